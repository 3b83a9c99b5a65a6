#pragma once
#include <string>
#include <vector>

#include "calib/data/trials.hpp"
#include "calib/fit/fit.hpp"

namespace taut {

/// The readings of a fit, as far as explanations of a misfit ask what they are.
struct ExplainedReadings {
  /// A channel or a control.
  struct Axis {
    std::string id, unit;  ///< SI
  };
  std::vector<Reading> readings;  ///< one per measurement, in their order
  std::vector<Axis> channels, controls;
  std::vector<Axis> assumed;  ///< dimensions and constants that were taken for granted
  int load = -1;              ///< the control over which figures are drawn; the others are held; -1: none
};

/// Something that could be wrong with readings, bench or model, and what the fit would be with it, to first order.
struct Explanation {
  std::string kind;                          ///< "zero error", "exchanged lines", ...: candidates of one kind
  std::string name;                          ///< "a zero error of 'tip'"
  std::string what;                          ///< the same with its value: "a zero error of 'tip': +0.20 +- 0.01 mm"
  std::vector<int> lines;                    ///< of the readings that it is about, where it is not about all
  std::vector<double> values;                ///< its unknowns where they are best, SI; none for an exchange
  std::vector<double> standard_errors;       ///< of these, SI
  std::string unit;                          ///< of these, SI
  double fall = 0;                           ///< of chi squared
  double chi_squared = 0;                    ///< that would be left
  int dof = 0;                               ///< that would be left
  double p_value = 1;                        ///< of so large a fall, corrected for all that was tried
  std::vector<double> shifts;                ///< of each free parameter, SI
  std::vector<std::string> like_parameters;  ///< the free ones that it cannot be told apart from
  std::vector<std::string> like;             ///< names of other explanations that it cannot be told apart from
  std::vector<std::string> includes;         ///< names of those that are special cases of it
};

/// The p-value below which an explanation is told.
inline constexpr double telling_p_value = 1e-3;

/// What would explain a misfit, by linear algebra at the optimum alone. Each explanation adds columns A to the
/// linearised model, r = J d + A b + noise, with r the residuals and J the derivatives on the fitted scale over the
/// sigmas: chi squared falls by the square of r's projection on what is left of A beyond J (as a full least-squares
/// solve would find), and b, its covariance and the parameters' step d follow. Tried are: another value of each number
/// that was taken for granted; zero and scale errors of channels, zero errors for each value of a held control and for
/// each trial; zero and scale errors of controls; drifts from trial to trial and over the file; a modulus or stiffness
/// that differs at each value of a held control, or changes with the load; something that gives way in proportion to
/// the load; each reading off by itself (its value over its standard error is the studentised residual, the shifts are
/// its pull on the parameters); and all pairs of readings of a channel exchanged, with their sigmas, where one of the
/// two is off by 2 of them at least.
///
/// p-values are those of chi squared, and where what is left is still too large for the noise (p < 0.05) those of F
/// against what is left; an exchange has one degree of freedom for its p-value (which bounds it from above) and none in
/// `dof`. Corrected (Bonferroni): each kind counts the same, and each candidate within its kind.
///
/// `prediction` has the derivatives with respect to the free parameters, in the order of `fit.parameters`, and then to
/// the controls and what is assumed, in theirs; SI. Parameters at bounds that hold them do not move. Returns the three
/// best of each kind, best first; none without a degree of freedom. `fit` need not have converged.
std::vector<Explanation> explain_misfit(const ExplainedReadings& readings, const Prediction& prediction,
                                        const std::vector<Measurement>& measurements, const FitResult& fit);

/// Those that are to be told, at most five: p-value below telling_p_value, and neither like a better one nor a special
/// case or a generalisation of it.
std::vector<Explanation> telling(const std::vector<Explanation>& explanations);

}  // namespace taut
