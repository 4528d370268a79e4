"""Signatures by which states stay their author's, where robots pass on those of others (`Relay`).

The sender of a relay is proved by the middleware; the authors of the states in it are not. In a sealed swarm each
robot, and the plane, signs its states, and the signature travels with them. It is checked only where a state comes from
somebody else than its author, by who takes it and by who passes it on.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from swarmabs_core.declaration import setting
from swarmabs_core.messages import NEVER, PARENT, AgentState, Message, Messages, PlaneState
from swarmabs_core.parameters import SettingError
from swarmabs_core.realtime.base import UNKNOWN, Health, RealtimeBehaviour, Schedule, Sender
from swarmabs_core.realtime.relayed import plane_relay

if TYPE_CHECKING:
    from collections.abc import Iterator

_STATE = struct.Struct("<15sqHBBBdddd")
_PLANE = struct.Struct("<15sqqdd")


class Seals(Protocol):
    """The private key of one author, and the public keys of all."""

    def sign(self, content: bytes) -> bytes:
        """Return the author's signature, of `relayed.SIGNATURE` bytes."""
        ...

    def holds(self, author: int, content: bytes, signature: bytes) -> bool:
        """Return whether an author has signed a content; False for unknown authors and what is no signature."""
        ...


@dataclass(frozen=True, slots=True)
class SealFiles:
    """Files with the keys of a robot or of the plane in a sealed swarm."""

    key: str = setting("", "file of the private key with which it signs its states; '': unsealed", name="seal.key")
    keys: str = setting("", "file of the public keys of all robots and of the plane; with seal.key", name="seal.keys")

    def __post_init__(self) -> None:
        """Reject one file without the other."""
        for name, given, other in (("seal.key", self.key, self.keys), ("seal.keys", self.keys, self.key)):
            if other and not given:
                raise SettingError(name, "it is empty", "give both files, or none for an unsealed swarm")


def signed_content(message: AgentState | PlaneState, schedule: Schedule) -> bytes:
    """Return the bytes that the author of a state signs.

    They have the time at which its step begins, so a state of one step, period or epoch is none of another. They leave
    out what is not passed on: of a robot the stamp, the command and the step of the broadcasts that it follows.
    """
    begun = schedule.begin(message.step)
    if isinstance(message, PlaneState):
        return _PLANE.pack(b"swarmabs plane", begun, message.stamp, message.angle, message.angular_velocity)
    return _STATE.pack(
        b"swarmabs robot",
        begun,
        message.agent_id,
        message.kind,
        message.status,
        message.broadcast_step != NEVER,
        message.mass,
        message.damping,
        message.position,
        message.velocity,
    )


def author_of(message: AgentState | PlaneState) -> int:
    """Return the number of the author of a state."""
    return PARENT if isinstance(message, PlaneState) else message.agent_id


def author_name(author: int) -> str:
    """Return the author of a number as events and errors name it."""
    return f"robot {author}" if author else "the plane"


@dataclass(slots=True)
class _Kept:
    message: AgentState | PlaneState
    signature: bytes
    checked: bool


class Signatures:
    """The signatures of the states that a robot holds; without keys, all states count as signed with no bytes.

    Whoever is the author may send a state with a false signature to one robot. So that this robot is not taken for a
    forger, it checks a state before it passes it on.
    """

    def __init__(self, seals: Seals | None, schedule: Schedule) -> None:
        self._seals, self._schedule = seals, schedule
        self._kept: dict[int, _Kept] = {}
        self._refuted: list[int] = []

    @property
    def sealed(self) -> bool:
        """Whether states are signed."""
        return self._seals is not None

    def sign(self, message: AgentState | PlaneState) -> bytes:
        """Return the signature of an own state."""
        return b"" if self._seals is None else self._seals.sign(signed_content(message, self._schedule))

    def holds(self, message: AgentState | PlaneState, signature: bytes) -> bool:
        """Return whether a state is signed by its author."""
        if self._seals is None:
            return True
        return self._seals.holds(author_of(message), signed_content(message, self._schedule), signature)

    def keep(self, message: AgentState | PlaneState, signature: bytes, *, checked: bool) -> None:
        """Keep the signature of the newest state of an author; `checked` tells whether it is known to hold."""
        self._kept[author_of(message)] = _Kept(message, signature, checked or self._seals is None)

    def of(self, message: AgentState | PlaneState) -> bytes | None:
        """Return the signature of a kept state for passing it on; None if there is none that holds."""
        if self._seals is None:
            return b""
        author = author_of(message)
        kept = self._kept.get(author)
        if kept is None or kept.message is not message:  # an operator has removed the robot, or the clock was set back
            return None
        if not kept.checked:
            if not self.holds(message, kept.signature):
                self._refuted.append(author)
                del self._kept[author]
                return None
            kept.checked = True
        return kept.signature

    def refuted(self) -> Iterator[int]:
        """Yield, once, the authors whose own states have turned out not to be signed by them."""
        while self._refuted:
            yield self._refuted.pop(0)


def sealed_plane(plane: RealtimeBehaviour, seals: Seals | None, schedule: Schedule) -> RealtimeBehaviour:
    """Return the plane's node as it is in a sealed swarm: it also publishes its states with their signatures.

    Robots then pass these on. Without keys it is returned as it is.
    """
    return plane if seals is None else _SealedPlane(plane, seals, schedule)


class _SealedPlane:
    def __init__(self, plane: RealtimeBehaviour, seals: Seals, schedule: Schedule) -> None:
        self._plane, self._signatures = plane, Signatures(seals, schedule)

    def hear(self, message: Message, now: int, sender: Sender = UNKNOWN) -> Messages:
        """Let the node take a message."""
        return self._plane.hear(message, now, sender)

    def tick(self, now: int) -> Messages:
        """Return what the node says, and its states once more with their signatures."""
        said = self._plane.tick(now)
        return (
            *said,
            *(plane_relay(state, self._signatures.sign(state)) for state in said if isinstance(state, PlaneState)),
        )

    def halt(self) -> None:
        """Halt the node."""
        self._plane.halt()

    def health(self, now: int) -> Health:
        """Return the health of the node."""
        return self._plane.health(now)
