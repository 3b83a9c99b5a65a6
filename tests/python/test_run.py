"""Experiment.fit, taut.Run and its predictions."""

import json
import math
import os
import shutil
import unittest
import tomllib
import warnings
from pathlib import Path

import numpy as np
import taut
from taut import tables
from common import (CANTILEVER, MODULE, InFolder, command, command_json, hopeless_beam, python, tension_bench,
                    tension_experiment)


def without_circumstances(record):
    """fit.json but for who made it and how long that took."""
    left = {key: value for key, value in record.items() if key not in ("provenance", "timing")}
    for key in ("main", "variants", "shares", "lip_friction"):
        for one in left.get(key, []) if isinstance(left.get(key), list) else [left.get(key)]:
            if isinstance(one, dict):
                one.pop("seconds", None)
    return left


class Fits(InFolder):
    def test_are_the_commands_to_the_last_digit(self):
        for path in (CANTILEVER, CANTILEVER.parents[1] / "foam_point/experiment.toml"):
            expected = command_json("fit", path, "--out", "by_command")
            run = taut.Experiment(path).fit(out="by_python")
            self.assertEqual(without_circumstances(run.record), without_circumstances(expected))
            self.assertEqual(without_circumstances(taut.Run("by_python").record), without_circumstances(expected))
            alone = taut.Experiment(path).fit()
            self.assertEqual(without_circumstances(alone.record), without_circumstances(expected))
            shutil.rmtree("by_python")
            shutil.rmtree("by_command")

    def test_write_the_folder_that_the_command_writes(self):
        command("fit", CANTILEVER, "--out", "by_command", "--no-variants")
        taut.Experiment(CANTILEVER).fit(out="by_python", variants=False)
        files = {folder: {str(file.relative_to(folder)) for file in Path(folder).rglob("*") if file.is_file()}
                 for folder in ("by_command", "by_python")}
        self.assertEqual(files["by_python"], files["by_command"])
        self.assertIn("report.html", files["by_python"])
        for name in ("predictions.csv", "experiment.toml", "data.csv"):
            self.assertEqual(Path("by_python", name).read_bytes(), Path("by_command", name).read_bytes())
        command("report", "by_python")  # the command goes on with it
        provenance = taut.Run("by_python").record["provenance"]
        self.assertEqual(provenance["command_line"], f"taut.Experiment({str(CANTILEVER)!r}).fit(out='by_python')")
        self.assertEqual(provenance["version"], taut.__version__)

    def test_of_a_dict_into_a_folder_explain_themselves(self):
        tension_bench("bench.csv", 100e3, [0.1, 0.3, 0.5], 100.0)
        experiment = taut.Experiment(tension_experiment())
        run = experiment.fit(out="run")
        self.assertEqual(Path("run/experiment.toml").read_text(encoding="utf-8"), experiment.toml)
        shutil.copy("run/data.csv", "run/bench.csv")  # its path is that of the dict
        again = command_json("fit", "run/experiment.toml", "--out", "again")
        self.assertEqual(without_circumstances(again)["parameters"], run.record["parameters"])
        recheck = command_json("recheck", "run")
        self.assertTrue(recheck)

    def test_of_a_straight_line_are_weighted_least_squares(self):
        # Stresses are linear in E, so that E, its error and chi squared are a line through the origin's.
        off = [300.0, -200.0, 150.0, -400.0, 250.0]
        sigma = 250.0
        strains, stresses = tension_bench("bench.csv", 100e3, [0.1, 0.2, 0.3, 0.4, 0.5], sigma, off)
        per_E = np.array([0.5 * ((1 + e) - 1 / (1 + e)) for e in strains])
        y = np.array(stresses)
        E = per_E @ y / (per_E @ per_E)
        se = sigma / math.sqrt(per_E @ per_E)
        run = taut.Experiment(tension_experiment()).fit()
        found = run.parameters["E_foam"]
        # The search ends some thousandths of a standard error from the optimum.
        near = 5e-3 * se
        self.assertAlmostEqual(found.value, E, delta=near)
        self.assertAlmostEqual(found.se / se, 1, delta=1e-4)
        self.assertEqual(found.unit, "Pa")
        self.assertEqual(found.verdict, "well determined")
        self.assertAlmostEqual(run.chi2, float(np.sum(((y - E * per_E) / sigma) ** 2)), delta=1e-4)
        self.assertEqual((run.dof, run.status), (4, "converged"))
        self.assertEqual(run.covariance.shape, (1, 1))
        self.assertEqual(run.covariance_scale, ["logarithm"])
        self.assertAlmostEqual(run.covariance[0, 0] / (se / E) ** 2, 1, delta=1e-4)
        self.assertEqual(run.correlation.tolist(), [[1.0]])
        # A factor e^(+-1.96 s) on the scale of logarithms.
        self.assertAlmostEqual(found.lower95, E * math.exp(-1.96 * se / E), delta=near)
        self.assertAlmostEqual(found.upper95, E * math.exp(1.96 * se / E), delta=near)
        np.testing.assert_allclose(run.readings["predicted"], E * per_E, rtol=near / E)
        np.testing.assert_allclose(run.readings["prediction_se"], se * per_E, rtol=1e-4)

    def test_find_the_modulus_of_timoshenkos_beam(self):
        # F (L^3/3EI + L/kGA) at 100 kPa; plane stress, 100 x 20 x 30 mm.
        loads, length, height, width, E, nu = [0.01, 0.02, 0.03], 0.1, 0.02, 0.03, 100e3, 0.3
        per_load = length**3 / (3 * E * width * height**3 / 12) + length / (5 / 6 * E / (2 * (1 + nu)) * width * height)
        with open("bench.csv", "w", encoding="utf-8") as file:
            file.write("load_N,drop_m\n" + "".join(f"{load},{load * per_load!r}\n" for load in loads))
        run = taut.Experiment({
            "title": "Timoshenko's beam", "data": "simulated",
            "geometry": {"kind": "rectangle", "size": ["100 mm", "20 mm"], "region": "foam", "thickness": "30 mm",
                         "plane": "stress"},
            "mesh": {"cells": np.array([20, 4]), "element": "quadratic"},
            "materials": {"foam": {"law": "neo_hookean", "E": "50 kPa", "nu": nu}},
            "support": [{"on": "xmin", "fix": ["x", "y"]}],
            "load": [{"id": "load", "on": "xmax", "direction": [0, -1], "column": "load_N"}],
            "channel": [{"id": "drop", "on": "xmax", "direction": [0, -1], "column": "drop_m",
                         "noise": {"absolute": "0.02 mm"}}],
            "bench": {"file": "bench.csv"}, "fit": {"free": {"E_foam": {}}, "mesh_share": False},
        }).fit()
        self.assertAlmostEqual(run.parameters["E_foam"].value / E, 1, delta=0.01)

    def test_that_do_not_start_are_solve_errors(self):
        hopeless_beam("beam.toml", ["a,1e6,1"])
        with self.assertRaises(taut.SolveError) as caught:
            taut.Experiment("beam.toml").fit(out="run")
        self.assertIn("start", str(caught.exception))
        self.assertIsNone(caught.exception.result)
        self.assertFalse(Path("run/fit.json").exists())

    def test_without_gnuplot_warn_and_keep_all_else(self):
        tension_bench("bench.csv", 100e3, [0.1, 0.3], 100.0)
        path = os.environ["PATH"]
        os.environ["PATH"] = "/nowhere"
        try:
            with warnings.catch_warnings(record=True) as said:
                warnings.simplefilter("always")
                run = taut.Experiment(tension_experiment()).fit(out="run")
        finally:
            os.environ["PATH"] = path
        self.assertTrue(any("gnuplot" in str(one.message) for one in said))
        self.assertEqual(taut.Run("run").record, run.record)


