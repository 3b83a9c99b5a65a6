#include "calib/models/rod_model.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>

#include "calib/models/rod.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/units.hpp"
#include "sim/scene/channel_kinds.hpp"

namespace taut {
namespace {

using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector3d;

/// What a value of the rod is: a number times parameters.
struct Product {
  double scale = 0;
  std::vector<int> factors;  ///< table indices

  /// Without the factor at `but`: the derivative by it.
  double at(const Params& p, size_t but = std::numeric_limits<size_t>::max()) const {
    double value = scale;
    for (size_t k = 0; k < factors.size(); ++k) value *= k == but ? 1.0 : p[factors[k]];
    return value;
  }
};

/// What a row reads.
struct RodChannel {
  RodPoint at;
  Vector3d direction;      ///< in the world, unit length
  bool rotation = false;   ///< of the end face, about the direction
  bool from_rest = false;  ///< a displacement
};

/// The rod with its place in the world: x = origin + frame (rod's own coordinates). The frame may be a left-handed one.
struct PlacedRod {
  Rod rod;
  Vector3d origin;
  Matrix3d frame;
  std::vector<RodChannel> channels;

  /// 1 or -1.
  double handedness() const {
    const Matrix3d& F = frame;
    return F(2, 2) * (F(0, 0) * F(1, 1) - F(1, 0) * F(0, 1)) + F(1, 2) * (F(2, 0) * F(0, 1) - F(0, 0) * F(2, 1)) +
           F(0, 2) * (F(1, 0) * F(2, 1) - F(2, 0) * F(1, 1));
  }
  double rest(const RodChannel& channel) const {
    return channel.direction.dot(origin + frame * (channel.at.offset + Vector3d(0, 0, channel.at.s)));
  }
};

/// A reading, and how it changes where the unknowns change like columns of `dx`.
struct RowReading {
  double value = 0;
  double moved = 0;  ///< see RodProtocol::moved()
  Eigen::RowVectorXd slopes;
};

RowReading reading_of(const PlacedRod& placed, const RodChannel& channel, const RodState& x, const MatrixXd& dx) {
  RowReading reading;
  if (channel.rotation) {
    // See make_rotation_channel(): the component about an axis, for small turns behind R.
    const Matrix3d R = placed.frame * placed.rod.end_rotation(x) * placed.frame.transpose();
    const Vector3d axial(R(2, 1) - R(1, 2), R(0, 2) - R(2, 0), R(1, 0) - R(0, 1));
    const double s = channel.direction.dot(axial), c = R.trace() - 1;
    reading.value = reading.moved = std::atan2(s, c);
    const Vector3d by_turn =
        (c * (R.trace() * channel.direction - R * channel.direction) + s * axial) / (c * c + s * s);
    reading.slopes = Eigen::RowVectorXd::Zero(dx.cols());
    if (dx.cols() > 0) reading.slopes = placed.handedness() * by_turn.transpose() * placed.frame * dx.bottomRows<3>();
    return reading;
  }
  const RodReading position = placed.rod.position(x, channel.at);
  const Vector3d direction = placed.frame.transpose() * channel.direction;
  reading.value = channel.direction.dot(placed.origin) + direction.dot(position.value);
  const double displacement = reading.value - placed.rest(channel);
  if (channel.from_rest) reading.value = displacement;
  reading.moved =
      std::copysign((position.value - channel.at.offset - Vector3d(0, 0, channel.at.s)).norm(), displacement);
  reading.slopes = direction.transpose() * position.change(dx);
  return reading;
}

/// An equilibrium with its sensitivities.
struct Solved {
  std::string problem;  ///< why it was not reached; "": it was
  RodState x;
  MatrixXd dx;       ///< by the free parameters
  double error = 0;  ///< what the rod states
};

}  // namespace

namespace {

/// Nodes are where tendons begin and end, whatever becomes of these places: an energy that jumps from element to
/// element would have a kink there.
struct Division {
  struct End {
    size_t cable;
    double EyeletLine::*at;
  };
  std::vector<std::vector<End>> stations;  ///< ends at one place, in their order along the rod
  std::vector<int> counts;                 ///< elements before each, and behind the last
};

Division divided(const Experiment& experiment) {
  const double length = experiment.geometry.shape->axis()->length;
  std::vector<std::pair<double, Division::End>> ends;
  for (size_t c = 0; c < experiment.cables.cables.size(); ++c) {
    for (double EyeletLine::*at : {&EyeletLine::start, &EyeletLine::end}) {
      const double s = (*experiment.cables.cables[c].line).*at;
      if (s > 1e-3 * length && s < (1 - 1e-3) * length) ends.push_back({s, {c, at}});
    }
  }
  std::ranges::stable_sort(ends, {}, [](const auto& end) { return end.first; });
  Division division;
  double before = 0;
  const auto fill = [&](double until) {
    division.counts.push_back(std::max(1, static_cast<int>(std::lround(72 * (until - before) / length))));
    before = until;
  };
  for (const auto& [s, end] : ends) {
    if (division.stations.empty() || s - before > 1e-3 * length) {
      fill(s);
      division.stations.emplace_back();
    }
    division.stations.back().push_back(end);
  }
  fill(length);
  return division;
}

std::vector<double> nodes_of(const Division& division, const Experiment& experiment, double length) {
  std::vector<double> nodes{0};
  for (size_t k = 0; k < division.counts.size(); ++k) {
    double until = length;
    if (k < division.stations.size()) {
      until = 0;
      for (const Division::End& end : division.stations[k])
        until += (*experiment.cables.cables[end.cable].line).*end.at / static_cast<double>(division.stations[k].size());
    }
    const double from = nodes.back();
    if (until < from + 1e-4 * length) throw InputError("cables begin and end in the order in which the file has them");
    for (int i = 1; i <= division.counts[k]; ++i)
      nodes.push_back(i == division.counts[k] ? until : from + (until - from) * i / division.counts[k]);
  }
  return nodes;
}

}  // namespace

struct RodProtocol::Bench {
  Division division;
  Experiment experiment;
  std::vector<Dimension> dimensions;
  ParameterTable table;
  Params nominal;
  std::vector<StaticRow> rows;
  std::vector<int> controls;
  std::vector<Product> values;  ///< in the order of Rod::Value
  std::optional<PlacedRod> placed;
  Eigen::VectorXd lengths;                         ///< dimensions of `placed`
  std::map<std::vector<double>, RodState> states;  ///< of the last prediction, by the controls
  struct Sides {
    std::optional<PlacedRod> less, more;
  };
  std::vector<Sides> sides;  ///< of `placed`, made when they are asked for
  double step = 0;           ///< of lengths [m]; of angles over the rod's length

