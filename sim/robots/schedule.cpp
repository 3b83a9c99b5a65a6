#include "sim/robots/schedule.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "sim/core/error.hpp"

namespace taut {

void ControlSchedule::add(const Piece& piece) {
  for (double number : {piece.until, piece.target, piece.amplitude, piece.frequency, piece.phase}) {
    if (!std::isfinite(number)) throw InputError("a schedule holds a number that is not finite; give finite ones");
  }
  const double begin = pieces_.empty() ? 0.0 : pieces_.back().until;
  if (!(piece.until > begin)) {
    throw InputError(
        fmt::format("a piece until {:.6g} s does not end after {:.6g} s, where it begins; order the pieces "
                    "by time",
                    piece.until, begin));
  }
  pieces_.push_back(piece);
}

void ControlSchedule::set_target(size_t piece, double target) {
  if (!has_target(pieces_.at(piece)) || !std::isfinite(target))
    throw std::logic_error("a finite target is for a linear or smooth piece");
  pieces_[piece].target = target;
}

ControlSchedule ControlSchedule::by_target(size_t piece) const {
  ControlSchedule derivative = *this;
  derivative.start_ = 0;
  for (Piece& one : derivative.pieces_) one.target = one.amplitude = 0;
  derivative.set_target(piece, 1);
  return derivative;
}

double ControlSchedule::within(const Piece& piece, double begin, double value, double t) {
  const double fraction = (t - begin) / (piece.until - begin);
  switch (piece.kind) {
    case Kind::hold:
      return value;
    case Kind::linear:
      return value + fraction * (piece.target - value);
    case Kind::smooth:
      return value + 0.5 * (1 - std::cos(M_PI * fraction)) * (piece.target - value);
    case Kind::sine:
      break;
  }
  const double angle = 2 * M_PI * piece.frequency * (t - begin) + piece.phase;
  return value + piece.amplitude * (std::sin(angle) - std::sin(piece.phase));
}

double ControlSchedule::at(double t) const {
  double value = start_, begin = 0;
  for (const Piece& piece : pieces_) {
    value = within(piece, begin, value, std::min(t, piece.until));
    if (t <= piece.until) break;
    begin = piece.until;
  }
  return value;
}

}  // namespace taut
