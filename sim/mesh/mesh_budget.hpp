#pragma once

namespace taut {

/// Most cells, segments or tiles that a specimen repeats: far beyond what can be solved, far below where numbers
/// overflow.
inline constexpr int most_repeated = 10000;

/// What equations on a mesh of this many nodes take [bytes]: its Hessian, the Cholesky factor (which fills up as
/// N log N in the plane and N^(4/3) in space, as nested dissection has it) and what a replay holds besides. Fitted to
/// what the system said of squares of 40 and 161 thousand nodes and of cubes of 5, 16 and 36 thousand; to 20 % there.
double memory_of_equations(double nodes, int dimension, int order);

/// Throws InputError before anything is made when a mesh of about this many elements (a lower bound will do) cannot be
/// solved on this machine: one sentence with the number of elements, the memory that they take, and what fits. Numbers
/// of elements are doubles here: products of counts are compared before they could overflow.
void require_mesh(double elements, int dimension, int order);

/// The same of a mesh that is there.
void require_equations(double elements, double nodes, int dimension, int order);

}  // namespace taut
