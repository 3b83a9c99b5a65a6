#pragma once
#include <Eigen/Core>
#include <vector>

#include "sim/model/term.hpp"

namespace taut {

/// Some nodes of a mesh, and their part of vectors of all unknowns.
struct NodeSet {
  std::vector<int> nodes;  ///< all different
  int dimension = 0;

  int count() const { return static_cast<int>(nodes.size()); }  ///< number of nodes
  /// All of its nodes coupled with each other.
  Cliques cliques() const {
    Cliques list;
    list.add(nodes);
    return list;
  }
  /// One column per node.
  Eigen::MatrixXd gather(const Eigen::VectorXd& all) const {
    Eigen::MatrixXd local(dimension, count());
    for (int a = 0; a < count(); ++a) local.col(a) = all.segment(nodes[a] * dimension, dimension);
    return local;
  }
  /// Adds what stands node by node in `local`.
  void scatter(const Eigen::VectorXd& local, Eigen::VectorXd& all) const {
    for (int a = 0; a < count(); ++a)
      all.segment(nodes[a] * dimension, dimension) += local.segment(a * dimension, dimension);
  }
  /// The same with zeros elsewhere, `size` entries in all.
  Eigen::VectorXd spread(const Eigen::VectorXd& local, Eigen::Index size) const {
    Eigen::VectorXd all = Eigen::VectorXd::Zero(size);
    scatter(local, all);
    return all;
  }
  /// An energy's derivatives; `H` is symmetric, and its only clique's.
  void add_hessian(const Eigen::MatrixXd& H, Assembly& out) const {
    out.add_hessian(0, nodes.data(), count(), dimension, H.data());
  }
};

}  // namespace taut
