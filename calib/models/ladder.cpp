#include "calib/models/ladder.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <map>
#include <set>

#include "calib/models/beam_model.hpp"
#include "sim/core/error.hpp"
#include "sim/shapes/geometry.hpp"

namespace taut {
namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();
constexpr double infinity = std::numeric_limits<double>::infinity();
constexpr int most_solid_unknowns = 30000, most_coarse_unknowns = 20000;

double seconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

/// Relative change from one value to another; of values that are both zero, none.
double relative_change(double from, double to) {
  if (from == to) return 0;
  return std::abs(to - from) / std::max(std::abs(to), 1e-12);
}

/// The rows of an experiment at rest, and the paths on which they lie.
struct Rows {
  const Experiment& experiment;
  const Trials& trials;
  const StaticBench& full;
  std::vector<int> path;  ///< per row: the condition that its path starts from
  int count() const { return static_cast<int>(path.size()); }

  Rows(const Experiment& e, const Trials& t, const StaticBench& f) : experiment(e), trials(t), full(f) {
    path.resize(static_cast<size_t>(full.protocol->row_count()));
    const auto& conditions = full.protocol->conditions();
    for (size_t c = 0; c < conditions.size(); ++c) {
      int root = static_cast<int>(c);
      while (conditions[static_cast<size_t>(root)].parent >= 0) root = conditions[static_cast<size_t>(root)].parent;
      for (int row : conditions[c].rows) path[static_cast<size_t>(row)] = root;
    }
  }

  /// The readings of some rows.
  Trials of(const std::set<int>& rows) const {
    Trials some = trials;
    some.readings.clear();
    for (size_t i = 0; i < trials.readings.size(); ++i) {
      if (rows.count(full.row_of_reading[i]) > 0) some.readings.push_back(trials.readings[i]);
    }
    return some;
  }
  /// The row of the full model for each row of a bench that was made of `of(rows)`.
  std::vector<int> map(const std::set<int>& rows, const std::vector<int>& row_of_reading, int row_count) const {
    std::vector<int> to(static_cast<size_t>(row_count));
    size_t k = 0;
    for (size_t i = 0; i < trials.readings.size(); ++i) {
      if (rows.count(full.row_of_reading[i]) > 0) to[static_cast<size_t>(row_of_reading[k++])] = full.row_of_reading[i];
    }
    return to;
  }
};

/// A rung with its values at the file's values, by rows of the full model: NaN where it was not asked.
struct Tried {
  RungTrial trial;
  LadderProtocol::Part part;
  StaticBench bench;  ///< of finite elements; its protocol is in `part`
  std::vector<double> values;

