#include "reports/simulator_files.hpp"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "reports/axes.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

using ChainJson = nlohmann::ordered_json;

/// Text for XML: in attributes, and in comments, which must not hold "--".
std::string xml_text(const std::string& text) {
  std::string safe;
  for (const char c : text) {
    if (c == '&')
      safe += "&amp;";
    else if (c == '<')
      safe += "&lt;";
    else if (c == '>')
      safe += "&gt;";
    else if (c == '"')
      safe += "&quot;";
    else if (c == '-' && safe.ends_with('-'))
      safe += " -";
    else
      safe += c;
  }
  return safe;
}

/// What is zero but for rounding is 0.
double tidy(double value) {
  return std::abs(value) < 1e-12 ? 0 : value;
}
std::string triple(const Eigen::Vector3d& v) {
  return fmt::format("{:.9g} {:.9g} {:.9g}", tidy(v.x()), tidy(v.y()), tidy(v.z()));
}

const AxisRecord& load_axis(const ChainText& text) {
  return text.controls[text.load];
}

/// Lines that both formats begin with, as the inside of a comment.
std::string about(const ModuleChain& chain, const ChainText& text) {
  std::string lines;
  const auto say = [&](const std::string& line) { lines += "  " + xml_text(line) + "\n"; };
  say("Written by taut from a calibrated run: " + text.title);
  if (text.simulated) say("SIMULATED DATA: the readings that it was fitted to were simulated, not measured.");
  say(fmt::format("State: {}. The rest shape is that of the body there, without loads and weight; SI units.",
                  chain.held));
  say(fmt::format(
      "{} hinges of one stiffness, {:.6g} N m/rad, fitted on this very chain: its displacement of '{}' under "
      "'{}' follows taut's replay {}.",
      chain.chain.size(), chain.fit.stiffness, text.channel, load_axis(text).id, chain_difference(chain)));
  say("Foam, cables and contact of this state are in that stiffness: it holds for loads across the axis in the plane "
      "of "
      "the hinges, from none to the largest one above, and in this state only.");
  say(fmt::format(
      "Assumed, not measured: damping {:.4g} N m s/rad, which is {:.0f} % of critical for the lowest mode "
      "({:.4g} Hz){}.",
      chain.damping, 100 * assumed_damping, chain.lowest / (2 * M_PI),
      chain.assumed.empty() ? ""
                            : fmt::format("; a density of {} kg/m3 for {}", assumed_density, join(chain.assumed))));
  say(chain.weight.norm() > 0 ? "Its own weight acts, as in the run."
                              : "Its own weight does not act: the run's model has none.");
  if (chain.slipped) say("The replay jumped to another equilibrium on its way: this state has several.");
  return lines;
}

/// Where a point is in the frame of its segment's body, whose origin is its hinge.
Eigen::Vector3d in_body(const ModuleChain& chain, int segment, const Eigen::Vector2d& at) {
  if (segment == 0) return chain.frame.point(at);
  return chain.frame.vector(at - chain.chain.hinges[static_cast<size_t>(segment) - 1]);
}

/// Where a segment's body is in that of the one before it.
Eigen::Vector3d origin_of(const ModuleChain& chain, int segment) {
  return in_body(chain, segment - 1, chain.chain.hinges[static_cast<size_t>(segment) - 1]);
}

/// The segment's own axes in space, as columns: along, across, normal.
Eigen::Matrix3d axes_of(const ModuleChain& chain, const ChainSegment& segment) {
  const Eigen::Vector2d along(std::cos(segment.angle), std::sin(segment.angle));
  Eigen::Matrix3d axes;
  axes << chain.frame.vector(along), chain.frame.vector({-along.y(), along.x()}), chain.frame.normal();
  return axes;
}

/// A time step that the stiffest mode bears, of two digits [s].
double time_step(const ModuleChain& chain) {
  return std::stod(fmt::format("{:.1e}", std::min(1e-3, 0.3 / chain.highest)));
}

class MjcfWriter {
 public:
  MjcfWriter(const ModuleChain& chain, const ChainText& text) : chain_(chain), text_(text) {}

