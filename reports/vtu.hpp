#pragma once
#include <string>
#include <vector>

#include "sim/mesh/mesh.hpp"

namespace taut {

/// VTK XML unstructured grid (.vtu) of a state for ParaView: rest positions as points, point data "displacement" [m],
/// cell data "region". Quadratic elements are written as such.
std::string vtu_text(const Mesh& mesh, const Eigen::VectorXd& u);

/// A .pvd collection: (time or load, file name) pairs.
std::string pvd_text(const std::vector<std::pair<double, std::string>>& files);

}  // namespace taut
