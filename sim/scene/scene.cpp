#include "sim/scene/scene.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <functional>
#include <optional>
#include <stdexcept>
#include <type_traits>

#include "sim/contact/contact_friction.hpp"
#include "sim/core/dense.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/terms/cable_friction.hpp"
#include "sim/terms/elastic_base.hpp"
#include "sim/terms/load.hpp"

namespace taut {
namespace {

/// Per node, a node that stands for the connected part of the chosen elements to which it belongs; -1 in none.
std::vector<int> parts_of(const Mesh& mesh, const std::function<bool(int)>& chosen) {
  std::vector<int> part(static_cast<size_t>(mesh.node_count()), -1);
  auto root = [&](int i) {
    while (part[static_cast<size_t>(i)] != i)
      i = part[static_cast<size_t>(i)] = part[static_cast<size_t>(part[static_cast<size_t>(i)])];
    return i;
  };
  for (int e = 0; e < mesh.element_count(); ++e) {
    if (!chosen(e)) continue;
    for (int a = 0; a < mesh.nodes_per_element(); ++a) {
      const int node = mesh.element(e)[a];
      if (part[static_cast<size_t>(node)] < 0) part[static_cast<size_t>(node)] = node;
      part[static_cast<size_t>(root(node))] = root(mesh.element(e)[0]);
    }
  }
  for (int node = 0; node < mesh.node_count(); ++node) {
    if (part[static_cast<size_t>(node)] >= 0) part[static_cast<size_t>(node)] = root(node);
  }
  return part;
}

/// Contact that would push before anything moves is refused.
template <class AnyContact>
void check_rest(const AnyContact& contact, const Mesh& mesh, double gap) {
  const Eigen::VectorXd rest = Eigen::VectorXd::Zero(mesh.X.size());
  if (contact.intersects(rest))
    throw InputError("bodies, obstacles or grounds cross each other at rest; move the obstacle or the ground away");
  for (const auto& ground : contact.settings().grounds) {
    const auto holds = [&](const Part& part) { return lies_in(part, mesh, ground.point); };
    if (ground.kind == GroundKind::sphere && std::ranges::any_of(mesh.parts, holds))
      throw InputError("a round ground lies inside a body at rest; move one of them");
  }
  const double smallest = contact.smallest_distance(rest, 2 * gap);
  if (!(smallest > gap)) {
    throw InputError(fmt::format(
        "the contact gap of {:.4g} mm is larger than the smallest distance at rest, {:.4g} mm: bodies would push each "
        "other before anything moves; choose a gap below half that distance",
        gap * 1e3, smallest * 1e3));
  }
}

/// How far from its pin the parts that a joint connects overlap at rest, or come within two gaps of it [m].
template <class AnyContact, class Patch>
double overlap_at_rest(const Mesh& mesh, const AnyContact& contact, const Patch& pin, double gap) {
  double farthest = contact.overlap_about(pin, 2 * gap);
  const std::vector<int> nodes = boundary(mesh).nodes();
  for (const auto& [here, other] : {std::pair(pin.parts[0], pin.parts[1]), std::pair(pin.parts[1], pin.parts[0])}) {
    const Part &own = mesh.parts[static_cast<size_t>(here)], &outer = mesh.parts[static_cast<size_t>(other)];
    for (int node : nodes) {
      if (node < own.first_node || node >= own.first_node + own.node_count) continue;
      const Eigen::VectorXd r = mesh.node(node) - pin.point;
      const double distance = (r - r.dot(pin.axis) * pin.axis).norm();
      if (distance > farthest && lies_in(outer, mesh, mesh.node(node))) farthest = distance;
    }
  }
  return farthest;
}

/// "body 'platform'", or the body with a node.
std::string name_of_piece(const Mesh& mesh, int node) {
  for (const Part& part : mesh.parts) {
    if (node >= part.first_node && node < part.first_node + part.node_count) return fmt::format("body '{}'", part.name);
  }
  const Eigen::VectorXd at = 1e3 * mesh.node(node);
  return fmt::format("the body with the node at ({:.4g}, {:.4g}{}) mm", at[0], at[1],
                     at.size() == 3 ? fmt::format(", {:.4g}", at[2]) : "");
}

/// Appends the pieces of a part: joints may leave them free to move against each other.
void add_pieces(const Mesh& mesh, const std::vector<int>& part, const std::vector<int>& piece, int which,
                std::vector<LooseBody>& loose) {
  std::map<int, LooseBody> pieces;
  for (int node = 0; node < mesh.node_count(); ++node) {
    if (part[static_cast<size_t>(node)] == which) pieces[piece[static_cast<size_t>(node)]].nodes.push_back(node);
  }
  for (auto& [first, body] : pieces) {
    body.name = name_of_piece(mesh, first);
    loose.push_back(std::move(body));
  }
}

}  // namespace

std::pair<ParameterSpec, ParameterSpec> prony_parameters(const std::string& region, size_t pair) {
  const std::string number = pair == 0 ? "" : std::to_string(pair + 1), ending = number + "_" + region;
  ParameterSpec g{"g" + ending, "g", "1", 0, 0.99, "share of the stiffness of " + region + " that relaxes"};
  ParameterSpec tau{"tau" + ending, "tau", "s", 1e-6, 1e9, "time in which that relaxes", true};
  g.may_be_zero = true;
  return {std::move(g), std::move(tau)};
}

SceneBuilder::SceneBuilder(Mesh mesh, Plane plane, double thickness)
    : mesh_(std::move(mesh)),
      plane_(plane),
      has_material_(mesh_.region_names.size()),
      modulus_(mesh_.region_names.size(), -1),
      stiffness_(mesh_.region_names.size(), 0.0),
      rigid_(mesh_.region_names.size(), false) {
  if (mesh_.dimension() == 2) {
    thickness_ = declare({"thickness", "t", "m", 1e-9, 1e3, "thickness out of the plane"}, thickness);
  }
}

int SceneBuilder::declare(ParameterSpec spec, double value) {
  if (parameters_.contains(spec.id))
    throw InputError(fmt::format("'{}' is a parameter of the model already; choose another id", spec.id));
  const int index = parameters_.declare(std::move(spec));
  parameters_.check(index, value);
  values_.push_back(value);
  return index;
}

void SceneBuilder::add_solid(const std::string& region, const std::string& law,
                             const std::map<std::string, double>& constants, Formulation formulation,
                             const std::vector<std::pair<double, double>>& prony) {
  SolidDefinition definition;
  definition.region = mesh_.region_index(region);
  const size_t index = static_cast<size_t>(definition.region);
  if (has_material_[index]) throw InputError(fmt::format("region '{}' has two materials; give it one", region));
  definition.law = law;
  definition.plane = plane_;
  definition.formulation = formulation;
  definition.thickness = thickness_;
  for (auto& [spec, value] : region_parameters(region, law, constants)) {
    const bool modulus = spec.id == "E_" + region;
    definition.parameters.push_back(declare(std::move(spec), value));
    if (modulus) modulus_[index] = definition.parameters.back();
  }
  for (size_t i = 0; i < prony.size(); ++i) {
    auto [g, tau] = prony_parameters(region, i);
    definition.prony.push_back({declare(std::move(g), prony[i].first), declare(std::move(tau), prony[i].second)});
  }
  stiffness_[index] = youngs_modulus(law, constants);
  has_material_[index] = true;
  terms_.push_back(make_solid(mesh_, definition));
}

void SceneBuilder::add_rigid(const std::string& region, double modulus) {
  const size_t index = static_cast<size_t>(mesh_.region_index(region));
  if (has_material_[index]) throw InputError(fmt::format("region '{}' has two materials; give it one", region));
  has_material_[index] = rigid_[index] = true;
  stiffness_[index] = modulus;
}

void SceneBuilder::support(const std::string& tag, int component, int control) {
  const int d = mesh_.dimension();
  if (component >= d)
    throw InputError(fmt::format("support on '{}': a {}D model has no component {}; use {}", tag, d, "xyz"[component],
                                 d == 2 ? "x, y" : "x, y, z"));
  for (int node : mesh_.select(tag).nodes()) {
    const Support wanted{node * d + component, control, control < 0 ? 0.0 : 1.0};
    const auto [position, inserted] = supports_.try_emplace(wanted.dof, wanted);
    if (!inserted && position->second.parameter != control) {
      throw InputError(
          fmt::format("support on '{}': component {} of a node is already prescribed by another support; let the "
                      "supports not overlap",
                      tag, "xyz"[component]));
    }
  }
}

void SceneBuilder::fix(const std::string& tag, const std::vector<int>& components) {
  for (int component : components) support(tag, component, -1);
}

void SceneBuilder::add_elastic_clamp(const std::string& tag, double rotation_stiffness) {
  if (mesh_.dimension() != 2) throw InputError("an elastic clamp is for 2D models; fix the face in 3D");
  if (!clamped_.empty())
    throw InputError("there is an elastic clamp already; one support may have a rotation_stiffness");
  const Tag face = mesh_.select(tag);
  const double stiffest = *std::max_element(stiffness_.begin(), stiffness_.end());
  const int rotation =
      declare({"k_base", "c", "Nm/rad", 1e-9, 1e12, "rotation stiffness of the clamp", true}, rotation_stiffness);
  // A hundred times what the material resists: the face's mean then moves less than the material beside it is strained.
  terms_.push_back(make_elastic_base(mesh_, face, rotation, 100 * stiffest * values_[static_cast<size_t>(thickness_)]));
  const std::vector<int> nodes = face.nodes();
  clamped_.insert(clamped_.end(), nodes.begin(), nodes.end());
}

void SceneBuilder::prescribe(const std::string& tag, int component, int control) {
  support(tag, component, control);
}

void SceneBuilder::carry(int node, const Eigen::VectorXd& way, int control) {
  const int d = mesh_.dimension();
  for (int i = 0; i < d; ++i) carried_.push_back({node * d + i, control, way[i]});
}

void SceneBuilder::check_direction(const Eigen::VectorXd& direction) const {
  if (direction.size() != mesh_.dimension() || !(direction.norm() > 0) || !direction.allFinite()) {
    throw InputError(
        fmt::format("a direction in a {0}D model needs {0} finite numbers that are not all zero", mesh_.dimension()));
  }
}

void SceneBuilder::add_load(const Eigen::VectorXd& weights, std::vector<int> factors) {
  std::erase_if(factors, [](int index) { return index < 0; });
  terms_.push_back(make_load(weights, factors));
}

void SceneBuilder::add_force(const std::string& tag, const Eigen::VectorXd& direction, int control, int gravity) {
  check_direction(direction);
  add_load(mean_weights(mesh_, mesh_.select(tag), direction), {control, gravity});
}

void SceneBuilder::add_point_force(const Eigen::VectorXd& point, const Eigen::VectorXd& direction, int control,
                                   int gravity) {
  check_direction(direction);
  add_load(point_weights(mesh_, locate(mesh_, point), direction), {control, gravity});
}

void SceneBuilder::add_traction(const std::string& tag, const Eigen::VectorXd& direction, int control) {
  check_direction(direction);
  const Tag facets = mesh_.select(tag);
  if (facets.dimension != mesh_.dimension() - 1)
    throw InputError(
        fmt::format("a traction acts on {}, and '{}' is not one", mesh_.dimension() == 3 ? "a face" : "an edge", tag));
  add_load(mean_weights(mesh_, facets, direction) * measure_of(mesh_, facets), {control, thickness_});
}

void SceneBuilder::add_line_load(const std::string& tag, const Eigen::VectorXd& direction, int control) {
  check_direction(direction);
  const Tag line = mesh_.select(tag);
  if (line.dimension != mesh_.dimension() - 2)
    throw InputError(fmt::format(
        "a line load acts on {}, and '{}' is not one",
        mesh_.dimension() == 3 ? "an edge, such as \"xmax & zmax\"" : "a point, such as \"xmax & ymax\"", tag));
  // In 2D the line runs through the thickness.
  add_load(mean_weights(mesh_, line, direction) * (thickness_ >= 0 ? 1.0 : measure_of(mesh_, line)),
           {control, thickness_});
}

void SceneBuilder::add_weight(const std::string& region, double density, const Eigen::VectorXd& direction,
                              int gravity) {
  check_direction(direction);
  add_load(body_weights(mesh_, mesh_.region_index(region), direction),
           {density_of(region, density), gravity, thickness_});
}

int SceneBuilder::density_of(const std::string& region, double density) {
  const std::string id = "density_" + region;
  if (!parameters_.contains(id)) return declare({id, "rho", "kg/m3", 1e-3, 1e5, "density of " + region}, density);
  const int index = parameters_.index(id);
  if (values_[static_cast<size_t>(index)] != density)
    throw InputError(fmt::format("region '{}' has two densities, {:.6g} and {:.6g} kg/m3; give it one", region,
                                 values_[static_cast<size_t>(index)], density));
  return index;
}

void SceneBuilder::add_inertia(const std::string& region, double density, MassForm form, int mass_damping) {
  terms_.push_back(
      make_inertia(mesh_, {mesh_.region_index(region), density_of(region, density), thickness_, mass_damping, form}));
}

void SceneBuilder::add_viscosity(const std::string& region, int stiffness_damping) {
  if (!parameters_.contains("E_" + region) || !parameters_.contains("nu_" + region))
    throw InputError(fmt::format("viscosity of region '{}' needs its material's E and nu; give it a material", region));
  ViscosityDefinition definition;
  definition.region = mesh_.region_index(region);
  definition.youngs_modulus = parameters_.index("E_" + region);
  definition.poisson_ratio = parameters_.index("nu_" + region);
  definition.damping = stiffness_damping;
  definition.thickness = thickness_;
  definition.plane_stress = mesh_.dimension() == 2 && plane_ == Plane::stress;
  terms_.push_back(make_viscosity(mesh_, definition));
}

void SceneBuilder::add_point_mass(const std::string& tag, int mass) {
  terms_.push_back(make_point_mass(mesh_, mesh_.select(tag), mass));
}

void SceneBuilder::add_cable(const Cable& cable) {
  std::vector<int>& nodes = ties_.emplace_back();
  for (const CablePoint& point : cable.points)
    nodes.push_back(point.material.nodes.empty() ? -1 : point.material.nodes.front());
  if (cable.tension < 0) return terms_.push_back(make_cable(mesh_, cable));
  for (std::unique_ptr<Term>& piece : make_held_cable(mesh_, cable)) terms_.push_back(std::move(piece));
}

void SceneBuilder::add_play(const Play& play) {
  std::vector<int>& nodes = ties_.emplace_back();
  const int d = mesh_.dimension();
  double resting = 0;  // weights of all places that move; their sum is zero between two of them
  Eigen::VectorXd sum = Eigen::VectorXd::Zero(d);
  for (int node = 0; node < mesh_.node_count(); ++node) {
    const auto weight = play.apart.segment(node * d, d);
    if (weight.isZero(0)) continue;
    nodes.push_back(node);
    sum += weight;
    resting = std::max(resting, weight.norm());
  }
  if (sum.norm() > 1e-9 * resting) nodes.push_back(-1);
  terms_.push_back(make_play(mesh_, play));
}

void SceneBuilder::add_rubbing_cable(Cable& cable) {
  const auto state = [&](const char* id, const char* unit, const char* meaning, bool past) {
    const size_t number = states_.size() + 1;
    states_.push_back(
        {declare({fmt::format("{}_{}", id, number), id, unit, -infinity, infinity, meaning}, 0), past, {}});
    return states_.back().index;
  };
  for (size_t i = 1; i + 1 < cable.points.size(); ++i) {
    CableEyelet& eyelet = cable.eyelets.emplace_back();
    eyelet.bound = state("eyelet_bound", "N", "what friction at an eyelet can bear", false);
    eyelet.slip = state("eyelet_slip", "m", "length of cable that had passed an eyelet", true);
  }
  add_cable(cable);
  StateParameter* of = states_.data() + (states_.size() - 2 * cable.eyelets.size());
  for (size_t i = 0; i < cable.eyelets.size(); ++i) {
    (of++)->value = make_eyelet_bound(mesh_, cable, static_cast<Eigen::Index>(i));
    (of++)->value = make_eyelet_slip(mesh_, cable, static_cast<Eigen::Index>(i));
  }
}

Joint SceneBuilder::add_joint(const JointSettings& settings, int angle) {
  const std::string where = fmt::format("joint '{}'", settings.id);
  const auto part_called = [&](const std::string& name) {
    return name.empty() && mesh_.parts.empty() ? Part{"", 0, mesh_.node_count(), 0, mesh_.element_count()}
                                               : mesh_.part(name);
  };
  double stiffest = 0;
  const auto attach = [&](const std::string& name, const Eigen::VectorXd& point) {
    if (point.size() == 0) return Attachment();
    if (name == "world") return world_attachment(point);
    try {
      const Part part = part_called(name);
      for (int e = part.first_element; e < part.first_element + part.element_count; ++e)
        stiffest = std::max(stiffest, stiffness_[static_cast<size_t>(mesh_.region[static_cast<size_t>(e)])]);
      return make_attachment(mesh_, part, point, settings.radius);
    } catch (const InputError& error) {
      throw InputError(fmt::format("{}: {}", where, error.what()));
    }
  };
  if (mesh_.dimension() == 3 && settings.axis_end.size() != 3)
    throw InputError(fmt::format("{} has no axis; give it a second point of the axis", where));
  Joint joint;
  joint.name = settings.id;
  joint.pivot_a = attach(settings.part_a, settings.pivot);
  joint.pivot_b = attach(settings.part_b, settings.pivot);
  joint.axis_a = attach(settings.part_a, settings.axis_end);
  joint.axis_b = attach(settings.part_b, settings.axis_end);
  joint.motor_a = attach(settings.part_a, settings.motor);
  joint.motor_b = attach(settings.part_b, settings.motor);
  double stiffness = settings.stiffness;
  if (stiffness == 0) {
    if (stiffest == 0)
      throw InputError(
          fmt::format("{} takes its stiffness from its bodies, and they have no modulus; add their "
                      "materials first or give it a stiffness",
                      where));
    stiffness =
        10 * stiffest *
        (thickness_ >= 0 ? values_[static_cast<size_t>(thickness_)] : (settings.axis_end - settings.pivot).norm());
  }
  joint.pin_stiffness = joint.motor_stiffness = declare(
      {"k_" + settings.id, "k", "N/m", 1e-9, 1e15, "spring stiffness of joint " + settings.id, true}, stiffness);
  if (settings.motor.size() > 0) {
    joint.angle =
        angle >= 0 ? angle : declare({settings.id, "theta", "rad", -1e4, 1e4, "angle of joint " + settings.id}, 0.0);
  }
  terms_.push_back(make_joint(mesh_, joint));
  joints_.push_back(joint);
  if (settings.part_a != "world" && !mesh_.parts.empty()) {
    const auto place = [&](const std::string& name) {
      return static_cast<int>(&mesh_.part(name) - mesh_.parts.data());
    };
    const Eigen::VectorXd axis =
        mesh_.dimension() == 3 ? Eigen::VectorXd(settings.axis_end - settings.pivot) : Eigen::VectorXd();
    joined_.push_back({settings.id, {place(settings.part_a), place(settings.part_b)}, settings.pivot, axis});
  }
  return joint;
}

/// Per node the part it is of, by its place in the mesh's list.
std::vector<int> SceneBuilder::part_of_nodes() const {
  std::vector<int> part(static_cast<size_t>(mesh_.node_count()), 0);  // 0 too for nodes that carry grounds
  for (size_t k = 0; k < mesh_.parts.size(); ++k)
    std::fill_n(part.begin() + mesh_.parts[k].first_node, mesh_.parts[k].node_count, static_cast<int>(k));
  return part;
}

template <class AnyContact, class AnySettings>
const AnyContact& SceneBuilder::add_surface(AnySettings settings, double gap,
                                            const std::map<std::string, double>& pressures, const char* unit) {
  check_materials();
  settings.part = part_of_nodes();
  settings.gap = declare({"contact_gap", "dhat", "m", 1e-9, 1, "distance at which the contact barrier sets in"}, gap);
  std::vector<int> stiffness;
  for (const std::string& region : mesh_.region_names) {
    stiffness.push_back(
        declare({"contact_pressure_" + region, "kappa", unit, 1e-9, 1e15, "barrier stiffness of " + region, true},
                pressures.at(region)));
  }
  std::vector<std::vector<int>> elements_at(static_cast<size_t>(mesh_.node_count()));
  for (int e = 0; e < mesh_.element_count(); ++e) {
    for (int a = 0; a < mesh_.nodes_per_element(); ++a)
      elements_at[static_cast<size_t>(mesh_.element(e)[a])].push_back(e);
  }
  const auto stiffness_of = [&](const auto& facet) {
    // The nodes of a boundary facet are together in one element only.
    for (int e : elements_at[static_cast<size_t>(facet[0])]) {
      const int *first = mesh_.element(e), *last = first + mesh_.nodes_per_element();
      if (std::all_of(facet.begin(), facet.end(), [&](int node) { return std::find(first, last, node) != last; }))
        return stiffness[static_cast<size_t>(mesh_.region[static_cast<size_t>(e)])];
    }
    throw std::logic_error("SceneBuilder: a facet of the boundary is of no element");
  };
  if constexpr (std::is_same_v<AnyContact, Contact>) {
    settings.edges = contact_edges(mesh_);
    for (const auto& edge : settings.edges) settings.stiffness.push_back(stiffness_of(edge));
  } else {
    settings.triangles = contact_triangles(mesh_);
    for (const auto& triangle : settings.triangles) settings.stiffness.push_back(stiffness_of(triangle));
  }
  auto contact = std::make_unique<AnyContact>(mesh_, settings);
  for (JoinedParts& joined : joined_) {
    auto& patch = settings.patches.emplace_back();
    patch.parts = joined.parts;
    patch.point = joined.pin;
    if (joined.axis.size() > 0) patch.axis = joined.axis.normalized();
    // What comes to the rim of the overlap on one side is not to meet there what begins right outside on the other.
    patch.radius = joined.radius = overlap_at_rest(mesh_, *contact, patch, gap) + 2 * gap;
  }
  if (!joined_.empty()) contact = std::make_unique<AnyContact>(mesh_, settings);
  check_rest(*contact, mesh_, gap);
  const AnyContact& added = *contact;
  terms_.push_back(std::move(contact));
  return added;
}

const Contact& SceneBuilder::add_contact(double gap, const std::map<std::string, double>& pressures,
                                         const std::vector<std::vector<Eigen::Vector2d>>& obstacles,
                                         const std::vector<GroundLine>& grounds, ContactForm form) {
  if (mesh_.dimension() != 2) throw InputError("contact with lines is for 2D models; use the one of 3D models");
  ContactSettings settings;
  settings.form = form;
  settings.obstacles = obstacles;
  settings.grounds = grounds;
  touches_others_ = !obstacles.empty() || !grounds.empty() || mesh_.parts.size() > 1;
  settings.thickness = thickness_;
  const bool pairs = form == ContactForm::pair_sum || form == ContactForm::pair_sum_dedup;
  return add_surface<Contact>(std::move(settings), gap, pressures, pairs ? "N/m" : "Pa");
}

const Contact3d& SceneBuilder::add_contact_3d(double gap, const std::map<std::string, double>& pressures,
                                              const std::vector<GroundPlane>& grounds) {
  if (mesh_.dimension() != 3) throw InputError("contact with planes is for 3D models; use the one of 2D models");
  Contact3dSettings settings;
  settings.grounds = grounds;
  touches_others_ = !grounds.empty() || mesh_.parts.size() > 1;
  return add_surface<Contact3d>(std::move(settings), gap, pressures, "Pa");
}

template <class AnyContact>
const SidedTerm& SceneBuilder::add_contact_friction(const AnyContact& contact, double coefficient) {
  const int mu =
      declare({"contact_friction", "mu", "1", 0, 10, "coefficient of friction of what touches"}, coefficient);
  const Params p = Eigen::Map<const Eigen::VectorXd>(values_.data(), static_cast<Eigen::Index>(values_.size()));
  std::unique_ptr<SidedTerm> friction = make_contact_friction(contact, mu, p);
  const SidedTerm& added = *friction;
  terms_.push_back(std::move(friction));
  return added;
}
template const SidedTerm& SceneBuilder::add_contact_friction(const Contact&, double);
template const SidedTerm& SceneBuilder::add_contact_friction(const Contact3d&, double);

/// Whether cables or studs to something else, or contact, may hold a part.
bool SceneBuilder::may_be_held(const std::vector<int>& part, int which) const {
  const auto on_it = [&](int node) { return node >= 0 && part[static_cast<size_t>(node)] == which; };
  return touches_others_ || std::any_of(ties_.begin(), ties_.end(), [&](const std::vector<int>& tie) {
           return std::any_of(tie.begin(), tie.end(), on_it) && !std::all_of(tie.begin(), tie.end(), on_it);
         });
}

/// What joints connect is one part here, and a point that a joint pins to the world, or turns by its motor, is held.
SceneBuilder::Connected SceneBuilder::connected_parts() const {
  const int d = mesh_.dimension(), motions = d == 2 ? 3 : 6;
  Connected result;
  result.piece = parts_of(mesh_, [](int) { return true; });
  result.part = result.piece;
  std::vector<int>& part = result.part;
  const auto root = [&](int i) { return part[static_cast<size_t>(i)]; };
  for (const Joint& joint : joints_) {
    if (joint.pivot_a.nodes.empty() || joint.pivot_b.nodes.empty()) continue;
    const int one = root(joint.pivot_a.nodes.front()), two = root(joint.pivot_b.nodes.front());
    std::replace(part.begin(), part.end(), two, one);
  }
  struct Held {
    Eigen::VectorXd point;
    int component;
  };
  std::map<int, std::vector<Held>> supported;  // part to its supported components
  for (int e = 0; e < mesh_.element_count(); ++e) supported[root(mesh_.element(e)[0])];
  const auto hold = [&](int node, const Eigen::VectorXd& point) {
    for (int i = 0; i < d; ++i) supported[root(node)].push_back({point, i});
  };
  for (const auto& [dof, s] : supports_) supported[root(dof / d)].push_back({mesh_.node(dof / d), dof % d});
  for (int node : clamped_) hold(node, mesh_.node(node));
  for (const Joint& joint : joints_) {
    if (!joint.pivot_a.nodes.empty() && !joint.pivot_b.nodes.empty()) continue;
    const int node = (joint.pivot_a.nodes.empty() ? joint.pivot_b : joint.pivot_a).nodes.front();
    hold(node, joint.pivot_a.point);
    if (d == 3) hold(node, joint.axis_a.point);
    if (joint.angle >= 0) hold(node, joint.motor_a.point);
  }
  for (const auto& [representative, held] : supported) {
    Eigen::MatrixXd rows = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(held.size()), motions);
    for (size_t k = 0; k < held.size(); ++k) {
      const int component = held[k].component;
      const Eigen::VectorXd x = (held[k].point - mesh_.node(representative)) / mesh_.diagonal();
      auto row = rows.row(static_cast<Eigen::Index>(k));
      row[component] = 1;
      for (int axis = 0; axis < motions - d; ++axis) {  // rotations: about z in 2D, about x, y, z in 3D
        const int about = d == 2 ? 2 : axis, first = (about + 1) % 3, second = (about + 2) % 3;
        if (component == first) row[d + axis] = -x[second];
        if (component == second) row[d + axis] = x[first];
      }
    }
    const Eigen::Index rank = held.empty() ? 0 : rank_of(rows, 1e-9);
    if (rank < motions) result.free_motions[representative] = static_cast<int>(motions - rank);
  }
  return result;
}

