#include <gtest/gtest.h>

#include "calib/benches/static_protocol.hpp"
#include "sim/mesh/structured.hpp"
#include "sim/mesh/weights.hpp"
#include "tests/support/taylor.hpp"

namespace taut {
namespace {

using namespace test;

struct ProtocolSetup {
  std::vector<std::vector<double>> rows;  ///< force [N], push [N]
  bool from_unloaded = false;
  int threads = 1;
  EquilibriumOptions equilibrium = {};
};

/// A clamped beam of two regions that bends by a good part of its length under its weight, a force on its end and a
/// push on its top; channels: mean deflection of the end, and a marker that turns with it. Two rows per load, one per
/// channel.
StaticProtocol beam(const ProtocolSetup& setup) {
  Mesh mesh = rectangle(graded(0.06, 12), graded(0.012, 3), 1, "soft");
  assign_regions(mesh, [](const Eigen::VectorXd& c) { return c[0] < 0.03 ? "soft" : "firm"; });
  SceneBuilder builder(std::move(mesh), Plane::strain, 0.02);
  builder.add_solid("soft", "neo_hookean", {{"E", 1e5}, {"nu", 0.3}});
  builder.add_solid("firm", "neo_hookean", {{"E", 2e5}, {"nu", 0.4}});
  const Eigen::Vector2d down(0, -1);
  const int g = builder.declare({"g", "g", "m/s2", 0, 100, "gravity"}, 9.81);
  builder.add_weight("soft", 1000, down, g);
  builder.add_weight("firm", 1000, down, g);
  builder.fix("xmin", {0, 1});
  const int force = builder.declare({"force", "F", "N", -1e9, 1e9, "force"}, 0);
  const int push = builder.declare({"push", "P", "N", -1e9, 1e9, "push"}, 0);
  builder.add_force("xmax", down, force);
  builder.add_force("ymax", Eigen::Vector2d(1, 0), push);
  const Mesh& shape = builder.mesh();
  std::vector<NamedChannel> channels;
  channels.push_back({"end", make_linear_channel(mean_weights(shape, shape.select("xmax"), down))});
  channels.push_back({"marker", make_marker_channel(shape, locate(shape, Eigen::Vector2d(0.06, 0.006)),
                                                    Eigen::Vector2d(0.01, 0), shape.select("xmax"), down)});
  std::vector<StaticRow> rows;
  for (const std::vector<double>& controls : setup.rows) {
    for (int channel : {0, 1}) rows.push_back({controls, channel});
  }
  StaticProtocol::Options options;
  options.equilibrium = setup.equilibrium;
  options.threads = setup.threads;
  options.from_unloaded = setup.from_unloaded;
  return {builder.build(), std::move(channels), {force, push}, {g}, rows, options};
}

const std::vector<std::vector<double>> kPulls = {{0, 0}, {0.1, 0}, {0.2, 0.1}, {0.3, -0.2}};

std::vector<int> some_free(const StaticProtocol& protocol) {
  std::vector<int> free;
  for (const char* id : {"E_soft", "nu_firm", "thickness", "g"}) free.push_back(protocol.parameters().index(id));
  return free;
}

double largest(const Eigen::VectorXd& v) {
  return v.cwiseAbs().maxCoeff();
}

TEST(StaticProtocol, DerivativesAreThoseOfTheWholePrediction) {
  for (const bool from_unloaded : {false, true}) {
    StaticProtocol protocol = beam({kPulls, from_unloaded, 1, {.step_tolerance = 1e-11}});
    const std::vector<int> free = some_free(protocol);
    const Params p = protocol.nominal();
    const Prediction at = protocol.predict(p, free);
    ASSERT_TRUE(at.complete()) << at.failures.front();
    ASSERT_GT(largest(at.values), 0.01) << "bent far enough to be nonlinear";
    ASSERT_EQ(at.derivatives.rows(), protocol.row_count());
    ASSERT_EQ(at.derivatives.cols(), 4);
    for (size_t j = 0; j < free.size(); ++j) {
      const std::string what = protocol.parameters()[free[j]].id + (from_unloaded ? ", from unloaded" : ", from rest");
      const double size = 0.1 * p[free[j]];
      const Eigen::VectorXd slope = at.derivatives.col(static_cast<Eigen::Index>(j));
      EXPECT_GT(largest(slope) * size, 1e-6) << what << " tests nothing";
      expect_taylor_order(
          [&](double h) {
            Params moved = p;
            moved[free[j]] += h;
            return (protocol.predict(moved, {}).values - at.values - h * slope).norm();
          },
          2, 1e-11, size, 5, what);
    }
  }
}

TEST(StaticProtocol, DisplacementsFromTheUnloadedStateLackItsValueAndItsDerivative) {
  StaticProtocol from_rest = beam({kPulls});
  StaticProtocol from_unloaded = beam({kPulls, true});
  const std::vector<int> free = some_free(from_rest);
  const Prediction a = from_rest.predict(from_rest.nominal(), free);
  const Prediction b = from_unloaded.predict(from_unloaded.nominal(), free);
  ASSERT_GT(std::abs(a.values[0]), 1e-4) << "the beam sags under its weight";
  for (Eigen::Index row = 0; row < a.values.size(); ++row) {
    const Eigen::Index unloaded = row % 2;  // the first two rows have no load
    EXPECT_NEAR(b.values[row], a.values[row] - a.values[unloaded], 1e-10);
    EXPECT_LT(largest(b.derivatives.row(row) - a.derivatives.row(row) + a.derivatives.row(unloaded)),
              1e-7 * largest(a.derivatives.row(row)));
  }
  EXPECT_EQ(b.values[0], 0);
  EXPECT_EQ(b.values[1], 0);
}

TEST(StaticProtocol, TheUnloadedStateIsSolvedEvenWhenNoRowAsksForIt) {
  StaticProtocol with = beam({kPulls, true}), without = beam({{kPulls[2]}, true});
  EXPECT_EQ(without.conditions().size(), 2u);
  EXPECT_EQ(without.row_count(), 2);
  EXPECT_NEAR(without.predict(without.nominal(), {}).values[0], with.predict(with.nominal(), {}).values[4], 1e-10);
}

TEST(StaticProtocol, AWarmStartGivesTheAnswerOfAColdOne) {
  StaticProtocol warm = beam({kPulls}), cold = beam({kPulls});
  const std::vector<int> free = some_free(warm);
  Params p = warm.nominal();
  warm.predict(p, free);
  const int first = warm.factorisations();
  for (const double factor : {1.3, 0.7, 3.0, 0.5}) {
    p = warm.nominal();
    p[free[0]] *= factor;
    p[free[3]] *= std::sqrt(factor);
    cold.forget();
    const Prediction a = warm.predict(p, free), b = cold.predict(p, free);
    ASSERT_TRUE(a.complete() && b.complete());
    EXPECT_LT(largest(a.values - b.values), 1e-9 * 0.06) << "E times " << factor;
    EXPECT_LT((a.derivatives - b.derivatives).cwiseAbs().maxCoeff(), 1e-5 * b.derivatives.cwiseAbs().maxCoeff());
  }
  EXPECT_LT(warm.factorisations() - first, cold.factorisations()) << "and is worth it";
}

TEST(StaticProtocol, ASearchTakesFewerFactorisationsForTheSameValuesAndNearlyTheSameDerivatives) {
  StaticProtocol quick = beam({kPulls}), full = beam({kPulls});
  const std::vector<int> free = some_free(full);
  Params p = full.nominal();
  quick.begin_search();
  for (const double factor : {1.0, 1.03, 0.98}) {
    p[free[0]] = factor * full.nominal()[free[0]];
    const Prediction a = quick.predict(p, free), b = full.predict(p, free);
    EXPECT_LT(largest(a.values - b.values), 1e-8 * 0.06) << "E times " << factor;
    EXPECT_LT((a.derivatives - b.derivatives).cwiseAbs().maxCoeff(), 0.1 * b.derivatives.cwiseAbs().maxCoeff());
  }
  EXPECT_LT(quick.factorisations(), 0.8 * full.factorisations());
  quick.end_search();
  const Prediction a = quick.predict(p, free), b = full.predict(p, free);
  EXPECT_LT((a.derivatives - b.derivatives).cwiseAbs().maxCoeff(), 1e-5 * b.derivatives.cwiseAbs().maxCoeff());
}

TEST(StaticProtocol, AfterForgettingThePastPredictionsAreThoseOfANewProtocolToTheLastBit) {
  StaticProtocol old = beam({kPulls}), fresh = beam({kPulls});
  const std::vector<int> free = some_free(old);
  Params p = old.nominal();
  p[free[0]] *= 2;
  old.predict(p, free);
  p[free[0]] /= 3;
  old.predict(p, free);
  const int before = old.factorisations();
  old.forget();
  const Prediction a = old.predict(p, free), b = fresh.predict(p, free);
  EXPECT_EQ(a.values, b.values);
  EXPECT_EQ(a.derivatives, b.derivatives);
  EXPECT_EQ(old.factorisations() - before, fresh.factorisations());
}

TEST(StaticProtocol, TheNumberOfThreadsDoesNotChangeABit) {
  StaticProtocol one = beam({kPulls, true, 1}), two = beam({kPulls, true, 2}), many = beam({kPulls, true, 16});
  const std::vector<int> free = some_free(one);
  Params p = one.nominal();
  for (const double factor : {1.0, 1.4, 0.8}) {  // cold, then twice warm
    p[free[0]] = 1e5 * factor;
    const Prediction a = one.predict(p, free);
    for (StaticProtocol* other : {&two, &many}) {
      const Prediction b = other->predict(p, free);
      EXPECT_EQ(a.values, b.values);
      EXPECT_EQ(a.derivatives, b.derivatives);
    }
  }
  EXPECT_EQ(one.factorisations(), two.factorisations());
  EXPECT_EQ(one.newton_iterations(), many.newton_iterations());
}

TEST(StaticProtocol, RowsWithTheSameControlsShareTheirSolve) {
  StaticProtocol protocol = beam({{{0.1, 0}, {0.2, 0}, {0.1, 0}}});
  EXPECT_EQ(protocol.row_count(), 6);
  ASSERT_EQ(protocol.conditions().size(), 2u);
  EXPECT_EQ(protocol.conditions()[0].rows, (std::vector{0, 1, 4, 5}));
  const Prediction prediction = protocol.predict(protocol.nominal(), {});
  EXPECT_EQ(prediction.values[0], prediction.values[4]);
  EXPECT_EQ(prediction.derivatives.size(), 0) << "none were asked for";
}

TEST(StaticProtocol, RowsMayRepeatAChannelInAnyOrderAndKeepTheirPlace) {
  StaticProtocol forward = beam({kPulls}), backward = beam({{kPulls.rbegin(), kPulls.rend()}});
  const Eigen::VectorXd a = forward.predict(forward.nominal(), {}).values;
  const Eigen::VectorXd b = backward.predict(backward.nominal(), {}).values;
  for (Eigen::Index load = 0; load < 4; ++load) {
    EXPECT_EQ(a[2 * load], b[2 * (3 - load)]);
    EXPECT_EQ(a[2 * load + 1], b[2 * (3 - load) + 1]);
  }
}

/// Few, short steps, so that an absurd load fails soon.
constexpr EquilibriumOptions kImpatient{.max_iterations = 15, .max_halvings = 3};

TEST(StaticProtocol, ALoadThatCannotBeCarriedCostsItsOwnRowsOnly) {
  StaticProtocol protocol = beam({{{0.1, 0}, {1e6, 0.5}, {0.2, 0}}, false, 2, kImpatient});
  StaticProtocol sound = beam({{{0.1, 0}, {0.2, 0}}, false, 1, kImpatient});
  const std::vector<int> free = some_free(protocol);
  const Prediction a = protocol.predict(protocol.nominal(), free), b = sound.predict(sound.nominal(), free);
  EXPECT_FALSE(a.complete());
  for (const Eigen::Index row : {2, 3}) {
    EXPECT_TRUE(std::isnan(a.values[row]));
    EXPECT_TRUE(a.derivatives.row(row).array().isNaN().all());
  }
  for (const auto& [row, same] : {std::pair{0, 0}, {1, 1}, {4, 2}, {5, 3}}) {
    EXPECT_EQ(a.values[row], b.values[same]);
    EXPECT_EQ(a.derivatives.row(row), b.derivatives.row(same));
  }
  ASSERT_EQ(a.failures.size(), 1u);
  for (const char* part : {"force = 1000 kN", "push = 500 mN", "E_soft = 100 kPa", "nu_firm = 0.4", "g = 9.81"}) {
    EXPECT_NE(a.failures[0].find(part), std::string::npos) << part << " is not in: " << a.failures[0];
  }
  EXPECT_EQ(a.failures[0].find('\n'), std::string::npos);
}

TEST(StaticProtocol, AfterAFailureTheNextPredictionIsRightAgain) {
  StaticProtocol protocol = beam({{{0.1, 0}}, false, 1, kImpatient}), fresh = beam({{{0.1, 0}}, false, 1, kImpatient});
  const int E = protocol.parameters().index("E_soft");
  Params p = protocol.nominal();
  protocol.predict(p, {E});
  p[E] = 1;  // nothing can be carried
  EXPECT_FALSE(protocol.predict(p, {E}).complete());
  p[E] = 1.2e5;
  const Prediction again = protocol.predict(p, {E});
  ASSERT_TRUE(again.complete()) << again.failures.front();
  EXPECT_NEAR(again.values[0], fresh.predict(p, {E}).values[0], 1e-10);
}

TEST(StaticProtocol, AFailedUnloadedStateCostsAllRowsThatAreMeasuredFromIt) {
  StaticProtocol protocol = beam({{{0.1, 0}}, true, 1, kImpatient});
  Params p = protocol.nominal();
  p[protocol.parameters().index("g")] = 1e7;
  const Prediction prediction = protocol.predict(p, {});
  EXPECT_TRUE(prediction.values.array().isNaN().all());
  EXPECT_GE(prediction.failures.size(), 1u);
}

TEST(StaticProtocol, ARaisedStopFlagEndsThePredictionAsAFailure) {
  const std::atomic<bool> stop{true};
  EquilibriumOptions options;
  options.stop = &stop;
  StaticProtocol protocol = beam({kPulls, false, 2, options});
  const Prediction prediction = protocol.predict(protocol.nominal(), {});
  EXPECT_EQ(prediction.failures.size(), protocol.conditions().size());
  EXPECT_TRUE(prediction.values.array().isNaN().all());
}

}  // namespace
}  // namespace taut