  StaticProtocol& elements() const { return static_cast<StaticProtocol&>(*part.protocol); }
};

void predict(Tried& tried, int rows) {
  const auto start = std::chrono::steady_clock::now();
  const int before = tried.part.protocol->factorisations();
  const Prediction prediction = tried.part.protocol->predict(tried.part.protocol->nominal(), {});
  tried.trial.seconds = seconds_since(start);
  tried.trial.factorisations = tried.part.protocol->factorisations() - before;
  tried.trial.rows = static_cast<int>(tried.part.rows.size());
  tried.values.assign(static_cast<size_t>(rows), nan);
  for (size_t k = 0; k < tried.part.rows.size(); ++k)
    tried.values[static_cast<size_t>(tried.part.rows[k])] = prediction.values[static_cast<Eigen::Index>(k)];
}

/// Finite elements for some rows, with the model and mesh as given.
Tried try_elements(const Rows& rows, const std::set<int>& chosen, Experiment experiment, Rung rung,
                   const MeshSettings& mesh) {
  Tried tried;
  tried.trial.rung = tried.part.rung = rung;
  experiment.model = rung;
  tried.bench = make_static_bench(experiment, mesh, rows.of(chosen));
  tried.trial.unknowns = Reduction(*tried.bench.protocol->scene().model).size();
  tried.part.rows = rows.map(chosen, tried.bench.row_of_reading, tried.bench.protocol->row_count());
  tried.part.protocol = std::move(tried.bench.protocol);
  predict(tried, rows.count());
  return tried;
}

/// Changes of the values of a rung of rigid segments by one Newton step of the full model, by rows of the full model;
/// infinite where its Hessian is not positive definite.
std::vector<double> newton_changes(const Rows& rows, const Tried& rigid, StaticProtocol& full) {
  const StaticProtocol& from = rigid.elements();
  const Model& model = *full.scene().model;
  std::vector<Eigen::VectorXd> steps;
  Equilibrium equilibrium(model, rows.experiment.equilibrium);
  for (const StaticProtocol::Condition& condition : from.conditions()) {
    Eigen::VectorXd& step = steps.emplace_back();
    if (!condition.solved) continue;
    equilibrium.start_at(condition.u, condition.p);
    if (!equilibrium.refactorise()) continue;
    Eigen::VectorXd gradient;
    Assembly out;
    out.gradient = &gradient;
    model.evaluate({condition.u, condition.p}, out);
    step = -equilibrium.solve_linear(gradient);
  }
  const auto moved = [&](int condition, int channel) {
    const StaticProtocol::Condition& at = from.conditions()[static_cast<size_t>(condition)];
    const Eigen::VectorXd& step = steps[static_cast<size_t>(condition)];
    if (step.size() == 0) return infinity;
    return full.channels()[static_cast<size_t>(channel)].channel->gradient({at.u, at.p}).dot(step);
  };
  std::vector<double> changes(static_cast<size_t>(rows.count()), nan);
  for (size_t c = 0; c < from.conditions().size(); ++c) {
    const StaticProtocol::Condition& condition = from.conditions()[c];
    for (int row : condition.rows) {
      const int channel = from.rows()[static_cast<size_t>(row)].channel, to = rigid.part.rows[static_cast<size_t>(row)];
      double change = moved(static_cast<int>(c), channel);
      if (condition.unloaded >= 0) change -= moved(condition.unloaded, channel);
      changes[static_cast<size_t>(to)] =
          std::isfinite(change) ? std::abs(change / rigid.values[static_cast<size_t>(to)]) : infinity;
    }
  }
  return changes;
}

/// Whether anything touches in the state of each row.
void mark_closed(const Tried& tried, std::vector<RowChoice>& choices) {
  if (tried.bench.contact == nullptr) return;
  const StaticProtocol& protocol = tried.elements();
  const double gap = protocol.nominal()[protocol.parameters().index("contact_gap")];
  for (const StaticProtocol::Condition& condition : protocol.conditions()) {
    if (condition.u.size() == 0) continue;
    const bool closed = tried.bench.contact->smallest_distance(condition.u, gap) < gap;
    for (int row : condition.rows)
      choices[static_cast<size_t>(tried.part.rows[static_cast<size_t>(row)])].closed = closed;
  }
}

/// Every row of a path that has one of these rows.
std::set<int> whole_paths(const Rows& rows, const std::set<int>& some) {
  std::set<int> paths, all;
  for (int row : some) paths.insert(rows.path[static_cast<size_t>(row)]);
  for (int row = 0; row < rows.count(); ++row) {
    if (paths.count(rows.path[static_cast<size_t>(row)]) > 0) all.insert(row);
  }
  return all;
}

std::string percent(double fraction) {
  return std::isfinite(fraction) ? fmt::format("{:.2g} %", 100 * fraction) : std::string("an unknown amount");
}

std::string words(Rung rung) {
  switch (rung) {
    case Rung::beam:
      return "a chain of beams";
    case Rung::rigid_segments:
      return "finite elements with rigid segments";
    case Rung::full:
      return "the full model";
    default:
      return "the solid";
  }
}

/// One protocol for each rung that rows have been given to, and for paths with and without contact.
std::vector<LadderProtocol::Part> make_parts(const Rows& rows, const Experiment& experiment,
                                             const std::vector<RowChoice>& choices) {
  std::set<int> touching;
  for (int row = 0; row < rows.count(); ++row) {
    if (choices[static_cast<size_t>(row)].closed) touching.insert(row);
  }
  touching = whole_paths(rows, touching);
  std::map<std::pair<Rung, bool>, std::set<int>> rows_of;
  for (int row = 0; row < rows.count(); ++row) {
    const Rung rung = choices[static_cast<size_t>(row)].rung;
    const bool elements = rung == Rung::rigid_segments || rung == Rung::full;
    rows_of[{rung, elements && experiment.contact.on && touching.count(row) == 0}].insert(row);
  }
  std::vector<LadderProtocol::Part> parts;
  for (const auto& [kind, chosen] : rows_of) {
    const auto [rung, idle] = kind;
    LadderProtocol::Part& part = parts.emplace_back();
    part.rung = rung;
    if (rung == Rung::beam) {
      BeamBench bench = make_beam_bench(experiment, rows.of(chosen));
      part.rows = rows.map(chosen, bench.row_of_reading, bench.protocol->row_count());
      part.protocol = std::move(bench.protocol);
      continue;
    }
    Experiment as = experiment;
    as.model = rung;
    const MeshSettings mesh = rung == Rung::solid ? deepened(as, as.mesh) : as.mesh;
    if (idle) part.watch = make_static_bench(as, mesh, rows.of(chosen));
    as.contact.idle = idle;
    StaticBench bench = make_static_bench(as, mesh, rows.of(chosen));
    part.rows = rows.map(chosen, bench.row_of_reading, bench.protocol->row_count());
    part.protocol = std::move(bench.protocol);
  }
  return parts;
}

/// The values of rows on the rungs chosen for them, of a plane section of the other kind.
std::vector<double> other_plane(const Rows& rows, const std::vector<RowChoice>& choices) {
  Experiment other = rows.experiment;
  other.geometry.plane = other.geometry.plane == Plane::strain ? Plane::stress : Plane::strain;
  std::vector<double> values(static_cast<size_t>(rows.count()), nan);
  for (const LadderProtocol::Part& part : make_parts(rows, other, choices)) {
    const Prediction prediction = part.protocol->predict(part.protocol->nominal(), {});
    for (size_t k = 0; k < part.rows.size(); ++k)
      values[static_cast<size_t>(part.rows[k])] = prediction.values[static_cast<Eigen::Index>(k)];
  }
  return values;
}

/// The row of each path with the smallest controls that are not all zero.
std::set<int> lightest(const Rows& rows, const std::set<int>& some) {
  std::map<int, std::pair<double, int>> best;  // path to size and row
  for (int row : some) {
    double size = 0;
    for (double value : rows.full.protocol->rows()[static_cast<size_t>(row)].controls) size += std::abs(value);
    const auto [place, added] = best.try_emplace(rows.path[static_cast<size_t>(row)], size, row);
    if (!added && size < place->second.first) place->second = {size, row};
  }
  std::set<int> found;
  for (const auto& [path, entry] : best) found.insert(entry.second);
  return found;
}

/// Replays doubtful rows as a solid, and gives it those that it changes by more than the tolerance. Returns what was
/// found, as the end of a sentence.
std::string try_solid(const Rows& rows, const std::set<int>& doubtful, const std::vector<double>& values,
                      Ladder& ladder) {
  const Experiment& experiment = rows.experiment;
  const MeshSettings own = deepened(experiment, experiment.mesh);
  const StaticBench whole = make_static_bench(experiment, own, rows.of(doubtful));
  const int unknowns = whole.protocol->scene().model->free_unknowns();
  double largest = 0;
  if (unknowns <= most_solid_unknowns) {
    const Tried solid = try_elements(rows, doubtful, experiment, Rung::solid, own);
    ladder.trials.push_back(solid.trial);
    std::set<int> changed;
    for (int row : doubtful) {
      const double change = relative_change(values[static_cast<size_t>(row)], solid.values[static_cast<size_t>(row)]);
      ladder.rows[static_cast<size_t>(row)].change = change;
      largest = std::max(largest, change);
      if (!(change <= experiment.tolerance)) changed.insert(row);
    }
    for (int row : whole_paths(rows, changed)) {
      ladder.rows[static_cast<size_t>(row)].rung = Rung::solid;
      ladder.rows[static_cast<size_t>(row)].change = nan;
    }
    return fmt::format("the solid changes rows by up to {}", percent(largest));
  }
  const MeshSettings coarse = refined(experiment.mesh, experiment.geometry, 0.5);
  const std::set<int> light = lightest(rows, doubtful);
  const MeshSettings coarse_solid = deepened(experiment, coarse);
  const int coarse_unknowns =
      make_static_bench(experiment, coarse_solid, rows.of(light)).protocol->scene().model->free_unknowns();
  if (coarse_unknowns > most_coarse_unknowns) {
    return fmt::format("the solid that would decide has {} unknowns and was not tried (model = \"solid\" takes it)",
                       unknowns);
  }
  const Tried plane = try_elements(rows, light, experiment, Rung::full, coarse);
  const Tried solid = try_elements(rows, light, experiment, Rung::solid, coarse_solid);
  ladder.trials.push_back(solid.trial);
  for (int row : light) {
    const double change =
        relative_change(plane.values[static_cast<size_t>(row)], solid.values[static_cast<size_t>(row)]);
    largest = std::max(largest, change);
    for (int same : doubtful) {
      if (rows.path[static_cast<size_t>(same)] == rows.path[static_cast<size_t>(row)])
        ladder.rows[static_cast<size_t>(same)].change = change;
    }
  }
  return fmt::format(
      "a coarse solid changes rows by up to {}{}", percent(largest),
      largest <= experiment.tolerance
          ? std::string()
          : fmt::format(", which is left as it is: the solid has {} unknowns (model = \"solid\" takes it)", unknowns));
}

std::string describe(const Ladder& ladder, double tolerance, const std::string& solid_remark) {
  std::string text;
  for (Rung rung : {Rung::beam, Rung::rigid_segments, Rung::full, Rung::solid}) {
    int count = 0, closed = 0;
    double change = 0, compliance = 0;
    for (const RowChoice& row : ladder.rows) {
      if (row.rung != rung) continue;
      ++count;
      closed += row.closed ? 1 : 0;
      change = std::max(change, row.change);
      compliance = std::max(compliance, row.compliance);
    }
    if (count == 0) continue;
    text += fmt::format("{}{} of {} rows from {}", text.empty() ? "" : "; ", count, ladder.rows.size(), words(rung));
    if (rung == Rung::beam)
      text += fmt::format(" (off by at most {})", percent(change));
    else if (rung == Rung::rigid_segments)
      text += fmt::format(" (their own compliance changes them by at most {})", percent(compliance));
    else if (rung == Rung::full && compliance > 0)
      text += fmt::format(" ({}the stiff regions' compliance changes them by up to {})",
                          closed > 0 ? fmt::format("gaps are closed in {}, and ", closed) : "", percent(compliance));
  }
  if (!solid_remark.empty()) text += "; " + solid_remark;
  return fmt::format("model = \"auto\" within {}: {}; {:.2g} s for the choice, {:.2g} s for a replay",
                     percent(tolerance), text, ladder.seconds, ladder.replay_seconds);
}

}  // namespace

