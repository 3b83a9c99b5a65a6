#include "reports/figures.hpp"

#include <fmt/format.h>

#include <cmath>
#include <filesystem>

namespace taut {
namespace plot {

std::string field(const std::string& text) {
  if (text.find_first_of(",\"\n\r") == std::string::npos) return text;
  std::string out = "\"";
  for (const char c : text) out += c == '"' ? std::string("\"\"") : std::string(1, c);
  return out + "\"";
}

std::string field(double value) {
  return std::isfinite(value) ? fmt::format("{:.10g}", value) : "";
}

Figure finished(Drawing drawing, const std::string& folder) {
  const std::filesystem::path figures = std::filesystem::path(folder) / "figures";
  const std::string& name = drawing.figure.name;
  write_file((figures / (name + ".csv")).string(), drawing.csv);
  write_file((figures / (name + ".gp")).string(), drawing.page.script(name));
  run_gnuplot(figures.string(), name);
  drawing.figure.svg = read_file((figures / (name + ".svg")).string());
  return std::move(drawing.figure);
}

}  // namespace plot

std::vector<Figure> draw_figures(const RunRecord& record, const std::string& folder) {
  std::vector<Figure> drawn;
  for (const auto& figure :
       {plot::force_displacement, plot::effective_stiffness, plot::residuals, plot::stress_strain, plot::recordings,
        plot::swings, plot::deformed_shapes, plot::profiles, plot::diagnostic, plot::variants}) {
    std::optional<plot::Drawing> drawing = figure(record);
    if (!drawing) continue;
    drawn.push_back(plot::finished(std::move(*drawing), folder));
    if (record.simulated) drawn.back().title = "SIMULATED DATA: " + drawn.back().title;
  }
  return drawn;
}

}  // namespace taut
