"""Events in words, as logs, summaries, reports and the page show them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.messages import EventKind, said
from swarmabs_core.steering import DISTURBANCE, REFERENCE

if TYPE_CHECKING:
    from swarmabs_core.messages import SwarmEvent

NO_BROADCASTS = "no complete broadcasts yet"
"""Detail of the safe stop in which a robot begins in real time."""
NO_FOLLOWER = "no robot follows the law yet"
"""Begin of the detail with which a robot is held until another one follows the law."""


def said_event(event: SwarmEvent) -> str:
    """Return what an event reports, without its value and detail; the number of a kind that is not known.

    A planned or requested change of the disturbance or the reference has the name of what changes, and a robot that has
    not been able to move yet waits.
    """
    try:
        kind = EventKind(event.kind)
    except ValueError:
        return f"event {event.kind}"
    if named(event):
        return event.detail
    if (kind is EventKind.SAFE_STOP and event.detail == NO_BROADCASTS) or (
        kind is EventKind.HELD and event.detail.startswith(NO_FOLLOWER)
    ):
        return "waits to start"
    return said(kind)


def named(event: SwarmEvent) -> bool:
    """Return whether `said_event` returns the detail of an event."""
    return event.kind == EventKind.STEERING and event.detail in {REFERENCE, DISTURBANCE}
