#include "sim/scene/reaction.hpp"

#include <gtest/gtest.h>

#include <random>

#include "sim/mesh/structured.hpp"
#include "sim/scene/scene.hpp"
#include "sim/solve/equilibrium.hpp"
#include "tests/support/message.hpp"
#include "tests/support/taylor.hpp"
#include "tests/support/term_battery.hpp"

namespace taut {
namespace {

using namespace test;

constexpr double force = 0.3, height = 0.012, length = 0.06, density = 1000, thickness = 0.02;

/// A beam under its weight and a force on its end that bends it by a good part of its length, held at one end, where
/// `lift` moves it up.
struct Beam {
  Scene scene;
  Eigen::VectorXd u;
  Beam() {
    SceneBuilder builder(rectangle(graded(length, 12), graded(height, 3), 2, "foam"), Plane::stress, thickness);
    builder.add_solid("foam", "neo_hookean", {{"E", 1e5}, {"nu", 0.3}});
    const int g = builder.declare({"g", "g", "m/s2", 0, 100, "gravity"}, 9.81);
    builder.add_weight("foam", density, Eigen::Vector2d(0, -1), g);
    builder.fix("xmin", {0});
    builder.prescribe("xmin", 1, builder.declare({"lift", "u", "m", -1, 1, "displacement"}, 0.002));
    builder.add_force("xmax", Eigen::Vector2d(3, -4), builder.declare({"pull", "F", "N", -10, 10, "force"}, force));
    scene = builder.build();
    Equilibrium equilibrium(*scene.model, {.step_tolerance = 1e-12});
    Params rest = scene.values;
    for (const char* id : {"g", "lift", "pull"}) rest[scene.model->parameters().index(id)] = 0;
    equilibrium.start_at_rest(rest);
    EXPECT_EQ(equilibrium.solve(scene.values).status, SolveStatus::converged);
    u = equilibrium.u();
  }
  std::unique_ptr<Channel> reaction(const Eigen::Vector2d& direction, double share = 1) const {
    return make_reaction(*scene.model, scene.model->mesh().select("xmin"), direction, share);
  }
};

TEST(Reaction, IsWhatTheSupportBringsAgainstLoadAndWeight) {
  const Beam beam;
  const Point at{beam.u, beam.scene.values};
  ASSERT_GT(beam.u.cwiseAbs().maxCoeff(), 0.02) << "bent";
  const double weight = density * 9.81 * length * height * thickness;
  EXPECT_NEAR(beam.reaction({1, 0})->value(at), -0.6 * force, 1e-8);
  EXPECT_NEAR(beam.reaction({0, 5})->value(at), 0.8 * force + weight, 1e-8);
  EXPECT_NEAR(beam.reaction({0, -1})->value(at), -0.8 * force - weight, 1e-8);
  EXPECT_NEAR(beam.reaction({3, 4})->value(at), -0.36 * force + 0.64 * force + 0.8 * weight, 1e-8);
  EXPECT_NEAR(beam.reaction({0, 1}, 0.5)->value(at), 2 * (0.8 * force + weight), 1e-8) << "half of a body";
}

TEST(Reaction, GradientIsThatOfItsValue) {
  const Beam beam;
  const auto reaction = beam.reaction({1, 2});
  std::mt19937 random(3);
  const Point at{beam.u, beam.scene.values};
  const double y = reaction->value(at);
  const Eigen::VectorXd gradient = reaction->gradient(at);
  for (int k = 0; k < 3; ++k) {
    const Eigen::VectorXd v = random_vector(beam.u.size(), random);
    ASSERT_GT(std::abs(gradient.dot(v)), 1e-3);
    expect_taylor_order(
        [&](double h) {
          const Eigen::VectorXd moved = beam.u + h * v;
          return std::abs(reaction->value({moved, beam.scene.values}) - y - h * gradient.dot(v));
        },
        2, 1e-12, 1e-4, 6, "along direction " + std::to_string(k));
  }
}

TEST(Reaction, ParameterDerivativesAreThoseOfItsValue) {
  const Beam beam;
  const auto reaction = beam.reaction({1, 2});
  const double y = reaction->value({beam.u, beam.scene.values});
  for (const char* id : {"E_foam", "nu_foam", "thickness", "g", "density_foam", "pull", "lift"}) {
    const int index = beam.scene.model->parameters().index(id);
    const double slope = reaction->parameter_derivative({beam.u, beam.scene.values}, index);
    expect_taylor_order(
        [&](double h) {
          Params p = beam.scene.values;
          p[index] += h;
          return std::abs(reaction->value({beam.u, p}) - y - h * slope);
        },
        2, 1e-12, 0.1 * std::abs(beam.scene.values[index]), 5, id);
    if (std::string(id) == "E_foam") {
      EXPECT_NE(slope, 0.0);
    }
  }
}

TEST(Reaction, APlaceThatNothingHoldsHasNone) {
  const Beam beam;
  const Model& model = *beam.scene.model;
  expect_input_error([&] { make_reaction(model, model.mesh().select("xmax"), Eigen::Vector2d(1, 0)); },
                     {"nothing that is fixed or moved", "name the tag of a support"});
  expect_input_error([&] { make_reaction(model, model.mesh().select("xmin"), Eigen::Vector3d(1, 0, 0)); },
                     {"direction", "2 finite numbers"});
}

}  // namespace
}  // namespace taut
