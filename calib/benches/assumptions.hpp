#pragma once
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "calib/benches/dimension.hpp"
#include "calib/benches/static_replay.hpp"
#include "sim/mesh/mesh.hpp"

namespace taut {

/// All of an experiment: lengths of its shape that are not zero, the thickness of a solid, places of eyelets beside the
/// axis and of markers on it, and how a body in space stands ("turn_x", "shift_x"). Corners of boxes and polygons are
/// some where they have a tolerance or are fitted (corners.hpp); nothing of a mesh that is read from a file.
/// What a column sets is none of them.
std::vector<Dimension> dimensions_of(const Experiment& experiment);
/// The same with those that a column sets.
std::vector<Dimension> all_dimensions(const Experiment& experiment);

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

/// Forgets the tolerances of these parameters and dimensions: of what is fitted they have no effect.
void drop_tolerances(Experiment& experiment, const std::vector<std::string>& ids);

/// Those of its dimensions that an experiment fits: [fit.free.gap_total].
std::vector<Dimension> free_dimensions(const Experiment& experiment);

/// Puts a dimension behind the parameters of a model, with the file's value.
void declare(const Dimension& dimension, ParameterTable& table, Params& nominal);

/// The rows of an experiment by a model whose dimensions are parameters, too, behind its own.
struct DimensionedModel : BenchRows {
  std::unique_ptr<Protocol> protocol;
  std::vector<Dimension> dimensions;
  std::vector<std::string> left_out;  ///< "gap_total: why"

  /// What a fit of the model without some of the dimensions found, and these as the file has them.
  Params values_of(const FitResult& fit) const;
};

/// The rows of an experiment's own protocol, with dimensions as further parameters behind those of the model. The mesh
/// keeps its elements and moves with the dimensions: X = X0 + sum_k (L_k - L_k0) dX/dL_k, dX/dL_k from meshes of a
/// small change. Where a shape is not linear in a dimension (arcs) that is its first order. Where a dimension has
/// moved, prediction starts from rest. Dimensions whose small change makes a mesh of other elements are left out.
class DimensionedProtocol final : public Protocol {
 public:
  /// Throws InputError as make_static_replay() does.
  DimensionedProtocol(Experiment experiment, Trials trials, const std::vector<Dimension>& dimensions);

  const ParameterTable& parameters() const override { return table_; }
  const Params& nominal() const override { return nominal_; }
  int row_count() const override { return replay_.protocol->row_count(); }
  Prediction predict(const Params& p, const std::vector<int>& free) override;
  void forget() override { replay_.protocol->forget(); }
  void begin_search() override {
    if (dimensions_.empty()) replay_.protocol->begin_search();  // from rest it would take derivatives too lightly
  }
  void end_search() override { replay_.protocol->end_search(); }
  std::string state() const override;
  void restore(const std::string& state) override;
  std::vector<Alternative> alternatives(const Params& p) override;
  void follow(const Params& at, const std::vector<int>& rows) override;
  int factorisations() const override { return factorisations_ + replay_.protocol->factorisations(); }

  int newton_iterations() const;  ///< since construction
  /// The readings' protocol with the dimensions of the last prediction. A move to others makes a new one.
  const StaticReplay& replay() const { return replay_; }
  const std::vector<Dimension>& dimensions() const { return dimensions_; }  ///< behind the model's own parameters
  const std::vector<std::string>& left_out() const { return left_out_; }    ///< "gap_total: why"

 private:
  int own_count() const { return replay_.protocol->parameters().size(); }
  StaticReplay replay_at(const Eigen::VectorXd& lengths) const;
  void move_to(const Eigen::VectorXd& lengths);
  double step_of(size_t dimension) const;
  void add(const Dimension& dimension);
  struct Sides {
    std::unique_ptr<StaticProtocol> less, more;
  };
  const Sides& sides_of(size_t dimension);

  Experiment experiment_;
  Trials trials_;
  std::shared_ptr<const Mesh> mesh_;  ///< with the file's dimensions
  double step_ = 0;                   ///< of differences of lengths [m]
  StaticReplay replay_;
  ParameterTable table_;
  Params nominal_;
  std::vector<Dimension> dimensions_;
  std::vector<Eigen::VectorXd> moves_;  ///< dX/dL
  Eigen::VectorXd lengths_;             ///< of replay_
  std::vector<Sides> sides_;            ///< of replay_, made when they are asked for
  std::vector<std::string> left_out_;
  Params follow_at_;  ///< as follow() had them
  std::vector<int> follow_rows_;
  int factorisations_ = 0, newton_iterations_ = 0;  ///< of replays that were given up
};

}  // namespace taut
