#include "experiments/cli/run_inputs.hpp"

#include <fmt/format.h>

#include <filesystem>

#include "calib/data/files.hpp"
#include "calib/files/experiment.hpp"
#include "experiments/cli/version.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

namespace fs = std::filesystem;

}  // namespace

std::vector<InputRecord> inputs_of(const Bench& bench) {
  std::vector<InputRecord> inputs;
  for (const RunInput& file : taut::inputs_of(bench.experiment()))
    inputs.push_back({file.path, file.copy, sha256_of(file.path)});
  return inputs;
}

void copy_inputs(const std::vector<InputRecord>& inputs, const std::string& folder) {
  for (const InputRecord& input : inputs) {
    const std::string copy = (fs::path(folder) / input.copy).string();
    write_file(copy, read_file(input.path));
    if (sha256_of(copy) != input.sha256)
      throw InputError(
          fmt::format("{}: changed while the fit was running, which was of the file before; fit again", input.path));
  }
}

void check_inputs(const RunRecord& record, const std::string& folder) {
  for (const InputRecord& input : record.provenance.inputs) {
    const std::string copy = (fs::path(folder) / input.copy).string();
    if (sha256_of(copy) == input.sha256) continue;
    throw InputError(fmt::format(
        "{}: is not the file that fit.json beside it was made from; what it says would be wrong: fit again", copy));
  }
}

Experiment experiment_of_run(const RunRecord& record, const std::string& folder) {
  check_inputs(record, folder);
  return read_copies(folder);
}

std::string fingerprint_of(const std::vector<InputRecord>& inputs) {
  std::string text = "taut " + version() + " " + sha256_of("/proc/self/exe");
  for (const InputRecord& input : inputs) text += " " + input.sha256;
  return text;
}

}  // namespace taut
