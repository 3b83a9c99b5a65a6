#pragma once
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "calib/benches/bench.hpp"
#include "calib/benches/uniaxial.hpp"
#include "calib/data/trials.hpp"

namespace taut {

extern const BenchKind material_point_kind;  ///< its row in the table of kinds

/// Homogeneous tests on a material, without a mesh: geometry kind "uniaxial". Channels are modes of loading, readings
/// nominal stresses [Pa] over the strain.
class MaterialPointBench final : public Bench {
 public:
  /// Throws InputError.
  MaterialPointBench(Experiment experiment, Trials trials);

  Protocol& protocol() const override { return *protocol_; }
  std::vector<FreeParameter> free() const override { return free_parameters_of_law(experiment_, *protocol_); }
  std::vector<FreeParameter> starts_after(const FitResult& /*main*/) const override { return free(); }
  std::vector<CurveRecord> curves(const Params& p, const std::vector<FreeParameter>& free,
                                  const Eigen::MatrixXd& covariance, const Ask& ask) const override;
  bool draws_variants() const override { return true; }
  std::unique_ptr<Bench> with(const VariantSettings& variant) const override;
  std::string fit_name() const override { return experiment_.materials.front().law; }
  std::string model_text() const override;
  int unknowns() const override { return static_cast<int>(measurements_.size()); }
  std::string size_text() const override;
  Lines describe() const override;
  std::string effort() const override { return "closed form"; }

 private:
  /// The fit called `name` (of the experiment itself: "") of a law to the readings of some modes.
  MaterialPointBench(Experiment experiment, Trials trials, const VariantSettings& variant);
  std::unique_ptr<UniaxialProtocol> protocol_of(std::vector<PointRow> rows) const;

  Trials trials_;
  VariantSettings fit_;
  PointReplay rows_;
  std::unique_ptr<UniaxialProtocol> protocol_;
};

}  // namespace taut
