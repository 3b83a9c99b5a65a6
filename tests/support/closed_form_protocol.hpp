#pragma once
#include <functional>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "calib/fit/fit.hpp"
#include "calib/fit/protocol.hpp"

namespace taut::test {

/// A protocol made from formulas: y(p), one entry per row, and dy/dp, rows x all parameters. `fails` says where in
/// parameter space the simulation fails (a sentence) and where it does not ("").
class ClosedFormProtocol final : public Protocol {
 public:
  using Values = std::function<Eigen::VectorXd(const Params&)>;
  using Derivatives = std::function<Eigen::MatrixXd(const Params&)>;

  ClosedFormProtocol(const std::vector<std::pair<ParameterSpec, double>>& parameters, Values y, Derivatives dy)
      : y_(std::move(y)), dy_(std::move(dy)), nominal_(static_cast<Eigen::Index>(parameters.size())) {
    for (const auto& [spec, value] : parameters) nominal_[table_.declare(spec)] = value;
    rows_ = static_cast<int>(y_(nominal_).size());
  }

  const ParameterTable& parameters() const override { return table_; }
  const Params& nominal() const override { return nominal_; }
  int row_count() const override { return rows_; }

  Prediction predict(const Params& p, const std::vector<int>& free) override {
    ++calls;
    Prediction prediction;
    const std::string failure = fails ? fails(p) : "";
    const double nan = std::numeric_limits<double>::quiet_NaN();
    prediction.values = failure.empty() ? y_(p) : Eigen::VectorXd::Constant(rows_, nan).eval();
    prediction.derivatives.resize(rows_, static_cast<Eigen::Index>(free.size()));
    const Eigen::MatrixXd all = dy_(p);
    for (size_t j = 0; j < free.size(); ++j)
      prediction.derivatives.col(static_cast<Eigen::Index>(j)) = all.col(free[j]);
    if (!failure.empty()) {
      prediction.derivatives.setConstant(nan);
      prediction.failures.push_back(failure);
    }
    return prediction;
  }
  void forget() override { ++forgotten; }

  std::function<std::string(const Params&)> fails;
  int calls = 0, forgotten = 0;

 private:
  Values y_;
  Derivatives dy_;
  ParameterTable table_;
  Params nominal_;
  int rows_ = 0;
};

/// A modulus [Pa], fitted as its logarithm, and a plain number.
inline ParameterSpec modulus(const std::string& id) {
  return {id, id, "Pa", 1, 1e13, "modulus " + id, true};
}
inline ParameterSpec plain(const std::string& id) {
  return {id, id, "1", -1e9, 1e9, "number " + id};
}

/// One measurement per row, each its own group.
inline std::vector<Measurement> measured(const Eigen::VectorXd& values, double sigma) {
  std::vector<Measurement> measurements;
  for (int row = 0; row < values.size(); ++row) measurements.push_back({row, values[row], sigma, row});
  return measurements;
}

/// y = c asinh(F / E) at five loads F: a spring that stiffens. E is a modulus, c a plain number.
inline const Eigen::VectorXd spring_loads = Eigen::VectorXd::LinSpaced(5, 0.5, 4.5);
inline ClosedFormProtocol stiffening_spring(double E = 1000, double c = 0.01) {
  return {{{modulus("E"), E}, {plain("c"), c}},
          [](const Params& p) -> Eigen::VectorXd {
            return p[1] * (1e3 * spring_loads / p[0]).array().unaryExpr([](double s) { return std::asinh(s); });
          },
          [](const Params& p) {
            Eigen::MatrixXd D(spring_loads.size(), 2);
            for (Eigen::Index i = 0; i < D.rows(); ++i) {
              const double s = 1e3 * spring_loads[i] / p[0];
              D.row(i) << -p[1] * s / p[0] / std::sqrt(1 + s * s), std::asinh(s);
            }
            return D;
          }};
}

/// y = a + b x.
inline ClosedFormProtocol straight_line(const Eigen::VectorXd& x, double a = 0, double b = 0) {
  return {{{plain("a"), a}, {plain("b"), b}},
          [x](const Params& p) -> Eigen::VectorXd { return p[0] + p[1] * x.array(); },
          [x](const Params&) {
            Eigen::MatrixXd D(x.size(), 2);
            D << Eigen::VectorXd::Ones(x.size()), x;
            return D;
          }};
}

}  // namespace taut::test
