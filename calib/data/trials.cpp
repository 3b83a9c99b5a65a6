#include "calib/data/trials.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numeric>
#include <optional>
#include <set>
#include <tuple>

#include "calib/data/csv_table.hpp"
#include "calib/data/number_style.hpp"
#include "calib/data/plan.hpp"
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

/// "2 to 5, 7": lines of the readings, all or those that are excluded.
std::string lines_text(const std::vector<Reading>& readings, bool excluded_only) {
  std::set<int> lines;
  for (const Reading& reading : readings) {
    if (reading.excluded || !excluded_only) lines.insert(reading.line);
  }
  std::string text;
  for (auto from = lines.begin(); from != lines.end();) {
    auto to = from;
    while (std::next(to) != lines.end() && *std::next(to) == *to + 1) ++to;
    text += fmt::format("{}{}", text.empty() ? "" : ", ", *from);
    if (to != from) text += fmt::format("{}{}", *to == *from + 1 ? ", " : " to ", *to);
    from = std::next(to);
  }
  return text;
}

/// What a row of a long file calls a channel.
const std::string& label_of(const BenchFormat::Channel& channel) {
  return channel.label.empty() ? channel.id : channel.label;
}

/// "2 readings in lines 40, 41"; "" without any.
std::string excluded_lines(const std::vector<Reading>& readings) {
  const auto count = static_cast<size_t>(std::ranges::count_if(readings, &Reading::excluded));
  if (count == 0) return "";
  return counted(count, "reading", "readings") + (count == 1 ? " in line " : " in lines ") + lines_text(readings, true);
}

/// A column of numbers and what its cells are multiplied by.
struct NumberColumn {
  size_t index = 0;
  double factor = 1;
  Quantity quantity = Quantity::pure;
};

/// A file with what its columns mean. In long files `values` holds the same column for each channel.
struct Sheet {
  const BenchFormat& format;
  CsvTable table;
  std::optional<size_t> trial, channel;
  std::optional<NumberColumn> time, dwell, rest;
  std::vector<NumberColumn> controls, values, sigmas, orders;
  NumberStyle style;
  size_t not_taken_count = 0;

  Sheet(const BenchFormat& of, const std::string& path, const std::vector<std::string>& wanted)
      : format(of), table(read_csv(path, wanted)) {
    check_names(table, of.ignored);
  }

  // Header to columns

  /// Index of a column that the experiment needs. `purpose` says for what: "control 'load'".
  size_t find(const std::string& name, std::string_view purpose) const {
    const std::vector<std::string>& names = table.header.cells;
    if (const std::optional<size_t> found = find_column(table, name, format.ignored)) return *found;

    std::string hint = did_you_mean(name, names);
    if (const std::optional<HeaderUnit> wanted = unit_in_header(name)) {
      for (const std::string& candidate : names) {
        const std::optional<HeaderUnit> present = unit_in_header(candidate);
        if (!present || present->name != wanted->name) continue;
        hint = fmt::format(" (there is '{}', in {} instead of {})", candidate, present->unit, wanted->unit);
        break;
      }
    }
    if (names.size() == 1) hint += " (columns are separated by commas, semicolons or tabs)";
    if (table.preamble_line > 0) hint += " (the table seems to start here)";
    table.fail(table.header.line,
               "column '{}' for {} is missing; the header has: {}{}; write the same name in the header and in the "
               "experiment file",
               shown(name), purpose, listed(names), hint);
  }

  NumberColumn number_column(const std::string& name, const std::vector<Quantity>& allowed,
                             const std::string& purpose) const {
    const size_t index = find(name, purpose);
    const HeaderUnit unit = parse_header(table.title(index), allowed, table.at(table.header.line) + ", " + purpose);
    return {index, unit.factor, unit.quantity};
  }

