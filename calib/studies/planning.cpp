#include "calib/studies/planning.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "calib/fit/goodness_of_fit.hpp"
#include "sim/core/dense.hpp"
#include "sim/core/draws.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"

namespace taut {
namespace {

using Eigen::Index;

constexpr double deviation_of_factor = 1.0986122886681098;  ///< ln 3

double fitted(const PlanBelief::Parameter& parameter, double si) {
  return parameter.spec.logarithmic ? std::log(si) : si;
}

PlanBelief::Parameter parameter_of(const ParameterSpec& spec, double value, double lower, double upper) {
  PlanBelief::Parameter parameter{spec, value, lower, upper};
  if (!spec.logarithmic) {
    const double apart = upper - lower;
    parameter.range = std::isfinite(apart) && apart > 0 ? apart : std::max(std::abs(value), 1e-12);
  }
  return parameter;
}

/// A quarter of the distance of its bounds on the fitted scale; infinite where it has none.
double quarter_of_range(const PlanBelief::Parameter& parameter) {
  return (fitted(parameter, parameter.upper) - fitted(parameter, parameter.lower)) / 4;
}

/// The part that both a normal distribution with this covariance and one of each by itself leave open:
/// (C^-1 + D^-2)^-1 = C - C (C + D^2)^-1 C, which needs no inverse of C.
Eigen::MatrixXd covariance_of_both(const Eigen::MatrixXd& C, const Eigen::VectorXd& deviations) {
  Eigen::MatrixXd sum = C;
  sum.diagonal() += deviations.cwiseAbs2();
  const auto part = solve_positive_definite(sum, C);
  if (!part) return C;
  const Eigen::MatrixXd both = C - C * *part;
  return (both + both.transpose()) / 2;
}

/// One draw of the parameters, in SI.
std::vector<double> values_at(const PlanBelief& belief, const Eigen::VectorXd& away) {
  std::vector<double> values;
  for (size_t j = 0; j < belief.parameters.size(); ++j) {
    const PlanBelief::Parameter& one = belief.parameters[j];
    const double q = fitted(one, one.value) + away[static_cast<Index>(j)];
    values.push_back(away[static_cast<Index>(j)] == 0
                         ? one.value
                         : std::clamp(one.spec.logarithmic ? std::exp(q) : q, one.lower, one.upper));
  }
  return values;
}

/// A bench's last prediction of some rows, on the fitted scale.
struct Asked {
  Prediction prediction;
  Params p;
};

/// What stays the same while draws change.
class Replays {
 public:
  Replays(const PlanBelief& belief, const PlanQuestion& question, const SigmaOfReading& sigma)
      : belief_(belief), question_(question), sigma_(sigma) {}

  Index count() const { return static_cast<Index>(belief_.parameters.size()); }

  /// Its rows at these values, along the protocol's own path, with derivatives by the parameters on the fitted scale,
  /// and behind them by `also`.
  Asked ask(const Bench& bench, const std::vector<double>& values, const std::vector<int>& also = {}) const {
    Protocol& protocol = bench.protocol();
    Asked asked;
    asked.p = protocol.nominal();
    std::vector<int> free;
    for (size_t j = 0; j < values.size(); ++j) {
      free.push_back(protocol.parameters().index(belief_.parameters[j].spec.id));
      asked.p[free.back()] = values[j];
    }
    free.insert(free.end(), also.begin(), also.end());
    protocol.forget();
    asked.prediction = protocol.predict(asked.p, free);
    for (size_t j = 0; j < values.size(); ++j) {
      if (belief_.parameters[j].spec.logarithmic) asked.prediction.derivatives.col(static_cast<Index>(j)) *= values[j];
    }
    return asked;
  }

  bool is_read(int channel) const { return std::ranges::count(question_.channels, channel) > 0; }

