#include "sim/scene/channel_kinds.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "sim/core/error.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/scene/contact_force.hpp"
#include "sim/scene/reaction.hpp"
#include "sim/solve/tangent_stiffness.hpp"

namespace taut {
namespace {

/// Displacement weights of a body's centre of mass; of its volume where a density is not known.
Eigen::VectorXd centre_weights(const ChannelParts& of, const Part& part, const Eigen::VectorXd& direction) {
  const Mesh& mesh = of.mesh();
  const std::vector<MaterialSettings>& materials = of.setup.materials;
  Eigen::VectorXd weights = Eigen::VectorXd::Zero(mesh.X.size());
  double mass = 0;
  const bool known = std::all_of(materials.begin(), materials.end(),
                                 [](const MaterialSettings& material) { return material.density.has_value(); });
  const std::vector<double> measures = element_measures(mesh);
  // Only this part's nodes: parts share no nodes.
  const Eigen::Index first = static_cast<Eigen::Index>(part.first_node) * mesh.dimension(),
                     count = static_cast<Eigen::Index>(part.node_count) * mesh.dimension();
  for (const MaterialSettings& material : materials) {
    const int region = mesh.region_index(material.region);
    const double density = known ? *material.density : 1.0;
    weights.segment(first, count) += density * body_weights(mesh, region, direction.normalized()).segment(first, count);
    for (int e = part.first_element; e < part.first_element + part.element_count; ++e) {
      if (mesh.region[static_cast<size_t>(e)] == region) mass += density * measures[static_cast<size_t>(e)];
    }
  }
  return weights / mass;
}

/// Displacement weights of a point, a tag's mean, or a body's centre of mass.
Eigen::VectorXd place_weights(const ChannelParts& of) {
  const Mesh& mesh = of.mesh();
  if (!of.channel.point.empty()) return point_weights(mesh, locate(mesh, vector_of(of.channel.point)), of.direction());
  const auto body =
      std::find_if(mesh.parts.begin(), mesh.parts.end(), [&](const Part& part) { return part.name == of.channel.on; });
  return body == mesh.parts.end() ? mean_weights(mesh, of.tag(), of.direction())
                                  : centre_weights(of, *body, of.direction());
}

/// A marker on the axis of a body at rest.
struct AxisMarker {
  Eigen::VectorXd standoff;            ///< [m]
  Eigen::VectorXd place;               ///< where the marker is [m]
  std::vector<MaterialPoint> section;  ///< whose mean is its foot, and with which it turns
};

/// The section's points are those whose mean square distances from the axis are the section's own, A and I: the mean of
/// whatever is quadratic across it is exact, and inside it they are, whether it is solid or hollow.
AxisMarker axis_marker(const ChannelParts& of) {
  const ChannelSettings& channel = of.channel;
  const Mesh& mesh = of.mesh();
  const auto& bodies = of.setup.bodies;
  const auto called =
      std::find_if(bodies.begin(), bodies.end(), [&](const BodySettings& body) { return body.name == channel.on; });
  const BodySettings& body = called == bodies.end() ? bodies.front() : *called;
  const BodyAxis axis = axis_of(body);
  const int d = static_cast<int>(axis.origin.size());
  if (d != mesh.dimension())
    throw InputError("a marker on the axis is for a plane or a whole body, not for half of a solid; give its 'point'");
  // A little beyond the end is where a foot at the end is while the body is made shorter.
  if (!(*channel.foot >= 0 && *channel.foot <= (1 + 1e-6) * axis.length)) {
    throw InputError(fmt::format("a marker's foot is {} along the axis, which goes from 0 to {}; put it there",
                                 in_mm(*channel.foot), in_mm(axis.length)));
  }
  AxisMarker marker;
  marker.standoff = Eigen::VectorXd::Zero(d);
  if (!channel.standoff.empty()) marker.standoff = rotation_of(body, d) * vector_of(channel.standoff);
  const Eigen::VectorXd foot = axis.point(*channel.foot, 0, 0);
  marker.place = foot + marker.standoff;
  const CrossSection section = axis.section(*channel.foot);
  const auto sample = [&](const Eigen::VectorXd& direction, double moment) {
    for (double side : {1.0, -1.0}) {
      // Half of the points in 3D are on the other direction.
      const Eigen::VectorXd point = foot + side * std::sqrt((d - 1) * moment / section.area) * direction;
      marker.section.push_back(body.name.empty() ? locate(mesh, point) : locate(mesh, point, mesh.part(body.name)));
    }
  };
  sample(axis.first, section.second);
  if (d == 3) sample(axis.second, section.first);
  return marker;
}

std::unique_ptr<Channel> make_displacement(const ChannelParts& of) {
  if (of.channel.foot) {
    const AxisMarker marker = axis_marker(of);
    return make_marker_channel(of.mesh(), marker.section, marker.standoff, of.direction());
  }
  if (of.channel.standoff.empty() || of.channel.point.empty()) return make_linear_channel(place_weights(of));
  return make_marker_channel(of.mesh(), locate(of.mesh(), vector_of(of.channel.point)), vector_of(of.channel.standoff),
                             of.mesh().select(of.channel.turns_with), of.direction());
}

std::unique_ptr<Channel> make_position(const ChannelParts& of) {
  if (of.channel.foot) {
    of.reading.rest = of.direction().normalized().dot(axis_marker(of).place);
    return make_displacement(of);
  }
  of.reading.rest = place_weights(of).dot(of.mesh().X);
  if (!of.channel.standoff.empty() && !of.channel.point.empty())
    of.reading.rest += of.direction().normalized().dot(vector_of(of.channel.standoff));
  return make_displacement(of);
}

std::unique_ptr<Channel> make_rotation(const ChannelParts& of) {
  return make_rotation_channel(of.mesh(), of.tag(), of.direction());
}

template <auto make>
std::unique_ptr<Channel> of_cable(const ChannelParts& of) {
  return make(of.mesh(), of.cable());
}

template <auto make>
std::unique_ptr<Channel> of_joint(const ChannelParts& of) {
  return make(of.mesh(), of.joint());
}

std::unique_ptr<Channel> make_support_reaction(const ChannelParts& of) {
  if (of.rigid_segments)
    throw InputError(
        "a rigid region does not say which of its nodes bear the reaction; set model = \"full\", or measure "
        "something else");
  return make_reaction(of.model, of.tag(), of.direction(), of.setup.share());
}

/// The force on a body by all others but gravity, mass times acceleration less weight: not a function of the state
/// alone.
std::unique_ptr<Channel> make_net_force(const ChannelParts& of) {
  of.reading.part = static_cast<int>(&of.mesh().part(of.channel.on) - of.mesh().parts.data());
  of.reading.direction = of.direction().normalized();
  return nullptr;
}

std::unique_ptr<Channel> make_force_by(const ChannelParts& of) {
  if (of.touching.terms.empty()) throw InputError("nothing touches anything here; add [contact]");
  const Part& part = of.mesh().part(of.channel.on);
  const auto surroundings = of.touching.side_called.find(of.channel.by);
  const int by = surroundings != of.touching.side_called.end()
                     ? surroundings->second
                     : static_cast<int>(&of.mesh().part(of.channel.by) - of.mesh().parts.data());
  return make_contact_force(of.mesh(), of.touching.terms, part, by, of.direction());
}

std::unique_ptr<Channel> make_stiffness(const ChannelParts& of) {
  const Eigen::VectorXd weights = place_weights(of);
  bool moves = false;
  for (Eigen::Index i = 0; i < weights.size(); ++i)
    moves = moves || (weights[i] != 0 && of.model.free_index(static_cast<int>(i)) >= 0);
  if (!moves)
    throw InputError("what is held along this direction gives way to no force; name a place that can move along it");
  return make_tangent_stiffness(of.model, weights);
}

}  // namespace

const std::vector<ChannelKind>& channel_kinds() {
  using On = ChannelKind::On;
  using Directed = ChannelKind::Directed;
  using Known = ChannelKind::Known;
  static const std::vector<ChannelKind> kinds{
      {"displacement", "m", "displacement of", On::place, make_displacement, Directed::always, true},
      {"position", "m", "position of", On::place, make_position, Directed::always},
      {"rotation", "rad", "rotation of", On::tag, make_rotation, Directed::in_space, true},
      {"tension", "N", "tension of cable", On::cable, of_cable<make_cable_tension>},
      {"end_tension", "N", "tension at the end of cable", On::cable, of_cable<make_cable_end_tension>},
      {"length", "m", "length of cable", On::cable, of_cable<make_cable_length>},
      {"joint_gap", "m", "gap of joint", On::joint, of_joint<make_joint_gap>},
      {"joint_angle", "rad", "angle of joint", On::joint, of_joint<make_joint_angle>},
      {"joint_torque", "Nm", "torque of joint", On::joint, of_joint<make_joint_torque>},
      {"reaction", "N", "reaction of", On::tag, make_support_reaction, Directed::always, false, Known::at_rest,
       "is that of an equilibrium"},
      {"net_force", "N", "force on", On::body, make_net_force, Directed::always, false, Known::in_steps,
       "is mass times acceleration"},
      {"contact_force", "N", "contact force on", On::body, make_force_by, Directed::always},
      {"stiffness", "N/m", "stiffness of", On::place, make_stiffness, Directed::always, false, Known::at_rest,
       "is that of an equilibrium", true}};
  return kinds;
}

}  // namespace taut
