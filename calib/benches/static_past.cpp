#include <algorithm>
#include <functional>
#include <map>
#include <stdexcept>

#include "calib/benches/static_protocol.hpp"
#include "sim/core/dense.hpp"
#include "sim/core/numbers.hpp"

// States that know their past (Scene::states): the ways on which they are reached, what follows from the state itself,
// and derivatives along the way.
namespace taut {

bool StaticProtocol::unloads(const Condition& condition) const {
  return options_.direction >= 0 && condition.controls[static_cast<size_t>(options_.direction)] == 2;
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

}  // namespace taut
