#pragma once
#include <vector>

namespace taut {

/// What values of one quantity, each found from a part of the readings alone, say of it when parts differ by more than
/// their errors: a random effect per part, x_u = mean + b_u + e_u with b_u ~ N(0, omega^2) and e_u ~ N(0, s_u^2).
struct Spread {
  double mean = 0;
  double omega = 0;       ///< standard deviation between parts (Paule and Mandel 1982)
  bool resolved = false;  ///< omega is at least as large as what errors typically are: else keep the noise's interval
  double half_width = 0;  ///< of the mean's 95 % interval (Hartung and Knapp 2001), t with n - 1 degrees of freedom
  double next_half_width = 0;  ///< of the 95 % interval of the value from another part
};

/// With weights w_u = 1 / (s_u^2 + omega^2): sum w (x - mean)^2 = n - 1 gives omega (0 where that is less at 0), and
/// the mean's variance is sum w (x - mean)^2 / ((n - 1) sum w), in balanced parts their variance over n. Two parts at
/// least, all errors positive.
Spread spread_of(const std::vector<double>& values, const std::vector<double>& standard_errors);

}  // namespace taut