  void find_columns() {
    if (!format.trial_column.empty()) trial = find(format.trial_column, "the trial");
    for (const BenchFormat::Control& control : format.controls) {
      const std::string purpose = fmt::format("control '{}'", control.id);
      controls.push_back(control.labels.empty() ? number_column(control.column, control.quantities, purpose)
                                                : NumberColumn{find(control.column, purpose)});
    }
    if (!format.channel_column.empty()) channel = find(format.channel_column, "the channel's name");
    if (!format.order_column.empty()) orders.push_back({find(format.order_column, "the order of the rows")});
    for (const BenchFormat::Channel& one : format.channels) {
      values.push_back(number_column(one.column.empty() ? format.value_column : one.column, {one.quantity},
                                     fmt::format("channel '{}'", one.id)));
      if (!format.sigma_column.empty())
        sigmas.push_back(
            number_column(format.sigma_column, {one.quantity}, fmt::format("sigma of channel '{}'", one.id)));
    }
    const auto find_time = [&](const std::string& name, const char* purpose) -> std::optional<NumberColumn> {
      if (name.empty()) return std::nullopt;
      return number_column(name, {Quantity::time}, purpose);
    };
    time = find_time(format.history.time_column, "the time");
    dwell = find_time(format.history.dwell_column, "the dwell");
    rest = find_time(format.history.rest_column, "the rest");
    std::set<size_t> used = number_columns();
    for (const NumberColumn& control : controls) used.insert(control.index);
    if (trial) used.insert(*trial);
    if (channel) used.insert(*channel);
    for (size_t i = 0; i < table.header.cells.size(); ++i) {
      const std::string& name = table.header.cells[i];
      if (!name.empty() && !used.contains(i) && !is_ignored(i))
        table.fail(table.header.line,
                   "column '{}' is not used by the experiment; use it as a control or channel, or list it under ignore "
                   "(the name, or the number {})",
                   shown(name), i + 1);
    }
  }

  bool is_ignored(size_t column) const {
    return contains(format.ignored, table.header.cells[column]) || contains(format.ignored, numbered_column(column));
  }

  std::set<size_t> number_columns() const {
    std::set<size_t> indices;
    for (const auto* group : {&values, &sigmas, &orders}) {
      for (const NumberColumn& column : *group) indices.insert(column.index);
    }
    for (size_t k = 0; k < controls.size(); ++k) {
      if (format.controls[k].labels.empty()) indices.insert(controls[k].index);
    }
    for (const auto* column : {&time, &dwell, &rest}) {
      if (*column) indices.insert((*column)->index);
    }
    return indices;
  }

  /// That there are rows, and how they write numbers. `what` is in each.
  void check_rows(std::string_view what) {
    if (table.rows.empty())
      table.fail(table.header.line, "there is a header but no row below it; add one row per {}", what);
    check_cell_counts(table);
    const std::set<size_t> columns = number_columns();
    style = number_style(table, {columns.begin(), columns.end()});
  }

  // Cells to numbers

  /// Text of a cell that must hold something.
  const std::string& text_in(const Row& row, size_t column) const {
    if (row.cells[column].empty())
      table.fail(row, column, "the cell is empty; fill it in or delete the row (only cells of readings may be empty)");
    return row.cells[column];
  }

  double number_in(const Row& row, const NumberColumn& column) const {
    const std::string& cell = text_in(row, column.index);
    if (const std::optional<double> number = style.number(cell)) return *number * column.factor;
    const bool ascii = std::ranges::all_of(cell, [](char c) { return static_cast<unsigned char>(c) < 0x80; });
    table.fail(row, column.index,
               "'{}' is not a finite number{}; write a number like 12.5 or 1.25e1 without a unit, or delete the row",
               shown(cell), ascii ? "" : " (it holds a special character, perhaps a long minus sign or a blank)");
  }

  double label_in(const Row& row, size_t column, const BenchFormat::Control& control) const {
    const std::string& text = text_in(row, column);
    const std::vector<std::string>& labels = control.labels;
    const auto found = std::ranges::find(labels, text);
    if (found == labels.end())
      table.fail(row, column, "'{}' is not {}{}; it has: {}", shown(text), control.label_is, did_you_mean(text, labels),
                 listed(labels));
    return static_cast<double>(found - labels.begin()) + 1;
  }

  std::vector<double> controls_in(const Row& row) const {
    std::vector<double> numbers;
    for (size_t k = 0; k < controls.size(); ++k) {
      const BenchFormat::Control& control = format.controls[k];
      numbers.push_back(control.labels.empty() ? number_in(row, controls[k])
                                               : label_in(row, controls[k].index, control));
      if (format.controls[k].pulls && numbers.back() < 0)
        table.fail(row, controls[k].index,
                   "the tension is '{}', but a cable cannot push; correct the sign, or write 0 where it hung loose",
                   shown(row.cells[controls[k].index]));
    }
    return numbers;
  }

  // Rows to readings

