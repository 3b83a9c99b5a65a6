#pragma once
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "calib/benches/assumptions.hpp"
#include "calib/studies/discretisation.hpp"

namespace taut {

/// The share of each assumption in each fitted parameter: the change that its tolerance makes, by gauss_newton_step()
/// from the optimum with exact derivatives (of dimensions DimensionedProtocol's). Without a tolerance the change by 1 %
/// stands there instead, and does not count. One cold replay of `model` for all. Other arguments as in
/// discretisation_shares().
std::vector<Share> assumption_shares(const Experiment& experiment, const DimensionedModel& model, const FitResult& fit,
                                     const std::function<void(const std::string&)>& progress = {}, const Ask& ask = {});

/// The share of the models that predict rows in place of the full one (Bench::model_of()): what the relative errors
/// that they state do to each parameter, by gauss_newton_step(), where all are off to the same side. Not known where a
/// row's is not. `fit` has a result.
Share model_share(const Bench& bench, const FitResult& fit, const Ask& ask = {});

/// The share of what a rod's sections resist with: one Gauss-Newton step at the optimum with the other law of sections
/// (see SectionLaw), less the fit's own, as error to either side: which of them a material follows is not known.
/// Nothing for other models.
std::optional<Share> law_share(const Bench& bench, const FitResult& fit, const Ask& ask = {});

/// The 95 % interval of the j-th parameter with all that counts: noise, bias and error of each share, added up as root
/// of squares on either side of the value.
struct TotalInterval {
  std::optional<double> lower, upper;  ///< SI; empty: open, as the noise alone leaves it
  std::vector<std::string> without;    ///< sources whose share is not known
};
/// See TotalInterval.
TotalInterval total_interval(const ParameterEstimate& estimate, const std::vector<Share>& shares, size_t j);

}  // namespace taut
