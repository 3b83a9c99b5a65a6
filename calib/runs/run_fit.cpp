#include "calib/runs/run_fit.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <set>
#include <tuple>

#include "calib/benches/assumptions.hpp"
#include "calib/check/plausibility.hpp"
#include "calib/fit/robust.hpp"
#include "calib/fit/spread.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/stopwatch.hpp"
#include "sim/core/units.hpp"
#include "sim/scene/scene.hpp"

namespace taut {
namespace {

const ParameterEstimate* estimate_of(const FitResult& result, const std::string& id) {
  const auto found = std::ranges::find(result.parameters, id, [](const ParameterEstimate& e) { return e.spec.id; });
  return found == result.parameters.end() ? nullptr : &*found;
}

/// Of each marker, and of all together; none where there are no markers.
std::vector<MarkerMisfit> marker_misfits(const Bench& bench, const Eigen::VectorXd& predicted) {
  std::vector<MarkerMisfit> misfits;
  std::map<std::string, std::pair<double, std::set<int>>> sums;  // squares and lines, of places
  double all = 0;
  for (const BenchReading& reading : bench.readings()) {
    const std::string& marker = bench.experiment().channels[static_cast<size_t>(reading.channel)].marker;
    if (marker.empty() || reading.excluded) continue;
    auto& [squares, lines] = sums[marker];
    squares += std::pow(predicted[reading.row] - reading.value, 2);
    lines.insert(reading.line);
  }
  double places = 0;
  for (const auto& [marker, sum] : sums) {
    misfits.push_back({marker, std::sqrt(sum.first / static_cast<double>(sum.second.size()))});
    all += sum.first;
    places += static_cast<double>(sum.second.size());
  }
  if (!misfits.empty()) misfits.push_back({"all", std::sqrt(all / places)});
  return misfits;
}

/// A fit as a row of the table of variants, its values in the order of the main fit's parameters.
VariantRecord as_variant(const std::string& name, const Bench& bench, const FitResult& result, const FitResult& main,
                         double seconds) {
  const std::string status(name_of(result.status));
  VariantRecord record{name, bench.model_text(), bench.unknowns(), status, {}, {}, result.chi_squared, seconds};
  if (result.status != FitStatus::converged) return record;
  for (const ParameterEstimate& wanted : main.parameters) {
    const ParameterEstimate* found = estimate_of(result, wanted.spec.id);
    record.values.push_back(found != nullptr ? found->value : not_a_number);
    record.standard_errors.push_back(found != nullptr ? found->standard_error : not_a_number);
  }
  for (const ParameterEstimate& e : result.parameters) {
    if (estimate_of(main, e.spec.id) == nullptr)
      record.further.push_back({e.spec.id, e.spec.unit, e.value, e.standard_error, std::string(name_of(e.verdict))});
  }
  if (result.predicted.size() > 0 && bench.experiment().kind->at_rest)
    record.markers = marker_misfits(bench, result.predicted);
  return record;
}

/// One run: its stages in their order.
class Run {
 public:
  Run(Bench& bench, RunRecord record, EvaluationLog& log, const RunOptions& options, const RunEvents& events)
      : bench_(bench), record_(std::move(record)), log_(log), options_(options), events_(events) {}

  RunRecord go() {
    const Stopwatch watch;
    if (!bench_.choice().empty()) {
      events_.say(bench_.choice());
      record_.remarks.push_back(bench_.choice());
    }
    free_ = bench_.free();
    fit_all();
    if (record_.fit.status == FitStatus::start_failed) return std::move(record_);
    for (const std::string& failure : record_.fit.failures)
      record_.remarks.push_back("survived in the fit: " + failure);
    for (const std::string& remark : record_.fit.remarks) record_.remarks.push_back(remark);
    record_.interrupted = stopped();
    events_.keep(record_);
    if (!stopped() && !options_.fit_alone) after_the_fit();
    if (stopped()) {
      record_.interrupted = true;
      if (record_.fit.status != FitStatus::interrupted)
        record_.remarks.emplace_back("interrupted: later parts of the run are missing");
      record_.fit.message = "interrupted";
    }
    record_.provenance.wall_seconds = watch.seconds();
    return std::move(record_);
  }

