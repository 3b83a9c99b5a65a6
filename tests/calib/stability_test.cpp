#include "calib/studies/stability.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "calib/files/experiment.hpp"
#include "sim/files/simulation.hpp"
#include "tests/support/experiment_files.hpp"
#include "tests/support/message.hpp"
#include "tests/support/problems.hpp"
#include "tests/support/small_robot.hpp"

namespace taut::test {
namespace {

StabilityRun judged(const Scene& scene, const Params& p, const EquilibriumOptions& options, bool contact = false,
                    const Eigen::VectorXd& reference = {}) {
  Equilibrium equilibrium(*scene.model, options);
  equilibrium.start_at_rest(scene.values);
  equilibrium.solve(p);
  return judge(equilibrium, options, p, reference, 0.05, contact);
}

Params loaded(const Problem& problem, double force) {
  Params p = problem.scene.values;
  p[problem.force] = force;
  return p;
}

TEST(Stability, ASlightLoadIsConvergedAndTooManyIterationsAreCutBack) {
  const Problem problem = problem_a1(2, 2);
  EXPECT_EQ(judged(problem.scene, loaded(problem, 0.1), {}).outcome, Outcome::converged);
  EXPECT_EQ(judged(problem.scene, loaded(problem, 4), {.max_iterations = 4}).outcome, Outcome::cut_back);
  // The same steps, asked for: nothing was cut back.
  EXPECT_EQ(judged(problem.scene, loaded(problem, 4), {.load_steps = 8}).outcome, Outcome::converged);
}

TEST(Stability, AReferenceElsewhereIsAnotherAnswer) {
  const Problem problem = problem_a1(2, 2);
  const Params p = loaded(problem, 1);
  Equilibrium equilibrium(*problem.scene.model);
  equilibrium.start_at_rest(problem.scene.values);
  equilibrium.solve(p);
  const StabilityRun same = judged(problem.scene, p, {}, false, equilibrium.u());
  EXPECT_EQ(same.outcome, Outcome::converged);
  EXPECT_LT(same.error, 1e-8);
  const StabilityRun other = judged(problem.scene, p, {}, false, 1.25 * equilibrium.u());
  EXPECT_EQ(other.outcome, Outcome::elsewhere);
  EXPECT_NEAR(other.error, 0.2, 1e-6);
}

TEST(Stability, APerfectColumnAboveItsBucklingLoadWithoutTheTestForAMinimumIsASaddle) {
  const double L = 0.1, H = 0.01, E = 1e5, t = 0.03, euler = E * t * H * H * H / 12 * std::pow(M_PI / (2 * L), 2);
  SceneBuilder builder(rectangle(graded(L, 20), {0, H / 2, H}, 2, "column"), Plane::strain, t);
  builder.add_solid("column", "neo_hookean", {{"E", E}, {"nu", 0.0}});
  const Problem problem = loaded_on_xmax(std::move(builder), {-1, 0});
  EXPECT_EQ(judged(problem.scene, loaded(problem, 1.3 * euler), {.check_minimum = false}).outcome, Outcome::saddle);
  EXPECT_EQ(judged(problem.scene, loaded(problem, 0.9 * euler), {.check_minimum = false}).outcome, Outcome::converged);
  EXPECT_EQ(judged(problem.scene, loaded(problem, 1.3 * euler), {}).outcome, Outcome::converged);
}

TEST(Stability, FullStepsThatTurnElementsInsideOutAreInvertedAndTooFewIterationsDiverged) {
  const Problem problem = problem_a1(4, 2);
  EquilibriumOptions full{.max_halvings = 0};
  full.comparison.line_search = LineSearch::none;
  EXPECT_EQ(judged(problem.scene, loaded(problem, 20), full).outcome, Outcome::inverted);
  EXPECT_EQ(judged(problem.scene, loaded(problem, 20), {.max_iterations = 3, .max_halvings = 0}).outcome,
            Outcome::diverged);
}

TEST(Stability, BlocksPushedThroughEachOtherByAPenaltyAreIntersectedAndByTheBarrierNot) {
  for (ContactForm form : {ContactForm::length_weighted, ContactForm::penalty}) {
    Mesh lower = rectangle(graded(0.02, 4), graded(0.01, 2), 1, "soft"), upper = lower;
    place(upper, Eigen::Matrix2d::Identity(), Eigen::Vector2d(0, 0.011));
    SceneBuilder builder(merge({{"lower", lower}, {"upper", upper}}), Plane::strain, 0.03);
    builder.add_solid("soft", "neo_hookean", {{"E", 1e5}, {"nu", 0.2}});
    const int push = builder.declare({"push", "u", "m", -1, 1, "push"}, 0.0);
    builder.fix("lower.ymin", {0, 1});
    builder.fix("upper.ymax", {0});
    builder.prescribe("upper.ymax", 1, push);
    builder.add_contact(1e-4, {{"soft", 1e5}}, {}, {}, form);
    const Scene scene = builder.build();
    Params p = scene.values;
    p[push] = -3e-3;
    EXPECT_EQ(judged(scene, p, {}, true).outcome == Outcome::intersected, form == ContactForm::penalty);
  }
}

/// The small beam on its bench, and its maps.
struct SmallBench {
  TemporaryFolder folder;
  Experiment experiment;
  Trials trials;

