// What is said of a bench at rest before anything is solved: what its supports hold, its description, and warnings.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <string_view>

#include "calib/benches/static_bench.hpp"
#include "sim/core/error.hpp"
#include "sim/core/units.hpp"
#include "sim/materials/prony.hpp"

namespace taut {
namespace {

std::string list_of(const std::vector<double>& values, std::string_view unit) {
  double size = 0;
  for (double value : values) size = std::max(size, std::abs(value));
  std::string text;
  for (double value : values) {
    const double shown = std::abs(value) < 1e-12 * size ? 0 : value;  // zero but for rounding
    text += fmt::format("{}{}", text.empty() ? "" : ", ", with_unit(shown, unit));
  }
  return text;
}

std::string geometry_text(const GeometrySettings& geometry) {
  std::string text = geometry.kind();
  if (const std::vector<double> extent = geometry.shape->extent(); !extent.empty())
    text += " of " + list_of(extent, "m");
  if (geometry.dimension == 2)
    text += fmt::format(", plane {}, {} thick", geometry.plane == Plane::strain ? "strain" : "stress",
                        with_unit(geometry.thickness, "m"));
  std::vector<std::string> planes;
  for (const SymmetryPlane& plane : geometry.shape->symmetry()) planes.push_back(plane.tag);
  if (!planes.empty()) text += fmt::format(", the part of it that ends at {}", join(planes, " and "));
  return text;
}

std::string support_text(const SupportSettings& support) {
  std::string text;
  for (int component : support.fix) text += fmt::format("{}{}", text.empty() ? "fixed in " : ", ", "xyz"[component]);
  if (support.rotation_stiffness)
    text += fmt::format("elastic, rotation stiffness {}", with_unit(*support.rotation_stiffness, "Nm/rad"));
  if (!support.control.empty())
    text +=
        fmt::format("{}moved in {} by column '{}'", text.empty() ? "" : "; ", "xyz"[support.component], support.column);
  return text;
}

std::string channel_text(const ChannelSettings& channel) {
  const std::string what(channel.kind->name);
  const bool place = channel.kind->on == ChannelKind::On::place;
  if (channel.foot) {
    const std::string text = fmt::format("{} of marker {} at {}", what, channel.marker, with_unit(*channel.foot, "m"));
    return channel.standoff.empty() ? text : text + fmt::format(", {} off the axis", list_of(channel.standoff, "m"));
  }
  std::string text = channel.on.empty() ? what + " of point (" + list_of(channel.point, "m") + ")"
                                        : (place ? "mean " : "") + what + " of " + channel.on;
  if (!channel.standoff.empty())
    text += fmt::format(", marker {} off it, turning with {}", list_of(channel.standoff, "m"), channel.turns_with);
  return text;
}

/// How the body stands; "": as its geometry has it.
std::string base_text(const Experiment& experiment) {
  std::string text;
  if (!experiment.base_turn.empty()) {
    for (double angle : experiment.base_turn)
      text += fmt::format("{}{:.4g} deg", text.empty() ? "turned by " : ", ", angle * 180 / M_PI);
    if (experiment.base_turn.size() == 3) text += " about x, y, z";
  }
  if (!experiment.base_at.empty())
    text += fmt::format("{}its origin at {}", text.empty() ? "" : "; ", list_of(experiment.base_at, "m"));
  return text;
}

/// "from 0 m to 305 mm along the axis, 11.4 mm off it, 2.4 mm at its end, at 60 deg".
std::string line_text(const EyeletLine& line) {
  std::string text = fmt::format("from {} to {} along the axis, {} off it", with_unit(line.start, "m"),
                                 with_unit(line.end, "m"), with_unit(line.offset, "m"));
  if (line.end_offset != line.offset) text += fmt::format(", {} at its end", with_unit(line.end_offset, "m"));
  return text + fmt::format(", at {:.4g} deg", line.angle * 180 / M_PI);
}

/// `model` in words.
std::string rung_text(const Experiment& experiment) {
  const std::string name = fmt::format("\"{}\"", name_of(experiment.model));
  switch (experiment.model) {
    case Rung::beam:
      return name + ": a chain of Timoshenko beams";
    case Rung::rod:
      return name + ": a Cosserat rod with " +
             (experiment.rod_section == SectionLaw::linear ? "linear" : "neo-Hookean") + " sections";
    case Rung::rigid_segments:
      return name + ": finite elements, in which " + join(rigid_regions(experiment), " and ") + " cannot deform";
    case Rung::full:
      return name + ": finite elements, in which all deforms";
    case Rung::solid:
      return name + fmt::format(": the section as a solid, {} layers of elements across half of its thickness",
                                experiment.mesh.depth_cells);
    case Rung::automatic:
      return name + fmt::format(": row by row the cheapest that is within {:.2g} %, chosen when the fit begins",
                                100 * experiment.tolerance);
  }
  return name;
}

}  // namespace

/// The supports that hold what `gradient` weighs, as "on 'xmin'"; empty where it moves freely, or is moved.
std::vector<std::string> StaticBench::held_by(const Eigen::VectorXd& gradient) const {
  const Model& whole = *model().scene().model;
  const double all = gradient.norm();
  if (all == 0 || whole.restrict_to_free(gradient).norm() > 1e-9 * all) return {};
  for (const int control : replay().protocol->controls()) {
    if (whole.support_derivative(control).cwiseProduct(gradient).cwiseAbs().maxCoeff() > 1e-9 * all) return {};
  }
  std::vector<std::string> found;
  for (const SupportSettings& support : experiment_.supports) {
    const std::vector<int> nodes = whole.mesh().select(support.on).nodes();
    const bool holds = std::ranges::any_of(nodes, [&](int node) {
      return std::ranges::any_of(support.fix,
                                 [&](int c) { return gradient[node * whole.mesh().dimension() + c] != 0; });
    });
    if (holds) found.push_back(fmt::format("on '{}'", support.on));
  }
  return found;
}

/// Channels that read 0 whatever happens: no parameter follows from them.
void StaticBench::refuse_held_channels() const {
  const StaticProtocol& protocol = model();
  const Point rest{Eigen::VectorXd::Zero(protocol.scene().model->mesh().X.size()), protocol.nominal()};
  for (size_t k = 0; k < experiment_.channels.size(); ++k) {
    const ChannelSettings& settings = experiment_.channels[k];
    if (settings.kind->on != ChannelKind::On::place) continue;
    const std::vector<std::string> supports = held_by(protocol.channels()[k].channel->gradient(rest));
    if (supports.empty()) continue;
    throw FileError(experiment_.path,
                    fmt::format("[[channel]] '{}': the {} never changes, since the support {} fixes it there; measure "
                                "where the specimen moves, or take that component out of the support's 'fix'",
                                settings.id, channel_text(settings), join(supports, " and ")));
  }
}

/// Loads that go into supports whole.
std::vector<std::string> StaticBench::held_loads() const {
  const StaticProtocol& protocol = model();
  const Model& whole = *protocol.scene().model;
  Point rest{Eigen::VectorXd::Zero(whole.mesh().X.size()), protocol.nominal()};
  std::vector<std::string> found;
  for (const LoadSettings& load : experiment_.loads) {
    const std::vector<std::string> supports =
        held_by(whole.parameter_gradient(rest, protocol.parameters().index(load.id)));
    if (!supports.empty())
      found.push_back(
          fmt::format("[[load]] '{}' strains nothing: the support {} fixes all that it pulls at along its direction; "
                      "is it on the right face?",
                      load.id, join(supports, " and ")));
  }
  return found;
}

Lines StaticBench::load_lines() const {
  Lines lines;
  if (!experiment_.gravity_direction.empty())
    lines.emplace_back("self-weight", fmt::format("g = {}", with_unit(experiment_.gravity, "m/s2", 6)));
  for (const LoadSettings& load : experiment_.loads) {
    const std::string place = load.on.empty() ? "point (" + list_of(load.point, "m") + ")" : load.on;
    lines.emplace_back("load " + load.id,
                       fmt::format("{} on {}, {}", name_of(load.quantity), place,
                                   load.column.empty() ? "constant " + fmt::format("{:.6g} (SI)", load.value)
                                                       : "column '" + load.column + "'"));
  }
  return lines;
}

std::string StaticBench::cables_text() const {
  const ParameterTable& table = model().parameters();
  const Params& nominal = model().nominal();
  std::string text;
  for (const CableSettings& cable : experiment_.cables.cables) text += (text.empty() ? "" : ", ") + cable.id;
  const auto law = [&](const std::string& k, const std::string& slack) {
    return fmt::format("k = {}, slack = {}", with_unit(nominal[table.index(k)], "N/m"),
                       with_unit(nominal[table.index(slack)], "m"));
  };
  if (table.contains("k_cable")) text += "; " + law("k_cable", "slack");
  for (const CableSettings& cable : experiment_.cables.cables) {
    if (cable.own) text += fmt::format("; {}: {}", cable.id, law("k_" + cable.id, "slack_" + cable.id));
    if (cable.held && cable.control.empty())
      text += fmt::format("; {} held at {}", cable.id, with_unit(cable.tension, "N"));
    if (cable.held && !cable.control.empty())
      text += fmt::format("; {} pulled by column '{}'", cable.id, experiment_.cables.tension_columns.at(cable.control));
    if (cable.spool > 0) text += fmt::format(" on a spool of radius {}", with_unit(cable.spool, "m"));
    if (cable.line) text += ", " + line_text(*cable.line);
  }
  if (experiment_.cables.rub)
    text += fmt::format("; friction {:.4g} at their eyelets", nominal[table.index("cable_friction")]);
  for (const auto& [id, column] : experiment_.cables.columns)
    text += fmt::format("; retracted by column '{}', before the loads", column);
  return text;
}

std::string StaticBench::contact_text() const {
  const ParameterTable& table = model().parameters();
  const Params& nominal = model().nominal();
  std::string text = fmt::format("sets in at {}", with_unit(nominal[table.index("contact_gap")], "m"));
  for (const std::string& region : model().scene().model->mesh().region_names) {
    text += fmt::format(", {} {}", region,
                        with_unit(nominal[table.index("contact_pressure_" + region)],
                                  experiment_.contact.form == ContactForm::length_weighted ? "Pa" : "N/m"));
  }
  if (experiment_.geometry.shape->defaults().contact)
    text += experiment_.contact.compensate ? "; lips shortened by the distance at which they rest"
                                           : "; stand-off not compensated";
  if (experiment_.contact.bracketed) text += "; friction bracketed after the fit";
  return text;
}

std::string StaticBench::studs_text() const {
  const StudsSettings& all = experiment_.studs;
  std::string text;
  for (const StudSettings& stud : all.studs) {
    text += fmt::format("{}{}: play of {} to either side, then {}", text.empty() ? "" : "; ", stud.id,
                        with_unit(stud.clearance ? *stud.clearance : *all.clearance, "m"),
                        with_unit(stud.stiffness ? *stud.stiffness : *all.stiffness, "N/m"));
  }
  return text;
}

std::string StaticBench::times_text() const {
  const BenchFormat::History& history = experiment_.bench.history;
  if (history.counts) {
    double longest_dwell = 0, longest_rest = 0;
    for (const BenchReading& reading : readings_) {
      longest_dwell = std::max(longest_dwell, reading.turn.dwell);
      longest_rest = std::max(longest_rest, reading.turn.rest);
    }
    return fmt::format("rows are replayed one after the other; dwells up to {}, median {}; rests up to {}",
                       with_unit(longest_dwell, "s"), with_unit(trials_.typical_dwell, "s"),
                       with_unit(longest_rest, "s"));
  }
  if (!history.time_column.empty() || !history.dwell_column.empty() || history.dwell)
    return "noted, and without effect, since nothing relaxes here ([materials.REGION] prony)";
  constexpr double g = 0.2, first = 10, second = 60;
  return fmt::format(
      "not noted; should a share of {} of the stiffness relax, dwells of {:.0f} and {:.0f} s may differ by {:.0f} %: "
      "note the time ([bench] dwell)",
      g, first, second, 100 * largest_creep_between(g, first, second));
}

Lines StaticBench::describe() const {
  const Experiment& e = experiment_;
  const Mesh& mesh = model().scene().model->mesh();
  Lines lines{{"data", e.simulated ? "simulated" : "measured"}, {"geometry", geometry_text(e.geometry)}};
  if (choice_.text.empty())
    lines.emplace_back("mesh", fmt::format("{}: {} nodes, {} elements, {} unknowns", e.mesh.describe(),
                                           mesh.node_count(), mesh.element_count(), unknowns()));
  lines.emplace_back("model",
                     rung_text(e) + (choice_.unknowns > 0 ? fmt::format(", {} unknowns", choice_.unknowns) : ""));
  if (!e.geometry.left_out.empty())
    lines.emplace_back("not in the file", "dimensions as the kind has them: " + join(e.geometry.left_out));
  add_material_lines(e, lines);
  for (const SupportSettings& support : e.supports) lines.emplace_back("support " + support.on, support_text(support));
  for (auto& line : load_lines()) lines.push_back(std::move(line));
  if (!e.cables.cables.empty()) lines.emplace_back("cables", cables_text());
  if (!e.studs.studs.empty()) lines.emplace_back("studs", studs_text());
  if (const std::string base = base_text(e); !base.empty()) lines.emplace_back("base", base);
  if (e.contact.on) lines.emplace_back("contact", contact_text());
  for (const ChannelSettings& channel : e.channels) lines.emplace_back("channel " + channel.id, channel_text(channel));
  lines.emplace_back("measured from", e.from_unloaded ? "the unloaded equilibrium" : "the rest shape");
  lines.emplace_back("times", times_text());
  for (const std::string& remark : trials_.remarks) lines.emplace_back("bench", remark);
  if (!trials_.layout.empty()) lines.emplace_back("bench file", trials_.layout);
  return lines;
}

std::vector<std::string> StaticBench::warnings_before() const {
  std::vector<std::string> warnings = model().scene().model->mesh().remarks;
  for (std::string& load : held_loads()) warnings.push_back(std::move(load));
  const Experiment& e = experiment_;
  const bool may_lock =
      e.mesh.formulation == Formulation::standard && !(e.geometry.dimension == 2 && e.geometry.plane == Plane::stress);
  for (const MaterialSettings& material : e.materials) {
    const auto nu = material.constants.find("nu");
    if (nu == material.constants.end() || !(nu->second > 0.45) || !may_lock) continue;
    warnings.push_back(
        fmt::format("{}: nu = {} with {} elements locks: the model is too stiff and a fitted modulus too small; set "
                    "formulation = \"locking_free\" with quadratic elements",
                    material.region, nu->second, e.mesh.order == 1 ? "linear" : "plain quadratic"));
  }
  const std::vector<std::string>& left_out = e.geometry.left_out;
  if (!e.cables.cables.empty() && std::ranges::find(left_out, "via_inset") != left_out.end())
    warnings.emplace_back(
        "[geometry] via_inset is not given, and sets how stiff the closed module is (from 0.25 to 3 mm by a factor of "
        "ten): measure how far inside the lips' ends the cables are guided, and write it down");
  if (e.mesh.order == 1)
    warnings.emplace_back(
        "linear elements bend too stiffly: a fitted modulus is too small by some per cent; compare with element = "
        "\"quadratic\"");
  return warnings;
}

}  // namespace taut