std::string_view name_of(Rung rung) {
  switch (rung) {
    case Rung::beam:
      return "beam";
    case Rung::rigid_segments:
      return "rigid_segments";
    case Rung::full:
      return "full";
    case Rung::solid:
      return "solid";
    case Rung::automatic:
      return "auto";
  }
  return "";
}

MeshSettings deepened(const Experiment& experiment, MeshSettings mesh) {
  const GeometrySettings& geometry = experiment.geometry;
  if (geometry.dimension != 2 || (mesh.size <= 0 && mesh.cells.empty())) {
    throw InputError(
        fmt::format("{}: model: a solid is swept from a plane section whose mesh has a size or cells, and a {} "
                    "in {}D is none; use \"full\"",
                    experiment.path, geometry.kind, geometry.dimension));
  }
  const double along = mesh.size > 0 ? mesh.size : geometry.size[0] / mesh.cells[0];
  mesh.depth_cells = std::clamp(static_cast<int>(std::ceil(0.5 * geometry.thickness / along)), 2, 8);
  return mesh;
}

LadderProtocol::LadderProtocol(ParameterTable parameters, Params nominal, int rows, std::vector<Part> parts)
    : parameters_(std::move(parameters)), nominal_(std::move(nominal)), rows_(rows), parts_(std::move(parts)) {}

