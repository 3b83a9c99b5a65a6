#pragma once
#include <Eigen/Core>
#include <Eigen/Geometry>
#include <string>
#include <vector>

#include "calib/models/hinge_chain.hpp"
#include "calib/studies/tuning.hpp"

// A calibrated module or beam, in one of its retractions, as the chain of rigid segments that other simulators take.
namespace taut {

/// What is taken where a run says nothing: written into every file.
inline constexpr double assumed_density = 1000;  ///< [kg/m3]
inline constexpr double assumed_damping = 0.1;   ///< of the chain's lowest mode, as a fraction of critical

/// Where the plane of the chain is in space: a point of it is origin + a along + b across. A plane model's x and y
/// become x and z, so that up is up; one in space keeps its coordinates.
struct ChainFrame {
  Eigen::Vector3d origin{0, 0, 0}, along{1, 0, 0}, across{0, 0, 1};
  Eigen::Vector3d normal() const { return along.cross(across); }  ///< about which positive turns are
  /// A point of the plane [m].
  Eigen::Vector3d point(const Eigen::Vector2d& at) const { return origin + at.x() * along + at.y() * across; }
  /// A vector in it.
  Eigen::Vector3d vector(const Eigen::Vector2d& v) const { return v.x() * along + v.y() * across; }
};

/// A rigid segment at rest in the chain; segment 0 is held.
struct ChainSegment {
  Eigen::Vector2d centre{0, 0};      ///< of mass [m]
  double angle = 0;                  ///< by which retraction alone has turned it [rad]
  double mass = 0;                   ///< [kg]
  Eigen::Vector3d inertia{0, 0, 0};  ///< about the centre, along its own two axes in the plane and the normal [kg m2]
  Eigen::Vector2d box_centre{0, 0};  ///< of the box around it, in the plane [m]
  Eigen::Vector3d half{0, 0, 0};     ///< half the sides of that box [m], as `inertia` has the axes
};

/// A cable's way through the segments.
struct ChainCable {
  std::string id;
  std::vector<HingeChain::Place> points;  ///< from its start on; the first ones may be fixed in space (segment 0)
  std::vector<double> off_plane;          ///< of each [m], along the normal
};

/// A module in one state of what is held, as a chain. The chain's rest shape is that of the retracted module without
/// loads and weight: hinges in the middle of each gap of a push-puppet module, or of each of n equal pieces of a beam.
/// The stiffness of all hinges is the one whose chain follows the replay best (fit_hinges()), at ten even loads up to
/// the largest.
struct ModuleChain {
  std::vector<double> controls;  ///< SI, in the order of Bench::controls(); that of the load is its largest
  std::string held;              ///< the others, in words: "retraction = 5.89 mm"
  ChainFrame frame;
  HingeChain chain;
  HingeCurve curve;
  HingeFit fit;
  std::vector<ChainSegment> segments;  ///< one more than hinges
  std::vector<ChainCable> cables;      ///< their pull is in the hinges' stiffness
  Eigen::Vector2d weight{0, 0};        ///< acceleration of gravity [m/s2]; zero: the run's model has no weight
  double lowest = 0, highest = 0;      ///< modes of the chain at rest without loads [rad/s]
  double damping = 0;  ///< of each hinge [N m s/rad]: assumed_damping of the lowest mode at rest, without loads
  std::vector<std::string> assumed;  ///< regions whose density is assumed_density
  bool slipped = false;              ///< the replay jumped to another equilibrium on its way
};

/// What is exported.
struct ModuleChainQuestion {
  std::vector<double> controls;  ///< what is held, SI, in the order of Bench::controls(); the load's does not count
  double largest = 0;            ///< load, as the bench has it, SI
  size_t channel = 0;            ///< displacement that the chain follows
  int hinges = 10;               ///< of what is no module
};

/// The chain of a run at these controls. Throws InputError for bodies that are neither push-puppet modules nor have a
/// straight axis, loads that nothing says the place of, channels that are no places, and as fit_hinges() does.
ModuleChain module_chain(const StiffnessReplay& replay, const ModuleChainQuestion& question);

}  // namespace taut
