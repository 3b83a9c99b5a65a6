#include "calib/fit/robust.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "calib/fit/gauss_newton.hpp"
#include "calib/fit/goodness_of_fit.hpp"
#include "sim/core/dense.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

constexpr double student_dof = 4;
constexpr int most_predictions = 12;

/// The measurements with the sigmas that least squares would need to give them Student's weights at these residuals.
std::vector<Measurement> reweighted(std::vector<Measurement> measurements, const Eigen::VectorXd& residuals) {
  for (size_t i = 0; i < measurements.size(); ++i) {
    const double r = residuals[static_cast<Eigen::Index>(i)];
    measurements[i].sigma *= std::sqrt((student_dof + r * r) / (student_dof + 1));
  }
  return measurements;
}

/// Parameters on the way, with what is predicted there.
struct RobustPlace {
  Params p;
  Prediction prediction;
  NoiseScaled scaled;  ///< derivatives on the fitted scale
  double cost() const { return (1 + scaled.residuals.array().square() / student_dof).log().sum(); }
  /// How far a step goes, in standard errors.
  double length(const Eigen::VectorXd& step) const { return (scaled.jacobian * step).norm(); }
};

class RobustSearch {
 public:
  RobustSearch(Protocol& protocol, const std::vector<Measurement>& measurements, const std::vector<FreeParameter>& free)
      : protocol_(protocol), measurements_(measurements), free_(free) {
    for (const FreeParameter& parameter : free) indices_.push_back(parameter.index);
  }

  RobustPlace at(const Params& p) const {
    RobustPlace place{p, protocol_.predict(p, indices_), {}};
    if (!place.prediction.complete()) throw InputError(place.prediction.failures.front());
    place.scaled = noise_scaled(place.prediction, measurements_);
    for (size_t j = 0; j < free_.size(); ++j) place.scaled.jacobian.col(static_cast<Eigen::Index>(j)) *= slope(p, j);
    return place;
  }

  /// To where the reweighted least squares of the linearised model end, fitted scale.
  Eigen::VectorXd step(const RobustPlace& from) const {
    Eigen::VectorXd step = Eigen::VectorXd::Zero(from.scaled.jacobian.cols());
    for (int round = 0; round < 100; ++round) {
      const Eigen::VectorXd there = from.scaled.residuals + from.scaled.jacobian * step;
      const Eigen::VectorXd next =
          gauss_newton_step(from.prediction, reweighted(measurements_, there), protocol_.parameters(), from.p, free_);
      const double change = from.length(next - step);
      step = next;
      if (change < 1e-3) break;
    }
    return step;
  }

  Params moved(Params p, const Eigen::VectorXd& step) const {
    for (size_t j = 0; j < free_.size(); ++j) {
      const double by = step[static_cast<Eigen::Index>(j)];
      double& value = p[free_[j].index];
      value = std::clamp(logarithmic(j) ? value * std::exp(by) : value + by, free_[j].lower, free_[j].upper);
    }
    return p;
  }

  std::vector<double> standard_errors(const RobustPlace& place) const {
    Eigen::VectorXd units(place.scaled.jacobian.cols());
    for (size_t j = 0; j < free_.size(); ++j)
      units[static_cast<Eigen::Index>(j)] = scale_of(free_[j], protocol_.parameters(), place.p) / slope(place.p, j);
    const auto [U, s, V] = singular_values(place.scaled.jacobian * units.asDiagonal());
    const Eigen::MatrixXd root = units.asDiagonal() * V * s.cwiseMax(0.01).cwiseInverse().asDiagonal();
    std::vector<double> errors;
    for (size_t j = 0; j < free_.size(); ++j)
      errors.push_back(std::sqrt((student_dof + 3) / (student_dof + 1)) *
                       root.row(static_cast<Eigen::Index>(j)).norm() * slope(place.p, j));
    return errors;
  }

 private:
  bool logarithmic(size_t j) const { return protocol_.parameters()[free_[j].index].logarithmic; }
  /// d SI / d fitted scale.
  double slope(const Params& p, size_t j) const { return logarithmic(j) ? p[free_[j].index] : 1; }

  Protocol& protocol_;
  const std::vector<Measurement>& measurements_;
  const std::vector<FreeParameter>& free_;
  std::vector<int> indices_;
};

}  // namespace

RobustFit robust_fit(Protocol& protocol, const std::vector<Measurement>& measurements,
                     const std::vector<FreeParameter>& free, const FitResult& fit) {
  const RobustSearch search(protocol, measurements, free);
  RobustPlace best = search.at(fit.p);
  RobustFit found{"Student's t, 4 degrees of freedom", {}, {}, {}, 1};
  for (Eigen::VectorXd step = search.step(best); best.length(step) > 0.02;) {
    if (found.evaluations == most_predictions)
      throw InputError(fmt::format("it did not converge within {} predictions", most_predictions));
    RobustPlace next = search.at(search.moved(best.p, step));
    ++found.evaluations;
    const bool lower = next.cost() < best.cost();
    if (lower) best = std::move(next);
    step = lower ? search.step(best) : Eigen::VectorXd(0.5 * step);  // too far for the linearised model
  }
  for (const FreeParameter& parameter : free) found.values.push_back(best.p[parameter.index]);
  found.standard_errors = search.standard_errors(best);
  found.residuals = -best.scaled.residuals;
  return found;
}

}  // namespace taut
