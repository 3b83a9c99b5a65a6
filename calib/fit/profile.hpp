#pragma once
#include <Eigen/Core>
#include <optional>
#include <utility>
#include <vector>

#include "calib/fit/distributions.hpp"
#include "calib/fit/search.hpp"

namespace taut {

constexpr double profile_rise = z95 * z95;  ///< rise of chi squared at the ends of a 95 % profile interval

/// A fall of chi squared that is another minimum: a tenth of a standard error.
constexpr double lower_minimum = 0.01;

/// The optimum that profiles start from, and what they found around it.
struct Surroundings {
  const Minimum& best;
  const Eigen::MatrixXd& covariance;  ///< of the parameters, fitted scale
  Minimum& lowest;                    ///< that was met
  std::vector<Linearised>& met;       ///< the points looked at
};

/// One end of a profile interval: where chi squared, minimised over all other parameters, has risen by `profile_rise`,
/// going from the optimum in direction `sign`. Fitted scale.
class ProfileEnd {
 public:
  /// The covariance says how the other parameters follow, to first order. The points looked at are added to `visited`
  /// too, and the search ends at one that is lower than the optimum.
  ProfileEnd(Evaluator& evaluator, const Surroundings& around, Eigen::Index j, int sign, const FitOptions& options,
             std::vector<std::pair<double, double>>& visited);

  /// Empty when chi squared has not risen so much at the bound, where simulations fail before it has, and, when
  /// `alone`, where it would only because another parameter is at its bound.
  std::optional<double> find(double guess, bool alone);

  /// The same, beyond an `end` that was found, from where another valley of chi squared crosses it, beginning at `all`:
  /// the end that is farther out of both.
  std::optional<double> go_on(double end, const Eigen::VectorXd& all);

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
  void drop_what_is_no_minimum();

  Evaluator& evaluator_;
  const Surroundings& around_;
  const Minimum& best_;
  Eigen::VectorXd slopes_;  ///< covariances with the parameter
  Eigen::Index j_;
  int sign_;
  FitOptions options_;
  std::vector<std::pair<double, double>>& visited_;
  Place inner_, outer_;
  Eigen::VectorXd start_;
};

}  // namespace taut
