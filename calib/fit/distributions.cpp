#include "calib/fit/distributions.hpp"

#include <boost/math/distributions/chi_squared.hpp>
#include <boost/math/distributions/fisher_f.hpp>
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

}  // namespace taut
