#include "sim/robots/soft_ik.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>

#include "sim/core/dense.hpp"
#include "sim/core/error.hpp"
#include "sim/core/stopwatch.hpp"
#include "sim/robots/sensitivities.hpp"
#include "sim/terms/solid.hpp"

namespace taut {
namespace {

// Errors are in units of the tolerance, controls in fractions of their ranges.
constexpr double awake_effect = 0.01;      ///< of a whole range: what has less on the errors counts as slack
constexpr double nominal_pull = 1e-8;      ///< weight of the distance to the nominal controls over the largest slope's
constexpr double worthwhile_error = 0.01;  ///< what a step has to take off the errors
constexpr double worthwhile_gain = 1e-4;   ///< what a step has to take off the squared distance to the nominal controls
constexpr double longest_trial = 0.25;     ///< what a step changes a control by at most
constexpr double shortest_trial = 1e-3;    ///< the length of a step that is not worth to be shortened
constexpr double kink_change = 0.3;        ///< what a control's effect gains or loses at least where it has a kink
constexpr double kink_step = 0.1;          ///< what the control moves by at most when one is looked for
constexpr double same_end = 0.1;           ///< a search that comes so near to where another ended is going there
constexpr double slope_step = 1e-4;        ///< half the way between two Hessians whose difference is a slope

/// Between what the controls stay, in fractions of their ranges.
struct Bounds {
  Eigen::VectorXd lower, upper;
};

/// The step s from q that minimises g . s + s . B s / 2 with lower <= q + s <= upper: controls that leave are held at
/// their bounds and the others solved again, until none held would go back inside; empty when B is not positive
/// definite on those.
Eigen::VectorXd bounded_step(const Eigen::MatrixXd& B, const Eigen::VectorXd& g, const Eigen::VectorXd& q,
                             const Bounds& bounds) {
  Eigen::VectorXd step = Eigen::VectorXd::Zero(q.size());
  std::vector<bool> held(static_cast<size_t>(q.size()), false);
  for (Eigen::Index round = 0; round < 3 * q.size(); ++round) {
    std::vector<Eigen::Index> free;
    for (Eigen::Index j = 0; j < q.size(); ++j) {
      if (!held[static_cast<size_t>(j)]) free.push_back(j);
    }
    step(free).setZero();
    const Eigen::VectorXd slope = g + B * step;
    const std::optional<Eigen::MatrixXd> inner = solve_positive_definite(B(free, free), slope(free));
    if (!inner) return {};
    step(free) = -*inner;
    bool inside = true;
    for (Eigen::Index j : free) {
      if (q[j] + step[j] >= bounds.lower[j] && q[j] + step[j] <= bounds.upper[j]) continue;
      step[j] = (q[j] + step[j] < bounds.lower[j] ? bounds.lower : bounds.upper)[j] - q[j];
      held[static_cast<size_t>(j)] = true;
      inside = false;
    }
    if (!inside) continue;
    const Eigen::VectorXd left = g + B * step;
    Eigen::Index worst = -1;
    for (Eigen::Index j = 0; j < q.size(); ++j) {
      const bool lower = q[j] + step[j] < 0.5 * (bounds.lower[j] + bounds.upper[j]);
      if (!held[static_cast<size_t>(j)] || bounds.lower[j] == bounds.upper[j] || (lower ? left[j] >= 0 : left[j] <= 0))
        continue;
      if (worst < 0 || std::abs(left[j]) > std::abs(left[worst])) worst = j;
    }
    if (worst < 0) break;
    held[static_cast<size_t>(worst)] = false;
  }
  return step;
}

/// A number of each.
template <class List, class Number>
Eigen::VectorXd each(const List& list, Number number) {
  Eigen::VectorXd values(static_cast<Eigen::Index>(list.size()));
  std::ranges::transform(list, values.begin(), number);
  return values;
}

/// An equilibrium of the search, with the errors there and their Jacobian.
struct Iterate {
  Eigen::VectorXd q, u, e;
  Params p;
  Eigen::MatrixXd J;
  bool fresh = false;   ///< the Hessian was factorised near it
  bool linear = false;  ///< J is by that factor
  bool exact = false;   ///< and that is of this very state
};

/// What is minimised near a point: |e|^2/2 + pull |q - nominal|^2/2 with errors e and their Jacobian J, and what S
/// knows of the errors' second derivatives. The pull is so weak beside the errors that it only tells controls apart
/// that do equally well.
struct Quadratic {
  const Eigen::VectorXd &q, &e;
  const Eigen::MatrixXd &J, &S;
  Eigen::VectorXd offset, g, scale;  ///< q - nominal; the gradient; what damping goes by
  Eigen::MatrixXd B;

