#include "calib/benches/static_protocol.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <optional>

#include "calib/benches/parallel.hpp"
#include "calib/fit/bytes.hpp"
#include "sim/core/units.hpp"
#include "sim/terms/solid.hpp"

namespace taut {

StaticProtocol::StaticProtocol(Scene scene, std::vector<NamedChannel> channels, std::vector<int> controls,
                               std::vector<int> switched_off_at_rest, std::vector<StaticRow> rows, Options options)
    : scene_(std::move(scene)),
      channels_(std::move(channels)),
      controls_(std::move(controls)),
      off_at_rest_(std::move(switched_off_at_rest)),
      rows_(std::move(rows)),
      options_(options) {
  const int given = scene_.model->parameters().size() - static_cast<int>(scene_.states.size());
  for (int i = 0; i < given; ++i) table_.declare(scene_.model->parameters()[i]);
  nominal_ = scene_.values.head(given);
  if (options_.history) {
    make_histories();
    return;
  }
  for (size_t r = 0; r < rows_.size(); ++r) {
    condition_of_row_.push_back(condition_with(rows_[r].controls, rows_[r].order));
    conditions_[static_cast<size_t>(condition_of_row_.back())].rows.push_back(static_cast<int>(r));
  }
  make_paths();
}

int StaticProtocol::condition_with(std::vector<double> controls, double order) {
  if (!knows_past()) {  // and which way it was reached does not matter
    order = not_a_number;
    if (options_.direction >= 0) controls[static_cast<size_t>(options_.direction)] = 1;
  }
  for (size_t c = 0; c < conditions_.size(); ++c) {
    const double other = conditions_[c].order;
    const bool same = other == order || (std::isnan(other) && std::isnan(order));
    if (same && conditions_[c].controls == controls) return static_cast<int>(c);
  }
  conditions_.emplace_back().controls = std::move(controls);
  conditions_.back().order = order;
  return static_cast<int>(conditions_.size()) - 1;
}

/// The controls with all that is not set first at zero.
std::vector<double> StaticProtocol::before_loads(std::vector<double> controls) const {
  for (size_t k = 0; k < controls.size(); ++k) {
    if (std::find(options_.set_first.begin(), options_.set_first.end(), static_cast<int>(k)) ==
        options_.set_first.end())
      controls[k] = static_cast<int>(k) == options_.direction ? 1 : 0;
  }
  return controls;
}

/// Whether a parameter is a load of the rows: in their unloaded states it is zero, whatever it is in the row.
bool StaticProtocol::held_when_unloaded(int index) const {
  const auto found = std::find(controls_.begin(), controls_.end(), index);
  return found != controls_.end() && std::find(options_.set_first.begin(), options_.set_first.end(),
                                               found - controls_.begin()) == options_.set_first.end();
}

/// Size of a condition's controls: the sum of their absolute values.
double StaticProtocol::load_of(int condition) const {
  double sum = 0;
  const std::vector<double>& controls = conditions_[static_cast<size_t>(condition)].controls;
  for (size_t k = 0; k < controls.size(); ++k) {
    if (static_cast<int>(k) != options_.direction) sum += std::abs(controls[k]);
  }
  return sum;
}

/// Whether each control of a condition is that of another one, or more of it.
bool StaticProtocol::adds_to(int more, int less) const {
  const auto &a = conditions_[static_cast<size_t>(more)].controls, &b = conditions_[static_cast<size_t>(less)].controls;
  for (size_t k = 0; k < a.size(); ++k) {
    if (static_cast<int>(k) == options_.direction) continue;
    if (a[k] * b[k] < 0 || std::abs(a[k]) < std::abs(b[k])) return false;
  }
  return true;
}

void StaticProtocol::make_paths() {
  if (!knows_past()) {
    make_paths_of_loads();
  } else if (rows_.empty() || std::isnan(rows_.front().order)) {
    make_paths_of_directions();
  } else {
    make_measured_path();
  }
  // Large loads take most. With retractions the soft module's large deflections and the closed one's contact do.
  double mean = 0;
  for (const Path& path : paths_) mean += load_of(path.conditions.front()) / static_cast<double>(paths_.size());
  for (Path& path : paths_) {
    const double size = load_of(path.conditions.front());
    path.cost = options_.set_first.empty() ? size : std::abs(size - mean);
  }
}

void StaticProtocol::make_paths_of_loads() {
  const size_t read = conditions_.size();  // conditions that rows read; those of unloaded states come after
  for (size_t c = 0; c < read; ++c) {
    if (!options_.from_unloaded && options_.set_first.empty()) continue;
    const int unloaded = condition_with(before_loads(conditions_[c].controls));
    if (options_.from_unloaded) conditions_[c].unloaded = unloaded;
    if (!options_.set_first.empty() && unloaded != static_cast<int>(c)) conditions_[c].parent = unloaded;
  }
  std::map<int, std::vector<int>> loaded;  // unloaded state to the conditions that start from it
  for (size_t c = 0; c < conditions_.size(); ++c) {
    if (conditions_[c].parent < 0)
      loaded[static_cast<int>(c)];
    else
      loaded[conditions_[c].parent].push_back(static_cast<int>(c));
  }
  // Loads are hung one after the other where each only adds to the last.
  for (auto& [unloaded, list] : loaded) {
    std::stable_sort(list.begin(), list.end(), [&](int a, int b) { return load_of(a) < load_of(b); });
    for (size_t i = 1; i < list.size(); ++i) {
      if (adds_to(list[i], list[i - 1])) conditions_[static_cast<size_t>(list[i])].parent = list[i - 1];
    }
    Path& path = paths_.emplace_back();
    path.conditions.push_back(unloaded);
    path.conditions.insert(path.conditions.end(), list.begin(), list.end());
  }
}

void StaticProtocol::forget() {
  for (Condition& condition : conditions_) condition.solved = false;
}

/// What solve_condition() starts from: the last equilibria with their sensitivities, and the contacts that the Hessians
/// have room for, path by path in the order of their first conditions.
std::string StaticProtocol::state() const {
  Bytes out;
  for (const Condition& c : conditions_)
    out(c.solved, c.p, c.u, c.sensitivities, c.sensitivity_of, c.state_sensitivities);
  std::map<int, const Path*> paths;
  for (const Path& path : paths_) paths[path.conditions.front()] = &path;
  for (const auto& [first, path] : paths)
    out(path->equilibrium ? path->equilibrium->couplings() : std::vector<std::array<int, 2>>());
  return out.bytes();
}

void StaticProtocol::restore(const std::string& state) {
  Bytes in(state);
  for (Condition& c : conditions_) in(c.solved, c.p, c.u, c.sensitivities, c.sensitivity_of, c.state_sensitivities);
  std::map<int, Path*> paths;
  for (Path& path : paths_) paths[path.conditions.front()] = &path;
  for (const auto& [first, path] : paths) {
    std::vector<std::array<int, 2>> couplings;
    in(couplings);
    path->equilibrium = std::make_unique<Equilibrium>(*scene_.model, options_.equilibrium);
    path->equilibrium->expect(couplings);
  }
}

std::string StaticProtocol::describe(const Condition& condition) const {
  std::string text;
  for (size_t k = 0; k < controls_.size(); ++k) {
    const ParameterSpec& spec = parameters()[controls_[k]];
    if (static_cast<int>(k) == options_.direction) {
      text += fmt::format("{}{}", k == 0 ? "" : ", ", unloads(condition) ? "unloading" : "loading");
      continue;
    }
    text += fmt::format("{}{} = {}", k == 0 ? "" : ", ", spec.id, with_unit(condition.controls[k], spec.unit));
  }
  return text;
}

std::string StaticProtocol::describe_parameters(const Params& p) const {
  std::string text;
  for (int i = 0; i < parameters().size(); ++i) {
    if (std::find(controls_.begin(), controls_.end(), i) != controls_.end()) continue;
    text +=
        fmt::format("{}{} = {}", text.empty() ? "" : ", ", parameters()[i].id, with_unit(p[i], parameters()[i].unit));
  }
  return text;
}

/// First-order change of a condition's equilibrium on the way to `to`; a stiffness counts by its reciprocal, in which
/// displacements of a linear solid are linear. Empty where it is no better start than the path is: when it changes the
/// state by more than a fifth, or when a stiffness whose sensitivity is not known has changed by more than half.
Eigen::VectorXd StaticProtocol::predicted_change(const Condition& condition, const Params& to) const {
  Eigen::VectorXd change = Eigen::VectorXd::Zero(condition.u.size());
  for (int i = 0; i < parameters().size(); ++i) {
    const double from = condition.p[i];
    const auto known = std::find(condition.sensitivity_of.begin(), condition.sensitivity_of.end(), i);
    if (known != condition.sensitivity_of.end()) {
      change += (parameters()[i].logarithmic ? from * (1 - from / to[i]) : to[i] - from) *
                condition.sensitivities.col(known - condition.sensitivity_of.begin());
    } else if (parameters()[i].logarithmic && !(from < 1.5 * to[i] && to[i] < 1.5 * from)) {
      return {};
    }
  }
  const bool near = change.cwiseAbs().maxCoeff() <= 0.2 * condition.u.cwiseAbs().maxCoeff();
  return near ? change : Eigen::VectorXd();
}

void StaticProtocol::follow_guide(std::unique_ptr<StaticProtocol> guide,
                                  std::function<Eigen::VectorXd(const Eigen::VectorXd& u)> as_here) {
  guide_ = std::move(guide);
  from_guide_ = std::move(as_here);
}

void StaticProtocol::ask_guide(const Params& p) {
  guided_ = guide_ != nullptr && !std::ranges::all_of(conditions_, &Condition::solved);
  if (!guided_) return;
  Params there = guide_->nominal();
  for (int i = 0; i < guide_->parameters().size(); ++i) {
    const std::string& id = guide_->parameters()[i].id;
    if (parameters().contains(id)) there[i] = p[parameters().index(id)];
  }
  guide_->forget();  // what it finds depends on the parameters alone
  guide_->predict(there, {});
}

/// False where there is no guide, or it does not come there straight.
bool StaticProtocol::start_as_guided(const Condition& condition, const Params& target, Equilibrium& equilibrium) const {
  if (!guided_ || condition.other_u.size() > 0) return false;
  const auto there = std::ranges::find(guide_->conditions_, condition.controls, &Condition::controls);
  if (there == guide_->conditions_.end()) return false;
  const SolveReport& report = there->report;
  if (report.status != SolveStatus::converged || !there->solved || report.slipped || report.left_saddle ||
      !report.side.empty())
    return false;
  if (condition.parent < 0) equilibrium.start_at_rest(target);  // forgets contacts of other paths
  equilibrium.start_at(from_guide_(there->u), target);
  return true;
}

Params StaticProtocol::with_controls(const Params& p, const std::vector<double>& controls) const {
  Params target = scene_.values;
  target.head(p.size()) = p;
  for (size_t k = 0; k < controls_.size(); ++k) target[controls_[k]] = controls[k];
  return target;
}

void StaticProtocol::solve_condition(Condition& condition, const Params& p, const std::vector<int>& free,
                                     Equilibrium& equilibrium) const {
  Params target = with_controls(p, condition.controls);
  if (knows_past()) target = start_of_states(condition, std::move(target));
  SolveReport total;
  double smallest = 0;  // Jacobian at the state found
  bool done = false;
  const Eigen::VectorXd change = condition.solved ? predicted_change(condition, target) : Eigen::VectorXd();
  if (change.size() > 0) equilibrium.start_beyond(condition.u, change, target);
  if (change.size() > 0 || start_as_guided(condition, target, equilibrium)) {
    total = equilibrium.solve(target, polish_);
    // A start that is not on the protocol's path may end in a spurious equilibrium with folded elements.
    if (total.status == SolveStatus::converged) smallest = smallest_jacobian(scene_.model->mesh(), equilibrium.u());
    done = smallest > 0;
  }
  if (!done && total.status != SolveStatus::interrupted) {
    if (condition.other_u.size() > 0) {
      equilibrium.start_at(condition.other_u, condition.other_p);
    } else if (condition.parent < 0) {
      Params rest = target;
      for (int index : controls_) rest[index] = 0;
      for (int index : off_at_rest_) rest[index] = 0;
      for (const StateParameter& state : scene_.states) rest[state.index] = 0;
      equilibrium.start_at_rest(rest);
    } else {
      const Condition& parent = conditions_[static_cast<size_t>(condition.parent)];
      Params from = parent.p;
      for (const StateParameter& state : scene_.states) {
        if (state.past)
          from[state.index] = target[state.index];  // the same equilibrium, at which all that slipped sticks
      }
      const bool there = equilibrium.has_factor() && equilibrium.p() == from && equilibrium.u() == parent.u;
      if (!there) equilibrium.start_at(parent.u, from);
    }
    SolveReport report = equilibrium.solve(target, polish_);
    report.factorisations += total.factorisations;
    report.iterations += total.iterations;
    total = report;
  }
  if (knows_past() && total.status == SolveStatus::converged) {
    settle_states(equilibrium, total);
    target = equilibrium.p();
  }
  condition.report = total;
  if (total.status != SolveStatus::converged) return;  // what was solved before stays as a start for the next try
  condition.p = target;
  condition.u = equilibrium.u();
  condition.smallest_jacobian = done ? smallest : smallest_jacobian(scene_.model->mesh(), condition.u);
  condition.solved = condition.smallest_jacobian > 0;  // a folded state is no start for other parameters
  find_sensitivities(condition, free, equilibrium);
}

/// Solves a condition under what `grip` holds, without what opens, which holds no more.
void StaticProtocol::solve_held(Path& path, Condition& condition, const Params& p, const std::vector<int>& free,
                                Grip& grip) const {
  for (;;) {
    path.held_equilibrium.reset();
    path.held_model = std::make_unique<Model>(*scene_.model, std::make_unique<Grip>(grip));
    path.held_equilibrium = std::make_unique<Equilibrium>(*path.held_model, options_.equilibrium);
    solve_condition(condition, p, free, *path.held_equilibrium);
    if (condition.report.status != SolveStatus::converged) return;
    const int before = grip.count();
    grip.drop_open(condition.u);
    if (grip.count() == before) return;
  }
}

void StaticProtocol::solve_path(Path& path, const Params& p, const std::vector<int>& free) {
  if (options_.history) return solve_history(path, p, free);
  path.cost = 0;
  if (!path.equilibrium) path.equilibrium = std::make_unique<Equilibrium>(*scene_.model, options_.equilibrium);
  path.equilibrium->drop_factor();  // the last prediction's: what follows depends on state() alone
  std::map<int, Grip> grips;        // what sticks at each condition, with Options::sticks
  for (int c : path.conditions) {
    Condition& condition = conditions_[static_cast<size_t>(c)];
    const Condition* parent = condition.parent < 0 ? nullptr : &conditions_[static_cast<size_t>(condition.parent)];
    const auto found = grips.find(condition.parent);
    std::optional<Grip> grip;
    if (found != grips.end()) grip = found->second;
    condition.held = grip && grip->count() > 0;
    if (parent != nullptr && parent->report.status != SolveStatus::converged) {
      condition.report = {};
      condition.report.status = parent->report.status;
      condition.report.not_tried = true;
    } else if (condition.held) {
      solve_held(path, condition, p, free, *grip);
    } else {
      solve_condition(condition, p, free, *path.equilibrium);
    }
    if (options_.sticks != nullptr && condition.report.status == SolveStatus::converged) {
      const Point here{condition.u, condition.p};
      if (!grip) grip.emplace(scene_.model->mesh(), *options_.sticks, here);
      grip->add_touching(scene_.model->mesh(), *options_.sticks, here);
      grips.emplace(c, *std::move(grip));
    }
    // What was chosen on the way to where it starts holds for it too.
    if (parent != nullptr && condition.report.side.empty()) condition.report.side = parent->report.side;
    path.cost += condition.report.factorisations;
  }
}

/// Value and derivatives of a row, where its equilibria were found.
void StaticProtocol::read_row(Eigen::Index r, const Params& p, const std::vector<int>& free,
                              Prediction& prediction) const {
  const StaticRow& row = rows_[static_cast<size_t>(r)];
  const Channel& channel = *channels_[static_cast<size_t>(row.channel)].channel;
  const Condition& condition = conditions_[static_cast<size_t>(condition_of_row_[static_cast<size_t>(r)])];
  const Condition* unloaded = condition.unloaded < 0 ? nullptr : &conditions_[static_cast<size_t>(condition.unloaded)];
  const auto converged = [](const Condition& c) { return c.report.status == SolveStatus::converged; };
  if (!converged(condition) || (unloaded != nullptr && !converged(*unloaded))) return;
  const auto k = static_cast<Eigen::Index>(free.size());
  if (options_.history) {
    const auto i = std::ranges::find(condition.rows, static_cast<int>(r)) - condition.rows.begin();
    prediction.values[r] = condition.read[static_cast<size_t>(i)];
    if (k > 0) prediction.derivatives.row(r) = condition.read_by.row(i);
  } else {
    const Point at{condition.u, condition.p};
    prediction.values[r] = channel.value(at);
    if (k > 0) prediction.derivatives.row(r) = channel.gradient(at).transpose() * condition.sensitivities;
    for (Eigen::Index i = 0; i < k; ++i)
      prediction.derivatives(r, i) += channel.parameter_derivative(at, free[static_cast<size_t>(i)]);
    if (k > 0 && knows_past()) prediction.derivatives.row(r) += by_states(channel, at) * condition.state_sensitivities;
  }
  if (unloaded != nullptr) {
    const Point before{unloaded->u, unloaded->p};
    prediction.values[r] -= channel.value(before);
    const Eigen::VectorXd gradient = channel.gradient(before);
    const Eigen::RowVectorXd by = k > 0 && knows_past()
                                      ? Eigen::RowVectorXd(by_states(channel, before) * unloaded->state_sensitivities)
                                      : Eigen::RowVectorXd::Zero(k);
    for (Eigen::Index i = 0; i < k; ++i) {
      if (held_when_unloaded(free[static_cast<size_t>(i)])) continue;
      prediction.derivatives(r, i) -= gradient.dot(unloaded->sensitivities.col(i)) + by[i] +
                                      channel.parameter_derivative(before, free[static_cast<size_t>(i)]);
    }
  }
  if (row.offset < 0) return;
  prediction.values[r] += p[row.offset];
  for (Eigen::Index i = 0; i < k; ++i) {
    if (free[static_cast<size_t>(i)] == row.offset) prediction.derivatives(r, i) += 1;
  }
}

Prediction StaticProtocol::predict(const Params& p, const std::vector<int>& free) {
  at_ = p;
  find_followed();
  ask_guide(p);
  // The dearest first, so that threads end together. Each path depends on its own past only, so which thread solves
  // it, and when, does not matter.
  std::stable_sort(paths_.begin(), paths_.end(), [](const Path& a, const Path& b) { return a.cost > b.cost; });
  in_parallel(paths_.size(), options_.threads, [&](size_t i) { solve_path(paths_[i], p, free); });
  Prediction prediction;
  for (const Condition& condition : conditions_) {
    factorisations_ += condition.report.factorisations;
    newton_iterations_ += condition.report.iterations;
    if (condition.report.status != SolveStatus::converged) {
      prediction.failures.push_back(fmt::format(
          "no equilibrium at {} (with {}): {}", describe(condition), describe_parameters(p),
          condition.report.not_tried ? "the state that it starts from failed" : condition.report.message()));
    }
  }
  const Eigen::Index count = row_count(), k = static_cast<Eigen::Index>(free.size());
  prediction.values = Eigen::VectorXd::Constant(count, std::numeric_limits<double>::quiet_NaN());
  if (k > 0) prediction.derivatives = Eigen::MatrixXd::Constant(count, k, std::numeric_limits<double>::quiet_NaN());
  for (Eigen::Index r = 0; r < count; ++r) read_row(r, p, free, prediction);
  return prediction;
}

/// Derivatives of a condition's state, one column per pair of neighbours; `leaves_before` are those of what the state
/// before it has left.
StaticProtocol::Slopes StaticProtocol::change_between(const std::vector<Neighbours>& neighbours,
                                                      const Condition& condition, const Eigen::MatrixXd& leaves_before,
                                                      Equilibrium& equilibrium) const {
  equilibrium.start_at(condition.u, condition.p);
  equilibrium.solve(condition.p, Polish::full);  // factorises where it stands
  const Point at{condition.u, condition.p};
  const auto gradient = [&](const StaticProtocol& protocol) {
    Eigen::VectorXd g;
    Assembly out;
    out.gradient = &g;
    protocol.scene_.model->evaluate(at, out);
    return g;
  };
  const auto count = static_cast<Eigen::Index>(neighbours.size());
  Eigen::MatrixXd pull(condition.u.size(), count);
  for (Eigen::Index k = 0; k < count; ++k) {
    const Neighbours& n = neighbours[static_cast<size_t>(k)];
    pull.col(k) = (gradient(*n.less) - gradient(*n.more)) / n.apart;
  }
  Slopes slopes{equilibrium.solve_linear(pull), {}, {}};
  if (!knows_past()) return slopes;
  std::vector<int> states;
  for (const StateParameter& state : scene_.states) states.push_back(state.index);
  slopes.states = equilibrium.sensitivities(states);
  Eigen::MatrixXd inherits = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(states.size()), count);
  for (Eigen::Index s = 0; s < inherits.rows(); ++s) {
    if (scene_.states[static_cast<size_t>(s)].past && leaves_before.size() > 0) inherits.row(s) = leaves_before.row(s);
  }
  return slopes_of(condition, slopes, inherits, [&](size_t s) {
    Eigen::RowVectorXd by(count);
    for (Eigen::Index k = 0; k < count; ++k) {
      const Neighbours& n = neighbours[static_cast<size_t>(k)];
      by[k] = (n.more->scene_.states[s].value->value(at) - n.less->scene_.states[s].value->value(at)) / n.apart;
    }
    return by;
  });
}

