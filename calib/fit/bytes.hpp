#pragma once
#include <Eigen/Core>
#include <concepts>
#include <cstring>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

namespace taut {

/// Values as bytes, one after the other, for files that the same program reads again on the same machine. The same call
/// puts values and takes them, so that what a file holds is said once.
class Bytes {
 public:
  /// To put values.
  Bytes() = default;
  /// To take them from `left`, which has to outlive this. Throws std::runtime_error where the bytes end too early.
  explicit Bytes(std::string_view left) : taking_(true), left_(left) {}

  /// Numbers, texts, vectors, matrices and lists of them; only those that are put may be const.
  template <class... Values>
  Bytes& operator()(Values&&... values) {
    (walk(values), ...);
    return *this;
  }
  const std::string& bytes() const { return bytes_; }  ///< what was put so far
  bool at_end() const { return left_.empty(); }        ///< all was taken

 private:
  template <class T>
  void walk(T& value) {
    using Value = std::remove_const_t<T>;
    if constexpr (std::is_trivially_copyable_v<Value>) {
      walk_all(&value, 1);
    } else if constexpr (std::same_as<Value, Eigen::MatrixXd>) {
      Eigen::Index rows = value.rows(), size = value.size();
      (*this)(rows, size);
      need(static_cast<size_t>(size));
      if constexpr (!std::is_const_v<T>) value.resize(rows, rows > 0 ? size / rows : 0);
      walk_all(value.data(), static_cast<size_t>(size));
    } else {
      auto size = static_cast<size_t>(value.size());
      walk(size);
      need(size);
      if constexpr (!std::is_const_v<T>) value.resize(size);
      if constexpr (std::is_trivially_copyable_v<std::remove_cvref_t<decltype(*value.data())>>) {
        walk_all(value.data(), size);
      } else {
        for (auto& element : value) walk(element);
      }
    }
  }
  template <class T>
  void walk_all(T* first, size_t count) {
    const size_t size = count * sizeof(T);
    if (!taking_) {
      bytes_.append(reinterpret_cast<const char*>(first), size);
    } else if constexpr (!std::is_const_v<T>) {
      need(size);
      if (size > 0) std::memcpy(first, left_.data(), size);
      left_.remove_prefix(size);
    }
  }
  void need(size_t size) const {
    if (taking_ && size > left_.size()) throw std::runtime_error("the bytes end too early");
  }

  bool taking_ = false;
  std::string bytes_;
  std::string_view left_;
};

}  // namespace taut
