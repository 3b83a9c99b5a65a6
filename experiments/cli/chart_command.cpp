#include <fmt/format.h>

#include <boost/program_options.hpp>

#include "experiments/cli/chart.hpp"
#include "experiments/cli/ensemble_output.hpp"
#include "experiments/cli/progress.hpp"
#include "sim/core/error.hpp"
#include "sim/files/simulation.hpp"

namespace taut {
namespace {

std::vector<std::string> files_of(const Experiment& experiment) {
  std::vector<std::string> files;
  for (const RunInput& input : inputs_of(experiment)) files.push_back(input.path);
  return files;
}

std::vector<std::string> files_of(const Simulation& simulation) {
  std::vector<std::string> files{simulation.path};
  for (const BodySettings& body : simulation.bodies) {
    if (const std::string mesh = input_file(body.geometry); !mesh.empty()) files.push_back(mesh);
  }
  return files;
}

/// What is drawn, by the name of the chart.
const std::vector<std::pair<std::string, int (*)(const CommandOptions&)>> charts{
    {"accuracy", chart_accuracy}, {"stability", chart_stability}, {"planted", chart_planted}, {"sbc", chart_sbc}};

int chart_main(const CommandOptions& options) {
  if (!(options.budget >= 0 && options.budget < 1e9))
    throw InputError("--budget: a number of seconds, zero or more, belongs here");
  std::vector<std::string> names;
  for (const auto& [name, chart] : charts) {
    if (name == options.name) return chart(options);
    names.push_back(name);
  }
  throw InputError(fmt::format("taut chart: '{}' is no chart{}; charts: {}", options.name,
                               did_you_mean(options.name, names), join(names)));
}

void add_chart_options(AddOption add, CommandOptions& options) {
  add_out(add, options, "folder of figures and tables; default: runs/<name of the experiment's folder>/charts");
  add_threads(add, options);
  add_shard(add, options);
  add("budget", boost::program_options::value(&options.budget)->value_name("SECONDS"),
      "time for its simulations; default: 300. What does not fit in is left to the next run");
}

}  // namespace

Charted read_charted(const CommandOptions& options) {
  if (is_simulation(options.target)) return read_simulation(options.target);
  Experiment experiment = read_experiment(options.target);
  if (!experiment.kind->specimen)
    throw InputError(
        fmt::format("{}: {} has no mesh and no steps to compare; chart an experiment with a specimen or a "
                    "simulation over time",
                    options.target, experiment.kind->about));
  if (options.threads > 0) experiment.threads = options.threads;
  return experiment;
}

ChartFolder open_chart(const CommandOptions& options, const std::string& chart, const Charted& charted,
                       Progress& progress) {
  ChartFolder folder;
  folder.path = options.out.empty() ? run_folder(options) + "/charts" : options.out;
  std::error_code error;
  std::filesystem::create_directories(folder.path / "figures", error);
  if (error)
    throw InputError(fmt::format("{}: the folder cannot be made ({}); choose another one with --out",
                                 folder.path.string(), error.message()));
  folder.study.budget = options.budget;
  folder.study.file = (folder.path / (chart + ".csv")).string();
  folder.study.fingerprint = fingerprint_of(std::visit([](const auto& one) { return files_of(one); }, charted));
  folder.study.stop = options.stop;
  folder.study.shard = shard_of(options);
  folder.study.messages = options.messages;
  folder.study.progress = [&progress](const std::string& what, size_t done, size_t all) {
    progress.show(fmt::format("{} ({} of {})", what, done + 1, all));
  };
  return folder;
}

int close_chart(const CommandOptions& options, size_t missing, size_t all, Progress& progress) {
  if (!options.shard.empty())
    progress.say(fmt::format("{} of {} settings are there; once all are, the same command without --shard draws them",
                             all - missing, all));
  else if (missing > 0)
    progress.say(
        fmt::format("{} of {} settings are missing; run it again to go on, or with a larger --budget", missing, all));
  return options.interrupted() ? exit_interrupted : exit_ok;
}

Command chart_command() {
  Command command{
      "chart",
      "accuracy|stability|planted|sbc FILE",
      "Charts error against cost over meshes, elements and solver settings (accuracy), where methods fail "
      "(stability), or how often fits of modules with a known truth find it (planted), or checks the posterior by "
      "simulation (sbc).",
      "  taut chart accuracy experiments/silicone_block/experiment.toml --budget 300\n"
      "  taut chart stability experiments/push_puppet/experiment.toml\n",
      add_chart_options,
      chart_main,
      {&CommandOptions::name, &CommandOptions::target}};
  command.together = true;
  return command;
}

}  // namespace taut
