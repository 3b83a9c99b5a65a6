#include "sim/solve/hessian.hpp"

#include <algorithm>
#include <cmath>

#include "sim/core/numbers.hpp"
#include "sim/core/sorted.hpp"

namespace taut {
namespace {

/// Of the curvature along a direction by one Hessian, to that by another: below it they are quite different.
constexpr double unlike = 0.05;

}  // namespace

Hessian::Hessian(const Model& model)
    : model_(&model),
      reduction_(model),
      pattern_(std::make_unique<SparsePattern>(base())),
      own_(model.pattern().entries() + 1),
      own_cholesky_(*pattern_) {
  if (reduction_.identity()) return;
  model.pattern().each([&](int k, int row, int column) {
    reduction_.spread(row, column, [&](int r, int c, int left, int right, double factor) {
      spreads_.push_back({k, base().slot(r, c), left, right, factor});
    });
  });
}

void Hessian::forget_couplings() {
  if (extra_.empty()) return;
  extra_.clear();
  slots_.clear();
  *pattern_ = base();
  if (grown_) factorisations_ += grown_->factorisations();
  grown_.reset();
  analysed_ = true;
  factorised_ = false;
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
    for (int k = own.columns[column]; k < own.columns[column + 1]; ++k) {
      const int row = own.rows[k];
      for (; next != extra_.end() && next->column == column && next->row < row; ++next)
        pattern_->rows.push_back(next->row);
      slots_[k] = static_cast<int>(pattern_->rows.size());
      pattern_->rows.push_back(row);
    }
    for (; next != extra_.end() && next->column == column; ++next) pattern_->rows.push_back(next->row);
    pattern_->columns.push_back(static_cast<int>(pattern_->rows.size()));
  }
  analysed_ = false;
}

/// T^T H T and the curvature of the rotations, from own_ to reduced_.
void Hessian::reduce(const Point& at, Curvature curvature, const Eigen::VectorXd& gradient,
                     const std::vector<double>& weights) {
  reduced_.assign(base().entries(), 0.0);
  for (const Spread& s : spreads_) {
    reduced_[s.slot] += s.factor * weights[s.left] * weights[s.right] * own_[s.entry];
  }
  for (const Reduction::Curved& c : reduction_.rotations(at.u, gradient, curvature == Curvature::projected))
    reduced_[base().slot(c.row, c.column)] += c.value;
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
    if (pattern_->slot(row, column) < 0) missing.push_back({column, row});
  };
  for (const Coupling& coupling : couplings_) {
    const int row = model_->free_index(coupling.row), column = model_->free_index(coupling.column);
    if (row < 0 || column < 0) continue;
    if (reduction_.identity()) {
      keep(row, column, coupling.value);
      continue;
    }
    reduction_.spread(row, column, [&](int r, int c, int left, int right, double factor) {
      keep(r, c, factor * weights[left] * weights[right] * coupling.value);
    });
  }
  couplings_ = std::move(kept);
  if (!missing.empty()) {
    missing.insert(missing.end(), extra_.begin(), extra_.end());
    sort_unique(missing);
    set_pattern(std::move(missing));
  }
  std::vector<double>& own = reduction_.identity() ? own_ : reduced_;
  if (!slots_.empty()) {
    values_.assign(pattern_->rows.size(), 0.0);
    for (size_t k = 0; k < slots_.size(); ++k) values_[slots_[k]] = own[k];
  }
  std::vector<double>& values = slots_.empty() ? own : values_;
  for (const Coupling& coupling : couplings_) values[pattern_->slot(coupling.row, coupling.column)] += coupling.value;
  return out;
}

bool Hessian::factorise(double shift) {
  if (!analysed_) {
    if (grown_) factorisations_ += grown_->factorisations();
    grown_.emplace(*pattern_);
    analysed_ = true;
  }
  return factorised_ = cholesky().factorise(values(), shift);
}

std::optional<Eigen::VectorXd> Hessian::iterate(const Eigen::VectorXd& b, double tolerance) const {
  if (!factorised_) return std::nullopt;
  Eigen::VectorXd x = Eigen::VectorXd::Zero(b.size()), r = b, d = x;
  double before = infinity, goal = 0;
  for (int iteration = 0; iteration < price(); ++iteration) {
    const Eigen::VectorXd z = solve(r);
    const double now = r.dot(z);
    if (iteration == 0) goal = tolerance * tolerance * now;
    if (now <= goal) return x;
    d = z + now / before * d;
    const Eigen::VectorXd Hd = times(d);
    const double curvature = d.dot(Hd);
    if (!(curvature > 0)) break;
    if (iteration == 0 && now < unlike * curvature) break;
    x += now / curvature * d;
    r -= now / curvature * Hd;
    before = now;
  }
  return std::nullopt;
}

double Hessian::mean_diagonal() const {
  double sum = 0;
  for (int j = 0; j < pattern_->size; ++j) sum += std::abs(values()[pattern_->columns[j]]);
  return sum / std::max(1, pattern_->size);
}

}  // namespace taut
