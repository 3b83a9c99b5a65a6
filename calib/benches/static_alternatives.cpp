#include <algorithm>
#include <map>

#include "calib/benches/parallel.hpp"
#include "calib/benches/static_protocol.hpp"

// Other equilibria than those of a static protocol's own paths.
namespace taut {

/// A way along loads that grow, to a quarter beyond the largest, and back from where the state jumped.
class StaticProtocol::LoadWalk {
 public:
  /// `loads` are conditions as growing_loads() has them.
  LoadWalk(const StaticProtocol& protocol, const Params& p, const std::vector<int>& loads)
      : protocol_(protocol), p_(p), equilibrium_(*protocol.scene_.model, checked(protocol.options_.equilibrium)) {
    const auto controls_of = [&](int c) { return protocol.conditions_[static_cast<size_t>(c)].controls; };
    stages_.push_back({protocol.before_loads(controls_of(loads.front()))});
    for (int c : loads) {
      if (controls_of(c) == stages_.front().controls)
        stages_.front().condition = c;
      else
        stages_.push_back({controls_of(c), c});
    }
    if (stages_.size() > 1) stages_.push_back({between(stages_.front(), stages_.back(), 1.25)});
  }

  void go_out() {
    Params rest = p_;
    for (int index : protocol_.controls_) rest[index] = 0;
    for (int index : protocol_.off_at_rest_) rest[index] = 0;
    equilibrium_.start_at_rest(rest);
    for (size_t k = 0; k < stages_.size(); ++k) {
      const SolveReport& report = solve(stages_[k]);
      const bool there = report.status == SolveStatus::converged;
      if (k > 0 && (report.slipped || !there))
        stages_[k].jump =
            load(between(stages_[k - 1], stages_[k], report.slipped ? report.slipped_after : report.reached));
      if (!there) return;  // a limit load, and nothing that was found beyond it
      stages_[k].u = equilibrium_.u();
    }
  }

  /// Adds what is not in `own`, the states of a prediction, to `found`.
  void come_back(const std::vector<Condition>& own, std::vector<Other>& found) {
    for (size_t k = 1; k < stages_.size(); ++k) {
      if (stages_[k].jump == 0) continue;
      note_jump(stages_[k].jump, found);
      if (stages_[k].u.size() == 0) continue;
      equilibrium_.start_at(stages_[k].u, protocol_.with_controls(p_, stages_[k].controls));
      for (size_t back = k; back-- > 0;) {
        const SolveReport& report = solve(stages_[back]);
        if (report.status != SolveStatus::converged || report.slipped ||
            protocol_.same_state(equilibrium_.u(), stages_[back].u))
          break;
        take(stages_[back].condition, equilibrium_.u(), own, found);
      }
    }
    for (const Stage& stage : stages_) take(stage.condition, stage.u, own, found);
  }

  int factorisations() const { return factorisations_; }

 private:
  struct Stage {
    std::vector<double> controls;
    int condition = -1;      ///< that has these controls; -1: none
    Eigen::VectorXd u = {};  ///< empty: there is none
    double jump = 0;         ///< load() at which the state jumped on the way here; 0: it did not
  };

  static EquilibriumOptions checked(EquilibriumOptions options) {
    options.check_path = true;
    return options;
  }
  static std::vector<double> between(const Stage& from, const Stage& to, double fraction) {
    std::vector<double> controls = from.controls;
    for (size_t k = 0; k < controls.size(); ++k) controls[k] += fraction * (to.controls[k] - controls[k]);
    return controls;
  }
  double load(const std::vector<double>& controls) const {
    double sum = 0;
    for (size_t k = 0; k < controls.size(); ++k) sum += std::abs(controls[k] - stages_.front().controls[k]);
    return sum;
  }
  const SolveReport& solve(const Stage& stage) {
    const SolveReport& report = equilibrium_.solve(protocol_.with_controls(p_, stage.controls));
    factorisations_ += report.factorisations;
    return report;
  }
  void note_jump(double at, std::vector<Other>& found) const {
    for (const Stage& stage : stages_) {
      if (stage.condition < 0 || load(stage.controls) == 0) continue;
      double& nearest = found[static_cast<size_t>(stage.condition)].jump;
      const double jump = at / load(stage.controls);
      if (!(std::abs(jump - 1) >= std::abs(nearest - 1))) nearest = jump;
    }
  }
  void take(int condition, const Eigen::VectorXd& u, const std::vector<Condition>& own,
            std::vector<Other>& found) const {
    if (condition < 0 || u.size() == 0) return;
    const auto c = static_cast<size_t>(condition);
    if (found[c].u.size() == 0 && !protocol_.same_state(u, own[c].u)) found[c].u = u;
  }

