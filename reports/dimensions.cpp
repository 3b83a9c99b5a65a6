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
constexpr const char* kFont = "font ',11'";

double text_width(const std::string& text) {
  return kText * static_cast<double>(length_of(text)) + 4;
}

/// An arrow along x or, `upright`, along y; `heads` is gnuplot's word for its ends.
std::string arrow(bool upright, double along0, double along1, double across, const char* heads, double scale) {
  const auto point = [&](double along) {
    return upright ? fmt::format("{:.8g},{:.8g}", across, along) : fmt::format("{:.8g},{:.8g}", along, across);
  };
  return fmt::format("set arrow from first {} to first {} {} size first {:.6g},16 filled front lw 1.1 lc rgb '{}'\n",
                     point(along0), point(along1), heads, 8 / scale, kBlack);
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

int Dimensions::rows(Dimension::Side side) const {
  int rows = 0;
  for (size_t i = 0; i < list_.size(); ++i) {
    if (list_[i].side == side) rows = std::max(rows, placed_[i].row + 1);
  }
  return rows;
}

double Dimensions::lowest(Dimension::Side side) const {
  double value = INFINITY;
  for (size_t i = 0; i < list_.size(); ++i) {
    if (list_[i].side == side) value = std::min(value, placed_[i].low);
  }
  return value;
}

double Dimensions::highest(Dimension::Side side) const {
  double value = -INFINITY;
  for (size_t i = 0; i < list_.size(); ++i) {
    if (list_[i].side == side) value = std::max(value, placed_[i].high);
  }
  return value;
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
      const double end = across + sign * 4 / scale_;
      const auto point = [&](double at) {
        return upright ? fmt::format("{:.8g},{:.8g}", at, along) : fmt::format("{:.8g},{:.8g}", along, at);
      };
      out += fmt::format("set arrow from first {} to first {} nohead front lw 0.7 lc rgb '{}'\n", point(d.body),
                         point(end), kGrey);
    }
    out += measured_line(upright, d.from, d.to, across, scale_);
    // Beyond the line, where no extension line of its own passes, or on its axis after an arrow that stands outside.
    double along = 0.5 * (d.from + d.to), beside = across;
    std::string adjust = "center";
    if (p.align == 0) {
      beside += sign * 10 / scale_;
    } else {
      along = p.align > 0 ? d.to + (kOutside + 4) / scale_ : d.from - (kOutside + 4) / scale_;
      adjust = p.align > 0 ? "left" : "right";
    }
    out += fmt::format("set label {} at first {:.8g},{:.8g} {}{} front {} tc rgb '{}'\n", literal(d.text),
                       upright ? beside : along, upright ? along : beside, adjust, upright ? " rotate by 90" : "",
                       kFont, kBlack);
  }
  return out;
}

std::string dimension_inside(double x, double from, double to, const std::string& text, double scale) {
  return measured_line(true, from, to, x, scale) +
         fmt::format("set label {} at first {:.8g},{:.8g} center rotate by 90 front {} tc rgb '{}'\n", literal(text),
                     x - 10 / scale, 0.5 * (from + to), kFont, kBlack);
}

}  // namespace taut::plot
