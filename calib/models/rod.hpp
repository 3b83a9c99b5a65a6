#pragma once
#include <Eigen/Core>
#include <array>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "calib/benches/section_law.hpp"
#include "sim/shapes/axis.hpp"

namespace taut {

/// A point that moves with a section of a rod.
struct RodPoint {
  double s = 0;                                      ///< arc length of the section at rest [m]
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();  ///< from its centre, along its directions d1, d2, d3 [m]
};

/// A tendon that runs through eyelets all along the rod from its start, where it is pulled, to its end, where the rod
/// holds it.
struct RodTendon {
  double start = 0, end = 0;                        ///< arc lengths [m]
  std::function<Eigen::Vector2d(double s)> eyelet;  ///< offset along d1 and d2 [m], also a little beyond the ends
};

/// A dead force.
struct RodForce {
  RodPoint at;
  Eigen::Vector3d direction;  ///< unit length, in the rod's frame
};

/// A rod in its own frame: clamped at the origin, straight along z at rest, where d1, d2, d3 are x, y, z.
struct RodShape {
  double length = 0;                              ///< [m]
  std::function<CrossSection(double s)> section;  ///< about d1 and d2
  bool round = true;                              ///< a circle or a ring; else a rectangle with sides along d1 and d2
  SectionLaw law = SectionLaw::linear;
  double shear_factor = 0.9;  ///< kappa of a full circle, which that of a ring follows; 5/6 of a rectangle
  Eigen::Vector3d down = Eigen::Vector3d::Zero();  ///< unit length: where weight pulls; zero: nowhere
  std::vector<RodTendon> tendons;
  std::vector<RodForce> forces;
  std::vector<double> nodes = {};  ///< arc lengths from 0 to the length [m]; empty: 73, evenly
};

/// Positions [m] and rotations (unit quaternions w, x, y, z) of a rod's nodes, the clamped one first.
struct RodState {
  std::vector<Eigen::Vector3d> r;
  std::vector<Eigen::Vector4d> q;
  Eigen::VectorXd left = {};  ///< what friction leaves of the tension, per piece of tendon; empty: all of it
};

/// A point of a state [m], with derivatives by the six unknowns of the node before it and of the one after.
struct RodReading {
  Eigen::Vector3d value;
  int node = 0;  ///< the one before
  Eigen::Matrix<double, 3, 12> slopes;

