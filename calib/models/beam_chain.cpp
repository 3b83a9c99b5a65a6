#include "calib/models/beam_chain.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <type_traits>

#include "calib/models/fibre.hpp"
#include "sim/core/dense.hpp"
#include "sim/core/jet.hpp"
#include "sim/core/numbers.hpp"

namespace taut {
namespace {

using Chain = BeamProtocol::Chain;

/// Width of the transition in which a lip begins to press [m]; a corner that presses at once would have a kink.
constexpr double lip_smoothing = 2e-6;

/// phi(e) and its derivatives for unit stiffness: a spring that only pulls, smooth as sim/terms/cable.hpp has it.
Jet<1> one_sided(double e, double smoothing) {
  Jet<1> phi;
  const double z = e + 0.5 * smoothing;
  if (z <= 0) return phi;
  const bool taut = z >= smoothing;
  phi.v = taut ? 0.5 * e * e + smoothing * smoothing / 24 : z * z * z / (6 * smoothing);
  phi.g[0] = taut ? e : z * z / (2 * smoothing);
  phi.H(0, 0) = taut ? 1 : z / smoothing;
  return phi;
}

template <class T>
T variable(double value, int index) {
  if constexpr (std::is_same_v<T, double>)
    return value;
  else
    return T::variable(value, index);
}

/// Where a point is, by the unknowns of its body, which are the variables from `first` on.
template <class T>
std::array<T, 2> place(const Chain& chain, const BodyPoint& point, const Eigen::VectorXd& x, int first) {
  if (point.body < 0) return {T(point.rest.x()), T(point.rest.y())};
  const Eigen::Vector2d centre = chain.centres[static_cast<size_t>(point.body)], arm = point.rest - centre;
  const auto unknown = [&](int i) { return variable<T>(x[3 * point.body + i], first + i); };
  using std::cos;
  using std::sin;
  const T angle = unknown(2), c = cos(angle), s = sin(angle);
  return {centre.x() + unknown(0) + arm.x() * c - arm.y() * s, centre.y() + unknown(1) + arm.x() * s + arm.y() * c};
}

template <class T>
T angle_of(int body, const Eigen::VectorXd& x, int first) {
  return body < 0 ? T(0.0) : variable<T>(x[3 * body + 2], first + 2);
}

/// Lengthening, shear and turning (e, s, k) of a span.
template <class T>
std::array<T, 3> deformation(const Chain& chain, const ChainSpan& span, const Eigen::VectorXd& x) {
  using std::cos;
  using std::sin;
  const std::array<T, 2> a = place<T>(chain, span.left, x, 0), b = place<T>(chain, span.right, x, 3);
  const T left = angle_of<T>(span.left.body, x, 0), right = angle_of<T>(span.right.body, x, 3);
  const T middle = 0.5 * (left + right), c = cos(middle), s = sin(middle);
  const T dx = b[0] - a[0], dy = b[1] - a[1];
  return {c * dx + s * dy - span.length, c * dy - s * dx, right - left};
}

/// Energy of a span per thickness [N] by its deformation and the foam's constants.
template <class T, class P>
T span_energy(bool plane_stress, const ChainSpan& span, const std::array<T, 3>& deformation, const P& youngs,
              const P& poisson) {
  using std::sqrt;
  using std::tanh;
  const auto& [e, s, k] = deformation;
  const double L = span.length, h = span.height;
  const P mu = youngs / (2.0 * (1.0 + poisson));
  const P lambda = youngs * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson));
  const P loose_modulus = plane_stress ? P(youngs) : P(youngs / (1.0 - poisson * poisson));
  const P kept_modulus = plane_stress ? P(youngs / (1.0 - poisson * poisson)) : P(lambda + 2.0 * mu);
  const auto near_ends = [&](const P& a_squared) {
    if (span.bonded == 0) return P(0.0);
    const P q = sqrt(a_squared) * (L / (span.bonded * h));
    return P(tanh(q) / q);
  };
  // The share of w_kept whose modulus has the compliance (1 - beta)/E' + beta/M.
  const auto share_of = [&](const P& beta) {
    return P(beta * loose_modulus / ((1.0 - beta) * kept_modulus + beta * loose_modulus));
  };
  const P mean = share_of(near_ends(12.0 * loose_modulus / mu));
  const P bending = share_of(near_ends(60.0 * loose_modulus / mu));
  const P warping = near_ends(140.0 * mu / kept_modulus);
  const int free = plane_stress ? 2 : 1;
  const auto mixed = [](const auto& loose, const auto& kept, const P& share) {
    return (1.0 - share) * loose + share * kept;
  };
  const auto fibre = [&](const T& stretch, const P& share) {
    const T loose = fibre_energy(stretch, free, mu, lambda);
    return span.bonded == 0 ? loose : mixed(loose, fibre_energy(stretch, free - 1, mu, lambda), share);
  };
  const T stretch = 1.0 + e / L;
  T sum = (h * L) * fibre(stretch, mean);
  // Gauss points over the height; the one in the middle is the fibre that the others are compared with.
  constexpr double place[2] = {0.5384693101056831, 0.9061798459386640};
  constexpr double weight[2] = {0.4786286704993665, 0.2369268850561891};
  const T middle = fibre(stretch, bending);
  for (int i = 0; i < 2; ++i) {
    const T turned = (0.5 * h * place[i] / L) * k;
    sum = sum + (0.5 * h * L * weight[i]) *
                    (fibre(stretch + turned, bending) + fibre(stretch - turned, bending) - 2.0 * middle);
  }
  const P tangent = mixed(loose_modulus, kept_modulus, bending);
  const P compliance = L * L * L / (tangent * (h * h * h)) + (1.2 - 0.2 * warping) * L / (mu * h);
  return sum + 0.5 * s * s / compliance;
}

