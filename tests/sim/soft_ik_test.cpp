#include "sim/robots/soft_ik.hpp"

#include <cmath>
#include <limits>

#include "sim/mesh/weights.hpp"
#include "sim/terms/cable.hpp"
#include "tests/support/arm.hpp"
#include "tests/support/mesh_checks.hpp"
#include "tests/support/message.hpp"

namespace taut {
namespace {

using namespace test;

/// For answers that are compared with exact ones: the search ends where the tolerance is met.
IkOptions exactly() {
  IkOptions options;
  options.tolerance = 1e-6;
  return options;
}

std::vector<IkChannel> tip_channels(const Eigen::VectorXd& x, const Eigen::VectorXd& y) {
  return {{make_linear_channel(x)}, {make_linear_channel(y)}};
}

void expect_within_bounds(const IkResult& result, const std::vector<IkControl>& controls) {
  ASSERT_EQ(static_cast<size_t>(result.controls.size()), controls.size()) << result.message;
  for (size_t j = 0; j < controls.size(); ++j) {
    const double c = result.controls[static_cast<Eigen::Index>(j)];
    EXPECT_GE(c, controls[j].lower);
    EXPECT_LE(c, controls[j].upper);
    EXPECT_EQ(result.bound[j] == 0, c > controls[j].lower && c < controls[j].upper);
  }
}

// ---------------------------------------------------------------------------------------------------------------------
// Two rigid links, whose inverse kinematics is known.

struct Arm {
  Scene scene;
  std::vector<IkControl> controls;
  std::vector<IkChannel> channels;

