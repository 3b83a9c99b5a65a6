#include "calib/runs/shapes.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>

#include "sim/mesh/loops.hpp"
#include "sim/scene/contact_force.hpp"

namespace taut {
namespace {

/// Lines to draw, with the number of facets that have them: in 2D the boundary, in 3D the edges of the faces that look
/// at the viewer (an edge between two of them is inside).
std::map<std::array<int, 2>, int> visible_lines(const Mesh& mesh, const std::array<int, 2>& plane) {
  const int d = mesh.dimension();
  const Tag facets = boundary(mesh);
  std::map<std::array<int, 2>, int> uses;
  const auto add = [&](int one, int two) { ++uses[{std::min(one, two), std::max(one, two)}]; };
  for (int f = 0; f < facets.count(); ++f) {
    const int* node = facets.entities.data() + static_cast<size_t>(f) * facets.nodes_per_entity;
    if (d == 3) {
      const Eigen::Vector3d a = mesh.node(node[1]) - mesh.node(node[0]), b = mesh.node(node[2]) - mesh.node(node[0]);
      if (a.cross(b).normalized()[3 - plane[0] - plane[1]] > -0.7) continue;
    }
    for (int c = 0; c < (d == 2 ? 1 : 3); ++c) {
      const int from = node[c], to = node[(c + 1) % d], mid = facets.nodes_per_entity > d ? node[d + c] : -1;
      if (mid >= 0) add(mid, to);
      add(from, mid >= 0 ? mid : to);
    }
  }
  return uses;
}

/// To a nanometre: finer digits would only fill the file.
double rounded(double metres) {
  return std::round(1e9 * metres) / 1e9;
}

/// A surface in space is shown, not measured: a tenth of a micrometre is far below what is seen of it.
double roughly(double metres) {
  return std::round(1e7 * metres) / 1e7;
}

Eigen::VectorXd place_of(const CablePoint& point, const Eigen::VectorXd& x, int d) {
  if (point.material.nodes.empty()) return point.fixed;
  Eigen::VectorXd at = Eigen::VectorXd::Zero(d);
  for (size_t i = 0; i < point.material.nodes.size(); ++i)
    at += point.material.weights[i] * x.segment(static_cast<Eigen::Index>(point.material.nodes[i]) * d, d);
  return at;
}

/// Draws one state after the other.
class Drawing {
 public:
  explicit Drawing(const SolvedStates& states)
      : states_(states), mesh_(*states.mesh), plane_(drawing_plane(states)), lines_(visible_lines(mesh_, plane_)) {
    for (size_t r = 0; mesh_.dimension() == 2 && r < mesh_.region_names.size(); ++r)
      outlines_.push_back(region_loops(mesh_, static_cast<int>(r)));
    if (mesh_.dimension() == 3) surface_ = boundary_surface(mesh_);
  }

  ShapeRecord draw(const SolvedState& state) const {
    ShapeRecord shape{.label = state.label, .segments = {}, .row = state.row, .column = state.column};
    const int d = mesh_.dimension();
    const Eigen::VectorXd x = mesh_.X + state.u;
    for (const auto& [line, count] : lines_) {
      if (count > 1) continue;
      const Eigen::Index a = static_cast<Eigen::Index>(line[0]) * d, b = static_cast<Eigen::Index>(line[1]) * d;
      shape.segments.push_back({x[a + plane_[0]], x[a + plane_[1]], x[b + plane_[0]], x[b + plane_[1]]});
    }
    if (d == 2) add_areas_and_cables(x, shape);
    if (d == 3) add_surface_and_cables(x, shape);
    if (state.contact.size() > 0) add_contacts(state, x, shape);
    return shape;
  }

 private:
  void add_areas_and_cables(const Eigen::VectorXd& x, ShapeRecord& shape) const {
    for (size_t r = 0; r < outlines_.size(); ++r) {
      ShapeRecord::Area& area = shape.areas.emplace_back(mesh_.region_names[r]);
      for (const std::vector<int>& loop : outlines_[r]) {
        ShapeRecord::Line& line = area.loops.emplace_back();
        for (int node : loop) line.push_back({rounded(x[2 * node]), rounded(x[2 * node + 1])});
      }
    }
    for (const Cable& cable : states_.cables) {
      ShapeRecord::Line& line = shape.cables.emplace_back();
      for (const CablePoint& point : cable.points) {
        const Eigen::VectorXd at = place_of(point, x, 2);
        line.push_back({rounded(at[0]), rounded(at[1])});
      }
    }
  }
  void add_surface_and_cables(const Eigen::VectorXd& x, ShapeRecord& shape) const {
    for (const int node : surface_.nodes) {
      for (const double value : x.segment<3>(3 * static_cast<Eigen::Index>(node)))
        shape.points.push_back(roughly(value));
    }
    for (const Cable& cable : states_.cables) {
      std::vector<double>& line = shape.space_cables.emplace_back();
      for (const CablePoint& point : cable.points) {
        for (const double value : place_of(point, x, 3)) line.push_back(roughly(value));
      }
    }
  }
  void add_contacts(const SolvedState& state, const Eigen::VectorXd& x, ShapeRecord& shape) const {
    const int d = mesh_.dimension();
    for (const ContactPatch& patch : contact_patches(mesh_, state.u, state.contact)) {
      ContactRecord& contact = shape.contacts.emplace_back();
      for (const double value : patch.centre) contact.centre.push_back(roughly(value));
      contact.force.assign(patch.force.begin(), patch.force.end());
      for (const int node : patch.nodes) {
        for (const double value : x.segment(static_cast<Eigen::Index>(node) * d, d))
          contact.places.push_back(roughly(value));
      }
    }
  }

  const SolvedStates& states_;
  const Mesh& mesh_;
  std::array<int, 2> plane_;
  std::map<std::array<int, 2>, int> lines_;
  std::vector<std::vector<std::vector<int>>> outlines_;  ///< of each region, in 2D
  BoundarySurface surface_;                              ///< in 3D
};

}  // namespace

std::array<int, 2> drawing_plane(const SolvedStates& states) {
  const Mesh& mesh = *states.mesh;
  const int d = mesh.dimension();
  if (d == 2) return {0, 1};
  int vertical = d - 1, horizontal = 0;
  for (int i = 0; i < d && !states.down.empty(); ++i) {
    if (std::abs(states.down[static_cast<size_t>(i)]) > std::abs(states.down[static_cast<size_t>(vertical)]))
      vertical = i;
  }
  const auto nodes = mesh.X.reshaped(d, mesh.node_count());
  Eigen::VectorXd size = nodes.rowwise().maxCoeff() - nodes.rowwise().minCoeff();
  size[vertical] = -1;
  size.maxCoeff(&horizontal);
  return {horizontal, vertical};
}

SurfaceRecord surface_record(const Mesh& mesh) {
  SurfaceRecord record;
  if (mesh.dimension() == 2) return record;
  record.regions = mesh.region_names;
  for (const auto& [region, points] : boundary_surface(mesh).triangles) {
    record.triangles.insert(record.triangles.end(), points.begin(), points.end());
    record.triangle_regions.push_back(region);
  }
  return record;
}

std::vector<ShapeRecord> draw_shapes(const SolvedStates& states) {
  if (states.mesh == nullptr) return {};
  const Drawing drawing(states);
  std::vector<ShapeRecord> shapes{drawing.draw({"rest", "", "", Eigen::VectorXd::Zero(states.mesh->X.size())})};
  for (const SolvedState& state : states.states) shapes.push_back(drawing.draw(state));
  return shapes;
}

}  // namespace taut
