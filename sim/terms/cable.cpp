#include "sim/terms/cable.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "sim/core/error.hpp"
#include "sim/core/sorted.hpp"
#include "sim/model/node_set.hpp"

namespace taut {
namespace {

void check(const Mesh& mesh, const Cable& cable) {
  const auto is_material = [](const CablePoint& point) { return !point.material.nodes.empty(); };
  if (cable.points.size() < 2) {
    throw InputError(fmt::format("a cable has {} point{}; it needs at least two, in the order in which it passes them",
                                 cable.points.size(), cable.points.size() == 1 ? "" : "s"));
  }
  if (std::none_of(cable.points.begin(), cable.points.end(), is_material)) {
    throw InputError(
        "a cable has fixed points only and pulls on nothing; at least one of its points must be a material point");
  }
  for (const CablePoint& point : cable.points) {
    if (!is_material(point) && (point.fixed.size() != mesh.dimension() || !point.fixed.allFinite())) {
      throw InputError(
          fmt::format("a cable's fixed point has {} coordinates; {} finite numbers are needed, one per "
                      "dimension of the mesh",
                      point.fixed.size(), mesh.dimension()));
    }
  }
  if (!(cable.smoothing >= 0)) {
    throw InputError(
        fmt::format("a cable's smoothing is {:.6g} m; it must be 0 (none) or positive, such as 2e-6", cable.smoothing));
  }
}

/// The path through the points: nodes that govern it, and its length with derivatives with respect to their
/// displacements.
class Path {
 public:
  Path(const Mesh& mesh, const std::vector<CablePoint>& points) : on_{{}, mesh.dimension()} {
    std::vector<int>& nodes = on_.nodes;
    for (const CablePoint& point : points)
      nodes.insert(nodes.end(), point.material.nodes.begin(), point.material.nodes.end());
    sort_unique(nodes);

    Eigen::MatrixXd place(on_.dimension, points.size());
    Eigen::MatrixXd weight = Eigen::MatrixXd::Zero(on_.count(), place.cols());
    for (Eigen::Index i = 0; i < place.cols(); ++i) {
      const CablePoint& point = points[i];
      place.col(i) = point.material.nodes.empty() ? point.fixed : Eigen::VectorXd::Zero(on_.dimension).eval();
      for (size_t a = 0; a < point.material.nodes.size(); ++a) {
        const int node = point.material.nodes[a];
        place.col(i) += point.material.weights[a] * mesh.node(node);
        weight(std::lower_bound(nodes.begin(), nodes.end(), node) - nodes.begin(), i) += point.material.weights[a];
      }
    }
    const Eigen::Index segments = place.cols() - 1;
    rest_ = place.rightCols(segments) - place.leftCols(segments);
    weights_ = weight.rightCols(segments) - weight.leftCols(segments);
    const double length = rest_.colwise().norm().sum();
    if (!(length > 0)) throw InputError("a cable has no length at rest; its points must not all be at one place");
    regular_ = 1e-9 * length;
    for (Eigen::Index s = 0; s < segments; ++s) rest_length_ += regular_length(rest_.col(s));
  }

  const NodeSet& on() const { return on_; }
  double rest_length() const { return rest_length_; }

  /// L(x) - L0 from the displacements, |d| - |D| = (2 D + d - D) . (d - D) / (|d| + |D|): rounding is relative to the
  /// elongation, not to the length.
  double elongation(const Eigen::VectorXd& u) const {
    const Eigen::MatrixXd change = changes(u);
    double sum = 0;
    for (Eigen::Index s = 0; s < rest_.cols(); ++s) {
      const double lengths = regular_length(rest_.col(s) + change.col(s)) + regular_length(rest_.col(s));
      sum += (2 * rest_.col(s) + change.col(s)).dot(change.col(s)) / lengths;
    }
    return sum;
  }

  /// dL/du of the nodes' displacements, node by node.
  Eigen::VectorXd gradient(const Eigen::VectorXd& u) const {
    const Eigen::MatrixXd difference = rest_ + changes(u);
    Eigen::MatrixXd g = Eigen::MatrixXd::Zero(on_.dimension, on_.count());
    for (Eigen::Index s = 0; s < rest_.cols(); ++s)
      g += difference.col(s) / regular_length(difference.col(s)) * weights_.col(s).transpose();
    return g.reshaped();
  }

  /// Adds `factor` d2L/du2: each segment has (I - t t^T)/length in the difference of its ends.
  void add_hessian(const Eigen::VectorXd& u, double factor, Eigen::MatrixXd& H) const {
    const Eigen::MatrixXd difference = rest_ + changes(u);
    const int d = on_.dimension;
    for (Eigen::Index s = 0; s < rest_.cols(); ++s) {
      const double length = regular_length(difference.col(s));
      const Eigen::VectorXd t = difference.col(s) / length;
      const Eigen::MatrixXd across = (factor / length) * (Eigen::MatrixXd::Identity(d, d) - t * t.transpose());
      for (Eigen::Index a = 0; a < on_.count(); ++a) {
        for (Eigen::Index b = 0; b < on_.count(); ++b) {
          const double w = weights_(a, s) * weights_(b, s);
          if (w != 0) H.block(a * d, b * d, d, d) += w * across;
        }
      }
    }
  }

