#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "sim/contact/contact.hpp"
#include "sim/mesh/structured.hpp"
#include "sim/scene/scene.hpp"
#include "sim/solve/equilibrium.hpp"

// A foam cylinder on a rigid plane against the closed form for line contact (Hertz 1882; Johnson, Contact Mechanics,
// 1985, section 4.2): F' the force per length, R the radius, E* = E / (1 - nu^2),
//     a = sqrt(4 F' R / (pi E*)),   p0 = sqrt(F' E* / (pi R)),   p(x) = p0 sqrt(1 - (x / a)^2).
namespace taut::test {
namespace {

constexpr double radius = 0.010, E_cylinder = 5e4, nu_cylinder = 0.3, pi = std::numbers::pi;

struct Hertz {
  double force = 0;          ///< F' [N/m]
  double half_width = 0;     ///< a [m]
  double peak_pressure = 0;  ///< p0 [Pa]
  double worst = 0;          ///< largest deviation from the elliptic law below 0.8 a, relative to p0
  SolveReport report;
};

/// Which side is round and elastic, and which is rigid.
enum class Pressed { cylinder_on_plane, block_on_disc };

/// Half of a cylinder, or of a block, by symmetry. The cylinder is cut off 60 degrees from its lowest line and at its
/// axis, pressed down by `depth`. Linear elements: the nodal forces of quadratic ones alternate under an even pressure
/// (1/6 and 4/6 of an edge), while the barrier's weights are lengths.
Hertz press(double depth, double gap, int cells, Pressed which = Pressed::cylinder_on_plane) {
  Mesh mesh = rectangle(graded(1, cells, 12), graded(1, 2 * cells / 3, 60), 1, "cylinder");
  map_vertices(mesh, [which](const Eigen::VectorXd& s) -> Eigen::VectorXd {
    if (which == Pressed::block_on_disc) return radius * Eigen::Vector2d(s);
    const double angle = s[0] * pi / 3, bottom = radius * (1 - std::cos(angle));
    return Eigen::Vector2d(radius * std::sin(angle), bottom + s[1] * (radius - bottom));
  });
  const double kappa = 3000;  // about p0, which then rests half a gap above the plane
  std::vector<GroundLine> plane{{{0, -1.2 * gap}, {0, 1}}};
  if (which == Pressed::block_on_disc) plane = {{{0, -radius - 1.2 * gap}, {0, 1}, GroundKind::sphere, radius}};
  SceneBuilder builder(mesh, Plane::strain, 1.0);
  builder.add_solid("cylinder", "neo_hookean", {{"E", E_cylinder}, {"nu", nu_cylinder}});
  builder.fix("xmin", {0});
  const int control = builder.declare({"lift", "v", "m", -1, 1, "of the upper face"}, 0.0);
  builder.prescribe("ymax", 1, control);
  builder.add_contact(gap, {{"cylinder", kappa}}, {}, plane);
  ContactSettings settings;
  settings.edges = contact_edges(mesh);
  settings.stiffness.assign(settings.edges.size(), builder.parameters().index("contact_pressure_cylinder"));
  settings.gap = builder.parameters().index("contact_gap");
  settings.grounds = plane;
  const Contact contact(builder.mesh(), settings);
  const Scene scene = builder.build();

  Equilibrium equilibrium(*scene.model);
  equilibrium.start_at_rest(scene.values);
  Params p = scene.values;
  p[control] = -depth;
  Hertz result;
  result.report = equilibrium.solve(p);

  Eigen::VectorXd force = Eigen::VectorXd::Zero(scene.model->unknowns());
  Assembly out;
  out.gradient = &force;
  contact.assemble({equilibrium.u(), p}, out);
  std::vector<double> share(static_cast<size_t>(mesh.node_count()), 0.0);
  for (const auto& [a, b] : settings.edges) {
    const double half = 0.5 * (mesh.node(a) - mesh.node(b)).norm();
    share[static_cast<size_t>(a)] += half;
    share[static_cast<size_t>(b)] += half;
  }
  // p^2 = p0^2 - (p0 / a)^2 x^2: a straight line through all that carries more than 0.6 p0, x in the deformed state.
  std::vector<std::array<double, 2>> pressures;
  double peak = 0;
  for (int node : mesh.select("ymin").nodes()) {
    result.force -= 2 * force[2 * node + 1];
    const double x = mesh.X[2 * node] + equilibrium.u()[2 * node];
    if (mesh.X[2 * node] == 0) continue;  // its share of the boundary counts the plane of symmetry
    pressures.push_back({x, -force[2 * node + 1] / share[static_cast<size_t>(node)]});
    peak = std::max(peak, pressures.back()[1]);
  }
  double n = 0, sx = 0, sy = 0, sxx = 0, sxy = 0;
  for (const auto& [x, pressure] : pressures) {
    if (pressure < 0.6 * peak) continue;
    n += 1, sx += x * x, sy += pressure * pressure, sxx += std::pow(x, 4), sxy += x * x * pressure * pressure;
  }
  const double slope = (n * sxy - sx * sy) / (n * sxx - sx * sx), start = (sy - slope * sx) / n;
  result.peak_pressure = std::sqrt(start);
  result.half_width = std::sqrt(-start / slope);
  for (const auto& [x, pressure] : pressures) {
    const double inside = 1 - std::pow(x / result.half_width, 2);
    if (inside > 0.36)
      result.worst = std::max(result.worst, std::abs(pressure / result.peak_pressure - std::sqrt(inside)));
  }
  return result;
}

TEST(Hertz, HalfWidthAndPeakPressureOfACylinderOnAPlaneAreTheClosedFormWithinTwoPercent) {
  const double modulus = E_cylinder / (1 - nu_cylinder * nu_cylinder);
  for (const double depth : {60e-6, 150e-6}) {
    const Hertz found = press(depth, 1e-6, 96);
    ASSERT_EQ(found.report.status, SolveStatus::converged) << found.report.message();
    const double a = std::sqrt(4 * found.force * radius / (pi * modulus)),
                 p0 = std::sqrt(found.force * modulus / (pi * radius));
    EXPECT_NEAR(found.half_width, a, 0.02 * a);
    EXPECT_NEAR(found.peak_pressure, p0, 0.02 * p0);
    EXPECT_LT(found.worst, 0.02);
  }
}

TEST(Hertz, ARigidDiscPressesIntoABlockAsTheClosedFormSaysWithinTwoPercent) {
  const double modulus = E_cylinder / (1 - nu_cylinder * nu_cylinder);
  const Hertz found = press(100e-6, 1e-6, 96, Pressed::block_on_disc);
  ASSERT_EQ(found.report.status, SolveStatus::converged) << found.report.message();
  const double a = std::sqrt(4 * found.force * radius / (pi * modulus)),
               p0 = std::sqrt(found.force * modulus / (pi * radius));
  EXPECT_NEAR(found.half_width, a, 0.02 * a);
  EXPECT_NEAR(found.peak_pressure, p0, 0.02 * p0);
  EXPECT_LT(found.worst, 0.02);
}

}  // namespace
}  // namespace taut::test
