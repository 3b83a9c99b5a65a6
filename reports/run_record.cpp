#include "reports/run_record.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "reports/axes.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kSchema = "taut-fit-1";
constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// ---- writing

Json number(double value) {
  return std::isfinite(value) ? Json(value) : Json(nullptr);
}

Json number(const std::optional<double>& value) {
  return value ? number(*value) : Json(nullptr);
}

template <class Values>
Json numbers(const Values& values) {
  Json list = Json::array();
  for (const double value : values) list.push_back(number(value));
  return list;
}

Json rows_of(const Eigen::MatrixXd& matrix) {
  Json list = Json::array();
  for (Eigen::Index i = 0; i < matrix.rows(); ++i) list.push_back(numbers(matrix.row(i)));
  return list;
}

Json pairs(const std::vector<std::pair<std::string, std::string>>& list, const char* first, const char* second) {
  Json all = Json::array();
  for (const auto& [a, b] : list) all.push_back(Json{{first, a}, {second, b}});
  return all;
}

Json axes_json(const std::vector<AxisRecord>& axes) {
  Json list = Json::array();
  for (const AxisRecord& axis : axes)
    list.push_back(Json{{"id", axis.id}, {"quantity", axis.quantity}, {"unit", axis.unit}, {"label", axis.label}});
  return list;
}

Json parameter_json(const ParameterEstimate& estimate) {
  Json profile = Json::array();
  for (const auto& [value, rise] : estimate.profile) profile.push_back(Json::array({number(value), number(rise)}));
  return {{"id", estimate.spec.id},
          {"symbol", estimate.spec.symbol},
          {"meaning", estimate.spec.meaning},
          {"value", number(estimate.value)},
          {"unit", estimate.spec.unit},
          {"standard_error", number(estimate.standard_error)},
          {"interval95", Json::array({number(estimate.lower95), number(estimate.upper95)})},
          {"profile", profile},
          {"verdict", name_of(estimate.verdict)},
          {"explanation", estimate.explanation},
          {"start", number(estimate.start)},
          {"bounds", Json::array({number(estimate.lower), number(estimate.upper)})},
          {"physical_bounds", Json::array({number(estimate.spec.lower), number(estimate.spec.upper)})}};
}

Json fit_json(const RunRecord& record) {
  const FitResult& fit = record.fit;
  if (record.parameter_ids.size() != static_cast<size_t>(fit.p.size())) {
    throw std::logic_error(fmt::format("RunRecord::parameter_ids has {} names for {} values in fit.p",
                                       record.parameter_ids.size(), fit.p.size()));
  }
  Json scales = Json::array();
  for (const ParameterEstimate& estimate : fit.parameters) {
    scales.push_back(estimate.spec.logarithmic ? "logarithm" : "linear");
  }
  Json all = Json::object();
  for (size_t i = 0; i < record.parameter_ids.size(); ++i) {
    all[record.parameter_ids[i]] = number(fit.p[static_cast<Eigen::Index>(i)]);
  }
  const LackOfFit& lack = fit.lack_of_fit;
  return {{"chi_squared", number(fit.chi_squared)},
          {"dof", fit.dof},
          {"chi_squared_p", number(fit.chi_squared_p)},
          {"lack_of_fit",
           {{"available", lack.available},
            {"lack_of_fit", number(lack.lack_of_fit)},
            {"pure_error", number(lack.pure_error)},
            {"lack_of_fit_dof", lack.lack_of_fit_dof},
            {"pure_error_dof", lack.pure_error_dof},
            {"F", number(lack.F)},
            {"p_value", number(lack.p_value)}}},
          {"evaluations", fit.evaluations},
          {"failed_evaluations", fit.failed_evaluations},
          {"iterations", fit.iterations},
          {"covariance", rows_of(fit.covariance)},
          {"covariance_scale", scales},
          {"correlation", rows_of(fit.correlation)},
          {"singular_values", numbers(fit.singular_values)},
          {"weakest_combination", numbers(fit.weakest)},
          {"failures", fit.failures},
          {"all_parameters", all}};
}

