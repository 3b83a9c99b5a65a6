#include "calib/models/ladder.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <set>
#include <tuple>

#include "calib/models/beam_model.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/stopwatch.hpp"
#include "sim/shapes/geometry.hpp"

namespace taut {
namespace {

constexpr int most_solid_unknowns = 30000, most_coarse_unknowns = 20000;

/// What stands for a row.
template <class Values>
auto& at(Values& values, int row) {
  return values[static_cast<size_t>(row)];
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
  const StaticReplay& full;
  std::vector<int> path;  ///< per row: the condition that its path starts from
  int count() const { return static_cast<int>(path.size()); }

  Rows(const Experiment& e, const Trials& t, const StaticReplay& f) : experiment(e), trials(t), full(f) {
    path.resize(static_cast<size_t>(full.protocol->row_count()));
    const auto& conditions = full.protocol->conditions();
    for (size_t c = 0; c < conditions.size(); ++c) {
      int root = static_cast<int>(c);
      while (conditions[static_cast<size_t>(root)].parent >= 0) root = conditions[static_cast<size_t>(root)].parent;
      for (int row : conditions[c].rows) path[static_cast<size_t>(row)] = root;
    }
  }

  /// The readings of some rows, and the row of each.
  std::pair<Trials, std::vector<int>> of(const std::set<int>& rows) const {
    Trials some = trials;
    some.readings.clear();
    std::vector<int> row_of_reading;
    for (size_t i = 0; i < trials.readings.size(); ++i) {
      if (rows.count(full.row_of_reading[i]) == 0) continue;
      some.readings.push_back(trials.readings[i]);
      row_of_reading.push_back(full.row_of_reading[i]);
    }
    return {some, row_of_reading};
  }
  /// A bench of some rows, with the row of the full model for each of its own.
  template <class Make>
  auto make(const std::set<int>& rows, Make&& make_bench) const {
    const auto [some, row_of_reading] = of(rows);
    auto bench = make_bench(some);
    std::vector<int> to(static_cast<size_t>(bench.protocol->row_count()));
    for (size_t k = 0; k < row_of_reading.size(); ++k) at(to, bench.row_of_reading[k]) = row_of_reading[k];
    return std::pair(std::move(bench), to);
  }
  auto beams(const std::set<int>& rows, const Experiment& with) const {
    return make(rows, [&](const Trials& some) { return make_beam_bench(with, some); });
  }
  auto elements(const std::set<int>& rows, const Experiment& with, const MeshSettings& mesh) const {
    return make(rows, [&](const Trials& some) { return make_static_replay(with, mesh, some); });
  }
};

/// A rung with its values at the file's values, by rows of the full model: NaN where it was not asked.
struct Tried {
  RungTrial trial;
  std::vector<int> rows;  ///< of the full model, per row of its own
  StaticReplay bench;     ///< of finite elements
  Eigen::VectorXd values;