  Quadratic(const Iterate& at, const Eigen::MatrixXd& learnt, const Eigen::VectorXd& nominal, double pull)
      : q(at.q), e(at.e), J(at.J), S(learnt), offset(q - nominal), g(J.transpose() * e + pull * offset) {
    const Eigen::MatrixXd squares = J.transpose() * J;
    B = squares + S;
    B.diagonal().array() += pull;
    scale = squares.diagonal();
    scale = scale.cwiseMax(1e-6 * scale.maxCoeff() + 1e-12);
  }
  Eigen::VectorXd step(double damping, const Bounds& bounds) const {
    return bounded_step(B + Eigen::MatrixXd(damping * scale.asDiagonal()), g, q, bounds);
  }
  /// How much the sum is to fall with a step.
  double promise(const Eigen::VectorXd& s) const { return -g.dot(s) - 0.5 * s.dot(B * s); }
  /// How much half the square of the distance to the nominal controls is to fall with a step that keeps the errors.
  double gain(const Eigen::VectorXd& s) const { return -offset.dot(s) - 0.5 * s.squaredNorm(); }
};

/// Levenberg's and Marquardt's damping, raised the faster the more steps in a row have failed (Nielsen).
struct Damping {
  double level = 1e-10, growth = 2;

  void raise() {
    level = growth * std::max(level, 1e-4);
    growth *= 2;
  }
  /// `ratio`: what a step brought over what it promised.
  void lower(double ratio) {
    level *= std::max(1.0 / 9, 1 - std::pow(2 * ratio - 1, 3));
    growth = 2;
  }
};

/// Symmetric rank-one update of S: along `step` its product is to be `change`.
void learn(const Eigen::VectorXd& change, const Eigen::VectorXd& step, Eigen::MatrixXd& S) {
  const Eigen::VectorXd miss = change - S * step;
  if (std::abs(miss.dot(step)) > 1e-8 * miss.norm() * step.norm()) S += miss * miss.transpose() / miss.dot(step);
}

/// Equilibria on the way are as exact as errors have to be.
EquilibriumOptions with_rough_tolerance(const IkOptions& options, double length) {
  EquilibriumOptions all = options.equilibrium;
  all.rough_tolerance = std::max(all.step_tolerance, 1e-3 * options.tolerance / length);
  return all;
}

}  // namespace

std::string_view name_of(IkStatus status) {
  switch (status) {
    case IkStatus::reached:
      return "reached";
    case IkStatus::unreachable:
      return "unreachable";
    case IkStatus::failed:
      return "failed";
  }
  return "";
}

/// The search of one solve. Controls are seen as fractions q of their ranges, errors in units of the tolerance.
class SoftIk::Search {
 public:
  Search(SoftIk& ik, const Eigen::VectorXd& targets, std::optional<double> stiffness)
      : ik_(ik),
        targets_(targets),
        nominal_(ik.to_range(each(ik.controls_, &IkControl::nominal))),
        weights_(each(ik.channels_, &IkChannel::weight) / ik.options_.tolerance),
        stiffness_(stiffness),
        nothing_learnt_(Eigen::MatrixXd::Zero(controls(), controls())) {}

