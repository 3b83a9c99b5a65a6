#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <tuple>

#include "calib/benches/assumptions.hpp"
#include "calib/benches/model.hpp"
#include "calib/check/look.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/units.hpp"

// Numbers of the experiment's file against each other and against what is known of such specimens.
namespace taut {
namespace {

double length_of_spans(const Spine& spine) {
  double sum = 0;
  for (const Spine::Span& span : spine.spans) sum += span.length;
  return sum;
}

/// All gaps between lips of one side [m]; NaN: there are none.
double gaps_of(const Look& look) {
  if (!look.spine || !look.spine->lips) return not_a_number;
  return length_of_spans(*look.spine) - 2 * look.spine->lips->length * static_cast<double>(look.spine->spans.size());
}

/// ", 10 times too large?" when a slip of the unit would bring `ratio` near one.
std::string unit_slip(double ratio) {
  for (const double factor : {10.0, 25.4, 100.0, 1000.0}) {
    for (const bool inverse : {false, true}) {
      const double mended = inverse ? ratio * factor : ratio / factor;
      if (mended > 0.4 && mended < 1.2)
        return fmt::format("; it would fit if it were {} times {}: a wrong unit?", factor,
                           inverse ? "larger" : "smaller");
    }
  }
  return "; a wrong unit?";
}

Sentences retraction_beyond_gaps(const Look& look) {
  const double gaps = gaps_of(look);
  Sentences found;
  for (const Look::Motion& motion : look.motions(true)) {
    if (!(motion.most > 1.5 * gaps)) continue;
    const double foam = length_of_spans(*look.spine);
    found.push_back(
        fmt::format("line {}: '{}' is {}, {:.2g} times all gaps together ({}){}, where the lips meet{}", motion.line,
                    motion.id, with_unit(motion.most, "m"), motion.most / gaps, with_unit(gaps, "m"),
                    motion.most > foam ? fmt::format(" and more than all the foam ({})", with_unit(foam, "m")) : "",
                    unit_slip(motion.most / gaps)));
  }
  return found;
}

Sentences motion_beyond_specimen(const Look& look) {
  Sentences found;
  if (look.size == 0) return found;
  for (const bool retraction : {true, false}) {
    for (const Look::Motion& motion : look.motions(retraction)) {
      const double limit = retraction ? 0.5 * look.size : 3 * look.size;
      if (motion.most <= limit || (retraction && std::isfinite(gaps_of(look)))) continue;
      found.push_back(fmt::format(
          "line {}: '{}' goes to {}, {}: nothing can be moved so far; is its unit right (cm or inches for mm)?",
          motion.line, motion.id, with_unit(motion.most, "m"),
          retraction
              ? fmt::format("more than half of the specimen's {}", with_unit(look.size, "m"))
              : fmt::format("{:.2g} times the specimen's {}", motion.most / look.size, with_unit(look.size, "m"))));
    }
  }
  return found;
}

Sentences no_lip_reached(const Look& look) {
  const double gaps = gaps_of(look);
  Sentences found;
  std::string free;
  for (const std::string& id :
       {std::string("k_cable"), std::string("slack"), look.spine ? "E_" + look.spine->stiff : ""}) {
    if (look.free_parameter(id) != nullptr) free += (free.empty() ? "" : ", ") + id;
  }
  for (const Look::Motion& motion : look.motions(true)) {
    if (!(motion.most > 0 && motion.most < 0.25 * gaps) || free.empty()) continue;
    found.push_back(
        fmt::format("line {}: '{}' goes to {} at most, {:.2g} % of all gaps ({}), so that no lip is reached, "
                    "by which alone {} would show well{}",
                    motion.line, motion.id, with_unit(motion.most, "m"), 100 * motion.most / gaps, with_unit(gaps, "m"),
                    free, unit_slip(motion.most / gaps)));
  }
  return found;
}

Sentences slack_beyond_gaps(const Look& look) {
  const double slack = look.value("slack"), gaps = gaps_of(look);
  if (look.experiment.cables.cables.empty() || !(slack > gaps)) return {};
  return {fmt::format(
      "[cables] slack = {} is more than all gaps ({}): no retraction that they allow makes a cable taut; a wrong unit?",
      with_unit(slack, "m"), with_unit(gaps, "m"))};
}

Sentences soft_cables(const Look& look) {
  if (!look.spine || look.experiment.cables.cables.empty()) return {};
  const double k = look.value("k_cable");
  const double foam = look.value("E_" + look.spine->soft) * look.spine->spans.front().height *
                      look.experiment.geometry.thickness / length_of_spans(*look.spine);
  if (!(k < 0.1 * foam)) return {};
  return {fmt::format(
      "[cables] k = {} is {:.2g} times the stiffness of the foam along it ({}): retraction would stretch the cables "
      "and leave the foam as it is; N/mm for N/m?",
      with_unit(k, "N/m"), k / foam, with_unit(foam, "N/m", 2))};
}

Sentences densities(const Look& look) {
  Sentences found;
  for (const MaterialSettings& material : look.experiment.materials) {
    if (!material.density || (*material.density >= 5 && *material.density <= 25000)) continue;
    found.push_back(fmt::format(
        "[materials.{}] density = {:.4g} kg/m3, where the lightest foams have 5 and the heaviest metals 23 000: {}?",
        material.region, *material.density, *material.density < 5 ? "g/cm3, 1000 times as much" : "g/m3"));
  }
  return found;
}

Sentences strange_gravity(const Look& look) {
  const double g = look.experiment.gravity;
  if (!look.experiment.kind->specimen || std::abs(g - 9.8) < 0.15) return {};
  std::string meant;
  for (const auto& [value, unit] : {std::pair{980.7, "cm/s2"}, {9807.0, "mm/s2"}, {32.17, "ft/s2"}, {386.1, "in/s2"}}) {
    if (std::abs(g / value - 1) < 0.02) meant = fmt::format("; as a number it is the one in {}", unit);
  }
  return {
      fmt::format("[gravity] acceleration = {:.5g} m/s2 is not that of any place on Earth (9.78 to 9.83){}", g, meant)};
}

Sentences strange_moduli(const Look& look) {
  Sentences found;
  for (const MaterialSettings& material : look.experiment.materials) {
    const auto E = material.constants.find("E");
    if (E == material.constants.end()) continue;
    const bool foam = look.spine && !look.spine->stiff.empty() && material.region == look.spine->soft;
    const double most = foam ? 1e8 : 2e12;
    if (E->second >= 100 && E->second <= most) continue;
    found.push_back(fmt::format("[materials.{}] E = {}, where {} have 100 Pa to {}: {}?", material.region,
                                with_unit(E->second, "Pa"), foam ? "foams of modules" : "solids", with_unit(most, "Pa"),
                                E->second < 100 ? "kPa or MPa for Pa" : "Pa or kPa for MPa"));
  }
  return found;
}

Sentences exchanged_materials(const Look& look) {
  if (!look.spine || look.spine->stiff.empty()) return {};
  const std::string &soft = look.spine->soft, &stiff = look.spine->stiff;
  const double of_soft = look.value("E_" + soft), of_stiff = look.value("E_" + stiff);
  if (!(of_stiff < 3 * of_soft)) return {};
  return {fmt::format(
      "E of {} ({}) is not above that of {} ({}), which carries it: exchanged, or kPa for MPa? Webs and lips are "
      "hundreds of times as stiff",
      stiff, with_unit(of_stiff, "Pa"), soft, with_unit(of_soft, "Pa"))};
}

Sentences strange_thickness(const Look& look) {
  if (look.experiment.geometry.dimension != 2 || look.size == 0) return {};
  const double thickness = look.experiment.geometry.thickness;
  if (thickness < 10 * look.size && thickness > look.size / 2000) return {};
  return {fmt::format("[geometry] thickness = {} on a section of {}, {:.2g} times that{}", with_unit(thickness, "m"),
                      with_unit(look.size, "m"), thickness / look.size,
                      thickness == 1 ? ": the default; give the specimen's" : unit_slip(thickness / look.size))};
}

Sentences wide_tolerances(const Look& look) {
  Sentences found;
  if (!look.at_rest() || (look.experiment.tolerances.empty() && look.experiment.control_tolerances.empty()))
    return found;
  for (const Assumption& one :
       assumptions_of(look.experiment, look.table, look.start, dimensions_of(look.experiment))) {
    // Pure numbers and slacks may be next to nothing.
    if ((one.unit == "1" && !one.scale) || one.id == "slack" || one.value == 0) continue;
    if (look.table.contains(one.id) ? look.table[look.table.index(one.id)].may_be_zero : one.unit == "rad") continue;
    if (one.tolerance < std::abs(one.value)) continue;
    if (look.bench.sets(one.id) && !one.scale) continue;  // an error of its zero
    found.push_back(fmt::format("{} = {} with a tolerance of {}, {:.0f} % of it: is its unit right?", one.id,
                                with_unit(one.value, one.unit), with_unit(one.tolerance, one.unit),
                                100 * one.tolerance / std::abs(one.value)));
  }
  return found;
}

Sentences references_out_of_bounds(const Look& look) {
  Sentences found;
  for (const ReferenceValue& reference : look.experiment.references) {
    const FreeParameter* free = look.free_parameter(reference.parameter);
    if (free == nullptr) continue;
    const std::string& unit = look.table[free->index].unit;
    const double value = parse_quantity(reference.value.text, quantity_of_si_unit(unit), reference.value.where);
    if (value >= free->lower && value <= free->upper) continue;
    found.push_back(
        fmt::format("[[fit.reference]] {} = {} ({}) is outside the bounds of its fit, {} to {}{}: one of them is wrong",
                    reference.parameter, with_unit(value, unit), reference.source, with_unit(free->lower, unit),
                    with_unit(free->upper, unit), slip_text(value / free->start, 0.3)));
  }
  return found;
}

Sentences distant_markers(const Look& look) {
  Sentences found;
  for (const ChannelSettings& channel : look.experiment.channels) {
    if (channel.standoff.empty() || look.size == 0) continue;
    const double off = vector_of(channel.standoff).norm();
    if (off > look.size)
      found.push_back(
          fmt::format("[[channel]] '{}': its marker stands {} off the surface, {:.2g} times the specimen's size"
                      "; is the unit of standoff right?",
                      channel.id, with_unit(off, "m"), off / look.size));
  }
  return found;
}

/// The largest tension of a cable [N], with the line where it stands; of a constant one 0.
std::pair<double, int> largest_tension(const Look& look, const CableSettings& cable) {
  if (cable.control.empty()) return {cable.tension, 0};
  const size_t k = position_of_control(look.experiment, cable.control);
  const double factor = cable.spool > 0 ? 1 / cable.spool : 1;
  std::pair<double, int> largest;
  for (const BenchReading* reading : look.readings) {
    if (factor * reading->controls[k] > largest.first) largest = {factor * reading->controls[k], reading->line};
  }
  return largest;
}

/// Tensions that would press the softest region together by more than half at the thinnest section they reach.
Sentences crushing_tensions(const Look& look) {
  Sentences found;
  double softest = infinity;
  for (const MaterialSettings& material : look.experiment.materials)
    softest = std::min(softest, look.value("E_" + material.region));
  for (const CableSettings& cable : look.experiment.cables.cables) {
    if (!cable.held || !cable.line || look.experiment.geometry.dimension != 3) continue;
    const BodyAxis axis = *look.experiment.geometry.shape->axis();
    const double area = std::min(axis.section(cable.line->start).area, axis.section(cable.line->end).area);
    const auto [tension, line] = largest_tension(look, cable);
    const double strain = tension / (softest * area);
    if (!(strain > 1.5)) continue;
    found.push_back(fmt::format(
        "{}cable '{}' pulls with {}, {:.2g} times what presses its thinnest section together by all its length at E = "
        "{}: is its unit right (g for N, N for mN), or the spool's?",
        line > 0 ? fmt::format("line {}: ", line) : "", cable.id, with_unit(tension, "N"), strain,
        with_unit(softest, "Pa")));
  }
  return found;
}

Sentences strange_spools(const Look& look) {
  Sentences found;
  for (const CableSettings& cable : look.experiment.cables.cables) {
    if (cable.spool > 0 && (cable.spool > 1 || cable.spool < 5e-4))
      found.push_back(fmt::format("cable '{}': a spool of radius {} is none of a bench: is its unit right?", cable.id,
                                  with_unit(cable.spool, "m")));
  }
  return found;
}

/// Rows of eyelets that bend nothing, are given in another unit, or are there twice.
Sentences strange_eyelets(const Look& look) {
  Sentences found;
  const auto& cables = look.experiment.cables.cables;
  for (size_t c = 0; c < cables.size(); ++c) {
    if (!cables[c].line) continue;
    const EyeletLine& line = *cables[c].line;
    if (line.offset == 0 && line.end_offset == 0)
      found.push_back(fmt::format("cable '{}' runs on the axis of the body, which it cannot bend: give its 'offset'",
                                  cables[c].id));
    if (std::abs(line.angle) > 2 * M_PI)
      found.push_back(
          fmt::format("cable '{}': its angle is {:.4g} turns: deg for rad?", cables[c].id, line.angle / (2 * M_PI)));
    for (size_t d = 0; d < c; ++d) {
      if (!cables[d].line) continue;
      const EyeletLine& other = *cables[d].line;
      if (std::tie(line.start, line.end, line.offset, line.end_offset, line.angle) ==
          std::tie(other.start, other.end, other.offset, other.end_offset, other.angle))
        found.push_back(fmt::format("cables '{}' and '{}' have one row of eyelets: give one of them its own 'angle'",
                                    cables[d].id, cables[c].id));
    }
  }
  return found;
}

Sentences crushing_loads(const Look& look) {
  Sentences found;
  if (!look.at_rest() || look.size == 0) return found;
  double stiffest = 0;
  for (const MaterialSettings& material : look.experiment.materials) {
    const double E = look.value("E_" + material.region);
    if (E > stiffest) stiffest = E;
  }
  if (look.spine) stiffest = look.value("E_" + look.spine->soft);
  for (size_t k = 0; k < look.bench.controls().size(); ++k) {
    const std::string& quantity = look.bench.controls()[k].quantity;
    if (quantity != name_of(Quantity::mass) && quantity != name_of(Quantity::force)) continue;
    const BenchReading* most = nullptr;
    for (const BenchReading* reading : look.readings) {
      if (most == nullptr || std::abs(reading->controls[k]) > std::abs(most->controls[k])) most = reading;
    }
    const double force = std::abs(look.bench.as_force(k, most->controls[k]));
    const double strain = force / (stiffest * look.size * look.size);
    if (strain > 3)
      found.push_back(fmt::format(
          "line {}: '{}' is {}, with which a cube of the specimen's size and E = {} would be strained by {:.2g}: is "
          "its "
          "unit right (kg for g, N for mN)?",
          most->line, look.bench.controls()[k].id, with_unit(force, "N"), with_unit(stiffest, "Pa"), strain));
  }
  return found;
}

}  // namespace

std::vector<Implausible> implausible_settings() {
  return {{"a retraction beyond all gaps", retraction_beyond_gaps},
          {"a motion beyond the specimen", motion_beyond_specimen},
          {"a retraction that reaches no lip", no_lip_reached},
          {"a slack beyond all gaps", slack_beyond_gaps},
          {"cables softer than the foam", soft_cables},
          {"a density of no solid", densities},
          {"a gravity of no place", strange_gravity},
          {"a modulus of no solid", strange_moduli},
          {"materials exchanged", exchanged_materials},
          {"a thickness of no specimen", strange_thickness},
          {"a tolerance as large as its value", wide_tolerances},
          {"a reference outside the bounds", references_out_of_bounds},
          {"a marker far from the specimen", distant_markers},
          {"a tension beyond the body", crushing_tensions},
          {"a spool of no bench", strange_spools},
          {"eyelets that bend nothing or stand twice", strange_eyelets},
          {"loads beyond any strength", crushing_loads}};
}

}  // namespace taut
