#include "sim/terms/play.hpp"

#include <fmt/format.h>

#include "sim/core/error.hpp"
#include "sim/model/node_set.hpp"
#include "sim/terms/one_sided.hpp"

namespace taut {
namespace {

class PlayTerm final : public Term {
 public:
  PlayTerm(const Mesh& mesh, const Play& play)
      : on_{{}, mesh.dimension()},
        stiffness_(play.stiffness),
        clearance_(play.clearance),
        smoothing_(play.smoothing),
        share_(play.share) {
    for (int node = 0; node < mesh.node_count(); ++node) {
      if (!play.apart.segment(node * on_.dimension, on_.dimension).isZero(0)) on_.nodes.push_back(node);
    }
    if (on_.nodes.empty())
      throw InputError("a stud and its hole are one place, so that there is no play between them; name two places");
    if (!(smoothing_ >= 0)) {
      throw InputError(
          fmt::format("a stud's smoothing is {:.6g} m; it must be 0 (none) or positive, such as 2e-6", smoothing_));
    }
    weights_ = on_.gather(play.apart).reshaped();
  }

  Cliques cliques() const override { return on_.cliques(); }

  void assemble(const Point& at, Assembly& out) const override {
    const double e = elongation(at), k = share_ * at.p[stiffness_];
    const OneSided above = side(at, e) * k, below = side(at, -e) * k;
    out.add_energy(above.energy + below.energy);
    const double force = above.tension - below.tension, rate = above.rate + below.rate;
    if (out.gradient != nullptr && force != 0) on_.scatter(force * weights_, *out.gradient);
    if (out.wants_hessian() && rate != 0) on_.add_hessian(rate * (weights_ * weights_.transpose()), out);
  }

  bool depends_on(int index) const override { return index >= 0 && (index == stiffness_ || index == clearance_); }

  void add_parameter_gradient(const Point& at, int index, Eigen::VectorXd& out) const override {
    if (!depends_on(index)) return;
    const double e = elongation(at);
    const OneSided above = side(at, e), below = side(at, -e);
    double change = 0;
    if (index == stiffness_) change += above.tension - below.tension;
    if (index == clearance_) change += at.p[stiffness_] * (below.rate - above.rate);
    on_.scatter(share_ * change * weights_, out);
  }

 private:
  double elongation(const Point& at) const { return weights_.dot(on_.gather(at.u).reshaped()); }
  OneSided side(const Point& at, double e) const { return {e - at.p[clearance_], smoothing_}; }

  NodeSet on_;
  Eigen::VectorXd weights_;  ///< de/du, node by node
  int stiffness_, clearance_;
  double smoothing_, share_;
};

}  // namespace

std::unique_ptr<Term> make_play(const Mesh& mesh, const Play& play) {
  return std::make_unique<PlayTerm>(mesh, play);
}

}  // namespace taut
