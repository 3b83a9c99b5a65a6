#pragma once
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "sim/contact/contact.hpp"
#include "sim/contact/contact_3d.hpp"
#include "sim/mesh/mesh.hpp"
#include "sim/model/channel.hpp"
#include "sim/model/model.hpp"
#include "sim/scene/setup.hpp"
#include "sim/terms/cable.hpp"
#include "sim/terms/inertia.hpp"
#include "sim/terms/joint.hpp"
#include "sim/terms/play.hpp"
#include "sim/terms/solid.hpp"

namespace taut {

/// A parameter that nobody gives: it follows from states of the model. They are the last ones of their table, and 0 at
/// rest.
struct StateParameter {
  int index = -1;     ///< in the table
  bool past = false;  ///< what it is comes from the state before on a path; else from the state that it has a part in
  std::unique_ptr<Channel> value;  ///< what it is, of that state
};

/// Two parts that a joint connects, and how far from its pin (in 3D, from its axis) they do not see each other: as far
/// as they overlap at rest. Beyond that they are in each other's way like any others.
struct JoinedParts {
  std::string joint;
  std::array<int, 2> parts{};  ///< by their places in the mesh's list
  Eigen::VectorXd pin, axis;   ///< [m]; the axis's direction, empty in the plane
  double radius = 0;           ///< [m]; 0: there is no contact
};

/// A model with a value for each of its parameters: what a forward solve needs.
struct Scene {
  std::unique_ptr<Model> model;
  Params values;
  std::vector<StateParameter> states = {};  ///< those that whoever solves it has to see to
};

/// g and tau of a region's Prony pairs, which count from 0: "g_foam" and "tau_foam", then "g2_foam", "tau2_foam".
std::pair<ParameterSpec, ParameterSpec> prony_parameters(const std::string& region, size_t pair);

/// What becomes of bodies that move freely.
enum class FreeBodies {
  none,  ///< there must not be any: statics
  move,  ///< their inertia holds them in each time step
  stay   ///< they stay where they are, whatever acts on them
};

/// Puts a model together by name: regions to materials, tags to supports and loads. Every number becomes a declared
/// parameter: material constants as "<constant>_<region>" (E_foam, nu_foam, density_foam), "thickness" in 2D, and what
/// the caller declares. Everything that does not fit the mesh throws InputError.
class SceneBuilder {
 public:
  /// `thickness` [m] counts in 2D only.
  SceneBuilder(Mesh mesh, Plane plane = Plane::strain, double thickness = 1.0);

  const Mesh& mesh() const { return mesh_; }                        ///< as it was given
  const ParameterTable& parameters() const { return parameters_; }  ///< declared so far

  /// Declares a parameter or a control (a load, a prescribed displacement) and returns its index.
  int declare(ParameterSpec spec, double value);

  /// Material of a region; `constants` by the law's ids, checked against their bounds. Prony pairs (g, tau) are
  /// declared as "g_<region>" and "tau_<region>", those after the first as "g2_<region>" and so on.
  void add_solid(const std::string& region, const std::string& law, const std::map<std::string, double>& constants,
                 Formulation formulation = Formulation::standard,
                 const std::vector<std::pair<double, double>>& prony = {});

  /// A region without strain: each connected piece of it moves as one, by three unknowns in 2D and six in 3D. A piece
  /// that is supported at all has to be held as a whole, each component of a face clamped or prescribed by one control:
  /// build() throws InputError otherwise. `modulus` [Pa] is what joints and clamps measure themselves by.
  void add_rigid(const std::string& region, double modulus);

  /// Clamps components (0 = x, ...) of all nodes of a tag.
  void fix(const std::string& tag, const std::vector<int>& components);
  /// Holds the mean displacement of a face at zero, and its rotation by a spring (2D). Declares "k_base" [Nm/rad].
  void add_elastic_clamp(const std::string& tag, double rotation_stiffness);
  /// u[component] = p[control] on all nodes of a tag.
  void prescribe(const std::string& tag, int component, int control);
  /// u = way p[control] at a node of no element, which carries a ground.
  void carry(int node, const Eigen::VectorXd& way, int control);

  /// Dead load weights . u times the parameters at the table indices `factors`; negative ones do not count.
  void add_load(const Eigen::VectorXd& weights, std::vector<int> factors);
  /// Dead force of p[control] newtons in all, spread evenly over a tag; with `gravity` >= 0 the control is a mass [kg]
  /// and the force p[control] * p[gravity].
  void add_force(const std::string& tag, const Eigen::VectorXd& direction, int control, int gravity = -1);
  /// The same at one material point.
  void add_point_force(const Eigen::VectorXd& point, const Eigen::VectorXd& direction, int control, int gravity = -1);
  /// Dead traction of p[control] pascals of rest area on a facet tag.
  void add_traction(const std::string& tag, const Eigen::VectorXd& direction, int control);
  /// Dead line load of p[control] newtons per metre along a tag of segments (an edge "a & b" of a 3D body; in 2D, of a
  /// point).
  void add_line_load(const std::string& tag, const Eigen::VectorXd& direction, int control);
  /// Self-weight of a region: density [kg/m^3] and the index of the acceleration [m/s^2].
  void add_weight(const std::string& region, double density, const Eigen::VectorXd& direction, int gravity);

