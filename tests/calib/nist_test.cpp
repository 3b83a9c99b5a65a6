#include "tests/support/nist.hpp"

#include <gtest/gtest.h>

#include "tests/support/closed_form_protocol.hpp"

namespace taut {
namespace {

using namespace test;

ClosedFormProtocol protocol_of(const NistProblem& problem) {
  std::vector<std::pair<ParameterSpec, double>> parameters;
  for (size_t j = 0; j < problem.certified.size(); ++j) {
    ParameterSpec spec = plain("b" + std::to_string(j + 1));
    spec.lower = -std::numeric_limits<double>::infinity();
    spec.upper = std::numeric_limits<double>::infinity();
    parameters.emplace_back(spec, problem.start1[j]);
  }
  const auto rows = static_cast<Eigen::Index>(problem.yx.size() / 2);
  const auto b_of = [](const Params& p) { return std::vector<double>(p.data(), p.data() + p.size()); };
  const auto x_of = [problem](Eigen::Index i) { return problem.yx[2 * static_cast<size_t>(i) + 1]; };
  return {parameters,
          [=](const Params& p) {
            Eigen::VectorXd y(rows);
            for (Eigen::Index i = 0; i < rows; ++i) y[i] = problem.y(x_of(i), b_of(p));
            return y;
          },
          [=](const Params& p) {
            Eigen::MatrixXd D(rows, p.size());
            for (Eigen::Index i = 0; i < rows; ++i) {
              const std::vector<double> row = problem.dy(x_of(i), b_of(p));
              D.row(i) = Eigen::Map<const Eigen::RowVectorXd>(row.data(), p.size());
            }
            return D;
          }};
}

/// Digits in which `value` agrees with `certified` (NIST's log relative error).
double digits(double value, double certified) {
  return -std::log10(std::max(std::abs(value / certified - 1), 1e-16));
}

class NistCertified : public testing::TestWithParam<NistProblem (*)()> {};

TEST_P(NistCertified, ParametersAndStandardDeviationsAreReachedToSixDigitsFromBothStarts) {
  const NistProblem problem = GetParam()();
  std::vector<Measurement> measurements;
  for (size_t i = 0; i < problem.yx.size() / 2; ++i) {
    measurements.push_back({static_cast<int>(i), problem.yx[2 * i], problem.residual_sd, static_cast<int>(i)});
  }
  for (const std::vector<double>* start : {&problem.start1, &problem.start2}) {
    ClosedFormProtocol protocol = protocol_of(problem);
    std::vector<FreeParameter> free;
    for (size_t j = 0; j < start->size(); ++j) {
      const ParameterSpec& spec = protocol.parameters()[static_cast<int>(j)];
      free.push_back({static_cast<int>(j), (*start)[j], spec.lower, spec.upper});
    }
    FitOptions options;
    options.max_iterations = 1000;
    options.tolerance = 1e-15;
    const FitResult result = fit(protocol, measurements, free, options);
    const std::string what = problem.name + (start == &problem.start1 ? ", start 1" : ", start 2");
    EXPECT_EQ(result.status, FitStatus::converged) << what << ": " << result.message;
    for (size_t j = 0; j < free.size(); ++j) {
      const ParameterEstimate& estimate = result.parameters[j];
      EXPECT_GE(digits(estimate.value, problem.certified[j]), 6) << what << ", " << estimate.spec.id;
      EXPECT_GE(digits(estimate.standard_error, problem.certified_sd[j]), 6) << what << ", " << estimate.spec.id;
    }
    const double sum_of_squares = result.chi_squared * problem.residual_sd * problem.residual_sd;
    EXPECT_GE(digits(sum_of_squares, problem.residual_sum_of_squares), 8) << what;
    EXPECT_NEAR(result.chi_squared, result.dof, 1e-6 * result.dof) << what << ": sigma is the residual deviation";
  }
}

INSTANTIATE_TEST_SUITE_P(Strd, NistCertified, testing::Values(&misra1a, &chwirut2, &hahn1),
                         [](const auto& problem) { return problem.param().name; });

}  // namespace
}  // namespace taut
