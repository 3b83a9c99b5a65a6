#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "reports/axes.hpp"
#include "reports/estimate_text.hpp"
#include "reports/html.hpp"
#include "reports/run_sections.hpp"

// The sections of a run's page that say what was measured, and how.
namespace taut {
using html::escaped;
using html::paragraph;
using html::table;

std::optional<Section> frequency_and_decay(const RunRecord& record) {
  if (record.swings.empty()) return std::nullopt;
  std::vector<std::vector<std::string>> rows;
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
  std::vector<std::string> header = {"#Line", "Trial", "Channel"};
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
  std::vector<std::vector<std::string>> rows;
  for (const ReadingRecord& r : record.readings) {
    std::vector<std::string> row = {std::to_string(r.line), r.trial, r.channel};
    for (size_t c = 0; c < factors.size(); ++c) row.push_back(fmt::format("{:.5g}", r.controls[c] / factors[c]));
    const double residual = r.measured - r.predicted;
    const WrittenUnit& unit = units.of(r.channel);
    const auto shown = [&](double value) {
      if (!std::isfinite(value)) return std::string("not known");
      return fmt::format("{:.3f}{}", value / unit.factor, units.common() ? "" : " " + unit.label);
    };
    row.insert(row.end(), {shown(r.measured), shown(r.sigma), shown(r.predicted), shown(residual),
                           std::isfinite(residual) ? fmt::format("{:+.2f}", residual / r.sigma) : "not known"});
    rows.push_back(row);
  }
  return Section{"<h2>Every reading</h2>\n" + table(header, rows)};
}

std::optional<Section> setup(const RunRecord& record) {
  std::string out;
  if (!record.setup.empty()) {
    std::vector<std::vector<std::string>> rows;
    for (const auto& [name, value] : record.setup) rows.push_back({name, value});
    out += "<h2>Set-up of the model</h2>\n" + table({"What", "How"}, rows);
  }
  if (!record.remarks.empty() || !record.fit.failures.empty()) {
    out += "<h2>Remarks</h2>\n<ul>\n";
    for (const auto& list : {record.remarks, record.fit.failures}) {
      for (const std::string& remark : list) out += "<li>" + escaped(remark) + "</li>\n";
    }
    out += "</ul>\n";
  }
  return html_section(out);
}

std::optional<Section> provenance(const RunRecord& record) {
  const Provenance& p = record.provenance;
  const FitResult& fit = record.fit;
  std::vector<std::string> libraries;
  for (const auto& [name, version] : p.libraries) libraries.push_back(name + " " + version);
  std::string all;
  for (const std::string& library : libraries) all += (all.empty() ? "" : ", ") + library;
  std::vector<std::vector<std::string>> rows = {
      {"taut", p.version + (p.commit.empty() ? "" : ", commit " + p.commit)},
      {"Command", "`" + p.command_line},
      {"Started", p.started},
      {"Machine", p.machine},
      {"Libraries", all},
      {"Random seed", p.seed == 0 ? "none, nothing in the fit is random" : std::to_string(p.seed)},
      {"Fit", fmt::format("{}; {} iterations, {} evaluations of the experiment, {} of them failed; {}",
                          name_of(fit.status), fit.iterations, fit.evaluations, fit.failed_evaluations, fit.message)},
      {"Time",
       fmt::format("{} in all; one cold replay of all readings {} with {} factorisations, the fit {} with {}, "
                   "profiles {} with {}",
                   with_unit(p.wall_seconds, "s", 3), with_unit(record.replay_seconds, "s", 3),
                   record.replay_factorisations, with_unit(fit.search.seconds, "s", 3), fit.search.factorisations,
                   with_unit(fit.profiles.seconds, "s", 3), fit.profiles.factorisations)}};
  std::string copies;
  for (const InputRecord& input : p.inputs) {
    rows.push_back({"Input " + input.path, "`SHA-256 " + input.sha256});
    copies += (copies.empty() ? "" : ", ") + input.copy;
  }
  if (!copies.empty()) rows.push_back({"Copies in this folder", copies});
  return Section{"<h2>Where this comes from</h2>\n" + table({"", ""}, rows)};
}

}  // namespace taut
