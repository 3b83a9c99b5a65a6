#pragma once
#include <Eigen/Core>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "calib/benches/static_replay.hpp"
#include "calib/fit/gauss_newton.hpp"

namespace taut {

/// The quadratic elements that an experiment's results tend to fastest on the mesh `settings`: locking-free ones where
/// a Poisson's ratio exceeds 0.4 and volumes are held (3D, plane strain), or where `settings` has them.
MeshSettings most_accurate(const Experiment& experiment, const MeshSettings& settings);

/// Mean edge of an element over the specimen's size.
double element_size(const Mesh& mesh);

/// What values on successively finer meshes tend to: Richardson's extrapolation and a grid convergence index
/// (Celik et al., J. Fluids Eng. 130, 2008).
struct Extrapolation {
  Eigen::VectorXd limit;  ///< one per quantity; the finest value where they do not converge monotonically
  Eigen::VectorXd error;  ///< of `limit`, one per quantity; NaN from a single mesh
  double order = 0;       ///< in h, one for all quantities: measured from three meshes, else 1
  bool measured = false;  ///< from three meshes with differences that shrink in the same direction
};

/// `values`: quantities x meshes, from coarse to fine, in units in which all quantities count alike; `h` their element
/// sizes. With v = limit + c h^p on the finest three, order p from the differences of all quantities taken together,
/// at most highest_order; error 1.25 |limit - v_finest|. From two meshes p = 1, the order beside a sharp corner between
/// unlike materials, so that the error covers higher ones. Where differences grow, turn by 60 degrees or more, or
/// shrink more slowly than with p = 0.5, no extrapolation and 3 times the last difference as error.
Extrapolation extrapolate(const std::vector<double>& h, const Eigen::MatrixXd& values, double highest_order);

/// How much of each fitted parameter is a matter of something that is not noise: how the specimen was cut into
/// elements, a plane model, a number that was taken for granted.
struct Share {
  std::string source;         ///< "mesh", "contact gap", "plane section", "gap_total", "scale of mass"
  std::vector<double> bias;   ///< per free parameter, SI: as fitted, less what it would be without; NaN: not known
  std::vector<double> error;  ///< of the bias, SI
  std::string how;            ///< one sentence: from which meshes or tolerance, or why it is not known
  double seconds = 0;
  bool counted = true;  ///< in the total; not: nobody knows the tolerance, `error` is what 1 % would do
  /// Of one number that was taken for granted: how each parameter moves when it is too large by its tolerance, SI,
  /// `error` with a sign. Empty: errors of several origins, whose signs have nothing to do with each other.
  std::vector<double> moves = {};
};

/// "the mesh makes it 0.4 kPa too large, +- 0.2 kPa", "gap_total adds +- 0.2 kPa": the share's part in its j-th
/// parameter, `estimate`.
std::string describe(const Share& share, const ParameterEstimate& estimate, size_t j);

/// The shares of mesh, contact gap and rigid segments in a fit of readings at rest. Models that are refined predict all
/// readings at the optimum, with derivatives, and gauss_newton_step() from there, less that of the fit's own model,
/// tells where their fit would end; nothing is fitted again.
///
/// Mesh: the finest three of most_accurate() meshes with sizes r^-2 ... r^2 times the fit's own, r = 2 in 2D and 1.45
/// in 3D, that have at most 150 000 unknowns in 2D and 40 000 in 3D; then extrapolate() with orders up to 2, what
/// clamped corners leave of quadratic elements' 4. Contact gap: half of it, then linearly to none, with half of the
/// bias as error (the stand-off of closed faces is proportional to the gap). Rigid segments: the same with segments
/// that deform; a third of the bias is its error.
///
/// `fit` has a result (a covariance); `experiment` and `trials` are those it was made with. A failed simulation makes
/// the share unknown. `progress` is told what comes next; `ask`, where it is given, is how predictions are had.
std::vector<Share> discretisation_shares(const Experiment& experiment, const Trials& trials, const FitResult& fit,
                                         const std::function<void(const std::string&)>& progress = {},
                                         const Ask& ask = {});

/// The share of having taken a solid for a plane section: one Gauss-Newton step with a coarse solid of the section's
/// thickness, less that with the same coarse section; a third of the bias is its error. Nothing for a
/// thickness that is fitted, and where deepened() or as_solid() has no solid. Arguments as above.
std::optional<Share> section_share(const Experiment& experiment, const Trials& trials, const FitResult& fit,
                                   const std::function<void(const std::string&)>& progress = {}, const Ask& ask = {});

}  // namespace taut
