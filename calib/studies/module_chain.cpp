#include "calib/studies/module_chain.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "calib/benches/model.hpp"
#include "sim/core/dense.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/scene/channel_kinds.hpp"
#include "sim/shapes/push_puppet_3d.hpp"

namespace taut {
namespace {

constexpr int chain_loads = 10;

/// A rigid motion in the plane: x = centre + R(angle) (X - from).
struct PlaneMotion {
  Eigen::Vector2d from{0, 0}, to{0, 0};
  double angle = 0;
  Eigen::Vector2d operator()(const Eigen::Vector2d& X) const {
    return to + Eigen::Rotation2Dd(angle).toRotationMatrix() * (X - from);
  }
};

/// The rigid motion that is nearest to how points have moved.
PlaneMotion nearest_motion(const std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>>& points) {
  PlaneMotion motion;
  for (const auto& [X, x] : points) {
    motion.from += X / static_cast<double>(points.size());
    motion.to += x / static_cast<double>(points.size());
  }
  double sine = 0, cosine = 0;
  for (const auto& [X, x] : points) {
    const Eigen::Vector2d A = X - motion.from, a = x - motion.to;
    sine += A.x() * a.y() - A.y() * a.x();
    cosine += A.dot(a);
  }
  motion.angle = std::atan2(sine, cosine);
  return motion;
}

/// One export: where the body is, and the steps.
class ChainMaker {
 public:
  ChainMaker(const StiffnessReplay& replay, const ModuleChainQuestion& question)
      : replay_(replay),
        question_(question),
        bench_(replay.bench()),
        setup_(setup_of(bench_.experiment(), bench_.experiment().mesh, *bench_.trials_at_rest())) {}

  ModuleChain made() {
    find_axis();
    find_load_and_channel();
    solve();
    place_segments();
    find_masses();
    follow();
    return std::move(made_);
  }

 private:
  [[noreturn]] void fail(const std::string& why) const { throw InputError(bench_.experiment().path + ": " + why); }
  const BodySettings& body() const { return setup_.bodies.front(); }
  int dimension() const { return mesh_->dimension(); }

  // The body at rest

  /// Axis, and arc lengths of the hinges along it.
  void find_axis() {
    const Shape& shape = *body().geometry.shape;
    const int d = setup_.dimension;
    const auto* plane = dynamic_cast<const PushPuppet*>(&shape);
    const auto* space = dynamic_cast<const PushPuppet3d*>(&shape);
    Eigen::VectorXd origin, along;
    if (plane != nullptr || space != nullptr) {
      const PushPuppet& module = plane != nullptr ? *plane : space->section;
      const PushPuppetLayout at(module);
      rigid_ = "plastic";
      for (int cell = 0; cell < module.cells; ++cell) places_.push_back(cell * at.pitch + 0.5 * module.cell_length);
      origin = placed(body(), Eigen::VectorXd::Zero(d));
      along = placed(body(), Eigen::VectorXd::Unit(d, 0)) - origin;
      length_ = at.tip;
    } else if (shape.axis()) {
      const BodyAxis axis = axis_of(body());
      origin = axis.origin;
      along = axis.along;
      length_ = axis.length;
      for (int i = 0; i < question_.hinges; ++i) places_.push_back((i + 0.5) * length_ / question_.hinges);
    } else {
      fail(
          fmt::format("a chain of hinges is made of a push-puppet module or a body with a straight axis ({}); '{}' is "
                      "neither, export its table",
                      join(kinds_with_axis()), shape.kind()));
    }
    origin_ = origin;
    along_ = along;
  }

  std::vector<double> rest_controls() const {
    std::vector<double> controls = question_.controls;
    controls[replay_.load()] = 0;
    return controls;
  }

  const LoadSettings& load() const {
    const std::string& id = bench_.controls()[replay_.load()].id;
    const auto found = std::ranges::find(setup_.loads, id, &LoadSettings::control);
    const auto by_id = std::ranges::find(setup_.loads, id, &LoadSettings::id);
    if (found == setup_.loads.end() && by_id == setup_.loads.end())
      fail(fmt::format("'{}' is no [[load]], so that nothing says where it acts", id));
    return found != setup_.loads.end() ? *found : *by_id;
  }

