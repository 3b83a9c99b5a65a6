#pragma once
#include <memory>
#include <string>
#include <vector>

#include "calib/benches/specimens.hpp"
#include "calib/benches/static_bench.hpp"

namespace taut {

/// Readings at rest of several specimens, whose columns say which is which: a StaticBench each, and one protocol over
/// them all. What is drawn of a specimen is drawn of the first.
class SpecimensBench final : public Bench {
 public:
  /// Throws InputError.
  SpecimensBench(Experiment experiment, Trials trials);

  void use(const CheaperModels& models) override;
  const Trials* trials_at_rest() const override { return &trials_; }
  Protocol& protocol() const override { return *protocol_; }
  std::vector<FreeParameter> free() const override;
  std::vector<CurveRecord> curves(const Params& p, const std::vector<FreeParameter>& free,
                                  const Eigen::MatrixXd& covariance, const Ask& ask) const override;
  std::unique_ptr<Bench> with(const VariantSettings& variant) const override;
  std::unique_ptr<Bench> part(size_t control, double held) const override;
  std::unique_ptr<Bench> at_rows(const std::vector<LoadRow>& rows) const override;
  std::vector<double> values_of(size_t control) const override;
  std::string model_text() const override { return first().model_text(); }
  int unknowns() const override { return first().unknowns(); }
  std::string size_text() const override;
  Lines describe() const override;
  std::vector<std::string> warnings_before() const override;
  std::vector<std::string> warnings_after() const override;
  std::string choice() const override;
  bool one_model() const override { return first().one_model(); }
  std::optional<RowModel> model_of(int row) const override;
  std::string compare_models(const Params& p, const Eigen::VectorXd& values, double seconds) const override;
  DimensionedModel with_dimensions() const override;
  SolvedStates states() const override { return first().states(); }
  std::vector<CableState> cable_states() const override;
  std::vector<TangentStiffness> tangent_stiffness() const override;
  double as_force(size_t control, double value) const override { return first().as_force(control, value); }
  std::string effort() const override { return first().effort(); }

 private:
  StaticBench& first() const { return *parts_.front(); }
  void join_protocols();

  Trials trials_;
  std::vector<Specimen> specimens_;
  std::vector<std::unique_ptr<StaticBench>> parts_;
  std::unique_ptr<SpecimensProtocol> protocol_;
  CheaperModels models_;
};

/// The bench of an experiment at rest, of one specimen or of several. Throws InputError.
std::unique_ptr<Bench> open_static_bench(Experiment experiment, Trials trials);

}  // namespace taut
