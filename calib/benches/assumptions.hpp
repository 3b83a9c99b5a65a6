#pragma once
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "calib/benches/static_replay.hpp"

namespace taut {

/// A length of a specimen, from which the model is built and for which it has no parameter.
struct Dimension {
  ParameterSpec spec;  ///< id "gap_total", "size_x"
  std::string place;   ///< in the file: "geometry.gap_total", "geometry.size.1"
  double value = 0;    ///< [m]
  std::function<void(Experiment& experiment, double value)> set;
};

/// All of an experiment that are not zero: lengths of its shape, and the thickness of a solid. Corners of boxes and
/// polygons are none, nor is anything of a mesh that is read from a file.
std::vector<Dimension> dimensions_of(const Experiment& experiment);

/// A number that a fit of readings at rest takes for granted: a dimension, a constant that is not fitted, the scale or
/// the zero of what the bench sets.
struct Assumption {
  std::string id;        ///< of the parameter, dimension or control
  double value = 0;      ///< SI; of a control 1
  double tolerance = 0;  ///< SI, of a scale relative; 0: not stated
  bool scale = false;    ///< of a control: its values are off by a factor, else by a constant
  std::string unit;      ///< SI unit of `value` and `tolerance`
};

/// What a fit with these free parameters takes for granted, in the order of the table and then of the dimensions: what
/// is not zero or has a tolerance. Throws InputError for a tolerance of what is fitted, or of no such number.
std::vector<Assumption> assumptions_of(const Experiment& experiment, const ParameterTable& table, const Params& p,
                                       const std::vector<Dimension>& dimensions);

/// The rows of an experiment's own protocol, with its dimensions as further parameters behind those of the model. They
/// have derivatives, and no other value than the file's: predict() throws std::logic_error there. Dimensions whose
/// small change makes a mesh of other elements are left out.
class DimensionedProtocol final : public Protocol {
 public:
  /// Throws InputError as make_static_replay() does.
  DimensionedProtocol(const Experiment& experiment, const Trials& trials);

  const ParameterTable& parameters() const override { return table_; }
  const Params& nominal() const override { return nominal_; }
  int row_count() const override { return replay_.protocol->row_count(); }
  Prediction predict(const Params& p, const std::vector<int>& free) override;
  int factorisations() const override { return replay_.protocol->factorisations(); }

  const StaticReplay& replay() const { return replay_; }                    ///< without dimensions
  const std::vector<Dimension>& dimensions() const { return dimensions_; }  ///< behind the model's own parameters
  const std::vector<std::string>& left_out() const { return left_out_; }    ///< "gap_total: why"

 private:
  int own_count() const { return replay_.protocol->parameters().size(); }
  struct Sides {
    std::unique_ptr<StaticProtocol> less, more;
    double apart = 0;
  };
  StaticReplay replay_;
  ParameterTable table_;
  Params nominal_;
  std::vector<Dimension> dimensions_;
  std::vector<Sides> sides_;
  std::vector<std::string> left_out_;
};

}  // namespace taut
