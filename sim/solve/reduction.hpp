#pragma once
#include <Eigen/Core>
#include <algorithm>
#include <vector>

#include "sim/model/model.hpp"

namespace taut {

/// What a solver has as unknowns q: the free displacements of all nodes outside rigid bodies and, for each rigid body
/// without supports, the increments t [m] and w a [m] of its position and rotation, a the root mean square of its
/// nodes' arms at rest. Around a state u, with r the arm of a node from the mean position c(u) of its body,
///
///   u(q) = u + t + (R(w) - I) r,   du/dq = T(u): t + w x r,
///   d2Pi/dq2 = T^T H T + sum over bodies of [ (g r^T + r g^T) / 2 - (g . r) I ] / a^2   (w w; g the nodal gradient).
///
/// Without rigid bodies T is the identity. Motion walks along u(q) exactly, so that rigid bodies stay rigid.
class Reduction {
 public:
  explicit Reduction(const Model& model);  ///< the model has to outlive it

  int size() const { return size_; }                         ///< number of unknowns
  bool identity() const { return bodies_.empty(); }          ///< they are the model's free unknowns
  const SparsePattern& pattern() const { return pattern_; }  ///< of T^T H T, for the model's own pattern of H

  Eigen::VectorXd restrict_to_free(const Eigen::VectorXd& u, const Eigen::VectorXd& all) const;  ///< T(u)^T all
  Eigen::VectorXd extend_from_free(const Eigen::VectorXd& u, const Eigen::VectorXd& q) const;    ///< T(u) q

  /// The entries of T at u, in the order of its rows.
  std::vector<double> weights(const Eigen::VectorXd& u) const;
  /// Where entry (i, j) of H, free unknowns of the model with i >= j, goes: add(row, column, left, right, factor) for
  /// each entry row >= column of T^T H T, to which it adds factor * weights[left] * weights[right] * H(i, j).
  template <class Add>
  void spread(int i, int j, Add&& add) const {
    for (int a = offsets_[i]; a < offsets_[i + 1]; ++a) {
      for (int b = offsets_[j]; b < offsets_[j + 1]; ++b) {
        const int one = entries_[a].column, two = entries_[b].column;
        if (i == j && one < two) continue;  // (a, b) and (b, a) are one entry of the lower triangle
        add(std::max(one, two), std::min(one, two), a, b, i != j && one == two ? 2.0 : 1.0);
      }
    }
  }
  /// Second derivative of the energy by the rotations for nodal gradients g: add(row, column, value). Its positive part
  /// alone where `projected`.
  struct Curved {
    int row, column;
    double value;
  };
  /// See Curved.
  std::vector<Curved> rotations(const Eigen::VectorXd& u, const Eigen::VectorXd& gradient, bool projected) const;

 private:
  struct Entry {
    int column;
    int body = -1;     ///< -1: the weight is 1
    int unknown = 0;   ///< whose arm component counts, among all unknowns
    double scale = 0;  ///< by what: +-1 / a
  };
  struct Rigid {
    const Body* body;
    int first;      ///< its first unknown, a translation
    double radius;  ///< a [m]
  };
  Eigen::VectorXd centre(const Body& body, const Eigen::VectorXd& u) const;
  void build_pattern();

  const Model* model_;
  int size_ = 0;
  std::vector<int> offsets_;    ///< per free unknown of the model, into entries_
  std::vector<Entry> entries_;  ///< T row by row
  std::vector<Rigid> bodies_;
  SparsePattern pattern_;
};

}  // namespace taut