  /// Adds J^T W J of a new reading. One without a sigma above zero says nothing.
  void add(const BenchReading& reading, const Prediction& prediction, Eigen::MatrixXd& information) const {
    const double sigma = sigma_(reading, prediction.values[reading.row]);
    if (!(sigma > 0) || !std::isfinite(sigma)) return;
    const Eigen::RowVectorXd slopes = prediction.derivatives.row(reading.row).head(count()) / sigma;
    information += slopes.transpose() * slopes;
  }

 private:
  const PlanBelief& belief_;
  const PlanQuestion& question_;
  const SigmaOfReading& sigma_;
};

std::unique_ptr<Bench> bench_at(const Bench& bench, const std::vector<std::vector<double>>& rows) {
  std::vector<LoadRow> lines;
  for (const std::vector<double>& row : rows) lines.push_back({static_cast<int>(lines.size()) + 1, row});
  return bench.at_rows(lines);
}

/// Candidates, which fail in some draws.
class Candidates {
 public:
  Candidates(const Bench& bench, const Replays& replays, const std::vector<std::vector<double>>& rows)
      : bench_(bench), replays_(replays), there_(bench_at(bench, rows)), rows_(rows.size()) {
    for (size_t i = 0; i < rows.size(); ++i) rows_[i].controls = rows[i];
  }

  /// What the rows say at these values, in a draw more.
  void ask(const std::vector<double>& values) {
    const Asked asked = replays_.ask(*there_, values);
    std::vector<std::string> why(rows_.size());
    std::vector<Eigen::MatrixXd> information(rows_.size(), Eigen::MatrixXd::Zero(replays_.count(), replays_.count()));
    for (const BenchReading& reading : there_->readings()) {
      if (!std::isfinite(asked.prediction.values[reading.row])) why[row_of(reading)] = "no equilibrium is found";
    }
    for (const int row : there_->slipped_rows())
      say(*there_, row, "the path jumps to another equilibrium on the way", why);
    find_alternatives(asked.p, why);
    for (const BenchReading& reading : there_->readings()) {
      if (why[row_of(reading)].empty() && replays_.is_read(reading.channel))
        replays_.add(reading, asked.prediction, information[row_of(reading)]);
    }
    for (size_t i = 0; i < rows_.size(); ++i) {
      rows_[i].information.push_back(information[i]);
      failed_[i].push_back(!why[i].empty());
      if (rows_[i].why.empty()) rows_[i].why = why[i];
    }
  }

  std::vector<PlanRow> take() {
    for (size_t i = 0; i < rows_.size(); ++i) {
      const std::vector<bool>& failed = failed_[i];
      const auto failures = static_cast<double>(std::ranges::count(failed, true));
      rows_[i].fails = failures / static_cast<double>(failed.size());
      if (failures == 0 || rows_[i].fails == 1) continue;
      Eigen::MatrixXd mean = Eigen::MatrixXd::Zero(replays_.count(), replays_.count());
      for (const Eigen::MatrixXd& one : rows_[i].information) mean += one;  // zero where it failed
      mean /= static_cast<double>(failed.size()) - failures;
      for (size_t d = 0; d < failed.size(); ++d) {
        if (failed[d]) rows_[i].information[d] = mean;
      }
    }
    return std::move(rows_);
  }

 private:
  static size_t row_of(const BenchReading& reading) { return static_cast<size_t>(reading.line) - 1; }

  static void say(const Bench& bench, int row, const char* what, std::vector<std::string>& why,
                  const std::vector<size_t>& places = {}) {
    for (const BenchReading& reading : bench.readings()) {
      if (reading.row != row) continue;
      std::string& text = why[places.empty() ? row_of(reading) : places[row_of(reading)]];
      if (text.empty()) text = what;
    }
  }