  /// From where the equilibrium is (the nominal controls at rest), and while targets are not reached from other starts.
  IkResult run() {
    if (is_folded()) ik_.forget();  // no start
    holds_left_ = 2 * static_cast<int>(controls());
    const Eigen::VectorXd u = ik_.equilibrium_.u();
    const Params p = ik_.equilibrium_.p();
    const Eigen::VectorXd start = ik_.at_rest_ ? nominal_ : ik_.to_range(p(ik_.indices_));
    attempt(start);
    // From one target that is out of reach to the next the nearest point is followed.
    if (!best_.reached && !ik_.lost_) restart(start, u, p);
    ik_.lost_ = best_.q.size() > 0 && !best_.reached;
    return result();
  }

 private:
  /// The best state of several searches.
  struct End {
    Eigen::VectorXd q, u;
    Params p;
    double distance = std::numeric_limits<double>::infinity();
    bool settled = false, reached = false;
  };

  Eigen::Index controls() const { return static_cast<Eigen::Index>(ik_.controls_.size()); }
  Eigen::Index rows() const { return targets_.size() + (stiffness_ ? 1 : 0); }
  bool is_folded() const { return smallest_jacobian(ik_.scene_->model->mesh(), ik_.equilibrium_.u()) <= 0; }
  /// Whether the targets are met, weights aside.
  bool within(const Iterate& at) const {
    const Eigen::Index n = targets_.size();
    const double error = at.e.head(n).cwiseQuotient(weights_).norm();
    return error <= ik_.options_.tolerance && (!stiffness_ || std::abs(at.e[n]) <= 1);
  }

  /// Moves the equilibrium to q, roughly where no stiffness is asked of its Hessian; false, and the equilibrium where
  /// it was, when there is none on the way. All but the Jacobian is set.
  bool move(const Eigen::VectorXd& q, Iterate& to) {
    const int before = ik_.factorisations_;
    if (!ik_.move_to(ik_.from_range(q), stiffness_ ? Polish::full : Polish::rough)) return false;
    to.q = q;
    to.u = ik_.equilibrium_.u();
    to.p = ik_.equilibrium_.p();
    to.e = errors();
    to.fresh = stiffness_ || ik_.factorisations_ > before;
    to.linear = to.exact = false;
    return true;
  }

  /// Goes back to where the search stands, and sees to it that the kept factor is of the Hessian there, which proves
  /// that it is a minimum. All but the Jacobian may change; false when that equilibrium is gone.
  bool settle(Iterate& at) {
    if (at.fresh && ik_.equilibrium_.has_factor() && ik_.equilibrium_.u() == at.u) return true;
    ik_.equilibrium_.start_at(at.u, at.p);
    const Eigen::VectorXd q = at.q;
    return move(q, at);
  }

  /// Searches from other points (nominal, mirrored, middle), together at most twice as long as the first search
  /// took, in factorisations.
  void restart(const Eigen::VectorXd& start, const Eigen::VectorXd& u, const Params& p) {
    const Eigen::VectorXd first = best_.q.size() > 0 ? best_.q : start;
    const Eigen::VectorXd others[] = {nominal_, Eigen::VectorXd::Ones(controls()) - first,
                                      Eigen::VectorXd::Constant(controls(), 0.5)};
    if (best_.q.size() > 0) most_ = 3 * ik_.factorisations_;
    for (int k = 0; k < std::min(3, ik_.options_.restarts) && !best_.reached && !tired(); ++k) {
      if (others[k] == start) continue;
      ik_.kinks_.clear();
      ik_.equilibrium_.start_at(u, p);
      attempt(others[k]);
    }
  }
  bool tired() const { return ik_.factorisations_ >= most_; }

  /// Searches from a point and keeps what it finds where that is better, and not folded unless there is nothing else.
  void attempt(const Eigen::VectorXd& from) {
    Iterate at;
    if (!start(from, at)) return;
    pull_ = nominal_pull * at.J.colwise().squaredNorm().maxCoeff();
    // What holds near the last target says nothing of one that is far.
    const Eigen::VectorXd first = Quadratic(at, nothing_learnt_, nominal_, pull_).step(0, bounds(at));
    if (first.size() == 0 || first.cwiseAbs().maxCoeff() > kink_step) ik_.kinks_.clear();
    minimise(at);
    if (!settle(at) || !(at.e.norm() < best_.distance)) return;
    if (best_.q.size() > 0 && (is_folded() || (best_.settled && !settled_))) return;
    best_ = {at.q, at.u, at.p, at.e.norm(), settled_, within(at)};
  }

