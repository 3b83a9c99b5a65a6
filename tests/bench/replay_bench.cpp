#include <benchmark/benchmark.h>

#include <chrono>

#include "calib/files/experiment.hpp"
#include "calib/fit/fit.hpp"
#include "calib/models/beam_model.hpp"
#include "sim/solve/cholesky.hpp"
#include "tests/support/push_puppet.hpp"

// The push-puppet module's 16 conditions from rest, on one thread and on two, and the fit of its bench in units of such
// a replay; wall time.
namespace taut::test {
namespace {

double seconds_of(const auto& action) {
  const auto start = std::chrono::steady_clock::now();
  action();
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

void replay(benchmark::State& state, int order, double size) {
  use_one_blas_thread();
  Experiment e = reference_module(order);
  e.mesh.size = size;
  e.threads = 1;
  const StaticReplay one = make_static_replay(e, e.mesh, conditions_of());
  e.threads = 2;
  const StaticReplay two = make_static_replay(e, e.mesh, conditions_of());
  auto cold = [](const StaticReplay& bench) {
    bench.protocol->forget();
    return seconds_of([&] { bench.protocol->predict(bench.protocol->nominal(), {}); });
  };
  double single = 1e9, both = 1e9;  // the fastest of all runs: what else the machine does only adds
  for (auto _ : state) {
    single = std::min(single, cold(one));
    both = std::min(both, cold(two));
  }
  const double runs = static_cast<double>(state.iterations());
  state.counters["unknowns"] = one.protocol->scene().model->free_unknowns();
  state.counters["factorisations"] = one.protocol->factorisations() / runs;
  state.counters["one_thread_ms"] = 1e3 * single;
  state.counters["two_threads_ms"] = 1e3 * both;
  state.counters["speed_up"] = single / both;
}

void ReplayLinear(benchmark::State& state) {
  replay(state, 1, 1.4e-3);
}
void ReplayQuadratic(benchmark::State& state) {
  replay(state, 2, 2.6e-3);
}
void ReplayQuadraticFine(benchmark::State& state) {
  replay(state, 2, 1.3e-3);
}
BENCHMARK(ReplayLinear)->Unit(benchmark::kMillisecond);
BENCHMARK(ReplayQuadratic)->Unit(benchmark::kMillisecond);
BENCHMARK(ReplayQuadraticFine)->Unit(benchmark::kMillisecond);

void FitOfTheBench(benchmark::State& state) {
  use_one_blas_thread();
  const Experiment e = read_experiment(TAUT_SOURCE_DIR "/experiments/push_puppet/experiment.toml");
  const Trials trials = read_trials(e.bench);
  const StaticReplay bench = make_static_replay(e, e.mesh, trials);
  const std::vector<FreeParameter> free = free_parameters(e, *bench.protocol);
  FitOptions options;
  options.profiles = false;
  double replays = 1e9, fits = 1e9;
  FitResult result;
  for (auto _ : state) {
    bench.protocol->forget();
    replays = std::min(replays, seconds_of([&] { bench.protocol->predict(bench.protocol->nominal(), {}); }));
    bench.protocol->forget();
    fits = std::min(fits, seconds_of([&] {
                      result = fit(*bench.protocol, bench.measurements, start_by_beams(e, trials, free), options);
                    }));
  }
  state.counters["fit_factorisations"] = result.search.factorisations;
  state.counters["evaluations"] = result.evaluations;
  state.counters["fit_ms"] = 1e3 * fits;
  state.counters["in_replays"] = fits / replays;
}
BENCHMARK(FitOfTheBench)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace taut::test

BENCHMARK_MAIN();
