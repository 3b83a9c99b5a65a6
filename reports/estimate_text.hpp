#pragma once
#include <string>

#include "calib/runs/run_record.hpp"
#include "sim/core/units.hpp"

/// Numbers of a fit as people write them. For pages and the command.
namespace taut {

/// "+3.9 %", "not known" for NaN.
std::string percent(double ratio);
/// "0.049", "less than 0.001".
std::string probability(double p);
/// A bound of a parameter; "no limit".
std::string bound(double value, const std::string& unit);

/// Chi squared per degree of freedom, NaN without any.
double misfit_ratio(const FitResult& fit);
/// How many readings were fitted.
size_t fitted_readings(const RunRecord& record);
/// "Not fitted: line 40 (1 reading)."; "" when nothing is excluded.
std::string excluded_text(const RunRecord& record);
/// Where to look first: "What would explain the misfit: a zero error of 'tip': +0.20 +- 0.01 mm (...)", the best of
/// telling(), else outlier_text() where the model misses the readings; "": neither.
std::string look_first(const RunRecord& record);
/// "1e-12", "below 1e-99".
std::string small_probability(double p);
/// "E_foam = 46.8 kPa, slack = 0.4 mm": the parameters that are determined, with this explanation.
std::string parameters_with(const RunRecord& record, const Explanation& explanation);
/// "as well: a drift from trial to trial; made up for by: E_foam": what it cannot be told apart from; "": nothing.
std::string cannot_be_told_from(const Explanation& explanation);
/// Whether the readings of each part are what the others predict, a sentence without its full stop.
std::string held_out_verdict(const RunRecord& record);
/// What limits parameters that further free ones move by more than their standard errors: "E_arm: 318 kPa to 640 kPa
/// over 5 sets of free parameters, standard error 4 kPa", a sentence each.
std::vector<std::string> spread_over_sets(const RunRecord& record);
/// "turn_x = -1.9 ± 0.3°, foot_m129 = 9 ± 1 mm": what a variant frees besides.
std::string further_text(const VariantRecord& variant);
/// held_out_verdict() with a line for each part; "": there are none.
std::string held_out_text(const RunRecord& record);
/// "friction of the lips, between none and any: ..." with the row that it changes most; "": not asked for, or no row
/// closes.
std::string friction_text(const RunRecord& record);
/// "line 40 (tip): 38.50 mm, 10.2 sigmas off 3.850 mm": readings that the robust fit sets aside; "": none.
std::string robust_outliers(const RunRecord& record);
/// There are more readings than parameters, and a result.
bool can_judge(const FitResult& fit);
/// "line 40 alone makes 98 % of chi squared: ..." when one reading makes more than half of it; else "".
std::string outlier_text(const RunRecord& record);
/// What the j-th parameter's interval in all is without, since nobody knows its share: " but the mesh, the model"; else
/// "".
std::string but_unknown(const RunRecord& record, size_t j);
/// What makes a share smaller: "refine the mesh", "measure it better".
std::string remedy_of(const Share& share);
/// "Limited by the plane section (1.8 kPa) rather than the noise: ...", what would make the j-th parameter better
/// known;
/// "" where that is fewer errors in the readings, or nothing is known of shares.
std::string limit_text(const RunRecord& record, size_t j);
bool fits(const FitResult& fit);  ///< chi squared is not improbably large: p is 0.05 or more

/// An estimate in one unit, cut to the digits that its standard error leaves.
struct Shown {
  DisplayUnit unit;
  int decimals = 0;

  explicit Shown(const ParameterEstimate& estimate);  ///< in the unit that suits its value
  std::string number(double value) const;             ///< without the unit
  std::string with_unit(double value) const;          ///< "271 kPa"
  /// The 95 % interval: "271.4 to 276.9 kPa", "open to 0.46".
  std::string interval(const ParameterEstimate& estimate) const;
  std::string total(const ParameterEstimate& estimate) const;  ///< the interval in all; "not asked for"

 private:
  std::string interval(const ParameterEstimate& estimate, const std::optional<double>& lower,
                       const std::optional<double>& upper) const;
};

}  // namespace taut
