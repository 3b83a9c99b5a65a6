#pragma once
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "sim/terms/inertia.hpp"
#include "sim/terms/region_term.hpp"

// Inertia and viscosity of elements of one shape; see make_inertia() and make_viscosity().
namespace taut {

/// v of an element's nodes: the rate of u within the step.
template <class Element>
typename Element::Local rate_of(const TimeStep& step, const Element& element, const Eigen::VectorXd& u) {
  typename Element::Local v = step.rate[0] * element.gather(u) + step.rate[1] * element.gather(step.previous);
  if (step.rate[2] != 0) v += step.rate[2] * element.gather(step.before);
  return v;
}

/// What a rate's derivative with respect to a state of the past is.
inline double rate_of(const TimeStep& step, History q) {
  return q == History::previous ? step.rate[1] : q == History::before ? step.rate[2] : 0.0;
}

/// Exact element mass matrix of unit density on a straight-sided simplex of unit measure, from
/// integral L^a L^b ... = d! prod(a_i!) / (d + sum a_i)!.
template <ElementShape S>
Eigen::Matrix<double, nodes_of(S), nodes_of(S)> unit_mass() {
  constexpr int D = dimension_of(S), N = nodes_of(S);
  // Each shape function is a sum of monomials in the barycentric coordinates: coefficient and powers.
  struct Monomial {
    double coefficient;
    std::array<int, D + 1> power;
  };
  std::array<std::vector<Monomial>, N> shape;
  const auto monomial = [](double coefficient, std::initializer_list<int> factors) {
    Monomial product{coefficient, {}};
    for (int k : factors) ++product.power[k];
    return product;
  };
  for (int a = 0; a <= D; ++a) {
    shape[a] = {monomial(1, {a})};
    if (order_of(S) == 2) shape[a] = {monomial(2, {a, a}), monomial(-1, {a})};
  }
  for (int e = D + 1; e < N; ++e) {
    const auto [i, j] = ReferenceElement<S>::edges[e - D - 1];
    shape[e] = {monomial(4, {i, j})};
  }
  auto factorial = [](int n) { return std::tgamma(n + 1.0); };
  Eigen::Matrix<double, N, N> M;
  for (int a = 0; a < N; ++a) {
    for (int b = 0; b < N; ++b) {
      double sum = 0;
      for (const Monomial& p : shape[a]) {
        for (const Monomial& q : shape[b]) {
          double product = factorial(D);
          int total = D;
          for (size_t k = 0; k <= D; ++k) {
            product *= factorial(p.power[k] + q.power[k]);
            total += p.power[k] + q.power[k];
          }
          sum += p.coefficient * q.coefficient * product / factorial(total);
        }
      }
      M(a, b) = sum;
    }
  }
  return M;
}

/// An element with its rest measure.
template <ElementShape S>
struct MassiveElement : ElementNodes<S> {
  using ElementNodes<S>::D;
  double measure;
  MassiveElement(const Mesh& mesh, int e) : ElementNodes<S>(mesh, e) {
    const auto X = ReferenceElement<S>::positions(mesh, e);
    Eigen::Matrix<double, D, D> edges;
    for (int i = 0; i < D; ++i) edges.col(i) = X.col(i + 1) - X.col(0);
    measure = edges.determinant() / (D == 2 ? 2.0 : 6.0);
  }
};

/// The inertia of elements of one shape.
template <ElementShape S>
class Inertia final : public RegionTerm<MassiveElement<S>> {
  using Element = MassiveElement<S>;
  static constexpr int D = dimension_of(S), N = nodes_of(S), DN = D * N;
  using Local = typename Element::Local;

 public:
  Inertia(const Mesh& mesh, const InertiaDefinition& definition)
      : RegionTerm<Element>(mesh, definition.region), definition_(definition), mass_(unit_mass<S>()) {
    if (definition.form == MassForm::lumped) {
      const Eigen::Matrix<double, N, 1> diagonal = mass_.diagonal();
      mass_ = (diagonal / diagonal.sum()).asDiagonal();
    }
  }

