#include "sim/materials/ogden_hill.hpp"

#include "sim/materials/neo_hookean.hpp"
#include "sim/materials/plane_stress.hpp"
#include "tests/support/material_battery.hpp"
#include "tests/support/message.hpp"
#include "tests/support/taylor.hpp"
#include "tests/support/term_battery.hpp"

namespace taut {
namespace {

using namespace test;

/// Nominal stress and its slope along x at the stretch s, sides held (which they are by themselves where nu = 0).
std::pair<double, double> stress_and_slope(const OgdenHill<>& material, double s) {
  Tensor<double, 3> H = Tensor<double, 3>::Zero();
  H(0, 0) = s - 1;
  return {material.stress(H)(0, 0), material.tangent(H)(0, 0)};
}

TEST(OgdenHill, WithoutPoissonEffectTheUniaxialStressIsItsClosedForm) {
  for (double alpha : {1.1, 2.0, 8.0, 25.0, 40.0}) {
    const OgdenHill<> material(std::array{1.0, 0.0, alpha});
    for (double s : {0.2, 0.5, 0.9, 0.999, 1.001, 1.3, 2.0}) {
      Tensor<double, 3> H = Tensor<double, 3>::Zero();
      H(0, 0) = s - 1;
      const double expected = (std::pow(s, alpha - 1) - 1 / s) / alpha;
      EXPECT_NEAR(material.stress(H)(0, 0), expected, 1e-13 * std::abs(expected) + 1e-15) << alpha << " " << s;
      EXPECT_EQ(material.stress(H)(1, 1), 0.0);
    }
  }
}

TEST(OgdenHill, SecantAndTangentAtThirtyPerCentCompressionAreTheTabulatedOnes) {
  struct Row {
    double alpha, secant, tangent;
  };
  for (const Row& row :
       {Row{2, 1.21, 1.52}, {4, .91, .88}, {8, .56, .36}, {12, .39, .20}, {20, .24, .10}, {30, .16, .07}}) {
    const auto [stress, slope] = stress_and_slope(OgdenHill<>(std::array{1.0, 0.0, row.alpha}), 0.7);
    EXPECT_NEAR(-stress / 0.3, row.secant, 0.006) << row.alpha;
    EXPECT_NEAR(slope, row.tangent, 0.006) << row.alpha;
  }
}

TEST(OgdenHill, UniaxialStressRisesWithTheStretchForEveryExponent) {
  for (double alpha : {1.1, 2.0, 12.0, 40.0}) {
    const OgdenHill<> material(std::array{1.0, 0.0, alpha});
    for (double s = 0.05; s < 2; s += 0.05) EXPECT_GT(stress_and_slope(material, s).second, 0.0) << alpha << " " << s;
  }
}

TEST(OgdenHill, WithExponentTwoAndNoPoissonEffectItIsTheNeoHookeanSolid) {
  const OgdenHill<> material(std::array{7.0, 0.0, 2.0});
  const NeoHookean<> other(std::array{7.0, 0.0});
  for (double size : strain_sizes) {
    for (const auto& H : sample_gradients<3>(size)) {
      EXPECT_NEAR(material.energy(H), other.energy(H), 1e-13 * other.energy(H));
      EXPECT_LE((material.stress(H) - other.stress(H)).norm(), 1e-13 * other.stress(H).norm());
      EXPECT_LE((material.tangent(H) - other.tangent(H)).norm(), 1e-13 * other.tangent(H).norm());
    }
  }
}

TEST(OgdenHill, IsContinuousAndAccurateAsThePoissonRatioGoesToZero) {
  const std::array theta{1.0, 0.0, 12.0};
  const OgdenHill<> material(theta), slope = OgdenHill<>::derivative(theta, 1);
  for (const auto& H : sample_gradients<3>(0.3)) {
    for (double nu : {1e-3, 1e-6, 1e-9, 1e-12, 1e-15}) {
      const OgdenHill<> near(std::array{1.0, nu, 12.0});
      const double expected = material.energy(H) + nu * slope.energy(H);
      EXPECT_NEAR(near.energy(H), expected, 400 * nu * nu * near.energy(H) + 1e-15 * expected) << nu;
    }
  }
}

TEST(OgdenHill, EnergyIsThatOfItsDefinition) {
  const double E = 3, nu = 0.3, alpha = 7, mu = E / (2 * (1 + nu)), beta = nu / (1 - 2 * nu);
  const OgdenHill<> material(std::array{E, nu, alpha});
  for (const auto& [a, b, c] : {std::array{0.5, 1.1, 1.4}, {1.2, 1.2, 1.2}, {0.8, 0.8, 1.3}}) {
    Tensor<double, 3> H = Tensor<double, 3>::Zero();
    H.diagonal() << a - 1, b - 1, c - 1;
    const double sum = std::pow(a, alpha) + std::pow(b, alpha) + std::pow(c, alpha) - 3,
                 volume = (std::pow(a * b * c, -alpha * beta) - 1) / beta;
    EXPECT_NEAR(material.energy(H), 2 * mu / (alpha * alpha) * (sum + volume), 1e-13);
  }
}

TEST(OgdenHill, TangentIsTheDerivativeOfTheStressWhereStretchesAreEqual) {
  const OgdenHill<> material(std::array{1.0, 0.25, 9.0});
  std::mt19937 random(3);
  for (const Eigen::Vector3d& stretches : {Eigen::Vector3d(1, 1, 1), Eigen::Vector3d(0.8, 0.8, 0.8),
                                           Eigen::Vector3d(1.2, 0.9, 0.9), Eigen::Vector3d(0.7, 0.7, 0.7 + 1e-12)}) {
    const Tensor<double, 3> Q = random_rotation<3>(random), R = random_rotation<3>(random);
    const Tensor<double, 3> H = R * stretches.asDiagonal() * Q - Tensor<double, 3>::Identity();
    const Tangent<double, 3> A = material.tangent(H);
    EXPECT_TRUE(A.allFinite());
    for (const auto& V : sample_gradients<3>(0.02)) {
      const Eigen::Matrix<double, 9, 1> change = A * Eigen::Map<const Eigen::Matrix<double, 9, 1>>(V.data());
      expect_taylor_order(
          [&](double h) {
            return (material.stress(Tensor<double, 3>(H + h * V)) - material.stress(H) -
                    h * Eigen::Map<const Eigen::Matrix3d>(change.data()))
                .norm();
          },
          2, 1e-14);
    }
  }
}

TEST(OgdenHill, SheetsHaveNoStressAcrossAndTheDerivativesOfTheirParameters) {
  const std::array theta{1.0, 0.3, 10.0};
  const PlaneStress<OgdenHill<>> sheet{OgdenHill<>(theta)};
  for (const auto& H : sample_gradients<2>(0.2, 5, 9)) {
    EXPECT_NEAR(sheet.solid.stress(embedded(H, sheet.thickness_strain(H)))(2, 2), 0.0, 1e-12);
    for (size_t j = 0; j < 3; ++j) {
      const Tensor<double, 2> slope = sheet.stress_derivative(H, OgdenHill<>::derivative(theta, static_cast<int>(j)));
      const double change = 0.05 * theta[j];
      expect_taylor_order(
          [&](double h) {
            auto moved = theta;
            moved[j] += h * change;
            const PlaneStress<OgdenHill<>> other{OgdenHill<>(moved)};
            return (other.stress(H) - sheet.stress(H) - h * change * slope).norm();
          },
          2, 1e-14);
    }
  }
}

TEST(OgdenHill, SolidsHaveTheDerivativesOfTheirEnergyInPlaneStrainPlaneStressAnd3D) {
  for (ElementShape shape : {ElementShape::tri6, ElementShape::tet4}) {
    for (Plane plane : {Plane::strain, Plane::stress}) {
      if (dimension_of(shape) == 3 && plane == Plane::stress) continue;
      ParameterTable table;
      SolidDefinition definition;
      definition.law = "ogden_hill";
      definition.plane = plane;
      for (const ParameterSpec& spec : material_parameters("ogden_hill"))
        definition.parameters.push_back(table.declare(spec));
      Mesh mesh = irregular_mesh(shape);
      auto term = make_solid(mesh, definition);
      Eigen::VectorXd u = random_state(mesh, 0.1, 0.01, 5);
      const TermUnderTest t = term_under_test(std::move(mesh), std::move(table), std::move(term),
                                              Eigen::Vector3d(3.0, 0.2, 6.0), std::move(u), "ogden_hill");
      expect_derivatives(t, 5e-4);
      expect_parameter_derivatives(t, 0.03);
      expect_projection_is_semidefinite(t);
      expect_no_net_force_or_moment(t);
    }
  }
}

TEST(OgdenHill, HasNoLockingFreeFormulation) {
  SolidDefinition definition{.law = "ogden_hill", .parameters = {0, 1, 2}, .formulation = Formulation::locking_free};
  expect_input_error([&] { make_solid(irregular_mesh(ElementShape::tri6), definition); },
                     {"'ogden_hill'", "no separate energy of volume change", "standard"});
}

}  // namespace
}  // namespace taut
