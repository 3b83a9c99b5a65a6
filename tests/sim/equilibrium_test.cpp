#include "sim/solve/equilibrium.hpp"

#include <thread>

#include "tests/support/mesh_checks.hpp"
#include "tests/support/message.hpp"
#include "tests/support/problems.hpp"
#include "tests/support/term_battery.hpp"

namespace taut {
namespace {

using namespace test;

Params at_force(const Problem& problem, double force) {
  Params p = problem.scene.values;
  p[problem.force] = force;
  return p;
}

/// Largest difference of displacements relative to the bounding box.
double distance(const Problem& problem, const Eigen::VectorXd& a, const Eigen::VectorXd& b) {
  return (a - b).cwiseAbs().maxCoeff() / problem.scene.model->length_scale();
}

Equilibrium solved(const Problem& problem, double force, EquilibriumOptions options = {}) {
  Equilibrium equilibrium(*problem.scene.model, options);
  equilibrium.start_at_rest(problem.scene.values);
  const SolveReport& report = equilibrium.solve(at_force(problem, force));
  EXPECT_EQ(report.status, SolveStatus::converged) << report.message();
  return equilibrium;
}

TEST(Equilibrium, ErrorsAreSquaredFromStepToStep) {
  const Problem problem = problem_a1(4, 2);
  const Eigen::VectorXd exact = solved(problem, 1.0, {.step_tolerance = 1e-13}).u();
  // Looser tolerances end after fewer iterations: one error for each number of iterations.
  std::map<int, double> errors;
  for (double tolerance = 0.3; tolerance > 1e-9; tolerance /= 3) {
    const Equilibrium loose = solved(problem, 1.0, {.step_tolerance = tolerance});
    errors[loose.report().iterations] = distance(problem, loose.u(), exact);
    EXPECT_LE(distance(problem, loose.u(), exact), tolerance);
  }
  int squared = 0;
  for (auto next = std::next(errors.begin()); next != errors.end(); ++next) {
    const auto& [iterations, error] = *std::prev(next);
    if (next->first != iterations + 1 || error > 1e-2 || error < 1e-7) continue;
    EXPECT_LE(next->second, 50 * error * error) << "after " << next->first << " iterations";
    ++squared;
  }
  EXPECT_GE(squared, 2) << "too few iterations to tell";
}

TEST(Equilibrium, ASolveInTheLinearRangeTakesTwoIterations) {
  const Problem problem = problem_a1(4, 2);
  EXPECT_LE(solved(problem, 1e-6).report().iterations, 2);
}

/// Layered block of problem A3 with foam of E = `soft` and plastic of 1e6 times that.
Problem stiff_layers(double soft) {
  Mesh mesh = rectangle(graded(0.055, 44), graded(0.030, 24), 2, "foam");
  assign_regions(mesh,
                 [](const Eigen::VectorXd& c) { return static_cast<int>(c[0] / 0.005) % 2 == 0 ? "plastic" : "foam"; });
  SceneBuilder builder(std::move(mesh), Plane::strain, 0.030);
  builder.add_solid("plastic", "neo_hookean", {{"E", 1e6 * soft}, {"nu", 0.35}});
  builder.add_solid("foam", "neo_hookean", {{"E", soft}, {"nu", 0.2}});
  return loaded_on_xmax(std::move(builder), {0, -1});
}

TEST(Equilibrium, DoesNotStagnateAtRoundingWithAStiffnessRatioOfAMillion) {
  for (double soft : {1e2, 5e4}) {
    const Problem problem = stiff_layers(soft);
    const double force = 2e-5 * soft;  // 1 N for foam of 5e4 Pa
    const Equilibrium equilibrium = solved(problem, force);
    EXPECT_EQ(equilibrium.report().load_steps, 1);
    EXPECT_LE(equilibrium.report().iterations, 12) << equilibrium.report().message();
    const Eigen::VectorXd precise = solved(problem, force, {.step_tolerance = 1e-11}).u();
    EXPECT_LE(distance(problem, equilibrium.u(), precise), 1e-9);
    EXPECT_GT(std::abs(problem.tip.dot(precise)), 0.003);
  }
}

TEST(Equilibrium, RecoversFromAnIndefiniteStart) {
  const Problem problem = problem_a1(4, 2);
  const Model& model = *problem.scene.model;
  const Eigen::VectorXd expected = solved(problem, 1.0).u();
  Eigen::VectorXd crumpled = random_state(model.mesh(), 0, 0.05, 3);
  model.impose_supports(problem.scene.values, crumpled);
  const Eigen::MatrixXd hessian = hessian_of(model, crumpled, problem.scene.values);
  ASSERT_LT(Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(hessian).eigenvalues()[0], 0.0) << "the start tests nothing";
  Equilibrium equilibrium(model);
  equilibrium.start_at(crumpled, at_force(problem, 1.0));
  const SolveReport report = equilibrium.solve(at_force(problem, 1.0));
  EXPECT_EQ(report.status, SolveStatus::converged) << report.message();
  EXPECT_GT(report.projections, 0);
  EXPECT_LE(distance(problem, equilibrium.u(), expected), 1e-9);
}

TEST(Equilibrium, AnInvertedStartIsAStatus) {
  const Problem problem = problem_a1(2, 1);
  Eigen::VectorXd inverted = Eigen::VectorXd::Zero(problem.scene.model->unknowns());
  for (int i = 0; i < problem.scene.model->mesh().node_count(); ++i) {
    inverted[2 * i] = -2 * problem.scene.model->mesh().node(i)[0];
  }
  Equilibrium equilibrium(*problem.scene.model);
  equilibrium.start_at(inverted, problem.scene.values);
  SolveReport report;
  EXPECT_NO_THROW(report = equilibrium.solve(at_force(problem, 0.1)));
  EXPECT_EQ(report.status, SolveStatus::infeasible_start) << report.message();
  EXPECT_EQ(report.reached, 0.0);
  EXPECT_EQ((equilibrium.u() - inverted).norm(), 0.0);
  EXPECT_THROW(equilibrium.sensitivities({0}), std::logic_error);
  // Rest is always a way out.
  equilibrium.start_at_rest(problem.scene.values);
  EXPECT_EQ(equilibrium.solve(at_force(problem, 0.1)).status, SolveStatus::converged);
}

TEST(Equilibrium, ALoadThatIsTooMuchAtOnceIsTakenInStepsToTheSameAnswer) {
  const Problem problem = problem_a1(4, 2);
  const Equilibrium at_once = solved(problem, 4.0);
  const Equilibrium in_steps = solved(problem, 4.0, {.max_iterations = 4});
  EXPECT_GT(in_steps.report().load_steps, 1);
  EXPECT_EQ(in_steps.report().reached, 1.0);
  EXPECT_LE(distance(problem, at_once.u(), in_steps.u()), 1e-9);
}

TEST(Equilibrium, ALoadThatCannotBeReachedLeavesTheLastEquilibrium) {
  const Problem problem = problem_a1(2, 2);
  Equilibrium equilibrium(*problem.scene.model, {.max_iterations = 2, .max_halvings = 1});
  equilibrium.start_at_rest(problem.scene.values);
  const SolveReport report = equilibrium.solve(at_force(problem, 4.0));
  EXPECT_EQ(report.status, SolveStatus::load_step_limit) << report.message();
  EXPECT_LT(report.reached, 1.0);
  EXPECT_EQ(equilibrium.p()[problem.force], 4.0 * report.reached);
  EXPECT_NE(report.message().find("reached"), std::string::npos);
}

/// A square between plates: u_x prescribed on xmax, sides free.
struct Stretched {
  Scene scene;
  int control;
};
Stretched stretched_square(int order, double nu, Formulation formulation) {
  SceneBuilder builder(rectangle(graded(0.1, 3), graded(0.1, 3, 2.0), order, "body"), Plane::strain, 0.02);
  builder.add_solid("body", "neo_hookean", {{"E", 1.0}, {"nu", nu}}, formulation);
  const int control = builder.declare({"travel", "u", "m", -1, 1, "travel of the plate", false}, 0.0);
  builder.fix("xmin", {0});
  builder.fix("ymin", {1});  // a plane of symmetry: without it the square slips sideways before half its length is left
  builder.prescribe("xmax", 0, control);
  return {builder.build(), control};
}

TEST(Equilibrium, APrescribedStretchGivesTheHomogeneousState) {
  struct {
    double along, across, stress;
  } const table[] = {{.9, 1.044997, -.120521}, {.7, 1.150796, -.458424}, {.5, 1.288305, -1.084407}};
  for (int order : {1, 2}) {
    for (Formulation formulation : {Formulation::standard, Formulation::locking_free}) {
      if (order == 1 && formulation == Formulation::locking_free) continue;
      const Stretched problem = stretched_square(order, 0.3, formulation);
      const Model& model = *problem.scene.model;
      Equilibrium equilibrium(model);
      equilibrium.start_at_rest(problem.scene.values);
      for (const auto& [along, across, stress] : table) {
        Params p = problem.scene.values;
        p[problem.control] = 0.1 * (along - 1);
        ASSERT_EQ(equilibrium.solve(p).status, SolveStatus::converged) << equilibrium.report().message();
        const Eigen::VectorXd reaction = gradient_of(model, equilibrium.u(), p);
        double force = 0;
        for (int node : model.mesh().select("xmax").nodes()) force += reaction[2 * node];
        EXPECT_NEAR(force / (0.1 * 0.02), stress, 6e-7);
        for (int i = 0; i < model.mesh().node_count(); ++i) {
          EXPECT_NEAR(equilibrium.u()[2 * i], (along - 1) * model.mesh().node(i)[0], 1e-10);
          EXPECT_NEAR(equilibrium.u()[2 * i + 1], (across - 1) * model.mesh().node(i)[1], 1e-7);
        }
      }
    }
  }
}

TEST(Equilibrium, AStraightColumnAboveItsEulerLoadBucklesOntoTheElastica) {
  // Clamped and free ends, nu = 0; slender enough that shortening and shear change the last printed digits only.
  const double L = 0.2, H = 0.002, E = 1e6, t = 0.03,
               euler = E * t * H * H * H / 12 * std::pow(3.14159265358979 / (2 * L), 2);
  SceneBuilder builder(rectangle(graded(L, 80), {0, H / 2, H}, 2, "column"), Plane::strain, t);
  builder.add_solid("column", "neo_hookean", {{"E", E}, {"nu", 0.0}});
  const Problem problem = loaded_on_xmax(std::move(builder), {-1, 0});
  const Mesh& mesh = problem.scene.model->mesh();
  const Eigen::VectorXd across = mean_weights(mesh, mesh.select("xmax"), vec({0, 1}));
  struct {
    double load, x, y;
  } const table[] = {{1.0154, .9697, .2194}, {1.0637, .8812, .4222}, {1.1517, .7410, .5932},
                     {1.2939, .5594, .7195}, {1.5184, .3490, .7915}, {1.8848, .1232, .8032}};
  for (const auto& [load, x, y] : table) {
    Equilibrium equilibrium(*problem.scene.model);
    equilibrium.start_at_rest(problem.scene.values);
    const SolveReport& report = equilibrium.solve(at_force(problem, load * euler));
    ASSERT_EQ(report.status, SolveStatus::converged) << report.message();
    EXPECT_TRUE(report.left_saddle);
    EXPECT_TRUE(equilibrium.has_factor());
    EXPECT_EQ(report.load_steps, 1) << report.message();
    EXPECT_NEAR(1 - problem.tip.dot(equilibrium.u()) / L, x, 3e-4) << "P / P_cr = " << load;
    EXPECT_NEAR(std::abs(across.dot(equilibrium.u())) / L, y, 3e-4) << "P / P_cr = " << load;
  }
  // Below the Euler load it stays straight.
  const Equilibrium straight = solved(problem, 0.95 * euler);
  EXPECT_FALSE(straight.report().left_saddle);
  EXPECT_NEAR(across.dot(straight.u()), 0.0, 1e-9 * L);
}

TEST(Equilibrium, ASymmetricColumnFallsToTheSameSideOntoTheElasticaAtEveryLoad) {
  // The free end's place by load, from elliptic integrals (Timoshenko and Gere, table 2-1); at 4 and 9 times the Euler
  // load one load step comes to a straight column that is unstable in several modes, or all but.
  const double L = 0.2, H = 0.001, E = 1e6, t = 0.03,
               euler = E * t * H * H * H / 12 * std::pow(3.14159265358979 / (2 * L), 2);
  for (const bool upright : {false, true}) {
    Mesh mesh = upright ? rectangle({0, H / 2, H}, graded(L, 60), 2, "column")
                        : rectangle(graded(L, 60), {0, H / 2, H}, 2, "column");
    SceneBuilder builder(std::move(mesh), Plane::strain, t);
    builder.add_solid("column", "neo_hookean", {{"E", E}, {"nu", 0.0}});
    const Eigen::VectorXd along = upright ? vec({0, -1}) : vec({-1, 0}), side = upright ? vec({1, 0}) : vec({0, 1});
    const std::string end = upright ? "ymax" : "xmax";
    builder.fix(upright ? "ymin" : "xmin", {0, 1});
    const int force = builder.declare({"force", "F", "N", -1e6, 1e6, "load"}, 0.0);
    builder.add_force(end, along, force);
    const Eigen::VectorXd shortening = mean_weights(builder.mesh(), builder.mesh().select(end), along),
                          across = mean_weights(builder.mesh(), builder.mesh().select(end), side);
    const Scene scene = builder.build();
    const double table[][3] = {
        {1.0637, .8812, .4222}, {2.541, -.107, .750}, {4.029, -.340, .625}, {9.116, -.577, .421}};
    for (const auto& [load, x, y] : table) {
      Equilibrium equilibrium(*scene.model);
      equilibrium.start_at_rest(scene.values);
      Params p = scene.values;
      p[force] = load * euler;
      const SolveReport& report = equilibrium.solve(p);
      ASSERT_EQ(report.status, SolveStatus::converged) << load << ": " << report.message();
      EXPECT_EQ(report.side, upright ? "+x" : "+y") << report.message();
      EXPECT_NEAR(1 - shortening.dot(equilibrium.u()) / L, x, 5e-3) << "P / P_cr = " << load;
      EXPECT_NEAR(across.dot(equilibrium.u()) / L, y, 5e-3) << "P / P_cr = " << load;
    }
    for (double load : {14.0, 20.0, 33.0}) {
      Equilibrium equilibrium(*scene.model);
      equilibrium.start_at_rest(scene.values);
      Params p = scene.values;
      p[force] = load * euler;
      const SolveReport& report = equilibrium.solve(p);
      ASSERT_EQ(report.status, SolveStatus::converged) << load << ": " << report.message();
      EXPECT_GT(across.dot(equilibrium.u()) / L, 0.1) << "P / P_cr = " << load;
      EXPECT_GT(shortening.dot(equilibrium.u()) / L, 1.577) << "P / P_cr = " << load;
    }
  }
}

TEST(Equilibrium, TheStopFlagInterruptsAndKeepsTheLastState) {
  const Problem problem = problem_a1(4, 2);
  std::atomic<bool> stop = false;
  Equilibrium equilibrium(*problem.scene.model, {.stop = &stop});
  equilibrium.start_at_rest(problem.scene.values);
  equilibrium.solve(at_force(problem, 0.5));
  const Eigen::VectorXd before = equilibrium.u();
  stop = true;
  EXPECT_EQ(equilibrium.solve(at_force(problem, 1.0)).status, SolveStatus::interrupted);
  EXPECT_EQ((equilibrium.u() - before).norm(), 0.0);
  EXPECT_EQ(equilibrium.p()[problem.force], 0.5);
  stop = false;
  EXPECT_EQ(equilibrium.solve(at_force(problem, 1.0)).status, SolveStatus::converged);
}

TEST(Equilibrium, AWarmStartGivesTheAnswerOfAColdOne) {
  const Problem problem = problem_a1(6, 2);
  const Equilibrium cold = solved(problem, 1.0);
  Equilibrium warm(*problem.scene.model);
  warm.start_at_rest(problem.scene.values);
  Params other = at_force(problem, 1.3);
  other[problem.scene.model->parameters().index("E_beam")] *= 1.7;
  ASSERT_EQ(warm.solve(other).status, SolveStatus::converged);
  ASSERT_EQ(warm.solve(at_force(problem, 0.9)).status, SolveStatus::converged);
  ASSERT_EQ(warm.solve(at_force(problem, 1.0)).status, SolveStatus::converged);
  EXPECT_LT(warm.report().iterations, cold.report().iterations);
  EXPECT_LE(distance(problem, warm.u(), cold.u()), 1e-9);
}

TEST(Equilibrium, AlwaysProjectingFindsTheSameAnswerWithMoreIterations) {
  const Problem problem = problem_a1(4, 2);
  const Equilibrium exact = solved(problem, 1.0),
                    projected = solved(problem, 1.0, {.max_iterations = 400, .comparison = {.always_project = true}});
  EXPECT_GT(projected.report().iterations, exact.report().iterations);
  EXPECT_LE(distance(problem, exact.u(), projected.u()), 1e-7);
}

TEST(Equilibrium, TwoThreadsOnOneModelFindBitIdenticalAnswers) {
  const Problem problem = problem_a1(6, 2);
  const Equilibrium alone = solved(problem, 2.0);
  Eigen::VectorXd found[2];
  Eigen::MatrixXd sensitivities[2];
  std::vector<std::thread> threads;
  for (size_t k = 0; k < 2; ++k) {
    threads.emplace_back([&, k] {
      const Equilibrium equilibrium = solved(problem, 2.0);
      found[k] = equilibrium.u();
      sensitivities[k] = equilibrium.sensitivities({0, 1, 2, 3});
    });
  }
  for (std::thread& thread : threads) thread.join();
  for (size_t k = 0; k < 2; ++k) {
    EXPECT_TRUE(found[k] == alone.u());
    EXPECT_TRUE(sensitivities[k] == alone.sensitivities({0, 1, 2, 3}));
  }
}

TEST(Equilibrium, StatusesHaveNamesAndReportsAPhrase) {
  const Problem problem = problem_a1(2, 1);
  const std::string message = solved(problem, 0.1).report().message();
  EXPECT_NE(message.find("converged: "), std::string::npos) << message;
  EXPECT_NE(message.find("1 load step"), std::string::npos) << message;
  EXPECT_EQ(name_of(SolveStatus::not_a_minimum), "not a minimum");
}

SceneBuilder block(int d) {
  SceneBuilder builder(d == 2 ? rectangle({0, 1}, {0, 1}, 1, "block") : box({0, 1}, {0, 1}, {0, 1}, 1, "block"));
  builder.add_solid("block", "neo_hookean", {{"E", 1e5}, {"nu", 0.3}});
  return builder;
}

TEST(SceneBuilder, ABodyThatCanMoveFreelyIsRefused) {
  expect_input_error([] { block(2).build(); }, {"leave 3 of 3 rigid motions free", "fix more components"});
  expect_input_error([] { block(3).build(); }, {"leave 6 of 6 rigid motions free"});
  expect_input_error(
      [] {
        SceneBuilder builder = block(2);
        builder.fix("xmin & ymin", {0, 1});
        builder.build();
      },
      {"leave 1 of 3 rigid motions free"});
  expect_input_error(
      [] {
        SceneBuilder builder = block(3);
        builder.fix("xmin & ymin", {0, 1, 2});  // an edge: it may still turn
        builder.build();
      },
      {"leave 1 of 6 rigid motions free"});
  SceneBuilder enough = block(3);
  enough.fix("xmin", {0});
  enough.fix("ymin", {1});
  enough.fix("zmin", {2});
  EXPECT_NO_THROW(enough.build());
}

TEST(SceneBuilder, EachOfTwoSeparateBodiesNeedsItsSupports) {
  Mesh mesh = rectangle({0, 1}, {0, 1}, 1, "block");
  const Mesh copy = mesh;
  const int nodes = mesh.node_count();
  mesh.X.conservativeResize(2 * copy.X.size());
  for (int i = 0; i < nodes; ++i) mesh.X.segment<2>(2 * (nodes + i)) = copy.node(i) + Eigen::Vector2d(3, 0);
  for (int node : copy.elements) mesh.elements.push_back(node + nodes);
  mesh.region.insert(mesh.region.end(), copy.region.begin(), copy.region.end());
  expect_input_error(
      [&] {
        SceneBuilder builder(mesh);
        builder.add_solid("block", "neo_hookean", {{"E", 1e5}, {"nu", 0.3}});
        builder.fix("xmin", {0, 1});
        builder.build();
      },
      {"leave 3 of 3 rigid motions free", "(3000, 0) mm"});
}

TEST(SceneBuilder, OverlappingSupportsAreRefusedUnlessTheyAgree) {
  SceneBuilder builder = block(2);
  const int control = builder.declare({"travel", "u", "m", -1, 1, "travel", false}, 0);
  builder.fix("xmin", {0, 1});
  EXPECT_NO_THROW(builder.fix("ymin", {0, 1}));
  expect_input_error([&] { builder.prescribe("ymax", 1, control); }, {"'ymax'", "component y", "already prescribed"});
  EXPECT_NO_THROW(builder.prescribe("xmax & ymax", 1, control));
}

TEST(SceneBuilder, UnknownNamesAreAnsweredWithTheNearest) {
  using Constants = std::map<std::string, double>;
  const auto solid = [](const char* region, const char* law, const Constants& constants) {
    return [=] { SceneBuilder(rectangle({0, 1}, {0, 1}, 1, "block")).add_solid(region, law, constants); };
  };
  expect_input_error(solid("blok", "neo_hookean", {{"E", 1e5}, {"nu", 0.3}}), {"'blok'", "did you mean 'block'?"});
  expect_input_error(solid("block", "neohookean", {{"E", 1e5}, {"nu", 0.3}}), {"did you mean 'neo_hookean'?"});
  expect_input_error(solid("block", "neo_hookean", {{"E", 1e5}, {"mu", 0.3}}), {"no constant 'mu'", "E, nu"});
  expect_input_error(solid("block", "neo_hookean", {{"E", 1e5}}), {"nu", "Poisson's ratio", "missing"});
  expect_input_error(solid("block", "neo_hookean", {{"E", 1e5}, {"nu", 0.5}}), {"nu_block = 0.5", "range", "of block"});
  SceneBuilder builder = block(2);
  expect_input_error([&] { builder.fix("xmni", {0}); }, {"'xmni'", "did you mean"});
  expect_input_error([&] { builder.fix("xmin", {2}); }, {"'xmin'", "2D", "no component z", "x, y"});
  expect_input_error([&] { builder.parameters().index("E_blok"); },
                     {"'E_blok'", "did you mean 'E_block'?", "thickness"});
}

TEST(SceneBuilder, ARegionWithoutOrWithTwoMaterialsIsRefused) {
  SceneBuilder bare(rectangle({0, 1}, {0, 1}, 1, "block"));
  bare.fix("xmin", {0, 1});
  expect_input_error([&] { bare.build(); }, {"'block' has no material"});
  SceneBuilder twice = block(2);
  expect_input_error(
      [&] {
        twice.add_solid("block", "neo_hookean", {{"E", 1e5}, {"nu", 0.3}});
      },
      {"'block'", "two materials"});
}

TEST(SceneBuilder, EveryNumberIsADeclaredParameterWithItsValue) {
  SceneBuilder builder = block(2);
  builder.fix("xmin", {0, 1});
  const int g = builder.declare({"g", "g", "m/s2", 0, 100, "gravity", false}, 9.81);
  builder.add_weight("block", 1100, vec({0, -1}), g);
  const Scene scene = builder.build();
  const ParameterTable& table = scene.model->parameters();
  EXPECT_EQ(join(table.ids()), "thickness, E_block, nu_block, g, density_block");
  EXPECT_EQ((scene.values - vec({1.0, 1e5, 0.3, 9.81, 1100})).norm(), 0.0);
}

TEST(Equilibrium, ASearchEndsInTheSameStateWithFewerFactorisations) {
  const Problem problem = problem_a1(8, 2);
  const Model& model = *problem.scene.model;
  Params p = problem.scene.values, nearby = p;
  p[problem.force] = nearby[problem.force] = 2.0;
  nearby[model.parameters().index("E_beam")] *= 1.1;
  Equilibrium full(model), search(model);
  for (Equilibrium* equilibrium : {&full, &search}) {
    equilibrium->start_at_rest(problem.scene.values);
    ASSERT_EQ(equilibrium->solve(p).status, SolveStatus::converged);
  }
  ASSERT_EQ(full.solve(nearby).status, SolveStatus::converged);
  ASSERT_EQ(search.solve(nearby, Polish::search).status, SolveStatus::converged);
  EXPECT_LT(search.report().factorisations, full.report().factorisations);
  EXPECT_LE((search.u() - full.u()).cwiseAbs().maxCoeff(),
            2 * EquilibriumOptions().step_tolerance * model.length_scale());
  const Eigen::MatrixXd exact = full.sensitivities({problem.force}), near = search.sensitivities({problem.force});
  EXPECT_LE((near - exact).norm(), 2e-3 * exact.norm());
}

TEST(Equilibrium, ARoughSolveNearTheLastEquilibriumTakesNoFactorisationAtAll) {
  const Problem problem = problem_a1(8, 2);
  const Model& model = *problem.scene.model;
  Params p = problem.scene.values, nearby = p;
  p[problem.force] = 2.0;
  nearby[problem.force] = 2.02;
  Equilibrium full(model), rough(model);
  for (Equilibrium* equilibrium : {&full, &rough}) {
    equilibrium->start_at_rest(problem.scene.values);
    ASSERT_EQ(equilibrium->solve(p).status, SolveStatus::converged);
  }
  ASSERT_EQ(full.solve(nearby).status, SolveStatus::converged);
  ASSERT_EQ(rough.solve(nearby, Polish::rough).status, SolveStatus::converged);
  EXPECT_EQ(rough.report().factorisations, 0);
  EXPECT_LE((rough.u() - full.u()).cwiseAbs().maxCoeff(), EquilibriumOptions().rough_tolerance * model.length_scale());
  // Far away it factorises as any search does.
  nearby[problem.force] = 6.0;
  ASSERT_EQ(rough.solve(nearby, Polish::rough).status, SolveStatus::converged);
  ASSERT_EQ(full.solve(nearby).status, SolveStatus::converged);
  EXPECT_GT(rough.report().factorisations, 0);
  EXPECT_LE((rough.u() - full.u()).cwiseAbs().maxCoeff(), EquilibriumOptions().rough_tolerance * model.length_scale());
}

TEST(Equilibrium, LoadStepsDivideTheWay) {
  const Problem problem = problem_a1(4, 2);
  Params p = problem.scene.values;
  p[problem.force] = 1.0;
  EquilibriumOptions options;
  options.load_steps = 4;
  Equilibrium one(*problem.scene.model), four(*problem.scene.model, options);
  one.start_at_rest(problem.scene.values);
  four.start_at_rest(problem.scene.values);
  EXPECT_EQ(one.solve(p).load_steps, 1);
  EXPECT_EQ(four.solve(p).load_steps, 4);
  EXPECT_LE((one.u() - four.u()).cwiseAbs().maxCoeff(), 1e-9 * problem.scene.model->length_scale());
}

}  // namespace
}  // namespace taut
