#include "calib/fit/fit.hpp"

#include <ceres/ceres.h>
#include <fmt/format.h>

#include <Eigen/QR>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <limits>

#include "calib/fit/goodness_of_fit.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/stopwatch.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

constexpr double z95 = 1.959963984540054;   ///< 97.5 % quantile of the normal distribution
constexpr double profile_rise = z95 * z95;  ///< rise of chi squared at the ends of a 95 % profile interval

/// The scale on which a parameter is fitted: its logarithm for moduli and stiffnesses, itself otherwise.
struct Scale {
  bool logarithmic;
  double inside(double si) const { return logarithmic ? std::log(si) : si; }
  double outside(double q) const { return logarithmic ? std::exp(q) : q; }
  double slope(double si) const { return logarithmic ? si : 1.0; }  ///< d outside / d inside
};

/// Noise-scaled residuals (predicted - measured) / sigma and their derivatives on the fitted scale, evaluated for
/// Ceres. The newest evaluation is kept, because Ceres asks for residuals first and for derivatives at the same point
/// later.
class Evaluator {
 public:
  Evaluator(Protocol& protocol, const std::vector<Measurement>& measurements, const std::vector<FreeParameter>& free,
            const FitOptions& options)
      : protocol_(protocol), measurements_(measurements), free_(free), options_(options) {
    for (const FreeParameter& parameter : free) {
      indices_.push_back(parameter.index);
      scales_.push_back({protocol.parameters()[parameter.index].logarithmic});
    }
  }

  const Scale& scale(size_t j) const { return scales_[j]; }
  size_t count() const { return free_.size(); }
  bool stopped() const { return options_.stop != nullptr && options_.stop->load(); }

  Params params(const double* q) const {
    Params p = options_.held.size() > 0 ? options_.held : protocol_.nominal();
    for (size_t j = 0; j < count(); ++j) {
      const double si = scales_[j].outside(q[j]);
      p[indices_[j]] = std::clamp(si, free_[j].lower, free_[j].upper);
    }
    return p;
  }

  /// False when a simulation failed.
  bool evaluate(const double* q) {
    const Eigen::Map<const Eigen::VectorXd> point(q, static_cast<Eigen::Index>(count()));
    if (point_.size() > 0 && point_ == point) return ok_;
    point_ = point;
    ++evaluations;
    prediction_ = protocol_.predict(params(q), indices_);
    ok_ = prediction_.complete();
    if (!ok_) {
      ++failed;
      last_failure = point;
      for (const std::string& failure : prediction_.failures) {
        if (failures.size() < 5) failures.push_back(failure);
      }
      return false;
    }
    for (size_t j = 0; j < count(); ++j) {
      prediction_.derivatives.col(static_cast<Eigen::Index>(j)) *= scales_[j].slope(scales_[j].outside(q[j]));
    }
    if (options_.progress) {
      FitProgress progress{evaluations, residuals().squaredNorm(), {}};
      for (size_t j = 0; j < count(); ++j) progress.values.push_back(scales_[j].outside(q[j]));
      options_.progress(progress);
    }
    return true;
  }

  /// Makes the next evaluation ask the protocol even at the same point.
  void reset() {
    point_.resize(0);
    prediction_ = {};
  }

  const Prediction& prediction() const { return prediction_; }
  std::vector<double> point() const { return {point_.begin(), point_.end()}; }  ///< of the newest evaluation

  Eigen::VectorXd residuals() const {
    Eigen::VectorXd r(static_cast<Eigen::Index>(measurements_.size()));
    for (size_t i = 0; i < measurements_.size(); ++i) {
      const Measurement& m = measurements_[i];
      r[static_cast<Eigen::Index>(i)] = (prediction_.values[m.row] - m.value) / m.sigma;
    }
    return r;
  }

  Eigen::MatrixXd jacobian() const {
    Eigen::MatrixXd J(static_cast<Eigen::Index>(measurements_.size()), static_cast<Eigen::Index>(count()));
    for (size_t i = 0; i < measurements_.size(); ++i) {
      J.row(static_cast<Eigen::Index>(i)) = prediction_.derivatives.row(measurements_[i].row) / measurements_[i].sigma;
    }
    return J;
  }

  int evaluations = 0, failed = 0;
  std::vector<std::string> failures;
  Eigen::VectorXd last_failure;  ///< where the last simulation failed, fitted scale; empty: none did

