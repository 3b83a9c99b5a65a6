#pragma once
#include <algorithm>
#include <cmath>

#include "sim/core/dense.hpp"
#include "sim/core/numbers.hpp"
#include "sim/materials/prony.hpp"
#include "sim/terms/region_term.hpp"
#include "sim/terms/solid.hpp"

namespace taut {

/// Adds the derivative of `pressure` F^-T at constant pressure: -pressure Finv_Jk Finv_Li.
template <int D>
void add_pressure_tangent(const Tensor<double, D>& inverse, double pressure, Tangent<double, D>& A) {
  for (int L = 0; L < D; ++L) {
    for (int k = 0; k < D; ++k) {
      for (int J = 0; J < D; ++J) {
        for (int i = 0; i < D; ++i) A(i + D * J, k + D * L) -= pressure * inverse(J, k) * inverse(L, i);
      }
    }
  }
}

/// The solid of elements of one shape; see make_solid().
template <ElementShape S>
class Solid final : public RegionTerm<ElementGeometry<S>> {
  using Geometry = ElementGeometry<S>;
  static constexpr int D = Geometry::D, N = Geometry::N, Q = Geometry::Q, DN = D * N, DD = D * D;
  using Local = typename Geometry::Local;
  using Stiffness = Eigen::Matrix<double, DN, DN, Eigen::RowMajor>;

 public:
  Solid(const Mesh& mesh, const SolidDefinition& definition)
      : RegionTerm<Geometry>(mesh, definition.region), law_(law_named(definition.law)), definition_(definition) {}

  bool depends_on(int index) const override {
    const auto& pairs = definition_.prony;
    return index == definition_.thickness || of_law(index) != definition_.parameters.end() ||
           std::any_of(pairs.begin(), pairs.end(), [&](const auto& pair) { return holds(pair, index); });
  }

  void assemble(const Point& at, Assembly& out) const override {
    const double t = thickness(at.p);
    const auto law = law_at(at.p);
    const Relaxation relaxation(at, definition_);
    for (size_t e = 0; e < elements_.size(); ++e) {
      const double energy = add_element(static_cast<int>(e), at.u, t, *law, relaxation, out);
      if (!std::isfinite(energy)) return out.add_energy(infinity);
      out.add_energy(energy);
    }
  }

  void add_parameter_gradient(const Point& at, int index, Eigen::VectorXd& out) const override {
    if (index == definition_.thickness) {
      Eigen::VectorXd gradient = Eigen::VectorXd::Zero(out.size());
      Assembly assembly;
      assembly.gradient = &gradient;
      assemble(at, assembly);
      out += gradient / thickness(at.p);
      return;
    }
    const auto position = of_law(index);
    if (position == definition_.parameters.end()) return add_relaxation_gradient(at, index, out);
    const int j = static_cast<int>(position - definition_.parameters.begin());
    const double t = Relaxation(at, definition_).left * thickness(at.p);
    const auto law = law_at(at.p);
    const double volumetric = averages() ? law->volumetric_modulus_derivative(j) : 0.0;
    for (const Geometry& element : elements_) {
      const Local u = element.gather(at.u);
      const double pressure = averages() ? volumetric * mean_dilatation(element, u) : 0.0;
      Local force = Local::Zero();
      for (size_t q = 0; q < Q; ++q) {
        const Tensor<double, D> H = element.slope(u, q);
        Tensor<double, D> P = law->stress_derivative(H, j);
        if (averages()) P += pressure * inverse_of<double, D>(H).transpose();
        force += element.spread(t * element.weight[q] * P, q);
      }
      element.scatter(force, out);
    }
  }

  int place_memory(int first) override {
    first_ = first;
    return static_cast<int>(elements_.size() * Q * block());
  }

  void remember(const Point& at, Eigen::VectorXd& next) const override {
    const Relaxation relaxation(at, definition_);
    if (relaxation.pairs.empty()) return;
    const auto law = law_at(at.p);
    each_point([&](const Geometry& element, size_t q, size_t place) {
      const Local u = element.gather(at.u);
      const Tensor<double, D> stress = law_stress(*law, element, u, q);
      const Tensor<double, D> rise = stress - memory_of(at.step->memory, place);
      memory_of(next, place) = stress;
      for (size_t i = 0; i < relaxation.pairs.size(); ++i) {
        const auto& [step, g, indices] = relaxation.pairs[i];
        memory_of(next, place, i + 1) = step.decay * memory_of(at.step->memory, place, i + 1) + g * step.gain * rise;
      }
    });
  }

  void add_memory_product(const Point& at, const Eigen::VectorXd& change, Eigen::VectorXd& out) const override {
    const Relaxation relaxation(at, definition_);
    if (relaxation.pairs.empty()) return;
    const double t = thickness(at.p);
    each_point([&](const Geometry& element, size_t q, size_t place) {
      const auto& G = element.gradient[q];
      const Tensor<double, D> F = Tensor<double, D>::Identity() + element.gather(at.u) * G.transpose();
      element.scatter((t * element.weight[q] * F * history(relaxation, change, place)) * G, out);
    });
  }

