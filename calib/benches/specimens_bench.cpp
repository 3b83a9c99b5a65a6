#include "calib/benches/specimens_bench.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <set>

#include "sim/core/error.hpp"

namespace taut {
SpecimensBench::SpecimensBench(Experiment experiment, Trials trials)
    : Bench(std::move(experiment)), trials_(std::move(trials)), specimens_(specimens_of(experiment_, trials_)) {
  for (const Specimen& specimen : specimens_)
    parts_.push_back(std::make_unique<StaticBench>(specimen.experiment, specimen.trials));
  controls_ = first().controls();
  channels_ = first().channels();
  drawn_control_ = first().drawn_control();
  drawn_label_ = first().drawn_label();
  join_protocols();
  readings_.resize(trials_.readings.size());
  for (size_t k = 0; k < parts_.size(); ++k) {
    for (size_t i = 0; i < specimens_[k].readings.size(); ++i) {
      BenchReading& reading = readings_[specimens_[k].readings[i]] = parts_[k]->readings()[i];
      if (reading.row >= 0) reading.row += protocol_->first_row(k);
      reading.series = specimens_[k].label + (reading.series.empty() ? "" : ", ") + reading.series;
    }
  }
  for (const BenchReading& reading : readings_) {
    if (!reading.excluded) measurements_.push_back({reading.row, reading.value, reading.sigma, reading.row});
  }
}

void SpecimensBench::join_protocols() {
  std::vector<SpecimensProtocol::Part> parts;
  for (size_t k = 0; k < parts_.size(); ++k)
    parts.push_back({&parts_[k]->protocol(), nullptr, specimens_[k].label, specimens_[k].suffix});
  protocol_ = std::make_unique<SpecimensProtocol>(
      std::move(parts), own_parameters(experiment_, trials_), ids_set_by_columns(experiment_),
      static_cast<int>(free_dimensions(specimens_.front().experiment).size()));
}

void SpecimensBench::use(const CheaperModels& models) {
  models_ = models;
  for (const auto& part : parts_) part->use(models);
  join_protocols();
}

std::vector<FreeParameter> SpecimensBench::free() const {
  return free_parameters(with_own_parameters(experiment_, own_parameters(experiment_, trials_)), *protocol_);
}

std::vector<CurveRecord> SpecimensBench::curves(const Params& p, const std::vector<FreeParameter>& free,
                                                const Eigen::MatrixXd& covariance, const Ask& ask) const {
  std::vector<CurveRecord> all;
  for (size_t k = 0; k < parts_.size(); ++k) {
    const auto [places, indices] = protocol_->free_of_part(k, indices_of(free));
    std::vector<FreeParameter> own;
    for (size_t c = 0; c < places.size(); ++c) {
      own.push_back(free[static_cast<size_t>(places[c])]);
      own.back().index = indices[c];
    }
    const Eigen::MatrixXd some = covariance.size() == 0 ? covariance : Eigen::MatrixXd(covariance(places, places));
    for (CurveRecord& curve : parts_[k]->curves(protocol_->of_part(k, p), own, some, ask)) {
      curve.series = specimens_[k].label + (curve.series.empty() ? "" : ", ") + curve.series;
      all.push_back(std::move(curve));
    }
  }
  return all;
}

std::unique_ptr<Bench> SpecimensBench::with(const VariantSettings& variant) const {
  Experiment changed = changed_by(experiment_, variant);
  auto bench = std::make_unique<SpecimensBench>(std::move(changed), trials_);
  if (models_.choose) bench->use(models_);
  return bench;
}

std::unique_ptr<Bench> SpecimensBench::part(size_t control, double held) const {
  auto bench = std::make_unique<SpecimensBench>(experiment_, trials_at(trials_, control, held));
  if (models_.choose) bench->use(models_);
  return bench;
}

std::unique_ptr<Bench> SpecimensBench::at_rows(const std::vector<LoadRow>& rows) const {
  auto bench = std::make_unique<SpecimensBench>(experiment_, trials_at_rows(experiment_, trials_, rows));
  if (models_.choose) bench->use(models_);
  return bench;
}

std::vector<double> SpecimensBench::values_of(size_t control) const {
  const std::set<double>& values = trials_.control_values[control];
  return {values.begin(), values.end()};
}

std::string SpecimensBench::size_text() const {
  std::set<std::vector<double>> conditions;
  for (const BenchReading& reading : readings_) conditions.insert(reading.controls);
  return fmt::format("{} readings in {} conditions of {} specimens with {} unknowns each", measurements_.size(),
                     conditions.size(), parts_.size(), unknowns());
}

Lines SpecimensBench::describe() const {
  Lines lines = first().describe();
  std::erase_if(lines, [](const auto& line) { return line.first == "bench"; });
  for (const std::string& remark : trials_.remarks) lines.emplace_back("bench", remark);
  lines.emplace_back("specimens", fmt::format("{}; the first of them above", parts_.size()));
  for (size_t k = 0; k < parts_.size(); ++k)
    lines.emplace_back(
        "specimen " + specimens_[k].suffix,
        fmt::format("{}{} readings", experiment_.specimen_control.empty() ? specimens_[k].label + ": " : "",
                    specimens_[k].readings.size()));
  return lines;
}

std::vector<std::string> SpecimensBench::warnings_before() const {
  return first().warnings_before();
}

std::vector<std::string> SpecimensBench::warnings_after() const {
  std::vector<std::string> all;
  for (size_t k = 0; k < parts_.size(); ++k) {
    for (const std::string& warning : parts_[k]->warnings_after())
      all.push_back(fmt::format("{}: {}", specimens_[k].label, warning));
  }
  return all;
}

std::string SpecimensBench::choice() const {
  std::string text;
  for (size_t k = 0; k < parts_.size(); ++k) {
    if (const std::string one = parts_[k]->choice(); !one.empty())
      text += fmt::format("{}{}: {}", text.empty() ? "" : "; ", specimens_[k].label, one);
  }
  return text;
}

std::optional<RowModel> SpecimensBench::model_of(int row) const {
  const size_t part = protocol_->part_of(row);
  return parts_[part]->model_of(row - protocol_->first_row(part));
}

std::string SpecimensBench::compare_models(const Params& p, const Eigen::VectorXd& values, double seconds) const {
  std::string text;
  for (size_t k = 0; k < parts_.size(); ++k) {
    const std::string one = parts_[k]->compare_models(
        protocol_->of_part(k, p), values.segment(protocol_->first_row(k), parts_[k]->protocol().row_count()), seconds);
    if (!one.empty()) text += fmt::format("{}{}: {}", text.empty() ? "" : "; ", specimens_[k].label, one);
  }
  return text;
}

DimensionedModel SpecimensBench::with_dimensions() const {
  const std::vector<Dimension> dimensions = dimensions_of(experiment_);
  std::vector<DimensionedModel> models;
  for (const auto& part : parts_) models.push_back(part->with_dimensions(dimensions));
  return as_one(specimens_, std::move(models), experiment_, own_parameters(experiment_, trials_));
}

std::vector<CableState> SpecimensBench::cable_states() const {
  std::vector<CableState> all;
  for (size_t k = 0; k < parts_.size(); ++k) {
    for (CableState& state : parts_[k]->cable_states()) all.push_back(std::move(state));
  }
  return all;
}

std::vector<TangentStiffness> SpecimensBench::tangent_stiffness() const {
  std::vector<TangentStiffness> all;
  for (size_t k = 0; k < parts_.size(); ++k) {
    for (TangentStiffness& one : parts_[k]->tangent_stiffness()) all.push_back(std::move(one));
  }
  return all;
}

std::unique_ptr<Bench> open_static_bench(Experiment experiment, Trials trials) {
  if (experiment.has_specimens()) return std::make_unique<SpecimensBench>(std::move(experiment), std::move(trials));
  return std::make_unique<StaticBench>(std::move(experiment), std::move(trials));
}

}  // namespace taut
