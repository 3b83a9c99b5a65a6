#include "sim/terms/inertia.hpp"

#include "sim/mesh/shape_functions.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/model/node_set.hpp"
#include "sim/terms/element_terms.hpp"

namespace taut {
namespace {

class PointMass final : public Term {
 public:
  PointMass(const Mesh& mesh, const Tag& tag, int mass) : nodes_{tag.nodes(), mesh.dimension()}, mass_(mass) {
    const int d = nodes_.dimension;
    for (int i = 0; i < d; ++i) weights_.push_back(mean_weights(mesh, tag, Eigen::VectorXd::Unit(d, i)));
    for (int node : nodes_.nodes) share_.push_back(weights_[0][node * d]);
  }
  Cliques cliques() const override { return nodes_.cliques(); }
  void assemble(const Point& at, Assembly& out) const override {
    if (!at.moves()) return;
    const double factor = at.p[mass_] * at.step->inertia;
    for (const Eigen::VectorXd& w : weights_) {
      const double away = w.dot(at.u - at.step->reference);
      out.add_energy(0.5 * factor * away * away);
      if (out.gradient != nullptr) *out.gradient += factor * away * w;
    }
    if (!out.wants_hessian()) return;
    const int d = nodes_.dimension, n = nodes_.count();
    Eigen::MatrixXd K = Eigen::MatrixXd::Zero(n * d, n * d);
    for (int a = 0; a < n; ++a) {
      for (int b = 0; b < n; ++b) {
        for (int i = 0; i < d; ++i) K(b * d + i, a * d + i) = factor * share_[a] * share_[b];
      }
    }
    nodes_.add_hessian(K, out);
  }
  bool depends_on(int index) const override { return index == mass_; }
  void add_parameter_gradient(const Point& at, int, Eigen::VectorXd& out) const override {
    if (!at.moves()) return;
    for (const Eigen::VectorXd& w : weights_) out += at.step->inertia * w.dot(at.u - at.step->reference) * w;
  }
  void add_history_product(const Point& at, History q, const Eigen::VectorXd& x, bool,
                           Eigen::VectorXd& out) const override {
    if (!at.moves() || q != History::reference) return;
    for (const Eigen::VectorXd& w : weights_) out -= at.p[mass_] * at.step->inertia * w.dot(x) * w;
  }
  bool is_inertia() const override { return true; }

 private:
  NodeSet nodes_;
  int mass_;
  std::vector<Eigen::VectorXd> weights_;  ///< per axis
  std::vector<double> share_;
};

}  // namespace

std::unique_ptr<Term> make_inertia(const Mesh& mesh, const InertiaDefinition& definition) {
  return with_shape(mesh.shape, [&](auto shape) { return ElementTerms<shape>::inertia(mesh, definition); });
}

std::unique_ptr<Term> make_point_mass(const Mesh& mesh, const Tag& tag, int mass) {
  return std::make_unique<PointMass>(mesh, tag, mass);
}

std::unique_ptr<Term> make_viscosity(const Mesh& mesh, const ViscosityDefinition& definition) {
  return with_shape(mesh.shape, [&](auto shape) { return ElementTerms<shape>::viscosity(mesh, definition); });
}

}  // namespace taut
