#pragma once
#include <Eigen/Core>
#include <vector>

#include "sim/mesh/mesh.hpp"

namespace taut {

/// Nodal weights of a unit force spread evenly over a tag (area, length or equal shares of points) in `direction` (any
/// length, normalised here): weights . u is the mean displacement of the tag in that direction. Shape: (unknowns).
/// Consistent with the elements' shape functions: quadratic triangles put 1/3 of their share on each mid-node.
Eigen::VectorXd mean_weights(const Mesh& mesh, const Tag& tag, const Eigen::VectorXd& direction);

/// Rest area [m^2], length [m] or number of points of a tag.
double measure_of(const Mesh& mesh, const Tag& tag);

/// Nodal weights of a body force per unit volume (3D) or area (2D) in one region.
Eigen::VectorXd body_weights(const Mesh& mesh, int region, const Eigen::VectorXd& direction);

/// Nodal weights of a unit force at one material point.
Eigen::VectorXd point_weights(const Mesh& mesh, const MaterialPoint& point, const Eigen::VectorXd& direction);

/// Volume (3D) or area (2D) of each element at rest.
std::vector<double> element_measures(const Mesh& mesh);

}  // namespace taut
