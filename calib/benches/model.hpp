#pragma once
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "calib/benches/experiment.hpp"
#include "calib/benches/static_protocol.hpp"
#include "calib/data/trials.hpp"
#include "sim/scene/build_scene.hpp"

namespace taut {

/// The mesh of an experiment with the given settings. Throws InputError naming the experiment's file.
Mesh make_mesh(const Experiment& experiment, const MeshSettings& settings);

/// A plane experiment in space: one half of the body, 0 <= z <= thickness / 2, with `depth_cells` layers of elements,
/// held in z on its plane of symmetry. What is at a point of the plane is in that plane, z = 0, but a load at a point
/// acts all along the line through the thickness there. A support that fixes x and y fixes z too. Forces, masses and
/// cables count by half, readings are what they were. The thickness is no longer a parameter. Throws InputError for
/// experiments that are in space already, recordings, elastic clamps and obstacles.
Experiment as_solid(const Experiment& experiment, int depth_cells);

/// The mesh of a solid whose elements are about as long across its thickness as along it, at least two. Throws
/// InputError for geometries that are no plane sections or whose element size is not known.
MeshSettings deepened(const Experiment& experiment, MeshSettings mesh);

/// The setup of an experiment with its body, meshed by `settings`, and its controls, whose columns hold what `trials`
/// says.
Setup setup_of(const Experiment& experiment, const MeshSettings& settings, const Trials& trials);

/// The model of an experiment: its controls are those of experiment.bench, its readings have become channels.
struct BenchModel : BuiltScene {
  std::vector<NamedChannel> channels;
  std::map<double, int> zero_offsets;  ///< table index by the value of the control that they go with
};
/// With settings.depth_cells that of as_solid(). `trials` says what each control's column holds (force, mass, ...),
/// which decides what kind of load it is, and the values it takes. Its readings are not looked at. With `over_time` the
/// model has inertia and damping, and that function declares parameters of its own.
BenchModel make_model(const Experiment& experiment, const MeshSettings& settings, const Trials& trials,
                      const std::function<void(SceneBuilder&)>& over_time = nullptr);

/// Position of a control among experiment.bench.controls.
size_t position_of_control(const Experiment& experiment, const std::string& id);

}  // namespace taut
