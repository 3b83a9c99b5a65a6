#include "calib/benches/uniaxial.hpp"

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

TEST(Uniaxial, WrongExperimentFilesAreRefused) {
  const TemporaryFolder folder;
  const auto expect = [&](const std::string& from, const std::string& to, const std::vector<std::string>& parts) {
    const std::string path = written(folder, from, to);
    expect_input_error([&] { read_experiment(path); }, parts);
  };
  expect("alpha = 8", "alpha = 80", {"alpha", "outside the physical range"});
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
