#include "sim/robots/soft_ik.hpp"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "sim/core/error.hpp"
#include "sim/core/stopwatch.hpp"
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
    const Eigen::LLT<Eigen::MatrixXd> llt(B(free, free));
    if (llt.info() != Eigen::Success) return {};
    for (Eigen::Index j : free) step[j] = 0;
    const Eigen::VectorXd slope = g + B * step;
    step(free) = -llt.solve(slope(free));
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
      : ik_(ik), targets_(targets), stiffness_(stiffness) {
    for (const IkChannel& channel : ik.channels_) weights_.push_back(channel.weight / ik.options_.tolerance);
    Eigen::VectorXd nominal(controls());
    for (size_t j = 0; j < ik.controls_.size(); ++j) nominal[static_cast<Eigen::Index>(j)] = ik.controls_[j].nominal;
    nominal_ = ik.to_range(nominal);
  }

  double pull = 1;      ///< weight of the distance to the nominal controls
  int iterations = 0;   ///< Levenberg-Marquardt steps so far
  bool settled = true;  ///< the last search ended by itself

  const Eigen::VectorXd& nominal() const { return nominal_; }

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

  /// The equilibrium was set to another state.
  void forget() { point_.resize(0); }

  /// Norm of the errors in units of the tolerance at the last point.
  double distance() const { return errors_.norm(); }
  /// Whether the last point meets the targets, weights aside.
  bool reached() const {
    return (ik_.values() - targets_).norm() <= ik_.options_.tolerance &&
           (!stiffness_ || std::abs(errors_[targets_.size()]) <= 1);
  }
  const Eigen::MatrixXd& slopes() const { return slopes_; }

  /// The best state of several searches.
  struct End {
    Eigen::VectorXd q, u;
    Params p;
    double distance = std::numeric_limits<double>::infinity();
    bool settled = false, reached = false;
  };

  /// Searches from q and keeps what it finds where that is better, and not folded unless there is nothing else.
  void attempt(const Eigen::VectorXd& from, End& best) {
    if (!evaluate(from, true)) return;
    pull = 1;
    Eigen::VectorXd q = minimise(awake(from));
    pull = 0;
    q = minimise(q);
    const bool found = settled;
    if (!evaluate(q, true) || !(distance() < best.distance)) return;
    const bool folded = smallest_jacobian(ik_.scene_->model->mesh(), ik_.equilibrium_.u()) <= 0;
    if (folded && best.q.size() > 0) return;
    best = {q, ik_.equilibrium_.u(), ik_.equilibrium_.p(), distance(), found, reached()};
  }

  /// Levenberg-Marquardt within the bounds from q; returns the best point. Where targets are out of reach, residuals
  /// stay and their second derivatives count: these are learnt from the changes of the Jacobian (S, a symmetric
  /// rank-one secant), without which the last steps would creep. Within the tolerance the Jacobian alone is right.
  Eigen::VectorXd minimise(Eigen::VectorXd q) {
    settled = false;
    if (!evaluate(q, true)) return q;
    Eigen::VectorXd r = residuals(q);
    Eigen::MatrixXd J = jacobian(), S = Eigen::MatrixXd::Zero(controls(), controls());
    double damping = 1e-6, growth = 2;
    bool blocked = false;  // the last trial failed
    for (int iteration = 0; iteration < ik_.options_.max_iterations; ++iteration) {
      const double cost = 0.5 * r.squaredNorm();
      if (2 * cost <= enough * enough) {
        settled = true;
        break;
      }
      const Eigen::VectorXd g = J.transpose() * r;
      const Eigen::MatrixXd squares = J.transpose() * J, B = squares + S;
      Eigen::VectorXd scale = squares.diagonal();
      scale = scale.cwiseMax(1e-6 * scale.maxCoeff() + 1e-12);
      const auto step_at = [&](double level) {
        return bounded_step(B + Eigen::MatrixXd(level * scale.asDiagonal()), g, q);
      };
      const auto promise = [&](const Eigen::VectorXd& s) { return -g.dot(s) - 0.5 * s.dot(B * s); };
      const Eigen::VectorXd step = step_at(damping), undamped = step_at(1e-9);
      if (step.size() == 0) {
        S.setZero();
        continue;
      }
      // A step that is short for its damping alone says nothing, nor does one that the bounds have turned uphill.
      const double hope = undamped.size() > 0 ? promise(undamped) : -1;
      if (hope >= 0 && hope <= (pull > 0 ? 1e-5 : 1e-8) * cost) {
        settled = !blocked;
        break;
      }
      const double promised = promise(step);
      if (!(promised > 0)) {
        damping = growth * std::max(damping, 1e-4);
        growth *= 2;
        continue;
      }
      const Eigen::VectorXd trial = (q + step).cwiseMax(0.0).cwiseMin(1.0);
      ++iterations;
      blocked = !evaluate(trial, false);
      const double ratio = blocked ? -1.0 : (cost - 0.5 * residuals(trial).squaredNorm()) / promised;
      if (ratio > 1e-3 && evaluate(trial, true)) {
        S *= residuals(trial).norm() / r.norm();
        r = residuals(trial);
        const Eigen::VectorXd miss = (jacobian() - J).transpose() * r - S * step;
        if (std::abs(miss.dot(step)) > 1e-8 * miss.norm() * step.norm()) S += miss * miss.transpose() / miss.dot(step);
        if (distance() < 1) S.setZero();
        J = jacobian();
        q = trial;
        damping *= std::max(1.0 / 9, 1 - std::pow(2 * ratio - 1, 3));
        growth = 2;
      } else {
        damping = growth * std::max(damping, 1e-4);
        growth *= 2;
      }
    }
    return q;
  }

 private:
  Eigen::Index controls() const { return static_cast<Eigen::Index>(ik_.controls_.size()); }
  Eigen::Index rows() const { return targets_.size() + (stiffness_ ? 1 : 0); }

  Eigen::VectorXd errors() const {
    Eigen::VectorXd r(rows());
    const Eigen::VectorXd y = ik_.values();
    for (Eigen::Index i = 0; i < y.size(); ++i) r[i] = weights_[static_cast<size_t>(i)] * (y[i] - targets_[i]);
    if (stiffness_) r[y.size()] = std::log(ik_.stiffness() / *stiffness_) / ik_.options_.stiffness_tolerance;
    return r;
  }

  /// Errors, and the pull towards the nominal controls.
  Eigen::VectorXd residuals(const Eigen::VectorXd& q) const {
    Eigen::VectorXd r(rows() + controls());
    r << errors_, pull * (q - nominal_);
    return r;
  }
  Eigen::MatrixXd jacobian() const {
    Eigen::MatrixXd J(rows() + controls(), controls());
    J << slopes_, pull * Eigen::MatrixXd::Identity(controls(), controls());
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
    J.topRows(targets_.size()) = ik_.derivatives() * ik_.range_.asDiagonal();
    for (Eigen::Index i = 0; i < targets_.size(); ++i) J.row(i) *= weights_[static_cast<size_t>(i)];
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

  SoftIk& ik_;
  Eigen::VectorXd targets_, nominal_;
  std::optional<double> stiffness_;
  std::vector<double> weights_;
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
  lower_.resize(static_cast<Eigen::Index>(controls_.size()));
  range_.resize(lower_.size());
  for (size_t j = 0; j < controls_.size(); ++j) {
    IkControl& control = controls_[j];
    const ParameterSpec& spec = table[control.index];
    if (!(control.lower < control.upper) || !(control.nominal >= control.lower && control.nominal <= control.upper))
      throw InputError(
          fmt::format("control '{}': its bounds are {:.6g} and {:.6g} {unit} and its nominal value {:.6g} "
                      "{unit}; the lower bound must be below the upper one and the nominal value between",
                      spec.id, control.lower, control.upper, control.nominal, fmt::arg("unit", spec.unit)));
    if (control.largest_step == 0)
      control.largest_step = spec.unit == "rad" ? std::numbers::pi / 6 : std::numeric_limits<double>::infinity();
    indices_.push_back(control.index);
    lower_[static_cast<Eigen::Index>(j)] = control.lower;
    range_[static_cast<Eigen::Index>(j)] = control.upper - control.lower;
  }
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
  double steps = 1;
  for (size_t j = 0; j < controls_.size(); ++j) {
    to[indices_[j]] = controls[static_cast<Eigen::Index>(j)];
    steps = std::max(steps, std::ceil(std::abs(to[indices_[j]] - from[indices_[j]]) / controls_[j].largest_step));
  }
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
  Eigen::VectorXd y(static_cast<Eigen::Index>(channels_.size()));
  for (size_t i = 0; i < channels_.size(); ++i)
    y[static_cast<Eigen::Index>(i)] = channels_[i].channel->value({equilibrium_.u(), equilibrium_.p()});
  return y;
}