  /// Mean of a tag, or a point [m].
  Eigen::VectorXd place_of(const std::string& on, const std::vector<double>& point) const {
    if (!point.empty()) return vector_of(point);
    Eigen::VectorXd place(dimension());
    for (int c = 0; c < dimension(); ++c)
      place[c] = mean_weights(*mesh_, mesh_->select(on), Eigen::VectorXd::Unit(dimension(), c)).dot(mesh_->X);
    return place;
  }

  void find_load_and_channel() {
    at_rest_ = replay_.solved({rest_controls()});
    states_ = at_rest_.bench->states();
    mesh_ = states_.mesh;
    if (mesh_ == nullptr) fail("its model has no mesh to make segments of");
    const Eigen::VectorXd direction = vector_of(load().direction).normalized();
    if (setup_.dimension == 3) {
      const Eigen::Vector3d across = direction - direction.dot(along_) * along_;
      if (!(across.norm() > 1e-6)) fail("the load is along the axis, and a chain gives way across it only");
      made_.frame = {origin_, along_, across.normalized()};
    }
    const Experiment& experiment = bench_.experiment();
    const ChannelSettings& channel = setup_.channels[question_.channel];
    if (channel.kind == nullptr || !channel.kind->is_place())
      fail(fmt::format("channel '{}' is not where something is; name one that is with --channel",
                       experiment.channels[question_.channel].id));
    Eigen::VectorXd watched;
    if (channel.foot) {
      watched = axis_of(body()).point(*channel.foot, 0, 0);
      if (!channel.standoff.empty()) watched += rotation_of(body(), setup_.dimension) * vector_of(channel.standoff);
    } else {
      watched = place_of(channel.on, channel.point);
      if (!channel.standoff.empty()) watched += vector_of(channel.standoff);
    }
    load_place_ = plane(place_of(load().on, load().point));
    watched_place_ = plane(watched);
    made_.curve.load_direction = plane_vector(direction);
    made_.curve.watched_direction = plane_vector(vector_of(channel.direction).normalized());
    if (!setup_.gravity_direction.empty())
      made_.weight = setup_.gravity * plane_vector(vector_of(setup_.gravity_direction).normalized());
    axis_origin_ = plane(origin_);
    axis_along_ = plane_vector(along_);
    turn_round_where_held();
  }

  /// The held end comes first.
  void turn_round_where_held() {
    double held = 0, count = 0;
    for (const SupportSettings& support : setup_.supports) {
      if (!support.control.empty()) continue;
      held += arc_length(plane(place_of(support.on, {})));
      ++count;
    }
    backwards_ = count > 0 && held / count > 0.5 * length_;
    if (backwards_) std::ranges::reverse(places_);
  }

  /// Coordinates in the plane of the chain.
  Eigen::Vector2d plane(const Eigen::VectorXd& x) const {
    return setup_.dimension == 2 ? Eigen::Vector2d(x) : plane_vector(x - origin_);
  }
  Eigen::Vector2d plane_vector(const Eigen::VectorXd& v) const {
    if (setup_.dimension == 2) return v;
    return {v.dot(made_.frame.along), v.dot(made_.frame.across)};
  }
  double off_plane(const Eigen::VectorXd& x) const {
    return setup_.dimension == 2 ? 0 : Eigen::Vector3d(x - origin_).dot(made_.frame.normal());
  }
  double arc_length(const Eigen::Vector2d& X) const { return (X - axis_origin_).dot(axis_along_); }
  /// The segment that a point of the rest shape is in.
  int segment_of(const Eigen::Vector2d& X) const {
    const double s = arc_length(X);
    return static_cast<int>(std::ranges::count_if(places_, [&](double at) { return backwards_ ? s < at : s > at; }));
  }

  // The retracted body

  /// The state at these controls without weight: what springs are without strain in.
  void solve() {
    if (made_.weight.norm() > 0) {
      Protocol& protocol = at_rest_.bench->protocol();
      Params p = replay_.fitted(protocol);
      p[protocol.parameters().index("g")] = 0;
      protocol.predict(p, {});
      states_ = at_rest_.bench->states();
    }
    const std::vector<double> controls = rest_controls();
    const auto found = std::ranges::find(states_.states, controls, &SolvedState::controls);
    if (found == states_.states.end() || found->u.size() == 0)
      fail("there is no equilibrium without load at these controls; choose others");
    u_ = found->u;
  }

