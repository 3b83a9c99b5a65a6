#include <fmt/format.h>

#include <algorithm>
#include <boost/program_options.hpp>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <set>

#include "calib/data/files.hpp"
#include "calib/data/plan.hpp"
#include "calib/data/run_folder.hpp"
#include "calib/runs/new_reading.hpp"
#include "calib/runs/open_bench.hpp"
#include "calib/runs/provenance.hpp"
#include "calib/studies/planning.hpp"
#include "calib/studies/tuning.hpp"
#include "experiments/cli/bench_words.hpp"
#include "experiments/cli/commands.hpp"
#include "experiments/cli/plan_output.hpp"
#include "experiments/cli/print.hpp"
#include "experiments/cli/progress.hpp"
#include "reports/estimate_text.hpp"
#include "reports/run_record.hpp"
#include "reports/simulation_run.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

namespace fs = std::filesystem;
namespace po = boost::program_options;

constexpr double worth_it = 0.05;  ///< fraction of a half width below which rows hardly help
constexpr double no_help = 0.01;   ///< and below which they do not
constexpr size_t most_rows = 200;  ///< candidates that are proposed

/// Where a plan begins: a run, or a file before any reading.
struct PlanSource {
  std::optional<RunRecord> record;
  std::unique_ptr<Bench> bench;

  double sigma(const BenchReading& at, double value) const {
    return record ? sigma_of_new_reading(*record, *bench, at, value) : sigma_of_new_reading(*bench, at, value);
  }
};

PlanSource source_of(const CommandOptions& options) {
  PlanSource source;
  std::string file = options.target;
  if (fs::is_directory(file) && !fs::exists(fs::path(file) / "fit.json") &&
      fs::exists(fs::path(file) / "experiment.toml"))
    file = (fs::path(file) / "experiment.toml").string();  // of `taut init`
  if (fs::is_directory(file)) {
    settle_run_folder(file);
    source.record = read_run(file);
    if (source.record->fit.covariance.size() == 0)
      throw InputError(fmt::format("{}: its fit has no result to plan from ({}: {}); run the fit again", file,
                                   name_of(source.record->fit.status), source.record->fit.message));
    source.bench = open_bench(experiment_of_run(*source.record, file), {options.threads, options.stop});
    check_can_be_planned(*source.bench);
    return source;
  }
  source.bench = open_bench(file, {options.threads, options.stop, Readings::rows_may_be_missing});
  check_can_be_planned(*source.bench);
  if (!planned_rows(*source.bench))
    throw InputError(
        fmt::format("{0}: its bench has readings, which say more than the starts of its parameters; fit it "
                    "first: taut fit {0}, and then: taut plan runs/{1}",
                    file, experiment_name(file)));
  if (source.bench->free().empty())
    throw InputError(
        fmt::format("{}: nothing is free, so that there is nothing to learn; give it a [fit.free.ID]", file));
  return source;
}

/// "retraction=12 mm": the control and the text of its value.
std::pair<size_t, std::string> assignment_in(const std::string& text, const Bench& bench, const std::string& where) {
  const size_t equals = text.find('=');
  if (equals == std::string::npos || equals == 0)
    throw InputError(fmt::format("{}: write ID=VALUE, for example \"{}=...\"", where, bench.controls().front().id));
  const std::string id(trimmed(std::string_view(text).substr(0, equals)));
  return {place_of_id(bench.controls(), id, where, "control of the bench"),
          std::string(trimmed(std::string_view(text).substr(equals + 1)))};
}

/// A value of a control: a number with its unit, or one of its names.
double value_in(const std::string& text, const Bench& bench, size_t control, const std::string& where) {
  const AxisRecord& axis = bench.controls()[control];
  if (!axis.labels.empty()) {
    const auto found = std::ranges::find(axis.labels, text);
    if (found == axis.labels.end())
      throw InputError(
          fmt::format("{}: '{}' is none of the values of {}: {}", where, text, axis.id, join(axis.labels)));
    return static_cast<double>(found - axis.labels.begin()) + 1;
  }
  const double value = in_unit_of(axis, spaced(text), where);
  if (bench.experiment().bench.controls[control].pulls && value < 0)
    throw InputError(fmt::format("{}: {} is a tension, and a cable cannot push; give 0 or more", where, axis.id));
  return value;
}

