#pragma once
#include <memory>

#include "sim/contact/contact.hpp"
#include "sim/contact/contact_3d.hpp"
#include "sim/model/term.hpp"

namespace taut {

/// Coulomb friction of what touches, with true stick: an elastic spring along the surface between a vertex i and the
/// point of the other side at which it was caught, which returns to the limit (Wriggers, Computational Contact
/// Mechanics, 2006). In a step, for each vertex and each side (part, obstacle, ground) that pressed on it with N_i when
/// the step began,
///
///   E = psi(|g|),   psi(g) = k g^2 / 2  for k g <= mu N_i,   mu N_i g - (mu N_i)^2 / (2 k)  beyond  [J],
///   g = (I - n n^T) (x_i - a)  [m],   a = sum_j alpha_j x_j,   k = kappa w_i t / dhat  [N/m],
///
/// x_j the corners of the edge or triangle that was nearest when the step began, alpha the caught point's coordinates
/// in it, n its normal; on a ground a is a place that moves with it, n the normal there; w_i the vertex's share of the
/// rest surface, t the thickness. At the step's end g is cut to mu N_i / k, and so caught again on what is nearest
/// then. What remembers that is TimeStep::memory, per vertex and two sides of it: the feature, its caught point, N_i.
///
/// Each step is the minimum of an energy. What sticks does so for good, whatever the number of steps: it gives way by
/// mu N / k, that is mu dhat p / kappa under a pressure p, and nothing creeps. N_i is the one before, so that sliding
/// under changing pressure is right to the first order in the step, and what comes to touch in a step rubs from the
/// next one on. Turns with the surfaces cost nothing. Both sides of a contact carry half of it. Edges that cross in
/// space rub not at all.
///
/// k takes dhat, kappa and t as they are given to the constructor; exact derivatives by mu and through N_i. Without a
/// step with memory (an equilibrium that has no past) there is no friction.
std::unique_ptr<SidedTerm> make_contact_friction(const Contact& contact, int coefficient, const Params& p);
/// The same in space.
std::unique_ptr<SidedTerm> make_contact_friction(const Contact3d& contact, int coefficient, const Params& p);

}  // namespace taut