 private:
  Protocol& protocol_;
  const std::vector<Measurement>& measurements_;
  const std::vector<FreeParameter>& free_;
  const FitOptions& options_;
  std::vector<int> indices_;
  std::vector<Scale> scales_;
  Eigen::VectorXd point_;
  Prediction prediction_;
  bool ok_ = false;
};

/// All residuals as one block, because one simulation yields them all.
class ResidualBlock final : public ceres::CostFunction {
 public:
  ResidualBlock(Evaluator& evaluator, size_t measurements) : evaluator_(evaluator) {
    set_num_residuals(static_cast<int>(measurements));
    for (size_t j = 0; j < evaluator.count(); ++j) mutable_parameter_block_sizes()->push_back(1);
  }
  bool Evaluate(double const* const* blocks, double* residuals, double** jacobians) const override {
    std::vector<double> q(evaluator_.count());
    for (size_t j = 0; j < q.size(); ++j) q[j] = blocks[j][0];
    if (!evaluator_.evaluate(q.data())) return false;
    Eigen::Map<Eigen::VectorXd>(residuals, num_residuals()) = evaluator_.residuals();
    if (jacobians == nullptr) return true;
    const Eigen::MatrixXd J = evaluator_.jacobian();
    for (size_t j = 0; j < q.size(); ++j) {
      if (jacobians[j] != nullptr)
        Eigen::Map<Eigen::VectorXd>(jacobians[j], num_residuals()) = J.col(static_cast<Eigen::Index>(j));
    }
    return true;
  }

 private:
  Evaluator& evaluator_;
};

/// What a change of a parameter is compared with: one for a logarithm, else the range that it may have.
double range_of(const FreeParameter& parameter, const Scale& scale, double value) {
  if (scale.logarithmic) return 1;
  const double range = parameter.upper - parameter.lower;
  return std::isfinite(range) ? range : std::max(std::abs(value), 1e-12);
}

/// Decrease of chi squared that a Gauss-Newton step from `q` promises, where the residuals are r with derivatives J; it
/// is the square of the step in standard errors. Parameters at bounds that hold them do not count, nor does `held`.
double promised_decrease(const Evaluator& evaluator, const std::vector<FreeParameter>& free,
                         const std::vector<double>& q, const Eigen::VectorXd& r, const Eigen::MatrixXd& J, int held) {
  Eigen::MatrixXd open = J;
  for (size_t j = 0; j < q.size(); ++j) {
    const Eigen::Index k = static_cast<Eigen::Index>(j);
    const Scale& scale = evaluator.scale(j);
    const double range = range_of(free[j], scale, scale.outside(q[j])), downhill = -J.col(k).dot(r);
    const double room = downhill > 0 ? scale.inside(free[j].upper) - q[j] : q[j] - scale.inside(free[j].lower);
    if (room < 1e-6 * range || static_cast<int>(j) == held) open.col(k).setZero();
  }
  return (open * open.completeOrthogonalDecomposition().solve(r)).squaredNorm();
}

/// Ends a search that is interrupted, or that has nothing more to gain: that saves the evaluation which would show it.
class StopCallback final : public ceres::IterationCallback {
 public:
  StopCallback(const Evaluator& evaluator, const std::vector<FreeParameter>& free, int held, double tolerance)
      : evaluator_(evaluator), free_(free), held_(held), tolerance_(tolerance) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary& summary) override {
    if (evaluator_.stopped()) return ceres::SOLVER_TERMINATE_SUCCESSFULLY;  // the best values so far are kept
    if (!summary.step_is_successful) return ceres::SOLVER_CONTINUE;
    const Eigen::VectorXd r = evaluator_.residuals();
    const double promised = promised_decrease(evaluator_, free_, evaluator_.point(), r, evaluator_.jacobian(), held_);
    return promised <= 0.1 * tolerance_ * r.squaredNorm() ? ceres::SOLVER_TERMINATE_SUCCESSFULLY
                                                          : ceres::SOLVER_CONTINUE;
  }

 private:
  const Evaluator& evaluator_;
  const std::vector<FreeParameter>& free_;
  int held_;
  double tolerance_;
};