/// --at "retraction=12 mm, mass=80 g": all controls.
std::vector<double> controls_at(const std::string& text, const Bench& bench) {
  std::vector<double> controls(bench.controls().size(), not_a_number);
  for (size_t begin = 0; begin <= text.size();) {
    const size_t end = std::min(text.find(',', begin), text.size());
    const auto [k, value] = assignment_in(text.substr(begin, end - begin), bench, "--at " + text);
    if (!std::isnan(controls[k]))
      throw InputError(fmt::format("--at {}: {} stands twice; leave one out", text, bench.controls()[k].id));
    controls[k] = value_in(value, bench, k, "--at " + text);
    begin = end + 1;
  }
  for (size_t k = 0; k < controls.size(); ++k) {
    if (std::isnan(controls[k]))
      throw InputError(
          fmt::format("--at {}: the value of {} is missing; write all controls, for example \"..., {}=...\"", text,
                      bench.controls()[k].id, bench.controls()[k].id));
  }
  return controls;
}

/// Three digits, as one would set it; the ends of a range as they are.
double as_set(double value) {
  return std::stod(fmt::format("{:.2e}", value));
}

std::vector<double> even_levels(double from, double to, int levels) {
  std::set<double> values{from, to};
  for (int i = 1; i + 1 < levels; ++i) values.insert(as_set(from + (to - from) * i / (levels - 1)));
  return {values.begin(), values.end()};
}

/// What --try says of each control: ranges, and single values.
struct Tries {
  std::vector<std::pair<double, double>> ranges;
  std::set<double> values;
};

std::vector<Tries> tries_of(const CommandOptions& options, const Bench& bench) {
  std::vector<Tries> all(bench.controls().size());
  for (const std::string& text : options.tries) {
    const std::string where = "--try " + text;
    const auto [k, value] = assignment_in(text, bench, where);
    const size_t dots = value.find("..");
    if (dots == std::string::npos) {
      all[k].values.insert(value_in(value, bench, k, where));
      continue;
    }
    if (!bench.controls()[k].labels.empty())
      throw InputError(fmt::format("{}: its values are names, between which there is nothing; name one", where));
    const double from = value_in(std::string(trimmed(std::string_view(value).substr(0, dots))), bench, k, where);
    const double to = value_in(std::string(trimmed(std::string_view(value).substr(dots + 2))), bench, k, where);
    if (!(from < to))
      throw InputError(fmt::format("{}: the range begins at {} and ends at {}; write the smaller value first", where,
                                   value_text(bench, k, from), value_text(bench, k, to)));
    all[k].ranges.emplace_back(from, to);
  }
  return all;
}

/// Where each value of a control has a zero error of its own, that of a new value is not known from any reading.
void refuse_new_zeros(const Bench& bench, const std::vector<std::vector<double>>& rows) {
  const std::string& per = bench.experiment().zero_offset_per;
  if (per.empty()) return;
  const size_t k = place_of_id(bench.controls(), per, bench.experiment().path, "control of the bench");
  const std::vector<double> known = bench.values_of(k);
  for (const std::vector<double>& row : rows) {
    if (std::ranges::find(known, row[k]) == known.end())
      throw InputError(
          fmt::format("{}: each {} has a zero error of its own (zero_offset_per), and {} is none of the "
                      "bench's; try the bench's own values",
                      bench.experiment().path, per, value_text(bench, k, row[k])));
  }
}

