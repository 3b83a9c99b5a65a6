#include "calib/fit/fit.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>

#include "calib/fit/branches.hpp"
#include "calib/fit/distributions.hpp"
#include "calib/fit/goodness_of_fit.hpp"
#include "calib/fit/profile.hpp"
#include "calib/fit/search.hpp"
#include "sim/core/dense.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/stopwatch.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

/// True when a simulation failed beside the newest evaluation of `last`, at `q`, although chi squared still falls
/// there.
bool stopped_by_failures(const Evaluator& searching, const Evaluator& last, const Eigen::VectorXd& q) {
  if (searching.last_failure.size() == 0) return false;
  for (Eigen::Index j = 0; j < q.size(); ++j) {
    if (std::abs(searching.last_failure[j] - q[j]) > 1e-2 * last.scale(j).range(q[j])) return false;
  }
  return promised_decrease(last, q) > std::max(1e-3, 1e-6 * last.chi_squared());
}

/// What a parameter's standard error on the fitted scale is compared with, and the words for it.
struct Size {
  double size;
  std::string_view words;
};

/// How far a parameter is from being known, as a number without unit: its standard error over its Size, with the others
/// free and with them held.
struct Uncertainty {
  double joint, alone;
};

constexpr double well = 0.1, weak = 0.7;

/// Of chi squared per degree of freedom: from here on intervals of the noise say nothing, and are not searched for.
constexpr double no_profiles = 100;

