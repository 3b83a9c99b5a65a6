#pragma once
#include <string>
#include <vector>

#include "calib/benches/experiment.hpp"
#include "calib/models/rod.hpp"

namespace taut {

/// What a row reads.
struct RodChannel {
  RodPoint at;
  Eigen::Vector3d direction;  ///< in the world, unit length
  bool rotation = false;      ///< of the end face, about the direction
  bool from_rest = false;     ///< a displacement
};

/// The rod with its place in the world: x = origin + frame (rod's own coordinates). The frame may be a left-handed one.
struct PlacedRod {
  Rod rod;
  Eigen::Vector3d origin;
  Eigen::Matrix3d frame;
  std::vector<RodChannel> channels;

  /// 1 or -1.
  double handedness() const {
    const Eigen::Matrix3d& F = frame;
    return F(2, 2) * (F(0, 0) * F(1, 1) - F(1, 0) * F(0, 1)) + F(1, 2) * (F(2, 0) * F(0, 1) - F(0, 0) * F(2, 1)) +
           F(0, 2) * (F(1, 0) * F(2, 1) - F(2, 0) * F(1, 1));
  }
  /// What a channel of position reads at rest [m].
  double rest(const RodChannel& channel) const {
    return channel.direction.dot(origin + frame * (channel.at.offset + Eigen::Vector3d(0, 0, channel.at.s)));
  }
};

/// A reading, and how it changes where the unknowns change like columns of `dx`.
struct RowReading {
  double value = 0;
  double moved = 0;  ///< see RodProtocol::moved()
  Eigen::RowVectorXd slopes;
};

/// A channel's reading in a state.
RowReading reading_of(const PlacedRod& placed, const RodChannel& channel, const RodState& x, const Eigen::MatrixXd& dx);

/// Throws FileError: what no rod has, in that part of the file, and what takes it.
[[noreturn]] void refuse_rod(const Experiment& experiment, const std::string& part, const std::string& what);

/// Throws FileError for everything that no rod has.
void check_rod(const Experiment& experiment);

/// The rod of an experiment, with the channels, between nodes at these arc lengths [m].
PlacedRod place_rod(const Experiment& experiment, const std::vector<double>& nodes);

}  // namespace taut
