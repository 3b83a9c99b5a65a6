#include "calib/push_puppet_settings.hpp"

#include <string_view>
#include <utility>

#include "calib/toml_reader.hpp"
#include "sim/core/error.hpp"

namespace taut {

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
      {"stud_play", &PushPuppet::stud_play},
  };
  for (const auto& [key, member] : lengths) {
    module.*member = table.optional_quantity(key, Quantity::length).value_or(module.*member);
  }
  try {
    check(module);
  } catch (const InputError& error) {
    table.fail("", error.what());
  }
  return module;
}

}  // namespace taut
