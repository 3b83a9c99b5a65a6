#include "reports/simulation_report.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>

#include "reports/animation.hpp"
#include "reports/html.hpp"
#include "reports/section.hpp"
#include "reports/simulation_figures.hpp"
#include "reports/vtu.hpp"

namespace taut {
namespace {

using html::escaped;

constexpr size_t kLargestInline = 2'000'000;  // bytes of a figure within the page

std::optional<Section> overview(const SimulationRecord& record) {
  std::vector<html::Cells> rows = {
      {"Mesh", fmt::format("{} elements, {} nodes", record.mesh.element_count(), record.mesh.node_count())}};
  for (const auto& [fact, text] : record.facts) rows.push_back({fact, text});
  return Section{html::paragraph(record.description) + html::table({"", ""}, rows)};
}

std::optional<Section> what_happens(const SimulationRecord& record) {
  return with_figure("<h2>What happens</h2>\n" + animation_fragment(record) +
                         "<p><a href=\"animation.html\">The animation as a page of its own</a></p>\n",
                     plot::strip(record));
}

std::optional<Section> what_it_gives(const SimulationRecord& record) {
  Section section{"<h2>What it gives</h2>\n"};
  for (const SimulationRecord::Plot& plot : record.plots) section.figures.push_back(plot::asked_plot(record, plot));
  if (std::optional<plot::Drawing> drawing = plot::workspaces(record)) section.figures.push_back(std::move(*drawing));
  std::vector<std::string> units;
  for (const Series& channel : record.channels) {
    if (std::ranges::find(units, channel.unit) != units.end()) continue;
    units.push_back(channel.unit);
    section.figures.push_back(*plot::channels_of_unit(record, channel.unit));
  }
  return section.figures.empty() ? std::nullopt : std::optional(std::move(section));
}

std::optional<Section> how_to_read(const SimulationRecord& record) {
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
  if (record.mesh.dimension() == 2)
    hints.push_back("The model is plane: what is seen is a section, the same at every depth.");
  return Section{"<h2>How to read this</h2>\n" + html::list(hints)};
}

std::optional<Section> origin(const SimulationRecord& record) {
  std::vector<html::Cells> rows;
  if (!record.command_line.empty()) rows.push_back({"Command", "`" + record.command_line});
  if (!record.version.empty()) rows.push_back({"Version of taut", record.version});
  std::string html = "<h2>Where this comes from</h2>\n" + html::table({"", ""}, rows);
  if (!record.experiment_text.empty())
    html += "<details><summary>Experiment file</summary><pre>" + escaped(record.experiment_text) + "</pre></details>\n";
  return Section{html};
}

constexpr MakeSection<SimulationRecord> kPage[] = {overview, what_happens, what_it_gives, how_to_read, origin};

std::string page_of(const SimulationRecord& record, const std::vector<Section>& sections) {
  const SampleLabel label(record);
  return html::page(
      "Simulation: " + record.title,
      html::paragraph("SIMULATION: everything below was computed from a model, nothing was measured.", "banner") +
          fmt::format("<h1>{}</h1>\n", escaped(record.title)) +
          html::paragraph(fmt::format("{} samples over {} from {} to {}, {} stored states; taut {}",
                                      record.samples.size(), record.sample_name, label(record.samples.front()),
                                      label(record.samples.back()), record.states.size(), record.version),
                          "origin") +
          html_of(sections, kLargestInline));
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
  std::vector<Section> sections = sections_of<SimulationRecord>(record, kPage, "Simulation: ");
  for (const Figure& figure : draw(sections, folder)) {
    for (const char* format : {"svg", "pdf", "png", "csv", "gp"}) {
      files.push_back(fmt::format("figures/{}.{}", figure.name, format));
    }
  }
  write("report.html", page_of(record, sections));
  return files;
}

}  // namespace taut
