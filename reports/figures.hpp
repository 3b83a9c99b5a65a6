#pragma once
#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <functional>
#include <optional>
#include <string>

#include "calib/fit/distributions.hpp"
#include "reports/axes.hpp"
#include "reports/gnuplot.hpp"
#include "reports/report.hpp"

/// What the figures have in common. Used inside reports/ only.
namespace taut::plot {

inline constexpr double kMillimetre = 1e-3;       ///< [m]
inline constexpr double kPageWidth = 960;         ///< px
inline constexpr double kTitle = 64;              ///< px, for the two lines of the title
inline constexpr const char* kCable = "#d55e00";  ///< of cables

/// A figure before it is drawn.
struct Drawing {
  Figure figure;
  std::string csv;
  Page page;
};

/// Writes a figure's files into folder/figures and fills in its SVG.
void draw(Drawing& drawing, const std::string& folder);
/// The same for a figure by itself.
Figure finished(Drawing drawing, const std::string& folder);

/// The room around the panels of a grid [px].
struct Room {
  double left = 76, gap = 56;     ///< before the first column, between columns
  double above = 30, below = 58;  ///< of each row, for its titles and its axes
  double head = 0, foot = 0;      ///< above and below all rows, for what else stands there
  double right = 24, edge = 8;    ///< left and right of the legend
  double legend = 300;            ///< how wide the legend may be
  double page = kPageWidth;
};

/// Panels in rows, numbered row by row, with the legend to their right.
struct Grid {
  Room room;
  std::vector<LegendEntry> legend;
  size_t columns;
  double legend_left, across;  ///< of each panel [px]
  std::vector<double> tall;    ///< panels of each row [px]
  double height;               ///< of the page [px]

  /// One panel in each of `column_count` columns until rows() or panels() says more.
  Grid(const Room& around, std::vector<LegendEntry> entries, size_t column_count = 1);
  /// The heights of the rows, one after the other, or of all rows that `count` panels need. The page is as high as the
  /// legend at least.
  Grid& rows(std::vector<double> heights);
  Grid& panels(size_t count, double each);  ///< see rows()

  Box box(size_t i) const;                                    ///< the i-th panel
  bool leftmost(size_t i) const { return i % columns == 0; }  ///< whether it stands in the first column
  /// The page with its legend, `down` pixels below the title: a little below the upper edge of the first panel.
  Page page(const std::string& title, const std::string& subtitle, bool simulated, double down) const;
  /// The same with the usual room.
  Page page(const std::string& title, const std::string& subtitle, bool simulated) const {
    return page(title, subtitle, simulated, room.above + 6);
  }
};

/// How many rows `count` panels take.
inline size_t row_count(size_t count, size_t columns) {
  return (count + columns - 1) / columns;
}

/// A curve with the band around it, as lower and upper points.
struct Band {
  Rows middle, lower, upper;
  /// A point, and how far the band goes along either axis.
  void add(double x, double y, double half_x, double half_y);
  void draw(Page& page, const std::string& colour, Plots& plots) const;  ///< band first, then the line
};

/// Points of any type with two coordinates as rows, in another unit.
template <class Points>
Rows rows_in(double unit, const Points& points) {
  Rows rows;
  for (const auto& p : points) rows.push_back({p[0] / unit, p[1] / unit});
  return rows;
}

/// Adds a line, apart from those before it.
void append(Rows& lines, const Rows& line);
/// The line with its first point once more at the end.
Rows closed(Rows line);

/// Area within a closed line; negative where it runs clockwise.
template <class Points>
double signed_area(const Points& line) {
  double sum = 0;
  for (size_t i = 0; i < line.size(); ++i) {
    const auto &a = line[i], &b = line[(i + 1) % line.size()];
    sum += 0.5 * (a[0] * b[1] - b[0] * a[1]);
  }
  return sum;
}

/// The part of a straight line inside a box along the axes, of any dimension (Liang and Barsky).
std::optional<std::pair<Eigen::VectorXd, Eigen::VectorXd>> clipped(const Eigen::VectorXd& a, const Eigen::VectorXd& b,
                                                                   const Eigen::VectorXd& lower,
                                                                   const Eigen::VectorXd& upper);

inline constexpr const char* kFilled = "filledcurves closed fs solid 1 noborder";  ///< a closed line as an area

/// Areas of a signed `size` in the order in which they are filled: what lies in a hole comes after it.
template <class Areas>
void largest_first(Areas& areas) {
  std::ranges::stable_sort(areas, std::greater(), [](const auto& area) { return std::abs(area.size); });
}

inline constexpr int kCross = 2;  ///< gnuplot's number of the symbol of readings that are not fitted
/// Readings that are not fitted: hollow grey symbols with a cross; of x and y.
void add_excluded(Page& page, const Rows& rows, Plots& plots);

/// Half of a 95 % interval; nothing where the standard error is not known.
double half95(double standard_error);

/// The index of `item` in `list`, to whose end it goes when it is not there.
size_t place_in(std::vector<std::string>& list, const std::string& item);

/// About `most` of `count` items, evenly chosen, the first and the last among them.
std::vector<size_t> evenly_chosen(size_t count, size_t most);

/// Behind residuals in units of sigma: the band in which 95 % of them lie if all is right, and the line of none.
std::string expected_band();
std::string zero_line();  ///< see expected_band()

/// A CSV field; text is quoted when it must be, a number that is not finite is left empty.
std::string field(const std::string& text);
std::string field(double value);  ///< see field()
/// See field().
inline std::string field(int value) {
  return std::to_string(value);
}

/// Fields of any of these types as one line.
template <class... Fields>
std::string line(const Fields&... fields) {
  std::string out;
  ((out += field(fields) + ","), ...);
  out.back() = '\n';
  return out;
}

}  // namespace taut::plot
