#include "calib/fit/explanations.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <optional>

#include "calib/data/slips.hpp"
#include "calib/fit/distributions.hpp"
#include "calib/fit/goodness_of_fit.hpp"
#include "sim/core/dense.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

constexpr double parallel_cosine = 0.98;  ///< cosine from which on two columns are not told apart
constexpr double unseen = 0.01;           ///< singular value of a direction that the readings do not see, as in fit()
constexpr size_t most_per_kind = 3, most_told = 5;
constexpr const char* exchanged_lines = "exchanged lines";

/// "+0.201 +- 0.006 mm"; percentages for pure numbers.
std::string signed_text(double value, double error, const std::string& si_unit) {
  const DisplayUnit unit = si_unit == "1" ? DisplayUnit{"%", 0.01} : display_unit(value, si_unit);
  const double digits = std::isfinite(error) && error > 0 ? 1 - std::floor(std::log10(error / unit.factor)) : 2;
  const int decimals = static_cast<int>(std::clamp(digits, 0.0, 9.0));
  return fmt::format("{:+.{}f} +- {:.{}f} {}", value / unit.factor, decimals, error / unit.factor, decimals, unit.name);
}

/// "+0.20, +0.21 mm".
std::string signed_list(const std::vector<double>& values, const std::string& si_unit) {
  double largest = 0;
  for (const double value : values) largest = std::max(largest, std::abs(value));
  const DisplayUnit unit = si_unit == "1" ? DisplayUnit{"%", 0.01} : display_unit(largest, si_unit);
  std::string text;
  for (const double value : values) text += fmt::format("{}{:+.2g}", text.empty() ? "" : ", ", value / unit.factor);
  return text + " " + unit.name;
}

/// Something to try: columns of the linearised model, or two readings that trade places.
struct Candidate {
  std::string kind, name, unit, ending;  ///< ending: behind the values, " per trial"
  Eigen::MatrixXd columns;    ///< over sigma: of one unit of each unknown; empty: a reading off, or an exchange of two
  std::vector<size_t> about;  ///< readings; empty: all
  std::function<std::string(const std::vector<double>&)> hint = {};  ///< of the values, or ""
};

/// A candidate with what it does.
struct JudgedCandidate {
  Candidate candidate;
  Explanation explanation;
  Eigen::MatrixXd beyond;  ///< orthonormal: its directions in the readings beyond what the parameters can do
};

/// The linearised fit: directions of the residuals that the free parameters span.
class LinearisedFit {
 public:
  LinearisedFit(const Prediction& prediction, const std::vector<Measurement>& measurements, const FitResult& fit)
      : fit_(fit), count_(static_cast<Eigen::Index>(fit.parameters.size())) {
    const NoiseScaled scaled = noise_scaled(prediction, measurements);
    residuals = -scaled.residuals;
    units_ = Eigen::VectorXd::Zero(count_);
    for (Eigen::Index j = 0; j < count_; ++j) {
      const ParameterEstimate& e = fit.parameters[static_cast<size_t>(j)];
      const double range = e.upper - e.lower;
      const double unit = e.spec.logarithmic || !std::isfinite(range) ? std::max(std::abs(e.value), 1e-12) : range;
      const double uphill = residuals.dot(scaled.jacobian.col(j)),
                   room = uphill > 0 ? e.upper - e.value : e.value - e.lower;
      if (room > 1e-6 * unit) units_[j] = unit;
    }
    slopes = scaled.jacobian.leftCols(count_) * units_.asDiagonal();
    const auto [U, s, V] = singular_values(slopes);
    const Eigen::Index seen = (s.array() > unseen).count();
    basis = U.leftCols(seen);
    to_steps_ = V.leftCols(seen) * s.head(seen).cwiseInverse().asDiagonal();
  }

  Eigen::MatrixXd beyond(const Eigen::MatrixXd& columns) const {
    return columns - basis * (basis.transpose() * columns);
  }

  /// Changes of the parameters [SI] for a step in the basis; stiffnesses to first order in their reciprocal and by at
  /// most a factor of three, as gauss_newton_step() does.
  std::vector<double> shifts(const Eigen::VectorXd& in_basis) const {
    const Eigen::VectorXd step = to_steps_ * in_basis;
    std::vector<double> changes;
    for (Eigen::Index j = 0; j < count_; ++j) {
      const ParameterEstimate& e = fit_.parameters[static_cast<size_t>(j)];
      double to = e.value + units_[j] * step[j];
      if (e.spec.logarithmic) to = e.value / (1 - std::clamp(step[j], -2.0, 2.0 / 3));
      changes.push_back(std::clamp(to, e.lower, e.upper) - e.value);
    }
    return changes;
  }

