"""The compiled part, and what is handed to it."""

from __future__ import annotations

import os
from typing import Any, Callable, Mapping, Optional, Union

from . import toml
from .errors import InputError

Path = Union[str, "os.PathLike[str]"]
Progress = Optional[Callable[[str], Any]]


def module() -> Any:
    """taut._taut. Raises ImportError, which says what to do, where it is not there."""
    try:
        from . import _taut
    except ImportError as error:
        raise ImportError(f"taut's compiled part cannot be loaded ({error}); build and install taut with "
                          "-DTAUT_PYTHON=ON for this Python (taut.Run works without it)") from error
    return _taut


def path_bytes(path: Path) -> bytes:
    """A path as the system has it, whatever its encoding."""
    return os.fsencode(path)


def threads_of(threads: int) -> int:
    """How many states are solved at the same time; 0: as the file says."""
    if isinstance(threads, bool) or not isinstance(threads, int) or not 0 <= threads <= 1024:
        raise InputError(f"threads: a whole number from 0 (as the file says) to 1024 belongs here, not {threads!r}")
    return threads


def source_of(source: Union[Path, Mapping[str, Any]], folder: Optional[Path]) -> "tuple[bytes, Optional[str]]":
    """Path and, of a dict, text of a file: ("folder/dict", its TOML)."""
    if isinstance(source, Mapping):
        return os.path.join(path_bytes(folder or "."), b"dict"), toml.dumps(source)
    if not isinstance(source, (str, os.PathLike)):
        raise InputError(f"a path or a dict with the keys of the file belongs here, not {type(source).__name__}")
    if folder is not None:
        raise InputError(f"{os.fspath(source)}: `folder` is for dicts; paths in a file are relative to it")
    return path_bytes(source), None