  /// Channels that a row holds readings of: all, in long files those that it names.
  std::vector<size_t> channels_in(const Row& row) const {
    std::vector<size_t> found;
    std::vector<std::string> labels;
    for (size_t k = 0; k < format.channels.size(); ++k) {
      labels.push_back(label_of(format.channels[k]));
      if (!channel || labels.back() == row.cells[*channel]) found.push_back(k);
    }
    if (found.empty()) {
      const std::string& label = text_in(row, *channel);
      labels.erase(std::unique(labels.begin(), labels.end()), labels.end());
      table.fail(row, *channel,
                 "'{}' is not a channel of the experiment{}; it has: {}; correct the cell or add a [[channel]]",
                 shown(label), did_you_mean(label, labels), listed(labels));
    }
    return found;
  }

  double sigma_of(const Row& row, const Reading& reading) const {
    const size_t k = static_cast<size_t>(reading.channel);
    if (!sigmas.empty()) {
      const double sigma = number_in(row, sigmas[k]);
      if (!(sigma > 0))
        table.fail(row, sigmas[k].index,
                   "sigma is '{}', but a standard deviation is positive; correct the cell or delete the row",
                   shown(row.cells[sigmas[k].index]));
      return sigma;
    }
    const double sigma = format.channels[k].noise.sigma(reading.value);
    const size_t column = values[k].index;
    if (!(sigma > 0) || !std::isfinite(sigma))
      table.fail(row, column,
                 "the noise of channel '{}' gives sigma = {} for the reading '{}'; add absolute or resolution to its "
                 "[[channel]]",
                 format.channels[k].id, sigma, shown(row.cells[column]));
    return sigma;
  }

  // When readings were taken

  /// A time in a row; `otherwise` where there is no such column.
  std::optional<double> time_in(const Row& row, const std::optional<NumberColumn>& column,
                                std::optional<double> otherwise = {}) const {
    if (!column) return otherwise;
    const double seconds = number_in(row, *column);
    if (seconds < 0)
      table.fail(row, column->index, "the time is '{}', but it cannot be negative; correct the cell",
                 shown(row.cells[column->index]));
    return seconds;
  }

  /// Gives each reading its turn. Rows stand in the order in which they were read, unless a column says it, or times.
  void set_turns(std::vector<Reading>& readings) const {
    std::map<int, const Row*> rows;
    for (const Row& row : table.rows) rows[row.line] = &row;
    std::vector<Reading*> order;
    for (Reading& reading : readings) order.push_back(&reading);
    const auto when = [&](const Reading* reading) { return time_in(*rows.at(reading->line), time).value_or(0); };
    if (!orders.empty())
      std::ranges::stable_sort(order, {}, &Reading::order);
    else if (time)
      std::ranges::stable_sort(order, {}, when);
    const Reading* last = nullptr;
    std::set<int> channels;  // read in the last turn
    for (Reading* reading : order) {
      const Row& row = *rows.at(reading->line);
      Turn turn{last == nullptr ? 0 : last->turn.place, 0, 0};
      const Row* before = last == nullptr ? nullptr : rows.at(last->line);
      const bool same_load = last != nullptr && last->trial == reading->trial && last->controls == reading->controls;
      const bool together =
          same_load && !channels.contains(reading->channel) && (!time || when(last) == when(reading)) &&
          (orders.empty() || last->order == reading->order) && time_in(row, dwell) == time_in(*before, dwell);
      if (together) {
        turn = last->turn;
      } else {
        if (last != nullptr) ++turn.place;
        const bool new_trial = last != nullptr && last->trial != reading->trial;
        if (new_trial && !time && !rest && !format.history.rest)
          table.fail(
              row.line,
              "trial '{}' follows line {} of trial '{}', and nothing says for how long there was no load between "
              "them; give [bench] rest (\"0 s\": none)",
              shown(reading->trial), last->line, shown(last->trial));
        channels.clear();
        find_times(row, before, same_load ? last->turn.dwell : -1, turn);
      }
      reading->turn = turn;
      channels.insert(reading->channel);
      last = reading;
    }
  }

