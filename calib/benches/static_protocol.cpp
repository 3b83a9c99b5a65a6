#include "calib/benches/static_protocol.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <map>
#include <numeric>
#include <optional>
#include <stdexcept>

#include "calib/benches/parallel.hpp"
#include "calib/fit/bytes.hpp"
#include "sim/core/dense.hpp"
#include "sim/core/numbers.hpp"
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

bool StaticProtocol::unloads(const Condition& condition) const {
  return options_.direction >= 0 && condition.controls[static_cast<size_t>(options_.direction)] == 2;
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

/// Whether all that rows set is set first, and so is what loads.
bool StaticProtocol::all_set_first() const {
  return options_.set_first.size() + (options_.direction >= 0 ? 1 : 0) == controls_.size();
}

/// Where a state comes from that knows its past: what is set first is, and nothing else.
int StaticProtocol::root_of(int condition) {
  std::vector<double> controls = before_loads(conditions_[static_cast<size_t>(condition)].controls);
  if (all_set_first()) {
    for (const int k : options_.set_first) controls[static_cast<size_t>(k)] = 0;
  }
  return condition_with(std::move(controls));
}

/// From each root the rows that load, from small to large, then those that unload, from large to small: each from the
/// last one that it adds to, or takes from.
void StaticProtocol::make_paths_of_directions() {
  struct Ways {
    std::vector<int> up, down;
  };
  std::map<int, Ways> from;
  for (int c = 0, read = static_cast<int>(conditions_.size()); c < read; ++c) {
    const int root = root_of(c);
    Ways& ways = from[root];
    if (options_.from_unloaded) conditions_[static_cast<size_t>(c)].unloaded = root;
    if (unloads(conditions_[static_cast<size_t>(c)]))
      ways.down.push_back(c);
    else if (c != root)
      ways.up.push_back(c);
  }
  for (auto& [root, ways] : from) {
    std::ranges::stable_sort(ways.down, std::greater<>(), [&](int c) { return load_of(c); });
    for (const int c : ways.down) {  // what is unloaded was loaded before
      const auto turns = [&](int other) { return adds_to(other, c); };
      if (std::ranges::any_of(ways.up, turns)) continue;
      std::vector<double> controls = conditions_[static_cast<size_t>(c)].controls;
      controls[static_cast<size_t>(options_.direction)] = 1;
      if (const int top = condition_with(controls); top != root) ways.up.push_back(top);
    }
    std::ranges::stable_sort(ways.up, {}, [&](int c) { return load_of(c); });
    Path& path = paths_.emplace_back();
    path.conditions.push_back(root);
    path.conditions.insert(path.conditions.end(), ways.up.begin(), ways.up.end());
    path.conditions.insert(path.conditions.end(), ways.down.begin(), ways.down.end());
    for (size_t i = 1; i < path.conditions.size(); ++i) {
      const int c = path.conditions[i];
      const bool down = unloads(conditions_[static_cast<size_t>(c)]);
      size_t before = i - 1;
      while (before > 0 && !(down ? adds_to(path.conditions[before], c) : adds_to(c, path.conditions[before])))
        --before;
      conditions_[static_cast<size_t>(c)].parent = path.conditions[before];
    }
  }
}

/// One path through all rows as they were measured.
void StaticProtocol::make_measured_path() {
  std::vector<int> rows(conditions_.size());
  for (size_t c = 0; c < rows.size(); ++c) rows[c] = static_cast<int>(c);
  std::ranges::stable_sort(rows, {}, [&](int c) { return conditions_[static_cast<size_t>(c)].order; });
  Path& path = paths_.emplace_back();
  int unloaded = -1;
  const auto go_to = [&](int c) {
    if (!path.conditions.empty()) conditions_[static_cast<size_t>(c)].parent = path.conditions.back();
    path.conditions.push_back(c);
  };
  const auto unload = [&](const std::vector<double>& controls, double order) {
    conditions_.emplace_back().controls = before_loads(controls);
    conditions_.back().order = order;
    go_to(unloaded = static_cast<int>(conditions_.size()) - 1);
  };
  for (const int c : rows) {
    const std::vector<double> controls = conditions_[static_cast<size_t>(c)].controls;
    const double order = conditions_[static_cast<size_t>(c)].order;
    const std::vector<double> now = path.conditions.empty()
                                        ? std::vector<double>()
                                        : conditions_[static_cast<size_t>(path.conditions.back())].controls;
    if (!all_set_first() && (now.empty() || before_loads(now) != before_loads(controls))) {
      if (!now.empty()) unload(now, order);
      unload(controls, order);
    }
    go_to(c);
    if (options_.from_unloaded) conditions_[static_cast<size_t>(c)].unloaded = unloaded;
  }
}

/// A condition at the end of a path.
int StaticProtocol::append(Path& path, std::vector<double> controls, int parent, double seconds) {
  const int index = static_cast<int>(conditions_.size());
  Condition& condition = conditions_.emplace_back();
  condition.controls = std::move(controls);
  condition.parent = parent;
  condition.seconds = seconds;
  path.conditions.push_back(index);
  return index;
}

void StaticProtocol::make_histories() {
  std::vector<size_t> order(rows_.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::ranges::stable_sort(order, {}, [&](size_t r) { return rows_[r].turn.place; });
  condition_of_row_.resize(rows_.size());
  int last = -1, unloaded = -1;  // conditions
  int place = -1;                // in the history, of the last row
  for (size_t r : order) {
    const StaticRow& row = rows_[r];
    const Turn& turn = row.turn;
    if (turn.place < 0 || turn.place != place) {
      if (place < 0) {
        paths_.emplace_back();
        last = unloaded = -1;
      }
      const std::vector<double> zero = before_loads(row.controls);
      const bool needed = options_.from_unloaded || !options_.set_first.empty();
      const bool moved = last >= 0 && before_loads(conditions_[static_cast<size_t>(last)].controls) != zero;
      if (last < 0 ? needed : turn.rest > 0 || (needed && moved))
        last = unloaded = append(paths_.back(), zero, last, last < 0 ? 0 : turn.rest);
      last = append(paths_.back(), row.controls, last, turn.dwell - turn.read);
      if (options_.from_unloaded) conditions_[static_cast<size_t>(last)].unloaded = unloaded;
    }
    condition_of_row_[r] = last;
    conditions_[static_cast<size_t>(last)].rows.push_back(static_cast<int>(r));
    place = turn.place;
  }
  for (Path& path : paths_) path.cost = static_cast<double>(path.conditions.size());
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

Params StaticProtocol::with_controls(const Params& p, const std::vector<double>& controls) const {
  Params target = scene_.values;
  target.head(p.size()) = p;
  for (size_t k = 0; k < controls_.size(); ++k) target[controls_[k]] = controls[k];
  return target;
}

/// Positions among Scene::states of those that follow from the state itself.
std::vector<int> StaticProtocol::own_states() const {
  std::vector<int> own;
  for (size_t s = 0; s < scene_.states.size(); ++s) {
    if (!scene_.states[s].past) own.push_back(static_cast<int>(s));
  }
  return own;
}

/// `target` with what the state before has left, and with a first guess of what follows from the state itself.
Params StaticProtocol::start_of_states(const Condition& condition, Params target) const {
  const Condition* parent = condition.parent < 0 ? nullptr : &conditions_[static_cast<size_t>(condition.parent)];
  for (size_t s = 0; s < scene_.states.size(); ++s) {
    const StateParameter& state = scene_.states[s];
    double& value = target[state.index];
    if (state.past) {
      value = parent != nullptr ? parent->leaves[static_cast<Eigen::Index>(s)] : 0;
    } else if (condition.solved) {
      value = condition.p[state.index];
      for (size_t k = 0; k < condition.sensitivity_of.size(); ++k) {
        const int index = condition.sensitivity_of[k];
        value += condition.state_sensitivities(static_cast<Eigen::Index>(s), static_cast<Eigen::Index>(k)) *
                 (target[index] - condition.p[index]);
      }
      value = std::max(0.0, value);
    } else {
      value = parent != nullptr ? parent->p[state.index] : 0;
    }
  }
  return target;
}

/// Takes an equilibrium to the one whose parameters that follow from the state itself do: Newton's method for
/// b = g(u(b), b), and b = g where that does not come nearer. The equilibria are those of frozen b.
void StaticProtocol::settle_states(Equilibrium& equilibrium, SolveReport& report) const {
  constexpr int most = 40;
  constexpr double smallest = 1e-10;  // below it a tension is none [N]
  const std::vector<int> own = own_states();
  const auto count = static_cast<Eigen::Index>(own.size());
  std::vector<int> indices;
  for (const int s : own) indices.push_back(scene_.states[static_cast<size_t>(s)].index);
  double last = infinity;
  for (int iteration = 0; iteration < most; ++iteration) {
    const Point at{equilibrium.u(), equilibrium.p()};
    Eigen::VectorXd is(count), miss(count);
    for (Eigen::Index i = 0; i < count; ++i) {
      is[i] = scene_.states[static_cast<size_t>(own[static_cast<size_t>(i)])].value->value(at);
      miss[i] = is[i] - at.p[indices[static_cast<size_t>(i)]];
    }
    const double size = miss.cwiseAbs().maxCoeff();
    if (size <= (polish_ == Polish::full ? 1e-10 : 1e-7) * is.maxCoeff() + smallest) return;
    Eigen::VectorXd change = miss;
    if (size < 0.5 * last && equilibrium.has_factor()) {
      const Eigen::MatrixXd du = equilibrium.sensitivities(indices);
      Eigen::MatrixXd J = Eigen::MatrixXd::Identity(count, count);
      for (Eigen::Index i = 0; i < count; ++i) {
        const Channel& value = *scene_.states[static_cast<size_t>(own[static_cast<size_t>(i)])].value;
        J.row(i) -= value.gradient(at).transpose() * du;
        for (Eigen::Index j = 0; j < count; ++j)
          J(i, j) -= value.parameter_derivative(at, indices[static_cast<size_t>(j)]);
      }
      change = least_squares(J, miss);
    }
    last = size;
    Params next = at.p;
    for (Eigen::Index i = 0; i < count; ++i) {
      double& value = next[indices[static_cast<size_t>(i)]];
      value = std::max(0.0, value + change[i]);
    }
    SolveReport more = equilibrium.solve(next, polish_);
    more.factorisations += report.factorisations;
    more.iterations += report.iterations;
    more.left_saddle |= report.left_saddle;
    if (more.side.empty()) more.side = report.side;
    if (report.slipped && !more.slipped) {
      more.slipped = true;
      more.slipped_after = report.slipped_after;
    }
    report = more;
    if (report.status != SolveStatus::converged) return;
  }
  report.status = SolveStatus::iteration_limit;
}

/// Derivatives of a state. `held` are those of u with all that follows from states held: by the numbers in question,
/// and by the parameters that follow from states; `inherited` those of what the state before has left, `partial` those
/// of what a parameter that follows from a state is, at fixed u and p.
StaticProtocol::Slopes StaticProtocol::slopes_of(const Condition& condition, const Slopes& held,
                                                 const Eigen::MatrixXd& inherited,
                                                 const std::function<Eigen::RowVectorXd(size_t state)>& partial) const {
  const auto count = static_cast<Eigen::Index>(scene_.states.size());
  const Point at{condition.u, condition.p};
  Eigen::MatrixXd by_u(count, held.u.rows()), by_states_(count, count), direct(count, held.u.cols());
  for (Eigen::Index s = 0; s < count; ++s) {
    const Channel& value = *scene_.states[static_cast<size_t>(s)].value;
    by_u.row(s) = value.gradient(at).transpose();
    by_states_.row(s) = by_states(value, at);
    direct.row(s) = partial(static_cast<size_t>(s));
  }
  // All of them at once: those of the past are what they are.
  Eigen::MatrixXd J = Eigen::MatrixXd::Identity(count, count), rhs = inherited;
  const Eigen::MatrixXd all_by_states = by_u * held.states + by_states_, all_direct = by_u * held.u + direct;
  for (const int s : own_states()) {
    J.row(s) -= all_by_states.row(s);
    rhs.row(s) = all_direct.row(s);
  }
  Slopes slopes;
  slopes.states.resize(count, rhs.cols());
  for (Eigen::Index k = 0; k < rhs.cols(); ++k) slopes.states.col(k) = least_squares(J, rhs.col(k));
  slopes.u = held.u + held.states * slopes.states;
  slopes.leaves = all_direct + all_by_states * slopes.states;
  return slopes;
}

/// What a state inherits from the one before, `leaves` of that by the parameters `of`. A control that differs between
/// them is another number there.
Eigen::MatrixXd StaticProtocol::inherited(const Condition& condition, const Eigen::MatrixXd& leaves,
                                          const std::vector<int>& of) const {
  Eigen::MatrixXd all =
      Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(scene_.states.size()), static_cast<Eigen::Index>(of.size()));
  if (condition.parent < 0) return all;
  const Condition& parent = conditions_[static_cast<size_t>(condition.parent)];
  for (Eigen::Index k = 0; k < all.cols(); ++k) {
    const int index = of[static_cast<size_t>(k)];
    if (held_when_unloaded(index) || parent.p[index] != condition.p[index]) continue;
    for (Eigen::Index s = 0; s < all.rows(); ++s) {
      if (scene_.states[static_cast<size_t>(s)].past) all(s, k) = leaves(s, k);
    }
  }
  return all;
}

/// Derivatives of a channel by the parameters that follow from states, at fixed u.
Eigen::RowVectorXd StaticProtocol::by_states(const Channel& channel, const Point& at) const {
  Eigen::RowVectorXd all(static_cast<Eigen::Index>(scene_.states.size()));
  for (Eigen::Index s = 0; s < all.size(); ++s)
    all[s] = channel.parameter_derivative(at, scene_.states[static_cast<size_t>(s)].index);
  return all;
}

/// After a solve: the condition's derivatives by `free`, and what it leaves for the next one.
void StaticProtocol::find_sensitivities(Condition& condition, const std::vector<int>& free,
                                        Equilibrium& equilibrium) const {
  condition.sensitivity_of = free;
  if (!knows_past()) {
    condition.sensitivities = free.empty() ? Eigen::MatrixXd() : equilibrium.sensitivities(free);
    return;
  }
  const Point at{condition.u, condition.p};
  const auto count = static_cast<Eigen::Index>(scene_.states.size()), k = static_cast<Eigen::Index>(free.size());
  condition.leaves.resize(count);
  for (Eigen::Index s = 0; s < count; ++s) condition.leaves[s] = scene_.states[static_cast<size_t>(s)].value->value(at);
  condition.sensitivities.resize(0, 0);
  condition.state_sensitivities.resize(0, 0);
  condition.leaves_sensitivities.resize(0, 0);
  if (free.empty()) return;
  // At its limit an eyelet may stick or slip, by rounding: the factor has to be of what the derivatives here are of.
  equilibrium.start_at(condition.u, condition.p);
  if (!equilibrium.refactorise()) throw std::logic_error("a minimum that was found has no factor");
  ++condition.report.factorisations;
  std::vector<int> all = free;
  for (const StateParameter& state : scene_.states) all.push_back(state.index);
  const Eigen::MatrixXd du = equilibrium.sensitivities(all);
  const auto partial = [&](size_t s) {
    Eigen::RowVectorXd by(k);
    for (Eigen::Index i = 0; i < k; ++i)
      by[i] = scene_.states[s].value->parameter_derivative(at, free[static_cast<size_t>(i)]);
    return by;
  };
  const Eigen::MatrixXd none;
  const Eigen::MatrixXd& before =
      condition.parent < 0 ? none : conditions_[static_cast<size_t>(condition.parent)].leaves_sensitivities;
  Slopes slopes =
      slopes_of(condition, {du.leftCols(k), du.rightCols(count), {}}, inherited(condition, before, free), partial);
  condition.sensitivities = std::move(slopes.u);
  condition.state_sensitivities = std::move(slopes.states);
  condition.leaves_sensitivities = std::move(slopes.leaves);
}

void StaticProtocol::solve_condition(Condition& condition, const Params& p, const std::vector<int>& free,
                                     Equilibrium& equilibrium) const {
  Params target = with_controls(p, condition.controls);
  if (knows_past()) target = start_of_states(condition, std::move(target));
  SolveReport total;
  double smallest = 0;  // Jacobian at the state found
  bool done = false;
  const Eigen::VectorXd change = condition.solved ? predicted_change(condition, target) : Eigen::VectorXd();
  if (change.size() > 0) {
    equilibrium.start_beyond(condition.u, change, target);
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

/// What the rows of a condition read at the end of its step.
void StaticProtocol::read_along(Condition& condition, const QuasiStatics& statics) const {
  const Point at{statics.u(), condition.p, &statics.step()};
  const auto rows = static_cast<Eigen::Index>(condition.rows.size()), k = statics.du().cols();
  condition.read.clear();
  condition.read_by = Eigen::MatrixXd::Zero(rows, k);
  for (Eigen::Index i = 0; i < rows; ++i) {
    const StaticRow& row = rows_[static_cast<size_t>(condition.rows[static_cast<size_t>(i)])];
    const Channel& channel = *channels_[static_cast<size_t>(row.channel)].channel;
    condition.read.push_back(channel.value(at));
    if (k == 0) continue;
    condition.read_by.row(i) = channel.gradient(at).transpose() * statics.du();
    for (Eigen::Index j = 0; j < k; ++j)
      condition.read_by(i, j) += channel.parameter_derivative(at, condition.sensitivity_of[static_cast<size_t>(j)]) +
                                 channel.memory_derivative(at, statics.dmemory().col(j));
  }
}

void StaticProtocol::solve_history(Path& path, const Params& p, const std::vector<int>& free) {
  QuasiStatics statics(*scene_.model, options_.equilibrium);
  Params rest = p;
  for (int index : controls_) rest[index] = 0;
  for (int index : off_at_rest_) rest[index] = 0;
  statics.start_at_rest(rest, static_cast<int>(free.size()));
  path.cost = 0;
  SolveReport last;
  for (int c : path.conditions) {
    Condition& condition = conditions_[static_cast<size_t>(c)];
    condition.solved = false;
    if (last.status != SolveStatus::converged) {
      condition.report = {};
      condition.report.status = last.status;
      condition.report.not_tried = true;
      continue;
    }
    const Params target = with_controls(p, condition.controls);
    Eigen::MatrixXd dp = Eigen::MatrixXd::Zero(p.size(), static_cast<Eigen::Index>(free.size()));
    for (size_t j = 0; j < free.size(); ++j) {
      if (!condition.rows.empty() || !held_when_unloaded(free[j])) dp(free[j], static_cast<Eigen::Index>(j)) = 1;
    }
    last = statics.advance(target, dp, 0);
    if (last.status == SolveStatus::converged && condition.seconds > 0) {
      const SolveReport held = statics.hold(target, dp, condition.seconds);
      last.status = held.status;
      last.iterations += held.iterations;
      last.factorisations += held.factorisations;
      last.slipped |= held.slipped;
    }
    condition.report = last;
    path.cost += last.factorisations;
    if (last.status != SolveStatus::converged) continue;
    condition.p = target;
    condition.u = statics.u();
    condition.smallest_jacobian = smallest_jacobian(scene_.model->mesh(), condition.u);
    condition.solved = condition.smallest_jacobian > 0;
    condition.sensitivity_of = free;
    condition.sensitivities = statics.du();
    read_along(condition, statics);
  }
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
  std::map<int, Grip> grips;  // what sticks at each condition, with Options::sticks
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