Json variant_json(const VariantRecord& variant) {
  return {{"name", variant.name},
          {"mesh", variant.mesh},
          {"unknowns", variant.unknowns},
          {"status", variant.status},
          {"values", numbers(variant.values)},
          {"standard_errors", numbers(variant.standard_errors)},
          {"chi_squared", number(variant.chi_squared)},
          {"seconds", number(variant.seconds)}};
}

Json readings_json(const RunRecord& record) {
  const size_t n = record.readings.size();
  for (const size_t size : {record.load_newtons.size(), record.series.size()}) {
    if (size != 0 && size != n) throw std::logic_error("RunRecord: load_newtons and series are per reading, or empty");
  }
  Json list = Json::array();
  for (size_t i = 0; i < n; ++i) {
    const ReadingRecord& r = record.readings[i];
    Json entry = {{"line", r.line},
                  {"trial", r.trial},
                  {"channel", r.channel},
                  {"controls", numbers(r.controls)},
                  {"measured", number(r.measured)},
                  {"sigma", number(r.sigma)},
                  {"predicted", number(r.predicted)},
                  {"prediction_se", number(r.prediction_se)}};
    if (!record.load_newtons.empty()) entry["load_N"] = number(record.load_newtons[i]);
    if (!record.series.empty()) entry["series"] = record.series[i];
    list.push_back(entry);
  }
  return list;
}

/// What curves run over.
const char* load_key(const RunRecord& record) {
  return over_strain(record) ? "strain" : over_time(record) ? "time_s" : "load_N";
}

Json curves_json(const RunRecord& record) {
  Json list = Json::array();
  for (const CurveRecord& curve : record.curves) {
    list.push_back(Json{{"channel", curve.channel},
                        {"series", curve.series},
                        {load_key(record), numbers(curve.load)},
                        {"value", numbers(curve.value)},
                        {"se", numbers(curve.se)},
                        {"increment_se", numbers(curve.increment_se)}});
  }
  return list;
}

Json lines_json(const std::vector<ShapeRecord::Line>& lines) {
  Json list = Json::array();
  for (const ShapeRecord::Line& line : lines) {
    Json points = Json::array();  // x y x y ...: one long paragraph each
    for (const auto& [x, y] : line) {
      points.push_back(number(x));
      points.push_back(number(y));
    }
    list.push_back(points);
  }
  return list;
}

Json shapes_json(const RunRecord& record) {
  Json list = Json::array();
  for (const ShapeRecord& shape : record.shapes) {
    Json segments = Json::array();
    for (const std::array<double, 4>& segment : shape.segments) segments.push_back(numbers(segment));
    Json json{{"label", shape.label}, {"segments", segments}};
    if (!shape.row.empty() || !shape.column.empty()) {
      json["row"] = shape.row;
      json["column"] = shape.column;
    }
    if (!shape.areas.empty()) {
      json["areas"] = Json::array();
      for (const ShapeRecord::Area& area : shape.areas)
        json["areas"].push_back({{"region", area.region}, {"loops", lines_json(area.loops)}});
    }
    if (!shape.cables.empty()) json["cables"] = lines_json(shape.cables);
    list.push_back(json);
  }
  return list;
}

Json provenance_json(const Provenance& provenance) {
  Json inputs = Json::array();
  for (const InputRecord& input : provenance.inputs)
    inputs.push_back({{"path", input.path}, {"copy", input.copy}, {"sha256", input.sha256}});
  return {{"version", provenance.version},
          {"commit", provenance.commit},
          {"command_line", provenance.command_line},
          {"libraries", pairs(provenance.libraries, "name", "version")},
          {"inputs", inputs},
          {"started", provenance.started},
          {"machine", provenance.machine},
          {"seed", provenance.seed}};
}

