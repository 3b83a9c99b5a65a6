#pragma once
#include <array>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "calib/benches/experiment.hpp"
#include "calib/fit/fit.hpp"
#include "calib/studies/study_store.hpp"

namespace taut {

/// A bench whose truth is known: a push-puppet module that was drawn at random, with readings that a finer mesh made.
struct PlantedBench {
  Experiment experiment;                  ///< as its owner would describe it: nominal dimensions, stated tolerances
  Experiment truth;                       ///< what the readings were made with
  Trials trials;                          ///< with noise
  std::map<std::string, double> planted;  ///< by parameter, SI
};

/// The `number`-th module about a base (its channels, noise and contact settings stay): 2 to 6 cells; dimensions by up
/// to 25 %; foam of 20 to 200 kPa and nu up to 0.3, cables of 3 to 40 N/mm with up to 0.6 mm of slack; four retractions
/// from none to a few per cent beyond what closes the lips; four masses of which the largest moves the slack module's
/// tip by 2 to 30 % of its length; three trials. `off`: the true dimensions, constants and scales differ from those
/// that the experiment says by normal deviates of half of their tolerances; else by nothing. The readings' mesh has
/// elements of 0.6 times the size. The same number makes the same bench on all machines with the same standard library.
/// Throws InputError for a base of another kind.
PlantedBench plant(const Experiment& base, unsigned number, bool off);

/// What the fits of one planted bench came to.
struct PlantedResult {
  int cells = 0, unknowns = 0;
  double largest = 0;                 ///< tip displacement over length
  std::array<std::string, 2> status;  ///< of the fits from a soft and from a stiff start, dimensions exact
  double apart = 0;                   ///< of their E_foam, in standard errors
  double chi_squared = 0, p = 0;      ///< dimensions exact
  int dof = 0;
  double cold_replays = 0;  ///< of the dearer search
  std::vector<std::string> parameters;
  std::vector<double> error;        ///< of each, relative to its planted value, dimensions exact
  std::vector<int> noise_holds;     ///< 1: the noise's interval holds the truth, dimensions exact
  std::vector<int> total_holds;     ///< 1: the interval in all does, dimensions off; -1: that fit has no result
  std::vector<double> total_width;  ///< half of it, relative to the value
  std::string total_status;         ///< of the fit with dimensions that are off
};

/// Fits planted benches 1 to `count`, as many as the budget allows; what is in the store is not run again.
std::vector<std::optional<PlantedResult>> run_planted(const Experiment& base, unsigned count,
                                                      const StudyOptions& options);

}  // namespace taut