  /// Inertia of a region. Its density is declared as "density_<region>" by whichever of this and add_weight() comes
  /// first and has to be the same in both. `mass_damping` is the table index of alpha [1/s], -1: none.
  void add_inertia(const std::string& region, double density, MassForm form = MassForm::consistent,
                   int mass_damping = -1);
  /// Viscosity of a region in proportion to its stiffness at rest; `stiffness_damping` is the table index of beta [s].
  /// Throws InputError when the region's material has no E and nu yet.
  void add_viscosity(const std::string& region, int stiffness_damping);
  /// Inertia of a mass p[mass] [kg] that moves with the mean of a tag.
  void add_point_mass(const std::string& tag, int mass);

  /// An energy of the caller's own.
  void add_term(std::unique_ptr<Term> term) { terms_.push_back(std::move(term)); }
  /// A cable by the table indices in it.
  void add_cable(const Cable& cable);
  /// A stud in its hole by the table indices in it.
  void add_play(const Play& play);
  /// An elastic cable that rubs at its inner points, by the table indices in it; its eyelets are made here. Nothing may
  /// be declared after it.
  void add_rubbing_cable(Cable& cable);
  /// A joint between two parts, or of one with the world, after their materials. Declares "k_<id>" [N/m] and, with a
  /// motor and without the table index of its `angle` [rad], that as "<id>". The stiffness that is taken from the
  /// bodies is ten times the larger modulus times the thickness (3D: the length of the axis): a load that strains a
  /// tenth of a body's section by 1e-1 opens a gap of 1e-3 of the section. Throws InputError, naming the joint, for
  /// points that are not on both bodies.
  Joint add_joint(const JointSettings& settings, int angle = -1);
  /// Contact of the whole boundary with itself, and with obstacles and grounds (2D): the barrier sets in at `gap` [m]
  /// and is as stiff as `pressures` say, region by region: the pressure [Pa] at which two faces rest half a gap apart,
  /// and the smaller one of two different sides. Declares "contact_gap" and "contact_pressure_<region>". Throws
  /// InputError when something is closer than the gap at rest already. Parts that a joint connects (added before) do
  /// not see each other about its pin: joined(). The term lives as long as the builder and its scene.
  const Contact& add_contact(double gap, const std::map<std::string, double>& pressures,
                             const std::vector<std::vector<Eigen::Vector2d>>& obstacles = {},
                             const std::vector<GroundLine>& grounds = {},
                             ContactForm form = ContactForm::length_weighted);
  /// The same for a 3D mesh, with itself and with ground planes.
  const Contact3d& add_contact_3d(double gap, const std::map<std::string, double>& pressures,
                                  const std::vector<GroundPlane>& grounds = {});

  /// Coulomb friction of such contact. Declares "contact_friction". The term lives as long as the builder and its
  /// scene.
  template <class AnyContact>
  const SidedTerm& add_contact_friction(const AnyContact& contact, double coefficient);
  /// What joints between two parts connect.
  const std::vector<JoinedParts>& joined() const { return joined_; }

  /// The finished scene. Parts that joints connect count as one body, and the world's joints as its supports, a free
  /// pin for what it holds. Throws InputError when a region has no material or, unless bodies move or stay, the
  /// supports leave a rigid motion free of a body that neither cables, studs nor contact reach; whether these hold the
  /// others is found with the equilibrium (Model::loose_bodies()).
  Scene build(FreeBodies free_bodies = FreeBodies::none);

 private:
  template <class AnyContact, class AnySettings>
  const AnyContact& add_surface(AnySettings settings, double gap, const std::map<std::string, double>& pressures,
                                const char* unit);
  void support(const std::string& tag, int component, int control);
  int density_of(const std::string& region, double density);
  std::vector<int> part_of_nodes() const;
  void check_materials() const;
  /// Connected parts, each by a node that stands for it.
  struct Connected {
    std::vector<int> piece, part;     ///< of each node; joints connect pieces to parts
    std::map<int, int> free_motions;  ///< how many rigid motions of a part its supports leave, where they leave any
  };
  Connected connected_parts() const;
  std::vector<LooseBody> loose_bodies() const;
  void hold_free_bodies();
  bool may_be_held(const std::vector<int>& part, int which) const;
  void hold_rigid(const Body& body);
  std::vector<Body> bodies();
  void check_direction(const Eigen::VectorXd& direction) const;

  Mesh mesh_;
  Plane plane_;
  int thickness_ = -1;
  ParameterTable parameters_;
  std::vector<double> values_;
  std::vector<StateParameter> states_;
  std::vector<std::unique_ptr<Term>> terms_;
  std::vector<bool> has_material_;
  std::vector<int> modulus_;       ///< per region: table index of its Young's modulus, -1 without one
  std::vector<double> stiffness_;  ///< per region: its Young's modulus at small strain [Pa], 0 without a material
  std::vector<bool> rigid_;        ///< per region
  std::map<int, Support> supports_;
  std::vector<Support> carried_;  ///< of nodes of no element
  std::vector<int> clamped_;      ///< nodes of elastic clamps
  /// Of each cable a node at each of its points, of each stud those that it holds; -1: fixed in the world.
  std::vector<std::vector<int>> ties_;
  bool touches_others_ = false;  ///< there is contact, with grounds, obstacles or other parts
  std::vector<Joint> joints_;
  std::vector<JoinedParts> joined_;
};

}  // namespace taut
