#include "reports/stability_figures.hpp"

#include <gtest/gtest.h>

#include "tests/support/experiment_files.hpp"

namespace taut::test {
namespace {

using Runs = std::vector<std::optional<StabilityRun>>;

StabilityMap small_map() {
  StabilityMap map;
  map.id = "small";
  map.title = "Two by two";
  map.setting = "a test";
  map.x_label = "load [N]";
  map.y_label = "steps";
  map.x = {"1", "2"};
  map.y = {"4", "8"};
  map.methods = {"good", "bad"};
  map.shows_error = true;
  return map;
}

/// The first method is right in three of four runs, the second in `right` of its first `run` ones.
Runs runs_of(const StabilityMap& map, int right, int run) {
  Runs runs(map.cells());
  for (size_t k = 0; k < 4; ++k) runs[k] = StabilityRun{k < 3 ? Outcome::converged : Outcome::saddle, 11, 12, 0.25};
  for (int k = 0; k < run; ++k)
    runs[static_cast<size_t>(4 + k)] = StabilityRun{k < right ? Outcome::cut_back : Outcome::intersected, 77, 88};
  return runs;
}

TEST(StabilityFigure, TheSentenceNamesTheFirstMethodAndTheWorstOneOrWhereNoneIsWorseTheBest) {
  const StabilityMap map = small_map();
  EXPECT_EQ(sentence_of(map, runs_of(map, 1, 4)), "Two by two: 'good' is right in 3 of 4 runs, 'bad' in 1");
  EXPECT_EQ(sentence_of(map, runs_of(map, 4, 4)), "Two by two: 'good' is right in 3 of 4 runs, 'bad' in 4");
  EXPECT_EQ(sentence_of(map, runs_of(map, 3, 4)), "Two by two: every method is right in 3 of 4 runs");
  EXPECT_EQ(sentence_of(map, runs_of(map, 0, 0)), "Two by two: every method is right in 3 of 4 runs");
  EXPECT_EQ(sentence_of(map, Runs(map.cells())), "Two by two");
}

TEST(StabilityFigure, ShowsOutcomesIterationsErrorsAndWhatWasNotRunAndSaysThatDataAreSimulated) {
  const TemporaryFolder folder;
  std::filesystem::create_directory(folder / "figures");
  const StabilityMap map = small_map();
  const Figure figure = draw_stability(map, runs_of(map, 1, 2), "A bench", true, folder / "");
  EXPECT_EQ(figure.name, "stability_small");
  for (const char* words : {"Two by two", "A bench: a test", "SIMULATED DATA", "converged at once",
                            "converged, steps halved", "not a minimum: unstable", "passed through something",
                            "not run: no time left", "load [N]", "steps", "+25 %", ">77<", ">11<"})
    EXPECT_NE(figure.svg.find(words), std::string::npos) << words;
  EXPECT_EQ(figure.svg.find("inside out"), std::string::npos) << "the legend has what occurs";
  const std::string csv = text_of(folder / "figures/stability_small.csv");
  EXPECT_NE(csv.find("good,1,4,converged,11,12,0.25\n"), std::string::npos) << csv;
  EXPECT_NE(csv.find("bad,2,4,intersected,77,88,\n"), std::string::npos) << csv;
  EXPECT_EQ(std::count(csv.begin(), csv.end(), '\n'), 7) << "a header and six runs";
}

}  // namespace
}  // namespace taut::test
