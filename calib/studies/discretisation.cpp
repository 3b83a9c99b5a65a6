#include "calib/studies/discretisation.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>

#include "calib/benches/bench.hpp"
#include "calib/benches/model.hpp"
#include "calib/benches/specimens.hpp"
#include "calib/fit/goodness_of_fit.hpp"
#include "sim/core/dense.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/stopwatch.hpp"
#include "sim/core/units.hpp"
#include "sim/shapes/geometry.hpp"

namespace taut {
namespace {

/// Quadratic elements would converge with order 4 where all is smooth. Beside a clamped corner it is 1.4 to 1.7, and a
/// higher one that coarse meshes show is not to be trusted.
constexpr double trusted_order = 2;
constexpr double lowest_order = 0.5;  ///< slower than beside any corner: no convergence to speak of

/// A mesh to extrapolate from.
struct Level {
  MeshSettings settings;
  double h = 0;      ///< element size, of the specimen's size
  bool own = false;  ///< the fit's mesh, with its elements: its shift is zero
  bool finer = false;
};

/// The finest three that are not too dear, from coarse to fine. Fewer where the mesh cannot be refined or coarsened.
std::vector<Level> levels_of(const Experiment& experiment) {
  const MeshSettings best = most_accurate(experiment, experiment.mesh);
  const bool member = best.order == experiment.mesh.order && best.formulation == experiment.mesh.formulation;
  const Mesh own = make_mesh(experiment, experiment.mesh);
  const double r = own.dimension() == 2 ? 2 : 1.45, most = own.dimension() == 2 ? 150e3 : 40e3;
  std::map<int, Level> found;  // by k, sizes r^-k
  for (int k : {0, 1, -1, -2, 2}) {
    if (found.size() == 3) break;
    Level level{refined(best, experiment.geometry, std::pow(r, k)), element_size(own), k == 0 && member, k > 0};
    try {
      const Mesh mesh = level.own ? own : make_mesh(experiment, level.settings);
      level.h = element_size(mesh);
      if (!level.own && static_cast<double>(mesh.X.size()) > most) continue;
    } catch (const InputError&) {  // too coarse for its geometry
      continue;
    }
    const bool distinct = std::ranges::all_of(
        found, [&](const auto& other) { return std::abs(std::log(other.second.h / level.h)) > std::log(1.15); });
    if (distinct) found.emplace(k, level);
  }
  std::vector<Level> levels;
  for (const auto& [k, level] : found) levels.push_back(level);
  return levels;
}

struct Shift {
  Eigen::VectorXd step;  ///< fitted scale
  std::string failure;   ///< "": none
};

/// A fit and what it was made with.
struct Fitted {
  const Experiment& experiment;
  const Trials& trials;
  const FitResult& fit;
  const std::function<void(const std::string&)>& progress;
  const Ask& ask;

  /// Where the fit would end with another mesh. `what` is told before that is computed.
  Shift shift_with(const MeshSettings& settings, const std::string& what) const {
    Experiment with = experiment;
    with.mesh = settings;
    return shift_with(with, what);
  }

  /// The same with another model.
  Shift shift_with(const Experiment& with, const std::string& what) const {
    if (progress) progress(what);
    const DimensionedModel model = full_model(with, trials, free_dimensions(with));
    if (!model.left_out.empty()) return {{}, model.left_out.front()};
    Protocol& protocol = *model.protocol;
    const ParameterTable& table = protocol.parameters();
    const std::vector<FreeParameter> free = free_beyond_bounds(fit, table);
    Params p = protocol.nominal();  // by ids: a solid has no thickness among its parameters
    for (const FreeParameter& parameter : free) p[parameter.index] = parameter.start;
    const Prediction prediction = ask ? ask(protocol, p, indices_of(free)) : protocol.predict(p, indices_of(free));
    if (!prediction.complete()) return {{}, prediction.failures.front()};
    return {gauss_newton_step(prediction, model.measurements, table, p, free), ""};
  }