/// Lets a protocol search while it lives.
struct Search {
  Protocol& protocol;
  explicit Search(Protocol& searching) : protocol(searching) { protocol.begin_search(); }
  Search(const Search&) = delete;
  Search& operator=(const Search&) = delete;
  ~Search() { protocol.end_search(); }
};

struct Minimum {
  ceres::Solver::Summary summary;
  std::vector<double> q;
  double chi_squared = not_a_number;
};

constexpr double damped = 1, undamped = 1e4;  ///< trust-region radii: half a Gauss-Newton step, the whole step

/// Levenberg-Marquardt from `q` with bounds; parameter `held` keeps its value.
Minimum minimise(Evaluator& evaluator, const std::vector<FreeParameter>& free, size_t measurements,
                 std::vector<double> q, int held, double radius, const FitOptions& options) {
  Minimum minimum;
  minimum.q = q;
  if (!evaluator.evaluate(q.data())) {  // Ceres would say so on stderr
    minimum.summary.message = "the simulation failed at the start";
    return minimum;
  }
  ceres::Problem::Options problem_options;
  problem_options.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ResidualBlock block(evaluator, measurements);
  ceres::Problem problem(problem_options);
  std::vector<double*> blocks;
  for (double& value : q) blocks.push_back(&value);
  problem.AddResidualBlock(&block, nullptr, blocks);
  for (size_t j = 0; j < free.size(); ++j) {
    const Scale& scale = evaluator.scale(j);
    if (static_cast<int>(j) == held) {
      problem.SetParameterBlockConstant(&q[j]);
      continue;
    }
    if (std::isfinite(free[j].lower)) problem.SetParameterLowerBound(&q[j], 0, scale.inside(free[j].lower));
    if (std::isfinite(free[j].upper)) problem.SetParameterUpperBound(&q[j], 0, scale.inside(free[j].upper));
  }
  StopCallback stop(evaluator, free, held, options.tolerance);
  ceres::Solver::Options solver;
  solver.linear_solver_type = ceres::DENSE_QR;
  solver.max_num_iterations = options.max_iterations;
  solver.function_tolerance = options.tolerance;
  solver.parameter_tolerance = 1e-10;
  solver.gradient_tolerance = 1e-12;
  solver.initial_trust_region_radius = radius;
  solver.max_num_consecutive_invalid_steps = 20;  // failed simulations shorten the step, they do not end the fit
  solver.logging_type = ceres::SILENT;
  solver.callbacks.push_back(&stop);
  ceres::Solve(solver, &problem, &minimum.summary);
  minimum.q = q;
  minimum.chi_squared = 2 * minimum.summary.final_cost;
  return minimum;
}

/// One Gauss-Newton step from `q` in the reciprocals of the logarithmic parameters (1/E instead of ln E): displacements
/// of a linear solid are linear in those, so that a start a few times off comes near at once. At most a factor of
/// three, because far from the truth the solid is not linear. Returns whether `q` moved; it stays when that does not
/// lower chi squared.
bool step_in_compliance(Evaluator& evaluator, const std::vector<FreeParameter>& free, std::vector<double>& q) {
  if (!evaluator.evaluate(q.data()) || evaluator.stopped()) return false;
  const Eigen::VectorXd r = evaluator.residuals();
  // A least-squares step of minimum norm: parameters that the readings do not see stay where they are.
  const Eigen::VectorXd step = -evaluator.jacobian().completeOrthogonalDecomposition().solve(r);
  std::vector<double> trial = q;
  for (size_t j = 0; j < q.size(); ++j) {
    const Scale& scale = evaluator.scale(j);
    const double d = step[static_cast<Eigen::Index>(j)];
    trial[j] += scale.logarithmic ? -std::log1p(-std::clamp(d, -2.0, 2.0 / 3.0)) : d;
    trial[j] = std::clamp(trial[j], scale.inside(free[j].lower), scale.inside(free[j].upper));
  }
  if (trial == q || !evaluator.evaluate(trial.data()) || !(evaluator.residuals().squaredNorm() < r.squaredNorm()))
    return false;
  q = trial;
  return true;
}