 private:
  bool stopped() const { return options_.stop != nullptr && options_.stop->load(); }

  /// A fit that is answered from the log as far as that goes, shown as `what`; "": not at all.
  FitResult fit_logged(const Bench& bench, const std::vector<FreeParameter>& free, const std::string& section,
                       const std::string& what, FitOptions how) {
    LoggedProtocol protocol(bench.protocol(), log_, section, options_.stop);
    how.stop = options_.stop;
    const Stopwatch watch;
    const auto progress = [&](const FitProgress& state) {
      std::string left;
      if (state.usually_left > 0)
        left = fmt::format(" (usually {} more in {:.2g} s)", state.usually_left,
                           state.usually_left * watch.seconds() / state.evaluation);
      std::string text = fmt::format("{}, {}: evaluation {}{}, chi squared {:.5g}", what, state.phase, state.evaluation,
                                     left, state.chi_squared);
      for (size_t j = 0; j < free.size(); ++j) {
        const ParameterSpec& spec = protocol.parameters()[free[j].index];
        text += fmt::format(", {} = {}", spec.id, with_unit(state.values[j], spec.unit));
      }
      events_.show(text);
    };
    if (!what.empty()) how.progress = progress;
    return fit(protocol, bench.measurements(), free, how);
  }

  /// A region's constant on which nothing depends at the start. Others may come to matter on the way: a cable's
  /// stiffness where it is still slack.
  void refuse_idle(int index) const {
    const Experiment& experiment = bench_.experiment();
    const std::string& id = bench_.protocol().parameters()[index].id;
    const std::string region = region_of(experiment, id);
    if (region.empty() || !experiment.kind->specimen) return;
    throw FileError(
        experiment.path,
        fmt::format("[fit.free.{}]: no reading depends on it at the start: {}; take this table out, or "
                    "load and measure where it matters",
                    id,
                    experiment.model == Rung::automatic
                        ? fmt::format("the models that were chosen take the region '{}' for rigid, or "
                                      "nothing strains it (model = \"full\" would tell)",
                                      region)
                        : fmt::format("nothing strains the region '{}' in a way that a channel sees", region)));
  }

  void fit_all() {
    const Stopwatch watch;
    const std::vector<FreeParameter> start = bench_.better_starts(free_);
    const double start_seconds = watch.seconds();
    FitOptions how;
    how.all_profiles = bench_.experiment().all_profiles;
    how.recover = bench_.trials_at_rest() != nullptr;  // searches of recordings take minutes each
    how.idle = [&](size_t place) { refuse_idle(start[place].index); };
    how.better_start = [&](const std::vector<FreeParameter>& from) { return bench_.better_starts(from); };
    FitResult& fit = record_.fit;
    fit = fit_logged(bench_, start, "fit", "fit", how);
    if (fit.status == FitStatus::start_failed && start.front().start != free_.front().start)
      fit = fit_logged(bench_, free_, "fit from the file's values", "fit", how);
    fit.search.seconds += start_seconds;
    for (size_t j = 0; j < fit.parameters.size(); ++j) fit.parameters[j].start = free_[j].start;
    record_.main = as_variant(bench_.fit_name(), bench_, fit, fit, watch.seconds());
    if (fit.predicted.size() > 0) fill_predictions(bench_, fit.predicted, fit.prediction_se, record_);
  }

