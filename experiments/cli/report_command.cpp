#include <fmt/format.h>

#include <filesystem>
#include <nlohmann/json.hpp>

#include "calib/data/run_folder.hpp"
#include "calib/runs/provenance.hpp"
#include "experiments/cli/commands.hpp"
#include "experiments/cli/print.hpp"
#include "reports/report.hpp"
#include "reports/run_record.hpp"

namespace taut {
namespace {

/// Rebuilds figures and report of a run from its fit.json.
int report_main(const CommandOptions& options) {
  settle_run_folder(options.target);
  const RunRecord record = read_run(options.target);
  check_inputs(record, options.target);
  RunFolder folder(options.target);
  write_run(record, folder.next());
  folder.publish(RunFolder::Publish::part);
  const std::string page = (std::filesystem::path(options.target) / "report.html").string();
  if (options.json)
    print_json(nlohmann::ordered_json{{"report", page}}, -1);
  else
    fmt::print("{}\n", page);
  return exit_ok;
}

}  // namespace

Command report_command() {
  return {"report",
          "RUN_FOLDER",
          "Rebuilds figures and report of a run from its fit.json, without solving.",
          "  taut report runs/silicone_block\n",
          nullptr,
          report_main};
}

}  // namespace taut
