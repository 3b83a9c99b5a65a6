#include "reports/run_record.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <nlohmann/json.hpp>
#include <sstream>
#include <stdexcept>
#include <utility>

#include "reports/figures.hpp"
#include "reports/record_checks.hpp"
#include "reports/run_record_members.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kSchema = "taut-fit-1";
constexpr double kInfinity = std::numeric_limits<double>::infinity();

std::string flat(const Json& json) {
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

/// A value in fit.json that knows where it stands. Walking a member of a record writes it there, or reads it from
/// there.
class JsonArchive {
 public:
  JsonArchive(Json& json, const std::string& file, bool reading, std::string key = "")
      : json_(json), file_(file), reading_(reading), key_(std::move(key)) {}

  const Json& json() const { return json_; }
  bool reading() const { return reading_; }

  bool there(const char* key, bool written = true) const { return reading_ ? json_.contains(key) : written; }

  JsonArchive operator[](const std::string& key) const {
    const std::string path = key_.empty() ? key : key_ + "." + key;
    need(json_.is_object(), "an object");
    if (reading_ && !json_.contains(key)) {
      throw InputError(fmt::format("{}: the key '{}' is missing; restore the file or run the fit again", file_, path));
    }
    return {json_[key], file_, reading_, path};
  }
  JsonArchive operator[](size_t i) const { return {json_[i], file_, reading_, fmt::format("{}[{}]", key_, i)}; }

  /// What else is said of a member is for those who write it elsewhere.
  template <class T, class... Else>
  void operator()(const std::string& key, T&& member, const Else&...) const {
    (*this)[key].walk(member);
  }

  /// Throws when what was read is not what is needed.
  void need(bool right, const std::string& what) const {
    if (!reading_ || right) return;
    std::string found = flat(json_);
    if (found.size() > 40) found = "a different " + std::string(json_.type_name());
    throw InputError(fmt::format("{}: the key '{}' holds {} where {} is needed; restore the file or run the fit again",
                                 file_, key_, found, what));
  }

  void walk(int& value) const { walk_if(json_is_in<int>(), value, "a whole number"); }
  void walk(unsigned& value) const { walk_if(json_is_in<unsigned>(), value, "a whole number"); }
  void walk(bool& value) const { walk_if(json_.is_boolean(), value, "true or false"); }
  void walk(std::string& value) const { walk_if(json_.is_string(), value, "text"); }

  /// Numbers that are not finite are null.
  void walk(double& value, double null = std::numeric_limits<double>::quiet_NaN()) const {
    if (reading_ && json_.is_null()) {
      value = null;
    } else if (reading_ || std::isfinite(value)) {
      walk_if(json_.is_number(), value, "a number or null");
    }
  }

  void walk(std::optional<double>& value) const {
    if (reading_) value = json_.is_null() ? std::nullopt : std::optional(0.0);
    if (value) walk(*value);
  }

  void walk(Eigen::MatrixXd& square) const {
    const size_t n = list(static_cast<size_t>(square.rows()));
    if (reading_) square.resize(n, n);
    for (size_t i = 0; i < n; ++i) {
      const JsonArchive row = (*this)[i];
      row.list_of(static_cast<size_t>(square.cols()));
      for (size_t j = 0; j < static_cast<size_t>(square.cols()); ++j) row[j].walk(square(i, j));
    }
  }

  /// Points as x y x y ...: one long paragraph.
  void walk(std::vector<std::array<double, 2>>& points) const {
    std::vector<double> values;
    for (const auto& [x, y] : points) values.insert(values.end(), {x, y});
    walk(values);
    need(values.size() % 2 == 0, "an even number of coordinates");
    points.resize(values.size() / 2);
    for (size_t i = 0; i < values.size(); ++i) points[i / 2][i % 2] = values[i];
  }

  /// Lists, tuples of any kind, enumerations with a name_of(), and records.
  template <class T>
  void walk(T& value) const {
    if constexpr (std::is_enum_v<T>) {
      walk_name(value);
    } else if constexpr (requires { std::tuple_size<T>::value; }) {
      list_of(std::tuple_size_v<T>);
      size_t i = 0;
      std::apply([&](auto&... part) { ((*this)[i++].walk(part), ...); }, value);
    } else if constexpr (requires { value.resize(1); }) {
      walk_list(value, [](const JsonArchive& element, auto& part) { element.walk(part); });
    } else {
      describe(*this, value);
    }
  }

  /// A list, element by element; a span has the number of elements that are needed.
  template <class List, class Each>
  void walk_list(List&& values, Each each) const {
    if constexpr (requires { values.resize(1); })
      values.resize(list(static_cast<size_t>(values.size())));
    else
      list_of(values.size());
    for (size_t i = 0; i < static_cast<size_t>(values.size()); ++i) each((*this)[i], values[i]);
  }

  /// An object from names to numbers.
  void walk_map(std::vector<std::string>& names, Eigen::VectorXd& values) const {
    if (!reading_) json_ = Json::object();
    need(json_.is_object(), "an object");
    for (const auto& [name, value] : json_.items()) names.push_back(name);
    values.resize(static_cast<Eigen::Index>(names.size()));
    for (size_t i = 0; i < names.size(); ++i) (*this)(names[i], values[static_cast<Eigen::Index>(i)]);
  }

  /// Null is no bound.
  void walk_bounds(double& lower, double& upper) const {
    list_of(2);
    (*this)[0].walk(lower, -kInfinity);
    (*this)[1].walk(upper, kInfinity);
  }

  /// A flag as one of two words.
  void walk_either(bool& value, const std::string& yes, const std::string& no) const {
    std::string word = value ? yes : no;
    walk(word);
    need(word == yes || word == no, fmt::format("\"{}\" or \"{}\"", yes, no));
    value = word == yes;
  }

 private:
  /// Whether it is a whole number that the type has.
  template <class T>
  bool json_is_in() const {
    if (!json_.is_number_integer()) return false;
    if (json_.is_number_unsigned()) return json_.get<std::uint64_t>() <= std::numeric_limits<T>::max();
    return std::in_range<T>(json_.get<std::int64_t>());
  }

  template <class T>
  void walk_if(bool right, T& value, const char* needed) const {
    need(right, needed);
    if (reading_)
      value = json_.get<T>();
    else
      json_ = value;
  }

  /// The number of elements of a list, which is what is written.
  size_t list(size_t written) const {
    if (!reading_) json_ = Json(written, nullptr);
    need(json_.is_array(), "a list");
    return json_.size();
  }

  void list_of(size_t size) const {
    if (!reading_) json_ = Json(size, nullptr);
    need(json_.is_array() && json_.size() == size, fmt::format("a list of {}", size));
  }

  /// The value whose name_of() this is; names of values that do not exist are empty.
  template <class Enum>
  void walk_name(Enum& value) const {
    if (!reading_) json_ = name_of(value);
    std::vector<std::string> names;
    for (int i = 0; !name_of(static_cast<Enum>(i)).empty(); ++i) names.emplace_back(name_of(static_cast<Enum>(i)));
    const auto found = std::ranges::find_if(names, [&](const std::string& name) { return json_ == name; });
    need(found != names.end(), "one of: " + join(names));
    value = static_cast<Enum>(found - names.begin());
  }

  Json& json_;
  const std::string& file_;
  bool reading_;
  std::string key_;
};

/// What fits on a line stands on a line; the rest one member per line, but a long list of plain values stays one
/// paragraph. Text that is not UTF-8 gets replacement characters.
void print(const Json& json, const std::string& indent, std::string& out) {
  const std::string line = flat(json);
  if (!json.is_structured() || json.empty() || line.size() + indent.size() <= 110) {
    out += line;
    return;
  }
  const bool object = json.is_object(), paragraph = !object && !json.front().is_structured();
  out += object ? "{" : "[";
  for (auto member = json.begin(); member != json.end(); ++member) {
    if (member != json.begin()) out += ",";
    if (object || member->is_structured()) out += "\n" + indent + "  ";
    if (object) out += flat(member.key()) + ": ";
    print(*member, indent + "  ", out);
  }
  out += (paragraph ? "" : "\n" + indent) + (object ? "}" : "]");
}

std::vector<std::string> named_channels(const RunRecord& record) {
  std::vector<std::string> names;
  for (const ReadingRecord& reading : record.readings) plot::place_in(names, reading.channel);
  for (const CurveRecord& curve : record.curves) plot::place_in(names, curve.channel);
  for (const FrictionRow& row : record.lip_friction) plot::place_in(names, row.channel);
  return names;
}

/// What the parts of a file say of each other. Older files measured nothing but stresses over a strain, and
/// displacements, and have the names of the inputs' copies beside them.
void complete(const JsonArchive& root, RunRecord& record) {
  for (const std::string& name : named_channels(record)) {
    if (!root.there("channels")) {
      record.channels.push_back(over_strain(record) ? make_axis(name, Quantity::pressure, "nominal stress")
                                                    : make_axis(name, Quantity::length, "displacement"));
    } else if (std::ranges::find(record.channels, name, &AxisRecord::id) == record.channels.end()) {
      root["channels"].need(false, fmt::format("the channel '{}' of the readings and curves too", name));
    }
  }
  for (size_t i = 0; i < record.shares.size(); ++i) {
    for (const char* key : {"bias", "error"}) {
      const JsonArchive values = root["shares"][i][key];
      values.need(values.json().size() == record.fit.parameters.size(), "one number for each parameter");
    }
    const std::vector<double>& moves = record.shares[i].moves;
    root["shares"][i].need(moves.empty() || moves.size() == record.fit.parameters.size(),
                           "'moves' with one number for each parameter, or none");
  }
  for (size_t i = 0; i < record.lip_friction.size(); ++i)
    root["lip_friction"][i]["controls"].need(record.lip_friction[i].controls.size() == record.controls.size(),
                                             "one number for each control");
  for (size_t i = 0; i < record.explanations.size(); ++i)
    root["explanations"][i]["shifts"].need(record.explanations[i].shifts.size() == record.fit.parameters.size(),
                                           "one number for each parameter");
  if (root.there("robust"))
    root["robust"].need(record.robust.values.size() == record.fit.parameters.size() &&
                            record.robust.standard_errors.size() == record.fit.parameters.size(),
                        "a value and a standard error for each parameter");
  if (!root.there("experiment_file")) return;
  std::vector<std::string> names(1);
  std::string data;
  root("experiment_file", names.front());
  root("data_file", data);
  std::istringstream text(data);
  for (std::string name; std::getline(text >> std::ws, name, ',');) names.push_back(name);
  names.emplace_back("mesh.msh");
  std::vector<InputRecord>& inputs = record.provenance.inputs;
  for (size_t i = 0; i < inputs.size() && i < names.size(); ++i) inputs[i].copy = names[i];
}

Json parsed(const std::string& file) {
  const std::string text = read_file(file);
  constexpr int deepest = 50;  // ours have about eight levels; what walks them does so by recursion
  try {
    return Json::parse(text, [&](int depth, Json::parse_event_t, Json&) {
      if (depth > deepest)
        throw InputError(fmt::format("{}: is nested {} deep, and no fit.json is; restore the file or run the fit again",
                                     file, depth));
      return true;
    });
  } catch (const Json::parse_error& error) {
    const size_t end = std::min(error.byte, text.size());
    const auto line = 1 + std::count(text.begin(), text.begin() + static_cast<std::ptrdiff_t>(end), '\n');
    throw InputError(fmt::format("{}: is not JSON (line {}); restore the file or run the fit again", file, line));
  } catch (const Json::exception&) {  // a number beyond all numbers
    throw InputError(
        fmt::format("{}: holds a number that is larger than any; restore the file or run the fit again", file));
  }
}

}  // namespace

