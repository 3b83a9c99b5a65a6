#pragma once
#include <filesystem>
#include <variant>

#include "calib/files/experiment.hpp"
#include "calib/studies/study_store.hpp"
#include "experiments/cli/progress.hpp"
#include "sim/robots/simulation.hpp"

namespace taut {

/// What a chart is drawn of.
using Charted = std::variant<Experiment, Simulation>;

/// Throws InputError for what has neither mesh nor steps.
Charted read_charted(const CommandOptions& options);

/// Where a chart's figures and its table of finished runs stand: runs/<name>/charts, or what --out says.
struct ChartFolder {
  std::filesystem::path path;
  StudyOptions study;  ///< the store is <chart>.csv in it
};

/// Makes the folder. Runs of another version of the file, of its readings or of its mesh are others.
ChartFolder open_chart(const CommandOptions& options, const std::string& chart, const Charted& charted,
                       Progress& progress);

/// Says what is missing, and returns the exit code.
int close_chart(const CommandOptions& options, size_t missing, size_t all, Progress& progress);

}  // namespace taut