namespace {

/// Whether anything has come within the contact gap in a state of a part that does not look for contact.
bool touches(const LadderProtocol::Part& part) {
  const StaticProtocol& with = *part.watch.protocol;
  const double gap = with.nominal()[with.parameters().index("contact_gap")];
  for (const StaticProtocol::Condition& condition : static_cast<StaticProtocol&>(*part.protocol).conditions()) {
    if (condition.u.size() > 0 && part.watch.contact->smallest_distance(condition.u, gap) < gap) return true;
  }
  return false;
}

/// What a part says, by its own table and indices.
Prediction ask(Protocol& protocol, const ParameterTable& parameters, const Params& p, const std::vector<int>& free,
               std::vector<Eigen::Index>& column) {
  const ParameterTable& table = protocol.parameters();
  Params own = protocol.nominal();
  for (int i = 0; i < table.size(); ++i) {
    if (parameters.contains(table[i].id)) own[i] = p[parameters.index(table[i].id)];
  }
  std::vector<int> indices;
  column.clear();
  for (size_t k = 0; k < free.size(); ++k) {
    const std::string& id = parameters[free[k]].id;
    if (!table.contains(id)) continue;
    indices.push_back(table.index(id));
    column.push_back(static_cast<Eigen::Index>(k));
  }
  return protocol.predict(own, indices);
}

}  // namespace

