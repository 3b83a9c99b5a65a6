#include <fmt/format.h>

#include <algorithm>
#include <boost/program_options.hpp>
#include <cctype>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <set>

#include "calib/data/files.hpp"
#include "calib/data/run_folder.hpp"
#include "calib/runs/open_bench.hpp"
#include "calib/runs/provenance.hpp"
#include "calib/studies/module_chain.hpp"
#include "experiments/cli/commands.hpp"
#include "experiments/cli/print.hpp"
#include "experiments/cli/progress.hpp"
#include "experiments/cli/run_controls.hpp"
#include "reports/axes.hpp"
#include "reports/run_record.hpp"
#include "reports/simulator_files.hpp"
#include "sim/core/error.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

namespace fs = std::filesystem;
namespace po = boost::program_options;
using ExportJson = nlohmann::ordered_json;

/// A run that is exported.
struct ExportedRun {
  const CommandOptions& options;
  const RunRecord& record;
  const Bench& bench;
  const StiffnessReplay& replay;
  Progress& progress;
  std::string folder;  ///< for its files

  size_t load() const { return replay.load(); }
  std::string name() const { return fs::absolute(fs::path(options.target) / "").parent_path().filename().string(); }
};

/// The largest load: --largest, else the largest at the bench.
double largest_load(const ExportedRun& run) {
  const AxisRecord& axis = run.bench.controls()[run.load()];
  const double largest = run.options.largest.empty() ? std::ranges::max(run.bench.values_of(run.load()), {},
                                                                        [](double value) { return std::abs(value); })
                                                     : in_unit_of(axis, run.options.largest, "--largest");
  if (largest == 0) throw InputError(fmt::format("--largest: {} is to be loaded with something; give a load", axis.id));
  return largest;
}

/// What is held in each state: all retractions at each --retraction, else as at the bench.
std::vector<std::vector<double>> exported_states(const ExportedRun& run) {
  const std::vector<double> held = held_controls(run.options, run.bench, run.load(), std::nullopt, "--largest");
  const std::vector<size_t> retractions = retractions_of(run.bench);
  std::vector<std::vector<double>> states;
  if (!run.options.retractions.empty()) {
    if (retractions.empty())
      throw InputError(fmt::format("--retraction: no cable of {} is retracted; leave it out", run.options.target));
    for (const std::string& text : run.options.retractions) {
      states.push_back(held);
      for (const size_t k : retractions) states.back()[k] = in_unit_of(run.bench.controls()[k], text, "--retraction");
    }
    return states;
  }
  std::set<std::vector<double>> found;
  for (const BenchReading& reading : run.bench.readings()) {
    std::vector<double> state = held;
    for (const size_t k : retractions) {
      if (!run.options.set.contains(run.bench.controls()[k].id)) state[k] = reading.controls[k];
    }
    found.insert(std::move(state));
  }
  states.assign(found.begin(), found.end());
  return states;
}

/// The channel that a chain follows: --channel, else the first that is a place.
size_t followed_channel(const ExportedRun& run) {
  const std::vector<AxisRecord>& channels = run.bench.channels();
  if (!run.options.channels.empty()) return place_of_id(channels, run.options.channels.front(), "--channel", "channel");
  const auto found = std::ranges::find_if(channels, [](const AxisRecord& axis) { return axis.unit == "m"; });
  if (found == channels.end())
    throw InputError(
        fmt::format("{}: no channel says where something is, which a chain could follow", run.options.target));
  return static_cast<size_t>(found - channels.begin());
}

/// "push_puppet_retraction_5.89_mm": letters, digits, points and underscores.
std::string state_name(const ExportedRun& run, const std::vector<double>& controls, bool several) {
  std::string name = run.name();
  if (several) {
    for (const size_t k : retractions_of(run.bench))
      name += "_" + run.bench.controls()[k].id + "_" + value_text(run.bench, k, controls[k]);
  }
  for (char& c : name) {
    if (std::isalnum(static_cast<unsigned char>(c)) == 0 && c != '.' && c != '-') c = '_';
  }
  return name;
}

ExportJson export_chains(const ExportedRun& run, const std::string& to) {
  const std::vector<std::vector<double>> states = exported_states(run);
  ModuleChainQuestion question;
  question.channel = followed_channel(run);
  question.largest = largest_load(run);
  question.hinges = run.options.hinges;
  if (question.hinges < 1 || question.hinges > 1000)
    throw InputError("--hinges: a whole number from 1 to 1000 belongs here");
  ChainText text{run.name(),           run.record.title, run.record.simulated,
                 run.bench.controls(), run.load(),       run.bench.channels()[question.channel].id};
  std::vector<ModuleChain> chains;
  const std::string ending = to == "mujoco" ? ".xml" : ".urdf";
  std::vector<std::string> files;
  for (const std::vector<double>& state : states) {
    question.controls = state;
    std::string name = state_name(run, state, states.size() > 1);
    const auto is_taken = [&](const std::string& file) { return std::ranges::count(files, file) > 0; };
    while (is_taken(name + ending)) name += "_";  // states that differ beyond the digits of their names
    run.progress.show(fmt::format("the chain of {}", name));
    chains.push_back(module_chain(run.replay, question));
    text.name = name;
    files.push_back(name + ending);
    write_file((fs::path(run.folder) / files.back()).string(),
               to == "mujoco" ? mjcf(chains.back(), text) : urdf(chains.back(), text));
    if (run.options.interrupted()) break;
  }
  const std::string csv = chain_table_csv(chains, text, files), json = chain_table_json(chains, text, files);
  write_file((fs::path(run.folder) / "hinges.csv").string(), csv);
  write_file((fs::path(run.folder) / "hinges.json").string(), json);
  if (!run.options.json) {
    if (run.record.simulated) fmt::print("SIMULATED DATA: fitted to readings that were simulated.\n");
    for (size_t i = 0; i < chains.size(); ++i) {
      const ModuleChain& chain = chains[i];
      fmt::print("{}: {} hinges of {:.4g} N m/rad; follows the replay of {} {}\n", files[i], chain.chain.size(),
                 chain.fit.stiffness, text.channel, chain_difference(chain));
      if (chain.slipped) fmt::print("  the replay jumped to another equilibrium on its way: do not trust this state\n");
    }
    fmt::print("assumed, not measured: damping, {:.0f} % of critical for the lowest mode", 100 * assumed_damping);
    if (!chains.front().assumed.empty())
      fmt::print("; a density of {} kg/m3 for {}", assumed_density, join(chains.front().assumed));
    fmt::print("\n{}\n", to == "urdf" ? "URDF has no stiffness of joints: set that of hinges.csv after loading"
                                      : "the actuator's control is the force [N]; stiffness of each state: hinges.csv");
  }
  return ExportJson::parse(json);
}

