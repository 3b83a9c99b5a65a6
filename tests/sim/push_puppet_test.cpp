#include "sim/shapes/push_puppet.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <vector>

#include "tests/support/mesh_checks.hpp"
#include "tests/support/message.hpp"

namespace taut {
namespace {

using namespace test;

PushPuppet with_studs() {
  PushPuppet module;
  module.stud_length = 1.2e-3;
  return module;
}

PushPuppet small_module() {  // two cells, every number another one than the default
  PushPuppet module;
  module.cells = 2;
  module.cell_length = 10e-3;
  module.core_height = 22e-3;
  module.web_thickness = 2.5e-3;
  module.plate_thickness = 4e-3;
  module.clearance = 1.5e-3;
  module.lip_thickness = 5e-3;
  module.lip_relief = 0.8e-3;
  module.gap_total = 5e-3;
  module.cable_offset = 14e-3;
  module.via_inset = 0.7e-3;
  module.stud_length = 2e-3;
  module.stud_thickness = 1e-3;
  module.stud_play = 0.3e-3;
  return module;
}

std::vector<PushPuppet> modules() {
  return {PushPuppet{}, with_studs(), small_module()};
}

double lip_length(const PushPuppet& m) {
  return 0.5 * (m.cell_length - m.gap_total / m.cells);
}

double outer_height(const PushPuppet& m) {
  return m.core_height + 2 * (m.clearance + m.lip_thickness);
}

double foam_area(const PushPuppet& m) {
  return m.cells * m.cell_length * m.core_height;
}

double plastic_area(const PushPuppet& m, double inset) {
  const double walls = 2 * m.plate_thickness + (m.cells - 1) * m.web_thickness;
  double lips = (2 * m.lip_thickness - 2 * m.lip_relief) * (lip_length(m) - inset);
  if (m.stud_length > 0) {
    lips += m.stud_length * (m.stud_thickness - 2 * inset) -
            (m.stud_length + m.stud_play) * (m.stud_thickness + 2 * m.stud_play + 2 * inset);
  }
  return walls * outer_height(m) + 2 * m.cells * lips;
}

double outline_length(const PushPuppet& m, double inset) {
  const double walls = 2 * m.plate_thickness + (m.cells - 1) * m.web_thickness;
  double cell = m.cell_length + 2 * (m.clearance + m.lip_thickness) + 4 * (lip_length(m) - inset);
  if (m.stud_length > 0) cell += 2 * m.stud_length + 2 * (m.stud_length + m.stud_play);
  return 2 * outer_height(m) + 2 * walls + 2 * m.cells * cell;
}

/// Connected parts of the boundary, counted by walking along its edges.
int loops(const Mesh& mesh) {
  std::map<int, int> next;
  const Tag edges = boundary(mesh);
  for (int i = 0; i < edges.count(); ++i) {
    const int* nodes = &edges.entities[i * edges.nodes_per_entity];
    EXPECT_TRUE(next.emplace(nodes[0], nodes[1]).second) << "two parts of the boundary touch in a node";
  }
  int count = 0;
  while (!next.empty()) {
    ++count;
    for (auto at = next.begin(); at != next.end();) {
      const int to = at->second;
      next.erase(at);
      at = next.find(to);
    }
  }
  return count;
}

/// Heights of the boundary vertices of the upper side with abscissa `x` between two heights, sorted.
std::vector<double> heights_at(const Mesh& mesh, double x, double low, double high) {
  std::set<double> heights;
  for (int node : boundary(mesh).nodes()) {
    const Eigen::VectorXd p = mesh.node(node);
    if (std::abs(p[0] - x) < 1e-12 && p[1] > low - 1e-12 && p[1] < high + 1e-12) heights.insert(p[1]);
  }
  return {heights.begin(), heights.end()};
}

double nearest_distance(const std::vector<double>& a, const std::vector<double>& b) {
  double nearest = INFINITY;
  for (double y : a) {
    for (double z : b) nearest = std::min(nearest, std::abs(y - z));
  }
  return nearest;
}

/// Region of an element that has all nodes of the located point; on a face those are fewer than the element's.
int region_at(const Mesh& mesh, double x, double y) {
  const MaterialPoint point = locate(mesh, vec({x, y}));
  for (int e = 0; e < mesh.element_count(); ++e) {
    const std::set<int> nodes(mesh.element(e), mesh.element(e) + mesh.nodes_per_element());
    if (std::all_of(point.nodes.begin(), point.nodes.end(), [&](int node) { return nodes.contains(node); })) {
      return mesh.region[e];
    }
  }
  return -1;
}

TEST(PushPuppetMesh, AreasOfTheRegionsAndTheOutlineAreThoseOfTheDrawing) {
  for (const PushPuppet& module : modules()) {
    for (int order : {1, 2}) {
      for (double inset : {0.0, 0.04e-3}) {
        const Mesh mesh = mesh_push_puppet(module, {1.3e-3, 2, order}, inset);
        EXPECT_NO_THROW(mesh.check("module"));
        EXPECT_NEAR(total_measure(mesh, "foam"), foam_area(module), 1e-11 * foam_area(module));
        EXPECT_NEAR(total_measure(mesh, "plastic"), plastic_area(module, inset), 1e-11 * plastic_area(module, inset));
        expect_conforming(mesh, outline_length(module, inset));
        if (order == 2) expect_mid_nodes_halfway(mesh);
      }
    }
  }
}

TEST(PushPuppetMesh, BracketsAreAsHighAsTheNextLineOfTheMesh) {
  // Lines of the foam lie 1 mm apart: half of 9.2 mm reaches to the fifth.
  PushPuppet module;
  const PushPuppetMesh settings{1e-3, 2, 1};
  const double without = total_measure(mesh_push_puppet(module, settings), "plastic");
  module.base_bracket = 4e-3;
  module.tip_bracket = 6e-3;
  for (const double height : {9.2e-3, 10e-3}) {
    module.bracket_height = height;
    const double with = total_measure(mesh_push_puppet(module, settings), "plastic");
    EXPECT_NEAR(with - without, (4e-3 + 6e-3) * 10e-3, 1e-11 * without) << height;
  }
}

TEST(PushPuppetMesh, TheBoundaryIsOneLoopAndFoamIsBondedToWebsOnly) {
  for (const PushPuppet& module : modules()) {
    const Mesh mesh = mesh_push_puppet(module, {1.3e-3, 2, 1});
    EXPECT_EQ(loops(mesh), 1);
    std::set<int> foam;
    std::set<int> plastic;
    for (int e = 0; e < mesh.element_count(); ++e) {
      (mesh.region[e] == mesh.region_index("foam") ? foam : plastic).insert(mesh.element(e), mesh.element(e) + 3);
    }
    for (int node : foam) {
      if (!plastic.contains(node)) continue;
      const double x = mesh.node(node)[0];
      const double pitch = module.cell_length + module.web_thickness;
      const double in_cell = x - pitch * std::floor(x / pitch + 1e-9);
      EXPECT_LT(std::min(std::abs(in_cell), std::abs(in_cell - module.cell_length)), 1e-12);
    }
  }
}

TEST(PushPuppetMesh, TagsAreTheOuterFacesOfThePlates) {
  for (int order : {1, 2}) {
    const Mesh mesh = mesh_push_puppet({}, {1.3e-3, 2, order});
    ASSERT_EQ(mesh.tags.size(), 2u);
    EXPECT_NEAR(size_of(mesh, mesh.select("base")), 42e-3, 1e-15);
    EXPECT_NEAR(size_of(mesh, mesh.select("tip")), 42e-3, 1e-15);
    for (int node : mesh.select("base").nodes()) EXPECT_EQ(mesh.node(node)[0], -3e-3);
    for (int node : mesh.select("tip").nodes()) EXPECT_NEAR(mesh.node(node)[0], 58e-3, 1e-16);
    EXPECT_LT(facet_normal(mesh, mesh.select("base").entities.data())[0], 0.0);
    EXPECT_GT(facet_normal(mesh, mesh.select("tip").entities.data())[0], 0.0);
  }
}

TEST(PushPuppetMesh, IsSymmetricToTheLastDigit) {
  const Mesh mesh = mesh_push_puppet(with_studs(), {1.3e-3, 2, 2});
  std::set<std::pair<double, double>> nodes;
  for (int i = 0; i < mesh.node_count(); ++i) nodes.insert({mesh.node(i)[0], mesh.node(i)[1]});
  EXPECT_EQ(nodes.size(), static_cast<size_t>(mesh.node_count()));
  for (const auto& [x, y] : nodes) EXPECT_TRUE(nodes.contains({x, -y})) << x << " " << y;
  const auto centroids = [&](double sign) {
    std::set<std::pair<long, long>> result;  // rounded to a femtometre: sums depend on their order
    for (int e = 0; e < mesh.element_count(); ++e) {
      Eigen::Vector2d sum = Eigen::Vector2d::Zero();
      for (int a = 0; a < 3; ++a) sum += mesh.node(mesh.element(e)[a]);
      result.insert({std::lround(sum.x() * 1e12), std::lround(sign * sum.y() * 1e12)});
    }
    return result;
  };
  EXPECT_EQ(centroids(1), centroids(-1));
}

TEST(PushPuppetMesh, NodesOfFacesThatMeetAreNotAligned) {
  for (const PushPuppet& module : modules()) {
    for (const PushPuppetMesh& settings :
         {PushPuppetMesh{1.3e-3, 2, 1}, PushPuppetMesh{1.3e-3, 4, 1}, PushPuppetMesh{0.65e-3, 2, 1},
          PushPuppetMesh{2e-3, 3, 1}, PushPuppetMesh{1.3e-3, 8, 1}, PushPuppetMesh{1.3e-3, 1, 2},
          PushPuppetMesh{1.3e-3, 2, 2}, PushPuppetMesh{1.3e-3, 4, 2}, PushPuppetMesh{0.65e-3, 2, 2}}) {
      const Mesh mesh = mesh_push_puppet(module, settings);
      const double low = 0.5 * module.core_height + module.clearance;
      const double high = low + module.lip_thickness;
      const double length = lip_length(module);
      const std::vector<double> left = heights_at(mesh, length, low, high);
      const std::vector<double> right = heights_at(mesh, module.cell_length - length, low, high);
      ASSERT_GE(left.size(), 3u);
      ASSERT_GT(right.size(), left.size());
      EXPECT_NEAR(left.front(), low + module.lip_relief, 1e-15);
      EXPECT_NEAR(left.back(), high - module.lip_relief, 1e-15);
      EXPECT_NEAR(right.front(), low, 1e-15);
      EXPECT_NEAR(right.back(), high, 1e-15);
      const double spacing = (high - low) / (static_cast<double>(right.size()) - 1);
      EXPECT_GT(nearest_distance(left, right), 0.02 * spacing)
          << "size " << settings.size << ", " << settings.lip_cells << " through a lip, order " << settings.order;
    }
  }
}

TEST(PushPuppetMesh, DoublingLipCellsDoublesTheElementsOfTheFaces) {
  const auto elements = [](int lip_cells) {
    const Mesh mesh = mesh_push_puppet({}, {1.3e-3, lip_cells, 1});
    const size_t nodes = heights_at(mesh, 3.6e-3, 17e-3, 21e-3).size() + heights_at(mesh, 7.9e-3, 17e-3, 21e-3).size();
    return static_cast<double>(nodes - 2);
  };
  EXPECT_NEAR(elements(4) / elements(2), 2.0, 0.2);
  EXPECT_NEAR(elements(8) / elements(4), 2.0, 0.2);
}

TEST(PushPuppetMesh, WallsHaveTwoElementsThroughTheirThicknessHoweverLargeTheElements) {
  const Mesh mesh = mesh_push_puppet({}, {8e-3, 2, 1});
  std::set<double> x;
  for (int i = 0; i < mesh.node_count(); ++i) x.insert(mesh.node(i)[0]);
  EXPECT_EQ(std::distance(x.lower_bound(-3.1e-3), x.upper_bound(1e-9)), 3);
  EXPECT_EQ(std::distance(x.lower_bound(11.4e-3), x.upper_bound(14.6e-3)), 3);
}

TEST(PushPuppetMesh, IsTheSameEveryTimeAndOfTheSizeAskedFor) {
  const Mesh mesh = mesh_push_puppet({}, {1.3e-3, 2, 1});
  EXPECT_EQ(mesh.X, mesh_push_puppet({}, {1.3e-3, 2, 1}).X);
  EXPECT_GT(mesh.node_count(), 1200);
  EXPECT_LT(mesh.node_count(), 1700);
  const Mesh finer = mesh_push_puppet({}, {0.65e-3, 4, 1});
  EXPECT_NEAR(static_cast<double>(finer.element_count()) / mesh.element_count(), 4.0, 0.4);
}

TEST(PushPuppetMesh, AnInsetShortensEveryLipAndNothingElse) {
  const Mesh mesh = mesh_push_puppet({}, {1.3e-3, 2, 1}, 0.05e-3);
  EXPECT_EQ(heights_at(mesh, 3.55e-3, 17e-3, 21e-3).size(), 3u);
  EXPECT_EQ(heights_at(mesh, 3.6e-3, 17e-3, 21e-3).size(), 0u);
  EXPECT_EQ(heights_at(mesh, 7.95e-3, 17e-3, 21e-3).size(), 6u);
  EXPECT_EQ(heights_at(mesh, 58e-3, -21e-3, 21e-3).size(), mesh.select("tip").nodes().size());
}

TEST(PushPuppetMesh, CablePointsLieInThePlastic) {
  for (const PushPuppet& module : modules()) {
    for (double inset : {0.0, 0.1e-3}) {
      const Mesh mesh = mesh_push_puppet(module, {1.3e-3, 2, 1}, inset);
      for (int side : {1, -1}) {
        const std::vector<Eigen::Vector2d> path = cable_path(module, side);
        ASSERT_EQ(path.size(), static_cast<size_t>(2 * module.cells + 2));
        for (size_t i = 0; i < path.size(); ++i) {
          EXPECT_EQ(region_at(mesh, path[i].x(), path[i].y()), mesh.region_index("plastic")) << "point " << i;
          if (i > 0) {
            EXPECT_GT(path[i].x(), path[i - 1].x());
          }
        }
      }
    }
  }
}

TEST(PushPuppetMesh, CablePathOfTheReferenceModule) {
  const std::vector<Eigen::Vector2d> path = cable_path({}, -1);
  const std::vector<double> x{-3, 3.1, 8.4, 17.6, 22.9, 32.1, 37.4, 46.6, 51.9, 58};
  ASSERT_EQ(path.size(), x.size());
  for (size_t i = 0; i < x.size(); ++i) {
    EXPECT_NEAR(path[i].x(), 1e-3 * x[i], 1e-15);
    EXPECT_EQ(path[i].y(), -19e-3);
  }
  // Behind the groove's bottom, 1.2 + 0.2 mm into the right lip; the left lip's point stays behind its end face.
  EXPECT_NEAR(cable_path(with_studs(), 1)[1].x(), 3.1e-3, 1e-15);
  EXPECT_NEAR(cable_path(with_studs(), 1)[2].x(), 9.8e-3, 1e-15);
}

TEST(PushPuppetMesh, ATongueLongerThanTheGapStartsInItsGroove) {
  PushPuppet module = with_studs();
  module.gap_total = 4e-3;  // 1 mm each
  const Mesh mesh = mesh_push_puppet(module, {1.3e-3, 2, 1});
  EXPECT_NEAR(total_measure(mesh, "plastic"), plastic_area(module, 0), 1e-11 * plastic_area(module, 0));
  EXPECT_EQ(loops(mesh), 1);
}

TEST(PushPuppetMessages, NumbersThatClashAreNamedInMillimetres) {
  const auto refused = [](auto&& change, const std::vector<std::string>& parts) {
    PushPuppet module = with_studs();
    change(module);
    expect_input_error([&] { module.check(); }, parts);
    expect_input_error([&] { mesh_push_puppet(module, {}); }, parts);
    expect_input_error([&] { cable_path(module, 1); }, parts);
  };
  refused([](PushPuppet& m) { m.cells = 0; }, {"cells is 0", "at least 1"});
  refused([](PushPuppet& m) { m.web_thickness = 0; }, {"web_thickness is 0 mm", "positive"});
  refused([](PushPuppet& m) { m.clearance = -1e-3; }, {"clearance is -1 mm", "positive"});
  refused([](PushPuppet& m) { m.cell_length = NAN; }, {"cell_length is nan", "positive"});
  refused([](PushPuppet& m) { m.lip_relief = -1e-3; }, {"lip_relief is -1 mm", "0"});
  refused([](PushPuppet& m) { m.gap_total = 46e-3; },
          {"gap_total 46 mm", "4 cells", "11.5 mm in each", "cell_length is 11.5 mm", "smaller than 46 mm"});
  refused([](PushPuppet& m) { m.lip_relief = 2e-3; }, {"lip_relief 2 mm", "lip_thickness 4 mm", "smaller than 2 mm"});
  refused([](PushPuppet& m) { m.via_inset = 3.6e-3; },
          {"via_inset 3.6 mm", "lips", "3.6 mm long", "gap_total 17.2 mm"});
  refused([](PushPuppet& m) { m.cable_offset = 17.2e-3; }, {"cable_offset 17.2 mm", "left lips", "17.5 mm to 20.5 mm"});
  refused([](PushPuppet& m) { m.stud_play = 0; }, {"stud_play is 0 mm", "positive", "leaves studs out"});
  refused([](PushPuppet& m) { m.stud_thickness = 3e-3; },
          {"stud_thickness 3 mm", "left lip of 3 mm", "lip_thickness 4 mm", "lip_relief 0.5 mm", "thinner"});
  refused([](PushPuppet& m) { m.stud_play = 1.3e-3; }, {"groove of 4.1 mm", "stud_play 1.3 mm", "lip_thickness 4 mm"});
  refused([](PushPuppet& m) { m.stud_length = 3e-3; },
          {"groove 3.2 mm deep", "stud_length 3 mm", "via_inset 0.5 mm", "3.6 mm long", "shorter"});
}

TEST(PushPuppetMessages, WrongMeshSettingsAreRefused) {
  expect_input_error([] { mesh_push_puppet({}, {0.0, 2, 1}); }, {"element size 0 mm", "positive"});
  expect_input_error([] { mesh_push_puppet({}, {1e-3, 0, 1}); }, {"0 elements through a lip", "at least 1"});
  expect_input_error([] { mesh_push_puppet({}, {1e-3, 2, 3}); }, {"order 3", "1 and 2"});
  expect_input_error([] { mesh_push_puppet({}, {}, 0.5e-3); }, {"0.5 mm shorter", "via_inset 0.5 mm"});
  expect_input_error([] { mesh_push_puppet({}, {}, -1e-3); }, {"-1 mm shorter", "allowed are 0"});
  expect_input_error(
      [] {
        PushPuppet module = with_studs();
        module.stud_thickness = 0.4e-3;
        mesh_push_puppet(module, {}, 0.3e-3);
      },
      {"0.3 mm taken off", "stud of 0.4 mm"});
  expect_input_error([] { cable_path({}, 0); }, {"side 0", "+1", "-1"});
}

}  // namespace
}  // namespace taut
