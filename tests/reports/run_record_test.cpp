#include "reports/run_record.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <limits>
#include <nlohmann/json.hpp>
#include <tuple>

#include "reports/estimate_text.hpp"
#include "reports/run_sections.hpp"
#include "tests/support/message.hpp"
#include "tests/support/run_records.hpp"

namespace taut {
namespace {

using test::expect_input_error;
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// A folder for one test, removed at its end.
class RunRecordTest : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = std::filesystem::temp_directory_path() /
              ("taut_" + std::string(::testing::UnitTest::GetInstance()->current_test_info()->name()) +
               std::to_string(getpid()));
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_);
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }
  std::string path(const std::string& name) const { return (folder_ / name).string(); }

  /// Writes fit.json of the hanging block after `edit` has changed it.
  template <class Edit>
  void write_edited(Edit&& edit) const {
    nlohmann::ordered_json json = nlohmann::ordered_json::parse(to_json(test::hanging_block()));
    edit(json);
    write_file(path("fit.json"), json.dump());
  }

  std::filesystem::path folder_;
};

TEST_F(RunRecordTest, SurfacesContactsAndTheHistoryOfTheSearchSurviveAndAreCheckedAgainstEachOther) {
  const RunRecord record = test::block_in_space();
  write_file(path("fit.json"), to_json(record));
  const RunRecord again = read_run(folder_.string());
  EXPECT_EQ(to_json(again), to_json(record));
  EXPECT_EQ(again.surface.triangles, record.surface.triangles);
  EXPECT_EQ(again.shapes[3].points, record.shapes[3].points);
  EXPECT_EQ(again.shapes[3].contacts[0].force, record.shapes[3].contacts[0].force);
  ASSERT_EQ(again.fit.history.size(), 4u);
  EXPECT_EQ(again.fit.history[1].values, std::vector<double>{280e3});
  EXPECT_TRUE(std::isnan(again.fit.history[2].chi_squared));
  const auto refused = [&](const std::function<void(nlohmann::ordered_json&)>& spoil, const std::string& key) {
    nlohmann::ordered_json json = nlohmann::ordered_json::parse(to_json(record));
    spoil(json);
    write_file(path("fit.json"), json.dump());
    test::expect_input_error([&] { read_run(folder_.string()); }, {"fit.json", key, "run the fit again"});
  };
  refused([](auto& json) { json["surface"]["triangles"][4] = 8; }, "shapes[0].points");
  refused([](auto& json) { json["surface"]["triangles"][4] = -1; }, "surface.triangles");
  refused([](auto& json) { json["surface"]["triangle_regions"][0] = 2; }, "surface.triangle_regions");
  refused([](auto& json) { json["shapes"][2]["points"].push_back(0.1); }, "shapes[2].points");
  refused([](auto& json) { json["shapes"][2]["space_cables"][0].push_back(0.1); }, "shapes[2].space_cables");
  refused([](auto& json) { json["shapes"][3]["contacts"][0]["force"].push_back(0.1); }, "shapes[3].contacts");
  refused([](auto& json) { json["fit"]["history"][0]["values"].push_back(0.1); }, "fit.history");
}

TEST_F(RunRecordTest, AreasAndCablesOfShapesSurviveAndOlderFilesHaveNone) {
  const RunRecord record = test::push_puppet_module();
  write_file(path("fit.json"), to_json(record));
  RunRecord again = read_run(folder_.string());
  ASSERT_EQ(again.shapes.size(), record.shapes.size());
  const ShapeRecord &a = again.shapes.back(), &b = record.shapes.back();
  EXPECT_EQ(a.row, b.row);
  EXPECT_EQ(a.column, b.column);
  EXPECT_EQ(a.cables, b.cables);
  ASSERT_EQ(a.areas.size(), 2u);
  EXPECT_EQ(a.areas[1].region, "plastic");
  EXPECT_EQ(a.areas[1].loops, b.areas[1].loops);
  EXPECT_EQ(again.trend_degree, 2);

  nlohmann::ordered_json json = nlohmann::ordered_json::parse(to_json(record));
  json.erase("trend_degree");
  for (auto& shape : json["shapes"]) {
    for (const char* key : {"areas", "cables", "row", "column"}) shape.erase(key);
  }
  write_file(path("fit.json"), json.dump());
  again = read_run(folder_.string());
  EXPECT_TRUE(again.shapes.back().areas.empty());
  EXPECT_TRUE(again.shapes.back().cables.empty());
  EXPECT_EQ(again.trend_degree, 0);

  json = nlohmann::ordered_json::parse(to_json(record));
  json["shapes"][0]["cables"][0].push_back(1.0);
  write_file(path("fit.json"), json.dump());
  expect_input_error([&] { read_run(folder_.string()); }, {"shapes[0].cables[0]", "even number of coordinates"});
}

