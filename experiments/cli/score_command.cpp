#include <fmt/format.h>

#include <algorithm>
#include <boost/program_options.hpp>
#include <cmath>
#include <nlohmann/json.hpp>
#include <set>

#include "calib/studies/score.hpp"
#include "experiments/cli/commands.hpp"
#include "experiments/cli/print.hpp"
#include "reports/axes.hpp"
#include "sim/core/error.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

namespace po = boost::program_options;
using ScoreJson = nlohmann::ordered_json;

/// "5.89 mm"; zero in the unit of the largest value.
std::string value_text_of(const ScoreData& data, size_t control, double value) {
  const AxisRecord& axis = data.controls[control];
  if (value != 0 || !axis.labels.empty()) return text_of(axis, value);
  const std::set<double>& all = data.rig.control_values[control];
  return "0 " + display_unit(std::max(std::abs(*all.begin()), std::abs(*all.rbegin())), axis.unit).name;
}

/// "retraction 5.89 mm, mass 50 g"; controls that are not a number are left out.
std::string place_text(const ScoreData& data, const std::vector<double>& controls) {
  std::vector<std::string> words;
  for (size_t k = 0; k < controls.size(); ++k) {
    if (!std::isnan(controls[k])) words.push_back(data.controls[k].id + " " + value_text_of(data, k, controls[k]));
  }
  return join(words);
}

/// "3 to 5, 9": ascending lines of a file.
std::string line_ranges(const std::vector<int>& lines) {
  std::vector<std::string> words;
  for (size_t i = 0; i < lines.size();) {
    size_t end = i;
    while (end + 1 < lines.size() && lines[end + 1] == lines[end] + 1) ++end;
    words.push_back(end == i ? std::to_string(lines[i]) : fmt::format("{} to {}", lines[i], lines[end]));
    i = end + 1;
  }
  return join(words);
}

std::string chi_squared_text(double chi_squared, int readings, double p) {
  return fmt::format("chi squared {:.4g} for {} readings, p = {:.2g}", chi_squared, readings, p);
}

void print_closure(const Closure& closure, const ScoreData& data) {
  const AxisRecord& channel = data.channels[static_cast<size_t>(closure.channel)];
  const auto retraction = static_cast<size_t>(
      std::ranges::find_if(closure.held, [](double value) { return std::isnan(value); }) - closure.held.begin());
  const auto step = [&](const Closure::Step& one) {
    return fmt::format("from {} to {} (the displacement falls to 1/{:.3g})", value_text_of(data, retraction, one.from),
                       value_text_of(data, retraction, one.to), one.factor);
  };
  fmt::print("  closure of {} at {}: measured {}, predicted {}\n", channel.id, place_text(data, closure.held),
             step(closure.measured), step(closure.predicted));
  fmt::print("    at {}, closed, {} was measured and {} predicted\n", value_text_of(data, retraction, closure.at),
             with_unit(closure.reading, channel.unit), with_unit(closure.prediction, channel.unit));
}

void print_sim(const SimScore& sim, const ScoreData& data) {
  fmt::print("{}\n", sim.name);
  for (size_t c = 0; c < sim.channels.size(); ++c) {
    const ChannelScore& one = sim.channels[c];
    const AxisRecord& axis = data.channels[c];
    if (one.readings == 0) {
      fmt::print("  {}: no reading is scored\n", axis.id);
      continue;
    }
    fmt::print("  {}: RMSE {}, bias {}, {:.3g} % of the readings' spread, {} readings\n", axis.id,
               with_unit(one.rmse, axis.unit), with_unit(one.bias, axis.unit, 3), 100 * one.relative, one.readings);
    fmt::print("    largest miss {} at {} (line {}: {} measured, {} predicted)\n",
               with_unit(one.largest.predicted - one.largest.measured, axis.unit, 3),
               place_text(data, one.largest.controls), one.largest.line, with_unit(one.largest.measured, axis.unit),
               with_unit(one.largest.predicted, axis.unit));
    if (data.has_noise[c]) fmt::print("    {}\n", chi_squared_text(one.chi_squared, one.readings, one.p_value));
  }
  if (sim.channels.size() > 1 && std::isfinite(sim.chi_squared))
    fmt::print("  all: {}\n", chi_squared_text(sim.chi_squared, sim.readings, sim.p_value));
  for (const Closure& closure : sim.closures) print_closure(closure, data);
  if (!sim.unpredicted.empty())
    fmt::print("  it predicts nothing for line{} {} of the rig's file\n", sim.unpredicted.size() == 1 ? "" : "s",
               line_ranges(sim.unpredicted));
  if (!sim.unread.empty())
    fmt::print("  its line{} {} {} no reading at the rig\n", sim.unread.size() == 1 ? "" : "s", line_ranges(sim.unread),
               sim.unread.size() == 1 ? "has" : "have");
}