/// The supports must fix all translations and rotations of every connected part, or the Hessian at rest is singular;
/// parts that cables or contact may hold instead are returned.
std::vector<LooseBody> SceneBuilder::loose_bodies() const {
  const int d = mesh_.dimension();
  const Connected all = connected_parts();
  std::vector<LooseBody> loose;
  for (const auto& [representative, free] : all.free_motions) {
    if (!may_be_held(all.part, representative)) {
      const Eigen::VectorXd at = mesh_.node(representative) * 1e3;
      throw InputError(
          fmt::format("the supports leave {} of {} rigid motions free (the part with the node at ({:.4g}, {:.4g}{}) "
                      "mm{}): fix more components, or hold it by cables or contact",
                      free, d == 2 ? 3 : 6, at[0], at[1], d == 3 ? fmt::format(", {:.4g}", at[2]) : "",
                      mesh_.parts.empty() ? "" : ", " + name_of_piece(mesh_, representative)));
    }
    add_pieces(mesh_, all.part, all.piece, representative, loose);
  }
  return loose;
}

/// Supports on all nodes of what moves freely: parts that neither supports nor, by way of whatever, cables or studs
/// hold.
void SceneBuilder::hold_free_bodies() {
  const Connected all = connected_parts();
  // Parts that cables or studs tie to one another, each by its root; the world is -1.
  std::map<int, int> tied;
  const auto root = [&](int part) {
    while (tied.contains(part) && tied[part] != part) part = tied[part];
    return part;
  };
  const auto tie_up = [&](int one, int two) { tied[std::max(root(one), root(two))] = std::min(root(one), root(two)); };
  for (int part : all.part) {
    if (!all.free_motions.contains(part)) tie_up(part, -1);
  }
  for (const std::vector<int>& tie : ties_) {
    for (int node : tie) {
      const auto part_of = [&](int i) { return i < 0 ? -1 : all.part[static_cast<size_t>(i)]; };
      tie_up(part_of(node), part_of(tie.front()));
    }
  }
  const int d = mesh_.dimension();
  for (int node = 0; node < mesh_.node_count(); ++node) {
    if (root(all.part[static_cast<size_t>(node)]) == -1) continue;
    for (int dof = node * d; dof < (node + 1) * d; ++dof) supports_.insert_or_assign(dof, Support{dof, -1, 0.0});
  }
}