  /// How each segment has moved from rest, by its rigid region where it has one.
  void place_segments() {
    const int d = dimension();
    std::vector<std::set<int>> nodes(places_.size() + 1), of_rigid(places_.size() + 1);
    for (int e = 0; e < mesh_->element_count(); ++e) {
      const bool rigid = mesh_->region_names[static_cast<size_t>(mesh_->region[static_cast<size_t>(e)])] == rigid_;
      for (int a = 0; a < mesh_->nodes_per_element(); ++a) {
        const int node = mesh_->element(e)[a];
        const double s = arc_length(plane(mesh_->node(node)));
        start_ = std::min(start_, s);
        end_ = std::max(end_, s);
        const auto segment = static_cast<size_t>(segment_of(plane(mesh_->node(node))));
        nodes[segment].insert(node);
        if (rigid) of_rigid[segment].insert(node);
      }
    }
    if (backwards_) std::swap(start_, end_);
    for (size_t i = 0; i < nodes.size(); ++i) {
      const std::set<int>& used = of_rigid[i].empty() ? nodes[i] : of_rigid[i];
      if (used.size() < 2)
        fail(fmt::format("{} hinges are more than the mesh resolves; ask for fewer with --hinges", places_.size()));
      std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> points;
      for (const int node : used) {
        const Eigen::VectorXd X = mesh_->node(node);
        points.emplace_back(plane(X), plane(X + u_.segment(node * d, d)));
      }
      motions_.push_back(nearest_motion(points));
      box(i, nodes[i]);
    }
    for (size_t i = 0; i < places_.size(); ++i) {
      const Eigen::Vector2d X = axis_origin_ + places_[i] * axis_along_;
      made_.chain.hinges.push_back(0.5 * (motions_[i](X) + motions_[i + 1](X)));
    }
    const auto moved = [&](const Eigen::Vector2d& X) {
      const int segment = segment_of(X);
      return HingeChain::Place{segment, motions_[static_cast<size_t>(segment)](X)};
    };
    made_.curve.load = moved(load_place_);
    made_.curve.watched = moved(watched_place_);
    for (const CableSettings& cable : setup_.cables.cables) {
      std::vector<Eigen::VectorXd> points;
      if (!cable.path.empty()) {
        for (const Eigen::VectorXd& point : own_cable(body().geometry, cable.path))
          points.push_back(placed(body(), point));
      } else {
        for (const std::vector<double>& point : cable.points) points.push_back(placed(body(), vector_of(point)));
      }
      if (points.empty()) continue;  // a row of eyelets
      ChainCable& own = made_.cables.emplace_back();
      own.id = cable.id;
      for (size_t i = 0; i < points.size(); ++i) {
        const bool fixed = (i == 0 && cable.start_fixed) || (i + 1 == points.size() && cable.end_fixed);
        own.points.push_back(fixed ? HingeChain::Place{0, plane(points[i])} : moved(plane(points[i])));
        own.off_plane.push_back(off_plane(points[i]));
      }
    }
  }

  /// The box around a segment, from hinge to hinge along the axis.
  void box(size_t i, const std::set<int>& nodes) {
    const PlaneMotion& motion = motions_.back();
    ChainSegment& segment = made_.segments.emplace_back();
    segment.angle = motion.angle + std::atan2(axis_along_.y(), axis_along_.x());
    Eigen::Vector3d low = Eigen::Vector3d::Constant(infinity), high = -low;
    for (const int node : nodes) {
      const Eigen::VectorXd X = mesh_->node(node);
      const Eigen::Vector2d beside = plane(X) - axis_origin_;
      const Eigen::Vector3d own{beside.dot(axis_along_), beside.y() * axis_along_.x() - beside.x() * axis_along_.y(),
                                off_plane(X)};
      low = low.cwiseMin(own);
      high = high.cwiseMax(own);
    }
    const double from = i == 0 ? start_ : places_[i - 1], to = i == places_.size() ? end_ : places_[i];
    low.x() = std::min(from, to);
    high.x() = std::max(from, to);
    if (setup_.dimension == 2) {
      low.z() = -0.5 * setup_.thickness;
      high.z() = 0.5 * setup_.thickness;
    } else if (setup_.share() < 1) {  // the other half is its mirror image
      for (const int c : {1, 2}) {
        if (std::abs(low[c]) < 1e-9) low[c] = -high[c];
      }
    }
    const Eigen::Vector3d middle = 0.5 * (low + high);
    const Eigen::Vector2d across(-axis_along_.y(), axis_along_.x());
    segment.box_centre = motion(axis_origin_ + middle.x() * axis_along_ + middle.y() * across);
    segment.half = 0.5 * (high - low);
  }

