#include "calib/fit/fit.hpp"

#include <ceres/ceres.h>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "calib/fit/goodness_of_fit.hpp"
#include "sim/core/dense.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/stopwatch.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

constexpr double z95 = 1.959963984540054;   ///< 97.5 % quantile of the normal distribution
constexpr double profile_rise = z95 * z95;  ///< rise of chi squared at the ends of a 95 % profile interval

/// A fall of chi squared that is another minimum: a tenth of a standard error.
constexpr double lower_minimum = 0.01;

/// A free parameter on the scale on which it is fitted: its logarithm for moduli and stiffnesses, itself otherwise.
struct Scale {
  bool logarithmic;
  double lower = 0, upper = 0;  ///< bounds, fitted scale

  double inside(double si) const { return logarithmic ? std::log(si) : si; }
  double outside(double q) const { return logarithmic ? std::exp(q) : q; }
  double slope(double si) const { return logarithmic ? si : 1.0; }  ///< d outside / d inside
  double clamped(double q) const { return std::clamp(q, lower, upper); }
  double room(double q) const { return std::min(q - lower, upper - q); }
  /// What a change of the parameter at q is compared with: one for a logarithm, else the range that it may have.
  double range(double q) const {
    if (logarithmic) return 1;
    return std::isfinite(upper - lower) ? upper - lower : std::max(std::abs(q), 1e-12);
  }
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
      Scale& scale = scales_.emplace_back(Scale{protocol.parameters()[parameter.index].logarithmic});
      scale.lower = scale.inside(parameter.lower);
      scale.upper = scale.inside(parameter.upper);
    }
  }

  const Scale& scale(Eigen::Index j) const { return scales_[static_cast<size_t>(j)]; }
  Eigen::Index count() const { return static_cast<Eigen::Index>(free_.size()); }
  int residual_count() const { return static_cast<int>(measurements_.size()); }
  bool stopped() const { return options_.stop != nullptr && options_.stop->load(); }

  /// The free parameters in SI.
  std::vector<double> values(const Eigen::VectorXd& q) const {
    std::vector<double> si;
    for (Eigen::Index j = 0; j < count(); ++j) si.push_back(scale(j).outside(q[j]));
    return si;
  }

  Params params(const Eigen::VectorXd& q) const {
    Params p = options_.held.size() > 0 ? options_.held : protocol_.nominal();
    const std::vector<double> si = values(q);
    for (size_t j = 0; j < si.size(); ++j) p[indices_[j]] = std::clamp(si[j], free_[j].lower, free_[j].upper);
    return p;
  }

  /// False when a simulation failed.
  bool evaluate(const Eigen::VectorXd& q) {
    if (point_.size() > 0 && point_ == q) return ok_;
    point_ = q;
    ++evaluations;
    prediction_ = protocol_.predict(params(q), indices_);
    ok_ = prediction_.complete();
    if (!ok_) {
      ++failed;
      last_failure = q;
      for (const std::string& failure : prediction_.failures) {
        if (failures.size() < 5) failures.push_back(failure);
      }
      return false;
    }
    const std::vector<double> si = values(q);
    for (Eigen::Index j = 0; j < count(); ++j)
      prediction_.derivatives.col(j) *= scale(j).slope(si[static_cast<size_t>(j)]);
    if (options_.progress)
      options_.progress({phase_, evaluations, std::max(0, phase_end_ - evaluations), chi_squared(), si});
    return true;
  }

  /// What the next evaluations are for, and how many that usually takes.
  void begin(std::string phase, int usual_evaluations) {
    phase_ = std::move(phase);
    phase_end_ = evaluations + usual_evaluations;
  }

  /// Makes the next evaluation ask the protocol even at the same point.
  void reset() {
    point_.resize(0);
    prediction_ = {};
  }

  const Prediction& prediction() const { return prediction_; }
  const Eigen::VectorXd& point() const { return point_; }  ///< of the newest evaluation

  Eigen::VectorXd residuals() const { return noise_scaled(prediction_, measurements_).residuals; }
  Eigen::MatrixXd jacobian() const { return noise_scaled(prediction_, measurements_).jacobian; }
  double chi_squared() const { return residuals().squaredNorm(); }

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
  std::string phase_;
  int phase_end_ = 0;  ///< where it usually ends
};

