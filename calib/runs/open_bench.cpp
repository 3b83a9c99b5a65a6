#include "calib/runs/open_bench.hpp"

#include <fmt/format.h>

#include <algorithm>

#include "calib/models/beam_model.hpp"
#include "calib/models/ladder.hpp"

namespace taut {
namespace {

ModelChoice beams(const Experiment& experiment, const Trials& trials) {
  std::unique_ptr<BeamProtocol> protocol = make_beam_bench(experiment, trials).protocol;
  ModelChoice choice;
  choice.model_of = [beams = protocol.get()](int row) {
    return RowModel{std::string(name_of(Rung::beam)), beams->stated_error(row)};
  };
  choice.doubt = [beams = protocol.get()] {
    int rows = 0;
    double largest = 0;
    for (int row = 0; row < beams->row_count(); ++row) {
      const double error = beams->stated_error(row);
      rows += error <= 0.1 ? 0 : 1;
      if (error <= 0.1) largest = std::max(largest, error);
    }
    std::string text = fmt::format("; the beams state errors of up to {:.2g} %", 100 * largest);
    if (rows > 0)
      text += fmt::format(", and {} of {} rows are beyond what they describe within 10 %", rows, beams->row_count());
    return text;
  };
  choice.protocol = std::move(protocol);
  return choice;
}

ModelChoice choose(const Experiment& experiment, const Trials& trials, const StaticReplay& full) {
  if (experiment.model == Rung::beam) return beams(experiment, trials);
  if (experiment.model != Rung::automatic) return {};
  Ladder ladder = climb(experiment, trials, full);
  const auto model_of = [rows = ladder.rows](int row) {
    const RowChoice& chosen = rows[static_cast<size_t>(row)];
    return RowModel{std::string(name_of(chosen.rung)), chosen.change};
  };
  return {std::move(ladder.protocol), ladder.sentence, {}, model_of};
}

}  // namespace

std::unique_ptr<Bench> open_bench(const std::string& path, const BenchOptions& options) {
  return open_bench(read_experiment(path), options);
}

std::unique_ptr<Bench> open_bench(Experiment experiment, const BenchOptions& options) {
  experiment.equilibrium.stop = options.stop;
  if (options.threads > 0) experiment.threads = options.threads;
  const BenchKind& kind = *experiment.kind;
  std::unique_ptr<Bench> bench = kind.open(std::move(experiment));
  bench->use({start_by_beams, choose});
  return bench;
}

}  // namespace taut
