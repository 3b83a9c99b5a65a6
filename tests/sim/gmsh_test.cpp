#include "sim/mesh/gmsh.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "tests/support/mesh_checks.hpp"
#include "tests/support/message.hpp"

namespace taut {
namespace {

using namespace test;

#if TAUT_HAS_GMSH
PolygonRegion square(const std::string& region, double x0, double y0, double x1, double y1) {
  return {region, {{x0, y0}, {x1, y0}, {x1, y1}, {x0, y1}}, {}};
}

std::set<int> nodes_of_region(const Mesh& mesh, const std::string& name) {
  std::set<int> nodes;
  for (int e = 0; e < mesh.element_count(); ++e) {
    if (mesh.region[e] != mesh.region_index(name)) continue;
    nodes.insert(mesh.element(e), mesh.element(e) + mesh.nodes_per_element());
  }
  return nodes;
}

int shared_nodes(const Mesh& mesh, const std::string& a, const std::string& b) {
  const std::set<int> first = nodes_of_region(mesh, a);
  const std::set<int> second = nodes_of_region(mesh, b);
  return static_cast<int>(std::count_if(first.begin(), first.end(), [&](int node) { return second.contains(node); }));
}

TEST(GmshPolygons, AnIrregularOutlineHasItsExactAreaAndTaggedLengths) {
  for (int order : {1, 2}) {
    // An L, clockwise, far from the origin and small, as drawings in metres are.
    PolygonRegion l{"l", {{1.0, 2.0}, {1.0, 2.003}, {1.001, 2.003}, {1.001, 2.001}, {1.002, 2.001}, {1.002, 2.0}}, {}};
    l.edge_tags = {"wall", "", "", "step", "", "floor"};
    const Mesh mesh = mesh_polygons({l}, 2e-4, order);
    EXPECT_NO_THROW(mesh.check("l"));
    EXPECT_NEAR(total_measure(mesh), 4e-6, 1e-17);
    expect_conforming(mesh, 10e-3);
    EXPECT_NEAR(size_of(mesh, mesh.select("wall")), 3e-3, 1e-15);
    EXPECT_NEAR(size_of(mesh, mesh.select("step")), 1e-3, 1e-15);
    EXPECT_NEAR(facet_normal(mesh, mesh.select("floor").entities.data()).normalized()[1], -1.0, 1e-12);
    EXPECT_EQ(mesh.select("wall & floor").count(), 1);
    EXPECT_EQ((mesh.node(mesh.select("wall & floor").entities[0]) - vec({1.0, 2.0})).norm(), 0.0);
    for (int node : mesh.select("wall").nodes()) EXPECT_EQ(mesh.node(node)[0], 1.0);
    if (order == 2) expect_mid_nodes_halfway(mesh);
    EXPECT_GT(mesh.element_count(), 100);
    EXPECT_LT(mesh.element_count(), 1000);
  }
}

TEST(GmshPolygons, RegionsThatShareAnEdgeAreBonded) {
  PolygonRegion foam = square("foam", 0.0, 0.0, 0.1, 0.02);
  foam.edge_tags = {"ground", "", "interface", ""};
  PolygonRegion plate = square("plate", 0.0, 0.02, 0.1, 0.025);
  plate.edge_tags = {"interface", "", "top", ""};
  const Mesh mesh = mesh_polygons({foam, plate}, 0.005, 2);
  EXPECT_EQ(mesh.region_names, (std::vector<std::string>{"foam", "plate"}));
  EXPECT_NEAR(total_measure(mesh, "foam"), 2e-3, 1e-15);
  EXPECT_NEAR(total_measure(mesh, "plate"), 5e-4, 1e-15);
  expect_conforming(mesh, 0.25);
  EXPECT_EQ(shared_nodes(mesh, "foam", "plate"), 41);  // 20 quadratic segments
  EXPECT_EQ(mesh.select("interface").count(), 20);
  for (int node : mesh.select("interface").nodes()) EXPECT_EQ(mesh.node(node)[1], 0.02);
}

TEST(GmshPolygons, AVertexOnAnotherPolygonsEdgeSplitsThatEdge) {
  PolygonRegion base = square("base", 0.0, 0.0, 0.1, 0.02);
  base.edge_tags = {"", "", "top", ""};
  const PolygonRegion left = square("left", 0.01, 0.02, 0.03, 0.04);
  PolygonRegion right = square("right", 0.06, 0.02, 0.09, 0.05);
  std::reverse(right.vertices.begin(), right.vertices.end());  // clockwise is fine
  const Mesh mesh = mesh_polygons({left, base, right}, 0.004, 1);
  expect_conforming(mesh, 0.24 + 2 * 0.02 + 2 * 0.03);
  EXPECT_GE(shared_nodes(mesh, "base", "left"), 5);
  EXPECT_GE(shared_nodes(mesh, "base", "right"), 7);
  EXPECT_EQ(shared_nodes(mesh, "left", "right"), 0);
  EXPECT_NEAR(size_of(mesh, mesh.select("top")), 0.1, 1e-15);  // the tag goes to all pieces
  EXPECT_NEAR(total_measure(mesh), 0.002 + 0.0004 + 0.0009, 1e-15);
}

TEST(GmshPolygons, AFinelySampledOutlineKeepsTheInteriorAtTheRequestedSize) {
  PolygonRegion disc{"disc", {}, {}};
  constexpr int n = 400;
  for (int i = 0; i < n; ++i) {
    const double angle = 2.0 * 3.14159265358979323846 * i / n;
    disc.vertices.push_back({std::cos(angle), std::sin(angle)});
  }
  const Mesh mesh = mesh_polygons({disc}, 0.1, 1);
  EXPECT_NEAR(total_measure(mesh), 0.5 * n * std::sin(2.0 * 3.14159265358979323846 / n), 1e-13);
  EXPECT_GT(mesh.element_count(), 700);   // about area / (0.43 size^2)
  EXPECT_LT(mesh.element_count(), 2500);  // some more along the outline; 30000 at the outline's own size
}

TEST(GmshPolygons, TheSameInputGivesTheSameMesh) {
  const auto make = [] { return mesh_polygons({square("a", 0, 0, 1, 1), square("b", 1, 0, 2, 0.5)}, 0.1, 2); };
  const Mesh first = make();
  const Mesh second = make();
  EXPECT_EQ(first.elements, second.elements);
  EXPECT_EQ(first.X, second.X);
}

TEST(GmshPolygons, SeveralPolygonsMayBeOneRegion) {
  const Mesh mesh = mesh_polygons({square("a", 0, 0, 1, 1), square("a", 1, 0, 2, 1)}, 0.3, 1);
  EXPECT_EQ(mesh.region_names, std::vector<std::string>{"a"});
  EXPECT_NEAR(total_measure(mesh), 2.0, 1e-14);
}

TEST(GmshPolygons, DegenerateAndSelfCrossingPolygonsAreRefused) {
  const auto mesh = [](std::vector<std::array<double, 2>> vertices) {
    return [vertices] { mesh_polygons({square("ok", 5, 5, 6, 6), {"web", vertices, {}}}, 0.1, 1); };
  };
  expect_input_error(mesh({{0, 0}, {1, 0}}), {"polygon 1 (region 'web')", "2 vertices", "at least 3"});
  expect_input_error(mesh({{0, 0}, {1, 0}, {2, 0}, {0.5, 0}}), {"'web'", "zero area", "0 to 3"});
  expect_input_error(mesh({{0, 0}, {1, 1}, {1, 0}, {0, 1}}),
                     {"'web'", "crosses itself", "vertex 0 to 1", "vertex 2 to 3"});
  expect_input_error(mesh({{0, 0}, {1, 0}, {1, 1}, {0, 0}}), {"'web'", "vertices 0 and 3 coincide", "closes itself"});
  expect_input_error(mesh({{0, 0}, {2, 0}, {2, 2}, {1, 0}, {0, 2}}), {"'web'", "vertex 3 lies on the edge", "0 to 1"});
  expect_input_error(mesh({{0, 0}, {1, NAN}, {1, 1}}), {"'web'", "vertex 1", "finite"});
  expect_input_error([] { mesh_polygons({}, 0.1, 1); }, {"no polygons"});
  expect_input_error([] { mesh_polygons({square("", 0, 0, 1, 1)}, 0.1, 1); }, {"polygon 0", "no region name"});
  expect_input_error([] { mesh_polygons({square("a", 0, 0, 1, 1)}, 0.0, 1); }, {"size 0", "positive"});
  expect_input_error([] { mesh_polygons({square("a", 0, 0, 1, 1)}, 1e-5, 1); },
                     {"1.6e+10 linear triangles", "fit", "make the elements"});
  expect_input_error([] { mesh_polygons({square("a", 0, 0, 1, 1)}, 0.1, 3); }, {"order 3"});
  PolygonRegion tagged = square("a", 0, 0, 1, 1);
  tagged.edge_tags = {"x", "y"};
  expect_input_error([&] { mesh_polygons({tagged}, 0.1, 1); }, {"2 edge tags for 4 edges"});
}

TEST(GmshPolygons, OverlappingPolygonsAreRefusedByName) {
  const PolygonRegion a = square("skin", 0, 0, 1, 1);
  const auto mesh = [&](const PolygonRegion& b) { return [a, b] { mesh_polygons({a, b}, 0.1, 1); }; };
  expect_input_error(mesh(square("bone", 0.5, 0.5, 2, 2)), {"region 'skin'", "region 'bone'", "overlap near", "mm"});
  expect_input_error(mesh(square("bone", 0.2, 0.2, 0.8, 0.8)), {"'skin'", "'bone'", "overlap"});  // inside
  expect_input_error(mesh(square("bone", 0, 0, 1, 1)), {"'skin'", "'bone'", "overlap"});          // the same
  expect_input_error(mesh(square("bone", 0, 0, 0.5, 1)), {"'skin'", "'bone'", "overlap"});        // along edges
  expect_input_error(mesh(square("bone", -1, 0.2, 2, 0.8)), {"'skin'", "'bone'", "overlap"});     // across
}

TEST(GmshBoxes, ABoxHasItsExactVolumeAndSides) {
  for (int order : {1, 2}) {
    const Mesh mesh = mesh_boxes({{"body", {0.1, 0.2, 0.3}, {0.13, 0.22, 0.31}}}, 0.004, order);
    EXPECT_NO_THROW(mesh.check("box"));
    EXPECT_NEAR(total_measure(mesh), 6e-6, 1e-17);
    expect_conforming(mesh, 2.0 * (6e-4 + 3e-4 + 2e-4));
    EXPECT_NEAR(size_of(mesh, mesh.select("xmax")), 2e-4, 1e-16);
    EXPECT_NEAR(size_of(mesh, mesh.select("zmin")), 6e-4, 1e-16);
    EXPECT_LT(facet_normal(mesh, mesh.select("ymin").entities.data())[1], 0.0);
    EXPECT_EQ(mesh.select("xmin & ymin").dimension, 1);
    EXPECT_EQ(mesh.select("xmin & ymin & zmin").count(), 1);
    if (order == 2) expect_mid_nodes_halfway(mesh);
  }
}

TEST(GmshBoxes, TouchingBoxesOfDifferentSizeAreBondedAndKeepTheirRegions) {
  // 0.1 + 0.2 is not 0.3 in floating point; the boxes touch all the same.
  const Mesh mesh =
      mesh_boxes({{"foot", {0, 0, 0.3}, {1, 1, 0.5}}, {"post", {0.3, 0.3, 0.1}, {0.6, 0.6, 0.1 + 0.2}}}, 0.15, 2);
  EXPECT_EQ(mesh.region_names, (std::vector<std::string>{"foot", "post"}));
  EXPECT_NEAR(total_measure(mesh, "foot"), 0.2, 1e-14);
  EXPECT_NEAR(total_measure(mesh, "post"), 0.018, 1e-14);
  expect_conforming(mesh, 2.0 + 0.8 + 4 * 0.3 * 0.2);
  EXPECT_GE(shared_nodes(mesh, "foot", "post"), 9);
  EXPECT_NEAR(size_of(mesh, mesh.select("zmin")), 0.09, 1e-14);
  EXPECT_NEAR(size_of(mesh, mesh.select("zmax")), 1.0, 1e-14);
}

TEST(GmshBoxes, OverlappingAndEmptyBoxesAreRefusedByName) {
  expect_input_error(
      [] {
        mesh_boxes({{"a", {0, 0, 0}, {1, 1, 1}}, {"b", {0.9, 0.5, 0.5}, {2, 2, 2}}}, 0.2, 1);
      },
      {"box 0 (region 'a')", "box 1 (region 'b')", "overlap"});
  expect_input_error([] { mesh_boxes({{"a", {0, 0, 0}, {1, 0, 1}}}, 0.2, 1); }, {"region 'a'", "along y", "upper"});
  expect_input_error([] { mesh_boxes({{"", {0, 0, 0}, {1, 1, 1}}}, 0.2, 1); }, {"box 0", "no region name"});
  expect_input_error([] { mesh_boxes({}, 0.2, 1); }, {"no boxes"});
  expect_input_error([] { mesh_boxes({{"a", {0, 0, 0}, {1, 1, 1}}}, -1.0, 1); }, {"size -1"});
}

TEST(GmshPolygons, NothingIsPrinted) {
  testing::internal::CaptureStdout();
  testing::internal::CaptureStderr();
  mesh_polygons({square("a", 0, 0, 1, 1)}, 0.2, 1);
  EXPECT_EQ(testing::internal::GetCapturedStdout(), "");
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "");
}
#else
TEST(Gmsh, ABuildWithoutGmshSaysSo) {
  EXPECT_FALSE(has_gmsh());
  expect_input_error([] { mesh_polygons({}, 0.1, 1); }, {"no Gmsh", "TAUT_GMSH"});
}
#endif

}  // namespace
}  // namespace taut
