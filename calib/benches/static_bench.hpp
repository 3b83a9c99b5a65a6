#pragma once
#include <memory>
#include <string>
#include <vector>

#include "calib/benches/assumptions.hpp"
#include "calib/benches/bench.hpp"
#include "calib/benches/static_replay.hpp"

namespace taut {

extern const BenchKind static_kind;  ///< its row in the table of kinds
/// Reads [bench] of readings at rest. Throws InputError.
void read_readings(TableReader& root, Experiment& experiment);

/// An experiment with what a [[fit.variant]] changes.
Experiment changed_by(Experiment changed, const VariantSettings& variant);
/// The readings at one value of a control.
Trials trials_at(Trials trials, size_t control, double held);
/// All channels at the controls of these rows, with what `there` knows besides readings.
Trials trials_at_rows(const Experiment& experiment, Trials there, const std::vector<LoadRow>& rows);

/// Readings at rest: loads, prescribed displacements and retractions in the columns of one file. With
/// model = "rigid_segments" or "solid" that model is the full one here.
class StaticBench final : public Bench {
 public:
  /// Throws InputError.
  StaticBench(Experiment experiment, Trials trials);

  void use(const CheaperModels& models) override;
  const Trials* trials_at_rest() const override { return &trials_; }
  Protocol& protocol() const override { return choice_.protocol ? *choice_.protocol : *protocol_; }
  std::vector<FreeParameter> better_starts(const std::vector<FreeParameter>& free) const override;
  std::vector<CurveRecord> curves(const Params& p, const std::vector<FreeParameter>& free,
                                  const Eigen::MatrixXd& covariance, const Ask& ask) const override;
  std::unique_ptr<Bench> with(const VariantSettings& variant) const override;
  std::unique_ptr<Bench> part(size_t control, double held) const override;
  std::unique_ptr<Bench> at_rows(const std::vector<LoadRow>& rows) const override;
  std::vector<double> values_of(size_t control) const override;
  std::string model_text() const override { return model_text_; }
  int unknowns() const override {
    return choice_.unknowns > 0 ? choice_.unknowns : model().scene().model->free_unknowns();
  }
  std::string size_text() const override;
  Lines describe() const override;
  std::vector<std::string> warnings_before() const override;
  std::vector<std::string> warnings_after() const override;
  std::string choice() const override { return choice_.sentence; }
  bool one_model() const override { return !choice_.protocol || choice_.one_model; }
  DimensionedModel with_dimensions() const override;
  DimensionedModel with_dimensions(const std::vector<Dimension>& dimensions) const;  ///< with these alone
  std::optional<RowModel> model_of(int row) const override {
    return choice_.model_of ? std::optional(choice_.model_of(row)) : std::nullopt;
  }
  std::string compare_models(const Params& p, const Eigen::VectorXd& values, double seconds) const override;
  SolvedStates states() const override;
  std::vector<CableState> cable_states() const override;
  std::vector<int> slipped_rows() const override;
  std::vector<TangentStiffness> tangent_stiffness() const override;
  double as_force(size_t control, double value) const override;
  std::string effort() const override;

 private:
  const StaticReplay& replay() const { return protocol_->replay(); }
  const StaticProtocol& model() const { return *replay().protocol; }
  void check_free(const VariantSettings& variant) const;
  bool touches(const StaticProtocol::Condition& condition) const;
  void find_axes();
  void find_readings();
  std::string series_of(const std::vector<double>& controls) const;
  std::string describe_controls(const std::vector<double>& controls) const;
  std::vector<double> curve_loads() const;
  std::string times_text() const;
  Lines load_lines() const;
  std::string cables_text() const;
  std::string contact_text() const;
  std::string studs_text() const;
  std::vector<std::string> sides_taken() const;
  std::vector<std::string> held_by(const Eigen::VectorXd& gradient) const;
  void refuse_held_channels() const;
  std::vector<std::string> held_loads() const;

  Trials trials_;
  std::unique_ptr<DimensionedProtocol> protocol_;  ///< of the full model, with the dimensions that are free
  ModelChoice choice_;
  CheaperModels models_;
  std::string model_text_;
};

}  // namespace taut
