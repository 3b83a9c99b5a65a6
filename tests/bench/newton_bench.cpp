#include <benchmark/benchmark.h>

#include <ctime>

#include "tests/support/problems.hpp"

// What a Newton iteration costs beyond the factorisation and solution of its linear system, measured in one run so that
// the ratio means something on any machine. A ratio of 1.3 or less says that there is little left to gain outside
// CHOLMOD.
namespace taut {
namespace {

using namespace test;

/// Processor time: with one thread it is the elapsed time, less what other programs take of the machine.
double seconds_since(std::clock_t start) {
  return static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC;
}

/// Clamped block bent at its free end, about 10 k unknowns.
Problem solid_block(Formulation formulation) {
  SceneBuilder builder(box(graded(0.055, 12), graded(0.030, 6), graded(0.030, 5), 2, "beam"));
  builder.add_solid("beam", "neo_hookean", {{"E", 1e5}, {"nu", formulation == Formulation::standard ? 0.3 : 0.499}},
                    formulation);
  Problem problem;
  builder.fix("xmin", {0, 1, 2});
  problem.force = builder.declare({"force", "F", "N", -1e6, 1e6, "load on the tip"}, 0.0);
  builder.add_force("xmax", Eigen::Vector3d(0, -1, 0), problem.force);
  problem.scene = builder.build();
  return problem;
}

/// One iteration is assembly of gradient and Hessian, factorisation, solution and the energy of the trial state, at a
/// bent state. `ratio` is its time over that of the factorisation and solution alone; the others are shares in
/// milliseconds.
void newton_iteration(benchmark::State& state, const Problem& problem) {
  use_one_blas_thread();
  const Model& model = *problem.scene.model;
  Equilibrium equilibrium(model);
  equilibrium.start_at_rest(problem.scene.values);
  Params p = problem.scene.values;
  p[problem.force] = 0.5;
  if (equilibrium.solve(p).status != SolveStatus::converged) return state.SkipWithError("no equilibrium");

  Cholesky cholesky(model.pattern());
  std::vector<double> values(static_cast<size_t>(model.pattern().entries()) + 1);
  Eigen::VectorXd gradient;
  double assembly = 0, linear = 0, energy = 0;
  for (auto _ : state) {
    std::clock_t start = std::clock();
    Assembly out;
    out.gradient = &gradient;
    out.hessian = values.data();
    model.evaluate({equilibrium.u(), p}, out);
    const Eigen::VectorXd free = model.restrict_to_free(gradient);
    assembly += seconds_since(start);

    start = std::clock();
    if (!cholesky.factorise(values)) return state.SkipWithError("not positive definite");
    const Eigen::VectorXd step = cholesky.solve(free);
    linear += seconds_since(start);

    start = std::clock();
    Assembly trial;
    model.evaluate({equilibrium.u() - model.extend_from_free(step), p}, trial);
    benchmark::DoNotOptimize(trial.energy);
    energy += seconds_since(start);
  }
  const double n = 1e-3 * static_cast<double>(state.iterations());
  state.counters["unknowns"] = model.free_unknowns();
  state.counters["assembly_ms"] = assembly / n;
  state.counters["cholmod_ms"] = linear / n;
  state.counters["energy_ms"] = energy / n;
  state.counters["ratio"] = (assembly + linear + energy) / linear;
}

#define TAUT_NEWTON_BENCH(name, problem) \
  void name(benchmark::State& state) {   \
    newton_iteration(state, problem);    \
  }                                      \
  BENCHMARK(name)->Unit(benchmark::kMillisecond)

TAUT_NEWTON_BENCH(A1Quadratic4k, problem_a1(16, 2));
TAUT_NEWTON_BENCH(A1Quadratic4kLockingFree, problem_a1(16, 2, 1, Formulation::locking_free));
TAUT_NEWTON_BENCH(A1Quadratic16k, problem_a1(33, 2));
TAUT_NEWTON_BENCH(A1Linear16k, problem_a1(66, 1));
TAUT_NEWTON_BENCH(BlockTet10, solid_block(Formulation::standard));
TAUT_NEWTON_BENCH(BlockTet10LockingFree, solid_block(Formulation::locking_free));

/// The whole of A1 at 2 N from rest, symbolic analysis included: to compare with the table of other programs.
void whole_solve(benchmark::State& state, const Problem& problem) {
  use_one_blas_thread();
  SolveReport report;
  for (auto _ : state) tip_at(problem, 2.0, &report);
  state.counters["unknowns"] = problem.scene.model->free_unknowns();
  state.counters["newton"] = report.iterations;
}
void A1SolveQuadratic4k(benchmark::State& state) {
  whole_solve(state, problem_a1(16, 2));
}
void A1SolveQuadratic16k(benchmark::State& state) {
  whole_solve(state, problem_a1(33, 2));
}
void A1SolveLinear16k(benchmark::State& state) {
  whole_solve(state, problem_a1(66, 1));
}
BENCHMARK(A1SolveQuadratic4k)->Unit(benchmark::kMillisecond);
BENCHMARK(A1SolveQuadratic16k)->Unit(benchmark::kMillisecond);
BENCHMARK(A1SolveLinear16k)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace taut

BENCHMARK_MAIN();
