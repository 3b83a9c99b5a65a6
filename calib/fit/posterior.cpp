#include "calib/fit/posterior.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "calib/fit/distributions.hpp"
#include "sim/core/dense.hpp"
#include "sim/core/draws.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

constexpr double solved = 5e-3;      ///< of U^T F, in standard deviations: what is left of it is exact for another xi
constexpr int most_steps = 12;       ///< of Newton's method
constexpr double shortest = 1e-2;    ///< step, as a fraction of Newton's
constexpr double from_bound = 1e-3;  ///< of the range: where the search for the centre begins, of an optimum at a bound

}  // namespace

PosteriorSampler::PosteriorSampler(Protocol& protocol, const std::vector<Measurement>& measurements,
                                   const std::vector<FreeParameter>& free, const FitOptions& options)
    : protocol_(protocol), evaluator_(protocol, measurements, free, options) {
  Eigen::VectorXd u(evaluator_.count()), optimum(evaluator_.count());
  for (Eigen::Index j = 0; j < u.size(); ++j) {
    const Scale& scale = evaluator_.scale(j);
    const double q = optimum[j] = scale.inside(free[static_cast<size_t>(j)].start);
    if (bounded(j)) {
      with_prior_.push_back(j);
      const double place = (q - scale.lower) / (scale.upper - scale.lower);
      u[j] = normal_quantile(std::clamp(place, from_bound, 1 - from_bound));
    } else {
      u[j] = q;
    }
  }
  protocol_.forget();
  // Where a parameter is at its bound the centre cannot be the optimum itself.
  if (evaluator_.evaluate(optimum)) {
    chi_squared_ = evaluator_.chi_squared();
    centre_ = at(u);
  }
  if (!centre_.ok)
    throw InputError("the simulation fails at the fitted parameters: " +
                     (evaluator_.failures.empty() ? std::string("no reason is known") : evaluator_.failures.front()));
  find_centre();
  basis_ = singular_values(centre_.jacobian).U;
  state_ = protocol_.state();
}

bool PosteriorSampler::bounded(Eigen::Index j) const {
  return std::isfinite(evaluator_.scale(j).lower) && std::isfinite(evaluator_.scale(j).upper);
}

Eigen::VectorXd PosteriorSampler::fitted(const Eigen::VectorXd& u) const {
  Eigen::VectorXd q = u;
  for (const Eigen::Index j : with_prior_) {
    const Scale& scale = evaluator_.scale(j);
    q[j] = scale.lower + (scale.upper - scale.lower) * normal_probability(u[j]);
  }
  return q;
}

PosteriorSampler::Point PosteriorSampler::at(const Eigen::VectorXd& u) {
  Point point;
  point.u = u;
  const Eigen::VectorXd q = fitted(u);
  for (Eigen::Index j = 0; j < q.size(); ++j)
    point.outside = point.outside || q[j] < evaluator_.scale(j).lower || q[j] > evaluator_.scale(j).upper;
  if (point.outside) return point;
  point.ok = evaluator_.evaluate(q);
  if (!point.ok) return point;
  const Eigen::VectorXd r = evaluator_.residuals();
  const auto priors = static_cast<Eigen::Index>(with_prior_.size());
  point.F.resize(r.size() + priors);
  point.F.head(r.size()) = r;
  point.jacobian = Eigen::MatrixXd::Zero(point.F.size(), u.size());
  point.jacobian.topRows(r.size()) = evaluator_.jacobian();
  for (Eigen::Index i = 0; i < priors; ++i) {
    const Eigen::Index j = with_prior_[static_cast<size_t>(i)];
    const Scale& scale = evaluator_.scale(j);
    point.jacobian.col(j) *= (scale.upper - scale.lower) * normal_density(u[j]);
    point.F[r.size() + i] = u[j];
    point.jacobian(r.size() + i, j) = 1;
  }
  return point;
}

/// Gauss-Newton to the least |F|, which the flat prior moves from the fit's optimum by next to nothing where the
/// readings say something. Where it stops makes no draw wrong: the weights hold for any centre.
void PosteriorSampler::find_centre() {
  for (int step = 0; step < most_steps; ++step) {
    const Eigen::VectorXd newton = -minimum_norm_solution(centre_.jacobian, centre_.F);
    const double promised = (centre_.jacobian * newton).squaredNorm();
    if (promised < 1e-4) return;
    double length = std::min(1.0, 1 / newton.cwiseAbs().maxCoeff());
    Point next;
    do {
      next = at(centre_.u + length * newton);
      length /= 2;
    } while ((!next.ok || next.F.squaredNorm() > centre_.F.squaredNorm()) && length > shortest);
    if (!next.ok || next.F.squaredNorm() >= centre_.F.squaredNorm()) return;
    centre_ = std::move(next);
  }
}