  void predict(Protocol& protocol, int row_count) {
    const Stopwatch watch;
    const int before = protocol.factorisations();
    const Prediction prediction = protocol.predict(protocol.nominal(), {});
    trial.seconds = watch.seconds();
    trial.factorisations = protocol.factorisations() - before;
    trial.rows = static_cast<int>(rows.size());
    values = Eigen::VectorXd::Constant(row_count, not_a_number);
    values(rows) = prediction.values;
  }
};

/// Finite elements for some rows, with the model and mesh as given.
Tried try_elements(const Rows& rows, const std::set<int>& chosen, Experiment experiment, Rung rung,
                   const MeshSettings& mesh) {
  Tried tried;
  tried.trial.rung = rung;
  experiment.model = rung;
  std::tie(tried.bench, tried.rows) = rows.elements(chosen, experiment, mesh);
  tried.trial.unknowns = Reduction(*tried.bench.protocol->scene().model).size();
  tried.predict(*tried.bench.protocol, rows.count());
  return tried;
}

/// Changes of the values of a rung of rigid segments by one Newton step of the full model, by rows of the full model;
/// infinite where its Hessian is not positive definite.
Eigen::VectorXd newton_changes(const Rows& rows, const Tried& rigid, StaticProtocol& full) {
  const StaticProtocol& from = *rigid.bench.protocol;
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
  Eigen::VectorXd changes = Eigen::VectorXd::Constant(rows.count(), not_a_number);
  for (size_t c = 0; c < from.conditions().size(); ++c) {
    const StaticProtocol::Condition& condition = from.conditions()[c];
    for (int row : condition.rows) {
      const int channel = at(from.rows(), row).channel, to = at(rigid.rows, row);
      double change = moved(static_cast<int>(c), channel);
      if (condition.unloaded >= 0) change -= moved(condition.unloaded, channel);
      changes[to] = std::isfinite(change) ? std::abs(change / rigid.values[to]) : infinity;
    }
  }
  return changes;
}

/// Whether anything has come within the contact gap of a bench in a state.
bool touches(const StaticReplay& bench, const Eigen::VectorXd& u) {
  const double gap = bench.protocol->nominal()[bench.protocol->parameters().index("contact_gap")];
  return bench.smallest_distance(u, gap) < gap;
}

/// Whether anything touches in the state of each row.
void mark_closed(const Tried& tried, std::vector<RowChoice>& choices) {
  if (!tried.bench.smallest_distance) return;
  for (const StaticProtocol::Condition& condition : tried.bench.protocol->conditions()) {
    if (condition.u.size() == 0) continue;
    const bool closed = touches(tried.bench, condition.u);
    for (int row : condition.rows) at(choices, at(tried.rows, row)).closed = closed;
  }
}

/// Every row of a path that has one of these rows.
std::set<int> whole_paths(const Rows& rows, const std::set<int>& some) {
  std::set<int> paths, all;
  for (int row : some) paths.insert(at(rows.path, row));
  for (int row = 0; row < rows.count(); ++row) {
    if (paths.count(at(rows.path, row)) > 0) all.insert(row);
  }
  return all;
}

std::string percent(double fraction) {
  return std::isfinite(fraction) ? fmt::format("{:.2g} %", 100 * fraction) : std::string("an unknown amount");
}

/// In the order of Rung.
constexpr std::array<std::pair<Rung, const char*>, 4> rungs_in_words{
    {{Rung::beam, "a chain of beams"},
     {Rung::rigid_segments, "finite elements with rigid segments"},
     {Rung::full, "the full model"},
     {Rung::solid, "the solid"}}};

/// One protocol for each rung that rows have been given to, and for paths with and without contact.
std::vector<LadderProtocol::Part> make_parts(const Rows& rows, const Experiment& experiment,
                                             const std::vector<RowChoice>& choices) {
  std::set<int> touching;
  for (int row = 0; row < rows.count(); ++row) {
    if (at(choices, row).closed) touching.insert(row);
  }
  touching = whole_paths(rows, touching);
  std::map<std::pair<Rung, bool>, std::set<int>> rows_of;
  for (int row = 0; row < rows.count(); ++row) {
    const Rung rung = at(choices, row).rung;
    const bool elements = rung == Rung::rigid_segments || rung == Rung::full;
    rows_of[{rung, elements && experiment.contact.on && touching.count(row) == 0}].insert(row);
  }
  std::vector<LadderProtocol::Part> parts;
  for (const auto& [kind, chosen] : rows_of) {
    const auto [rung, idle] = kind;
    LadderProtocol::Part& part = parts.emplace_back();
    part.rung = rung;
    if (rung == Rung::beam) {
      auto [bench, to] = rows.beams(chosen, experiment);
      part.rows = to;
      part.protocol = std::move(bench.protocol);
      continue;
    }
    Experiment as = experiment;
    as.model = rung;
    const MeshSettings mesh = rung == Rung::solid ? deepened(as, as.mesh) : as.mesh;
    if (idle) part.watch = rows.elements(chosen, as, mesh).first;
    as.contact.idle = idle;
    auto [bench, to] = rows.elements(chosen, as, mesh);
    part.rows = to;
    part.idle = idle ? bench.protocol.get() : nullptr;
    part.protocol = std::move(bench.protocol);
  }
  return parts;
}

/// The values of rows on the rungs chosen for them, of a plane section of the other kind.
Eigen::VectorXd other_plane(const Rows& rows, const std::vector<RowChoice>& choices) {
  Experiment other = rows.experiment;
  other.geometry.plane = other.geometry.plane == Plane::strain ? Plane::stress : Plane::strain;
  Eigen::VectorXd values = Eigen::VectorXd::Constant(rows.count(), not_a_number);
  for (const LadderProtocol::Part& part : make_parts(rows, other, choices))
    values(part.rows) = part.protocol->predict(part.protocol->nominal(), {}).values;
  return values;
}

/// The row of each path with the smallest controls that are not all zero.
std::set<int> lightest(const Rows& rows, const std::set<int>& some) {
  std::map<int, std::pair<double, int>> best;  // path to size and row
  for (int row : some) {
    double size = 0;
    for (double value : at(rows.full.protocol->rows(), row).controls) size += std::abs(value);
    const auto [place, added] = best.try_emplace(at(rows.path, row), size, row);
    if (!added && size < place->second.first) place->second = {size, row};
  }
  std::set<int> found;
  for (const auto& [path, entry] : best) found.insert(entry.second);
  return found;
}

std::string describe(const Ladder& ladder, double tolerance, const std::string& solid_remark) {
  std::string text;
  for (const auto& [rung, words] : rungs_in_words) {
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
    text += fmt::format("{}{} of {} rows from {}", text.empty() ? "" : "; ", count, ladder.rows.size(), words);
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

/// Whether anything has come within the contact gap in a state of a part that does not look for contact.
bool touches(const LadderProtocol::Part& part) {
  return std::ranges::any_of(part.idle->conditions(), [&](const StaticProtocol::Condition& condition) {
    return condition.u.size() > 0 && touches(part.watch, condition.u);
  });
}

/// What a part says, by its own table and indices.
Prediction ask(Protocol& protocol, const ParameterTable& parameters, const Params& p, const std::vector<int>& free,
               std::vector<int>& column) {
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
    column.push_back(static_cast<int>(k));
  }
  return protocol.predict(own, indices);
}

}  // namespace

Prediction LadderProtocol::predict(const Params& p, const std::vector<int>& free) {
  Prediction all;
  const Eigen::Index columns = static_cast<Eigen::Index>(free.size());
  all.values = Eigen::VectorXd::Constant(rows_, not_a_number);
  if (columns > 0) all.derivatives = Eigen::MatrixXd::Zero(rows_, columns);
  for (Part& part : parts_) {
    std::vector<int> column;
    Prediction some = ask(*part.protocol, parameters_, p, free, column);
    if (part.idle != nullptr && (!some.complete() || touches(part))) {
      factorisations_before_ += part.protocol->factorisations();
      part.protocol = std::move(part.watch.protocol);
      part.idle = nullptr;
      if (searching_) part.protocol->begin_search();
      some = ask(*part.protocol, parameters_, p, free, column);
    }
    all.values(part.rows) = some.values;
    if (!column.empty()) all.derivatives(part.rows, column) = some.derivatives;
    all.failures.insert(all.failures.end(), some.failures.begin(), some.failures.end());
  }
  return all;
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
  return static_cast<int>(std::ranges::count_if(parts_, [](const Part& part) { return part.idle != nullptr; }));
}

namespace {

/// The way up: which rows are still to be decided, and what was found on the rungs below.
class Climb {
 public:
  Climb(const Experiment& experiment, const Trials& trials, const StaticReplay& full)
      : experiment_(experiment),
        tolerance_(experiment.tolerance),
        rows_(experiment, trials, full),
        beam_(Eigen::VectorXd::Constant(rows_.count(), not_a_number)),
        values_(beam_) {
    ladder.rows.resize(rows_.path.size());
    for (int row = 0; row < rows_.count(); ++row) all_.insert(row);
    undecided_ = all_;
  }
  Ladder ladder;

