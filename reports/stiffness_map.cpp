#include "reports/stiffness_map.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>

#include "reports/axes.hpp"
#include "reports/figures.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

using Json = nlohmann::ordered_json;
using plot::LegendEntry;
using plot::Rows;

/// "control 12.34 mm, load 50 g".
std::string place_of(const StiffnessMap& map, const StiffnessMapText& text, double control, double load) {
  const DisplayUnit across = display_unit(map.controls.back(), text.control.unit);
  const DisplayUnit along = display_unit(map.loads.back(), text.load.unit);
  return fmt::format("{} {:.4g} {}, {} {:.4g} {}", text.control.id, control / across.factor, across.name, text.load.id,
                     load / along.factor, along.name);
}

constexpr const char* kRule = "bilinear in the logarithm of the stiffness between the nodes around";

}  // namespace

std::string interpolation_error(const StiffnessMap& map, const StiffnessMapText& text) {
  std::string sentence;
  for (const bool mixed : {false, true}) {
    const StiffnessMap::Check* worst = map.worst(mixed);
    if (worst == nullptr) continue;
    const auto count = std::ranges::count(map.checks, mixed, &StiffnessMap::Check::mixed);
    sentence += fmt::format(
        "{}at {} points half-way between nodes{} it is off by {:.2g} % (root mean square), at most {:.2g} % ({})",
        sentence.empty() ? "" : "; ", count, mixed ? " some of which are closed and some open" : "",
        100 * map.rms_error(mixed), 100 * worst->error(), place_of(map, text, worst->control, worst->load));
  }
  return sentence.empty() ? "no point between the nodes could be checked" : sentence;
}

namespace {

std::string held_text(const StiffnessMapText& text) {
  std::string held;
  for (size_t k = 0; k < text.held.size(); ++k)
    held += fmt::format(", {} {}", text.held[k].id, text_of(text.held[k], text.held_at[k]));
  return held;
}

/// A colour of a scale from dark violet (0) to yellow green (1), as a number.
int shade_of(double t) {
  constexpr int steps = 64;
  const auto i = static_cast<size_t>(std::clamp(t, 0.0, 1.0) * (steps - 1));
  return std::stoi(plot::ordered_colour(steps - 1 - i, steps).substr(1), nullptr, 16);
}

/// Both panels and their legend.
class MapFigure {
 public:
  MapFigure(const StiffnessMap& map, const StiffnessMapText& text, double wanted, const std::vector<double>& found)
      : map_(map),
        text_(text),
        wanted_(wanted),
        found_(found),
        control_unit_(shown_unit(text.control.unit, map.controls)),
        load_unit_(display_unit(map.loads.back(), text.load.unit)),
        unit_(display_unit(wanted, "N/m")) {
    for (const StiffnessMap::Node& node : map.nodes) {
      if (!(node.state.stiffness > 0)) continue;
      lowest_ = std::min(lowest_, node.state.stiffness);
      highest_ = std::max(highest_, node.state.stiffness);
    }
  }

  plot::Drawing drawn() {
    const size_t loads = map_.loads.size();
    std::vector<LegendEntry> legend{{LegendEntry::heading, text_.load.id}};
    for (size_t j = 0; j < loads; ++j)
      legend.push_back({LegendEntry::line, load_text(map_.loads[j]), plot::ordered_colour(j, loads)});
    legend.push_back({LegendEntry::band, "95 %, noise and shares"});
    if (std::ranges::any_of(map_.nodes, [](const auto& node) { return node.state.touching; }))
      legend.push_back({LegendEntry::point, "surfaces touch (closed)", plot::kBlack, 7});
    legend.push_back({LegendEntry::dashes, fmt::format("wanted: {}", with_unit(wanted_, "N/m"))});
    legend.push_back({LegendEntry::heading, fmt::format("stiffness [{}]", unit_.name)});
    for (const double t : {1.0, 0.75, 0.5, 0.25, 0.0})
      legend.push_back({LegendEntry::area,
                        fmt::format("{:.3g}", lowest_ * std::pow(highest_ / lowest_, t) / unit_.factor),
                        fmt::format("#{:06x}", shade_of(t))});
    plot::Grid grid({.above = 34}, legend);
    grid.rows({330, 230});
    const std::string title = fmt::format("Tangent stiffness along {} over {}", text_.load.id, text_.control.id);
    plot::Page page = grid.page(title, text_.title + held_text(text_), text_.simulated);
    curves(page, grid.box(0));
    cells(page, grid.box(1));
    const std::string caption = fmt::format(
        "How hard the specimen is to deflect further, dF/dx where the load acts, by the fitted model: one curve for "
        "each "
        "load with its 95 % band; below it over both. Filled points: surfaces touch. Between the nodes ln k is "
        "interpolated: {}.",
        interpolation_error(map_, text_));
    return {{"stiffness_map", title, caption}, stiffness_map_csv(map_, text_), page};
  }

