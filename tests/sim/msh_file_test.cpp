#include "sim/mesh/msh_file.hpp"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

#if TAUT_HAS_GMSH && __has_include(<gmsh.h>)
#include <gmsh.h>
#define TAUT_TEST_WRITES_MSH 1
#endif

#include "sim/mesh/geo_file.hpp"
#include "sim/mesh/mesh.hpp"
#include "sim/shapes/mesh_file.hpp"
#include "tests/support/mesh_checks.hpp"
#include "tests/support/message.hpp"

namespace taut {
namespace {

using namespace test;

/// A file in the temporary folder that goes with the test.
class TemporaryFile {
 public:
  explicit TemporaryFile(const std::string& text, const std::string& extension = ".msh") {
    const auto* info = testing::UnitTest::GetInstance()->current_test_info();
    static int number = 0;
    path_ = testing::TempDir() + info->test_suite_name() + "_" + info->name() + std::to_string(number++) + extension;
    std::ofstream(path_, std::ios::binary) << text;
  }
  ~TemporaryFile() { std::filesystem::remove(path_); }
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;
  const std::string& path() const { return path_; }

 private:
  std::string path_;
};

Mesh read_text(const std::string& text, double unit = 1.0) {
  const TemporaryFile file(text);
  return read_msh(file.path(), unit);
}

/// How many remarks contain `part`.
int count_of(const Mesh& mesh, const std::string& part) {
  return static_cast<int>(
      std::ranges::count_if(mesh.remarks, [&](const std::string& r) { return r.find(part) != std::string::npos; }));
}

std::string all_of(const Mesh& mesh) {
  std::string all;
  for (const std::string& remark : mesh.remarks) all += remark + "\n";
  return all;
}

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return text.replace(at, from.size(), to);
}

// Two triangles of one square, mm; the second is clockwise. Node 9 is a construction point of no element.
const std::string square_22 = R"($MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
3
1 5 "left edge"
2 7 "skin"
2 8 "core"
$EndPhysicalNames
$Nodes
5
1 0 0 3
2 10 0 3
30 10 10 3
4 0 10 3
9 50 50 99
$EndNodes
$Elements
6
1 15 2 11 1 2
2 1 2 5 4 1 4
3 1 2 0 1 1 2
4 2 2 7 1 1 2 30
5 2 2 8 2 1 4 30
6 1 2 6 1 2 30
$EndElements
)";

const std::string square_41 = R"($MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
3
1 5 "left edge"
2 7 "skin"
2 8 "core"
$EndPhysicalNames
$Entities
1 3 2 0
2 10 0 3 1 11
1 0 0 3 10 0 3 0 2 1 -2
2 10 0 3 10 10 3 1 6 2 2 -3
4 0 0 3 0 10 3 1 -5 2 4 -1
1 0 0 3 10 10 3 1 7 3 1 2 3
2 0 0 3 10 10 3 1 8 3 1 2 3
$EndEntities
$Nodes
2 5 1 30
2 1 0 4
1
2
30
4
0 0 3
10 0 3
10 10 3
0 10 3
0 5 1 1
9
50 50 99 0.5
$EndNodes
$Elements
6 6 1 6
0 2 15 1
1 2
1 4 1 1
2 1 4
1 1 1 1
3 1 2
1 2 1 1
6 2 30
2 1 2 1
4 1 2 30
2 2 2 1
5 1 4 30
$EndElements
$NodeData
1
"ignored"
$EndNodeData
)";

void expect_square(const Mesh& mesh) {
  EXPECT_EQ(mesh.shape, ElementShape::tri3);
  EXPECT_EQ(mesh.node_count(), 4);  // the construction point is dropped
  ASSERT_EQ(mesh.element_count(), 2);
  EXPECT_NEAR(total_measure(mesh), 1e-4, 1e-18);  // the clockwise triangle is turned round
  EXPECT_EQ(mesh.region_names, (std::vector<std::string>{"skin", "core"}));
  EXPECT_EQ(mesh.region, (std::vector<int>{0, 1}));
  EXPECT_EQ(mesh.elements, (std::vector<int>{0, 1, 2, 0, 2, 3}));
  ASSERT_EQ(mesh.tags.size(), 3u);
  EXPECT_EQ(mesh.tags.at("left edge").entities, (std::vector<int>{3, 0}));  // outward: down along the left side
  EXPECT_EQ(mesh.tags.at("physical_6").entities, (std::vector<int>{1, 2}));
  EXPECT_EQ(mesh.tags.at("physical_11").dimension, 0);
  EXPECT_EQ(mesh.tags.at("physical_11").entities, std::vector<int>{1});
  EXPECT_NEAR(mesh.X[4], 0.01, 1e-18);
}