  void try_beams() {
    Eigen::VectorXd stated = Eigen::VectorXd::Constant(rows_.count(), infinity);
    try {
      const auto [bench, to] = rows_.beams(all_, experiment_);
      Tried tried;
      tried.trial.rung = Rung::beam;
      tried.trial.unknowns = bench.protocol->unknowns();
      tried.rows = to;
      tried.predict(*bench.protocol, rows_.count());
      beam_ = tried.values;
      for (size_t k = 0; k < to.size(); ++k) stated[to[k]] = bench.protocol->stated_error(static_cast<int>(k));
      ladder.trials.push_back(tried.trial);
    } catch (const InputError& error) {
      cannot(Rung::beam, error.what());
    }
    for (int row : all_) choice(row).change = stated[row];
    take(
        Rung::beam, [&](int row) { return stated[row] <= tolerance_; }, [&](int row) { return stated[row]; });
  }

  /// Rigid segments, and what one Newton step of the full model makes of them.
  void try_rigid_segments() {
    if (undecided_.empty()) return;
    try {
      const Tried tried = try_elements(rows_, undecided_, experiment_, Rung::rigid_segments, experiment_.mesh);
      ladder.trials.push_back(tried.trial);
      mark_closed(tried, ladder.rows);
      const StaticReplay whole = rows_.elements(undecided_, experiment_, experiment_.mesh).first;
      const Eigen::VectorXd changes = newton_changes(rows_, tried, *whole.protocol);
      for (int row : undecided_) choice(row).compliance = changes[row];
      const auto from_beam = [&](int row) { return relative_change(beam_[row], tried.values[row]); };
      const auto compliance = [&](int row) { return choice(row).compliance; };
      take(
          Rung::beam, [&](int row) { return from_beam(row) + compliance(row) <= tolerance_; }, from_beam);
      take(
          Rung::rigid_segments, [&](int row) { return compliance(row) <= 0.5 * tolerance_; }, compliance);
    } catch (const InputError& error) {
      cannot(Rung::rigid_segments, error.what());
    }
  }

