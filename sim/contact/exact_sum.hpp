#pragma once
#include <array>
#include <cmath>
#include <cstddef>

namespace taut {

/// A sum of doubles without rounding (Shewchuk's expansion): its sign is that of the last component that is not zero.
template <size_t capacity>
class ExactSum {
 public:
  /// The sum plus x.
  void add(double x) {
    double carried = x;
    for (size_t i = 0; i < size_; ++i) {
      const double sum = carried + part_[i], virtual_part = sum - carried;
      part_[i] = (carried - (sum - virtual_part)) + (part_[i] - virtual_part);
      carried = sum;
    }
    part_[size_++] = carried;
  }
  /// The sum plus x y.
  void add_product(double x, double y) {
    const double product = x * y;
    add(std::fma(x, y, -product));
    add(product);
  }
  /// The sum plus x y z.
  void add_product(double x, double y, double z) {
    const double product = x * y;
    add_product(std::fma(x, y, -product), z);
    add_product(product, z);
  }
  /// -1, 0 or 1.
  int sign() const {
    for (size_t i = size_; i-- > 0;) {
      if (part_[i] != 0) return part_[i] > 0 ? 1 : -1;
    }
    return 0;
  }

 private:
  std::array<double, capacity> part_{};
  size_t size_ = 0;
};

}  // namespace taut
