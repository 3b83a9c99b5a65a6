#include "sim/shapes/twist.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "sim/core/error.hpp"
#include "sim/mesh/mesh_budget.hpp"
#include "sim/mesh/structured.hpp"

namespace taut {

std::vector<ShapeKey> TwistModule::keys() {
  const Allowed any = Allowed::any(), positive = Allowed::positive(), counted = Allowed::at_least(1, most_repeated);
  return {
      {"cells", &cells, counted, "of foam, a plate at either end of each", Quantity::pure},
      {"cables", &cables, counted, "of each handedness", Quantity::pure},
      {"cell_length", &cell_length, positive, "foam between two plates"},
      {"core_width", &core_width, positive, "of the square foam"},
      {"plate_width", &plate_width, positive, "of the square plates"},
      {"plate_thickness", &plate_thickness, positive, "of the plates"},
      {"rim_width", &rim_width, positive, "of the frame along the plates' edges"},
      {"rim_gap", &rim_gap, positive, "between the rims of two plates"},
      {"cable_radius", &cable_radius, positive, "distance of the cables from the axis where they pass a plate"},
      {"cable_turn", &cable_turn, any, "angle of a cable from plate to plate", Quantity::angle},
  };
}

std::vector<MeshKey> TwistModule::mesh_keys() const {
  return {{MeshKey::count, "core_cells", "across the core", 4}, {MeshKey::count, "layers", "in each rim and gap", 1}};
}

void TwistModule::check() const {
  check_keys("twist module");
  const TwistModule& m = *this;
  if (!(m.rim_gap < m.cell_length))
    throw InputError(
        fmt::format("twist module: rim_gap {} has to be below cell_length {}", in_mm(m.rim_gap), in_mm(m.cell_length)));
  if (!(m.core_width + 2 * m.rim_width < m.plate_width))
    throw InputError(
        fmt::format("twist module: a core of {} and rims of {} do not fit on plates of {}; widen the plates",
                    in_mm(m.core_width), in_mm(m.rim_width), in_mm(m.plate_width)));
}

Mesh TwistModule::mesh(const MeshSettings& settings, bool, bool) const {
  check();
  check_counts("twist module", settings);
  const int layers = count(settings, "layers");
  const double core = 0.5 * core_width, plate = 0.5 * plate_width, inner = plate - rim_width;
  std::vector<double> x{-plate, -inner, -core}, z{0.0};
  step_to(x, core, count(settings, "core_cells"));
  x.insert(x.end(), {inner, plate});
  const double rim = 0.5 * (cell_length - rim_gap), pitch = cell_length + plate_thickness;
  step_to(z, plate_thickness, 1);
  for (int cell = 0; cell < cells; ++cell) {
    const double begin = cell * pitch + plate_thickness;
    step_to(z, begin + rim, layers);
    step_to(z, begin + rim + rim_gap, layers);
    step_to(z, begin + cell_length, layers);
    step_to(z, (cell + 1) * pitch + plate_thickness, 1);
  }
  Mesh grid = box(x, x, z, 1, "foam");
  const auto from_axis = [](const Eigen::VectorXd& at) { return std::max(std::abs(at[0]), std::abs(at[1])); };
  assign_regions(grid, [&](const Eigen::VectorXd& at) -> std::string {
    return from_axis(at) < core && std::fmod(at[2], pitch) > plate_thickness ? "foam" : "plastic";
  });
  Mesh module = part_of(grid, [&](const Eigen::VectorXd& at) {
    const double above = std::fmod(at[2], pitch) - plate_thickness;  // the plate
    if (above < 0 || from_axis(at) < core) return true;
    return from_axis(at) > inner && (above < rim || above > rim + rim_gap);
  });
  module.tags = {{"base", module.tags.at("zmin")}, {"tip", module.tags.at("zmax")}};
  return settings.order == 1 ? module : to_quadratic(module);
}

std::vector<Eigen::Vector3d> cable_path(const TwistModule& m, int cable, int handedness) {
  m.check();
  if (cable < 0 || cable >= m.cables)
    throw InputError(fmt::format("twist module: there is no cable {} among {}, counted from 0", cable, m.cables));
  if (handedness != 1 && handedness != -1)
    throw InputError(fmt::format("twist module: handedness {}; 1 and -1 are allowed", handedness));
  std::vector<Eigen::Vector3d> path;
  for (int plate = 0; plate <= m.cells; ++plate) {
    const double angle = 2 * std::numbers::pi * cable / m.cables + handedness * m.cable_turn * (plate - 0.5 * m.cells);
    const double x = m.cable_radius * std::cos(angle), y = m.cable_radius * std::sin(angle);
    const double z = plate * (m.cell_length + m.plate_thickness), side = std::max(std::abs(x), std::abs(y));
    if (!(side < 0.5 * m.plate_width) || !(side > 0.5 * m.core_width)) {
      throw InputError(
          fmt::format("twist module: cable {} passes plate {} at ({:.4g}, {:.4g}) mm, which is not between the core "
                      "and the plate's "
                      "edge; change cable_radius or cable_turn",
                      cable, plate + 1, 1e3 * x, 1e3 * y));
    }
    path.emplace_back(x, y, z);
    path.emplace_back(x, y, z + m.plate_thickness);
    // Clear of the core where one of its four sides has the whole way from the last plate before it.
    if (plate == 0) continue;
    const Eigen::Vector3d &from = path[path.size() - 3], &to = path[path.size() - 2];
    bool outside = false;
    for (int axis = 0; axis < 2; ++axis) {
      for (double sign : {1.0, -1.0})
        outside = outside || std::min(sign * from[axis], sign * to[axis]) > 0.5 * m.core_width;
    }
    if (!outside)
      throw InputError(
          fmt::format("twist module: cable {} cuts through the core between plates {} and {}; turn it less", cable,
                      plate, plate + 1));
  }
  return path;
}

std::vector<std::string> TwistModule::cable_names() const {
  std::vector<std::string> names;
  for (const char* hand : {"right", "left"}) {
    for (int i = 1; i <= cables; ++i) names.push_back(fmt::format("{}_{}", hand, i));
  }
  return names;
}

std::vector<Eigen::VectorXd> TwistModule::cable(size_t index) const {
  const int place = static_cast<int>(index);
  const std::vector<Eigen::Vector3d> path = cable_path(*this, place % cables, place < cables ? 1 : -1);
  return {path.begin(), path.end()};
}

}  // namespace taut
