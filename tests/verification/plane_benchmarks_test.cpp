#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "tests/support/mesh_checks.hpp"
#include "tests/support/problems.hpp"

// Problems A1 to A4 against values on which an independent program and a public finite-element package agree.
// Tolerances are the uncertainties stated with the values and half a unit of their last digit.
namespace taut {
namespace {

using namespace test;

/// Tip displacements [mm] at increasing forces, each solved from the one before.
std::vector<double> tips(const Problem& problem, const std::vector<double>& forces) {
  Equilibrium equilibrium(*problem.scene.model);
  equilibrium.start_at_rest(problem.scene.values);
  std::vector<double> found;
  Params p = problem.scene.values;
  for (double force : forces) {
    p[problem.force] = force;
    EXPECT_EQ(equilibrium.solve(p).status, SolveStatus::converged) << equilibrium.report().message();
    found.push_back(1e3 * problem.tip.dot(equilibrium.u()));
  }
  return found;
}

/// Limit of values on meshes of sizes h, h/2, h/4, ...: Aitken's extrapolation, which finds the order for itself, and
/// again on its results while there are three.
double limit_of(std::vector<double> values) {
  while (values.size() >= 3) {
    std::vector<double> better;
    for (size_t k = 2; k < values.size(); ++k) {
      const double last = values[k] - values[k - 1], ratio = (values[k - 1] - values[k - 2]) / last;
      better.push_back(values[k] + last / (ratio - 1));
    }
    values = std::move(better);
  }
  return values.back();
}

struct Known {
  double force, tip, uncertainty, last_digit;  ///< [N], [mm]
};

/// Extrapolates from meshes of `cells`, each twice the one before, and compares.
void expect_limits(const std::vector<Known>& table, const std::vector<int>& cells,
                   const std::function<Problem(int)>& make) {
  std::vector<double> forces;
  for (const Known& row : table) forces.push_back(row.force);
  std::vector<std::vector<double>> found;
  for (int n : cells) found.push_back(tips(make(n), forces));
  for (size_t i = 0; i < table.size(); ++i) {
    std::vector<double> values;
    for (const auto& mesh : found) values.push_back(mesh[i]);
    EXPECT_NEAR(limit_of(values), table[i].tip, table[i].uncertainty + 0.5 * table[i].last_digit)
        << table[i].force << " N";
  }
}

struct Error {
  int cells;
  double percent, tolerance;  ///< half a unit of the printed digit
};

void expect_errors(const std::vector<Error>& table, double force, double exact,
                   const std::function<Problem(int)>& make) {
  for (const Error& row : table) {
    EXPECT_NEAR(100 * (tips(make(row.cells), {force})[0] / exact - 1), row.percent, row.tolerance)
        << row.cells << " cells";
  }
}

/// A1 with n cells through the height and two along for each.
Problem a1(int n, int order) {
  return cantilever(0.055, 0.030, 1e5, 0.3, 2 * n, n, order);
}

TEST(Cantilever, TipIsTheKnownOne) {
  expect_limits(
      {{0.25, 2.30412, 1e-5, 1e-5}, {0.5, 4.59554, 1e-5, 1e-5}, {1.0, 9.0920, 1e-4, 1e-4}, {1.5, 13.403, 1e-3, 1e-3}},
      {10, 20, 40}, [](int n) { return a1(n, 2); });
}

TEST(Cantilever, LinearTrianglesAreTooStiffByTheKnownAmount) {
  expect_errors({{2, -31, .5}, {4, -12.5, .05}, {10, -2.6, .05}, {20, -0.8, .05}, {40, -0.24, .005}}, 1.0, 9.0920,
                [](int n) { return n == 2 ? a1(n, 1) : problem_a1(n, 1); });
}

TEST(Cantilever, QuadraticTrianglesAreTooStiffByTheKnownAmount) {
  expect_errors({{2, -1.4, .05}, {4, -0.5, .05}, {10, -0.13, .005}, {20, -0.05, .005}, {40, -0.02, .005}}, 1.0, 9.0920,
                [](int n) { return n == 2 ? a1(n, 2) : problem_a1(n, 2); });
}

/// A2: force of alpha = F L^2 / B.
double slender_force(double alpha, double E, double nu, double L, double H) {
  return alpha * E / (1 - nu * nu) * 0.030 * H * H * H / 12 / (L * L);
}

TEST(SlenderCantilever, SolidHasTheKnownDrop) {
  const double L = 0.2, H = 0.005, mm = 1e3 * L;  // from drop/L to [mm]
  const double alpha[] = {0.5, 1, 2, 4, 7, 10}, drop[] = {0.16211, 0.30169, 0.49353, 0.67028, 0.76798, 0.81147};
  std::vector<Known> table;
  for (size_t i = 0; i < 6; ++i)
    table.push_back({slender_force(alpha[i], 1e6, 0.3, L, H), drop[i] * mm, 1e-5 * mm, 1e-5 * mm});
  expect_limits(table, {2, 4, 8}, [&](int n) { return cantilever(L, H, 1e6, 0.3, 40 * n, n, 2); });
}

TEST(SlenderCantilever, TrianglesAreTooStiffByTheKnownAmount) {
  const double exact = 0.30169 * 200, force = slender_force(1, 1e6, 0.3, 0.2, 0.005);
  const auto make = [](int order) {
    return [order](int n) { return cantilever(0.2, 0.005, 1e6, 0.3, 40 * n, n, order); };
  };
  expect_errors({{1, -67, .5}, {2, -32, .5}, {4, -11, .5}, {8, -2.9, .05}, {16, -0.7, .05}}, force, exact, make(1));
  expect_errors({{1, -0.3, .05}, {2, -0.07, .005}, {4, -0.02, .005}}, force, exact, make(2));
}

TEST(SlenderCantilever, ApproachesTheElasticaAsItGetsThin) {
  // nu = 0 leaves stretch and shear, of order (H/L)^2, between the solid and the elastica: extrapolated from two
  // heights.
  const double L = 0.2;
  const double alpha[] = {0.5, 1, 2, 4, 7, 10};
  const double elastica[] = {0.1621436, 0.3017208, 0.4934575, 0.6699642, 0.7673691, 0.8106090};
  std::vector<double> drops[2];
  for (int k : {0, 1}) {
    const double H = k == 0 ? 0.008 : 0.004;
    std::vector<double> forces;
    for (double a : alpha) forces.push_back(slender_force(a, 1e6, 0.0, L, H));
    drops[k] = tips(cantilever(L, H, 1e6, 0.0, 80, 2, 2), forces);
  }
  for (size_t i = 0; i < 6; ++i) {
    EXPECT_NEAR(1e-3 * (4 * drops[1][i] - drops[0][i]) / 3 / L, elastica[i], 5e-6) << "alpha = " << alpha[i];
    EXPECT_GT(1e-3 * drops[1][i] / L, elastica[i]);
  }
}

TEST(LayeredBlock, TrianglesAreTooStiffByTheKnownAmount) {
  // The values tabulated come from other diagonals; a twentieth of each is left for that.
  expect_errors({{1, -9.5, .5}, {2, -2.9, .15}, {4, -1, .05}, {8, -0.3, .05}}, 1.0, 7.8410,
                [](int n) { return problem_a3(n, 1); });
  expect_errors({{1, -1.35, .07}, {2, -0.27, .02}, {4, -0.08, .005}, {8, -0.03, .005}}, 1.0, 7.8410,
                [](int n) { return problem_a3(n, 2); });
}

TEST(SlowLayeredBlock, TipIsTheKnownOne) {
  expect_limits(
      {{0.1, 0.79553, 1e-5, 1e-5}, {0.25, 1.98727, 2e-5, 1e-5}, {0.5, 3.96344, 3e-5, 1e-5}, {1.0, 7.8410, 2e-4, 1e-4}},
      {4, 8, 16}, [](int n) { return problem_a3(n, 2); });
}

TEST(CookMembrane, LinearTrianglesLockByTheKnownAmount) {
  // All diagonals fall; rising ones lock worse and alternating ones much less.
  const auto with = [](Diagonals diagonals) {
    return [=](int n) { return problem_a4(n, 1, 0.4999, Formulation::standard, 1, diagonals); };
  };
  expect_errors({{8, -47, .5}, {16, -43, .5}, {32, -36, .5}, {64, -24, .5}}, 100, 6.9546, with(Diagonals::falling));
  EXPECT_LT(tips(with(Diagonals::rising)(16), {100})[0], 0.4 * 6.9546);
  EXPECT_GT(tips(with(Diagonals::alternating)(16), {100})[0], 0.9 * 6.9546);
}

TEST(CookMembrane, QuadraticTrianglesErrByNoMoreThanTheKnownAmount) {
  // Tabulated with a finer rule than three points, which lets the element change its volume a little more easily.
  struct {
    int n;
    double percent;
  } const table[] = {{8, -1.9}, {16, -0.8}, {32, -0.4}};
  for (const auto& [n, percent] : table) {
    const Problem problem = problem_a4(n, 2, 0.4999, Formulation::standard, 1, Diagonals::falling);
    const double error = 100 * (tips(problem, {100})[0] / 6.9546 - 1);
    EXPECT_GT(error, percent) << n;
    EXPECT_LT(error, 0.7 * percent) << n;
  }
}

TEST(CookMembrane, LockingFreeTrianglesAreRightOnCoarseMeshes) {
  struct {
    int n;
    double percent;
  } const table[] = {{8, 0.5}, {16, 0.12}, {32, 0.03}};
  for (const auto& [n, percent] : table) {
    const double found = tips(problem_a4(n, 2, 0.4999, Formulation::locking_free), {100})[0];
    EXPECT_LT(100 * std::abs(found / 6.9546 - 1), percent) << n;
  }
}

TEST(SlowCookMembrane, TipOfTheCompressibleOneIsTheKnownOne) {
  expect_limits({{25, 2.20772, 1e-5, 1e-5}, {50, 4.25401, 1e-5, 1e-5}, {100, 7.8777, 1e-4, 1e-4}}, {8, 16, 32, 64, 128},
                [](int n) { return problem_a4(n, 2, 0.3); });
}

TEST(SlowCookMembrane, TipOfTheNearlyIncompressibleOneIsTheKnownOne) {
  expect_limits({{25, 1.88250, 3e-5, 1e-5}, {50, 3.6693, 1e-4, 1e-4}, {100, 6.9546, 3e-4, 1e-4}}, {32, 64, 128},
                [](int n) { return problem_a4(n, 2, 0.4999, Formulation::locking_free, 4); });
}

}  // namespace
}  // namespace taut
