#include "sim/scene/setup.hpp"

#include <algorithm>
#include <array>

namespace taut {
namespace {

using Kind = ChannelSettings::Kind;

struct KindRow {
  Kind kind;
  std::string_view name, unit;
};

constexpr std::array<KindRow, 10> kinds{{{Kind::displacement, "displacement", "m"},
                                         {Kind::position, "position", "m"},
                                         {Kind::rotation, "rotation", "rad"},
                                         {Kind::tension, "tension", "N"},
                                         {Kind::length, "length", "m"},
                                         {Kind::joint_gap, "joint_gap", "m"},
                                         {Kind::joint_angle, "joint_angle", "rad"},
                                         {Kind::joint_torque, "joint_torque", "Nm"},
                                         {Kind::reaction, "reaction", "N"},
                                         {Kind::net_force, "net_force", "N"}}};

const KindRow& row_of(Kind kind) {
  return *std::find_if(kinds.begin(), kinds.end(), [&](const KindRow& row) { return row.kind == kind; });
}

}  // namespace

std::string_view name_of(ChannelSettings::Kind kind) {
  return row_of(kind).name;
}

std::string_view unit_of(ChannelSettings::Kind kind) {
  return row_of(kind).unit;
}

}  // namespace taut
