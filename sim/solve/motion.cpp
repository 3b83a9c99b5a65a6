#include "sim/solve/motion.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

namespace taut {
namespace {

/// (R(w) - I) v for the rotation by |w| about w, free of cancellation for small angles.
Eigen::Vector3d turned_by(const Eigen::Vector3d& w, const Eigen::Vector3d& v) {
  const double angle = w.norm();
  const double first = angle < 1e-4 ? 1 - angle * angle / 6 : std::sin(angle) / angle;
  const double half = angle < 1e-4 ? 0.5 : std::sin(angle / 2) / angle;
  const Eigen::Vector3d across = w.cross(v);
  return first * across + 2 * half * half * w.cross(across);
}

}  // namespace

Motion::Motion(const Model& model, const Params& p, bool straight, bool unchecked)
    : model_(&model), unchecked_(unchecked) {
  double softest = std::numeric_limits<double>::infinity();
  for (const Body& body : model.bodies()) {
    if (!body.rigid()) softest = std::min(softest, p[body.modulus]);
  }
  for (const Body& body : model.bodies()) {
    if (body.supported) continue;
    if (body.rigid() || (!straight && p[body.modulus] > 100 * softest)) stiff_.push_back(&body);
  }
}

Eigen::VectorXd Motion::along(const Eigen::VectorXd& u, const Eigen::VectorXd& step, double fraction) const {
  Eigen::VectorXd result = u + fraction * step;
  const int d = model_->mesh().dimension();
  auto lifted = [d](const Eigen::VectorXd& all, int node) {
    Eigen::Vector3d v = Eigen::Vector3d::Zero();
    v.head(d) = all.segment(node * d, d);
    return v;
  };
  for (const Body* body : stiff_) {
    Eigen::Vector3d centre = Eigen::Vector3d::Zero(), translation = Eigen::Vector3d::Zero();
    for (int node : body->nodes) {
      centre += lifted(model_->mesh().X, node) + lifted(u, node);
      translation += lifted(step, node);
    }
    centre /= static_cast<double>(body->nodes.size());
    translation /= static_cast<double>(body->nodes.size());
    Eigen::Matrix3d inertia = Eigen::Matrix3d::Zero();
    Eigen::Vector3d momentum = Eigen::Vector3d::Zero();
    for (int node : body->nodes) {
      const Eigen::Vector3d r = lifted(model_->mesh().X, node) + lifted(u, node) - centre;
      inertia += r.squaredNorm() * Eigen::Matrix3d::Identity() - r * r.transpose();
      momentum += r.cross(lifted(step, node) - translation);
    }
    const Eigen::Vector3d w =
        d == 2 ? Eigen::Vector3d(0, 0, momentum[2] / inertia(2, 2)) : Eigen::Vector3d(inertia.ldlt().solve(momentum));
    for (int node : body->nodes) {
      const Eigen::Vector3d r = lifted(model_->mesh().X, node) + lifted(u, node) - centre;
      Eigen::Vector3d strained = Eigen::Vector3d::Zero();
      if (!body->rigid()) strained = fraction * (lifted(step, node) - translation - w.cross(r));
      const Eigen::Vector3d moved = fraction * translation + turned_by(fraction * w, r + strained) + strained;
      result.segment(node * d, d) = u.segment(node * d, d) + moved.head(d);
    }
  }
  return result;
}

Eigen::VectorXd Motion::admissible(const Eigen::VectorXd& u, const Eigen::VectorXd& step, const Params& p,
                                   double& fraction) const {
  if (unchecked_) return along(u, step, fraction);
  for (int attempt = 0; attempt < 20; ++attempt) {
    Eigen::VectorXd trial = along(u, step, fraction);
    const double limit = model_->step_limit({u, p}, trial - u);
    if (limit >= 1) return trial;
    fraction *= 0.95 * limit;  // the way bends: the next chord is another one
    if (!(fraction > 1e-14)) break;
  }
  fraction = 0;
  return u;
}

}  // namespace taut
