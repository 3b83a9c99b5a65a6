#include "calib/runs/comparison.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <tuple>

#include "calib/fit/distributions.hpp"
#include "sim/core/dense.hpp"
#include "sim/core/error.hpp"
#include "sim/core/units.hpp"
#include "sim/files/toml_keys.hpp"

namespace taut {
namespace {

double scale_of_estimate(const ParameterEstimate& estimate) {
  return estimate.spec.logarithmic ? estimate.value : 1;
}

/// second - first on the fitted scale.
double distance(const ParameterEstimate& first, const ParameterEstimate& second) {
  return first.spec.logarithmic ? std::log(second.value / first.value) : second.value - first.value;
}

std::string last_word(const std::string& key) {
  return key.substr(key.rfind('.') + 1);
}

/// Whether what a share is of is the same in both runs: no input that has its name differs.
bool is_common(const std::string& source, const std::vector<InputDifference>& inputs) {
  const auto touches = [&](const InputDifference& input) {
    if (source == "mesh" || source == "plane section") return input.key.starts_with("mesh") || input.key == "model";
    if (source == "contact gap") return input.key.starts_with("contact");
    if (source == "model" || source == "section law") return input.key == "model" || input.key.starts_with("rod");
    return source.find(last_word(input.key)) != std::string::npos;
  };
  return std::ranges::none_of(inputs, touches);
}

/// Half width of a share's part in a parameter on the fitted scale; 0: not known, or not counted.
struct Part {
  double bias = 0, error = 0;
};
std::map<std::string, Part> parts_of(const RunRecord& record, size_t j) {
  std::map<std::string, Part> parts;
  const double scale = scale_of_estimate(record.fit.parameters[j]);
  for (const Share& share : record.shares) {
    if (!share.counted || j >= share.bias.size() || !std::isfinite(share.bias[j])) continue;
    parts[share.source] = {share.bias[j] / scale, std::isfinite(share.error[j]) ? share.error[j] / scale : 0};
  }
  return parts;
}

/// Variance of the difference by all shares; those in common are named.
double variance_of_shares(const std::map<std::string, Part>& first, const std::map<std::string, Part>& second,
                          const std::vector<InputDifference>& inputs, std::vector<std::string>& cancelled) {
  double sum = 0;
  const auto count = [&](double bias, double error) { sum += std::pow((std::abs(bias) + std::abs(error)) / z95, 2); };
  for (const auto& [source, part] : first) {
    const auto other = second.find(source);
    if (other != second.end() && is_common(source, inputs)) {
      count(other->second.bias - part.bias, other->second.error - part.error);
      cancelled.push_back(source);
      continue;
    }
    count(part.bias, part.error);
    if (other != second.end()) count(other->second.bias, other->second.error);
  }
  for (const auto& [source, part] : second) {
    if (!first.contains(source)) count(part.bias, part.error);
  }
  return sum;
}

/// What tells a reading from others: trial, channel, controls, and which one of those that have all these alike.
using ReadingKey = std::tuple<std::string, std::string, std::vector<double>, int>;
std::map<ReadingKey, const ReadingRecord*> readings_of(const RunRecord& record) {
  std::map<ReadingKey, const ReadingRecord*> found;
  for (const ReadingRecord& reading : record.readings) {
    int repeat = 0;
    while (found.contains({reading.trial, reading.channel, reading.controls, repeat})) ++repeat;
    found[{reading.trial, reading.channel, reading.controls, repeat}] = &reading;
  }
  return found;
}

std::string name_of_reading(const RunRecord& record, const ReadingRecord& reading) {
  std::string text = reading.trial.empty() ? "" : fmt::format("trial {}, ", reading.trial);
  text += reading.channel;
  for (size_t k = 0; k < reading.controls.size(); ++k) {
    const AxisRecord& axis = record.controls[k];
    const size_t number = static_cast<size_t>(std::max(1.0, reading.controls[k]));
    const std::string value = !axis.labels.empty() && number <= axis.labels.size()
                                  ? axis.labels[number - 1]
                                  : with_unit(reading.controls[k], axis.unit);
    text += fmt::format("{}{} {}", k == 0 ? " at " : ", ", axis.id, value);
  }
  return text;
}

std::string unit_of_channel(const RunRecord& record, const std::string& id) {
  const auto axis = std::ranges::find(record.channels, id, &AxisRecord::id);
  return axis == record.channels.end() ? "" : axis->unit;
}

void compare_readings(const RunRecord& first, const RunRecord& second, RunComparison& found) {
  const auto a = readings_of(first), b = readings_of(second);
  bool excluded_alike = true;
  for (const auto& [key, reading] : a) {
    const auto other = b.find(key);
    ReadingDifference difference{name_of_reading(first, *reading), reading->measured, std::nullopt, 0,
                                 unit_of_channel(first, reading->channel)};
    if (other != b.end()) {
      ++found.common_readings;
      difference.second = other->second->measured;
      difference.in_sigmas =
          (other->second->measured - reading->measured) / std::hypot(reading->sigma, other->second->sigma);
      excluded_alike &= reading->excluded == other->second->excluded;
      if (reading->measured == other->second->measured) {
        ++found.equal_readings;
        continue;
      }
    }
    found.readings.push_back(std::move(difference));
  }
  for (const auto& [key, reading] : b) {
    if (!a.contains(key))
      found.readings.push_back({name_of_reading(second, *reading), std::nullopt, reading->measured, 0,
                                unit_of_channel(second, reading->channel)});
  }
  std::ranges::stable_sort(found.readings, std::greater(),
                           [](const ReadingDifference& one) { return std::abs(one.in_sigmas); });
  found.same_readings = found.readings.empty() && !a.empty() && excluded_alike;
}

void compare_curves(const RunRecord& first, const RunRecord& second, RunComparison& found) {
  std::string load_unit = "N";
  if (first.load_control < 0) load_unit = first.controls.empty() ? "" : first.controls.front().unit;
  for (const CurveRecord& a : first.curves) {
    const auto b = std::ranges::find_if(second.curves, [&](const CurveRecord& other) {
      return other.channel == a.channel && other.series == a.series;
    });
    if (b == second.curves.end()) continue;
    std::optional<CurveDifference> largest;
    for (size_t i = 0; i < a.load.size(); ++i) {
      for (size_t k = 0; k < b->load.size(); ++k) {
        if (std::abs(a.load[i] - b->load[k]) > 1e-9 * std::abs(a.load[i])) continue;
        const double apart = b->value[k] - a.value[i], sigma = std::hypot(a.se[i], b->se[k]);
        if (!std::isfinite(apart) || !(sigma > 0)) continue;
        if (!largest || std::abs(apart / sigma) > std::abs(largest->in_sigmas))
          largest = {a.channel,   a.series,     unit_of_channel(first, a.channel), a.load[i], load_unit, a.value[i],
                     b->value[k], apart / sigma};
      }
    }
    if (largest) found.curves.push_back(*largest);
  }
}

void refuse_without_result(const RunRecord& record) {
  if (record.fit.covariance.size() == 0)
    throw InputError(fmt::format("the run '{}' has no result to compare ({}); run its fit again", record.title,
                                 name_of(record.fit.status)));
}

}  // namespace

RunComparison compare(const RunRecord& first, const RunRecord& second, std::vector<InputDifference> inputs) {
  refuse_without_result(first);
  refuse_without_result(second);
  RunComparison found;
  found.inputs = std::move(inputs);
  compare_readings(first, second, found);
  compare_curves(first, second, found);
  const std::vector<ParameterEstimate>&a = first.fit.parameters, &b = second.fit.parameters;
  std::vector<std::pair<Eigen::Index, Eigen::Index>> places;
  for (size_t i = 0; i < a.size(); ++i) {
    const auto other = std::ranges::find(b, a[i].spec.id, [](const ParameterEstimate& e) { return e.spec.id; });
    if (other == b.end()) {
      found.first_alone.push_back(a[i].spec.id);
      continue;
    }
    places.emplace_back(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(other - b.begin()));
  }
  for (const ParameterEstimate& e : b) {
    if (std::ranges::find(a, e.spec.id, [](const ParameterEstimate& one) { return one.spec.id; }) == a.end())
      found.second_alone.push_back(e.spec.id);
  }
  const Eigen::Index n = static_cast<Eigen::Index>(places.size());
  Eigen::MatrixXd covariance(n, n);
  Eigen::VectorXd apart(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    for (Eigen::Index k = 0; k < n; ++k) {
      covariance(i, k) = first.fit.covariance(places[i].first, places[k].first);
      if (!found.same_readings) covariance(i, k) += second.fit.covariance(places[i].second, places[k].second);
    }
  }
  for (Eigen::Index i = 0; i < n; ++i) {
    const size_t one = static_cast<size_t>(places[i].first), two = static_cast<size_t>(places[i].second);
    ParameterDifference& difference = found.parameters.emplace_back();
    difference.id = a[one].spec.id;
    difference.unit = a[one].spec.unit;
    difference.first = a[one].value;
    difference.second = b[two].value;
    apart[i] = distance(a[one], b[two]);
    if (!found.same_readings)
      covariance(i, i) +=
          variance_of_shares(parts_of(first, one), parts_of(second, two), found.inputs, difference.cancelled);
    difference.sigma = std::sqrt(covariance(i, i)) * scale_of_estimate(a[one]);
    difference.in_sigmas = apart[i] / std::sqrt(covariance(i, i));
  }
  if (n > 0) {
    // In units of each one's sigma, so that directions that the readings do not tell fall out by the rank.
    const Eigen::VectorXd sigma = covariance.diagonal().cwiseSqrt();
    const Eigen::MatrixXd correlation =
        sigma.cwiseInverse().asDiagonal() * covariance * sigma.cwiseInverse().asDiagonal();
    const SymmetricModes modes = symmetric_modes(correlation);
    const Eigen::VectorXd along = modes.vectors.transpose() * apart.cwiseQuotient(sigma);
    int dof = 0;
    for (Eigen::Index i = 0; i < n; ++i) {
      if (!(modes.values[i] > 1e-9)) continue;
      found.chi_squared += along[i] * along[i] / modes.values[i];
      ++dof;
    }
    if (dof > 0) found.p_value = chi_squared_probability(found.chi_squared, dof);
  }
  return found;
}

bool RunComparison::differs(double limit) const {
  if (!first_alone.empty() || !second_alone.empty()) return true;
  const double own = same_readings ? limit / 20 : limit;
  if (!same_readings && p_value < 0.0027) return true;
  return std::ranges::any_of(parameters,
                             [&](const ParameterDifference& one) { return !(std::abs(one.in_sigmas) <= own); });
}

std::vector<InputDifference> input_differences(const std::string& first, const std::string& second) {
  const std::map<std::string, TomlValue> a = toml_values(first), b = toml_values(second);
  const auto is_text = [](const std::string& key) {
    return key == "title" || last_word(key) == "file" || key.starts_with("fit.reference");
  };
  std::vector<InputDifference> found;
  for (const auto& [key, value] : a) {
    if (is_text(key)) continue;
    const auto other = b.find(key);
    if (other == b.end())
      found.push_back({key, value.text, ""});
    else if (other->second.alike != value.alike)
      found.push_back({key, value.text, other->second.text});
  }
  for (const auto& [key, value] : b) {
    if (!a.contains(key) && !is_text(key)) found.push_back({key, "", value.text});
  }
  return found;
}

}  // namespace taut
