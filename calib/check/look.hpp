#pragma once
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "calib/benches/bench.hpp"
#include "calib/check/plausibility.hpp"
#include "sim/shapes/spine.hpp"

namespace taut {

/// What a kind finds.
using Sentences = std::vector<std::string>;

/// Readings of one channel in one condition.
struct Repeats {
  int channel = 0;
  std::vector<double> controls;
  std::vector<const BenchReading*> readings;  ///< in the order of the file
  double mean() const;                        ///< of the readings
  double median() const;                      ///< which one odd reading does not move
  double sigma() const;                       ///< of either, as declared
};

/// What a chain of beams says of the rows of a BeamView.
struct BeamCurve {
  double factor = 1;                   ///< modulus of the soft material over its start
  std::vector<double> values, errors;  ///< [m]; the errors that the model states
};

/// One channel's readings at least retraction beside what a chain of beams says over the modulus.
struct BeamView {
  int channel = 0;
  std::vector<const Repeats*> rows;  ///< that stand out of their noise
  std::vector<BeamCurve> curves;     ///< at the starts from soft to stiff, then with slack and clamp at their bounds
};

/// A bench as the kinds of implausible input look at it.
struct Look {
  explicit Look(const Bench& bench);  ///< of a bench that outlives it

  const Bench& bench;
  const Experiment& experiment;
  const ParameterTable& table;
  std::vector<const BenchReading*> readings;  ///< that are not excluded
  std::vector<Repeats> repeats;               ///< of them; none of recordings
  std::vector<FreeParameter> free;
  Params start;                ///< nominal, free ones at their starts
  double size = 0;             ///< diagonal of the specimen [m]; 0: not known
  std::optional<Spine> spine;  ///< where it is a chain of beams

  /// Whether its readings are those of equilibria of a specimen.
  bool at_rest() const { return experiment.kind->at_rest; }
  /// The id of a channel, and its SI unit.
  const std::string& channel(int channel) const { return bench.channels()[static_cast<size_t>(channel)].id; }
  /// See channel().
  const std::string& unit(int channel) const { return bench.channels()[static_cast<size_t>(channel)].unit; }
  /// The values of a channel's readings.
  std::vector<double> values_of(int channel) const;
  /// A control that is a length set before the loads, with its largest size and the line of that.
  struct Motion {
    std::string id;
    double most = 0;  ///< [m]
    int line = 0;
  };
  std::vector<Motion> motions(bool retractions) const;               ///< retractions, or supports that are moved
  const FreeParameter* free_parameter(const std::string& id) const;  ///< null: it is not free
  double value(const std::string& id) const;                         ///< at the start; NaN: there is none
  /// Whether gravity acts on the specimen.
  bool own_weight() const { return !experiment.gravity_direction.empty(); }
  /// By channel; none where no chain of beams describes the specimen. Computed when first asked for.
  const std::vector<BeamView>& beam_views() const;

 private:
  mutable std::optional<std::vector<BeamView>> views_;
};

/// Of values, one at least.
double median_of(std::vector<double> values);

/// Largest power of ten of which all values are multiples, 1e-5 m for 3.55 mm and 2.1 mm; 0: there is none.
double step_of(const std::vector<double>& values);

/// ", larger by 10: a slipped decimal point or a wrong unit?", or "".
std::string slip_text(double ratio, double tolerance);

std::vector<Implausible> implausible_readings();   ///< the table of readings.cpp
std::vector<Implausible> implausible_trials();     ///< the table of trials.cpp
std::vector<Implausible> implausible_settings();   ///< the table of settings.cpp
std::vector<Implausible> implausible_for_beams();  ///< the table of beams.cpp
std::vector<Implausible> implausible_curves();     ///< the table of curves.cpp

}  // namespace taut