  /// The free parameters that make up for a column (all of it, in fact); none where it can be told apart from them.
  std::vector<std::string> makes_up(const Eigen::VectorXd& column) const {
    const double size = column.norm();
    if (!(beyond(column).norm() < std::sqrt(1 - parallel_cosine * parallel_cosine) * size)) return {};
    const Eigen::VectorXd step = to_steps_ * (basis.transpose() * column);
    std::vector<std::string> ids;
    for (Eigen::Index j = 0; j < count_; ++j) {
      if (std::abs(step[j]) * slopes.col(j).norm() > 0.2 * size)
        ids.push_back(fit_.parameters[static_cast<size_t>(j)].spec.id);
    }
    return ids;
  }

  Eigen::VectorXd residuals;  ///< measured - predicted, over sigma
  Eigen::MatrixXd slopes;     ///< of the predictions over sigma, in units of each parameter's size
  Eigen::MatrixXd basis;      ///< orthonormal

 private:
  const FitResult& fit_;
  Eigen::Index count_;
  Eigen::VectorXd units_;
  Eigen::MatrixXd to_steps_;
};

/// The list of what is tried.
class Candidates {
 public:
  Candidates(const ExplainedReadings& bench, const Prediction& prediction, const std::vector<Measurement>& measurements,
             const FitResult& fit)
      : bench_(bench), fit_(fit), count_(static_cast<Eigen::Index>(measurements.size())) {
    const auto parameters = static_cast<Eigen::Index>(fit.parameters.size());
    const auto scaled = noise_scaled(prediction, measurements).jacobian;
    by_parameter_ = scaled.leftCols(parameters);
    by_control_ = scaled.middleCols(parameters, static_cast<Eigen::Index>(bench.controls.size()));
    by_assumed_ = scaled.rightCols(static_cast<Eigen::Index>(bench.assumed.size()));
    predicted_.resize(count_);
    weight_.resize(count_);
    for (Eigen::Index i = 0; i < count_; ++i) {
      const Measurement& m = measurements[static_cast<size_t>(i)];
      weight_[i] = 1 / m.sigma;
      predicted_[i] = prediction.values[m.row] / m.sigma;
    }
  }

  std::vector<Candidate> all() {
    for (size_t c = 0; c < bench_.channels.size(); ++c) add_channel(static_cast<int>(c));
    for (size_t k = 0; k < bench_.controls.size(); ++k) add_control(k);
    for (size_t k = 0; k < bench_.assumed.size(); ++k)
      add({"a number taken for granted",
           fmt::format("another {}", bench_.assumed[k].id),
           bench_.assumed[k].unit,
           "",
           by_assumed_.col(static_cast<Eigen::Index>(k)),
           {}});
    add_drifts();
    add_stiffnesses();
    add_single_readings();
    return std::move(found_);
  }

 private:
  using Groups = std::map<double, std::vector<size_t>>;

  const Reading& reading(Eigen::Index i) const { return bench_.readings[static_cast<size_t>(i)]; }
  double control(Eigen::Index i, size_t k) const { return reading(i).controls[k]; }

  void add(Candidate candidate) {
    if (candidate.columns.norm() > 0) found_.push_back(std::move(candidate));
  }

  /// Readings by a key, where there are two groups at least and three readings in each on average.
  Groups groups_by(const std::function<double(Eigen::Index)>& key) const {
    Groups groups;
    for (Eigen::Index i = 0; i < count_; ++i) groups[key(i)].push_back(static_cast<size_t>(i));
    if (groups.size() < 2 || 3 * static_cast<Eigen::Index>(groups.size()) > count_) groups.clear();
    return groups;
  }
  Groups by_held(size_t k) const {
    if (static_cast<int>(k) == bench_.load) return {};
    return groups_by([&](Eigen::Index i) { return control(i, k); });
  }
  /// Trials are numbered as they come in the file.
  Groups by_trial() const {
    std::map<std::string, double> numbers;
    for (const Reading& r : bench_.readings) numbers.try_emplace(r.trial, static_cast<double>(numbers.size()));
    return groups_by([&](Eigen::Index i) { return numbers.at(reading(i).trial); });
  }

