#pragma once
#include <optional>
#include <string>
#include <vector>

#include "calib/data/trials.hpp"

namespace taut {

/// The rows of a bench that is planned and not measured yet: each row's controls, with readings of all its channels
/// whose value and sigma are NaN. `rows`: a CSV file with the columns of controls, as read_load_rows() takes it (a
/// trial column may be there); "": the bench's own file, whose header has to be as read_trials() wants it. nullopt:
/// that file holds a reading, so that the bench is no plan. A file without a row is refused, or stands for one row,
/// line 0, in which nothing is set (`rows_needed` false), so that all else can be looked at. Throws InputError as
/// read_trials() does.
std::optional<Trials> read_plan(const BenchFormat& format, const std::string& rows, bool rows_needed);

/// A row that is to be measured.
struct RowToMeasure {
  std::string trial;             ///< where the format has trials
  std::vector<double> controls;  ///< SI, in the order of BenchFormat::controls
};

/// A column of a bench file: its name in BenchFormat, and that with its unit as the file has it.
struct TitledColumn {
  std::string name, title;
};

/// A bench file of rows that are not measured yet, with all columns of `format` but those that it ignores: trials,
/// controls in the columns' units, numbers from 1 where it has an order, and empty cells. In long files each row has a
/// line for each label of a channel. Columns stand as in `titled`, then those that are not there. Throws InputError for
/// a column of a control whose unit nothing says.
std::string plan_csv(const BenchFormat& format, const std::vector<RowToMeasure>& rows,
                     const std::vector<TitledColumn>& titled = {});

/// The columns of `format` that its file has, in its order; none where there is no file. Throws InputError as
/// read_csv() does.
std::vector<TitledColumn> columns_in_file(const BenchFormat& format);

}  // namespace taut