Prediction LadderProtocol::predict(const Params& p, const std::vector<int>& free) {
  Prediction all;
  const Eigen::Index columns = static_cast<Eigen::Index>(free.size());
  all.values = Eigen::VectorXd::Constant(rows_, nan);
  if (columns > 0) all.derivatives = Eigen::MatrixXd::Zero(rows_, columns);
  for (Part& part : parts_) {
    std::vector<Eigen::Index> column;
    Prediction some = ask(*part.protocol, parameters_, p, free, column);
    if (part.watch.protocol != nullptr && (!some.complete() || touches(part))) {
      factorisations_before_ += part.protocol->factorisations();
      part.protocol = std::move(part.watch.protocol);
      if (searching_) part.protocol->begin_search();
      some = ask(*part.protocol, parameters_, p, free, column);
    }
    for (size_t r = 0; r < part.rows.size(); ++r) {
      all.values[part.rows[r]] = some.values[static_cast<Eigen::Index>(r)];
      for (size_t k = 0; k < column.size(); ++k)
        all.derivatives(part.rows[r], column[k]) =
            some.derivatives(static_cast<Eigen::Index>(r), static_cast<Eigen::Index>(k));
    }
    all.failures.insert(all.failures.end(), some.failures.begin(), some.failures.end());
  }
  return all;
}

void LadderProtocol::forget() {
  for (Part& part : parts_) part.protocol->forget();
}

void LadderProtocol::begin_search() {
  searching_ = true;
  for (Part& part : parts_) part.protocol->begin_search();
}

void LadderProtocol::end_search() {
  searching_ = false;
  for (Part& part : parts_) part.protocol->end_search();
}