  /// A column for each group but the first `without`.
  static Eigen::MatrixXd split(const Eigen::VectorXd& column, const Groups& groups, Eigen::Index without) {
    const auto n = static_cast<Eigen::Index>(groups.size()) - without;
    Eigen::MatrixXd columns = Eigen::MatrixXd::Zero(column.size(), std::max<Eigen::Index>(n, 0));
    Eigen::Index g = -without;
    for (const auto& [key, members] : groups) {
      for (const size_t i : members) {
        if (g >= 0) columns(static_cast<Eigen::Index>(i), g) = column[static_cast<Eigen::Index>(i)];
      }
      ++g;
    }
    return columns;
  }

  void add_channel(int c) {
    const auto& [id, unit] = bench_.channels[static_cast<size_t>(c)];
    Eigen::VectorXd zero = weight_, scale = predicted_;
    for (Eigen::Index i = 0; i < count_; ++i) {
      if (reading(i).channel != c) zero[i] = scale[i] = 0;
    }
    const std::string name = fmt::format("zero error of '{}'", id);
    add({"zero error", "a " + name, unit, "", zero, {}});
    for (size_t k = 0; k < bench_.controls.size(); ++k)
      add({"zero error",
           fmt::format("a {} for each '{}'", name, bench_.controls[k].id),
           unit,
           "",
           split(zero, by_held(k), 0),
           {}});
    add({"zero error", fmt::format("a {} for each trial", name), unit, "", split(zero, by_trial(), 0), {}});
    const auto slip = [](const std::vector<double>& values) {
      return 1 + values.front() < 0 ? std::string("the other sign?") : slip_of(1 + values.front(), 0.05);
    };
    add({"scale error", fmt::format("a scale error of '{}'", id), "1", "", scale, {}, slip});
  }

  void add_control(size_t k) {
    const auto& [id, unit] = bench_.controls[k];
    const Eigen::VectorXd slope = by_control_.col(static_cast<Eigen::Index>(k));
    Eigen::VectorXd scale = slope, giving = weight_;
    double largest = 0;
    for (Eigen::Index i = 0; i < count_; ++i) largest = std::max(largest, std::abs(control(i, k)));
    for (Eigen::Index i = 0; i < count_; ++i) {
      const std::string& read = bench_.channels[static_cast<size_t>(reading(i).channel)].unit;
      scale[i] *= control(i, k);
      giving[i] *= read == "m" || read == "rad" ? control(i, k) / std::max(largest, 1e-300) : 0;
    }
    const bool mass = unit == "kg", load = mass || unit == "N";
    add({"zero of a control",
         fmt::format("{} '{}'{}", load ? "a constant part of" : "a zero error of", id,
                     mass ? " that is not written (the hanger?)" : ""),
         unit,
         "",
         slope,
         {}});
    const auto slip = [](const std::vector<double>& values) { return slip_of(1 + values.front(), 0.05); };
    add({"scale of a control",
         fmt::format("a scale error of '{}'{}", id, mass ? " (or another g)" : ""),
         "1",
         "",
         scale,
         {},
         slip});
    if (load)
      add({"something gives",
           fmt::format("a clamp or frame that gives way in proportion to '{}'", id),
           bench_.channels.front().unit,
           " at the largest",
           one_per_channel(giving),
           {}});
  }

  /// A column for each channel that it is not zero for, of the unit of the first.
  Eigen::MatrixXd one_per_channel(const Eigen::VectorXd& column) const {
    Groups groups;
    for (Eigen::Index i = 0; i < count_; ++i) {
      const auto c = static_cast<size_t>(reading(i).channel);
      if (bench_.channels[c].unit == bench_.channels.front().unit)
        groups[static_cast<double>(c)].push_back(static_cast<size_t>(i));
    }
    return split(column, groups, 0);
  }

