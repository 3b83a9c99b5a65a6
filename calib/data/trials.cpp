#include "calib/data/trials.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <set>
#include <tuple>

#include "calib/data/csv_table.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

using Row = CsvTable::Row;

std::string counted(size_t n, std::string_view singular, std::string_view plural) {
  return fmt::format("{} {}", n, n == 1 ? singular : plural);
}

bool contains(const std::vector<std::string>& names, std::string_view name) {
  return std::ranges::find(names, name) != names.end();
}

// ---------------------------------------------------------------------------------------------------------------------
// Header to columns

std::optional<HeaderUnit> any_unit(std::string_view header) {
  using enum Quantity;
  static const std::vector<Quantity> all = {length,       area, mass,  force,     pressure,  density,
                                            acceleration, time, angle, stiffness, line_load, pure};
  try {
    return parse_header(header, all, "");
  } catch (const InputError&) {
    return std::nullopt;
  }
}

/// Index of a column that the experiment needs. `purpose` says for what: "control 'load'".
size_t find_column(const CsvTable& table, const std::string& name, std::string_view purpose) {
  const std::vector<std::string>& names = table.header.cells;
  const auto found = std::ranges::find(names, name);
  if (found != names.end()) return static_cast<size_t>(found - names.begin());

  std::string hint = did_you_mean(name, names);
  if (const std::optional<HeaderUnit> wanted = any_unit(name)) {
    for (const std::string& candidate : names) {
      const std::optional<HeaderUnit> present = any_unit(candidate);
      if (present && present->name == wanted->name) {
        hint = fmt::format(" (there is '{}', in {} instead of {})", candidate, present->unit, wanted->unit);
        break;
      }
    }
  }
  if (names.size() == 1) hint += " (columns are separated by commas, semicolons or tabs)";
  throw InputError(fmt::format(
      "{}: column '{}' for {} is missing; the header has: {}{}; write the same name in the header and in the "
      "experiment file",
      table.at(table.header.line), shown(name), purpose, listed(names), hint));
}

/// A column of numbers and what its cells are multiplied by.
struct NumberColumn {
  size_t index = 0;
  double factor = 1;
  Quantity quantity = Quantity::pure;
};

NumberColumn number_column(const CsvTable& table, const std::string& name, const std::vector<Quantity>& allowed,
                           const std::string& purpose) {
  const size_t index = find_column(table, name, purpose);
  const HeaderUnit unit = parse_header(name, allowed, table.at(table.header.line) + ", " + purpose);
  return {index, unit.factor, unit.quantity};
}

/// Where everything stands and how numbers are written. In long files `values` holds the same column for each channel.
struct Columns {
  std::optional<size_t> trial, channel;
  std::vector<NumberColumn> controls, values, sigmas;
  bool decimal_commas = false;

  std::vector<size_t> of_numbers() const {
    std::set<size_t> indices;
    for (const auto* group : {&controls, &values, &sigmas}) {
      for (const NumberColumn& column : *group) indices.insert(column.index);
    }
    return {indices.begin(), indices.end()};
  }
};

Columns find_columns(const BenchFormat& format, const CsvTable& table) {
  Columns columns;
  if (!format.trial_column.empty()) columns.trial = find_column(table, format.trial_column, "the trial");
  for (const BenchFormat::Control& control : format.controls) {
    columns.controls.push_back(
        number_column(table, control.column, control.quantities, fmt::format("control '{}'", control.id)));
  }
  if (!format.channel_column.empty()) {
    columns.channel = find_column(table, format.channel_column, "the channel's name");
  }
  for (const BenchFormat::Channel& channel : format.channels) {
    const std::string& column = columns.channel ? format.value_column : channel.column;
    columns.values.push_back(number_column(table, column, {channel.quantity}, fmt::format("channel '{}'", channel.id)));
    if (!format.sigma_column.empty()) {
      columns.sigmas.push_back(number_column(table, format.sigma_column, {channel.quantity},
                                             fmt::format("sigma of channel '{}'", channel.id)));
    }
  }

  std::set<size_t> used;
  for (const size_t index : columns.of_numbers()) used.insert(index);
  if (columns.trial) used.insert(*columns.trial);
  if (columns.channel) used.insert(*columns.channel);
  for (size_t i = 0; i < table.header.cells.size(); ++i) {
    const std::string& name = table.header.cells[i];
    if (used.contains(i) || contains(format.ignored, name)) continue;
    throw InputError(fmt::format(
        "{}: column '{}' is not used by the experiment; use it as a control or channel, or list it under ignore",
        table.at(table.header.line), shown(name)));
  }
  return columns;
}

// ---------------------------------------------------------------------------------------------------------------------
// Cells to numbers

