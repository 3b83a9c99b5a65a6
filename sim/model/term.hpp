#pragma once
#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "sim/core/parameters.hpp"

namespace taut {

/// Sets of nodes that an energy couples: clique c holds nodes[offsets[c]] ... nodes[offsets[c + 1] - 1], all different.
struct Cliques {
  std::vector<int> offsets{0};
  std::vector<int> nodes;
  int count() const { return static_cast<int>(offsets.size()) - 1; }             ///< number of cliques
  int size(int clique) const { return offsets[clique + 1] - offsets[clique]; }   ///< nodes of one
  const int* begin(int clique) const { return nodes.data() + offsets[clique]; }  ///< its first node
  /// One more clique.
  template <class Range>
  void add(const Range& range) {
    nodes.insert(nodes.end(), std::begin(range), std::end(range));
    offsets.push_back(static_cast<int>(nodes.size()));
  }
};

/// One entry of the Hessian's lower triangle outside the cliques' pattern, by unknowns (row >= column).
struct Coupling {
  int row = 0, column = 0;
  double value = 0;
};

/// Second derivatives as they are, or made positive semi-definite element by element. Only the exact ones are used for
/// sensitivities, tangent stiffness and the test for a minimum.
enum class Curvature { exact, projected };

/// What a time step knows of the past. At its end, where u is searched,
///
///   du/dt = rate[0] u + rate[1] previous + rate[2] before,   and the same for the rate of any function of u,
///   d2u/dt2 = inertia (u - reference).
///
/// Implicit Euler has rate = {1, -1, 0}/h, BDF2 three entries; both have inertia = rate[0]^2. Without inertia and rates
/// it is a stretch of time in quasi-statics, through which only stresses relax.
struct TimeStep {
  double inertia = 0;            ///< [1/s^2]
  Eigen::VectorXd reference;     ///< [m], all unknowns
  std::array<double, 3> rate{};  ///< [1/s]
  Eigen::VectorXd previous;      ///< u one step ago [m]
  Eigen::VectorXd before;        ///< u two steps ago [m]; empty: not used, rate[2] = 0
  double length = 0;             ///< [s]
  Eigen::VectorXd memory = {};   ///< what terms remember at its beginning, (Model::memory_size()); empty: nothing
};

/// The states of the past that an energy in a time step may depend on.
enum class History { reference, previous, before };

/// Where an energy is evaluated: displacements u = x - X [m] of all nodes, stacked node by node, and all parameters;
/// within a time step, that step. In statics there is none, inertia and damping contribute nothing, and nothing
/// relaxes.
struct Point {
  const Eigen::VectorXd& u;  ///< [m], all unknowns
  const Params& p;
  const TimeStep* step = nullptr;
  /// In a step of dynamics, where inertia and damping count.
  bool moves() const { return step != nullptr && (step->inertia != 0 || step->rate[0] != 0); }
};

/// Collects what terms contribute: energy and, where asked for, gradient and Hessian. The Hessian goes into the values
/// of a fixed sparsity pattern (lower triangle, fixed unknowns left out), or, times a direction, into a vector.
class Assembly {
 public:
  double energy = 0;     ///< [J]
  double magnitude = 0;  ///< sum of |contributions| [J]; rounding in `energy` is about epsilon times this
  Eigen::VectorXd* gradient = nullptr;  ///< [N], all unknowns
  double* hessian = nullptr;            ///< [N/m], values of the pattern; one more slot at the end takes the rest
  std::vector<Coupling>* couplings = nullptr;  ///< with `hessian`: entries between nodes that no clique declares
  const Eigen::VectorXd* direction = nullptr;  ///< all unknowns; with it `product` receives Hessian * direction
  Eigen::VectorXd* product = nullptr;
  Curvature curvature = Curvature::exact;

  /// As a matrix, or times a direction.
  bool wants_hessian() const { return hessian != nullptr || product != nullptr; }

  /// And to the magnitude.
  void add_energy(double value) {
    energy += value;
    magnitude += std::abs(value);
  }

  /// Adds an element's gradient; `g` holds `dimension` entries per node.
  void add_gradient(const int* nodes, int count, int dimension, const double* g) {
    for (int a = 0; a < count; ++a) {
      for (int i = 0; i < dimension; ++i) (*gradient)[nodes[a] * dimension + i] += g[a * dimension + i];
    }
  }

