#include "sim/shapes/shape.hpp"

#include <gtest/gtest.h>

#include <set>

#include "sim/shapes/geometry.hpp"
#include "sim/shapes/grid.hpp"
#include "sim/shapes/push_puppet.hpp"
#include "tests/support/message.hpp"

namespace taut {
namespace {

using namespace test;

TEST(Shapes, EveryKindIsMadeByItsNameWithATableThatExplainsEachKeyOnce) {
  EXPECT_EQ(shape_kinds().size(), 12u);
  for (const std::string& kind : shape_kinds()) {
    const std::unique_ptr<Shape> shape = make_shape(kind);
    EXPECT_EQ(shape->kind(), kind);
    std::set<std::string_view> keys{"kind"};
    for (const ShapeKey& key : shape->keys()) {
      EXPECT_TRUE(keys.insert(key.key).second) << kind << " " << key.key;
      EXPECT_NE(key.meaning, "") << kind << " " << key.key;
    }
    for (const MeshKey& key : shape->mesh_keys()) EXPECT_NE(key.meaning, "") << kind << " " << key.key;
    EXPECT_NO_THROW(shape->check()) << kind << ": what may be left out has a default";
  }
  expect_input_error([] { make_shape("discs"); }, {"'discs'", "did you mean 'disc'", "push_puppet"});
}

TEST(Shapes, ACloneHasDimensionsOfItsOwn) {
  for (const std::string& kind : shape_kinds()) {
    const std::unique_ptr<Shape> shape = make_shape(kind), other = shape->clone();
    const std::vector<ShapeKey> own = shape->keys(), cloned = other->keys();
    for (size_t k = 0; k < own.size(); ++k) EXPECT_NE(own[k].value, cloned[k].value) << kind << " " << own[k].key;
  }
}

TEST(Shapes, OwnCablesHaveNamesAndPoints) {
  for (const std::string& kind : shape_kinds()) {
    GeometrySettings geometry;
    geometry.shape = make_shape(kind);
    for (const std::string& name : geometry.shape->cable_names()) {
      const std::vector<Eigen::VectorXd> points = own_cable(geometry, name);
      ASSERT_GE(points.size(), 2u) << kind << " " << name;
      EXPECT_EQ(points[0].size(), geometry.shape->dimension()) << kind << " " << name;
    }
    if (geometry.shape->cable_names().empty())
      expect_input_error([&] { own_cable(geometry, "cable"); }, {kind, "no cables of its own"});
  }
}

TEST(Shapes, ChangedSettingsLeaveTheirCopiesAsTheyAre) {
  GeometrySettings geometry;
  geometry.shape = make_shape("push_puppet");
  const GeometrySettings before = geometry;
  geometry.edit<PushPuppet>().cells = 7;
  EXPECT_EQ(geometry.as<PushPuppet>().cells, 7);
  EXPECT_EQ(before.as<PushPuppet>().cells, 4);
  EXPECT_THROW(geometry.as<Rectangle>(), std::bad_cast);
}

TEST(Shapes, AMeshFileMayBeTakenFromAnotherPlaceAndIsTheOnlyOneWithoutMeshSettings) {
  for (const std::string& kind : shape_kinds()) {
    GeometrySettings geometry;
    geometry.shape = make_shape(kind);
    EXPECT_EQ(refinable(geometry), kind != "msh") << kind;
    set_input_file(geometry, "elsewhere.msh");
    EXPECT_EQ(input_file(geometry), kind == "msh" ? "elsewhere.msh" : "") << kind;
  }
}

TEST(Shapes, SpinesRunBetweenTagsOfTheMeshOverSpansOfFoam) {
  Rectangle rectangle;
  rectangle.size = {0.06, 0.01};
  rectangle.origin = {0.02, 0.03};
  rectangle.region = "foam";
  const PushPuppet module;
  MeshSettings settings;
  settings.cells = {6, 2};
  settings.size = 3e-3;
  EXPECT_EQ(rectangle.spines().size(), 4u) << "each side may be clamped";
  EXPECT_EQ(module.spines().size(), 1u);
  for (const Shape* shape : {static_cast<const Shape*>(&rectangle), static_cast<const Shape*>(&module)}) {
    const Mesh mesh = shape->mesh(settings, false, false);
    for (const Spine& spine : shape->spines()) {
      for (int node : mesh.select(spine.loaded).entities)
        EXPECT_NEAR((mesh.node(node) - spine.origin).dot(spine.along), spine.end, 1e-12) << spine.loaded;
      const Spine::Span& last = spine.spans.back();
      EXPECT_LE(last.begin + last.length, spine.end);
      EXPECT_GT(mesh.select(spine.clamped).count(), 0);
    }
  }
}

}  // namespace
}  // namespace taut