  void add_drifts() {
    const Groups trials = by_trial();
    Eigen::VectorXd drift = Eigen::VectorXd::Zero(count_), over_file = predicted_;
    for (const auto& [number, members] : trials) {
      for (const size_t i : members)
        drift[static_cast<Eigen::Index>(i)] = number * predicted_[static_cast<Eigen::Index>(i)];
    }
    add({"drift", "a drift from trial to trial", "1", " per trial", drift, {}});
    int first = bench_.readings.front().line, last = first;
    for (const Reading& r : bench_.readings) {
      first = std::min(first, r.line);
      last = std::max(last, r.line);
    }
    for (Eigen::Index i = 0; i < count_; ++i)
      over_file[i] *= (reading(i).line - first) / std::max(1.0, last - first + 0.0);
    add({"drift", "a drift over the rows of the file", "1", " from the first to the last", over_file, {}});
  }

  void add_stiffnesses() {
    for (size_t j = 0; j < fit_.parameters.size(); ++j) {
      const ParameterEstimate& e = fit_.parameters[j];
      if (!e.spec.logarithmic) continue;
      const Eigen::VectorXd slope = e.value * by_parameter_.col(static_cast<Eigen::Index>(j));
      for (size_t k = 0; k < bench_.controls.size(); ++k) {
        const std::string& id = bench_.controls[k].id;
        add({"stiffness per held control",
             fmt::format("another {} at each '{}'", e.spec.id, id),
             "1",
             " against that at the first",
             split(slope, by_held(k), 1),
             {}});
        if (static_cast<int>(k) != bench_.load) continue;
        double largest = 1e-300;
        for (Eigen::Index i = 0; i < count_; ++i) largest = std::max(largest, std::abs(control(i, k)));
        Eigen::VectorXd changing = slope;
        for (Eigen::Index i = 0; i < count_; ++i) changing[i] *= std::abs(control(i, k)) / largest;
        add({"law",
             fmt::format("{} that changes with '{}' (another law?)", e.spec.id, id),
             "1",
             " at the largest",
             changing,
             {}});
      }
    }
  }

  void add_single_readings() {
    for (Eigen::Index i = 0; i < count_; ++i) {
      const Reading& r = reading(i);
      const ExplainedReadings::Axis& channel = bench_.channels[static_cast<size_t>(r.channel)];
      const bool several = bench_.channels.size() > 1;
      const double value = r.value;
      const auto slip = [value](const std::vector<double>& values) {
        return slip_of(value / (value - values.front()), 0.05);
      };
      found_.push_back(
          {"a single reading",
           fmt::format("line {}{} alone being off", r.line, several ? fmt::format(" ('{}')", channel.id) : ""),
           channel.unit,
           "",
           {},
           {static_cast<size_t>(i)},
           slip});
    }
  }

  const ExplainedReadings& bench_;
  const FitResult& fit_;
  Eigen::Index count_;
  Eigen::MatrixXd by_parameter_, by_control_, by_assumed_;  ///< derivatives over sigma
  Eigen::VectorXd predicted_, weight_;                      ///< over sigma; 1/sigma
  std::vector<Candidate> found_;
};

/// Tries them one by one.
class Trier {
 public:
  Trier(const std::vector<Measurement>& measurements, const LinearisedFit& linear, int dof)
      : measurements_(measurements), linear_(linear), left_(linear.beyond(linear.residuals)), dof_(dof) {}

  JudgedCandidate add_columns(const Candidate& candidate) const {
    JudgedCandidate judged{candidate, {}, {}};
    Eigen::MatrixXd A = candidate.columns;
    if (A.size() == 0) A = column_of(candidate.about.front());
    const Eigen::MatrixXd beyond = linear_.beyond(A);
    const Eigen::VectorXd sizes = A.colwise().norm().transpose().cwiseMax(1e-300);
    const auto [U, s, V] = singular_values(beyond * sizes.cwiseInverse().asDiagonal());
    const Eigen::Index rank = (s.array() > 1e-3).count();
    const Eigen::MatrixXd root =
        sizes.cwiseInverse().asDiagonal() * V.leftCols(rank) * s.head(rank).cwiseInverse().asDiagonal();
    const Eigen::VectorXd along = U.leftCols(rank).transpose() * left_, values = root * along,
                          errors = root.rowwise().norm();
    Explanation& e = judged.explanation;
    e.fall = along.squaredNorm();
    judge(e, rank, static_cast<int>(rank));
    e.unit = candidate.unit;
    if (rank > 0) {
      e.values.assign(values.begin(), values.end());
      e.standard_errors.assign(errors.begin(), errors.end());
    }
    e.shifts = linear_.shifts(linear_.basis.transpose() * (linear_.residuals - A * values));
    judged.beyond = U.leftCols(rank);
    if (A.cols() == 1) e.like_parameters = linear_.makes_up(A);
    return judged;
  }

