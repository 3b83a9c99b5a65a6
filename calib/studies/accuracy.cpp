#include "calib/studies/accuracy.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>
#include <sstream>
#include <tuple>

#include "calib/studies/discretisation.hpp"
#include "sim/core/dense.hpp"
#include "sim/core/error.hpp"
#include "sim/core/stopwatch.hpp"

namespace taut {
namespace {

std::string packed(const Eigen::MatrixXd& values) {
  return fmt::format("{}", fmt::join(values.data(), values.data() + values.size(), " "));
}

std::vector<double> unpacked(const std::string& text) {
  std::vector<double> values;
  std::istringstream in(text);
  for (std::string word; in >> word;) values.push_back(std::strtod(word.c_str(), nullptr));
  return values;
}

const Cells run_columns{"fingerprint", "axis",           "setting", "in_use", "unknowns",
                        "seconds",     "factorisations", "failure", "values", "derivatives"};

/// A run as it stands after axis and setting.
Cells cells_of(const AccuracySetting& setting, const AccuracyRun& run) {
  const bool good = run.failure.empty();
  return {setting.in_use ? "1" : "0",
          fmt::format("{}", run.unknowns),
          fmt::format("{:.6g}", run.seconds),
          fmt::format("{}", run.factorisations),
          run.failure,
          good ? packed(run.values) : "",
          good ? packed(run.derivatives) : ""};
}

/// Nothing where there is neither a reason nor as many numbers as a result has.
std::optional<AccuracyRun> run_of(const Cells& cells, size_t parameters) {
  AccuracyRun run;
  run.unknowns = std::atoi(cells[1].c_str());
  run.seconds = std::strtod(cells[2].c_str(), nullptr);
  run.factorisations = std::atoi(cells[3].c_str());
  run.failure = cells[4];
  const std::vector<double> values = unpacked(cells[5]), derivatives = unpacked(cells[6]);
  if (run.failure.empty() && (values.empty() || derivatives.size() != values.size() * parameters)) return std::nullopt;
  const Eigen::Index n = static_cast<Eigen::Index>(values.size());
  run.values = Eigen::Map<const Eigen::VectorXd>(values.data(), n);
  if (!derivatives.empty())
    run.derivatives = Eigen::Map<const Eigen::MatrixXd>(derivatives.data(), n, static_cast<Eigen::Index>(parameters));
  return run;
}

/// Runs a setting; nothing when it was interrupted, or the budget ended.
std::optional<AccuracyRun> run_setting(const AccuracySetting& setting, const Deadline& deadline) {
  AccuracyRun run;
  const Stopwatch watch;
  try {
    run = setting.run(deadline.flag());
  } catch (const InputError& error) {
    const auto* of_file = dynamic_cast<const FileError*>(&error);
    run.failure = of_file != nullptr ? of_file->reason : error.what();  // its own chart need not be told the file
    run.seconds = watch.seconds();
  }
  if (run.failure.empty() || !deadline.flag()) return run;
  if (!deadline.late() || !setting.may_hang) return std::nullopt;
  run.failure = fmt::format("given up after {:.0f} s: {}", deadline.seconds(), run.failure);
  return run;
}

/// The setting in use first, then from cheap to dear, what may hang last.
std::vector<size_t> order_of(const std::vector<AccuracySetting>& settings) {
  std::vector<size_t> order(settings.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::ranges::stable_sort(
      order, {}, [&](size_t i) { return std::tuple(!settings[i].in_use, settings[i].may_hang, settings[i].cost); });
  return order;
}

double root_mean_square(const Eigen::VectorXd& v) {
  return v.size() == 0 ? 0 : std::sqrt(v.squaredNorm() / static_cast<double>(v.size()));
}

/// What errors of each value are relative to.
Eigen::VectorXd scales_of(const AccuracyStudy& study, const Eigen::VectorXd& values) {
  if (study.series.empty()) return values.cwiseAbs().cwiseMax(0.01 * values.cwiseAbs().maxCoeff());
  std::map<int, std::pair<double, double>> ranges;
  for (Eigen::Index i = 0; i < values.size(); ++i) {
    auto& [low, high] = ranges.try_emplace(study.series[static_cast<size_t>(i)], values[i], values[i]).first->second;
    low = std::min(low, values[i]);
    high = std::max(high, values[i]);
  }
  return Eigen::VectorXd::NullaryExpr(values.size(), [&](Eigen::Index i) {
    const auto& [low, high] = ranges.at(study.series[static_cast<size_t>(i)]);
    return std::max(high - low, 1e-300);
  });
}

/// Relative change of each free parameter if readings that are `truth` are fitted with this model.
std::vector<double> parameter_errors(const AccuracyStudy& study, const Eigen::VectorXd& values,
                                     const Eigen::MatrixXd& derivatives, const Eigen::VectorXd& truth) {
  if (study.free.empty()) return {};
  std::vector<Measurement> measurements;
  for (Eigen::Index i = 0; i < truth.size(); ++i) {
    const int row = static_cast<int>(i);
    measurements.push_back({row, truth[i], study.sigma[static_cast<size_t>(i)], row});
  }
  const Eigen::VectorXd step =
      gauss_newton_step({values, derivatives, {}}, measurements, study.table, study.nominal, study.free);
  std::vector<double> errors;
  for (size_t j = 0; j < study.free.size(); ++j) {
    const FreeParameter& parameter = study.free[j];
    const double change = step[static_cast<Eigen::Index>(j)];
    errors.push_back(study.table[parameter.index].logarithmic
                         ? std::expm1(change)
                         : change / scale_of(parameter, study.table, study.nominal));
  }
  return errors;
}

/// Standard errors of the free parameters from the noise of the readings, relative, first order.
std::vector<double> parameter_noise(const AccuracyStudy& study, const Eigen::MatrixXd& derivatives) {
  if (study.free.empty()) return {};
  Eigen::MatrixXd J = derivatives;
  for (Eigen::Index i = 0; i < J.rows(); ++i) J.row(i) /= study.sigma[static_cast<size_t>(i)];
  for (size_t j = 0; j < study.free.size(); ++j)
    J.col(static_cast<Eigen::Index>(j)) *= scale_of(study.free[j], study.table, study.nominal);
  const SingularValues svd = singular_values(J);
  const Eigen::VectorXd errors = (svd.V * svd.s.cwiseMax(0.01).cwiseInverse().asDiagonal()).rowwise().norm();
  return {errors.data(), errors.data() + errors.size()};
}

using Runs = std::vector<std::optional<AccuracyRun>>;

bool has_result(const std::optional<AccuracyRun>& run) {
  return run && run->failure.empty();
}

size_t in_use_of(const AccuracyStudy& study, const Runs& runs) {
  for (size_t i = 0; i < runs.size(); ++i) {
    if (study.settings[i].in_use && has_result(runs[i])) return i;
  }
  throw InputError(
      fmt::format("{}: the experiment as its file has it gave no result, so there is nothing to compare "
                  "with; run `taut replay` or `taut simulate` on it",
                  study.title));
}

/// What runs are compared with, and how well that is known.
struct Reference {
  Eigen::VectorXd in_use, scales;
  Eigen::VectorXd values, squares;  ///< squares of their relative errors
  Eigen::VectorXd step_limit;       ///< on the file's own mesh; empty: not known
  Eigen::VectorXd solid;            ///< what `values` are of the plane section; empty: not known
};

/// The settings of a sequence that have a result, from coarse to fine; none where the one in use is alone.
std::vector<size_t> levels_of(const AccuracyStudy& study, const Runs& runs, const std::string& sequence) {
  std::vector<size_t> levels;
  for (size_t i = 0; i < runs.size(); ++i) {
    if (has_result(runs[i]) && study.settings[i].sequences.count(sequence) > 0) levels.push_back(i);
  }
  std::ranges::sort(levels, std::greater(), [&](size_t i) { return study.settings[i].sequences.at(sequence); });
  if (levels.size() == 1 && study.settings[levels.front()].in_use) levels.clear();
  return levels;
}

/// The limit of a sequence, relative to the scales; how it was come to.
std::pair<Extrapolation, std::string> limit_of(const AccuracyStudy& study, const Runs& runs,
                                               const std::string& sequence, const std::vector<size_t>& levels,
                                               const Eigen::VectorXd& scales) {
  std::vector<double> h;
  Eigen::MatrixXd values(scales.size(), static_cast<Eigen::Index>(levels.size()));
  for (size_t i : levels) {
    values.col(static_cast<Eigen::Index>(h.size())) = runs[i]->values.cwiseQuotient(scales);
    h.push_back(study.settings[i].sequences.at(sequence));
  }
  Extrapolation limit = extrapolate(h, values, study.highest_order.at(sequence));
  const std::string& finest = study.settings[levels.back()].name;
  std::string how = limit.measured
                        ? fmt::format("{} extrapolated from {} with order {:.2g}", sequence, finest, limit.order)
                        : fmt::format("{} from {}", sequence, finest);
  return {std::move(limit), std::move(how)};
}

/// A single level tells nothing of its own error: as much as it is away from the setting in use is allowed for.
Eigen::VectorXd error_of(const Extrapolation& limit, size_t levels, const Reference& reference) {
  return levels > 1 ? limit.error
                    : Eigen::VectorXd(limit.limit - reference.in_use.cwiseQuotient(reference.scales)).cwiseAbs();
}

/// Adds to the reference what is between the setting in use and the limit of a sequence.
void add_sequence(const AccuracyStudy& study, const Runs& runs, const std::string& sequence,
                  const std::vector<size_t>& levels, Reference& reference, AccuracyChart& chart) {
  const auto [limit, how] = limit_of(study, runs, sequence, levels, reference.scales);
  reference.values += limit.limit.cwiseProduct(reference.scales) - reference.in_use;
  reference.squares += error_of(limit, levels.size(), reference).cwiseAbs2();
  chart.reference += (chart.reference.empty() ? "" : "; ") + how;
  if (sequence != "step" || levels.size() < 2) return;
  reference.step_limit = limit.limit.cwiseProduct(reference.scales);
  chart.step_uncertainty = root_mean_square(limit.error);
  chart.step_reference = how;
}

/// What the solid is beyond the plane section in use, on the same mesh of it.
void set_solid(const AccuracyStudy& study, const Runs& runs, Reference& reference, AccuracyChart& chart) {
  const std::vector<size_t> levels = levels_of(study, runs, "depth");
  if (levels.empty()) return;
  const auto [limit, how] = limit_of(study, runs, "depth", levels, reference.scales);
  const Eigen::VectorXd off = reference.in_use.cwiseQuotient(reference.scales) - limit.limit;
  reference.solid = reference.values - off.cwiseProduct(reference.scales);
  chart.model_uncertainty =
      root_mean_square((reference.squares + error_of(limit, levels.size(), reference).cwiseAbs2()).cwiseSqrt());
  chart.model_reference = chart.reference + (chart.reference.empty() ? "" : "; ") + how;
  chart.section = fmt::format(
      "the plane section in use is {:.2g} % off the solid (root mean square; {:.2g} % at most), which takes {:.2g} "
      "times "
      "as long",
      100 * root_mean_square(off), 100 * off.cwiseAbs().maxCoeff(),
      runs[levels.back()]->seconds / runs[in_use_of(study, runs)]->seconds);
}

AccuracyPoint point_of(const AccuracyStudy& study, size_t setting, const AccuracyRun& run, const Reference& reference) {
  AccuracyPoint point;
  point.setting = setting;
  const auto from = [&](const Eigen::VectorXd& other) {
    return Eigen::VectorXd((run.values - other).cwiseQuotient(reference.scales));
  };
  point.error = root_mean_square(from(reference.values));
  point.largest = from(reference.values).cwiseAbs().maxCoeff();
  point.from_setting_in_use = root_mean_square(from(reference.in_use));
  if (!study.settings[setting].integrator.empty() && reference.step_limit.size() > 0)
    point.step_error = root_mean_square(from(reference.step_limit));
  if (!study.settings[setting].model.empty() && reference.solid.size() > 0)
    point.model_error = root_mean_square(from(reference.solid));
  point.parameters = parameter_errors(study, run.values, run.derivatives, reference.values);
  return point;
}

}  // namespace

Runs run_settings(const AccuracyStudy& study, const StudyOptions& options) {
  const std::vector<size_t> order = order_of(study.settings);
  Runs runs(order.size());
  Study table;
  table.columns = run_columns;
  table.keys = 2;
  table.least = 1;
  for (size_t i : order) {
    const AccuracySetting& setting = study.settings[i];
    table.settings.push_back({{setting.axis, setting.name}, setting.name, setting.cost, setting.may_hang});
  }
  table.run = [&](size_t k, const Deadline& deadline) -> std::optional<StudyResult> {
    const AccuracySetting& setting = study.settings[order[k]];
    const std::optional<AccuracyRun> run = run_setting(setting, deadline);
    if (!run) return std::nullopt;
    return StudyResult{cells_of(setting, *run), run->failure.empty() ? run->seconds : 0};
  };
  table.take = [&](size_t k, const Cells& cells) {
    runs[order[k]] = run_of(cells, study.free.size());
    return runs[order[k]].has_value();
  };
  run_study(table, options);
  return runs;
}

std::vector<size_t> pareto_front(const std::vector<std::pair<double, double>>& cost_and_error) {
  std::vector<size_t> order(cost_and_error.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::ranges::stable_sort(order, {}, [&](size_t i) { return cost_and_error[i]; });
  std::vector<size_t> front;
  for (size_t i : order) {
    if (front.empty() || cost_and_error[i].second < 0.98 * cost_and_error[front.back()].second) front.push_back(i);
  }
  return front;
}

AccuracyChart judge(const AccuracyStudy& study, const Runs& runs) {
  const AccuracyRun& own = *runs[in_use_of(study, runs)];
  AccuracyChart chart;
  Reference reference{
      own.values, scales_of(study, own.values), own.values, Eigen::VectorXd::Zero(own.values.size()), {}, {}};
  for (const auto& [sequence, highest] : study.highest_order) {
    const std::vector<size_t> levels = levels_of(study, runs, sequence);
    if (!levels.empty() && sequence != "depth") add_sequence(study, runs, sequence, levels, reference, chart);
  }
  set_solid(study, runs, reference, chart);
  if (chart.reference.empty()) {
    chart.reference = "the setting in use itself: nothing finer was run";
    reference.squares.setConstant(not_a_number);
  }
  const Eigen::VectorXd errors = reference.squares.cwiseSqrt();
  chart.uncertainty = root_mean_square(errors);
  const Eigen::VectorXd off = reference.values + errors.cwiseProduct(reference.scales);
  for (double error : parameter_errors(study, reference.values, own.derivatives, off))
    chart.parameter_uncertainty.push_back(std::abs(error));
  chart.parameter_noise = parameter_noise(study, own.derivatives);
  std::vector<std::pair<double, double>> cost_and_error;
  for (size_t i = 0; i < runs.size(); ++i) {
    if (!has_result(runs[i])) continue;
    chart.points.push_back(point_of(study, i, *runs[i], reference));
    cost_and_error.emplace_back(runs[i]->seconds, chart.points.back().error);
  }
  for (size_t i : pareto_front(cost_and_error)) chart.points[i].on_front = true;
  return chart;
}

}  // namespace taut
