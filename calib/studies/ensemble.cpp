#include "calib/studies/ensemble.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <new>
#include <numeric>
#include <set>
#include <sstream>
#include <tuple>

#include "calib/fit/distributions.hpp"
#include "calib/fit/gauss_newton.hpp"
#include "calib/fit/goodness_of_fit.hpp"
#include "calib/fit/posterior.hpp"
#include "calib/fit/profile.hpp"
#include "calib/studies/assumption_shares.hpp"
#include "sim/core/draws.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/stopwatch.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

constexpr const char* fine = "ok";
constexpr const char* beyond = "outside";
constexpr size_t enough_trials = 5;   ///< from so many on trials are drawn anew, else noise
constexpr int fewest_members = 20;    ///< from which a distribution is described
constexpr size_t most_drawn = 1000;   ///< members that figures show
constexpr size_t fewest_places = 7;   ///< of a profile, from which its ends are read off
constexpr double of_good_ends = 0.2;  ///< as a part of the parabola's half width: nobody decides otherwise for less

/// The text of one number that reads back to the same bits.
std::string exact(double value) {
  return fmt::format("{}", value);
}

std::string exact_words(const std::vector<double>& values) {
  std::string text;
  for (double value : values) text += (text.empty() ? "" : " ") + exact(value);
  return text;
}

std::vector<double> numbers_of(const std::string& text) {
  std::vector<double> values;
  std::istringstream in(text);
  for (std::string word; in >> word;) values.push_back(std::strtod(word.c_str(), nullptr));
  return values;
}

const Cells member_columns{"fingerprint", "seed",        "number", "status",   "log_weight",
                           "chi_squared", "evaluations", "values", "predicted"};

Cells cells_of_member(const EnsembleMember& member) {
  return {member.status,
          exact(member.log_weight),
          exact(member.chi_squared),
          std::to_string(member.evaluations),
          exact_words(member.values),
          exact_words(member.predicted)};
}

/// What cells_of_member() was given; nothing when it does not fit this bench.
std::optional<EnsembleMember> member_of(const Cells& cells, size_t parameters) {
  EnsembleMember member{cells[0],
                        numbers_of(cells[4]),
                        std::strtod(cells[1].c_str(), nullptr),
                        std::strtod(cells[2].c_str(), nullptr),
                        numbers_of(cells[5]),
                        std::atoi(cells[3].c_str())};
  if (!member.values.empty() && member.values.size() != parameters) return std::nullopt;
  return member;
}

/// A member's value on the fitted scale.
double fitted(const ParameterSpec& spec, double value) {
  return spec.logarithmic ? std::log(value) : value;
}

double unfitted(const ParameterSpec& spec, double q) {
  return spec.logarithmic ? std::exp(q) : q;
}

/// Of the parabola on the fitted scale; NaN or infinite where the readings do not define it.
double fitted_se(const ParameterEstimate& estimate) {
  return estimate.standard_error / (estimate.spec.logarithmic ? estimate.value : 1);
}

/// Between which ends a profile is looked at, fitted scale: twice as far out as its interval's, to the bound where that
/// is open, and six standard errors where the fit has none.
std::pair<double, double> profile_range(const ParameterEstimate& estimate) {
  const double centre = fitted(estimate.spec, estimate.value), se = fitted_se(estimate);
  const bool has_none = !estimate.lower95 && !estimate.upper95 && se > 0 && std::isfinite(se);
  const auto end = [&](const std::optional<double>& of_interval, double bound, double sign) {
    const double farthest = std::isfinite(bound) ? fitted(estimate.spec, bound) : sign * infinity;
    const double wanted = of_interval ? centre + 2 * (fitted(estimate.spec, *of_interval) - centre)
                          : has_none  ? centre + sign * 6 * se
                                      : farthest;
    const double q = sign > 0 ? std::min(wanted, farthest) : std::max(wanted, farthest);
    if (!std::isfinite(q))
      throw InputError(
          fmt::format("{}: its profile goes to its bounds, and it has none on one side; give it both, as in "
                      "[fit.free.{}] lower = \"...\", upper = \"...\"",
                      estimate.spec.id, estimate.spec.id));
    return q;
  };
  return {end(estimate.lower95, estimate.lower, -1), end(estimate.upper95, estimate.upper, 1)};
}

