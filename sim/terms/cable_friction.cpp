#include "sim/terms/cable_friction.hpp"

#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "sim/core/numbers.hpp"
#include "sim/terms/cable_path.hpp"
#include "sim/terms/one_sided.hpp"

namespace taut {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

/// The law of a whole cable: tension by elongation, and back.
struct CableLawOf {
  double stiffness, smoothing;

  double energy(double e) const { return stiffness * OneSided(e, smoothing).energy; }
  /// The elongation [m] at a tension, the largest slack one at 0.
  double elongation(double tension) const {
    const double t = tension / stiffness;
    return t < 0.5 * smoothing ? std::sqrt(2 * smoothing * t) - 0.5 * smoothing : t;
  }
  /// Its derivative [m/N]; infinite at 0.
  double compliance(double tension) const {
    const double t = tension / stiffness;
    if (t <= 0) return infinity;
    return (t < 0.5 * smoothing ? std::sqrt(0.5 * smoothing / t) : 1) / stiffness;
  }
};

/// Segments in a row whose tensions differ by no more than eyelets between them bear.
class Chain {
 public:
  /// `shares` w_j, `trial` the elongations E_j where every eyelet sticks, `bounds` b_i of the eyelets between.
  Chain(CableLawOf law, const VectorXd& shares, const VectorXd& trial, const VectorXd& bounds)
      : law_(law), shares_(shares), trial_(trial), bounds_(bounds) {
    solve();
  }

  Index size() const { return trial_.size(); }
  const VectorXd& tensions() const { return tensions_; }  ///< T_j [N]
  const VectorXd& slips() const { return slips_; }        ///< s_i - s_i' [m], 0 where eyelets stick

  double energy() const {
    if (is_slack_) return 0;
    double sum = bounds_.dot(slips_.cwiseAbs());
    for (Index j = 0; j < size(); ++j) {
      const double e = trial_[j] + (j > 0 ? slips_[j - 1] : 0) - (j + 1 < size() ? slips_[j] : 0);
      sum += shares_[j] * law_.energy(e / shares_[j]);
    }
    return sum;
  }

  /// Runs of segments that slipping eyelets join, as first and past the last, with the compliance of each [m/N].
  struct Run {
    Index first, end;
    double compliance;
  };
  std::vector<Run> runs() const {
    std::vector<Run> all;
    for (Index j = 0; j < size(); ++j) {
      if (j == 0 || way_[static_cast<size_t>(j - 1)] == 0) all.push_back({j, j, 0});
      all.back().end = j + 1;
      all.back().compliance += compliance(j);
    }
    return all;
  }
  /// Of a segment [m/N]; infinite where it is slack.
  double compliance(Index j) const { return shares_[j] * law_.compliance(tensions_[j]); }

  /// Changes of tensions and slips, a column each.
  struct Change {
    MatrixXd tensions, slips;
  };
  /// With those of the trial elongations and of the bounds.
  Change change(const MatrixXd& trial, const MatrixXd& bounds) const {
    Change of{MatrixXd::Zero(size(), trial.cols()), MatrixXd::Zero(size() - 1, trial.cols())};
    if (is_slack_) {
      MatrixXd past = MatrixXd::Zero(1, trial.cols());
      for (Index j = 0; j + 1 < size(); ++j)
        of.slips.row(j) = past += trial.row(j) - shares_[j] * trial.colwise().sum();
      return of;
    }
    for (const Run& run : runs()) {
      // Against the first segment of the run the others change by what the bounds between them do.
      Index slack = -1;
      MatrixXd sum = MatrixXd::Zero(1, trial.cols());
      for (Index j = run.first; j < run.end; ++j) {
        if (j > run.first)
          of.tensions.row(j) = of.tensions.row(j - 1) - way_[static_cast<size_t>(j - 1)] * bounds.row(j - 1);
        sum += trial.row(j);
        if (std::isinf(compliance(j))) {
          slack = j;
        } else {
          sum -= compliance(j) * of.tensions.row(j);
        }
      }
      const MatrixXd common = slack >= 0 ? MatrixXd(-of.tensions.row(slack)) : MatrixXd(sum / run.compliance);
      for (Index j = run.first; j < run.end; ++j) of.tensions.row(j) += common;
      MatrixXd past = MatrixXd::Zero(1, trial.cols());
      for (Index j = run.first; j + 1 < run.end; ++j) {
        past += trial.row(j);
        if (!std::isinf(compliance(j))) past -= compliance(j) * of.tensions.row(j);
        of.slips.row(j) = past;
      }
    }
    return of;
  }

