#include "sim/terms/cable.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "sim/core/error.hpp"
#include "sim/core/sorted.hpp"
#include "sim/model/node_set.hpp"
#include "sim/terms/one_sided.hpp"

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
  /// `regular`: the length that a segment without one has [m]; 0: 1e-9 of the path.
  Path(const Mesh& mesh, const std::vector<CablePoint>& points, double regular) : on_{{}, mesh.dimension()} {
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
    if (!(length > 0) && regular == 0)
      throw InputError("a cable has no length at rest; its points must not all be at one place");
    regular_ = regular > 0 ? regular : 1e-9 * length;
    for (Eigen::Index s = 0; s < segments; ++s) rest_length_ += regular_length(rest_.col(s));
  }

  const NodeSet& on() const { return on_; }
  double rest_length() const { return rest_length_; }
  double regular() const { return regular_; }  ///< see Path()

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
  TautPath(const Mesh& mesh, const Cable& cable, double regular = 0)
      : Path(mesh, cable.points, regular),
        held_(cable.tension >= 0),
        factor_(held_ ? cable.tension : cable.stiffness),
        slack_(held_ ? -1 : cable.slack),
        retraction_(held_ ? -1 : cable.retraction),
        scale_(held_ ? cable.tension_scale : -1),
        per_control_(held_ ? cable.per_control : 1),
        smoothing_(cable.smoothing) {}

  using Law = OneSided;
  Law law(const Point& at) const { return unit_law(at) * factor(at.p); }

  bool depends_on(int index) const {
    return index >= 0 && (index == factor_ || index == slack_ || index == retraction_ || index == scale_);
  }
  /// Derivative of the tension with respect to p[index] at fixed displacements.
  double tension_derivative(const Point& at, int index) const {
    if (!depends_on(index)) return 0;
    const Law unit = unit_law(at);
    double derivative = 0;
    if (index == factor_) derivative += per_control_ * scale(at.p) * unit.tension;
    if (index == scale_) derivative += per_control_ * at.p[factor_] * unit.tension;
    if (index == slack_) derivative -= factor(at.p) * unit.rate;
    if (index == retraction_) derivative += factor(at.p) * unit.rate;
    return derivative;
  }

 private:
  double scale(const Params& p) const { return scale_ >= 0 ? p[scale_] : 1; }
  /// The stiffness, or the tension: all is proportional to it.
  double factor(const Params& p) const { return p[factor_] * per_control_ * scale(p); }
  /// The law for a factor of 1.
  Law unit_law(const Point& at) const {
    double e = elongation(at.u);
    if (held_) return {e, 1, 0};
    if (slack_ >= 0) e -= at.p[slack_];
    if (retraction_ >= 0) e += at.p[retraction_];
    return {e, smoothing_};
  }

  bool held_;
  int factor_;  ///< table index of the stiffness or the tension
  int slack_, retraction_, scale_;
  double per_control_, smoothing_;
};

TautPath checked_path(const Mesh& mesh, const Cable& cable) {
  check(mesh, cable);
  return {mesh, cable};
}

class CableTerm final : public Term {
 public:
  CableTerm(TautPath path, double share) : share_(share), path_(std::move(path)) {}

  Cliques cliques() const override { return path_.on().cliques(); }

  void assemble(const Point& at, Assembly& out) const override {
    const TautPath::Law law = path_.law(at) * share_;
    out.add_energy(law.energy);
    if (law.tension == 0) return;
    const Eigen::VectorXd gradient = path_.gradient(at.u);
    if (out.gradient != nullptr) path_.on().scatter(law.tension * gradient, *out.gradient);
    if (out.wants_hessian()) {
      Eigen::MatrixXd H = law.rate * (gradient * gradient.transpose());
      if (law.tension > 0 || out.curvature == Curvature::exact) path_.add_hessian(at.u, law.tension, H);
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
  double value(const Point& at) const override { return path_.law(at).tension; }
  Eigen::VectorXd gradient(const Point& at) const override {
    return path_.on().spread(path_.law(at).rate * path_.gradient(at.u), at.u.size());
  }
  double parameter_derivative(const Point& at, int index) const override { return path_.tension_derivative(at, index); }

 private:
  TautPath path_;
};

}  // namespace

std::unique_ptr<Term> make_cable(const Mesh& mesh, Cable cable) {
  return std::make_unique<CableTerm>(checked_path(mesh, cable), cable.share);
}

std::vector<std::unique_ptr<Term>> make_held_cable(const Mesh& mesh, const Cable& cable) {
  const double regular = checked_path(mesh, cable).regular();
  std::vector<std::unique_ptr<Term>> terms;
  for (size_t i = 1; i < cable.points.size(); ++i) {
    Cable piece = cable;
    piece.points = {cable.points[i - 1], cable.points[i]};
    TautPath path(mesh, piece, regular);
    if (path.on().count() > 0) terms.push_back(std::make_unique<CableTerm>(std::move(path), cable.share));
  }
  return terms;
}

std::unique_ptr<Channel> make_cable_length(const Mesh& mesh, const Cable& cable) {
  return std::make_unique<LengthChannel>(mesh, cable);
}

std::unique_ptr<Channel> make_cable_tension(const Mesh& mesh, const Cable& cable) {
  return std::make_unique<TensionChannel>(mesh, cable);
}

}  // namespace taut
