#include "calib/studies/discretisation.hpp"

#include <gtest/gtest.h>

#include "calib/files/experiment.hpp"
#include "tests/support/experiment_files.hpp"

namespace taut::test {
namespace {

/// Poisson's ratio of a small beam in plane strain, fitted with linear elements to the tip's rest position under one
/// load, which a finer, quadratic mesh predicts at the ratio planted in the file.
struct PoissonFit {
  static constexpr double planted = 0.3;
  FitResult fit;
  std::vector<Share> shares;

  PoissonFit() {
    const TemporaryFolder folder;
    folder.write("bench.csv", "trial,pull_N,tip_mm\na,0.05,1\n");
    std::string text =
        replaced(beam_toml, "[fit.free.E_foam]\nstart = \"50 kPa\"\nlower = \"1 kPa\"\nupper = \"10 MPa\"",
                 "[fit.free.nu_foam]\nstart = 0.2\nlower = 0.01\nupper = 0.45");
    Experiment e = read_experiment(folder.write("beam.toml", text));
    Trials trials = read_trials(e.bench);
    MeshSettings fine = e.mesh;
    fine.cells = {40, 16};
    const StaticReplay truth = make_static_replay(e, fine, trials);
    trials.readings[0].value = truth.protocol->predict(truth.protocol->nominal(), {}).values[truth.row_of_reading[0]];
    trials.readings[0].sigma = 0.001 * trials.readings[0].value;
    e.mesh.order = 1;
    e.mesh.cells = {40, 16};
    const StaticReplay bench = make_static_replay(e, e.mesh, trials);
    FitOptions options;
    options.profiles = false;
    fit = taut::fit(*bench.protocol, bench.measurements, free_parameters(e, *bench.protocol), options);
    shares = discretisation_shares(e, trials, fit);
  }
};

TEST(Discretisation, TheBiasOfAParameterThatIsNotLogarithmicHasTheSignAndSizeOfItsError) {
  const PoissonFit found;
  ASSERT_EQ(found.fit.status, FitStatus::converged) << found.fit.message;
  ASSERT_EQ(found.shares.size(), 1u);
  const ParameterEstimate& nu = found.fit.parameters[0];
  ASSERT_FALSE(nu.spec.logarithmic);
  const double off = nu.value - PoissonFit::planted;
  EXPECT_LT(off, -0.005) << "linear elements are too stiff, which a smaller ratio makes up for in plane strain";
  EXPECT_NEAR(found.shares[0].bias[0], off, 0.15 * std::abs(off));
}

TEST(Discretisation, APlaneMeshOfElevenThousandUnknownsIsHalvedAndDoubled) {
  const TemporaryFolder folder;
  folder.write("bench.csv", "trial,pull_N,tip_mm\na,0.01,1\n");
  const Experiment e =
      read_experiment(folder.write("beam.toml", replaced(beam_toml, "cells = [10, 4]", "cells = [60, 24]")));
  Trials trials = read_trials(e.bench);
  const StaticReplay bench = make_static_replay(e, e.mesh, trials);
  std::vector<Measurement> exact = bench.measurements;
  exact[0].value = bench.protocol->predict(bench.protocol->nominal(), {}).values[exact[0].row];
  trials.readings[0].value = exact[0].value;
  FitOptions options;
  options.profiles = false;
  const FitResult found = taut::fit(*bench.protocol, exact, free_parameters(e, *bench.protocol), options);
  ASSERT_EQ(found.status, FitStatus::converged) << found.message;
  const std::string how = discretisation_shares(e, trials, found).at(0).how;
  for (const char* part : {"30 x 12", "60 x 24", "120 x 48"})
    EXPECT_NE(how.find(part), std::string::npos) << part << ": " << how;
  EXPECT_EQ(how.find("too long"), std::string::npos) << how;
}

}  // namespace
}  // namespace taut::test