  /// Dwell and rest of a row, of which one may follow from its time and that of the row read before it. Where that has
  /// the same load, it was read after `acted` seconds of it, else -1.
  void find_times(const Row& row, const Row* before, double acted, Turn& turn) const {
    const std::optional<double> stays = time_in(row, dwell, format.history.dwell),
                                rests = time_in(row, rest, format.history.rest);
    turn.rest = rests.value_or(0);
    const bool goes_on = acted >= 0 && turn.rest == 0;  // its load may not have been taken off
    if (time) {
      const double passed = *time_in(row, time) - (before == nullptr ? 0 : *time_in(*before, time));
      if (passed < 0)
        table.fail(row, time->index,
                   "it was read before line {}, which the order has before it; correct the order or the time",
                   before->line);
      const bool went_on = goes_on && stays && std::abs(passed - (*stays - acted)) <= 0.5;
      const double left = passed - turn.rest - (went_on ? passed : stays.value_or(0));
      if (left < -1e-9 * passed || (stays && rests && before != nullptr && left > 0.5))
        table.fail(row, time->index,
                   "{} s after {} its dwell and rest are {} s together; correct the times, or leave one of the three "
                   "out",
                   passed, before == nullptr ? "the first load" : fmt::format("line {}", before->line),
                   stays.value_or(0) + turn.rest);
      turn.dwell = stays ? *stays : left + (goes_on ? acted : 0.0);
      if (went_on || (!stays && goes_on)) turn.read = acted;
      if (stays && !rests && !went_on && before != nullptr) turn.rest = std::max(0.0, left);
      return;
    }
    turn.dwell = *stays;
    if (!goes_on) return;
    if (turn.dwell <= acted)
      table.fail(row.line,
                 "its load had acted for {} s, no longer than in line {}, so that it was taken off between them; say "
                 "for how long ([bench] rest)",
                 turn.dwell, before->line);
    turn.read = acted;
  }

  [[noreturn]] void fail_twice(const Row& row, const Reading& reading, int first_line) const {
    std::string condition;
    for (const NumberColumn& control : controls)
      condition += fmt::format(", {} = {}", shown(table.header.cells[control.index]), shown(row.cells[control.index]));
    table.fail(
        row.line,
        "the reading of channel '{}' stands twice, first in line {} (trial '{}'{}); give repeats different trials "
        "in column '{}', or delete one",
        format.channels[static_cast<size_t>(reading.channel)].id, first_line, shown(reading.trial), condition,
        shown(format.trial_column));
  }

  std::vector<std::string> remarks_of(const Trials& trials) const {
    std::vector<std::string> remarks;
    const size_t channels = trials.channel_ids.size();
    std::map<std::vector<double>, std::vector<size_t>> repeats;  // by controls: of each channel
    for (const Reading& reading : trials.readings)
      ++repeats.try_emplace(reading.controls, channels, 0).first->second[static_cast<size_t>(reading.channel)];
    size_t fewest = trials.readings.size(), most = 0;
    for (const auto& [controls_of, counts] : repeats) {
      const auto [low, high] = std::ranges::minmax(counts);
      fewest = std::min(fewest, low);
      most = std::max(most, high);
    }
    const bool regular = fewest == most;
    std::string summary = counted(trials.readings.size(), "reading", "readings") + ": " +
                          counted(repeats.size(), "condition", "conditions");
    if (channels > 1) summary += fmt::format("{}{} channels", regular ? " x " : ", ", channels);
    summary += regular ? " x " + counted(most, "trial", "trials") : fmt::format(", {} to {} trials each", fewest, most);
    remarks.push_back(summary);

    if (const std::string lines = excluded_lines(trials.readings); !lines.empty())
      remarks.push_back("not fitted (exclude): " + lines);
    if (not_taken_count > 0)
      remarks.push_back(counted(not_taken_count, "reading", "readings") + " not taken (empty, NA, NaN, - or the like)");
    const std::string separators = table.separator == ';' ? "semicolons" : table.separator == '\t' ? "tabs" : "commas";
    const std::string numbers = style.describe();
    if (table.preamble_line + table.units_line + table.footer_line == 0 && (separators != "commas" || !numbers.empty()))
      remarks.push_back(separators + (numbers.empty() ? " between cells" : " and " + numbers));
    if (table.byte_order_mark) remarks.emplace_back("byte order mark (BOM) skipped");
    if (table.carriage_returns) remarks.emplace_back("CRLF line ends");
    if (table.comments > 0)
      remarks.push_back(counted(static_cast<size_t>(table.comments), "comment line", "comment lines") + " skipped");
    std::vector<std::string> ignored;
    for (size_t i = 0; i < table.header.cells.size(); ++i) {
      const std::string& name = table.header.cells[i];
      if (is_ignored(i)) ignored.push_back(name.empty() ? numbered_column(i) : name);
    }
    if (!ignored.empty()) remarks.push_back("columns ignored: " + listed(ignored));
    return remarks;
  }
};

