#include "sim/solve/equilibrium.hpp"

#include <fmt/format.h>

#include <limits>
#include <stdexcept>
#include <utility>

namespace taut {
namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();
constexpr double epsilon = std::numeric_limits<double>::epsilon();

double largest(const Eigen::VectorXd& v) {
  return v.size() == 0 ? 0.0 : v.cwiseAbs().maxCoeff();
}

}  // namespace

std::string_view name_of(SolveStatus status) {
  constexpr std::string_view names[] = {"converged",     "infeasible start", "iteration limit", "stalled",
                                        "not a minimum", "load step limit",  "interrupted"};
  return names[static_cast<size_t>(status)];
}

std::string SolveReport::message() const {
  std::string text = fmt::format("{}: {} Newton iterations, {} factorisations, {} load step{}", name_of(status),
                                 iterations, factorisations, load_steps, load_steps == 1 ? "" : "s");
  if (left_saddle) text += ", left an unstable equilibrium";
  if (slipped) text += fmt::format(", slipped to another equilibrium after {:.3g} % of the load", 100 * slipped_after);
  if (status != SolveStatus::converged) {
    text += fmt::format(", reached {:.3g} % of the load, out-of-balance force {:.3g} N", 100 * reached, gradient);
  }
  if (status == SolveStatus::load_step_limit)
    text += "; the path may end there, as at a limit load: lower the load, or allow more iterations";
  return text;
}

Equilibrium::Equilibrium(const Model& model, EquilibriumOptions options)
    : model_(&model), options_(options), hessian_(model) {}

void Equilibrium::start_at_rest(const Params& p) {
  start_at(Eigen::VectorXd::Zero(model_->unknowns()), p);
  hessian_.forget_couplings();
}

void Equilibrium::start_at(const Eigen::VectorXd& u, const Params& p) {
  step_ = nullptr;
  u_ = u;
  p_ = p;
  has_factor_ = false;
}

void Equilibrium::start_beyond(const Eigen::VectorXd& u, const Eigen::VectorXd& step, const Params& p) {
  double fraction = 1;
  start_at(motion(p).admissible(u, step, p, fraction), p);
}

/// Assembles gradient and Hessian at u and factorises: exact, else projected, else projected and shifted.
bool Equilibrium::factorise(bool& exact, const Eigen::VectorXd& u, const Params& p, Eigen::VectorXd& gradient) {
  hessian_.assemble(at(u, p), options_.comparison.always_project ? Curvature::projected : Curvature::exact, &gradient);
  exact = !options_.comparison.always_project;
  if (hessian_.factorise()) return true;
  exact = false;
  ++report_.projections;
  if (buckling_) {
    // The softening is slight and of the body as a whole. Element by element projection would remove far more than that
    // and creep along; a shift just beyond it keeps the rest of the curvature.
    const double scale = hessian_.mean_diagonal();
    for (double shift = 1e-12 * scale; shift <= 1e-4 * scale; shift *= 10) {
      if (hessian_.factorise(shift)) return true;
    }
  }
  if (!options_.comparison.always_project) hessian_.assemble(at(u, p), Curvature::projected, &gradient);
  for (double shift = 0, scale = hessian_.mean_diagonal(); shift < 1e3 * scale;
       shift = std::max(10 * shift, 1e-8 * scale)) {
    if (hessian_.factorise(shift)) return true;
    if (scale == 0 || !std::isfinite(scale)) break;
  }
  return false;
}

Eigen::VectorXd Equilibrium::free_gradient_at(const Eigen::VectorXd& u, const Params& p) const {
  Eigen::VectorXd gradient;
  Assembly out;
  out.gradient = &gradient;
  model_->evaluate(at(u, p), out);
  return hessian_.reduction().restrict_to_free(u, gradient);
}

/// Newton's step from u. False when there is none.
bool Equilibrium::find_direction(const Eigen::VectorXd& u, const Params& p, Direction& to) {
  Eigen::VectorXd gradient;
  if (!factorise(to.exact, u, p, gradient)) return false;
  ++report_.iterations;
  to.gradient = hessian_.reduction().restrict_to_free(u, gradient);
  to.step = -hessian_.solve(to.gradient);
  if (!to.step.allFinite()) return false;
  report_.gradient = largest(to.gradient);
  to.slope = to.gradient.dot(to.step);
  return true;
}

