#pragma once
#include <memory>
#include <vector>

#include "calib/benches/assumptions.hpp"
#include "calib/benches/static_replay.hpp"
#include "calib/fit/protocol.hpp"
#include "sim/mesh/mesh.hpp"

namespace taut {

/// A cheap rung for long bodies in space: the body as one Cosserat rod (see Rod) of about 72 elements, clamped at the
/// start of its axis, under own weight, loads and cables whose tensions are held. It takes
///
///   * a geometry with a round or rectangular section along a straight axis (revolved, box) in any pose, of one
///   material;
///   * forces and hung masses on the end face or at a point, which move with the section there;
///   * cables along the axis with held tensions, as if they had eyelets everywhere, where they may rub;
///   * displacements and positions of markers, of points and of the middle of the end face, and that face's rotation.
///
/// The section's law is experiment.rod_section: neo_hookean (of a neo_hookean material) or linear.
///
/// Each distinct set of controls is an equilibrium that is reached from rest, all that acts growing in proportion.
/// Derivatives are those of the implicit function theorem. Parameters are those of the full model, by the same ids and
/// in the same places; behind them come dimensions, if any are given. In these, derivatives of the energy's gradient
/// and of readings are central differences, at the equilibrium: dx = -H^-1 dg.
class RodProtocol final : public Protocol {
 public:
  struct Bench;
  explicit RodProtocol(std::unique_ptr<Bench> bench);  ///< see make_rod_bench(), which makes it
  ~RodProtocol() override;
  const ParameterTable& parameters() const override;
  const Params& nominal() const override;
  int row_count() const override;
  Prediction predict(const Params& p, const std::vector<int>& free) override;
  int factorisations() const override { return factorisations_; }

  /// Bound on the error of a row's value of the last prediction, relative to how far its point has moved from rest (of
  /// a rotation: to itself), against finite elements with the same parameters; +inf where the model does not hold, NaN
  /// for a row that failed. With R the largest distance from the axis, L the length, e the largest strain of a fibre
  /// and c the largest compression:
  ///
  ///   0.01 + 2 (R/L)^2 + 3/2 e^2; +inf for L < 5 R or c > 1/2.
  ///
  /// Found by comparison of neo_hookean sections: bars in bending and torsion, and a tapered arm that tendons curl past
  /// 90 degrees. In finite elements these cut into it, the more the finer the mesh: e^2 is mostly that. What the law of
  /// linear sections makes different is not in it (see law_share()).
  double stated_error(int row) const { return errors_[static_cast<size_t>(row)]; }
  /// How far the point of a row has moved from rest in the last prediction [m] (of a rotation: turned [rad]), with the
  /// sign of that part of it which the row reads.
  double moved(int row) const { return moved_[static_cast<size_t>(row)]; }
  /// Displacements of a mesh of the body [m] at these controls, as the last prediction has them: sections stay plane.
  /// Empty: it had none such.
  Eigen::VectorXd displacements(const Mesh& mesh, const std::vector<double>& controls) const;
  int elements() const;  ///< all along the rod
  int unknowns() const;  ///< six per element

 private:
  void move_to(const Eigen::VectorXd& dimensions);

  std::unique_ptr<Bench> bench_;
  std::vector<double> errors_, moved_;
  int factorisations_ = 0;
};

/// A bench's readings as rows of a rod: see StaticReplay.
struct RodBench : BenchRows {
  std::unique_ptr<RodProtocol> protocol;
};

/// Dimensions become parameters behind those of the model. Throws InputError, one sentence that says what a rod takes,
/// for everything else: other geometries and laws, recordings, other supports, loads, cables and channels.
RodBench make_rod_bench(const Experiment& experiment, const Trials& trials,
                        const std::vector<Dimension>& dimensions = {});

}  // namespace taut