 private:
  std::string load_text(double value) const {
    return fmt::format("{:.4g} {}", value / load_unit_.factor, load_unit_.name);
  }

  void curves(plot::Page& page, const plot::Box& box) const {
    plot::Plots plots;
    std::vector<double> values{wanted_ / unit_.factor}, places;
    for (const double control : map_.controls) places.push_back(control / control_unit_.factor);
    for (size_t j = 0; j < map_.loads.size(); ++j) {
      plot::Band band;
      Rows open, touching;
      for (size_t i = 0; i < map_.controls.size(); ++i) {
        const StiffnessMap::Node& node = map_.node(i, j);
        if (!(node.state.stiffness > 0)) continue;
        const double k = node.state.stiffness / unit_.factor;
        // On a logarithmic axis a band that reaches below zero ends at a tenth.
        const double half = std::isfinite(node.half.total) ? std::min(node.half.total / unit_.factor, 0.9 * k) : 0;
        band.add(places[i], k, 0, half);
        (node.state.touching ? touching : open).push_back({places[i], k});
        values.insert(values.end(), {k, k - half, k + half});
      }
      const std::string colour = plot::ordered_colour(j, map_.loads.size());
      if (!band.middle.empty()) band.draw(page, colour, plots);
      page.add(plots, open, "points pt 6 ps 0.6", colour);
      page.add(plots, touching, "points pt 7 ps 0.7", colour);
    }
    std::string extra = plot::horizontal_line(wanted_ / unit_.factor, plot::kGrey, plot::kDashed);
    for (const double found : found_)
      extra += plot::vertical_line(found / control_unit_.factor, plot::kGrey, plot::kDashed);
    page.panel(box, plot::axis_over(places, bracketed(text_.control.id, control_unit_.label), 8, false),
               plot::logarithmic_axis_over(values, bracketed("stiffness", unit_.name)), "", plots, extra);
  }

  void cells(plot::Page& page, const plot::Box& box) const {
    constexpr int across = 96, up = 32;
    Rows boxes, touching;
    const double left = map_.controls.front(), right = map_.controls.back(), top = map_.loads.back();
    const double dx = (right - left) / across, dy = top / up;
    for (int a = 0; a < across; ++a) {
      for (int b = 0; b < up; ++b) {
        const double x = left + (a + 0.5) * dx, y = (b + 0.5) * dy, k = map_.at(x, y);
        if (!(k > 0)) continue;
        const double t = highest_ > lowest_ ? std::log(k / lowest_) / std::log(highest_ / lowest_) : 0.5;
        boxes.push_back({x / control_unit_.factor, y / load_unit_.factor, (x - 0.55 * dx) / control_unit_.factor,
                         (x + 0.55 * dx) / control_unit_.factor, (y - 0.55 * dy) / load_unit_.factor,
                         (y + 0.55 * dy) / load_unit_.factor, static_cast<double>(shade_of(t))});
      }
    }
    for (const StiffnessMap::Node& node : map_.nodes) {
      if (node.state.touching)
        touching.push_back({node.state.controls[map_.control] / control_unit_.factor,
                            node.state.controls[map_.load] / load_unit_.factor});
    }
    plot::Plots plots;
    if (!boxes.empty())
      plots.push_back(page.data(boxes) + " using 1:2:3:4:5:6:7 with boxxyerror fs solid 1 noborder lc rgb variable");
    page.add(plots, touching, "points pt 7 ps 0.7", plot::kBlack);
    std::vector<double> places, loads;
    for (const double control : map_.controls) places.push_back(control / control_unit_.factor);
    for (const double load : map_.loads) loads.push_back(load / load_unit_.factor);
    page.panel(box, plot::axis_over(places, bracketed(text_.control.id, control_unit_.label), 8, false),
               plot::axis_over(loads, bracketed(text_.load.id, load_unit_.name), 4, true), "", plots, "unset grid\n");
  }

