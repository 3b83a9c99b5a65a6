#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>

#include "sim/contact/contact.hpp"
#include "sim/scene/scene.hpp"
#include "sim/solve/equilibrium.hpp"
#include "sim/terms/cable.hpp"
#include "sim/terms/load.hpp"
#include "sim/terms/solid.hpp"

// A two-cell module on a fixed mesh of linear triangles with seven equilibria and two other states, computed by an
// independent program (small_module_P1.json). Contact is the plain pair sum or the one that counts shared vertices
// once.
namespace taut::test {
namespace {

using Json = nlohmann::json;

const Json& reference() {
  static const Json json = Json::parse(std::ifstream(TAUT_SOURCE_DIR "/tests/verification/small_module_P1.json"));
  return json;
}

Mesh mesh_of(const Json& json) {
  Mesh mesh;
  mesh.shape = ElementShape::tri3;
  const auto& vertices = json["vertices"];
  mesh.X.resize(2 * static_cast<Eigen::Index>(vertices.size()));
  for (size_t i = 0; i < vertices.size(); ++i) {
    for (size_t c = 0; c < 2; ++c) mesh.X[static_cast<Eigen::Index>(2 * i + c)] = vertices[i][c];
  }
  for (const Json& triangle : json["triangles"]) {
    for (int node : triangle) mesh.elements.push_back(node);
  }
  mesh.region = json["region"].get<std::vector<int>>();
  mesh.region_names = {"plastic", "foam"};
  Tag clamped;
  clamped.entities = json["fixed_nodes"].get<std::vector<int>>();
  mesh.tags["clamped"] = clamped;
  return mesh;
}

struct Module {
  Scene scene;
  std::vector<Cable> cables;
  std::unique_ptr<Contact> contact;  ///< a second one to ask for its pairs
  int retraction = -1, force = -1;
  Eigen::VectorXd load, tip;

