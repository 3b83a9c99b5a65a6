#include "sim/shapes/push_puppet_3d.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <functional>
#include <map>
#include <set>

#include "tests/support/mesh_checks.hpp"
#include "tests/support/message.hpp"

namespace taut {
namespace {

using namespace test;

constexpr PushPuppetMesh coarse_mesh{5e-3, 1, 1};

PushPuppet3d module_in_space(double stud_length = 0, const std::string& part = "whole") {
  PushPuppet3d module;
  module.section.cells = 2;
  module.section.gap_total = 8.6e-3;
  module.section.stud_length = stud_length;
  module.part = part;
  return module;
}

PushPuppet3d oblong_module() {  // every number another one than the default
  PushPuppet3d m;
  m.section.cells = 3;
  m.section.cell_length = 10e-3;
  m.section.core_height = 22e-3;
  m.core_depth = 34e-3;
  m.section.web_thickness = 2.5e-3;
  m.section.plate_thickness = 4e-3;
  m.section.clearance = 1.5e-3;
  m.section.lip_thickness = 5e-3;
  m.section.lip_relief = 0.8e-3;
  m.section.gap_total = 4.5e-3;
  m.section.cable_offset = 14.5e-3;
  m.section.via_inset = 0.7e-3;
  m.section.stud_length = 2e-3;
  m.section.stud_thickness = 1e-3;
  m.section.stud_play = 0.3e-3;
  return m;
}

double wide(const PushPuppet3d& m) {
  return m.core_depth + 2 * (m.section.clearance + m.section.lip_thickness);
}
double high(const PushPuppet3d& m) {
  return m.section.core_height + 2 * (m.section.clearance + m.section.lip_thickness);
}

/// Area of the core's section, made larger by r on all four sides.
double section_with(const PushPuppet3d& m, double r) {
  return (m.section.core_height + 2 * r) * (m.core_depth + 2 * r);
}

double plastic_volume(const PushPuppet3d& module, double inset) {
  const PushPuppet& m = module.section;
  const double walls = 2 * m.plate_thickness + (m.cells - 1) * m.web_thickness;
  const double lip = 0.5 * (m.cell_length - m.gap_total / m.cells) - inset, out = m.clearance + m.lip_thickness;
  double cell = lip * (section_with(module, out) - section_with(module, m.clearance) +
                       section_with(module, out - m.lip_relief) - section_with(module, m.clearance + m.lip_relief));
  if (m.stud_length > 0) {
    cell += 4 * m.stud_length * std::pow(m.stud_thickness - 2 * inset, 2);
    cell -= 4 * (m.stud_length + m.stud_play) * std::pow(m.stud_thickness + 2 * m.stud_play + 2 * inset, 2);
  }
  return walls * high(module) * wide(module) + m.cells * cell;
}

TEST(PushPuppet3d, VolumesAndFacesAreThoseOfTheDrawingForEachPart) {
  for (PushPuppet3d m : {module_in_space(), module_in_space(1.2e-3), oblong_module()}) {
    const PushPuppet& s = m.section;
    for (const auto& [part, share] : {std::pair{"whole", 1.0}, std::pair{"half", 0.5}, std::pair{"quarter", 0.25}}) {
      m.part = part;
      for (double inset : {0.0, 0.04e-3}) {
        const Mesh mesh = mesh_push_puppet_3d(m, coarse_mesh, inset);
        const double foam = share * s.cells * s.cell_length * s.core_height * m.core_depth;
        const double plastic = share * plastic_volume(m, inset);
        EXPECT_NEAR(total_measure(mesh, "foam") / foam, 1, 1e-12);
        EXPECT_NEAR(total_measure(mesh, "plastic") / plastic, 1, 1e-12) << part;
        EXPECT_NEAR(enclosed_measure(mesh, boundary(mesh)) / (foam + plastic), 1, 1e-12) << "closed";
        for (const char* end : {"base", "tip"})
          EXPECT_NEAR(size_of(mesh, mesh.select(end)) / (share * high(m) * wide(m)), 1, 1e-12) << end;
        const double walls = 2 * s.plate_thickness + (s.cells - 1) * s.web_thickness;
        const double outer = walls + 0.5 * (s.cells * s.cell_length - s.gap_total) - s.cells * inset;
        EXPECT_NEAR(size_of(mesh, mesh.select("upper")) / (std::max(share, 0.5) * outer * wide(m)), 1, 1e-12);
        EXPECT_NEAR(size_of(mesh, mesh.select("front")) / ((part[0] == 'q' ? 0.5 : 1) * outer * high(m)), 1, 1e-12);
      }
    }
    EXPECT_EQ(mesh_push_puppet_3d(m, coarse_mesh).tags.size(), 6u) << "base, tip, two sides, two planes of symmetry";
    // What is cut: each web and plate in half, the core, and of each frame two bars.
    m.part = "half";
    const Mesh half = mesh_push_puppet_3d(m, coarse_mesh);
    const double lip = 0.5 * (s.cell_length - s.gap_total / s.cells);
    EXPECT_NEAR(size_of(half, half.select("symmetry_z")),
                (2 * s.plate_thickness + (s.cells - 1) * s.web_thickness) * high(m) +
                    s.cells * (s.cell_length * s.core_height + 2 * lip * (2 * s.lip_thickness - 2 * s.lip_relief)),
                1e-12);
  }
}

TEST(PushPuppet3d, AQuadraticMeshHasTheSameVolumeAndItsMidNodesHalfway) {
  const PushPuppet3d m = module_in_space(1.2e-3, "quarter");
  const Mesh mesh = mesh_push_puppet_3d(m, {5e-3, 1, 2});
  mesh.check("module");
  EXPECT_EQ(mesh.shape, ElementShape::tet10);
  expect_mid_nodes_halfway(mesh);
  EXPECT_NEAR(total_measure(mesh, "plastic") / (0.25 * plastic_volume(m, 0)), 1, 1e-12);
}

using Place = std::array<double, 3>;
using Image = std::function<Place(Place)>;

/// Whether the images of all elements are elements, to the last digit.
void expect_own_image(const Mesh& mesh, const Image& image) {
  const auto vertices = [&](int e, const Image& map) {
    std::set<Place> places;
    for (int a = 0; a < mesh.nodes_per_element(); ++a) {
      const Eigen::VectorXd x = mesh.node(mesh.element(e)[a]);
      places.insert(map({x[0], x[1], x[2]}));
    }
    return std::pair(mesh.region[e], places);
  };
  std::set<std::pair<int, std::set<Place>>> elements, images;
  for (int e = 0; e < mesh.element_count(); ++e) {
    elements.insert(vertices(e, [](Place place) { return place; }));
    images.insert(vertices(e, image));
  }
  EXPECT_TRUE(elements == images);
}

TEST(PushPuppet3d, TheMeshIsItsOwnMirrorImageToTheLastDigit) {
  for (int order : {1, 2}) {
    const Mesh square = mesh_push_puppet_3d(module_in_space(1.2e-3), {7e-3, 1, order}, 0.02e-3);
    expect_own_image(square, [](Place at) { return Place{at[0], -at[1] + 0.0, at[2]}; });
    expect_own_image(square, [](Place at) { return Place{at[0], at[1], -at[2] + 0.0}; });
    expect_own_image(square, [](Place at) { return Place{at[0], at[2], at[1]}; });
  }
  const Mesh oblong = mesh_push_puppet_3d(oblong_module(), {8e-3, 1, 1});
  expect_own_image(oblong, [](Place at) { return Place{at[0], -at[1] + 0.0, at[2]}; });
  expect_own_image(oblong, [](Place at) { return Place{at[0], at[1], -at[2] + 0.0}; });
}

TEST(PushPuppet3d, APartHasTheElementsOfTheWhole) {
  const auto places = [](const std::string& part) {
    std::set<std::set<Place>> elements;
    const Mesh mesh = mesh_push_puppet_3d(module_in_space(1.2e-3, part), coarse_mesh);
    for (int e = 0; e < mesh.element_count(); ++e) {
      std::set<Place> vertices;
      for (int a = 0; a < 4; ++a) {
        const Eigen::VectorXd x = mesh.node(mesh.element(e)[a]);
        vertices.insert({x[0], x[1], x[2]});
      }
      elements.insert(vertices);
    }
    return elements;
  };
  const auto whole = places("whole"), half = places("half"), quarter = places("quarter");
  EXPECT_TRUE(std::ranges::includes(whole, half));
  EXPECT_TRUE(std::ranges::includes(half, quarter));
}

TEST(PushPuppet3d, NodesOfFacesThatMeetDoNotCoincide) {
  for (double stud : {0.0, 1.2e-3}) {
    for (int lip_cells : {1, 2, 3, 5}) {
      for (int order : {1, 2}) {
        const PushPuppet3d m = module_in_space(stud, "quarter");
        const Mesh mesh = mesh_push_puppet_3d(m, {5e-3, lip_cells, order});
        const double lip = 3.6e-3, core = 0.5 * m.section.core_height;
        std::vector<Eigen::Vector2d> left, right;
        for (int node : boundary(mesh).nodes()) {
          const Eigen::Vector3d x = mesh.node(node);
          if (std::max(x[1], x[2]) < core + 1e-9) continue;
          if (std::abs(x[0] - lip) < 1e-9) left.emplace_back(x[1], x[2]);
          if (std::abs(x[0] - (11.5e-3 - lip)) < 1e-9) right.emplace_back(x[1], x[2]);
        }
        ASSERT_GT(left.size(), 10u);
        ASSERT_GT(right.size(), left.size());
        double nearest = 1;
        for (const Eigen::Vector2d& a : left) {
          for (const Eigen::Vector2d& b : right) nearest = std::min(nearest, (a - b).norm());
        }
        const double spacing = 3e-3 / (stud > 0 ? 7 : lip_cells) / order;
        EXPECT_GT(nearest, 0.03 * spacing) << stud << " " << lip_cells << " " << order;
      }
    }
  }
}

TEST(PushPuppet3d, FoamIsBondedToTheWebsOnlyAndStudsStandFreeInTheirHoles) {
  const Mesh mesh = mesh_push_puppet_3d(oblong_module(), coarse_mesh);
  std::set<int> foam, plastic;
  for (int e = 0; e < mesh.element_count(); ++e) {
    for (int a = 0; a < 4; ++a)
      (mesh.region[e] == mesh.region_index("foam") ? foam : plastic).insert(mesh.element(e)[a]);
  }
  for (int node : foam) {
    if (!plastic.contains(node)) continue;
    const double in_pitch = std::fmod(mesh.node(node)[0], 12.5e-3);
    EXPECT_TRUE(in_pitch < 1e-9 || std::abs(in_pitch - 10e-3) < 1e-9 || in_pitch > 12.5e-3 - 1e-9) << in_pitch;
  }
  // A stud, reaching 0.5 mm into its hole: plastic on its axis, nothing beside it within the play.
  const double y = 11e-3 + 1.5e-3 + 2.5e-3, z = 17e-3 + 4e-3, x = 6e-3;
  EXPECT_NO_THROW(locate(mesh, vec({x, y, z})));
  for (const auto& [dy, dz] : {std::pair{0.65e-3, 0.0}, std::pair{0.0, -0.65e-3}, std::pair{-0.65e-3, 0.65e-3}})
    EXPECT_THROW(locate(mesh, vec({x, y + dy, z + dz})), InputError);
  EXPECT_NO_THROW(locate(mesh, vec({x, y + 0.85e-3, z}))) << "the hole's wall";
  EXPECT_THROW(locate(mesh, vec({x + 1e-3, y, z})), InputError) << "behind the stud";
}

TEST(PushPuppet3d, CablesRunThroughTheCornersOfItsPart) {
  for (const auto& [part, count] : {std::pair{"whole", 4u}, std::pair{"half", 2u}, std::pair{"quarter", 1u}}) {
    PushPuppet3d m = oblong_module();
    m.part = part;
    const Mesh mesh = mesh_push_puppet_3d(m, coarse_mesh);
    const std::vector<std::string> names = m.cable_names();
    ASSERT_EQ(names.size(), count);
    for (size_t k = 0; k < names.size(); ++k) {
      const auto points = m.cable(k);
      const double up = names[k].starts_with("upper") ? 1 : -1, forward = names[k].ends_with("front") ? 1 : -1;
      for (size_t i = 0; i < points.size(); ++i) {
        EXPECT_NO_THROW(locate(mesh, points[i])) << names[k];
        EXPECT_NEAR(points[i][0], cable_path(m.section, 1)[i][0], 0);
        EXPECT_NEAR(points[i][1], up * 14.5e-3, 1e-15);
        EXPECT_NEAR(points[i][2], forward * 20.5e-3, 1e-15) << "as far from the rim as along y";
      }
    }
  }
}

TEST(PushPuppet3d, ClosedLipsRestWhereTheModulesOwnDo) {
  const PushPuppet3d m = module_in_space();
  const MeshSettings settings{.size = 5e-3, .counts = {{"lip_cells", 1}}, .order = 1, .contact_gap = 0.1e-3};
  const double lost =
      total_measure(m.mesh(settings, true, false), "plastic") - total_measure(m.mesh(settings, true, true), "plastic");
  EXPECT_NEAR(lost, plastic_volume(m, 0) - plastic_volume(m, 0.5 * resting_distance * 0.1e-3), 1e-16);
  MeshSettings wide_gap = settings;
  wide_gap.contact_gap = 1e-3;
  expect_input_error([&] { m.mesh(wide_gap, true, true); }, {"contact gap of 1 mm", "0.5 mm"});
}

TEST(PushPuppet3d, WhatMakesNoModuleIsRefused) {
  PushPuppet3d m;
  const auto refused = [&](const std::vector<std::string>& parts) {
    expect_input_error([&] { mesh_push_puppet_3d(m, coarse_mesh); }, parts);
    m = {};
  };
  m.core_depth = 0;
  refused({"push-puppet module", "core_depth is 0 mm", "positive"});
  m.part = "quater";
  refused({"push-puppet module", "part \"quater\"", "did you mean 'quarter'", "whole, half, quarter"});
  m.section.lip_relief = 2e-3;
  refused({"lip_relief 2 mm"});
  m.section.gap_total = 8e-3;
  m.section.stud_length = 2.001e-3;  // ends in the mouth of its hole
  refused({"0.001 mm apart", "needles", "stud_length"});
  m.section.cable_offset = 15e-3;
  refused({"cable_offset 15 mm", "left lips"});
  expect_input_error([&] { mesh_push_puppet_3d(m, {0, 1, 1}); }, {"element size 0 mm"});
  for (const ShapeKey& key : m.keys()) EXPECT_EQ(key.key.find("bracket"), std::string_view::npos);
}

}  // namespace
}  // namespace taut