TEST_F(RunRecordTest, ReadingBackReproducesTheRecord) {
  for (const RunRecord& record :
       {test::hanging_block(), test::tendon_finger(), test::push_puppet_module(), RunRecord()}) {
    write_file(path("fit.json"), to_json(record));
    const RunRecord again = read_run(folder_.string());
    EXPECT_EQ(to_json(again), to_json(record));
    EXPECT_EQ(again.parameter_ids, record.parameter_ids);
    EXPECT_EQ(again.fit.p, record.fit.p);
    EXPECT_EQ(again.load_newtons, record.load_newtons);
    EXPECT_EQ(again.series, record.series);
    EXPECT_EQ(again.simulated, record.simulated);
    ASSERT_EQ(again.readings.size(), record.readings.size());
    for (size_t i = 0; i < again.readings.size(); ++i) {
      EXPECT_EQ(again.readings[i].measured, record.readings[i].measured);
      EXPECT_EQ(again.readings[i].controls, record.readings[i].controls);
    }
  }
}

TEST_F(RunRecordTest, CurvesAtTheStartSurviveWithNullWhereTheModelFailedThere) {
  RunRecord record = test::hanging_block();
  EXPECT_FALSE(nlohmann::json::parse(to_json(record)).contains("start_curves"));
  record.start_curves = {record.curves[1]};
  record.start_curves[0].value[3] = kNaN;
  write_file(path("fit.json"), to_json(record));
  const RunRecord again = read_run(folder_.string());
  ASSERT_EQ(again.start_curves.size(), 1u);
  EXPECT_EQ(again.start_curves[0].channel, record.curves[1].channel);
  EXPECT_EQ(again.start_curves[0].load, record.curves[1].load);
  EXPECT_TRUE(std::isnan(again.start_curves[0].value[3]));
  EXPECT_EQ(again.start_curves[0].value[4], record.curves[1].value[4]);
}

TEST_F(RunRecordTest, ProfilesAndDiagnosticsSurviveFailedOnesAsNull) {
  RunRecord record = test::push_puppet_module();
  record.diagnostics[1].value = record.diagnostics[1].standard_error = kNaN;
  const auto json = nlohmann::json::parse(to_json(record));
  EXPECT_EQ(json["parameters"][0]["profile"][0], nlohmann::json::parse("[55800.0, 3.9]"));
  EXPECT_TRUE(json["diagnostics"][1]["value"].is_null());
  write_file(path("fit.json"), to_json(record));
  const RunRecord again = read_run(folder_.string());
  for (size_t p = 0; p < 2; ++p) EXPECT_EQ(again.fit.parameters[p].profile, record.fit.parameters[p].profile);
  EXPECT_FALSE(again.fit.parameters[1].lower95.has_value());
  ASSERT_EQ(again.diagnostics.size(), 4u);
  for (size_t i : {0, 2, 3}) {
    const DiagnosticRecord &a = again.diagnostics[i], &b = record.diagnostics[i];
    EXPECT_EQ(std::tie(a.parameter, a.part, a.value, a.standard_error, a.chi_squared, a.readings),
              std::tie(b.parameter, b.part, b.value, b.standard_error, b.chi_squared, b.readings));
  }
  EXPECT_TRUE(std::isnan(again.diagnostics[1].value));
  EXPECT_EQ(again.diagnostics[1].part, "retraction = 5.89 mm");
}

