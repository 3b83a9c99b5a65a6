#include "sim/robots/workspace.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>

#include "sim/robots/reach.hpp"
#include "sim/robots/sensitivities.hpp"
#include "sim/robots/simulate.hpp"

namespace taut {
namespace {

/// 1 / sqrt of the k-th prime: a curve of such periods never closes.
double period(size_t k) {
  std::vector<int> primes;
  for (int n = 2; primes.size() <= k; ++n) {
    if (std::ranges::none_of(primes, [n](int prime) { return n % prime == 0; })) primes.push_back(n);
  }
  return 1 / std::sqrt(primes.back());
}

/// How controls change places, or go the other way, in a mirror.
struct Mirror {
  int coordinate = 0;           ///< that changes its sign
  Eigen::Vector2d middle;       ///< a place on the line [m]
  std::vector<size_t> partner;  ///< per axis
  std::vector<bool> is_reversed;

  Eigen::Vector2d of(Eigen::Vector2d place) const {
    place[coordinate] = 2 * middle[coordinate] - place[coordinate];
    return place;
  }
};

/// One mode, by fractions of the ranges of its controls.
class Sampler {
 public:
  Sampler(const Simulation& simulation, const Robot& robot, const WorkspaceMode& mode, const std::atomic<bool>* stop)
      : x_(robot.reading(simulation.workspace->x)),
        y_(robot.reading(simulation.workspace->y)),
        equilibrium_(equilibrium_at_rest(simulation, robot, *robot.scene.model, stop)),
        start_(robot.at(simulation, 0)),
        tolerance_(1e-3 * robot.scene.model->mesh().diagonal()),
        stop_(stop) {
    for (size_t k = 0; k < simulation.controls.size(); ++k) {
      const auto range = mode.ranges.find(simulation.controls[k].id);
      if (range == mode.ranges.end()) continue;
      indices_.push_back(robot.controls[k]);
      ranges_.push_back(range->second);
    }
    result.mode = mode.name;
    equilibrium_.solve(start_);
  }

  void run(int samples) {
    const size_t axes = indices_.size();
    // All at one end, all at the other; the reach of a robot is often there.
    for (double end : {1.0, 0.0}) visit(std::vector<double>(axes, end));
    const double fastest = axes == 0 ? 1 : period(axes - 1);
    for (int i = 1; i <= samples; ++i) {
      std::vector<double> fractions;
      for (size_t k = 0; k < axes; ++k) {
        const double turns = i * fastest / (24 * period(k)), wave = turns - std::floor(turns);
        fractions.push_back(std::clamp(1.5 * (wave < 0.5 ? 2 * wave : 2 - 2 * wave) - 0.25, 0.0, 1.0));
      }
      visit(fractions);
    }
    result.samples = static_cast<int>(result.points.size());
    const std::optional<Mirror> mirror = find_mirror();
    if (!mirror) return;
    result.mirrored = mirror->coordinate;
    for (int i = 0; i < result.samples; ++i) result.points.push_back(mirror->of(result.points[static_cast<size_t>(i)]));
  }

  WorkspaceResult result;

 private:
  bool stopped() const { return stop_ != nullptr && stop_->load(); }

  /// The place at the equilibrium there; none: there is no equilibrium, and the state stays where it was.
  std::optional<Eigen::Vector2d> place_at(const std::vector<double>& fractions) {
    Params p = start_;
    for (size_t k = 0; k < fractions.size(); ++k)
      p[indices_[k]] = std::lerp(ranges_[k].first, ranges_[k].second, fractions[k]);
    if (equilibrium_.solve(p).status != SolveStatus::converged) return std::nullopt;
    const Point at{equilibrium_.u(), equilibrium_.p()};
    return Eigen::Vector2d(x_.rest + x_.channel->value(at), y_.rest + y_.channel->value(at));
  }

  void visit(const std::vector<double>& fractions) {
    if (stopped()) return;
    const auto place = place_at(fractions);
    if (!place) {
      ++result.failures;
      return;
    }
    result.slips += equilibrium_.report().slipped;
    result.points.push_back(*place);
  }

  /// A mirror image that two equilibria confirm.
  std::optional<Mirror> find_mirror() {
    const std::vector<double> centre(indices_.size(), 0.5);
    const auto middle = place_at(centre);
    if (stopped() || !middle || !equilibrium_.refactorise()) return std::nullopt;
    const Eigen::MatrixXd du = equilibrium_.sensitivities(indices_);
    Eigen::Matrix2Xd slopes(2, du.cols());  // by fractions
    for (const auto& [row, reading] : {std::pair(0, &x_), std::pair(1, &y_)})
      slopes.row(row) = channel_derivatives(*reading->channel, {equilibrium_.u(), equilibrium_.p()}, du, indices_);
    for (size_t k = 0; k < ranges_.size(); ++k)
      slopes.col(static_cast<Eigen::Index>(k)) *= ranges_[k].second - ranges_[k].first;
    for (const int coordinate : {1, 0}) {
      const std::optional<Mirror> mirror = pair_up(coordinate, *middle, slopes);
      if (mirror && holds(*mirror)) return mirror;
    }
    return std::nullopt;
  }