double stiffness_of_lips(const Chain& chain, const Params& p) {
  return chain.lip_shape * p[chain.thickness] * (chain.E_plastic < 0 ? 1e10 : p[chain.E_plastic]);
}

/// Distance of a corner from the face, positive while open.
template <class T>
T gap(const Chain& chain, const LipCorner& lip, const Eigen::VectorXd& x) {
  using std::cos;
  using std::sin;
  const std::array<T, 2> corner = place<T>(chain, lip.corner, x, 0), face = place<T>(chain, lip.face, x, 3);
  const T angle = angle_of<T>(lip.face.body, x, 3);
  return cos(angle) * (face[0] - corner[0]) + sin(angle) * (face[1] - corner[1]);
}

template <class T>
T distance(const Chain& chain, const std::array<BodyPoint, 2>& ends, const Eigen::VectorXd& x) {
  using std::sqrt;
  const std::array<T, 2> a = place<T>(chain, ends[0], x, 0), b = place<T>(chain, ends[1], x, 3);
  const T dx = b[0] - a[0], dy = b[1] - a[1];
  return sqrt(dx * dx + dy * dy);
}

double elongation(const Chain& chain, const ChainCable& cable, const Eigen::VectorXd& x, const Params& p) {
  double e = (cable.retraction < 0 ? 0.0 : p[cable.retraction]) - p[chain.slack];
  for (const auto& ends : cable.free_lengths)
    e += distance<double>(chain, ends, x) - (ends[1].rest - ends[0].rest).norm();
  return e;
}

/// Scale times all parameters of a load but number `but`: its force, or the derivative of that.
double force(const ChainLoad& load, const Params& p, size_t but = std::numeric_limits<size_t>::max()) {
  double newtons = load.scale;
  for (size_t k = 0; k < load.factors.size(); ++k) newtons *= k == but ? 1.0 : p[load.factors[k]];
  return newtons;
}

/// Adds up the energies of pairs of bodies, with derivatives. What is fixed in space is one body more, at the end.
class Assembler {
 public:
  Assembler(const Chain& chain, const Eigen::VectorXd& x, const Params& p, const std::vector<int>& free)
      : chain_(chain), x_(x), p_(p), free_(free) {
    const Eigen::Index all = x.size() + 3;
    sum_.gradient = Eigen::VectorXd::Zero(all);
    sum_.hessian = Eigen::MatrixXd::Zero(all, all);
    sum_.mixed = Eigen::MatrixXd::Zero(all, static_cast<Eigen::Index>(free.size()));
  }

