#include "calib/models/beam_model.hpp"

#include <cmath>

#include "calib/files/experiment.hpp"
#include "calib/models/beam_chain.hpp"
#include "sim/shapes/grid.hpp"
#include "tests/support/message.hpp"
#include "tests/support/push_puppet.hpp"
#include "tests/support/taylor.hpp"

namespace taut::test {
namespace {

/// A cantilever of 1e5 Pa, 30 mm thick, under forces on its free end.
Experiment cantilever(double length, double height, double poisson, Plane plane = Plane::strain) {
  Experiment e = read_experiment(TAUT_SOURCE_DIR "/experiments/foam_cantilever/experiment.toml");
  e.geometry.edit<Rectangle>().size = {length, height};
  e.geometry.plane = plane;
  e.materials[0].constants = {{"E", 1e5}, {"nu", poisson}};
  return e;
}

Trials forces(const std::vector<double>& values) {
  Trials trials;
  trials.control_ids = {"tip_load"};
  trials.control_quantities = {Quantity::force};
  trials.control_values = {{values.begin(), values.end()}};
  trials.channel_ids = {"tip"};
  for (double value : values) {
    Reading reading;
    reading.controls = {value};
    reading.sigma = 1;
    trials.readings.push_back(reading);
  }
  return trials;
}

Eigen::VectorXd predicted(BeamBench& bench) {
  const Prediction prediction = bench.protocol->predict(bench.protocol->nominal(), {});
  for (const std::string& failure : prediction.failures) ADD_FAILURE() << failure;
  return prediction.values;
}

Eigen::VectorXd predicted(const Experiment& experiment, const Trials& trials) {
  BeamBench bench = make_beam_bench(experiment, trials);
  return predicted(bench);
}

TEST(BeamModel, ACantileverHasTheDeflectionOfATimoshenkoBeam) {
  const double F = 1e-6, L = 0.1;
  for (double h : {0.01, 0.02}) {
    const double A = 0.03 * h, I = A * h * h / 12, G = 0.5e5;
    const double expected = F * L * L * L / (3 * 1e5 * I) + F * L / (5.0 / 6 * G * A);
    // The clamped end keeps its section plane, which a beam knows nothing of: less shear over a part of the height.
    EXPECT_NEAR(predicted(cantilever(L, h, 0), forces({F}))[0], expected, 1e-3 * expected);
  }
  const Eigen::VectorXd strain = predicted(cantilever(0.2, 0.005, 0.3), forces({1e-6})),
                        stress = predicted(cantilever(0.2, 0.005, 0.3, Plane::stress), forces({1e-6}));
  EXPECT_NEAR(stress[0] / strain[0], 1 / (1 - 0.3 * 0.3), 1e-3);
}

TEST(BeamModel, ClampAndLoadMayBeOnAnyPairOfOppositeSides) {
  const double expected = predicted(cantilever(0.055, 0.03, 0.3), forces({0.5}))[0];
  struct Case {
    std::string clamped, loaded;
    std::vector<double> size, down;
  };
  for (const Case& c : {Case{"xmax", "xmin", {0.055, 0.03}, {0, 1}}, Case{"ymin", "ymax", {0.03, 0.055}, {1, 0}},
                        Case{"ymax", "ymin", {0.03, 0.055}, {-2, 0}}}) {
    Experiment e = cantilever(0.055, 0.03, 0.3);
    e.geometry.edit<Rectangle>().size = c.size;
    e.geometry.edit<Rectangle>().origin = {0.3, -0.2};
    e.supports[0].on = c.clamped;
    e.loads[0].on = e.channels[0].on = c.loaded;
    e.loads[0].direction = e.channels[0].direction = c.down;
    EXPECT_NEAR(predicted(e, forces({0.5}))[0], expected, 1e-9 * expected) << c.clamped;
  }
}

TEST(BeamModel, PulledAndPressedItIsANeoHookeanBar) {
  Experiment e = cantilever(0.1, 0.02, 0);
  e.loads[0].direction = e.channels[0].direction = {1, 0};
  for (double stretch : {0.999, 1.1, 1.3}) {
    const double force = 0.03 * 0.02 * 1e5 / 2 * (stretch - 1 / stretch);
    EXPECT_NEAR(predicted(e, forces({force}))[0], 0.1 * (stretch - 1), 1e-10);
  }
}

TEST(BeamModel, ALoadBesideTheAxisBendsBySmallMomentTimesLengthOverStiffness) {
  Experiment e = cantilever(0.2, 0.005, 0);
  e.loads[0].on = "";
  e.loads[0].point = {0.2, 0.005};
  e.loads[0].direction = {1, 0};
  const double F = 1e-8, stiffness = 1e5 * 0.03 * std::pow(0.005, 3) / 12;
  EXPECT_NEAR(predicted(e, forces({F}))[0], F * 0.0025 * 0.2 * 0.2 / (2 * stiffness), 1e-3 * 1.6e-8);
}

/// The reference module with a channel along its axis.
Experiment shortening(double poisson) {
  Experiment e = reference_module();
  e.materials[0].constants["nu"] = poisson;
  e.channels[0].direction = {-1, 0};
  e.from_unloaded = false;
  return e;
}

TEST(BeamModel, BeforeClosureASymmetricRetractionIsFourFoamSpringsAgainstTwoCables) {
  Experiment e = shortening(0);
  e.cables.slack = 0.4e-3;
  for (double retraction : {3e-3, 12e-3}) {
    // 2 k (u - slack - 4 L (1 - stretch)) = A E/2 (1/stretch - stretch), nu = 0.
    double low = 0.3, high = 1;
    for (int i = 0; i < 200; ++i) {
      const double stretch = 0.5 * (low + high);
      const double cables = 2 * 20e3 * (retraction - 0.4e-3 - 4 * 11.5e-3 * (1 - stretch));
      (cables > 0.03 * 0.03 * 50e3 / 2 * (1 / stretch - stretch) ? high : low) = stretch;
    }
    EXPECT_NEAR(predicted(e, conditions_of({retraction}, {0}))[0], 4 * 11.5e-3 * (1 - low), 1e-9);
  }
}

TEST(BeamModel, ClosedLipsPressAsBarsBesideTheFoam) {
  Experiment e = shortening(0);
  e.materials[1].constants["E"] = 1e7;
  const double u = 20e-3, gap = 17.2e-3 / 4, lip = 0.5 * (11.5e-3 - gap);
  double low = 0.05, high = 1 - gap / 11.5e-3;
  for (int i = 0; i < 200; ++i) {
    const double stretch = 0.5 * (low + high);
    const double cables = 2 * 20e3 * (u - 4 * 11.5e-3 * (1 - stretch));
    const double lips = 2 * 1e7 * 0.03 * 3e-3 / (2 * lip) * (11.5e-3 * (1 - stretch) - gap);
    (cables > 0.03 * 0.03 * 50e3 / 2 * (1 / stretch - stretch) + lips ? high : low) = stretch;
  }
  EXPECT_NEAR(predicted(e, conditions_of({u}, {0}))[0], 4 * 11.5e-3 * (1 - low), 1e-8);
}

TEST(BeamModel, DerivativesAreThoseOfThePrediction) {
  Experiment e = reference_module();
  e.materials[1].constants["E"] = 1e8;
  BeamBench bench = make_beam_bench(e, conditions_of({0, 8e-3, 18.5e-3}, {0.05, 0.5}));
  BeamProtocol& beam = *bench.protocol;
  const Params p = beam.nominal();
  std::vector<int> free;
  for (const char* id : {"E_foam", "nu_foam", "E_plastic", "k_cable", "slack", "thickness", "g", "nu_plastic"})
    free.push_back(beam.parameters().index(id));
  const Prediction at = beam.predict(p, free);
  ASSERT_TRUE(at.complete());
  for (size_t k = 0; k < free.size(); ++k) {
    const Eigen::VectorXd slope = at.derivatives.col(static_cast<Eigen::Index>(k));
    const double size = beam.parameters()[free[k]].id == "slack" ? 1e-4 : 0.1 * p[free[k]];
    for (Eigen::Index row = 0; row < at.values.size(); ++row) {
      expect_taylor_order(
          [&](double h) {
            Params moved = p;
            moved[free[k]] += h;
            return std::abs(beam.predict(moved, {}).values[row] - at.values[row] - h * slope[row]);
          },
          2, 1e-13, size, 6, beam.parameters()[free[k]].id + ", row " + std::to_string(row));
    }
    EXPECT_EQ(slope.norm() > 0, beam.parameters()[free[k]].id != "nu_plastic");
  }
}

TEST(BeamModel, PlaneStressHasTheRightDerivativesToo) {
  BeamBench bench = make_beam_bench(cantilever(0.055, 0.03, 0.3, Plane::stress), forces({1.0}));
  BeamProtocol& beam = *bench.protocol;
  const int nu = beam.parameters().index("nu_foam");
  const Prediction at = beam.predict(beam.nominal(), {nu});
  expect_taylor_order(
      [&](double h) {
        Params moved = beam.nominal();
        moved[nu] += h;
        return std::abs(beam.predict(moved, {}).values[0] - at.values[0] - h * at.derivatives(0, 0));
      },
      2, 1e-13, 0.05);
}

// Effective stiffnesses of an independent program, see tests/verification/push_puppet_test.cpp.
constexpr double kOpen[3][4] = {
    {130.1, 140.5, 163.1, 261.8}, {284.2, 289.2, 308.5, 447.7}, {528.2, 536.7, 570.2, 940.3}};

TEST(BeamModel, TheOpenReferenceModuleIsWithinTheStatedErrorOfAnIndependentProgram) {
  BeamBench bench = make_beam_bench(reference_module(), conditions_of());
  const Prediction prediction = bench.protocol->predict(bench.protocol->nominal(), {});
  for (size_t u = 0; u < 3; ++u) {
    for (size_t m = 0; m < 4; ++m) {
      const double error = std::abs(kOpen[u][m] / stiffness(prediction, u, m) - 1);
      const double stated = bench.protocol->stated_error(static_cast<int>(4 * u + m));
      EXPECT_LT(error, stated) << "retraction " << u << ", mass " << m;
      EXPECT_LT(error, 0.025);
      EXPECT_LT(stated, 0.15);
    }
  }
}

TEST(BeamModel, ItStatesNoErrorWhereBothLipsAreClosedAndALargeOneForSoftPlastic) {
  Experiment e = reference_module();
  BeamBench closed = make_beam_bench(e, conditions_of({18.5e-3}, {0.05}));
  predicted(closed);
  EXPECT_EQ(closed.protocol->stated_error(0), std::numeric_limits<double>::infinity());
  e.materials[1].constants["E"] = 2.3e7;  // shifts the open module's stiffness by a third
  BeamBench soft = make_beam_bench(e, conditions_of({11.79e-3}, {0.05}));
  predicted(soft);
  EXPECT_GT(soft.protocol->stated_error(0), 0.3);
}

TEST(BeamModel, CantileversAreWithinTheStatedErrorOfSolidReferences) {
  // 55 x 30 mm, nu = 0.3; two programs on fine meshes.
  const std::vector<double> loads{0.25, 0.5, 1, 1.5, 2, 3, 4},
      tips{2.30412e-3, 4.59554e-3, 9.0920e-3, 13.403e-3, 17.464e-3, 24.70e-3, 30.74e-3};
  BeamBench stout = make_beam_bench(cantilever(0.055, 0.03, 0.3), forces(loads));
  const Eigen::VectorXd drops = predicted(stout);
  for (size_t i = 0; i < loads.size(); ++i) {
    const double error = std::abs(drops[static_cast<Eigen::Index>(i)] / tips[i] - 1);
    EXPECT_LT(error, stout.protocol->stated_error(static_cast<int>(i))) << loads[i] << " N";
  }
  EXPECT_NEAR(drops[0] / tips[0], 1, 2e-3);
  // 200 x 5 mm, load alpha B / L^2: a solid, far into the range of the elastica.
  const std::vector<double> alpha{0.5, 1, 2, 4}, ratio{0.16211, 0.30169, 0.49353, 0.67028};
  const double B = 1e5 / (1 - 0.09) * 0.03 * std::pow(0.005, 3) / 12;
  std::vector<double> small;
  for (double a : alpha) small.push_back(a * B / 0.04);
  BeamBench slender = make_beam_bench(cantilever(0.2, 0.005, 0.3), forces(small));
  const Eigen::VectorXd bent = predicted(slender);
  for (size_t i = 0; i < alpha.size(); ++i)
    EXPECT_NEAR(bent[static_cast<Eigen::Index>(i)] / 0.2 / ratio[i], 1, slender.protocol->stated_error(0));
}

TEST(SlowBeamModel, OpenModulesOfOtherFoamsAreWithinTheStatedErrorOfFiniteElements) {
  for (double poisson : {0.0, 0.4}) {
    Experiment e = reference_module();
    e.materials[0].constants["nu"] = poisson;
    const Trials trials = conditions_of({0, 6e-3}, {0.05, 0.5});
    BeamBench bench = make_beam_bench(e, trials);
    const StaticReplay full = make_static_replay(e, e.mesh, trials);
    const Eigen::VectorXd beam = predicted(bench), solid = full.protocol->predict(full.protocol->nominal(), {}).values;
    for (Eigen::Index row = 0; row < beam.size(); ++row) {
      const double error = std::abs(beam[row] / solid[row] - 1),
                   stated = bench.protocol->stated_error(static_cast<int>(row));
      EXPECT_LT(error, stated) << "nu = " << poisson << ", row " << row;
      EXPECT_GT(error, 1e-3) << "it cannot be that good";
    }
  }
}

TEST(BeamModel, ThePredictionOfABenchTakesTwelveUnknownsAndTenFactorisationsARow) {
  BeamBench bench = make_beam_bench(reference_module(), conditions_of());
  predicted(bench);
  EXPECT_EQ(bench.protocol->unknowns(), 12);
  EXPECT_LE(bench.protocol->factorisations(), 160);
  EXPECT_GE(bench.protocol->factorisations(), 32);
}

TEST(BeamModel, ATautCableStoresHalfItsStiffnessTimesItsElongationSquared) {
  BeamProtocol::Chain chain;  // one body on an elastic base, pulled by a cable from a fixed point and by a force
  chain.bodies = 1;
  chain.base = 500;
  chain.centres = {Eigen::Vector2d(0.03, 0)};
  for (const char* id : {"k_cable", "slack", "k_base", "retraction", "force"})
    chain.table.declare({id, id, "1", -1e9, 1e9, "number"});
  chain.k_cable = 0, chain.slack = 1, chain.k_base = 2;
  chain.cables.push_back(
      {{{BodyPoint{-1, Eigen::Vector2d(0, 0)}, BodyPoint{0, Eigen::Vector2d(0.03, 0.01)}}}, 3, 1e-9});
  chain.loads.push_back({BodyPoint{0, Eigen::Vector2d(0.04, 0)}, Eigen::Vector2d(0, -1), {4}, 1});
  Params p(5);
  p << 2000, 0.2e-3, 0.3, 1.5e-3, 0.7;
  const Eigen::Vector3d x(1e-3, -2e-3, 0.05);
  const auto turned = [&](double X, double Y) {  // where a point of the body is
    return Eigen::Vector2d(0.03 + x[0] + std::cos(x[2]) * (X - 0.03) - std::sin(x[2]) * Y,
                           x[1] + std::sin(x[2]) * (X - 0.03) + std::cos(x[2]) * Y);
  };
  const double e = turned(0.03, 0.01).norm() - std::hypot(0.03, 0.01) + 1.5e-3 - 0.2e-3;
  ASSERT_GT(e, 1e-3);
  const double stored =
      0.5 * 2000 * e * e + 0.5 * 500 * x.head<2>().squaredNorm() + 0.5 * 0.3 * x[2] * x[2] + 0.7 * turned(0.04, 0).y();
  EXPECT_NEAR(chain.energy(x, p), stored, 1e-8 * std::abs(stored));
  const ChainEnergy assembled = chain.assemble(x, p, {});
  EXPECT_NEAR(assembled.energy, stored, 1e-8 * std::abs(stored));
  for (int i = 0; i < 3; ++i) {
    const Eigen::Vector3d step = 1e-6 * Eigen::Vector3d::Unit(i);
    const double slope = (chain.energy(x + step, p) - chain.energy(x - step, p)) / 2e-6;
    EXPECT_NEAR(assembled.gradient[i], slope, 1e-5 * assembled.gradient.norm()) << i;
  }
}

TEST(BeamModel, ParametersStartsAndBoundsAreThoseOfTheFullModel) {
  const Experiment e = reference_module();
  const Trials trials = conditions_of({5e-3}, {0.05});
  const BeamBench beam = make_beam_bench(e, trials);
  const StaticReplay full = make_static_replay(e, e.mesh, trials);
  EXPECT_EQ(beam.protocol->parameters().ids(), full.protocol->parameters().ids());
  const std::vector<FreeParameter> one = free_parameters(e, *beam.protocol), other = free_parameters(e, *full.protocol);
  ASSERT_EQ(one.size(), 4u);
  for (size_t i = 0; i < one.size(); ++i) {
    EXPECT_EQ(one[i].index, other[i].index);
    EXPECT_EQ(one[i].start, other[i].start);
    EXPECT_EQ(one[i].lower, other[i].lower);
  }
}

TEST(BeamModel, AFitFindsTheParametersOfItsOwnReadings) {
  const Experiment e = reference_module();
  BeamBench bench = make_beam_bench(e, conditions_of({0, 8e-3}, {0.05, 0.2}));
  BeamProtocol& beam = *bench.protocol;
  Params truth = beam.nominal();
  const int E = beam.parameters().index("E_foam"), k = beam.parameters().index("k_cable");
  truth[E] = 61e3;
  truth[k] = 14e3;
  const Eigen::VectorXd values = beam.predict(truth, {}).values;
  for (Measurement& m : bench.measurements) {
    m.value = values[m.row];
    m.sigma = 1e-5;
  }
  std::vector<FreeParameter> free(2);
  free[0].index = E;
  free[0].start = 80e3;
  free[0].lower = 1e3;
  free[0].upper = 1e7;
  free[1].index = k;
  free[1].start = 5e3;
  free[1].lower = 1e2;
  free[1].upper = 1e7;
  const FitResult result = fit(beam, bench.measurements, free, {});
  EXPECT_NEAR(result.parameters[0].value, 61e3, 61);
  EXPECT_NEAR(result.parameters[1].value, 14e3, 140);
}

/// Tip deflection of an inextensible elastica without shear, clamped and level at rest, under a tip force and a weight
/// per length, both downwards all the way: B theta'' = -(F + w (L - s)) cos theta by Runge and Kutta's method, shot for
/// theta'(L) = 0.
double elastica(double force, double weight, double B, double L) {
  constexpr int steps = 2000;
  const double h = L / steps;
  double drop = 0;
  const auto end_curvature = [&](double curvature) {
    Eigen::Vector3d y(0, curvature, 0);  // theta, theta', drop
    const auto slope = [&](double s, const Eigen::Vector3d& at) {
      return Eigen::Vector3d(at[1], -(force + weight * (L - s)) / B * std::cos(at[0]), std::sin(at[0]));
    };
    for (int i = 0; i < steps; ++i) {
      const double s = i * h;
      const Eigen::Vector3d a = slope(s, y), b = slope(s + h / 2, y + h / 2 * a), c = slope(s + h / 2, y + h / 2 * b),
                            d = slope(s + h, y + h * c);
      y += h / 6 * (a + 2 * b + 2 * c + d);
    }
    drop = y[2];
    return y[1];
  };
  double low = 0, high = (force + weight * L / 2) * L / B;
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    (end_curvature(middle) < 0 ? low : high) = middle;
  }
  return drop;
}

/// A spring-steel strip on edge: 250 x 20 x 0.5 mm, bending stiffness in B.
Experiment strip(double& B) {
  Experiment e = cantilever(0.25, 0.0005, 0.3, Plane::stress);
  e.geometry.thickness = 0.02;
  e.materials[0].constants = {{"E", 206e9}, {"nu", 0.3}};
  B = 206e9 * 0.02 * std::pow(0.0005, 3) / 12;
  return e;
}

TEST(BeamModel, AThinSteelStripFollowsTheElasticaFarIntoTheNonlinearRange) {
  double B = 0;
  const Experiment e = strip(B);
  std::vector<double> loads;
  for (double alpha : {0.01, 0.3, 1.0, 3.0, 10.0}) loads.push_back(alpha * B / (0.25 * 0.25));
  BeamBench bench = make_beam_bench(e, forces(loads));
  const Eigen::VectorXd drops = predicted(bench);
  for (size_t i = 0; i < loads.size(); ++i) {
    const double expected = elastica(loads[i], 0, B, 0.25);
    EXPECT_NEAR(drops[static_cast<Eigen::Index>(i)] / expected, 1, 1e-3) << loads[i] << " N";
    EXPECT_LT(bench.protocol->stated_error(static_cast<int>(i)), 0.02);
  }
}

TEST(BeamModel, ConstantLoadsAreLaidOnBeforeTheRowsOwn) {
  double B = 0;
  Experiment e = strip(B);
  LoadSettings constant = e.loads[0];
  constant.id = "clip";
  constant.column = constant.control = "";
  constant.value = 1.2 * B / (0.25 * 0.25);
  e.loads.push_back(constant);
  const double force = 0.7 * B / (0.25 * 0.25);
  EXPECT_NEAR(predicted(e, forces({force}))[0] / elastica(force + constant.value, 0, B, 0.25), 1, 1e-3);
  e.from_unloaded = true;
  EXPECT_NEAR(predicted(e, forces({force}))[0] /
                  (elastica(force + constant.value, 0, B, 0.25) - elastica(constant.value, 0, B, 0.25)),
              1, 2e-3);
}

TEST(BeamModel, ItsOwnWeightBendsAStripAsItDoesAnElastica) {
  double B = 0;
  Experiment e = strip(B);
  e.gravity_direction = {0, -1};
  for (double density : {7.8, 7850.0, 40e3}) {
    e.materials[0].density = density;
    const double weight = density * 9.81 * 0.02 * 0.0005, force = 1e-2 * weight;
    EXPECT_NEAR(predicted(e, forces({force}))[0] / elastica(force, weight, B, 0.25), 1, 1e-3) << density;
  }
  // A stout one: F L^4/(8 B) and, by shear, w L^2/(2 x 5/6 G A).
  Experiment stout = cantilever(0.1, 0.02, 0);
  stout.gravity_direction = {0, -1};
  stout.materials[0].density = 1e-3;
  const double w = 1e-3 * 9.81 * 0.03 * 0.02, I = 0.03 * std::pow(0.02, 3) / 12;
  const double expected = w * 1e-4 / (8 * 1e5 * I) + w * 1e-2 / (2 * 5.0 / 6 * 0.5e5 * 0.03 * 0.02);
  EXPECT_NEAR(predicted(stout, forces({0}))[0] / expected, 1, 5e-3);
}

TEST(BeamModel, AnElasticClampTurnsByMomentOverStiffness) {
  Experiment e = cantilever(0.2, 0.005, 0);
  const double F = 1e-6, rigid = predicted(e, forces({F}))[0];
  e.supports[0].fix.clear();
  e.supports[0].rotation_stiffness = 2e-3;
  EXPECT_NEAR(predicted(e, forces({F}))[0] - rigid, F * 0.2 * 0.2 / 2e-3, 1e-3 * rigid);
}

TEST(BeamModel, WeightAndElasticClampOfAModuleAreThoseOfItsFiniteElements) {
  Experiment e = reference_module();
  e.gravity_direction = {0, -1};
  e.materials[0].density = 300;
  e.materials[1].density = 1240;
  e.supports[0].fix.clear();
  e.supports[0].rotation_stiffness = 3.0;
  e.from_unloaded = false;
  const Trials trials = conditions_of({0}, {0, 0.05});
  BeamBench bench = make_beam_bench(e, trials);
  const Eigen::VectorXd beams = predicted(bench);
  const StaticReplay full = make_static_replay(e, e.mesh, trials);
  const Eigen::VectorXd solid = full.protocol->predict(full.protocol->nominal(), {}).values;
  for (int row = 0; row < 2; ++row)
    EXPECT_NEAR(beams[row] / solid[row], 1, bench.protocol->stated_error(row)) << beams[row] << " m";
}

TEST(BeamModel, DerivativesByDensityGravityThicknessAndClampAreThoseOfThePrediction) {
  Experiment e = cantilever(0.1, 0.01, 0.3);
  e.gravity_direction = {0, -1};
  e.materials[0].density = 90;
  e.supports[0].fix.clear();
  e.supports[0].rotation_stiffness = 0.01;
  BeamBench bench = make_beam_bench(e, forces({0.01}));
  BeamProtocol& beam = *bench.protocol;
  const Params p = beam.nominal();
  for (const char* id : {"density_foam", "g", "thickness", "k_base", "E_foam"}) {
    const int index = beam.parameters().index(id);
    const Prediction at = beam.predict(p, {index});
    ASSERT_TRUE(at.complete()) << id;
    EXPECT_NE(at.derivatives(0, 0), 0) << id;
    expect_taylor_order(
        [&](double h) {
          Params moved = p;
          moved[index] += h;
          return std::abs(beam.predict(moved, {}).values[0] - at.values[0] - h * at.derivatives(0, 0));
        },
        2, 1e-12, 0.1 * p[index], 6, id);
  }
}

TEST(BeamModel, WhatItCannotDescribeIsRefusedInOneSentence) {
  const Trials load = forces({0.1});
  const auto refused = [&](auto&& change, const std::vector<std::string>& parts, bool module = false) {
    Experiment e = module ? reference_module() : cantilever(0.055, 0.03, 0.3);
    change(e);
    expect_input_error([&] { make_beam_bench(e, module ? conditions_of() : load); }, parts);
  };
  refused([](Experiment& e) { e.geometry.shape = make_shape("polygons"); },
          {"experiment.toml", "polygons", "push_puppet", "rectangle"});
  refused([](Experiment& e) { e.materials[0].law = "ogden_hill"; }, {"neo_hookean", "ogden_hill"});
  refused([](Experiment& e) { e.supports[0].fix = {0}; }, {"[[support]]", "xmin", "fix"});
  refused([](Experiment& e) { e.supports[0].on = "xmin & ymin"; }, {"[[support]]", "xmin"});
  refused([](Experiment& e) { e.supports[0].rotation_stiffness = 1.0; }, {"[[support]]", "fix", "rotation_stiffness"});
  refused([](Experiment& e) { e.loads[0].on = "ymax"; }, {"'tip_load'", "'xmax'"});
  refused([](Experiment& e) { e.loads[0].quantity = Quantity::pressure; }, {"'tip_load'", "forces and hung masses"});
  refused([](Experiment& e) { e.channels[0].standoff = {0, 0.01}; }, {"'tip'", "markers"});
  refused([](Experiment& e) { e.channels[0].on = "xmin"; }, {"'tip'", "'xmax'"});
  refused([](Experiment& e) { e.contact.on = true; }, {"[contact]"});
  refused([](Experiment& e) { e.geometry.edit<PushPuppet>().stud_length = 1e-3; }, {"studs"}, true);
  refused([](Experiment& e) { e.supports[0].on = "tip"; }, {"'base'"}, true);
  refused([](Experiment& e) { e.cables.cables[0].points[1][0] += 1e-4; }, {"'upper'", "own cables"}, true);
}

TEST(BeamModel, StartsAFitNearItsEndAndLeavesAloneWhatItDoesNotDescribe) {
  Experiment e = read_experiment(TAUT_SOURCE_DIR "/experiments/foam_cantilever/experiment.toml");
  const Trials trials = read_trials(e.bench);
  const StaticReplay bench = make_static_replay(e, e.mesh, trials);
  const std::vector<FreeParameter> free = free_parameters(e, *bench.protocol), start = start_by_beams(e, trials, free);
  const FitResult result = fit(*bench.protocol, bench.measurements, free);
  ASSERT_EQ(result.status, FitStatus::converged);
  EXPECT_GT(std::abs(free[0].start / result.parameters[0].value - 1), 1) << "the file's own start is far off";
  EXPECT_NEAR(start[0].start / result.parameters[0].value, 1, 0.05);
  EXPECT_EQ(start[0].lower, free[0].lower);
  e.channels[0].on = "xmin";
  EXPECT_EQ(start_by_beams(e, trials, free)[0].start, free[0].start);
}

}  // namespace
}  // namespace taut::test
