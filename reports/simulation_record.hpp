#pragma once
#include <Eigen/Core>
#include <string>
#include <utility>
#include <vector>

#include "reports/axes.hpp"
#include "sim/contact/contact_term.hpp"
#include "sim/mesh/mesh.hpp"
#include "sim/terms/cable.hpp"

namespace taut {

/// A quantity over the samples of a simulation.
struct Series {
  std::string id;              ///< "tip_y", column name without unit
  std::string unit;            ///< SI unit as in ParameterSpec ("m", "N", "rad", "Nm", "J", "1", "s")
  std::string meaning;         ///< axis label for people
  std::vector<double> values;  ///< SI, one per sample; NaN where there is none
};

/// A line drawn through material points (a cable) or fixed in space.
struct DrawnLine {
  std::string id;
  std::vector<CablePoint> points;
};

/// A rigid surface without a mesh, see Ground.
struct DrawnGround {
  Eigen::VectorXd point, normal;  ///< [m]; into the free side, or the axis of a cylinder
  GroundKind kind = GroundKind::plane;
  double radius = 0;                        ///< of what is round [m]
  std::vector<Eigen::VectorXd> moved = {};  ///< per frame [m]; empty: it stays
  /// Where its point is in a frame [m].
  Eigen::VectorXd at(size_t frame) const { return moved.empty() ? point : Eigen::VectorXd(point + moved[frame]); }
};

/// Everything that a simulation found, as plain data: states of a mesh over time, or over a control where the run is a
/// sequence of equilibria. All files of its folder are functions of it.
struct SimulationRecord {
  std::string name, title;
  std::string description;  ///< a sentence or two, from the experiment file
  Mesh mesh;
  std::vector<DrawnLine> lines;
  std::vector<std::vector<Eigen::VectorXd>> obstacles;  ///< fixed polylines [m]
  std::vector<DrawnGround> grounds;
  std::string sample_name = "time", sample_unit = "s";  ///< what the samples run over
  std::vector<double> samples;                          ///< SI; every series has a value at each
  bool at_rest = false;  ///< a sequence of equilibria: time only orders them, and controls drive
  std::vector<Series> controls, channels;
  std::vector<int> frames;              ///< samples with a stored state, ascending
  std::vector<Eigen::VectorXd> states;  ///< u of each frame [m], all unknowns
  /// A plot that the experiment asks for. Ids are those of series; x "" or `sample_name` is the sample variable.
  struct Plot {
    std::string id, title, x;
    std::vector<std::string> y;
  };
  std::vector<Plot> plots;  ///< beside those of all channels of one unit, which come by themselves
  /// Reachable points of a chosen place in one actuation mode, with an outline [m], its area and how well that is known
  /// [m^2].
  struct Workspace {
    std::string mode;
    std::vector<Eigen::Vector2d> points;
    double area, area_error;
    std::vector<Eigen::Vector2d> outline;
  };
  std::vector<Workspace> workspaces;
  std::vector<std::pair<std::string, std::string>> facts;  ///< label and text: integrator, steps, time, checks
  std::string command_line, version, experiment_text;
};

/// Throws std::logic_error for a series whose length is not the number of samples, frames that are none, not ascending
/// or outside the samples, and states that do not fit frames or mesh; InputError for two series of one id, and for a
/// plot of a series that does not exist, with the nearest name.
void check(const SimulationRecord& record);

/// Controls, then channels; a control that is the sample variable itself is left out.
std::vector<const Series*> all_series(const SimulationRecord& record);

/// What drives a sequence of equilibria: its first control that varies. Null where time does, or nothing varies.
const Series* driver_of(const SimulationRecord& record);

/// `text` with everything but letters, digits, '-', '_' and '.' made '_': a part of a file name.
std::string file_name_of(const std::string& text);

/// Labels of the record's samples with as many digits as their range needs: "0.25 s".
class SampleLabel {
 public:
  explicit SampleLabel(const SimulationRecord& record);  ///< with the unit that suits the samples
  std::string operator()(double sample) const;           ///< "0.25 s"
  const WrittenUnit& unit() const { return unit_; }      ///< that labels are in
  int decimals() const { return decimals_; }             ///< that labels have

 private:
  WrittenUnit unit_;
  int decimals_;
};

}  // namespace taut
