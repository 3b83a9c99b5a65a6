#pragma once
#include <Eigen/Core>
#include <string>
#include <vector>

#include "calib/fit/search.hpp"

namespace taut {

/// One point of a posterior, with the weight that it has among the others.
struct PosteriorDraw {
  std::vector<double> values;     ///< of the free parameters, SI; empty: there is no such point (failure says why)
  double log_weight = 0;          ///< natural logarithm, up to a constant that all draws of a sampler share
  std::vector<double> predicted;  ///< per row of the protocol, SI
  int evaluations = 0;            ///< of the protocol
  std::string failure;            ///< "": none
  bool outside = false;           ///< it lies where the prior is zero: a result, of weight zero
};

/// Draws from the posterior of a fit's parameters: normal readings with their sigmas, a prior that is flat between the
/// bounds on the fitted scale (the logarithm of logarithmic parameters).
///
/// Randomised maximum likelihood in the form of randomise-then-optimise (Bardsley, Solonen, Haario and Laine, SIAM J.
/// Sci. Comput. 36, 2014), whose points have a density that is known, so that weights make them exact. A parameter
/// between two bounds is q = a + (b - a) Phi(u), which makes its flat prior a standard normal one of u (Wang, Bardsley,
/// Solonen, Cui and Marzouk, SIAM J. Sci. Comput. 39, 2017); others stand for themselves. With F(u) = (r, u), r the
/// noise-scaled residuals, and the orthonormal columns U of F's Jacobian at its least |F|, u_0, each draw solves
///   U^T (F(u) - F(u_0)) = xi,  xi ~ N(0, 1),
/// and weighs exp(-|F(u)|^2 / 2 + |xi|^2 / 2) / |det(U^T F'(u))|. Of a linear model all weights are alike. It stays in
/// the valley of the optimum: another one is not found. Draws differ in their number alone: they may be made in any
/// order and by any process, to the same bits.
class PosteriorSampler {
 public:
  /// Draws about the optimum of a fit: `free` as free_at() has them, options with the values of the held parameters.
  /// All references have to outlive it. Throws InputError when the protocol has no prediction there.
  PosteriorSampler(Protocol& protocol, const std::vector<Measurement>& measurements,
                   const std::vector<FreeParameter>& free, const FitOptions& options);

  /// The draw with this number; `seed` makes another sequence. An interrupted one has the failure "interrupted".
  PosteriorDraw draw(unsigned number, unsigned seed);
  double chi_squared() const { return chi_squared_; }  ///< at the start that it was given

 private:
  /// F and its Jacobian somewhere.
  struct Point {
    Eigen::VectorXd u, F;
    Eigen::MatrixXd jacobian;
    bool ok = false;       ///< the simulation did not fail
    bool outside = false;  ///< beyond the one bound of a parameter
  };
  bool bounded(Eigen::Index j) const;
  Eigen::VectorXd fitted(const Eigen::VectorXd& u) const;
  Point at(const Eigen::VectorXd& u);
  void find_centre();

  Protocol& protocol_;
  Evaluator evaluator_;
  std::vector<Eigen::Index> with_prior_;  ///< parameters between two bounds
  Point centre_;
  Eigen::MatrixXd basis_;  ///< U
  std::string state_;      ///< of the protocol at the centre
  double chi_squared_ = 0;
};

/// Values with weights: what an expectation, a quantile or an effective number of them is.
struct WeightedValues {
  std::vector<double> values, weights;  ///< weights >= 0, of any sum

  double mean() const;       ///< sum w x / sum w
  double deviation() const;  ///< root of the weighted mean squared distance from the mean
  /// The value below which a fraction `p` of the weight lies: between the middles of the values' own weights linearly,
  /// beyond the first and last one their values.
  double quantile(double p) const;
};

/// Weights from their logarithms, the largest 1.
std::vector<double> weights_of(const std::vector<double>& log_weights);
/// (sum w)^2 / sum w^2: so many equal weights say as much (Kong, 1992). 0 of none.
double effective_number(const std::vector<double>& weights);

}  // namespace taut