/// Mistakes in the description of the file, which no file can mend.
class FormatCheck {
 public:
  explicit FormatCheck(const BenchFormat& format) : format_(format), is_long_(!format.channel_column.empty()) {}

  void run() {
    if (format_.channels.empty()) fail("there is no channel; describe each measured quantity in a [[channel]]");
    if (!is_long_ && !format_.value_column.empty())
      fail("a value column belongs to a long file; name its channel column too, or neither for one column per channel");
    for (const BenchFormat::Control& control : format_.controls) {
      use(control.column, fmt::format("control '{}'", control.id));
      name(control.id);
    }
    for (const BenchFormat::Channel& channel : format_.channels) check(channel);
    for (const auto& [column, purpose] : own_columns_) use(column, purpose);
    for (const auto& [column, purpose] : {std::pair(&format_.channel_column, "the channel's name"),
                                          {&format_.history.time_column, "the time"},
                                          {&format_.history.dwell_column, "the dwell"},
                                          {&format_.history.rest_column, "the rest"},
                                          {&format_.value_column, "the reading"},
                                          {&format_.trial_column, "the trial"},
                                          {&format_.order_column, "the order of the rows"},
                                          {&format_.sigma_column, "sigma"}}) {
      if (!column->empty()) use(*column, purpose);
    }
    for (const std::string& column : format_.ignored) {
      if (purposes_.contains(column))
        fail("column '{}' is ignored and used for {}; do one of them", column, purposes_[column]);
    }
  }

 private:
  template <class... Args>
  [[noreturn]] void fail(fmt::format_string<Args...> what, Args&&... args) const {
    throw InputError(
        fmt::format("experiment file, bench {}: {}", format_.path, fmt::format(what, std::forward<Args>(args)...)));
  }
  void use(const std::string& column, const std::string& purpose) {
    if (column.empty()) fail("{} has no column; name the column of the file that holds it", purpose);
    const auto [previous, is_new] = purposes_.emplace(column, purpose);
    if (!is_new) fail("column '{}' is used for {} and for {}; use a column once", column, previous->second, purpose);
  }
  void name(const std::string& id) {
    if (!ids_.insert(id).second) fail("the name '{}' stands twice; rename one", id);
  }
  void check(const BenchFormat::Channel& channel) {
    const std::string purpose = fmt::format("channel '{}'", channel.id);
    if (!is_long_) {
      use(channel.column, purpose);
    } else {
      const std::string& column = channel.column.empty() ? format_.value_column : channel.column;
      if (column.empty())
        fail("{} has no column; name it, or the value column of all channels that have none of their own", purpose);
      const auto [previous, is_new] = places_.emplace(std::pair(label_of(channel), column), channel.id);
      if (!is_new)
        fail("channels '{}' and '{}' are read from one column '{}' of the same rows; give one of them another",
             previous->second, channel.id, column);
      if (!channel.column.empty()) own_columns_.emplace(channel.column, purpose);
    }
    name(channel.id);
    const auto& [absolute, relative, resolution] = channel.noise;
    for (const double part : {absolute, relative, resolution}) {
      if (!std::isfinite(part) || part < 0)
        fail("noise of channel '{}' has the value {}; it must be 0 or positive", channel.id, part);
    }
    if (format_.sigma_column.empty() && absolute == 0 && relative == 0 && resolution == 0)
      fail("channel '{}' has no noise; give absolute, relative or resolution in its [[channel]], or a sigma column",
           channel.id);
  }

  const BenchFormat& format_;
  bool is_long_;
  std::map<std::string, std::string> purposes_;
  std::map<std::string, std::string> own_columns_;                     ///< of channels in long files
  std::map<std::pair<std::string, std::string>, std::string> places_;  ///< label and column to channel
  std::set<std::string> ids_;
};

/// The columns that the format names.
std::vector<std::string> names_of(const BenchFormat& format) {
  std::vector<std::string> names = format.ignored;
  for (const BenchFormat::Control& control : format.controls) names.push_back(control.column);
  for (const BenchFormat::Channel& channel : format.channels) names.push_back(channel.column);
  names.insert(names.end(), {format.trial_column, format.channel_column, format.value_column, format.sigma_column,
                             format.order_column, format.history.time_column, format.history.dwell_column,
                             format.history.rest_column});
  std::erase(names, "");
  return names;
}

