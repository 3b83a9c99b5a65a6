#include "sim/core/channel.hpp"

#include <Eigen/Dense>

#include "sim/core/error.hpp"
#include "sim/terms/load.hpp"

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

/// Treats 2D as 3D with zero third components: there the rotation is about the third axis, which a third, unit moment
/// of the patch about its own plane keeps well defined.
class MarkerChannel final : public Channel {
 public:
  MarkerChannel(const Mesh& mesh, const MaterialPoint& foot, const Eigen::VectorXd& standoff, const Tag& patch,
                const Eigen::VectorXd& direction)
      : dimension_(mesh.dimension()),
        foot_(point_weights(mesh, foot, direction)),
        standoff_(lift(standoff)),
        direction_(lift(direction).normalized()) {
    nodes_ = patch.nodes();
    // A node's share of the patch; quadratic faces have none at vertices, which is as good a sample of the rotation.
    const Eigen::VectorXd share = mean_weights(mesh, patch, Eigen::VectorXd::Unit(dimension_, 0));
    Eigen::Vector3d centre = Eigen::Vector3d::Zero();
    for (int node : nodes_) {
      shares_.push_back(share[static_cast<Eigen::Index>(node) * dimension_]);
      centre += shares_.back() * lift(mesh.node(node));
    }
    Eigen::Matrix3d moment = Eigen::Matrix3d::Zero();
    for (size_t i = 0; i < nodes_.size(); ++i) {
      arms_.push_back(lift(mesh.node(nodes_[i])) - centre);
      moment += shares_[i] * arms_.back() * arms_.back().transpose();
    }
    if (dimension_ == 2) moment(2, 2) = moment.trace();
    moment_ = moment;
    const Eigen::Vector3d spread = Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(moment).eigenvalues();
    if (!(spread[1] > 1e-12 * mesh.diagonal() * mesh.diagonal())) {
      throw InputError(
          "a marker needs a patch that has a rotation, not a single point or (in 3D) a straight line; name a face as "
          "its 'turns_with'");
    }
  }

  double value(const Point& at) const override {
    return foot_.dot(at.u) + direction_.dot(rotation(at.u) * standoff_ - standoff_);
  }

  Eigen::VectorXd gradient(const Point& at) const override {
    // A = R S. A change dA turns R by the vector w, dR = R [w]x, with (tr(S) I - S) w = axial(R^T dA - dA^T R).
    const Eigen::Matrix3d A = shape(at.u), R = polar(A), S = R.transpose() * A;
    const Eigen::Matrix3d G = S.trace() * Eigen::Matrix3d::Identity() - 0.5 * (S + S.transpose());
    const Eigen::Vector3d lever = G.inverse() * standoff_.cross(R.transpose() * direction_);
    Eigen::VectorXd gradient = foot_;
    // dA = sum_i share_i du_i arm_i^T, because the arms' weighted sum is zero. axial(R^T dA - ...) = sum share_i arm_i
    // x R^T du_i
    for (size_t i = 0; i < nodes_.size(); ++i) {
      const Eigen::Vector3d g = shares_[i] * (R * lever.cross(arms_[i]));
      gradient.segment(static_cast<Eigen::Index>(nodes_[i]) * dimension_, dimension_) += g.head(dimension_);
    }
    return gradient;
  }

 private:
  static Eigen::Vector3d lift(const Eigen::VectorXd& v) {
    Eigen::Vector3d lifted = Eigen::Vector3d::Zero();
    lifted.head(v.size()) = v;
    return lifted;
  }

  Eigen::Matrix3d shape(const Eigen::VectorXd& u) const {
    Eigen::Matrix3d A = moment_;
    for (size_t i = 0; i < nodes_.size(); ++i) {
      A += shares_[i] * lift(u.segment(static_cast<Eigen::Index>(nodes_[i]) * dimension_, dimension_)) *
           arms_[i].transpose();
    }
    return A;
  }

  static Eigen::Matrix3d polar(const Eigen::Matrix3d& A) {
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(A, Eigen::ComputeFullU | Eigen::ComputeFullV);
    Eigen::Vector3d sign(1, 1, (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0 ? -1 : 1);
    return svd.matrixU() * sign.asDiagonal() * svd.matrixV().transpose();
  }

  Eigen::Matrix3d rotation(const Eigen::VectorXd& u) const { return polar(shape(u)); }

  int dimension_;
  Eigen::VectorXd foot_;
  Eigen::Vector3d standoff_, direction_;
  std::vector<int> nodes_;
  std::vector<double> shares_;
  std::vector<Eigen::Vector3d> arms_;
  Eigen::Matrix3d moment_;
};

}  // namespace

std::unique_ptr<Channel> make_linear_channel(Eigen::VectorXd weights) {
  return std::make_unique<LinearChannel>(std::move(weights));
}

std::unique_ptr<Channel> make_marker_channel(const Mesh& mesh, const MaterialPoint& foot,
                                             const Eigen::VectorXd& standoff, const Tag& patch,
                                             const Eigen::VectorXd& direction) {
  return std::make_unique<MarkerChannel>(mesh, foot, standoff, patch, direction);
}

}  // namespace taut
