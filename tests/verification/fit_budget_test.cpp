#include <gtest/gtest.h>

#include "calib/benches/static_protocol.hpp"
#include "calib/fit/fit.hpp"
#include "tests/support/problems.hpp"

// What a fit costs, counted in factorisations, so that the answer does not depend on the machine.
namespace taut {
namespace {

using namespace test;

/// The cantilever A1 (16 quadratic elements through its height), read at its tip under four loads.
StaticProtocol four_loads() {
  Problem problem = problem_a1(16, 2);
  std::vector<NamedChannel> channels;
  channels.push_back({"tip", make_linear_channel(problem.tip)});
  std::vector<StaticRow> rows;
  for (const double force : {0.5, 1.0, 2.0, 4.0}) rows.push_back({{force}, 0});
  return {std::move(problem.scene), std::move(channels), {problem.force}, {}, rows, {}};
}

TEST(FitBudget, AFitFromAStartThreeTimesOffTakesAtMostSixTimesTheFactorisationsOfAColdReplay) {
  StaticProtocol replay = four_loads();
  const int E = replay.parameters().index("E_beam");
  const Prediction truth = replay.predict(replay.nominal(), {});
  ASSERT_TRUE(truth.complete()) << truth.failures.front();
  const int cold = replay.factorisations();
  std::vector<Measurement> measurements;
  for (int row = 0; row < 4; ++row) measurements.push_back({row, truth.values[row], 1e-5, row});

  for (const double factor : {3.0, 1.0 / 3}) {
    StaticProtocol protocol = four_loads();
    const FitResult result = fit(protocol, measurements, {{E, 1e5 * factor, 1e3, 1e7}});
    EXPECT_EQ(result.status, FitStatus::converged) << result.message;
    EXPECT_NEAR(result.parameters[0].value, 1e5, 1) << "to 1e-5";
    EXPECT_EQ(result.failed_evaluations, 0);
    std::printf(
        "start %.4g Pa: %d factorisations in %d evaluations, %.2f times the %d of a cold replay (%d unknowns)\n",
        1e5 * factor, protocol.factorisations(), result.evaluations,
        static_cast<double>(protocol.factorisations()) / cold, cold, protocol.scene().model->free_unknowns());
    EXPECT_LE(protocol.factorisations(), 6 * cold) << "the last, cold computation included";
  }
}

}  // namespace
}  // namespace taut
