#include "reports/page_data.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
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
constexpr std::array<const char*, 4> kLive = {"force_displacement", "residuals", "effective_stiffness",
                                              "stress_strain"};

/// Six digits: no screen shows more. Null for what is not known.
Json six_digits(double value) {
  if (!std::isfinite(value)) return nullptr;
  return std::stod(fmt::format("{:.6g}", value));
}

/// Points of shapes in whole steps from a corner.
class Steps {
 public:
  explicit Steps(const RunRecord& record) {
    for (const ShapeRecord& shape : record.shapes) {
      for (const auto& [x0, y0, x1, y1] : shape.segments) widen({x0, y0}), widen({x1, y1});
      for (const ShapeRecord::Line& cable : shape.cables) std::ranges::for_each(cable, [&](auto& p) { widen(p); });
    }
    const double size = std::max(high_[0] - low_[0], high_[1] - low_[1]);
    step_ = size > 0 && std::isfinite(size) ? size / kShapeSteps : kMillimetre;
  }
  Json lower() const { return {six_digits(low_[0] / kMillimetre), six_digits(low_[1] / kMillimetre)}; }
  double step() const { return step_; }

  template <class Points>
  Json operator()(const Points& points) const {
    Json list = Json::array();
    for (const auto& point : points) {
      for (size_t c = 0; c < point.size(); ++c) list.push_back(std::lround((point[c] - low_[c % 2]) / step_));
    }
    return list;
  }

 private:
  void widen(const std::array<double, 2>& p) {
    for (size_t c = 0; c < 2; ++c) {
      low_[c] = std::min(low_[c], p[c]);
      high_[c] = std::max(high_[c], p[c]);
    }
  }
  std::array<double, 2> low_ = {INFINITY, INFINITY}, high_ = {-INFINITY, -INFINITY};
  double step_;
};

Json state_json(const ShapeRecord& shape, const Steps& steps) {
  Json state{{"label", shape.label}, {"row", shape.row}, {"column", shape.column}, {"areas", Json::array()}};
  for (const ShapeRecord::Area& area : shape.areas) {
    Json& loops = state["areas"].emplace_back(Json::array());
    for (const ShapeRecord::Line& loop : area.loops) loops.push_back(steps(loop));
  }
  state["cables"] = Json::array();
  for (const ShapeRecord::Line& cable : shape.cables) state["cables"].push_back(steps(cable));
  state["lines"] = shape.areas.empty() ? steps(shape.segments) : Json::array();  // else they are the areas' loops
  return state;
}

/// Shapes of the record that are shown, first and last among them: at most `budget` bytes of them.
std::vector<size_t> shown_shapes(const RunRecord& record, const Steps& steps, size_t budget) {
  size_t bytes = 0;
  for (const ShapeRecord& shape : record.shapes) bytes += state_json(shape, steps).dump().size();
  const size_t all = record.shapes.size();
  return plot::evenly_chosen(all, bytes > budget ? std::max<size_t>(2, all * budget / bytes) : all);
}

Json shapes_json(const RunRecord& record, const std::vector<size_t>& shown, const Steps& steps) {
  Json json{{"axes", record.shape_axes},
            {"lower", steps.lower()},
            {"step", steps.step() / kMillimetre},
            {"regions", Json::array()},
            {"states", Json::array()}};
  for (const ShapeRecord::Area& area : record.shapes[shown.front()].areas)
    json["regions"].push_back(
        {{"name", area.region}, {"colour", plot::region_colour(area.region, json["regions"].size())}});
  for (const size_t i : shown) json["states"].push_back(state_json(record.shapes[i], steps));
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
  return fmt::format("<script type=\"application/json\" id=\"run-data\">{}</script>\n<script>\n{}</script>\n",
                     within_script(page_data(record, sections, budget)), page_text("report.js"));
}

}  // namespace taut
