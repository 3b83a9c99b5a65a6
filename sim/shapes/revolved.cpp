#include "sim/shapes/revolved.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "sim/core/error.hpp"
#include "sim/mesh/extrude.hpp"
#include "sim/mesh/mesh_budget.hpp"
#include "sim/mesh/structured.hpp"
#include "sim/mesh/topology.hpp"

namespace taut {
namespace {

constexpr std::array<std::string_view, 6> ways{"x", "-x", "y", "-y", "z", "-z"};

double interpolated(const std::vector<double>& s, const std::vector<double>& values, double at) {
  if (values.size() == 1) return values[0];
  const auto after = std::upper_bound(s.begin() + 1, s.end() - 1, at);
  const auto k = static_cast<size_t>(after - s.begin());
  return values[k - 1] + (at - s[k - 1]) / (s[k] - s[k - 1]) * (values[k] - values[k - 1]);
}

/// Nodes on each ring of a section, from the axis or the bore (which is ring 0) to the rim. Around a bore there are
/// twice as many per ring as on the rim of a solid section, since a thin wall has few rings.
int nodes_on(bool hollow, int rings, int ring) {
  return hollow ? 12 * rings : ring == 0 ? 1 : 6 * ring;
}

/// A section in triangles: ring k of `rings` is at radius k / rings, with a bore at 1 + k / rings. Tags "rim", "bore".
Mesh section_mesh(bool hollow, int rings, const std::string& region) {
  Mesh mesh;
  mesh.shape = ElementShape::tri3;
  mesh.region_names = {region};
  std::vector<int> first;
  std::vector<double> X;
  for (int ring = 0; ring <= rings; ++ring) {
    first.push_back(static_cast<int>(X.size()) / 2);
    const double radius = (hollow ? 1.0 : 0.0) + static_cast<double>(ring) / rings;
    const int count = nodes_on(hollow, rings, ring);
    for (int i = 0; i < count; ++i) {
      const double angle = 2 * std::numbers::pi * i / count;
      X.push_back(radius * std::cos(angle));
      X.push_back(radius * std::sin(angle));
    }
  }
  mesh.X = Eigen::Map<const Eigen::VectorXd>(X.data(), static_cast<Eigen::Index>(X.size()));
  const auto node = [&](int ring, int i) { return first[ring] + i % nodes_on(hollow, rings, ring); };
  for (int ring = 0; ring < rings; ++ring) {
    // Around once, one step on the inner or the outer ring a time, whichever is behind.
    const int inner = nodes_on(hollow, rings, ring), outer = nodes_on(hollow, rings, ring + 1);
    const int inner_steps = inner == 1 ? 0 : inner;
    for (int i = 0, o = 0; i < inner_steps || o < outer;) {
      const int a = node(ring, i), b = node(ring + 1, o);
      if (i == inner_steps || (o < outer && (2 * o + 1) * inner <= (2 * i + 1) * outer)) {
        mesh.elements.insert(mesh.elements.end(), {a, b, node(ring + 1, ++o)});
      } else {
        mesh.elements.insert(mesh.elements.end(), {a, b, node(ring, ++i)});
      }
    }
  }
  mesh.region.assign(static_cast<size_t>(mesh.element_count()), 0);
  const auto tag = [&](const char* name, int ring) {
    Tag& line = mesh.tags[name] = {1, 2, {}};
    for (int i = 0; i < nodes_on(hollow, rings, ring); ++i)
      line.entities.insert(line.entities.end(), {node(ring, i), node(ring, i + 1)});
  };
  tag("rim", rings);
  if (hollow) tag("bore", 0);
  return mesh;
}

/// Puts mid-nodes at the mean distance of their edge's ends from the axis, in the direction in which they are: those of
/// the rim, and in a wall, which may be thinner than the arcs are high, all of them.
void round_off(Mesh& mesh, const BodyAxis& axis, bool everywhere) {
  std::vector<bool> on_rim(static_cast<size_t>(mesh.node_count()), everywhere);
  for (int node : mesh.tags.at("side").nodes()) on_rim[static_cast<size_t>(node)] = true;
  const auto across = [&](const Eigen::Vector3d& x) -> Eigen::Vector3d { return x - axis.along.dot(x) * axis.along; };
  const auto edges = edges_of(mesh.shape);
  for (int e = 0; e < mesh.element_count(); ++e) {
    const int* nodes = mesh.element(e);
    for (size_t k = 0; k < edges.size(); ++k) {
      const int a = nodes[edges[k][0]], b = nodes[edges[k][1]];
      if (!on_rim[static_cast<size_t>(a)] || !on_rim[static_cast<size_t>(b)]) continue;
      const Eigen::Vector3d from = mesh.node(a), to = mesh.node(b), middle = across(0.5 * (from + to));
      const double distance = 0.5 * (across(from).norm() + across(to).norm());
      mesh.X.segment<3>(3 * nodes[4 + k]) = 0.5 * (from + to) + (distance / middle.norm() - 1) * middle;
    }
  }
}

/// Boundaries of layers: at each of the outline's points, and between them in proportion to the lengths.
std::vector<double> layer_boundaries(const std::vector<double>& s, int layers) {
  std::vector<double> levels{0.0};
  for (size_t k = 1; k < s.size(); ++k) {
    const double share = layers * (s[k] - s[k - 1]) / s.back();
    step_to(levels, s[k], static_cast<int>(std::clamp(std::round(share), 1.0, 1e9)));
  }
  return levels;
}

}  // namespace

double Revolved::radius_at(double at) const {
  return interpolated(s.values, radius.values, at);
}

double Revolved::bore_at(double at) const {
  return hollow() ? interpolated(s.values, bore.values, at) : 0;
}

std::vector<ShapeKey> Revolved::keys() {
  const Allowed positive = Allowed::positive();
  return {{"s", &s, Allowed::zero_or_more(), "places along the axis, from 0 on", Quantity::length, true},
          {"radius", &radius, positive, "of the outline at these places", Quantity::length, true},
          {"bore", &bore, positive, "inner radius at these places, or one of all"},
          {"axis", &along, Allowed::any(), "x, -x, y, -y, z or -z", Quantity::pure},
          {"region", &region, Allowed::any(), "name of its material", Quantity::pure, true}};
}

void Revolved::check() const {
  const auto fail = [](const std::string& what) { throw InputError("revolved: " + what); };
  const size_t count = s.values.size();
  if (count < 2) fail(fmt::format("s has {} of at least 2 places; give those of both ends", count));
  if (s.values[0] != 0) fail(fmt::format("s begins at {}; the first place is 0", in_mm(s.values[0])));
  for (size_t k = 1; k < count; ++k) {
    if (!(s.values[k] > s.values[k - 1]) || !std::isfinite(s.values[k])) {
      fail(fmt::format("s goes from {} to {}; places must increase", in_mm(s.values[k - 1]), in_mm(s.values[k])));
    }
  }
  if (radius.values.size() != count)
    fail(fmt::format("{} radii for {} places in s; give one each", radius.values.size(), count));
  if (hollow() && bore.values.size() != 1 && bore.values.size() != count)
    fail(fmt::format("{} bores for {} places in s; give one each, or one of all", bore.values.size(), count));
  for (size_t k = 0; k < count; ++k) {
    const double outer = radius.values[k];
    if (!Allowed::positive().holds(outer))
      fail(fmt::format("radius is {}; it must be positive, a point has no section", in_mm(outer)));
    if (!hollow()) continue;
    const double inner = bore.values.size() == 1 ? bore.values[0] : bore.values[k];
    if (!Allowed::positive().holds(inner))
      fail(fmt::format("bore is {}; it must be positive everywhere, or left out of a solid body", in_mm(inner)));
    if (!(inner < outer))
      fail(fmt::format("bore {} has to be below radius {} at s = {}", in_mm(inner), in_mm(outer), in_mm(s.values[k])));
  }
  if (std::find(ways.begin(), ways.end(), along) == ways.end())
    fail(fmt::format("axis '{}'; allowed: {}", along, join({ways.begin(), ways.end()})));
}

std::vector<MeshKey> Revolved::mesh_keys() const {
  const int as_long_as_wide = static_cast<int>(std::clamp(std::round(length() / radius_at(0.5 * length())), 1.0, 1e9));
  return {{MeshKey::count, "layers", "along the axis; unless given, about as long as the radius", as_long_as_wide},
          {MeshKey::count, "rings", hollow() ? "from bore to rim" : "from axis to rim", hollow() ? 1 : 2}};
}

Mesh Revolved::mesh(const MeshSettings& settings, bool, bool) const {
  check();
  check_counts("revolved", settings);
  if (settings.order != 1 && settings.order != 2)
    throw InputError(fmt::format("revolved: element order {}; 1 and 2 are allowed", settings.order));
  const int rings = count(settings, "rings");
  require_mesh((hollow() ? 72.0 : 18.0) * count(settings, "layers") * rings * rings, 3, settings.order);
  const std::vector<double> levels = layer_boundaries(s.values, count(settings, "layers"));
  const int layers = static_cast<int>(levels.size()) - 1;
  Mesh mesh = extrude(section_mesh(hollow(), rings, region), layers, layers);
  std::map<std::string, Tag> tags{
      {"base", mesh.tags.at("symmetry")}, {"tip", mesh.tags.at("side")}, {"side", mesh.tags.at("rim")}};
  if (hollow()) tags["bore"] = mesh.tags.at("bore");
  mesh.tags = std::move(tags);

  const BodyAxis line = *axis();
  const double corner = 2 * std::numbers::pi / nodes_on(hollow(), rings, rings);
  const double scale = settings.order == 1 ? std::sqrt(corner / std::sin(corner)) : 1;  // of a polygon to its circle
  for (int i = 0; i < mesh.node_count(); ++i) {
    const Eigen::VectorXd unit = mesh.node(i);
    const double at = levels[static_cast<size_t>(std::lround(unit[2]))], rho = std::hypot(unit[0], unit[1]);
    const double inner = bore_at(at), outer = radius_at(at);
    const double r = hollow() ? inner + (rho - 1) * (outer - inner) : rho * outer;
    mesh.X.segment<3>(3 * i) = line.point(at, scale * r, std::atan2(unit[1], unit[0]));
  }
  for (int e = 0; e < mesh.element_count(); ++e) {
    if (vertex_determinant(mesh, e) < 0) flip_element(mesh.shape, &mesh.elements[4 * static_cast<size_t>(e)]);
  }
  orient_tags(mesh, "revolved");
  if (settings.order == 2) {
    mesh = to_quadratic(mesh);
    round_off(mesh, line, hollow());
  }
  mesh.check("revolved");
  return mesh;
}

std::vector<double> Revolved::extent() const {
  const double width = 2 * *std::max_element(radius.values.begin(), radius.values.end());
  std::vector<double> lengths(3, width);
  lengths[static_cast<size_t>(along.back() - 'x')] = length();
  return lengths;
}

std::optional<BodyAxis> Revolved::axis() const {
  BodyAxis axis = coordinate_axis(Eigen::Vector3d::Zero(), along.back() - 'x', along.size() == 1, length());
  axis.section = [shape = *this](double at) {
    const double outer = shape.radius_at(at), inner = shape.bore_at(at), pi = std::numbers::pi;
    const double moment = pi / 4 * (std::pow(outer, 4) - std::pow(inner, 4));
    return CrossSection{pi * (outer * outer - inner * inner), moment, moment, 2 * moment};
  };
  return axis;
}

}  // namespace taut
