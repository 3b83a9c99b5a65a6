#pragma once
#include <string>
#include <vector>

#include "calib/studies/module_chain.hpp"

// A calibrated module as the files of rigid-body simulators. SI throughout.
namespace taut {

/// What stands around a chain in its files.
struct ChainText {
  std::string name;        ///< of the model
  std::string title;       ///< of the run
  bool simulated = false;  ///< its readings were
  std::vector<AxisRecord> controls;
  size_t load = 0;      ///< position among the controls
  std::string channel;  ///< whose displacement the chain follows
};

/// "followed to within 3.2 % (largest, at 1.96 N of 0 to 4.9 N)": what is left between chain and replay.
std::string chain_difference(const ModuleChain& chain);

/// A model of MuJoCo (MJCF): bodies "segment_0" ... on hinges with stiffness and damping, geometry that is only seen
/// (contact is in the stiffness), cables as tendons without force, an actuator with the load's id whose control is the
/// force [N] along the load's direction, and a sensor with the channel's id that tells where its point is [m].
std::string mjcf(const ModuleChain& chain, const ChainText& text);

/// The same as URDF: links on revolute joints with damping; the frames "load" and "watched" are links without mass.
/// URDF has no stiffness of joints: it stands in a comment and in chain_table_csv(), and has to be set after loading.
std::string urdf(const ModuleChain& chain, const ChainText& text);

/// What differs between the states, a row each: what is held, `hinge_stiffness_Nm_per_rad`,
/// `hinge_damping_Nms_per_rad`, `largest_difference_%`, the largest force [N], the file.
std::string chain_table_csv(const std::vector<ModuleChain>& chains, const ChainText& text,
                            const std::vector<std::string>& files);

/// All that is known of the chains: hinges, segments (`inertia_kg_m2` as ChainSegment has it), the curve of the replay
/// and what the chain makes of it.
std::string chain_table_json(const std::vector<ModuleChain>& chains, const ChainText& text,
                             const std::vector<std::string>& files);

}  // namespace taut