  explicit SmallBench(const std::string& toml = beam_toml) {
    folder.write("bench.csv", beam_csv);
    experiment = read_experiment(folder.write("experiment.toml", toml));
    trials = read_trials(experiment.bench);
  }
};

const StabilityMap& map_called(const std::vector<StabilityMap>& maps, const std::string& id) {
  for (const StabilityMap& map : maps) {
    if (map.id == id) return map;
  }
  ADD_FAILURE() << "there is no map " << id;
  return maps.front();
}

TEST(Stability, ABeamOfOneMaterialHasMapsOverLoadElementAndStart) {
  const SmallBench bench;
  const std::vector<StabilityMap> maps = stability_maps(bench.experiment, bench.trials);
  std::vector<std::string> ids;
  for (const StabilityMap& map : maps) {
    ids.push_back(map.id);
    EXPECT_EQ(map.cells(), map.methods.size() * map.x.size() * map.y.size());
    for (const std::string* text : {&map.title, &map.setting, &map.x_label, &map.y_label}) EXPECT_FALSE(text->empty());
  }
  EXPECT_EQ(ids, (std::vector<std::string>{"load_steps", "poisson_element", "perturbed_start"}));
}

TEST(Stability, LinearElementsOfANearlyIncompressibleBeamAreLockedAndLockingFreeOnesAreNot) {
  // Linear elements are too stiff at any ratio on this mesh, and ten times so at 0.4999 (see the stress scenes).
  const SmallBench bench(replaced(beam_toml, "cells = [10, 4]", "cells = [20, 4]"));
  const auto maps = stability_maps(bench.experiment, bench.trials);
  const StabilityMap& map = map_called(maps, "poisson_element");
  ASSERT_EQ(map.y.size(), 3u);
  const size_t last = map.x.size() - 1;
  const StabilityRun linear = map.run(0, last, 0), free = map.run(0, last, 2), ordinary = map.run(0, 1, 1);
  EXPECT_EQ(linear.outcome, Outcome::locked);
  EXPECT_LT(linear.error, -0.1);
  EXPECT_EQ(free.outcome, Outcome::converged);
  EXPECT_LT(std::abs(free.error), 0.03);
  EXPECT_EQ(ordinary.outcome, Outcome::converged) << "quadratic at 0.3";
}

/// A map whose runs are counted.
StabilityMap counted(int& runs) {
  StabilityMap map;
  map.id = "counted";
  map.x = {"1", "2", "3"};
  map.y = {"a", "b"};
  map.methods = {"one", "another, with a comma"};
  map.run = [&runs](size_t m, size_t x, size_t y) {
    ++runs;
    StabilityRun run;
    run.outcome = static_cast<Outcome>((m + x + y) % 8);
    run.iterations = static_cast<int>(100 * m + 10 * x + y);
    if (x > 0) run.error = 0.125 * static_cast<double>(x);
    return run;
  };
  return map;
}

TEST(Stability, AChartThatWasStoppedGoesOnWithoutRepeatingWhatIsDone) {
  TemporaryFolder folder;
  int runs = 0;
  std::atomic<bool> stop = false;
  std::vector<StabilityMap> maps{counted(runs)};
  StudyOptions options{300, folder / "stability.csv", "this", &stop, {}};
  options.progress = [&](const std::string&, size_t done, size_t all) {
    EXPECT_EQ(all, 12u);
    stop = done >= 4;
  };
  const auto first = run_stability(maps, options);
  EXPECT_EQ(runs, 5) << "the one that was begun is finished";
  EXPECT_EQ(std::count_if(first[0].begin(), first[0].end(), [](const auto& run) { return run.has_value(); }), 5);
  // The last line was cut off while it was written.
  std::string text = text_of(options.file);
  folder.write("stability.csv", text.substr(0, text.size() - 4));
  stop = false;
  options.progress = nullptr;
  const auto all = run_stability(maps, options);
  EXPECT_EQ(runs, 5 + 8) << "seven new ones, and the one that was cut off";
  for (size_t m = 0; m < 2; ++m) {
    for (size_t x = 0; x < 3; ++x) {
      for (size_t y = 0; y < 2; ++y) {
        const auto& run = all[0][maps[0].cell(m, x, y)];
        ASSERT_TRUE(run);
        EXPECT_EQ(run->iterations, static_cast<int>(100 * m + 10 * x + y));
        EXPECT_EQ(run->outcome, static_cast<Outcome>((m + x + y) % 8));
        EXPECT_EQ(std::isfinite(run->error), x > 0);
      }
    }
  }
  EXPECT_EQ(run_stability(maps, options)[0].size(), 12u);
  EXPECT_EQ(runs, 5 + 8) << "all of them are in the file";
  options.fingerprint = "that";
  options.budget = 0;
  EXPECT_FALSE(run_stability(maps, options)[0][0]) << "another content of the experiment file: nothing of this counts";
}

TEST(Stability, WithoutTimeNothingIsRunAndWhatIsThereIsReadFromOlderTablesToo) {
  TemporaryFolder folder;
  int runs = 0;
  const std::vector<StabilityMap> maps{counted(runs)};
  const std::string path = folder.write("stability.csv",
                                        "map,method,x,y,outcome,iterations,factorisations,error,fingerprint\n"
                                        "counted,another; with a comma,3,b,cut back,7,8,0.5,this\n"
                                        "counted,one,3,b,no such outcome,7,8,0.5,this\n");
  const auto found = run_stability(maps, {0, path, "this", nullptr, {}});
  EXPECT_EQ(runs, 0);
  const auto& run = found[0][maps[0].cell(1, 2, 1)];
  ASSERT_TRUE(run);
  EXPECT_EQ(run->outcome, Outcome::cut_back);
  EXPECT_EQ(run->iterations, 7);
  EXPECT_EQ(run->error, 0.5);
  EXPECT_FALSE(found[0][maps[0].cell(0, 2, 1)]);
  EXPECT_FALSE(found[0][maps[0].cell(0, 0, 0)]);
}

TEST(Stability, ASimulationHasMapsOverTimeStepsAndShortStepsOfImplicitEulerArrive) {
  TemporaryFolder folder;
  const Simulation simulation = read_simulation(folder.write("robot.toml", robot_toml));
  const auto maps = stability_maps(simulation);
  const StabilityMap& map = map_called(maps, "step_stiffness");
  EXPECT_EQ(map.x.front(), "0.4") << "a fifth of 2 ms";
  const StabilityRun run = map.run(0, 0, 0), rough = map.run(0, 4, 0);
  EXPECT_LE(run.outcome, Outcome::elsewhere);
  EXPECT_TRUE(std::isfinite(run.error));
  EXPECT_GT(rough.error, run.error) << "one step instead of a hundred";
  EXPECT_LT(rough.iterations, run.iterations);
}

TEST(Stability, WrongKindsOfFilesGetASentence) {
  TemporaryFolder folder;
  Simulation still = read_simulation(folder.write("robot.toml", robot_toml));
  still.method = SimulationMethod::quasi_static;
  expect_input_error([&] { stability_maps(still); }, {"robot.toml", "quasi-static", "no time steps", "benches"});
  const Experiment swing = read_experiment(TAUT_SOURCE_DIR "/experiments/silicone_swing/experiment.toml");
  expect_input_error([&] { stability_maps(swing, {}); }, {"recordings over time", "benches with readings at rest"});
}

}  // namespace
}  // namespace taut::test
