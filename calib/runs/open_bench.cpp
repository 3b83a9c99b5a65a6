#include "calib/runs/open_bench.hpp"

#include <fmt/format.h>

#include "calib/benches/material_point_bench.hpp"
#include "calib/benches/recordings_bench.hpp"
#include "calib/benches/static_bench.hpp"
#include "calib/models/beam_model.hpp"
#include "calib/models/ladder.hpp"

namespace taut {
namespace {

ModelChoice beams(const Experiment& experiment, const Trials& trials) {
  std::unique_ptr<BeamProtocol> protocol = make_beam_bench(experiment, trials).protocol;
  ModelChoice choice;
  choice.doubt = [beams = protocol.get()] {
    int rows = 0;
    for (int row = 0; row < beams->row_count(); ++row) rows += beams->stated_error(row) <= 0.1 ? 0 : 1;
    return rows == 0 ? std::string()
                     : fmt::format("; {} of {} rows are beyond what a chain of beams describes within 10 %", rows,
                                   beams->row_count());
  };
  choice.protocol = std::move(protocol);
  return choice;
}

std::unique_ptr<Bench> open_static(Experiment experiment) {
  Trials trials = read_trials(experiment.bench);
  auto bench = std::make_unique<StaticBench>(std::move(experiment), std::move(trials));
  bench->start_by([](const Experiment& e, const Trials& t, const std::vector<FreeParameter>& free) {
    return start_by_beams(e, t, free);
  });
  if (bench->experiment().model == Rung::beam) bench->predict_by(beams(bench->experiment(), bench->trials()));
  if (bench->experiment().model == Rung::automatic) {
    Ladder ladder = climb(bench->experiment(), bench->trials(), bench->full());
    bench->predict_by({std::move(ladder.protocol), ladder.sentence, {}});
  }
  return bench;
}

}  // namespace

std::unique_ptr<Bench> open_bench(const std::string& path, const BenchOptions& options) {
  return open_bench(read_experiment(path), options);
}

std::unique_ptr<Bench> open_bench(Experiment experiment, const BenchOptions& options) {
  experiment.equilibrium.stop = options.stop;
  if (options.threads > 0) experiment.threads = options.threads;
  if (experiment.recordings) return std::make_unique<RecordingsBench>(std::move(experiment));
  if (!experiment.material_point) return open_static(std::move(experiment));
  Trials trials = read_trials(experiment.bench);
  return std::make_unique<MaterialPointBench>(std::move(experiment), std::move(trials));
}

}  // namespace taut
