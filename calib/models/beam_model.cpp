#include "calib/models/beam_model.hpp"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <type_traits>

#include "sim/core/error.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();
constexpr double not_a_number = std::numeric_limits<double>::quiet_NaN();
/// Width of the transition in which a lip begins to press [m]; a corner that presses at once would have a kink.
constexpr double lip_smoothing = 2e-6;

/// A number with its first and second derivatives with respect to N variables.
template <int N>
struct Jet {
  using Gradient = Eigen::Matrix<double, N, 1>;
  using Hessian = Eigen::Matrix<double, N, N>;
  double v = 0;
  Gradient g = Gradient::Zero();
  Hessian H = Hessian::Zero();

  Jet() = default;
  Jet(double value) : v(value) {}
  static Jet variable(double value, int index) {
    Jet x(value);
    x.g[index] = 1;
    return x;
  }
  /// f(x) of one number by its value and derivatives there.
  Jet with(double f, double df, double ddf) const {
    Jet y(f);
    y.g = df * g;
    y.H = df * H + ddf * (g * g.transpose());
    return y;
  }
  friend Jet operator+(const Jet& a, const Jet& b) {
    Jet c(a.v + b.v);
    c.g = a.g + b.g;
    c.H = a.H + b.H;
    return c;
  }
  friend Jet operator-(const Jet& a, const Jet& b) {
    Jet c(a.v - b.v);
    c.g = a.g - b.g;
    c.H = a.H - b.H;
    return c;
  }
  friend Jet operator*(const Jet& a, const Jet& b) {
    Jet c(a.v * b.v);
    c.g = a.v * b.g + b.v * a.g;
    const Hessian cross = a.g * b.g.transpose();
    c.H = a.v * b.H + b.v * a.H + cross + cross.transpose();
    return c;
  }
  friend Jet operator+(const Jet& a, double b) {
    Jet c = a;
    c.v += b;
    return c;
  }
  friend Jet operator+(double a, const Jet& b) { return b + a; }
  friend Jet operator-(const Jet& a, double b) { return a + (-b); }
  friend Jet operator-(double a, const Jet& b) { return a + (-1.0) * b; }
  friend Jet operator*(double a, const Jet& b) {
    Jet c(a * b.v);
    c.g = a * b.g;
    c.H = a * b.H;
    return c;
  }
  friend Jet operator*(const Jet& a, double b) { return b * a; }
  friend Jet operator/(const Jet& a, double b) { return (1 / b) * a; }
  friend Jet operator/(const Jet& a, const Jet& b) {
    return a * b.with(1 / b.v, -1 / (b.v * b.v), 2 / (b.v * b.v * b.v));
  }
  friend Jet operator/(double a, const Jet& b) { return b.with(a / b.v, -a / (b.v * b.v), 2 * a / (b.v * b.v * b.v)); }
  friend Jet log(const Jet& x) { return x.with(std::log(x.v), 1 / x.v, -1 / (x.v * x.v)); }
  friend Jet sqrt(const Jet& x) {
    const double root = std::sqrt(x.v);
    return x.with(root, 0.5 / root, -0.25 / (root * x.v));
  }
  friend Jet tanh(const Jet& x) {
    const double t = std::tanh(x.v);
    return x.with(t, 1 - t * t, -2 * t * (1 - t * t));
  }
  friend Jet sin(const Jet& x) { return x.with(std::sin(x.v), std::cos(x.v), -std::sin(x.v)); }
  friend Jet cos(const Jet& x) { return x.with(std::cos(x.v), -std::sin(x.v), -std::cos(x.v)); }
};

double value_of(double x) {
  return x;
}
template <int N>
double value_of(const Jet<N>& x) {
  return x.v;
}

/// Neo-Hookean energy per volume [Pa] of a fibre while `free` of its two lateral directions move as they like, by a
/// common stretch l that minimises it, mu (l^2 - 1) + lambda (ln stretch + free ln l) = 0, and the others not at all.
template <class T, class P>
T fibre_energy(const T& stretch, int free, const P& mu, const P& lambda) {
  using std::log;
  if (!(value_of(stretch) > 0)) return T(infinity);
  const T axial = log(stretch);
  if (free == 0) return 0.5 * mu * (stretch * stretch - 1.0) - mu * axial + 0.5 * lambda * axial * axial;
  const double m = value_of(mu), c = value_of(lambda), n = free;
  const auto slope = [&](double l) { return 2 * m * l + c * n / l; };
  double l = 1;
  for (int i = 0; i < 50; ++i) {
    const double step = -(m * (l * l - 1) + c * (value_of(axial) + n * std::log(l))) / slope(l);
    l = std::max(l + step, 0.1 * l);
    if (std::abs(step) < 1e-15 * l) break;
  }
  // One more step with derivatives makes those of l right to first order: enough, where l minimises, for two of the
  // energy.
  const T lateral = l - (mu * (l * l - 1) + lambda * (axial + n * std::log(l))) / slope(l);
  const T volume = axial + n * log(lateral);
  return 0.5 * mu * (stretch * stretch - 1.0 + n * (lateral * lateral - 1.0)) - mu * volume +
         0.5 * lambda * volume * volume;
}

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