 private:
  struct Value {
    double value, slope;
  };
  /// The elongation that segment j and all before it have too little of [m] at tension T of segment j.
  Value lacking(Index j, double T) const {
    Value sum{shares_[j] * law_.elongation(T) - trial_[j], shares_[j] * law_.compliance(T)};
    if (j == 0) return sum;
    const double b = bounds_[j - 1], free = alone_[j - 1];
    if (b > 0 && std::abs(T - free) <= b) return sum;
    const Value before = lacking(j - 1, T < free ? T + b : T - b);
    return {sum.value + before.value, sum.slope + before.slope};
  }

  /// The tension of segment j where nothing follows it: the root of lacking(), which rises.
  double root(Index j) const {
    if (lacking(j, 0).value >= 0) return 0;
    double low = 0, high = law_.stiffness * std::max(law_.smoothing, std::abs(trial_[j] / shares_[j]));
    if (!(high > 0)) high = std::numeric_limits<double>::min();
    while (lacking(j, high).value < 0) {
      low = high;
      high *= 2;
    }
    double T = high;
    for (int iteration = 0; iteration < 200; ++iteration) {
      const Value at = lacking(j, T);
      (at.value < 0 ? low : high) = T;
      double next = T - at.value / at.slope;
      if (!(next > low && next < high)) next = 0.5 * (low + high);
      if (std::abs(next - T) <= std::numeric_limits<double>::epsilon() * T || next == low || next == high) return next;
      T = next;
    }
    return T;
  }

  void solve() {
    alone_.resize(size());
    for (Index j = 0; j < size(); ++j) alone_[j] = root(j);
    tensions_ = alone_;
    way_.assign(static_cast<size_t>(size() - 1), 0);
    for (Index j = size() - 1; j-- > 0;) {
      const double after = tensions_[j + 1], b = bounds_[j];
      // Where nothing rubs all is free to slip, by nothing too.
      if (std::abs(alone_[j] - after) > b || b == 0) way_[static_cast<size_t>(j)] = alone_[j] < after ? -1 : 1;
      if (way_[static_cast<size_t>(j)] != 0) tensions_[j] = after + way_[static_cast<size_t>(j)] * b;
    }
    is_slack_ = (tensions_.array() == 0).all();
    if (is_slack_) way_.assign(way_.size(), 1);
    slips_ = VectorXd::Zero(size() - 1);
    double past = 0;
    for (Index j = 0; j + 1 < size(); ++j) {
      past += trial_[j] - shares_[j] * (is_slack_ ? trial_.sum() : law_.elongation(tensions_[j]));
      if (way_[static_cast<size_t>(j)] == 0) past = 0;
      slips_[j] = past;
    }
  }

  CableLawOf law_;
  VectorXd shares_, trial_, bounds_;
  VectorXd alone_;  ///< tension of each segment where the cable ends with it
  VectorXd tensions_, slips_;
  std::vector<int> way_;  ///< of each eyelet: 1 slips towards the pulled end, -1 away from it, 0 sticks
  bool is_slack_ = false;
};

/// The path with its friction.
class RubbingPath : public CablePath {
 public:
  RubbingPath(const Mesh& mesh, Cable cable) : CablePath(mesh, cable.points, 0), cable_(std::move(cable)) {
    shares_ = rest_lengths() / rest_length();
  }

  const Cable& cable() const { return cable_; }

