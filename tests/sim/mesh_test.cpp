#include "sim/mesh/mesh.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <random>
#include <set>

#include "sim/mesh/structured.hpp"
#include "tests/support/graded.hpp"
#include "tests/support/mesh_checks.hpp"
#include "tests/support/message.hpp"

namespace taut {
namespace {

using namespace test;

constexpr double pi = 3.14159265358979323846;

Mesh small_box(int order) {
  return box(graded(0.3, 3), graded(0.2, 2, 3.0), graded(0.1, 3, 0.5), order, "body");
}
Mesh small_rectangle(int order) {
  return rectangle(graded(0.3, 5), graded(0.2, 4, 2.0), order, "body");
}

Eigen::VectorXd bent(const Eigen::VectorXd& p) {
  return vec({p[0] + 0.1 * p[1] * p[1], p[1] + 0.3 * p[0] * p[1]});
}

/// An affine mesh bent afterwards, so that its quadratic elements are truly curved.
Mesh curved_rectangle() {
  Mesh mesh = small_rectangle(2);
  for (int i = 0; i < mesh.node_count(); ++i) mesh.X.segment<2>(2 * i) = bent(mesh.node(i));
  return mesh;
}

Mesh curved_box() {
  Mesh mesh = small_box(2);
  for (int i = 0; i < mesh.node_count(); ++i) mesh.X[3 * i] += 0.3 * mesh.X[3 * i + 1] * mesh.X[3 * i + 2];
  return mesh;
}

TEST(Graded, EndPointsAreExactAndRatioIsLastToFirst) {
  for (double length : {0.1, 0.3, 7.0}) {
    for (double ratio : {1.0, 0.2, 5.0}) {
      for (int cells : {1, 2, 7}) {
        const std::vector<double> x = graded(length, cells, ratio);
        ASSERT_EQ(x.size(), static_cast<size_t>(cells) + 1);
        EXPECT_EQ(x.front(), 0.0);
        EXPECT_EQ(x.back(), length);
        if (cells > 1) {
          EXPECT_NEAR((x[cells] - x[cells - 1]) / x[1], ratio, 1e-12 * ratio);
        }
        for (int i = 2; i <= cells; ++i) {  // geometric progression: constant quotient
          EXPECT_NEAR((x[i] - x[i - 1]) / (x[i - 1] - x[i - 2]), std::pow(ratio, 1.0 / (cells - 1)), 1e-11);
        }
      }
    }
  }
}

TEST(Graded, BothEndsAreSymmetricWithExactEndPointsAndTheMiddleIsCoarser) {
  for (int cells : {3, 4, 7, 10}) {
    const double length = 0.3;
    const std::vector<double> x = graded_both(length, cells, 4.0);
    EXPECT_EQ(x.front(), 0.0);
    EXPECT_EQ(x.back(), length);
    const int middle = (cells - 1) / 2;
    EXPECT_NEAR((x[middle + 1] - x[middle]) / x[1], 4.0, 1e-10);
    for (int i = 0; i <= cells; ++i) EXPECT_NEAR(x[i] + x[cells - i], length, 1e-16);
  }
  EXPECT_EQ(graded_both(1.0, 1, 4.0), (std::vector<double>{0.0, 1.0}));
  EXPECT_EQ(graded_both(1.0, 2, 4.0), (std::vector<double>{0.0, 0.5, 1.0}));
}

TEST(Graded, WrongArgumentsAreRefused) {
  expect_input_error([] { graded(1.0, 0); }, {"0 cells", "at least 1"});
  expect_input_error([] { graded(1.0, 2, 0.0); }, {"ratio 0", "positive"});
  expect_input_error([] { graded(1.0, 2, -3.0); }, {"ratio -3"});
  expect_input_error([] { graded(0.0, 2); }, {"length 0"});
  expect_input_error([] { graded(1.0, -1, 2.0); }, {"-1 cells"});
}

TEST(Structured, AreaAndVolumeAreExact) {
  for (int order : {1, 2}) {
    EXPECT_NEAR(total_measure(small_rectangle(order)), 0.06, 1e-16);
    EXPECT_NEAR(total_measure(small_box(order)), 0.006, 1e-16);
  }
}

TEST(Structured, MeshesConformAndTheirBoundaryIsOutward) {
  for (int order : {1, 2}) {
    expect_conforming(small_rectangle(order), 1.0);
    expect_conforming(small_box(order), 2.0 * (0.06 + 0.03 + 0.02));
    EXPECT_NO_THROW(small_rectangle(order).check("rectangle"));
    EXPECT_NO_THROW(small_box(order).check("box"));
  }
}

TEST(Structured, EverySideIsTaggedWithItsWholeSizeAndOutwardNormal) {
  const Mesh mesh = small_box(2);
  const std::map<std::string, Eigen::Vector3d> normals{{"xmin", {-0.02, 0, 0}}, {"xmax", {0.02, 0, 0}},
                                                       {"ymin", {0, -0.03, 0}}, {"ymax", {0, 0.03, 0}},
                                                       {"zmin", {0, 0, -0.06}}, {"zmax", {0, 0, 0.06}}};
  ASSERT_EQ(mesh.tags.size(), normals.size());
  for (const auto& [name, normal] : normals) {
    const Tag tag = mesh.select(name);
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (int i = 0; i < tag.count(); ++i) sum += facet_normal(mesh, &tag.entities[i * tag.nodes_per_entity]);
    EXPECT_NEAR((sum - normal).norm(), 0.0, 1e-15) << name;
  }
}

TEST(Structured, DiagonalsAreMirroredFromCellToCell) {
  // Around an interior vertex of even indices every edge of the fan has its mirror image.
  const Mesh mesh = box({0, 1, 2}, {0, 1, 2}, {0, 1, 2}, 1, "body");
  std::set<std::pair<int, int>> edges;
  for (int e = 0; e < mesh.element_count(); ++e) {
    for (int a = 0; a < 4; ++a) {
      for (int b = 0; b < 4; ++b) edges.insert({mesh.element(e)[a], mesh.element(e)[b]});
    }
  }
  for (const auto& [a, b] : edges) {
    const int i = 2 - a % 3 + a / 3 * 3;  // mirrored in x
    const int j = 2 - b % 3 + b / 3 * 3;
    EXPECT_TRUE(edges.contains({i, j}));
  }
}

TEST(Structured, QuadraticMidNodesLieExactlyHalfway) {
  expect_mid_nodes_halfway(small_rectangle(2));
  expect_mid_nodes_halfway(small_box(2));
}

TEST(Structured, WrongGridsAreRefused) {
  expect_input_error([] { rectangle({0.0}, {0.0, 1.0}, 1, "a"); }, {"along x", "at least 2"});
  expect_input_error([] { rectangle({0.0, 1.0}, {0.0, 2.0, 1.0}, 1, "a"); }, {"coordinate 2 along y", "increase"});
  expect_input_error([] { rectangle({0.0, 1.0}, {0.0, NAN}, 1, "a"); }, {"along y", "finite"});
  expect_input_error([] { box({0.0, 1.0}, {0.0, 1.0}, {0.0, 1.0}, 3, "a"); }, {"order 3", "1 and 2"});
  expect_input_error([] { box({0.0, 1.0}, {0.0, 1.0}, {0.0, 1.0}, 1, ""); }, {"no name"});
}

TEST(Structured, MappedMeshHasTheExactAreaAndStraightEdges) {
  for (int order : {1, 2}) {
    // Cook's membrane: a trapezium with corners (0, 0), (48, 44), (48, 60), (0, 44) mm.
    Mesh mesh = rectangle(graded(1.0, 6), graded(1.0, 6), order, "membrane");
    map_vertices(mesh, [](const Eigen::VectorXd& p) {
      const double lower = 0.044 * p[0];
      const double upper = 0.044 + 0.016 * p[0];
      return vec({0.048 * p[0], lower + p[1] * (upper - lower)});
    });
    EXPECT_NEAR(total_measure(mesh), 0.048 * 0.5 * (0.044 + 0.016), 1e-16);
    if (order == 2) expect_mid_nodes_halfway(mesh);
    EXPECT_NEAR(enclosed_measure(mesh, boundary(mesh)), total_measure(mesh), 1e-16);
  }
}

TEST(Structured, AMapThatInvertsElementsIsRefused) {
  Mesh mesh = small_rectangle(1);
  expect_input_error([&] { map_vertices(mesh, [](const Eigen::VectorXd& p) {
                             return vec({-p[0], p[1]});
                           }); },
                     {"map_vertices", "element 0", "inverted", "mm"});
  Mesh other = small_rectangle(1);
  expect_input_error([&] { map_vertices(other, [](const Eigen::VectorXd&) { return vec({1.0}); }); },
                     {"1 coordinates", "2D"});
}

TEST(Structured, AssignedRegionsFollowTheCentroidAndShareInterfaceNodes) {
  Mesh mesh = rectangle(graded(0.2, 4), graded(0.1, 3), 2, "all");
  const int nodes = mesh.node_count();
  assign_regions(mesh, [](const Eigen::VectorXd& c) { return c[0] < 0.05 ? "plate" : "foam"; });
  EXPECT_EQ(mesh.region_names, (std::vector<std::string>{"plate", "foam"}));
  EXPECT_NEAR(total_measure(mesh, "plate"), 0.005, 1e-16);
  EXPECT_NEAR(total_measure(mesh, "foam"), 0.015, 1e-16);
  EXPECT_EQ(mesh.node_count(), nodes);
  std::set<int> plate;
  std::set<int> shared;
  for (int e = 0; e < mesh.element_count(); ++e) {
    for (int a = 0; a < 6; ++a) {
      if (mesh.region[e] == 0) plate.insert(mesh.element(e)[a]);
    }
  }
  for (int e = 0; e < mesh.element_count(); ++e) {
    for (int a = 0; a < 6; ++a) {
      if (mesh.region[e] == 1 && plate.contains(mesh.element(e)[a])) shared.insert(mesh.element(e)[a]);
    }
  }
  EXPECT_EQ(shared.size(), 7u);  // 4 vertices and 3 mid-nodes on the line x = 0.05
  for (int node : shared) EXPECT_NEAR(mesh.node(node)[0], 0.05, 1e-16);
  expect_input_error([&] { assign_regions(mesh, [](const Eigen::VectorXd&) { return ""; }); },
                     {"element 0", "no region name"});
}

TEST(Quadratic, TagsGetTheirMidNodesAfterTheVertices) {
  const Mesh mesh = small_box(2);
  const Tag& tag = mesh.tags.at("zmax");
  EXPECT_EQ(tag.nodes_per_entity, 6);
  for (int i = 0; i < tag.count(); ++i) {
    const int* n = &tag.entities[6 * i];
    for (int k = 0; k < 3; ++k) {
      EXPECT_EQ((mesh.node(n[3 + k]) - 0.5 * (mesh.node(n[k]) + mesh.node(n[(k + 1) % 3]))).norm(), 0.0);
    }
  }
  Mesh linear = small_rectangle(1);
  linear.tags["corner"] = Tag{0, 1, {0}};
  const Mesh flat = to_quadratic(linear);
  EXPECT_EQ(flat.tags.at("xmin").nodes_per_entity, 3);
  EXPECT_EQ(flat.tags.at("corner").entities, std::vector<int>{0});
  EXPECT_EQ(to_quadratic(flat).node_count(), flat.node_count());
  linear.tags["cut"] = Tag{1, 2, {0, 8}};
  expect_input_error([&] { to_quadratic(linear); }, {"tag 'cut'", "no edge of any element"});
}

TEST(Select, AnIntersectionOfTwoFacesIsAnEdgeOfTheMeshesOrder) {
  for (int order : {1, 2}) {
    const Mesh mesh = small_box(order);
    for (const char* name : {"xmax & zmax", "xmax&zmax", "  zmax &xmax "}) {
      const Tag edge = mesh.select(name);
      EXPECT_EQ(edge.dimension, 1);
      EXPECT_EQ(edge.nodes_per_entity, order + 1);
      EXPECT_EQ(edge.count(), 2);
      double length = 0.0;
      for (int i = 0; i < edge.count(); ++i) {
        const int* n = &edge.entities[i * edge.nodes_per_entity];
        length += (mesh.node(n[1]) - mesh.node(n[0])).norm();
        if (order == 2) {
          EXPECT_EQ((mesh.node(n[2]) - 0.5 * (mesh.node(n[0]) + mesh.node(n[1]))).norm(), 0.0);
        }
      }
      EXPECT_NEAR(length, 0.2, 1e-15);
      for (int node : edge.nodes()) {
        EXPECT_EQ(mesh.node(node)[0], 0.3);
        EXPECT_EQ(mesh.node(node)[2], 0.1);
      }
    }
  }
}

TEST(Select, AnIntersectionOfThreeFacesIsACorner) {
  const Mesh mesh = small_box(2);
  const Tag corner = mesh.select("xmin & ymax & zmin");
  EXPECT_EQ(corner.dimension, 0);
  ASSERT_EQ(corner.count(), 1);
  EXPECT_EQ((mesh.node(corner.entities[0]) - vec({0.0, 0.2, 0.0})).norm(), 0.0);
  const Mesh flat = small_rectangle(2);
  const Tag flat_corner = flat.select("xmax & ymin");
  EXPECT_EQ(flat_corner.dimension, 0);
  ASSERT_EQ(flat_corner.count(), 1);
  EXPECT_EQ((flat.node(flat_corner.entities[0]) - vec({0.3, 0.0})).norm(), 0.0);
}

TEST(Select, ATagAndItselfIsTheTag) {
  const Mesh mesh = small_box(2);
  const Tag same = mesh.select("ymin & ymin");
  EXPECT_EQ(same.dimension, 2);
  EXPECT_EQ(same.nodes_per_entity, 6);
  EXPECT_EQ(same.entities, mesh.select(" ymin ").entities);
}

TEST(Select, UnknownAndEmptySelectionsSayWhatIsKnown) {
  const Mesh mesh = small_box(1);
  expect_input_error([&] { mesh.select("xmx"); }, {"'xmx'", "did you mean 'xmax'?", "known tags: xmax, xmin, ymax"});
  expect_input_error([&] { mesh.select("xmin & zmaxx"); }, {"'zmaxx'", "did you mean 'zmax'?"});
  expect_input_error([&] { mesh.select("xmin & xmax"); }, {"'xmin & xmax' is empty", "known tags"});
  expect_input_error([&] { mesh.select("xmin &"); }, {"'xmin &'", "a & b"});
  expect_input_error([&] { mesh.select("& xmin"); }, {"'& xmin'", "a & b"});
  expect_input_error([&] { mesh.region_index("bodi"); }, {"'bodi'", "did you mean 'body'?"});
}

TEST(Check, EachDefectIsNamed) {
  const Mesh good = small_rectangle(1);
  Mesh mesh = good;
  std::swap(mesh.elements[3], mesh.elements[4]);
  expect_input_error([&] { mesh.check("part.msh"); }, {"part.msh: element 1", "centroid at (20, ", "mm", "inverted"});
  mesh = good;
  mesh.X.segment<2>(2 * mesh.elements[1]) = 0.5 * (good.node(good.elements[0]) + good.node(good.elements[2]));
  expect_input_error([&] { mesh.check("m"); }, {"element 0", "degenerate"});
  mesh = good;
  mesh.X.conservativeResize(mesh.X.size() + 2);
  mesh.X.tail<2>() << 0.5, 0.25;
  expect_input_error([&] { mesh.check("m"); }, {"node 30 at (500, 250) mm", "belongs to no element"});
  mesh = good;
  mesh.elements[5] = 30;
  expect_input_error([&] { mesh.check("m"); }, {"element 1", "node 30", "0 to 29"});
  mesh = good;
  mesh.region[7] = 1;
  expect_input_error([&] { mesh.check("m"); }, {"element 7", "region index 1"});
  mesh = good;
  mesh.region_names[0].clear();
  expect_input_error([&] { mesh.check("m"); }, {"region 0 has no name"});
  mesh = good;
  mesh.region.pop_back();
  expect_input_error([&] { mesh.check("m"); }, {"39 region indices for 40 elements"});
  mesh = good;
  mesh.X[3] = NAN;
  expect_input_error([&] { mesh.check("m"); }, {"node 1", "not finite"});
  mesh = good;
  mesh.tags["xmin"].entities[0] = -1;
  expect_input_error([&] { mesh.check("m"); }, {"tag 'xmin'", "node -1"});
  mesh = good;
  mesh.tags["xmin"].nodes_per_entity = 3;
  expect_input_error([&] { mesh.check("m"); }, {"tag 'xmin'", "3 nodes per entity", "tri3"});
  expect_input_error([] { Mesh().check("m"); }, {"no elements"});
}

TEST(Check, AQuadraticElementFoldedByItsMidNodeIsInverted) {
  Mesh mesh = small_rectangle(2);
  EXPECT_NO_THROW(curved_rectangle().check("curved"));
  EXPECT_NO_THROW(curved_box().check("curved"));
  const int* nodes = mesh.element(0);
  mesh.X.segment<2>(2 * nodes[3]) = mesh.node(nodes[0]) + 0.9 * (mesh.node(nodes[2]) - mesh.node(nodes[0]));
  expect_input_error([&] { mesh.check("m"); }, {"element 0", "inverted"});
}

void expect_located(const Mesh& mesh, const Eigen::VectorXd& point, double tolerance) {
  const MaterialPoint found = locate(mesh, point);
  ASSERT_EQ(found.nodes.size(), found.weights.size());
  Eigen::VectorXd position = Eigen::VectorXd::Zero(mesh.dimension());
  double sum = 0.0;
  for (size_t a = 0; a < found.nodes.size(); ++a) {
    position += found.weights[a] * mesh.node(found.nodes[a]);
    sum += found.weights[a];
    EXPECT_GE(std::abs(found.weights[a]), 1e-14);
  }
  EXPECT_NEAR((position - point).norm(), 0.0, tolerance);
  EXPECT_NEAR(sum, 1.0, 1e-14);
}

TEST(Locate, WeightsReproduceRandomPoints) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  for (int order : {1, 2}) {
    const Mesh flat = small_rectangle(order);
    const Mesh solid = small_box(order);
    for (int i = 0; i < 200; ++i) {
      expect_located(flat, vec({0.3 * unit(random), 0.2 * unit(random)}), 1e-15);
      expect_located(solid, vec({0.3 * unit(random), 0.2 * unit(random), 0.1 * unit(random)}), 1e-15);
    }
  }
}

TEST(Locate, WeightsReproduceRandomPointsOfCurvedElements) {
  std::mt19937 random(8);
  std::uniform_real_distribution<double> unit(0.05, 0.95);
  const Mesh flat = curved_rectangle();
  const Mesh solid = curved_box();
  for (int i = 0; i < 200; ++i) {
    expect_located(flat, bent(vec({0.3 * unit(random), 0.2 * unit(random)})), 1e-14);
    const double y = 0.2 * unit(random);
    const double z = 0.1 * unit(random);
    expect_located(solid, vec({0.3 * unit(random) + 0.3 * y * z, y, z}), 1e-14);
  }
}

TEST(Locate, ANodeIsLocatedAsItself) {
  for (const Mesh& mesh : {small_rectangle(1), small_rectangle(2), small_box(2), curved_rectangle(), curved_box()}) {
    for (int i = 0; i < mesh.node_count(); i += 7) {
      const MaterialPoint found = locate(mesh, mesh.node(i));
      ASSERT_EQ(found.nodes, std::vector<int>{i});
      EXPECT_NEAR(found.weights[0], 1.0, 1e-14);
    }
  }
}

TEST(Locate, APointOutsideByRoundOffIsMovedOntoTheMesh) {
  for (const Mesh& mesh : {small_box(1), small_box(2)}) {
    const MaterialPoint found = locate(mesh, vec({0.3 + 1e-8, 0.07, 0.1 + 1e-8}));
    Eigen::Vector3d position = Eigen::Vector3d::Zero();
    for (size_t a = 0; a < found.nodes.size(); ++a) position += found.weights[a] * mesh.node(found.nodes[a]);
    EXPECT_NEAR((position - Eigen::Vector3d(0.3, 0.07, 0.1)).norm(), 0.0, 1e-15);
  }
}

TEST(Locate, APointOutsideIsRefusedWithDistanceAndNearestNode) {
  expect_input_error(
      [] {
        locate(small_box(2), vec({0.305, 0.2, 0.1}));
      },
      {"(305, 200, 100) mm", "5 mm outside", "nearest node is 47", "(300, 200, 100) mm"});
  expect_input_error([] { locate(small_rectangle(1), vec({0.1, -0.0002})); }, {"0.2 mm outside"});
  expect_input_error([] { locate(curved_rectangle(), vec({-1.0, 0.0})); }, {"1000 mm outside", "node is 0"});
  expect_input_error([] { locate(small_rectangle(1), vec({0.1, 0.1, 0.1})); }, {"2D mesh", "2 finite coordinates"});
  expect_input_error([] { locate(small_rectangle(1), vec({0.1, NAN})); }, {"finite"});
}

TEST(Locate, ALineOfPointsThroughAMappedMeshIsReproduced) {
  // An annulus: the mapped mesh is polygonal, and points of its chords are inside.
  Mesh mesh = rectangle(graded(1.0, 8), graded(1.0, 3), 2, "ring");
  map_vertices(mesh, [](const Eigen::VectorXd& p) {
    const double r = 2.0 - p[1];
    return vec({r * std::cos(0.5 * pi * p[0]), r * std::sin(0.5 * pi * p[0])});
  });
  for (int i = 0; i <= 20; ++i) expect_located(mesh, vec({1.0 + 0.05 * i, 0.0}), 1e-15);
}

}  // namespace
}  // namespace taut