/// Marks the readings of the excluded lines.
void exclude(const BenchFormat& format, std::vector<Reading>& readings) {
  for (const int line : format.excluded) {
    bool there = false;
    for (Reading& reading : readings) {
      if (reading.line == line) there = reading.excluded = true;
    }
    if (!there)
      throw InputError(fmt::format("{}: line {} is to be excluded, but holds no reading; readings stand in line{} {}",
                                   format.path, line, readings.size() == 1 ? "" : "s", lines_text(readings, false)));
  }
  if (std::ranges::all_of(readings, &Reading::excluded))
    throw InputError(format.path + ": all readings are excluded; leave some of them to be fitted");
}

/// Ids and quantities, without readings.
Trials trials_without_readings(const Sheet& sheet) {
  Trials trials;
  trials.control_values.resize(sheet.format.controls.size());
  for (size_t i = 0; i < sheet.format.controls.size(); ++i) {
    trials.control_ids.push_back(sheet.format.controls[i].id);
    trials.control_quantities.push_back(sheet.controls[i].quantity);
  }
  for (const BenchFormat::Channel& channel : sheet.format.channels) trials.channel_ids.push_back(channel.id);
  return trials;
}

}  // namespace

double InstrumentNoise::sigma(double reading) const {
  return std::hypot(absolute, relative * reading, resolution / std::sqrt(12.0));
}

Trials read_trials(const BenchFormat& format) {
  FormatCheck(format).run();
  Sheet sheet(format, format.path, names_of(format));
  sheet.find_columns();
  sheet.check_rows("reading");

  Trials trials = trials_without_readings(sheet);
  std::map<std::tuple<std::string, std::vector<double>, int, std::array<double, 3>>, int> first_lines;
  for (const Row& row : sheet.table.rows) {
    Reading reading;
    reading.line = row.line;
    if (sheet.trial) reading.trial = sheet.text_in(row, *sheet.trial);
    reading.controls = sheet.controls_in(row);
    if (!sheet.orders.empty()) reading.order = sheet.number_in(row, sheet.orders.front());
    for (const size_t channel : sheet.channels_in(row)) {
      if (not_taken(row.cells[sheet.values[channel].index])) {
        ++sheet.not_taken_count;
        continue;
      }
      for (size_t k = 0; k < reading.controls.size(); ++k) trials.control_values[k].insert(reading.controls[k]);
      reading.channel = static_cast<int>(channel);
      reading.value = sheet.number_in(row, sheet.values[channel]);
      reading.sigma = sheet.sigma_of(row, reading);
      const std::array<double, 3> when{std::isnan(reading.order) ? 0 : reading.order,
                                       sheet.time_in(row, sheet.time).value_or(0),
                                       sheet.time_in(row, sheet.dwell).value_or(0)};
      const auto [previous, is_new] =
          first_lines.try_emplace({reading.trial, reading.controls, reading.channel, when}, row.line);
      if (sheet.trial && !is_new) sheet.fail_twice(row, reading, previous->second);
      trials.readings.push_back(reading);
    }
  }
  if (trials.readings.empty())
    sheet.table.fail(sheet.table.rows.front().line,
                     "no row below the header has a reading: all {} are empty, NA or the like; fill them in",
                     sheet.not_taken_count);
  exclude(format, trials.readings);
  if (format.history.counts) {
    sheet.set_turns(trials.readings);
    std::vector<double> dwells;
    for (const Reading& reading : trials.readings) dwells.push_back(reading.turn.dwell);
    std::ranges::nth_element(dwells, dwells.begin() + static_cast<std::ptrdiff_t>(dwells.size() / 2));
    trials.typical_dwell = dwells[dwells.size() / 2];
  }
  trials.remarks = sheet.remarks_of(trials);
  trials.layout = sheet.table.layout(sheet.style.describe());
  return trials;
}

