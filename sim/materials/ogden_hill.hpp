#pragma once
#include <array>
#include <cmath>
#include <limits>
#include <string_view>

#include "sim/core/parameters.hpp"
#include "sim/materials/tensor.hpp"

namespace taut {

/// The entire functions phi_k(x) = sum_n x^n / (n + k)!: phi_1 = (e^x - 1)/x, phi_(k+1) = (phi_k - 1/k!)/x, without the
/// cancellation of these at small x.
template <int k, class T>
T exponential_remainder(const T& x) {
  using std::expm1;
  constexpr double factorial = k == 1 ? 1 : k == 2 ? 2 : 6;
  static_assert(k >= 1 && k <= 3);
  if (x < 0.5 && x > -0.5) {
    T sum(1.0);  // Horner form; what sixteen terms leave is less than 1e-18
    for (int n = 16; n >= 1; --n) sum = 1.0 + x * sum / static_cast<double>(n + k);
    return sum / factorial;
  }
  if constexpr (k == 1) {
    return expm1(x) / x;
  } else {
    return (exponential_remainder<k - 1>(x) - k / factorial) / x;
  }
}

/// Eigenvalues and vectors of a symmetric matrix by Jacobi's rotations, which differentiable scalars survive.
/// `diagonal` = vectors^T A vectors is diagonal up to rounding in its values; derivatives beside the diagonal may be
/// left, because the eigenvectors of equal eigenvalues have none.
template <class T, int D>
struct PrincipalAxes {
  Tensor<T, D> diagonal, vectors;

  /// Of a symmetric A.
  explicit PrincipalAxes(const Tensor<T, D>& A) : diagonal(A), vectors(Tensor<T, D>::Identity()) {
    using std::abs;
    using std::hypot;
    for (int sweep = 0; sweep < 12; ++sweep) {
      T all(0.0), beside(0.0);
      for (int p = 0; p < D; ++p) {
        all += abs(diagonal(p, p));
        for (int q = p + 1; q < D; ++q) beside += abs(diagonal(p, q));
      }
      if (!(beside > 1e-17 * all)) return;
      for (int p = 0; p < D; ++p) {
        for (int q = p + 1; q < D; ++q) {
          const T a = diagonal(p, q);
          if (a == 0.0) continue;
          const T difference = diagonal(q, q) - diagonal(p, p), root = hypot(difference, T(2.0 * a));
          const T t = difference < 0.0 ? T(2.0 * a / (difference - root)) : T(2.0 * a / (difference + root));
          turn(p, q, t);
          diagonal(p, p) -= t * a;
          diagonal(q, q) += t * a;
          diagonal(p, q) = diagonal(q, p) = T(0.0);
        }
      }
    }
  }

 private:
  void turn(int p, int q, const T& t) {
    using std::sqrt;
    const T c = 1.0 / sqrt(1.0 + t * t), s = t * c;
    for (int i = 0; i < D; ++i) {
      const T vp = vectors(i, p), vq = vectors(i, q);
      vectors(i, p) = c * vp - s * vq;
      vectors(i, q) = s * vp + c * vq;
      if (i == p || i == q) continue;
      const T ap = diagonal(i, p), aq = diagonal(i, q);
      diagonal(i, p) = diagonal(p, i) = c * ap - s * aq;
      diagonal(i, q) = diagonal(q, i) = s * ap + c * aq;
    }
  }
};

/// Highly compressible solid with one Ogden-Hill ("hyperfoam") term:
///
///   Psi = 2 mu / alpha^2 ( s1^alpha + s2^alpha + s3^alpha - 3 + (J^(-alpha beta) - 1) / beta )   [J/m^3],
///   mu = E / (2 (1 + nu)),   beta = nu / (1 - 2 nu),   s the principal stretches, J = s1 s2 s3,
///
/// and -alpha ln J for the last term when nu = 0. At small strain it is Hooke's law with the same E and nu. The
/// exponent shapes the rest: alpha = 2 with nu = 0 is the neo-Hookean solid; a larger one softens compression towards
/// the plateau of a foam and stiffens tension (without lateral strain the nominal stress is (2 mu/alpha)(s^(alpha - 1)
/// - 1/s), which rises with s for every alpha > 1). Source: R. Hill, Adv. Appl. Mech. 18 (1978); B. Storakers, J. Mech.
/// Phys. Solids 34 (1986).
///
/// D = 3 is the solid, D = 2 the same solid in plane strain. All functions take the displacement gradient H = F - I.
/// With l = ln s, L = ln J and phi_k as in exponential_remainder() the energy is a sum without cancellation,
///
///   Psi = 2 mu ( sum_i l_i^2 phi_2(alpha l_i) + beta L^2 phi_2(-alpha beta L) ),
///
/// so rounding is relative to the strain, and nu = 0 is no special case. Valid for J > 0, energy +inf otherwise. nu
/// ends at 0.4: J^(-alpha beta) overflows beyond in strong compression, and a foam is not nearly incompressible.
template <class T = double>
struct OgdenHill {
  static constexpr std::string_view id = "ogden_hill";
  static constexpr std::string_view summary = "one-term Ogden-Hill (hyperfoam) solid for foams";
  /// Its constants with their bounds.
  static std::array<ParameterSpec, 3> parameters() {
    return {{{"E", "E", "Pa", 1.0, 1e13, "Young's modulus", true},
             {"nu", "nu", "1", 0.0, 0.4, "Poisson's ratio"},
             {"alpha", "alpha", "1", 1.1, 40.0, "exponent of the stretches"}}};
  }

