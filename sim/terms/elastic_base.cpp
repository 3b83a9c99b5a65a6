#include "sim/terms/elastic_base.hpp"

#include <fmt/format.h>

#include <cmath>
#include <limits>

#include "sim/core/error.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/model/node_set.hpp"

namespace taut {
namespace {

/// With sum_i w_i A_i = 0 both arguments of atan2 are linear in the displacements: S = s . u and C = M + c . u.
class ElasticBase final : public Term {
 public:
  ElasticBase(const Mesh& mesh, const Tag& tag, int rotation_stiffness, double translation_stiffness)
      : nodes_{tag.nodes(), mesh.dimension()},
        stiffness_(rotation_stiffness),
        translation_stiffness_(translation_stiffness) {
    if (mesh.dimension() != 2)
      throw InputError("an elastic clamp was asked for in a 3D model; it exists in 2D only, so use fixed components");
    if (!(translation_stiffness > 0) || !std::isfinite(translation_stiffness)) {
      throw InputError(
          fmt::format("an elastic clamp has the translation stiffness {:.6g} N/m; it must be positive, and so large "
                      "that the clamp's translation does not count",
                      translation_stiffness));
    }
    const Eigen::VectorXd share = mean_weights(mesh, tag, Eigen::Vector2d(1, 0));
    weights_ = nodes_.gather(share).row(0);
    Eigen::Matrix2Xd arms = nodes_.gather(mesh.X);
    const Eigen::Vector2d centre = arms * weights_;
    arms.colwise() -= centre;
    moment_ = arms.colwise().squaredNorm() * weights_;
    if (!(moment_ > 1e-12 * mesh.diagonal() * mesh.diagonal())) {
      throw InputError("an elastic clamp needs an edge with a rotation, not a single point; name a face as its place");
    }
    sine_.resize(2, nodes_.count());
    cosine_ = arms * weights_.asDiagonal();
    sine_.row(0) = -cosine_.row(1);
    sine_.row(1) = cosine_.row(0);
  }

  Cliques cliques() const override { return nodes_.cliques(); }

  void assemble(const Point& at, Assembly& out) const override {
    const Eigen::Matrix2Xd u = nodes_.gather(at.u);
    const Eigen::Vector2d mean = u * weights_;
    const Rotation rotation = rotation_at(u);
    const double c = at.p[stiffness_];
    out.add_energy(0.5 * translation_stiffness_ * mean.squaredNorm());
    out.add_energy(rotation.defined() ? 0.5 * c * rotation.angle * rotation.angle
                                      : std::numeric_limits<double>::infinity());
    if (!rotation.defined()) return;
    if (out.gradient != nullptr) {
      const Eigen::Matrix2Xd g =
          translation_stiffness_ * mean * weights_.transpose() + c * rotation.angle * gradient_of(rotation);
      nodes_.scatter(g.reshaped(), *out.gradient);
    }
    if (out.wants_hessian()) {
      const Eigen::VectorXd slope = gradient_of(rotation).reshaped(), s = sine_.reshaped(), k = cosine_.reshaped();
      Eigen::MatrixXd H = c * (slope * slope.transpose());
      if (out.curvature == Curvature::exact) {
        // theta = Im ln(C + i S), so its second derivative is -Im((k + i s)(k + i s)^T / (C + i S)^2).
        const double C = rotation.cosine, S = rotation.sine, square = C * C + S * S;
        const double factor = c * rotation.angle / (square * square);
        H += (2 * C * S * factor) * (k * k.transpose() - s * s.transpose()) -
             ((C * C - S * S) * factor) * (k * s.transpose() + s * k.transpose());
      }
      for (int a = 0; a < nodes_.count(); ++a) {
        for (int b = 0; b < nodes_.count(); ++b) {
          const double entry = translation_stiffness_ * (weights_[a] * weights_[b]);
          H(2 * a, 2 * b) += entry;
          H(2 * a + 1, 2 * b + 1) += entry;
        }
      }
      nodes_.add_hessian(H, out);
    }
  }

  bool depends_on(int index) const override { return index == stiffness_; }

  void add_parameter_gradient(const Point& at, int index, Eigen::VectorXd& out) const override {
    if (!depends_on(index)) return;
    const Rotation rotation = rotation_at(nodes_.gather(at.u));
    const Eigen::Matrix2Xd g = rotation.angle * gradient_of(rotation);
    nodes_.scatter(g.reshaped(), out);
  }

 private:
  struct Rotation {
    double sine, cosine;  ///< both times the same length^2
    double angle;
    bool defined() const { return sine != 0 || cosine != 0; }
  };

  Rotation rotation_at(const Eigen::Matrix2Xd& u) const {
    const double S = sine_.cwiseProduct(u).sum(), C = moment_ + cosine_.cwiseProduct(u).sum();
    return {S, C, std::atan2(S, C)};
  }

  /// dtheta/du, one column per node.
  Eigen::Matrix2Xd gradient_of(const Rotation& r) const {
    return (r.cosine * sine_ - r.sine * cosine_) / (r.cosine * r.cosine + r.sine * r.sine);
  }

  NodeSet nodes_;
  int stiffness_;
  double translation_stiffness_;
  Eigen::VectorXd weights_;
  double moment_ = 0;  ///< M = sum_i w_i |A_i|^2 [m^2]
  Eigen::Matrix2Xd sine_,
      cosine_;  ///< derivatives of S and C: w_i times the arm turned by 90 degrees, w_i times the arm
};

}  // namespace

std::unique_ptr<Term> make_elastic_base(const Mesh& mesh, const Tag& tag, int rotation_stiffness,
                                        double translation_stiffness) {
  return std::make_unique<ElasticBase>(mesh, tag, rotation_stiffness, translation_stiffness);
}

}  // namespace taut
