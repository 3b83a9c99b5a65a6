#include "calib/studies/accuracy.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <thread>

#include "calib/data/csv_table.hpp"
#include "calib/files/experiment.hpp"
#include "sim/core/error.hpp"
#include "sim/files/simulation.hpp"
#include "tests/support/experiment_files.hpp"
#include "tests/support/hung_mass.hpp"
#include "tests/support/message.hpp"
#include "tests/support/small_robot.hpp"

namespace taut {
namespace {

using namespace test;

/// Settings whose results and costs are made up: value 1 + h^2 at size h, and a number of factorisations of 1/h.
AccuracyStudy made_up(std::vector<double> sizes, int* runs = nullptr) {
  AccuracyStudy study;
  study.title = "made up";
  study.highest_order = {{"mesh", 2}};
  for (double h : sizes) {
    AccuracySetting setting;
    setting.axis = "size";
    setting.name = "size, \"quoted\", " + std::to_string(h);
    setting.in_use = h == sizes.front();
    setting.cost = 1 / h;
    setting.sequences["mesh"] = h;
    setting.run = [h, runs](const std::atomic<bool>&) {
      if (runs != nullptr) ++*runs;
      AccuracyRun run;
      run.unknowns = static_cast<int>(1 / h);
      run.seconds = 1e-3 / h;
      run.factorisations = static_cast<int>(1 / h);
      run.values = Eigen::Vector2d(1 + h * h, -3 - 2 * h * h);
      return run;
    };
    study.settings.push_back(setting);
  }
  return study;
}

TEST(Accuracy, TheFrontHoldsWhatNothingBeatsInBothCostAndError) {
  const std::vector<std::pair<double, double>> points{{1, 9}, {2, 10}, {3, 4}, {2.5, 4.5}, {3, 5}, {9, 3.99}, {8, 1}};
  EXPECT_EQ(pareto_front(points), (std::vector<size_t>{0, 3, 2, 6}))
      << "2 and 3 are dearer and worse than others; a four-hundredth is no gain";
  EXPECT_TRUE(pareto_front({}).empty());
  EXPECT_EQ(pareto_front({{1, 1}, {1, 1}}), (std::vector<size_t>{0}));
}

TEST(Accuracy, ErrorsAreThoseToTheLimitOfTheFinestSettings) {
  const AccuracyStudy study = made_up({0.4, 0.2, 0.1});
  const TemporaryFolder folder;
  const AccuracyChart chart = judge(study, run_settings(study, {10, folder / "a.csv", "f", nullptr, {}}));
  ASSERT_EQ(chart.points.size(), 3u);
  const double tall[2] = {0.16 / 1, 0.32 / 3};  // errors of the values 1 and 3
  const double scaled[2] = {1.16, 3.32};        // relative to the setting in use
  EXPECT_NEAR(chart.points[0].largest, tall[0] / scaled[0], 1e-9);
  EXPECT_NEAR(chart.points[0].error, std::sqrt((std::pow(0.16 / 1.16, 2) + std::pow(0.32 / 3.32, 2)) / 2), 1e-9);
  EXPECT_NEAR(chart.points[2].error / chart.points[0].error, 1.0 / 16, 1e-6) << "order 2, seen and used";
  EXPECT_NEAR(chart.uncertainty, 1.25 * chart.points[2].error, 1e-9);
  EXPECT_EQ(chart.points[0].from_setting_in_use, 0);
}

TEST(Accuracy, TheReferenceOfABeamHoldsTheTrueStiffnessWithinItsUncertainty) {
  // A bar that is pulled: u = F L / (E A) to first order, no matter which elements; and Poisson's ratio 0.
  const TemporaryFolder folder;
  folder.write("bench.csv", "pull_N,tip_mm\n0.001,1\n");
  std::string text = replaced(beam_toml, "trial = \"trial\"", "");
  text = replaced(replaced(text, "nu = 0.3", "nu = 0.0"), "id = \"pull\"\non = \"xmax\"\ndirection = [0, -1]",
                  "id = \"pull\"\non = \"xmax\"\ndirection = [1, 0]");
  text = replaced(text, "id = \"tip\"\non = \"xmax\"\ndirection = [0, -1]",
                  "id = \"tip\"\non = \"xmax\"\ndirection = [1, 0]");
  const AccuracyStudy bar = accuracy_study(read_experiment(folder.write("bar.toml", text)));
  const auto runs = run_settings(bar, {1e3, folder / "bar.csv", "f", nullptr, {}});
  const double exact = 0.001 * 0.060 / (100e3 * 0.012 * 0.020);
  for (const auto& run : runs) {
    ASSERT_TRUE(run && run->failure.empty()) << (run ? run->failure : "missing");
    EXPECT_NEAR(run->values[0] / exact, 1, 1e-4) << "strain 4e-5";
  }

  // A slender cantilever, plane stress, nu = 0: Timoshenko's deflection, whose clamp is no stiffer than the solid's.
  const double L = 0.12, H = 0.006, t = 0.02, E = 100e3, F = 1e-5;
  folder.write("bench.csv", "pull_N,tip_mm\n0.00001,1\n");
  text = replaced(replaced(beam_toml, "[\"60 mm\", \"12 mm\"]", "[\"120 mm\", \"6 mm\"]"), "cells = [10, 4]",
                  "cells = [20, 2]");
  text =
      replaced(replaced(replaced(text, "trial = \"trial\"", ""), "nu = 0.3", "nu = 0.0"), "\"strain\"", "\"stress\"");
  const AccuracyStudy beam = accuracy_study(read_experiment(folder.write("beam.toml", text)));
  const auto bent = run_settings(beam, {1e3, folder / "beam.csv", "f", nullptr, {}});
  const AccuracyChart chart = judge(beam, bent);
  const double timoshenko = F * L * L * L / (3 * E * t * H * H * H / 12) + F * L / (5.0 / 6 * E / 2 * t * H);
  double own = 0, error = 0;
  for (const AccuracyPoint& point : chart.points) {
    if (!beam.settings[point.setting].in_use) continue;
    own = bent[point.setting]->values[0];
    error = point.error;
  }
  const double reference = own * (1 + error);  // elements are too stiff, so the limit is above
  EXPECT_GT(error, 1e-5);
  EXPECT_LT(chart.uncertainty, 1e-3);
  EXPECT_NEAR(reference / timoshenko, 1, chart.uncertainty + 5e-4) << "the clamped end is not Timoshenko's";
}

TEST(Accuracy, WhatThePlaneSectionCostsIsSaidAgainstTheLimitOfTheSolid) {
  // The solid with n layers gives 1.05 (1 + h^2 / 50), h = 1/n; the section 1 in a thousandth of the finest one's time.
  AccuracyStudy study = made_up({0.4, 1.0, 0.5, 0.25});
  study.highest_order = {{"depth", 2}};
  study.settings[0].sequences.clear();
  for (size_t i = 0; i < 4; ++i) {
    const double h = i == 0 ? 0 : std::pow(0.5, static_cast<double>(i - 1));
    study.settings[i].model = i > 0 ? "solid" : "plane section";
    if (i > 0) study.settings[i].sequences = {{"depth", h}};
    study.settings[i].run = [i, h](const std::atomic<bool>&) {
      AccuracyRun run;
      run.seconds = i == 0 ? 1e-3 : static_cast<double>(i) / 3;
      run.values = Eigen::VectorXd::Constant(1, i == 0 ? 1 : 1.05 * (1 + h * h / 50));
      return run;
    };
  }
  const TemporaryFolder folder;
  const AccuracyChart chart = judge(study, run_settings(study, {10, folder / "a.csv", "f", nullptr, {}}));
  EXPECT_EQ(
      chart.section,
      "the plane section in use is 5 % off the solid (root mean square; 5 % at most), which takes 1e+03 times as long");
  EXPECT_NEAR(chart.points[0].model_error, 0.05, 1e-6) << "to the solid's limit";
  for (size_t i = 1; i < 4; ++i)  // over the section's value, 1
    EXPECT_NEAR(chart.points[i].model_error, 1.05 * std::pow(0.25, static_cast<double>(i - 1)) / 50, 1e-9);
  EXPECT_EQ(chart.points[0].error, 0) << "the reference of all else is the section's own";
  study.settings.resize(1);
  EXPECT_EQ(judge(study, run_settings(study, {10, folder / "b.csv", "f", nullptr, {}})).section, "");
}

TEST(Accuracy, TimeStepsAreJudgedByTheLimitOfSmallStepsOnTheSameMesh) {
  // Results 1 + h + mesh: the mesh's part is the same on all of one mesh, whatever the steps.
  AccuracyStudy study = made_up({0.4, 0.2, 0.1, 0.05});
  study.highest_order = {{"mesh", 2}, {"step", 1}};
  const double meshes[] = {0.1, 0.1, 0.1, 0.0}, steps[] = {0.04, 0.02, 0.01, 0.04};
  for (size_t i = 0; i < 4; ++i) {
    study.settings[i].run = [y = 1 + meshes[i] + steps[i]](const std::atomic<bool>&) {
      AccuracyRun run;
      run.values = Eigen::VectorXd::Constant(1, y);
      return run;
    };
    study.settings[i].sequences.clear();
    study.settings[i].sequences[i < 3 ? "step" : "mesh"] = i < 3 ? steps[i] : 1;
    study.settings[i].integrator = i < 3 ? "BDF2" : "";
  }
  const TemporaryFolder folder;
  const AccuracyChart chart = judge(study, run_settings(study, {10, folder / "a.csv", "f", nullptr, {}}));
  ASSERT_EQ(chart.points.size(), 4u);
  for (size_t i = 0; i < 3; ++i) EXPECT_NEAR(chart.points[i].step_error, steps[i] / 1.14, 1e-9);
  EXPECT_TRUE(std::isnan(chart.points[3].step_error)) << "another mesh";
  EXPECT_NEAR(chart.points[0].error, (0.1 + 0.04) / 1.14, 1e-9) << "both";
  EXPECT_NEAR(chart.step_uncertainty, 1.25 * 0.01 / 1.14, 1e-9);
}

TEST(Accuracy, GoingOnRepeatsNothingThatIsFinished) {
  int count = 0;
  const AccuracyStudy study = made_up({0.4, 0.2, 0.1, 0.05}, &count);
  const TemporaryFolder folder;
  const StudyOptions tight{0, folder / "a.csv", "file 1", nullptr, {}};
  const auto first = run_settings(study, tight);
  EXPECT_EQ(count, 1) << "one at least, and the one in use";
  EXPECT_TRUE(first[0].has_value());
  EXPECT_FALSE(first[1].has_value());
  const auto second = run_settings(study, tight);
  EXPECT_EQ(count, 2) << "the next one";
  EXPECT_EQ(second[0]->values, first[0]->values) << "to the last bit";
  EXPECT_EQ(second[0]->factorisations, 2);
  StudyOptions rich = tight;
  rich.budget = 1000;
  run_settings(study, rich);
  EXPECT_EQ(count, 4);
  run_settings(study, rich);
  EXPECT_EQ(count, 4) << "all are there";
  rich.fingerprint = "file 2";
  run_settings(study, rich);
  EXPECT_EQ(count, 8) << "another experiment, other results";
}

TEST(Accuracy, OfTwoSettingsOfOneNameTheOneInUseStays) {
  // A single cell refined by 0.5 and 0.7 is itself.
  const TemporaryFolder folder;
  folder.write("bench.csv", "pull_N,tip_mm\n0.001,1\n");
  const std::string text = replaced(replaced(beam_toml, "trial = \"trial\"", ""), "cells = [10, 4]", "cells = [1, 1]");
  const AccuracyStudy study = accuracy_study(read_experiment(folder.write("beam.toml", text)));
  EXPECT_EQ(std::ranges::count(study.settings, true, &AccuracySetting::in_use), 1);
}

TEST(Accuracy, AStopEndsTheSearchAndKeepsWhatWasFinished) {
  int count = 0;
  AccuracyStudy study = made_up({0.4, 0.2, 0.1}, &count);
  std::atomic<bool> stop{false};
  const auto run = study.settings[1].run;
  study.settings[1].run = [&](const std::atomic<bool>& flag) {
    AccuracyRun result = run(flag);
    stop = true;
    return result;
  };
  const TemporaryFolder folder;
  const auto runs = run_settings(study, {100, folder / "a.csv", "f", &stop, {}});
  EXPECT_EQ(count, 2);
  EXPECT_TRUE(runs[1].has_value());
  EXPECT_FALSE(runs[2].has_value());
  EXPECT_EQ(read_csv(folder / "a.csv").rows.size(), 2u);
}

TEST(Accuracy, AFailedSettingIsKeptWithItsReason) {
  AccuracyStudy study = made_up({0.4, 0.2, 0.1});
  study.settings[1].run = [](const std::atomic<bool>&) -> AccuracyRun {
    throw InputError("the mesh, \"so to say\", is not possible");
  };
  study.settings[2].may_hang = true;
  study.settings[2].run = [](const std::atomic<bool>& flag) {
    while (!flag) std::this_thread::yield();
    AccuracyRun run;
    run.failure = "interrupted at t = 3 ms";
    return run;
  };
  const TemporaryFolder folder;
  for (int again = 0; again < 2; ++again) {
    const auto runs = run_settings(study, {3, folder / "a.csv", "f", nullptr, {}});
    ASSERT_TRUE(runs[1] && runs[2]) << "not tried again either";
    EXPECT_EQ(runs[1]->failure, "the mesh, \"so to say\", is not possible");
    EXPECT_EQ(runs[2]->failure, "given up after 0 s: interrupted at t = 3 ms");
    const AccuracyChart chart = judge(study, runs);
    ASSERT_EQ(chart.points.size(), 1u);
    EXPECT_TRUE(std::isnan(chart.uncertainty));
    EXPECT_NE(chart.reference.find("nothing finer was run"), std::string::npos);
  }
}

TEST(Accuracy, AnExperimentThatFailsAsItStandsCannotBeJudged) {
  AccuracyStudy study = made_up({0.4, 0.2});
  study.settings[0].run = [](const std::atomic<bool>&) {
    AccuracyRun run;
    run.failure = "no equilibrium";
    return run;
  };
  const TemporaryFolder folder;
  const auto runs = run_settings(study, {10, folder / "a.csv", "f", nullptr, {}});
  expect_input_error([&] { judge(study, runs); }, {"made up", "nothing to compare", "taut replay"});
}

TEST(Accuracy, ParametersAreOffByWhatAFitWouldMakeOfTheError) {
  // One reading y = 1 / k: values 10 % too small look like a stiffness 10 % too small.
  AccuracyStudy study = made_up({0.4, 0.2});
  study.highest_order.clear();
  study.table.declare({"k", "k", "N/m", 1e-3, 1e3, "", true});
  study.nominal = Eigen::VectorXd::Constant(1, 0.5);
  study.free = {{0, 0.5, 1e-3, 1e3}};
  study.sigma = {0.02};
  for (size_t i : {0, 1}) {
    study.settings[i].run = [i](const std::atomic<bool>&) {
      const double y = i == 0 ? 2 : 1.8;
      AccuracyRun run;
      run.values = Eigen::VectorXd::Constant(1, y);
      run.derivatives = Eigen::MatrixXd::Constant(1, 1, -y / 0.5);
      return run;
    };
  }
  const TemporaryFolder folder;
  const AccuracyChart chart = judge(study, run_settings(study, {10, folder / "a.csv", "f", nullptr, {}}));
  EXPECT_NEAR(chart.points[0].parameters[0], 0, 1e-12);
  EXPECT_NEAR(chart.points[1].parameters[0], -0.1, 1e-9);
  EXPECT_NEAR(chart.points[1].error, 0.1, 1e-12);
  EXPECT_NEAR(chart.parameter_noise[0], 0.01, 1e-12) << "sigma / y";
}

TEST(Accuracy, SimulationsWithoutInertiaOrWithoutChannelsToCompareAreRefused) {
  const TemporaryFolder folder;
  const std::string path = folder.write("robot.toml", robot_toml);
  Simulation simulation = read_simulation(path);
  Simulation still = simulation;
  still.method = SimulationMethod::quasi_static;
  expect_input_error([&] { accuracy_study(still); }, {path, "no integrator to compare"});
  simulation.channels.clear();
  expect_input_error([&] { accuracy_study(simulation); }, {path, "no channel to compare", "position"});
}

/// The setting that is called so.
const AccuracySetting& called(const AccuracyStudy& study, const std::string& name) {
  const auto found = std::ranges::find(study.settings, name, &AccuracySetting::name);
  if (found == study.settings.end()) throw std::runtime_error("there is no setting '" + name + "'");
  return *found;
}

std::vector<std::string> names_of(const AccuracyStudy& study, const std::string& axis) {
  std::vector<std::string> names;
  for (const AccuracySetting& one : study.settings) {
    if (one.axis == axis) names.push_back(one.name);
  }
  return names;
}

Eigen::VectorXd values_of(const AccuracySetting& setting) {
  const std::atomic<bool> go_on{false};
  const AccuracyRun run = setting.run(go_on);
  EXPECT_EQ(run.failure, "") << setting.name;
  return run.values;
}

TEST(Accuracy, StepsOfARecordingTendToTheMotionWithTheOrderOfTheirIntegrator) {
  const TemporaryFolder folder;
  folder.write("ring.csv", hung_mass_csv(40));
  const AccuracyStudy study = accuracy_study(read_experiment(folder.write("experiment.toml", hung_mass_toml)));
  const auto error = [&](const std::string& name) {
    const AccuracySetting& one = called(study, name);
    EXPECT_EQ(one.integrator, name.substr(0, name.find(',')));
    const Eigen::VectorXd values = values_of(one);
    double worst = 0;
    for (int i = 0; i < 40; ++i)
      worst = std::max(worst, std::abs(values[i] - hung_mass_at(0.05e-3 * i)) * hung_k / hung_F);
    return worst;
  };
  const double coarse = error("BDF2, steps of 0.05 ms"), fine = error("BDF2, steps of 0.0125 ms");
  EXPECT_NEAR(std::log2(coarse / fine) / 2, 2, 0.2) << coarse << " " << fine;
  const double rough = error("implicit Euler, steps of 0.025 ms"), better = error("implicit Euler, steps of 0.0125 ms");
  EXPECT_NEAR(std::log2(rough / better), 1, 0.2) << rough << " " << better;
  EXPECT_GT(better, 4 * fine);
  EXPECT_EQ(names_of(study, "BDF2"),
            (std::vector<std::string>{"BDF2, steps of 0.1 ms", "BDF2, steps of 0.05 ms", "BDF2, steps of 0.0125 ms"}))
      << "0.025 ms are those in use";
  EXPECT_EQ(names_of(study, "implicit Euler").size(), 4u);
  const auto in_use = std::ranges::find(study.settings, true, &AccuracySetting::in_use);
  ASSERT_NE(in_use, study.settings.end());
  EXPECT_EQ(in_use->sequences.at("step"), 25e-6);
  EXPECT_EQ(called(study, "BDF2, steps of 0.0125 ms").sequences.at("step"), 12.5e-6);
  EXPECT_EQ(called(study, "implicit Euler, steps of 0.025 ms").sequences.count("step"), 0u) << "another order";
  EXPECT_EQ(in_use->integrator, "BDF2");
}

TEST(Accuracy, SamplesThatAreLeftOutLendTheirWeightToThoseThatStay) {
  const TemporaryFolder folder;
  folder.write("ring.csv", hung_mass_csv(250));
  const AccuracyStudy study = accuracy_study(read_experiment(folder.write("experiment.toml", hung_mass_toml)));
  ASSERT_EQ(study.sigma.size(), 2 * 84u) << "every third one of 250 in each of two channels";
  for (double sigma : study.sigma) EXPECT_NEAR(sigma, 0.2e-6 / std::sqrt(3), 1e-18);
  EXPECT_EQ(std::ranges::count(study.series, 0), 84);
  EXPECT_EQ(std::ranges::count(study.series, 1), 84);
  folder.write("ring.csv", hung_mass_csv(100));
  EXPECT_EQ(accuracy_study(read_experiment(folder / "experiment.toml")).sigma, std::vector(200, 0.2e-6));
}

TEST(Accuracy, ABeamIsSoftestInPlaneStressAndStiffestInPlaneStrainAndAsASolidBetween) {
  const TemporaryFolder folder;
  folder.write("bench.csv", "trial,pull_N,tip_mm\na,0.0005,0.01\na,0.001,0.02\nb,0.0005,0.01\n");
  const AccuracyStudy study = accuracy_study(read_experiment(folder.write("beam.toml", beam_toml)));
  ASSERT_EQ(study.sigma.size(), 2u);
  EXPECT_NEAR(study.sigma[0], 1e-4 / std::sqrt(2), 1e-16) << "the mean of two readings";
  EXPECT_NEAR(study.sigma[1], 1e-4, 1e-16);
  const auto in_use = std::ranges::find(study.settings, true, &AccuracySetting::in_use);
  ASSERT_NE(in_use, study.settings.end());
  EXPECT_EQ(in_use->model, "plane section, quadratic elements");
  const AccuracySetting &stress = called(study, "plane stress"),
                        &solid = called(study, "as a solid, 1 cell across half of it");
  EXPECT_EQ(solid.model, "solid");
  EXPECT_EQ(solid.sequences.at("depth"), 1);
  EXPECT_EQ(called(study, "as a solid, 2 cells across half of it").sequences.at("depth"), 0.5);
  const double narrow = values_of(stress)[1], wide = values_of(*in_use)[1], between = values_of(solid)[1];
  EXPECT_LT(wide, between);
  EXPECT_LT(between, narrow);
  // F L^3 / (3 E I) + F L / (kappa G A), in plane strain with E / (1 - nu^2).
  const double L = 0.06, H = 0.012, t = 0.02, E = 100e3, F = 0.001, nu = 0.3;
  const double bending = F * L * L * L / (3 * E * t * H * H * H / 12), shear = F * L / (5.0 / 6 * E / 2.6 * t * H);
  EXPECT_NEAR(narrow, bending + shear, 0.02 * narrow);
  EXPECT_NEAR(wide, (1 - nu * nu) * bending + shear, 0.02 * wide);
  EXPECT_NEAR(values_of(called(study, "model \"beam\""))[1], wide, 0.03 * wide);
  for (const char* name : {"2 load steps", "step tolerance 1e-07"})
    EXPECT_NEAR(values_of(called(study, name))[1], wide, 1e-5 * wide) << "small strains: no matter how they are solved";
  EXPECT_EQ(names_of(study, "load steps").size(), 3u) << "of 1, 2, 4 and 8 the file has one";
  EXPECT_EQ(names_of(study, "contact gap").size(), 0u);
  EXPECT_EQ(names_of(study, "quadratic, locking-free").size(), 0u);
  const std::string soft = folder.write("soft.toml", replaced(beam_toml, "nu = 0.3", "nu = 0.45"));
  EXPECT_GT(names_of(accuracy_study(read_experiment(soft)), "quadratic, locking-free").size(), 3u);
}

/// A block that falls freely and turns nothing.
const std::string falling_toml = R"(
title = "A falling block"
[simulation]
integrator = "implicit_euler"
duration = "40 ms"
step = "2 ms"
thickness = "20 mm"
gravity = "9.81 m/s2"
direction = [0, -1]
[[body]]
name = "block"
geometry = { kind = "rectangle", size = ["8 mm", "8 mm"], region = "rubber" }
mesh = { cells = [1, 1], element = "linear" }
[materials.rubber]
law = "neo_hookean"
E = "200 kPa"
nu = 0.3
density = "1000 kg/m3"
[[channel]]
id = "height"
kind = "displacement"
of = "block"
direction = [0, 1]
[[channel]]
id = "force"
kind = "net_force"
of = "block"
direction = [0, 1]
)";

TEST(Accuracy, AFallIsComparedAtAHundredAndOneInstantsBetweenItsSteps) {
  const TemporaryFolder folder;
  const AccuracyStudy study = accuracy_study(read_simulation(folder.write("fall.toml", falling_toml)));
  EXPECT_EQ(study.series, std::vector<int>(101, 0)) << "net forces are no curve";
  const double g = 9.81, duration = 0.04;
  // Implicit Euler after n steps: -g h^2 n (n + 1) / 2, straight between them.
  for (const auto& [name, h] : std::vector<std::pair<std::string, double>>{{"implicit Euler, steps of 4 ms", 0.004},
                                                                           {"implicit Euler, steps of 1 ms", 0.001}}) {
    const Eigen::VectorXd values = values_of(called(study, name));
    ASSERT_EQ(values.size(), 101);
    for (int i = 0; i <= 100; ++i) {
      const double t = duration * i / 100, n = std::min(std::floor(t / h + 1e-9), std::round(duration / h) - 1);
      const auto at = [&](double steps) { return -g * h * h * steps * (steps + 1) / 2; };
      const double s = t / h - n;
      EXPECT_NEAR(values[i], (1 - s) * at(n) + s * at(n + 1), 1e-7) << name << " at " << t;
    }
  }
  for (const char* name : {"CVODE, tolerance 1e-04", "ARKODE, implicit, tolerance 1e-04"}) {
    EXPECT_TRUE(called(study, name).may_hang);
    const Eigen::VectorXd values = values_of(called(study, name));
    EXPECT_NEAR(values[100], -g * duration * duration / 2, 2e-3 * g * duration * duration / 2) << name;
  }
  const auto in_use = std::ranges::find(study.settings, true, &AccuracySetting::in_use);
  ASSERT_NE(in_use, study.settings.end());
  EXPECT_TRUE(in_use->name.ends_with(", implicit Euler, steps of 2 ms")) << in_use->name;
  EXPECT_EQ(in_use->sequences.count("step"), 0u) << "of BDF2 alone";
  EXPECT_EQ(names_of(study, "implicit Euler").size(), 4u);
  EXPECT_EQ(names_of(study, "BDF2").size(), 5u);
  for (const AccuracySetting& one : study.settings)
    EXPECT_EQ(one.sequences.count("mesh"), one.axis == "quadratic elements" ? 1u : 0u)
        << one.name << ": linear elements tend to the answer more slowly";
  EXPECT_EQ(called(study, "BDF2, steps of 1 ms").sequences.at("step"), 1e-3);
  EXPECT_EQ(names_of(study, "contact gap").size(), 0u);

  const AccuracyStudy touching = accuracy_study(read_simulation(folder.write("robot.toml", robot_toml)));
  EXPECT_EQ(names_of(touching, "contact gap"), (std::vector<std::string>{"contact gap 1.2 mm", "contact gap 600 um",
                                                                         "contact gap 150 um", "contact gap 75 um"}));
  EXPECT_NEAR(called(touching, "contact gap 75 um").sequences.at("contact gap"), 75e-6, 1e-18);
  EXPECT_EQ(touching.series.size(), 5 * 101u) << "of six channels one is a net force";
}

}  // namespace
}  // namespace taut
