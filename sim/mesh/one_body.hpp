#pragma once
#include <string_view>

#include "sim/mesh/mesh.hpp"

namespace taut {

/// Whether a mesh from elsewhere is the body that it seems to be; names and places in the message are of vertices.
/// Throws InputError where
/// - two vertices coincide (to 1e-3 of the mean edge): the elements on either side of that seam are not joined;
/// - elements share no vertex with others: there are several parts;
/// - a vertex lies on an edge or face of an element whose vertex it is not: a hanging node;
/// - a vertex lies inside an element: elements overlap.
/// `separate`: several parts that may touch are meant, the first three are not asked. `where` starts the message (a
/// file name, say). Cost: n log n for elements of about one size.
void check_one_body(const Mesh& mesh, std::string_view where, bool separate);

}  // namespace taut