  /// The full model, and where there is nothing in between the beams against it.
  void try_full_model() {
    if (undecided_.empty()) return;
    const Tried tried = try_elements(rows_, undecided_, experiment_, Rung::full, experiment_.mesh);
    ladder.trials.push_back(tried.trial);
    mark_closed(tried, ladder.rows);
    const auto from_beam = [&](int row) { return relative_change(beam_[row], tried.values[row]); };
    take(
        Rung::beam, [&](int row) { return from_beam(row) <= tolerance_; }, from_beam);
    take(
        Rung::full, [](int) { return true; }, [](int) { return 0; });
  }

  /// Makes the protocol of the rungs chosen, and replays it.
  void replay() {
    const StaticProtocol& full = *rows_.full.protocol;
    ladder.protocol = std::make_unique<LadderProtocol>(full.parameters(), full.nominal(), rows_.count(),
                                                       make_parts(rows_, experiment_, ladder.rows));
    const Stopwatch watch;
    values_ = ladder.protocol->predict(ladder.protocol->nominal(), {}).values;
    ladder.replay_seconds = watch.seconds();
  }

  /// Between plane stress and plane strain lies the solid: asks whether a plane section will do, and takes the solid
  /// where not. Returns what was found.
  std::string check_planes() {
    if (experiment_.geometry.dimension != 2) return "";
    const Eigen::VectorXd other = other_plane(rows_, ladder.rows);
    std::set<int> doubtful;
    double widest = 0;
    for (int row : all_) {
      const double apart = relative_change(values_[row], other[row]);
      widest = std::max(widest, apart);
      if (choice(row).rung == Rung::full) choice(row).change = apart;  // until a solid is asked
      if (!(apart <= tolerance_)) doubtful.insert(row);
    }
    std::string remark;
    if (!doubtful.empty()) {
      try {
        remark = try_solid(whole_paths(rows_, doubtful));
      } catch (const InputError& error) {
        cannot(Rung::solid, error.what());
        remark = "no solid could be tried";
      }
      if (needs_solid()) replay();
    }
    return fmt::format("plane stress and plane strain differ by at most {}{}{}", percent(widest),
                       remark.empty() ? "" : ", and ", remark);
  }

  int failed_rows() const { return static_cast<int>((!values_.array().isFinite()).count()); }
  bool needs_solid() const { return std::ranges::count(ladder.rows, Rung::solid, &RowChoice::rung) > 0; }

 private:
  RowChoice& choice(int row) { return at(ladder.rows, row); }
  void cannot(Rung rung, const std::string& why) {
    RungTrial& trial = ladder.trials.emplace_back();
    trial.rung = rung;
    trial.cannot = why;
  }
  int unknowns_of(const std::set<int>& rows, const MeshSettings& mesh) const {
    return rows_.elements(rows, experiment_, mesh).first.protocol->scene().model->free_unknowns();
  }
  /// Gives a rung the undecided rows whose whole paths are good, with the change that is told of each.
  template <class Good, class Change>
  void take(Rung rung, Good&& good, Change&& change) {
    std::set<int> bad, accepted = undecided_;
    for (int row : undecided_) {
      if (!good(row)) bad.insert(row);
    }
    for (int row : whole_paths(rows_, bad)) accepted.erase(row);
    for (int row : accepted) {
      choice(row).rung = rung;
      choice(row).change = change(row);
      undecided_.erase(row);
    }
  }