/// 0, 1, 1/2, 1/4, 3/4, 1/8, ...: evenly, however many there are (van der Corput's sequence after the ends).
double halving(unsigned number) {
  if (number < 2) return number;
  double place = 0, part = 0.5;
  for (unsigned digits = number - 1; digits > 0; digits /= 2, part /= 2) place += part * (digits % 2);
  return place;
}

/// Makes members one by one.
class Members {
 public:
  Members(const Bench& bench, const FitResult& fit, const EnsembleTask& task, const std::atomic<bool>* stop)
      : bench_(bench),
        protocol_(bench.protocol()),
        fit_(fit),
        task_(task),
        free_(free_at(fit, protocol_.parameters())) {
    if (fit.status != FitStatus::converged || fit.covariance.size() == 0)
      throw InputError(fmt::format("the fit has no optimum to draw around ({}); fit it again", name_of(fit.status)));
    options_.held = fit.p;
    options_.stop = stop;
    options_.profiles = options_.recover = false;
    if (task.kind == EnsembleKind::posterior) {
      sampler_.emplace(protocol_, bench.measurements(), free_, options_);
      check_optimum(sampler_->chi_squared());
    } else {
      start();
    }
  }

  /// Nothing when it was interrupted.
  std::optional<EnsembleMember> make(unsigned number) {
    try {
      EnsembleMember member = task_.kind == EnsembleKind::posterior   ? drawn(number)
                              : task_.kind == EnsembleKind::bootstrap ? refitted(number)
                              : task_.kind == EnsembleKind::profiles  ? held_at(number)
                                                                      : from_elsewhere(number);
      if (options_.stop != nullptr && options_.stop->load()) return std::nullopt;
      return member;
    } catch (const std::bad_alloc&) {
      throw;
    } catch (const std::exception& error) {
      return EnsembleMember{error.what()};
    }
  }

 private:
  /// One prediction along the protocol's own path, from which all fits go on.
  void start() {
    protocol_.forget();
    const Prediction there = protocol_.predict(fit_.p, indices_of(free_));
    if (!there.complete()) throw InputError(there.failures.front());
    check_optimum(noise_scaled(there, bench_.measurements()).residuals.squaredNorm());
    at_optimum_ = there.values;
    state_ = protocol_.state();
    size_t i = 0;
    for (const BenchReading& reading : bench_.readings()) {
      if (!reading.excluded) trials_[reading.trial].push_back(i++);
    }
    if (i != bench_.measurements().size()) trials_.clear();  // a recording has many measurements
  }

  void check_optimum(double chi_squared) const {
    if (std::abs(chi_squared - fit_.chi_squared) <= 0.01 + 1e-4 * fit_.chi_squared) return;
    throw InputError(fmt::format(
        "at the fitted parameters chi squared is {:.6g}, and the run has {:.6g}: it comes from another taut, or its "
        "fit has followed rows into another equilibrium, around which nothing can be drawn; fit it again",
        chi_squared, fit_.chi_squared));
  }

  EnsembleMember drawn(unsigned number) {
    const PosteriorDraw draw = sampler_->draw(number, task_.seed);
    EnsembleMember member{draw.failure.empty() ? fine : draw.outside ? beyond : draw.failure};
    member.evaluations = draw.evaluations;
    if (draw.values.empty()) return member;
    member.values = draw.values;
    member.log_weight = draw.log_weight;
    member.predicted = draw.predicted;
    for (const Measurement& measured : bench_.measurements()) {
      const double off = (draw.predicted[static_cast<size_t>(measured.row)] - measured.value) / measured.sigma;
      member.chi_squared += off * off;
    }
    return member;
  }

