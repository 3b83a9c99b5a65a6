#include "calib/fit/distributions.hpp"

#include <algorithm>
#include <boost/math/distributions/chi_squared.hpp>
#include <boost/math/distributions/fisher_f.hpp>
#include <boost/math/distributions/normal.hpp>
#include <boost/math/distributions/students_t.hpp>
#include <cmath>

namespace taut {

double chi_squared_probability(double value, double dof) {
  return dof > 0 ? cdf(complement(boost::math::chi_squared(dof), value)) : 1;
}

double f_probability(double value, double dof, double other_dof) {
  return cdf(complement(boost::math::fisher_f(dof, other_dof), value));
}

double t_probability(double value, double dof) {
  return 2 * cdf(complement(boost::math::students_t(dof), std::abs(value)));
}

double t_quantile(double p, double dof) {
  return quantile(boost::math::students_t(dof), p);
}

double normal_density(double value) {
  return pdf(boost::math::normal(), value);
}

double normal_probability(double value) {
  return cdf(boost::math::normal(), value);
}

double normal_quantile(double p) {
  return quantile(boost::math::normal(), p);
}

double kolmogorov_probability(double distance, int count) {
  const double root = std::sqrt(count), x = distance * (root + 0.12 + 0.11 / root);
  double sum = 0;
  for (int k = 1; k <= 100; ++k) sum += (k % 2 == 1 ? 2 : -2) * std::exp(-2 * k * k * x * x);
  return x < 0.2 ? 1 : std::clamp(sum, 0.0, 1.0);
}

}  // namespace taut
