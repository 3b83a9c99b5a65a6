#include <benchmark/benchmark.h>

#include <ctime>

#include "sim/solve/equilibrium.hpp"
#include "tests/support/push_puppet.hpp"

// What each part of a solve costs over the number of unknowns, from 1 k to 200 k: the push-puppet module, quadratic
// elements, retracted and loaded, contact on. Nothing should grow faster than the factorisation. `plot` draws the CSV
// that --benchmark_out writes.
namespace taut::test {
namespace {

/// Processor time of one thread, in milliseconds, the fastest of `times` runs.
double milliseconds(int times, const auto& action) {
  double fastest = 1e9;
  for (int i = 0; i < times; ++i) {
    const std::clock_t start = std::clock();
    action();
    fastest = std::min(fastest, 1e3 * static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC);
  }
  return fastest;
}

void module_of(benchmark::State& state, double size) {
  use_one_blas_thread();
  Experiment e = reference_module();
  e.mesh.size = size;
  e.mesh.counts["lip_cells"] = std::max(1, static_cast<int>(2 * 2.6e-3 / size));
  const StaticReplay bench = make_static_replay(e, e.mesh, conditions_of({5.89e-3}, {0.05}));
  const Model& model = *bench.protocol->scene().model;
  const std::vector<int> parameters{model.parameters().index("E_foam"), model.parameters().index("k_cable"),
                                    model.parameters().index("slack"), model.parameters().index("E_plastic")};
  for (auto _ : state) {
    bench.protocol->forget();
    const double solve = milliseconds(1, [&] { bench.protocol->predict(bench.protocol->nominal(), {}); });
    const StaticProtocol::Condition& condition = bench.protocol->conditions().front();
    const Point at{condition.u, condition.p};
    const int times = model.free_unknowns() < 50000 ? 10 : 3;

    Hessian hessian(model);
    Eigen::VectorXd gradient, x;
    state.counters["unknowns"] = model.free_unknowns();
    state.counters["analysis"] = milliseconds(1, [&] { Cholesky analysis(model.pattern()); });
    state.counters["assembly"] = milliseconds(times, [&] { hessian.assemble(at, Curvature::exact, &gradient); });
    state.counters["factorisation"] = milliseconds(times, [&] { hessian.factorise(); });
    const Eigen::VectorXd free = hessian.reduction().restrict_to_free(condition.u, gradient);
    state.counters["solution"] = milliseconds(times, [&] { x = hessian.solve(free); });
    Assembly energy;
    state.counters["energy"] = milliseconds(times, [&] { model.evaluate(at, energy); });
    const Eigen::VectorXd step = 1e-7 * Eigen::VectorXd::Random(model.unknowns());
    state.counters["contact_limit"] = milliseconds(times, [&] { model.step_limit(at, step); });
    Equilibrium equilibrium(model);
    equilibrium.start_at(condition.u, condition.p);
    equilibrium.refactorise();
    state.counters["sensitivities"] = milliseconds(times, [&] { equilibrium.sensitivities(parameters); });
    state.counters["solve"] = solve;  // two states: retracted, and with the mass hung
  }
}

void Module(benchmark::State& state) {
  module_of(state, 1e-6 * static_cast<double>(state.range(0)));
}
// Element sizes in micrometres.
BENCHMARK(Module)->Arg(8000)->Arg(2600)->Arg(1300)->Arg(650)->Arg(450)->Arg(320)->Iterations(1)->Unit(
    benchmark::kMillisecond);

}  // namespace
}  // namespace taut::test

BENCHMARK_MAIN();
