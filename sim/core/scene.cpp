#include "sim/core/scene.hpp"

#include <fmt/format.h>

#include <Eigen/QR>
#include <functional>

#include "sim/core/error.hpp"
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

}  // namespace

SceneBuilder::SceneBuilder(Mesh mesh, Plane plane, double thickness)
    : mesh_(std::move(mesh)),
      plane_(plane),
      has_material_(mesh_.region_names.size()),
      modulus_(mesh_.region_names.size(), -1) {
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
                             const std::map<std::string, double>& constants, Formulation formulation) {
  SolidDefinition definition;
  definition.region = mesh_.region_index(region);
  const size_t index = static_cast<size_t>(definition.region);
  if (has_material_[index]) throw InputError(fmt::format("region '{}' has two materials; give it one", region));
  definition.law = law;
  definition.plane = plane_;
  definition.formulation = formulation;
  definition.thickness = thickness_;
  std::vector<std::string> known;
  for (const ParameterSpec& spec : material_parameters(law)) known.push_back(spec.id);
  for (const auto& [id, value] : constants) {
    if (std::find(known.begin(), known.end(), id) == known.end()) {
      throw InputError(fmt::format("material of region '{}': '{}' has no constant '{}'{}; it has: {}", region, law, id,
                                   did_you_mean(id, known), join(known)));
    }
  }
  for (ParameterSpec spec : material_parameters(law)) {
    const auto found = constants.find(spec.id);
    if (found == constants.end()) {
      throw InputError(fmt::format("material of region '{}': {} ({}) is missing; law '{}' needs {}", region, spec.id,
                                   spec.meaning, law, join(known)));
    }
    spec.id += "_" + region;
    spec.meaning += " of " + region;
    const bool modulus = spec.id == "E_" + region;
    definition.parameters.push_back(declare(std::move(spec), found->second));
    if (modulus) modulus_[index] = definition.parameters.back();
  }
  has_material_[index] = true;
  terms_.push_back(make_solid(mesh_, definition));
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
  double stiffest = 0;
  for (int index : modulus_) stiffest = std::max(stiffest, index < 0 ? 0.0 : values_[static_cast<size_t>(index)]);
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

void SceneBuilder::check_direction(const Eigen::VectorXd& direction) const {
  if (direction.size() != mesh_.dimension() || !(direction.norm() > 0) || !direction.allFinite()) {
    throw InputError(
        fmt::format("a direction in a {0}D model needs {0} finite numbers that are not all zero", mesh_.dimension()));
  }
}

void SceneBuilder::add_force(const std::string& tag, const Eigen::VectorXd& direction, int control, int gravity) {
  check_direction(direction);
  std::vector<int> factors{control};
  if (gravity >= 0) factors.push_back(gravity);
  terms_.push_back(make_load(mean_weights(mesh_, mesh_.select(tag), direction), factors));
}

void SceneBuilder::add_point_force(const Eigen::VectorXd& point, const Eigen::VectorXd& direction, int control,
                                   int gravity) {
  check_direction(direction);
  std::vector<int> factors{control};
  if (gravity >= 0) factors.push_back(gravity);
  terms_.push_back(make_load(point_weights(mesh_, locate(mesh_, point), direction), factors));
}

void SceneBuilder::add_traction(const std::string& tag, const Eigen::VectorXd& direction, int control) {
  check_direction(direction);
  const Tag facets = mesh_.select(tag);
  if (facets.dimension != mesh_.dimension() - 1)
    throw InputError(
        fmt::format("a traction acts on {}, and '{}' is not one", mesh_.dimension() == 3 ? "a face" : "an edge", tag));
  std::vector<int> factors{control};
  if (thickness_ >= 0) factors.push_back(thickness_);
  terms_.push_back(make_load(mean_weights(mesh_, facets, direction) * measure_of(mesh_, facets), factors));
}

void SceneBuilder::add_line_load(const std::string& tag, const Eigen::VectorXd& direction, int control) {
  check_direction(direction);
  const Tag line = mesh_.select(tag);
  if (line.dimension != mesh_.dimension() - 2)
    throw InputError(fmt::format(
        "a line load acts on {}, and '{}' is not one",
        mesh_.dimension() == 3 ? "an edge, such as \"xmax & zmax\"" : "a point, such as \"xmax & ymax\"", tag));
  std::vector<int> factors{control};
  if (thickness_ >= 0) factors.push_back(thickness_);  // in 2D the line runs through the thickness
  terms_.push_back(
      make_load(mean_weights(mesh_, line, direction) * (thickness_ >= 0 ? 1.0 : measure_of(mesh_, line)), factors));
}

void SceneBuilder::add_weight(const std::string& region, double density, const Eigen::VectorXd& direction,
                              int gravity) {
  check_direction(direction);
  const int rho = declare({"density_" + region, "rho", "kg/m3", 1e-3, 1e5, "density of " + region}, density);
  std::vector<int> factors{rho, gravity};
  if (thickness_ >= 0) factors.push_back(thickness_);
  terms_.push_back(make_load(body_weights(mesh_, mesh_.region_index(region), direction), factors));
}

void SceneBuilder::add_cable(const Cable& cable) {
  terms_.push_back(make_cable(mesh_, cable));
}

void SceneBuilder::add_contact(double gap, const std::map<std::string, double>& pressures,
                               const std::vector<std::vector<Eigen::Vector2d>>& obstacles,
                               const std::vector<GroundLine>& grounds, ContactForm form) {
  if (mesh_.dimension() != 2) throw InputError("contact is for 2D models; leave it out in 3D");
  check_materials();
  ContactSettings settings;
  settings.form = form;
  settings.obstacles = obstacles;
  settings.grounds = grounds;
  settings.thickness = thickness_;
  settings.gap = declare({"contact_gap", "dhat", "m", 1e-9, 1, "distance at which the contact barrier sets in"}, gap);
  std::vector<int> stiffness;
  for (const std::string& region : mesh_.region_names) {
    stiffness.push_back(
        declare({"contact_pressure_" + region, "kappa", form == ContactForm::length_weighted ? "Pa" : "N/m", 1e-9, 1e15,
                 "barrier stiffness of " + region, true},
                pressures.at(region)));
  }
  std::map<std::array<int, 2>, int> region_of;  // of an edge, by its nodes in either order
  for (int e = 0; e < mesh_.element_count(); ++e) {
    for (int a = 0; a < mesh_.nodes_per_element(); ++a) {
      for (int b = 0; b < mesh_.nodes_per_element(); ++b)
        region_of[{mesh_.element(e)[a], mesh_.element(e)[b]}] = mesh_.region[static_cast<size_t>(e)];
    }
  }
  settings.edges = contact_edges(mesh_);
  for (const std::array<int, 2>& edge : settings.edges)
    settings.stiffness.push_back(stiffness[static_cast<size_t>(region_of.at(edge))]);
  auto contact = std::make_unique<Contact>(mesh_, settings);
  const Eigen::VectorXd rest = Eigen::VectorXd::Zero(mesh_.X.size());
  if (contact->intersects(rest))
    throw InputError("bodies, obstacles or grounds cross each other at rest; move the obstacle or the ground away");
  const double smallest = contact->smallest_distance(rest, 2 * gap);
  if (!(smallest > gap)) {
    throw InputError(fmt::format(
        "the contact gap of {:.4g} mm is larger than the smallest distance at rest, {:.4g} mm: bodies would push each "
        "other before anything moves; choose a gap below half that distance",
        gap * 1e3, smallest * 1e3));
  }
  terms_.push_back(std::move(contact));
}

/// The supports must fix all translations and rotations of every connected part, or the Hessian at rest is singular.
void SceneBuilder::check_rigid_motions() const {
  const int d = mesh_.dimension(), motions = d == 2 ? 3 : 6;
  const std::vector<int> part = parts_of(mesh_, [](int) { return true; });
  auto root = [&](int i) { return part[static_cast<size_t>(i)]; };
  std::map<int, std::vector<int>> supported;  // part to its supported unknowns
  for (int e = 0; e < mesh_.element_count(); ++e) supported[root(mesh_.element(e)[0])];
  for (const auto& [dof, s] : supports_) supported[root(dof / d)].push_back(dof);
  for (int node : clamped_) {
    for (int i = 0; i < d; ++i) supported[root(node)].push_back(node * d + i);
  }
  for (const auto& [representative, dofs] : supported) {
    Eigen::MatrixXd rows = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(dofs.size()), motions);
    for (size_t k = 0; k < dofs.size(); ++k) {
      const int component = dofs[k] % d;
      const Eigen::VectorXd x = (mesh_.node(dofs[k] / d) - mesh_.node(representative)) / mesh_.diagonal();
      auto row = rows.row(static_cast<Eigen::Index>(k));
      row[component] = 1;
      for (int axis = 0; axis < motions - d; ++axis) {  // rotations: about z in 2D, about x, y, z in 3D
        const int about = d == 2 ? 2 : axis, first = (about + 1) % 3, second = (about + 2) % 3;
        if (component == first) row[d + axis] = -x[second];
        if (component == second) row[d + axis] = x[first];
      }
    }
    Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(rows);
    qr.setThreshold(1e-9);
    if (dofs.empty() || qr.rank() < motions) {
      const Eigen::VectorXd at = mesh_.node(representative) * 1e3;
      throw InputError(
          fmt::format("the supports leave {} of {} rigid motions free (the part with the node at ({:.4g}, {:.4g}{}) "
                      "mm): fix more components",
                      motions - (dofs.empty() ? 0 : qr.rank()), motions, at[0], at[1],
                      d == 3 ? fmt::format(", {:.4g}", at[2]) : ""));
    }
  }
}

