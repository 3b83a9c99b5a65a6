#include "sim/scene/contact_force.hpp"

#include <utility>

namespace taut {
namespace {

class ContactForce final : public Channel {
 public:
  ContactForce(std::vector<std::unique_ptr<Term>> terms, Eigen::VectorXd weights)
      : terms_(std::move(terms)), weights_(std::move(weights)) {}

  double value(const Point& at) const override {
    Eigen::VectorXd gradient = Eigen::VectorXd::Zero(weights_.size());
    Assembly out;
    out.gradient = &gradient;
    for (const auto& term : terms_) term->assemble(at, out);
    return -weights_.dot(gradient);
  }
  Eigen::VectorXd gradient(const Point& at) const override {
    Eigen::VectorXd product = Eigen::VectorXd::Zero(weights_.size());
    Assembly out;
    out.direction = &weights_;
    out.product = &product;
    for (const auto& term : terms_) term->assemble(at, out);
    return -product;
  }
  double parameter_derivative(const Point& at, int index) const override {
    Eigen::VectorXd gradient = Eigen::VectorXd::Zero(weights_.size());
    for (const auto& term : terms_) {
      if (term->depends_on(index)) term->add_parameter_gradient(at, index, gradient);
    }
    return -weights_.dot(gradient);
  }
  double memory_derivative(const Point& at, const Eigen::VectorXd& change) const override {
    Eigen::VectorXd gradient = Eigen::VectorXd::Zero(weights_.size());
    for (const auto& term : terms_) term->add_memory_product(at, change, gradient);
    return -weights_.dot(gradient);
  }

 private:
  std::vector<std::unique_ptr<Term>> terms_;
  Eigen::VectorXd weights_;
};

}  // namespace

std::unique_ptr<Channel> make_contact_force(const Mesh& mesh, const std::vector<const SidedTerm*>& terms,
                                            const Part& part, int by, const Eigen::VectorXd& direction) {
  const int d = mesh.dimension(), own = static_cast<int>(&part - mesh.parts.data());
  Eigen::VectorXd weights = Eigen::VectorXd::Zero(mesh.X.size());
  for (int node = part.first_node; node < part.first_node + part.node_count; ++node)
    weights.segment(static_cast<Eigen::Index>(node) * d, d) = direction.normalized();
  std::vector<std::unique_ptr<Term>> between;
  for (const SidedTerm* term : terms) between.push_back(term->between({own, by}));
  return std::make_unique<ContactForce>(std::move(between), std::move(weights));
}

}  // namespace taut
