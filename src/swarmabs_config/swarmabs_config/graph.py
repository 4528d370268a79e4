"""The graph of the swarm: publishers and readers of each topic, their conditions, and the quality of service.

`GRAPH` is the single source. The nodes' endpoints, the processes of a run and the peers each of them waits for, the
recorder, the permissions under sros2, the simulation in one process, the virtual fleet and the tables of the
documentation follow from it.

Correctness never depends on a quality of service: a node that waits too long repeats its last messages, and a receiver
ignores messages that it already has. The policies can therefore be tuned by measurement. Measurements show that
positive acknowledgements of the robots' state writers slow a reliable swarm down, so these writers are best effort. The
broadcasts are offered as reliable for other listeners. The nodes of a run read them as best effort: a robot that misses
one asks for it by repeating its own state, and messages that the recorder misses are repeated when the run has used up
the recorder's credit.

In real time each message makes the previous one obsolete. Nodes read everything except events as best effort: a
reliable reader holds newer messages back until a lost one has been resent, and then all of them are old. Reliable
delivery is offered for recorders and tools. A periodic publisher asserts its liveliness by publishing; events are not
periodic and have no lease. There are no deadlines: the state machines decide by age how to react to an overdue message,
with an event and a test for each case.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import Literal

from swarmabs_core import pair_role
from swarmabs_core.membership import ALWAYS
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    AUXILIARY_STATE,
    BASIS,
    BROADCAST,
    CONTROLLER_NODE,
    DESIRED_ABSTRACT_STATE,
    EVENTS,
    OBSERVER_NODE,
    PARENT,
    PARENT_STATE,
    PLANE_FAMILY,
    PLANE_STATE,
    RECORDER_NODE,
    RECORDING_PROGRESS,
    RELAY,
    REMOVALS,
    ROBOT_STATE,
    STANDING,
    STEERING,
    SWARM_ABSTRACT,
    SWARM_AUXILIARY,
    SWARM_BROADCAST,
    SWARM_DESIRED,
    SWARM_STATES,
    SYSTEM,
    TOPIC_OF,
    Topic,
    relay_topic,
)
from swarmabs_core.nodes import agent_name
from swarmabs_core.realtime import leadership
from swarmabs_core.steering import STEERER

# Default names of the nodes; each robot's node has its own name (`agent_name`), and so have standbys (`standby_name`).
PLANE = PLANE_FAMILY.node  # under another parent system its process has the name of that family
PLANE_DRIVER, OBSERVER, CONTROLLER = "plane_driver", OBSERVER_NODE, CONTROLLER_NODE
RECORDER, ROBOT = RECORDER_NODE, "agent_node"
PEER = "peer_node"
"""A robot that sums up and controls the swarm by itself, or several of them in one process."""


class Driver(Enum):
    """What drives the steps of the nodes."""

    LOCKSTEP = "lockstep"
    REALTIME = "realtime"


LOCKSTEP, REALTIME = Driver


@dataclass(frozen=True, slots=True)
class Node:
    """How a kind of node is started: its module by driver, and its DDS participant id, or that of the first robot.

    Without an id of its own, a node has one behind those of the robots.
    """

    participant: int | None
    modules: Mapping[Driver, str]


COORDINATORS = 8
"""Participant ids below this one belong to coordinators, and from `FIRST_TOOL` on to tools, which take a free one."""
FIRST_TOOL = 4

NODES = {
    PLANE: Node(0, {LOCKSTEP: "plane_sim.node", REALTIME: "plane_sim.realtime"}),
    PLANE_DRIVER: Node(0, {REALTIME: "plane_sim.driver"}),
    OBSERVER: Node(1, {LOCKSTEP: "abstraction_observer.node", REALTIME: "abstraction_observer.realtime"}),
    CONTROLLER: Node(2, {LOCKSTEP: "parent_controller.node", REALTIME: "parent_controller.realtime"}),
    RECORDER: Node(3, {LOCKSTEP: "swarmabs_bag.recorder.node", REALTIME: "swarmabs_bag.recorder.realtime"}),
    STEERER: Node(None, {LOCKSTEP: "swarmabs_run.steering.node"}),
    ROBOT: Node(COORDINATORS, {LOCKSTEP: "agent_node.node", REALTIME: "agent_node.realtime"}),
    PEER: Node(COORDINATORS, {LOCKSTEP: "agent_node.group", REALTIME: "agent_node.realtime_peer"}),
}
"""Every kind of node."""


STANDBY_SUFFIX = pair_role.STANDBY_SUFFIX


def standby_name(node: str) -> str:
    """Return the node name of a coordinator's standby."""
    return f"{node}{STANDBY_SUFFIX}"