/// The candidates that are proposed: all combinations of the controls' levels.
std::vector<std::vector<double>> proposed_rows(const CommandOptions& options, const Bench& bench,
                                               std::vector<std::string>& notes) {
  const std::vector<Tries> tries = tries_of(options, bench);
  const bool nothing_planned = planned_rows(bench).value_or(1) == 0;
  std::vector<std::vector<double>> levels;
  for (int count = options.levels;; --count) {
    levels.clear();
    size_t all = 1;
    for (size_t k = 0; k < bench.controls().size(); ++k) {
      std::set<double> values = tries[k].values;
      for (const auto& [from, to] : tries[k].ranges) {
        for (const double value : even_levels(from, to, count)) values.insert(value);
      }
      const std::vector<double> own = bench.values_of(k);
      if (values.empty() && nothing_planned)
        throw InputError(
            fmt::format("{}: its bench has no row yet; say which values {} may have: --try \"{}=FROM..TO\"",
                        bench.experiment().path, bench.controls()[k].id, bench.controls()[k].id));
      if (values.empty()) {
        const bool as_they_are =
            !bench.controls()[k].labels.empty() || bench.experiment().zero_offset_per == bench.controls()[k].id;
        const std::vector<double> even = as_they_are ? own : even_levels(own.front(), own.back(), count);
        values.insert(even.begin(), even.end());
      }
      levels.emplace_back(values.begin(), values.end());
      all *= levels.back().size();
    }
    if (all <= most_rows || count == 2) {
      if (all > 10 * most_rows)
        throw InputError(
            fmt::format("{}: even two values of each control make {} rows; name candidates with --rows FILE, "
                        "or hold controls with --try ID=VALUE",
                        bench.experiment().path, all));
      if (count < options.levels)
        notes.push_back(fmt::format("candidates: {} values of each control, since {} would make more than {} rows",
                                    count, options.levels, most_rows));
      break;
    }
  }
  std::vector<std::vector<double>> rows{{}};
  for (const std::vector<double>& values : levels) {
    std::vector<std::vector<double>> longer;
    for (const std::vector<double>& row : rows) {
      for (const double value : values) {
        longer.push_back(row);
        longer.back().push_back(value);
      }
    }
    rows = std::move(longer);
  }
  return rows;
}

std::vector<std::vector<double>> candidates_of(const CommandOptions& options, const Bench& bench,
                                               std::vector<std::string>& notes) {
  std::vector<std::vector<double>> rows;
  if (bench.controls().empty())
    throw InputError(fmt::format("{}: its bench sets nothing, so that all rows are alike", bench.experiment().path));
  if (options.rows.empty()) {
    rows = proposed_rows(options, bench, notes);
  } else {
    if (!options.tries.empty()) throw InputError("--rows and --try both say what is looked at; leave one out");
    for (const LoadRow& row : read_load_rows(bench.experiment().bench, options.rows)) {
      if (std::ranges::find(rows, row.controls) == rows.end()) rows.push_back(row.controls);
    }
  }
  refuse_new_zeros(bench, rows);
  return rows;
}

std::vector<int> channels_of(const CommandOptions& options, const Bench& bench) {
  std::vector<int> channels;
  for (size_t begin = 0; !options.read_channels.empty() && begin <= options.read_channels.size();) {
    const size_t end = std::min(options.read_channels.find(',', begin), options.read_channels.size());
    const std::string id(trimmed(std::string_view(options.read_channels).substr(begin, end - begin)));
    channels.push_back(static_cast<int>(place_of_id(bench.channels(), id, "--channels", "channel")));
    begin = end + 1;
  }
  for (size_t c = 0; options.read_channels.empty() && c < bench.channels().size(); ++c)
    channels.push_back(static_cast<int>(c));
  return channels;
}

double minutes_in(const std::string& text, const char* option) {
  const double seconds = parse_quantity(spaced(text), Quantity::time, option);
  if (seconds < 0) throw InputError(fmt::format("{}: a time is 0 or more", option));
  return seconds / 60;
}

PlanCosts costs_of(const CommandOptions& options) {
  PlanCosts costs{minutes_in(options.setup, "--setup"), minutes_in(options.rest, "--rest"),
                  minutes_in(options.reading, "--reading")};
  if (!(costs.rest + costs.reading > 0))
    throw InputError("--rest, --reading: a row takes some time; give one of them more than 0");
  return costs;
}

