#pragma once
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "calib/benches/bench.hpp"
#include "calib/data/trials.hpp"
#include "sim/core/numbers.hpp"

// Predictions of any simulator beside the readings of a rig: how far off they are, all by the same numbers.
namespace taut {

/// Controls are the same where each differs by no more than this fraction of its largest size at the rig.
inline constexpr double same_control = 1e-6;

/// What one simulator predicts: readings without noise, which know their line, controls, channel and value (SI).
struct SimPredictions {
  std::string name;  ///< its file
  std::vector<Reading> rows;
};

/// How the repeats of a channel scatter: what no prediction that is a function of the controls can get below.
struct RepeatScatter {
  int dof = 0;                               ///< readings less conditions; 0: nothing was repeated
  double standard_deviation = not_a_number;  ///< root of sum (y - mean of its condition)^2 / dof [SI]
  double least_rmse = not_a_number;          ///< root of sum (y - mean of its condition)^2 / readings [SI]
  double least_chi_squared = not_a_number;   ///< sum ((y - weighted mean of its condition) / sigma)^2
};

/// A reading and what was predicted for it.
struct Miss {
  int line = 0;  ///< of the rig's file
  std::vector<double> controls;
  double measured = 0, predicted = 0;  ///< SI
};

/// Predictions of a channel against its n readings, repeats counted each: RMSE = root of sum (predicted - measured)^2 /
/// n, bias = sum (predicted - measured) / n, chi squared = sum ((predicted - measured) / sigma)^2.
struct ChannelScore {
  int readings = 0;
  double rmse = not_a_number, bias = not_a_number;  ///< SI
  /// rmse over the readings' standard deviation about their own mean (of equal readings: over their size)
  double relative = not_a_number;
  Miss largest = {};                                          ///< where |predicted - measured| is largest
  double chi_squared = not_a_number, p_value = not_a_number;  ///< NaN: no noise is known
};

/// Between which retractions a module closes: of neighbouring ones those over which the displacement at the largest
/// load falls by the largest factor, all else held. It is the same rule for readings (the mean of repeats) and
/// predictions, and needs no model.
struct Closure {
  int channel = 0;
  std::vector<double> held;  ///< the controls of that series, SI; that of the retraction is NaN
  /// Two neighbouring retractions.
  struct Step {
    double from = 0, to = 0;  ///< retractions [m]
    double factor = 1;        ///< displacement at `from` over that at `to`
  };
  Step measured, predicted;
  double at = 0;                       ///< measured.to: the first retraction at which it is closed [m]
  double reading = 0, prediction = 0;  ///< mean displacements there [m]
};

/// What one simulator comes to.
struct SimScore {
  std::string name;
  std::vector<ChannelScore> channels;                         ///< as Trials::channel_ids
  int readings = 0;                                           ///< of all channels
  double chi_squared = not_a_number, p_value = not_a_number;  ///< of all; NaN: not every channel's noise is known
  /// Root of the mean square of ChannelScore::relative over the channels that have readings.
  double relative = not_a_number;
  std::vector<int> unpredicted;  ///< lines of the rig's file with a reading for which it has no prediction
  std::vector<int> unread;       ///< lines of its own file for which the rig has no reading
  std::vector<Closure> closures;
};

/// All, the best first: by chi squared where all have it, else by SimScore::relative.
struct ScoreTable {
  std::vector<RepeatScatter> repeats;  ///< of each channel, of the readings that are scored
  std::vector<SimScore> sims;
  int readings = 0;   ///< scored: those that every simulator predicts, so that all are asked the same
  int available = 0;  ///< of the rig, without excluded ones
};

/// Which control is a retraction, which the load, and which channels are displacements, where that is known.
struct ClosureQuestion {
  std::vector<size_t> retractions;
  std::optional<size_t> load;
  std::vector<int> displacements;
};

/// Scores predictions. `has_noise` says of each channel whether the readings' sigmas mean anything. Probabilities are
/// those of chi squared with as many degrees of freedom as readings: nothing is taken to have been fitted to them.
/// Throws InputError where a simulator predicts two values for the same controls, or where no reading is predicted by
/// all of them.
ScoreTable score(const Trials& rig, const std::vector<SimPredictions>& sims, const std::vector<bool>& has_noise,
                 const ClosureQuestion& closure = {});

/// What to score, as files and words.
struct ScoreQuestion {
  std::string rig;                           ///< a bench file
  std::vector<std::string> sims;             ///< tables with the same controls and predicted channels
  std::string experiment;                    ///< file that says what the columns are, and their noise; "": none
  std::vector<std::string> channels;         ///< columns that were measured; empty: as the experiment, or as guessed
  std::map<std::string, std::string> noise;  ///< by channel: "0.02 mm", "1.5 %", or both with a +
};

/// What is scored, once files are read.
struct ScoreData {
  Trials rig;
  std::vector<SimPredictions> sims;
  std::vector<AxisRecord> controls, channels;
  std::vector<bool> has_noise;
  ClosureQuestion closure;
  std::vector<std::string> remarks;  ///< what was taken for what
};

/// Reads the rig's file and all tables by the reader of benches (read_trials()). With an experiment its file says which
/// columns are controls, channels, trials and sigmas. Without one a column that both files have is a control where at
/// more than half of the values of one file are values of the other one, else a channel; text that both have is a
/// control; "trial" is the repeat. A table may be the predictions.csv of a run of taut: its channels are found by their
/// ids, or where there is one only, whatever it is called. Throws InputError.
ScoreData read_score(const ScoreQuestion& question);

}  // namespace taut
