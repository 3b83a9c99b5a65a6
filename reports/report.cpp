#include "reports/report.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>

#include "reports/axes.hpp"
#include "reports/estimate_text.hpp"
#include "reports/html.hpp"
#include "reports/page_data.hpp"
#include "reports/run_record_members.hpp"
#include "reports/run_sections.hpp"

namespace taut {
namespace {

std::vector<Section> sections_of(const RunRecord& record) {
  return sections_of<RunRecord>(record, kRunPage, record.simulated ? "SIMULATED DATA: " : "");
}

std::string page_of(const RunRecord& record, const std::vector<Section>& sections) {
  using html::paragraph;
  std::string body;
  if (record.simulated)
    body += paragraph("SIMULATED DATA: the readings below come from a simulation, not from a bench.", "banner");
  body += fmt::format("<h1>{}</h1>\n", html::escaped(record.title));
  body += paragraph(fmt::format("{} readings, fitted with taut {} on {}", fitted_readings(record),
                                record.provenance.version, record.provenance.started),
                    "origin");
  return html::page(record.simulated ? "SIMULATED DATA: " + record.title : record.title,
                    body + html_of(sections) + interactive(record, sections));
}

/// Walks the members of a reading: a line of predictions.csv, and the heads of its columns.
struct ReadingColumns {
  const RunRecord& record;
  const ReadingUnits& units;
  std::string heads = {}, fields = {};

  bool there(const char*) const { return true; }
  void operator()(const std::string& name, const auto& value) {
    heads += name + ",";
    fields += plot::field(value) + ",";
  }
  void operator()(const std::string& name, double value, InUnitOfChannel) { (*this)(units.column(name), value); }
  void operator()(const std::string&, const std::vector<double>& controls) {
    for (const AxisRecord& control : record.controls) heads += control.id + "_" + column_suffix(control.unit) + ",";
    for (const double control : controls) fields += plot::field(control) + ",";
  }
};

}  // namespace

std::string report_html(const RunRecord& record) {
  return page_of(record, sections_of(record));
}

std::vector<Figure> write_report(const RunRecord& record, const std::string& folder) {
  std::vector<Section> sections = sections_of(record);
  std::vector<Figure> figures = draw(sections, folder);
  write_file((std::filesystem::path(folder) / "report.html").string(), page_of(record, sections));
  return figures;
}

std::string predictions_csv(const RunRecord& record) {
  const ReadingUnits units(record, ReadingUnits::si);
  const bool any_excluded = std::ranges::any_of(record.readings, &ReadingRecord::excluded);
  const bool any_marked =
      std::ranges::any_of(record.readings, [](const ReadingRecord& r) { return !r.equilibria.empty(); });
  const auto columns_of = [&](ReadingRecord reading, size_t place) {
    ReadingColumns columns{record, units};
    describe(columns, reading);
    for (const EnsembleRecord& ensemble : record.ensembles) {
      if (ensemble.bands.size() != record.readings.size()) continue;
      columns(ensemble.kind + "_lower95", ensemble.bands[place][0], InUnitOfChannel());
      columns(ensemble.kind + "_upper95", ensemble.bands[place][1], InUnitOfChannel());
    }
    const double residual = reading.measured - reading.predicted;
    columns("residual", residual, InUnitOfChannel());
    columns("normalised_residual", residual / reading.sigma);
    if (any_excluded) columns("excluded", static_cast<int>(reading.excluded));
    if (any_marked) columns("equilibria", reading.equilibria);
    columns.heads.back() = columns.fields.back() = '\n';
    return columns;
  };
  std::string out = units.heads(columns_of({}, 0).heads);
  for (size_t i = 0; i < record.readings.size(); ++i)
    out += units.row(columns_of(record.readings[i], i).fields, record.readings[i].channel);
  return out;
}

void write_run(const RunRecord& record, const std::string& folder) {
  const std::filesystem::path root(folder);
  // The result first: a missing gnuplot must not cost a fit.
  write_file((root / "fit.json").string(), to_json(record));
  write_file((root / "predictions.csv").string(), predictions_csv(record));
  write_report(record, folder);
}

}  // namespace taut