TEST_F(RunRecordTest, PartsThatTheOthersDoNotPredictAreNamedAndSurvive) {
  RunRecord record = test::hanging_block();
  EXPECT_EQ(held_out_text(record), "");
  record.held_out = {{"retraction = 0 mm", 12, 9.5, 12, 0.66, {}}, {"retraction = 6 mm", 3, 8, 2, 0.02, {"k_cable"}}};
  write_file(path("fit.json"), to_json(record));
  RunRecord again = read_run(folder_.string());
  EXPECT_EQ(to_json(again), to_json(record));
  EXPECT_EQ(again.held_out[1].own, std::vector<std::string>{"k_cable"});
  EXPECT_TRUE(held_out_verdict(again).starts_with("Left out one by one")) << "0.02 in two parts is nothing";
  EXPECT_NE(held_out_text(again).find("6 mm: chi squared 8 for 2, p = 0.02; without it k_cable"), std::string::npos);
  again.held_out[0].p_value = 1e-4;
  EXPECT_TRUE(held_out_verdict(again).starts_with("The readings at retraction = 0 mm are NOT what"));
}

TEST_F(RunRecordTest, ExplanationsTheRobustFitAndExcludedReadingsSurviveAndOlderFilesHaveNone) {
  RunRecord record = test::hanging_block();
  Explanation& zero = record.explanations.emplace_back();
  zero.kind = "zero error";
  zero.what = "a zero error of 'tip': +0.20 +- 0.01 mm";
  zero.lines = {4, 7};
  zero.values = {2e-4};
  zero.p_value = 1e-9;
  zero.shifts = {-310};
  zero.like = {"a drift"};
  record.robust = {"Student's t", {2.7e5}, {1.7e3}, {{9, "tip_top", -0.02, -0.01, -12}}};
  record.readings[3].excluded = true;
  write_file(path("fit.json"), to_json(record));
  const RunRecord again = read_run(folder_.string());
  ASSERT_EQ(again.explanations.size(), 1u);
  const Explanation& read = again.explanations[0];
  EXPECT_EQ(std::tie(read.kind, read.what, read.lines, read.values, read.p_value, read.shifts, read.like),
            std::tie(zero.kind, zero.what, zero.lines, zero.values, zero.p_value, zero.shifts, zero.like));
  EXPECT_EQ(again.robust.values, record.robust.values);
  ASSERT_EQ(again.robust.outliers.size(), 1u);
  EXPECT_EQ(again.robust.outliers[0].off, -12);
  for (size_t i = 0; i < again.readings.size(); ++i) EXPECT_EQ(again.readings[i].excluded, i == 3);
  write_edited([](auto& json) { json.erase("explanations"); });
  EXPECT_TRUE(read_run(folder_.string()).explanations.empty());
  EXPECT_EQ(read_run(folder_.string()).robust.method, "");
  write_edited([&](auto& json) { json["explanations"] = {{{"kind", "zero error"}}}; });
  expect_input_error([&] { read_run(folder_.string()); }, {"explanations[0].name"});
  zero.shifts = {1, 2};
  write_file(path("fit.json"), to_json(record));
  expect_input_error([&] { read_run(folder_.string()); }, {"explanations[0].shifts", "one number for each parameter"});
}

TEST_F(RunRecordTest, FrictionOfTheLipsSurvivesIsSaidAndStandsOnThePage) {
  RunRecord record = test::push_puppet_module();
  EXPECT_EQ(friction_text(record), "");
  std::vector<double> controls(record.controls.size(), 0.01);
  record.lip_friction = {{record.channels[0].id, controls, 2e-3, 1.9e-3, 500, 526.3},
                         {record.channels[0].id, controls, 1e-3, 0.8e-3, kNaN, kNaN}};
  write_file(path("fit.json"), to_json(record));
  const RunRecord again = read_run(folder_.string());
  ASSERT_EQ(again.lip_friction.size(), 2u);
  EXPECT_EQ(again.lip_friction[0].controls, controls);
  EXPECT_EQ(again.lip_friction[0].sticking, 1.9e-3);
  EXPECT_EQ(again.lip_friction[0].sticking_stiffness, 526.3);
  EXPECT_TRUE(std::isnan(again.lip_friction[1].sliding_stiffness));
  const std::string text = friction_text(again);
  EXPECT_NE(text.find("2 closed rows by 20 % at most"), std::string::npos) << text;
  EXPECT_NE(text.find("1 mm with lips that slide, 800 um with lips that stick"), std::string::npos) << text;
  EXPECT_NE(fitted_parameters(again)->html.find("<h2>Friction of the lips</h2>"), std::string::npos);
  write_edited([](auto& json) {
    json["lip_friction"] = {{{"channel", json["channels"][0]["id"]},
                             {"controls", {1, 2, 3, 4, 5}},
                             {"sliding", 1},
                             {"sticking", 1},
                             {"sliding_stiffness", 1},
                             {"sticking_stiffness", 1}}};
  });
  expect_input_error([&] { read_run(folder_.string()); }, {"lip_friction[0].controls", "one number for each control"});
  write_edited([](auto& json) { json.erase("lip_friction"); });
  EXPECT_TRUE(read_run(folder_.string()).lip_friction.empty());
}

