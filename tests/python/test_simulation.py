"""taut.simulate, taut.ik."""

import json
import os
import subprocess
import tomllib
import unittest
import warnings
from pathlib import Path

import numpy as np
import taut
from common import CANTILEVER, COMMAND, SOURCE, InFolder, command_json

ROBOT = SOURCE / "tests/support/robot.toml"
ARM = SOURCE / "experiments/arm/experiment.toml"


class Simulations(InFolder):
    def test_are_the_commands_to_the_last_digit(self):
        channels = command_json("simulate", ROBOT, "--out", "by_command")["channels"]
        found = taut.simulate(ROBOT, out="by_python")
        self.assertEqual(set(found.channels), set(channels))
        for name, one in channels.items():
            values = found.channels[name]
            self.assertEqual([values.min(), values.max(), values[-1]], [one["min"], one["max"], one["end"]], name)
            self.assertEqual(found.units[name], one["unit"])
        self.assertEqual(Path("by_python/channels.csv").read_bytes(), Path("by_command/channels.csv").read_bytes())
        self.assertTrue(Path("by_python/report.html").exists())
        self.assertEqual(found.failure, "")

    def test_without_gnuplot_warn_and_keep_all_else(self):
        path = os.environ["PATH"]
        os.environ["PATH"] = "/nowhere"
        try:
            with warnings.catch_warnings(record=True) as said:
                warnings.simplefilter("always")
                taut.simulate(ROBOT, out="run")
        finally:
            os.environ["PATH"] = path
        self.assertEqual(sum("gnuplot" in str(one.message) for one in said), 1)
        self.assertTrue(Path("run/report.html").exists())
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            taut.simulate(ROBOT, out="run")

    def test_have_channels_controls_and_states_over_time(self):
        found = taut.simulate(ROBOT)
        self.assertEqual(found.time[0], 0)
        self.assertAlmostEqual(found.time[-1], 0.04)
        # pull goes from 0 to 3 mm, motor evenly to 20 degrees
        self.assertAlmostEqual(found.controls["pull"][-1], 0.003)
        np.testing.assert_allclose(found.controls["motor"], np.radians(20) * found.time / 0.04, atol=1e-12)
        self.assertEqual((found.units["pull"], found.units["motor"]), ("m", "rad"))
        frames, nodes, dimension = found.displacements.shape
        self.assertEqual((frames, nodes, dimension), (len(found.frames), len(found.points), 2))
        self.assertEqual(found.elements.max(), nodes - 1)
        # The block falls freely from -0.5 m/s until it touches: its highest nodes after the first stored step.
        block = found.points[:, 1] < -0.02
        self.assertEqual(int(block.sum()), 9)
        self.assertTrue(np.all(found.displacements[0] == 0))
        self.assertTrue(np.all(found.displacements[1][block][:, 1] < 0))
        self.assertEqual(len(found.table["time"]), len(found.time))
        self.assertEqual(found.table.attrs["units"]["time"], "s")

    def test_of_a_dict_are_those_of_the_file(self):
        about = tomllib.loads(ROBOT.read_text(encoding="utf-8"))
        expected, found = taut.simulate(ROBOT), taut.simulate(about, folder=ROBOT.parent, out="run")
        np.testing.assert_array_equal(found.displacements, expected.displacements)
        self.assertTrue(Path("run/channels.csv").exists())

    def test_falling_free_is_a_parabola(self):
        about = tomllib.loads(ROBOT.read_text(encoding="utf-8"))
        about = {key: about[key] for key in ("title", "description", "simulation", "body", "materials")}
        about["body"] = [one for one in about["body"] if one["name"] == "block"]
        del about["materials"]["foam"]
        about["simulation"].update(integrator="bdf2", duration="20 ms", step="1 ms")
        about["channel"] = [{"id": "height", "kind": "position", "of": "block", "direction": [0, 1]}]
        found = taut.simulate(about)
        t = found.time
        # BDF2 is exact on parabolas but for its first step, implicit Euler's, which is off by less than g h^2.
        np.testing.assert_allclose(found.channels["height"] - found.channels["height"][0], -0.5 * t - 0.5 * 9.81 * t**2,
                                   rtol=0, atol=9.81e-6)

    def test_that_are_wrong_are_refused(self):
        self.assertRefused(lambda: taut.simulate(CANTILEVER), "taut.Experiment")
        self.assertRefused(lambda: taut.simulate("nowhere.toml"), "nowhere.toml")
        about = tomllib.loads(ROBOT.read_text(encoding="utf-8"))
        about["simulation"]["step"] = "2 mm"
        self.assertRefused(lambda: taut.simulate(about), "[simulation] step", "mm")


class Targets(InFolder):
    LINES = [{"tip_x": "170 mm", "tip_y": 0.06}, {"tip_x": 0.172, "tip_y": 0.061}]

    def test_are_answered_as_the_stream_does(self):
        text = "".join(json.dumps(line) + "\n" for line in self.LINES)
        done = subprocess.run([COMMAND, "ik", str(ARM), "--stream"], input=text, capture_output=True, text=True, check=True)
        expected = [json.loads(line) for line in done.stdout.splitlines()]
        poses = taut.ik(ARM, self.LINES)
        self.assertEqual(len(poses), len(expected))
        for pose, one in zip(poses, expected):
            self.assertEqual(pose.status, one["status"])
            self.assertEqual(pose.controls, {name: control["value"] for name, control in one["controls"].items()})
            self.assertEqual(pose.bounds, {name: control["bound"] for name, control in one["controls"].items()})
            self.assertEqual(pose.achieved, {name: channel["achieved"] for name, channel in one["channels"].items()})
            self.assertEqual(pose.error, one["error_m"])
        self.assertTrue(poses[0].reached)
        self.assertAlmostEqual(poses[0].achieved["tip_x"], 0.17, delta=1e-4)
        self.assertEqual(poses[0].wanted, {"tip_x": 0.17, "tip_y": 0.06})
        self.assertEqual(poses[0].units["tip_x"], "m")

    def test_of_the_file_have_names(self):
        search = taut.InverseKinematics(ARM)
        self.assertIn("soft", search.targets)
        (pose,) = search.solve_named("soft")
        self.assertTrue(pose.reached)
        self.assertNotIn("motor1", pose.controls)  # held
        self.assertRefused(lambda: search.solve_named("sofd"), "sofd", "did you mean 'soft'")

    def test_that_are_wrong_are_refused(self):
        search = taut.InverseKinematics(ARM)
        self.assertRefused(lambda: search.solve(tip_z=0.1), "target 1", "tip_z", "tip_x")
        self.assertRefused(lambda: search.solve(tip_x="1 N"), "tip_x", "N", "mm")
        self.assertRefused(lambda: search.solve(), "target 3", "needs the value of a channel")
        self.assertRefused(lambda: taut.InverseKinematics(ROBOT), "[ik]") if "[ik]" not in ROBOT.read_text() else None
        self.assertRefused(lambda: taut.ik(CANTILEVER), "taut.Experiment")


if __name__ == "__main__":
    unittest.main()