  /// N: deformations only (3), or the foam's two constants too (5).
  template <int N>
  void add(const ChainSpan& span) {
    const Unknowns pair = unknowns(span.left.body, span.right.body);
    const std::array<Jet<6>, 3> q = deformation<Jet<6>>(chain_, span, x_);
    Eigen::Matrix<double, 6, 3> J;
    std::array<Jet<N>, 3> local;
    for (int i = 0; i < 3; ++i) {
      J.col(i) = q[static_cast<size_t>(i)].g;
      local[static_cast<size_t>(i)] = Jet<N>::variable(q[static_cast<size_t>(i)].v, i);
    }
    const double t = p_[chain_.thickness], youngs = p_[chain_.E], poisson = p_[chain_.nu];
    Jet<N> stored;
    if constexpr (N == 3) {
      stored = span_energy(chain_.plane_stress, span, local, youngs, poisson);
    } else {
      stored = span_energy(chain_.plane_stress, span, local, Jet<N>::variable(youngs, 3), Jet<N>::variable(poisson, 4));
      add_mixed(pair, chain_.E, J * (t * stored.H.template block<3, 1>(0, 3)));
      add_mixed(pair, chain_.nu, J * (t * stored.H.template block<3, 1>(0, 4)));
      add_mixed(pair, chain_.thickness, J * stored.g.template head<3>());
    }
    const Eigen::Vector3d slope = t * stored.g.template head<3>();
    const Eigen::Matrix3d curvature = t * stored.H.template topLeftCorner<3, 3>();
    Matrix6 H = J * curvature * J.transpose();
    for (int i = 0; i < 3; ++i) H += slope[i] * q[static_cast<size_t>(i)].H;
    add(pair, t * stored.v, J * slope, H);
  }

  void add(const ChainCable& cable) {
    const Jet<1> phi = one_sided(elongation(chain_, cable, x_, p_), cable.smoothing);
    const double k = p_[chain_.k_cable];
    sum_.energy += k * phi.v;
    if (phi.g[0] == 0) return;
    Eigen::VectorXd along = Eigen::VectorXd::Zero(sum_.gradient.size());
    for (const auto& ends : cable.free_lengths) {
      const Unknowns pair = unknowns(ends[0].body, ends[1].body);
      const Jet<6> length = distance<Jet<6>>(chain_, ends, x_);
      along(pair) += length.g;
      sum_.hessian(pair, pair) += k * phi.g[0] * length.H;
    }
    sum_.gradient += k * phi.g[0] * along;
    sum_.hessian += k * phi.H(0, 0) * along * along.transpose();
    for (Eigen::Index c = 0; c < sum_.mixed.cols(); ++c) {
      const int index = free_[static_cast<size_t>(c)];
      if (index == chain_.k_cable) sum_.mixed.col(c) += phi.g[0] * along;
      if (index == chain_.slack) sum_.mixed.col(c) -= k * phi.H(0, 0) * along;
      if (index == cable.retraction) sum_.mixed.col(c) += k * phi.H(0, 0) * along;
    }
  }

  void add(const LipCorner& lip) {
    const Jet<1> phi = one_sided(-gap<double>(chain_, lip, x_), lip_smoothing);
    if (phi.g[0] == 0) return;
    const Unknowns pair = unknowns(lip.corner.body, lip.face.body);
    const double stiffness = stiffness_of_lips(chain_, p_);
    const Jet<6> open = gap<Jet<6>>(chain_, lip, x_);
    const Vector6 push = -stiffness * phi.g[0] * open.g;
    add(pair, stiffness * phi.v, push, stiffness * (phi.H(0, 0) * open.g * open.g.transpose() - phi.g[0] * open.H));
    if (chain_.E_plastic >= 0) add_mixed(pair, chain_.E_plastic, push / p_[chain_.E_plastic]);
    add_mixed(pair, chain_.thickness, push / p_[chain_.thickness]);
  }

  void add(const ChainLoad& load) {
    const Unknowns pair = unknowns(load.at.body, -1);
    const std::array<Jet<6>, 2> at = place<Jet<6>>(chain_, load.at, x_, 0);
    const Jet<6> way = load.direction.x() * at[0] + load.direction.y() * at[1];
    const double newtons = force(load, p_);
    add(pair, -newtons * (way.v - load.direction.dot(load.at.rest)), -newtons * way.g, -newtons * way.H);
    for (size_t k = 0; k < load.factors.size(); ++k) add_mixed(pair, load.factors[k], -force(load, p_, k) * way.g);
  }

  /// The elastic clamp, the first body: it turns about its middle.
  void add_base() {
    const Unknowns own = unknowns(0, -1);
    const double angle = x_[2], c = p_[chain_.k_base];
    Vector6 slope = Vector6::Zero(), turn = Vector6::Unit(2);
    slope << chain_.base * x_[0], chain_.base * x_[1], c * angle, 0, 0, 0;
    Vector6 stiffness;
    stiffness << chain_.base, chain_.base, c, 0, 0, 0;
    add(own, 0.5 * (chain_.base * x_.head<2>().squaredNorm() + c * angle * angle), slope, stiffness.asDiagonal());
    add_mixed(own, chain_.k_base, angle * turn);
  }

  ChainEnergy result() const {
    const Eigen::Index n = x_.size();
    return {sum_.energy, sum_.gradient.head(n), sum_.hessian.topLeftCorner(n, n), sum_.mixed.topRows(n)};
  }