  /// A piece of an element's mass.
  struct Lump {
    double mass = 0, off = 0;  ///< [kg]; off the plane [m]
    Eigen::Vector2d at{0, 0};  ///< at rest in the plane [m]
    size_t segment = 0;
  };

  /// The mass of each simplex in equal lumps between its centroid and its vertices, where they have its own second
  /// moments: at the fraction 1 / sqrt(d + 2) of the way.
  std::vector<Lump> lumps() {
    const std::vector<double> measures = element_measures(*mesh_);
    std::map<int, double> densities;
    for (size_t region = 0; region < mesh_->region_names.size(); ++region) {
      const auto material = std::ranges::find(setup_.materials, mesh_->region_names[region], &MaterialSettings::region);
      const bool known = material != setup_.materials.end() && material->density;
      densities[static_cast<int>(region)] = known ? *material->density : assumed_density;
      if (!known) made_.assumed.push_back(mesh_->region_names[region]);
    }
    const int d = dimension();
    const double times = (d == 2 ? setup_.thickness : 1) / setup_.share() / (d + 1);
    std::vector<Lump> all;
    for (int e = 0; e < mesh_->element_count(); ++e) {
      const Eigen::VectorXd centroid = mesh_->centroid(e);
      const auto element = static_cast<size_t>(e);
      for (int a = 0; a <= d; ++a) {
        const Eigen::VectorXd X = centroid + (mesh_->node(mesh_->element(e)[a]) - centroid) / std::sqrt(d + 2.0);
        Lump& lump = all.emplace_back();
        lump.mass = times * measures[element] * densities[mesh_->region[element]];
        lump.off = off_plane(X);
        lump.at = plane(X);
        lump.segment = static_cast<size_t>(segment_of(lump.at));
      }
    }
    return all;
  }

  void find_masses() {
    const std::vector<Lump> all = lumps();
    std::vector<Eigen::Vector2d> centres(made_.segments.size(), Eigen::Vector2d::Zero());
    for (const Lump& lump : all) {
      made_.segments[lump.segment].mass += lump.mass;
      centres[lump.segment] += lump.mass * lump.at;
    }
    for (size_t i = 0; i < centres.size(); ++i) {
      if (!(made_.segments[i].mass > 0))
        fail(fmt::format("{} hinges are more than the mesh resolves; ask for fewer with --hinges", places_.size()));
      centres[i] /= made_.segments[i].mass;
      made_.segments[i].centre = motions_[i](centres[i]);
    }
    const Eigen::Vector2d across(-axis_along_.y(), axis_along_.x());
    for (const Lump& lump : all) {
      const Eigen::Vector2d from = lump.at - centres[lump.segment];
      const double a = std::pow(from.dot(axis_along_), 2), b = std::pow(from.dot(across), 2);
      const double n = setup_.dimension == 2 ? setup_.thickness * setup_.thickness / 12 : lump.off * lump.off;
      made_.segments[lump.segment].inertia += lump.mass * Eigen::Vector3d(b + n, a + n, a + b);
    }
  }

  // The stiffness of its hinges

