#include "sim/model/channel.hpp"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <Eigen/SVD>
#include <cmath>
#include <map>
#include <utility>

#include "sim/core/dense.hpp"
#include "sim/core/error.hpp"
#include "sim/mesh/weights.hpp"

namespace taut {
namespace {

class LinearChannel final : public Channel {
 public:
  explicit LinearChannel(Eigen::VectorXd weights) : weights_(std::move(weights)) {}
  double value(const Point& at) const override { return weights_.dot(at.u); }
  Eigen::VectorXd gradient(const Point&) const override { return weights_; }

 private:
  Eigen::VectorXd weights_;
};

Eigen::Vector3d lift(const Eigen::VectorXd& v) {
  Eigen::Vector3d lifted = Eigen::Vector3d::Zero();
  lifted.head(v.size()) = v;
  return lifted;
}

/// Material points with equal weights.
struct Section {
  const std::vector<MaterialPoint>& points;
};

/// Rotation R of a patch of nodes or of material points, by the polar decomposition A = R S of its moment A = sum_i w_i
/// (x_i - x_c)(X_i - X_c)^T, which is linear in the displacements of nodes: A = M + sum_a u_a lever_a^T. Treats 2D as
/// 3D with zero third components: there the rotation is about the third axis, which a third, unit moment of the patch
/// about its own plane keeps well defined.
class PatchRotation {
 public:
  PatchRotation(const Mesh& mesh, const Tag& patch) : dimension_(mesh.dimension()) {
    // A node's share of the patch; quadratic faces have none at vertices, which is as good a sample of the rotation.
    const Eigen::VectorXd share = mean_weights(mesh, patch, Eigen::VectorXd::Unit(dimension_, 0));
    std::vector<MaterialPoint> samples;
    std::vector<double> weights;
    for (int node : patch.nodes()) {
      samples.push_back({{node}, {1.0}});
      weights.push_back(share[node * dimension_]);
    }
    gather(mesh, samples, weights);
  }
  PatchRotation(const Mesh& mesh, const Section& section) : dimension_(mesh.dimension()) {
    const size_t count = section.points.size();
    gather(mesh, section.points, std::vector<double>(count, 1.0 / static_cast<double>(count)));
  }

  Eigen::Matrix3d at(const Eigen::VectorXd& u) const { return polar(shape(u)); }

  /// Adds the derivative of a quantity y(R) to `gradient`, where a turn of R by the small vector w, dR = R [w]x,
  /// changes y by w . q(R).
  template <class Change>
  void add_gradient(const Eigen::VectorXd& u, Change&& q, Eigen::VectorXd& gradient) const {
    // A change dA turns R by w, with (tr(S) I - S) w = axial(R^T dA - dA^T R).
    const Eigen::Matrix3d A = shape(u), R = polar(A), S = R.transpose() * A;
    const Eigen::Matrix3d G = S.trace() * Eigen::Matrix3d::Identity() - 0.5 * (S + S.transpose());
    const Eigen::Vector3d lever = G.inverse() * q(R);
    // dA = sum_a du_a lever_a^T, and axial(R^T dA - ...) = sum_a lever_a x R^T du_a
    for (size_t i = 0; i < nodes_.size(); ++i) {
      const Eigen::Vector3d g = R * lever.cross(levers_[i]);
      gradient.segment(nodes_[i] * dimension_, dimension_) += g.head(dimension_);
    }
  }

 private:
  /// M, and the lever of each node: sum over the samples of weight times shape function times arm from the centre. The
  /// centre's own motion drops out, because the arms' weighted sum is zero.
  void gather(const Mesh& mesh, const std::vector<MaterialPoint>& samples, const std::vector<double>& weights) {
    std::vector<Eigen::Vector3d> arms;
    Eigen::Vector3d centre = Eigen::Vector3d::Zero();
    for (size_t i = 0; i < samples.size(); ++i) {
      arms.emplace_back(Eigen::Vector3d::Zero());
      for (size_t a = 0; a < samples[i].nodes.size(); ++a)
        arms[i] += samples[i].weights[a] * lift(mesh.node(samples[i].nodes[a]));
      centre += weights[i] * arms[i];
    }
    std::map<int, Eigen::Vector3d> levers;
    Eigen::Matrix3d moment = Eigen::Matrix3d::Zero();
    for (size_t i = 0; i < samples.size(); ++i) {
      arms[i] -= centre;
      moment += weights[i] * arms[i] * arms[i].transpose();
      for (size_t a = 0; a < samples[i].nodes.size(); ++a) {
        levers.try_emplace(samples[i].nodes[a], Eigen::Vector3d::Zero()).first->second +=
            weights[i] * samples[i].weights[a] * arms[i];
      }
    }
    for (const auto& [node, lever] : levers) {
      nodes_.push_back(node);
      levers_.push_back(lever);
    }
    if (dimension_ == 2) moment(2, 2) = moment.trace();
    moment_ = moment;
    const Eigen::Vector3d spread = symmetric_modes(moment).values;
    if (!(spread[1] > 1e-12 * mesh.diagonal() * mesh.diagonal())) {
      throw InputError(
          "a marker or a rotation needs a patch that has a rotation, not a single point or (in 3D) a straight line; "
          "name a face");
    }
  }

