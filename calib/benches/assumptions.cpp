#include "calib/benches/assumptions.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <map>

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

/// The default, and what it may be off by from the equator (9.780) to the poles (9.832 m/s2).
constexpr double standard_gravity = 9.81, gravity_on_earth = 0.03;

/// The parameter that a place of the file sets: "materials.foam.nu" nu_foam; of others the last word.
std::string id_at(const std::string& place) {
  if (place == "cables.k" || place == "cables.EA") return "k_cable";
  if (place == "gravity.acceleration") return "g";
  const size_t last = place.rfind('.'), first = place.find('.');
  if (place.starts_with("materials.") && last > first)
    return place.substr(last + 1) + "_" + place.substr(first + 1, last - first - 1);
  if (place.starts_with("geometry.size.")) return fmt::format("size_{}", "xyz"[(place[last + 1] - '1') % 3]);
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
    const auto found_dimension = std::ranges::find(dimensions, place, &Dimension::place);
    const bool dimension = found_dimension != dimensions.end();
    const std::string id = dimension ? found_dimension->spec.id : id_at(place);
    const bool known = table.contains(id) && (place.starts_with("materials.") || place.starts_with("cables.") ||
                                              place == "geometry.thickness" || place == "gravity.acceleration");
    if (!dimension && !known)
      throw InputError(tolerance.where +
                       ": a tolerance has no effect here; allowed: lengths in [geometry] that are not zero, corners of "
                       "boxes and polygons, constants in "
                       "[materials.NAME], k and slack in [cables], and [bench.tolerance] for what the bench sets");
    if (is_fitted(experiment, id))
      throw InputError(
          fmt::format("{}: {} is fitted ([fit.free.{}]), so that its tolerance has no effect; leave either "
                      "out",
                      tolerance.where, id, id));
    found[id] = tolerance;
  }
  return found;
}

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
  std::vector<Dimension> dimensions;
  add_lengths(experiment, dimensions);
  add_corners(experiment, dimensions);
  if (experiment.geometry.dimension == 2 && experiment.mesh.depth_cells > 0) {
    dimensions.push_back({spec_of("thickness", experiment.geometry.thickness, "thickness of the solid"),
                          "geometry.thickness", experiment.geometry.thickness,
                          [](Experiment& other, double length) { other.geometry.thickness = length; }});
  }
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
  table_.declare(dimension.spec);
  nominal_.conservativeResize(nominal_.size() + 1);
  nominal_[nominal_.size() - 1] = dimension.value;
  dimensions_.push_back(dimension);
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
  for (auto& [side, change] : {std::pair{&sides.less, -step_}, std::pair{&sides.more, step_}}) {
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
        const Sides& sides = sides_of(static_cast<size_t>(index - own));
        neighbours.push_back({sides.less.get(), sides.more.get(), 2 * step_});
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

Params DimensionedProtocol::values_of(const FitResult& fit) const {
  Params p = nominal_;
  p.head(own_count()) = fit.p.head(own_count());
  for (const ParameterEstimate& estimate : fit.parameters) p[table_.index(estimate.spec.id)] = estimate.value;
  return p;
}

}  // namespace taut