class Predictions(InFolder):
    @classmethod
    def setUpClass(cls):
        cls.experiment = taut.Experiment(CANTILEVER)
        cls.fitted = cls.experiment.fit(variants=False)

    def test_are_the_commands_to_the_last_digit(self):
        Path("new.csv").write_text("tip_load_N\n0.7\n3\n", encoding="utf-8")
        self.experiment.fit(out="run", variants=False)
        rows = command_json("predict", "run", "--rows", "new.csv")["rows"]
        for run in (self.fitted, taut.Run("run")):
            table = run.predict("new.csv")
            self.assertEqual(list(table["predicted"]), [row["predicted_m"] for row in rows])
            self.assertEqual(list(table["standard_error"]), [row["standard_error_m"] for row in rows])
            self.assertEqual([[a, b] for a, b in zip(table["lower95"], table["upper95"])],
                             [row["interval95_m"] for row in rows])
            self.assertEqual([[a, b] for a, b in zip(table["reading_lower95"], table["reading_upper95"])],
                             [row["reading_interval95_m"] for row in rows])
            self.assertEqual(list(table["tip_load"]), [0.7, 3.0])
            self.assertEqual(list(table["channel"]), ["tip", "tip"])
            self.assertEqual(table.attrs["units"]["predicted"], "m")
            self.assertEqual(table.attrs["data"], "simulated")

    def test_take_rows_in_every_form(self):
        Path("new.csv").write_text("tip_load_N\n0.7\n3\n", encoding="utf-8")
        expected = list(self.fitted.predict(Path("new.csv"))["predicted"])
        forms = [[{"tip_load": 0.7}, {"tip_load": 3}], {"tip_load": [0.7, 3.0]}, {"tip_load": np.array([0.7, 3.0])},
                 [{"tip_load_N": 0.7}, {"tip_load_N": 3}]]
        try:
            import pandas
        except ImportError:
            pass
        else:
            forms += [pandas.DataFrame({"tip_load": [0.7, 3]}), pandas.DataFrame({"tip_load_N": [0.7, 3]})]
        for rows in forms:
            self.assertEqual(list(self.fitted.predict(rows)["predicted"]), expected)
        self.assertEqual(list(self.fitted.predict({"tip_load": 3.0})["predicted"]), expected[1:])
        self.assertEqual(list(self.fitted.predict(self.experiment.readings)["predicted"]), list(self.fitted.readings["predicted"]))

    def test_of_a_module_take_masses_and_retractions_in_si(self):
        Path("new.csv").write_text("retraction_mm,mass_g\n2,25\n0,40\n", encoding="utf-8")
        names = {axis["id"] for axis in taut.Experiment(MODULE)._description["controls"]}
        self.assertEqual(names, {"retraction", "mass"})
        run = self.module_run()
        by_file = run.predict("new.csv")
        by_rows = run.predict([{"mass": 0.025, "retraction": 0.002}, {"mass": 0.04, "retraction": 0.0}])
        self.assertEqual(list(by_file["mass"]), [0.025, 0.04])
        np.testing.assert_allclose(by_rows["predicted"], by_file["predicted"], rtol=1e-12)

    def module_run(self):
        """A fit of the module with its plastic and cables held: seconds."""
        if not hasattr(Predictions, "_module"):
            about = tomllib.loads(MODULE.read_text(encoding="utf-8"))
            about["fit"] = {"free": {"E_foam": about["fit"]["free"]["E_foam"]}, "mesh_share": False}
            about["mesh"]["element"] = "linear"
            Predictions._module = taut.Experiment(about, folder=MODULE.parent).fit()
        return Predictions._module

    def test_wrong_rows_are_refused(self):
        run = self.fitted
        self.assertRefused(lambda: run.predict("nowhere.csv"), "nowhere.csv")
        self.assertRefused(lambda: run.predict([]), "rows")
        self.assertRefused(lambda: run.predict(3), "rows", "CSV")
        self.assertRefused(lambda: run.predict([{"tip_load": 1}, {"tip_lood": 1}]), "row 2", "tip_lood")
        said = self.assertRefused(lambda: run.predict([{"tip_lood_N": 1}]), "rows", "tip_load_N")
        self.assertNotIn("/tmp", said)
        self.assertRefused(lambda: run.predict([{"tip_load": "much"}]), "row 1", "tip_load", "'much'", "N")
        self.assertRefused(lambda: run.predict([{"tip_load": math.inf}]), "row 1", "finite")
        self.assertRefused(lambda: run.predict({"tip_load": [1, 2], "other": [1]}), "lengths")

    def test_take_specimens_by_name_or_number(self):
        controls = [{"id": "load", "unit": "N"}, {"id": "line", "unit": "1", "labels": ["thin", "thick"]}]
        columns = {"load": [1, 2.5], "control_line": ["thick", 1]}  # "line" is a column of our own
        self.assertEqual(tables.control_matrix(columns, controls).tolist(), [[1.0, 2.0], [2.5, 1.0]])
        columns["control_line"][1] = "thicc"
        self.assertRefused(lambda: tables.control_matrix(columns, controls), "row 2", "'thicc'", "thin, thick")

    def test_of_a_material_point_have_no_rows(self):
        tension_bench("bench.csv", 100e3, [0.1, 0.3], 100.0)
        run = taut.Experiment(tension_experiment()).fit()
        self.assertRefused(lambda: run.predict([{"strain": 0.2}]), "no table of loads")

    def test_need_the_inputs_that_were_fitted(self):
        tension_bench("bench.csv", 100e3, [0.1, 0.3], 100.0)
        run = taut.Experiment(tension_experiment()).fit()
        tension_bench("bench.csv", 200e3, [0.1, 0.3], 100.0)
        self.assertRefused(lambda: run.predict([{"strain": 0.2}]), "bench.csv", "fit again")


