#pragma once
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "sim/robots/schedule.hpp"
#include "sim/scene/setup.hpp"
#include "sim/solve/equilibrium.hpp"
#include "sim/terms/inertia.hpp"

namespace taut {

/// One separate body of a simulation: its geometry about its own origin, and where it is put.
struct BodySettings {
  std::string name;
  GeometrySettings geometry;
  MeshSettings mesh;
  std::vector<double> at;        ///< [m]
  double angle = 0;              ///< about z, counter-clockwise, before it is put there [rad]
  std::vector<double> velocity;  ///< at the start [m/s]; empty: none
  std::vector<std::pair<std::string, std::vector<int>>> fixed;  ///< tags of the body and their clamped components
};

struct ControlSettings {
  std::string id;
  Quantity quantity = Quantity::length;
  ControlSchedule schedule;
};

struct RobotCable {
  CableSettings path;  ///< points in the body's own frame; empty: the body's own cable called path.id
  std::string id, body;
  double k = 0, slack = 0, smoothing = 2e-6;  ///< [N/m], [m], [m]
};

struct RobotJoint {
  std::string id;
  std::string first, second;                   ///< bodies; "world" for the first
  std::vector<double> at, axis_end, motor_at;  ///< [m], in the world at rest
  double radius = 0;                           ///< [m]
  std::optional<double> stiffness;
  std::string control;  ///< id of the angle; "": a free pin
};

struct RobotLoad {
  std::string id, on;
  std::vector<double> direction;
  Quantity quantity = Quantity::force;  ///< force, or a mass that hangs there (weight and inertia)
  double value = 0;                     ///< SI, or
  std::string control;
};

/// What is recorded at every step.
struct RobotChannel {
  enum class Kind {
    position,      ///< of a tag's mean or a body's centre of mass, along `direction` [m]
    displacement,  ///< the same from rest
    rotation,      ///< of a tag's facets about z (2D) or `direction` (3D), from rest [rad]
    tension,       ///< of a cable [N]
    joint_gap,     ///< [m]
    joint_angle,   ///< [rad]
    joint_torque,  ///< [Nm]
    net_force      ///< on a body by all others but gravity, along `direction` [N]: mass times acceleration less weight
  };
  std::string id;
  Kind kind = Kind::position;
  std::string of;  ///< tag ("link1.tip"), body, cable or joint
  std::vector<double> direction;
};

struct RobotPlot {
  std::string id, title, x;
  std::vector<std::string> y;
};

/// Static sampling of where a place can be brought in one way of actuation.
struct WorkspaceMode {
  std::string name;
  std::map<std::string, std::pair<double, double>> ranges;  ///< control id to its range, SI; others stay at the start's
};
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
struct IkTarget {
  std::string name;
  std::map<std::string, std::vector<double>> values;  ///< channel id to value, SI; a path has several, as many for each
  std::string stiffness_of;                           ///< channel along which the stiffness is meant; "": none
  double stiffness = 0;                               ///< [N/m]
  std::map<std::string, double> hold;                 ///< controls held at a value during this target, SI
};
struct IkSettings {
  std::vector<IkRange> controls;
  std::vector<IkTarget> targets;
  double tolerance = 1e-4;  ///< [m]
};

enum class SimulationMethod { quasi_static, implicit_euler, bdf2, cvode, arkode_implicit, arkode_explicit };

/// A simulation as its TOML file describes it: bodies, what connects and moves them, and what is recorded. SI inside.
struct Simulation {
  std::string path, title, description;
  int dimension = 2;
  double thickness = 1;
  Plane plane = Plane::strain;
  SimulationMethod method = SimulationMethod::implicit_euler;
  double duration = 0, step = 0;  ///< [s]
  double tolerance = 0;           ///< 0: fixed steps
  bool from_equilibrium = false;  ///< start under loads and gravity in equilibrium, not at rest without them
  int frames = 60;                ///< stored states
  MassForm mass = MassForm::consistent;
  std::vector<BodySettings> bodies;
  std::vector<MaterialSettings> materials;
  std::map<std::string, double> mass_damping, stiffness_damping;  ///< region to alpha [1/s], beta [s]
  double gravity = 9.81;
  std::vector<double> gravity_direction;  ///< empty: none
  std::vector<ControlSettings> controls;
  std::vector<RobotCable> cables;
  std::vector<RobotJoint> joints;
  std::vector<RobotLoad> loads;
  bool contact = false;
  double contact_gap = 0;                          ///< [m]
  std::map<std::string, double> contact_pressure;  ///< region to barrier stiffness [Pa]; missing: from the materials
  std::vector<std::vector<Eigen::Vector2d>> obstacles;
  std::vector<std::pair<Eigen::VectorXd, Eigen::VectorXd>> grounds;  ///< point, unit normal
  std::vector<RobotChannel> channels;
  std::vector<RobotPlot> plots;
  std::optional<WorkspaceSettings> workspace;
  std::optional<IkSettings> ik;
  EquilibriumOptions equilibrium;
};

}  // namespace taut
