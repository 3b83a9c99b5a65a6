#include "sim/solve/hessian.hpp"

#include <algorithm>
#include <cmath>

namespace taut {

namespace {

/// Where an entry of the lower triangle is stored; -1: nowhere.
int slot_in(const SparsePattern& pattern, int row, int column) {
  const auto begin = pattern.rows.begin() + pattern.columns[static_cast<size_t>(column)];
  const auto end = pattern.rows.begin() + pattern.columns[static_cast<size_t>(column) + 1];
  const auto found = std::lower_bound(begin, end, row);
  return found != end && *found == row ? static_cast<int>(found - pattern.rows.begin()) : -1;
}

}  // namespace

Hessian::Hessian(const Model& model)
    : model_(&model),
      reduction_(model),
      pattern_(std::make_unique<SparsePattern>(base())),
      own_(static_cast<size_t>(model.pattern().entries()) + 1),
      own_cholesky_(*pattern_) {
  if (reduction_.identity()) return;
  const SparsePattern& whole = model.pattern();
  for (int j = 0; j < whole.size; ++j) {
    for (int k = whole.columns[static_cast<size_t>(j)]; k < whole.columns[static_cast<size_t>(j) + 1]; ++k) {
      reduction_.spread(whole.rows[static_cast<size_t>(k)], j,
                        [&](int row, int column, int left, int right, double factor) {
                          spreads_.push_back({k, slot_in(base(), row, column), left, right, factor});
                        });
    }
  }
}

void Hessian::forget_couplings() {
  if (extra_.empty()) return;
  extra_.clear();
  slots_.clear();
  *pattern_ = base();
  factorisations_ += grown_->factorisations();
  grown_.reset();
}

std::vector<std::array<int, 2>> Hessian::couplings() const {
  std::vector<std::array<int, 2>> couplings;
  for (const Place& place : extra_) couplings.push_back({place.row, place.column});
  return couplings;
}

void Hessian::expect(const std::vector<std::array<int, 2>>& couplings) {
  forget_couplings();
  if (couplings.empty()) return;
  std::vector<Place> extra;
  for (const auto& [row, column] : couplings) extra.push_back({column, row});
  set_pattern(std::move(extra));
}

const std::vector<double>& Hessian::values() const {
  return !slots_.empty() ? values_ : reduction_.identity() ? own_ : reduced_;
}

void Hessian::set_pattern(std::vector<Place> extra) {
  extra_ = std::move(extra);
  const SparsePattern& own = base();
  pattern_->size = own.size;
  pattern_->columns.assign(1, 0);
  pattern_->rows.clear();
  slots_.assign(own.rows.size(), 0);
  auto next = extra_.begin();
  for (int column = 0; column < own.size; ++column) {
    for (int k = own.columns[static_cast<size_t>(column)]; k < own.columns[static_cast<size_t>(column) + 1]; ++k) {
      const int row = own.rows[static_cast<size_t>(k)];
      for (; next != extra_.end() && next->column == column && next->row < row; ++next)
        pattern_->rows.push_back(next->row);
      slots_[static_cast<size_t>(k)] = static_cast<int>(pattern_->rows.size());
      pattern_->rows.push_back(row);
    }
    for (; next != extra_.end() && next->column == column; ++next) pattern_->rows.push_back(next->row);
    pattern_->columns.push_back(static_cast<int>(pattern_->rows.size()));
  }
  if (grown_) factorisations_ += grown_->factorisations();
  grown_.emplace(*pattern_);
}

/// T^T H T and the curvature of the rotations, from own_ to reduced_.
void Hessian::reduce(const Point& at, Curvature curvature, const Eigen::VectorXd& gradient,
                     const std::vector<double>& weights) {
  reduced_.assign(static_cast<size_t>(base().entries()), 0.0);
  for (const Spread& s : spreads_) {
    reduced_[static_cast<size_t>(s.slot)] += s.factor * weights[static_cast<size_t>(s.left)] *
                                             weights[static_cast<size_t>(s.right)] * own_[static_cast<size_t>(s.entry)];
  }
  for (const Reduction::Curved& c : reduction_.rotations(at.u, gradient, curvature == Curvature::projected))
    reduced_[static_cast<size_t>(slot_in(base(), c.row, c.column))] += c.value;
}

Assembly Hessian::assemble(const Point& at, Curvature curvature, Eigen::VectorXd* gradient) {
  Eigen::VectorXd own_gradient;
  Assembly out;
  out.gradient = gradient == nullptr && !reduction_.identity() ? &own_gradient : gradient;
  out.hessian = own_.data();
  out.couplings = &couplings_;
  out.curvature = curvature;
  model_->evaluate(at, out);

  const std::vector<double> weights = reduction_.identity() ? std::vector<double>() : reduction_.weights(at.u);
  if (!reduction_.identity()) reduce(at, curvature, *out.gradient, weights);
  out.gradient = gradient;

  // Couplings by the unknowns that they end in; those of supports fall away.
  std::vector<Coupling> kept;
  std::vector<Place> missing;
  const auto keep = [&](int row, int column, double value) {
    kept.push_back({row, column, value});
    if (slot_in(*pattern_, row, column) < 0) missing.push_back({column, row});
  };
  for (const Coupling& coupling : couplings_) {
    const int row = model_->free_index(coupling.row), column = model_->free_index(coupling.column);
    if (row < 0 || column < 0) continue;
    if (reduction_.identity()) {
      keep(row, column, coupling.value);
      continue;
    }
    reduction_.spread(row, column, [&](int r, int c, int left, int right, double factor) {
      keep(r, c, factor * weights[static_cast<size_t>(left)] * weights[static_cast<size_t>(right)] * coupling.value);
    });
  }
  couplings_ = std::move(kept);
  if (!missing.empty()) {
    missing.insert(missing.end(), extra_.begin(), extra_.end());
    std::sort(missing.begin(), missing.end());
    missing.erase(std::unique(missing.begin(), missing.end()), missing.end());
    set_pattern(std::move(missing));
  }
  std::vector<double>& own = reduction_.identity() ? own_ : reduced_;
  if (!slots_.empty()) {
    values_.assign(pattern_->rows.size(), 0.0);
    for (size_t k = 0; k < slots_.size(); ++k) values_[static_cast<size_t>(slots_[k])] = own[k];
  }
  std::vector<double>& values = slots_.empty() ? own : values_;
  for (const Coupling& coupling : couplings_)
    values[static_cast<size_t>(slot_in(*pattern_, coupling.row, coupling.column))] += coupling.value;
  return out;
}

bool Hessian::factorise(double shift) {
  return (grown_ ? *grown_ : own_cholesky_).factorise(values(), shift);
}

Eigen::VectorXd Hessian::times(const Eigen::VectorXd& q) const {
  Eigen::VectorXd product = Eigen::VectorXd::Zero(q.size());
  for (int j = 0; j < pattern_->size; ++j) {
    for (int k = pattern_->columns[static_cast<size_t>(j)]; k < pattern_->columns[static_cast<size_t>(j) + 1]; ++k) {
      const int i = pattern_->rows[static_cast<size_t>(k)];
      const double value = values()[static_cast<size_t>(k)];
      product[i] += value * q[j];
      if (i != j) product[j] += value * q[i];
    }
  }
  return product;
}

double Hessian::mean_diagonal() const {
  double sum = 0;
  for (int j = 0; j < pattern_->size; ++j)
    sum += std::abs(values()[static_cast<size_t>(pattern_->columns[static_cast<size_t>(j)])]);
  return sum / std::max(1, pattern_->size);
}

}  // namespace taut
