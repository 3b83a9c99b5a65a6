#include "sim/files/simulation.hpp"

#include <pybind11/eigen.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "experiments/python/compute.hpp"
#include "reports/ik_target.hpp"
#include "reports/report.hpp"
#include "reports/simulation_run.hpp"
#include "sim/core/error.hpp"
#include "sim/core/units.hpp"
#include "sim/robots/robot_ik.hpp"

namespace taut {
namespace {

namespace py = pybind11;

Simulation read(const std::string& path, const std::optional<std::string>& toml) {
  if (toml) return read_simulation_text(path, *toml);
  if (!is_simulation(path))
    throw InputError(path +
                     ": this is an experiment with a bench, not a simulation (there is no [simulation]); use "
                     "taut.Experiment");
  return read_simulation(path);
}

/// Numbers that NumPy takes over without a copy.
py::object array(std::vector<double>&& values) {
  auto* kept = new std::vector<double>(std::move(values));
  const py::capsule owner(kept, [](void* held) { delete static_cast<std::vector<double>*>(held); });
  return py::array_t<double>(static_cast<py::ssize_t>(kept->size()), kept->data(), owner);
}

py::list series_of(std::vector<Series>& all) {
  py::list list;
  for (Series& series : all) {
    py::dict one;
    one["id"] = text(series.id);
    one["unit"] = series.unit;
    one["meaning"] = text(series.meaning);
    one["values"] = array(std::move(series.values));
    list.append(one);
  }
  return list;
}

/// Displacements of the frames: (frames x nodes x dimension) [m].
py::array_t<double> displacements_of(const SimulationRecord& record) {
  const py::ssize_t frames = static_cast<py::ssize_t>(record.states.size()), d = record.mesh.dimension(),
                    nodes = record.mesh.X.size() / d;
  py::array_t<double> u({frames, nodes, d});
  for (py::ssize_t i = 0; i < frames; ++i)
    std::copy_n(record.states[static_cast<size_t>(i)].data(), nodes * d, u.mutable_data(i, 0, 0));
  return u;
}

py::dict as_dict(SimulationRecord& record, const std::string& failure) {
  const Mesh& mesh = record.mesh;
  const py::ssize_t d = mesh.dimension(), nodes = mesh.X.size() / d;
  py::dict all;
  all["title"] = text(record.title);
  py::list facts;
  for (const auto& [label, said] : record.facts) facts.append(py::make_tuple(text(label), text(said)));
  all["facts"] = facts;
  all["points"] = py::array_t<double>({nodes, d}, mesh.X.data());
  all["elements"] = py::array_t<int>(
      {static_cast<py::ssize_t>(mesh.element_count()), static_cast<py::ssize_t>(mesh.nodes_per_element())},
      mesh.elements.data());
  all["displacements"] = displacements_of(record);
  all["frames"] = py::array_t<int>(static_cast<py::ssize_t>(record.frames.size()), record.frames.data());
  all["time"] = array(std::move(record.samples));
  all["controls"] = series_of(record.controls);
  all["channels"] = series_of(record.channels);
  py::list workspaces;
  for (const SimulationRecord::Workspace& reached : record.workspaces) {
    py::array_t<double> points({static_cast<py::ssize_t>(reached.points.size()), py::ssize_t{2}});
    for (size_t i = 0; i < reached.points.size(); ++i)
      std::copy_n(reached.points[i].data(), 2, points.mutable_data(static_cast<py::ssize_t>(i), 0));
    workspaces.append(py::dict(py::arg("mode") = text(reached.mode), py::arg("area") = reached.area,
                               py::arg("area_error") = reached.area_error, py::arg("points") = points));
  }
  all["workspaces"] = workspaces;
  all["failure"] = text(failure);
  return all;
}

/// Whether an independent test found something that no body can do.
std::string unsound(const SimulationResult& result) {
  if (result.smallest_jacobian <= 0) return "elements have folded";
  return result.intersecting > 0 ? "bodies intersect" : "";
}

/// `taut simulate`: the record, and its folder unless `out` is "".
py::dict simulate_file(const std::string& path, const std::optional<std::string>& toml, const std::string& out,
                       const std::string& called, const py::object& progress) {
  std::atomic<bool> stop{false};
  Computation computation(progress, stop);
  std::optional<SimulationRecord> record;
  std::string failure;
  computation.run([&] {
    const Simulation simulation = read(path, toml);
    const Robot robot = make_robot(simulation);
    std::optional<RunFolder> folder;
    if (!out.empty()) folder.emplace(out, RunFolder::Kind::simulation);
    SimulateOptions options;
    options.stop = &stop;
    options.progress = [&](double t, const SimulationResult& so_far) {
      computation.show(with_unit(t, "s") + " of " + with_unit(simulation.duration, "s") + ", " +
                       std::to_string(so_far.steps) + " steps");
    };
    const SimulationResult result = simulate(simulation, robot, options);
    failure = result.failure.empty() ? unsound(result) : result.failure;
    if (result.times.empty()) return;
    record = make_simulation_record(simulation, robot, result, this_module(called));
    if (result.failure.empty())
      add_workspaces(
          simulation, robot, [&](const std::string& line) { computation.say(line); }, &stop, *record);
    const bool stopped = result.interrupted || stop;
    if (folder && !(stopped && folder->finished())) publish(*record, *folder, stopped);
  });
  py::object found = py::none();
  if (record) found = as_dict(*record, failure);
  computation.raise(found);
  if (!record) found = py::dict(py::arg("failure") = text(failure));
  found["undrawn"] = text(undrawn_figures());
  return found;
}

/// `taut ik --stream`: targets one after the other, each from the answer to the last one.
class InverseKinematics {
 public:
  InverseKinematics(const std::string& path, const std::optional<std::string>& toml)
      : simulation_(read(path, toml)), robot_(checked(simulation_)), ik_(simulation_, robot_, &stop_) {}