  /// Readings i and j trade places, with their sigmas: two rows of the normal equations, in the fit's basis, change.
  JudgedCandidate exchange(size_t i, size_t j) const {
    const Eigen::MatrixXd& Q = linear_.basis;
    Eigen::MatrixXd N = Eigen::MatrixXd::Identity(Q.cols(), Q.cols());
    Eigen::VectorXd g = Q.transpose() * linear_.residuals;
    double squares = linear_.residuals.squaredNorm();
    for (const auto& [k, from] : {std::pair(i, j), std::pair(j, i)}) {
      const Measurement &own = measurements_[k], &other = measurements_[from];
      const auto row = static_cast<Eigen::Index>(k);
      const Eigen::VectorXd q = Q.row(row).transpose(), to = q * own.sigma / other.sigma;
      const double r = linear_.residuals[row], there = (r * own.sigma + other.value - own.value) / other.sigma;
      N += to * to.transpose() - q * q.transpose();
      g += to * there - q * r;
      squares += there * there - r * r;
    }
    JudgedCandidate judged;
    judged.candidate.kind = exchanged_lines;
    judged.candidate.about = {i, j};
    const std::optional<Eigen::MatrixXd> step = solve_positive_definite(N, g);
    if (!step) return judged;
    judged.explanation.fall = left_.squaredNorm() - (squares - g.dot(step->col(0)));
    judge(judged.explanation, 1, 0);
    judged.explanation.shifts = linear_.shifts(step->col(0));
    return judged;
  }

  /// The direction of an exchange, which costs more than all else of it.
  Eigen::VectorXd direction_of_exchange(size_t i, size_t j) const {
    const double apart = measurements_[j].value - measurements_[i].value;
    const Eigen::VectorXd moved = apart * (column_of(i) - column_of(j));
    return linear_.beyond(moved).normalized();
  }

  /// Whether a reading is off so far that it could gain by an exchange.
  bool is_off(size_t i) const { return std::abs(left_[static_cast<Eigen::Index>(i)]) > 2; }

 private:
  /// Of one reading being off.
  Eigen::VectorXd column_of(size_t i) const {
    return Eigen::VectorXd::Unit(left_.size(), static_cast<Eigen::Index>(i)) / measurements_[i].sigma;
  }

  /// p-value before correction.
  void judge(Explanation& e, Eigen::Index unknowns, int taken) const {
    e.chi_squared = std::max(0.0, left_.squaredNorm() - e.fall);
    e.dof = dof_ - taken;
    if (!(e.fall > 0) || unknowns == 0 || e.dof <= 0) return;
    const double k = static_cast<double>(unknowns);
    e.p_value = chi_squared_probability(e.fall, k);
    if (chi_squared_probability(e.chi_squared, e.dof) < 0.05)
      e.p_value = f_probability(e.fall / k / (e.chi_squared / e.dof), k, e.dof);
  }

  const std::vector<Measurement>& measurements_;
  const LinearisedFit& linear_;
  Eigen::VectorXd left_;  ///< residuals beyond what the parameters can do
  int dof_;
};

bool more_telling(const JudgedCandidate& a, const JudgedCandidate& b) {
  if (a.explanation.p_value != b.explanation.p_value) return a.explanation.p_value < b.explanation.p_value;
  return a.explanation.chi_squared - 2 * a.explanation.dof < b.explanation.chi_squared - 2 * b.explanation.dof;
}

/// The best of a kind.
struct BestOfKind {
  std::vector<JudgedCandidate> best = {};
  size_t possible = 0;  ///< candidates that there are

  void offer(JudgedCandidate one) {
    if (best.size() == most_per_kind && !more_telling(one, best.back())) return;
    best.insert(std::ranges::upper_bound(best, one, more_telling), std::move(one));
    if (best.size() > most_per_kind) best.pop_back();
  }
};

