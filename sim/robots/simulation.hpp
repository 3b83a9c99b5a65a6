#pragma once
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "sim/robots/schedule.hpp"
#include "sim/scene/setup.hpp"
#include "sim/solve/equilibrium.hpp"

namespace taut {

/// [[plot]]: channels and controls over one of them.
struct RobotPlot {
  std::string id, title, x;
  std::vector<std::string> y;
};

/// Static sampling of where a place can be brought in one way of actuation.
struct WorkspaceMode {
  std::string name;
  std::map<std::string, std::pair<double, double>> ranges;  ///< control id to its range, SI; others stay at the start's
};
/// [workspace].
struct WorkspaceSettings {
  std::string x, y;  ///< channels
  int samples = 0;   ///< per mode
  std::vector<WorkspaceMode> modes;
};

/// [ik]: which controls may be used within which bounds, and where points are to be brought.
struct IkRange {
  std::string id;
  double lower = 0, upper = 0;  ///< SI
  double nominal = 0;           ///< SI: where it stays when the targets leave a choice
};
/// [[ik.target]] or [[ik.path]].
struct IkTarget {
  std::string name;
  std::map<std::string, std::vector<double>> values;  ///< channel id to value, SI; a path has several, as many for each
  std::string stiffness_of;                           ///< channel along which the stiffness is meant; "": none
  double stiffness = 0;                               ///< [N/m]
  std::map<std::string, double> hold;                 ///< controls held at a value during this target, SI
};
/// [ik].
struct IkSettings {
  std::vector<IkRange> controls;
  std::vector<IkTarget> targets;
  double tolerance = 1e-4;  ///< [m]
};

/// [optimise.control.ID]: a control whose pieces may end anywhere within bounds.
struct OptimiseRange {
  std::string id;
  double lower = 0, upper = 0;   ///< SI
  std::optional<double> change;  ///< SI: a change of this size from piece to piece costs 1; none: changes cost nothing
};
/// [[optimise.goal]]: what a channel shall be at one time.
struct OptimiseGoal {
  /// What is wanted of it; reach: to come near to `value`.
  enum class Aim { maximise, minimise, reach };
  std::string channel;
  double time = 0;  ///< [s]
  Aim aim = Aim::maximise;
  double value = 0;  ///< SI, of reach
  double scale = 1;  ///< SI: a gain of this size, or a miss, counts as 1
};
/// [optimise].
struct OptimiseSettings {
  std::vector<OptimiseRange> controls;
  std::vector<OptimiseGoal> goals;
  int iterations = 100;     ///< of the search, at most
  double tolerance = 1e-6;  ///< where it ends, see optimise()
};

/// How a simulation goes from state to state; the last three are SUNDIALS'.
enum class SimulationMethod { quasi_static, implicit_euler, bdf2, cvode, arkode_implicit, arkode_explicit };

/// A simulation as its TOML file describes it: a setup, how its controls move, and what is run and shown. SI inside.
struct Simulation : Setup {
  std::string title, description;
  SimulationMethod method = SimulationMethod::implicit_euler;
  double duration = 0, step = 0;           ///< [s]
  double tolerance = 0;                    ///< 0: fixed steps
  bool from_equilibrium = false;           ///< start under loads and gravity in equilibrium, not at rest without them
  int frames = 60;                         ///< stored states
  bool rigid_segments = false;             ///< see SceneOptions::rigid_segments
  std::vector<ControlSchedule> schedules;  ///< as controls
  std::vector<RobotPlot> plots;
  std::optional<WorkspaceSettings> workspace;
  std::optional<IkSettings> ik;
  std::optional<OptimiseSettings> optimise;
  EquilibriumOptions equilibrium;
};

}  // namespace taut