  /// A stage that may fail without harm to the others; what it found is kept at once.
  template <class Action>
  void stage(const std::string& name, Action&& action) {
    if (stopped()) return;
    events_.show(name);
    try {
      events_.begins(name);
      action();
    } catch (const std::exception& error) {
      record_.failed_stages.push_back(fmt::format("{} failed and is left out: {}", name, error.what()));
      record_.remarks.push_back(record_.failed_stages.back());
    }
    try {
      if (!stopped()) events_.keep(record_);
    } catch (const std::exception& error) {
      record_.remarks.push_back(fmt::format("{} could not be written at once: {}", name, error.what()));
    }
  }

  /// Asks protocols by way of the log, each time in a section of its own: "curves 1".
  Ask asking(const std::string& sections) {
    return [this, sections, asked = 0](Protocol& protocol, const Params& p, const std::vector<int>& free) mutable {
      return LoggedProtocol(protocol, log_, fmt::format("{} {}", sections, ++asked), options_.stop).predict(p, free);
    };
  }

  /// What parameters that each specimen has for itself say of another one.
  void judge_specimens() {
    for (const FreeSettings& free : bench_.experiment().free) {
      if (!free.per_specimen) continue;
      std::vector<double> values, errors;
      const ParameterSpec* spec = nullptr;
      for (const ParameterEstimate& e : record_.fit.parameters) {
        if (!e.spec.id.starts_with(free.id + "_") || !(e.standard_error > 0)) continue;
        values.push_back(e.value);
        errors.push_back(e.standard_error);
        spec = &e.spec;
      }
      if (values.size() < 3) continue;
      const Spread spread = spread_of(values, errors);
      std::string text = fmt::format("{} of {} specimens: mean {} +- {} (95 %)", free.id, values.size(),
                                     with_unit(spread.mean, spec->unit), with_unit(spread.half_width, spec->unit, 2));
      text +=
          spread.resolved
              ? fmt::format(", scatter between them {} (one standard deviation); another one is predicted to +- {}",
                            with_unit(spread.omega, spec->unit, 2), with_unit(spread.next_half_width, spec->unit, 2))
              : "; scatter between them is not resolved beyond their errors";
      record_.remarks.push_back(text);
    }
  }

  /// The modulus of a material that relaxes is the one at once; says what is left of it in the long run.
  void judge_relaxation() {
    const ParameterTable& table = bench_.protocol().parameters();
    const FitResult& fit = record_.fit;
    for (const MaterialSettings& material : bench_.experiment().materials) {
      const std::string modulus = "E_" + material.region;
      if (material.prony.empty() || !table.contains(modulus)) continue;
      const double E = fit.p[table.index(modulus)];
      std::map<int, double> slopes{{table.index(modulus), 1.0}};
      for (size_t i = 0; i < material.prony.size(); ++i) {
        const int share = table.index(prony_parameters(material.region, i).first.id);
        slopes.at(table.index(modulus)) -= fit.p[share];
        slopes[share] = -E;
      }
      Prediction left;
      left.values = Eigen::VectorXd::Constant(1, E * slopes.at(table.index(modulus)));
      left.derivatives = Eigen::MatrixXd::Zero(1, static_cast<Eigen::Index>(free_.size()));
      for (size_t j = 0; j < free_.size(); ++j) {
        const auto slope = slopes.find(free_[j].index);
        if (slope != slopes.end()) left.derivatives(0, static_cast<Eigen::Index>(j)) = slope->second;
      }
      const double error = standard_errors(left, table, fit.p, free_, fit.covariance)[0];
      const std::string later = error < left.values[0]
                                    ? fmt::format("in the long run {} +- {} are left of it (noise alone)",
                                                  with_unit(left.values[0], "Pa"), with_unit(error, "Pa", 2))
                                    : "what is left of it in the long run these readings do not tell";
      record_.remarks.push_back(fmt::format("{} is the modulus at once, {}; {}", modulus, with_unit(E, "Pa"), later));
    }
  }

