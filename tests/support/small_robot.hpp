#pragma once
#include <string>

// A two-link robot of a few elements: a soft beam with two cables on a motorised joint, a ball above a ground.
namespace taut::test {

inline const std::string robot_toml = R"(title = "A small robot"
description = "For tests."

[simulation]
integrator = "implicit_euler"
duration = "40 ms"
step = "2 ms"
frames = 5
thickness = "20 mm"
gravity = "9.81 m/s2"
direction = [0, -1]

[[body]]
name = "arm"
geometry = { kind = "rectangle", size = ["60 mm", "12 mm"], origin = ["0 mm", "-6 mm"], region = "foam" }
mesh = { cells = [8, 2], element = "linear" }

[[body]]
name = "block"
geometry = { kind = "rectangle", size = ["8 mm", "8 mm"], region = "rubber" }
mesh = { cells = [2, 2], element = "linear" }
at = ["20 mm", "-38 mm"]
velocity = ["0 m/s", "-0.5 m/s"]

[materials.foam]
law = "neo_hookean"
E = "100 kPa"
nu = 0.3
density = "100 kg/m3"

[materials.rubber]
law = "neo_hookean"
E = "200 kPa"
nu = 0.4
density = "1000 kg/m3"

[damping.foam]
stiffness = "2 ms"

[[control]]
id = "pull"
start = "0 mm"
[[control.piece]]
until = "40 ms"
to = "3 mm"

[[control]]
id = "motor"
start = "0 deg"
[[control.piece]]
until = "40 ms"
kind = "linear"
to = "20 deg"

[[cable]]
id = "upper"
body = "arm"
x = ["0 mm", "30 mm", "60 mm"]
y = ["5 mm", "5 mm", "5 mm"]
k = "2 N/mm"
retraction = "pull"

[[joint]]
id = "shoulder"
between = ["world", "arm"]
at = ["2 mm", "0 mm"]
motor_at = ["2 mm", "4 mm"]
radius = "3 mm"
stiffness = "1000 N/mm"
angle = "motor"

[[load]]
id = "tip_mass"
on = "arm.xmax"
direction = [0, -1]
value = "2 g"

[contact]
gap = "0.3 mm"
[[contact.ground]]
point = ["0 mm", "-40 mm"]
normal = [0, 1]

[[channel]]
id = "tip_y"
kind = "position"
of = "arm.xmax"
direction = [0, 1]

[[channel]]
id = "tip_turn"
kind = "rotation"
of = "arm.xmax"

[[channel]]
id = "tension"
kind = "tension"
of = "upper"

[[channel]]
id = "shoulder_angle"
kind = "joint_angle"
of = "shoulder"

[[channel]]
id = "block_force"
kind = "net_force"
of = "block"
direction = [0, 1]

[[channel]]
id = "block_height"
kind = "position"
of = "block"
direction = [0, 1]

[[plot]]
id = "turn_over_pull"
title = "Turn of the tip over the retraction"
x = "pull"
y = ["tip_turn"]
)";

}  // namespace taut::test