  Chain chain(const Point& at) const {
    VectorXd trial = elongations(at.u), bounds(segments() - 1);
    if (cable_.retraction >= 0) trial[0] += at.p[cable_.retraction];
    if (cable_.slack >= 0) trial[0] -= at.p[cable_.slack];
    for (Index i = 0; i < bounds.size(); ++i) {
      const CableEyelet& eyelet = cable_.eyelets[static_cast<size_t>(i)];
      bounds[i] = std::max(0.0, at.p[eyelet.bound]);
      trial[i] -= at.p[eyelet.slip];
      trial[i + 1] += at.p[eyelet.slip];
    }
    return {{at.p[cable_.stiffness], cable_.smoothing}, shares_, trial, bounds};
  }

  bool depends_on(int index) const {
    if (index < 0) return false;
    if (index == cable_.stiffness || index == cable_.slack || index == cable_.retraction) return true;
    for (const CableEyelet& eyelet : cable_.eyelets) {
      if (index == eyelet.bound || index == eyelet.slip) return true;
    }
    return false;
  }

  /// Of tensions and slips with p[index] at fixed displacements.
  Chain::Change change(const Point& at, const Chain& chain, int index) const {
    VectorXd trial = VectorXd::Zero(segments()), bounds = VectorXd::Zero(segments() - 1);
    if (index == cable_.retraction) trial[0] += 1;
    if (index == cable_.slack) trial[0] -= 1;
    if (index == cable_.stiffness) {
      for (Index j = 0; j < segments(); ++j) {
        if (chain.tensions()[j] > 0) trial[j] += chain.compliance(j) * chain.tensions()[j] / at.p[index];
      }
    }
    for (Index i = 0; i < bounds.size(); ++i) {
      const CableEyelet& eyelet = cable_.eyelets[static_cast<size_t>(i)];
      if (index == eyelet.bound && at.p[index] >= 0) bounds[i] = 1;
      if (index != eyelet.slip) continue;
      trial[i] -= 1;
      trial[i + 1] += 1;
    }
    return chain.change(trial, bounds);
  }
  /// Of tensions and slips with the lengths of the segments, a column each.
  Chain::Change change_by_lengths(const Chain& chain) const {
    return chain.change(MatrixXd::Identity(segments(), segments()), MatrixXd::Zero(segments() - 1, segments()));
  }

  /// mu (beta_i + beta_0) / 2.
  VectorXd half_exponents(const Point& at) const {
    return 0.5 * at.p[cable_.friction] * (turnings(at.u).array() + misalignment(at.p)).matrix();
  }
  double misalignment(const Params& p) const { return cable_.misalignment >= 0 ? p[cable_.misalignment] : 0; }

 private:
  Cable cable_;
  VectorXd shares_;  ///< of the segments in the length at rest
};

class RubbingTerm final : public Term {
 public:
  explicit RubbingTerm(RubbingPath path) : path_(std::move(path)) {}

  Cliques cliques() const override { return path_.on().cliques(); }

  void assemble(const Point& at, Assembly& out) const override {
    const Chain chain = path_.chain(at);
    const double share = path_.cable().share;
    out.add_energy(share * chain.energy());
    if (chain.tensions().isZero(0)) return;
    const MatrixXd gradients = path_.gradients(at.u);
    if (out.gradient != nullptr) path_.on().scatter(share * (gradients * chain.tensions()), *out.gradient);
    if (!out.wants_hessian()) return;
    MatrixXd H = MatrixXd::Zero(gradients.rows(), gradients.rows());
    for (const Chain::Run& run : chain.runs()) {
      if (std::isinf(run.compliance)) continue;
      const VectorXd together = gradients.middleCols(run.first, run.end - run.first).rowwise().sum();
      H += share / run.compliance * (together * together.transpose());
    }
    path_.add_hessian(at.u, VectorXd(share * chain.tensions()), H);
    path_.on().add_hessian(H, out);
  }

  bool depends_on(int index) const override { return path_.depends_on(index); }

  void add_parameter_gradient(const Point& at, int index, VectorXd& out) const override {
    if (!depends_on(index)) return;
    const Chain::Change change = path_.change(at, path_.chain(at), index);
    path_.on().scatter(path_.cable().share * (path_.gradients(at.u) * change.tensions), out);
  }

