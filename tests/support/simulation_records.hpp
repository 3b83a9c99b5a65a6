#pragma once
#include <algorithm>
#include <cmath>
#include <numbers>

#include "reports/simulation_record.hpp"
#include "sim/mesh/structured.hpp"

namespace taut::test {

/// A straight cable along material points, fixed behind the clamped end.
inline DrawnLine line_through(const Mesh& mesh, const std::string& id, const std::vector<Eigen::VectorXd>& points) {
  DrawnLine line{id, {}};
  for (const Eigen::VectorXd& point : points) line.points.push_back({locate(mesh, point), {}});
  return line;
}

inline Eigen::VectorXd vector_of(std::initializer_list<double> values) {
  Eigen::VectorXd v(static_cast<Eigen::Index>(values.size()));
  std::ranges::copy(values, v.begin());
  return v;
}

/// A beam of 60 x 10 mm, plastic at its tip, that bends up as a circular arc and swings back over 1 s; `frames` states
/// at every second sample. The tip's angle is a(t) = 1.2 sin(2.5 pi t) exp(-t).
inline SimulationRecord bending_beam(int frames = 21) {
  constexpr double length = 0.06, height = 0.01;
  SimulationRecord record;
  record.name = "bending beam";
  record.title = "A beam that <bends> & swings";
  record.description = "A made-up motion: a beam with a stiff tip bends as a circular arc.";
  record.mesh = rectangle(graded(length, 24), graded(height, 4), 2, "foam");
  assign_regions(record.mesh, [](const Eigen::VectorXd& x) { return std::string(x[0] > 0.05 ? "plastic" : "foam"); });
  record.lines = {
      line_through(record.mesh, "upper", {vector_of({0, 0.009}), vector_of({0.03, 0.009}), vector_of({0.06, 0.009})}),
      line_through(record.mesh, "lower", {vector_of({0, 0.001}), vector_of({0.03, 0.001}), vector_of({0.06, 0.001})})};
  record.lines[1].points.insert(record.lines[1].points.begin(), {{}, vector_of({-0.01, 0.001})});
  record.obstacles = {{vector_of({0.05, -0.03}), vector_of({0.058, -0.034}), vector_of({0.066, -0.03})}};
  record.grounds = {{vector_of({0, -0.035}), vector_of({0, 2})}};
  Series pull{"retraction_upper", "m", "upper cable pulled in", {}}, rest{"gravity", "m/s2", "gravity", {}};
  Series x{"tip_x", "m", "tip, along", {}}, y{"tip_y", "m", "tip, upwards", {}},
      angle{"tip_angle", "rad", "turn of the tip", {}};
  Series tension{"tension_upper", "N", "tension of the upper cable", {}}, energy{"energy", "J", "stored energy", {}};
  const int samples = 2 * frames - 1;
  for (int k = 0; k < samples; ++k) {
    const double t = samples > 1 ? static_cast<double>(k) / (samples - 1) : 0;
    const double a = 1.2 * std::sin(2.5 * std::numbers::pi * t) * std::exp(-t);
    const auto moved = [&](double X, double Y) {
      const double s = X / length * a, r = std::abs(a) < 1e-9 ? 0 : length / a;
      if (r == 0) return Eigen::Vector2d(X, Y);
      return Eigen::Vector2d((r + height / 2 - Y) * std::sin(s), r + height / 2 - (r + height / 2 - Y) * std::cos(s));
    };
    record.samples.push_back(t);
    pull.values.push_back(0.01 * std::max(0.0, std::sin(2.5 * std::numbers::pi * t)));
    rest.values.push_back(9.81);
    const Eigen::Vector2d tip = moved(length, height / 2);
    x.values.push_back(tip.x());
    y.values.push_back(tip.y());
    angle.values.push_back(a);
    tension.values.push_back(k == 3 ? NAN : 2.5 * std::max(0.0, a));
    energy.values.push_back(0.003 * a * a);
    if (k % 2 != 0) continue;
    Eigen::VectorXd u(record.mesh.X.size());
    for (int i = 0; i < record.mesh.node_count(); ++i) {
      u.segment<2>(2 * i) = moved(record.mesh.X[2 * i], record.mesh.X[2 * i + 1]) - record.mesh.X.segment<2>(2 * i);
    }
    record.frames.push_back(k);
    record.states.push_back(u);
  }
  record.controls = {pull, rest};
  record.channels = {x, y, angle, tension, energy};
  record.plots = {{"path", "Path of the tip", "tip_x", {"tip_y"}},
                  {"pull", "What the cable does", "", {"tension_upper", "tip_angle"}}};
  for (int mode = 0; mode < 2; ++mode) {
    SimulationRecord::Workspace space{mode == 0 ? "one cable" : "both cables", {}, 0, 0, {}};
    for (int i = 0; i < 200; ++i) {
      const double phi = 0.01 * i * std::numbers::pi, r = (mode == 0 ? 0.008 : 0.014) * (i % 5 + 1) / 5.0;
      space.points.emplace_back(0.05 + r * std::cos(phi), 0.03 + 0.8 * r * std::sin(phi));
      if (i % 5 == 4) space.outline.push_back(space.points.back());
    }
    space.area = std::numbers::pi * 0.8 * std::pow(mode == 0 ? 0.008 : 0.014, 2);
    space.area_error = 0.05 * space.area;
    record.workspaces.push_back(space);
  }
  record.facts = {{"Integrator", "implicit Euler, 41 steps of 25 ms"}, {"Time", "0.8 s on one core"}};
  record.command_line = "taut simulate experiments/beam/experiment.toml --out run";
  record.version = "0.1.0";
  record.experiment_text = "title = \"A beam that <bends> & swings\"\n";
  return record;
}

/// A column of 20 x 20 x 60 mm that twists by up to 1.5 rad over a sequence of equilibria.
inline SimulationRecord twisted_column(int frames = 9, int order = 1) {
  SimulationRecord record;
  record.name = "column";
  record.title = "A column that twists";
  record.description = "A made-up motion: every section of a column turns in proportion to its height.";
  record.mesh = box(graded(0.02, 4), graded(0.02, 4), graded(0.06, 10), order, "foam");
  for (int i = 0; i < record.mesh.node_count(); ++i) {
    record.mesh.X[3 * i] -= 0.01;
    record.mesh.X[3 * i + 1] -= 0.01;
  }
  assign_regions(record.mesh, [](const Eigen::VectorXd& x) { return std::string(x[2] > 0.048 ? "plastic" : "foam"); });
  record.lines = {line_through(record.mesh, "tendon", {vector_of({0.01, -0.01, 0}), vector_of({0.01, -0.01, 0.06})})};
  record.lines.front().points.push_back({{}, vector_of({0.02, -0.02, 0.07})});
  record.grounds = {{vector_of({0, 0, 0}), vector_of({0, 0, 1})}};
  record.sample_name = "turn";
  record.sample_unit = "rad";
  Series turn{"turn", "rad", "turn of the top", {}}, torque{"torque", "Nm", "torque at the top", {}};
  for (int k = 0; k < frames; ++k) {
    const double a = 1.5 * k / std::max(frames - 1, 1);
    Eigen::VectorXd u(record.mesh.X.size());
    for (int i = 0; i < record.mesh.node_count(); ++i) {
      const Eigen::Vector3d X = record.mesh.node(i);
      const double s = a * X.z() / 0.06;
      u.segment<3>(3 * i) = Eigen::Vector3d(std::cos(s) * X.x() - std::sin(s) * X.y() + 0.3 * X.z() * std::sin(s),
                                            std::sin(s) * X.x() + std::cos(s) * X.y(), X.z()) -
                            X;
    }
    record.samples.push_back(a);
    turn.values.push_back(a);
    torque.values.push_back(0.02 * a + 0.003 * a * a * a);
    record.frames.push_back(k);
    record.states.push_back(u);
  }
  record.controls = {turn};
  record.channels = {torque};
  return record;
}

}  // namespace taut::test