  /// Readings of trials that are drawn with replacement, or the fit's predictions with new noise.
  std::vector<Measurement> readings_anew(Draws& random) const {
    std::vector<Measurement> readings;
    if (trials_.size() < enough_trials) {
      readings = bench_.measurements();
      for (Measurement& one : readings) one.value = at_optimum_[one.row] + one.sigma * random.normal();
      return readings;
    }
    std::vector<const std::vector<size_t>*> all;
    for (const auto& [trial, places] : trials_) all.push_back(&places);
    for (size_t i = 0; i < all.size(); ++i) {
      const auto which = static_cast<size_t>(random.uniform(0, static_cast<double>(all.size())));
      for (size_t place : *all[std::min(which, all.size() - 1)]) readings.push_back(bench_.measurements()[place]);
    }
    return readings;
  }

  EnsembleMember refitted(unsigned number) {
    Draws random(task_.seed * 1'000'003U + number);
    const std::vector<Measurement> readings = readings_anew(random);
    protocol_.restore(state_);
    return as_member(fit(protocol_, readings, free_, options_));
  }

  EnsembleMember from_elsewhere(unsigned number) {
    Draws random(task_.seed * 1'000'003U + number);
    std::vector<FreeParameter> free = free_;
    for (size_t j = 0; j < free.size(); ++j) {
      const bool logarithmic = protocol_.parameters()[free[j].index].logarithmic;
      FreeParameter& one = free[j];
      if (!std::isfinite(one.lower) || !std::isfinite(one.upper))
        throw InputError(
            fmt::format("{}: starts are drawn between its bounds, and it has none on one side; give it "
                        "both, as in [fit.free.{}] bounds = [...]",
                        protocol_.parameters()[one.index].id, protocol_.parameters()[one.index].id));
      one.start =
          std::clamp(logarithmic ? random.logarithmic(one.lower, one.upper) : random.uniform(one.lower, one.upper),
                     one.lower, one.upper);
    }
    protocol_.forget();
    return as_member(fit(protocol_, bench_.measurements(), free, options_));
  }

  /// The others' best where one parameter has been moved along its profile, to which they start on the parabola.
  EnsembleMember held_at(unsigned number) {
    const size_t one = number % free_.size();
    const auto [low, high] = profile_range(fit_.parameters[one]);
    const double q = std::lerp(low, high, halving(number / static_cast<unsigned>(free_.size())));
    const auto scaled = [&](size_t j) { return fitted(fit_.parameters[j].spec, fit_.parameters[j].value); };
    const auto j = static_cast<Eigen::Index>(one);
    FitOptions options = options_;
    const double value = unfitted(fit_.parameters[one].spec, q);
    options.held[free_[one].index] = value;
    std::vector<FreeParameter> others;
    for (size_t k = 0; k < free_.size(); ++k) {
      if (k == one) continue;
      FreeParameter& other = others.emplace_back(free_[k]);
      const double slope = fit_.covariance(static_cast<Eigen::Index>(k), j) / fit_.covariance(j, j);
      const double start = unfitted(fit_.parameters[k].spec, scaled(k) + slope * (q - scaled(one)));
      if (std::isfinite(start)) other.start = std::clamp(start, other.lower, other.upper);
    }
    protocol_.restore(state_);
    EnsembleMember member;
    if (others.empty()) {
      const Prediction there = protocol_.predict(options.held, {});
      if (!there.complete()) return {there.failures.front()};
      member = {fine, {}, 0, noise_scaled(there, bench_.measurements()).residuals.squaredNorm()};
      member.predicted.assign(there.values.begin(), there.values.end());
      member.evaluations = 1;
    } else {
      member = as_member(fit(protocol_, bench_.measurements(), others, options));
      if (member.status != fine) return member;
    }
    member.values.insert(member.values.begin() + j, value);
    return member;
  }

