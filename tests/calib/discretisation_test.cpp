#include "calib/studies/discretisation.hpp"

#include <gtest/gtest.h>

#include <functional>

#include "calib/files/experiment.hpp"
#include "tests/support/experiment_files.hpp"

namespace taut::test {
namespace {

/// Poisson's ratio of a small beam in plane strain, fitted to one reading that `fine` predicts at the ratio planted in
/// the file, with the mesh `own`.
struct PoissonFit {
  double planted = 0;
  FitResult fit;
  std::vector<Share> shares;

  PoissonFit(const std::string& beam, const std::function<void(MeshSettings&)>& fine,
             const std::function<void(MeshSettings&)>& own) {
    const TemporaryFolder folder;
    folder.write("bench.csv", "trial,pull_N,tip_mm\na,0.05,1\n");
    Experiment e = read_experiment(folder.write(
        "beam.toml", replaced(beam, "[fit.free.E_foam]\nstart = \"50 kPa\"\nlower = \"1 kPa\"\nupper = \"10 MPa\"",
                              "[fit.free.nu_foam]\nstart = 0.2\nlower = 0.01\nupper = 0.45")));
    planted = e.materials[0].constants.at("nu");
    Trials trials = read_trials(e.bench);
    MeshSettings settings = e.mesh;
    fine(settings);
    const StaticReplay truth = make_static_replay(e, settings, trials);
    trials.readings[0].value = truth.protocol->predict(truth.protocol->nominal(), {}).values[truth.row_of_reading[0]];
    trials.readings[0].sigma = 0.001 * trials.readings[0].value;
    own(e.mesh);
    const StaticReplay bench = make_static_replay(e, e.mesh, trials);
    FitOptions options;
    options.profiles = false;
    fit = taut::fit(*bench.protocol, bench.measurements, free_parameters(e, *bench.protocol), options);
    shares = discretisation_shares(e, trials, fit);
  }
  /// How far the fit is from the truth.
  double off() const {
    EXPECT_EQ(fit.status, FitStatus::converged) << fit.message;
    EXPECT_FALSE(fit.parameters[0].spec.logarithmic);
    return fit.parameters[0].value - planted;
  }
};

TEST(Discretisation, DifferencesThatTurnBySixtyDegreesAreNotExtrapolated) {
  // From (2, b, b, b) to (1, 0, 0, 0): cos = 1/2 of b = 2.
  const auto turning = [](double b) {
    Eigen::MatrixXd values(4, 3);
    values << 0, 2, 3, 0, b, b, 0, b, b, 0, b, b;
    return extrapolate({4, 2, 1}, values, 4);
  };
  EXPECT_TRUE(turning(1.99).measured);
  EXPECT_FALSE(turning(2).measured);
  EXPECT_FALSE(turning(2.01).measured);
  EXPECT_NEAR(turning(1.99).order, 1, 1e-9) << "halved with the elements";
}

TEST(Discretisation, TheMeshBiasOfAParameterThatIsNotLogarithmicHasTheSignAndSizeOfItsError) {
  const PoissonFit found(
      beam_toml,
      [](MeshSettings& fine) {
        fine.cells = {40, 16};
      },
      [](MeshSettings& own) {
        own.order = 1;
        own.cells = {40, 16};
      });
  ASSERT_EQ(found.shares.size(), 1u);
  EXPECT_LT(found.off(), -0.005) << "linear elements are too stiff, which a smaller ratio makes up for in plane strain";
  EXPECT_NEAR(found.shares[0].bias[0], found.off(), 0.15 * std::abs(found.off()));
}

TEST(Discretisation, TheGapBiasOfAParameterThatIsNotLogarithmicHasTheSignAndSizeOfItsError) {
  // Loaded along its top, the beam comes to rest on the ground with its tip, which a gap holds up, and so its middle.
  std::string propped = beam_toml + "\n[[contact.ground]]\npoint = [\"0 mm\", \"-5 mm\"]\nnormal = [0, 1]\n";
  propped = replaced(replaced(propped, "E = \"100 kPa\"", "E = \"25 kPa\""), "nu = 0.3", "nu = 0.4");
  propped = replaced(propped, "on = \"xmax\"\ndirection = [0, -1]\ncolumn = \"pull_N\"",
                     "on = \"ymax\"\ndirection = [0, -1]\ncolumn = \"pull_N\"");
  propped = replaced(propped, "on = \"xmax\"\ndirection = [0, -1]\ncolumn = \"tip_mm\"",
                     "point = [\"30 mm\", \"12 mm\"]\ndirection = [0, -1]\ncolumn = \"tip_mm\"");
  const PoissonFit found(
      propped, [](MeshSettings& fine) { fine.contact_gap = 0.5e-6; },
      [](MeshSettings& own) { own.contact_gap = 50e-6; });
  ASSERT_EQ(found.shares.size(), 2u);
  ASSERT_EQ(found.shares[1].source, "contact gap");
  EXPECT_LT(found.off(), -0.01) << "held up too high, the beam has to be softer to sag as far";
  EXPECT_NEAR(found.shares[1].bias[0], found.off(), 0.1 * std::abs(found.off()));
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