/// A point that moves with a body.
struct BodyPoint {
  int body = -1;         ///< -1: fixed in space
  Eigen::Vector2d rest;  ///< [m]
};

struct Span {
  BodyPoint left, right;  ///< middles of the faces that it joins
  double length = 0, height = 0;
  int bonded = 0;  ///< ends that are bonded to a body as wide as the span
};

struct ChainCable {
  std::vector<std::array<BodyPoint, 2>> free_lengths;  ///< pieces between points of different bodies
  int retraction = -1;
  double smoothing = 0;
};

/// A corner of a left lip's end face above the end face of a right lip.
struct LipCorner {
  int cell = 0, side = 0;
  BodyPoint corner, face;
};

struct ChainLoad {
  BodyPoint at;
  Eigen::Vector2d direction;
  int value = -1, times = -1;  ///< table indices; -1: 1
};

struct ChainChannel {
  BodyPoint at;
  Eigen::Vector2d direction;
};

/// Energy with derivatives with respect to the unknowns, and of the gradient with respect to parameters.
struct Sum {
  double energy = 0;
  Eigen::VectorXd gradient;
  Eigen::MatrixXd hessian;
  Eigen::MatrixXd mixed;
};

}  // namespace

struct BeamProtocol::Chain {
  ParameterTable table;
  Params nominal;
  std::vector<StaticRow> rows;
  std::vector<int> controls, set_first;  ///< table indices; positions among them
  bool from_unloaded = false;

  int bodies = 0;
  std::vector<Eigen::Vector2d> centres;  ///< what bodies turn about, at rest
  std::vector<Span> spans;
  std::vector<ChainCable> cables;
  std::vector<LipCorner> lips;
  std::vector<ChainLoad> loads;
  std::vector<ChainChannel> channels;
  bool plane_stress = false;
  double lip_shape = 0;  ///< stiffness of one corner of a lip over (E_plastic thickness)
  int E = -1, nu = -1, thickness = -1, E_plastic = -1, k_cable = -1, slack = -1;

  /// Where a point is, by the unknowns of its body, which are the variables from `first` on.
  template <class T>
  std::array<T, 2> place(const BodyPoint& point, const Eigen::VectorXd& x, int first) const {
    if (point.body < 0) return {T(point.rest.x()), T(point.rest.y())};
    const Eigen::Vector2d centre = centres[static_cast<size_t>(point.body)], arm = point.rest - centre;
    const auto unknown = [&](int i) { return variable<T>(x[3 * point.body + i], first + i); };
    using std::cos;
    using std::sin;
    const T angle = unknown(2), c = cos(angle), s = sin(angle);
    return {centre.x() + unknown(0) + arm.x() * c - arm.y() * s, centre.y() + unknown(1) + arm.x() * s + arm.y() * c};
  }
  template <class T>
  static T variable(double value, int index) {
    if constexpr (std::is_same_v<T, double>)
      return value;
    else
      return T::variable(value, index);
  }
  template <class T>
  T angle_of(int body, const Eigen::VectorXd& x, int first) const {
    return body < 0 ? T(0.0) : variable<T>(x[3 * body + 2], first + 2);
  }

  /// Lengthening, shear and turning (e, s, k) of a span.
  template <class T>
  std::array<T, 3> deformation(const Span& span, const Eigen::VectorXd& x) const {
    using std::cos;
    using std::sin;
    const std::array<T, 2> a = place<T>(span.left, x, 0), b = place<T>(span.right, x, 3);
    const T left = angle_of<T>(span.left.body, x, 0), right = angle_of<T>(span.right.body, x, 3);
    const T middle = 0.5 * (left + right), c = cos(middle), s = sin(middle);
    const T dx = b[0] - a[0], dy = b[1] - a[1];
    return {c * dx + s * dy - span.length, c * dy - s * dx, right - left};
  }

