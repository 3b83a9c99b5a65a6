#include "calib/benches/recordings_bench.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "calib/data/ring_down.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

std::vector<std::pair<std::string*, std::string>> files_of(Experiment& experiment) {
  std::vector<std::pair<std::string*, std::string>> files;
  for (RecordingSettings& recording : recordings_of(experiment).recordings)
    files.emplace_back(&recording.path, recording.id + ".csv");
  return files;
}

}  // namespace

constinit const BenchKind recordings_kind{.name = "recordings",
                                          .about = "recordings over time",
                                          .read = read_recordings,
                                          .readings = files_of,
                                          .open = [](Experiment experiment) -> std::unique_ptr<Bench> {
                                            return std::make_unique<RecordingsBench>(std::move(experiment));
                                          }};

RecordingsBench::RecordingsBench(Experiment experiment) : RecordingsBench(experiment, read_samples(experiment)) {}

RecordingsBench::RecordingsBench(Experiment experiment, std::vector<Sample> samples)
    : Bench(std::move(experiment)),
      samples_(std::move(samples)),
      replay_(make_recording_replay(experiment_, experiment_.mesh, samples_)) {
  controls_ = {make_axis("time", Quantity::time, "time")};
  drawn_label_ = "time";
  for (const ChannelSettings& channel : experiment_.channels) channels_.push_back(make_axis(channel));
  for (const Sample& sample : samples_) {
    const Reading reading{sample.line, recording(sample), {sample.time}, sample.channel, sample.value, sample.sigma};
    readings_.push_back({reading, static_cast<int>(readings_.size()), reading.trial, {}});
  }
  measurements_ = replay_.measurements;
}

size_t RecordingsBench::end_of(size_t first) const {
  size_t i = first;
  while (i < samples_.size() && samples_[i].recording == samples_[first].recording &&
         samples_[i].channel == samples_[first].channel && samples_[i].still == samples_[first].still)
    ++i;
  return i;
}

/// Frequency and decay of every channel of every recording; those too short for it are left out.
std::vector<SwingRecord> RecordingsBench::swings(const Eigen::VectorXd& predicted) const {
  std::vector<SwingRecord> swings;
  for (size_t first = 0, end = 0; first < samples_.size(); first = end) {
    end = end_of(first);
    std::vector<double> times, measured, simulated;
    for (size_t i = first; i < end; ++i) {
      times.push_back(samples_[i].time);
      measured.push_back(samples_[i].value);
      simulated.push_back(predicted[static_cast<Eigen::Index>(i)]);
    }
    if (samples_[first].still) continue;
    const bool whole = std::all_of(simulated.begin(), simulated.end(), [](double y) { return std::isfinite(y); });
    if (times.size() < 8 || !whole) continue;
    const RingDown one = ring_down(times, measured), other = ring_down(times, simulated);
    swings.push_back({recording(samples_[first]), channels_[static_cast<size_t>(samples_[first].channel)].id,
                      one.frequency, one.decay, other.frequency, other.decay});
  }
  return swings;
}

/// The simulated motions from the first to the last sample of each recording and channel.
std::vector<CurveRecord> RecordingsBench::curves(const Params& p, const std::vector<FreeParameter>& /*free*/,
                                                 const Eigen::MatrixXd& /*covariance*/, const Ask& ask) const {
  constexpr int points = 240;
  std::vector<CurveRecord> curves;
  std::vector<Sample> dense;
  for (size_t first = 0, end = 0; first < samples_.size(); first = end) {
    end = end_of(first);
    if (samples_[first].still) continue;
    const double from = samples_[first].time, to = samples_[end - 1].time;
    CurveRecord& curve = curves.emplace_back();
    curve.channel = channels_[static_cast<size_t>(samples_[first].channel)].id;
    curve.series = recording(samples_[first]);
    for (int k = 0; k <= points; ++k) {
      Sample& sample = dense.emplace_back(samples_[end - 1]);
      sample.time = from + (to - from) * k / points;
      curve.load.push_back(sample.time);
    }
  }
  const RecordingReplay replay = make_recording_replay(experiment_, experiment_.mesh, dense);
  const Prediction prediction = ask(*replay.protocol, p, {});
  Eigen::Index row = 0;
  for (CurveRecord& curve : curves) {
    for (size_t k = 0; k < curve.load.size(); ++k) curve.value.push_back(prediction.values[row++]);
    curve.se.assign(curve.load.size(), not_a_number);
  }
  return curves;
}