/// All nodes of a rigid piece get the supports that some of its nodes have.
void SceneBuilder::hold_rigid(const Body& body) {
  const int d = mesh_.dimension();
  std::vector<std::optional<int>> control(static_cast<size_t>(d));  // of each component; -1: clamped
  int held = 0;                                                     // nodes
  bool alike = true;
  for (int node : body.nodes) {
    int components = 0;
    for (int i = 0; i < d; ++i) {
      const auto support = supports_.find(node * d + i);
      if (support == supports_.end()) continue;
      ++components;
      std::optional<int>& known = control[static_cast<size_t>(i)];
      alike = alike && known.value_or(support->second.parameter) == support->second.parameter;
      known = support->second.parameter;
    }
    held += components == d ? 1 : 0;
    alike = alike && (components == 0 || components == d);
  }
  if (held < d || !alike) {
    const Eigen::VectorXd at = 1e3 * mesh_.node(body.nodes.front());
    throw InputError(fmt::format(
        "a rigid body (with the node at {:.4g}, {:.4g} mm) has supports that do not hold it as a whole; fix "
        "all components on one of its faces, or move that face as one, or leave it free",
        at[0], at[1]));
  }
  for (int node : body.nodes) {
    for (int i = 0; i < d; ++i) {
      const int by = *control[static_cast<size_t>(i)];
      supports_.insert_or_assign(node * d + i, Support{node * d + i, by, by < 0 ? 0.0 : 1.0});
    }
  }
}

