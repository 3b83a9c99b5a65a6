#include "calib/models/hinge_chain.hpp"

#include <algorithm>
#include <boost/math/tools/minima.hpp>
#include <cmath>

#include "sim/core/dense.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"

namespace taut {
namespace {

Eigen::Vector2d turned(const Eigen::Vector2d& v, double angle) {
  return {std::cos(angle) * v.x() - std::sin(angle) * v.y(), std::sin(angle) * v.x() + std::cos(angle) * v.y()};
}
Eigen::Vector2d quarter_turned(const Eigen::Vector2d& v) {
  return {-v.y(), v.x()};
}

/// Calls action(i, v) for the vector of each segment i, from 0, on the way to a point.
template <class Action>
void each_vector(const HingeChain& chain, const HingeChain::Place& place, Action&& action) {
  for (int i = 0; i < place.segment; ++i) {
    const Eigen::Vector2d& from = chain.hinges[static_cast<size_t>(i)];
    action(i, i + 1 < place.segment ? Eigen::Vector2d(chain.hinges[static_cast<size_t>(i) + 1] - from)
                                    : Eigen::Vector2d(place.at - from));
  }
}

/// The potential of a chain with its derivatives by the turns.
struct ChainPotential {
  double energy = 0;
  Eigen::VectorXd gradient;
  Eigen::MatrixXd hessian;

  ChainPotential(const HingeChain& chain, double k, const std::vector<HingeChain::Force>& forces,
                 const Eigen::VectorXd& turns)
      : gradient(Eigen::VectorXd::Zero(chain.size())), hessian(Eigen::MatrixXd::Zero(chain.size(), chain.size())) {
    for (int i = 0; i < chain.size(); ++i) {
      const double bend = turns[i] - (i == 0 ? 0 : turns[i - 1]);
      energy += 0.5 * k * bend * bend;
      gradient[i] += k * bend;
      hessian(i, i) += k;
      if (i == 0) continue;
      gradient[i - 1] -= k * bend;
      hessian(i - 1, i - 1) += k;
      hessian(i, i - 1) -= k;
      hessian(i - 1, i) -= k;
    }
    for (const HingeChain::Force& force : forces) {
      each_vector(chain, force.on, [&](int i, const Eigen::Vector2d& v) {
        const Eigen::Vector2d there = turned(v, turns[i]);
        // Of the change from rest: its digits count.
        energy -= force.newtons.dot(there - v);
        gradient[i] -= force.newtons.dot(quarter_turned(there));
        hessian(i, i) += force.newtons.dot(there);
      });
    }
  }
};

/// Newton's step; where the Hessian is not positive definite, that of one which is made so.
Eigen::VectorXd newton_step(const ChainPotential& at, double k) {
  Eigen::MatrixXd hessian = at.hessian;
  for (double shift = 0;; shift = std::max(2 * shift, 1e-3 * k)) {
    hessian.diagonal() = at.hessian.diagonal().array() + shift;
    if (const auto way = solve_positive_definite(hessian, -at.gradient)) return *way;
  }
}

}  // namespace

Eigen::Vector2d HingeChain::where(const Place& place, const Eigen::VectorXd& turns) const {
  if (place.segment == 0) return place.at;
  Eigen::Vector2d there = hinges.front();
  each_vector(*this, place, [&](int i, const Eigen::Vector2d& v) { there += turned(v, turns[i]); });
  return there;
}

Eigen::VectorXd hinge_chain_equilibrium(const HingeChain& chain, double k, const std::vector<HingeChain::Force>& forces,
                                        const Eigen::VectorXd& start) {
  Eigen::VectorXd turns = start.size() == chain.size() ? start : Eigen::VectorXd::Zero(chain.size());
  for (int step = 0; step < 200; ++step) {
    const ChainPotential here(chain, k, forces, turns);
    const Eigen::VectorXd way = newton_step(here, k);
    const double longest = way.cwiseAbs().maxCoeff();
    if (longest < 1e-13) return turns + way;
    double part = std::min(1.0, 0.5 / longest);
    for (int halved = 0; halved < 40; ++halved, part /= 2) {
      // Near the end energies differ by rounding only.
      const double allowed = here.energy + 1e-4 * part * here.gradient.dot(way) + 1e-14 * std::abs(here.energy);
      if (longest < 1e-6 || ChainPotential(chain, k, forces, turns + part * way).energy <= allowed) break;
    }
    turns += part * way;
    if (!turns.allFinite()) break;
  }
  return Eigen::VectorXd::Constant(chain.size(), not_a_number);
}

std::vector<double> hinge_chain_curve(const HingeChain& chain, double k, const HingeCurve& curve) {
  std::vector<HingeChain::Force> forces = curve.always;
  Eigen::VectorXd turns = hinge_chain_equilibrium(chain, k, forces);
  const Eigen::Vector2d before = chain.where(curve.watched, turns);
  forces.push_back({curve.load, {0, 0}});
  std::vector<double> displacements;
  for (const double force : curve.forces) {
    forces.back().newtons = force * curve.load_direction;
    turns = hinge_chain_equilibrium(chain, k, forces, turns);
    displacements.push_back(curve.watched_direction.dot(chain.where(curve.watched, turns) - before));
  }
  return displacements;
}

HingeFit fit_hinges(const HingeChain& chain, const HingeCurve& curve) {
  // By small turns: each hinge turns by F a / k, and moves the point by that times b.
  const auto lever = [&](int hinge, const HingeChain::Place& place, const Eigen::Vector2d& direction) {
    if (hinge >= place.segment) return 0.0;
    return direction.dot(quarter_turned(place.at - chain.hinges[static_cast<size_t>(hinge)]));
  };
  double levers = 0, along = 0;
  for (int i = 0; i < chain.size(); ++i) {
    levers += lever(i, curve.load, curve.load_direction) * lever(i, curve.watched, curve.watched_direction);
    along += std::pow((curve.load.at - chain.hinges[static_cast<size_t>(i)]).norm(), 2);
  }
  if (!(std::abs(levers) > 1e-6 * along))
    throw InputError(
        "the load does not turn the hinges, or what is measured does not move with them: a chain gives way across its "
        "axis only; choose a load and a channel across it");
  double k = 0;
  for (size_t i = 0; i < curve.forces.size(); ++i) {
    if (!(curve.displacements[i] / levers > 0) || !std::isfinite(curve.displacements[i]))
      throw InputError(
          "the replay moves against the load, or not at all, or has no equilibrium: no chain of springs follows that; "
          "choose another channel, load or retraction");
    k += levers * curve.forces[i] / curve.displacements[i] / static_cast<double>(curve.forces.size());
  }
  const auto misfit = [&](double log_k) {
    double sum = 0;
    const std::vector<double> found = hinge_chain_curve(chain, std::exp(log_k), curve);
    for (size_t i = 0; i < found.size(); ++i) sum += std::pow(found[i] / curve.displacements[i] - 1, 2);
    return std::isfinite(sum) ? sum : infinity;
  };
  std::uintmax_t most = 200;
  const auto [best, least] =
      boost::math::tools::brent_find_minima(misfit, std::log(k / 30), std::log(k * 30), 40, most);
  HingeFit fit;
  fit.stiffness = std::exp(best);
  fit.displacements = hinge_chain_curve(chain, fit.stiffness, curve);
  for (size_t i = 0; i < fit.displacements.size(); ++i) {
    const double off = std::abs(fit.displacements[i] / curve.displacements[i] - 1);
    if (!(off > fit.largest)) continue;
    fit.largest = off;
    fit.at = curve.forces[i];
  }
  return fit;
}

}  // namespace taut
