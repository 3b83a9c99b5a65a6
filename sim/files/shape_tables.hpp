#pragma once
#include "sim/shapes/finger.hpp"
#include "sim/shapes/push_puppet.hpp"
#include "sim/shapes/segmented_3d.hpp"

namespace taut {

class TableReader;

/// The keys of [geometry] with kind = "push_puppet": `cells` and the lengths of PushPuppet by their names ("11.5 mm");
/// what is left out is the reference module's. Throws InputError with file and line when a key's value is wrong or when
/// the numbers clash.
PushPuppet read_push_puppet(TableReader& table);
/// The same for kind = "finger".
Finger read_finger(TableReader& table);
/// The same for kind = "twist" and kind = "sheet".
TwistModule read_twist_module(TableReader& table);
Sheet read_sheet(TableReader& table);

}  // namespace taut
