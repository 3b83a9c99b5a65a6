#pragma once
#include <Eigen/Core>
#include <functional>
#include <string>

#include "sim/core/parameters.hpp"
#include "sim/mesh/mesh.hpp"

namespace taut {

struct Experiment;

/// A length or an angle of a specimen, from which the model is built and for which it has no parameter.
struct Dimension {
  ParameterSpec spec;  ///< id "gap_total", "size_x"
  std::string place;   ///< in the file: "geometry.gap_total", "geometry.size.1"
  double value = 0;    ///< [m] or [rad]
  std::function<void(Experiment& experiment, double value)> set;
  /// How the nodes of the experiment's mesh go with it, dX/dvalue (all zero: not at all); empty: as meshes of a little
  /// more and less tell. Throws InputError where they cannot.
  std::function<Eigen::VectorXd(const Mesh& mesh)> moves = {};
};

}  // namespace taut
