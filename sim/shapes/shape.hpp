#pragma once
#include <Eigen/Core>
#include <climits>
#include <cmath>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

#include "sim/core/units.hpp"
#include "sim/mesh/gmsh.hpp"
#include "sim/shapes/axis.hpp"
#include "sim/shapes/drawing.hpp"
#include "sim/shapes/spine.hpp"
#include "sim/terms/solid.hpp"

namespace taut {

/// How finely and with which elements the geometry is resolved; [mesh], and what a [[fit.variant]] changes.
struct MeshSettings {
  std::vector<int> cells = {};                          ///< structured: cells along x, y(, z)
  double size = 0;                                      ///< element size [m]
  std::map<std::string, int, std::less<>> counts = {};  ///< elements by the names of a shape's mesh_keys()
  int depth_cells = 0;  ///< a 2D kind as a solid: elements across half of its thickness; 0: it is plane
  int order = 2;
  Formulation formulation = Formulation::standard;
  double contact_gap = 0;        ///< distance at which contact sets in [m]; 0: 2e-5 of the specimen's diagonal
  std::string describe() const;  ///< "quadratic, locking-free, 14 x 5 x 5 cells"
};

/// Distance at which contact sets in [m]: the file's, or 2e-5 of a specimen's diagonal.
double contact_gap(const MeshSettings& settings, double diagonal);

/// What a key of [mesh] stands for.
struct MeshKey {
  /// Cells along the axes, an element size, a number of elements.
  enum Kind { cells, size, count } kind;
  std::string_view key, meaning;
  int fallback = 1;  ///< of a count
};

/// Values that a dimension may have.
struct Allowed {
  double least = -INFINITY, most = INFINITY;
  bool open = false;                                                   ///< without `least` itself
  static constexpr Allowed any() { return {}; }                        ///< any finite number
  static constexpr Allowed positive() { return {0, INFINITY, true}; }  ///< above zero
  static constexpr Allowed zero_or_more() { return {0, INFINITY}; }    ///< zero too
  /// From `least` on, `most` included.
  static constexpr Allowed at_least(int least, int most = INT_MAX) {
    return {static_cast<double>(least), static_cast<double>(most)};
  }
  /// Whether a value is one of them.
  bool holds(double value) const {
    return std::isfinite(value) && (open ? value > least : value >= least) && value <= most;
  }
};

/// A path as a value of a key.
struct InputFile {
  std::string path;  ///< in a file of settings: beside that file
};
/// Lengths as a value of a key, as many as the file gives.
struct LengthList {
  std::vector<double> values;  ///< [m]
};
/// A unit of length as a value of a key.
struct LengthUnit {
  double metres = 1;
};

/// One key of [geometry]: the member of a shape that it sets, whose value before that is the default, and what it
/// means.
struct ShapeKey {
  std::string_view key;
  std::variant<int*, double*, std::string*, std::vector<double>*, LengthList*, InputFile*, LengthUnit*,
               std::vector<BoxRegion>*, std::vector<PolygonRegion>*>
      value;
  Allowed allowed;
  std::string_view meaning;
  Quantity quantity = Quantity::length;
  /// Without it there is no such shape. What is required is checked where it is read, the rest by Shape::check().
  bool required = false;
};

/// What an experiment has unless its file says otherwise.
struct ShapeDefaults {
  bool cables = false;   ///< all cables that the shape brings along, by their names
  bool contact = false;  ///< between lips that close, the distance at which they rest taken off their faces
};

/// A plane of symmetry that bounds a part of a body: a coordinate is 0 on it, in the body's own frame, and not negative
/// in the part.
struct SymmetryPlane {
  std::string tag;
  int component;  ///< which coordinate
};

/// A kind of specimen: its dimensions are its members. A new one is one new file and its name in all.hpp: factory,
/// files, messages, meshes, cables and drawings follow.
class Shape {
 public:
  virtual ~Shape() = default;
  virtual std::unique_ptr<Shape> clone() const = 0;  ///< a copy

  /// The name in files, "push_puppet".
  virtual std::string kind() const = 0;
  virtual int dimension() const = 0;  ///< 2 or 3
  /// The table of dimensions, in the order in which they are read. Valid as long as the shape lives.
  virtual std::vector<ShapeKey> keys() = 0;
  /// Throws InputError with the numbers that clash.
  virtual void check() const {}

  /// The table of [mesh]; none: the mesh is what it is.
  virtual std::vector<MeshKey> mesh_keys() const = 0;
  /// The body, or its plane section. In `contact` it must have room for the contact gap; with `compensate` the distance
  /// at which closed faces rest is taken off them, so that they close where the specimen's own do. Throws InputError.
  virtual Mesh mesh(const MeshSettings& settings, bool contact, bool compensate) const = 0;

  /// Names of the cables that it brings along, and the rest points [m] of one of them in its own frame.
  virtual std::vector<std::string> cable_names() const { return {}; }
  virtual std::vector<Eigen::VectorXd> cable(size_t) const { return {}; }  ///< see cable_names()
  virtual ShapeDefaults defaults() const { return {}; }                    ///< see ShapeDefaults

  /// Of a part that stands for a whole body.
  virtual std::vector<SymmetryPlane> symmetry() const { return {}; }

  /// Lengths along the axes [m], where it is made of such.
  virtual std::vector<double> extent() const { return {}; }
  /// The ways in which it is a chain of beams, one per face that may be clamped. Throws InputError when its dimensions
  /// make it none.
  virtual std::vector<Spine> spines() const { return {}; }
  /// The straight centre line, where it has one: cables and markers may be placed along it, and it may be a rod.
  virtual std::optional<BodyAxis> axis() const { return std::nullopt; }
  /// Without one, a drawing shows overall dimensions.
  virtual std::optional<ShapeDrawing> drawing() const { return std::nullopt; }

 protected:
  /// The part of check() that follows from the table, for keys with a bound that are not required.
  void check_keys(std::string_view who) const;
  /// The same for numbers of elements, as settings or the table of [mesh] have them.
  void check_counts(std::string_view who, const MeshSettings& settings) const;
  /// settings.counts[key], or what the table says.
  int count(const MeshSettings& settings, std::string_view key) const;
};

/// A kind of specimen of D dimensions that says its `kind_name`.
template <class Own, int D>
struct ShapeOf : Shape {
  /// See Shape::clone().
  std::unique_ptr<Shape> clone() const override { return std::make_unique<Own>(static_cast<const Own&>(*this)); }
  std::string kind() const override { return Own::kind_name; }  ///< see Shape::kind()
  int dimension() const override { return D; }                  ///< see Shape::dimension()
};

/// The only key of [mesh] of what Gmsh meshes.
inline constexpr MeshKey size_of_elements{MeshKey::size, "size", "of the elements, about"};

/// Names of all kinds, as files have them.
std::vector<std::string> shape_kinds();
/// Of these, the kinds that have an axis.
std::vector<std::string> kinds_with_axis();
/// A shape of this kind with its default dimensions. Throws InputError for an unknown one.
std::unique_ptr<Shape> make_shape(std::string_view kind);

/// Fraction of the contact gap that faces rest apart at about half the pressure that the barrier is made for.
inline constexpr double resting_distance = 0.65;

/// "11.5 mm", six digits
std::string in_mm(double length);

}  // namespace taut