  /// Those of the rows that have an equilibrium: one without would hide the others'.
  void find_alternatives(const Params& p, std::vector<std::string>& why) const {
    std::vector<size_t> places;
    std::vector<std::vector<double>> rest;
    for (size_t i = 0; i < rows_.size(); ++i) {
      if (!why[i].empty()) continue;
      places.push_back(i);
      rest.push_back(rows_[i].controls);
    }
    if (rest.empty()) return;
    const std::unique_ptr<Bench> others = rest.size() < rows_.size() ? bench_at(bench_, rest) : nullptr;
    const Bench& of = others ? *others : *there_;
    for (const Alternative& other : of.protocol().alternatives(p)) {
      const char* what = other.near_jump()         ? "near a fold, where the state jumps"
                         : other.jump < 1          ? "the path jumps to another equilibrium on the way"
                         : other.other.size() == 0 ? nullptr
                                                   : "another equilibrium exists there";
      if (what == nullptr) continue;
      for (const int row : other.rows) say(of, row, what, why, places);
    }
  }

  const Bench& bench_;
  const Replays& replays_;
  std::unique_ptr<Bench> there_;
  std::vector<PlanRow> rows_;
  std::map<size_t, std::vector<bool>> failed_;  ///< by row: of each draw
};

/// The distinct rows of a bench that were measured, in the order of its file.
class MeasuredRows {
 public:
  MeasuredRows(const Bench& bench, const Replays& replays) : replays_(replays) {
    for (const BenchReading& reading : bench.readings()) {
      if (reading.row < 0 || std::isnan(reading.value) || !replays.is_read(reading.channel)) continue;
      const auto [place, is_new] = places_.try_emplace(reading.controls, rows_.size());
      if (is_new) rows_.emplace_back().controls = reading.controls;
      readings_[place->second].try_emplace(reading.channel, &reading);  // of repeats the first
    }
  }

  void ask(const Prediction& prediction) {
    for (size_t i = 0; i < rows_.size(); ++i) {
      Eigen::MatrixXd& information = rows_[i].information.emplace_back();
      information.setZero(replays_.count(), replays_.count());
      for (const auto& [channel, reading] : readings_.at(i)) replays_.add(*reading, prediction, information);
    }
  }

  std::vector<PlanRow> take() { return std::move(rows_); }

