#include "reports/page_data.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>

#include "reports/axes.hpp"
#include "reports/page_texts.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

using Json = nlohmann::ordered_json;
using plot::kMillimetre;

constexpr double kShapeSteps = 4000;  // along the window's largest side: finer than a screen shows

/// Figures that report.js draws itself, by their CSV.
constexpr std::array<const char*, 5> kLive = {"force_displacement", "residuals", "effective_stiffness", "stress_strain",
                                              "search_history"};

/// Six digits: no screen shows more. Null for what is not known.
Json six_digits(double value) {
  if (!std::isfinite(value)) return nullptr;
  return std::stod(fmt::format("{:.6g}", value));
}

/// Points of shapes in whole steps from a corner: in the drawing plane, or in space where the record has a surface.
class Steps {
 public:
  explicit Steps(const RunRecord& record)
      : dimension_(record.surface.triangles.empty() ? 2 : 3), low_(dimension_, INFINITY), high_(dimension_, -INFINITY) {
    for (const ShapeRecord& shape : record.shapes) {
      if (in_space()) {
        widen(shape.points);
        for (const std::vector<double>& cable : shape.space_cables) widen(cable);
        continue;
      }
      for (const auto& segment : shape.segments) widen(segment);
      for (const ShapeRecord::Line& cable : shape.cables) {
        for (const auto& point : cable) widen(point);
      }
    }
    double size = 0;
    for (size_t c = 0; c < dimension_; ++c) size = std::max(size, high_[c] - low_[c]);
    step_ = size > 0 && std::isfinite(size) ? size / kShapeSteps : kMillimetre;
  }
  bool in_space() const { return dimension_ == 3; }
  Json lower() const {
    Json json = Json::array();
    for (const double value : low_) json.push_back(six_digits(value / kMillimetre));
    return json;
  }
  double step() const { return step_; }

  /// Of coordinates one after the other.
  std::vector<long> of(const auto& coordinates) const {
    std::vector<long> list;
    for (size_t c = 0; c < coordinates.size(); ++c)
      list.push_back(std::lround((coordinates[c] - low_[c % dimension_]) / step_));
    return list;
  }
  /// Of points.
  Json operator()(const auto& points) const {
    Json list = Json::array();
    for (const auto& point : points) {
      for (const long step : of(point)) list.push_back(step);
    }
    return list;
  }

 private:
  void widen(const auto& coordinates) {
    for (size_t c = 0; c < coordinates.size(); ++c) {
      low_[c % dimension_] = std::min(low_[c % dimension_], coordinates[c]);
      high_[c % dimension_] = std::max(high_[c % dimension_], coordinates[c]);
    }
  }
  size_t dimension_;
  std::vector<double> low_, high_;
  double step_;
};

/// `before`: the state that is shown before it, from which points in space are counted; null: none.
Json state_json(const ShapeRecord& shape, const ShapeRecord* before, const Steps& steps) {
  Json state{{"label", shape.label}, {"row", shape.row}, {"column", shape.column}, {"areas", Json::array()}};
  for (const ShapeRecord::Area& area : shape.areas) {
    Json& loops = state["areas"].emplace_back(Json::array());
    for (const ShapeRecord::Line& loop : area.loops) loops.push_back(steps(loop));
  }
  state["cables"] = Json::array();
  for (const ShapeRecord::Line& cable : shape.cables) state["cables"].push_back(steps(cable));
  const bool as_lines = shape.areas.empty() && !steps.in_space();  // else they are the areas' loops
  state["lines"] = as_lines ? steps(shape.segments) : Json::array();
  if (steps.in_space()) {
    std::vector<long> points = steps.of(shape.points);
    if (before != nullptr) std::ranges::transform(points, steps.of(before->points), points.begin(), std::minus());
    state["points"] = points;
    for (const std::vector<double>& cable : shape.space_cables) state["cables"].push_back(steps.of(cable));
  }
  state["contacts"] = Json::array();
  for (const ContactRecord& contact : shape.contacts) {
    Json force = Json::array();
    for (const double value : contact.force) force.push_back(six_digits(value));
    state["contacts"].push_back(
        {{"at", steps.of(contact.centre)}, {"force", force}, {"places", steps.of(contact.places)}});
  }
  return state;
}

Json states_json(const RunRecord& record, const std::vector<size_t>& shown, const Steps& steps) {
  Json states = Json::array();
  for (size_t i = 0; i < shown.size(); ++i)
    states.push_back(state_json(record.shapes[shown[i]], i > 0 ? &record.shapes[shown[i - 1]] : nullptr, steps));
  return states;
}

/// Shapes of the record that are shown, first and last among them: at most `budget` bytes of them.
std::vector<size_t> shown_shapes(const RunRecord& record, const Steps& steps, size_t budget) {
  const size_t all = record.shapes.size();
  const std::vector<size_t> each = plot::evenly_chosen(all, all);
  const size_t bytes = states_json(record, each, steps).dump().size();
  return bytes > budget ? plot::evenly_chosen(all, std::max<size_t>(2, all * budget / bytes)) : each;
}

