#pragma once
#include <vector>

namespace taut {

/// Frequency and decay of a motion that rings down:
///
///   y(t) = offset + drift (t - t_0) + exp(-decay (t - t_0)) (a cos w (t - t_0) + b sin w (t - t_0)),   t_0 the first
///   time,
///
/// in least squares. The drift stands for a rest position that creeps. w = 2 pi frequency is that of the damped motion.
struct RingDown {
  double frequency = 0;  ///< [Hz]
  double decay = 0;      ///< [1/s]
  double amplitude = 0;  ///< at t_0, unit of y
  double offset = 0, drift = 0;
  double rms = 0;  ///< of what is left
  /// Part of critical damping: decay / sqrt(w^2 + decay^2).
  double damping_ratio() const;
};

/// One motion with one frequency, seen for a period at least, in three samples a period or more. Throws InputError for
/// fewer than 8 samples, times that do not ascend, and values that are not finite.
RingDown ring_down(const std::vector<double>& times, const std::vector<double>& values);

}  // namespace taut
