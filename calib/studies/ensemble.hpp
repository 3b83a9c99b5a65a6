#pragma once
#include <Eigen/Core>
#include <array>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "calib/benches/bench.hpp"
#include "calib/studies/discretisation.hpp"
#include "calib/studies/study_store.hpp"

// Many fits of one bench: what a single one, and its parabola, do not tell.
namespace taut {

/// What the members of an ensemble are.
enum class EnsembleKind {
  posterior,  ///< draws from the posterior of the parameters (calib/fit/posterior.hpp)
  bootstrap,  ///< fits of readings that were drawn anew
  starts,     ///< fits of the readings from elsewhere within the bounds
  profiles    ///< fits with one parameter held, at places along each in turn: profile likelihood
};
std::string_view name_of(EnsembleKind kind);  ///< "posterior"

/// Which ensemble, how large.
struct EnsembleTask {
  EnsembleKind kind = EnsembleKind::posterior;
  unsigned count = 500;  ///< of members
  unsigned seed = 1;
};

/// One of an ensemble.
struct EnsembleMember {
  std::string status = {};             ///< "ok", "outside" (where the prior is zero), or why it has no values
  std::vector<double> values = {};     ///< of the free parameters, SI; empty: none
  double log_weight = 0;               ///< among the members, up to a constant; of fits 0
  double chi_squared = 0;              ///< against its own readings
  std::vector<double> predicted = {};  ///< per row of the protocol, SI
  int evaluations = 0;                 ///< of the protocol
};

/// Makes the members that the store does not have; each is the same whoever makes it, in whichever order. `fit` is that
/// of the bench's readings. Nothing stands where one is missing: of another shard, beyond the budget, interrupted.
/// Throws InputError where the bench does not give the fit's chi squared at its optimum (a fit that follows rows into
/// another equilibrium, or of another taut), and where there is no optimum.
std::vector<std::optional<EnsembleMember>> run_ensemble(const Bench& bench, const FitResult& fit,
                                                        const EnsembleTask& task, const StudyOptions& options);

/// What an ensemble says of a parameter, SI.
struct EnsembleMarginal {
  std::string id, unit;
  double mean = 0, deviation = 0;               ///< of profiles NaN
  double lower95 = 0, median = 0, upper95 = 0;  ///< of profiles the lowest place between ends that are NaN where open
  std::optional<double> total_lower95, total_upper95;  ///< with all shares that count; posterior only
  /// Width over that of the parabola's 95 % interval, on the fitted scale, and two Monte-Carlo standard errors of it;
  /// NaN: the parabola has none.
  double width = 0, width_error = 0;
  std::string verdict;  ///< on the parabola: "good (ends within 9 %)", "too narrow by 1.6", "shifted by ..."
};

/// A minimum of chi squared that starts led to.
struct EnsembleMinimum {
  double chi_squared = 0;
  int starts = 0;              ///< that ended there
  std::vector<double> values;  ///< of the free parameters, SI
};

/// Rises of chi squared, minimised over all other parameters, at values [SI] of one, ascending.
using ProfileGrid = std::vector<std::pair<double, double>>;

/// An ensemble as it is written to fit.json.
struct EnsembleRecord {
  std::string kind, how;  ///< name_of(); one or two sentences: what was drawn, from which prior
  int asked = 0, finished = 0, failed = 0, outside = 0;
  unsigned seed = 1;
  double effective = 0;                      ///< number of equal weights that say as much
  double evaluations = 0;                    ///< of the protocol per member
  std::vector<EnsembleMarginal> parameters;  ///< in the order of the fit's; empty: too few members
  Eigen::MatrixXd correlation;               ///< of the parameters on the fitted scale
  /// 95 % band of what each of the bench's readings would be without noise, SI, in their order, NaN where nothing
  /// predicts it; empty: too few members.
  std::vector<std::array<double, 2>> bands;
  /// The first members that have values, for figures: parameters, SI, and weights, the largest 1.
  std::vector<std::vector<double>> drawn;
  std::vector<double> weights;
  std::vector<EnsembleMinimum> minima;  ///< of starts, the lowest first
  std::vector<ProfileGrid> profiles;    ///< of profiles, in the order of the fit's parameters
  std::vector<std::string> failures;    ///< distinct reasons, the first few
  std::string verdict;                  ///< one sentence for people
};

/// Sums members up. `bench` has the fit's free parameters.
EnsembleRecord summed_up(const std::vector<std::optional<EnsembleMember>>& members, const Bench& bench,
                         const FitResult& fit, const std::vector<Share>& shares, const EnsembleTask& task);

/// Members as a table: number, status, weight (the largest 1), chi squared, parameters, in SI with units in the heads.
std::string ensemble_csv(const std::vector<std::optional<EnsembleMember>>& members, const FitResult& fit);

}  // namespace taut
