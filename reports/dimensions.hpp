#pragma once
#include <string>
#include <vector>

#include "sim/shapes/drawing.hpp"

/// Dimension lines around a drawing, as on an engineer's sheet. Used inside reports/ only.
namespace taut::plot {

/// A DimensionLine as it is drawn.
struct Dimension {
  using enum DimensionLine::Side;    ///< below, above, left, right
  using Side = DimensionLine::Side;  ///< the side of the body that it stands on
  Side side;
  double from, to;  ///< along the side [mm]
  double body;      ///< across it: where the extension lines begin [mm]
  std::string text;
};

/// Puts dimensions into rows beside the body so that neither numbers nor lines cover each other.
class Dimensions {
 public:
  static constexpr double spacing = 30;  ///< from one row to the next [px]

  /// At `scale` [px/mm].
  Dimensions(std::vector<Dimension> list, double scale);

  int rows(Dimension::Side side) const;  ///< how many rows a side takes
  /// Reach of numbers and arrows along the side, over all rows [px, from the side's coordinate 0].
  double lowest(Dimension::Side side) const;
  double highest(Dimension::Side side) const;  ///< see lowest()
  /// gnuplot's arrows and labels; the first row on each side lies `spacing` beyond these coordinates [mm].
  std::string drawn(double left, double below, double right, double above) const;

 private:
  struct Placed {
    int row, align;    ///< align of the number: 0 beside the line, 1 after it, -1 before it
    double low, high;  ///< what it covers [px]
  };
  Placed place(const Dimension& dimension) const;
  template <class Number, class Value>
  Number largest(Dimension::Side side, Number least, Value&& value) const;

  std::vector<Dimension> list_;
  std::vector<Placed> placed_;
  double scale_;
};

/// A vertical dimension inside the body, its number beside it.
std::string dimension_inside(double x, double from, double to, const std::string& text, double scale);

/// "4.3 mm"
std::string millimetres(double metres);

}  // namespace taut::plot
