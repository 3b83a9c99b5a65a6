#pragma once
#include <string>
#include <string_view>
#include <vector>

#include "sim/mesh/mesh.hpp"

namespace taut {

/// Whether a mesh from elsewhere is the body that it seems to be; places in the message are of nodes or centroids.
/// Distances are compared with a thousandth of the shortest edge at the vertex. Throws InputError where
/// - elements have more than a tenth of their height in common: they overlap, or are there twice;
/// - two vertices coincide, or two mid-nodes of one edge: the elements on either side of that seam are not joined;
/// - a vertex lies on an edge or face of an element whose vertex it is not: a hanging node;
/// - elements share no vertex with others: there are several parts.
/// `separate`: several parts that may touch are meant, only the first is asked. `where` starts the message (a file
/// name, say). Cost: n log n.
void check_one_body(const Mesh& mesh, std::string_view where, bool separate);

/// What may be meant and often is not, one sentence each: needles, parts that hang together at a point or line only, a
/// size that tells of a wrong unit. `where` starts each.
std::vector<std::string> oddities(const Mesh& mesh, std::string_view where);

/// Whether a mesh of linear elements, to become quadratic ones with straight sides, has a boundary that is made of
/// chords: sides one after the other that turn by 3 to 45 degrees on more than one hand. One sentence, or "".
std::string straight_chords(const Mesh& linear, std::string_view where);

}  // namespace taut