PosteriorDraw PosteriorSampler::draw(unsigned number, unsigned seed) {
  PosteriorDraw result;
  Draws random(seed * 1'000'003U + number);
  Eigen::VectorXd xi(evaluator_.count());
  for (double& one : xi) one = random.normal();
  const Eigen::VectorXd target = basis_.transpose() * centre_.F + xi;
  const int before = evaluator_.evaluations;
  protocol_.restore(state_);  // a draw does not depend on those before it
  evaluator_.reset();
  const auto left = [&](const Point& point) -> Eigen::VectorXd { return basis_.transpose() * point.F - target; };

  Point here = centre_;
  bool left_the_bounds = false;
  for (int step = 0; step < most_steps && left(here).cwiseAbs().maxCoeff() > solved; ++step) {
    if (evaluator_.stopped()) break;
    const Eigen::VectorXd newton = -least_squares(basis_.transpose() * here.jacobian, left(here));
    // Between bounds a step of two standard deviations of the prior is as far as a linear model may be believed.
    double length = 1;
    for (const Eigen::Index j : with_prior_) length = std::min(length, 2 / std::max(2.0, std::abs(newton[j])));
    Point next;
    bool nearer = false;
    for (; !nearer && length > shortest; length /= 2) {
      next = at(here.u + length * newton);
      left_the_bounds = next.outside;
      nearer = next.ok && left(next).norm() < (1 - 1e-4 * length) * left(here).norm();
    }
    if (!nearer) break;
    here = std::move(next);
  }
  result.evaluations = evaluator_.evaluations - before;
  if (evaluator_.stopped()) {
    result.failure = "interrupted";
  } else if (left(here).cwiseAbs().maxCoeff() > solved) {
    result.outside = left_the_bounds;
    result.failure = left_the_bounds ? "it would lie beyond a bound" : "no parameters were found for it";
  } else {
    evaluator_.evaluate(fitted(here.u));  // the newest prediction is that of the last trial
    result.evaluations = evaluator_.evaluations - before;
    result.values = evaluator_.values(fitted(here.u));
    result.predicted.assign(evaluator_.prediction().values.begin(), evaluator_.prediction().values.end());
    const Eigen::VectorXd s = singular_values(basis_.transpose() * here.jacobian).s;
    const Eigen::VectorXd drawn = basis_.transpose() * (here.F - centre_.F);
    result.log_weight = 0.5 * (drawn.squaredNorm() - here.F.squaredNorm()) - s.array().log().sum();
  }
  return result;
}

double WeightedValues::mean() const {
  return std::inner_product(values.begin(), values.end(), weights.begin(), 0.0) /
         std::accumulate(weights.begin(), weights.end(), 0.0);
}

double WeightedValues::deviation() const {
  const double centre = mean();
  double sum = 0;
  for (size_t i = 0; i < values.size(); ++i) sum += weights[i] * (values[i] - centre) * (values[i] - centre);
  return std::sqrt(sum / std::accumulate(weights.begin(), weights.end(), 0.0));
}

double WeightedValues::quantile(double p) const {
  std::vector<size_t> order(values.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::ranges::sort(order, {}, [&](size_t i) { return values[i]; });
  const double all = std::accumulate(weights.begin(), weights.end(), 0.0);
  double below = 0, place = 0, value = values[order.front()];
  for (size_t i : order) {
    const double middle = (below + weights[i] / 2) / all;
    if (middle >= p && weights[i] > 0) {
      const double part = middle > place ? (p - place) / (middle - place) : 1;
      return below > 0 ? value + std::clamp(part, 0.0, 1.0) * (values[i] - value) : values[i];
    }
    below += weights[i];
    if (weights[i] > 0) {
      place = middle;
      value = values[i];
    }
  }
  return value;
}

std::vector<double> weights_of(const std::vector<double>& log_weights) {
  std::vector<double> weights = log_weights;
  if (weights.empty()) return weights;
  const double largest = std::ranges::max(log_weights);
  for (double& weight : weights) weight = std::exp(weight - largest);
  return weights;
}

double effective_number(const std::vector<double>& weights) {
  double sum = 0, squares = 0;
  for (double weight : weights) {
    sum += weight;
    squares += weight * weight;
  }
  return squares > 0 ? sum * sum / squares : 0;
}

}  // namespace taut
