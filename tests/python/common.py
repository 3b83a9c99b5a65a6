"""What the tests of the Python package share. Ran by ctest, which sets PYTHONPATH, TAUT (the command) and TAUT_SOURCE."""

import json
import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

SOURCE = Path(os.environ["TAUT_SOURCE"])
COMMAND = os.environ["TAUT"]
CANTILEVER = SOURCE / "experiments/foam_cantilever/experiment.toml"
MODULE = SOURCE / "experiments/push_puppet/experiment.toml"


class InFolder(unittest.TestCase):
    """Tests in an empty folder."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)
        before = os.getcwd()
        self.addCleanup(os.chdir, before)
        os.chdir(folder.name)

    def assertRefused(self, call, *parts):
        """The call raises InputError, a ValueError, in one line that holds all these parts; returns the line."""
        import taut

        with self.assertRaises(taut.InputError) as caught:
            call()
        said = str(caught.exception)
        self.assertIsInstance(caught.exception, ValueError)
        self.assertNotIn("\n", said)
        for part in parts:
            self.assertIn(part, said)
        return said


def command(*words, code=0):
    """What `taut` prints."""
    done = subprocess.run([COMMAND, *map(str, words)], capture_output=True, text=True)
    assert done.returncode == code, done.stderr
    return done.stdout


def command_json(*words):
    return json.loads(command(*words, "--json", "--quiet"))


def python(text, **more):
    """A Python program of its own."""
    return subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=300, **more)


def tension_bench(path, E, strains, sigma, off=None):
    """Writes a bench of a neo-Hookean material point in tension with nu = 0; returns engineering strains, stresses [Pa].

    Psi = mu/2 (tr C - 3) - mu ln J with mu = E/2: free sides stay as they are, and P = mu (s - 1/s), s = 1 + strain.
    """
    stresses = [E / 2 * ((1 + e) - 1 / (1 + e)) + (off[i] if off else 0) for i, e in enumerate(strains)]
    rows = [f"tension,{e!r},{p!r},{sigma!r}" for e, p in zip(strains, stresses)]
    Path(path).write_text("mode,strain_1,stress_Pa,sigma_Pa\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return strains, stresses


def tension_experiment(bench="bench.csv"):
    """The experiment of tension_bench() as a dict."""
    return {
        "title": "A point in tension", "data": "simulated", "geometry": {"kind": "uniaxial"},
        "materials": {"foam": {"law": "neo_hookean", "E": "50 kPa", "nu": 0}},
        "bench": {"file": bench, "mode": "mode", "strain": "strain_1", "stress": "stress_Pa", "sigma": "sigma_Pa"},
        "fit": {"free": {"E_foam": {}}},
    }


def hopeless_beam(path, rows):
    """Writes the beam of tests/support with these rows of loads beside it; its solver gives up early under 1e6 N."""
    text = (SOURCE / "tests/support/beam.toml").read_text(encoding="utf-8")
    Path(path).write_text(text + "[solver]\nmax_iterations = 10\nmax_halvings = 2\n", encoding="utf-8")
    Path(path).with_name("bench.csv").write_text("trial,pull_N,tip_mm\n" + "\n".join(rows) + "\n", encoding="utf-8")