/// All residuals as one block, because one simulation yields them all.
class ResidualBlock final : public ceres::CostFunction {
 public:
  explicit ResidualBlock(Evaluator& evaluator) : evaluator_(evaluator) {
    set_num_residuals(evaluator.residual_count());
    mutable_parameter_block_sizes()->assign(static_cast<size_t>(evaluator.count()), 1);
  }
  bool Evaluate(double const* const* blocks, double* residuals, double** jacobians) const override {
    Eigen::VectorXd q(evaluator_.count());
    for (Eigen::Index j = 0; j < q.size(); ++j) q[j] = blocks[j][0];
    if (!evaluator_.evaluate(q)) return false;
    Eigen::Map<Eigen::VectorXd>(residuals, num_residuals()) = evaluator_.residuals();
    if (jacobians == nullptr) return true;
    const Eigen::MatrixXd J = evaluator_.jacobian();
    for (Eigen::Index j = 0; j < q.size(); ++j) {
      if (jacobians[j] != nullptr) Eigen::Map<Eigen::VectorXd>(jacobians[j], num_residuals()) = J.col(j);
    }
    return true;
  }

 private:
  Evaluator& evaluator_;
};

/// Decrease of chi squared that a Gauss-Newton step from the newest evaluation at `q` promises; it is the square of the
/// step in standard errors. Parameters at bounds that hold them do not count, nor does `held`.
double promised_decrease(const Evaluator& at, const Eigen::VectorXd& q, Eigen::Index held) {
  const Eigen::VectorXd r = at.residuals();
  const Eigen::MatrixXd J = at.jacobian();
  Eigen::MatrixXd open = J;
  for (Eigen::Index j = 0; j < q.size(); ++j) {
    const Scale& scale = at.scale(j);
    const double downhill = -J.col(j).dot(r), room = downhill > 0 ? scale.upper - q[j] : q[j] - scale.lower;
    if (room < 1e-6 * scale.range(q[j]) || j == held) open.col(j).setZero();
  }
  return (open * minimum_norm_solution(open, r)).squaredNorm();
}

/// Ends a search that is interrupted, or that has nothing more to gain: that saves the evaluation which would show it.
class StopCallback final : public ceres::IterationCallback {
 public:
  StopCallback(const Evaluator& evaluator, Eigen::Index held, double tolerance)
      : evaluator_(evaluator), held_(held), tolerance_(tolerance) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary& summary) override {
    if (evaluator_.stopped()) return ceres::SOLVER_TERMINATE_SUCCESSFULLY;  // the best values so far are kept
    if (!summary.step_is_successful) return ceres::SOLVER_CONTINUE;
    const double promised = promised_decrease(evaluator_, evaluator_.point(), held_);
    return promised <= 0.1 * tolerance_ * evaluator_.chi_squared() ? ceres::SOLVER_TERMINATE_SUCCESSFULLY
                                                                   : ceres::SOLVER_CONTINUE;
  }

 private:
  const Evaluator& evaluator_;
  Eigen::Index held_;
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
  Eigen::VectorXd q;
  double chi_squared = not_a_number;
};

constexpr double damped = 1, undamped = 1e4;  ///< trust-region radii: half a Gauss-Newton step, the whole step

/// Levenberg-Marquardt from `q` with bounds; parameter `held` keeps its value.
Minimum minimise(Evaluator& evaluator, const Eigen::VectorXd& q, Eigen::Index held, double radius,
                 const FitOptions& options) {
  Minimum minimum;
  minimum.q = q;
  if (!evaluator.evaluate(q)) {  // Ceres would say so on stderr
    minimum.summary.message = "the simulation failed at the start";
    return minimum;
  }
  ceres::Problem::Options problem_options;
  problem_options.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ResidualBlock block(evaluator);
  ceres::Problem problem(problem_options);
  std::vector<double*> blocks;
  for (double& value : minimum.q) blocks.push_back(&value);
  problem.AddResidualBlock(&block, nullptr, blocks);
  for (Eigen::Index j = 0; j < q.size(); ++j) {
    const Scale& scale = evaluator.scale(j);
    double* const value = &minimum.q[j];
    if (j == held) problem.SetParameterBlockConstant(value);
    if (j != held && std::isfinite(scale.lower)) problem.SetParameterLowerBound(value, 0, scale.lower);
    if (j != held && std::isfinite(scale.upper)) problem.SetParameterUpperBound(value, 0, scale.upper);
  }
  StopCallback stop(evaluator, held, options.tolerance);
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
  minimum.chi_squared = 2 * minimum.summary.final_cost;
  return minimum;
}

