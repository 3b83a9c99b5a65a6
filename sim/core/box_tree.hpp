#pragma once
#include <Eigen/Geometry>
#include <vector>

namespace taut {

/// A binary tree over boxes in D dimensions. What belongs together is decided once, from places at rest, and stays good
/// because neighbours on a boundary stay neighbours; the boxes are another argument, so that one tree serves any number
/// of states and threads.
template <int D>
class BoxTree {
 public:
  using Place = Eigen::Matrix<double, D, 1>;  ///< a point [m]
  using Box = Eigen::AlignedBox<double, D>;   ///< along the axes

  BoxTree() = default;
  /// One leaf per place [m].
  explicit BoxTree(const std::vector<Place>& places);

  /// Boxes of all tree nodes from those of the leaves: O(n).
  std::vector<Box> enclose(const std::vector<Box>& leaves) const;

  /// Calls visit(leaf) for every leaf whose box meets `query`, always in the same order: O(log n) per hit.
  template <class Visit>
  void visit(const std::vector<Box>& boxes, const Box& query, Visit&& visit) const {
    for (size_t k = 0; k < leaf_.size();) {
      if (!boxes[k].intersects(query)) {
        k = next_[k];
        continue;
      }
      if (leaf_[k] >= 0) visit(leaf_[k]);
      ++k;
    }
  }

 private:
  void build(const std::vector<Place>& places, std::vector<int>& order, size_t begin, size_t end);

  // Depth first: the children of node k are k + 1 and next_[k + 1].
  std::vector<int> leaf_;     ///< -1: inner node
  std::vector<size_t> next_;  ///< the node after the whole subtree
};

}  // namespace taut