TEST(MshFile, Format22IsRead) {
  expect_square(read_text(square_22, 1e-3));
}

TEST(MshFile, Format41IsRead) {
  expect_square(read_text(square_41, 1e-3));
}

TEST(MshFile, WindowsLineEndsAreRead) {
  std::string text;
  for (char c : square_41) text += c == '\n' ? std::string("\r\n") : std::string(1, c);
  expect_square(read_text(text, 1e-3));
}

// One tetrahedron with vertices 1..4 and Gmsh's order of mid-nodes: 01 12 02 03 23 13.
const std::string tet10 = R"($MeshFormat
2.2 0 8
$EndMeshFormat
$Nodes
10
1 0 0 0
2 2 0 0
3 0 2 0
4 0 0 2
5 1 0 0
6 1 1 0
7 0 1 0
8 0 0 1
9 0 1 1
10 1 0 1
$EndNodes
$Elements
3
1 11 2 1 1 1 2 3 4 5 6 7 8 9 10
2 9 2 3 1 1 2 3 5 6 7
3 8 2 4 1 2 4 10
$EndElements
)";

void expect_tet10(const Mesh& mesh) {
  EXPECT_EQ(mesh.shape, ElementShape::tet10);
  EXPECT_NEAR(total_measure(mesh), 8.0 / 6.0, 1e-15);
  const int edges[6][2] = {{0, 1}, {1, 2}, {0, 2}, {0, 3}, {1, 3}, {2, 3}};
  const int* nodes = mesh.element(0);
  for (int k = 0; k < 6; ++k) {
    EXPECT_EQ((mesh.node(nodes[4 + k]) - 0.5 * (mesh.node(nodes[edges[k][0]]) + mesh.node(nodes[edges[k][1]]))).norm(),
              0.0)
        << "mid-node " << k;
  }
  const Tag& face = mesh.tags.at("physical_3");
  EXPECT_EQ(face.nodes_per_entity, 6);
  EXPECT_EQ(mesh.tags.at("physical_4").nodes_per_entity, 3);
  const Eigen::Vector3d a = mesh.node(face.entities[1]) - mesh.node(face.entities[0]);
  const Eigen::Vector3d b = mesh.node(face.entities[2]) - mesh.node(face.entities[0]);
  EXPECT_LT(a[0] * b[1] - a[1] * b[0], 0.0);  // the face z = 0 looks down, outward
}

TEST(MshFile, QuadraticTetrahedraGetOurMidNodeOrder) {
  expect_tet10(read_text(tet10));
}

TEST(MshFile, InvertedQuadraticTetrahedraAreTurnedRoundWithTheirMidNodes) {
  expect_tet10(read_text(replaced(tet10, "1 2 3 4 5 6 7 8 9 10", "1 3 2 4 7 6 5 8 10 9")));
}

TEST(MshFile, InvertedQuadraticTrianglesAreTurnedRoundWithTheirMidNodes) {
  const Mesh mesh = read_text(R"($MeshFormat
2.2 0 8
$EndMeshFormat
$Nodes
6
1 0 0 0
2 0 2 0
3 2 0 0
4 0 1 0
5 1 1 0
6 1 0 0
$EndNodes
$Elements
1
1 9 2 1 1 1 2 3 4 5 6
$EndElements
)");
  EXPECT_NEAR(total_measure(mesh), 2.0, 1e-15);
  const int* n = mesh.element(0);
  for (int k = 0; k < 3; ++k) {
    EXPECT_EQ((mesh.node(n[3 + k]) - 0.5 * (mesh.node(n[k]) + mesh.node(n[(k + 1) % 3]))).norm(), 0.0);
  }
}

