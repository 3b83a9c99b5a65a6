#include "experiments/cli/plan_output.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "experiments/cli/bench_words.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

using PlanJson = nlohmann::ordered_json;

std::string minutes_text(double minutes) {
  return fmt::format("{:.4g}", minutes);
}

/// Cells in columns as wide as they need, numbers to the right.
void print_columns(const std::vector<std::vector<std::string>>& lines) {
  std::vector<size_t> widths(lines.front().size(), 0);
  for (const auto& line : lines) {
    for (size_t i = 0; i < line.size(); ++i) widths[i] = std::max(widths[i], line[i].size());
  }
  for (const auto& line : lines) {
    std::string text = " ";
    for (size_t i = 0; i < line.size(); ++i)
      text += i == 0 ? fmt::format(" {:<{}}", line[i], widths[i]) : fmt::format("  {:>{}}", line[i], widths[i]);
    fmt::print("{}\n", text.substr(0, text.find_last_not_of(' ') + 1));
  }
}

/// What the table of rows is under, for people: costs and what they are of.
std::string costs_text(const PlanReport& report, const Bench& bench) {
  std::vector<std::string> held;
  const size_t varied = varied_control(bench);
  for (size_t k = 0; k < bench.controls().size(); ++k) {
    if (k != varied) held.push_back(bench.controls()[k].id);
  }
  const PlanCosts& costs = report.task.costs;
  const std::string setup = held.empty() ? "once" : "for each " + join(held, " and ");
  return fmt::format("set-up {} min {} (--setup), rest {} min (--rest) and reading {} min (--reading) for each row",
                     minutes_text(costs.setup), setup, minutes_text(costs.rest), minutes_text(costs.reading));
}

void print_rows(const PlanReport& report, const Bench& bench) {
  std::vector<std::string> heads{"row"};
  for (const AxisRecord& control : bench.controls()) heads.push_back(control.id);
  for (const char* head : {"trial", "min", "sum", "by noise", "in all", "fails"}) heads.emplace_back(head);
  std::vector<std::vector<std::string>> lines{heads};
  const std::vector<int> trials = trials_of(report.rows);
  double before = 0;
  std::vector<size_t> so_far;
  for (size_t i = 0; i < report.rows.size(); ++i) {
    const PlanRow& row = report.task.rows[report.rows[i]];
    so_far.push_back(report.rows[i]);
    const double sum = minutes_of(report.task, so_far);
    std::vector<std::string>& cells = lines.emplace_back();
    cells.push_back(std::to_string(i + 1));
    for (size_t k = 0; k < row.controls.size(); ++k) cells.push_back(value_text(bench, k, row.controls[k]));
    cells.push_back(std::to_string(trials[i]));
    cells.push_back(minutes_text(sum - before));
    cells.push_back(minutes_text(sum));
    cells.push_back(width_text(report.goal, report.along[i].noise));
    cells.push_back(width_text(report.goal, report.along[i].total));
    cells.push_back(fmt::format("{:.0f} %", 100 * row.fails));
    before = sum;
  }
  print_columns(lines);
  std::set<std::string> reasons;
  for (const size_t row : report.rows) {
    if (!report.task.rows[row].why.empty()) reasons.insert(report.task.rows[row].why);
  }
  if (!reasons.empty())
    fmt::print("  fails: in so many of the draws ({})\n", join({reasons.begin(), reasons.end()}, "; "));
}

void print_quantities(const PlanReport& report) {
  std::vector<std::vector<std::string>> lines{{"", "value", "now, by noise", "then", "now, in all", "then"}};
  std::vector<PlannedQuantity> all = report.parameters;
  if (std::ranges::none_of(all, &PlannedQuantity::is_goal)) all.insert(all.begin(), report.goal);
  for (const PlannedQuantity& one : all)
    lines.push_back({one.id + (one.is_goal ? " (goal)" : ""), with_unit(one.value, one.unit),
                     width_text(one, one.before.noise), width_text(one, one.after.noise),
                     width_text(one, one.before.total), width_text(one, one.after.total)});
  fmt::print("expected 95 % half widths, before and after these rows:\n");
  print_columns(lines);
}

PlanJson widths_json(const PlanWidths& widths) {
  const auto number = [](double value) { return std::isfinite(value) ? PlanJson(value) : PlanJson(); };
  return {{"noise_half95", number(widths.noise)}, {"total_half95", number(widths.total)}};
}

PlanJson quantity_json(const PlannedQuantity& one) {
  return {{"id", one.id},
          {"unit", one.unit},
          {"value", one.value},
          {"logarithmic", one.logarithmic},
          {"before", widths_json(one.before)},
          {"after", widths_json(one.after)}};
}

}  // namespace

std::vector<int> trials_of(const std::vector<size_t>& rows) {
  std::map<size_t, int> seen;
  std::vector<int> trials;
  for (const size_t row : rows) trials.push_back(++seen[row]);
  return trials;
}

