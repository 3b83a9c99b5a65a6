#pragma once
#include <Eigen/Core>
#include <memory>
#include <vector>

#include "sim/model/term.hpp"

namespace taut {

/// Potential of a dead load: E = -(product of p[factors]) * (weights . u)  [J]. A hung mass has the factors {m, g}, a
/// traction in 2D {traction, thickness}, self-weight {density, g, thickness}; `weights` says where it acts and which
/// way.
std::unique_ptr<Term> make_load(Eigen::VectorXd weights, std::vector<int> factors);

}  // namespace taut