  std::string written() {
    out_ = fmt::format("<mujoco model=\"{}\">\n  <!--\n{}  -->\n", xml_text(text_.name), about(chain_, text_));
    out_ += "  <compiler angle=\"radian\" autolimits=\"true\"/>\n";
    out_ += fmt::format("  <option gravity=\"{}\" integrator=\"implicitfast\" timestep=\"{:g}\"/>\n",
                        triple(chain_.frame.vector(chain_.weight)), time_step(chain_));
    out_ += "  <default>\n    <geom contype=\"0\" conaffinity=\"0\" group=\"1\"/>\n  </default>\n";
    out_ += "  <worldbody>\n    <site name=\"world\"/>\n";
    for (int i = 0; i < static_cast<int>(chain_.segments.size()); ++i) begin_segment(i);
    for (int i = static_cast<int>(chain_.segments.size()); i-- > 0;) line(i, "</body>");
    out_ += "  </worldbody>\n";
    tendons();
    const std::string load = xml_text(load_axis(text_).id), channel = xml_text(text_.channel);
    out_ += fmt::format(
        "  <actuator>\n    <!-- its control is the force [N] along the load's direction -->\n"
        "    <general name=\"{}\" site=\"load\" refsite=\"world\" gear=\"{} 0 0 0\"/>\n  </actuator>\n",
        load, triple(chain_.frame.vector(chain_.curve.load_direction)));
    out_ += fmt::format("  <sensor>\n    <framepos name=\"{}\" objtype=\"site\" objname=\"watched\"/>\n  </sensor>\n",
                        channel);
    return out_ + "</mujoco>\n";
  }

 private:
  void line(int depth, const std::string& text) {
    out_ += std::string(4 + 2 * static_cast<size_t>(depth), ' ') + text + "\n";
  }

  void begin_segment(int i) {
    const ChainSegment& segment = chain_.segments[static_cast<size_t>(i)];
    const Eigen::Matrix3d axes = axes_of(chain_, segment);
    const std::string turn = triple(axes.col(0)) + " " + triple(axes.col(1));
    line(i, fmt::format("<body name=\"segment_{}\"{}>", i,
                        i == 0 ? "" : fmt::format(" pos=\"{}\"", triple(origin_of(chain_, i)))));
    if (i > 0) {
      line(i + 1, fmt::format("<inertial pos=\"{}\" xyaxes=\"{}\" mass=\"{:.9g}\" diaginertia=\"{}\"/>",
                              triple(in_body(chain_, i, segment.centre)), turn, segment.mass,
                              fmt::format("{:.9g} {:.9g} {:.9g}", segment.inertia.x(), segment.inertia.y(),
                                          segment.inertia.z())));
      line(i + 1,
           fmt::format("<joint name=\"hinge_{}\" type=\"hinge\" axis=\"{}\" stiffness=\"{:.9g}\" damping=\"{:.9g}\"/>",
                       i, triple(chain_.frame.normal()), chain_.fit.stiffness, chain_.damping));
    }
    line(i + 1, fmt::format("<geom type=\"box\" pos=\"{}\" xyaxes=\"{}\" size=\"{}\"/>",
                            triple(in_body(chain_, i, segment.box_centre)), turn, triple(segment.half)));
    if (chain_.curve.load.segment == i) site(i, "load", in_body(chain_, i, chain_.curve.load.at));
    if (chain_.curve.watched.segment == i) site(i, "watched", in_body(chain_, i, chain_.curve.watched.at));
    for (const ChainCable& cable : chain_.cables) {
      for (size_t k = 0; k < cable.points.size(); ++k) {
        if (cable.points[k].segment == i)
          site(i, fmt::format("{}_{}", xml_text(cable.id), k),
               in_body(chain_, i, cable.points[k].at) + cable.off_plane[k] * chain_.frame.normal());
      }
    }
  }

  void site(int depth, const std::string& name, const Eigen::Vector3d& at) {
    line(depth + 1, fmt::format("<site name=\"{}\" pos=\"{}\" size=\"0.001\"/>", name, triple(at)));
  }

  void tendons() {
    if (chain_.cables.empty()) return;
    out_ += "  <tendon>\n    <!-- ways and lengths of the cables; their pull is in the hinges' stiffness -->\n";
    for (const ChainCable& cable : chain_.cables) {
      out_ += fmt::format("    <spatial name=\"{}\" width=\"0.0005\">\n", xml_text(cable.id));
      for (size_t k = 0; k < cable.points.size(); ++k)
        out_ += fmt::format("      <site site=\"{}_{}\"/>\n", xml_text(cable.id), k);
      out_ += "    </spatial>\n";
    }
    out_ += "  </tendon>\n";
  }

