#include "reports/diagnostic.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "reports/report.hpp"
#include "tests/support/message.hpp"
#include "tests/support/run_records.hpp"

// What the report says of a parameter fitted to each part of the readings alone.
namespace taut {
namespace {

using test::contains;

/// The push-puppet module with these values from the four retractions; the whole fit's is 61.3 kPa.
RunRecord with_values(const std::vector<double>& values) {
  RunRecord record = test::push_puppet_module();
  for (size_t i = 0; i < values.size(); ++i) {
    record.diagnostics[i].value = values[i];
    record.diagnostics[i].standard_error = 1e3;
  }
  return record;
}

std::string said_of(const RunRecord& record) {
  const auto groups = diagnostic_groups(record);
  EXPECT_EQ(groups.size(), 1u);
  return groups.empty() ? "" : interpretation(record, groups.front());
}

TEST(Diagnostic, WithinTwoStandardErrorsOneLawServesAll) {
  const RunRecord record = with_values({62.9e3, 61.3e3, 60.0e3, 59.5e3});
  EXPECT_EQ(said_of(record), "All agree with the whole fit within 2 standard errors: one law serves every retraction.");
  const DiagnosticGroup group = diagnostic_groups(record).front();
  EXPECT_EQ(group.whole->spec.id, "E_foam");
  EXPECT_EQ(group.held, "retraction");
  EXPECT_NEAR(standard_errors_apart(group, *group.parts[0]), 1.6, 1e-9);
}

TEST(Diagnostic, AFallByMoreThanTwoStandardErrorsIsSofteningUnderCompression) {
  std::string said = said_of(with_values({65e3, 62e3, 57e3, 50e3}));
  EXPECT_TRUE(contains(said, "E_foam falls as retraction grows, from 65 kPa to 50 kPa, 10.6 standard errors"));
  EXPECT_TRUE(contains(said, "the foam softens under compression, which a neo-Hookean law does not do"));
  EXPECT_TRUE(contains(said, "try law = \"ogden_hill\" in [materials.foam]"));
  // A step up that is within one standard error of the difference does not hide it.
  EXPECT_TRUE(contains(said_of(with_values({65e3, 65.9e3, 57e3, 50e3})), "softens under compression"));
  RunRecord record = with_values({65e3, 62e3, 57e3, 50e3});
  record.setup.back().second = "ogden_hill, E = 50 kPa, nu = 0.2, alpha = 4";
  said = said_of(record);
  EXPECT_TRUE(contains(said, "more than its exponent allows; free alpha_foam"));
  EXPECT_FALSE(contains(said, "neo-Hookean"));
}

TEST(Diagnostic, ARiseOrNoOrderIsSaidToo) {
  EXPECT_TRUE(contains(said_of(with_values({57e3, 60e3, 62e3, 66e3})), "rises as retraction grows"));
  const std::string said = said_of(with_values({61e3, 68e3, 57e3, 61e3}));
  EXPECT_TRUE(contains(said, "without an order in retraction: retraction = 5.89 mm is 6.7 standard errors from"));
  EXPECT_FALSE(contains(said, "ogden_hill"));
}

TEST(Diagnostic, FailedPartsAreCountedAndSayNothing) {
  RunRecord record = with_values({61e3, 61e3, 61e3, std::nan("")});
  EXPECT_TRUE(contains(said_of(record), "one law serves every retraction. 1 of 4 fits failed and say nothing."));
  record = with_values({61e3, std::nan(""), std::nan(""), std::nan("")});
  EXPECT_TRUE(contains(said_of(record), "There are not two values to compare."));
}

TEST(Diagnostic, TheReportHasATableOfThePartsAndWhatItMeans) {
  const std::string html = report_html(with_values({65e3, 62e3, 57e3, 50e3}));
  for (const char* text : {"From each retraction alone", "<td>retraction = 5.89 mm</td>", "62.0 ± 1.0 kPa", ">-11.3<",
                           ">+3.7<", "all readings", "the foam softens under compression"}) {
    EXPECT_TRUE(contains(html, text)) << text;
  }
  RunRecord record = test::push_puppet_module();
  record.diagnostics.clear();
  EXPECT_FALSE(contains(report_html(record), "alone</h3>"));
  record.diagnostics = {{"E_other", "retraction = 0 mm", 1, 1, 1, 1}};  // not a fitted parameter: no unit to show it in
  EXPECT_TRUE(diagnostic_groups(record).empty());
}

TEST(Diagnostic, LackOfFitComesWithWhatToTry) {
  RunRecord record = test::push_puppet_module();
  record.fit.lack_of_fit.p_value = 0.049;
  std::string html = report_html(record);
  EXPECT_TRUE(contains(html, "What to try, one at a time: what the table of each retraction alone says"));
  EXPECT_TRUE(contains(html, "rotation_stiffness"));
  record.diagnostics.clear();
  EXPECT_TRUE(contains(report_html(record), "a [fit.diagnostic] table"));
  record.controls = {make_axis("strain", Quantity::pure, "engineering strain")};
  for (ReadingRecord& reading : record.readings) reading.controls.resize(1);
  EXPECT_TRUE(contains(remedy_for_lack_of_fit(record), "[[fit.variant]] with another law"));
  record.fit.lack_of_fit.p_value = 0.051;
  EXPECT_EQ(remedy_for_lack_of_fit(record), "");
  EXPECT_FALSE(contains(report_html(record), "What to try"));
}

}  // namespace
}  // namespace taut
