#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "calib/studies/tuning.hpp"
#include "sim/core/numbers.hpp"

namespace taut {
namespace {

/// `count` even steps' ends from lower to upper, and with `halves` what is between them.
std::vector<double> even(double lower, double upper, size_t count, bool halves) {
  const size_t steps = (count - 1) * (halves ? 2 : 1);
  std::vector<double> values;
  for (size_t i = 0; i <= steps; ++i) {
    const double t = static_cast<double>(i) / static_cast<double>(steps);
    values.push_back((1 - t) * lower + t * upper);
  }
  return values;
}

/// The place of the interval that holds x among ascending values, at most the last one.
size_t interval_of(const std::vector<double>& values, double x) {
  const auto above = std::ranges::upper_bound(values, x);
  const size_t i = static_cast<size_t>(above - values.begin());
  return std::clamp<size_t>(i, 1, values.size() - 1) - 1;
}

/// The controls of all pairs of these values, those of one value of the control after each other.
std::vector<std::vector<double>> rows_of(const TuneQuestion& question, size_t load, const std::vector<double>& controls,
                                         const std::vector<double>& loads) {
  std::vector<std::vector<double>> rows;
  for (const double control : controls) {
    for (const double value : loads) {
      std::vector<double>& row = rows.emplace_back(question.controls);
      row[question.control] = control;
      row[load] = value;
    }
  }
  return rows;
}

/// A map that is made.
class Mapper {
 public:
  Mapper(const StiffnessReplay& replay, const TuneQuestion& question, double largest_load, const MapOptions& options)
      : replay_(replay), question_(question), options_(options) {
    map_.control = question.control;
    map_.load = replay.load();
    map_.controls = even(question.lower, question.upper, options.controls, false);
    map_.loads = even(0, largest_load, options.loads, false);
    fine_loads_ = even(0, largest_load, options.loads, true);
  }

  StiffnessMap made(const std::function<void(const std::string&)>& progress) {
    while (true) {
      if (progress) progress(fmt::format("the map over {} values", map_.controls.size()));
      solve_columns();
      fill();
      const std::vector<double> more = where_coarse();
      if (more.empty()) break;
      map_.controls.insert(map_.controls.end(), more.begin(), more.end());
      std::ranges::sort(map_.controls);
    }
    return std::move(map_);
  }

 private:
  std::vector<double> middles() const {
    std::vector<double> values;
    for (size_t i = 0; i + 1 < map_.controls.size(); ++i)
      values.push_back((map_.controls[i] + map_.controls[i + 1]) / 2);
    return values;
  }

  /// All values of the control that nodes and checks need and that are not known, each a path over the loads.
  void solve_columns() {
    std::vector<double> wanted = map_.controls;
    for (const double value : middles()) wanted.push_back(value);
    std::erase_if(wanted, [&](double value) { return columns_.contains(value); });
    if (wanted.empty()) return;
    const std::vector<TunedState> states = replay_.at(rows_of(question_, map_.load, wanted, fine_loads_));
    for (size_t i = 0; i < wanted.size(); ++i) {
      const auto first = states.begin() + static_cast<std::ptrdiff_t>(i * fine_loads_.size());
      columns_[wanted[i]].assign(first, first + static_cast<std::ptrdiff_t>(fine_loads_.size()));
    }
  }

  void fill() {
    map_.nodes.clear();
    map_.checks.clear();
    for (const double control : map_.controls) {
      for (size_t j = 0; j < map_.loads.size(); ++j) map_.nodes.push_back({columns_[control][2 * j]});
    }
    std::vector<double> all = map_.controls;
    for (const double value : middles()) all.push_back(value);
    for (size_t i = 0; i < all.size(); ++i) {
      const bool between = i >= map_.controls.size();
      for (size_t j = between ? 0 : 1; j < fine_loads_.size(); j += between ? 1 : 2) {
        const double replayed = columns_[all[i]][j].stiffness, interpolated = map_.at(all[i], fine_loads_[j]);
        if (replayed > 0 && interpolated > 0)
          map_.checks.push_back(
              {all[i], fine_loads_[j], interpolated, replayed, map_.mixed_at(all[i], fine_loads_[j])});
      }
    }
  }

