#include "experiments/cli/schema.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "calib/files/experiment.hpp"
#include "experiments/cli/topics.hpp"
#include "sim/core/error.hpp"
#include "sim/files/key_table.hpp"
#include "sim/files/simulation.hpp"
#include "sim/files/toml_reader.hpp"

namespace taut {
namespace {

using Json = nlohmann::ordered_json;

/// A decimal number as parse_number() takes it.
constexpr std::string_view number_pattern = R"([-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?)";

/// A unit in all its spellings: "um" is "µm" too, "mm2" "mm²", "Nm" "N·m" and "N*m".
std::string unit_pattern(std::string_view unit) {
  if (unit == "in") return R"((in|inch|inches|"))";
  if (unit == "s") return "s(ec)?";
  if (unit == "deg") return "(deg|°)";
  std::string pattern;
  for (size_t i = 0; i < unit.size(); ++i) {
    const bool moment = unit.substr(i, 2) == "Nm";
    switch (unit[i]) {
      case 'u':
        pattern += "[uµμ]";
        break;
      case '2':
        pattern += R"(\^?[2²])";
        break;
      case '3':
        pattern += R"(\^?[3³])";
        break;
      default:
        pattern += unit[i];
    }
    if (moment) pattern += "[·⋅*. ]?";
  }
  return pattern;
}

/// A text that is a number with a unit of this quantity, with a tolerance perhaps.
Json quantity_text(Quantity quantity) {
  const bool pure = quantity == Quantity::pure;
  std::string units;
  for (const std::string& unit : units_of(quantity)) units += (units.empty() ? "" : "|") + unit_pattern(unit);
  const std::string unit = pure ? R"((\s+%)?)" : R"(\s+()" + units + ")";
  const std::string of_tolerance = pure ? unit : R"(\s+()" + units + "|%)";
  return {{"type", "string"},
          {"pattern", fmt::format(R"(^\s*{0}{1}\s*((\+-|\+/-|±)\s*{0}{2}\s*)?$)", number_pattern, unit, of_tolerance)}};
}

/// Made of what readers asked for.
class SchemaMaker {
 public:
  Json object(const KeyTable& table) {
    Json json{{"type", "object"}};
    if (table.keys.empty() && !table.id) return json;
    json["properties"] = Json::object();
    for (const auto& [key, use] : table.keys) json["properties"][key] = value(use);
    json["additionalProperties"] = table.id ? value(*table.id) : Json(false);
    return json;
  }

  Json definitions() const {
    Json json = Json::object();
    for (const Quantity quantity : used_) {
      Json text = quantity_text(quantity);
      const std::string about = fmt::format("{}: {}", name_of(quantity), join(units_of(quantity)));
      if (quantity == Quantity::pure)
        json[name(quantity)] = {{"description", "a number, or per cent in quotes"},
                                {"anyOf", Json::array({Json{{"type", "number"}}, std::move(text)})}};
      else
        json[name(quantity)] = {{"description", about}, {"type", "string"}, {"pattern", text["pattern"]}};
    }
    return json;
  }

 private:
  static std::string name(Quantity quantity) {
    std::string name(name_of(quantity));
    std::ranges::replace(name, ' ', '_');
    return name;
  }

  Json value(const KeyUse& use) {
    std::vector<Json> forms;
    for (const KeyForm& form : use.forms) {
      Json json = one(form, use);
      if (form.list) {
        // A list of any length says all that one of a certain length does.
        const bool any = form.count > 0 && use.forms.contains({form.kind, form.of, true, 0, form.least});
        if (any) continue;
        json = {{"type", "array"}, {"items", std::move(json)}};
        if (form.count > 0) json["minItems"] = json["maxItems"] = form.count;
      }
      if (std::ranges::find(forms, json) == forms.end()) forms.push_back(std::move(json));
    }
    if (forms.empty()) return Json::object();
    if (forms.size() == 1) return forms.front();
    return {{"anyOf", forms}};
  }

  Json one(const KeyForm& form, const KeyUse& use) {
    switch (form.kind) {
      case KeyForm::text:
        if (!use.words.empty() && !form.list) return {{"enum", use.words}};
        return {{"type", "string"}};
      case KeyForm::number:
        return {{"type", "number"}};
      case KeyForm::integer:
        return {{"type", "integer"}, {"minimum", form.least}};
      case KeyForm::boolean:
        return {{"type", "boolean"}};
      case KeyForm::quantity:
        used_.insert(form.of);
        return {{"$ref", "#/definitions/" + name(form.of)}};
      case KeyForm::given:
        return {{"anyOf", Json::array({Json{{"type", "number"}}, Json{{"type", "string"}}})}};
      case KeyForm::column:
        return {{"anyOf", Json::array({Json{{"type", "string"}}, Json{{"type", "integer"}, {"minimum", 1}}})}};
      case KeyForm::table:
        return object(*use.table);
      case KeyForm::tables:
        return {{"type", "array"}, {"items", object(*use.table)}};
    }
    return Json::object();
  }

  std::set<Quantity> used_;
};

}  // namespace

std::string language_of(const std::string& path, std::string_view text) {
  return TomlFile(path, text).has("simulation") ? "simulation" : "experiment";
}

Json schema_of(std::string_view language) {
  KeyTable root;
  {
    const KeyNotes notes(root);
    for (const auto& [document, text] : documents()) {
      const std::string path(document);
      if (!document.ends_with(".toml") || language_of(path, text) != language) continue;
      try {
        if (language == "simulation")
          read_simulation_text(path, text);
        else
          read_experiment_text(path, text);
      } catch (const InputError& error) {
        throw std::logic_error(fmt::format("a file that taut ships is wrong: {}", error.what()));
      }
    }
  }
  SchemaMaker maker;
  Json json{{"$schema", "http://json-schema.org/draft-04/schema#"},
            {"title", fmt::format("taut: {} file", language)},
            {"description", "Keys, words and units; `taut check` knows what depends on other keys."}};
  Json object = maker.object(root);
  json["definitions"] = maker.definitions();
  json.update(object);
  return json;
}

}  // namespace taut