  /// Energy of a span per thickness [N] by its deformation and the foam's constants.
  template <class T, class P>
  T energy(const Span& span, const std::array<T, 3>& deformation, const P& youngs, const P& poisson) const {
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

  double stiffness_of_lips(const Params& p) const {
    return lip_shape * p[thickness] * (E_plastic < 0 ? 1e10 : p[E_plastic]);
  }

  /// Distance of a corner from the face, positive while open.
  template <class T>
  T gap(const LipCorner& lip, const Eigen::VectorXd& x) const {
    using std::cos;
    using std::sin;
    const std::array<T, 2> corner = place<T>(lip.corner, x, 0), face = place<T>(lip.face, x, 3);
    const T angle = angle_of<T>(lip.face.body, x, 3);
    return cos(angle) * (face[0] - corner[0]) + sin(angle) * (face[1] - corner[1]);
  }

  template <class T>
  T distance(const std::array<BodyPoint, 2>& ends, const Eigen::VectorXd& x) const {
    using std::sqrt;
    const std::array<T, 2> a = place<T>(ends[0], x, 0), b = place<T>(ends[1], x, 3);
    const T dx = b[0] - a[0], dy = b[1] - a[1];
    return sqrt(dx * dx + dy * dy);
  }

  double elongation(const ChainCable& cable, const Eigen::VectorXd& x, const Params& p) const {
    double e = (cable.retraction < 0 ? 0.0 : p[cable.retraction]) - p[slack];
    for (const auto& ends : cable.free_lengths) e += distance<double>(ends, x) - (ends[1].rest - ends[0].rest).norm();
    return e;
  }

  double force(const ChainLoad& load, const Params& p) const {
    return p[load.value] * (load.times < 0 ? 1.0 : p[load.times]);
  }

  double energy(const Eigen::VectorXd& x, const Params& p) const;
  /// With derivatives; `free`: table indices of the parameters of `mixed`.
  Sum assemble(const Eigen::VectorXd& x, const Params& p, const std::vector<int>& free) const;
  std::string solve(Eigen::VectorXd& x, const Params& p, int& factorisations) const;
  std::string solve_in_steps(Eigen::VectorXd& x, const Params& from, const Params& to, int& factorisations) const;
  double stated_error(const Eigen::VectorXd& x, const Params& p) const;
};

double BeamProtocol::Chain::energy(const Eigen::VectorXd& x, const Params& p) const {
  double sum = 0;
  for (const Span& span : spans) sum += p[thickness] * energy(span, deformation<double>(span, x), p[E], p[nu]);
  for (const ChainCable& cable : cables) sum += p[k_cable] * one_sided(elongation(cable, x, p), cable.smoothing).v;
  for (const LipCorner& lip : lips) sum += stiffness_of_lips(p) * one_sided(-gap<double>(lip, x), lip_smoothing).v;
  for (const ChainLoad& load : loads) {
    const std::array<double, 2> at = place<double>(load.at, x, 0);
    sum -= force(load, p) * load.direction.dot(Eigen::Vector2d(at[0], at[1]) - load.at.rest);
  }
  return sum;
}

Sum BeamProtocol::Chain::assemble(const Eigen::VectorXd& x, const Params& p, const std::vector<int>& free) const {
  const Eigen::Index n = x.size(), columns = static_cast<Eigen::Index>(free.size());
  Sum sum;
  sum.gradient = Eigen::VectorXd::Zero(n);
  sum.hessian = Eigen::MatrixXd::Zero(n, n);
  sum.mixed = Eigen::MatrixXd::Zero(n, columns);
  // Adds to the unknowns of two bodies, those of the first one first; what belongs to a fixed one is dropped.
  const auto place_of = [](const std::array<int, 2>& pair, int i) {
    const int body = pair[static_cast<size_t>(i / 3)];
    return body < 0 ? -1 : 3 * body + i % 3;
  };
  const auto add_gradient = [&](const std::array<int, 2>& pair, const Eigen::Matrix<double, 6, 1>& local, auto&& to) {
    for (int i = 0; i < 6; ++i) {
      if (place_of(pair, i) >= 0) to[place_of(pair, i)] += local[i];
    }
  };
  const auto add_hessian = [&](const std::array<int, 2>& pair, const Eigen::Matrix<double, 6, 6>& local,
                               Eigen::MatrixXd& to) {
    for (int i = 0; i < 6; ++i) {
      for (int j = 0; j < 6; ++j) {
        if (place_of(pair, i) >= 0 && place_of(pair, j) >= 0) to(place_of(pair, i), place_of(pair, j)) += local(i, j);
      }
    }
  };
  const auto add_mixed = [&](const std::array<int, 2>& pair, int index, const Eigen::Matrix<double, 6, 1>& local) {
    for (Eigen::Index c = 0; c < columns; ++c) {
      if (free[static_cast<size_t>(c)] == index) add_gradient(pair, local, sum.mixed.col(c));
    }
  };

  const double t = p[thickness];
  for (const Span& span : spans) {
    const std::array<int, 2> pair{span.left.body, span.right.body};
    const std::array<Jet<6>, 3> q = deformation<Jet<6>>(span, x);
    Eigen::Matrix<double, 6, 3> J;
    for (int i = 0; i < 3; ++i) J.col(i) = q[static_cast<size_t>(i)].g;
    Eigen::Vector3d slope;
    Eigen::Matrix3d curvature;
    if (columns == 0) {
      std::array<Jet<3>, 3> local;
      for (int i = 0; i < 3; ++i) local[static_cast<size_t>(i)] = Jet<3>::variable(q[static_cast<size_t>(i)].v, i);
      const Jet<3> stored = energy(span, local, p[E], p[nu]);
      sum.energy += t * stored.v;
      slope = t * stored.g;
      curvature = t * stored.H;
    } else {
      std::array<Jet<5>, 3> local;
      for (int i = 0; i < 3; ++i) local[static_cast<size_t>(i)] = Jet<5>::variable(q[static_cast<size_t>(i)].v, i);
      const Jet<5> stored = energy(span, local, Jet<5>::variable(p[E], 3), Jet<5>::variable(p[nu], 4));
      sum.energy += t * stored.v;
      slope = t * stored.g.head<3>();
      curvature = t * stored.H.topLeftCorner<3, 3>();
      add_mixed(pair, E, J * (t * stored.H.block<3, 1>(0, 3)));
      add_mixed(pair, nu, J * (t * stored.H.block<3, 1>(0, 4)));
      add_mixed(pair, thickness, J * stored.g.head<3>());
    }
    Eigen::Matrix<double, 6, 6> H = J * curvature * J.transpose();
    for (int i = 0; i < 3; ++i) H += slope[i] * q[static_cast<size_t>(i)].H;
    add_gradient(pair, J * slope, sum.gradient);
    add_hessian(pair, H, sum.hessian);
  }

  for (const ChainCable& cable : cables) {
    const Jet<1> phi = one_sided(elongation(cable, x, p), cable.smoothing);
    sum.energy += p[k_cable] * phi.v;
    if (phi.g[0] == 0) continue;
    Eigen::VectorXd along = Eigen::VectorXd::Zero(n);
    for (const auto& ends : cable.free_lengths) {
      const std::array<int, 2> pair{ends[0].body, ends[1].body};
      const Jet<6> length = distance<Jet<6>>(ends, x);
      add_gradient(pair, length.g, along);
      add_hessian(pair, p[k_cable] * phi.g[0] * length.H, sum.hessian);
    }
    sum.gradient += p[k_cable] * phi.g[0] * along;
    sum.hessian += p[k_cable] * phi.H(0, 0) * along * along.transpose();
    for (Eigen::Index c = 0; c < columns; ++c) {
      const int index = free[static_cast<size_t>(c)];
      if (index == k_cable) sum.mixed.col(c) += phi.g[0] * along;
      if (index == slack) sum.mixed.col(c) -= p[k_cable] * phi.H(0, 0) * along;
      if (index == cable.retraction) sum.mixed.col(c) += p[k_cable] * phi.H(0, 0) * along;
    }
  }

  const double lip_stiffness = lips.empty() ? 0.0 : stiffness_of_lips(p);
  for (const LipCorner& lip : lips) {
    const std::array<int, 2> pair{lip.corner.body, lip.face.body};
    const double distance = gap<double>(lip, x);
    const Jet<1> phi = one_sided(-distance, lip_smoothing);
    if (phi.g[0] == 0) continue;
    const Jet<6> open = gap<Jet<6>>(lip, x);
    const Eigen::Matrix<double, 6, 1> push = -lip_stiffness * phi.g[0] * open.g;
    sum.energy += lip_stiffness * phi.v;
    add_gradient(pair, push, sum.gradient);
    add_hessian(pair, lip_stiffness * (phi.H(0, 0) * open.g * open.g.transpose() - phi.g[0] * open.H), sum.hessian);
    if (E_plastic >= 0) add_mixed(pair, E_plastic, push / p[E_plastic]);
    add_mixed(pair, thickness, push / t);
  }

  for (const ChainLoad& load : loads) {
    const std::array<int, 2> pair{load.at.body, -1};
    const std::array<Jet<6>, 2> at = place<Jet<6>>(load.at, x, 0);
    const Jet<6> way = load.direction.x() * at[0] + load.direction.y() * at[1];
    const double newtons = force(load, p);
    sum.energy -= newtons * (way.v - load.direction.dot(load.at.rest));
    add_gradient(pair, -newtons * way.g, sum.gradient);
    add_hessian(pair, -newtons * way.H, sum.hessian);
    add_mixed(pair, load.value, -(load.times < 0 ? 1.0 : p[load.times]) * way.g);
    if (load.times >= 0) add_mixed(pair, load.times, -p[load.value] * way.g);
  }
  return sum;
}

/// Newton's method with a line search, from `x` on. Returns what went wrong, "" for a minimum.
std::string BeamProtocol::Chain::solve(Eigen::VectorXd& x, const Params& p, int& factorisations) const {
  constexpr double negligible = 1e-11;  // [m]; angles times a span's length
  const double size = spans.front().length;
  Eigen::VectorXd unit = Eigen::VectorXd::Ones(x.size());
  for (Eigen::Index i = 2; i < x.size(); i += 3) unit[i] = size;
  for (int iteration = 0; iteration < 100; ++iteration) {
    const Sum sum = assemble(x, p, {});
    ++factorisations;
    const Eigen::LLT<Eigen::MatrixXd> factor(sum.hessian);
    const bool convex = factor.info() == Eigen::Success;
    Eigen::VectorXd step;
    if (convex) {
      step = -factor.solve(sum.gradient);
    } else {
      // Downhill all the same: curvatures by their size.
      const Eigen::MatrixXd scaled = unit.cwiseInverse().asDiagonal() * sum.hessian * unit.cwiseInverse().asDiagonal();
      const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> modes(scaled);
      const Eigen::VectorXd curvatures =
          modes.eigenvalues().cwiseAbs().cwiseMax(1e-9 * modes.eigenvalues().cwiseAbs().maxCoeff());
      const Eigen::VectorXd downhill = unit.cwiseInverse().asDiagonal() * sum.gradient;
      step = -(unit.cwiseInverse().asDiagonal() *
               (modes.eigenvectors() * (modes.eigenvectors().transpose() * downhill).cwiseQuotient(curvatures)).eval());
    }
    if (!step.allFinite()) return "the energy is not finite";
    const double length = step.cwiseProduct(unit).cwiseAbs().maxCoeff();
    if (length < negligible) {
      x += step;
      return convex ? "" : "the equilibrium is not stable";
    }
    const double slope = sum.gradient.dot(step);
    double fraction = std::min(1.0, 0.5 * size / length);
    // Below a tenth of a micrometre energies differ by rounding.
    const auto accepted = [&] {
      const double reached = energy(x + fraction * step, p);
      return std::isfinite(reached) && (reached <= sum.energy + 1e-4 * fraction * slope || fraction * length < 1e-8);
    };
    while (!accepted() && fraction > 1e-12) fraction *= 0.5;
    x += fraction * step;
  }
  return "Newton's method does not converge";
}

/// From the equilibrium at `from` to the one at `to`; where that fails, by smaller changes.
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
      continue;
    }
    step *= 0.5;
    if (step < 1.0 / 64) return problem;
  }
  return "";
}

