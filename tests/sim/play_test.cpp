#include "sim/terms/play.hpp"

#include <fmt/format.h>

#include "sim/mesh/structured.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/scene/scene.hpp"
#include "sim/solve/equilibrium.hpp"
#include "tests/support/message.hpp"
#include "tests/support/term_battery.hpp"

namespace taut {
namespace {

using namespace test;

/// A stud on a face, its hole a point of the same irregular body, moved so far that e is `moved`.
TermUnderTest play_case(ElementShape shape, double moved, double clearance, double smoothing) {
  ParameterTable table;
  table.declare({"other", "x", "1", -10, 10, "a number of some other term", false});
  table.declare({"k", "k", "N/m", 0, 1e9, "stiffness", true});
  table.declare({"c", "c", "m", 0, 1, "clearance"});
  Mesh mesh = irregular_mesh(shape);
  const int d = mesh.dimension();
  Eigen::VectorXd direction = Eigen::VectorXd::Zero(d);
  direction.head<2>() << 0.6, 0.8;
  Play play;
  play.apart = mean_weights(mesh, mesh.select("xmax"), direction) -
               point_weights(mesh, locate(mesh, 0.5 * (mesh.node(0) + mesh.centroid(0))), direction);
  play.stiffness = 1;
  play.clearance = 2;
  play.smoothing = smoothing;
  play.share = 0.5;
  Eigen::VectorXd u = random_state(mesh, 0.1, 0.01, 5);
  u += (moved - play.apart.dot(u)) / play.apart.squaredNorm() * play.apart;
  auto term = make_play(mesh, play);
  return term_under_test(std::move(mesh), std::move(table), std::move(term), Eigen::Vector3d(1, 30, clearance), u,
                         fmt::format("{}, e = {}, c = {}", name_of(shape), moved, clearance));
}

TEST(Play, PassesTheBatteryOfTerms) {
  for (const ElementShape shape : all_shapes) {
    for (const double moved : {-0.05, -0.021, -0.004, 0.018, 0.04}) {
      const TermUnderTest t = play_case(shape, moved, 0.02, 0.01);
      expect_derivatives(t, 1e-4);
      expect_parameter_derivatives(t, 0.02);
      expect_symmetric_hessian(t);
      expect_projection_is_semidefinite(t);
    }
  }
}

TEST(Play, TheForceIsThatBeyondTheClearanceToEitherSideAndForNoneThatOfASpring) {
  const auto energy = [](double moved, double clearance, double smoothing) {
    const TermUnderTest t = play_case(ElementShape::tri3, moved, clearance, smoothing);
    return energy_of(t.model, t.u, t.p);
  };
  const auto force = [&](double moved, double clearance, double smoothing) {
    return (energy(moved + 1e-6, clearance, smoothing) - energy(moved - 1e-6, clearance, smoothing)) / 2e-6 / 0.5;
  };
  for (const double e : {-0.05, -0.03, 0.03, 0.05})
    EXPECT_NEAR(force(e, 0.02, 0.01), 30 * std::copysign(std::abs(e) - 0.02, e), 1e-8) << e;
  EXPECT_EQ(energy(0.014, 0.02, 0.01), 0.0);
  EXPECT_EQ(energy(-0.014, 0.02, 0.01), 0.0);
  for (const double e : {-0.05, -0.002, 0.0, 0.003, 0.05}) EXPECT_NEAR(force(e, 0, 0.01), 30 * e, 1e-8) << e;
}

constexpr double reach = 0.1, half_width = 5e-3;

/// Stiff bars one after the other, each in the one before it (the first in the world) by studs at the ends of an
/// engaged length, with play across; along, and weakly in itself, each is held without.
struct Chain {
  Scene scene;
  int force = -1, clearance = -1;