  /// Its derivative where the unknowns change like columns of `dx`.
  Eigen::MatrixXd change(const Eigen::MatrixXd& dx) const {
    if (dx.cols() == 0) return Eigen::MatrixXd(3, 0);  // nothing is free; of no columns there are no rows either
    if (node == 0) return slopes.rightCols<6>() * dx.topRows<6>();  // the clamped node has none
    return slopes * dx.middleRows<12>(6 * (node - 1));
  }
};

/// What the fibres of a rod stretch by, at most.
struct RodStrains {
  double compression = 0;  ///< the largest 1 - stretch
  double size = 0;         ///< the largest |stretch - 1|
};

namespace rod {
class BlockFactors;
struct RodStretching;
}  // namespace rod

/// A tapered Cosserat rod in space: it stretches, shears, bends and twists. With d1, d2, d3 the directions of a
/// section,
///
///   v_i = d_i . r',   d_i' = k x d_i,   k = k_1 d1 + k_2 d2 + k_3 d3,
///   W = int [ kappa G A (v_1^2 + v_2^2)/2 + G J k_3^2/2 + w_s(v_3, k_1, k_2) ] ds,   G = E/(2 (1 + nu)),
///   linear:       w_s = E A (v_3 - 1)^2/2 + E I_1 k_1^2/2 + E I_2 k_2^2/2,
///   neo_hookean:  w_s = int w(v_3 + k_1 Y_2 - k_2 Y_1) dA,
///
/// w the energy of a fibre with free sides (fibre_energy()); both agree at small strains. Sections stay plane, and the
/// integral over a circle is a Gauss rule along the direction of bending (6 points, exact to degree 11), over a
/// rectangle one of 5 x 5 points. A tendon of tension T through the points c = (c_1, c_2, 0) of the sections stores
///
///   T int |v + k x c + c'| ds,
///
/// weight and dead forces what points of the sections that they act on move by.
///
/// Where tendons rub with a coefficient mu (capstan), the tension falls from where they are pulled,
///
///   T(s) = T_0 exp(-mu beta(s)),
///
/// beta the angle by which the tendon's path has turned until s: a sum over the angles between neighbouring elements.
/// All tensions grow from rest and every tendon slips towards its pull: this is the branch of loading; unloading,
/// sticking, and a tendon that others pull out are not in it. The equilibrium is that of the energy with these tensions
/// held, such that it leaves them as they are; derivatives are those of both together. With mu = 0 none of this is
/// computed.
///
/// Strains are constant along an element of length l between nodes with positions r and rotations R:
///
///   v = R_m^T (r_b - r_a)/l,   k = log(R_a^T R_b)/l,   R_m half way between R_a and R_b,
///
/// which is objective and of second order in l; sections and eyelets are those in the element's middle. Unknowns are
/// translations and turns behind R, R exp(turn). Derivatives are exact, the Hessian is block-tridiagonal. An element
/// whose ends turn by more than 150 degrees against each other is taken for a failure.
///
/// Not in it: contact, inertia, sections that warp or become oval.
///
/// Sources: J. C. Simo, A finite strain beam formulation, Comput. Methods Appl. Mech. Engrg. 49 (1985) 55-70; H. Lang,
/// J. Linn and M. Arnold, Multi-body dynamics simulation of geometrically exact Cosserat rods, Multibody Syst. Dyn. 25
/// (2011) 285-312, for rotations as quaternions and strains in the middle of elements; D. C. Rucker and R. J. Webster,
/// Statics and dynamics of continuum robots with general tendon routing, IEEE Trans. Robot. 27 (2011) 1033-1044, for
/// tendons; G. R. Cowper, The shear coefficient in Timoshenko's beam theory, J. Appl. Mech. 33 (1966) 335-340, for
/// kappa: 0.9 (1 + m^2)^2/((1 + m^2)^2 + 2.6 m^2) of a ring of radii m R and R is his at nu = 1/2.
class Rod {
 public:
  /// Throws InputError for a rod without length, nodes that do not ascend, or a section without area.
  explicit Rod(RodShape shape);

  /// What acts and resists, as one vector: E [Pa], nu, weight (density times gravity) [N/m3], tensions where tendons
  /// are pulled [N], forces [N], the tendons' friction [-].
  enum Value : Eigen::Index { youngs, poisson, weight, first_tension };
  using Values = Eigen::VectorXd;  ///< in that order
  /// The place of the first force among the values.
  Eigen::Index first_force() const { return first_tension + static_cast<Eigen::Index>(shape_.tendons.size()); }
  /// The place of the tendons' friction among the values.
  Eigen::Index friction() const { return first_force() + static_cast<Eigen::Index>(shape_.forces.size()); }
  /// How many values there are.
  Eigen::Index value_count() const { return friction() + 1; }
  Eigen::Index unknowns() const { return 6 * elements(); }  ///< six of each node but the clamped one

  int elements() const { return static_cast<int>(sections_.size()); }  ///< all along the rod
  const RodShape& shape() const { return shape_; }                     ///< as it was given
  RodState rest() const;                                               ///< straight, without strain

  /// Pi(x; values) [J] with the tensions that `x` has left, +inf where a fibre is crushed to nothing.
  double energy(const RodState& x, const Values& values) const;
  /// [N], [N m], with the tensions that friction leaves at this state.
  Eigen::VectorXd gradient(const RodState& x, const Values& values) const;
  /// d gradient / d values at a fixed equilibrium, a column each; that of the friction is empty unless asked for.
  Eigen::MatrixXd gradient_by_values(const RodState& x, const Values& values, bool by_friction = false) const;
  /// J^-1 B at an equilibrium, J the derivative of the gradient: the Hessian, and by how much friction leaves less
  /// tension where tendons turn more. Nothing where that is not stable with the tensions held.
  std::optional<Eigen::MatrixXd> solve_linear(const RodState& x, const Values& values, const Eigen::MatrixXd& B) const;

