#pragma once
#include <fmt/format.h>

#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "sim/core/error.hpp"
#include "sim/scene/channel_kinds.hpp"
#include "sim/scene/scene.hpp"

namespace taut {

/// The model of a setup, and what its file's names mean in it.
struct BuiltScene {
  Scene scene;
  std::vector<SceneReading> readings;  ///< as setup.channels has them
  std::vector<Cable> cables;           ///< as setup.cables has them
  std::vector<Joint> joints;           ///< as setup.joints has them
  std::vector<int> controls;           ///< table index per control
  int gravity = -1;                    ///< table index
  std::vector<JoinedParts> joined;     ///< what joints connect, and where it does not see each other
  std::vector<int> off_at_rest;  ///< table indices of gravity and constant loads, of which the rest shape knows nothing
  Touching touching;             ///< what of the scene is contact
  const Contact* contact = nullptr;                          ///< lives in the scene; null: there is none, or a 3D one
  std::function<bool(const Eigen::VectorXd& u)> intersects;  ///< exact test of a state; empty: there is no contact
  std::function<double(const Eigen::VectorXd& u, double horizon)> smallest_distance;  ///< [m], looked for up to horizon
};

/// What a model is made for.
struct SceneOptions {
  bool over_time = false;                     ///< with inertia and damping
  FreeBodies free_bodies = FreeBodies::none;  ///< what becomes of bodies that nothing holds
  bool rigid_segments = false;  ///< regions over 100 times as stiff as the softest one move as rigid bodies
  double largest_force = 0;     ///< by loads [N]: what presses stiff faces together beside the soft bodies
  std::function<void(SceneBuilder&)> declare;  ///< further parameters, of the caller's own
};

/// Builds the model of a setup: the only way from a file to one. Controls are parameters of value zero. A body that is
/// one half of a solid (mesh.depth_cells) bears half of the forces, masses and cables; its readings are the whole
/// body's. Throws InputError with the file's name and the table for what does not fit: points outside their body,
/// cables through no body, bodies that overlap at rest, supports that leave rigid motions free.
BuiltScene build_scene(const Setup& setup, const SceneOptions& options);

/// Wrong input in a file, whose path stands before the reason.
class FileError : public InputError {
 public:
  /// `why` begins after the path.
  FileError(const std::string& path, std::string why) : InputError(path + ": " + why), reason(std::move(why)) {}
  std::string reason;
};

/// The regions that SceneOptions::rigid_segments makes rigid.
std::vector<std::string> rigid_regions(const Setup& setup);

/// Runs `action` and puts the file (and the part of it) in front of what goes wrong.
template <class Action>
auto at(const Setup& setup, const std::string& part, Action&& action) {
  try {
    return action();
  } catch (const InputError& error) {
    if (std::string_view(error.what()).starts_with(setup.path + ":")) throw;  // it says where, to the line
    throw FileError(setup.path, part + ": " + error.what());
  }
}

}  // namespace taut
