#include "calib/studies/lip_friction.hpp"

#include <gtest/gtest.h>

#include "calib/benches/static_bench.hpp"
#include "tests/support/message.hpp"
#include "tests/support/push_puppet.hpp"
#include "tests/support/static_bench.hpp"

namespace taut::test {
namespace {

/// The reference module at these retractions, read as it is, and the fit of its E.
struct FittedModule {
  std::unique_ptr<StaticBench> bench;
  FitResult fit;

  explicit FittedModule(const std::vector<double>& retractions, const std::vector<double>& masses = {0.050, 0.500}) {
    const Experiment module = reference_module(1);
    Trials trials = conditions_of(retractions, masses);
    const StaticReplay replay = make_static_replay(module, module.mesh, trials);
    const Prediction truth = predicted(replay);
    for (size_t i = 0; i < trials.readings.size(); ++i) {
      trials.readings[i].value = truth.values[replay.row_of_reading[i]];
      trials.readings[i].sigma = 1e-4;
    }
    bench = std::make_unique<StaticBench>(module, trials);
    const int E = bench->protocol().parameters().index("E_foam");
    FitOptions options;
    options.profiles = false;
    fit = taut::fit(bench->protocol(), bench->measurements(), {{E, 50e3, 1e3, 1e7}}, options);
    EXPECT_EQ(fit.status, FitStatus::converged);
  }
};

TEST(LipFriction, AClosedModuleIsStifferWithLipsThatStickAndAnOpenOneDoesNotCome) {
  const FittedModule module({0, kRetractions.back()});
  const std::optional<LipFriction> found = lip_friction(*module.bench, module.fit);
  ASSERT_TRUE(found.has_value());
  ASSERT_EQ(found->rows.size(), 2u) << "the open state has no lips that touch";
  for (const FrictionRow& row : found->rows) {
    EXPECT_EQ(row.controls[1], kRetractions.back());
    EXPECT_LT(row.sticking, row.sliding);
    EXPECT_GT(row.sticking, 0.3 * row.sliding);
    EXPECT_GT(row.sticking_stiffness, row.sliding_stiffness);
    EXPECT_NEAR(row.sliding_stiffness * row.sliding, row.controls[0] * 9.81, 1e-6);
  }
  const Share& share = found->share;
  EXPECT_EQ(share.source, "friction of the lips");
  ASSERT_EQ(share.bias.size(), 1u);
  EXPECT_GT(share.error[0], 0);
  EXPECT_EQ(share.error[0], std::abs(share.bias[0])) << "either end may be true";
}

/// Drop of the tip [m] from 50 to 500 g on the closed module, with what touches under 50 g held with this stiffness.
double drop_with(double stiffness) {
  const Experiment module = reference_module(1);
  StaticReplay replay = make_static_replay(module, module.mesh, conditions_of({kRetractions.back()}, {0.050, 0.500}));
  predicted(replay);
  const StaticProtocol& protocol = *replay.protocol;
  const StaticProtocol::Condition &before = protocol.conditions()[0], &loaded = protocol.conditions()[1];
  const Model& model = *protocol.scene().model;
  Grip grip(model.mesh(), *replay.contact, {before.u, before.p}, stiffness);
  EXPECT_GE(grip.count(), 2);
  for (;;) {
    const Model held(model, std::make_unique<Grip>(grip));
    Equilibrium equilibrium(held);
    equilibrium.start_at(before.u, before.p);
    EXPECT_EQ(equilibrium.solve(loaded.p).status, SolveStatus::converged);
    const int count = grip.count();
    grip.drop_open(equilibrium.u());
    const Channel& tip = *protocol.channels().front().channel;
    if (grip.count() == count) return tip.value({equilibrium.u(), loaded.p}) - tip.value({before.u, before.p});
  }
}

TEST(LipFriction, AGripThatIsTenTimesAsStiffChangesNothing) {
  const double drop = drop_with(10);
  EXPECT_NEAR(drop_with(100), drop, 1e-3 * drop);
}

TEST(LipFriction, AModuleThatNeverClosesStatesNothingAndCostsNothing) {
  const FittedModule module({0}, {0.050, 0.100});
  const Ask ask = [](Protocol& protocol, const Params& p, const std::vector<int>& free) {
    ADD_FAILURE() << "a prediction was asked for";
    return protocol.predict(p, free);
  };
  EXPECT_FALSE(lip_friction(*module.bench, module.fit, ask).has_value());
}

TEST(LipFriction, ABracketIsRefusedWhereThereIsNothingThatCloses) {
  const TemporaryFolder folder;
  const std::string csv = "trial,pull_N,tip_mm\n1,0.1,1\n1,0.2,2\n";
  const auto refused = [&](const std::string& toml, const std::vector<std::string>& parts) {
    expect_input_error([&] { experiment_in(folder, toml, csv); }, parts);
  };
  const std::string contact = replaced(beam_toml, "[bench]", "[contact]\nfriction = \"bracket\"\n[bench]");
  refused(contact, {"friction = \"bracket\"", "'retraction'", "leave it out"});
  refused(replaced(contact, "data = \"simulated\"", "data = \"simulated\"\nmodel = \"auto\""),
          {"friction = \"bracket\"", "\"auto\"", "\"full\""});
  refused(replaced(contact, "\"bracket\"", "0.3"), {"[contact] friction"});
  refused(replaced(contact, "\"bracket\"", "\"brackets\""), {"[contact] friction", "did you mean 'bracket'"});
}

}  // namespace
}  // namespace taut::test
