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
from typing import Literal

from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    AUXILIARY_STATE,
    BROADCAST,
    DESIRED_ABSTRACT_STATE,
    EVENTS,
    PLANE_STATE,
    RECORDING_PROGRESS,
    Topic,
)


@dataclass(frozen=True, slots=True)
class Qos:
    """Offered or requested quality of service: the policies that differ between topics; history is KEEP_LAST."""

    reliability: Literal["reliable", "best_effort"]
    depth: int
    durability: Literal["volatile", "transient_local"] = "volatile"


OFFERED: dict[Topic, Qos] = {
    AGENT_STATE: Qos("best_effort", 10),
    PLANE_STATE: Qos("reliable", 100),
    ABSTRACT_STATE: Qos("reliable", 100),
    AUXILIARY_STATE: Qos("reliable", 100),
    DESIRED_ABSTRACT_STATE: Qos("reliable", 100),
    EVENTS: Qos("reliable", 1000, "transient_local"),
    RECORDING_PROGRESS: Qos("best_effort", 10),
    BROADCAST: Qos("best_effort", 10),
}
"""What the publishers of a topic offer."""


def requested(topic: Topic, *, depth: int, reliable: bool = False) -> Qos:
    """Return what a reader of a topic asks for: never more than is offered.

    Parameters
    ----------
    topic : Topic
        Topic to read.
    depth : int
        How many messages wait for the reader before the oldest is lost.
    reliable : bool
        Whether to ask for retransmission, where the writer offers it.
    """
    offered = OFFERED[topic]
    reliability = offered.reliability if reliable else "best_effort"
    return Qos(reliability, depth, offered.durability if reliability == "reliable" else "volatile")
