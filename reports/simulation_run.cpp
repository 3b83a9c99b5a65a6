#include "reports/simulation_run.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "calib/data/files.hpp"
#include "reports/simulation_report.hpp"
#include "sim/core/error.hpp"
#include "sim/robots/workspace.hpp"
#include "sim/solve/reduction.hpp"

namespace taut {
namespace {

/// Where the scene jumped from one path of equilibria to another.
std::string slips_text(const SimulationResult& result) {
  std::string when;
  constexpr size_t most = 3;
  for (size_t k = 0; k < std::min(most, result.slips.size()); ++k)
    when += fmt::format("{}at {} (by {})", k == 0 ? "" : ", ", with_unit(result.slips[k].t, "s"),
                        with_unit(result.slips[k].jump, "m"));
  if (result.slips.size() > most) when += fmt::format(" and {} more", result.slips.size() - most);
  return fmt::format(
      "YES: {}: the path of equilibria ends there and the scene jumps to another one; to which, inertia decides "
      "(integrator = \"bdf2\"), not statics",
      when);
}

/// What an independent test says of all accepted states, and what a run took.
void add_facts(const Simulation& simulation, const Robot& robot, const SimulationResult& result,
               SimulationRecord& record) {
  const auto add = [&](const char* label, const std::string& text) { record.facts.emplace_back(label, text); };
  const Mesh& mesh = robot.scene.model->mesh();
  const size_t states = result.states.size();
  add("model", fmt::format("{} {}, {} {} elements, {} unknowns", mesh.parts.size(),
                           mesh.parts.size() == 1 ? "body" : "bodies", mesh.element_count(),
                           order_of(mesh.shape) == 1 ? "linear" : "quadratic", Reduction(*robot.scene.model).size()));
  if (simulation.rigid_segments)
    add("rigid", fmt::format("{}: over 100 times as stiff as the softest region and taken not to deform; how much that "
                             "changes is not estimated here: compare with model = \"full\"",
                             join(rigid_regions(simulation), " and ")));
  add("time integration", integrator_text(simulation));
  add("took", fmt::format("{:.3g} s for {}: {} steps, {} repeated, {} Newton iterations, {} factorisations",
                          result.seconds, with_unit(result.times.back(), "s"), result.steps, result.repeated,
                          result.iterations, result.factorisations));
  if (!result.failure.empty()) add("ended early", result.failure);
  if (result.saddles_left > 0)
    add("buckling",
        fmt::format("{} equilibria were reached by leaving an unstable one{}", result.saddles_left,
                    result.side.empty()
                        ? ""
                        : "; symmetric bifurcation: the side was chosen by a fixed rule, towards " + result.side));
  if (!result.slips.empty()) add("slips", slips_text(result));
  add("inverted elements", result.smallest_jacobian > 0
                               ? fmt::format("none in {} states; smallest J = {:.3g}", states, result.smallest_jacobian)
                               : fmt::format("YES: smallest J = {:.3g}", result.smallest_jacobian));
  if (robot.intersects && result.intersecting > 0) {
    add("intersections", fmt::format("YES: in {} of {} states", result.intersecting, states));
  } else if (robot.intersects) {
    const bool near = std::isfinite(result.smallest_distance);
    add("intersections",
        fmt::format("none in {} states, by an exact test afterwards; smallest distance {}", states,
                    (near ? "" : "over ") + with_unit(near ? result.smallest_distance : 0.01 * mesh.diagonal(), "m")));
  }
  if (!robot.joints.empty())
    add("joints", fmt::format("largest gap {}, largest motor error {:.3g} deg",
                              with_unit(result.largest_joint_gap, "m"), result.largest_motor_error * 180 / M_PI));
}

/// Frames evenly over time; steps need not be even.
void add_frames(const Simulation& simulation, const SimulationResult& result, SimulationRecord& record) {
  const int frames = std::min(simulation.frames, static_cast<int>(result.times.size()));
  for (int i = 0; i < frames; ++i) {
    const double t = result.times.back() * i / std::max(1, frames - 1);
    const auto at = std::lower_bound(result.times.begin(), result.times.end(), t - 1e-12) - result.times.begin();
    if (!record.frames.empty() && record.frames.back() >= at) continue;
    record.frames.push_back(static_cast<int>(at));
    add_state(simulation, result.states[static_cast<size_t>(at)], record);
  }
}

/// How a workspace was sampled.
std::string samples_text(const WorkspaceResult& reached) {
  std::string text = fmt::format("{} equilibria", reached.samples);
  if (reached.mirrored >= 0)
    text += fmt::format(", each counted mirrored in {} as well, as the scene is symmetric", "xy"[reached.mirrored]);
  if (!reached.holds.empty()) text += fmt::format(", and those of {}", join(reached.holds, " and "));
  if (reached.failures > 0) text += fmt::format("; {} samples had no equilibrium and are left out", reached.failures);
  if (reached.slips > 0)
    text +=
        fmt::format("; {} were reached by a jump to another equilibrium, on no path that leads back", reached.slips);
  return text;
}

}  // namespace

std::string experiment_name(const std::string& path) {
  const std::filesystem::path file = std::filesystem::absolute(path);
  const std::string stem = file.stem().string();
  return stem == "experiment" ? file.parent_path().filename().string() : stem;
}

std::string integrator_text(const Simulation& simulation) {
  const std::string steps = simulation.tolerance > 0
                                ? fmt::format("steps up to {}, error of a step kept at {:.2g} of the scene's size",
                                              with_unit(simulation.step, "s"), simulation.tolerance)
                                : fmt::format("steps of {}", with_unit(simulation.step, "s"));
  switch (simulation.method) {
    case SimulationMethod::quasi_static:
      return fmt::format("equilibria at {} intervals; no inertia", with_unit(simulation.step, "s"));
    case SimulationMethod::implicit_euler:
      return "implicit Euler (order 1), " + steps +
             fmt::format("; it damps a motion of frequency f by the ratio pi f h, {:.2g} at 10 Hz",
                         M_PI * 10 * simulation.step);
    case SimulationMethod::bdf2:
      return "BDF2 (order 2), " + steps;
    case SimulationMethod::cvode:
      return fmt::format("CVODE (BDF), outputs every {}", with_unit(simulation.step, "s"));
    case SimulationMethod::arkode_implicit:
      return fmt::format("ARKODE (implicit Runge-Kutta), outputs every {}", with_unit(simulation.step, "s"));
    case SimulationMethod::arkode_explicit:
      return fmt::format("ARKODE (explicit Runge-Kutta), outputs every {}", with_unit(simulation.step, "s"));
  }
  return "";
}

std::string blind_patches(const Robot& robot) {
  std::string text;
  for (const JoinedParts& joined : robot.joined) {
    if (joined.radius > 0)
      text += fmt::format("{}'{}' within {}", text.empty() ? "bodies that overlap about the pin of " : ", ",
                          joined.joint, with_unit(joined.radius, "m"));
  }
  return text;
}

int carriers_of(const Simulation& simulation) {
  return static_cast<int>(std::ranges::count_if(simulation.contact.grounds,
                                                [](const GroundSettings& ground) { return !ground.control.empty(); }));
}

void add_state(const Simulation& simulation, const Eigen::VectorXd& u, SimulationRecord& record) {
  const int d = record.mesh.dimension();
  Eigen::Index carrier = record.mesh.X.size();
  record.states.push_back(u.head(carrier));
  for (size_t k = 0; k < record.grounds.size(); ++k) {
    if (simulation.contact.grounds[k].control.empty()) continue;
    record.grounds[k].moved.push_back(u.segment(carrier, d));
    carrier += d;
  }
}

SimulationRecord start_simulation_record(const Simulation& simulation, const Robot& robot, const Program& program) {
  SimulationRecord record;
  record.name = file_name_of(experiment_name(simulation.path));
  record.title = simulation.title;
  record.description = simulation.description;
  record.at_rest = simulation.method == SimulationMethod::quasi_static;
  record.mesh = robot.scene.model->mesh();
  for (const std::string& remark : record.mesh.remarks) record.facts.emplace_back("mesh", remark);
  if (const std::string text = blind_patches(robot); !text.empty()) record.facts.emplace_back("no contact of", text);
  for (size_t k = 0; k < robot.cables.size(); ++k)
    record.lines.push_back({simulation.cables.cables[k].id, robot.cables[k].points});
  for (const std::vector<Eigen::Vector2d>& line : simulation.contact.obstacles)
    record.obstacles.emplace_back(line.begin(), line.end());
  for (const GroundSettings& ground : simulation.contact.grounds)
    record.grounds.push_back({ground.point, ground.normal, ground.kind, ground.radius});
  // Nodes of no element only carry grounds.
  record.mesh.X.conservativeResize(record.mesh.X.size() - record.mesh.dimension() * carriers_of(simulation));
  for (const ControlSettings& control : simulation.controls)
    record.controls.push_back({control.id, units_of(control.quantity).front(), control.id, {}});
  for (const SceneReading& reading : robot.readings)
    record.channels.push_back({reading.id, reading.unit, reading.meaning, {}});
  record.command_line = program.command_line;
  record.version = fmt::format("{} ({})", program.version, program.commit);
  record.experiment_text = simulation.text ? *simulation.text : read_file(simulation.path);
  return record;
}

SimulationRecord make_simulation_record(const Simulation& simulation, const Robot& robot,
                                        const SimulationResult& result, const Program& program) {
  SimulationRecord record = start_simulation_record(simulation, robot, program);
  record.samples = result.times;
  for (size_t k = 0; k < record.controls.size(); ++k) record.controls[k].values = result.controls[k];
  for (size_t k = 0; k < record.channels.size(); ++k) record.channels[k].values = result.readings[k];
  if (simulation.method != SimulationMethod::quasi_static) {
    record.channels.push_back({"kinetic_energy", "J", "kinetic energy", result.kinetic});
    record.channels.push_back({"potential_energy", "J", "potential energy", result.potential});
  }
  add_frames(simulation, result, record);
  for (const RobotPlot& plot : simulation.plots) record.plots.push_back({plot.id, plot.title, plot.x, plot.y});
  add_facts(simulation, robot, result, record);
  return record;
}

void add_workspaces(const Simulation& simulation, const Robot& robot,
                    const std::function<void(const std::string&)>& say, const std::atomic<bool>* stop,
                    SimulationRecord& record) {
  if (!simulation.workspace) return;
  const auto tell = [&](const std::string& mode) { say(fmt::format("workspace of mode {}", mode)); };
  for (const WorkspaceResult& reached : sample_workspaces(simulation, robot, tell, stop)) {
    record.facts.emplace_back("workspace " + reached.mode, samples_text(reached));
    record.workspaces.push_back({reached.mode, reached.points, reached.area, reached.area_error, reached.outline});
  }
}

void publish(const SimulationRecord& record, RunFolder& folder, bool stopped) {
  if (stopped) folder.mark_unfinished();
  try {
    write_simulation(record, folder.next());
  } catch (const InputError&) {
    folder.publish();
    throw;
  }
  folder.publish();
}

}  // namespace taut
