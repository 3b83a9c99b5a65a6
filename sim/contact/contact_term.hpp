#pragma once
#include <Eigen/Core>
#include <array>
#include <memory>
#include <vector>

#include "sim/mesh/mesh.hpp"
#include "sim/model/term.hpp"

namespace taut {

/// What a ground is.
enum class GroundKind {
  plane,    ///< a half-space; in 2D a half-plane
  sphere,   ///< a ball; in 2D a disc
  cylinder  ///< around an axis without ends; in 3D only
};

/// A rigid surface without a mesh, by its signed distance h(x) [m]; a place x is admissible where h > 0. With
/// r = x - point - w, w the displacement of the ground and a its axis,
///
///   plane     h = r . normal            sphere    h = |r| - radius            cylinder  h = |r - (r . a) a| - radius
///
/// It does not turn. Only nodes are held off: facets between them cut into a curved one by (length)^2 / (8 radius).
template <int D>
struct Ground {
  using Vector = Eigen::Matrix<double, D, 1>;  ///< of the space
  Vector point;                                ///< of the plane, the centre, or on the axis [m]
  Vector normal;                               ///< unit length: of the plane; of a cylinder its axis
  GroundKind kind = GroundKind::plane;
  double radius = 0;  ///< of what is round [m]
  int node = -1;      ///< of the mesh, whose displacement is w; -1: it does not move

  bool is_round() const { return kind != GroundKind::plane; }  ///< not a plane
  /// What of r counts: across the axis of a cylinder, else all of it.
  Vector across(const Vector& r) const { return kind == GroundKind::cylinder ? Vector(r - r.dot(normal) * normal) : r; }
  double height(const Vector& r) const { return is_round() ? across(r).norm() - radius : r.dot(normal); }  ///< h [m]
  /// dh/dx at r, unit length.
  Vector up(const Vector& r) const { return is_round() ? Vector(across(r).normalized()) : normal; }
  /// d2h/dx2 at r [1/m].
  Eigen::Matrix<double, D, D> curvature(const Vector& r) const {
    using Matrix = Eigen::Matrix<double, D, D>;
    if (!is_round()) return Matrix::Zero();
    Matrix along = Matrix::Identity() - up(r) * up(r).transpose();
    if (kind == GroundKind::cylinder) along -= normal * normal.transpose();
    return along / across(r).norm();
  }
  /// The largest fraction of a relative step `dr`, at most `limit`, on which a tenth of the height `h` at `r` is kept.
  double free_motion(const Vector& r, const Vector& dr, double h, double limit) const;
};

/// A pin that joins two parts. What of them comes within `radius` of it at rest, in the plane across its axis, does not
/// see each other: bodies that overlap about a pin and turn about it keep that overlap inside of such a circle.
template <int D>
struct PinPatch {
  std::array<int, 2> parts;                                                ///< by their places in the mesh's list
  Eigen::Matrix<double, D, 1> point;                                       ///< [m]
  Eigen::Matrix<double, D, 1> axis = Eigen::Matrix<double, D, 1>::Zero();  ///< of unit length; zero in the plane
  double radius = 0;                                                       ///< [m]
};

/// What presses on a vertex of a surface from one side: from a part of the mesh, an obstacle or a ground.
template <int D>
struct Touch {
  int vertex = 0;   ///< of the surface, by its own number
  int feature = 0;  ///< the nearest one there: an edge or triangle, after all of them the grounds
  using Vector = Eigen::Matrix<double, D, 1>;  ///< [N]
  Vector force = Vector::Zero();               ///< on the vertex [N]; edges that cross take no part
  Vector change = Vector::Zero();              ///< of that; zero unless asked for
};

/// A vertex (first) and the corners of the feature that it meets.
template <int D>
struct Meeting {
  std::array<int, D + 1> nodes;       ///< of the mesh; -1: fixed in space
  Eigen::Matrix<double, D, D + 1> X;  ///< at rest [m]
  const Ground<D>* ground = nullptr;  ///< that it meets: nodes[1] is the ground's, X.col(1) its point, none beyond
  int side = 0;                       ///< what the feature is of; the same for all of a part, an obstacle, a ground
  int own_side = 0;                   ///< what the vertex is of
  int stiffness = -1;                 ///< table index of kappa
  double area = 0;                    ///< of the rest surface that stands for the vertex there [m2]; [m] in the plane
};

/// What contact in the plane and in space ask for alike, by numbers of the parameter table.
template <int D>
struct ContactSides {
  static constexpr int dimension = D;
  /// Per edge or triangle: table index of kappa > 0 [Pa]; [N/m] in the pair sums. A pair takes the smaller of its two
  /// sides' values, and a node or an edge has the smallest of those that it belongs to.
  std::vector<int> stiffness;
  std::vector<Ground<D>> grounds;    ///< they carry their whole pressure at the bodies' nodes
  int obstacle_stiffness = -1;       ///< table index of kappa of obstacles and grounds; -1: they take the body's
  int gap = -1;                      ///< table index of dhat > 0 [m]: the distance at which the barrier sets in
  std::vector<int> part;             ///< per mesh node: the part of the mesh it is of; empty: there is one
  std::vector<PinPatch<D>> patches;  ///< where parts do not see each other
};

/// An energy of what touches, in which what two sides (parts, obstacles, grounds: Meeting::side) have with each other
/// can be told apart.
class SidedTerm : public Term {
 public:
  /// What of it is between two sides, in either order; it lives no longer than this.
  virtual std::unique_ptr<Term> between(std::array<int, 2> sides) const = 0;
};

/// Contact without friction: a barrier between the features of a boundary, and between those and what is fixed, that
/// grows without bound as their distance goes to zero. Contact and Contact3d are its two kinds.
template <class Surface, class Settings, class Pair>
class SurfaceContact : public SidedTerm {
 public:
  /// Throws std::logic_error for a mesh of another dimension, features outside the mesh or without measure, or missing
  /// parameters; InputError for obstacles with repeated or too few points and grounds without direction.
  SurfaceContact(const Mesh& mesh, Settings settings);
  ~SurfaceContact() override;

