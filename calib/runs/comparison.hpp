#pragma once
#include <optional>
#include <string>
#include <vector>

#include "calib/runs/run_record.hpp"

// Two runs beside each other: whether their calibrations differ, and in what they were made from.
namespace taut {

/// A parameter that both runs fitted.
struct ParameterDifference {
  std::string id, unit;
  double first = 0, second = 0;  ///< SI
  /// Standard deviation of the difference of both on the fitted scale (logarithms of logarithmic parameters), in units
  /// of the first value's: see compare().
  double sigma = 0;                    ///< SI
  double in_sigmas = 0;                ///< difference / sigma on the fitted scale
  std::vector<std::string> cancelled;  ///< sources of shares that both have in common
};

/// A reading that stands in both benches with different numbers, or in one of them alone.
struct ReadingDifference {
  std::string what;                     ///< "trial 1, tip at mass 50 g"
  std::optional<double> first, second;  ///< SI; empty: not there
  double in_sigmas = 0;                 ///< of both readings' noise; 0 where one is missing
  std::string unit;                     ///< SI
};

/// The largest distance of the curves of one channel and series, at loads that both have.
struct CurveDifference {
  std::string channel, series, unit;
  double load = 0;               ///< as CurveRecord::load
  std::string load_unit;         ///< its SI unit
  double first = 0, second = 0;  ///< SI, there
  double in_sigmas = 0;          ///< of both curves' standard errors
};

/// A value of the experiment file that is not the same in both.
struct InputDifference {
  std::string key;            ///< "geometry.gap_total"
  std::string first, second;  ///< as they stand there; "": it is not there
};

/// Two runs beside each other.
struct RunComparison {
  std::vector<ParameterDifference> parameters;
  std::vector<std::string> first_alone, second_alone;  ///< parameters that only one of them fitted
  double chi_squared = 0;  ///< of all differences together: d^T C^-1 d, with the noise's correlations
  double p_value = 1;      ///< of a larger one, if both measured the same
  std::vector<CurveDifference> curves;
  std::vector<ReadingDifference> readings;  ///< those that moved by most first
  int common_readings = 0;                  ///< of equal trial, channel and controls,
  int equal_readings = 0;                   ///< and of those, equal to the last digit
  /// Both were fitted to the very same readings: their noise is common, and what they differ by is not noise. Sigmas
  /// are then those of one run's noise.
  bool same_readings = false;
  std::vector<InputDifference> inputs;

  /// Whether the calibrations differ: a parameter by more than `limit` sigmas (with the same readings a twentieth of
  /// that), all together with a probability below 0.27 %, or one run fitted what the other did not.
  bool differs(double limit = 3) const;
};

/// Compares two runs that have a result. With D = second - first on the fitted scale, its variance is that of the noise
/// of both; a share of what was assumed that both have in common (the same source, and no input of that name differs)
/// moves both alike, and counts only by how far it moves one more than the other, (|b2 - b1| + |e2 - e1|) / 1.96;
/// all others count by (|b| + e) / 1.96 each. Shares that are not known are left out. Throws InputError where a run has
/// no result.
RunComparison compare(const RunRecord& first, const RunRecord& second, std::vector<InputDifference> inputs);

/// What differs between two experiment files, key by key: values with units as quantities, without comments, order,
/// title and the names of files. Throws InputError as toml_values() does.
std::vector<InputDifference> input_differences(const std::string& first, const std::string& second);

}  // namespace taut
