#include "calib/models/placed_rod.hpp"

#include <fmt/format.h>

#include <cmath>

#include "sim/core/error.hpp"
#include "sim/scene/build_scene.hpp"
#include "sim/scene/channel_kinds.hpp"

namespace taut {

using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector3d;

namespace {

/// The faces at the ends of the axis.
struct EndFaces {
  std::string base, tip;
};
EndFaces end_faces(const Experiment& experiment) {
  return experiment.geometry.kind() == "box" ? EndFaces{"xmin", "xmax"} : EndFaces{"base", "tip"};
}

/// A point of the world at rest, in a rod.
RodPoint rod_point(const PlacedRod& placed, const std::vector<double>& at) {
  const Vector3d own = placed.frame.transpose() * (vector_of(at) - placed.origin);
  return {own[2], {own[0], own[1], 0}};
}

/// Where a load or a channel sits: the middle of the end face, or a point of the body.
RodPoint rod_seat(const Experiment& experiment, const std::string& part, const std::string& on,
                  const std::vector<double>& point, const PlacedRod& placed) {
  const EndFaces faces = end_faces(experiment);
  const double length = placed.rod.shape().length;
  if (on == faces.tip) return {length, Vector3d::Zero()};
  if (on.empty() && point.size() == 3) {
    const RodPoint at = rod_point(placed, point);
    if (at.s > -1e-6 * length && at.s < (1 + 1e-6) * length) return at;
  }
  refuse_rod(experiment, part, fmt::format("on a rod it stands on '{}' or at a point between its ends", faces.tip));
}

RodTendon tendon_along(const EyeletLine& line) {
  return {line.start, line.end, [line](double s) {
            const double t = (s - line.start) / (line.end - line.start);
            return Eigen::Vector2d(std::lerp(line.offset, line.end_offset, t) *
                                   Eigen::Vector2d(std::cos(line.angle), std::sin(line.angle)));
          }};
}

RodChannel make_channel(const Experiment& experiment, const ChannelSettings& channel, const BodySettings& body,
                        const PlacedRod& placed) {
  const std::string part = fmt::format("[[channel]] '{}'", channel.id);
  RodChannel made;
  made.direction = vector_of(channel.direction).normalized();
  made.rotation = channel.kind->name == "rotation";
  made.from_rest = channel.kind->from_rest;
  if (!made.rotation && channel.kind->name != "displacement" && channel.kind->name != "position")
    refuse_rod(experiment, part,
               fmt::format("a rod shows displacements, positions and rotations, and this is a {}", channel.kind->name));
  if (channel.foot) {
    made.at.s = *channel.foot;
    if (!channel.standoff.empty())
      made.at.offset = placed.frame.transpose() * rotation_of(body, 3) * vector_of(channel.standoff);
    return made;
  }
  if (!channel.standoff.empty())
    refuse_rod(experiment, part, "a rod carries markers on its axis; make it a [[marker]]");
  if (made.rotation && channel.on != end_faces(experiment).tip)
    refuse_rod(experiment, part,
               fmt::format("a rod shows the rotation of its end face, '{}'", end_faces(experiment).tip));
  made.at = rod_seat(experiment, part, channel.on, channel.point, placed);
  return made;
}

}  // namespace

RowReading reading_of(const PlacedRod& placed, const RodChannel& channel, const RodState& x, const MatrixXd& dx) {
  RowReading reading;
  if (channel.rotation) {
    // See make_rotation_channel(): the component about an axis, for small turns behind R.
    const Matrix3d R = placed.frame * placed.rod.end_rotation(x) * placed.frame.transpose();
    const Vector3d axial(R(2, 1) - R(1, 2), R(0, 2) - R(2, 0), R(1, 0) - R(0, 1));
    const double s = channel.direction.dot(axial), c = R.trace() - 1;
    reading.value = reading.moved = std::atan2(s, c);
    const Vector3d by_turn =
        (c * (R.trace() * channel.direction - R * channel.direction) + s * axial) / (c * c + s * s);
    reading.slopes = Eigen::RowVectorXd::Zero(dx.cols());
    if (dx.cols() > 0) reading.slopes = placed.handedness() * by_turn.transpose() * placed.frame * dx.bottomRows<3>();
    return reading;
  }
  const RodReading position = placed.rod.position(x, channel.at);
  const Vector3d direction = placed.frame.transpose() * channel.direction;
  reading.value = channel.direction.dot(placed.origin) + direction.dot(position.value);
  const double displacement = reading.value - placed.rest(channel);
  if (channel.from_rest) reading.value = displacement;
  reading.moved =
      std::copysign((position.value - channel.at.offset - Vector3d(0, 0, channel.at.s)).norm(), displacement);
  reading.slopes = direction.transpose() * position.change(dx);
  return reading;
}

void refuse_rod(const Experiment& experiment, const std::string& part, const std::string& what) {
  throw FileError(experiment.path, part + ": " + what + "; model = \"full\" takes the rest");
}

void check_rod(const Experiment& experiment) {
  const GeometrySettings& geometry = experiment.geometry;
  if (!experiment.kind->at_rest)
    refuse_rod(experiment, "[bench]", "a rod has no inertia here and takes readings at rest");
  if ((geometry.kind() != "revolved" && geometry.kind() != "box") || geometry.dimension != 3) {
    refuse_rod(experiment, "[geometry]",
               fmt::format("a rod is made from a revolved body or a box, not from '{}'", geometry.kind()));
  }
  if (experiment.mesh.depth_cells > 0) refuse_rod(experiment, "[mesh]", "a rod is a whole body, not one half");
  const EndFaces faces = end_faces(experiment);
  if (experiment.supports.size() != 1 || experiment.supports.front().on != faces.base ||
      experiment.supports.front().fix.size() != 3) {
    refuse_rod(experiment, "[[support]]",
               fmt::format("a rod has one support, '{}', with fix = [\"x\", \"y\", \"z\"]", faces.base));
  }
  if (experiment.materials.size() != 1) refuse_rod(experiment, "[materials]", "a rod is of one material");
  const MaterialSettings& material = experiment.materials.front();
  if (experiment.rod_section == SectionLaw::neo_hookean && material.law != "neo_hookean")
    refuse_rod(
        experiment, fmt::format("[materials.{}]", material.region),
        fmt::format("the fibres of a rod are neo_hookean, not {}; set rod_section = \"linear\" for its E and nu alone",
                    material.law));
  if (experiment.contact.on || !experiment.contact.obstacles.empty() || !experiment.contact.grounds.empty())
    refuse_rod(experiment, "[contact]", "a rod touches nothing; leave [contact] out");
  for (const CableSettings& cable : experiment.cables.cables) {
    if (!cable.held || !cable.line)
      refuse_rod(experiment, fmt::format("cable '{}'", cable.id),
                 "a rod's cables run beside its axis ('along', 'offset', 'angle') and their 'tension' is held");
  }
}

PlacedRod place_rod(const Experiment& experiment, const std::vector<double>& nodes) {
  BodySettings body;
  body.geometry = experiment.geometry;
  body.at = experiment.base_at;
  body.turn = experiment.base_turn;
  const BodyAxis axis = axis_of(body);
  Matrix3d frame;
  frame << axis.first, axis.second, axis.along;
  RodShape shape;
  shape.length = axis.length;
  shape.nodes = nodes;
  shape.section = axis.section;
  shape.round = experiment.geometry.kind() != "box";
  if (!shape.round) shape.shear_factor = 5.0 / 6;
  shape.law = experiment.rod_section;
  if (!experiment.gravity_direction.empty())
    shape.down = frame.transpose() * vector_of(experiment.gravity_direction).normalized();
  for (const CableSettings& cable : experiment.cables.cables) shape.tendons.push_back(tendon_along(*cable.line));
  PlacedRod placed{Rod(shape), axis.origin, frame, {}};
  if (!experiment.loads.empty()) {
    for (const LoadSettings& load : experiment.loads) {
      const std::string part = fmt::format("[[load]] '{}'", load.id);
      if (load.quantity != Quantity::force && load.quantity != Quantity::mass)
        refuse_rod(experiment, part, "a rod carries forces and hung masses");
      shape.forces.push_back({rod_seat(experiment, part, load.on, load.point, placed),
                              frame.transpose() * vector_of(load.direction).normalized()});
    }
    placed.rod = Rod(shape);
  }
  for (const ChannelSettings& channel : experiment.channels)
    placed.channels.push_back(make_channel(experiment, channel, body, placed));
  return placed;
}

}  // namespace taut
