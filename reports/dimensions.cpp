#include "reports/dimensions.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "reports/gnuplot.hpp"

namespace taut::plot {
namespace {

constexpr double kText = 6.6;    // average width of a character of the numbers [px]
constexpr double kNarrow = 30;   // below this the arrows stand outside [px]
constexpr double kOutside = 18;  // length of an arrow that stands outside [px]
constexpr double kMargin = 8;    // between neighbours of one row [px]

double text_width(const std::string& text) {
  return kText * static_cast<double>(length_of(text)) + 4;
}

/// A point of a line along x or, `upright`, along y.
std::string point(bool upright, double along, double across) {
  return upright ? fmt::format("{:.8g},{:.8g}", across, along) : fmt::format("{:.8g},{:.8g}", along, across);
}

/// `heads` is gnuplot's word for the arrow's ends.
std::string arrow(bool upright, double along0, double along1, double across, const char* heads, double scale) {
  return fmt::format("set arrow from first {} to first {} {} size first {:.6g},16 filled front lw 1.1 lc rgb '{}'\n",
                     point(upright, along0, across), point(upright, along1, across), heads, 8 / scale, kBlack);
}

std::string number(const std::string& text, bool upright, double along, double across, const char* adjust) {
  return fmt::format("set label {} at first {} {}{} front font ',11' tc rgb '{}'\n", literal(text),
                     point(upright, along, across), adjust, upright ? " rotate by 90" : "", kBlack);
}

/// The line of one dimension with its arrow heads.
std::string measured_line(bool upright, double from, double to, double across, double scale) {
  if ((to - from) * scale >= kNarrow) return arrow(upright, from, to, across, "heads", scale);
  const double out = kOutside / scale;
  return arrow(upright, from - out, from, across, "head", scale) + arrow(upright, to + out, to, across, "head", scale) +
         arrow(upright, from, to, across, "nohead", scale);
}

}  // namespace

std::string millimetres(double metres) {
  return fmt::format("{:.4g} mm", 1e3 * metres);
}

Dimensions::Dimensions(std::vector<Dimension> list, double scale) : list_(std::move(list)), scale_(scale) {
  for (const Dimension& dimension : list_) placed_.push_back(place(dimension));
}

Dimensions::Placed Dimensions::place(const Dimension& d) const {
  const double from = d.from * scale_, to = d.to * scale_, width = text_width(d.text);
  const double out = to - from < kNarrow ? kOutside + 2 : 0;
  constexpr int most_rows = 8;
  Placed second_best{most_rows, 0, 0, 0};
  for (int row = 0; row < most_rows; ++row) {
    for (const int align : {0, 1, -1}) {
      if (align != 0 && out == 0) continue;  // numbers of wide ones stand over their line
      Placed candidate{row, align, from - out, to + out};
      if (align == 0) {
        candidate.low = std::min(candidate.low, 0.5 * (from + to - width));
        candidate.high = std::max(candidate.high, 0.5 * (from + to + width));
      } else {
        (align > 0 ? candidate.high : candidate.low) += align * (width + 4);
      }
      bool covered = false, crossed = false;
      for (size_t i = 0; i < placed_.size(); ++i) {
        const Placed& other = placed_[i];
        if (list_[i].side != d.side) continue;
        const auto inside = [](double place, const Placed& p) { return place > p.low - 3 && place < p.high + 3; };
        if (other.row == row) {
          covered = covered || (candidate.low < other.high + kMargin && other.low < candidate.high + kMargin);
        } else if (other.row < row) {  // my extension lines pass its number
          crossed = crossed || inside(from, other) || inside(to, other);
        } else {
          crossed = crossed || inside(scale_ * list_[i].from, candidate) || inside(scale_ * list_[i].to, candidate);
        }
      }
      if (covered) continue;
      if (!crossed) return candidate;
      if (second_best.row == most_rows) second_best = candidate;
    }
  }
  return second_best;
}

template <class Number, class Value>
Number Dimensions::largest(Dimension::Side side, Number least, Value&& value) const {
  for (size_t i = 0; i < list_.size(); ++i) {
    if (list_[i].side == side) least = std::max<Number>(least, value(placed_[i]));
  }
  return least;
}

int Dimensions::rows(Dimension::Side side) const {
  return largest(side, 0, [](const Placed& p) { return p.row + 1; });
}

double Dimensions::lowest(Dimension::Side side) const {
  return -largest<double>(side, -INFINITY, [](const Placed& p) { return -p.low; });
}

double Dimensions::highest(Dimension::Side side) const {
  return largest<double>(side, -INFINITY, [](const Placed& p) { return p.high; });
}

std::string Dimensions::drawn(double left, double below, double right, double above) const {
  std::string out;
  for (size_t i = 0; i < list_.size(); ++i) {
    const Dimension& d = list_[i];
    const Placed& p = placed_[i];
    const bool upright = d.side == Dimension::left || d.side == Dimension::right;
    const double sign = d.side == Dimension::below || d.side == Dimension::left ? -1 : 1;
    const double start = d.side == Dimension::below   ? below
                         : d.side == Dimension::above ? above
                         : d.side == Dimension::left  ? left
                                                      : right;
    const double across = start + sign * (p.row + 1) * spacing / scale_;
    for (const double along : {d.from, d.to}) {
      out += fmt::format("set arrow from first {} to first {} nohead front lw 0.7 lc rgb '{}'\n",
                         point(upright, along, d.body), point(upright, along, across + sign * 4 / scale_), kGrey);
    }
    out += measured_line(upright, d.from, d.to, across, scale_);
    // Beyond the line, where no extension line of its own passes, or on its axis after an arrow that stands outside.
    const double along =
        p.align == 0 ? 0.5 * (d.from + d.to) : (p.align > 0 ? d.to : d.from) + p.align * (kOutside + 4) / scale_;
    const double beside = p.align == 0 ? across + sign * 10 / scale_ : across;
    out += number(d.text, upright, along, beside, p.align == 0 ? "center" : p.align > 0 ? "left" : "right");
  }
  return out;
}

std::string dimension_inside(double x, double from, double to, const std::string& text, double scale) {
  return measured_line(true, from, to, x, scale) + number(text, true, 0.5 * (from + to), x - 10 / scale, "center");
}

}  // namespace taut::plot