 private:
  using Unknowns = std::array<Eigen::Index, 6>;
  using Vector6 = Eigen::Matrix<double, 6, 1>;
  using Matrix6 = Eigen::Matrix<double, 6, 6>;

  /// Those of a pair of bodies, of the first one first.
  Unknowns unknowns(int first, int second) const {
    const Eigen::Index a = first < 0 ? x_.size() : 3 * first, b = second < 0 ? x_.size() : 3 * second;
    return {a, a + 1, a + 2, b, b + 1, b + 2};
  }
  void add(const Unknowns& pair, double energy, const Vector6& gradient, const Matrix6& hessian) {
    sum_.energy += energy;
    sum_.gradient(pair) += gradient;
    sum_.hessian(pair, pair) += hessian;
  }
  void add_mixed(const Unknowns& pair, int index, const Vector6& local) {
    for (size_t c = 0; c < free_.size(); ++c) {
      if (free_[c] == index) sum_.mixed.col(static_cast<Eigen::Index>(c))(pair) += local;
    }
  }

  const Chain& chain_;
  const Eigen::VectorXd& x_;
  const Params& p_;
  const std::vector<int>& free_;
  ChainEnergy sum_;
};

}  // namespace

double BeamProtocol::Chain::energy(const Eigen::VectorXd& x, const Params& p) const {
  double sum = 0;
  for (const ChainSpan& span : spans)
    sum += p[thickness] * span_energy(plane_stress, span, deformation<double>(*this, span, x), p[E], p[nu]);
  for (const ChainCable& cable : cables)
    sum += p[k_cable] * one_sided(elongation(*this, cable, x, p), cable.smoothing).v;
  for (const LipCorner& lip : lips)
    sum += stiffness_of_lips(*this, p) * one_sided(-gap<double>(*this, lip, x), lip_smoothing).v;
  for (const ChainLoad& load : loads) {
    const std::array<double, 2> at = place<double>(*this, load.at, x, 0);
    sum -= force(load, p) * load.direction.dot(Eigen::Vector2d(at[0], at[1]) - load.at.rest);
  }
  if (base > 0) sum += 0.5 * (base * x.head<2>().squaredNorm() + p[k_base] * x[2] * x[2]);
  return sum;
}

ChainEnergy BeamProtocol::Chain::assemble(const Eigen::VectorXd& x, const Params& p,
                                          const std::vector<int>& free) const {
  Assembler sum(*this, x, p, free);
  for (const ChainSpan& span : spans) free.empty() ? sum.add<3>(span) : sum.add<5>(span);
  for (const ChainCable& cable : cables) sum.add(cable);
  for (const LipCorner& lip : lips) sum.add(lip);
  for (const ChainLoad& load : loads) sum.add(load);
  if (base > 0) sum.add_base();
  return sum.result();
}

Eigen::VectorXd BeamProtocol::Chain::moved(const Eigen::VectorXd& x, const Eigen::VectorXd& step) const {
  Eigen::VectorXd to = x + step;
  for (const ChainSpan& span : spans) {
    const std::array<Jet<6>, 3> q = deformation<Jet<6>>(*this, span, x);
    Eigen::Matrix<double, 6, 1> by = Eigen::Matrix<double, 6, 1>::Zero();
    if (span.left.body >= 0) by.head<3>() = step.segment<3>(3 * span.left.body);
    by.tail<3>() = step.segment<3>(3 * span.right.body);
    const double e = span.length + q[0].v + q[0].g.dot(by), s = q[1].v + q[1].g.dot(by);
    const double middle = 0.5 * (angle_of<double>(span.left.body, to, 0) + to[3 * span.right.body + 2]);
    const std::array<double, 2> from = place<double>(*this, span.left, to, 0),
                                now = place<double>(*this, span.right, to, 0);
    to[3 * span.right.body] += from[0] + std::cos(middle) * e - std::sin(middle) * s - now[0];
    to[3 * span.right.body + 1] += from[1] + std::sin(middle) * e + std::cos(middle) * s - now[1];
  }
  return to;
}

