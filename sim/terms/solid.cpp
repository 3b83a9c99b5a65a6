#include "sim/terms/solid.hpp"

#include <fmt/format.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <limits>

#include "sim/core/error.hpp"
#include "sim/materials/all.hpp"
#include "sim/materials/plane_stress.hpp"
#include "sim/mesh/shape_functions.hpp"
#include "sim/terms/region_term.hpp"

namespace taut {
namespace {

/// The solid itself, or its plane-strain section: the material's own functions.
template <class Material>
struct Direct {
  Material solid;
  template <int D>
  double energy(const Tensor<double, D>& H) const {
    return solid.energy(H);
  }
  template <int D>
  Tensor<double, D> stress(const Tensor<double, D>& H) const {
    return solid.stress(H);
  }
  template <int D>
  Tangent<double, D> tangent(const Tensor<double, D>& H) const {
    return solid.tangent(H);
  }
  template <int D>
  Tensor<double, D> stress_derivative(const Tensor<double, D>& H, const Material& derivative) const {
    return derivative.stress(H);
  }
};

/// Removes the negative eigenvalues of a symmetric matrix.
template <int n>
void clamp_to_semidefinite(Eigen::Matrix<double, n, n>& A) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, n, n>> eigen(A);
  if (eigen.eigenvalues()[0] >= 0) return;
  A = eigen.eigenvectors() * eigen.eigenvalues().cwiseMax(0.0).asDiagonal() * eigen.eigenvectors().transpose();
}

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

/// A positive semi-definite stand-in for the tangent. The volumetric energy lambda/2 (ln J)^2 keeps its Gauss-Newton
/// part lambda F^-T (x) F^-T and loses the part proportional to the pressure, which in nearly incompressible solids is
/// large, of either sign, and mostly wrong far from the solution; the rest has its negative eigenvalues removed.
template <int D, class Law>
Tangent<double, D> projected_tangent(const Law& law, const Tensor<double, D>& H) {
  using Material = std::remove_cvref_t<decltype(law.solid)>;
  if constexpr (Material::splits_volume && std::is_same_v<Law, Direct<Material>>) {
    Tangent<double, D> A = law.solid.without_volume().tangent(H);
    clamp_to_semidefinite<D * D>(A);
    const Tensor<double, D> cofactor = inverse_of<double, D>(H).transpose();
    const Eigen::Map<const Eigen::Matrix<double, D * D, 1>> c(cofactor.data());
    return A + law.solid.volumetric_modulus() * c * c.transpose();
  } else {
    Tangent<double, D> A = law.tangent(H);
    clamp_to_semidefinite<D * D>(A);
    return A;
  }
}

template <ElementShape S, class Material, template <class> class Law>
class Solid final : public RegionTerm<ElementGeometry<S>> {
  using Geometry = ElementGeometry<S>;
  static constexpr int D = Geometry::D, N = Geometry::N, Q = Geometry::Q, DN = D * N;
  static constexpr size_t parameter_count = std::tuple_size_v<decltype(Material::parameters())>;
  using Local = typename Geometry::Local;
  using Stiffness = Eigen::Matrix<double, DN, DN, Eigen::RowMajor>;

 public:
  Solid(const Mesh& mesh, const SolidDefinition& definition)
      : RegionTerm<Geometry>(mesh, definition.region), definition_(definition) {}

  bool depends_on(int index) const override {
    return index == definition_.thickness || std::find(definition_.parameters.begin(), definition_.parameters.end(),
                                                       index) != definition_.parameters.end();
  }

