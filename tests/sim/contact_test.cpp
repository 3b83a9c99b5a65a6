#include "sim/contact/contact.hpp"

#include <numbers>
#include <set>

#include "sim/contact/contact_geometry.hpp"
#include "tests/support/message.hpp"
#include "tests/support/term_battery.hpp"

namespace taut {
namespace {

using namespace test;
using Vector = Eigen::Vector2d;
using Polyline = std::vector<Vector>;
constexpr double pi = std::numbers::pi;

enum Index { soft, hard, gap, thickness, other };
constexpr ContactForm all_forms[] = {ContactForm::length_weighted, ContactForm::pair_sum, ContactForm::pair_sum_dedup,
                                     ContactForm::penalty};

ParameterTable contact_table() {
  ParameterTable table;
  for (const char* id : {"kappa_soft", "kappa_hard", "dhat", "thickness", "other"})
    table.declare({id, id, "SI", 0, 1e30, id, false});
  return table;
}

/// Polylines as a mesh without elements; first = last point closes one.
struct Boundary {
  Mesh mesh;
  std::vector<std::array<int, 2>> edges;

  explicit Boundary(const std::vector<Polyline>& lines) {
    std::vector<double> X;
    for (const Polyline& line : lines) {
      const bool closed = line.front() == line.back();
      const int first = static_cast<int>(X.size() / 2), count = static_cast<int>(line.size()) - (closed ? 1 : 0);
      for (int k = 0; k < count; ++k) X.insert(X.end(), {line[k][0], line[k][1]});
      for (int k = 0; k + 1 < static_cast<int>(line.size()); ++k) edges.push_back({first + k, first + (k + 1) % count});
    }
    mesh.X = Eigen::Map<Eigen::VectorXd>(X.data(), static_cast<Eigen::Index>(X.size()));
  }
  ContactSettings settings(ContactForm form = ContactForm::length_weighted) const {
    ContactSettings s;
    s.form = form;
    s.edges = edges;
    s.stiffness.assign(edges.size(), soft);
    s.gap = gap;
    s.thickness = thickness;
    return s;
  }
  Eigen::VectorXd rest() const { return Eigen::VectorXd::Zero(mesh.X.size()); }
};

Polyline straight(const Vector& a, const Vector& b, int cells) {
  Polyline line;
  for (int k = 0; k <= cells; ++k) line.push_back(a + (b - a) * k / cells);
  return line;
}

Polyline ring(const Vector& centre, double radius, int cells, double turn = 0) {
  Polyline line;
  for (int k = 0; k < cells; ++k) {
    const double angle = turn + 2 * pi * k / cells;
    line.emplace_back(centre + radius * Vector(std::cos(angle), std::sin(angle)));
  }
  line.push_back(line.front());
  return line;
}

Params values(double kappa_soft, double kappa_hard, double dhat, double t) {
  Params p(5);
  p << kappa_soft, kappa_hard, dhat, t, 1.0;
  return p;
}

/// Two wavy lines and a corner within each other's dhat = 0.3, edges of about 0.5, two kappas; with an obstacle and a
/// ground or without.
TermUnderTest contact_case(ContactForm form, bool surroundings, unsigned seed) {
  std::mt19937 random(seed);
  Polyline lower = straight({0, 0}, {3, 0}, 6), upper = straight({2.9, 0.15}, {0.3, 0.2}, 5);
  lower.push_back({3.1, 1.0});
  const Boundary boundary({lower, upper});
  ContactSettings settings = boundary.settings(form);
  for (size_t e = 3; e < 10; ++e) settings.stiffness[e] = hard;
  if (surroundings) {
    settings.obstacles = {{{3.3, -0.5}, {3.25, 0.4}, {3.4, 0.9}, {3.3, -0.5}}, straight({-0.5, -0.15}, {2, -0.25}, 4)};
    settings.grounds = {{{0.0, 0.85}, Vector(0.1, -1).normalized()}};
    settings.obstacle_stiffness = seed % 2 == 0 ? hard : -1;
  }
  std::string name = std::to_string(static_cast<int>(form)) + (surroundings ? " with surroundings " : " ");
  for (double noise = 0.03;; noise *= 0.9) {
    Eigen::VectorXd u = noise * random_vector(boundary.mesh.X.size(), random);
    const Contact contact(boundary.mesh, settings);
    if (contact.intersects(u) || contact.smallest_distance(u, 1) < 0.05) continue;
    return term_under_test(boundary.mesh, contact_table(), std::make_unique<Contact>(boundary.mesh, settings),
                           values(2.0, 3.0, 0.3, 0.7), std::move(u), name + std::to_string(seed));
  }
}

template <class Action>
void for_each_contact(Action&& action, bool with_surroundings = true) {
  for (ContactForm form : all_forms) {
    for (unsigned seed = 31; seed <= 34; ++seed) {
      action(contact_case(form, false, seed));
      if (with_surroundings) action(contact_case(form, true, seed));
    }
  }
}

TEST(Contact, GradientAndHessianAreTheDerivativesOfTheEnergy) {
  for_each_contact([](const TermUnderTest& t) { expect_derivatives(t, 2e-4); });
}

TEST(Contact, ParameterDerivativesAreThoseOfTheGradient) {
  for_each_contact([](const TermUnderTest& t) {
    expect_parameter_derivatives(t, 0.003);
    EXPECT_EQ(t.model.parameter_gradient({t.u, t.p}, other).norm(), 0.0);
    EXPECT_GT(t.model.parameter_gradient({t.u, t.p}, soft).norm(), 0.0);
    EXPECT_GT(t.model.parameter_gradient({t.u, t.p}, hard).norm(), 0.0);
    EXPECT_GT(t.model.parameter_gradient({t.u, t.p}, gap).norm(), 0.0);
    const bool by_length = t.name[0] == '0' || t.name[0] == '3';  // length_weighted and penalty
    EXPECT_EQ(t.model.parameter_gradient({t.u, t.p}, thickness).norm() > 0, by_length);
  });
}

TEST(Contact, HessianIsSymmetric) {
  for_each_contact(expect_symmetric_hessian);
}

TEST(Contact, ProjectedHessianIsPositiveSemiDefiniteWhereTheExactOneIsNot) {
  for_each_contact([](const TermUnderTest& t) {
    const Eigen::MatrixXd exact = hessian_of(t.model, t.u, t.p);
    const Eigen::VectorXd eigenvalues = Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(exact).eigenvalues();
    EXPECT_LT(eigenvalues[0], -1e-6 * eigenvalues.cwiseAbs().maxCoeff()) << t.name << ": the state tests nothing";
    expect_projection_is_semidefinite(t);
  });
}

TEST(Contact, ExertsNoNetForceOrMoment) {
  for_each_contact(expect_no_net_force_or_moment, false);
}

TEST(Contact, APairTakesTheSmallerStiffnessOfItsSides) {
  const TermUnderTest t = contact_case(ContactForm::length_weighted, false, 1);
  const double before = energy_of(t.model, t.u, t.p);
  Params p = t.p;
  p[hard] = p[soft];
  const double all_soft = energy_of(t.model, t.u, p);
  EXPECT_LT(all_soft, before);
  p[hard] = 1e6;  // the hard edges alone touch nothing that is not soft in part
  Params q = t.p;
  q[soft] = 1e6;
  q[hard] = p[soft];
  EXPECT_GT(energy_of(t.model, t.u, p), all_soft);
  q[hard] = 1e6;
  EXPECT_NEAR(energy_of(t.model, t.u, q), all_soft * 1e6 / p[soft], 1e-9 * all_soft * 1e6);
}

// Distances ---------------------------------------------------------------------------------------------------------

/// Gradient and Hessian of f(d) = d and f(d) = d^2 / 2 by Taylor's remainder.
template <class Distance, int n>
void expect_distance_derivatives(const Eigen::Matrix<double, n, 1>& x) {
  using VectorN = Eigen::Matrix<double, n, 1>;
  std::mt19937 random(3);
  const auto at = [](const VectorN& y) {
    if constexpr (n == 4)
      return Distance(y.template head<2>() - y.template tail<2>());
    else
      return Distance(y.template head<2>() - y.template segment<2>(2), y.template tail<2>() - y.template segment<2>(2));
  };
  const Distance distance = at(x);
  for (int k = 0; k < 2; ++k) {
    const double smallest =
        n == 4 ? distance.value
               : std::min(distance.value, (x.template tail<2>() - x.template segment<2>(n / 2 - 1)).norm());
    const VectorN v = 0.5 * smallest * random_vector(n, random);
    const double slope = distance.gradient().dot(v), curvature = v.dot(distance.hessian(1, 0) * v);
    const double square = v.dot(distance.hessian(distance.value, 1) * v);
    const double noise = 1e-15 * x.norm();
    const auto change = [&](double h) { return at(x + h * v).value - distance.value; };
    expect_taylor_order([&](double h) { return std::abs(change(h) - h * slope); }, 2, noise, 0.01);
    expect_taylor_order([&](double h) { return std::abs(change(h) - h * slope - 0.5 * h * h * curvature); }, 3, noise,
                        0.01);
    expect_taylor_order(
        [&](double h) {
          const double d = at(x + h * v).value;
          return std::abs(0.5 * (d * d - distance.value * distance.value) - h * distance.value * slope -
                          0.5 * h * h * square);
        },
        3, noise * distance.value, 0.01);
    expect_taylor_order(
        [&](double h) {
          return (at(x + h * v).gradient() - distance.gradient() - h * distance.hessian(1, 0) * v).norm();
        },
        2, 1e-14, 0.01);
  }
}

TEST(ContactDistance, PointPointAndPointLineDerivativesAreThoseOfTheDistance) {
  std::mt19937 random(5);
  for (int k = 0; k < 40; ++k) {
    const Eigen::Matrix<double, 6, 1> x = random_vector(6, random);
    const Vector r = x.head<2>() - x.segment<2>(2), e = x.tail<2>() - x.segment<2>(2);
    if (PointLineDistance(r, e).value < 0.3 || e.norm() < 0.3) continue;  // smaller ones drown in rounding
    expect_distance_derivatives<PointPointDistance, 4>(Eigen::Vector4d(x.head<4>()));
    expect_distance_derivatives<PointLineDistance, 6>(x);
  }
}

TEST(ContactDistance, TheProjectedHessianIsTheNearestSemiDefiniteOne) {
  std::mt19937 random(6);
  for (int k = 0; k < 50; ++k) {
    const Eigen::VectorXd x = random_vector(6, random), f = random_vector(2, random);
    const PointLineDistance line(x.head<2>() - x.segment<2>(2), x.tail<2>() - x.segment<2>(2));
    const PointPointDistance point(x.head<2>() - x.segment<2>(2));
    const auto clamped = [](const Eigen::MatrixXd& H) -> Eigen::MatrixXd {
      const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(H);
      return eigen.eigenvectors() * eigen.eigenvalues().cwiseMax(0.0).asDiagonal() * eigen.eigenvectors().transpose();
    };
    const Eigen::MatrixXd H = line.hessian(f[0], f[1]), K = point.hessian(f[0], f[1]);
    EXPECT_LE((line.hessian(f[0], f[1], Curvature::projected) - clamped(H)).norm(), 1e-13 * H.norm());
    EXPECT_LE((point.hessian(f[0], f[1], Curvature::projected) - clamped(K)).norm(), 1e-13 * K.norm());
  }
}

TEST(ContactDistance, TheClosestPointOfASegmentIsFoundInAllItsParts) {
  const Vector e(2, 0);
  const auto part = [&](double x, double y) { return closest_on_segment({x, y}, e); };
  EXPECT_EQ(part(-3, 4).part, Closest::Part::first_end);
  EXPECT_DOUBLE_EQ(part(-3, 4).distance, 5);
  EXPECT_EQ(part(5, -4).part, Closest::Part::second_end);
  EXPECT_DOUBLE_EQ(part(5, -4).distance, 5);
  EXPECT_EQ(part(0.5, -4).part, Closest::Part::inside);
  EXPECT_DOUBLE_EQ(part(0.5, -4).distance, 4);
  EXPECT_EQ(part(0.5, -4).normal, Vector(0, -1));
  EXPECT_DOUBLE_EQ(part(1.5, 1e-12).distance, 1e-12);
  EXPECT_EQ(part(1, 0).distance, 0);
  EXPECT_EQ(closest_on_segment({3, 4}, {0, 0}).distance, 5);
}

TEST(ContactBarrier, IsTwiceContinuouslyDifferentiableAndFollowsTheInterfaceLaw) {
  // p / kappa and k_n dhat / kappa at s, from the closed form to three digits.
  const double table[][3] = {{1e-3, .982, .111}, {1e-2, .943, .360}, {0.1, .829, 1.25}, {0.3, .717, 2.40},
                             {1, .532, 5.54},    {3, .320, 15.3},    {10, .122, 84.6}};
  const Barrier b{1e-4, 1};
  for (const auto& [pressure, s, stiffness] : table) {
    double low = 1e-3, high = 1;
    for (int k = 0; k < 200; ++k) (-b.slope(0.5 * (low + high) * b.gap) > pressure ? low : high) = 0.5 * (low + high);
    EXPECT_NEAR(low, s, 6e-4);
    EXPECT_NEAR(b.curvature(low * b.gap) * b.gap, stiffness, 6e-3 * stiffness);
    EXPECT_NEAR(-b.slope(low * b.gap), pressure, 1e-12 * pressure);
  }
  for (int power : {1, 2}) {
    const Barrier c{0.5, power};
    EXPECT_EQ(c.value(0.5), 0);
    EXPECT_EQ(c.slope(0.5), 0);
    EXPECT_EQ(c.curvature(0.5), 0);
    EXPECT_EQ(c.value(0.7), 0);
    EXPECT_LT(c.curvature(0.5 - 1e-9), 1e-7);
    for (double d : {0.01, 0.1, 0.24, 0.26, 0.4, 0.49}) {
      const auto moved = [&](double h) { return Barrier{0.5 + h, power}; };
      expect_taylor_order([&](double h) { return std::abs(c.value(d + h) - c.value(d) - h * c.slope(d)); }, 2, 1e-15,
                          5e-3);
      expect_taylor_order([&](double h) { return std::abs(c.slope(d + h) - c.slope(d) - h * c.curvature(d)); }, 2,
                          1e-14, 5e-3);
      expect_taylor_order([&](double h) { return std::abs(moved(h).slope(d) - c.slope(d) - h * c.slope_by_gap(d)); }, 2,
                          1e-14, 5e-3);
    }
  }
}

TEST(ContactBarrier, KeepsItsDigitsNearTheGap) {
  const Barrier b{1e-4, 1};
  const double below = 1e-8;  // 1 - s; b = dhat below^3 (1 + below / 2 + ...)
  const double d = b.gap * (1 - below), actual = (b.gap - d) / b.gap;
  EXPECT_NEAR(b.value(d) / (b.gap * actual * actual * actual), 1 + actual / 2, 1e-14);
}

// Sums ----------------------------------------------------------------------------------------------------------------

/// Force of an upper face on a lower one at distance s dhat, faces of `cells` cells, 1 m long.
Eigen::VectorXd forces_between(int lower_cells, int upper_cells, double s, Boundary* made = nullptr,
                               double* energy = nullptr) {
  const double dhat = 1e-3;
  const Boundary boundary({straight({0, 0}, {1, 0}, lower_cells), straight({1, s * dhat}, {0, s * dhat}, upper_cells)});
  const Contact contact(boundary.mesh, boundary.settings());
  const Params p = values(50, 50, dhat, 0.03);
  const Eigen::VectorXd u = boundary.rest();
  Eigen::VectorXd gradient = boundary.rest();
  Assembly out;
  out.gradient = &gradient;
  contact.assemble({u, p}, out);
  if (made != nullptr) *made = boundary;
  if (energy != nullptr) *energy = out.energy;
  return gradient;
}

TEST(Contact, LengthWeightedEnergyAndForceBetweenFlatFacesDoNotDependOnTheNumberOfNodes) {
  const double s = 0.6, dhat = 1e-3, pressure = 50 * (2 * (s - 1) * std::log(s) + (s - 1) * (s - 1) / s);
  const double density = -50 * dhat * (s - 1) * (s - 1) * std::log(s);
  for (auto [lower, upper] : {std::array{8, 8}, {8, 16}, {16, 8}, {64, 64}, {10, 27}, {1, 1}}) {
    double energy = 0;
    Boundary boundary({});
    const Eigen::VectorXd f = forces_between(lower, upper, s, &boundary, &energy);
    EXPECT_NEAR(energy, 0.03 * density, 1e-12 * 0.03 * density) << lower << " and " << upper;
    double up = 0, moment = 0;
    for (int node = lower + 1; node < lower + upper + 2; ++node) {
      up -= f[2 * node + 1];
      moment -= f[2 * node + 1] * boundary.mesh.X[2 * node];
    }
    EXPECT_NEAR(up, 0.03 * pressure, 1e-12 * pressure);
    EXPECT_NEAR(moment, 0.5 * 0.03 * pressure, 1e-12 * pressure);
  }
}

TEST(Contact, LengthWeightedPressureBetweenAlignedFlatFacesIsUniform) {
  const double s = 0.4, pressure = 50 * (2 * (s - 1) * std::log(s) + (s - 1) * (s - 1) / s);
  for (int cells : {5, 20}) {
    const Eigen::VectorXd f = forces_between(cells, cells, s);
    for (int node = 0; node <= cells; ++node) {
      const double share = (node == 0 || node == cells ? 0.5 : 1.0) / cells;
      EXPECT_NEAR(f[2 * node + 1], 0.03 * pressure * share, 1e-12 * pressure);
      EXPECT_NEAR(f[2 * node], 0.0, 1e-12 * pressure);
    }
  }
}

TEST(Contact, APlainPairSumDependsOnTheNumberOfNodes) {
  const auto energy = [](int cells) {
    const Boundary boundary({straight({0, 0}, {1, 0}, cells), straight({1, 6e-4}, {0, 6e-4}, cells)});
    const Eigen::VectorXd u = boundary.rest();
    const Params p = values(50, 50, 1e-3, 0.03);
    Assembly out;
    Contact(boundary.mesh, boundary.settings(ContactForm::pair_sum)).assemble({u, p}, out);
    return out.energy;
  };
  EXPECT_GT(energy(16), 1.8 * energy(8));
}

TEST(Contact, ANodeThatSlidesOverAVertexFeelsNothingOfItLengthWeighted) {
  // The lower face has a vertex at x = 0.5; the upper one is shorter, with a vertex that slides over it.
  const double dhat = 0.01;
  for (double x = 0.46; x < 0.55; x += 0.0041) {
    const Boundary boundary({straight({0, 0}, {1, 0}, 2), straight({x + 0.1, 0.005}, {x - 0.1, 0.005}, 2)});
    const Eigen::VectorXd u = boundary.rest();
    const Params p = values(1, 1, dhat, 1);
    Eigen::VectorXd gradient = boundary.rest();
    Assembly out;
    out.gradient = &gradient;
    Contact(boundary.mesh, boundary.settings()).assemble({u, p}, out);
    double along = 0;
    for (int node : {3, 4, 5}) along += gradient[2 * node];
    EXPECT_NEAR(along, 0, 1e-15) << x;
  }
}

TEST(Contact, ObstaclesAndGroundsPressLikeBodies) {
  const double s = 0.6, dhat = 1e-3, pressure = 50 * (2 * (s - 1) * std::log(s) + (s - 1) * (s - 1) / s);
  const Boundary boundary({straight({1, s * dhat}, {0, s * dhat}, 20)});
  for (bool ground : {false, true}) {
    ContactSettings settings = boundary.settings();
    if (ground)
      settings.grounds = {{{0, 0}, {0, 1}}};
    else
      settings.obstacles = {straight({0, 0}, {1, 0}, 31)};
    const Contact contact(boundary.mesh, settings);
    const Params p = values(50, 80, dhat, 0.03);
    const Eigen::VectorXd u = boundary.rest();
    Eigen::VectorXd gradient = boundary.rest();
    Assembly out;
    out.gradient = &gradient;
    contact.assemble({u, p}, out);
    double down = 0;
    for (int node = 0; node <= 20; ++node) down += gradient[2 * node + 1];
    EXPECT_NEAR(-down, 0.03 * pressure, 1e-12 * pressure) << (ground ? "ground" : "obstacle");
  }
}

TEST(Contact, ANodeOnAnEdgeOrBehindAGroundHasInfiniteEnergy) {
  const Boundary boundary({straight({0, 0}, {1, 0}, 1), straight({0.5, 0}, {0.5, 1}, 1)});
  ContactSettings settings = boundary.settings();
  const Params p = values(1, 1, 0.1, 1);
  const Eigen::VectorXd u = boundary.rest();
  Assembly out;
  Contact(boundary.mesh, settings).assemble({u, p}, out);
  EXPECT_EQ(out.energy, std::numeric_limits<double>::infinity());
  const Boundary free({straight({0, 0}, {1, 0}, 1)});
  settings = free.settings();
  settings.grounds = {{{0, 1e-3}, {0, 1}}};
  Assembly behind;
  const Eigen::VectorXd v = free.rest();
  const Contact contact(free.mesh, settings);
  contact.assemble({v, p}, behind);
  EXPECT_EQ(behind.energy, std::numeric_limits<double>::infinity());
  EXPECT_TRUE(contact.intersects(v));
  EXPECT_NEAR(contact.smallest_distance(v, 1), -1e-3, 1e-18);
}

TEST(Contact, APenaltyPressesWithKappaTimesTheDepthWithinTheGapAndPushesBackFromBehindAGround) {
  const double dhat = 1e-3;
  const Params p = values(50, 80, dhat, 0.03);
  for (double s : {0.9, 0.6, 0.01, 0.0, -2.5}) {  // the last one is 2.5 mm behind the ground
    const Boundary boundary({straight({1, s * dhat}, {0, s * dhat}, 20)});
    ContactSettings settings = boundary.settings(ContactForm::penalty);
    settings.grounds = {{{0, 0}, {0, 1}}};
    const Contact contact(boundary.mesh, settings);
    const Eigen::VectorXd u = boundary.rest();
    Eigen::VectorXd gradient = boundary.rest();
    Assembly out;
    out.gradient = &gradient;
    contact.assemble({u, p}, out);
    double down = 0;
    for (int node = 0; node <= 20; ++node) down += gradient[2 * node + 1];
    EXPECT_NEAR(-down, 0.03 * 50 * (1 - s), 1e-12) << s;
    EXPECT_NEAR(out.energy, 0.03 * 50 * 0.5 * dhat * (1 - s) * (1 - s), 1e-15) << s;
    EXPECT_EQ(contact.step_limit({u, p}, Eigen::VectorXd::Constant(u.size(), -1.0)), 1.0) << "nothing stops a step";
  }
}

TEST(Contact, APenaltyHasAFiniteEnergyAndNoForceForANodeRightOnAnEdge) {
  const Boundary boundary({straight({0, 0}, {1, 0}, 1), straight({0.5, 0}, {0.5, 1}, 1)});
  const Params p = values(1, 1, 0.1, 1);
  const Eigen::VectorXd u = boundary.rest();
  Eigen::VectorXd gradient = boundary.rest();
  Assembly out;
  out.gradient = &gradient;
  Contact(boundary.mesh, boundary.settings(ContactForm::penalty)).assemble({u, p}, out);
  EXPECT_NEAR(out.energy, 0.5 * 0.5 * 0.05, 1e-15) << "half of the length of one edge, half of the other side";
  EXPECT_EQ(gradient.norm(), 0.0);
}

// Search --------------------------------------------------------------------------------------------------------------

/// Rings of different fineness side by side, an obstacle around them and one between, moved at random.
struct Crowd {
  Boundary boundary;
  ContactSettings settings;
  explicit Crowd(unsigned seed, double distance = 0.02, bool surroundings = true) : boundary(rings(seed, distance)) {
    settings = boundary.settings();
    if (!surroundings) return;
    settings.obstacles = {ring({0.5, 0.5}, 1.6, 40), {{-0.6, -0.3}, {-0.5, 0.5}, {-0.9, 0.7}}};
    settings.grounds = {{{0, -1.2}, Vector(0.1, 1).normalized()}};
  }
  static std::vector<Polyline> rings(unsigned seed, double distance) {
    std::vector<Polyline> lines;
    for (int i = 0; i < 2; ++i) {
      for (int j = 0; j < 2; ++j) {
        lines.push_back(
            ring(Vector(i, j), 0.5 * (1 - distance), 5 + 7 * (i + 2 * j) + static_cast<int>(seed % 5), 0.1 * i + seed));
      }
    }
    return lines;
  }
};

/// A smooth motion plus noise, of size 1.
Eigen::VectorXd random_motion(const Mesh& mesh, std::mt19937& random, double noise) {
  const Eigen::VectorXd a = random_vector(10, random);
  Eigen::VectorXd motion = noise * random_vector(mesh.X.size(), random);
  for (int i = 0; i < mesh.node_count(); ++i) {
    const double x = mesh.X[2 * i], y = mesh.X[2 * i + 1];
    motion[2 * i] += a[0] + a[1] * x + a[2] * y + a[3] * std::sin(4 * x + a[4]);
    motion[2 * i + 1] += a[5] + a[6] * x + a[7] * y + a[8] * std::sin(4 * y + a[9]);
  }
  return motion;
}

TEST(Contact, BroadPhaseFindsWhatAllPairsFind) {
  std::mt19937 random(2);
  size_t found = 0;
  for (unsigned seed = 0; seed < 300; ++seed) {
    const Crowd crowd(seed, 0.02 * (seed % 3));
    const Contact contact(crowd.boundary.mesh, crowd.settings);
    const Eigen::VectorXd u = 0.1 * (seed % 7) * random_motion(crowd.boundary.mesh, random, 0.1);
    const Params p = values(1, 1, std::pow(10.0, -(seed % 4) / 2.0 - 0.5), 1);
    const auto fast = contact.active_pairs({u, p}), slow = contact.active_pairs({u, p}, true);
    ASSERT_EQ(fast.size(), slow.size());
    for (size_t k = 0; k < fast.size(); ++k) {
      ASSERT_EQ(fast[k].node, slow[k].node);
      ASSERT_EQ(fast[k].edge, slow[k].edge);
      ASSERT_EQ(fast[k].distance, slow[k].distance);
    }
    double smallest = std::numeric_limits<double>::infinity();
    for (const ContactPair& pair : slow) smallest = std::min(smallest, pair.distance);
    EXPECT_EQ(contact.smallest_distance(u, p[gap]), smallest);
    found += fast.size();
  }
  EXPECT_GT(found, 20000u);
}

/// All distances between nodes and edges that they do not belong to, and to grounds, in a fixed order.
std::vector<double> all_distances(const Contact& contact, const Eigen::VectorXd& u) {
  std::vector<double> distances;
  const Params p = values(1, 1, 1e9, 1);
  for (const ContactPair& pair : contact.active_pairs({u, p}, true)) distances.push_back(pair.distance);
  return distances;
}

TEST(Contact, NothingEverPassesThroughAnythingWithinTheStepLimit) {
  std::mt19937 random(8);
  int limited = 0, steps = 0;
  const Params p = values(1, 1, 0.1, 1);
  for (unsigned seed = 0; seed < 150; ++seed) {
    const Crowd crowd(seed, seed % 2 == 0 ? 0.02 : 1e-5, seed % 3 != 0);
    const Contact contact(crowd.boundary.mesh, crowd.settings);
    Eigen::VectorXd u = crowd.boundary.rest();
    ASSERT_FALSE(contact.intersects(u)) << seed;
    for (int k = 0; k < 30; ++k) {
      const double size = std::pow(10.0, -static_cast<int>(random() % 4));
      const Eigen::VectorXd step = size * random_motion(crowd.boundary.mesh, random, k % 3 == 0 ? 0.3 : 0.01);
      const double limit = contact.step_limit({u, p}, step);
      ASSERT_GE(limit, 0.0);
      ASSERT_LE(limit, 1.0);
      Eigen::VectorXd next = u + limit * step;
      ASSERT_FALSE(contact.intersects(next)) << "seed " << seed << ", step " << k << ", limit " << limit;
      ASSERT_FALSE(contact.intersects(u + 0.5 * limit * step));
      u.swap(next);
      if (k % 5 == 4) u.setZero();
      limited += limit < 1;
      ++steps;
      if (k % 5 != 1) continue;
      // Distances keep a tenth of the smallest clearance; a limit below 1 has a reason.
      const std::vector<double> before = all_distances(contact, next), after = all_distances(contact, u);
      double left = 1;
      for (size_t i = 0; i < before.size(); ++i) left = std::min(left, after[i] / before[i]);
      ASSERT_GE(*std::min_element(after.begin(), after.end()),
                0.1 * *std::min_element(before.begin(), before.end()) - 1e-15);
      ASSERT_TRUE(limit == 1 || left < 0.2 + 1e-6) << "seed " << seed << ", step " << k << ", limit " << limit;
    }
  }
  EXPECT_GT(limited, steps / 4);
  EXPECT_LT(limited, steps * 9 / 10);
}

TEST(Contact, StepLimitHoldsInGapsOfTenNanometresAtCoordinatesOfCentimetres) {
  std::mt19937 random(4);
  std::normal_distribution<double> normal;
  const Params p = values(1, 1, 1e-6, 1);
  for (int trial = 0; trial < 200; ++trial) {
    const double distance = trial % 2 == 0 ? 1e-7 : 1e-8, angle = normal(random);
    const Vector along(std::cos(angle), std::sin(angle)), up(-along[1], along[0]), corner(0.06, -0.02);
    const Boundary boundary({straight(corner, corner + 5e-3 * along, 10),
                             straight(corner + distance * up + 4.7e-3 * along, corner + distance * up, 11)});
    const Contact contact(boundary.mesh, boundary.settings());
    const auto moved = [&](const Vector& by, double noise) {
      Eigen::VectorXd step = noise * random_vector(boundary.mesh.X.size(), random);
      for (int node = 11; node < 23; ++node) step.segment<2>(2 * node) += by;
      return step;
    };
    Eigen::VectorXd u = boundary.rest();
    ASSERT_FALSE(contact.intersects(u));
    EXPECT_NEAR(contact.smallest_distance(u, 1e-6), distance, 1e-16);
    EXPECT_EQ(contact.step_limit({u, p}, moved(1e-3 * along, 0)), 1.0) << "sliding along is free";
    EXPECT_EQ(contact.step_limit({u, p}, moved(1e-2 * up, 0)), 1.0) << "parting is free";
    EXPECT_NEAR(contact.step_limit({u, p}, moved(-2 * distance * up, 0)), 0.45, 0.05 + 1e-6);
    for (int k = 0; k < 8; ++k) {
      const Eigen::VectorXd step = moved(1e-6 * Vector(normal(random), normal(random)), 1e-8);
      u += contact.step_limit({u, p}, step) * step;
      ASSERT_FALSE(contact.intersects(u)) << trial << ", " << k;
      if (k % 4 == 3) u.setZero();
    }
  }
}

TEST(Contact, StepLimitLetsANodeThroughNoNeighbouringEdge) {
  // A bent line whose end is driven through the edge after the next, and a corner that folds flat.
  const Boundary boundary({{{0, 0}, {1, 0}, {1, 1}, {0.5, 0.5}}});
  const Contact contact(boundary.mesh, boundary.settings());
  const Params p = values(1, 1, 0.1, 1);
  const Eigen::VectorXd u = boundary.rest();
  Eigen::VectorXd step = boundary.rest();
  step[7] = -2;
  EXPECT_NEAR(contact.step_limit({u, p}, step), 0.225, 0.0251);
  EXPECT_TRUE(contact.intersects(u + step));
  step.setZero();
  step[5] = -3;
  EXPECT_LT(contact.step_limit({u, p}, step), 1.0);
}

TEST(Contact, StepLimitIsZeroForStepsThatAreNotFinite) {
  const Crowd crowd(1);
  const Contact contact(crowd.boundary.mesh, crowd.settings);
  Eigen::VectorXd step = crowd.boundary.rest();
  const Eigen::VectorXd u = crowd.boundary.rest();
  const Params p = values(1, 1, 0.1, 1);
  EXPECT_EQ(contact.step_limit({u, p}, step), 1.0);
  step[3] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(contact.step_limit({u, p}, step), 0.0);
  step[3] = std::numeric_limits<double>::infinity();
  EXPECT_EQ(contact.step_limit({u, p}, step), 0.0);
}

TEST(Contact, IntersectionsAreExact) {
  const auto crosses = [](const std::vector<Polyline>& lines) {
    const Boundary boundary(lines);
    return Contact(boundary.mesh, boundary.settings()).intersects(boundary.rest());
  };
  EXPECT_TRUE(crosses({{{0, 0}, {1, 1}}, {{0, 1}, {1, 0}}}));
  EXPECT_FALSE(crosses({{{0, 0}, {1, 1}}, {{0, 1}, {0.4, 0.6}}}));
  EXPECT_TRUE(crosses({{{0, 0}, {1, 1}}, {{0, 1}, {0.5, 0.5}}})) << "touching counts";
  const double least = 0.5 - std::ldexp(1, -54);  // the next double below
  EXPECT_FALSE(crosses({{{0, 0}, {1, 1}}, {{0, 1}, {least, 0.5}}}));
  EXPECT_TRUE(crosses({{{0, 0}, {1, 1}}, {{0, 1}, {0.5, least}}}));
  EXPECT_TRUE(crosses({{{0, 0}, {2, 0}}, {{1, 0}, {3, 0}}})) << "on one line, overlapping";
  EXPECT_FALSE(crosses({{{0, 0}, {1, 0}}, {{2, 0}, {3, 0}}})) << "on one line, apart";
  EXPECT_FALSE(crosses({{{0, 0}, {1, 0}, {2, 0}}})) << "neighbours share their node";
  EXPECT_TRUE(crosses({{{0, 0}, {1, 0}, {0.5, 0}}})) << "a neighbour that lies on the other";
  EXPECT_FALSE(crosses({ring({0, 0}, 1, 50), ring({0, 0}, 0.5, 30)}));
}

TEST(ContactDistance, OrientationIsExactAtTheLastBit) {
  // Points of a grid of one unit in the last place around a line: integers tell the sign.
  for (int i = 0; i < 16; ++i) {
    for (int j = 0; j < 16; ++j) {
      const double ulp = std::ldexp(1.0, -53);
      const Vector a(0.5 + i * ulp, 0.5 + j * ulp), b(12, 12), c(24, 24);
      EXPECT_EQ(orientation(a, b, c), i == j ? 0 : i < j ? 1 : -1) << i << ", " << j;
      EXPECT_EQ(orientation(b, a, c), -orientation(a, b, c));
    }
  }
}

TEST(Contact, EdgesOfAMeshAreItsBoundaryWithTheBodyOnTheirLeft) {
  for (int order : {1, 2}) {
    const Mesh mesh = rectangle(graded(2, 4), graded(1, 3), order, "body");
    const auto edges = contact_edges(mesh);
    EXPECT_EQ(edges.size(), 14u * order);
    double area = 0;
    std::set<int> nodes;
    for (const auto& [a, b] : edges) {
      const Eigen::VectorXd x = mesh.node(a), y = mesh.node(b);
      area += 0.5 * (x[0] * y[1] - x[1] * y[0]);
      nodes.insert({a, b});
    }
    EXPECT_NEAR(area, 2.0, 1e-14);
    EXPECT_EQ(nodes.size(), edges.size());
  }
}

TEST(Contact, WrongSurroundingsAreRefused) {
  const Boundary boundary({straight({0, 0}, {1, 0}, 2)});
  ContactSettings settings = boundary.settings();
  settings.obstacles = {{{0, 1}}};
  expect_input_error([&] { Contact(boundary.mesh, settings); }, {"obstacle 1 has 1 points", "at least 2"});
  settings.obstacles = {{{0, 1}, {1, 1}, {1, 1}}};
  expect_input_error([&] { Contact(boundary.mesh, settings); }, {"points 2 and 3 of obstacle 1", "remove one"});
  settings.obstacles.clear();
  settings.grounds = {{{0, -1}, {0, 0}}};
  expect_input_error([&] { Contact(boundary.mesh, settings); }, {"ground 1", "normal"});
  settings = boundary.settings();
  settings.edges[0][0] = 7;
  EXPECT_THROW(Contact(boundary.mesh, settings), std::logic_error);
}

}  // namespace
}  // namespace taut
