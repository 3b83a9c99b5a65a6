#include "sim/solve/hessian.hpp"

#include <algorithm>
#include <cmath>

namespace taut {

Hessian::Hessian(const Model& model)
    : model_(&model),
      pattern_(std::make_unique<SparsePattern>(model.pattern())),
      own_(static_cast<size_t>(model.pattern().entries()) + 1),
      cholesky_(*pattern_) {}

void Hessian::forget_couplings() {
  if (!extra_.empty()) set_pattern({});
}

int Hessian::slot_of(int row, int column) const {
  const auto begin = pattern_->rows.begin() + pattern_->columns[static_cast<size_t>(column)];
  const auto end = pattern_->rows.begin() + pattern_->columns[static_cast<size_t>(column) + 1];
  const auto found = std::lower_bound(begin, end, row);
  return found != end && *found == row ? static_cast<int>(found - pattern_->rows.begin()) : -1;
}

void Hessian::set_pattern(std::vector<Place> extra) {
  extra_ = std::move(extra);
  const SparsePattern& own = model_->pattern();
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
  if (extra_.empty()) slots_.clear();
  factorisations_ += cholesky_.factorisations();
  cholesky_ = Cholesky(*pattern_);
}

Assembly Hessian::assemble(const Point& at, Curvature curvature, Eigen::VectorXd* gradient) {
  Assembly out;
  out.gradient = gradient;
  out.hessian = own_.data();
  out.couplings = &couplings_;
  out.curvature = curvature;
  model_->evaluate(at, out);

  // Couplings by free unknowns; those of supports fall away.
  size_t kept = 0;
  std::vector<Place> missing;
  for (const Coupling& coupling : couplings_) {
    const int row = model_->free_index(coupling.row), column = model_->free_index(coupling.column);
    if (row < 0 || column < 0) continue;
    couplings_[kept++] = {row, column, coupling.value};
    if (slot_of(row, column) < 0) missing.push_back({column, row});
  }
  couplings_.resize(kept);
  if (!missing.empty()) {
    missing.insert(missing.end(), extra_.begin(), extra_.end());
    std::sort(missing.begin(), missing.end());
    missing.erase(std::unique(missing.begin(), missing.end()), missing.end());
    set_pattern(std::move(missing));
  }
  if (!slots_.empty()) {
    values_.assign(pattern_->rows.size(), 0.0);
    for (size_t k = 0; k < slots_.size(); ++k) values_[static_cast<size_t>(slots_[k])] = own_[k];
  }
  for (const Coupling& coupling : couplings_) {
    std::vector<double>& values = slots_.empty() ? own_ : values_;
    values[static_cast<size_t>(slot_of(coupling.row, coupling.column))] += coupling.value;
  }
  return out;
}

bool Hessian::factorise(double shift) {
  return cholesky_.factorise(slots_.empty() ? own_ : values_, shift);
}

double Hessian::mean_diagonal() const {
  const std::vector<double>& values = slots_.empty() ? own_ : values_;
  double sum = 0;
  for (int j = 0; j < pattern_->size; ++j)
    sum += std::abs(values[static_cast<size_t>(pattern_->columns[static_cast<size_t>(j)])]);
  return sum / std::max(1, pattern_->size);
}

}  // namespace taut
