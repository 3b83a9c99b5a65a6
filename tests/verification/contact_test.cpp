#include "sim/terms/contact.hpp"

#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>

#include "sim/core/scene.hpp"
#include "sim/mesh/structured.hpp"
#include "sim/solve/equilibrium.hpp"
#include "sim/terms/contact_geometry.hpp"
#include "sim/terms/load.hpp"

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

/// A block over a line, 20 x 10 mm, held sideways along its left face.
struct Block {
  Scene scene;
  std::unique_ptr<Contact> contact;  ///< the same as in the scene, to ask it
  int load = -1;
};

constexpr double dhat = 1e-4, kappa = 5e3, t = 0.03;

enum class Below { ground, obstacle, tilted_ground };

Block block_over(Below below, int cells, double height) {
  Block block;
  const double tilt = below == Below::tilted_ground ? 0.1 : 0;
  const Eigen::Vector2d normal(-std::sin(tilt), std::cos(tilt)), along(normal[1], -normal[0]);
  Mesh mesh = rectangle(graded(0.02, cells), graded(0.01, cells / 2), 2, "block");
  map_vertices(mesh, [&](const Eigen::VectorXd& X) -> Eigen::VectorXd { return X[0] * along + X[1] * normal; });
  SceneBuilder builder(mesh, Plane::strain, t);
  builder.add_solid("block", "neo_hookean", {{"E", 5e4}, {"nu", 0.3}});
  builder.fix("xmin", {0});
  // A weak spring to the ground would do as well; the height is prescribed instead, and then let go.
  std::vector<std::vector<Eigen::Vector2d>> obstacles;
  std::vector<GroundLine> grounds;
  const Eigen::Vector2d origin = -height * normal;
  if (below == Below::obstacle) {
    std::vector<Eigen::Vector2d> line;
    for (int k = 0; k <= 3 * cells; ++k) line.push_back(origin + (0.03 * k / (3 * cells) - 0.005) * along);
    obstacles.push_back(line);
  } else {
    grounds.push_back({origin, normal});
  }
  builder.add_contact(dhat, {{"block", kappa}}, obstacles, grounds);
  ContactSettings settings;
  settings.edges = contact_edges(builder.mesh());
  settings.stiffness.assign(settings.edges.size(), builder.parameters().index("contact_pressure_block"));
  settings.gap = builder.parameters().index("contact_gap");
  settings.thickness = builder.parameters().index("thickness");
  settings.obstacles = obstacles;
  settings.grounds = grounds;
  block.contact = std::make_unique<Contact>(builder.mesh(), settings);
  block.load = builder.declare({"g", "g", "m/s^2", -1e6, 1e6, "gravity"}, 0.0);
  builder.add_weight("block", 1000, -normal, block.load);
  block.scene = builder.build();
  return block;
}

}  // namespace
}  // namespace taut::test