/// What fits on a line stands on a line; the rest one member per line. Text that is not UTF-8 gets replacement
/// characters.
void print(const Json& json, const std::string& indent, std::string& out) {
  const std::string flat = json.dump(-1, ' ', false, Json::error_handler_t::replace);
  if (!json.is_structured() || json.empty() || flat.size() + indent.size() <= 110) {
    out += flat;
    return;
  }
  const std::string deeper = indent + "  ";
  const bool object = json.is_object();
  out += object ? "{" : "[";
  bool first = true;
  for (const auto& [key, value] : json.items()) {
    if (object || value.is_structured()) {
      out += (first ? "\n" : ",\n") + deeper;
    } else {
      out += first ? "" : ",";  // a long list of plain values stays one paragraph
    }
    if (object) out += Json(key).dump(-1, ' ', false, Json::error_handler_t::replace) + ": ";
    print(value, deeper, out);
    first = false;
  }
  const bool paragraph = !object && !json.front().is_structured();
  out += (paragraph ? "" : "\n" + indent) + (object ? "}" : "]");
}

// ---- reading

/// A value in fit.json that knows where it stands.
class Entry {
 public:
  Entry(const Json& json, const std::string& file, std::string key) : json_(json), file_(file), key_(std::move(key)) {}

  bool has(const char* key) const { return json_.is_object() && json_.contains(key); }

  Entry at(const char* key) const {
    if (!json_.is_object()) wrong("an object");
    const auto found = json_.find(key);
    const std::string path = key_.empty() ? key : key_ + "." + key;
    if (found == json_.end()) {
      throw InputError(fmt::format("{}: the key '{}' is missing; restore the file or run the fit again", file_, path));
    }
    return {*found, file_, path};
  }

  std::vector<Entry> list() const {
    if (!json_.is_array()) wrong("a list");
    std::vector<Entry> entries;
    for (size_t i = 0; i < json_.size(); ++i) entries.emplace_back(json_[i], file_, fmt::format("{}[{}]", key_, i));
    return entries;
  }

  Entry at(size_t i, size_t size) const {
    if (!json_.is_array() || json_.size() != size) wrong(fmt::format("a list of {}", size));
    return {json_[i], file_, fmt::format("{}[{}]", key_, i)};
  }

  double number(double null = kNaN) const {
    if (json_.is_null()) return null;
    if (!json_.is_number()) wrong("a number or null");
    return json_.get<double>();
  }

  std::optional<double> optional() const { return json_.is_null() ? std::nullopt : std::optional(number()); }

  int integer() const {
    if (!json_.is_number_integer()) wrong("a whole number");
    return json_.get<int>();
  }

  bool flag() const {
    if (!json_.is_boolean()) wrong("true or false");
    return json_.get<bool>();
  }

  std::string text() const {
    if (!json_.is_string()) wrong("text");
    return json_.get<std::string>();
  }

  std::vector<double> numbers() const {
    std::vector<double> values;
    for (const Entry& entry : list()) values.push_back(entry.number());
    return values;
  }

  std::vector<std::string> texts() const {
    std::vector<std::string> values;
    for (const Entry& entry : list()) values.push_back(entry.text());
    return values;
  }

  Eigen::VectorXd vector() const {
    const std::vector<double> values = numbers();
    return Eigen::Map<const Eigen::VectorXd>(values.data(), static_cast<Eigen::Index>(values.size()));
  }

  Eigen::MatrixXd square() const {
    const auto n = static_cast<Eigen::Index>(list().size());
    Eigen::MatrixXd matrix(n, n);
    for (Eigen::Index i = 0; i < n; ++i) {
      for (Eigen::Index j = 0; j < n; ++j) {
        matrix(i, j) = at(static_cast<size_t>(i), static_cast<size_t>(n))
                           .at(static_cast<size_t>(j), static_cast<size_t>(n))
                           .number();
      }
    }
    return matrix;
  }