/// One Gauss-Newton step from `q` in the reciprocals of the logarithmic parameters (1/E instead of ln E): displacements
/// of a linear solid are linear in those, so that a start a few times off comes near at once. At most a factor of
/// three, because far from the truth the solid is not linear. Returns whether `q` moved; it stays when that does not
/// lower chi squared.
bool step_in_compliance(Evaluator& evaluator, Eigen::VectorXd& q) {
  if (!evaluator.evaluate(q) || evaluator.stopped()) return false;
  const Eigen::VectorXd r = evaluator.residuals();
  // A least-squares step of minimum norm: parameters that the readings do not see stay where they are.
  const Eigen::VectorXd step = -minimum_norm_solution(evaluator.jacobian(), r);
  Eigen::VectorXd trial = q;
  for (Eigen::Index j = 0; j < q.size(); ++j) {
    const Scale& scale = evaluator.scale(j);
    trial[j] += scale.logarithmic ? -std::log1p(-std::clamp(step[j], -2.0, 2.0 / 3.0)) : step[j];
    trial[j] = scale.clamped(trial[j]);
  }
  if (trial == q || !evaluator.evaluate(trial) || !(evaluator.chi_squared() < r.squaredNorm())) return false;
  q = trial;
  return true;
}

/// One end of a profile interval: where chi squared, minimised over all other parameters, has risen by `profile_rise`,
/// going from the optimum in direction `sign`. Fitted scale.
class ProfileEnd {
 public:
  /// `covariance` says how the other parameters follow, to first order. The points looked at are added to `visited`,
  /// and the lowest of them is `lowest` if that was higher; the search ends there.
  ProfileEnd(Evaluator& evaluator, const Minimum& best, const Eigen::MatrixXd& covariance, Eigen::Index j, int sign,
             const FitOptions& options, std::vector<std::pair<double, double>>& visited, Minimum& lowest)
      : evaluator_(evaluator),
        best_(best),
        slopes_(covariance.col(j)),
        j_(j),
        sign_(sign),
        options_(options),
        visited_(visited),
        lowest_(lowest),
        inner_{best.q[j], 0, best.q},
        outer_(inner_),
        start_(best.q) {
    // Of the rise: half a per cent.
    options_.tolerance = std::min(1e-3, 0.005 * profile_rise / std::max(best.chi_squared, 1e-12));
  }

  /// Empty when chi squared has not risen so much at the bound, where simulations fail before it has, and, when
  /// `alone`, where it would only because another parameter is at its bound.
  std::optional<double> find(double guess, bool alone) {
    if (!enclose(std::max(guess, 1e-6))) return std::nullopt;
    narrow();
    if (!std::isfinite(outer_.rise) || (alone && another_is_at_its_bound())) return std::nullopt;
    return 0.5 * (inner_.q + outer_.q);
  }

 private:
  struct Place {
    double q, rise;
    Eigen::VectorXd all;  ///< parameters, the others where they are best
  };

  Place place_at(double q) {
    const double moved = q - start_[j_];
    for (Eigen::Index i = 0; i < start_.size(); ++i)
      start_[i] = evaluator_.scale(i).clamped(start_[i] + moved * slopes_[i] / slopes_[j_]);
    start_[j_] = q;
    double rise = std::numeric_limits<double>::infinity();
    if (start_.size() == 1) {
      if (evaluator_.evaluate(start_)) rise = evaluator_.chi_squared() - best_.chi_squared;
    } else {
      const Minimum there = minimise(evaluator_, start_, j_, undamped, options_);
      if (there.summary.termination_type != ceres::FAILURE) {
        start_ = there.q;
        rise = there.chi_squared - best_.chi_squared;
      }
    }
    if (std::isfinite(rise)) visited_.emplace_back(evaluator_.scale(j_).outside(q), rise);
    if (best_.chi_squared + rise < lowest_.chi_squared) {
      lowest_.q = start_;
      lowest_.chi_squared = best_.chi_squared + rise;
    }
    return {q, rise, start_};
  }

