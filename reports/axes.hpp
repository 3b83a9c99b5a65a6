#pragma once
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "calib/runs/run_record.hpp"

namespace taut {

/// "50 g", or the name that a number stands for.
std::string text_of(const AxisRecord& control, double value);

/// The unit in which a quantity of this SI unit is written to CSV files: millimetres, degrees, kilopascals, cm2, else
/// SI. `suffix` ends a column name as parse_header() reads it ("N_per_m"); `label` is empty for pure numbers.
struct WrittenUnit {
  std::string suffix, label;
  double factor;                                              ///< SI value of one unit
  bool operator==(const WrittenUnit& other) const = default;  ///< same unit
};
WrittenUnit written_unit(const std::string& si_unit);  ///< see WrittenUnit

/// The same for figures: forces, torques, energies and times whose largest size is below 0.1 get a thousandth.
WrittenUnit shown_unit(const std::string& si_unit, double largest);

/// The unit that fits `values`.
WrittenUnit shown_unit(const std::string& si_unit, const std::vector<double>& values);

/// A unit as the end of a column's name: "N/m" is "N_per_m".
std::string column_suffix(const std::string& unit);

/// "displacement [mm]"; one of the two alone where the other is empty.
std::string bracketed(const std::string& text, const std::string& unit);

bool is(const AxisRecord& axis, Quantity quantity);  ///< whether it is an axis of this quantity

/// What curves and figures run over: the control of the load, else the first one; without controls an empty axis.
const AxisRecord& drawn_control(const RunRecord& record);
/// Readings are samples of recordings.
bool over_time(const RunRecord& record);
/// Readings are those of a material point: they run over a strain.
bool over_strain(const RunRecord& record);

/// Throws std::logic_error for a channel that is not among RunRecord::channels.
const AxisRecord& channel_axis(const RunRecord& record, const std::string& channel);

/// The units of a record's readings, and how they stand in CSV files: in the names of the columns where all channels
/// have the same ("displacement_mm", "sigma_mm"), else in a last column "unit" ("value", "sigma").
class ReadingUnits {
 public:
  /// As CSV files have them, or all in SI.
  enum Kind { written, si };
  explicit ReadingUnits(const RunRecord& record, Kind kind = written);  ///< of all channels of a record
  /// Throws std::logic_error for a channel that is not among RunRecord::channels.
  const WrittenUnit& of(const std::string& channel) const;
  /// What all channels have; nullopt where they differ, or there are none.
  const std::optional<WrittenUnit>& common() const { return common_; }
  /// What all channels are called: "displacement"; "value" where they differ.
  const std::string& what() const { return what_; }
  std::string column(const std::string& name) const;  ///< head of a column: "sigma_mm", or "sigma"
  /// The line of heads, with the column "unit" where it is needed.
  std::string heads(const std::string& line) const { return ended(line, "unit"); }
  /// A line of this channel, with its unit where it is needed.
  std::string row(const std::string& line, const std::string& channel) const { return ended(line, of(channel).suffix); }

 private:
  std::string ended(std::string line, const std::string& unit) const;

  std::map<std::string, WrittenUnit> units_;
  std::optional<WrittenUnit> common_;
  std::string what_ = "value";
};

/// What stands in tables beside SI: the same numbers in the units of the bench's own file, controls under the heads
/// that they have there ("mass_g"), readings under names that end in the file's unit ("predicted_mm"). Where channels
/// have different units, under "predicted_in_file" and so on, with the unit in a last column "unit_in_file". Nothing of
/// what the file has in SI, or without a unit.
class BenchColumns {
 public:
  /// `names`: of the numbers that have the unit of a channel.
  BenchColumns(const RunRecord& record, const std::vector<std::string>& names);
  const std::string& heads() const { return heads_; }  ///< each with a comma before it; "": there are none
  /// The fields below them; `values` has a number [SI] for each of the names.
  std::string fields(const std::vector<double>& controls, const std::string& channel,
                     const std::vector<double>& values) const;

 private:
  struct Unit {
    std::string name;
    double factor;  ///< SI value of one
  };
  std::vector<std::pair<size_t, double>> controls_;  ///< which, and the SI value of one unit
  std::map<std::string, Unit> channels_;
  bool readings_ = false, units_ = false;  ///< whether readings, and their units, stand there
  std::string heads_;
};

}  // namespace taut
