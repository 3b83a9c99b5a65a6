#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "tests/support/arch.hpp"
#include "tests/support/command.hpp"

namespace taut {
namespace {

using namespace test;

/// Whether `text` holds all of these.
void expect_named(const std::string& text, const std::vector<std::string>& parts) {
  for (const std::string& part : parts) EXPECT_NE(text.find(part), std::string::npos) << part << " in: " << text;
}

TEST(TwoEquilibria, AreNamedByFitInItsRecordTableAndReportAndByPredict) {
  TemporaryFolder folder;
  folder.write("arch.msh", arch_msh());
  // Line 4 was read snapped through already; line 6 is near the fold.
  folder.write("bench.csv", arch_csv({{8, 0.352}, {12, 0.577}, {16, 8.144}, {20, 1.263}, {23.9, 2.12}, {28, 9.462}}));
  folder.write("experiment.toml", arch_toml);
  const Outcome fit = done_in(folder / "", {"fit", "experiment.toml", "--out", "run"});
  EXPECT_EQ(fit.code, 0) << fit.err;
  expect_named(fit.out, {"line 4, push = 16 mN: two equilibria, drop ", "line 6, push = 23.9 mN",
                         "the readings decide for the first, in which they are predicted", "near a fold: at 1.0"});
  expect_named(fit.err, {"1 row(s)", "chi squared falls from"});
  expect_named(text_of(folder / "run/predictions.csv"), {",equilibria,", ",the other of two,", ",near a fold,"});
  expect_named(text_of(folder / "run/report.html"), {"Of several equilibria: line 4", "(the other of two)"});
  const auto record = nlohmann::json::parse(text_of(folder / "run/fit.json"));
  EXPECT_EQ(record.at("equilibria").at(0).at("lines"), nlohmann::json({4}));
  EXPECT_EQ(record.at("equilibria").at(0).at("decided"), "other");
  EXPECT_EQ(done_in(folder / "", {"report", "run"}).code, 0) << "the record is read again";

  folder.write("new.csv", "push_mN\n8\n18\n");
  const Outcome far = done_in(folder / "", {"predict", "run", "--rows", "new.csv"});
  EXPECT_EQ(far.code, 0) << far.err;
  EXPECT_EQ(far.out.find("equilibria"), std::string::npos) << "the loads stay below the snap";
  folder.write("new.csv", "push_mN\n8\n23.5\n");
  const Outcome near = done_in(folder / "", {"predict", "run", "--rows", "new.csv"});
  expect_named(near.out, {",equilibria,", ",near a fold,"});
  expect_named(near.err, {"warning: line 3, push = 23.5 mN: two equilibria", "near a fold"});
}

}  // namespace
}  // namespace taut