  static EnsembleMember as_member(const FitResult& found) {
    EnsembleMember member{found.status == FitStatus::converged ? fine : std::string(name_of(found.status))};
    member.evaluations = found.evaluations;
    if (found.status != FitStatus::converged) return member;
    for (const ParameterEstimate& estimate : found.parameters) member.values.push_back(estimate.value);
    member.predicted.assign(found.predicted.begin(), found.predicted.end());
    member.chi_squared = found.chi_squared;
    return member;
  }

  const Bench& bench_;
  Protocol& protocol_;
  const FitResult& fit_;
  const EnsembleTask& task_;
  std::vector<FreeParameter> free_;
  FitOptions options_;
  std::optional<PosteriorSampler> sampler_;
  Eigen::VectorXd at_optimum_;
  std::string state_;
  std::map<std::string, std::vector<size_t>> trials_;  ///< places of their measurements
};

/// What ends on the fitted scale say of the parabola's, each as a part of its half width.
std::string verdict_on(double low, double high, double allowed, double width) {
  if (std::abs(low - 1) <= allowed && std::abs(high - 1) <= allowed)
    return fmt::format("good (its ends within {:.0f} %)", 100 * allowed);
  if (width > 1 + allowed / std::sqrt(2)) return fmt::format("too narrow by {:.2g}", width);
  if (width < 1 - allowed / std::sqrt(2)) return fmt::format("too wide by {:.2g}", 1 / width);
  return fmt::format("{} by {:.2g} standard errors", high > low ? "too low" : "too high",
                     z95 * std::abs(high - low) / 2);
}

constexpr const char* no_parabola = "it has none: the readings do not define it";

std::string verdict_on(const WeightedValues& drawn, const ParameterEstimate& estimate, double effective,
                       EnsembleMarginal& marginal) {
  const double value = fitted(estimate.spec, estimate.value), se = fitted_se(estimate);
  marginal.width = marginal.width_error = not_a_number;
  if (!(se > 0) || !std::isfinite(se)) return no_parabola;
  // An end's standard error is sqrt(p (1 - p) / n) over the density there, 1.36 / sqrt(n) of a normal half width.
  const double doubt = 2 * 1.36 / std::sqrt(effective);
  const double low = (value - drawn.quantile(0.025)) / (z95 * se), high = (drawn.quantile(0.975) - value) / (z95 * se);
  marginal.width = (low + high) / 2;
  marginal.width_error = doubt / std::sqrt(2);
  if (doubt > 0.5) return fmt::format("not known: {:.0f} effective members are too few", effective);
  return verdict_on(low, high, std::max(of_good_ends, doubt), marginal.width);
}