  /// Pairs vary with the state: Hessian entries are couplings. Curvature::projected makes each pair's Hessian positive
  /// semi-definite.
  void assemble(const Point& at, Assembly& out) const override;
  /// True for dhat, every kappa and, where it counts, the thickness.
  bool depends_on(int index) const override;
  /// Where two kappas are equal, the derivative is that of the one with the lower index.
  void add_parameter_gradient(const Point& at, int index, Eigen::VectorXd& out) const override;
  /// At every time on the way the distance of a pair stays above a tenth of the clearance at the start: in the plane
  /// the distance of its node, or of an end of its edge, to the nearest edge (or ground); in space the smallest
  /// distance to anything in its way that one of the pair's nodes, or a triangle or edge at it, has. The limit is below
  /// 1 only where some pair comes down to two tenths of its own distance. 0 for steps that are not finite and from
  /// states that touch. Always 1 for the penalty.
  double step_limit(const Point& at, const Eigen::VectorXd& step) const override;

  std::unique_ptr<Term> between(std::array<int, 2> sides) const override;

  static constexpr int dimension = Settings::dimension;  ///< 2 or 3

  int side_of_obstacle(int number) const;  ///< of those in the settings
  int side_of_ground(int number) const;    ///< of those in the settings

  const Settings& settings() const;  ///< as they were given, the grounds' normals of unit length
  /// Pairs closer than dhat, sorted by their numbers. `brute_force` looks at all pairs (for tests).
  std::vector<Pair> active_pairs(const Point& at, bool brute_force = false) const;
  int vertices() const;  ///< of the surface, what is fixed included
  /// What presses on each vertex at this state, by vertex and then side; with how that changes where u and the
  /// parameters change by `du` and `dp`, if they are given.
  std::vector<Touch<dimension>> touches(const Point& at, const Eigen::VectorXd* du = nullptr,
                                        const Params* dp = nullptr) const;
  /// The places of a touch's vertex and feature, with the parameters that say how stiff contact is there.
  Meeting<dimension> meeting(int vertex, int feature, const Params& p) const;
  /// Smallest distance [m] between features that share no node, or a node and a ground (negative behind it), looked for
  /// up to `horizon`; +inf when nothing is nearer than that.
  double smallest_distance(const Eigen::VectorXd& u, double horizon) const;
  /// Whether edges meet (in space, an edge and a triangle) other than neighbours in their common nodes, a node lies on
  /// or behind a ground, or a facet cuts by more than half of its radius into a round one. Exact for the positions X +
  /// u as rounded, and independent of the distances; O(n log n). Obstacles may cross each other.
  bool intersects(const Eigen::VectorXd& u) const;
  /// The largest distance [m] from a pin at which boundaries of the two parts that it joins cross or come within
  /// `reach` [m] of each other at rest, by what a patch of that radius takes in. Negative when none do.
  double overlap_about(const typename decltype(Settings::patches)::value_type& pin, double reach) const;

 private:
  using Sides = std::array<int, 2>;
  class Between;
  template <class Action>
  void each_interaction(const Point& at, const Sides* between, Action&& action) const;
  void assemble(const Point& at, const Sides* between, Assembly& out) const;
  void add_parameter_gradient(const Point& at, int index, const Sides* between, Eigen::VectorXd& out) const;

  std::unique_ptr<const Surface> surface_;
};

}  // namespace taut
