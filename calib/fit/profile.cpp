#include "calib/fit/profile.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace taut {

ProfileEnd::ProfileEnd(Evaluator& evaluator, const Surroundings& around, Eigen::Index j, int sign,
                       const FitOptions& options, std::vector<std::pair<double, double>>& visited)
    : evaluator_(evaluator),
      around_(around),
      best_(around.best),
      slopes_(around.covariance.col(j)),
      j_(j),
      sign_(sign),
      options_(options),
      visited_(visited),
      inner_{best_.q[j], 0, best_.q},
      outer_(inner_),
      start_(best_.q) {
  // Of the rise: half a per cent.
  options_.tolerance = std::min(1e-3, 0.005 * profile_rise / std::max(best_.chi_squared, 1e-12));
}

std::optional<double> ProfileEnd::find(double guess, bool alone) {
  if (!enclose(std::max(guess, 1e-6))) return std::nullopt;
  narrow();
  if (!std::isfinite(outer_.rise) || (alone && another_is_at_its_bound())) return std::nullopt;
  return 0.5 * (inner_.q + outer_.q);
}

std::optional<double> ProfileEnd::go_on(double end, const Eigen::VectorXd& all) {
  start_ = all;
  start_[j_] = end;
  inner_.all = start_;
  inner_ = place_at(end);
  if (!(inner_.rise < profile_rise) || nearly(inner_)) return end;
  const std::optional<double> farther = find(0.1 * std::abs(end - best_.q[j_]), false);
  if (evaluator_.halted()) return end;
  drop_what_is_no_minimum();
  return farther;
}

/// Points of the higher valley: farther out chi squared is lower.
void ProfileEnd::drop_what_is_no_minimum() {
  const auto outside = [&](double value) { return sign_ * (evaluator_.scale(j_).inside(value) - best_.q[j_]); };
  const std::vector<std::pair<double, double>> all = visited_;
  std::erase_if(visited_, [&](const auto& point) {
    return outside(point.first) > 0 && std::ranges::any_of(all, [&](const auto& other) {
             return outside(other.first) >= outside(point.first) && other.second < point.second;
           });
  });
}

ProfileEnd::Place ProfileEnd::place_at(double q) {
  // A rise by so much more than what is looked for is perhaps none: where the others move much faster than this one,
  // the tangent leads them astray, and the search from there may not come back.
  constexpr double astray = 25 * profile_rise;
  const double moved = q - start_[j_];
  Eigen::VectorXd plain = inner_.all;  // what lies outside of the valley may have no way back
  plain[j_] = q;
  for (Eigen::Index i = 0; i < start_.size(); ++i)
    start_[i] = evaluator_.scale(i).clamped(start_[i] + moved * slopes_[i] / slopes_[j_]);
  start_[j_] = q;
  double rise = std::numeric_limits<double>::infinity();
  if (start_.size() == 1) {
    if (evaluator_.evaluate(start_)) rise = evaluator_.chi_squared() - best_.chi_squared;
  } else {
    Minimum there = minimise(evaluator_, start_, j_, undamped, options_);
    if (there.failed || there.chi_squared > best_.chi_squared + astray) {
      const Minimum other = minimise(evaluator_, plain, j_, undamped, options_);
      if (!other.failed && (there.failed || other.chi_squared < there.chi_squared)) there = other;
    }
    if (!there.failed) {
      start_ = there.q;
      rise = there.chi_squared - best_.chi_squared;
    }
  }
  if (std::isfinite(rise)) visited_.emplace_back(evaluator_.scale(j_).outside(q), rise);
  if (best_.chi_squared + rise < around_.lowest.chi_squared) {
    around_.lowest.q = start_;
    around_.lowest.chi_squared = best_.chi_squared + rise;
  }
  if (std::isfinite(rise) && evaluator_.prediction().complete())  // of the last point that was tried, there or near it
    around_.met.push_back({evaluator_.point(), evaluator_.residuals(), evaluator_.jacobian(), j_});
  return {q, rise, start_};
}

/// So near the end, the rest of the way is a fraction of the way so far, if the rise is a parabola as expected.
bool ProfileEnd::nearly(const Place& place) const {
  const double parabola = z95 * std::sqrt(slopes_[j_]);
  const bool expected = std::abs(std::abs(place.q - best_.q[j_]) / parabola - 1) < 0.3;
  return std::abs(place.rise / profile_rise - 1) < (expected ? 0.05 : 0.01);
}

/// Goes outwards by ever longer steps until the end is between the two places, or both are at it.
bool ProfileEnd::enclose(double step) {
  const Scale& scale = evaluator_.scale(j_);
  int level = 0;  // steps that have changed nothing
  for (int expansion = 0; expansion < 12; ++expansion, step *= 2) {
    if (evaluator_.halted() || around_.lowest.chi_squared < best_.chi_squared - lower_minimum) return false;
    const double q = inner_.q + sign_ * step;
    const bool at_bound = sign_ > 0 ? q >= scale.upper : q <= scale.lower;
    outer_ = place_at(at_bound ? (sign_ > 0 ? scale.upper : scale.lower) : q);
    if (outer_.rise >= profile_rise || nearly(outer_)) break;
    // Where chi squared has risen and longer and longer steps change nothing any more, the rest of the way does not
    // either. Flat from the beginning says nothing: the end of a plateau may still come.
    const bool same = inner_.rise > 0.02 * profile_rise && std::abs(outer_.rise - inner_.rise) < 0.01 * profile_rise;
    level = same ? level + 1 : 0;
    if (at_bound || level == 2) return false;
    inner_ = outer_;
  }
  if (!nearly(outer_)) return !(outer_.rise < profile_rise);
  inner_.q = outer_.q = best_.q[j_] + (outer_.q - best_.q[j_]) * std::sqrt(profile_rise / outer_.rise);
  return true;
}

void ProfileEnd::narrow() {
  const double target = std::sqrt(profile_rise);
  for (int i = 0; i < 12; ++i) {
    const double apart = std::abs(outer_.q - inner_.q), way = std::abs(outer_.q - best_.q[j_]);
    if (!(apart > 1e-3 * std::max(way, 1e-12)) || evaluator_.halted()) return;
    // The rise is nearly quadratic, so its root is nearly linear; bisect when that is of no use.
    const double a = std::sqrt(std::max(inner_.rise, 0.0)), b = std::sqrt(outer_.rise);
    double t = std::isfinite(b) && b > a ? (target - a) / (b - a) : 0.5;
    t = i % 3 == 2 ? 0.5 : std::clamp(t, 0.05, 0.95);
    const Place middle = place_at(inner_.q + t * (outer_.q - inner_.q));
    if (nearly(middle)) {
      inner_.q = outer_.q = middle.q;
      outer_.all = middle.all;
      return;
    }
    (middle.rise >= profile_rise ? outer_ : inner_) = middle;
  }
}

bool ProfileEnd::another_is_at_its_bound() const {
  for (Eigen::Index i = 0; i < start_.size(); ++i) {
    const Scale& scale = evaluator_.scale(i);
    if (i != j_ && scale.room(outer_.all[i]) < 1e-6 * scale.range(outer_.all[i])) return true;
  }
  return false;
}

}  // namespace taut
