#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

#include "tests/support/command.hpp"

// The numbers of the shipped experiments, as taut 0.1.0 found them before its pipelines became one, on one machine.
// They may move by rounding where another BLAS kernel sums in another order, and by nothing else.
namespace taut {
namespace {

using namespace test;
using Json = nlohmann::ordered_json;  // what is written reads as it was put together

/// Members of each entry of a list.
Json picked(const Json& list, const std::vector<std::string>& names) {
  Json result = Json::array();
  for (const Json& entry : list) {
    Json one;
    for (const std::string& name : names) one[name] = entry.at(name);
    result.push_back(one);
  }
  return result;
}

/// One member of each entry of a list.
Json column(const Json& list, const std::string& name) {
  Json result = Json::array();
  for (const Json& entry : list) result.push_back(entry.at(name));
  return result;
}

Json numbers_of_fit(const Json& run) {
  Json result;
  result["parameters"] = picked(run.at("parameters"), {"id", "value", "standard_error", "interval95", "verdict"});
  result["shares"] = picked(run.at("shares"), {"source", "bias", "error"});
  result["chi_squared"] = run.at("fit").at("chi_squared");
  result["predicted"] = column(run.at("readings"), "predicted");
  result["variants"] = picked(run.at("variants"), {"name", "values"});
  result["diagnostics"] = column(run.at("diagnostics"), "value");
  result["swings"] = Json::array();
  for (const Json& swing : run.at("swings"))
    result["swings"].push_back({swing.at("predicted_frequency_Hz"), swing.at("predicted_decay_per_s")});
  return result;
}

Json numbers_of_simulation(const Json& run) {
  Json result;
  for (const auto& [id, channel] : run.at("channels").items())
    result["channels"][id] = {{"min", channel.at("min")}, {"max", channel.at("max")}, {"end", channel.at("end")}};
  result["workspace_m2"] = run.value("workspace_m2", Json::object());
  return result;
}

Json numbers_of_poses(const Json& run) {
  Json result = Json::array();
  for (const Json& target : run.at("targets")) {
    for (const Json& point : target.at("points")) {
      Json& pose = result.emplace_back();
      for (const char* name : {"status", "stiffness_N_per_m"}) pose[name] = point.value(name, Json());
      for (const auto& [id, control] : point.at("controls").items()) pose["controls"][id] = control.at("value");
      for (const auto& [id, channel] : point.at("channels").items()) pose["channels"][id] = channel.at("achieved");
    }
  }
  return result;
}

/// Shares extrapolate small differences, profile ends are searched to half a per cent of a rise, poses to their
/// tolerance, by steps that amplify rounding. In which of two equilibria a sample of a workspace ends turns on it, too:
/// OpenBLAS's kernels for AVX-512 and those for AVX2 (OPENBLAS_CORETYPE=Haswell) differ by 6e-4 in the arm's hybrid
/// one.
double tolerance_at(const std::string& path) {
  const auto in = [&](const char* part) { return path.find(part) != std::string::npos; };
  if (in("workspace")) return 1e-3;
  return in("shares") || in("interval95") || in("ik_") ? 1e-4 : 1e-6;
}

/// `scale`: what a number is small against: the largest beside it.
void expect_same(const Json& golden, const Json& now, const std::string& path, double scale) {
  ASSERT_EQ(golden.size(), now.size()) << path;
  if (golden.is_number() && now.is_number()) {
    EXPECT_NEAR(now.get<double>(), golden.get<double>(), tolerance_at(path) * scale) << path;
    return;
  }
  if (!golden.is_structured()) {
    EXPECT_EQ(golden, now) << path;
    return;
  }
  double largest = 0;
  for (const Json& entry : golden) {
    if (entry.is_number()) largest = std::max(largest, std::abs(entry.get<double>()));
  }
  for (const auto& [key, entry] : golden.items()) {
    const Json& other = golden.is_array() ? now.at(std::stoul(key)) : now.at(key);
    const bool own = key == "value" || key == "standard_error" || key == "chi_squared";
    expect_same(entry, other, path + "/" + key, own && entry.is_number() ? std::abs(entry.get<double>()) : largest);
  }
}

struct Golden {
  std::string command, experiment, file;
  std::vector<std::string> more = {};  ///< words of the command
};

class GoldenNumbers : public testing::TestWithParam<Golden> {};

TEST_P(GoldenNumbers, AreWhatTheyWere) {
  const TemporaryFolder folder;
  const Golden& golden = GetParam();
  const std::string root(TAUT_SOURCE_DIR);
  std::vector<std::string> words{
      golden.command, root + "/experiments/" + golden.experiment, "--json", "--quiet", "--out", "run"};
  words.insert(words.end(), golden.more.begin(), golden.more.end());
  const Outcome outcome = run_in(folder / "", words);
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  const Json run = Json::parse(outcome.out);
  const Json now = golden.command == "fit"  ? numbers_of_fit(run)
                   : golden.command == "ik" ? numbers_of_poses(run)
                                            : numbers_of_simulation(run);
  expect_same(Json::parse(text_of(root + "/tests/golden/" + golden.file + ".json")), now, golden.file, 1);
  if (!HasFailure()) return;
  const std::string seen = golden.file + "_now.json";
  std::ofstream(seen) << now.dump(1);
  ADD_FAILURE() << std::filesystem::absolute(seen).string() << " has the numbers of now";
}

INSTANTIATE_TEST_SUITE_P(Slow, GoldenNumbers,
                         testing::Values(Golden{"fit", "foam_cantilever/experiment.toml", "fit_foam_cantilever"},
                                         Golden{"fit", "foam_point/experiment.toml", "fit_foam_point"},
                                         Golden{"fit", "silicone_block/experiment.toml", "fit_silicone_block"},
                                         Golden{"fit", "silicone_swing/experiment.toml", "fit_silicone_swing"},
                                         Golden{"fit", "push_puppet/experiment.toml", "fit_push_puppet"},
                                         Golden{"fit", "tentacle/experiment.toml", "fit_tentacle"},
                                         Golden{"simulate", "ball_impact/experiment.toml", "simulate_ball_impact"},
                                         Golden{"simulate", "finger_bend/experiment.toml", "simulate_finger_bend"},
                                         Golden{"simulate", "finger_straighten/experiment.toml",
                                                "simulate_finger_straighten"},
                                         Golden{"simulate", "sheet/experiment.toml", "simulate_sheet"},
                                         Golden{"simulate", "stiffening/experiment.toml", "simulate_stiffening"},
                                         Golden{"simulate", "twist/experiment.toml", "simulate_twist"},
                                         Golden{"simulate", "arm/experiment.toml", "simulate_arm"},
                                         Golden{"simulate", "arm/tip_mass.toml", "simulate_tip_mass"},
                                         Golden{"ik", "arm/experiment.toml", "ik_arm", {"--target", "80 N per m"}}),
                         [](const testing::TestParamInfo<Golden>& one) { return one.param.file; });

}  // namespace
}  // namespace taut