  void remember_change(const Point& at, const Eigen::VectorXd& du, const Params& dp, const Eigen::VectorXd& dmemory,
                       Eigen::VectorXd& next) const override {
    const Relaxation relaxation(at, definition_);
    if (relaxation.pairs.empty()) return;
    const auto law = law_at(at.p);
    each_point([&](const Geometry& element, size_t q, size_t place) {
      const Local u = element.gather(at.u);
      const Tensor<double, D> stress = law_stress(*law, element, u, q);
      const Tensor<double, D> change = law_stress_change(*law, element, u, element.gather(du), dp, q, stress);
      const Tensor<double, D> rise = stress - memory_of(at.step->memory, place);
      const Tensor<double, D> more = change - memory_of(dmemory, place);
      memory_of(next, place) = change;
      for (size_t i = 0; i < relaxation.pairs.size(); ++i) {
        const auto& [step, g, indices] = relaxation.pairs[i];
        const double dg = dp[indices[0]], dtau = dp[indices[1]];
        memory_of(next, place, i + 1) = step.decay * memory_of(dmemory, place, i + 1) + g * step.gain * more +
                                        (dg * step.gain + g * dtau * step.gain_by_tau) * rise +
                                        dtau * step.decay_by_tau * memory_of(at.step->memory, place, i + 1);
      }
    });
  }

 private:
  using RegionTerm<Geometry>::elements_;

  /// How far the material relaxes within the step at hand; without one, or without memory, not at all.
  struct Relaxation {
    struct Pair {
      PronyStep step;
      double g;
      std::array<int, 2> indices;
    };
    std::vector<Pair> pairs;
    double left = 1;  ///< of the law's energy
    const Eigen::VectorXd* memory = nullptr;

    Relaxation(const Point& at, const SolidDefinition& definition) {
      if (at.step == nullptr || at.step->memory.size() == 0) return;
      memory = &at.step->memory;
      for (const std::array<int, 2>& indices : definition.prony) {
        const double g = at.p[indices[0]];
        pairs.push_back({PronyStep(at.step->length, at.p[indices[1]]), g, indices});
        left -= g * (1 - pairs.back().step.gain);
      }
    }
  };

  static bool holds(const std::array<int, 2>& pair, int index) { return pair[0] == index || pair[1] == index; }
  std::vector<int>::const_iterator of_law(int index) const {
    return std::find(definition_.parameters.begin(), definition_.parameters.end(), index);
  }

  /// Numbers remembered at a quadrature point: S_e, and h of each pair.
  size_t block() const { return definition_.prony.empty() ? 0 : DD * (1 + definition_.prony.size()); }
  /// S_e (0) or h of a pair (its place + 1) at a quadrature point, in the memory of all terms.
  Eigen::Map<const Tensor<double, D>> memory_of(const Eigen::VectorXd& all, size_t point, size_t which = 0) const {
    return Eigen::Map<const Tensor<double, D>>(all.data() + first_ + point * block() + which * DD);
  }
  Eigen::Map<Tensor<double, D>> memory_of(Eigen::VectorXd& all, size_t point, size_t which = 0) const {
    return Eigen::Map<Tensor<double, D>>(all.data() + first_ + point * block() + which * DD);
  }
  /// action(element, q, place of this point in the memory).
  template <class Action>
  void each_point(Action&& action) const {
    for (size_t e = 0; e < elements_.size(); ++e) {
      for (size_t q = 0; q < Q; ++q) action(elements_[e], q, e * Q + q);
    }
  }

  /// The stress that is left of the past at the end of the step, sum decay_i h_i - g_i gain_i S_0 [Pa].
  Tensor<double, D> history(const Relaxation& relaxation, const Eigen::VectorXd& memory, size_t place) const {
    Tensor<double, D> sum = Tensor<double, D>::Zero();
    for (size_t i = 0; i < relaxation.pairs.size(); ++i) {
      const auto& [step, g, indices] = relaxation.pairs[i];
      sum += step.decay * memory_of(memory, place, i + 1) - g * step.gain * memory_of(memory, place);
    }
    return sum;
  }

