#include "reports/simulation_report.hpp"

#include <fmt/format.h>

#include <filesystem>

#include "reports/animation.hpp"
#include "reports/html.hpp"
#include "reports/simulation_figures.hpp"
#include "reports/vtu.hpp"

namespace taut {
namespace {

using html::escaped;

constexpr size_t kLargestInline = 2'000'000;  // bytes of a figure within the page

const char* const kStyle = R"(
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; color: #222;
  background: #fff; margin: 0 auto; padding: 1.5rem 1rem 4rem; max-width: 60rem; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { font-size: 1.25rem; margin: 2.4rem 0 .6rem; padding-bottom: .2rem; border-bottom: 1px solid #ddd; }
p, li { max-width: 46rem; }
.origin { color: #666; }
.banner { background: #d55e00; color: #fff; font-weight: 600; padding: .6rem 1rem; border-radius: .3rem; max-width: none; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .88rem; margin: .6rem 0; }
td { text-align: left; vertical-align: top; padding: .28rem .8rem .28rem 0; border-bottom: 1px solid #e6e6e6; }
figure { margin: 1.6rem 0; }
figure svg, figure img { width: 100%; height: auto; display: block; }
figcaption { margin-top: .6rem; color: #555; font-size: .92rem; max-width: 46rem; }
code, pre { font-family: ui-monospace, Menlo, Consolas, monospace; font-size: .85em; overflow-wrap: anywhere; }
pre { background: #f6f6f6; padding: .8rem; overflow-x: auto; }
@media print { body { font-size: 10.5pt; max-width: none; padding: 0; } figure, tr { break-inside: avoid; } #motion { display: none; } }
)";

std::string paragraph(const std::string& text, const char* kind = "") {
  return fmt::format("<p{}>{}</p>\n", *kind ? fmt::format(" class=\"{}\"", kind) : "", escaped(text));
}

std::string figure_html(const Figure& figure) {
  const std::string picture =
      figure.svg.size() <= kLargestInline
          ? html::inlined(figure.svg, figure.name, figure.title)
          : fmt::format("<img src=\"figures/{}.png\" alt=\"{}\">\n", escaped(figure.name), escaped(figure.title));
  return fmt::format("<figure>\n{}<figcaption>{}</figcaption>\n</figure>\n", picture, escaped(figure.caption));
}

std::string report(const SimulationRecord& record, const std::vector<Figure>& figures) {
  std::string out = fmt::format(
      "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
      "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>Simulation: {}</title>\n"
      "<style>{}</style>\n</head>\n<body>\n",
      escaped(record.title), kStyle);
  out += paragraph("SIMULATION: everything below was computed from a model, nothing was measured.", "banner");
  out += fmt::format("<h1>{}</h1>\n", escaped(record.title));
  const SampleLabel label(record);
  out += paragraph(fmt::format("{} samples over {} from {} to {}, {} stored states; taut {}", record.samples.size(),
                               record.sample_name, label(record.samples.front()), label(record.samples.back()),
                               record.states.size(), record.version),
                   "origin");
  out += paragraph(record.description);
  std::vector<std::vector<std::string>> rows = {
      {"Mesh", fmt::format("{} elements, {} nodes", record.mesh.element_count(), record.mesh.node_count())}};
  for (const auto& [fact, text] : record.facts) rows.push_back({fact, text});
  out += html::table({"", ""}, rows);
  out += "<h2>What happens</h2>\n" + animation_fragment(record);
  out += "<p><a href=\"animation.html\">The animation as a page of its own</a></p>\n";
  out += figure_html(figures.front());
  if (figures.size() > 1) out += "<h2>What it gives</h2>\n";
  for (size_t i = 1; i < figures.size(); ++i) out += figure_html(figures[i]);
  out += "<h2>How to read this</h2>\n<ul>\n";
  std::vector<std::string> hints = {
      "Displacements are drawn as they are, not magnified; lengths along all axes have one scale.",
      record.sample_unit == "s"
          ? "Curves and pictures are over simulated time."
          : fmt::format("The run is a sequence of equilibria over {}: nothing in it says how fast it happens.",
                        record.sample_name),
      "What was prescribed (controls) went into the model, everything else came out of it.",
      fmt::format("Every curve is a column of channels.csv; the numbers of each figure lie beside it in figures/. Open "
                  "{}.pvd with ParaView for all stored states with regions and displacements.",
                  file_name_of(record.name))};
  if (record.mesh.dimension() == 2) {
    hints.push_back("The model is plane: what is seen is a section, the same at every depth.");
  }
  for (const std::string& hint : hints) out += "<li>" + escaped(hint) + "</li>\n";
  out += "</ul>\n<h2>Where this comes from</h2>\n";
  rows.clear();
  if (!record.command_line.empty()) rows.push_back({"Command", "`" + record.command_line});
  if (!record.version.empty()) rows.push_back({"Version of taut", record.version});
  out += html::table({"", ""}, rows);
  if (!record.experiment_text.empty()) {
    out += "<details><summary>Experiment file</summary><pre>" + escaped(record.experiment_text) + "</pre></details>\n";
  }
  return out + "</body>\n</html>\n";
}

}  // namespace

std::string channels_csv(const SimulationRecord& record) {
  const std::vector<const Series*> all = all_series(record);
  std::string text = plot::field(record.sample_name + "_" + written_unit(record.sample_unit).suffix);
  for (const Series* series : all) text += "," + plot::field(series->id + "_" + written_unit(series->unit).suffix);
  text += "\n";
  for (size_t i = 0; i < record.samples.size(); ++i) {
    text += plot::field(record.samples[i] / written_unit(record.sample_unit).factor);
    for (const Series* series : all) text += "," + plot::field(series->values[i] / written_unit(series->unit).factor);
    text += "\n";
  }
  return text;
}

std::vector<std::string> write_simulation(const SimulationRecord& record, const std::string& folder) {
  check(record);
  std::vector<std::string> files;
  const auto write = [&](const std::string& name, const std::string& text) {
    write_file((std::filesystem::path(folder) / name).string(), text);
    files.push_back(name);
  };
  // Numbers first: a missing gnuplot must not cost a run.
  write("channels.csv", channels_csv(record));
  const std::string name = file_name_of(record.name);
  std::vector<std::pair<double, std::string>> collection;
  for (size_t f = 0; f < record.states.size(); ++f) {
    collection.emplace_back(record.samples[static_cast<size_t>(record.frames[f])],
                            fmt::format("frames/{}_{:04}.vtu", name, f));
    write(collection.back().second, vtu_text(record.mesh, record.states[f]));
  }
  write(name + ".pvd", pvd_text(collection));
  write("animation.html", animation_html(record));
  const std::vector<Figure> figures = plot::draw_simulation(record, folder);
  for (const Figure& figure : figures) {
    for (const char* format : {"svg", "pdf", "png", "csv", "gp"}) {
      files.push_back(fmt::format("figures/{}.{}", figure.name, format));
    }
  }
  write("report.html", report(record, figures));
  return files;
}

}  // namespace taut
