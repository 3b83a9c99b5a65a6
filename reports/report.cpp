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

/// For the heads of columns: a reading that there might be.
ReadingRecord any_reading(const RunRecord& record) {
  ReadingRecord reading;
  reading.controls.resize(record.controls.size());
  if (!record.channels.empty()) reading.channel = record.channels.front().id;
  return reading;
}

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
  const BenchColumns in_file(record, {"measured", "sigma", "predicted", "prediction_se", "residual"});
  const bool any_excluded = std::ranges::any_of(record.readings, &ReadingRecord::excluded);
  const bool any_marked =
      std::ranges::any_of(record.readings, [](const ReadingRecord& r) { return !r.equilibria.empty(); });
  const auto columns_of = [&](ReadingRecord reading, size_t place) {
    ReadingColumns columns{record, units};
    describe(columns, reading);
    for (const EnsembleRecord& ensemble : record.ensembles) {
      if (ensemble.bands.empty() || ensemble.bands.size() != record.readings.size()) continue;
      columns(ensemble.kind + "_lower95", ensemble.bands[place][0], InUnitOfChannel());
      columns(ensemble.kind + "_upper95", ensemble.bands[place][1], InUnitOfChannel());
    }
    const double residual = reading.measured - reading.predicted;
    columns("residual", residual, InUnitOfChannel());
    columns("normalised_residual", residual / reading.sigma);
    if (any_excluded) columns("excluded", static_cast<int>(reading.excluded));
    if (any_marked) columns("equilibria", reading.equilibria);
    columns.heads.back() = columns.fields.back() = '\n';
    // Behind a column of units, too, which goes with what stands before it.
    columns.heads = units.heads(columns.heads);
    if (record.channels.empty()) return columns;  // and no reading
    columns.fields = units.row(columns.fields, reading.channel);
    columns.heads.insert(columns.heads.size() - 1, in_file.heads());
    columns.fields.insert(columns.fields.size() - 1, in_file.fields(reading.controls, reading.channel,
                                                                    {reading.measured, reading.sigma, reading.predicted,
                                                                     reading.prediction_se, residual}));
    return columns;
  };
  std::string out = columns_of(any_reading(record), 0).heads;
  for (size_t i = 0; i < record.readings.size(); ++i) out += columns_of(record.readings[i], i).fields;
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