  const ModuleChain& chain_;
  const ChainText& text_;
  std::string out_;
};

/// Roll, pitch and yaw (about the fixed x, y and z, in this order) of a rotation.
Eigen::Vector3d roll_pitch_yaw(const Eigen::Matrix3d& R) {
  const double pitch = std::atan2(-R(2, 0), std::hypot(R(0, 0), R(1, 0)));
  if (std::hypot(R(0, 0), R(1, 0)) < 1e-9) return {std::atan2(-R(1, 2), R(1, 1)), pitch, 0};
  return {std::atan2(R(2, 1), R(2, 2)), pitch, std::atan2(R(1, 0), R(0, 0))};
}

std::string urdf_link(const ModuleChain& chain, int i) {
  const ChainSegment& segment = chain.segments[static_cast<size_t>(i)];
  const std::string turn = triple(roll_pitch_yaw(axes_of(chain, segment)));
  std::string link = fmt::format("  <link name=\"segment_{}\">\n", i);
  if (i > 0)
    link += fmt::format(
        "    <inertial>\n      <origin xyz=\"{}\" rpy=\"{}\"/>\n      <mass value=\"{:.9g}\"/>\n"
        "      <inertia ixx=\"{:.9g}\" iyy=\"{:.9g}\" izz=\"{:.9g}\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/>\n    "
        "</inertial>\n",
        triple(in_body(chain, i, segment.centre)), turn, segment.mass, segment.inertia.x(), segment.inertia.y(),
        segment.inertia.z());
  return link +
         fmt::format(
             "    <visual>\n      <origin xyz=\"{}\" rpy=\"{}\"/>\n      <geometry>\n        <box size=\"{}\"/>\n"
             "      </geometry>\n    </visual>\n  </link>\n",
             triple(in_body(chain, i, segment.box_centre)), turn, triple(2 * segment.half));
}

/// A link without mass that stands for a point of a segment.
std::string urdf_frame(const ModuleChain& chain, const std::string& name, const HingeChain::Place& place) {
  return fmt::format(
      "  <link name=\"{0}\"/>\n  <joint name=\"to_{0}\" type=\"fixed\">\n    <parent link=\"segment_{1}\"/>\n"
      "    <child link=\"{0}\"/>\n    <origin xyz=\"{2}\" rpy=\"0 0 0\"/>\n  </joint>\n",
      name, place.segment, triple(in_body(chain, place.segment, place.at)));
}

}  // namespace

std::string chain_difference(const ModuleChain& chain) {
  return fmt::format("to within {:.2g} % (the largest difference, at {} of 0 to {})", 100 * chain.fit.largest,
                     with_unit(chain.fit.at, "N"), with_unit(chain.curve.forces.back(), "N"));
}

std::string mjcf(const ModuleChain& chain, const ChainText& text) {
  return MjcfWriter(chain, text).written();
}

std::string urdf(const ModuleChain& chain, const ChainText& text) {
  std::string out =
      fmt::format("<?xml version=\"1.0\"?>\n<robot name=\"{}\">\n  <!--\n{}", xml_text(text.name), about(chain, text));
  out += fmt::format(
      "  URDF has no stiffness of joints: set {:.6g} N m/rad on every hinge after loading, or none of this holds.\n"
      "  {} of the run. The load acts at the link \"load\" along {}, what is read is where the link \"watched\" is\n"
      "  along {}. The range of the joints is no limit of the body.\n  -->\n",
      chain.fit.stiffness,
      chain.weight.norm() > 0 ? fmt::format("Gravity has to be {} m/s2, that", triple(chain.frame.vector(chain.weight)))
                              : std::string("Gravity has to be off, as in the model"),
      triple(chain.frame.vector(chain.curve.load_direction)),
      triple(chain.frame.vector(chain.curve.watched_direction)));
  out += urdf_link(chain, 0);
  for (int i = 1; i <= chain.chain.size(); ++i) {
    out += urdf_link(chain, i);
    out += fmt::format(
        "  <joint name=\"hinge_{0}\" type=\"revolute\">\n    <parent link=\"segment_{1}\"/>\n"
        "    <child link=\"segment_{0}\"/>\n    <origin xyz=\"{2}\" rpy=\"0 0 0\"/>\n    <axis xyz=\"{3}\"/>\n"
        "    <limit lower=\"-3.14\" upper=\"3.14\" effort=\"1000\" velocity=\"1000\"/>\n"
        "    <dynamics damping=\"{4:.9g}\" friction=\"0\"/>\n  </joint>\n",
        i, i - 1, triple(origin_of(chain, i)), triple(chain.frame.normal()), chain.damping);
  }
  out += urdf_frame(chain, "load", chain.curve.load) + urdf_frame(chain, "watched", chain.curve.watched);
  return out + "</robot>\n";
}

