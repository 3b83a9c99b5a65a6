# %% [markdown]
# # Calibrating a foam cantilever from Python
#
# A foam cantilever, four hung loads, three trials each (`experiments/foam_cantilever`; its readings are **simulated, not
# measured**). Run it as a script, or cell by cell in an editor that knows `# %%`. Numbers are in SI.

# %%
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import taut

root = Path(__file__).resolve().parents[2]  # of the sources
experiment = taut.Experiment(root / "experiments/foam_cantilever/experiment.toml")
readings = experiment.readings
print(experiment.title, "-", readings.attrs["data"], "readings in", readings.attrs["units"])
print(readings)

# %% [markdown]
# What the model says with the values of the file, and with a softer foam; and how much the modulus matters to each row.

# %%
replay = experiment.replay(E_foam="47 kPa", derivatives=True)
print("a foam of 47 kPa would drop", 1e3 * np.max(replay["predicted"]), "mm, not", 1e3 * np.max(replay["value"]), "mm")
print("and each further kPa changes that by", 1e6 * np.min(replay["d_E_foam"]), "mm")

# %% [markdown]
# The fit, with all that `taut fit` does; `out="runs/..."` would write its folder with report.html.

# %%
run = experiment.fit(progress=lambda line: print(line, file=sys.stderr))
E = run.parameters["E_foam"]
print(f"E = {E.value / 1e3:.2f} kPa, 95 % interval {E.lower95 / 1e3:.2f} to {E.upper95 / 1e3:.2f} kPa: {E.verdict}")
print(E.explanation)
print(f"chi squared {run.chi2:.2f} for {run.dof} degrees of freedom")

# %% [markdown]
# The same numbers as the command's, to the last digit (where the command is: in PATH, or named by TAUT).

# %%
command = os.environ.get("TAUT", "taut")
printed = subprocess.run([command, "fit", root / "experiments/foam_cantilever/experiment.toml", "--json", "--quiet", "--out",
                          "runs/example"], capture_output=True, text=True, check=True).stdout
by_command = json.loads(printed)
for mine, theirs in zip(run.record["parameters"], by_command["parameters"]):
    assert mine == theirs, (mine, theirs)
assert run.chi2 == by_command["fit"]["chi_squared"]
print("equal to what `taut fit --json` prints")

# %% [markdown]
# At loads that nobody has measured, with the band of the curve and that of a new reading.

# %%
print(run.predict([{"tip_load": 0.001}, {"tip_load": 3.0}]))

# %% [markdown]
# Small loads have a closed form, Timoshenko's beam: drop = F (L^3/(3 E' I) + L/(k G A)), in plane strain with
# E' = E/(1 - nu^2). The beam is short (55 x 30 mm), and the formula knows nothing of how its clamp holds it: within 3 %.

# %%
F, L, h, b, nu = 1e-3, 0.055, 0.030, 0.030, 0.3
beam = F * (L**3 / (3 * E.value / (1 - nu**2) * b * h**3 / 12) + L / (5 / 6 * E.value / (2 * (1 + nu)) * b * h))
solid = run.predict({"tip_load": F})["predicted"][0]
print(f"at 1 mN: {1e6 * solid:.2f} um by the fit, {1e6 * beam:.2f} um by Timoshenko")
assert abs(solid / beam - 1) < 0.03

# %% [markdown]
# Afterwards, and elsewhere: a run folder is read without the compiled part of taut.

# %%
again = taut.Run("runs/example")
assert again.parameters == run.parameters
print(again)
