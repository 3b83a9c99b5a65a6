#include "sim/solve/equilibrium.hpp"

#include <fmt/format.h>

#include <array>
#include <limits>
#include <stdexcept>
#include <utility>

#include "sim/core/dense.hpp"
#include "sim/core/numbers.hpp"

namespace taut {
namespace {

constexpr double epsilon = std::numeric_limits<double>::epsilon();
constexpr double inexact = 0.03;     ///< residual of a Newton step that is found by iteration, of its gradient
constexpr double negligible = 1e-3;  ///< change of a Hessian for the sensitivities that a search goes by

double largest(const Eigen::VectorXd& v) {
  return v.size() == 0 ? 0.0 : v.cwiseAbs().maxCoeff();
}

/// Whether two modes in space move each node as far, in other directions: a square column bends one way, and across it.
bool move_alike(const Eigen::VectorXd& one, const Eigen::VectorXd& other) {
  const auto sizes = [](const Eigen::VectorXd& all) {
    return Eigen::VectorXd(all.reshaped(3, all.size() / 3).colwise().norm().transpose()).normalized().eval();
  };
  return sizes(one).dot(sizes(other)) > 0.99;
}

}  // namespace

std::string_view name_of(SolveStatus status) {
  constexpr std::string_view names[] = {"converged",     "infeasible start", "iteration limit", "stalled",
                                        "not a minimum", "not held",         "load step limit", "interrupted"};
  return names[static_cast<size_t>(status)];
}

std::string SolveReport::message() const {
  std::string text = fmt::format("{}: {} Newton iterations, {} factorisations, {} load step{}", name_of(status),
                                 iterations, factorisations, load_steps, load_steps == 1 ? "" : "s");
  if (left_saddle) text += ", left an unstable equilibrium";
  if (!side.empty()) text += fmt::format(" of two alike sides towards {}", side);
  if (slipped) text += fmt::format(", slipped to another equilibrium after {:.3g} % of the load", 100 * slipped_after);
  if (status != SolveStatus::converged) {
    text += fmt::format(", reached {:.3g} % of the load, out-of-balance force {:.3g} N", 100 * reached, gradient);
  }
  if (status == SolveStatus::load_step_limit)
    text += "; the path may end there, as at a limit load: lower the load, or allow more iterations";
  if (status == SolveStatus::not_held) text += "; " + held_by_nothing();
  return text;
}

std::string SolveReport::held_by_nothing() const {
  return fmt::format(
      "{} has rigid motions free, since neither supports nor cables nor contact hold it there: add a "
      "support, or cables or contact that hold it in every direction",
      loose);
}

Equilibrium::Equilibrium(const Model& model, EquilibriumOptions options)
    : model_(&model), options_(options), hessian_(model) {}

void Equilibrium::start_at_rest(const Params& p) {
  start_at(Eigen::VectorXd::Zero(model_->unknowns()), p);
  hessian_.forget_couplings();
  drop_factor();
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

/// Factorises the Hessian that was assembled at u: exact, else projected, else projected and shifted.
bool Equilibrium::factorise(bool& exact, const Eigen::VectorXd& u, const Params& p) {
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
  if (!options_.comparison.always_project) hessian_.assemble(at(u, p), Curvature::projected, nullptr);
  for (double shift = 0, scale = hessian_.mean_diagonal(); shift < 1e3 * scale;
       shift = std::max(10 * shift, 1e-8 * scale)) {
    if (hessian_.factorise(shift)) return true;
    if (scale == 0 || !std::isfinite(scale)) break;
  }
  return false;
}

/// Longest step to begin with [m]. A loose body that nothing holds yet would be thrown out of sight: it falls, faster
/// and faster, until it is caught.
double Equilibrium::first_step() const {
  return model_->loose_bodies().empty() || moves() ? infinity : 0.02 * model_->length_scale();
}

Eigen::VectorXd Equilibrium::free_gradient_at(const Eigen::VectorXd& u, const Params& p) const {
  Eigen::VectorXd gradient;
  Assembly out;
  out.gradient = &gradient;
  model_->evaluate(at(u, p), out);
  return hessian_.reduction().restrict_to_free(u, gradient);
}

/// Of the largest component of a step [m].
double Equilibrium::tolerance() const {
  return (polish_ == Polish::rough ? options_.rough_tolerance : options_.step_tolerance) * model_->length_scale();
}

/// Newton's step from u. False when there is none.
bool Equilibrium::find_direction(const Eigen::VectorXd& u, const Params& p, Direction& to) {
  const bool project = options_.comparison.always_project;
  Eigen::VectorXd gradient;
  hessian_.assemble(at(u, p), project ? Curvature::projected : Curvature::exact, &gradient);
  to.gradient = hessian_.reduction().restrict_to_free(u, gradient);
  report_.gradient = largest(to.gradient);
  loudest_ = std::max(loudest_, report_.gradient);
  std::optional<Eigen::VectorXd> iterated;
  if (!project && hessian_.price() >= options_.dear) iterated = hessian_.iterate(to.gradient, inexact);
  to.exact_factor = false;
  if (iterated) {
    to.step = -*iterated;
  } else {
    if (!factorise(to.exact_factor, u, p)) return false;
    to.step = -hessian_.solve(to.gradient);
    if (!to.exact_factor) {
      ++indefinite_;
      calmest_ = std::min(calmest_, report_.gradient);
    }
  }
  ++report_.iterations;
  to.slope = to.gradient.dot(to.step);
  return to.step.allFinite();
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

  const double tolerance = this->tolerance();
  const LineSearch search = options_.comparison.line_search;
  bool on_trust = false;  // the last step raised the energy and is still to be made up for
  const int limit = (buckling_ ? 4 : 1) * options_.max_iterations;  // the way into a post-buckled shape is long
  double longest = first_step();
  for (int iteration = 0; iteration < limit; ++iteration, longest *= 1.5) {
    if (stopped()) return {SolveStatus::interrupted, false};
    Direction way;
    if (!find_direction(u, p, way)) return {SolveStatus::stalled, false};
    if (report_.gradient < options_.comparison.stop_at_force) return {SolveStatus::converged, way.exact_factor};
    const double noise = 10 * epsilon * energy.magnitude;
    const Eigen::VectorXd step = hessian_.reduction().extend_from_free(u, way.step);
    const double size = largest(way.step);
    double fraction = std::min(1.0, longest / size);
    Eigen::VectorXd trial = motions.admissible(u, step, p, fraction);
    if (fraction == 0 && search != LineSearch::none) return {SolveStatus::stalled, false};
    model_->evaluate(at(trial, p), next);
    // The Newton step is the error estimate. A last full step costs no factorisation and leaves an error of its square.
    if (search == LineSearch::none && !std::isfinite(next.energy)) return {SolveStatus::stalled, false};
    if (size <= tolerance) {
      if (search == LineSearch::none || next.energy <= energy.energy + noise) u = trial;
      return {SolveStatus::converged, way.exact_factor};
    }
    if (search == LineSearch::none) {
      u = trial;
      energy = next;
      continue;
    }
    if (polish_ != Polish::full && way.exact_factor && fraction == 1 && next.energy <= energy.energy) {
      Eigen::VectorXd refined = trial;
      if (const auto changed = refine(refined, p, size)) {
        if (polish_ == Polish::search) hessian_changed_ = *changed;
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

/// Steps with the last factor again, as long as each is at most a tenth of the one before it, which was `before`. When
/// u has come to the tolerance: by which part the Hessian has changed since, which the first step shows.
std::optional<double> Equilibrium::refine(Eigen::VectorXd& u, const Params& p, double before) {
  const double tolerance = this->tolerance();
  double changed = 0;
  for (int iteration = 0; iteration < 8; ++iteration) {
    const Eigen::VectorXd step = -hessian_.solve(free_gradient_at(u, p));
    const double size = largest(step);
    if (!(size <= 0.1 * before)) return std::nullopt;
    double fraction = 1;
    u = motion(p).admissible(u, hessian_.reduction().extend_from_free(u, step), p, fraction);
    if (fraction < 1) return std::nullopt;
    if (iteration == 0) changed = size / before;
    if (0.1 * size <= tolerance) {
      Assembly out;
      model_->evaluate(at(u, p), out);
      return std::isfinite(out.energy) ? std::optional(changed) : std::nullopt;
    }
    before = size;
  }
  return std::nullopt;
}

/// Factorises the exact Hessian at u plus the smallest multiple of I of a few that makes it positive definite.
bool Equilibrium::factorise_shifted(const Eigen::VectorXd& u, const Params& p, Assembly& out) {
  out = hessian_.assemble(at(u, p), Curvature::exact, nullptr);
  const double scale = hessian_.mean_diagonal();
  for (double shift = 1e-10 * scale; shift < 1e3 * scale; shift *= 10) {
    if (hessian_.factorise(shift)) return true;
  }
  return false;
}

/// The mode of the lowest eigenvalue by inverse iteration with the (shifted) factor at hand, orthogonal to `besides`.
Eigen::VectorXd Equilibrium::lowest_mode(const Eigen::VectorXd& besides) const {
  Eigen::VectorXd mode(hessian_.reduction().size());
  for (Eigen::Index i = 0; i < mode.size(); ++i) mode[i] = 1.0 + 0.5 * std::sin(1.0 + 0.7 * static_cast<double>(i));
  for (int iteration = 0; iteration < 20; ++iteration) {
    mode = hessian_.solve(mode.normalized());
    if (besides.size() > 0) mode -= besides.dot(mode) / besides.squaredNorm() * besides;
  }
  return mode / largest(mode);
}

/// A displacement of all nodes that no symmetry of a body leaves as it is; each about 1 long.
Eigen::VectorXd Equilibrium::push() const {
  constexpr double component[3] = {0.48, 0.8, 0.36}, along[3] = {0.37, 0.23, 0.31};
  const Mesh& mesh = model_->mesh();
  const int d = mesh.dimension();
  Eigen::VectorXd all(mesh.X.size());
  for (int node = 0; node < mesh.node_count(); ++node) {
    double size = 1;
    for (int i = 0; i < d; ++i) size += along[i] * (mesh.node(node)[i] - mesh.X[i]) / model_->length_scale();
    for (int i = 0; i < d; ++i) all[node * d + i] = size * component[i];
  }
  return all;
}

/// "+y": along which axis a mode goes most, and which way on the whole.
std::string Equilibrium::heading(const Eigen::VectorXd& direction) const {
  const int d = model_->mesh().dimension();
  int most = 0;
  double largest_square = -1, sum = 0;
  for (int i = 0; i < d; ++i) {
    const auto component = direction(Eigen::seq(i, Eigen::last, d));
    if (component.squaredNorm() <= largest_square) continue;
    largest_square = component.squaredNorm();
    most = i;
    sum = component.sum();
  }
  return fmt::format("{}{}", sum < 0 ? '-' : '+', "xyz"[most]);
}

/// At a stationary point whose exact Hessian is not positive definite: finds the direction of the lowest eigenvalue and
/// steps along it, to the side of lower energy; of two that are alike to the one that push() has a share in, and of two
/// modes that are, in space, to the one between them that is nearest to it: they are one branch, whose sides are a
/// circle. False when there is no negative curvature.
bool Equilibrium::leave_saddle(Eigen::VectorXd& u, const Params& p) {
  Assembly out;
  if (!factorise_shifted(u, p, out)) return false;
  const Eigen::VectorXd mode = lowest_mode({});
  if (!(hessian_.times(mode).dot(mode) < 0)) return false;
  const Eigen::VectorXd second = lowest_mode(mode);
  const auto curvature = [&](const Eigen::VectorXd& v) { return hessian_.times(v).dot(v) / v.squaredNorm(); };
  bool several = curvature(second) < 0;
  Eigen::VectorXd direction = hessian_.reduction().extend_from_free(u, mode);
  const Eigen::VectorXd other = hessian_.reduction().extend_from_free(u, second);
  if (model_->mesh().dimension() == 3 && curvature(second) < 0.9 * curvature(mode) && move_alike(direction, other)) {
    several = false;
    direction =
        push().dot(direction) / direction.squaredNorm() * direction + push().dot(other) / other.squaredNorm() * other;
    direction /= largest(direction);
  }
  if (push().dot(direction) < 0) direction = -direction;
  const Motion way = motion(p);
  const double noise = 10 * epsilon * out.magnitude;
  for (double amplitude = 1e-2 * model_->length_scale(); amplitude > 1e-6 * model_->length_scale(); amplitude *= 0.5) {
    std::array<Eigen::VectorXd, 2> sides;
    std::array<double, 2> falls;  // of the energy
    for (size_t k : {0u, 1u}) {
      double fraction = amplitude;
      sides[k] = way.admissible(u, (k == 0 ? 1.0 : -1.0) * direction, p, fraction);
      Assembly energy;
      model_->evaluate(at(sides[k], p), energy);
      falls[k] = out.energy - energy.energy;
    }
    if (!(falls[0] > 0 || falls[1] > 0)) continue;
    const bool alike = std::abs(falls[0] - falls[1]) <= 1e-2 * std::max(falls[0], falls[1]) + noise;
    const bool first = alike || falls[0] >= falls[1];
    report_.side = alike ? heading(direction) : "";
    saddle_ = {u, first ? direction : Eigen::VectorXd(-direction), several};
    u = sides[first ? 0 : 1];
    return true;
  }
  return false;
}

/// Whether the way from the saddle that was left last may have led to another branch: several were there to take, or
/// the end is not on the side that was chosen.
bool Equilibrium::lost_its_way(const Eigen::VectorXd& u) const {
  return saddle_.several || (u - saddle_.u).dot(saddle_.direction) < 0;
}

/// Whether rounding alone decided that a search from `start` ended at u, as where a symmetric state is unstable: after
/// a small push one way or the other it ends elsewhere. Asked where many Hessians were indefinite, in one of these
/// states forces were nearly in balance, and the way was long; of another object, so that what this one keeps does not
/// depend on the question.
bool Equilibrium::drifted(const Eigen::VectorXd& u, const Eigen::VectorXd& start, const Params& p) {
  constexpr int fewest = 5;  // Newton steps take to make something of rounding
  const double size = model_->length_scale();
  if (indefinite_ < fewest || !options_.check_minimum || largest(u - start) < 0.05 * size) return false;
  if (calmest_ > 1e-3 * loudest_) return false;  // forces drove it on all the way
  Equilibrium probe(*model_, options_);
  probe.hessian_.expect(hessian_.couplings());
  bool elsewhere = false;
  for (double way : {1.0, -1.0}) {
    double fraction = 1e-7 * size;
    Eigen::VectorXd other = motion(p).admissible(start, way * push(), p, fraction);
    model_->impose_supports(p, other);
    elsewhere |= probe.settle(other, p) == SolveStatus::converged && largest(other - u) > 1e-6 * size;
  }
  probed_ += probe.hessian_.factorisations();
  return elsewhere;
}

/// Whether all loose bodies are held at u: R^T H R has no eigenvalue that is zero beside rounding, where R are their
/// rigid motions (of unit length). What is not held in some way has such a motion without stiffness.
bool Equilibrium::is_held(const Eigen::VectorXd& u, const Params& p) {
  const std::vector<LooseBody>& loose = model_->loose_bodies();
  if (loose.empty() || moves()) return true;
  const int d = model_->mesh().dimension(), turns = d == 2 ? 1 : 3, each = d + turns;
  const Eigen::VectorXd x = model_->mesh().X + u;
  Eigen::MatrixXd R = Eigen::MatrixXd::Zero(u.size(), each * static_cast<Eigen::Index>(loose.size()));
  for (size_t k = 0; k < loose.size(); ++k) {
    auto columns = R.middleCols(static_cast<Eigen::Index>(k) * each, each);
    Eigen::VectorXd centre = Eigen::VectorXd::Zero(d);
    for (int node : loose[k].nodes) centre += x.segment(node * d, d) / static_cast<double>(loose[k].nodes.size());
    for (int node : loose[k].nodes) {
      const Eigen::VectorXd arm = x.segment(node * d, d) - centre;
      for (int i = 0; i < d; ++i) columns(node * d + i, i) = 1;
      for (int turn = 0; turn < turns; ++turn) {
        const int about = d == 2 ? 2 : turn, first = (about + 1) % 3, second = (about + 2) % 3;
        columns(node * d + first, d + turn) = -arm[second];
        columns(node * d + second, d + turn) = arm[first];
      }
    }
  }
  for (Eigen::Index j = 0; j < R.cols(); ++j)
    R.col(j) = model_->extend_from_free(model_->restrict_to_free(R.col(j))).normalized();
  const SingularValues basis = singular_values(R);  // partial supports may take some of these motions away
  const Eigen::MatrixXd Q = basis.U.leftCols((basis.s.array() > 1e-9).count());
  if (Q.cols() == 0) return true;
  Eigen::MatrixXd HQ(Q.rows(), Q.cols());
  for (Eigen::Index j = 0; j < Q.cols(); ++j) HQ.col(j) = model_->hessian_times(at(u, p), Q.col(j));
  const SymmetricModes modes = symmetric_modes(Q.transpose() * HQ);
  if (modes.values[0] > 1e-13 * hessian_.mean_diagonal()) return true;
  const Eigen::VectorXd motion = Q * modes.vectors.col(0);
  const auto moves = [&](const LooseBody& body) {
    double square = 0;
    for (int node : body.nodes) square += motion.segment(node * d, d).squaredNorm();
    return square;
  };
  report_.loose = std::ranges::max_element(loose, {}, moves)->name;
  return false;
}

/// From the state that was predicted with the factor of the last one, on with that factor: the prediction counts as the
/// first step. False, and u as it was, when the factor does not serve.
bool Equilibrium::follow(Eigen::VectorXd& u, const Params& p) {
  if (polish_ != Polish::rough || !has_factor_ || p == p_) return false;
  Eigen::VectorXd followed = u;
  if (!refine(followed, p, largest(u - u_))) return false;
  u = followed;
  return true;
}

/// Minimises from u and makes sure that the result is a minimum whose exact Hessian is factorised.
SolveStatus Equilibrium::settle(Eigen::VectorXd& u, const Params& p) {
  indefinite_ = 0;
  hessian_changed_ = 0;
  if (follow(u, p)) return SolveStatus::converged;
  has_factor_ = false;
  buckling_ = patient_;
  loudest_ = 0;
  calmest_ = infinity;
  for (int attempt = 0; attempt < 4; ++attempt) {
    const NewtonResult result = minimise(u, p);
    if (result.status != SolveStatus::converged) return result.status;
    if (result.exact_factor || !options_.check_minimum) {
      has_factor_ = result.exact_factor;
      return SolveStatus::converged;
    }
    hessian_.assemble(at(u, p), Curvature::exact, nullptr);
    has_factor_ = hessian_.factorise();
    if (has_factor_) {
      // Steps by iteration leave a part of themselves; one with this factor leaves its square.
      Eigen::VectorXd polished = u;
      if (refine(polished, p, 10 * tolerance())) u = polished;
      return SolveStatus::converged;
    }
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
  Eigen::MatrixXd free = hessian_.solve(rhs);
  if (hessian_changed_ > negligible) {
    for (Eigen::Index k = 0; k < rhs.cols(); ++k) rhs.col(k) -= hessian_.times(free.col(k));
    free += hessian_.solve(rhs);
  }
  Eigen::MatrixXd all(model_->unknowns(), rhs.cols());
  for (size_t k = 0; k < indices.size(); ++k) {
    all.col(k) = reduction.extend_from_free(u_, free.col(k)) + model_->support_derivative(indices[k]);
  }
  return all;
}

Eigen::MatrixXd Equilibrium::response(const Eigen::MatrixXd& dp, Eigen::MatrixXd force) const {
  const Point here = at(u_, p_);
  Eigen::MatrixXd moved = Eigen::MatrixXd::Zero(force.rows(), force.cols());
  for (int k = 0; k < dp.rows(); ++k) {
    if (dp.row(k).isZero(0)) continue;
    force += model_->parameter_gradient(here, k) * dp.row(k);
    moved += model_->support_derivative(k) * dp.row(k);
  }
  for (Eigen::Index j = 0; j < force.cols(); ++j) {
    if (!moved.col(j).isZero(0)) force.col(j) += model_->hessian_times(here, moved.col(j));
  }
  return moved - solve_linear(force);
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
  if (!has_factor_ || p == p_) return plain;
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
  patient_ = false;
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

/// settle() on the way to `p`. True when where it came to is not to be relied on, and shorter load steps have to tell:
/// what left a saddle took one of several ways, or a path that had left one already met another.
bool Equilibrium::search(Eigen::VectorXd& u, const Params& p) {
  const bool on_branch = std::exchange(report_.left_saddle, false);  // of a saddle that was left before
  const Eigen::VectorXd start = u;
  report_.status = passes_through(p, u) ? SolveStatus::infeasible_start : settle(u, p);
  bool lost = false;
  if (report_.status == SolveStatus::converged && p != p_)
    lost = report_.left_saddle ? on_branch || lost_its_way(u) : !on_branch && drifted(u, start, p);
  report_.left_saddle |= on_branch;
  return lost;
}

/// Takes u at `p` as the last equilibrium; where the path is `checked` and slipped on the way, and `can_be_shorter`,
/// not, and returns false.
bool Equilibrium::accept(const Eigen::VectorXd& u, const Params& p, const Eigen::VectorXd& predicted, bool checked,
                         bool can_be_shorter) {
  const Eigen::VectorXd u_before = std::exchange(u_, u);
  const Params p_before = std::exchange(p_, p);
  if (!checked || !slipped(u_before, p_before, predicted)) return true;
  if (can_be_shorter) {
    u_ = u_before;
    p_ = p_before;
    return false;
  }
  if (!report_.slipped && options_.check_path) report_.slipped_after = report_.reached;
  report_.slipped |= options_.check_path;  // what is followed for a saddle's sake only is no path of a bench
  return true;
}

/// Load steps from the current state to `p`, with slips looked for where `check_path`.
void Equilibrium::advance(const Params& p, bool check_path) {
  const Params start = p_;
  const int first = report_.iterations;
  int most = first + options_.max_total_iterations;
  const double smallest_step = std::ldexp(1.0, -options_.max_halvings);
  constexpr double smallest_followed = 1.0 / 64;   // a slip within a shorter load step counts as one
  constexpr double smallest_bracket = 1.0 / 1024;  // around an unstable equilibrium whose modes are to be told apart
  const double longest_step = 1.0 / options_.load_steps;
  double step = longest_step;
  while (report_.reached < 1) {
    const double target = std::min(1.0, report_.reached + step);
    step = target - report_.reached;
    const Params next = target == 1.0 ? p : Params(start + target * (p - start));
    // Supports that move far in one go invert the elements beside them, unless the whole body is predicted to follow; a
    // checked path needs its prediction too.
    const bool checked = (check_path || report_.left_saddle) && next != p_;
    if (model_->support_moves(p_, next) || checked) refactorise();
    Eigen::VectorXd u = predict(next);
    const Eigen::VectorXd predicted = checked && has_factor_ ? u : Eigen::VectorXd();
    const bool on_branch = report_.left_saddle;
    const std::string side = report_.side;
    const bool lost = search(u, next);
    if (lost || report_.left_saddle) most = first + 10 * options_.max_total_iterations;  // branches are long
    const bool shorter = lost && 0.5 * step >= smallest_bracket && report_.iterations < most;
    const bool converged = report_.status == SolveStatus::converged;
    if (converged && !shorter && accept(u, next, predicted, checked, 0.5 * step >= smallest_followed)) {
      report_.reached = target;
      ++report_.load_steps;
      step = std::min(2 * step, longest_step);
      continue;
    }
    const bool left_saddle = std::exchange(report_.left_saddle, on_branch);
    report_.side = side;
    has_factor_ = false;  // it belongs to a state that was given up
    step *= 0.5;
    if (!converged && !goes_on_shorter(next, step >= smallest_step && report_.iterations < most) &&
        (options_.check_path || !goes_on_patiently(step, most))) {
      report_.left_saddle = left_saddle;
      break;
    }
    refactorise();  // for the predictor of the shorter step
  }
}

const SolveReport& Equilibrium::solve(const Params& p, Polish polish, const TimeStep* step) {
  report_ = {};
  polish_ = polish;
  patient_ = false;
  probed_ = 0;
  if (std::exchange(step_, step) != nullptr || step != nullptr) has_factor_ = false;
  const int factorisations = hessian_.factorisations();
  const Eigen::VectorXd u_start = u_;
  const Params p_start = p_;
  advance(p, options_.check_path);
  // Just beyond the end of a path (a limit load) Newton's method only creeps; from farther away the load drives the
  // body to where the slip ends.
  if (options_.check_path && report_.status == SolveStatus::load_step_limit) {
    const double end = report_.slipped ? report_.slipped_after : report_.reached;
    start_at(u_start, p_start);
    step_ = step;
    report_.reached = 0;
    report_.load_steps = 0;
    report_.left_saddle = false;
    report_.side.clear();
    advance(p, false);
    report_.slipped = true;
    report_.slipped_after = end;
  }
  const bool undecided = report_.status != SolveStatus::interrupted && report_.status != SolveStatus::infeasible_start;
  if (undecided && !is_held(u_, p_)) {
    report_.status = SolveStatus::not_held;
    has_factor_ = false;
  }
  if (has_factor_ && hessian_changed_ > negligible)  // what sensitivities() corrects by
    hessian_.assemble(at(u_, p_), Curvature::exact, nullptr);
  report_.factorisations = hessian_.factorisations() - factorisations + probed_;
  return report_;
}

/// Whether a shorter load step is worth trying after one to `next` has failed; sets the status where it is not because
/// none is `allowed`.
bool Equilibrium::goes_on_shorter(const Params& next, bool allowed) {
  if (report_.status == SolveStatus::interrupted || next == p_) return false;  // nothing to take shorter steps of
  if (report_.status == SolveStatus::infeasible_start) {
    Assembly out;
    model_->evaluate(at(u_, p_), out);
    if (!std::isfinite(out.energy)) return false;  // shorter steps start from the same state
  }
  if (!allowed && report_.status != SolveStatus::not_a_minimum) report_.status = SolveStatus::load_step_limit;
  return allowed;
}

/// A body that is not quite symmetric softens so much near its critical load that even short steps fail: once a solve
/// would give up there, the rest of it goes as after a saddle. Not where the path is checked: what lies beyond its end
/// is a matter of rounding.
bool Equilibrium::goes_on_patiently(double& step, int& most_iterations) {
  constexpr double patient_step = 1.0 / 64;
  if (std::ldexp(1.0, -options_.max_halvings) > patient_step) return false;  // asked not to
  if (report_.status != SolveStatus::load_step_limit || patient_ || indefinite_ == 0) return false;
  patient_ = true;
  step = patient_step;
  most_iterations = report_.iterations + options_.max_total_iterations;
  return true;
}

}  // namespace taut