  std::vector<std::pair<std::string, std::string>> pairs(const char* first, const char* second) const {
    std::vector<std::pair<std::string, std::string>> values;
    for (const Entry& entry : list()) values.emplace_back(entry.at(first).text(), entry.at(second).text());
    return values;
  }

  /// The value whose name_of() is this text; names of values that do not exist are empty.
  template <class Enum>
  Enum one_of() const {
    std::vector<std::string> names;
    for (int i = 0; !name_of(static_cast<Enum>(i)).empty(); ++i) {
      names.emplace_back(name_of(static_cast<Enum>(i)));
      if (json_.is_string() && json_.get<std::string>() == names.back()) return static_cast<Enum>(i);
    }
    wrong("one of: " + join(names));
  }

  [[noreturn]] void wrong(const std::string& expected) const {
    std::string found = json_.dump(-1, ' ', false, Json::error_handler_t::replace);
    if (found.size() > 40) found = "a different " + std::string(json_.type_name());
    throw InputError(fmt::format("{}: the key '{}' holds {} where {} is needed; restore the file or run the fit again",
                                 file_, key_, found, expected));
  }

  const Json& json() const { return json_; }

 private:
  const Json& json_;
  const std::string& file_;
  std::string key_;
};

ParameterEstimate read_parameter(const Entry& entry, const Entry& scale) {
  ParameterEstimate estimate;
  estimate.spec.id = entry.at("id").text();
  estimate.spec.symbol = entry.at("symbol").text();
  estimate.spec.unit = entry.at("unit").text();
  estimate.spec.meaning = entry.at("meaning").text();
  estimate.spec.lower = entry.at("physical_bounds").at(0, 2).number(-kInfinity);
  estimate.spec.upper = entry.at("physical_bounds").at(1, 2).number(kInfinity);
  const std::string scale_name = scale.text();
  if (scale_name != "logarithm" && scale_name != "linear") scale.wrong("\"logarithm\" or \"linear\"");
  estimate.spec.logarithmic = scale_name == "logarithm";
  estimate.value = entry.at("value").number();
  estimate.standard_error = entry.at("standard_error").number();
  estimate.lower95 = entry.at("interval95").at(0, 2).optional();
  estimate.upper95 = entry.at("interval95").at(1, 2).optional();
  for (const Entry& point : entry.at("profile").list())
    estimate.profile.emplace_back(point.at(0, 2).number(), point.at(1, 2).number());
  estimate.verdict = entry.at("verdict").one_of<Verdict>();
  estimate.explanation = entry.at("explanation").text();
  estimate.start = entry.at("start").number();
  estimate.lower = entry.at("bounds").at(0, 2).number(-kInfinity);
  estimate.upper = entry.at("bounds").at(1, 2).number(kInfinity);
  return estimate;
}

void read_fit(const Entry& root, RunRecord& record) {
  FitResult& result = record.fit;
  result.status = root.at("status").one_of<FitStatus>();
  result.message = root.at("message").text();
  const Entry fit = root.at("fit");
  const std::vector<Entry> parameters = root.at("parameters").list();
  for (size_t i = 0; i < parameters.size(); ++i) {
    result.parameters.push_back(read_parameter(parameters[i], fit.at("covariance_scale").at(i, parameters.size())));
  }
  result.chi_squared = fit.at("chi_squared").number();
  result.dof = fit.at("dof").integer();
  result.chi_squared_p = fit.at("chi_squared_p").number();
  const Entry lack = fit.at("lack_of_fit");
  result.lack_of_fit.available = lack.at("available").flag();
  result.lack_of_fit.lack_of_fit = lack.at("lack_of_fit").number();
  result.lack_of_fit.pure_error = lack.at("pure_error").number();
  result.lack_of_fit.lack_of_fit_dof = lack.at("lack_of_fit_dof").integer();
  result.lack_of_fit.pure_error_dof = lack.at("pure_error_dof").integer();
  result.lack_of_fit.F = lack.at("F").number();
  result.lack_of_fit.p_value = lack.at("p_value").number();
  result.evaluations = fit.at("evaluations").integer();
  result.failed_evaluations = fit.at("failed_evaluations").integer();
  result.iterations = fit.at("iterations").integer();
  result.covariance = fit.at("covariance").square();
  result.correlation = fit.at("correlation").square();
  result.singular_values = fit.at("singular_values").vector();
  result.weakest = fit.at("weakest_combination").vector();
  result.failures = fit.at("failures").texts();
  const Entry all = fit.at("all_parameters");
  if (!all.json().is_object()) all.wrong("an object");
  for (const auto& [id, value] : all.json().items()) record.parameter_ids.push_back(id);
  result.p.resize(static_cast<Eigen::Index>(record.parameter_ids.size()));
  for (size_t i = 0; i < record.parameter_ids.size(); ++i) {
    result.p[static_cast<Eigen::Index>(i)] = all.at(record.parameter_ids[i].c_str()).number();
  }
}