/// See BeamProtocol::stated_error().
double BeamProtocol::Chain::stated_error(const Eigen::VectorXd& x, const Params& p) const {
  std::map<int, std::array<bool, 2>> closed;  // cell to its sides
  for (const LipCorner& lip : lips) {
    if (gap<double>(lip, x) < 0) closed[lip.cell][lip.side > 0 ? 0 : 1] = true;
  }
  for (const auto& [cell, sides] : closed) {
    if (sides[0] && sides[1]) return infinity;
  }
  const Span& first = spans.front();
  if (first.bonded < 2) {
    const double turned = x[x.size() - 1], length = first.length * static_cast<double>(spans.size());
    if (length < first.height || p[nu] > 0.45) return infinity;
    return 0.01 + 0.15 * first.height / length * turned * turned;
  }
  const double slenderness = first.length / first.height, poisson = p[nu];
  if (slenderness < 0.2 || slenderness > 1 || poisson > 0.45) return infinity;
  // What bonding can add to the modulus, M/E' - 1.
  const double excess = poisson * poisson / (plane_stress ? 1 - poisson * poisson : 1 - 2 * poisson);
  double compression = 0;
  for (const Span& span : spans) compression = std::max(compression, -deformation<double>(span, x)[0] / span.length);
  return 0.02 + 0.04 * excess + (0.15 + 0.5 * slenderness * slenderness) * compression +
         2 * std::max(0.0, compression - 0.25) + (E_plastic < 0 ? 0.0 : 150 * p[E] / p[E_plastic]);
}