TEST_F(RunRecordTest, EnsemblesSurviveStandOnThePageAndAreBelievedOnlyWhereTheyFit) {
  RunRecord record = test::hanging_block();
  EnsembleRecord ensemble;
  ensemble.kind = "posterior";
  ensemble.how = "as it was done";
  ensemble.verdict = "The parabola's 95 % interval: E: too narrow by 1.6.";
  ensemble.asked = ensemble.finished = 30;
  ensemble.effective = 21.5;
  const double E = record.fit.parameters[0].value;
  ensemble.parameters = {{record.fit.parameters[0].spec.id, "Pa", E, 1e3, 0.9 * E, E, 1.2 * E, 0.8 * E, 1.3 * E, 1.6,
                          0.1, "too narrow by 1.6"}};
  ensemble.correlation = Eigen::MatrixXd::Identity(1, 1);
  ensemble.bands.assign(record.readings.size(), {1e-3, kNaN});
  for (int i = 0; i < 30; ++i) {
    ensemble.drawn.push_back({E * (1 + 0.01 * i)});
    ensemble.weights.push_back(i == 3 ? 1 : 0.5);
  }
  ensemble.minima = {{12.5, 7, {E}}};
  ensemble.failures = {"no parameters were found for it"};
  record.ensembles = {ensemble};
  const std::string whole = to_json(record);
  write_file(path("fit.json"), whole);
  const RunRecord again = read_run(folder_.string());
  EXPECT_EQ(to_json(again), whole);
  ASSERT_EQ(again.ensembles.size(), 1u);
  EXPECT_EQ(again.ensembles[0].parameters[0].upper95, 1.2 * E);
  EXPECT_EQ(again.ensembles[0].drawn, ensemble.drawn);
  EXPECT_TRUE(std::isnan(again.ensembles[0].bands[0][1]));
  const std::string html = ensembles(again)->html;
  for (const char* words : {"Beyond the parabola", "as much as 22 equal ones", "too narrow by 1.6", "1.60 ± 0.10",
                            "12.5", "no parameters were found"})
    EXPECT_NE(html.find(words), std::string::npos) << words << " in " << html;
  ASSERT_TRUE(plot::ensemble(again, again.ensembles[0]).has_value());
  EXPECT_EQ(plot::ensemble(again, again.ensembles[0])->figure.name, "ensemble_posterior");

  const auto refused = [&](auto&& edit, const std::vector<std::string>& parts) {
    auto json = nlohmann::ordered_json::parse(whole);
    edit(json["ensembles"][0]);
    write_file(path("fit.json"), json.dump());
    expect_input_error([&] { read_run(folder_.string()); }, parts);
  };
  refused([](auto& json) { json["parameters"].push_back(json["parameters"][0]); },
          {"ensembles[0].parameters", "2 entries"});
  refused([](auto& json) { json["drawn"][2].push_back(1); }, {"ensembles[0].drawn", "2 entries for 1 parameters"});
  refused([](auto& json) { json["weights"].erase(0); }, {"ensembles[0].weights", "29 entries for 30 members"});
  refused([](auto& json) { json["weights"][0] = -1; }, {"ensembles[0].weights", "from 0 to 1"});
  refused([](auto& json) { json["bands"] = {1, 2}; }, {"ensembles[0].bands", "readings"});
  refused([](auto& json) { json["minima"][0]["values"] = {1, 2}; }, {"ensembles[0].minima", "2 entries"});
}