/// Near the rounding floor energies cannot tell better from worse; the gradient can (approximate Wolfe conditions).
bool Equilibrium::better_by_gradient(const Eigen::VectorXd& trial, const Params& p, const Direction& way) const {
  const Eigen::VectorXd gradient = free_gradient_at(trial, p);
  return std::abs(gradient.dot(way.step)) <= 0.9 * std::abs(way.slope) || gradient.norm() <= 0.9 * way.gradient.norm();
}

/// Goes back and shortens a step until the energy decreases enough. False, and where the step began, when it never
/// does.
bool Equilibrium::shorten(const Step& from, const Params& p, Eigen::VectorXd& u, Assembly& energy) const {
  const double shortest = 1e-9 * from.fraction;
  double fraction = 0.5 * from.fraction;
  for (; fraction > shortest; fraction *= 0.5) {
    u = motion(p).admissible(from.u, from.step, p, fraction);
    model_->evaluate(at(u, p), energy);
    if (energy.energy <= from.energy.energy + 1e-4 * fraction * from.slope) break;
  }
  if (fraction > shortest) return true;
  u = from.u;
  energy = from.energy;
  return false;
}

/// Newton's method at fixed p. `u` is the start (supports imposed) and the result.
///
/// Line search with a watchdog (Chamberlain et al. 1982): a full step that raises the energy is taken all the same,
/// once, and only when the step after it does not make up for it does the search go back and shorten the first one. A
/// step along a stiff constraint (a segment that turns, a volume that must not change) leaves it to second order; a
/// line search alone would creep along, where the next Newton step simply returns to it.
Equilibrium::NewtonResult Equilibrium::minimise(Eigen::VectorXd& u, const Params& p) {
  Step reference;
  const Motion motions = motion(p);
  Assembly energy, next;
  model_->evaluate(at(u, p), energy);
  if (!std::isfinite(energy.energy)) return {SolveStatus::infeasible_start, false};

  const double tolerance = options_.step_tolerance * model_->length_scale();
  const LineSearch search = options_.comparison.line_search;
  bool on_trust = false;  // the last step raised the energy and is still to be made up for
  const int limit = (buckling_ ? 4 : 1) * options_.max_iterations;  // the way into a post-buckled shape is long
  for (int iteration = 0; iteration < limit; ++iteration) {
    if (stopped()) return {SolveStatus::interrupted, false};
    Direction way;
    if (!find_direction(u, p, way)) return {SolveStatus::stalled, false};
    if (report_.gradient < options_.comparison.stop_at_force) return {SolveStatus::converged, way.exact};
    const double noise = 10 * epsilon * energy.magnitude;
    const Eigen::VectorXd step = hessian_.reduction().extend_from_free(u, way.step);
    double fraction = 1;
    Eigen::VectorXd trial = motions.admissible(u, step, p, fraction);
    if (fraction == 0 && search != LineSearch::none) return {SolveStatus::stalled, false};
    model_->evaluate(at(trial, p), next);
    // The Newton step is the error estimate. A last full step costs no factorisation and leaves an error of its square.
    const double size = largest(way.step);
    if (search == LineSearch::none) {
      u = trial;
      energy = next;
      if (!std::isfinite(energy.energy)) return {SolveStatus::stalled, false};
      if (size <= tolerance) return {SolveStatus::converged, way.exact};
      continue;
    }
    if (size <= tolerance) {
      if (next.energy <= energy.energy + noise) u = trial;
      return {SolveStatus::converged, way.exact};
    }
    if (polish_ == Polish::search && way.exact && fraction == 1 && next.energy <= energy.energy) {
      Eigen::VectorXd refined = trial;
      if (refine(refined, p, 0.1 * size)) {
        u = refined;
        return {SolveStatus::converged, true};
      }
    }
    if (!on_trust) reference = {u, step, energy, way.slope, fraction};
    const bool armijo = search == LineSearch::armijo;
    const bool sufficient = next.energy <= reference.energy.energy + 1e-4 * reference.fraction * reference.slope ||
                            (!armijo && next.energy <= energy.energy + noise && better_by_gradient(trial, p, way));
    if (sufficient || (!armijo && !on_trust && std::isfinite(next.energy))) {
      on_trust = !sufficient;
      u = trial;
      energy = next;
      continue;
    }
    on_trust = false;
    if (shorten(reference, p, u, energy)) continue;
    // No acceptable step; when even the predicted decrease is below what rounding lets us see, this is the floor.
    const bool floor = !armijo && std::abs(reference.slope) <= 10 * epsilon * reference.energy.magnitude;
    return {floor ? SolveStatus::converged : SolveStatus::stalled, false};
  }
  return {SolveStatus::iteration_limit, false};
}