  void assemble(const Point& at, Assembly& out) const override {
    if (!at.moves()) return;
    const TimeStep& step = *at.step;
    const double rho = density(at.p), alpha = damping(at.p);
    for (size_t e = 0; e < elements_.size(); ++e) {
      const Element& element = elements_[e];
      const double m = rho * element.measure;
      const Local away = element.gather(at.u) - element.gather(step.reference);
      const Local v = alpha != 0 ? rate_of(step, element, at.u) : Local::Zero();
      const Local force = m * step.inertia * away * mass_, drag = m * alpha * v * mass_;
      out.add_energy(0.5 * force.cwiseProduct(away).sum());
      if (alpha != 0) out.add_energy(0.5 / step.rate[0] * drag.cwiseProduct(v).sum());
      if (out.gradient != nullptr) {
        const Local both = force + drag;
        out.add_gradient(element.nodes.data(), N, D, both.data());
      }
      if (out.wants_hessian()) {
        Eigen::Matrix<double, DN, DN> K = Eigen::Matrix<double, DN, DN>::Zero();
        const double factor = m * (step.inertia + alpha * step.rate[0]);
        for (int a = 0; a < N; ++a) {
          for (int b = 0; b < N; ++b) {
            for (int i = 0; i < D; ++i) K(a * D + i, b * D + i) = factor * mass_(a, b);
          }
        }
        out.add_hessian(static_cast<int>(e), element.nodes.data(), N, D, K.data());
      }
    }
  }

  bool depends_on(int index) const override {
    return index == definition_.density || index == definition_.thickness ||
           (index >= 0 && index == definition_.damping);
  }

  void add_parameter_gradient(const Point& at, int index, Eigen::VectorXd& out) const override {
    if (!at.moves()) return;
    const TimeStep& step = *at.step;
    const bool of_damping = index == definition_.damping;
    const double rho = density(at.p), alpha = damping(at.p);
    for (const Element& element : elements_) {
      Local source = rate_of(step, element, at.u);
      if (!of_damping) {
        const Local away = element.gather(at.u) - element.gather(step.reference);
        source = (step.inertia * away + alpha * source).eval();
      }
      element.scatter((of_damping ? rho : rho / at.p[index]) * element.measure * source * mass_, out);
    }
  }

  void add_history_product(const Point& at, History q, const Eigen::VectorXd& x, bool,
                           Eigen::VectorXd& out) const override {
    if (!at.moves()) return;
    const double alpha = damping(at.p);
    const double factor = q == History::reference ? -at.step->inertia : alpha * rate_of(*at.step, q);
    if (factor == 0) return;
    for (const Element& element : elements_)
      element.scatter(density(at.p) * element.measure * factor * element.gather(x) * mass_, out);
  }

  bool is_inertia() const override { return true; }

 private:
  using RegionTerm<Element>::elements_;
  double damping(const Params& p) const { return definition_.damping < 0 ? 0.0 : p[definition_.damping]; }
  double density(const Params& p) const {
    return p[definition_.density] * (definition_.thickness < 0 ? 1.0 : p[definition_.thickness]);
  }

  InertiaDefinition definition_;
  Eigen::Matrix<double, N, N> mass_;  ///< of unit density and measure
};

/// The viscosity of elements of one shape.
template <ElementShape S>
class Viscosity final : public RegionTerm<ElementGeometry<S>> {
  using Element = ElementGeometry<S>;
  static constexpr int D = dimension_of(S), N = nodes_of(S), DN = D * N;
  static constexpr size_t Q = Element::Q;
  using Local = typename Element::Local;
  using Square = Eigen::Matrix<double, D, D>;
  using Flat = Eigen::Matrix<double, DN, 1>;

 public:
  Viscosity(const Mesh& mesh, const ViscosityDefinition& definition)
      : RegionTerm<Element>(mesh, definition.region), definition_(definition) {}

