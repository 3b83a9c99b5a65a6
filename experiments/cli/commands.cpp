#include "experiments/cli/commands.hpp"

#include <fmt/format.h>

#include <boost/program_options.hpp>
#include <filesystem>
#include <limits>

#include "experiments/cli/version.hpp"
#include "reports/simulation_run.hpp"
#include "sim/core/error.hpp"

namespace taut {

namespace fs = std::filesystem;
namespace po = boost::program_options;

Command init_command();
Command schema_command();
Command check_command();
Command draw_command();
Command replay_command();
Command fit_command();
Command simulate_command();
Command ik_command();
Command optimise_command();
Command predict_command();
Command chart_command();
Command report_command();
Command tune_command();
Command plan_command();
Command score_command();
Command export_command();
Command compare_command();
Command recheck_command();
Command ensemble_command();

const std::vector<Command>& all_commands() {
  static const std::vector<Command> all{init_command(),     schema_command(),  check_command(),    draw_command(),
                                        replay_command(),   fit_command(),     simulate_command(), ik_command(),
                                        optimise_command(), predict_command(), tune_command(),     plan_command(),
                                        export_command(),   score_command(),   compare_command(),  recheck_command(),
                                        ensemble_command(), chart_command(),   report_command()};
  return all;
}

Program program_of(const CommandOptions& options) {
  return {version(), commit(), options.command_line};
}

std::string run_folder(const CommandOptions& options) {
  return options.out.empty() ? (fs::path("runs") / experiment_name(options.target)).string() : options.out;
}

void add_out(AddOption add, CommandOptions& options, const char* what) {
  add("out", po::value(&options.out)->value_name("DIR"), what);
}

void add_assignments(AddOption add, std::map<std::string, std::string>& values, const char* name, const char* what) {
  const std::string_view example = std::string_view(name) == "set"     ? "E_foam=\"50 kPa\""
                                   : std::string_view(name) == "noise" ? "tip=\"0.02 mm\""
                                                                       : "retraction=\"5 mm\"";
  const auto keep = [&values, name, example](const std::vector<std::string>& settings) {
    for (const std::string& setting : settings) {
      const size_t equals = setting.find('=');
      if (equals == std::string::npos || equals == 0)
        throw InputError(fmt::format("--{0} {1}: write ID=VALUE, for example --{0} {2}", name, setting, example));
      values[setting.substr(0, equals)] = setting.substr(equals + 1);
    }
  };
  add(name, po::value<std::vector<std::string>>()->value_name("ID=VALUE")->composing()->notifier(keep), what);
}

unsigned seed_of(const CommandOptions& options) {
  if (options.seed < 0 || options.seed > std::numeric_limits<unsigned>::max())
    throw InputError("--seed: a whole number from 0 to 4294967295 belongs here");
  return static_cast<unsigned>(options.seed);
}

void add_threads(AddOption add, CommandOptions& options) {
  add("threads", po::value(&options.threads)->value_name("N"), "states solved at the same time; default: all cores");
}

po::options_description options_of(const Command& command, CommandOptions& options) {
  po::options_description description("options");
  AddOption add = description.add_options();
  add("help,h", "this text");
  add("json", po::bool_switch(&options.json), "print the result as JSON");
  add("quiet,q", po::bool_switch(&options.quiet), "no progress on stderr");
  if (command.add_options != nullptr) command.add_options(add, options);
  return description;
}

}  // namespace taut
