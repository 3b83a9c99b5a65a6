#pragma once
#include <Eigen/Core>
#include <cstring>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

namespace taut {

/// Values as bytes, one after the other, for files that the same program reads again on the same machine.
class ByteWriter {
 public:
  template <class T>
  requires std::is_trivially_copyable_v<T>
  void put(const T& value) { bytes_.append(reinterpret_cast<const char*>(&value), sizeof value); }
  void put(std::string_view text) { put_all(text.data(), text.size()); }
  template <class T>
  void put(const std::vector<T>& values) {
    put_all(values.data(), values.size());
  }
  void put(const Eigen::MatrixXd& matrix) {
    put(matrix.rows());
    put_all(matrix.data(), static_cast<size_t>(matrix.size()));
  }
  void put(const Eigen::VectorXd& vector) { put_all(vector.data(), static_cast<size_t>(vector.size())); }
  const std::string& bytes() const { return bytes_; }

 private:
  template <class T>
  void put_all(const T* first, size_t count) {
    put(count);
    bytes_.append(reinterpret_cast<const char*>(first), count * sizeof(T));
  }
  std::string bytes_;
};

/// The reverse. Throws std::runtime_error where the bytes end too early.
class ByteReader {
 public:
  explicit ByteReader(std::string_view bytes) : left_(bytes) {}
  template <class T>
  T get() {
    T value;
    std::memcpy(&value, take(sizeof value).data(), sizeof value);
    return value;
  }
  std::string text() { return std::string(take(get<size_t>())); }
  template <class T>
  std::vector<T> list() {
    const size_t count = get<size_t>();
    std::vector<T> values(count <= left_.size() / sizeof(T) ? count : 0);
    const std::string_view bytes = take(count * sizeof(T));
    if (count > 0) std::memcpy(values.data(), bytes.data(), bytes.size());
    return values;
  }
  Eigen::MatrixXd matrix() {
    const auto rows = get<Eigen::Index>();
    const std::vector<double> values = list<double>();
    return Eigen::Map<const Eigen::MatrixXd>(values.data(), rows,
                                             rows > 0 ? static_cast<Eigen::Index>(values.size()) / rows : 0);
  }
  Eigen::VectorXd vector() {
    const std::vector<double> values = list<double>();
    return Eigen::Map<const Eigen::VectorXd>(values.data(), static_cast<Eigen::Index>(values.size()));
  }
  bool at_end() const { return left_.empty(); }

 private:
  std::string_view take(size_t count) {
    if (count > left_.size()) throw std::runtime_error("the bytes end too early");
    const std::string_view taken = left_.substr(0, count);
    left_.remove_prefix(count);
    return taken;
  }
  std::string_view left_;
};

}  // namespace taut