  /// Controls whose effects are each other's mirror images.
  std::optional<Mirror> pair_up(int coordinate, const Eigen::Vector2d& middle, const Eigen::Matrix2Xd& slopes) const {
    Mirror mirror{coordinate, middle, {}, {}};
    const double alike = 1e-2 * slopes.colwise().norm().maxCoeff();
    for (size_t k = 0; k < ranges_.size(); ++k) {
      Eigen::Vector2d image = slopes.col(static_cast<Eigen::Index>(k));
      image[coordinate] *= -1;
      double nearest = alike;
      std::optional<size_t> partner;
      bool is_reversed = false;
      for (size_t j = 0; j < ranges_.size(); ++j) {
        for (const double sign : {1.0, -1.0}) {
          const bool fits =
              sign > 0 ? ranges_[j] == ranges_[k] : ranges_[j] == std::pair(-ranges_[k].second, -ranges_[k].first);
          const double miss = (sign * slopes.col(static_cast<Eigen::Index>(j)) - image).norm();
          const bool is_taken = std::ranges::find(mirror.partner, j) != mirror.partner.end();
          if (!fits || is_taken || miss > nearest) continue;
          nearest = miss;
          partner = j;
          is_reversed = sign < 0;
        }
      }
      if (!partner) return std::nullopt;
      mirror.partner.push_back(*partner);
      mirror.is_reversed.push_back(is_reversed);
    }
    return mirror;
  }

  bool holds(const Mirror& mirror) {
    for (const double seed : {std::numbers::sqrt2, std::numbers::e}) {
      std::vector<double> here, there(indices_.size());
      for (size_t k = 0; k < indices_.size(); ++k) {
        const double turns = seed * static_cast<double>(k + 1);
        here.push_back(0.2 + 0.6 * (turns - std::floor(turns)));
      }
      for (size_t k = 0; k < indices_.size(); ++k)
        there[mirror.partner[k]] = mirror.is_reversed[k] ? 1 - here[k] : here[k];
      const auto one = place_at(here), other = place_at(there);
      if (stopped() || !one || !other || (mirror.of(*one) - *other).norm() > tolerance_) return false;
    }
    return true;
  }

  const SceneReading &x_, &y_;
  Equilibrium equilibrium_;
  const Params start_;
  const double tolerance_;
  const std::atomic<bool>* stop_;
  std::vector<int> indices_;  ///< of the mode's controls, in the table
  std::vector<std::pair<double, double>> ranges_;
};

/// Whether all that the controls do in `inner` they can do in `outer`.
bool holds(const Simulation& simulation, const Params& start, const Robot& robot, const WorkspaceMode& outer,
           const WorkspaceMode& inner) {
  for (size_t k = 0; k < simulation.controls.size(); ++k) {
    const auto range_of = [&](const WorkspaceMode& mode) {
      const auto range = mode.ranges.find(simulation.controls[k].id);
      const double still = start[robot.controls[k]];
      const auto [one, other] = range == mode.ranges.end() ? std::pair(still, still) : range->second;
      return std::pair(std::min(one, other), std::max(one, other));
    };
    const std::pair<double, double> mine = range_of(outer), theirs = range_of(inner);
    if (theirs.first < mine.first || theirs.second > mine.second) return false;
  }
  return true;
}

void cover(double radius, WorkspaceResult& result) {
  const Reach reach = reach_of(result.points, radius);
  result.outline = reach.outline;
  result.area = reach.area;
  const auto differs = [&](double area) {
    result.area_error = std::max(result.area_error, std::abs(area - reach.area));
  };
  differs(reach_of(result.points, radius / std::numbers::sqrt2).area);
  for (const size_t first : {0u, 1u}) {
    std::vector<Eigen::Vector2d> half;
    for (size_t i = first; i < result.points.size(); i += 2) half.push_back(result.points[i]);
    differs(reach_of(half, radius).area);
  }
}

}  // namespace

std::vector<WorkspaceResult> sample_workspaces(const Simulation& simulation, const Robot& robot,
                                               const std::function<void(const std::string& mode)>& tell,
                                               const std::atomic<bool>* stop) {
  std::vector<WorkspaceResult> results;
  const std::vector<WorkspaceMode>& modes = simulation.workspace->modes;
  for (const WorkspaceMode& mode : modes) {
    if (stop != nullptr && stop->load()) return results;
    if (tell) tell(mode.name);
    Sampler sampler(simulation, robot, mode, stop);
    sampler.run(simulation.workspace->samples);
    results.push_back(std::move(sampler.result));
  }
  std::vector<std::vector<Eigen::Vector2d>> own;
  for (const WorkspaceResult& result : results) own.push_back(result.points);
  const Params start = robot.at(simulation, 0);
  for (size_t k = 0; k < results.size(); ++k) {
    for (size_t j = 0; j < results.size(); ++j) {
      if (j == k || !holds(simulation, start, robot, modes[k], modes[j])) continue;
      results[k].holds.push_back(modes[j].name);
      results[k].points.insert(results[k].points.end(), own[j].begin(), own[j].end());
    }
    cover(robot.scene.model->mesh().diagonal() / 6, results[k]);
  }
  return results;
}

}  // namespace taut
