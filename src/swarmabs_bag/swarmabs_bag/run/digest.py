"""The digest of a run (docs/reference/bag.md); loaded without numpy by what starts runs."""

from __future__ import annotations

from hashlib import sha256
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from swarmabs_core.messages import Topic


class Digested(Protocol):
    """One step of a run, or several: a `Step`."""

    def digest_text(self) -> bytes:
        """Return the contribution to the digest of a run."""
        ...


class Digest:
    """SHA-256 over the main topics of a run, with steps in ascending order.

    Every message contributes the name of its topic without namespace, a zero byte, the length of its payload as
    little-endian uint32, and the payload; within a step, messages are sorted by topic and robot.
    """

    def __init__(self) -> None:
        self._hash = sha256()

    def update(self, step: Digested) -> None:
        """Add the next step, or steps."""
        self._hash.update(step.digest_text())

    def hexdigest(self) -> str:
        """Return the digest of the steps so far."""
        return self._hash.hexdigest()


def digest_head(topic: Topic, size: int) -> bytes:
    """Return the bytes before a payload of this size in the digest: topic, zero, length."""
    return b"%b\x00%b" % (topic.name.encode(), size.to_bytes(4, "little"))
