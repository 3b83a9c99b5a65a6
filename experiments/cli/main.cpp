#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <boost/program_options.hpp>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <exception>
#include <functional>
#include <iostream>
#include <optional>
#include <system_error>

#include "experiments/cli/chart_accuracy.hpp"
#include "experiments/cli/chart_stability.hpp"
#include "experiments/cli/commands.hpp"
#include "experiments/cli/ik_command.hpp"
#include "experiments/cli/simulate_command.hpp"
#include "experiments/cli/version.hpp"
#include "sim/core/error.hpp"
#include "sim/solve/cholesky.hpp"

namespace {

namespace po = boost::program_options;

std::atomic<bool> stop_requested{false};

void on_interrupt(int) {
  if (stop_requested.exchange(true)) std::_Exit(taut::exit_interrupted);  // a second Ctrl-C does not wait
}

struct Command {
  std::string name, argument, summary, examples;
  std::function<int(const taut::CommandOptions&)> run;
  bool out = false, threads = true;
};

/// What `taut chart` draws, by the name of the chart.
const std::vector<std::pair<std::string, int (*)(const taut::CommandOptions&)>> charts{
    {"accuracy", taut::chart_accuracy}, {"stability", taut::chart_stability}};

int chart_command(const taut::CommandOptions& options) {
  for (const auto& [name, chart] : charts) {
    if (name == options.name) return chart(options);
  }
  std::vector<std::string> names;
  for (const auto& [name, chart] : charts) names.push_back(name);
  throw taut::InputError(fmt::format("taut chart: '{}' is no chart{}; charts: {}", options.name,
                                     taut::did_you_mean(options.name, names), taut::join(names)));
}

const std::vector<Command>& commands() {
  static const std::vector<Command> list{
      {"check", "EXPERIMENT",
       "Reads an experiment and its bench, says what it understood, finds problems; solves nothing.",
       "  taut check experiments/silicone_block/experiment.toml\n", taut::check_command, false, false},
      {"draw", "EXPERIMENT",
       "Draws the specimen at rest with its dimensions in millimetres (2D): SVG, PDF, PNG, CSV; reads no bench.",
       "  taut draw experiments/foam_cantilever/experiment.toml\n", taut::draw_command, true, false},
      {"replay", "EXPERIMENT", "Simulates every row of the bench with given parameters: table, CSV, VTU.",
       "  taut replay experiments/silicone_block/experiment.toml\n"
       "  taut replay experiments/silicone_block/experiment.toml --set E_silicone=\"263.8 kPa\" --out /tmp/replay\n",
       taut::replay_command, true, true},
      {"fit", "EXPERIMENT",
       "Fits the free parameters to the bench: run folder with report.html, figures, fit.json, predictions.csv.",
       "  taut fit experiments/silicone_block/experiment.toml\n"
       "  taut fit experiments/silicone_block/experiment.toml --no-variants --json --out runs/quick\n",
       taut::fit_command, true, true},
      {"simulate", "SIMULATION",
       "Runs a simulation over time or through equilibria: states, plots, animation and report.",
       "  taut simulate experiments/ball_impact/experiment.toml\n"
       "  taut simulate experiments/finger_bend/experiment.toml --goal tip_angle --json\n",
       taut::simulate_command, true, false},
      {"ik", "SIMULATION", "Finds the controls that bring a robot to the targets of its file, within their bounds.",
       "  taut ik experiments/arm/experiment.toml\n"
       "  taut ik experiments/arm/experiment.toml --target circle --json\n",
       taut::ik_command, true, false},
      {"predict", "RUN_FOLDER", "Predicts at new loads with the parameters of a run, with 95 % bands.",
       "  taut predict runs/silicone_block --rows new.csv        # new.csv: the load columns of the bench, one row per "
       "prediction\n",
       taut::predict_command, false, true},
      {"chart", "accuracy|stability FILE",
       "Charts error against cost over meshes, elements and solver settings (accuracy), or where methods fail "
       "(stability).",
       "  taut chart accuracy experiments/silicone_block/experiment.toml --budget 300\n"
       "  taut chart stability experiments/push_puppet/experiment.toml\n",
       chart_command, true, true},
      {"report", "RUN_FOLDER", "Rebuilds figures and report of a run from its fit.json, without solving.",
       "  taut report runs/silicone_block\n", taut::report_command, false, false},
  };
  return list;
}

void print_help(std::ostream& out) {
  out << "taut " << taut::version() << ": characterisation and calibration of soft-rigid robot modules\n\nexamples:\n";
  for (const Command& command : commands()) out << command.examples.substr(0, command.examples.find('\n') + 1);
  out << "\ncommands:\n";
  for (const Command& command : commands()) out << fmt::format("  {:<8} {}\n", command.name, command.summary);
  out << "\n`taut COMMAND --help` tells a command's options. Data go to stdout, progress to stderr.\n"
         "exit codes: 0 done, 1 internal fault, 2 wrong usage or input, 3 a simulation failed, 4 the fit did not "
         "converge, 130 interrupted\n";
}

po::options_description options_of(const Command& command, taut::CommandOptions& options,
                                   std::vector<std::string>& settings) {
  po::options_description description("options");
  auto add = description.add_options();
  add("help,h", "this text");
  add("json", po::bool_switch(&options.json), "print the result as JSON");
  add("quiet,q", po::bool_switch(&options.quiet), "no progress on stderr");
  if (command.out)
    add("out", po::value(&options.out)->value_name("DIR"),
        command.name == "chart" ? "folder of figures and tables; default: runs/<name of the experiment's folder>/charts"
                                : "run folder; default: runs/<name of the experiment's folder>");
  if (command.threads)
    add("threads", po::value(&options.threads)->value_name("N"), "states solved at the same time; default: all cores");
  if (command.name == "replay") {
    add("set", po::value(&settings)->value_name("ID=VALUE")->composing(),
        "a parameter instead of the file's value, with its unit");
    add("sensitivities", po::bool_switch(&options.sensitivities),
        "derivatives of every row with respect to all parameters and controls, and the stiffness at each load: "
        "sensitivities.csv");
  }
  if (command.name == "simulate") {
    add("sensitivities", po::bool_switch(&options.sensitivities),
        "derivatives of all channels at every time with respect to parameters and controls: sensitivities.csv");
    add("goal", po::value(&options.goal)->value_name("CHANNEL[@TIME]"),
        "gradient of this channel at the end, or at a time (tip_x@\"20 ms\")");
    add("wrt", po::value(&options.wrt)->value_name("ID,ID,..."),
        "parameters of both; default: all. A control counts as an offset of its whole schedule");
  }
  if (command.name == "ik") add("target", po::value(&options.name)->value_name("NAME"), "this target or path alone");
  if (command.name == "chart")
    add("budget", po::value(&options.budget)->value_name("SECONDS"),
        "time for its simulations; default: 300. What does not fit in is left to the next run");
  if (command.name == "fit") {
    add("no-variants", "leave out the refits with other meshes");
    add("fresh", po::bool_switch(&options.fresh), "start anew where an interrupted run would be gone on with");
  }
  if (command.name == "predict")
    add("rows", po::value(&options.rows)->value_name("FILE"), "CSV file with the load columns of the bench (required)");
  return description;
}

/// What the words after the command's name ask for; prints the help and returns nullopt where that is asked for.
std::optional<taut::CommandOptions> parse(const Command& command, const std::vector<std::string>& words) {
  taut::CommandOptions options;
  options.stop = &stop_requested;
  options.command_line = "taut " + command.name;
  for (const std::string& word : words)
    options.command_line += word.find(' ') == std::string::npos ? " " + word : " '" + word + "'";
  std::vector<std::string> settings, given;
  std::vector<std::string*> positional{&options.target};
  if (command.name == "chart") positional.insert(positional.begin(), &options.name);
  po::options_description visible = options_of(command, options, settings), all;
  all.add(visible).add_options()("positional", po::value(&given));
  po::variables_map values;
  po::store(po::command_line_parser(words)
                .options(all)
                .positional(po::positional_options_description().add("positional", static_cast<int>(positional.size())))
                .run(),
            values);
  po::notify(values);
  for (size_t i = 0; i < given.size(); ++i) *positional[i] = given[i];
  if (values.count("help") != 0) {
    std::cout << command.summary << "\n\nexamples:\n"
              << command.examples << "\nusage: taut " << command.name << " " << command.argument << " [options]\n\n"
              << visible;
    return std::nullopt;
  }
  for (const std::string& setting : settings) {
    const size_t equals = setting.find('=');
    if (equals == std::string::npos || equals == 0)
      throw taut::InputError(fmt::format("--set {}: write ID=VALUE, for example --set E_foam=\"50 kPa\"", setting));
    options.set[setting.substr(0, equals)] = setting.substr(equals + 1);
  }
  options.variants = values.count("no-variants") == 0;
  return options;
}

void check(const Command& command, const taut::CommandOptions& options) {
  if (options.target.empty())
    throw taut::InputError(
        fmt::format("taut {0}: {1} is missing; usage: taut {0} {1} [options]", command.name, command.argument));
  if (options.threads < 0 || options.threads > 1024)
    throw taut::InputError("--threads: a whole number from 1 to 1024 belongs here");
  if (!(options.budget >= 0 && options.budget < 1e9))
    throw taut::InputError("--budget: a number of seconds, zero or more, belongs here");
  if (command.name == "predict" && options.rows.empty())
    throw taut::InputError("taut predict: --rows FILE is missing; give a CSV file with the load columns of the bench");
}

int run(const std::vector<std::string>& arguments) {
  if (arguments.empty() || arguments[0] == "--help" || arguments[0] == "-h" || arguments[0] == "help") {
    print_help(std::cout);
    return arguments.empty() ? taut::exit_input : taut::exit_ok;
  }
  if (arguments[0] == "--version") {
    std::cout << "taut " << taut::version() << " (" << taut::commit() << ")\n";
    return taut::exit_ok;
  }
  std::vector<std::string> names;
  for (const Command& command : commands()) {
    names.push_back(command.name);
    if (command.name != arguments[0]) continue;
    const auto options = parse(command, {arguments.begin() + 1, arguments.end()});
    if (!options) return taut::exit_ok;
    check(command, *options);
    return command.run(*options);
  }
  throw taut::InputError(fmt::format("unknown command '{}'{}; commands: {}", arguments[0],
                                     taut::did_you_mean(arguments[0], names), taut::join(names)));
}

/// Runs the command and turns what it throws into one sentence and an exit code.
int guarded(const std::vector<std::string>& arguments) {
  try {
    return run(arguments);
  } catch (const taut::InputError& error) {
    std::cerr << "taut: " << error.what() << "\n";
    return taut::exit_input;
  } catch (const po::error& error) {
    std::cerr << "taut: " << error.what() << "; `taut --help` tells what is allowed\n";
    return taut::exit_input;
  } catch (const std::bad_alloc&) {
    std::cerr << "taut: out of memory; use a coarser mesh or fewer threads\n";
    return taut::exit_internal;
  } catch (const std::system_error&) {  // fmt, of a stream that takes no more: said below
    return taut::exit_input;
  } catch (const std::exception& error) {
    std::cerr << "taut: internal fault: " << error.what() << "\n";
    return taut::exit_internal;
  }
}

/// Standard streams that the caller closed would be given to the next files that are opened, which then got what is
/// printed. In their place stands a device that takes nothing.
void hold_standard_streams() {
  for (int stream : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO}) {
    if (fcntl(stream, F_GETFD) == -1 && open("/dev/full", stream == STDIN_FILENO ? O_RDONLY : O_WRONLY) == -1)
      std::_Exit(taut::exit_internal);
  }
}

/// Whether all that was printed has arrived. A reader that has seen enough (`taut replay | head`) is no error to tell.
int end_output(int code) {
  std::cout.flush();
  errno = 0;
  const bool lost = std::fflush(stdout) != 0 || std::ferror(stdout) != 0 || !std::cout;
  if (!lost) return code;
  if (errno != EPIPE)
    std::cerr << "taut: what was printed could not be written to standard output; files of the run are complete\n";
  return code == taut::exit_ok ? taut::exit_input : code;
}

}  // namespace

int main(int argc, char** argv) {
  hold_standard_streams();
  for (int signal : {SIGINT, SIGTERM, SIGHUP}) {
    if (std::signal(signal, on_interrupt) == SIG_IGN) std::signal(signal, SIG_IGN);  // nohup asked for that
  }
  std::signal(SIGPIPE, SIG_IGN);  // a reader that ends early must not end a run
  taut::use_one_blas_thread();
  return end_output(guarded({argv + 1, argv + argc}));
}
