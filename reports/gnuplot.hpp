#pragma once
#include <string>
#include <string_view>
#include <vector>

/// What the figures need of gnuplot: a page with panels and a legend, laid out in pixels, so that nothing overlaps in
/// any format. Used inside reports/ only.
namespace taut::plot {

inline constexpr const char* kBlack = "#222222";  ///< of text and axes
inline constexpr const char* kGrey = "#6b6b6b";   ///< of what matters less

/// Colours that the colour-blind tell apart (Okabe and Ito), repeated from the eighth on.
std::string colour(size_t i);
/// Light green to dark violet in `count` steps (viridis), for quantities that have an order.
std::string ordered_colour(size_t i, size_t count);
/// Light fill of a region: sand for foam, blue-grey for plastic, others in order of `i`.
std::string region_colour(std::string_view name, size_t i);
/// gnuplot's number of the i-th symbol; open ones first, since they show what they cover.
int symbol(size_t i);

/// A single-quoted gnuplot string.
std::string literal(std::string_view text);
/// At most `length` characters, the last one an ellipsis when something was cut off.
std::string shortened(const std::string& text, size_t length);
/// Characters, not bytes.
size_t length_of(std::string_view utf8);

/// Rows of numbers; an empty one interrupts a line.
using Rows = std::vector<std::vector<double>>;

/// What a panel draws, in the order of painting: "$d1 using 1:2 with lines".
using Plots = std::vector<std::string>;

/// A plot of columns of a block of data in one of gnuplot's styles: "lines lw 2", "points pt 6".
std::string plotted(const std::string& block, const std::string& style, const std::string& colour,
                    const std::string& columns = "1:2");

/// An axis of a panel.
struct Axis {
  std::string label;
  double low = 0, high = 1;
  double step = 0.2;  ///< between tics; on a logarithmic axis only where it spans less than a factor of five
  bool logarithmic = false;
};

/// The axis that shows all finite `values` with a little room and about `tics` round tics; from zero on request.
Axis axis_over(std::vector<double> values, std::string label, int tics, bool with_zero);
Axis logarithmic_axis_over(const std::vector<double>& values, std::string label);  ///< the same in decades

/// Gives both axes one scale in a panel `across` wide, and returns its height: that of the data, within limits [px].
double to_one_scale(Axis& x, Axis& y, double across, double least, double most);

// gnuplot commands for one panel.

/// Names along an axis instead of numbers.
std::string named_tics(char axis, const std::vector<std::pair<std::string, double>>& names);
/// A line through a whole panel at a value of y, or of x; `more` is gnuplot's ("dt (6,4)").
std::string horizontal_line(double y, const std::string& colour, const std::string& more = "");
/// See horizontal_line().
std::string vertical_line(double x, const std::string& colour, const std::string& more = "");
inline constexpr const char* kDashed = "dt (6,4) ";  ///< a style of lines
/// An area behind the plots, between two of gnuplot's positions ("graph 0, first -2"); `fill` is its style of filling.
std::string shade(const std::string& from, const std::string& to, const std::string& fill, const std::string& colour);
/// A place at a value of an axis, or at a fraction of the panel.
std::string first(double value);
/// Numbers and names of the axes at the outer panels of a grid alone.
std::string outer_labels(Axis& x, Axis& y, bool lowest, bool leftmost);

/// A rectangle on the page in pixels, from its lower left corner.
struct Box {
  double left, bottom, right, top;
};

/// A line of the legend with the mark it explains.
struct LegendEntry {
  /// The mark before the words; a heading and a text have none.
  enum Kind { heading, text, line, dashes, band, area, hatch, arrow, point, bar_along_x, bar_along_y } kind;
  std::string label;
  std::string colour = kGrey;
  int symbol = 6;
};

inline constexpr double kLegendRow = 19;  ///< height of a line of the legend [px]

/// Pixels that a legend's lines need in height, and across, at most `limit`.
inline double legend_height(const std::vector<LegendEntry>& entries) {
  return kLegendRow * static_cast<double>(entries.size());
}
double legend_width(const std::vector<LegendEntry>& entries, double limit = 300);  ///< see legend_height()

/// A figure as a gnuplot script: panels, legend and data.
class Page {
 public:
  /// `simulated` is said beside the title.
  Page(double width, double height, const std::string& title, const std::string& subtitle, bool simulated);

  /// Adds rows of numbers and returns the name under which plots refer to them.
  std::string data(const Rows& rows);

  /// Adds a plot of rows; nothing without any.
  void add(Plots& plots, const Rows& rows, const std::string& style, const std::string& colour,
           const std::string& columns = "1:2");

  /// Its upper left corner at (left, top) [px].
  void legend(double left, double top, const std::vector<LegendEntry>& entries);

  /// Axes in `box` with `plots` ("$d1 using 1:2 with lines", drawn in this order); `extra` gnuplot lines come before
  /// and hold for this panel only if they set arrows, labels, objects or tics.
  void panel(const Box& box, const Axis& x, const Axis& y, const std::string& title, Plots plots,
             const std::string& extra = "");

  /// The script that draws NAME.svg, .pdf and .png into the current folder.
  std::string script(const std::string& name) const;

 private:
  std::string screen(double x, double y) const;
  /// The mark of a line of the legend, from its left end.
  void mark(const LegendEntry& entry, double left, double y);

  double width_, height_;
  std::string blocks_, marks_, panels_;
  int block_count_ = 0;
};

/// How long gnuplot may take for a figure [s]: TAUT_GNUPLOT_TIMEOUT, or two minutes.
double gnuplot_patience();

/// Runs NAME.gp in `folder`, once more where that fails or takes longer than `patience` [s]; it ends with this process.
/// Throws InputError with the remedy when gnuplot is missing or fails twice.
void run_gnuplot(const std::string& folder, const std::string& name, double patience = gnuplot_patience());

}  // namespace taut::plot
