#pragma once
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "sim/core/numbers.hpp"
#include "sim/core/units.hpp"

namespace taut {

/// When a reading was taken, in benches whose readings depend on that.
struct Turn {
  int place = -1;    ///< in the order of the bench, which readings that were taken together share; -1: from rest
  double dwell = 0;  ///< [s] for which its load had acted
  double rest = 0;   ///< [s] without load before that
  double read = 0;   ///< [s] after which that load, not taken off since, was read before; 0: it was hung anew
  bool operator==(const Turn&) const = default;  ///< as a whole
};

/// One measured number, with where it stands in its file.
struct Reading {
  int line = 0;                  ///< line in the CSV file, the header is line 1
  std::string trial;             ///< repeat it belongs to, "" when the file has no trial column
  std::vector<double> controls;  ///< SI values, in the order of Trials::control_ids
  int channel = 0;               ///< index into Trials::channel_ids
  double value = 0;              ///< SI
  double sigma = 0;              ///< standard deviation, SI, > 0
  bool excluded = false;         ///< shown, but not fitted
  double order = not_a_number;   ///< its place in the sequence of all; NaN: the file does not say
  Turn turn = {};                ///< where BenchFormat::History counts
};

/// What an instrument is good for: sigma^2 = absolute^2 + (relative * reading)^2 + resolution^2 / 12.
struct InstrumentNoise {
  double absolute = 0;                 ///< SI unit of the channel
  double relative = 0;                 ///< fraction of the reading
  double resolution = 0;               ///< last digit, SI unit of the channel; rounding is uniform, hence / 12
  double sigma(double reading) const;  ///< standard deviation at a reading [SI]
  bool given() const { return absolute != 0 || relative != 0 || resolution != 0; }  ///< whether there is any
};

/// Which column of a bench file means what. Column names are headers as they stand in the file, unit included.
struct BenchFormat {
  /// A column of what was set.
  struct Control {
    std::string id;                    ///< name of the load or actuation in the experiment
    std::string column;                ///< e.g. "tip_load_N" or "mass_g"
    std::vector<Quantity> quantities;  ///< what the unit may be; several are told apart by Trials::control_quantities
    bool pulls = false;                ///< a tension, which is never negative
    std::vector<std::string> labels = {};  ///< its cells are these texts, its values their numbers from 1
    std::string label_is = {};             ///< what such a text is: "a [[specimen]] of the experiment"
  };
  /// What was measured, and where it stands.
  struct Channel {
    std::string id;
    std::string column;  ///< wide files: one column per channel; in long files the column of its readings, or empty
    Quantity quantity = Quantity::length;
    InstrumentNoise noise;
    std::string label =
        {};  ///< long files: what the channel column holds, which several channels may share; "": the id
  };
  /// When readings were taken: columns of times, "" where there is none, and what holds for all rows [s].
  struct History {
    bool counts = false;      ///< readings depend on it, and each has its Turn
    std::string time_column;  ///< when it was read, since the first load was hung
    std::string dwell_column, rest_column;
    std::optional<double> dwell, rest;
  };
  std::string path;
  History history = {};
  std::string trial_column;  ///< "" when there is none: rows with equal controls are then repeats
  std::string order_column;  ///< optional: numbers in whose order rows were measured; those of one number share a state
  std::vector<Control> controls;
  std::vector<Channel> channels;
  std::string channel_column;        ///< long files: the column that holds the channel's id or label; else ""
  std::string value_column;          ///< long files: the column of readings of channels that name none; else ""
  std::string sigma_column;          ///< optional: sigma per row (a length like the reading); overrides the noise
  std::vector<std::string> ignored;  ///< columns that are deliberately not used, by name or by number ("#3")
  std::vector<int> excluded;         ///< lines whose readings are not fitted
};

/// All readings of a bench, repeats kept.
struct Trials {
  std::vector<std::string> control_ids;
  std::vector<std::set<double>> control_values;  ///< all values of each control in the file, SI
  std::vector<Quantity> control_quantities;      ///< e.g. mass for "mass_g": the caller turns masses into forces
  std::vector<std::string> channel_ids;
  std::vector<Reading> readings;
  /// For people: first the count of conditions, channels and trials, then what was recognised ("semicolons and decimal
  /// commas", "BOM", ...).
  std::vector<std::string> remarks;
  double typical_dwell = 0;  ///< median of the readings' [s]; what is asked for beside them is read after as long
  std::string layout;        ///< for people: where the table was found in a file that holds more; "" for a plain file
};

/// Reads a bench CSV file (fast-cpp-csv-parser). Comma, semicolon or tab separated, decimal point or comma, thousands
/// separators where all numbers of the file can be read in one way only, UTF-8 with or without BOM or cp1252, any line
/// ends, comment lines with # or %, quoted fields, and what machines put around a table (see read_csv()). A column's
/// unit stands in its name or in a row below the header. A reading that is empty, NA, NaN or the like (see not_taken())
/// was not taken. Throws InputError, one sentence with file, line and column, for: missing file, empty file, header
/// only, missing, duplicate or unknown column, wrong or missing unit, a control that is empty, text where a number
/// belongs, infinity, a row with too few or too many cells, an unknown channel id, a reading that stands twice (same
/// trial, order, controls and channel, both lines named), sigma not positive, no noise given at all, no reading at all,
/// an excluded line without a reading, no reading that is not excluded; where history counts, for times that contradict
/// each other.
Trials read_trials(const BenchFormat& format);

/// A line of a file that holds loads only: where to predict.
struct LoadRow {
  int line = 0;
  std::vector<double> controls;      ///< SI, in the order of BenchFormat::controls
  std::optional<double> dwell = {};  ///< [s]; none: it is not said
};

/// Reads the control columns of `format` from the CSV file at `path`; the format's other columns may be there and are
/// not read. Throws InputError as read_trials() does.
std::vector<LoadRow> read_load_rows(const BenchFormat& format, const std::string& path);

/// The full names of those of these columns that are in the file at `path`, with their units ("Load (N)"), wherever the
/// file says them. Throws InputError as read_csv() does.
std::map<std::string, std::string> titles_in_file(const std::string& path, const std::vector<std::string>& names);

}  // namespace taut
