#pragma once
#include <any>
#include <limits>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "calib/benches/recording_protocol.hpp"
#include "calib/benches/static_replay.hpp"

namespace taut {

/// One [[bench.recording]]: a file with a motion, and how that came about.
struct RecordingSettings {
  std::string id;  ///< "load52_a": case and trial
  std::string path, case_id, trial;
  std::map<std::string, double> loads;  ///< load id to its value in this recording, SI
  std::map<std::string, double> held;   ///< loads that act until the release only
  double held_for = infinity;           ///< [s]
  double release = 0;                   ///< [s] on the recording's clock
  double from = -std::numeric_limits<double>::infinity(), until = std::numeric_limits<double>::infinity();  ///< [s]
  int every = 1;
  double sigma = 0;  ///< SI unit of the channels; 0: their noise
  /// Where it came to rest: channel id to reading, SI; none: not said.
  std::map<std::string, double> rest;
  double rest_after = 0, rest_sigma = 0;  ///< since its release [s]; SI unit of the channels
};

/// [bench] with kind = "recordings", and [dynamics]: how they are replayed.
struct RecordingsSettings {
  std::string time_column;
  bool from_mean_before = false;      ///< displacements are measured from the mean before time zero
  std::vector<std::string> per_case;  ///< parameters that each case has for itself
  std::vector<RecordingSettings> recordings;
  Integrator integrator = Integrator::bdf2;
  double step = 0;  ///< [s]
};

/// Those of an experiment with recordings.
inline RecordingsSettings& recordings_of(Experiment& experiment) {
  return std::any_cast<RecordingsSettings&>(experiment.own);
}
/// The same, to look at.
inline const RecordingsSettings& recordings_of(const Experiment& experiment) {
  return std::any_cast<const RecordingsSettings&>(experiment.own);
}

/// Reads [bench] with kind = "recordings", [dynamics] and [damping.REGION], and checks them against what `experiment`
/// has already: materials, loads, channels. Throws InputError.
void read_recordings(TableReader& root, Experiment& experiment);

/// The recordings with parameters of their own: "release_<recording>", "<load>_<recording>" for what holds one, and
/// "<parameter>_<case>" for what [bench] per_case names.
std::vector<Recording> declare_recordings(const Experiment& experiment, SceneBuilder& builder);

/// One sample of one channel, with where it stands.
struct Sample {
  int recording = 0, channel = 0;
  int line = 0;        ///< in the recording's file, the header is line 1
  double time = 0;     ///< [s]
  double value = 0;    ///< SI, from the mean before time zero if the bench says so
  double sigma = 0;    ///< SI
  bool still = false;  ///< the motion had come to rest
};

/// The samples that the bench chooses from its files, in order of recording, channel and time. Throws InputError, one
/// sentence with file, line and column, for a missing file or column, a wrong unit, what is not a finite number, times
/// that do not ascend, a recording without samples in its window, and no samples before time zero where their mean is
/// asked for.
std::vector<Sample> read_samples(const Experiment& experiment);

/// For people: where a recording was found in a file that holds more than a plain table, and what was not taken; or "".
std::string recording_layout(const Experiment& experiment, size_t index);

/// Samples as rows of a recording protocol, one each. Recordings of one case at one time since their release are no
/// repeats in the sense of a static bench, since each has its own release.
struct RecordingReplay {
  std::unique_ptr<RecordingProtocol> protocol;
  std::vector<Measurement> measurements;  ///< one per sample
};
/// Throws InputError.
RecordingReplay make_recording_replay(const Experiment& experiment, const MeshSettings& settings,
                                      const std::vector<Sample>& samples);

}  // namespace taut
