"""Dicts as TOML text, for the one reader that taut has."""

from __future__ import annotations

import json
import os
import re
from typing import Any, Iterator, Mapping

from .errors import InputError

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def dumps(table: Mapping[str, Any]) -> str:
    """The TOML text of a dict of dicts, lists, text, numbers and booleans; NumPy's numbers and arrays, and paths, too.

    Raises InputError, which names the place, for what TOML has no word for.
    """
    return "\n".join(_lines(table, ())) + "\n"


def _lines(table: Mapping[str, Any], place: "tuple[str, ...]") -> Iterator[str]:
    """Plain values first: what follows a header belongs to it."""
    later = []
    for key, value in table.items():
        if not isinstance(key, str):
            raise InputError(f"{_name(place)}: keys are texts, and {key!r} is none")
        if isinstance(value, Mapping) or _is_tables(value):
            later.append((key, value))
        else:
            yield f"{_key(key)} = {_value(value, (*place, key))}"
    for key, value in later:
        inner = (*place, key)
        header = ".".join(map(_key, inner))
        if isinstance(value, Mapping):
            yield f"\n[{header}]"
            yield from _lines(value, inner)
            continue
        for entry in value:
            yield f"\n[[{header}]]"
            for name, one in entry.items():
                yield f"{_key(name)} = {_value(one, (*inner, str(name)))}"


def _is_tables(value: Any) -> bool:
    return isinstance(value, (list, tuple)) and len(value) > 0 and all(isinstance(one, Mapping) for one in value)


def _name(place: "tuple[str, ...]") -> str:
    return "dict: " + (".".join(map(str, place)) or "its top")


def _key(key: Any) -> str:
    return key if isinstance(key, str) and _BARE.fullmatch(key) else _text(str(key))


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value: Any, place: "tuple[str, ...]") -> str:
    if hasattr(value, "tolist"):  # NumPy's
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, (str, os.PathLike)):
        return _text(os.fspath(value))
    if isinstance(value, Mapping):
        inner = ", ".join(f"{_key(key)} = {_value(one, (*place, str(key)))}" for key, one in value.items())
        return f"{{ {inner} }}" if inner else "{}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(_value(one, place) for one in value)}]"
    raise InputError(f"{_name(place)}: {value!r} is a {type(value).__name__}, which no experiment file can hold; write a "
                     "number, a text such as \"30 mm\", true or false, a list or a dict, or leave the key out")