  void after_the_fit() {
    if (record_.fit.status == FitStatus::converged) {
      judge_specimens();
      judge_relaxation();
    }
    stage("the replay", [&] { replay(); });
    if (!record_.fit.followed.empty())
      record_.remarks.emplace_back(
          "curves are those of loads that grow from rest; what would explain the misfit, and the shares of what was "
          "assumed, are not known where rows are in another equilibrium");
    if (record_.fit.predicted.size() > 0) {  // empty: the optimum could not be replayed
      if (bench_.one_model() && bench_.trials_at_rest() != nullptr)
        stage("other equilibria", [&] { find_other_equilibria(); });
      record_.swings = bench_.swings(record_.fit.predicted);
      if (bench_.one_model()) stage("drawing curves", [&] { add_curves(bench_, record_.fit, free_, "curves"); });
      if (bench_.one_model() && bench_.trials_at_rest() != nullptr)
        stage("drawing what the fit started from", [&] { add_start_curves(); });
      stage("drawing shapes", [&] { draw(); });
      if (bench_.trials_at_rest() != nullptr && record_.fit.followed.empty())
        stage("what would explain the misfit", [&] { explain(bench_, asking("explanations"), record_); });
      if (bench_.experiment().robust && record_.fit.status == FitStatus::converged)
        stage("the robust fit", [&] { fit_robustly(); });
      if (shares_wanted()) stage("the shares of what was assumed", [&] { find_shares(); });
      if (bench_.experiment().contact.bracketed && record_.fit.status == FitStatus::converged &&
          record_.fit.followed.empty())
        stage("the friction of the lips", [&] { bracket_friction(); });
      if (bench_.experiment().diagnostic && bench_.one_model()) diagnose();
    }
    if (!bench_.one_model())
      record_.remarks.emplace_back("curves, variants and diagnostics need one model for all rows: left out");
    else if (options_.variants)
      for (const VariantSettings& variant : bench_.experiment().variants) fit_variant(variant);
  }

  /// Cold, as it is measured: what a fit costs is compared with it.
  void replay() {
    Protocol& protocol = bench_.protocol();
    const int before = protocol.factorisations();
    protocol.forget();
    const Stopwatch watch;
    const Prediction again = protocol.predict(record_.fit.p, {});
    record_.replay_seconds = watch.seconds();
    record_.replay_factorisations = protocol.factorisations() - before;
    const std::string comparison = bench_.compare_models(record_.fit.p, again.values, record_.replay_seconds);
    if (!comparison.empty()) record_.remarks.push_back(comparison);
  }

  void find_other_equilibria() {
    LoggedProtocol protocol(bench_.protocol(), log_, "other equilibria", options_.stop);
    const std::vector<Alternative> found = protocol.alternatives(record_.fit.p);
    if (stopped()) return;
    record_.equilibria = equilibria_of(bench_, found, bench_.measurements(), record_.fit.followed);
    for (ReadingRecord& reading : record_.readings) {
      for (const EquilibriaRecord& rows : record_.equilibria) {
        if (std::ranges::count(rows.lines, reading.line) > 0) reading.equilibria = mark_of(rows);
      }
    }
  }

  void add_curves(const Bench& bench, const FitResult& fit, const std::vector<FreeParameter>& free,
                  const std::string& sections) {
    const std::vector<CurveRecord> curves = bench.curves(fit.p, free, fit.covariance, asking(sections));
    if (!stopped()) record_.curves.insert(record_.curves.end(), curves.begin(), curves.end());
  }

  /// Where the search began, so that one sees how far the readings pulled it. Conditions in which the model has no
  /// equilibrium there are NaN: nothing is missing then.
  void add_start_curves() {
    Params p = record_.fit.p;
    for (size_t i = 0; i < free_.size(); ++i) p[free_[i].index] = record_.fit.parameters[i].start;
    const std::vector<CurveRecord> curves = bench_.curves(p, {}, {}, asking("curves at the start"));
    if (!stopped()) record_.start_curves = curves;
  }