void read_readings(const Entry& list, RunRecord& record) {
  for (const Entry& entry : list.list()) {
    ReadingRecord reading;
    reading.line = entry.at("line").integer();
    reading.trial = entry.at("trial").text();
    reading.channel = entry.at("channel").text();
    reading.controls = entry.at("controls").numbers();
    reading.measured = entry.at("measured").number();
    reading.sigma = entry.at("sigma").number();
    reading.predicted = entry.at("predicted").number();
    reading.prediction_se = entry.at("prediction_se").number();
    record.readings.push_back(reading);
    // Either all readings have them or none.
    if (list.json().front().contains("load_N")) record.load_newtons.push_back(entry.at("load_N").number());
    if (list.json().front().contains("series")) record.series.push_back(entry.at("series").text());
  }
}

std::vector<AxisRecord> read_axes(const Entry& list) {
  std::vector<AxisRecord> axes;
  for (const Entry& entry : list.list()) {
    AxisRecord& axis = axes.emplace_back();
    axis.id = entry.at("id").text();
    axis.unit = entry.at("unit").text();
    if (entry.has("quantity")) {
      axis.quantity = entry.at("quantity").text();
      axis.label = entry.at("label").text();
    } else {  // older files have units only
      try {
        axis.quantity = name_of(quantity_of_si_unit(axis.unit));
      } catch (const std::logic_error&) {
        entry.at("unit").wrong("an SI unit");
      }
      axis.label = is(axis, Quantity::pure) ? "engineering strain" : axis.id;
    }
  }
  return axes;
}

std::vector<std::string> named_channels(const RunRecord& record) {
  std::vector<std::string> names;
  const auto add = [&](const std::string& name) {
    if (std::ranges::find(names, name) == names.end()) names.push_back(name);
  };
  for (const ReadingRecord& reading : record.readings) add(reading.channel);
  for (const CurveRecord& curve : record.curves) add(curve.channel);
  return names;
}

/// Older files measured nothing but stresses over a strain, and displacements.
std::vector<AxisRecord> channels_of_older_files(const RunRecord& record) {
  std::vector<AxisRecord> channels;
  for (const std::string& name : named_channels(record)) {
    channels.push_back(over_strain(record) ? make_axis(name, Quantity::pressure, "nominal stress")
                                           : make_axis(name, Quantity::length, "displacement"));
  }
  return channels;
}

void check_channels(const Entry& root, const RunRecord& record) {
  for (const std::string& name : named_channels(record)) {
    if (std::ranges::find(record.channels, name, &AxisRecord::id) == record.channels.end())
      root.at("channels").wrong(fmt::format("the channel '{}' of the readings and curves too", name));
  }
}

std::vector<ShapeRecord::Line> read_lines(const Entry& list) {
  std::vector<ShapeRecord::Line> lines;
  for (const Entry& entry : list.list()) {
    const std::vector<double> values = entry.numbers();
    if (values.size() % 2 != 0) entry.wrong("an even number of coordinates");
    ShapeRecord::Line& line = lines.emplace_back();
    for (size_t i = 0; i < values.size(); i += 2) line.push_back({values[i], values[i + 1]});
  }
  return lines;
}