  /// Reaches the targets; then goes along the controls that reach them towards the nominal ones, by steps that leave
  /// them for a moment, as long as each brings something.
  void minimise(Iterate& now) {
    approach(now, ik_.options_.max_iterations);
    double longest = std::numeric_limits<double>::infinity();
    const int most = iterations_ + ik_.options_.max_iterations;
    while (within(now) && iterations_ < most) {
      // What errors are left is not worth a step, nor is what moving within the tolerance brings.
      Iterate along = now;
      along.e.setZero();
      const Quadratic near(along, nothing_learnt_, nominal_, pull_);
      const Eigen::VectorXd step = shortened(near.step(0, bounds(now)), longest);
      if (step.size() == 0 || near.gain(step) <= worthwhile_gain * near.offset.squaredNorm()) {
        if (!let_go(now)) break;
        longest = std::numeric_limits<double>::infinity();
        continue;
      }
      Iterate trial;
      const bool tried = go_on(now, step, trial);
      const std::optional<Kink> kink = tried ? kink_between(now, trial) : std::nullopt;
      const bool closer =
          tried && approach(trial, 5) && within(trial) && (trial.q - nominal_).norm() < (now.q - nominal_).norm();
      if (closer) now = trial;
      // What it holds is no longer what made it fail.
      longest =
          !closer && kink && hold(*kink) ? std::numeric_limits<double>::infinity() : (closer ? 2 : 0.25) * step.norm();
    }
  }

  /// Between what the controls stay: their bounds, and the kinks at which they are held.
  Bounds bounds(const Iterate& now) const {
    Bounds bounds{Eigen::VectorXd::Zero(controls()), Eigen::VectorXd::Ones(controls())};
    for (const Kink& kink : ik_.kinks_) {
      bounds.lower[kink.control] = std::min(kink.at, now.q[kink.control]);
      bounds.upper[kink.control] = std::max(kink.at, now.q[kink.control]);
    }
    return bounds;
  }
  /// Where on the way of a trial the effect of a control changed most, if it did: the place at which the errors of both
  /// sides, each linear, agree best.
  std::optional<Kink> kink_between(const Iterate& now, const Iterate& trial) const {
    if (!now.linear || !trial.linear) return std::nullopt;
    const Eigen::VectorXd step = trial.q - now.q;
    std::optional<Eigen::Index> most;
    double largest = 0;
    for (Eigen::Index j = 0; j < step.size(); ++j) {
      // A direction turns with the robot, and over a long way all effects change.
      if (std::abs(step[j]) > kink_step) continue;
      const double change = std::abs(trial.J.col(j).norm() - now.J.col(j).norm());
      if (change < kink_change * std::max(trial.J.col(j).norm(), now.J.col(j).norm())) continue;
      if (change * std::abs(step[j]) > largest) most = j;
      largest = std::max(largest, change * std::abs(step[j]));
    }
    if (!most) return std::nullopt;
    const Eigen::VectorXd apart = (now.J - trial.J) * step;
    const double part = apart.dot(trial.e - now.e - trial.J * step) / apart.squaredNorm();
    if (!std::isfinite(part)) return std::nullopt;
    const bool up = step[*most] > 0;
    return Kink{*most, now.q[*most] + std::clamp(part, 0.0, 1.0) * step[*most], (up ? now : trial).J.col(*most),
                (up ? trial : now).J.col(*most)};
  }
  /// Holds a control at a kink from now on; false when that has been done often enough.
  bool hold(const Kink& kink) {
    if (--holds_left_ < 0) return false;
    std::erase_if(ik_.kinks_, [&](const Kink& other) { return other.control == kink.control; });
    ik_.kinks_.push_back(kink);
    return true;
  }
  /// Lets a held control go where on one of its sides the controls come nearer to the nominal ones, both by its effect
  /// on that side of the kink and by its effect here; false: none does. Once for each control and target.
  bool let_go(Iterate& now) {
    for (auto kink = ik_.kinks_.begin(); kink != ik_.kinks_.end(); ++kink) {
      if (std::ranges::count(let_go_, kink->control) > 0) continue;
      for (const bool up : {false, true}) {
        Bounds side = bounds(now);
        (up ? side.upper : side.lower)[kink->control] = up ? 1 : 0;
        Iterate along = now;
        along.e.setZero();
        const auto gains = [&] {
          const Quadratic near(along, nothing_learnt_, nominal_, pull_);
          const Eigen::VectorXd step = near.step(0, side);
          return step.size() > 0 && near.gain(step) > worthwhile_gain * near.offset.squaredNorm();
        };
        if (!gains()) continue;
        along.J.col(kink->control) = up ? kink->above : kink->below;
        if (!gains()) continue;
        now.J = along.J;
        let_go_.push_back(kink->control);
        ik_.kinks_.erase(kink);
        return true;
      }
    }
    return false;
  }
  /// Where nothing is found with held controls, they are free again, for good.
  bool give_in() {
    if (ik_.kinks_.empty()) return false;
    ik_.kinks_.clear();
    holds_left_ = 0;
    return true;
  }

