#include "calib/benches/uniaxial.hpp"

#include "calib/benches/material_point_bench.hpp"
#include "calib/files/experiment.hpp"
#include "sim/materials/neo_hookean.hpp"
#include "tests/support/experiment_files.hpp"
#include "tests/support/message.hpp"
#include "tests/support/taylor.hpp"

namespace taut {
namespace {

using namespace test;

const std::vector<PointRow> rows{{PointMode::tension, 0.3},      {PointMode::tension, 0},
                                 {PointMode::compression, -0.1}, {PointMode::compression, -0.3},
                                 {PointMode::compression, -0.5}, {PointMode::shear, 0.2}};

UniaxialProtocol neo_hookean(double nu) {
  return {"foam", "neo_hookean", {{"E", 1.0}, {"nu", nu}}, rows};
}

UniaxialProtocol ogden_hill(double nu, double alpha) {
  return {"foam", "ogden_hill", {{"E", 1.0}, {"nu", nu}, {"alpha", alpha}}, rows};
}

TEST(Uniaxial, NeoHookeanStressesAreTheTabulatedOnes) {
  UniaxialProtocol protocol = neo_hookean(0.3);
  const Prediction prediction = protocol.predict(protocol.nominal(), {});
  EXPECT_EQ(prediction.values[1], 0.0);
  EXPECT_NEAR(prediction.values[2], -0.108722, 6e-7);
  EXPECT_NEAR(prediction.values[3], -0.405230, 6e-7);
  EXPECT_NEAR(prediction.values[4], -0.935352, 6e-7);
  EXPECT_NEAR(prediction.values[5], 0.2 / 2.6, 1e-15) << "simple shear: mu times the amount of shear";
  EXPECT_TRUE(prediction.complete());
}

TEST(Uniaxial, OgdenHillWithoutPoissonEffectHasItsClosedForm) {
  const double alpha = 8;
  UniaxialProtocol protocol = ogden_hill(0, alpha);
  const Prediction prediction = protocol.predict(protocol.nominal(), {});
  for (Eigen::Index r = 0; r < 5; ++r) {
    const double s = 1 + rows[static_cast<size_t>(r)].strain;
    EXPECT_NEAR(prediction.values[r], (std::pow(s, alpha - 1) - 1 / s) / alpha, 1e-14);
  }
}

TEST(Uniaxial, DerivativesFollowTheFreeSides) {
  for (int law : {0, 1}) {
    UniaxialProtocol protocol = law == 0 ? neo_hookean(0.3) : ogden_hill(0.2, 7);
    const Params p = protocol.nominal();
    std::vector<int> free;
    for (int i = 0; i < p.size(); ++i) free.push_back(i);
    const Prediction here = protocol.predict(p, free);
    for (int i : free) {
      expect_taylor_order(
          [&](double h) {
            Params moved = p;
            moved[i] += h;
            return (protocol.predict(moved, {}).values - here.values - h * here.derivatives.col(i)).norm();
          },
          2, 1e-14, 0.1 * p[i], 6, protocol.parameters()[i].id);
    }
  }
}

TEST(Uniaxial, SidesAreFoundAtExtremeStretches) {
  for (double nu : {0.0, 0.2, 0.4}) {
    for (double alpha : {1.1, 10.0, 40.0}) {
      for (double strain : {-0.95, -0.6, 0.5, 3.0}) {
        UniaxialProtocol protocol("foam", "ogden_hill", {{"E", 1.0}, {"nu", nu}, {"alpha", alpha}},
                                  {{strain < 0 ? PointMode::compression : PointMode::tension, strain}});
        const Prediction prediction = protocol.predict(protocol.nominal(), {});
        EXPECT_TRUE(prediction.complete()) << nu << " " << alpha << " " << strain;
        EXPECT_GT(prediction.values[0] * strain, 0.0) << nu << " " << alpha << " " << strain;
      }
    }
  }
}

TEST(Uniaxial, FitRecoversTheConstantsOfSimulatedReadings) {
  UniaxialProtocol truth = ogden_hill(0.15, 9);
  const Eigen::VectorXd readings = truth.predict(truth.nominal(), {}).values;
  std::vector<Measurement> measurements;
  for (int r = 0; r < readings.size(); ++r) measurements.push_back({r, readings[r], 1e-3, r});
  UniaxialProtocol protocol = ogden_hill(0.0, 4);
  const FitResult result = fit(protocol, measurements, {{0, 0.5, 1e-2, 1e2}, {1, 0.05, 0, 0.4}, {2, 4, 1.1, 40}});
  EXPECT_EQ(result.status, FitStatus::converged);
  EXPECT_NEAR(result.p[0], 1.0, 1e-4);
  EXPECT_NEAR(result.p[1], 0.15, 1e-4);
  EXPECT_NEAR(result.p[2], 9.0, 1e-3);
}

TEST(Uniaxial, WrongConstantsAreRefused) {
  expect_input_error([] { UniaxialProtocol("foam", "ogden_hil", {}, {}); },
                     {"'ogden_hil'", "did you mean 'ogden_hill'"});
  expect_input_error(
      [] {
        UniaxialProtocol("foam", "ogden_hill", {{"E", 1e5}, {"nu", 0}}, {});
      },
      {"foam", "alpha", "missing"});
  expect_input_error(
      [] {
        UniaxialProtocol("foam", "neo_hookean", {{"E", 1e5}, {"mu", 0}}, {});
      },
      {"no constant 'mu'", "did you mean 'nu'"});
  expect_input_error(
      [] {
        UniaxialProtocol("foam", "neo_hookean", {{"E", 1e5}, {"nu", 0.6}}, {});
      },
      {"nu_foam = 0.6", "physical range"});
}

TEST(Softening, IsTheTabulatedOneAndNoneOnFirstLoading) {
  EXPECT_NEAR(Softening({3, 1, 0}, 0, 1).eta, 0.71910, 5e-6);
  EXPECT_EQ(Softening({3, 1, 0}, 1, 1).eta, 1.0);
  EXPECT_EQ(Softening({3, 1, 0.5}, 2, 2).eta, 1.0);
  EXPECT_NEAR(Softening({3, 1, 0}, 0, 100).eta, 1 - 1.0 / 3, 1e-15) << "at most 1 / r is lost";
}

/// First loading and unloading in tension and shear, with softening where it is asked for.
UniaxialProtocol softening(const std::optional<Mullins>& law, bool unloading = true) {
  std::vector<PointRow> cycle;
  for (const PointMode mode : {PointMode::tension, PointMode::shear}) {
    for (const double strain : {0.1, 0.2, 0.3, 0.4}) cycle.push_back({mode, strain, strain - 0.1});
    for (const double strain : {0.3, 0.2, 0.1}) {
      if (unloading) cycle.push_back({mode, strain, 0.4});
    }
  }
  return {"foam", "ogden_hill", {{"E", 1.0}, {"nu", 0.2}, {"alpha", 7}}, cycle, law};
}

TEST(Uniaxial, SofteningScalesTheStressOfUnloadingAndLeavesFirstLoadingAsItIs) {
  UniaxialProtocol with = softening(Mullins{2, 0.02, 0.1}), without = softening({});
  const Eigen::VectorXd soft = with.predict(with.nominal(), {}).values,
                        hard = without.predict(without.nominal(), {}).values;
  for (const Eigen::Index first : {0, 7}) {
    EXPECT_EQ(soft.segment(first, 4), hard.segment(first, 4));
    for (Eigen::Index r = first + 4; r < first + 7; ++r) {
      EXPECT_LT(soft[r], hard[r]);
      EXPECT_GT(soft[r], 0.5 * hard[r]);
    }
    EXPECT_LT(soft[first + 6] / hard[first + 6], soft[first + 4] / hard[first + 4])
        << "more the farther it is unloaded";
  }
}

TEST(Uniaxial, DerivativesGoThroughTheSofteningWithSlopeTwo) {
  UniaxialProtocol protocol = softening(Mullins{2, 0.02, 0.1});
  const Params p = protocol.nominal();
  std::vector<int> free;
  for (int i = 0; i < p.size(); ++i) free.push_back(i);
  const Prediction here = protocol.predict(p, free);
  for (int i : free) {
    expect_taylor_order(
        [&](double h) {
          Params moved = p;
          moved[i] += h;
          return (protocol.predict(moved, {}).values - here.values - h * here.derivatives.col(i)).norm();
        },
        2, 1e-13, 0.1 * p[i], 6, protocol.parameters()[i].id);
  }
}

/// A fit of E, r and m to what a softening foam reads with an error of 1 % of 0.1.
FitResult fit_softening(bool unloading) {
  UniaxialProtocol truth = softening(Mullins{2, 0.02, 0}, unloading),
                   protocol = softening(Mullins{3, 0.05, 0}, unloading);
  const Eigen::VectorXd readings = truth.predict(truth.nominal(), {}).values;
  std::vector<Measurement> measurements;
  for (int r = 0; r < readings.size(); ++r) measurements.push_back({r, readings[r], 1e-3, r});
  const ParameterTable& table = protocol.parameters();
  return fit(protocol, measurements,
             {{0, 0.5, 1e-2, 1e2},
              {table.index("mullins_r_foam"), 3, 1.05, 20},
              {table.index("mullins_m_foam"), 0.05, 1e-4, 1}});
}

TEST(Uniaxial, PlantedSofteningIsFoundAgainFromLoadingAndUnloading) {
  const FitResult result = fit_softening(true);
  ASSERT_EQ(result.status, FitStatus::converged);
  EXPECT_NEAR(result.parameters[0].value, 1.0, 1e-4);
  EXPECT_NEAR(result.parameters[1].value, 2.0, 1e-3);
  EXPECT_NEAR(result.parameters[2].value, 0.02, 2e-5);
  for (const ParameterEstimate& e : result.parameters) EXPECT_NE(e.verdict, Verdict::tied) << e.spec.id;
}

TEST(Uniaxial, FirstLoadingAloneDeterminesNoSoftening) {
  const FitResult result = fit_softening(false);
  EXPECT_EQ(result.parameters[0].verdict, Verdict::well_determined);
  for (const size_t j : {1u, 2u}) {
    EXPECT_NE(result.parameters[j].verdict, Verdict::well_determined) << result.parameters[j].spec.id;
    EXPECT_NE(result.parameters[j].verdict, Verdict::weakly_determined) << result.parameters[j].spec.id;
  }
}

/// Writes an experiment and its bench, one line replaced at wish.
std::string written(
    const TemporaryFolder& folder, const std::string& from = "", const std::string& to = "",
    const std::string& bench = "mode,strain_%,stress_kPa\ntension,10,9\ncompression,-10,-9\nshear,5,2\n") {
  const std::string text = R"(title = "foam"
data = "measured"
[geometry]
kind = "uniaxial"
[materials.foam]
law = "ogden_hill"
E = "100 kPa"
nu = 0
alpha = 8
[bench]
file = "bench.csv"
mode = "mode"
strain = "strain_%"
stress = "stress_kPa"
noise = { absolute = "1 kPa", relative = "5 %" }
[fit.free.E_foam]
start = "90 kPa"
[fit.free.alpha_foam]
[[fit.variant]]
name = "neo-Hookean in compression"
law = "neo_hookean"
modes = ["compression"]
)";
  folder.write("bench.csv", bench);
  return folder.write("uniaxial.toml", from.empty() ? text : replaced(text, from, to));
}

TEST(Uniaxial, ExperimentFilesAreRead) {
  const TemporaryFolder folder;
  const std::string path = written(folder);
  const Experiment experiment = read_experiment(path);
  EXPECT_FALSE(experiment.kind->specimen);
  EXPECT_EQ(experiment.materials.front().constants.at("alpha"), 8);
  ASSERT_EQ(experiment.variants.size(), 1u);
  EXPECT_EQ(experiment.variants[0].constants.at("E"), 1e5) << "the material's own where the variant gives none";
  EXPECT_EQ(experiment.variants[0].constants.count("alpha"), 0u);
  EXPECT_EQ(experiment.variants[0].modes, std::vector<std::string>{"compression"});
  const Trials trials = read_trials(experiment.bench);
  const PointReplay bench = make_point_replay(experiment.bench, trials);
  ASSERT_EQ(bench.rows.size(), 3u);
  EXPECT_EQ(bench.rows[1].mode, PointMode::compression);
  EXPECT_NEAR(bench.rows[1].strain, -0.1, 1e-15);
  EXPECT_NEAR(bench.measurements[1].value, -9000, 1e-9);
  EXPECT_NEAR(bench.measurements[1].sigma, std::hypot(1000.0, 450.0), 1e-9);
  const MaterialSettings& material = experiment.materials.front();
  const UniaxialProtocol main(material.region, material.law, material.constants, bench.rows);
  EXPECT_EQ(free_parameters_of_law(experiment, main).size(), 2u);
  const UniaxialProtocol other(material.region, "neo_hookean", experiment.variants[0].constants, bench.rows);
  const std::vector<FreeParameter> free = free_parameters_of_law(experiment, other);
  ASSERT_EQ(free.size(), 1u) << "a law without alpha";
  EXPECT_NEAR(free[0].start, 9e4, 1e-9);
}

TEST(Uniaxial, SofteningIsReadWithTheOrderInWhichASpecimenWasStrained) {
  const TemporaryFolder folder;
  const auto read = [&](const std::string& order, const std::string& bench) {
    const std::string path = written(folder, "alpha = 8\n[bench]\n",
                                     "alpha = 8\nmullins = { r = 2, m = \"5 kPa\" }\n[bench]\n" + order, bench);
    const Experiment experiment = read_experiment(path);
    EXPECT_EQ(point_settings(experiment).mullins->m, 5e3);
    return make_point_replay(experiment.bench, read_trials(experiment.bench), true);
  };
  const PointReplay as_it_stands = read("", "mode,strain_%,stress_kPa\ntension,10,9\ntension,20,15\ntension,10,7\n");
  ASSERT_EQ(as_it_stands.rows.size(), 3u);
  EXPECT_EQ(as_it_stands.rows[0].peak, 0.0);
  EXPECT_EQ(as_it_stands.rows[1].peak, 0.0) << "less than it";
  EXPECT_NEAR(as_it_stands.rows[2].peak, 0.2, 1e-15);
  const PointReplay ordered = read("trial = \"piece\"\norder = \"n_1\"\n",
                                   "piece,n_1,mode,strain_%,stress_kPa\na,3,tension,10,7\na,1,tension,10,9\n"
                                   "a,2,tension,20,15\nb,1,tension,10,9\nb,2,compression,-5,-5\n");
  ASSERT_EQ(ordered.rows.size(), 4u) << "first loading of both pieces is one row";
  EXPECT_NEAR(ordered.rows[0].peak, 0.2, 1e-15);
  EXPECT_EQ(ordered.rows[1].peak, 0.0);
  EXPECT_EQ(ordered.rows[3].peak, 0.0) << "each mode has specimens of its own";
  const Experiment experiment = read_experiment(folder / "uniaxial.toml");
  const std::unique_ptr<Bench> bench = material_point_kind.open(experiment);
  EXPECT_EQ(bench->readings().front().controls.size(), bench->controls().size());
  EXPECT_TRUE(bench->protocol().parameters().contains("mullins_r_foam"));
}

TEST(Uniaxial, WrongExperimentFilesAreRefused) {
  const TemporaryFolder folder;
  const auto expect = [&](const std::string& from, const std::string& to, const std::vector<std::string>& parts) {
    const std::string path = written(folder, from, to);
    expect_input_error([&] { read_experiment(path); }, parts);
  };
  expect("alpha = 8", "alpha = 80", {"alpha", "outside the physical range"});
  expect("alpha = 8", "alpha = 8\nmullins = { r = 1, m = \"5 kPa\" }", {"mullins", "r", "above 1"});
  expect("alpha = 8", "alpha = 8\nmullins = { r = 2, m = \"0 kPa\" }", {"mullins", "m", "energy density"});
  expect("alpha = 8", "alpha = 8\nmullins = { r = 2, m = \"5 kPa\", beta = -1 }", {"beta", "zero or more"});
  expect("[bench]", "[bench]\norder = \"n\"", {"order", "with softening only", "'mullins'"});
  expect("noise = { absolute = \"1 kPa\", relative = \"5 %\" }\n", "", {"no noise", "'sigma'"});
  expect("[\"compression\"]", "[\"compresion\"]", {"'compresion'", "did you mean 'compression'", "shear"});
  expect("law = \"ogden_hill\"", "law = \"ogden\"", {"'ogden'", "ogden_hill"});
  expect("[fit.free.alpha_foam]", "[mesh]", {"mesh"});
  expect("strain = \"strain_%\"\n", "", {"'strain' is missing"});
}

TEST(Uniaxial, StrainsOfTheWrongSignAreRefused) {
  for (const char* row : {"tension,-10,9", "compression,10,-9", "compression,-100,-9"}) {
    const TemporaryFolder folder;
    const std::string path = written(folder, "", "", std::string("mode,strain_%,stress_kPa\n") + row + "\n");
    const BenchFormat format = read_experiment(path).bench;
    expect_input_error([&] { make_point_replay(format, read_trials(format)); }, {"line 2", "engineering strain"});
  }
}

}  // namespace
}  // namespace taut
