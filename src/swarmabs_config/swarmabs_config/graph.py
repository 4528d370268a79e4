"""The graph of the swarm: who publishes and who reads each topic, on what condition, and with what quality of service.

`GRAPH` is the only place that says so. The nodes' endpoints, the processes of a run and whom each of them waits for,
the recorder, the permissions under sros2, the simulation in one process, the virtual fleet and the tables of the
documentation follow from it.

Nothing relies on a quality of service for correctness: whoever waits too long repeats its last messages, whoever
receives ignores what it has. So the policies are free to be tuned by measurement. What was measured: positive
acknowledgements of the robots' state writers are what makes a reliable swarm slow, so these are best effort; the
broadcasts are offered reliable, for whoever else wants to listen. The nodes of a run read them best effort: a robot
that misses one asks again by repeating its own state, and what the recorder misses is repeated when the run has used
up the recorder's credit.

In real time the next message makes the one before worthless. The nodes read everything but events as best effort: a
reliable reader holds newer messages back until a lost one has been sent again, and then all of them are old. Reliable
is offered for recorders and tools. Whoever publishes every period asserts by this that it lives; events have no period
and so no lease. There is no deadline: what a message that is overdue leads to is decided by its age in the state
machines, where it has an event and a test.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Literal

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
from swarmabs_core.steering import STEERER

# Nodes, by the names that they have where none is remapped; every robot's node has a name of its own.
PLANE, PLANE_DRIVER, OBSERVER, CONTROLLER = "plane_sim", "plane_driver", "abstraction_observer", "parent_controller"
RECORDER, ROBOT = "recorder", "agent_node"


class Driver(Enum):
    """What makes the steps of the nodes."""

    LOCKSTEP = "lockstep"
    REALTIME = "realtime"


LOCKSTEP, REALTIME = Driver


@dataclass(frozen=True, slots=True)
class Node:
    """How a kind of node is started: its DDS participant id, or that of the first robot, and its module by driver."""

    participant: int
    modules: Mapping[Driver, str]


COORDINATORS = 8
"""Participant ids below belong to the coordinators: the nodes here but the robots, spares, and tools."""
FIRST_SPARE = 4

NODES = {
    PLANE: Node(0, {LOCKSTEP: "plane_sim.node", REALTIME: "plane_sim.realtime"}),
    PLANE_DRIVER: Node(0, {REALTIME: "plane_sim.driver"}),
    OBSERVER: Node(1, {LOCKSTEP: "abstraction_observer.node", REALTIME: "abstraction_observer.realtime"}),
    CONTROLLER: Node(2, {LOCKSTEP: "parent_controller.node", REALTIME: "parent_controller.realtime"}),
    RECORDER: Node(3, {LOCKSTEP: "swarmabs_bag.recorder.node", REALTIME: "swarmabs_bag.recorder.realtime"}),
    STEERER: Node(FIRST_SPARE, {LOCKSTEP: "swarmabs_run.steering.node"}),
    ROBOT: Node(COORDINATORS, {LOCKSTEP: "agent_node.node", REALTIME: "agent_node.realtime"}),
}
"""Every kind of node."""


def agent_name(agent_id: int) -> str:
    """Return the node name of a robot."""
    return f"agent_{agent_id:03d}"


class Option(Enum):
    """What a node may be asked for, on which some of its endpoints depend."""

    PACKED = "packed"
    """Robots hear the three broadcasts as one message."""
    STEERED = "steered"
    """Each step begins with what is ordered for it."""
    CREDITED = "credited"
    """The run is not ahead of its recorder by more than a window."""
    WATCHING = "watching"
    """The observer estimates the swarm's torque from the motion of the plane."""
    FEELING = "feeling"
    """The tilt of the plane acts on the robot's drive."""


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


