#include "calib/bench.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <map>

#include "sim/core/error.hpp"
#include "sim/mesh/msh_file.hpp"
#include "sim/mesh/structured.hpp"
#include "sim/terms/load.hpp"

namespace taut {
namespace {

Eigen::VectorXd vector_of(const std::vector<double>& values) {
  return Eigen::Map<const Eigen::VectorXd>(values.data(), static_cast<Eigen::Index>(values.size()));
}

std::vector<double> shifted(std::vector<double> coordinates, double origin) {
  for (double& x : coordinates) x += origin;
  return coordinates;
}

ParameterSpec control_spec(const std::string& id, Quantity quantity) {
  switch (quantity) {
    case Quantity::mass:
      return {id, "m", "kg", -1e6, 1e6, "hung mass"};
    case Quantity::pressure:
      return {id, "p", "Pa", -1e12, 1e12, "traction"};
    case Quantity::line_load:
      return {id, "q", "N/m", -1e9, 1e9, "line load"};
    case Quantity::length:
      return {id, "u", "m", -1e3, 1e3, "prescribed displacement"};
    default:
      return {id, "F", "N", -1e9, 1e9, "force"};
  }
}

/// Loads and prescribed displacements are parameters beside the model's own, whose names they must not take.
int declare_control(SceneBuilder& builder, const std::string& id, Quantity quantity, double value) {
  if (builder.parameters().contains(id))
    throw InputError(fmt::format("'{}' is a parameter of the model already; choose another id", id));
  return builder.declare(control_spec(id, quantity), value);
}

void add_load(SceneBuilder& builder, const LoadSettings& load, int control, int gravity) {
  const Eigen::VectorXd direction = vector_of(load.direction);
  const int times = load.quantity == Quantity::mass ? gravity : -1;
  if (!load.point.empty()) return builder.add_point_force(vector_of(load.point), direction, control, times);
  if (load.quantity == Quantity::pressure) return builder.add_traction(load.on, direction, control);
  if (load.quantity == Quantity::line_load) return builder.add_line_load(load.on, direction, control);
  builder.add_force(load.on, direction, control, times);
}

std::unique_ptr<Channel> make_channel(const Mesh& mesh, const ChannelSettings& settings) {
  const Eigen::VectorXd direction = vector_of(settings.direction);
  if (!settings.on.empty()) return make_linear_channel(mean_weights(mesh, mesh.select(settings.on), direction));
  const MaterialPoint point = locate(mesh, vector_of(settings.point));
  if (settings.standoff.empty()) return make_linear_channel(point_weights(mesh, point, direction));
  return make_marker_channel(mesh, point, vector_of(settings.standoff), mesh.select(settings.turns_with), direction);
}

/// Runs `action` and puts the file (and the part of it) in front of what goes wrong.
template <class Action>
auto at(const Experiment& experiment, const std::string& part, Action&& action) {
  try {
    return action();
  } catch (const InputError& error) {
    if (std::string_view(error.what()).starts_with(experiment.path + ":")) throw;  // it says where, to the line
    throw InputError(fmt::format("{}: {}: {}", experiment.path, part, error.what()));
  }
}

}  // namespace

Mesh make_mesh(const Experiment& experiment, const MeshSettings& settings) {
  const GeometrySettings& g = experiment.geometry;
  return at(experiment, "[geometry]", [&] {
    auto axis = [&](size_t i) { return shifted(graded(g.size[i], settings.cells[i]), g.origin[i]); };
    if (g.kind == "box") return box(axis(0), axis(1), axis(2), settings.order, g.region);
    if (g.kind == "rectangle") return rectangle(axis(0), axis(1), settings.order, g.region);
    if (g.kind == "boxes") return mesh_boxes(g.boxes, settings.size, settings.order);
    if (g.kind == "polygons") return mesh_polygons(g.polygons, settings.size, settings.order);
    Mesh mesh = read_msh(g.file, g.unit);
    if (mesh.dimension() != g.dimension)
      throw InputError(fmt::format("{} is a {}D mesh; set dimension = {}", g.file, mesh.dimension(), mesh.dimension()));
    if (settings.order == 2 && order_of(mesh.shape) == 1) return to_quadratic(mesh);
    if (settings.order == 1 && order_of(mesh.shape) == 2)
      throw InputError(fmt::format("{} has quadratic elements; set element = \"quadratic\"", g.file));
    return mesh;
  });
}

BenchModel make_model(const Experiment& experiment, const MeshSettings& settings,
                      const std::vector<Quantity>& quantities) {
  BenchModel result;
  SceneBuilder builder(make_mesh(experiment, settings), experiment.geometry.plane, experiment.geometry.thickness);
  const int gravity = builder.declare({"g", "g", "m/s2", 0, 1000, "acceleration of gravity"}, experiment.gravity);
  if (!experiment.gravity_direction.empty()) result.switched_off_at_rest.push_back(gravity);
  for (const MaterialSettings& material : experiment.materials) {
    at(experiment, fmt::format("[materials.{}]", material.region), [&] {
      builder.add_solid(material.region, material.law, material.constants, settings.formulation);
      if (material.density && !experiment.gravity_direction.empty())
        builder.add_weight(material.region, *material.density, vector_of(experiment.gravity_direction), gravity);
    });
  }
  std::map<std::string, int> control_index;
  for (size_t k = 0; k < experiment.bench.controls.size(); ++k) {
    const BenchFormat::Control& control = experiment.bench.controls[k];
    at(experiment, fmt::format("id '{}'", control.id),
       [&] { result.controls.push_back(declare_control(builder, control.id, quantities[k], 0.0)); });
    control_index[control.id] = result.controls.back();
  }
  for (const SupportSettings& support : experiment.supports) {
    at(experiment, fmt::format("[[support]] on '{}'", support.on), [&] {
      builder.fix(support.on, support.fix);
      if (!support.control.empty()) builder.prescribe(support.on, support.component, control_index.at(support.control));
    });
  }
  for (const LoadSettings& load : experiment.loads) {
    at(experiment, fmt::format("[[load]] '{}'", load.id), [&] {
      int control;
      if (load.column.empty()) {
        control = declare_control(builder, load.id, load.quantity, load.value);
        result.switched_off_at_rest.push_back(control);
      } else {
        control = control_index.at(load.id);
      }
      add_load(builder, load, control, gravity);
    });
  }
  for (const ChannelSettings& channel : experiment.channels) {
    result.channels.push_back({channel.id, at(experiment, fmt::format("[[channel]] '{}'", channel.id),
                                              [&] { return make_channel(builder.mesh(), channel); })});
  }
  result.scene = at(experiment, "the model", [&] { return builder.build(); });
  return result;
}

StaticBench make_static_bench(const Experiment& experiment, const MeshSettings& settings, const Trials& trials) {
  StaticBench bench;
  std::vector<StaticRow> rows;
  for (const Reading& reading : trials.readings) {
    const auto same = std::find_if(rows.begin(), rows.end(), [&](const StaticRow& row) {
      return row.channel == reading.channel && row.controls == reading.controls;
    });
    const int row = static_cast<int>(same - rows.begin());
    if (same == rows.end()) rows.push_back({reading.controls, reading.channel});
    bench.row_of_reading.push_back(row);
    bench.measurements.push_back({row, reading.value, reading.sigma, row});
  }
  BenchModel model = make_model(experiment, settings, trials.control_quantities);
  StaticProtocol::Options options;
  options.equilibrium = experiment.equilibrium;
  options.threads = experiment.threads;
  options.from_unloaded = experiment.from_unloaded;
  bench.protocol = std::make_unique<StaticProtocol>(std::move(model.scene), std::move(model.channels), model.controls,
                                                    model.switched_off_at_rest, rows, options);
  return bench;
}

std::vector<FreeParameter> free_parameters(const Experiment& experiment, const Protocol& protocol) {
  std::vector<FreeParameter> free;
  for (const FreeSettings& settings : experiment.free) {
    at(experiment, fmt::format("[fit.free.{}]", settings.id), [&] {
      FreeParameter parameter;
      parameter.index = protocol.parameters().index(settings.id);
      for (const BenchFormat::Control& control : experiment.bench.controls) {
        if (control.id == settings.id)
          throw InputError(
              fmt::format("'{}' is set by the bench, row by row, and cannot be fitted; free a parameter of the model",
                          settings.id));
      }
      const ParameterSpec& spec = protocol.parameters()[parameter.index];
      auto given = [&](const std::optional<GivenValue>& value, double otherwise) {
        return value ? parse_quantity(value->text, quantity_of_si_unit(spec.unit), value->where) : otherwise;
      };
      parameter.start = given(settings.start, protocol.nominal()[parameter.index]);
      parameter.lower = given(settings.lower, spec.lower);
      parameter.upper = given(settings.upper, spec.upper);
      for (double value : {parameter.lower, parameter.start, parameter.upper})
        protocol.parameters().check(parameter.index, value);
      if (!(parameter.lower <= parameter.start && parameter.start <= parameter.upper &&
            parameter.lower < parameter.upper)) {
        throw InputError(fmt::format("the start {} must lie between the bounds {} and {}",
                                     with_unit(parameter.start, spec.unit), with_unit(parameter.lower, spec.unit),
                                     with_unit(parameter.upper, spec.unit)));
      }
      free.push_back(parameter);
    });
  }
  return free;
}

double load_in_newtons(const Experiment& experiment, Quantity quantity, double value_si) {
  return quantity == Quantity::mass ? value_si * experiment.gravity : value_si;
}

}  // namespace taut
