"""What taut raises."""

from __future__ import annotations

from typing import Any


class InputError(ValueError):
    """Wrong input, in one sentence that says where, what, what is allowed and what to do."""


class SolveError(RuntimeError):
    """A simulation found no equilibrium, or ended early.

    ``result`` is what succeeded all the same (as the call would have returned it, NaN where it failed), or None.
    """

    def __init__(self, message: str, result: Any = None) -> None:
        super().__init__(message)
        self.result = result
