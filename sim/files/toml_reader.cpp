#include "sim/files/toml_reader.hpp"

#include <fmt/format.h>
#include <toml++/toml.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "sim/core/error.hpp"
#include "sim/core/input_file.hpp"
#include "sim/core/text_encoding.hpp"
#include "sim/files/key_table.hpp"

namespace taut {

struct TableReader::Nodes {
  static const toml::table& table(const TableReader& reader) { return *static_cast<const toml::table*>(reader.table_); }

  /// Where what is asked for at a key is noted; null: nowhere.
  static KeyUse* use_of(TableReader& reader, std::string_view key) {
    if (reader.keys_ == nullptr) return nullptr;
    KeyTable& table = *reader.keys_;
    const auto fixed = table.keys.find(std::string(key));
    if (fixed != table.keys.end()) return &fixed->second;
    return reader.ids_ ? table.id.get() : &table.keys[std::string(key)];
  }

  static void note(TableReader& reader, std::string_view key, KeyForm form) {
    if (KeyUse* use = use_of(reader, key)) use->forms.insert(form);
  }

  /// Where readers of a table below, or of tables, note theirs.
  static KeyTable* below(TableReader& reader, std::string_view key, KeyForm::Kind kind) {
    KeyUse* use = use_of(reader, key);
    if (use == nullptr) return nullptr;
    use->forms.insert({kind});
    if (!use->table) use->table = std::make_unique<KeyTable>();
    return use->table.get();
  }

  static const toml::node* find(TableReader& reader, std::string_view key) {
    use_of(reader, key);
    std::vector<std::string>& asked = reader.asked_;
    if (std::find(asked.begin(), asked.end(), key) == asked.end()) asked.emplace_back(key);
    return table(reader).get(key);
  }

  static const toml::node& get(TableReader& reader, std::string_view key) {
    const toml::node* node = find(reader, key);
    if (node == nullptr) reader.fail("", fmt::format("'{}' is missing; add it", key));
    return *node;
  }

  static const toml::array& array(TableReader& reader, std::string_view key, size_t count) {
    const toml::array* array = get(reader, key).as_array();
    if (array == nullptr) reader.fail(key, "a list in square brackets belongs here");
    if (count > 0 && array->size() != count)
      reader.fail(key, fmt::format("the list has {} entries, but {} belong here", array->size(), count));
    return *array;
  }

  /// Of a node that is a number. The library has no double for whole numbers of more digits than a double's.
  static double number_of(const toml::node& node) {
    const auto whole = node.value_exact<int64_t>();
    return whole ? static_cast<double>(*whole) : *node.value_exact<double>();
  }

  /// `entry`: where in a list, from 1; 0: it is none.
  static double quantity(const TableReader& reader, const toml::node& node, std::string_view key, Quantity quantity,
                         size_t entry = 0) {
    if (const auto text = node.value_exact<std::string>()) {
      const std::string where = reader.where(key);
      const auto [number, tolerance] = split_tolerance(*text);
      const double value = parse_quantity(number, quantity, where);
      check_magnitude(value, quantity, where);
      if (!tolerance.empty()) {
        const std::string place =
            fmt::format("{}.{}{}", reader.place_, key, entry == 0 ? "" : fmt::format(".{}", entry));
        (*reader.tolerances_)[place] = {
            half_width(tolerance, value, number.find('%') == std::string::npos, quantity, where), where};
      }
      return value;
    }
    if (quantity == Quantity::pure && node.is_number()) {
      const double value = number_of(node);
      if (std::isfinite(value)) return value;
      reader.fail(key, "the number must be finite");
    }
    if (quantity == Quantity::pure) reader.fail(key, "a number belongs here");
    reader.fail(key, fmt::format("a {} in quotes with its unit belongs here, for example \"1 {}\"; units: {}",
                                 name_of(quantity), units_of(quantity).front(), join(units_of(quantity))));
  }

  /// Far beyond what anybody builds or measures numbers overflow, or vanish beside others.
  static void check_magnitude(double value, Quantity quantity, const std::string& where) {
    const auto [least, most] = quantity == Quantity::length ? std::pair(1e-12, 1e6) : std::pair(1e-30, 1e30);
    if (value == 0 || (std::abs(value) >= least && std::abs(value) <= most)) return;
    throw InputError(fmt::format("{}: {:.4g} {} is too {} for a {}; from {:g} to {:g} {}, or 0, are allowed", where,
                                 value, units_of(quantity).front(), std::abs(value) < least ? "small" : "large",
                                 name_of(quantity), least, most, units_of(quantity).front()));
  }

