#pragma once
#include <span>
#include <stdexcept>
#include <string>
#include <tuple>

#include "reports/axes.hpp"

/// What the records of a run consist of, said once for all that walk them: fit.json in both directions (JsonArchive,
/// run_record.cpp), the columns of predictions.csv (report.cpp). A member more is a line more here: its key, and
/// itself. The order is that of the file. Used inside reports/ only.
///
/// `a(key, member)` walks a member, `a[key]` is what stands under a key, `a.there(key)` is false for a key that an
/// older file lacks or that has nothing to say, `need(condition, text)` says what was needed in a file that holds
/// something else.
namespace taut {

/// Said of a number that has the unit of its reading's channel.
struct InUnitOfChannel {};

/// Walks the members of a record.
/// @{
void describe(auto&& a, ReadingRecord& reading) {
  a("line", reading.line);
  a("trial", reading.trial);
  a("channel", reading.channel);
  a("controls", reading.controls);
  a("measured", reading.measured, InUnitOfChannel());
  a("sigma", reading.sigma, InUnitOfChannel());
  a("predicted", reading.predicted, InUnitOfChannel());
  a("prediction_se", reading.prediction_se, InUnitOfChannel());
}

void describe(auto&& a, AxisRecord& axis) {
  a("id", axis.id);
  const bool whole = a.there("quantity");  // older files have units only
  if (whole) a("quantity", axis.quantity);
  a("unit", axis.unit);
  if (a.there("labels", !axis.labels.empty())) a("labels", axis.labels);
  if (whole) return a("label", axis.label);
  try {
    axis.quantity = name_of(quantity_of_si_unit(axis.unit));
  } catch (const std::logic_error&) {
    a["unit"].need(false, "an SI unit");
  }
  axis.label = is(axis, Quantity::pure) ? "engineering strain" : axis.id;
}

void describe(auto&& a, ParameterEstimate& estimate) {
  a("id", estimate.spec.id);
  a("symbol", estimate.spec.symbol);
  a("meaning", estimate.spec.meaning);
  a("value", estimate.value);
  a("unit", estimate.spec.unit);
  a("standard_error", estimate.standard_error);
  a("interval95", std::tie(estimate.lower95, estimate.upper95));
  if (a.there("total95", estimate.total_lower95 || estimate.total_upper95))
    a("total95", std::tie(estimate.total_lower95, estimate.total_upper95));
  a("profile", estimate.profile);
  a("verdict", estimate.verdict);
  a("explanation", estimate.explanation);
  a("start", estimate.start);
  a["bounds"].walk_bounds(estimate.lower, estimate.upper);
  a["physical_bounds"].walk_bounds(estimate.spec.lower, estimate.spec.upper);
}

void describe(auto&& a, LackOfFit& lack) {
  a("available", lack.available);
  a("lack_of_fit", lack.lack_of_fit);
  a("pure_error", lack.pure_error);
  a("lack_of_fit_dof", lack.lack_of_fit_dof);
  a("pure_error_dof", lack.pure_error_dof);
  a("F", lack.F);
  a("p_value", lack.p_value);
}

void describe(auto&& a, FurtherRecord& further) {
  a("id", further.id);
  a("unit", further.unit);
  a("value", further.value);
  a("standard_error", further.standard_error);
  a("verdict", further.verdict);
}

void describe(auto&& a, MarkerMisfit& misfit) {
  a("marker", misfit.marker);
  a("rms", misfit.rms);
}

void describe(auto&& a, VariantRecord& variant) {
  a("name", variant.name);
  a("mesh", variant.mesh);
  a("unknowns", variant.unknowns);
  a("status", variant.status);
  a("values", variant.values);
  a("standard_errors", variant.standard_errors);
  a("chi_squared", variant.chi_squared);
  a("seconds", variant.seconds);
  if (a.there("further", !variant.further.empty())) a("further", variant.further);
  if (a.there("law", !variant.law.empty())) a("law", variant.law);
  if (a.there("markers", !variant.markers.empty())) a("markers", variant.markers);
}

void describe(auto&& a, DiagnosticRecord& diagnostic) {
  a("parameter", diagnostic.parameter);
  a("part", diagnostic.part);
  a("value", diagnostic.value);
  a("standard_error", diagnostic.standard_error);
  a("chi_squared", diagnostic.chi_squared);
  a("readings", diagnostic.readings);
}

void describe(auto&& a, SwingRecord& swing) {
  a("recording", swing.recording);
  a("channel", swing.channel);
  a("frequency_Hz", swing.frequency);
  a("decay_per_s", swing.decay);
  a("predicted_frequency_Hz", swing.predicted_frequency);
  a("predicted_decay_per_s", swing.predicted_decay);
}

void describe(auto&& a, Share& share) {
  a("source", share.source);
  a("bias", share.bias);
  a("error", share.error);
  a("how", share.how);
  a("seconds", share.seconds);
  if (a.there("counted")) a("counted", share.counted);
  if (a.there("moves")) a("moves", share.moves);
}

void describe(auto&& a, EnsembleMarginal& marginal) {
  a("id", marginal.id);
  a("unit", marginal.unit);
  a("mean", marginal.mean);
  a("deviation", marginal.deviation);
  a("median", marginal.median);
  a("interval95", std::tie(marginal.lower95, marginal.upper95));
  if (a.there("total95", marginal.total_lower95 || marginal.total_upper95))
    a("total95", std::tie(marginal.total_lower95, marginal.total_upper95));
  a("width_to_parabola", marginal.width);
  a("width_error", marginal.width_error);
  a("verdict", marginal.verdict);
}

void describe(auto&& a, EnsembleMinimum& minimum) {
  a("chi_squared", minimum.chi_squared);
  a("starts", minimum.starts);
  a("values", minimum.values);
}

void describe(auto&& a, EnsembleRecord& ensemble) {
  a("kind", ensemble.kind);
  a("how", ensemble.how);
  a("verdict", ensemble.verdict);
  a("asked", ensemble.asked);
  a("finished", ensemble.finished);
  a("failed", ensemble.failed);
  a("outside", ensemble.outside);
  a("seed", ensemble.seed);
  a("effective", ensemble.effective);
  a("evaluations", ensemble.evaluations);
  a("parameters", ensemble.parameters);
  a("correlation", ensemble.correlation);
  a("bands", ensemble.bands);
  a("drawn", ensemble.drawn);
  a("weights", ensemble.weights);
  a("minima", ensemble.minima);
  if (a.there("profiles", !ensemble.profiles.empty())) a("profiles", ensemble.profiles);
  a("failures", ensemble.failures);
}

void describe(auto&& a, FrictionRow& row) {
  a("channel", row.channel);
  a("controls", row.controls);
  a("sliding", row.sliding);
  a("sticking", row.sticking);
  a("sliding_stiffness", row.sliding_stiffness);
  a("sticking_stiffness", row.sticking_stiffness);
}

void describe(auto&& a, HeldOut& held_out) {
  a("part", held_out.part);
  a("readings", held_out.readings);
  a("chi_squared", held_out.chi_squared);
  a("dof", held_out.dof);
  a("p_value", held_out.p_value);
  a("parameters_of_its_own", held_out.own);
}

void describe(auto&& a, Explanation& explanation) {
  a("kind", explanation.kind);
  a("name", explanation.name);
  a("what", explanation.what);
  a("lines", explanation.lines);
  a("values", explanation.values);
  a("standard_errors", explanation.standard_errors);
  a("unit", explanation.unit);
  a("chi_squared_fall", explanation.fall);
  a("chi_squared", explanation.chi_squared);
  a("dof", explanation.dof);
  a("p_value", explanation.p_value);
  a("shifts", explanation.shifts);
  a("like_parameters", explanation.like_parameters);
  a("like", explanation.like);
  a("includes", explanation.includes);
}

void describe(auto&& a, OutlierRecord& outlier) {
  a("line", outlier.line);
  a("channel", outlier.channel);
  a("measured", outlier.measured);
  a("expected", outlier.expected);
  a("off_sigmas", outlier.off);
}

void describe(auto&& a, RobustRecord& robust) {
  a("method", robust.method);
  a("values", robust.values);
  a("standard_errors", robust.standard_errors);
  a("outliers", robust.outliers);
}

void describe(auto&& a, EquilibriaRecord& equilibria) {
  a("lines", equilibria.lines);
  a("decided", equilibria.decided);
  a("jump", equilibria.jump);
  a("text", equilibria.text);
}

void describe(auto&& a, ReferenceRecord& reference) {
  a("parameter", reference.parameter);
  a("value", reference.value);
  a("source", reference.source);
}

void describe(auto&& a, ShapeRecord::Area& area) {
  a("region", area.region);
  a("loops", area.loops);
}

void describe(auto&& a, ContactRecord& contact) {
  a("centre", contact.centre);
  a("force", contact.force);
  a("places", contact.places);
}

void describe(auto&& a, SurfaceRecord& surface) {
  a("regions", surface.regions);
  a("triangles", surface.triangles);
  a("triangle_regions", surface.triangle_regions);
}

void describe(auto&& a, ShapeRecord& shape) {
  a("label", shape.label);
  a("segments", shape.segments);
  if (a.there("row", !shape.row.empty() || !shape.column.empty())) {
    a("row", shape.row);
    a("column", shape.column);
  }
  if (a.there("areas", !shape.areas.empty())) a("areas", shape.areas);
  if (a.there("cables", !shape.cables.empty())) a("cables", shape.cables);
  if (a.there("points", !shape.points.empty())) a("points", shape.points);
  if (a.there("space_cables", !shape.space_cables.empty())) a("space_cables", shape.space_cables);
  if (a.there("contacts", !shape.contacts.empty())) a("contacts", shape.contacts);
}

void describe(auto&& a, InputRecord& input) {
  a("path", input.path);
  if (a.there("copy")) a("copy", input.copy);
  a("sha256", input.sha256);
}

void describe(auto&& a, Provenance& provenance) {
  a("version", provenance.version);
  a("commit", provenance.commit);
  a("command_line", provenance.command_line);
  a["libraries"].walk_list(provenance.libraries, [](auto&& library, auto& pair) {
    library("name", pair.first);
    library("version", pair.second);
  });
  a("inputs", provenance.inputs);
  a("started", provenance.started);
  a("machine", provenance.machine);
  a("seed", provenance.seed);
}

void describe(auto&& a, SearchStep& step) {
  a("phase", step.phase);
  a("chi_squared", step.chi_squared);
  a("values", step.values);
}

/// Under the key "fit": what is not said of the parameters one by one.
void describe_fit(auto&& a, RunRecord& record) {
  FitResult& fit = record.fit;
  a("chi_squared", fit.chi_squared);
  a("dof", fit.dof);
  a("chi_squared_p", fit.chi_squared_p);
  a("lack_of_fit", fit.lack_of_fit);
  a("evaluations", fit.evaluations);
  a("failed_evaluations", fit.failed_evaluations);
  a("iterations", fit.iterations);
  if (a.there("history", !fit.history.empty())) a("history", fit.history);
  a("covariance", fit.covariance);
  a["covariance_scale"].walk_list(std::span(fit.parameters), [](auto&& scale, ParameterEstimate& estimate) {
    scale.walk_either(estimate.spec.logarithmic, "logarithm", "linear");
  });
  a("correlation", fit.correlation);
  a("singular_values", fit.singular_values);
  a("weakest_combination", fit.weakest);
  a("failures", fit.failures);
  a["all_parameters"].walk_map(record.parameter_ids, fit.p);
}

/// Loads and series stand among the readings: either all of them have one or none.
void describe_readings(auto&& a, RunRecord& record) {
  a.walk_list(record.readings, [&](auto&& entry, ReadingRecord& reading) {
    const auto i = static_cast<size_t>(&reading - record.readings.data());
    const auto beside = [&](const char* key, auto& values) {
      if (i == 0 && entry.there(key, !values.empty())) values.resize(record.readings.size());
      if (!values.empty()) entry(key, values[i]);
    };
    describe(entry, reading);
    if (entry.there("excluded", reading.excluded)) entry("excluded", reading.excluded);
    if (entry.there("equilibria", !reading.equilibria.empty())) entry("equilibria", reading.equilibria);
    beside("load_N", record.load_newtons);
    beside("series", record.series);
  });
}

void describe_curves(auto&& a, RunRecord& record, std::vector<CurveRecord>& curves) {
  a.walk_list(curves, [&](auto&& entry, CurveRecord& curve) {
    entry("channel", curve.channel);
    entry("series", curve.series);
    entry(over_strain(record) ? "strain" : over_time(record) ? "time_s" : "load_N", curve.load);
    entry("value", curve.value);
    entry("se", curve.se);
    entry("increment_se", curve.increment_se);
  });
}

void describe_timing(auto&& a, RunRecord& record) {
  a("wall_seconds", record.provenance.wall_seconds);
  a("replay_seconds", record.replay_seconds);
  a("replay_factorisations", record.replay_factorisations);
  a("fit_seconds", record.fit.search.seconds);
  a("fit_factorisations", record.fit.search.factorisations);
  a("profile_seconds", record.fit.profiles.seconds);
  a("profile_factorisations", record.fit.profiles.factorisations);
}

void describe(auto&& a, RunRecord& record) {
  bool measured = !record.simulated;
  a("title", record.title);
  a["data"].walk_either(measured, "measured", "simulated");
  record.simulated = !measured;
  std::string kind = over_strain(record) ? "material point" : over_time(record) ? "recordings" : "specimen";
  if (!a.reading()) a("kind", kind);  // for others: it follows from the controls
  a("status", record.fit.status);
  a("message", record.fit.message);
  a("parameters", record.fit.parameters);
  if (a.there("explanations")) a("explanations", record.explanations);
  if (a.there("held_out", !record.held_out.empty())) a("held_out", record.held_out);
  if (a.there("robust", !record.robust.method.empty())) a("robust", record.robust);
  if (a.there("shares")) a("shares", record.shares);
  if (a.there("lip_friction", !record.lip_friction.empty())) a("lip_friction", record.lip_friction);
  describe_fit(a["fit"], record);
  if (a.there("interrupted")) a("interrupted", record.interrupted);
  a("controls", record.controls);
  if (a.there("channels")) a("channels", record.channels);
  if (a.there("control_columns", !record.control_columns.empty())) a("control_columns", record.control_columns);
  if (a.there("channel_columns", !record.channel_columns.empty())) a("channel_columns", record.channel_columns);
  a["load"]("label", record.load_label);
  a["load"]("control", record.load_control);
  if (a["load"].there("by_tension", record.by_tension)) a["load"]("by_tension", record.by_tension);
  a["load"]["control"].need(record.load_control < static_cast<int>(record.controls.size()),
                            "the index of a control, or -1");
  describe_readings(a["readings"], record);
  if (a.there("equilibria", !record.equilibria.empty())) a("equilibria", record.equilibria);
  describe_curves(a["curves"], record, record.curves);
  if (a.there("start_curves", !record.start_curves.empty()))
    describe_curves(a["start_curves"], record, record.start_curves);
  a("shape_axes", std::tie(record.shape_axes[0], record.shape_axes[1]));
  if (a.there("surface", !record.surface.triangles.empty())) a("surface", record.surface);
  a("shapes", record.shapes);
  if (a.there("trend_degree")) a("trend_degree", record.trend_degree);
  a("main", record.main);
  a("variants", record.variants);
  a("diagnostics", record.diagnostics);
  if (a.there("swings")) a("swings", record.swings);
  a("references", record.references);
  if (a.there("ensembles", !record.ensembles.empty())) a("ensembles", record.ensembles);
  a["setup"].walk_list(record.setup, [](auto&& line, auto& pair) {
    line("name", pair.first);
    line("value", pair.second);
  });
  a("remarks", record.remarks);
  describe_timing(a["timing"], record);
  a("provenance", record.provenance);
}

/// @}

}  // namespace taut
