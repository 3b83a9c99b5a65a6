#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <set>

#include "calib/data/csv_table.hpp"
#include "calib/data/number_style.hpp"
#include "calib/files/experiment.hpp"
#include "calib/studies/score.hpp"
#include "sim/core/error.hpp"
#include "sim/core/units.hpp"
#include "sim/scene/channel_kinds.hpp"

// Which columns of a rig's file and of a simulator's table mean the same: both are then read as benches are.
namespace taut {
namespace {

/// A file before its columns mean anything.
struct ScoreFile {
  CsvTable table;

  explicit ScoreFile(const std::string& path) : table(read_csv(path)) {}
  size_t size() const { return table.header.cells.size(); }
  const std::string& name(size_t i) const { return table.header.cells[i]; }
  std::optional<HeaderUnit> unit(size_t i) const { return unit_in_header(table.title(i)); }
  /// The name without its unit.
  std::string base(size_t i) const {
    const std::optional<HeaderUnit> found = unit(i);
    return found ? found->name : name(i);
  }
  /// The column that has one of these names, with its unit or without; at best to the letter.
  std::optional<size_t> find(const std::vector<std::string>& names) const {
    for (const std::string& wanted : names) {
      if (const std::optional<size_t> found = find_column(table, wanted)) return found;
      for (size_t i = 0; i < size(); ++i) {
        if (!wanted.empty() && base(i) == wanted) return i;
      }
    }
    return std::nullopt;
  }
  bool has_numbers(size_t i) const {
    return std::ranges::all_of(table.rows, [&](const CsvTable::Row& row) {
      return i >= row.cells.size() || not_taken(row.cells[i]) || like_a_number(row.cells[i]);
    });
  }
  /// Distinct values of a column of numbers, SI.
  std::set<double> values(size_t i) const {
    const NumberStyle style = number_style(table, {i});
    std::set<double> found;
    for (const CsvTable::Row& row : table.rows) {
      const std::optional<double> value = i < row.cells.size() ? style.number(row.cells[i]) : std::nullopt;
      if (value) found.insert(*value * unit(i)->factor);
    }
    return found;
  }
  std::set<std::string> texts(size_t i) const {
    std::set<std::string> found;
    for (const CsvTable::Row& row : table.rows) {
      if (i < row.cells.size() && !row.cells[i].empty()) found.insert(row.cells[i]);
    }
    return found;
  }
};

/// Columns of a predictions.csv of taut besides its controls.
constexpr std::array own_columns{"line",          "trial",      "channel",
                                 "measured",      "sigma",      "predicted",
                                 "prediction_se", "residual",   "normalised_residual",
                                 "excluded",      "equilibria", "unit",
                                 "unit_in_file"};

/// Whether a table is one that `taut replay` or `taut fit` wrote.
bool is_own(const ScoreFile& file) {
  return file.find({"line"}) && file.find({"channel"}) && file.find({"predicted"}) && file.find({"measured"});
}

/// A channel without a declared noise still needs a sigma to be read; what follows from it is left out.
constexpr double no_noise = 1;

class ScoreReader {
 public:
  explicit ScoreReader(const ScoreQuestion& question) : question_(question), rig_(question.rig) {
    for (const std::string& path : question.sims) sims_.emplace_back(path);
  }

  ScoreData read() {
    check_names(rig_.table);
    if (question_.experiment.empty())
      guess_format();
    else
      take_experiment();
    take_noise();
    data_.rig = read_trials(format_);
    for (size_t k = 0; k < format_.controls.size(); ++k) {
      format_.controls[k].quantities = {data_.rig.control_quantities[k]};
      data_.controls.push_back(make_axis(format_.controls[k].id, data_.rig.control_quantities[k], ""));
      data_.controls.back().labels = format_.controls[k].labels;
    }
    for (const BenchFormat::Channel& channel : format_.channels)
      data_.channels.push_back(make_axis(channel.id, channel.quantity, ""));
    for (const ScoreFile& sim : sims_) data_.sims.push_back(is_own(sim) ? own(sim) : table(sim));
    data_.remarks.insert(data_.remarks.begin(), data_.rig.remarks.begin(), data_.rig.remarks.end());
    return std::move(data_);
  }

 private:
  // What the rig's columns are

