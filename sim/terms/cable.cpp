#include "sim/terms/cable.hpp"

#include <fmt/format.h>

#include <algorithm>

#include "sim/core/error.hpp"
#include "sim/terms/cable_friction.hpp"
#include "sim/terms/cable_path.hpp"
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

bool rubs(const Cable& cable) {
  return !cable.eyelets.empty();
}

/// The path with the law of its tension.
class TautPath : public CablePath {
 public:
  TautPath(const Mesh& mesh, const Cable& cable, double regular = 0)
      : CablePath(mesh, cable.points, regular),
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
  if (rubs(cable)) {
    check(mesh, cable);
    return make_rubbing_cable(mesh, cable);
  }
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
  if (rubs(cable)) return make_segment_tension(mesh, cable, 0);
  return std::make_unique<TensionChannel>(mesh, cable);
}

std::unique_ptr<Channel> make_cable_end_tension(const Mesh& mesh, const Cable& cable) {
  if (rubs(cable)) return make_segment_tension(mesh, cable, static_cast<Eigen::Index>(cable.eyelets.size()));
  return std::make_unique<TensionChannel>(mesh, cable);
}

}  // namespace taut