class Folders(InFolder):
    def test_are_read_without_the_compiled_part(self):
        run = taut.Experiment(CANTILEVER).fit(out="run", variants=False)
        package = Path("alone/taut")
        shutil.copytree(Path(taut.__file__).parent, package, ignore=shutil.ignore_patterns("_taut*", "__pycache__"))
        done = python("""
import json, taut
run = taut.Run("run")
E = run.parameters["E_foam"]
try:
    run.predict([{"tip_load": 1.0}])
    said = ""
except ImportError as error:
    said = str(error)
try:
    taut.Run("nowhere")
except taut.InputError as error:
    said += str(error)
print(json.dumps([E.value, E.se, E.lower95, E.upper95, E.total_lower95, E.total_upper95, E.verdict, run.chi2, run.dof,
                  run.covariance.tolist(), list(run.readings["predicted"]), list(map(int, run.predictions["line"])), run.simulated, said]))
""", env={**os.environ, "PYTHONPATH": str(package.parent.resolve())})
        self.assertEqual(done.returncode, 0, done.stderr)
        *found, said = json.loads(done.stdout)
        E = run.parameters["E_foam"]
        self.assertEqual(found, [E.value, E.se, E.lower95, E.upper95, E.total_lower95, E.total_upper95, E.verdict, run.chi2,
                                 run.dof, run.covariance.tolist(), list(run.readings["predicted"]),
                                 list(map(int, run.readings["line"])), True])
        self.assertIn("-DTAUT_PYTHON=ON", said)
        self.assertIn("taut fit", said)

    def test_have_their_predictions_as_they_stand_there(self):
        run = taut.Experiment(CANTILEVER).fit(out="run", variants=False)
        written = taut.Run("run").predictions
        np.testing.assert_allclose(written["predicted_m"], run.readings["predicted"], rtol=1e-6)
        self.assertEqual(list(written["line"]), list(run.readings["line"]))
        self.assertEqual(list(written["trial"]), list(run.readings["trial"]))
        self.assertRefused(lambda: taut.Experiment(CANTILEVER).fit(variants=False).predictions, "no folder")
        os.remove("run/predictions.csv")
        self.assertRefused(lambda: taut.Run("run").predictions, "predictions.csv", "taut report")

    def test_have_a_table_of_parameters_with_open_ends(self):
        Path("run").mkdir()
        one = {"id": "E", "symbol": "E", "meaning": "a modulus", "value": 1.0, "unit": "Pa", "standard_error": None,
               "interval95": [0.5, None], "verdict": "bounded from one side", "explanation": "why", "start": 2.0,
               "bounds": [None, 9.0]}
        Path("run/fit.json").write_text(json.dumps({"schema": "taut-fit-1", "data": "measured", "title": "t", "status": "converged",
                                                    "parameters": [one]}), encoding="utf-8")
        run = taut.Run("run")
        found = run.parameters["E"]
        self.assertEqual((found.lower95, found.upper95, found.bounds), (0.5, None, (-math.inf, 9.0)))
        self.assertTrue(math.isnan(found.se))
        self.assertEqual(run.table["lower95"][0], 0.5)
        self.assertTrue(math.isnan(run.table["upper95"][0]))
        self.assertIn("bounded from one side", repr(run))

    def test_that_hold_no_fit_are_refused(self):
        self.assertRefused(lambda: taut.Run("nowhere"), "nowhere", "taut fit")
        Path("run").mkdir()
        self.assertRefused(lambda: taut.Run("run"), "fit.json")
        Path("run/fit.json").write_text("{", encoding="utf-8")
        self.assertRefused(lambda: taut.Run("run"), "not JSON")
        Path("run/fit.json").write_text('{"schema": "other"}', encoding="utf-8")
        self.assertRefused(lambda: taut.Run("run"), "'other'", "'taut-fit-1'")

    def test_whose_copies_were_changed_predict_nothing(self):
        taut.Experiment(CANTILEVER).fit(out="run", variants=False)
        with open("run/data.csv", "a", encoding="utf-8") as file:
            file.write("1,4,40\n")
        self.assertRefused(lambda: taut.Run("run").predict([{"tip_load": 1.0}]), "data.csv", "fit again")


if __name__ == "__main__":
    unittest.main()
