#include <benchmark/benchmark.h>

#include <algorithm>
#include <ctime>
#include <string>
#include <vector>

#include "sim/files/simulation.hpp"
#include "sim/robots/robot_ik.hpp"
#include "sim/robots/simulate.hpp"
#include "sim/solve/reduction.hpp"

// What driving a robot costs, in one run: targets of inverse kinematics per second, and simulated over processor time.
namespace taut {
namespace {

Simulation shipped(const char* experiment) {
  return read_simulation(std::string(TAUT_SOURCE_DIR "/experiments/") + experiment + "/experiment.toml");
}
double seconds_since(std::clock_t start) {
  return static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC;
}

/// The shipped circle of the arm, from point to point, the way to its first one left out. `ratio` is the median time of
/// a target over that of one factorisation of the same Hessian with its assembly; `dearest` the same of the dearest
/// one, at which a link first comes to lie against another.
void circle(benchmark::State& state) {
  use_one_blas_thread();
  const Simulation simulation = shipped("arm");
  const Robot robot = make_robot(simulation);
  const IkTarget& path = simulation.ik->targets.back();
  std::vector<double> seconds, factorisations;
  double reached = 0;
  Hessian hessian(*robot.scene.model);
  double one = 0;
  for (auto _ : state) {
    RobotIk ik(simulation, robot);
    for (size_t k = 0; k < path.values.begin()->second.size(); ++k) {
      const std::clock_t start = std::clock();
      const IkAnswer answer = ik.solve(path, k);
      if (k == 0) continue;
      seconds.push_back(seconds_since(start));
      factorisations.push_back(answer.result.factorisations);
      reached += answer.result.status == IkStatus::reached ? 1 : 0;
      const std::clock_t then = std::clock();
      hessian.assemble({answer.u, answer.p}, Curvature::exact, nullptr);
      if (!hessian.factorise()) return state.SkipWithError("an answer is no minimum");
      one += seconds_since(then);
    }
  }
  const auto n = static_cast<double>(seconds.size());
  double sum = 0, all = 0;
  for (const double s : seconds) sum += s;
  for (const double f : factorisations) all += f;
  one /= n;
  std::sort(seconds.begin(), seconds.end());
  state.counters["targets/s"] = n / sum;
  state.counters["median/s"] = 1 / seconds[seconds.size() / 2];
  state.counters["factorisations"] = all / n;
  state.counters["ratio"] = seconds[seconds.size() / 2] / one;
  state.counters["dearest"] = seconds.back() / one;
  state.counters["reached"] = reached / n;
}
BENCHMARK(circle)->Unit(benchmark::kMillisecond)->Iterations(3);

/// Simulated over processor time of a shipped scene: more than 1 is faster than real time.
void real_time(benchmark::State& state, const char* experiment, bool rigid) {
  use_one_blas_thread();
  Simulation simulation = shipped(experiment);
  simulation.rigid_segments = rigid;
  const Robot robot = make_robot(simulation);
  double spent = 0, simulated = 0;
  for (auto _ : state) {
    const std::clock_t start = std::clock();
    const SimulationResult result = simulate(simulation, robot);
    spent += seconds_since(start);
    if (!result.failure.empty()) return state.SkipWithError(result.failure.c_str());
    simulated += result.times.back();
  }
  state.counters["unknowns"] = Reduction(*robot.scene.model).size();
  state.counters["real_time"] = simulated / spent;
}
BENCHMARK_CAPTURE(real_time, stiffening, "stiffening", false)->Unit(benchmark::kMillisecond)->Iterations(1);
BENCHMARK_CAPTURE(real_time, stiffening_rigid, "stiffening", true)->Unit(benchmark::kMillisecond)->Iterations(1);
BENCHMARK_CAPTURE(real_time, ball_impact, "ball_impact", false)->Unit(benchmark::kMillisecond)->Iterations(1);
BENCHMARK_CAPTURE(real_time, ball_impact_rigid, "ball_impact", true)->Unit(benchmark::kMillisecond)->Iterations(1);

}  // namespace
}  // namespace taut

BENCHMARK_MAIN();