BeamProtocol::BeamProtocol(std::unique_ptr<const Chain> chain)
    : chain_(std::move(chain)), errors_(chain_->rows.size(), not_a_number) {}
BeamProtocol::~BeamProtocol() = default;
const ParameterTable& BeamProtocol::parameters() const {
  return chain_->table;
}
const Params& BeamProtocol::nominal() const {
  return chain_->nominal;
}
int BeamProtocol::row_count() const {
  return static_cast<int>(chain_->rows.size());
}
int BeamProtocol::unknowns() const {
  return 3 * chain_->bodies;
}

Prediction BeamProtocol::predict(const Params& p, const std::vector<int>& free) {
  const Chain& chain = *chain_;
  const Eigen::Index count = row_count(), columns = static_cast<Eigen::Index>(free.size());
  Prediction prediction;
  prediction.values = Eigen::VectorXd::Constant(count, not_a_number);
  if (columns > 0) prediction.derivatives = Eigen::MatrixXd::Constant(count, columns, not_a_number);
  std::fill(errors_.begin(), errors_.end(), not_a_number);

  struct State {
    std::string problem;
    Eigen::VectorXd x;
    Eigen::MatrixXd dx;  ///< sensitivities
    Params p;
  };
  const auto with_controls = [&](const std::vector<double>& controls) {
    Params q = p;
    for (size_t k = 0; k < controls.size(); ++k) q[chain.controls[k]] = controls[k];
    return q;
  };
  const auto reached = [&](State state, const Params& target) {
    if (!state.problem.empty()) return state;
    state.problem = chain.solve_in_steps(state.x, state.p, target, factorisations_);
    state.p = target;
    if (state.problem.empty() && columns > 0) {
      const Sum sum = chain.assemble(state.x, target, free);
      ++factorisations_;
      state.dx = -sum.hessian.llt().solve(sum.mixed);
    }
    return state;
  };
  // The reading of a channel and its derivatives.
  const auto read = [&](const State& state, int channel) {
    const ChainChannel& reading = chain.channels[static_cast<size_t>(channel)];
    const auto at = chain.place<Jet<6>>(reading.at, state.x, 0);
    const Jet<6> y = reading.direction.x() * at[0] + reading.direction.y() * at[1];
    Eigen::RowVectorXd slopes(columns);
    if (columns > 0) slopes = y.g.head<3>().transpose() * state.dx.middleRows(3 * reading.at.body, 3);
    return std::pair{y.v - reading.direction.dot(reading.at.rest), slopes};
  };

  // Retractions first, each from rest; then loads from small to large, each from the last one's equilibrium.
  const auto before_loads = [&](std::vector<double> controls) {
    for (size_t k = 0; k < controls.size(); ++k) {
      if (std::find(chain.set_first.begin(), chain.set_first.end(), static_cast<int>(k)) == chain.set_first.end())
        controls[k] = 0;
    }
    return controls;
  };
  const auto size_of = [](const std::vector<double>& controls) {
    double sum = 0;
    for (double value : controls) sum += std::abs(value);
    return sum;
  };
  std::map<std::vector<double>, std::map<std::pair<double, std::vector<double>>, std::vector<Eigen::Index>>> paths;
  for (Eigen::Index r = 0; r < count; ++r) {
    const std::vector<double>& controls = chain.rows[static_cast<size_t>(r)].controls;
    paths[before_loads(controls)][{size_of(controls), controls}].push_back(r);
  }
  for (const auto& [first, loaded] : paths) {
    Params rest = with_controls(std::vector<double>(chain.controls.size(), 0.0));
    State state{"", Eigen::VectorXd::Zero(unknowns()), {}, rest};
    const State unloaded = state = reached(state, with_controls(first));
    for (const auto& [key, rows] : loaded) {
      state = reached(state, with_controls(key.second));
      if (!state.problem.empty()) {
        std::string where;
        for (size_t k = 0; k < chain.controls.size(); ++k) {
          const ParameterSpec& spec = chain.table[chain.controls[k]];
          where += fmt::format("{}{} = {}", k == 0 ? "" : ", ", spec.id, with_unit(key.second[k], spec.unit));
        }
        prediction.failures.push_back(fmt::format("no equilibrium of the beams at {}: {}", where, state.problem));
        continue;
      }
      for (Eigen::Index r : rows) {
        const StaticRow& row = chain.rows[static_cast<size_t>(r)];
        auto [value, slopes] = read(state, row.channel);
        double& error = errors_[static_cast<size_t>(r)];
        error = chain.stated_error(state.x, state.p);
        if (chain.from_unloaded) {
          error = std::max(error, chain.stated_error(unloaded.x, unloaded.p));
          const auto [value_before, slopes_before] = read(unloaded, row.channel);
          value -= value_before;
          slopes -= slopes_before;
        }
        if (row.offset >= 0) value += p[row.offset];
        prediction.values[r] = value;
        if (columns > 0) prediction.derivatives.row(r) = slopes;
        for (Eigen::Index c = 0; c < columns; ++c) {
          if (free[static_cast<size_t>(c)] == row.offset) prediction.derivatives(r, c) += 1;
        }
      }
    }
  }
  return prediction;
}