void print_ranking(const ScoreTable& table, const ScoreData& data) {
  std::vector<std::vector<std::string>> rows{{"", "file"}};
  for (const AxisRecord& channel : data.channels) rows[0].push_back("RMSE " + channel.id);
  rows[0].insert(rows[0].end(), {"of the spread", "chi squared"});
  for (const SimScore& sim : table.sims) {
    std::vector<std::string>& row = rows.emplace_back();
    row = {fmt::format("{}.", rows.size() - 1), sim.name};
    for (size_t c = 0; c < sim.channels.size(); ++c)
      row.push_back(with_unit(sim.channels[c].rmse, data.channels[c].unit));
    row.push_back(fmt::format("{:.3g} %", 100 * sim.relative));
    row.push_back(std::isfinite(sim.chi_squared) ? fmt::format("{:.4g}", sim.chi_squared) : "-");
  }
  std::vector<size_t> widths(rows[0].size(), 0);
  for (const auto& row : rows) {
    for (size_t i = 0; i < row.size(); ++i) widths[i] = std::max(widths[i], row[i].size());
  }
  for (const auto& row : rows) {
    std::string line;
    for (size_t i = 0; i < row.size(); ++i) line += fmt::format("{:<{}}  ", row[i], widths[i]);
    fmt::print("{}\n", line.substr(0, line.find_last_not_of(' ') + 1));
  }
}

void print_score(const ScoreTable& table, const ScoreData& data) {
  fmt::print("{}\n", join(data.remarks, "\n"));
  fmt::print("rows are matched by their controls, to {} of each one's largest value\n", same_control);
  const bool all = table.readings == table.available;
  fmt::print("scored: {} of {} readings{}\n", table.readings, table.available,
             all                      ? ""
             : table.sims.size() == 1 ? ", those that are predicted"
                                      : ", those that all files predict");
  bool any_noise = false;
  for (size_t c = 0; c < data.channels.size(); ++c) {
    const AxisRecord& axis = data.channels[c];
    const RepeatScatter& repeats = table.repeats[c];
    any_noise |= data.has_noise[c];
    if (repeats.dof == 0) {
      fmt::print("{}: nothing was repeated, so that the least possible miss is not known\n", axis.id);
      continue;
    }
    fmt::print("{}: repeats scatter by {} (standard deviation); no simulator can have an RMSE below {} here{}\n",
               axis.id, with_unit(repeats.standard_deviation, axis.unit, 3),
               with_unit(repeats.least_rmse, axis.unit, 3),
               data.has_noise[c] ? fmt::format(", or a chi squared below {:.4g}", repeats.least_chi_squared) : "");
  }
  if (!any_noise)
    fmt::print("no chi squared: no noise was given (--noise {}=\"...\", or --experiment)\n", data.channels.front().id);
  else
    fmt::print(
        "chi squared counts nothing as fitted: p is too large for a simulator that was fitted to these readings\n");
  if (table.sims.size() > 1) {
    fmt::print("\n");
    print_ranking(table, data);
  }
  for (const SimScore& sim : table.sims) {
    fmt::print("\n");
    print_sim(sim, data);
  }
}

/// NaN is null.
ScoreJson number_or_null(double value) {
  return std::isfinite(value) ? ScoreJson(value) : ScoreJson();
}

ScoreJson controls_json(const ScoreData& data, const std::vector<double>& controls) {
  ScoreJson json = ScoreJson::object();
  for (size_t k = 0; k < controls.size(); ++k) {
    if (std::isnan(controls[k])) continue;
    if (data.controls[k].labels.empty())
      json[data.controls[k].id] = controls[k];
    else
      json[data.controls[k].id] = text_of(data.controls[k], controls[k]);
  }
  return json;
}

