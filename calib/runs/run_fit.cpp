#include "calib/runs/run_fit.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/stopwatch.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

/// A fit as a row of the table of variants, its values in the order of the main fit's parameters.
VariantRecord as_variant(const std::string& name, const Bench& bench, const FitResult& result, const FitResult& main,
                         double seconds) {
  VariantRecord record;
  record.name = name;
  record.mesh = bench.model_text();
  record.unknowns = bench.unknowns();
  record.status = name_of(result.status);
  record.chi_squared = result.chi_squared;
  record.seconds = seconds;
  if (result.status != FitStatus::converged) return record;
  for (const ParameterEstimate& wanted : main.parameters) {
    const auto found = std::find_if(result.parameters.begin(), result.parameters.end(),
                                    [&](const ParameterEstimate& e) { return e.spec.id == wanted.spec.id; });
    record.values.push_back(found != result.parameters.end() ? found->value : not_a_number);
    record.standard_errors.push_back(found != result.parameters.end() ? found->standard_error : not_a_number);
  }
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
      say(bench_.choice());
      record_.remarks.push_back(bench_.choice());
    }
    free_ = bench_.free();
    fit_all();
    if (record_.fit.status == FitStatus::start_failed) return std::move(record_);
    for (const std::string& failure : record_.fit.failures)
      record_.remarks.push_back("survived in the fit: " + failure);
    record_.interrupted = stopped();
    if (events_.keep) events_.keep(record_);
    if (!stopped()) after_the_fit();
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
  void say(const std::string& line) const {
    if (events_.say) events_.say(line);
  }
  void show(const std::string& line) const {
    if (events_.show) events_.show(line);
  }

  FitOptions fit_options(const ParameterTable& table, const std::vector<FreeParameter>& free,
                         const std::string& what) const {
    FitOptions how;
    how.stop = options_.stop;
    how.progress = [this, &table, &free, what](const FitProgress& state) {
      std::string text =
          fmt::format("{}: evaluation {}, chi squared {:.5g}", what, state.evaluation, state.chi_squared);
      for (size_t j = 0; j < free.size(); ++j) {
        const ParameterSpec& spec = table[free[j].index];
        text += fmt::format(", {} = {}", spec.id, with_unit(state.values[j], spec.unit));
      }
      show(text);
    };
    return how;
  }

  FitResult fit_from(const std::vector<FreeParameter>& start, const std::string& section) {
    LoggedProtocol protocol(bench_.protocol(), log_, section, options_.stop);
    FitOptions how = fit_options(protocol.parameters(), start, "fit");
    how.all_profiles = bench_.experiment().all_profiles;
    return fit(protocol, bench_.measurements(), start, how);
  }

  void fit_all() {
    const Stopwatch watch;
    const std::vector<FreeParameter> start = bench_.better_starts(free_);
    const double start_seconds = watch.seconds();
    FitResult& fit = record_.fit;
    fit = fit_from(start, "fit");
    if (fit.status == FitStatus::start_failed && start.front().start != free_.front().start)
      fit = fit_from(free_, "fit from the file's values");
    fit.search.seconds += start_seconds;
    for (size_t j = 0; j < fit.parameters.size(); ++j) fit.parameters[j].start = free_[j].start;
    record_.main = as_variant(bench_.fit_name(), bench_, fit, fit, watch.seconds());
    if (fit.predicted.size() > 0) fill_predictions(bench_, fit.predicted, fit.prediction_se, record_);
  }

  /// A stage that may fail without harm to the others; what it found is kept at once.
  template <class Action>
  void stage(const std::string& name, Action&& action) {
    if (stopped()) return;
    show(name);
    try {
      if (events_.begins) events_.begins(name);
      action();
    } catch (const std::exception& error) {
      record_.remarks.push_back(fmt::format("{} failed and is left out: {}", name, error.what()));
      ++record_.failed_stages;
    }
    try {
      if (events_.keep && !stopped()) events_.keep(record_);
    } catch (const std::exception& error) {
      record_.remarks.push_back(fmt::format("{} could not be written at once: {}", name, error.what()));
    }
  }

  /// Asks a protocol once, or the log.
  Prediction ask(const std::string& section, Protocol& protocol, const Params& p, const std::vector<int>& free) {
    return LoggedProtocol(protocol, log_, section, options_.stop).predict(p, free);
  }

  void after_the_fit() {
    stage("the replay", [&] { replay(); });
    if (record_.fit.predicted.size() > 0) {  // empty: the optimum could not be replayed
      record_.swings = bench_.swings(record_.fit.predicted);
      if (bench_.one_model()) stage("drawing curves", [&] { add_curves(bench_, record_.fit, free_, "curves"); });
      stage("drawing shapes", [&] { draw(); });
      if (shares_wanted()) stage("the shares of mesh and contact gap", [&] { find_shares(); });
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

  void add_curves(const Bench& bench, const FitResult& fit, const std::vector<FreeParameter>& free,
                  const std::string& section) {
    int asked = 0;
    const Ask ask_logged = [&](Protocol& protocol, const Params& p, const std::vector<int>& wanted) {
      return ask(fmt::format("{} {}", section, ++asked), protocol, p, wanted);
    };
    std::vector<CurveRecord> curves = bench.curves(fit.p, free, fit.covariance, ask_logged);
    if (stopped()) return;
    std::move(curves.begin(), curves.end(), std::back_inserter(record_.curves));
  }

  void draw() {
    const SolvedStates states = bench_.states();
    if (states.mesh != nullptr) {
      record_.shapes = draw_shapes(states);
      const std::array<int, 2> plane = drawing_plane(states);
      for (size_t i = 0; i < 2; ++i) record_.shape_axes[i] = "xyz"[plane[i]];
    }
    for (const std::string& warning : bench_.warnings_after()) record_.remarks.push_back(warning);
    if (events_.states) events_.states(states);
  }

  bool shares_wanted() const {
    const Experiment& experiment = bench_.experiment();
    return bench_.trials_at_rest() != nullptr && experiment.mesh_share && experiment.model == Rung::full &&
           record_.fit.status == FitStatus::converged;
  }

  void find_shares() {
    const Ask ask_logged = [&](Protocol& protocol, const Params& p, const std::vector<int>& free) {
      return ask(fmt::format("share {}", ++shares_asked_), protocol, p, free);
    };
    std::vector<DiscretisationShare> shares = discretisation_shares(
        bench_.experiment(), *bench_.trials_at_rest(), record_.fit, [&](const std::string& what) { show(what); },
        ask_logged);
    if (!stopped()) record_.shares = std::move(shares);
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
  }

  void diagnose_part(const std::string& id, size_t control, double held, const std::string& what) {
    const std::unique_ptr<Bench> part = bench_.part(control, held);
    LoggedProtocol protocol(part->protocol(), log_, "part " + what, options_.stop);
    FitOptions how;
    how.held = record_.fit.p;
    how.profiles = false;
    how.stop = options_.stop;
    const std::vector<ParameterEstimate>& all = record_.fit.parameters;
    const auto whole = std::find_if(all.begin(), all.end(), [&](const auto& e) { return e.spec.id == id; });
    const FreeParameter free{protocol.parameters().index(id), whole->value, whole->lower, whole->upper};
    const FitResult result = fit(protocol, part->measurements(), {free}, how);
    if (stopped()) return;
    const bool good = result.status == FitStatus::converged;
    DiagnosticRecord& diagnostic = record_.diagnostics.emplace_back();
    diagnostic.parameter = id;
    diagnostic.part = what;
    diagnostic.readings = static_cast<int>(part->readings().size());
    diagnostic.value = good ? result.parameters.front().value : not_a_number;
    diagnostic.standard_error = good ? result.parameters.front().standard_error : not_a_number;
    diagnostic.chi_squared = result.chi_squared;
  }

  /// The same fit with what the variant changes.
  void fit_variant(const VariantSettings& settings) {
    stage("variant " + settings.name, [&] {
      const Stopwatch watch;
      try {
        const std::unique_ptr<Bench> bench = bench_.with(settings);
        const std::vector<FreeParameter> free = bench->starts_after(record_.fit);
        LoggedProtocol protocol(bench->protocol(), log_, "variant " + settings.name, options_.stop);
        FitOptions how = fit_options(protocol.parameters(), free, "variant " + settings.name);
        how.profiles = false;
        const FitResult result = fit(protocol, bench->measurements(), free, how);
        if (stopped()) return;
        record_.variants.push_back(as_variant(settings.name, *bench, result, record_.fit, watch.seconds()));
        if (bench->draws_variants() && result.status == FitStatus::converged)
          add_curves(*bench, result, free, "curves of " + settings.name);
      } catch (const InputError& error) {  // a mesh that cannot be made, say: that variant's status
        VariantRecord& failed = record_.variants.emplace_back();
        failed.name = settings.name;
        failed.mesh = settings.law.empty() ? settings.mesh.describe() : settings.law;
        failed.status = error.what();
        failed.seconds = watch.seconds();
      }
    });
  }

  Bench& bench_;
  RunRecord record_;
  EvaluationLog& log_;
  const RunOptions& options_;
  const RunEvents& events_;
  std::vector<FreeParameter> free_;
  int shares_asked_ = 0;
};

}  // namespace

