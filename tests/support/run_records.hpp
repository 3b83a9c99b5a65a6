#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "reports/run_record.hpp"
#include "sim/core/units.hpp"
#include "sim/mesh/loops.hpp"
#include "sim/shapes/push_puppet.hpp"

namespace taut::test {

/// The frame of a record: one fitted modulus, one control, a channel's readings added by add_reading().
inline RunRecord empty_record(const std::string& parameter, double value, double standard_error) {
  RunRecord record;
  record.title = "A record for tests";
  record.controls = {make_axis("tip_load", Quantity::force, "tip load")};
  record.load_label = "tip load";
  record.load_control = 0;
  record.parameter_ids = {parameter, "nu", "gravity", "tip_load"};
  record.fit.status = FitStatus::converged;
  record.fit.message = "chi squared no longer changes";
  record.fit.p = Eigen::Vector4d(value, 0.499, 9.81, 0);
  ParameterEstimate estimate;
  estimate.spec = {parameter, "E", "Pa", 0, std::numeric_limits<double>::infinity(), "Young's modulus", true};
  estimate.start = 2 * value;
  estimate.lower = value / 100;
  estimate.upper = value * 100;
  estimate.value = value;
  estimate.standard_error = standard_error;
  estimate.lower95 = value * std::exp(-1.96 * standard_error / value);
  estimate.upper95 = value * std::exp(1.96 * standard_error / value);
  estimate.verdict = Verdict::well_determined;
  estimate.explanation = "All readings depend on it, far beyond their noise.";
  record.fit.parameters = {estimate};
  record.fit.covariance = Eigen::MatrixXd::Constant(1, 1, std::pow(standard_error / value, 2));
  record.fit.correlation = Eigen::MatrixXd::Ones(1, 1);
  record.fit.singular_values = Eigen::VectorXd::Constant(1, value / standard_error);
  record.fit.weakest = Eigen::VectorXd::Ones(1);
  record.fit.evaluations = 9;
  record.fit.iterations = 7;
  record.main = {
      "quadratic", "quadratic, locking-free, 14 x 5 x 5 cells", 9867, "converged", {value}, {standard_error}, 0, 12.5};
  record.provenance = {
      "0.1.0",
      "0123abcd",
      {{"Ceres", "2.1.0"}, {"Eigen", "3.4.0"}},
      "taut fit experiment.toml --output run",
      {{"experiment.toml", "experiment.toml", std::string(64, 'a')}, {"bench.csv", "data.csv", std::string(64, 'b')}},
      "2024-05-01T12:00:00Z",
      "two cores, Linux",
      0,
      12.5};
  record.setup = {{"mesh", record.main.mesh}, {"material", "neo-Hookean, density 1070 kg/m3, Poisson ratio 0.499"}};
  record.remarks = {"2 columns are not used: frame_fit_rms_mm, sd_eq_z_mm"};
  record.shape_axes[0] = "x";
  record.shape_axes[1] = "z";
  record.replay_seconds = 1.25;
  record.replay_factorisations = 31;
  record.fit.search = {1.5, 280};
  record.fit.profiles = {0.5, 60};
  return record;
}

inline void add_reading(RunRecord& record, const std::string& trial, const std::string& channel, double load,
                        double measured, double sigma, double predicted, const std::string& series = "") {
  ReadingRecord reading;
  reading.line = static_cast<int>(record.readings.size()) + 2;
  reading.trial = trial;
  reading.channel = channel;
  reading.controls = {load};
  reading.measured = measured;
  reading.sigma = sigma;
  reading.predicted = predicted;
  reading.prediction_se = 0.005 * std::abs(predicted);
  record.readings.push_back(reading);
  record.load_newtons.push_back(load);
  record.series.push_back(series);
  if (std::ranges::find(record.channels, channel, &AxisRecord::id) == record.channels.end())
    record.channels.push_back(make_axis(channel, Quantity::length, "displacement"));
}

/// Chi squared and the test for lack of fit, from the readings; the p values are given, not computed.
inline void set_statistics(RunRecord& record, double chi_squared_p, const LackOfFit& lack) {
  record.fit.chi_squared = 0;
  for (const ReadingRecord& r : record.readings)
    record.fit.chi_squared += std::pow((r.measured - r.predicted) / r.sigma, 2);
  record.fit.dof = static_cast<int>(record.readings.size()) - static_cast<int>(record.fit.parameters.size());
  record.fit.chi_squared_p = chi_squared_p;
  record.fit.lack_of_fit = lack;
  record.main.chi_squared = record.fit.chi_squared;
}

/// Three markers on a block that hangs under its own weight and two masses, twice each; the curve is made up.
inline RunRecord hanging_block() {
  RunRecord record = empty_record("E_silicone", 274.1e3, 1.4e3);
  record.title = "Clamped silicone block, bent by its own weight and by hung masses";
  const char* channels[] = {"tip_top", "tip_left", "tip_right"};
  const double loads[] = {0, 0.51012, 1.00062};
  const double sigmas[] = {0.2e-3, 0.3e-3, 0.7e-3};
  // z displacement [mm] by load, trial and channel
  const double measured[3][2][3] = {{{-6.494, -6.504, -6.361}, {-6.575, -6.554, -6.453}},
                                    {{-17.147, -17.279, -16.467}, {-17.259, -17.107, -16.863}},
                                    {{-27.082, -26.131, -25.037}, {-26.085, -25.192, -24.607}}};
  const auto model = [](int channel, double load) {
    const double scale[] = {1.01, 1.0, 0.97};
    return -scale[channel] * 1e-3 * (6.9 + 21.2 * load - 2.1 * load * load);
  };
  for (int l = 0; l < 3; ++l) {
    for (int t = 0; t < 2; ++t) {
      for (int c = 0; c < 3; ++c) {
        add_reading(record, t == 0 ? "a" : "b", channels[c], loads[l], 1e-3 * measured[l][t][c], sigmas[l],
                    model(c, loads[l]));
      }
    }
  }
  for (int c = 0; c < 3; ++c) {
    CurveRecord curve;
    curve.channel = channels[c];
    for (int i = 0; i <= 40; ++i) {
      const double load = 1.00062 * i / 40;
      curve.load.push_back(load);
      curve.value.push_back(model(c, load));
      curve.se.push_back(0.005 * std::abs(model(c, load)));
      curve.increment_se.push_back(0.005 * std::abs(model(c, load) - model(c, 0)));
    }
    record.curves.push_back(curve);
  }
  for (int k = 0; k < 4; ++k) {
    const double drop[] = {0, 7.2e-3, 17.6e-3, 27.0e-3};
    ShapeRecord shape;
    shape.label = k == 0 ? "rest" : with_unit(loads[k - 1], "N");
    const auto point = [&](double s, double z) {
      const double bend = drop[k] * s * s * (3 - s) / 2, slope = drop[k] / 0.1 * (6 * s - 3 * s * s) / 2;
      return std::array<double, 2>{-0.1 + 0.1 * s + (z - 0.015) * slope - drop[k] * drop[k] * s * s / 0.2, z - bend};
    };
    for (const double z : {0.0, 0.03}) {
      for (int i = 0; i < 14; ++i) {
        const auto a = point(i / 14.0, z), b = point((i + 1) / 14.0, z);
        shape.segments.push_back({a[0], a[1], b[0], b[1]});
      }
    }
    for (const double s : {0.0, 1.0}) {
      const auto a = point(s, 0), b = point(s, 0.03);
      shape.segments.push_back({a[0], a[1], b[0], b[1]});
    }
    record.shapes.push_back(shape);
  }
  record.variants = {
      {"half the cells", "quadratic, locking-free, 7 x 3 x 3 cells", 1764, "converged", {275.2e3}, {1.4e3}, 60.1, 2.0},
      {"linear", "linear, locking-free, 28 x 10 x 10 cells", 10527, "converged", {268.9e3}, {1.4e3}, 63.2, 5.5},
      {"linear, locking", "linear, standard, 14 x 5 x 5 cells", 1620, "converged", {251.0e3}, {1.6e3}, 95.7, 1.1}};
  record.references = {{"E_silicone", 263.824e3, "Dubied et al. 2022, value marked optimized"},
                       {"E_silicone", 283.5e3, "Dubied et al. 2022, gradient fit of the 102 g case"}};
  LackOfFit lack{true, 45.0, 4.0, 8, 9, 12.66, 0.0005};
  set_statistics(record, 4e-6, lack);
  return record;
}

/// The same block with its shapes in space: a box of eight corners whose free end sinks, with a cable along its top and
/// a stop below its free end that bears 2.5 N and 0.4 N in the last two states. A search of four evaluations, the third
/// of which failed.
inline RunRecord block_in_space() {
  RunRecord record = hanging_block();
  record.shapes.clear();
  record.surface = {
      {"silicone", "plastic"},
      {0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4, 2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5},
      {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 1}};
  const double loads[] = {0, 0, 0.51012, 1.00062}, drop[] = {0, 7.2e-3, 17.6e-3, 27.0e-3};
  for (int k = 0; k < 4; ++k) {
    ShapeRecord& shape = record.shapes.emplace_back();
    shape.column = k == 0 ? "" : "tip_load " + with_unit(loads[k], "N");
    shape.label = k == 0 ? "rest" : shape.column;
    shape.segments = {{-0.1, 0, 0, -drop[k]}, {-0.1, 0.03, 0, 0.03 - drop[k]}};
    for (int corner = 0; corner < 8; ++corner) {
      const bool free_end = corner % 2 == 1;
      const double x = free_end ? 0 : -0.1, y = corner / 2 % 2 == 1 ? 0.03 : 0, z = corner / 4 == 1 ? 0.03 : 0;
      shape.points.insert(shape.points.end(), {x, y, z - (free_end ? drop[k] : 0)});
    }
    shape.space_cables = {{-0.1, 0.015, 0.028, 0, 0.015, 0.028 - drop[k]}};
    if (k > 1)
      shape.contacts = {{{0, 0.015, -drop[k]}, {0, 0, k == 2 ? 0.4 : 2.5}, {0, 0, -drop[k], 0, 0.03, -drop[k]}}};
  }
  record.fit.history = {{"search", 5400, {500e3}},
                        {"search", 71, {280e3}},
                        {"search", std::nan(""), {1e3}},
                        {"cold replay", record.fit.chi_squared, {record.fit.parameters[0].value}}};
  return record;
}

/// A finger at four retractions of its tendon, four masses, three trials; the curves are made up.
inline RunRecord tendon_finger() {
  RunRecord record = empty_record("E_foam", 61.3e3, 2.9e3);
  record.title = "Finger under tendon retraction and hung masses";
  record.simulated = true;
  record.controls.push_back(make_axis("retraction", Quantity::length, "retraction"));
  ParameterEstimate friction = record.fit.parameters[0];
  friction.spec = {"mu_tendon", "mu", "1", 0, 2, "friction of the tendon in its sheath", false};
  friction.start = 0.1;
  friction.value = 0.21;
  friction.standard_error = 0.12;
  friction.lower = 0;
  friction.upper = 2;
  friction.lower95.reset();
  friction.upper95 = 0.46;
  friction.verdict = Verdict::bounded_from_one_side;
  friction.explanation = "Any friction below 0.46 explains the readings; readings on the way back would tell.";
  record.fit.parameters.push_back(friction);
  record.fit.correlation.resize(2, 2);
  record.fit.correlation << 1, -0.83, -0.83, 1;
  record.fit.covariance = record.fit.correlation;
  record.fit.singular_values = Eigen::Vector2d(21, 4);
  record.fit.weakest = Eigen::Vector2d(0.28, 0.96);
  record.main.values = {61.3e3, 0.21};
  record.main.standard_errors = {2.9e3, 0.12};
  const double retractions[] = {0, 5.89, 11.79, 17.68}, masses[] = {0.05, 0.1, 0.2, 0.5};
  const double measured[4][4][3] = {
      {{3.55, 3.52, 3.56}, {6.36, 6.06, 6.24}, {10.82, 10.89, 10.88}, {17.62, 17.95, 18.14}},
      {{1.44, 1.45, 1.42}, {2.96, 2.95, 3.00}, {5.52, 5.59, 5.51}, {10.27, 10.84, 10.67}},
      {{0.80, 0.82, 0.81}, {1.62, 1.61, 1.55}, {3.04, 2.96, 3.04}, {5.15, 5.07, 5.17}},
      {{0.28, 0.28, 0.28}, {0.45, 0.41, 0.40}, {0.61, 0.59, 0.64}, {1.23, 1.15, 1.18}}};
  const double compliance[] = {7.7e-3, 3.1e-3, 1.72e-3, 0.46e-3}, softening[] = {0.22, 0.09, 0.13, 0.13};
  for (int s = 0; s < 4; ++s) {
    const std::string series = "retraction " + std::to_string(retractions[s]).substr(0, s < 2 ? 4 : 5) + " mm";
    const auto model = [&](double load) { return compliance[s] * load / (1 + softening[s] * load); };
    for (int m = 0; m < 4; ++m) {
      for (int t = 0; t < 3; ++t) {
        const double load = 9.80665 * masses[m], value = 1e-3 * measured[s][m][t];
        add_reading(record, std::to_string(t + 1), "tip", load, value, std::hypot(0.03e-3, 0.02 * value), model(load),
                    series);
        record.readings.back().controls.push_back(1e-3 * retractions[s]);
      }
    }
    CurveRecord curve;
    curve.channel = "tip";
    curve.series = series;
    for (int i = 0; i <= 40; ++i) {
      curve.load.push_back(4.903325 * i / 40);
      curve.value.push_back(model(curve.load.back()));
      curve.se.push_back(0.03 * curve.value.back());
    }
    record.curves.push_back(curve);
  }
  record.variants = {{"half the cells", "linear, 20 x 4 cells", 210, "converged", {64.0e3, 0.19}, {3.0e3, 0.13}, 80, 1},
                     {"twice the cells", "linear, 80 x 16 cells", 2754, "start failed", {}, {}, 0, 9}};
  record.references = {{"E_foam", 60e3, "value the simulation was made with"},
                       {"mu_tendon", 0.25, "value the simulation was made with"}};
  set_statistics(record, 1e-38, {true, 280.0, 15.5, 14, 32, 41.3, 1e-17});
  return record;
}

/// A module with cables at the same retractions and masses; its shapes are a made-up map of the reference module's
/// mesh. Its profiles: a modulus known on both sides, a friction that is open below, as far as its bound. Its
/// diagnostics agree with the whole fit.
inline RunRecord push_puppet_module() {
  RunRecord record = tendon_finger();
  record.title = "Push-puppet module under cable retraction and hung masses";
  record.shape_axes[0] = "x";
  record.shape_axes[1] = "y";
  const Mesh mesh = mesh_push_puppet({}, {2.6e-3, 2, 1});
  const auto shape_of = [&](double retraction, double drop) {
    const auto moved = [&](const Eigen::Vector2d& p) {
      const double cells = std::clamp(p.x(), 0.0, 55e-3) / 14.5e-3, whole = std::floor(cells);
      const double shortened = retraction / 4 * (whole + std::min(1.0, (cells - whole) * 14.5 / 11.5));
      const double s = p.x() / 58e-3, slope = 2 * drop / 58e-3 * s;
      return std::array<double, 2>{p.x() - shortened + slope * p.y(), p.y() - drop * s * s};
    };
    ShapeRecord shape;
    const Tag edges = boundary(mesh);
    for (int i = 0; i < edges.count(); ++i) {
      const auto a = moved(mesh.node(edges.entities[2 * i])), b = moved(mesh.node(edges.entities[2 * i + 1]));
      shape.segments.push_back({a[0], a[1], b[0], b[1]});
    }
    for (size_t r = 0; r < mesh.region_names.size(); ++r) {
      shape.areas.push_back({mesh.region_names[r], {}});
      for (const std::vector<int>& loop : region_loops(mesh, static_cast<int>(r))) {
        ShapeRecord::Line& line = shape.areas.back().loops.emplace_back();
        for (int node : loop) line.push_back(moved(mesh.node(node)));
      }
    }
    for (int side : {1, -1}) {
      ShapeRecord::Line& line = shape.cables.emplace_back();
      for (const Eigen::Vector2d& p : cable_path({}, side)) line.push_back(moved(p));
    }
    return shape;
  };
  record.shapes.clear();
  record.shapes.push_back(shape_of(0, 0));
  record.shapes.back().label = "rest";
  const double retractions[] = {0, 5.89e-3, 11.79e-3, 17.2e-3}, masses[] = {0, 0.05, 0.1, 0.2, 0.5};
  const double compliance[] = {24e-3, 12e-3, 6e-3, 0.8e-3};
  for (int r = 0; r < 4; ++r) {
    for (double mass : masses) {
      record.shapes.push_back(shape_of(retractions[r], compliance[r] * mass));
      ShapeRecord& shape = record.shapes.back();
      shape.row = "retraction " + (r == 0 ? std::string("0 mm") : with_unit(retractions[r], "m"));
      shape.column = "mass " + (mass == 0 ? std::string("0 g") : with_unit(mass, "kg"));
      shape.label = shape.row + ", " + shape.column;
    }
  }
  record.trend_degree = 2;
  record.fit.parameters[0].profile = {{55.8e3, 3.9}, {58.2e3, 1.1}, {61.3e3, 0}, {67.3e3, 3.7}};
  record.fit.parameters[1].profile = {{0, 2.9}, {0.21, 0}, {0.4, 2.6}, {0.46, 3.85}, {0.9, 14}};
  record.diagnostics = {{"E_foam", "retraction = 0 mm", 61.9e3, 1.1e3, 9.5, 12},
                        {"E_foam", "retraction = 5.89 mm", 60.2e3, 0.9e3, 17.7, 12},
                        {"E_foam", "retraction = 11.79 mm", 62.0e3, 1.4e3, 7.7, 12},
                        {"E_foam", "retraction = 17.2 mm", 58.4e3, 2.9e3, 10.6, 12}};
  record.setup.emplace_back("material foam", "neo_hookean, E = 50 kPa, nu = 0.2");
  return record;
}

}  // namespace taut::test
