#include "calib/benches/assumptions.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <set>

#include "calib/benches/corners.hpp"
#include "calib/benches/model.hpp"
#include "calib/fit/bytes.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"

namespace taut {
namespace {

/// A mesh that moves with a dimension is none any more when that has doubled.
ParameterSpec spec_of(const std::string& id, double value, std::string_view meaning) {
  return {id, id, "m", std::min(0.0, 2 * value), std::max(0.0, 2 * value), std::string(meaning)};
}

void add_lengths(const Experiment& experiment, std::vector<Dimension>& dimensions) {
  const std::unique_ptr<Shape> shape = experiment.geometry.shape->clone();
  const std::vector<ShapeKey> keys = shape->keys();
  for (size_t k = 0; k < keys.size(); ++k) {
    if (keys[k].quantity != Quantity::length) continue;
    const std::string name(keys[k].key);
    if (const auto* value = std::get_if<double*>(&keys[k].value); value != nullptr && **value != 0) {
      dimensions.push_back(
          {spec_of(name, **value, keys[k].meaning), "geometry." + name, **value, [k](Experiment& other, double length) {
             edit_key(other, k, [&](const ShapeKey& key) { *std::get<double*>(key.value) = length; });
           }});
    }
    if (const auto* list = std::get_if<LengthList*>(&keys[k].value); list != nullptr) {
      for (size_t i = 0; i < (*list)->values.size(); ++i) {
        const double length = (*list)->values[i];
        if (length == 0) continue;
        dimensions.push_back(
            {spec_of(fmt::format("{}_{}", name, i + 1), length, fmt::format("{}, number {}", keys[k].meaning, i + 1)),
             fmt::format("geometry.{}.{}", name, i + 1), length, [k, i](Experiment& other, double to) {
               edit_key(other, k, [&](const ShapeKey& key) { std::get<LengthList*>(key.value)->values[i] = to; });
             }});
      }
    }
    if (name != "size") continue;
    if (const auto* sizes = std::get_if<std::vector<double>*>(&keys[k].value); sizes != nullptr) {
      for (size_t axis = 0; axis < (*sizes)->size(); ++axis) {
        const std::string id = fmt::format("size_{}", "xyz"[axis]);
        dimensions.push_back(
            {spec_of(id, (**sizes)[axis], fmt::format("length along {}", "xyz"[axis])),
             fmt::format("geometry.size.{}", axis + 1), (**sizes)[axis], [k, axis](Experiment& other, double length) {
               edit_key(other, k,
                        [&](const ShapeKey& key) { (*std::get<std::vector<double>*>(key.value))[axis] = length; });
             }});
      }
    }
  }
}

/// A number of the setup that the mesh does not depend on: a reach to either side of its value.
void add_free_of_mesh(const std::string& id, std::string_view meaning, const std::string& place, double value,
                      double reach, std::string_view unit, std::function<void(Experiment&, double)> set,
                      std::vector<Dimension>& dimensions) {
  dimensions.push_back({{id, id, std::string(unit), value - reach, value + reach, std::string(meaning)},
                        place,
                        value,
                        std::move(set),
                        [](const Mesh& mesh) { return Eigen::VectorXd::Zero(mesh.X.size()).eval(); }});
  dimensions.back().spec.may_be_zero = unit == "rad" || id.starts_with("shift_");
}

/// Ends, offsets and angles of eyelets beside the axis: "cable_offset" of all that share one, "offset_<id>" of others.
void add_eyelets(const Experiment& experiment, std::vector<Dimension>& dimensions) {
  const auto& cables = experiment.cables.cables;
  if (std::ranges::none_of(cables, [](const CableSettings& cable) { return cable.line.has_value(); })) return;
  const double length = experiment.geometry.shape->axis()->length;
  const auto shared = experiment.cables.line;
  struct Part {
    std::string_view name, meaning, key;
    double EyeletLine::*member;
  };
  static constexpr std::array<Part, 5> parts{
      {{"start", "place along the axis where it begins", "along.1", &EyeletLine::start},
       {"end", "place along the axis where it ends", "along.2", &EyeletLine::end},
       {"offset", "distance from the axis where it begins", "offset.1", &EyeletLine::offset},
       {"end_offset", "distance from the axis where it ends", "offset.2", &EyeletLine::end_offset},
       {"angle", "angle about the axis", "angle", &EyeletLine::angle}}};
  for (const auto& [name, meaning, key, member] : parts) {
    const bool angle = key == "angle";
    const double reach = angle ? M_PI : length;
    const std::string group(key.substr(0, key.find('.')));
    const auto is_shared = [shared = shared.has_value(), group](const CableSettings& cable) {
      return shared && cable.line && std::ranges::find(cable.own_line, group) == cable.own_line.end();
    };
    if (angle && experiment.geometry.dimension == 2) continue;  // to either side, no more
    if (std::ranges::any_of(cables, is_shared))
      add_free_of_mesh(
          fmt::format("cable_{}", name), fmt::format("cables: {}", meaning), fmt::format("cables.{}", key),
          (*shared).*member, reach, angle ? "rad" : "m",
          [member = member, is_shared](Experiment& other, double value) {
            for (CableSettings& cable : other.cables.cables) {
              if (is_shared(cable)) (*cable.line).*member = value;
            }
          },
          dimensions);
    for (size_t c = 0; c < cables.size(); ++c) {
      if (!cables[c].line || is_shared(cables[c])) continue;
      add_free_of_mesh(
          fmt::format("{}_{}", name, cables[c].id), fmt::format("cable {}: {}", cables[c].id, meaning),
          fmt::format("cables.cable.{}.{}", cables[c].id, key), (*cables[c].line).*member, reach, angle ? "rad" : "m",
          [c, member = member](Experiment& other, double value) { (*other.cables.cables[c].line).*member = value; },
          dimensions);
    }
  }
}

/// The foot and the stand-off of each marker: "foot_<id>", "standoff_<id>", which stretches it.
void add_markers(const Experiment& experiment, std::vector<Dimension>& dimensions) {
  std::set<std::string> seen;
  for (const ChannelSettings& channel : experiment.channels) {
    if (!channel.foot || !seen.insert(channel.marker).second) continue;
    const std::string& id = channel.marker;
    const auto each = [id](Experiment& other, const auto& change) {
      for (ChannelSettings& one : other.channels) {
        if (one.marker == id) change(one);
      }
    };
    add_free_of_mesh(
        "foot_" + id, fmt::format("place of marker {} along the axis", id), "marker." + id + ".s", *channel.foot,
        experiment.geometry.shape->axis()->length, "m",
        [each](Experiment& other, double value) { each(other, [&](ChannelSettings& one) { one.foot = value; }); },
        dimensions);
    if (channel.standoff.empty()) continue;
    const double length = vector_of(channel.standoff).norm();
    add_free_of_mesh(
        "standoff_" + id, fmt::format("length of the stand-off of marker {}", id), "marker." + id + ".standoff", length,
        length, "m",
        [each, from = channel.standoff, length](Experiment& other, double value) {
          each(other, [&](ChannelSettings& one) {
            for (size_t k = 0; k < from.size(); ++k) one.standoff[k] = value / length * from[k];
          });
        },
        dimensions);
  }
}

/// How a body stands: "turn_x" and so on, about axes through its own origin, and "shift_x".
void add_pose(const Experiment& experiment, std::vector<Dimension>& dimensions) {
  if (experiment.geometry.dimension != 3 || experiment.mesh.depth_cells > 0) return;
  for (size_t k = 0; k < 3; ++k) {
    const char name = "xyz"[k];
    const auto entry = [k](std::vector<double>& values) -> double& {
      values.resize(3, 0.0);
      return values[k];
    };
    const auto value_in = [k](const std::vector<double>& values) { return values.empty() ? 0.0 : values[k]; };
    add_free_of_mesh(
        fmt::format("turn_{}", name), fmt::format("turn of the base about {}", name),
        fmt::format("base.turn.{}", k + 1), value_in(experiment.base_turn), M_PI, "rad",
        [entry](Experiment& other, double value) { entry(other.base_turn) = value; }, dimensions);
    add_free_of_mesh(
        fmt::format("shift_{}", name), fmt::format("place of the base along {}", name),
        fmt::format("base.at.{}", k + 1), value_in(experiment.base_at), 1.0, "m",
        [entry](Experiment& other, double value) { entry(other.base_at) = value; }, dimensions);
  }
}

/// The default, and what it may be off by from the equator (9.780) to the poles (9.832 m/s2).
constexpr double standard_gravity = 9.81, gravity_on_earth = 0.03;

/// The parameter that a place of the file sets: "materials.foam.nu" nu_foam; of others the last word.
std::string id_at(const std::string& place) {
  if (place == "cables.k" || place == "cables.EA") return "k_cable";
  if (place == "cables.friction") return "cable_friction";
  if (place == "cables.misalignment") return "cable_misalignment";
  if (place == "gravity.acceleration") return "g";
  if (place == "studs.stiffness") return "k_stud";
  const size_t last = place.rfind('.'), first = place.find('.');
  if (place.starts_with("stud.") && last > first)
    return (place.ends_with(".stiffness") ? "k" : "clearance") + ("_" + place.substr(first + 1, last - first - 1));
  if (place.starts_with("materials.") && last > first)
    return place.substr(last + 1) + "_" + place.substr(first + 1, last - first - 1);
  return place.substr(last + 1);
}

/// What an experiment's numerics or a bench's zero have, which is nobody's to measure.
bool is_numerical(const std::string& id) {
  return id == "contact_gap" || id.starts_with("contact_pressure_") || id.starts_with("zero_");
}

/// The tolerances of a file by the ids of what they belong to.
std::map<std::string, Tolerance> tolerances_by_id(const Experiment& experiment, const ParameterTable& table,
                                                  const std::vector<Dimension>& dimensions) {
  std::map<std::string, Tolerance> found;
  for (const auto& [place, tolerance] : experiment.tolerances) {
    const auto dimension = std::ranges::find(dimensions, place, &Dimension::place);
    const std::string id = dimension != dimensions.end() ? dimension->spec.id : id_at(place);
    const bool known = table.contains(id) && (place.starts_with("materials.") || place.starts_with("cables.") ||
                                              place.starts_with("stud.") || place.starts_with("studs.") ||
                                              place == "geometry.thickness" || place == "gravity.acceleration");
    if (dimension == dimensions.end() && !known)
      throw InputError(
          tolerance.where +
          ": a tolerance has no effect here; allowed: lengths in [geometry] that are not zero, corners of boxes and "
          "polygons, constants in [materials.NAME], k, slack, friction, misalignment and eyelets in [cables], "
          "clearance and "
          "stiffness of a [[stud]], places of a [[marker]], [base], and [bench.tolerance] for what the bench sets");
    if (is_fitted(experiment, id))
      throw InputError(
          fmt::format("{}: {} is fitted ([fit.free.{}]), so that its tolerance has no effect; leave either "
                      "out",
                      tolerance.where, id, id));
    found[id] = tolerance;
  }
  return found;
}

}  // namespace

void drop_tolerances(Experiment& experiment, const std::vector<std::string>& ids) {
  const std::vector<Dimension> dimensions = all_dimensions(experiment);
  std::erase_if(experiment.tolerances, [&](const auto& entry) {
    const auto dimension = std::ranges::find(dimensions, entry.first, &Dimension::place);
    const std::string id = dimension != dimensions.end() ? dimension->spec.id : id_at(entry.first);
    return std::ranges::find(ids, id) != ids.end();
  });
}

namespace {

/// A control's own tolerance: a part of its values, or an error of its zero.
Assumption control_assumption(const Experiment& experiment, const ParameterSpec& spec) {
  Assumption assumption{spec.id, 1, 0, true, "1"};
  const auto given = experiment.control_tolerances.find(spec.id);
  if (given == experiment.control_tolerances.end()) return assumption;
  const auto& [text, where] = given->second;
  assumption.scale = text.find('%') != std::string::npos;
  assumption.unit = assumption.scale ? "1" : spec.unit;
  assumption.tolerance =
      parse_quantity(text, assumption.scale ? Quantity::pure : quantity_of_si_unit(spec.unit), where);
  if (!(assumption.tolerance > 0)) throw InputError(where + ": a tolerance must be positive");
  return assumption;
}

}  // namespace

std::vector<Dimension> dimensions_of(const Experiment& experiment) {
  std::vector<Dimension> dimensions = all_dimensions(experiment);
  const std::vector<std::string> set = ids_set_by_columns(experiment);
  std::erase_if(dimensions, [&](const Dimension& one) { return std::ranges::find(set, one.spec.id) != set.end(); });
  return dimensions;
}

std::vector<Dimension> all_dimensions(const Experiment& experiment) {
  std::vector<Dimension> dimensions;
  add_lengths(experiment, dimensions);
  add_corners(experiment, dimensions);
  if (experiment.geometry.dimension == 2 && experiment.mesh.depth_cells > 0) {
    dimensions.push_back({spec_of("thickness", experiment.geometry.thickness, "thickness of the solid"),
                          "geometry.thickness", experiment.geometry.thickness,
                          [](Experiment& other, double length) { other.geometry.thickness = length; }});
  }
  add_eyelets(experiment, dimensions);
  add_markers(experiment, dimensions);
  add_pose(experiment, dimensions);
  return dimensions;
}

std::vector<Assumption> assumptions_of(const Experiment& experiment, const ParameterTable& table, const Params& p,
                                       const std::vector<Dimension>& dimensions) {
  const std::map<std::string, Tolerance> tolerances = tolerances_by_id(experiment, table, dimensions);
  std::vector<Assumption> assumptions;
  const auto add = [&](const ParameterSpec& spec, double value) {
    const auto stated = tolerances.find(spec.id);
    double tolerance = stated == tolerances.end() ? 0 : stated->second.half_width;
    if (spec.id == "g" && tolerance == 0) {
      if (value != standard_gravity) return;  // somebody looked it up
      tolerance = gravity_on_earth;
    }
    if (value != 0 || tolerance > 0) assumptions.push_back({spec.id, value, tolerance, false, spec.unit});
  };
  for (int i = 0; i < table.size(); ++i) {
    const ParameterSpec& spec = table[i];
    if (std::ranges::find(experiment.bench.controls, spec.id, &BenchFormat::Control::id) !=
        experiment.bench.controls.end())
      assumptions.push_back(control_assumption(experiment, spec));
    else if (!is_fitted(experiment, spec.id) && !is_numerical(spec.id) &&
             std::ranges::find(dimensions, spec.id, [](const Dimension& d) { return d.spec.id; }) == dimensions.end())
      add(spec, p[i]);
  }
  for (const Dimension& dimension : dimensions) {
    if (!is_fitted(experiment, dimension.spec.id)) add(dimension.spec, dimension.value);
  }
  return assumptions;
}

void declare(const Dimension& dimension, ParameterTable& table, Params& nominal) {
  table.declare(dimension.spec);
  nominal.conservativeResize(nominal.size() + 1);
  nominal[nominal.size() - 1] = dimension.value;
}

Params DimensionedModel::values_of(const FitResult& fit) const {
  Params p = protocol->nominal();
  const Eigen::Index own = p.size() - static_cast<Eigen::Index>(dimensions.size());
  p.head(own) = fit.p.head(own);
  for (const ParameterEstimate& e : fit.parameters) p[protocol->parameters().index(e.spec.id)] = e.value;
  return p;
}

std::vector<Dimension> free_dimensions(const Experiment& experiment) {
  std::vector<Dimension> dimensions = dimensions_of(experiment);
  std::erase_if(dimensions, [&](const Dimension& dimension) { return !is_fitted(experiment, dimension.spec.id); });
  return dimensions;
}

DimensionedProtocol::DimensionedProtocol(Experiment experiment, Trials trials, const std::vector<Dimension>& dimensions)
    : experiment_(std::move(experiment)),
      trials_(std::move(trials)),
      replay_(make_static_replay(experiment_, experiment_.mesh, trials_)),
      table_(replay_.protocol->parameters()),
      nominal_(replay_.protocol->nominal()) {
  if (dimensions.empty()) return;
  mesh_ = std::make_shared<const Mesh>(make_mesh(experiment_, experiment_.mesh));
  // Far below the distance at which contact sets in, far above rounding.
  step_ = 1e-8 * mesh_->diagonal();
  for (const Dimension& dimension : dimensions) {
    if (!table_.contains(dimension.spec.id)) add(dimension);
  }
  sides_.resize(dimensions_.size());
  lengths_ = nominal_.tail(static_cast<Eigen::Index>(dimensions_.size()));
}

void DimensionedProtocol::add(const Dimension& dimension) {
  const auto mesh_with = [&](double change) {
    Experiment other = experiment_;
    dimension.set(other, dimension.value + change);
    Mesh mesh = make_mesh(other, other.mesh);
    if (mesh.elements != mesh_->elements || (mesh.X - mesh_->X).cwiseAbs().maxCoeff() > 1e3 * step_)
      throw InputError("a small change of it makes a mesh of other elements");
    return mesh;
  };
  try {
    moves_.emplace_back(dimension.moves ? dimension.moves(*mesh_)
                                        : (mesh_with(step_).X - mesh_with(-step_).X) / (2 * step_));
  } catch (const InputError& error) {
    left_out_.push_back(fmt::format("{}: {}", dimension.spec.id, error.what()));
    return;
  }
  declare(dimension, table_, nominal_);
  dimensions_.push_back(dimension);
}

double DimensionedProtocol::step_of(size_t dimension) const {
  return dimensions_[dimension].spec.unit == "rad" ? 1e-8 : step_;
}

StaticReplay DimensionedProtocol::replay_at(const Eigen::VectorXd& lengths) const {
  Experiment moved = experiment_;
  auto mesh = std::make_shared<Mesh>(*mesh_);
  for (size_t k = 0; k < dimensions_.size(); ++k) {
    const double length = lengths[static_cast<Eigen::Index>(k)];
    if (length == dimensions_[k].value) continue;
    dimensions_[k].set(moved, length);
    mesh->X += (length - dimensions_[k].value) * moves_[k];
  }
  moved.geometry.mesh = mesh;
  return make_static_replay(moved, moved.mesh, trials_);
}

void DimensionedProtocol::move_to(const Eigen::VectorXd& lengths) {
  if (lengths == lengths_) return;
  StaticReplay there = replay_at(lengths);
  factorisations_ += replay_.protocol->factorisations();
  newton_iterations_ += replay_.protocol->newton_iterations();
  replay_ = std::move(there);
  lengths_ = lengths;
  for (Sides& sides : sides_) sides = {};
  if (!follow_rows_.empty()) replay_.protocol->follow(follow_at_, follow_rows_);
}

const DimensionedProtocol::Sides& DimensionedProtocol::sides_of(size_t dimension) {
  Sides& sides = sides_[dimension];
  const double step = step_of(dimension);
  for (auto& [side, change] : {std::pair{&sides.less, -step}, std::pair{&sides.more, step}}) {
    if (*side) continue;
    Eigen::VectorXd lengths = lengths_;
    lengths[static_cast<Eigen::Index>(dimension)] += change;
    *side = std::move(replay_at(lengths).protocol);
  }
  return sides;
}

Prediction DimensionedProtocol::predict(const Params& p, const std::vector<int>& free) {
  const Eigen::Index own = own_count();
  std::vector<int> of_model;
  std::vector<StaticProtocol::Neighbours> neighbours;
  try {
    move_to(p.tail(p.size() - own));
    for (int index : free) {
      if (index < own) {
        of_model.push_back(index);
      } else {
        const size_t dimension = static_cast<size_t>(index - own);
        const Sides& sides = sides_of(dimension);
        neighbours.push_back({sides.less.get(), sides.more.get(), 2 * step_of(dimension)});
      }
    }
  } catch (const InputError& error) {  // dimensions that are none together cost this prediction
    Prediction none;
    none.values = Eigen::VectorXd::Constant(row_count(), not_a_number);
    if (!free.empty())
      none.derivatives = Eigen::MatrixXd::Constant(row_count(), static_cast<Eigen::Index>(free.size()), not_a_number);
    none.failures.emplace_back(error.what());
    return none;
  }
  Prediction prediction = replay_.protocol->predict(p.head(own), of_model);
  if (neighbours.empty()) return prediction;
  Eigen::MatrixXd all = Eigen::MatrixXd::Constant(row_count(), static_cast<Eigen::Index>(free.size()), not_a_number);
  if (prediction.complete()) {
    const Eigen::MatrixXd between = replay_.protocol->derivatives_between(neighbours);
    Eigen::Index a = 0, b = 0;
    for (size_t k = 0; k < free.size(); ++k)
      all.col(static_cast<Eigen::Index>(k)) =
          free[k] < own ? Eigen::VectorXd(prediction.derivatives.col(a++)) : Eigen::VectorXd(between.col(b++));
  }
  prediction.derivatives = std::move(all);
  return prediction;
}

std::string DimensionedProtocol::state() const {
  if (dimensions_.empty()) return replay_.protocol->state();
  Bytes out;
  out(lengths_, replay_.protocol->state());
  return out.bytes();
}

void DimensionedProtocol::restore(const std::string& state) {
  if (dimensions_.empty()) return replay_.protocol->restore(state);
  Eigen::VectorXd lengths;
  std::string of_replay;
  Bytes in(state);
  in(lengths, of_replay);
  move_to(lengths);
  replay_.protocol->restore(of_replay);
}

std::vector<Alternative> DimensionedProtocol::alternatives(const Params& p) {
  move_to(p.tail(p.size() - own_count()));
  return replay_.protocol->alternatives(p.head(own_count()));
}

void DimensionedProtocol::follow(const Params& at, const std::vector<int>& rows) {
  follow_rows_ = rows;
  if (!rows.empty()) {
    follow_at_ = at.head(own_count());
    move_to(at.tail(at.size() - own_count()));
  }
  replay_.protocol->follow(follow_at_, rows);
}

int DimensionedProtocol::newton_iterations() const {
  return newton_iterations_ + replay_.protocol->newton_iterations();
}

}  // namespace taut
