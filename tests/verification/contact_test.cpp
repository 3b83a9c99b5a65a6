#include "sim/contact/contact.hpp"

#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>

#include "sim/mesh/structured.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/solve/equilibrium.hpp"
#include "sim/terms/load.hpp"
#include "sim/terms/solid.hpp"

// Contact against sums in 60-digit arithmetic (contact_check.json) and against equilibria that are known.
namespace taut::test {
namespace {

using Json = nlohmann::json;

Eigen::VectorXd vector_of(const Json& json) {
  const std::vector<double> list = json.get<std::vector<double>>();
  return Eigen::Map<const Eigen::VectorXd>(list.data(), static_cast<Eigen::Index>(list.size()));
}

TEST(ContactCheck, PairSumsAgreeWithSixtyDigitArithmetic) {
  const Json json = Json::parse(std::ifstream(TAUT_SOURCE_DIR "/tests/verification/contact_check.json"));
  Mesh mesh;
  mesh.X.resize(2 * static_cast<Eigen::Index>(json["nodes"].size()));
  for (size_t i = 0; i < json["nodes"].size(); ++i) {
    for (size_t c = 0; c < 2; ++c) mesh.X[static_cast<Eigen::Index>(2 * i + c)] = json["nodes"][i][c];
  }
  ContactSettings settings;
  settings.edges = json["edges"].get<std::vector<std::array<int, 2>>>();
  settings.stiffness.assign(settings.edges.size(), 0);
  settings.gap = 1;
  Params p(2);
  p << json["kappa"].get<double>(), json["dhat"].get<double>();
  Eigen::VectorXd v(mesh.X.size());
  for (Eigen::Index k = 0; k < v.size(); ++k) v[k] = std::round(std::cos(1.7 * static_cast<double>(k)) * 1e12) / 1e12;
  const Eigen::VectorXd u = Eigen::VectorXd::Zero(mesh.X.size());
  for (ContactForm form : {ContactForm::pair_sum, ContactForm::pair_sum_dedup}) {
    settings.form = form;
    const Contact contact(mesh, settings);
    const Json& expected = json[form == ContactForm::pair_sum ? "plain" : "dedup"];
    Eigen::VectorXd gradient = u, product = u;
    Assembly out;
    out.gradient = &gradient;
    out.direction = &v;
    out.product = &product;
    contact.assemble({u, p}, out);
    const double energy = expected["energy"];
    const Eigen::VectorXd force = vector_of(expected["gradient"]), Hv = vector_of(expected["Hv"]);
    EXPECT_NEAR(out.energy, energy, 1e-12 * energy);
    EXPECT_LE((gradient - force).norm(), 1e-12 * force.norm());
    EXPECT_LE((product - Hv).norm(), 1e-12 * Hv.norm());
    if (form == ContactForm::pair_sum_dedup) continue;
    const std::vector<ContactPair> pairs = contact.active_pairs({u, p});
    ASSERT_EQ(pairs.size(), json["active_pairs"].size());
    for (size_t k = 0; k < pairs.size(); ++k) {
      const Json& pair = json["active_pairs"][k];
      EXPECT_EQ(pairs[k].node, pair["node"].get<int>());
      EXPECT_EQ(pairs[k].edge, pair["edge"].get<int>());
      EXPECT_NEAR(pairs[k].distance, pair["distance"].get<double>(), 1e-17);
    }
  }
}

/// Length-weighted pressure of two faces at distance s dhat, over kappa.
double law(double s) {
  return 2 * (s - 1) * std::log(s) + (s - 1) * (s - 1) / s;
}

/// A foam block of 20 x 10 mm, `height` over a line, free but for its left face, which slides up and down.
struct Block {
  std::unique_ptr<Model> model;
  std::unique_ptr<Contact> contact;  ///< the same as in the model, to ask it
  Params values;
};
enum BlockIndex { E, nu, thickness, density, gravity, gap, kappa };
enum class Below { ground, obstacle };

Block block_over(Below below, int cells, double height) {
  Block block;
  ParameterTable table;
  SolidDefinition definition;
  for (const ParameterSpec& spec : material_parameters("neo_hookean"))
    definition.parameters.push_back(table.declare(spec));
  for (const char* id : {"thickness", "density", "gravity", "gap", "kappa"})
    table.declare({id, id, "SI", 0, 1e9, id, false});
  definition.thickness = thickness;
  block.values.resize(7);
  block.values << 5e4, 0.3, 0.03, 1000, 0, 1e-4, 5e3;

  const Mesh mesh = rectangle(graded(0.02, cells), graded(0.01, cells / 2), 2, "block");
  ContactSettings settings;
  settings.edges = contact_edges(mesh);
  settings.stiffness.assign(settings.edges.size(), kappa);
  settings.gap = gap;
  settings.thickness = thickness;
  if (below == Below::ground) {
    settings.grounds = {{{0, -height}, {0, 1}}};
  } else {
    settings.obstacles.emplace_back();
    for (int k = 0; k <= 3 * cells; ++k) settings.obstacles[0].emplace_back(-0.005 + 0.01 * k / cells, -height);
  }
  block.contact = std::make_unique<Contact>(mesh, settings);
  std::vector<std::unique_ptr<Term>> terms;
  terms.push_back(make_solid(mesh, definition));
  terms.push_back(make_load(body_weights(mesh, 0, Eigen::Vector2d(0, -1)), {density, gravity, thickness}));
  terms.push_back(std::make_unique<Contact>(mesh, settings));
  std::vector<Support> supports;
  for (int node : mesh.select("xmin").nodes()) supports.push_back({2 * node, -1, 0});
  block.model = std::make_unique<Model>(mesh, table, std::move(terms), supports);
  return block;
}

TEST(ContactEquilibrium, ABlockOnTheGroundIsCarriedByIt) {
  for (Below below : {Below::ground, Below::obstacle}) {
    const Block block = block_over(below, 16, 0.9e-4);
    Equilibrium equilibrium(*block.model);
    equilibrium.start_at_rest(block.values);
    Params p = block.values;
    p[gravity] = 9.81;
    const SolveReport& report = equilibrium.solve(p);
    ASSERT_EQ(report.status, SolveStatus::converged) << report.message();
    EXPECT_FALSE(block.contact->intersects(equilibrium.u()));
    Eigen::VectorXd force = Eigen::VectorXd::Zero(block.model->unknowns());
    Assembly out;
    out.gradient = &force;
    block.contact->assemble({equilibrium.u(), p}, out);
    double up = 0;
    for (Eigen::Index k = 1; k < force.size(); k += 2) up -= force[k];
    const double weight = 1000 * 9.81 * 0.02 * 0.01 * 0.03;
    EXPECT_NEAR(up, weight, 1e-9 * weight);
    // Standing: weight / area, and the distance that belongs to it.
    const double smallest = block.contact->smallest_distance(equilibrium.u(), 1e-4) / 1e-4;
    EXPECT_NEAR(law(smallest), weight / (0.02 * 0.03) / 5e3, 0.2 * law(smallest));
  }
}

TEST(ContactEquilibrium, ABlockPressedDeepIntoTheBarrierIsCarriedAsWell) {
  const Block block = block_over(Below::ground, 8, 0.99e-4);
  Equilibrium equilibrium(*block.model);
  equilibrium.start_at_rest(block.values);
  Params p = block.values;
  p[gravity] = 300;
  const SolveReport& report = equilibrium.solve(p);
  ASSERT_EQ(report.status, SolveStatus::converged) << report.message();
  const double weight = 1000 * 300 * 0.02 * 0.01 * 0.03;
  Eigen::VectorXd force = Eigen::VectorXd::Zero(block.model->unknowns());
  Assembly out;
  out.gradient = &force;
  block.contact->assemble({equilibrium.u(), p}, out);
  double up = 0;
  for (Eigen::Index k = 1; k < force.size(); k += 2) up -= force[k];
  EXPECT_NEAR(up, weight, 1e-9 * weight);
}

TEST(ContactEquilibrium, ANodePressedOntoALineRestsWhereTheBarrierLawSays) {
  // One edge over a ground carries F by its two nodes; p / kappa and s from the closed form.
  const double table[][2] = {{1e-3, .982}, {1e-2, .943}, {0.1, .829}, {0.3, .717}, {1, .532}, {3, .320}, {10, .122}};
  Mesh mesh;
  mesh.X = Eigen::Vector4d(0, 0.99e-4, 0.01, 0.99e-4);
  ParameterTable names;
  for (const char* id : {"kappa", "dhat", "thickness", "F"}) names.declare({id, id, "SI", 0, 1e9, id, false});
  ContactSettings settings;
  settings.edges = {{0, 1}};
  settings.stiffness = {0};
  settings.gap = 1;
  settings.thickness = 2;
  settings.grounds = {{{0, 0}, {0, 1}}};
  std::vector<std::unique_ptr<Term>> terms;
  terms.push_back(std::make_unique<Contact>(mesh, settings));
  terms.push_back(make_load(Eigen::Vector4d(0, -0.5, 0, -0.5), {3}));
  const Model model(mesh, names, std::move(terms), {{0, -1, 0}, {2, -1, 0}});
  Params p(4);
  p << 5e3, 1e-4, 0.03, 0;
  Equilibrium equilibrium(model);
  equilibrium.start_at_rest(p);
  for (const auto& [pressure, s] : table) {
    p[3] = pressure * 5e3 * 0.01 * 0.03;
    const SolveReport& report = equilibrium.solve(p);
    ASSERT_EQ(report.status, SolveStatus::converged) << report.message();
    const double found = (0.99e-4 + equilibrium.u()[1]) / 1e-4;
    EXPECT_NEAR(found, s, 6e-4);
    EXPECT_NEAR(law(found), pressure, 1e-8 * pressure);
    EXPECT_NEAR(equilibrium.u()[3], equilibrium.u()[1], 1e-12);
  }
}

}  // namespace
}  // namespace taut::test
