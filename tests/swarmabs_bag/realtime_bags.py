"""Bags of virtual fleets, written as the recorder writes them."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from tests.swarmabs_core.realtime.bags import Stored, world
from tests.virtual.fleet import EPOCH

from swarmabs_bag.realtime_world import RealtimeWorld
from swarmabs_bag.recorder.recording import RealtimeRecording
from swarmabs_config import realtime as configure
from swarmabs_config.configure import members
from swarmabs_core.messages import NEVER, AgentState, Basis, Message, SwarmEvent
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.record import Record

Change = Callable[[Stored], Iterable[Message]]


def realtime_bag(
    folder: Path, name: str = "quiet", *, since_1970: bool = False, change: Change | None = None, **differs: Any
) -> Path:
    """Write the bag of a world; `differs` is what is different about its `RealtimeWorld`.

    Steps may count since 1970, as in a fleet whose file gives no epoch, and what is recorded may be changed.
    """
    recorded = world(name)
    clock = configure.schedule(recorded.scenario, EPOCH)
    if since_1970:
        clock = Schedule(clock.period_ns)
    simulated = replace(RealtimeWorld(clock, members(recorded.scenario), plane=True), **differs)
    recording = RealtimeRecording(recorded.scenario, folder, simulated)
    for stored in recorded.bag:
        for message in (stored.message,) if change is None else change(stored):
            kept = later(message, EPOCH // clock.period_ns) if since_1970 else message
            recording.add(Record.of(kept), stored.time)
    recording.close()
    return folder


def later(message: Any, steps: int) -> Message:
    """Return a message in which every step is later."""
    fields = {AgentState: ("step", "broadcast_step"), Basis: ("step", "since", "begun"), SwarmEvent: ("step",)}
    names = fields.get(type(message), ("step",))
    changes: dict[str, Any] = {n: getattr(message, n) + steps for n in names if getattr(message, n) != NEVER}
    if isinstance(message, Basis):
        changes["state_steps"] = tuple(step + steps for step in message.state_steps)
    changed: Message = message._replace(**changes)
    return changed
