#include "sim/mesh/one_body.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "sim/mesh/extrude.hpp"
#include "sim/mesh/structured.hpp"
#include "tests/support/message.hpp"

// Meshes that are put together from pieces which do not fit: each is refused with its place, and told from what is
// meant.
namespace taut::test {
namespace {

/// `a` and `b` in one list of nodes and elements, as an export without merged nodes has them.
Mesh beside(const Mesh& a, Mesh b, const Eigen::VectorXd& shift) {
  place(b, Eigen::MatrixXd::Identity(shift.size(), shift.size()), shift);
  Mesh both = merge({{"a", a}, {"b", b}});
  both.parts.clear();
  return both;
}

Mesh plate(int across) {
  return rectangle(graded(0.04, 4), graded(0.01, across), 1, "foam");
}

void expect_refused(const Mesh& mesh, const std::vector<std::string>& parts, bool separate = false) {
  expect_input_error([&] { check_one_body(mesh, "file.msh", separate); }, parts);
}

TEST(OneBody, WhatIsOneIsAccepted) {
  check_one_body(plate(2), "file.msh", false);
  check_one_body(to_quadratic(plate(2)), "file.msh", false);
  check_one_body(box(graded(1, 3), graded(2, 3), graded(1, 2), 2, "foam"), "file.msh", false);
}

TEST(OneBody, TrianglesWithACommonSideDoNotOverlapWhicheverCornerIsFirst) {
  Mesh mesh;
  mesh.X = Eigen::VectorXd::Zero(8);
  mesh.X << 0, 0, 1, 0, 0.5, 1, 0.5, -1;
  mesh.region = {0, 0};
  mesh.region_names = {"foam"};
  for (int turn = 0; turn < 9; ++turn) {
    mesh.elements = {0, 1, 2, 1, 0, 3};
    std::rotate(mesh.elements.begin(), mesh.elements.begin() + turn % 3, mesh.elements.begin() + 3);
    std::rotate(mesh.elements.begin() + 3, mesh.elements.begin() + 3 + turn / 3, mesh.elements.end());
    EXPECT_NO_THROW(check_one_body(mesh, "file.msh", false)) << turn;
  }
}

TEST(OneBody, LayersWithTheirOwnNodesAreNotJoined) {
  const Mesh layers = beside(plate(2), plate(2), Eigen::Vector2d(0, 0.01));
  expect_refused(layers,
                 {"file.msh: two nodes coincide at (", "4 pairs elsewhere", "Coherence", "bodies = \"separate\""});
  check_one_body(layers, "file.msh", true);
  expect_refused(beside(box(graded(1, 3), graded(1, 3), graded(1, 3), 1, "foam"),
                        box(graded(1, 3), graded(1, 3), graded(1, 3), 1, "foam"), Eigen::Vector3d(1 + 1e-6, 0, 0)),
                 {"two nodes coincide", "15 pairs elsewhere"});
}

TEST(OneBody, ASeamInsideOneBodyIsFound) {
  Mesh mesh = plate(2);
  // The elements above the middle line get a node of their own at its left end.
  const int last = mesh.node_count();
  mesh.X.conservativeResize(mesh.X.size() + 2);
  const auto on_seam = [&](int node) { return mesh.node(node).isApprox(Eigen::Vector2d(0, 0.005)); };
  int old = 0;
  while (!on_seam(old)) ++old;
  mesh.X.tail(2) = mesh.node(old);
  for (int e = 0; e < mesh.element_count(); ++e) {
    if (mesh.centroid(e)[1] < 0.005) continue;
    for (int a = 0; a < 3; ++a) {
      int& node = mesh.elements[static_cast<size_t>(3 * e + a)];
      if (node == old) node = last;
    }
  }
  expect_refused(mesh, {"two nodes coincide at (0, 5) mm:"});
}

TEST(OneBody, PartsApartAreCounted) {
  const Mesh apart = beside(plate(2), plate(2), Eigen::Vector2d(0, 0.02));
  expect_refused(apart, {"has 2 parts that share no node", "separate"});
  check_one_body(apart, "file.msh", true);
}

TEST(OneBody, HangingNodesAndOverlapsAreFound) {
  // Welded at the corners, but the finer side has nodes in between.
  Mesh hanging = beside(rectangle(graded(0.04, 4), graded(0.01, 2), 1, "foam"),
                        rectangle(graded(0.04, 8), graded(0.01, 2), 1, "foam"), Eigen::Vector2d(0, 0.01));
  for (int& node : hanging.elements) {
    for (int i = 0; i < node; ++i) {
      if ((hanging.node(i) - hanging.node(node)).norm() < 1e-9) node = i;
    }
  }
  expect_refused(hanging, {"a hanging node at (", "10) mm"});
  const Mesh overlapping = beside(plate(2), plate(2), Eigen::Vector2d(0.0033, 0.0071));
  for (const bool separate : {false, true}) expect_refused(overlapping, {"elements overlap at ("}, separate);
}

/// Nodes that coincide to 1e-9 m become one.
Mesh welded(Mesh mesh) {
  for (int& node : mesh.elements) {
    for (int i = 0; i < node; ++i) {
      if ((mesh.node(i) - mesh.node(node)).norm() < 1e-9) node = i;
    }
  }
  return mesh;
}

TEST(OneBody, HangingNodesInSpaceAndOfRoundedCoordinates) {
  const Mesh coarse = box(graded(1, 1), graded(1, 1), graded(1, 1), 1, "foam");
  const Mesh fine = box(graded(1, 2), graded(1, 2), graded(1, 2), 1, "foam");
  // Of the 9 nodes in the common face 4 are shared; one lies on its diagonal or beside it.
  expect_refused(welded(beside(coarse, fine, Eigen::Vector3d(1, 0, 0))), {"a hanging node at (1000, ", "4 such nodes"});
  Mesh rounded = welded(beside(rectangle(graded(0.04, 1), graded(0.01, 2), 1, "foam"),
                               rectangle(graded(0.04, 2), graded(0.01, 2), 1, "foam"), Eigen::Vector2d(0, 0.01)));
  for (int i = 0; i < rounded.node_count(); ++i) {
    if (rounded.node(i).isApprox(Eigen::Vector2d(0.02, 0.01))) rounded.X[2 * i + 1] += 1e-7;
  }
  expect_refused(rounded, {"a hanging node at (20, 10.0001) mm", "around ("});
}

TEST(OneBody, WhatIsThereTwiceOverlapsWhateverWasMeant) {
  const Mesh twice = beside(plate(2), plate(2), Eigen::Vector2d::Zero());
  const Mesh upright = rectangle(graded(0.01, 3), graded(0.1, 15), 1, "foam");
  const Mesh cross =
      beside(rectangle(graded(0.1, 15), graded(0.01, 3), 1, "foam"), upright, Eigen::Vector2d(0.045, -0.0451));
  for (const bool separate : {false, true}) {
    expect_refused(twice, {"elements overlap at (", "31 places elsewhere", "delete what is there twice"}, separate);
    expect_refused(cross, {"elements overlap at ("}, separate);
    // Columns on columns: no node and no centroid lies inside an element.
    expect_refused(beside(plate(2), plate(2), Eigen::Vector2d(0, 0.0085)), {"elements overlap at (", "15 places"},
                   separate);
    expect_refused(beside(box(graded(1, 2), graded(1, 2), graded(1, 2), 1, "foam"),
                          box(graded(1, 2), graded(1, 2), graded(1, 2), 1, "foam"), Eigen::Vector3d(0, 0, 0.9)),
                   {"elements overlap at ("}, separate);
  }
}

TEST(OneBody, QuadraticElementsWithMidNodesOfTheirOwnAreNotJoined) {
  Mesh mesh = to_quadratic(plate(2));
  const Tag outside = boundary(mesh);
  const std::vector<int> outer = outside.nodes();
  int mid = 0;  // of an element whose edge is inside
  for (int a = 3; a < 6; ++a) {
    if (!std::ranges::binary_search(outer, mesh.element(3)[a])) mid = a;
  }
  ASSERT_GT(mid, 0);
  const Eigen::VectorXd place = mesh.node(mesh.element(3)[mid]);
  mesh.X.conservativeResize(mesh.X.size() + 2);
  mesh.X.tail(2) = place;
  mesh.elements[static_cast<size_t>(3 * 6 + mid)] = mesh.node_count() - 1;
  expect_refused(mesh, {"two nodes coincide at ("});
  check_one_body(mesh, "file.msh", true);
}

TEST(OneBody, SizesMayDifferByAThousandAndMore) {
  std::vector<double> steep{0, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1};
  const Mesh mesh = rectangle(steep, steep, 1, "foam");
  check_one_body(mesh, "file.msh", false);
  // A seam in the finest corner is nearer than any element there is wide.
  Mesh seam = beside(mesh, mesh, Eigen::Vector2d(1 + 1e-12, 0));
  expect_refused(seam, {"two nodes coincide at (1000, 0) mm", "8 pairs elsewhere"});
}

TEST(OneBody, OdditiesAreSaidWithTheirPlace) {
  EXPECT_TRUE(oddities(plate(2), "file.msh").empty());
  EXPECT_TRUE(oddities(box(graded(1, 3), graded(2, 3), graded(1, 2), 2, "foam"), "file.msh").empty());
  const auto expect_said = [](const Mesh& mesh, const std::vector<std::string>& parts) {
    const std::vector<std::string> said = oddities(mesh, "file.msh");
    ASSERT_EQ(said.size(), 1u);
    for (const std::string& part : parts) EXPECT_NE(said[0].find(part), std::string::npos) << said[0];
  };
  // A triangle of legs a and b has the quality 2 sqrt(3) ab / (2 (a^2 + b^2)): 1.7e-4 of a/b = 1e-4, 1.7e-2 of 1e-2.
  expect_said(rectangle({0, 1e-4, 1}, graded(1, 1), 1, "foam"),
              {"file.msh: 2 of 4 elements are needles", "the worst around (0.0"});
  EXPECT_TRUE(oddities(rectangle({0, 1e-2, 1}, graded(1, 1), 1, "foam"), "file.msh").empty());
  expect_said(welded(beside(plate(2), plate(2), Eigen::Vector2d(0.04, 0.01))), {"meet at (40, 10) mm in a point only"});
  expect_said(rectangle(graded(40, 4), graded(10, 2), 1, "foam"), {"4.12e+04 mm", "is `unit` right?"});
}

/// A convex polygon around the origin, as triangles from there.
Mesh polygon(const std::vector<std::array<double, 2>>& corners) {
  Mesh mesh;
  const int count = static_cast<int>(corners.size());
  mesh.X.resize(2 * (count + 1));
  mesh.X.tail(2).setZero();
  for (int i = 0; i < count; ++i) {
    mesh.X.segment(2 * i, 2) << corners[static_cast<size_t>(i)][0], corners[static_cast<size_t>(i)][1];
    mesh.elements.insert(mesh.elements.end(), {count, i, (i + 1) % count});
  }
  mesh.region.assign(corners.size(), mesh.add_region("foam"));
  return mesh;
}
Mesh regular(int count) {
  std::vector<std::array<double, 2>> corners;
  for (int i = 0; i < count; ++i) corners.push_back({std::cos(2 * M_PI * i / count), std::sin(2 * M_PI * i / count)});
  return polygon(corners);
}

TEST(OneBody, ChordsOfACurveAreToldFromEdges) {
  for (const Mesh& mesh : {regular(12), extrude(regular(12), 0.5, 2)}) {
    const std::string said = straight_chords(mesh, "file.msh");
    for (const char* part : {"file.msh: ", "12 flat pieces", "by up to 30 degrees", "Mesh.ElementOrder = 2"})
      EXPECT_NE(said.find(part), std::string::npos) << part << " is not in: " << said;
  }
  for (int corners : {3, 4, 6, 8, 200}) EXPECT_EQ(straight_chords(regular(corners), "file.msh"), "") << corners;
  // An edge that is cut off under 30 degrees is no curve.
  EXPECT_EQ(straight_chords(polygon({{-2, -1}, {2, -1}, {2, 0.4226}, {1, 1}, {-2, 1}}), "file.msh"), "");
}

}  // namespace
}  // namespace taut::test