/// Steps with the last factor again, as long as each is at most a tenth of the one before it; the first one says how
/// much the Hessian has changed since. True when u has come to the tolerance.
bool Equilibrium::refine(Eigen::VectorXd& u, const Params& p, double largest_step) {
  const double tolerance = options_.step_tolerance * model_->length_scale();
  for (int iteration = 0; iteration < 8; ++iteration) {
    const Eigen::VectorXd step = -hessian_.solve(free_gradient_at(u, p));
    const double size = largest(step);
    if (!(size <= largest_step)) return false;
    double fraction = 1;
    u = motion(p).admissible(u, hessian_.reduction().extend_from_free(u, step), p, fraction);
    if (fraction < 1) return false;
    if (0.1 * size <= tolerance) {
      Assembly out;
      model_->evaluate(at(u, p), out);
      return std::isfinite(out.energy);
    }
    largest_step = 0.1 * size;
  }
  return false;
}

/// At a stationary point whose exact Hessian is not positive definite: finds the direction of the lowest eigenvalue by
/// inverse iteration and steps along it, to the side of lower energy. False when there is no negative curvature.
bool Equilibrium::leave_saddle(Eigen::VectorXd& u, const Params& p) {
  const Assembly out = hessian_.assemble(at(u, p), Curvature::exact, nullptr);
  const double scale = hessian_.mean_diagonal();
  double shift = 1e-10 * scale;
  while (!hessian_.factorise(shift)) {
    shift *= 10;
    if (!(shift < 1e3 * scale)) return false;
  }
  Eigen::VectorXd mode(hessian_.reduction().size());
  for (Eigen::Index i = 0; i < mode.size(); ++i) mode[i] = 1.0 + 0.5 * std::sin(1.0 + 0.7 * static_cast<double>(i));
  for (int iteration = 0; iteration < 20; ++iteration) mode = hessian_.solve(mode.normalized());
  mode /= largest(mode);
  if (!(hessian_.times(mode).dot(mode) < 0)) return false;
  const Eigen::VectorXd direction = hessian_.reduction().extend_from_free(u, mode);
  Eigen::VectorXd best;
  const Motion way = motion(p);
  double lowest = infinity;
  for (double amplitude = 1e-2 * model_->length_scale();
       amplitude > 1e-6 * model_->length_scale() && lowest == infinity; amplitude *= 0.5) {
    for (double sign : {1.0, -1.0}) {
      double fraction = amplitude;
      const Eigen::VectorXd candidate = way.admissible(u, sign * direction, p, fraction);
      Assembly energy;
      model_->evaluate(at(candidate, p), energy);
      if (energy.energy < out.energy && energy.energy < lowest) {
        lowest = energy.energy;
        best = candidate;
      }
    }
  }
  if (lowest == infinity) return false;
  u = best;
  return true;
}

/// Minimises from u and makes sure that the result is a minimum whose exact Hessian is factorised.
SolveStatus Equilibrium::settle(Eigen::VectorXd& u, const Params& p) {
  has_factor_ = buckling_ = false;
  for (int attempt = 0; attempt < 4; ++attempt) {
    const NewtonResult result = minimise(u, p);
    if (result.status != SolveStatus::converged) return result.status;
    if (result.exact_factor || !options_.check_minimum) {
      has_factor_ = result.exact_factor;
      return SolveStatus::converged;
    }
    hessian_.assemble(at(u, p), Curvature::exact, nullptr);
    has_factor_ = hessian_.factorise();
    if (has_factor_) return SolveStatus::converged;
    if (!leave_saddle(u, p)) break;
    report_.left_saddle = buckling_ = true;
  }
  return SolveStatus::not_a_minimum;
}

/// Minus the mixed derivative, on the free unknowns: what H du/dp equals. Moving supports pull through H as well.
Eigen::VectorXd Equilibrium::right_hand_side(int index) const {
  Eigen::VectorXd g = model_->parameter_gradient(at(u_, p_), index);
  const Eigen::VectorXd moved = model_->support_derivative(index);
  if (!moved.isZero(0)) g += model_->hessian_times(at(u_, p_), moved);
  return -hessian_.reduction().restrict_to_free(u_, g);
}