class Option(Enum):
    """An option of a node that adds or removes endpoints."""

    PACKED = "packed"
    """Robots receive the three broadcasts in one message, plane and recorder the states of all robots."""
    STEERED = "steered"
    """Each step begins with the steering message for it."""
    CREDITED = "credited"
    """The run is never ahead of its recorder by more than a window."""
    WATCHING = "watching"
    """The observer estimates the swarm's torque from the motion of the plane."""
    FEELING = "feeling"
    """The tilt of the plane acts on the robot's drive."""
    CHANGING = "changing"
    """Robots may join, end or be dropped."""
    SYSTEM = "system"
    """The parent system is not the plane."""
    PAIRED = "paired"
    """In real time some coordinator has a standby: what standbys publish is read too."""
    STANDBY = "standby"
    """In real time this coordinator is a standby: it publishes on topics of its own."""
    SENSING = "sensing"
    """Among robots that sum up the swarm by themselves, this one hears the parent's state."""
    SEALED = "sealed"
    """In real time states are signed: the plane's node publishes them with their signatures, too, and such robots read
    them there."""
    OWN_TOPICS = "own topics"
    """In real time each robot publishes on topics below its own name, so that permissions can tell robots apart."""


@dataclass(frozen=True, slots=True)
class Qos:
    """Offered or requested quality of service: the policies that differ between topics; history is KEEP_LAST.

    With a `lease` (s), liveliness is MANUAL_BY_TOPIC: a writer that has not published for that long is considered dead.
    0 means no lease.
    """

    reliability: Literal["reliable", "best_effort"]
    depth: int
    durability: Literal["volatile", "transient_local"] = "volatile"
    lease: float = 0.0


@dataclass(frozen=True, slots=True)
class End:
    """A node at one end of a topic, under one driver or both, possibly only with or only without an option.

    The `depth` of a reader is the number of messages that wait for it before the oldest is lost; it may depend on the
    number of robots. A reader may request retransmission if the writer offers it. A reader of its `peer` is one of a
    pair of coordinators and reads only what the other one publishes; a reader `of_robots` needs only what robots
    publish.
    """

    node: str
    depth: int | Callable[[int], int] = 10
    reliable: bool = False
    driver: Driver | None = None
    only: Option | None = None
    unless: Option | None = None
    peer: bool = False
    of_robots: bool = False

    def holds(self, driver: Driver, options: frozenset[Option]) -> bool:
        """Tell whether this end exists under a driver with these options."""
        return (
            self.driver in {None, driver}
            and (self.only is None or self.only in options)
            and (self.unless is None or self.unless not in options)
        )


@dataclass(frozen=True, slots=True)
class Link:
    """A topic with all its ends and what its publishers offer, by driver; a missing driver does not have the topic.

    `system` is the topic that takes its place if the parent system is not the plane; None if there is none. `own` is
    the name below that of a robot's node on which the robot publishes with `Option.OWN_TOPICS`; empty if there is none.
    """

    topic: Topic
    offered: Mapping[Driver, Qos]
    writers: tuple[End, ...]
    readers: tuple[End, ...]
    system: Topic | None = None
    own: str = ""

    def topic_with(self, options: frozenset[Option]) -> Topic | None:
        """Return the topic with these options, None if there is none."""
        return self.system if Option.SYSTEM in options else self.topic

    @property
    def topics(self) -> tuple[Topic, ...]:
        """The topics with any options."""
        return (self.topic,) if self.system in {None, self.topic} else (self.topic, self.system)


