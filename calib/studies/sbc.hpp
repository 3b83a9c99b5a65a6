#pragma once
#include <optional>
#include <string>
#include <vector>

#include "calib/benches/bench.hpp"
#include "calib/studies/study_store.hpp"

// Simulation-based calibration: is the posterior that taut samples the right one? (Talts, Betancourt, Simpson, Vehtari
// and Gelman, 2018)
namespace taut {

/// A bench whose truth was drawn from the prior and whose readings were simulated, sampled.
struct SbcResult {
  std::string status;         ///< "ok", or why there are no ranks
  std::vector<double> ranks;  ///< per free parameter: share of the posterior's weight below the truth
  double effective = 0;       ///< number of draws
};

/// What the ranks of one parameter say.
struct SbcVerdict {
  std::string id;
  int count = 0;        ///< of ranks
  double distance = 0;  ///< largest between them and the uniform distribution (Kolmogorov and Smirnov)
  double p = 1;         ///< probability of more, where the posterior is right
};

/// Draws truths evenly between the bounds of the bench's free parameters (of moduli and stiffnesses evenly in their
/// logarithm), simulates its readings with their noise, fits them and makes `draws` draws from the posterior, `count`
/// times. Where truth and posterior have the same prior, ranks are uniform. Throws InputError for parameters without
/// two bounds.
std::vector<std::optional<SbcResult>> run_sbc(const Bench& bench, unsigned count, unsigned draws,
                                              const StudyOptions& options);

/// One verdict for each free parameter of the bench.
std::vector<SbcVerdict> judge_sbc(const Bench& bench, const std::vector<std::optional<SbcResult>>& results);

}  // namespace taut
