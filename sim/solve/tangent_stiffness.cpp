#include "sim/solve/tangent_stiffness.hpp"

#include <algorithm>
#include <limits>
#include <utility>

namespace taut {
namespace {

class StiffnessChannel final : public Channel {
 public:
  StiffnessChannel(const Model& model, Eigen::VectorXd weights) : model_(&model), weights_(std::move(weights)) {}

  double value(const Point& at) const override { return stiffness(at, nullptr); }
  Eigen::VectorXd gradient(const Point& at) const override {
    return slope(at, [&](const Point& beside, const Eigen::VectorXd& w) { return model_->hessian_times(beside, w); });
  }
  double parameter_derivative(const Point& at, int index) const override {
    const auto of = [&](const Point& beside, const Eigen::VectorXd& w) {
      return Eigen::VectorXd::Constant(1, w.dot(model_->parameter_gradient(beside, index)));
    };
    return slope(at, of)[0];
  }

 private:
  double stiffness(const Point& at, Eigen::VectorXd* w) const {
    EquilibriumOptions options;
    Equilibrium here(*model_, options);
    here.start_at(at.u, at.p);
    if (at.step != nullptr) here.step_moved_to(*at.step);
    if (!here.refactorise()) return std::numeric_limits<double>::quiet_NaN();
    if (w != nullptr) *w = here.solve_linear(weights_).col(0);
    return stiffness_along(here, weights_);
  }
  /// k^2 times the derivative of something along w.
  template <class Of>
  Eigen::VectorXd slope(const Point& at, Of&& of) const {
    Eigen::VectorXd w = Eigen::VectorXd::Zero(model_->unknowns());
    const double k = stiffness(at, &w);
    const double step = 1e-5 * model_->length_scale() / std::max(w.cwiseAbs().maxCoeff(), 1e-300);
    const Eigen::VectorXd ahead = at.u + step * w, behind = at.u - step * w;
    return k * k / (2 * step) * (of(Point{ahead, at.p, at.step}, w) - of(Point{behind, at.p, at.step}, w));
  }

  const Model* model_;
  Eigen::VectorXd weights_;
};

}  // namespace

double stiffness_along(const Equilibrium& equilibrium, const Eigen::VectorXd& direction) {
  return 1 / direction.dot(equilibrium.solve_linear(direction).col(0));
}

Eigen::RowVectorXd log_stiffness_slopes(const Equilibrium& equilibrium, const Eigen::VectorXd& direction,
                                        const std::vector<int>& indices, const Eigen::VectorXd& steps) {
  const Eigen::VectorXd w = equilibrium.solve_linear(direction).col(0);
  const Eigen::MatrixXd du = equilibrium.sensitivities(indices);
  Eigen::RowVectorXd slopes(du.cols());
  for (Eigen::Index j = 0; j < du.cols(); ++j) {
    double difference = 0;
    for (const double step : {steps[j], -steps[j]}) {
      const Eigen::VectorXd u = equilibrium.u() + step * du.col(j);
      Params p = equilibrium.p();
      p[indices[static_cast<size_t>(j)]] += step;
      difference += w.dot(equilibrium.model().hessian_times({u, p}, w)) / (2 * step);
    }
    slopes[j] = difference / direction.dot(w);
  }
  return slopes;
}

std::unique_ptr<Channel> make_tangent_stiffness(const Model& model, Eigen::VectorXd weights) {
  return std::make_unique<StiffnessChannel>(model, std::move(weights));
}

}  // namespace taut
