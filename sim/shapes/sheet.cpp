#include "sim/shapes/sheet.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "sim/core/error.hpp"
#include "sim/mesh/structured.hpp"

namespace taut {
namespace {

/// Coordinate within the period of tile and strip.
bool in_tile(const Sheet& s, double x) {
  return std::fmod(x, s.tile + s.strip) < s.tile;
}

}  // namespace

std::vector<ShapeKey> Sheet::keys() {
  const Allowed any = Allowed::any(), positive = Allowed::positive(), counted = Allowed::at_least(1);
  return {
      {"columns", &columns, counted, "tiles along x", Quantity::pure},
      {"rows", &rows, counted, "tiles along y", Quantity::pure},
      {"tile", &tile, positive, "edge of the square tiles"},
      {"strip", &strip, positive, "foam between tiles"},
      {"thickness", &thickness, positive, "of the sheet"},
      {"cable_height", &cable_height, any, "of its own cables above the middle plane"},
  };
}

std::vector<MeshKey> Sheet::mesh_keys() const {
  return {{MeshKey::count, "tile_cells", "along a tile", 1},
          {MeshKey::count, "strip_cells", "across a strip of foam", 2},
          {MeshKey::count, "layers", "through the thickness", 1}};
}

void Sheet::check() const {
  check_keys("sheet");
}

Mesh Sheet::mesh(const MeshSettings& settings, bool, bool) const {
  check();
  check_counts("sheet", settings);
  const auto lines = [&](int tiles) {
    std::vector<double> x{0.0};
    for (int k = 0; k < tiles; ++k) {
      step_to(x, k * (tile + strip) + tile, count(settings, "tile_cells"));
      if (k + 1 < tiles) step_to(x, (k + 1) * (tile + strip), count(settings, "strip_cells"));
    }
    return x;
  };
  std::vector<double> z{-0.5 * thickness};
  step_to(z, 0.5 * thickness, count(settings, "layers"));
  Mesh sheet = box(lines(columns), lines(rows), z, settings.order, "foam");
  assign_regions(sheet, [&](const Eigen::VectorXd& at) -> std::string {
    return in_tile(*this, at[0]) && in_tile(*this, at[1]) ? "plastic" : "foam";
  });
  sheet.tags = {{"base", sheet.tags.at("xmin")},
                {"tip", sheet.tags.at("xmax")},
                {"lower", sheet.tags.at("zmin")},
                {"upper", sheet.tags.at("zmax")}};
  return sheet;
}

std::vector<Eigen::Vector3d> cable_path(const Sheet& s, int row, double z) {
  s.check();
  if (row < 0 || row >= s.rows)
    throw InputError(fmt::format("sheet: there is no row {} among {}, counted from 0", row, s.rows));
  if (!(std::abs(z) < 0.5 * s.thickness))
    throw InputError(
        fmt::format("sheet: a cable at {} leaves the sheet, which ends at {}", in_mm(z), in_mm(0.5 * s.thickness)));
  std::vector<Eigen::Vector3d> path;
  const double y = row * (s.tile + s.strip) + 0.5 * s.tile;
  for (int column = 0; column < s.columns; ++column) {
    const double x = column * (s.tile + s.strip);
    path.emplace_back(x, y, z);
    path.emplace_back(x + s.tile, y, z);
  }
  return path;
}

std::vector<std::string> Sheet::cable_names() const {
  std::vector<std::string> names;
  for (int i = 1; i <= rows; ++i) names.push_back(fmt::format("row_{}", i));
  return names;
}

std::vector<Eigen::VectorXd> Sheet::cable(size_t index) const {
  const std::vector<Eigen::Vector3d> path = cable_path(*this, static_cast<int>(index), cable_height);
  return {path.begin(), path.end()};
}

}  // namespace taut
