#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "calib/check/look.hpp"
#include "calib/models/beam_model.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/units.hpp"

// Readings against what a chain of beams says, where that describes the specimen: with the file's values, over a range
// of the soft material's modulus, since a start may be far off.
namespace taut {
namespace {

/// The rows at least retraction, the cheapest to predict and those that cables and lips say least of; no more than 8
/// of each channel.
std::vector<const Repeats*> slack_rows(const Look& look) {
  const auto retraction = [&](const Repeats& group) {
    double sum = 0;
    for (size_t k = 0; k < group.controls.size(); ++k) {
      if (look.experiment.cables.columns.count(look.bench.controls()[k].id) > 0) sum += std::abs(group.controls[k]);
    }
    return sum;
  };
  double least = INFINITY;
  for (const Repeats& group : look.repeats) least = std::min(least, retraction(group));
  std::vector<const Repeats*> rows;
  for (size_t c = 0; c < look.bench.channels().size(); ++c) {
    std::vector<const Repeats*> of_channel;
    for (const Repeats& group : look.repeats) {
      if (group.channel == static_cast<int>(c) && retraction(group) == least) of_channel.push_back(&group);
    }
    const size_t every = (of_channel.size() + 7) / 8;
    for (size_t i = 0; i < of_channel.size(); i += std::max<size_t>(every, 1)) rows.push_back(of_channel[i]);
  }
  return rows;
}

/// The file's trials with one reading of each of these.
Trials trials_of_rows(const Look& look, const std::vector<const Repeats*>& rows) {
  Trials trials = *look.bench.trials_at_rest();
  trials.readings.clear();
  for (const Repeats* row : rows) trials.readings.push_back(*row->readings.front());
  return trials;
}

/// Whether loads only press the body together along its axis, which then may buckle to a side that nobody knows.
bool only_pressed(const Look& look) {
  for (const LoadSettings& load : look.experiment.loads) {
    const Eigen::Vector2d direction = vector_of(load.direction).head<2>().normalized();
    if (direction.dot(look.spine->along) > -0.99) return false;
  }
  return !look.own_weight() && !look.experiment.loads.empty();
}

/// Whether a chain of beams may say something of the readings.
bool for_beams(const Look& look) {
  return look.spine && !look.experiment.has_specimens() && look.at_rest() && look.bench.trials_at_rest() != nullptr &&
         look.experiment.mesh.depth_cells == 0 && !only_pressed(look);
}

/// Logarithms of a curve between its neighbours: curves of steps in between.
std::vector<BeamCurve> refined_curves(const std::vector<BeamCurve>& coarse) {
  std::vector<BeamCurve> fine;
  constexpr int parts = 25;
  for (size_t i = 0; i + 1 < coarse.size(); ++i) {
    for (int part = 0; part < parts; ++part) {
      const double right = static_cast<double>(part) / parts;
      const auto between = [&](double a, double b) {
        return a * b > 0 ? a * std::pow(b / a, right) : (1 - right) * a + right * b;
      };
      BeamCurve& curve = fine.emplace_back();
      curve.factor = between(coarse[i].factor, coarse[i + 1].factor);
      for (size_t r = 0; r < coarse[i].values.size(); ++r) {
        curve.values.push_back(between(coarse[i].values[r], coarse[i + 1].values[r]));
        curve.errors.push_back(std::max(coarse[i].errors[r], coarse[i + 1].errors[r]));
      }
    }
  }
  return fine;
}

/// What beams say of these rows from the soft modulus over 100 to 10 000 times it, with the other parameters as in `p`.
void add_curves(const Look& look, const BeamBench& beams, const Params& p, size_t rows,
                std::vector<BeamCurve>& curves) {
  std::vector<BeamCurve> coarse;
  for (int quarter = -8; quarter <= 8; ++quarter) {
    const double factor = std::pow(10, 0.25 * quarter);
    Params at = p;
    at[look.table.index("E_" + look.spine->soft)] *= factor;
    const Prediction prediction = beams.protocol->predict(at, {});
    BeamCurve& curve = coarse.emplace_back(BeamCurve{factor, {}, {}});
    for (size_t r = 0; r < rows; ++r) {
      curve.values.push_back(prediction.values[beams.row_of_reading[r]]);
      curve.errors.push_back(beams.protocol->stated_error(beams.row_of_reading[r]));
    }
  }
  const BeamCurve last = coarse.back();
  for (int quarter = 1; quarter <= 8; ++quarter) {  // stiffer still, all is linear
    BeamCurve& curve = coarse.emplace_back(last);
    curve.factor *= std::pow(10, 0.25 * quarter);
    for (double& value : curve.values) value *= std::pow(10, -0.25 * quarter);
  }
  const std::vector<BeamCurve> fine = refined_curves(coarse);
  curves.insert(curves.end(), fine.begin(), fine.end());
}

/// Where else than at their starts free parameters may be that change what a slack module does.
std::vector<Params> other_places(const Look& look) {
  std::vector<Params> places{look.start};
  for (const char* id : {"slack", "k_base"}) {
    const FreeParameter* free = look.free_parameter(id);
    if (free == nullptr) continue;
    for (const double value : {free->lower, free->upper}) {
      Params p = look.start;
      p[free->index] = value;
      places.push_back(p);
    }
  }
  return places;
}

}  // namespace

const std::vector<BeamView>& Look::beam_views() const {
  if (views_) return *views_;
  std::vector<BeamView>& views = views_.emplace();
  if (!for_beams(*this)) return views;
  const std::vector<const Repeats*> rows = slack_rows(*this);
  std::vector<BeamCurve> curves;
  try {
    const BeamBench beams = make_beam_bench(experiment, trials_of_rows(*this, rows));
    for (const Params& p : other_places(*this)) add_curves(*this, beams, p, rows.size(), curves);
  } catch (const InputError&) {  // not a case for beams
    return views;
  }
  const auto stands_out = [&](const Repeats& row, double by_beams) {
    return std::abs(row.median()) > 5 * row.sigma() && !(std::abs(by_beams) < 1e-9 * size);
  };
  const size_t middle = static_cast<size_t>(
      std::ranges::min_element(curves, {}, [](const BeamCurve& c) { return std::abs(std::log(c.factor)); }) -
      curves.begin());
  for (size_t c = 0; c < bench.channels().size(); ++c) {
    const std::vector<double> values = values_of(static_cast<int>(c));
    if (values.empty() || std::ranges::minmax(values).min == std::ranges::minmax(values).max) continue;
    BeamView view{static_cast<int>(c), {}, {}};
    for (const BeamCurve& curve : curves) view.curves.push_back({curve.factor, {}, {}});
    for (size_t r = 0; r < rows.size(); ++r) {
      if (rows[r]->channel != view.channel || !stands_out(*rows[r], curves[middle].values[r])) continue;
      view.rows.push_back(rows[r]);
      for (size_t k = 0; k < curves.size(); ++k) {
        view.curves[k].values.push_back(curves[k].values[r]);
        view.curves[k].errors.push_back(curves[k].errors[r]);
      }
    }
    if (!view.rows.empty()) views.push_back(std::move(view));
  }
  return views;
}

namespace {

/// Largest factor by which readings and beams differ, as its logarithm; `scale`: of the readings.
double apart(const BeamView& view, const BeamCurve& curve, double scale) {
  double most = 0;
  for (size_t r = 0; r < view.rows.size(); ++r) {
    const double ratio = std::abs(scale * view.rows[r]->median() / curve.values[r]);
    most = std::max(most, std::isfinite(ratio) && ratio > 0 ? std::abs(std::log(ratio)) : INFINITY);
  }
  return most;
}

/// The modulus at which beams come nearest to the readings, over the start.
struct Nearest {
  double factor = 1, apart = INFINITY;
};

Nearest nearest(const BeamView& view, double scale, double least, double most) {
  Nearest best;
  for (const BeamCurve& curve : view.curves) {
    if (curve.factor < least || curve.factor > most) continue;
    if (const double off = apart(view, curve, scale); off < best.apart) best = {curve.factor, off};
  }
  return best;
}

/// Range of the soft modulus over its start: where it may be without being odd.
struct ModulusRange {
  bool free = false;
  double start = 0, least = 1, most = 1;
};

constexpr double likely = 20;  ///< a start that is farther off is no start

ModulusRange modulus_range(const Look& look) {
  const std::string id = "E_" + look.spine->soft;
  ModulusRange range{look.free_parameter(id) != nullptr, look.value(id), 1.0 / 3, 3};
  if (const FreeParameter* free = look.free_parameter(id))
    range = {true, free->start, std::max(free->lower / free->start, 1.0 / likely),
             std::min(free->upper / free->start, likely)};
  return range;
}

const double well = std::log(1.5);  ///< so far apart readings and beams agree

/// Whether most of the readings go the other way than beams do at the start.
bool is_reversed(const BeamView& view) {
  const auto at_start =
      std::ranges::min_element(view.curves, {}, [](const BeamCurve& c) { return std::abs(std::log(c.factor)); });
  size_t against = 0, known = 0;
  for (size_t r = 0; r < view.rows.size(); ++r) {
    if (!std::isfinite(at_start->values[r])) continue;
    ++known;
    against += view.rows[r]->median() * at_start->values[r] < 0;
  }
  return known > 0 && against == known;
}

Sentences reversed_for_beams(const Look& look) {
  Sentences found;
  for (const BeamView& view : look.beam_views()) {
    if (!is_reversed(view)) continue;
    const Repeats& row = *view.rows.back();
    found.push_back(fmt::format(
        "channel '{}': its readings go the other way than the loads push (line {}: {}; all of {} conditions): turn the "
        "channel's direction round, or the readings' sign",
        look.channel(view.channel), row.readings.front()->line, with_unit(row.median(), "m"), view.rows.size()));
  }
  return found;
}

/// The slips of readings or loads with which beams would agree at a likely modulus, the three likeliest: "10 times too
/// large (with E_foam = 95 kPa)"; "" when there are none.
std::string scales_that_fit(const Look& look, const BeamView& view, const ModulusRange& range) {
  std::vector<std::pair<double, std::string>> fitting;  // by the distance of the modulus from its start
  for (const auto& [factor, hint] :
       {std::pair{10.0, ""}, {100.0, ""}, {1000.0, ""}, {25.4, ", inches?"}, {9.81, ", a mass for a force?"}}) {
    for (const bool large : {true, false}) {
      const Nearest at = nearest(view, large ? 1 / factor : factor, range.least, range.most);
      if (at.apart < well)
        fitting.emplace_back(std::abs(std::log(at.factor)),
                             fmt::format("{} times too {} (with E_{} = {}{})", factor, large ? "large" : "small",
                                         look.spine->soft, with_unit(range.start * at.factor, "Pa", 2), hint));
    }
  }
  std::ranges::sort(fitting);
  std::string text;
  for (size_t i = 0; i < std::min<size_t>(fitting.size(), 3); ++i) text += (i == 0 ? "" : " or ") + fitting[i].second;
  return text;
}

Sentences scale_for_beams(const Look& look) {
  Sentences found;
  for (const BeamView& view : look.beam_views()) {
    if (is_reversed(view)) continue;
    const ModulusRange range = modulus_range(look);
    const Nearest any = nearest(view, 1, 0, INFINITY), within = nearest(view, 1, range.least, range.most);
    if (within.apart < std::log(2.5)) continue;
    const FreeParameter* free = look.free_parameter("E_" + look.spine->soft);
    const bool in_bounds =
        free == nullptr || (any.factor * free->start >= free->lower && any.factor * free->start <= free->upper);
    if (any.apart < well && !in_bounds) continue;  // said of the bounds
    const std::string slips = scales_that_fit(look, view, range);
    if (slips.empty() && any.apart >= well && within.apart < std::log(5)) continue;
    found.push_back(fmt::format(
        "channel '{}': its readings are up to {:.2g} times off what a chain of beams says at the best E_{} from {} to "
        "{} "
        "({} conditions){}{}",
        look.channel(view.channel), std::exp(std::min(within.apart, 20.0)), look.spine->soft,
        with_unit(range.least * range.start, "Pa", 2), with_unit(range.most * range.start, "Pa", 2), view.rows.size(),
        any.apart < well
            ? fmt::format("; they would need E_{} = {}", look.spine->soft, with_unit(any.factor * range.start, "Pa", 2))
            : "",
        slips.empty() ? "; are units of readings, loads and dimensions right?"
                      : "; readings are " + slips + ", or loads the other way round: a wrong unit?"));
  }
  return found;
}

Sentences bounds_for_beams(const Look& look) {
  Sentences found;
  for (const BeamView& view : look.beam_views()) {
    const std::string id = "E_" + look.spine->soft;
    const FreeParameter* free = look.free_parameter(id);
    const Nearest any = nearest(view, 1, 0, INFINITY);
    if (free == nullptr || is_reversed(view) || any.apart > well) continue;
    const double E = any.factor * free->start;
    if (E > free->lower / 1.5 && E < 1.5 * free->upper) continue;
    found.push_back(fmt::format(
        "[fit.free.{}]: by a chain of beams the readings of '{}' need about {}, and the bounds are {} to {}{}", id,
        look.channel(view.channel), with_unit(E, "Pa", 2), with_unit(free->lower, "Pa"), with_unit(free->upper, "Pa"),
        slip_text(E / free->start, 0.3)));
  }
  return found;
}

/// Channels that agree with beams each at a modulus of its own.
Sentences channels_apart(const Look& look) {
  std::vector<std::pair<const BeamView*, double>> seen;
  const std::vector<BeamView>& views = look.beam_views();
  for (const BeamView& view : views) {
    const Nearest any = nearest(view, 1, 0, INFINITY);
    if (any.apart < well && !is_reversed(view)) seen.emplace_back(&view, any.factor);
  }
  Sentences found;
  for (size_t i = 1; i < seen.size(); ++i) {
    const double ratio = seen[i].second / seen[0].second;
    if (std::abs(std::log(ratio)) < std::log(3)) continue;
    found.push_back(
        fmt::format("channels '{}' and '{}' contradict each other: by a chain of beams their readings need moduli "
                    "{:.2g} times apart"
                    "{}: is one of their units wrong?",
                    look.channel(seen[0].first->channel), look.channel(seen[i].first->channel),
                    std::max(ratio, 1 / ratio), slip_text(ratio, 0.2)));
  }
  return found;
}

/// Least squares of the readings about a curve, with a constant or without.
struct Misfit {
  double chi_squared = INFINITY, constant = 0, se = 0;
};

Misfit misfit(const BeamView& view, const BeamCurve& curve, bool with_constant) {
  double w = 0, wr = 0, wrr = 0;
  for (size_t r = 0; r < view.rows.size(); ++r) {
    const double error = std::isfinite(curve.errors[r]) ? std::max(curve.errors[r], 0.02) : 0.3;
    const double sigma = std::hypot(view.rows[r]->readings.front()->sigma, error * curve.values[r]);
    const double rest = view.rows[r]->median() - curve.values[r];
    if (!std::isfinite(rest)) return {};
    w += 1 / (sigma * sigma), wr += rest / (sigma * sigma), wrr += rest * rest / (sigma * sigma);
  }
  return with_constant ? Misfit{wrr - wr * wr / w, wr / w, 1 / std::sqrt(w)} : Misfit{wrr, 0, 0};
}

Sentences offset_for_beams(const Look& look) {
  Sentences found;
  if (!look.experiment.zero_offset_per.empty() || other_places(look).size() > 1) return found;
  for (const BeamView& view : look.beam_views()) {
    if (view.rows.size() < 4 || is_reversed(view)) continue;
    const ModulusRange range = modulus_range(look);
    double largest = 0;
    for (const Repeats* row : view.rows) largest = std::max(largest, std::abs(row->median()));
    Misfit without, with;
    for (const BeamCurve& curve : view.curves) {
      if (curve.factor < range.least || curve.factor > range.most) continue;
      if (const Misfit one = misfit(view, curve, false); one.chi_squared < without.chi_squared) without = one;
      if (const Misfit one = misfit(view, curve, true); one.chi_squared < with.chi_squared) with = one;
    }
    const double fall = without.chi_squared - with.chi_squared;
    const bool explained = with.chi_squared < 2.0 * static_cast<double>(view.rows.size());
    if (fall < 25 || !explained || std::abs(with.constant) > largest || std::abs(with.constant) < 5 * with.se) continue;
    found.push_back(fmt::format(
        "channel '{}': its readings run to {} at no load by a chain of beams, {:.2g} standard errors from zero: a zero "
        "error of that size in all of them explains {} conditions that the model does not (chi squared {:.3g}, with it "
        "{:.2g}); subtract it, or let the fit find it ([bench] zero_offset_per)",
        look.channel(view.channel), with_unit(with.constant, "m", 2), std::abs(with.constant) / with.se,
        view.rows.size(), without.chi_squared, with.chi_squared));
  }
  return found;
}

/// By how many sigmas, all readings together, a parameter moves what beams predict when it goes up by a factor of e; a
/// slack, by a tenth of the way between its bounds.
double seen_by_beams(const Look& look, BeamProtocol& beams, const std::vector<Measurement>& measurements, int index,
                     const Params& p) {
  const FreeParameter& free = *look.free_parameter(look.table[index].id);
  const double change = look.table[index].logarithmic ? p[index] : 0.1 * (free.upper - free.lower);
  const Prediction prediction = beams.predict(p, {index});
  double squares = 0;
  for (const Measurement& m : measurements) {
    const double slope = prediction.derivatives(m.row, 0);
    if (!std::isfinite(slope)) return INFINITY;
    squares += std::pow(slope * change / m.sigma, 2);
  }
  return std::sqrt(squares);
}

Sentences unseen_by_beams(const Look& look) {
  Sentences found;
  if (!for_beams(look)) return found;
  for (const char* id : {"k_cable", "slack", "k_base"}) {
    if (look.free_parameter(id) == nullptr) continue;
    try {
      const BeamBench beams = make_beam_bench(look.experiment, *look.bench.trials_at_rest());
      Params taut = look.start;  // as taut as cables may be
      if (const FreeParameter* slack = look.free_parameter("slack")) taut[slack->index] = slack->lower;
      double most = 0;
      for (const Params& p : {look.start, taut})
        most = std::max(most, seen_by_beams(look, *beams.protocol, beams.measurements, look.table.index(id), p));
      if (most < 0.3)
        found.push_back(fmt::format(
            "[fit.free.{}]: no row sees it: a change {} moves all readings together by {:.1g} of their noise; {}", id,
            look.table[look.table.index(id)].logarithmic ? "by a factor of 2.7" : "by a tenth of its range", most,
            std::string_view(id) == "k_base" ? "hold it" : "retract the cables in some rows, or hold it"));
    } catch (const InputError&) {  // not a case for beams
    }
  }
  return found;
}

}  // namespace

std::vector<Implausible> implausible_for_beams() {
  return {{"a channel reversed", reversed_for_beams},
          {"readings out of scale", scale_for_beams},
          {"bounds that exclude the readings", bounds_for_beams},
          {"channels that contradict each other", channels_apart},
          {"a zero error that explains the trend", offset_for_beams},
          {"a free parameter that no row sees", unseen_by_beams}};
}

}  // namespace taut
