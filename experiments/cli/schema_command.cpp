#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "experiments/cli/commands.hpp"
#include "experiments/cli/print.hpp"
#include "experiments/cli/schema.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

/// Prints the JSON Schema of a language of files.
int schema_main(const CommandOptions& options) {
  const std::vector<std::string> languages{"experiment", "simulation"};
  if (options.name != languages[0] && options.name != languages[1])
    throw InputError(fmt::format("taut schema: '{}' is no language of files{}; allowed: {}", options.name,
                                 did_you_mean(options.name, languages), join(languages)));
  print_json(schema_of(options.name));
  return exit_ok;
}

}  // namespace

Command schema_command() {
  return {"schema",
          "experiment|simulation",
          "Prints the JSON Schema of such files, by which editors complete keys and underline those that are wrong.",
          "  taut schema experiment > experiment.schema.json\n",
          nullptr,
          schema_main,
          {&CommandOptions::name}};
}

}  // namespace taut