  /// So near the end, the rest of the way is a fraction of the way so far, if the rise is a parabola as expected.
  bool nearly(const Place& place) const {
    const double parabola = z95 * std::sqrt(slopes_[j_]);
    const bool expected = std::abs(std::abs(place.q - best_.q[j_]) / parabola - 1) < 0.3;
    return std::abs(place.rise / profile_rise - 1) < (expected ? 0.05 : 0.01);
  }

  /// Goes outwards by ever longer steps until the end is between the two places, or both are at it.
  bool enclose(double step) {
    const Scale& scale = evaluator_.scale(j_);
    for (int expansion = 0; expansion < 12; ++expansion, step *= 2) {
      if (evaluator_.stopped() || lowest_.chi_squared < best_.chi_squared - lower_minimum) return false;
      const double q = inner_.q + sign_ * step;
      const bool at_bound = sign_ > 0 ? q >= scale.upper : q <= scale.lower;
      outer_ = place_at(at_bound ? (sign_ > 0 ? scale.upper : scale.lower) : q);
      if (outer_.rise >= profile_rise || nearly(outer_)) break;
      if (at_bound) return false;
      inner_ = outer_;
    }
    if (!nearly(outer_)) return !(outer_.rise < profile_rise);
    inner_.q = outer_.q = best_.q[j_] + (outer_.q - best_.q[j_]) * std::sqrt(profile_rise / outer_.rise);
    return true;
  }

  void narrow() {
    const double target = std::sqrt(profile_rise);
    for (int i = 0; i < 12; ++i) {
      const double apart = std::abs(outer_.q - inner_.q), way = std::abs(outer_.q - best_.q[j_]);
      if (!(apart > 1e-3 * std::max(way, 1e-12)) || evaluator_.stopped()) return;
      // The rise is nearly quadratic, so its root is nearly linear; bisect when that is of no use.
      const double a = std::sqrt(std::max(inner_.rise, 0.0)), b = std::sqrt(outer_.rise);
      double t = std::isfinite(b) && b > a ? (target - a) / (b - a) : 0.5;
      t = i % 3 == 2 ? 0.5 : std::clamp(t, 0.05, 0.95);
      const Place middle = place_at(inner_.q + t * (outer_.q - inner_.q));
      if (nearly(middle)) {
        inner_.q = outer_.q = middle.q;
        outer_.all = middle.all;
        return;
      }
      (middle.rise >= profile_rise ? outer_ : inner_) = middle;
    }
  }

