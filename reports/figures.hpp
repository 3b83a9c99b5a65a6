#pragma once
#include <optional>
#include <string>

#include "reports/axes.hpp"
#include "reports/gnuplot.hpp"
#include "reports/report.hpp"

/// What the figures have in common. Used inside reports/ only.
namespace taut::plot {

inline constexpr double kMillimetre = 1e-3;
inline constexpr double k95 = 1.959963984540054;  // 97.5 % quantile of the normal distribution
inline constexpr double kPageWidth = 960;         // px
inline constexpr double kTitle = 64;              // px, for the two lines of the title

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

/// The index of `item` in `list`, to whose end it goes when it is not there.
size_t place_in(std::vector<std::string>& list, const std::string& item);

/// Behind residuals in units of sigma: the band in which 95 % of them lie if all is right, and the line of none.
std::string expected_band();
std::string zero_line();

/// A CSV field; text is quoted when it must be, a number that is not finite is left empty.
std::string field(const std::string& text);
std::string field(double value);
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
