#pragma once
#include <atomic>
#include <map>
#include <string>

namespace taut {

/// Exit codes of the command `taut`.
enum ExitCode {
  exit_ok = 0,
  exit_internal = 1,      ///< a fault of taut's own
  exit_input = 2,         ///< wrong usage or wrong input, or output that cannot be written
  exit_solve = 3,         ///< one or more simulations or parts of a run failed; what succeeded is written
  exit_fit = 4,           ///< the fit did not converge
  exit_interrupted = 130  ///< Ctrl-C; what was finished is written
};

/// What was asked for on the command line.
struct CommandOptions {
  std::string target;                      ///< experiment file or run folder
  std::string out;                         ///< run folder, "" for runs/<experiment>
  std::string name;                        ///< ik: the target that is meant, "" for all; chart: which one
  std::string rows;                        ///< predict: CSV file of new loads
  double budget = 300;                     ///< chart: time that its simulations may take [s]
  std::map<std::string, std::string> set;  ///< replay: parameter values that replace the nominal ones
  bool sensitivities = false;              ///< replay, simulate: derivatives too
  std::string goal;                        ///< simulate: CHANNEL or CHANNEL@TIME whose gradient is asked for
  std::string wrt;                         ///< simulate: the parameters of both, "ID,ID,..."; "" for all
  bool json = false;
  bool quiet = false;
  bool variants = true;  ///< fit: also the [[fit.variant]] ones
  bool fresh = false;    ///< fit: not from where an interrupted run stopped
  int threads = 0;
  std::string command_line;
  const std::atomic<bool>* stop = nullptr;  ///< raised by Ctrl-C
};

/// Reads experiment, bench and model, says what was understood and what looks wrong; solves nothing.
int check_command(const CommandOptions& options);
/// Draws the specimen of an experiment at rest with its dimensions; reads no bench, solves nothing.
int draw_command(const CommandOptions& options);
/// Simulates every row of the bench with the nominal parameters: table on stdout; predictions.csv and states as VTU.
int replay_command(const CommandOptions& options);
/// Fits the free parameters and writes a run folder.
int fit_command(const CommandOptions& options);
/// Predicts at new loads with the parameters and covariance of a run.
int predict_command(const CommandOptions& options);
/// Rebuilds figures and report of a run from its fit.json, without solving.
int report_command(const CommandOptions& options);

}  // namespace taut