@dataclass(frozen=True, slots=True)
class Endpoints:
    """The topics that a node publishes, and those it reads with the requested quality of service."""

    publications: tuple[Topic, ...]
    subscriptions: Mapping[Topic, Qos]


RECORDING_STEPS = 100
RECORDING_MESSAGES = 20_000
"""How many steps, and how many messages of robots, a recorded run may be ahead of the bag on disk."""
SHORTEST_RECORDING_WINDOW = 4


SILENCE = 3.0
"""Age, s, from which the last report of a node no longer tells of it; nodes report once a second."""
KEPT_STEPS = 128
"""Largest number of steps that a receiver keeps and a sender repeats: a run is less ahead of its recorder."""


_RELAYED_ROUNDS = 9
"""Relays of a robot in a step that the recorder must be able to take."""


def recording_window(robots: int, *, relayed: bool = False) -> int:
    """Return how many steps a recorded run may be ahead of the bag on disk: fewer if a step has many messages."""
    messages = max(1, robots) * (1 + _RELAYED_ROUNDS * relayed)
    return max(SHORTEST_RECORDING_WINDOW, min(RECORDING_STEPS, RECORDING_MESSAGES // messages))


LEASE = 0.5
"""Silence, s, after which the middleware considers a node dead: several age limits, which therefore act first."""
_RECORDED = 5000
"""Messages of a topic that may wait in real time: a slow disk may block the recorder for seconds."""


def _gathered(robots: int) -> int:
    """Return how many robot states may wait for a node that gathers those of all robots."""
    return max(100, 4 * robots)


def _recorded(robots: int) -> int:
    """Return how many robot states may wait for the recorder: those of the window, and of the step being recorded."""
    return max(1000, (recording_window(robots) + 1) * robots)


def _recorder(
    depth: int | Callable[[int], int] = 1000, *, reliable: bool = False, unless: Option | None = None
) -> tuple[End, End]:
    """Return the recorder's ends; in lockstep, acknowledgements would wake a thread of each writer several times."""
    lockstep = End(RECORDER, depth, reliable, LOCKSTEP, unless=unless)
    return lockstep, End(RECORDER, _RECORDED, reliable=True, driver=REALTIME, unless=unless)


def _peer(node: str) -> End:
    """Return the end at which a coordinator reads what the other one of its pair publishes."""
    return End(node, driver=REALTIME, only=Option.PAIRED, peer=True)


def _both(lockstep: Qos, realtime: Qos) -> dict[Driver, Qos]:
    return {LOCKSTEP: lockstep, REALTIME: realtime}


_STATE = _both(Qos("reliable", 100), Qos("reliable", 10, lease=LEASE))

GRAPH = (
    Link(
        AGENT_STATE,
        _both(Qos("best_effort", 10), Qos("best_effort", 1, lease=LEASE)),
        (End(ROBOT), End(PEER)),
        (
            End(PLANE, _gathered, unless=Option.PACKED),
            End(OBSERVER, _gathered),
            *_recorder(_recorded, unless=Option.PACKED),
        ),
        system=ROBOT_STATE,
        own="state",
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
            End(PEER, only=Option.SENSING, unless=Option.SEALED),
        ),
        system=PARENT_STATE,
    ),
    Link(
        ABSTRACT_STATE,
        _STATE,
        (End(OBSERVER), End(PEER)),
        (
            End(CONTROLLER, driver=LOCKSTEP, only=Option.PACKED),
            End(CONTROLLER, driver=REALTIME),
            _peer(OBSERVER),
            *_recorder(),
            End(ROBOT, unless=Option.PACKED),
        ),
        system=SWARM_ABSTRACT,
    ),
    Link(
        AUXILIARY_STATE,
        _STATE,
        (End(OBSERVER), End(PEER)),
        (
            End(CONTROLLER, only=Option.PACKED),
            *_recorder(),
            End(ROBOT, unless=Option.PACKED),
        ),
        system=SWARM_AUXILIARY,
    ),
    Link(
        DESIRED_ABSTRACT_STATE,
        _STATE,
        (End(CONTROLLER), End(PEER)),
        (_peer(CONTROLLER), *_recorder(), End(ROBOT, unless=Option.PACKED)),
        system=SWARM_DESIRED,
    ),
    Link(
        EVENTS,
        _both(Qos("reliable", 1000, "transient_local"), Qos("reliable", 1000, "transient_local")),
        (End(PLANE), End(PLANE_DRIVER), End(OBSERVER), End(CONTROLLER), End(ROBOT), End(PEER)),
        (
            End(PLANE, 1000, reliable=True, driver=LOCKSTEP),
            End(OBSERVER, 1000, reliable=True, driver=REALTIME, of_robots=True),
            *_recorder(reliable=True),
            End(STEERER, 1000, reliable=True),
        ),
        system=EVENTS,
        own="events",
    ),
    Link(
        RECORDING_PROGRESS,
        {LOCKSTEP: Qos("best_effort", 10)},
        (End(RECORDER),),
        (End(CONTROLLER, 1, only=Option.CREDITED), End(PEER, 1)),
        system=RECORDING_PROGRESS,
    ),
    Link(
        BROADCAST,
        {LOCKSTEP: Qos("best_effort", 10)},
        (End(CONTROLLER, only=Option.PACKED),),
        (End(ROBOT, only=Option.PACKED), End(RECORDER, 1000, only=Option.PACKED)),
        system=SWARM_BROADCAST,
    ),
    Link(
        SWARM_STATES,
        {LOCKSTEP: Qos("best_effort", 10)},
        (End(OBSERVER, only=Option.PACKED),),
        (End(PLANE, only=Option.PACKED), End(RECORDER, 1000, only=Option.PACKED)),
        system=SWARM_STATES,
    ),
    Link(
        BASIS,
        {REALTIME: Qos("reliable", 10)},
        (End(PLANE), End(OBSERVER), End(CONTROLLER)),
        (_peer(CONTROLLER), *_recorder()),
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
            End(PEER, 100, only=Option.STEERED),
        ),
        system=STEERING,
    ),
    Link(
        SYSTEM,
        {LOCKSTEP: Qos("reliable", 1, "transient_local")},
        (End(PLANE, only=Option.SYSTEM),),
        (End(RECORDER, 10, reliable=True, only=Option.SYSTEM),),
        system=SYSTEM,
    ),
    Link(
        REMOVALS,
        {REALTIME: Qos("reliable", 100, "transient_local")},
        (End(OBSERVER), End(PEER)),
        (End(OBSERVER, 100, reliable=True), End(PEER, 100, reliable=True), *_recorder(reliable=True)),
    ),
    Link(
        STANDING,
        _STATE,
        (
            End(OBSERVER, driver=LOCKSTEP, only=Option.CHANGING),
            End(OBSERVER, driver=REALTIME),
            End(PEER, driver=LOCKSTEP, only=Option.CHANGING),
            End(PEER, driver=REALTIME),
        ),
        (
            End(CONTROLLER, driver=LOCKSTEP, only=Option.CHANGING),
            End(CONTROLLER, driver=REALTIME),
            End(RECORDER, 1000, driver=LOCKSTEP, only=Option.CHANGING),
            End(RECORDER, _RECORDED, reliable=True, driver=REALTIME),
        ),
        system=STANDING,
    ),
    Link(
        RELAY,
        _both(Qos("best_effort", 100), Qos("best_effort", 1, lease=LEASE)),
        (
            End(PEER),
            End(PLANE, driver=REALTIME, only=Option.SEALED),
            End(PLANE_DRIVER, driver=REALTIME, only=Option.SEALED),
        ),
        (End(PEER, 100, driver=LOCKSTEP), End(PEER, 10, driver=REALTIME), *_recorder()),
        system=RELAY,
    ),
)
"""Every topic of the swarm, in the order of `swarmabs_core.messages.TOPICS`."""