  void draw() {
    const SolvedStates states = bench_.states();
    if (states.mesh != nullptr) {
      record_.shapes = draw_shapes(states);
      record_.surface = surface_record(*states.mesh);
      const std::array<int, 2> plane = drawing_plane(states);
      for (size_t i = 0; i < 2; ++i) record_.shape_axes[i] = "xyz"[plane[i]];
    }
    for (const std::string& warning : bench_.warnings_after()) record_.remarks.push_back(warning);
    events_.states(states);
  }

  void fit_robustly() {
    LoggedProtocol protocol(bench_.protocol(), log_, "robust", options_.stop);
    protocol.forget();  // whatever came before: an interrupted run goes on to the same bits
    const RobustFit found = robust_fit(protocol, bench_.measurements(), free_, record_.fit);
    if (stopped()) return;
    RobustRecord& robust = record_.robust;
    robust = {found.method, found.values, found.standard_errors, {}};
    size_t fitted = 0;
    for (const BenchReading& reading : bench_.readings()) {
      if (reading.excluded) continue;
      const double off = found.residuals[static_cast<Eigen::Index>(fitted++)];
      if (std::abs(off) > outlier_from)
        robust.outliers.push_back({reading.line, bench_.channels()[static_cast<size_t>(reading.channel)].id,
                                   reading.value, reading.value - off * reading.sigma, off});
    }
  }

  bool shares_wanted() const {
    const Experiment& experiment = bench_.experiment();
    return bench_.trials_at_rest() != nullptr && experiment.mesh_share && record_.fit.status == FitStatus::converged &&
           record_.fit.followed.empty();
  }

  bool all_rows_solid() const {
    return std::ranges::all_of(bench_.readings(), [&](const BenchReading& reading) {
      const auto model = reading.row < 0 ? std::nullopt : bench_.model_of(reading.row);
      return reading.row < 0 || (model && model->name == name_of(Rung::solid));
    });
  }

  /// Where "auto" took the solid for all rows.
  Share no_section_share() const {
    const std::vector<double> none(record_.fit.parameters.size(), 0.0);
    return {"plane section", none, none, "all rows come from the solid: no plane section is assumed"};
  }

  void find_shares() {
    Experiment experiment = bench_.experiment();
    const Trials& trials = *bench_.trials_at_rest();
    const Ask ask = asking("share");
    std::vector<Share> shares;
    if (bench_.model_of(0))
      shares.push_back(model_share(bench_, record_.fit, ask));
    else
      shares = discretisation_shares(experiment, trials, record_.fit, events_.show, ask);
    if (auto share = law_share(bench_, record_.fit, ask)) shares.push_back(*share);
    if (all_rows_solid()) {
      shares.push_back(no_section_share());
    } else if (bench_.one_model()) {  // "auto" looks at the section itself
      if (experiment.model == Rung::beam) experiment.model = Rung::full;
      if (auto share = section_share(experiment, trials, record_.fit, events_.show, ask)) shares.push_back(*share);
    }
    for (Share& share : assumption_shares(experiment, bench_.with_dimensions(), record_.fit, events_.show, ask))
      shares.push_back(std::move(share));
    if (stopped()) return;
    record_.shares = std::move(shares);
    add_up();
  }

  void bracket_friction() {
    std::optional<LipFriction> found = lip_friction(bench_, record_.fit, asking("friction"));
    if (stopped()) return;
    if (!found) {
      record_.remarks.emplace_back("friction of the lips: no row closes, so that it changes nothing");
      return;
    }
    record_.lip_friction = std::move(found->rows);
    record_.shares.push_back(std::move(found->share));
    add_up();
  }

  void add_up() {
    for (size_t j = 0; j < record_.fit.parameters.size(); ++j) {
      ParameterEstimate& estimate = record_.fit.parameters[j];
      const TotalInterval total = total_interval(estimate, record_.shares, j);
      std::tie(estimate.total_lower95, estimate.total_upper95) = std::tie(total.lower, total.upper);
    }
  }

