#pragma once
#include <Eigen/Core>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "sim/contact/contact.hpp"
#include "sim/core/units.hpp"
#include "sim/shapes/geometry.hpp"
#include "sim/solve/time_stepper.hpp"
#include "sim/terms/inertia.hpp"

namespace taut {

struct MaterialSettings {
  std::string region, law;
  std::map<std::string, double> constants;  ///< SI
  std::optional<double> density;
};

struct SupportSettings {
  std::string on;
  std::vector<int> fix;                      ///< components
  std::string control;                       ///< a prescribed displacement: id of the control
  int component = 0;                         ///< of the prescribed displacement
  std::string column;                        ///< bench column of the control
  std::optional<double> rotation_stiffness;  ///< an elastic clamp instead [N m/rad]
};

/// One cable of [cables].
struct CableSettings {
  std::string id;
  std::vector<std::vector<double>> points;     ///< rest positions along it [m]
  bool start_fixed = true, end_fixed = false;  ///< ends that are fixed in space, not in the material
  std::string control;                         ///< id of the control that retracts it; "": none
};

/// What all cables have in common, and each of them.
struct CablesSettings {
  std::optional<double> k, EA;         ///< [N/m] of the whole cable, or [N]
  double slack = 0, smoothing = 2e-6;  ///< [m]
  std::vector<CableSettings> cables;
  std::map<std::string, std::string> columns;  ///< control id to bench column of the retractions
};

/// [contact]: on for push_puppet, elsewhere when the table is there.
struct SurfaceSettings {
  bool on = false;
  bool idle = false;  ///< nothing touches: the mesh is made for contact, but none is looked for
  ContactForm form = ContactForm::length_weighted;
  std::optional<double> stiffness;  ///< pair sums only [N/m]
  bool compensate = true;           ///< take the distance at which closed lips rest off their faces (push_puppet)
  std::vector<std::vector<Eigen::Vector2d>> obstacles;
  std::vector<GroundLine> grounds;
};

struct LoadSettings {
  std::string id;
  std::string on;             ///< tag, or
  std::vector<double> point;  ///< rest position [m]
  std::vector<double> direction;
  std::string column;                   ///< bench column that holds its value, or
  double value = 0;                     ///< a constant one, SI
  Quantity quantity = Quantity::force;  ///< force, mass, pressure (traction) or line_load
};

struct ChannelSettings {
  std::string id;
  std::string on;                ///< mean over a tag, or
  std::vector<double> point;     ///< a material point [m]
  std::vector<double> standoff;  ///< marker off the surface [m], empty: none
  std::string turns_with;        ///< tag that the stand-off turns with
  std::vector<double> direction;
};

/// [dynamics] and [damping.REGION].
struct DynamicsSettings {
  Integrator integrator = Integrator::bdf2;
  double step = 0;  ///< [s]
  MassForm mass = MassForm::consistent;
  std::map<std::string, double> mass_damping, stiffness_damping;  ///< region to alpha [1/s], beta [s]
};

}  // namespace taut