/// All pairs of readings of one channel, of which one is off.
BestOfKind try_exchanges(const ExplainedReadings& bench, const Trier& trier) {
  BestOfKind kind;
  for (size_t b = 0; b < bench.readings.size(); ++b) {
    for (size_t a = 0; a < b; ++a) {
      const Reading &one = bench.readings[a], &other = bench.readings[b];
      if (one.channel != other.channel || one.value == other.value) continue;
      ++kind.possible;
      if (!trier.is_off(a) && !trier.is_off(b)) continue;
      JudgedCandidate judged = trier.exchange(a, b);
      if (judged.explanation.fall > 0) kind.offer(std::move(judged));
    }
  }
  for (JudgedCandidate& judged : kind.best) {
    const size_t a = judged.candidate.about[0], b = judged.candidate.about[1];
    judged.candidate.name = fmt::format("lines {} and {} exchanged", bench.readings[a].line, bench.readings[b].line);
    judged.beyond = trier.direction_of_exchange(a, b);
  }
  return kind;
}

/// The words of an explanation whose numbers are known.
void put_in_words(const ExplainedReadings& bench, JudgedCandidate& judged) {
  const Candidate& candidate = judged.candidate;
  Explanation& e = judged.explanation;
  e.kind = candidate.kind;
  e.name = e.what = candidate.name;
  for (const size_t i : candidate.about) e.lines.push_back(bench.readings[i].line);
  if (e.values.empty()) return;
  e.what += ": " + (e.values.size() == 1 ? signed_text(e.values.front(), e.standard_errors.front(), e.unit)
                                         : signed_list(e.values, e.unit));
  e.what += candidate.ending;
  const std::string hint = candidate.hint ? candidate.hint(e.values) : "";
  if (!hint.empty()) e.what += fmt::format(" ({})", hint);
}

/// Whether all directions of one are directions of the other.
bool within(const Eigen::MatrixXd& one, const Eigen::MatrixXd& other) {
  if (one.cols() == 0 || one.cols() > other.cols()) return false;
  return (other.transpose() * one).colwise().norm().minCoeff() > parallel_cosine;
}

/// Says of each which others it is parallel to, and which it has among its special cases.
void note_parallels(std::vector<JudgedCandidate>& all) {
  for (JudgedCandidate& one : all) {
    for (const JudgedCandidate& other : all) {
      if (&one == &other || !within(other.beyond, one.beyond)) continue;
      const bool same = other.beyond.cols() == one.beyond.cols();
      (same ? one.explanation.like : one.explanation.includes).push_back(other.explanation.name);
    }
  }
}

}  // namespace

std::vector<Explanation> explain_misfit(const ExplainedReadings& readings, const Prediction& prediction,
                                        const std::vector<Measurement>& measurements, const FitResult& fit) {
  const LinearisedFit linear(prediction, measurements, fit);
  const Trier trier(measurements, linear, fit.dof);
  if (fit.dof <= 0) return {};
  std::map<std::string, BestOfKind> kinds;
  for (const Candidate& candidate : Candidates(readings, prediction, measurements, fit).all()) {
    BestOfKind& kind = kinds[candidate.kind];
    ++kind.possible;
    kind.offer(trier.add_columns(candidate));
  }
  kinds[exchanged_lines] = try_exchanges(readings, trier);
  std::vector<JudgedCandidate> best;
  for (auto& [name, kind] : kinds) {
    for (JudgedCandidate& one : kind.best) {
      Explanation& e = one.explanation;
      e.p_value = std::min(1.0, e.p_value * static_cast<double>(kinds.size() * kind.possible));
      put_in_words(readings, one);
      best.push_back(std::move(one));
    }
  }
  std::ranges::stable_sort(best, more_telling);
  note_parallels(best);
  std::vector<Explanation> found;
  for (JudgedCandidate& one : best) found.push_back(std::move(one.explanation));
  return found;
}

std::vector<Explanation> telling(const std::vector<Explanation>& explanations) {
  std::vector<Explanation> told;
  for (const Explanation& e : explanations) {
    const auto names = [](const Explanation& one, const Explanation& other) {
      return std::ranges::count(one.like, other.name) + std::ranges::count(one.includes, other.name) > 0;
    };
    const bool said = std::ranges::any_of(told, [&](const Explanation& one) { return names(one, e) || names(e, one); });
    if (e.p_value < telling_p_value && !said && told.size() < most_told) told.push_back(e);
  }
  return told;
}

}  // namespace taut
