#include "calib/benches/specimens.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <map>
#include <numeric>
#include <set>

#include "calib/fit/bytes.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

/// The positions among the controls of those that say what the specimen is.
std::vector<size_t> specimen_controls(const Experiment& experiment) {
  std::vector<size_t> positions;
  for (size_t k = 0; k < experiment.bench.controls.size(); ++k) {
    const std::string& id = experiment.bench.controls[k].id;
    if (id == experiment.specimen_control || experiment.set_by.contains(id)) positions.push_back(k);
  }
  return positions;
}

/// What a control's value makes of a specimen.
void set_value(Experiment& specimen, const std::string& id, double value) {
  if (id == "thickness" && specimen.geometry.dimension == 2) {
    specimen.geometry.thickness = value;
    return;
  }
  for (const Dimension& dimension : all_dimensions(specimen)) {
    if (dimension.spec.id == id) return dimension.set(specimen, value);
  }
}

Specimen specimen_with(const Experiment& experiment, const Trials& trials, const std::vector<size_t>& controls,
                       const std::vector<double>& values) {
  Specimen made;
  made.experiment = experiment;
  made.experiment.specimens.clear();
  made.experiment.set_by.clear();
  made.experiment.specimen_control.clear();
  for (size_t k = 0; k < controls.size(); ++k) {
    const BenchFormat::Control& control = experiment.bench.controls[controls[k]];
    std::string text;
    if (control.id == experiment.specimen_control) {
      const SpecimenSettings& settings = experiment.specimens[static_cast<size_t>(values[k]) - 1];
      for (const auto& [id, value] : settings.set) set_value(made.experiment, id, value);
      text = made.suffix = settings.id;
    } else {
      const std::string& id = experiment.set_by.at(control.id);
      set_value(made.experiment, id, values[k]);
      text = with_unit(values[k], control.quantities.front() == Quantity::angle ? "rad" : "m");
    }
    made.label += fmt::format("{}{} {}", made.label.empty() ? "" : ", ", control.id, text);
  }
  try {
    made.experiment.geometry.shape->check();
  } catch (const InputError& error) {
    throw FileError(experiment.path, fmt::format("{}: {}", made.label, error.what()));
  }
  made.trials = trials;
  made.trials.readings.clear();
  return made;
}

}  // namespace

std::vector<Specimen> specimens_of(const Experiment& experiment, const Trials& trials) {
  const std::vector<size_t> controls = specimen_controls(experiment);
  std::map<std::vector<double>, Specimen> found;
  for (size_t i = 0; i < trials.readings.size(); ++i) {
    std::vector<double> values;
    for (size_t k : controls) values.push_back(trials.readings[i].controls[k]);
    auto place = found.find(values);
    if (place == found.end()) place = found.emplace(values, specimen_with(experiment, trials, controls, values)).first;
    place->second.trials.readings.push_back(trials.readings[i]);
    place->second.readings.push_back(i);
  }
  std::vector<Specimen> specimens;
  for (auto& [values, specimen] : found) {
    if (specimen.suffix.empty() || controls.size() > 1) specimen.suffix = std::to_string(specimens.size() + 1);
    if (controls.size() == 1 && experiment.specimen_control.empty()) {
      // By its rank in the bench's file, whatever of that is here.
      const std::set<double>& known = trials.control_values[controls.front()];
      const auto rank = known.find(values.front());
      specimen.suffix = rank == known.end() ? "" : std::to_string(1 + std::distance(known.begin(), rank));
    }
    const bool own = std::ranges::any_of(experiment.free, &FreeSettings::per_specimen);
    if (own && specimen.suffix.empty())
      throw FileError(experiment.path, fmt::format("{}: it has parameters of its own, and the bench's file has no such "
                                                   "specimen; ask for those that were measured",
                                                   specimen.label));
    if (specimen.suffix.empty()) specimen.suffix = "new";
    specimens.push_back(std::move(specimen));
  }
  return specimens;
}

OwnParameters own_parameters(const Experiment& experiment, const Trials& trials) {
  OwnParameters own;
  for (const FreeSettings& free : experiment.free) {
    if (free.per_specimen) own.ids.push_back(free.id);
  }
  for (const SpecimenSettings& specimen : experiment.specimens) own.suffixes.push_back(specimen.id);
  if (experiment.specimens.empty()) {
    const size_t count = trials.control_values[specimen_controls(experiment).front()].size();
    for (size_t k = 1; k <= count; ++k) own.suffixes.push_back(std::to_string(k));
  }
  return own;
}