void check_limits(const CommandOptions& options) {
  if (options.count < 0 || options.count > 200)
    throw InputError(fmt::format("--count {}: a plan has 1 to 200 rows", options.count));
  if (!(options.minutes >= 0)) throw InputError(fmt::format("--minutes {}: give more than 0", options.minutes));
  if (options.levels < 2)
    throw InputError(fmt::format("--levels {}: a range has at least its two ends", options.levels));
  if (options.draws < 1 || options.draws > 1000)
    throw InputError(fmt::format("--draws {}: give 1 to 1000", options.draws));
  if (!options.parameter.empty() && !options.predict.empty())
    throw InputError("--parameter and --predict both name the goal; leave one out");
  if (options.predict.empty() != options.at.empty())
    throw InputError(
        "--predict CHANNEL and --at \"ID=VALUE, ...\" belong together: what is to be predicted, and where");
}

/// What is asked, and all that is known to answer it.
class Planner {
 public:
  Planner(const CommandOptions& options, const PlanSource& source, Progress& progress)
      : options_(options), source_(source), bench_(*source.bench), progress_(progress) {
    report_.title = source.record ? source.record->title : bench_.experiment().title;
    report_.simulated = source.record && source.record->simulated;
    report_.before_readings = !source.record;
    report_.belief = source.record ? belief_after(source.record->fit) : belief_before(bench_);
    question_.rows = candidates_of(options, bench_, report_.notes);
    question_.channels = channels_of(options, bench_);
    question_.draws = options.draws;
    question_.seed = seed_of(options);
    for (const int channel : question_.channels)
      report_.channels.push_back(bench_.channels()[static_cast<size_t>(channel)].id);
    report_.task.costs = costs_of(options);
    if (options.count > 0) report_.task.count = options.count;
    if (options.minutes > 0) report_.task.minutes = options.minutes;
    if (options.count == 0 && options.minutes == 0) report_.task.count = 4;
    if (!options.parameter.empty()) parameter_ = parameter_named(options.parameter);
    if (!options.predict.empty())
      question_.predicted = {static_cast<int>(place_of_id(bench_.channels(), options.predict, "--predict", "channel")),
                             controls_at(options.at, bench_)};
  }

  PlanReport go() {
    knowledge_ =
        ask_rows(bench_, report_.belief, question_, sigma(), [&](const std::string& text) { progress_.show(text); });
    if (options_.interrupted()) return std::move(report_);
    progress_.show("choosing rows");
    report_.task.known = knowledge_.known;
    report_.task.rows = knowledge_.candidates;
    if (question_.predicted) {
      set_goal_predicted();
    } else {
      if (!parameter_) parameter_ = worst_known();
      report_.task.goal = goal_of(*parameter_);
      report_.goal = quantity_of(*parameter_);
    }
    report_.goal.is_goal = true;
    const PlanChoice choice = choose_rows(report_.task);
    const double narrower = narrowing(report_.task, choice.rows);
    report_.exhaustive = choice.exhaustive;
    if (choice.rows.empty())
      report_.notes.push_back(
          fmt::format("one row takes {:.4g} min already; give more --minutes",
                      report_.task.costs.setup + report_.task.costs.rest + report_.task.costs.reading));
    if (narrower > no_help) report_.rows = choice.rows;
    for (size_t i = 1; i <= report_.rows.size(); ++i)
      report_.along.push_back(
          widths_after(report_.task, {report_.rows.begin(), report_.rows.begin() + static_cast<std::ptrdiff_t>(i)}));
    fill_quantities();
    compare();
    say_what_limits(choice.rows, narrower);
    return std::move(report_);
  }

 private:
  SigmaOfReading sigma() const {
    return [this](const BenchReading& at, double value) { return source_.sigma(at, value); };
  }