/// Text of a cell that must hold something.
const std::string& text_in(const CsvTable& table, const Row& row, size_t column) {
  if (!row.cells[column].empty()) return row.cells[column];
  throw InputError(
      fmt::format("{}: the cell is empty; fill it in or delete the row (a reading that was not taken has "
                  "no row)",
                  table.at(row, column)));
}

/// Whether the file writes decimal commas; all its numbers must agree.
bool has_decimal_commas(const CsvTable& table, const std::vector<size_t>& number_columns) {
  struct Seen {
    const Row* row;
    size_t column;
  };
  const auto text = [](const Seen& seen) { return shown(seen.row->cells[seen.column]); };
  std::optional<Seen> comma, point;
  for (const Row& row : table.rows) {
    for (const size_t column : number_columns) {
      const std::string& cell = row.cells[column];
      if (cell.find_first_not_of("0123456789+-.,eE") != std::string::npos) continue;
      const auto commas = std::ranges::count(cell, ',');
      const auto points = std::ranges::count(cell, '.');
      if (commas + points > 1) {
        throw InputError(
            fmt::format("{}: '{}' has more than one comma or point; write numbers without thousands "
                        "separators, like 1234.5",
                        table.at(row, column), shown(cell)));
      }
      if (commas == 1 && table.separator == ',') {
        throw InputError(
            fmt::format("{}: '{}' has a decimal comma in a file that is separated by commas; write a "
                        "decimal point, or separate the cells by semicolons or tabs",
                        table.at(row, column), shown(cell)));
      }
      if (commas == 1 && !comma) comma = Seen{&row, column};
      if (points == 1 && !point) point = Seen{&row, column};
      if (comma && point) {
        throw InputError(
            fmt::format("{}: '{}' has a decimal comma, but '{}' in line {}, column '{}' has a decimal point; use "
                        "one of them in the whole file",
                        table.at(*comma->row, comma->column), text(*comma), text(*point), point->row->line,
                        shown(table.header.cells[point->column])));
      }
    }
  }
  return comma.has_value();
}

double number_in(const CsvTable& table, const Row& row, size_t column, bool decimal_commas) {
  const std::string& cell = text_in(table, row, column);
  std::string text = cell;
  if (decimal_commas) std::ranges::replace(text, ',', '.');
  if (const std::optional<double> number = parse_number(text)) return *number;
  const bool ascii = std::ranges::all_of(cell, [](char c) { return static_cast<unsigned char>(c) < 0x80; });
  throw InputError(
      fmt::format("{}: '{}' is not a finite number{}; write a number like 12.5 or 1.25e1 without a unit, "
                  "or delete the row",
                  table.at(row, column), shown(cell),
                  ascii ? "" : " (it holds a special character, perhaps a long minus sign or a blank)"));
}

// ---------------------------------------------------------------------------------------------------------------------
// Rows to readings

/// Mistakes in the description of the file, which no file can mend.
void check_format(const BenchFormat& format) {
  const auto fail = [&](const std::string& what) {
    throw InputError(fmt::format("experiment file, bench {}: {}", format.path, what));
  };
  if (format.channels.empty()) fail("there is no channel; describe each measured quantity in a [[channel]]");
  if (format.channel_column.empty() != format.value_column.empty()) {
    fail(
        "a long file needs both a channel column and a value column; give both, or neither for one column per channel");
  }
  const bool is_long = !format.channel_column.empty();
  std::map<std::string, std::string> purposes;
  const auto use = [&](const std::string& column, const std::string& purpose) {
    if (column.empty()) fail(fmt::format("{} has no column; name the column of the file that holds it", purpose));
    const auto [previous, is_new] = purposes.emplace(column, purpose);
    if (!is_new) {
      fail(fmt::format("column '{}' is used for {} and for {}; use a column once", column, previous->second, purpose));
    }
  };
  std::set<std::string> ids;
  for (const BenchFormat::Control& control : format.controls) {
    use(control.column, fmt::format("control '{}'", control.id));
    if (!ids.insert(control.id).second) fail(fmt::format("the name '{}' stands twice; rename one", control.id));
  }
  for (const BenchFormat::Channel& channel : format.channels) {
    if (!is_long) {
      use(channel.column, fmt::format("channel '{}'", channel.id));
    } else if (!channel.column.empty()) {
      fail(fmt::format("channel '{}' has its own column '{}' in a long file; remove it, or the channel column",
                       channel.id, channel.column));
    }
    if (!ids.insert(channel.id).second) fail(fmt::format("the name '{}' stands twice; rename one", channel.id));
    const InstrumentNoise& noise = channel.noise;
    for (const double part : {noise.absolute, noise.relative, noise.resolution}) {
      if (std::isfinite(part) && part >= 0) continue;
      fail(fmt::format("noise of channel '{}' has the value {}; it must be 0 or positive", channel.id, part));
    }
    const bool silent = noise.absolute == 0 && noise.relative == 0 && noise.resolution == 0;
    if (format.sigma_column.empty() && silent) {
      fail(
          fmt::format("channel '{}' has no noise; give absolute, relative or resolution in its [[channel]], or a "
                      "sigma column",
                      channel.id));
    }
  }
  if (is_long) use(format.channel_column, "the channel's name");
  if (is_long) use(format.value_column, "the reading");
  if (!format.trial_column.empty()) use(format.trial_column, "the trial");
  if (!format.sigma_column.empty()) use(format.sigma_column, "sigma");
  for (const std::string& column : format.ignored) {
    if (purposes.contains(column)) {
      fail(fmt::format("column '{}' is ignored and used for {}; do one of them", column, purposes[column]));
    }
  }
}