  void take_experiment() {
    const Experiment experiment = read_experiment(question_.experiment);
    if (experiment.kind->readings != nullptr)
      throw InputError(fmt::format(
          "{}: its readings are those of {}, which stand in files of their own; a table of readings at rest can be "
          "scored",
          question_.experiment, experiment.kind->about));
    if (!question_.channels.empty())
      throw InputError("--channel: the experiment says what the channels are; leave one of the two out");
    format_ = experiment.bench;
    if (experiment.bench.history.counts)
      data_.remarks.emplace_back("times of the readings (dwell, rest) are not looked at");
    std::error_code none;
    if (!std::filesystem::equivalent(format_.path, question_.rig, none)) format_.excluded.clear();
    format_.path = question_.rig;
    format_.history = {};
    format_.order_column.clear();
    use_only_known(format_, rig_);
    data_.has_noise.assign(format_.channels.size(), true);
    for (size_t c = 0; c < experiment.channels.size(); ++c) {
      if (experiment.channels[c].kind != nullptr && experiment.channels[c].kind->name == "displacement")
        data_.closure.displacements.push_back(static_cast<int>(c));
    }
    for (size_t k = 0; k < format_.controls.size(); ++k) {
      if (experiment.cables.columns.contains(format_.controls[k].id)) data_.closure.retractions.push_back(k);
      for (const LoadSettings& load : experiment.loads) {
        if (load.control == format_.controls[k].id && !data_.closure.load) data_.closure.load = k;
      }
    }
  }

  /// Columns that both files have: controls, where values of the table stand in the rig's file, and channels.
  void guess_format() {
    const ScoreFile& sim = sims_.front();
    const bool own = is_own(sim);
    format_.path = question_.rig;
    std::vector<std::string> unused, common;
    std::vector<size_t> channels;
    for (size_t i = 0; i < rig_.size(); ++i) {
      const std::string base = rig_.base(i);
      if (base == "trial" && format_.trial_column.empty()) {
        format_.trial_column = rig_.name(i);
        continue;
      }
      const bool of_own = own && std::ranges::find(own_columns, base) != own_columns.end();
      const std::optional<size_t> there = of_own ? std::nullopt : sim.find({base});
      const bool named = is_named(i);
      if (!there && !named && !own) {
        unused.push_back(rig_.name(i));
        continue;
      }
      if (named || (own && !there)) {
        if (named || (rig_.unit(i) && rig_.has_numbers(i)))
          channels.push_back(i);
        else
          unused.push_back(rig_.name(i));
        continue;
      }
      common.push_back(rig_.name(i));
      if (!rig_.unit(i) || !rig_.has_numbers(i)) {
        std::set<std::string> labels = rig_.texts(i);
        for (const ScoreFile& other : sims_) {
          if (const std::optional<size_t> column = other.find({base})) labels.merge(other.texts(*column));
        }
        format_.controls.push_back(
            {base, rig_.name(i), {Quantity::pure}, false, {labels.begin(), labels.end()}, "a value of this column"});
      } else if (own || !question_.channels.empty() || shares_values(i, sim, *there)) {
        format_.controls.push_back({base, rig_.name(i), {rig_.unit(i)->quantity}});
      } else {
        channels.push_back(i);
      }
    }
    check_guess(channels, common);
    for (const size_t i : channels) {
      if (!rig_.unit(i))
        throw InputError(fmt::format("{}: the channel '{}' has no unit; end its name in one, for example {}_mm",
                                     rig_.table.at(rig_.table.header.line), rig_.name(i), rig_.name(i)));
      format_.channels.push_back({rig_.base(i), rig_.name(i), rig_.unit(i)->quantity, {no_noise}});
    }
    data_.has_noise.assign(channels.size(), false);
    use_only_known(format_, rig_);
    std::vector<std::string> controls, measured;
    for (const BenchFormat::Control& control : format_.controls) controls.push_back(control.column);
    for (const BenchFormat::Channel& channel : format_.channels) measured.push_back(channel.column);
    data_.remarks.push_back(fmt::format("controls: {}; channels: {}{}{}", join(controls), join(measured),
                                        format_.trial_column.empty() ? "" : "; repeats by " + format_.trial_column,
                                        unused.empty() ? "" : "; not used: " + join(unused)));
  }