  size_t parameter_named(const std::string& id) const {
    std::vector<std::string> ids;
    for (const PlanBelief::Parameter& one : report_.belief.parameters) ids.push_back(one.spec.id);
    const auto found = std::ranges::find(ids, id);
    if (found == ids.end())
      throw InputError(fmt::format("--parameter: '{}' is not among what {}{}; there are: {}", id,
                                   source_.record ? "was fitted" : "is free", did_you_mean(id, ids), join(ids)));
    return static_cast<size_t>(found - ids.begin());
  }

  /// Of the shares that count, 95 %; before a fit nobody knows them.
  double floor_of(const Eigen::VectorXd& gradient) const {
    return source_.record ? half_widths(source_.record->fit, source_.record->shares, gradient).shares : 0;
  }

  PlanGoal goal_of(size_t parameter) const {
    PlanGoal goal = goal_of_parameter(report_.belief, parameter, knowledge_.known.size(), 0);
    goal.floor = floor_of(goal.gradients.front());
    return goal;
  }

  PlannedQuantity quantity_of(size_t parameter) const {
    const PlanBelief::Parameter& one = report_.belief.parameters[parameter];
    return {one.spec.id, one.spec.unit, one.value, one.spec.logarithmic};
  }

  void set_goal_predicted() {
    const PlanQuestion::Goal& goal = *question_.predicted;
    std::vector<std::string> at;
    for (size_t k = 0; k < goal.controls.size(); ++k) at.push_back(bench_.describe_control(k, goal.controls[k]));
    const AxisRecord& channel = bench_.channels()[static_cast<size_t>(goal.channel)];
    report_.task.goal = {knowledge_.slopes, floor_of(knowledge_.slopes.front())};
    report_.goal = {fmt::format("{} at {}", channel.id, join(at)), channel.unit, knowledge_.predicted};
  }

  /// The parameter with the largest deviation, over what it is compared with, of those that rows narrow by 5 % or
  /// more; if there is none, of all.
  size_t worst_known() const {
    std::optional<size_t> worst, worst_of_all;
    double most = 0, most_of_all = 0;
    for (size_t j = 0; j < report_.belief.parameters.size(); ++j) {
      PlanTask task = report_.task;
      task.goal = goal_of(j);
      const PlanBelief::Parameter& one = report_.belief.parameters[j];
      const double spread = widths_after(task, {}).total / (one.scale() * one.range);
      if (!worst_of_all || spread > most_of_all) {
        worst_of_all = j;
        most_of_all = spread;
      }
      if (worst && spread <= most) continue;
      if (narrowing(task, choose_rows(task).rows) < worth_it) continue;
      worst = j;
      most = spread;
    }
    return worst.value_or(*worst_of_all);
  }

  void fill_quantities() {
    report_.goal.before = widths_after(report_.task, {});
    report_.goal.after = widths_after(report_.task, report_.rows);
    for (size_t j = 0; j < report_.belief.parameters.size(); ++j) {
      PlanTask task = report_.task;
      task.goal = goal_of(j);
      PlannedQuantity& one = report_.parameters.emplace_back(quantity_of(j));
      one.is_goal = parameter_ == j;
      one.before = widths_after(task, {});
      one.after = widths_after(task, report_.rows);
    }
  }

  /// What the bench's own rows would give for the same time.
  void compare() {
    if (knowledge_.measured.empty() || report_.rows.empty()) return;
    PlanTask again = report_.task;
    again.rows = knowledge_.measured;
    again.count.reset();
    again.minutes = minutes_of(report_.task, report_.rows);
    const auto add = [&](const std::string& what, const std::vector<size_t>& rows) {
      if (rows.empty()) return;
      report_.comparisons.push_back({what, rows.size(), minutes_of(again, rows), widths_after(again, rows)});
    };
    std::vector<std::string> held;
    const size_t varied = varied_control(bench_);
    for (size_t k = 0; k < bench_.controls().size(); ++k) {
      if (k != varied) held.push_back(bench_.describe_control(k, again.rows.front().controls[k]));
    }
    add("the bench's cheapest rows again" + (held.empty() ? "" : " (" + join(held) + ")"),
        cheapest_rows(again, *again.minutes));
    add("the best of the bench's own rows again", choose_rows(again).rows);
  }