ShapeRecord read_shape(const Entry& entry) {
  ShapeRecord shape{entry.at("label").text(), {}};
  for (const Entry& segment : entry.at("segments").list()) {
    shape.segments.push_back(
        {segment.at(0, 4).number(), segment.at(1, 4).number(), segment.at(2, 4).number(), segment.at(3, 4).number()});
  }
  if (entry.has("row")) {
    shape.row = entry.at("row").text();
    shape.column = entry.at("column").text();
  }
  if (entry.has("areas")) {
    for (const Entry& area : entry.at("areas").list())
      shape.areas.push_back({area.at("region").text(), read_lines(area.at("loops"))});
  }
  if (entry.has("cables")) shape.cables = read_lines(entry.at("cables"));
  return shape;
}

VariantRecord read_variant(const Entry& entry) {
  VariantRecord variant;
  variant.name = entry.at("name").text();
  variant.mesh = entry.at("mesh").text();
  variant.unknowns = entry.at("unknowns").integer();
  variant.status = entry.at("status").text();
  variant.values = entry.at("values").numbers();
  variant.standard_errors = entry.at("standard_errors").numbers();
  variant.chi_squared = entry.at("chi_squared").number();
  variant.seconds = entry.at("seconds").number();
  return variant;
}

/// Files that were written before copies were named have the names beside them.
std::vector<InputRecord> read_inputs(const Entry& list, const Entry& root) {
  std::vector<InputRecord> inputs;
  for (const Entry& entry : list.list())
    inputs.push_back(
        {entry.at("path").text(), entry.has("copy") ? entry.at("copy").text() : "", entry.at("sha256").text()});
  if (!root.has("experiment_file")) return inputs;
  std::vector<std::string> names{root.at("experiment_file").text()};
  std::istringstream data(root.at("data_file").text());
  for (std::string name; std::getline(data >> std::ws, name, ',');) names.push_back(name);
  names.emplace_back("mesh.msh");
  for (size_t i = 0; i < inputs.size() && i < names.size(); ++i) inputs[i].copy = names[i];
  return inputs;
}

Provenance read_provenance(const Entry& root, const Entry& wall_seconds) {
  const Entry entry = root.at("provenance");
  Provenance provenance;
  provenance.version = entry.at("version").text();
  provenance.commit = entry.at("commit").text();
  provenance.command_line = entry.at("command_line").text();
  provenance.libraries = entry.at("libraries").pairs("name", "version");
  provenance.inputs = read_inputs(entry.at("inputs"), root);
  provenance.started = entry.at("started").text();
  provenance.machine = entry.at("machine").text();
  provenance.seed = static_cast<unsigned>(entry.at("seed").integer());
  provenance.wall_seconds = wall_seconds.number();
  return provenance;
}