#if TAUT_TEST_WRITES_MSH
TEST(MshFile, WhatGmshWritesIsReadInAllFormatsAndOrders) {
  const TemporaryFile file("");
  for (const auto& [version, binary] : {std::pair{2.2, 0}, {4.1, 0}, {2.2, 1}, {4.0, 0}, {4.1, 1}}) {
    for (int order : {1, 2}) {
      gmsh::initialize(0, nullptr, false);
      gmsh::option::setNumber("General.Terminal", 0);
      gmsh::model::add("beam");
      const int left = gmsh::model::occ::addBox(0, 0, 0, 30, 10, 10);
      const int right = gmsh::model::occ::addBox(30, 0, 0, 20, 10, 10);
      gmsh::vectorpair pieces;
      std::vector<gmsh::vectorpair> origins;
      gmsh::model::occ::fragment({{3, left}}, {{3, right}}, pieces, origins);
      gmsh::model::occ::synchronize();
      gmsh::model::setPhysicalName(3, gmsh::model::addPhysicalGroup(3, {pieces[0].second}), "soft part");
      gmsh::model::setPhysicalName(3, gmsh::model::addPhysicalGroup(3, {pieces[1].second}), "hard part");
      gmsh::vectorpair sides;
      gmsh::model::getEntitiesInBoundingBox(-1, -1, -1, 1, 11, 11, sides, 2);
      ASSERT_EQ(sides.size(), 1u);
      gmsh::model::setPhysicalName(2, gmsh::model::addPhysicalGroup(2, {sides[0].second}), "clamp");
      gmsh::option::setNumber("Mesh.MeshSizeMax", 5);
      gmsh::option::setNumber("Mesh.ElementOrder", order);
      gmsh::option::setNumber("Mesh.MshFileVersion", version);
      gmsh::option::setNumber("Mesh.Binary", binary);
      gmsh::model::mesh::generate(3);
      gmsh::write(file.path());
      gmsh::finalize();

      const Mesh mesh = read_msh(file.path(), 1e-3);
      EXPECT_EQ(mesh.shape, order == 1 ? ElementShape::tet4 : ElementShape::tet10);
      EXPECT_NEAR(total_measure(mesh, "soft part"), 3e-6, 1e-17);
      EXPECT_NEAR(total_measure(mesh, "hard part"), 2e-6, 1e-17);
      expect_conforming(mesh, 2e-4 + 4 * 5e-4);
      EXPECT_NEAR(size_of(mesh, mesh.select("clamp")), 1e-4, 1e-16);
      EXPECT_LT(facet_normal(mesh, mesh.select("clamp").entities.data())[0], 0.0);
      if (order == 2) expect_mid_nodes_halfway(mesh, 1e-15);
    }
  }
}
#endif

#if TAUT_TEST_WRITES_MSH
TEST(MshFile, GeometryIsMeshedWithItsSizesAndNames) {
  const TemporaryFile file(
      "SetFactory(\"OpenCASCADE\");\nRectangle(1) = {0, 0, 0, 40, 20};\nDisk(2) = {20, 10, 0, 5};\n"
      "BooleanDifference{ Surface{1}; Delete; }{ Surface{2}; Delete; }\nMesh.MeshSizeMax = 2;\n"
      "Physical Surface(\"plate\") = {1};\n",
      ".geo");
  const Mesh mesh = read_msh(file.path(), 1e-3, 2);
  EXPECT_EQ(mesh.dimension(), 2);
  // The hole is a polygon of chords of at most 2 mm.
  EXPECT_NEAR(total_measure(mesh, "plate"), 800e-6 - M_PI * 25e-6, 3e-6);
  EXPECT_GT(mesh.element_count(), 400);
  EXPECT_GE(mesh.tags.size(), 5u) << "curves that have no name are called by their numbers";
  EXPECT_TRUE(std::ranges::all_of(mesh.tags, [](const auto& tag) { return tag.first.starts_with("curve_"); }));
}

