#pragma once
#include <filesystem>
#include <variant>

#include "calib/files/experiment.hpp"
#include "calib/studies/study_store.hpp"
#include "experiments/cli/commands.hpp"
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

/// Runs an experiment (readings at rest, recordings, or a simulation) with other meshes, elements and solver settings
/// and charts the error of its result against the time and the matrix factorisations it took: accuracy.csv, figures as
/// SVG, PDF and PNG in the folder that --out names. Each finished setting is kept at once, and the next run goes on
/// from there; settings that do not fit into --budget are left out and counted. Exit code 130 when interrupted.
int chart_accuracy(const CommandOptions& options);

/// `taut chart stability EXPERIMENT`.
int chart_stability(const CommandOptions& options);

/// Plants benches about a push_puppet experiment, fits them, and says how often intervals hold the truth.
int chart_planted(const CommandOptions& options);

/// Checks the posterior of an experiment by simulation: truths from the prior, and their ranks.
int chart_sbc(const CommandOptions& options);

}  // namespace taut
