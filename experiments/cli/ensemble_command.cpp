#include <fmt/format.h>

#include <boost/program_options.hpp>
#include <limits>

#include "calib/data/run_folder.hpp"
#include "calib/runs/open_bench.hpp"
#include "calib/runs/provenance.hpp"
#include "calib/studies/crew.hpp"
#include "experiments/cli/commands.hpp"
#include "experiments/cli/ensemble_output.hpp"
#include "experiments/cli/print.hpp"
#include "experiments/cli/progress.hpp"
#include "reports/ensemble_run.hpp"
#include "reports/run_record.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

namespace po = boost::program_options;

EnsembleTask task_of(const CommandOptions& options) {
  constexpr std::pair<EnsembleKind, unsigned> kinds[] = {{EnsembleKind::posterior, 500},
                                                         {EnsembleKind::bootstrap, 500},
                                                         {EnsembleKind::starts, 50},
                                                         {EnsembleKind::profiles, 100}};
  std::vector<std::string> names;
  for (const auto& [kind, count] : kinds) {
    names.emplace_back(name_of(kind));
    if (options.name == names.back())
      return {kind, members_asked(options.members, "--members", count), seed_of(options)};
  }
  throw InputError(fmt::format("taut ensemble: '{}' is no ensemble{}; ensembles: {}", options.name,
                               did_you_mean(options.name, names), join(names)));
}

/// Makes, or goes on with, an ensemble of a run.
int ensemble_main(const CommandOptions& options) {
  const EnsembleTask task = task_of(options);
  settle_run_folder(options.target);
  RunRecord record = read_run(options.target);
  check_inputs(record, options.target);
  const int threads = options.messages != nullptr && options.threads == 0 ? 1 : options.threads;
  const std::unique_ptr<Bench> bench = open_bench(experiment_of_run(record, options.target), {threads, options.stop});
  Progress progress(options.quiet);
  const EnsembleRun run = run_ensemble_of(record, *bench, task, ensemble_options(options, progress), options.target);
  if (options.messages != nullptr && options.messages->rank() > 0) return exit_ok;
  return end_ensemble(options, run, task, progress);
}

void add_ensemble_options(AddOption add, CommandOptions& options) {
  add("members", po::value(&options.members)->value_name("N"),
      "how many; default: 500, of starts 50, of profiles 100 over all parameters");
  add("seed", po::value(&options.seed)->value_name("N"), "of what is drawn; default: 1");
  add_shard(add, options);
  add_threads(add, options);
}

}  // namespace

Command ensemble_command() {
  Command command{
      "ensemble",
      "posterior|bootstrap|starts|profiles RUN_FOLDER",
      "Draws from the posterior of a run's parameters, fits readings that are drawn anew (bootstrap), fits from "
      "other starts, or along the profile of each parameter: on several cores or machines under mpirun or by --shard, "
      "resumable, the same "
      "result to the last digit.",
      "  taut ensemble posterior runs/foam_cantilever --members 200\n"
      "  mpirun -n 4 taut ensemble bootstrap runs/push_puppet\n"
      "  taut ensemble profiles runs/push_puppet --shard 2/4\n",
      add_ensemble_options,
      ensemble_main,
      {&CommandOptions::name, &CommandOptions::target}};
  command.together = true;
  return command;
}

}  // namespace taut
