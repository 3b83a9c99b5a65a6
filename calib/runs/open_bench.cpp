#include "calib/runs/open_bench.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "calib/benches/material_point_bench.hpp"
#include "calib/benches/specimens_bench.hpp"
#include "calib/data/plan.hpp"
#include "calib/models/beam_model.hpp"
#include "calib/models/ladder.hpp"
#include "calib/models/rod_model.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

/// All rows by a model that states its errors.
template <class StatingProtocol>
ModelChoice one_rung(Rung rung, std::unique_ptr<StatingProtocol> protocol) {
  ModelChoice choice;
  choice.one_model = true;
  choice.unknowns = protocol->unknowns();
  choice.model_of = [model = protocol.get(), rung](int row) {
    RowModel of_row{std::string(name_of(rung)), model->stated_error(row)};
    if constexpr (requires { model->moved(row); }) of_row.of = model->moved(row);
    return of_row;
  };
  choice.doubt = [model = protocol.get(), rung] {
    int rows = 0;
    double largest = 0;
    for (int row = 0; row < model->row_count(); ++row) {
      const double error = model->stated_error(row);
      rows += error <= 0.1 ? 0 : 1;
      if (error <= 0.1) largest = std::max(largest, error);
    }
    std::string text = fmt::format("; the {} states errors of up to {:.2g} %", name_of(rung), 100 * largest);
    if (rows > 0)
      text += fmt::format(", and {} of {} rows are beyond what it describes within 10 %", rows, model->row_count());
    return text;
  };
  choice.protocol = std::move(protocol);
  return choice;
}

ModelChoice choose(const Experiment& experiment, const Trials& trials, const StaticReplay& full,
                   const std::vector<Dimension>& dimensions) {
  if (experiment.model == Rung::beam) {
    ModelChoice choice = one_rung(Rung::beam, make_beam_bench(experiment, trials).protocol);
    choice.text = "chain of beams";
    return choice;
  }
  if (experiment.model == Rung::rod) {
    RodBench rod = make_rod_bench(experiment, trials, dimensions);
    const std::string text = fmt::format("rod of {} elements", rod.protocol->elements());
    const auto state = [model = rod.protocol.get(), &mesh = full.protocol->scene().model->mesh()](
                           const auto& controls) { return model->displacements(mesh, controls); };
    ModelChoice choice = one_rung(Rung::rod, std::move(rod.protocol));
    choice.state = state;
    choice.text = text;
    choice.dimensions = dimensions;
    choice.compared = false;
    return choice;
  }
  if (experiment.model != Rung::automatic) return {};
  Ladder ladder = climb(experiment, trials, full);
  const auto model_of = [rows = ladder.rows](int row) {
    const RowChoice& chosen = rows[static_cast<size_t>(row)];
    return RowModel{std::string(name_of(chosen.rung)), chosen.change};
  };
  ModelChoice choice;
  choice.protocol = std::move(ladder.protocol);
  choice.sentence = ladder.sentence;
  choice.model_of = model_of;
  return choice;
}

/// The bench of rows that are not measured yet; null: it has readings, or they are needed.
std::unique_ptr<Bench> open_plan(const Experiment& experiment, const BenchOptions& options) {
  const bool point = experiment.kind == &material_point_kind;
  if (!point && experiment.kind != &static_kind) {
    if (!options.rows.empty())
      throw InputError(
          fmt::format("{}: --rows: {} has no rows of controls; leave it out", experiment.path, experiment.kind->about));
    return nullptr;
  }
  if (options.rows.empty() && options.readings == Readings::needed) return nullptr;
  // Where rows say how large the specimen is, there is none without rows.
  const bool rows_needed = options.readings != Readings::rows_may_be_missing || !experiment.set_by.empty();
  std::optional<Trials> trials = read_plan(experiment.bench, options.rows, rows_needed);
  if (!trials) return nullptr;
  if (point) return std::make_unique<MaterialPointBench>(experiment, *std::move(trials));
  return open_static_bench(experiment, *std::move(trials));
}

}  // namespace

std::optional<int> planned_rows(const Bench& bench) {
  std::set<int> lines;
  for (const BenchReading& reading : bench.readings()) {
    if (!std::isnan(reading.value)) return std::nullopt;
    if (reading.line > 0) lines.insert(reading.line);
  }
  return static_cast<int>(lines.size());
}

std::unique_ptr<Bench> open_bench(const std::string& path, const BenchOptions& options) {
  return open_bench(read_experiment(path), options);
}

std::unique_ptr<Bench> open_bench(Experiment experiment, const BenchOptions& options) {
  experiment.equilibrium.stop = options.stop;
  if (options.threads > 0) experiment.threads = options.threads;
  std::unique_ptr<Bench> bench = open_plan(experiment, options);
  if (!bench) {
    const BenchKind& kind = *experiment.kind;
    bench = kind.open(std::move(experiment));
  }
  bench->use({start_by_beams, choose});
  return bench;
}

}  // namespace taut
