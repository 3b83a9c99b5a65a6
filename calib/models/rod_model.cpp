#include "calib/models/rod_model.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>

#include "calib/models/placed_rod.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/units.hpp"
#include "sim/scene/channel_kinds.hpp"

namespace taut {
namespace {

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

/// An equilibrium with its sensitivities.
struct Solved {
  std::string problem;  ///< why it was not reached; "": it was
  RodState x;
  MatrixXd dx;       ///< by the free parameters
  double error = 0;  ///< what the rod states
};

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

std::vector<double> nodes_of(const Division& division, const Experiment& experiment) {
  const double length = experiment.geometry.shape->axis()->length;
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

PlacedRod placed_rod(const Experiment& experiment, const Division& division) {
  experiment.geometry.shape->check();
  return place_rod(experiment, nodes_of(division, experiment));
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

/// "tension_1 = 6.154 N, tension_2 = 0 N".
std::string described_controls(const ParameterTable& table, const std::vector<int>& controls,
                               const std::vector<double>& values) {
  std::vector<std::string> texts;
  for (size_t k = 0; k < controls.size(); ++k)
    texts.push_back(fmt::format("{} = {}", table[controls[k]].id, with_unit(values[k], table[controls[k]].unit)));
  return join(texts);
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
  return placed_rod(moved, division);
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
  const PlacedRod meshed = placed_rod(bench_->experiment, bench_->division);  // dimensions as the file has them
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
  made->placed.emplace(placed_rod(experiment, made->division));
  for (const Dimension& dimension : dimensions) declare(dimension, made->table, made->nominal);
  made->sides.resize(dimensions.size());
  made->lengths = made->nominal.tail(static_cast<Eigen::Index>(dimensions.size()));
  made->step = 1e-5 * made->placed->rod.shape().length;
  bench.protocol = std::make_unique<RodProtocol>(std::move(made));
  return bench;
}

}  // namespace taut