 private:
  const Replays& replays_;
  std::vector<PlanRow> rows_;
  std::map<std::vector<double>, size_t> places_;
  std::map<size_t, std::map<int, const BenchReading*>> readings_;
};

/// Numbers what is held besides the control that varies.
void number_setups(size_t varied, std::vector<PlanRow>& candidates, std::vector<PlanRow>& measured) {
  std::map<std::vector<double>, int> numbers;
  for (std::vector<PlanRow>* rows : {&measured, &candidates}) {
    for (PlanRow& row : *rows) {
      std::vector<double> held = row.controls;
      if (varied < held.size()) held.erase(held.begin() + static_cast<std::ptrdiff_t>(varied));
      row.setup = numbers.try_emplace(held, static_cast<int>(numbers.size())).first->second;
    }
  }
}

bool all_finite(const Eigen::MatrixXd& values) {
  return values.array().isFinite().all();
}

}  // namespace

void check_can_be_planned(const Bench& bench) {
  const Experiment& experiment = bench.experiment();
  const auto fail = [&](const std::string& why) { throw InputError(experiment.path + ": " + why); };
  if (bench.trials_at_rest() == nullptr)
    fail(
        fmt::format("its readings are those of {}, and a plan is one of rows at rest under controls; plan for a bench "
                    "of readings at rest",
                    experiment.kind->about));
  if (experiment.has_specimens()) fail("its bench has several specimens; plan for a bench of one of them");
  const bool directed = std::ranges::any_of(experiment.bench.controls,
                                            [](const auto& control) { return control.id == direction_control; });
  if (experiment.bench.history.counts || experiment.cables.rub || directed)
    fail(
        "what its rows read depends on the rows before them (dwells, friction of cables, unloading), and a plan takes "
        "each row by itself; leave prony or friction out to plan");
}

PlanBelief belief_after(const FitResult& fit) {
  PlanBelief belief;
  const auto count = static_cast<Index>(fit.parameters.size());
  belief.prior_deviations.resize(count);
  for (Index j = 0; j < count; ++j) {
    const ParameterEstimate& e = fit.parameters[static_cast<size_t>(j)];
    belief.parameters.push_back(parameter_of(e.spec, e.value, e.lower, e.upper));
    const double quarter = quarter_of_range(belief.parameters.back());
    belief.prior_deviations[j] = std::isfinite(quarter) && quarter > 0 ? quarter : 100 * belief.parameters.back().range;
  }
  belief.covariance = covariance_of_both(fit.covariance, belief.prior_deviations);
  return belief;
}

PlanBelief belief_before(const Bench& bench) {
  PlanBelief belief;
  const std::vector<FreeParameter> free = bench.free();
  belief.prior_deviations.resize(static_cast<Index>(free.size()));
  for (const FreeParameter& one : free) {
    const ParameterSpec& spec = bench.protocol().parameters()[one.index];
    const PlanBelief::Parameter& parameter =
        belief.parameters.emplace_back(parameter_of(spec, one.start, one.lower, one.upper));
    const double quarter = quarter_of_range(parameter);
    const bool chosen = one.bounds_chosen && std::isfinite(quarter);
    if (!chosen && !spec.logarithmic)
      throw InputError(
          fmt::format("{}: [fit.free.{}]: before any reading its bounds say how well it is known; give it "
                      "lower and upper",
                      bench.experiment().path, spec.id));
    belief.prior_deviations[static_cast<Index>(belief.parameters.size()) - 1] = chosen ? quarter : deviation_of_factor;
  }
  belief.covariance = belief.prior_deviations.cwiseAbs2().asDiagonal();
  return belief;
}

size_t varied_control(const Bench& bench) {
  if (bench.drawn_control() >= 0) return static_cast<size_t>(bench.drawn_control());
  size_t varied = 0;
  for (size_t k = 1; k < bench.controls().size(); ++k) {
    if (bench.values_of(k).size() > bench.values_of(varied).size()) varied = k;
  }
  return varied;
}

PlanKnowledge ask_rows(const Bench& bench, const PlanBelief& belief, const PlanQuestion& question,
                       const SigmaOfReading& sigma, const std::function<void(const std::string&)>& progress) {
  check_can_be_planned(bench);
  const Replays replays(belief, question, sigma);
  Candidates candidates(bench, replays, question.rows);
  MeasuredRows measured(bench, replays);
  const bool has_readings =
      std::ranges::any_of(bench.measurements(), [](const Measurement& m) { return !std::isnan(m.value); });
  const std::unique_ptr<Bench> goal = question.predicted ? bench_at(bench, {question.predicted->controls}) : nullptr;
  const SymmetricModes modes = symmetric_modes(belief.covariance);
  const Eigen::MatrixXd root = modes.vectors * modes.values.cwiseMax(0.0).cwiseSqrt().asDiagonal();
  Draws random(question.seed);
  PlanKnowledge knowledge;
  const auto draws = static_cast<size_t>(std::max(1, question.draws));
  for (size_t attempt = 0; knowledge.known.size() < draws && attempt < 3 * draws; ++attempt) {
    Eigen::VectorXd away = Eigen::VectorXd::Zero(replays.count());
    if (attempt > 0) {
      for (double& one : away) one = random.normal();
      away = root * away;
    }
    if (progress) progress(fmt::format("draw {} of {} of the parameters", knowledge.known.size() + 1, draws));
    const std::vector<double> values = values_at(belief, away);
    Eigen::MatrixXd known = belief.prior_deviations.cwiseAbs2().cwiseInverse().asDiagonal();
    Asked own;
    if (has_readings) {
      own = replays.ask(bench, values);
      const NoiseScaled scaled = noise_scaled(own.prediction, bench.measurements());
      if (!all_finite(scaled.residuals) || !all_finite(scaled.jacobian)) {
        if (attempt == 0)
          throw InputError(fmt::format("{}: its own readings cannot be replayed at the best values, {}",
                                       bench.experiment().path,
                                       own.prediction.failures.empty() ? "" : own.prediction.failures.front()));
        ++knowledge.dropped;
        continue;
      }
      known += scaled.jacobian.transpose() * scaled.jacobian;
    }
    if (goal) {
      const Asked there = replays.ask(*goal, values);
      for (const BenchReading& reading : goal->readings()) {
        if (reading.channel != question.predicted->channel) continue;
        const double value = there.prediction.values[reading.row];
        if (!std::isfinite(value)) break;
        if (attempt == 0) knowledge.predicted = value;
        knowledge.slopes.emplace_back(there.prediction.derivatives.row(reading.row));
      }
      if (knowledge.slopes.size() == knowledge.known.size()) {
        if (attempt == 0)
          throw InputError(
              fmt::format("{}: what is to be predicted has no equilibrium at the best values{}; ask at "
                          "smaller loads",
                          bench.experiment().path,
                          there.prediction.failures.empty() ? "" : ": " + there.prediction.failures.front()));
        ++knowledge.dropped;
        continue;
      }
    }
    knowledge.values.push_back(values);
    knowledge.known.push_back(known);
    if (has_readings) measured.ask(own.prediction);
    candidates.ask(values);
  }
  knowledge.candidates = candidates.take();
  if (has_readings) knowledge.measured = measured.take();
  number_setups(varied_control(bench), knowledge.candidates, knowledge.measured);
  return knowledge;
}

PlanGoal goal_of_parameter(const PlanBelief& belief, size_t parameter, size_t draws, double floor) {
  Eigen::VectorXd gradient = Eigen::VectorXd::Zero(static_cast<Index>(belief.parameters.size()));
  gradient[static_cast<Index>(parameter)] = belief.parameters[parameter].scale();
  return {std::vector<Eigen::VectorXd>(draws, gradient), floor};
}

namespace {

/// A row far beyond the candidates: what it says, and whether surfaces touch there.
struct Beyond {
  double fraction = 0;  ///< of the goal's noise that rows like it take away
  std::optional<bool> touching{};
};

/// Looks along one control.
class ReachScan {
 public:
  ReachScan(const Bench& bench, const PlanBelief& belief, const PlanQuestion& question, const SigmaOfReading& sigma,
            const PlanKnowledge& knowledge, const PlanGoal& goal, int count)
      : bench_(bench), question_(question), knowledge_(knowledge), replays_(belief, question, sigma), count_(count) {
    task_.known = knowledge.known;
    task_.goal.gradients = goal.gradients;
    task_.rows.resize(1);
  }

