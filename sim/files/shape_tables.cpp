#include "sim/files/shape_tables.hpp"

#include <string_view>
#include <utility>

#include "sim/core/error.hpp"
#include "sim/files/toml_reader.hpp"

namespace taut {
namespace {

template <class Members, class Shape>
void read_members(TableReader& table, const Members& members, Quantity quantity, Shape& shape) {
  for (const auto& [key, member] : members)
    shape.*member = table.optional_quantity(key, quantity).value_or(shape.*member);
}

/// `shape` when its numbers fit together.
template <class Shape>
Shape checked(const TableReader& table, const Shape& shape) {
  try {
    check(shape);
  } catch (const InputError& error) {
    table.fail("", error.what());
  }
  return shape;
}

}  // namespace

PushPuppet read_push_puppet(TableReader& table) {
  PushPuppet module;
  module.cells = table.integer("cells", module.cells, 1);
  const std::pair<std::string_view, double PushPuppet::*> lengths[] = {
      {"cell_length", &PushPuppet::cell_length},     {"core_height", &PushPuppet::core_height},
      {"web_thickness", &PushPuppet::web_thickness}, {"plate_thickness", &PushPuppet::plate_thickness},
      {"clearance", &PushPuppet::clearance},         {"lip_thickness", &PushPuppet::lip_thickness},
      {"lip_relief", &PushPuppet::lip_relief},       {"gap_total", &PushPuppet::gap_total},
      {"cable_offset", &PushPuppet::cable_offset},   {"via_inset", &PushPuppet::via_inset},
      {"stud_length", &PushPuppet::stud_length},     {"stud_thickness", &PushPuppet::stud_thickness},
      {"stud_play", &PushPuppet::stud_play},         {"base_bracket", &PushPuppet::base_bracket},
      {"tip_bracket", &PushPuppet::tip_bracket},     {"bracket_height", &PushPuppet::bracket_height},
  };
  read_members(table, lengths, Quantity::length, module);
  return checked(table, module);
}

Finger read_finger(TableReader& table) {
  Finger finger;
  finger.segments = table.integer("segments", finger.segments, 2);
  const std::pair<std::string_view, double Finger::*> lengths[] = {
      {"segment_length", &Finger::segment_length},
      {"height", &Finger::height},
      {"hinge", &Finger::hinge},
      {"foam_height", &Finger::foam_height},
      {"lip_height", &Finger::lip_height},
      {"cable_depth", &Finger::cable_depth},
      {"via_inset", &Finger::via_inset},
  };
  const std::pair<std::string_view, double Finger::*> angles[] = {
      {"opening", &Finger::opening}, {"closing", &Finger::closing}, {"rest_turn", &Finger::rest_turn}};
  read_members(table, lengths, Quantity::length, finger);
  read_members(table, angles, Quantity::angle, finger);
  return checked(table, finger);
}

TwistModule read_twist_module(TableReader& table) {
  TwistModule module;
  module.cells = table.integer("cells", module.cells, 1);
  module.cables = table.integer("cables", module.cables, 1);
  const std::pair<std::string_view, double TwistModule::*> lengths[] = {
      {"cell_length", &TwistModule::cell_length},   {"core_width", &TwistModule::core_width},
      {"plate_width", &TwistModule::plate_width},   {"plate_thickness", &TwistModule::plate_thickness},
      {"rim_width", &TwistModule::rim_width},       {"rim_gap", &TwistModule::rim_gap},
      {"cable_radius", &TwistModule::cable_radius},
  };
  const std::pair<std::string_view, double TwistModule::*> angles[] = {{"cable_turn", &TwistModule::cable_turn}};
  read_members(table, lengths, Quantity::length, module);
  read_members(table, angles, Quantity::angle, module);
  return checked(table, module);
}

Sheet read_sheet(TableReader& table) {
  Sheet sheet;
  sheet.columns = table.integer("columns", sheet.columns, 1);
  sheet.rows = table.integer("rows", sheet.rows, 1);
  const std::pair<std::string_view, double Sheet::*> lengths[] = {
      {"tile", &Sheet::tile}, {"strip", &Sheet::strip}, {"thickness", &Sheet::thickness}};
  read_members(table, lengths, Quantity::length, sheet);
  return checked(table, sheet);
}

}  // namespace taut