/// What a profile says of its parameter: the outermost places where it crosses the rise of a 95 % interval, found on
/// straight lines between the roots of the rises, in which a parabola is straight.
EnsembleMarginal marginal_of(const ProfileGrid& grid, const ParameterEstimate& estimate) {
  EnsembleMarginal marginal;
  marginal.id = estimate.spec.id;
  marginal.unit = estimate.spec.unit;
  marginal.median = estimate.value;
  marginal.mean = marginal.deviation = marginal.lower95 = marginal.upper95 = not_a_number;
  marginal.width = marginal.width_error = not_a_number;
  if (grid.size() < fewest_places) {
    marginal.verdict = fmt::format("not known: {} places are too few", grid.size());
    return marginal;
  }
  const auto inside = [](const std::pair<double, double>& place) { return place.second <= profile_rise; };
  const auto scaled = [&](const std::pair<double, double>& place) { return fitted(estimate.spec, place.first); };
  const auto crossing = [&](const std::pair<double, double>& in, const std::pair<double, double>& out) {
    const double from = std::sqrt(std::max(in.second, 0.0)), to = std::sqrt(out.second);
    return std::lerp(scaled(in), scaled(out), (z95 - from) / (to - from));
  };
  int pieces = 0;
  for (size_t k = 0; k < grid.size(); ++k) pieces += inside(grid[k]) && (k == 0 || !inside(grid[k - 1]));
  marginal.median = std::ranges::min_element(grid, {}, &std::pair<double, double>::second)->first;
  const double value = fitted(estimate.spec, estimate.value), half = z95 * fitted_se(estimate);
  std::string open;
  const auto end_of = [&](auto outermost, auto edge, const char* side, double& end) {
    if (outermost == edge) {
      open += fmt::format("; open {}: a rise of {:.2g} at {}", side, edge->second,
                          with_unit(edge->first, estimate.spec.unit));
      return not_a_number;
    }
    const double q = crossing(*outermost, *std::prev(outermost));
    end = unfitted(estimate.spec, q);
    return q;
  };
  const double low = end_of(std::ranges::find_if(grid, inside), grid.begin(), "below", marginal.lower95);
  const double high =
      end_of(std::find_if(grid.rbegin(), grid.rend(), inside), grid.rbegin(), "above", marginal.upper95);
  if (!(half > 0) || !std::isfinite(half)) {
    marginal.verdict = no_parabola;
  } else if (!open.empty()) {
    marginal.verdict = "wrong, it has two ends";
  } else {
    marginal.width = (high - low) / (2 * half);
    marginal.width_error = 0;
    marginal.verdict = verdict_on((value - low) / half, (high - value) / half, of_good_ends, marginal.width);
  }
  marginal.verdict += open;
  if (pieces > 1) marginal.verdict += fmt::format("; the readings allow {} ranges apart from each other", pieces);
  return marginal;
}

/// Members by the parameter that is held, with the optimum.
void describe_profiles(const std::vector<std::optional<EnsembleMember>>& members, const FitResult& fit,
                       EnsembleRecord& record) {
  const size_t count = fit.parameters.size();
  for (size_t j = 0; j < count; ++j) {
    ProfileGrid grid{{fit.parameters[j].value, 0.0}};
    for (size_t k = j; k < members.size(); k += count) {
      if (members[k] && members[k]->status == fine)
        grid.emplace_back(members[k]->values[j], members[k]->chi_squared - fit.chi_squared);
    }
    std::ranges::sort(grid);
    record.parameters.push_back(marginal_of(grid, fit.parameters[j]));
    record.profiles.push_back(std::move(grid));
  }
}

/// Ends that lie where the prior ends rather than where readings do: a thousandth of the weight within the last
/// hundredth of the range between the bounds.
std::string prior_ends(const WeightedValues& drawn, const ParameterEstimate& estimate) {
  const double low = fitted(estimate.spec, estimate.lower), high = fitted(estimate.spec, estimate.upper);
  if (!std::isfinite(low) || !std::isfinite(high)) return "";
  const double strip = 0.01 * (high - low), all = std::accumulate(drawn.weights.begin(), drawn.weights.end(), 0.0);
  double below = 0, above = 0;
  for (size_t i = 0; i < drawn.values.size(); ++i) {
    below += drawn.values[i] < low + strip ? drawn.weights[i] : 0;
    above += drawn.values[i] > high - strip ? drawn.weights[i] : 0;
  }
  std::string text;
  for (const auto& [weight, side, bound] :
       {std::tuple{below, "lower", estimate.lower}, std::tuple{above, "upper", estimate.upper}}) {
    if (weight > 0.001 * all)
      text += fmt::format("; its {} end is the prior's, which ends at {}", side, with_unit(bound, estimate.spec.unit));
  }
  return text;
}

/// Of two quantities of the same members.
double correlation_of(const WeightedValues& a, const WeightedValues& b) {
  WeightedValues product{{}, a.weights};
  const double centre_a = a.mean(), centre_b = b.mean();
  for (size_t i = 0; i < a.values.size(); ++i)
    product.values.push_back((a.values[i] - centre_a) * (b.values[i] - centre_b));
  return product.mean() / (a.deviation() * b.deviation());
}

