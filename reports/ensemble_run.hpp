#pragma once
#include <string>

#include "calib/runs/run_record.hpp"
#include "calib/studies/ensemble.hpp"

namespace taut {

/// What stands of an ensemble in its run folder, ensembles/KIND.csv and what other processes wrote beside it, and in
/// the run's record.
struct EnsembleRun {
  EnsembleRecord record;  ///< of all members that are there
  int missing = 0;        ///< members that are not
};

/// Makes what is missing of an ensemble of the run in `folder`, whose record and bench these are. `options` have no
/// file and no fingerprint of their own: the store stands in the folder, and counts as long as the run's inputs and its
/// optimum are the same. Where no member is missing, and this is the process that sums up, they become part of the
/// record, of fit.json, report and figures, and the table KIND.csv. Throws InputError as run_ensemble() does and for
/// a folder that cannot be written.
EnsembleRun run_ensemble_of(RunRecord& record, const Bench& bench, const EnsembleTask& task, StudyOptions options,
                            const std::string& folder);

}  // namespace taut
