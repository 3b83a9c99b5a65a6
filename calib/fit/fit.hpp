#pragma once
#include <Eigen/Core>
#include <atomic>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "calib/fit/protocol.hpp"

namespace taut {

/// A parameter that a fit may change, with the interval it may move in (SI). Moduli and stiffnesses
/// (ParameterSpec::logarithmic) are fitted as their logarithms.
struct FreeParameter {
  int index = 0;     ///< in the protocol's table
  double start = 0;  ///< SI, as the bounds
  double lower = 0;
  double upper = 0;
  bool bounds_chosen = true;  ///< both bounds come from somebody who knows, not from what is possible at all
};

/// A measured value of one row of the protocol.
struct Measurement {
  int row = 0;       ///< row of the protocol
  double value = 0;  ///< SI
  double sigma = 0;  ///< standard deviation, SI, absolute: not rescaled by the residuals
  int group = 0;     ///< readings of one condition and channel share a group: repeats, whose spread is pure error
};

/// How well the readings determine a parameter; fit.cpp has the limits, experiments/README.md says them in words.
enum class Verdict {
  well_determined,
  weakly_determined,
  bounded_from_one_side,  ///< the interval is open on one side
  tied,                   ///< visible alone, but not to be told apart from another free parameter
  invisible,              ///< the readings do not depend on it within their noise
  at_its_bound,           ///< the readings would move it beyond the bound that it was given
  of_a_wrong_model,       ///< the model misses the readings: what its parameters are worth is not known
  unknown                 ///< the fit has no optimum, or ended before the uncertainty was worked out
};
std::string_view name_of(Verdict verdict);  ///< "well determined"

/// What a fit says of one free parameter.
struct ParameterEstimate {
  ParameterSpec spec;
  double start = 0, lower = 0, upper = 0;  ///< as the fit was given them, SI
  double value = 0;                        ///< SI
  double standard_error = 0;  ///< SI, first order, from the noise alone; NaN when the readings do not define it
  std::optional<double> lower95, upper95;  ///< 95 % interval of the noise, SI; empty: open on that side
  /// 95 % interval of noise and all shares that count (total_interval()), SI; empty: open, or not asked for.
  std::optional<double> total_lower95, total_upper95;
  /// Profile likelihood where it was searched: (value [SI], rise of chi squared minimised over all others), ascending.
  std::vector<std::pair<double, double>> profile;
  Verdict verdict = Verdict::unknown;
  std::string explanation;  ///< one or two sentences for a person: why this verdict, and what would help
};

/// Do repeats scatter as little as the curve misses them? F = (SS_lof / dof_lof) / (SS_pe / dof_pe), sums of squares of
/// noise-scaled residuals, against the F distribution.
struct LackOfFit {
  bool available = false;  ///< needs repeats and more groups than parameters
  double lack_of_fit = 0, pure_error = 0;
  int lack_of_fit_dof = 0, pure_error_dof = 0;
  double F = 0, p_value = 1;
};

/// How a fit ended.
enum class FitStatus { converged, not_converged, start_failed, interrupted };
std::string_view name_of(FitStatus status);  ///< "not converged"

/// What a part of a fit took.
struct FitCost {
  double seconds = 0;
  int factorisations = 0;  ///< Protocol::factorisations
};

/// A point at which a search has asked the model.
struct SearchStep {
  std::string phase;           ///< as FitProgress::phase
  double chi_squared = 0;      ///< NaN where a simulation failed
  std::vector<double> values;  ///< free parameters, SI
};

/// What a fit found: estimates, their uncertainty, and how well the model follows the readings.
struct FitResult {
  FitStatus status = FitStatus::not_converged;
  std::string message;
  std::vector<ParameterEstimate> parameters;
  Eigen::MatrixXd covariance;   ///< of the fitted scale (logarithm for logarithmic parameters), free x free
  Eigen::MatrixXd correlation;  ///< free x free
  Eigen::VectorXd
      singular_values;      ///< of the noise-scaled Jacobian on the fitted scale in units of each one's range (1 for a
                            ///< logarithm), largest first: standard deviations of the readings that a change is worth
  Eigen::VectorXd weakest;  ///< right singular vector of the smallest one: the combination known least
  Params p;                 ///< all parameters at the optimum
  Eigen::VectorXd predicted;      ///< per protocol row, recomputed from the start of the protocol's path, SI
  Eigen::VectorXd prediction_se;  ///< per protocol row: standard error of the curve, SI
  Eigen::VectorXd residuals;      ///< per measurement: measured - predicted, SI
  double chi_squared = 0;         ///< sum of (residual / sigma)^2
  int dof = 0;                    ///< measurements - free parameters
  double chi_squared_p = 1;       ///< probability of a larger chi squared if model and sigmas are right
  LackOfFit lack_of_fit;
  int evaluations = 0;         ///< of the protocol within the fit, profiles not counted
  FitCost search, profiles;    ///< the fit with its final cold replay, and the profiles after it
  int failed_evaluations = 0;  ///< trial points at which a simulation failed; each shortened a step
  int iterations = 0;
  std::vector<SearchStep> history;    ///< in the order of the search, cold replays among them; not of the intervals
  std::vector<std::string> failures;  ///< sentences of the failed simulations, the first few
  std::vector<int> followed;          ///< rows that are predicted in another equilibrium than that of their path
  std::vector<std::string> remarks;   ///< on the way to the optimum, sentences for people
};

/// Whether a chi squared as large as the fit's has a probability below 1e-6 under the declared noise: the model does
/// not describe the readings, or the sigmas are far too small.
bool misses_readings(const FitResult& fit);

/// Where a fit is, for those who watch.
struct FitProgress {
  std::string phase;     ///< "search", "cold replay" of its result, "profile of <id>"
  int evaluation = 0;    ///< how many there have been
  int usually_left = 0;  ///< how many more the phase usually takes; 0: it has taken more than usual
  double chi_squared = 0;
  std::vector<double> values;  ///< free parameters, SI
};

/// How long a fit searches, and how its intervals are found.
struct FitOptions {
  int max_iterations = 60;
  double tolerance = 1e-6;      ///< relative decrease of chi squared at which the fit ends: some thousandths of a sigma
  bool profiles = true;         ///< search interval ends by profile likelihood where the parabola does not hold
  bool all_profiles = false;    ///< and for all other parameters too
  double profile_budget = 200;  ///< what all profiles may cost, in cold replays; intervals after that are parabolas
  Params held;                  ///< values of the parameters that are not free; empty: the protocol's nominal ones
  /// Where the optimum misses the readings (misses_readings(), and their own scatter does not explain it): look for
  /// rows whose readings are in another equilibrium, and search again from other starts.
  bool recover = true;
  double restart_budget = 40;  ///< what those searches may cost, in cold replays
  /// A start that is nearer to an optimum than the one given, from a cheaper model; may be empty.
  std::function<std::vector<FreeParameter>(const std::vector<FreeParameter>&)> better_start;
  /// Told of each parameter, by its place, whose whole range (a factor of e) changes no prediction by 1e-6 standard
  /// deviations at the start; may throw.
  std::function<void(size_t place)> idle;
  const std::atomic<bool>* stop = nullptr;
  std::function<void(const FitProgress&)> progress;
};

/// Standard error of each prediction [SI] from the covariance of the fitted scale, first order: sqrt(diag(D C D^T))
/// with D the derivatives of `prediction` (with respect to the parameters `free`, SI) on that scale. Zeros when
/// `covariance` is empty.
Eigen::VectorXd standard_errors(const Prediction& prediction, const ParameterTable& table, const Params& p,
                                const std::vector<FreeParameter>& free, const Eigen::MatrixXd& covariance);

/// Weighted nonlinear least squares (Ceres, Levenberg-Marquardt): min sum ((measured - predicted(theta)) / sigma)^2
/// within bounds. Displacements are fitted, not stiffnesses: the mean of 1/x is not 1/mean. A simulation that fails
/// shortens the step; only one that fails at the start ends the fit (status start_failed). Standard errors are first
/// order, C = (J^T J)^-1 with the sigmas taken as absolute; intervals are symmetric on the fitted scale (so asymmetric
/// in a modulus) and replaced by profile-likelihood ones where a parameter is not well determined, or where chi squared
/// at one of their ends does not rise as they promise. Where that search meets a lower chi squared, the fit goes on
/// from there. What is reported is a prediction along the protocol's own path; where the fit's way keeps parting from
/// that, each prediction goes it from its start. An optimum that misses the readings is tried from other starts, and
/// with rows in the other one of two equilibria (FitOptions::recover). Without a minimum there are no standard errors,
/// intervals and verdicts; and no profiles where the model misses the readings by far. Throws InputError when there are
/// fewer measurements than free parameters, or a start outside its bounds.
FitResult fit(Protocol& protocol, const std::vector<Measurement>& measurements, const std::vector<FreeParameter>& free,
              const FitOptions& options = {});

}  // namespace taut
