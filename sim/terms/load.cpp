#include "sim/terms/load.hpp"

#include <algorithm>

namespace taut {
namespace {

class Load final : public Term {
 public:
  Load(Eigen::VectorXd weights, std::vector<int> factors)
      : weights_(std::move(weights)), factors_(std::move(factors)) {}

  void assemble(const Point& at, Assembly& out) const override {
    const double value = product_without(at.p, -1);
    out.add_energy(-value * weights_.dot(at.u));
    if (out.gradient != nullptr) *out.gradient -= value * weights_;
  }
  bool depends_on(int index) const override {
    return std::find(factors_.begin(), factors_.end(), index) != factors_.end();
  }
  void add_parameter_gradient(const Point& at, int index, Eigen::VectorXd& out) const override {
    for (size_t k = 0; k < factors_.size(); ++k) {
      if (factors_[k] == index) out -= product_without(at.p, static_cast<int>(k)) * weights_;
    }
  }

 private:
  double product_without(const Params& p, int left_out) const {
    double product = 1;
    for (size_t k = 0; k < factors_.size(); ++k) {
      if (static_cast<int>(k) != left_out) product *= p[factors_[k]];
    }
    return product;
  }

  Eigen::VectorXd weights_;
  std::vector<int> factors_;
};

}  // namespace

std::unique_ptr<Term> make_load(Eigen::VectorXd weights, std::vector<int> factors) {
  return std::make_unique<Load>(std::move(weights), std::move(factors));
}

}  // namespace taut
