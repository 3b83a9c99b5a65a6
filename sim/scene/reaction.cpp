#include "sim/scene/reaction.hpp"

#include <fmt/format.h>

#include "sim/core/error.hpp"

namespace taut {
namespace {

class Reaction final : public Channel {
 public:
  Reaction(const Model& model, Eigen::VectorXd weights) : model_(&model), weights_(std::move(weights)) {}

  double value(const Point& at) const override {
    Eigen::VectorXd gradient;
    Assembly out;
    out.gradient = &gradient;
    model_->evaluate(at, out);
    return weights_.dot(gradient);
  }
  Eigen::VectorXd gradient(const Point& at) const override { return model_->hessian_times(at, weights_); }
  double parameter_derivative(const Point& at, int index) const override {
    return weights_.dot(model_->parameter_gradient(at, index));
  }
  double memory_derivative(const Point& at, const Eigen::VectorXd& change) const override {
    return weights_.dot(model_->memory_product(at, change));
  }

 private:
  const Model* model_;
  Eigen::VectorXd weights_;
};

}  // namespace

std::unique_ptr<Channel> make_reaction(const Model& model, const Tag& tag, const Eigen::VectorXd& direction,
                                       double share) {
  const int d = model.mesh().dimension();
  if (direction.size() != d || !(direction.norm() > 0) || !direction.allFinite())
    throw InputError(
        fmt::format("the direction of a reaction in a {0}D model needs {0} finite numbers that are not "
                    "all zero",
                    d));
  Eigen::VectorXd weights = Eigen::VectorXd::Zero(model.unknowns());
  for (int node : tag.nodes()) {
    for (int i = 0; i < d; ++i) {
      if (model.free_index(node * d + i) < 0) weights[node * d + i] = direction[i] / direction.norm() / share;
    }
  }
  if (weights.isZero(0))
    throw InputError(
        "nothing that is fixed or moved holds this place along this direction, so that there is no reaction; name the "
        "tag of a support that fixes or moves a component along it");
  return std::make_unique<Reaction>(model, std::move(weights));
}

}  // namespace taut
