#include <ceres/jet.h>
#include <gtest/gtest.h>

#include "sim/materials/all.hpp"
#include "sim/mesh/shape_functions.hpp"
#include "sim/solve/equilibrium.hpp"
#include "sim/terms/load.hpp"
#include "sim/terms/solid.hpp"
#include "tests/support/taylor.hpp"
#include "tests/support/term_battery.hpp"

// A smooth large displacement is chosen, the body force that holds it is computed from the divergence of the material's
// own stress by automatic differentiation, and the solver must find the displacement with the order of its elements.
namespace taut {
namespace {

using namespace test;

constexpr double modulus = 10.0;

/// A number without infinitesimal parts, of whatever depth of jets T is.
template <class T>
T constant(double value) {
  if constexpr (std::is_same_v<T, double>) {
    return value;
  } else {
    T jet;
    jet.a = constant<decltype(jet.a)>(value);
    return jet;
  }
}

/// u(X), in metres on the unit square or cube; gradients up to 0.4.
template <class T, int D>
Eigen::Matrix<T, D, 1> displacement(const Eigen::Matrix<T, D, 1>& X) {
  using std::cos;
  using std::sin;
  constexpr auto c = constant<T>;
  Eigen::Matrix<T, D, 1> u;
  u[0] = c(0.1) * sin(c(2.0) * X[1]) + c(0.08) * X[0] * X[0];
  u[1] = c(0.1) * cos(c(2.5) * X[0]) - c(0.1) * X[0] * X[1];
  if constexpr (D == 3) {
    u[0] += c(0.1) * sin(c(1.5) * X[2]);
    u[2] = c(0.08) * sin(c(2.0) * X[0] + X[1]) + c(0.1) * X[2] * X[1];
  }
  return u;
}

/// b = -Div P of the chosen displacement [N/m^3], by jets of jets.
template <int D>
Eigen::Matrix<double, D, 1> body_force(const Eigen::Matrix<double, D, 1>& X, double nu) {
  using Outer = ceres::Jet<double, D>;
  using Inner = ceres::Jet<Outer, D>;
  const NeoHookean<Outer> material(std::array<Outer, 2>{Outer(modulus), Outer(nu)});
  Eigen::Matrix<Inner, D, 1> x;
  for (int i = 0; i < D; ++i) {
    x[i].a = Outer(X[i], i);
    for (int j = 0; j < D; ++j) x[i].v[j] = Outer(i == j ? 1.0 : 0.0);
  }
  const Eigen::Matrix<Inner, D, 1> u = displacement<Inner, D>(x);
  Tensor<Outer, D> H;
  for (int i = 0; i < D; ++i) {
    for (int J = 0; J < D; ++J) H(i, J) = u[i].v[J];
  }
  const Tensor<Outer, D> P = material.stress(H);
  Eigen::Matrix<double, D, 1> b = Eigen::Matrix<double, D, 1>::Zero();
  for (int i = 0; i < D; ++i) {
    for (int J = 0; J < D; ++J) b[i] -= P(i, J).v[J];
  }
  return b;
}

/// A point of the reference simplex and its weight.
template <int D>
struct Sample {
  Eigen::Matrix<double, D, 1> xi;
  double weight;
};

/// Gauss's five points along each collapsed coordinate of the simplex (Duffy): exact for polynomials of degree 7, far
/// beyond the elements' own rules.
template <int D>
std::vector<Sample<D>> fine_rule() {
  constexpr double points[] = {-0.9061798459386640, -0.5384693101056831, 0, 0.5384693101056831, 0.9061798459386640};
  constexpr double weights[] = {0.2369268850561891, 0.4786286704993665, 0.5688888888888889, 0.4786286704993665,
                                0.2369268850561891};
  std::vector<Sample<D>> rule;
  for (int k = 0; k < (D == 2 ? 25 : 125); ++k) {
    Sample<D> sample{.xi = {}, .weight = 1};
    double rest = 1;
    for (int i = 0, digit = k; i < D; ++i, digit /= 5) {
      sample.xi[i] = 0.5 * (1 + points[digit % 5]) * rest;
      sample.weight *= 0.5 * weights[digit % 5] * rest;
      rest -= sample.xi[i];
    }
    rule.push_back(sample);
  }
  return rule;
}

/// Calls visit(element's nodes, X, shape functions, volume) at the points of the fine rule in each straight-sided
/// element.
template <ElementShape S, class Visit>
void integrate(const Mesh& mesh, Visit&& visit) {
  constexpr int D = dimension_of(S);
  const std::vector<Sample<D>> rule = fine_rule<D>();
  for (int e = 0; e < mesh.element_count(); ++e) {
    const int* nodes = mesh.element(e);
    Eigen::Matrix<double, D, D> edges;
    for (int a = 0; a < D; ++a) edges.col(a) = mesh.node(nodes[a + 1]) - mesh.node(nodes[0]);
    for (const Sample<D>& sample : rule) {
      const Eigen::Matrix<double, D, 1> X = mesh.node(nodes[0]) + edges * sample.xi;
      visit(nodes, X, ReferenceElement<S>::values(sample.xi), sample.weight * edges.determinant());
    }
  }
}

template <ElementShape S>
Mesh unit_mesh(int cells) {
  constexpr int D = dimension_of(S), order = order_of(S);
  Mesh mesh = D == 2 ? rectangle(graded(1, cells), graded(1, cells), order, "body")
                     : box(graded(1, cells), graded(1, cells), graded(1, cells), order, "body");
  map_vertices(mesh, [](const Eigen::VectorXd& X) -> Eigen::VectorXd {
    Eigen::VectorXd moved = X;
    moved[0] += 0.08 * std::sin(3.14159265358979 * X[1]) * X[0] * (1 - X[0]);
    return moved;
  });
  return mesh;
}

/// L2 norm of the error of the solution on `cells` cells per side; the displacement is prescribed on the boundary.
template <ElementShape S>
double error_of(int cells, double nu, Formulation formulation) {
  constexpr int D = dimension_of(S);
  using Vector = Eigen::Matrix<double, D, 1>;
  Mesh mesh = unit_mesh<S>(cells);
  ParameterTable table;
  SolidDefinition definition;
  for (const ParameterSpec& spec : material_parameters("neo_hookean"))
    definition.parameters.push_back(table.declare(spec));
  const int control = table.declare({"s", "s", "1", 0, 1, "fraction of the load", false});
  definition.formulation = formulation;

  Eigen::VectorXd weights = Eigen::VectorXd::Zero(mesh.X.size());
  integrate<S>(mesh, [&](const int* nodes, const Vector& X, const auto& N, double volume) {
    const Vector b = body_force<D>(X, nu);
    for (int a = 0; a < N.size(); ++a) weights.segment<D>(nodes[a] * D) += volume * N[a] * b;
  });
  std::vector<Support> supports;
  for (int node : boundary(mesh).nodes()) {
    const Vector u = displacement<double, D>(Vector(mesh.node(node)));
    for (int i = 0; i < D; ++i) supports.push_back({node * D + i, control, u[i]});
  }
  std::vector<std::unique_ptr<Term>> terms;
  terms.push_back(make_solid(mesh, definition));
  terms.push_back(make_load(weights, {control}));
  const Model model(std::move(mesh), std::move(table), std::move(terms), std::move(supports));
  Equilibrium equilibrium(model);
  equilibrium.start_at_rest(Eigen::Vector3d(modulus, nu, 0));
  EXPECT_EQ(equilibrium.solve(Eigen::Vector3d(modulus, nu, 1)).status, SolveStatus::converged)
      << equilibrium.report().message();

  double squared = 0;
  integrate<S>(model.mesh(), [&](const int* nodes, const Vector& X, const auto& N, double volume) {
    Vector u = -displacement<double, D>(X);
    for (int a = 0; a < N.size(); ++a) u += N[a] * equilibrium.u().segment<D>(nodes[a] * D);
    squared += volume * u.squaredNorm();
  });
  return std::sqrt(squared);
}

template <ElementShape S>
void expect_order(double order, const std::vector<int>& cells, double nu = 0.3,
                  Formulation formulation = Formulation::standard) {
  std::vector<double> sizes, errors;
  for (int n : cells) {
    sizes.push_back(1.0 / n);
    errors.push_back(error_of<S>(n, nu, formulation));
  }
  const size_t last = cells.size() - 1;
  const double observed = log_slope({sizes[last - 1], sizes[last]}, {errors[last - 1], errors[last]});
  ::testing::Test::RecordProperty(std::string(name_of(S)) + "_order", std::to_string(observed));
  EXPECT_NEAR(observed, order, 0.15) << name_of(S) << ", nu = " << nu << ", error " << errors[last];
  EXPECT_LT(errors[last], errors.front());
}

TEST(ManufacturedSolution, TheRuleIntegratesTheUnitCell) {
  double area = 0, volume = 0, moment = 0;
  integrate<ElementShape::tri6>(unit_mesh<ElementShape::tri6>(2),
                                [&](const int*, const auto&, const auto&, double w) { area += w; });
  integrate<ElementShape::tet10>(unit_mesh<ElementShape::tet10>(2),
                                 [&](const int*, const auto& X, const auto&, double w) {
                                   volume += w;
                                   moment += w * X[2] * X[2];
                                 });
  EXPECT_NEAR(area, 1.0, 1e-14);
  EXPECT_NEAR(volume, 1.0, 1e-14);
  EXPECT_NEAR(moment, 1.0 / 3, 1e-14);
}

TEST(ManufacturedSolution, LinearTrianglesConvergeWithOrderTwo) {
  expect_order<ElementShape::tri3>(2, {8, 16, 32});
}

TEST(ManufacturedSolution, QuadraticTrianglesConvergeWithOrderThree) {
  expect_order<ElementShape::tri6>(3, {4, 8, 16});
}

TEST(ManufacturedSolution, LinearTetrahedraConvergeWithOrderTwo) {
  expect_order<ElementShape::tet4>(2, {4, 8});
}

TEST(ManufacturedSolution, QuadraticTetrahedraConvergeWithOrderThree) {
  expect_order<ElementShape::tet10>(3, {3, 6});
}

TEST(ManufacturedSolution, LockingFreeElementsConvergeWithOrderTwo) {
  expect_order<ElementShape::tri6>(2, {8, 16, 32}, 0.3, Formulation::locking_free);
  expect_order<ElementShape::tet10>(2, {3, 6}, 0.3, Formulation::locking_free);
}

}  // namespace
}  // namespace taut