TEST_F(RunRecordTest, SharesOfMeshAndContactGapSurviveAndOlderFilesHaveNone) {
  RunRecord record = test::hanging_block();
  record.shares = {{"mesh", {-412.5}, {190}, "from three meshes", 9.5},
                   {"contact gap", {kNaN}, {kNaN}, "failed", 1, false}};
  record.fit.parameters[0].total_lower95 = 262.5e3;
  write_file(path("fit.json"), to_json(record));
  const RunRecord again = read_run(folder_.string());
  ASSERT_EQ(again.shares.size(), 2u);
  EXPECT_EQ(again.shares[0].source, "mesh");
  EXPECT_EQ(again.shares[0].bias, std::vector{-412.5});
  EXPECT_EQ(again.shares[0].error, std::vector{190.0});
  EXPECT_EQ(again.shares[0].how, "from three meshes");
  EXPECT_EQ(again.shares[0].seconds, 9.5);
  EXPECT_TRUE(std::isnan(again.shares[1].bias[0]));
  EXPECT_TRUE(again.shares[0].counted);
  EXPECT_FALSE(again.shares[1].counted);
  EXPECT_EQ(again.fit.parameters[0].total_lower95, record.fit.parameters[0].total_lower95);
  EXPECT_FALSE(again.fit.parameters[0].total_upper95.has_value());
  write_edited([](auto& json) { json.erase("shares"); });
  EXPECT_TRUE(read_run(folder_.string()).shares.empty());
  write_edited([](auto& json) {
    json["shares"] = {{{"source", "mesh"}, {"bias", {1, 2}}, {"error", {1}}, {"how", ""}, {"seconds", 1}}};
  });
  expect_input_error([&] { read_run(folder_.string()); }, {"shares[0].bias", "one number for each parameter"});
}

TEST_F(RunRecordTest, AxesSurviveAndOlderFilesHaveUnitsOfControlsOnly) {
  RunRecord record = test::tendon_finger();
  record.channels[0] = make_axis("tip", Quantity::angle, "rotation");
  write_file(path("fit.json"), to_json(record));
  RunRecord again = read_run(folder_.string());
  ASSERT_EQ(again.controls.size(), 2u);
  EXPECT_EQ(again.controls[1].id, "retraction");
  EXPECT_EQ(again.controls[1].quantity, "length");
  ASSERT_EQ(again.channels.size(), 1u);
  EXPECT_EQ(again.channels[0].quantity, "angle");
  EXPECT_EQ(again.channels[0].unit, "rad");
  EXPECT_EQ(again.channels[0].label, "rotation");

  write_edited([](auto& json) {
    json.erase("channels");
    json["controls"] = {{{"id", "tip_load"}, {"unit", "N"}}};
  });
  again = read_run(folder_.string());
  EXPECT_EQ(again.controls[0].quantity, "force");
  ASSERT_EQ(again.channels.size(), 3u);
  EXPECT_EQ(again.channels[2].id, "tip_right");
  EXPECT_EQ(again.channels[2].quantity, "length");
  EXPECT_EQ(again.channels[2].label, "displacement");

  write_edited([](auto& json) { json["channels"].erase(1); });
  expect_input_error([&] { read_run(folder_.string()); }, {"'channels'", "the channel 'tip_left'"});
  write_edited([](auto& json) { json["load"]["control"] = 7; });
  expect_input_error([&] { read_run(folder_.string()); }, {"'load.control' holds 7", "index of a control"});
  write_edited([](auto& json) { json["controls"] = {{{"id", "tip_load"}, {"unit", "furlong"}}}; });
  expect_input_error([&] { read_run(folder_.string()); }, {"controls[0].unit", "an SI unit"});
}

TEST_F(RunRecordTest, DoublesKeepEveryBit) {
  RunRecord record = test::hanging_block();
  record.fit.chi_squared = 0.1 + 0.2;
  record.fit.p[0] = std::nextafter(274.1e3, 1e9);
  record.replay_seconds = 5e-324;
  record.references[0].value = std::numeric_limits<double>::max();
  write_file(path("fit.json"), to_json(record));
  const RunRecord again = read_run(folder_.string());
  EXPECT_EQ(again.fit.chi_squared, record.fit.chi_squared);
  EXPECT_EQ(again.fit.p[0], record.fit.p[0]);
  EXPECT_EQ(again.replay_seconds, record.replay_seconds);
  EXPECT_EQ(again.references[0].value, record.references[0].value);
}