/// Connected pieces of each region.
std::vector<Body> SceneBuilder::bodies() const {
  std::vector<Body> bodies;
  for (int region = 0; region < static_cast<int>(mesh_.region_names.size()); ++region) {
    if (modulus_[static_cast<size_t>(region)] < 0) continue;
    const std::vector<int> part =
        parts_of(mesh_, [&](int e) { return mesh_.region[static_cast<size_t>(e)] == region; });
    std::map<int, Body> pieces;
    for (int node = 0; node < mesh_.node_count(); ++node) {
      if (part[static_cast<size_t>(node)] >= 0) pieces[part[static_cast<size_t>(node)]].nodes.push_back(node);
    }
    for (const auto& [dof, s] : supports_) {
      const int piece = part[static_cast<size_t>(dof / mesh_.dimension())];
      if (piece >= 0) pieces[piece].supported = true;
    }
    for (auto& [representative, body] : pieces) {
      body.modulus = modulus_[static_cast<size_t>(region)];
      bodies.push_back(std::move(body));
    }
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

Scene SceneBuilder::build() {
  check_materials();
  check_rigid_motions();
  std::vector<Support> supports;
  for (const auto& [dof, s] : supports_) supports.push_back(s);
  Scene scene;
  scene.values = Eigen::Map<const Eigen::VectorXd>(values_.data(), static_cast<Eigen::Index>(values_.size()));
  std::vector<Body> pieces = bodies();
  scene.model = std::make_unique<Model>(std::move(mesh_), std::move(parameters_), std::move(terms_),
                                        std::move(supports), std::move(pieces));
  return scene;
}

}  // namespace taut
