#include "reports/vtu.hpp"

#include <gtest/gtest.h>

#include <sstream>

#include "sim/mesh/mesh.hpp"

namespace taut {
namespace {

/// Numbers of the DataArray called `name`.
std::vector<double> array_of(const std::string& vtu, const std::string& name) {
  const size_t at = vtu.find("Name=\"" + name + "\"");
  if (at == std::string::npos) return {};
  const size_t begin = vtu.find('>', at) + 1;
  std::istringstream text(vtu.substr(begin, vtu.find('<', begin) - begin));
  std::vector<double> values;
  for (double value = 0; text >> value;) values.push_back(value);
  return values;
}

/// One element with edge mid-nodes if `quadratic`.
Mesh one_element(int dimension, bool quadratic) {
  Mesh mesh;
  mesh.region = {0};
  mesh.region_names = {"foam <soft>"};
  if (dimension == 2) {
    mesh.shape = ElementShape::tri3;
    mesh.X.resize(6);
    mesh.X << 0, 0, 0.1, 0, 0, 0.3;
    mesh.elements = {0, 1, 2};
  } else {
    mesh.shape = ElementShape::tet4;
    mesh.X.resize(12);
    mesh.X << 0, 0, 0, 0.1, 0, 0, 0, 0.2, 0, 0, 0, 1.0 / 3;
    mesh.elements = {0, 1, 2, 3};
  }
  return quadratic ? to_quadratic(mesh) : mesh;
}

TEST(Vtu, NumbersReadBackAsTheyWere) {
  for (const int dimension : {2, 3}) {
    for (const bool quadratic : {false, true}) {
      const Mesh mesh = one_element(dimension, quadratic);
      const Eigen::VectorXd u = Eigen::VectorXd::LinSpaced(mesh.X.size(), -1.0 / 3, 1e-9);
      const std::string text = vtu_text(mesh, u);
      const std::vector<double> positions = array_of(text, "position"), displacements = array_of(text, "displacement");
      ASSERT_EQ(positions.size(), static_cast<size_t>(3 * mesh.node_count()));
      ASSERT_EQ(displacements.size(), positions.size());
      for (int i = 0; i < mesh.node_count(); ++i) {
        for (int c = 0; c < 3; ++c) {
          const auto k = static_cast<size_t>(3 * i + c);
          EXPECT_EQ(positions[k], c < dimension ? mesh.X[i * dimension + c] : 0.0);
          EXPECT_EQ(displacements[k], c < dimension ? u[i * dimension + c] : 0.0);
        }
      }
      const std::vector<double> connectivity = array_of(text, "connectivity");
      EXPECT_EQ(std::vector<int>(connectivity.begin(), connectivity.end()), mesh.elements);
      EXPECT_EQ(array_of(text, "offsets"), std::vector<double>{static_cast<double>(mesh.nodes_per_element())});
      EXPECT_EQ(array_of(text, "region"), std::vector<double>{0});
      EXPECT_NE(text.find("NumberOfPoints=\"" + std::to_string(mesh.node_count()) + "\" NumberOfCells=\"1\""),
                std::string::npos);
    }
  }
}

TEST(Vtu, CellTypesAreThoseOfVtk) {
  const auto type = [](int dimension, bool quadratic) {
    const Mesh mesh = one_element(dimension, quadratic);
    return array_of(vtu_text(mesh, Eigen::VectorXd::Zero(mesh.X.size())), "types");
  };
  EXPECT_EQ(type(2, false), std::vector<double>{5});
  EXPECT_EQ(type(2, true), std::vector<double>{22});
  EXPECT_EQ(type(3, false), std::vector<double>{10});
  EXPECT_EQ(type(3, true), std::vector<double>{24});
}

TEST(Vtu, MidNodesComeInVtksOrder) {
  // vtkQuadraticTriangle: mid-nodes of (0,1) (1,2) (2,0); vtkQuadraticTetra: (0,1) (1,2) (2,0) (0,3) (1,3) (2,3)
  const int edges[6][2] = {{0, 1}, {1, 2}, {2, 0}, {0, 3}, {1, 3}, {2, 3}};
  for (const int dimension : {2, 3}) {
    const Mesh mesh = one_element(dimension, true);
    const std::string text = vtu_text(mesh, Eigen::VectorXd::Zero(mesh.X.size()));
    const std::vector<double> x = array_of(text, "position"), nodes = array_of(text, "connectivity");
    const size_t vertices = static_cast<size_t>(dimension) + 1;
    ASSERT_EQ(nodes.size(), dimension == 2 ? 6u : 10u);
    for (size_t e = 0; e + vertices < nodes.size(); ++e) {
      for (size_t c = 0; c < 3; ++c) {
        const auto at = [&](size_t i) { return x[3 * static_cast<size_t>(nodes[i]) + c]; };
        EXPECT_DOUBLE_EQ(at(vertices + e),
                         (at(static_cast<size_t>(edges[e][0])) + at(static_cast<size_t>(edges[e][1]))) / 2);
      }
    }
  }
}

TEST(Vtu, RegionNamesAreEscaped) {
  const Mesh mesh = one_element(2, false);
  const std::string text = vtu_text(mesh, Eigen::VectorXd::Zero(6));
  EXPECT_NE(text.find("0 = foam &lt;soft&gt;"), std::string::npos);
}

TEST(Vtu, ADisplacementOfAnotherMeshIsAProgrammingError) {
  EXPECT_THROW(vtu_text(one_element(2, false), Eigen::VectorXd::Zero(8)), std::logic_error);
}

TEST(Pvd, ListsTimesAndFiles) {
  const std::string text = pvd_text({{0, "a.vtu"}, {0.1, "b&c.vtu"}});
  EXPECT_NE(text.find("<DataSet timestep=\"0\" part=\"0\" file=\"a.vtu\"/>"), std::string::npos);
  EXPECT_NE(text.find("<DataSet timestep=\"0.1\" part=\"0\" file=\"b&amp;c.vtu\"/>"), std::string::npos);
  EXPECT_NE(text.find("type=\"Collection\""), std::string::npos);
}

}  // namespace
}  // namespace taut