namespace {

constexpr const char* remedy = "; model = \"full\" takes the rest";

[[noreturn]] void refuse(const Experiment& experiment, const std::string& part, const std::string& what) {
  throw InputError(fmt::format("{}: {}: {}{}", experiment.path, part, what, remedy));
}

/// Everything that no chain of beams has, whatever its geometry.
void check(const Experiment& experiment) {
  const GeometrySettings& geometry = experiment.geometry;
  const bool module = geometry.kind == "push_puppet";
  if (!module && geometry.kind != "rectangle") {
    refuse(experiment, "[geometry]",
           fmt::format("a chain of beams is made from a push_puppet or a rectangle, not from '{}'", geometry.kind));
  }
  if (module && geometry.puppet.stud_length > 0)
    refuse(experiment, "[geometry]", "a chain of beams has lips without studs; set stud_length = \"0 mm\"");
  if (experiment.recordings)
    refuse(experiment, "[bench]", "a chain of beams has no inertia and takes readings at rest");
  if (!experiment.gravity_direction.empty())
    refuse(experiment, "[gravity]", "a chain of beams has no self-weight; leave its direction out");
  const std::string soft = module ? "foam" : geometry.region;
  for (const MaterialSettings& material : experiment.materials) {
    if (material.region == soft && material.law != "neo_hookean") {
      refuse(experiment, fmt::format("[materials.{}]", soft),
             fmt::format("the fibres of a chain of beams are neo_hookean, not {}", material.law));
    }
  }
  if (!experiment.contact.obstacles.empty() || !experiment.contact.grounds.empty())
    refuse(experiment, "[contact]", "a chain of beams meets no obstacles or grounds");
  if (!module && experiment.contact.on)
    refuse(experiment, "[contact]", "a beam does not touch itself; leave [contact] out");
  if (!module && !experiment.cables.cables.empty())
    refuse(experiment, "[cables]", "only a push_puppet's chain of beams has cables");
}

/// Names of the clamped and of the loaded face.
std::pair<std::string, std::string> faces_of(const Experiment& experiment) {
  const bool module = experiment.geometry.kind == "push_puppet";
  const std::map<std::string, std::string> opposite =
      module
          ? std::map<std::string, std::string>{{"base", "tip"}}
          : std::map<std::string, std::string>{{"xmin", "xmax"}, {"xmax", "xmin"}, {"ymin", "ymax"}, {"ymax", "ymin"}};
  const SupportSettings& support = experiment.supports.front();
  const auto found = opposite.find(support.on);
  std::vector<int> fixed = support.fix;
  std::sort(fixed.begin(), fixed.end());
  if (experiment.supports.size() != 1 || found == opposite.end() || fixed != std::vector<int>{0, 1} ||
      !support.control.empty() || support.rotation_stiffness) {
    refuse(experiment, "[[support]]",
           fmt::format("a chain of beams has one support, {}, with fix = [\"x\", \"y\"]",
                       module ? "'base'" : "one of xmin, xmax, ymin, ymax"));
  }
  return *found;
}

/// The chain lies along x, from x = 0: where it starts in the experiment's frame, and which way it goes.
struct ChainFrame {
  Eigen::Vector2d origin = Eigen::Vector2d::Zero(), along = Eigen::Vector2d::UnitX();
  Eigen::Vector2d direction(const Eigen::Vector2d& v) const {
    return {along.dot(v), along.x() * v.y() - along.y() * v.x()};
  }
  Eigen::Vector2d point(const Eigen::Vector2d& v) const { return direction(v - origin); }
};

/// Six bodies without thickness, the last one the loaded face.
ChainFrame build_beam(const Experiment& experiment, const std::string& clamped, BeamProtocol::Chain& chain) {
  const GeometrySettings& geometry = experiment.geometry;
  const bool along_x = clamped[0] == 'x', forwards = clamped.substr(1) == "min";
  const double length = geometry.size[along_x ? 0 : 1], height = geometry.size[along_x ? 1 : 0];
  ChainFrame frame;
  frame.along = (forwards ? 1.0 : -1.0) * (along_x ? Eigen::Vector2d::UnitX() : Eigen::Vector2d::UnitY());
  const Eigen::Vector2d middle(geometry.origin[0] + 0.5 * geometry.size[0],
                               geometry.origin[1] + 0.5 * geometry.size[1]);
  frame.origin = middle - 0.5 * length * frame.along;
  chain.bodies = 6;
  for (int i = 0; i < chain.bodies; ++i) {
    const Eigen::Vector2d left(i * length / chain.bodies, 0), right((i + 1) * length / chain.bodies, 0);
    chain.centres.push_back(right);
    chain.spans.push_back({{i - 1, left}, {i, right}, length / chain.bodies, height, i == 0 ? 1 : 0});
  }
  return frame;
}

/// Webs and tip plate; the base plate is fixed.
ChainFrame build_module(const Experiment& experiment, const BenchModel& model, BeamProtocol::Chain& chain) {
  const PushPuppet& m = experiment.geometry.puppet;
  const double pitch = m.cell_length + m.web_thickness, gap = m.gap_total / m.cells;
  const double lip_length = 0.5 * (m.cell_length - gap), low = 0.5 * m.core_height + m.clearance;
  const double tip = m.cells * pitch - m.web_thickness + m.plate_thickness;
  chain.bodies = m.cells;
  for (int i = 0; i < m.cells; ++i) {
    const double left = i * pitch, right = left + m.cell_length;
    chain.centres.push_back({i + 1 == m.cells ? tip : right, 0});
    chain.spans.push_back({{i - 1, {left, 0}}, {i, {right, 0}}, m.cell_length, m.core_height, 2});
    if (!experiment.contact.on) continue;
    for (int side : {1, -1}) {
      for (double y : {low + m.lip_relief, low + m.lip_thickness - m.lip_relief}) {
        const BodyPoint corner{i - 1, {left + lip_length, side * y}};
        chain.lips.push_back({i, side, corner, {i, {right - lip_length, side * y}}});
      }
    }
  }
  // Two lips in a row as bars, with two corners each.
  chain.lip_shape = 0.5 * (m.lip_thickness - 2 * m.lip_relief) / (2 * lip_length);
  for (size_t c = 0; c < model.cables.size(); ++c) {
    const CableSettings& settings = experiment.cables.cables[c];
    bool own = false;
    for (int side : {1, -1}) {
      const std::vector<Eigen::Vector2d> path = cable_path(m, side);
      own = own || std::equal(path.begin(), path.end(), settings.points.begin(), settings.points.end(),
                              [&](const Eigen::Vector2d& a, const std::vector<double>& b) {
                                return (a - Eigen::Vector2d(b[0], b[1])).norm() < 1e-9;
                              });
    }
    if (!own) {
      refuse(experiment, fmt::format("cable '{}'", settings.id),
             "a chain of beams has the module's own cables, 'upper' and 'lower' without points of their own");
    }
    ChainCable cable;
    cable.retraction = model.cables[c].retraction;
    cable.smoothing = model.cables[c].smoothing;
    for (int i = 0; i < m.cells; ++i) {
      const auto point = [&](int k) {
        const std::vector<double>& at = settings.points[static_cast<size_t>(k)];
        return Eigen::Vector2d(at[0], at[1]);
      };
      cable.free_lengths.push_back({BodyPoint{i - 1, point(2 * i + 1)}, BodyPoint{i, point(2 * i + 2)}});
    }
    chain.cables.push_back(std::move(cable));
  }
  return {};
}

/// Where a load or a channel sits: the middle of the loaded face, or one of the face's points.
BodyPoint seat(const Experiment& experiment, const std::string& part, const std::string& on,
               const std::vector<double>& point, const std::string& face, const ChainFrame& frame,
               const BeamProtocol::Chain& chain) {
  const BodyPoint middle{chain.bodies - 1, chain.centres.back()};
  if (on == face) return middle;
  if (on.empty()) {
    const BodyPoint at{middle.body, frame.point({point[0], point[1]})};
    const Eigen::Vector2d off = at.rest - middle.rest;
    if (std::abs(off.x()) < 1e-9 && std::abs(off.y()) <= 0.5 * chain.spans.back().height + 1e-9) return at;
  }
  refuse(experiment, part, fmt::format("on a chain of beams it stands on '{}' or at a point of that face", face));
}

}  // namespace