/// Where an ensemble's distribution has its ends, of each parameter.
void describe_parameters(const std::vector<const EnsembleMember*>& made, const std::vector<double>& weights,
                         const FitResult& fit, const std::vector<Share>& shares, EnsembleRecord& record) {
  std::vector<WeightedValues> scaled;
  for (size_t j = 0; j < fit.parameters.size(); ++j) {
    const ParameterEstimate& estimate = fit.parameters[j];
    WeightedValues drawn{{}, weights}, q{{}, weights};
    for (const EnsembleMember* member : made) {
      drawn.values.push_back(member->values[j]);
      q.values.push_back(fitted(estimate.spec, member->values[j]));
    }
    EnsembleMarginal& marginal = record.parameters.emplace_back();
    marginal.id = estimate.spec.id;
    marginal.unit = estimate.spec.unit;
    marginal.mean = drawn.mean();
    marginal.deviation = drawn.deviation();
    marginal.lower95 = drawn.quantile(0.025);
    marginal.median = drawn.quantile(0.5);
    marginal.upper95 = drawn.quantile(0.975);
    marginal.verdict = verdict_on(q, estimate, record.effective, marginal) + prior_ends(q, estimate);
    if (record.kind == name_of(EnsembleKind::posterior) && !shares.empty()) {
      ParameterEstimate about = estimate;
      about.value = marginal.median;
      about.lower95 = marginal.lower95;
      about.upper95 = marginal.upper95;
      const TotalInterval total = total_interval(about, shares, j);
      marginal.total_lower95 = total.lower;
      marginal.total_upper95 = total.upper;
    }
    scaled.push_back(std::move(q));
  }
  const auto count = static_cast<Eigen::Index>(scaled.size());
  record.correlation.resize(count, count);
  for (Eigen::Index a = 0; a < count; ++a) {
    for (Eigen::Index b = 0; b < count; ++b)
      record.correlation(a, b) = correlation_of(scaled[static_cast<size_t>(a)], scaled[static_cast<size_t>(b)]);
  }
}

void find_bands(const std::vector<const EnsembleMember*>& made, const std::vector<double>& weights, const Bench& bench,
                EnsembleRecord& record) {
  std::vector<std::array<double, 2>> rows;
  for (size_t row = 0; row < made.front()->predicted.size(); ++row) {
    WeightedValues of_row{{}, weights};
    for (const EnsembleMember* member : made) of_row.values.push_back(member->predicted[row]);
    rows.push_back({of_row.quantile(0.025), of_row.quantile(0.975)});
  }
  for (const BenchReading& reading : bench.readings())
    record.bands.push_back(reading.row < 0 ? std::array{not_a_number, not_a_number}
                                           : rows.at(static_cast<size_t>(reading.row)));
}

/// Ends of fits that are one minimum: a chi squared within what a search leaves.
void find_minima(std::vector<const EnsembleMember*> made, EnsembleRecord& record) {
  std::ranges::sort(made, {}, &EnsembleMember::chi_squared);
  for (const EnsembleMember* member : made) {
    if (!record.minima.empty() &&
        member->chi_squared <= record.minima.back().chi_squared + lower_minimum + 1e-4 * member->chi_squared)
      ++record.minima.back().starts;
    else
      record.minima.push_back({member->chi_squared, 1, member->values});
  }
}

