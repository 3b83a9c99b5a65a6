#include "sim/scene/setup.hpp"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <cmath>

#include "sim/core/error.hpp"

namespace taut {

double Setup::share() const {
  return std::pow(0.5, symmetry_of(bodies.front()).size());
}

std::vector<SymmetryPlane> symmetry_of(const BodySettings& body) {
  return body.mesh.depth_cells > 0 ? std::vector<SymmetryPlane>{{"symmetry", 2}} : body.geometry.shape->symmetry();
}

Eigen::MatrixXd rotation_of(const BodySettings& body, int dimension) {
  Eigen::VectorXd signs = Eigen::VectorXd::Ones(dimension);
  if (body.mirrored >= 0) signs[body.mirrored] = -1;
  if (dimension == 2) return Eigen::Rotation2Dd(body.angle).toRotationMatrix() * signs.asDiagonal();
  Eigen::Matrix3d rotation = Eigen::AngleAxisd(body.angle, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  for (size_t axis = 0; axis < body.turn.size(); ++axis)
    rotation = Eigen::AngleAxisd(body.turn[axis], Eigen::Vector3d::Unit(static_cast<Eigen::Index>(axis))) * rotation;
  return rotation * signs.asDiagonal();
}

Eigen::VectorXd placed(const BodySettings& body, const Eigen::VectorXd& point) {
  Eigen::VectorXd x = rotation_of(body, static_cast<int>(point.size())) * point;
  if (!body.at.empty()) x += vector_of(body.at);
  return x;
}

BodyAxis axis_of(const BodySettings& body) {
  std::optional<BodyAxis> axis = body.geometry.shape->axis();
  if (!axis) {
    throw InputError(fmt::format("a {} has no straight axis to place anything along; kinds that have one: {}",
                                 body.geometry.kind(), join(kinds_with_axis())));
  }
  const Eigen::MatrixXd rotation = rotation_of(body, static_cast<int>(axis->origin.size()));
  axis->origin = placed(body, axis->origin);
  for (Eigen::VectorXd* direction : {&axis->along, &axis->first, &axis->second}) {
    if (direction->size() > 0) *direction = rotation * *direction;
  }
  return *std::move(axis);
}

}  // namespace taut