std::string width_text(const PlannedQuantity& quantity, double half) {
  if (!std::isfinite(half)) return "unknown";
  if (quantity.logarithmic && half > 0.5 * quantity.value)
    return fmt::format("factor {:.2g}", std::exp(std::min(half / quantity.value, 700.0)));
  const DisplayUnit unit = display_unit(quantity.value == 0 ? half : quantity.value, quantity.unit);
  return fmt::format("+- {:.2g}{}", half / unit.factor, unit.name == "1" ? "" : " " + unit.name);
}

void print_plan(const PlanReport& report, const Bench& bench) {
  if (report.simulated && !report.before_readings)
    fmt::print("SIMULATED DATA: the readings so far were made by a program, not measured.\n");
  fmt::print("goal: {} = {}, now {} by noise, {} in all (95 % half widths)\n", report.goal.id,
             with_unit(report.goal.value, report.goal.unit), width_text(report.goal, report.goal.before.noise),
             width_text(report.goal, report.goal.before.total));
  if (report.before_readings) {
    std::vector<std::string> priors;
    for (size_t j = 0; j < report.belief.parameters.size(); ++j) {
      const PlanBelief::Parameter& one = report.belief.parameters[j];
      const double deviation = report.belief.prior_deviations[static_cast<Eigen::Index>(j)];
      priors.push_back(fmt::format("{} {} {}", one.spec.id, with_unit(one.value, one.spec.unit),
                                   one.spec.logarithmic ? fmt::format("within a factor of {:.3g}", std::exp(deviation))
                                                        : "+- " + with_unit(deviation, one.spec.unit, 3)));
    }
    fmt::print("known before any reading (prior, one standard deviation): {}\n", join(priors));
  }
  fmt::print("read in each row: {}; {}\n", join(report.channels), costs_text(report, bench));
  if (!report.rows.empty()) {
    fmt::print("{} rows in {} min, the best of {} candidates ({}):\n", report.rows.size(),
               minutes_text(minutes_of(report.task, report.rows)), report.task.rows.size(),
               report.exhaustive ? "all combinations were looked at" : "greedy, then exchanges");
    print_rows(report, bench);
    print_quantities(report);
  }
  if (!report.comparisons.empty()) {
    fmt::print("instead, for the same time:\n");
    for (const PlanComparison& other : report.comparisons)
      fmt::print("  {}: {} rows in {} min, {} by noise, {} in all\n", other.what, other.rows,
                 minutes_text(other.minutes), width_text(report.goal, other.after.noise),
                 width_text(report.goal, other.after.total));
  }
  for (const std::string& note : report.notes) fmt::print("{}\n", note);
}

nlohmann::ordered_json plan_json(const PlanReport& report, const Bench& bench) {
  PlanJson json{
      {"title", report.title},
      {"data", report.before_readings ? "none"
               : report.simulated     ? "simulated"
                                      : "measured"},
      {"goal", quantity_json(report.goal)},
      {"channels", report.channels},
      {"costs_min",
       {{"setup", report.task.costs.setup}, {"rest", report.task.costs.rest}, {"reading", report.task.costs.reading}}},
      {"draws", report.task.known.size()},
      {"candidates", report.task.rows.size()},
      {"exhaustive", report.exhaustive}};
  if (report.before_readings) {
    for (size_t j = 0; j < report.belief.parameters.size(); ++j)
      json["prior"].push_back({{"id", report.belief.parameters[j].spec.id},
                               {"value", report.belief.parameters[j].value},
                               {"logarithmic", report.belief.parameters[j].spec.logarithmic},
                               {"deviation", report.belief.prior_deviations[static_cast<Eigen::Index>(j)]}});
  }
  for (const AxisRecord& control : bench.controls())
    json["controls"].push_back({{"id", control.id}, {"unit", control.unit}});
  json["rows"] = PlanJson::array();
  const std::vector<int> trials = trials_of(report.rows);
  std::vector<size_t> so_far;
  for (size_t i = 0; i < report.rows.size(); ++i) {
    const PlanRow& row = report.task.rows[report.rows[i]];
    so_far.push_back(report.rows[i]);
    json["rows"].push_back({{"controls", row.controls},
                            {"trial", trials[i]},
                            {"minutes_so_far", minutes_of(report.task, so_far)},
                            {"after", widths_json(report.along[i])},
                            {"fails", row.fails},
                            {"why", row.why}});
  }
  json["parameters"] = PlanJson::array();
  for (const PlannedQuantity& one : report.parameters) json["parameters"].push_back(quantity_json(one));
  json["instead"] = PlanJson::array();
  for (const PlanComparison& other : report.comparisons)
    json["instead"].push_back(
        {{"what", other.what}, {"rows", other.rows}, {"minutes", other.minutes}, {"after", widths_json(other.after)}});
  json["notes"] = report.notes;
  return json;
}

}  // namespace taut
