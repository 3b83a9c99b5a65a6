#include "calib/data/plan.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <map>
#include <utility>

#include "calib/data/csv_table.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

/// A cell as CSV files hold it.
std::string quoted(const std::string& cell) {
  if (cell.find_first_of(",\"\n#%") == std::string::npos) return cell;
  std::string text = "\"";
  for (const char c : cell) text += c == '"' ? std::string("\"\"") : std::string(1, c);
  return text + "\"";
}

std::string line_of(const std::vector<std::string>& cells) {
  std::vector<std::string> written;
  for (const std::string& cell : cells) written.push_back(quoted(cell));
  return join(written, ",") + "\n";
}

/// The columns of a format, each once.
std::vector<std::string> columns_of(const BenchFormat& format) {
  std::vector<std::string> names{format.trial_column, format.order_column};
  for (const BenchFormat::Control& control : format.controls) names.push_back(control.column);
  names.push_back(format.channel_column);
  for (const BenchFormat::Channel& channel : format.channels) names.push_back(channel.column);
  names.insert(names.end(), {format.value_column, format.sigma_column, format.history.time_column,
                             format.history.dwell_column, format.history.rest_column});
  std::vector<std::string> once;
  for (const std::string& name : names) {
    if (!name.empty() && std::ranges::find(once, name) == once.end()) once.push_back(name);
  }
  return once;
}

}  // namespace

std::vector<TitledColumn> columns_in_file(const BenchFormat& format) {
  if (!std::filesystem::exists(format.path)) return {};
  const std::vector<std::string> names = columns_of(format);
  const CsvTable table = read_csv(format.path, names);
  std::map<size_t, TitledColumn> found;
  for (const std::string& name : names) {
    if (const std::optional<size_t> column = find_column(table, name, format.ignored))
      found.try_emplace(*column, TitledColumn{name, table.title(*column)});
  }
  std::vector<TitledColumn> columns;
  for (auto& [column, titled] : found) columns.push_back(std::move(titled));
  return columns;
}

std::string plan_csv(const BenchFormat& format, const std::vector<RowToMeasure>& rows,
                     const std::vector<TitledColumn>& titled) {
  std::vector<TitledColumn> columns = titled;
  for (const std::string& name : columns_of(format)) {
    if (std::ranges::find(columns, name, &TitledColumn::name) == columns.end()) columns.push_back({name, name});
  }
  std::vector<std::string> heads;
  for (const TitledColumn& column : columns) heads.push_back(column.title);
  std::vector<std::string> labels;
  for (const BenchFormat::Channel& channel : format.channels) {
    const std::string& label = channel.label.empty() ? channel.id : channel.label;
    if (std::ranges::find(labels, label) == labels.end()) labels.push_back(label);
  }
  if (format.channel_column.empty()) labels.assign(1, "");
  std::string csv = line_of(heads);
  int order = 0;
  for (const RowToMeasure& row : rows) {
    std::map<std::string, std::string> cells{{format.trial_column, row.trial},
                                             {format.order_column, std::to_string(++order)}};
    for (size_t k = 0; k < row.controls.size(); ++k) {
      const BenchFormat::Control& control = format.controls[k];
      const std::string& title = std::ranges::find(columns, control.column, &TitledColumn::name)->title;
      cells[control.column] =
          control.labels.empty()
              ? fmt::format("{:.10g}",
                            row.controls[k] / parse_header(title, control.quantities,
                                                           fmt::format("{}, control '{}'", format.path, control.id))
                                                  .factor)
              : control.labels[static_cast<size_t>(row.controls[k]) - 1];
    }
    for (const std::string& label : labels) {
      cells[format.channel_column] = label;
      std::vector<std::string> line;
      for (const TitledColumn& column : columns) line.push_back(cells[column.name]);
      csv += line_of(line);
    }
  }
  return csv;
}

}  // namespace taut