TEST_F(RunRecordTest, OpenIntervalsInfiniteBoundsAndNaNAreNull) {
  RunRecord record = test::tendon_finger();
  ParameterEstimate& estimate = record.fit.parameters[0];
  estimate.lower95.reset();
  estimate.upper95.reset();
  estimate.lower = -kInfinity;
  estimate.upper = kInfinity;
  estimate.standard_error = kNaN;
  estimate.verdict = Verdict::tied;
  record.fit.correlation(0, 1) = kNaN;
  record.readings[0].predicted = kNaN;
  record.fit.status = FitStatus::interrupted;
  record.fit.covariance.resize(0, 0);
  const std::string text = to_json(record);
  const auto json = nlohmann::json::parse(text);
  EXPECT_TRUE(json["parameters"][0]["interval95"][0].is_null());
  EXPECT_TRUE(json["parameters"][0]["bounds"][1].is_null());
  EXPECT_TRUE(json["parameters"][0]["standard_error"].is_null());
  write_file(path("fit.json"), text);
  const RunRecord again = read_run(folder_.string());
  const ParameterEstimate& read = again.fit.parameters[0];
  EXPECT_FALSE(read.lower95.has_value());
  EXPECT_FALSE(read.upper95.has_value());
  EXPECT_EQ(read.lower, -kInfinity);
  EXPECT_EQ(read.upper, kInfinity);
  EXPECT_EQ(read.spec.upper, kInfinity);
  EXPECT_TRUE(std::isnan(read.standard_error));
  EXPECT_EQ(read.verdict, Verdict::tied);
  EXPECT_EQ(again.fit.status, FitStatus::interrupted);
  EXPECT_TRUE(std::isnan(again.fit.correlation(0, 1)));
  EXPECT_TRUE(std::isnan(again.readings[0].predicted));
  EXPECT_FALSE(again.fit.parameters[1].spec.logarithmic);
  EXPECT_TRUE(again.fit.parameters[0].spec.logarithmic);
}

TEST_F(RunRecordTest, TheSchemaStandsFirstAndKeysKeepTheirOrder) {
  const auto json = nlohmann::ordered_json::parse(to_json(test::hanging_block()));
  std::vector<std::string> keys;
  for (const auto& [key, value] : json.items()) keys.push_back(key);
  ASSERT_GT(keys.size(), 7u);
  EXPECT_EQ(std::vector<std::string>(keys.begin(), keys.begin() + 7),
            (std::vector<std::string>{"schema", "title", "data", "kind", "status", "message", "parameters"}));
  EXPECT_EQ(json["schema"], "taut-fit-1");
  EXPECT_EQ(json["data"], "measured");
  EXPECT_EQ(json["parameters"][0]["verdict"], "well determined");
  EXPECT_EQ(json["fit"]["covariance_scale"][0], "logarithm");
  EXPECT_EQ(json["fit"]["all_parameters"]["nu"], 0.499);
}

TEST_F(RunRecordTest, TextThatIsNotUtf8IsWrittenWithReplacements) {
  RunRecord record = test::hanging_block();
  record.title = "caf\xe9";
  write_file(path("fit.json"), to_json(record));
  EXPECT_EQ(read_run(folder_.string()).title, "caf\xef\xbf\xbd");
}

TEST_F(RunRecordTest, ValuesWithoutIdsAreAProgrammingError) {
  RunRecord record = test::hanging_block();
  record.parameter_ids.pop_back();
  EXPECT_THROW(to_json(record), std::logic_error);
}

TEST_F(RunRecordTest, WhatIsWrongWithAFolderIsSaidWithTheRemedy) {
  expect_input_error([&] { read_run(path("nowhere")); }, {path("nowhere"), "no such folder", "taut fit"});
  expect_input_error([&] { read_run(folder_.string()); }, {path("fit.json"), "is missing", "run 'taut fit'"});
  write_file(path("file"), "x");
  expect_input_error([&] { read_run(path("file")); }, {path("file"), "is not a folder"});
}

