#include "calib/runs/provenance.hpp"

#include <ceres/version.h>
#include <cholmod.h>
#include <fmt/format.h>
#include <sys/utsname.h>

#include <Eigen/Core>
#include <boost/version.hpp>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <thread>

#include "calib/benches/bench.hpp"
#include "calib/data/files.hpp"
#include "calib/files/experiment.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

namespace fs = std::filesystem;

/// Libraries it was built with: name, version.
std::vector<std::pair<std::string, std::string>> library_versions() {
  return {{"Eigen", fmt::format("{}.{}.{}", EIGEN_WORLD_VERSION, EIGEN_MAJOR_VERSION, EIGEN_MINOR_VERSION)},
          {"Ceres", CERES_VERSION_STRING},
          {"CHOLMOD", fmt::format("{}.{}.{}", CHOLMOD_MAIN_VERSION, CHOLMOD_SUB_VERSION, CHOLMOD_SUBSUB_VERSION)},
          {"Boost", fmt::format("{}.{}.{}", BOOST_VERSION / 100000, BOOST_VERSION / 100 % 1000, BOOST_VERSION % 100)},
          {"compiler", __VERSION__}};
}

/// Processor, cores and system.
std::string machine_description() {
  std::string processor = "unknown processor";
  std::ifstream cpuinfo("/proc/cpuinfo");
  for (std::string line; std::getline(cpuinfo, line);) {
    if (line.starts_with("model name")) {
      processor = line.substr(line.find(':') + 2);
      break;
    }
  }
  utsname system{};
  uname(&system);
  return fmt::format("{}, {} cores, {} {}", processor, std::thread::hardware_concurrency(), system.sysname,
                     system.machine);
}

/// Now in UTC, ISO 8601.
std::string utc_now() {
  const std::time_t now = std::chrono::system_clock::to_time_t(std::chrono::system_clock::now());
  std::tm utc{};
  gmtime_r(&now, &utc);
  char text[32];
  std::strftime(text, sizeof text, "%Y-%m-%dT%H:%M:%SZ", &utc);
  return text;
}

/// The files that a bench was made from, with their hashes.
std::vector<InputRecord> input_records(const Bench& bench) {
  std::vector<InputRecord> inputs;
  for (const RunInput& file : inputs_of(bench.experiment()))
    inputs.push_back({file.path, file.copy, file.text ? sha256_of_text(*file.text) : sha256_of(file.path), file.text});
  return inputs;
}

}  // namespace

Provenance provenance_of(const Program& program, const Bench& bench) {
  Provenance provenance;
  provenance.version = program.version;
  provenance.commit = program.commit;
  provenance.libraries = library_versions();
  provenance.command_line = program.command_line;
  provenance.inputs = input_records(bench);
  provenance.started = utc_now();
  provenance.machine = machine_description();
  return provenance;
}

void copy_inputs(const std::vector<InputRecord>& inputs, const std::string& folder) {
  for (const InputRecord& input : inputs) {
    const std::string copy = (fs::path(folder) / input.copy).string();
    fs::create_directories(fs::path(copy).parent_path());
    write_file(copy, input.text ? *input.text : read_file(input.path));
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

std::string fingerprint_of(const Program& program, const std::vector<InputRecord>& inputs) {
  std::string text = "taut " + program.version + " " + sha256_of(program.file);
  for (const InputRecord& input : inputs) text += " " + input.sha256;
  return text;
}

}  // namespace taut
