#pragma once
#include "calib/benches/static_replay.hpp"
#include "calib/files/experiment.hpp"
#include "sim/contact/contact.hpp"
#include "sim/shapes/push_puppet.hpp"

// The reference push-puppet module on its bench, for tests and benchmarks: four retractions, four hung masses.
namespace taut::test {

inline const std::vector<double> kRetractions{0, 5.89e-3, 11.79e-3, 17.68e-3};
inline const std::vector<double> kMasses{0.050, 0.100, 0.200, 0.500};

/// Makes an experiment's module another one, with its own cables.
inline void set_module(Experiment& e, const PushPuppet& module) {
  e.geometry.shape = std::make_shared<PushPuppet>(module);
  for (CableSettings& cable : e.cables.cables) {
    cable.points.clear();
    for (const Eigen::Vector2d& point : cable_path(module, cable.id == "upper" ? 1 : -1))
      cable.points.push_back({point[0], point[1]});
  }
}

/// Linear: 1.4 mm, 2.7 k unknowns; quadratic: 2.6 mm, 4.5 k.
inline Experiment reference_module(int order = 2) {
  Experiment e = read_experiment(TAUT_SOURCE_DIR "/experiments/push_puppet/experiment.toml");
  set_module(e, PushPuppet{});
  e.cables.k = 20e3;
  e.materials[0].constants["E"] = 50e3;
  e.mesh.order = order;
  e.mesh.size = order == 1 ? 1.4e-3 : 2.6e-3;
  return e;
}

/// One reading per condition, without values; condition = 4 * retraction + mass.
inline Trials conditions_of(const std::vector<double>& retractions = kRetractions,
                            const std::vector<double>& masses = kMasses) {
  Trials trials;
  trials.control_ids = {"mass", "retraction"};
  trials.control_quantities = {Quantity::mass, Quantity::length};
  trials.control_values = {{masses.begin(), masses.end()}, {retractions.begin(), retractions.end()}};
  trials.channel_ids = {"tip"};
  for (double retraction : retractions) {
    for (double mass : masses) {
      Reading reading;
      reading.controls = {mass, retraction};
      reading.sigma = 1;
      trials.readings.push_back(reading);
    }
  }
  return trials;
}

/// Effective stiffness F / drop [N/m] of row 4 * retraction + mass.
inline double stiffness(const Prediction& prediction, size_t retraction, size_t mass) {
  return kMasses[mass] * 9.81 / prediction.values[static_cast<Eigen::Index>(4 * retraction + mass)];
}

}  // namespace taut::test
