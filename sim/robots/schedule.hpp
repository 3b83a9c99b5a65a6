#pragma once
#include <cstddef>
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

  const std::vector<Piece>& pieces() const { return pieces_; }  ///< in their order
  double start() const { return start_; }                       ///< before the first piece, SI
  /// Whether a piece has a `target`: it is linear or smooth.
  static bool has_target(const Piece& piece) { return piece.kind == Kind::linear || piece.kind == Kind::smooth; }
  /// Gives piece number `piece` another target, finite, SI. Throws std::logic_error where it has none.
  void set_target(size_t piece, double target);
  /// The derivative of at(t) by the target of piece number `piece`, as a schedule: values are linear in all targets.
  ControlSchedule by_target(size_t piece) const;

 private:
  static double within(const Piece& piece, double begin, double value, double t);
  double start_;
  std::vector<Piece> pieces_;
};

}  // namespace taut
