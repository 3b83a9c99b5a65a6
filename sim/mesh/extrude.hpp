#pragma once
#include "sim/mesh/mesh.hpp"

namespace taut {

/// A plane mesh swept along z from 0 to `depth` [m] in `layers` equal layers: each triangle becomes a column of prisms,
/// each of these three tetrahedra, of the same order and with straight edges. A side of a prism is cut from the vertex
/// with the lower number, at the bottom in even layers and at the top in odd ones, so that neighbours match. Regions
/// and parts are kept; segments of a tag become triangles, points become segments, both under the tag's name; the
/// faces z = 0 and z = depth become the tags "symmetry" and "side".
///
/// Throws InputError for a mesh that is not plane, a depth or number of layers that is not positive, a tag that is
/// called "symmetry" or "side" already, or one that holds a mid-node as a point.
Mesh extrude(const Mesh& plane, double depth, int layers);

}  // namespace taut