Json shapes_json(const RunRecord& record, const std::vector<size_t>& shown, const Steps& steps) {
  Json json{{"axes", record.shape_axes},
            {"lower", steps.lower()},
            {"step", steps.step() / kMillimetre},
            {"regions", Json::array()},
            {"triangles", record.surface.triangles},
            {"triangle_regions", record.surface.triangle_regions},
            {"states", states_json(record, shown, steps)}};
  const auto add_region = [&](const std::string& name) {
    json["regions"].push_back({{"name", name}, {"colour", plot::region_colour(name, json["regions"].size())}});
  };
  for (const ShapeRecord::Area& area : record.shapes[shown.front()].areas) add_region(area.region);
  std::ranges::for_each(record.surface.regions, add_region);
  return json;
}

/// The value of a control as shapes and series name it: none has the unit of what there is of it.
std::string control_text(const RunRecord& record, size_t c, double value) {
  const AxisRecord& control = record.controls[c];
  if (!control.labels.empty() && value < 1) return "none";
  if (!control.labels.empty() || value != 0) return text_of(control, value);
  double largest = 0;
  for (const ReadingRecord& r : record.readings) largest = std::max(largest, std::abs(r.controls.at(c)));
  const DisplayUnit unit = display_unit(largest, control.unit);
  return unit.name.empty() || unit.name == "1" ? "0" : "0 " + unit.name;
}

/// "tip_load 0.51 N, retraction 5.89 mm".
std::string setting_of(const RunRecord& record, const ReadingRecord& reading) {
  std::string text;
  for (size_t c = 0; c < reading.controls.size(); ++c)
    text +=
        fmt::format("{}{} {}", c == 0 ? "" : ", ", record.controls[c].id, control_text(record, c, reading.controls[c]));
  return text;
}

Json readings_json(const RunRecord& record, const std::vector<size_t>& shown) {
  std::map<std::pair<std::string, std::string>, size_t> shape_of;  // by what is held and the load
  for (size_t i = 0; i < shown.size(); ++i)
    shape_of.emplace(std::pair(record.shapes[shown[i]].row, record.shapes[shown[i]].column), i);
  const ReadingUnits units(record);
  Json lists = Json::object();
  for (const char* key :
       {"line", "trial", "channel", "series", "setting", "measured", "sigma", "fitted", "excluded", "shape"})
    lists[key] = Json::array();
  const auto k = static_cast<size_t>(std::max(record.load_control, 0));
  for (size_t i = 0; i < record.readings.size(); ++i) {
    const ReadingRecord& r = record.readings[i];
    const std::string series = record.series.empty() ? "" : record.series[i];
    const double unit = units.of(r.channel).factor;
    lists["line"].push_back(r.line);
    lists["trial"].push_back(r.trial);
    lists["channel"].push_back(r.channel);
    lists["series"].push_back(series);
    lists["setting"].push_back(setting_of(record, r));
    lists["measured"].push_back(six_digits(r.measured / unit));
    lists["sigma"].push_back(six_digits(r.sigma / unit));
    lists["fitted"].push_back(six_digits(r.predicted / unit));
    lists["excluded"].push_back(static_cast<int>(r.excluded));
    const std::string column =
        k < r.controls.size() ? record.controls[k].id + " " + control_text(record, k, r.controls[k]) : "";
    const auto found = shape_of.find({series, column});
    lists["shape"].push_back(found == shape_of.end() || column.empty() ? -1 : static_cast<int>(found->second));
  }
  return lists;
}

}  // namespace

std::string page_data(const RunRecord& record, const std::vector<Section>& sections, size_t budget) {
  Json json{{"before", record.simulated ? "SIMULATED DATA: " : ""}, {"figures", Json::object()}};
  for (const Section& section : sections) {
    for (const plot::Drawing& drawing : section.figures) {
      if (std::ranges::count(kLive, drawing.figure.name) > 0) json["figures"][drawing.figure.name] = drawing.csv;
    }
  }
  const bool torque =
      record.load_control >= 0 && record.controls[static_cast<size_t>(record.load_control)].unit == "Nm";
  json["load"] = {{"label", record.load_label.empty() ? "load" : record.load_label}, {"unit", torque ? "Nm" : "N"}};
  const ReadingUnits units(record);
  json["channels"] = Json::array();
  for (const AxisRecord& channel : record.channels)
    json["channels"].push_back({{"id", channel.id}, {"label", channel.label}, {"unit", units.of(channel.id).label}});
  std::vector<size_t> shown;
  if (!record.shapes.empty()) {
    const Steps steps(record);
    shown = shown_shapes(record, steps, budget);
    json["shapes"] = shapes_json(record, shown, steps);
  }
  json["stored"] = record.shapes.size();
  // Samples of recordings are too many to be pointed at.
  if (!over_time(record)) json["readings"] = readings_json(record, shown);
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

std::string within_script(std::string json) {
  for (size_t at = json.find('<'); at != std::string::npos; at = json.find('<', at)) json.replace(at, 1, "\\u003c");
  return json;
}

std::string interactive(const RunRecord& record, const std::vector<Section>& sections, size_t budget) {
  std::string page = fmt::format("<script type=\"application/json\" id=\"run-data\">{}</script>\n",
                                 within_script(page_data(record, sections, budget)));
  if (!record.surface.triangles.empty())
    page += fmt::format("<script>\n/*\n{}*/\n{}\n</script>\n<script>\n{}</script>\n", page_text("three_licence.txt"),
                        page_text("three.min.js"), page_text("space.js"));
  return page + fmt::format("<script>\n{}</script>\n", page_text("report.js"));
}

}  // namespace taut
