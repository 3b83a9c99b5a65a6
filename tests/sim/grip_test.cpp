#include "sim/contact/grip.hpp"

#include "sim/mesh/structured.hpp"
#include "sim/scene/scene.hpp"
#include "sim/solve/equilibrium.hpp"
#include "tests/support/term_battery.hpp"

namespace taut {
namespace {

using namespace test;

/// Two facing wavy lines 0.1 apart, dhat = 0.3, without elements, held where they are; then moved at random.
TermUnderTest grip_case(bool ground) {
  Mesh mesh;
  std::vector<std::array<int, 2>> edges;
  mesh.X.resize(2 * 16);
  for (int k = 0; k < 16; ++k) {
    const double x = 0.5 * (k % 8) + (k < 8 ? 0 : 0.17);
    mesh.X.segment<2>(2 * k) << x, (k < 8 ? 0 : 0.1) + 0.02 * std::sin(3 * x);
    // Bodies are on the left of their edges: the lower one's surface runs backwards.
    if (k % 8 > 0) edges.push_back(k < 8 ? std::array{k, k - 1} : std::array{k - 1, k});
  }
  ParameterTable table;
  for (const char* id : {"kappa", "dhat", "t"}) table.declare({id, id, "SI", 0, 1e30, id, false});
  ContactSettings settings;
  settings.edges = edges;
  settings.stiffness.assign(edges.size(), 0);
  settings.gap = 1;
  settings.thickness = 2;
  if (ground) settings.grounds = {{{0, -0.1}, {0.1, 1}}};
  Params p(3);
  p << 7, 0.3, 0.2;
  const Contact contact(mesh, settings);
  std::mt19937 random(3);
  const Eigen::VectorXd held = 0.005 * random_vector(mesh.X.size(), random);
  auto grip = std::make_unique<Grip>(mesh, contact, Point{held, p}, 10);
  EXPECT_GT(grip->count(), 8);
  const Eigen::VectorXd u = held + 0.01 * random_vector(mesh.X.size(), random);
  return term_under_test(mesh, std::move(table), std::move(grip), p, u, ground ? "with a ground" : "two lines");
}

TEST(Grip, PassesTheBatteryOfTerms) {
  for (const bool ground : {false, true}) {
    const TermUnderTest t = grip_case(ground);
    expect_derivatives(t, 2e-4);
    expect_parameter_derivatives(t);
    expect_symmetric_hessian(t);
    expect_projection_is_semidefinite(t);
    if (!ground) expect_no_net_force_or_moment(t);
  }
}

constexpr double kBlockLength = 40e-3, kBlockHeight = 1e-3, kBlockThickness = 0.02, kBlockGap = 2e-6,
                 kBlockModulus = 1e5;

/// Two flat blocks on each other, the lower one clamped at its bottom. The upper one's top is moved: "push" closes the
/// gap between them, "shear" moves it along.
struct Blocks {
  Scene scene;
  const Contact* contact = nullptr;
  int push = -1, shear = -1;
};

Blocks blocks() {
  Mesh upper = rectangle(graded(kBlockLength, 24), graded(kBlockHeight, 1), 2, "block");
  place(upper, Eigen::Matrix2d::Identity(), Eigen::Vector2d(0, kBlockHeight + 2 * kBlockGap));
  Mesh both =
      merge({{"lower", rectangle(graded(kBlockLength, 24), graded(kBlockHeight, 1), 2, "block")}, {"upper", upper}});
  SceneBuilder builder(std::move(both), Plane::strain, kBlockThickness);
  builder.add_solid("block", "neo_hookean", {{"E", kBlockModulus}, {"nu", 0.0}});
  Blocks result;
  result.push = builder.declare({"push", "u", "m", -1, 1, "push"}, 0.0);
  result.shear = builder.declare({"shear", "u", "m", -1, 1, "shear"}, 0.0);
  builder.fix("lower.ymin", {0, 1});
  builder.prescribe("upper.ymax", 0, result.shear);
  builder.prescribe("upper.ymax", 1, result.push);
  result.contact = &builder.add_contact(kBlockGap, {{"block", kBlockModulus}});
  result.scene = builder.build();
  return result;
}

std::unique_ptr<Grip> grip_of(const Blocks& blocks, const Equilibrium& at, double stiffness = 10) {
  return std::make_unique<Grip>(blocks.scene.model->mesh(), *blocks.contact, Point{at.u(), at.p()}, stiffness);
}

/// What moves the top along [N].
double shear_force(const Model& model, const Equilibrium& at) {
  const Eigen::VectorXd forces = gradient_of(model, at.u(), at.p());
  double sum = 0;
  for (const int node : model.mesh().select("upper.ymax").nodes()) sum += forces[2 * node];
  return sum;
}

/// Pressed together, then moved along by `shear` with this stiffness of the grip; 0: none.
double shear_force(const Blocks& blocks, double shear, double stiffness) {
  Params p = blocks.scene.values;
  Equilibrium pressed(*blocks.scene.model);
  pressed.start_at_rest(p);
  p[blocks.push] = -0.02 * kBlockHeight;
  EXPECT_EQ(pressed.solve(p).status, SolveStatus::converged) << pressed.report().message();
  p[blocks.shear] = shear;
  if (stiffness == 0) {
    EXPECT_EQ(pressed.solve(p).status, SolveStatus::converged) << pressed.report().message();
    return shear_force(*blocks.scene.model, pressed);
  }
  const Model held(*blocks.scene.model, grip_of(blocks, pressed, stiffness));
  Equilibrium sheared(held);
  sheared.start_at(pressed.u(), pressed.p());
  EXPECT_EQ(sheared.solve(pressed.p()).status, SolveStatus::converged);
  EXPECT_LT((sheared.u() - pressed.u()).cwiseAbs().maxCoeff(), 1e-12) << "what was in equilibrium still is";
  EXPECT_EQ(sheared.solve(p).status, SolveStatus::converged) << sheared.report().message();
  return shear_force(held, sheared);
}

TEST(Grip, BlocksThatArePressedSlideWithoutItAndAreOneElasticBlockInShearWithIt) {
  const Blocks pair = blocks();
  const double shear = 0.02 * kBlockHeight;
  const double G = kBlockModulus / 2, force = G * shear / (2 * kBlockHeight) * kBlockLength * kBlockThickness;
  EXPECT_NEAR(shear_force(pair, shear, 0), 0, 1e-4 * force);
  const double stuck = shear_force(pair, shear, 10);
  EXPECT_NEAR(stuck, force, 0.03 * force) << "less by what the free ends do not carry";
  for (const double stiffness : {1.0, 100.0})
    EXPECT_NEAR(shear_force(pair, shear, stiffness), stuck, 1e-3 * stuck) << "stiff enough";
}

TEST(Grip, NothingCreepsInAThousandSolves) {
  const Blocks pair = blocks();
  Params p = pair.scene.values;
  Equilibrium pressed(*pair.scene.model);
  pressed.start_at_rest(p);
  p[pair.push] = -0.02 * kBlockHeight;
  ASSERT_EQ(pressed.solve(p).status, SolveStatus::converged);
  const Model held(*pair.scene.model, grip_of(pair, pressed));
  Equilibrium sheared(held);
  sheared.start_at(pressed.u(), pressed.p());
  Eigen::VectorXd first;
  for (int i = 0; i < 1000; ++i) {
    p[pair.shear] = (i % 2 == 0 ? 0.02 : 0.018) * kBlockHeight;
    ASSERT_EQ(sheared.solve(p).status, SolveStatus::converged);
    if (i == 0) first = sheared.u();
  }
  p[pair.shear] = 0.02 * kBlockHeight;
  sheared.solve(p);
  EXPECT_LT((sheared.u() - first).cwiseAbs().maxCoeff(), 1e-11);
}

TEST(Grip, HoldsWhatTouchesAndForgetsWhatOpens) {
  const Blocks pair = blocks();
  const Model& model = *pair.scene.model;
  Equilibrium pressed(model);
  pressed.start_at_rest(pair.scene.values);
  EXPECT_EQ(grip_of(pair, pressed)->count(), 0);
  Params closed = pair.scene.values;
  closed[pair.push] = -0.02 * kBlockHeight;
  ASSERT_EQ(pressed.solve(closed).status, SolveStatus::converged);
  const std::unique_ptr<Grip> grip = grip_of(pair, pressed);
  EXPECT_GT(grip->count(), 30);
  const int all = grip->count();
  grip->drop_open(pressed.u());
  EXPECT_EQ(grip->count(), all);
  const Part& upper = model.mesh().part("upper");
  Eigen::VectorXd u = pressed.u();
  for (int node = upper.first_node; node < upper.first_node + upper.node_count; ++node)
    u[2 * node + 1] += model.mesh().node(node)[0] > kBlockLength / 2 ? kBlockGap : 0;
  grip->drop_open(u);
  EXPECT_NEAR(grip->count(), 0.5 * all, 3);
  grip->add_touching(model.mesh(), *pair.contact, {pressed.u(), closed});
  EXPECT_EQ(grip->count(), all) << "each once";
}

}  // namespace
}  // namespace taut
