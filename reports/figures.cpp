#include "reports/figures.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <mutex>
#include <utility>

#include "calib/data/files.hpp"
#include "sim/core/error.hpp"

namespace taut::plot {

namespace {

std::mutex undrawn_mutex;
std::string undrawn;  ///< why the first one could not be drawn

}  // namespace

std::string field(const std::string& text) {
  if (text.find_first_of(",\"\n\r") == std::string::npos) return text;
  std::string out = "\"";
  for (const char c : text) out += c == '"' ? std::string("\"\"") : std::string(1, c);
  return out + "\"";
}

std::string field(double value) {
  return std::isfinite(value) ? fmt::format("{:.10g}", value) : "";
}

size_t place_in(std::vector<std::string>& list, const std::string& item) {
  const auto found = std::ranges::find(list, item);
  if (found != list.end()) return static_cast<size_t>(found - list.begin());
  list.push_back(item);
  return list.size() - 1;
}

std::vector<size_t> evenly_chosen(size_t count, size_t most) {
  std::vector<size_t> chosen;
  const size_t kept = std::min(count, most);
  for (size_t i = 0; i < kept; ++i) chosen.push_back(kept == 1 ? 0 : (i * (count - 1) + (kept - 1) / 2) / (kept - 1));
  return chosen;
}

Grid::Grid(const Room& around, std::vector<LegendEntry> entries, size_t column_count)
    : room(around), legend(std::move(entries)), columns(column_count) {
  const double n = static_cast<double>(columns);
  legend_left = room.page - legend_width(legend, room.legend) - room.edge;
  across = (legend_left - room.right - room.left - room.gap * (n - 1)) / n;
}

Grid& Grid::rows(std::vector<double> heights) {
  tall = std::move(heights);
  height = kTitle + room.head + room.foot;
  for (const double row : tall) height += room.above + row + room.below;
  height = std::max(height, kTitle + legend_height(legend) + 60);
  return *this;
}

Grid& Grid::panels(size_t count, double each) {
  return rows(std::vector<double>(row_count(count, columns), each));
}

Box Grid::box(size_t i) const {
  const size_t row = i / columns;
  const double left = room.left + static_cast<double>(i % columns) * (across + room.gap);
  double top = height - kTitle - room.head - room.above;
  for (size_t r = 0; r < row; ++r) top -= tall[r] + room.below + room.above;
  return {left, top - tall[row], left + across, top};
}

Page Grid::page(const std::string& title, const std::string& subtitle, bool simulated, double down) const {
  Page page(room.page, height, title, subtitle, simulated);
  page.legend(legend_left, height - kTitle - down, legend);
  return page;
}

void Band::add(double x, double y, double half_x, double half_y) {
  middle.push_back({x, y});
  lower.push_back({x - half_x, y - half_y});
  upper.push_back({x + half_x, y + half_y});
}

void Band::draw(Page& page, const std::string& colour, Plots& plots) const {
  Rows around = lower;
  around.insert(around.end(), upper.rbegin(), upper.rend());
  page.add(plots, around, "filledcurves closed", colour);
  page.add(plots, middle, "lines lw 2", colour);
}

void append(Rows& lines, const Rows& line) {
  lines.insert(lines.end(), line.begin(), line.end());
  lines.push_back({});
}

Rows closed(Rows line) {
  if (!line.empty()) line.push_back(std::vector<double>(line.front()));
  return line;
}

std::optional<std::pair<Eigen::VectorXd, Eigen::VectorXd>> clipped(const Eigen::VectorXd& a, const Eigen::VectorXd& b,
                                                                   const Eigen::VectorXd& lower,
                                                                   const Eigen::VectorXd& upper) {
  double from = 0, to = 1;
  for (Eigen::Index axis = 0; axis < a.size(); ++axis) {
    for (const double sign : {1.0, -1.0}) {
      const double limit = sign > 0 ? lower[axis] : upper[axis];
      const double inside = sign * (a[axis] - limit), slope = sign * (b[axis] - a[axis]);
      if (slope == 0 && inside < 0) return std::nullopt;
      if (slope > 0) from = std::max(from, -inside / slope);
      if (slope < 0) to = std::min(to, -inside / slope);
    }
  }
  if (from >= to) return std::nullopt;
  return std::pair<Eigen::VectorXd, Eigen::VectorXd>(a + from * (b - a), a + to * (b - a));
}

void add_excluded(Page& page, const Rows& rows, Plots& plots) {
  if (rows.empty()) return;
  const std::string block = page.data(rows);
  for (const int mark : {symbol(0), kCross})
    plots.push_back(plotted(block, fmt::format("points pt {} ps 1 lw 1.2", mark), kGrey));
}

double half95(double standard_error) {
  return std::isfinite(standard_error) ? z95 * standard_error : 0;
}

std::string expected_band() {
  return shade("graph 0, first -2", "graph 1, first 2", "transparent solid 0.18", kGrey);
}

std::string zero_line() {
  return horizontal_line(0, kBlack);
}

void draw(Drawing& drawing, const std::string& folder) {
  const std::filesystem::path figures = std::filesystem::path(folder) / "figures";
  const std::string& name = drawing.figure.name;
  write_file((figures / (name + ".csv")).string(), drawing.csv);
  write_file((figures / (name + ".gp")).string(), drawing.page.script(name));
  try {
    run_gnuplot(figures.string(), name);
    drawing.figure.svg = read_file((figures / (name + ".svg")).string());
  } catch (const InputError& error) {
    const std::lock_guard lock(undrawn_mutex);
    if (undrawn.empty()) undrawn = error.what();
  }
}

Figure finished(Drawing drawing, const std::string& folder) {
  draw(drawing, folder);
  return std::move(drawing.figure);
}

}  // namespace taut::plot

namespace taut {

std::string undrawn_figures() {
  const std::lock_guard lock(plot::undrawn_mutex);
  return std::exchange(plot::undrawn, "");
}

}  // namespace taut
