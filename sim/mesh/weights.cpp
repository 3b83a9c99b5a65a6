#include "sim/mesh/weights.hpp"

#include <Eigen/Geometry>
#include <Eigen/LU>

#include "sim/mesh/shape_functions.hpp"

namespace taut {
namespace {

/// Share of each node in the integral of its shape function over a straight entity of unit measure.
std::vector<double> shares(const Tag& tag) {
  const bool linear = tag.nodes_per_entity == tag.dimension + 1;
  if (tag.dimension == 0) return {1.0};
  if (tag.dimension == 1) return linear ? std::vector{0.5, 0.5} : std::vector{1.0 / 6, 1.0 / 6, 4.0 / 6};
  return linear ? std::vector(3, 1.0 / 3) : std::vector{0.0, 0.0, 0.0, 1.0 / 3, 1.0 / 3, 1.0 / 3};
}

double measure_of_entity(const Mesh& mesh, const Tag& tag, int entity) {
  if (tag.dimension == 0) return 1.0;
  const int* node = tag.entity(entity);
  const Eigen::VectorXd a = mesh.node(node[1]) - mesh.node(node[0]);
  if (tag.dimension == 1) return a.norm();
  const Eigen::VectorXd b = mesh.node(node[2]) - mesh.node(node[0]);
  return 0.5 * Eigen::Vector3d(a).cross(Eigen::Vector3d(b)).norm();
}

void add_at_node(Eigen::VectorXd& weights, int node, double share, const Eigen::VectorXd& direction) {
  weights.segment(node * direction.size(), direction.size()) += share * direction;
}

}  // namespace

double measure_of(const Mesh& mesh, const Tag& tag) {
  double sum = 0;
  for (int entity = 0; entity < tag.count(); ++entity) sum += measure_of_entity(mesh, tag, entity);
  return sum;
}

Eigen::VectorXd mean_weights(const Mesh& mesh, const Tag& tag, const Eigen::VectorXd& direction) {
  Eigen::VectorXd weights = Eigen::VectorXd::Zero(mesh.X.size());
  const Eigen::VectorXd unit = direction.normalized() / measure_of(mesh, tag);
  const std::vector<double> share = shares(tag);
  for (int entity = 0; entity < tag.count(); ++entity) {
    const double measure = measure_of_entity(mesh, tag, entity);
    for (int a = 0; a < tag.nodes_per_entity; ++a) {
      add_at_node(weights, tag.entities[entity * tag.nodes_per_entity + a], share[a] * measure, unit);
    }
  }
  return weights;
}

std::vector<double> element_measures(const Mesh& mesh) {
  return with_shape(mesh.shape, [&](auto shape) {
    using Reference = ReferenceElement<shape>;
    std::vector<double> measures;
    for (int e = 0; e < mesh.element_count(); ++e) {
      const auto X = Reference::positions(mesh, e);
      double sum = 0;
      for (const auto& point : Reference::quadrature()) {
        const Eigen::Matrix<double, Reference::D, Reference::D> jacobian =
            X * Reference::gradients(point.xi).transpose();
        sum += point.weight * jacobian.determinant();
      }
      measures.push_back(sum);
    }
    return measures;
  });
}

Eigen::VectorXd body_weights(const Mesh& mesh, int region, const Eigen::VectorXd& direction) {
  // Integral of the shape functions over straight-sided simplices: linear, 1/(d+1) each; quadratic triangle, 0 at
  // vertices and 1/3 at mid-nodes; quadratic tetrahedron, -1/20 at vertices and 1/5 at mid-nodes.
  const int vertices = mesh.dimension() + 1;
  const bool quadratic = order_of(mesh.shape) == 2;
  const double at_vertex = !quadratic ? 1.0 / vertices : mesh.dimension() == 2 ? 0.0 : -1.0 / 20;
  const double at_mid = mesh.dimension() == 2 ? 1.0 / 3 : 1.0 / 5;
  const Eigen::VectorXd unit = direction.normalized();
  const std::vector<double> measures = element_measures(mesh);
  Eigen::VectorXd weights = Eigen::VectorXd::Zero(mesh.X.size());
  for (int e = 0; e < mesh.element_count(); ++e) {
    if (mesh.region[e] != region) continue;
    for (int a = 0; a < mesh.nodes_per_element(); ++a) {
      add_at_node(weights, mesh.element(e)[a], (a < vertices ? at_vertex : at_mid) * measures[e], unit);
    }
  }
  return weights;
}

Eigen::VectorXd point_weights(const Mesh& mesh, const MaterialPoint& point, const Eigen::VectorXd& direction) {
  Eigen::VectorXd weights = Eigen::VectorXd::Zero(mesh.X.size());
  const Eigen::VectorXd unit = direction.normalized();
  for (size_t k = 0; k < point.nodes.size(); ++k) add_at_node(weights, point.nodes[k], point.weights[k], unit);
  return weights;
}

}  // namespace taut
