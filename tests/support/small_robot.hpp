#pragma once
#include "tests/support/experiment_files.hpp"

// A two-link robot of a few elements: a soft beam with two cables on a motorised joint, a ball above a ground.
namespace taut::test {

inline const std::string robot_toml = text_of(TAUT_SOURCE_DIR "/tests/support/robot.toml");

/// The same with its block held, and two targets: one that its motor reaches and one that is too far.
inline const std::string posed_robot_toml =
    replaced(robot_toml, "velocity = [\"0 m/s\", \"-0.5 m/s\"]", "clamped = [\"ymin\"]") + R"(
[ik.control.motor]
lower = "-40 deg"
upper = "40 deg"

[[ik.target]]
name = "up"
tip_y = "20 mm"

[[ik.target]]
name = "far"
tip_y = "200 mm"
)";

}  // namespace taut::test
