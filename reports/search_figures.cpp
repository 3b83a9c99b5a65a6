#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "reports/run_sections.hpp"
#include "sim/core/units.hpp"

namespace taut::plot {
namespace {

/// A number that the search has at each of its evaluations; NaN where a simulation failed.
struct Course {
  std::string name, unit;
  std::vector<double> values;
};

std::vector<Course> courses_of(const FitResult& fit) {
  std::vector<Course> courses{{"chi squared", "", {}}};
  for (const SearchStep& step : fit.history) courses[0].values.push_back(step.chi_squared);
  for (size_t j = 0; j < fit.parameters.size(); ++j) {
    const ParameterEstimate& estimate = fit.parameters[j];
    double largest = std::abs(estimate.value);
    for (const SearchStep& step : fit.history) largest = std::max(largest, std::abs(step.values[j]));
    const DisplayUnit unit = display_unit(largest, estimate.spec.unit);
    Course& course = courses.emplace_back(Course{estimate.spec.id, unit.name == "1" ? "" : unit.name, {}});
    for (const SearchStep& step : fit.history) course.values.push_back(step.values[j] / unit.factor);
  }
  return courses;
}

/// In decades where the values span more than one.
Axis course_axis(const Course& course) {
  std::vector<double> known;
  std::ranges::copy_if(course.values, std::back_inserter(known), [](double value) { return std::isfinite(value); });
  const std::string label = bracketed(course.name, course.unit);
  const auto [least, most] = std::ranges::minmax(known);
  return least > 0 && most > 8 * least ? logarithmic_axis_over(known, label) : axis_over(known, label, 5, false);
}

}  // namespace

std::optional<Drawing> search_history(const RunRecord& record) {
  const std::vector<SearchStep>& history = record.fit.history;
  const auto known = std::ranges::count_if(history, [](const SearchStep& s) { return std::isfinite(s.chi_squared); });
  if (known < 2) return std::nullopt;
  const std::vector<Course> courses = courses_of(record.fit);
  std::string csv = "kind,channel,unit,series,evaluation,value,phase\n";
  for (const char* kind : {"evaluation", "line"}) {
    for (const Course& course : courses) {
      for (size_t i = 0; i < history.size(); ++i)
        csv += line(kind, course.name, course.unit, "", static_cast<int>(i + 1), course.values[i], history[i].phase);
    }
  }
  const std::vector<LegendEntry> legend = {{LegendEntry::line, "the search", colour(0)},
                                           {LegendEntry::point, "an evaluation", colour(0), 6},
                                           {LegendEntry::point, "replay from rest", colour(1), 7}};
  const Grid grid = Grid({.gap = 76, .above = 34}, legend, 2).panels(courses.size(), 190);
  const std::string title = "The way of the search";
  Page page = grid.page(title, record.title, record.simulated);
  std::vector<double> numbers{1, static_cast<double>(history.size())};
  for (size_t c = 0; c < courses.size(); ++c) {
    Rows way, cold;
    for (size_t i = 0; i < history.size(); ++i) {
      const std::vector<double> point{static_cast<double>(i + 1), courses[c].values[i]};
      if (!std::isfinite(point[1])) continue;
      way.push_back(point);
      if (history[i].phase == "cold replay") cold.push_back(point);
    }
    Plots plots;
    page.add(plots, way, "lines lw 1.4", colour(0));
    page.add(plots, way, "points pt 6 ps 0.8 lw 1.4", colour(0));
    page.add(plots, cold, "points pt 7 ps 1", colour(1));
    const bool lowest = c + grid.columns >= courses.size();
    page.panel(grid.box(c), axis_over(numbers, lowest ? "evaluation of the model" : "", 6, false),
               course_axis(courses[c]), courses[c].name, plots);
  }
  const SearchStep &start = history.front(), &end = history.back();
  const std::string caption = fmt::format(
      "Chi squared and the parameters at each of the {} evaluations of the model in the search{}, from {} to {}. What "
      "is filled was computed again from rest, which is what the result is. The evaluations for intervals are not "
      "among them.",
      history.size(),
      known < std::ssize(history) ? fmt::format(", {} of which failed", std::ssize(history) - known) : "",
      std::isfinite(start.chi_squared) ? fmt::format("{:.4g}", start.chi_squared) : "a start that failed",
      std::isfinite(end.chi_squared) ? fmt::format("{:.4g}", end.chi_squared) : "one that failed");
  return Drawing{{"search_history", title, caption}, csv, page};
}

}  // namespace taut::plot
