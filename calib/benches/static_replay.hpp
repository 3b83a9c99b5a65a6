#pragma once
#include <functional>
#include <memory>
#include <vector>

#include "calib/benches/model.hpp"
#include "calib/fit/fit.hpp"
#include "sim/core/error.hpp"

namespace taut {

/// Readings as rows: one row per distinct (controls, channel), readings of one row are repeats.
struct BenchRows {
  std::vector<StaticRow> rows;
  std::vector<int> row_of_reading;        ///< -1: an excluded reading without repeats, for which nothing is solved
  std::vector<Measurement> measurements;  ///< of the readings that are not excluded
};
/// As the model numbers controls and channels.
BenchRows rows_of_readings(const Experiment& experiment, const BenchModel& model, const Trials& trials);

/// Readings as rows of a static protocol, which has them.
struct StaticReplay : BenchRows {
  std::unique_ptr<StaticProtocol> protocol;
  std::vector<Cable> cables;
  const Contact* contact = nullptr;                                                   ///< of its model, in 2D
  std::function<double(const Eigen::VectorXd& u, double horizon)> smallest_distance;  ///< see BuiltScene
  std::vector<const SidedTerm*> touching;                                             ///< what of its model is contact
};
/// The readings' protocol with this mesh. Throws InputError.
StaticReplay make_static_replay(const Experiment& experiment, const MeshSettings& settings, const Trials& trials);

/// That there is no parameter of this name: the nearest one, and all that there are.
InputError unknown_parameter(const Experiment& experiment, const Protocol& protocol, const std::string& id);
/// The region whose material has this constant, "E_foam" say; "": none.
std::string region_of(const Experiment& experiment, const std::string& id);

/// The experiment's free parameters with starts and bounds filled in from the model. Throws InputError for unknown ids,
/// constants of rigid regions, a start outside its bounds, and bounds outside the physical range.
std::vector<FreeParameter> free_parameters(const Experiment& experiment, const Protocol& protocol);

/// A load as a force [N] for figures: itself, a mass times gravity; other quantities as they are.
double load_in_newtons(const Experiment& experiment, Quantity quantity, double value_si);

}  // namespace taut