  /// The mixed derivative with respect to a g or tau.
  void add_relaxation_gradient(const Point& at, int index, Eigen::VectorXd& out) const {
    const Relaxation relaxation(at, definition_);
    const double t = thickness(at.p);
    const auto law = law_at(at.p);
    for (size_t i = 0; i < relaxation.pairs.size(); ++i) {
      const auto& [step, g, indices] = relaxation.pairs[i];
      if (!holds(indices, index)) continue;
      const bool of_tau = indices[1] == index;
      const double gain = of_tau ? g * step.gain_by_tau : step.gain, decay = of_tau ? step.decay_by_tau : 0.0;
      const double left = of_tau ? gain : gain - 1;
      each_point([&](const Geometry& element, size_t q, size_t place) {
        const auto& G = element.gradient[q];
        const Local u = element.gather(at.u);
        const Tensor<double, D> stress = left * law_stress(*law, element, u, q) +
                                         decay * memory_of(*relaxation.memory, place, i + 1) -
                                         gain * memory_of(*relaxation.memory, place);
        const Tensor<double, D> F = Tensor<double, D>::Identity() + u * G.transpose();
        element.scatter((t * element.weight[q] * F * stress) * G, out);
      });
    }
  }

  /// Second Piola-Kirchhoff stress of the law [Pa].
  Tensor<double, D> law_stress(const PointLaw<D>& law, const Geometry& element, const Local& u, size_t q) const {
    const Tensor<double, D> H = element.slope(u, q), inverse = inverse_of<double, D>(H);
    Tensor<double, D> P = law.stress(H);
    if (averages()) P += law.volumetric_modulus() * mean_dilatation(element, u) * inverse.transpose();
    return inverse * P;
  }

  /// Its change where displacements and parameters change; `stress` is what it is.
  Tensor<double, D> law_stress_change(const PointLaw<D>& law, const Geometry& element, const Local& u, const Local& du,
                                      const Params& dp, size_t q, const Tensor<double, D>& stress) const {
    const Tensor<double, D> H = element.slope(u, q), inverse = inverse_of<double, D>(H);
    const Tensor<double, D> dF = element.slope(du, q);
    Tensor<double, D> dP = (law.tangent(H) * Eigen::Map<const Eigen::Matrix<double, DD, 1>>(dF.data())).reshaped(D, D);
    double mean = 0, modulus = 0, dmodulus = 0;
    if (averages()) {
      mean = mean_dilatation(element, u);
      modulus = law.volumetric_modulus();
    }
    for (size_t j = 0; j < definition_.parameters.size(); ++j) {
      const double change = dp[definition_.parameters[j]];
      if (change == 0) continue;
      dP += change * law.stress_derivative(H, static_cast<int>(j));
      if (averages()) dmodulus += change * law.volumetric_modulus_derivative(static_cast<int>(j));
    }
    if (averages()) {
      double dmean = 0, measure = 0;
      for (size_t k = 0; k < Q; ++k) {
        const Tensor<double, D> there = element.slope(u, k);
        dmean += element.weight[k] * (inverse_of<double, D>(there) * element.slope(du, k)).trace();
        measure += element.weight[k];
      }
      dmean /= measure;
      dP += (dmodulus * mean + modulus * dmean) * inverse.transpose() -
            modulus * mean * (inverse * dF * inverse).transpose();
    }
    return inverse * (dP - dF * stress);
  }

  bool averages() const { return definition_.formulation == Formulation::locking_free; }
  double thickness(const Params& p) const { return definition_.thickness < 0 ? 1.0 : p[definition_.thickness]; }

  /// The law with its constants, to be shared by all elements of an assembly.
  std::unique_ptr<PointLaw<D>> law_at(const Params& p) const {
    std::vector<double> theta;
    for (int index : definition_.parameters) theta.push_back(p[index]);
    if constexpr (D == 2) return law_.section(theta, definition_.plane, averages());
    if constexpr (D == 3) return law_.solid(theta, averages());
  }

  /// Mean of ln J over the element's rest volume; NaN where a J <= 0.
  static double mean_dilatation(const Geometry& element, const Local& u) {
    double sum = 0, measure = 0;
    for (size_t q = 0; q < Q; ++q) {
      const double j = jacobian_minus_one<double, D>(element.slope(u, q));
      sum += element.weight[q] * (j > -1.0 ? std::log1p(j) : std::nan(""));
      measure += element.weight[q];
    }
    return sum / measure;
  }

