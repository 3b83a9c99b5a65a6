#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <nlohmann/json.hpp>

#include "tests/support/command.hpp"

// `taut replay --sensitivities` against central differences of whole commands.
namespace taut {
namespace {

using namespace test;
using Json = nlohmann::json;

Json replay(const TemporaryFolder& folder, const std::string& csv, const std::vector<std::string>& more = {}) {
  folder.write("bench.csv", csv);
  folder.write("experiment.toml", beam_toml);
  std::vector<std::string> arguments{"replay", "experiment.toml", "--json", "--quiet", "--out", "run"};
  arguments.insert(arguments.end(), more.begin(), more.end());
  const Outcome outcome = run_in(folder / "", arguments);
  EXPECT_EQ(outcome.code, 0) << outcome.err;
  return Json::parse(outcome.out);
}

std::string csv_of(double pull) {
  return fmt::format("trial,pull_N,tip_mm\na,{:.12g},1\n", pull);
}

double value(const Json& run) {
  return run["rows"][0]["predicted_m"];
}

TEST(ReplaySensitivities, AreThoseOfWholeCommands) {
  const TemporaryFolder folder;
  const double pull = 0.1, step = 1e-3;
  const Json here = replay(folder, csv_of(pull), {"--sensitivities"});
  const Json& all = here["sensitivities"]["with_respect_to"];
  std::map<std::string, double> derivative;
  for (size_t i = 0; i < all.size(); ++i) derivative[all[i]["id"]] = here["sensitivities"]["rows"][0]["derivatives"][i];
  EXPECT_TRUE(std::filesystem::exists(folder / "run/sensitivities.csv"));

  const std::map<std::string, std::pair<double, std::string>> parameters{
      {"E_foam", {100, "kPa"}}, {"nu_foam", {0.3, ""}}, {"thickness", {20, "mm"}}};
  for (const auto& [id, nominal] : parameters) {
    const auto at = [&](double factor) {
      const std::string text = fmt::format("{}={:.12g} {}", id, nominal.first * factor, nominal.second);
      return value(replay(folder, csv_of(pull), {"--set", text.substr(0, text.find_last_not_of(' ') + 1)}));
    };
    const double si = nominal.second == "kPa" ? 1e3 : nominal.second == "mm" ? 1e-3 : 1;
    const double slope = (at(1 + step) - at(1 - step)) / (2 * step * nominal.first * si);
    EXPECT_NEAR(derivative[id], slope, 1e-5 * std::abs(slope)) << id;
  }
  const double more = value(replay(folder, csv_of(pull * (1 + step)))),
               less = value(replay(folder, csv_of(pull * (1 - step)))), slope = (more - less) / (2 * step * pull);
  EXPECT_NEAR(derivative["pull"], slope, 1e-5 * std::abs(slope)) << "a control";
  // The channel is the load's own displacement.
  EXPECT_NEAR(here["sensitivities"]["tangent_stiffness"][0]["N_per_m"].get<double>(), 1 / slope, 1e-5 / slope);
}

}  // namespace
}  // namespace taut
