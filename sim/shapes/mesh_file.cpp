#include "sim/shapes/mesh_file.hpp"

#include <fmt/format.h>

#include "sim/core/error.hpp"
#include "sim/mesh/msh_file.hpp"

namespace taut {

std::vector<ShapeKey> MeshFile::keys() {
  return {{"file", &file, Allowed::any(), "Gmsh 2.2 or 4.1, ASCII", Quantity::pure, true},
          {"unit", &unit, Allowed::any(), "of the file's coordinates", Quantity::length, true},
          {"dimension", &axes, Allowed::at_least(2, 3), "of the mesh", Quantity::pure}};
}

Mesh MeshFile::mesh(const MeshSettings& settings, bool, bool) const {
  Mesh mesh = read_msh(file.path, unit.metres);
  if (mesh.dimension() != axes) {
    throw InputError(
        fmt::format("{} is a {}D mesh; set dimension = {}", file.path, mesh.dimension(), mesh.dimension()));
  }
  if (settings.order == 2 && order_of(mesh.shape) == 1) return to_quadratic(mesh);
  if (settings.order == 1 && order_of(mesh.shape) == 2)
    throw InputError(fmt::format("{} has quadratic elements; set element = \"quadratic\"", file.path));
  return mesh;
}

}  // namespace taut
