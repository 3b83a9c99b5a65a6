#pragma once
#include <optional>
#include <string>

#include "reports/gnuplot.hpp"
#include "reports/report.hpp"

/// The figures, one function each: a new one is written beside them and named in draw_figures(). Each returns nothing
/// when the record holds nothing to draw. Used inside reports/ only.
namespace taut::plot {

inline constexpr double kMillimetre = 1e-3;
inline constexpr double kPageWidth = 960;  // px
inline constexpr double kTitle = 64;       // px, for the two lines of the title

/// A figure before it is drawn.
struct Drawing {
  Figure figure;
  std::string csv;
  Page page;
};

/// Writes a figure's files into folder/figures and returns it with its SVG.
Figure finished(Drawing drawing, const std::string& folder);

std::optional<Drawing> force_displacement(const RunRecord& record);
std::optional<Drawing> effective_stiffness(const RunRecord& record);
std::optional<Drawing> residuals(const RunRecord& record);
std::optional<Drawing> stress_strain(const RunRecord& record);
std::optional<Drawing> deformed_shapes(const RunRecord& record);
/// The same as panels beside each other, with filled regions and cables: for several materials, cables or several held
/// values; else nothing.
std::optional<Drawing> shape_panels(const RunRecord& record);
std::optional<Drawing> variants(const RunRecord& record);
/// Rise of chi squared over the value of each parameter whose profile likelihood was searched; open ends are arrows.
std::optional<Drawing> profiles(const RunRecord& record);
/// Measured and simulated motion of each recording over time, with residuals below.
std::optional<Drawing> recordings(const RunRecord& record);
/// Frequency and decay of each recording, measured and simulated.
std::optional<Drawing> swings(const RunRecord& record);
/// Values of a parameter fitted to each part of the readings alone, beside the whole fit.
std::optional<Drawing> diagnostic(const RunRecord& record);

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
