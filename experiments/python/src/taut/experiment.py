"""Experiments: a bench, its readings, and the model that replays them."""

from __future__ import annotations

import os
import warnings
from functools import cached_property
from typing import Any, Mapping, Optional, Union

from . import compiled, tables
from .compiled import Path, Progress
from .errors import SolveError
from .run import Run


class Experiment:
    """An experiment file, or a dict with the same keys. What it says is checked at once, its readings and its model when
    they are first needed.

    `source`: path of an experiment.toml, or a dict: ``{"title": ..., "geometry": {"kind": "box", ...}, ...}`` with
    quantities as in files ("30 mm"). A dict is written out as TOML text and read by the same reader; paths in it are
    relative to `folder` (default: the current one). Raises InputError with place, fault and remedy.
    """

    def __init__(self, source: Union[Path, Mapping[str, Any]], folder: Optional[Path] = None) -> None:
        path, text = compiled.source_of(source, folder)
        self.path: str = os.fsdecode(path)
        self._compiled = compiled.module().Experiment(path, text)

    def __repr__(self) -> str:
        return f"taut.Experiment({self.path!r})"

    @property
    def toml(self) -> str:
        """The text that was read."""
        return self._compiled.toml()

    @cached_property
    def _description(self) -> "dict[str, Any]":
        return self._compiled.describe(0, b"")

    @property
    def title(self) -> str:
        """As the file has it."""
        return self._description["title"]

    @property
    def simulated(self) -> bool:
        """Whether the readings were simulated, not measured."""
        return self._description["simulated"]

    @property
    def remarks(self) -> "list[str]":
        """What a reader must know: data that were recognised, elements that lock."""
        return list(self._description["remarks"])

    @property
    def readings(self) -> Any:
        """What was measured, a row for each reading, in SI: columns line (in the bench file), trial, the controls by
        their ids, channel, value, sigma (one standard deviation), excluded. ``attrs["units"]`` has the units of all
        (of value and sigma a dict by channels where these differ), ``attrs["data"]`` is "measured" or "simulated".
        Values are NaN where nothing is measured yet."""
        about = self._description
        return tables.rows_table(about["readings"], about, data=self._data)

    @property
    def parameters(self) -> Any:
        """All parameters and controls of the model: id, value as the file has it, unit (SI), lower and upper physical
        limits, meaning, and control: whether the bench sets it row by row."""
        listed = self._description["parameters"]
        return tables.make({key: [one[key] for one in listed] for key in listed[0]})

    @property
    def _data(self) -> str:
        return "simulated" if self.simulated else "measured"

    def replay(self, *, derivatives: bool = False, rows: Optional[Path] = None, threads: int = 0,
               progress: Progress = None, **parameters: Union[float, str]) -> Any:
        """Predicts every reading with given parameters, along the path that the experimenter took, as `taut replay`.

        `parameters`: instead of the file's values, ``E_foam="47 kPa"`` or a number in SI. `rows`: a CSV file with the
        columns of controls, instead of the bench's. `threads`: states solved at the same time; 0: as the file says.
        Returns `readings` with a column predicted (SI) and, with `derivatives`, a column d_ID for each parameter and
        control: the derivative of the prediction, SI units of both, everything else held;
        ``attrs["tangent_stiffness"]`` is then a list of dicts with state, load and N_per_m.
        Raises InputError, and SolveError (its ``result``: the table with NaN) where an equilibrium was not found.
        """
        raw = self._compiled.replay(_plain(parameters), derivatives, compiled.path_bytes(rows or ""),
                                    compiled.threads_of(threads), progress)
        readings = dict(raw["readings"])
        table = tables.rows_table(readings, raw, data=self._data)
        if derivatives:
            units = {one["id"]: one["unit"] for one in self._description["parameters"]}
            for k, name in enumerate(raw["with_respect_to"]):
                table[f"d_{name}"] = raw["derivatives"][:, k]
                table.attrs["units"][f"d_{name}"] = f"of the channel per {units.get(name, '')}"
            table.attrs["tangent_stiffness"] = raw["tangent_stiffness"]
        for warning in raw["warnings"]:
            warnings.warn(warning, stacklevel=2)
        if raw["failures"]:
            raise SolveError("; ".join(raw["failures"]), table)
        return table

    def fit(self, out: Optional[Path] = None, *, variants: bool = True, fresh: bool = False, threads: int = 0,
            progress: Progress = None) -> Run:
        """Fits the free parameters to the readings, as `taut fit`, with all that follows: curves, what would explain a
        misfit, shares of what was assumed, variants.

        `out`: a run folder, written as the command writes it (report.html, figures, fit.json, predictions.csv, copies
        of the inputs); an interrupted fit goes on from there when it is called again (`fresh`: starts anew). None: no
        files. `variants`: the refits that the file asks for, too. `progress`: called with lines of text, in the thread
        that waits.
        Returns a Run, also of a fit that did not converge (``run.status``). A stage after the fit that failed, and what
        could not be drawn, is a warning. Raises InputError, and SolveError where
        the simulation failed at the start. After Ctrl-C, KeyboardInterrupt has the Run as far as it came as ``result``.
        """
        where = b"" if out is None else compiled.path_bytes(out)
        called = f"{self!r}.fit({'' if out is None else f'out={os.fspath(out)!r}'})"
        try:
            end, fitted, lost, failures = self._compiled.fit(where, variants, fresh, called,
                                                                             compiled.threads_of(threads), progress)
        except BaseException as error:
            fitted = getattr(error, "result", None)
            if fitted is not None:
                error.result = Run._of(fitted, out)  # type: ignore[attr-defined]
            raise
        if end == "start failed":
            raise SolveError(f"{self.path}: the simulation failed at the start of the fit: {'; '.join(failures)}; change "
                             "the start values, or look at the model with replay()")
        for warning in lost:
            warnings.warn(warning, stacklevel=2)
        return Run._of(fitted, out)


def _plain(parameters: Mapping[str, Any]) -> "dict[str, Union[float, str]]":
    """Numbers as floats: NumPy's too."""
    return {name: value if isinstance(value, str) else float(value) for name, value in parameters.items()}
