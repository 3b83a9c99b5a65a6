#pragma once
#include <memory>
#include <vector>

#include "calib/benches/static_replay.hpp"
#include "calib/fit/protocol.hpp"

namespace taut {

/// The cheapest rung of a model: a chain of rigid bodies in the plane, each with three unknowns, joined by spans of a
/// Timoshenko beam, in equilibrium under loads, own weight, cables and lips that meet. It takes
///
///   * a push_puppet: base plate (clamped), webs and tip plate are bodies, the foam of each cell is a span bonded to
///     two of them; the module's own cables run through their via points, lips press on each other at their end faces;
///   * a rectangle clamped on one side and loaded on the opposite one: six bodies without thickness, 24 where it is
///     over 20 times as long as high.
///
/// The clamp may give way (k_base): one body more, which springs hold.
///
/// Between two bodies that moved apart by e along the direction half way between theirs, by s across it, and turned by
/// k, a span of length L, height h and thickness t stores
///
///   t { h L w_m(1 + e/L) + L int [ w_b(1 + (e + k Y)/L) - w_b(1 + e/L) ] dY + s^2/2 / c }  [J],
///   c = L^3/(B h^3) + (1.2 - 0.2 beta) L/(mu h).
///
/// w is the neo-Hookean energy of a fibre. Far from a bonded end its sides move freely (modulus E', E or E/(1 - nu^2));
/// at the end they do not (modulus M, uniaxial strain; in plane stress E/(1 - nu^2)). In between Ritz's method with one
/// bulge (linear in Y for a force, quadratic for a moment) and one warping (Y^3 for shear) is a linear equation whose
/// solution decays from the ends: with n bonded ends
///
///   1/B = (1 - beta)/E' + beta/M,   beta = tanh(q)/q,   q = a L/(n h),
///   a^2 = 12 E'/mu for a force, 60 E'/mu for a moment, 140 mu/M for shear,
///
/// and w_m, w_b mix the energies of both kinds of fibre to have these moduli at rest. Without bonded ends this is the
/// plain beam: F L^3/(3 E' I) + F L/(5/6 G A) at the tip of a cantilever. The turning of bodies is exact, so what
/// tension and compression do to the stiffness across is in it. Hessians are exact; derivatives are those of the
/// implicit function theorem.
///
/// The reference module's bench, 16 rows, takes 146 factorisations of 12 x 12 matrices: 0.3 to 0.6 ms a row.
///
/// Not in it: webs and lips that bend (lips press on each other as bars of their own length), contact between foam and
/// lips or webs, friction. Parameters are those of the full model, by the same ids and in the same places; some have no
/// effect.
class BeamProtocol final : public Protocol {
 public:
  struct Chain;
  explicit BeamProtocol(std::unique_ptr<const Chain> chain);  ///< see make_beam_bench(), which makes the chain
  ~BeamProtocol() override;
  const ParameterTable& parameters() const override;
  const Params& nominal() const override;
  int row_count() const override;
  Prediction predict(const Params& p, const std::vector<int>& free) override;
  int factorisations() const override { return factorisations_; }

  /// Bound on the relative error of a row's value of the last prediction, against fine finite elements with the same
  /// parameters; +inf where the model does not hold, NaN for a row that failed. Found by comparison, with the largest
  /// mean compression c of a span:
  ///
  ///   push_puppet:  0.02 + 0.04 (M/E' - 1) + (0.15 + (L/h)^2/2) c + 2 max(0, c - 1/4) + 150 E_foam/E_plastic,
  ///
  /// for L/h from 0.2 to 1 and nu up to 0.45 (in the reference module, open, the error is 1 to 2 %); compression eats
  /// up the stiffness of slender spans, and beyond a quarter foam folds onto webs and lips. +inf when both lips of a
  /// cell are closed. Rectangle, L/h at least 1, nu up to 0.45, whose end turned by theta: 0.01 + 0.15 (h/L) theta^2.
  double stated_error(int row) const { return errors_[static_cast<size_t>(row)]; }
  /// Three per body: 12 in the reference module.
  int unknowns() const;

 private:
  std::unique_ptr<const Chain> chain_;
  std::vector<double> errors_;
  int factorisations_ = 0;
};

/// A bench's readings as rows of the beam model: see StaticReplay.
struct BeamBench {
  std::unique_ptr<BeamProtocol> protocol;
  std::vector<int> row_of_reading;
  std::vector<Measurement> measurements;
};

/// Throws InputError, one sentence that says what the beam model takes, for everything else: other geometries and
/// laws, recordings, other supports, loads and channels.
BeamBench make_beam_bench(const Experiment& experiment, const Trials& trials);

/// Free parameters with starts from a fit of the beam model, where that describes the experiment and determines them: a
/// search with a dearer model then begins near its end. Each reading counts with its own sigma and the error that the
/// model states at the given starts; rows beyond its validity do not count.
std::vector<FreeParameter> start_by_beams(const Experiment& experiment, const Trials& trials,
                                          std::vector<FreeParameter> free);

}  // namespace taut
