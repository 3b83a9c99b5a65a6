#include "experiments/cli/session.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <set>

#include "calib/models/beam_model.hpp"
#include "calib/models/ladder.hpp"
#include "experiments/cli/version.hpp"
#include "reports/vtu.hpp"
#include "sim/core/error.hpp"
#include "sim/mesh/loops.hpp"

namespace taut {
namespace {

namespace fs = std::filesystem;

constexpr const char* experiment_copy = "experiment.toml";
constexpr const char* data_copy = "data.csv";
constexpr const char* mesh_copy = "mesh.msh";

std::string list_of(const std::vector<double>& values, std::string_view unit) {
  std::string text;
  for (double value : values) text += fmt::format("{}{}", text.empty() ? "" : ", ", with_unit(value, unit));
  return text;
}

/// "5.89 mm"; zero in the unit of the control's other values.
std::string control_text(const Session& session, size_t k, double value) {
  const std::string& unit = session.bench.protocol->parameters()[session.bench.protocol->controls()[k]].unit;
  if (value != 0) return with_unit(value, unit);
  double largest = 0;
  for (const Reading& reading : session.trials.readings) largest = std::max(largest, std::abs(reading.controls[k]));
  const DisplayUnit shown = display_unit(largest, unit);
  return shown.name.empty() || shown.name == "1" ? "0" : "0 " + shown.name;
}

}  // namespace

Session open_session(const CommandOptions& options) {
  Session session;
  session.experiment = read_experiment(options.target);
  session.experiment.equilibrium.stop = options.stop;
  if (options.threads > 0) session.experiment.threads = options.threads;
  session.trials = read_trials(session.experiment.bench);
  Experiment& experiment = session.experiment;
  if (experiment.model == Rung::solid) experiment.mesh = deepened(experiment, experiment.mesh);
  session.bench = make_static_bench(experiment, experiment.mesh, session.trials);
  if (experiment.model == Rung::beam) session.rungs = make_beam_bench(experiment, session.trials).protocol;
  if (experiment.model == Rung::automatic) {
    Ladder ladder = climb(experiment, session.trials, session.bench);
    session.rungs = std::move(ladder.protocol);
    session.choice = ladder.sentence;
  }
  return session;
}

std::string compare_models(const Session& session, const Params& p, const Eigen::VectorXd& values, double seconds) {
  if (!session.rungs) return "";
  const auto start = std::chrono::steady_clock::now();
  session.bench.protocol->forget();
  const Prediction full = session.bench.protocol->predict(p, {});
  const double took = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  double largest = 0;
  for (Eigen::Index r = 0; r < values.size(); ++r) {
    if (full.values[r] != 0 && std::isfinite(full.values[r] + values[r]))
      largest = std::max(largest, std::abs(values[r] / full.values[r] - 1));
  }
  std::string doubt;
  if (const auto* beams = dynamic_cast<const BeamProtocol*>(session.rungs.get())) {
    int rows = 0;
    for (int row = 0; row < beams->row_count(); ++row) rows += beams->stated_error(row) <= 0.1 ? 0 : 1;
    if (rows > 0)
      doubt = fmt::format("; {} of {} rows are beyond what a chain of beams describes within 10 %", rows,
                          beams->row_count());
  }
  const auto failed = std::count_if(values.begin(), values.end(), [](double value) { return !std::isfinite(value); });
  if (failed > 0) doubt += fmt::format("; {} rows have no equilibrium", failed);
  return fmt::format(
      "a replay by the chosen models takes {:.2g} s, by the full one {:.2g} s; they differ by at most {:.2g} %{}",
      seconds, took, 100 * largest, doubt);
}

Progress::Progress(bool quiet) : quiet_(quiet), terminal_(isatty(STDERR_FILENO) != 0) {}
Progress::~Progress() {
  clear();
}

void Progress::clear() {
  if (shown_) std::fputs("\r\033[K", stderr);
  shown_ = false;
}

void Progress::say(const std::string& line) {
  if (quiet_) return;
  clear();
  fmt::print(stderr, "{}\n", line);
}

void Progress::show(const std::string& line) {
  if (quiet_ || !terminal_) return;
  fmt::print(stderr, "\r\033[K{}", line.substr(0, 150));
  std::fflush(stderr);
  shown_ = true;
}

std::string experiment_name(const std::string& path) {
  const fs::path file = fs::absolute(path);
  const std::string stem = file.stem().string();
  return stem == "experiment" ? file.parent_path().filename().string() : stem;
}

std::string run_folder(const CommandOptions& options) {
  return options.out.empty() ? (fs::path("runs") / experiment_name(options.target)).string() : options.out;
}

std::vector<std::pair<std::string, std::string>> describe_setup(const Session& session) {
  const Experiment& e = session.experiment;
  const Model& model = *session.bench.protocol->scene().model;
  std::vector<std::pair<std::string, std::string>> lines;
  lines.emplace_back("data", e.simulated ? "simulated" : "measured");
  std::string geometry = e.geometry.kind;
  if (!e.geometry.size.empty()) geometry += " of " + list_of(e.geometry.size, "m");
  if (e.geometry.dimension == 2)
    geometry += fmt::format(", plane {}, {} thick", e.geometry.plane == Plane::strain ? "strain" : "stress",
                            with_unit(e.geometry.thickness, "m"));
  lines.emplace_back("geometry", geometry);
  lines.emplace_back("mesh",
                     fmt::format("{}: {} nodes, {} elements, {} unknowns", e.mesh.describe(), model.mesh().node_count(),
                                 model.mesh().element_count(), model.free_unknowns()));
  for (const MaterialSettings& material : e.materials) {
    std::string text = material.law;
    for (const auto& [id, value] : material.constants)
      text += fmt::format(", {} = {}", id, with_unit(value, id == "E" ? "Pa" : "1"));
    if (material.density) text += fmt::format(", density = {}", with_unit(*material.density, "kg/m3"));
    lines.emplace_back("material " + material.region, text);
  }
  for (const SupportSettings& support : e.supports) {
    std::string text;
    for (int component : support.fix) text += fmt::format("{}{}", text.empty() ? "fixed in " : ", ", "xyz"[component]);
    if (support.rotation_stiffness)
      text += fmt::format("elastic, rotation stiffness {}", with_unit(*support.rotation_stiffness, "Nm/rad"));
    if (!support.control.empty())
      text += fmt::format("{}moved in {} by column '{}'", text.empty() ? "" : "; ", "xyz"[support.component],
                          support.column);
    lines.emplace_back("support " + support.on, text);
  }
  if (!e.gravity_direction.empty())
    lines.emplace_back("self-weight", fmt::format("g = {}", with_unit(e.gravity, "m/s2", 6)));
  for (const LoadSettings& load : e.loads) {
    const std::string place = load.on.empty() ? "point (" + list_of(load.point, "m") + ")" : load.on;
    lines.emplace_back("load " + load.id,
                       fmt::format("{} on {}, {}", name_of(load.quantity), place,
                                   load.column.empty() ? "constant " + fmt::format("{:.6g} (SI)", load.value)
                                                       : "column '" + load.column + "'"));
  }
  if (!e.cables.cables.empty()) {
    const ParameterTable& table = session.bench.protocol->parameters();
    const Params& nominal = session.bench.protocol->nominal();
    std::string text;
    for (const CableSettings& cable : e.cables.cables) text += (text.empty() ? "" : ", ") + cable.id;
    text += fmt::format("; k = {}, slack = {}", with_unit(nominal[table.index("k_cable")], "N/m"),
                        with_unit(nominal[table.index("slack")], "m"));
    for (const auto& [id, column] : e.cables.columns)
      text += fmt::format("; retracted by column '{}', before the loads", column);
    lines.emplace_back("cables", text);
  }
  if (e.contact.on) {
    const ParameterTable& table = session.bench.protocol->parameters();
    const Params& nominal = session.bench.protocol->nominal();
    std::string text = fmt::format("sets in at {}", with_unit(nominal[table.index("contact_gap")], "m"));
    for (const std::string& region : model.mesh().region_names) {
      text += fmt::format(", {} {}", region,
                          with_unit(nominal[table.index("contact_pressure_" + region)],
                                    e.contact.form == ContactForm::length_weighted ? "Pa" : "N/m"));
    }
    if (e.geometry.kind == "push_puppet")
      text +=
          e.contact.compensate ? "; lips shortened by the distance at which they rest" : "; stand-off not compensated";
    lines.emplace_back("contact", text);
  }
  for (const ChannelSettings& channel : e.channels) {
    std::string text = channel.on.empty() ? "displacement of point (" + list_of(channel.point, "m") + ")"
                                          : "mean displacement of " + channel.on;
    if (!channel.standoff.empty())
      text += fmt::format(", marker {} off it, turning with {}", list_of(channel.standoff, "m"), channel.turns_with);
    lines.emplace_back("channel " + channel.id, text);
  }
  lines.emplace_back("measured from", e.from_unloaded ? "the unloaded equilibrium" : "the rest shape");
  for (const std::string& remark : session.trials.remarks) lines.emplace_back("bench", remark);
  return lines;
}

std::vector<std::string> warnings_before(const Session& session) {
  std::vector<std::string> warnings;
  const Experiment& e = session.experiment;
  for (const MaterialSettings& material : e.materials) {
    const auto nu = material.constants.find("nu");
    const bool locks = e.mesh.formulation == Formulation::standard &&
                       !(e.geometry.dimension == 2 && e.geometry.plane == Plane::stress);
    if (nu != material.constants.end() && nu->second > 0.45 && locks) {
      warnings.push_back(
          fmt::format("{}: nu = {} with {} elements locks: the model is too stiff and a fitted modulus too small; set "
                      "formulation = \"locking_free\" with quadratic elements",
                      material.region, nu->second, e.mesh.order == 1 ? "linear" : "plain quadratic"));
    }
  }
  if (e.mesh.order == 1)
    warnings.emplace_back(
        "linear elements bend too stiffly: a fitted modulus is too small by some per cent; compare with element = "
        "\"quadratic\"");
  return warnings;
}

std::vector<std::string> warnings_after(const StaticProtocol& protocol) {
  std::vector<std::string> warnings;
  for (const StaticProtocol::Condition& condition : protocol.conditions()) {
    if (condition.report.status != SolveStatus::converged) continue;
    const std::string where = protocol.describe(condition);
    if (condition.report.left_saddle)
      warnings.push_back(
          fmt::format("at {} the straight path became unstable (buckling); the equilibrium on the side of "
                      "lower energy was taken",
                      where));
    if (condition.report.slipped) {
      warnings.push_back(
          fmt::format("at {} the path slipped to another equilibrium, {:.3g} % of the way from the state "
                      "before: several exist there, and the specimen may be in another one; leave this row out or hang "
                      "smaller loads",
                      where, 100 * condition.report.slipped_after));
    }
    if (condition.smallest_jacobian <= 0) {
      warnings.push_back(
          fmt::format("at {} an element has folded between its quadrature points (smallest J = {:.2g}): do "
                      "not trust the state near it; refine there or lower the load",
                      where, condition.smallest_jacobian));
    }
  }
  return warnings;
}

std::string describe_control(const Session& session, size_t control, double value) {
  return fmt::format("{} = {}", session.trials.control_ids[control], control_text(session, control, value));
}

std::string describe_controls(const Session& session, const std::vector<double>& controls) {
  if (controls.empty()) return "no load";
  std::string text;
  for (size_t k = 0; k < controls.size(); ++k) text += (k == 0 ? "" : ", ") + describe_control(session, k, controls[k]);
  return text;
}

std::vector<CableState> cable_states(const Session& session) {
  std::vector<CableState> states;
  const StaticProtocol& protocol = *session.bench.protocol;
  for (size_t c = 0; c < session.bench.cables.size(); ++c) {
    const auto tension = make_cable_tension(protocol.scene().model->mesh(), session.bench.cables[c]);
    const auto length = make_cable_length(protocol.scene().model->mesh(), session.bench.cables[c]);
    for (const StaticProtocol::Condition& condition : protocol.conditions()) {
      if (condition.report.status != SolveStatus::converged) continue;
      const Point at{condition.u, condition.p};
      states.push_back({protocol.describe(condition), session.experiment.cables.cables[c].id, tension->value(at),
                        length->value(at)});
    }
  }
  return states;
}

size_t diagnostic_control(const Session& session) {
  const std::vector<std::string>& ids = session.trials.control_ids;
  return static_cast<size_t>(std::find(ids.begin(), ids.end(), session.experiment.diagnostic->per) - ids.begin());
}

int load_control(const Session& session) {
  int best = -1;
  size_t most = 0;
  for (size_t k = 0; k < session.trials.control_ids.size(); ++k) {
    if (session.trials.control_quantities[k] == Quantity::length) continue;
    std::set<double> values;
    for (const Reading& reading : session.trials.readings) values.insert(reading.controls[k]);
    if (values.size() > most) {
      most = values.size();
      best = static_cast<int>(k);
    }
  }
  return best;
}

std::string series_of(const Session& session, const std::vector<double>& controls) {
  std::string text;
  for (size_t k = 0; k < controls.size(); ++k) {
    if (static_cast<int>(k) == load_control(session)) continue;
    std::set<double> values;
    for (const Reading& reading : session.trials.readings) values.insert(reading.controls[k]);
    if (values.size() > 1)
      text += fmt::format("{}{} {}", text.empty() ? "" : ", ", session.trials.control_ids[k],
                          control_text(session, k, controls[k]));
  }
  return text;
}

FitOptions fit_options(const CommandOptions& options, const Experiment& experiment, const ParameterTable& table,
                       const std::vector<FreeParameter>& free, Progress& progress, const std::string& what) {
  FitOptions result;
  result.stop = options.stop;
  result.all_profiles = experiment.all_profiles;
  result.progress = [&progress, &table, &free, what](const FitProgress& state) {
    std::string text = fmt::format("{}: evaluation {}, chi squared {:.5g}", what, state.evaluation, state.chi_squared);
    for (size_t j = 0; j < free.size(); ++j) {
      const ParameterSpec& spec = table[free[j].index];
      text += fmt::format(", {} = {}", spec.id, with_unit(state.values[j], spec.unit));
    }
    progress.show(text);
  };
  return result;
}

VariantRecord as_variant(const std::string& name, const MeshSettings& mesh, const Model& model, const FitResult& fit,
                         double seconds) {
  VariantRecord record;
  record.name = name;
  record.mesh = mesh.describe();
  record.unknowns = model.free_unknowns();
  record.status = name_of(fit.status);
  record.chi_squared = fit.chi_squared;
  record.seconds = seconds;
  if (fit.status != FitStatus::converged) return record;
  for (const ParameterEstimate& e : fit.parameters) {
    record.values.push_back(e.value);
    record.standard_errors.push_back(e.standard_error);
  }
  return record;
}

RunRecord start_record(const Session& session, const CommandOptions& options) {
  RunRecord record;
  record.title = session.experiment.title;
  record.simulated = session.experiment.simulated;
  record.setup = describe_setup(session);
  record.control_ids = session.trials.control_ids;
  const StaticProtocol& protocol = *session.bench.protocol;
  record.parameter_ids = protocol.parameters().ids();
  for (int control : protocol.controls()) record.control_units.push_back(protocol.parameters()[control].unit);
  record.load_control = load_control(session);
  record.trend_degree = session.experiment.trend_degree;
  if (record.load_control >= 0) {
    const size_t k = static_cast<size_t>(record.load_control);
    record.load_label =
        session.trials.control_ids[k] + (session.trials.control_quantities[k] == Quantity::mass ? " × g" : "");
  } else {
    record.load_label = "load";
  }
  for (const Reading& reading : session.trials.readings) {
    ReadingRecord line;
    line.line = reading.line;
    line.trial = reading.trial;
    line.channel = session.trials.channel_ids[static_cast<size_t>(reading.channel)];
    line.controls = reading.controls;
    line.measured = reading.value;
    line.sigma = reading.sigma;
    line.predicted = line.prediction_se = std::nan("");
    record.readings.push_back(line);
    const size_t k = static_cast<size_t>(std::max(0, record.load_control));
    record.load_newtons.push_back(
        record.load_control < 0
            ? 0.0
            : load_in_newtons(session.experiment, session.trials.control_quantities[k], reading.controls[k]));
    record.series.push_back(series_of(session, reading.controls));
  }
  record.remarks = warnings_before(session);
  for (const ReferenceValue& reference : session.experiment.references) {
    const int index = protocol.parameters().index(reference.parameter);
    const double value = parse_quantity(reference.value.text, quantity_of_si_unit(protocol.parameters()[index].unit),
                                        reference.value.where);
    record.references.push_back({reference.parameter, value, reference.source});
  }
  record.provenance.version = version();
  record.provenance.commit = commit();
  record.provenance.libraries = library_versions();
  record.provenance.command_line = options.command_line;
  record.provenance.started = utc_now();
  record.provenance.machine = machine_description();
  return record;
}

std::vector<CurveRecord> make_curves(const Session& session, const Params& p, const std::vector<FreeParameter>& free,
                                     const Eigen::MatrixXd& covariance) {
  const int load = load_control(session);
  if (load < 0) return {};
  const size_t k = static_cast<size_t>(load);
  Trials grid = session.trials;
  grid.readings.clear();
  std::map<std::string, std::vector<double>> held;  // series label to controls
  std::set<double> loads{0.0};
  for (const Reading& reading : session.trials.readings) {
    held.try_emplace(series_of(session, reading.controls), reading.controls);
    loads.insert(reading.controls[k]);
  }
  // At every measured load, where curve and readings are compared, and in even steps between them.
  const double lowest = *loads.begin(), highest = *loads.rbegin(), step = (highest - lowest) / 10;
  if (loads.size() > 20) loads = {lowest, highest};
  const std::set<double> measured = loads;
  for (int i = 1; i < 10; ++i) {
    const double value = lowest + step * i;
    const bool near = std::any_of(measured.begin(), measured.end(),
                                  [&](double load_there) { return std::abs(load_there - value) < 0.4 * step; });
    if (!near) loads.insert(value);
  }
  const size_t points = loads.size();
  std::vector<CurveRecord> curves;
  for (auto& [series, controls] : held) {
    for (size_t channel = 0; channel < grid.channel_ids.size(); ++channel) {
      CurveRecord& curve = curves.emplace_back();
      curve.channel = grid.channel_ids[channel];
      curve.series = series;
      for (double value : loads) {
        Reading reading;
        reading.controls = controls;
        reading.controls[k] = value;
        reading.channel = static_cast<int>(channel);
        reading.sigma = 1;
        curve.load.push_back(load_in_newtons(session.experiment, grid.control_quantities[k], value));
        grid.readings.push_back(reading);
      }
    }
  }
  const StaticBench bench = make_static_bench(session.experiment, session.experiment.mesh, grid);
  std::vector<int> indices;
  for (const FreeParameter& parameter : free) indices.push_back(parameter.index);
  const Prediction prediction = bench.protocol->predict(p, indices);
  const Eigen::VectorXd se = standard_errors(prediction, bench.protocol->parameters(), p, free, covariance);
  // Increments from the start of the curve are known better than the values: errors of the parameters move both.
  Prediction increments = prediction;
  for (size_t reading = 0; reading < grid.readings.size(); ++reading) {
    const int row = bench.row_of_reading[reading], start = bench.row_of_reading[reading - reading % points];
    if (increments.derivatives.size() > 0)
      increments.derivatives.row(row) = prediction.derivatives.row(row) - prediction.derivatives.row(start);
  }
  const Eigen::VectorXd increment_se = standard_errors(increments, bench.protocol->parameters(), p, free, covariance);
  size_t reading = 0;
  for (CurveRecord& curve : curves) {
    for (size_t i = 0; i < points; ++i, ++reading) {
      const int row = bench.row_of_reading[reading];
      curve.value.push_back(prediction.values[row]);
      curve.se.push_back(se[row]);
      if (lowest == 0) curve.increment_se.push_back(increment_se[row]);
    }
  }
  return curves;
}

std::vector<ShapeRecord> make_shapes(const Session& session, const std::string& folder, std::string axes[2]) {
  const Mesh& mesh = session.bench.protocol->scene().model->mesh();
  const Experiment& e = session.experiment;
  const int d = mesh.dimension();
  // The drawing plane: vertical is where gravity or the first load points, horizontal is the longest of the other
  // directions.
  const std::vector<double> down = !e.gravity_direction.empty() ? e.gravity_direction
                                   : !e.loads.empty()           ? e.loads.front().direction
                                                                : std::vector<double>(static_cast<size_t>(d), 0.0);
  Eigen::VectorXd lower = Eigen::VectorXd::Constant(d, 1e300), upper = -lower;
  for (int i = 0; i < mesh.node_count(); ++i) {
    lower = lower.cwiseMin(mesh.node(i));
    upper = upper.cwiseMax(mesh.node(i));
  }
  int vertical = d - 1;
  for (int i = 0; i < d; ++i) {
    if (std::abs(down[static_cast<size_t>(i)]) > std::abs(down[static_cast<size_t>(vertical)])) vertical = i;
  }
  int horizontal = -1;
  for (int i = 0; i < d; ++i) {
    if (i != vertical && (horizontal < 0 || upper[i] - lower[i] > upper[horizontal] - lower[horizontal]))
      horizontal = i;
  }
  if (d == 2) {
    horizontal = 0;
    vertical = 1;
  }
  axes[0] = "xyz"[horizontal];
  axes[1] = "xyz"[vertical];

  // Lines: in 2D the boundary, in 3D the outline of the faces that look at the viewer (an edge between two of them is
  // inside).
  const Tag facets = boundary(mesh);
  std::map<std::array<int, 2>, int> uses;  // line to the number of facets that have it
  for (int f = 0; f < facets.count(); ++f) {
    const int* node = facets.entities.data() + static_cast<size_t>(f) * facets.nodes_per_entity;
    if (d == 3) {
      const Eigen::Vector3d a = mesh.node(node[1]) - mesh.node(node[0]), b = mesh.node(node[2]) - mesh.node(node[0]);
      if (a.cross(b).normalized()[3 - horizontal - vertical] > -0.7) continue;
    }
    for (int c = 0; c < (d == 2 ? 1 : 3); ++c) {
      const int from = node[c], to = node[(c + 1) % d], mid = facets.nodes_per_entity > d ? node[d + c] : -1;
      auto add = [&](int one, int two) { ++uses[{std::min(one, two), std::max(one, two)}]; };
      if (mid < 0) {
        add(from, to);
      } else {
        add(from, mid);
        add(mid, to);
      }
    }
  }

  std::vector<ShapeRecord> shapes;
  std::vector<std::pair<double, std::string>> files;
  std::vector<std::vector<std::vector<int>>> outlines;  // of each region
  for (size_t r = 0; d == 2 && r < mesh.region_names.size(); ++r)
    outlines.push_back(region_loops(mesh, static_cast<int>(r)));
  // To a nanometre: finer digits would only fill the file.
  const auto rounded = [](double metres) { return std::round(1e9 * metres) / 1e9; };
  auto draw = [&](const std::string& label, const Eigen::VectorXd& u) {
    ShapeRecord& shape = shapes.emplace_back();
    shape.label = label;
    for (const auto& [line, count] : uses) {
      if (count > 1) continue;
      const auto [one, two] = line;
      const Eigen::VectorXd a = mesh.node(one) + u.segment(one * d, d), b = mesh.node(two) + u.segment(two * d, d);
      shape.segments.push_back({a[horizontal], a[vertical], b[horizontal], b[vertical]});
    }
    for (size_t r = 0; r < outlines.size(); ++r) {
      ShapeRecord::Area& area = shape.areas.emplace_back();
      area.region = mesh.region_names[r];
      for (const std::vector<int>& loop : outlines[r]) {
        ShapeRecord::Line& line = area.loops.emplace_back();
        for (int node : loop)
          line.push_back({rounded(mesh.X[2 * node] + u[2 * node]), rounded(mesh.X[2 * node + 1] + u[2 * node + 1])});
      }
    }
    for (size_t c = 0; d == 2 && c < session.bench.cables.size(); ++c) {
      ShapeRecord::Line& line = shape.cables.emplace_back();
      for (const CablePoint& point : session.bench.cables[c].points) {
        Eigen::Vector2d at = Eigen::Vector2d::Zero();
        if (point.material.nodes.empty()) at = point.fixed;
        for (size_t i = 0; i < point.material.nodes.size(); ++i)
          at += point.material.weights[i] * (mesh.X + u).segment<2>(2 * point.material.nodes[i]);
        line.push_back({rounded(at[0]), rounded(at[1])});
      }
    }
  };
  draw("rest", Eigen::VectorXd::Zero(mesh.X.size()));
  // What is held first, the load second: states next to each other in the figures and in states.pvd.
  const int load = load_control(session);
  std::vector<const StaticProtocol::Condition*> conditions;
  for (const StaticProtocol::Condition& condition : session.bench.protocol->conditions()) {
    if (condition.report.status == SolveStatus::converged) conditions.push_back(&condition);
  }
  const auto held_then_load = [&](const StaticProtocol::Condition* one, const StaticProtocol::Condition* other) {
    std::vector<double> a = one->controls, b = other->controls;
    if (load >= 0) {
      std::rotate(a.begin() + load, a.begin() + load + 1, a.end());
      std::rotate(b.begin() + load, b.begin() + load + 1, b.end());
    }
    return a < b;
  };
  std::stable_sort(conditions.begin(), conditions.end(), held_then_load);
  for (const StaticProtocol::Condition* solved : conditions) {
    const StaticProtocol::Condition& condition = *solved;
    draw(describe_controls(session, condition.controls), condition.u);
    shapes.back().row = series_of(session, condition.controls);
    if (load >= 0)
      shapes.back().column = session.trials.control_ids[static_cast<size_t>(load)] + " " +
                             control_text(session, static_cast<size_t>(load), condition.controls[load]);
    const std::string file = fmt::format("state_{:03}.vtu", files.size());
    write_file((fs::path(folder) / "states" / file).string(), vtu_text(mesh, condition.u));
    files.emplace_back(static_cast<double>(files.size()), file);
  }
  write_file((fs::path(folder) / "states" / "states.pvd").string(), pvd_text(files));
  return shapes;
}

void copy_inputs(const Session& session, const std::string& folder, RunRecord& record) {
  auto copy = [&](const std::string& from, const char* to) {
    write_file((fs::path(folder) / to).string(), read_file(from));
    record.provenance.inputs.emplace_back(from, sha256_of(from));
  };
  copy(session.experiment.path, experiment_copy);
  copy(session.experiment.bench.path, data_copy);
  if (!session.experiment.geometry.file.empty()) copy(session.experiment.geometry.file, mesh_copy);
  record.experiment_file = experiment_copy;
  record.data_file = data_copy;
}

Experiment experiment_of_run(const RunRecord& record, const std::string& folder) {
  Experiment experiment = read_experiment((fs::path(folder) / record.experiment_file).string());
  experiment.bench.path = (fs::path(folder) / record.data_file).string();
  if (!experiment.geometry.file.empty()) experiment.geometry.file = (fs::path(folder) / mesh_copy).string();
  return experiment;
}

}  // namespace taut