  /// Levenberg-Marquardt within the bounds until the errors are within the tolerance, or no step brings them nearer.
  /// Where targets are out of reach, second derivatives of the errors count: these are learnt from the changes of the
  /// Jacobian (S, a symmetric rank-one secant), without which the last steps would creep. False when the search was
  /// given up.
  bool approach(Iterate& now, int most) {
    settled_ = false;
    // What was learnt goes on to count from one target out of reach to the next, unless that one seems in reach.
    Eigen::MatrixXd& S = ik_.curvature_;
    const bool in_reach =
        (now.e + now.J * Quadratic(now, nothing_learnt_, nominal_, pull_).step(0, bounds(now))).norm() <= 1;
    if (!ik_.lost_ || in_reach) S = nothing_learnt_;
    Damping damping;
    bool blocked = false;  // the last trial failed
    for (int iteration = 0; iteration < most && !given_up(now); ++iteration) {
      settled_ = within(now);
      if (settled_) return true;
      const Quadratic near(now, S, nominal_, pull_);
      const Eigen::VectorXd undamped = near.step(0, bounds(now)),
                            step = shortened(near.step(damping.level, bounds(now)));
      if (step.size() == 0 || undamped.size() == 0) {
        S.setZero();
        damping.raise();
        continue;
      }
      // A step that is short for its damping alone says nothing.
      const bool ended = near.promise(undamped) <= worthwhile_error * now.e.norm();
      if (ended && now.exact) {
        if (give_in()) continue;
        settled_ = !blocked;
        return true;
      }
      Iterate trial;
      const double promised = near.promise(step);
      const bool tried = !ended && promised > 0;
      if (tried) blocked = !go_on(now, step, trial);
      const double ratio = tried && !blocked ? (cost(now) - cost(trial)) / promised : -1.0;
      if (!(ratio > 1e-3 || (tried && !blocked && within(trial)))) {
        // Where not even the shortest steps do what the slopes say, as at the kink of a cable that goes slack, it ends.
        settled_ = tried && now.exact && step.norm() < shortest_trial && !give_in();
        if (settled_) return true;
        const std::optional<Kink> kink = tried && !blocked ? kink_between(now, trial) : std::nullopt;
        if (kink && hold(*kink)) continue;
        if (!now.exact && !renew(now)) return false;
        damping.raise();
        continue;
      }
      if (now.linear && trial.linear)
        learn((trial.J - now.J).transpose() * (now.e + now.J * undamped), trial.q - now.q, S);
      damping.lower(ratio);
      now = trial;
    }
    settled_ = within(now);
    return settled_;
  }

