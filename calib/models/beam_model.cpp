#include "calib/models/beam_model.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <optional>

#include "calib/models/beam_chain.hpp"
#include "sim/core/dense.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/units.hpp"
#include "sim/mesh/weights.hpp"

namespace taut {

BeamProtocol::BeamProtocol(std::unique_ptr<const Chain> chain)
    : chain_(std::move(chain)), errors_(chain_->rows.size(), not_a_number) {}
BeamProtocol::~BeamProtocol() = default;
const ParameterTable& BeamProtocol::parameters() const {
  return chain_->table;
}
const Params& BeamProtocol::nominal() const {
  return chain_->nominal;
}
int BeamProtocol::row_count() const {
  return static_cast<int>(chain_->rows.size());
}
int BeamProtocol::unknowns() const {
  return 3 * chain_->bodies;
}

namespace {

using Controls = std::vector<double>;

/// An equilibrium of the chain.
struct State {
  std::string problem;  ///< why it was not reached; "": it was
  Eigen::VectorXd x;
  Eigen::MatrixXd dx;  ///< sensitivities
  Params p;
};

Params with_controls(const BeamProtocol::Chain& chain, Params p, const Controls& controls) {
  for (size_t k = 0; k < controls.size(); ++k) p[chain.controls[k]] = controls[k];
  return p;
}

/// Nothing acts yet.
Params at_rest(const BeamProtocol::Chain& chain, Params p) {
  for (int index : chain.controls) p[index] = 0;
  for (int index : chain.off_at_rest) p[index] = 0;
  return p;
}

/// What stands after a row's retractions, before its loads.
Controls before_loads(const BeamProtocol::Chain& chain, Controls controls) {
  for (size_t k = 0; k < controls.size(); ++k) {
    if (std::ranges::count(chain.set_first, static_cast<int>(k)) == 0) controls[k] = 0;
  }
  return controls;
}

/// Rows by their controls, from small to large.
using Path = std::map<std::pair<double, Controls>, std::vector<size_t>>;

/// Rows by their retractions, then by their loads.
std::map<Controls, Path> paths_of(const BeamProtocol::Chain& chain) {
  std::map<Controls, Path> paths;
  for (size_t r = 0; r < chain.rows.size(); ++r) {
    const Controls& controls = chain.rows[r].controls;
    double size = 0;
    for (double value : controls) size += std::abs(value);
    paths[before_loads(chain, controls)][{size, controls}].push_back(r);
  }
  return paths;
}

State reached(const BeamProtocol::Chain& chain, State state, const Params& target, const std::vector<int>& free,
              int& factorisations) {
  if (!state.problem.empty()) return state;
  state.problem = chain.solve_in_steps(state.x, state.p, target, factorisations);
  state.p = target;
  if (state.problem.empty() && !free.empty()) {
    const ChainEnergy sum = chain.assemble(state.x, target, free);
    ++factorisations;
    const std::optional<Eigen::MatrixXd> slopes = solve_positive_definite(sum.hessian, sum.mixed);
    if (slopes)
      state.dx = -*slopes;
    else
      state.problem = "the equilibrium is not stable";
  }
  return state;
}

/// The reading of a channel and its derivatives.
std::pair<double, Eigen::RowVectorXd> read(const BeamProtocol::Chain& chain, const State& state, int channel) {
  const auto [value, slope] = chain.read(static_cast<size_t>(channel), state.x);
  const int body = chain.channels[static_cast<size_t>(channel)].at.body;
  if (state.dx.size() == 0) return {value, {}};
  return {value, slope * state.dx.middleRows(3 * body, 3)};
}

/// Fills a row of a prediction, and returns the error that the model states for it.
double set_row(const BeamProtocol::Chain& chain, size_t r, const State& state, const State& unloaded,
               const std::vector<int>& free, Prediction& prediction) {
  const StaticRow& row = chain.rows[r];
  const Eigen::Index to = static_cast<Eigen::Index>(r);
  auto [value, slopes] = read(chain, state, row.channel);
  double error = chain.stated_error(state.x, state.p);
  if (chain.from_unloaded) {
    error = std::max(error, chain.stated_error(unloaded.x, unloaded.p));
    const auto [value_before, slopes_before] = read(chain, unloaded, row.channel);
    value -= value_before;
    slopes -= slopes_before;
  }
  if (row.offset >= 0) value += state.p[row.offset];
  prediction.values[to] = value;
  if (!free.empty()) prediction.derivatives.row(to) = slopes;
  for (size_t c = 0; c < free.size(); ++c) {
    if (free[c] == row.offset) prediction.derivatives(to, static_cast<Eigen::Index>(c)) += 1;
  }
  return error;
}

/// "mass = 50 g, retraction = 5 mm".
std::string described(const BeamProtocol::Chain& chain, const Controls& controls) {
  std::vector<std::string> texts;
  for (size_t k = 0; k < controls.size(); ++k) {
    const ParameterSpec& spec = chain.table[chain.controls[k]];
    texts.push_back(fmt::format("{} = {}", spec.id, with_unit(controls[k], spec.unit)));
  }
  return join(texts);
}

}  // namespace

Prediction BeamProtocol::predict(const Params& p, const std::vector<int>& free) {
  const Chain& chain = *chain_;
  const Eigen::Index columns = static_cast<Eigen::Index>(free.size());
  Prediction prediction;
  prediction.values = Eigen::VectorXd::Constant(row_count(), not_a_number);
  if (columns > 0) prediction.derivatives = Eigen::MatrixXd::Constant(row_count(), columns, not_a_number);
  std::fill(errors_.begin(), errors_.end(), not_a_number);
  // Retractions and what always acts first, each from rest; then loads from small to large, each from the last one's
  // equilibrium.
  for (const auto& [first, loaded] : paths_of(chain)) {
    const State rest{"", Eigen::VectorXd::Zero(unknowns()), {}, at_rest(chain, p)};
    const State unloaded = reached(chain, rest, with_controls(chain, p, first), free, factorisations_);
    State state = unloaded;
    for (const auto& [key, rows] : loaded) {
      state = reached(chain, state, with_controls(chain, p, key.second), free, factorisations_);
      if (state.problem.empty()) {
        for (size_t r : rows) errors_[r] = set_row(chain, r, state, unloaded, free, prediction);
      } else {
        prediction.failures.push_back(
            fmt::format("no equilibrium of the beams at {}: {}", described(chain, key.second), state.problem));
      }
    }
  }
  return prediction;
}

namespace {

constexpr const char* remedy = "; model = \"full\" takes the rest";

[[noreturn]] void refuse(const Experiment& experiment, const std::string& part, const std::string& what) {
  throw InputError(experiment.path + ": " + part + ": " + what + remedy);
}

/// The ways in which the experiment's body is a chain of beams; at least one.
std::vector<Spine> spines_of(const Experiment& experiment) {
  std::vector<Spine> spines;
  try {
    spines = experiment.geometry.shape->spines();
  } catch (const InputError& error) {
    refuse(experiment, "[geometry]", error.what());
  }
  if (spines.empty()) {
    refuse(experiment, "[geometry]",
           fmt::format("a chain of beams is made from a push_puppet or a rectangle, not from '{}'",
                       experiment.geometry.kind()));
  }
  return spines;
}

/// Everything that no chain of beams has, however it is clamped.
void check(const Experiment& experiment, const Spine& spine) {
  if (!experiment.kind->at_rest)
    refuse(experiment, "[bench]", "a chain of beams has no inertia and takes readings at rest");
  for (const MaterialSettings& material : experiment.materials) {
    if (material.region == spine.soft && material.law != "neo_hookean") {
      refuse(experiment, fmt::format("[materials.{}]", spine.soft),
             fmt::format("the fibres of a chain of beams are neo_hookean, not {}", material.law));
    }
  }
  if (!experiment.contact.obstacles.empty() || !experiment.contact.grounds.empty())
    refuse(experiment, "[contact]", "a chain of beams meets no obstacles or grounds");
  if (!spine.lips && experiment.contact.on)
    refuse(experiment, "[contact]", "a beam does not touch itself; leave [contact] out");
  if (spine.stiff.empty() && !experiment.cables.cables.empty())
    refuse(experiment, "[cables]", "only a push_puppet's chain of beams has cables");
  const auto unlike = [](const CableSettings& cable) { return cable.held || cable.own || cable.line; };
  if (std::ranges::any_of(experiment.cables.cables, unlike))
    refuse(experiment, "[cables]", "the cables of a chain of beams share one law and are retracted");
  if (!experiment.base_at.empty() || !experiment.base_turn.empty())
    refuse(experiment, "[base]", "a chain of beams stands as its geometry does");
}

/// The one whose end is clamped.
Spine clamped_spine(const Experiment& experiment, const std::vector<Spine>& spines) {
  if (experiment.supports.empty()) refuse(experiment, "[[support]]", "a chain of beams is clamped at one end");
  const SupportSettings& support = experiment.supports.front();
  const auto found = std::ranges::find(spines, support.on, &Spine::clamped);
  std::vector<int> fixed = support.fix;
  std::ranges::sort(fixed);
  const bool clamped = support.rotation_stiffness ? fixed.empty() : fixed == std::vector<int>{0, 1};
  if (experiment.supports.size() != 1 || found == spines.end() || !clamped || !support.control.empty()) {
    std::vector<std::string> ends;
    for (const Spine& spine : spines) ends.push_back(spine.clamped);
    refuse(experiment, "[[support]]",
           fmt::format("a chain of beams has one support, {}, with fix = [\"x\", \"y\"] or a rotation_stiffness",
                       ends.size() == 1 ? "'" + ends[0] + "'" : "one of " + join(ends)));
  }
  return *found;
}

/// The chain lies along x, from x = 0: where it starts in the experiment's frame, and which way it goes.
struct ChainFrame {
  Eigen::Vector2d origin, along;
  Eigen::Vector2d direction(const Eigen::Vector2d& v) const {
    return {along.dot(v), along.x() * v.y() - along.y() * v.x()};
  }
  Eigen::Vector2d point(const Eigen::Vector2d& v) const { return direction(v - origin); }
};

/// The face of an elastic clamp is a body of its own, before all others. Its translation is as stiff as the full
/// model's.
void build_base(BeamProtocol::Chain& chain) {
  chain.k_base = chain.index("k_base");
  if (chain.k_base < 0) return;
  const double stiffest = chain.nominal[chain.E_plastic < 0 ? chain.E : chain.E_plastic];
  chain.base = 100 * stiffest * chain.nominal[chain.thickness];
  chain.bodies = 1;
}

/// Bodies without thickness, the last one the loaded face: six, and more in a slender beam, whose ends turn far. A span
/// that is bent by k is shorter by k^2/24, which it does not know. A face that an elastic clamp holds may bulge.
void build_beam(const Spine::Span& span, BeamProtocol::Chain& chain) {
  const int first = chain.bodies, count = span.length > 20 * span.height ? 24 : 6;
  if (first > 0) chain.centres.push_back({0, 0});
  chain.bodies += count;
  for (int i = 0; i < count; ++i) {
    const Eigen::Vector2d left(i * span.length / count, 0), right((i + 1) * span.length / count, 0);
    chain.centres.push_back(right);
    chain.spans.push_back(
        {{first + i - 1, left}, {first + i, right}, span.length / count, span.height, i == 0 && first == 0 ? 1 : 0});
  }
}

/// The cable of a chain with stiff pieces, the second of which is body `first`: it has to be one of the body's own.
ChainCable chain_cable(const Experiment& experiment, const CableSettings& settings, const Cable& model, int spans,
                       int first) {
  const auto point = [&](int k) {
    const std::vector<double>& at = settings.points[static_cast<size_t>(k)];
    return Eigen::Vector2d(at[0], at[1]);
  };
  const std::vector<std::string> names = experiment.geometry.shape->cable_names();
  bool own = false;
  for (size_t k = 0; k < names.size(); ++k) {
    const std::vector<Eigen::VectorXd> path = experiment.geometry.shape->cable(k);
    own = own || std::equal(path.begin(), path.end(), settings.points.begin(), settings.points.end(),
                            [](const Eigen::VectorXd& a, const std::vector<double>& b) {
                              return (a - Eigen::Vector2d(b[0], b[1])).norm() < 1e-9;
                            });
  }
  if (!own) {
    refuse(experiment, fmt::format("cable '{}'", settings.id),
           "a chain of beams has the module's own cables, 'upper' and 'lower' without points of their own");
  }
  ChainCable cable;
  cable.retraction = model.retraction;
  cable.smoothing = model.smoothing;
  if (first > 0 && model.points.front().material.nodes.empty())  // the clamp gives way and the cable's anchor does not
    cable.free_lengths.push_back({BodyPoint{-1, point(0)}, BodyPoint{0, point(1)}});
  for (int i = 0; i < spans; ++i)
    cable.free_lengths.push_back({BodyPoint{first + i - 1, point(2 * i + 1)}, BodyPoint{first + i, point(2 * i + 2)}});
  return cable;
}

/// Webs and tip plate; the base plate is fixed, or the first body on an elastic clamp.
void build_module(const Experiment& experiment, const Spine& spine, const BenchModel& model,
                  BeamProtocol::Chain& chain) {
  const int first = chain.bodies, count = static_cast<int>(spine.spans.size());
  const Mesh& mesh = model.scene.model->mesh();
  if (first > 0) chain.centres.push_back({mesh.node(mesh.select(spine.clamped).nodes().front()).x(), 0});
  chain.bodies += count;
  for (int i = 0; i < count; ++i) {
    const auto& [left, length, height] = spine.spans[static_cast<size_t>(i)];
    const double right = left + length;
    const int one = first + i - 1, other = first + i;
    chain.centres.push_back({i + 1 == count ? spine.end : right, 0});
    chain.spans.push_back({{one, {left, 0}}, {other, {right, 0}}, length, height, 2});
    if (!spine.lips || !experiment.contact.on) continue;
    for (int side : {1, -1}) {
      for (double y : {spine.lips->inner, spine.lips->outer}) {
        const BodyPoint corner{one, {left + spine.lips->length, side * y}};
        chain.lips.push_back({i, side, corner, {other, {right - spine.lips->length, side * y}}});
      }
    }
  }
  // Two lips in a row as bars, with two corners each.
  if (spine.lips) chain.lip_shape = 0.5 * spine.lips->thickness / (2 * spine.lips->length);
  for (size_t c = 0; c < model.cables.size(); ++c)
    chain.cables.push_back(chain_cable(experiment, experiment.cables.cables[c], model.cables[c], count, first));
}

/// Own weight, of density times gravity times thickness on an area.
class Weights {
 public:
  Weights(const Experiment& experiment, const Spine& spine, BeamProtocol::Chain& chain) : spine_(spine), chain_(chain) {
    const std::vector<double>& down = experiment.gravity_direction;
    down_ = ChainFrame{spine.origin, spine.along}.direction(Eigen::Vector2d(down[0], down[1]).normalized());
  }