  Eigen::Index own() const { return nominal.size() - static_cast<Eigen::Index>(dimensions.size()); }
  double step_of(size_t dimension) const {
    return dimensions[dimension].spec.unit == "rad" ? step / placed->rod.shape().length : step;
  }
  PlacedRod placed_at(const Eigen::VectorXd& at) const;
  const Sides& sides_of(size_t dimension);
  Rod::Values values_at(const Params& p) const;
  MatrixXd values_by(const Params& p, const std::vector<int>& free) const;
  Solved solve(const Params& p, const std::vector<int>& free, int& factorisations);
  RowReading read_row(const RodChannel& channel, size_t index, const Solved& solved, const std::vector<int>& free);
  double stated(const RodState& x) const;
};

namespace {

constexpr const char* rod_remedy = "; model = \"full\" takes the rest";

[[noreturn]] void refuse_rod(const Experiment& experiment, const std::string& part, const std::string& what) {
  throw FileError(experiment.path, part + ": " + what + rod_remedy);
}

/// The faces at the ends of the axis.
struct EndFaces {
  std::string base, tip;
};
EndFaces end_faces(const Experiment& experiment) {
  return experiment.geometry.kind() == "box" ? EndFaces{"xmin", "xmax"} : EndFaces{"base", "tip"};
}

/// Everything that no rod has.
void check_rod(const Experiment& experiment) {
  const GeometrySettings& geometry = experiment.geometry;
  if (!experiment.kind->at_rest)
    refuse_rod(experiment, "[bench]", "a rod has no inertia here and takes readings at rest");
  if ((geometry.kind() != "revolved" && geometry.kind() != "box") || geometry.dimension != 3) {
    refuse_rod(experiment, "[geometry]",
               fmt::format("a rod is made from a revolved body or a box, not from '{}'", geometry.kind()));
  }
  if (experiment.mesh.depth_cells > 0) refuse_rod(experiment, "[mesh]", "a rod is a whole body, not one half");
  const EndFaces faces = end_faces(experiment);
  if (experiment.supports.size() != 1 || experiment.supports.front().on != faces.base ||
      experiment.supports.front().fix.size() != 3) {
    refuse_rod(experiment, "[[support]]",
               fmt::format("a rod has one support, '{}', with fix = [\"x\", \"y\", \"z\"]", faces.base));
  }
  if (experiment.materials.size() != 1) refuse_rod(experiment, "[materials]", "a rod is of one material");
  const MaterialSettings& material = experiment.materials.front();
  if (experiment.rod_section == SectionLaw::neo_hookean && material.law != "neo_hookean")
    refuse_rod(
        experiment, fmt::format("[materials.{}]", material.region),
        fmt::format("the fibres of a rod are neo_hookean, not {}; set rod_section = \"linear\" for its E and nu alone",
                    material.law));
  if (experiment.contact.on || !experiment.contact.obstacles.empty() || !experiment.contact.grounds.empty())
    refuse_rod(experiment, "[contact]", "a rod touches nothing; leave [contact] out");
  for (const CableSettings& cable : experiment.cables.cables) {
    if (!cable.held || !cable.line)
      refuse_rod(experiment, fmt::format("cable '{}'", cable.id),
                 "a rod's cables run beside its axis ('along', 'offset', 'angle') and their 'tension' is held");
  }
}

/// A point of the world at rest, in a rod.
RodPoint rod_point(const PlacedRod& placed, const std::vector<double>& at) {
  const Vector3d own = placed.frame.transpose() * (vector_of(at) - placed.origin);
  return {own[2], {own[0], own[1], 0}};
}

/// Where a load or a channel sits: the middle of the end face, or a point of the body.
RodPoint rod_seat(const Experiment& experiment, const std::string& part, const std::string& on,
                  const std::vector<double>& point, const PlacedRod& placed) {
  const EndFaces faces = end_faces(experiment);
  const double length = placed.rod.shape().length;
  if (on == faces.tip) return {length, Vector3d::Zero()};
  if (on.empty() && point.size() == 3) {
    const RodPoint at = rod_point(placed, point);
    if (at.s > -1e-6 * length && at.s < (1 + 1e-6) * length) return at;
  }
  refuse_rod(experiment, part, fmt::format("on a rod it stands on '{}' or at a point between its ends", faces.tip));
}

RodTendon tendon_along(const EyeletLine& line) {
  return {line.start, line.end, [line](double s) {
            const double t = (s - line.start) / (line.end - line.start);
            return Eigen::Vector2d(std::lerp(line.offset, line.end_offset, t) *
                                   Eigen::Vector2d(std::cos(line.angle), std::sin(line.angle)));
          }};
}

RodChannel make_channel(const Experiment& experiment, const ChannelSettings& channel, const BodySettings& body,
                        const PlacedRod& placed) {
  const std::string part = fmt::format("[[channel]] '{}'", channel.id);
  RodChannel made;
  made.direction = vector_of(channel.direction).normalized();
  made.rotation = channel.kind->name == "rotation";
  made.from_rest = channel.kind->from_rest;
  if (!made.rotation && channel.kind->name != "displacement" && channel.kind->name != "position")
    refuse_rod(experiment, part,
               fmt::format("a rod shows displacements, positions and rotations, and this is a {}", channel.kind->name));
  if (channel.foot) {
    made.at.s = *channel.foot;
    if (!channel.standoff.empty())
      made.at.offset = placed.frame.transpose() * rotation_of(body, 3) * vector_of(channel.standoff);
    return made;
  }
  if (!channel.standoff.empty())
    refuse_rod(experiment, part, "a rod carries markers on its axis; make it a [[marker]]");
  if (made.rotation && channel.on != end_faces(experiment).tip)
    refuse_rod(experiment, part,
               fmt::format("a rod shows the rotation of its end face, '{}'", end_faces(experiment).tip));
  made.at = rod_seat(experiment, part, channel.on, channel.point, placed);
  return made;
}

/// "tension_1 = 6.154 N, tension_2 = 0 N".
std::string described_controls(const ParameterTable& table, const std::vector<int>& controls,
                               const std::vector<double>& values) {
  std::vector<std::string> texts;
  for (size_t k = 0; k < controls.size(); ++k)
    texts.push_back(fmt::format("{} = {}", table[controls[k]].id, with_unit(values[k], table[controls[k]].unit)));
  return join(texts);
}

PlacedRod place_rod(const Experiment& experiment, const Division& division) {
  experiment.geometry.shape->check();
  BodySettings body;
  body.geometry = experiment.geometry;
  body.at = experiment.base_at;
  body.turn = experiment.base_turn;
  const BodyAxis axis = axis_of(body);
  Matrix3d frame;
  frame << axis.first, axis.second, axis.along;
  RodShape shape;
  shape.length = axis.length;
  shape.nodes = nodes_of(division, experiment, axis.length);
  shape.section = axis.section;
  shape.round = experiment.geometry.kind() != "box";
  if (!shape.round) shape.shear_factor = 5.0 / 6;
  shape.law = experiment.rod_section;
  if (!experiment.gravity_direction.empty())
    shape.down = frame.transpose() * vector_of(experiment.gravity_direction).normalized();
  for (const CableSettings& cable : experiment.cables.cables) shape.tendons.push_back(tendon_along(*cable.line));
  PlacedRod placed{Rod(shape), axis.origin, frame, {}};
  if (!experiment.loads.empty()) {
    for (const LoadSettings& load : experiment.loads) {
      const std::string part = fmt::format("[[load]] '{}'", load.id);
      if (load.quantity != Quantity::force && load.quantity != Quantity::mass)
        refuse_rod(experiment, part, "a rod carries forces and hung masses");
      shape.forces.push_back({rod_seat(experiment, part, load.on, load.point, placed),
                              frame.transpose() * vector_of(load.direction).normalized()});
    }
    placed.rod = Rod(shape);
  }
  for (const ChannelSettings& channel : experiment.channels)
    placed.channels.push_back(make_channel(experiment, channel, body, placed));
  return placed;
}

/// What the values of the rod are made of.
std::vector<Product> products_of(const Experiment& experiment, const BenchModel& model, const ParameterTable& table) {
  const std::string& region = experiment.materials.front().region;
  const auto index = [&](const std::string& id) { return table.contains(id) ? table.index(id) : -1; };
  std::vector<Product> values;
  for (const char* id : {"E_", "nu_"}) {
    if (index(id + region) < 0)
      refuse_rod(experiment, fmt::format("[materials.{}]", region), "a rod needs a law with E and nu");
    values.push_back({1, {index(id + region)}});
  }
  const int density = index("density_" + region);
  values.push_back(density < 0 ? Product{} : Product{1, {density, index("g")}});
  for (const Cable& cable : model.cables) values.push_back({cable.per_control, {cable.tension, cable.tension_scale}});
  for (const LoadSettings& load : experiment.loads) {
    values.push_back({1, {index(load.control.empty() ? load.id : load.control)}});
    if (load.quantity == Quantity::mass) values.back().factors.push_back(index("g"));
  }
  const int friction = index("cable_friction");
  values.push_back(friction < 0 ? Product{} : Product{1, {friction}});
  return values;
}

}  // namespace

PlacedRod RodProtocol::Bench::placed_at(const Eigen::VectorXd& at) const {
  Experiment moved = experiment;
  for (size_t k = 0; k < dimensions.size(); ++k) {
    const double value = at[static_cast<Eigen::Index>(k)];
    if (value != dimensions[k].value) dimensions[k].set(moved, value);
  }
  return place_rod(moved, division);
}

const RodProtocol::Bench::Sides& RodProtocol::Bench::sides_of(size_t dimension) {
  Sides& there = sides[dimension];
  for (const auto& [side, sign] : {std::pair{&there.less, -1.0}, std::pair{&there.more, 1.0}}) {
    if (*side) continue;
    Eigen::VectorXd moved = lengths;
    moved[static_cast<Eigen::Index>(dimension)] += sign * step_of(dimension);
    side->emplace(placed_at(moved));
  }
  return there;
}

Rod::Values RodProtocol::Bench::values_at(const Params& p) const {
  Rod::Values all(static_cast<Eigen::Index>(values.size()));
  for (size_t k = 0; k < values.size(); ++k) all[static_cast<Eigen::Index>(k)] = values[k].at(p);
  return all;
}

MatrixXd RodProtocol::Bench::values_by(const Params& p, const std::vector<int>& free) const {
  MatrixXd by = MatrixXd::Zero(static_cast<Eigen::Index>(values.size()), static_cast<Eigen::Index>(free.size()));
  for (size_t k = 0; k < values.size(); ++k) {
    for (size_t f = 0; f < values[k].factors.size(); ++f) {
      for (size_t c = 0; c < free.size(); ++c) {
        if (free[c] == values[k].factors[f])
          by(static_cast<Eigen::Index>(k), static_cast<Eigen::Index>(c)) += values[k].at(p, f);
      }
    }
  }
  return by;
}

Solved RodProtocol::Bench::solve(const Params& p, const std::vector<int>& free, int& factorisations) {
  Solved solved;
  const Rod& rod = placed->rod;
  const Rod::Values at = values_at(p);
  solved.problem = rod.solve_from_rest(solved.x, at, factorisations);
  if (!solved.problem.empty()) return solved;
  solved.error = stated(solved.x);
  if (free.empty()) {
    solved.dx = MatrixXd::Zero(rod.unknowns(), 0);
    return solved;
  }
  const MatrixXd by = values_by(p, free);
  MatrixXd gradients = rod.gradient_by_values(solved.x, at, !by.row(rod.friction()).isZero()) * by;
  for (size_t c = 0; c < free.size(); ++c) {
    if (free[c] < own()) continue;
    const size_t dimension = static_cast<size_t>(free[c] - own());
    const Sides& there = sides_of(dimension);
    gradients.col(static_cast<Eigen::Index>(c)) =
        (there.more->rod.gradient(solved.x, at) - there.less->rod.gradient(solved.x, at)) / (2 * step_of(dimension));
  }
  ++factorisations;
  const std::optional<MatrixXd> dx = rod.solve_linear(solved.x, at, -gradients);
  if (dx)
    solved.dx = *dx;
  else
    solved.problem = "the equilibrium is not stable";
  return solved;
}

/// With what dimensions change at a fixed state.
RowReading RodProtocol::Bench::read_row(const RodChannel& channel, size_t index, const Solved& solved,
                                        const std::vector<int>& free) {
  RowReading reading = reading_of(*placed, channel, solved.x, solved.dx);
  const MatrixXd none = MatrixXd::Zero(placed->rod.unknowns(), 0);
  for (size_t c = 0; c < free.size(); ++c) {
    if (free[c] < own()) continue;
    const size_t dimension = static_cast<size_t>(free[c] - own());
    const Sides& there = sides_of(dimension);
    const auto value = [&](const PlacedRod& side) {
      return reading_of(side, side.channels[index], solved.x, none).value;
    };
    reading.slopes[static_cast<Eigen::Index>(c)] +=
        (value(*there.more) - value(*there.less)) / (2 * step_of(dimension));
  }
  return reading;
}

double RodProtocol::Bench::stated(const RodState& x) const {
  const RodShape& shape = placed->rod.shape();
  double radius = 0;
  for (int i = 0; i <= 8; ++i) {
    const CrossSection section = shape.section(i * shape.length / 8);
    radius = std::max(radius, std::sqrt((shape.round ? 2 : 3) * (section.first + section.second) / section.area));
  }
  const auto [compression, size] = placed->rod.strains(x);
  if (shape.length < 5 * radius || compression > 0.5) return std::numeric_limits<double>::infinity();
  return 0.01 + 2 * std::pow(radius / shape.length, 2) + 1.5 * size * size;
}

RodProtocol::RodProtocol(std::unique_ptr<Bench> bench)
    : bench_(std::move(bench)), errors_(bench_->rows.size(), not_a_number), moved_(errors_) {}
RodProtocol::~RodProtocol() = default;
const ParameterTable& RodProtocol::parameters() const {
  return bench_->table;
}
const Params& RodProtocol::nominal() const {
  return bench_->nominal;
}
int RodProtocol::row_count() const {
  return static_cast<int>(bench_->rows.size());
}
int RodProtocol::elements() const {
  return bench_->placed->rod.elements();
}
int RodProtocol::unknowns() const {
  return static_cast<int>(bench_->placed->rod.unknowns());
}

Eigen::VectorXd RodProtocol::displacements(const Mesh& mesh, const std::vector<double>& controls) const {
  const auto state = bench_->states.find(controls);
  if (state == bench_->states.end()) return {};
  const PlacedRod& placed = *bench_->placed;
  const PlacedRod meshed = place_rod(bench_->experiment, bench_->division);  // dimensions as the file has them
  Eigen::VectorXd u(mesh.X.size());
  for (int i = 0; i < mesh.node_count(); ++i) {
    const Vector3d X = mesh.node(i), own = meshed.frame.transpose() * (X - meshed.origin);
    const RodPoint point{own[2], {own[0], own[1], 0}};
    u.segment<3>(3 * i) = placed.origin + placed.frame * placed.rod.position(state->second, point).value - X;
  }
  return u;
}

void RodProtocol::move_to(const Eigen::VectorXd& dimensions) {
  if (dimensions == bench_->lengths) return;
  bench_->placed.emplace(bench_->placed_at(dimensions));
  bench_->lengths = dimensions;
  for (Bench::Sides& sides : bench_->sides) sides = {};
}

Prediction RodProtocol::predict(const Params& p, const std::vector<int>& free) {
  Bench& bench = *bench_;
  const Eigen::Index columns = static_cast<Eigen::Index>(free.size());
  Prediction prediction;
  prediction.values = Eigen::VectorXd::Constant(row_count(), not_a_number);
  if (columns > 0) prediction.derivatives = MatrixXd::Constant(row_count(), columns, not_a_number);
  std::fill(errors_.begin(), errors_.end(), not_a_number);
  moved_ = errors_;
  std::map<std::vector<double>, Solved> solved;
  bench.states.clear();
  const auto state_at = [&](const std::vector<double>& controls) -> const Solved& {
    const auto [found, is_new] = solved.try_emplace(controls);
    if (!is_new) return found->second;
    Params here = p;
    for (size_t k = 0; k < controls.size(); ++k) here[bench.controls[k]] = controls[k];
    found->second = bench.solve(here, free, factorisations_);
    if (!found->second.problem.empty()) {
      prediction.failures.push_back(fmt::format("no equilibrium of the rod at {}: {}",
                                                described_controls(bench.table, bench.controls, controls),
                                                found->second.problem));
    }
    return found->second;
  };
  try {
    move_to(p.tail(p.size() - bench.own()));
    for (size_t r = 0; r < bench.rows.size(); ++r) {
      const StaticRow& row = bench.rows[r];
      const size_t index = static_cast<size_t>(row.channel);
      const RodChannel& channel = bench.placed->channels[index];
      const Solved& loaded = state_at(row.controls);
      if (!loaded.problem.empty()) continue;
      RowReading reading = bench.read_row(channel, index, loaded, free);
      double error = loaded.error;
      if (bench.experiment.from_unloaded) {
        const Solved& unloaded = state_at(std::vector<double>(row.controls.size(), 0.0));
        if (!unloaded.problem.empty()) continue;
        const RowReading before = bench.read_row(channel, index, unloaded, free);
        reading.value -= before.value;
        reading.moved -= before.moved;
        reading.slopes -= before.slopes;
        error = std::max(error, unloaded.error);
      }
      if (row.offset >= 0) reading.value += p[row.offset];
      const Eigen::Index to = static_cast<Eigen::Index>(r);
      prediction.values[to] = reading.value;
      errors_[r] = error;
      moved_[r] = reading.moved;
      if (columns > 0) prediction.derivatives.row(to) = reading.slopes;
      for (Eigen::Index c = 0; c < columns; ++c) {
        if (free[static_cast<size_t>(c)] == row.offset) prediction.derivatives(to, c) += 1;
      }
    }
    for (auto& [controls, one] : solved) {
      if (one.problem.empty()) bench.states[controls] = std::move(one.x);
    }
  } catch (const InputError& error) {  // dimensions that are none together cost this prediction
    prediction.values.setConstant(not_a_number);
    prediction.derivatives.setConstant(not_a_number);
    prediction.failures.assign(1, error.what());
  }
  return prediction;
}

RodBench make_rod_bench(const Experiment& experiment, const Trials& trials, const std::vector<Dimension>& dimensions) {
  check_rod(experiment);
  // Parameters, controls and offsets are those of the full model, on the coarsest mesh that has them all.
  Experiment full = experiment;
  full.model = Rung::full;
  full.channels.clear();
  for (CableSettings& cable : full.cables.cables) cable.line->pieces = 1;
  MeshSettings coarse;
  coarse.order = 1;
  coarse.cells = {1, 1, 1};
  if (experiment.geometry.kind() == "revolved") {
    coarse.cells.clear();
    coarse.counts = {{"layers", 1}, {"rings", 1}};
  }
  const BenchModel model = make_model(full, coarse, trials);

  RodBench bench;
  static_cast<BenchRows&>(bench) = rows_of_readings(experiment, model, trials);
  auto made = std::make_unique<RodProtocol::Bench>();
  made->experiment = experiment;
  made->dimensions = dimensions;
  made->table = model.scene.model->parameters();
  made->nominal = model.scene.values;
  made->rows = bench.rows;
  made->controls = model.controls;
  made->values = products_of(experiment, model, made->table);
  made->division = divided(experiment);
  made->placed.emplace(place_rod(experiment, made->division));
  for (const Dimension& dimension : dimensions) declare(dimension, made->table, made->nominal);
  made->sides.resize(dimensions.size());
  made->lengths = made->nominal.tail(static_cast<Eigen::Index>(dimensions.size()));
  made->step = 1e-5 * made->placed->rod.shape().length;
  bench.protocol = std::make_unique<RodProtocol>(std::move(made));
  return bench;
}

}  // namespace taut
