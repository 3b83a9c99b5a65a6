#include "calib/runs/run_fit.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>

#include "calib/runs/open_bench.hpp"
#include "sim/core/units.hpp"
#include "sim/mesh/structured.hpp"
#include "sim/scene/contact_force.hpp"
#include "tests/support/experiment_files.hpp"

namespace taut {
namespace {

using namespace test;

const std::string kWhole = replaced(beam_toml, "cells = [10, 4]", "cells = [4, 1]") +
                           "\n[fit.diagnostic]\nparameter = \"E_foam\"\nper = \"pull\"\n"
                           "\n[[fit.variant]]\nname = \"coarser\"\ncells = [3, 1]\n";

class RunFit : public testing::Test {
 protected:
  RunRecord run(const RunEvents& events, const std::string& toml = kWhole, const std::string& csv = beam_csv) {
    folder.write("bench.csv", csv);
    const std::unique_ptr<Bench> bench = open_bench(folder.write("experiment.toml", toml));
    EvaluationLog log(folder / ("log_" + std::to_string(logs++)), "test");
    return run_fit(*bench, start_record(*bench), log, {}, events);
  }
  TemporaryFolder folder;
  int logs = 0;
};

TEST_F(RunFit, AStageThatThrowsIsARemarkAndCostsItselfAlone) {
  std::vector<std::string> stages;
  RunEvents watching;
  watching.begins = [&](std::string_view stage) { stages.emplace_back(stage); };
  const RunRecord whole = run(watching);
  EXPECT_TRUE(whole.failed_stages.empty());
  ASSERT_GE(stages.size(), 6u) << "replay, curves, shapes, shares, two parts, a variant";
  for (const std::string& faulty : stages) {
    int kept = 0;
    RunEvents events;
    events.begins = [&](std::string_view stage) {
      if (stage == faulty) throw std::runtime_error("a fault");
    };
    events.keep = [&](const RunRecord& so_far) {
      EXPECT_EQ(so_far.fit.status, FitStatus::converged);
      ++kept;
    };
    const RunRecord record = run(events);
    EXPECT_EQ(record.failed_stages, std::vector{faulty + " failed and is left out: a fault"});
    EXPECT_EQ(record.remarks.back(), record.failed_stages.back());
    EXPECT_EQ(record.fit.p, whole.fit.p) << faulty;
    EXPECT_EQ(kept, static_cast<int>(stages.size()) + 1) << "after the fit and after each stage";
    const size_t parts = record.curves.size() + record.shapes.size() + record.shares.size() +
                         record.diagnostics.size() + record.variants.size() + record.explanations.size() +
                         record.start_curves.size();
    const size_t all = whole.curves.size() + whole.shapes.size() + whole.shares.size() + whole.diagnostics.size() +
                       whole.variants.size() + whole.explanations.size() + whole.start_curves.size();
    EXPECT_TRUE(parts < all || faulty == "the replay" || faulty == "the scatter" || faulty == "other equilibria")
        << faulty;
  }
}

TEST_F(RunFit, TheSetupSaysWhichModelAnswersAndHowFarItMayBeOff) {
  const auto model = [&](const std::string& keys) {
    folder.write("bench.csv", beam_csv);
    const std::string toml = replaced(beam_toml, "title = \"A small beam\"", "title = \"A small beam\"\n" + keys);
    for (const auto& [label, text] : open_bench(folder.write("experiment.toml", toml))->describe()) {
      if (label == "model") return text;
    }
    return std::string("nothing");
  };
  EXPECT_EQ(model(""), "\"full\": finite elements, in which all deforms");
  EXPECT_TRUE(model("model = \"auto\"\ntolerance = \"2.5 %\"\n")
                  .starts_with("\"auto\": row by row the cheapest that is within 2.5 %, chosen when the fit begins"));
  EXPECT_TRUE(model("model = \"beam\"\n").starts_with("\"beam\": a chain of Timoshenko beams, "));
}

TEST_F(RunFit, CurvesAtTheStartAreThoseOfTheStartingModulus) {
  // Small loads on one elastic material: displacements go with the inverse of the modulus.
  const RunRecord record =
      run({}, replaced(beam_toml, "0.1 mm", "0.001 mm"), "trial,pull_N,tip_mm\na,0.0005,0.3\na,0.001,0.6\n");
  ASSERT_EQ(record.fit.status, FitStatus::converged) << record.fit.message;
  const ParameterEstimate& modulus = record.fit.parameters.front();
  ASSERT_GT(std::abs(std::log(modulus.start / modulus.value)), 0.05);
  ASSERT_EQ(record.start_curves.size(), record.curves.size());
  ASSERT_EQ(record.start_curves.size(), 1u);
  const CurveRecord &start = record.start_curves[0], &fitted = record.curves[0];
  EXPECT_EQ(start.load, fitted.load);
  ASSERT_EQ(start.value.size(), fitted.value.size());
  for (size_t i = 0; i < start.value.size(); ++i)
    EXPECT_NEAR(start.value[i] * modulus.start, fitted.value[i] * modulus.value,
                1e-3 * std::abs(fitted.value[i]) * modulus.value);
}

TEST_F(RunFit, PartsWhoseModuliScatterAreAShareOfTheirSpreadAndSayWhatTheNextOneWillBe) {
  // Drops in proportion to the loads over moduli of 0.8, 1 and 1.25 of a middle one: their logarithms differ by
  // ln 1.25.
  const std::string toml =
      replaced(beam_toml, "0.1 mm", "0.001 mm") + "\n[fit.diagnostic]\nparameter = \"E_foam\"\nper = \"pull\"\n";
  const RunRecord record = run({}, toml, "trial,pull_N,tip_mm\na,0.001,0.3\na,0.002,0.48\na,0.004,0.768\n");
  ASSERT_EQ(record.fit.status, FitStatus::converged) << record.fit.message;
  ASSERT_EQ(record.diagnostics.size(), 3u);
  EXPECT_NEAR(record.diagnostics[1].value / record.diagnostics[0].value, 1.25, 1e-3);
  EXPECT_NEAR(record.diagnostics[2].value / record.diagnostics[1].value, 1.25, 1e-3);
  const auto share = std::ranges::find(record.shares, "scatter between pulls", &Share::source);
  ASSERT_NE(share, record.shares.end());
  // Student's t with two degrees of freedom.
  const ParameterEstimate& modulus = record.fit.parameters.front();
  const double between = std::log(1.25) * modulus.value, t = 4.302653;
  EXPECT_EQ(share->bias, std::vector<double>{0});
  ASSERT_EQ(share->error.size(), 1u);
  EXPECT_NEAR(share->error[0] / (t * between / std::sqrt(3)), 1, 2e-3);
  EXPECT_EQ(share->how, "3 values of E_foam scatter by " + with_unit(between, "Pa", 2) +
                            " beyond their errors (one standard deviation); another pull is predicted to +- " +
                            with_unit(t * between * std::sqrt(4.0 / 3), "Pa", 2));
  EXPECT_LE(*modulus.total_lower95, *modulus.lower95);
}

// A modulus goes as one over the thickness: 5 % of it are 5 % of the modulus, wherever its bound is.
TEST_F(RunFit, ABoundNearbyCutsNoShare) {
  const std::string csv = "trial,pull_N,tip_mm\na,0.001,0.3\na,0.002,0.6\nb,0.001,0.302\nb,0.002,0.598\n";
  const std::string wide = replaced(beam_toml, "thickness = \"20 mm\"", "thickness = \"20 mm +- 1 mm\"");
  const double E = run({}, wide, csv).fit.parameters.front().value;
  const std::string near = replaced(wide, "upper = \"10 MPa\"", fmt::format("upper = \"{} Pa\"", 1.03 * E));
  for (const std::string& toml : {wide, near}) {
    const RunRecord record = run({}, replaced(toml, "start = \"50 kPa\"", fmt::format("start = \"{} Pa\"", E)), csv);
    const auto share = std::ranges::find(record.shares, "thickness", &Share::source);
    ASSERT_NE(share, record.shares.end());
    EXPECT_NEAR(share->error[0] / E, 0.05, 0.003);
    EXPECT_LT(*record.fit.parameters.front().total_lower95, 0.955 * E);
  }
}

// Beyond some softness of the beam no clamp makes up for it: a search that has been there finds no way back by itself.
TEST(Profiles, AnEndIsNotWhereASearchFromOutsideGetsStuck) {
  TemporaryFolder folder;
  std::string csv = "trial,pull_N,tip_mm\n";
  for (const char* row : {"a,0.5,4.64", "b,0.5,4.61", "c,0.5,4.70", "a,1,9.10", "b,1,9.18", "c,1,9.06", "a,2,17.55",
                          "b,2,17.40", "c,2,17.42", "a,4,30.73", "b,4,30.71", "c,4,30.91"})
    csv += std::string(row) + "\n";
  folder.write("bench.csv", csv);
  std::string toml = replaced(beam_toml, "data = \"simulated\"", "data = \"simulated\"\nmodel = \"beam\"");
  toml = replaced(toml, "size = [\"60 mm\", \"12 mm\"]", "size = [\"55 mm\", \"30 mm\"]");
  toml = replaced(toml, "thickness = \"20 mm\"", "thickness = \"30 mm\"");
  toml = replaced(toml, "fix = [\"x\", \"y\"]", "rotation_stiffness = \"20 Nm/rad\"");
  toml = replaced(toml, "{ absolute = \"0.1 mm\" }",
                  "{ relative = \"1 %\", absolute = \"0.02 mm\", resolution = \"0.01 mm\" }");
  const auto fitted = [&](const std::string& file, const std::string& text) {
    const std::unique_ptr<Bench> bench = open_bench(folder.write(file, text));
    return fit(bench->protocol(), bench->measurements(), bench->better_starts(bench->free()));
  };
  const FitResult both = fitted("both.toml", toml + "\n[fit.free.k_base]\n");
  ASSERT_EQ(both.status, FitStatus::converged);
  const FitResult stiff =
      fitted("stiff.toml", replaced(toml, "rotation_stiffness = \"20 Nm/rad\"", "rotation_stiffness = \"8 Nm/rad\""));
  ASSERT_EQ(stiff.status, FitStatus::converged);
  ASSERT_LT(stiff.chi_squared, both.chi_squared + 3.84) << "so that its modulus lies within the interval";
  ASSERT_LT(stiff.parameters[0].value, 0.8 * both.parameters[0].value);
  if (both.parameters[0].lower95) {
    EXPECT_LE(*both.parameters[0].lower95, 1.001 * stiff.parameters[0].value);
  }
}

TEST(RunFitOfSolids, RowsOfTheSolidHaveNoShareOfAPlaneSection) {
  TemporaryFolder folder;
  folder.write("bench.csv", "trial,pull_N,tip_mm\na,0.02,0.4\nb,0.02,0.41\n");
  std::string toml = replaced(beam_toml, "nu = 0.3", "nu = 0.45");
  toml = replaced(toml, "thickness = \"20 mm\"", "thickness = \"60 mm\"");
  toml = replaced(toml, "data = \"simulated\"", "data = \"simulated\"\nmodel = \"auto\"");
  toml = replaced(toml, "cells = [10, 4]", "cells = [8, 2]");
  const std::unique_ptr<Bench> bench = open_bench(folder.write("experiment.toml", toml));
  ASSERT_NE(bench->choice().find("1 of 1 rows from the solid"), std::string::npos) << bench->choice();
  EvaluationLog log(folder / "log", "test");
  const RunRecord record = run_fit(*bench, start_record(*bench), log, {}, {});
  ASSERT_EQ(record.fit.status, FitStatus::converged) << record.fit.message;
  for (const char* source : {"model", "plane section"}) {
    const auto share = std::ranges::find(record.shares, source, &Share::source);
    ASSERT_NE(share, record.shares.end()) << source;
    EXPECT_EQ(share->bias[0], 0) << share->how;
    EXPECT_EQ(share->error[0], 0) << share->how;
  }
}

TEST(TiedTriple, EndsInAResultThatSaysSo) {
  TemporaryFolder folder;
  folder.write("bench.csv",
               "trial,pull_N,tip_mm\na,0.02,1.4\na,0.05,3.5\na,0.1,6.8\nb,0.02,1.5\nb,0.05,3.4\nb,0.1,6.9\n");
  const std::unique_ptr<Bench> bench = open_bench(folder.write(
      "experiment.toml", beam_toml + "\n[fit.free.nu_foam]\nlower = \"0\"\nupper = \"0.45\"\n[fit.free.thickness]\n"
                                     "lower = \"10 mm\"\nupper = \"40 mm\"\n"));
  const FitResult result = fit(bench->protocol(), bench->measurements(), bench->better_starts(bench->free()));
  EXPECT_EQ(result.status, FitStatus::converged) << result.message;
  for (const ParameterEstimate& e : result.parameters) {
    // E times thickness is seen, and Poisson's ratio hardly: within the bounds of one the other may be anything.
    EXPECT_EQ(e.verdict, e.spec.id == "nu_foam" ? Verdict::invisible : Verdict::tied) << e.explanation;
    EXPECT_FALSE(e.lower95 || e.upper95) << e.spec.id;
  }
}

TEST_F(RunFit, WhatCannotBeKeptInALaterStageDoesNotEndTheRun) {
  int calls = 0;
  RunEvents events;
  events.keep = [&](const RunRecord&) {
    if (++calls > 1) throw std::runtime_error("no room");
  };
  const RunRecord record = run(events);
  EXPECT_EQ(record.fit.status, FitStatus::converged);
  EXPECT_EQ(record.variants.size(), 1u);
  EXPECT_NE(record.remarks.back().find("no room"), std::string::npos);
}

// ---- shapes

/// Shapes of all conditions with the starting values.
std::vector<ShapeRecord> shapes_of(const TemporaryFolder& folder, const std::string& toml, const std::string& csv) {
  folder.write("bench.csv", csv);
  const std::unique_ptr<Bench> bench = open_bench(folder.write("experiment.toml", toml));
  const Prediction prediction = bench->protocol().predict(bench->protocol().nominal(), {});
  for (const std::string& failure : prediction.failures) ADD_FAILURE() << failure;
  return draw_shapes(bench->states());
}

/// A block on a floor, guided so that it can only move up and down: the floor bears all that is hung on it.
const std::string kOnFloor =
    replaced(replaced(replaced(replaced(beam_toml, "fix = [\"x\", \"y\"]", "fix = [\"x\"]"),
                               "on = \"xmax\"\ndirection = [0, -1]\ncolumn = \"pull_N\"",
                               "on = \"ymax\"\ndirection = [0, -1]\ncolumn = \"pull_N\""),
                      "[mesh]", "[mesh]\ncontact_gap = \"0.02 mm\""),
             "[bench]", "[[contact.ground]]\npoint = [\"0 mm\", \"-0.05 mm\"]\nnormal = [0, 1]\n[bench]");

TEST(Shapes, ContactForcesBalanceTheLoadAndTheirPatchIsTheFaceOnTheFloor) {
  const TemporaryFolder folder;
  const std::vector<ShapeRecord> shapes = shapes_of(folder, kOnFloor, "trial,pull_N,tip_mm\na,0.05,1\na,0.1,2\n");
  ASSERT_EQ(shapes.size(), 3u);
  EXPECT_TRUE(shapes[0].contacts.empty()) << "at rest";
  for (size_t k : {1, 2}) {
    const double load = 0.05 * static_cast<double>(k);
    ASSERT_EQ(shapes[k].contacts.size(), 1u);
    const ContactRecord& contact = shapes[k].contacts[0];
    EXPECT_NEAR(contact.force[0], 0, 1e-8);
    EXPECT_NEAR(contact.force[1], load, 1e-7 * load);
    EXPECT_NEAR(contact.centre[0], 30e-3, 1e-3) << "below the middle of the face that the load is on";
    // All 10 quadratic edges of the lower face.
    EXPECT_EQ(contact.places.size(), 2u * 21u);
    for (size_t i = 1; i < contact.places.size(); i += 2) EXPECT_NEAR(contact.places[i], 0, 0.1e-3);
  }
}

TEST(Shapes, InSpaceTheyHaveTheSurfaceThatEnclosesTheSpecimen) {
  std::string toml = replaced(beam_toml, "kind = \"rectangle\"\nsize = [\"60 mm\", \"12 mm\"]",
                              "kind = \"box\"\nsize = [\"60 mm\", \"12 mm\", \"20 mm\"]");
  toml = replaced(replaced(toml, "thickness = \"20 mm\"\n", ""), "plane = \"strain\"\n", "");
  toml = replaced(toml, "cells = [10, 4]\nelement = \"quadratic\"", "cells = [6, 2, 2]\nelement = \"linear\"");
  toml = replaced(toml, "fix = [\"x\", \"y\"]", "fix = [\"x\", \"y\", \"z\"]");
  toml = replaced(toml, "direction = [0, -1]\ncolumn = \"pull_N\"", "direction = [0, -1, 0]\ncolumn = \"pull_N\"");
  toml = replaced(toml, "direction = [0, -1]\ncolumn = \"tip_mm\"", "direction = [0, -1, 0]\ncolumn = \"tip_mm\"");
  const TemporaryFolder folder;
  const std::vector<ShapeRecord> shapes = shapes_of(folder, toml, "trial,pull_N,tip_mm\na,0.05,1\na,0.1,2\n");
  ASSERT_EQ(shapes.size(), 3u);
  // The surface of 6 x 2 x 2 cells: 7 * 3 * 3 nodes less the 5 inside; it encloses the block's volume.
  const std::vector<double>& points = shapes[0].points;
  ASSERT_EQ(points.size(), 3u * (63 - 5));
  EXPECT_EQ(shapes[2].points.size(), points.size());
  const std::unique_ptr<Bench> bench = open_bench(folder / "experiment.toml");
  const SurfaceRecord surface = surface_record(*bench->states().mesh);
  EXPECT_EQ(surface.regions, std::vector<std::string>{"foam"});
  double volume = 0;
  for (size_t t = 0; t < surface.triangles.size(); t += 3) {
    const auto corner = [&](size_t c) {
      return Eigen::Map<const Eigen::Vector3d>(&points[3 * static_cast<size_t>(surface.triangles[t + c])]);
    };
    volume += corner(0).dot(corner(1).cross(corner(2))) / 6;
  }
  EXPECT_NEAR(volume, 60e-3 * 12e-3 * 20e-3, 1e-12);
}

TEST(Shapes, PatchesOfContactAreNeighboursWhoseForcesGoTheSameWayAndAddUpToAllForces) {
  const Mesh mesh = box({0, 1, 2}, {0, 1, 2}, {0, 1, 2}, 1, "foam");
  // Pressed from the left, on an edge from the right, and beside that edge against it.
  Eigen::VectorXd u = Eigen::VectorXd::Zero(mesh.X.size()), forces = u;
  for (int i = 0; i < mesh.node_count(); ++i) {
    const Eigen::VectorXd X = mesh.node(i);
    u[3 * i + 1] = 0.25;
    if (X[0] == 0 && X[1] < 2) forces[3 * i] = 1 + X[1];
    if (X[0] == 2 && X[1] == 2) forces[3 * i] = -4;
    if (X[0] == 1 && X[1] == 2 && X[2] == 1) forces[3 * i] = 0.5;
  }
  const std::vector<ContactPatch> patches = contact_patches(mesh, u, forces);
  ASSERT_EQ(patches.size(), 3u);
  EXPECT_EQ(patches[0].nodes.size(), 3u);
  EXPECT_EQ(patches[0].force, Eigen::Vector3d(-12, 0, 0));
  EXPECT_EQ(patches[1].nodes.size(), 6u);
  EXPECT_EQ(patches[1].force, Eigen::Vector3d(9, 0, 0));
  EXPECT_LT((patches[1].centre - Eigen::Vector3d(0, 2.0 / 3 + 0.25, 1)).norm(), 1e-12);
  EXPECT_EQ(patches[2].force, Eigen::Vector3d(0.5, 0, 0));
  EXPECT_TRUE(contact_patches(mesh, u, 0 * forces).empty());
}

}  // namespace
}  // namespace taut
