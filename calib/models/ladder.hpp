#pragma once
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "calib/benches/static_replay.hpp"
#include "sim/core/numbers.hpp"

namespace taut {

/// One experiment whose rows come from several models, the dearer ones only where they are needed. Its parameters are
/// those of the full model; what a model does not have changes nothing there.
class LadderProtocol final : public Protocol {
 public:
  /// A model and the rows that it predicts.
  struct Part {
    Rung rung = Rung::full;
    std::unique_ptr<Protocol> protocol;
    std::vector<int> rows;  ///< of this protocol, per row of the part's
    /// `protocol` where it looks for no contact because no gap closed when it was made; else null.
    const StaticProtocol* idle = nullptr;
    StaticReplay watch;  ///< then the same with contact: takes its place as soon as a gap closes
  };
  /// `parameters` and `nominal` are the full model's; each row is in one part.
  LadderProtocol(ParameterTable parameters, Params nominal, int rows, std::vector<Part> parts)
      : parameters_(std::move(parameters)), nominal_(std::move(nominal)), rows_(rows), parts_(std::move(parts)) {}

  const ParameterTable& parameters() const override { return parameters_; }
  const Params& nominal() const override { return nominal_; }
  int row_count() const override { return rows_; }
  Prediction predict(const Params& p, const std::vector<int>& free) override;
  void forget() override {
    for (Part& part : parts_) part.protocol->forget();
  }
  void begin_search() override;
  void end_search() override;
  int factorisations() const override;
  /// Parts that look for no contact at present.
  int idle_parts() const;

 private:
  ParameterTable parameters_;
  Params nominal_;
  int rows_;
  std::vector<Part> parts_;
  bool searching_ = false;
  int factorisations_before_ = 0;  ///< by protocols that others took the place of
};

/// What a rung took to predict the rows that it was asked for, at the values that the file gives.
struct RungTrial {
  Rung rung = Rung::full;
  std::string cannot;  ///< why it does not describe the experiment; "": it does
  int rows = 0;
  int unknowns = 0, factorisations = 0;
  double seconds = 0;
};

/// Which rung a row comes from, and why.
struct RowChoice {
  Rung rung = Rung::full;
  /// Relative change of the row's value by the next rung: computed where that was tried, else stated (beam) or
  /// estimated (rigid segments, plane section); 0 where no rung is above; NaN: not known.
  double change = not_a_number;
  double compliance = 0;  ///< the stiff regions' part of that: relative change of the row from rigid to as they are
  bool closed = false;    ///< gaps are closed there: contact acts
};

/// What a climb came to.
struct Ladder {
  std::vector<RungTrial> trials;
  std::vector<RowChoice> rows;  ///< as the full model's protocol has them
  std::unique_ptr<LadderProtocol> protocol;
  double seconds = 0;         ///< of the climb
  double replay_seconds = 0;  ///< of one cold replay of `protocol`
  std::string sentence;       ///< what was chosen, why, and what it saves, for people
};

/// Climbs the rungs of an experiment at rest until the next one changes no row by more than experiment.tolerance, at
/// the values that its file gives. Rows of one path (one retraction) share a rung, the highest that any of them needs;
/// where no gap closes on a path, no contact is looked for, and every state is tested for that.
///
///   beam            accepted where its stated error is within the tolerance, or the next rung says so
///   rigid_segments  accepted where one Newton step of the full model from its equilibrium, du = -H^-1 grad Pi, changes
///                   the row by no more than half the tolerance. To first order that is -dy/d ln E of the stiff
///                   regions (y = y_rigid + c/E): the sensitivity that says whether their modulus matters
///   full            the file's own model; of a plane section accepted where plane stress and plane strain, between
///                   which the truth lies, differ by no more than the tolerance, or where a solid on a coarse mesh
///                   changes the row of the lightest load of its path by no more
///   solid           taken where that changes more, unless it has over 30 000 unknowns (the coarse one over 20 000);
///                   then the sentence says so
///
/// `full` is the full model's bench. Throws InputError as the benches do.
Ladder climb(const Experiment& experiment, const Trials& trials, const StaticReplay& full);

}  // namespace taut
