#include "sim/shapes/push_puppet_3d.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "sim/core/error.hpp"
#include "sim/mesh/structured.hpp"

namespace taut {
namespace {

const std::vector<std::string> parts_of_module{"whole", "half", "quarter"};

/// A foam cell along x from its left web's face, and what stands around the core by its distance from the core's side.
/// [m]
struct CellPlan {
  CellPlan(const PushPuppet& m, double inset) : at(m), length(m.cell_length) {
    const double core = 0.5 * m.core_height, middle = at.middle - core;
    left_end = at.lip_length - inset;
    right_end = length - at.lip_length + inset;
    thick = {at.lip_low - core, at.lip_high - core};
    thin = {at.thin_low - core, at.thin_high - core};
    if (at.groove_depth == 0) return;
    stud_end = left_end + m.stud_length;
    hole_end = right_end + at.groove_depth;
    const double stud = 0.5 * m.stud_thickness - inset, hole = 0.5 * m.stud_thickness + m.stud_play + inset;
    thin.insert(thin.begin() + 1, {middle - stud, middle + stud});
    thick.insert(thick.begin() + 1, {middle - hole, middle + hole});
  }

  bool has_studs() const { return at.groove_depth > 0; }
  /// Whether a point, given by its distances from the core's sides, is in the corner between the middle breaks.
  static bool in_corner(const std::vector<double>& breaks, double a, double b) {
    return std::min(a, b) > breaks[1] && std::max(a, b) < breaks[2];
  }

  /// The region of a point that is on no plane of the grid; "" outside.
  std::string region(double x, double a, double b) const {
    const double r = std::max(a, b);
    if (x < 0 || x > length) return "plastic";
    if (r < 0) return "foam";
    const bool left = x < left_end && r > thin.front() && r < thin.back();
    const bool right = x > right_end && r > thick.front() && r < thick.back();
    const bool hole = has_studs() && x < hole_end && in_corner(thick, a, b);
    const bool stud = has_studs() && x < stud_end && in_corner(thin, a, b);
    return left || stud || (right && !hole) ? "plastic" : "";
  }

  /// Whether a node outside the core belongs to a left lip or its stud, not to a right one.
  bool of_left(double x, double a, double b) const {
    if (x < 0.5 * (left_end + right_end)) return true;
    return has_studs() && x < 0.5 * (stud_end + hole_end) && in_corner(thick, a, b);
  }

  PushPuppetLayout at;
  double length, left_end, right_end, stud_end = 0, hole_end = 0;
  std::vector<double> thin, thick;  ///< where the faces of left and of right lips begin, change and end
};

/// Where a module is, by its cells.
struct ModulePlan {
  ModulePlan(const PushPuppet3d& m, double inset)
      : cell(m.section, inset),
        cells(m.section.cells),
        base(-m.section.plate_thickness),
        half{0.5 * m.section.core_height, 0.5 * m.core_depth} {}

  /// Of a place, its distance from the core's side along y (0) or z (1).
  double beside(const Eigen::VectorXd& place, int axis) const { return std::abs(place[axis + 1]) - half[axis]; }
  /// Along x from the left web of its cell; the webs and plates are before 0 and beyond the cell.
  double in_cell(double x) const {
    return x < 0 ? x : x - std::min(cells - 1.0, std::floor(x / cell.at.pitch)) * cell.at.pitch;
  }
  std::string region(const Eigen::VectorXd& place) const {
    return cell.region(in_cell(place[0]), beside(place, 0), beside(place, 1));
  }