  Eigen::Matrix3d shape(const Eigen::VectorXd& u) const {
    Eigen::Matrix3d A = moment_;
    for (size_t i = 0; i < nodes_.size(); ++i)
      A += lift(u.segment(nodes_[i] * dimension_, dimension_)) * levers_[i].transpose();
    return A;
  }

  static Eigen::Matrix3d polar(const Eigen::Matrix3d& A) {
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(A, Eigen::ComputeFullU | Eigen::ComputeFullV);
    Eigen::Vector3d sign(1, 1, (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0 ? -1 : 1);
    return svd.matrixU() * sign.asDiagonal() * svd.matrixV().transpose();
  }

  int dimension_;
  std::vector<int> nodes_;
  std::vector<Eigen::Vector3d> levers_;
  Eigen::Matrix3d moment_;
};

class MarkerChannel final : public Channel {
 public:
  /// `foot`: displacement weights of the foot's component.
  MarkerChannel(Eigen::VectorXd foot, const Eigen::VectorXd& standoff, PatchRotation rotation,
                const Eigen::VectorXd& direction)
      : foot_(std::move(foot)),
        standoff_(lift(standoff)),
        direction_(lift(direction).normalized()),
        rotation_(std::move(rotation)) {}

  double value(const Point& at) const override {
    return foot_.dot(at.u) + direction_.dot(rotation_.at(at.u) * standoff_ - standoff_);
  }

  Eigen::VectorXd gradient(const Point& at) const override {
    Eigen::VectorXd gradient = foot_;
    rotation_.add_gradient(
        at.u, [&](const Eigen::Matrix3d& R) { return standoff_.cross(R.transpose() * direction_).eval(); }, gradient);
    return gradient;
  }

 private:
  Eigen::VectorXd foot_;
  Eigen::Vector3d standoff_, direction_;
  PatchRotation rotation_;
};

class RotationChannel final : public Channel {
 public:
  RotationChannel(const Mesh& mesh, const Tag& patch, const Eigen::VectorXd& axis)
      : axis_(mesh.dimension() == 2 ? Eigen::Vector3d::UnitZ() : lift(axis).normalized()), rotation_(mesh, patch) {}

  double value(const Point& at) const override {
    const Eigen::Matrix3d R = rotation_.at(at.u);
    return std::atan2(axis_.dot(axial(R)), R.trace() - 1);
  }

  Eigen::VectorXd gradient(const Point& at) const override {
    Eigen::VectorXd gradient = Eigen::VectorXd::Zero(at.u.size());
    rotation_.add_gradient(
        at.u,
        [&](const Eigen::Matrix3d& R) -> Eigen::Vector3d {
          const Eigen::Vector3d a = axial(R);
          const double s = axis_.dot(a), c = R.trace() - 1;
          return (c * (R.trace() * axis_ - R * axis_) + s * a) / (c * c + s * s);
        },
        gradient);
    return gradient;
  }

 private:
  static Eigen::Vector3d axial(const Eigen::Matrix3d& R) {
    return {R(2, 1) - R(1, 2), R(0, 2) - R(2, 0), R(1, 0) - R(0, 1)};
  }
  Eigen::Vector3d axis_;
  PatchRotation rotation_;
};

}  // namespace

std::unique_ptr<Channel> make_linear_channel(Eigen::VectorXd weights) {
  return std::make_unique<LinearChannel>(std::move(weights));
}

std::unique_ptr<Channel> make_marker_channel(const Mesh& mesh, const MaterialPoint& foot,
                                             const Eigen::VectorXd& standoff, const Tag& patch,
                                             const Eigen::VectorXd& direction) {
  return std::make_unique<MarkerChannel>(point_weights(mesh, foot, direction), standoff, PatchRotation(mesh, patch),
                                         direction);
}

std::unique_ptr<Channel> make_marker_channel(const Mesh& mesh, const std::vector<MaterialPoint>& section,
                                             const Eigen::VectorXd& standoff, const Eigen::VectorXd& direction) {
  PatchRotation rotation(mesh, Section{section});
  Eigen::VectorXd foot = Eigen::VectorXd::Zero(mesh.X.size());
  for (const MaterialPoint& point : section)
    foot += point_weights(mesh, point, direction) / static_cast<double>(section.size());
  return std::make_unique<MarkerChannel>(std::move(foot), standoff, std::move(rotation), direction);
}

std::unique_ptr<Channel> make_rotation_channel(const Mesh& mesh, const Tag& patch, const Eigen::VectorXd& axis) {
  return std::make_unique<RotationChannel>(mesh, patch, axis);
}

}  // namespace taut
