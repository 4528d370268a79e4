"""Errors of the package. Each text is one line that states what is wrong and, if there is one, the remedy."""

from __future__ import annotations

import sys
from pathlib import PurePath
from traceback import walk_tb

_OWN = {"swarmabs_core", "swarmabs_config", "swarmabs_bag", "swarmabs_run"}


class SwarmabsError(Exception):
    """Base class of all errors that are not bugs."""


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
