#pragma once
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "calib/files/experiment.hpp"

namespace taut {

/// How a material point is loaded. Tension and compression differ in the sign of the strain only.
enum class PointMode { tension, compression, shear };
/// "tension", "compression", "shear": the ids under which a bench file names them.
std::string_view name_of(PointMode mode);
/// The reverse, of a name that is one of those.
PointMode mode_named(const std::string& name);

/// A [[fit.variant]]: the same fit with another law, or with the readings of some modes only.
struct UniaxialVariant {
  std::string name, law;
  std::map<std::string, double> constants;
  std::vector<PointMode> modes;
};

/// An experiment with geometry kind "uniaxial": title, data, materials (one), bench, free parameters and references of
/// `common` are used.
struct UniaxialExperiment {
  Experiment common;
  std::vector<UniaxialVariant> variants;
};

/// Whether the experiment file at `path` is of this kind. False when it cannot be read: read_experiment() says why.
bool is_uniaxial(const std::string& path);

/// Reads and checks an experiment file of this kind. Throws InputError as read_experiment() does.
UniaxialExperiment read_uniaxial(const std::string& path);

}  // namespace taut