/// Channel that a row of a long file belongs to.
int channel_in(const CsvTable& table, const Row& row, size_t column, const std::vector<std::string>& ids) {
  const std::string& id = text_in(table, row, column);
  const auto found = std::ranges::find(ids, id);
  if (found != ids.end()) return static_cast<int>(found - ids.begin());
  throw InputError(
      fmt::format("{}: '{}' is not a channel of the experiment{}; it has: {}; correct the cell or add a "
                  "[[channel]]",
                  table.at(row, column), shown(id), did_you_mean(id, ids), listed(ids)));
}

double sigma_of(const BenchFormat& format, const CsvTable& table, const Row& row, const Columns& columns,
                const Reading& reading) {
  const size_t channel = static_cast<size_t>(reading.channel);
  if (!columns.sigmas.empty()) {
    const NumberColumn& column = columns.sigmas[channel];
    const double sigma = number_in(table, row, column.index, columns.decimal_commas) * column.factor;
    if (sigma > 0) return sigma;
    throw InputError(
        fmt::format("{}: sigma is '{}', but a standard deviation is positive; correct the cell or delete "
                    "the row",
                    table.at(row, column.index), shown(row.cells[column.index])));
  }
  const double sigma = format.channels[channel].noise.sigma(reading.value);
  if (sigma > 0 && std::isfinite(sigma)) return sigma;
  const size_t column = columns.values[channel].index;
  throw InputError(
      fmt::format("{}: the noise of channel '{}' gives sigma = {} for the reading '{}'; add absolute or "
                  "resolution to its [[channel]]",
                  table.at(row, column), format.channels[channel].id, sigma, shown(row.cells[column])));
}

using ReadingKey = std::tuple<std::string, std::vector<double>, int>;

[[noreturn]] void fail_twice(const BenchFormat& format, const CsvTable& table, const Row& row, const Columns& columns,
                             const Reading& reading, int first_line) {
  std::string condition;
  for (const NumberColumn& control : columns.controls) {
    condition += fmt::format(", {} = {}", shown(table.header.cells[control.index]), shown(row.cells[control.index]));
  }
  throw InputError(
      fmt::format("{}: the reading of channel '{}' stands twice, first in line {} (trial '{}'{}); give "
                  "repeats different trials in column '{}', or delete one",
                  table.at(row.line), format.channels[static_cast<size_t>(reading.channel)].id, first_line,
                  shown(reading.trial), condition, shown(format.trial_column)));
}

std::vector<std::string> remarks_of(const CsvTable& table, const BenchFormat& format, const Columns& columns,
                                    const Trials& trials) {
  std::vector<std::string> remarks;
  std::map<std::vector<double>, std::map<int, size_t>> repeats;
  for (const Reading& reading : trials.readings) ++repeats[reading.controls][reading.channel];
  const size_t channels = trials.channel_ids.size();
  size_t fewest = trials.readings.size();
  size_t most = 0;
  for (auto& [controls, counts] : repeats) {
    for (size_t channel = 0; channel < channels; ++channel) {
      const size_t count = counts[static_cast<int>(channel)];
      fewest = std::min(fewest, count);
      most = std::max(most, count);
    }
  }
  const bool regular = fewest == most;
  std::string summary = counted(trials.readings.size(), "reading", "readings") + ": " +
                        counted(repeats.size(), "condition", "conditions");
  if (channels > 1) summary += fmt::format("{}{} channels", regular ? " x " : ", ", channels);
  summary += regular ? " x " + counted(most, "trial", "trials") : fmt::format(", {} to {} trials each", fewest, most);
  remarks.push_back(summary);

  const std::string separators = table.separator == ';' ? "semicolons" : table.separator == '\t' ? "tabs" : "";
  if (!separators.empty()) {
    remarks.push_back(separators + (columns.decimal_commas ? " and decimal commas" : " between cells"));
  }
  if (table.byte_order_mark) remarks.emplace_back("byte order mark (BOM) skipped");
  if (table.carriage_returns) remarks.emplace_back("CRLF line ends");
  if (table.comments > 0) {
    remarks.push_back(counted(static_cast<size_t>(table.comments), "comment line", "comment lines") + " skipped");
  }
  std::vector<std::string> ignored;
  for (const std::string& name : table.header.cells) {
    if (contains(format.ignored, name)) ignored.push_back(name);
  }
  if (!ignored.empty()) remarks.push_back("columns ignored: " + listed(ignored));
  return remarks;
}

}  // namespace

