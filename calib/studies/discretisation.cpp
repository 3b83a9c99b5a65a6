#include "calib/studies/discretisation.hpp"

#include <fmt/format.h>

#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <optional>

#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/stopwatch.hpp"
#include "sim/core/units.hpp"
#include "sim/shapes/geometry.hpp"

namespace taut {
namespace {

/// Quadratic elements would converge with order 4 where all is smooth. Beside a clamped corner it is 1.4 to 1.7, and a
/// higher one that coarse meshes show is not to be trusted.
constexpr double highest_order = 2;
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
  std::vector<Level> levels;  // from fine to coarse
  const Mesh own = make_mesh(experiment, experiment.mesh);
  const double r = own.dimension() == 2 ? 2 : 1.45, most = own.dimension() == 2 ? 150e3 : 40e3;
  auto level = [&](int k) -> std::optional<Level> {
    Level result{refined(best, experiment.geometry, std::pow(r, k)), element_size(own), k == 0 && member, k > 0};
    if (result.own) return result;
    try {
      const Mesh mesh = make_mesh(experiment, result.settings);
      result.h = element_size(mesh);
      if (static_cast<double>(mesh.X.size()) <= most) return result;
    } catch (const InputError&) {  // too coarse for its geometry
    }
    return std::nullopt;
  };
  auto add = [&](int k, auto at) {
    const std::optional<Level> next = level(k);
    const bool distinct = next && std::all_of(levels.begin(), levels.end(), [&](const Level& other) {
                            return std::abs(std::log(other.h / next->h)) > std::log(1.15);
                          });
    if (distinct) levels.insert(at(), *next);
  };
  for (int k = 1; k >= -2 && levels.size() < 3; --k) add(k, [&] { return levels.end(); });
  if (levels.size() < 3) add(2, [&] { return levels.begin(); });
  std::reverse(levels.begin(), levels.end());
  return levels;
}

/// The free parameters of a fit, in a protocol's table.
std::vector<FreeParameter> free_of(const FitResult& fit, const ParameterTable& table) {
  std::vector<FreeParameter> free;
  for (const ParameterEstimate& e : fit.parameters) free.push_back({table.index(e.spec.id), e.value, e.lower, e.upper});
  return free;
}

struct Shift {
  Eigen::VectorXd step;  ///< fitted scale
  std::string failure;   ///< "": none
};

/// Where the fit would end with other settings.
Shift shift_with(const Experiment& experiment, const MeshSettings& settings, const Trials& trials, const FitResult& fit,
                 const Ask& ask) {
  const StaticReplay bench = make_static_replay(experiment, settings, trials);
  StaticProtocol& protocol = *bench.protocol;
  const ParameterTable& table = protocol.parameters();
  const std::vector<FreeParameter> free = free_of(fit, table);
  std::vector<int> indices;
  for (const FreeParameter& parameter : free) indices.push_back(parameter.index);
  Params p = fit.p;
  if (experiment.contact.on) p[table.index("contact_gap")] = protocol.nominal()[table.index("contact_gap")];
  const Prediction prediction = ask ? ask(protocol, p, indices) : protocol.predict(p, indices);
  if (!prediction.complete()) return {{}, prediction.failures.front()};
  return {gauss_newton_step(prediction, bench.measurements, table, p, free), ""};
}

/// A share from where the fit would end in the limit and the error of that, on the fitted scale.
void set_bias(const FitResult& fit, const Eigen::VectorXd& limit, const Eigen::VectorXd& error,
              DiscretisationShare& share) {
  for (size_t j = 0; j < fit.parameters.size(); ++j) {
    const ParameterEstimate& e = fit.parameters[j];
    const double shift = limit[static_cast<Eigen::Index>(j)], by = error[static_cast<Eigen::Index>(j)];
    share.bias.push_back(e.spec.logarithmic ? -e.value * std::expm1(shift) : -shift);
    share.error.push_back(e.spec.logarithmic ? e.value * std::exp(shift) * by : by);
  }
}

void set_unknown(const FitResult& fit, const std::string& why, DiscretisationShare& share) {
  share.bias.assign(fit.parameters.size(), not_a_number);
  share.error.assign(fit.parameters.size(), not_a_number);
  share.how = why;
}

DiscretisationShare mesh_share(const Experiment& experiment, const Trials& trials, const FitResult& fit,
                               const Shift& own, const std::function<void(const std::string&)>& progress,
                               const Ask& ask) {
  const Stopwatch watch;
  DiscretisationShare share;
  share.source = "mesh";
  const std::vector<Level> levels = levels_of(experiment);
  const Eigen::VectorXd sd = fit.covariance.diagonal().cwiseSqrt();
  Eigen::MatrixXd steps(sd.size(), static_cast<Eigen::Index>(levels.size()));
  std::vector<double> h;
  std::string names;
  for (const Level& level : levels) {
    const Eigen::Index k = static_cast<Eigen::Index>(h.size());
    h.push_back(level.h);
    names += (names.empty() ? "" : "; ") + level.settings.describe();
    steps.col(k).setZero();
    if (level.own) continue;
    if (progress) progress("the mesh's share: " + level.settings.describe());
    const Shift shift = shift_with(experiment, level.settings, trials, fit, ask);
    if (!shift.failure.empty()) {
      set_unknown(fit, fmt::format("{}: {}", level.settings.describe(), shift.failure), share);
      share.seconds = watch.seconds();
      return share;
    }
    steps.col(k) = (shift.step - own.step).cwiseQuotient(sd);
  }
  if (levels.size() < 2 && (levels.empty() || levels.front().own)) {
    set_unknown(fit, "the mesh can be neither refined nor coarsened", share);
    return share;
  }
  const Extrapolation limit = extrapolate(h, steps, highest_order);
  set_bias(fit, limit.limit.cwiseProduct(sd), limit.error.cwiseProduct(sd), share);
  share.how = "one Gauss-Newton step at the optimum with " + names;
  if (levels.size() == 1)
    share.how += "; there is no other mesh to tell how far that is from the limit";
  else if (limit.measured)
    share.how += fmt::format("; extrapolated with the order {:.2g} that they show", limit.order);
  else
    share.how +=
        levels.size() == 2 ? "; extrapolated with order 1" : "; they do not converge evenly: the finest counts";
  if (std::none_of(levels.begin(), levels.end(), [](const Level& level) { return level.finer; }))
    share.how += "; finer ones than the fit's own would take too long";
  share.seconds = watch.seconds();
  return share;
}

DiscretisationShare gap_share(const Experiment& experiment, const Trials& trials, const FitResult& fit,
                              const Shift& own, const std::function<void(const std::string&)>& progress,
                              const Ask& ask) {
  const Stopwatch watch;
  DiscretisationShare share;
  share.source = "contact gap";
  if (progress) progress("the contact gap's share");
  MeshSettings half = experiment.mesh;
  half.contact_gap = 0.5 * contact_gap(experiment.mesh, make_mesh(experiment, experiment.mesh).diagonal());
  const Shift shift = shift_with(experiment, half, trials, fit, ask);
  if (shift.failure.empty()) {
    const Eigen::VectorXd step = shift.step - own.step;
    set_bias(fit, 2 * step, step.cwiseAbs(), share);
    share.how = fmt::format("one Gauss-Newton step at the optimum with half the gap, {}; extrapolated linearly to none",
                            with_unit(half.contact_gap, "m"));
  } else {
    set_unknown(fit, "half the gap: " + shift.failure, share);
  }
  share.seconds = watch.seconds();
  return share;
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

double scale_of(const FreeParameter& parameter, const ParameterTable& table, const Params& p) {
  const double value = p[parameter.index], range = parameter.upper - parameter.lower;
  if (table[parameter.index].logarithmic) return value;
  return std::isfinite(range) ? range : std::max(std::abs(value), 1e-12);
}

Extrapolation extrapolate(const std::vector<double>& h, const Eigen::MatrixXd& values, double highest_order) {
  const Eigen::Index n = values.cols();
  Extrapolation result;
  result.order = 1;
  result.limit = values.col(n - 1);
  result.error = Eigen::VectorXd::Constant(values.rows(), not_a_number);
  if (n < 2) return result;
  const Eigen::VectorXd last = values.col(n - 1) - values.col(n - 2);
  // What is left of the finest value's error, in last differences.
  auto left = [&](double p) {
    const double b = std::pow(h[static_cast<size_t>(n - 2)], p), c = std::pow(h[static_cast<size_t>(n - 1)], p);
    return c / (b - c);
  };
  Eigen::VectorXd before = last;
  if (n >= 3) {
    before = values.col(n - 2) - values.col(n - 3);
    const double squares = last.squaredNorm(), ratio = before.dot(last) / std::max(squares, 1e-300);
    auto ratio_of = [&](double p) {
      const double a = std::pow(h[static_cast<size_t>(n - 3)], p), b = std::pow(h[static_cast<size_t>(n - 2)], p);
      return (a - b) / (b - std::pow(h[static_cast<size_t>(n - 1)], p));
    };
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
  for (Eigen::Index i = 0; i < values.rows(); ++i) {
    if (before[i] * last[i] < 0) {
      result.error[i] = 3 * std::abs(last[i]);
      continue;
    }
    const double change = left(result.order) * last[i];
    result.limit[i] += change;
    result.error[i] = 1.25 * std::abs(change);
  }
  return result;
}

Eigen::VectorXd gauss_newton_step(const Prediction& prediction, const std::vector<Measurement>& measurements,
                                  const ParameterTable& table, const Params& p,
                                  const std::vector<FreeParameter>& free) {
  const Eigen::Index m = static_cast<Eigen::Index>(measurements.size()), n = static_cast<Eigen::Index>(free.size());
  Eigen::VectorXd r(m), range(n), lowest(n), highest(n);
  Eigen::MatrixXd J(m, n);
  for (Eigen::Index i = 0; i < m; ++i) {
    const Measurement& reading = measurements[static_cast<size_t>(i)];
    r[i] = (reading.value - prediction.values[reading.row]) / reading.sigma;
    J.row(i) = prediction.derivatives.row(reading.row) / reading.sigma;
  }
  // Logarithmic parameters by d = 1 - value/new, so new = value / (1 - d); others in units of their range.
  for (Eigen::Index j = 0; j < n; ++j) {
    const FreeParameter& parameter = free[static_cast<size_t>(j)];
    const double value = p[parameter.index];
    range[j] = scale_of(parameter, table, p);
    if (table[parameter.index].logarithmic) {
      lowest[j] = std::max(-2.0, 1 - value / parameter.lower);
      highest[j] = std::min(2.0 / 3, 1 - value / parameter.upper);
    } else {
      lowest[j] = (parameter.lower - value) / range[j];
      highest[j] = (parameter.upper - value) / range[j];
    }
  }
  J *= range.asDiagonal();
  // Those that would leave their bounds stop there, and the others are asked again.
  Eigen::VectorXd d = Eigen::VectorXd::Zero(n);
  std::vector<bool> held(free.size(), false);
  for (bool changed = true; changed;) {
    changed = false;
    Eigen::VectorXd left = r;
    Eigen::MatrixXd open = J;
    for (Eigen::Index j = 0; j < n; ++j) {
      if (!held[static_cast<size_t>(j)]) continue;
      left -= d[j] * J.col(j);
      open.col(j).setZero();
    }
    const Eigen::JacobiSVD<Eigen::MatrixXd> svd(open, Eigen::ComputeThinU | Eigen::ComputeThinV);
    const Eigen::VectorXd s = svd.singularValues(), inverse = s.cwiseQuotient(s.cwiseMax(0.01).cwiseAbs2());
    const Eigen::VectorXd step = svd.matrixV() * inverse.asDiagonal() * (svd.matrixU().transpose() * left);
    for (Eigen::Index j = 0; j < n; ++j) {
      if (held[static_cast<size_t>(j)]) continue;
      d[j] = std::clamp(step[j], lowest[j], highest[j]);
      if (d[j] != step[j]) held[static_cast<size_t>(j)] = changed = true;
    }
  }
  for (Eigen::Index j = 0; j < n; ++j)
    d[j] = table[free[static_cast<size_t>(j)].index].logarithmic ? -std::log1p(-d[j]) : d[j] * range[j];
  return d;
}

std::string describe(const DiscretisationShare& share, const ParameterEstimate& estimate, size_t j) {
  if (!std::isfinite(share.bias[j]))
    return fmt::format("what the {} adds to it is not known: {}", share.source, share.how);
  const DisplayUnit unit = display_unit(estimate.value, estimate.spec.unit);
  const std::string name = unit.name == "1" || unit.name.empty() ? "" : " " + unit.name;
  const std::string bias =
      fmt::format("the {} makes it {:.2g}{} too {}", share.source, std::abs(share.bias[j]) / unit.factor, name,
                  share.bias[j] < 0 ? "small" : "large");
  if (!std::isfinite(share.error[j])) return bias + ", more or less";
  return bias + fmt::format(", +- {:.2g}{}", share.error[j] / unit.factor, name);
}

std::vector<DiscretisationShare> discretisation_shares(const Experiment& experiment, const Trials& trials,
                                                       const FitResult& fit,
                                                       const std::function<void(const std::string&)>& progress,
                                                       const Ask& ask) {
  std::vector<DiscretisationShare> shares;
  if (fit.covariance.size() == 0) return shares;
  // Where the fit stopped short of its own optimum is nobody's share.
  if (progress) progress("the fit's own next step");
  const Shift own = shift_with(experiment, experiment.mesh, trials, fit, ask);
  if (!own.failure.empty()) return shares;
  shares.push_back(mesh_share(experiment, trials, fit, own, progress, ask));
  if (experiment.contact.on) shares.push_back(gap_share(experiment, trials, fit, own, progress, ask));
  return shares;
}

}  // namespace taut