  /// What stands before and behind "+-" or its sign; "" where there is none.
  static std::pair<std::string, std::string> split_tolerance(const std::string& text) {
    for (const std::string_view sign : {"+-", "+/-", "\u00b1"}) {
      if (const size_t at = text.find(sign); at != std::string::npos)
        return {text.substr(0, at), text.substr(at + sign.size())};
    }
    return {text, ""};
  }

  /// Per cent are of the value, unless that stands in per cent itself.
  static double half_width(std::string_view text, double value, bool may_be_relative, Quantity quantity,
                           const std::string& where) {
    const bool relative = may_be_relative && text.find('%') != std::string_view::npos;
    const double width = relative ? parse_quantity(text, Quantity::pure, where) * std::abs(value)
                                  : parse_quantity(text, quantity, where);
    if (!(width > 0))
      throw InputError(
          fmt::format("{}: the tolerance behind +- must be positive; leave it out where it is not known", where));
    return width;
  }
};

namespace {

constexpr double most_of_toml = 64e6;  // [bytes]

InputError not_toml(const std::string& path, const toml::parse_error& error) {
  return InputError(
      fmt::format("{}:{}: not valid TOML: {}", path, error.source().begin.line, on_one_line(error.description())));
}

}  // namespace

TomlFile::TomlFile(const std::string& path) : path_(path) {
  try {
    const DecodedText text = decoded(read_input_file(path, most_of_toml), path);
    remark_ = text.remark();
    document_ = std::make_shared<const toml::table>(toml::parse(text.text, path));
  } catch (const toml::parse_error& error) {
    throw not_toml(path, error);
  }
}

TomlFile::TomlFile(const std::string& path, std::string_view text) : path_(path) {
  try {
    document_ = std::make_shared<const toml::table>(toml::parse(text, path));
  } catch (const toml::parse_error& error) {
    throw not_toml(path, error);
  }
}

TomlFile::~TomlFile() = default;

TableReader TomlFile::root() const {
  return {document_.get(), path_, "", tolerances_, KeyNotes::now()};
}

bool TomlFile::has(std::string_view key) const {
  return static_cast<const toml::table*>(document_.get())->contains(key);
}

std::string TomlFile::text_at(std::string_view table, std::string_view key) const {
  return (*static_cast<const toml::table*>(document_.get()))[table][key].value_or(std::string());
}

std::string TableReader::where(std::string_view key) const {
  const toml::node* node = key.empty() ? nullptr : Nodes::table(*this).get(key);
  const auto line = (node != nullptr ? node->source() : Nodes::table(*this).source()).begin.line;
  std::string text = line > 0 ? fmt::format("{}:{}", file_, line) : file_;
  if (!name_.empty()) text += fmt::format(": [{}]", name_);
  if (!key.empty()) text += fmt::format("{} {}", name_.empty() ? ":" : "", key);
  return text;
}

void TableReader::fail(std::string_view key, const std::string& what) const {
  if (key.empty()) refuse_misspelt();
  throw InputError(where(key) + ": " + what);
}

bool TableReader::has(std::string_view key) {
  return Nodes::find(*this, key) != nullptr;
}

std::string TableReader::text(std::string_view key) {
  Nodes::note(*this, key, {KeyForm::text});
  const auto value = Nodes::get(*this, key).value_exact<std::string>();
  if (!value) fail(key, "a text in quotes belongs here");
  if (value->empty()) fail(key, "the text is empty");
  return *value;
}

std::string TableReader::text(std::string_view key, std::string fallback) {
  Nodes::note(*this, key, {KeyForm::text});
  return has(key) ? text(key) : std::move(fallback);
}

std::string TableReader::choice(std::string_view key, const std::vector<std::string>& allowed) {
  if (KeyUse* use = Nodes::use_of(*this, key)) use->words.insert(allowed.begin(), allowed.end());
  const std::string value = text(key, allowed.front());
  if (std::find(allowed.begin(), allowed.end(), value) == allowed.end()) {
    fail(key, fmt::format("'{}' is not known{}; allowed: {}", value, did_you_mean(value, allowed), join(allowed)));
  }
  return value;
}

double TableReader::number(std::string_view key) {
  Nodes::note(*this, key, {KeyForm::number});
  const auto value = Nodes::get(*this, key).value<double>();
  if (!value || !Nodes::get(*this, key).is_number()) fail(key, "a number belongs here");
  if (!std::isfinite(*value)) fail(key, "the number must be finite");
  return *value;
}

int TableReader::integer(std::string_view key, int fallback, int smallest, int largest) {
  Nodes::note(*this, key, {KeyForm::integer, Quantity::pure, false, 0, smallest});
  if (!has(key)) return fallback;
  const auto value = Nodes::get(*this, key).value_exact<int64_t>();
  if (value && *value > largest) fail(key, fmt::format("a whole number from {} to {} belongs here", smallest, largest));
  if (!value || *value < smallest) fail(key, fmt::format("a whole number of at least {} belongs here", smallest));
  return static_cast<int>(*value);
}

bool TableReader::boolean(std::string_view key, bool fallback) {
  Nodes::note(*this, key, {KeyForm::boolean});
  if (!has(key)) return fallback;
  const auto value = Nodes::get(*this, key).value_exact<bool>();
  if (!value) fail(key, "true or false belongs here");
  return *value;
}

double TableReader::quantity(std::string_view key, Quantity quantity) {
  Nodes::note(*this, key, {KeyForm::quantity, quantity});
  return Nodes::quantity(*this, Nodes::get(*this, key), key, quantity);
}

std::optional<GivenValue> TableReader::optional_given(std::string_view key) {
  Nodes::note(*this, key, {KeyForm::given});
  if (!has(key)) return std::nullopt;
  const toml::node& node = Nodes::get(*this, key);
  if (const auto value = node.value_exact<std::string>()) return GivenValue{*value, where(key)};
  if (node.is_number()) return GivenValue{fmt::format("{}", Nodes::number_of(node)), where(key)};
  fail(key, "a number, or a text in quotes with a unit, belongs here");
}

std::optional<double> TableReader::optional_quantity(std::string_view key, Quantity wanted) {
  Nodes::note(*this, key, {KeyForm::quantity, wanted});
  if (!has(key)) return std::nullopt;
  return quantity(key, wanted);
}

double TableReader::positive(std::string_view key, Quantity wanted, std::string_view what) {
  const double value = quantity(key, wanted);
  if (!(value > 0)) fail(key, fmt::format("the {} must be positive", what));
  return value;
}

std::optional<double> TableReader::optional_positive(std::string_view key, Quantity wanted, std::string_view what) {
  Nodes::note(*this, key, {KeyForm::quantity, wanted});
  if (!has(key)) return std::nullopt;
  return positive(key, wanted, what);
}

std::vector<double> TableReader::quantities(std::string_view key, Quantity quantity, size_t count) {
  Nodes::note(*this, key, {KeyForm::quantity, quantity, true, count});
  std::vector<double> values;
  for (const toml::node& node : Nodes::array(*this, key, count))
    values.push_back(Nodes::quantity(*this, node, key, quantity, values.size() + 1));
  return values;
}

std::vector<double> TableReader::numbers(std::string_view key, size_t count) {
  return quantities(key, Quantity::pure, count);
}

std::vector<std::string> TableReader::texts(std::string_view key) {
  Nodes::note(*this, key, {KeyForm::text, Quantity::pure, true});
  std::vector<std::string> values;
  for (const toml::node& node : Nodes::array(*this, key, 0)) {
    const auto value = node.value_exact<std::string>();
    if (!value) fail(key, "the list must hold texts in quotes");
    values.push_back(*value);
  }
  if (values.empty()) fail(key, "the list is empty");
  return values;
}

std::vector<std::string> TableReader::texts_or_none(std::string_view key) {
  Nodes::note(*this, key, {KeyForm::text, Quantity::pure, true});
  return has(key) ? texts(key) : std::vector<std::string>{};
}

std::vector<std::string> TableReader::columns_or_none(std::string_view key) {
  Nodes::note(*this, key, {KeyForm::column, Quantity::pure, true});
  std::vector<std::string> values;
  if (!has(key)) return values;
  for (const toml::node& node : Nodes::array(*this, key, 0)) {
    const auto name = node.value_exact<std::string>();
    const auto number = node.value_exact<int64_t>();
    if (!name && (!number || *number < 1))
      fail(key, "the list must hold names of columns in quotes, or their numbers, from 1");
    values.push_back(name ? *name : fmt::format("#{}", *number));
  }
  if (values.empty()) fail(key, "the list is empty");
  return values;
}

std::vector<int> TableReader::integers_or_none(std::string_view key, int smallest) {
  Nodes::note(*this, key, {KeyForm::integer, Quantity::pure, true, 0, smallest});
  std::vector<int> values;
  if (!has(key)) return values;
  for (const toml::node& node : Nodes::array(*this, key, 0)) {
    const auto number = node.value_exact<int64_t>();
    if (!number || *number < smallest || *number > std::numeric_limits<int>::max())
      fail(key, fmt::format("the list must hold whole numbers from {}", smallest));
    values.push_back(static_cast<int>(*number));
  }
  return values;
}

TableReader TableReader::table(std::string_view key) {
  KeyTable* keys = Nodes::below(*this, key, KeyForm::table);
  const toml::node* node = Nodes::find(*this, key);
  if (node == nullptr)
    fail("", fmt::format("the table [{}{}{}] is missing; add it", name_, name_.empty() ? "" : ".", key));
  if (!node->is_table()) fail(key, fmt::format("a table [{}] belongs here", key));
  return {node->as_table(), file_, name_.empty() ? std::string(key) : name_ + "." + std::string(key), tolerances_,
          keys};
}

std::optional<TableReader> TableReader::optional_table(std::string_view key) {
  Nodes::below(*this, key, KeyForm::table);
  if (!has(key)) return std::nullopt;
  return table(key);
}

std::vector<std::pair<std::string, TableReader>> TableReader::named_tables(std::string_view key) {
  Nodes::below(*this, key, KeyForm::table);
  std::vector<std::pair<std::string, TableReader>> tables;
  if (!has(key)) return tables;
  TableReader parent = table(key);
  parent.keys_are_ids();
  for (const auto& [name, node] : Nodes::table(parent))
    tables.emplace_back(std::string(name.str()), parent.table(name.str()));
  return tables;
}

std::vector<TableReader> TableReader::tables(std::string_view key) {
  KeyTable* keys = Nodes::below(*this, key, KeyForm::tables);
  std::vector<TableReader> readers;
  const toml::node* node = Nodes::find(*this, key);
  if (node == nullptr) return readers;
  const std::string name = name_.empty() ? std::string(key) : name_ + "." + std::string(key);
  const toml::array* array = node->as_array();
  if (array == nullptr || !array->is_array_of_tables())
    fail(key, fmt::format("this is a list of tables; write [[{}]]", name));
  for (const toml::node& element : *array) {
    readers.push_back(TableReader(element.as_table(), file_, name, tolerances_, keys));
    const auto id = (*element.as_table())["id"].value_exact<std::string>();
    readers.back().place_ += "." + id.value_or(std::to_string(readers.size()));
  }
  return readers;
}

void TableReader::keys_are_ids() {
  ids_ = true;
  if (keys_ != nullptr && !keys_->id) keys_->id = std::make_unique<KeyUse>();
}

void TableReader::refuse_misspelt() const {
  const toml::table& table = Nodes::table(*this);
  std::vector<std::string> absent;
  for (const std::string& key : asked_) {
    if (!table.contains(key)) absent.push_back(key);
  }
  for (const auto& [key, node] : table) {
    const std::string name(key.str());
    if (std::find(asked_.begin(), asked_.end(), name) != asked_.end()) continue;
    if (const std::string meant = near_name(name, absent); !meant.empty())
      throw InputError(fmt::format("{}:{}: {}unknown key '{}' (did you mean '{}'?); correct it", file_,
                                   key.source().begin.line, name_.empty() ? "" : "[" + name_ + "]: ", name, meant));
  }
}

void TableReader::finish() {
  for (const auto& [key, node] : Nodes::table(*this)) {
    const std::string name(key.str());
    if (std::find(asked_.begin(), asked_.end(), name) != asked_.end()) continue;
    const auto line = key.source().begin.line;
    throw InputError(fmt::format("{}:{}: {}unknown key '{}'{}; allowed: {}", file_, line,
                                 name_.empty() ? "" : "[" + name_ + "]: ", name, did_you_mean(name, asked_),
                                 join(asked_)));
  }
}

}  // namespace taut