RunRecord read_record(const Entry& root) {
  RunRecord record;
  record.title = root.at("title").text();
  const std::string data = root.at("data").text();
  if (data != "measured" && data != "simulated") root.at("data").wrong("\"measured\" or \"simulated\"");
  record.simulated = data == "simulated";
  record.interrupted = root.has("interrupted") && root.at("interrupted").flag();
  record.controls = read_axes(root.at("controls"));
  record.load_label = root.at("load").at("label").text();
  record.load_control = root.at("load").at("control").integer();
  if (record.load_control >= static_cast<int>(record.controls.size()))
    root.at("load").at("control").wrong("the index of a control, or -1");
  read_fit(root, record);
  read_readings(root.at("readings"), record);
  for (const Entry& entry : root.at("curves").list()) {
    record.curves.push_back({entry.at("channel").text(), entry.at("series").text(),
                             entry.at(load_key(record)).numbers(), entry.at("value").numbers(),
                             entry.at("se").numbers(), entry.at("increment_se").numbers()});
  }
  record.channels = root.has("channels") ? read_axes(root.at("channels")) : channels_of_older_files(record);
  check_channels(root, record);
  for (const Entry& entry : root.at("shapes").list()) record.shapes.push_back(read_shape(entry));
  if (root.has("trend_degree")) record.trend_degree = root.at("trend_degree").integer();
  for (size_t i = 0; i < 2; ++i) record.shape_axes[i] = root.at("shape_axes").at(i, 2).text();
  record.main = read_variant(root.at("main"));
  for (const Entry& entry : root.at("variants").list()) record.variants.push_back(read_variant(entry));
  for (const Entry& entry : root.at("diagnostics").list()) {
    record.diagnostics.push_back({entry.at("parameter").text(), entry.at("part").text(), entry.at("value").number(),
                                  entry.at("standard_error").number(), entry.at("chi_squared").number(),
                                  entry.at("readings").integer()});
  }
  if (root.has("swings")) {
    for (const Entry& entry : root.at("swings").list()) {
      record.swings.push_back({entry.at("recording").text(), entry.at("channel").text(),
                               entry.at("frequency_Hz").number(), entry.at("decay_per_s").number(),
                               entry.at("predicted_frequency_Hz").number(),
                               entry.at("predicted_decay_per_s").number()});
    }
  }
  if (root.has("shares")) {
    for (const Entry& entry : root.at("shares").list()) {
      record.shares.push_back({entry.at("source").text(), entry.at("bias").numbers(), entry.at("error").numbers(),
                               entry.at("how").text(), entry.at("seconds").number()});
      const DiscretisationShare& share = record.shares.back();
      if (share.bias.size() != record.fit.parameters.size()) entry.at("bias").wrong("one number for each parameter");
      if (share.error.size() != record.fit.parameters.size()) entry.at("error").wrong("one number for each parameter");
    }
  }
  for (const Entry& entry : root.at("references").list()) {
    record.references.push_back({entry.at("parameter").text(), entry.at("value").number(), entry.at("source").text()});
  }
  record.setup = root.at("setup").pairs("name", "value");
  record.remarks = root.at("remarks").texts();
  const Entry timing = root.at("timing");
  record.replay_seconds = timing.at("replay_seconds").number();
  record.replay_factorisations = timing.at("replay_factorisations").integer();
  record.fit.search = {timing.at("fit_seconds").number(), timing.at("fit_factorisations").integer()};
  record.fit.profiles = {timing.at("profile_seconds").number(), timing.at("profile_factorisations").integer()};
  record.provenance = read_provenance(root, timing.at("wall_seconds"));
  return record;
}

}  // namespace

