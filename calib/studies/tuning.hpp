#pragma once
#include <Eigen/Core>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "calib/benches/bench.hpp"
#include "calib/studies/discretisation.hpp"

// Which retraction gives a wanted stiffness, by a fitted model: the inverse of a replay, and the map of all of them.
namespace taut {

/// 95 % half widths of a quantity whose gradient by the fitted parameters is g (on the fitted scale: by the logarithm
/// of logarithmic ones), first order: 1.96 sqrt(g^T C g) of the noise, with the covariance C of the fit; in all the
/// root of the squares of that and, for each share that counts, |g . bias| + |g . moves|; where it has no Share::moves,
/// sum_j |g_j| error_j instead, its errors being taken to add up at their worst.
struct HalfWidths {
  double noise = 0, shares = 0, total = 0;  ///< in the unit of the quantity
};
/// |g . bias| + sum_j |g_j| error_j of one share; NaN where it is not known.
double part_of(const Share& share, const FitResult& fit, const Eigen::VectorXd& gradient);
/// See HalfWidths. Shares that are not known (NaN) are left out.
HalfWidths half_widths(const FitResult& fit, const std::vector<Share>& shares, const Eigen::VectorXd& gradient);

/// A state of the specimen at some controls, as the bench's protocol comes to it.
struct TunedState {
  std::vector<double> controls;      ///< SI, in the order of Bench::controls()
  double stiffness = not_a_number;   ///< tangent stiffness along the load [N/m]; NaN: no equilibrium was found
  bool touching = false;             ///< as TangentStiffness::touching
  bool slipped = false;              ///< as TangentStiffness::slipped
  std::vector<double> readings;      ///< of each channel of the bench, SI
  Eigen::MatrixXd reading_slopes{};  ///< channels x fitted parameters, on the fitted scale; empty: not asked for
};

/// Replays a fitted bench at controls of one's own. The load along which stiffness is meant is a force or a mass that
/// the readings set.
class StiffnessReplay {
 public:
  /// Throws InputError where there is no tangent stiffness: readings that are no equilibria under loads, several
  /// specimens, cheaper models than the full one, a load that is none. `bench`, `fit` outlive it.
  StiffnessReplay(const Bench& bench, const FitResult& fit, size_t load);

  const Bench& bench() const { return bench_; }  ///< as it was given
  const FitResult& fit() const { return fit_; }  ///< as it was given
  size_t load() const { return load_; }          ///< its position among Bench::controls()

  /// The states at the fitted parameters, from rest along the protocol's path.
  std::vector<TunedState> at(const std::vector<std::vector<double>>& controls, bool with_slopes = false) const;
  /// Derivatives of their stiffness by the fitted parameters, on the fitted scale [N/m]: central differences of replays
  /// at +- 1e-3 of what each one's changes are relative to (scale_of()). Shape (states, fitted parameters).
  Eigen::MatrixXd stiffness_slopes(const std::vector<std::vector<double>>& controls) const;
  /// The states, with the bench whose last prediction they are, for those who ask more of it.
  struct Solved {
    std::unique_ptr<Bench> bench;
    std::vector<TunedState> states;
  };
  Solved solved(const std::vector<std::vector<double>>& controls) const;  ///< see Solved
  Params fitted(const Protocol& protocol) const;  ///< all parameters, the fitted ones at their values

  const std::vector<std::string>& failures() const { return failures_; }  ///< of all replays so far

 private:
  std::unique_ptr<Bench> at_rows(const std::vector<std::vector<double>>& controls) const;
  std::vector<TunedState> read(const Bench& there, const Params& p, bool with_slopes) const;