BeamBench make_beam_bench(const Experiment& experiment, const Trials& trials) {
  check(experiment);
  const auto [clamped, loaded] = faces_of(experiment);
  // Parameters, controls and offsets are those of the full model, on the coarsest mesh that has them all.
  Experiment full = experiment;
  full.model = Rung::full;
  MeshSettings coarse;
  coarse.order = 1;
  coarse.cells = {1, 1};
  coarse.size = experiment.geometry.puppet.cell_length;
  BenchModel model = make_model(full, coarse, trials);

  auto chain = std::make_unique<BeamProtocol::Chain>();
  chain->table = model.scene.model->parameters();
  chain->nominal = model.scene.values;
  BenchRows rows = rows_of_readings(experiment, model, trials);
  chain->rows = std::move(rows.rows);
  chain->controls = model.controls;
  chain->from_unloaded = experiment.from_unloaded;
  for (size_t k = 0; k < experiment.bench.controls.size(); ++k) {
    if (experiment.cables.columns.count(experiment.bench.controls[k].id) > 0)
      chain->set_first.push_back(static_cast<int>(k));
  }
  const bool module = experiment.geometry.kind == "push_puppet";
  const auto index = [&](const std::string& id) { return chain->table.contains(id) ? chain->table.index(id) : -1; };
  const std::string soft = module ? "foam" : experiment.geometry.region;
  chain->E = index("E_" + soft);
  chain->nu = index("nu_" + soft);
  chain->thickness = index("thickness");
  chain->E_plastic = index("E_plastic");
  chain->k_cable = index("k_cable");
  chain->slack = index("slack");
  chain->plane_stress = experiment.geometry.plane == Plane::stress;
  const ChainFrame frame = module ? build_module(experiment, model, *chain) : build_beam(experiment, clamped, *chain);

  for (const LoadSettings& load : experiment.loads) {
    const std::string part = fmt::format("[[load]] '{}'", load.id);
    if (load.quantity != Quantity::force && load.quantity != Quantity::mass)
      refuse(experiment, part, "a chain of beams carries forces and hung masses");
    ChainLoad one;
    one.at = seat(experiment, part, load.on, load.point, loaded, frame, *chain);
    one.direction = frame.direction(Eigen::Vector2d(load.direction[0], load.direction[1]).normalized());
    one.value = index(load.id);
    if (load.quantity == Quantity::mass) one.times = index("g");
    chain->loads.push_back(one);
  }
  for (const ChannelSettings& channel : experiment.channels) {
    const std::string part = fmt::format("[[channel]] '{}'", channel.id);
    if (!channel.standoff.empty()) refuse(experiment, part, "a chain of beams carries no markers");
    chain->channels.push_back(
        {seat(experiment, part, channel.on, channel.point, loaded, frame, *chain),
         frame.direction(Eigen::Vector2d(channel.direction[0], channel.direction[1]).normalized())});
  }
  BeamBench bench;
  bench.protocol = std::make_unique<BeamProtocol>(std::move(chain));
  bench.row_of_reading = std::move(rows.row_of_reading);
  bench.measurements = std::move(rows.measurements);
  return bench;
}

