#pragma once
#include <optional>
#include <string>
#include <vector>

#include "calib/benches/bench.hpp"
#include "calib/studies/discretisation.hpp"

namespace taut {

/// One row of a closed module: without friction of its lips, and with so much of it that they cannot slide.
struct FrictionRow {
  std::string channel;
  std::vector<double> controls;                          ///< SI
  double sliding = 0, sticking = 0;                      ///< what is read [SI]
  double sliding_stiffness = 0, sticking_stiffness = 0;  ///< load over displacement since unloaded [N/m]; NaN: neither
};

/// Between what friction of a closed module's lips lies.
struct LipFriction {
  std::vector<FrictionRow> rows;  ///< those that start from lips that touch
  Share share;                    ///< "friction of the lips": half of the way that a fit with sticking lips would go
                                  ///< from this one's, and as much again as its error: which end is true is not known
};

/// What friction of contact, of which the model has none, could change at most: the rows once more at the fit's optimum
/// with surfaces that cannot slide from the state on in which they first touch, the unloaded one or that of a smaller
/// load of the rows (Grip), and one Gauss-Newton step with those values. What friction does to loads that grow is
/// between the two; what comes to touch under a row's own last step of load slides in that row. Nothing where no row
/// starts from a closed state, and no solve where nothing touches in the bench's last replay, which was at the optimum.
/// One cold replay without derivatives, and a warm one with them (`ask`). For one specimen,
/// readings at rest of the plane full model or rigid segments, and fits that have a result.
std::optional<LipFriction> lip_friction(const Bench& bench, const FitResult& fit, const Ask& ask = {});

}  // namespace taut