ExportJson export_table(const ExportedRun& run) {
  const std::vector<size_t> controls = controls_of(run.options, run.bench, run.load());
  ExportJson json = ExportJson::array();
  for (const size_t control : controls) {
    TuneQuestion question;
    question.control = control;
    question.controls = held_controls(run.options, run.bench, run.load(), control, "--largest");
    question.lower = run.bench.values_of(control).front();
    question.upper = run.bench.values_of(control).back();
    const std::string& id = run.bench.controls()[control].id;
    if (!(question.lower < question.upper))
      throw InputError(fmt::format("{}: {} has one value at the bench, so that there is nothing to map over it",
                                   run.options.target, id));
    const double largest = largest_load(run);
    if (!(largest > 0)) throw InputError("--largest: a table goes from no load to one above zero");
    const StiffnessMap map = stiffness_map(run.replay, run.record.shares, question, largest, {},
                                           [&](const std::string& text) { run.progress.show(id + ": " + text); });
    const std::string folder = controls.size() == 1 ? run.folder : (fs::path(run.folder) / id).string();
    const StiffnessMapText text = write_stiffness_map(map, run.record, run.bench, question, folder);
    json.push_back(
        {{"control", id}, {"folder", folder}, {"nodes", map.nodes.size()}, {"error", interpolation_error(map, text)}});
    if (!run.options.json)
      fmt::print(
          "{0}/stiffness_map.csv, {0}/stiffness_map.json: stiffness and what channels read over {1} and {2}, {3} "
          "nodes; {4}\n",
          folder, id, run.bench.controls()[run.load()].id, map.nodes.size(), interpolation_error(map, text));
  }
  return json;
}

/// Hands a calibrated module to other simulators.
int export_main(const CommandOptions& options) {
  const std::string& to = options.format;
  if (to != "table" && to != "mujoco" && to != "urdf")
    throw InputError(fmt::format("taut export: --to {}; say what for: table, mujoco or urdf",
                                 to.empty() ? "is missing" : fmt::format("'{}' is unknown", to)));
  settle_run_folder(options.target);
  const RunRecord record = read_run(options.target);
  const std::unique_ptr<Bench> bench =
      open_bench(experiment_of_run(record, options.target), {options.threads, options.stop});
  const StiffnessReplay replay(*bench, record.fit, load_of(options, *bench));
  Progress progress(options.quiet);
  if (misses_readings(record.fit))
    progress.say("THE MODEL DID NOT DESCRIBE THE READINGS that it was fitted to: what is exported does not either");
  const std::string folder = options.out.empty() ? (fs::path(options.target) / "export" / to).string() : options.out;
  const ExportedRun run{options, record, *bench, replay, progress, folder};
  const ExportJson json = to == "table" ? export_table(run) : export_chains(run, to);
  if (options.json) print_json({{"to", to}, {"folder", folder}, {"exported", json}, {"warnings", replay.failures()}});
  progress.say("written to " + folder);
  print_failures(replay.failures());
  return options.interrupted() ? exit_interrupted : replay.failures().empty() ? exit_ok : exit_solve;
}

void add_export_options(AddOption add, CommandOptions& options) {
  add("to", po::value(&options.format)->value_name("FORMAT"), "table, mujoco or urdf");
  add("retraction", po::value(&options.retractions)->value_name("VALUE")->composing(),
      "mujoco, urdf: a state to export, of all cables: \"16 mm\"; may be repeated; default: those of the bench");
  add_assignments(add, options.set, "hold", "another control's value; default: its smallest at the bench");
  add("load", po::value(&options.load)->value_name("ID"), "the load; default: the one that figures are drawn over");
  add("largest", po::value(&options.largest)->value_name("VALUE"),
      "the load up to which it is to hold; default: the largest at the bench");
  add("channel", po::value(&options.channels)->value_name("ID")->composing(),
      "mujoco, urdf: the displacement that the chain follows; default: the first one");
  add("hinges", po::value(&options.hinges)->value_name("N"),
      "mujoco, urdf: of a body that is no module; default: 10. A module has one per gap");
  add("control", po::value(&options.name)->value_name("ID"), "table: over which; default: each retraction");
  add_out(add, options, "folder of the files; default: export/FORMAT in the run folder");
  add_threads(add, options);
}

}  // namespace

Command export_command() {
  return {"export",
          "RUN_FOLDER",
          "Hands a calibrated module to other simulators: as a chain of hinges (MuJoCo, URDF) or a table.",
          "  taut export runs/push_puppet --to mujoco --retraction \"16 mm\"\n"
          "  taut export runs/push_puppet --to table\n",
          add_export_options,
          export_main};
}

}  // namespace taut