Verdict verdict_of(const Uncertainty& spread) {
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

std::string explain(const ParameterEstimate& e, const Uncertainty& spread, std::string_view compared_with,
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
    FitResult found = search_and_judge();
    found.history = std::move(history_);
    return found;
  }

 private:
  FitResult search_and_judge() {
    set_start();
    const Eigen::VectorXd start = best_.q;
    if (!find_optimum(true)) return std::move(result_);
    if (options_.recover && is_astray()) follow_readings();
    if (options_.recover && is_astray()) start_elsewhere(start);
    add_cost(result_.search);
    result_.evaluations = evaluator_.evaluations + last_.evaluations;
    for (int restart = 0; result_.status == FitStatus::converged; ++restart) {
      evaluator_.history = last_.history = nullptr;
      find_covariance();
      lowest_ = best_;
      find_intervals(restart == most_restarts);
      add_cost(result_.profiles);
      if (!lower_found() || restart == most_restarts || evaluator_.stopped()) break;
      best_ = lowest_;
      evaluator_.reset();
      if (!find_optimum(false)) return std::move(result_);
    }
    if (result_.status == FitStatus::converged) judge_partners();
    return std::move(result_);
  }

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

  /// Searches from where best_ is, and judges the fit there. False when there is no prediction to judge.
  bool find_optimum(bool first) {
    search(first);
    forget_errors();
    add_cost(result_.search);
    list_estimates();
    if (last_.prediction().values.size() == 0 || !last_.prediction().complete()) return false;
    judge_fit();
    return true;
  }

  /// Whether the readings are missed by more than their noise and their own scatter explain.
  bool is_astray() const {
    const LackOfFit& lack = result_.lack_of_fit;
    return !evaluator_.stopped() && result_.status != FitStatus::interrupted && misses_readings(result_) &&
           chi_squared_probability(lack.lack_of_fit, lack.lack_of_fit_dof) < 1e-6;
  }

  /// An optimum to come back to where something else is tried.
  struct Kept {
    Minimum best;
    FitResult result;
    Eigen::MatrixXd jacobian;
    Prediction prediction;
  };
  Kept kept() const { return {best_, result_, jacobian_, last_.prediction()}; }
  void restore(Kept to) {
    best_ = std::move(to.best);
    result_ = std::move(to.result);
    jacobian_ = std::move(to.jacobian);
    protocol_.forget();
    last_.take(best_.q, std::move(to.prediction));
    evaluator_.reset();
  }

  /// Whether a search from best_ ends with a chi squared that is lower than that `before` by more than `least`.
  bool improves(const Kept& before, double least) {
    evaluator_.reset();
    return find_optimum(false) && !evaluator_.stopped() && result_.chi_squared < before.result.chi_squared - least &&
           (result_.status == FitStatus::converged || before.result.status != FitStatus::converged);
  }

  /// Rows whose readings are nearer to another equilibrium than to that of the protocol's path are followed there,
  /// where the fit comes to agree with them.
  void follow_readings() {
    const std::vector<int> rows = rows_elsewhere(protocol_.alternatives(result_.p), measurements_);
    const Kept before = kept();
    protocol_.forget();
    evaluator_.reset();
    if (rows.empty() || evaluator_.stopped()) return;
    protocol_.follow(result_.p, rows);
    if (!improves(before, 25)) {
      protocol_.follow({}, {});
      return restore(before);
    }
    result_.followed = rows;
    result_.remarks.push_back(
        fmt::format("{} row(s) with two equilibria are taken in the one that their readings agree with, not in that of "
                    "loads that grow from rest: chi squared falls from {:.4g} to {:.4g}",
                    rows.size(), before.result.chi_squared, result_.chi_squared));
  }

  /// Searches from other starts, and goes on from the best of them where that is better than what was found.
  void start_elsewhere(const Eigen::VectorXd& start) {
    const Kept before = kept();
    evaluator_.allow(options_.restart_budget, replay_factorisations_);
    Minimum lowest = best_;
    std::vector<Eigen::VectorXd> tried{start};
    int searches = 0;
    for (const Eigen::VectorXd& designed : designed_starts(evaluator_, start)) {
      if (evaluator_.halted()) break;
      tried.push_back(untried(designed, tried));
      evaluator_.begin(fmt::format("search from another start ({} of 4)", ++searches), 8);
      const Searching searching(protocol_);
      Eigen::VectorXd q = tried.back();
      const bool near = step_in_compliance(evaluator_, q);
      const Minimum there = minimise(evaluator_, q, -1, near ? undamped : damped, options_);
      if (!there.failed && there.chi_squared < lowest.chi_squared - lower_minimum) lowest = there;
    }
    evaluator_.allow(std::numeric_limits<double>::infinity(), 0);
    best_ = lowest;
    const bool better = lowest.chi_squared < before.best.chi_squared && improves(before, lower_minimum);
    if (!better) restore(before);
    result_.remarks.push_back(
        better ? fmt::format(
                     "the search from the start that was given ended at a chi squared of {:.4g}; of {} others that "
                     "began elsewhere the best has ended here, at {:.4g}",
                     before.result.chi_squared, searches, result_.chi_squared)
               : fmt::format("since the readings are missed, {} more searches began elsewhere: none found a lower chi "
                             "squared",
                             searches));
  }

  /// A start as a cheaper model improves it, unless that leads to one that was tried.
  Eigen::VectorXd untried(const Eigen::VectorXd& start, const std::vector<Eigen::VectorXd>& tried) const {
    if (!options_.better_start) return start;
    std::vector<FreeParameter> free = free_;
    const std::vector<double> values = evaluator_.values(start);
    for (size_t j = 0; j < free.size(); ++j) free[j].start = std::clamp(values[j], free[j].lower, free[j].upper);
    free = options_.better_start(free);
    Eigen::VectorXd better = start;
    for (Eigen::Index j = 0; j < better.size(); ++j)
      better[j] = evaluator_.scale(j).inside(free[static_cast<size_t>(j)].start);
    const auto near = [&](const Eigen::VectorXd& q) {
      for (Eigen::Index j = 0; j < q.size(); ++j) {
        if (std::abs(q[j] - better[j]) > 0.05 * evaluator_.scale(j).range(q[j])) return false;
      }
      return true;
    };
    return std::ranges::any_of(tried, near) ? start : better;
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

  /// Verdicts and intervals, until a lower chi squared is met; or of all parameters, where a search has not come to
  /// what was met so far.
  void find_intervals(bool of_all) {
    const Searching profiles(protocol_);
    evaluator_.allow(options_.profile_budget, replay_factorisations_);
    double lowest = best_.chi_squared;
    const auto goes_on = [&](Eigen::Index j) {
      lowest = std::min(lowest, lowest_.chi_squared);
      if (of_all) lowest_ = best_;
      return j < evaluator_.count() && !lower_found();
    };
    for (Eigen::Index j = 0; goes_on(j); ++j) {
      judge_parameter(j);
      look_into_other_valleys();
    }
    // What a profile met tells of the ends of the others, too.
    for (Eigen::Index j = 0; goes_on(j); ++j) {
      go_on_from_other_valleys(j, -1);
      go_on_from_other_valleys(j, +1);
    }
    evaluator_.allow(std::numeric_limits<double>::infinity(), 0);
    if (of_all && lowest < best_.chi_squared - lower_minimum)
      result_.remarks.push_back(
          fmt::format("profiles met a chi squared of {:.5g}, to which a search along the protocol's own path does not "
                      "come, but to {:.5g}: rows may have more than one equilibrium; an interval whose end was looked "
                      "for there is open",
                      lowest, best_.chi_squared));
  }

  /// Where a point that was met promises another minimum, lower than the optimum and not the same, looks there.
  void look_into_other_valleys() {
    Promise best{{}, best_.chi_squared - lower_minimum};
    size_t from = met_.size();
    for (size_t k = 0; k < met_.size(); ++k) {
      const Promise promise = promised_minimum(evaluator_, met_[k], -1, 0);
      if (!(promise.chi_squared < best.chi_squared) || !((jacobian_ * (promise.q - best_.q)).norm() > 0.1)) continue;
      best = promise;
      from = k;
    }
    if (from == met_.size() || evaluator_.halted() || lower_found()) return;
    met_.erase(met_.begin() + static_cast<std::ptrdiff_t>(from));  // one look is enough
    evaluator_.begin("another valley", 4);
    const Minimum there = minimise(evaluator_, best.q, -1, undamped, options_);
    if (!there.failed && there.chi_squared < lowest_.chi_squared) lowest_ = there;
  }

  /// Whether an end of a closed interval lies in another valley farther out, as what was met promises; goes on from
  /// there.
  void go_on_from_other_valleys(Eigen::Index j, int sign) {
    ParameterEstimate& estimate = result_.parameters[static_cast<size_t>(j)];
    std::optional<double>& end = sign < 0 ? estimate.lower95 : estimate.upper95;
    if (!estimate.lower95 || !estimate.upper95 || !profiles_wanted(j) || evaluator_.halted()) return;
    const double at = evaluator_.scale(j).inside(*end);
    Promise best{{}, best_.chi_squared + 0.8 * profile_rise};  // as far off as a parabola's end may be
    for (const Linearised& met : met_) {
      if (met.profiled == j || !(sign * (met.q[j] - best_.q[j]) > 0)) continue;  // its own valley, or the other end's
      Promise promise = promised_minimum(evaluator_, met, j, at);
      if (promise.chi_squared < best.chi_squared) best = std::move(promise);
    }
    if (best.q.size() == 0) return;
    if (estimate.profile.empty()) estimate.profile.emplace_back(estimate.value, 0.0);
    evaluator_.begin("profile of " + estimate.spec.id, 8);
    const std::optional<double> farther =
        ProfileEnd(evaluator_, around_, j, sign, options_, estimate.profile).go_on(at, best.q);
    std::ranges::sort(estimate.profile);
    end = farther ? std::optional(evaluator_.scale(j).outside(*farther)) : std::nullopt;
    if (!end && estimate.verdict == Verdict::well_determined) estimate.verdict = Verdict::weakly_determined;
  }

  /// Remembers the newest evaluation, of the j-th parameter's interval, and keeps it if it is the lowest.
  void note_lowest(Eigen::Index j) {
    met_.push_back({evaluator_.point(), evaluator_.residuals(), evaluator_.jacobian(), j});
    if (!(evaluator_.chi_squared() < lowest_.chi_squared)) return;
    lowest_.q = evaluator_.point();
    lowest_.chi_squared = evaluator_.chi_squared();
  }

  FitStatus search_status() const {
    if (evaluator_.stopped()) return FitStatus::interrupted;
    if (best_.converged) return FitStatus::converged;
    return evaluator_.failed > 0 && evaluator_.failed == evaluator_.evaluations ? FitStatus::start_failed
                                                                                : FitStatus::not_converged;
  }

  /// Of the start, whose evaluation the search begins with anyway.
  void tell_idle() {
    if (!options_.idle || !evaluator_.evaluate(best_.q)) return;
    const Eigen::MatrixXd jacobian = evaluator_.jacobian();
    for (Eigen::Index j = 0; j < jacobian.cols(); ++j) {
      if (jacobian.col(j).cwiseAbs().maxCoeff() * evaluator_.scale(j).range(best_.q[j]) < 1e-6)
        options_.idle(static_cast<size_t>(j));
    }
  }

  void search_once(bool first) {
    const Searching searching(protocol_);
    if (first) tell_idle();
    const bool near = !first || step_in_compliance(evaluator_, best_.q);
    best_ = minimise(evaluator_, best_.q, -1, near ? undamped : damped, options_);
  }

  /// Whether the cold path finds the same chi squared, or nearly, and within a thirtieth of a standard error of the
  /// optimum on the protocol's own path.
  bool agrees(double again) const {
    const double apart = std::abs(again - best_.chi_squared) / (1 + best_.chi_squared);
    if (apart <= 1e-6) return true;
    return apart <= 1e-2 && promised_decrease(last_, best_.q) <= std::max(1e-3, 1e-5 * again);
  }

  /// What is reported is computed once more from the start of the protocol's path, without the fit's history. Should
  /// the history have led to another equilibrium than that path does, the fit goes on from there; in the end with
  /// predictions that have no history.
  void search(bool first) {
    evaluator_.history = last_.history = &history_;
    evaluator_.begin("search", 8);  // of the shipped experiments they take 3 to 8, rarely more
    for (int round = 0; round < 4; ++round) {
      last_.reset();
      search_once(first && round == 0);
      result_.iterations += best_.iterations;
      result_.message = best_.message;
      result_.status = search_status();
      if (result_.status == FitStatus::start_failed || result_.status == FitStatus::interrupted) break;
      protocol_.forget();
      last_.reset();
      const int before = protocol_.factorisations();
      const bool complete = last_.evaluate(best_.q);
      replay_factorisations_ = protocol_.factorisations() - before;
      if (!complete) {
        result_.status = last_.stopped() ? FitStatus::interrupted : FitStatus::not_converged;
        result_.message =
            "the optimum could not be computed again from the start of the path: " + last_.failures.front();
        break;
      }
      const double again = last_.chi_squared();
      // A search along a valley that is level (tied parameters) takes all its iterations and has nothing more to gain.
      if (result_.status == FitStatus::not_converged &&
          promised_decrease(last_, best_.q) <= std::max(1e-3, 1e-5 * again))
        result_.status = FitStatus::converged;
      if (round == 3 ? !jumps_beside() : agrees(again)) break;
      evaluator_.reset();
      if (round == 2) part_from_history(again);
      if (round < 3) continue;
      result_.status = FitStatus::not_converged;
      result_.message = fmt::format(
          "chi squared, {:.6g}, still falls where the search ended: rows have more than one equilibrium and jump from "
          "one "
          "to another there, so that there is no minimum on the protocol's own path",
          again);
    }
    result_.evaluations = evaluator_.evaluations + last_.evaluations;
    result_.failed_evaluations = evaluator_.failed;
    result_.failures = evaluator_.failures;
  }

  /// The fit's way has led to other equilibria than the protocol's path time and again.
  void part_from_history(double again) {
    evaluator_.go_cold();
    result_.remarks.push_back(fmt::format(
        "chi squared was {:.4g} on the fit's way and {:.4g} on the protocol's own path: rows have more than "
        "one equilibrium, and the search went on along that path, each time from its start",
        best_.chi_squared, again));
  }

  /// Whether the search has stopped although chi squared still falls: where a row jumps from one equilibrium to
  /// another.
  bool jumps_beside() const {
    return result_.status == FitStatus::converged &&
           promised_decrease(last_, best_.q) > std::max(1e-2, 1e-4 * last_.chi_squared());
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

  bool at_bound(Eigen::Index j) const { return evaluator_.scale(j).room(best_.q[j]) < 1e-6 * ranges_[j]; }
  bool at_upper(Eigen::Index j) const {
    const Scale& scale = evaluator_.scale(j);
    return scale.upper - best_.q[j] < best_.q[j] - scale.lower;
  }

  /// Whether chi squared would fall by more than the noise's one if the parameter might leave the bound that it is at.
  bool held_by_bound(Eigen::Index j) const {
    if (!at_bound(j)) return false;
    const double downhill = -jacobian_.col(j).dot(last_.residuals());
    return downhill * (at_upper(j) ? 1 : -1) > jacobian_.col(j).norm();
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
    const Uncertainty spread{deviations_[j] / size, 1 / std::max(jacobian_.col(j).norm(), 1e-150) / size};
    estimate.verdict = verdict_of(spread);
    estimate.standard_error =
        deviations_[j] < 10 * ranges_[j] ? deviations_[j] * evaluator_.scale(j).slope(estimate.value) : not_a_number;
    if (estimate.verdict == Verdict::well_determined && !estimate.spec.may_be_zero &&
        estimate.standard_error > std::abs(estimate.value))
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
    if (evaluator_.spent() && profiles_wanted(j))
      estimate.explanation +=
          fmt::format(" Its profile was not finished: profiles have taken the {:.3g} cold replays that they may.",
                      options_.profile_budget);
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

  bool profiles_wanted(Eigen::Index j) const {
    return options_.profiles && result_.chi_squared < no_profiles * std::max(result_.dof, 1) && !held_by_bound(j) &&
           !pushed_out();
  }

  /// Whether chi squared rises at both ends of the parabola's interval as that promises, to a fifth, with the others
  /// following to first order.
  bool parabola_holds(Eigen::Index j) {
    for (const int sign : {-1, 1}) {
      if (evaluator_.halted()) return true;
      Eigen::VectorXd q = best_.q + sign * z95 / deviations_[j] * result_.covariance.col(j);
      for (Eigen::Index i = 0; i < q.size(); ++i) q[i] = evaluator_.scale(i).clamped(q[i]);
      if (!evaluator_.evaluate(q)) return false;
      note_lowest(j);
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
    const bool profiles = profiles_wanted(j) && !evaluator_.halted();
    if (doubtful) low = high = std::nullopt;
    evaluator_.begin("interval of " + estimate.spec.id, 2);
    const bool refuted = profiles && !doubtful && !options_.all_profiles && !parabola_holds(j);
    if (profiles && (doubtful || options_.all_profiles || refuted)) {
      const double guess = std::min(reach, scale.logarithmic ? 1.0 : 0.25 * ranges_[j]);
      estimate.profile.emplace_back(estimate.value, 0.0);
      evaluator_.begin("profile of " + estimate.spec.id, doubtful ? 24 : 8);  // what the push-puppet module's take
      const auto end = [&](int sign) {
        return ProfileEnd(evaluator_, around_, j, sign, options_, estimate.profile)
            .find(guess, estimate.verdict == Verdict::tied);
      };
      const std::optional<double> down = end(-1), up = lower_found() ? std::nullopt : end(+1);
      if (!evaluator_.halted()) {
        low = down;
        high = up;
      } else if (refuted) {  // half a search is worth less than the parabola, but not than one that is known to be
                             // wrong
        low = high = std::nullopt;
      }
      std::ranges::sort(estimate.profile);
    }
    if (doubtful) {
      // What is nothing, and may not be less, cannot be compared with itself; the parabola says how much it may be.
      const double other_end = best_.q[j] + (at_upper(j) ? -reach : reach);
      if (!profiles && estimate.verdict == Verdict::invisible && at_bound(j) && other_end == scale.clamped(other_end))
        (at_upper(j) ? low : high) = other_end;
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
  int replay_factorisations_ = 0;  ///< of one cold replay
  std::vector<SearchStep> history_;
  Minimum best_, lowest_;        ///< of the search; met since, where intervals were looked for
  std::vector<Linearised> met_;  ///< there
  FitResult result_;
  const Surroundings around_{best_, result_.covariance, lowest_, met_};
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
