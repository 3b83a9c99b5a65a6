#include "sim/contact/contact_friction.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "sim/core/dense.hpp"
#include "sim/core/jet.hpp"

namespace taut {
namespace {

/// A vector of numbers with or without derivatives.
template <class S, int D>
using Tuple = std::array<S, static_cast<size_t>(D)>;

template <class S, int D>
S dot(const Tuple<S, D>& a, const Tuple<S, D>& b) {
  S sum = a[0] * b[0];
  for (size_t i = 1; i < D; ++i) sum = sum + a[i] * b[i];
  return sum;
}

/// a + factor b.
template <class S, int D>
Tuple<S, D> plus(const Tuple<S, D>& a, const S& factor, const Tuple<S, D>& b) {
  Tuple<S, D> sum;
  for (size_t i = 0; i < D; ++i) sum[i] = a[i] + factor * b[i];
  return sum;
}

/// A vertex seen from the first corner of the feature that it meets: itself, and the other corners.
template <class S, int D>
struct Seen {
  Tuple<S, D> vertex;
  std::array<Tuple<S, D>, static_cast<size_t>(D) - 1> along;
};

/// What is left of d along the surface.
template <class S>
Tuple<S, 2> tangential(const Seen<S, 2>& seen, const Tuple<S, 2>& d) {
  const Tuple<S, 2>& e = seen.along[0];
  const S part = dot<S, 2>(d, e) / dot<S, 2>(e, e);
  return {part * e[0], part * e[1]};
}
template <class S>
Tuple<S, 3> cross(const Tuple<S, 3>& a, const Tuple<S, 3>& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
template <class S>
Tuple<S, 3> tangential(const Seen<S, 3>& seen, const Tuple<S, 3>& d) {
  // -n x (n x d), in which nothing of the distance to the surface cancels.
  const Tuple<S, 3> n = cross(seen.along[0], seen.along[1]), turned = cross(cross(n, d), n);
  const S square = dot<S, 3>(n, n);
  return {turned[0] / square, turned[1] / square, turned[2] / square};
}

/// Coordinates of a point, seen from the first corner, among the corners.
template <class S>
Tuple<S, 1> coordinates(const Seen<S, 2>& seen, const Tuple<S, 2>& point) {
  return {dot<S, 2>(point, seen.along[0]) / dot<S, 2>(seen.along[0], seen.along[0])};
}
template <class S>
Tuple<S, 2> coordinates(const Seen<S, 3>& seen, const Tuple<S, 3>& point) {
  const auto& [a, b] = seen.along;
  const S aa = dot<S, 3>(a, a), ab = dot<S, 3>(a, b), bb = dot<S, 3>(b, b);
  const S pa = dot<S, 3>(point, a), pb = dot<S, 3>(point, b), det = aa * bb - ab * ab;
  return {(bb * pa - ab * pb) / det, (aa * pb - ab * pa) / det};
}

/// What is left of d along a ground at a place `at` on it, from the ground's point.
template <class S, int D>
Tuple<S, D> along_ground(const Ground<D>& ground, const Tuple<S, D>& at, const Tuple<S, D>& d) {
  Tuple<S, D> normal;
  for (int i = 0; i < D; ++i) normal[static_cast<size_t>(i)] = S(ground.normal[i]);
  if (ground.is_round()) {
    Tuple<S, D> across = at;
    if (ground.kind == GroundKind::cylinder) across = plus<S, D>(at, -1.0 * dot<S, D>(at, normal), normal);
    const S length = sqrt(dot<S, D>(across, across));
    for (size_t i = 0; i < D; ++i) normal[i] = across[i] / length;
  }
  return plus<S, D>(d, -1.0 * dot<S, D>(normal, d), normal);
}

/// What is remembered of a vertex and a side that pressed on it: coordinates in the edge or triangle, or the place from
/// the point of a ground, where it was caught.
template <class S, int D>
struct Caught {
  int feature = -1;  ///< -1: nothing pressed
  Tuple<S, D> at{};
  S force{};
};

template <class AnyContact>
class ContactFriction final : public SidedTerm {
  static constexpr int D = AnyContact::dimension;
  static constexpr int places = D * (D + 1);  ///< coordinates of a vertex and what it meets
  static constexpr int slots = 2;             ///< sides that are remembered of each vertex
  static constexpr int numbers = D + 2;       ///< of each: feature + 1, where it was caught, force

 public:
  ContactFriction(const AnyContact& contact, int coefficient, const Params& p)
      : contact_(&contact), coefficient_(coefficient), p_(p) {}

  void assemble(const Point& at, Assembly& out) const override {
    const double mu = at.p[coefficient_];
    each(at, [&](const Meeting<D>& meeting, double k, const Caught<double, D>& caught) {
      using J = Jet<places>;
      Caught<J, D> constant{caught.feature, {}, J(caught.force)};
      for (size_t i = 0; i < D; ++i) constant.at[i] = J(caught.at[i]);
      const J energy = energy_of(meeting, seen<J>(meeting, at.u), constant, J(mu), k);
      out.add_energy(energy.v);
      if (out.gradient == nullptr && !out.wants_hessian()) return;
      const auto [nodes, entry] = moving(meeting);
      const Eigen::VectorXd gradient = energy.g(entry);
      const int count = static_cast<int>(nodes.size());
      if (out.gradient != nullptr) out.add_gradient(nodes.data(), count, D, gradient.data());
      if (!out.wants_hessian()) return;
      Eigen::MatrixXd hessian = energy.H(entry, entry);
      if (out.curvature == Curvature::projected) hessian = positive_part(hessian);
      out.add_coupling(nodes.data(), count, D, hessian.data());
    });
  }

  bool depends_on(int index) const override { return index == coefficient_; }
  void add_parameter_gradient(const Point& at, int index, Eigen::VectorXd& out) const override {
    if (index == coefficient_) add_mixed(at, 1, Eigen::VectorXd(), out);
  }

  int place_memory(int first) override {
    first_ = first;
    return contact_->vertices() * slots * numbers;
  }
  std::unique_ptr<Term> between(std::array<int, 2> sides) const override {
    auto some = std::make_unique<ContactFriction>(*this);  // of the same memory
    some->between_ = sides;
    return some;
  }
  void remember(const Point& at, Eigen::VectorXd& next) const override {
    catch_again<double>(
        at, contact_->touches(at), next, [&](Eigen::Index i) { return at.u[i]; },
        [&](Eigen::Index i) { return at.step->memory[i]; }, at.p[coefficient_]);
  }
  void add_memory_product(const Point& at, const Eigen::VectorXd& change, Eigen::VectorXd& out) const override {
    add_mixed(at, 0, change, out);
  }
  void remember_change(const Point& at, const Eigen::VectorXd& du, const Params& dp, const Eigen::VectorXd& dmemory,
                       Eigen::VectorXd& next) const override {
    using J = Jet<1>;
    const auto number = [](double value, double slope) {
      J x(value);
      x.g[0] = slope;
      return x;
    };
    catch_again<J>(
        at, contact_->touches(at, &du, &dp), next, [&](Eigen::Index i) { return number(at.u[i], du[i]); },
        [&](Eigen::Index i) { return number(at.step->memory[i], dmemory[i]); },
        number(at.p[coefficient_], dp[coefficient_]));
  }

 private:
  /// k of a vertex and what it meets.
  double stiffness_of(const Meeting<D>& meeting) const {
    const auto& settings = contact_->settings();
    double thickness = 1;
    if constexpr (D == 2) thickness = settings.thickness >= 0 ? p_[settings.thickness] : 1;
    return p_[meeting.stiffness] * meeting.area * thickness / p_[settings.gap];
  }

  Eigen::Index slot(int vertex, int which) const {
    return first_ + static_cast<Eigen::Index>(vertex * slots + which) * numbers;
  }
  template <class S, class Memory>
  static Caught<S, D> read(Memory&& memory, Eigen::Index from) {
    Caught<S, D> caught;
    caught.feature = static_cast<int>(std::lround(value_of(memory(from)))) - 1;
    for (size_t i = 0; i < D; ++i) caught.at[i] = memory(from + 1 + static_cast<Eigen::Index>(i));
    caught.force = memory(from + D + 1);
    return caught;
  }

  /// Whether it is of the sides that are asked for.
  bool counts(const Meeting<D>& meeting) const {
    const std::array<int, 2> one{meeting.own_side, meeting.side}, other{meeting.side, meeting.own_side};
    return !between_ || *between_ == one || *between_ == other;
  }

  /// action(meeting, stiffness, caught) for all that pressed when the step began.
  template <class Action>
  void each(const Point& at, Action&& action) const {
    if (at.step == nullptr || at.step->memory.size() == 0) return;
    for (int v = 0; v < contact_->vertices(); ++v) {
      for (int which = 0; which < slots; ++which) {
        const auto caught = read<double>([&](Eigen::Index i) { return at.step->memory[i]; }, slot(v, which));
        if (caught.feature < 0) break;
        const Meeting<D> meeting = contact_->meeting(v, caught.feature, p_);
        if (!counts(meeting)) continue;
        action(meeting, stiffness_of(meeting), caught);
      }
    }
  }

  /// The nodes that move, and which of the coordinates are theirs.
  static std::pair<std::vector<int>, std::vector<int>> moving(const Meeting<D>& meeting) {
    std::pair<std::vector<int>, std::vector<int>> result;
    for (int k = 0; k <= D; ++k) {
      if (meeting.nodes[static_cast<size_t>(k)] < 0) continue;
      result.first.push_back(meeting.nodes[static_cast<size_t>(k)]);
      for (int i = 0; i < D; ++i) result.second.push_back(D * k + i);
    }
    return result;
  }

  /// Without the digits that positions share; `displacement(place, component)` of the vertex and the corners.
  template <class S, class Displacement>
  static Seen<S, D> seen_with(const Meeting<D>& meeting, Displacement&& displacement) {
    Seen<S, D> seen;
    for (int k = 0; k <= (meeting.ground == nullptr ? D : 0); ++k) {
      if (k == 1) continue;
      Tuple<S, D>& to = k == 0 ? seen.vertex : seen.along[static_cast<size_t>(k) - 2];
      for (int i = 0; i < D; ++i)
        to[static_cast<size_t>(i)] = S(meeting.X(i, k) - meeting.X(i, 1)) + (displacement(k, i) - displacement(1, i));
    }
    return seen;
  }
  /// With the coordinates of the places as the first variables.
  template <class J>
  static Seen<J, D> seen(const Meeting<D>& meeting, const Eigen::VectorXd& u) {
    return seen_with<J>(meeting, [&](int k, int i) {
      const int node = meeting.nodes[static_cast<size_t>(k)];
      return J::variable(node < 0 ? 0.0 : u[D * node + i], D * k + i);
    });
  }

  template <class S>
  static Tuple<S, D> stretch(const Meeting<D>& meeting, const Seen<S, D>& seen, const Tuple<S, D>& caught) {
    Tuple<S, D> d = seen.vertex;
    if (meeting.ground != nullptr) return along_ground<S, D>(*meeting.ground, caught, plus<S, D>(d, S(-1.0), caught));
    for (size_t j = 0; j + 1 < D; ++j) d = plus<S, D>(d, -1.0 * caught[j], seen.along[j]);
    return tangential(seen, d);
  }

  template <class S>
  static S energy_of(const Meeting<D>& meeting, const Seen<S, D>& seen, const Caught<S, D>& caught, const S& mu,
                     double k) {
    const Tuple<S, D> g = stretch(meeting, seen, caught.at);
    const S square = dot<S, D>(g, g), limit = mu * caught.force;
    if (k * k * value_of(square) <= std::pow(value_of(limit), 2)) return (0.5 * k) * square;
    return limit * sqrt(square) - (0.5 / k) * (limit * limit);
  }

  /// Adds the mixed derivative of E by u and by the memory along `change`, and `by_coefficient` times that by mu.
  void add_mixed(const Point& at, double by_coefficient, const Eigen::VectorXd& change, Eigen::VectorXd& out) const {
    using J = Jet<places + 1>;
    const auto along = [&](double value, double slope) {
      J x(value);
      x.g[places] = slope;
      return x;
    };
    if (at.step == nullptr || at.step->memory.size() == 0) return;
    for (int v = 0; v < contact_->vertices(); ++v) {
      for (int which = 0; which < slots; ++which) {
        const auto caught =
            read<J>([&](Eigen::Index i) { return along(at.step->memory[i], change.size() > 0 ? change[i] : 0.0); },
                    slot(v, which));
        if (caught.feature < 0) break;
        const Meeting<D> meeting = contact_->meeting(v, caught.feature, p_);
        if (!counts(meeting)) continue;
        const J energy = energy_of(meeting, seen<J>(meeting, at.u), caught, along(at.p[coefficient_], by_coefficient),
                                   stiffness_of(meeting));
        for (int k = 0; k <= D; ++k) {
          const int node = meeting.nodes[static_cast<size_t>(k)];
          if (node >= 0) out.segment<D>(D * node) += energy.H.col(places).template segment<D>(D * k);
        }
      }
    }
  }

  template <class S>
  static double to_write(const S& x) {
    if constexpr (std::is_same_v<S, double>)
      return x;
    else
      return x.g[0];
  }

  /// Writes what is remembered at the end of a step, or its change: springs cut to their limit, caught on what is
  /// nearest now.
  template <class S, class Displacement, class Memory>
  void catch_again(const Point& at, std::vector<Touch<D>> touches, Eigen::VectorXd& next, Displacement&& displacement,
                   Memory&& memory, const S& mu) const {
    const bool has_past = at.step != nullptr && at.step->memory.size() > 0;
    const auto seen_now = [&](const Meeting<D>& meeting) {
      return seen_with<S>(meeting, [&](int k, int i) {
        const int node = meeting.nodes[static_cast<size_t>(k)];
        return node < 0 ? S(0.0) : S(displacement(D * node + i));
      });
    };
    // Those that press most of each vertex.
    std::ranges::stable_sort(touches, [](const Touch<D>& a, const Touch<D>& b) {
      return a.vertex != b.vertex ? a.vertex < b.vertex : a.force.norm() > b.force.norm();
    });
    int which = 0;
    for (size_t i = 0; i < touches.size(); ++i) {
      const Touch<D>& touch = touches[i];
      which = i > 0 && touches[i - 1].vertex == touch.vertex ? which + 1 : 0;
      if (which >= slots || !(touch.force.norm() > 0)) continue;
      const Meeting<D> meeting = contact_->meeting(touch.vertex, touch.feature, p_);
      const Seen<S, D> seen = seen_now(meeting);
      Tuple<S, D> place = seen.vertex;
      for (int old = 0; has_past && old < slots; ++old) {
        const Caught<S, D> caught = read<S>(memory, slot(touch.vertex, old));
        if (caught.feature < 0) break;
        const Meeting<D> before = contact_->meeting(touch.vertex, caught.feature, p_);
        if (before.side != meeting.side) continue;
        const Tuple<S, D> g = stretch(before, seen_now(before), caught.at);
        const S square = dot<S, D>(g, g), limit = mu * caught.force;
        const double k = stiffness_of(before);
        const bool slides = k * k * value_of(square) > std::pow(value_of(limit), 2);
        place = plus<S, D>(place, slides ? S((-1.0 / k) * (limit / sqrt(square))) : S(-1.0), g);
      }
      Tuple<S, D> where = place;
      if (meeting.ground == nullptr) {
        const Tuple<S, D - 1> alpha = coordinates(seen, place);
        where = {};
        std::ranges::copy(alpha, where.begin());
      }
      const Eigen::Index to = slot(touch.vertex, which);
      if constexpr (std::is_same_v<S, double>) next[to] = touch.feature + 1;
      for (size_t j = 0; j < D; ++j) next[to + 1 + static_cast<Eigen::Index>(j)] = to_write(where[j]);
      if constexpr (std::is_same_v<S, double>)
        next[to + D + 1] = touch.force.norm();
      else
        next[to + D + 1] = touch.force.dot(touch.change) / touch.force.norm();
    }
  }

  const AnyContact* contact_;
  int coefficient_;
  Params p_;  ///< at which k is taken
  int first_ = 0;
  std::optional<std::array<int, 2>> between_;  ///< sides; none: all
};

}  // namespace

std::unique_ptr<SidedTerm> make_contact_friction(const Contact& contact, int coefficient, const Params& p) {
  return std::make_unique<ContactFriction<Contact>>(contact, coefficient, p);
}

std::unique_ptr<SidedTerm> make_contact_friction(const Contact3d& contact, int coefficient, const Params& p) {
  return std::make_unique<ContactFriction<Contact3d>>(contact, coefficient, p);
}

}  // namespace taut