Experiment with_own_parameters(const Experiment& experiment, const OwnParameters& own) {
  Experiment expanded = experiment;
  expanded.free.clear();
  for (const FreeSettings& free : experiment.free) {
    if (!free.per_specimen) {
      expanded.free.push_back(free);
      continue;
    }
    for (const std::string& suffix : own.suffixes) {
      expanded.free.push_back(free);
      expanded.free.back().id += "_" + suffix;
    }
  }
  return expanded;
}

SpecimensProtocol::SpecimensProtocol(std::vector<Part> parts, const OwnParameters& own,
                                     const std::vector<std::string>& set, int dimensions)
    : parts_(std::move(parts)) {
  const ParameterTable& first = parts_.front().protocol->parameters();
  const Params& values = parts_.front().protocol->nominal();
  std::vector<double> nominal;
  const auto add = [&](ParameterSpec spec, double value) {
    table_.declare(std::move(spec));
    nominal.push_back(value);
  };
  const int model = first.size() - dimensions;
  for (int i = 0; i < model; ++i) add(first[i], values[i]);
  for (const std::string& id : own.ids) {
    for (const std::string& suffix : own.suffixes) {
      const int index = first.index(id);
      ParameterSpec spec = first[index];
      spec.id += "_" + suffix;
      spec.meaning += " of specimen " + suffix;
      add(std::move(spec), values[index]);
    }
  }
  for (int i = model; i < first.size(); ++i) add(first[i], values[i]);
  nominal_ = Eigen::Map<const Params>(nominal.data(), static_cast<Eigen::Index>(nominal.size()));
  for (const Part& part : parts_) {
    std::vector<int>& index = index_.emplace_back();
    for (const std::string& id : part.protocol->parameters().ids()) {
      if (std::ranges::find(set, id) != set.end())
        index.push_back(-1);
      else if (std::ranges::find(own.ids, id) != own.ids.end())
        index.push_back(table_.index(id + "_" + part.suffix));
      else
        index.push_back(table_.index(id));
    }
    first_row_.push_back(rows_);
    rows_ += part.protocol->row_count();
  }
}

size_t SpecimensProtocol::part_of(int row) const {
  return static_cast<size_t>(std::ranges::upper_bound(first_row_, row) - first_row_.begin()) - 1;
}

Params SpecimensProtocol::of_part(size_t part, const Params& p) const {
  Params own = parts_[part].protocol->nominal();
  for (size_t i = 0; i < index_[part].size(); ++i) {
    if (index_[part][i] >= 0) own[static_cast<Eigen::Index>(i)] = p[index_[part][i]];
  }
  return own;
}

std::pair<std::vector<int>, std::vector<int>> SpecimensProtocol::free_of_part(size_t part,
                                                                              const std::vector<int>& free) const {
  std::vector<int> places, indices;
  for (size_t k = 0; k < free.size(); ++k) {
    const auto found = std::ranges::find(index_[part], free[k]);
    if (found == index_[part].end()) continue;
    places.push_back(static_cast<int>(k));
    indices.push_back(static_cast<int>(found - index_[part].begin()));
  }
  return {places, indices};
}

Prediction SpecimensProtocol::predict(const Params& p, const std::vector<int>& free) {
  Prediction all;
  all.values = Eigen::VectorXd::Constant(rows_, not_a_number);
  if (!free.empty()) all.derivatives = Eigen::MatrixXd::Zero(rows_, static_cast<Eigen::Index>(free.size()));
  for (size_t k = 0; k < parts_.size(); ++k) {
    const auto [places, indices] = free_of_part(k, free);
    const Prediction some = parts_[k].protocol->predict(of_part(k, p), indices);
    const Eigen::Index first = first_row_[k], count = parts_[k].protocol->row_count();
    all.values.segment(first, count) = some.values;
    for (size_t c = 0; c < places.size(); ++c)
      all.derivatives.col(places[c]).segment(first, count) = some.derivatives.col(static_cast<Eigen::Index>(c));
    for (const std::string& failure : some.failures)
      all.failures.push_back(fmt::format("{}: {}", parts_[k].label, failure));
  }
  return all;
}

void SpecimensProtocol::forget() {
  for (const Part& part : parts_) part.protocol->forget();
}
void SpecimensProtocol::begin_search() {
  for (const Part& part : parts_) part.protocol->begin_search();
}
void SpecimensProtocol::end_search() {
  for (const Part& part : parts_) part.protocol->end_search();
}