  const StiffnessMap& map_;
  const StiffnessMapText& text_;
  double wanted_;
  const std::vector<double>& found_;
  WrittenUnit control_unit_;
  DisplayUnit load_unit_, unit_;
  double lowest_ = std::numeric_limits<double>::infinity(), highest_ = 0;
};

}  // namespace

std::string stiffness_map_csv(const StiffnessMap& map, const StiffnessMapText& text) {
  std::string csv = fmt::format("# {}{}{}\n# interpolation: {}; {}\n", text.simulated ? "SIMULATED DATA: " : "",
                                text.title, held_text(text), kRule, interpolation_error(map, text));
  csv += fmt::format("{}_{},{}_{},stiffness_N_per_m,noise_half95_N_per_m,total_half95_N_per_m,touching,slipped",
                     text.control.id, column_suffix(text.control.unit), text.load.id, column_suffix(text.load.unit));
  for (const AxisRecord& channel : text.channels) csv += fmt::format(",{}_{}", channel.id, column_suffix(channel.unit));
  csv += "\n";
  for (const StiffnessMap::Node& node : map.nodes) {
    const TunedState& state = node.state;
    csv += fmt::format("{:.10g},{:.10g},{},{},{},{:d},{:d}", state.controls[map.control], state.controls[map.load],
                       plot::field(state.stiffness), plot::field(node.half.noise), plot::field(node.half.total),
                       state.touching, state.slipped);
    for (size_t c = 0; c < text.channels.size(); ++c) csv += "," + plot::field(state.readings[c]);
    csv += "\n";
  }
  return csv;
}

std::string stiffness_map_json(const StiffnessMap& map, const StiffnessMapText& text) {
  Json json{{"title", text.title}, {"data", text.simulated ? "simulated" : "measured"}};
  const auto axis = [](const AxisRecord& of, const std::vector<double>& values) {
    return Json{{"id", of.id}, {"unit", of.unit}, {"values", values}};
  };
  json["control"] = axis(text.control, map.controls);
  json["load"] = axis(text.load, map.loads);
  json["held"] = Json::object();
  for (size_t k = 0; k < text.held.size(); ++k) json["held"][text.held[k].id] = text.held_at[k];
  const auto rows_of = [&](auto&& value) {
    Json rows = Json::array();
    for (size_t i = 0; i < map.controls.size(); ++i) {
      Json row = Json::array();
      for (size_t j = 0; j < map.loads.size(); ++j) row.push_back(value(map.node(i, j)));
      rows.push_back(row);
    }
    return rows;
  };
  json["stiffness_N_per_m"] = rows_of([](const auto& node) { return node.state.stiffness; });
  json["noise_half95_N_per_m"] = rows_of([](const auto& node) { return node.half.noise; });
  json["total_half95_N_per_m"] = rows_of([](const auto& node) { return node.half.total; });
  json["touching"] = rows_of([](const auto& node) { return node.state.touching; });
  json["slipped"] = rows_of([](const auto& node) { return node.state.slipped; });
  json["channels"] = Json::object();
  for (size_t c = 0; c < text.channels.size(); ++c)
    json["channels"][text.channels[c].id] = {
        {"unit", text.channels[c].unit}, {"values", rows_of([&](const auto& node) { return node.state.readings[c]; })}};
  Json& interpolation = json["interpolation"] = {{"rule", kRule}, {"checks", map.checks.size()}};
  for (const bool mixed : {false, true}) {
    const StiffnessMap::Check* worst = map.worst(mixed);
    if (worst == nullptr) continue;
    interpolation[mixed ? "where_closing_runs_through" : "elsewhere"] = {{"rms_relative_error", map.rms_error(mixed)},
                                                                         {"largest_relative_error", worst->error()},
                                                                         {"largest_at", {worst->control, worst->load}}};
  }
  return json.dump(1) + "\n";
}

Figure draw_stiffness_map(const StiffnessMap& map, const StiffnessMapText& text, double wanted,
                          const std::vector<double>& found, const std::string& folder) {
  return plot::finished(MapFigure(map, text, wanted, found).drawn(), folder);
}

}  // namespace taut
