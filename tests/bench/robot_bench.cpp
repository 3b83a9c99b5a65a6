#include <benchmark/benchmark.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
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

/// The motors' angles at which rigid links in line from the origin, joined by them, have their end at `target`: those
/// nearest to a straight arm, step by step.
Eigen::VectorXd rigid_angles(const std::vector<double>& lengths, const Eigen::Vector2d& target) {
  Eigen::VectorXd angles = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(lengths.size()));
  for (int iteration = 0; iteration < 50; ++iteration) {
    Eigen::Vector2d end(0, 0);
    std::vector<Eigen::Vector2d> joints;
    double heading = 0;
    for (size_t k = 0; k < lengths.size(); ++k) {
      joints.push_back(end);
      heading += angles[static_cast<Eigen::Index>(k)];
      end += lengths[k] * Eigen::Vector2d(std::cos(heading), std::sin(heading));
    }
    Eigen::MatrixXd J(2, angles.size());
    for (size_t k = 0; k < lengths.size(); ++k)
      J.col(static_cast<Eigen::Index>(k)) << -(end - joints[k]).y(), (end - joints[k]).x();
    const Eigen::Vector2d miss = target - end;
    if (miss.norm() < 1e-6) break;
    angles += J.transpose() * (J * J.transpose()).inverse() * miss;
  }
  return angles;
}

/// Every point of the shipped circle by itself: searched for from rest, or (hybrid bootstrapping) from the equilibrium
/// at the angles that rigid links of the nominal cables' lengths have there, whose factorisations count, too.
void cold_targets(benchmark::State& state, bool bootstrapped) {
  use_one_blas_thread();
  const Simulation simulation = shipped("arm");
  const Robot robot = make_robot(simulation);
  const IkTarget& path = simulation.ik->targets.back();
  const double retraction = 7e-3, link = 85e-3;  // nominal; from joint to joint at rest
  const std::vector<double> lengths{link - retraction, link - retraction,
                                    robot.reading("tip_x").rest - 2 * link - retraction};
  double factorisations = 0, trials = 0, reached = 0, n = 0, spent = 0;
  for (auto _ : state) {
    for (size_t k = 0; k < path.values.begin()->second.size(); ++k) {
      const std::clock_t start = std::clock();
      RobotIk ik(simulation, robot);
      if (bootstrapped) {
        const Eigen::VectorXd angles = rigid_angles(lengths, {path.values.at("tip_x")[k], path.values.at("tip_y")[k]});
        Equilibrium equilibrium = equilibrium_at_rest(simulation, robot, *robot.scene.model);
        Params p = robot.at(simulation, 0);
        for (int step = 1; step <= 2; ++step) {
          for (size_t c = 0; c < simulation.controls.size(); ++c) {
            const std::string& id = simulation.controls[c].id;
            p[robot.controls[c]] = id.starts_with("motor") ? 0.5 * step * angles[id.back() - '1'] : retraction;
          }
          factorisations += equilibrium.solve(p).factorisations;
          ++trials;
        }
        ik.start_at(equilibrium.u(), p);
      }
      const IkResult result = ik.solve(path, k).result;
      spent += seconds_since(start);
      factorisations += result.factorisations;
      trials += result.solves;
      reached += result.status == IkStatus::reached ? 1 : 0;
      ++n;
    }
  }
  state.counters["targets/s"] = n / spent;
  state.counters["factorisations"] = factorisations / n;
  state.counters["trials"] = trials / n;
  state.counters["reached"] = reached / n;
}
BENCHMARK_CAPTURE(cold_targets, from_rest, false)->Unit(benchmark::kMillisecond)->Iterations(1);
BENCHMARK_CAPTURE(cold_targets, from_rigid_kinematics, true)->Unit(benchmark::kMillisecond)->Iterations(1);

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