TEST(MshFile, StepFilesAndClosedSurfacesBecomeBodies) {
  const TemporaryFile step("", ".step"), stl("", ".stl");
  const TemporaryFile box(
      "SetFactory(\"OpenCASCADE\");\nBox(1) = {0, 0, 0, 30, 10, 10};\nMesh.MeshSizeMax = 5;\nMesh 2;\nSave \"" +
          step.path() + "\";\nSave \"" + stl.path() + "\";\nMesh 3;\nPhysical Volume(\"bar\") = {1};\n",
      ".geo");
  const Mesh drawn = read_msh(box.path(), 1e-3);
  EXPECT_NEAR(total_measure(drawn, "bar"), 3e-6, 1e-14);
  for (const TemporaryFile* file : {&step, &stl}) {
    const Mesh mesh = read_msh(file->path(), 1e-3);
    ASSERT_EQ(mesh.region_names.size(), 1u) << file->path();
    EXPECT_NEAR(total_measure(mesh, mesh.region_names[0]), 3e-6, 1e-13) << file->path();
    EXPECT_EQ(mesh.tags.size(), 6u) << file->path();
    double area = 0;
    for (const auto& [name, tag] : mesh.tags) area += size_of(mesh, mesh.select(name));
    EXPECT_NEAR(area, 1400e-6, 1e-10) << file->path();
  }
}

TEST(MshFile, WhatGmshCannotReadIsSaidWithThePath) {
  const TemporaryFile nonsense("Box(1 = {;", ".geo"), open(
                                                          "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n"
                                                          "vertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid a\n",
                                                          ".stl");
  for (const TemporaryFile* file : {&nonsense, &open})
    expect_input_error([&] { read_msh(file->path()); }, {file->path(), "Gmsh"});
}
#endif

TEST(MshFile, WrongFilesAreRefusedWithPathAndLine) {
  const auto read = [](const std::string& text) { return [text] { read_text(text); }; };
  expect_input_error([] { read_msh("/nowhere/finger.msh"); }, {"/nowhere/finger.msh", "cannot be read"});
  expect_input_error([] { read_text(square_22, 0.0); }, {"unit 0", "positive"});
  expect_input_error(read(""), {".msh:0", "no $MeshFormat"});
  expect_input_error(read("solid ascii\n"), {".msh:1:", "expected a section", "solid ascii"});
  expect_input_error(read("$Nodes\n0\n$EndNodes\n"), {".msh:1:", "before $MeshFormat"});
  expect_input_error(read(replaced(square_22, "2.2 0 8", "2.2 1 8")), {".msh: ", "Gmsh"});  // it is not binary
  expect_input_error(read(replaced(square_22, "2.2 0 8", "4 0 8")), {".msh: ", "Gmsh"});
  expect_input_error(read(replaced(square_22, "30 10 10 3", "30 10 1O 3")), {".msh:14:", "coordinate", "'1O'"});
  expect_input_error(read(replaced(square_22, "30 10 10 3", "30 10 nan 3")), {".msh:14:", "'nan'", "finite"});
  expect_input_error(read(replaced(square_22, "30 10 10 3", "30 10 10")),
                     {".msh:14:", "three coordinates", "30 10 10"});
  expect_input_error(read(replaced(square_22, "30 10 10 3", "2 10 10 3")), {".msh:14:", "node 2 occurs twice"});
  expect_input_error(read(replaced(square_22, "$Nodes\n5", "$Nodes\n4")), {".msh:16:", "$EndNodes", "9 50 50 99"});
  expect_input_error(read(replaced(square_22, "$Nodes\n5", "$Nodes\n-5")), {".msh:11:", "-5", "zero or more"});
  expect_input_error(read(replaced(square_22, "1 1 2 30\n", "1 1 2 31\n")), {".msh:23:", "element 4", "node 31"});
  expect_input_error(read(replaced(square_22, "1 1 2 30\n", "1 1 2\n")),
                     {".msh:23:", "element 4 has 2 nodes", "has 3"});
  expect_input_error(read(replaced(square_22, "4 2 2 7 1 1 2 30", "4 3 2 7 1 1 2 30 4")),
                     {".msh:23:", "element type 3 (quadrangle)", "triangles or tetrahedra"});
  expect_input_error(read(replaced(square_22, "4 2 2 7 1 1 2 30", "4 9 2 7 1 1 2 30 4 1 2")),
                     {"mixed element orders", "element 4"});
  expect_input_error(read(replaced(square_22, "4 2 2 7 1", "4 2 2 0 1")),
                     {".msh:23:", "element 4 is in no physical group", "Physical Surface"});
  expect_input_error(read(replaced(square_22, "5 2 2 8 2 1 4 30", "5 2 2 8 2 1 30 2")),
                     {".msh:24:", "element 5", "line 23", "one region only"});
  expect_input_error(read(replaced(square_22, "1 15 2 11 1 2", "1 15 2 11 1 9")),
                     {".msh:20:", "node 9", "physical_11", "no triangle"});
  expect_input_error(read(replaced(square_22, "2 1 2 5 4 1 4", "2 1 2 5 4 2 4")),
                     {"tag 'left edge'", "no side of any element"});
  expect_input_error(read(replaced(square_22, "6 1 2 6 1", "6 1 2 11 1")),
                     {".msh:25:", "dimensions 0 and 1", "'physical_11'", "rename"});
  expect_input_error(read(replaced(square_22, "2 10 0 3\n", "2 10 0 4\n")),
                     {"z varies by 1000 mm", "a node is at (10000, 0, 4000) mm", "surface in space"});
  expect_input_error(read(replaced(square_22, "30 10 10 3", "30 5 0 3")), {"element 0", "degenerate"});
  expect_input_error(read(replaced(square_22, "1 5 \"left edge\"", "1 5 left edge")), {".msh:6:", "double quotes"});
  expect_input_error(read(square_22.substr(0, square_22.find("$Elements"))), {"no $Elements section"});
  expect_input_error(read(square_22.substr(0, square_22.find("5 2 2 8"))), {".msh:23:", "file ends"});
  expect_input_error(read(replaced(square_22, "$EndElements\n", "$EndElements\n$Nodes\n")), {"second $Nodes"});
  expect_input_error(read(replaced(square_41, "$Entities", "$PartitionedEntities")), {".msh:10:", "partitioned"});
  expect_input_error(read(replaced(square_41, "3 1 7 3 1 2 3", "3 0 3 1 2 3")), {"element 4 is in no physical group"});
  expect_input_error(read(replaced(square_41, "3 1 7 3 1 2 3", "3 2 7 8 3 1 2 3")),
                     {"element 4", "'skin' and 'core'", "one region only"});
  expect_input_error(read(replaced(square_41, "3 1 7 3 1 2 3", "3 1")), {".msh:16:", "physical group", "missing"});
  expect_input_error(read(replaced(square_41, "$EndNodeData\n", "")), {"$EndNodeData"});
}

