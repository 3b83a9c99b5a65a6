#pragma once
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "sim/contact/contact_term.hpp"
#include "sim/model/channel.hpp"
#include "sim/model/model.hpp"
#include "sim/scene/setup.hpp"
#include "sim/terms/cable.hpp"
#include "sim/terms/joint.hpp"

namespace taut {

/// What a channel of a setup reads: of the state, or where `part` >= 0 the net force on a part, which needs a time
/// step.
struct SceneReading {
  std::string id, unit, meaning;
  std::unique_ptr<Channel> channel;  ///< y(u; p)
  double rest = 0;                   ///< added to it: a position is rest and displacement
  int part = -1;                     ///< of a net force
  Eigen::VectorXd direction;         ///< of a net force, unit length
};

/// The terms of contact and friction of a scene; they live in it.
struct Touching {
  std::vector<const SidedTerm*> terms;     ///< none: there is no contact
  std::map<std::string, int> side_called;  ///< of obstacles and grounds with a name
};

/// What a channel is made from: its settings, the model with all that they may name, and what it becomes.
struct ChannelParts {
  const ChannelSettings& channel;
  const Setup& setup;
  const Model& model;
  const std::vector<Cable>& cables;  ///< as setup.cables has them
  const std::vector<Joint>& joints;  ///< as setup.joints has them
  const Touching& touching;          ///< what of the model is contact
  bool rigid_segments;               ///< stiff regions move as rigid bodies
  SceneReading& reading;

  const Mesh& mesh() const { return model.mesh(); }                           ///< of the model
  Tag tag() const { return mesh().select(channel.on); }                       ///< that it is on
  const Cable& cable() const { return named(setup.cables.cables, cables); }   ///< that it is on
  const Joint& joint() const { return named(setup.joints, joints); }          ///< that it is on
  Eigen::VectorXd direction() const { return vector_of(channel.direction); }  ///< that it is along

 private:
  template <class Settings, class Made>
  const Made& named(const std::vector<Settings>& settings, const std::vector<Made>& made) const {
    size_t k = 0;
    while (settings.at(k).id != channel.on) ++k;
    return made[k];
  }
};

/// A kind of channel, which files, models, tables and drawings ask for what they have to know. A new one is a function
/// that makes its Channel and a row of the table in channel_kinds.cpp.
struct ChannelKind {
  /// place: a tag's mean, a body's centre of mass, a material point or a marker. model: all of it.
  enum class On { place, tag, cable, joint, body, model };
  /// Whether it has a direction: never, in space only, always.
  enum class Directed { no, in_space, always };
  /// In which states it is known: all, equilibria, ends of time steps.
  enum class Known { always, at_rest, in_steps };

  std::string_view name;     ///< as in files
  std::string_view unit;     ///< SI
  std::string_view meaning;  ///< before the name of what it is on: "tension of cable"
  On on;
  /// Null where SceneReading::part says what is read.
  std::unique_ptr<Channel> (*make)(const ChannelParts& of);
  Directed directed = Directed::no;  ///< whether it has a direction, which of a turn is the axis
  bool from_rest = false;            ///< whether it is zero in the rest shape
  Known known = Known::always;       ///< in which states; in_steps: of integrators that hand out their steps
  std::string_view why{};            ///< not in others: the sentence that begins with its name
  bool simulated_only = false;       ///< not of a bench

  /// Whether it says where something is: a coordinate or how it changes.
  bool is_place() const { return on == On::place && unit == "m"; }

  /// A bench has one body, without a name, and no joints.
  bool at_bench() const { return on != On::joint && on != On::body && !simulated_only; }
};

/// All of them.
const std::vector<ChannelKind>& channel_kinds();

}  // namespace taut
