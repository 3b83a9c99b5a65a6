#pragma once
#include <memory>
#include <string>
#include <vector>

#include "calib/benches/recording_protocol.hpp"
#include "calib/benches/static_replay.hpp"

namespace taut {

/// The recordings with parameters of their own: "release_<recording>", "<load>_<recording>" for what holds one, and
/// "<parameter>_<case>" for what [bench] per_case names.
std::vector<Recording> declare_recordings(const Experiment& experiment, SceneBuilder& builder);

/// One sample of one channel, with where it stands.
struct Sample {
  int recording = 0, channel = 0;
  int line = 0;      ///< in the recording's file, the header is line 1
  double time = 0;   ///< [s]
  double value = 0;  ///< SI, from the mean before time zero if the bench says so
  double sigma = 0;  ///< SI
};

/// The samples that the bench chooses from its files, in order of recording, channel and time. Throws InputError, one
/// sentence with file, line and column, for a missing file or column, a wrong unit, what is not a finite number, times
/// that do not ascend, a recording without samples in its window, and no samples before time zero where their mean is
/// asked for.
std::vector<Sample> read_samples(const Experiment& experiment);

/// Samples as rows of a recording protocol, one each. Recordings of one case at one time since their release are no
/// repeats in the sense of a static bench, since each has its own release.
struct RecordingReplay {
  std::unique_ptr<RecordingProtocol> protocol;
  std::vector<Measurement> measurements;  ///< one per sample
};
RecordingReplay make_recording_replay(const Experiment& experiment, const MeshSettings& settings,
                                      const std::vector<Sample>& samples);

}  // namespace taut
