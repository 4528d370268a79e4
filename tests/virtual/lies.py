"""What intruders and lying robots tell robots without coordinators, and the keys by which these find that out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from hashlib import blake2b
from math import nan

import numpy as np
from tests.virtual.schedule import Case

from swarmabs_core.messages import PARENT, Kind, Message, PlaneState, Relay, Status
from swarmabs_core.realtime.controller import LawView
from swarmabs_core.realtime.modes import Orders
from swarmabs_core.realtime.relayed import SIGNATURE, Constants, Motion, Told, plane_relay, read, written

SHIFT = 0.01
"""By how much lies about positions (m) and the plane (rad) are wrong."""


class VirtualSeals:
    """The keys of one author in a fleet of which nobody knows those of others; as `Seals`, and cheap."""

    def __init__(self, author: int) -> None:
        self._author = author

    def sign(self, content: bytes) -> bytes:
        return _signature(self._author, content)

    def holds(self, author: int, content: bytes, signature: bytes) -> bool:
        return signature == _signature(author, content)


def _signature(author: int, content: bytes) -> bytes:
    return blake2b(content, key=author.to_bytes(2, "big"), digest_size=SIGNATURE).digest()


def falsified(how: int, robots: tuple[str, ...], message: Message) -> Message:
    """Return a relay with what others have not said: moved (1), of a later step (2), or of the plane (3)."""
    if not isinstance(message, Relay) or message.agent_id == PARENT:
        return message
    told, own = read(message, len(robots)), message.agent_id - 1
    if how == 3 and told.plane is not None:
        plane = told.plane._replace(step=told.plane.step + 1, angle=told.plane.angle + SHIFT)
        told = replace(told, plane=plane)
    else:
        change = {"position": SHIFT} if how == 1 else {"age": -1}
        told = replace(told, motions=[_changed(m, change) if m.rank != own else m for m in told.motions])
    return message._replace(content=written(message.step, told, len(robots)))


def _changed(motion: Motion, change: dict[str, float]) -> Motion:
    return motion._replace(**{name: getattr(motion, name) + by for name, by in change.items()})


def forged_relays(kind: str, author: int, step: int, case: Case) -> Iterator[Relay]:
    """Yield what an intruder says in the name of a robot, or of the plane."""
    signature = bytes(SIGNATURE * case.sealed)
    if author == PARENT:
        if kind in {"future", "impostor"}:
            yield plane_relay(PlaneState(0, step + 10**6 * (kind == "future"), 0.1, 0.0), signature)
        return
    constants = Constants(Kind.DOUBLE_INTEGRATOR, 0.3, 0.6)
    motion = Motion(author - 1, Status.ACTIVE, 0, constants.tag, 0.05, 0.0, signature)
    everything = np.full(case.robots, step)
    told = Told(
        Orders(),
        LawView(),
        (-1, 0),
        step,
        None,
        everything,
        constants={author - 1: constants},
        motions=[motion],
        sealed=case.sealed,
    )
    if kind == "nonsense":
        told = replace(told, law=LawView(step, step, (nan,)))
    content = written(step, told, case.robots)
    relay = Relay(0, step, author, 0, 0, 0, content[:-3] if kind == "garbage" else content)
    yield relay._replace(step=step + 10**6 * (kind == "future"), agent_id=author + 99 * (kind == "stranger"))
