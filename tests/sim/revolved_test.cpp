#include "sim/shapes/revolved.hpp"

#include <Eigen/LU>
#include <cmath>

#include "sim/files/geometry_file.hpp"
#include "sim/mesh/shape_functions.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/scene/scene.hpp"
#include "sim/shapes/grid.hpp"
#include "sim/solve/equilibrium.hpp"
#include "tests/support/experiment_files.hpp"
#include "tests/support/mesh_checks.hpp"
#include "tests/support/message.hpp"
#include "tests/support/taylor.hpp"

namespace taut {
namespace {

using namespace test;

Revolved round_body(std::vector<double> s, std::vector<double> radius, std::vector<double> bore = {},
                    const std::string& along = "x") {
  Revolved body;
  body.s.values = std::move(s);
  body.radius.values = std::move(radius);
  body.bore.values = std::move(bore);
  body.along = along;
  body.region = "body";
  return body;
}

Mesh mesh_of(const Revolved& body, int layers, int rings, int order) {
  MeshSettings settings;
  settings.counts = {{"layers", layers}, {"rings", rings}};
  settings.order = order;
  return body.mesh(settings, false, false);
}

/// The integral of f over the mesh, curved as it is: Gauss's rule with 4 points on a cube that is folded to the
/// tetrahedron, exact to degree 5 at least.
template <ElementShape S, class Function>
double integral_in(const Mesh& mesh, Function&& f) {
  const double x[4] = {-0.8611363115940526, -0.3399810435848563, 0.3399810435848563, 0.8611363115940526};
  const double w[4] = {0.3478548451374538, 0.6521451548625461, 0.6521451548625461, 0.3478548451374538};
  double sum = 0;
  for (int e = 0; e < mesh.element_count(); ++e) {
    const auto X = ReferenceElement<S>::positions(mesh, e);
    for (int i = 0; i < 4; ++i) {
      for (int j = 0; j < 4; ++j) {
        for (int k = 0; k < 4; ++k) {
          const double a = 0.5 + 0.5 * x[i], b = 0.5 + 0.5 * x[j], c = 0.5 + 0.5 * x[k];
          const Eigen::Vector3d xi(a, b * (1 - a), c * (1 - a) * (1 - b));
          const double weight = w[i] * w[j] * w[k] / 8 * (1 - a) * (1 - a) * (1 - b);
          const double volume = (X * ReferenceElement<S>::gradients(xi).transpose()).determinant();
          sum += weight * volume * f(Eigen::Vector3d(X * ReferenceElement<S>::values(xi)));
        }
      }
    }
  }
  return sum;
}

template <class Function>
double integral(const Mesh& mesh, Function&& f) {
  return order_of(mesh.shape) == 1 ? integral_in<ElementShape::tet4>(mesh, f)
                                   : integral_in<ElementShape::tet10>(mesh, f);
}

/// Of a frustum of a cone: the integrals of r^2 M_PI and r^4 M_PI / 4 along it.
double volume_of(double length, double a, double b) {
  return M_PI * length / 3 * (a * a + a * b + b * b);
}
double moment_of(double length, double a, double b) {
  return M_PI / 20 * length *
         (std::pow(a, 4) + std::pow(a, 3) * b + a * a * b * b + a * std::pow(b, 3) + std::pow(b, 4));
}

struct RoundBody {
  Revolved shape;
  double volume, moment;
  std::string name;
};
const std::vector<RoundBody>& round_bodies() {
  static const std::vector<RoundBody> list{
      {round_body({0, 0.1}, {0.01, 0.01}), volume_of(0.1, 0.01, 0.01), moment_of(0.1, 0.01, 0.01), "cylinder"},
      {round_body({0, 0.1}, {0.015, 0.006}), volume_of(0.1, 0.015, 0.006), moment_of(0.1, 0.015, 0.006), "frustum"},
      {round_body({0, 0.06, 0.1}, {0.015, 0.006, 0.005}), volume_of(0.06, 0.015, 0.006) + volume_of(0.04, 0.006, 0.005),
       moment_of(0.06, 0.015, 0.006) + moment_of(0.04, 0.006, 0.005), "two tapers"},
      {round_body({0, 0.1}, {0.01, 0.01}, {0.009}), volume_of(0.1, 0.01, 0.01) - volume_of(0.1, 0.009, 0.009),
       moment_of(0.1, 0.01, 0.01) - moment_of(0.1, 0.009, 0.009), "tube"},
      {round_body({0, 0.1}, {0.015, 0.006}, {0.002, 0.005}),
       volume_of(0.1, 0.015, 0.006) - volume_of(0.1, 0.002, 0.005),
       moment_of(0.1, 0.015, 0.006) - moment_of(0.1, 0.002, 0.005), "tube of changing wall"}};
  return list;
}

TEST(Revolved, LinearElementsHaveTheVolumeOfTheRoundBody) {
  for (const RoundBody& body : round_bodies()) {
    for (int rings : {1, 3}) {
      const Mesh mesh = mesh_of(body.shape, 4, rings, 1);
      EXPECT_NEAR(total_measure(mesh), body.volume, 1e-12 * body.volume) << body.name;
      double outer = 0;
      for (const auto& [name, tag] : mesh.tags) outer += size_of(mesh, tag);
      expect_conforming(mesh, outer);
    }
  }
}

TEST(Revolved, VolumeAndSecondMomentsOfQuadraticElementsConvergeToThoseOfTheRoundBody) {
  for (const RoundBody& body : round_bodies()) {
    double before[3] = {};
    for (int rings : {1, 2, 4}) {
      const Mesh mesh = mesh_of(body.shape, 4 * rings, rings, 2);
      const double off[3] = {integral(mesh, [](const Eigen::Vector3d&) { return 1.0; }) / body.volume - 1,
                             integral(mesh, [](const Eigen::Vector3d& x) { return x[1] * x[1]; }) / body.moment - 1,
                             integral(mesh, [](const Eigen::Vector3d& x) { return x[2] * x[2]; }) / body.moment - 1};
      for (int k = 0; k < 3; ++k) {
        if (rings > 1) {
          EXPECT_LT(std::abs(off[k]), std::abs(before[k]) / 12) << body.name << ", " << rings << " rings, " << k;
        }
        before[k] = off[k];
      }
    }
    for (double off : before) EXPECT_LT(std::abs(off), 3e-5) << body.name;
  }
}

TEST(Revolved, BoundaryNodesOfQuadraticElementsAreOnTheRoundSurface) {
  for (const RoundBody& body : round_bodies()) {
    const Mesh mesh = mesh_of(body.shape, 5, 2, 2);
    const auto distance = [&](int node) { return std::hypot(mesh.node(node)[1], mesh.node(node)[2]); };
    for (int node : mesh.tags.at("side").nodes())
      EXPECT_NEAR(distance(node), body.shape.radius_at(mesh.node(node)[0]), 1e-16) << body.name;
    for (int node : mesh.tags.at("base").nodes()) EXPECT_EQ(mesh.node(node)[0], 0);
    for (int node : mesh.tags.at("tip").nodes()) EXPECT_EQ(mesh.node(node)[0], 0.1);
    EXPECT_EQ(mesh.tags.count("bore"), body.shape.hollow() ? 1u : 0u);
    if (!body.shape.hollow()) continue;
    for (int node : mesh.tags.at("bore").nodes())
      EXPECT_NEAR(distance(node), body.shape.bore_at(mesh.node(node)[0]), 1e-16) << body.name;
  }
}

TEST(Revolved, LayersEndAtTheOutlinesPoints) {
  const Mesh mesh = mesh_of(round_body({0, 0.01, 0.1}, {0.02, 0.01, 0.01}), 4, 1, 1);
  std::vector<double> s;
  for (int i = 0; i < mesh.node_count(); ++i) s.push_back(mesh.node(i)[0]);
  std::sort(s.begin(), s.end());
  s.erase(std::unique(s.begin(), s.end()), s.end());
  ASSERT_EQ(s.size(), 6u) << "one layer in the short span, and four in the long one";
  EXPECT_EQ(s[1], 0.01);
  EXPECT_NEAR(s[2], 0.01 + 0.09 / 4, 1e-15);
}

TEST(Revolved, RunsAlongEachAxisForwardsAndBackwards) {
  for (const std::string along : {"x", "-x", "y", "-y", "z", "-z"}) {
    const Revolved body = round_body({0, 0.1}, {0.015, 0.006}, {}, along);
    const BodyAxis axis = *body.axis();
    const int component = along.back() - 'x';
    EXPECT_EQ(axis.along[component], along.size() == 1 ? 1 : -1);
    EXPECT_EQ(axis.first[(component + 1) % 3], 1);
    EXPECT_EQ(axis.second[(component + 2) % 3], 1);
    EXPECT_EQ(body.extent()[static_cast<size_t>(component)], 0.1);
    for (int order : {1, 2}) {
      const Mesh mesh = mesh_of(body, 3, 2, order);
      EXPECT_GT(total_measure(mesh), 0.9 * volume_of(0.1, 0.015, 0.006)) << along;
      for (int node : mesh.tags.at("tip").nodes()) EXPECT_NEAR(axis.along.dot(mesh.node(node)), 0.1, 1e-16) << along;
    }
  }
}

TEST(Revolved, SectionsOfItsAxisAreThoseOfARing) {
  const BodyAxis axis = *round_body({0, 0.1, 0.3}, {0.02, 0.01, 0.01}, {0.004}).axis();
  EXPECT_EQ(axis.length, 0.3);
  for (const auto& [s, outer] : {std::pair{0.0, 0.02}, {0.05, 0.015}, {0.1, 0.01}, {0.2, 0.01}, {0.3, 0.01}}) {
    const CrossSection section = axis.section(s);
    const double moment = M_PI / 4 * (std::pow(outer, 4) - std::pow(0.004, 4));
    EXPECT_NEAR(section.area, M_PI * (outer * outer - 0.004 * 0.004), 1e-15);
    EXPECT_NEAR(section.first, moment, 1e-12 * moment);
    EXPECT_NEAR(section.second, moment, 1e-12 * moment);
    EXPECT_NEAR(section.torsion, 2 * moment, 1e-12 * moment);
  }
}

TEST(BodyAxis, PointsAndOffsetsGoFromTheFirstDirectionToTheSecond) {
  const BodyAxis axis = coordinate_axis(Eigen::Vector3d(1, 2, 3), 1, false, 5);
  const auto expect = [](const Eigen::VectorXd& is, const Eigen::Vector3d& should) {
    EXPECT_LT((is - should).norm(), 1e-15) << is.transpose();
  };
  expect(axis.along, {0, -1, 0});
  expect(axis.point(0.5, 2, 0), {1, 1.5, 5});
  expect(axis.point(0.5, 2, M_PI / 2), {3, 1.5, 3});
  expect(axis.offset(2, M_PI, 0.25), {0, -0.25, -2});
  const BodyAxis plane = coordinate_axis(Eigen::Vector2d(1, 2), 0, true, 5);
  EXPECT_LT((plane.point(1, 0.5, 0) - Eigen::Vector2d(2, 2.5)).norm(), 1e-15);
  EXPECT_LT((plane.point(1, 0.5, M_PI) - Eigen::Vector2d(2, 1.5)).norm(), 1e-15);
}

/// S. Timoshenko and J. N. Goodier, Theory of Elasticity, table of k1 in art. 109: J = k1 a b^3.
TEST(BodyAxis, TorsionOfRectanglesIsThatOfTheTable) {
  const std::pair<double, double> table[] = {{1, 0.1406}, {1.2, 0.166}, {1.5, 0.196}, {2, 0.229},
                                             {3, 0.263},  {5, 0.291},   {10, 0.312}};
  for (const auto& [ratio, k1] : table) {
    EXPECT_NEAR(torsion_of_rectangle(ratio, 1), k1 * ratio, 5.1e-4 * ratio) << ratio;
    EXPECT_DOUBLE_EQ(torsion_of_rectangle(1, ratio), torsion_of_rectangle(ratio, 1));
  }
  EXPECT_NEAR(torsion_of_rectangle(1, 1e6), 1e6 / 3, 0.22) << "b^3 (a - 0.63 b) / 3";
  Box box;
  box.size = {0.3, 0.02, 0.01};
  box.origin = {1, 2, 3};
  const BodyAxis axis = *box.axis();
  EXPECT_LT((axis.point(0.1, 0, 0) - Eigen::Vector3d(1.1, 2.01, 3.005)).norm(), 1e-15);
  const CrossSection section = axis.section(0);
  EXPECT_NEAR(section.area, 2e-4, 1e-18);
  EXPECT_NEAR(section.first, 0.02 * 1e-6 / 12, 1e-20) << "about y: heights along z";
  EXPECT_NEAR(section.second, 0.01 * 8e-6 / 12, 1e-20);
  EXPECT_NEAR(section.torsion, 0.229 * 0.02 * 1e-6, 5e-4 * 0.02 * 1e-6);
}

/// Of a cantilever under a small load on its end, over that of a beam: P L^3 / 3 E I and, sheared, P L / (k G A) with
/// the factor of a ring of radii r and R, m = r / R (G. R. Cowper 1966): k = 6 (1 + nu) (1 + m^2)^2 / ((7 + 6 nu) (1 +
/// m^2)^2 + (20 + 12 nu) m^2). With nu = 0 the clamp changes nothing.
double deflection_over_beams(int layers, int rings, int order, const std::vector<double>& bore) {
  constexpr double L = 0.2, R = 0.01, E = 1e6, nu = 0, P = 1e-5;
  SceneBuilder builder(mesh_of(round_body({0, L}, {R, R}, bore), layers, rings, order));
  builder.add_solid("body", "neo_hookean", {{"E", E}, {"nu", nu}});
  builder.fix("base", {0, 1, 2});
  builder.add_force("tip", Eigen::Vector3d(0, 3, 4), builder.declare({"P", "P", "N", -1, 1, "force"}, P));
  const Scene scene = builder.build();
  Equilibrium equilibrium(*scene.model);
  equilibrium.start_at_rest(scene.values);
  EXPECT_EQ(equilibrium.solve(scene.values).status, SolveStatus::converged);
  const Mesh& mesh = scene.model->mesh();
  const double tip = mean_weights(mesh, mesh.select("tip"), Eigen::Vector3d(0, 3, 4)).dot(equilibrium.u());
  const double r = bore.empty() ? 0 : bore[0];
  const double area = M_PI * (R * R - r * r), moment = M_PI / 4 * (std::pow(R, 4) - std::pow(r, 4));
  const double m = std::pow(1 + r * r / (R * R), 2), G = E / (2 * (1 + nu));
  const double k = 6 * (1 + nu) * m / ((7 + 6 * nu) * m + (20 + 12 * nu) * r * r / (R * R));
  return tip / (P * L * L * L / (3 * E * moment) + P * L / (k * G * area));
}

TEST(Revolved, BendingOfASlenderCylinderConvergesToThatOfABeam) {
  const double coarse = deflection_over_beams(10, 1, 2, {}), fine = deflection_over_beams(20, 2, 2, {});
  const double linear = deflection_over_beams(20, 2, 1, {}), finer = deflection_over_beams(40, 4, 1, {});
  const double tube = deflection_over_beams(20, 1, 2, {0.008});
  EXPECT_NEAR(coarse, 1, 0.01);
  EXPECT_NEAR(fine, 1, 5e-4);
  EXPECT_LT(std::abs(fine - 1), std::abs(coarse - 1) / 2);
  EXPECT_LT(linear, finer);
  EXPECT_LT(finer, 1) << "linear elements are too stiff";
  EXPECT_NEAR(tube, 1, 5e-4);
}

TEST(Revolved, KeysThatMakeNoBodyAreRefused) {
  const auto expect = [](Revolved body, const std::vector<std::string>& parts) {
    expect_input_error([&] { body.check(); }, parts);
    expect_input_error([&] { mesh_of(body, 4, 1, 2); }, parts);
  };
  expect(round_body({0}, {0.01}), {"1 of at least 2 places"});
  expect(round_body({0.01, 0.1}, {0.01, 0.01}), {"s begins at 10 mm", "first place is 0"});
  expect(round_body({0, 0.1, 0.1}, {0.01, 0.01, 0.01}), {"100 mm to 100 mm", "increase"});
  expect(round_body({0, 0.1}, {0.01}), {"1 radii for 2 places"});
  expect(round_body({0, 0.1}, {0.01, 0}), {"radius is 0 mm", "positive"});
  expect(round_body({0, 0.1}, {0.01, 0.01}, {0.001, 0.001, 0.001}), {"3 bores for 2 places", "one of all"});
  expect(round_body({0, 0.1}, {0.01, 0.01}, {0.005, 0}), {"bore is 0 mm", "left out"});
  expect(round_body({0, 0.1}, {0.02, 0.01}, {0.01}), {"bore 10 mm", "below radius 10 mm", "s = 100 mm"});
  expect(round_body({0, 0.1}, {0.01, 0.01}, {}, "w"), {"axis 'w'", "x, -x, y, -y, z, -z"});
  expect_input_error([] { mesh_of(round_body({0, 0.1}, {0.01, 0.01}), 4, 0, 2); }, {"rings is 0", "at least 1"});
  expect_input_error([] { mesh_of(round_body({0, 0.1}, {0.01, 0.01}), 4, 1, 3); }, {"order 3", "1 and 2"});
}

TEST(Revolved, ComesFromAFile) {
  const TemporaryFolder folder;
  const auto read = [&](const std::string& keys) {
    const std::string path =
        folder.write("body.toml", "[geometry]\nkind = \"revolved\"\nregion = \"silicone\"\n" + keys);
    return read_geometry(TomlFile(path).root().table("geometry"), path);
  };
  const GeometrySettings geometry = read(
      "s = [\"0 mm\", \"305 mm\", \"36 cm\"]\nradius = [\"15.41 mm\", \"6.42 mm\", \"4.8 mm\"]\nbore = [\"1 "
      "mm\"]\naxis = "
      "\"-z\"");
  const Revolved& body = geometry.as<Revolved>();
  EXPECT_EQ(body.s.values, (std::vector<double>{0, 0.305, 0.36}));
  EXPECT_EQ(body.radius_at(0.305), 0.00642);
  EXPECT_EQ(body.bore_at(0.2), 0.001);
  EXPECT_EQ(body.region, "silicone");
  EXPECT_EQ(body.axis()->along[2], -1);
  EXPECT_FALSE(read("s = [\"0 mm\", \"1 cm\"]\nradius = [\"2 mm\", \"2 mm\"]").as<Revolved>().hollow());
  const std::string s = "s = [\"0 mm\", \"1 cm\"]\n";
  expect_input_error([&] { read(s); }, {"body.toml", "'radius' is missing"});
  expect_input_error([&] { read(s + "radius = []"); }, {"body.toml", "radius", "list is empty"});
  expect_input_error([&] { read(s + "radius = [\"1 mm\", \"0 mm\"]"); }, {"radius", "must be positive"});
  expect_input_error([&] { read("s = [\"-1 mm\", \"1 cm\"]\nradius = [\"1 mm\", \"1 mm\"]"); }, {"s", "zero or more"});
  expect_input_error([&] { read(s + "radius = [\"1 mm\"]"); }, {"body.toml", "1 radii for 2 places"});
}

}  // namespace
}  // namespace taut
