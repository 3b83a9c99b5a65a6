#pragma once
#include "calib/models/rod_algebra.hpp"

namespace taut::rod {

/// Energy per length of a section's stretching and bending with derivatives by (v_3, k_1, k_2), and those of its slopes
/// by Poisson's number.
struct RodStretching {
  double energy = 0;
  Eigen::Vector3d stress = Eigen::Vector3d::Zero(), by_poisson = Eigen::Vector3d::Zero();
  Eigen::Matrix3d tangent = Eigen::Matrix3d::Zero();
};

/// int w(v_3 + k_1 Y_2 - k_2 Y_1) dA over a circle [m], times `sign`, w the energy of a fibre with free sides, see
/// fibre_energy(): added to `sum`. `by` is (v_3, k_1, k_2).
void add_circle(double sign, double radius, const Vector3d& by, double E, double nu, bool by_poisson,
                RodStretching& sum);
/// The same over a rectangle of half sides along d1 and d2 [m].
void add_rectangle(double half_first, double half_second, const Vector3d& by, double E, double nu, bool by_poisson,
                   RodStretching& sum);

}  // namespace taut::rod
