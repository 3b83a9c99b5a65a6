#pragma once
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "calib/benches/experiment.hpp"
#include "calib/benches/mullins.hpp"
#include "calib/data/trials.hpp"
#include "calib/fit/fit.hpp"
#include "calib/fit/protocol.hpp"

namespace taut {

/// How a material point is loaded. Tension and compression differ in the sign of the strain only.
enum class PointMode { tension, compression, shear };
/// "tension", "compression", "shear": the ids under which a bench file names them.
std::string_view name_of(PointMode mode);
std::vector<std::string> mode_names();  ///< of all modes, in their order
/// The reverse, of a name that is one of those.
PointMode mode_named(const std::string& name);

/// A point of a stress-strain curve.
struct PointRow {
  PointMode mode = PointMode::tension;
  double strain = 0;  ///< engineering strain s - 1 (compression < 0), or the amount of shear
  double peak = 0;    ///< that of largest size which the specimen has seen before; counts with softening only
};

/// Homogeneous tests on one material, without a mesh. Predicts the nominal stress [Pa], force per rest area:
///
///   tension, compression:  P_11 at F = diag(s, a, a), a such that the sides are free: P_22 = 0 (Newton's method),
///   shear:                 P_12 at F = I + g e_1 e_2^T, the plates keeping their distance.
///
/// With softening by the first loading P is that times eta of Softening, W_max at the larger one of strain and peak: W
/// grows with the size of the strain. dW/dtheta at free sides is that at fixed F, since these do no work.
///
/// dP_11/dtheta at free sides is that at fixed F minus (dP_11/da) (dP_22/dtheta) / (dP_22/da) (implicit function
/// theorem). Parameters are the law's constants, "<constant>_<region>", then with softening "mullins_r_<region>" [-],
/// "mullins_m_<region>" [Pa = J/m^3] and "mullins_beta_<region>" [-]. Valid where deformation is homogeneous: sides
/// that slide freely on the platens, specimens long (tension) or flat (shear) enough. A prediction whose free sides are
/// not found is NaN and a failure.
class UniaxialProtocol final : public Protocol {
 public:
  /// Throws InputError for an unknown law, and for a constant that is missing, unknown or outside its physical range.
  UniaxialProtocol(const std::string& region, const std::string& law, const std::map<std::string, double>& constants,
                   std::vector<PointRow> rows, const std::optional<Mullins>& mullins = {});

  const ParameterTable& parameters() const override { return table_; }
  const Params& nominal() const override { return nominal_; }
  int row_count() const override { return static_cast<int>(rows_.size()); }
  Prediction predict(const Params& p, const std::vector<int>& free) override;

 private:
  std::string law_;
  int softening_ = -1;  ///< table index of the first of its parameters; -1: none
  ParameterTable table_;
  Params nominal_;
  std::vector<PointRow> rows_;
};

/// Readings of a bench as rows: one per distinct (mode, strain), with softening also by peak; readings of one row are
/// repeats.
struct PointReplay {
  std::vector<PointRow> rows;
  std::vector<Measurement> measurements;  ///< one per reading
};

/// Throws InputError for tension with a negative and compression with a positive strain, and strains of -100 % or less.
/// With `softening` each trial (without a column of them all readings) of a mode is one specimen, which sees its
/// strains, those of readings that are not fitted included, in the order of the second control where there is one, else
/// in that of the file.
PointReplay make_point_replay(const BenchFormat& format, const Trials& trials, bool softening = false);

/// The free parameters of `experiment` that the protocol's law has, with starts and bounds. Throws as free_parameters()
/// does.
std::vector<FreeParameter> free_parameters_of_law(const Experiment& experiment, const Protocol& protocol);

}  // namespace taut
