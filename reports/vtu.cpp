#include "reports/vtu.hpp"

#include <fmt/format.h>

#include <filesystem>
#include <stdexcept>

#include "calib/data/files.hpp"
#include "reports/html.hpp"

namespace taut {
namespace {

/// VTK's number for a shape. Its node order for quadratic simplices is that of Mesh.
int vtk_cell_type(ElementShape shape) {
  switch (shape) {
    case ElementShape::tri3:
      return 5;
    case ElementShape::tri6:
      return 22;
    case ElementShape::tet4:
      return 10;
    case ElementShape::tet10:
      return 24;
  }
  throw std::logic_error("vtu_text: unknown element shape");
}

/// VTK points and vectors have three components always.
std::string vectors(const Eigen::VectorXd& values, int dimension) {
  std::string text;
  for (Eigen::Index i = 0; i + dimension <= values.size(); i += dimension) {
    text += fmt::format("{} {} {}\n", values[i], values[i + 1], dimension == 3 ? values[i + 2] : 0.0);
  }
  return text;
}

}  // namespace

std::string vtu_text(const Mesh& mesh, const Eigen::VectorXd& u) {
  if (u.size() != mesh.X.size()) {
    throw std::logic_error(fmt::format("vtu_text: {} displacements for {} coordinates", u.size(), mesh.X.size()));
  }
  std::string connectivity, offsets, types, regions;
  for (int e = 0; e < mesh.element_count(); ++e) {
    for (int i = 0; i < mesh.nodes_per_element(); ++i) {
      connectivity += fmt::format("{}{}", i == 0 ? "" : " ", mesh.element(e)[i]);
    }
    connectivity += '\n';
    offsets += fmt::format("{}\n", (e + 1) * mesh.nodes_per_element());
    types += fmt::format("{}\n", vtk_cell_type(mesh.shape));
    regions += fmt::format("{}\n", mesh.region[static_cast<size_t>(e)]);
  }
  std::string names;
  for (size_t i = 0; i < mesh.region_names.size(); ++i) {
    names += fmt::format("{}{} = {}", i == 0 ? "" : ", ", i, mesh.region_names[i]);
  }
  for (size_t dash = names.find("--"); dash != std::string::npos; dash = names.find("--")) names.replace(dash, 2, "-");

  const auto array = [](const char* type, const char* attributes, const std::string& numbers) {
    return fmt::format("<DataArray type=\"{}\" {} format=\"ascii\">\n{}</DataArray>\n", type, attributes, numbers);
  };
  return fmt::format(
             "<?xml version=\"1.0\"?>\n<!-- lengths in metres; regions: {} -->\n"
             "<VTKFile type=\"UnstructuredGrid\" version=\"0.1\" byte_order=\"LittleEndian\">\n<UnstructuredGrid>\n"
             "<Piece NumberOfPoints=\"{}\" NumberOfCells=\"{}\">\n",
             html::escaped(names), mesh.node_count(), mesh.element_count()) +
         "<PointData Vectors=\"displacement\">\n" +
         array("Float64", "Name=\"displacement\" NumberOfComponents=\"3\"", vectors(u, mesh.dimension())) +
         "</PointData>\n<CellData Scalars=\"region\">\n" + array("Int32", "Name=\"region\"", regions) +
         "</CellData>\n<Points>\n" +
         array("Float64", "Name=\"position\" NumberOfComponents=\"3\"", vectors(mesh.X, mesh.dimension())) +
         "</Points>\n<Cells>\n" + array("Int32", "Name=\"connectivity\"", connectivity) +
         array("Int32", "Name=\"offsets\"", offsets) + array("UInt8", "Name=\"types\"", types) +
         "</Cells>\n</Piece>\n</UnstructuredGrid>\n</VTKFile>\n";
}

std::string pvd_text(const std::vector<std::pair<double, std::string>>& files) {
  std::string text =
      "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"0.1\" byte_order=\"LittleEndian\">\n"
      "<Collection>\n";
  for (const auto& [time, file] : files) {
    text += fmt::format("<DataSet timestep=\"{}\" part=\"0\" file=\"{}\"/>\n", time, html::escaped(file));
  }
  return text + "</Collection>\n</VTKFile>\n";
}

std::string write_states(const SolvedStates& states, const std::string& folder) {
  if (states.mesh == nullptr) return "";
  const std::filesystem::path root = std::filesystem::path(folder) / "states";
  std::vector<std::pair<double, std::string>> files;
  for (const SolvedState& state : states.states) {
    const std::string file = fmt::format("state_{:03}.vtu", files.size());
    write_file((root / file).string(), vtu_text(*states.mesh, state.u));
    files.emplace_back(static_cast<double>(files.size()), file);
  }
  const std::string collection = (root / "states.pvd").string();
  write_file(collection, pvd_text(files));
  return collection;
}

}  // namespace taut
