#pragma once
#include <string>
#include <vector>

#include "calib/benches/bench.hpp"
#include "sim/mesh/mesh.hpp"

namespace taut {

/// VTK XML unstructured grid (.vtu) of a state for ParaView: rest positions as points, point data "displacement" [m],
/// cell data "region". Quadratic elements are written as such.
std::string vtu_text(const Mesh& mesh, const Eigen::VectorXd& u);

/// Writes the states of a replay to `folder`/states and returns the path of their collection; "" without a mesh.
std::string write_states(const SolvedStates& states, const std::string& folder);

/// A .pvd collection: (time or load, file name) pairs.
std::string pvd_text(const std::vector<std::pair<double, std::string>>& files);

}  // namespace taut
