#include <fmt/format.h>

#include <boost/program_options.hpp>
#include <nlohmann/json.hpp>

#include "calib/runs/open_bench.hpp"
#include "calib/runs/run_fit.hpp"
#include "experiments/cli/print.hpp"
#include "experiments/cli/simulate_command.hpp"
#include "sim/files/simulation.hpp"

namespace taut {
namespace {

nlohmann::ordered_json check_json(const RunRecord& record, const ParameterTable& table,
                                  const std::vector<FreeParameter>& free) {
  nlohmann::ordered_json json{{"title", record.title}, {"data", record.simulated ? "simulated" : "measured"}};
  for (const auto& [label, text] : record.setup) json["setup"].push_back({label, text});
  json["free"] = nlohmann::ordered_json::array();
  for (const FreeParameter& p : free)
    json["free"].push_back(
        {{"id", table[p.index].id}, {"start", p.start}, {"bounds", {p.lower, p.upper}}, {"unit", table[p.index].unit}});
  json["warnings"] = record.remarks;
  return json;
}

/// Reads experiment, bench and model, says what was understood and what cannot be right.
int check_main(const CommandOptions& options) {
  if (is_simulation(options.target)) return check_simulation(options);
  const std::unique_ptr<Bench> bench = open_bench(options.target, {options.threads, options.stop});
  RunRecord record = start_record(*bench);
  record.setup.emplace_back("size", bench->size_text());
  const ParameterTable& table = bench->protocol().parameters();
  if (options.json)
    print_json(check_json(record, table, bench->free()));
  else
    print_check(record, table, bench->free());
  return options.strict && !record.remarks.empty() ? exit_input : exit_ok;
}

void add_check_options(AddOption add, CommandOptions& options) {
  add("strict", boost::program_options::bool_switch(&options.strict), "exit code 2 when there is a warning");
}

}  // namespace

Command check_command() {
  return {"check",
          "EXPERIMENT",
          "Reads an experiment and its bench, says what it understood and what cannot be right; solves beams only.",
          "  taut check experiments/silicone_block/experiment.toml\n",
          add_check_options,
          check_main};
}

}  // namespace taut