  /// Newton's method with a line search, from `x` on and with the tensions that it has left, in at most `iterations`.
  /// Returns what went wrong, "" for a minimum.
  std::string solve(RodState& x, const Values& values, int& factorisations, int iterations = 50) const;
  /// The equilibrium that is reached from rest as all that acts grows in proportion: at once where Newton's method
  /// finds it downhill from rest, else in smaller steps.
  std::string solve_from_rest(RodState& x, const Values& values, int& factorisations) const;

  /// Where a point is [m]; beyond the ends it moves with the last section.
  RodReading position(const RodState& x, const RodPoint& point) const;
  /// The turn of the last section from rest; the unknowns 4 to 6 of the last node are small turns behind it.
  Eigen::Matrix3d end_rotation(const RodState& x) const;
  RodStrains strains(const RodState& x) const;  ///< the largest of all elements
  /// exp(-mu beta) of each piece of tendon at this state: a tendon's pieces follow each other from its start.
  Eigen::VectorXd tension_left(const RodState& x, double friction) const;

 private:
  struct Sums;
  /// A share of a load that acts on a point of one node's section.
  struct Share {
    int node;
    Eigen::Vector3d arm, force;  ///< per unit of its value
    Eigen::Index value;
  };
  /// A tendon along an element.
  struct Piece {
    Eigen::Vector3d eyelet, slope;  ///< in the middle of its part of the element, and by the arc length
    double part;                    ///< of the element
    Eigen::Index value, index;      ///< its tension; its place among all pieces
  };
  /// In the middle of an element.
  struct Section {
    CrossSection of;
    double length;                           ///< of the element [m]
    double shear = 0;                        ///< kappa A [m2]
    double outer = 0, inner = 0;             ///< radii [m]
    double half_first = 0, half_second = 0;  ///< [m], along d1 and d2
    std::vector<Piece> pieces = {};
  };
  struct Place {
    int element;
    double fraction, length;  ///< of the element
  };
  Place place_of(double s) const;
  std::vector<Share> shares_of(const RodPoint& at, const Eigen::Vector3d& force, Eigen::Index value) const;
  std::array<Eigen::Vector3d, 2> arms_of(const RodPoint& at) const;
  void add_weight();
  enum Order { energies, slopes, curvatures };
  Sums assemble(const RodState& x, const Values& values, Order order, bool by_values = false) const;
  bool add_element(size_t i, const RodState& x, const Values& values, Order order, bool by_values, Sums& sum) const;
  rod::RodStretching stretching_of(const Section& section, const Eigen::Vector3d& by, double E, double nu,
                                   bool by_poisson) const;
  std::optional<rod::BlockFactors> factors_at(const RodState& x, const Values& values) const;
  RodState moved(const RodState& x, const Eigen::VectorXd& step, const Sums& at) const;
  struct Run;
  std::vector<Run> runs_of(const RodState& x) const;
  struct Turning;
  Turning turning_of(const std::vector<Run>& runs, const Eigen::MatrixXd& dx) const;
  struct Feedback;
  Feedback feedback_of(const RodState& x, const Values& values,
                       const std::function<Eigen::MatrixXd(Eigen::MatrixXd)>& by_hessian) const;
  Eigen::VectorXd gradient_by_friction(const RodState& x, const Values& values) const;
  Eigen::MatrixXd pulled(const std::vector<Run>& runs, const Values& values, const Eigen::MatrixXd& more) const;
  std::string settle(RodState& x, const Values& values, int& factorisations) const;

  RodShape shape_;
  std::vector<Section> sections_;
  std::vector<Share> shares_;
  Eigen::Index pieces_ = 0;
};

}  // namespace taut