std::string to_json(const RunRecord& record) {
  Json variants = Json::array();
  for (const VariantRecord& variant : record.variants) variants.push_back(variant_json(variant));
  Json diagnostics = Json::array();
  for (const DiagnosticRecord& diagnostic : record.diagnostics) {
    diagnostics.push_back({{"parameter", diagnostic.parameter},
                           {"part", diagnostic.part},
                           {"value", number(diagnostic.value)},
                           {"standard_error", number(diagnostic.standard_error)},
                           {"chi_squared", number(diagnostic.chi_squared)},
                           {"readings", diagnostic.readings}});
  }
  Json swings = Json::array();
  for (const SwingRecord& swing : record.swings) {
    swings.push_back({{"recording", swing.recording},
                      {"channel", swing.channel},
                      {"frequency_Hz", number(swing.frequency)},
                      {"decay_per_s", number(swing.decay)},
                      {"predicted_frequency_Hz", number(swing.predicted_frequency)},
                      {"predicted_decay_per_s", number(swing.predicted_decay)}});
  }
  Json shares = Json::array();
  for (const DiscretisationShare& share : record.shares) {
    shares.push_back({{"source", share.source},
                      {"bias", numbers(share.bias)},
                      {"error", numbers(share.error)},
                      {"how", share.how},
                      {"seconds", number(share.seconds)}});
  }
  Json references = Json::array();
  for (const ReferenceRecord& r : record.references) {
    references.push_back(Json{{"parameter", r.parameter}, {"value", number(r.value)}, {"source", r.source}});
  }
  Json parameters = Json::array();
  for (const ParameterEstimate& estimate : record.fit.parameters) parameters.push_back(parameter_json(estimate));

  const Json json = {{"schema", kSchema},
                     {"title", record.title},
                     {"data", record.simulated ? "simulated" : "measured"},
                     {"kind", over_strain(record) ? "material point"
                              : over_time(record) ? "recordings"
                                                  : "specimen"},
                     {"status", name_of(record.fit.status)},
                     {"message", record.fit.message},
                     {"parameters", parameters},
                     {"shares", shares},
                     {"fit", fit_json(record)},
                     {"interrupted", record.interrupted},
                     {"controls", axes_json(record.controls)},
                     {"channels", axes_json(record.channels)},
                     {"load", {{"label", record.load_label}, {"control", record.load_control}}},
                     {"readings", readings_json(record)},
                     {"curves", curves_json(record)},
                     {"shape_axes", record.shape_axes},
                     {"shapes", shapes_json(record)},
                     {"trend_degree", record.trend_degree},
                     {"main", variant_json(record.main)},
                     {"variants", variants},
                     {"diagnostics", diagnostics},
                     {"swings", swings},
                     {"references", references},
                     {"setup", pairs(record.setup, "name", "value")},
                     {"remarks", record.remarks},
                     {"timing",
                      {{"wall_seconds", number(record.provenance.wall_seconds)},
                       {"replay_seconds", number(record.replay_seconds)},
                       {"replay_factorisations", record.replay_factorisations},
                       {"fit_seconds", number(record.fit.search.seconds)},
                       {"fit_factorisations", record.fit.search.factorisations},
                       {"profile_seconds", number(record.fit.profiles.seconds)},
                       {"profile_factorisations", record.fit.profiles.factorisations}}},
                     {"provenance", provenance_json(record.provenance)}};
  std::string text;
  print(json, "", text);
  return text + "\n";
}

RunRecord read_run(const std::string& folder) {
  const std::string file = (std::filesystem::path(folder) / "fit.json").string();
  std::error_code ignored;
  if (!std::filesystem::exists(folder, ignored)) {
    throw InputError(fmt::format("{}: there is no such folder; name a folder that 'taut fit' has written", folder));
  }
  if (!std::filesystem::is_directory(folder, ignored)) {
    throw InputError(fmt::format("{}: is not a folder; name the folder that 'taut fit' has written", folder));
  }
  if (!std::filesystem::exists(file, ignored)) {
    throw InputError(fmt::format(
        "{}: is missing, so no fit was finished in this folder; name another folder or run 'taut fit' into this one",
        file));
  }
  const std::string text = read_file(file);
  Json json;
  try {
    json = Json::parse(text);
  } catch (const Json::parse_error& error) {
    const size_t end = std::min(error.byte, text.size());
    const auto line = 1 + std::count(text.begin(), text.begin() + static_cast<std::ptrdiff_t>(end), '\n');
    throw InputError(fmt::format("{}: is not JSON (line {}); restore the file or run the fit again", file, line));
  }
  const Entry root(json, file, "");
  if (!json.is_object()) throw InputError(fmt::format("{}: holds no JSON object; run the fit again", file));
  const Entry schema = root.at("schema");
  if (schema.json() != kSchema) {
    throw InputError(fmt::format("{}: the schema is {} but this version reads \"{}\"; run the fit again with it", file,
                                 schema.json().dump(-1, ' ', false, Json::error_handler_t::replace), kSchema));
  }
  try {
    return read_record(root);
  } catch (const Json::exception& error) {
    throw InputError(fmt::format("{}: cannot be read ({}); restore it or run the fit again", file, error.what()));
  }
}

}  // namespace taut