@dataclass(frozen=True, slots=True)
class End:
    """A node at one end of a topic, under both drivers or one, only with or unless with an option.

    A reader has a `depth`, which may depend on the number of robots: how many messages wait for it before the oldest is
    lost. It may ask for retransmission, where the writer offers it.
    """

    node: str
    depth: int | Callable[[int], int] = 10
    reliable: bool = False
    driver: Driver | None = None
    only: Option | None = None
    unless: Option | None = None

    def holds(self, driver: Driver, options: frozenset[Option]) -> bool:
        """Tell whether there is this end under a driver, with these options."""
        return (
            self.driver in {None, driver}
            and (self.only is None or self.only in options)
            and (self.unless is None or self.unless not in options)
        )


@dataclass(frozen=True, slots=True)
class Link:
    """A topic with all its ends, and what its publishers offer; a driver that is missing has no such topic."""

    topic: Topic
    offered: Mapping[Driver, Qos]
    writers: tuple[End, ...]
    readers: tuple[End, ...]


@dataclass(frozen=True, slots=True)
class Endpoints:
    """What a node publishes, and what it reads with which quality of service requested."""

    publications: tuple[Topic, ...]
    subscriptions: Mapping[Topic, Qos]


RECORDING_STEPS = 100
RECORDING_MESSAGES = 20_000
"""How many steps, and how many states of robots, a recorded run may be ahead of what is on disk."""
SHORTEST_RECORDING_WINDOW = 4


