#pragma once
#include <vector>

namespace taut {

/// A control over time: pieces one after the other, each from where the last one ended, so that it never jumps.
///
///   hold    the value stays
///   linear  straight to `target`
///   smooth  to `target` as (1 - cos)/2, with zero speed at both ends
///   sine    value + amplitude (sin(2 pi frequency t + phase) - sin(phase)), t from the piece's beginning
class ControlSchedule {
 public:
  /// As listed for the class.
  enum class Kind { hold, linear, smooth, sine };
  /// A part of the schedule; begins where the one before ends.
  struct Piece {
    Kind kind = Kind::hold;
    double until = 0;      ///< end [s]
    double target = 0;     ///< SI
    double amplitude = 0;  ///< SI
    double frequency = 0;  ///< [Hz]
    double phase = 0;      ///< [rad]
  };

  explicit ControlSchedule(double start = 0) : start_(start) {}  ///< the value before the first piece, SI
  /// Throws InputError unless each piece ends after the one before, and all numbers are finite.
  void add(const Piece& piece);
  /// Value at time t >= 0; after the last piece its end value.
  double at(double t) const;

 private:
  static double within(const Piece& piece, double begin, double value, double t);
  double start_;
  std::vector<Piece> pieces_;
};

}  // namespace taut
