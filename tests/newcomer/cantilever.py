# The cantilever of cantilever.cpp with the installed Python package: three loads on its tip, the drops that were read, and
# the Young's modulus that explains them. The readings are made up: Timoshenko's F (L^3/3EI + L/kGA) at 100 kPa.
import tempfile

import taut

with tempfile.TemporaryDirectory() as folder:
    with open(f"{folder}/bench.csv", "w", encoding="utf-8") as bench:
        bench.write("load_N,drop_mm\n0.01,1.72\n0.02,3.44\n0.03,5.15\n")
    run = taut.Experiment({
        "title": "A foam cantilever", "data": "simulated",
        "geometry": {"kind": "rectangle", "size": ["100 mm", "20 mm"], "region": "foam", "thickness": "30 mm", "plane": "stress"},
        "mesh": {"cells": [20, 4], "element": "quadratic"},
        "materials": {"foam": {"law": "neo_hookean", "E": "50 kPa", "nu": 0.3}},
        "support": [{"on": "xmin", "fix": ["x", "y"]}],
        "load": [{"id": "load", "on": "xmax", "direction": [0, -1], "column": "load_N"}],
        "channel": [{"id": "drop", "on": "xmax", "direction": [0, -1], "column": "drop_mm", "noise": {"absolute": "0.02 mm"}}],
        "bench": {"file": "bench.csv"},
        "fit": {"free": {"E_foam": {}}, "mesh_share": False},
    }, folder=folder).fit()
found = run.parameters["E_foam"]
print(f"taut {taut.__version__} from {taut.__file__}")
print(f"E = {found.value / 1e3:.2f} kPa +- {found.se / 1e3:.2f} kPa, chi squared {run.chi2:.2f} for {run.dof} degrees of "
      f"freedom: {found.verdict}")