  T alpha{2}, beta{0};
  /// The energy is w Psi_1 + w_beta dPsi_1/dbeta + w_alpha dPsi_1/dalpha with Psi_1 that of 2 mu = 1. The material
  /// itself has w = 2 mu [Pa] and no other part; its parameter derivatives have.
  T weight{0}, weight_of_beta{0}, weight_of_alpha{0};

  OgdenHill() = default;
  /// From {E [Pa], nu, alpha}.
  explicit OgdenHill(const std::array<T, 3>& theta) {
    const auto& [E, nu, exponent] = theta;
    alpha = exponent;
    beta = nu / (1.0 - 2.0 * nu);
    weight = E / (1.0 + nu);
  }

  /// dPsi/dtheta_j: energy() and stress() are derivatives of those of the material; there is no tangent of it.
  static OgdenHill derivative(const std::array<T, 3>& theta, int j) {
    const auto& [E, nu, exponent] = theta;
    OgdenHill d(theta);
    const T w = d.weight, b = 1.0 - 2.0 * nu;
    d.weight = j == 0 ? T(w / E) : j == 1 ? T(-w / (1.0 + nu)) : T(0.0);
    if (j == 1) d.weight_of_beta = w / (b * b);
    if (j == 2) d.weight_of_alpha = w;
    return d;
  }

  /// The volume change cannot be averaged apart from the rest: the form lambda/2 (ln J)^2 is not part of this law.
  static constexpr bool splits_volume = false;

  /// Psi [J/m^3], +inf for J <= 0.
  template <int D>
  T energy(const Tensor<T, D>& H) const {
    const T j = jacobian_minus_one(H);
    if (!(j > -1.0)) return T(std::numeric_limits<double>::infinity());
    const State<D> at(H);
    const T y = -alpha * beta * at.ln_j;
    T sum = weight * beta * at.ln_j * at.ln_j * exponential_remainder<2>(y);
    for (const T& l : at.ln_s) sum += weight * l * l * exponential_remainder<2>(T(alpha * l));
    if (weight_of_beta != 0.0)
      sum += weight_of_beta * at.ln_j * at.ln_j * (exponential_remainder<1>(y) - exponential_remainder<2>(y));
    if (weight_of_alpha != 0.0) {
      const T b = beta * at.ln_j;
      sum -= weight_of_alpha * b * b * at.ln_j * slope_of_second(y);
      for (const T& l : at.ln_s) sum += weight_of_alpha * l * l * l * slope_of_second(T(alpha * l));
    }
    return sum;
  }

  /// First Piola-Kirchhoff stress P = F S [Pa], S = sum_i tau_i / s_i^2 N_i N_i^T, with the principal Kirchhoff
  /// stresses tau_i = (2 mu/alpha)(s_i^alpha - J^(-alpha beta)).
  template <int D>
  Tensor<T, D> stress(const Tensor<T, D>& H) const {
    const State<D> at(H);
    const Tensor<T, D> S = second_stress(at);
    return S + H * S;
  }

