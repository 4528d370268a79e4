"""Errors of the package. Each text is one line: what is wrong and, if there is one, the remedy."""

from __future__ import annotations

import sys
from pathlib import PurePath
from traceback import walk_tb
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from types import TracebackType

_OWN = {"swarmabs_core", "swarmabs_config", "swarmabs_bag", "swarmabs_run", "swarmabs_view", "numpy", "scipy"}
"""Packages on the way to the code of another package, which their own errors do not blame."""


class SwarmabsError(Exception):
    """Base class of all errors that are not bugs.

    Attributes
    ----------
    problem, remedy : str
        What is wrong and what to do about it; the remedy is empty if it is not given on its own.
    """

    def __init__(self, problem: str, remedy: str = "") -> None:
        self.problem = problem
        self.remedy = remedy
        super().__init__(problem, *filter(None, (remedy,)))

    def __str__(self) -> str:
        return joined(self.problem, self.remedy)


class InputError(SwarmabsError):
    """Invalid input, rejected before anything is started (exit code 2)."""


class RunError(SwarmabsError):
    """Failure of a run that was started (exit code 1)."""


class ProtocolError(RunError):
    """A node received a message that no correct peer sends in this state."""


class MalformedMessageError(ProtocolError):
    """Bytes that are not a message of this swarm."""

    def __init__(self, message_type: str, problem: str) -> None:
        super().__init__(f"malformed {message_type}: {problem}")


def raised(error: BaseException) -> str:
    """Return what the code of another package raised, and where: ``KeyError: 'x' (ship.py:12)``; empty if none did."""
    place = ""
    for frame, line in walk_tb(error.__traceback__):
        package = frame.f_globals.get("__name__", "").partition(".")[0]
        if package not in _OWN and package not in sys.stdlib_module_names:
            place = f" ({PurePath(frame.f_code.co_filename).name}:{line})"
    return place and " ".join(f"{type(error).__name__}: {error}{place}".split())


def joined(problem: str, remedy: str) -> str:
    """Return a problem and its remedy as one text; either may be empty."""
    return "; ".join(filter(None, (problem, remedy)))


def one_line(error: BaseException) -> str:
    """Return an error as one line: its text, with the type if it is foreign, and the place if `raised` knows it."""
    if isinstance(error, SwarmabsError):
        return " ".join(str(error).split())
    return raised(error) or " ".join(f"{type(error).__name__}: {error}".split())


class InStep:
    """A context in which the code of another package is called for a step: what it raises becomes a `RunError`.

    The text has the step, the type and text of the exception, and file and line in the package.
    """

    __slots__ = ("_step",)

    def __init__(self, step: int) -> None:
        self._step = step

    def __enter__(self) -> None:
        """Enter the context."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Replace an exception of another package."""
        if isinstance(error, Exception) and not isinstance(error, SwarmabsError) and (what := raised(error)):
            raise RunError(f"step {self._step}: {what}") from error
