#pragma once
#include <string>
#include <vector>

#include "reports/run_record.hpp"

namespace taut {

/// The diagnostics of one parameter beside its value in the whole fit.
struct DiagnosticGroup {
  const ParameterEstimate* whole = nullptr;
  std::string held;                            ///< the control whose values make the parts: "retraction"
  std::vector<const DiagnosticRecord*> parts;  ///< in the order of that control's values
};

/// By parameter, those of parameters that were not fitted left out. Points into `record`.
std::vector<DiagnosticGroup> diagnostic_groups(const RunRecord& record);

/// How far a part's value is from the whole fit's, in the part's own standard errors; NaN where its fit failed.
double standard_errors_apart(const DiagnosticGroup& group, const DiagnosticRecord& part);

/// What the parts say, in one or two sentences. All within two standard errors of the whole fit: one law serves all. A
/// fall from the first part to the last by more than two standard errors of the difference, on which no part rises by
/// more than one over the one before: the foam softens under compression, which a neo-Hookean law does not do. A rise,
/// or no order, is said too.
std::string interpretation(const RunRecord& record, const DiagnosticGroup& group);

/// What to try when repeats agree on what the model misses (lack of fit with p < 0.05); empty otherwise.
std::string remedy_for_lack_of_fit(const RunRecord& record);

}  // namespace taut