OWN = {link.topic: link.own for link in GRAPH if link.own}
"""The names of robots' own topics below the names of their nodes, by the usual topic."""


@cache
def own_topic(topic: Topic, agent_id: int) -> Topic:
    """Return the robot's own topic that takes the place of one of those in `OWN`."""
    return Topic(f"{agent_name(agent_id)}/{OWN[topic]}", topic.message, topic.ros_type, agent_id)


_STANDBY = "standby/"
STANDBY_TOPICS = {
    topic: Topic(f"{_STANDBY}{topic.name}", topic.message, topic.ros_type)
    for topic in (ABSTRACT_STATE, AUXILIARY_STATE, STANDING, DESIRED_ABSTRACT_STATE, BASIS)
}
"""The topics on which a standby coordinator publishes in real time, by the usual topic. Events have no second one."""
USUAL_TOPICS = {standby: topic for topic, standby in STANDBY_TOPICS.items()}
"""The usual topics by those of standbys."""


def standby_topic(topic: Topic) -> Topic:
    """Return the topic on which a standby coordinator publishes, given the usual one."""
    return STANDBY_TOPICS.get(topic, topic)


def usual_topic(topic: Topic) -> Topic:
    """Return the topic whose place one of a standby coordinator, or of a robot, takes; any other one unchanged."""
    return TOPIC_OF[topic.message]