  const StaticProtocol& protocol_;
  const Params& p_;
  Equilibrium equilibrium_;
  std::vector<Stage> stages_;
  int factorisations_ = 0;
};

/// Conditions whose controls differ in loads only, from small to large, each adding to the one before it.
std::vector<std::vector<int>> StaticProtocol::growing_loads() const {
  std::map<std::vector<double>, std::vector<int>> by_unloaded;
  for (size_t c = 0; c < conditions_.size(); ++c)
    by_unloaded[before_loads(conditions_[c].controls)].push_back(static_cast<int>(c));
  std::vector<std::vector<int>> chains;
  for (auto& [unloaded, list] : by_unloaded) {
    std::ranges::stable_sort(list, {}, [&](int c) { return load_of(c); });
    for (size_t i = 0; i < list.size(); ++i) {
      if (i == 0 || !adds_to(list[i], list[i - 1])) chains.emplace_back();
      chains.back().push_back(list[i]);
    }
  }
  return chains;
}

bool StaticProtocol::same_state(const Eigen::VectorXd& a, const Eigen::VectorXd& b) const {
  return (a - b).cwiseAbs().maxCoeff() <= 1e-4 * scene_.model->length_scale();
}

/// All conditions as a prediction from the start finds them; nothing that later ones start from changes.
std::vector<StaticProtocol::Condition> StaticProtocol::solved_afresh(const Params& p) {
  std::vector<Condition> conditions = conditions_;
  std::vector<Path> paths;
  for (const Path& path : paths_) paths.push_back({path.conditions, path.cost, nullptr});
  std::swap(paths, paths_);
  forget();
  in_parallel(paths_.size(), options_.threads, [&](size_t i) { solve_path(paths_[i], p, {}); });
  std::swap(paths, paths_);
  std::swap(conditions, conditions_);
  for (const Condition& condition : conditions) factorisations_ += condition.report.factorisations;
  return conditions;
}

/// Of each condition, `own` being the states of a prediction at `p`.
std::vector<StaticProtocol::Other> StaticProtocol::others(const Params& p, const std::vector<Condition>& own) {
  std::vector<Other> found(conditions_.size(), Other{{}, not_a_number});
  if (std::ranges::any_of(own, [](const Condition& c) { return c.report.status != SolveStatus::converged; }))
    return found;
  const std::vector<std::vector<int>> chains = growing_loads();
  std::vector<int> factorisations(chains.size());
  in_parallel(chains.size(), options_.threads, [&](size_t i) {
    LoadWalk walk(*this, p, chains[i]);
    walk.go_out();
    walk.come_back(own, found);
    factorisations[i] = walk.factorisations();
  });
  for (int one : factorisations) factorisations_ += one;
  return found;
}

std::vector<Alternative> StaticProtocol::alternatives(const Params& p) {
  if (options_.history || knows_past()) return {};  // loads that grow beyond a row's own would leave it another past
  find_followed();
  const std::vector<Condition> own = solved_afresh(p);
  const std::vector<Other> found = others(p, own);
  std::vector<Alternative> alternatives;
  for (size_t c = 0; c < own.size(); ++c) {
    if (own[c].rows.empty() || (found[c].u.size() == 0 && !std::isfinite(found[c].jump))) continue;
    Alternative& alternative = alternatives.emplace_back();
    alternative.rows = own[c].rows;
    alternative.jump = found[c].jump;
    const auto values = [&](const Eigen::VectorXd& u) {
      Eigen::VectorXd all(static_cast<Eigen::Index>(own[c].rows.size()));
      for (Eigen::Index i = 0; i < all.size(); ++i) {
        const StaticRow& row = rows_[static_cast<size_t>(own[c].rows[static_cast<size_t>(i)])];
        const Channel& channel = *channels_[static_cast<size_t>(row.channel)].channel;
        all[i] = channel.value({u, own[c].p}) + (row.offset < 0 ? 0 : p[row.offset]);
        if (own[c].unloaded < 0) continue;
        const Condition& unloaded = own[static_cast<size_t>(own[c].unloaded)];
        all[i] -= channel.value({unloaded.u, unloaded.p});
      }
      return all;
    };
    alternative.path = values(own[c].u);
    if (found[c].u.size() > 0) alternative.other = values(found[c].u);
  }
  return alternatives;
}

void StaticProtocol::follow(const Params& at, const std::vector<int>& rows) {
  if (options_.history) return;
  for (Condition& condition : conditions_) {
    condition.other_u.resize(0);
    condition.other_p.resize(0);
  }
  follow_at_ = rows.empty() ? Params() : at;
  follow_rows_ = rows;
  forget();
}

/// Where follow() has left it to the next prediction, which may be one that is known already, looks for what is to be
/// followed.
void StaticProtocol::find_followed() {
  if (follow_at_.size() == 0) return;
  const Params at = std::exchange(follow_at_, Params());
  const std::vector<Other> found = others(at, solved_afresh(at));
  for (int row : follow_rows_) {
    const auto c = static_cast<size_t>(condition_of_row_[static_cast<size_t>(row)]);
    conditions_[c].other_u = found[c].u;
    if (found[c].u.size() > 0) conditions_[c].other_p = with_controls(at, conditions_[c].controls);
  }
}

}  // namespace taut