  /// Shares that no reading lowers, rows that see nothing, draws that were left out.
  void say_what_limits(const std::vector<size_t>& chosen, double narrower) {
    const PlanTask& task = report_.task;
    if (knowledge_.dropped > 0)
      report_.notes.push_back(
          fmt::format("{} draws of the parameters were left out, since the bench's own readings (or "
                      "the goal) have no equilibrium there; {} are left",
                      knowledge_.dropped, knowledge_.known.size()));
    const PlanWidths before = report_.goal.before;
    const bool dominated = task.goal.floor > 0.9 * before.total;
    if (dominated) {
      const Share& most = largest_share();
      report_.notes.push_back(fmt::format(
          "more readings do not help: of {} in all, {} are shares of what is assumed, which no reading lowers; the "
          "largest is that of {}: {}",
          width_text(report_.goal, before.total), width_text(report_.goal, task.goal.floor), most.source,
          remedy_of(most)));
    }
    const double by_noise = before.noise > 0 ? 1 - widths_after(task, chosen).noise / before.noise : 0;
    if (chosen.empty() || (dominated ? by_noise : narrower) >= worth_it) return;
    report_.notes.push_back(fmt::format("no candidate narrows {} by {:.0f} % or more: the best {} rows do by {:.2g} %",
                                        report_.goal.id, 100 * worth_it, chosen.size(), 100 * std::max(0.0, narrower)));
    const int count = static_cast<int>(chosen.size());
    const std::vector<PlanReach> found =
        where_seen(bench_, report_.belief, question_, sigma(), knowledge_, task.goal, count, worth_it,
                   [&](const std::string& text) { progress_.show(text); });
    for (const PlanReach& reach : found) report_.notes.push_back(reach_text(reach));
    if (found.empty())
      report_.notes.push_back("nor do rows with one control beyond the candidates, up to once their range further");
  }

  const Share& largest_share() const {
    const auto part = [&](const Share& share) {
      const double size = share.counted ? part_of(share, source_.record->fit, report_.task.goal.gradients.front()) : 0;
      return std::isfinite(size) ? size : 0;
    };
    return *std::ranges::max_element(source_.record->shares, {}, part);
  }

  /// "E_plastic needs closed lips (surfaces that touch): retraction 17.3 mm and above (at mass = 50 g)".
  std::string reach_text(const PlanReach& reach) const {
    std::vector<std::string> others;
    for (size_t k = 0; k < reach.controls.size(); ++k) {
      if (k != reach.control) others.push_back(bench_.describe_control(k, reach.controls[k]));
    }
    std::string reason = "begins to be seen beyond the candidates", state;
    if (reach.touching && reach.touching_before && *reach.touching != *reach.touching_before)
      reason = *reach.touching ? "needs closed lips (surfaces that touch)" : "needs surfaces that do not touch";
    else if (reach.touching && *reach.touching)
      state = "; surfaces touch there, and at the candidates' end already";
    return fmt::format("{} {}: {} {} and {}{}{}", report_.goal.id, reason, bench_.controls()[reach.control].id,
                       value_text(bench_, reach.control, as_set(reach.controls[reach.control])),
                       reach.above ? "above" : "below", others.empty() ? "" : " (at " + join(others) + ")", state);
  }

  const CommandOptions& options_;
  const PlanSource& source_;
  const Bench& bench_;
  Progress& progress_;
  PlanQuestion question_;
  PlanKnowledge knowledge_;
  PlanReport report_;
  std::optional<size_t> parameter_;
};