  /// Displacement of the tip that brings it to `position`.
  Eigen::Vector2d target(const Eigen::Vector2d& position) const { return position - arm_rest_tip(scene.model->mesh()); }
  Eigen::Vector2d position(const IkResult& result) const { return result.achieved + arm_rest_tip(scene.model->mesh()); }
};

Arm two_link_arm() {
  Arm arm;
  SceneBuilder builder = arm_builder(2, 6);
  for (int i = 0; i < 2; ++i) {
    const Joint joint = builder.add_joint(arm_joint(i));
    arm.controls.push_back({joint.angle, i == 0 ? -1.5 : -2.5, i == 0 ? 1.5 : 2.5, i == 0 ? 0.0 : 0.5});
  }
  arm.channels = tip_channels(arm_tip_weights(builder.mesh(), {1, 0}), arm_tip_weights(builder.mesh(), {0, 1}));
  arm.scene = builder.build();
  return arm;
}

/// Both angles for a tip position, the second one positive (law of cosines).
Eigen::Vector2d closed_form(const Eigen::Vector2d& position) {
  const Eigen::Vector2d r = position - Eigen::Vector2d(arm_base, 0);
  const double second = std::acos(r.squaredNorm() / (2 * arm_link * arm_link) - 1);
  return {std::atan2(r[1], r[0]) - second / 2, second};
}

TEST(SoftIk, ATwoLinkArmTakesTheAnglesOfTheClosedForm) {
  const Arm arm = two_link_arm();
  SoftIk ik(arm.scene, arm.channels, arm.controls, exactly());
  for (const Eigen::Vector2d& position :
       {Eigen::Vector2d(0.085, 0.03), Eigen::Vector2d(0.06, 0.06), Eigen::Vector2d(0.07, -0.02)}) {
    const IkResult result = ik.solve(arm.target(position));
    ASSERT_EQ(result.status, IkStatus::reached) << result.message;
    EXPECT_LE((arm.position(result) - position).norm(), 1e-6);
    EXPECT_NEAR(result.error, (arm.position(result) - position).norm(), 1e-12);
    EXPECT_LE((result.controls - closed_form(position)).norm(), 1e-4);
    EXPECT_GT(result.factorisations, 0);
    EXPECT_LE(result.iterations, 15);
    expect_within_bounds(result, arm.controls);
  }
}

TEST(SoftIk, ATargetOutOfReachYieldsItsRadialProjection) {
  const Arm arm = two_link_arm();
  SoftIk ik(arm.scene, arm.channels, arm.controls);
  const Eigen::Vector2d base(arm_base, 0), position = base + 0.12 * Eigen::Vector2d(std::cos(0.6), std::sin(0.6));
  const IkResult result = ik.solve(arm.target(position));
  EXPECT_EQ(result.status, IkStatus::unreachable) << result.message;
  const Eigen::Vector2d nearest = base + 2 * arm_link * (position - base).normalized();
  EXPECT_LE((arm.position(result) - nearest).norm(), 1e-4);
  EXPECT_NEAR(result.error, 0.02, 1e-6);
  EXPECT_NE(result.message.find("out of reach"), std::string::npos);
  expect_within_bounds(result, arm.controls);
}

TEST(SoftIk, ABoundThatHoldsIsSaidAndNotLeft) {
  Arm arm = two_link_arm();
  arm.controls[0].lower = 0.4;
  arm.controls[0].nominal = 0.5;
  arm.controls[1] = {arm.controls[1].index, 0.2, 0.8, 0.5};
  SoftIk ik(arm.scene, arm.channels, arm.controls);
  // Below the arc that the lowest first angle allows: the first joint stays at its bound, and the second one, too.
  const IkResult result = ik.solve(arm.target(two_link_tip(0.1, 0.0)));
  EXPECT_EQ(result.status, IkStatus::unreachable) << result.message;
  EXPECT_EQ(result.bound, (std::vector<int>{-1, -1}));
  EXPECT_LE((result.controls - Eigen::Vector2d(0.4, 0.2)).norm(), 1e-9);
  EXPECT_NE(result.message.find("'joint1' at its lower bound"), std::string::npos) << result.message;
  expect_within_bounds(result, arm.controls);
}

TEST(SoftIk, AnotherStartLeadsOutOfALocalMinimum) {
  // With the elbow up the first joint would have to leave its bounds; the search begins with the elbow up.
  Arm arm = two_link_arm();
  arm.controls[0] = {arm.controls[0].index, 0.3, 2.0, 0.6};
  IkOptions once = exactly();
  once.restarts = 0;
  const Eigen::Vector2d target = arm.target(two_link_tip(1.0, -1.2));
  const IkResult stuck = SoftIk(arm.scene, arm.channels, arm.controls, once).solve(target);
  const IkResult result = SoftIk(arm.scene, arm.channels, arm.controls, exactly()).solve(target);
  ASSERT_EQ(result.status, IkStatus::reached) << result.message;
  EXPECT_LE((result.controls - Eigen::Vector2d(1.0, -1.2)).norm(), 1e-4);
  EXPECT_EQ(stuck.status, IkStatus::unreachable) << stuck.message;
  EXPECT_GT(stuck.error, 100 * result.error);
}

TEST(SoftIk, APathOfTargetsTakesFewerFactorisationsThanColdSolves) {
  const Arm arm = two_link_arm();
  SoftIk warm(arm.scene, arm.channels, arm.controls, exactly()), cold(arm.scene, arm.channels, arm.controls, exactly());
  int most_warm = 0, fewest_cold = std::numeric_limits<int>::max();
  for (int k = 0; k < 20; ++k) {
    const Eigen::Vector2d position(0.08 - 0.001 * k, 0.02 + 0.002 * k);
    const IkResult from_last = warm.solve(arm.target(position));
    ASSERT_EQ(from_last.status, IkStatus::reached) << from_last.message;
    if (k > 0) most_warm = std::max(most_warm, from_last.factorisations);
    if (k % 5 != 0) continue;
    cold.forget();
    const IkResult from_rest = cold.solve(arm.target(position));
    ASSERT_EQ(from_rest.status, IkStatus::reached) << from_rest.message;
    fewest_cold = std::min(fewest_cold, from_rest.factorisations);
    EXPECT_LE((from_last.controls - from_rest.controls).norm(), 1e-5) << "the past changes the time, not the answer";
  }
  RecordProperty("most_factorisations_warm", most_warm);
  RecordProperty("fewest_factorisations_cold", fewest_cold);
  EXPECT_LT(3 * most_warm, fewest_cold);
}

TEST(SoftIk, WithMoreControlsThanTargetsTheNominalOnesDecide) {
  // Only the height of the tip is asked for. Of all pairs of angles that reach it the nearest one to the nominal pair,
  // in fractions of the ranges, by Lagrange's condition: d/R^2 is parallel to the gradient of the height.
  Arm arm = two_link_arm();
  arm.channels = {arm.channels[1]};
  SoftIk ik(arm.scene, arm.channels, arm.controls, exactly());
  for (double height : {0.03, 0.05}) {
    const IkResult result = ik.solve(vec({height}));
    ASSERT_EQ(result.status, IkStatus::reached) << result.message;
    EXPECT_LE(result.error, 1e-6);
    const double a = result.controls[0], b = result.controls[1];
    const Eigen::Vector2d gradient(std::cos(a) + std::cos(a + b), std::cos(a + b));
    const Eigen::Vector2d pull((a - 0.0) / (3.0 * 3.0), (b - 0.5) / (5.0 * 5.0));
    EXPECT_NEAR(gradient[0] * pull[1] - gradient[1] * pull[0], 0, 0.01 * gradient.norm() * pull.norm()) << height;
  }
}

TEST(SoftIk, ANearTargetTakesFewFactorisationsAndIsMetWithinTheTolerance) {
  const Arm arm = two_link_arm();
  SoftIk ik(arm.scene, arm.channels, arm.controls);
  int factorisations = 0, trials = 0;
  constexpr int targets = 20;
  for (int k = 0; k <= targets; ++k) {
    const Eigen::Vector2d position(0.08 - 0.001 * k, 0.02 + 0.002 * k);
    const IkResult result = ik.solve(arm.target(position));
    ASSERT_EQ(result.status, IkStatus::reached) << result.message;
    EXPECT_LE((arm.position(result) - position).norm(), IkOptions().tolerance);
    EXPECT_LE((two_link_tip(result.controls[0], result.controls[1]) - position).norm(), IkOptions().tolerance + 1e-6);
    if (k == 0) continue;  // from rest
    factorisations += result.factorisations;
    trials += result.iterations;
  }
  RecordProperty("factorisations", factorisations);
  RecordProperty("trials", trials);
  EXPECT_LE(factorisations, 3 * targets);
  EXPECT_LE(trials, 2 * targets);
}

TEST(SoftIk, AlongTheEdgeOfReachATargetCostsNoMoreThanFiveInReach) {
  const Arm arm = two_link_arm();
  const Eigen::Vector2d base(arm_base, 0);
  const auto at = [&](double radius, double angle) {
    return arm.target(base + radius * Eigen::Vector2d(std::cos(angle), std::sin(angle)));
  };
  SoftIk near(arm.scene, arm.channels, arm.controls), far(arm.scene, arm.channels, arm.controls);
  near.solve(at(0.06, 0.6));  // from rest
  far.solve(at(0.12, 0.6));
  int steps = 0, edge = 0;
  for (int k = 1; k <= 10; ++k) {
    steps += near.solve(at(0.06, 0.6 + 0.02 * k)).factorisations;
    const IkResult result = far.solve(at(0.12, 0.6 + 0.02 * k));
    EXPECT_EQ(result.status, IkStatus::unreachable) << result.message;
    EXPECT_NEAR(result.error, 0.12 - 2 * arm_link, 1e-5);
    edge += result.factorisations;
  }
  EXPECT_LE(edge, 5 * steps);
}

// ---------------------------------------------------------------------------------------------------------------------
// A foam beam, 60 x 20 mm, clamped at its left end, with a cable along either side.

struct PulledBeam {
  Scene scene;
  std::vector<IkControl> controls;
  std::vector<IkChannel> channels;
  Eigen::VectorXd up;                      ///< weights of the tip's height
  std::shared_ptr<const Channel> tension;  ///< of the top cable
  int force;                               ///< on the tip, upwards
  int idle;                                ///< a parameter on which nothing depends
};

PulledBeam soft_beam(double smoothing = 2e-6, double lower = -0.004, double nominal = 0.001) {
  PulledBeam beam;
  SceneBuilder builder(rectangle(graded(0.06, 12), graded(0.02, 4), 2, "foam"), Plane::stress, 0.03);
  builder.add_solid("foam", "neo_hookean", {{"E", 5e4}, {"nu", 0.2}});
  builder.fix("xmin", {0, 1});
  const int stiffness = builder.declare({"k_cable", "k", "N/m", 1, 1e6, "stiffness of the cables", true}, 2e3);
  for (const auto& [name, y] : {std::pair{"bottom", 0.001}, std::pair{"top", 0.019}}) {
    Cable cable;
    cable.smoothing = smoothing;
    cable.stiffness = stiffness;
    cable.retraction = builder.declare({name, "u", "m", -0.1, 0.1, "retraction"}, 0.0);
    for (double x : {0.0, 0.02, 0.04, 0.06}) cable.points.push_back({locate(builder.mesh(), vec({x, y})), {}});
    builder.add_cable(cable);
    beam.tension = make_cable_tension(builder.mesh(), cable);
    beam.controls.push_back({cable.retraction, lower, 0.012, nominal});
  }
  const Tag end = builder.mesh().select("xmax");
  beam.up = mean_weights(builder.mesh(), end, vec({0, 1}));
  beam.channels = tip_channels(mean_weights(builder.mesh(), end, vec({1, 0})), beam.up);
  beam.force = builder.declare({"force", "F", "N", -1e6, 1e6, "load on the tip"}, 0.0);
  builder.add_force("xmax", vec({0, 1}), beam.force);
  beam.idle = builder.declare({"idle", "x", "1", 0, 1, "nothing"}, 0.25);
  beam.scene = builder.build();
  return beam;
}

/// Displacement of the tip at these retractions, by a solve of its own.
Eigen::Vector2d forward(const PulledBeam& beam, double bottom, double top) {
  Equilibrium equilibrium(*beam.scene.model);
  equilibrium.start_at_rest(beam.scene.values);
  Params p = beam.scene.values;
  p[beam.controls[0].index] = bottom;
  p[beam.controls[1].index] = top;
  EXPECT_EQ(equilibrium.solve(p).status, SolveStatus::converged);
  const Point at{equilibrium.u(), equilibrium.p()};
  return {beam.channels[0].channel->value(at), beam.channels[1].channel->value(at)};
}

TEST(SoftIk, ASoftBeamReachesWhatOtherControlsReached) {
  const PulledBeam beam = soft_beam();
  SoftIk ik(beam.scene, beam.channels, beam.controls, exactly());
  for (const auto& [bottom, top] : {std::pair{0.002, 0.006}, {0.008, 0.001}, {0.005, 0.005}}) {
    const Eigen::Vector2d target = forward(beam, bottom, top);
    const IkResult result = ik.solve(target);
    ASSERT_EQ(result.status, IkStatus::reached) << result.message;
    EXPECT_LE((result.achieved - target).norm(), 2e-6);
    EXPECT_LE((forward(beam, result.controls[0], result.controls[1]) - target).norm(), 2e-6)
        << "the controls reach it from rest, too";
    EXPECT_LE((result.controls - Eigen::Vector2d(bottom, top)).norm(), 1e-5);
    expect_within_bounds(result, beam.controls);
  }
}

TEST(SoftIk, OfAllPairsOfRetractionsThatReachAHeightTheNearestToTheNominalOneIsTaken) {
  const PulledBeam beam = soft_beam();
  const double target = 0.003;
  const auto fraction = [&](double c, size_t j) {
    return (c - beam.controls[j].nominal) / (beam.controls[j].upper - beam.controls[j].lower);
  };
  // By brute force: for each bottom retraction the top one that reaches the height, by the secant method.
  Equilibrium equilibrium(*beam.scene.model);
  equilibrium.start_at_rest(beam.scene.values);
  const auto height = [&](double bottom, double top) {
    Params p = beam.scene.values;
    p[beam.controls[0].index] = bottom;
    p[beam.controls[1].index] = top;
    EXPECT_EQ(equilibrium.solve(p).status, SolveStatus::converged);
    return beam.up.dot(equilibrium.u());
  };
  double least = std::numeric_limits<double>::infinity();
  for (double bottom = -0.001; bottom <= 0.003; bottom += 0.00025) {
    double last = 0.003, top = 0.004, before = height(bottom, last);
    for (int k = 0; k < 20 && std::abs(top - last) > 1e-9; ++k) {
      const double now = height(bottom, top);
      const double next = top - (now - target) * (top - last) / (now - before);
      last = top;
      before = now;
      top = next;
    }
    least = std::min(least, std::hypot(fraction(bottom, 0), fraction(top, 1)));
  }
  const std::vector<IkChannel> channels{beam.channels[1]};
  for (double tolerance : {1e-4, 1e-6}) {
    IkOptions options;
    options.tolerance = tolerance;
    const IkResult result = SoftIk(beam.scene, channels, beam.controls, options).solve(vec({target}));
    ASSERT_EQ(result.status, IkStatus::reached) << result.message;
    EXPECT_NEAR(height(result.controls[0], result.controls[1]), target, tolerance);
    const double distance = std::hypot(fraction(result.controls[0], 0), fraction(result.controls[1], 1));
    EXPECT_NEAR(distance, least, 0.05 * least) << tolerance;
  }
}

TEST(SoftIk, SlackCablesAreTightenedUntilTheyHaveAnEffect) {
  const PulledBeam beam = soft_beam(2e-6, -0.004, -0.003);
  SoftIk ik(beam.scene, beam.channels, beam.controls, exactly());
  const Eigen::Vector2d target = forward(beam, 0.003, 0.006);
  const IkResult result = ik.solve(target);
  ASSERT_EQ(result.status, IkStatus::reached) << result.message;
  EXPECT_LE((result.controls - Eigen::Vector2d(0.003, 0.006)).norm(), 1e-5);
}

TEST(SoftIk, ABeamCannotBePulledLongerAndSaysHowNearItComes) {
  const PulledBeam beam = soft_beam();
  SoftIk ik(beam.scene, beam.channels, beam.controls);
  const IkResult result = ik.solve(vec({0.005, 0}));
  EXPECT_EQ(result.status, IkStatus::unreachable) << result.message;
  EXPECT_NEAR(result.error, 0.005, 2e-6) << "cables do not push: the nearest point is the tip at rest";
  expect_within_bounds(result, beam.controls);
}

TEST(SlowSoftIk, CoContractionReachesAPoseAndAStiffnessBetweenTheLeastAndTheLargest) {
  // Cables that tighten gradually: their stiffness rises with their tension, so that pulling both stiffens the beam.
  const PulledBeam beam = soft_beam(0.01);
  std::vector<IkChannel> height{beam.channels[1]};
  IkOptions options;
  options.stiffness_direction = beam.up;
  const double target = 0.003;
  // The least and the largest stiffness at this height: the bottom cable stays, the top one brings the tip there.
  double least = 1e300, largest = 0;
  for (double bottom : {-0.004, 0.0, 0.004, 0.008}) {
    std::vector<IkControl> top{beam.controls[1]};
    IkOptions held = options;
    held.held = beam.scene.values;
    held.held[beam.controls[0].index] = bottom;
    const IkResult result = SoftIk(beam.scene, height, top, held).solve(vec({target}));
    if (result.status != IkStatus::reached) continue;
    least = std::min(least, result.stiffness);
    largest = std::max(largest, result.stiffness);
  }
  ASSERT_GT(largest, 1.1 * least);
  SoftIk ik(beam.scene, height, beam.controls, options);
  for (double fraction : {0.3, 0.7}) {
    const double wanted = least + fraction * (largest - least);
    const IkResult result = ik.solve(vec({target}), wanted);
    ASSERT_EQ(result.status, IkStatus::reached) << result.message;
    EXPECT_NEAR(result.stiffness, wanted, 0.01 * wanted);
    EXPECT_NEAR(result.achieved[0], target, 1e-4);
    expect_within_bounds(result, beam.controls);
    // The stiffness by its meaning: small forces on the tip, and how far it goes.
    Equilibrium equilibrium(*beam.scene.model);
    equilibrium.start_at_rest(beam.scene.values);
    double height_at[2];
    for (int side : {0, 1}) {
      Params p = beam.scene.values;
      for (int j : {0, 1}) p[beam.controls[static_cast<size_t>(j)].index] = result.controls[j];
      p[beam.force] = side == 0 ? -1e-3 : 1e-3;
      ASSERT_EQ(equilibrium.solve(p).status, SolveStatus::converged);
      height_at[side] = beam.up.dot(equilibrium.u());
    }
    EXPECT_NEAR(2e-3 / (height_at[1] - height_at[0]), result.stiffness, 1e-4 * result.stiffness);
  }
  const IkResult beyond = ik.solve(vec({target}), 3 * largest);
  EXPECT_EQ(beyond.status, IkStatus::unreachable) << beyond.message;
  EXPECT_NE(beyond.message.find("N/m instead of"), std::string::npos) << beyond.message;
}

TEST(SoftIk, TheSlopesOfAStiffnessAreThoseOfEquilibriaSolvedAgain) {
  for (double smoothing : {0.01, 2e-6}) {
    const PulledBeam beam = soft_beam(smoothing);
    Equilibrium equilibrium(*beam.scene.model);
    equilibrium.start_at_rest(beam.scene.values);
    Params p = beam.scene.values;
    p[beam.controls[0].index] = 0.003;
    p[beam.controls[1].index] = 0.007;
    p[beam.force] = 0.05;
    ASSERT_EQ(equilibrium.solve(p).status, SolveStatus::converged);
    const std::vector<int> indices{beam.controls[0].index, beam.controls[1].index, beam.force,
                                   beam.scene.model->parameters().index("E_foam")};
    const Eigen::VectorXd steps = vec({1e-6, 1e-6, 1e-4, 1.0});
    const Eigen::RowVectorXd slopes = log_stiffness_slopes(equilibrium, beam.up, indices, steps);
    for (size_t j = 0; j < indices.size(); ++j) {
      // Differences of orders two at two widths, extrapolated.
      const auto difference = [&](double step) {
        double k[2];
        for (int side : {0, 1}) {
          Params moved = p;
          moved[indices[j]] += side == 0 ? step : -step;
          Equilibrium other(*beam.scene.model);
          other.start_at(equilibrium.u(), p);
          EXPECT_EQ(other.solve(moved).status, SolveStatus::converged);
          k[side] = stiffness_along(other, beam.up);
        }
        return std::log(k[0] / k[1]) / (2 * step);
      };
      const double step = 20 * steps[static_cast<Eigen::Index>(j)];
      const double expected = (4 * difference(step) - difference(2 * step)) / 3;
      EXPECT_NEAR(slopes[static_cast<Eigen::Index>(j)], expected, 1e-5 * std::abs(expected)) << j << ' ' << smoothing;
    }
  }
}

TEST(SoftIk, ChannelsThatDependOnAControlDirectlyAreFollowedInFewSteps) {
  // A cable's tension changes with its retraction at fixed displacements, too; the force on the tip is the other
  // control.
  PulledBeam beam = soft_beam();
  beam.channels[0] = {beam.tension};
  beam.controls[0] = {beam.force, -1, 1, 0.0};
  const IkResult result = SoftIk(beam.scene, beam.channels, beam.controls).solve(vec({0.8, 0.002}));
  EXPECT_EQ(result.status, IkStatus::reached) << result.message;
  EXPECT_NEAR(result.achieved[0], 0.8, 1e-4);
  EXPECT_LE(result.iterations, 8);
}

TEST(SoftIk, AControlWithoutEffectStaysNominal) {
  PulledBeam beam = soft_beam();
  beam.controls.push_back({beam.idle, 0.0, 1.0, 0.25});
  SoftIk ik(beam.scene, beam.channels, beam.controls);
  const IkResult result = ik.solve(forward(beam, 0.004, 0.006));
  EXPECT_EQ(result.status, IkStatus::reached) << result.message;
  EXPECT_NEAR(result.controls[2], 0.25, 1e-12);
}

TEST(SoftIk, WithoutAnEquilibriumAtTheStartItFailsAndSaysWhy) {
  const PulledBeam beam = soft_beam();
  IkOptions options;
  options.held = beam.scene.values;
  options.held[beam.force] = -1e4;
  options.restarts = 0;
  options.equilibrium.max_iterations = 10;
  options.equilibrium.max_total_iterations = 20;
  const IkResult result = SoftIk(beam.scene, beam.channels, beam.controls, options).solve(vec({0, 0}));
  EXPECT_EQ(result.status, IkStatus::failed);
  EXPECT_NE(result.message.find("no equilibrium was found where the search starts: load step limit"), std::string::npos)
      << result.message;
  EXPECT_EQ(result.controls.size(), 0);
}

TEST(SoftIk, WrongQuestionsAreRefused) {
  const Arm arm = two_link_arm();
  SoftIk ik(arm.scene, arm.channels, arm.controls);
  expect_input_error([&] { ik.solve(vec({0.1})); }, {"1 targets", "2 channels"});
  expect_input_error([&] { ik.solve(vec({0, 0}), 100.0); }, {"stiffness", "direction"});
  std::vector<IkControl> wrong = arm.controls;
  wrong[1].nominal = 3;
  expect_input_error([&] { SoftIk(arm.scene, arm.channels, wrong); }, {"joint2", "-2.5", "2.5", "3", "rad"});
  expect_input_error([&] { SoftIk(arm.scene, arm.channels, {}); }, {"at least one"});
}

}  // namespace
}  // namespace taut