  /// Middles at which the map is off by more than it may, the worst first, as many as there may be more.
  std::vector<double> where_coarse() const {
    std::vector<std::pair<double, double>> off;  // error, middle
    for (const double value : middles()) {
      double largest = 0;
      for (const StiffnessMap::Check& check : map_.checks) {
        if (check.control == value) largest = std::max(largest, check.error());
      }
      if (largest > options_.tolerance) off.emplace_back(largest, value);
    }
    std::ranges::sort(off, std::greater());
    off.resize(std::min(off.size(), options_.most_controls - std::min(options_.most_controls, map_.controls.size())));
    std::vector<double> values;
    for (const auto& [error, value] : off) values.push_back(value);
    return values;
  }

  const StiffnessReplay& replay_;
  const TuneQuestion& question_;
  const MapOptions& options_;
  StiffnessMap map_;
  std::vector<double> fine_loads_;
  std::map<double, std::vector<TunedState>> columns_;  ///< by the control, over fine_loads_
};

}  // namespace

namespace {

/// Calls action(weight, node) for the corners of the cell that holds a place, as far as they count there.
template <class Action>
void each_corner(const StiffnessMap& map, double control, double load, Action&& action) {
  const size_t i = interval_of(map.controls, control), j = interval_of(map.loads, load);
  const double s = (control - map.controls[i]) / (map.controls[i + 1] - map.controls[i]);
  const double t = (load - map.loads[j]) / (map.loads[j + 1] - map.loads[j]);
  for (const size_t a : {0, 1}) {
    for (const size_t b : {0, 1}) {
      const double weight = (a == 1 ? s : 1 - s) * (b == 1 ? t : 1 - t);
      if (weight != 0) action(weight, map.node(i + a, j + b));
    }
  }
}

}  // namespace

double StiffnessMap::at(double control_value, double load_value) const {
  if (!(control_value >= controls.front() && control_value <= controls.back())) return not_a_number;
  if (!(load_value >= loads.front() && load_value <= loads.back())) return not_a_number;
  double sum = 0;
  each_corner(*this, control_value, load_value,
              [&](double weight, const Node& one) { sum += weight * std::log(one.state.stiffness); });
  return std::exp(sum);
}

bool StiffnessMap::mixed_at(double control_value, double load_value) const {
  bool open = false, closed = false;
  each_corner(*this, control_value, load_value,
              [&](double, const Node& one) { (one.state.touching ? closed : open) = true; });
  return open && closed;
}

const StiffnessMap::Check* StiffnessMap::worst(bool mixed) const {
  const Check* found = nullptr;
  for (const Check& check : checks) {
    if (check.mixed == mixed && (found == nullptr || check.error() > found->error())) found = &check;
  }
  return found;
}

double StiffnessMap::rms_error(bool mixed) const {
  double sum = 0, count = 0;
  for (const Check& check : checks) {
    if (check.mixed != mixed) continue;
    sum += check.error() * check.error();
    ++count;
  }
  return count == 0 ? not_a_number : std::sqrt(sum / count);
}

StiffnessMap stiffness_map(const StiffnessReplay& replay, const std::vector<Share>& shares,
                           const TuneQuestion& question, double largest_load, const MapOptions& options,
                           const std::function<void(const std::string&)>& progress) {
  StiffnessMap map = Mapper(replay, question, largest_load, options).made(progress);
  if (progress) progress("the bands of the map");
  const Eigen::MatrixXd slopes = replay.stiffness_slopes(rows_of(question, map.load, map.controls, map.loads));
  for (size_t i = 0; i < map.nodes.size(); ++i)
    map.nodes[i].half = half_widths(replay.fit(), shares, slopes.row(static_cast<Eigen::Index>(i)).transpose());
  return map;
}

}  // namespace taut