  CellPlan cell;
  int cells;
  double base;
  std::array<double, 2> half;
};

/// Extends a grid's lines to planes at `breaks`, in whatever order.
void add_lines(std::vector<double>& lines, std::vector<double> breaks, double size, int at_least = 1) {
  std::sort(breaks.begin(), breaks.end());
  for (double end : breaks) {
    const double step = end - lines.back();
    if (step < 1e-12) continue;  // the same plane
    if (step < size / 500) {
      refuse_module(
          fmt::format("two of its faces lie in planes only {} apart, between which elements would be needles; change "
                      "stud_length, stud_thickness, stud_play, lip_relief or gap_total a little",
                      in_mm(step)));
    }
    step_to(lines, end, cells_along(step, size, at_least));
  }
}

/// Lines along x over the whole module.
std::vector<double> lines_along(const PushPuppet& m, const ModulePlan& plan, double size) {
  const CellPlan& cell = plan.cell;
  std::vector<double> lines{plan.base};
  step_to(lines, 0, cells_along(m.plate_thickness, size));
  for (int k = 0; k < m.cells; ++k) {
    const double left = k * cell.at.pitch;
    std::vector<double> breaks{left + cell.left_end, left + cell.right_end, left + cell.length};
    if (cell.has_studs()) breaks.insert(breaks.end(), {left + cell.stud_end, left + cell.hole_end});
    add_lines(lines, breaks, size);
    const bool last = k + 1 == m.cells;
    step_to(lines, last ? cell.at.tip : (k + 1) * cell.at.pitch,
            cells_along(last ? m.plate_thickness : m.web_thickness, size));
  }
  return lines;
}

/// Lines across the module on both sides of its middle; `half` of the core is on either side.
std::vector<double> lines_across(const CellPlan& cell, double half, const PushPuppetMesh& mesh) {
  std::vector<double> lines{0};
  step_to(lines, half, cells_along(half, mesh.size));
  step_to(lines, half + cell.thick.front(), cells_along(cell.thick.front(), mesh.size));
  std::vector<double> breaks = cell.thin;
  breaks.insert(breaks.end(), cell.thick.begin() + 1, cell.thick.end());
  for (double& one : breaks) one += half;
  if (cell.has_studs()) {
    add_lines(lines, breaks, mesh.size);
  } else {
    std::sort(breaks.begin(), breaks.end());
    add_lines(lines, {breaks[0]}, mesh.size);
    add_lines(lines, {breaks[1]}, mesh.size, mesh.lip_cells);
    add_lines(lines, {breaks[2]}, mesh.size);
  }
  std::vector<double> both;
  for (auto line = lines.rbegin(); line + 1 != lines.rend(); ++line) both.push_back(-*line);
  both.insert(both.end(), lines.begin(), lines.end());
  return both;
}

/// Moves a coordinate from the line of the grid that it is on, towards the rim (`way` 1) or the core (-1): nothing at
/// the breaks of a lip's face, between them up to a fifth of the spacing of nodes.
double unaligned(double coordinate, double half, const std::vector<double>& breaks, const std::vector<double>& lines,
                 int order, double way) {
  const double a = std::abs(coordinate) - half, sliver = 1e-6 * (breaks.back() - breaks.front());
  for (size_t i = 0; i + 1 < breaks.size(); ++i) {
    if (a < breaks[i] + sliver || a > breaks[i + 1] - sliver) continue;
    const auto inside = [&](double line) {
      return line - half > breaks[i] + sliver && line - half < breaks[i + 1] - sliver;
    };
    const double length = breaks[i + 1] - breaks[i], s = (a - breaks[i]) / length;
    const double spacing = length / static_cast<double>(order * (1 + std::ranges::count_if(lines, inside)));
    return std::copysign(std::abs(coordinate) + way * 0.2 * spacing * 4 * s * (1 - s), coordinate);
  }
  return coordinate;
}

}  // namespace

std::vector<ShapeKey> PushPuppet3d::keys() {
  std::vector<ShapeKey> keys = section.keys();
  std::erase_if(keys, [](const ShapeKey& key) { return key.key.find("bracket") != std::string_view::npos; });
  const auto after_height = std::ranges::find(keys, "core_height", &ShapeKey::key) + 1;
  keys.insert(after_height, {"core_depth", &core_depth, Allowed::positive(), "of the foam along z"});
  keys.push_back({"part", &part, Allowed::any(), "of the body: \"whole\", or by symmetry a \"half\" or a \"quarter\"",
                  Quantity::pure});
  return keys;
}

std::vector<MeshKey> PushPuppet3d::mesh_keys() const {
  return section.mesh_keys();
}

void PushPuppet3d::check() const {
  section.check();
  check_keys("push-puppet module");
  if (std::ranges::find(parts_of_module, part) == parts_of_module.end()) {
    refuse_module(
        fmt::format("part \"{}\"{}; allowed: {}", part, did_you_mean(part, parts_of_module), join(parts_of_module)));
  }
}

Mesh PushPuppet3d::mesh(const MeshSettings& settings, bool contact, bool compensate) const {
  const PushPuppetMesh resolution{settings.size, count(settings, "lip_cells"), settings.order};
  if (!contact) return mesh_push_puppet_3d(*this, resolution);
  const PushPuppetLayout at(section);
  const Eigen::Vector3d extent(section.plate_thickness + at.tip, 2 * at.lip_high,
                               2 * at.lip_high + core_depth - section.core_height);
  const double inset = closing_inset(section, contact_gap(settings, extent.norm()));
  return mesh_push_puppet_3d(*this, resolution, compensate ? inset : 0.0);
}

Mesh mesh_push_puppet_3d(const PushPuppet3d& module, const PushPuppetMesh& settings, double inset) {
  module.check();
  check_resolution(module.section, settings, inset);
  const ModulePlan plan(module, inset);
  const CellPlan& cell = plan.cell;
  const std::vector<double> x = lines_along(module.section, plan, settings.size);
  const std::array<std::vector<double>, 2> across{lines_across(cell, plan.half[0], settings),
                                                  lines_across(cell, plan.half[1], settings)};
  // The grid has as many cells on one side of the middle as on the other, so that its cuts are mirror images. A part is
  // cut out of the whole, whose elements it then has.
  Mesh mesh = part_of(box(x, across[0], across[1], 1, "plastic"), [&](const Eigen::VectorXd& place) {
    const bool kept = module.part == "whole" || (place[2] > 0 && (module.part == "half" || place[1] > 0));
    return kept && !plan.region(place).empty();
  });
  assign_regions(mesh, [&](const Eigen::VectorXd& place) { return plan.region(place); });
  // Frames start from their web on its lines and end on lines of their own, apart from those of the frame that they
  // meet.
  map_vertices(mesh, [&](const Eigen::VectorXd& place) {
    const double along = plan.in_cell(place[0]), a = plan.beside(place, 0), b = plan.beside(place, 1);
    Eigen::VectorXd moved = place;
    if (along <= 0 || along >= cell.length) return moved;
    const bool left = cell.of_left(along, a, b);
    const double way = left ? -std::min(1.0, along / cell.left_end)
                            : std::min(1.0, (cell.length - along) / (cell.length - cell.right_end));
    for (int axis = 0; axis < 2; ++axis) {
      moved[axis + 1] =
          unaligned(place[axis + 1], plan.half[axis], left ? cell.thin : cell.thick, across[axis], settings.order, way);
    }
    return moved;
  });
  mesh.tags.clear();  // those of the grid
  const Tag outer = boundary(mesh);
  const auto tag = [&](const char* name, int axis, double at) {
    mesh.tags[name] = outer.where([&](int node) { return mesh.X[3 * node + axis] == at; });
  };
  tag("base", 0, x.front());
  tag("tip", 0, x.back());
  tag("upper", 1, across[0].back());
  tag("front", 2, across[1].back());
  if (module.part != "quarter") tag("lower", 1, across[0].front());
  if (module.part == "whole") tag("back", 2, across[1].front());
  for (const SymmetryPlane& plane : module.symmetry()) tag(plane.tag.c_str(), plane.component, 0);
  return settings.order == 1 ? mesh : to_quadratic(mesh);
}

std::vector<SymmetryPlane> PushPuppet3d::symmetry() const {
  if (part == "whole") return {};
  if (part == "half") return {{"symmetry_z", 2}};
  return {{"symmetry_y", 1}, {"symmetry_z", 2}};
}

std::vector<std::string> PushPuppet3d::cable_names() const {
  std::vector<std::string> names{"upper_front", "lower_front", "upper_back", "lower_back"};
  names.resize(part == "whole" ? 4 : part == "half" ? 2 : 1);
  return names;
}

std::vector<Eigen::VectorXd> PushPuppet3d::cable(size_t index) const {
  const int up = index % 2 == 0 ? 1 : -1, forward = index < 2 ? 1 : -1;
  const double z = forward * (std::abs(section.cable_offset) + 0.5 * (core_depth - section.core_height));
  std::vector<Eigen::VectorXd> points;
  for (const Eigen::Vector2d& point : cable_path(section, up))
    points.emplace_back(Eigen::Vector3d(point[0], point[1], z));
  return points;
}

}  // namespace taut
