#include "sim/terms/cable.hpp"

#include <fstream>
#include <nlohmann/json.hpp>

#include "tests/support/mesh_checks.hpp"
#include "tests/support/message.hpp"
#include "tests/support/term_battery.hpp"

namespace taut {
namespace {

using namespace test;

enum { stiffness, slack, retraction, other };
enum { held_tension, held_scale, held_other };
constexpr double k = 700;

ParameterTable cable_table() {
  ParameterTable table;
  table.declare({"k", "k", "N/m", 0, 1e9, "stiffness", true});
  table.declare({"slack", "s", "m", -1, 1, "slack", false});
  table.declare({"u", "u", "m", -1, 1, "retraction", false});
  table.declare({"other", "x", "1", -10, 10, "a number of some other term", false});
  return table;
}

Eigen::VectorXd some(int d, double a, double b, double c) {
  return d == 2 ? vec({a, b}) : vec({a, b, c});
}

/// Through an irregular body: a material point inside an element, two that share nodes with it, and a node. The first
/// one is fixed beside the body if `anchored`.
Cable cable_through(const Mesh& mesh, bool anchored, double smoothing) {
  const int d = mesh.dimension();
  Cable cable;
  cable.stiffness = stiffness;
  cable.slack = slack;
  cable.retraction = retraction;
  cable.smoothing = smoothing;
  if (anchored) cable.points.push_back({{}, some(d, -0.05, 0.02, 0.01)});
  for (const Eigen::VectorXd& at : {some(d, 0.03, 0.03, 0.03), some(d, 0.05, 0.035, 0.03), some(d, 0.13, 0.06, 0.05)})
    cable.points.push_back({locate(mesh, at), {}});
  cable.points.push_back({{{mesh.select("xmax").entities[0]}, {1.0}}, {}});
  return cable;
}

/// The cable in a strained body, its parameters such that e is `elongation`.
TermUnderTest cable_case(ElementShape shape, double elongation, double smoothing, bool anchored = true) {
  Mesh mesh = irregular_mesh(shape);
  const Cable cable = cable_through(mesh, anchored, smoothing);
  const Eigen::VectorXd u = random_state(mesh, 0.1, 0.01, 5), none = Eigen::VectorXd::Zero(u.size());
  const auto length = make_cable_length(mesh, cable);
  Params p(4);
  p << k, 0.004, 0, 1;
  p[retraction] = elongation + p[slack] - (length->value({u, p}) - length->value({none, p}));
  auto term = make_cable(mesh, cable);
  return term_under_test(std::move(mesh), cable_table(), std::move(term), p, u,
                         std::string(name_of(shape)) + ", e = " + std::to_string(elongation));
}

template <class Action>
void for_each_taut_cable(bool anchored, Action&& action) {
  for (ElementShape shape : all_shapes) {
    for (double smoothing : {0.0, 2e-6}) action(cable_case(shape, 0.03, smoothing, anchored), smoothing);
    action(cable_case(shape, 0.01, 0.2, anchored), 0.2);  // in the transition
  }
}

TEST(Cable, GradientAndHessianAreTheDerivativesOfTheEnergyInTheTransitionAndTaut) {
  for_each_taut_cable(true, [](const TermUnderTest& t, double) { expect_derivatives(t, 3e-4); });
}

TEST(Cable, ParameterDerivativesAreThoseOfTheGradient) {
  for_each_taut_cable(true, [](const TermUnderTest& t, double) {
    expect_parameter_derivatives(t, 0.05);
    for (int index : {stiffness, slack, retraction})
      EXPECT_GT(t.model.parameter_gradient({t.u, t.p}, index).norm(), 0.0) << t.name;
    EXPECT_EQ(t.model.parameter_gradient({t.u, t.p}, other).norm(), 0.0) << "a parameter of another term";
  });
}

TEST(Cable, HessianIsSymmetricAndPositiveSemiDefiniteAsItIs) {
  for_each_taut_cable(true, [](const TermUnderTest& t, double) {
    expect_symmetric_hessian(t);
    expect_projection_is_semidefinite(t);
    EXPECT_EQ((hessian_of(t.model, t.u, t.p) - hessian_of(t.model, t.u, t.p, Curvature::projected)).norm(), 0.0);
  });
}

TEST(Cable, WithoutAFixedPointExertsNoNetForceOrMoment) {
  for_each_taut_cable(false, [](const TermUnderTest& t, double) { expect_no_net_force_or_moment(t); });
}

TEST(Cable, ASlackCableStoresNoEnergyAndExertsNoForce) {
  for (ElementShape shape : all_shapes) {
    for (double smoothing : {0.0, 2e-6, 0.02}) {
      const TermUnderTest t = cable_case(shape, -0.011, smoothing);
      EXPECT_EQ(energy_of(t.model, t.u, t.p), 0.0) << t.name;
      EXPECT_EQ(gradient_of(t.model, t.u, t.p).norm(), 0.0) << t.name;
      EXPECT_EQ(hessian_of(t.model, t.u, t.p).norm(), 0.0) << t.name;
      for (int index : {stiffness, slack, retraction})
        EXPECT_EQ(t.model.parameter_gradient({t.u, t.p}, index).norm(), 0.0) << t.name;
    }
  }
}

/// Tension and energy of a cable between two fixed points and a node, by its elongation at rest of the body.
std::pair<double, double> tension_and_energy(double elongation, double smoothing) {
  const Mesh mesh = rectangle({0, 1}, {0, 1}, 1, "body");
  Cable cable;
  cable.points = {{{{0}, {1.0}}, {}}, {{}, vec({-3, 0})}};
  cable.stiffness = stiffness;
  cable.retraction = retraction;
  cable.smoothing = smoothing;
  const Eigen::VectorXd u = Eigen::VectorXd::Zero(mesh.X.size());
  const Params p = Eigen::Vector3d(k, 0, elongation);
  Assembly out;
  make_cable(mesh, cable)->assemble({u, p}, out);
  return {make_cable_tension(mesh, cable)->value({u, p}), out.energy};
}

TEST(Cable, TautTensionIsStiffnessTimesElongationExactlyBeyondTheTransition) {
  for (double smoothing : {0.0, 2e-6, 1e-3}) {
    for (double e : {0.5e-3, 0.6e-3, 2e-3, 0.05, 1.0}) {
      const auto [tension, energy] = tension_and_energy(e, smoothing);
      EXPECT_EQ(tension, k * e);
      EXPECT_NEAR(energy, k * e * e / 2 + k * smoothing * smoothing / 24, 1e-15 * energy);
    }
  }
}

TEST(Cable, TransitionIsCentredOnZeroAndTwiceContinuouslyDifferentiable) {
  const double eps = 1e-3;
  const auto [tension, energy] = tension_and_energy(0, eps);
  EXPECT_NEAR(tension, k * eps / 8, 1e-15);
  EXPECT_NEAR(energy, k * eps * eps / 48, 1e-18);
  // Across both ends a step of 2 h changes value, slope and curvature by what a C2 function may.
  const double h = 1e-9;
  for (double end : {-eps / 2, eps / 2}) {
    const auto below = tension_and_energy(end - h, eps), above = tension_and_energy(end + h, eps);
    const double rate = end > 0 ? k : 0;
    EXPECT_NEAR(above.second - below.second, 2 * h * (end > 0 ? k * end : 0), 4 * k * h * h);
    EXPECT_NEAR(above.first - below.first, 2 * h * rate, 2 * k * h * h / eps + 1e-13);
  }
}

TEST(Cable, SegmentsOfNoLengthHaveFiniteEnergyAndDerivatives) {
  for (ElementShape shape : all_shapes) {
    TermUnderTest t = cable_case(shape, 0.03, 2e-6);
    const Mesh& mesh = t.model.mesh();
    // All material onto the fixed point: every segment ends where it begins, and the cable is retracted all the same.
    for (int i = 0; i < mesh.node_count(); ++i) {
      t.u.segment(i * mesh.dimension(), mesh.dimension()) = some(mesh.dimension(), -0.05, 0.02, 0.01) - mesh.node(i);
    }
    t.p[retraction] = 1;
    EXPECT_TRUE(std::isfinite(energy_of(t.model, t.u, t.p))) << t.name;
    EXPECT_GT(energy_of(t.model, t.u, t.p), 0.0) << t.name;
    EXPECT_TRUE(gradient_of(t.model, t.u, t.p).allFinite()) << t.name;
    EXPECT_TRUE(hessian_of(t.model, t.u, t.p).allFinite()) << t.name;
  }
}

TEST(Cable, ElongationKeepsItsDigitsHoweverSmall) {
  const Mesh mesh = rectangle({0, 1}, {0, 1}, 1, "body");
  Cable cable;
  cable.points = {{{}, vec({-0.7, 0})}, {{{0}, {1.0}}, {}}};
  cable.stiffness = stiffness;
  cable.smoothing = 0;
  const auto tension = make_cable_tension(mesh, cable);
  for (double elongation : {1e-3, 1e-8, 1e-14, 1e-20}) {
    Eigen::VectorXd u = Eigen::VectorXd::Zero(mesh.X.size());
    u[0] = elongation;
    EXPECT_NEAR(tension->value({u, Eigen::Vector3d(k, 0, 0)}), k * elongation, 1e-15 * k * elongation);
  }
}

void expect_channel_derivatives(const Channel& channel, const TermUnderTest& t, double size) {
  std::mt19937 random(4);
  const double value = channel.value({t.u, t.p});
  const Eigen::VectorXd gradient = channel.gradient({t.u, t.p});
  const Eigen::VectorXd v = random_vector(t.u.size(), random);
  expect_taylor_order(
      [&](double h) {
        return std::abs(channel.value({t.u + h * v, t.p}) - value - h * gradient.dot(v));
      },
      2, 1e-14 * std::abs(value), size, 6, t.name);
  for (int index = 0; index < t.p.size(); ++index) {
    const double slope = channel.parameter_derivative({t.u, t.p}, index);
    expect_taylor_order(
        [&](double h) {
          Params p = t.p;
          p[index] += h;
          return std::abs(channel.value({t.u, p}) - value - h * slope);
        },
        2, 1e-14 * std::abs(value), index == stiffness ? 70 : 1e-3, 6, t.name);
  }
}

TEST(Cable, ChannelsHaveTheDerivativesOfTheirValues) {
  for_each_taut_cable(true, [](const TermUnderTest& t, double smoothing) {
    const Cable cable = cable_through(t.model.mesh(), true, smoothing);
    const auto tension = make_cable_tension(t.model.mesh(), cable);
    expect_channel_derivatives(*tension, t, 1e-3);
    expect_channel_derivatives(*make_cable_length(t.model.mesh(), cable), t, 1e-3);
    EXPECT_NE(tension->parameter_derivative({t.u, t.p}, slack), 0.0);
    EXPECT_EQ(tension->parameter_derivative({t.u, t.p}, other), 0.0);
  });
  const TermUnderTest t = cable_case(ElementShape::tri6, -0.01, 2e-6);
  const auto tension = make_cable_tension(t.model.mesh(), cable_through(t.model.mesh(), true, 2e-6));
  EXPECT_EQ(tension->value({t.u, t.p}), 0.0);
  EXPECT_EQ(tension->gradient({t.u, t.p}).norm(), 0.0);
  EXPECT_EQ(tension->parameter_derivative({t.u, t.p}, slack), 0.0);
}

TEST(Cable, AShareScalesEnergyAndAllItsDerivativesButNotTheTension) {
  for (ElementShape shape : all_shapes) {
    const TermUnderTest whole = cable_case(shape, 0.03, 2e-6);
    Cable cable = cable_through(whole.model.mesh(), true, 2e-6);
    const double tension = make_cable_tension(whole.model.mesh(), cable)->value({whole.u, whole.p});
    cable.share = 0.5;
    EXPECT_EQ(make_cable_tension(whole.model.mesh(), cable)->value({whole.u, whole.p}), tension);
    const TermUnderTest half =
        term_under_test(irregular_mesh(shape), cable_table(), make_cable(whole.model.mesh(), cable), whole.p, whole.u,
                        whole.name + ", half");
    expect_derivatives(half, 3e-4);
    expect_parameter_derivatives(half, 0.05);
    const auto expect_half = [](const auto& a, const auto& b) { EXPECT_LT((a - 0.5 * b).norm(), 1e-14 * b.norm()); };
    EXPECT_NEAR(energy_of(half.model, half.u, half.p), 0.5 * energy_of(whole.model, whole.u, whole.p),
                1e-14 * energy_of(whole.model, whole.u, whole.p));
    expect_half(gradient_of(half.model, half.u, half.p), gradient_of(whole.model, whole.u, whole.p));
    expect_half(hessian_of(half.model, half.u, half.p), hessian_of(whole.model, whole.u, whole.p));
    for (int index : {stiffness, slack, retraction}) {
      expect_half(half.model.parameter_gradient({half.u, half.p}, index),
                  whole.model.parameter_gradient({whole.u, whole.p}, index));
    }
  }
}

TEST(Cable, WrongPathsAreRefused) {
  const Mesh mesh = irregular_mesh(ElementShape::tri3);
  const auto expect = [&](std::vector<CablePoint> points, double smoothing, const std::vector<std::string>& parts) {
    Cable cable;
    cable.points = std::move(points);
    cable.stiffness = stiffness;
    cable.smoothing = smoothing;
    expect_input_error([&] { make_cable(mesh, cable); }, parts);
    expect_input_error([&] { make_cable_length(mesh, cable); }, parts);
    expect_input_error([&] { make_cable_tension(mesh, cable); }, parts);
    cable.tension = held_tension;
    expect_input_error([&] { make_held_cable(mesh, cable); }, parts);
  };
  const CablePoint node{{{0}, {1.0}}, {}}, fixed{{}, vec({1, 1})};
  expect({}, 0, {"0 points", "at least two"});
  expect({node}, 0, {"1 point;", "at least two"});
  expect({fixed, fixed}, 0, {"fixed points only", "material point"});
  expect({node, {{}, vec({1, 1, 1})}}, 0, {"3 coordinates", "2 finite numbers"});
  expect({node, node}, 0, {"no length"});
  expect({node, fixed}, -1e-6, {"smoothing", "0 (none) or positive"});
}

/// The same path pulled with a tension that is held, made of one or two parameters, in a strained body.
TermUnderTest held_case(const Cable& cable, const Mesh& mesh, double tension, const std::string& name) {
  ParameterTable table;
  table.declare({"T", "T", "N", -1e9, 1e9, "tension", false});
  table.declare({"scale", "c", "1", 0, 10, "factor", false});
  table.declare({"other", "x", "1", -10, 10, "a number of some other term", false});
  return {Model(mesh, std::move(table), make_held_cable(mesh, cable), {}), Eigen::Vector3d(tension, 1.7, 1),
          random_state(mesh, 0.1, 0.01, 5), name};
}

Cable held_through(const Mesh& mesh, bool anchored, bool scaled) {
  Cable cable = cable_through(mesh, anchored, 2e-6);
  cable.stiffness = cable.slack = cable.retraction = -1;
  cable.tension = held_tension;
  if (scaled) cable.tension_scale = held_scale;
  cable.per_control = 2.5;
  return cable;
}

template <class Action>
void for_each_held_cable(bool anchored, Action&& action) {
  for (ElementShape shape : all_shapes) {
    const Mesh mesh = irregular_mesh(shape);
    for (bool scaled : {false, true}) {
      for (double tension : {3.0, -2.0}) {
        const Cable cable = held_through(mesh, anchored, scaled);
        action(held_case(cable, mesh, tension, std::string(name_of(shape)) + ", T = " + std::to_string(tension)),
               cable);
      }
    }
  }
}

TEST(HeldCable, GradientAndHessianAreTheDerivativesOfTheEnergyWhateverTheSignOfTheTension) {
  for_each_held_cable(true, [](const TermUnderTest& t, const Cable&) {
    expect_derivatives(t, 3e-4);
    expect_symmetric_hessian(t);
    expect_projection_is_semidefinite(t);
  });
}

TEST(HeldCable, EnergyIsTensionTimesElongation) {
  for_each_held_cable(true, [](const TermUnderTest& t, const Cable& cable) {
    const Mesh& mesh = t.model.mesh();
    const double tension = 2.5 * t.p[held_tension] * (cable.tension_scale >= 0 ? t.p[held_scale] : 1);
    const Eigen::VectorXd rest = Eigen::VectorXd::Zero(t.u.size());
    const auto length = make_cable_length(mesh, cable);
    const double elongation = length->value({t.u, t.p}) - length->value({rest, t.p});
    EXPECT_NEAR(energy_of(t.model, t.u, t.p), tension * elongation, 1e-13 * std::abs(tension * elongation)) << t.name;
    EXPECT_EQ(make_cable_tension(mesh, cable)->value({t.u, t.p}), tension) << t.name;
  });
}

TEST(HeldCable, ParameterDerivativesAreThoseOfTheGradient) {
  for_each_held_cable(true, [](const TermUnderTest& t, const Cable& cable) {
    expect_parameter_derivatives(t, 0.05);
    EXPECT_GT(t.model.parameter_gradient({t.u, t.p}, held_tension).norm(), 0.0) << t.name;
    EXPECT_EQ(t.model.parameter_gradient({t.u, t.p}, held_scale).norm() > 0, cable.tension_scale >= 0) << t.name;
    EXPECT_EQ(t.model.parameter_gradient({t.u, t.p}, held_other).norm(), 0.0) << t.name;
    expect_channel_derivatives(*make_cable_tension(t.model.mesh(), cable), t, 1e-3);
    expect_channel_derivatives(*make_cable_length(t.model.mesh(), cable), t, 1e-3);
  });
}

TEST(HeldCable, WithoutAFixedPointExertsNoNetForceOrMoment) {
  for_each_held_cable(false, [](const TermUnderTest& t, const Cable&) { expect_no_net_force_or_moment(t); });
}

TEST(HeldCable, CliquesAreThoseOfSegmentsWithMaterialPoints) {
  const Mesh mesh = rectangle({0, 1, 2, 3}, {0, 1}, 1, "body");
  Cable cable;
  cable.tension = held_tension;
  cable.points = {{{}, vec({-2, 0})}, {{}, vec({-1, 0})}};
  for (int node : {0, 1, 2}) cable.points.push_back({{{node}, {1.0}}, {}});
  cable.points.push_back(cable.points.back());  // a segment without length
  const auto terms = make_held_cable(mesh, cable);
  ASSERT_EQ(terms.size(), 4u) << "none between the two fixed points";
  const std::vector<int> nodes[] = {{0}, {0, 1}, {1, 2}, {2}};
  for (size_t i = 0; i < terms.size(); ++i) EXPECT_EQ(terms[i]->cliques().nodes, nodes[i]);
}

TEST(HeldCable, AShareScalesTheEnergyButNotTheTension) {
  const Mesh mesh = irregular_mesh(ElementShape::tet10);
  Cable cable = held_through(mesh, true, true);
  const TermUnderTest whole = held_case(cable, mesh, 3, "whole");
  cable.share = 0.5;
  const TermUnderTest half = held_case(cable, mesh, 3, "half");
  EXPECT_DOUBLE_EQ(energy_of(half.model, half.u, half.p), 0.5 * energy_of(whole.model, whole.u, whole.p));
  EXPECT_EQ(make_cable_tension(mesh, cable)->value({half.u, half.p}), 2.5 * 1.7 * 3);
}

/// A small plane module with two cables, its equilibria computed by an independent program.
TEST(Cable, LengthsTensionsAndEnergiesOfTheSmallModuleAreThoseOfAnIndependentProgram) {
  std::ifstream file(TAUT_SOURCE_DIR "/tests/verification/small_module_P1.json");
  const nlohmann::json reference = nlohmann::json::parse(file);
  Mesh mesh;
  mesh.shape = ElementShape::tri3;
  const auto& vertices = reference["mesh"]["vertices"];
  mesh.X.resize(2 * static_cast<Eigen::Index>(vertices.size()));
  for (size_t i = 0; i < vertices.size(); ++i) mesh.X.segment<2>(2 * i) << vertices[i][0], vertices[i][1];
  for (const auto& triangle : reference["mesh"]["triangles"])
    mesh.elements.insert(mesh.elements.end(), triangle.begin(), triangle.end());
  mesh.region.assign(reference["mesh"]["triangles"].size(), 0);
  mesh.region_names = {"body"};

  std::vector<Cable> cables;
  for (const auto& entry : reference["cables"]) {
    Cable& cable = cables.emplace_back();
    for (const auto& via : entry["via"]) {
      CablePoint point{{via["nodes"].get<std::vector<int>>(), via["weights"].get<std::vector<double>>()}, {}};
      if (point.material.nodes.empty()) point.fixed = vec({via["rest_xy"][0], via["rest_xy"][1]});
      cable.points.push_back(point);
    }
    cable.stiffness = stiffness;
    cable.slack = slack;
    cable.retraction = retraction;
    cable.smoothing = 0;
  }
  int compared = 0;
  for (const auto& solution : reference["solutions"]) {
    if (!solution.contains("cable_tension")) continue;
    Eigen::VectorXd u(mesh.X.size());
    for (size_t i = 0; i < vertices.size(); ++i) u.segment<2>(2 * i) << solution["x"][i][0], solution["x"][i][1];
    u -= mesh.X;
    double energy = 0;
    for (size_t c = 0; c < cables.size(); ++c) {
      const Params p =
          Eigen::Vector3d(reference["cables"][c]["k"], reference["cables"][c]["slack"], solution["u_cable"]);
      const double length = solution["cable_length"][c], tension = solution["cable_tension"][c];
      EXPECT_NEAR(make_cable_length(mesh, cables[c])->value({u, p}), length, 1e-10 * length);
      EXPECT_NEAR(make_cable_tension(mesh, cables[c])->value({u, p}), tension, 1e-10 * tension);
      Assembly out;
      make_cable(mesh, cables[c])->assemble({u, p}, out);
      energy += out.energy;
      ++compared;
    }
    const double expected = solution["parts"]["cable"];
    EXPECT_NEAR(energy, expected, 1e-10 * expected) << solution["name"];
  }
  EXPECT_EQ(compared, 12);
}

}  // namespace
}  // namespace taut
