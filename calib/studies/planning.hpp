#pragma once
#include <Eigen/Core>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "calib/benches/bench.hpp"

// What to measure next: which rows of a bench narrow a fitted parameter, or a prediction, most. By the Fisher
// information of readings (Atkinson, Donev and Tobias, Optimum Experimental Designs, 2007), averaged over what the
// parameters may be.
namespace taut {

/// What is known of the free parameters before any further row, on the fitted scale: the logarithm of logarithmic ones.
struct PlanBelief {
  /// A free parameter.
  struct Parameter {
    ParameterSpec spec;
    double value = 0, lower = 0, upper = 0;  ///< best value and bounds, SI
    double range =
        1;  ///< what its deviation is compared with: 1 for a logarithm, else its bounds' distance or its size

    double scale() const { return spec.logarithmic ? value : 1; }  ///< d value / d fitted scale
  };
  std::vector<Parameter> parameters;
  /// Of the distribution from which parameters are drawn.
  Eigen::MatrixXd covariance;
  /// Deviations of a normal distribution of each parameter by itself that holds besides what readings say.
  Eigen::VectorXd prior_deviations;
};

/// What a fit leaves open: normal with its covariance, and of each parameter by itself with a quarter of its range as
/// deviation (a hundred sizes where it has none), which counts where the readings see nothing. `fit` has a covariance.
PlanBelief belief_after(const FitResult& fit);

/// Before any reading: normal about the start, with a deviation of a quarter of the range where both bounds were
/// chosen, else ln 3 for logarithmic parameters. Throws InputError for others whose bounds were not chosen.
PlanBelief belief_before(const Bench& bench);

/// What rows are asked.
struct PlanQuestion {
  /// A reading that is to be predicted.
  struct Goal {
    int channel = 0;               ///< of the bench
    std::vector<double> controls;  ///< SI, in the order of Bench::controls()
  };
  std::vector<std::vector<double>> rows;  ///< candidates, SI, in the order of Bench::controls()
  std::vector<int> channels;              ///< that are read in each
  std::optional<Goal> predicted{};        ///< none: a parameter is the goal
  int draws = 8;                          ///< of the parameters; the first one is the best value
  unsigned seed = 1;                      ///< of the others
};

/// Standard deviation of a new reading of this channel at these controls, whose value would be `value` [SI].
using SigmaOfReading = std::function<double(const BenchReading& at, double value)>;

/// A row that may be measured, all its channels at once.
struct PlanRow {
  std::vector<double> controls;  ///< SI
  int setup = 0;                 ///< rows of one number share what is held
  /// J^T W J of its readings on the fitted scale, one per draw; where it fails, the mean of the draws where it does
  /// not.
  std::vector<Eigen::MatrixXd> information;
  double fails =
      0;            ///< share of the draws in which it has no equilibrium, slips, is near a jump, or has two equilibria
  std::string why;  ///< of these the first that was met; "": it never fails
};

/// What rows say in each draw of the parameters.
struct PlanKnowledge {
  std::vector<std::vector<double>> values;  ///< of the parameters, SI, a list per draw; the first are the best
  std::vector<Eigen::MatrixXd> known;       ///< of the bench's readings, with the prior, one per draw
  std::vector<PlanRow> candidates;          ///< in the order of the question
  std::vector<PlanRow> measured;        ///< distinct rows of the bench, in the order of its file, as if read once more
  std::vector<Eigen::VectorXd> slopes;  ///< of what is to be predicted, one per draw; empty: nothing is
  double predicted = 0;                 ///< that at the best values, SI
  int dropped = 0;  ///< draws in which the bench's own readings, or the goal, have no equilibrium: not used
};

/// Throws InputError where a bench has no plan: readings that are not at rest, several specimens, rows that depend on
/// those before them.
void check_can_be_planned(const Bench& bench);

/// The control that changes from row to row while a set-up stays: the drawn load, else the one with most values.
size_t varied_control(const Bench& bench);

/// Replays the bench's readings, candidates and goal at draws of the parameters, each along the protocol's own path,
/// with derivatives. Throws InputError as check_can_be_planned(), and where its own readings or the goal cannot be
/// replayed at the best values. Draws in
/// which they cannot are made anew, up to three times as many as wanted. `progress` is told what comes next.
PlanKnowledge ask_rows(const Bench& bench, const PlanBelief& belief, const PlanQuestion& question,
                       const SigmaOfReading& sigma, const std::function<void(const std::string&)>& progress = {});

/// What measuring costs [min].
struct PlanCosts {
  double setup = 5;    ///< for each state of what is held
  double rest = 1;     ///< before each row
  double reading = 1;  ///< each row
};

/// A quantity that is to be narrowed: a parameter, or a prediction.
struct PlanGoal {
  std::vector<Eigen::VectorXd> gradients;  ///< of it by the parameters on the fitted scale, one per draw
  double floor = 0;                        ///< 95 % half width of what no reading lowers (shares), in its unit
};
/// The goal that a parameter is, in SI at its best value.
PlanGoal goal_of_parameter(const PlanBelief& belief, size_t parameter, size_t draws, double floor);

/// How well a goal is known: 95 % half widths, in its unit.
struct PlanWidths {
  double noise = 0;  ///< 1.96 sqrt(expected variance)
  double total = 0;  ///< root of the squares of that and the floor
};

/// Which rows are to be chosen among.
struct PlanTask {
  std::vector<Eigen::MatrixXd> known;  ///< information before, one per draw
  std::vector<PlanRow> rows;
  PlanGoal goal;
  PlanCosts costs{};
  std::optional<int> count{};        ///< of rows
  std::optional<double> minutes{};   ///< that they may take together
  size_t exhaustive_up_to = 20'000;  ///< combinations that are all looked at
};

/// Widths once `chosen` (positions in task.rows, repeats allowed) are measured, by the expected variance: the mean over
/// the draws of g^T (K + sum_i (1 - p_i) F_i)^-1 g, with the gradient g, what is known K, the information F_i of row i,
/// and the probability p_i that it fails. Infinite where that matrix is singular.
PlanWidths widths_after(const PlanTask& task, const std::vector<size_t>& chosen);

/// Minutes that these rows take, each set-up made once.
double minutes_of(const PlanTask& task, const std::vector<size_t>& chosen);

/// Rows to measure.
struct PlanChoice {
  std::vector<size_t> rows;  ///< positions in PlanTask::rows, in the order to measure: set-ups one after the other
  bool exhaustive = false;   ///< all combinations were looked at
};

/// The rows that narrow the goal best. With `minutes`: those after which it is narrowest in all within that time (and
/// at most `count`). Else: `count` rows that narrow it most per minute, so that a set-up has to be worth its time.
/// Looks at all combinations where they are few enough; else greedy by narrowing per minute from each first row, then
/// exchanges of one and of two rows until none helps. The set-up that narrows most per minute comes first; within one
/// rows keep the order of the task.
PlanChoice choose_rows(const PlanTask& task);

/// The half width in all that `chosen` takes away, as a fraction of what it is without them.
double narrowing(const PlanTask& task, const std::vector<size_t>& chosen);

/// The rows that cost least in these minutes: those of the first row's set-up, in the order of the task, from the first
/// one again once each was read.
std::vector<size_t> cheapest_rows(const PlanTask& task, double minutes);

/// Where beyond the candidates a goal begins to be seen.
struct PlanReach {
  size_t control = 0;                     ///< of Bench::controls()
  std::vector<double> controls{};         ///< of the row where it begins, SI
  bool above = true;                      ///< it is seen from there upwards, else downwards
  std::optional<bool> touching{};         ///< surfaces touch there; none: not known
  std::optional<bool> touching_before{};  ///< and at the candidates' end
};

/// Scans each control from either end of the candidates' range over once that range (not to the other side of zero),
/// the others at the candidates' largest values, then at their smallest, for where `count` rows narrow the goal's noise
/// by the fraction `worth` or more, expected over the draws; narrows where that begins to 1/1000 of the range. Whether
/// surfaces touch is told at the best values. `knowledge` is ask_rows()'s answer.
std::vector<PlanReach> where_seen(const Bench& bench, const PlanBelief& belief, const PlanQuestion& question,
                                  const SigmaOfReading& sigma, const PlanKnowledge& knowledge, const PlanGoal& goal,
                                  int count, double worth,
                                  const std::function<void(const std::string&)>& progress = {});

}  // namespace taut