std::string chain_table_csv(const std::vector<ModuleChain>& chains, const ChainText& text,
                            const std::vector<std::string>& files) {
  std::string csv = fmt::format(
      "# {}{}\n# one stiffness of all hinges, fitted on the chain of each file; the damping is assumed ({:.0f} % of "
      "critical for the lowest mode)\n",
      text.simulated ? "SIMULATED DATA: " : "", text.title, 100 * assumed_damping);
  for (size_t k = 0; k < text.controls.size(); ++k) {
    if (k != text.load) csv += fmt::format("{}_{},", text.controls[k].id, column_suffix(text.controls[k].unit));
  }
  csv += "hinge_stiffness_Nm_per_rad,hinge_damping_Nms_per_rad,largest_difference_%,largest_force_N,file\n";
  for (size_t i = 0; i < chains.size(); ++i) {
    const ModuleChain& chain = chains[i];
    for (size_t k = 0; k < text.controls.size(); ++k) {
      if (k != text.load) csv += fmt::format("{:.10g},", chain.controls[k]);
    }
    csv += fmt::format("{:.9g},{:.9g},{:.4g},{:.6g},{}\n", chain.fit.stiffness, chain.damping, 100 * chain.fit.largest,
                       chain.curve.forces.back(), files[i]);
  }
  return csv;
}

std::string chain_table_json(const std::vector<ModuleChain>& chains, const ChainText& text,
                             const std::vector<std::string>& files) {
  ChainJson json{{"title", text.title}, {"data", text.simulated ? "simulated" : "measured"}};
  json["load"] = load_axis(text).id;
  json["channel"] = text.channel;
  json["assumed"] = {{"density_kg_per_m3", assumed_density}, {"damping_of_critical", assumed_damping}};
  json["states"] = ChainJson::array();
  for (size_t i = 0; i < chains.size(); ++i) {
    const ModuleChain& chain = chains[i];
    const auto in_space = [&](const Eigen::Vector3d& v) { return ChainJson{tidy(v.x()), tidy(v.y()), tidy(v.z())}; };
    const auto place = [&](const HingeChain::Place& of) {
      return ChainJson{{"segment", of.segment}, {"at_m", in_space(chain.frame.point(of.at))}};
    };
    ChainJson& state = json["states"].emplace_back();
    state["file"] = files[i];
    state["held"] = ChainJson::object();
    for (size_t k = 0; k < text.controls.size(); ++k) {
      if (k != text.load) state["held"][text.controls[k].id] = chain.controls[k];
    }
    state["hinge_stiffness_Nm_per_rad"] = chain.fit.stiffness;
    state["hinge_damping_Nms_per_rad"] = chain.damping;
    state["largest_difference"] = chain.fit.largest;
    state["largest_difference_at_N"] = chain.fit.at;
    state["modes_Hz"] = {chain.lowest / (2 * M_PI), chain.highest / (2 * M_PI)};
    state["density_assumed"] = chain.assumed;
    state["gravity_m_per_s2"] = in_space(chain.frame.vector(chain.weight));
    state["axis"] = in_space(chain.frame.normal());
    for (const Eigen::Vector2d& hinge : chain.chain.hinges)
      state["hinges_m"].push_back(in_space(chain.frame.point(hinge)));
    for (const ChainSegment& segment : chain.segments)
      state["segments"].push_back({{"mass_kg", segment.mass},
                                   {"centre_m", in_space(chain.frame.point(segment.centre))},
                                   {"inertia_kg_m2", {segment.inertia.x(), segment.inertia.y(), segment.inertia.z()}}});
    state["load_at"] = place(chain.curve.load);
    state["load_direction"] = in_space(chain.frame.vector(chain.curve.load_direction));
    state["watched_at"] = place(chain.curve.watched);
    state["watched_direction"] = in_space(chain.frame.vector(chain.curve.watched_direction));
    state["forces_N"] = chain.curve.forces;
    state["replay_m"] = chain.curve.displacements;
    state["chain_m"] = chain.fit.displacements;
  }
  return json.dump(1) + "\n";
}

}  // namespace taut
