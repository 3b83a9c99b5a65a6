#include "calib/benches/static_replay.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "calib/benches/assumptions.hpp"
#include "sim/core/error.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/shapes/geometry.hpp"
#include "sim/terms/load.hpp"

namespace taut {

BenchRows rows_of_readings(const Experiment& experiment, const BenchModel& model, const Trials& trials) {
  BenchRows bench;
  const size_t offset_control =
      experiment.zero_offset_per.empty() ? 0 : position_of_control(experiment, experiment.zero_offset_per);
  std::vector<StaticRow>& rows = bench.rows;
  // The way to a row counts where cables rub.
  const auto order_of = [&](const Reading& reading) { return experiment.cables.rub ? reading.order : not_a_number; };
  const auto row_of = [&](const Reading& reading) {
    return std::find_if(rows.begin(), rows.end(), [&](const StaticRow& row) {
      const bool same = row.order == order_of(reading) || (std::isnan(row.order) && std::isnan(order_of(reading)));
      return same && row.channel == reading.channel && row.controls == reading.controls && row.turn == reading.turn;
    });
  };
  // Repeats: all alike but for their place in the history.
  const auto group_of = [&](const Reading& reading) {
    const auto found = std::find_if(rows.begin(), rows.end(), [&](const StaticRow& row) {
      return row.channel == reading.channel && row.controls == reading.controls &&
             row.turn.dwell == reading.turn.dwell && row.turn.rest == reading.turn.rest;
    });
    return static_cast<int>(found - rows.begin());
  };
  for (const Reading& reading : trials.readings) {
    bench.row_of_reading.push_back(-1);
    const bool remembered = reading.turn.place >= 0;  // what comes after it depends on it
    if (reading.excluded && !remembered) continue;
    const auto same = row_of(reading);
    const int row = bench.row_of_reading.back() = static_cast<int>(same - rows.begin());
    const auto offset = model.zero_offsets.empty() ? model.zero_offsets.end()
                                                   : model.zero_offsets.find(reading.controls[offset_control]);
    const int zero_offset = offset == model.zero_offsets.end() ? -1 : offset->second;
    if (same == rows.end())
      rows.push_back({reading.controls, reading.channel, zero_offset, order_of(reading), reading.turn});
    if (!reading.excluded) bench.measurements.push_back({row, reading.value, reading.sigma, group_of(reading)});
  }
  for (size_t i = 0; i < trials.readings.size(); ++i) {
    const auto same = row_of(trials.readings[i]);
    if (same != rows.end()) bench.row_of_reading[i] = static_cast<int>(same - rows.begin());
  }
  return bench;
}

namespace {

/// Which of the controls are set before the others: retractions.
std::vector<int> set_first(const Experiment& experiment) {
  std::vector<int> positions;
  for (size_t k = 0; k < experiment.bench.controls.size(); ++k) {
    if (experiment.cables.columns.count(experiment.bench.controls[k].id) > 0) positions.push_back(static_cast<int>(k));
  }
  return positions;
}

/// The position of the control that says which way a row was reached; -1: there is none.
int direction_of_rows(const Experiment& experiment) {
  const auto& controls = experiment.bench.controls;
  const auto found = std::ranges::find(controls, direction_control, &BenchFormat::Control::id);
  return found == controls.end() ? -1 : static_cast<int>(found - controls.begin());
}

/// An order of rows that says two things of one state, or another direction than the rows themselves.
void refuse_contradictions(const Experiment& experiment, const Trials& trials) {
  const int direction = direction_of_rows(experiment);
  const std::vector<int> first = set_first(experiment);
  const bool only_first = first.size() + (direction >= 0 ? 1 : 0) == experiment.bench.controls.size();
  const auto is_load = [&](size_t k) {
    return static_cast<int>(k) != direction &&
           (std::ranges::find(first, static_cast<int>(k)) == first.end()) != only_first;
  };
  const auto load_of = [&](const Reading& reading) {
    double sum = 0;
    for (size_t k = 0; k < reading.controls.size(); ++k) sum += is_load(k) ? std::abs(reading.controls[k]) : 0;
    return sum;
  };
  std::map<double, const Reading*> states;
  for (const Reading& reading : trials.readings) {
    if (reading.excluded || std::isnan(reading.order)) continue;
    const Reading& same = *states.emplace(reading.order, &reading).first->second;
    const auto differ = std::ranges::mismatch(same.controls, reading.controls).in1 - same.controls.begin();
    if (differ < std::ssize(same.controls))
      throw FileError(
          experiment.bench.path,
          fmt::format("lines {} and {}: both have the order {:.10g}, but not the same '{}'; a number stands for "
                      "one state: give each its own",
                      same.line, reading.line, reading.order,
                      experiment.bench.controls[static_cast<size_t>(differ)].id));
  }
  if (direction < 0) return;
  const Reading* before = nullptr;
  for (const auto& [order, reading] : states) {
    const bool goes_on =
        before != nullptr && std::ranges::all_of(first, [&](int k) {
          return only_first || before->controls[static_cast<size_t>(k)] == reading->controls[static_cast<size_t>(k)];
        });
    const double last = goes_on ? load_of(*before) : 0, load = load_of(*reading);
    const bool unloads = reading->controls[static_cast<size_t>(direction)] == 2;
    if (unloads ? load > last : load < last)
      throw FileError(
          experiment.bench.path,
          fmt::format(
              "line {}: it is '{}', but {} in the order of the rows its load is {}; correct the direction or the "
              "order",
              reading->line, unloads ? "unloading" : "loading",
              goes_on ? fmt::format("after line {}", before->line) : "after nothing was hung",
              unloads ? "larger" : "smaller"));
    before = reading;
  }
}

/// The plane section of a solid finds out where its conditions lie. Of no use to models that look back.
void guide_by_section(const Experiment& experiment, const MeshSettings& settings, const Trials& trials,
                      StaticProtocol& solid) {
  const bool has_section = experiment.geometry.dimension == 2 && settings.depth_cells > 0 && !experiment.geometry.mesh;
  if (!has_section || experiment.remembers() || experiment.contact.sticks || !solid.scene().states.empty()) return;
  MeshSettings section = settings;
  section.depth_cells = 0;
  std::unique_ptr<StaticProtocol> guide = make_static_replay(experiment, section, trials).protocol;
  const Mesh &plane = guide->scene().model->mesh(), &mesh = solid.scene().model->mesh();
  // Nodes of the solid lie above those of its section.
  std::map<std::array<double, 2>, int> below;
  for (int i = 0; i < plane.node_count(); ++i) below[{plane.node(i)[0], plane.node(i)[1]}] = i;
  std::vector<int> foot;
  for (int i = 0; i < mesh.node_count(); ++i) {
    const auto found = below.find({mesh.node(i)[0], mesh.node(i)[1]});
    if (found == below.end()) return;
    foot.push_back(found->second);
  }
  solid.follow_guide(std::move(guide), [foot = std::move(foot)](const Eigen::VectorXd& u) {
    Eigen::VectorXd swept = Eigen::VectorXd::Zero(3 * std::ssize(foot));
    for (Eigen::Index i = 0; i < std::ssize(foot); ++i)
      swept.segment<2>(3 * i) = u.segment<2>(2 * foot[static_cast<size_t>(i)]);
    return swept;
  });
}

}  // namespace

StaticReplay make_static_replay(const Experiment& experiment, const MeshSettings& settings, const Trials& trials) {
  refuse_contradictions(experiment, trials);
  BenchModel model = make_model(experiment, settings, trials);
  StaticReplay bench{rows_of_readings(experiment, model, trials),
                     nullptr,
                     model.cables,
                     model.contact,
                     model.smallest_distance,
                     model.touching.terms};
  StaticProtocol::Options options;
  options.equilibrium = experiment.equilibrium;
  options.threads = experiment.threads;
  options.from_unloaded = experiment.from_unloaded;
  options.history = experiment.remembers();
  options.set_first = set_first(experiment);
  options.direction = direction_of_rows(experiment);
  options.equilibrium.check_path = !options.set_first.empty();
  if (experiment.contact.sticks) options.sticks = model.contact;
  bench.protocol = std::make_unique<StaticProtocol>(std::move(model.scene), std::move(model.channels), model.controls,
                                                    model.off_at_rest, bench.rows, options);
  guide_by_section(experiment, settings, trials, *bench.protocol);
  return bench;
}

InputError unknown_parameter(const Experiment& experiment, const Protocol& protocol, const std::string& id) {
  std::vector<std::string> known = protocol.parameters().ids(), lengths;
  for (const Dimension& dimension : dimensions_of(experiment)) {
    if (!protocol.parameters().contains(dimension.spec.id)) lengths.push_back(dimension.spec.id);
  }
  const std::string of_model = join(known);
  known.insert(known.end(), lengths.begin(), lengths.end());
  return InputError(fmt::format("unknown parameter '{}'{}; the model has: {}{}", id, did_you_mean(id, known), of_model,
                                lengths.empty() ? "" : "; lengths that may be fitted: " + join(lengths)));
}

namespace {

/// A constant of a region that is rigid by the file's own wish changes nothing.
void refuse_rigid(const Experiment& experiment, const std::string& id) {
  if (experiment.model != Rung::rigid_segments) return;
  for (const std::string& region : rigid_regions(experiment)) {
    if (region_of(experiment, id) != region) continue;
    throw InputError(fmt::format(
        "model = \"rigid_segments\" takes '{}', over 100 times as stiff as the softest region, for rigid, so "
        "that no reading depends on {}; take this table out, or set model = \"full\"",
        region, id));
  }
}

}  // namespace

std::string region_of(const Experiment& experiment, const std::string& id) {
  for (const MaterialSettings& material : experiment.materials) {
    for (const auto& [spec, value] : region_parameters(material.region, material.law, material.constants)) {
      if (spec.id == id) return material.region;
    }
  }
  return "";
}

/// Bounds of what the file gives none for: of a modulus those of what it starts as, foams, gels and rubbers or plastics
/// and metals; else the physical range.
std::pair<double, double> usual_bounds(const ParameterSpec& spec, double start) {
  if (spec.symbol != "E") return {spec.lower, spec.upper};
  const auto [lower, upper] = start < 100e6 ? std::pair(100.0, 1e9) : std::pair(1e6, 1e12);
  return {std::min(lower, std::max(spec.lower, start / 100)), std::max(upper, std::min(spec.upper, start * 100))};
}

std::vector<FreeParameter> free_parameters(const Experiment& experiment, const Protocol& protocol) {
  std::vector<FreeParameter> free;
  for (const FreeSettings& settings : experiment.free) {
    at(experiment, fmt::format("[fit.free.{}]", settings.id), [&] {
      FreeParameter parameter;
      if (!protocol.parameters().contains(settings.id)) throw unknown_parameter(experiment, protocol, settings.id);
      parameter.index = protocol.parameters().index(settings.id);
      for (const BenchFormat::Control& control : experiment.bench.controls) {
        if (control.id == settings.id)
          throw InputError(
              fmt::format("'{}' is set by the bench, row by row, and cannot be fitted; free a parameter of the model",
                          settings.id));
      }
      refuse_rigid(experiment, settings.id);
      const ParameterSpec& spec = protocol.parameters()[parameter.index];
      auto given = [&](const std::optional<GivenValue>& value, double otherwise) {
        return value ? parse_quantity(value->text, quantity_of_si_unit(spec.unit), value->where) : otherwise;
      };
      parameter.start = given(settings.start, protocol.nominal()[parameter.index]);
      const auto [lower, upper] = usual_bounds(spec, parameter.start);
      parameter.lower = given(settings.lower, lower);
      parameter.upper = given(settings.upper, upper);
      parameter.bounds_chosen = settings.lower.has_value() && settings.upper.has_value();
      for (double value : {parameter.lower, parameter.start, parameter.upper})
        protocol.parameters().check(parameter.index, value);
      if (!(parameter.lower < parameter.upper))
        throw InputError(
            fmt::format("the lower bound {} must be less than the upper one, {}; exchange or widen the bounds",
                        with_unit(parameter.lower, spec.unit), with_unit(parameter.upper, spec.unit)));
      if (!(parameter.lower <= parameter.start && parameter.start <= parameter.upper)) {
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