Eigen::MatrixXd StaticProtocol::derivatives_between(const std::vector<Neighbours>& neighbours) {
  if (options_.history) {
    Eigen::MatrixXd derivatives(row_count(), static_cast<Eigen::Index>(neighbours.size()));
    for (size_t k = 0; k < neighbours.size(); ++k) {
      const auto& [less, more, apart] = neighbours[k];
      derivatives.col(static_cast<Eigen::Index>(k)) =
          (more->predict(at_, {}).values - less->predict(at_, {}).values) / apart;
    }
    return derivatives;
  }
  std::vector<Slopes> change(conditions_.size());
  in_parallel(paths_.size(), options_.threads, [&](size_t i) {
    if (!paths_[i].equilibrium)
      paths_[i].equilibrium = std::make_unique<Equilibrium>(*scene_.model, options_.equilibrium);
    for (int c : paths_[i].conditions) {
      const auto condition = static_cast<size_t>(c);
      const int parent = conditions_[condition].parent;
      change[condition] = change_between(neighbours, conditions_[condition],
                                         parent < 0 ? Eigen::MatrixXd() : change[static_cast<size_t>(parent)].leaves,
                                         *paths_[i].equilibrium);
    }
  });
  Eigen::MatrixXd derivatives(row_count(), static_cast<Eigen::Index>(neighbours.size()));
  for (Eigen::Index r = 0; r < derivatives.rows(); ++r) {
    const auto channel = static_cast<size_t>(rows_[static_cast<size_t>(r)].channel);
    const auto along = [&](int c, size_t k) {
      const Condition& condition = conditions_[static_cast<size_t>(c)];
      const Slopes& slopes = change[static_cast<size_t>(c)];
      const auto column = static_cast<Eigen::Index>(k);
      const Point at{condition.u, condition.p};
      const auto value = [&](const StaticProtocol& protocol) { return protocol.channels_[channel].channel->value(at); };
      const double by_past =
          knows_past() ? by_states(*channels_[channel].channel, at).dot(slopes.states.col(column)) : 0;
      return channels_[channel].channel->gradient(at).dot(slopes.u.col(column)) + by_past +
             (value(*neighbours[k].more) - value(*neighbours[k].less)) / neighbours[k].apart;
    };
    const int condition = condition_of_row_[static_cast<size_t>(r)];
    const int unloaded = conditions_[static_cast<size_t>(condition)].unloaded;
    for (size_t k = 0; k < neighbours.size(); ++k)
      derivatives(r, static_cast<Eigen::Index>(k)) = along(condition, k) - (unloaded < 0 ? 0 : along(unloaded, k));
  }
  return derivatives;
}

}  // namespace taut
