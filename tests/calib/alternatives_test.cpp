#include <gtest/gtest.h>

#include "calib/fit/branches.hpp"
#include "calib/runs/evaluation_log.hpp"
#include "calib/runs/open_bench.hpp"
#include "calib/runs/run_fit.hpp"
#include "tests/support/arch.hpp"
#include "tests/support/taylor.hpp"

// Rows with two equilibria: both are found, the readings decide, and what they leave open is named.
namespace taut {
namespace {

using namespace test;

void expect_tells(const std::string& text, const std::vector<std::string>& parts) {
  for (const std::string& part : parts) EXPECT_NE(text.find(part), std::string::npos) << part << " in: " << text;
}

const std::vector<double> kPushes = {8, 12, 16, 20, 24, 28};  // [mN]; the arch snaps through at 24.3
constexpr double kSnapped = 5e-3;                             // a drop beyond it is that of a snapped arch

class Alternatives : public testing::Test {
 protected:
  TemporaryFolder folder_;
  StaticReplay bench_ = arch_bench(folder_, kPushes);
  StaticProtocol& protocol_ = *bench_.protocol;
  const Params p_ = protocol_.nominal();

  const Alternative& of_row(const std::vector<Alternative>& all, int row) const {
    return *std::ranges::find(all, std::vector<int>{row}, &Alternative::rows);
  }
};

TEST_F(Alternatives, OfAnArchAreBothSidesOfItsSnap) {
  const Eigen::VectorXd y = protocol_.predict(p_, {}).values;
  const std::vector<Alternative> all = protocol_.alternatives(p_);
  ASSERT_EQ(all.size(), 6u) << "the loads grow to a jump, which all rows know of";
  for (const Alternative& one : all) {
    const int row = one.rows.front();
    EXPECT_NEAR(one.path[0], y[row], 1e-9);
    EXPECT_EQ(y[row] > kSnapped, row == 5);
    EXPECT_NEAR(one.jump, 24.28 / kPushes[static_cast<size_t>(row)], 0.02) << row;
    EXPECT_EQ(one.near_jump(), row == 4) << "1.2 % below the snap";
    EXPECT_EQ(one.other.size(), row >= 2 && row <= 4 ? 1 : 0) << row;
    if (one.other.size() > 0) {
      EXPECT_GT(one.other[0], kSnapped);
    }
  }
}

TEST_F(Alternatives, ChangeNothingThatPredictionsStartFrom) {
  protocol_.predict(p_, {protocol_.parameters().index("E_strip")});
  const std::string before = protocol_.state();
  protocol_.alternatives(p_);
  EXPECT_EQ(protocol_.state(), before);
}

TEST_F(Alternatives, AFollowedRowIsPredictedThereWithItsDerivatives) {
  const std::vector<int> free{protocol_.parameters().index("E_strip")};
  const double other = of_row(protocol_.alternatives(p_), 3).other[0];
  const Eigen::VectorXd y = protocol_.predict(p_, {}).values;
  protocol_.follow(p_, {3});
  for (const bool cold : {true, false}) {
    if (cold) protocol_.forget();
    const Prediction there = protocol_.predict(p_, free);
    EXPECT_NEAR(there.values[3], other, 1e-8);
    EXPECT_NEAR(there.values[2], y[2], 1e-8) << "others are as ever";
    const double slope = there.derivatives(3, 0);
    expect_taylor_order(
        [&](double h) {
          Params moved = p_;
          moved[free[0]] += h;
          return std::abs(protocol_.predict(moved, {}).values[3] - there.values[3] - h * slope);
        },
        2, 1e-11, 3e4, 4, "the other equilibrium");
    protocol_.predict(p_, free);
  }
  EXPECT_NEAR(of_row(protocol_.alternatives(p_), 3).other[0], y[3], 1e-8) << "now the path's is the other one";
  protocol_.follow({}, {});
  EXPECT_NEAR(protocol_.predict(p_, {}).values[3], y[3], 1e-8);
}

TEST_F(Alternatives, AFitFollowsTheRowThatItsReadingsAreIn) {
  // The specimen snapped through early: at 16 mN already.
  Eigen::VectorXd y = protocol_.predict(p_, {}).values;
  y[2] = of_row(protocol_.alternatives(p_), 2).other[0];
  for (Measurement& m : bench_.measurements) m.value = y[m.row];
  FreeParameter E{protocol_.parameters().index("E_strip"), 0.9e6, 1e5, 1e7};
  for (const double start : {0.9e6, 1.3e6}) {
    E.start = start;
    const FitResult result = fit(protocol_, bench_.measurements, {E});
    ASSERT_EQ(result.status, FitStatus::converged) << result.message;
    EXPECT_NEAR(result.parameters[0].value, 1e6, 1e3) << start;
    EXPECT_LT(result.chi_squared, 1e-2);
    EXPECT_EQ(result.followed, std::vector<int>{2});
    std::string remarks;
    for (const std::string& remark : result.remarks) remarks += remark + '\n';
    expect_tells(remarks, {"two equilibria", "agree with", "chi squared falls"});
    protocol_.follow({}, {});
  }
}

TEST_F(Alternatives, OfALogAreThoseThatWereLogged) {
  std::vector<Alternative> live, logged;
  for (std::vector<Alternative>* all : {&live, &logged}) {
    EvaluationLog log(folder_ / "log", "test");
    LoggedProtocol protocol(protocol_, log, "fit", nullptr);
    const int before = protocol_.factorisations();
    *all = protocol.alternatives(p_);
    EXPECT_EQ(protocol_.factorisations() > before, all == &live);
  }
  ASSERT_EQ(live.size(), logged.size());
  for (size_t k = 0; k < live.size(); ++k) {
    EXPECT_EQ(live[k].rows, logged[k].rows);
    EXPECT_EQ(live[k].path, logged[k].path);
    EXPECT_EQ(live[k].other, logged[k].other);
    EXPECT_EQ(live[k].jump, logged[k].jump);
  }
}

TEST(Branches, OnlyReadingsThatAgreeWithOneOfTwoDecide) {
  const Alternative two{.rows = {0, 3}, .path = Eigen::Vector2d(1, 2), .other = Eigen::Vector2d(5, 7)};
  const auto misfit_at = [&](double first, double second, double sigma) {
    return branch_misfit(two, {{0, first, sigma, 0}, {3, second, sigma, 1}, {1, 100, sigma, 2}});
  };
  EXPECT_EQ(misfit_at(1, 2.1, 0.1).decided(), Decided::path);
  EXPECT_EQ(misfit_at(5, 7.1, 0.1).decided(), Decided::other);
  EXPECT_EQ(misfit_at(3, 4.5, 0.1).decided(), Decided::undecided) << "far from both";
  EXPECT_EQ(misfit_at(3, 4.4, 5).decided(), Decided::undecided) << "near both";
  EXPECT_EQ(misfit_at(3, 4.4, 5).readings, 2);
}

/// A run of the arch with these readings [mN, mm].
class ArchRun : public testing::Test {
 protected:
  RunRecord run(const std::vector<std::pair<double, double>>& readings) {
    folder.write("arch.msh", arch_msh());
    folder.write("bench.csv", arch_csv(readings));
    const std::unique_ptr<Bench> bench = open_bench(folder.write("experiment.toml", arch_toml));
    EvaluationLog log(folder / ("log_" + std::to_string(logs++)), "test");
    return run_fit(*bench, start_record(*bench), log, {}, {});
  }
  TemporaryFolder folder;
  int logs = 0;
};

TEST_F(ArchRun, NamesTheRowThatNothingDecidesWithBothValuesAndWhatToDo) {
  // At 20 mN something between the two equilibria, 1.26 and 8.77 mm, was written down.
  const RunRecord record = run({{8, 0.352}, {12, 0.577}, {16, 0.861}, {20, 5}, {23.9, 2.12}, {28, 9.462}});
  const auto row = std::ranges::find(record.equilibria, std::vector<int>{5}, &EquilibriaRecord::lines);
  ASSERT_NE(row, record.equilibria.end());
  EXPECT_EQ(row->decided, "undecided");
  EXPECT_TRUE(row->has_to_be_said());
  expect_tells(row->text, {"line 5, push = 20 mN", " mm or ", "do not decide", "exclude = [5]", "loading from below"});
  EXPECT_EQ(record.readings[3].equilibria, "two; undecided");
  EXPECT_EQ(record.readings[0].equilibria, "");
}

TEST_F(ArchRun, MarksWhatIsNearAFoldAndWhatItsReadingsDecide) {
  const RunRecord record = run({{8, 0.352}, {12, 0.577}, {16, 8.144}, {20, 1.263}, {23.9, 2.12}, {28, 9.462}});
  ASSERT_EQ(record.fit.status, FitStatus::converged) << record.fit.message;
  EXPECT_NEAR(record.fit.parameters[0].value, 1e6, 1e4);
  std::vector<std::string> marks;
  for (const ReadingRecord& reading : record.readings) marks.push_back(reading.equilibria);
  EXPECT_EQ(marks, (std::vector<std::string>{"", "", "the other of two", "two", "near a fold", ""}));
  EXPECT_FALSE(record.equilibria[1].has_to_be_said());
  expect_tells(record.equilibria[0].text, {"line 4", " mm or 86", "the readings decide for the first"});
  expect_tells(record.equilibria[2].text, {"line 6", "near a fold: at 1.0"});
  EXPECT_TRUE(record.shares.empty());
  EXPECT_NEAR(record.readings[2].predicted, 8.144e-3, 5e-5);
}

}  // namespace
}  // namespace taut