  /// Adds one element's gradient and Hessian and returns its energy.
  double add_element(int e, const Eigen::VectorXd& all, double thickness, const PointLaw<D>& law,
                     const Relaxation& relaxation, Assembly& out) const {
    const double t = relaxation.left * thickness;
    const Geometry& element = elements_[e];
    const Local u = element.gather(all);
    const bool wants_gradient = out.gradient != nullptr, wants_hessian = out.wants_hessian(), averaged = averages();
    double energy = 0, modulus = 0, pressure = 0, measure = 0;
    if (averaged) {
      for (double w : element.weight) measure += t * w;
      modulus = law.volumetric_modulus();
      const double mean = mean_dilatation(element, u);
      energy = 0.5 * modulus * measure * mean * mean;
      pressure = modulus * mean;
    }

    Local force = Local::Zero(), dilatation = Local::Zero();  // dilatation = d(V mean ln J)/du
    Stiffness K;
    if (wants_hessian) K.setZero();
    for (size_t q = 0; q < Q; ++q) {
      const auto& G = element.gradient[q];
      const double w = t * element.weight[q];
      const Tensor<double, D> H = element.slope(u, q);
      const double density = law.energy(H);
      if (!std::isfinite(density)) return infinity;
      energy += w * density;
      Tensor<double, D> past;
      if (!relaxation.pairs.empty()) {
        past = thickness * element.weight[q] * history(relaxation, *relaxation.memory, static_cast<size_t>(e) * Q + q);
        energy += past.cwiseProduct(green_strain<double, D>(H)).sum();
      }
      if (!wants_gradient && !wants_hessian) continue;
      Tensor<double, D> inverse;
      if (averaged) {
        inverse = inverse_of<double, D>(H);
        dilatation += element.spread(w * inverse.transpose(), q);
      }
      if (wants_gradient) force += element.spread(w * law.stress(H), q);
      if (wants_gradient && !relaxation.pairs.empty()) force += element.spread(past + H * past, q);
      if (!wants_hessian) continue;
      if (out.curvature == Curvature::projected) {
        add_stiffness(G, w, projected_tangent(law, H), K);
      } else {
        Tangent<double, D> A = law.tangent(H);
        if (averaged) add_pressure_tangent<D>(inverse, pressure, A);
        add_stiffness(G, w, A, K);
        if (!relaxation.pairs.empty()) add_past_stiffness(G, past, K);
      }
    }
    if (wants_gradient) {
      if (averaged) force += pressure * dilatation;
      out.add_gradient(element.nodes.data(), N, D, force.data());
    }
    if (wants_hessian) {
      if (averaged) {
        const Eigen::Map<const Eigen::Matrix<double, DN, 1>> b(dilatation.data());
        K.template triangularView<Eigen::Lower>() += (modulus / measure) * b * b.transpose();
      }
      mirror(K);
      out.add_hessian(e, element.nodes.data(), N, D, K.data());
    }
    return energy;
  }

  /// A positive semi-definite stand-in for the tangent. The volumetric energy k/2 (ln J)^2 keeps its Gauss-Newton part
  /// k F^-T (x) F^-T and loses the part proportional to the pressure, which in nearly incompressible solids is large,
  /// of either sign, and mostly wrong far from the solution; the rest has its negative eigenvalues removed.
  Tangent<double, D> projected_tangent(const PointLaw<D>& law, const Tensor<double, D>& H) const {
    Tangent<double, D> A = positive_part(law.rest_tangent(H));
    const double modulus = averages() ? 0.0 : law.volumetric_modulus();
    if (modulus == 0) return A;
    const Tensor<double, D> cofactor = inverse_of<double, D>(H).transpose();
    const Eigen::Map<const Eigen::Matrix<double, D * D, 1>> c(cofactor.data());
    return A + modulus * c * c.transpose();
  }

  /// Lower triangle of K += w B^T A B, row and column index a * D + i.
  static void add_stiffness(const Eigen::Matrix<double, D, N>& G, double w, const Tangent<double, D>& A, Stiffness& K) {
    for (int b = 0; b < N; ++b) {
      // AG(i + D J, k) = w sum_L A(iJ, kL) G(L, b)
      Eigen::Matrix<double, D * D, D> AG = (w * G(0, b)) * A.template leftCols<D>();
      for (int L = 1; L < D; ++L) AG += (w * G(L, b)) * A.template middleCols<D>(D * L);
      for (int a = b; a < N; ++a) {
        Eigen::Matrix<double, D, D> block = G(0, a) * AG.template topRows<D>();
        for (int J = 1; J < D; ++J) block += G(J, a) * AG.template middleRows<D>(D * J);
        K.template block<D, D>(a * D, b * D) += block;
      }
    }
  }

  /// Lower triangle of what a history stress adds, by how Green's strain curves; of either sign, and left out where
  /// only positive curvature is wanted.
  static void add_past_stiffness(const Eigen::Matrix<double, D, N>& G, const Tensor<double, D>& past, Stiffness& K) {
    const Eigen::Matrix<double, N, N> by = G.transpose() * past * G;
    for (int b = 0; b < N; ++b) {
      for (int a = b; a < N; ++a) {
        for (int i = 0; i < D; ++i) K(a * D + i, b * D + i) += by(a, b);
      }
    }
  }

  static void mirror(Stiffness& K) {
    for (int r = 0; r < DN; ++r) {
      for (int c = r + 1; c < DN; ++c) K(r, c) = K(c, r);
    }
  }

  const Law& law_;
  SolidDefinition definition_;
  int first_ = 0;  ///< of its memory in that of all terms
};

}  // namespace taut