  py::dict solve(const std::string& target, const std::string& where, const py::object& progress) {
    return py::cast<py::dict>(searched(
        progress, [&] { return std::vector<IkAnswer>{ik_.solve(read_ik_target(target, simulation_, where))}; })[0]);
  }

  /// A target or path of the file, from rest: an answer for each of its points.
  py::list solve_named(const std::string& name, const py::object& progress) {
    return searched(progress, [&] {
      std::vector<std::string> names;
      for (const IkTarget& target : simulation_.ik->targets) {
        if (target.name == name) return solve_target(simulation_, robot_, target, &stop_);
        names.push_back(target.name);
      }
      throw InputError(simulation_.path + ": there is no target '" + name + "'" + did_you_mean(name, names) +
                       "; targets: " + join(names));
    });
  }

  py::list names() const {
    py::list all;
    for (const IkTarget& target : simulation_.ik->targets) all.append(text(target.name));
    return all;
  }

 private:
  static Robot checked(const Simulation& simulation) {
    if (!simulation.ik)
      throw InputError(simulation.path + ": there is no [ik]; add [ik.control.ID] with bounds and [[ik.target]]");
    return make_robot(simulation);
  }

  template <class Search>
  py::list searched(const py::object& progress, Search&& search) {
    std::unique_lock<std::mutex> alone(one_at_a_time_, std::defer_lock);
    {
      const py::gil_scoped_release released;
      alone.lock();
    }
    Computation computation(progress, stop_);
    std::vector<IkAnswer> answers;
    computation.run([&] { answers = search(); });
    py::list all;
    for (const IkAnswer& answer : answers) all.append(as_dict(answer));
    computation.raise(all);
    return all;
  }

  py::dict as_dict(const IkAnswer& answer) const {
    const IkResult& result = answer.result;
    py::dict one, controls, bounds, channels;
    for (size_t j = 0; j < answer.free.size() && result.controls.size() > 0; ++j) {
      const py::str id = text(simulation_.controls[answer.free[j]].id);
      controls[id] = result.controls[static_cast<Eigen::Index>(j)];
      bounds[id] = result.bound[j];
    }
    py::dict units;
    for (const ControlSettings& control : simulation_.controls)
      units[text(control.id)] = units_of(control.quantity).front();
    for (size_t i = 0; i < answer.achieved.size(); ++i) {
      channels[text(answer.channels[i])] = py::make_tuple(answer.wanted[i], answer.achieved[i]);
      units[text(answer.channels[i])] = robot_.reading(answer.channels[i]).unit;
    }
    one["status"] = std::string(name_of(result.status));
    one["message"] = text(result.message);
    one["controls"] = controls;
    one["bounds"] = bounds;
    one["channels"] = channels;
    one["units"] = units;
    one["error"] = result.error;
    one["stiffness"] = result.stiffness;
    one["solves"] = result.solves;
    one["factorisations"] = result.factorisations;
    one["seconds"] = result.seconds;
    return one;
  }

  std::atomic<bool> stop_{false};
  std::mutex one_at_a_time_;
  Simulation simulation_;
  Robot robot_;
  RobotIk ik_;
};

}  // namespace

void bind_simulations(py::module_& module) {
  using py::arg;
  module.def("simulate", &simulate_file, arg("path"), arg("toml"), arg("out"), arg("called"), arg("progress"));
  py::class_<InverseKinematics>(module, "InverseKinematics")
      .def(py::init<const std::string&, const std::optional<std::string>&>(), arg("path"), arg("toml") = py::none())
      .def("solve", &InverseKinematics::solve, arg("target"), arg("where"), arg("progress"))
      .def("solve_named", &InverseKinematics::solve_named, arg("name"), arg("progress"))
      .def("names", &InverseKinematics::names);
}

}  // namespace taut
