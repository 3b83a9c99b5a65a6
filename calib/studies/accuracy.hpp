#pragma once
#include <Eigen/Core>
#include <atomic>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "calib/benches/static_replay.hpp"
#include "calib/studies/study_store.hpp"
#include "sim/core/numbers.hpp"
#include "sim/robots/simulation.hpp"

namespace taut {

/// What an experiment's result came to with one setting, and what it took.
struct AccuracyRun {
  std::string failure;  ///< why there is no result; "": there is one
  int unknowns = 0;
  double seconds = 0;           ///< wall time of one cold replay
  int factorisations = 0;       ///< matrices factorised in it
  Eigen::VectorXd values;       ///< the result, SI
  Eigen::MatrixXd derivatives;  ///< values x free parameters, SI; empty for simulations
};

/// One way to compute an experiment's result.
struct AccuracySetting {
  std::string axis;        ///< what is varied, for the legend: "linear elements", "step tolerance"
  std::string name;        ///< unique: "linear, 14 x 5 x 5 cells"
  bool in_use = false;     ///< as the file has it
  double cost = 0;         ///< a guess, to a factor: what is cheap is run first
  std::string model;       ///< "plane section", "solid", "beam", ... of settings that are compared by it; else ""
  std::string integrator;  ///< over time: of settings that differ from the one in use in how they step alone; else ""
  bool may_hang = false;   ///< is given up after a tenth of the budget
  /// Sequences that tend to the answer, with the size that goes to zero: "mesh", "contact gap", "step", and "depth" of
  /// solids on the mesh of the plane section in use.
  std::map<std::string, double> sequences;
  std::function<AccuracyRun(const std::atomic<bool>& stop)> run;
};

/// An experiment, its result, and the settings to try.
struct AccuracyStudy {
  std::string title;
  bool simulated = false;
  std::string result;  ///< what is compared, in words: "displacements of all rows"
  std::vector<AccuracySetting> settings;
  std::map<std::string, double> highest_order;  ///< per sequence, for extrapolate()
  std::vector<int> series;  ///< per value: which curve it is of, whose range errors are relative to; empty: to itself
  // What a fit would make of the errors; empty for simulations.
  ParameterTable table;
  Params nominal;
  std::vector<FreeParameter> free;
  std::vector<double> sigma;  ///< noise of each value [SI]
};

/// Readings at rest: all rows at the file's own parameters, which are the model's where nothing else is said. Elements
/// (linear, quadratic, locking-free where a Poisson's ratio exceeds 0.4) times meshes, and one at a time: contact gap,
/// step tolerance, load steps, plane stress or strain, as a solid, and cheaper models (beams, rod, rigid segments)
/// where they describe the bench. Recordings: up to 101 samples of each. Elements times meshes, integrators times
/// steps.
AccuracyStudy accuracy_study(const Experiment& experiment);

/// A simulation over time: its channels but net forces (second differences of positions, whose peaks are as tall as the
/// steps are short) at 101 even times. Elements times meshes, integrators times steps, contact gap, step tolerance.
/// Throws InputError for a simulation without inertia or without such channels.
AccuracyStudy accuracy_study(const Simulation& simulation);

/// The runs of all settings, in their order: read from the store, or made now, one at least, the setting in use first,
/// then the cheap ones. Missing where the budget ends before or `stop` was raised.
std::vector<std::optional<AccuracyRun>> run_settings(const AccuracyStudy& study, const StudyOptions& options);

/// How far a setting is from the answer. All relative: to the value (at least a hundredth of the largest one), or to
/// the range of its curve.
struct AccuracyPoint {
  size_t setting = 0;
  double error = 0, largest = 0;   ///< root mean square, largest one
  double from_setting_in_use = 0;  ///< root mean square difference to it
  std::vector<double>
      parameters;  ///< error of each free parameter that a fit would have; of its range if not logarithmic
  /// Of settings with an `integrator`: root mean square, to the limit of small steps on the file's own mesh.
  double step_error = not_a_number;
  bool on_front = false;  ///< no setting is both faster and more accurate
  /// Of settings with a `model`: root mean square, to the limit of the solid. NaN: there is none.
  double model_error = not_a_number;
};

/// The runs judged by a reference: the result in use, plus for each sequence what is between it and the sequence's
/// limit; "depth" counts for AccuracyPoint::model_error alone, lest what the plane section leaves out hides all else.
struct AccuracyChart {
  std::vector<AccuracyPoint> points;          ///< of runs with a result
  double uncertainty = 0;                     ///< of the reference, root mean square; NaN: not known
  std::vector<double> parameter_uncertainty;  ///< per free parameter, relative as AccuracyPoint::parameters
  std::vector<double> parameter_noise;        ///< standard error from the readings' noise, the same way
  std::string reference;                      ///< one sentence: how it was made
  /// How far the plane section in use is from the solid, and how many times as long the solid takes: one sentence; "":
  /// no solid has a result.
  std::string section;
  double model_uncertainty = not_a_number;  ///< of the limit of the solid
  std::string model_reference;              ///< "": there is none
  double step_uncertainty = not_a_number;   ///< of the limit of small steps
  std::string step_reference;               ///< "": there is none
};

/// Throws InputError when the setting in use has no result.
AccuracyChart judge(const AccuracyStudy& study, const std::vector<std::optional<AccuracyRun>>& runs);

/// Indices of the points that no other one beats in both cost and error, from cheap to dear. An error less than 2 %
/// below that of a cheaper point is no gain.
std::vector<size_t> pareto_front(const std::vector<std::pair<double, double>>& cost_and_error);

}  // namespace taut