std::string SpecimensProtocol::state() const {
  std::vector<std::string> states;
  for (const Part& part : parts_) states.push_back(part.protocol->state());
  Bytes out;
  out(states);
  return out.bytes();
}

void SpecimensProtocol::restore(const std::string& state) {
  std::vector<std::string> states;
  Bytes in(state);
  in(states);
  for (size_t k = 0; k < parts_.size(); ++k) parts_[k].protocol->restore(states.at(k));
}

std::vector<Alternative> SpecimensProtocol::alternatives(const Params& p) {
  std::vector<Alternative> all;
  for (size_t k = 0; k < parts_.size(); ++k) {
    for (Alternative& one : parts_[k].protocol->alternatives(of_part(k, p))) {
      for (int& row : one.rows) row += first_row_[k];
      all.push_back(std::move(one));
    }
  }
  return all;
}

void SpecimensProtocol::follow(const Params& at, const std::vector<int>& rows) {
  for (size_t k = 0; k < parts_.size(); ++k) {
    std::vector<int> own;
    for (int row : rows) {
      if (part_of(row) == k) own.push_back(row - first_row_[k]);
    }
    parts_[k].protocol->follow(rows.empty() ? at : of_part(k, at), own);
  }
}

int SpecimensProtocol::factorisations() const {
  return std::accumulate(parts_.begin(), parts_.end(), 0,
                         [](int sum, const Part& part) { return sum + part.protocol->factorisations(); });
}

DimensionedModel as_one(const std::vector<Specimen>& specimens, std::vector<DimensionedModel> models,
                        const Experiment& experiment, const OwnParameters& own) {
  DimensionedModel whole;
  std::vector<SpecimensProtocol::Part> parts;
  size_t readings = 0;
  for (const Specimen& specimen : specimens) readings += specimen.readings.size();
  whole.row_of_reading.assign(readings, -1);
  for (size_t k = 0; k < specimens.size(); ++k) {
    DimensionedModel& model = models[k];
    const int first = static_cast<int>(whole.rows.size());
    whole.rows.insert(whole.rows.end(), model.rows.begin(), model.rows.end());
    for (size_t i = 0; i < specimens[k].readings.size(); ++i) {
      const int row = model.row_of_reading[i];
      whole.row_of_reading[specimens[k].readings[i]] = row < 0 ? -1 : first + row;
    }
    parts.push_back({model.protocol.get(), std::move(model.protocol), specimens[k].label, specimens[k].suffix});
  }
  // In the order of the readings, as the fit has them.
  std::map<size_t, Measurement> measured;
  for (size_t k = 0; k < specimens.size(); ++k) {
    size_t m = 0;
    for (size_t i = 0; i < specimens[k].readings.size(); ++i) {
      if (specimens[k].trials.readings[i].excluded) continue;
      Measurement one = models[k].measurements[m++];
      one.row = one.group = whole.row_of_reading[specimens[k].readings[i]];
      measured.emplace(specimens[k].readings[i], one);
    }
  }
  for (const auto& [reading, one] : measured) whole.measurements.push_back(one);
  whole.dimensions = models.front().dimensions;
  for (DimensionedModel& model : models) {
    for (const std::string& why : model.left_out) {
      if (std::ranges::find(whole.left_out, why) == whole.left_out.end()) whole.left_out.push_back(why);
    }
  }
  whole.protocol = std::make_unique<SpecimensProtocol>(std::move(parts), own, ids_set_by_columns(experiment),
                                                       static_cast<int>(whole.dimensions.size()));
  return whole;
}

DimensionedModel full_model(const Experiment& experiment, const Trials& trials,
                            const std::vector<Dimension>& dimensions) {
  if (experiment.has_specimens()) {
    const std::vector<Specimen> specimens = specimens_of(experiment, trials);
    std::vector<DimensionedModel> models;
    for (const Specimen& one : specimens) models.push_back(full_model(one.experiment, one.trials, dimensions));
    return as_one(specimens, std::move(models), experiment, own_parameters(experiment, trials));
  }
  auto protocol = std::make_unique<DimensionedProtocol>(experiment, trials, dimensions);
  DimensionedModel model;
  static_cast<BenchRows&>(model) = protocol->replay();
  model.dimensions = protocol->dimensions();
  model.left_out = protocol->left_out();
  model.protocol = std::move(protocol);
  return model;
}

}  // namespace taut
