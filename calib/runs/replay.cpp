#include "calib/runs/replay.hpp"

#include <fmt/format.h>

#include <numeric>

#include "calib/runs/run_fit.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/stopwatch.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

/// "47.3kPa" as "47.3 kPa": shells take blanks for ends of words.
std::string with_blank(const std::string& text) {
  if (text.find(' ') != std::string::npos) return text;
  for (size_t end = text.size(); end > 0; --end) {
    if (parse_number(std::string_view(text).substr(0, end)))
      return end == text.size() ? text : text.substr(0, end) + " " + text.substr(end);
  }
  return text;
}

/// The place of a parameter that may be set.
int index_to_set(const Bench& bench, const std::string& id, const std::string& where) {
  if (bench.sets(id)) {
    throw InputError(fmt::format(
        "{0}: '{1}' is set by the bench, row by row; change its column in a copy of the bench file", where, id));
  }
  return bench.protocol().parameters().index(id);
}

}  // namespace

void set_parameter(const Bench& bench, const std::string& id, const std::string& value, const std::string& where,
                   Params& p) {
  const int index = index_to_set(bench, id, where);
  const Quantity quantity = quantity_of_si_unit(bench.protocol().parameters()[index].unit);
  set_parameter(bench, id, parse_quantity(with_blank(value), quantity, where), where, p);
}

void set_parameter(const Bench& bench, const std::string& id, double value, const std::string& where, Params& p) {
  const int index = index_to_set(bench, id, where);
  bench.protocol().parameters().check(index, value);
  p[index] = value;
}

Replay replay_bench(const Bench& bench, const Params& p, bool sensitivities) {
  Replay replay;
  replay.record = start_record(bench);
  Protocol& protocol = bench.protocol();
  if (sensitivities) {
    replay.with_respect_to.resize(static_cast<size_t>(protocol.parameters().size()));
    std::iota(replay.with_respect_to.begin(), replay.with_respect_to.end(), 0);
  }
  protocol.forget();  // what the choice of the model left
  const Stopwatch watch;
  replay.prediction = protocol.predict(p, replay.with_respect_to);
  replay.record.replay_seconds = watch.seconds();
  if (sensitivities) {
    for (const BenchReading& reading : bench.readings()) {
      Eigen::VectorXd row = Eigen::VectorXd::Constant(replay.prediction.derivatives.cols(), not_a_number);
      if (reading.row >= 0) row = replay.prediction.derivatives.row(reading.row);
      replay.derivatives.emplace_back(row.begin(), row.end());
    }
    if (bench.one_model()) replay.stiffness = bench.tangent_stiffness();
  }
  fill_predictions(bench, replay.prediction.values, {}, replay.record);
  replay.record.swings = bench.swings(replay.prediction.values);
  return replay;
}

}  // namespace taut
