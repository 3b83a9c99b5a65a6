#include "sim/mesh/one_body.hpp"

#include <gtest/gtest.h>

#include "sim/mesh/structured.hpp"
#include "tests/support/message.hpp"

// Meshes that are put together from pieces which do not fit: each is refused with its place, and told from what is
// meant.
namespace taut::test {
namespace {

/// `a` and `b` in one list of nodes and elements, as an export without merged nodes has them.
Mesh beside(const Mesh& a, Mesh b, const Eigen::VectorXd& shift) {
  place(b, 0, shift);
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

}  // namespace
}  // namespace taut::test