  /// Of a beam. The area under a span's bent axis is that under its chord and L^2/12 times the difference of the ends'
  /// slopes: as if halves of its weight sat a sixth of its length from its ends and moved with these.
  void add_spans() {
    for (const ChainSpan& span : chain_.spans) {
      const Eigen::Vector2d inwards(span.length / 6, 0);
      const double half = 0.5 * span.length * span.height;
      add(spine_.soft, {span.left.body, span.left.rest + inwards}, half);
      add(spine_.soft, {span.right.body, span.right.rest - inwards}, half);
    }
  }

  /// Of a module: stiff pieces turn with their bodies, soft elements are carried by both neighbours.
  void add_elements(const Mesh& mesh) {
    const std::vector<double> areas = element_measures(mesh);
    for (int e = 0; e < mesh.element_count(); ++e) {
      Eigen::Vector2d middle = Eigen::Vector2d::Zero();
      const int corners = mesh.dimension() + 1;  // of a triangle
      for (int a = 0; a < corners; ++a) middle += mesh.node(mesh.element(e)[a]) / corners;
      const std::string& region = mesh.region_names[static_cast<size_t>(mesh.region[static_cast<size_t>(e)])];
      size_t span = 0;
      while (span + 1 < chain_.spans.size() && middle.x() > chain_.spans[span + 1].left.rest.x()) ++span;
      const ChainSpan& at = chain_.spans[span];
      const double along = std::clamp((middle.x() - at.left.rest.x()) / at.length, 0.0, 1.0);
      const double right = region == spine_.soft ? along : std::round(along), area = areas[static_cast<size_t>(e)];
      gather(region, at.left.body, middle, (1 - right) * area);
      gather(region, at.right.body, middle, right * area);
    }
    for (const auto& [piece, moment] : pieces_)
      add(piece.first, {piece.second, moment.head<2>() / moment[2]}, moment[2]);
  }

