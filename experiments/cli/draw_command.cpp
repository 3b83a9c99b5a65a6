#include <fmt/format.h>

#include <boost/program_options.hpp>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "calib/benches/model.hpp"
#include "experiments/cli/commands.hpp"
#include "experiments/cli/print.hpp"
#include "reports/draw.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

/// Draws the specimen of an experiment at rest with its dimensions; reads no bench.
int draw_main(const CommandOptions& options) {
  const Experiment experiment = read_experiment(options.target);
  if (!experiment.kind->specimen)
    throw InputError(fmt::format("{}: {} has no specimen to draw; use `taut check` and `taut fit` on it",
                                 options.target, experiment.kind->about));
  const std::string folder = run_folder(options);
  draw_experiment(experiment, make_mesh(experiment, experiment.mesh), folder);
  nlohmann::ordered_json files = nlohmann::ordered_json::array();
  for (const char* format : {"svg", "pdf", "png", "csv"})
    files.push_back((std::filesystem::path(folder) / "figures" / (std::string("drawing.") + format)).string());
  if (options.json)
    print_json(nlohmann::ordered_json{{"title", experiment.title}, {"files", files}});
  else
    for (const nlohmann::ordered_json& file : files) fmt::print("{}\n", file.get<std::string>());
  return exit_ok;
}

}  // namespace

Command draw_command() {
  return {"draw",
          "EXPERIMENT",
          "Draws the specimen at rest with its dimensions in millimetres (2D): SVG, PDF, PNG, CSV; reads no bench.",
          "  taut draw experiments/foam_cantilever/experiment.toml\n",
          [](AddOption add, CommandOptions& options) { add_out(add, options); },
          draw_main};
}

}  // namespace taut
