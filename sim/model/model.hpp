#pragma once
#include <algorithm>
#include <memory>
#include <string>
#include <vector>

#include "sim/core/parameters.hpp"
#include "sim/mesh/mesh.hpp"
#include "sim/model/term.hpp"

namespace taut {

/// A prescribed displacement component: u[dof] = coefficient * p[parameter], or 0 when there is no parameter.
struct Support {
  int dof = 0;         ///< node * dimension + component
  int parameter = -1;  ///< index into the table, -1 for a clamp
  double coefficient = 0;
};

/// A connected piece of one material, and the table index of its Young's modulus.
struct Body {
  std::vector<int> nodes;
  int modulus = -1;                           ///< -1: rigid, see SceneBuilder::add_rigid
  bool supported = false;                     ///< a support prescribes some of its displacements
  bool rigid() const { return modulus < 0; }  ///< see modulus
};

/// A connected piece of the mesh that supports do not hold by themselves: cables or contact have to, which only an
/// equilibrium tells.
struct LooseBody {
  std::string name;  ///< for people: "body 'platform'"
  std::vector<int> nodes;
};

/// Sparsity pattern of the Hessian on the free unknowns: lower triangle, compressed columns, rows ascending.
struct SparsePattern {
  int size = 0;
  std::vector<int> columns;  ///< size + 1 offsets
  std::vector<int> rows;
  int entries() const { return columns.empty() ? 0 : columns.back(); }  ///< entries of the lower triangle
  /// Where an entry is stored; -1: nowhere.
  int slot(int row, int column) const {
    const auto begin = rows.begin() + columns[column], end = rows.begin() + columns[column + 1];
    const auto found = std::lower_bound(begin, end, row);
    return found != end && *found == row ? static_cast<int>(found - rows.begin()) : -1;
  }
  /// action(slot, row, column) for all entries in their order.
  template <class Action>
  void each(Action&& action) const {
    for (int column = 0; column < size; ++column) {
      for (int k = columns[column]; k < columns[column + 1]; ++k) action(k, rows[k], column);
    }
  }
  /// The symmetric matrix with these values times x.
  Eigen::VectorXd times(const std::vector<double>& values, const Eigen::VectorXd& x) const {
    Eigen::VectorXd y = Eigen::VectorXd::Zero(x.size());
    each([&](int k, int row, int column) {
      y[row] += values[k] * x[column];
      if (row != column) y[column] += values[k] * x[row];
    });
    return y;
  }
};

/// Pi(u; p) = sum of terms, on a mesh, with supports. Complete and immutable from its construction on, so any number of
/// threads may evaluate it at once.
class Model {
 public:
  /// Throws std::logic_error when a displacement component is prescribed twice.
  Model(Mesh mesh, ParameterTable parameters, std::vector<std::unique_ptr<Term>> terms, std::vector<Support> supports,
        std::vector<Body> bodies = {}, std::vector<LooseBody> loose = {});

  /// `base` with one more term, all else shared or copied.
  Model(const Model& base, std::unique_ptr<Term> more);

  const Mesh& mesh() const { return mesh_; }                         ///< at rest
  const ParameterTable& parameters() const { return parameters_; }   ///< all numbers that it depends on
  int unknowns() const { return static_cast<int>(mesh_.X.size()); }  ///< all displacement components
  int free_unknowns() const { return pattern_.size; }                ///< without the supported ones
  const SparsePattern& pattern() const { return pattern_; }          ///< of the Hessian, without couplings by contact
  double length_scale() const { return length_scale_; }              ///< diagonal of the bounding box [m]
  const std::vector<Body>& bodies() const { return bodies_; }        ///< see Body; empty: none are told apart
  const std::vector<LooseBody>& loose_bodies() const { return loose_; }  ///< see LooseBody; none: supports hold all
  /// Index of an unknown among the free ones, -1 when it is supported.
  int free_index(int unknown) const { return free_index_[unknown]; }

  /// Energy, and the derivatives that `out` asks for (cleared first).
  void evaluate(const Point& at, Assembly& out) const { evaluate(at, out, false); }
  /// Largest fraction in [0, 1] of the straight way from at.u to at.u + step on which nothing passes through anything.
  double step_limit(const Point& at, const Eigen::VectorXd& step) const;
  /// d2Pi/du dp_index on all unknowns [N per unit].
  Eigen::VectorXd parameter_gradient(const Point& at, int index) const;
  /// Mixed derivative of the gradient with respect to a state of the past times x, or its transpose times x.
  Eigen::VectorXd history_product(const Point& at, History q, const Eigen::VectorXd& x, bool transposed) const;
  /// How many numbers all terms together remember of the past (TimeStep::memory); of nothing they are zero.
  int memory_size() const { return memory_size_; }
  /// What they remember at the end of a step whose solution is at.u. Zeros without a step.
  Eigen::VectorXd remember(const Point& at) const;
  /// Derivative of the gradient with respect to the memory at the step's beginning times `change`, all unknowns.
  Eigen::VectorXd memory_product(const Point& at, const Eigen::VectorXd& change) const;
  /// Derivatives of remember() where u, the parameters and the memory at the step's beginning change like columns of
  /// du, dp and dmemory, shape (memory_size() x columns).
  Eigen::MatrixXd remember_change(const Point& at, const Eigen::MatrixXd& du, const Eigen::MatrixXd& dp,
                                  const Eigen::MatrixXd& dmemory) const;
  /// Inertia alone: evaluate() over the terms that say so. With step->inertia = 1, damping zero and step->reference =
  /// u - v its energy is the kinetic energy of v and its Hessian the mass matrix [kg].
  void evaluate_inertia(const Point& at, Assembly& out) const { evaluate(at, out, true); }
  /// Hessian at `at` times `direction`, all unknowns, exact curvature.
  Eigen::VectorXd hessian_times(const Point& at, const Eigen::VectorXd& direction) const;

  /// Sets the supported components of u to what p prescribes.
  void impose_supports(const Params& p, Eigen::VectorXd& u) const;
  /// Whether a support stands elsewhere at `b` than at `a`.
  bool support_moves(const Params& a, const Params& b) const;
  /// Derivative of the supported components with respect to p[index], zero elsewhere; all unknowns.
  Eigen::VectorXd support_derivative(int index) const;
  Eigen::VectorXd restrict_to_free(const Eigen::VectorXd& all) const;  ///< entries of free unknowns, in their order
  /// Free entries into a vector of all unknowns, zero at the supports.
  Eigen::VectorXd extend_from_free(const Eigen::VectorXd& free) const;

 private:
  struct Slots {
    std::vector<int> slots;
    std::vector<size_t> offsets;
  };
  void build_pattern();
  void evaluate(const Point& at, Assembly& out, bool inertia_only) const;

  Mesh mesh_;
  ParameterTable parameters_;
  std::vector<std::shared_ptr<const Term>> terms_;  ///< shared with models of one more
  std::vector<Support> supports_;
  std::vector<Body> bodies_;
  std::vector<LooseBody> loose_;
  std::vector<int> free_index_;  ///< per unknown: index among the free ones or -1
  std::vector<int> free_;        ///< unknown of each free index
  std::vector<Slots> slots_;     ///< per term
  SparsePattern pattern_;
  double length_scale_ = 0;
  int memory_size_ = 0;
};

}  // namespace taut