TEST(MshFile, WhatAGroupListsTwiceCountsOnce) {
  const std::string twice = replaced(replaced(square_22, "$Elements\n6", "$Elements\n7"), "2 1 2 5 4 1 4\n",
                                     "2 1 2 5 4 1 4\n7 1 2 5 4 4 1\n");
  const Mesh once = read_text(square_22), mesh = read_text(twice);
  EXPECT_EQ(mesh.tags.at("left edge").count(), once.tags.at("left edge").count());
  EXPECT_NEAR(size_of(mesh, mesh.tags.at("left edge")), 10, 1e-12);
  EXPECT_EQ(count_of(mesh, "'left edge' lists 1 of its entities twice; each counts once"), 1) << all_of(mesh);
  EXPECT_EQ(count_of(once, "twice"), 0) << all_of(once);
}

TEST(MshFile, AnElementListedTwiceInOneRegionCountsOnce) {
  const Mesh mesh = read_text(replaced(replaced(square_22, "$Elements\n6", "$Elements\n7"), "5 2 2 8 2 1 4 30\n",
                                       "5 2 2 8 2 1 4 30\n7 2 2 8 2 4 30 1\n"));
  EXPECT_NEAR(total_measure(mesh), 100, 1e-12);
  EXPECT_EQ(count_of(mesh, "1 element is listed twice; each counts once"), 1) << all_of(mesh);
}

