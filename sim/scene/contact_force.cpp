#include "sim/scene/contact_force.hpp"

#include <algorithm>
#include <functional>
#include <map>
#include <numeric>
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

Eigen::VectorXd contact_forces(const Mesh& mesh, const std::vector<const SidedTerm*>& terms, const Point& at) {
  Eigen::VectorXd gradient = Eigen::VectorXd::Zero(mesh.X.size());
  Assembly out;
  out.gradient = &gradient;
  for (const SidedTerm* term : terms) term->assemble(at, out);
  std::vector<bool> of_element(static_cast<size_t>(mesh.node_count()), false);
  for (const int node : mesh.elements) of_element[static_cast<size_t>(node)] = true;
  const int d = mesh.dimension();
  for (int node = 0; node < mesh.node_count(); ++node) {
    if (!of_element[static_cast<size_t>(node)]) gradient.segment(static_cast<Eigen::Index>(node) * d, d).setZero();
  }
  return -gradient;
}

std::vector<ContactPatch> contact_patches(const Mesh& mesh, const Eigen::VectorXd& u, const Eigen::VectorXd& forces) {
  const int d = mesh.dimension();
  const auto force_on = [&](int node) { return forces.segment(static_cast<Eigen::Index>(node) * d, d); };
  // Patches as trees: each node names one before it, roots themselves.
  std::vector<int> root(static_cast<size_t>(mesh.node_count()));
  std::iota(root.begin(), root.end(), 0);
  const auto root_of = [&](int node) {
    while (root[static_cast<size_t>(node)] != node) node = root[static_cast<size_t>(node)];
    return node;
  };
  const Tag facets = boundary(mesh);
  for (int i = 0; i < facets.count(); ++i) {
    for (int a = 0; a < facets.nodes_per_entity; ++a) {
      for (int b = 0; b < a; ++b) {
        const int one = facets.entity(i)[a], other = facets.entity(i)[b];
        if (force_on(one).dot(force_on(other)) <= 0) continue;
        const int first = root_of(one), second = root_of(other);
        root[static_cast<size_t>(std::max(first, second))] = std::min(first, second);
      }
    }
  }
  std::map<int, ContactPatch> patch_of;
  for (int node = 0; node < mesh.node_count(); ++node) {
    if (force_on(node).isZero(0)) continue;
    ContactPatch& patch = patch_of[root_of(node)];
    if (patch.nodes.empty()) patch.force = patch.centre = Eigen::VectorXd::Zero(d);
    patch.nodes.push_back(node);
    patch.force += force_on(node);
  }
  std::vector<ContactPatch> patches;
  for (auto& [first, patch] : patch_of) {
    double weights = 0;
    for (const int node : patch.nodes) {
      const double weight = force_on(node).norm();
      patch.centre += weight * (mesh.node(node) + u.segment(static_cast<Eigen::Index>(node) * d, d));
      weights += weight;
    }
    patch.centre /= weights;
    patches.push_back(std::move(patch));
  }
  std::ranges::stable_sort(patches, std::greater(), [](const ContactPatch& patch) { return patch.force.norm(); });
  return patches;
}

}  // namespace taut