TEST_F(RunRecordTest, WhatIsWrongWithFitJsonIsSaidWithItsKey) {
  const auto read = [&] { read_run(folder_.string()); };
  write_file(path("fit.json"), "{\n\"schema\": \"taut-fit-1\",\n oops\n}");
  expect_input_error(read, {path("fit.json"), "is not JSON (line 3)", "run the fit again"});
  write_file(path("fit.json"), "[]");
  expect_input_error(read, {path("fit.json"), "holds no JSON object"});
  write_file(path("fit.json"), "{}");
  expect_input_error(read, {path("fit.json"), "'schema' is missing"});

  write_edited([](auto& json) { json["schema"] = "taut-fit-9"; });
  expect_input_error(read,
                     {path("fit.json"), "the schema is \"taut-fit-9\"", "reads \"taut-fit-1\"", "run the fit again"});
  write_edited([](auto& json) { json["fit"].erase("dof"); });
  expect_input_error(read, {path("fit.json"), "'fit.dof' is missing"});
  write_edited([](auto& json) { json["readings"][2].erase("sigma"); });
  expect_input_error(read, {"'readings[2].sigma' is missing"});
  write_edited([](auto& json) { json["readings"][2].erase("load_N"); });
  expect_input_error(read, {"'readings[2].load_N' is missing"});
  write_edited([](auto& json) { json["fit"]["dof"] = 1.5; });
  expect_input_error(read, {"'fit.dof' holds 1.5 where a whole number is needed"});
  write_edited([](auto& json) { json["title"] = 7; });
  expect_input_error(read, {"'title' holds 7 where text is needed"});
  write_edited([](auto& json) { json["parameters"][0]["value"] = "big"; });
  expect_input_error(read, {"'parameters[0].value' holds \"big\" where a number or null is needed"});
  write_edited([](auto& json) { json["parameters"][0]["verdict"] = "splendid"; });
  expect_input_error(read,
                     {"'parameters[0].verdict' holds \"splendid\"", "one of: well determined, weakly determined"});
  write_edited([](auto& json) { json["status"] = "done"; });
  expect_input_error(read, {"'status' holds \"done\"", "converged"});
  write_edited([](auto& json) { json["data"] = "guessed"; });
  expect_input_error(read, {"'data' holds \"guessed\"", "\"measured\" or \"simulated\""});
  write_edited([](auto& json) { json["curves"] = 3; });
  expect_input_error(read, {"'curves' holds 3 where a list is needed"});
  write_edited([](auto& json) { json["parameters"][0]["bounds"] = {1}; });
  expect_input_error(read, {"'parameters[0].bounds' holds [1] where a list of 2 is needed"});
  write_edited([](auto& json) { json["fit"]["lack_of_fit"]["available"] = 1; });
  expect_input_error(read, {"'fit.lack_of_fit.available' holds 1 where true or false is needed"});
  write_edited([](auto& json) { json["provenance"] = "here"; });
  expect_input_error(read, {"'provenance' holds \"here\" where an object is needed"});
  write_edited([](auto& json) { json["fit"]["covariance_scale"][0] = "square"; });
  expect_input_error(read, {"'fit.covariance_scale[0]' holds \"square\""});
}

