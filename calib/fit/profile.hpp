#pragma once
#include <Eigen/Core>
#include <optional>
#include <utility>
#include <vector>

#include "calib/fit/search.hpp"

namespace taut {

constexpr double z95 = 1.959963984540054;   ///< 97.5 % quantile of the normal distribution
constexpr double profile_rise = z95 * z95;  ///< rise of chi squared at the ends of a 95 % profile interval

/// A fall of chi squared that is another minimum: a tenth of a standard error.
constexpr double lower_minimum = 0.01;

/// One end of a profile interval: where chi squared, minimised over all other parameters, has risen by `profile_rise`,
/// going from the optimum in direction `sign`. Fitted scale.
class ProfileEnd {
 public:
  /// `covariance` says how the other parameters follow, to first order. The points looked at are added to `visited`,
  /// and the lowest of them is `lowest` if that was higher; the search ends there.
  ProfileEnd(Evaluator& evaluator, const Minimum& best, const Eigen::MatrixXd& covariance, Eigen::Index j, int sign,
             const FitOptions& options, std::vector<std::pair<double, double>>& visited, Minimum& lowest);

  /// Empty when chi squared has not risen so much at the bound, where simulations fail before it has, and, when
  /// `alone`, where it would only because another parameter is at its bound.
  std::optional<double> find(double guess, bool alone);

 private:
  struct Place {
    double q, rise;
    Eigen::VectorXd all;  ///< parameters, the others where they are best
  };
  Place place_at(double q);
  bool nearly(const Place& place) const;
  bool enclose(double step);
  void narrow();
  bool another_is_at_its_bound() const;

  Evaluator& evaluator_;
  const Minimum& best_;
  Eigen::VectorXd slopes_;  ///< covariances with the parameter
  Eigen::Index j_;
  int sign_;
  FitOptions options_;
  std::vector<std::pair<double, double>>& visited_;
  Minimum& lowest_;
  Place inner_, outer_;
  Eigen::VectorXd start_;
};

}  // namespace taut
