#include "sim/shapes/shape.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <type_traits>

#include "sim/core/error.hpp"
#include "sim/shapes/all.hpp"

namespace taut {
namespace {

template <class... Shapes>
std::vector<std::unique_ptr<Shape>> one_of_each(std::type_identity<std::tuple<Shapes...>>) {
  std::vector<std::unique_ptr<Shape>> all;
  (all.push_back(std::make_unique<Shapes>()), ...);
  return all;
}

template <class... Shapes>
std::vector<std::string> names_with_axis(std::type_identity<std::tuple<Shapes...>>) {
  std::vector<std::string> names;
  // The member's class is Shape where a kind has none of its own.
  const auto add = [&]<class Own>(std::type_identity<Own>) {
    if (!std::is_same_v<decltype(&Own::axis), decltype(&Shape::axis)>) names.push_back(Own().kind());
  };
  (add(std::type_identity<Shapes>()), ...);
  return names;
}

}  // namespace

std::vector<std::string> shape_kinds() {
  std::vector<std::string> kinds;
  for (const auto& shape : one_of_each(std::type_identity<AllShapes>())) kinds.push_back(shape->kind());
  return kinds;
}

std::vector<std::string> kinds_with_axis() {
  return names_with_axis(std::type_identity<AllShapes>());
}

std::unique_ptr<Shape> make_shape(std::string_view kind) {
  for (auto& shape : one_of_each(std::type_identity<AllShapes>())) {
    if (shape->kind() == kind) return std::move(shape);
  }
  throw InputError(fmt::format("'{}' is no kind of geometry{}; allowed: {}", kind, did_you_mean(kind, shape_kinds()),
                               join(shape_kinds())));
}

std::string MeshSettings::describe() const {
  std::string text = fmt::format("{}{}", order == 1 ? "linear" : "quadratic",
                                 formulation == Formulation::locking_free ? ", locking-free" : "");
  if (!cells.empty()) {
    text += ", ";
    for (size_t i = 0; i < cells.size(); ++i) text += fmt::format("{}{}", i == 0 ? "" : " x ", cells[i]);
    text += " cells";
  } else if (size > 0) {
    text += fmt::format(", elements of {}", with_unit(size, "m"));
  }
  if (contact_gap > 0) text += fmt::format(", contact gap {}", with_unit(contact_gap, "m"));
  return text;
}

double contact_gap(const MeshSettings& settings, double diagonal) {
  return settings.contact_gap > 0 ? settings.contact_gap : 2e-5 * diagonal;
}

std::string in_mm(double length) {
  return fmt::format("{:.6g} mm", 1e3 * length);
}

void Shape::check_keys(std::string_view who) const {
  const std::unique_ptr<Shape> own = clone();
  for (const ShapeKey& key : own->keys()) {
    if (key.required) continue;
    if (int* const* count = std::get_if<int*>(&key.value); count != nullptr && !key.allowed.holds(**count))
      throw InputError(fmt::format("{}: {} is {}; {} is needed", who, key.key, **count,
                                   **count > key.allowed.most ? fmt::format("at most {}", key.allowed.most)
                                                              : fmt::format("at least {}", key.allowed.least)));
    double* const* length = std::get_if<double*>(&key.value);
    if (length == nullptr || std::isinf(key.allowed.least) || key.allowed.holds(**length)) continue;
    throw InputError(fmt::format("{}: {} is {}; a positive length {}", who, key.key, in_mm(**length),
                                 key.allowed.open ? "is needed" : "or 0 for none is allowed"));
  }
}

void Shape::check_counts(std::string_view who, const MeshSettings& settings) const {
  for (const MeshKey& key : mesh_keys()) {
    const int given = key.kind == MeshKey::count ? count(settings, key.key) : 1;
    if (given < 1) throw InputError(fmt::format("{}: {} is {}; at least 1 is needed", who, key.key, given));
    if (given > 1'000'000)
      throw InputError(fmt::format("{}: {} is {}; at most a million are allowed", who, key.key, given));
  }
}

int Shape::count(const MeshSettings& settings, std::string_view key) const {
  const auto given = settings.counts.find(key);
  if (given != settings.counts.end()) return given->second;
  const std::vector<MeshKey> keys = mesh_keys();
  return std::find_if(keys.begin(), keys.end(), [&](const MeshKey& one) { return one.key == key; })->fallback;
}

}  // namespace taut
