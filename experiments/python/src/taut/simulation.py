"""Simulations of robots, and inverse kinematics on their equilibria."""

from __future__ import annotations

import json
import os
import warnings
from dataclasses import dataclass
from typing import Any, Mapping, Optional, Sequence, Union

import numpy as np

from . import compiled, tables
from .compiled import Path, Progress
from .errors import InputError, SolveError


@dataclass(frozen=True)
class Simulation:
    """What a simulation found, in SI. Simulated, not measured."""

    title: str
    time: "np.ndarray"  #: (samples) [s]
    controls: "dict[str, np.ndarray]"  #: (samples) each
    channels: "dict[str, np.ndarray]"  #: (samples) each; NaN where there is no value
    units: "dict[str, str]"  #: of controls and channels by their ids
    facts: "list[tuple[str, str]]"  #: label and text: integrator, steps, checks of all states, areas of workspaces
    points: "np.ndarray"  #: rest positions (nodes x dimension) [m]
    elements: "np.ndarray"  #: node numbers (elements x nodes of one), vertices first
    frames: "np.ndarray"  #: samples with a stored state (frames)
    displacements: "np.ndarray"  #: of these (frames x nodes x dimension) [m]
    workspaces: "dict[str, np.ndarray]"  #: points that were reached, by mode (points x 2) [m]
    failure: str  #: why it ended early, or what is impossible in its states; "": neither

    @property
    def table(self) -> Any:
        """time, controls and channels as a table, a row for each sample."""
        columns = {"time": self.time, **self.controls, **self.channels}
        return tables.make(columns, units={"time": "s", **self.units}, data="simulated")


def simulate(source: Union[Path, Mapping[str, Any]], out: Optional[Path] = None, *, folder: Optional[Path] = None,
             progress: Progress = None) -> Simulation:
    """Runs a simulation file, or a dict with the same keys, as `taut simulate`.

    `out`: a run folder, written as the command writes it (states, plots, animation, report); None: no files. `folder`:
    what paths in a dict are relative to. `progress`: called with lines of text. Figures that could not be drawn are left
    out of the folder, with a warning.
    Raises InputError, and SolveError (its ``result``: the Simulation as far as it came) where it ended early, elements
    folded or bodies intersect. After Ctrl-C, KeyboardInterrupt has what there is as ``result``.
    """
    path, text = compiled.source_of(source, folder)
    called = f"taut.simulate({os.fsdecode(path)!r}{'' if out is None else f', out={os.fspath(out)!r}'})"
    try:
        raw = compiled.module().simulate(path, text, b"" if out is None else compiled.path_bytes(out), called, progress)
    except BaseException as error:
        raw = getattr(error, "result", None)
        if raw is not None:
            error.result = _simulation(raw)  # type: ignore[attr-defined]
        raise
    if raw["undrawn"]:
        warnings.warn(raw["undrawn"], stacklevel=2)
    found = _simulation(raw) if "time" in raw else None
    if raw["failure"]:
        raise SolveError(f"{os.fsdecode(path)}: {raw['failure']}", found)
    assert found is not None
    return found


def _simulation(raw: Mapping[str, Any]) -> Simulation:
    plain = {key: raw[key] for key in ("title", "time", "facts", "points", "elements", "frames", "displacements", "failure")}
    return Simulation(
        controls={one["id"]: one["values"] for one in raw["controls"]},
        channels={one["id"]: one["values"] for one in raw["channels"]},
        units={one["id"]: one["unit"] for one in [*raw["controls"], *raw["channels"]]},
        workspaces={one["mode"]: one["points"] for one in raw["workspaces"]}, **plain)


@dataclass(frozen=True)
class Pose:
    """Controls for a target, in SI, and what they achieve."""

    status: str  #: "reached", "unreachable" (the nearest point found) or "failed"
    message: str
    controls: "dict[str, float]"  #: of the free ones, by their ids
    bounds: "dict[str, int]"  #: -1: at its lower bound, 1: at its upper one, 0: between
    wanted: "dict[str, float]"  #: by channel
    achieved: "dict[str, float]"
    units: "dict[str, str]"  #: SI, of all controls and the target's channels
    error: float  #: |achieved - wanted| [m]; angles count as 1 m per radian
    stiffness: float  #: along the channel that it was asked of [N/m]; 0: it was not
    solves: int  #: equilibria that the search took
    factorisations: int
    seconds: float

    @property
    def reached(self) -> bool:
        """Whether the target was."""
        return self.status == "reached"


class InverseKinematics:
    """Controls within their bounds that bring a robot's channels to targets, one after the other, each from the answer
    to the last one: `taut ik --stream`. Statically, by SoftIk (sim/robots/soft_ik.hpp).

    `source`: a simulation file with [ik], or a dict with the same keys (`folder`: what its paths are relative to).
    Raises InputError. One search at a time: calls of other threads wait.
    """

    def __init__(self, source: Union[Path, Mapping[str, Any]], folder: Optional[Path] = None) -> None:
        path, text = compiled.source_of(source, folder)
        self._compiled = compiled.module().InverseKinematics(path, text)
        self._count = 0

    @property
    def targets(self) -> "list[str]":
        """Names of the targets and paths in the file."""
        return self._compiled.names()

    def solve(self, target: Optional[Mapping[str, Any]] = None, *, progress: Progress = None, **channels: Any) -> Pose:
        """The pose for a target: values by ids of channels, numbers in SI or text with a unit, as a dict or as keywords:
        ``solve(tip_x="170 mm", tip_y=0.06)``. "hold" is a dict of controls that are held at values, "stiffness" one of
        a channel and the stiffness [N/m] along it. Raises InputError."""
        wanted = {key: value for key, value in {**(target or {}), **channels}.items() if key != "name"}
        self._count += 1
        return _pose(self._compiled.solve(json.dumps(wanted, default=_plain), f"target {self._count}", progress))

    def solve_named(self, name: str, *, progress: Progress = None) -> "list[Pose]":
        """A target or path of the file, from rest: a pose for each of its points. Raises InputError."""
        return [_pose(raw) for raw in self._compiled.solve_named(name, progress)]


def ik(source: Union[Path, Mapping[str, Any]], targets: Union[None, Mapping[str, Any], Sequence[Mapping[str, Any]]] = None, *,
       folder: Optional[Path] = None, progress: Progress = None) -> "list[Pose]":
    """Poses for targets: see InverseKinematics. `targets`: a list of dicts, or one; None: all of the file, from rest."""
    search = InverseKinematics(source, folder)
    if targets is None:
        return [pose for name in search.targets for pose in search.solve_named(name, progress=progress)]
    return [search.solve(target, progress=progress) for target in ([targets] if isinstance(targets, Mapping) else targets)]


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):  # NumPy's
        return value.tolist()
    raise InputError(f"{value!r}: a number in SI or a text with a unit belongs here")


def _pose(raw: Mapping[str, Any]) -> Pose:
    rest = {key: value for key, value in raw.items() if key != "channels"}
    return Pose(wanted={key: pair[0] for key, pair in raw["channels"].items()},
                achieved={key: pair[1] for key, pair in raw["channels"].items()}, **rest)
