#include "tests/fuzz/targets.hpp"

#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <stdexcept>

#include "calib/data/trials.hpp"
#include "calib/files/experiment.hpp"
#include "reports/report.hpp"
#include "sim/core/error.hpp"
#include "sim/core/units.hpp"
#include "sim/files/simulation.hpp"
#include "sim/mesh/msh_file.hpp"
#include "tests/support/run_records.hpp"

namespace taut::fuzz {
namespace {

namespace fs = std::filesystem;

std::string content(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  if (!file || text.str().empty()) throw std::runtime_error("no seed: " + path.string());
  return text.str();
}

/// A folder of this process, which goes with it.
class Place {
 public:
  Place() {
    std::string name = (fs::temp_directory_path() / "taut_fuzz_XXXXXX").string();
    if (mkdtemp(name.data()) == nullptr) throw std::runtime_error("no temporary folder");
    folder_ = name;
  }
  ~Place() {
    std::error_code ignored;
    fs::remove_all(folder_, ignored);
  }
  Place(const Place&) = delete;
  Place& operator=(const Place&) = delete;
  std::string write(const std::string& name, std::string_view bytes) const {
    std::ofstream(folder_ / name, std::ios::binary) << bytes;
    return (folder_ / name).string();
  }
  std::string path() const { return folder_.string(); }

 private:
  fs::path folder_;
};

const Place& place() {
  static const Place one;
  return one;
}

const fs::path source(TAUT_SOURCE_DIR);

void take_csv(std::string_view bytes) {
  BenchFormat format;
  format.path = place().write("bench.csv", bytes);
  format.trial_column = "trial";
  format.controls = {{"load", "load_N", {Quantity::force, Quantity::mass}}};
  format.channels = {{"tip", "tip_mm", Quantity::length, {1e-4, 0, 0}}};
  read_trials(format);
}

std::vector<std::string> csv_seeds() {
  return {"trial,load_N,tip_mm\na,0.05,1\na,0.1,2\nb,0.05,1.1\nb,0.1,2.1\n",
          "# a machine's\ntrial;load_N;tip_mm\n\"a\";0,05;1,5\n\"b\";1.000,5;NaN\n",
          "\xEF\xBB\xBFtrial\tload_N\ttip_mm\r\na\t0.05\t1\r\nb\t0.05\t1\r\n"};
}

void take_experiment(std::string_view bytes) {
  read_experiment_text((source / "experiments/foam_cantilever/experiment.toml").string(), bytes);
}

std::vector<std::string> experiment_seeds() {
  std::vector<std::string> seeds;
  for (const char* name : {"foam_cantilever", "foam_point", "push_puppet", "silicone_swing", "tentacle"})
    seeds.push_back(content(source / "experiments" / name / "experiment.toml"));
  return seeds;
}

void take_simulation(std::string_view bytes) {
  read_simulation_text((source / "experiments/arm/experiment.toml").string(), bytes);
}

std::vector<std::string> simulation_seeds() {
  std::vector<std::string> seeds{content(source / "tests/support/robot.toml")};
  for (const char* name : {"ball_impact", "finger_bend", "sheet", "twist", "gripper_3d"})
    seeds.push_back(content(source / "experiments" / name / "experiment.toml"));
  return seeds;
}

void take_units(std::string_view bytes) {
  for (int k = static_cast<int>(Quantity::pure); k <= static_cast<int>(Quantity::torque); ++k) {
    try {
      parse_quantity(bytes, static_cast<Quantity>(k), "here");
    } catch (const InputError&) {
      continue;
    }
  }
  parse_number(bytes);
  unit_in_header(bytes);
}

std::vector<std::string> units_seeds() {
  return {"30 mm",        "-1.5e-3 N/mm", "2 %",           "9.81 m/s2", "1,5 kPa",
          "tip load (N)", "time [ms]",    "0.1 \xC2\xB5m", "12 deg"};
}

/// Only what taut reads itself: all else is Gmsh's, in a process of its own.
void take_msh(std::string_view bytes) {
  std::istringstream text{std::string(bytes)};
  std::string first, version, type;
  text >> first >> version >> type;
  if (first == "$NOD" || (first == "$MeshFormat" && ((version != "4.1" && version != "2.2") || type != "0"))) return;
  read_msh(place().write("mesh.msh", bytes), 1e-3);
}

std::vector<std::string> msh_seeds() {
  return {
      "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n2\n1 1 \"left\"\n2 2 \"foam\"\n$EndPhysicalNames\n"
      "$Nodes\n4\n1 0 0 0\n2 10 0 0\n3 10 10 0\n4 0 10 0\n$EndNodes\n$Elements\n3\n1 1 2 1 1 4 1\n2 2 2 2 1 1 2 3\n"
      "3 2 2 2 1 1 3 4\n$EndElements\n",
      "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$PhysicalNames\n1\n3 7 \"foam\"\n$EndPhysicalNames\n$Entities\n0 0 0 1\n"
      "1 0 0 0 1 1 1 1 7 0\n$EndEntities\n$Nodes\n1 4 1 4\n3 1 0 4\n1\n2\n3\n4\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n$EndNodes\n"
      "$Elements\n1 1 1 1\n3 1 4 1\n1 1 2 3 4\n$EndElements\n"};
}

void take_record(std::string_view bytes) {
  place().write("fit.json", bytes);
  const RunRecord record = read_run(place().path());
  to_json(record);
  predictions_csv(record);
}

std::vector<std::string> record_seeds() {
  RunRecord small = test::hanging_block();
  small.curves.resize(1);
  small.curves[0].load.resize(3);
  small.curves[0].value.resize(3);
  small.curves[0].se.resize(3);
  small.curves[0].increment_se.resize(3);
  small.shapes.resize(1);
  small.shapes[0].segments.resize(2);
  return {to_json(small)};
}

}  // namespace

const std::vector<Target>& targets() {
  static const std::vector<Target> all{{"csv", take_csv, csv_seeds},
                                       {"experiment", take_experiment, experiment_seeds},
                                       {"simulation", take_simulation, simulation_seeds},
                                       {"units", take_units, units_seeds},
                                       {"msh", take_msh, msh_seeds},
                                       {"record", take_record, record_seeds}};
  return all;
}

}  // namespace taut::fuzz