/// Connected pieces of each region, and of all rigid ones together: what touches moves as one.
std::vector<Body> SceneBuilder::bodies() {
  const int d = mesh_.dimension();
  std::vector<Body> bodies;
  const auto add_pieces = [&](int modulus, auto&& belongs) {
    const std::vector<int> part = parts_of(mesh_, belongs);
    std::map<int, Body> pieces;
    for (int node = 0; node < mesh_.node_count(); ++node) {
      if (part[static_cast<size_t>(node)] >= 0) pieces[part[static_cast<size_t>(node)]].nodes.push_back(node);
    }
    for (const auto& [dof, s] : supports_) {
      const int piece = part[static_cast<size_t>(dof / d)];
      if (piece >= 0) pieces[piece].supported = true;
    }
    for (auto& [representative, body] : pieces) {
      body.modulus = modulus;
      bodies.push_back(std::move(body));
    }
  };
  for (int region = 0; region < static_cast<int>(mesh_.region_names.size()); ++region) {
    const int modulus = modulus_[static_cast<size_t>(region)];
    if (modulus >= 0) add_pieces(modulus, [&](int e) { return mesh_.region[static_cast<size_t>(e)] == region; });
  }
  if (std::find(rigid_.begin(), rigid_.end(), true) == rigid_.end()) return bodies;
  add_pieces(-1, [&](int e) { return rigid_[static_cast<size_t>(mesh_.region[static_cast<size_t>(e)])]; });
  for (const Body& body : bodies) {
    if (body.rigid() && body.supported) hold_rigid(body);
  }
  return bodies;
}

void SceneBuilder::check_materials() const {
  for (size_t r = 0; r < has_material_.size(); ++r) {
    if (!has_material_[r])
      throw InputError(
          fmt::format("region '{}' has no material; add [materials.{}]", mesh_.region_names[r], mesh_.region_names[r]));
  }
}

Scene SceneBuilder::build(FreeBodies free_bodies) {
  check_materials();
  if (free_bodies == FreeBodies::stay) hold_free_bodies();
  std::vector<LooseBody> loose;
  if (free_bodies != FreeBodies::move) loose = loose_bodies();
  std::vector<Body> pieces = bodies();
  std::vector<Support> supports;
  for (const auto& [dof, s] : supports_) supports.push_back(s);
  supports.insert(supports.end(), carried_.begin(), carried_.end());
  Scene scene;
  scene.values = Eigen::Map<const Eigen::VectorXd>(values_.data(), static_cast<Eigen::Index>(values_.size()));
  scene.states = std::move(states_);
  scene.model = std::make_unique<Model>(std::move(mesh_), std::move(parameters_), std::move(terms_),
                                        std::move(supports), std::move(pieces), std::move(loose));
  return scene;
}

}  // namespace taut
