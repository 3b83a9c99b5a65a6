#pragma once
#include <memory>
#include <string>
#include <vector>

#include "calib/benches/bench.hpp"
#include "calib/benches/recordings.hpp"

namespace taut {

extern const BenchKind recordings_kind;  ///< its row in the table of kinds

/// Motions over time: [bench] with kind = "recordings". One row per sample.
class RecordingsBench final : public Bench {
 public:
  /// Throws InputError.
  explicit RecordingsBench(Experiment experiment);
  RecordingsBench(Experiment experiment, std::vector<Sample> samples);  ///< with samples that were read already

  Protocol& protocol() const override { return *replay_.protocol; }
  std::vector<CurveRecord> curves(const Params& p, const std::vector<FreeParameter>& free,
                                  const Eigen::MatrixXd& covariance, const Ask& ask) const override;
  std::vector<SwingRecord> swings(const Eigen::VectorXd& predicted) const override;
  std::unique_ptr<Bench> with(const VariantSettings& variant) const override;
  std::string model_text() const override { return experiment_.mesh.describe(); }
  int unknowns() const override { return replay_.protocol->scene().model->free_unknowns(); }
  std::string size_text() const override;
  Lines describe() const override;
  std::string effort() const override;
  std::vector<std::string> warnings_before() const override { return replay_.protocol->scene().model->mesh().remarks; }

 private:
  const std::string& recording(const Sample& sample) const;
  /// Index behind the last sample of the same recording and channel.
  size_t end_of(size_t first) const;
  std::string recording_text(size_t index) const;

  std::vector<Sample> samples_;
  RecordingReplay replay_;
};

}  // namespace taut
