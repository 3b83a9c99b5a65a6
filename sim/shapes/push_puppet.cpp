#include "sim/shapes/push_puppet.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "sim/core/error.hpp"
#include "sim/mesh/mesh_budget.hpp"

namespace taut {
namespace {

void check_studs(const PushPuppet& m) {
  const PushPuppetLayout at(m);
  for (const auto& [name, length] :
       {std::pair{"stud_thickness", m.stud_thickness}, std::pair{"stud_play", m.stud_play}}) {
    if (!(length > 0.0) || !std::isfinite(length)) {
      refuse_module(fmt::format("{} is {}; studs need a positive one (stud_length = \"0 mm\" leaves studs out)", name,
                                in_mm(length)));
    }
  }
  const double thin = m.lip_thickness - 2.0 * m.lip_relief;
  if (m.stud_thickness >= thin) {
    refuse_module(
        fmt::format("a stud of stud_thickness {} does not fit on a left lip of {} (lip_thickness {} - 2 x lip_relief "
                    "{}); make the stud thinner than that",
                    in_mm(m.stud_thickness), in_mm(thin), in_mm(m.lip_thickness), in_mm(m.lip_relief)));
  }
  const double groove = m.stud_thickness + 2.0 * m.stud_play;
  if (groove >= m.lip_thickness) {
    refuse_module(
        fmt::format("a groove of {} (stud_thickness {} + 2 x stud_play {}) does not fit in a right lip of "
                    "lip_thickness {}; make stud or play smaller",
                    in_mm(groove), in_mm(m.stud_thickness), in_mm(m.stud_play), in_mm(m.lip_thickness)));
  }
  if (at.groove_depth + m.via_inset >= at.lip_length) {
    refuse_module(fmt::format(
        "a groove {} deep (stud_length {} + stud_play {}) and the via point via_inset {} behind it do not "
        "fit in lips that are {} long; make the studs shorter or gap_total smaller",
        in_mm(at.groove_depth), in_mm(m.stud_length), in_mm(m.stud_play), in_mm(m.via_inset), in_mm(at.lip_length)));
  }
}

}  // namespace

void refuse_module(const std::string& what) {
  throw InputError("push-puppet module: " + what);
}

PushPuppetLayout::PushPuppetLayout(const PushPuppet& m)
    : gap(m.gap_total / m.cells),
      lip_length(0.5 * (m.cell_length - gap)),
      lip_low(0.5 * m.core_height + m.clearance),
      lip_high(lip_low + m.lip_thickness),
      thin_low(lip_low + m.lip_relief),
      thin_high(lip_high - m.lip_relief),
      middle(lip_low + 0.5 * m.lip_thickness),
      groove_depth(m.stud_length > 0.0 ? m.stud_length + m.stud_play : 0.0),
      pitch(m.cell_length + m.web_thickness),
      tip(m.cells * pitch - m.web_thickness + m.plate_thickness) {}

std::vector<ShapeKey> PushPuppet::keys() {
  const Allowed positive = Allowed::positive(), any = Allowed::any();
  return {
      {"cells", &cells, Allowed::at_least(1, most_repeated), "foam cells, a web between two, a plate at either end",
       Quantity::pure},
      {"cell_length", &cell_length, positive, "foam between two webs"},
      {"core_height", &core_height, positive, "of the foam"},
      {"web_thickness", &web_thickness, positive, "of the webs"},
      {"plate_thickness", &plate_thickness, positive, "of base and tip plate"},
      {"clearance", &clearance, positive, "between foam and lips"},
      {"lip_thickness", &lip_thickness, positive, "of the right lip of each gap"},
      {"lip_relief", &lip_relief, Allowed::zero_or_more(), "the left lip is that much thinner on both long sides"},
      {"gap_total", &gap_total, positive, "all gaps of one side together: what retraction closes"},
      {"cable_offset", &cable_offset, any, "the cables' distance from the axis"},
      {"via_inset", &via_inset, positive, "via points lie that far inside every lip's end"},
      {"stud_length", &stud_length, Allowed::zero_or_more(), "tongue on the left lip's end, groove in the right one"},
      {"stud_thickness", &stud_thickness, any, "of the tongue"},
      {"stud_play", &stud_play, any, "between the tongue and each side of its groove"},
      {"base_bracket", &base_bracket, any, "how far a bracket for a joint reaches out of the base plate"},
      {"tip_bracket", &tip_bracket, any, "the same at the tip plate"},
      {"bracket_height", &bracket_height, any, "of the brackets, across the axis, up to the next line of the mesh"},
  };
}

std::vector<MeshKey> PushPuppet::mesh_keys() const {
  return {size_of_elements,
          {MeshKey::count, "lip_cells", "elements through a lip's thickness at least", PushPuppetMesh().lip_cells}};
}

void PushPuppet::check() const {
  check_keys("push-puppet module");
  const PushPuppet& m = *this;
  if (!std::isfinite(m.cable_offset)) refuse_module("cable_offset is not a finite length");
  const PushPuppetLayout at(m);
  if (at.gap >= m.cell_length) {
    refuse_module(
        fmt::format("gap_total {} over {} cells opens {} in each, but cell_length is {}; make gap_total smaller than "
                    "{}",
                    in_mm(m.gap_total), m.cells, in_mm(at.gap), in_mm(m.cell_length), in_mm(m.cells * m.cell_length)));
  }
  const double thin = m.lip_thickness - 2.0 * m.lip_relief;
  if (!(thin > 0.0)) {
    refuse_module(
        fmt::format("lip_relief {} on both sides leaves nothing of lip_thickness {}; make lip_relief smaller than {}",
                    in_mm(m.lip_relief), in_mm(m.lip_thickness), in_mm(0.5 * m.lip_thickness)));
  }
  if (m.via_inset >= at.lip_length) {
    refuse_module(
        fmt::format("via_inset {} is not inside the lips, which are {} long ((cell_length {} - gap_total {} / {} "
                    "cells) / 2); make via_inset or gap_total smaller",
                    in_mm(m.via_inset), in_mm(at.lip_length), in_mm(m.cell_length), in_mm(m.gap_total), m.cells));
  }
  const double offset = std::abs(m.cable_offset);
  if (offset < at.thin_low || offset > at.thin_high) {
    refuse_module(
        fmt::format("cable_offset {} is outside the left lips, which go from {} to {}; put the cables in them",
                    in_mm(m.cable_offset), in_mm(at.thin_low), in_mm(at.thin_high)));
  }
  if (m.stud_length > 0.0) check_studs(m);
  if (!(m.base_bracket >= 0.0 && m.tip_bracket >= 0.0 && m.bracket_height > 0.0 &&
        m.bracket_height <= 2 * at.lip_high)) {
    refuse_module(fmt::format("brackets need a length of zero or more and a height above 0, at most the plates' {}",
                              in_mm(2 * at.lip_high)));
  }
}

Mesh PushPuppet::mesh(const MeshSettings& settings, bool contact, bool compensate) const {
  const PushPuppetMesh resolution{settings.size, count(settings, "lip_cells"), settings.order};
  if (!contact) return mesh_push_puppet(*this, resolution);
  const double inset = closing_inset(*this, contact_gap(settings, mesh_push_puppet(*this, resolution).diagonal()));
  return mesh_push_puppet(*this, resolution, compensate ? inset : 0.0);
}

double closing_inset(const PushPuppet& m, double contact_gap) {
  const double largest = std::min(0.5 * m.gap_total / m.cells, m.via_inset);
  if (contact_gap > largest) {
    throw InputError(fmt::format(
        "the contact gap of {:.4g} mm is too large for the module: faces would push each other at rest or lose "
        "their via points; set contact_gap below {:.4g} mm (half a gap between lips, and via_inset), or leave it out",
        1e3 * contact_gap, 1e3 * largest));
  }
  return 0.5 * resting_distance * contact_gap;
}

std::vector<Eigen::VectorXd> PushPuppet::cable(size_t index) const {
  const std::vector<Eigen::Vector2d> path = cable_path(*this, index == 0 ? 1 : -1);
  return {path.begin(), path.end()};
}

std::vector<Spine> PushPuppet::spines() const {
  if (stud_length > 0) throw InputError("a chain of beams has lips without studs; set stud_length = \"0 mm\"");
  const PushPuppetLayout at(*this);
  Spine spine;
  spine.clamped = "base";
  spine.loaded = "tip";
  spine.end = at.tip;
  spine.soft = "foam";
  spine.stiff = "plastic";
  for (int i = 0; i < cells; ++i) spine.spans.push_back({i * at.pitch, cell_length, core_height});
  spine.lips = Spine::Lips{at.lip_length, lip_thickness - 2 * lip_relief, at.thin_low, at.thin_high};
  return {spine};
}

std::vector<Eigen::Vector2d> cable_path(const PushPuppet& module, int side) {
  module.check();
  if (side != 1 && side != -1) refuse_module(fmt::format("cable side {}; +1 (upper) and -1 (lower) are allowed", side));
  const PushPuppetLayout at(module);
  const double y = side * std::abs(module.cable_offset);
  std::vector<Eigen::Vector2d> path{{-module.plate_thickness, y}};
  for (int k = 0; k < module.cells; ++k) {
    const double left = k * at.pitch;
    path.emplace_back(left + at.lip_length - module.via_inset, y);
    path.emplace_back(left + module.cell_length - at.lip_length + at.groove_depth + module.via_inset, y);
  }
  path.emplace_back(at.tip, y);
  return path;
}

namespace {

/// Lengths around the whole module.
std::vector<DimensionLine> lines_around(const PushPuppet& m, const PushPuppetLayout& at) {
  std::vector<DimensionLine> lines;
  const double high = at.lip_high, plate = m.plate_thickness;
  lines.push_back({DimensionLine::above, at.lip_length, at.lip_length + at.gap, high, "gap"});
  if (m.cells > 1) {
    const int web = m.cells / 2;  // the one after this many cells
    lines.push_back({DimensionLine::above, web * at.pitch - m.web_thickness, web * at.pitch, high, "web"});
  }
  lines.push_back({DimensionLine::above, at.tip - plate, at.tip, high, "plate"});
  lines.push_back({DimensionLine::below, 0, m.cell_length, -high, "cell"});
  if (m.cells > 1) lines.push_back({DimensionLine::below, 0, at.tip - plate, -high, "core"});
  lines.push_back({DimensionLine::below, -plate, at.tip, -high, "total"});
  lines.push_back({DimensionLine::right, -high, high, at.tip, "height"});
  return lines;
}

/// Lengths around the upper half of the first cell.
std::vector<DimensionLine> lines_of_gap(const PushPuppet& m, const PushPuppetLayout& at) {
  std::vector<DimensionLine> lines;
  const double lip = at.lip_length, face = lip + at.gap;  // the end faces of the left and the right lip
  if (at.groove_depth > 0) {
    const double tongue = 0.5 * m.stud_thickness, groove = tongue + m.stud_play;
    lines.push_back({DimensionLine::below, lip, lip + m.stud_length, at.middle - tongue, "stud"});
    lines.push_back({DimensionLine::below, face, face + at.groove_depth, at.middle - groove, "groove"});
    lines.push_back({DimensionLine::left, at.middle - tongue, at.middle + tongue, lip, "stud"});
    lines.push_back({DimensionLine::right, at.middle - groove, at.middle + groove, face, "groove"});
  }
  lines.push_back({DimensionLine::above, 0, lip, at.thin_high, "left lip"});
  lines.push_back({DimensionLine::above, lip, face, at.thin_high, "gap"});
  lines.push_back({DimensionLine::above, face, m.cell_length, at.lip_high, "right lip"});
  lines.push_back({DimensionLine::below, lip - m.via_inset, lip, std::abs(m.cable_offset), "via inset"});
  lines.push_back({DimensionLine::left, at.thin_low, at.thin_high, 0, "left lip"});
  if (m.lip_relief > 0) lines.push_back({DimensionLine::left, at.thin_high, at.lip_high, 0, "relief"});
  lines.push_back({DimensionLine::right, at.lip_low, at.lip_high, m.cell_length, "right lip"});
  lines.push_back({DimensionLine::right, 0.5 * m.core_height, at.lip_low, m.cell_length, "clearance"});
  return lines;
}

}  // namespace

std::optional<ShapeDrawing> PushPuppet::drawing() const {
  const PushPuppetLayout at(*this);
  const bool several = cells > 1;
  const double half = 0.5 * core_height;
  const double second = several ? at.pitch : 0.0, last = (cells - 1) * at.pitch;  // cells, where they begin
  ShapeDrawing drawing;
  drawing.summary =
      fmt::format("{} cell{}, gaps of one side {:.4g} mm in all", cells, several ? "s" : "", 1e3 * gap_total);
  drawing.lines = lines_around(*this, at);
  drawing.inner = {{second, second + cell_length, 0.4, -half, half, "core"},
                   {last, last + cell_length, several ? 0.62 : 0.75, 0, std::abs(cable_offset), "cable"}};
  drawing.axis = {-plate_thickness, at.tip};
  const double room = 0.55;  // of the walls beside the cell
  drawing.detail = {"One gap",
                    {-room * plate_thickness, half - 0.35 * (at.lip_high - half)},
                    {cell_length + room * (several ? web_thickness : plate_thickness), at.lip_high},
                    lines_of_gap(*this, at)};
  return drawing;
}

}  // namespace taut
