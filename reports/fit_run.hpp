#pragma once
#include <atomic>
#include <functional>
#include <string>

#include "calib/runs/provenance.hpp"
#include "calib/runs/run_record.hpp"

namespace taut {

/// How a bench is fitted, who may end that, and who is told.
struct FitJob {
  Program program;
  /// Run folder: see RunFolder. "": none, nothing is written and an interrupted fit cannot be gone on with.
  std::string folder;
  bool variants = true;                     ///< the [[fit.variant]] too
  bool fresh = false;                       ///< not from where an interrupted run stopped
  const std::atomic<bool>* stop = nullptr;  ///< end soon, with what is finished
  std::function<void(const std::string&)> say = [](const std::string&) {};   ///< a line that stays
  std::function<void(const std::string&)> show = [](const std::string&) {};  ///< a line that the next one replaces
};

/// How a fit with its folder ended.
enum class FitEnd {
  kept,          ///< the record is what was found, and stands in the folder; of an interrupted run, as far as it came
  start_failed,  ///< the simulation failed at the start of the fit; what stands in the folder stays
  no_result,     ///< interrupted before there was a result; the same call goes on from there
  not_replacing  ///< interrupted; the finished run in the folder stays, and the same call goes on
};

/// A fit with all that follows.
struct FitRun {
  RunRecord record;
  FitEnd end = FitEnd::kept;
  size_t said = 0;             ///< how many of the record's remarks were said before the fit
  std::string report_failure;  ///< why there are no figures and no report; all else is written
};

/// The whole of `taut fit`: what stands in the bench is said, run_fit(), and its folder with fit.json, predictions.csv,
/// figures, report.html, states and copies of the inputs, which takes the old one's place as a whole. Throws InputError
/// for a folder that cannot be used and inputs that changed meanwhile.
FitRun fit_bench(Bench& bench, const FitJob& job);

}  // namespace taut
