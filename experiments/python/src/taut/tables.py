"""Tables: pandas frames where pandas is there, else dicts of NumPy arrays."""

from __future__ import annotations

import csv
import os
import tempfile
from contextlib import contextmanager
from typing import Any, Iterator, Mapping, Sequence, Union

import numpy as np

from .errors import InputError


class Table(dict):
    """Columns by their names, NumPy arrays of one length; ``attrs`` as pandas frames have them."""

    def __init__(self, columns: Mapping[str, Any]) -> None:
        super().__init__(columns)
        self.attrs: "dict[str, Any]" = {}


def make(columns: Mapping[str, Any], **attrs: Any) -> Any:
    """A frame, or a Table, with attributes."""
    arrays = {name: np.asarray(values) for name, values in columns.items()}
    try:
        import pandas
    except ImportError:
        table: Any = Table(arrays)
    else:
        table = pandas.DataFrame(arrays, copy=False)
    table.attrs.update(attrs)
    return table


def rows_table(raw: Mapping[str, Any], axes: Mapping[str, Any], **attrs: Any) -> Any:
    """What the compiled part says of readings or predictions as a table: controls by their ids, all in SI.

    `axes`: dict with lists "controls" and "channels" of dicts with id, unit, labels.
    """
    columns: "dict[str, Any]" = {}
    units: "dict[str, Any]" = {}
    labels: "dict[str, Any]" = {}
    channel_units = {axis["id"]: axis["unit"] for axis in axes["channels"]}
    values_unit = one_or_each(channel_units)
    for name, values in raw.items():
        if name != "controls":
            columns[name] = values
            if name not in ("line", "trial", "channel", "excluded", "equilibria"):
                units[name] = values_unit
            continue
        for axis, control in zip(axes["controls"], values):
            own = control_column(axis["id"])
            columns[own] = control
            units[own] = axis["unit"]
            if axis.get("labels"):
                labels[own] = axis["labels"]
    table = make(columns, units=units, **attrs)
    if labels:
        table.attrs["labels"] = labels  # what the numbers 1, 2, ... of a control stand for
    return table


RESERVED = ("line", "trial", "channel", "value", "sigma", "excluded", "predicted")


def control_column(name: str) -> str:
    """The column of a control: its id, unless a column of our own is called so."""
    return f"control_{name}" if name in RESERVED else name


def one_or_each(channel_units: Mapping[str, str]) -> Union[str, "dict[str, str]"]:
    """The unit of all channels, or a dict of each one's."""
    distinct = set(channel_units.values())
    return distinct.pop() if len(distinct) == 1 else dict(channel_units)


def columns_of(rows: Any) -> "dict[str, list[Any]]":
    """Columns of rows that a user gives: list of dicts, dict of columns or of single values, or frame."""
    if hasattr(rows, "to_dict") and hasattr(rows, "columns"):
        return {str(name): list(rows[name]) for name in rows.columns}
    if isinstance(rows, Mapping):
        if all(np.ndim(values) == 0 for values in rows.values()):
            rows = [rows]
        else:
            columns = {str(name): list(values) for name, values in rows.items()}
            if len({len(values) for values in columns.values()}) > 1:
                raise InputError("rows: the columns have different lengths; each needs one value per row")
            return columns
    if not isinstance(rows, Sequence) or isinstance(rows, (str, bytes)) or not all(isinstance(row, Mapping) for row in rows):
        raise InputError("rows: a list of dicts, a dict of columns, a frame or the path of a CSV file belongs here")
    if len(rows) == 0:
        raise InputError("rows: there is none; give one dict for each prediction")
    for i, row in enumerate(rows):
        if set(row) != set(rows[0]):
            raise InputError(f"rows: row {i + 1} has other keys than row 1 ({', '.join(map(str, row))} instead of "
                             f"{', '.join(map(str, rows[0]))}); each needs the same")
    return {str(name): [row[name] for row in rows] for name in rows[0]}


def control_matrix(columns: Mapping[str, Sequence[Any]], controls: Sequence[Mapping[str, Any]]) -> "np.ndarray":
    """(rows x controls) in SI of columns that have all controls by their ids; names of specimens become numbers."""
    values = []
    for axis in controls:
        labels = axis.get("labels") or []
        column = []
        for row, value in enumerate(columns[control_column(axis["id"])]):
            try:
                column.append(float(labels.index(value) + 1 if value in labels else value))
            except (TypeError, ValueError):
                known = f"; known: {', '.join(labels)}" if labels else f", in {axis['unit']}"
                raise InputError(f"rows: row {row + 1}, {axis['id']}: a number belongs here, not {value!r}{known}") from None
            if not np.isfinite(column[-1]):
                raise InputError(f"rows: row {row + 1}, {axis['id']}: the number must be finite")
        values.append(column)
    return np.array(values, dtype=float).reshape(len(controls), -1).T


@contextmanager
def csv_file(columns: Mapping[str, Sequence[Any]]) -> "Iterator[str]":
    """A file of these columns for the reader of bench files; it is called "rows" in what that says."""
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "rows.csv")
        with open(path, "w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(columns)
            writer.writerows(zip(*columns.values()))
        try:
            yield path
        except InputError as error:
            raise InputError(str(error).replace(path, "rows")) from None


def read_csv(path: str, **attrs: Any) -> Any:
    """A CSV file of taut's own: columns of numbers where all cells are such (empty ones NaN), else of text."""
    with open(path, newline="", encoding="utf-8", errors="surrogateescape") as file:
        head, *lines = list(csv.reader(file))
    columns = {name: _cells(name, [line[k] for line in lines]) for k, name in enumerate(head)}
    return make(columns, **attrs)


def _cells(name: str, cells: "list[str]") -> Any:
    if name in ("trial", "channel"):  # names, though they may look like numbers
        return cells
    for kind in (int, float):
        try:
            return [kind(cell) if cell or kind is int else float("nan") for cell in cells]
        except ValueError:
            continue
    return cells
