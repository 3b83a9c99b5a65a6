#include "calib/runs/shapes.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <map>

#include "sim/mesh/structured.hpp"

// Side views of deformed specimens.
namespace taut {
namespace {

/// The states of a mesh: at rest, and moved by `map` from each place.
SolvedStates moved_state(const Mesh& mesh, const std::function<Eigen::VectorXd(const Eigen::VectorXd&)>& map) {
  SolvedStates states;
  states.mesh = &mesh;
  Eigen::VectorXd u(mesh.X.size());
  const int d = mesh.dimension();
  for (int i = 0; i < mesh.node_count(); ++i) u.segment(i * d, d) = map(mesh.node(i)) - mesh.node(i);
  states.states.push_back({"moved", "held", "load", u});
  return states;
}

/// Length of all lines; each of their ends has to be that of two.
double length_of_loops(const ShapeRecord& shape) {
  std::map<std::pair<long, long>, int> ends;
  double length = 0;
  for (const auto& [x0, y0, x1, y1] : shape.segments) {
    length += std::hypot(x1 - x0, y1 - y0);
    ++ends[{std::lround(1e9 * x0), std::lround(1e9 * y0)}];
    ++ends[{std::lround(1e9 * x1), std::lround(1e9 * y1)}];
  }
  for (const auto& [end, lines] : ends) EXPECT_EQ(lines, 2) << end.first << " " << end.second;
  return length;
}

TEST(Shapes, TheOutlineOfARectangleIsDrawnWhereItWasMovedTo) {
  const Mesh mesh = rectangle(graded(0.06, 4), graded(0.02, 2), 2, "foam");
  const double stretch = 1.5, shift = 0.01;
  const SolvedStates states = moved_state(
      mesh, [&](const Eigen::VectorXd& X) { return Eigen::Vector2d(stretch * X[0] + shift, X[1] - shift); });
  const std::vector<ShapeRecord> shapes = draw_shapes(states);
  ASSERT_EQ(shapes.size(), 2u) << "at rest, and the state";
  EXPECT_NEAR(length_of_loops(shapes[0]), 2 * (0.06 + 0.02), 1e-12);
  EXPECT_NEAR(length_of_loops(shapes[1]), 2 * (stretch * 0.06 + 0.02), 1e-12);
  EXPECT_EQ(shapes[1].label, "moved");
  EXPECT_EQ(shapes[1].row, "held");
  EXPECT_EQ(shapes[1].column, "load");
  for (const auto& [x0, y0, x1, y1] : shapes[1].segments) {
    EXPECT_GT(x0, shift - 1e-12);
    EXPECT_LT(x1, stretch * 0.06 + shift + 1e-12);
    EXPECT_GT(std::min(y0, y1), -shift - 1e-12);
    EXPECT_LT(std::max(y0, y1), 0.02 - shift + 1e-12);
  }
  ASSERT_EQ(shapes[1].areas.size(), 1u);
  EXPECT_EQ(shapes[1].areas[0].region, "foam");
  ASSERT_EQ(shapes[1].areas[0].loops.size(), 1u);
  const ShapeRecord::Line& loop = shapes[1].areas[0].loops[0];
  double twice = 0;  // the shoelace formula
  for (size_t i = 0; i < loop.size(); ++i) {
    const auto &a = loop[i], &b = loop[(i + 1) % loop.size()];
    twice += a[0] * b[1] - b[0] * a[1];
  }
  EXPECT_NEAR(twice / 2, stretch * 0.06 * 0.02, 1e-9) << "anticlockwise";
}

TEST(Shapes, ASolidIsSeenFromTheSideWithDownBelow) {
  const Mesh mesh = box(graded(0.06, 3), graded(0.01, 1), graded(0.02, 2), 1, "foam");
  SolvedStates states = moved_state(mesh, [](const Eigen::VectorXd& X) { return Eigen::VectorXd(2 * X); });
  states.down = {0, 0, -1};
  EXPECT_EQ(drawing_plane(states), (std::array<int, 2>{0, 2})) << "x is longer than y";
  const std::vector<ShapeRecord> shapes = draw_shapes(states);
  ASSERT_EQ(shapes.size(), 2u);
  EXPECT_NEAR(length_of_loops(shapes[0]), 2 * (0.06 + 0.02), 1e-12);
  EXPECT_NEAR(length_of_loops(shapes[1]), 4 * (0.06 + 0.02), 1e-12);
  states.down = {0, -1, 0};
  EXPECT_EQ(drawing_plane(states), (std::array<int, 2>{0, 1}));
  EXPECT_TRUE(draw_shapes({}).empty()) << "no mesh";
}

}  // namespace
}  // namespace taut