  const Bench& bench_;
  const FitResult& fit_;
  size_t load_;
  mutable std::vector<std::string> failures_;
};

/// What is sought: the values of one control in [lower, upper] at which the tangent stiffness is the wanted one.
struct TuneQuestion {
  double stiffness = 0;          ///< [N/m]
  size_t control = 0;            ///< position of what is sought among Bench::controls()
  std::vector<double> controls;  ///< of all others, SI; the load's is the one at which the stiffness is meant
  double lower = 0, upper = 0;   ///< SI
};

/// A value of the control that gives the wanted stiffness.
struct TunedControl {
  double value = 0;                                ///< SI
  double slope = 0;                                ///< dk/dvalue [N/m per SI unit of the control]
  HalfWidths half{};                               ///< of `value`, SI: those of k over |dk/dvalue|
  std::optional<double> lower95{}, upper95{};      ///< in all; empty: beyond the range that was looked at
  TunedState state{};                              ///< there
  std::vector<double> reading_half95{};            ///< of its readings, in all, at that value of the control, SI
  double settable = 0;                             ///< the value as one would set it, of four digits
  double replayed = 0;                             ///< stiffness of a replay of its own there [N/m]
  bool two_equilibria = false, near_jump = false;  ///< Alternative, of that replay
};

/// What was found.
struct Tuned {
  std::vector<TunedControl> solutions;  ///< all, ascending
  std::vector<TunedState> scan;         ///< where it was looked, ascending; those without an equilibrium are left out
  /// Where the stiffness passes the wanted one in a jump, or so steeply that a value of four digits misses it by over
  /// 10 %: the states a thousandth of the range before and after.
  std::vector<std::pair<TunedState, TunedState>> jumps;
  /// Ranges of stiffness that are reachable [N/m]; more than one where the stiffness jumps over what is between.
  std::vector<std::pair<double, double>> reachable;
};

/// Scans [lower, upper] in 24 even steps and where three of them have an extremum between, then narrows each change of
/// sign of ln(k / wanted) by regula falsi (Illinois), until |ln| < 1e-6, or a step of 1e-9 of the range is left: a
/// jump. Solutions closer together than a step, and pairs around an extremum that a parabola through three states does
/// not show, can be missed. Throws InputError when no state of the scan has an equilibrium.
Tuned tune(const StiffnessReplay& replay, const std::vector<Share>& shares, const TuneQuestion& question,
           const std::function<void(const std::string&)>& progress = {});

/// Stiffness over a control and a load. Between nodes ln k is interpolated bilinearly.
struct StiffnessMap {
  /// What is known at a node.
  struct Node {
    TunedState state{};
    HalfWidths half{};  ///< of the stiffness [N/m]
  };
  /// Between nodes: what the map says there, and what a replay does.
  struct Check {
    double control = 0, load = 0;           ///< SI
    double interpolated = 0, replayed = 0;  ///< [N/m]
    bool mixed = false;                     ///< surfaces touch at some of the nodes around and not at others
    double error() const { return std::abs(interpolated / replayed - 1); }  ///< relative
  };
  size_t control = 0, load = 0;         ///< positions among Bench::controls()
  std::vector<double> controls, loads;  ///< of the nodes, ascending, SI
  std::vector<Node> nodes;              ///< nodes[i * loads.size() + j] at controls[i], loads[j]
  std::vector<Check> checks;            ///< in the middle of each edge and each cell
  /// At controls[i], loads[j].
  const Node& node(size_t i, size_t j) const { return nodes[i * loads.size() + j]; }
  /// What the map says [N/m]; NaN outside it, and where a corner has no equilibrium.
  double at(double control, double load) const;
  /// The check with the largest error, of those where closing runs between the nodes around, or of the others; null:
  /// there is none.
  const Check* worst(bool mixed) const;
  double rms_error(bool mixed) const;  ///< root of the mean square of their relative errors; NaN: there is none
  bool mixed_at(double control, double load) const;  ///< as Check::mixed
};

/// How fine a map is.
struct MapOptions {
  size_t controls = 9, loads = 6;  ///< nodes at first
  size_t most_controls = 41;       ///< where steps are halved
  double tolerance = 0.03;         ///< relative error of a check beyond which they are
};

/// The map over [question.lower, question.upper] and [0, largest_load], other controls as question.controls has them.
/// Steps of the control are halved where a check is off by more than the tolerance, the worst ones first.
StiffnessMap stiffness_map(const StiffnessReplay& replay, const std::vector<Share>& shares,
                           const TuneQuestion& question, double largest_load, const MapOptions& options = {},
                           const std::function<void(const std::string&)>& progress = {});

}  // namespace taut