/// The plan as a bench file, its trials beyond those of the readings.
std::string bench_csv(const PlanReport& report, const Bench& bench) {
  const BenchFormat& format = bench.experiment().bench;
  int last = 0;
  bool numbers = true;
  for (const BenchReading& reading : bench.readings()) {
    if (report.before_readings || reading.trial.empty()) continue;
    const std::optional<double> number = parse_number(reading.trial);
    numbers &= number && *number == std::floor(*number) && std::abs(*number) < 1e6;
    if (numbers) last = std::max(last, static_cast<int>(*number));
  }
  std::vector<RowToMeasure> rows;
  const std::vector<int> trials = trials_of(report.rows);
  for (size_t i = 0; i < report.rows.size(); ++i)
    rows.push_back({numbers ? std::to_string(last + trials[i]) : fmt::format("plan{}", trials[i]),
                    report.task.rows[report.rows[i]].controls});
  return plan_csv(format, rows, columns_in_file(format));
}

int plan_main(const CommandOptions& options) {
  check_limits(options);
  if (!options.out.empty() && fs::exists(options.out))
    throw InputError(
        fmt::format("--out {}: it is there already and is not overwritten; name another file", options.out));
  const PlanSource source = source_of(options);
  Progress progress(options.quiet);
  PlanReport report;
  try {
    report = Planner(options, source, progress).go();
  } catch (const InputError&) {
    if (options.interrupted()) return exit_interrupted;  // a replay that was ended early
    throw;
  }
  if (options.interrupted()) return exit_interrupted;
  if (source.record && misses_readings(source.record->fit))
    progress.say("THE MODEL DID NOT DESCRIBE THE READINGS that it was fitted to: widths count their noise only");
  if (!options.out.empty() && !report.rows.empty()) {
    write_file(options.out, bench_csv(report, *source.bench));
    progress.say(fmt::format("{} rows to fill in: {}", report.rows.size(), options.out));
  }
  if (options.json)
    print_json(plan_json(report, *source.bench));
  else
    print_plan(report, *source.bench);
  return report.rows.empty() ? exit_fit : exit_ok;
}

void add_plan_options(AddOption add, CommandOptions& options) {
  add("parameter", po::value(&options.parameter)->value_name("ID"),
      "the goal; default: the one known worst of those that can be narrowed");
  add("predict", po::value(&options.predict)->value_name("CHANNEL"), "or what it reads is the goal, with --at");
  add("at", po::value(&options.at)->value_name("ID=VALUE,..."), "where: \"retraction=12 mm, mass=80 g\"");
  add("count", po::value(&options.count)->value_name("N"), "rows; default: 4, with --minutes as many as fit");
  add("minutes", po::value(&options.minutes)->value_name("M"), "bench time that they may take");
  add("setup", po::value(&options.setup)->value_name("TIME"),
      "for each state of what is held besides the load; default: 5 min");
  add("rest", po::value(&options.rest)->value_name("TIME"), "before each row; default: 1 min");
  add("reading", po::value(&options.reading)->value_name("TIME"), "each row; default: 1 min");
  add("rows", po::value(&options.rows)->value_name("FILE"),
      "CSV file with the columns of controls, the candidates; default: even values over the bench's own range");
  add("try", po::value(&options.tries)->value_name("ID=FROM..TO")->composing(),
      "another range of a control, or a value of it; may be repeated");
  add("levels", po::value(&options.levels)->value_name("N"), "even values in a range; default: 5");
  add("channels", po::value(&options.read_channels)->value_name("ID,..."), "what is read in each row; default: all");
  add("draws", po::value(&options.draws)->value_name("N"),
      "of the parameters, over which widths are averaged; default: 8");
  add("seed", po::value(&options.seed)->value_name("N"), "of the draws; default: 1");
  add("out", po::value(&options.out)->value_name("FILE"), "the rows as a bench file, ready to fill in: next.csv");
  add_threads(add, options);
}

}  // namespace

Command plan_command() {
  return {
      "plan",
      "RUN_OR_FILE",
      "Says which rows to measure next, for a parameter or a prediction, in a given time.",
      "  taut plan runs/push_puppet --parameter k_cable\n"
      "  taut plan runs/push_puppet --predict tip --at \"retraction=12 mm, mass=80 g\" --minutes 30 --out next.csv\n"
      "  taut plan my_module/experiment.toml --try \"retraction=0 mm..20 mm\"    # before any reading\n",
      add_plan_options,
      plan_main};
}

}  // namespace taut
