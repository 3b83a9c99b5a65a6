#include "calib/runs/equilibria.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "calib/fit/branches.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

bool near_jump(double jump) {
  return Alternative{.rows = {}, .path = {}, .other = {}, .jump = jump}.near_jump();
}

std::string decided_by(const Alternative& alternative, const BranchMisfit& misfit, bool followed) {
  if (alternative.other.size() == 0 || misfit.readings == 0) return "";
  const Decided decided = misfit.decided();
  if (decided == Decided::path) return followed ? "other" : "path";
  return "undecided";  // or the readings agree with one that they were not predicted in
}

/// "tip 13.1 mm or 17 mm".
std::string values_of(const Bench& bench, const Alternative& alternative) {
  std::string text;
  std::set<int> said;
  for (const BenchReading& reading : bench.readings()) {
    const auto row = std::ranges::find(alternative.rows, reading.row);
    if (row == alternative.rows.end() || !said.insert(reading.row).second) continue;
    const auto i = static_cast<Eigen::Index>(row - alternative.rows.begin());
    const AxisRecord& channel = bench.channels()[static_cast<size_t>(reading.channel)];
    text +=
        fmt::format("{}{} {} or {}", text.empty() ? "" : ", ", channel.id,
                    with_unit(alternative.path[i], channel.unit, 3), with_unit(alternative.other[i], channel.unit, 3));
  }
  return text;
}

std::string text_of(const Bench& bench, const Alternative& alternative, const EquilibriaRecord& record,
                    const std::string& controls) {
  const bool one = record.lines.size() == 1;
  std::string text = fmt::format("line{} {}, {}: ", one ? "" : "s", fmt::join(record.lines, ", "), controls);
  if (alternative.other.size() > 0) {
    text += fmt::format("two equilibria, {}", values_of(bench, alternative));
    if (record.decided == "undecided")
      text += fmt::format(
          ", and the readings do not decide for the first, in which they are predicted; leave {0} out ([bench] exclude "
          "= "
          "[{1}]), or read {0} again, loading from below",
          one ? "it" : "them", fmt::join(record.lines, ", "));
    else if (record.decided == "path")
      text += "; the readings decide for the first, that of loads that grow from rest";
    else if (record.decided == "other")
      text +=
          "; the readings decide for the first, in which they are predicted; loads that grow from rest lead to the "
          "second";
    else
      text += "; predicted is the first, that of loads that grow from rest";
  }
  if (alternative.near_jump())
    text += fmt::format(
        "{}near a fold: at {:.3g} times {} load the state jumps, so that small errors of model or bench "
        "decide what is read",
        alternative.other.size() > 0 ? "; " : "", alternative.jump, one ? "its" : "their");
  return text;
}

}  // namespace

bool EquilibriaRecord::has_to_be_said() const {
  return near_jump(jump) || decided != "path";
}

std::vector<EquilibriaRecord> equilibria_of(const Bench& bench, const std::vector<Alternative>& alternatives,
                                            const std::vector<Measurement>& measurements,
                                            const std::vector<int>& followed) {
  std::vector<EquilibriaRecord> records;
  for (const Alternative& alternative : alternatives) {
    if (alternative.other.size() == 0 && !alternative.near_jump()) continue;
    EquilibriaRecord record;
    std::set<int> lines;
    std::string controls;
    for (const BenchReading& reading : bench.readings()) {
      if (std::ranges::count(alternative.rows, reading.row) == 0) continue;
      lines.insert(reading.line);
      controls.clear();
      for (size_t k = 0; k < reading.controls.size(); ++k)
        controls += (k == 0 ? "" : ", ") + bench.describe_control(k, reading.controls[k]);
    }
    const bool is_followed =
        std::ranges::any_of(alternative.rows, [&](int row) { return std::ranges::count(followed, row) > 0; });
    record.lines.assign(lines.begin(), lines.end());
    record.jump = alternative.jump;
    record.decided = decided_by(alternative, branch_misfit(alternative, measurements), is_followed);
    record.text = text_of(bench, alternative, record, controls);
    records.push_back(std::move(record));
  }
  return records;
}

std::string mark_of(const EquilibriaRecord& record) {
  if (record.decided == "undecided") return "two; undecided";
  if (record.decided == "other") return "the other of two";
  return near_jump(record.jump) ? "near a fold" : "two";
}

}  // namespace taut