  /// Adds an element's symmetric Hessian `K`, (n x n) with n = count * dimension, of clique `clique` of the term at
  /// work.
  void add_hessian(int clique, const int* nodes, int count, int dimension, const double* K) {
    const int n = count * dimension;
    if (hessian != nullptr) {
      const int* slot = slots_ + slot_offsets_[clique];
      for (int r = 0; r < n; ++r) {
        for (int c = 0; c <= r; ++c) hessian[*slot++] += K[r * n + c];
      }
    }
    if (product != nullptr) add_product(nodes, count, dimension, K);
  }

  /// The same for nodes that come together only in some states (contact): not of a clique, all different.
  void add_coupling(const int* nodes, int count, int dimension, const double* K) {
    const int n = count * dimension;
    if (couplings != nullptr) {
      for (int r = 0; r < n; ++r) {
        for (int c = 0; c <= r; ++c) {
          const int one = nodes[r / dimension] * dimension + r % dimension;
          const int two = nodes[c / dimension] * dimension + c % dimension;
          couplings->push_back({std::max(one, two), std::min(one, two), K[r * n + c]});
        }
      }
    }
    if (product != nullptr) add_product(nodes, count, dimension, K);
  }

  /// Set by the model before each term: where the entries of its cliques' Hessians go.
  void use_slots(const int* slots, const size_t* offsets) {
    slots_ = slots;
    slot_offsets_ = offsets;
  }

 private:
  void add_product(const int* nodes, int count, int dimension, const double* K) {
    const int n = count * dimension;
    for (int r = 0; r < n; ++r) {
      double sum = 0;
      for (int c = 0; c < n; ++c) sum += K[r * n + c] * (*direction)[nodes[c / dimension] * dimension + c % dimension];
      (*product)[nodes[r / dimension] * dimension + r % dimension] += sum;
    }
  }

  const int* slots_ = nullptr;
  const size_t* slot_offsets_ = nullptr;
};

/// One energy in joules, a pure function E(u; p) of displacements and parameters, with all its derivatives. Everything
/// physical is a term: solids, loads, self-weight, cables, contact.
class Term {
 public:
  virtual ~Term() = default;
  /// The node sets whose unknowns this energy couples; linear energies have none.
  virtual Cliques cliques() const { return {}; }
  /// Adds energy, gradient dE/du [N] and Hessian d2E/du2 [N/m] as the assembly asks. An inadmissible state has energy
  /// +inf and may leave the derivatives unfinished.
  virtual void assemble(const Point& at, Assembly& out) const = 0;
  /// Whether E depends on parameter `index` of the model's table.
  virtual bool depends_on(int index) const = 0;
  /// Largest fraction in [0, 1] of the straight way from u to u + step that stays admissible (contact: nothing passes
  /// through anything). 1 means that the whole way does.
  virtual double step_limit(const Point&, const Eigen::VectorXd& /*step*/) const { return 1.0; }
  /// Adds the mixed derivative d2E/du dp_index [N per unit of the parameter] to `out`, all unknowns.
  virtual void add_parameter_gradient(const Point& at, int index, Eigen::VectorXd& out) const = 0;
  /// Adds G x to `out`, or G^T x when `transposed`, with G = d2E/du dq the mixed derivative with respect to a state q
  /// of the past; all unknowns. Nothing for energies without memory.
  virtual void add_history_product(const Point&, History /*q*/, const Eigen::VectorXd& /*x*/, bool /*transposed*/,
                                   Eigen::VectorXd& /*out*/) const {}
  /// Tells an energy with internal state where its part of TimeStep::memory begins, before all else; returns how many
  /// numbers that is.
  virtual int place_memory(int /*first*/) { return 0; }
  /// Writes that part at the end of the step, where u is its solution.
  virtual void remember(const Point&, Eigen::VectorXd& /*next*/) const {}
  /// Adds the mixed derivative of E with respect to u and to the memory at the step's beginning, times `change` of
  /// that.
  virtual void add_memory_product(const Point&, const Eigen::VectorXd& /*change*/, Eigen::VectorXd& /*out*/) const {}
  /// Writes the change of remember() where u, the parameters and the memory change by du, dp and dmemory.
  virtual void remember_change(const Point&, const Eigen::VectorXd& /*du*/, const Params& /*dp*/,
                               const Eigen::VectorXd& /*dmemory*/, Eigen::VectorXd& /*next*/) const {}
  /// Whether this is the inertia of a time step; its Hessian over step->inertia is then the mass matrix.
  virtual bool is_inertia() const { return false; }
};

}  // namespace taut
