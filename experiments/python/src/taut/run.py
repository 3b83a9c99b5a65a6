"""Runs: what a fit found. Reads run folders without anything compiled."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from typing import Any, Mapping, Optional

import numpy as np

from . import compiled, tables
from .compiled import Path, Progress
from .errors import InputError, SolveError

SCHEMA = "taut-fit-1"


@dataclass(frozen=True)
class Parameter:
    """A fitted parameter, in SI. Ends of intervals are None where they are open; se is NaN where the readings do not
    define it."""

    id: str
    value: float
    unit: str
    se: float  #: standard error, first order, of the noise alone
    lower95: Optional[float]  #: 95 % interval of the noise
    upper95: Optional[float]
    total_lower95: Optional[float]  #: 95 % interval of noise and all shares that count; None too: not asked for
    total_upper95: Optional[float]
    verdict: str  #: "well determined", ...
    explanation: str  #: why, and what would help
    symbol: str
    meaning: str
    start: float
    bounds: "tuple[float, float]"  #: that the fit was given; infinite: none


class Run:
    """What a fit found; of a folder that `taut fit`, or Experiment.fit(out=...), wrote.

    All numbers are those of fit.json, in SI; `record` is its content as it stands there (experiments/README.md has the
    schema). Raises InputError where the folder holds no finished fit.
    """

    def __init__(self, folder: Path) -> None:
        self.folder: Optional[str] = os.fspath(folder)
        self.record: "dict[str, Any]" = _read(self.folder)
        self._fitted: Any = None

    @classmethod
    def _of(cls, fitted: Any, folder: Optional[Path]) -> "Run":
        run = cls.__new__(cls)
        run.folder = os.fspath(folder) if folder is not None and fitted.written() else None
        run.record = json.loads(fitted.json())
        run._fitted = fitted if run.folder is None else None  # a folder has copies of all inputs
        return run

    def __repr__(self) -> str:
        found = ", ".join(f"{p.id} = {p.value:.4g} {p.unit} ({p.verdict})" for p in self.parameters.values())
        return f"<taut.Run of '{self.title}': {self.status}; {found}>"

    @property
    def title(self) -> str:
        """Of the experiment."""
        return self.record["title"]

    @property
    def simulated(self) -> bool:
        """Whether the readings were simulated, not measured."""
        return self.record["data"] == "simulated"

    @property
    def status(self) -> str:
        """"converged", "not converged" or "interrupted"."""
        return self.record["status"]

    @property
    def message(self) -> str:
        """How the fit ended, in words."""
        return self.record["message"]

    @property
    def remarks(self) -> "list[str]":
        """What a reader must know before trusting the numbers."""
        return list(self.record["remarks"])

    @property
    def parameters(self) -> "dict[str, Parameter]":
        """The fitted parameters by their ids."""
        return {one["id"]: _parameter(one) for one in self.record["parameters"]}

    @property
    def table(self) -> Any:
        """The same as a table, a row for each; open ends are NaN."""
        keys = ("id", "value", "unit", "se", "lower95", "upper95", "total_lower95", "total_upper95", "verdict", "explanation")
        columns = {key: [getattr(one, key) for one in self.parameters.values()] for key in keys}
        for key, values in columns.items():
            if key.endswith("95"):
                columns[key] = [_number(value) for value in values]
        return tables.make(columns, data=self.record["data"])

    @property
    def covariance(self) -> "np.ndarray":
        """(parameters x parameters), in the order of `parameters`, on the fitted scale: of logarithms where
        `covariance_scale` says so (1), else of values in SI. (0 x 0) where the fit has no result."""
        return _matrix(self.record["fit"]["covariance"])

    @property
    def covariance_scale(self) -> "list[str]":
        """"logarithm" or "linear" for each parameter."""
        return list(self.record["fit"]["covariance_scale"])

    @property
    def correlation(self) -> "np.ndarray":
        """(parameters x parameters)."""
        return _matrix(self.record["fit"]["correlation"])

    @property
    def chi2(self) -> float:
        """Sum of (residual / sigma)^2."""
        return _number(self.record["fit"]["chi_squared"])

    @property
    def dof(self) -> int:
        """Fitted readings less free parameters."""
        return self.record["fit"]["dof"]

    @property
    def p_value(self) -> float:
        """Probability of a larger chi2 if model and sigmas are right."""
        return _number(self.record["fit"]["chi_squared_p"])

    @property
    def readings(self) -> Any:
        """What was measured beside what the fit says, in SI, as Experiment.readings, with columns predicted and
        prediction_se (standard error of the curve)."""
        listed = self.record["readings"]
        raw: "dict[str, Any]" = {key: [one[key] for one in listed] for key in ("line", "trial", "channel")}
        raw["controls"] = [np.array([_number(one["controls"][k]) for one in listed])
                           for k in range(len(self.record["controls"]))]
        for name, key in (("value", "measured"), ("sigma", "sigma"), ("predicted", "predicted"),
                          ("prediction_se", "prediction_se")):
            raw[name] = np.array([_number(one[key]) for one in listed])
        raw["excluded"] = [bool(one.get("excluded", False)) for one in listed]
        return tables.rows_table(raw, self.record, data=self.record["data"])

    @property
    def predictions(self) -> Any:
        """The folder's predictions.csv as it stands there: units are in the names of its columns. Raises InputError of
        a run without a folder."""
        if self.folder is None:
            raise InputError("this run has no folder, so that there is no predictions.csv; `readings` has the predictions")
        path = os.path.join(self.folder, "predictions.csv")
        if not os.path.exists(path):
            raise InputError(f"{path}: is missing; write it again with `taut report {self.folder}`")
        return tables.read_csv(path, data=self.record["data"])

    def predict(self, rows: Any, *, anyway: bool = False, threads: int = 0, progress: Progress = None) -> Any:
        """Predicts at new loads with the fitted parameters, as `taut predict`, first order in their covariance.

        `rows`: a list of dicts, a dict of columns, or a frame, which have the controls by their ids in SI
        (``{"tip_load": 3.0}``, as in `readings`) or else the columns of the bench file (``{"tip_load_N": 3.0}``); or
        the path of such a CSV file. `anyway`: also from a fit without a result, without errors.
        Returns a row for each of them and channel, in SI: line (of the file; of rows given here as if their header was
        line 1), the controls, channel, predicted, standard_error, lower95 and upper95 (of the curve: the noise's part),
        reading_lower95 and reading_upper95 (of a new reading), equilibria ("" where there is one).
        Raises InputError, and SolveError (its ``result``: the table with NaN) where an equilibrium was not found.
        Needs the compiled part.
        """
        if self._fitted is None:
            self._fitted = compiled.module().Fitted.open(compiled.path_bytes(self.folder or ""))
        if isinstance(rows, (str, os.PathLike)):
            return self._predict(compiled.path_bytes(rows), anyway, threads, progress)
        columns = tables.columns_of(rows)
        controls = self.record["controls"]
        if controls and all(tables.control_column(axis["id"]) in columns for axis in controls):
            return self._predict(tables.control_matrix(columns, controls), anyway, threads, progress)
        with tables.csv_file(columns) as path:
            return self._predict(compiled.path_bytes(path), anyway, threads, progress)

    def _predict(self, rows: Any, anyway: bool, threads: int, progress: Progress) -> Any:
        raw = self._fitted.predict(rows, anyway, compiled.threads_of(threads), progress)
        table = tables.rows_table(raw["rows"], raw, data=self.record["data"], warnings=raw["warnings"])
        if raw["failures"]:
            raise SolveError("; ".join(raw["failures"]), table)
        return table


def _read(folder: str) -> "dict[str, Any]":
    path = os.path.join(folder, "fit.json")
    if os.path.exists(os.path.join(folder, ".next", ".publish")):
        raise InputError(f"{folder}: a run here was killed while it took its place; `taut report {folder}` finishes that")
    try:
        with open(path, encoding="utf-8") as file:
            record = json.load(file)
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{path}: is missing, so no fit was finished in this folder; name a folder that `taut fit` has "
                         "written") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path") from None
    except ValueError as error:
        raise InputError(f"{path}: is not JSON ({error}); restore the file or run the fit again") from None
    schema = record.get("schema") if isinstance(record, Mapping) else None
    if schema != SCHEMA:
        raise InputError(f"{path}: the schema is {schema!r} but this version reads {SCHEMA!r}; run the fit again with it")
    return record


def _number(value: Optional[float]) -> float:
    return float("nan") if value is None else float(value)


def _matrix(rows: "list[list[Optional[float]]]") -> "np.ndarray":
    return np.array([[_number(value) for value in row] for row in rows], dtype=float).reshape(len(rows), len(rows))


def _parameter(one: Mapping[str, Any]) -> Parameter:
    total = one.get("total95") or (None, None)
    lower, upper = one["bounds"]
    return Parameter(
        id=one["id"], value=_number(one["value"]), unit=one["unit"], se=_number(one["standard_error"]),
        lower95=one["interval95"][0], upper95=one["interval95"][1], total_lower95=total[0], total_upper95=total[1],
        verdict=one["verdict"], explanation=one["explanation"], symbol=one["symbol"], meaning=one["meaning"],
        start=_number(one["start"]),
        bounds=(float("-inf") if lower is None else lower, float("inf") if upper is None else upper))
