#include "sim/terms/cable_path.hpp"

#include <algorithm>
#include <cmath>

#include "sim/core/error.hpp"
#include "sim/core/sorted.hpp"

namespace taut {

CablePath::CablePath(const Mesh& mesh, const std::vector<CablePoint>& points, double regular)
    : on_{{}, mesh.dimension()} {
  std::vector<int>& nodes = on_.nodes;
  for (const CablePoint& point : points)
    nodes.insert(nodes.end(), point.material.nodes.begin(), point.material.nodes.end());
  sort_unique(nodes);

  Eigen::MatrixXd place(on_.dimension, points.size());
  Eigen::MatrixXd weight = Eigen::MatrixXd::Zero(on_.count(), place.cols());
  for (Eigen::Index i = 0; i < place.cols(); ++i) {
    const CablePoint& point = points[i];
    place.col(i) = point.material.nodes.empty() ? point.fixed : Eigen::VectorXd::Zero(on_.dimension).eval();
    for (size_t a = 0; a < point.material.nodes.size(); ++a) {
      const int node = point.material.nodes[a];
      place.col(i) += point.material.weights[a] * mesh.node(node);
      weight(std::lower_bound(nodes.begin(), nodes.end(), node) - nodes.begin(), i) += point.material.weights[a];
    }
  }
  const Eigen::Index count = place.cols() - 1;
  rest_ = place.rightCols(count) - place.leftCols(count);
  weights_ = weight.rightCols(count) - weight.leftCols(count);
  const double length = rest_.colwise().norm().sum();
  if (!(length > 0) && regular == 0)
    throw InputError("a cable has no length at rest; its points must not all be at one place");
  regular_ = regular > 0 ? regular : 1e-9 * length;
  rest_lengths_.resize(count);
  for (Eigen::Index s = 0; s < count; ++s) rest_length_ += rest_lengths_[s] = regular_length(rest_.col(s));
}

double CablePath::elongation(const Eigen::VectorXd& u) const {
  double sum = 0;
  for (const double one : elongations(u)) sum += one;
  return sum;
}

Eigen::VectorXd CablePath::elongations(const Eigen::VectorXd& u) const {
  const Eigen::MatrixXd change = changes(u);
  Eigen::VectorXd all(segments());
  for (Eigen::Index s = 0; s < segments(); ++s) {
    const double lengths = regular_length(rest_.col(s) + change.col(s)) + regular_length(rest_.col(s));
    all[s] = (2 * rest_.col(s) + change.col(s)).dot(change.col(s)) / lengths;
  }
  return all;
}

Eigen::VectorXd CablePath::gradient(const Eigen::VectorXd& u) const {
  const Eigen::MatrixXd difference = rest_ + changes(u);
  Eigen::MatrixXd g = Eigen::MatrixXd::Zero(on_.dimension, on_.count());
  for (Eigen::Index s = 0; s < segments(); ++s)
    g += difference.col(s) / regular_length(difference.col(s)) * weights_.col(s).transpose();
  return g.reshaped();
}

Eigen::MatrixXd CablePath::gradients(const Eigen::VectorXd& u) const {
  const Eigen::MatrixXd difference = rest_ + changes(u);
  Eigen::MatrixXd all(on_.dimension * on_.count(), segments());
  for (Eigen::Index s = 0; s < segments(); ++s) {
    const Eigen::VectorXd t = difference.col(s) / regular_length(difference.col(s));
    all.col(s) = (t * weights_.col(s).transpose()).reshaped();
  }
  return all;
}

void CablePath::add_hessian(const Eigen::VectorXd& u, double factor, Eigen::MatrixXd& H) const {
  add_hessian(u, Eigen::VectorXd::Constant(segments(), factor), H);
}

void CablePath::add_hessian(const Eigen::VectorXd& u, const Eigen::VectorXd& factors, Eigen::MatrixXd& H) const {
  const Eigen::MatrixXd difference = rest_ + changes(u);
  const int d = on_.dimension;
  for (Eigen::Index s = 0; s < segments(); ++s) {
    const double length = regular_length(difference.col(s));
    const Eigen::VectorXd t = difference.col(s) / length;
    const Eigen::MatrixXd across = (factors[s] / length) * (Eigen::MatrixXd::Identity(d, d) - t * t.transpose());
    for (Eigen::Index a = 0; a < on_.count(); ++a) {
      for (Eigen::Index b = 0; b < on_.count(); ++b) {
        const double w = weights_(a, s) * weights_(b, s);
        if (w != 0) H.block(a * d, b * d, d, d) += w * across;
      }
    }
  }
}

Eigen::VectorXd CablePath::turnings(const Eigen::VectorXd& u) const {
  const Eigen::MatrixXd difference = rest_ + changes(u);
  Eigen::VectorXd all(segments() - 1);
  for (Eigen::Index i = 0; i < all.size(); ++i) {
    const Eigen::VectorXd before = difference.col(i) / regular_length(difference.col(i)),
                          after = difference.col(i + 1) / regular_length(difference.col(i + 1));
    const double along = before.dot(after);
    all[i] = std::atan2((after - along * before).norm(), along);
  }
  return all;
}

Eigen::MatrixXd CablePath::turning_gradients(const Eigen::VectorXd& u) const {
  const Eigen::MatrixXd difference = rest_ + changes(u);
  Eigen::MatrixXd all = Eigen::MatrixXd::Zero(on_.dimension * on_.count(), segments() - 1);
  for (Eigen::Index i = 0; i < all.cols(); ++i) {
    const double one = regular_length(difference.col(i)), two = regular_length(difference.col(i + 1));
    const Eigen::VectorXd before = difference.col(i) / one, after = difference.col(i + 1) / two;
    const double along = before.dot(after);
    const Eigen::VectorXd across = after - along * before, back = before - along * after;
    if (!(across.norm() > 1e-12)) continue;
    all.col(i) = -(across.normalized() / one * weights_.col(i).transpose() +
                   back.normalized() / two * weights_.col(i + 1).transpose())
                      .reshaped();
  }
  return all;
}

double CablePath::regular_length(const Eigen::VectorXd& d) const {
  return std::sqrt(d.squaredNorm() + regular_ * regular_);
}

/// How the segments' vectors have changed from rest.
Eigen::MatrixXd CablePath::changes(const Eigen::VectorXd& u) const {
  return on_.gather(u) * weights_;
}

}  // namespace taut