int LadderProtocol::factorisations() const {
  int sum = factorisations_before_;
  for (const Part& part : parts_) sum += part.protocol->factorisations();
  return sum;
}

int LadderProtocol::idle_parts() const {
  return static_cast<int>(
      std::count_if(parts_.begin(), parts_.end(), [](const Part& part) { return part.watch.protocol != nullptr; }));
}

Ladder climb(const Experiment& experiment, const Trials& trials, const StaticBench& full) {
  const auto start = std::chrono::steady_clock::now();
  const double tolerance = experiment.tolerance;
  const Rows rows(experiment, trials, full);
  Ladder ladder;
  ladder.rows.resize(static_cast<size_t>(rows.count()));
  const auto choice = [&](int row) -> RowChoice& { return ladder.rows[static_cast<size_t>(row)]; };
  std::set<int> all, undecided;
  for (int row = 0; row < rows.count(); ++row) all.insert(row);
  undecided = all;
  const auto cannot = [&](Rung rung, const std::string& why) {
    RungTrial& trial = ladder.trials.emplace_back();
    trial.rung = rung;
    trial.cannot = why;
  };
  const auto take = [&](Rung rung, const std::set<int>& accepted) {
    for (int row : accepted) {
      choice(row).rung = rung;
      undecided.erase(row);
    }
  };
  /// The rows whose whole paths are `good`.
  const auto paths_where = [&](auto&& good) {
    std::set<int> bad;
    for (int row : undecided) {
      if (!good(row)) bad.insert(row);
    }
    std::set<int> accepted = undecided;
    for (int row : whole_paths(rows, bad)) accepted.erase(row);
    return accepted;
  };

  // The chain of beams, and what it says of its own error.
  std::vector<double> beam(static_cast<size_t>(rows.count()), nan), stated(beam.size(), infinity);
  try {
    BeamBench bench = make_beam_bench(experiment, trials);
    Tried tried;
    tried.trial.rung = tried.part.rung = Rung::beam;
    tried.trial.unknowns = bench.protocol->unknowns();
    tried.part.rows = rows.map(all, bench.row_of_reading, bench.protocol->row_count());
    const BeamProtocol& protocol = *bench.protocol;
    tried.part.protocol = std::move(bench.protocol);
    predict(tried, rows.count());
    beam = tried.values;
    for (size_t k = 0; k < tried.part.rows.size(); ++k)
      stated[static_cast<size_t>(tried.part.rows[k])] = protocol.stated_error(static_cast<int>(k));
    ladder.trials.push_back(tried.trial);
  } catch (const InputError& error) {
    cannot(Rung::beam, error.what());
  }
  const auto good_beam = [&](int row) { return stated[static_cast<size_t>(row)] <= tolerance; };
  for (int row : all) choice(row).change = stated[static_cast<size_t>(row)];
  take(Rung::beam, paths_where(good_beam));

  // Rigid segments, and what one Newton step of the full model makes of them.
  std::vector<double> rigid(beam.size(), nan);
  if (!undecided.empty()) {
    try {
      const Tried tried = try_elements(rows, undecided, experiment, Rung::rigid_segments, experiment.mesh);
      ladder.trials.push_back(tried.trial);
      rigid = tried.values;
      mark_closed(tried, ladder.rows);
      const StaticBench whole = make_static_bench(experiment, experiment.mesh, rows.of(undecided));
      const std::vector<double> changes = newton_changes(rows, tried, *whole.protocol);
      for (int row : undecided) choice(row).compliance = changes[static_cast<size_t>(row)];
      const auto beam_too = [&](int row) {
        const double change =
            relative_change(beam[static_cast<size_t>(row)], rigid[static_cast<size_t>(row)]) + choice(row).compliance;
        return change <= tolerance;
      };
      const std::set<int> by_comparison = paths_where(beam_too);
      for (int row : by_comparison)
        choice(row).change = relative_change(beam[static_cast<size_t>(row)], rigid[static_cast<size_t>(row)]);
      take(Rung::beam, by_comparison);
      const std::set<int> accepted = paths_where([&](int row) { return choice(row).compliance <= 0.5 * tolerance; });
      for (int row : accepted) choice(row).change = choice(row).compliance;
      take(Rung::rigid_segments, accepted);
    } catch (const InputError& error) {
      cannot(Rung::rigid_segments, error.what());
    }
  }

  // The full model, and where there is nothing in between the beams against it.
  if (!undecided.empty()) {
    const Tried tried = try_elements(rows, undecided, experiment, Rung::full, experiment.mesh);
    ladder.trials.push_back(tried.trial);
    mark_closed(tried, ladder.rows);
    const auto changed = [&](int row) {
      return relative_change(beam[static_cast<size_t>(row)], tried.values[static_cast<size_t>(row)]);
    };
    const std::set<int> accepted = paths_where([&](int row) { return changed(row) <= tolerance; });
    for (int row : accepted) choice(row).change = changed(row);
    take(Rung::beam, accepted);
    for (int row : undecided) choice(row).change = nan;
    take(Rung::full, std::set<int>(undecided));
  }

  // A plane section: between plane stress and plane strain lies the solid.
  std::vector<double> values(beam.size(), nan);
  ladder.protocol = std::make_unique<LadderProtocol>(full.protocol->parameters(), full.protocol->nominal(),
                                                     rows.count(), make_parts(rows, experiment, ladder.rows));
  const auto replay = [&] {
    const auto since = std::chrono::steady_clock::now();
    const Prediction prediction = ladder.protocol->predict(ladder.protocol->nominal(), {});
    ladder.replay_seconds = seconds_since(since);
    std::copy(prediction.values.begin(), prediction.values.end(), values.begin());
  };
  replay();
  std::string solid_remark;
  double widest = 0;
  if (experiment.geometry.dimension == 2) {
    const std::vector<double> other = other_plane(rows, ladder.rows);
    std::set<int> doubtful;
    for (int row : all) {
      const double apart = relative_change(values[static_cast<size_t>(row)], other[static_cast<size_t>(row)]);
      widest = std::max(widest, apart);
      if (!(apart <= tolerance)) doubtful.insert(row);
    }
    if (!doubtful.empty()) {
      doubtful = whole_paths(rows, doubtful);
      try {
        solid_remark = try_solid(rows, doubtful, values, ladder);
      } catch (const InputError& error) {
        cannot(Rung::solid, error.what());
        solid_remark = "no solid could be tried";
      }
      if (std::any_of(ladder.rows.begin(), ladder.rows.end(),
                      [](const RowChoice& row) { return row.rung == Rung::solid; })) {
        ladder.protocol = std::make_unique<LadderProtocol>(full.protocol->parameters(), full.protocol->nominal(),
                                                           rows.count(), make_parts(rows, experiment, ladder.rows));
        replay();
      }
    }
    solid_remark = fmt::format("plane stress and plane strain differ by at most {}{}{}", percent(widest),
                               solid_remark.empty() ? "" : ", and ", solid_remark);
  }
  const bool solid =
      std::any_of(ladder.rows.begin(), ladder.rows.end(), [](const RowChoice& row) { return row.rung == Rung::solid; });
  for (const FreeSettings& free : experiment.free) {
    if (solid && free.id == "thickness")
      throw InputError(
          fmt::format("{}: [fit.free.thickness]: some rows need the solid, whose thickness is its mesh; fix it, "
                      "or set model = \"full\"",
                      experiment.path));
  }
  const auto failed = std::count_if(values.begin(), values.end(), [](double value) { return !std::isfinite(value); });
  if (failed > 0)
    solid_remark += fmt::format("{}{} rows have no equilibrium", solid_remark.empty() ? "" : "; ", failed);
  ladder.seconds = seconds_since(start);
  ladder.sentence = describe(ladder, tolerance, solid_remark);
  return ladder;
}

}  // namespace taut