RunRecord start_record(const Bench& bench) {
  const Experiment& experiment = bench.experiment();
  const ParameterTable& table = bench.protocol().parameters();
  RunRecord record;
  record.title = experiment.title;
  record.simulated = experiment.simulated;
  record.setup = bench.describe();
  record.controls = bench.controls();
  record.channels = bench.channels();
  record.load_control = bench.drawn_control();
  record.load_label = bench.drawn_label();
  record.parameter_ids = table.ids();
  record.trend_degree = experiment.trend_degree;
  for (const BenchReading& from : bench.readings()) {
    ReadingRecord& reading = record.readings.emplace_back();
    reading.line = from.line;
    reading.trial = from.trial;
    reading.channel = bench.channels()[static_cast<size_t>(from.channel)].id;
    reading.controls = from.controls;
    reading.measured = from.value;
    reading.sigma = from.sigma;
    reading.predicted = reading.prediction_se = not_a_number;
    if (from.load_newtons) record.load_newtons.push_back(*from.load_newtons);
    if (experiment.kind->specimen) record.series.push_back(from.series);
  }
  record.remarks = bench.warnings_before();
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
    record.readings[i].predicted = values[bench.readings()[i].row];
    if (standard_errors.size() > 0) record.readings[i].prediction_se = standard_errors[bench.readings()[i].row];
  }
}

RunRecord run_fit(Bench& bench, RunRecord record, EvaluationLog& log, const RunOptions& options,
                  const RunEvents& events) {
  return Run(bench, std::move(record), log, options, events).go();
}

}  // namespace taut
