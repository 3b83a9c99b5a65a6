#include "calib/models/rod_section.hpp"

#include <array>
#include <cmath>
#include <numbers>

#include "calib/models/fibre.hpp"

namespace taut::rod {
namespace {

/// w, w', w'', dw'/dnu of a fibre.
std::array<double, 4> fibre_of(double stretch, double E, double nu, bool by_poisson) {
  const auto mu_of = [&](const auto& poisson) { return E / (2.0 * (1.0 + poisson)); };
  const auto lambda_of = [&](const auto& poisson) { return E * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson)); };
  if (!by_poisson) {
    const Jet<1> w = fibre_energy(Jet<1>::variable(stretch, 0), 2, mu_of(nu), lambda_of(nu));
    return {w.v, w.g[0], w.H(0, 0), 0};
  }
  const Jet<2> poisson = Jet<2>::variable(nu, 1);
  const Jet<2> w = fibre_energy(Jet<2>::variable(stretch, 0), 2, mu_of(poisson), lambda_of(poisson));
  return {w.v, w.g[0], w.H(0, 0), w.H(0, 1)};
}

}  // namespace

// Fibres lie on lines square to the direction of bending, of lengths 2 sqrt(1 - x^2).
void add_circle(double sign, double radius, const Vector3d& by, double E, double nu, bool by_poisson,
                RodStretching& sum) {
  constexpr int points = 6;
  const double k = by.tail<2>().norm(), area = sign * std::numbers::pi * radius * radius;
  // Where it does not bend yet, any direction will do.
  const Eigen::Vector2d way = k > 0 ? Eigen::Vector2d(by.tail<2>() / k) : Eigen::Vector2d(1, 0);
  double moment = 0, stiffness = 0;
  for (int i = 1; i <= points; ++i) {
    const double angle = i * std::numbers::pi / (points + 1), arm = radius * std::cos(angle);
    const double dA = area * 2 / (points + 1) * std::sin(angle) * std::sin(angle);
    const auto [w, dw, ddw, dw_nu] = fibre_of(by[0] + k * arm, E, nu, by_poisson);
    const Vector3d slope(1, arm * way[0], arm * way[1]);
    sum.energy += dA * w;
    sum.stress += dA * dw * slope;
    sum.by_poisson += dA * dw_nu * slope;
    sum.tangent += dA * ddw * outer(slope, slope);
    moment += dA * dw * arm;
    stiffness += dA * ddw * arm * arm;
  }
  const double across = k * radius > 1e-5 ? moment / k : stiffness;
  sum.tangent(1, 1) += across * way[1] * way[1];
  sum.tangent(2, 2) += across * way[0] * way[0];
  sum.tangent(1, 2) -= across * way[0] * way[1];
  sum.tangent(2, 1) -= across * way[0] * way[1];
}

void add_rectangle(double half_first, double half_second, const Vector3d& by, double E, double nu, bool by_poisson,
                   RodStretching& sum) {
  constexpr double place[5] = {-0.9061798459386640, -0.5384693101056831, 0, 0.5384693101056831, 0.9061798459386640};
  constexpr double weight[5] = {0.2369268850561891, 0.4786286704993665, 0.5688888888888889, 0.4786286704993665,
                                0.2369268850561891};
  for (int i = 0; i < 5; ++i) {
    for (int j = 0; j < 5; ++j) {
      const Vector3d slope(1, half_second * place[j], -half_first * place[i]);
      const double dA = half_first * half_second * weight[i] * weight[j];
      const auto [w, dw, ddw, dw_nu] = fibre_of(slope.dot(by), E, nu, by_poisson);
      sum.energy += dA * w;
      sum.stress += dA * dw * slope;
      sum.by_poisson += dA * dw_nu * slope;
      sum.tangent += dA * ddw * outer(slope, slope);
    }
  }
}

}  // namespace taut::rod