  void follow() {
    std::vector<std::vector<double>> rows{rest_controls()};
    for (int i = 1; i <= chain_loads; ++i) {
      rows.push_back(question_.controls);
      rows.back()[replay_.load()] = question_.largest * i / chain_loads;
    }
    const std::vector<TunedState> states = replay_.at(rows);
    const auto reading = [&](const TunedState& state) { return state.readings[question_.channel]; };
    for (size_t i = 1; i < states.size(); ++i) {
      made_.curve.forces.push_back(bench_.as_force(replay_.load(), rows[i][replay_.load()]));
      made_.curve.displacements.push_back(reading(states[i]) - reading(states[0]));
      made_.slipped |= states[i].slipped;
    }
    made_.controls = rows.back();
    std::vector<std::string> held;
    for (size_t k = 0; k < made_.controls.size(); ++k) {
      if (k != replay_.load()) held.push_back(bench_.describe_control(k, made_.controls[k]));
    }
    made_.held = held.empty() ? "nothing is held" : join(held);
    if (made_.weight.norm() > 0) {
      for (size_t i = 1; i < made_.segments.size(); ++i)
        made_.curve.always.push_back(
            {{static_cast<int>(i), made_.segments[i].centre}, made_.segments[i].mass * made_.weight});
    }
    try {
      made_.fit = fit_hinges(made_.chain, made_.curve);
    } catch (const InputError& error) {
      fail(error.what());
    }
    find_modes();
    made_.damping = 2 * assumed_damping * made_.fit.stiffness / made_.lowest;
  }

  /// Of the chain without loads.
  void find_modes() {
    const int n = made_.chain.size();
    Eigen::MatrixXd mass = Eigen::MatrixXd::Zero(n, n), stiffness = mass;
    for (int j = 0; j < n; ++j) {
      const ChainSegment& segment = made_.segments[static_cast<size_t>(j) + 1];
      std::vector<Eigen::Vector2d> arms;
      for (int i = 0; i <= j; ++i) {
        const Eigen::Vector2d& from = made_.chain.hinges[static_cast<size_t>(i)];
        arms.push_back((i < j ? made_.chain.hinges[static_cast<size_t>(i) + 1] : segment.centre) - from);
      }
      for (int a = 0; a <= j; ++a) {
        for (int b = 0; b <= j; ++b)
          mass(a, b) += segment.mass * arms[static_cast<size_t>(a)].dot(arms[static_cast<size_t>(b)]);
      }
      mass(j, j) += segment.inertia.z();
      stiffness(j, j) += made_.fit.stiffness;
      if (j == 0) continue;
      stiffness(j - 1, j - 1) += made_.fit.stiffness;
      stiffness(j, j - 1) -= made_.fit.stiffness;
      stiffness(j - 1, j) -= made_.fit.stiffness;
    }
    const SymmetricModes of_mass = symmetric_modes(mass);
    const Eigen::MatrixXd scaled = of_mass.vectors * of_mass.values.cwiseSqrt().cwiseInverse().asDiagonal();
    const Eigen::VectorXd squares = symmetric_modes(scaled.transpose() * stiffness * scaled).values;
    made_.lowest = std::sqrt(squares[0]);
    made_.highest = std::sqrt(squares[n - 1]);
  }

  const StiffnessReplay& replay_;
  const ModuleChainQuestion& question_;
  const Bench& bench_;
  Setup setup_;
  std::string rigid_;               ///< region that moves as one within a segment; "": all of it
  Eigen::VectorXd origin_, along_;  ///< of the axis at rest, in the model's coordinates
  Eigen::Vector2d axis_origin_{0, 0}, axis_along_{1, 0}, load_place_{0, 0}, watched_place_{0, 0};  ///< in the plane
  double length_ = 0;
  double start_ = 0, end_ = 0;  ///< arc lengths of the held and of the other end of all that is meshed
  bool backwards_ = false;
  std::vector<double> places_;  ///< arc lengths of the hinges, from the held end on
  StiffnessReplay::Solved at_rest_;
  SolvedStates states_;
  const Mesh* mesh_ = nullptr;
  Eigen::VectorXd u_;
  std::vector<PlaneMotion> motions_;
  ModuleChain made_;
};

}  // namespace

ModuleChain module_chain(const StiffnessReplay& replay, const ModuleChainQuestion& question) {
  return ChainMaker(replay, question).made();
}

}  // namespace taut
