#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <boost/program_options.hpp>
#include <nlohmann/json.hpp>

#include "calib/runs/open_bench.hpp"
#include "calib/runs/run_fit.hpp"
#include "experiments/cli/print.hpp"
#include "experiments/cli/simulate_command.hpp"
#include "sim/core/error.hpp"
#include "sim/files/simulation.hpp"
#include "sim/mesh/topology.hpp"

namespace taut {
namespace {

nlohmann::ordered_json check_json(const RunRecord& record, const ParameterTable& table,
                                  const std::vector<FreeParameter>& free, std::optional<int> planned) {
  nlohmann::ordered_json json{{"title", record.title}, {"data", record.simulated ? "simulated" : "measured"}};
  for (const auto& [label, text] : record.setup) json["setup"].push_back({label, text});
  json["free"] = nlohmann::ordered_json::array();
  for (const FreeParameter& p : free)
    json["free"].push_back(
        {{"id", table[p.index].id}, {"start", p.start}, {"bounds", {p.lower, p.upper}}, {"unit", table[p.index].unit}});
  if (planned) json["rows_without_readings"] = *planned;
  json["warnings"] = record.remarks;
  return json;
}

/// "12 facets, x 0 to 60, y 12 to 12 mm, centre (30, 12) mm": what a tag of the mesh is, and where.
std::string tag_text(const Mesh& mesh, const Tag& tag) {
  const std::array<const char*, 3> names{"point", "line", "facet"};
  const bool facets = tag.dimension == mesh.dimension() - 1;
  std::string text = fmt::format("{} {}{}", tag.count(), facets ? "facet" : names[static_cast<size_t>(tag.dimension)],
                                 tag.count() == 1 ? "" : "s");
  const std::vector<int> nodes = tag.nodes();
  if (nodes.empty()) return text;
  Eigen::VectorXd lower = mesh.node(nodes.front()), upper = lower;
  for (int node : nodes) {
    lower = lower.cwiseMin(mesh.node(node));
    upper = upper.cwiseMax(mesh.node(node));
  }
  for (Eigen::Index c = 0; c < lower.size(); ++c)
    text += fmt::format(", {} {:.4g} to {:.4g}", "xyz"[c], 1e3 * lower[c], 1e3 * upper[c]);
  return text + " mm, centre " + in_millimetres(0.5 * (lower + upper));
}

/// Where the tags of the mesh are, one line each: on the wrong one a support or load is as right as on any other.
void add_tags(const Bench& bench, RunRecord& record) {
  const Mesh* mesh = bench.states().mesh;
  if (mesh == nullptr) return;
  for (const auto& [name, tag] : mesh->tags) record.setup.emplace_back("tag " + name, tag_text(*mesh, tag));
}

/// What a plan waits for, and how to go on; "": the bench has readings.
std::string missing_readings(const Bench& bench, const CommandOptions& options) {
  const std::optional<int> rows = planned_rows(bench);
  if (!rows) return "";
  const BenchFormat& format = bench.experiment().bench;
  if (!options.rows.empty())
    return fmt::format("{} holds no readings: `taut replay {} --rows {}` predicts its rows", options.rows,
                       options.target, options.rows);
  std::vector<std::string> set, read;  // columns
  for (const BenchFormat::Control& control : format.controls) set.push_back(control.column);
  for (const BenchFormat::Channel& channel : format.channels) {
    const std::string& column = channel.column.empty() ? format.value_column : channel.column;
    if (std::ranges::find(read, column) == read.end()) read.push_back(column);
  }
  if (*rows == 0)
    return fmt::format("{}: there is a header and no row yet; add a row per reading, with {}", format.path,
                       set.empty() ? "what was read" : "what was set (" + join(set) + ")");
  return fmt::format(
      "{}: {} rows, and no reading yet; fill in {}, then run `taut fit {}` (`taut replay {}` predicts them)",
      format.path, *rows, join(read), options.target, options.target);
}

/// Reads experiment, bench and model, says what was understood and what cannot be right.
int check_main(const CommandOptions& options) {
  if (is_simulation(options.target)) return check_simulation(options);
  const std::unique_ptr<Bench> bench =
      open_bench(options.target, {options.threads, options.stop, Readings::rows_may_be_missing, options.rows});
  RunRecord record = start_record(*bench);
  if (const std::string missing = missing_readings(*bench, options); !missing.empty())
    record.remarks.insert(record.remarks.begin(), missing);
  record.setup.emplace_back("size", bench->size_text());
  add_tags(*bench, record);
  const ParameterTable& table = bench->protocol().parameters();
  if (options.json)
    print_json(check_json(record, table, bench->free(), planned_rows(*bench)));
  else
    print_check(record, table, bench->free());
  return options.strict && !record.remarks.empty() ? exit_input : exit_ok;
}

void add_check_options(AddOption add, CommandOptions& options) {
  add("strict", boost::program_options::bool_switch(&options.strict), "exit code 2 when there is a warning");
  add("rows", boost::program_options::value(&options.rows)->value_name("FILE"),
      "CSV file with the columns of controls, instead of the bench file, which need not be there");
}

}  // namespace

Command check_command() {
  return {"check",
          "EXPERIMENT",
          "Reads an experiment and its bench, says what it understood and what cannot be right; solves beams only. The "
          "bench may still be empty.",
          "  taut check experiments/silicone_block/experiment.toml\n",
          add_check_options,
          check_main};
}

}  // namespace taut
