#include <fmt/format.h>

#include <algorithm>
#include <boost/program_options.hpp>
#include <filesystem>
#include <limits>
#include <nlohmann/json.hpp>

#include "calib/data/files.hpp"
#include "experiments/cli/ik_stream.hpp"
#include "experiments/cli/print.hpp"
#include "experiments/cli/progress.hpp"
#include "reports/simulation_run.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/units.hpp"
#include "sim/files/simulation.hpp"
#include "sim/files/toml_reader.hpp"
#include "sim/robots/robot_ik.hpp"
#include "sim/terms/solid.hpp"

namespace taut {
namespace {

constexpr std::string_view poses_suffix = "_ik";  ///< of the record's name, and so of its files

struct Solved {
  const IkTarget* target;
  std::vector<IkAnswer> answers;  ///< one, or a path's
};

/// A path's points are numbered.
std::string label_of(const Solved& solved, size_t k) {
  return solved.answers.size() == 1 ? solved.target->name : fmt::format("{} {}", solved.target->name, k + 1);
}

/// "11.36 mm", "-35.5 deg".
std::string text_of(double value, const std::string& unit) {
  const WrittenUnit written = written_unit(unit);
  return fmt::format("{:.4g} {}", value / written.factor, written.label);
}

bool is_path(const Solved& solved) {
  return solved.target->values.begin()->second.size() > 1;
}

/// Targets per second, the first point of a path left out: it comes from rest.
double rate_of(const Solved& solved) {
  double seconds = 0;
  for (size_t k = 1; k < solved.answers.size(); ++k) seconds += solved.answers[k].result.seconds;
  return seconds > 0 ? static_cast<double>(solved.answers.size() - 1) / seconds : 0;
}

void print_answer(const Simulation& simulation, const Robot& robot, const Solved& solved) {
  const IkAnswer& answer = solved.answers.front();
  const IkResult& result = answer.result;
  fmt::print("{}: {}\n", solved.target->name, result.message);
  for (size_t j = 0; j < answer.free.size() && result.controls.size() > 0; ++j) {
    const size_t k = answer.free[j];
    fmt::print("  {:<10} {:>14}{}\n", simulation.controls[k].id,
               text_of(result.controls[static_cast<Eigen::Index>(j)], unit_of(simulation.controls[k])),
               result.bound[j] < 0   ? "  (lower bound)"
               : result.bound[j] > 0 ? "  (upper bound)"
                                     : "");
  }
  for (size_t i = 0; i < answer.achieved.size(); ++i) {
    const std::string& unit = robot.reading(answer.channels[i]).unit;
    fmt::print("  {:<10} {:>14}  wanted {}\n", answer.channels[i], text_of(answer.achieved[i], unit),
               text_of(answer.wanted[i], unit));
  }
  if (result.stiffness > 0)
    fmt::print("  {:<10} {:>14}  wanted {}\n", "stiffness", text_of(result.stiffness, "N/m"),
               text_of(solved.target->stiffness, "N/m"));
  fmt::print("  {} iterations, {} equilibria, {} factorisations, {:.2f} s\n", result.iterations, result.solves,
             result.factorisations, result.seconds);
}

void print_path(const Solved& solved) {
  int reached = 0;
  for (const IkAnswer& answer : solved.answers) reached += answer.result.status == IkStatus::reached;
  fmt::print("{}: {} of {} points reached; {:.2g} targets per second after the first\n", solved.target->name, reached,
             solved.answers.size(), rate_of(solved));
  for (size_t k = 0; k < solved.answers.size(); ++k) {
    const IkResult& result = solved.answers[k].result;
    fmt::print("  {:>3} {:<12} error {:.2e} mm, {:>3} iterations, {:>4} factorisations, {:.2f} s\n", k + 1,
               name_of(result.status), 1e3 * result.error, result.iterations, result.factorisations, result.seconds);
  }
}

nlohmann::ordered_json json_of(const Simulation& simulation, const Robot& robot, const Solved& solved) {
  nlohmann::ordered_json out;
  out["name"] = solved.target->name;
  if (is_path(solved)) out["targets_per_second"] = rate_of(solved);
  for (const IkAnswer& answer : solved.answers) out["points"].push_back(json_of(simulation, robot, answer));
  return out;
}

std::string csv_of(const std::vector<Solved>& all) {
  std::string csv = "target,point,status,error_mm,stiffness_N_per_m,iterations,equilibria,factorisations,time_s\n";
  for (const Solved& solved : all) {
    for (size_t k = 0; k < solved.answers.size(); ++k) {
      const IkResult& r = solved.answers[k].result;
      const auto given = [](bool there, double value) { return there ? fmt::format("{:.9g}", value) : std::string(); };
      csv += fmt::format("\"{}\",{},{},{},{},{},{},{},{:.4f}\n", solved.target->name, k + 1, name_of(r.status),
                         given(solved.answers[k].u.size() > 0, 1e3 * r.error), given(r.stiffness > 0, r.stiffness),
                         r.iterations, r.solves, r.factorisations, r.seconds);
    }
  }
  return csv;
}

void add_pose(const Simulation& simulation, const Robot& robot, const IkAnswer& answer, const std::string& label,
              SimulationRecord& record) {
  record.frames.push_back(static_cast<int>(record.samples.size()));
  record.samples.push_back(static_cast<double>(record.samples.size() + 1));
  add_state(simulation, answer.u, record);
  for (size_t c = 0; c < robot.controls.size(); ++c) record.controls[c].values.push_back(answer.p[robot.controls[c]]);
  for (size_t c = 0; c < robot.readings.size(); ++c) {
    const SceneReading& reading = robot.readings[c];
    record.channels[c].values.push_back(reading.channel ? reading.rest + reading.channel->value({answer.u, answer.p})
                                                        : not_a_number);
  }
  record.facts.emplace_back(fmt::format("pose {}", record.samples.size()),
                            fmt::format("{}: {}", label, answer.result.message));
}

/// Which poses no slow motion from the one before comes to.
std::string jumps_text(const Simulation& simulation, const Robot& robot, const std::vector<Solved>& all,
                       const CommandOptions& options) {
  std::vector<std::string> found;
  for (const Solved& solved : all) {
    for (const size_t k : jumps_to(simulation, robot, solved.answers, options.stop))
      found.push_back(label_of(solved, k));
  }
  if (options.interrupted()) return "not looked for to the end: interrupted";
  if (found.empty())
    return "none: a slow and straight motion of the controls, from rest or the point before, comes to each pose";
  return "YES: a slow and straight motion of the controls, from rest or the point before, does not come to " +
         join(found);
}

/// The poses as the states of a run over the number of the target; what has no state is left out.
SimulationRecord make_ik_record(const Simulation& simulation, const Robot& robot, const std::vector<Solved>& all,
                                const CommandOptions& options) {
  SimulationRecord record = start_simulation_record(simulation, robot, program_of(options));
  record.name += poses_suffix;
  record.title += ": poses found for its targets";
  record.sample_name = "pose";
  record.sample_unit = "1";
  for (const Solved& solved : all) {
    for (size_t k = 0; k < solved.answers.size(); ++k) {
      if (solved.answers[k].u.size() > 0) add_pose(simulation, robot, solved.answers[k], label_of(solved, k), record);
    }
  }
  record.facts.emplace_back("jumps", jumps_text(simulation, robot, all, options));
  double smallest = std::numeric_limits<double>::infinity();
  for (const Eigen::VectorXd& u : record.states) smallest = std::min(smallest, smallest_jacobian(record.mesh, u));
  record.facts.emplace_back("inverted elements",
                            fmt::format("{} smallest J = {:.3g}", smallest > 0 ? "none;" : "YES:", smallest));
  if (!robot.intersects) return record;
  int crossing = 0;
  for (const Solved& solved : all) {
    for (const IkAnswer& answer : solved.answers) crossing += answer.u.size() > 0 && robot.intersects(answer.u);
  }
  record.facts.emplace_back(
      "intersections", crossing > 0 ? fmt::format("YES: in {} poses", crossing) : "none, by an exact test afterwards");
  return record;
}

[[noreturn]] void refuse(const CommandOptions& options, const std::string& why) {
  throw InputError(fmt::format("{}: {}", options.target, why));
}

/// All targets, or the one that is asked for.
std::vector<const IkTarget*> targets_of(const CommandOptions& options, const Simulation& simulation) {
  if (!simulation.ik) refuse(options, "there is no [ik]; add [ik.control.ID] with bounds and [[ik.target]]");
  std::vector<const IkTarget*> targets;
  std::vector<std::string> names;
  for (const IkTarget& target : simulation.ik->targets) {
    names.push_back(target.name);
    if (options.name.empty() || target.name == options.name) targets.push_back(&target);
  }
  if (targets.empty())
    refuse(options, fmt::format("there is no target '{}'{}; targets: {}", options.name,
                                did_you_mean(options.name, names), join(names)));
  return targets;
}

/// The poses go to the run folder; where a simulation stands there, beside it.
std::string ik_folder(const CommandOptions& options) {
  namespace fs = std::filesystem;
  const fs::path folder = run_folder(options);
  std::error_code missing;
  const bool simulated = std::any_of(fs::directory_iterator(folder, missing), {}, [](const fs::directory_entry& file) {
    return file.path().extension() == ".pvd" && !file.path().stem().string().ends_with(poses_suffix);
  });
  return (simulated ? folder / "ik" : folder).string();
}

/// Solves the targets and paths of [ik], one after the other: a table on stdout; ik.csv, states, a strip of the poses
/// and report.html in a run folder. Exit code 3 when a search failed; a target out of reach is an answer.
int ik_main(const CommandOptions& options) {
  if (!is_simulation(options.target)) refuse(options, "there is no [simulation]; `taut ik` is for robots");
  const Simulation simulation = read_simulation(options.target);
  const std::vector<const IkTarget*> targets = targets_of(options, simulation);
  if (options.stream) return stream_targets(simulation, options);
  Progress progress(options.quiet);
  const Robot robot = make_robot(simulation);
  RunFolder folder(ik_folder(options), RunFolder::Kind::simulation);
  std::vector<Solved> all;
  bool failed = false;
  for (const IkTarget* target : targets) {
    if (options.interrupted()) break;
    progress.show(fmt::format("target {}", target->name));
    all.push_back({target, solve_target(simulation, robot, *target, options.stop)});
    for (const IkAnswer& answer : all.back().answers) failed = failed || answer.result.status == IkStatus::failed;
  }
  const bool stopped = options.interrupted();
  if (options.json) {
    nlohmann::ordered_json json;
    json["title"] = simulation.title;
    json["simulated"] = true;
    for (const Solved& solved : all) json["targets"].push_back(json_of(simulation, robot, solved));
    print_json(json);
  } else {
    fmt::print("{} (inverse kinematics of a simulation)\n", simulation.title);
    for (const Solved& solved : all) is_path(solved) ? print_path(solved) : print_answer(simulation, robot, solved);
  }
  const SimulationRecord record = make_ik_record(simulation, robot, all, options);
  if (!options.json) {
    for (const auto& [label, text] : record.facts) {
      if (!label.starts_with("pose ")) fmt::print("{}: {}\n", label, text);
    }
  }
  if (stopped && folder.finished()) {
    progress.say(fmt::format("interrupted; the finished run in {} stays as it is", folder.path()));
  } else if (!record.samples.empty()) {
    write_file(folder.next() + "/ik.csv", csv_of(all));
    publish(record, folder, stopped);
    progress.say(fmt::format("report: {}/report.html", folder.path()));
  }
  if (stopped) return exit_interrupted;
  return failed ? exit_solve : exit_ok;
}

void add_ik_options(AddOption add, CommandOptions& options) {
  add_out(add, options);
  add("target", boost::program_options::value(&options.name)->value_name("NAME"), "this target or path alone");
  add("stream", boost::program_options::bool_switch(&options.stream),
      "targets from stdin, a JSON object a line, answers on stdout; no folder is written");
}

}  // namespace

Command ik_command() {
  return {"ik",
          "SIMULATION",
          "Finds the controls that bring a robot to the targets of its file, within their bounds.",
          "  taut ik experiments/arm/experiment.toml\n"
          "  taut ik experiments/arm/experiment.toml --target circle --json\n"
          "  echo '{\"tip_x\": \"170 mm\", \"tip_y\": 0.06}' | taut ik experiments/arm/experiment.toml --stream\n",
          add_ik_options,
          ik_main};
}

}  // namespace taut