/// Where chi squared, minimised over all other parameters, has risen by `profile_rise`, going from the optimum in
/// direction `sign`; empty when it has not at the bound, where simulations fail before it has, and, when `alone`, where
/// it would only because another parameter is at its bound. Fitted scale. `covariance` says how the others follow, to
/// first order. The points looked at are added to `visited`.
std::optional<double> profile_end(Evaluator& evaluator, const std::vector<FreeParameter>& free, size_t measurements,
                                  const Minimum& best, const Eigen::MatrixXd& covariance, size_t j, int sign,
                                  double guess, bool alone, const FitOptions& options,
                                  std::vector<std::pair<double, double>>& visited) {
  const Scale& scale = evaluator.scale(j);
  const double bound = scale.inside(sign > 0 ? free[j].upper : free[j].lower);
  FitOptions coarse = options;
  coarse.tolerance =
      std::min(1e-3, 0.005 * profile_rise / std::max(best.chi_squared, 1e-12));  // of the rise: half a per cent
  std::vector<double> start = best.q;
  auto rise_at = [&](double q) {
    const Eigen::Index k = static_cast<Eigen::Index>(j);
    const double moved = q - start[j];
    for (size_t i = 0; i < free.size(); ++i) {
      const double lower = evaluator.scale(i).inside(free[i].lower), upper = evaluator.scale(i).inside(free[i].upper);
      start[i] =
          std::clamp(start[i] + moved * covariance(static_cast<Eigen::Index>(i), k) / covariance(k, k), lower, upper);
    }
    start[j] = q;
    double rise = std::numeric_limits<double>::infinity();
    if (free.size() == 1) {
      if (evaluator.evaluate(start.data())) rise = evaluator.residuals().squaredNorm() - best.chi_squared;
    } else {
      const Minimum there = minimise(evaluator, free, measurements, start, static_cast<int>(j), undamped, coarse);
      if (there.summary.termination_type != ceres::FAILURE) {
        start = there.q;
        rise = there.chi_squared - best.chi_squared;
      }
    }
    if (std::isfinite(rise)) visited.emplace_back(scale.outside(q), rise);
    return rise;
  };
  // So near the end, the rest of the way is a fraction of the way so far, if the rise is a parabola as expected.
  const double parabola = z95 * std::sqrt(covariance(static_cast<Eigen::Index>(j), static_cast<Eigen::Index>(j)));
  auto nearly = [&](double q, double rise) {
    const bool expected = std::abs(std::abs(q - best.q[j]) / parabola - 1) < 0.3;
    return std::abs(rise / profile_rise - 1) < (expected ? 0.05 : 0.01);
  };
  double inner = best.q[j], inner_rise = 0, step = std::max(guess, 1e-6);
  double outer = inner, outer_rise = 0;
  std::vector<double> beyond = start;  // all parameters at `outer`
  for (int expansion = 0; expansion < 12; ++expansion, step *= 2) {
    if (evaluator.stopped()) return std::nullopt;
    outer = inner + sign * step;
    const bool at_bound = sign > 0 ? outer >= bound : outer <= bound;
    if (at_bound) outer = bound;
    outer_rise = rise_at(outer);
    beyond = start;
    if (outer_rise >= profile_rise || nearly(outer, outer_rise)) break;
    if (at_bound) return std::nullopt;
    inner = outer;
    inner_rise = outer_rise;
  }
  if (nearly(outer, outer_rise))
    inner = outer = best.q[j] + (outer - best.q[j]) * std::sqrt(profile_rise / outer_rise);
  else if (outer_rise < profile_rise)
    return std::nullopt;
  for (int i = 0; i < 12 && std::abs(outer - inner) > 1e-3 * std::max(std::abs(outer - best.q[j]), 1e-12); ++i) {
    if (evaluator.stopped()) break;
    // The rise is nearly quadratic, so its root is nearly linear; bisect when that is of no use.
    const double a = std::sqrt(std::max(inner_rise, 0.0)), b = std::sqrt(outer_rise), target = std::sqrt(profile_rise);
    double t = std::isfinite(b) && b > a ? (target - a) / (b - a) : 0.5;
    t = i % 3 == 2 ? 0.5 : std::clamp(t, 0.05, 0.95);
    const double middle = inner + t * (outer - inner), rise = rise_at(middle);
    if (nearly(middle, rise)) {
      inner = outer = middle;
      beyond = start;
      break;
    }
    if (rise >= profile_rise) {
      outer = middle;
      outer_rise = rise;
      beyond = start;
    } else {
      inner = middle;
      inner_rise = rise;
    }
  }
  if (!std::isfinite(outer_rise)) return std::nullopt;
  for (size_t i = 0; alone && i < free.size(); ++i) {
    const double margin = 1e-6 * range_of(free[i], evaluator.scale(i), evaluator.scale(i).outside(beyond[i]));
    const double room = std::min(beyond[i] - evaluator.scale(i).inside(free[i].lower),
                                 evaluator.scale(i).inside(free[i].upper) - beyond[i]);
    if (i != j && room < margin) return std::nullopt;
  }
  return 0.5 * (inner + outer);
}