  /// Values from parts of the readings that differ by more than their errors have a share, too.
  void judge_spread(const std::string& id, const std::string& per) {
    const ParameterEstimate& whole = *estimate_of(record_.fit, id);
    std::vector<double> values, errors;
    for (const DiagnosticRecord& part : record_.diagnostics) {
      if (part.parameter != id || !(part.value > 0) || !(part.standard_error > 0)) continue;
      values.push_back(whole.spec.logarithmic ? std::log(part.value) : part.value);
      errors.push_back(part.standard_error / (whole.spec.logarithmic ? part.value : 1));
    }
    if (values.size() < 3) return;
    const Spread spread = spread_of(values, errors);
    if (!spread.resolved) return;
    const double scale = whole.spec.logarithmic ? whole.value : 1;
    Share share;
    share.source = fmt::format("scatter between {}s", per);
    for (const ParameterEstimate& e : record_.fit.parameters) {
      share.bias.push_back(0);
      share.error.push_back(&e == &whole ? scale * spread.half_width : 0);
    }
    share.how = fmt::format(
        "{} values of {} scatter by {} beyond their errors (one standard deviation); another {} is "
        "predicted to +- {}",
        values.size(), id, with_unit(scale * spread.omega, whole.spec.unit, 2), per,
        with_unit(scale * spread.next_half_width, whole.spec.unit, 2));
    record_.shares.push_back(std::move(share));
    add_up();
  }

  /// Fits one parameter to the readings of each value of a control alone, from the whole fit's result: values that
  /// differ by more than their errors say that one law does not serve all readings.
  void diagnose() {
    const DiagnosticSettings& settings = *bench_.experiment().diagnostic;
    size_t control = 0;
    while (bench_.controls()[control].id != settings.per) ++control;
    for (double held : bench_.values_of(control)) {
      const std::string what = bench_.describe_control(control, held);
      stage(fmt::format("{} from {} alone", settings.parameter, what),
            [&] { diagnose_part(settings.parameter, control, held, what); });
    }
    stage("the scatter", [&] { judge_spread(settings.parameter, settings.per); });
  }

  void diagnose_part(const std::string& id, size_t control, double held, const std::string& what) {
    const std::unique_ptr<Bench> part = bench_.part(control, held);
    const ParameterEstimate& whole = *estimate_of(record_.fit, id);
    const FreeParameter free{part->protocol().parameters().index(id), whole.value, whole.lower, whole.upper};
    FitOptions how;
    how.held = record_.fit.p;
    how.profiles = how.recover = false;
    const FitResult result = fit_logged(*part, {free}, "part " + what, "", how);
    if (stopped()) return;
    DiagnosticRecord& diagnostic = record_.diagnostics.emplace_back(id, what, not_a_number, not_a_number);
    diagnostic.chi_squared = result.chi_squared;
    diagnostic.readings = static_cast<int>(part->readings().size());
    if (result.status != FitStatus::converged) return;
    diagnostic.value = result.parameters.front().value;
    diagnostic.standard_error = result.parameters.front().standard_error;
  }

  /// The same fit with what the variant changes.
  void fit_variant(const VariantSettings& settings) {
    stage("variant " + settings.name, [&] {
      const Stopwatch watch;
      try {
        const std::unique_ptr<Bench> bench = bench_.with(settings);
        const std::vector<FreeParameter> free = bench->starts_after(record_.fit);
        FitOptions how;
        how.profiles = how.recover = false;
        const std::string name = "variant " + settings.name;
        const FitResult result = fit_logged(*bench, free, name, name, how);
        if (stopped()) return;
        record_.variants.push_back(as_variant(settings.name, *bench, result, record_.fit, watch.seconds()));
        if (bench_.experiment().model == Rung::rod) record_.variants.back().law = settings.law;
        if (bench->draws_variants() && result.status == FitStatus::converged)
          add_curves(*bench, result, free, "curves of " + settings.name);
      } catch (const InputError& error) {  // a mesh that cannot be made, say: that variant's status
        const std::string model = settings.law.empty() ? bench_.model_text() : settings.law;
        record_.variants.push_back({settings.name, model, 0, error.what(), {}, {}, 0, watch.seconds()});
      }
    });
  }

