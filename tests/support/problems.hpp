#pragma once
#include <string>
#include <vector>

#include "sim/mesh/structured.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/scene/scene.hpp"
#include "sim/solve/equilibrium.hpp"
#include "tests/support/graded.hpp"

// The plane-strain problems whose answers are tabulated in tests/verification/plane_benchmarks_test.cpp, for tests and
// benchmarks alike. Each has one control, "force" [N] in all, and the channel "tip": the mean displacement of the
// loaded face along the load.
namespace taut::test {

struct Problem {
  Scene scene;
  Eigen::VectorXd tip;  ///< weights of the tip displacement
  int force;            ///< index of the control
};

inline Problem loaded_on_xmax(SceneBuilder&& builder, const Eigen::Vector2d& direction) {
  Problem problem;
  builder.fix("xmin", {0, 1});
  problem.force = builder.declare({"force", "F", "N", -1e6, 1e6, "load on the tip"}, 0.0);
  builder.add_force("xmax", direction, problem.force);
  problem.tip = mean_weights(builder.mesh(), builder.mesh().select("xmax"), direction);
  problem.scene = builder.build();
  return problem;
}

/// A1: cantilever 55 x 30 x 30 mm; A2 with other sizes. `grading` > 1 refines towards the clamp and both of its
/// corners.
inline Problem cantilever(double L, double H, double E, double nu, int nx, int ny, int order, double grading = 1,
                          Formulation formulation = Formulation::standard) {
  SceneBuilder builder(rectangle(graded(L, nx, grading), graded_both(H, ny, grading), order, "beam"), Plane::strain,
                       0.030);
  builder.add_solid("beam", "neo_hookean", {{"E", E}, {"nu", nu}}, formulation);
  return loaded_on_xmax(std::move(builder), {0, -1});
}
inline Problem problem_a1(int ny, int order, double grading = 1, Formulation formulation = Formulation::standard) {
  return cantilever(0.055, 0.030, 1e5, 0.3, ny * 55 / 30, ny, order, grading, formulation);
}

/// A3: 11 layers of 5 mm along x, stiff ones first and last, `per_layer` elements through each.
inline Problem problem_a3(int per_layer, int order, double grading = 1) {
  std::vector<double> x{0};
  for (int layer = 0; layer < 11; ++layer) {
    const std::vector<double> local = graded_both(0.005, per_layer, grading);
    for (size_t i = 1; i < local.size(); ++i) x.push_back(0.005 * layer + local[i]);
  }
  Mesh mesh = rectangle(x, graded_both(0.030, 6 * per_layer, grading), order, "foam");
  assign_regions(mesh,
                 [](const Eigen::VectorXd& c) { return static_cast<int>(c[0] / 0.005) % 2 == 0 ? "plastic" : "foam"; });
  SceneBuilder builder(std::move(mesh), Plane::strain, 0.030);
  builder.add_solid("plastic", "neo_hookean", {{"E", 2.3e9}, {"nu", 0.35}});
  builder.add_solid("foam", "neo_hookean", {{"E", 5e4}, {"nu", 0.2}});
  return loaded_on_xmax(std::move(builder), {0, -1});
}

/// A4: Cook's membrane, n x n cells.
inline Problem problem_a4(int n, int order, double nu, Formulation formulation = Formulation::standard,
                          double grading = 1, Diagonals diagonals = Diagonals::alternating) {
  Mesh mesh = rectangle(graded(1, n, grading), graded_both(1, n, grading), order, "membrane", diagonals);
  map_vertices(mesh, [](const Eigen::VectorXd& s) -> Eigen::VectorXd {
    const double bottom = 0.044 * s[0], top = 0.044 + 0.016 * s[0];
    return Eigen::Vector2d(0.048 * s[0], bottom + (top - bottom) * s[1]);
  });
  SceneBuilder builder(std::move(mesh), Plane::strain, 0.001);
  builder.add_solid("membrane", "neo_hookean", {{"E", 240.565e6}, {"nu", nu}}, formulation);
  return loaded_on_xmax(std::move(builder), {0, 1});
}

/// Tip displacement [m] at force F, solved from rest.
inline double tip_at(const Problem& problem, double force, SolveReport* report = nullptr) {
  Equilibrium equilibrium(*problem.scene.model);
  equilibrium.start_at_rest(problem.scene.values);
  Params p = problem.scene.values;
  p[problem.force] = force;
  const SolveReport& result = equilibrium.solve(p);
  if (report != nullptr) *report = result;
  return problem.tip.dot(equilibrium.u());
}

}  // namespace taut::test
