#pragma once
#include <Eigen/Core>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <vector>

#include "sim/mesh/shape_functions.hpp"
#include "sim/model/term.hpp"

namespace taut {

/// The nodes of an element, and their part of vectors of all unknowns.
template <ElementShape S>
struct ElementNodes {
  static constexpr int D = dimension_of(S), N = nodes_of(S);
  using Local = Eigen::Matrix<double, D, N>;  ///< one column per node
  std::array<int, N> nodes;

  ElementNodes(const Mesh& mesh, int e) { std::copy_n(mesh.element(e), N, nodes.begin()); }  ///< of element e

  /// The part of `all` that belongs to these nodes.
  Local gather(const Eigen::VectorXd& all) const {
    Local local;
    for (int a = 0; a < N; ++a) local.col(a) = all.segment<D>(nodes[a] * D);
    return local;
  }
  /// Adds to that part.
  void scatter(const Local& local, Eigen::VectorXd& all) const {
    for (int a = 0; a < N; ++a) all.segment<D>(nodes[a] * D) += local.col(a);
  }
};

/// Geometry of an element at its quadrature points.
template <ElementShape S>
struct ElementGeometry : ElementNodes<S> {
  using Reference = ReferenceElement<S>;  ///< shape functions and quadrature
  using typename ElementNodes<S>::Local;
  using ElementNodes<S>::D;
  static constexpr int Q = static_cast<int>(std::tuple_size_v<decltype(Reference::quadrature())>);
  std::array<double, Q> weight;   ///< of the rest volume (area) [m^D]
  std::array<Local, Q> gradient;  ///< dN/dX [1/m], one column per node

  // Not inlined: everything calls these, and the compiler's memory goes with how often they are written out.
  /// dv/dX at a quadrature point, of a field with these values at the nodes.
  [[gnu::noinline]] Eigen::Matrix<double, D, D> slope(const Local& values, size_t q) const {
    return values * gradient[q].transpose();
  }
  /// Nodes' forces from a first Piola-Kirchhoff stress there, times the volume: the transpose of slope().
  [[gnu::noinline]] Local spread(const Eigen::Matrix<double, D, D>& stress, size_t q) const {
    return stress * gradient[q];
  }

  /// At the rest shape of element e.
  ElementGeometry(const Mesh& mesh, int e) : ElementNodes<S>(mesh, e) {
    const Local X = Reference::positions(mesh, e);
    const auto rule = Reference::quadrature();
    for (size_t q = 0; q < rule.size(); ++q) {
      const Local natural = Reference::gradients(rule[q].xi);
      const Eigen::Matrix<double, Reference::D, Reference::D> jacobian = X * natural.transpose();
      weight[q] = rule[q].weight * jacobian.determinant();
      gradient[q] = jacobian.transpose().inverse() * natural;
    }
  }
};

/// An energy of a region's elements, each of which is a clique.
template <class Element>
class RegionTerm : public Term {
 public:
  /// Of all elements of a region.
  RegionTerm(const Mesh& mesh, int region) {
    for (int e = 0; e < mesh.element_count(); ++e) {
      if (mesh.region[e] == region) elements_.emplace_back(mesh, e);
    }
  }
  Cliques cliques() const override {
    Cliques list;
    for (const Element& element : elements_) list.add(element.nodes);
    return list;
  }

 protected:
  std::vector<Element> elements_;
};

}  // namespace taut