/// True when a simulation failed beside `q` although chi squared still falls there: r, J are those at `q`.
bool stopped_by_failures(const Evaluator& evaluator, const std::vector<FreeParameter>& free,
                         const std::vector<double>& q, const Eigen::VectorXd& r, const Eigen::MatrixXd& J) {
  if (evaluator.last_failure.size() == 0) return false;
  for (size_t j = 0; j < q.size(); ++j) {
    const Scale& scale = evaluator.scale(j);
    const double range = range_of(free[j], scale, scale.outside(q[j]));
    if (std::abs(evaluator.last_failure[static_cast<Eigen::Index>(j)] - q[j]) > 1e-2 * range) return false;
  }
  return promised_decrease(evaluator, free, q, r, J, -1) > std::max(1e-3, 1e-6 * r.squaredNorm());
}

/// How far a parameter is from being known, as a number without unit: its standard error on the fitted scale, for
/// parameters that are not logarithmic as a fraction of the range it may have.
struct Spread {
  double joint, alone;
};

constexpr double well = 0.1, weak = 0.7;

Verdict verdict_of(const Spread& spread) {
  if (spread.joint <= well) return Verdict::well_determined;
  if (spread.joint <= weak) return Verdict::weakly_determined;
  return spread.alone <= weak ? Verdict::tied : Verdict::invisible;
}

std::string explain(const ParameterEstimate& e, const Spread& spread, const std::string& partner, double correlation,
                    bool at_bound) {
  const std::string known_to =
      e.spec.logarithmic
          ? fmt::format("{:.2g} %", 100 * spread.joint)
          : fmt::format("{} ({:.2g} % of its range)", with_unit(e.standard_error, e.spec.unit, 2), 100 * spread.joint);
  std::string text;
  switch (e.verdict) {
    case Verdict::well_determined:
      text = fmt::format("The readings determine {} to {}.", e.spec.id, known_to);
      break;
    case Verdict::weakly_determined:
      text = fmt::format(
          "The readings determine {} to {} only: its value is a rough one; more repeats or loads at which it "
          "matters more would help.",
          e.spec.id, known_to);
      break;
    case Verdict::bounded_from_one_side:
      text = fmt::format(
          "The readings say that {} is {} {} and nothing more: {} it no longer changes the predictions by more than "
          "the noise; "
          "take the value from elsewhere and fix it.",
          e.spec.id, e.lower95 ? "above" : "below", with_unit(e.lower95 ? *e.lower95 : *e.upper95, e.spec.unit),
          e.lower95 ? "beyond that" : "below that");
      break;
    case Verdict::tied:
      text = fmt::format(
          "The readings see {} but cannot tell it from {}: a change of one is made up for by the other; fix one of "
          "them from another "
          "measurement, or add loads that separate them.",
          e.spec.id, partner.empty() ? "the other parameters" : partner);
      break;
    case Verdict::invisible:
      text = fmt::format(
          "The readings do not depend on {} within their noise: its value is where the search happened to be, not a "
          "result; fix it, or measure where it matters.",
          e.spec.id);
      break;
    case Verdict::unknown:
      break;
  }
  if ((e.verdict == Verdict::well_determined || e.verdict == Verdict::weakly_determined) &&
      std::abs(correlation) > 0.9) {
    text += fmt::format(" It is correlated with {} ({:.2f}).", partner, correlation);
  }
  if (at_bound && e.verdict != Verdict::bounded_from_one_side)
    text +=
        " The fit ended at a bound that was set, not at what the readings prefer: widen the bound or ask whether the "
        "model fits.";
  return text;
}

