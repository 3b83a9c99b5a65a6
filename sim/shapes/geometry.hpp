#pragma once
#include <memory>
#include <string>
#include <vector>

#include "sim/shapes/shape.hpp"

namespace taut {

/// [geometry]: a shape, and what all plane ones have.
struct GeometrySettings {
  std::shared_ptr<const Shape> shape;  ///< none: nothing is meshed
  double thickness = 1;                ///< 2D [m]
  Plane plane = Plane::strain;
  int dimension = 3;                           ///< of the model: a plane shape may be swept to a solid
  std::shared_ptr<const Mesh> mesh = nullptr;  ///< in place of the shape's own, whatever the settings; null: its own
  std::vector<std::string> left_out;  ///< dimensions that the file does not give: those of the shape's own making

  std::string kind() const { return shape ? shape->kind() : ""; }  ///< "push_puppet", "" without a shape
  /// The shape of a kind that is known; std::bad_cast for another one.
  template <class Kind>
  const Kind& as() const {
    return dynamic_cast<const Kind&>(*shape);
  }
  /// The same to be changed, which leaves copies of these settings as they are.
  template <class Kind>
  Kind& edit() {
    auto own = std::make_shared<Kind>(as<Kind>());
    shape = own;
    return *own;
  }
};

/// The mesh of a geometry, see Shape::mesh(). With settings.depth_cells the plane section becomes a solid of half its
/// thickness, with a plane of symmetry at z = 0. Throws InputError.
Mesh make_mesh(const GeometrySettings& geometry, const MeshSettings& settings, bool contact, bool compensate);

/// Whether its mesh follows from settings, so that refined() makes another one.
bool refinable(const GeometrySettings& geometry);
/// The settings of a mesh with elements `factor` times as small: all that the shape's table of [mesh] has and layers of
/// depth, rounded and at least one. A mesh that is read from a file stays as it is.
MeshSettings refined(const MeshSettings& settings, const GeometrySettings& geometry, double factor);

/// Rest points [m] of the cable called `name` that a geometry brings along ("upper" and "lower" of a push_puppet), in
/// its own frame. Throws InputError when it has none of that name.
std::vector<Eigen::VectorXd> own_cable(const GeometrySettings& geometry, const std::string& name);

/// Path of the file that a geometry is read from; "" when there is none.
std::string input_file(const GeometrySettings& geometry);
/// Takes that file from another place.
void set_input_file(GeometrySettings& geometry, const std::string& path);

}  // namespace taut
