#pragma once
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "calib/studies/planning.hpp"

// What `taut plan` found, as JSON and lines for people.
namespace taut {

/// A quantity before the plan's rows and after them.
struct PlannedQuantity {
  std::string id, unit;  ///< of a parameter, or "tip at retraction = 12 mm, mass = 80 g"; SI
  double value = 0;      ///< SI
  bool logarithmic = false;
  PlanWidths before{}, after{};
  bool is_goal = false;
};

/// Other rows for the same time.
struct PlanComparison {
  std::string what;  ///< "the bench's cheapest rows again (retraction = 0 mm)"
  size_t rows = 0;
  double minutes = 0;
  PlanWidths after{};
};

/// A plan, ready to be said.
struct PlanReport {
  std::string title;
  bool simulated = false;
  bool before_readings = false;  ///< nothing is measured yet: of a file, not of a run
  PlanBelief belief;
  PlanTask task;
  std::vector<size_t> rows;       ///< of the task, in the order to measure; empty: nothing helps
  bool exhaustive = false;        ///< all combinations were looked at
  std::vector<PlanWidths> along;  ///< of the goal after each row
  PlannedQuantity goal;
  std::vector<PlannedQuantity> parameters;
  std::vector<PlanComparison> comparisons;
  std::vector<std::string> channels;  ///< that are read
  std::vector<std::string> notes;     ///< sentences
};

/// Which trial each of these rows is, from 1: a row that was chosen before is one more.
std::vector<int> trials_of(const std::vector<size_t>& rows);

/// "+- 0.36 kPa" beside a value in kPa, or "factor 3.1" where that is more than half of it.
std::string width_text(const PlannedQuantity& quantity, double half);

/// The tables.
void print_plan(const PlanReport& report, const Bench& bench);
/// What `--json` prints.
nlohmann::ordered_json plan_json(const PlanReport& report, const Bench& bench);

}  // namespace taut