std::string method_of(EnsembleKind kind, const Bench& bench) {
  if (kind == EnsembleKind::posterior)
    return "Draws by randomised maximum likelihood (randomise-then-optimise) with their weights: the readings' noise "
           "as "
           "it was declared, and a prior that is flat between the bounds, of moduli and stiffnesses in their "
           "logarithm. "
           "They stay in the valley of the optimum.";
  if (kind == EnsembleKind::profiles)
    return "Fits with one parameter held at places along its range, twice as far out as its 95 % interval, or to its "
           "bounds where that is open. Its profile's interval is where chi squared, least over all others, rises by "
           "3.84 at most.";
  if (kind == EnsembleKind::starts)
    return "Fits from starts that were drawn between the bounds, of moduli and stiffnesses evenly in their logarithm.";
  std::set<std::string> trials;
  for (const BenchReading& reading : bench.readings()) trials.insert(reading.trial);
  return trials.size() >= enough_trials && bench.trials_at_rest() != nullptr
             ? fmt::format(
                   "Fits of {} trials that were drawn with replacement. That shows how the estimates scatter, not "
                   "whether the readings can tell the parameters from each other.",
                   trials.size())
             : fmt::format(
                   "Fits of the fitted curve with new noise as it was declared ({} trials are too few to be drawn "
                   "anew). That shows how the estimates scatter, not whether the readings can tell the "
                   "parameters from each other.",
                   trials.size());
}

std::string summary_of(const EnsembleRecord& record, EnsembleKind kind, const FitResult& fit) {
  if (kind == EnsembleKind::starts) {
    if (record.minima.empty()) return "No start led to a minimum.";
    const EnsembleMinimum& lowest = record.minima.front();
    std::string text = fmt::format("{} of {} starts ended in the lowest minimum, chi squared {:.4g}", lowest.starts,
                                   record.finished, lowest.chi_squared);
    if (lowest.chi_squared < fit.chi_squared - lower_minimum - 1e-4 * fit.chi_squared)
      return text + fmt::format(", BELOW THE FIT'S {:.4g}: fit again from there.", fit.chi_squared);
    return text + (record.minima.size() > 1
                       ? fmt::format("; {} others ended above it, the next one at {:.4g}.",
                                     record.finished - record.failed - lowest.starts, record.minima[1].chi_squared)
                       : ", which is the fit's.");
  }
  if (record.parameters.empty())
    return fmt::format("{} members have values: too few to describe a distribution.",
                       record.finished - record.failed - record.outside);
  double lowest = 0;
  for (const ProfileGrid& grid : record.profiles) {
    for (const auto& [value, rise] : grid) lowest = std::min(lowest, rise);
  }
  if (lowest < -lower_minimum - 1e-4 * fit.chi_squared)
    return fmt::format("Chi squared falls to {:.4g} along a profile, BELOW THE FIT'S {:.4g}: fit again from there.",
                       fit.chi_squared + lowest, fit.chi_squared);
  std::string good, bad;
  for (const EnsembleMarginal& one : record.parameters) {
    if (one.verdict.starts_with("good"))
      good += (good.empty() ? "" : ", ") + one.id;
    else
      bad += (bad.empty() ? "" : "; ") + fmt::format("{}: {}", one.id, one.verdict);
  }
  std::string text = "The parabola's 95 % interval";
  if (misses_readings(fit))
    text =
        "THE MODEL MISSES THE READINGS by far more than their declared noise, which is all that the members count: how "
        "far "
        "the parameters are from the truth is not known. Of that noise alone the parabola's 95 % interval";
  if (!good.empty()) text += fmt::format(" is good for {}", good);
  if (!bad.empty()) text += fmt::format("{} {}", good.empty() ? ":" : ";", bad);
  return text + ".";
}

}  // namespace

std::string_view name_of(EnsembleKind kind) {
  switch (kind) {
    case EnsembleKind::posterior:
      return "posterior";
    case EnsembleKind::bootstrap:
      return "bootstrap";
    case EnsembleKind::starts:
      return "starts";
    case EnsembleKind::profiles:
      return "profiles";
  }
  return "";
}

