#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "calib/fit/distributions.hpp"
#include "calib/studies/planning.hpp"
#include "sim/core/dense.hpp"
#include "sim/core/numbers.hpp"

namespace taut {
namespace {

using Information = std::vector<Eigen::MatrixXd>;  ///< one per draw
using Rows = std::vector<size_t>;                  ///< positions in PlanTask::rows, repeats allowed

void add_row(const PlanTask& task, size_t row, Information& information) {
  const PlanRow& one = task.rows[row];
  for (size_t d = 0; d < information.size(); ++d) information[d] += (1 - one.fails) * one.information[d];
}

Information after(const PlanTask& task, const Rows& chosen) {
  Information information = task.known;
  for (const size_t row : chosen) add_row(task, row, information);
  return information;
}

PlanWidths widths_of(const PlanTask& task, const Information& information) {
  double variance = 0;
  for (size_t d = 0; d < information.size(); ++d) {
    const Eigen::VectorXd& g = task.goal.gradients[d];
    const auto solved = solve_positive_definite(information[d], g);
    const double one = solved ? g.dot(solved->col(0)) : infinity;
    variance += (std::isfinite(one) ? one : infinity) / static_cast<double>(information.size());
  }
  PlanWidths widths;
  widths.noise = z95 * std::sqrt(std::max(0.0, variance));
  widths.total = std::hypot(widths.noise, task.goal.floor);
  return widths;
}

double minutes_at(const PlanTask& task, size_t setups, size_t rows) {
  return static_cast<double>(setups) * task.costs.setup +
         static_cast<double>(rows) * (task.costs.rest + task.costs.reading);
}

/// Sets of rows compared: what is larger is better.
struct Worth {
  double score = -infinity, minutes = 0;
};

class PlanSearch {
 public:
  explicit PlanSearch(const PlanTask& task) : task_(task), before_(widths_after(task, {}).total) {}

  Rows go(bool& exhaustive) {
    if (task_.rows.empty() || largest() == 0) return {};
    exhaustive = combinations_within(task_.exhaustive_up_to);
    if (exhaustive) {
      Rows chosen;
      try_all(0, chosen, task_.known);
    } else {
      search();
    }
    return best_;
  }

 private:
  /// Rows that a choice may have.
  size_t largest() const {
    size_t most = task_.count ? static_cast<size_t>(std::max(0, *task_.count)) : infinity_of_rows;
    if (task_.minutes) {
      const double each = task_.costs.rest + task_.costs.reading, left = *task_.minutes - task_.costs.setup;
      if (left < each - 1e-9) return 0;
      if (each > 0) most = std::min(most, static_cast<size_t>(std::floor(left / each + 1e-9)));
    }
    return std::min(most, infinity_of_rows);
  }

  /// Whether the multisets of up to `largest` rows are at most `limit`.
  bool combinations_within(size_t limit) const {
    double all = 0, ways = 1;
    const auto n = static_cast<double>(task_.rows.size());
    for (size_t k = 1; k <= largest(); ++k) {
      ways *= (n + static_cast<double>(k) - 1) / static_cast<double>(k);
      all += ways;
      if (all > static_cast<double>(limit)) return false;
    }
    return true;
  }

  double minutes(const Rows& chosen) const { return minutes_of(task_, chosen); }
  bool affordable(const Rows& chosen) const {
    return chosen.size() <= largest() && (!task_.minutes || minutes(chosen) <= *task_.minutes * (1 + 1e-9));
  }

  Worth worth_of(const Rows& chosen, const Information& information) const {
    Worth worth;
    worth.minutes = minutes(chosen);
    const double total = widths_of(task_, information).total;
    if (task_.minutes || !std::isfinite(before_) || worth.minutes <= 0)
      worth.score = -total;
    else
      worth.score = (before_ - total) / worth.minutes;
    return worth;
  }

  /// Beyond rounding; of equals what takes less time.
  static bool better(const Worth& a, const Worth& b) {
    if (!std::isfinite(a.score) || !std::isfinite(b.score))
      return a.score > b.score || (a.score == b.score && a.minutes < b.minutes - 1e-9);
    const double rounding = 1e-12 * std::max(std::abs(a.score), std::abs(b.score));
    if (std::abs(a.score - b.score) > rounding) return a.score > b.score;
    return a.minutes < b.minutes - 1e-9;
  }

  void offer(const Rows& chosen, const Worth& worth) {
    if (!best_.empty() && !better(worth, best_worth_)) return;
    best_ = chosen;
    best_worth_ = worth;
  }

  /// All multisets that begin with `chosen` and go on with rows from `first` on.
  void try_all(size_t first, Rows& chosen, const Information& information) {
    for (size_t row = first; row < task_.rows.size(); ++row) {
      chosen.push_back(row);
      if (affordable(chosen)) {
        Information more = information;
        add_row(task_, row, more);
        if (task_.minutes || chosen.size() == largest()) offer(chosen, worth_of(chosen, more));
        if (chosen.size() < largest()) try_all(row, chosen, more);
      }
      chosen.pop_back();
    }
  }

  /// Adds rows by narrowing per further minute, until there is no room.
  void fill(Rows& chosen) const {
    while (chosen.size() < largest()) {
      const Information information = after(task_, chosen);
      const double here = widths_of(task_, information).total, spent = minutes(chosen);
      std::optional<size_t> next;
      Worth best;
      for (size_t row = 0; row < task_.rows.size(); ++row) {
        Rows with = chosen;
        with.push_back(row);
        if (!affordable(with)) continue;
        Information more = information;
        add_row(task_, row, more);
        const double total = widths_of(task_, more).total, takes = minutes(with) - spent;
        const bool rates = std::isfinite(here) && takes > 0;
        const Worth worth{rates ? (here - total) / takes : -total, takes};
        if (next && !better(worth, best)) continue;
        next = row;
        best = worth;
      }
      if (!next) return;
      chosen.push_back(*next);
    }
  }

