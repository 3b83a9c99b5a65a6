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
#include "sim/core/units.hpp"
#include "sim/materials/prony.hpp"
#include "sim/scene/contact_force.hpp"

namespace taut {
namespace {

/// Solved, and with success: where another model predicts, the full one's states are not there.
bool is_known(const StaticProtocol::Condition& condition) {
  return condition.report.status == SolveStatus::converged && condition.u.size() > 0;
}

std::string list_of(const std::vector<double>& values, std::string_view unit) {
  double size = 0;
  for (double value : values) size = std::max(size, std::abs(value));
  std::string text;
  for (double value : values) {
    const double shown = std::abs(value) < 1e-12 * size ? 0 : value;  // zero but for rounding
    text += fmt::format("{}{}", text.empty() ? "" : ", ", with_unit(shown, unit));
  }
  return text;
}

std::string geometry_text(const GeometrySettings& geometry) {
  std::string text = geometry.kind();
  if (const std::vector<double> extent = geometry.shape->extent(); !extent.empty())
    text += " of " + list_of(extent, "m");
  if (geometry.dimension == 2)
    text += fmt::format(", plane {}, {} thick", geometry.plane == Plane::strain ? "strain" : "stress",
                        with_unit(geometry.thickness, "m"));
  std::vector<std::string> planes;
  for (const SymmetryPlane& plane : geometry.shape->symmetry()) planes.push_back(plane.tag);
  if (!planes.empty()) text += fmt::format(", the part of it that ends at {}", join(planes, " and "));
  return text;
}

std::string support_text(const SupportSettings& support) {
  std::string text;
  for (int component : support.fix) text += fmt::format("{}{}", text.empty() ? "fixed in " : ", ", "xyz"[component]);
  if (support.rotation_stiffness)
    text += fmt::format("elastic, rotation stiffness {}", with_unit(*support.rotation_stiffness, "Nm/rad"));
  if (!support.control.empty())
    text +=
        fmt::format("{}moved in {} by column '{}'", text.empty() ? "" : "; ", "xyz"[support.component], support.column);
  return text;
}

std::string channel_text(const ChannelSettings& channel) {
  const std::string what(channel.kind->name);
  const bool place = channel.kind->on == ChannelKind::On::place;
  if (channel.foot) {
    const std::string text = fmt::format("{} of marker {} at {}", what, channel.marker, with_unit(*channel.foot, "m"));
    return channel.standoff.empty() ? text : text + fmt::format(", {} off the axis", list_of(channel.standoff, "m"));
  }
  std::string text = channel.on.empty() ? what + " of point (" + list_of(channel.point, "m") + ")"
                                        : (place ? "mean " : "") + what + " of " + channel.on;
  if (!channel.standoff.empty())
    text += fmt::format(", marker {} off it, turning with {}", list_of(channel.standoff, "m"), channel.turns_with);
  return text;
}

/// How the body stands; "": as its geometry has it.
std::string base_text(const Experiment& experiment) {
  std::string text;
  if (!experiment.base_turn.empty()) {
    for (double angle : experiment.base_turn)
      text += fmt::format("{}{:.4g} deg", text.empty() ? "turned by " : ", ", angle * 180 / M_PI);
    if (experiment.base_turn.size() == 3) text += " about x, y, z";
  }
  if (!experiment.base_at.empty())
    text += fmt::format("{}its origin at {}", text.empty() ? "" : "; ", list_of(experiment.base_at, "m"));
  return text;
}

/// "from 0 m to 305 mm along the axis, 11.4 mm off it, 2.4 mm at its end, at 60 deg".
std::string line_text(const EyeletLine& line) {
  std::string text = fmt::format("from {} to {} along the axis, {} off it", with_unit(line.start, "m"),
                                 with_unit(line.end, "m"), with_unit(line.offset, "m"));
  if (line.end_offset != line.offset) text += fmt::format(", {} at its end", with_unit(line.end_offset, "m"));
  return text + fmt::format(", at {:.4g} deg", line.angle * 180 / M_PI);
}

/// `model` in words.
std::string rung_text(const Experiment& experiment) {
  const std::string name = fmt::format("\"{}\"", name_of(experiment.model));
  switch (experiment.model) {
    case Rung::beam:
      return name + ": a chain of Timoshenko beams";
    case Rung::rod:
      return name + ": a Cosserat rod with " +
             (experiment.rod_section == SectionLaw::linear ? "linear" : "neo-Hookean") + " sections";
    case Rung::rigid_segments:
      return name + ": finite elements, in which " + join(rigid_regions(experiment), " and ") + " cannot deform";
    case Rung::full:
      return name + ": finite elements, in which all deforms";
    case Rung::solid:
      return name + fmt::format(": the section as a solid, {} layers of elements across half of its thickness",
                                experiment.mesh.depth_cells);
    case Rung::automatic:
      return name + fmt::format(": row by row the cheapest that is within {:.2g} %, chosen when the fit begins",
                                100 * experiment.tolerance);
  }
  return name;
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

/// The supports that hold what `gradient` weighs, as "on 'xmin'"; empty where it moves freely, or is moved.
std::vector<std::string> StaticBench::held_by(const Eigen::VectorXd& gradient) const {
  const Model& whole = *model().scene().model;
  const double all = gradient.norm();
  if (all == 0 || whole.restrict_to_free(gradient).norm() > 1e-9 * all) return {};
  for (const int control : replay().protocol->controls()) {
    if (whole.support_derivative(control).cwiseProduct(gradient).cwiseAbs().maxCoeff() > 1e-9 * all) return {};
  }
  std::vector<std::string> found;
  for (const SupportSettings& support : experiment_.supports) {
    const std::vector<int> nodes = whole.mesh().select(support.on).nodes();
    const bool holds = std::ranges::any_of(nodes, [&](int node) {
      return std::ranges::any_of(support.fix,
                                 [&](int c) { return gradient[node * whole.mesh().dimension() + c] != 0; });
    });
    if (holds) found.push_back(fmt::format("on '{}'", support.on));
  }
  return found;
}

/// Channels that read 0 whatever happens: no parameter follows from them.
void StaticBench::refuse_held_channels() const {
  const StaticProtocol& protocol = model();
  const Point rest{Eigen::VectorXd::Zero(protocol.scene().model->mesh().X.size()), protocol.nominal()};
  for (size_t k = 0; k < experiment_.channels.size(); ++k) {
    const ChannelSettings& settings = experiment_.channels[k];
    if (settings.kind->on != ChannelKind::On::place) continue;
    const std::vector<std::string> supports = held_by(protocol.channels()[k].channel->gradient(rest));
    if (supports.empty()) continue;
    throw FileError(experiment_.path,
                    fmt::format("[[channel]] '{}': the {} never changes, since the support {} fixes it there; measure "
                                "where the specimen moves, or take that component out of the support's 'fix'",
                                settings.id, channel_text(settings), join(supports, " and ")));
  }
}

/// Loads that go into supports whole.
std::vector<std::string> StaticBench::held_loads() const {
  const StaticProtocol& protocol = model();
  const Model& whole = *protocol.scene().model;
  Point rest{Eigen::VectorXd::Zero(whole.mesh().X.size()), protocol.nominal()};
  std::vector<std::string> found;
  for (const LoadSettings& load : experiment_.loads) {
    const std::vector<std::string> supports =
        held_by(whole.parameter_gradient(rest, protocol.parameters().index(load.id)));
    if (!supports.empty())
      found.push_back(
          fmt::format("[[load]] '{}' strains nothing: the support {} fixes all that it pulls at along its direction; "
                      "is it on the right face?",
                      load.id, join(supports, " and ")));
  }
  return found;
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

Lines StaticBench::load_lines() const {
  Lines lines;
  if (!experiment_.gravity_direction.empty())
    lines.emplace_back("self-weight", fmt::format("g = {}", with_unit(experiment_.gravity, "m/s2", 6)));
  for (const LoadSettings& load : experiment_.loads) {
    const std::string place = load.on.empty() ? "point (" + list_of(load.point, "m") + ")" : load.on;
    lines.emplace_back("load " + load.id,
                       fmt::format("{} on {}, {}", name_of(load.quantity), place,
                                   load.column.empty() ? "constant " + fmt::format("{:.6g} (SI)", load.value)
                                                       : "column '" + load.column + "'"));
  }
  return lines;
}

std::string StaticBench::cables_text() const {
  const ParameterTable& table = model().parameters();
  const Params& nominal = model().nominal();
  std::string text;
  for (const CableSettings& cable : experiment_.cables.cables) text += (text.empty() ? "" : ", ") + cable.id;
  const auto law = [&](const std::string& k, const std::string& slack) {
    return fmt::format("k = {}, slack = {}", with_unit(nominal[table.index(k)], "N/m"),
                       with_unit(nominal[table.index(slack)], "m"));
  };
  if (table.contains("k_cable")) text += "; " + law("k_cable", "slack");
  for (const CableSettings& cable : experiment_.cables.cables) {
    if (cable.own) text += fmt::format("; {}: {}", cable.id, law("k_" + cable.id, "slack_" + cable.id));
    if (cable.held && cable.control.empty())
      text += fmt::format("; {} held at {}", cable.id, with_unit(cable.tension, "N"));
    if (cable.held && !cable.control.empty())
      text += fmt::format("; {} pulled by column '{}'", cable.id, experiment_.cables.tension_columns.at(cable.control));
    if (cable.spool > 0) text += fmt::format(" on a spool of radius {}", with_unit(cable.spool, "m"));
    if (cable.line) text += ", " + line_text(*cable.line);
  }
  if (experiment_.cables.rub)
    text += fmt::format("; friction {:.4g} at their eyelets", nominal[table.index("cable_friction")]);
  for (const auto& [id, column] : experiment_.cables.columns)
    text += fmt::format("; retracted by column '{}', before the loads", column);
  return text;
}

std::string StaticBench::contact_text() const {
  const ParameterTable& table = model().parameters();
  const Params& nominal = model().nominal();
  std::string text = fmt::format("sets in at {}", with_unit(nominal[table.index("contact_gap")], "m"));
  for (const std::string& region : model().scene().model->mesh().region_names) {
    text += fmt::format(", {} {}", region,
                        with_unit(nominal[table.index("contact_pressure_" + region)],
                                  experiment_.contact.form == ContactForm::length_weighted ? "Pa" : "N/m"));
  }
  if (experiment_.geometry.shape->defaults().contact)
    text += experiment_.contact.compensate ? "; lips shortened by the distance at which they rest"
                                           : "; stand-off not compensated";
  if (experiment_.contact.bracketed) text += "; friction bracketed after the fit";
  return text;
}

std::string StaticBench::studs_text() const {
  const StudsSettings& all = experiment_.studs;
  std::string text;
  for (const StudSettings& stud : all.studs) {
    text += fmt::format("{}{}: play of {} to either side, then {}", text.empty() ? "" : "; ", stud.id,
                        with_unit(stud.clearance ? *stud.clearance : *all.clearance, "m"),
                        with_unit(stud.stiffness ? *stud.stiffness : *all.stiffness, "N/m"));
  }
  return text;
}

std::string StaticBench::times_text() const {
  const BenchFormat::History& history = experiment_.bench.history;
  if (history.counts) {
    double longest_dwell = 0, longest_rest = 0;
    for (const BenchReading& reading : readings_) {
      longest_dwell = std::max(longest_dwell, reading.turn.dwell);
      longest_rest = std::max(longest_rest, reading.turn.rest);
    }
    return fmt::format("rows are replayed one after the other; dwells up to {}, median {}; rests up to {}",
                       with_unit(longest_dwell, "s"), with_unit(trials_.typical_dwell, "s"),
                       with_unit(longest_rest, "s"));
  }
  if (!history.time_column.empty() || !history.dwell_column.empty() || history.dwell)
    return "noted, and without effect, since nothing relaxes here ([materials.REGION] prony)";
  constexpr double g = 0.2, first = 10, second = 60;
  return fmt::format(
      "not noted; should a share of {} of the stiffness relax, dwells of {:.0f} and {:.0f} s may differ by {:.0f} %: "
      "note the time ([bench] dwell)",
      g, first, second, 100 * largest_creep_between(g, first, second));
}

Lines StaticBench::describe() const {
  const Experiment& e = experiment_;
  const Mesh& mesh = model().scene().model->mesh();
  Lines lines{{"data", e.simulated ? "simulated" : "measured"}, {"geometry", geometry_text(e.geometry)}};
  if (choice_.text.empty())
    lines.emplace_back("mesh", fmt::format("{}: {} nodes, {} elements, {} unknowns", e.mesh.describe(),
                                           mesh.node_count(), mesh.element_count(), unknowns()));
  lines.emplace_back("model",
                     rung_text(e) + (choice_.unknowns > 0 ? fmt::format(", {} unknowns", choice_.unknowns) : ""));
  if (!e.geometry.left_out.empty())
    lines.emplace_back("not in the file", "dimensions as the kind has them: " + join(e.geometry.left_out));
  add_material_lines(e, lines);
  for (const SupportSettings& support : e.supports) lines.emplace_back("support " + support.on, support_text(support));
  for (auto& line : load_lines()) lines.push_back(std::move(line));
  if (!e.cables.cables.empty()) lines.emplace_back("cables", cables_text());
  if (!e.studs.studs.empty()) lines.emplace_back("studs", studs_text());
  if (const std::string base = base_text(e); !base.empty()) lines.emplace_back("base", base);
  if (e.contact.on) lines.emplace_back("contact", contact_text());
  for (const ChannelSettings& channel : e.channels) lines.emplace_back("channel " + channel.id, channel_text(channel));
  lines.emplace_back("measured from", e.from_unloaded ? "the unloaded equilibrium" : "the rest shape");
  lines.emplace_back("times", times_text());
  for (const std::string& remark : trials_.remarks) lines.emplace_back("bench", remark);
  if (!trials_.layout.empty()) lines.emplace_back("bench file", trials_.layout);
  return lines;
}

std::vector<std::string> StaticBench::warnings_before() const {
  std::vector<std::string> warnings = model().scene().model->mesh().remarks;
  for (std::string& load : held_loads()) warnings.push_back(std::move(load));
  const Experiment& e = experiment_;
  const bool may_lock =
      e.mesh.formulation == Formulation::standard && !(e.geometry.dimension == 2 && e.geometry.plane == Plane::stress);
  for (const MaterialSettings& material : e.materials) {
    const auto nu = material.constants.find("nu");
    if (nu == material.constants.end() || !(nu->second > 0.45) || !may_lock) continue;
    warnings.push_back(
        fmt::format("{}: nu = {} with {} elements locks: the model is too stiff and a fitted modulus too small; set "
                    "formulation = \"locking_free\" with quadratic elements",
                    material.region, nu->second, e.mesh.order == 1 ? "linear" : "plain quadratic"));
  }
  const std::vector<std::string>& left_out = e.geometry.left_out;
  if (!e.cables.cables.empty() && std::ranges::find(left_out, "via_inset") != left_out.end())
    warnings.emplace_back(
        "[geometry] via_inset is not given, and sets how stiff the closed module is (from 0.25 to 3 mm by a factor of "
        "ten): measure how far inside the lips' ends the cables are guided, and write it down");
  if (e.mesh.order == 1)
    warnings.emplace_back(
        "linear elements bend too stiffly: a fitted modulus is too small by some per cent; compare with element = "
        "\"quadratic\"");
  return warnings;
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