 private:
  RubbingPath path_;
};

class SegmentTension final : public Channel {
 public:
  SegmentTension(RubbingPath path, Index segment) : path_(std::move(path)), segment_(segment) {}
  double value(const Point& at) const override { return path_.chain(at).tensions()[segment_]; }
  VectorXd gradient(const Point& at) const override {
    const MatrixXd by_length = path_.change_by_lengths(path_.chain(at)).tensions;
    return path_.on().spread(path_.gradients(at.u) * by_length.row(segment_).transpose(), at.u.size());
  }
  double parameter_derivative(const Point& at, int index) const override {
    return path_.depends_on(index) ? path_.change(at, path_.chain(at), index).tensions(segment_, 0) : 0;
  }

 private:
  RubbingPath path_;
  Index segment_;
};

class EyeletBound final : public Channel {
 public:
  EyeletBound(RubbingPath path, Index eyelet) : path_(std::move(path)), i_(eyelet) {}

  double value(const Point& at) const override { return factor(at) * sum(path_.chain(at)); }

  VectorXd gradient(const Point& at) const override {
    const Chain chain = path_.chain(at);
    const MatrixXd by_length = path_.change_by_lengths(chain).tensions.middleRows(i_, 2).colwise().sum();
    const VectorXd local =
        factor(at) * (path_.gradients(at.u) * by_length.transpose()) +
        0.5 * at.p[path_.cable().friction] * slope(at) * sum(chain) * path_.turning_gradients(at.u).col(i_);
    return path_.on().spread(local, at.u.size());
  }

  double parameter_derivative(const Point& at, int index) const override {
    const Chain chain = path_.chain(at);
    const Cable& cable = path_.cable();
    double derivative = 0;
    if (path_.depends_on(index))
      derivative += factor(at) * path_.change(at, chain, index).tensions.middleRows(i_, 2).sum();
    if (index == cable.friction)
      derivative += 0.5 * (path_.turnings(at.u)[i_] + path_.misalignment(at.p)) * slope(at) * sum(chain);
    if (index == cable.misalignment) derivative += 0.5 * at.p[cable.friction] * slope(at) * sum(chain);
    return derivative;
  }

 private:
  double factor(const Point& at) const { return std::tanh(path_.half_exponents(at)[i_]); }
  /// Of the factor by its argument.
  double slope(const Point& at) const { return 1 - std::pow(factor(at), 2); }
  double sum(const Chain& chain) const { return chain.tensions()[i_] + chain.tensions()[i_ + 1]; }

  RubbingPath path_;
  Index i_;
};

class EyeletSlip final : public Channel {
 public:
  EyeletSlip(RubbingPath path, Index eyelet) : path_(std::move(path)), i_(eyelet) {}

  double value(const Point& at) const override { return at.p[before()] + path_.chain(at).slips()[i_]; }

  VectorXd gradient(const Point& at) const override {
    const MatrixXd by_length = path_.change_by_lengths(path_.chain(at)).slips;
    return path_.on().spread(path_.gradients(at.u) * by_length.row(i_).transpose(), at.u.size());
  }

  double parameter_derivative(const Point& at, int index) const override {
    const double own = index == before() ? 1 : 0;
    return path_.depends_on(index) ? own + path_.change(at, path_.chain(at), index).slips(i_, 0) : own;
  }

 private:
  int before() const { return path_.cable().eyelets[static_cast<size_t>(i_)].slip; }

  RubbingPath path_;
  Index i_;
};

}  // namespace

std::unique_ptr<Term> make_rubbing_cable(const Mesh& mesh, const Cable& cable) {
  return std::make_unique<RubbingTerm>(RubbingPath(mesh, cable));
}

std::unique_ptr<Channel> make_segment_tension(const Mesh& mesh, const Cable& cable, Index segment) {
  return std::make_unique<SegmentTension>(RubbingPath(mesh, cable), segment);
}

std::unique_ptr<Channel> make_eyelet_bound(const Mesh& mesh, const Cable& cable, Index eyelet) {
  return std::make_unique<EyeletBound>(RubbingPath(mesh, cable), eyelet);
}

std::unique_ptr<Channel> make_eyelet_slip(const Mesh& mesh, const Cable& cable, Index eyelet) {
  return std::make_unique<EyeletSlip>(RubbingPath(mesh, cable), eyelet);
}

}  // namespace taut