TEST_F(RunRecordTest, ARecordThatContradictsItselfIsNotBelieved) {
  const auto read = [&] { read_run(folder_.string()); };
  const std::string whole = to_json(test::tendon_finger());
  const auto expect = [&](const std::string& text, const std::vector<std::string>& parts) {
    write_file(path("fit.json"), text);
    expect_input_error(read, parts);
  };
  const auto edited = [&](auto&& edit) {
    auto json = nlohmann::ordered_json::parse(whole);
    edit(json);
    return json.dump();
  };
  write_file(path("fit.json"), whole);
  EXPECT_NO_THROW(read());
  expect(edited([](auto& json) { json["fit"]["covariance"] = {{1}}; }), {"'fit.covariance'", "1 entries for 2"});
  expect(edited([](auto& json) {
           json["fit"]["covariance"] = {{1, 0.2}, {0.3, 1}};
         }),
         {"'fit.covariance'", "not symmetric"});
  expect(edited([](auto& json) {
           json["fit"]["covariance"] = {{-1, 0}, {0, 1}};
         }),
         {"'fit.covariance'", "a variance is negative"});
  expect(edited([](auto& json) {
           json["fit"]["covariance"] = {{1, 2}, {2, 1}};
         }),
         {"'fit.covariance'", "a combination of parameters has a negative variance"});
  expect(edited([](auto& json) {
           json["fit"]["covariance"] = {{nullptr, 0}, {0, 1}};
         }),
         {"'fit.covariance'", "no number"});
  expect(edited([](auto& json) { json["fit"]["correlation"][0][1] = 1.5; }), {"'fit.correlation'", "1.5 is beyond 1"});
  expect(edited([](auto& json) { json["parameters"][1]["value"] = 2.5; }),
         {"'parameters[1].value'", "2.5 is outside its bounds"});
  expect(edited([](auto& json) { json["parameters"][1]["value"] = nullptr; }), {"'parameters[1].value'", "no value"});
  expect(edited([](auto& json) {
           json["parameters"][1]["interval95"] = {0.3, 0.46};
         }),
         {"'parameters[1].interval95'", "the value is not in it"});
  expect(edited([](auto& json) { json["status"] = "interrupted"; }), {"'status'", "'interrupted' has no covariance"});
  expect(edited([](auto& json) { json["readings"][2]["sigma"] = 1e-300; }),
         {"'readings[2].sigma'", "1e-300 is no standard deviation"});
  expect(edited([](auto& json) { json["readings"][2]["sigma"] = nullptr; }), {"'readings[2].sigma'"});
  expect(edited([](auto& json) { json["readings"][2]["measured"] = nullptr; }), {"'readings[2].measured'"});
  expect(edited([](auto& json) { json["readings"][2]["controls"].push_back(1); }),
         {"'readings[2].controls'", "3 entries for 2 controls"});
  expect(edited([](auto& json) { json["curves"][0]["value"].erase(0); }), {"'curves[0].value'", "loads"});
  expect(edited([](auto& json) { json["fit"]["dof"] = 4294967296; }), {"'fit.dof'", "a whole number"});
  const std::string value = "\"chi_squared\": ";
  const size_t at = whole.find(value) + value.size();
  expect(whole.substr(0, at) + "1e999" + whole.substr(whole.find_first_of(",\n", at)), {"larger than any"});
  expect(whole.substr(0, at) + "NaN" + whole.substr(whole.find_first_of(",\n", at)), {"is not JSON"});
  expect(std::string(100000, '['), {"nested"});
}

TEST_F(RunRecordTest, FilesAreWrittenWholeWithTheirFolders) {
  write_file(path("a/b/c.txt"), "one");
  write_file(path("a/b/c.txt"), "two\n");
  EXPECT_EQ(read_file(path("a/b/c.txt")), "two\n");
  write_file(path("empty"), "");
  EXPECT_EQ(read_file(path("empty")), "");
  int files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(path("a/b"))) files += entry.is_regular_file();
  EXPECT_EQ(files, 1) << "a temporary file was left behind";
}

TEST_F(RunRecordTest, FilesThatCannotBeWrittenOrReadAreNamed) {
  write_file(path("file"), "x");
  expect_input_error([&] { write_file(path("file/below"), "y"); }, {path("file/below"), "cannot be written", "choose"});
  std::filesystem::create_directories(folder_ / "folder" / "inside");
  expect_input_error([&] { write_file(path("folder"), "y"); }, {path("folder"), "cannot be written"});
  int entries = 0;
  for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(folder_)) ++entries;
  EXPECT_EQ(entries, 2) << "a temporary file was left behind";
  expect_input_error([&] { read_file(path("nowhere")); }, {path("nowhere"), "cannot be read", "check the path"});
  expect_input_error([&] { read_file(path("folder")); }, {path("folder"), "is a folder"});
}

TEST_F(RunRecordTest, Sha256AgreesWithThePublishedValues) {
  // FIPS 180-2, appendix B.1 and B.3, and the empty message
  write_file(path("abc"), "abc");
  EXPECT_EQ(sha256_of(path("abc")), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
  EXPECT_EQ(sha256_of_text("abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
  write_file(path("million"), std::string(1000000, 'a'));
  EXPECT_EQ(sha256_of(path("million")), "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0");
  write_file(path("empty"), "");
  EXPECT_EQ(sha256_of(path("empty")), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
  expect_input_error([&] { sha256_of(path("nowhere")); }, {path("nowhere"), "cannot be read"});
}

}  // namespace
}  // namespace taut