Eigen::MatrixXd Equilibrium::sensitivities(const std::vector<int>& indices) const {
  if (!has_factor_) throw std::logic_error("sensitivities need a converged equilibrium");
  const Reduction& reduction = hessian_.reduction();
  Eigen::MatrixXd rhs(reduction.size(), indices.size());
  for (size_t k = 0; k < indices.size(); ++k) rhs.col(k) = right_hand_side(indices[k]);
  const Eigen::MatrixXd free = hessian_.solve(rhs);
  Eigen::MatrixXd all(model_->unknowns(), rhs.cols());
  for (size_t k = 0; k < indices.size(); ++k) {
    all.col(k) = reduction.extend_from_free(u_, free.col(k)) + model_->support_derivative(indices[k]);
  }
  return all;
}

/// First-order change of the equilibrium on the way to `p`, from the kept factor. Towards a new start a stiffness
/// enters by its reciprocal, in which displacements of a linear solid are linear.
Eigen::VectorXd Equilibrium::predicted_step(const Params& p, bool stiffness_by_reciprocal) const {
  Eigen::VectorXd rhs = Eigen::VectorXd::Zero(hessian_.reduction().size());
  Eigen::VectorXd supported = Eigen::VectorXd::Zero(model_->unknowns());
  for (int k = 0; k < p.size(); ++k) {
    if (p[k] == p_[k]) continue;
    const bool stiffness = stiffness_by_reciprocal && model_->parameters()[k].logarithmic && p_[k] > 0 && p[k] > 0;
    rhs += (stiffness ? p_[k] * (1 - p_[k] / p[k]) : p[k] - p_[k]) * right_hand_side(k);
    supported += (p[k] - p_[k]) * model_->support_derivative(k);
  }
  return hessian_.reduction().extend_from_free(u_, hessian_.solve(rhs)) + supported;
}

/// Start of the search at `p`: the predicted state, or where it is no better, the current one with supports imposed.
Eigen::VectorXd Equilibrium::predict(const Params& p) const {
  Eigen::VectorXd plain = u_;
  model_->impose_supports(p, plain);
  if (!has_factor_) return plain;
  double fraction = 1;
  Eigen::VectorXd predicted = motion(p).admissible(u_, predicted_step(p, true), p, fraction);
  model_->impose_supports(p, predicted);
  Assembly a, b;
  model_->evaluate(at(predicted, p), a);
  model_->evaluate(at(plain, p), b);
  // Supports may have been moved through something, which the contact barrier would not notice afterwards.
  if (passes_through(p, plain)) b.energy = infinity;
  if (passes_through(p, predicted)) a.energy = infinity;
  return std::isfinite(a.energy) && !(a.energy > b.energy) ? predicted : plain;
}

/// Whether something is passed through on the straight way from u_.
bool Equilibrium::passes_through(const Params& p, const Eigen::VectorXd& u) const {
  return !options_.comparison.ignore_contact && model_->step_limit(at(u_, p), u - u_) < 1;
}

/// Whether the new state, u_ at p_, belongs to another equilibrium path than u_before at p_before. On one path the
/// first-order predictions forwards (`predicted`, empty without one) or backwards come near; at a kink (a cable that
/// goes taut, a gap that closes) one of them still does.
bool Equilibrium::slipped(const Eigen::VectorXd& u_before, const Params& p_before,
                          const Eigen::VectorXd& predicted) const {
  const double change = largest(u_ - u_before);
  double miss = predicted.size() == 0 ? change : largest(u_ - predicted);
  const double allowed = std::max(0.01 * model_->length_scale(), 0.3 * change);
  if (miss <= allowed) return false;
  if (has_factor_) {
    const Eigen::VectorXd back = motion(p_).along(u_, predicted_step(p_before, false), 1.0);
    miss = std::min(miss, largest(back - u_before));
  }
  return miss > allowed;
}

Eigen::MatrixXd Equilibrium::solve_linear(const Eigen::MatrixXd& b) const {
  if (!has_factor_) throw std::logic_error("a linear solve needs a converged equilibrium");
  const Reduction& reduction = hessian_.reduction();
  Eigen::MatrixXd free(reduction.size(), b.cols()), all(model_->unknowns(), b.cols());
  for (Eigen::Index k = 0; k < b.cols(); ++k) free.col(k) = reduction.restrict_to_free(u_, b.col(k));
  free = hessian_.solve(free);
  for (Eigen::Index k = 0; k < b.cols(); ++k) all.col(k) = reduction.extend_from_free(u_, free.col(k));
  return all;
}