std::vector<FreeParameter> start_by_beams(const Experiment& experiment, const Trials& trials,
                                          std::vector<FreeParameter> free) {
  if (experiment.mesh.depth_cells > 0) return free;  // a solid's parameters are other ones
  try {
    const BeamBench bench = make_beam_bench(experiment, trials);
    Params p = bench.protocol->nominal();
    for (const FreeParameter& parameter : free) p[parameter.index] = parameter.start;
    const Prediction prediction = bench.protocol->predict(p, {});
    std::vector<Measurement> measurements;
    for (Measurement m : bench.measurements) {
      const double error = bench.protocol->stated_error(m.row);
      if (!std::isfinite(error)) continue;
      m.sigma = std::hypot(m.sigma, error * prediction.values[m.row]);
      measurements.push_back(m);
    }
    if (measurements.size() < free.size()) return free;
    FitOptions options;
    options.profiles = false;
    options.tolerance = 1e-3;
    options.stop = experiment.equilibrium.stop;
    const FitResult rough = fit(*bench.protocol, measurements, free, options);
    for (size_t j = 0; j < free.size() && rough.status == FitStatus::converged; ++j) {
      const ParameterEstimate& estimate = rough.parameters[j];
      if (estimate.verdict == Verdict::well_determined || estimate.verdict == Verdict::weakly_determined)
        free[j].start = estimate.value;
    }
  } catch (const InputError&) {  // not a case for beams
  }
  return free;
}

}  // namespace taut
