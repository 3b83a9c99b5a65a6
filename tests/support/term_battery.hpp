#pragma once
#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <memory>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "sim/mesh/structured.hpp"
#include "sim/model/model.hpp"
#include "sim/terms/solid.hpp"
#include "tests/support/taylor.hpp"

// What every energy must satisfy. A term is put into a model of its own, without supports, and seen through it.
namespace taut::test {

/// One term at one state, within a time step or not: all that the battery needs.
struct TermUnderTest {
  Model model;
  Params p;
  Eigen::VectorXd u;
  std::string name;
  std::shared_ptr<TimeStep> step{};
  Point at() const { return {u, p, step.get()}; }
};

inline TermUnderTest term_under_test(Mesh mesh, ParameterTable table, std::unique_ptr<Term> term, Params p,
                                     Eigen::VectorXd u, std::string name) {
  std::vector<std::unique_ptr<Term>> terms;
  terms.push_back(std::move(term));
  return {Model(std::move(mesh), std::move(table), std::move(terms), {}), std::move(p), std::move(u), std::move(name)};
}

inline double energy_of(const Model& model, const Eigen::VectorXd& u, const Params& p, const TimeStep* step = nullptr) {
  Assembly out;
  model.evaluate({u, p, step}, out);
  return out.energy;
}

inline Eigen::VectorXd gradient_of(const Model& model, const Eigen::VectorXd& u, const Params& p,
                                   const TimeStep* step = nullptr) {
  Eigen::VectorXd gradient;
  Assembly out;
  out.gradient = &gradient;
  model.evaluate({u, p, step}, out);
  return gradient;
}

/// The Hessian on the free unknowns as it goes into the pattern, mirrored to both triangles; without supports, also
/// what comes outside of the pattern.
inline Eigen::MatrixXd hessian_of(const Model& model, const Eigen::VectorXd& u, const Params& p,
                                  Curvature curvature = Curvature::exact, const TimeStep* step = nullptr) {
  const SparsePattern& pattern = model.pattern();
  std::vector<double> values(static_cast<size_t>(pattern.entries()) + 1);
  Assembly out;
  std::vector<Coupling> couplings;
  out.hessian = values.data();
  if (model.free_unknowns() == model.unknowns()) out.couplings = &couplings;
  out.curvature = curvature;
  model.evaluate({u, p, step}, out);
  Eigen::MatrixXd H = Eigen::MatrixXd::Zero(pattern.size, pattern.size);
  for (int j = 0; j < pattern.size; ++j) {
    for (int k = pattern.columns[j]; k < pattern.columns[j + 1]; ++k) {
      H(pattern.rows[k], j) = H(j, pattern.rows[k]) = values[k];
    }
  }
  for (const Coupling& entry : couplings) {
    H(entry.row, entry.column) += entry.value;
    if (entry.row != entry.column) H(entry.column, entry.row) += entry.value;
  }
  return H;
}

inline Eigen::VectorXd random_vector(Eigen::Index size, std::mt19937& random) {
  std::normal_distribution<double> normal;
  Eigen::VectorXd v(size);
  for (double& x : v) x = normal(random);
  return v;
}

/// An admissible state: a homogeneous deformation plus noise of `noise` times the bounding-box diagonal, scaled down
/// until no element is inverted.
inline Eigen::VectorXd random_state(const Mesh& mesh, double strain, double noise, unsigned seed) {
  std::mt19937 random(seed);
  const int d = mesh.dimension();
  const Eigen::MatrixXd H = strain * random_vector(d * d, random).reshaped(d, d);
  const Eigen::VectorXd irregular = noise * mesh.diagonal() * random_vector(mesh.X.size(), random);
  Eigen::VectorXd homogeneous(mesh.X.size()), u;
  for (int i = 0; i < mesh.node_count(); ++i) homogeneous.segment(i * d, d) = H * mesh.node(i);
  for (double scale = 1; u.size() == 0 || smallest_jacobian(mesh, u) < 0.1; scale *= 0.8)
    u = homogeneous + scale * irregular;
  return u;
}

/// Gradient by the remainder of the energy (order 2); Hessian by that of the energy (3) and of the gradient (2).
/// `size` [m] is the largest step: small against the elements.
inline void expect_derivatives(const TermUnderTest& t, double size) {
  std::mt19937 random(11);
  const double energy = energy_of(t.model, t.u, t.p, t.step.get());
  ASSERT_TRUE(std::isfinite(energy)) << t.name << ": the state is not admissible";
  const Eigen::VectorXd gradient = gradient_of(t.model, t.u, t.p, t.step.get());
  for (int direction = 0; direction < 3; ++direction) {
    const Eigen::VectorXd v = random_vector(t.u.size(), random), Hv = t.model.hessian_times(t.at(), v);
    const double slope = gradient.dot(v), curvature = v.dot(Hv);
    const double energy_noise =
        1e-14 * (std::abs(energy) + gradient.cwiseAbs().dot(t.u.cwiseAbs() + size * v.cwiseAbs()));
    const double gradient_noise = 1e-13 * (gradient.norm() + size * Hv.norm());
    const auto change = [&](double h) { return energy_of(t.model, t.u + h * v, t.p, t.step.get()) - energy; };
    expect_taylor_order([&](double h) { return std::abs(change(h) - h * slope); }, 2, energy_noise, size, 6,
                        t.name + ": gradient");
    expect_taylor_order([&](double h) { return std::abs(change(h) - h * slope - 0.5 * h * h * curvature); }, 3,
                        energy_noise, size, 5, t.name + ": Hessian in the energy");
    expect_taylor_order(
        [&](double h) { return (gradient_of(t.model, t.u + h * v, t.p, t.step.get()) - gradient - h * Hv).norm(); }, 2,
        gradient_noise, size, 6, t.name + ": Hessian in the gradient");
  }
}

/// The mixed derivative of each parameter by the remainder of the gradient; parameters on which nothing depends have
/// none.
inline void expect_parameter_derivatives(const TermUnderTest& t, double relative_step = 0.1) {
  const Eigen::VectorXd gradient = gradient_of(t.model, t.u, t.p, t.step.get());
  for (int k = 0; k < t.model.parameters().size(); ++k) {
    const Eigen::VectorXd mixed = t.model.parameter_gradient(t.at(), k);
    const auto moved = [&](double h) {
      Params p = t.p;
      p[k] += h;
      return gradient_of(t.model, t.u, p, t.step.get());
    };
    const double size = relative_step * (t.p[k] == 0 ? 1 : std::abs(t.p[k]));
    const double noise = 1e-13 * (gradient.norm() + size * mixed.norm());
    expect_taylor_order([&](double h) { return (moved(h) - gradient - h * mixed).norm(); }, 2, noise, size, 6,
                        t.name + ": " + t.model.parameters()[k].id);
  }
}

/// Both ways to see the Hessian agree, and it is symmetric.
inline void expect_symmetric_hessian(const TermUnderTest& t) {
  const Eigen::MatrixXd assembled = hessian_of(t.model, t.u, t.p, Curvature::exact, t.step.get());
  Eigen::MatrixXd columns(t.u.size(), t.u.size());
  for (Eigen::Index k = 0; k < t.u.size(); ++k) {
    columns.col(k) = t.model.hessian_times(t.at(), Eigen::VectorXd::Unit(t.u.size(), k));
  }
  const double scale = columns.norm();
  EXPECT_LE((columns - columns.transpose()).norm(), 1e-15 * scale) << t.name;
  EXPECT_LE((columns - assembled).norm(), 1e-15 * scale) << t.name;
}

inline void expect_projection_is_semidefinite(const TermUnderTest& t) {
  const Eigen::MatrixXd H = hessian_of(t.model, t.u, t.p, Curvature::projected, t.step.get());
  const Eigen::VectorXd eigenvalues = Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(H).eigenvalues();
  EXPECT_GE(eigenvalues[0], -1e-13 * eigenvalues.cwiseAbs().maxCoeff()) << t.name;
}

/// The nodal forces of an internal energy balance: sum f = 0 and sum x x f = 0 about the origin.
inline void expect_no_net_force_or_moment(const TermUnderTest& t) {
  const Eigen::VectorXd f = gradient_of(t.model, t.u, t.p, t.step.get());
  const int d = t.model.mesh().dimension();
  Eigen::Vector3d force = Eigen::Vector3d::Zero(), moment = Eigen::Vector3d::Zero();
  double scale = 0;
  for (int i = 0; i < t.model.mesh().node_count(); ++i) {
    Eigen::Vector3d x = Eigen::Vector3d::Zero(), g = Eigen::Vector3d::Zero();
    x.head(d) = t.model.mesh().node(i) + t.u.segment(i * d, d);
    g.head(d) = f.segment(i * d, d);
    force += g;
    moment += x.cross(g);
    scale += g.norm();
  }
  ASSERT_GT(scale, 0.0) << t.name << ": without forces nothing is tested";
  EXPECT_LE(force.norm(), 1e-14 * scale) << t.name;
  EXPECT_LE(moment.norm(), 1e-14 * scale * t.model.length_scale()) << t.name;
}

/// A small irregular mesh of each shape, 0.2 m wide: interior vertices off their grid places.
inline Mesh irregular_mesh(ElementShape shape) {
  const int order = order_of(shape), d = dimension_of(shape);
  Mesh mesh = d == 2 ? rectangle(graded(0.2, 3, 1.5), graded(0.1, 2), order, "body")
                     : box(graded(0.2, 2, 1.5), graded(0.15, 2), graded(0.1, 1), order, "body");
  map_vertices(mesh, [&](const Eigen::VectorXd& X) -> Eigen::VectorXd {
    Eigen::VectorXd moved = X;
    moved[0] += 0.010 * std::sin(40 * X[1] + 1) + (d == 3 ? 0.05 * X[2] : 0);
    moved[1] += 0.008 * std::cos(50 * X[0]);
    if (d == 3) moved[2] += 0.05 * X[0] + 0.1 * X[1];
    return moved;
  });
  return mesh;
}

constexpr ElementShape all_shapes[] = {ElementShape::tri3, ElementShape::tri6, ElementShape::tet4, ElementShape::tet10};

}  // namespace taut::test
