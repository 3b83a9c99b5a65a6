#include "reports/animation.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <nlohmann/json.hpp>

#include "reports/figures.hpp"
#include "reports/html.hpp"
#include "reports/page_data.hpp"
#include "reports/page_texts.hpp"
#include "reports/surface.hpp"

namespace taut {
namespace {

using Json = nlohmann::ordered_json;
using plot::kMillimetre;

constexpr double kSteps = 1e4;  // along the window's largest side

/// A number of at most six digits, so that the file stays small; null for none.
Json short_number(double value) {
  if (!std::isfinite(value)) return nullptr;
  return std::stod(fmt::format("{:.6g}", value));
}

std::vector<double> in_millimetres(const Eigen::VectorXd& x) {
  const Eigen::VectorXd mm = x / kMillimetre;
  return {mm.begin(), mm.end()};
}

/// One entry for each item of a list.
template <class List, class Make>
Json array_of(const List& list, Make&& make) {
  Json array = Json::array();
  for (const auto& item : list) array.push_back(make(item));
  return array;
}

/// Coordinates of points [mm], one after the other.
Json short_coordinates(const std::vector<Eigen::VectorXd>& points) {
  Json array = Json::array();
  for (const Eigen::VectorXd& point : points) {
    for (const double value : point) array.push_back(short_number(value / kMillimetre));
  }
  return array;
}

/// Whole steps of all points of a frame from the window's lower corner.
std::vector<int> steps_of(const SimulationRecord& record, const plot::Surface& surface, const plot::Bounds& bounds,
                          double step, size_t frame) {
  std::vector<int> steps;
  const auto add = [&](const Eigen::MatrixXd& x) {
    for (const auto& point : x.colwise()) {
      for (Eigen::Index c = 0; c < x.rows(); ++c) {
        steps.push_back(static_cast<int>(std::lround((point[c] - bounds.lower[c]) / step)));
      }
    }
  };
  add(plot::positions(surface, record.mesh, record.states[frame]));
  for (const DrawnLine& line : record.lines) add(plot::positions(line, record.mesh, record.states[frame]));
  return steps;
}

std::string frames_text(const std::vector<std::vector<int>>& steps, const std::vector<size_t>& chosen) {
  std::string text = "[";
  for (size_t f = 0; f < chosen.size(); ++f) {
    text += f == 0 ? "[" : ",\n[";
    const std::vector<int>& now = steps[chosen[f]];
    for (size_t i = 0; i < now.size(); ++i) {
      fmt::format_to(std::back_inserter(text), "{}{}", i == 0 ? "" : ",",
                     f == 0 ? now[i] : now[i] - steps[chosen[f - 1]][i]);
    }
    text += "]";
  }
  return text + "]";
}

/// The frames' positions as text of at most `budget` bytes, and which frames they are.
std::pair<std::string, std::vector<size_t>> frames_within(size_t budget, const std::vector<std::vector<int>>& steps) {
  std::vector<size_t> chosen = plot::evenly_chosen(steps.size(), steps.size());
  std::string frames = frames_text(steps, chosen);
  while (frames.size() > budget && chosen.size() > 2) {
    const double kept = std::min(0.9, static_cast<double>(budget) / static_cast<double>(frames.size()));
    chosen = plot::evenly_chosen(steps.size(),
                                 std::max<size_t>(2, static_cast<size_t>(kept * static_cast<double>(chosen.size()))));
    frames = frames_text(steps, chosen);
  }
  return {frames, chosen};
}

/// What is drawn in every frame, and in which colours.
Json scene_json(const SimulationRecord& record, const plot::Surface& surface, const plot::Bounds& bounds, double step,
                const std::vector<size_t>& chosen) {
  Json json{{"dimension", record.mesh.dimension()},
            {"window", {{"lower", in_millimetres(bounds.lower)}, {"upper", in_millimetres(bounds.upper)}}},
            {"step", step / kMillimetre},
            {"regions", Json::array()},
            {"nodes", surface.nodes}};
  for (const std::string& name : record.mesh.region_names)
    json["regions"].push_back({{"name", name}, {"colour", plot::body_colour(name, json["regions"].size())}});
  json["loops"] = array_of(surface.loops, [](const plot::Surface::Loop& loop) {
    return Json{{"region", loop.region}, {"points", loop.points}};
  });
  json["triangles"] = json["triangle_regions"] = Json::array();
  for (const auto& [region, points] : surface.triangles) {
    for (const int point : points) json["triangles"].push_back(point);
    json["triangle_regions"].push_back(region);
  }
  json["lines"] = Json::array();
  const size_t count = record.lines.size();
  for (size_t i = 0; i < count; ++i) {
    const std::string name = plot::lines_are_told_apart(count) ? record.lines[i].id : i == 0 ? "cables" : "";
    json["lines"].push_back(
        {{"name", name}, {"colour", plot::line_colour(i, count)}, {"count", record.lines[i].points.size()}});
  }
  json["obstacles"] = array_of(record.obstacles, short_coordinates);
  using plot::GroundsDrawn;
  for (const auto& [name, which] :
       {std::pair("ground", GroundsDrawn::planes), std::pair("round", GroundsDrawn::round)}) {
    json[name] = Json::array();
    for (size_t frame : plot::grounds_move(record) ? chosen : std::vector<size_t>{0}) {
      std::vector<Eigen::VectorXd> strokes;
      for (const auto& [from, to] : plot::ground_strokes(record, bounds, frame, which))
        strokes.insert(strokes.end(), {from, to});
      json[name].push_back(short_coordinates(strokes));
    }
  }
  return json;
}

/// The sample variable and the series in the chosen frames.
void add_values(Json& json, const SimulationRecord& record, const std::vector<size_t>& chosen) {
  const auto in_frames = [&](const std::vector<double>& values, double unit) {
    return array_of(
        chosen, [&](size_t frame) { return short_number(values[static_cast<size_t>(record.frames[frame])] / unit); });
  };
  const SampleLabel label(record);
  json["sample"] = {{"name", record.sample_name},
                    {"unit", label.unit().label},
                    {"decimals", label.decimals()},
                    {"seconds", record.sample_unit == "s" ? label.unit().factor : 0.0},
                    {"values", in_frames(record.samples, label.unit().factor)}};
  if (const Series* driver = driver_of(record)) {  // time means nothing
    const WrittenUnit unit = shown_unit(driver->unit, driver->values);
    json["sample"] = {{"name", driver->meaning.empty() ? driver->id : driver->meaning},
                      {"unit", unit.label},
                      {"decimals", 2},
                      {"seconds", 0.0},
                      {"values", in_frames(driver->values, unit.factor)}};
  }
  json["series"] = array_of(all_series(record), [&](const Series* series) {
    const WrittenUnit unit = shown_unit(series->unit, series->values);
    const bool control = series >= record.controls.data() && series < record.controls.data() + record.controls.size();
    return Json{{"id", series->id},
                {"meaning", series->meaning},
                {"unit", unit.label},
                {"control", control},
                {"values", in_frames(series->values, unit.factor)}};
  });
}

}  // namespace

std::string animation_json(const SimulationRecord& record, size_t budget) {
  const plot::Surface surface = boundary_surface(record.mesh);
  const plot::Bounds bounds = plot::bounds_of(record);
  const double step = (bounds.upper - bounds.lower).maxCoeff() / kSteps;
  std::vector<std::vector<int>> steps;
  for (size_t f = 0; f < record.states.size(); ++f) steps.push_back(steps_of(record, surface, bounds, step, f));
  const auto [frames, chosen] = frames_within(budget, steps);

  Json json = scene_json(record, surface, bounds, step, chosen);
  add_values(json, record, chosen);
  json["shown"] = chosen.size();
  json["stored"] = record.states.size();
  std::string text = json.dump(-1, ' ', false, Json::error_handler_t::replace);
  text.pop_back();
  text += ",\"frames\":" + frames + "}";
  return within_script(std::move(text));
}

std::string animation_fragment(const SimulationRecord& record) {
  std::string text(page_text("animation.html"));
  const std::string mark = "@DATA@";
  return text.replace(text.find(mark), mark.size(), animation_json(record));
}

std::string animation_html(const SimulationRecord& record) {
  return html::page("Simulation: " + record.title,
                    fmt::format("<h1>Simulation: {}</h1>\n<p>{}</p>\n{}", html::escaped(record.title),
                                html::escaped(record.description), animation_fragment(record)));
}

}  // namespace taut