std::string to_json(const RunRecord& record) {
  if (record.parameter_ids.size() != static_cast<size_t>(record.fit.p.size())) {
    throw std::logic_error(fmt::format("RunRecord::parameter_ids has {} names for {} values in fit.p",
                                       record.parameter_ids.size(), record.fit.p.size()));
  }
  for (const size_t size : {record.load_newtons.size(), record.series.size()}) {
    if (size != 0 && size != record.readings.size())
      throw std::logic_error("RunRecord: load_newtons and series are per reading, or empty");
  }
  Json json{{"schema", kSchema}};
  RunRecord walked = record;
  JsonArchive(json, "", false).walk(walked);
  std::string text;
  print(json, "", text);
  return text + "\n";
}

RunRecord read_run(const std::string& folder) {
  const std::string file = (std::filesystem::path(folder) / "fit.json").string();
  const auto need = [](bool right, const std::string& path, const char* otherwise) {
    if (!right) throw InputError(path + ": " + otherwise);
  };
  std::error_code ignored;
  need(std::filesystem::exists(folder, ignored), folder,
       "there is no such folder; name a folder that 'taut fit' has written");
  need(std::filesystem::is_directory(folder, ignored), folder,
       "is not a folder; name the folder that 'taut fit' has written");
  need(std::filesystem::exists(file, ignored), file,
       "is missing, so no fit was finished in this folder; name another folder or run 'taut fit' into this one");
  Json json = parsed(file);
  need(json.is_object(), file, "holds no JSON object; run the fit again");
  const JsonArchive root(json, file, true);
  if (root["schema"].json() != kSchema) {
    throw InputError(fmt::format("{}: the schema is {} but this version reads \"{}\"; run the fit again with it", file,
                                 flat(json["schema"]), kSchema));
  }
  RunRecord record;
  root.walk(record);
  complete(root, record);
  check_record(record, file);
  return record;
}

}  // namespace taut
