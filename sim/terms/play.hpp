#pragma once
#include <Eigen/Core>
#include <memory>

#include "sim/mesh/mesh.hpp"
#include "sim/model/term.hpp"

namespace taut {

/// A stud in its hole, along one direction: where each of them is, and the table indices of what governs them.
struct Play {
  Eigen::VectorXd apart;    ///< weights . u = e [m], how far the stud has moved in its hole; of all unknowns
  int stiffness = -1;       ///< k [N/m] of stud and hole in contact
  int clearance = -1;       ///< c [m], to either side
  double smoothing = 2e-6;  ///< eps [m], width of the transition to contact; 0: none
  double share = 1;         ///< of the energy; 0.5 in a model of one half of a symmetric body
};

/// Energy of a stud that moves freely within a clearance and is held elastically beyond it:
///
///   E = k [phi(e - c) + phi(-e - c)] [J],   F = dE/de = k sign(e) max(|e| - c, 0) [N] but for the transition,
///
/// phi the OneSided energy with its transition eps. C2 in u and c; for c = 0 it is the spring k e^2 / 2, whatever eps.
/// The direction is fixed in space: valid while what holds the hole turns little. Positive semi-definite as it is; a
/// body that nothing else holds has no equilibrium within the clearance. Without friction: loaded across, a stud
/// slides.
///
/// The clique holds all nodes with a weight. Throws InputError where these are none (a stud in its own place, or a
/// direction across everything), and for a negative smoothing.
std::unique_ptr<Term> make_play(const Mesh& mesh, const Play& play);

}  // namespace taut