OFFERED = {
    driver: {topic: link.offered[driver] for link in GRAPH if driver in link.offered for topic in link.topics}
    for driver in Driver
}
"""What the publishers of a topic offer, by driver."""
OFFERED[REALTIME] |= {standby: OFFERED[REALTIME][topic] for topic, standby in STANDBY_TOPICS.items()}

RELEASE = "~/release"
"""The service by which one of a pair of coordinators hands over to the other one."""
SERVICES = {
    OBSERVER: (RELEASE,),
    CONTROLLER: ("swarm/stop", "swarm/reset", RELEASE),
    ROBOT: ("~/leave", "~/join"),
    PEER: ("~/leave", "~/join", "~/stop", "~/reset"),
}
"""The services for operators in real time, by node. Only one of a pair of coordinators offers `RELEASE`."""


def services(node: str, options: frozenset[Option] = frozenset()) -> tuple[str, ...]:
    """Return the services of a node with these options; those of a standby, too, have names of their own."""
    names = SERVICES.get(node, ())
    if Option.STANDBY not in options:
        return names
    return tuple(map(standby_service, names))


def standby_service(name: str) -> str:
    """Return the name at a standby of a service; those below the name of a node are its own anyway."""
    return name if name.startswith("~/") else f"{_STANDBY}{name}"


DIAGNOSTICS = "diagnostics"
"""Topic on which real-time nodes report their health, relative to the swarm's namespace."""


def endpoints(
    node: str,
    driver: Driver,
    options: frozenset[Option] = frozenset(),
    *,
    robots: int = 0,
    members: Collection[int] = (),
    neighbours: Collection[int] = (),
) -> Endpoints:
    """Return the endpoints of a node; some depths depend on the number of robots that ever take part.

    `members` are the robots whose own topics it uses with `Option.OWN_TOPICS`: all members, or for a robot only itself.
    A `PEER` publishes the relays of `members`, and reads those of `neighbours`, as the recorder does; with
    `Option.SEALED` also that of the plane, if it hears the plane.
    """
    if driver is not REALTIME:
        options -= _REALTIME_ONLY
    relaying = members if node == PEER else (PARENT,)
    heard = (*neighbours, PARENT) if options >= {Option.SENSING, Option.SEALED} and node == PEER else neighbours
    named = ((link.topic_with(options), link) for link in GRAPH if driver in link.offered)
    links = [(topic, link) for topic, link in named if topic is not None]
    return Endpoints(
        tuple(
            written
            for topic, link in links
            for end in link.writers
            if _is(end, node, driver, options)
            for written in (map(relay_topic, relaying) if topic is RELAY else _written(topic, end, options, members))
        ),
        {
            read: requested(read, driver, depth=_depth(end, 1 if read.agent_id else robots), reliable=end.reliable)
            for topic, link in links
            for end in link.readers
            if _is(end, node, driver, options)
            for read in (map(relay_topic, heard) if topic is RELAY else _read(topic, link, end, options, members))
        },
    )