double InstrumentNoise::sigma(double reading) const {
  return std::hypot(absolute, relative * reading, resolution / std::sqrt(12.0));
}

Trials read_trials(const BenchFormat& format) {
  check_format(format);
  const CsvTable table = read_csv(format.path);
  Columns columns = find_columns(format, table);
  if (table.rows.empty()) {
    throw InputError(
        fmt::format("{}: there is a header but no row below it; add one row per reading", table.at(table.header.line)));
  }
  check_cell_counts(table);
  columns.decimal_commas = has_decimal_commas(table, columns.of_numbers());

  Trials trials;
  for (size_t i = 0; i < format.controls.size(); ++i) {
    trials.control_ids.push_back(format.controls[i].id);
    trials.control_quantities.push_back(columns.controls[i].quantity);
  }
  for (const BenchFormat::Channel& channel : format.channels) trials.channel_ids.push_back(channel.id);

  std::map<ReadingKey, int> first_lines;
  for (const Row& row : table.rows) {
    Reading reading;
    reading.line = row.line;
    if (columns.trial) reading.trial = text_in(table, row, *columns.trial);
    for (const NumberColumn& control : columns.controls) {
      reading.controls.push_back(number_in(table, row, control.index, columns.decimal_commas) * control.factor);
    }
    int first = 0;
    int last = static_cast<int>(format.channels.size()) - 1;
    if (columns.channel) first = last = channel_in(table, row, *columns.channel, trials.channel_ids);
    for (int channel = first; channel <= last; ++channel) {
      const NumberColumn& value = columns.values[static_cast<size_t>(channel)];
      reading.channel = channel;
      reading.value = number_in(table, row, value.index, columns.decimal_commas) * value.factor;
      reading.sigma = sigma_of(format, table, row, columns, reading);
      if (columns.trial) {
        const auto [previous, is_new] =
            first_lines.emplace(ReadingKey{reading.trial, reading.controls, channel}, row.line);
        if (!is_new) fail_twice(format, table, row, columns, reading, previous->second);
      }
      trials.readings.push_back(reading);
    }
  }
  trials.control_values.resize(trials.control_ids.size());
  for (const Reading& reading : trials.readings) {
    for (size_t k = 0; k < reading.controls.size(); ++k) trials.control_values[k].insert(reading.controls[k]);
  }
  trials.remarks = remarks_of(table, format, columns, trials);
  return trials;
}

std::vector<LoadRow> read_load_rows(const BenchFormat& format, const std::string& path) {
  const CsvTable table = read_csv(path);
  std::vector<NumberColumn> controls;
  std::vector<size_t> indices;
  for (const BenchFormat::Control& control : format.controls) {
    controls.push_back(number_column(table, control.column, control.quantities, "load"));
    indices.push_back(controls.back().index);
  }
  std::vector<std::string> known = format.ignored;
  for (const std::string* name :
       {&format.trial_column, &format.channel_column, &format.value_column, &format.sigma_column})
    known.push_back(*name);
  for (const BenchFormat::Control& control : format.controls) known.push_back(control.column);
  for (const BenchFormat::Channel& channel : format.channels) known.push_back(channel.column);
  for (size_t column = 0; column < table.header.cells.size(); ++column) {
    const std::string& name = table.header.cells[column];
    if (!contains(known, name)) {
      throw InputError(fmt::format("{}: the experiment knows no such column{}; delete it",
                                   table.at(table.header, column), did_you_mean(name, known)));
    }
  }
  if (table.rows.empty())
    throw InputError(
        fmt::format("{}: there is a header but no row below it; add one row per load", table.at(table.header.line)));
  check_cell_counts(table);
  const bool decimal_commas = has_decimal_commas(table, indices);
  std::vector<LoadRow> rows;
  for (const Row& row : table.rows) {
    LoadRow& load = rows.emplace_back();
    load.line = row.line;
    for (const NumberColumn& control : controls)
      load.controls.push_back(number_in(table, row, control.index, decimal_commas) * control.factor);
  }
  return rows;
}

}  // namespace taut
