#pragma once
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "calib/files/experiment.hpp"
#include "sim/files/toml_reader.hpp"

namespace taut {

/// How a material point is loaded. Tension and compression differ in the sign of the strain only.
enum class PointMode { tension, compression, shear };
/// "tension", "compression", "shear": the ids under which a bench file names them.
std::string_view name_of(PointMode mode);
/// The reverse, of a name that is one of those.
PointMode mode_named(const std::string& name);

/// Reads and checks an experiment file with geometry kind "uniaxial": title, data, materials (one), bench, free
/// parameters, variants and references. Throws InputError as read_experiment() does.
Experiment read_uniaxial(const TomlFile& file, const std::string& path);

}  // namespace taut