  bool is_named(size_t i) const {
    return std::ranges::any_of(question_.channels,
                               [&](const std::string& name) { return name == rig_.name(i) || name == rig_.base(i); });
  }

  void check_guess(const std::vector<size_t>& channels, const std::vector<std::string>& common) const {
    for (const std::string& name : question_.channels) {
      if (!rig_.find({name}))
        throw InputError(fmt::format("--channel {}: {} has no such column{}; it has: {}", name, question_.rig,
                                     did_you_mean(name, rig_.table.header.cells), listed(rig_.table.header.cells)));
    }
    const std::string both =
        common.empty() ? "they have no column in common" : fmt::format("in common they have {}", join(common));
    if (channels.empty())
      throw InputError(fmt::format(
          "{} and {}: no column looks like a prediction ({}); name what was measured with --channel, or give "
          "--experiment",
          question_.rig, question_.sims.front(), both));
    if (format_.controls.empty())
      throw InputError(
          fmt::format("{} and {}: no column looks like a control, by which rows could be matched ({}); name what was "
                      "measured with --channel, or give --experiment",
                      question_.rig, question_.sims.front(), both));
  }

  /// Whether more than half of the values of one of both files are values of the other one.
  bool shares_values(size_t at_rig, const ScoreFile& sim, size_t there) const {
    if (!sim.unit(there) || !sim.has_numbers(there)) return false;
    const std::set<double> rig = rig_.values(at_rig), predicted = sim.values(there);
    double largest = 0;
    for (const double value : rig) largest = std::max(largest, std::abs(value));
    const auto mostly_in = [&](const std::set<double>& some, const std::set<double>& others) {
      const auto shared = std::ranges::count_if(some, [&](double value) {
        const auto near = others.lower_bound(value - same_control * largest);
        return near != others.end() && *near <= value + same_control * largest;
      });
      return 2 * static_cast<size_t>(shared) > some.size();
    };
    return mostly_in(predicted, rig) || mostly_in(rig, predicted);
  }

  void take_noise() {
    for (const auto& [id, text] : question_.noise) {
      const auto channel =
          std::ranges::find_if(format_.channels, [&](const auto& one) { return one.id == id || one.column == id; });
      if (channel == format_.channels.end()) {
        std::vector<std::string> ids;
        for (const BenchFormat::Channel& one : format_.channels) ids.push_back(one.id);
        throw InputError(
            fmt::format("--noise {}: there is no such channel{}; there are: {}", id, did_you_mean(id, ids), join(ids)));
      }
      channel->noise = noise_of(id, text, channel->quantity);
      format_.sigma_column.clear();
      data_.has_noise[static_cast<size_t>(channel - format_.channels.begin())] = true;
    }
    if (question_.noise.empty() || question_.experiment.empty()) return;
    use_only_known(format_, rig_);
    for (const BenchFormat::Channel& channel : format_.channels) {
      if (!channel.noise.given())
        throw InputError(fmt::format(
            "--noise: the file's sigmas are not used then, and channel '{}' has none; give it one too", channel.id));
    }
  }

  /// "0.02 mm + 1.5 %".
  static InstrumentNoise noise_of(const std::string& id, const std::string& text, Quantity quantity) {
    InstrumentNoise noise{0, 0, 0};
    for (size_t begin = 0; begin <= text.size();) {
      const size_t end = std::min(text.find('+', begin), text.size());
      const std::string part(trimmed(std::string_view(text).substr(begin, end - begin)));
      const bool relative = part.ends_with('%') && quantity != Quantity::pure;
      double& target = relative ? noise.relative : noise.absolute;
      const double value = parse_quantity(part, relative ? Quantity::pure : quantity, "--noise " + id);
      if (!(value > 0))
        throw InputError(fmt::format("--noise {}: '{}' is no standard deviation; give a positive one", id, part));
      target = value;
      begin = end + 1;
    }
    return noise;
  }

  // Tables as benches

