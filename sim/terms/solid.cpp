#include "sim/terms/solid.hpp"

#include <fmt/format.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <map>

#include "sim/core/error.hpp"
#include "sim/materials/all.hpp"
#include "sim/materials/plane_stress.hpp"
#include "sim/mesh/shape_functions.hpp"

namespace taut {
namespace {

/// The solid itself, or its plane-strain section: the material's own functions.
template <class Material>
struct Direct {
  Material solid;
  template <int D>
  double energy(const Tensor<double, D>& H) const { return solid.energy(H); }
  template <int D>
  Tensor<double, D> stress(const Tensor<double, D>& H) const { return solid.stress(H); }
  template <int D>
  Tangent<double, D> tangent(const Tensor<double, D>& H) const { return solid.tangent(H); }
  template <int D>
  Tensor<double, D> stress_derivative(const Tensor<double, D>& H, const Material& derivative) const { return derivative.stress(H); }
};

/// Geometry of an element at its quadrature points.
template <ElementShape S>
struct ElementGeometry {
  using Reference = ReferenceElement<S>;
  static constexpr int D = Reference::D, N = Reference::N;
  static constexpr int Q = static_cast<int>(std::tuple_size_v<decltype(Reference::quadrature())>);
  std::array<int, N> nodes;
  std::array<double, Q> weight;                                     ///< of the rest volume (area) [m^D]
  std::array<Eigen::Matrix<double, D, N>, Q> gradient;              ///< dN/dX [1/m], one column per node

  ElementGeometry(const Mesh& mesh, int e) {
    Eigen::Matrix<double, D, N> X;
    for (int a = 0; a < N; ++a) {
      nodes[static_cast<size_t>(a)] = mesh.element(e)[a];
      X.col(a) = mesh.X.template segment<D>(static_cast<Eigen::Index>(mesh.element(e)[a]) * D);
    }
    const auto rule = Reference::quadrature();
    for (size_t q = 0; q < rule.size(); ++q) {
      const Eigen::Matrix<double, D, N> natural = Reference::gradients(rule[q].xi);
      const Eigen::Matrix<double, D, D> jacobian = X * natural.transpose();
      weight[q] = rule[q].weight * jacobian.determinant();
      gradient[q] = jacobian.transpose().inverse() * natural;
    }
  }

  Eigen::Matrix<double, D, N> gather(const Eigen::VectorXd& u) const {
    Eigen::Matrix<double, D, N> local;
    for (int a = 0; a < N; ++a) local.col(a) = u.segment<D>(static_cast<Eigen::Index>(nodes[static_cast<size_t>(a)]) * D);
    return local;
  }
};

/// Removes the negative eigenvalues of a symmetric matrix.
template <int n>
void clamp_to_semidefinite(Eigen::Matrix<double, n, n>& A) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, n, n>> eigen(A);
  if (eigen.eigenvalues()[0] >= 0) return;
  A = eigen.eigenvectors() * eigen.eigenvalues().cwiseMax(0.0).asDiagonal() * eigen.eigenvectors().transpose();
}

/// Tangent of a stress whose volumetric part is `pressure` F^-T at constant pressure: A - pressure Finv_Jk Finv_Li.
template <int D>
Tangent<double, D> with_pressure(Tangent<double, D> A, const Tensor<double, D>& inverse, double pressure) {
  for (int L = 0; L < D; ++L) {
    for (int k = 0; k < D; ++k) {
      for (int J = 0; J < D; ++J) {
        for (int i = 0; i < D; ++i) A(i + D * J, k + D * L) -= pressure * inverse(J, k) * inverse(L, i);
      }
    }
  }
  return A;
}

/// A positive semi-definite stand-in for the tangent. The volumetric energy lambda/2 (ln J)^2 keeps its Gauss-Newton part
/// lambda F^-T (x) F^-T and loses the part proportional to the pressure, which in nearly incompressible solids is large, of
/// either sign, and mostly wrong far from the solution; the rest has its negative eigenvalues removed.
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
class Solid final : public Term {
  using Geometry = ElementGeometry<S>;
  static constexpr int D = Geometry::D, N = Geometry::N, Q = Geometry::Q, DN = D * N;
  static constexpr size_t parameter_count = std::tuple_size_v<decltype(Material::parameters())>;
  using Local = Eigen::Matrix<double, D, N>;
  using Stiffness = Eigen::Matrix<double, DN, DN, Eigen::RowMajor>;

 public:
  Solid(const Mesh& mesh, const SolidDefinition& definition) : definition_(definition) {
    for (int e = 0; e < mesh.element_count(); ++e) {
      if (mesh.region[static_cast<size_t>(e)] == definition.region) elements_.emplace_back(mesh, e);
    }
    if (definition.formulation != Formulation::standard) build_patches();
  }

