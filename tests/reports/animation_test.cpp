#include "reports/animation.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <nlohmann/json.hpp>

#include "reports/surface.hpp"
#include "tests/support/simulation_records.hpp"

namespace taut {
namespace {

using namespace test;
using Json = nlohmann::json;

/// Positions [mm] of the points of each frame, as the page decodes them: sums of whole steps from the lower corner.
std::vector<Eigen::MatrixXd> decoded(const Json& json) {
  const int d = json["dimension"];
  std::vector<Eigen::MatrixXd> frames;
  std::vector<long> sum(json["frames"][0].size(), 0);
  for (const Json& frame : json["frames"]) {
    EXPECT_EQ(frame.size(), sum.size());
    Eigen::MatrixXd x(d, static_cast<Eigen::Index>(sum.size()) / d);
    for (size_t i = 0; i < sum.size(); ++i) {
      sum[i] += frame[i].get<long>();
      const size_t c = i % static_cast<size_t>(d);
      x.reshaped()[static_cast<Eigen::Index>(i)] =
          json["window"]["lower"][c].get<double>() + json["step"].get<double>() * static_cast<double>(sum[i]);
    }
    frames.push_back(x);
  }
  return frames;
}

TEST(Animation, PositionsAreThoseOfTheStatesWithinHalfAStep) {
  for (const SimulationRecord& record : {bending_beam(7), twisted_column(5, 1), twisted_column(5, 2)}) {
    const int d = record.mesh.dimension();
    const Json json = Json::parse(animation_json(record));
    ASSERT_EQ(json["dimension"], d);
    const double step = json["step"];
    double widest = 0;
    for (size_t c = 0; c < static_cast<size_t>(d); ++c) {
      widest = std::max(widest, json["window"]["upper"][c].get<double>() - json["window"]["lower"][c].get<double>());
    }
    EXPECT_NEAR(step, 1e-4 * widest, 1e-9);
    const std::vector<Eigen::MatrixXd> frames = decoded(json);
    ASSERT_EQ(frames.size(), record.states.size());
    const std::vector<int> nodes = json["nodes"];
    ASSERT_GT(nodes.size(), 20u);
    size_t line_points = 0;
    for (const Json& line : json["lines"]) line_points += line["count"].get<size_t>();
    ASSERT_EQ(static_cast<size_t>(frames[0].cols()), nodes.size() + line_points);
    for (size_t f = 0; f < frames.size(); ++f) {
      for (size_t i = 0; i < nodes.size(); ++i) {
        const Eigen::VectorXd mm = 1e3 * (record.mesh.node(nodes[i]) + record.states[f].segment(nodes[i] * d, d));
        EXPECT_LE((frames[f].col(static_cast<Eigen::Index>(i)) - mm).cwiseAbs().maxCoeff(), 0.5001 * step);
      }
    }
  }
}

TEST(Animation, LinesPassThroughTheirMaterialPointsAndFixedEnds) {
  const SimulationRecord record = bending_beam(3);
  const Json json = Json::parse(animation_json(record));
  const Eigen::MatrixXd last = decoded(json).back();
  const Eigen::Index first = static_cast<Eigen::Index>(json["nodes"].size());
  ASSERT_EQ(last.cols(), first + 3 + 4);
  const double tolerance = json["step"].get<double>();
  // The lower line begins at a point fixed in space; its second point lies on the clamped end.
  EXPECT_LE((last.col(first + 3) - Eigen::Vector2d(-10, 1)).norm(), tolerance);
  EXPECT_LE((last.col(first + 4) - Eigen::Vector2d(0, 1)).norm(), tolerance);
  // Its last point is that of the tip, turned by a = 1.2 exp(-1): radius L/a + 4 mm about (0, L/a + 5 mm).
  const double a = 1.2 * std::exp(-1.0), r = 60 / a + 5;
  EXPECT_LE((last.col(first + 6) - Eigen::Vector2d((r - 1) * std::sin(a), r - (r - 1) * std::cos(a))).norm(), 0.01);
}

TEST(Animation, LoopsEncloseTheRegionsAndLeaveTheirHolesOpen) {
  SimulationRecord record = bending_beam(1);
  // A hole-like inclusion of 20 x 5 mm in the middle of the foam.
  assign_regions(record.mesh, [](const Eigen::VectorXd& x) {
    return std::string(x[0] > 0.02 && x[0] < 0.04 && x[1] > 0.0025 && x[1] < 0.0075 ? "plastic" : "foam");
  });
  const Json json = Json::parse(animation_json(record));
  const Eigen::MatrixXd x = decoded(json).front();
  std::map<std::string, double> area;
  for (const Json& loop : json["loops"]) {
    const std::vector<int> points = loop["points"];
    double& sum = area[json["regions"][loop["region"].get<size_t>()]["name"]];
    for (size_t i = 0; i < points.size(); ++i) {
      const Eigen::Vector2d p = x.col(points[i]), q = x.col(points[(i + 1) % points.size()]);
      sum += (p.x() * q.y() - q.x() * p.y()) / 2;
    }
  }
  EXPECT_NEAR(area["foam"], 60 * 10 - 20 * 5, 1);
  EXPECT_NEAR(area["plastic"], 20 * 5, 0.5);
}

TEST(Animation, TrianglesEncloseTheVolumeAndKnowTheirRegion) {
  for (const int order : {1, 2}) {
    const Json json = Json::parse(animation_json(twisted_column(2, order)));
    const Eigen::MatrixXd x = decoded(json).front();
    const std::vector<int> t = json["triangles"];
    const std::vector<int> regions = json["triangle_regions"];
    ASSERT_EQ(t.size(), 3 * regions.size());
    double volume = 0, plastic = 0;
    for (size_t i = 0; i < regions.size(); ++i) {
      const Eigen::Vector3d a = x.col(t[3 * i]), b = x.col(t[3 * i + 1]), c = x.col(t[3 * i + 2]);
      volume += a.dot(b.cross(c)) / 6;
      if (json["regions"][static_cast<size_t>(regions[i])]["name"] == "plastic")
        plastic += (b - a).cross(c - a).norm() / 2;
    }
    EXPECT_NEAR(volume, 20 * 20 * 60, 20);  // mm^3; closed and outward oriented
    EXPECT_NEAR(plastic, 20 * 20 + 4 * 20 * 12, 2);
  }
}

TEST(Animation, FramesAreThinnedOutToTheBudgetWithFirstAndLastKept) {
  const SimulationRecord record = bending_beam(41);
  const Json whole = Json::parse(animation_json(record));
  EXPECT_EQ(whole["shown"], 41);
  EXPECT_EQ(whole["frames"].size(), 41u);
  const size_t budget = 10'000;
  const std::string text = animation_json(record, budget);
  const Json json = Json::parse(text);
  const size_t shown = json["shown"];
  EXPECT_EQ(json["stored"], 41);
  EXPECT_GT(shown, 5u);
  EXPECT_LT(shown, 41u);
  EXPECT_EQ(json["frames"].size(), shown);
  EXPECT_LE(text.size() - text.find("\"frames\":"), budget + 20);
  const std::vector<double> times = json["sample"]["values"];
  ASSERT_EQ(times.size(), shown);
  EXPECT_EQ(times.front(), 0);
  EXPECT_EQ(times.back(), 1);
  for (size_t i = 1; i < shown; ++i) {
    EXPECT_NEAR(times[i] - times[i - 1], 1.0 / static_cast<double>(shown - 1), 0.026);
  }
  // Positions and values belong to the frames that stayed: one node, the angle of the tip against its closed form.
  const std::vector<Eigen::MatrixXd> positions = decoded(json);
  const int node = json["nodes"].back();
  const Eigen::Index place = static_cast<Eigen::Index>(json["nodes"].size()) - 1;
  for (size_t i = 0; i < shown; ++i) {
    const auto frame = static_cast<size_t>(std::lround(40 * times[i]));
    const Eigen::Vector2d mm = 1e3 * (record.mesh.node(node) + record.states[frame].segment<2>(2 * node));
    EXPECT_LE((positions[i].col(place) - mm).norm(), json["step"].get<double>()) << "frame " << frame;
  }
  for (const Json& series : json["series"]) {
    if (series["id"] != "tip_angle") continue;
    EXPECT_EQ(series["unit"], "deg");
    for (size_t i = 0; i < shown; ++i) {
      const double a = 1.2 * std::sin(2.5 * std::numbers::pi * times[i]) * std::exp(-times[i]);
      EXPECT_NEAR(series["values"][i].get<double>(), a * 180 / std::numbers::pi, 2e-3);
    }
  }
}

TEST(Animation, ValuesThatAreNotThereAreNull) {
  SimulationRecord record = bending_beam(3);
  record.channels[3].values[2] = NAN;  // the tension at the second frame
  const Json json = Json::parse(animation_json(record));
  const Json& tension = json["series"][5];
  EXPECT_EQ(tension["id"], "tension_upper");
  EXPECT_TRUE(tension["values"][1].is_null());
  EXPECT_TRUE(tension["values"][2].is_number());
}

TEST(Animation, ThePageLoadsNothingAndItsTextsCannotEndTheScript) {
  SimulationRecord record = bending_beam(3);
  record.title = "</script><b>&";
  record.channels[0].meaning = "</script><!-- \xff";  // not even UTF-8
  const std::string page = animation_html(record);
  EXPECT_NE(page.find("<h1>Simulation: &lt;/script&gt;&lt;b&gt;&amp;</h1>"), std::string::npos);
  size_t ends = 0;
  for (size_t at = page.find("</script"); at != std::string::npos; at = page.find("</script", at + 1)) ++ends;
  EXPECT_EQ(ends, 2u);  // of the data and of the script
  for (const char* outside : {"http", "src=", "@import", "<link", "@DATA@"}) {
    EXPECT_EQ(page.find(outside), std::string::npos) << outside;
  }
}

TEST(Animation, AnObstacleFarAwayDoesNotWidenTheWindowAndANearGroundIsInIt) {
  SimulationRecord record = bending_beam(2);
  record.grounds.clear();
  record.obstacles.clear();
  record.lines.clear();
  const plot::Bounds bodies = plot::bounds_of(record);
  record.obstacles = {{vector_of({1, 1}), vector_of({2, 1})}};
  record.grounds = {{vector_of({0, -1}), vector_of({0, 1})}};
  plot::Bounds bounds = plot::bounds_of(record);
  EXPECT_EQ(bounds.lower, bodies.lower);
  EXPECT_EQ(bounds.upper, bodies.upper);
  // Of a long floor only what is near counts; a ground at 2 mm below is seen, its far side is not.
  record.obstacles = {{vector_of({-5, 0.001}), vector_of({5, 0.001})}};
  record.grounds = {{vector_of({3, -0.002}), vector_of({0, 7})}};
  bounds = plot::bounds_of(record);
  EXPECT_NEAR(bounds.lower[1], -0.002, 1e-12);
  const double reach = 0.25 * bodies.diagonal();
  EXPECT_NEAR(bounds.lower[0], bodies.lower[0] - reach, 1e-9);
  EXPECT_NEAR(bounds.upper[0], bodies.upper[0] + reach, 1e-9);
  EXPECT_EQ(bounds.upper[1], bodies.upper[1]);
}

TEST(Surface, ARoundGroundThatMovesIsDrawnWhereItIsInEachFrame) {
  for (const bool in_space : {false, true}) {
    SimulationRecord record = in_space ? twisted_column(3) : bending_beam(3);
    const int d = in_space ? 3 : 2;
    const Eigen::VectorXd middle = Eigen::VectorXd::Constant(d, 0.01), way = Eigen::VectorXd::Unit(d, d - 1) * 0.004;
    record.grounds = {{middle, Eigen::VectorXd::Unit(d, d - 1), GroundKind::sphere, 0.003, {0 * way, way, 2 * way}}};
    const plot::Bounds bounds = plot::bounds_of(record);
    EXPECT_TRUE(plot::grounds_move(record));
    const auto first = plot::ground_strokes(record, bounds, 0), last = plot::ground_strokes(record, bounds, 2);
    ASSERT_EQ(first.size(), last.size());
    double farthest = 0;
    for (size_t i = 0; i < first.size(); ++i) {
      EXPECT_NEAR((last[i].first - first[i].first - 2 * way).norm(), 0, 1e-15);
      EXPECT_NEAR((first[i].first - middle).norm(), 0.003, 1e-15) << "strokes begin on its surface";
      farthest = std::max(farthest, (first[i].second - middle).norm());
    }
    EXPECT_NEAR(farthest, 0.003, 1e-15);
    const Json drawn = Json::parse(animation_json(record));
    EXPECT_EQ(drawn["round"].size(), 3u);
    record.grounds[0].moved.clear();
    EXPECT_EQ(Json::parse(animation_json(record))["round"].size(), 1u);
  }
}

TEST(Surface, ChosenFramesAreEvenAndHoldFirstAndLast) {
  EXPECT_EQ(plot::evenly_chosen(3, 6), (std::vector<size_t>{0, 1, 2}));
  EXPECT_EQ(plot::evenly_chosen(11, 6), (std::vector<size_t>{0, 2, 4, 6, 8, 10}));
  EXPECT_EQ(plot::evenly_chosen(1, 6), std::vector<size_t>{0});
  const std::vector<size_t> chosen = plot::evenly_chosen(100, 7);
  EXPECT_EQ(chosen.front(), 0u);
  EXPECT_EQ(chosen.back(), 99u);
  for (size_t i = 1; i < chosen.size(); ++i) EXPECT_NEAR(static_cast<double>(chosen[i] - chosen[i - 1]), 16.5, 0.6);
}

TEST(Surface, ThePainterDrawsTheNearOfTwoBoxesLastFromWhereverOneLooks) {
  // Two cubes on the x axis: whoever looks from +x must get all of the right one after all of the left one.
  Mesh left = box(graded(0.01, 1), graded(0.01, 1), graded(0.01, 1), 1, "foam"), right = left;
  for (int i = 0; i < right.node_count(); ++i) right.X[3 * i] += 0.05;
  const Mesh mesh = merge({{"left", left}, {"right", right}});
  const plot::Surface surface = boundary_surface(mesh);
  const Eigen::MatrixXd x = plot::positions(surface, mesh, Eigen::VectorXd::Zero(mesh.X.size()));
  for (const double azimuth : {-0.6, 0.0, 0.7, std::numbers::pi - 0.4, std::numbers::pi + 0.5}) {
    const bool from_right = std::cos(azimuth) > 0;
    bool near_begun = false;
    int near = 0, far = 0;
    for (const plot::Painted& facet : plot::painted(surface, x, plot::View(azimuth, 0.3))) {
      const auto& triangle = surface.triangles[static_cast<size_t>(facet.triangle)];
      const bool is_near = (x(0, triangle.points[0]) > 0.03) == from_right;
      near_begun = near_begun || is_near;
      EXPECT_EQ(is_near, near_begun);
      ++(is_near ? near : far);
      EXPECT_GT(facet.brightness, 0.4);
      EXPECT_LE(facet.brightness, 1.0);
    }
    EXPECT_EQ(near, far);
    EXPECT_EQ(near, azimuth == 0.0 ? 4 : 6);  // two triangles per visible face; at 0 one looks along a face
  }
}

}  // namespace
}  // namespace taut
