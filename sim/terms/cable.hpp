#pragma once
#include <Eigen/Core>
#include <memory>
#include <vector>

#include "sim/core/channel.hpp"
#include "sim/core/term.hpp"
#include "sim/mesh/mesh.hpp"

namespace taut {

/// A point that a cable passes without friction: a material point (its nodes and weights), or fixed in space.
struct CablePoint {
  MaterialPoint material;  ///< no nodes: fixed
  Eigen::VectorXd fixed;   ///< [m]
};

/// A cable: its points in order, and the table indices of what governs it.
struct Cable {
  std::vector<CablePoint> points;  ///< at least two
  int stiffness = -1;              ///< k [N/m], of the whole cable
  int slack = -1;                  ///< [m]; the cable is that much longer than its path at rest; -1: none
  int retraction = -1;             ///< u [m]; -1: none
  double smoothing = 2e-6;         ///< eps [m], width of the transition from slack to taut; 0: none
};

std::unique_ptr<Term> make_cable(const Mesh& mesh, Cable cable);
std::unique_ptr<Channel> make_cable_length(const Mesh& mesh, const Cable& cable);
std::unique_ptr<Channel> make_cable_tension(const Mesh& mesh, const Cable& cable);

}  // namespace taut