  explicit Chain(const std::vector<double>& engaged) {
    std::vector<std::pair<std::string, Mesh>> bars;
    double start = 0, before = 0;
    std::vector<double> starts;
    for (size_t j = 0; j < engaged.size(); ++j) {
      start = j == 0 ? 0 : before + reach - engaged[j];
      Mesh bar = rectangle(graded(reach, 20), graded(2 * half_width, 2), 1, "bar");
      place(bar, Eigen::Matrix2d::Identity(), Eigen::Vector2d(start, -half_width));
      bars.emplace_back(fmt::format("bar{}", j), std::move(bar));
      starts.push_back(before = start);
    }
    SceneBuilder builder(merge(bars), Plane::stress, 1e-2);
    builder.add_solid("bar", "neo_hookean", {{"E", 1e12}, {"nu", 0.3}});
    force = builder.declare({"force", "F", "N", -10, 10, "force at the tip"}, 0);
    clearance = builder.declare({"clearance", "c", "m", 0, 1, "clearance"}, 1e-4);
    const int none = builder.declare({"none", "c", "m", 0, 1, "no clearance"}, 0);
    const int stiff = builder.declare({"k", "k", "N/m", 0, 1e12, "stiffness of studs"}, 1e7);
    const int weak = builder.declare({"k_weak", "k", "N/m", 0, 1e12, "what holds bars that are open"}, 1e-3);
    const Mesh& mesh = builder.mesh();
    const auto tie = [&](size_t j, double x, const Eigen::Vector2d& direction, int stiffness, int play_of) {
      const Eigen::Vector2d at(x, 0);
      Play play;
      play.apart = point_weights(mesh, locate(mesh, at, mesh.parts[j]), direction);
      if (j > 0) play.apart -= point_weights(mesh, locate(mesh, at, mesh.parts[j - 1]), direction);
      play.stiffness = stiffness;
      play.clearance = play_of;
      builder.add_play(play);
    };
    for (size_t j = 0; j < engaged.size(); ++j) {
      tie(j, starts[j], {1, 0}, stiff, none);
      for (const double x : {starts[j], starts[j] + engaged[j]}) {
        tie(j, x, {0, 1}, stiff, clearance);
        tie(j, x, {0, 1}, weak, none);
      }
    }
    tip = starts.back() + reach;
    builder.add_point_force(Eigen::Vector2d(tip, 0), Eigen::Vector2d(0, 1), force);
    weights = point_weights(mesh, locate(mesh, Eigen::Vector2d(tip, 0), mesh.parts.back()), Eigen::Vector2d(0, 1));
    for (size_t j = 0; j < engaged.size(); ++j) levers += 2e-4 / engaged[j] * (tip - starts[j] - engaged[j] / 2);
    scene = builder.build();
  }

  double tip_under(double newtons) const {
    Equilibrium equilibrium(*scene.model);
    Params p = scene.values;
    equilibrium.start_at_rest(p);
    p[force] = newtons;
    EXPECT_EQ(equilibrium.solve(p).status, SolveStatus::converged) << equilibrium.report().message();
    return weights.dot(equilibrium.u());
  }

  double tip = 0, levers = 0;  ///< sum_j (2 c / l_j) x_j
  Eigen::VectorXd weights;
};

TEST(Play, TheFreePlayOfATipIsTheSumOverItsStudsToEitherSideOfTheCentre) {
  for (const std::vector<double>& engaged :
       {std::vector{0.02}, std::vector{0.02, 0.03}, std::vector{0.03, 0.01, 0.02}}) {
    const Chain chain(engaged);
    for (const double sign : {1.0, -1.0})
      EXPECT_NEAR(chain.tip_under(sign * 2e-3), sign * chain.levers, 0.02 * chain.levers) << engaged.size();
    EXPECT_NEAR(chain.tip_under(2e-3) - chain.tip_under(-2e-3), 2 * chain.levers, 0.04 * chain.levers);
  }
}

TEST(Play, StudsWithoutAPlaceOrWithANegativeSmoothingAreRefused) {
  Mesh bar = rectangle(graded(0.1, 4), graded(0.02, 2), 1, "bar");
  SceneBuilder builder(bar, Plane::strain, 0.01);
  builder.add_solid("bar", "neo_hookean", {{"E", 1e5}, {"nu", 0.3}});
  Play play;
  play.apart = Eigen::VectorXd::Zero(bar.X.size());
  play.stiffness = builder.declare({"k", "k", "N/m", 0, 1e12, "stiffness"}, 1e4);
  play.clearance = builder.declare({"c", "c", "m", 0, 1, "clearance"}, 0);
  expect_input_error([&] { make_play(bar, play); }, {"one place", "name two places"});
  play.apart[0] = 1;
  play.smoothing = -1;
  expect_input_error([&] { make_play(bar, play); }, {"smoothing", "0 (none) or positive"});
}

}  // namespace
}  // namespace taut