  /// A trial point with its Jacobian: by the factor where there is a new one, else by its own change (Broyden). False
  /// when there is no equilibrium.
  bool go_on(const Iterate& now, const Eigen::VectorXd& step, Iterate& trial) {
    ++iterations_;
    if (!move((now.q + step).cwiseMax(0.0).cwiseMin(1.0), trial)) return false;
    const Eigen::VectorXd moved = trial.q - now.q;
    if (trial.fresh)
      linearise(trial);
    else
      trial.J = now.J + (trial.e - now.e - now.J * moved) * moved.transpose() / moved.squaredNorm();
    return true;
  }
  /// Goes back and takes the Jacobian anew, by the factor there.
  bool renew(Iterate& now) {
    ik_.equilibrium_.start_at(now.u, now.p);
    if (!ik_.equilibrium_.refactorise()) return false;
    ++ik_.factorisations_;
    linearise(now);
    now.exact = true;
    return true;
  }

  /// A step of at most `longest`, which changes no control by more than a linear step may.
  static Eigen::VectorXd shortened(const Eigen::VectorXd& step,
                                   double longest = std::numeric_limits<double>::infinity()) {
    if (step.size() == 0 || step.isZero(0)) return step;
    return step * std::min({1.0, longest / step.norm(), longest_trial / step.cwiseAbs().maxCoeff()});
  }
  /// More searches than one share what they may take, and one that comes near to where another ended is going there.
  bool given_up(const Iterate& at) const {
    return tired() || (best_.q.size() > 0 && (at.q - best_.q).norm() < same_end);
  }
  double cost(const Iterate& at) const {
    return 0.5 * at.e.squaredNorm() + 0.5 * pull_ * (at.q - nominal_).squaredNorm();
  }

  Eigen::VectorXd errors() const {
    Eigen::VectorXd r(rows());
    r.head(targets_.size()) = weights_.cwiseProduct(ik_.values() - targets_);
    if (stiffness_) r[targets_.size()] = std::log(stiffness() / *stiffness_) / ik_.options_.stiffness_tolerance;
    return r;
  }

  /// Moves to where a search begins; where it is there already, the factor is made anew, since the first step is only
  /// as good as its tangent. Controls without effect are moved until they have one; where they get none, they stay.
  bool start(const Eigen::VectorXd& from, Iterate& at) {
    Eigen::VectorXd q = from, effect;
    for (double step = 0.01;; step *= 2) {
      if (!move(q, at)) return false;
      if (at.fresh)
        linearise(at);
      else if (!renew(at))
        return false;
      effect = at.J.colwise().norm();
      if (effect.minCoeff() >= awake_effect) return true;
      if (step >= 1) break;
      for (Eigen::Index j = 0; j < q.size(); ++j) {
        if (effect[j] < awake_effect) q[j] = std::min(1.0, q[j] + step);
      }
    }
    q = (effect.array() >= awake_effect).select(q, from);
    if (!move(q, at)) return false;
    linearise(at);
    return true;
  }

  /// Sets the Jacobian by the kept factor.
  void linearise(Iterate& at) {
    Eigen::MatrixXd& J = at.J;
    J.resize(rows(), controls());
    J.topRows(targets_.size()) = weights_.asDiagonal() * (ik_.derivatives() * ik_.range_.asDiagonal());
    if (stiffness_)
      J.row(targets_.size()) = log_stiffness_slopes(ik_.equilibrium_, ik_.options_.stiffness_direction, ik_.indices_,
                                                    slope_step * ik_.range_)
                                   .cwiseProduct(ik_.range_.transpose()) /
                               ik_.options_.stiffness_tolerance;
    at.linear = true;
  }

  double stiffness() const { return stiffness_along(ik_.equilibrium_, ik_.options_.stiffness_direction); }