/// A fit in its steps.
class Fit {
 public:
  Fit(Protocol& protocol, const std::vector<Measurement>& measurements, const std::vector<FreeParameter>& free,
      const FitOptions& options)
      : protocol_(protocol),
        measurements_(measurements),
        free_(free),
        options_(options),
        evaluator_(protocol, measurements, free, options),
        last_(protocol, measurements, free, options),
        factorisations_(protocol.factorisations()) {}

  FitResult run() {
    set_start();
    search();
    result_.search = cost_so_far();
    list_estimates();
    if (last_.prediction().values.size() == 0 || !last_.prediction().complete()) return std::move(result_);
    judge_fit();
    find_covariance();
    {
      const Search profiles(protocol_);
      for (size_t j = 0; j < free_.size(); ++j) judge_parameter(j);
    }
    result_.profiles = cost_so_far();
    return std::move(result_);
  }

 private:
  void set_start() {
    for (size_t j = 0; j < free_.size(); ++j) {
      const FreeParameter& free = free_[j];
      const ParameterSpec& spec = protocol_.parameters()[free.index];
      if (!(free.lower < free.upper) || !(free.start >= free.lower && free.start <= free.upper)) {
        throw InputError(fmt::format("{}: the start {:.6g} {} must lie between its bounds {:.6g} and {:.6g}", spec.id,
                                     free.start, spec.unit, free.lower, free.upper));
      }
      best_.q.push_back(evaluator_.scale(j).inside(free.start));
    }
  }

  FitCost cost_so_far() {
    const FitCost cost{watch_.seconds(), protocol_.factorisations() - factorisations_};
    watch_ = Stopwatch();
    factorisations_ = protocol_.factorisations();
    return cost;
  }

  FitStatus search_status() const {
    if (evaluator_.stopped()) return FitStatus::interrupted;
    if (best_.summary.IsSolutionUsable() && best_.summary.termination_type != ceres::NO_CONVERGENCE)
      return FitStatus::converged;
    return evaluator_.failed > 0 && evaluator_.failed == evaluator_.evaluations ? FitStatus::start_failed
                                                                                : FitStatus::not_converged;
  }

  void search_once(bool first) {
    const Search searching(protocol_);
    const bool near = !first || step_in_compliance(evaluator_, free_, best_.q);
    best_ = minimise(evaluator_, free_, measurements_.size(), best_.q, -1, near ? undamped : damped, options_);
  }

  /// Whether the cold path finds the same chi squared, or nearly, and within a thirtieth of a standard error of the
  /// optimum on the protocol's own path.
  bool agrees(double again) const {
    const double apart = std::abs(again - best_.chi_squared) / (1 + best_.chi_squared);
    if (apart <= 1e-6) return true;
    return apart <= 1e-2 && promised_decrease(last_, free_, best_.q, last_.residuals(), last_.jacobian(), -1) <=
                                std::max(1e-3, 1e-5 * again);
  }

  /// What is reported is computed once more from the start of the protocol's path, without the fit's history. Should
  /// the history have led to another equilibrium than that path does, the fit goes on from there.
  void search() {
    for (int round = 0; round < 3; ++round) {
      last_.reset();
      search_once(round == 0);
      result_.iterations += std::max(0, static_cast<int>(best_.summary.iterations.size()) - 1);
      result_.message = best_.summary.termination_type == ceres::USER_SUCCESS ? "a further step promises nothing more"
                                                                              : best_.summary.message;
      result_.status = search_status();
      if (result_.status == FitStatus::start_failed || result_.status == FitStatus::interrupted) break;
      protocol_.forget();
      last_.reset();
      if (!last_.evaluate(best_.q.data())) {
        result_.status = last_.stopped() ? FitStatus::interrupted : FitStatus::not_converged;
        result_.message =
            "the optimum could not be computed again from the start of the path: " + last_.failures.front();
        break;
      }
      const double again = last_.residuals().squaredNorm();
      if (agrees(again)) break;
      evaluator_.reset();
      if (round < 2) continue;
      result_.status = FitStatus::not_converged;
      result_.message = fmt::format(
          "chi squared is {:.6g} on the fit's way and {:.6g} on the protocol's own path: there is more than one "
          "equilibrium",
          best_.chi_squared, again);
    }
    result_.evaluations = evaluator_.evaluations + last_.evaluations;
    result_.failed_evaluations = evaluator_.failed;
    result_.failures = evaluator_.failures;
  }

