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

constexpr double enough = 0.01;  ///< errors below this part of the tolerance are not worth another step

/// The step s from q that minimises g . s + s . B s / 2 with 0 <= q + s <= 1: controls that leave are held at their
/// bounds and the others solved again; empty when B is not positive definite on those.
Eigen::VectorXd bounded_step(const Eigen::MatrixXd& B, const Eigen::VectorXd& g, const Eigen::VectorXd& q) {
  std::vector<Eigen::Index> free;
  for (Eigen::Index j = 0; j < q.size(); ++j) {
    if (!((q[j] <= 0 && g[j] >= 0) || (q[j] >= 1 && g[j] <= 0))) free.push_back(j);
  }
  Eigen::VectorXd step = Eigen::VectorXd::Zero(q.size());
  while (!free.empty()) {
    for (Eigen::Index j : free) step[j] = 0;
    const Eigen::VectorXd slope = g + B * step;
    const std::optional<Eigen::MatrixXd> inner = solve_positive_definite(B(free, free), slope(free));
    if (!inner) return {};
    step(free) = -*inner;
    std::vector<Eigen::Index> inside;
    for (Eigen::Index j : free) {
      if (q[j] + step[j] >= 0 && q[j] + step[j] <= 1) {
        inside.push_back(j);
      } else {
        step[j] = (step[j] < 0 ? 0.0 : 1.0) - q[j];
      }
    }
    if (inside.size() == free.size()) break;
    free = inside;
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

/// The sum of squares near a point: residuals r with their Jacobian J, and what S knows of their second derivatives.
struct Quadratic {
  Eigen::VectorXd g, scale;
  Eigen::MatrixXd B;

  Quadratic(const Eigen::MatrixXd& J, const Eigen::VectorXd& r, const Eigen::MatrixXd& S) : g(J.transpose() * r) {
    const Eigen::MatrixXd squares = J.transpose() * J;
    B = squares + S;
    scale = squares.diagonal();
    scale = scale.cwiseMax(1e-6 * scale.maxCoeff() + 1e-12);
  }
  Eigen::VectorXd step(const Eigen::VectorXd& q, double damping) const {
    return bounded_step(B + Eigen::MatrixXd(damping * scale.asDiagonal()), g, q);
  }
  /// How much half the sum is to fall with a step.
  double promise(const Eigen::VectorXd& s) const { return -g.dot(s) - 0.5 * s.dot(B * s); }
};

/// Levenberg's and Marquardt's damping, raised the faster the more steps in a row have failed (Nielsen).
struct Damping {
  double level = 1e-6, growth = 2;

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

/// The least-squares problem of one solve. Controls are seen as fractions q of their ranges, errors in units of the
/// tolerance. The newest evaluation is kept: residuals are asked for first and derivatives at the same point later.
class SoftIk::Search {
 public:
  Search(SoftIk& ik, const Eigen::VectorXd& targets, std::optional<double> stiffness)
      : ik_(ik),
        targets_(targets),
        nominal_(ik.to_range(each(ik.controls_, &IkControl::nominal))),
        weights_(each(ik.channels_, &IkChannel::weight) / ik.options_.tolerance),
        stiffness_(stiffness) {}

  /// From where the equilibrium is (the nominal controls at rest), and while targets are not reached from other starts.
  IkResult run() {
    if (is_folded()) ik_.forget();  // no start
    const Eigen::VectorXd u = ik_.equilibrium_.u();
    const Params p = ik_.equilibrium_.p();
    const Eigen::VectorXd start = ik_.at_rest_ ? nominal_ : ik_.to_range(p(ik_.indices_));
    ik_.at_rest_ = false;
    attempt(start);
    const Eigen::VectorXd first = best_.q.size() > 0 ? best_.q : start;
    const Eigen::VectorXd others[] = {nominal_, Eigen::VectorXd::Ones(controls()) - first,
                                      Eigen::VectorXd::Constant(controls(), 0.5)};
    for (int k = 0; k < std::min(3, ik_.options_.restarts) && !best_.reached; ++k) {
      ik_.equilibrium_.start_at(u, p);
      point_.resize(0);
      attempt(others[k]);
    }
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
  /// Norm of the errors in units of the tolerance at the last point.
  double distance() const { return errors_.norm(); }
  /// Whether the last point meets the targets, weights aside.
  bool reached() const {
    return (ik_.values() - targets_).norm() <= ik_.options_.tolerance &&
           (!stiffness_ || std::abs(errors_[targets_.size()]) <= 1);
  }

  /// Moves the equilibrium to q; false, and the equilibrium where it was, when there is none on the way.
  bool evaluate(const Eigen::VectorXd& q, bool derivatives) {
    if (point_.size() == 0 || point_ != q) {
      point_ = q;
      slopes_.resize(0, 0);
      ok_ = ik_.move_to(ik_.from_range(q));
      if (ok_) errors_ = errors();
    }
    if (ok_ && derivatives && slopes_.size() == 0) ok_ = differentiate();
    return ok_;
  }

  /// Searches from a point and keeps what it finds where that is better, and not folded unless there is nothing else.
  void attempt(const Eigen::VectorXd& from) {
    if (!evaluate(from, true)) return;
    pull_ = 1;
    Eigen::VectorXd q = minimise(awake(from));
    pull_ = 0;
    q = minimise(q);
    const bool found = settled_;
    if (!evaluate(q, true) || !(distance() < best_.distance)) return;
    if (best_.q.size() > 0 && is_folded()) return;
    best_ = {q, ik_.equilibrium_.u(), ik_.equilibrium_.p(), distance(), found, reached()};
  }

  /// Levenberg-Marquardt within the bounds from q; returns the best point. Where targets are out of reach, residuals
  /// stay and their second derivatives count: these are learnt from the changes of the Jacobian (S, a symmetric
  /// rank-one secant), without which the last steps would creep. Within the tolerance the Jacobian alone is right.
  Eigen::VectorXd minimise(Eigen::VectorXd q) {
    settled_ = false;
    if (!evaluate(q, true)) return q;
    Eigen::VectorXd r = residuals(q);
    Eigen::MatrixXd J = jacobian(), S = Eigen::MatrixXd::Zero(controls(), controls());
    Damping damping;
    bool blocked = false;  // the last trial failed
    for (int iteration = 0; iteration < ik_.options_.max_iterations; ++iteration) {
      const double cost = 0.5 * r.squaredNorm();
      settled_ = 2 * cost <= enough * enough;
      if (settled_) break;
      const Quadratic near(J, r, S);
      const Eigen::VectorXd step = near.step(q, damping.level), undamped = near.step(q, 1e-9);
      if (step.size() == 0) {
        S.setZero();
        continue;
      }
      // A step that is short for its damping alone says nothing, nor does one that the bounds have turned uphill.
      const double hope = undamped.size() > 0 ? near.promise(undamped) : -1;
      if (hope >= 0 && hope <= (pull_ > 0 ? 1e-5 : 1e-8) * cost) {
        settled_ = !blocked;
        break;
      }
      const double promised = near.promise(step);
      if (!(promised > 0)) {
        damping.raise();
        continue;
      }
      const Eigen::VectorXd trial = (q + step).cwiseMax(0.0).cwiseMin(1.0);
      ++iterations_;
      blocked = !evaluate(trial, false);
      const double ratio = blocked ? -1.0 : (cost - 0.5 * residuals(trial).squaredNorm()) / promised;
      if (!(ratio > 1e-3 && evaluate(trial, true))) {
        damping.raise();
        continue;
      }
      S *= residuals(trial).norm() / r.norm();
      r = residuals(trial);
      learn((jacobian() - J).transpose() * r, step, S);
      if (distance() < 1) S.setZero();
      J = jacobian();
      q = trial;
      damping.lower(ratio);
    }
    return q;
  }

  Eigen::VectorXd errors() const {
    Eigen::VectorXd r(rows());
    r.head(targets_.size()) = weights_.cwiseProduct(ik_.values() - targets_);
    if (stiffness_) r[targets_.size()] = std::log(ik_.stiffness() / *stiffness_) / ik_.options_.stiffness_tolerance;
    return r;
  }

  /// Errors, and the pull towards the nominal controls.
  Eigen::VectorXd residuals(const Eigen::VectorXd& q) const {
    Eigen::VectorXd r(rows() + controls());
    r << errors_, pull_ * (q - nominal_);
    return r;
  }
  Eigen::MatrixXd jacobian() const {
    Eigen::MatrixXd J(rows() + controls(), controls());
    J << slopes_, pull_ * Eigen::MatrixXd::Identity(controls(), controls());
    return J;
  }

  /// Controls without effect are moved until they have one; where they get none, they stay.
  Eigen::VectorXd awake(const Eigen::VectorXd& from) {
    Eigen::VectorXd q = from;
    for (double step = 0.01; step < 1 && evaluate(q, true); step *= 2) {
      const Eigen::VectorXd effect = slopes_.colwise().norm();
      if (effect.minCoeff() >= enough) return q;
      for (Eigen::Index j = 0; j < q.size(); ++j) {
        if (effect[j] < enough) q[j] = std::min(1.0, q[j] + step);
      }
    }
    if (!evaluate(q, true)) return from;
    const Eigen::VectorXd effect = slopes_.colwise().norm();
    return (effect.array() >= enough).select(q, from);
  }

  bool differentiate() {
    Eigen::MatrixXd J(rows(), controls());
    J.topRows(targets_.size()) = weights_.asDiagonal() * (ik_.derivatives() * ik_.range_.asDiagonal());
    if (stiffness_) {
      const Eigen::VectorXd u = ik_.equilibrium_.u();
      const Params p = ik_.equilibrium_.p();
      for (Eigen::Index j = 0; j < controls(); ++j) {
        Eigen::VectorXd q = point_;
        const double step = q[j] < 0.5 ? 1e-3 : -1e-3;  // stays within the bounds
        q[j] += step;
        const bool moved = ik_.move_to(ik_.from_range(q));
        if (moved) J(targets_.size(), j) = (errors()[targets_.size()] - errors_[targets_.size()]) / step;
        ik_.equilibrium_.start_at(u, p);
        if (!ik_.equilibrium_.refactorise() || !moved) return false;
        ++ik_.factorisations_;
      }
    }
    slopes_ = J;
    return true;
  }

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
    if (ik_.options_.stiffness_direction.size() > 0) result.stiffness = ik_.stiffness();
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
  double pull_ = 1;      ///< weight of the distance to the nominal controls
  int iterations_ = 0;   ///< Levenberg-Marquardt steps so far
  bool settled_ = true;  ///< the last search ended by itself
  End best_;
  Eigen::VectorXd point_, errors_;
  Eigen::MatrixXd slopes_;
  bool ok_ = false;
};

SoftIk::SoftIk(const Scene& scene, std::vector<IkChannel> channels, std::vector<IkControl> controls, IkOptions options)
    : scene_(&scene),
      channels_(std::move(channels)),
      controls_(std::move(controls)),
      options_(std::move(options)),
      equilibrium_(*scene.model, options_.equilibrium) {
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
}

Eigen::VectorXd SoftIk::from_range(const Eigen::VectorXd& q) const {
  return lower_ + range_.cwiseProduct(q.cwiseMax(0.0).cwiseMin(1.0));
}

Eigen::VectorXd SoftIk::to_range(const Eigen::VectorXd& c) const {
  return (c - lower_).cwiseQuotient(range_).cwiseMax(0.0).cwiseMin(1.0);
}

/// In as many solves as the controls' largest steps ask for.
bool SoftIk::move_to(const Eigen::VectorXd& controls) {
  const Eigen::VectorXd u = equilibrium_.u();
  const Params from = equilibrium_.p();
  Params to = options_.held;
  to(indices_) = controls;
  const Eigen::ArrayXd change = (to(indices_) - from(indices_)).cwiseAbs().array();
  const double steps = std::max(1.0, ceil(change / each(controls_, &IkControl::largest_step).array()).maxCoeff());
  for (double step = 1; step <= steps; ++step) {
    const Params next = step == steps ? to : Params(from + step / steps * (to - from));
    const SolveReport& report = equilibrium_.solve(next);
    ++solves_;
    factorisations_ += report.factorisations;
    if (report.status == SolveStatus::converged) continue;
    equilibrium_.start_at(u, from);
    return false;
  }
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

double SoftIk::stiffness() const {
  const Eigen::VectorXd& c = options_.stiffness_direction;
  return 1 / c.dot(equilibrium_.solve_linear(c).col(0));
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
  const Stopwatch stopwatch;
  solves_ = factorisations_ = 0;
  IkResult result = Search(*this, targets, stiffness).run();
  result.solves = solves_;
  result.factorisations = factorisations_;
  result.seconds = stopwatch.seconds();
  return result;
}

}  // namespace taut
