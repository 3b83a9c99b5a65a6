#include "reports/simulation_report.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
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

/// "tip_angle goes from 0 deg at 0 mm of retraction to -89.2 deg at 17.1 mm", and what it reaches in between.
std::string course_of(const Series& x, const Series& y, const std::string& name) {
  std::vector<size_t> known;
  for (size_t k = 0; k < y.values.size(); ++k) {
    if (std::isfinite(y.values[k])) known.push_back(k);
  }
  if (known.empty()) return name + " has no value";
  const size_t first = known.front(), last = known.back();
  const auto at = [&](size_t k) {
    return fmt::format("{} at {} {}", plot::shown_value(y, k), plot::label_of(x), plot::shown_value(x, k));
  };
  std::string text = fmt::format("{} goes from {} to {}", name, at(first), at(last));
  const double low = std::min(y.values[first], y.values[last]), high = std::max(y.values[first], y.values[last]);
  const auto [least, most] = std::ranges::minmax_element(known, {}, [&](size_t k) { return y.values[k]; });
  const double beyond = 0.02 * (y.values[*most] - y.values[*least]);
  if (y.values[*least] < low - beyond) text += fmt::format("; the least is {}", at(*least));
  if (y.values[*most] > high + beyond) text += fmt::format("; the most is {}", at(*most));
  return text;
}

/// What the scene asks: its plots in words, else its first channel.
std::optional<Section> question(const SimulationRecord& record) {
  const Series time{record.sample_name, record.sample_unit, record.sample_name, record.samples};
  const Series* driver = driver_of(record);
  std::vector<const Series*> all = all_series(record);
  all.push_back(&time);
  const auto named = [&](const std::string& id) {
    const auto found = std::ranges::find(all, id, &Series::id);
    return found != all.end() ? *found : driver != nullptr ? driver : &time;
  };
  std::vector<SimulationRecord::Plot> plots = record.plots;
  if (plots.empty() && !record.channels.empty()) plots.push_back({"", "", "", {record.channels.front().id}});
  // Several channels may have one meaning: "drop (displacement of module.tip)".
  const auto name_of_series = [&](const Series& y) {
    const std::string label = plot::label_of(y);
    const auto alike = std::ranges::count_if(all, [&](const Series* other) { return plot::label_of(*other) == label; });
    return alike > 1 ? fmt::format("{} ({})", y.id, label) : label;
  };
  std::string html;
  for (const SimulationRecord::Plot& plot : plots) {
    for (const std::string& y : plot.y) {
      const Series& x = *named(plot.x.empty() && driver != nullptr ? driver->id : plot.x);
      html += html::paragraph(fmt::format("{}{}{}.", plot.title, plot.title.empty() ? "" : ": ",
                                          course_of(x, *named(y), name_of_series(*named(y)))));
    }
  }
  if (html.empty()) return html_section(html::paragraph(record.description));
  return html_section(html::paragraph(record.description) + "<div class=\"answer\">\n" + html + "</div>\n");
}

std::optional<Section> how_computed(const SimulationRecord& record) {
  std::vector<html::Cells> rows = {
      {"Mesh", fmt::format("{} elements, {} nodes", record.mesh.element_count(), record.mesh.node_count())}};
  for (const auto& [fact, text] : record.facts) rows.push_back({fact, text});
  return Section{"<h2>How it was computed</h2>\n" + html::table({"", ""}, rows)};
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
      record.at_rest && record.sample_unit == "s"
          ? "The run is a sequence of equilibria: time only orders them, nothing in it says how fast it happens."
      : record.sample_unit == "s"
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

constexpr MakeSection<SimulationRecord> kPage[] = {question,     what_happens, what_it_gives,
                                                   how_computed, how_to_read,  origin};

std::string page_of(const SimulationRecord& record, const std::vector<Section>& sections) {
  const SampleLabel label(record);
  const Series* driver = driver_of(record);
  return html::page(
      "Simulation: " + record.title,
      html::paragraph("SIMULATION: everything below was computed from a model, nothing was measured.", "banner") +
          fmt::format("<h1>{}</h1>\n", escaped(record.title)) +
          html::paragraph(
              fmt::format("{} {} over {} from {} to {}, {} stored states; taut {}", record.samples.size(),
                          record.at_rest ? "equilibria" : "samples",
                          driver ? plot::label_of(*driver) : record.sample_name,
                          driver ? plot::shown_value(*driver, 0) : label(record.samples.front()),
                          driver ? plot::shown_value(*driver, driver->values.size() - 1) : label(record.samples.back()),
                          record.states.size(), record.version),
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
      if (!std::filesystem::exists(std::filesystem::path(folder) / "figures" / (figure.name + "." + format))) continue;
      files.push_back(fmt::format("figures/{}.{}", figure.name, format));
    }
  }
  write("report.html", page_of(record, sections));
  return files;
}

}  // namespace taut
