#pragma once
#include <string>
#include <utility>
#include <vector>

#include "calib/benches/static_protocol.hpp"
#include "sim/core/numbers.hpp"
#include "sim/solve/time_stepper.hpp"

namespace taut {

/// A motion that was recorded: what was set for it, how it was held, and when it was let go.
struct Recording {
  std::string id;
  std::vector<std::pair<int, double>> set;  ///< parameters with the values that they have here (a hung load)
  /// Parameters (first) that take the value of another one (second) here: a damping that each load case has for itself.
  /// No energy knows the second ones.
  std::vector<std::pair<int, int>> takes;
  /// The same for loads that act until the release and have their nominal value afterwards. None: the body is held in
  /// its rest shape, without loads; else in equilibrium with gravity, the set loads and these.
  std::vector<std::pair<int, int>> held;
  int release = -1;            ///< parameter that holds the time of the release on the recording's clock [s]; -1: 0
  double held_for = infinity;  ///< [s]; what relaxes has done so for as long when it is let go
};

/// One sample: what a channel showed at a time of the recording's clock.
struct RecordingRow {
  int recording = 0;
  int channel = 0;
  double time = 0;     ///< [s]; before the release nothing moves
  bool still = false;  ///< the motion has died out, and the body only creeps
};

/// Motions from a release at rest, u(0) held and v(0) = 0, by TimeStepper in fixed steps; recordings that differ in
/// their release time only share a trajectory. Between steps the state follows the cubic polynomial through u and v at
/// both ends, which is off by O(h^4), less than the steps' O(h^2) (O(h) with implicit Euler). Derivatives are those
/// of the steps (TimeStepper::track) and of that polynomial, exact to rounding; the one with respect to the release is
/// minus the channel's speed. What is read when the motion has come to rest is the end of as long a creep
/// (QuasiStatics), on which the release hardly bears. Trajectories run on all threads, whose number does not change a
/// bit of the result. A trajectory that fails leaves NaN in its rows and one sentence.
class RecordingProtocol final : public Protocol {
 public:
  /// How motions are computed.
  struct Options {
    Integrator integrator = Integrator::bdf2;
    double step = 2e-3;  ///< [s]
    EquilibriumOptions equilibrium;
    int threads = 0;  ///< 0: as many as there are cores
  };

  /// `off_at_rest` are the table indices of gravity and loads, of which the rest shape knows nothing. The model has
  /// inertia. Rows hold finite times.
  RecordingProtocol(Scene scene, std::vector<NamedChannel> channels, std::vector<int> off_at_rest,
                    std::vector<Recording> recordings, std::vector<RecordingRow> rows, Options options);

  const ParameterTable& parameters() const override { return scene_.model->parameters(); }
  const Params& nominal() const override { return scene_.values; }
  int row_count() const override { return static_cast<int>(rows_.size()); }
  Prediction predict(const Params& p, const std::vector<int>& free) override;
  int factorisations() const override { return factorisations_; }

  const Scene& scene() const { return scene_; }                             ///< the model with its nominal values
  const std::vector<Recording>& recordings() const { return recordings_; }  ///< as they were given
  const std::vector<RecordingRow>& rows() const { return rows_; }           ///< as they were given
  /// Recordings that differ in their release only share one.
  int trajectories() const { return static_cast<int>(trajectories_.size()); }
  int steps() const { return steps_; }  ///< of all trajectories since construction

 private:
  struct Trajectory {
    std::vector<int> recordings;
    std::vector<int> rows;
    double length = 0;  ///< of the last row's time: how dear it is
    int factorisations = 0, steps = 0;
    std::string failure;
  };
  Params parameters_of(const Trajectory& trajectory, const Params& p, bool held) const;
  Eigen::MatrixXd derivatives_of(const Trajectory& trajectory, const std::vector<int>& tracked, bool held) const;
  std::vector<int> tracked_by(const Trajectory& trajectory, const std::vector<int>& free) const;
  class Run;

  Scene scene_;
  std::vector<NamedChannel> channels_;
  std::vector<int> off_at_rest_;
  std::vector<Recording> recordings_;
  std::vector<RecordingRow> rows_;
  Options options_;
  std::vector<Trajectory> trajectories_;
  int factorisations_ = 0, steps_ = 0;
};

}  // namespace taut