_REALTIME_ONLY = frozenset({Option.PAIRED, Option.STANDBY, Option.OWN_TOPICS, Option.SEALED})


def _depth(end: End, robots: int) -> int:
    return end.depth if isinstance(end.depth, int) else end.depth(robots)


def _written(topic: Topic, end: End, options: frozenset[Option], members: Collection[int]) -> tuple[Topic, ...]:
    """Return the topics that are written at an end: the usual one, a robot's own, or that of standbys."""
    if end.node in {ROBOT, PEER} and Option.OWN_TOPICS in options and topic in OWN:
        return tuple(own_topic(topic, member) for member in members)
    return (standby_topic(topic) if Option.STANDBY in options else topic,)


def _read(
    topic: Topic, link: Link, end: End, options: frozenset[Option], members: Collection[int]
) -> tuple[Topic, ...]:
    """Return the topics that are read at an end: the usual one, those of robots or of standbys, or several of them."""
    if Option.OWN_TOPICS in options and topic in OWN:
        shared = not end.of_robots and any(writer.node not in {ROBOT, PEER} for writer in link.writers)
        return (*((topic,) if shared else ()), *(own_topic(topic, member) for member in members))
    if Option.PAIRED not in options:
        return (topic,)
    if end.peer:
        return (topic if Option.STANDBY in options else standby_topic(topic),)
    return tuple(dict.fromkeys((topic, standby_topic(topic))))


def _is(end: End, node: str, driver: Driver, options: frozenset[Option]) -> bool:
    return end.node == node and end.holds(driver, options)


def requested(topic: Topic, driver: Driver = LOCKSTEP, *, depth: int, reliable: bool = False) -> Qos:
    """Return the QoS that a reader of a topic requests: never more than is offered, retransmission if `reliable`."""
    offered = OFFERED[driver][usual_topic(topic)]
    reliability = offered.reliability if reliable else "best_effort"
    return Qos(reliability, depth, offered.durability if reliability == "reliable" else "volatile")


def options_of(parameters: Mapping[str, object]) -> frozenset[Option]:
    """Return the options that a node's parameters select."""
    asked = {
        Option.PACKED: parameters.get("packed"),
        Option.STEERED: parameters.get("steered"),
        Option.CREDITED: parameters.get("recording_window"),
        Option.WATCHING: parameters.get("type") == "parent_response",
        Option.FEELING: parameters.get("feels_gravity") and parameters.get("kind") == "double_integrator",
        Option.CHANGING: parameters.get("schedule")
        or parameters.get("steered")
        or parameters.get("division") == ALWAYS,
        Option.SYSTEM: "system.type" in parameters,
        Option.OWN_TOPICS: parameters.get("own_topics"),
        Option.SEALED: parameters.get("seal.key"),
        Option.PAIRED: parameters.get("paired") or parameters.get("pair", "single") != "single",
        Option.STANDBY: parameters.get("pair") == leadership.STANDBY,
    }
    return frozenset(option for option, given in asked.items() if given)


def writers(topic: Topic) -> tuple[str, ...]:
    """Return the nodes that publish a topic under any driver, with any options."""
    return tuple(dict.fromkeys(end.node for link in GRAPH if topic in link.topics for end in link.writers))