  Cliques cliques() const override {
    Cliques list;
    for (const Geometry& element : elements_) list.add(element.nodes);
    for (const Patch& patch : patches_) list.add(patch.nodes);
    return list;
  }

  bool depends_on(int index) const override {
    return index == definition_.thickness ||
           std::find(definition_.parameters.begin(), definition_.parameters.end(), index) != definition_.parameters.end();
  }

  void assemble(const Point& at, Assembly& out) const override {
    const double t = thickness(at.p);
    Law<Material> law{Material(theta(at.p))};
    const bool averaged = !patches_.empty();
    std::vector<double> pressure;
    if constexpr (Material::splits_volume) {
      if (averaged) {
        const double modulus = law.solid.volumetric_modulus();
        pressure = averaged_dilatation(at.u);
        for (size_t a = 0; a < patches_.size(); ++a) {
          const double mean = pressure[a];
          if (!std::isfinite(mean)) return out.add_energy(std::numeric_limits<double>::infinity());
          out.add_energy(t * 0.5 * modulus * patches_[a].measure * mean * mean);
          pressure[a] = modulus * mean;
        }
        law.solid = law.solid.without_volume();
      }
    }

    for (size_t e = 0; e < elements_.size(); ++e) {
      const Geometry& element = elements_[e];
      const Local u = element.gather(at.u);
      Local force = Local::Zero();
      Stiffness K;
      if (out.wants_hessian()) K.setZero();
      double energy = 0;
      for (int q = 0; q < Q; ++q) {
        const auto& G = element.gradient[static_cast<size_t>(q)];
        const double w = t * element.weight[static_cast<size_t>(q)];
        const Tensor<double, D> H = u * G.transpose();
        const double density = law.energy(H);
        if (!std::isfinite(density)) return out.add_energy(std::numeric_limits<double>::infinity());
        energy += w * density;
        if (out.gradient == nullptr && !out.wants_hessian()) continue;
        const double p_q = averaged ? pressure_at(pressure, e, q) : 0.0;
        const Tensor<double, D> inverse = averaged ? inverse_of<double, D>(H) : Tensor<double, D>();
        if (out.gradient != nullptr) {
          Tensor<double, D> P = law.stress(H);
          if (averaged) P += p_q * inverse.transpose();
          force.noalias() += (w * P) * G;
        }
        if (out.wants_hessian()) {
          const Tangent<double, D> A = out.curvature == Curvature::projected ? projected_tangent<D>(law, H)
                                       : averaged                            ? with_pressure<D>(law.tangent(H), inverse, p_q)
                                                                             : law.tangent(H);
          add_stiffness(G, w, A, K);
        }
      }
      out.add_energy(energy);
      if (out.gradient != nullptr) out.add_gradient(element.nodes.data(), N, D, force.data());
      if (out.wants_hessian()) {
        mirror(K);
        out.add_hessian(static_cast<int>(e), element.nodes.data(), N, D, K.data());
      }
    }
    if (averaged && out.wants_hessian()) add_patch_stiffness(at, t, out);
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
    Material derivative = Material::derivative(theta(at.p), static_cast<int>(position - definition_.parameters.begin()));
    std::vector<double> pressure;
    const bool averaged = !patches_.empty();
    if constexpr (Material::splits_volume) {
      if (averaged) {
        pressure = averaged_dilatation(at.u);
        for (double& mean : pressure) mean *= derivative.volumetric_modulus();
        law.solid = law.solid.without_volume();
        derivative = derivative.without_volume();
      }
    }
    for (size_t e = 0; e < elements_.size(); ++e) {
      const Geometry& element = elements_[e];
      const Local u = element.gather(at.u);
      Local force = Local::Zero();
      for (int q = 0; q < Q; ++q) {
        const auto& G = element.gradient[static_cast<size_t>(q)];
        const Tensor<double, D> H = u * G.transpose();
        Tensor<double, D> P = law.stress_derivative(H, derivative);
        if (averaged) P += pressure_at(pressure, e, q) * inverse_of<double, D>(H).transpose();
        force.noalias() += (t * element.weight[static_cast<size_t>(q)] * P) * G;
      }
      for (int a = 0; a < N; ++a) out.segment<D>(static_cast<Eigen::Index>(element.nodes[static_cast<size_t>(a)]) * D) += force.col(a);
    }
  }