const SolveReport& Equilibrium::solve_step(const Eigen::VectorXd& start, const Params& p, const TimeStep& step) {
  report_ = {};
  polish_ = Polish::full;
  const int factorisations = hessian_.factorisations();
  step_ = &step;
  Eigen::VectorXd u = start;
  model_->impose_supports(p, u);
  report_.status = settle(u, p);
  if (report_.status == SolveStatus::converged) {
    u_ = u;
    p_ = p;
    report_.reached = 1;
    report_.load_steps = 1;
  } else {
    has_factor_ = false;
  }
  report_.factorisations = hessian_.factorisations() - factorisations;
  return report_;
}

bool Equilibrium::refactorise() {
  if (has_factor_) return true;
  const Assembly out = hessian_.assemble(at(u_, p_), Curvature::exact, nullptr);
  return has_factor_ = std::isfinite(out.energy) && hessian_.factorise();
}

/// Load steps from the current state to `p`, with slips looked for where `check_path`.
void Equilibrium::advance(const Params& p, bool check_path) {
  const Params start = p_;
  const int most = report_.iterations + options_.max_total_iterations;
  const double smallest_step = std::ldexp(1.0, -options_.max_halvings);
  constexpr double smallest_followed = 1.0 / 64;  // a slip within a shorter load step counts as one
  const double longest_step = 1.0 / options_.load_steps;
  double step = longest_step;
  while (report_.reached < 1) {
    const double target = std::min(1.0, report_.reached + step);
    step = target - report_.reached;
    const Params next = target == 1.0 ? p : Params(start + target * (p - start));
    // Supports that move far in one go invert the elements beside them, unless the whole body is predicted to follow; a
    // checked path needs its prediction too.
    if (model_->support_moves(p_, next) || (check_path && next != p_)) refactorise();
    Eigen::VectorXd u = predict(next);
    const bool checked = check_path && next != p_;
    const Eigen::VectorXd predicted = checked && has_factor_ ? u : Eigen::VectorXd();
    report_.status = passes_through(next, u) ? SolveStatus::infeasible_start : settle(u, next);
    if (report_.status == SolveStatus::converged) {
      const Eigen::VectorXd u_before = std::exchange(u_, u);
      const Params p_before = std::exchange(p_, next);
      if (checked && slipped(u_before, p_before, predicted)) {
        if (0.5 * step >= smallest_followed) {
          u_ = u_before;
          p_ = p_before;
          has_factor_ = false;
          step *= 0.5;
          refactorise();
          continue;
        }
        if (!report_.slipped) report_.slipped_after = report_.reached;
        report_.slipped = true;
      }
      report_.reached = target;
      ++report_.load_steps;
      step = std::min(2 * step, longest_step);
      continue;
    }
    has_factor_ = false;                                                  // it belongs to a state that was given up
    if (report_.status == SolveStatus::interrupted || next == p_) break;  // nothing to take shorter steps of
    if (report_.status == SolveStatus::infeasible_start) {
      Assembly out;
      model_->evaluate(at(u_, p_), out);
      if (!std::isfinite(out.energy)) break;  // shorter steps start from the same state
    }
    step *= 0.5;
    if (step < smallest_step || report_.iterations >= most) {
      if (report_.status != SolveStatus::not_a_minimum) report_.status = SolveStatus::load_step_limit;
      break;
    }
    refactorise();  // for the predictor of the shorter step
  }
}

const SolveReport& Equilibrium::solve(const Params& p, Polish polish) {
  report_ = {};
  polish_ = polish;
  if (std::exchange(step_, nullptr) != nullptr) has_factor_ = false;
  const int factorisations = hessian_.factorisations();
  const Eigen::VectorXd u_start = u_;
  const Params p_start = p_;
  advance(p, options_.check_path);
  // Just beyond the end of a path (a limit load) Newton's method only creeps; from farther away the load drives the
  // body to where the slip ends.
  if (options_.check_path && report_.status == SolveStatus::load_step_limit) {
    const double end = report_.slipped ? report_.slipped_after : report_.reached;
    start_at(u_start, p_start);
    report_.reached = 0;
    report_.load_steps = 0;
    advance(p, false);
    report_.slipped = true;
    report_.slipped_after = end;
  }
  report_.factorisations = hessian_.factorisations() - factorisations;
  return report_;
}

}  // namespace taut
