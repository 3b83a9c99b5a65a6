"""taut.Experiment: readings, replays, dicts, wrong input."""

import csv
import math
import tomllib
import unittest

import numpy as np
import taut
from taut import toml
from common import (CANTILEVER, MODULE, SOURCE, InFolder, command_json, hopeless_beam, python, tension_bench,
                    tension_experiment)


def read_dict(path):
    with open(path, "rb") as file:
        return tomllib.load(file)


class Readings(InFolder):
    def test_are_those_of_the_bench_file_in_si(self):
        experiment = taut.Experiment(CANTILEVER)
        table = experiment.readings
        with open(SOURCE / "data/foam_cantilever_synthetic/bench.csv", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        self.assertEqual(len(table), len(rows))
        self.assertEqual(list(table["trial"]), [row["trial"] for row in rows])
        self.assertEqual(list(table["channel"]), ["tip"] * len(rows))
        self.assertEqual(list(table["line"]), list(range(2, len(rows) + 2)))
        np.testing.assert_allclose(table["tip_load"], [float(row["tip_load_N"]) for row in rows], rtol=1e-15)
        drops = np.array([float(row["tip_drop_mm"]) for row in rows]) / 1000
        np.testing.assert_allclose(table["value"], drops, rtol=1e-14)
        # noise = { relative = "1 %", absolute = "0.02 mm", resolution = "0.01 mm" }
        np.testing.assert_allclose(table["sigma"], np.sqrt((0.01 * drops) ** 2 + 2e-5**2 + 1e-5**2 / 12), rtol=1e-12)
        self.assertFalse(any(table["excluded"]))
        self.assertEqual(table.attrs["units"], {"tip_load": "N", "value": "m", "sigma": "m"})
        self.assertEqual(table.attrs["data"], "simulated")
        self.assertEqual(experiment.title, "Foam cantilever, four tip loads")

    def test_of_a_plan_are_nan(self):
        with open("plan.csv", "w", encoding="utf-8") as file:
            file.write("trial,tip_load_N,tip_drop_mm\n1,0.5,\n1,1,\n")
        about = read_dict(CANTILEVER)
        about["bench"]["file"] = "plan.csv"
        table = taut.Experiment(about).readings
        self.assertEqual(list(table["tip_load"]), [0.5, 1.0])
        self.assertTrue(np.all(np.isnan(table["value"])))

    def test_of_all_shipped_experiments_are_finite_and_have_units(self):
        count = 0
        for path in sorted((SOURCE / "experiments").glob("*/*.toml")):
            if "simulation" in read_dict(path):
                continue
            table = taut.Experiment(path).readings
            self.assertTrue(np.all(np.isfinite(np.asarray(table["value"])[~np.asarray(table["excluded"])])), path)
            self.assertTrue(np.all(np.asarray(table["sigma"]) > 0), path)
            named = {"line", "trial", "channel", "excluded"} | set(table.attrs["units"])
            self.assertEqual(set(table), named, path)
            count += 1
        self.assertGreaterEqual(count, 9)

    def test_are_numpy_arrays_without_pandas(self):
        done = python(f"""
import sys
sys.modules["pandas"] = None
import numpy, taut
table = taut.Experiment({str(CANTILEVER)!r}).readings
assert isinstance(table, dict) and all(isinstance(column, numpy.ndarray) for column in table.values()), table
print(table.attrs["units"]["value"], table["value"][0], len(table["tip_load"]))
""")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(done.stdout.split(), ["m", "0.00464", "12"])

    def test_parameters_have_values_units_and_limits(self):
        table = taut.Experiment(CANTILEVER).parameters
        by_id = {name: k for k, name in enumerate(table["id"])}
        k = by_id["E_foam"]
        self.assertEqual((table["value"][k], table["unit"][k], bool(table["control"][k])), (80e3, "Pa", False))
        self.assertTrue(table["lower"][k] > 0)
        self.assertTrue(bool(table["control"][by_id["tip_load"]]))


class Dicts(InFolder):
    def test_are_written_as_toml_that_says_the_same(self):
        count = 0
        for path in sorted((SOURCE / "experiments").glob("*/*.toml")) + sorted((SOURCE / "experiments/init").glob("*/*.toml")):
            about = read_dict(path)
            self.assertEqual(tomllib.loads(toml.dumps(about)), about, path)
            count += 1
        self.assertGreater(count, 20)

    def test_nasty_texts_keys_and_numbers_come_back(self):
        about = {"a key": 'quotes " and \\ and\nlines\ttabs \x7f \x01 é µ', "list": [1, 2.5, True, "x", [1e-300]], "empty": [],
                 "table": {"inner.dotted": {"x": -0.0, "big": 12345678901234567}}, "many": [{"a": {"b": [{"c": 1}]}}, {}]}
        self.assertEqual(tomllib.loads(toml.dumps(about)), about)
        self.assertEqual(tomllib.loads(toml.dumps({"a": np.arange(3), "b": np.float64(0.1), "c": np.bool_(True)})),
                         {"a": [0, 1, 2], "b": 0.1, "c": True})

    def test_are_read_as_the_file_is(self):
        for path in (CANTILEVER, SOURCE / "experiments/foam_point/experiment.toml"):
            from_file, from_dict = taut.Experiment(path), taut.Experiment(read_dict(path), folder=path.parent)
            self.assertEqual(from_dict.title, from_file.title)
            for column in from_file.readings:
                self.assertEqual(list(from_file.readings[column]), list(from_dict.readings[column]), column)
            self.assertEqual(list(from_file.replay()["predicted"]), list(from_dict.replay()["predicted"]))
        self.assertEqual(tomllib.loads(from_dict.toml), read_dict(path))
        self.assertEqual(tomllib.loads(from_file.toml), read_dict(path))


class Replays(InFolder):
    def test_are_the_commands_to_the_last_digit(self):
        for path, options, given in ((CANTILEVER, [], {}), (CANTILEVER, ["--set", "E_foam=47kPa"], {"E_foam": "47 kPa"}),
                                     (MODULE, [], {})):
            rows = command_json("replay", path, "--out", "run", *options)["rows"]
            table = taut.Experiment(path).replay(**given)
            self.assertEqual(list(table["predicted"]), [row["predicted_m"] for row in rows])
            self.assertEqual(list(table["line"]), [row["line"] for row in rows])
            self.assertEqual(table.attrs["units"]["predicted"], "m")

    def test_take_numbers_in_si(self):
        experiment = taut.Experiment(CANTILEVER)
        self.assertEqual(list(experiment.replay(E_foam="47 kPa")["predicted"]),
                         list(experiment.replay(E_foam=np.float32(47e3))["predicted"]))
        self.assertEqual(list(experiment.replay(E_foam=47000)["predicted"]),
                         list(experiment.replay(E_foam="47000 Pa")["predicted"]))

    def test_of_a_material_point_are_its_closed_form(self):
        strains, stresses = tension_bench("bench.csv", 100e3, [0.05, 0.2, 0.5, 1.0], 100.0)
        table = taut.Experiment(tension_experiment()).replay(E_foam=100e3, derivatives=True)
        np.testing.assert_allclose(table["predicted"], stresses, rtol=1e-12)
        self.assertEqual(table.attrs["units"]["predicted"], "Pa")
        np.testing.assert_allclose(table["d_E_foam"], np.array(stresses) / 100e3, rtol=1e-12)  # linear in E

    def test_derivatives_are_those_of_finite_differences(self):
        experiment = taut.Experiment(CANTILEVER)
        table = experiment.replay(derivatives=True)
        h = 1e-4
        for name, value in (("E_foam", 80e3), ("nu_foam", 0.3)):
            up, down = (np.array(experiment.replay(**{name: value * factor})["predicted"]) for factor in (1 + h, 1 - h))
            np.testing.assert_allclose(table[f"d_{name}"], (up - down) / (2 * h * value), rtol=2e-6)
        stiffness = table.attrs["tangent_stiffness"]
        self.assertEqual({one["load"] for one in stiffness}, {"tip_load"})
        # k = dF/dx of the loaded place, which is the channel's own here.
        slopes = {float(f): 1 / d for f, d in zip(table["tip_load"], table["d_tip_load"])}
        np.testing.assert_allclose(sorted(one["N_per_m"] for one in stiffness), sorted(slopes.values()), rtol=1e-9)

    def test_take_other_rows(self):
        with open("plan.csv", "w", encoding="utf-8") as file:
            file.write("tip_load_N\n0.5\n4\n")
        experiment = taut.Experiment(CANTILEVER)
        planned, whole = experiment.replay(rows="plan.csv"), experiment.replay()
        by_load = dict(zip(whole["tip_load"], whole["predicted"]))
        np.testing.assert_allclose(planned["predicted"], [by_load[0.5], by_load[4.0]], rtol=1e-6)

    def test_that_fail_say_so_and_keep_the_rest(self):
        hopeless_beam("beam.toml", ["a,0.05,1", "a,1e6,2"])
        with self.assertRaises(taut.SolveError) as caught:
            taut.Experiment("beam.toml").replay()
        self.assertIn("no equilibrium at pull = 1000 kN", str(caught.exception))
        table = caught.exception.result
        self.assertEqual(list(np.isnan(table["predicted"])), [False, True])


class WrongInput(InFolder):
    def test_is_one_sentence_of_tauts_own(self):
        good = read_dict(CANTILEVER)

        def changed(place, value):
            about = read_dict(CANTILEVER)
            table = about
            for key in place[:-1]:
                table = table[key]
            table[place[-1]] = value
            return lambda: taut.Experiment(about, folder=CANTILEVER.parent)

        self.assertRefused(lambda: taut.Experiment("nowhere.toml"), "nowhere.toml")
        self.assertRefused(changed(("materials", "foam", "E"), 80e3), "[materials.foam] E", '"1 Pa"')
        self.assertRefused(changed(("materials", "foam", "Nu"), 0.3), "Nu", "did you mean 'nu'")
        self.assertRefused(changed(("mesh", "element"), "cubic"), "[mesh] element", "quadratic")
        self.assertRefused(changed(("bench", "file"), None), "bench.file", "None", "NoneType")
        self.assertRefused(changed(("channel",), [{"id": "tip", 3: 4}]), "3")
        self.assertRefused(lambda: taut.Experiment(good).readings, "../../data/foam_cantilever_synthetic/bench.csv")  # another folder
        self.assertRefused(lambda: taut.Experiment(CANTILEVER, folder="."), "folder", "dict")
        self.assertRefused(lambda: taut.Experiment(3), "path", "int")
        self.assertRefused(lambda: taut.Experiment(SOURCE / "experiments/arm/experiment.toml"), "simulation")

    def test_of_a_replay_is_refused(self):
        experiment = taut.Experiment(CANTILEVER)
        self.assertRefused(lambda: experiment.replay(E_foem="47 kPa"), "E_foem", "E_foam")
        self.assertRefused(lambda: experiment.replay(E_foam="47 N"), "E_foam", "N", "Pa")
        self.assertRefused(lambda: experiment.replay(E_foam=-1.0), "E_foam")
        self.assertRefused(lambda: experiment.replay(E_foam=math.nan), "E_foam")
        self.assertRefused(lambda: experiment.replay(tip_load="1 N"), "tip_load", "set by the bench")
        self.assertRefused(lambda: experiment.replay(rows="nowhere.csv"), "nowhere.csv")
        self.assertRefused(lambda: experiment.replay(threads=-1), "threads", "1024", "-1")


if __name__ == "__main__":
    unittest.main()
