#pragma once
#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <optional>
#include <string>
#include <vector>

#include "calib/fit/fit.hpp"
#include "sim/core/numbers.hpp"

/// What fit() and profiles search with. Used inside calib/fit only.
namespace taut {

/// A free parameter on the scale on which it is fitted: its logarithm for moduli and stiffnesses, itself otherwise.
struct Scale {
  bool logarithmic;
  double lower = 0, upper = 0;  ///< bounds, fitted scale

  double inside(double si) const { return logarithmic ? std::log(si) : si; }  ///< the fitted scale's value
  double outside(double q) const { return logarithmic ? std::exp(q) : q; }    ///< SI
  double slope(double si) const { return logarithmic ? si : 1.0; }            ///< d outside / d inside
  double clamped(double q) const { return std::clamp(q, lower, upper); }      ///< within the bounds
  double room(double q) const { return std::min(q - lower, upper - q); }      ///< to the nearer bound
  /// What a change of the parameter at q is compared with: one for a logarithm, else the range that it may have.
  double range(double q) const {
    if (logarithmic) return 1;
    return std::isfinite(upper - lower) ? upper - lower : std::max(std::abs(q), 1e-12);
  }
};

/// Noise-scaled residuals (predicted - measured) / sigma and their derivatives on the fitted scale, evaluated for
/// Ceres. The newest evaluation is kept, because Ceres asks for residuals first and for derivatives at the same point
/// later.
class Evaluator {
 public:
  /// All references have to outlive it.
  Evaluator(Protocol& protocol, const std::vector<Measurement>& measurements, const std::vector<FreeParameter>& free,
            const FitOptions& options);

  const Scale& scale(Eigen::Index j) const { return scales_[static_cast<size_t>(j)]; }  ///< of a free parameter
  Eigen::Index count() const { return static_cast<Eigen::Index>(free_.size()); }        ///< of free parameters
  int residual_count() const { return static_cast<int>(measurements_.size()); }         ///< of measurements
  bool stopped() const { return options_.stop != nullptr && options_.stop->load(); }    ///< by FitOptions::stop
  /// Lets the next predictions cost so many times one that takes `replay` matrix factorisations (0: that many calls).
  void allow(double replays, int replay);
  bool spent() const;                                   ///< what was allowed is used up
  bool halted() const { return stopped() || spent(); }  ///< no further prediction is to be made
  /// From here on each prediction goes the protocol's own path from its start.
  void go_cold() { cold_ = true; }

  std::vector<double> values(const Eigen::VectorXd& q) const;  ///< the free parameters in SI
  Params params(const Eigen::VectorXd& q) const;               ///< all parameters
  bool evaluate(const Eigen::VectorXd& q);                     ///< false when a simulation failed

  /// What the next evaluations are for, and how many that usually takes.
  void begin(std::string phase, int usual_evaluations) {
    phase_ = std::move(phase);
    phase_end_ = evaluations + usual_evaluations;
  }

  /// Makes the next evaluation ask the protocol even at the same point.
  void reset() {
    point_.resize(0);
    prediction_ = {};
  }

  /// Has `prediction`, of an earlier evaluation at `q`, as the newest.
  void take(const Eigen::VectorXd& q, Prediction prediction) {
    point_ = q;
    prediction_ = std::move(prediction);
    ok_ = true;
  }
  const Prediction& prediction() const { return prediction_; }  ///< derivatives on the fitted scale
  const Eigen::VectorXd& point() const { return point_; }       ///< of the newest evaluation

  Eigen::VectorXd residuals() const;                                ///< noise-scaled, of the newest evaluation
  Eigen::MatrixXd jacobian() const;                                 ///< their derivatives on the fitted scale
  double chi_squared() const { return residuals().squaredNorm(); }  ///< of the newest evaluation

  int evaluations = 0, failed = 0;
  std::vector<SearchStep>* history = nullptr;  ///< where each evaluation is noted; null: nowhere
  std::vector<std::string> failures;
  Eigen::VectorXd last_failure;  ///< where the last simulation failed, fitted scale; empty: none did

 private:
  Protocol& protocol_;
  const std::vector<Measurement>& measurements_;
  const std::vector<FreeParameter>& free_;
  const FitOptions& options_;
  std::vector<int> indices_;
  std::vector<Scale> scales_;
  Eigen::VectorXd point_;
  Prediction prediction_;
  bool ok_ = false, cold_ = false;
  std::optional<double> allowed_;  ///< of cost()
  bool by_calls_ = false;
  double cost() const;
  std::string phase_;
  int phase_end_ = 0;  ///< where it usually ends
};

/// Decrease of chi squared that a Gauss-Newton step within the bounds from the newest evaluation at `q` promises; away
/// from bounds it is the square of the step in standard errors.
double promised_decrease(const Evaluator& at, const Eigen::VectorXd& q);

/// The residuals around a point, to first order.
struct Linearised {
  Eigen::VectorXd q, residuals;  ///< fitted scale; noise-scaled
  Eigen::MatrixXd jacobian;
  Eigen::Index profiled = -1;  ///< the parameter whose interval was looked for
};

/// Where chi squared is lowest to first order, and how low.
struct Promise {
  Eigen::VectorXd q;
  double chi_squared = not_a_number;
};

/// The lowest chi squared that `from` promises within the bounds, with parameter `held` at `value` (-1: all are free).
Promise promised_minimum(const Evaluator& evaluator, Linearised from, Eigen::Index held, double value);

/// Lets a protocol search while it lives.
struct Searching {
  Protocol& protocol;
  /// Begins the search.
  explicit Searching(Protocol& searching) : protocol(searching) { protocol.begin_search(); }
  Searching(const Searching&) = delete;
  Searching& operator=(const Searching&) = delete;
  /// Ends it.
  ~Searching() { protocol.end_search(); }
};

/// Where a search ended.
struct Minimum {
  bool failed = true;      ///< the simulation failed at its start, or at too many points
  bool converged = false;  ///< there is nothing more to gain, or it was asked to stop
  int iterations = 0;
  std::string message;
  Eigen::VectorXd q;  ///< fitted scale
  double chi_squared = not_a_number;
};

constexpr double damped = 1;      ///< trust-region radius of half a Gauss-Newton step
constexpr double undamped = 1e4;  ///< of the whole step

/// Levenberg-Marquardt from `q` with bounds; parameter `held` keeps its value (-1: none).
Minimum minimise(Evaluator& evaluator, const Eigen::VectorXd& q, Eigen::Index held, double radius,
                 const FitOptions& options);

/// One Gauss-Newton step from `q` in the reciprocals of the logarithmic parameters (1/E instead of ln E): displacements
/// of a linear solid are linear in those, so that a start a few times off comes near at once. At most a factor of
/// three, because far from the truth the solid is not linear. Returns whether `q` moved; it stays when that does not
/// lower chi squared.
bool step_in_compliance(Evaluator& evaluator, Eigen::VectorXd& q);

/// Four other starts around `q`, a design of two levels in which each parameter stands twice on either side: by half a
/// decade for logarithmic parameters, else a quarter of the range, and within the bounds.
std::vector<Eigen::VectorXd> designed_starts(const Evaluator& evaluator, const Eigen::VectorXd& q);

}  // namespace taut
