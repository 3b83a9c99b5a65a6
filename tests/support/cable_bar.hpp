#pragma once
#include <fmt/format.h>

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "tests/support/command.hpp"
#include "tests/support/experiment_files.hpp"

// A bar of foam, pulled along its axis, with a cable along the same axis whose way from slack to taut is so long that
// its stiffness is a straight line over the retraction. Then all is a closed form.
namespace taut::test {

inline constexpr double kLength = 60e-3, kArea = 12e-3 * 20e-3;         // of the bar [m], [m2]
inline constexpr double kCable = 8, kSlack = 5e-3, kTransition = 4e-3;  // [N/m], [m], [m]

inline const std::string bar_toml =
    foam_piece("A bar with a cable", "[4, 2]", "E = \"100 kPa\"\nnu = 0\n") + R"(fix = ["x", "y"]

[cables]
k = "8 N/m"
slack = "5 mm"
smoothing = "4 mm"
retraction = "retraction_mm"

[[cables.cable]]
id = "middle"
x = ["-20 mm", "60 mm"]
y = ["6 mm", "6 mm"]

[[load]]
id = "pull"
on = "xmax"
direction = [1, 0]
column = "pull_N"

[[channel]]
id = "tip"
on = "xmax"
direction = [1, 0]
column = "tip_mm"
noise = { absolute = "0.001 mm" }

[bench]
file = "bench.csv"

[fit.free.E_foam]
start = "80 kPa"
lower = "1 kPa"
upper = "10 MPa"

[fit.free.k_cable]
start = "5 N/m"
lower = "0.1 N/m"
upper = "1 kN/m"
)";

/// Readings of the file's own model, to a micrometre, at two pulls [N] and these retractions [mm]; and their fit, in
/// the folder `run`.
inline void fit_own_readings(const TemporaryFolder& folder, const std::string& run, const std::string& toml,
                             const std::vector<double>& retractions, double pull) {
  std::filesystem::create_directory(folder / ("of_" + run));
  folder.write("of_" + run + "/bar.toml", toml);
  std::string csv = "retraction_mm,pull_N,tip_mm\n";
  for (const double retraction : retractions) {
    for (const double times : {1.0, 2.0}) csv += fmt::format("{},{},1\n", retraction, times * pull);
  }
  const std::string bench = "of_" + run + "/bench.csv", experiment = "of_" + run + "/bar.toml";
  folder.write(bench, csv);
  const nlohmann::json replay =
      nlohmann::json::parse(done_in(folder / "", {"replay", experiment, "--json", "--quiet", "--out", "replay"}).out);
  csv = "retraction_mm,pull_N,tip_mm\n";
  for (const nlohmann::json& row : replay.at("rows"))
    csv += fmt::format("{:.6g},{:.6g},{:.3f}\n", 1e3 * row.at("controls")[1].get<double>(),
                       row.at("controls")[0].get<double>(), 1e3 * row.at("predicted_m").get<double>());
  folder.write(bench, csv);
  run_in(folder / "", {"fit", experiment, "--quiet", "--out", run});
}

}  // namespace taut::test