 private:
  void gather(const std::string& region, int body, const Eigen::Vector2d& middle, double area) {
    if (area == 0) return;
    Eigen::Vector3d& moment = pieces_.try_emplace({region, body}, Eigen::Vector3d::Zero()).first->second;
    moment += area * Eigen::Vector3d(middle.x(), middle.y(), 1);
  }
  void add(const std::string& region, const BodyPoint& at, double area) {
    const int density = chain_.index("density_" + region);
    if (density < 0 || at.body < 0) return;
    chain_.loads.push_back({at, down_, {density, chain_.index("g"), chain_.thickness}, area});
  }

  const Spine& spine_;
  BeamProtocol::Chain& chain_;
  Eigen::Vector2d down_;
  std::map<std::pair<std::string, int>, Eigen::Vector3d> pieces_;  ///< region and body: first moments and area
};

/// Where a load or a channel sits: the middle of the loaded face, or one of the face's points.
BodyPoint seat(const Experiment& experiment, const std::string& part, const std::string& on,
               const std::vector<double>& point, const std::string& face, const ChainFrame& frame,
               const BeamProtocol::Chain& chain) {
  const BodyPoint middle{chain.bodies - 1, chain.centres.back()};
  if (on == face) return middle;
  if (on.empty()) {
    const BodyPoint at{middle.body, frame.point({point[0], point[1]})};
    const Eigen::Vector2d off = at.rest - middle.rest;
    if (std::abs(off.x()) < 1e-9 && std::abs(off.y()) <= 0.5 * chain.spans.back().height + 1e-9) return at;
  }
  refuse(experiment, part, fmt::format("on a chain of beams it stands on '{}' or at a point of that face", face));
}

/// Loads and channels at the end of the chain.
void add_loads_and_channels(const Experiment& experiment, const Spine& spine, BeamProtocol::Chain& chain) {
  const ChainFrame frame{spine.origin, spine.along};
  const auto along = [&](const std::vector<double>& direction) {
    return frame.direction(Eigen::Vector2d(direction[0], direction[1]).normalized());
  };
  for (const LoadSettings& load : experiment.loads) {
    const std::string part = fmt::format("[[load]] '{}'", load.id);
    if (load.quantity != Quantity::force && load.quantity != Quantity::mass)
      refuse(experiment, part, "a chain of beams carries forces and hung masses");
    std::vector<int> factors{chain.index(load.id)};
    if (load.quantity == Quantity::mass) factors.push_back(chain.index("g"));
    chain.loads.push_back(
        {seat(experiment, part, load.on, load.point, spine.loaded, frame, chain), along(load.direction), factors, 1});
  }
  for (const ChannelSettings& channel : experiment.channels) {
    const std::string part = fmt::format("[[channel]] '{}'", channel.id);
    if (channel.kind->name != "displacement")
      refuse(experiment, part,
             fmt::format("a chain of beams shows displacements, and this is a {}", channel.kind->name));
    if (!channel.standoff.empty()) refuse(experiment, part, "a chain of beams carries no markers");
    chain.channels.push_back(
        {seat(experiment, part, channel.on, channel.point, spine.loaded, frame, chain), along(channel.direction)});
  }
}

}  // namespace

BeamBench make_beam_bench(const Experiment& experiment, const Trials& trials) {
  const std::vector<Spine> spines = spines_of(experiment);
  check(experiment, spines.front());
  const Spine spine = clamped_spine(experiment, spines);
  // Parameters, controls and offsets are those of the full model, on the coarsest mesh that has them all.
  Experiment full = experiment;
  full.model = Rung::full;
  MeshSettings coarse;
  coarse.order = 1;
  coarse.cells = {1, 1};
  coarse.size = spine.spans.front().length;
  BenchModel model = make_model(full, coarse, trials);

  auto chain = std::make_unique<BeamProtocol::Chain>();
  chain->table = model.scene.model->parameters();
  chain->nominal = model.scene.values;
  BenchRows rows = rows_of_readings(experiment, model, trials);
  chain->rows = std::move(rows.rows);
  chain->controls = model.controls;
  chain->off_at_rest = model.off_at_rest;
  chain->from_unloaded = experiment.from_unloaded;
  for (size_t k = 0; k < experiment.bench.controls.size(); ++k) {
    if (experiment.cables.columns.count(experiment.bench.controls[k].id) > 0)
      chain->set_first.push_back(static_cast<int>(k));
  }
  chain->E = chain->index("E_" + spine.soft);
  chain->nu = chain->index("nu_" + spine.soft);
  chain->thickness = chain->index("thickness");
  chain->E_plastic = chain->index("E_" + spine.stiff);
  chain->k_cable = chain->index("k_cable");
  chain->slack = chain->index("slack");
  chain->plane_stress = experiment.geometry.plane == Plane::stress;
  build_base(*chain);
  if (spine.stiff.empty()) {
    build_beam(spine.spans.front(), *chain);
  } else {
    build_module(experiment, spine, model, *chain);
  }
  if (!experiment.gravity_direction.empty()) {
    Weights weights(experiment, spine, *chain);
    spine.stiff.empty() ? weights.add_spans() : weights.add_elements(model.scene.model->mesh());
  }
  add_loads_and_channels(experiment, spine, *chain);
  return {std::make_unique<BeamProtocol>(std::move(chain)), std::move(rows.row_of_reading),
          std::move(rows.measurements)};
}

std::vector<FreeParameter> start_by_beams(const Experiment& experiment, const Trials& trials,
                                          std::vector<FreeParameter> free) {
  if (experiment.mesh.depth_cells > 0) return free;  // a solid's parameters are other ones
  try {
    const BeamBench bench = make_beam_bench(experiment, trials);
    Params p = bench.protocol->nominal();
    for (const FreeParameter& parameter : free) p[parameter.index] = parameter.start;
    const Prediction prediction = bench.protocol->predict(p, {});
    std::vector<Measurement> measurements;
    for (Measurement m : bench.measurements) {
      const double error = bench.protocol->stated_error(m.row);
      if (!std::isfinite(error)) continue;
      m.sigma = std::hypot(m.sigma, error * prediction.values[m.row]);
      measurements.push_back(m);
    }
    if (measurements.size() < free.size()) return free;
    FitOptions options;
    options.profiles = options.recover = false;
    options.tolerance = 1e-3;
    options.stop = experiment.equilibrium.stop;
    const FitResult rough = fit(*bench.protocol, measurements, free, options);
    for (size_t j = 0; j < free.size() && rough.status == FitStatus::converged; ++j) {
      const ParameterEstimate& estimate = rough.parameters[j];
      if (estimate.verdict == Verdict::well_determined || estimate.verdict == Verdict::weakly_determined)
        free[j].start = estimate.value;
    }
  } catch (const InputError&) {  // not a case for beams
  }
  return free;
}

}  // namespace taut
