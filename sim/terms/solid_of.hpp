#pragma once
#include <algorithm>
#include <cmath>

#include "sim/core/dense.hpp"
#include "sim/core/numbers.hpp"
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
  static constexpr int D = Geometry::D, N = Geometry::N, Q = Geometry::Q, DN = D * N;
  using Local = typename Geometry::Local;
  using Stiffness = Eigen::Matrix<double, DN, DN, Eigen::RowMajor>;

 public:
  Solid(const Mesh& mesh, const SolidDefinition& definition)
      : RegionTerm<Geometry>(mesh, definition.region), law_(law_named(definition.law)), definition_(definition) {}

  bool depends_on(int index) const override {
    return index == definition_.thickness || std::find(definition_.parameters.begin(), definition_.parameters.end(),
                                                       index) != definition_.parameters.end();
  }

  void assemble(const Point& at, Assembly& out) const override {
    const double t = thickness(at.p);
    const auto law = law_at(at.p);
    for (size_t e = 0; e < elements_.size(); ++e) {
      const double energy = add_element(static_cast<int>(e), at.u, t, *law, out);
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
    const auto position = std::find(definition_.parameters.begin(), definition_.parameters.end(), index);
    const int j = static_cast<int>(position - definition_.parameters.begin());
    const double t = thickness(at.p);
    const auto law = law_at(at.p);
    const double volumetric = averages() ? law->volumetric_modulus_derivative(j) : 0.0;
    for (const Geometry& element : elements_) {
      const Local u = element.gather(at.u);
      const double pressure = averages() ? volumetric * mean_dilatation(element, u) : 0.0;
      Local force = Local::Zero();
      for (size_t q = 0; q < Q; ++q) {
        const Tensor<double, D> H = u * element.gradient[q].transpose();
        Tensor<double, D> P = law->stress_derivative(H, j);
        if (averages()) P += pressure * inverse_of<double, D>(H).transpose();
        force.noalias() += (t * element.weight[q] * P) * element.gradient[q];
      }
      element.scatter(force, out);
    }
  }

 private:
  using RegionTerm<Geometry>::elements_;

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
      const double j = jacobian_minus_one<double, D>(u * element.gradient[q].transpose());
      sum += element.weight[q] * (j > -1.0 ? std::log1p(j) : std::nan(""));
      measure += element.weight[q];
    }
    return sum / measure;
  }

  /// Adds one element's gradient and Hessian and returns its energy.
  double add_element(int e, const Eigen::VectorXd& all, double t, const PointLaw<D>& law, Assembly& out) const {
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
      const Tensor<double, D> H = u * G.transpose();
      const double density = law.energy(H);
      if (!std::isfinite(density)) return infinity;
      energy += w * density;
      if (!wants_gradient && !wants_hessian) continue;
      Tensor<double, D> inverse;
      if (averaged) {
        inverse = inverse_of<double, D>(H);
        dilatation.noalias() += w * inverse.transpose() * G;
      }
      if (wants_gradient) force.noalias() += (w * law.stress(H)) * G;
      if (!wants_hessian) continue;
      if (out.curvature == Curvature::projected) {
        add_stiffness(G, w, projected_tangent(law, H), K);
      } else {
        Tangent<double, D> A = law.tangent(H);
        if (averaged) add_pressure_tangent<D>(inverse, pressure, A);
        add_stiffness(G, w, A, K);
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

  static void mirror(Stiffness& K) {
    for (int r = 0; r < DN; ++r) {
      for (int c = r + 1; c < DN; ++c) K(r, c) = K(c, r);
    }
  }

  const Law& law_;
  SolidDefinition definition_;
};

}  // namespace taut
