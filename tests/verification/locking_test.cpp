#include <gtest/gtest.h>

#include <cmath>

#include "tests/support/mesh_checks.hpp"
#include "tests/support/problems.hpp"

// A solid slab between two slippery walls is in plane strain: tetrahedra against fine triangles.
namespace taut {
namespace {

using namespace test;

/// Half of cantilever A1 (15 mm wide, so half the force) with n cells through the height.
Problem slab(int n, double nu, Formulation formulation) {
  SceneBuilder builder(box(graded(0.055, 2 * n), graded(0.030, n), graded(0.015, std::max(1, n / 2)), 2, "beam"));
  builder.add_solid("beam", "neo_hookean", {{"E", 1e5}, {"nu", nu}}, formulation);
  Problem problem;
  builder.fix("xmin", {0, 1});
  builder.fix("zmin", {2});
  builder.fix("zmax", {2});
  problem.force = builder.declare({"force", "F", "N", -1e6, 1e6, "load on the tip", false}, 0.0);
  builder.add_force("xmax", vec({0, -1, 0}), problem.force);
  problem.tip = mean_weights(builder.mesh(), builder.mesh().select("xmax"), vec({0, -1, 0}));
  problem.scene = builder.build();
  return problem;
}

/// Relative error of the slab's tip at 1 N per 30 mm.
double slab_error(int n, double nu, Formulation formulation, double exact) {
  SolveReport report;
  const double tip = tip_at(slab(n, nu, formulation), 0.5, &report);
  EXPECT_EQ(report.status, SolveStatus::converged) << report.message();
  return tip / exact - 1;
}

/// The same by fine locking-free triangles, extrapolated (order 2).
double plane_tip(double nu) {
  const auto tip = [&](int n) {
    return tip_at(cantilever(0.055, 0.030, 1e5, nu, 2 * n, n, 2, 1, Formulation::locking_free), 1.0);
  };
  const double coarse = tip(16), fine = tip(32);
  EXPECT_LT(std::abs(fine / coarse - 1), 1e-3);
  return fine + (fine - coarse) / 3;
}

TEST(Locking, ANearlyIncompressibleSlabIsRightWithLockingFreeTetrahedraAndTooStiffWithStandardOnes) {
  for (double nu : {0.499, 0.4999}) {
    const double exact = plane_tip(nu);
    EXPECT_LT(slab_error(3, nu, Formulation::standard, exact), -0.04) << nu;
    EXPECT_LT(slab_error(6, nu, Formulation::standard, exact), -0.01) << nu;
    EXPECT_NEAR(slab_error(3, nu, Formulation::locking_free, exact), 0, 0.015) << nu;
    EXPECT_NEAR(slab_error(6, nu, Formulation::locking_free, exact), 0, 0.005) << nu;
  }
}

TEST(Locking, BothFormulationsAgreeWithThePlaneSolutionWhenCompressible) {
  const double exact = 9.0920e-3;
  EXPECT_NEAR(slab_error(6, 0.3, Formulation::standard, exact), 0, 0.003);
  EXPECT_NEAR(slab_error(6, 0.3, Formulation::locking_free, exact), 0, 0.004);
}

TEST(Locking, ErrorsDoNotGrowTowardsTheIncompressibleLimit) {
  const double near = slab_error(3, 0.499, Formulation::locking_free, plane_tip(0.499));
  const double nearer = slab_error(3, 0.49999, Formulation::locking_free, plane_tip(0.49999));
  EXPECT_NEAR(nearer, near, 1e-3);
}

}  // namespace
}  // namespace taut
