#include "reports/record_checks.hpp"

#include <fmt/format.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <map>

#include "sim/core/error.hpp"

namespace taut {
namespace {

/// Refuses what a record says at a key.
class RecordChecker {
 public:
  explicit RecordChecker(const std::string& file) : file_(file) {}
  void need(bool right, const std::string& key, const std::string& what) const {
    if (!right)
      throw InputError(fmt::format("{}: the key '{}' contradicts the rest: {}; restore the file or run the fit again",
                                   file_, key, what));
  }
  void same_length(size_t have, size_t wanted, const std::string& key, const char* of_what) const {
    need(have == wanted, key, fmt::format("{} entries for {} {}", have, wanted, of_what));
  }

 private:
  const std::string& file_;
};

/// Symmetric to rounding, no variance below zero, no combination of parameters with one.
void check_covariance(const RecordChecker& checker, const Eigen::MatrixXd& covariance, size_t parameters) {
  if (covariance.size() == 0) return;
  const std::string key = "fit.covariance";
  checker.same_length(static_cast<size_t>(covariance.rows()), parameters, key, "parameters");
  checker.need(covariance.allFinite(), key, "an entry is no number");
  checker.need(covariance.diagonal().minCoeff() >= 0, key, "a variance is negative");
  const Eigen::VectorXd scale = covariance.diagonal().cwiseSqrt().cwiseMax(1e-300).cwiseInverse();
  const Eigen::MatrixXd scaled = scale.asDiagonal() * covariance * scale.asDiagonal();
  checker.need((scaled - scaled.transpose()).cwiseAbs().maxCoeff() < 1e-6, key, "it is not symmetric");
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> modes(scaled, Eigen::EigenvaluesOnly);
  checker.need(modes.eigenvalues().minCoeff() > -1e-6, key, "a combination of parameters has a negative variance");
}

void check_correlation(const RecordChecker& checker, const Eigen::MatrixXd& correlation, size_t parameters) {
  if (correlation.size() == 0) return;
  const std::string key = "fit.correlation";
  checker.same_length(static_cast<size_t>(correlation.rows()), parameters, key, "parameters");
  for (const double entry : correlation.reshaped())
    checker.need(std::isnan(entry) || std::abs(entry) <= 1 + 1e-9, key, fmt::format("{} is beyond 1", entry));
}

bool has_result(const FitResult& fit) {
  return fit.status == FitStatus::converged || fit.status == FitStatus::not_converged;
}

void check_parameters(const RecordChecker& checker, const FitResult& fit) {
  for (size_t i = 0; i < fit.parameters.size(); ++i) {
    const ParameterEstimate& estimate = fit.parameters[i];
    const auto key = [&](const char* member) { return fmt::format("parameters[{}].{}", i, member); };
    checker.need(std::isfinite(estimate.value) || !has_result(fit), key("value"), "a fit with a result has no value");
    checker.need(!(estimate.lower > estimate.upper), key("bounds"), "the lower one is above the upper one");
    const double slack = 1e-9 * std::abs(estimate.value);
    checker.need(!(estimate.value < std::max(estimate.lower, estimate.spec.lower) - slack ||
                   estimate.value > std::min(estimate.upper, estimate.spec.upper) + slack),
                 key("value"), fmt::format("{} is outside its bounds", estimate.value));
    checker.need(!(estimate.standard_error < 0), key("standard_error"), "it is negative");
    checker.need(!(estimate.lower95 && *estimate.lower95 > estimate.value + slack) &&
                     !(estimate.upper95 && *estimate.upper95 < estimate.value - slack),
                 key("interval95"), "the value is not in it");
  }
}

void check_readings(const RecordChecker& checker, const RunRecord& record) {
  std::map<std::string, double> largest;  // by channel
  for (const ReadingRecord& reading : record.readings)
    largest[reading.channel] = std::max(largest[reading.channel], std::abs(reading.measured));
  for (size_t i = 0; i < record.readings.size(); ++i) {
    const ReadingRecord& reading = record.readings[i];
    const auto key = [&](const char* member) { return fmt::format("readings[{}].{}", i, member); };
    checker.need(std::isfinite(reading.measured), key("measured"), "a reading is a number");
    checker.need(
        std::isfinite(reading.sigma) && reading.sigma > 1e-15 * largest[reading.channel], key("sigma"),
        fmt::format("{} is no standard deviation of readings up to {}", reading.sigma, largest[reading.channel]));
    checker.same_length(reading.controls.size(), record.controls.size(), key("controls"), "controls");
    for (const double control : reading.controls)
      checker.need(std::isfinite(control), key("controls"), "a control is a number");
  }
}

void check_curves(const RecordChecker& checker, const std::vector<CurveRecord>& curves, const char* name) {
  for (size_t i = 0; i < curves.size(); ++i) {
    const CurveRecord& curve = curves[i];
    for (const auto& [member, values] : {std::pair("value", &curve.value), std::pair("se", &curve.se),
                                         std::pair("increment_se", &curve.increment_se)}) {
      if (values != &curve.value && values->empty()) continue;
      checker.same_length(values->size(), curve.load.size(), fmt::format("{}[{}].{}", name, i, member), "loads");
    }
  }
}

void check_ensembles(const RecordChecker& checker, const RunRecord& record) {
  const size_t n = record.fit.parameters.size();
  for (size_t i = 0; i < record.ensembles.size(); ++i) {
    const EnsembleRecord& ensemble = record.ensembles[i];
    const auto key = [&](const char* member) { return fmt::format("ensembles[{}].{}", i, member); };
    if (!ensemble.parameters.empty())
      checker.same_length(ensemble.parameters.size(), n, key("parameters"), "parameters");
    if (!ensemble.bands.empty())
      checker.same_length(ensemble.bands.size(), record.readings.size(), key("bands"), "readings");
    if (!ensemble.profiles.empty()) checker.same_length(ensemble.profiles.size(), n, key("profiles"), "parameters");
    checker.same_length(ensemble.weights.size(), ensemble.drawn.size(), key("weights"), "members");
    for (const std::vector<double>& values : ensemble.drawn)
      checker.same_length(values.size(), n, key("drawn"), "parameters");
    for (const double weight : ensemble.weights)
      checker.need(weight >= 0 && weight <= 1 + 1e-9, key("weights"), "a weight is from 0 to 1");
    for (const EnsembleMinimum& minimum : ensemble.minima)
      checker.same_length(minimum.values.size(), n, key("minima"), "parameters");
  }
}

/// What shapes in space say of their surface, and what presses on them.
void check_shapes(const RecordChecker& checker, const RunRecord& record) {
  const SurfaceRecord& surface = record.surface;
  const std::vector<int>& triangles = surface.triangles;
  checker.need(triangles.size() == 3 * surface.triangle_regions.size(), "surface.triangles",
               "three points and one region for each");
  for (const int region : surface.triangle_regions)
    checker.need(region >= 0 && region < static_cast<int>(surface.regions.size()), "surface.triangle_regions",
                 fmt::format("there is no region {}", region));
  const int largest = triangles.empty() ? -1 : *std::ranges::max_element(triangles);
  checker.need(triangles.empty() || *std::ranges::min_element(triangles) >= 0, "surface.triangles",
               "a point is not negative");
  for (size_t i = 0; i < record.shapes.size(); ++i) {
    const ShapeRecord& shape = record.shapes[i];
    const auto key = [&](const char* member) { return fmt::format("shapes[{}].{}", i, member); };
    checker.need(shape.points.size() % 3 == 0 && static_cast<int>(shape.points.size() / 3) > largest, key("points"),
                 fmt::format("three coordinates for each of {} points", largest + 1));
    checker.same_length(shape.points.size(), record.shapes.front().points.size(), key("points"), "at rest");
    for (const std::vector<double>& cable : shape.space_cables)
      checker.need(cable.size() % 3 == 0, key("space_cables"), "three coordinates for each point");
    const size_t d = shape.points.empty() ? 2 : 3;
    for (const ContactRecord& contact : shape.contacts)
      checker.need(contact.centre.size() == d && contact.force.size() == d && contact.places.size() % d == 0,
                   key("contacts"), fmt::format("{} coordinates for each point and force", d));
  }
}

}  // namespace

void check_record(const RunRecord& record, const std::string& file) {
  const RecordChecker checker(file);
  const FitResult& fit = record.fit;
  const size_t n = fit.parameters.size();
  check_covariance(checker, fit.covariance, n);
  check_correlation(checker, fit.correlation, n);
  checker.need(fit.covariance.size() == 0 || has_result(fit), "status",
               fmt::format("a fit that ended as '{}' has no covariance", name_of(fit.status)));
  for (const auto& [key, values] :
       {std::pair("fit.singular_values", &fit.singular_values), std::pair("fit.weakest_combination", &fit.weakest)}) {
    if (values->size() == 0) continue;
    checker.same_length(static_cast<size_t>(values->size()), n, key, "parameters");
  }
  checker.need(!(fit.chi_squared < 0), "fit.chi_squared", "a sum of squares is not negative");
  checker.need(!(fit.chi_squared_p < 0 || fit.chi_squared_p > 1), "fit.chi_squared_p", "a probability is from 0 to 1");
  check_parameters(checker, fit);
  check_readings(checker, record);
  check_curves(checker, record.curves, "curves");
  check_curves(checker, record.start_curves, "start_curves");
  check_ensembles(checker, record);
  check_shapes(checker, record);
  if (!record.control_columns.empty())
    checker.same_length(record.control_columns.size(), record.controls.size(), "control_columns", "controls");
  if (!record.channel_columns.empty())
    checker.same_length(record.channel_columns.size(), record.channels.size(), "channel_columns", "channels");
  checker.need(!std::ranges::any_of(fit.history, [&](const SearchStep& step) { return step.values.size() != n; }),
               "fit.history", "a value for each parameter");
  checker.need(record.load_control >= -1, "load.control", "-1 is for none");
  checker.need(record.trend_degree >= 0 && record.trend_degree <= 5, "trend_degree", "a trend has a degree up to 5");
}

}  // namespace taut