  /// Other columns than the format's are passed over, by their numbers.
  static void use_only_known(BenchFormat& format, const ScoreFile& file) {
    std::set<std::string> used{format.trial_column, format.channel_column, format.value_column, format.sigma_column};
    for (const BenchFormat::Control& control : format.controls) used.insert(control.column);
    for (const BenchFormat::Channel& channel : format.channels) used.insert(channel.column);
    used.erase("");
    format.ignored.clear();
    for (size_t i = 0; i < file.size(); ++i) {
      if (std::ranges::none_of(used, [&](const std::string& name) { return same_column(name, file.name(i)); }))
        format.ignored.push_back(numbered_column(i));
    }
  }

  /// What both kinds of tables have: no repeats, no noise, none left out.
  BenchFormat without_noise(const ScoreFile& sim) const {
    BenchFormat format = format_;
    format.path = sim.table.path;
    format.trial_column.clear();
    format.sigma_column.clear();
    format.excluded.clear();
    for (BenchFormat::Control& control : format.controls) {
      if (const auto found = sim.find({control.column, control.id, base_of(control.column), control.id + "_1"}))
        control.column = sim.name(*found);
    }
    for (BenchFormat::Channel& channel : format.channels) channel.noise = {no_noise};
    return format;
  }

  static std::string base_of(const std::string& column) {
    const std::optional<HeaderUnit> unit = unit_in_header(column);
    return unit ? unit->name : column;
  }

  SimPredictions table(const ScoreFile& sim) const {
    BenchFormat format = without_noise(sim);
    for (BenchFormat::Channel& channel : format.channels) {
      if (channel.column.empty()) continue;
      if (const auto found = sim.find({channel.column, channel.id, base_of(channel.column)}))
        channel.column = sim.name(*found);
    }
    use_only_known(format, sim);
    return {sim.table.path, read_trials(format).readings};
  }

  /// The predictions.csv of a run: a row a reading, its channel by id, its unit in the head of the column or in the
  /// row.
  SimPredictions own(const ScoreFile& sim) const {
    const CsvTable& table = sim.table;
    const size_t predicted = *sim.find({"predicted"}), channel_at = *sim.find({"channel"});
    const std::optional<size_t> unit_at = sim.find({"unit"});
    BenchFormat format = without_noise(sim);
    for (BenchFormat::Control& control : format.controls) {
      control.labels.clear();  // their numbers stand there
      control.pulls = false;
    }
    for (size_t i = 0; i < sim.size(); ++i) {
      if (std::ranges::none_of(format.controls, [&](const auto& one) { return same_column(one.column, sim.name(i)); }))
        format.ignored.push_back(numbered_column(i));
    }
    const std::vector<LoadRow> rows = read_load_rows(format, table.path);
    const NumberStyle style = number_style(table, {predicted});
    const bool single = format.channels.size() == 1 && sim.texts(channel_at).size() == 1;
    SimPredictions predictions{table.path, {}};
    for (size_t r = 0; r < rows.size(); ++r) {
      const CsvTable::Row& row = table.rows[r];
      const std::string& id = row.cells[channel_at];
      const auto known = std::ranges::find_if(format.channels, [&](const auto& one) { return single || one.id == id; });
      if (known == format.channels.end()) {
        std::vector<std::string> names;
        for (const BenchFormat::Channel& one : format.channels) names.push_back(one.id);
        table.fail(row, channel_at,
                   "'{}' is none of the rig's channels, which are {}; give --experiment, which knows both", shown(id),
                   join(names));
      }
      if (not_taken(row.cells[predicted])) continue;
      const std::optional<double> value = style.number(row.cells[predicted]);
      if (!value) table.fail(row, predicted, "'{}' is no number; run taut again", shown(row.cells[predicted]));
      const std::string where = table.at(row, predicted);
      const double factor = unit_at ? unit_factor(row.cells[*unit_at], known->quantity, where)
                                    : parse_header(table.title(predicted), {known->quantity}, where).factor;
      Reading& reading = predictions.rows.emplace_back();
      reading.line = row.line;
      reading.controls = rows[r].controls;
      reading.channel = static_cast<int>(known - format.channels.begin());
      reading.value = *value * factor;
    }
    return predictions;
  }

  const ScoreQuestion& question_;
  ScoreFile rig_;
  std::vector<ScoreFile> sims_;
  BenchFormat format_;
  ScoreData data_;
};

}  // namespace

ScoreData read_score(const ScoreQuestion& question) {
  return ScoreReader(question).read();
}

}  // namespace taut