std::vector<std::optional<EnsembleMember>> run_ensemble(const Bench& bench, const FitResult& fit,
                                                        const EnsembleTask& task, const StudyOptions& options) {
  std::vector<std::optional<EnsembleMember>> members(task.count);
  std::optional<Members> maker;  // made where there is something to make: it costs a replay
  Study study;
  study.columns = member_columns;
  study.keys = 2;
  for (unsigned k = 0; k < task.count; ++k)
    study.settings.push_back(
        {{std::to_string(task.seed), std::to_string(k)}, fmt::format("{} {}", name_of(task.kind), k + 1), 1});
  study.run = [&](size_t setting, const Deadline&) -> std::optional<StudyResult> {
    const Stopwatch watch;
    if (!maker) maker.emplace(bench, fit, task, options.stop);
    const std::optional<EnsembleMember> member = maker->make(static_cast<unsigned>(setting));
    if (!member) return std::nullopt;
    return StudyResult{cells_of_member(*member), watch.seconds()};
  };
  study.take = [&](size_t setting, const Cells& cells) {
    members[setting] = member_of(cells, fit.parameters.size());
    return members[setting].has_value();
  };
  run_study(study, options);
  return members;
}

EnsembleRecord summed_up(const std::vector<std::optional<EnsembleMember>>& members, const Bench& bench,
                         const FitResult& fit, const std::vector<Share>& shares, const EnsembleTask& task) {
  EnsembleRecord record;
  record.kind = name_of(task.kind);
  record.how = method_of(task.kind, bench);
  record.asked = static_cast<int>(task.count);
  record.seed = task.seed;
  std::vector<const EnsembleMember*> made;
  std::vector<double> logs;
  std::set<std::string> reasons;
  for (const std::optional<EnsembleMember>& member : members) {
    if (!member) continue;
    ++record.finished;
    record.evaluations += member->evaluations;
    if (member->status == beyond) {
      ++record.outside;
    } else if (member->status != fine) {
      ++record.failed;
      if (reasons.size() < 5) reasons.insert(member->status);
    } else {
      made.push_back(&*member);
      logs.push_back(member->log_weight);
    }
  }
  if (record.finished > 0) record.evaluations /= record.finished;
  record.failures.assign(reasons.begin(), reasons.end());
  const std::vector<double> weights = weights_of(logs);
  record.effective = effective_number(weights);
  if (task.kind == EnsembleKind::starts) {
    find_minima(made, record);
  } else if (task.kind == EnsembleKind::profiles) {
    describe_profiles(members, fit, record);
  } else if (static_cast<int>(made.size()) >= fewest_members) {
    describe_parameters(made, weights, fit, shares, record);
    find_bands(made, weights, bench, record);
    for (size_t i = 0; i < std::min(made.size(), most_drawn); ++i) {
      record.drawn.push_back(made[i]->values);
      record.weights.push_back(weights[i]);
    }
  }
  record.verdict = summary_of(record, task.kind, fit);
  return record;
}

std::string ensemble_csv(const std::vector<std::optional<EnsembleMember>>& members, const FitResult& fit) {
  std::vector<double> logs;
  for (const auto& member : members) {
    if (member && !member->values.empty()) logs.push_back(member->log_weight);
  }
  const double largest = logs.empty() ? 0 : std::ranges::max(logs);
  std::string csv = "number,status,weight,chi_squared";
  for (const ParameterEstimate& estimate : fit.parameters)
    csv += fmt::format(",{}{}", estimate.spec.id, estimate.spec.unit == "1" ? "" : " [" + estimate.spec.unit + "]");
  csv += "\n";
  for (size_t k = 0; k < members.size(); ++k) {
    if (!members[k]) continue;
    const EnsembleMember& member = *members[k];
    Cells cells{std::to_string(k), member.status};
    const bool made = !member.values.empty();
    cells.push_back(made ? exact(std::exp(member.log_weight - largest)) : "0");
    cells.push_back(made ? exact(member.chi_squared) : "");
    for (size_t j = 0; j < fit.parameters.size(); ++j) cells.push_back(made ? exact(member.values[j]) : "");
    csv += csv_line(cells) + "\n";
  }
  return csv;
}

}  // namespace taut