  std::optional<PlanReach> along(size_t control, bool largest, double from, double to, double worth) {
    const double step = (to - from) / steps;
    std::vector<std::vector<double>> rows;
    for (int i = 0; i <= steps; ++i) rows.push_back(row_at(control, largest, from + i * step));
    const std::vector<Beyond> found = at(rows);
    for (size_t i = 1; i < found.size(); ++i) {
      if (!(found[i].fraction >= worth)) continue;
      double unseen = rows[i - 1][control], seen = rows[i][control];
      Beyond there = found[i];
      while (std::abs(seen - unseen) > 1e-3 * std::abs(to - from)) {
        const double middle = (seen + unseen) / 2;
        const Beyond one = at({row_at(control, largest, middle)}).front();
        if (one.fraction >= worth) {
          seen = middle;
          there = one;
        } else {
          unseen = middle;
        }
      }
      return PlanReach{control, row_at(control, largest, seen), to > from, there.touching, found.front().touching};
    }
    return std::nullopt;
  }

 private:
  static constexpr int steps = 12;

  /// The other controls at the largest, or smallest, values of the candidates.
  std::vector<double> row_at(size_t control, bool largest, double value) const {
    std::vector<double> row = question_.rows.front();
    for (const std::vector<double>& other : question_.rows) {
      for (size_t k = 0; k < row.size(); ++k) {
        if (largest ? std::abs(other[k]) > std::abs(row[k]) : std::abs(other[k]) < std::abs(row[k])) row[k] = other[k];
      }
    }
    row[control] = value;
    return row;
  }