  Share mesh_share(const Shift& own) const {
    const std::vector<Level> levels = levels_of(experiment);
    const Eigen::VectorXd sd = fit.covariance.diagonal().cwiseSqrt();
    Eigen::MatrixXd steps = Eigen::MatrixXd::Zero(sd.size(), static_cast<Eigen::Index>(levels.size()));
    std::vector<double> h;
    std::vector<std::string> names;
    for (const Level& level : levels) {
      const Eigen::Index k = static_cast<Eigen::Index>(h.size());
      h.push_back(level.h);
      names.push_back(level.settings.describe());
      if (level.own) continue;
      const Shift shift = shift_with(level.settings, "the mesh's share: " + names.back());
      if (!shift.failure.empty()) return unknown(names.back() + ": " + shift.failure);
      steps.col(k) = (shift.step - own.step).cwiseQuotient(sd);
    }
    if (levels.size() < 2 && (levels.empty() || levels.front().own))
      return unknown("the mesh can be neither refined nor coarsened");
    const Extrapolation limit = extrapolate(h, steps, trusted_order);
    std::string how = "one Gauss-Newton step at the optimum with " + join(names, "; ");
    if (levels.size() == 1)
      how += "; there is no other mesh to tell how far that is from the limit";
    else if (limit.measured)
      how += fmt::format("; extrapolated with the order {:.2g} that they show", limit.order);
    else
      how += levels.size() == 2 ? "; extrapolated with order 1" : "; they do not converge evenly: the finest counts";
    if (std::ranges::none_of(levels, &Level::finer)) how += "; finer ones than the fit's own would take too long";
    // One finer mesh alone: what is left may be as much again.
    const Eigen::VectorXd error = levels.size() == 1 ? limit.limit.cwiseAbs() : limit.error;
    return known(limit.limit.cwiseProduct(sd), error.cwiseProduct(sd), how);
  }

  Share gap_share(const Shift& own) const {
    MeshSettings half = experiment.mesh;
    half.contact_gap = 0.5 * contact_gap(experiment.mesh, make_mesh(experiment, experiment.mesh).diagonal());
    const Shift shift = shift_with(half, "the contact gap's share");
    if (!shift.failure.empty()) return unknown("half the gap: " + shift.failure);
    const Eigen::VectorXd step = shift.step - own.step;
    return known(
        2 * step, step.cwiseAbs(),
        fmt::format("one Gauss-Newton step at the optimum with half the gap, {}; extrapolated linearly to none",
                    with_unit(half.contact_gap, "m")));
  }

  /// What a plane section leaves out: a body's faces bulge freely and its middle does not, supports hold it across its
  /// thickness too, and loads may act at points.
  Share section_share() const {
    std::optional<MeshSettings> coarse;
    MeshSettings solid;
    for (double factor : {1.0, 0.7, 0.5, 0.35, 0.25}) {
      const MeshSettings plane = refined(experiment.mesh, experiment.geometry, factor);
      solid = deepened(experiment, plane);
      if (make_mesh(experiment, solid).X.size() > 16000 && factor > 0.25) continue;
      coarse = plane;
      break;
    }
    const Shift flat = shift_with(*coarse, "the plane section's share: " + coarse->describe());
    if (!flat.failure.empty()) return unknown(coarse->describe() + ": " + flat.failure);
    const Shift deep = shift_with(solid, "the plane section's share: " + solid.describe());
    if (!deep.failure.empty()) return unknown(solid.describe() + ": " + deep.failure);
    const Eigen::VectorXd step = deep.step - flat.step;
    return known(step, step.cwiseAbs() / 3,
                 fmt::format("one Gauss-Newton step at the optimum with a solid ({}) against the same section",
                             solid.describe()));
  }

  /// What stiff regions that do not deform leave out.
  Share rigid_share(const Shift& own) const {
    Experiment full = experiment;
    full.model = Rung::full;
    const Shift shift = shift_with(full, "the share of rigid segments");
    if (!shift.failure.empty()) return unknown("segments that deform: " + shift.failure);
    const Eigen::VectorXd step = shift.step - own.step;
    return known(step, step.cwiseAbs() / 3, "one Gauss-Newton step at the optimum with segments that deform");
  }

  /// A share from where the fit would end in the limit and the error of that, on the fitted scale.
  Share known(const Eigen::VectorXd& limit, const Eigen::VectorXd& error, const std::string& how) const {
    Share share;
    for (size_t j = 0; j < fit.parameters.size(); ++j) {
      const ParameterEstimate& e = fit.parameters[j];
      const double shift = limit[static_cast<Eigen::Index>(j)], by = error[static_cast<Eigen::Index>(j)];
      share.bias.push_back(e.spec.logarithmic ? -e.value * std::expm1(shift) : -shift);
      share.error.push_back(e.spec.logarithmic ? e.value * std::exp(shift) * by : by);
    }
    share.how = how;
    return share;
  }

