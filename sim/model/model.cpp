#include "sim/model/model.hpp"

#include <algorithm>
#include <stdexcept>

#include "sim/core/sorted.hpp"

namespace taut {

Model::Model(Mesh mesh, ParameterTable parameters, std::vector<std::unique_ptr<Term>> terms,
             std::vector<Support> supports, std::vector<Body> bodies, std::vector<LooseBody> loose)
    : mesh_(std::move(mesh)),
      parameters_(std::move(parameters)),
      supports_(std::move(supports)),
      bodies_(std::move(bodies)),
      loose_(std::move(loose)) {
  length_scale_ = mesh_.diagonal();
  for (std::unique_ptr<Term>& term : terms) {
    memory_size_ += term->place_memory(memory_size_);
    terms_.push_back(std::move(term));
  }
  std::vector<bool> fixed(unknowns(), false);
  for (const Support& support : supports_) {
    if (fixed[support.dof]) throw std::logic_error("a displacement component is prescribed twice");
    fixed[support.dof] = true;
  }
  free_index_.assign(unknowns(), -1);
  for (int i = 0; i < unknowns(); ++i) {
    if (fixed[i]) continue;
    free_index_[i] = static_cast<int>(free_.size());
    free_.push_back(i);
  }
  build_pattern();
}

Model::Model(const Model& base, std::unique_ptr<Term> more) : Model(base) {
  memory_size_ += more->place_memory(memory_size_);
  terms_.push_back(std::move(more));
  slots_.clear();
  pattern_ = {};
  build_pattern();
}

void Model::build_pattern() {
  const int d = mesh_.dimension(), nodes = mesh_.node_count();
  std::vector<Cliques> cliques;
  for (const auto& term : terms_) cliques.push_back(term->cliques());

  // Nodes per node, neighbours with a higher number only: columns of the lower triangle.
  std::vector<std::vector<int>> neighbours(nodes);
  for (const Cliques& list : cliques) {
    for (int c = 0; c < list.count(); ++c) {
      const int* node = list.begin(c);
      for (int a = 0; a < list.size(c); ++a) {
        for (int b = 0; b < list.size(c); ++b) {
          if (node[b] > node[a]) neighbours[node[a]].push_back(node[b]);
        }
      }
    }
  }
  for (auto& list : neighbours) sort_unique(list);

  auto free_of = [&](int node, int i) { return free_index_[node * d + i]; };
  pattern_.size = static_cast<int>(free_.size());
  pattern_.columns.assign(1, 0);
  for (int node = 0; node < nodes; ++node) {
    for (int i = 0; i < d; ++i) {
      if (free_of(node, i) < 0) continue;
      for (int k = i; k < d; ++k) {
        if (free_of(node, k) >= 0) pattern_.rows.push_back(free_of(node, k));
      }
      for (int other : neighbours[node]) {
        for (int k = 0; k < d; ++k) {
          if (free_of(other, k) >= 0) pattern_.rows.push_back(free_of(other, k));
        }
      }
      pattern_.columns.push_back(static_cast<int>(pattern_.rows.size()));
    }
  }

  const int nowhere = pattern_.entries();  // the extra slot for entries of fixed unknowns
  auto slot_of = [&](int one, int two) {
    if (one < 0 || two < 0) return nowhere;
    return pattern_.slot(std::max(one, two), std::min(one, two));
  };
  for (const Cliques& list : cliques) {
    Slots& slots = slots_.emplace_back();
    slots.offsets.push_back(0);
    for (int c = 0; c < list.count(); ++c) {
      const int* node = list.begin(c);
      const int n = list.size(c) * d;
      for (int r = 0; r < n; ++r) {
        for (int k = 0; k <= r; ++k)
          slots.slots.push_back(slot_of(free_of(node[r / d], r % d), free_of(node[k / d], k % d)));
      }
      slots.offsets.push_back(slots.slots.size());
    }
  }
}

void Model::evaluate(const Point& at, Assembly& out, bool inertia_only) const {
  out.energy = out.magnitude = 0;
  if (out.gradient != nullptr) out.gradient->setZero(unknowns());
  if (out.hessian != nullptr) std::fill_n(out.hessian, pattern_.entries() + 1, 0.0);
  if (out.couplings != nullptr) out.couplings->clear();
  if (out.product != nullptr) out.product->setZero(unknowns());
  for (size_t k = 0; k < terms_.size(); ++k) {
    if (inertia_only && !terms_[k]->is_inertia()) continue;
    out.use_slots(slots_[k].slots.data(), slots_[k].offsets.data());
    terms_[k]->assemble(at, out);
    if (!std::isfinite(out.energy)) return;
  }
}

double Model::step_limit(const Point& at, const Eigen::VectorXd& step) const {
  double limit = 1;
  for (const auto& term : terms_) limit = std::min(limit, term->step_limit(at, step));
  return limit;
}

Eigen::VectorXd Model::parameter_gradient(const Point& at, int index) const {
  Eigen::VectorXd gradient = Eigen::VectorXd::Zero(unknowns());
  for (const auto& term : terms_) {
    if (term->depends_on(index)) term->add_parameter_gradient(at, index, gradient);
  }
  return gradient;
}

Eigen::VectorXd Model::history_product(const Point& at, History q, const Eigen::VectorXd& x, bool transposed) const {
  Eigen::VectorXd product = Eigen::VectorXd::Zero(unknowns());
  for (const auto& term : terms_) term->add_history_product(at, q, x, transposed, product);
  return product;
}

Eigen::VectorXd Model::remember(const Point& at) const {
  Eigen::VectorXd next = Eigen::VectorXd::Zero(memory_size_);
  for (const auto& term : terms_) term->remember(at, next);
  return next;
}

Eigen::VectorXd Model::memory_product(const Point& at, const Eigen::VectorXd& change) const {
  Eigen::VectorXd product = Eigen::VectorXd::Zero(unknowns());
  for (const auto& term : terms_) term->add_memory_product(at, change, product);
  return product;
}

Eigen::MatrixXd Model::remember_change(const Point& at, const Eigen::MatrixXd& du, const Eigen::MatrixXd& dp,
                                       const Eigen::MatrixXd& dmemory) const {
  Eigen::MatrixXd next(memory_size_, du.cols());
  for (Eigen::Index j = 0; j < du.cols(); ++j) {
    Eigen::VectorXd column = Eigen::VectorXd::Zero(memory_size_);
    for (const auto& term : terms_) term->remember_change(at, du.col(j), dp.col(j), dmemory.col(j), column);
    next.col(j) = column;
  }
  return next;
}

Eigen::VectorXd Model::hessian_times(const Point& at, const Eigen::VectorXd& direction) const {
  Eigen::VectorXd product;
  Assembly out;
  out.direction = &direction;
  out.product = &product;
  evaluate(at, out);
  return product;
}

void Model::impose_supports(const Params& p, Eigen::VectorXd& u) const {
  for (const Support& support : supports_)
    u[support.dof] = support.parameter < 0 ? 0.0 : support.coefficient * p[support.parameter];
}

bool Model::support_moves(const Params& a, const Params& b) const {
  return std::any_of(supports_.begin(), supports_.end(), [&](const Support& support) {
    return support.parameter >= 0 && support.coefficient != 0 && a[support.parameter] != b[support.parameter];
  });
}

Eigen::VectorXd Model::support_derivative(int index) const {
  Eigen::VectorXd derivative = Eigen::VectorXd::Zero(unknowns());
  for (const Support& support : supports_) {
    if (support.parameter == index) derivative[support.dof] = support.coefficient;
  }
  return derivative;
}

Eigen::VectorXd Model::restrict_to_free(const Eigen::VectorXd& all) const {
  Eigen::VectorXd free(free_.size());
  for (size_t i = 0; i < free_.size(); ++i) free[i] = all[free_[i]];
  return free;
}

Eigen::VectorXd Model::extend_from_free(const Eigen::VectorXd& free) const {
  Eigen::VectorXd all = Eigen::VectorXd::Zero(unknowns());
  for (size_t i = 0; i < free_.size(); ++i) all[free_[i]] = free[i];
  return all;
}

}  // namespace taut