 private:
  /// A set of elements over which ln J is averaged; weights are in `shares_`.
  struct Patch {
    double measure = 0;           ///< sum of its weights [m^D]
    std::vector<int> nodes;       ///< all nodes of its elements, sorted
    std::vector<int> elements;    ///< indices into elements_
  };
  static constexpr int patches_per_element_max = D + 1;

  double thickness(const Params& p) const { return definition_.thickness < 0 ? 1.0 : p[definition_.thickness]; }

  std::array<double, parameter_count> theta(const Params& p) const {
    std::array<double, parameter_count> values;
    for (size_t j = 0; j < parameter_count; ++j) values[j] = p[definition_.parameters[j]];
    return values;
  }

  /// K += w B^T A B for the lower triangle, row and column a * D + i.
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

  void build_patches() {
    const bool around_vertices = definition_.formulation == Formulation::locking_free;
    std::map<int, int> patch_of_vertex;
    patches_of_element_.resize(elements_.size());
    for (size_t e = 0; e < elements_.size(); ++e) {
      for (int c = 0; c < (around_vertices ? D + 1 : 1); ++c) {
        int patch = static_cast<int>(patches_.size());
        if (around_vertices) patch = patch_of_vertex.try_emplace(elements_[e].nodes[static_cast<size_t>(c)], patch).first->second;
        if (patch == static_cast<int>(patches_.size())) patches_.emplace_back();
        patches_of_element_[e].push_back(patch);
        Patch& target = patches_[static_cast<size_t>(patch)];
        target.elements.push_back(static_cast<int>(e));
        target.nodes.insert(target.nodes.end(), elements_[e].nodes.begin(), elements_[e].nodes.end());
        for (int q = 0; q < Q; ++q) target.measure += share(e, c, q);
      }
    }
    for (Patch& patch : patches_) {
      std::sort(patch.nodes.begin(), patch.nodes.end());
      patch.nodes.erase(std::unique(patch.nodes.begin(), patch.nodes.end()), patch.nodes.end());
    }
  }

  /// Weight of quadrature point q of element e in the element's c-th patch: w_q times hat function (or times 1).
  double share(size_t e, int c, int q) const {
    return elements_[e].weight[static_cast<size_t>(q)] * hat(c, q);
  }
  double hat(int c, int q) const {
    static const auto rule = Geometry::Reference::quadrature();
    if (definition_.formulation == Formulation::mean_dilatation) return 1.0;
    return Geometry::Reference::barycentric(rule[static_cast<size_t>(q)].xi)[static_cast<size_t>(c)];
  }

  /// Mean of ln J over each patch; NaN where a J <= 0.
  std::vector<double> averaged_dilatation(const Eigen::VectorXd& u) const {
    std::vector<double> mean(patches_.size(), 0.0);
    for (size_t e = 0; e < elements_.size(); ++e) {
      const Local local = elements_[e].gather(u);
      for (int q = 0; q < Q; ++q) {
        const Tensor<double, D> H = local * elements_[e].gradient[static_cast<size_t>(q)].transpose();
        const double j = jacobian_minus_one<double, D>(H);
        const double ln_j = j > -1.0 ? std::log1p(j) : std::nan("");
        for (size_t c = 0; c < patches_of_element_[e].size(); ++c) {
          mean[static_cast<size_t>(patches_of_element_[e][c])] += share(e, static_cast<int>(c), q) * ln_j;
        }
      }
    }
    for (size_t a = 0; a < mean.size(); ++a) mean[a] /= patches_[a].measure;
    return mean;
  }

  double pressure_at(const std::vector<double>& pressure, size_t e, int q) const {
    double p = 0;
    for (size_t c = 0; c < patches_of_element_[e].size(); ++c) {
      p += hat(static_cast<int>(c), q) * pressure[static_cast<size_t>(patches_of_element_[e][c])];
    }
    return p;
  }

  /// The part of the Hessian that couples a patch: modulus / V b b^T with b = d(V mean ln J)/du.
  void add_patch_stiffness(const Point& at, double t, Assembly& out) const {
    if constexpr (Material::splits_volume) {
      const double modulus = t * Material(theta(at.p)).volumetric_modulus();
      Eigen::VectorXd b;
      Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> K;
      for (size_t a = 0; a < patches_.size(); ++a) {
        const Patch& patch = patches_[a];
        b.setZero(static_cast<Eigen::Index>(patch.nodes.size()) * D);
        for (int e : patch.elements) {
          const Geometry& element = elements_[static_cast<size_t>(e)];
          const auto& list = patches_of_element_[static_cast<size_t>(e)];
          const int c = static_cast<int>(std::find(list.begin(), list.end(), static_cast<int>(a)) - list.begin());
          const Local local = element.gather(at.u);
          Local gradient = Local::Zero();
          for (int q = 0; q < Q; ++q) {
            const auto& G = element.gradient[static_cast<size_t>(q)];
            const Tensor<double, D> H = local * G.transpose();
            gradient.noalias() += share(static_cast<size_t>(e), c, q) * inverse_of<double, D>(H).transpose() * G;
          }
          for (int n = 0; n < N; ++n) {
            const auto position = std::lower_bound(patch.nodes.begin(), patch.nodes.end(), element.nodes[static_cast<size_t>(n)]);
            b.segment<D>((position - patch.nodes.begin()) * D) += gradient.col(n);
          }
        }
        K.noalias() = (modulus / patch.measure) * b * b.transpose();
        out.add_hessian(static_cast<int>(elements_.size() + a), patch.nodes.data(), static_cast<int>(patch.nodes.size()), D, K.data());
      }
    }
  }

