#include "sim/shapes/mesh_file.hpp"

#include <fmt/format.h>

#include "sim/core/error.hpp"
#include "sim/mesh/msh_file.hpp"
#include "sim/mesh/one_body.hpp"

namespace taut {

std::vector<ShapeKey> MeshFile::keys() {
  return {{"file", &file, Allowed::any(), "a mesh or geometry that Gmsh reads", Quantity::pure, true},
          {"unit", &unit, Allowed::any(), "of the file's coordinates", Quantity::length, true},
          {"dimension", &axes, Allowed::at_least(2, 3), "of the mesh", Quantity::pure},
          {"bodies", &bodies, Allowed::any(), "\"joined\", or \"separate\": parts that share no node are meant",
           Quantity::pure}};
}

void MeshFile::check() const {
  if (bodies != "joined" && bodies != "separate")
    throw InputError(fmt::format("bodies must be \"joined\" or \"separate\", not \"{}\"", bodies));
}

Mesh MeshFile::mesh(const MeshSettings& settings, bool, bool) const {
  Mesh mesh = read_msh(file.path, unit.metres, axes);
  if (mesh.dimension() != axes) {
    throw InputError(
        fmt::format("{} is a {}D mesh; set dimension = {}", file.path, mesh.dimension(), mesh.dimension()));
  }
  check_one_body(mesh, file.path, bodies == "separate");
  for (std::string& oddity : oddities(mesh, file.path)) mesh.remarks.push_back(std::move(oddity));
  if (settings.order == 2 && order_of(mesh.shape) == 1) {
    if (std::string chords = straight_chords(mesh, file.path); !chords.empty()) mesh.remarks.push_back(chords);
    return to_quadratic(mesh);
  }
  if (settings.order == 1 && order_of(mesh.shape) == 2)
    throw InputError(fmt::format("{} has quadratic elements; set element = \"quadratic\"", file.path));
  return mesh;
}

}  // namespace taut