std::string BeamProtocol::Chain::solve(Eigen::VectorXd& x, const Params& p, int& factorisations) const {
  constexpr double negligible = 1e-11;  // [m]; angles times a span's length
  const double size = spans.front().length;
  Eigen::VectorXd unit = Eigen::VectorXd::Ones(x.size());
  for (Eigen::Index i = 2; i < x.size(); i += 3) unit[i] = size;
  double before = infinity;  // length of the last step
  for (int iteration = 0; iteration < 100; ++iteration) {
    const ChainEnergy sum = assemble(x, p, {});
    ++factorisations;
    const std::optional<Eigen::MatrixXd> newton = solve_positive_definite(sum.hessian, sum.gradient);
    const bool convex = newton.has_value();
    Eigen::VectorXd step;
    if (convex) {
      step = -*newton;
    } else {
      // Downhill all the same: curvatures by their size.
      const auto scale = unit.cwiseInverse().asDiagonal();
      const auto [values, V] = symmetric_modes(scale * sum.hessian * scale);
      const Eigen::VectorXd sizes = values.cwiseAbs(), downhill = scale * sum.gradient;
      const Eigen::VectorXd curvatures = sizes.cwiseMax(1e-9 * sizes.maxCoeff());
      step = -(scale * (V * (V.transpose() * downhill).cwiseQuotient(curvatures)).eval());
    }
    if (!step.allFinite()) return "the energy is not finite";
    const double length = step.cwiseProduct(unit).cwiseAbs().maxCoeff();
    // A thin beam is so much stiffer along itself than across that rounding keeps steps above what is negligible.
    const bool floor = convex && length < 1e-7 * size && length > 0.5 * before;
    if (length < negligible || floor) {
      x += step;
      return convex ? "" : "the equilibrium is not stable";
    }
    before = length;
    const double slope = sum.gradient.dot(step);
    double fraction = std::min(1.0, 0.5 * size / length);
    // Below a tenth of a micrometre energies differ by rounding.
    const auto accepted = [&] {
      const double reached = energy(moved(x, fraction * step), p);
      return std::isfinite(reached) && (reached <= sum.energy + 1e-4 * fraction * slope || fraction * length < 1e-8);
    };
    while (!accepted() && fraction > 1e-12) fraction *= 0.5;
    x = moved(x, fraction * step);
  }
  return "Newton's method does not converge";
}

std::string BeamProtocol::Chain::solve_in_steps(Eigen::VectorXd& x, const Params& from, const Params& to,
                                                int& factorisations) const {
  double done = 0, step = 1;
  while (done < 1) {
    Eigen::VectorXd next = x;
    const double until = std::min(1.0, done + step);
    const std::string problem = solve(next, from + until * (to - from), factorisations);
    if (problem.empty()) {
      x = next;
      done = until;
      step = std::min(1.0, 2 * step);
      continue;
    }
    step = 0.5 * (until - done);
    if (step < 1.0 / 64) return problem;
  }
  return "";
}

double BeamProtocol::Chain::stated_error(const Eigen::VectorXd& x, const Params& p) const {
  std::map<int, std::array<bool, 2>> closed;  // cell to its sides
  for (const LipCorner& lip : lips) {
    if (gap<double>(*this, lip, x) < 0) closed[lip.cell][lip.side > 0 ? 0 : 1] = true;
  }
  for (const auto& [cell, sides] : closed) {
    if (sides[0] && sides[1]) return infinity;
  }
  const ChainSpan& first = spans.front();
  if (first.bonded < 2) {
    const double turned = x[x.size() - 1] - (base > 0 ? x[2] : 0.0),
                 length = first.length * static_cast<double>(spans.size());
    if (length < first.height || p[nu] > 0.45) return infinity;
    return 0.01 + 0.15 * first.height / length * turned * turned;
  }
  const double slenderness = first.length / first.height, poisson = p[nu];
  if (slenderness < 0.2 || slenderness > 1 || poisson > 0.45) return infinity;
  // What bonding can add to the modulus, M/E' - 1.
  const double excess = poisson * poisson / (plane_stress ? 1 - poisson * poisson : 1 - 2 * poisson);
  double compression = 0;
  for (const ChainSpan& span : spans)
    compression = std::max(compression, -deformation<double>(*this, span, x)[0] / span.length);
  return 0.02 + 0.04 * excess + (0.15 + 0.5 * slenderness * slenderness) * compression +
         2 * std::max(0.0, compression - 0.25) + (E_plastic < 0 ? 0.0 : 150 * p[E] / p[E_plastic]);
}

std::pair<double, Eigen::RowVector3d> BeamProtocol::Chain::read(size_t channel, const Eigen::VectorXd& x) const {
  const ChainChannel& reading = channels[channel];
  const std::array<Jet<6>, 2> at = place<Jet<6>>(*this, reading.at, x, 0);
  const Jet<6> y = reading.direction.x() * at[0] + reading.direction.y() * at[1];
  return {y.v - reading.direction.dot(reading.at.rest), y.g.head<3>().transpose()};
}

}  // namespace taut
