#include "sim/mesh/extrude.hpp"

#include <gtest/gtest.h>

#include "sim/mesh/structured.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/scene/scene.hpp"
#include "sim/shapes/push_puppet.hpp"
#include "sim/solve/equilibrium.hpp"
#include "tests/support/mesh_checks.hpp"
#include "tests/support/message.hpp"
#include "tests/support/term_battery.hpp"

namespace taut::test {
namespace {

/// A skewed plate with a second region on its right.
Mesh plate(int order) {
  Mesh mesh = rectangle(graded(0.4, 4), graded(0.3, 3), order, "left");
  map_vertices(mesh, [](const Eigen::VectorXd& x) { return vec({x[0] + 0.2 * x[1], x[1] + 0.5 * x[0] * x[1]}); });
  assign_regions(mesh, [](const Eigen::VectorXd& x) { return x[0] < 0.2 ? "left" : "right"; });
  return mesh;
}

TEST(Extrude, VolumesAreAreasTimesDepthRegionByRegion) {
  for (int order : {1, 2}) {
    const Mesh plane = plate(order);
    for (int layers : {1, 2, 5}) {
      const Mesh solid = extrude(plane, 0.25, layers);
      EXPECT_EQ(order_of(solid.shape), order);
      EXPECT_EQ(solid.element_count(), 3 * layers * plane.element_count());
      for (const char* region : {"left", "right"})
        EXPECT_NEAR(total_measure(solid, region), 0.25 * total_measure(plane, region), 1e-15);
    }
  }
}

TEST(Extrude, NeighboursShareWholeFacesAndMidNodesLieHalfway) {
  for (int order : {1, 2}) {
    const Mesh plane = plate(order);
    for (int layers : {1, 4}) {
      const Mesh solid = extrude(plane, 0.25, layers);
      expect_conforming(solid, 2 * total_measure(plane) + 0.25 * size_of(plane, boundary(plane)));
      if (order == 2) expect_mid_nodes_halfway(solid, 1e-15);
    }
  }
}

TEST(Extrude, SegmentsBecomeFacesPointsBecomeLinesAndBothEndsAreTagged) {
  for (int order : {1, 2}) {
    Mesh plane = plate(order);
    plane.tags["corner"] = plane.select("xmax & ymax");
    const Mesh solid = extrude(plane, 0.25, 3);
    for (const char* side : {"xmin", "xmax", "ymin", "ymax"}) {
      EXPECT_NEAR(size_of(solid, solid.select(side)), 0.25 * size_of(plane, plane.select(side)), 1e-15) << side;
      // Outward, as the plane's own: same normals.
      const Tag before = plane.select(side), after = solid.select(side);
      const Eigen::VectorXd normal = facet_normal(plane, before.entities.data());
      for (int i = 0; i < after.count(); ++i)
        EXPECT_GT(facet_normal(solid, &after.entities[i * after.nodes_per_entity]).head(2).dot(normal), 0);
    }
    EXPECT_NEAR(size_of(solid, solid.select("symmetry")), total_measure(plane), 1e-15);
    EXPECT_NEAR(size_of(solid, solid.select("side")), total_measure(plane), 1e-15);
    for (int node : solid.select("symmetry").nodes()) EXPECT_EQ(solid.node(node)[2], 0.0);
    for (int node : solid.select("side").nodes()) EXPECT_EQ(solid.node(node)[2], 0.25);
    EXPECT_NEAR(measure_of(solid, solid.select("corner")), 0.25, 1e-15);
    EXPECT_NEAR(measure_of(solid, solid.select("xmax & ymax")), 0.25, 1e-15);
    EXPECT_NEAR(measure_of(solid, solid.select("xmin & side")), measure_of(plane, plane.select("xmin")), 1e-15);
  }
}

TEST(Extrude, UniformStretchIsExact) {
  // 20 % along x between rollers; sides free: with nu = 0 the stress is E/2 (1.2 - 1/1.2) and nothing else moves.
  for (int order : {1, 2}) {
    SceneBuilder builder(extrude(rectangle({0, 0.1, 0.25}, {0, 0.07, 0.1}, order, "body"), 0.15, 2));
    builder.add_solid("body", "neo_hookean", {{"E", 2e5}, {"nu", 0.0}});
    const int pull = builder.declare({"u", "u", "m", -1, 1, "pull"}, 0.05);
    builder.fix("xmin", {0});
    builder.fix("ymin", {1});
    builder.fix("symmetry", {2});
    builder.prescribe("xmax", 0, pull);
    Scene scene = builder.build();
    Equilibrium equilibrium(*scene.model);
    Params rest = scene.values;
    rest[pull] = 0;
    equilibrium.start_at_rest(rest);
    ASSERT_EQ(equilibrium.solve(scene.values).status, SolveStatus::converged);
    const Mesh& mesh = scene.model->mesh();
    for (int i = 0; i < mesh.node_count(); ++i)
      EXPECT_LT((equilibrium.u().segment<3>(3 * i) - vec({0.2 * mesh.node(i)[0], 0, 0})).norm(), 1e-11);
    const double energy = energy_of(*scene.model, equilibrium.u(), scene.values);
    EXPECT_NEAR(energy, 2e5 / 4 * (1.2 * 1.2 - 1 - 2 * std::log(1.2)) * 0.25 * 0.1 * 0.15, 1e-10 * energy);
  }
}

TEST(Extrude, PartsKeepTheirNodesAndElementsInARow) {
  for (int order : {1, 2}) {
    Mesh other = rectangle(graded(0.1, 2), graded(0.1, 1), order, "left");
    place(other, Eigen::Rotation2Dd(0.3).toRotationMatrix(), vec({2, 1}));
    const Mesh plane = merge({{"one", plate(order)}, {"two", other}}), solid = extrude(plane, 0.1, 2);
    ASSERT_EQ(solid.parts.size(), 2u);
    int nodes = 0, elements = 0;
    for (const Part& part : solid.parts) {
      EXPECT_EQ(part.first_node, nodes);
      EXPECT_EQ(part.first_element, elements);
      nodes += part.node_count;
      elements += part.element_count;
      for (int e = part.first_element; e < elements; ++e) {
        for (int a = 0; a < solid.nodes_per_element(); ++a) {
          EXPECT_GE(solid.element(e)[a], part.first_node);
          EXPECT_LT(solid.element(e)[a], nodes);
        }
      }
    }
    EXPECT_EQ(nodes, solid.node_count());
    EXPECT_EQ(elements, solid.element_count());
    EXPECT_NEAR(size_of(solid, solid.select("two.xmin")), 0.01, 1e-15);
    for (int node : solid.select("two.xmin").nodes()) EXPECT_GT(solid.node(node)[0], 1.5);
  }
}

TEST(Extrude, ThePushPuppetModuleBecomesASolidWithItsTags) {
  const Mesh plane = mesh_push_puppet({}, {2.6e-3, 1, 2}), solid = extrude(plane, 15e-3, 2);
  EXPECT_NEAR(total_measure(solid, "foam"), 15e-3 * 4 * 11.5e-3 * 30e-3, 1e-15);
  EXPECT_NEAR(size_of(solid, solid.select("tip")), 15e-3 * 42e-3, 1e-12);
}

TEST(Extrude, WrongInputIsRefused) {
  const Mesh plane = plate(2);
  expect_input_error([&] { extrude(extrude(plane, 0.1, 1), 0.1, 1); }, {"plane mesh"});
  expect_input_error([&] { extrude(plane, 0, 1); }, {"0 mm deep", "positive"});
  expect_input_error([&] { extrude(plane, 0.1, 0); }, {"0 layers", "positive"});
  Mesh named = plane;
  named.tags["side"] = named.tags["xmin"];
  expect_input_error([&] { extrude(named, 0.1, 1); }, {"'side'", "rename"});
  Mesh halfway = plane;
  halfway.tags["point"] = {0, 1, {plane.element(0)[3]}};
  expect_input_error([&] { extrude(halfway, 0.1, 1); }, {"'point'", "corner"});
}

}  // namespace
}  // namespace taut::test
