#pragma once

// Probabilities and quantiles of the distributions that intervals and verdicts rest on; Boost.Math computes all but the
// constant, in the one source that pays for its headers.
namespace taut {

/// 97.5 % quantile of the normal distribution: half the width of a 95 % interval in standard deviations.
inline constexpr double z95 = 1.959963984540054;

/// Probability that chi squared with `dof` degrees of freedom exceeds `value`; 1 without degrees of freedom.
double chi_squared_probability(double value, double dof);

/// Probability that Fisher's F with `dof` degrees of freedom over `other_dof`, both positive, exceeds `value`.
double f_probability(double value, double dof, double other_dof);

/// Probability that Student's t with `dof` > 0 degrees of freedom exceeds |value| to either side.
double t_probability(double value, double dof);

/// What Student's t with `dof` > 0 degrees of freedom stays below with a probability of 0 < p < 1.
double t_quantile(double p, double dof);

/// Of the normal distribution with mean 0 and deviation 1: its density at `value`, the probability of less than that,
/// and what is not exceeded with a probability of 0 < p < 1.
double normal_density(double value);
double normal_probability(double value);  ///< see normal_density()
double normal_quantile(double p);         ///< see normal_density()

/// Probability that the largest distance between a distribution and that of `count` independent draws from it exceeds
/// `distance` (Kolmogorov's limit with Stephens' correction, J. R. Statist. Soc. B 32, 1970).
double kolmogorov_probability(double distance, int count);

}  // namespace taut