  void list_estimates() {
    for (size_t j = 0; j < free_.size(); ++j) {
      ParameterEstimate& estimate = result_.parameters.emplace_back();
      estimate.spec = protocol_.parameters()[free_[j].index];
      estimate.start = free_[j].start;
      estimate.lower = free_[j].lower;
      estimate.upper = free_[j].upper;
      estimate.value = evaluator_.scale(j).outside(best_.q[j]);
      estimate.standard_error = not_a_number;
    }
    result_.p = evaluator_.params(best_.q.data());
  }

  void judge_fit() {
    result_.predicted = last_.prediction().values;
    const Eigen::VectorXd r = last_.residuals();
    jacobian_ = last_.jacobian();
    best_.chi_squared = result_.chi_squared = r.squaredNorm();
    if (result_.status == FitStatus::converged && stopped_by_failures(evaluator_, free_, best_.q, r, jacobian_)) {
      result_.status = FitStatus::not_converged;
      result_.message =
          "the fit ended where simulations fail, before it was at a minimum: " + evaluator_.failures.front();
    }
    result_.residuals.resize(r.size());
    for (Eigen::Index i = 0; i < r.size(); ++i)
      result_.residuals[i] = -r[i] * measurements_[static_cast<size_t>(i)].sigma;
    result_.dof = static_cast<int>(measurements_.size()) - static_cast<int>(free_.size());
    result_.chi_squared_p = chi_squared_probability(result_.chi_squared, result_.dof);
    result_.lack_of_fit = lack_of_fit(measurements_, result_.chi_squared, free_.size());
  }

  /// Directions that the readings do not see get a deviation of a hundred ranges instead of a pseudo-inverse's zero;
  /// more than that would drown in rounding what they do see.
  void find_covariance() {
    const Eigen::Index n = static_cast<Eigen::Index>(free_.size());
    ranges_.resize(n);
    for (size_t j = 0; j < free_.size(); ++j)
      ranges_[static_cast<Eigen::Index>(j)] = range_of(free_[j], evaluator_.scale(j), result_.parameters[j].value);
    const Eigen::JacobiSVD<Eigen::MatrixXd> svd(jacobian_ * ranges_.asDiagonal(),
                                                Eigen::ComputeThinU | Eigen::ComputeThinV);
    result_.singular_values = svd.singularValues();
    result_.weakest = svd.matrixV().col(n - 1);
    const Eigen::VectorXd inverse = svd.singularValues().cwiseMax(0.01).cwiseInverse();
    const Eigen::MatrixXd root = ranges_.asDiagonal() * svd.matrixV() * inverse.asDiagonal();
    result_.covariance = root * root.transpose();
    deviations_ = root.rowwise().norm();
    result_.correlation =
        deviations_.cwiseInverse().asDiagonal() * result_.covariance * deviations_.cwiseInverse().asDiagonal();
    const Eigen::MatrixXd& D = last_.prediction().derivatives;  // on the fitted scale already
    result_.prediction_se = (D * root).rowwise().norm();
  }

  /// Verdict, interval and the words for them.
  void judge_parameter(size_t j) {
    ParameterEstimate& estimate = result_.parameters[j];
    const Scale& scale = evaluator_.scale(j);
    const Eigen::Index k = static_cast<Eigen::Index>(j);
    const Spread spread{deviations_[k] / ranges_[k], 1 / std::max(jacobian_.col(k).norm(), 1e-150) / ranges_[k]};
    estimate.verdict = verdict_of(spread);
    estimate.standard_error = spread.joint < 10 ? deviations_[k] * scale.slope(estimate.value) : not_a_number;
    find_interval(j);
    std::string partner;
    double strongest = 0;
    for (size_t i = 0; i < free_.size(); ++i) {
      const double c = result_.correlation(k, static_cast<Eigen::Index>(i));
      if (i != j && std::abs(c) > std::abs(strongest)) {
        strongest = c;
        partner = result_.parameters[i].spec.id;
      }
    }
    const double margin = 1e-6 * ranges_[k];
    const bool at_bound =
        best_.q[j] - scale.inside(estimate.lower) < margin || scale.inside(estimate.upper) - best_.q[j] < margin;
    estimate.explanation = explain(estimate, spread, partner, strongest, at_bound);
  }