/// dy/dc = dy/du du/dc + dy/dc at fixed u, shape (channels x controls).
Eigen::MatrixXd SoftIk::derivatives() const {
  const Eigen::MatrixXd sensitivities = equilibrium_.sensitivities(indices_);
  const Point at{equilibrium_.u(), equilibrium_.p()};
  Eigen::MatrixXd J(static_cast<Eigen::Index>(channels_.size()), static_cast<Eigen::Index>(controls_.size()));
  for (size_t i = 0; i < channels_.size(); ++i) {
    const Eigen::Index row = static_cast<Eigen::Index>(i);
    J.row(row) = channels_[i].channel->gradient(at).transpose() * sensitivities;
    for (size_t j = 0; j < controls_.size(); ++j)
      J(row, static_cast<Eigen::Index>(j)) += channels_[i].channel->parameter_derivative(at, indices_[j]);
  }
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
  IkResult result;
  Search search(*this, targets, stiffness);
  const auto finish = [&](IkStatus status, std::string message) {
    result.status = status;
    result.message = std::move(message);
    result.iterations = search.iterations;
    result.solves = solves_;
    result.factorisations = factorisations_;
    result.seconds = stopwatch.seconds();
    return result;
  };

  Search::End best;
  if (smallest_jacobian(scene_->model->mesh(), equilibrium_.u()) <= 0) forget();  // a folded state is no start
  const Eigen::VectorXd u = equilibrium_.u();
  const Params p = equilibrium_.p();
  Eigen::VectorXd current(range_.size());
  for (size_t j = 0; j < controls_.size(); ++j) current[static_cast<Eigen::Index>(j)] = p[indices_[j]];
  const Eigen::VectorXd start = at_rest_ ? search.nominal() : to_range(current);
  at_rest_ = false;

  search.attempt(start, best);
  const Eigen::VectorXd first = best.q.size() > 0 ? best.q : start;
  const Eigen::VectorXd half = Eigen::VectorXd::Constant(range_.size(), 0.5);
  const Eigen::VectorXd others[] = {search.nominal(), Eigen::VectorXd::Ones(range_.size()) - first, half};
  for (int k = 0; k < std::min(3, options_.restarts) && !best.reached; ++k) {
    equilibrium_.start_at(u, p);
    search.forget();
    search.attempt(others[k], best);
  }
  if (best.q.size() == 0)
    return finish(IkStatus::failed,
                  fmt::format("no equilibrium was found where the search starts: {}", equilibrium_.report().message()));
  if (equilibrium_.u() != best.u || equilibrium_.p() != best.p || !equilibrium_.has_factor()) {
    equilibrium_.start_at(best.u, best.p);
    equilibrium_.refactorise();
    ++factorisations_;
  }

  result.controls = from_range(best.q);
  result.achieved = values();
  result.error = (result.achieved - targets).norm();
  if (options_.stiffness_direction.size() > 0) result.stiffness = this->stiffness();
  for (const double q : best.q) result.bound.push_back(q <= 1e-9 ? -1 : q >= 1 - 1e-9 ? 1 : 0);
  const std::string where = fmt::format(
      "{:.4g} mm from the target{}{}{}", 1e3 * result.error,
      stiffness ? fmt::format(", {:.4g} N/m instead of {:.4g} N/m", result.stiffness, *stiffness) : "",
      bounds_text(result), smallest_jacobian(scene_->model->mesh(), best.u) > 0 ? "" : ", with folded elements");
  if (best.reached) return finish(IkStatus::reached, fmt::format("reached: {}", where));
  if (!best.settled)
    return finish(IkStatus::failed,
                  fmt::format("the search did not end within {} steps: {}", options_.max_iterations, where));
  return finish(IkStatus::unreachable, fmt::format("out of reach, and the nearest point found is {}", where));
}

}  // namespace taut
