#include "calib/benches/static_bench.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "calib/benches/assumptions.hpp"
#include "calib/benches/model.hpp"
#include "calib/benches/specimens_bench.hpp"
#include "sim/core/error.hpp"
#include "sim/core/stopwatch.hpp"
#include "sim/scene/contact_force.hpp"

namespace taut {
namespace {

/// Solved, and with success: where another model predicts, the full one's states are not there.
bool is_known(const StaticProtocol::Condition& condition) {
  return condition.report.status == SolveStatus::converged && condition.u.size() > 0;
}

/// The experiment whose mesh is that of its solid, where it asks for one.
Experiment with_own_mesh(Experiment experiment) {
  if (experiment.model == Rung::solid) experiment.mesh = deepened(experiment, experiment.mesh);
  return experiment;
}

}  // namespace

constinit const BenchKind static_kind{.name = "readings",
                                      .about = "readings at rest",
                                      .at_rest = true,
                                      .read = read_readings,
                                      .open = [](Experiment experiment) -> std::unique_ptr<Bench> {
                                        Trials trials = read_trials(experiment.bench);
                                        return open_static_bench(std::move(experiment), std::move(trials));
                                      }};

StaticBench::StaticBench(Experiment experiment, Trials trials)
    : Bench(with_own_mesh(std::move(experiment))),
      trials_(std::move(trials)),
      protocol_(std::make_unique<DimensionedProtocol>(experiment_, trials_, free_dimensions(experiment_))),
      model_text_(experiment_.mesh.describe()) {
  // Tolerances that mean nothing are wrong input, whatever is done with the bench.
  assumptions_of(experiment_, protocol_->parameters(), protocol_->nominal(), dimensions_of(experiment_));
  for (const std::string& why : protocol_->left_out()) throw FileError(experiment_.path, "[fit.free] " + why);
  for (const VariantSettings& variant : experiment_.variants) check_free(variant);
  refuse_held_channels();
  find_axes();
  find_readings();
}

/// What a variant frees has to be there, long before its turn.
void StaticBench::check_free(const VariantSettings& variant) const {
  const std::vector<Dimension> dimensions = dimensions_of(experiment_);
  for (const FreeSettings& settings : variant.free) {
    const std::string& id = settings.id;
    if (!protocol_->parameters().contains(id) &&
        std::ranges::find(dimensions, id, [](const Dimension& one) { return one.spec.id; }) == dimensions.end())
      throw FileError(experiment_.path, fmt::format("[[fit.variant]] '{}' free: {}", variant.name,
                                                    unknown_parameter(experiment_, *protocol_, id).what()));
  }
}

void StaticBench::use(const CheaperModels& models) {
  models_ = models;
  choice_ = models.choose(experiment_, trials_, replay(), protocol_->dimensions());
  if (!choice_.text.empty()) model_text_ = choice_.text;
  if (choice_.protocol && choice_.dimensions.size() < protocol_->dimensions().size())
    throw FileError(experiment_.path, fmt::format("[fit.free.{}]: a dimension is fitted by the full model or a rod "
                                                  "alone; leave 'model' out",
                                                  protocol_->dimensions().front().spec.id));
}

DimensionedModel StaticBench::with_dimensions() const {
  return with_dimensions(dimensions_of(experiment_));
}

DimensionedModel StaticBench::with_dimensions(const std::vector<Dimension>& dimensions) const {
  if (choice_.protocol && choice_.one_model) {
    ModelChoice all = models_.choose(experiment_, trials_, replay(), dimensions);
    if (!all.dimensions.empty()) {
      DimensionedModel model;
      static_cast<BenchRows&>(model) = replay();
      model.protocol = std::move(all.protocol);
      model.dimensions = std::move(all.dimensions);
      return model;
    }
  }
  Experiment full = experiment_;
  if (choice_.protocol) full.model = Rung::full;
  return full_model(full, trials_, dimensions);
}

/// Cheaper models have the dimensions of the file.
std::vector<FreeParameter> StaticBench::better_starts(const std::vector<FreeParameter>& free) const {
  const auto first_dimension =
      std::ranges::find_if(free, [&](const FreeParameter& one) { return one.index >= model().parameters().size(); });
  if (!models_.starts || first_dimension != free.end() || experiment_.remembers()) return free;
  return models_.starts(experiment_, trials_, free);
}

void StaticBench::find_axes() {
  size_t most = 0;
  for (size_t k = 0; k < trials_.control_ids.size(); ++k) {
    const Quantity quantity = trials_.control_quantities[k];
    controls_.push_back(make_axis(trials_.control_ids[k], quantity, trials_.control_ids[k]));
    controls_.back().labels = experiment_.bench.controls[k].labels;
    if (quantity == Quantity::length || !experiment_.bench.controls[k].labels.empty()) continue;
    std::set<double> values;
    for (const Reading& reading : trials_.readings) values.insert(reading.controls[k]);
    if (values.size() <= most) continue;
    most = values.size();
    drawn_control_ = static_cast<int>(k);
    drawn_label_ = trials_.control_ids[k] + (quantity == Quantity::mass ? " × g" : "");
  }
  if (drawn_control_ < 0) drawn_label_ = "load";
  for (const ChannelSettings& channel : experiment_.channels) channels_.push_back(make_axis(channel));
}

void StaticBench::find_readings() {
  for (size_t i = 0; i < trials_.readings.size(); ++i) {
    const Reading& from = trials_.readings[i];
    BenchReading& reading = readings_.emplace_back(BenchReading{from, replay().row_of_reading[i], {}, {}});
    const size_t k = static_cast<size_t>(std::max(drawn_control_, 0));
    reading.load_newtons = drawn_control_ < 0 ? 0.0 : as_force(k, from.controls[k]);
  }
  for (BenchReading& reading : readings_) reading.series = series_of(reading.controls);
  measurements_ = replay().measurements;
}

double StaticBench::as_force(size_t control, double value) const {
  return load_in_newtons(experiment_, trials_.control_quantities[control], value);
}

std::vector<double> StaticBench::values_of(size_t control) const {
  const std::set<double>& values = trials_.control_values[control];
  return {values.begin(), values.end()};
}

/// What is held besides the load, as a label; "" when nothing else varies.
std::string StaticBench::series_of(const std::vector<double>& controls) const {
  std::string text;
  for (size_t k = 0; k < controls.size(); ++k) {
    if (static_cast<int>(k) == drawn_control_ || Bench::values_of(k).size() <= 1) continue;
    text += fmt::format("{}{} {}", text.empty() ? "" : ", ", controls_[k].id, control_text(k, controls[k]));
  }
  return text;
}

std::string StaticBench::describe_controls(const std::vector<double>& controls) const {
  if (controls.empty()) return "no load";
  std::string text;
  for (size_t k = 0; k < controls.size(); ++k) text += (k == 0 ? "" : ", ") + describe_control(k, controls[k]);
  return text;
}

/// At every measured load, where curve and readings are compared, and in even steps between them.
std::vector<double> StaticBench::curve_loads() const {
  std::set<double> loads{0.0};
  for (const BenchReading& reading : readings_) loads.insert(reading.controls[static_cast<size_t>(drawn_control_)]);
  const double lowest = *loads.begin(), highest = *loads.rbegin(), step = (highest - lowest) / 10;
  if (loads.size() > 20) loads = {lowest, highest};
  const std::set<double> measured = loads;
  for (int i = 1; i < 10; ++i) {
    const double value = lowest + step * i;
    const bool near = std::any_of(measured.begin(), measured.end(),
                                  [&](double load_there) { return std::abs(load_there - value) < 0.4 * step; });
    if (!near) loads.insert(value);
  }
  return {loads.begin(), loads.end()};
}

std::vector<CurveRecord> StaticBench::curves(const Params& p, const std::vector<FreeParameter>& free,
                                             const Eigen::MatrixXd& covariance, const Ask& ask) const {
  if (drawn_control_ < 0) return {};
  const std::vector<double> loads = curve_loads();
  std::map<std::string, std::vector<double>> held;  // series to controls
  for (const BenchReading& reading : readings_) held.try_emplace(reading.series, reading.controls);
  Trials grid = trials_;
  grid.readings.clear();
  std::vector<CurveRecord> curves;
  for (const auto& [series, controls] : held) {
    for (size_t channel = 0; channel < channels_.size(); ++channel) {
      CurveRecord& curve = curves.emplace_back();
      curve.channel = channels_[channel].id;
      curve.series = series;
      for (double value : loads) {
        Reading& reading = grid.readings.emplace_back();
        reading.controls = controls;
        reading.controls[static_cast<size_t>(drawn_control_)] = value;
        reading.channel = static_cast<int>(channel);
        reading.sigma = 1;
        reading.turn.dwell = trials_.typical_dwell;
        curve.load.push_back(as_force(static_cast<size_t>(drawn_control_), value));
      }
    }
  }
  StaticBench there(experiment_, std::move(grid));
  if (models_.choose) there.use(models_);
  Protocol& protocol = there.protocol();
  const std::vector<BenchReading>& readings = there.readings();
  const ParameterTable& table = protocol.parameters();
  const Prediction prediction = ask(protocol, p, indices_of(free));
  const Eigen::VectorXd se = standard_errors(prediction, table, p, free, covariance);
  // Increments from the start of the curve are known better than the values: errors of the parameters move both.
  Prediction increments = prediction;
  for (size_t reading = 0; reading < readings.size() && prediction.derivatives.size() > 0; ++reading) {
    const int row = readings[reading].row, start = readings[reading - reading % loads.size()].row;
    increments.derivatives.row(row) = prediction.derivatives.row(row) - prediction.derivatives.row(start);
  }
  const Eigen::VectorXd increment_se = standard_errors(increments, table, p, free, covariance);
  size_t reading = 0;
  for (CurveRecord& curve : curves) {
    for (size_t i = 0; i < loads.size(); ++i, ++reading) {
      const int row = readings[reading].row;
      curve.value.push_back(prediction.values[row]);
      curve.se.push_back(se[row]);
      if (loads.front() == 0) curve.increment_se.push_back(increment_se[row]);
    }
  }
  return curves;
}

Experiment changed_by(Experiment changed, const VariantSettings& variant) {
  changed.mesh = variant.mesh;
  for (const auto& [name, law] : section_laws()) {
    if (name == variant.law) changed.rod_section = law;
  }
  changed.free.insert(changed.free.end(), variant.free.begin(), variant.free.end());
  changed.variants.clear();
  std::vector<std::string> ids;
  for (const FreeSettings& free : variant.free) ids.push_back(free.id);
  if (!ids.empty()) drop_tolerances(changed, ids);
  return changed;
}

std::unique_ptr<Bench> StaticBench::with(const VariantSettings& variant) const {
  auto bench = std::make_unique<StaticBench>(changed_by(experiment_, variant), trials_);
  bench->model_text_ = variant.mesh.describe();
  if (models_.choose) bench->use(models_);
  return bench;
}

Trials trials_at(Trials trials, size_t control, double held) {
  for (Reading& reading : trials.readings)
    reading.excluded |= reading.turn.place >= 0 && reading.controls[control] != held;
  std::erase_if(trials.readings,
                [&](const Reading& reading) { return reading.turn.place < 0 && reading.controls[control] != held; });
  return trials;
}

Trials trials_at_rows(const Experiment& experiment, Trials there, const std::vector<LoadRow>& rows) {
  there.readings.clear();
  for (const LoadRow& row : rows) {
    for (size_t channel = 0; channel < experiment.channels.size(); ++channel) {
      Reading& reading = there.readings.emplace_back();
      reading.line = row.line;
      reading.controls = row.controls;
      reading.channel = static_cast<int>(channel);
      reading.turn.dwell = row.dwell.value_or(there.typical_dwell);
    }
  }
  return there;
}

std::unique_ptr<Bench> StaticBench::part(size_t control, double held) const {
  auto bench = std::make_unique<StaticBench>(experiment_, trials_at(trials_, control, held));
  if (models_.choose) bench->use(models_);
  return bench;
}

std::unique_ptr<Bench> StaticBench::at_rows(const std::vector<LoadRow>& rows) const {
  auto bench = std::make_unique<StaticBench>(experiment_, trials_at_rows(experiment_, trials_, rows));
  if (models_.choose) bench->use(models_);  // which model a load needs is asked anew
  return bench;
}

std::string StaticBench::size_text() const {
  return fmt::format("{} readings in {} conditions with {} unknowns", measurements_.size(), model().conditions().size(),
                     unknowns());
}

std::string StaticBench::effort() const {
  if (choice_.protocol) return fmt::format("{} factorisations", choice_.protocol->factorisations());
  return fmt::format("{} Newton iterations, {} factorisations", protocol_->newton_iterations(),
                     protocol_->factorisations());
}

/// Rows whose equilibrium is one of two alike, by the side that was taken.
std::vector<std::string> StaticBench::sides_taken() const {
  std::map<std::string, std::set<int>> lines;
  for (const StaticProtocol::Condition& condition : model().conditions()) {
    if (condition.report.side.empty() || condition.report.status != SolveStatus::converged) continue;
    for (const BenchReading& reading : readings_) {
      if (std::ranges::count(condition.rows, reading.row) > 0) lines[condition.report.side].insert(reading.line);
    }
  }
  std::vector<std::string> warnings;
  for (const auto& [side, of_side] : lines) {
    std::vector<std::string> names;
    for (int line : of_side) names.push_back(std::to_string(line));
    warnings.push_back(
        fmt::format("row{} of line{} {}: symmetric bifurcation; the side was chosen by a fixed rule, towards {} in all "
                    "of them, and the specimen may have gone to the other one, where what is read across has the other "
                    "sign: compare the readings' signs, or add a small load towards its side",
                    names.size() == 1 ? "" : "s", names.size() == 1 ? "" : "s", join(names), side));
  }
  return warnings;
}

std::vector<std::string> StaticBench::warnings_after() const {
  std::vector<std::string> warnings = sides_taken();
  for (const StaticProtocol::Condition& condition : model().conditions()) {
    if (!is_known(condition)) continue;
    const std::string where = model().describe(condition);
    if (condition.report.left_saddle && condition.report.side.empty())
      warnings.push_back(
          fmt::format("at {} the straight path became unstable (buckling); the equilibrium on the side of "
                      "lower energy was taken",
                      where));
    if (condition.report.slipped)
      warnings.push_back(
          fmt::format("at {} the path slipped to another equilibrium, {:.3g} % of the way from the state "
                      "before: several exist there, and the specimen may be in another one; leave this row out or hang "
                      "smaller loads",
                      where, 100 * condition.report.slipped_after));
    if (condition.smallest_jacobian <= 0)
      warnings.push_back(
          fmt::format("at {} an element has folded between its quadrature points (smallest J = {:.2g}): do "
                      "not trust the state near it; refine there or lower the load",
                      where, condition.smallest_jacobian));
  }
  return warnings;
}

std::string StaticBench::compare_models(const Params& p, const Eigen::VectorXd& values, double seconds) const {
  if (!choice_.protocol) return "";
  std::string doubt = choice_.doubt ? choice_.doubt() : "";
  if (!choice_.compared) return fmt::format("a replay takes {:.2g} s{}", seconds, doubt);
  const Stopwatch watch;
  protocol_->forget();
  const Prediction full = protocol_->predict(p, {});
  const double took = watch.seconds();
  double largest = 0;
  for (Eigen::Index r = 0; r < values.size(); ++r) {
    if (full.values[r] != 0 && std::isfinite(full.values[r] + values[r]))
      largest = std::max(largest, std::abs(values[r] / full.values[r] - 1));
  }
  const auto failed = std::count_if(values.begin(), values.end(), [](double value) { return !std::isfinite(value); });
  if (failed > 0) doubt += fmt::format("; {} rows have no equilibrium", failed);
  return fmt::format(
      "a replay by the chosen models takes {:.2g} s, by the full one {:.2g} s; they differ by at most {:.2g} %{}",
      seconds, took, 100 * largest, doubt);
}

SolvedStates StaticBench::states() const {
  SolvedStates all;
  all.mesh = &model().scene().model->mesh();
  all.cables = replay().cables;
  if (!experiment_.gravity_direction.empty())
    all.down = experiment_.gravity_direction;
  else if (!experiment_.loads.empty())
    all.down = experiment_.loads.front().direction;
  // What is held first, the load second: states next to each other in the figures.
  std::vector<const StaticProtocol::Condition*> solved;
  for (const StaticProtocol::Condition& condition : model().conditions()) {
    if (choice_.state ? choice_.state(condition.controls).size() > 0 : is_known(condition))
      solved.push_back(&condition);
  }
  const auto held_then_load = [&](const StaticProtocol::Condition* one, const StaticProtocol::Condition* other) {
    std::vector<double> a = one->controls, b = other->controls;
    if (drawn_control_ >= 0) {
      std::rotate(a.begin() + drawn_control_, a.begin() + drawn_control_ + 1, a.end());
      std::rotate(b.begin() + drawn_control_, b.begin() + drawn_control_ + 1, b.end());
    }
    return a < b;
  };
  std::stable_sort(solved.begin(), solved.end(), held_then_load);
  for (const StaticProtocol::Condition* condition : solved) {
    SolvedState& state = all.states.emplace_back();
    state.label = describe_controls(condition->controls);
    state.controls = condition->controls;
    state.row = series_of(condition->controls);
    if (drawn_control_ >= 0) {
      const size_t k = static_cast<size_t>(drawn_control_);
      state.column = controls_[k].id + " " + control_text(k, condition->controls[k]);
    }
    state.u = choice_.state ? choice_.state(condition->controls) : condition->u;
    if (!choice_.state && !replay().touching.empty())
      state.contact = contact_forces(*all.mesh, replay().touching, {condition->u, condition->p});
  }
  return all;
}

std::vector<CableState> StaticBench::cable_states() const {
  std::vector<CableState> states;
  const StaticProtocol& protocol = model();
  const Mesh& mesh = protocol.scene().model->mesh();
  for (size_t c = 0; c < replay().cables.size(); ++c) {
    const auto tension = make_cable_tension(mesh, replay().cables[c]);
    const auto length = make_cable_length(mesh, replay().cables[c]);
    for (const StaticProtocol::Condition& condition : protocol.conditions()) {
      if (!is_known(condition)) continue;
      const Point at{condition.u, condition.p};
      states.push_back(
          {protocol.describe(condition), experiment_.cables.cables[c].id, tension->value(at), length->value(at)});
    }
  }
  return states;
}

}  // namespace taut
