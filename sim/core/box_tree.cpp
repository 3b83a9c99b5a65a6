#include "sim/core/box_tree.hpp"

#include <algorithm>
#include <cstddef>
#include <numeric>

namespace taut {

template <int D>
BoxTree<D>::BoxTree(const std::vector<Place>& places) {
  std::vector<int> order(places.size());
  std::iota(order.begin(), order.end(), 0);
  if (!places.empty()) build(places, order, 0, places.size());
}

template <int D>
void BoxTree<D>::build(const std::vector<Place>& places, std::vector<int>& order, size_t begin, size_t end) {
  const size_t self = leaf_.size();
  leaf_.push_back(end - begin == 1 ? order[begin] : -1);
  next_.push_back(self + 2 * (end - begin) - 1);
  if (end - begin == 1) return;
  Box box;
  for (size_t i = begin; i < end; ++i) box.extend(places[order[i]]);
  int axis = 0;
  box.sizes().maxCoeff(&axis);
  const size_t middle = begin + (end - begin) / 2;
  std::sort(order.begin() + static_cast<std::ptrdiff_t>(begin), order.begin() + static_cast<std::ptrdiff_t>(end),
            [&](int one, int two) {
              const double x = places[one][axis], y = places[two][axis];
              return x < y || (x == y && one < two);
            });
  build(places, order, begin, middle);
  build(places, order, middle, end);
}

template <int D>
auto BoxTree<D>::enclose(const std::vector<Box>& leaves) const -> std::vector<Box> {
  std::vector<Box> boxes(leaf_.size());
  for (size_t k = leaf_.size(); k-- > 0;) {
    boxes[k] = leaf_[k] >= 0 ? leaves[leaf_[k]] : boxes[k + 1].merged(boxes[next_[k + 1]]);
  }
  return boxes;
}

template class BoxTree<2>;
template class BoxTree<3>;

}  // namespace taut
