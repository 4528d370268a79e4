"""Quality of service of every topic, as data: one table for the nodes, the recorder and the bag's metadata.

Nothing here relies on a QoS for correctness: whoever waits too long repeats its last messages, whoever receives
ignores what it has. The table is therefore free to be tuned by measurement. What was measured: positive
acknowledgements of the robots' state writers are what makes a reliable swarm slow, so these are best effort; the
broadcasts are offered reliable, for whoever else wants to listen. The nodes of a run read them best effort: a robot
that misses one asks again by repeating its own state, and what the recorder misses is repeated when the run has used
up the recorder's credit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    AUXILIARY_STATE,
    BASIS,
    BROADCAST,
    DESIRED_ABSTRACT_STATE,
    EVENTS,
    PLANE_STATE,
    RECORDING_PROGRESS,
    STEERING,
    Topic,
)

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True, slots=True)
class Qos:
    """Offered or requested quality of service: the policies that differ between topics; history is KEEP_LAST.

    With `lease` (s) liveliness is MANUAL_BY_TOPIC: whoever does not publish for so long is taken to be dead. With 0
    there is none.
    """

    reliability: Literal["reliable", "best_effort"]
    depth: int
    durability: Literal["volatile", "transient_local"] = "volatile"
    lease: float = 0.0


OFFERED: dict[Topic, Qos] = {
    AGENT_STATE: Qos("best_effort", 10),
    PLANE_STATE: Qos("reliable", 100),
    ABSTRACT_STATE: Qos("reliable", 100),
    AUXILIARY_STATE: Qos("reliable", 100),
    DESIRED_ABSTRACT_STATE: Qos("reliable", 100),
    EVENTS: Qos("reliable", 1000, "transient_local"),
    RECORDING_PROGRESS: Qos("best_effort", 10),
    BROADCAST: Qos("best_effort", 10),
    BASIS: Qos("reliable", 100),
    STEERING: Qos("reliable", 100),
}
"""What the publishers of a topic offer."""

LEASE = 0.5
"""Silence, s, after which the middleware takes a node to be dead: several age limits, so that it never decides."""

REALTIME: dict[Topic, Qos] = {
    AGENT_STATE: Qos("best_effort", 1, lease=LEASE),
    PLANE_STATE: Qos("reliable", 10, lease=LEASE),
    ABSTRACT_STATE: Qos("reliable", 10, lease=LEASE),
    AUXILIARY_STATE: Qos("reliable", 10, lease=LEASE),
    DESIRED_ABSTRACT_STATE: Qos("reliable", 10, lease=LEASE),
    EVENTS: Qos("reliable", 1000, "transient_local"),
    BASIS: Qos("reliable", 10),
}
"""What is offered in real time, where the next message makes the one before worthless.

The nodes read everything but events as best effort: a reliable reader holds newer messages back until a lost one has
been sent again, and then all of them are old. Reliable is offered for recorders and tools. Whoever publishes every
period asserts by this that it lives; events have no period and so no lease. There is no deadline: what a message that
is overdue leads to is decided by its age in the state machines, where it has an event and a test.
"""


def requested(topic: Topic, *, depth: int, reliable: bool = False, offers: Mapping[Topic, Qos] = OFFERED) -> Qos:
    """Return what a reader of a topic asks for: never more than is offered.

    Parameters
    ----------
    topic : Topic
        Topic to read.
    depth : int
        How many messages wait for the reader before the oldest is lost.
    reliable : bool
        Whether to ask for retransmission, where the writer offers it.
    offers : mapping
        What the publishers offer: `OFFERED`, or `REALTIME`.
    """
    offered = offers[topic]
    reliability = offered.reliability if reliable else "best_effort"
    return Qos(reliability, depth, offered.durability if reliability == "reliable" else "volatile")