ScoreJson closure_json(const Closure& closure, const ScoreData& data) {
  const auto step = [](const Closure::Step& one) {
    return ScoreJson{{"from", one.from}, {"to", one.to}, {"factor", one.factor}};
  };
  return {{"channel", data.channels[static_cast<size_t>(closure.channel)].id},
          {"held", controls_json(data, closure.held)},
          {"measured", step(closure.measured)},
          {"predicted", step(closure.predicted)},
          {"at", closure.at},
          {"measured_displacement_m", closure.reading},
          {"predicted_displacement_m", closure.prediction}};
}

ScoreJson sim_json(const SimScore& sim, const ScoreData& data) {
  ScoreJson json{{"file", sim.name},
                 {"readings", sim.readings},
                 {"relative", number_or_null(sim.relative)},
                 {"chi_squared", number_or_null(sim.chi_squared)},
                 {"p_value", number_or_null(sim.p_value)}};
  json["channels"] = ScoreJson::array();
  for (size_t c = 0; c < sim.channels.size(); ++c) {
    const ChannelScore& one = sim.channels[c];
    json["channels"].push_back({{"channel", data.channels[c].id},
                                {"unit", data.channels[c].unit},
                                {"readings", one.readings},
                                {"rmse", number_or_null(one.rmse)},
                                {"bias", number_or_null(one.bias)},
                                {"relative", number_or_null(one.relative)},
                                {"largest_miss",
                                 {{"line", one.largest.line},
                                  {"controls", controls_json(data, one.largest.controls)},
                                  {"measured", one.largest.measured},
                                  {"predicted", one.largest.predicted}}},
                                {"chi_squared", number_or_null(one.chi_squared)},
                                {"p_value", number_or_null(one.p_value)}});
  }
  json["unpredicted_lines"] = sim.unpredicted;
  json["unread_lines"] = sim.unread;
  json["closures"] = ScoreJson::array();
  for (const Closure& closure : sim.closures) json["closures"].push_back(closure_json(closure, data));
  return json;
}

ScoreJson score_json(const ScoreTable& table, const ScoreData& data, const std::string& rig) {
  ScoreJson json{{"rig", rig}, {"readings", table.available}, {"scored", table.readings}};
  json["remarks"] = data.remarks;
  json["matched_to"] = same_control;
  json["repeats"] = ScoreJson::array();
  for (size_t c = 0; c < data.channels.size(); ++c) {
    const RepeatScatter& one = table.repeats[c];
    json["repeats"].push_back({{"channel", data.channels[c].id},
                               {"unit", data.channels[c].unit},
                               {"degrees_of_freedom", one.dof},
                               {"standard_deviation", number_or_null(one.standard_deviation)},
                               {"least_rmse", number_or_null(one.least_rmse)},
                               {"least_chi_squared", number_or_null(one.least_chi_squared)}});
  }
  json["ranked"] = ScoreJson::array();
  for (const SimScore& sim : table.sims) json["ranked"].push_back(sim_json(sim, data));
  return json;
}

/// Scores predictions of other programs, and of taut's own, against a rig's readings.
int score_main(const CommandOptions& options) {
  if (options.further.empty())
    throw InputError(
        "taut score: SIM.csv is missing; name a table of predictions with the rig's controls and channels, or several");
  const ScoreData data =
      read_score({options.target, options.further, options.experiment, options.channels, options.set});
  const ScoreTable table = score(data.rig, data.sims, data.has_noise, data.closure);
  if (options.json)
    print_json(score_json(table, data, options.target));
  else
    print_score(table, data);
  return exit_ok;
}

void add_score_options(AddOption add, CommandOptions& options) {
  add("experiment", po::value(&options.experiment)->value_name("FILE"),
      "experiment file of that rig: which columns are what, their noise, retractions; default: the columns that both "
      "files have");
  add("channel", po::value(&options.channels)->value_name("COLUMN")->composing(),
      "a column that was measured, may be repeated; default: those whose predictions are no values of the rig's "
      "column");
  add_assignments(add, options.set, "noise", "standard deviation of a channel: \"0.02 mm\", \"1.5 %\", or both with +");
}

}  // namespace

Command score_command() {
  return {"score",
          "RIG.csv SIM.csv...",
          "Scores predictions of any simulator against a rig's readings: RMSE, bias, chi squared, ranking.",
          "  taut score bench.csv other_tool.csv --noise tip=\"0.02 mm\"\n"
          "  taut score bench.csv a.csv b.csv runs/module/predictions.csv --experiment experiment.toml --json\n",
          add_score_options,
          score_main,
          {&CommandOptions::target},
          true};
}

}  // namespace taut
