#pragma once
#include <Eigen/Core>
#include <array>
#include <string>
#include <vector>

#include "reports/figures.hpp"
#include "reports/simulation_record.hpp"
#include "sim/mesh/loops.hpp"

/// What is seen of a moving mesh and its surroundings, for the pictures of a simulation. Used inside reports/ only.
namespace taut::plot {

using Surface = BoundarySurface;  ///< all that is visible of a mesh

/// Positions x = X + u [m], one column per point: of a surface, and of a line.
Eigen::MatrixXd positions(const Surface& surface, const Mesh& mesh, const Eigen::VectorXd& u);
Eigen::MatrixXd positions(const DrawnLine& line, const Mesh& mesh, const Eigen::VectorXd& u);  ///< of a line

/// A box along the axes [m].
struct Bounds {
  Eigen::VectorXd lower, upper;                               ///< corners
  void include(const Eigen::VectorXd& point);                 ///< makes it hold the point
  double diagonal() const { return (upper - lower).norm(); }  ///< [m]
  bool holds(const Eigen::VectorXd& point) const {            ///< whether it has the point
    return (point.array() >= lower.array()).all() && (point.array() <= upper.array()).all();
  }
};

/// The window of all pictures of a run: all nodes and lines in all stored states, and what lies within a quarter of
/// their diagonal of obstacles and grounds.
Bounds bounds_of(const SimulationRecord& record);

/// Which grounds.
enum class GroundsDrawn { all, planes, round };
/// Grounds as they are drawn in a frame [m]: pairs of points, of the surface and of hatching behind it in 2D; in 3D of
/// a square grid, of circles on what is round and lines along a cylinder.
std::vector<std::pair<Eigen::VectorXd, Eigen::VectorXd>> ground_strokes(const SimulationRecord& record,
                                                                        const Bounds& bounds, size_t frame,
                                                                        GroundsDrawn which = GroundsDrawn::all);
/// Whether any of them moves.
bool grounds_move(const SimulationRecord& record);

/// An orthographic view: unit vectors to the right, upwards (z is up in space) and from the scene to the viewer.
struct View {
  Eigen::Vector3d right, up, toward;
  /// Azimuth and elevation of the viewer [rad].
  View(double azimuth, double elevation);
  /// To the right, upwards, towards the viewer.
  Eigen::Vector3d operator()(const Eigen::Vector3d& x) const { return {right.dot(x), up.dot(x), toward.dot(x)}; }
};
/// Isometric: all three axes equally long, x to the lower right.
View isometric_view();

/// Triangles that face the viewer (not those seen edge-on), the farthest first (painter's algorithm, by their centres),
/// with the brightness in (0, 1] that a light over the viewer's left shoulder gives them.
struct Painted {
  int triangle;
  double brightness;
};
std::vector<Painted> painted(const Surface& surface, const Eigen::MatrixXd& x, const View& view);  ///< see Painted

/// Colours of the bodies: yellow for foam, dark grey for plastic, others in order of `i`.
std::string body_colour(const std::string& region, size_t i);
/// Colour of the i-th of `count` lines; many are all alike.
std::string line_colour(size_t i, size_t count);
/// Whether lines have their own colours, and names in legends.
bool lines_are_told_apart(size_t count);

inline constexpr const char* kGround = "#8a8278";    ///< colour of grounds
inline constexpr const char* kObstacle = "#5a3d2b";  ///< colour of obstacles

}  // namespace taut::plot
