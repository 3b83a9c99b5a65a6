#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "reports/axes.hpp"
#include "reports/estimate_text.hpp"
#include "reports/html.hpp"
#include "reports/run_sections.hpp"
#include "sim/core/error.hpp"

// The sections of a run's page that say what was measured, and how.
namespace taut {
using html::Cells;
using html::paragraph;
using html::rows_of;
using html::table;

std::optional<Section> frequency_and_decay(const RunRecord& record) {
  if (record.swings.empty()) return std::nullopt;
  std::vector<Cells> rows;
  for (const SwingRecord& s : record.swings) {
    rows.push_back({s.recording, s.channel, fmt::format("{:.3f}", s.frequency),
                    fmt::format("{:.3f}", s.predicted_frequency), percent(s.predicted_frequency / s.frequency - 1),
                    fmt::format("{:.3f}", s.decay), fmt::format("{:.3f}", s.predicted_decay),
                    percent(s.predicted_decay / s.decay - 1)});
  }
  return with_figure(
      "<h2>Frequency and decay</h2>\n" +
          table({"Recording", "Channel", "#Frequency [Hz]", "#Simulated [Hz]", "#Differs by", "#Decay [1/s]",
                 "#Simulated [1/s]", "#Differs by"},
                rows) +
          paragraph(
              "Both by the same least-squares fit of offset, drift and one decaying oscillation to the samples and "
              "to the simulation at their times."),
      plot::swings(record));
}

std::optional<Section> every_reading(const RunRecord& record) {
  Cells header = {"#Line", "Trial", "Channel"};
  std::vector<double> factors;
  for (size_t c = 0; c < record.controls.size(); ++c) {
    double largest = 0;
    for (const ReadingRecord& r : record.readings) largest = std::max(largest, std::abs(r.controls.at(c)));
    const DisplayUnit unit = display_unit(largest, record.controls[c].unit);
    factors.push_back(unit.factor);
    header.push_back("#" + bracketed(record.controls[c].id, unit.name));
  }
  const ReadingUnits units(record);
  for (const char* what : {"#Measured", "#σ", "#Fitted", "#Residual"})
    header.push_back(bracketed(what, units.common() ? units.common()->label : ""));
  header.emplace_back("#Residual / σ");
  const auto row_of = [&](const ReadingRecord& r) {
    Cells row = {std::to_string(r.line), r.trial, r.channel};
    for (size_t c = 0; c < factors.size(); ++c) row.push_back(fmt::format("{:.5g}", r.controls[c] / factors[c]));
    const double residual = r.measured - r.predicted;
    const WrittenUnit& unit = units.of(r.channel);
    for (const double value : {r.measured, r.sigma, r.predicted, residual})
      row.push_back(std::isfinite(value)
                        ? fmt::format("{:.3f}{}", value / unit.factor, units.common() ? "" : " " + unit.label)
                        : "not known");
    row.push_back(std::isfinite(residual) ? fmt::format("{:+.2f}", residual / r.sigma) : "not known");
    if (!r.equilibria.empty()) row.back() += " (" + r.equilibria + ")";
    if (r.excluded) {
      for (std::string& cell : row) cell.insert(0, "~");
    }
    return row;
  };
  const std::string excluded = excluded_text(record);
  return Section{"<h2>Every reading</h2>\n" + table(header, rows_of(record.readings, row_of)) +
                 (excluded.empty() ? "" : paragraph(excluded))};
}

std::optional<Section> setup(const RunRecord& record) {
  std::string out;
  if (!record.setup.empty())
    out += "<h2>Set-up of the model</h2>\n" + table({"What", "How"}, rows_of(record.setup, [](const auto& line) {
                                                      return Cells{line.first, line.second};
                                                    }));
  std::vector<std::string> remarks = record.remarks;
  remarks.insert(remarks.end(), record.fit.failures.begin(), record.fit.failures.end());
  for (const EquilibriaRecord& rows : record.equilibria) remarks.push_back(rows.text);
  if (!remarks.empty()) out += "<h2>Remarks</h2>\n" + html::list(remarks);
  return html_section(out);
}

std::optional<Section> provenance(const RunRecord& record) {
  const Provenance& p = record.provenance;
  const FitResult& fit = record.fit;
  std::vector<std::string> libraries, copies;
  for (const auto& [name, version] : p.libraries) libraries.push_back(name + " " + version);
  std::vector<Cells> rows = {
      {"taut", p.version + (p.commit.empty() ? "" : ", commit " + p.commit)},
      {"Command", "`" + p.command_line},
      {"Started", p.started},
      {"Machine", p.machine},
      {"Libraries", join(libraries)},
      {"Random seed", p.seed == 0 ? "none, nothing in the fit is random" : std::to_string(p.seed)},
      {"Fit", fmt::format("{}; {} iterations, {} evaluations of the experiment, {} of them failed; {}",
                          name_of(fit.status), fit.iterations, fit.evaluations, fit.failed_evaluations, fit.message)},
      {"Time",
       fmt::format("{} in all; one cold replay of all readings {} with {} factorisations, the fit {} with {}, "
                   "profiles {} with {}",
                   with_unit(p.wall_seconds, "s", 3), with_unit(record.replay_seconds, "s", 3),
                   record.replay_factorisations, with_unit(fit.search.seconds, "s", 3), fit.search.factorisations,
                   with_unit(fit.profiles.seconds, "s", 3), fit.profiles.factorisations)}};
  for (const InputRecord& input : p.inputs) {
    rows.push_back({"Input " + input.path, "`SHA-256 " + input.sha256});
    copies.push_back(input.copy);
  }
  if (const std::string all = join(copies); !all.empty()) rows.push_back({"Copies in this folder", all});
  return Section{"<h2>Where this comes from</h2>\n" + table({"", ""}, rows)};
}

}  // namespace taut
