#include "sim/contact/contact_3d.hpp"

#include <Eigen/Geometry>
#include <numbers>
#include <set>

#include "sim/contact/contact_geometry.hpp"
#include "sim/contact/contact_geometry_3d.hpp"
#include "sim/scene/scene.hpp"
#include "sim/solve/equilibrium.hpp"
#include "tests/support/message.hpp"
#include "tests/support/term_battery.hpp"

namespace taut {
namespace {

using namespace test;
using Eigen::Vector3d;
using Triangle = std::array<Vector3d, 3>;

enum Index { soft, hard, gap, other };

ParameterTable contact_table() {
  ParameterTable table;
  for (const char* id : {"kappa_soft", "kappa_hard", "dhat", "other"})
    table.declare({id, id, "SI", 0, 1e30, id, false});
  return table;
}

Params values(double kappa_soft, double kappa_hard, double dhat) {
  Params p(4);
  p << kappa_soft, kappa_hard, dhat, 1.0;
  return p;
}

/// Triangles in space as a mesh without elements.
struct Surface {
  Mesh mesh;
  std::vector<std::array<int, 3>> triangles;

  Surface() { mesh.shape = ElementShape::tet4; }
  int nodes() const { return static_cast<int>(mesh.X.size() / 3); }
  void add(const std::vector<Vector3d>& points, const std::vector<std::array<int, 3>>& corners) {
    const int first = nodes();
    mesh.X.conservativeResize(mesh.X.size() + 3 * static_cast<Eigen::Index>(points.size()));
    for (size_t k = 0; k < points.size(); ++k)
      mesh.X.segment<3>(3 * (first + static_cast<Eigen::Index>(k))) = points[k];
    for (const auto& [a, b, c] : corners) triangles.push_back({first + a, first + b, first + c});
  }
  /// A face of (nx x ny) cells, each cut in two, spanned by `along` and `up` from `corner`; its front is along x up.
  void add_face(const Vector3d& corner, const Vector3d& along, const Vector3d& up, int nx, int ny) {
    std::vector<Vector3d> points;
    std::vector<std::array<int, 3>> corners;
    for (int j = 0; j <= ny; ++j) {
      for (int i = 0; i <= nx; ++i) {
        points.push_back(corner + along * i / nx + up * j / ny);
        if (i == nx || j == ny) continue;
        const int a = i + (nx + 1) * j, b = a + 1, d = a + nx + 1, c = d + 1;
        if ((i + j) % 2 == 0)
          corners.insert(corners.end(), {{a, b, c}, {a, c, d}});
        else
          corners.insert(corners.end(), {{a, b, d}, {b, c, d}});
      }
    }
    add(points, corners);
  }
  /// The surface of a grid of cells.
  void add_box(const Vector3d& corner, const Vector3d& size, const std::array<int, 3>& cells,
               const Eigen::Matrix3d& turn = Eigen::Matrix3d::Identity()) {
    const Mesh box = taut::box(graded(size[0], cells[0]), graded(size[1], cells[1]), graded(size[2], cells[2]), 1, "b");
    const std::vector<std::array<int, 3>> faces = contact_triangles(box);
    std::vector<Vector3d> points;
    std::vector<int> number(static_cast<size_t>(box.node_count()), -1);
    std::vector<std::array<int, 3>> corners;
    for (const std::array<int, 3>& face : faces) {
      std::array<int, 3>& own = corners.emplace_back();
      for (size_t k = 0; k < 3; ++k) {
        int& n = number[static_cast<size_t>(face[k])];
        if (n < 0) {
          n = static_cast<int>(points.size());
          points.push_back(corner + turn * Vector3d(box.node(face[k])));
        }
        own[k] = n;
      }
    }
    add(points, corners);
  }
  Contact3dSettings settings() const {
    Contact3dSettings s;
    s.triangles = triangles;
    s.stiffness.assign(triangles.size(), soft);
    s.gap = gap;
    return s;
  }
  Eigen::VectorXd rest() const { return Eigen::VectorXd::Zero(mesh.X.size()); }
};

double pressure_at(double s) {
  return 2 * (s - 1) * std::log(s) + (s - 1) * (s - 1) / s;
}

struct Evaluation {
  double energy;
  Eigen::VectorXd gradient;
  Vector3d force(int first, int last) const {
    Vector3d sum = Vector3d::Zero();
    for (int node = first; node < last; ++node) sum -= gradient.segment<3>(3 * node);
    return sum;
  }
};

Evaluation evaluate(const Surface& surface, const Contact3dSettings& settings, const Params& p,
                    const Eigen::VectorXd& u) {
  Evaluation result{0, surface.rest()};
  Assembly out;
  out.gradient = &result.gradient;
  Contact3d(surface.mesh, settings).assemble({u, p}, out);
  result.energy = out.energy;
  return result;
}

/// Two wavy faces and a tetrahedron near the upper one, triangles of about 0.5, within dhat = 0.6 of each other, of two
/// kappas; with a ground or without. Some pairs of edges are nearer than a quarter of that, some nearly parallel.
TermUnderTest contact_case(bool ground, unsigned seed) {
  std::mt19937 random(seed);
  Surface surface;
  surface.add_face({0, 0, 0}, {1.5, 0, 0}, {0, 1, 0}, 3, 2);
  surface.add_face({0.1, 0.9, 0.15}, {1.2, 0, 0}, {0, -1, 0}, 2, 2);
  surface.add({{0.3, 0.4, 0.28}, {0.8, 0.3, 0.5}, {0.2, 0.8, 0.6}, {0.3, 0.4, 0.9}},
              {{0, 2, 1}, {0, 1, 3}, {1, 2, 3}, {2, 0, 3}});
  Contact3dSettings settings = surface.settings();
  for (size_t t = 7; t < settings.stiffness.size(); ++t) settings.stiffness[t] = hard;
  if (ground) {
    settings.grounds = {{{0, 0, -0.3}, Vector3d(0.1, 0.05, 1)}};
    settings.obstacle_stiffness = seed % 2 == 0 ? hard : -1;
  }
  for (double noise = 0.03;; noise *= 0.9) {
    Eigen::VectorXd u = noise * random_vector(surface.mesh.X.size(), random);
    const Contact3d contact(surface.mesh, settings);
    if (contact.intersects(u) || contact.smallest_distance(u, 1) < 0.02) continue;
    return term_under_test(surface.mesh, contact_table(), std::make_unique<Contact3d>(surface.mesh, settings),
                           values(2.0, 3.0, 0.6), std::move(u), (ground ? "with ground " : "") + std::to_string(seed));
  }
}

template <class Action>
void for_each_contact(Action&& action, bool with_ground = true) {
  for (unsigned seed = 31; seed <= 33; ++seed) {
    action(contact_case(false, seed));
    if (with_ground) action(contact_case(true, seed));
  }
}

TEST(Contact3d, GradientAndHessianAreTheDerivativesOfTheEnergy) {
  for_each_contact([](const TermUnderTest& t) { expect_derivatives(t, 5e-5); });
}

TEST(Contact3d, ParameterDerivativesAreThoseOfTheGradient) {
  for_each_contact([](const TermUnderTest& t) {
    expect_parameter_derivatives(t, 0.001);
    EXPECT_EQ(t.model.parameter_gradient({t.u, t.p}, other).norm(), 0.0);
    for (int index : {soft, hard, gap}) EXPECT_GT(t.model.parameter_gradient({t.u, t.p}, index).norm(), 0.0);
  });
}

TEST(Contact3d, HessianIsSymmetric) {
  for_each_contact(expect_symmetric_hessian);
}

TEST(Contact3d, ProjectedHessianIsPositiveSemiDefiniteWhereTheExactOneIsNot) {
  for_each_contact([](const TermUnderTest& t) {
    const Eigen::MatrixXd exact = hessian_of(t.model, t.u, t.p);
    const Eigen::VectorXd eigenvalues = Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(exact).eigenvalues();
    EXPECT_LT(eigenvalues[0], -1e-6 * eigenvalues.cwiseAbs().maxCoeff()) << t.name << ": the state tests nothing";
    expect_projection_is_semidefinite(t);
  });
}

TEST(Contact3d, ExertsNoNetForceOrMoment) {
  for_each_contact(
      [](const TermUnderTest& t) {
        const Eigen::VectorXd f = gradient_of(t.model, t.u, t.p);
        Vector3d force = Vector3d::Zero(), moment = Vector3d::Zero();
        double scale = 0;
        for (Eigen::Index i = 0; i < f.size(); i += 3) {
          force += f.segment<3>(i);
          moment += Vector3d(t.model.mesh().X.segment<3>(i) + t.u.segment<3>(i)).cross(Vector3d(f.segment<3>(i)));
          scale += f.segment<3>(i).norm();
        }
        ASSERT_GT(scale, 0.0);
        EXPECT_LE(force.norm(), 1e-13 * scale);
        EXPECT_LE(moment.norm(), 1e-13 * scale);
      },
      false);
}

TEST(Contact3d, APairTakesTheSmallerStiffnessOfItsSides) {
  Surface surface;
  surface.add_face({0, 0, 0}, {1, 0, 0}, {0, 1, 0}, 4, 4);
  surface.add_face({1, 0, 6e-4}, {-1, 0, 0}, {0, 1, 0}, 3, 3);
  const Contact3dSettings one = surface.settings();
  Contact3dSettings two = one;
  for (size_t t = 32; t < two.stiffness.size(); ++t) two.stiffness[t] = hard;
  const auto energy = [&](const Contact3dSettings& settings, double kappa_soft, double kappa_hard) {
    return evaluate(surface, settings, values(kappa_soft, kappa_hard, 1e-3), surface.rest()).energy;
  };
  const double alone = energy(one, 2, 5);
  EXPECT_NEAR(energy(two, 2, 5), alone, 1e-14 * alone);
  EXPECT_NEAR(energy(two, 2, 1), 0.5 * alone, 1e-14 * alone);
  // A face of two kappas, seen by a node above the line where they meet: the smaller one, once.
  Surface roof;
  roof.add_face({0, 0, 0}, {2, 0, 0}, {0, 1, 0}, 2, 1);
  roof.add({{1.0, 0.4, 6e-4}, {1.3, 0.4, 0.6}, {1.0, 0.7, 0.6}}, {{0, 1, 2}});
  Contact3dSettings mixed = roof.settings();
  mixed.stiffness = {soft, soft, hard, hard, hard};
  const Params p = values(2, 5, 1e-3);
  const double weight = 0.5 / 6 * Vector3d(0.3, 0, 0.5994).cross(Vector3d(0, 0.3, 0.5994)).norm();
  EXPECT_NEAR(evaluate(roof, mixed, p, roof.rest()).energy, weight * 2 * Barrier{1e-3}.value(6e-4), 1e-13 * weight);
}

// Distances -----------------------------------------------------------------------------------------------------------

FeatureDistance distance_of(int kind, const Eigen::VectorXd& x) {
  const auto at = [&](int k) { return Vector3d(x.segment<3>(3 * k)); };
  if (kind == 0) return FeatureDistance::point_point(at(0) - at(1));
  if (kind == 1) return FeatureDistance::point_line(at(0) - at(1), at(2) - at(1));
  if (kind == 2) return FeatureDistance::point_plane(at(0) - at(1), at(2) - at(1), at(3) - at(1));
  return FeatureDistance::line_line(at(0) - at(2), at(1) - at(0), at(3) - at(2));
}

TEST(Contact3dDistance, DerivativesOfAllFeaturesAreThoseOfTheDistance) {
  std::mt19937 random(5);
  for (int kind = 0; kind < 4; ++kind) {
    for (int trial = 0; trial < 10; ++trial) {
      const Eigen::VectorXd x = random_vector(kind == 0 ? 6 : kind == 1 ? 9 : 12, random);
      const FeatureDistance d = distance_of(kind, x);
      if (d.value < 0.3 || d.tangents.col(0).cross(d.tangents.col(1)).norm() < (d.parameters == 2 ? 0.5 : 0)) continue;
      const Eigen::VectorXd v = random_vector(x.size(), random), g = d.gradient();
      const Eigen::MatrixXd H = d.hessian(1, 0), square = d.hessian(d.value, 1);
      const std::string what = "kind " + std::to_string(kind);
      expect_taylor_order(
          [&](double h) { return std::abs(distance_of(kind, x + h * v).value - d.value - h * g.dot(v)); }, 2, 1e-14,
          0.01, 6, what);
      expect_taylor_order(
          [&](double h) { return (Eigen::VectorXd(distance_of(kind, x + h * v).gradient()) - g - h * H * v).norm(); },
          2, 1e-13, 0.01, 6, what);
      EXPECT_LE((square - d.value * H - g * g.transpose()).norm(), 1e-13 * square.norm());
    }
  }
}

TEST(Contact3dDistance, TheMollifierIsOneForCrossingEdgesAndHasItsDerivatives) {
  std::mt19937 random(6);
  EXPECT_EQ(Mollifier({1, 0, 0}, {0, 1, 0}, 1e-3).value, 1);
  EXPECT_EQ(Mollifier({1, 0, 0}, {0, 1, 0}, 1e-3).first, 0);
  EXPECT_EQ(Mollifier({1, 0, 0}, {2, 0, 0}, 1e-3).value, 0);
  const auto at = [](const Eigen::VectorXd& x) {
    return Mollifier(x.segment<3>(3) - x.segment<3>(0), x.segment<3>(9) - x.segment<3>(6), 1e3);
  };
  for (int trial = 0; trial < 10; ++trial) {
    const Eigen::VectorXd x = random_vector(12, random), v = random_vector(12, random);
    const Mollifier m = at(x);
    ASSERT_LT(m.value, 1);
    const Eigen::VectorXd g = m.first * m.gradient;
    const Eigen::MatrixXd H = m.first * m.hessian + m.second * m.gradient * m.gradient.transpose();
    expect_taylor_order([&](double h) { return std::abs(at(x + h * v).value - m.value - h * g.dot(v)); }, 2, 1e-16,
                        0.1);
    expect_taylor_order(
        [&](double h) {
          const Mollifier n = at(x + h * v);
          return (Eigen::VectorXd(n.first * n.gradient) - g - h * H * v).norm();
        },
        2, 1e-16, 0.1);
  }
}

TEST(Contact3dDistance, ClosestPointsAreNoFartherThanAnyOtherAndReached) {
  // Against a search over a grid of points on both features, whose error is bounded by its width.
  std::mt19937 random(7);
  for (int trial = 0; trial < 60; ++trial) {
    std::array<Vector3d, 4> x;
    for (Vector3d& point : x) point = random_vector(3, random);
    if (trial % 3 == 0) x[3] = x[2] + 0.7 * (x[1] - x[0]) + 1e-9 * random_vector(3, random);  // nearly parallel
    const Closest3 triangle = closest_on_triangle(x[0] - x[1], x[2] - x[1], x[3] - x[1]);
    const Closest3 segments = closest_of_segments(x[0] - x[2], x[1] - x[0], x[3] - x[2]);
    double to_triangle = 1e9, to_segment = 1e9;
    const int n = 120;
    for (int i = 0; i <= n; ++i) {
      for (int j = 0; j <= n; ++j) {
        const double s = double(i) / n, t = double(j) / n;
        to_segment = std::min(to_segment, (x[0] + s * (x[1] - x[0]) - x[2] - t * (x[3] - x[2])).norm());
        if (i + j <= n)
          to_triangle = std::min(to_triangle, (x[0] - x[1] - s * (x[2] - x[1]) - t * (x[3] - x[1])).norm());
      }
    }
    EXPECT_LE(triangle.distance, to_triangle + 1e-12);
    EXPECT_LE(segments.distance, to_segment + 1e-12);
    EXPECT_GE(triangle.distance, to_triangle - 0.06);
    EXPECT_GE(segments.distance, to_segment - 0.06);
    // The normal separates the two by just the distance.
    double apart_triangle = 1e9, apart_segments = 1e9;
    for (size_t k = 1; k < 4; ++k) apart_triangle = std::min(apart_triangle, triangle.normal.dot(x[0] - x[k]));
    for (size_t i = 0; i < 2; ++i) {
      for (size_t j = 2; j < 4; ++j) apart_segments = std::min(apart_segments, segments.normal.dot(x[i] - x[j]));
    }
    EXPECT_NEAR(apart_triangle, triangle.distance, 1e-12);
    EXPECT_NEAR(apart_segments, segments.distance, trial % 3 == 0 ? 1e-7 : 1e-12);
  }
}

TEST(Contact3dDistance, WhatSurelyIsApartIsFartherThanTheReachAndMostOfAFlatFaceIs) {
  // Against the distances of points on both features, none of which may be within the reach.
  std::mt19937 random(11);
  int found = 0, all = 0;
  for (int trial = 0; trial < 300; ++trial) {
    std::array<Vector3d, 4> x;
    for (Vector3d& point : x) point = random_vector(3, random);
    if (trial % 3 == 0) x[3] = x[2] + 0.7 * (x[1] - x[0]) + 1e-9 * random_vector(3, random);  // nearly parallel
    if (trial % 3 == 1) {
      for (Vector3d& point : x) point[2] = 1e-12 * point[0];  // in a plane
    }
    double to_triangle = 1e9, to_segment = 1e9;
    const int n = 40;
    for (int i = 0; i <= n; ++i) {
      for (int j = 0; j <= n; ++j) {
        const double s = double(i) / n, t = double(j) / n;
        to_segment = std::min(to_segment, (x[0] + s * (x[1] - x[0]) - x[2] - t * (x[3] - x[2])).norm());
        if (i + j <= n)
          to_triangle = std::min(to_triangle, (x[0] - x[1] - s * (x[2] - x[1]) - t * (x[3] - x[1])).norm());
      }
    }
    for (double reach : {0.0, 1e-3, 0.1, 0.5, 2.0}) {
      const bool triangle = surely_apart_from_triangle(x[0] - x[1], x[2] - x[1], x[3] - x[1], reach);
      const bool segments = surely_apart_segments(x[0] - x[2], x[1] - x[0], x[3] - x[2], reach);
      EXPECT_TRUE(!triangle || to_triangle > reach) << to_triangle << " m within " << reach;
      EXPECT_TRUE(!segments || to_segment > reach) << to_segment << " m within " << reach;
      found += triangle + segments;
      all += (to_triangle > reach + 0.1) + (to_segment > reach + 0.1);
    }
  }
  EXPECT_GT(found, 0.6 * all);
  // A vertex of a flat face and a triangle that is not its own; two edges beside each other.
  EXPECT_TRUE(surely_apart_from_triangle({1, 1, 0}, {1, 0, 0}, {0, 1, 0}, 0.5));
  EXPECT_TRUE(surely_apart_segments({0, 0.1, 0}, {1, 0, 0}, {1, -1, 0}, 0.01));
  EXPECT_FALSE(surely_apart_segments({0, 0, 0.1}, {1, 0, 0}, {1, -1, 0}, 0.1));
}

// Sums ----------------------------------------------------------------------------------------------------------------

/// A lower face of 1 m x 1 m with n x n cells and an upper one with m x m at distance s dhat.
Surface faces(int n, int m, double distance) {
  Surface surface;
  surface.add_face({0, 0, 0}, {1, 0, 0}, {0, 1, 0}, n, n);
  surface.add_face({1, 0, distance}, {-1, 0, 0}, {0, 1, 0}, m, m);
  return surface;
}

TEST(Contact3d, EnergyAndForceBetweenFlatFacesDoNotDependOnTheMeshes) {
  const double dhat = 1e-3;
  for (double s : {0.3, 0.6}) {
    const double density = -50 * dhat * (s - 1) * (s - 1) * std::log(s), pressure = 50 * pressure_at(s);
    for (auto [lower, upper] : {std::array{4, 4}, {4, 8}, {9, 2}, {5, 7}, {1, 1}, {1, 3}}) {
      const Surface surface = faces(lower, upper, s * dhat);
      const Evaluation e = evaluate(surface, surface.settings(), values(50, 50, dhat), surface.rest());
      EXPECT_NEAR(e.energy, density, 1e-12 * density) << lower << " and " << upper;
      const int first = (lower + 1) * (lower + 1);
      EXPECT_NEAR(e.force(first, surface.nodes())[2], pressure, 1e-11 * pressure);
      Vector3d moment = Vector3d::Zero();
      for (int node = first; node < surface.nodes(); ++node)
        moment -= Vector3d(surface.mesh.node(node)).cross(Vector3d(e.gradient.segment<3>(3 * node)));
      EXPECT_NEAR(moment[0], 0.5 * pressure, 1e-11 * pressure);
      EXPECT_NEAR(moment[1], -0.5 * pressure, 1e-11 * pressure);
    }
  }
}

TEST(Contact3d, PressureBetweenAlignedFlatFacesIsUniform) {
  const double s = 0.4, pressure = 50 * pressure_at(s);
  const Surface surface = faces(6, 6, s * 1e-3);
  const Evaluation e = evaluate(surface, surface.settings(), values(50, 50, 1e-3), surface.rest());
  std::vector<double> share(49, 0.0);  // of a uniform pressure on linear triangles
  for (size_t t = 0; t < 72; ++t) {
    for (int node : surface.triangles[t]) share[static_cast<size_t>(node)] += 1.0 / 216;
  }
  for (int node = 0; node < 49; ++node) {
    EXPECT_NEAR(e.gradient[3 * node + 2], pressure * share[static_cast<size_t>(node)], 1e-12 * pressure);
    EXPECT_NEAR(e.gradient.segment<2>(3 * node).norm(), 0, 1e-12 * pressure);
  }
}

TEST(Contact3d, CrossingEdgesBetweenFlatFacesPushOnlyBelowAQuarterOfTheGap) {
  const double dhat = 1e-3;
  const auto excess = [&](int n, int m, double s) {
    const Surface surface = faces(n, m, s * dhat);
    const Evaluation e = evaluate(surface, surface.settings(), values(50, 50, dhat), surface.rest());
    return e.force((n + 1) * (n + 1), surface.nodes())[2] / (50 * pressure_at(s)) - 1;
  };
  EXPECT_NEAR(excess(3, 5, 0.26), 0, 1e-11);
  EXPECT_GT(excess(3, 5, 0.2), 1e-4);
}

/// A needle (one thin triangle, nodes last) with its point at `tip` and its other end beyond it.
void add_needle(Surface& surface, const Vector3d& tip, const Vector3d& beyond) {
  const Vector3d side = 0.02 * beyond.unitOrthogonal();
  surface.add({tip, tip + beyond + side, tip + beyond - side}, {{0, 1, 2}});
}

/// Energy that the needle's point should feel at `distance`, and that of the other nodes, each of which sees one
/// triangle only; in units of kappa.
double needle_energy(const Surface& surface, double dhat, double distance) {
  std::vector<Vector3d> x;
  for (int node = 0; node < surface.nodes(); ++node) x.emplace_back(surface.mesh.node(node));
  const auto area_of = [&](const std::array<int, 3>& t) {
    return Vector3d((x[t[1]] - x[t[0]]).cross(x[t[2]] - x[t[0]]) / 2);
  };
  const auto weight = [&](size_t node) {
    double most = 0;
    for (const auto& one : surface.triangles) {
      double sum = 0;
      if (std::find(one.begin(), one.end(), static_cast<int>(node)) == one.end()) continue;
      for (const auto& two : surface.triangles) {
        if (std::find(two.begin(), two.end(), static_cast<int>(node)) == two.end()) continue;
        sum += std::max(0.0, area_of(one).dot(area_of(two))) / area_of(one).norm() / 3;
      }
      most = std::max(most, sum);
    }
    return most;
  };
  const size_t tip = x.size() - 3;
  double energy = 0.5 * weight(tip) * Barrier{dhat}.value(distance);
  for (size_t i = 0; i < tip; ++i) {
    const Closest3 closest = closest_on_triangle(x[i] - x[tip], x[tip + 1] - x[tip], x[tip + 2] - x[tip]);
    energy += 0.5 * weight(i) * Barrier{dhat}.value(closest.distance);
  }
  return energy;
}

TEST(Contact3d, ANodeOverAFlatFaceCountsOnceOverEdgesAndVerticesToo) {
  for (int k = 0; k < 60; ++k) {  // over vertices, along edges and across them
    const double x = 0.25 + 0.0083 * k, y = k % 2 == 0 ? x : 2.0 / 3;
    Surface surface;
    surface.add_face({0, 0, 0}, {1, 0, 0}, {0, 1, 0}, 3, 3);
    add_needle(surface, {x, y, 0.006}, {0, 0.1, 0.5});
    const double expected = needle_energy(surface, 0.01, 0.006);
    EXPECT_NEAR(evaluate(surface, surface.settings(), values(1, 1, 0.01), surface.rest()).energy, expected,
                1e-13 * expected)
        << k;
  }
}

/// Stiffness on the point of a needle that stands `height` over a place of a face, which is folded along x = 0.5 by
/// twice `slope`: across the needle relative to the barrier's own along it, the extremes.
std::pair<double, double> stiffness_across(double x, double y, double slope) {
  const double dhat = 0.01, height = 0.006;
  Surface surface;
  surface.add_face({0, 0, 0}, {1, 0, 0}, {0, 1, 0}, 4, 4);
  for (int node = 0; node < surface.nodes(); ++node)
    surface.mesh.X[3 * node + 2] -= slope * std::abs(surface.mesh.X[3 * node] - 0.5);
  add_needle(surface, {x, y, height - slope * std::abs(x - 0.5)}, {0, 0, 0.5});
  const auto model =
      term_under_test(surface.mesh, contact_table(), std::make_unique<Contact3d>(surface.mesh, surface.settings()),
                      values(1, 1, dhat), surface.rest(), "needle");
  const int tip = surface.nodes() - 3;
  const Vector3d a = surface.mesh.node(tip), b = surface.mesh.node(tip + 1), c = surface.mesh.node(tip + 2);
  const double along = (b - a).cross(c - a).norm() / 12 * Barrier{dhat}.curvature(height);
  const Eigen::Matrix3d H = hessian_of(model.model, model.u, model.p).block<3, 3>(3 * tip, 3 * tip);
  EXPECT_NEAR(H(2, 2) / along, 1, 1e-3);
  const auto values = Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(H.topLeftCorner<2, 2>() / along).eigenvalues();
  return {values[0], values[1]};
}

TEST(Contact3d, TheHessianTakesEdgesAndVerticesBetweenFacetsThatAreFlatToAHundredthForPlanes) {
  // Inside a triangle, over edges along y, x and a diagonal.
  for (const auto& [x, y] : {std::pair{0.3, 0.45}, {0.5, 0.3}, {0.3, 0.5}, {0.4, 0.6}}) {
    for (double slope : {0.0, 1e-5, 5e-3}) {
      const auto [least, most] = stiffness_across(x, y, slope);
      EXPECT_GT(least, -1e-4) << x << ", " << y << " folded by " << slope;
      EXPECT_LT(most, 1e-4) << x << ", " << y << " folded by " << slope;
    }
  }
  // All nodes of one face over those of another.
  const Surface aligned = faces(4, 4, 0.5e-3);
  const auto two =
      term_under_test(aligned.mesh, contact_table(), std::make_unique<Contact3d>(aligned.mesh, aligned.settings()),
                      values(1, 1, 1e-3), aligned.rest(), "faces");
  const Eigen::MatrixXd H = hessian_of(two.model, two.u, two.p);
  std::array<double, 3> stiffness{};
  for (int axis = 0; axis < 3; ++axis) {
    Eigen::VectorXd shift = aligned.rest();
    for (int node = 25; node < 50; ++node) shift[3 * node + axis] = 1;
    stiffness[static_cast<size_t>(axis)] = shift.dot(H * shift);
  }
  EXPECT_LT(std::abs(stiffness[0]) + std::abs(stiffness[1]), 1e-9 * stiffness[2]);
  // A sharper ridge pushes the needle aside.
  EXPECT_LT(stiffness_across(0.5, 0.3, 0.05).first, -0.1);
}

TEST(Contact3d, ANodeBesideAConvexEdgeOrCornerCountsOnce) {
  for (const Vector3d& way : {Vector3d(0.02, 0.01, 0), Vector3d(0.01, 0.02, 0.015), Vector3d(0.03, 0, 0)}) {
    for (double z : {0.31, 0.5, 1.0}) {
      const Vector3d away = z == 1.0 ? way : Vector3d(way[0], way[1], 0);
      Surface surface;
      surface.add_box({0, 0, 0}, {1, 1, 1}, {2, 2, 2});
      add_needle(surface, Vector3d(1, 1, z) + away, {0.5, 0.4, 0.3});
      const double expected = needle_energy(surface, 0.05, away.norm());
      EXPECT_NEAR(evaluate(surface, surface.settings(), values(1, 1, 0.05), surface.rest()).energy, expected,
                  1e-13 * expected)
          << way.transpose() << " at " << z;
    }
  }
}

TEST(Contact3d, AGroundPressesLikeABody) {
  const double s = 0.6, pressure = 50 * pressure_at(s);
  Surface surface;
  surface.add_face({0, 0, s * 1e-3}, {0, 1, 0}, {1, 0, 0}, 6, 5);
  Contact3dSettings settings = surface.settings();
  settings.grounds = {{{0, 0, 0}, {0, 0, 3}}};
  const Evaluation e = evaluate(surface, settings, values(50, 50, 1e-3), surface.rest());
  EXPECT_NEAR(e.force(0, surface.nodes())[2], pressure, 1e-12 * pressure);
}

TEST(Contact3d, WhatTouchesOrLiesBehindAGroundHasInfiniteEnergy) {
  Surface touching;
  touching.add_face({0, 0, 0}, {1, 0, 0}, {0, 1, 0}, 1, 1);
  touching.add({{0.5, 0.25, 0}, {0.6, 0.3, 1}, {0.5, 0.5, 1}}, {{0, 1, 2}});
  const Params p = values(1, 1, 0.01);
  EXPECT_EQ(evaluate(touching, touching.settings(), p, touching.rest()).energy,
            std::numeric_limits<double>::infinity());
  Surface behind;
  behind.add_face({0, 0, 0}, {1, 0, 0}, {0, 1, 0}, 1, 1);
  Contact3dSettings settings = behind.settings();
  settings.grounds = {{{0, 0, 1e-3}, {0, 0, 1}}};
  EXPECT_EQ(evaluate(behind, settings, p, behind.rest()).energy, std::numeric_limits<double>::infinity());
  const Contact3d contact(behind.mesh, settings);
  EXPECT_TRUE(contact.intersects(behind.rest()));
  EXPECT_NEAR(contact.smallest_distance(behind.rest(), 1), -1e-3, 1e-18);
}

TEST(Contact3d, PartsThatDoNotSeeEachOtherPassAndOthersDoNot) {
  Surface surface;
  for (double x : {0.0, 0.5, 2.0}) surface.add_box({x, 0.1 * x, 0.1 * x}, {1, 1, 1}, {1, 1, 1});
  Contact3dSettings settings = surface.settings();
  for (int node = 0; node < surface.nodes(); ++node) settings.part.push_back(node / 8);
  EXPECT_TRUE(Contact3d(surface.mesh, settings).intersects(surface.rest()));
  settings.patches = {{{1, 0}, {0.7, 0.5, 0.5}, Vector3d::UnitZ(), 2}};
  const Contact3d contact(surface.mesh, settings);
  EXPECT_FALSE(contact.intersects(surface.rest()));
  EXPECT_NEAR(contact.smallest_distance(surface.rest(), 2), 0.5, 1e-12);  // the third box and the second
  Eigen::VectorXd step = surface.rest();
  for (int node = 0; node < 8; ++node) step[3 * node] = 1.2;
  EXPECT_LT(contact.step_limit({surface.rest(), values(1, 1, 0.01)}, step), 1.0);
  for (int node = 0; node < 8; ++node) step[3 * node] = 0.7;
  EXPECT_EQ(contact.step_limit({surface.rest(), values(1, 1, 0.01)}, step), 1.0);
}

// Search --------------------------------------------------------------------------------------------------------------

/// Boxes of different fineness side by side and turned, over a ground.
struct Crowd {
  Surface surface;
  Contact3dSettings settings;
  explicit Crowd(unsigned seed, bool ground = true) {
    std::mt19937 random(seed);
    for (int i = 0; i < 2; ++i) {
      for (int j = 0; j < 2; ++j) {
        const Vector3d axis = random_vector(3, random).normalized();
        const Eigen::Matrix3d turn = Eigen::AngleAxisd(seed % 3 == 0 ? 0.0 : 0.2, axis).toRotationMatrix();
        surface.add_box(Vector3d(i, j, 0.3 * (i + j)), Vector3d(0.8, 0.8, 0.5), {1 + i, 1, 1}, turn);
      }
    }
    settings = surface.settings();
    if (ground) settings.grounds = {{{0, 0, -0.6}, Vector3d(0.1, 0, 1)}};
  }
};

/// A smooth motion plus noise, of size 1.
Eigen::VectorXd random_motion(const Mesh& mesh, std::mt19937& random, double noise) {
  const Eigen::Matrix3d A = random_vector(9, random).reshaped(3, 3);
  const Vector3d b = random_vector(3, random), phase = random_vector(3, random);
  Eigen::VectorXd motion = noise * random_vector(mesh.X.size(), random);
  for (Eigen::Index i = 0; i < mesh.X.size(); i += 3) {
    const Vector3d x = mesh.X.segment<3>(i);
    motion.segment<3>(i) += b + A * x + (4 * x + phase).array().sin().matrix();
  }
  return motion;
}

TEST(Contact3d, BroadPhaseFindsWhatAllPairsFind) {
  std::mt19937 random(2);
  size_t found = 0;
  for (unsigned seed = 0; seed < 30; ++seed) {
    const Crowd crowd(seed);
    const Contact3d contact(crowd.surface.mesh, crowd.settings);
    const Eigen::VectorXd u = 0.1 * (seed % 5) * random_motion(crowd.surface.mesh, random, 0.1);
    const Params p = values(1, 1, std::pow(10.0, -(seed % 4) / 2.0 - 0.5));
    const auto fast = contact.active_pairs({u, p}), slow = contact.active_pairs({u, p}, true);
    ASSERT_EQ(fast.size(), slow.size());
    double smallest = std::numeric_limits<double>::infinity();
    for (size_t k = 0; k < fast.size(); ++k) {
      ASSERT_EQ(fast[k].kind, slow[k].kind);
      ASSERT_EQ(fast[k].first, slow[k].first);
      ASSERT_EQ(fast[k].second, slow[k].second);
      ASSERT_EQ(fast[k].distance, slow[k].distance);
      smallest = std::min(smallest, slow[k].distance);
    }
    EXPECT_EQ(contact.smallest_distance(u, p[gap]), smallest);
    found += fast.size();
  }
  EXPECT_GT(found, 2000u);
}

std::vector<double> all_distances(const Contact3d& contact, const Eigen::VectorXd& u) {
  std::vector<double> distances;
  for (const ContactPair3& pair : contact.active_pairs({u, values(1, 1, 1e9)}, true))
    distances.push_back(pair.distance);
  return distances;
}

TEST(SlowContact3d, NothingEverPassesThroughAnythingWithinTheStepLimit) {
  std::mt19937 random(8);
  int limited = 0, steps = 0;
  const Params p = values(1, 1, 0.1);
  for (unsigned seed = 0; seed < 90; ++seed) {
    const Crowd crowd(seed, seed % 2 == 0);
    const Contact3d contact(crowd.surface.mesh, crowd.settings);
    Eigen::VectorXd u = crowd.surface.rest();
    if (contact.intersects(u)) continue;
    for (int k = 0; k < 30; ++k) {
      const double size = std::pow(10.0, -static_cast<int>(random() % 3));
      const Eigen::VectorXd step = size * random_motion(crowd.surface.mesh, random, k % 3 == 0 ? 0.3 : 0.01);
      const double limit = contact.step_limit({u, p}, step);
      ASSERT_GE(limit, 0.0);
      ASSERT_LE(limit, 1.0);
      Eigen::VectorXd next = u + limit * step;
      ASSERT_FALSE(contact.intersects(next)) << "seed " << seed << ", step " << k << ", limit " << limit;
      ASSERT_FALSE(contact.intersects(u + 0.5 * limit * step));
      u.swap(next);
      limited += limit < 1;
      ++steps;
      if (k % 10 == 1) {
        const std::vector<double> before = all_distances(contact, next), after = all_distances(contact, u);
        double left = 1;
        for (size_t i = 0; i < before.size(); ++i) left = std::min(left, after[i] / before[i]);
        ASSERT_GE(*std::min_element(after.begin(), after.end()),
                  0.1 * *std::min_element(before.begin(), before.end()) - 1e-15);
        ASSERT_TRUE(limit == 1 || left < 0.2 + 1e-6) << "seed " << seed << ", step " << k << ", limit " << limit;
      }
      if (k % 5 == 4) u.setZero();
    }
  }
  EXPECT_GT(steps, 2000);
  EXPECT_GT(limited, steps / 4);
}

TEST(Contact3d, StepLimitHoldsInGapsOfTenNanometresAtCoordinatesOfCentimetres) {
  std::mt19937 random(4);
  const Params p = values(1, 1, 1e-6);
  for (int trial = 0; trial < 30; ++trial) {
    const double distance = trial % 2 == 0 ? 1e-7 : 1e-8;
    const Eigen::Matrix3d R = Eigen::AngleAxisd(trial, Vector3d(random_vector(3, random)).normalized()).matrix();
    Surface surface;
    const Vector3d corner(0.06, -0.02, 0.03), x = R.col(0), y = R.col(1), up = R.col(2);
    surface.add_face(corner, 5e-3 * x, 4e-3 * y, 4, 3);
    const int first = surface.nodes();
    surface.add_face(corner + distance * up + 4.1e-3 * x, -4e-3 * x, 3.9e-3 * y, 3, 4);
    const Contact3d contact(surface.mesh, surface.settings());
    const auto moved = [&](const Vector3d& by, double noise) {
      Eigen::VectorXd step = noise * random_vector(surface.mesh.X.size(), random);
      for (int node = first; node < surface.nodes(); ++node) step.segment<3>(3 * node) += by;
      return step;
    };
    Eigen::VectorXd u = surface.rest();
    ASSERT_FALSE(contact.intersects(u));
    EXPECT_NEAR(contact.smallest_distance(u, 1e-6), distance, 1e-15);
    EXPECT_EQ(contact.step_limit({u, p}, moved(1e-3 * x, 0)), 1.0) << "sliding along is free";
    EXPECT_EQ(contact.step_limit({u, p}, moved(1e-2 * up, 0)), 1.0) << "parting is free";
    EXPECT_NEAR(contact.step_limit({u, p}, moved(-2 * distance * up, 0)), 0.45, 0.05 + 1e-6);
    for (int k = 0; k < 8; ++k) {
      const Eigen::VectorXd step = moved(1e-6 * Vector3d(random_vector(3, random)), 1e-8);
      u += contact.step_limit({u, p}, step) * step;
      ASSERT_FALSE(contact.intersects(u)) << trial << ", " << k;
      if (k % 4 == 3) u.setZero();
    }
  }
}

TEST(Contact3d, StepLimitIsZeroForStepsThatAreNotFiniteAndFromStatesThatTouch) {
  const Crowd crowd(0);
  const Contact3d contact(crowd.surface.mesh, crowd.settings);
  const Params p = values(1, 1, 0.1);
  const Eigen::VectorXd u = crowd.surface.rest();
  Eigen::VectorXd step = u;
  EXPECT_EQ(contact.step_limit({u, p}, step), 1.0);
  for (double wrong : {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    step[3] = wrong;
    EXPECT_EQ(contact.step_limit({u, p}, step), 0.0);
    EXPECT_EQ(contact.step_limit({step, p}, u), 0.0);
  }
  Surface touching;
  touching.add_face({0, 0, 0}, {1, 0, 0}, {0, 1, 0}, 1, 1);
  touching.add({{0.5, 0.25, 0}, {0.6, 0.3, 1}, {0.5, 0.5, 1}}, {{0, 1, 2}});
  Eigen::VectorXd lift = touching.rest();
  for (int node = 4; node < 7; ++node) lift[3 * node] = 0.01;
  EXPECT_EQ(Contact3d(touching.mesh, touching.settings()).step_limit({touching.rest(), p}, lift), 0.0);
}

TEST(Contact3d, EdgesThatCrossWithoutANodeNearAreStoppedAndPushed) {
  // Two bars of one cell each, crossed: their nodes are far from each other's faces.
  Surface surface;
  surface.add_box({-2, -0.1, 0.1}, {4, 0.2, 0.2}, {1, 1, 1});
  surface.add_box({-0.1, -2, -0.3}, {0.2, 4, 0.2}, {1, 1, 1});
  const Contact3d contact(surface.mesh, surface.settings());
  const Params p = values(1, 1, 0.08);
  Eigen::VectorXd u = surface.rest(), step = u;
  for (int node = 0; node < 8; ++node) step[3 * node + 2] = -0.5;
  const double limit = contact.step_limit({u, p}, step);
  EXPECT_NEAR(limit, 0.4 * 0.85, 0.4 * 0.051);
  EXPECT_TRUE(contact.intersects(u + 0.41 * step));
  EXPECT_FALSE(contact.intersects(u + 0.39 * step));
  for (double distance : {0.021, 0.019, 0.005}) {
    for (int node = 0; node < 8; ++node) u[3 * node + 2] = distance - 0.2;
    const Evaluation e = evaluate(surface, surface.settings(), p, u);
    EXPECT_EQ(e.force(0, 8)[2] > 0, distance < 0.02) << distance;
  }
}

TEST(Contact3d, IntersectionsAreExact) {
  const Triangle triangle{Vector3d(0, 0, 0), Vector3d(1, 0, 0), Vector3d(0, 1, 0)};
  const auto meets = [&](const Vector3d& a, const Vector3d& b) {
    const bool found = segment_meets_triangle(a, b, triangle);
    EXPECT_EQ(segment_meets_triangle(b, a, {triangle[2], triangle[1], triangle[0]}), found);
    return found;
  };
  EXPECT_TRUE(meets({0.2, 0.2, -1}, {0.2, 0.2, 1}));
  EXPECT_FALSE(meets({0.6, 0.6, -1}, {0.6, 0.6, 1}));
  EXPECT_FALSE(meets({0.2, 0.2, 1e-300}, {0.2, 0.2, 1}));
  EXPECT_TRUE(meets({0.2, 0.2, 0}, {0.2, 0.2, 1})) << "touching counts";
  EXPECT_TRUE(meets({0.5, 0.5, -1}, {0.5, 0.5, 1})) << "on the edge";
  const double beyond = 0.5 + std::ldexp(1, -53);  // the next double
  EXPECT_FALSE(meets({0.5, beyond, -1}, {0.5, beyond, 1}));
  EXPECT_TRUE(meets({0.1, 0.1, 0}, {0.2, 0.2, 0})) << "in the plane, inside";
  EXPECT_TRUE(meets({-1, 0.3, 0}, {2, 0.3, 0})) << "in the plane, through";
  EXPECT_TRUE(meets({0, -1, 0}, {0, 0, 0})) << "in the plane, at a corner";
  EXPECT_FALSE(meets({-1, 0.3, 0}, {-1e-300, 0.3, 0})) << "in the plane, outside";
  EXPECT_FALSE(meets({1, 1, 0}, {beyond, 0.5, 0}));
}

TEST(Contact3dDistance, OrientationIsExactAtTheLastBit) {
  // d on a grid of one unit in the last place around the plane x + y + z = 36 through three far points.
  const Vector3d a(36, 0, 0), b(0, 36, 0), c(0, 0, 36);
  const double ulp = std::ldexp(1.0, -49);  // of numbers between 8 and 16
  for (int i = -3; i <= 3; ++i) {
    for (int j = -3; j <= 3; ++j) {
      for (int k = -3; k <= 3; ++k) {
        const Vector3d d(12 + i * ulp, 12 + j * ulp, 12 + k * ulp);
        const int sign = i + j + k > 0 ? 1 : i + j + k < 0 ? -1 : 0;
        ASSERT_EQ(orientation(a, b, c, d), sign) << i << j << k;
        ASSERT_EQ(orientation(b, a, c, d), -sign);
        ASSERT_EQ(orientation(d, b, c, a), -sign);
        ASSERT_EQ(orientation(b, c, a, d), sign);
      }
    }
  }
  EXPECT_EQ(orientation({0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}), 1);
}

TEST(Contact3d, TrianglesOfAMeshAreItsBoundaryOutwardOriented) {
  for (int order : {1, 2}) {
    const Mesh mesh = box(graded(2, 2), graded(1, 3), graded(1, 1), order, "body");
    const auto triangles = contact_triangles(mesh);
    EXPECT_EQ(triangles.size(), (order == 1 ? 1u : 4u) * 2 * 2 * (2 * 3 + 2 * 1 + 3 * 1));
    double volume = 0;
    std::set<int> nodes;
    for (const auto& [a, b, c] : triangles) {
      volume += Vector3d(mesh.node(a)).dot(Vector3d(mesh.node(b)).cross(Vector3d(mesh.node(c)))) / 6;
      nodes.insert({a, b, c});
    }
    EXPECT_NEAR(volume, 2.0, 1e-14);
    EXPECT_EQ(static_cast<size_t>(nodes.size()), triangles.size() / 2 + 2) << "Euler";
  }
}

TEST(Contact3d, WrongSurroundingsAreRefused) {
  Surface surface;
  surface.add_face({0, 0, 0}, {1, 0, 0}, {0, 1, 0}, 1, 1);
  Contact3dSettings settings = surface.settings();
  settings.grounds = {{{0, 0, -1}, {0, 0, 0}}};
  expect_input_error([&] { Contact3d(surface.mesh, settings); }, {"ground 1", "normal"});
  settings = surface.settings();
  settings.triangles[0][0] = 7;
  EXPECT_THROW(Contact3d(surface.mesh, settings), std::logic_error);
}

// Equilibria ----------------------------------------------------------------------------------------------------------

/// What contact does to the nodes from `first` on.
Vector3d contact_force(const Contact3d& contact, const Eigen::VectorXd& u, const Params& p, int first) {
  Eigen::VectorXd gradient = Eigen::VectorXd::Zero(u.size());
  Assembly out;
  out.gradient = &gradient;
  contact.assemble({u, p}, out);
  Vector3d force = Vector3d::Zero();
  for (Eigen::Index i = 3 * Eigen::Index(first); i < u.size(); i += 3) force -= gradient.segment<3>(i);
  return force;
}

struct Blocks {
  Scene scene;
  const Contact3d* contact = nullptr;
  int approach = -1;
};

constexpr double block_gap = 10e-6, block_distance = 30e-6, block_stiffness = 2e3;

/// Two blocks of 10 mm x 10 mm x 4 mm one above the other between smooth walls (nu = 0: uniform stress), the upper of
/// which moves by p[approach].
Blocks blocks(int order, const std::array<int, 3>& lower_cells, const std::array<int, 3>& upper_cells,
              bool may_slide = true) {
  const auto block = [&](const std::array<int, 3>& cells, const char* region) {
    return box(graded(10e-3, cells[0]), graded(10e-3, cells[1]), graded(4e-3, cells[2]), order, region);
  };
  Mesh upper = block(upper_cells, "hard");
  for (Eigen::Index i = 2; i < upper.X.size(); i += 3) upper.X[i] += 4e-3 + block_distance;
  SceneBuilder builder(merge({{"lower", block(lower_cells, "soft")}, {"upper", upper}}));
  builder.add_solid("soft", "neo_hookean", {{"E", 1e5}, {"nu", 0.0}});
  builder.add_solid("hard", "neo_hookean", {{"E", 4e5}, {"nu", 0.0}});
  builder.fix("lower.zmin", {2});
  for (const char* part : {"lower", "upper"}) {
    for (const char* side : {".xmin", ".xmax"}) builder.fix(std::string(part) + side, {0});
    for (const char* side : {".ymin", ".ymax"}) builder.fix(std::string(part) + side, {1});
  }
  if (!may_slide) {
    for (const char* face : {"lower.zmax", "upper.zmin"}) builder.fix(face, {0, 1});
  }
  Blocks result;
  result.approach = builder.declare({"approach", "w", "m", -1, 1, "approach"}, 0.0);
  builder.prescribe("upper.zmax", 2, result.approach);
  result.contact = &builder.add_contact_3d(block_gap, {{"soft", block_stiffness}, {"hard", 1e6}});
  result.scene = builder.build();
  return result;
}

TEST(Contact3dSolve, BlocksWithTheSameMeshesTouchUniformlyUpToTheirRimsAndFollowTheContactLaw) {
  // Nodes exactly over nodes are a ridge of the energy, from which faces that may slide do so.
  const Blocks b = blocks(1, {4, 2, 2}, {4, 2, 2}, false);
  Equilibrium equilibrium(*b.scene.model);
  equilibrium.start_at_rest(b.scene.values);
  Params p = b.scene.values;
  p[b.approach] = -60e-6;
  ASSERT_EQ(equilibrium.solve(p).status, SolveStatus::converged) << equilibrium.report().message();
  const Eigen::VectorXd& u = equilibrium.u();
  const int first = b.scene.model->mesh().part("upper").first_node, face = 15;  // nodes of the lower block's upper face
  for (int k = 0; k < face; ++k) {
    EXPECT_NEAR(u[3 * (first + k) + 2], u[3 * first + 2], 1e-11);
    EXPECT_NEAR(u[3 * (first - face + k) + 2], u[3 * (first - face) + 2], 1e-11);
  }
  const double s = (block_distance + u[3 * first + 2] - u[3 * (first - face) + 2]) / block_gap;
  EXPECT_GT(s, 0.5);
  EXPECT_LT(s, 0.9);
  const double force = contact_force(*b.contact, u, p, first)[2];
  EXPECT_NEAR(force, 1e-4 * block_stiffness * pressure_at(s), 1e-6 * force);
}

TEST(Contact3dSolve, PressedBlocksCarryTheForceOfUniformPressureWhateverTheirMeshes) {
  // Small strains: 60 um = 30 um - s dhat + q (4 mm / 1e5 Pa + 4 mm / 4e5 Pa), q = kappa p(s).
  double low = 0.1, high = 1;
  for (int k = 0; k < 100; ++k) {
    const double s = 0.5 * (low + high), q = (30e-6 + s * block_gap) / 5e-8;
    (block_stiffness * pressure_at(s) > q ? low : high) = s;
  }
  const double expected = 1e-4 * block_stiffness * pressure_at(low);
  struct Case {
    int order;
    std::array<int, 3> lower, upper;
    double tolerance;
  };
  for (const Case& c : {Case{1, {3, 2, 1}, {4, 3, 2}, 0.015}, {2, {3, 2, 1}, {4, 3, 2}, 0.04}}) {
    const Blocks b = blocks(c.order, c.lower, c.upper);
    Equilibrium equilibrium(*b.scene.model);
    equilibrium.start_at_rest(b.scene.values);
    Params p = b.scene.values;
    p[b.approach] = -60e-6;
    ASSERT_EQ(equilibrium.solve(p).status, SolveStatus::converged) << equilibrium.report().message();
    const Eigen::VectorXd& u = equilibrium.u();
    EXPECT_FALSE(b.contact->intersects(u));
    const Mesh& mesh = b.scene.model->mesh();
    const double force = contact_force(*b.contact, u, p, mesh.part("upper").first_node)[2];
    EXPECT_NEAR(force, expected, c.tolerance * expected);
    EXPECT_LE(contact_force(*b.contact, u, p, 0).norm(), 1e-12 * force);
    // What the wall below carries is what the faces exchange.
    const Eigen::VectorXd gradient = gradient_of(*b.scene.model, u, p);
    double reaction = 0;
    for (int node : mesh.select("lower.zmin").nodes()) reaction += gradient[3 * node + 2];
    EXPECT_NEAR(reaction, force, 1e-9 * force);
  }
}

/// A block of 10 mm, 1 g, free over a ground 1 mm below it.
struct Free {
  Scene scene;
  const Contact3d* contact = nullptr;
  int gravity = -1;
};

Free free_block(int order) {
  SceneBuilder builder(box(graded(10e-3, 2), graded(10e-3, 2), graded(10e-3, 2), order, "block"));
  builder.add_solid("block", "neo_hookean", {{"E", 1e5}, {"nu", 0.3}});
  builder.add_inertia("block", 1000);
  Free result;
  result.gravity = builder.declare({"gravity", "g", "m/s2", 0, 100, "gravity"}, 0.0);
  builder.add_weight("block", 1000, Vector3d(0, 0, -1), result.gravity);
  result.contact = &builder.add_contact_3d(20e-6, {{"block", 1e3}}, {{{0, 0, -1e-3}, {0, 0, 1}}});
  result.scene = builder.build(FreeBodies::move);
  return result;
}

TEST(Contact3dSolve, ABlockComesToRestOnTheGroundUnderItsWeight) {
  for (int order : {1, 2}) {
    const Free f = free_block(order);
    Params p = f.scene.values;
    p[f.gravity] = 9.80665;
    Equilibrium equilibrium(*f.scene.model);
    Eigen::VectorXd u = Eigen::VectorXd::Zero(f.scene.model->unknowns());
    for (int step = 0; step < 30; ++step) {  // each forgets the velocity
      TimeStep at;
      at.inertia = 2e3;
      at.reference = u;
      ASSERT_EQ(equilibrium.solve_step(u, p, at).status, SolveStatus::converged) << equilibrium.report().message();
      u = equilibrium.u();
      ASSERT_FALSE(f.contact->intersects(u));
    }
    const Vector3d force = contact_force(*f.contact, u, p, 0);
    EXPECT_NEAR(force[2], 9.80665e-3, 1e-9 * force[2]);
    EXPECT_LE(force.head<2>().norm(), 1e-12);
  }
}

TEST(Contact3dSolve, ABlockThatIsThrownFarBehindTheGroundStopsAtIt) {
  const Free f = free_block(1);
  TimeStep at;
  at.inertia = 10;
  at.reference = Eigen::VectorXd::Zero(f.scene.model->unknowns());
  for (Eigen::Index i = 0; i < at.reference.size(); i += 3) at.reference.segment<3>(i) << 0.3, 0.2, -1;
  Equilibrium equilibrium(*f.scene.model);
  const Eigen::VectorXd rest = Eigen::VectorXd::Zero(f.scene.model->unknowns());
  ASSERT_EQ(equilibrium.solve_step(rest, f.scene.values, at).status, SolveStatus::converged);
  const Eigen::VectorXd& u = equilibrium.u();
  EXPECT_FALSE(f.contact->intersects(u));
  // m (u - reference) / h^2 with the mean height, 1 mm deep and some of the gap.
  EXPECT_NEAR(contact_force(*f.contact, u, f.scene.values, 0)[2], 1e-3 * 10 * 0.999, 5e-4 * 1e-2);
  EXPECT_NEAR(u[0], 0.3, 1e-4);
  EXPECT_NEAR(u[1], 0.2, 1e-4);
}

TEST(Contact3dSolve, CrossedBarsStayApartWhereOnlyTheirEdgesMeet) {
  // Bars on their edges: the upper one is thrown across the lower one, whose ends are held.
  const auto bar = [](int axis, double z) {
    Mesh mesh = box(graded(40e-3, 3), graded(2e-3, 1), graded(2e-3, 1), 1, "bar");
    for (int node = 0; node < mesh.node_count(); ++node) {
      const Vector3d x = mesh.node(node) - Vector3d(20e-3, 1e-3, 1e-3);
      const double side = std::sqrt(0.5) * (x[1] - x[2]), up = std::sqrt(0.5) * (x[1] + x[2]);
      mesh.X.segment<3>(3 * node) = axis == 0 ? Vector3d(x[0], side, up + z) : Vector3d(-side, x[0], up + z);
    }
    return mesh;
  };
  SceneBuilder builder(merge({{"lower", bar(0, 0)}, {"upper", bar(1, 3e-3)}}));
  builder.add_solid("bar", "neo_hookean", {{"E", 1e7}, {"nu", 0.3}});
  builder.add_inertia("bar", 1000);
  for (const char* end : {"lower.xmin", "lower.xmax"}) builder.fix(end, {0, 1, 2});
  const Contact3d& contact = builder.add_contact_3d(40e-6, {{"bar", 1e3}});
  const Scene scene = builder.build(FreeBodies::move);
  const int first = scene.model->mesh().part("upper").first_node;
  Eigen::VectorXd u = Eigen::VectorXd::Zero(scene.model->unknowns());
  TimeStep at;
  at.inertia = 1e4;
  at.reference = u;
  for (Eigen::Index i = 3 * first + 2; i < u.size(); i += 3) at.reference[i] = -5e-3;
  Equilibrium equilibrium(*scene.model, {.max_iterations = 400});
  ASSERT_EQ(equilibrium.solve_step(u, scene.values, at).status, SolveStatus::converged)
      << equilibrium.report().message();
  EXPECT_FALSE(contact.intersects(equilibrium.u()));
  EXPECT_TRUE(contact.intersects(at.reference));
  EXPECT_GT(contact_force(contact, equilibrium.u(), scene.values, first)[2], 1e-3);
  double nearest = 1;
  for (const ContactPair3& pair : contact.active_pairs({equilibrium.u(), scene.values})) {
    EXPECT_EQ(pair.kind, ContactPair3::Kind::edges);
    nearest = std::min(nearest, pair.distance);
  }
  EXPECT_LT(nearest, 10e-6);
}

TEST(Contact3dSolve, WhatIsCloserThanTheGapAtRestIsRefused) {
  const auto add = [](double gap, double height) {
    SceneBuilder builder(box(graded(10e-3, 2), graded(10e-3, 2), graded(10e-3, 2), 1, "block"));
    builder.add_solid("block", "neo_hookean", {{"E", 1e5}, {"nu", 0.3}});
    builder.add_contact_3d(gap, {{"block", 1e3}}, {{{0, 0, -height}, {0, 0, 1}}});
  };
  EXPECT_NO_THROW(add(20e-6, 1e-3));
  expect_input_error([&] { add(20e-6, 15e-6); }, {"0.02 mm", "0.015 mm", "below half"});
  expect_input_error([&] { add(20e-6, -1e-6); }, {"cross each other at rest"});
  SceneBuilder plane(rectangle(graded(1, 1), graded(1, 1), 1, "block"));
  expect_input_error([&] { plane.add_contact_3d(1e-3, {}); }, {"for 3D models"});
}

}  // namespace
}  // namespace taut
