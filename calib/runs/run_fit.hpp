#pragma once
#include <atomic>
#include <functional>
#include <string>
#include <string_view>

#include "calib/runs/evaluation_log.hpp"
#include "calib/runs/run_record.hpp"

namespace taut {

/// What a run does.
struct RunOptions {
  bool variants = true;                     ///< the [[fit.variant]] too
  const std::atomic<bool>* stop = nullptr;  ///< end soon, with what is finished
  bool fit_alone = false;                   ///< nothing after the fit
};

/// What a run tells while it goes; nobody listens where nothing is set.
struct RunEvents {
  /// Who is told.
  template <class What>
  using Event = std::function<void(What)>;
  static constexpr auto unheard = [](const auto&) {};

  Event<const std::string&> say = unheard;      ///< a line that stays
  Event<const std::string&> show = unheard;     ///< a line that the next one replaces
  Event<std::string_view> begins = unheard;     ///< a stage
  Event<const RunRecord&> keep = unheard;       ///< the fit is finished, or a stage after it: write it down
  Event<const SolvedStates&> states = unheard;  ///< of the replay, for drawings in full
};

/// The record of a bench before anything is computed: title, set-up, readings with predictions NaN, references. Throws
/// InputError for references to parameters that are not there.
RunRecord start_record(const Bench& bench);

/// Puts a protocol's values beside the readings.
void fill_predictions(const Bench& bench, const Eigen::VectorXd& values, const Eigen::VectorXd& standard_errors,
                      RunRecord& record);

/// What would explain the misfit of a record's fit of readings at rest (explain_misfit()), and how the readings at each
/// value of a held control are predicted by those at the others (held_out()): from one prediction at the optimum with
/// the derivatives with respect to the controls too, had by `ask`. Throws InputError where that fails.
void explain(const Bench& bench, const Ask& ask, RunRecord& record);

/// The whole of `taut fit` on a bench: the fit, and once that is kept, stage by stage, a cold replay, curves, shapes,
/// what would explain the misfit, parts held out, the robust fit, shares of mesh and contact gap, parts of the readings
/// alone, variants. A stage that throws is a sentence among the record's remarks and costs itself alone. What the log
/// knows is not computed again. When the fit fails at its start (FitStatus::start_failed), nothing follows and nothing
/// is kept.
RunRecord run_fit(Bench& bench, RunRecord record, EvaluationLog& log, const RunOptions& options = {},
                  const RunEvents& events = {});

}  // namespace taut