  /// Puts other rows in the places of those at `places`, where that is better. Whether it was.
  bool exchange(Rows& chosen, Worth& worth, const std::vector<size_t>& places) const {
    Rows rest;
    for (size_t i = 0; i < chosen.size(); ++i) {
      if (std::ranges::count(places, i) == 0) rest.push_back(chosen[i]);
    }
    const Information base = after(task_, rest);
    bool found = false;
    const Rows kept = rest;
    const auto look = [&](const Rows& with, const Information& information) {
      if (!affordable(with)) return;
      const Worth there = worth_of(with, information);
      if (!better(there, worth)) return;
      chosen = with;
      worth = there;
      found = true;
    };
    for (size_t one = 0; one < task_.rows.size(); ++one) {
      Information information = base;
      add_row(task_, one, information);
      Rows with = kept;
      with.push_back(one);
      if (places.size() == 1) {
        look(with, information);
        continue;
      }
      for (size_t other = one; other < task_.rows.size(); ++other) {
        Information both = information;
        add_row(task_, other, both);
        with.push_back(other);
        look(with, both);
        with.pop_back();
      }
    }
    if (task_.minutes) {  // what was taken out may make room for other numbers of rows
      fill(rest);
      look(rest, after(task_, rest));
    }
    return found;
  }

  void improve(Rows& chosen, Worth& worth, bool pairs) const {
    for (bool changed = true; changed;) {
      changed = false;
      for (size_t i = 0; i < chosen.size(); ++i) changed |= exchange(chosen, worth, {i});
      for (size_t i = 0; pairs && !changed && i < chosen.size(); ++i) {
        for (size_t j = i + 1; !changed && j < chosen.size(); ++j) changed |= exchange(chosen, worth, {i, j});
      }
    }
  }

  void search() {
    const size_t n = task_.rows.size(), k = std::min(largest(), infinity_of_rows);
    // From many first rows while that is cheap; else from none.
    std::vector<Rows> starts{{}};
    for (size_t row = 0; row < n && n * n * k <= 50'000; ++row) {
      if (affordable({row})) starts.push_back({row});
    }
    const double pairs = static_cast<double>(k * k) * static_cast<double>(n * n) / 4;
    for (Rows& start : starts) {
      fill(start);
      if (start.empty()) continue;
      Worth worth = worth_of(start, after(task_, start));
      improve(start, worth, pairs <= 2'000);
      offer(start, worth);
    }
    if (best_.empty() || pairs <= 2'000 || pairs > 200'000) return;
    Rows chosen = best_;
    Worth worth = best_worth_;
    improve(chosen, worth, true);
    offer(chosen, worth);
  }

  static constexpr size_t infinity_of_rows = 200;  ///< more nobody measures in one plan
  const PlanTask& task_;
  double before_;
  Rows best_;
  Worth best_worth_;
};

/// Set-ups one after the other, the one that narrows most per minute first; within one as the task lists the rows.
Rows in_order(const PlanTask& task, const Rows& chosen) {
  std::map<int, Rows> setups;
  for (const size_t row : chosen) setups[task.rows[row].setup].push_back(row);
  Rows ordered;
  while (!setups.empty()) {
    double most = -infinity;
    int next = setups.begin()->first;
    const double here = widths_after(task, ordered).total;
    for (const auto& [setup, rows] : setups) {
      Rows with = ordered;
      with.insert(with.end(), rows.begin(), rows.end());
      const double total = widths_after(task, with).total;
      const double rate =
          std::isfinite(here) ? (here - total) / std::max(1e-9, minutes_at(task, 1, rows.size())) : -total;
      if (rate > most) {
        most = rate;
        next = setup;
      }
    }
    Rows rows = setups.extract(next).mapped();
    std::ranges::sort(rows);
    ordered.insert(ordered.end(), rows.begin(), rows.end());
  }
  return ordered;
}

}  // namespace

PlanWidths widths_after(const PlanTask& task, const std::vector<size_t>& chosen) {
  return widths_of(task, after(task, chosen));
}

double minutes_of(const PlanTask& task, const std::vector<size_t>& chosen) {
  std::set<int> setups;
  for (const size_t row : chosen) setups.insert(task.rows[row].setup);
  return minutes_at(task, setups.size(), chosen.size());
}

PlanChoice choose_rows(const PlanTask& task) {
  PlanChoice choice;
  choice.rows = in_order(task, PlanSearch(task).go(choice.exhaustive));
  return choice;
}

std::vector<size_t> cheapest_rows(const PlanTask& task, double minutes) {
  Rows one;
  for (size_t row = 0; row < task.rows.size(); ++row) {
    if (task.rows[row].setup == task.rows.front().setup) one.push_back(row);
  }
  Rows cheapest;
  while (!one.empty() && cheapest.size() < 1000 && minutes_at(task, 1, cheapest.size() + 1) <= minutes * (1 + 1e-9))
    cheapest.push_back(one[cheapest.size() % one.size()]);
  return cheapest;
}

double narrowing(const PlanTask& task, const std::vector<size_t>& chosen) {
  const double before = widths_after(task, {}).total, now = widths_after(task, chosen).total;
  if (!std::isfinite(before)) return std::isfinite(now) ? 1 : 0;
  return before > 0 ? 1 - now / before : 0;
}

}  // namespace taut
