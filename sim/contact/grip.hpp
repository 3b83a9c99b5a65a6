#pragma once
#include <Eigen/Core>
#include <array>
#include <vector>

#include "sim/contact/contact.hpp"
#include "sim/mesh/mesh.hpp"
#include "sim/model/term.hpp"

namespace taut {

/// Friction without limit in the plane: what touches at the state `held` cannot slide from there. One elastic spring
/// along the surface for each node i that is nearer than dhat to an edge from a to b that it is in front of, or to a
/// ground,
///
///   E = 1/2 sum k g^2  [J],   g = (tau - tau_0) |e|  [m],   tau = (x_i - x_a) . e / (e . e),   e = x_b - x_a,
///   k = stiffness kappa l_i t / dhat  [N/m],
///
/// tau_0 that of `held`, l_i half of the boundary's rest length at the node, t the thickness, kappa the smaller
/// pressure of both sides (in the pair sums k = stiffness kappa). g turns and stretches with the edge, so that rigid
/// motions cost nothing; across the surface there is contact alone, and nothing sticks there. Nothing slips for good,
/// so that states do not depend on how often they are solved. What is in equilibrium at `held` without it is with it,
/// too.
///
/// Where contact opens the springs have to go: drop_open(). They are energies of closed contact only.
///
/// `stiffness` [-] is that along the surface over about that across it; points slide by about dhat / stiffness times
/// the ratio of shear to kappa, so that 10 is plenty where dhat is far below what loads move. Pressures, dhat and
/// thickness are those of `held`: the term depends on no parameter. A node is in front of an edge where it is not
/// farther beyond its end than from its line. Points of obstacles against edges of the body are not held; the nodes
/// beside them are. After the elastic spring with return mapping (Wriggers, Computational Contact Mechanics, 2006),
/// which never returns here.
class Grip final : public Term {
 public:
  /// `contact` is of `mesh`.
  Grip(const Mesh& mesh, const Contact& contact, const Point& held, double stiffness = 10);

  Cliques cliques() const override;
  void assemble(const Point& at, Assembly& out) const override;
  bool depends_on(int) const override { return false; }
  void add_parameter_gradient(const Point&, int, Eigen::VectorXd&) const override {}

  int count() const { return static_cast<int>(pairs_.size()); }  ///< of springs
  /// Lets go of pairs that are dhat apart, or more, at this state.
  void drop_open(const Eigen::VectorXd& u);
  /// Holds what touches at this state and is not held yet, too.
  void add_touching(const Mesh& mesh, const Contact& contact, const Point& held);

 private:
  /// A node and the ends of the edge that it touches, or of a piece of what is fixed.
  struct Held {
    std::array<int, 3> node;        ///< of the mesh; -1: fixed in space
    int edge = 0;                   ///< as ContactPair has it
    Eigen::Matrix<double, 2, 3> X;  ///< at rest [m]
    double parameter = 0;           ///< tau_0
    double side = 1;                ///< on which side of the edge's line the node is
    double stiffness = 0;           ///< k [N/m]

    Eigen::Matrix<double, 2, 3> places(const Eigen::VectorXd& u) const;
    std::vector<int> moving() const;
  };
  std::vector<Held> pairs_;
  double stiffness_, gap_ = 0;
};

}  // namespace taut