  std::vector<Beyond> at(const std::vector<std::vector<double>>& rows) {
    const std::unique_ptr<Bench> there = bench_at(bench_, rows);
    std::vector<int> loads;  // whose sensitivities tell of the state
    for (const AxisRecord& control : bench_.controls()) {
      if (control.quantity == name_of(Quantity::force) || control.quantity == name_of(Quantity::mass))
        loads.push_back(there->protocol().parameters().index(control.id));
    }
    const Eigen::MatrixXd nothing = Eigen::MatrixXd::Zero(replays_.count(), replays_.count());
    std::vector<std::vector<Eigen::MatrixXd>> information(rows.size());
    std::map<std::vector<double>, bool> touching;  // at the best values
    for (const std::vector<double>& values : knowledge_.values) {
      const Asked asked = replays_.ask(*there, values, loads);
      for (const TangentStiffness& one : there->tangent_stiffness()) touching.try_emplace(one.controls, one.touching);
      for (std::vector<Eigen::MatrixXd>& row : information) row.push_back(nothing);
      for (const BenchReading& reading : there->readings()) {
        const double value = asked.prediction.values[reading.row];
        if (std::isfinite(value) && replays_.is_read(reading.channel))
          replays_.add(reading, asked.prediction, information[static_cast<size_t>(reading.line) - 1].back());
      }
    }
    const double before = widths_after(task_, {}).noise;
    std::vector<Beyond> found;
    for (size_t i = 0; i < rows.size(); ++i) {
      Beyond& beyond = found.emplace_back();
      task_.rows.front().information = information[i];
      const double after = widths_after(task_, std::vector<size_t>(static_cast<size_t>(count_), 0)).noise;
      beyond.fraction = 1 - after / before;
      if (const auto one = touching.find(rows[i]); one != touching.end()) beyond.touching = one->second;
    }
    return found;
  }

  const Bench& bench_;
  const PlanQuestion& question_;
  const PlanKnowledge& knowledge_;
  const Replays replays_;
  int count_;
  PlanTask task_;
};

}  // namespace

std::vector<PlanReach> where_seen(const Bench& bench, const PlanBelief& belief, const PlanQuestion& question,
                                  const SigmaOfReading& sigma, const PlanKnowledge& knowledge, const PlanGoal& goal,
                                  int count, double worth, const std::function<void(const std::string&)>& progress) {
  ReachScan scan(bench, belief, question, sigma, knowledge, goal, count);
  std::vector<PlanReach> found;
  for (size_t k = 0; k < bench.controls().size(); ++k) {
    if (!bench.controls()[k].labels.empty()) continue;
    if (progress) progress(fmt::format("looking along {} beyond the candidates", bench.controls()[k].id));
    double low = infinity, high = -infinity;
    for (const std::vector<double>& row : question.rows) {
      low = std::min(low, row[k]);
      high = std::max(high, row[k]);
    }
    const double range = high > low ? high - low : std::max(std::abs(low), std::abs(high));
    if (range == 0) continue;
    const double highest = high <= 0 ? std::min(0.0, high + range) : high + range;
    const double lowest = low >= 0 ? std::max(0.0, low - range) : low - range;
    for (const auto& [from, to] : {std::pair(high, highest), std::pair(low, lowest)}) {
      if (from == to) continue;
      std::optional<PlanReach> nearest;
      for (const bool largest : {false, true}) {
        const std::optional<PlanReach> reach = scan.along(k, largest, from, to, worth);
        if (reach && (!nearest || std::abs(reach->controls[k] - from) < std::abs(nearest->controls[k] - from)))
          nearest = reach;
      }
      if (nearest) found.push_back(*nearest);
    }
  }
  return found;
}

}  // namespace taut