  /// The best state, to which the equilibrium goes back, and what is to be said of it.
  IkResult result() {
    IkResult result;
    result.iterations = iterations_;
    Equilibrium& equilibrium = ik_.equilibrium_;
    if (best_.q.size() == 0) {
      result.message =
          fmt::format("no equilibrium was found where the search starts: {}", equilibrium.report().message());
      return result;
    }
    if (equilibrium.u() != best_.u || equilibrium.p() != best_.p || !equilibrium.has_factor()) {
      equilibrium.start_at(best_.u, best_.p);
      equilibrium.refactorise();
      ++ik_.factorisations_;
    }
    result.controls = ik_.from_range(best_.q);
    result.achieved = ik_.values();
    result.error = (result.achieved - targets_).norm();
    if (ik_.options_.stiffness_direction.size() > 0) result.stiffness = stiffness();
    for (const double q : best_.q) result.bound.push_back(q <= 1e-9 ? -1 : q >= 1 - 1e-9 ? 1 : 0);
    const std::string where =
        fmt::format("{:.4g} mm from the target{}{}{}", 1e3 * result.error,
                    stiffness_ ? fmt::format(", {:.4g} N/m instead of {:.4g} N/m", result.stiffness, *stiffness_) : "",
                    ik_.bounds_text(result), is_folded() ? ", with folded elements" : "");
    if (best_.reached) {
      result.status = IkStatus::reached;
      result.message = "reached: " + where;
    } else if (best_.settled) {
      result.status = IkStatus::unreachable;
      result.message = "out of reach, and the nearest point found is " + where;
    } else {
      result.message = fmt::format("the search did not end within {} steps: {}", ik_.options_.max_iterations, where);
    }
    return result;
  }