  SolidDefinition definition_;
  std::vector<Geometry> elements_;
  std::vector<Patch> patches_;
  std::vector<std::vector<int>> patches_of_element_;
};

/// Calls `action` with a default-constructed material of the named law.
template <class Action>
auto with_law(std::string_view law, Action&& action) {
  using First = std::tuple_element_t<0, AllMaterials<>>;
  decltype(action(First{})) result{};
  bool found = false;
  std::apply([&](auto... material) { ((material.id == law ? (result = action(material), found = true) : false), ...); }, AllMaterials<>{});
  if (!found) {
    throw InputError(fmt::format("unknown material law '{}'{}; known laws: {}", law, did_you_mean(law, material_laws()), join(material_laws())));
  }
  return result;
}

template <class Action>
auto with_shape(ElementShape shape, Action&& action) {
  switch (shape) {
    case ElementShape::tri3: return action(std::integral_constant<ElementShape, ElementShape::tri3>{});
    case ElementShape::tri6: return action(std::integral_constant<ElementShape, ElementShape::tri6>{});
    case ElementShape::tet4: return action(std::integral_constant<ElementShape, ElementShape::tet4>{});
    default: return action(std::integral_constant<ElementShape, ElementShape::tet10>{});
  }
}

}  // namespace

std::unique_ptr<Term> make_solid(const Mesh& mesh, const SolidDefinition& definition) {
  return with_law(definition.law, [&](auto material) -> std::unique_ptr<Term> {
    using Material = decltype(material);
    if (definition.formulation != Formulation::standard && !Material::splits_volume) {
      throw InputError(fmt::format("material law '{}' has no separate energy of volume change; use formulation = \"standard\"", definition.law));
    }
    const bool plane_stress = mesh.dimension() == 2 && definition.plane == Plane::stress;
    if (plane_stress && definition.formulation != Formulation::standard) {
      throw InputError("plane stress does not lock, because the thickness is free to change; use formulation = \"standard\"");
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
    for (int a = 0; a <= D; ++a) {
      samples.push_back(Reference::Xi::Zero());
      if (a > 0) samples.back()[a - 1] = 1.0;
    }
    for (int edge = 0; edge < N - D - 1; ++edge) {
      const auto [i, j] = Reference::edges[static_cast<size_t>(edge)];
      samples.push_back(0.5 * (samples[samples.size() - static_cast<size_t>(D + 1 + edge) + static_cast<size_t>(i)] +
                               samples[samples.size() - static_cast<size_t>(D + 1 + edge) + static_cast<size_t>(j)]));
    }
    double smallest = std::numeric_limits<double>::infinity();
    for (int e = 0; e < mesh.element_count(); ++e) {
      Eigen::Matrix<double, D, N> X, x;
      for (int a = 0; a < N; ++a) {
        X.col(a) = mesh.X.segment<D>(static_cast<Eigen::Index>(mesh.element(e)[a]) * D);
        x.col(a) = X.col(a) + u.segment<D>(static_cast<Eigen::Index>(mesh.element(e)[a]) * D);
      }
      for (const auto& xi : samples) {
        const Eigen::Matrix<double, D, N> natural = Reference::gradients(xi);
        const Eigen::Matrix<double, D, D> rest = X * natural.transpose(), now = x * natural.transpose();
        smallest = std::min(smallest, now.determinant() / rest.determinant());
      }
    }
    return smallest;
  });
}

std::vector<double> element_measures(const Mesh& mesh) {
  return with_shape(mesh.shape, [&](auto shape) {
    std::vector<double> measures;
    for (int e = 0; e < mesh.element_count(); ++e) {
      const ElementGeometry<shape> element(mesh, e);
      double sum = 0;
      for (double w : element.weight) sum += w;
      measures.push_back(sum);
    }
    return measures;
  });
}

}  // namespace taut