  /// The parabola's interval, or where that cannot be trusted that of the profile likelihood.
  void find_interval(size_t j) {
    ParameterEstimate& estimate = result_.parameters[j];
    const Scale& scale = evaluator_.scale(j);
    const double reach = z95 * deviations_[static_cast<Eigen::Index>(j)];
    const double lower = best_.q[j] - reach, upper = best_.q[j] + reach;
    const bool doubtful = estimate.verdict != Verdict::well_determined || lower < scale.inside(estimate.lower) ||
                          upper > scale.inside(estimate.upper);
    std::optional<double> low = lower, high = upper;
    if (doubtful) low = high = std::nullopt;
    if (options_.profiles && (doubtful || options_.all_profiles) && !evaluator_.stopped()) {
      const double range = ranges_[static_cast<Eigen::Index>(j)];
      const double guess = std::min(reach, scale.logarithmic ? 1.0 : 0.25 * range);
      estimate.profile.emplace_back(estimate.value, 0.0);
      auto end = [&](int sign) {
        return profile_end(evaluator_, free_, measurements_.size(), best_, result_.covariance, j, sign, guess,
                           estimate.verdict == Verdict::tied, options_, estimate.profile);
      };
      const std::optional<double> down = end(-1), up = end(+1);
      if (!evaluator_.stopped()) {  // half a search is worth less than the parabola, or than nothing
        low = down;
        high = up;
      }
      std::sort(estimate.profile.begin(), estimate.profile.end());
    }
    if (doubtful) {
      if (estimate.verdict != Verdict::well_determined && low.has_value() != high.has_value())
        estimate.verdict = Verdict::bounded_from_one_side;
      if (estimate.verdict == Verdict::invisible && low && high) estimate.verdict = Verdict::weakly_determined;
    }
    if (low) estimate.lower95 = scale.outside(*low);
    if (high) estimate.upper95 = scale.outside(*high);
  }

  Protocol& protocol_;
  const std::vector<Measurement>& measurements_;
  const std::vector<FreeParameter>& free_;
  const FitOptions& options_;
  Evaluator evaluator_, last_;  ///< of the search; of the cold replay after it
  Stopwatch watch_;
  int factorisations_;
  Minimum best_;
  FitResult result_;
  Eigen::MatrixXd jacobian_;             ///< at the end, fitted scale
  Eigen::VectorXd ranges_, deviations_;  ///< per parameter, fitted scale
};

}  // namespace

std::string_view name_of(Verdict verdict) {
  switch (verdict) {
    case Verdict::well_determined:
      return "well determined";
    case Verdict::weakly_determined:
      return "weakly determined";
    case Verdict::bounded_from_one_side:
      return "bounded from one side";
    case Verdict::tied:
      return "tied";
    case Verdict::invisible:
      return "invisible";
    case Verdict::unknown:
      return "unknown";
  }
  return "";
}

std::string_view name_of(FitStatus status) {
  switch (status) {
    case FitStatus::converged:
      return "converged";
    case FitStatus::not_converged:
      return "not converged";
    case FitStatus::start_failed:
      return "start failed";
    case FitStatus::interrupted:
      return "interrupted";
  }
  return "";
}

Eigen::VectorXd standard_errors(const Prediction& prediction, const ParameterTable& table, const Params& p,
                                const std::vector<FreeParameter>& free, const Eigen::MatrixXd& covariance) {
  if (covariance.size() == 0) return Eigen::VectorXd::Zero(prediction.values.size());
  Eigen::MatrixXd D = prediction.derivatives;
  for (size_t j = 0; j < free.size(); ++j) {
    D.col(static_cast<Eigen::Index>(j)) *= Scale{table[free[j].index].logarithmic}.slope(p[free[j].index]);
  }
  return (D * covariance * D.transpose()).diagonal().cwiseMax(0.0).cwiseSqrt();
}

FitResult fit(Protocol& protocol, const std::vector<Measurement>& measurements, const std::vector<FreeParameter>& free,
              const FitOptions& options) {
  if (free.empty()) throw InputError("there is no free parameter to fit; name at least one under [fit.free]");
  if (measurements.size() < free.size()) {
    throw InputError(fmt::format("{} readings cannot determine {} parameters; add readings or fix parameters",
                                 measurements.size(), free.size()));
  }
  return Fit(protocol, measurements, free, options).run();
}

}  // namespace taut