  void assemble(const Point& at, Assembly& out) const override {
    if (!at.moves() || at.p[definition_.damping] == 0) return;
    const Constants c = constants(at.p);
    const double a0 = at.step->rate[0];
    for (size_t e = 0; e < elements_.size(); ++e) {
      const Element& element = elements_[e];
      const Rates rates = rates_of(element, at);
      const double energy = rates.energy(element, c) / a0;
      out.add_energy(std::isfinite(energy) ? energy : std::numeric_limits<double>::infinity());
      if (!std::isfinite(energy)) return;
      if (out.gradient != nullptr) {
        const Local force = force_of(element, rates, c);
        out.add_gradient(element.nodes.data(), N, D, force.data());
      }
      if (!out.wants_hessian()) continue;
      // d(force)/du = a0 B^T C0 B + the geometric part S : d2E/du2, which goes when only positive curvature is wanted.
      const bool exact = out.curvature == Curvature::exact;
      Eigen::Matrix<double, DN, DN> K = Eigen::Matrix<double, DN, DN>::Zero();
      for (size_t q = 0; q < Q; ++q) {
        const auto& G = element.gradient[q];
        const Square& F = rates.F[q];
        const Square stress = 2 * c.mu * rates.dE[q];
        const double w = element.weight[q], pressure = c.lambda * rates.volume;
        const Local FG = element.spread(F, q), VG = element.spread(volume_derivative(F), q);
        const Eigen::Matrix<double, N, N> GG = G.transpose() * G, GSG = G.transpose() * stress * G;
        const Square FF = F * F.transpose();
        for (int a = 0; a < N; ++a) {
          for (int b = 0; b < N; ++b) {
            // dE_a = sym(F^T e_i G_a^T):  2 mu dE_a : dE_b = mu ( (F F^T)_ij G_a.G_b + (F G_b)_i (F G_a)_j )
            Square block = w * a0 * c.mu * (GG(a, b) * FF + FG.col(b) * FG.col(a).transpose());
            if (exact) {
              block += w * GSG(a, b) * Square::Identity();
              block += (w * pressure) * (definition_.plane_stress ? Square(GG(a, b) * Square::Identity())
                                                                  : Square(-VG.col(b) * VG.col(a).transpose()));
            }
            K.template block<D, D>(a * D, b * D) += block;
          }
        }
      }
      const Local volume = volume_gradient(element, rates.F);
      const Eigen::Map<const Flat> v(volume.data());
      K += (a0 * c.lambda / measure_of(element)) * v * v.transpose();
      for (int row = 0; row < DN; ++row) {
        for (int column = 0; column <= row; ++column)
          K(row, column) = K(column, row) = 0.5 * (c.scale * K(row, column) + c.scale * K(column, row));
      }
      out.add_hessian(static_cast<int>(e), element.nodes.data(), N, D, K.data());
    }
  }

  bool depends_on(int index) const override {
    return index >= 0 && (index == definition_.youngs_modulus || index == definition_.poisson_ratio ||
                          index == definition_.damping || index == definition_.thickness);
  }

  void add_parameter_gradient(const Point& at, int index, Eigen::VectorXd& out) const override {
    if (!at.moves()) return;
    const Constants c = derivative(at.p, index);
    for (const Element& element : elements_) element.scatter(force_of(element, rates_of(element, at), c), out);
  }

  void add_history_product(const Point& at, History q, const Eigen::VectorXd& x, bool transposed,
                           Eigen::VectorXd& out) const override {
    if (!at.moves() || q == History::reference) return;
    const double factor = rate_of(*at.step, q);
    if (factor == 0) return;
    const Constants c = constants(at.p);
    const Eigen::VectorXd& past = q == History::previous ? at.step->previous : at.step->before;
    const Eigen::VectorXd& from = transposed ? at.u : past;  // G = B(u)^T C0 rate B(past)
    const Eigen::VectorXd& to = transposed ? past : at.u;
    for (const Element& element : elements_) {
      const Local u_from = element.gather(from), u_to = element.gather(to), dx = element.gather(x);
      Rates rates;
      std::array<Square, Q> there;
      for (size_t p = 0; p < Q; ++p) {
        const Square F = Square::Identity() + element.slope(u_from, p), dF = element.slope(dx, p);
        there[p] = F;
        rates.F[p] = Square::Identity() + element.slope(u_to, p);
        rates.dE[p] = 0.5 * factor * (F.transpose() * dF + dF.transpose() * F);
      }
      rates.volume = factor / measure_of(element) * volume_gradient(element, there).cwiseProduct(dx).sum();
      element.scatter(force_of(element, rates, c), out);
    }
  }