  bool another_is_at_its_bound() const {
    for (Eigen::Index i = 0; i < start_.size(); ++i) {
      const Scale& scale = evaluator_.scale(i);
      if (i != j_ && scale.room(outer_.all[i]) < 1e-6 * scale.range(outer_.all[i])) return true;
    }
    return false;
  }

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

/// True when a simulation failed beside the newest evaluation of `last`, at `q`, although chi squared still falls
/// there.
bool stopped_by_failures(const Evaluator& searching, const Evaluator& last, const Eigen::VectorXd& q) {
  if (searching.last_failure.size() == 0) return false;
  for (Eigen::Index j = 0; j < q.size(); ++j) {
    if (std::abs(searching.last_failure[j] - q[j]) > 1e-2 * last.scale(j).range(q[j])) return false;
  }
  return promised_decrease(last, q, -1) > std::max(1e-3, 1e-6 * last.chi_squared());
}

/// What a parameter's standard error on the fitted scale is compared with, and the words for it.
struct Size {
  double size;
  std::string_view words;
};

/// How far a parameter is from being known, as a number without unit: its standard error over its Size, with the others
/// free and with them held.
struct Spread {
  double joint, alone;
};

constexpr double well = 0.1, weak = 0.7;

/// Of chi squared per degree of freedom: from here on intervals of the noise say nothing, and are not searched for.
constexpr double no_profiles = 100;
Verdict verdict_of(const Spread& spread) {
  if (spread.joint <= well) return Verdict::well_determined;
  if (spread.joint <= weak) return Verdict::weakly_determined;
  return spread.alone <= weak ? Verdict::tied : Verdict::invisible;
}

/// What is said of a parameter, in the order of Verdict.
struct VerdictWords {
  std::string_view name;
  const char* sentence;
};
constexpr std::array<VerdictWords, 8> verdict_words{{
    {"well determined", "The readings determine {id} to {known_to}."},
    {"weakly determined",
     "The readings determine {id} to {known_to} only: its value is a rough one; more repeats or loads at which it "
     "matters more would help."},
    {"bounded from one side",
     "The readings say that {id} is {side} {bound} and nothing more: {beyond} it no longer changes the predictions by "
     "more than the noise; take the value from elsewhere and fix it."},
    {"tied",
     "The readings see {id} but cannot tell it from {partner}: a change of one is made up for by the other; fix one of "
     "them from another measurement, or add loads that separate them."},
    {"invisible",
     "The readings do not depend on {id} within their noise: its value is where the search happened to be, not a "
     "result; fix it, or measure where it matters."},
    {"at its bound",
     "The readings would move {id} beyond the bound that was set, and what is written is that bound, not a result: "
     "widen "
     "it, or ask whether the model fits."},
    {"of a model that misses the readings",
     "The model misses the readings by far more than their declared noise: {id} is the value with which it misses them "
     "least, and how far that is from the truth is not known."},
    {"unknown", ""},
}};

std::string explain(const ParameterEstimate& e, const Spread& spread, std::string_view compared_with,
                    const std::string& partner, double correlation) {
  const std::string relative = fmt::format("{:.2g} %", 100 * spread.joint);
  const bool one_sided = e.verdict == Verdict::bounded_from_one_side;
  std::string text = fmt::format(
      fmt::runtime(verdict_words[static_cast<size_t>(e.verdict)].sentence), fmt::arg("id", e.spec.id),
      fmt::arg("known_to", e.spec.logarithmic
                               ? relative
                               : fmt::format("{} ({} of {})", with_unit(e.standard_error, e.spec.unit, 2), relative,
                                             compared_with)),
      fmt::arg("side", e.lower95 ? "above" : "below"), fmt::arg("beyond", e.lower95 ? "beyond that" : "below that"),
      fmt::arg("bound", one_sided ? with_unit(e.lower95 ? *e.lower95 : *e.upper95, e.spec.unit) : ""),
      fmt::arg("partner", partner.empty() ? "the other parameters" : partner));
  if ((e.verdict == Verdict::well_determined || e.verdict == Verdict::weakly_determined) && std::abs(correlation) > 0.9)
    text += fmt::format(" It is correlated with {} ({:.2f}).", partner, correlation);
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
        factorisations_(protocol.factorisations()) {
    last_.begin("cold replay", 0);
  }

  FitResult run() {
    set_start();
    for (int restart = 0;; ++restart) {
      search(restart == 0);
      forget_errors();
      add_cost(result_.search);
      list_estimates();
      if (last_.prediction().values.size() == 0 || !last_.prediction().complete()) return std::move(result_);
      judge_fit();
      if (result_.status != FitStatus::converged) return std::move(result_);
      find_covariance();
      lowest_ = best_;
      {
        const Search profiles(protocol_);
        for (Eigen::Index j = 0; j < evaluator_.count() && !lower_found(); ++j) judge_parameter(j);
      }
      add_cost(result_.profiles);
      if (!lower_found() || restart == most_restarts || evaluator_.stopped()) break;
      best_ = lowest_;
      evaluator_.reset();
    }
    judge_partners();
    return std::move(result_);
  }

 private:
  void set_start() {
    best_.q.resize(evaluator_.count());
    for (Eigen::Index j = 0; j < evaluator_.count(); ++j) {
      const FreeParameter& free = free_[static_cast<size_t>(j)];
      const ParameterSpec& spec = protocol_.parameters()[free.index];
      if (!(free.lower < free.upper) || !(free.start >= free.lower && free.start <= free.upper)) {
        throw InputError(fmt::format("{}: the start {:.6g} {} must lie between its bounds {:.6g} and {:.6g}", spec.id,
                                     free.start, spec.unit, free.lower, free.upper));
      }
      best_.q[j] = evaluator_.scale(j).inside(free.start);
    }
  }

  /// What was spent since it was asked last.
  void add_cost(FitCost& to) {
    to.seconds += watch_.seconds();
    to.factorisations += protocol_.factorisations() - factorisations_;
    watch_ = Stopwatch();
    factorisations_ = protocol_.factorisations();
  }

  /// Looking for the ends of intervals has met a lower chi squared than the search did.
  bool lower_found() const { return lowest_.chi_squared < best_.chi_squared - lower_minimum; }

  /// Keeps the newest evaluation if it is the lowest.
  void note_lowest() {
    if (!(evaluator_.chi_squared() < lowest_.chi_squared)) return;
    lowest_.q = evaluator_.point();
    lowest_.chi_squared = evaluator_.chi_squared();
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
    const bool near = !first || step_in_compliance(evaluator_, best_.q);
    best_ = minimise(evaluator_, best_.q, -1, near ? undamped : damped, options_);
  }

  /// Whether the cold path finds the same chi squared, or nearly, and within a thirtieth of a standard error of the
  /// optimum on the protocol's own path.
  bool agrees(double again) const {
    const double apart = std::abs(again - best_.chi_squared) / (1 + best_.chi_squared);
    if (apart <= 1e-6) return true;
    return apart <= 1e-2 && promised_decrease(last_, best_.q, -1) <= std::max(1e-3, 1e-5 * again);
  }

  /// What is reported is computed once more from the start of the protocol's path, without the fit's history. Should
  /// the history have led to another equilibrium than that path does, the fit goes on from there.
  void search(bool first) {
    evaluator_.begin("search", 8);  // of the shipped experiments they take 3 to 8, rarely more
    for (int round = 0; round < 3; ++round) {
      last_.reset();
      search_once(first && round == 0);
      result_.iterations += std::max(0, static_cast<int>(best_.summary.iterations.size()) - 1);
      result_.message = best_.summary.termination_type == ceres::USER_SUCCESS ? "a further step promises nothing more"
                                                                              : best_.summary.message;
      result_.status = search_status();
      if (result_.status == FitStatus::start_failed || result_.status == FitStatus::interrupted) break;
      protocol_.forget();
      last_.reset();
      if (!last_.evaluate(best_.q)) {
        result_.status = last_.stopped() ? FitStatus::interrupted : FitStatus::not_converged;
        result_.message =
            "the optimum could not be computed again from the start of the path: " + last_.failures.front();
        break;
      }
      const double again = last_.chi_squared();
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
    const std::vector<double> values = evaluator_.values(best_.q);
    result_.parameters.clear();
    for (size_t j = 0; j < free_.size(); ++j) {
      ParameterEstimate& estimate = result_.parameters.emplace_back();
      estimate.spec = protocol_.parameters()[free_[j].index];
      estimate.start = free_[j].start;
      estimate.lower = free_[j].lower;
      estimate.upper = free_[j].upper;
      estimate.value = values[j];
      estimate.standard_error = not_a_number;
    }
    result_.p = evaluator_.params(best_.q);
  }

  void judge_fit() {
    result_.predicted = last_.prediction().values;
    const Eigen::VectorXd r = last_.residuals();
    jacobian_ = last_.jacobian();
    best_.chi_squared = result_.chi_squared = r.squaredNorm();
    if (result_.status == FitStatus::converged && stopped_by_failures(evaluator_, last_, best_.q)) {
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

  /// Those of the optimum before belong to another place.
  void forget_errors() {
    result_.covariance.resize(0, 0);
    result_.correlation.resize(0, 0);
    result_.singular_values.resize(0);
    result_.weakest.resize(0);
    result_.prediction_se.resize(0);
  }

  /// Directions that the readings do not see get a deviation of a hundred ranges instead of a pseudo-inverse's zero;
  /// more than that would drown in rounding what they do see.
  void find_covariance() {
    const Eigen::Index n = evaluator_.count();
    ranges_.resize(n);
    for (Eigen::Index j = 0; j < n; ++j) ranges_[j] = evaluator_.scale(j).range(best_.q[j]);
    const SingularValues svd = singular_values(jacobian_ * ranges_.asDiagonal());
    result_.singular_values = svd.s;
    result_.weakest = svd.V.col(n - 1);
    const Eigen::VectorXd inverse = svd.s.cwiseMax(0.01).cwiseInverse();
    const Eigen::MatrixXd root = ranges_.asDiagonal() * svd.V * inverse.asDiagonal();
    result_.covariance = root * root.transpose();
    deviations_ = root.rowwise().norm();
    result_.correlation =
        deviations_.cwiseInverse().asDiagonal() * result_.covariance * deviations_.cwiseInverse().asDiagonal();
    const Eigen::MatrixXd& D = last_.prediction().derivatives;  // on the fitted scale already
    result_.prediction_se = (D * root).rowwise().norm();
  }

  /// Positive quantities are compared with themselves, others with the range that was chosen for them; where nobody
  /// chose one, with the change that would change the readings by as much as they are, at most with all that is
  /// possible.
  Size size_of(Eigen::Index j) const {
    const FreeParameter& free = free_[static_cast<size_t>(j)];
    const ParameterEstimate& estimate = result_.parameters[static_cast<size_t>(j)];
    if (estimate.spec.logarithmic) return {1, ""};
    if (estimate.spec.lower >= 0) return {std::max(std::abs(estimate.value), 1e-12), "itself"};
    if (free.bounds_chosen) return {ranges_[j], "its range"};
    double readings = 0;
    for (const Measurement& m : measurements_) readings += std::pow(m.value / m.sigma, 2);
    const double own = std::sqrt(readings) / std::max(jacobian_.col(j).norm(), 1e-150);
    return {std::min(own, estimate.upper - estimate.lower), "what would double the readings"};
  }

  /// Whether chi squared would fall by more than the noise's one if the parameter might leave the bound that it is at.
  bool held_by_bound(Eigen::Index j) const {
    const Scale& scale = evaluator_.scale(j);
    if (scale.room(best_.q[j]) >= 1e-6 * ranges_[j]) return false;
    const bool at_upper = scale.upper - best_.q[j] < best_.q[j] - scale.lower;
    const double downhill = -jacobian_.col(j).dot(last_.residuals());
    return downhill * (at_upper ? 1 : -1) > jacobian_.col(j).norm();
  }

  /// Whether the model misses the readings and pushes a parameter against its bound to miss them less. Intervals of the
  /// others are worth nothing then, and their profiles long: one of those beside a modulus at 100 GPa took 250
  /// predictions.
  bool pushed_out() const {
    if (!misses_readings(result_)) return false;
    for (Eigen::Index j = 0; j < evaluator_.count(); ++j) {
      if (held_by_bound(j)) return true;
    }
    return false;
  }

  /// Verdict, interval and the words for them.
  void judge_parameter(Eigen::Index j) {
    ParameterEstimate& estimate = result_.parameters[static_cast<size_t>(j)];
    const auto [size, compared_with] = size_of(j);
    const Spread spread{deviations_[j] / size, 1 / std::max(jacobian_.col(j).norm(), 1e-150) / size};
    estimate.verdict = verdict_of(spread);
    estimate.standard_error =
        deviations_[j] < 10 * ranges_[j] ? deviations_[j] * evaluator_.scale(j).slope(estimate.value) : not_a_number;
    if (estimate.verdict == Verdict::well_determined && estimate.standard_error > std::abs(estimate.value))
      estimate.verdict = Verdict::weakly_determined;
    find_interval(j, estimate);
    const bool determined =
        estimate.verdict == Verdict::well_determined || estimate.verdict == Verdict::weakly_determined;
    if (misses_readings(result_) && determined) estimate.verdict = Verdict::of_a_wrong_model;
    if (held_by_bound(j)) {
      estimate.verdict = Verdict::at_its_bound;
      estimate.lower95 = estimate.upper95 = std::nullopt;
      estimate.standard_error = not_a_number;
    }
    const auto [partner, correlation] = partner_of(j);
    const std::string name = partner < 0 ? "" : result_.parameters[static_cast<size_t>(partner)].spec.id;
    estimate.explanation = explain(estimate, spread, compared_with, name, correlation);
  }

  /// The parameter that j is correlated with most, -1 when it is alone, and how much.
  std::pair<Eigen::Index, double> partner_of(Eigen::Index j) const {
    std::pair<Eigen::Index, double> strongest{-1, 0};
    for (Eigen::Index i = 0; i < evaluator_.count(); ++i) {
      const double c = result_.correlation(j, i);
      if (i != j && std::abs(c) > std::abs(strongest.second)) strongest = {i, c};
    }
    return strongest;
  }

  /// What is tied to a parameter, or to one that a bound holds, is not determined well.
  void judge_partners() {
    for (Eigen::Index j = 0; j < evaluator_.count(); ++j) {
      ParameterEstimate& estimate = result_.parameters[static_cast<size_t>(j)];
      const auto [partner, correlation] = partner_of(j);
      if (estimate.verdict != Verdict::well_determined || std::abs(correlation) < 0.9) continue;
      const ParameterEstimate& other = result_.parameters[static_cast<size_t>(partner)];
      if (other.verdict != Verdict::tied && other.verdict != Verdict::at_its_bound) continue;
      estimate.verdict = Verdict::weakly_determined;
      estimate.explanation += fmt::format(" And {} is {}.", other.spec.id, name_of(other.verdict));
    }
  }

  /// Whether chi squared rises at both ends of the parabola's interval as that promises, to a fifth, with the others
  /// following to first order.
  bool parabola_holds(Eigen::Index j) {
    for (const int sign : {-1, 1}) {
      if (evaluator_.stopped()) return true;
      Eigen::VectorXd q = best_.q + sign * z95 / deviations_[j] * result_.covariance.col(j);
      for (Eigen::Index i = 0; i < q.size(); ++i) q[i] = evaluator_.scale(i).clamped(q[i]);
      if (!evaluator_.evaluate(q)) return false;
      note_lowest();
      if (!(std::abs((evaluator_.chi_squared() - best_.chi_squared) / profile_rise - 1) <= 0.2)) return false;
    }
    return true;
  }

  /// The parabola's interval, or where that cannot be trusted that of the profile likelihood.
  void find_interval(Eigen::Index j, ParameterEstimate& estimate) {
    const Scale& scale = evaluator_.scale(j);
    const double reach = z95 * deviations_[j];
    std::optional<double> low = best_.q[j] - reach, high = best_.q[j] + reach;
    const bool doubtful = estimate.verdict != Verdict::well_determined || *low < scale.lower || *high > scale.upper;
    const bool profiles = options_.profiles && !evaluator_.stopped() &&
                          result_.chi_squared < no_profiles * std::max(result_.dof, 1) && !held_by_bound(j) &&
                          !pushed_out();
    if (doubtful) low = high = std::nullopt;
    evaluator_.begin("interval of " + estimate.spec.id, 2);
    if (profiles && (doubtful || options_.all_profiles || !parabola_holds(j))) {
      const double guess = std::min(reach, scale.logarithmic ? 1.0 : 0.25 * ranges_[j]);
      estimate.profile.emplace_back(estimate.value, 0.0);
      evaluator_.begin("profile of " + estimate.spec.id, doubtful ? 24 : 8);  // what the push-puppet module's take
      const auto end = [&](int sign) {
        return ProfileEnd(evaluator_, best_, result_.covariance, j, sign, options_, estimate.profile, lowest_)
            .find(guess, estimate.verdict == Verdict::tied);
      };
      const std::optional<double> down = end(-1), up = lower_found() ? std::nullopt : end(+1);
      if (!evaluator_.stopped()) {  // half a search is worth less than the parabola, or than nothing
        low = down;
        high = up;
      }
      std::ranges::sort(estimate.profile);
    }
    if (doubtful) {
      if (estimate.verdict != Verdict::well_determined && low.has_value() != high.has_value())
        estimate.verdict = Verdict::bounded_from_one_side;
      if (estimate.verdict == Verdict::invisible && low && high) estimate.verdict = Verdict::weakly_determined;
    }
    if (estimate.verdict == Verdict::well_determined && profiles && !(low && high))
      estimate.verdict = Verdict::weakly_determined;
    if (low) estimate.lower95 = scale.outside(*low);
    if (high) estimate.upper95 = scale.outside(*high);
  }

  static constexpr int most_restarts = 4;
  Protocol& protocol_;
  const std::vector<Measurement>& measurements_;
  const std::vector<FreeParameter>& free_;
  const FitOptions& options_;
  Evaluator evaluator_, last_;  ///< of the search; of the cold replay after it
  Stopwatch watch_;
  int factorisations_;
  Minimum best_, lowest_;  ///< of the search; met since, where intervals were looked for
  FitResult result_;
  Eigen::MatrixXd jacobian_;             ///< at the end, fitted scale
  Eigen::VectorXd ranges_, deviations_;  ///< per parameter, fitted scale
};

}  // namespace

std::string_view name_of(Verdict verdict) {
  const auto i = static_cast<size_t>(verdict);
  return i < verdict_words.size() ? verdict_words[i].name : "";
}

std::string_view name_of(FitStatus status) {
  constexpr std::array<std::string_view, 4> names{"converged", "not converged", "start failed", "interrupted"};
  const auto i = static_cast<size_t>(status);
  return i < names.size() ? names[i] : "";
}

bool misses_readings(const FitResult& fit) {
  return fit.dof > 0 && fit.chi_squared_p < 1e-6;
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
