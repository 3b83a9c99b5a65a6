#include <Eigen/LU>

#include "sim/core/parameters.hpp"
#include "sim/materials/laws.hpp"
#include "sim/materials/plane_stress.hpp"
#include "tests/support/material_battery.hpp"
#include "tests/support/message.hpp"
#include "tests/support/taylor.hpp"

namespace taut {
namespace {

using namespace test;

template <class Case>
class MaterialBattery : public ::testing::Test {};
TYPED_TEST_SUITE(MaterialBattery, AllMaterialCases, MaterialCaseName);

TYPED_TEST(MaterialBattery, RestHasNoEnergyAndNoStress) {
  constexpr int D = TypeParam::dimension;
  for (const auto& theta : sample_parameters<TypeParam>()) {
    const typename TypeParam::template Material<double> material(theta);
    const Tensor<double, D> H = Tensor<double, D>::Zero();
    EXPECT_EQ(material.energy(H), 0.0);
    EXPECT_EQ(material.stress(H).norm(), 0.0);
  }
}

TYPED_TEST(MaterialBattery, ARotationChangesNoEnergyAndTurnsTheStress) {
  constexpr int D = TypeParam::dimension;
  std::mt19937 random(2);
  for (const auto& theta : sample_parameters<TypeParam>()) {
    const typename TypeParam::template Material<double> material(theta);
    for (const auto& H : sample_gradients<D>(0.3)) {
      const Tensor<double, D> I = Tensor<double, D>::Identity(), Q = random_rotation<D>(random);
      const Tensor<double, D> turned = Q * (I + H) - I;
      const double scale = material.tangent(H).norm();
      EXPECT_NEAR(material.energy(turned), material.energy(H), 1e-14 * scale);
      EXPECT_NEAR((material.stress(turned) - Q * material.stress(H)).norm(), 0.0, 3e-14 * scale);
    }
    EXPECT_NEAR(material.energy(Tensor<double, D>(random_rotation<D>(random) - Tensor<double, D>::Identity())), 0.0,
                1e-14 * theta[0]);
  }
}

TYPED_TEST(MaterialBattery, StressIsTheDerivativeOfTheEnergyToTheLastDigits) {
  constexpr int D = TypeParam::dimension;
  for (const auto& theta : sample_parameters<TypeParam>()) {
    using Jet = ceres::Jet<double, D * D>;
    const typename TypeParam::template Material<double> material(theta);
    const typename TypeParam::template Material<Jet> differentiated(as<Jet>(theta));
    for (double size : strain_sizes) {
      for (const auto& H : sample_gradients<D>(size)) {
        const Jet energy = differentiated.energy(with_infinitesimals<D>(H));
        const Tensor<double, D> P = material.stress(H);
        EXPECT_NEAR(energy.a, material.energy(H), 1e-13 * energy.a);
        EXPECT_LE((Eigen::Map<const Tensor<double, D>>(energy.v.data()) - P).norm(), 1e-12 * P.norm())
            << "strain " << size << ", last parameter " << theta.back();
      }
    }
  }
}

TYPED_TEST(MaterialBattery, TangentIsTheDerivativeOfTheStressToTheLastDigitsAndSymmetric) {
  constexpr int D = TypeParam::dimension;
  for (const auto& theta : sample_parameters<TypeParam>()) {
    using Jet = ceres::Jet<double, D * D>;
    const typename TypeParam::template Material<double> material(theta);
    const typename TypeParam::template Material<Jet> differentiated(as<Jet>(theta));
    for (double size : strain_sizes) {
      for (const auto& H : sample_gradients<D>(size)) {
        const Tensor<Jet, D> P = differentiated.stress(with_infinitesimals<D>(H));
        Tangent<double, D> expected;
        for (int i = 0; i < D * D; ++i) expected.row(i) = P.data()[i].v.transpose();
        const Tangent<double, D> A = material.tangent(H);
        EXPECT_LE((A - expected).norm(), 1e-13 * A.norm()) << "strain " << size;
        EXPECT_LE((A - A.transpose()).norm(), 1e-15 * A.norm());
      }
    }
  }
}

TYPED_TEST(MaterialBattery, SmallStrainsLoseNoDigits) {
  constexpr int D = TypeParam::dimension;
  for (const auto& theta : sample_parameters<TypeParam>()) {
    using Long = long double;
    const typename TypeParam::template Material<double> material(theta);
    const typename TypeParam::template Material<Long> precise(as<Long>(theta));
    for (double size : strain_sizes) {
      for (const auto& H : sample_gradients<D>(size)) {
        const Tensor<Long, D> same = H.template cast<Long>();
        const Tensor<double, D> P = precise.stress(same).template cast<double>();
        EXPECT_NEAR(material.energy(H), static_cast<double>(precise.energy(same)), 1e-13 * material.energy(H)) << size;
        EXPECT_LE((material.stress(H) - P).norm(), 1e-12 * P.norm()) << size;
      }
    }
  }
}

TYPED_TEST(MaterialBattery, ParameterDerivativesAreThoseOfEnergyAndStress) {
  constexpr int D = TypeParam::dimension;
  for (const auto& theta : sample_parameters<TypeParam>()) {
    using Jet = ceres::Jet<double, static_cast<int>(TypeParam::parameter_count)>;
    const typename TypeParam::template Material<Jet> differentiated(with_infinitesimals(theta));
    for (size_t j = 0; j < theta.size(); ++j) {
      const auto derivative = TypeParam::template Material<double>::derivative(theta, static_cast<int>(j));
      for (double size : strain_sizes) {
        for (const auto& H : sample_gradients<D>(size)) {
          const Tensor<Jet, D> constant = H.template cast<Jet>();
          const double energy = differentiated.energy(constant).v[static_cast<Eigen::Index>(j)];
          EXPECT_NEAR(derivative.energy(H), energy, 1e-12 * std::abs(energy)) << "parameter " << j;
          const Tensor<Jet, D> P = differentiated.stress(constant);
          Tensor<double, D> expected;
          for (int i = 0; i < D * D; ++i) expected.data()[i] = P.data()[i].v[static_cast<Eigen::Index>(j)];
          EXPECT_LE((derivative.stress(H) - expected).norm(), 1e-12 * expected.norm()) << "parameter " << j;
        }
      }
    }
  }
}

/// E and nu by their declared ids.
template <class Case>
std::pair<double, double> young_and_poisson(const typename Case::Theta& theta) {
  double E = NAN, nu = NAN;
  const auto specs = Case::template Material<double>::parameters();
  for (size_t j = 0; j < specs.size(); ++j) {
    if (specs[j].id == "E") E = theta[j];
    if (specs[j].id == "nu") nu = theta[j];
  }
  return {E, nu};
}

TYPED_TEST(MaterialBattery, SmallStrainIsHookesLawWithTheSameModulusAndPoissonRatio) {
  constexpr int D = TypeParam::dimension;
  for (const auto& theta : sample_parameters<TypeParam>()) {
    const auto [E, nu] = young_and_poisson<TypeParam>(theta);
    ASSERT_TRUE(std::isfinite(E) && std::isfinite(nu)) << "a law without E and nu needs its own small-strain test";
    const typename TypeParam::template Material<double> material(theta);
    const double shear = E / (2 * (1 + nu)), lame = E * nu / ((1 + nu) * (1 - 2 * nu));
    const Tensor<double, D> I = Tensor<double, D>::Identity();
    const auto hooke = [&](const Tensor<double, D>& H) -> Tensor<double, D> {
      return shear * (H + H.transpose()) + lame * H.trace() * I;
    };
    const Tangent<double, D> A = material.tangent(Tensor<double, D>(Tensor<double, D>::Zero()));
    for (const auto& H : sample_gradients<D>(1.0)) {
      const Tensor<double, D> stress = hooke(H);
      const Eigen::Matrix<double, D * D, 1> product = A * Eigen::Map<const Eigen::Matrix<double, D * D, 1>>(H.data());
      EXPECT_LE((Eigen::Map<const Tensor<double, D>>(product.data()) - stress).norm(), 1e-13 * A.norm() * H.norm());
      // The law itself leaves Hooke's by the square of the strain.
      const double scale = A.norm() * H.norm();
      expect_taylor_order(
          [&](double h) { return (material.stress(Tensor<double, D>(h * H)) - h * stress).norm() / scale; }, 2, 0,
          1e-4);
    }
  }
}

TYPED_TEST(MaterialBattery, PlaneStrainIsThe3DLawWithoutOutOfPlaneStrain) {
  if constexpr (TypeParam::dimension == 2) {
    for (const auto& theta : sample_parameters<TypeParam>()) {
      const typename TypeParam::template Material<double> material(theta);
      for (double size : strain_sizes) {
        for (const auto& H : sample_gradients<2>(size)) {
          const Tensor<double, 3> full = embedded(H);
          EXPECT_NEAR(material.energy(H), material.energy(full), 1e-12 * material.energy(H)) << size;
          const Tensor<double, 2> P = material.stress(H);
          EXPECT_LE((P - material.stress(full).template topLeftCorner<2, 2>()).norm(), 1e-12 * P.norm()) << size;
          const Tangent<double, 2> A = material.tangent(H);
          const Tangent<double, 3> B = material.tangent(full);
          for (int a = 0; a < 4; ++a) {
            for (int b = 0; b < 4; ++b) {
              EXPECT_NEAR(A(a, b), B(a % 2 + 3 * (a / 2), b % 2 + 3 * (b / 2)), 1e-14 * A.norm());
            }
          }
        }
      }
    }
  }
}

TYPED_TEST(MaterialBattery, AnInvertedOrFlatElementHasInfiniteEnergy) {
  constexpr int D = TypeParam::dimension;
  const double infinity = std::numeric_limits<double>::infinity();
  for (const auto& theta : sample_parameters<TypeParam>()) {
    const typename TypeParam::template Material<double> material(theta);
    Tensor<double, D> H = Tensor<double, D>::Zero();
    for (double entry : {-1.0, -1.5, -3.0}) {
      H(D - 1, D - 1) = entry;
      EXPECT_EQ(material.energy(H), infinity) << entry;
    }
    H(D - 1, D - 1) = -1.0 + 1e-3;
    EXPECT_TRUE(std::isfinite(material.energy(H)));
    H(D - 1, D - 1) = -1.0 + 1e-9;  // a high power of 1/J may exceed all numbers there
    EXPECT_FALSE(std::isnan(material.energy(H)));
    H(0, 0) = NAN;
    EXPECT_FALSE(std::isfinite(material.energy(H)));
  }
}

TYPED_TEST(MaterialBattery, EveryBoundOfEveryParameterIsRejectedWithItsName) {
  for (const ParameterSpec& spec : TypeParam::template Material<double>::parameters()) {
    ParameterTable table;
    table.declare(spec);
    EXPECT_FALSE(spec.meaning.empty());
    EXPECT_FALSE(spec.unit.empty());
    ASSERT_TRUE(std::isfinite(spec.lower) && std::isfinite(spec.upper) && spec.lower < spec.upper);
    EXPECT_NO_THROW(table.check(0, spec.lower));
    EXPECT_NO_THROW(table.check(0, spec.upper));
    const double beyond = 1e-6 * (spec.upper - spec.lower);
    for (double wrong : {spec.lower - beyond, spec.upper + beyond, double(NAN), double(INFINITY)}) {
      expect_input_error([&] { table.check(0, wrong); }, {spec.id + " = ", "physical range", spec.meaning});
    }
  }
}

/// Homogeneous states with free sides, E = 1, nu = 0.3 (Newton's method on the free stretch).
struct Stretch {
  double along, across, stress;
};
template <int D>
Tensor<double, D> free_sides(const NeoHookean<>& material, double along) {
  Tensor<double, D> H = Tensor<double, D>::Zero();
  H(0, 0) = along - 1;
  for (int iteration = 0; iteration < 30; ++iteration) {
    const auto A = material.tangent(H);
    const double slope = A(D + 1, D + 1) + (D == 3 ? A(4, 8) : 0.0);
    const double step = -material.stress(H)(1, 1) / slope;
    for (int i = 1; i < D; ++i) H(i, i) += step;
  }
  EXPECT_NEAR(material.stress(H)(1, 1), 0.0, 1e-15);
  return H;
}

TEST(NeoHookean, PlaneStrainWithFreeSidesHasTheTabulatedStress) {
  const NeoHookean<> material(std::array{1.0, 0.3});
  for (const auto& [along, across, stress] :
       {Stretch{0.9, 1.044997, -0.120521}, {0.7, 1.150796, -0.458424}, {0.5, 1.288305, -1.084407}}) {
    const Tensor<double, 2> H = free_sides<2>(material, along);
    EXPECT_NEAR(1 + H(1, 1), across, 6e-7);
    EXPECT_NEAR(material.stress(H)(0, 0), stress, 6e-7);
  }
}

TEST(NeoHookean, ConfinedCompressionHasTheTabulatedStress) {
  const NeoHookean<> material(std::array{1.0, 0.3});
  for (const auto& [along, across, stress] : {Stretch{0.9, 1, -0.148735}, {0.7, 1, -0.574183}, {0.5, 1, -1.376708}}) {
    Tensor<double, 2> H = Tensor<double, 2>::Zero();
    H(0, 0) = along - 1;
    EXPECT_NEAR(material.stress(H)(0, 0), stress, 6e-7);
    EXPECT_NEAR(material.stress(embedded(H))(0, 0), stress, 6e-7);
  }
}

TEST(NeoHookean, UniaxialTensionIn3DHasTheTabulatedStress) {
  const NeoHookean<> material(std::array{1.0, 0.3});
  for (const auto& [along, across, stress] :
       {Stretch{0.9, 1.031702, -0.108722}, {0.7, 1.107935, -0.405230}, {0.5, 1.210767, -0.935352}}) {
    const Tensor<double, 3> H = free_sides<3>(material, along);
    EXPECT_NEAR(1 + H(1, 1), across, 6e-7);
    EXPECT_NEAR(material.stress(H)(0, 0), stress, 6e-7);
  }
}

TEST(NeoHookean, WithoutPoissonEffectTheStressIsHalfOfStretchMinusItsInverse) {
  const NeoHookean<> material(std::array{1.0, 0.0});
  for (double along : {0.2, 0.5, 0.9, 1.5, 3.0}) {
    const Tensor<double, 3> H = free_sides<3>(material, along);
    EXPECT_NEAR(H(1, 1), 0.0, 1e-15);
    EXPECT_NEAR(material.stress(H)(0, 0), 0.5 * (along - 1 / along), 1e-15);
  }
}

TEST(NeoHookean, VolumetricPartIsSplitOffCompletely) {
  const NeoHookean<> material(std::array{1e5, 0.45});
  for (const auto& H : sample_gradients<3>(0.3)) {
    const double ln_j = std::log1p(jacobian_minus_one<double, 3>(H));
    EXPECT_NEAR(material.energy(H),
                material.without_volume().energy(H) + 0.5 * material.volumetric_modulus() * ln_j * ln_j, 1e-9);
  }
}

TEST(PlaneStress, HasNoStressAcrossTheSheet) {
  for (double nu : {-0.5, 0.0, 0.3, 0.499}) {
    const PlaneStress<NeoHookean<>> sheet{NeoHookean<>(std::array{1.0, nu})};
    for (double size : strain_sizes) {
      for (const auto& H : sample_gradients<2>(size, 8)) {
        const double strain = sheet.thickness_strain(H);
        EXPECT_NEAR(sheet.solid.stress(embedded(H, strain))(2, 2), 0.0,
                    1e-12 * sheet.solid.tangent(embedded(H))(8, 8) * size);
        EXPECT_LE((sheet.stress(H) - sheet.solid.stress(embedded(H, strain)).topLeftCorner<2, 2>()).norm(), 1e-15);
        EXPECT_EQ(sheet.energy(H), sheet.solid.energy(embedded(H, strain)));
      }
    }
  }
}

TEST(PlaneStress, SolvesForExtremeStretches) {
  const PlaneStress<NeoHookean<>> sheet{NeoHookean<>(std::array{1.0, 0.49})};
  for (double first : {0.05, 0.3, 4.0, 10.0}) {
    for (double second : {0.05, 1.0, 10.0}) {
      Tensor<double, 2> H = Tensor<double, 2>::Zero();
      H.diagonal() << first - 1, second - 1;
      const double strain = sheet.thickness_strain(H);
      EXPECT_GT(strain, -1.0) << first << " " << second;
      EXPECT_NEAR(sheet.solid.stress(embedded(H, strain))(2, 2), 0.0, 1e-11) << first << " " << second;
    }
  }
}

TEST(PlaneStress, UniaxialTensionOfASheetIsThatOf3D) {
  const NeoHookean<> solid(std::array{1.0, 0.3});
  const PlaneStress<NeoHookean<>> sheet{solid};
  for (double along : {0.5, 0.9, 1.3, 2.0}) {
    const Tensor<double, 3> full = free_sides<3>(solid, along);
    const Tensor<double, 2> H = full.topLeftCorner<2, 2>();
    EXPECT_NEAR(sheet.thickness_strain(H), full(2, 2), 1e-14);
    EXPECT_LE((sheet.stress(H) - solid.stress(full).topLeftCorner<2, 2>()).norm(), 1e-14);
  }
}

TEST(PlaneStress, AnInvertedSheetHasInfiniteEnergy) {
  const PlaneStress<NeoHookean<>> sheet{NeoHookean<>(std::array{1.0, 0.3})};
  Tensor<double, 2> H = Tensor<double, 2>::Zero();
  H(0, 0) = -1.2;
  EXPECT_EQ(sheet.energy(H), std::numeric_limits<double>::infinity());
}

TEST(PlaneStress, StressAndTangentAreTheDerivativesOfTheEnergy) {
  const PlaneStress<NeoHookean<>> sheet{NeoHookean<>(std::array{1.0, 0.4})};
  const auto directions = sample_gradients<2>(0.1, 5, 7);
  const auto states = sample_gradients<2>(0.25, 5, 8);
  for (size_t i = 0; i < states.size(); ++i) {
    const Tensor<double, 2>&H = states[i], &V = directions[i];
    const Eigen::Vector4d v = Eigen::Map<const Eigen::Vector4d>(V.data()), change = sheet.tangent(H) * v;
    const double first = (sheet.stress(H).array() * V.array()).sum(), second = v.dot(change);
    const auto at = [&](double h) { return Tensor<double, 2>(H + h * V); };
    expect_taylor_order([&](double h) { return std::abs(sheet.energy(at(h)) - sheet.energy(H) - h * first); }, 2,
                        1e-15);
    expect_taylor_order(
        [&](double h) { return std::abs(sheet.energy(at(h)) - sheet.energy(H) - h * first - 0.5 * h * h * second); }, 3,
        1e-15);
    expect_taylor_order(
        [&](double h) {
          return (sheet.stress(at(h)) - sheet.stress(H) - h * Eigen::Map<const Eigen::Matrix2d>(change.data())).norm();
        },
        2, 1e-15);
    EXPECT_LE((sheet.tangent(H) - sheet.tangent(H).transpose()).norm(), 1e-15);
  }
}

TYPED_TEST(MaterialBattery, TheModulusAtRestIsThatOfSmallStrain) {
  for (const auto& theta : sample_parameters<TypeParam>()) {
    const typename TypeParam::template Material<double> material(theta);
    // Stretched by a little with free sides: nominal stress over strain.
    const Tangent<double, 3> A = material.tangent(Tensor<double, 3>(Tensor<double, 3>::Zero()));
    const double sides = -A(0, 4) / (A(4, 4) + A(4, 8)), strain = 1e-7;
    const Tensor<double, 3> H = strain * Eigen::Vector3d(1, sides, sides).asDiagonal();
    EXPECT_NEAR(material.stress(H)(0, 0) / strain / modulus_at_rest(A), 1, 2e-3);
  }
}

TEST(Laws, AConstantEIsTheModulusAndALawByOtherConstantsHasOneToo) {
  EXPECT_EQ(youngs_modulus("neo_hookean", {{"E", 1e5}, {"nu", 0.3}}), 1e5);
  EXPECT_EQ(youngs_modulus("ogden_hill", {{"E", 2e4}, {"nu", 0.1}, {"alpha", 5}}), 2e4);
  const double E = 1e5, nu = 0.3;  // by Lame's constants instead
  const NeoHookean<> lame(E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu)));
  EXPECT_NEAR(modulus_at_rest(lame.tangent<3>(Tensor<double, 3>::Zero())) / E, 1, 1e-14);
}

TEST(PlaneStress, StressDerivativeFollowsTheParameters) {
  const std::array theta{1.0, 0.35};
  const PlaneStress<NeoHookean<>> sheet{NeoHookean<>(theta)};
  const std::array change{0.3, 0.08};
  for (const auto& H : sample_gradients<2>(0.25, 5, 9)) {
    for (size_t j = 0; j < 2; ++j) {
      const Tensor<double, 2> slope = sheet.stress_derivative(H, NeoHookean<>::derivative(theta, static_cast<int>(j)));
      expect_taylor_order(
          [&](double h) {
            auto moved = theta;
            moved[j] += h * change[j];
            const PlaneStress<NeoHookean<>> other{NeoHookean<>(moved)};
            return (other.stress(H) - sheet.stress(H) - h * change[j] * slope).norm();
          },
          2, 1e-14);
    }
  }
}

}  // namespace
}  // namespace taut
