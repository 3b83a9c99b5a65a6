#pragma once
#include <optional>
#include <string>
#include <vector>

#include "calib/benches/bench.hpp"
#include "calib/runs/run_record.hpp"
#include "calib/studies/tuning.hpp"
#include "experiments/cli/bench_words.hpp"
#include "experiments/cli/commands.hpp"
#include "reports/stiffness_map.hpp"

// What options say of a run's controls and channels: for commands that replay it at values of one's own.
namespace taut {

/// The load along which stiffness is meant: --load, else the one that the figures are drawn over. Throws InputError.
size_t load_of(const CommandOptions& options, const Bench& bench);
/// The controls that are retractions.
std::vector<size_t> retractions_of(const Bench& bench);
/// What is sought: --control, else each retraction. Throws InputError.
std::vector<size_t> controls_of(const CommandOptions& options, const Bench& bench, size_t load);
/// All controls as --hold says, else at their smallest size at the bench; the load (0, for the option
/// `sets_load` to set) and what is sought cannot be held. Throws InputError.
std::vector<double> held_controls(const CommandOptions& options, const Bench& bench, size_t load,
                                  std::optional<size_t> sought, const char* sets_load);

/// The map as stiffness_map.csv and .json in a folder; returns what stands around it.
StiffnessMapText write_stiffness_map(const StiffnessMap& map, const RunRecord& record, const Bench& bench,
                                     const TuneQuestion& question, const std::string& folder);

}  // namespace taut