  /// Replays doubtful rows as a solid, and gives it those that it changes by more than the tolerance. Returns what was
  /// found, as the end of a sentence.
  std::string try_solid(const std::set<int>& doubtful) {
    const MeshSettings mesh = deepened(experiment_, experiment_.mesh);
    const int unknowns = unknowns_of(doubtful, mesh);
    return unknowns <= most_solid_unknowns ? take_solid(doubtful, mesh) : ask_coarse_solid(doubtful, unknowns);
  }

  std::string take_solid(const std::set<int>& doubtful, const MeshSettings& mesh) {
    const Tried solid = try_elements(rows_, doubtful, experiment_, Rung::solid, mesh);
    ladder.trials.push_back(solid.trial);
    double largest = 0;
    std::set<int> changed;
    for (int row : doubtful) {
      const double change = relative_change(values_[row], solid.values[row]);
      choice(row).change = change;
      largest = std::max(largest, change);
      if (!(change <= tolerance_)) changed.insert(row);
    }
    for (int row : whole_paths(rows_, changed)) {
      choice(row).rung = Rung::solid;
      choice(row).change = 0;
    }
    return fmt::format(
        "the solid changes rows by up to {}{}", percent(largest),
        changed.empty()
            ? ""
            : fmt::format(
                  ", so that they come from it although the file says plane {}: no plane section is assumed in them",
                  experiment_.geometry.plane == Plane::strain ? "strain" : "stress"));
  }

  /// Where the solid itself has too many `unknowns`: coarse ones tell what it would change.
  std::string ask_coarse_solid(const std::set<int>& doubtful, int unknowns) {
    const MeshSettings coarse = refined(experiment_.mesh, experiment_.geometry, 0.5);
    const MeshSettings coarse_solid = deepened(experiment_, coarse);
    const std::set<int> light = lightest(rows_, doubtful);
    if (unknowns_of(light, coarse_solid) > most_coarse_unknowns)
      return fmt::format("the solid that would decide has {} unknowns and was not tried (model = \"solid\" takes it)",
                         unknowns);
    const Tried plane = try_elements(rows_, light, experiment_, Rung::full, coarse);
    const Tried solid = try_elements(rows_, light, experiment_, Rung::solid, coarse_solid);
    ladder.trials.push_back(solid.trial);
    double largest = 0;
    for (int row : light) {
      const double change = relative_change(plane.values[row], solid.values[row]);
      largest = std::max(largest, change);
      for (int same : doubtful) {
        if (at(rows_.path, same) == at(rows_.path, row)) choice(same).change = change;
      }
    }
    return fmt::format(
        "a coarse solid changes rows by up to {}{}", percent(largest),
        largest <= tolerance_
            ? std::string()
            : fmt::format(", which is left as it is: the solid has {} unknowns (model = \"solid\" takes it)",
                          unknowns));
  }

  const Experiment& experiment_;
  double tolerance_;
  Rows rows_;
  std::set<int> all_, undecided_;
  Eigen::VectorXd beam_;    ///< values from the chain of beams; NaN: none
  Eigen::VectorXd values_;  ///< from the rungs chosen
};

}  // namespace

Ladder climb(const Experiment& experiment, const Trials& trials, const StaticReplay& full) {
  const Stopwatch watch;
  Climb climb(experiment, trials, full);
  climb.try_beams();
  climb.try_rigid_segments();
  climb.try_full_model();
  climb.replay();
  std::string remark = climb.check_planes();
  if (climb.needs_solid() && std::ranges::count(experiment.free, "thickness", &FreeSettings::id) > 0)
    throw InputError(experiment.path +
                     ": [fit.free.thickness]: some rows need the solid, whose thickness is its mesh; fix it, or set "
                     "model = \"full\"");
  if (const int failed = climb.failed_rows(); failed > 0)
    remark += fmt::format("{}{} rows have no equilibrium", remark.empty() ? "" : "; ", failed);
  climb.ladder.seconds = watch.seconds();
  climb.ladder.sentence = describe(climb.ladder, experiment.tolerance, remark);
  return std::move(climb.ladder);
}

}  // namespace taut
