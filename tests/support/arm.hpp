#pragma once
#include <string>
#include <utility>
#include <vector>

#include "sim/mesh/structured.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/scene/scene.hpp"
#include "sim/terms/joint.hpp"
#include "tests/support/mesh_checks.hpp"

// Arms of stiff links along x, 60 mm long and 10 mm wide, which overlap by 10 mm at the joints between them. The first
// joint is with the world.
namespace taut::test {

constexpr double arm_base = 0.005;      ///< x of the first pivot [m]; y is 0
constexpr double arm_link = 0.05;       ///< from pivot to pivot [m]
constexpr double arm_thickness = 0.03;  ///< [m]

inline SceneBuilder arm_builder(int links, int cells = 12, double modulus = 2e9) {
  std::vector<std::pair<std::string, Mesh>> parts;
  for (int i = 0; i < links; ++i) {
    Mesh mesh = rectangle(graded(0.06, cells), graded(0.01, 2), 2, "link" + std::to_string(i + 1));
    place(mesh, Eigen::Matrix2d::Identity(), Eigen::Vector2d(i * arm_link, -0.005));
    parts.emplace_back("link" + std::to_string(i + 1), std::move(mesh));
  }
  SceneBuilder builder(merge(parts), Plane::stress, arm_thickness);
  for (const auto& [name, mesh] : parts) builder.add_solid(name, "neo_hookean", {{"E", modulus}, {"nu", 0.3}});
  return builder;
}

inline JointSettings arm_joint(int i) {
  JointSettings settings;
  settings.id = "joint" + std::to_string(i + 1);
  settings.part_a = i == 0 ? "world" : "link" + std::to_string(i);
  settings.part_b = "link" + std::to_string(i + 1);
  settings.pivot = vec({arm_base + i * arm_link, 0});
  settings.motor = vec({arm_base + i * arm_link + 0.004, 0});
  settings.radius = 0.003;
  return settings;
}

/// Rest position of the tip, a link's length beyond the last pivot.
inline Eigen::Vector2d arm_rest_tip(const Mesh& mesh) {
  return {arm_base + static_cast<double>(mesh.parts.size()) * arm_link, 0};
}

/// Weights of the tip's displacement in `direction`.
inline Eigen::VectorXd arm_tip_weights(const Mesh& mesh, const Eigen::Vector2d& direction) {
  return point_weights(mesh, locate(mesh, arm_rest_tip(mesh), mesh.parts.back()), direction);
}

/// Position of the tip at u.
inline Eigen::Vector2d arm_tip(const Mesh& mesh, const Eigen::VectorXd& u) {
  return arm_rest_tip(mesh) +
         Eigen::Vector2d(arm_tip_weights(mesh, {1, 0}).dot(u), arm_tip_weights(mesh, {0, 1}).dot(u));
}

/// Where the tip of an arm of two rigid links is.
inline Eigen::Vector2d two_link_tip(double first, double second) {
  return Eigen::Vector2d(arm_base, 0) + arm_link * Eigen::Vector2d(std::cos(first) + std::cos(first + second),
                                                                   std::sin(first) + std::sin(first + second));
}

}  // namespace taut::test