  /// dP/dF as a D^2 x D^2 symmetric matrix [Pa], row and column index i + D * J of P_iJ (column-major vec).
  template <int D>
  Tangent<T, D> tangent(const Tensor<T, D>& H) const {
    using std::exp;
    using Vector = Eigen::Matrix<T, D * D, 1>;
    const State<D> at(H);
    const Tensor<T, D> S = second_stress(at), FV = at.vectors + H * at.vectors;
    // dP = dF S + F dS; `plane(a, b)` is vec(F N_a N_b^T).
    const auto plane = [&](int a, int b) {
      Vector v;
      for (int J = 0; J < D; ++J) {
        for (int i = 0; i < D; ++i) v[i + D * J] = FV(i, a) * at.vectors(J, b);
      }
      return v;
    };
    Tangent<T, D> A = Tangent<T, D>::Zero();
    for (int L = 0; L < D; ++L) {
      for (int J = 0; J < D; ++J) {
        for (int i = 0; i < D; ++i) A(i + D * J, i + D * L) = S(J, L);
      }
    }
    const T volume = weight * beta * exp(-alpha * beta * at.ln_j);
    for (int a = 0; a < D; ++a) {
      const T la = at.ln_s[static_cast<size_t>(a)];
      const Vector va = plane(a, a);
      const T slope = weight * exp(alpha * la) + volume - 2.0 * kirchhoff(la, at.ln_j);
      A += (slope * exp(-4.0 * la)) * (va * va.transpose());
      for (int b = 0; b < a; ++b) {
        const T lb = at.ln_s[static_cast<size_t>(b)];
        const Vector vb = plane(b, b), shear = plane(a, b) + plane(b, a);
        A += (volume * exp(-2.0 * (la + lb))) * (va * vb.transpose() + vb * va.transpose());
        A += (0.5 * divided_difference(la, lb, at.ln_j)) * (shear * shear.transpose());
      }
    }
    return A;
  }

 private:
  /// Principal axes of Green's strain G, and logarithms of the stretches and of J.
  template <int D>
  struct State : PrincipalAxes<T, D> {
    std::array<T, D> ln_s;
    T ln_j;
    explicit State(const Tensor<T, D>& H) : PrincipalAxes<T, D>(green_strain<T, D>(H)) {
      using std::log1p;
      ln_j = log1p(jacobian_minus_one(H));
      T others = ln_j;
      int smallest = 0;
      for (int i = 1; i < D; ++i) {
        if (this->diagonal(i, i) < this->diagonal(smallest, smallest)) smallest = i;
      }
      for (int i = 0; i < D; ++i) {
        const bool flat = i == smallest && this->diagonal(i, i) < -0.45;
        if (!flat) others -= ln_s[static_cast<size_t>(i)] = 0.5 * log1p(2.0 * this->diagonal(i, i));
      }
      // Of a stretch near 0 the strain keeps no digits; J does.
      if (this->diagonal(smallest, smallest) < -0.45) ln_s[static_cast<size_t>(smallest)] = others;
    }
  };

  /// phi_2'(x) = sum_n (n + 1) x^n / (n + 3)!.
  static T slope_of_second(const T& x) { return exponential_remainder<2>(x) - 2.0 * exponential_remainder<3>(x); }

  T kirchhoff(const T& l, const T& ln_j) const {
    using std::exp;
    // Not as a difference of exponentials over alpha, whose derivative with respect to alpha would lose digits.
    const T y = -alpha * beta * ln_j, x = alpha * l;
    T tau = weight * (l * exponential_remainder<1>(x) + beta * ln_j * exponential_remainder<1>(y));
    if (weight_of_beta != 0.0) tau += weight_of_beta * ln_j * exp(y);
    if (weight_of_alpha != 0.0) {
      const T b = beta * ln_j;
      tau += weight_of_alpha * (l * l * (exponential_remainder<1>(x) - exponential_remainder<2>(x)) -
                                b * b * (exponential_remainder<1>(y) - exponential_remainder<2>(y)));
    }
    return tau;
  }

  /// (S_a - S_b) / (G_a - G_b) of principal second Piola-Kirchhoff stresses and Green's strains, and its limit for
  /// equal ones: differences of exponentials are hyperbolic sines of l_a - l_b.
  T divided_difference(const T& la, const T& lb, const T& ln_j) const {
    using std::exp;
    const T middle = 0.5 * (la + lb), difference = la - lb, y = -alpha * beta * ln_j;
    const T strain = exp(2.0 * middle) * sinh_over(difference);
    const T rising = (alpha - 2.0) * exp((alpha - 2.0) * middle) * sinh_over(T(0.5 * (alpha - 2.0) * difference));
    const T falling = 2.0 * exp(y - 2.0 * middle) * sinh_over(difference);
    return weight / alpha * (rising + falling) / strain;
  }
  static T sinh_over(const T& x) {
    using std::exp;
    return exp(-x) * exponential_remainder<1>(T(2.0 * x));
  }

  template <int D>
  Tensor<T, D> second_stress(const State<D>& at) const {
    using std::exp;
    Tensor<T, D> principal;
    for (int a = 0; a < D; ++a) {
      const T& la = at.ln_s[static_cast<size_t>(a)];
      principal(a, a) = kirchhoff(la, at.ln_j) * exp(-2.0 * la);
      // What the rotations left beside the diagonal counts to first order: it carries derivatives.
      for (int b = 0; b < a; ++b) {
        principal(a, b) = principal(b, a) =
            divided_difference(la, at.ln_s[static_cast<size_t>(b)], at.ln_j) * at.diagonal(a, b);
      }
    }
    return at.vectors * principal * at.vectors.transpose();
  }
};

}  // namespace taut