 private:
  double regular_length(const Eigen::VectorXd& d) const { return std::sqrt(d.squaredNorm() + regular_ * regular_); }

  /// How the segments' vectors have changed from rest.
  Eigen::MatrixXd changes(const Eigen::VectorXd& u) const { return on_.gather(u) * weights_; }

  NodeSet on_;
  Eigen::MatrixXd rest_;     ///< (dimension x segments): vector from each point to the next, at rest [m]
  Eigen::MatrixXd weights_;  ///< (nodes x segments): derivative of that vector with respect to a node
  double regular_ = 0, rest_length_ = 0;
};

/// The path with the law of its tension.
class TautPath : public Path {
 public:
  TautPath(const Mesh& mesh, const Cable& cable)
      : Path(mesh, cable.points),
        stiffness_(cable.stiffness),
        slack_(cable.slack),
        retraction_(cable.retraction),
        smoothing_(cable.smoothing) {}

  /// phi and its derivatives for k = 1: every one is proportional to k.
  struct Spring {
    double energy = 0, tension = 0, rate = 0;
  };
  Spring spring(const Point& at) const {
    double e = elongation(at.u);
    if (slack_ >= 0) e -= at.p[slack_];
    if (retraction_ >= 0) e += at.p[retraction_];
    const double z = e + 0.5 * smoothing_;
    if (z <= 0) return {};
    if (z < smoothing_) return {z * z * z / (6 * smoothing_), z * z / (2 * smoothing_), z / smoothing_};
    return {0.5 * e * e + smoothing_ * smoothing_ / 24, e, 1};
  }

  double stiffness(const Params& p) const { return p[stiffness_]; }
  bool depends_on(int index) const {
    return index >= 0 && (index == stiffness_ || index == slack_ || index == retraction_);
  }
  /// Derivative of the tension with respect to p[index] at fixed displacements.
  double tension_derivative(const Point& at, int index) const {
    if (!depends_on(index)) return 0;
    const Spring unit = spring(at);
    double derivative = 0;
    if (index == stiffness_) derivative += unit.tension;
    if (index == slack_) derivative -= stiffness(at.p) * unit.rate;
    if (index == retraction_) derivative += stiffness(at.p) * unit.rate;
    return derivative;
  }

 private:
  int stiffness_, slack_, retraction_;
  double smoothing_;
};

TautPath checked_path(const Mesh& mesh, const Cable& cable) {
  check(mesh, cable);
  return {mesh, cable};
}

class CableTerm final : public Term {
 public:
  CableTerm(const Mesh& mesh, const Cable& cable) : share_(cable.share), path_(checked_path(mesh, cable)) {}

  Cliques cliques() const override { return path_.on().cliques(); }

  void assemble(const Point& at, Assembly& out) const override {
    const double k = share_ * path_.stiffness(at.p);
    const TautPath::Spring unit = path_.spring(at);
    out.add_energy(k * unit.energy);
    if (unit.tension == 0) return;
    const Eigen::VectorXd gradient = path_.gradient(at.u);
    if (out.gradient != nullptr) path_.on().scatter(k * unit.tension * gradient, *out.gradient);
    if (out.wants_hessian()) {
      Eigen::MatrixXd H = k * unit.rate * (gradient * gradient.transpose());
      path_.add_hessian(at.u, k * unit.tension, H);
      path_.on().add_hessian(H, out);
    }
  }

  bool depends_on(int index) const override { return path_.depends_on(index); }

  void add_parameter_gradient(const Point& at, int index, Eigen::VectorXd& out) const override {
    if (!depends_on(index)) return;
    path_.on().scatter(share_ * path_.tension_derivative(at, index) * path_.gradient(at.u), out);
  }

 private:
  double share_;
  TautPath path_;
};

class LengthChannel final : public Channel {
 public:
  LengthChannel(const Mesh& mesh, const Cable& cable) : path_(checked_path(mesh, cable)) {}
  double value(const Point& at) const override { return path_.rest_length() + path_.elongation(at.u); }
  Eigen::VectorXd gradient(const Point& at) const override {
    return path_.on().spread(path_.gradient(at.u), at.u.size());
  }

 private:
  TautPath path_;
};

class TensionChannel final : public Channel {
 public:
  TensionChannel(const Mesh& mesh, const Cable& cable) : path_(checked_path(mesh, cable)) {}
  double value(const Point& at) const override { return path_.stiffness(at.p) * path_.spring(at).tension; }
  Eigen::VectorXd gradient(const Point& at) const override {
    const double rate = path_.stiffness(at.p) * path_.spring(at).rate;
    return path_.on().spread(rate * path_.gradient(at.u), at.u.size());
  }
  double parameter_derivative(const Point& at, int index) const override { return path_.tension_derivative(at, index); }

 private:
  TautPath path_;
};

}  // namespace

std::unique_ptr<Term> make_cable(const Mesh& mesh, Cable cable) {
  return std::make_unique<CableTerm>(mesh, cable);
}

std::unique_ptr<Channel> make_cable_length(const Mesh& mesh, const Cable& cable) {
  return std::make_unique<LengthChannel>(mesh, cable);
}

std::unique_ptr<Channel> make_cable_tension(const Mesh& mesh, const Cable& cable) {
  return std::make_unique<TensionChannel>(mesh, cable);
}

}  // namespace taut
