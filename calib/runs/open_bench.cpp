#include "calib/runs/open_bench.hpp"

#include <fmt/format.h>

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

ModelChoice choose(const Experiment& experiment, const Trials& trials, const StaticReplay& full) {
  if (experiment.model == Rung::beam) return beams(experiment, trials);
  if (experiment.model != Rung::automatic) return {};
  Ladder ladder = climb(experiment, trials, full);
  return {std::move(ladder.protocol), ladder.sentence, {}};
}

}  // namespace

std::unique_ptr<Bench> open_bench(const std::string& path, const BenchOptions& options) {
  return open_bench(read_experiment(path), options);
}

std::unique_ptr<Bench> open_bench(Experiment experiment, const BenchOptions& options) {
  experiment.equilibrium.stop = options.stop;
  if (options.threads > 0) experiment.threads = options.threads;
  std::unique_ptr<Bench> bench = experiment.kind->open(std::move(experiment));
  bench->use({start_by_beams, choose});
  return bench;
}

}  // namespace taut