  SoftIk& ik_;
  const Eigen::VectorXd targets_, nominal_, weights_;
  const std::optional<double> stiffness_;
  const Eigen::MatrixXd nothing_learnt_;        ///< of the errors' second derivatives
  int most_ = std::numeric_limits<int>::max();  ///< factorisations
  double pull_ = 0;                             ///< weight of the square of the distance to the nominal controls
  int iterations_ = 0;                          ///< Levenberg-Marquardt steps so far
  int holds_left_ = 0;                          ///< how often a control may still be held at a kink
  std::vector<Eigen::Index> let_go_;            ///< controls that were let go
  bool settled_ = true;                         ///< the last search ended by itself
  End best_;
};

SoftIk::SoftIk(const Scene& scene, std::vector<IkChannel> channels, std::vector<IkControl> controls, IkOptions options)
    : scene_(&scene),
      channels_(std::move(channels)),
      controls_(std::move(controls)),
      options_(std::move(options)),
      equilibrium_(*scene.model, with_rough_tolerance(options_, scene.model->length_scale())) {
  if (channels_.empty() || controls_.empty())
    throw InputError("inverse kinematics needs at least one channel with a target and one control; name them");
  const ParameterTable& table = scene.model->parameters();
  for (IkControl& control : controls_) {
    const ParameterSpec& spec = table[control.index];
    if (!(control.lower < control.upper) || !(control.nominal >= control.lower && control.nominal <= control.upper))
      throw InputError(
          fmt::format("control '{}': its bounds are {:.6g} and {:.6g} {unit} and its nominal value {:.6g} "
                      "{unit}; the lower bound must be below the upper one and the nominal value between",
                      spec.id, control.lower, control.upper, control.nominal, fmt::arg("unit", spec.unit)));
    if (control.largest_step == 0)
      control.largest_step = spec.unit == "rad" ? std::numbers::pi / 6 : std::numeric_limits<double>::infinity();
    indices_.push_back(control.index);
  }
  lower_ = each(controls_, &IkControl::lower);
  range_ = each(controls_, &IkControl::upper) - lower_;
  if (options_.held.size() == 0) options_.held = scene.values;
  if (options_.rest.size() == 0) options_.rest = scene.values;
  forget();
}

void SoftIk::forget() {
  equilibrium_.start_at_rest(options_.rest);
  at_rest_ = true;
  lost_ = false;
  kinks_.clear();
}

void SoftIk::start_at(const Eigen::VectorXd& u, const Params& p) {
  equilibrium_.start_at(u, p);
  at_rest_ = lost_ = false;
  kinks_.clear();
}

Eigen::VectorXd SoftIk::from_range(const Eigen::VectorXd& q) const {
  return lower_ + range_.cwiseProduct(q.cwiseMax(0.0).cwiseMin(1.0));
}

Eigen::VectorXd SoftIk::to_range(const Eigen::VectorXd& c) const {
  return (c - lower_).cwiseQuotient(range_).cwiseMax(0.0).cwiseMin(1.0);
}

/// In as many solves as the controls' largest steps ask for; none where nothing changes.
bool SoftIk::move_to(const Eigen::VectorXd& controls, Polish polish) {
  const Eigen::VectorXd u = equilibrium_.u();
  const Params from = equilibrium_.p();
  Params to = options_.held;
  to(indices_) = controls;
  if (!at_rest_ && to == from && equilibrium_.has_factor()) return true;
  const Eigen::ArrayXd change = (to(indices_) - from(indices_)).cwiseAbs().array();
  const double steps = std::max(1.0, ceil(change / each(controls_, &IkControl::largest_step).array()).maxCoeff());
  for (double step = 1; step <= steps; ++step) {
    const Params next = step == steps ? to : Params(from + step / steps * (to - from));
    const SolveReport& report = equilibrium_.solve(next, polish);
    ++solves_;
    factorisations_ += report.factorisations;
    if (report.status == SolveStatus::converged) continue;
    equilibrium_.start_at(u, from);
    return false;
  }
  at_rest_ = false;
  return true;
}

Eigen::VectorXd SoftIk::values() const {
  const Point at{equilibrium_.u(), equilibrium_.p()};
  return each(channels_, [&](const IkChannel& one) { return one.channel->value(at); });
}

/// (channels x controls).
Eigen::MatrixXd SoftIk::derivatives() const {
  const Eigen::MatrixXd sensitivities = equilibrium_.sensitivities(indices_);
  Eigen::MatrixXd J(static_cast<Eigen::Index>(channels_.size()), range_.size());
  Eigen::Index row = 0;
  for (const IkChannel& one : channels_)
    J.row(row++) = channel_derivatives(*one.channel, {equilibrium_.u(), equilibrium_.p()}, sensitivities, indices_);
  return J;
}

/// ", with 'a' at its lower bound, 'b' at its upper bound" or "".
std::string SoftIk::bounds_text(const IkResult& result) const {
  std::string text;
  for (size_t j = 0; j < result.bound.size(); ++j) {
    if (result.bound[j] == 0) continue;
    text += fmt::format("{}'{}' at its {} bound", text.empty() ? ", with " : ", ",
                        scene_->model->parameters()[indices_[j]].id, result.bound[j] < 0 ? "lower" : "upper");
  }
  return text;
}

IkResult SoftIk::solve(const Eigen::VectorXd& targets, std::optional<double> stiffness) {
  if (targets.size() != static_cast<Eigen::Index>(channels_.size()) || !targets.allFinite())
    throw InputError(fmt::format("{} targets were given to inverse kinematics with {} channels; give each a finite one",
                                 targets.size(), channels_.size()));
  if (stiffness && (!(*stiffness > 0) || options_.stiffness_direction.size() == 0))
    throw InputError(
        fmt::format("a stiffness of {:.6g} N/m is no target; it must be positive, and the options must "
                    "name its direction",
                    *stiffness));
  if (stiffness && std::ranges::any_of(scene_->model->bodies(), &Body::rigid))
    throw InputError(
        "a stiffness is no target where segments are rigid; set model = \"full\", or ask for places alone");
  const Stopwatch stopwatch;
  solves_ = factorisations_ = 0;
  IkResult result = Search(*this, targets, stiffness).run();
  result.solves = solves_;
  result.factorisations = factorisations_;
  result.seconds = stopwatch.seconds();
  return result;
}

}  // namespace taut