  void assemble(const Point& at, Assembly& out) const override {
    const double t = thickness(at.p);
    const Material material(theta(at.p));
    for (size_t e = 0; e < elements_.size(); ++e) {
      const double energy = averages() ? add_element<true>(static_cast<int>(e), at.u, t, material, out)
                                       : add_element<false>(static_cast<int>(e), at.u, t, material, out);
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
    const double t = thickness(at.p);
    Law<Material> law{Material(theta(at.p))};
    Material derivative =
        Material::derivative(theta(at.p), static_cast<int>(position - definition_.parameters.begin()));
    double volumetric = 0;
    if constexpr (Material::splits_volume) {
      if (averages()) {
        volumetric = derivative.volumetric_modulus();
        law.solid = law.solid.without_volume();
        derivative = derivative.without_volume();
      }
    }
    for (const Geometry& element : elements_) {
      const Local u = element.gather(at.u);
      const double pressure = averages() ? volumetric * mean_dilatation(element, u) : 0.0;
      Local force = Local::Zero();
      for (size_t q = 0; q < Q; ++q) {
        const Tensor<double, D> H = u * element.gradient[q].transpose();
        Tensor<double, D> P = law.stress_derivative(H, derivative);
        if (averages()) P += pressure * inverse_of<double, D>(H).transpose();
        force.noalias() += (t * element.weight[q] * P) * element.gradient[q];
      }
      element.scatter(force, out);
    }
  }

 private:
  using RegionTerm<Geometry>::elements_;
  static constexpr double infinity = std::numeric_limits<double>::infinity();

  bool averages() const { return definition_.formulation == Formulation::locking_free; }
  double thickness(const Params& p) const { return definition_.thickness < 0 ? 1.0 : p[definition_.thickness]; }

  std::array<double, parameter_count> theta(const Params& p) const {
    std::array<double, parameter_count> values;
    for (size_t j = 0; j < parameter_count; ++j) values[j] = p[definition_.parameters[j]];
    return values;
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
  template <bool averaged>
  double add_element(int e, const Eigen::VectorXd& all, double t, const Material& material, Assembly& out) const {
    const Geometry& element = elements_[e];
    const Local u = element.gather(all);
    const bool wants_gradient = out.gradient != nullptr, wants_hessian = out.wants_hessian();
    Law<Material> law{material};
    double energy = 0, modulus = 0, pressure = 0, measure = 0;
    if constexpr (averaged && Material::splits_volume) {
      for (double w : element.weight) measure += t * w;
      modulus = material.volumetric_modulus();
      const double mean = mean_dilatation(element, u);
      energy = 0.5 * modulus * measure * mean * mean;
      pressure = modulus * mean;
      law.solid = material.without_volume();
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
      if constexpr (averaged) {
        inverse = inverse_of<double, D>(H);
        dilatation.noalias() += w * inverse.transpose() * G;
      }
      if (wants_gradient) force.noalias() += (w * law.stress(H)) * G;
      if (!wants_hessian) continue;
      if (out.curvature == Curvature::projected) {
        add_stiffness(G, w, projected_tangent<D>(law, H), K);
      } else {
        Tangent<double, D> A = law.tangent(H);
        if constexpr (averaged) add_pressure_tangent<D>(inverse, pressure, A);
        add_stiffness(G, w, A, K);
      }
    }
    if (wants_gradient) {
      if constexpr (averaged) force += pressure * dilatation;
      out.add_gradient(element.nodes.data(), N, D, force.data());
    }
    if (wants_hessian) {
      if constexpr (averaged) {
        const Eigen::Map<const Eigen::Matrix<double, DN, 1>> b(dilatation.data());
        K.template triangularView<Eigen::Lower>() += (modulus / measure) * b * b.transpose();
      }
      mirror(K);
      out.add_hessian(e, element.nodes.data(), N, D, K.data());
    }
    return energy;
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

  SolidDefinition definition_;
};

/// Calls `action` with a default-constructed material of the named law.
template <class Action>
auto with_law(std::string_view law, Action&& action) {
  using First = std::tuple_element_t<0, AllMaterials<>>;
  decltype(action(First{})) result{};
  bool found = false;
  std::apply([&](auto... material) { ((material.id == law ? (result = action(material), found = true) : false), ...); },
             AllMaterials<>{});
  if (!found) {
    throw InputError(fmt::format("unknown material law '{}'{}; known laws: {}", law, did_you_mean(law, material_laws()),
                                 join(material_laws())));
  }
  return result;
}

}  // namespace

std::unique_ptr<Term> make_solid(const Mesh& mesh, const SolidDefinition& definition) {
  return with_law(definition.law, [&](auto material) -> std::unique_ptr<Term> {
    using Material = decltype(material);
    const bool plane_stress = mesh.dimension() == 2 && definition.plane == Plane::stress;
    if (definition.formulation == Formulation::locking_free) {
      constexpr auto remedy = "use formulation = \"standard\"";
      if (!Material::splits_volume)
        throw InputError(fmt::format("material law '{}' has no separate energy of volume change to average; {}",
                                     definition.law, remedy));
      if (plane_stress)
        throw InputError(
            fmt::format("plane stress does not lock, because the thickness is free to change; {}", remedy));
      if (order_of(mesh.shape) == 1)
        throw InputError(
            fmt::format("the locking-free formulation needs quadratic elements (a linear one has only one volume "
                        "change to average); use element = \"quadratic\", or {}",
                        remedy));
    }
    return with_shape(mesh.shape, [&](auto shape) -> std::unique_ptr<Term> {
      if constexpr (dimension_of(shape) == 2) {
        if (plane_stress) return std::make_unique<Solid<shape, Material, PlaneStress>>(mesh, definition);
      }
      return std::make_unique<Solid<shape, Material, Direct>>(mesh, definition);
    });
  });
}

std::vector<std::string> material_laws() {
  std::vector<std::string> names;
  std::apply([&](auto... material) { (names.emplace_back(material.id), ...); }, AllMaterials<>{});
  return names;
}

std::vector<ParameterSpec> material_parameters(std::string_view law) {
  return with_law(law, [](auto material) {
    const auto specs = material.parameters();
    return std::vector<ParameterSpec>(specs.begin(), specs.end());
  });
}

double smallest_jacobian(const Mesh& mesh, const Eigen::VectorXd& u) {
  return with_shape(mesh.shape, [&](auto shape) {
    using Reference = ReferenceElement<shape>;
    constexpr int D = Reference::D, N = Reference::N;
    std::vector<typename Reference::Xi> samples;
    for (const auto& point : Reference::quadrature()) samples.push_back(point.xi);
    for (int a = 0; a < N; ++a) samples.push_back(Reference::node(a));
    double smallest = std::numeric_limits<double>::infinity();
    for (int e = 0; e < mesh.element_count(); ++e) {
      const Eigen::Matrix<double, D, N> X = Reference::positions(mesh, e);
      const Eigen::Matrix<double, D, N> x = X + ElementNodes<shape>(mesh, e).gather(u);
      for (const auto& xi : samples) {
        const Eigen::Matrix<double, D, N> natural = Reference::gradients(xi);
        const Eigen::Matrix<double, D, D> rest = X * natural.transpose(), now = x * natural.transpose();
        smallest = std::min(smallest, now.determinant() / rest.determinant());
      }
    }
    return smallest;
  });
}

}  // namespace taut
