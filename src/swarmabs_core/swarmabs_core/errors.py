"""Errors of the package. Each text is one line that states what is wrong and, if there is one, the remedy."""

from __future__ import annotations


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