  /// Controls as a solution has them.
  Params at(const Json& solution) const {
    Params p = scene.values;
    p[force] = solution["F"];
    if (retraction >= 0) p[retraction] = solution["u_cable"];
    return p;
  }
};

enum class With { elastic, cables, pair_sum, pair_sum_dedup };

Module module_of(With with) {
  const Json& json = reference();
  Module module;
  SceneBuilder builder(mesh_of(json["mesh"]), Plane::strain, json["mesh"]["t"]);
  for (const char* region : {"plastic", "foam"}) {
    const Json& material = json["mesh"]["materials"][region];
    builder.add_solid(region, "neo_hookean", {{"E", material["E"]}, {"nu", material["nu"]}});
  }
  builder.fix("clamped", {0, 1});
  if (with != With::elastic) {
    const int k = builder.declare({"k_cable", "k", "N/m", 0, 1e9, "cable", true}, json["cables"][0]["k"]);
    module.retraction = builder.declare({"retraction", "u", "m", -1, 1, "retraction"}, 0.0);
    for (const Json& description : json["cables"]) {
      Cable cable;
      cable.stiffness = k;
      cable.retraction = module.retraction;
      cable.smoothing = 0;
      for (const Json& via : description["via"]) {
        const std::vector<double> rest = via["rest_xy"];
        cable.points.push_back({{via["nodes"].get<std::vector<int>>(), via["weights"].get<std::vector<double>>()},
                                Eigen::Vector2d(rest[0], rest[1])});
      }
      builder.add_cable(cable);
      module.cables.push_back(cable);
    }
  }
  if (with == With::pair_sum || with == With::pair_sum_dedup) {
    const double kappa = json["contact_plain"]["kappa"], dhat = json["contact_plain"]["dhat"];
    const ContactForm form = with == With::pair_sum ? ContactForm::pair_sum : ContactForm::pair_sum_dedup;
    builder.add_contact(dhat, {{"plastic", kappa}, {"foam", kappa}}, {}, {}, form);
  }
  module.force = builder.declare({"F", "F", "N", -1e3, 1e3, "load"}, 0.0);
  const Mesh& mesh = builder.mesh();
  module.load = module.tip = Eigen::VectorXd::Zero(mesh.X.size());
  const Json &load = json["mesh"]["unit_load"], &tip = json["mesh"]["tip_mean_uy"];
  for (size_t i = 0; i < load["nodes"].size(); ++i) module.load[2 * load["nodes"][i].get<int>() + 1] = load["fy"][i];
  for (size_t i = 0; i < tip["nodes"].size(); ++i) module.tip[2 * tip["nodes"][i].get<int>() + 1] = tip["weights"][i];
  builder.add_term(make_load(module.load, {module.force}));
  if (with == With::pair_sum || with == With::pair_sum_dedup) {
    ContactSettings settings;
    settings.form = with == With::pair_sum ? ContactForm::pair_sum : ContactForm::pair_sum_dedup;
    settings.edges = contact_edges(mesh);
    settings.gap = builder.parameters().index("contact_gap");
    settings.stiffness.assign(settings.edges.size(), builder.parameters().index("contact_pressure_plastic"));
    module.contact = std::make_unique<Contact>(mesh, settings);
  }
  module.scene = builder.build();
  return module;
}

With kind_of(const std::string& name) {
  if (name.starts_with("iii")) return name.find("dedup") != std::string::npos ? With::pair_sum_dedup : With::pair_sum;
  return name.starts_with("ii") ? With::cables : With::elastic;
}

Eigen::VectorXd displacements(const Mesh& mesh, const Json& x) {
  Eigen::VectorXd u(mesh.X.size());
  for (size_t i = 0; i < x.size(); ++i) {
    for (size_t c = 0; c < 2; ++c) {
      const Eigen::Index k = static_cast<Eigen::Index>(2 * i + c);
      u[k] = x[i][c].get<double>() - mesh.X[k];
    }
  }
  return u;
}

/// The whole energy and what is left of it without cables, contact and load.
double energy_of(const Module& module, const Eigen::VectorXd& u, const Params& p) {
  Assembly out;
  module.scene.model->evaluate({u, p}, out);
  return out.energy;
}

double relative(double a, double b) {
  return std::abs(a - b) / std::max(std::abs(b), 1e-12);
}

void expect_parts(const Module& module, const Eigen::VectorXd& u, const Params& p, const Json& parts, double total,
                  double tolerance_of_total, double tolerance) {
  EXPECT_LT(relative(energy_of(module, u, p), total), tolerance_of_total);
  const double load = -p[module.force] * module.load.dot(u);
  if (parts["load"].get<double>() != 0) {
    EXPECT_LT(relative(load, parts["load"]), tolerance);
  }
  // Elastic energy alone: cables cut (k = 0), contact switched off (kappa = 0), no load.
  Params elastic = p, cable = p;
  elastic[module.force] = cable[module.force] = 0;
  const ParameterTable& table = module.scene.model->parameters();
  for (const char* id : {"contact_pressure_plastic", "contact_pressure_foam"}) {
    if (table.contains(id)) elastic[table.index(id)] = cable[table.index(id)] = 0;
  }
  if (table.contains("k_cable")) elastic[table.index("k_cable")] = 0;
  const double strain = energy_of(module, u, elastic);
  EXPECT_LT(relative(strain, parts["elastic"]), tolerance);
  if (parts["cable"].get<double>() > 0) {
    EXPECT_LT(relative(energy_of(module, u, cable) - strain, parts["cable"]), tolerance);
  }
  if (parts["contact"].get<double>() > 0) {
    Assembly out;
    module.contact->assemble({u, p}, out);
    EXPECT_LT(relative(out.energy, parts["contact"]), tolerance);
  }
}

Eigen::VectorXd cosines(const Model& model, bool free_only) {
  Eigen::VectorXd v(model.unknowns());
  for (int i = 0; i < model.unknowns(); ++i) v[i] = free_only && model.free_index(i) < 0 ? 0.0 : std::cos(1.7 * i);
  return v;
}

TEST(SmallModule, EnergiesAndPartsAtTheListedEquilibriaAgree) {
  for (const Json& solution : reference()["solutions"]) {
    SCOPED_TRACE(solution["name"].get<std::string>());
    const Module module = module_of(kind_of(solution["name"]));
    const Params p = module.at(solution);
    const Eigen::VectorXd u = displacements(module.scene.model->mesh(), solution["x"]);
    expect_parts(module, u, p, solution["parts"], solution["total_potential"], 1e-10, 1e-10);
    for (size_t c = 0; c < module.cables.size(); ++c) {
      const auto tension = make_cable_tension(module.scene.model->mesh(), module.cables[c]);
      const auto length = make_cable_length(module.scene.model->mesh(), module.cables[c]);
      EXPECT_LT(relative(tension->value({u, p}), solution["cable_tension"][c]), 1e-9);
      EXPECT_LT(relative(length->value({u, p}), solution["cable_length"][c]), 1e-12);
    }
    const Eigen::VectorXd v = cosines(*module.scene.model, true);
    const Eigen::VectorXd Hv = module.scene.model->hessian_times({u, p}, v);
    EXPECT_LT(relative(v.dot(Hv), solution["Hv_check"]["vTHv"]), 1e-9);
    EXPECT_LT(relative(module.scene.model->restrict_to_free(Hv).norm(), solution["Hv_check"]["norm_Hv_free"]), 1e-9);
  }
}

TEST(SmallModule, TheSameNodeEdgePairsAreInContact) {
  int checked = 0;
  for (const Json& solution : reference()["solutions"]) {
    if (!solution.contains("contact")) continue;
    SCOPED_TRACE(solution["name"].get<std::string>());
    const Module module = module_of(kind_of(solution["name"]));
    const Mesh& mesh = module.scene.model->mesh();
    const Eigen::VectorXd u = displacements(mesh, solution["x"]);
    const std::vector<std::array<int, 2>> edges = contact_edges(mesh);
    std::map<std::array<int, 3>, double> found, expected;
    for (const ContactPair& pair : module.contact->active_pairs({u, module.at(solution)})) {
      const auto [a, b] =
          std::minmax({edges[static_cast<size_t>(pair.edge)][0], edges[static_cast<size_t>(pair.edge)][1]});
      found[{pair.node, a, b}] = pair.distance;
    }
    for (const Json& active : solution["contact"]["active"]) {
      const int one = active["edge"][0], two = active["edge"][1];
      expected[{active["node"], std::min(one, two), std::max(one, two)}] = active["d"];
    }
    ASSERT_EQ(found.size(), expected.size());
    for (const auto& [pair, distance] : expected) {
      ASSERT_TRUE(found.contains(pair));
      EXPECT_LT(relative(found[pair], distance), 1e-9);
    }
    ++checked;
  }
  EXPECT_EQ(checked, 4);
}

TEST(SmallModule, StatesAwayFromEquilibriumAgreeInEnergyAndDerivatives) {
  for (const Json& state : reference()["state_checks"]) {
    SCOPED_TRACE(state["name"].get<std::string>());
    const bool cables = state["parts"]["cable"].get<double>() > 0;
    const Module module = module_of(cables ? With::cables : With::elastic);
    Params p = module.scene.values;
    if (cables) p[module.retraction] = 0.005;
    const Mesh& mesh = module.scene.model->mesh();
    Eigen::VectorXd u(mesh.X.size());
    for (int i = 0; i < mesh.node_count(); ++i) {
      const double X = mesh.X[2 * i], Y = mesh.X[2 * i + 1];
      u[2 * i] = 2e-4 * std::sin(90 * X + 40 * Y);
      u[2 * i + 1] = 3e-4 * std::cos(70 * X - 55 * Y);
    }
    EXPECT_LT(relative(energy_of(module, u, p), state["total"]), 1e-9);
    Eigen::VectorXd gradient;
    Assembly out;
    out.gradient = &gradient;
    module.scene.model->evaluate({u, p}, out);
    const Eigen::VectorXd v = cosines(*module.scene.model, false);
    const Eigen::VectorXd Hv = module.scene.model->hessian_times({u, p}, v);
    EXPECT_LT(relative(gradient.norm(), state["grad_norm2"]), 1e-9);
    EXPECT_LT(relative(gradient.dot(v), state["gTv"]), 1e-9);
    EXPECT_LT(relative(v.dot(Hv), state["vTHv"]), 1e-9);
    EXPECT_LT(relative(Hv.norm(), state["Hv_norm2"]), 1e-9);
  }
}

TEST(SmallModule, OwnSolvesReachTheListedEquilibria) {
  for (const Json& solution : reference()["solutions"]) {
    SCOPED_TRACE(solution["name"].get<std::string>());
    const Module module = module_of(kind_of(solution["name"]));
    const Model& model = *module.scene.model;
    Equilibrium equilibrium(model);
    Params p = module.scene.values;
    equilibrium.start_at_rest(p);
    if (module.retraction >= 0) {
      p[module.retraction] = solution["u_cable"];
      ASSERT_EQ(equilibrium.solve(p).status, SolveStatus::converged) << equilibrium.report().message();
    }
    p = module.at(solution);
    ASSERT_EQ(equilibrium.solve(p).status, SolveStatus::converged) << equilibrium.report().message();
    expect_parts(module, equilibrium.u(), p, solution["parts"], solution["total_potential"], 1e-10, 1e-7);
    for (size_t c = 0; c < module.cables.size(); ++c) {
      const auto tension = make_cable_tension(model.mesh(), module.cables[c]);
      EXPECT_LT(relative(tension->value({equilibrium.u(), p}), solution["cable_tension"][c]), 1e-7);
    }
    const Eigen::VectorXd expected = displacements(model.mesh(), solution["x"]);
    EXPECT_LT((equilibrium.u() - expected).cwiseAbs().maxCoeff(), 1e-9);
    EXPECT_NEAR(module.tip.dot(equilibrium.u()), solution["tip_mean_uy"], 1e-9);
  }
}

}  // namespace
}  // namespace taut::test
