#include "sim/shapes/sheet.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "sim/core/error.hpp"
#include "sim/mesh/mesh_budget.hpp"
#include "sim/mesh/structured.hpp"

namespace taut {
namespace {

/// Whether a coordinate is in a tile, or no farther from one than `beyond`.
bool in_tile(const Sheet& s, double x, double beyond = 0) {
  const double place = std::fmod(x, s.tile + s.strip);
  return place < s.tile + beyond || place > s.tile + s.strip - beyond;
}

/// Takes from lips what leans back from their faces' lower edges.
Eigen::VectorXd leant(const Sheet& s, Eigen::VectorXd at) {
  const double height = at[2] - (0.5 * s.thickness - s.lip_thickness), period = s.tile + s.strip;
  if (height <= 0) return at;
  const double shorter = std::tan(0.5 * s.lip_angle) * height / s.lip(), reach = s.lip() * (1 + 1e-9);
  for (const int i : {0, 1}) {
    const double place = std::fmod(at[i], period), after = place - s.tile, before = period - place;
    if (after > 0 && after <= reach) at[i] -= shorter * after;
    if (before <= reach) at[i] += shorter * before;
  }
  return at;
}

/// "plastic", "foam" or, beside and above the foam of a sheet with lips, "" for nothing.
std::string region_at(const Sheet& s, const Eigen::VectorXd& at) {
  if (in_tile(s, at[0]) && in_tile(s, at[1])) return "plastic";
  if (s.lip_gap == 0) return "foam";
  const double height = at[2] + 0.5 * s.thickness;
  if (height < s.foam_thickness) return "foam";
  const bool at_lips =
      height > s.thickness - s.lip_thickness && in_tile(s, at[0], s.lip()) && in_tile(s, at[1], s.lip());
  return at_lips ? "plastic" : "";
}

}  // namespace

std::vector<ShapeKey> Sheet::keys() {
  const Allowed any = Allowed::any(), positive = Allowed::positive(), counted = Allowed::at_least(1, most_repeated);
  return {
      {"columns", &columns, counted, "tiles along x", Quantity::pure},
      {"rows", &rows, counted, "tiles along y", Quantity::pure},
      {"tile", &tile, positive, "edge of the square tiles"},
      {"strip", &strip, positive, "foam between tiles"},
      {"thickness", &thickness, positive, "of the sheet"},
      {"cable_height", &cable_height, any, "of its own cables above the middle plane"},
      {"lip_gap", &lip_gap, Allowed::zero_or_more(), "between the lips of two tiles at the upper side; 0: no lips"},
      {"lip_thickness", &lip_thickness, positive, "of the lips"},
      {"lip_angle", &lip_angle, Allowed::zero_or_more(), "between the faces of two lips: where they meet flat",
       Quantity::angle},
      {"foam_thickness", &foam_thickness, positive, "of the foam under the lips, from the lower side"},
  };
}

std::vector<MeshKey> Sheet::mesh_keys() const {
  return {{MeshKey::count, "tile_cells", "along a tile", 1},
          {MeshKey::count, "strip_cells", "across a strip of foam", 2},
          {MeshKey::count, "layers", "through the thickness", 1}};
}

void Sheet::check() const {
  check_keys("sheet");
  if (lip_gap == 0) return;
  if (lip_gap >= strip)
    throw InputError(fmt::format("sheet: a lip_gap of {} leaves no lips over strips of {}; make it smaller",
                                 in_mm(lip_gap), in_mm(strip)));
  if (std::tan(0.5 * lip_angle) * lip_thickness >= lip())
    throw InputError(fmt::format("sheet: lips of {} lean back to nothing over {}; make lip_angle smaller", in_mm(lip()),
                                 in_mm(lip_thickness)));
  if (foam_thickness + lip_thickness > thickness)
    throw InputError(
        fmt::format("sheet: foam_thickness {} and lip_thickness {} are more than the thickness {} together; "
                    "make one of them smaller",
                    in_mm(foam_thickness), in_mm(lip_thickness), in_mm(thickness)));
}

Mesh Sheet::mesh(const MeshSettings& settings, bool, bool) const {
  check();
  check_counts("sheet", settings);
  const auto lines = [&](int tiles) {
    std::vector<double> x{0.0};
    for (int k = 0; k < tiles; ++k) {
      step_to(x, k * (tile + strip) + tile, count(settings, "tile_cells"));
      if (k + 1 == tiles) break;
      const int across = count(settings, "strip_cells");
      if (lip_gap > 0) {
        step_to(x, k * (tile + strip) + tile + lip(), across);
        step_to(x, (k + 1) * (tile + strip) - lip(), across);
      }
      step_to(x, (k + 1) * (tile + strip), across);
    }
    return x;
  };
  std::vector<double> z{-0.5 * thickness};
  const int layers = count(settings, "layers");
  if (lip_gap > 0) {
    step_to(z, foam_thickness - 0.5 * thickness, layers);
    if (foam_thickness + lip_thickness < thickness) step_to(z, 0.5 * thickness - lip_thickness, layers);
  }
  step_to(z, 0.5 * thickness, layers);
  Mesh sheet = box(lines(columns), lines(rows), z, settings.order, "foam");
  if (lip_gap > 0) sheet = part_of(sheet, [&](const Eigen::VectorXd& at) { return !region_at(*this, at).empty(); });
  assign_regions(sheet, [&](const Eigen::VectorXd& at) { return region_at(*this, at); });
  if (lip_gap > 0 && lip_angle > 0) map_vertices(sheet, [&](const Eigen::VectorXd& at) { return leant(*this, at); });
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
