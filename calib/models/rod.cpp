#include "calib/models/rod.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <numbers>

#include "calib/models/block_factors.hpp"
#include "calib/models/rod_element.hpp"
#include "calib/models/rod_section.hpp"
#include "sim/core/error.hpp"

namespace taut {

using namespace rod;

namespace {

/// Second derivatives of tau . exp(turn) arm by the turn.
Matrix3d arm_curvature(const Vector3d& arm, const Vector3d& tau) {
  return 0.5 * (outer(arm, tau) + outer(tau, arm)) - arm.dot(tau) * Matrix3d::Identity();
}

}  // namespace

struct Rod::Sums {
  double energy = 0;
  Eigen::VectorXd gradient;
  Blocks hessian;
  Eigen::MatrixXd by_values;
  std::vector<Vector3d> v;        ///< of each element
  std::vector<Matrix312> slopes;  ///< of v
};

Rod::Rod(RodShape shape) : shape_(std::move(shape)) {
  if (!(shape_.length > 0)) throw InputError("a rod has a positive length");
  if (shape_.nodes.empty()) {
    for (int i = 0; i <= 72; ++i) shape_.nodes.push_back(shape_.length * i / 72);
  }
  const std::vector<double>& nodes = shape_.nodes;
  if (nodes.size() < 2 || nodes.front() != 0 || nodes.back() != shape_.length ||
      std::adjacent_find(nodes.begin(), nodes.end(), std::greater_equal()) != nodes.end())
    throw InputError("the nodes of a rod ascend from its clamp to its end");
  for (size_t i = 0; i + 1 < nodes.size(); ++i) {
    Section section{shape_.section(0.5 * (nodes[i] + nodes[i + 1])), nodes[i + 1] - nodes[i]};
    const auto& [A, first, second, torsion] = section.of;
    if (!(A > 0 && first > 0 && second > 0 && torsion > 0)) throw InputError("a rod's sections have an area");
    const double sum = 4 * first / A, difference = A / std::numbers::pi;  // of the squares of outer and inner radius
    section.outer = std::sqrt(0.5 * (sum + difference));
    section.inner = sum - difference < 1e-9 * sum ? 0.0 : std::sqrt(0.5 * (sum - difference));
    const double square = std::pow(section.inner / section.outer, 2), whole = (1 + square) * (1 + square);
    section.shear = shape_.shear_factor * A * (shape_.round ? whole / (whole + 2.6 * square) : 1.0);
    section.half_first = std::sqrt(3 * second / A);
    section.half_second = std::sqrt(3 * first / A);
    sections_.push_back(section);
  }
  if (!shape_.down.isZero()) add_weight();
  for (size_t t = 0; t < shape_.tendons.size(); ++t) {
    const RodTendon& tendon = shape_.tendons[t];
    for (size_t i = 0; i < sections_.size(); ++i) {
      const double from = i == 0 ? tendon.start : std::max(nodes[i], tendon.start),
                   to = i + 1 == sections_.size() ? tendon.end : std::min(nodes[i + 1], tendon.end);
      if (to - from < 1e-9 * sections_[i].length) continue;
      const Eigen::Vector2d middle = tendon.eyelet(0.5 * (from + to)),
                            slope = (tendon.eyelet(to) - tendon.eyelet(from)) / (to - from);
      sections_[i].pieces.push_back({{middle[0], middle[1], 0},
                                     {slope[0], slope[1], 0},
                                     (to - from) / sections_[i].length,
                                     first_tension + static_cast<Eigen::Index>(t),
                                     pieces_++});
    }
  }
  for (size_t f = 0; f < shape_.forces.size(); ++f) {
    const RodForce& force = shape_.forces[f];
    for (const Share& share : shares_of(force.at, force.direction, first_force() + static_cast<Eigen::Index>(f)))
      shares_.push_back(share);
  }
}

/// By Gauss's rule along each element, what acts on a node in one.
void Rod::add_weight() {
  constexpr double place[3] = {0.1127016653792583, 0.5, 0.8872983346207417}, part[3] = {5.0 / 18, 4.0 / 9, 5.0 / 18};
  std::vector<Share> of_nodes;
  for (int i = 0; i <= elements(); ++i) of_nodes.push_back({i, Vector3d::Zero(), Vector3d::Zero(), weight});
  for (size_t i = 0; i < 3 * sections_.size(); ++i) {
    const double length = sections_[i / 3].length, s = shape_.nodes[i / 3] + place[i % 3] * length;
    const double volume = part[i % 3] * length * shape_.section(s).area;
    for (const Share& share : shares_of({s, Vector3d::Zero()}, volume * shape_.down, weight)) {
      Share& node = of_nodes[static_cast<size_t>(share.node)];
      const double before = node.force.norm(), more = share.force.norm();
      node.arm = (before * node.arm + more * share.arm) / (before + more);
      node.force += share.force;
    }
  }
  shares_.insert(shares_.end(), of_nodes.begin() + 1, of_nodes.end());
}

Rod::Place Rod::place_of(double s) const {
  const auto next = std::upper_bound(shape_.nodes.begin() + 1, shape_.nodes.end() - 1, s);
  const int element = static_cast<int>(next - shape_.nodes.begin()) - 1;
  const double length = sections_[static_cast<size_t>(element)].length;
  return {element, std::clamp((s - *(next - 1)) / length, 0.0, 1.0), length};
}

/// A point between two nodes is a mean of where both would carry it, each half way: its axis is a parabola between
/// them.
std::vector<Rod::Share> Rod::shares_of(const RodPoint& at, const Vector3d& force, Eigen::Index value) const {
  const auto [element, f, length] = place_of(at.s);
  const auto [before, after] = arms_of(at);
  std::vector<Share> shares;
  if (f < 1 && element > 0) shares.push_back({element, before, (1 - f) * force, value});  // the clamp carries its own
  if (f > 0) shares.push_back({element + 1, after, f * force, value});
  return shares;
}

std::array<Vector3d, 2> Rod::arms_of(const RodPoint& at) const {
  const auto [element, f, length] = place_of(at.s);
  const double beyond = at.s - std::clamp(at.s, 0.0, shape_.length);
  return {at.offset + Vector3d(0, 0, beyond + 0.5 * length * f),
          at.offset + Vector3d(0, 0, beyond - 0.5 * length * (1 - f))};
}

RodState Rod::rest() const {
  RodState x;
  for (const double s : shape_.nodes) {
    x.r.emplace_back(0, 0, s);
    x.q.emplace_back(1, 0, 0, 0);
  }
  return x;
}

Rod::Sums Rod::assemble(const RodState& x, const Values& values, Order order, bool by_values) const {
  const size_t n = sections_.size();
  Sums sum;
  if (order >= slopes) sum.gradient = Eigen::VectorXd::Zero(unknowns() + 6);  // the clamped node's come first
  if (order == curvatures) {
    sum.hessian.on.assign(n + 1, Matrix6::Zero());
    sum.hessian.beside.assign(n, Matrix6::Zero());
    sum.v.resize(n);
    sum.slopes.resize(n);
  }
  if (by_values) sum.by_values = Eigen::MatrixXd::Zero(unknowns() + 6, value_count());
  for (size_t i = 0; i < n; ++i) {
    if (!add_element(i, x, values, order, by_values, sum)) {
      sum.energy = std::numeric_limits<double>::infinity();
      return sum;
    }
  }
  for (const Share& share : shares_) {
    const size_t a = static_cast<size_t>(share.node);
    const Matrix3d R = rotation_by(x.q[a]);
    const double pull = values[share.value];
    sum.energy -= pull * share.force.dot(x.r[a] + R * share.arm);
    if (order < slopes) continue;
    const Vector3d tau = R.transpose() * share.force;
    Vector6 slope;
    slope << -share.force, -cross(share.arm, tau);
    sum.gradient.segment<6>(6 * share.node) += pull * slope;
    if (by_values) sum.by_values.col(share.value).segment<6>(6 * share.node) += slope;
    if (order == curvatures) sum.hessian.on[a].bottomRightCorner<3, 3>() -= pull * arm_curvature(share.arm, tau);
  }
  if (order >= slopes) sum.gradient = sum.gradient.tail(unknowns()).eval();
  if (by_values) sum.by_values = sum.by_values.bottomRows(unknowns()).eval();
  if (order == curvatures) {
    sum.hessian.on.erase(sum.hessian.on.begin());
    sum.hessian.beside.erase(sum.hessian.beside.begin());
  }
  return sum;
}

/// False where it has turned by too much.
bool Rod::add_element(size_t i, const RodState& x, const Values& values, Order order, bool by_values, Sums& sum) const {
  const Section& section = sections_[i];
  const double E = values[youngs], nu = values[poisson], G = E / (2 * (1 + nu));
  const RodElement e(x.r[i], x.q[i], x.r[i + 1], x.q[i + 1], sections_[i].length);
  if (!e.possible()) return false;
  const double shear = G * section.shear, twist = G * section.of.torsion;
  const RodStretching body = stretching_of(section, Vector3d(e.v[2], e.k[0], e.k[1]), E, nu, by_values);
  Vector6 stress;
  stress << shear * e.v[0], shear * e.v[1], body.stress, twist * e.k[2];
  const Vector6 of_body = stress;
  Matrix6 tangent = Matrix6::Zero();
  tangent.diagonal() << shear, shear, 0, 0, 0, twist;
  tangent.block<3, 3>(2, 2) = body.tangent;
  double stored = body.energy + 0.5 * (shear * e.v.head<2>().squaredNorm() + twist * e.k[2] * e.k[2]);
  Eigen::Matrix<double, 6, Eigen::Dynamic> pulls(6, section.pieces.size());  // stresses by tensions
  for (size_t t = 0; t < section.pieces.size(); ++t) {
    const Piece& piece = section.pieces[t];
    const Vector3d way = e.v + cross(e.k, piece.eyelet) + piece.slope;
    const double part = x.left.size() == 0 ? piece.part : piece.part * x.left[piece.index];
    const double length = way.norm(), tension = part * values[piece.value];
    const Vector3d along = way / length;
    Vector6 pull;
    pull << along, cross(piece.eyelet, along);
    pulls.col(static_cast<Eigen::Index>(t)) = part * pull;
    stored += tension * length;
    stress += tension * pull;
    Matrix3d across = -tension / length * outer(along, along);
    across.diagonal().array() += tension / length;
    Matrix36 by_strains;
    const Matrix3d arm = cross_matrix(piece.eyelet);
    for (int c = 0; c < 3; ++c) {
      for (int r = 0; r < 3; ++r) {
        by_strains(r, c) = r == c ? 1 : 0;
        by_strains(r, c + 3) = -arm(r, c);
      }
    }
    tangent += congruent(across, by_strains);
  }
  sum.energy += section.length * stored;
  if (order < slopes) return true;

  const Eigen::Index at = 6 * static_cast<Eigen::Index>(i);
  const Matrix612 B = e.slopes();
  const auto add_slope = [&](Eigen::Ref<Eigen::VectorXd> to, const Vector6& by_strains) {
    to.segment<12>(at) += section.length * (B.transpose() * by_strains);
  };
  add_slope(sum.gradient, stress);
  if (by_values) {
    Vector6 poissons;
    poissons << of_body[0], of_body[1], 0, 0, 0, of_body[5];
    poissons /= -(1 + nu);
    poissons.segment<3>(2) = body.by_poisson;
    add_slope(sum.by_values.col(youngs), of_body / E);
    add_slope(sum.by_values.col(poisson), poissons);
    for (size_t t = 0; t < section.pieces.size(); ++t)
      add_slope(sum.by_values.col(section.pieces[t].value), pulls.col(static_cast<Eigen::Index>(t)));
  }
  if (order < curvatures) return true;
  const Matrix12 H = section.length * (congruent(tangent, B) + e.curvature(stress));
  sum.hessian.on[i] += H.topLeftCorner<6, 6>();
  sum.hessian.on[i + 1] += H.bottomRightCorner<6, 6>();
  sum.hessian.beside[i] += H.topRightCorner<6, 6>();
  sum.v[i] = e.v;
  sum.slopes[i] = B.topRows<3>();
  return true;
}

RodStretching Rod::stretching_of(const Section& section, const Vector3d& by, double E, double nu,
                                 bool by_poisson) const {
  RodStretching sum;
  if (shape_.law == SectionLaw::linear) {
    const Vector3d stiffness(E * section.of.area, E * section.of.first, E * section.of.second);
    const Vector3d strains = by - Vector3d(1, 0, 0);
    sum.tangent = stiffness.asDiagonal();
    sum.stress = stiffness.cwiseProduct(strains);
    sum.energy = 0.5 * sum.stress.dot(strains);
  } else if (shape_.round) {
    add_circle(1, section.outer, by, E, nu, by_poisson, sum);
    if (section.inner > 0) add_circle(-1, section.inner, by, E, nu, by_poisson, sum);
  } else {
    add_rectangle(section.half_first, section.half_second, by, E, nu, by_poisson, sum);
  }
  return sum;
}

std::optional<BlockFactors> Rod::factors_at(const RodState& x, const Values& values) const {
  return BlockFactors::of(assemble(x, values, curvatures).hessian, 0, Vector6::Zero());
}

double Rod::energy(const RodState& x, const Values& values) const {
  return assemble(x, values, energies).energy;
}

Eigen::VectorXd Rod::gradient(const RodState& x, const Values& values) const {
  if (values[friction()] == 0) return assemble(x, values, slopes).gradient;
  RodState rubbed = x;
  rubbed.left = tension_left(x, values[friction()]);
  return assemble(rubbed, values, slopes).gradient;
}

Eigen::MatrixXd Rod::gradient_by_values(const RodState& x, const Values& values, bool by_friction) const {
  MatrixXd by_values = assemble(x, values, slopes, true).by_values;
  if (by_friction) by_values.col(friction()) = gradient_by_friction(x, values);
  return by_values;
}

/// Sections turn, and elements stretch and shear as the step says to first order: what they carry moves with them, and
/// no large turn stretches the rod.
RodState Rod::moved(const RodState& x, const Eigen::VectorXd& step, const Sums& at) const {
  RodState to = x;
  for (size_t i = 1; i < x.q.size(); ++i) {
    const Eigen::Index first = 6 * static_cast<Eigen::Index>(i - 1);
    to.q[i] = product(x.q[i], turn(step.segment<3>(first + 3))).normalized();
    Vector12 by = Vector12::Zero();
    if (i > 1) by.head<6>() = step.segment<6>(first - 6);
    by.tail<6>() = step.segment<6>(first);
    const Vector3d v = at.v[i - 1] + at.slopes[i - 1] * by;
    const Vector4d qb = to.q[i - 1].dot(to.q[i]) < 0 ? Vector4d(-to.q[i]) : to.q[i];
    to.r[i] = to.r[i - 1] + sections_[i - 1].length * (rotation_by((to.q[i - 1] + qb).normalized()) * v);
  }
  return to;
}

std::string Rod::solve(RodState& x, const Values& values, int& factorisations, int iterations) const {
  constexpr double negligible = 1e-12;  // of the rod's length; turns times an element's length
  const double size = shape_.length;
  Vector6 unit;
  const double mean = size / elements();
  unit << 1, 1, 1, mean, mean, mean;
  const auto length_of = [&](const Eigen::VectorXd& step) {
    double most = 0;
    for (Eigen::Index i = 0; i < step.size(); ++i) most = std::max(most, unit[i % 6] * std::abs(step[i]));
    return most;
  };
  double before = std::numeric_limits<double>::infinity();  // length of the last step
  for (int iteration = 0; iteration < iterations; ++iteration) {
    const Sums sum = assemble(x, values, curvatures);
    if (!std::isfinite(sum.energy)) return "the energy is not finite";
    std::optional<BlockFactors> factors;
    double shift = 0;
    const double softest = values[youngs] * sections_.back().of.area / mean;
    while (!factors) {
      ++factorisations;
      factors = BlockFactors::of(sum.hessian, shift, unit.cwiseAbs2());
      if (factors) break;
      shift = shift == 0 ? 1e-5 * softest : 8 * shift;
      if (!(shift < 1e6 * softest)) return "the energy is not finite";
    }
    const Eigen::VectorXd step = -factors->solve(sum.gradient);
    if (!step.allFinite()) return "the energy is not finite";
    const double length = length_of(step);
    // A thin rod is so much stiffer along itself than across that rounding keeps steps above what is negligible.
    const bool floor = shift == 0 && length < 1e-8 * size && length > 0.5 * before;
    if (length < negligible * size || floor) {
      x = moved(x, step, sum);
      return shift == 0 ? "" : "the equilibrium is not stable";
    }
    before = length;
    double largest_turn = 0;
    for (Eigen::Index i = 0; i + 6 <= step.size(); i += 6)
      largest_turn = std::max(largest_turn, step.segment<3>(i + 3).norm());
    double fraction = std::min(1.0, 1.5 / largest_turn);
    const double slope = sum.gradient.dot(step);
    RodState to;
    const auto accepted = [&] {
      to = moved(x, fraction * step, sum);
      const double reached = energy(to, values);
      // Below that energies differ by rounding.
      return std::isfinite(reached) &&
             (reached <= sum.energy + 1e-4 * fraction * slope || fraction * length < 1e-8 * size);
    };
    while (!accepted() && fraction > 1e-10) fraction *= 0.5;
    x = to;
  }
  return "Newton's method does not converge";
}

std::string Rod::solve_from_rest(RodState& x, const Values& values, int& factorisations) const {
  const auto at = [&](double part) {
    Values some = values;
    some.segment(weight, friction() - weight) *= part;
    return some;
  };
  x = rest();
  double done = 0, step = 1;
  while (done < 1) {
    RodState next = x;
    const double until = std::min(1.0, done + step);
    const std::string problem = settle(next, at(until), factorisations);
    if (problem.empty()) {
      x = next;
      done = until;
      continue;
    }
    step = 0.5 * (until - done);
    if (step < 1.0 / 256) return problem;
  }
  return "";
}

RodReading Rod::position(const RodState& x, const RodPoint& point) const {
  const auto [element, f, length] = place_of(point.s);
  const auto [before, after] = arms_of(point);
  const size_t a = static_cast<size_t>(element);
  const Matrix3d Ra = rotation_by(x.q[a]), Rb = rotation_by(x.q[a + 1]);
  RodReading reading;
  reading.node = element;
  reading.value = (1 - f) * (x.r[a] + Ra * before) + f * (x.r[a + 1] + Rb * after);
  const Matrix3d A = times(Ra, cross_matrix(before)), B = times(Rb, cross_matrix(after));
  for (int c = 0; c < 3; ++c) {
    for (int r = 0; r < 3; ++r) {
      reading.slopes(r, c) = r == c ? 1 - f : 0;
      reading.slopes(r, c + 3) = -(1 - f) * A(r, c);
      reading.slopes(r, c + 6) = r == c ? f : 0;
      reading.slopes(r, c + 9) = -f * B(r, c);
    }
  }
  return reading;
}

Matrix3d Rod::end_rotation(const RodState& x) const {
  return rotation_by(x.q.back());
}

RodStrains Rod::strains(const RodState& x) const {
  RodStrains most;
  for (size_t i = 0; i < sections_.size(); ++i) {
    const RodElement e(x.r[i], x.q[i], x.r[i + 1], x.q[i + 1], sections_[i].length);
    const Section& section = sections_[i];
    const double bent = shape_.round ? section.outer * e.k.head<2>().norm()
                                     : section.half_second * std::abs(e.k[0]) + section.half_first * std::abs(e.k[1]);
    most.compression = std::max(most.compression, 1 - e.v[2] + bent);
    most.size = std::max({most.size, most.compression, e.v[2] - 1 + bent});
  }
  return most;
}

}  // namespace taut
