#pragma once
#include <atomic>
#include <map>
#include <string>
#include <vector>

#include "calib/runs/provenance.hpp"

namespace boost::program_options {
class options_description;
class options_description_easy_init;
}  // namespace boost::program_options

namespace taut {

class Messages;

/// Exit codes of the command `taut`.
enum ExitCode {
  exit_ok = 0,
  exit_internal = 1,      ///< a fault of taut's own
  exit_input = 2,         ///< wrong usage or wrong input, or output that cannot be written
  exit_solve = 3,         ///< one or more simulations or parts of a run failed; what succeeded is written
  exit_fit = 4,           ///< the fit or search did not converge, or found nothing
  exit_differs = 5,       ///< what was compared differs
  exit_figures = 6,       ///< all is done and written but figures that gnuplot could not draw
  exit_interrupted = 130  ///< Ctrl-C; what was finished is written
};

/// What was asked for on the command line.
struct CommandOptions {
  std::string target;                ///< experiment file or run folder
  std::vector<std::string> further;  ///< compare: the other run folders; score: tables
  std::string out;                   ///< run folder, "" for runs/<experiment>
  std::string name;                  ///< ik: the target that is meant, "" for all; chart: which one; tune: control
  bool stream = false;               ///< ik: targets from stdin
  std::string rows;                  ///< predict: CSV file of new loads; plan: of candidates
  double budget = 300;               ///< chart: time that its simulations may take [s]
  std::map<std::string, std::string> set;  ///< parameter values of replay; controls of tune, export; noise of score
  bool sensitivities = false;              ///< replay, simulate: derivatives too
  std::string goal;                        ///< simulate: CHANNEL or CHANNEL@TIME whose gradient is asked for
  std::string wrt;                         ///< simulate: the parameters of both, "ID,ID,..."; "" for all
  std::string stiffness, at, from, to;     ///< tune: what is wanted, the load at which, the range looked at
  std::string load;                        ///< tune: the load along which
  std::vector<std::string> also;           ///< tune: conditions on channels
  bool no_map = false;                     ///< tune: without the map
  std::vector<std::string> tries;          ///< plan: "ID=FROM..TO", values of controls that are looked at
  int levels = 5;                          ///< plan: how many in each range
  std::string read_channels;               ///< plan: that are read, "ID,ID,..."; "" for all
  std::string parameter, predict;          ///< plan: the goal, a parameter or a channel at `at`; "" for neither
  int count = 0;                           ///< plan: rows; 0: not said
  double minutes = 0;                      ///< plan: bench time; 0: not said
  std::string setup = "5 min", rest = "1 min", reading = "1 min";  ///< plan: costs
  int draws = 8;                                                   ///< plan: of the parameters
  long long seed = 1;                                              ///< plan, ensemble: of the draws
  int members = 0;                                                 ///< ensemble: how many; 0: not said
  int posterior = 0;                                               ///< fit: draws of the posterior; 0: none
  std::string shard;                                               ///< ensemble, chart: "I/N"; "": all
  Messages* messages = nullptr;          ///< to the processes that mpirun started beside this one; null: none
  std::string format;                    ///< export: what for
  std::vector<std::string> retractions;  ///< export: the states
  std::string largest;                   ///< export: the load up to which it holds
  int hinges = 10;                       ///< export: of bodies that are no modules
  std::string experiment;                ///< score: the file that says what the columns are
  std::vector<std::string> channels;     ///< score: columns that were measured; export: the one followed
  double sigmas = 3;                     ///< compare: beyond which a parameter differs
  bool no_fit = false;                   ///< recheck: without the fit
  bool json = false;
  bool quiet = false;
  bool no_variants = false;  ///< fit: without the [[fit.variant]] ones
  bool strict = false;       ///< check: warnings are errors
  bool fresh = false;        ///< fit: not from where an interrupted run stopped
  bool anyway = false;       ///< predict: also from a fit without a result
  int threads = 0;
  std::string command_line;
  const std::atomic<bool>* stop = nullptr;  ///< raised by Ctrl-C

  bool interrupted() const { return stop != nullptr && stop->load(); }
};

/// add("name", po::value(&options.member)->value_name("UNIT"), "what it does") declares an option.
using AddOption = boost::program_options::options_description_easy_init;

/// A command: what its help says, what it takes, what it does. Each is made in a file of its own.
struct Command {
  std::string name;
  std::string arguments;  ///< as the usage has them: "EXPERIMENT"
  std::string summary;
  std::string examples;  ///< a line each; the first one stands in `taut --help` as well
  /// Declares the options that not all commands have; null: there are none.
  void (*add_options)(AddOption add, CommandOptions& options) = nullptr;
  /// Checks its options, does the work, prints the result; returns the exit code. Throws InputError.
  int (*run)(const CommandOptions& options) = nullptr;
  /// Where the words go that are no options; the last one is needed.
  std::vector<std::string CommandOptions::*> positional = {&CommandOptions::target};
  bool several = false;   ///< further words go to CommandOptions::further
  bool together = false;  ///< its work is shared among the processes that mpirun starts
};

/// This one, as it was called.
Program program_of(const CommandOptions& options);
/// runs/<name of the experiment>, or what --out says.
std::string run_folder(const CommandOptions& options);

/// --out, of commands that write a folder.
void add_out(AddOption add, CommandOptions& options,
             const char* what = "run folder; default: runs/<name of the experiment's folder>");
/// --NAME ID=VALUE, as often as one likes.
void add_assignments(AddOption add, std::map<std::string, std::string>& values, const char* name, const char* what);
/// What --seed says. Throws InputError for a number that none can be.
unsigned seed_of(const CommandOptions& options);
/// --threads, of commands that solve several states at the same time.
void add_threads(AddOption add, CommandOptions& options);

/// Its options, those that all commands have first; they store into `options`.
boost::program_options::options_description options_of(const Command& command, CommandOptions& options);

/// What `taut` knows, in the order in which its help lists them.
const std::vector<Command>& all_commands();

}  // namespace taut
