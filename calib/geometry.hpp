#pragma once
#include "calib/experiment.hpp"

namespace taut {

/// The mesh of a geometry. A push_puppet in `contact` must have room for the contact gap; with `compensate` the
/// distance at which closed lips rest is taken off their faces, so that they close where the specimen's own do. With
/// settings.depth_cells the plane section becomes a solid of half its thickness, with a plane of symmetry at z = 0.
/// Throws InputError.
Mesh make_mesh(const GeometrySettings& geometry, const MeshSettings& settings, bool contact, bool compensate);

/// Distance at which contact sets in [m]: the file's, or 2e-5 of a specimen's diagonal.
double contact_gap(const MeshSettings& settings, double diagonal);

/// Rest points [m] of the cable called `name` that a geometry brings along ("upper" and "lower" of a push_puppet), in
/// its own frame. Throws InputError when it has none of that name.
std::vector<Eigen::VectorXd> own_cable(const GeometrySettings& geometry, const std::string& name);

}  // namespace taut
