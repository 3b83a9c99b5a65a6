#pragma once
#include <Eigen/Core>
#include <atomic>
#include <functional>
#include <string>
#include <vector>

#include "sim/robots/robot.hpp"

namespace taut {

/// Places that can be reached in one mode of actuation.
struct WorkspaceResult {
  std::string mode;
  std::vector<Eigen::Vector2d> points;   ///< [m]; of the mode's own equilibria, then what else it holds
  std::vector<Eigen::Vector2d> outline;  ///< of what they cover, see reach_of() [m]
  double area = 0;                       ///< of what they cover [m^2]
  double area_error = 0;                 ///< largest change of it with half of the points or a disc of half the area
  int samples = 0;                       ///< equilibria of its own
  int failures = 0;                      ///< samples without an equilibrium
  int slips = 0;                         ///< samples that a jump from one path of equilibria to another led to
  int mirrored = -1;                     ///< each sample counts mirrored too: this coordinate changes sign; -1: none
  std::vector<std::string> holds;        ///< modes whose controls are among this one's: their points are its own, too
};

/// Samples the modes of [workspace]: equilibria at the ends of their ranges and along a curve through them, each from
/// the last one, so that each is where a robot would get to. Along the curve control k goes to and fro in a time of its
/// own, in proportion to 1/sqrt of the k-th prime, and dwells at its ends, where the border is made; a sample moves no
/// control by more than an eighth of its range. What they cover is drawn with a disc of a sixth of the scene's
/// diagonal.
///
/// A scene that is its own mirror image has a workspace that is, too: where controls exchanged (a cable for the one on
/// the other side) or reversed (a motor) mirror the tip across its place in the middle of the ranges, which two
/// equilibria have to show within 1e-3 of the diagonal, every sample counts twice.
///
/// `tell` is called before each mode. Ends early when `stop` is raised.
std::vector<WorkspaceResult> sample_workspaces(const Simulation& simulation, const Robot& robot,
                                               const std::function<void(const std::string& mode)>& tell = {},
                                               const std::atomic<bool>* stop = nullptr);

}  // namespace taut