def recording_window(robots: int) -> int:
    """Return how many steps a recorded run may be ahead of what is on disk: few where a step has many messages."""
    return max(SHORTEST_RECORDING_WINDOW, min(RECORDING_STEPS, RECORDING_MESSAGES // max(1, robots)))


LEASE = 0.5
"""Silence, s, after which the middleware takes a node to be dead: several age limits, so that it never decides."""
_RECORDED = 5000
"""Messages of a topic that may wait in real time: the recorder may stand still for seconds while the disk does."""


def _gathered(robots: int) -> int:
    """Return how many robots' states may wait where those of all robots are gathered."""
    return max(100, 4 * robots)


def _recorded(robots: int) -> int:
    """Return how many robots' states may wait for the recorder: what may be under way, and the step being recorded."""
    return max(1000, (recording_window(robots) + 1) * robots)


def _recorder(depth: int | Callable[[int], int] = 1000, *, reliable: bool = False) -> tuple[End, End]:
    """Return the recorder's ends; in lockstep acknowledgements would wake a thread of each writer several times."""
    return End(RECORDER, depth, reliable, LOCKSTEP), End(RECORDER, _RECORDED, reliable=True, driver=REALTIME)


def _both(lockstep: Qos, realtime: Qos) -> dict[Driver, Qos]:
    return {LOCKSTEP: lockstep, REALTIME: realtime}


_STATE = _both(Qos("reliable", 100), Qos("reliable", 10, lease=LEASE))

GRAPH = (
    Link(
        AGENT_STATE,
        _both(Qos("best_effort", 10), Qos("best_effort", 1, lease=LEASE)),
        (End(ROBOT),),
        (End(PLANE, _gathered), End(OBSERVER, _gathered), *_recorder(_recorded)),
    ),
    Link(
        PLANE_STATE,
        _STATE,
        (End(PLANE), End(PLANE_DRIVER)),
        (
            End(OBSERVER, only=Option.WATCHING),
            End(CONTROLLER),
            *_recorder(),
            End(STEERER),
            End(ROBOT, only=Option.FEELING),
        ),
    ),
    Link(
        ABSTRACT_STATE,
        _STATE,
        (End(OBSERVER),),
        (
            End(CONTROLLER, driver=LOCKSTEP, only=Option.PACKED),
            End(CONTROLLER, driver=REALTIME),
            *_recorder(),
            End(ROBOT, unless=Option.PACKED),
        ),
    ),
    Link(
        AUXILIARY_STATE,
        _STATE,
        (End(OBSERVER),),
        (End(CONTROLLER, only=Option.PACKED), *_recorder(), End(ROBOT, unless=Option.PACKED)),
    ),
    Link(
        DESIRED_ABSTRACT_STATE,
        _STATE,
        (End(CONTROLLER),),
        (*_recorder(), End(ROBOT, unless=Option.PACKED)),
    ),
    Link(
        EVENTS,
        _both(Qos("reliable", 1000, "transient_local"), Qos("reliable", 1000, "transient_local")),
        (End(PLANE), End(PLANE_DRIVER), End(OBSERVER), End(CONTROLLER), End(ROBOT)),
        (
            End(PLANE, 1000, reliable=True, driver=LOCKSTEP),
            End(OBSERVER, 1000, reliable=True, driver=REALTIME),
            *_recorder(reliable=True),
            End(STEERER, 1000, reliable=True),
        ),
    ),
    Link(
        RECORDING_PROGRESS,
        {LOCKSTEP: Qos("best_effort", 10)},
        (End(RECORDER),),
        (End(CONTROLLER, 1, only=Option.CREDITED),),
    ),
    Link(
        BROADCAST,
        {LOCKSTEP: Qos("best_effort", 10)},
        (End(CONTROLLER, only=Option.PACKED),),
        (End(ROBOT, only=Option.PACKED),),
    ),
    Link(
        BASIS,
        {REALTIME: Qos("reliable", 10)},
        (End(PLANE), End(OBSERVER), End(CONTROLLER)),
        _recorder(),
    ),
    Link(
        STEERING,
        {LOCKSTEP: Qos("reliable", 100)},
        (End(STEERER),),
        (
            End(PLANE, 100, only=Option.STEERED),
            End(OBSERVER, 100, only=Option.STEERED),
            End(CONTROLLER, 100, only=Option.STEERED),
            End(RECORDER, 1000, only=Option.STEERED),
            End(ROBOT, only=Option.STEERED),
        ),
    ),
)
"""Every topic of the swarm, in the order of `swarmabs_core.messages.TOPICS`."""

OFFERED = {driver: {link.topic: link.offered[driver] for link in GRAPH if driver in link.offered} for driver in Driver}
"""What the publishers of a topic offer, by driver."""

SERVICES = {CONTROLLER: ("swarm/stop", "swarm/reset"), ROBOT: ("~/leave", "~/join")}
"""An operator's commands in real time, by node."""

DIAGNOSTICS = "diagnostics"
"""Where nodes in real time say how they are, relative to the namespace: a swarm's own."""


def endpoints(node: str, driver: Driver, options: frozenset[Option] = frozenset(), *, robots: int = 0) -> Endpoints:
    """Return the endpoints of a node; the depths of what comes from all robots depend on how many ever take part."""
    links = [link for link in GRAPH if driver in link.offered]
    return Endpoints(
        tuple(link.topic for link in links if any(_is(end, node, driver, options) for end in link.writers)),
        {
            link.topic: requested(
                link.topic,
                driver,
                depth=end.depth if isinstance(end.depth, int) else end.depth(robots),
                reliable=end.reliable,
            )
            for link in links
            for end in link.readers
            if _is(end, node, driver, options)
        },
    )


def _is(end: End, node: str, driver: Driver, options: frozenset[Option]) -> bool:
    return end.node == node and end.holds(driver, options)


def requested(topic: Topic, driver: Driver = LOCKSTEP, *, depth: int, reliable: bool = False) -> Qos:
    """Return what a reader of a topic asks for: never more than is offered; retransmission if it is `reliable`."""
    offered = OFFERED[driver][topic]
    reliability = offered.reliability if reliable else "best_effort"
    return Qos(reliability, depth, offered.durability if reliability == "reliable" else "volatile")


def options_of(parameters: Mapping[str, object]) -> frozenset[Option]:
    """Return what a node is asked for by its parameters."""
    asked = {
        Option.PACKED: parameters.get("packed"),
        Option.STEERED: parameters.get("steered"),
        Option.CREDITED: parameters.get("recording_window"),
        Option.WATCHING: parameters.get("type") == "parent_response",
        Option.FEELING: parameters.get("feels_gravity") and parameters.get("kind") == "double_integrator",
    }
    return frozenset(option for option, given in asked.items() if given)


def writers(topic: Topic) -> tuple[str, ...]:
    """Return the nodes that publish a topic, under whatever driver and with whatever options."""
    return tuple(dict.fromkeys(end.node for link in GRAPH if link.topic is topic for end in link.writers))