std::unique_ptr<Bench> RecordingsBench::with(const VariantSettings& variant) const {
  Experiment changed = experiment_;
  changed.mesh = variant.mesh;
  return std::make_unique<RecordingsBench>(std::move(changed), samples_);
}

std::string RecordingsBench::size_text() const {
  const RecordingProtocol& protocol = *replay_.protocol;
  return fmt::format("{} samples of {} recordings, {} trajectories with {} unknowns", samples_.size(),
                     protocol.recordings().size(), protocol.trajectories(), unknowns());
}

std::string RecordingsBench::effort() const {
  const RecordingProtocol& protocol = *replay_.protocol;
  return fmt::format("{} trajectories, {} steps, {} factorisations", protocol.trajectories(), protocol.steps(),
                     protocol.factorisations());
}

const std::string& RecordingsBench::recording(const Sample& sample) const {
  return recordings_of(experiment_).recordings[static_cast<size_t>(sample.recording)].id;
}

std::string RecordingsBench::recording_text(size_t index) const {
  const RecordingSettings& recording = recordings_of(experiment_).recordings[index];
  double first = 1e300, last = -1e300;
  int count = 0;
  for (const Sample& sample : samples_) {
    if (sample.recording != static_cast<int>(index)) continue;
    first = std::min(first, sample.time);
    last = std::max(last, sample.time);
    ++count;
  }
  std::string text = fmt::format("{} samples from {} to {}", count, with_unit(first, "s"), with_unit(last, "s"));
  for (const auto& [id, value] : recording.loads) text += fmt::format("; {} = {:.6g} (SI)", id, value);
  text += recording.held.empty() ? "; held at rest" : "";
  for (const auto& [id, value] : recording.held) text += fmt::format("; held by {} = {:.6g} (SI)", id, value);
  return text + fmt::format(", let go at {}", with_unit(recording.release, "s"));
}

Lines RecordingsBench::describe() const {
  const Experiment& e = experiment_;
  const Mesh& mesh = replay_.protocol->scene().model->mesh();
  Lines lines{{"data", e.simulated ? "simulated" : "measured"},
              {"mesh", fmt::format("{}D, {}: {} nodes, {} elements, {} unknowns", e.geometry.dimension,
                                   e.mesh.describe(), mesh.node_count(), mesh.element_count(), unknowns())}};
  add_material_lines(e, lines);
  const auto& [mass, stiffness] = std::pair(e.mass_damping, e.stiffness_damping);
  for (size_t m = 0; m < e.materials.size(); ++m) {
    const std::string& region = e.materials[m].region;
    std::string& text = lines[lines.size() - e.materials.size() + m].second;
    if (mass.count(region) > 0) text += fmt::format(", damping {} of its mass", with_unit(mass.at(region), "1/s"));
    if (stiffness.count(region) > 0)
      text += fmt::format(", damping {} of its stiffness", with_unit(stiffness.at(region), "s"));
  }
  for (const LoadSettings& load : e.loads)
    lines.emplace_back("load " + load.id, fmt::format("{} on {}{}", name_of(load.quantity), load.on,
                                                      load.quantity == Quantity::mass ? ", with its inertia" : ""));
  const RecordingsSettings& settings = recordings_of(e);
  lines.emplace_back("integrator",
                     fmt::format("{}, steps of {}", settings.integrator == Integrator::bdf2 ? "BDF2" : "implicit Euler",
                                 with_unit(settings.step, "s")));
  for (size_t r = 0; r < settings.recordings.size(); ++r) {
    lines.emplace_back("recording " + settings.recordings[r].id, recording_text(r));
    if (const std::string layout = recording_layout(experiment_, r); !layout.empty())
      lines.emplace_back("bench file", layout);
  }
  lines.emplace_back("trajectories", std::to_string(replay_.protocol->trajectories()));
  return lines;
}

}  // namespace taut
