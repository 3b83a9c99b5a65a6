#include "reports/page_data.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "reports/page_texts.hpp"
#include "reports/run_sections.hpp"
#include "tests/support/run_records.hpp"

namespace taut {
namespace {

nlohmann::json data_of(const RunRecord& record, size_t budget = 1'000'000) {
  return nlohmann::json::parse(page_data(record, sections_of<RunRecord>(record, kRunPage, ""), budget));
}

TEST(PageData, PointsOfShapesAreThoseOfTheRecordWithinHalfAStep) {
  for (const RunRecord& record : {test::push_puppet_module(), test::hanging_block()}) {
    const nlohmann::json shapes = data_of(record)["shapes"];
    const double step = shapes["step"];
    const auto expect_points = [&](const nlohmann::json& steps, const std::vector<double>& metres) {
      ASSERT_EQ(steps.size(), metres.size());
      for (size_t i = 0; i < metres.size(); ++i)
        ASSERT_NEAR(shapes["lower"][i % 2].get<double>() + step * steps[i].get<double>(), 1e3 * metres[i], 0.51 * step);
    };
    ASSERT_EQ(shapes["states"].size(), record.shapes.size());
    EXPECT_LT(step, 0.05) << "mm";
    for (size_t s = 0; s < record.shapes.size(); ++s) {
      const ShapeRecord& shape = record.shapes[s];
      const nlohmann::json& state = shapes["states"][s];
      EXPECT_EQ(state["label"], shape.label);
      std::vector<double> segments;
      for (const auto& segment : shape.segments) segments.insert(segments.end(), segment.begin(), segment.end());
      if (shape.areas.empty()) expect_points(state["lines"], segments);
      ASSERT_EQ(state["areas"].size(), shape.areas.size());
      const auto flat = [](const ShapeRecord::Line& line) {
        std::vector<double> out;
        for (const auto& point : line) out.insert(out.end(), point.begin(), point.end());
        return out;
      };
      for (size_t a = 0; a < shape.areas.size(); ++a) {
        ASSERT_EQ(state["areas"][a].size(), shape.areas[a].loops.size());
        for (size_t l = 0; l < shape.areas[a].loops.size(); ++l)
          expect_points(state["areas"][a][l], flat(shape.areas[a].loops[l]));
      }
      for (size_t c = 0; c < shape.cables.size(); ++c) expect_points(state["cables"][c], flat(shape.cables[c]));
    }
  }
}

TEST(PageData, InSpacePointsAddUpToThoseOfTheRecordWithinHalfAStepOfEachShownState) {
  const RunRecord record = test::block_in_space();
  const nlohmann::json shapes = data_of(record)["shapes"];
  const double step = shapes["step"];
  EXPECT_LT(step, 0.05) << "mm";
  EXPECT_EQ(shapes["triangles"], nlohmann::json(record.surface.triangles));
  EXPECT_EQ(shapes["regions"][1]["name"], "plastic");
  ASSERT_EQ(shapes["states"].size(), record.shapes.size());
  const auto expect_places = [&](const std::vector<double>& steps, const std::vector<double>& metres) {
    ASSERT_EQ(steps.size(), metres.size());
    for (size_t i = 0; i < metres.size(); ++i)
      EXPECT_NEAR(shapes["lower"][i % 3].get<double>() + step * steps[i], 1e3 * metres[i], 0.51 * step);
  };
  std::vector<double> sum(24, 0.0);
  for (size_t k = 0; k < record.shapes.size(); ++k) {
    const nlohmann::json& state = shapes["states"][k];
    for (size_t i = 0; i < sum.size(); ++i) sum[i] += state["points"][i].get<double>();
    expect_places(sum, record.shapes[k].points);
    expect_places(state["cables"][0], record.shapes[k].space_cables[0]);
    ASSERT_EQ(state["contacts"].size(), record.shapes[k].contacts.size());
    if (k < 2) continue;
    expect_places(state["contacts"][0]["at"], record.shapes[k].contacts[0].centre);
    expect_places(state["contacts"][0]["places"], record.shapes[k].contacts[0].places);
    EXPECT_EQ(state["contacts"][0]["force"], nlohmann::json(record.shapes[k].contacts[0].force));
  }
  // three.js comes along where there is something in space alone.
  const auto page_of = [](const RunRecord& run) { return interactive(run, sections_of<RunRecord>(run, kRunPage, "")); };
  EXPECT_GT(page_of(record).size(), 600'000u);
  EXPECT_NE(page_of(record).find("three.js authors"), std::string::npos) << "its licence";
  EXPECT_LT(page_of(test::hanging_block()).size(), 100'000u);
}

TEST(PageData, ReadingsAreInTheUnitsOfTheirChannelsAndTheExcludedAreMarked) {
  RunRecord record = test::hanging_block();
  record.readings[4].excluded = true;
  record.readings[4].predicted = NAN;
  const nlohmann::json readings = data_of(record)["readings"];
  for (size_t i = 0; i < record.readings.size(); ++i) {
    EXPECT_EQ(readings["line"][i], record.readings[i].line);
    EXPECT_NEAR(readings["measured"][i].get<double>(), 1e3 * record.readings[i].measured, 1e-4);
    EXPECT_EQ(readings["excluded"][i], i == 4 ? 1 : 0);
    EXPECT_EQ(readings["fitted"][i].is_null(), i == 4);
  }
}

TEST(PageData, ShapesAreThinnedOutToTheBudgetWithFirstAndLastKept) {
  const RunRecord record = test::push_puppet_module();
  const nlohmann::json whole = data_of(record), less = data_of(record, 30'000);
  const size_t bytes = less["shapes"]["states"].dump().size();
  EXPECT_LT(bytes, 40'000u);
  EXPECT_GT(bytes, 10'000u);
  EXPECT_EQ(less["stored"], record.shapes.size());
  EXPECT_EQ(less["shapes"]["states"].front(), whole["shapes"]["states"].front());
  EXPECT_EQ(less["shapes"]["states"].back(), whole["shapes"]["states"].back());
}

TEST(PageData, NoTextEndsItsScript) {
  RunRecord record = test::hanging_block();
  for (ReadingRecord& reading : record.readings) reading.trial = "</script><b>";
  const std::string piece = interactive(record, sections_of<RunRecord>(record, kRunPage, ""));
  size_t ends = 0;
  for (size_t at = piece.find("</script"); at != std::string::npos; at = piece.find("</script", at + 1)) ++ends;
  EXPECT_EQ(ends, 2u);
  for (const char* script : {"report.js", "space.js", "three.min.js"})
    EXPECT_EQ(page_text(script).find("</script"), std::string::npos) << script;
  for (const char* script : {"report.js", "space.js"})
    EXPECT_EQ(page_text(script).find("http"), std::string::npos) << script;
}

}  // namespace
}  // namespace taut