  Bench& bench_;
  RunRecord record_;
  EvaluationLog& log_;
  const RunOptions& options_;
  const RunEvents& events_;
  std::vector<FreeParameter> free_;
};

}  // namespace

namespace {

/// The column of each axis in the bench's file, with its unit; `common` is that of all that name none.
std::vector<std::string> columns_in_file(const Experiment& experiment, const std::vector<AxisRecord>& axes,
                                         const auto& settings, const std::string& common) {
  std::vector<std::string> columns;
  for (const AxisRecord& axis : axes) {
    const auto found = std::ranges::find_if(settings, [&](const auto& one) { return one.id == axis.id; });
    std::string& column =
        columns.emplace_back(found == settings.end() || found->column.empty() ? common : found->column);
    if (const auto title = experiment.titles.find(column); title != experiment.titles.end()) column = title->second;
  }
  return columns;
}

}  // namespace

RunRecord start_record(const Bench& bench) {
  const Experiment& experiment = bench.experiment();
  const ParameterTable& table = bench.protocol().parameters();
  RunRecord record;
  record.title = experiment.title;
  record.simulated = experiment.simulated;
  record.setup = bench.describe();
  if (!experiment.encoding.empty()) record.setup.emplace_back("experiment file", experiment.encoding);
  record.controls = bench.controls();
  record.channels = bench.channels();
  record.control_columns = columns_in_file(experiment, record.controls, experiment.bench.controls, "");
  record.channel_columns =
      columns_in_file(experiment, record.channels, experiment.bench.channels, experiment.bench.value_column);
  record.load_control = bench.drawn_control();
  record.load_label = bench.drawn_label();
  record.by_tension = record.load_control >= 0 && experiment.cables.tension_columns.contains(
                                                      record.controls[static_cast<size_t>(record.load_control)].id);
  record.parameter_ids = table.ids();
  record.trend_degree = experiment.trend_degree;
  for (const BenchReading& from : bench.readings()) {
    record.readings.push_back({.line = from.line,
                               .trial = from.trial,
                               .channel = bench.channels()[static_cast<size_t>(from.channel)].id,
                               .controls = from.controls,
                               .measured = from.value,
                               .sigma = from.sigma,
                               .predicted = not_a_number,
                               .prediction_se = not_a_number,
                               .excluded = from.excluded});
    if (from.load_newtons) record.load_newtons.push_back(*from.load_newtons);
    if (experiment.kind->specimen) record.series.push_back(from.series);
  }
  record.remarks = bench.warnings_before();
  for (const Finding& finding : implausible(bench)) record.remarks.push_back(finding.sentence);
  for (const ReferenceValue& reference : experiment.references) {
    const ParameterSpec& spec = table[table.index(reference.parameter)];
    record.references.push_back(
        {reference.parameter,
         parse_quantity(reference.value.text, quantity_of_si_unit(spec.unit), reference.value.where),
         reference.source});
  }
  return record;
}

void fill_predictions(const Bench& bench, const Eigen::VectorXd& values, const Eigen::VectorXd& standard_errors,
                      RunRecord& record) {
  for (size_t i = 0; i < record.readings.size(); ++i) {
    if (bench.readings()[i].row < 0) continue;
    record.readings[i].predicted = values[bench.readings()[i].row];
    if (standard_errors.size() > 0) record.readings[i].prediction_se = standard_errors[bench.readings()[i].row];
  }
}

namespace {

/// Whether nothing but the tensions of cables is set: then every setting is a part of its own.
bool pulled_alone(const Bench& bench) {
  const auto& tensions = bench.experiment().cables.tension_columns;
  return !tensions.empty() &&
         std::ranges::all_of(bench.controls(), [&](const AxisRecord& axis) { return tensions.contains(axis.id); });
}

/// Each value of a control that is held while loads are hung.
std::vector<HeldOut> parts_held_out(const Bench& bench, const ExplainedReadings& readings, const Prediction& prediction,
                                    const FitResult& fit) {
  std::vector<HeldOut> parts;
  if (pulled_alone(bench)) {
    std::map<std::vector<double>, std::vector<size_t>> rows;
    for (size_t i = 0; i < readings.readings.size(); ++i) rows[readings.readings[i].controls].push_back(i);
    for (const auto& [controls, of_setting] : rows) {
      std::vector<std::string> texts;
      for (size_t k = 0; k < controls.size(); ++k) texts.push_back(bench.describe_control(k, controls[k]));
      if (rows.size() > 1) parts.push_back(held_out(prediction, bench.measurements(), fit, join(texts), of_setting));
    }
    return parts;
  }
  for (size_t k = 0; k < bench.controls().size(); ++k) {
    if (static_cast<int>(k) == bench.drawn_control()) continue;
    std::map<double, std::vector<size_t>> rows;
    for (size_t i = 0; i < readings.readings.size(); ++i) rows[readings.readings[i].controls[k]].push_back(i);
    if (rows.size() < 2) continue;
    for (const auto& [value, of_value] : rows)
      parts.push_back(held_out(prediction, bench.measurements(), fit, bench.describe_control(k, value), of_value));
  }
  return parts;
}

}  // namespace

void explain(const Bench& bench, const Ask& ask, RunRecord& record) {
  const FitResult& fit = record.fit;
  ExplainedReadings readings;
  for (const BenchReading& reading : bench.readings()) {
    if (!reading.excluded) readings.readings.push_back(reading);
  }
  for (const AxisRecord& axis : bench.channels()) readings.channels.push_back({axis.id, axis.unit});
  const Trials* trials = bench.trials_at_rest();
  std::optional<DimensionedModel> dimensioned;
  const Rung rung = bench.experiment().model;
  if (trials != nullptr && (rung == Rung::full || rung == Rung::rod)) dimensioned = bench.with_dimensions();
  Protocol& protocol = dimensioned ? *dimensioned->protocol : bench.protocol();
  const ParameterTable& table = protocol.parameters();
  const Params p = dimensioned ? dimensioned->values_of(fit) : fit.p;
  std::vector<int> columns;
  for (const ParameterEstimate& estimate : fit.parameters) columns.push_back(table.index(estimate.spec.id));
  for (const AxisRecord& axis : bench.controls()) {
    readings.controls.push_back({axis.id, axis.unit});
    columns.push_back(table.index(axis.id));
  }
  if (dimensioned) {
    for (const Assumption& one : assumptions_of(bench.experiment(), table, p, dimensioned->dimensions)) {
      if (one.id == "g" || estimate_of(fit, one.id) != nullptr ||
          std::ranges::find(readings.controls, one.id, &ExplainedReadings::Axis::id) != readings.controls.end())
        continue;
      readings.assumed.push_back({one.id, one.unit});
      columns.push_back(table.index(one.id));
    }
  }
  readings.load = bench.drawn_control();
  const Prediction prediction = ask(protocol, p, columns);
  if (!prediction.complete()) throw InputError(prediction.failures.front());
  record.explanations = explain_misfit(readings, prediction, bench.measurements(), fit);
  if (fit.status == FitStatus::converged) record.held_out = parts_held_out(bench, readings, prediction, fit);
}

RunRecord run_fit(Bench& bench, RunRecord record, EvaluationLog& log, const RunOptions& options,
                  const RunEvents& events) {
  return Run(bench, std::move(record), log, options, events).go();
}

}  // namespace taut
