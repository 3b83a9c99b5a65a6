#pragma once
#include <Eigen/Core>
#include <array>
#include <string>
#include <vector>

#include "calib/models/beam_model.hpp"

namespace taut {

/// A point that moves with a body.
struct BodyPoint {
  int body = -1;         ///< -1: fixed in space
  Eigen::Vector2d rest;  ///< [m]
};

/// The foam between two bodies.
struct ChainSpan {
  BodyPoint left, right;          ///< middles of the faces that it joins
  double length = 0, height = 0;  ///< [m]
  int bonded = 0;                 ///< ends that are bonded to a body as wide as the span
};

/// A cable as straight pieces between bodies.
struct ChainCable {
  std::vector<std::array<BodyPoint, 2>> free_lengths;  ///< pieces between points of different bodies
  int retraction = -1;
  double smoothing = 0;  ///< [m], see CableLaw
};

/// A corner of a left lip's end face above the end face of a right lip.
struct LipCorner {
  int cell = 0, side = 0;
  BodyPoint corner, face;
};

/// A dead force: direction times a product of parameters.
struct ChainLoad {
  BodyPoint at;
  Eigen::Vector2d direction;
  std::vector<int> factors;  ///< table indices
  double scale = 1;          ///< of the product
};

/// A displacement along a direction.
struct ChainChannel {
  BodyPoint at;
  Eigen::Vector2d direction;
};

/// Energy with derivatives with respect to the unknowns, and of the gradient with respect to parameters.
struct ChainEnergy {
  double energy = 0;         ///< [J]
  Eigen::VectorXd gradient;  ///< [N], [N m]
  Eigen::MatrixXd hessian;
  Eigen::MatrixXd mixed;  ///< a column for each free parameter
};

/// Bodies, what joins them, and what they carry; see BeamProtocol for the energies.
struct BeamProtocol::Chain {
  ParameterTable table;
  Params nominal;
  std::vector<StaticRow> rows;
  std::vector<int> controls, set_first;  ///< table indices; positions among them
  std::vector<int> off_at_rest;          ///< table indices of constants that the rest shape knows nothing of
  bool from_unloaded = false;

  int bodies = 0;
  double base =
      0;  ///< stiffness [N/m] against translation of the first body, a face that k_base turns; 0: there is none
  std::vector<Eigen::Vector2d> centres;  ///< what bodies turn about, at rest
  std::vector<ChainSpan> spans;
  std::vector<ChainCable> cables;
  std::vector<LipCorner> lips;
  std::vector<ChainLoad> loads;
  std::vector<ChainChannel> channels;
  bool plane_stress = false;
  double lip_shape = 0;  ///< stiffness of one corner of a lip over (E_plastic thickness)
  int E = -1, nu = -1, thickness = -1, E_plastic = -1, k_cable = -1, slack = -1, k_base = -1;

  /// Table index of a parameter; -1: there is none of that name.
  int index(const std::string& id) const { return table.contains(id) ? table.index(id) : -1; }
  double energy(const Eigen::VectorXd& x, const Params& p) const;  ///< Pi(x; p) [J]
  /// With derivatives; `free`: table indices of the parameters of `mixed`.
  ChainEnergy assemble(const Eigen::VectorXd& x, const Params& p, const std::vector<int>& free) const;
  /// A step along which spans deform as `step` says to first order, and whatever they carry turns with them: no thin
  /// span is stretched by the turning of its neighbours.
  Eigen::VectorXd moved(const Eigen::VectorXd& x, const Eigen::VectorXd& step) const;
  /// Newton's method with a line search, from `x` on. Returns what went wrong, "" for a minimum.
  std::string solve(Eigen::VectorXd& x, const Params& p, int& factorisations) const;
  /// From the equilibrium at `from` to the one at `to`; where that fails, by smaller changes.
  std::string solve_in_steps(Eigen::VectorXd& x, const Params& from, const Params& to, int& factorisations) const;
  /// See BeamProtocol::stated_error().
  double stated_error(const Eigen::VectorXd& x, const Params& p) const;
  /// A channel's reading [m], and its derivatives with respect to the unknowns of the channel's body.
  std::pair<double, Eigen::RowVector3d> read(size_t channel, const Eigen::VectorXd& x) const;
};

}  // namespace taut
