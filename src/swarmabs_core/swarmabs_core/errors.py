"""Errors of the package. Their text is one line that names what is wrong and, if there is one, the remedy."""

from __future__ import annotations


class SwarmabsError(Exception):
    """Base of every error that is not a bug."""


class InputError(SwarmabsError):
    """Something the user gave is refused before anything was started (exit code 2)."""


class RunError(SwarmabsError):
    """A run was started and failed (exit code 1)."""


class ProtocolError(RunError):
    """A node received a message that no correct peer sends in this state."""


class MalformedMessageError(ProtocolError):
    """Bytes that are not a message of this swarm."""

    def __init__(self, message_type: str, problem: str) -> None:
        super().__init__(f"malformed {message_type}: {problem}")
