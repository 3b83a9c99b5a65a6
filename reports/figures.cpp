#include "reports/figures.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

namespace taut::plot {

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

std::string expected_band() {
  return fmt::format(
      "set object rectangle from graph 0, first -2 to graph 1, first 2 behind fs transparent solid 0.18 "
      "noborder fc rgb '{}'\n",
      kGrey);
}

std::string zero_line() {
  return fmt::format("set arrow from graph 0, first 0 to graph 1, first 0 nohead lw 1.5 lc rgb '{}'\n", kBlack);
}

void draw(Drawing& drawing, const std::string& folder) {
  const std::filesystem::path figures = std::filesystem::path(folder) / "figures";
  const std::string& name = drawing.figure.name;
  write_file((figures / (name + ".csv")).string(), drawing.csv);
  write_file((figures / (name + ".gp")).string(), drawing.page.script(name));
  run_gnuplot(figures.string(), name);
  drawing.figure.svg = read_file((figures / (name + ".svg")).string());
}

Figure finished(Drawing drawing, const std::string& folder) {
  draw(drawing, folder);
  return std::move(drawing.figure);
}

}  // namespace taut::plot