  Share unknown(const std::string& why) const {
    const std::vector<double> none(fit.parameters.size(), not_a_number);
    return {"", none, none, why};
  }
};

/// Whether the experiment is a plane section in place of a solid that can be modelled too.
bool may_be_deepened(const Experiment& experiment) {
  if (experiment.geometry.dimension != 2) return false;
  try {
    as_solid(experiment, deepened(experiment, experiment.mesh).depth_cells);
  } catch (const InputError&) {
    return false;
  }
  return experiment.mesh.depth_cells == 0;
}

}  // namespace

MeshSettings most_accurate(const Experiment& experiment, const MeshSettings& settings) {
  MeshSettings result = settings;
  result.order = 2;
  const bool volumes = experiment.geometry.dimension == 3 || experiment.geometry.plane == Plane::strain;
  for (const MaterialSettings& material : experiment.materials) {
    const auto nu = material.constants.find("nu");
    if (volumes && nu != material.constants.end() && nu->second > 0.4) result.formulation = Formulation::locking_free;
  }
  return result;
}

double element_size(const Mesh& mesh) {
  return std::pow(static_cast<double>(mesh.element_count()), -1.0 / mesh.dimension());
}

Extrapolation extrapolate(const std::vector<double>& h, const Eigen::MatrixXd& values, double highest_order) {
  const Eigen::Index n = values.cols();
  Extrapolation result;
  result.order = 1;
  result.limit = values.col(n - 1);
  result.error = Eigen::VectorXd::Constant(values.rows(), not_a_number);
  if (n < 2) return result;
  const Eigen::VectorXd last = values.col(n - 1) - values.col(n - 2);
  // h^p of the finest mesh but `coarser`.
  const auto power = [&](Eigen::Index coarser, double p) {
    return std::pow(h[static_cast<size_t>(n - 1 - coarser)], p);
  };
  Eigen::VectorXd before = last;
  if (n >= 3) {
    before = values.col(n - 2) - values.col(n - 3);
    const double squares = last.squaredNorm(), ratio = before.dot(last) / std::max(squares, 1e-300);
    const auto ratio_of = [&](double p) { return (power(2, p) - power(1, p)) / (power(1, p) - power(0, p)); };
    const double cosine = before.dot(last) / std::max(before.norm() * last.norm(), 1e-300);
    result.measured = squares == 0 || (cosine > 0.5 && ratio > ratio_of(lowest_order));
    double low = lowest_order, high = highest_order;
    for (int i = 0; i < 60; ++i) {
      const double middle = 0.5 * (low + high);
      (ratio_of(middle) < ratio ? low : high) = middle;
    }
    result.order = 0.5 * (low + high);
    if (!result.measured) {
      result.error = 3 * last.cwiseAbs();
      return result;
    }
  }
  // What is left of the finest value's error, in last differences.
  const double left = power(0, result.order) / (power(1, result.order) - power(0, result.order));
  for (Eigen::Index i = 0; i < values.rows(); ++i) {
    const bool turns = before[i] * last[i] < 0;
    if (!turns) result.limit[i] += left * last[i];
    result.error[i] = turns ? 3 * std::abs(last[i]) : 1.25 * std::abs(left * last[i]);
  }
  return result;
}

std::string describe(const Share& share, const ParameterEstimate& estimate, size_t j) {
  if (!std::isfinite(share.bias[j]))
    return fmt::format("what the {} adds to it is not known: {}", share.source, share.how);
  const DisplayUnit unit = display_unit(estimate.value, estimate.spec.unit);
  const std::string name = unit.name == "1" || unit.name.empty() ? "" : " " + unit.name;
  if (share.bias[j] == 0)
    return fmt::format("{} adds +- {:.2g}{} ({})", share.source, share.error[j] / unit.factor, name, share.how);
  const std::string bias =
      fmt::format("the {} makes it {:.2g}{} too {}", share.source, std::abs(share.bias[j]) / unit.factor, name,
                  share.bias[j] < 0 ? "small" : "large");
  if (!std::isfinite(share.error[j])) return bias + ", more or less";
  return bias + fmt::format(", +- {:.2g}{}", share.error[j] / unit.factor, name);
}

std::vector<Share> discretisation_shares(const Experiment& experiment, const Trials& trials, const FitResult& fit,
                                         const std::function<void(const std::string&)>& progress, const Ask& ask) {
  std::vector<Share> shares;
  if (fit.covariance.size() == 0) return shares;
  // Where the fit stopped short of its own optimum is nobody's share.
  const Fitted fitted{experiment, trials, fit, progress, ask};
  const Shift own = fitted.shift_with(experiment.mesh, "the fit's own next step");
  if (!own.failure.empty()) return shares;
  const auto add = [&](const char* source, auto&& share_of) {
    const Stopwatch watch;
    Share& share = shares.emplace_back(share_of());
    share.source = source;
    share.seconds = watch.seconds();
  };
  add("mesh", [&] { return fitted.mesh_share(own); });
  if (experiment.contact.on) add("contact gap", [&] { return fitted.gap_share(own); });
  if (experiment.model == Rung::rigid_segments) add("rigidity", [&] { return fitted.rigid_share(own); });
  return shares;
}

std::optional<Share> section_share(const Experiment& experiment, const Trials& trials, const FitResult& fit,
                                   const std::function<void(const std::string&)>& progress, const Ask& ask) {
  if (fit.covariance.size() == 0 || !may_be_deepened(experiment)) return std::nullopt;
  const Stopwatch watch;
  Share share = Fitted{experiment, trials, fit, progress, ask}.section_share();
  share.source = "plane section";
  share.seconds = watch.seconds();
  return share;
}

}  // namespace taut
