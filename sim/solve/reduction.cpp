#include "sim/solve/reduction.hpp"

#include <array>
#include <cmath>

#include "sim/core/dense.hpp"
#include "sim/core/sorted.hpp"

namespace taut {

Reduction::Reduction(const Model& model) : model_(&model) {
  const int d = model.mesh().dimension();
  std::vector<int> owner(model.mesh().node_count(), -1);
  for (const Body& body : model.bodies()) {
    if (!body.rigid() || body.supported) continue;
    for (int node : body.nodes) owner[node] = static_cast<int>(bodies_.size());
    bodies_.push_back({&body, 0, 0});
  }
  offsets_.push_back(0);
  size_ = model.free_unknowns();
  if (identity()) return;

  size_ = 0;
  std::vector<int> own(model.free_unknowns(), -1);  // of unknowns outside rigid bodies
  for (int i = 0; i < model.unknowns(); ++i) {
    if (model.free_index(i) >= 0 && owner[i / d] < 0) own[model.free_index(i)] = size_++;
  }
  const Eigen::VectorXd rest = Eigen::VectorXd::Zero(model.unknowns());
  for (Rigid& rigid : bodies_) {
    rigid.first = size_;
    size_ += d == 2 ? 3 : 6;
    const Eigen::VectorXd c = centre(*rigid.body, rest);
    double sum = 0;
    for (int node : rigid.body->nodes) sum += (model.mesh().node(node) - c).squaredNorm();
    rigid.radius = std::sqrt(sum / static_cast<double>(rigid.body->nodes.size()));
  }
  for (int i = 0; i < model.unknowns(); ++i) {
    const int free = model.free_index(i), node = i / d, component = i % d;
    if (free < 0) continue;
    if (owner[node] < 0) {
      entries_.push_back({own[free]});
    } else {
      const int b = owner[node];
      const Rigid& rigid = bodies_[b];
      entries_.push_back({rigid.first + component});
      // w x r: component i takes w_j r_k - w_k r_j, (i, j, k) cyclic.
      const int j = (component + 1) % 3, k = (component + 2) % 3;
      const double scale = 1 / rigid.radius;
      if (d == 3) entries_.push_back({rigid.first + d + j, b, node * d + k, scale});
      if (d == 3) entries_.push_back({rigid.first + d + k, b, node * d + j, -scale});
      if (d == 2) entries_.push_back({rigid.first + d, b, node * d + 1 - component, component == 0 ? -scale : scale});
    }
    offsets_.push_back(static_cast<int>(entries_.size()));
  }
  build_pattern();
}

void Reduction::build_pattern() {
  std::vector<std::vector<int>> columns(size_);
  for (int k = 0; k < size_; ++k) columns[k].push_back(k);
  model_->pattern().each([&](int, int i, int j) {
    spread(i, j, [&](int row, int column, int, int, double) { columns[column].push_back(row); });
  });
  for (const Rigid& rigid : bodies_) {
    const int first = rigid.first + model_->mesh().dimension();
    const int last = rigid.first + (model_->mesh().dimension() == 2 ? 3 : 6);
    for (int column = first; column < last; ++column) {
      for (int row = column; row < last; ++row) columns[column].push_back(row);
    }
  }
  pattern_.size = size_;
  pattern_.columns.assign(1, 0);
  for (std::vector<int>& rows : columns) {
    sort_unique(rows);
    pattern_.rows.insert(pattern_.rows.end(), rows.begin(), rows.end());
    pattern_.columns.push_back(static_cast<int>(pattern_.rows.size()));
  }
}

Eigen::VectorXd Reduction::centre(const Body& body, const Eigen::VectorXd& u) const {
  const int d = model_->mesh().dimension();
  Eigen::VectorXd sum = Eigen::VectorXd::Zero(d);
  for (int node : body.nodes) sum += model_->mesh().node(node) + u.segment(node * d, d);
  return sum / static_cast<double>(body.nodes.size());
}

std::vector<double> Reduction::weights(const Eigen::VectorXd& u) const {
  std::vector<Eigen::VectorXd> centres;
  for (const Rigid& rigid : bodies_) centres.push_back(centre(*rigid.body, u));
  std::vector<double> weights;
  weights.reserve(entries_.size());
  const int d = model_->mesh().dimension();
  for (const Entry& entry : entries_) {
    weights.push_back(entry.body < 0 ? 1.0
                                     : entry.scale * (model_->mesh().X[entry.unknown] + u[entry.unknown] -
                                                      centres[entry.body][entry.unknown % d]));
  }
  return weights;
}

Eigen::VectorXd Reduction::restrict_to_free(const Eigen::VectorXd& u, const Eigen::VectorXd& all) const {
  Eigen::VectorXd free = model_->restrict_to_free(all);
  if (identity()) return free;
  const std::vector<double> w = weights(u);
  Eigen::VectorXd q = Eigen::VectorXd::Zero(size_);
  for (Eigen::Index i = 0; i < free.size(); ++i) {
    for (int k = offsets_[i]; k < offsets_[i + 1]; ++k) q[entries_[k].column] += w[k] * free[i];
  }
  return q;
}

Eigen::VectorXd Reduction::extend_from_free(const Eigen::VectorXd& u, const Eigen::VectorXd& q) const {
  if (identity()) return model_->extend_from_free(q);
  const std::vector<double> w = weights(u);
  Eigen::VectorXd free = Eigen::VectorXd::Zero(model_->free_unknowns());
  for (Eigen::Index i = 0; i < free.size(); ++i) {
    for (int k = offsets_[i]; k < offsets_[i + 1]; ++k) free[i] += w[k] * q[entries_[k].column];
  }
  return model_->extend_from_free(free);
}

std::vector<Reduction::Curved> Reduction::rotations(const Eigen::VectorXd& u, const Eigen::VectorXd& gradient,
                                                    bool projected) const {
  std::vector<Curved> curved;
  const int d = model_->mesh().dimension();
  for (const Rigid& rigid : bodies_) {
    const Eigen::VectorXd c = centre(*rigid.body, u);
    Eigen::MatrixXd moment = Eigen::MatrixXd::Zero(d, d);  // sum of g r^T
    for (int node : rigid.body->nodes) {
      const Eigen::Index at = static_cast<Eigen::Index>(node) * d;
      moment += gradient.segment(at, d) * (model_->mesh().node(node) + u.segment(at, d) - c).transpose();
    }
    moment /= rigid.radius * rigid.radius;
    if (d == 2) {
      const double value = -moment.trace();
      curved.push_back({rigid.first + d, rigid.first + d, projected ? std::max(0.0, value) : value});
      continue;
    }
    Eigen::Matrix3d whole = 0.5 * (moment + moment.transpose()) - moment.trace() * Eigen::Matrix3d::Identity();
    if (projected) whole = positive_part(whole);
    for (int column = 0; column < d; ++column) {
      for (int row = column; row < d; ++row)
        curved.push_back({rigid.first + d + row, rigid.first + d + column, whole(row, column)});
    }
  }
  return curved;
}

}  // namespace taut