namespace {

/// A file of controls: what the experiment's bench file may hold besides may be there, and is not read.
Sheet load_sheet(const BenchFormat& format, const std::string& path) {
  const std::vector<std::string> known = names_of(format);
  Sheet sheet(format, path, known);
  for (const BenchFormat::Control& control : format.controls)
    sheet.controls.push_back(control.labels.empty() ? sheet.number_column(control.column, control.quantities, "load")
                                                    : NumberColumn{sheet.find(control.column, "load")});
  const Row& header = sheet.table.header;
  for (size_t column = 0; column < header.cells.size(); ++column) {
    const std::string& name = header.cells[column];
    if (!name.empty() && !sheet.is_ignored(column) &&
        std::ranges::none_of(known, [&](const std::string& other) { return same_column(other, name); }))
      sheet.table.fail(header, column, "the experiment knows no such column{}; delete it", did_you_mean(name, known));
  }
  sheet.check_rows("load");
  const std::string& dwell = format.history.dwell_column;
  if (!dwell.empty() && find_column(sheet.table, dwell, format.ignored))
    sheet.dwell = sheet.number_column(dwell, {Quantity::time}, "the dwell");
  return sheet;
}

}  // namespace

std::vector<LoadRow> read_load_rows(const BenchFormat& format, const std::string& path) {
  const Sheet sheet = load_sheet(format, path);
  std::vector<LoadRow> rows;
  for (const Row& row : sheet.table.rows)
    rows.push_back({row.line, sheet.controls_in(row), sheet.time_in(row, sheet.dwell, format.history.dwell)});
  return rows;
}

std::optional<Trials> read_plan(const BenchFormat& format, const std::string& rows, bool rows_needed) {
  const bool own = rows.empty();
  FormatCheck(format).run();
  Sheet sheet = own ? Sheet(format, format.path, names_of(format)) : load_sheet(format, rows);
  if (own) {
    sheet.find_columns();
    if (rows_needed || !sheet.table.rows.empty()) sheet.check_rows("reading");
  } else {
    if (!format.trial_column.empty()) sheet.trial = find_column(sheet.table, format.trial_column, format.ignored);
    if (!format.channel_column.empty()) sheet.channel = find_column(sheet.table, format.channel_column, format.ignored);
  }
  Trials trials = trials_without_readings(sheet);
  const auto add = [&](Reading reading, const std::vector<size_t>& channels) {
    for (size_t k = 0; k < reading.controls.size(); ++k) trials.control_values[k].insert(reading.controls[k]);
    reading.value = reading.sigma = not_a_number;
    for (const size_t channel : channels) {
      reading.channel = static_cast<int>(channel);
      trials.readings.push_back(reading);
    }
  };
  for (const Row& row : sheet.table.rows) {
    const std::vector<size_t> channels = sheet.channels_in(row);
    for (const size_t channel : channels) {
      if (own && !not_taken(row.cells[sheet.values[channel].index])) return std::nullopt;
    }
    Reading reading;
    reading.line = row.line;
    if (sheet.trial) reading.trial = sheet.text_in(row, *sheet.trial);
    reading.controls = sheet.controls_in(row);
    if (!sheet.orders.empty()) reading.order = sheet.number_in(row, sheet.orders.front());
    if (format.history.counts && !own) {
      const std::optional<double> dwell = sheet.time_in(row, sheet.dwell, format.history.dwell);
      if (!dwell)
        sheet.table.fail(row.line,
                         "for how long its load acts is not said, and readings depend on it (prony); add a column "
                         "'{}', or a constant [bench] dwell",
                         format.history.dwell_column.empty() ? "dwell_s" : format.history.dwell_column);
      reading.turn.dwell = *dwell;
    }
    add(reading, channels);
  }
  if (trials.readings.empty()) {  // of labels the first, of numbers none
    Reading rest;
    for (const BenchFormat::Control& control : format.controls) rest.controls.push_back(control.labels.empty() ? 0 : 1);
    std::vector<size_t> all(format.channels.size());
    std::iota(all.begin(), all.end(), size_t{0});
    add(rest, all);
    trials.remarks.emplace_back("no row yet");
    return trials;
  }
  if (own) exclude(format, trials.readings);
  if (own && format.history.counts) sheet.set_turns(trials.readings);
  trials.remarks = sheet.remarks_of(trials);
  trials.remarks.front() = "planned, without readings: " + trials.remarks.front();
  trials.layout = sheet.table.layout(sheet.style.describe());
  return trials;
}

std::map<std::string, std::string> titles_in_file(const std::string& path, const std::vector<std::string>& names) {
  const CsvTable table = read_csv(path, names);
  std::map<std::string, std::string> titles;
  for (const std::string& name : names) {
    if (const std::optional<size_t> column = find_column(table, name)) titles[name] = table.title(*column);
  }
  return titles;
}

}  // namespace taut