TEST(MshFile, WhatIsLeftOutOrTurnedIsSaid) {
  const Mesh mesh = read_text(square_22, 1e-3);
  EXPECT_EQ(mesh.remarks.size(), 2u) << all_of(mesh);
  EXPECT_EQ(count_of(mesh, "1 node is in no triangle, at (50, 50) mm; left out"), 1) << all_of(mesh);
  EXPECT_EQ(count_of(mesh, "1 of 2 elements list their nodes the other way round; turned"), 1) << all_of(mesh);
  // All of one orientation, whichever it is, is nothing to speak of.
  std::string text = replaced(replaced(square_22, "$Nodes\n5", "$Nodes\n4"), "9 50 50 99\n", "");
  const std::string clockwise = replaced(text, "4 2 2 7 1 1 2 30\n", "4 2 2 7 1 2 1 30\n");
  EXPECT_TRUE(read_text(clockwise).remarks.empty()) << all_of(read_text(clockwise));
  text = replaced(text, "5 2 2 8 2 1 4 30\n", "5 2 2 8 2 4 1 30\n");
  EXPECT_TRUE(read_text(text).remarks.empty()) << all_of(read_text(text));
}

#if TAUT_HAS_GMSH
TEST(MshFile, WhatIsWrongWithAGeometryNamesNoLineOfAMeshThatNobodyHas) {
  const TemporaryFile file(
      "Point(1) = {0, 0, 0, 1}; Point(2) = {1, 0, 0, 1}; Point(3) = {0, 1, 1, 1};\n"
      "Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 1};\nCurve Loop(1) = {1, 2, 3}; Plane Surface(1) = {1};\n",
      ".geo");
  expect_input_error([&] { read_msh(file.path(), 1, 2); }, {file.path() + ": as a mesh: triangles only, but z varies"});
}

TEST(MshFile, AFilesChordsAreSaidWhereTheyBecomeQuadraticAndNotWhereTheyAreCurves) {
  const std::string disc =
      "SetFactory(\"OpenCASCADE\");\nDisk(1) = {0, 0, 0, 1};\nMesh.MeshSizeMax = 0.57;\nMesh.MeshSizeMin = 0.57;\n";
  const auto mesh_of = [](const std::string& path) {
    MeshFile shape;
    shape.file.path = path;
    shape.unit.metres = 1;
    shape.axes = 2;
    MeshSettings settings;
    settings.order = 2;
    return shape.mesh(settings, false, false);
  };
  const TemporaryFile straight(disc, ".geo"), curved(disc + "Mesh.ElementOrder = 2;\n", ".geo");
  const Mesh chords = mesh_of(straight.path()), arcs = mesh_of(curved.path());
  EXPECT_EQ(count_of(chords, "chords of a curve"), 1) << all_of(chords);
  EXPECT_EQ(count_of(arcs, "chords of a curve"), 0) << all_of(arcs);
  const auto rim = [](const Mesh& mesh) {  // the mid-nodes of the outline
    double least = 1;
    const Tag outline = boundary(mesh);
    for (int i = 0; i < outline.count(); ++i) least = std::min(least, mesh.node(outline.entity(i)[2]).norm());
    return least;
  };
  EXPECT_NEAR(rim(arcs), 1, 1e-3);
  EXPECT_LT(rim(chords), 0.97);
}

TEST(MshFile, WhatAGeometryTakesInIsKnownByItsPlaceBesideIt) {
  namespace fs = std::filesystem;
  const fs::path folder = fs::path(testing::TempDir()) / "taut_taken_in";
  fs::create_directories(folder / "parts");
  const auto write = [&](const std::string& name, const std::string& text) { std::ofstream(folder / name) << text; };
  write("plate.geo",
        "// Merge \"never.step\";\nMerge \"parts/a.geo\"; /* Include \"no.geo\" */\nv() = ShapeFromFile(\"b.step\");\n"
        "Mesh.Merge = 1; Printf(\"Merge \\n\");\nMerge \"missing.stl\";\n");
  write("parts/a.geo", "Include \"sizes.geo\"\nMerge \"../b.step\";\n");
  write("parts/sizes.geo", "h = 1;\n");
  write("b.step", "");
  EXPECT_EQ(merged_files((folder / "plate.geo").string()),
            (std::vector<std::string>{"parts/a.geo", "parts/sizes.geo", "b.step"}));
  EXPECT_TRUE(merged_files((folder / "b.step").string()).empty());
  write("computed.geo", "h = 1;\nMerge StrCat(\"b\", \".step\");\n");
  expect_input_error([&] { merged_files((folder / "computed.geo").string()); }, {"computed.geo:2:", "computed"});
  fs::remove_all(folder);
}
#endif

}  // namespace
}  // namespace taut