 private:
  using RegionTerm<Element>::elements_;
  static double measure_of(const Element& element) {
    double sum = 0;
    for (double w : element.weight) sum += w;
    return sum;
  }
  /// scale [s m] times (mu, lambda) [Pa]
  struct Constants {
    double scale, mu, lambda;
  };
  /// Deformation at the end, rate of strain, and the rate of the element's mean change of volume.
  struct Rates {
    std::array<Square, Q> F, dE;
    double volume = 0;
    double energy(const Element& element, const Constants& c) const {
      double sum = 0.5 * c.lambda * volume * volume * measure_of(element);
      for (size_t q = 0; q < Q; ++q) sum += element.weight[q] * c.mu * dE[q].squaredNorm();
      return c.scale * sum;
    }
  };

  /// Change of volume e(F): ln J, or in plane stress, where J is not that of the plane, tr E; and de/dF.
  double volume_of(const Square& H) const {
    if (definition_.plane_stress) return H.trace() + 0.5 * H.squaredNorm();
    return std::log((Square::Identity() + H).determinant());
  }
  Square volume_derivative(const Square& F) const {
    if (definition_.plane_stress) return F;
    return F.inverse().transpose();
  }
  /// d/du of the integral of e over an element.
  Local volume_gradient(const Element& element, const std::array<Square, Q>& F) const {
    Local gradient = Local::Zero();
    for (size_t q = 0; q < Q; ++q) gradient += element.spread(element.weight[q] * volume_derivative(F[q]), q);
    return gradient;
  }

  Constants constants(const Params& p) const {
    const double E = p[definition_.youngs_modulus], nu = p[definition_.poisson_ratio];
    const double t = definition_.thickness < 0 ? 1.0 : p[definition_.thickness];
    const double lambda = E * nu / ((1 + nu) * (definition_.plane_stress ? 1 - nu : 1 - 2 * nu));
    return {p[definition_.damping] * t, E / (2 * (1 + nu)), lambda};
  }
  Constants derivative(const Params& p, int index) const {
    Constants c = constants(p);
    if (index == definition_.poisson_ratio) {
      const double E = p[definition_.youngs_modulus], nu = p[definition_.poisson_ratio];
      const double m = definition_.plane_stress ? 1 : 2, below = (1 + nu) * (1 - m * nu);
      return {c.scale, -c.mu / (1 + nu), E * (below - nu * (1 - m - 2 * m * nu)) / (below * below)};
    }
    if (index == definition_.damping) c.scale = definition_.thickness < 0 ? 1.0 : p[definition_.thickness];
    if (index == definition_.thickness) c.scale = p[definition_.damping];
    if (index == definition_.youngs_modulus) c.scale /= p[index];
    return c;
  }

  /// sum of rate * E(state), with E = (H + H^T + H^T H) / 2; the linear part from the differences of states.
  Rates rates_of(const Element& element, const Point& at) const {
    const TimeStep& step = *at.step;
    const Local now = element.gather(at.u), previous = element.gather(step.previous);
    const bool two = step.rate[2] != 0;
    const Local before = two ? element.gather(step.before) : Local::Zero();
    const Local v = step.rate[0] * now + step.rate[1] * previous + step.rate[2] * before;
    Rates rates;
    for (size_t q = 0; q < Q; ++q) {
      const Square H = element.slope(now, q), P = element.slope(previous, q), V = element.slope(v, q),
                   B = two ? element.slope(before, q) : Square::Zero();
      rates.F[q] = Square::Identity() + H;
      // The rates sum to zero: products of states may be taken relative to the previous one.
      const Square dH = H - P;
      Square quadratic = step.rate[0] * (dH.transpose() * dH);
      if (two) {
        const Square dB = B - P;
        quadratic += step.rate[2] * (dB.transpose() * dB);
      }
      rates.volume += element.weight[q] * (step.rate[0] * volume_of(H) + step.rate[1] * volume_of(P) +
                                           (two ? step.rate[2] * volume_of(B) : 0.0));
      rates.dE[q] = 0.5 * (V + V.transpose() + P.transpose() * V + V.transpose() * P + quadratic);
    }
    rates.volume /= measure_of(element);
    return rates;
  }
  /// B(u)^T C0 dE, with the volume's part.
  Local force_of(const Element& element, const Rates& rates, const Constants& c) const {
    Local force = c.lambda * rates.volume * volume_gradient(element, rates.F);
    for (size_t q = 0; q < Q; ++q)
      force += element.spread((element.weight[q] * 2 * c.mu) * rates.F[q] * rates.dE[q], q);
    return c.scale * force;
  }

  ViscosityDefinition definition_;
};

}  // namespace taut
