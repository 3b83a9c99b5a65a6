#pragma once
#include <vector>

#include "calib/benches/assumptions.hpp"

namespace taut {

/// Whether [fit.free.ID] is there.
bool is_fitted(const Experiment& experiment, const std::string& id);

/// Changes one of a shape's keys, by its place, in a copy of the shape; the cables that it brings along follow.
void edit_key(Experiment& experiment, size_t key, const std::function<void(const ShapeKey& key)>& change);

/// The corners of boxes and polygons that have a tolerance or are fitted, as dimensions "box_1_upper_x" and
/// "polygon_1_x_3" (counted from 1). With a side of a box all faces in its plane move, what lies between that and the
/// next planes in proportion. With a corner of a polygon those of others at the same place move, their edges in
/// proportion, and the nodes between by the mean of their neighbours; one that lies on the edge of another polygon, or
/// on whose edge another one's corner lies, does not move.
void add_corners(const Experiment& experiment, std::vector<Dimension>& dimensions);

}  // namespace taut
