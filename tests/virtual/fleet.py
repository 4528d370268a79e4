"""A fleet in real time without time: the real loop of each node, with clocks and a network of this process.

Everything that a fleet does to a swarm can be done here, as often as wanted and each time with the same result:
messages that are late, lost, twice or in another order, clocks that differ, nodes that die and come back.
"""

from __future__ import annotations

import heapq
from bisect import insort
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from hashlib import blake2b
from math import copysign, inf
from random import Random
from typing import Any, NamedTuple, Protocol, cast

from tests.transport.network import Outbox

from swarmabs_config import configure as lockstep, realtime as configure
from swarmabs_config.graph import (
    CONTROLLER,
    OBSERVER,
    PLANE,
    REALTIME,
    ROBOT,
    Endpoints,
    Option,
    endpoints,
    standby_name,
    usual_topic,
)
from swarmabs_config.scenario import Scenario
from swarmabs_core.cdr import decode as deserialize, encode
from swarmabs_core.messages import (
    PARENT,
    PLANE_STATE,
    TOPIC_OF,
    AgentState,
    Message,
    Mode,
    SwarmEvent,
    Topic,
    relay_topic,
)
from swarmabs_core.nodes import ROBOT_PREFIX, agent_name
from swarmabs_core.realtime.agent import RealtimeAgent, RealtimeAgentConfig
from swarmabs_core.realtime.base import (
    AGENT_PHASE,
    CONTROLLER_PHASE,
    OBSERVER_PHASE,
    PLANE_PHASE,
    RealtimeBehaviour,
)
from swarmabs_core.realtime.controller import RealtimeController
from swarmabs_core.realtime.drives import Body, Measurement, SimulatedDrive
from swarmabs_core.realtime.leadership import PRIMARY, SINGLE, STANDBY
from swarmabs_core.realtime.observer import RealtimeObserver
from swarmabs_core.realtime.peer import RealtimePeer, RealtimePeerConfig
from swarmabs_core.realtime.plane import RealtimePlane
from swarmabs_core.realtime.seals import Seals, sealed_plane
from swarmabs_ros.realtime import Activity, Engine
from swarmabs_ros.timing import Reading, StepClock

EPOCH = 1_700_000_000_000_000_000
"""A time of the clock, ns since 1970, as large as those of real clocks are."""
SHORTEST_SLEEP = 1000
"""Shortest time, ns, for which a node sleeps: a clock that drifts may wake it just before a step is due."""
_PARTICIPANT = 12

decode = lru_cache(maxsize=4096)(deserialize)
"""Deserializes a message once for all who hear it."""


@dataclass(slots=True)
class Network:
    """What happens to a message between two nodes.

    It is under way for `delay` and up to `jitter` more, s, which changes the order where it is more than the time
    between two messages. `loss` and `duplication` are probabilities; `fading` that of a robot hearing nothing of all
    that is sent in a period. Nodes that are `cut` neither send nor receive, but go on. What those in `slow` send and
    receive is under way for so much longer, s.
    """

    delay: float = 0.0005
    jitter: float = 0.0
    loss: float = 0.0
    duplication: float = 0.0
    fading: float = 0.0
    cut: set[str] = field(default_factory=set)
    slow: dict[str, float] = field(default_factory=dict)

    def arrivals(self, sender: str, receiver: str, step: int, draw: Random) -> Iterable[int]:
        """Return after which times (ns) a message of a step arrives; none if it is lost."""
        fades = bool(self.fading) and receiver.startswith(ROBOT_PREFIX)
        faded = fades and Random(f"{receiver}:{step}").random() < self.fading
        lost = draw.random() < self.loss or faded
        copies = 2 if draw.random() < self.duplication else 1
        delay = self.delay + self.slow.get(sender, 0.0) + self.slow.get(receiver, 0.0)
        times = [round((delay + self.jitter * draw.random()) * 1e9) for _ in range(copies)]
        return [] if lost or sender in self.cut or receiver in self.cut else times


class Transport(Protocol):
    """Decides what happens to messages; one that is `arrivals` of a `Network` or the like."""

    def arrivals(self, sender: str, receiver: str, step: int, draw: Random) -> Iterable[int]: ...


class Parcel(NamedTuple):
    """A message under way: who has sent it (empty: no node of the fleet), its topic, its bytes, the GID of its writer.

    `message` is what the bytes mean, None if nothing.
    """

    sender: str
    topic: Topic
    data: bytes
    writer: bytes
    message: Message | None = None


class Watcher:
    """Sees all that happens in a fleet; times are those of the fleet."""

    def begins(self, node: str) -> None:
        """A node starts, maybe not for the first time."""

    def ends(self, node: str) -> None:
        """A node dies."""

    def resumes(self, node: str) -> None:
        """A node is activated that was deactivated."""

    def published(self, node: str, topic: Topic, message: Message, data: bytes) -> None:
        """A node has published a message; the topic is the usual one."""

    def heard(self, node: str, parcel: Parcel) -> None:
        """A node takes a message that has arrived, and is about to handle it."""

    def told(self, node: str, command: str) -> None:
        """An operator has given a node a command."""


class Published(Watcher):
    """Keeps what is published, as (time of the fleet in ns, node, message)."""

    def __init__(self, fleet: VirtualFleet) -> None:
        self._fleet = fleet
        self.all: list[tuple[int, str, Message]] = []

    def published(self, node: str, topic: Topic, message: Message, data: bytes) -> None:
        self.all.append((self._fleet.now_ns, node, message))


class Arrivals:
    """The inbox of a node: it knows what is under way, and hands out what has arrived, of each topic the newest.

    That nothing has to happen when a message arrives makes a fleet fast.
    """

    def __init__(
        self,
        fleet: VirtualFleet,
        depths: Mapping[Topic, int],
        heard: Callable[[Parcel], None],
        before: Arrivals | None = None,
    ) -> None:
        self._fleet = fleet
        self._depths = depths
        # What is under way to a node that dies reaches the next one of its name.
        self._queues: dict[Topic, list[tuple[tuple[int, float], Parcel]]] = {
            topic: [] if before is None else before.under_way(topic) for topic in depths
        }
        self._writers: dict[Topic, bytes] = {}
        self._heard = heard

    def under_way(self, topic: Topic) -> list[tuple[tuple[int, float], Parcel]]:
        """Return what has not arrived."""
        return [item for item in self._queues[topic] if item[0] > self._fleet.moment]

    def put(self, topic: Topic, at: tuple[int, float], parcel: Parcel) -> None:
        """Let a parcel arrive at a moment, on a topic of the subscriptions."""
        queue = self._queues[topic]
        if queue and queue[-1][0] > at:
            insort(queue, (at, parcel), key=_moment)
        else:
            queue.append((at, parcel))

    def take(self, topic: Topic) -> bytes | None:
        """Return the bytes of the next message; those that have not had room are lost."""
        queue = self._queues[topic]
        moment = self._fleet.moment
        if not queue or queue[0][0] > moment:
            return None
        depth = self._depths[topic]
        while len(queue) > depth and queue[depth][0] <= moment:
            del queue[0]
        parcel = queue.pop(0)[1]
        self._writers[topic] = parcel.writer
        self._heard(parcel)
        return parcel.data

    def has(self, topics: Iterable[Topic]) -> bool:
        """Return whether a message of one of the topics has arrived."""
        moment = self._fleet.moment
        return any(queue and queue[0][0] <= moment for queue in map(self._queues.__getitem__, topics))

    def waiting(self) -> int:
        """Return how many messages are under way or have arrived."""
        return sum(map(len, self._queues.values()))

    def writer(self, topic: Topic) -> bytes:
        return self._writers[topic]

    def wait(self, topics: tuple[Topic, ...], timeout: float) -> bool:
        """Refuse: whoever drives the node waits."""
        raise AssertionError(f"a node waits by itself for {topics}, {timeout} s")

    def publisher_count(self, topic: Topic) -> int:
        return 1


def _moment(item: tuple[tuple[int, float], Parcel]) -> tuple[int, float]:
    return item[0]


@dataclass(slots=True)
class Node:
    """A node of a fleet, alive if it has an activity.

    `body` is the robot whose drive stops with the node, None for others. `started` counts its starts.
    """

    name: str
    phase: float
    endpoints: Endpoints
    wakes: tuple[Topic, ...]
    make: Callable[[], RealtimeBehaviour]
    body: int | None = None
    inbox: Arrivals | None = None
    activity: Activity | None = None
    clock_offset: int = 0
    drift: int = 0
    drifts_since: int = 0
    started: int = 0
    turn: int = 0
    paused: bool = False
    events: list[Parcel] = field(default_factory=list)
    readers: dict[Topic, list[Node]] = field(default_factory=dict)
    writers: dict[Topic, bytes] = field(default_factory=dict)


class SimulatedBody(SimulatedDrive):
    """A body that moves by the time of the world, whatever the clock of its node says, up to the ends of the plane.

    While it is `blind`, its sensor is silent. With a `watchdog` it stops when it gets no command for so many periods.
    """

    def __init__(
        self,
        time: Callable[[], int],
        config: RealtimeAgentConfig,
        start: tuple[float, float],
        watchdog: int | None = None,
    ) -> None:
        body = (config.agent_id, config.kind, config.schedule, config.mass, config.damping)
        super().__init__(Body(*body, position=start[0], velocity=start[1]))
        self._time = time
        self._period = config.schedule.period_ns
        self._end = 0.5 * config.plane_length
        self._watchdog = watchdog
        self._written = 0
        self._seen: Measurement | None = None
        self.blind = False

    @property
    def rests(self) -> bool:
        """Whether it has been stopped."""
        return self._command == self._velocity == 0.0

    def write(self, command: float, now: int) -> None:
        self._written = self._time()
        super().write(command, now)

    def read(self, now: int) -> Measurement:
        """Move up to now, and tell where that leads, at the time of the node's clock."""
        if self._watchdog is not None:
            stops = self._written + self._watchdog * self._period
            if stops < self._time():
                super().read(EPOCH + stops)
                self.stop()
        moved = super().read(EPOCH + self._time())
        if abs(moved.position) > self._end:
            self._position, self._velocity = copysign(self._end, moved.position), 0.0
            moved = moved._replace(position=self._position, velocity=0.0)
        if not self.blind or self._seen is None:
            self._seen = moved._replace(stamp=now)
        return self._seen


class VirtualFleet:
    """All nodes of a scenario, each with a clock of its own, and the network between them.

    Nodes that are `absent` are not there at the beginning. Nodes that are `prompt` hear each message when it
    arrives, and not only those that they answer at once. With `own_topics` robots publish on topics of their own.
    Writers have GIDs only if they are `identified`. Bodies have a `watchdog` of so many periods, or none. What was
    `published` is kept unless it is not `kept`: (time since the beginning in ns, node, message). The bodies of the
    robots by id, `drives`, outlive their nodes. Authors with `seals` sign their states. A node among the `liars`
    publishes what that makes of its messages.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        seed: int = 1,
        network: Transport | None = None,
        absent: Iterable[str] = (),
        start_mode: Mode = Mode.RUN,
        prompt: bool = False,
        own_topics: bool = False,
        paired: bool = False,
        identified: bool = False,
        watchdog: int | None = None,
        kept: bool = True,
        seals: Mapping[int, Seals] | None = None,
    ) -> None:
        configure.check_realtime(scenario)
        self.network: Any = network or Network()
        self.watchers: list[Watcher] = []
        self._told_published: list[Callable[[str, Topic, Message, bytes], None]] = []
        self._told_heard: list[Callable[[str, Parcel], None]] = []
        self._kept = Published(self)
        if kept:
            self.watch(self._kept)
        self.scenario = scenario
        self.clock = configure.schedule(scenario, EPOCH)
        self.now_ns = 0
        self.moment: tuple[int, float] = (0, inf)
        self.nodes: dict[str, Node] = {}
        self.drives: dict[int, SimulatedBody] = {}
        self.liars: dict[str, Callable[[Message], Message]] = {}
        self._seals = seals or {}
        self._prompt = prompt
        self._identified = identified
        self._watchdog = watchdog
        self._draw = Random(f"virtual fleet:{seed}")
        self._sequence = 0
        self._queue: list[tuple[int, int, Callable[..., None], tuple[Any, ...]]] = []
        chosen = {Option.OWN_TOPICS: own_topics, Option.PAIRED: paired, Option.SEALED: PARENT in self._seals}
        options = frozenset(option for option, given in chosen.items() if given)
        each_robot = configure.check_realtime(scenario).decentralised
        made = self._peers(start_mode) if each_robot else self._central(options, start_mode, paired=paired)
        for node in (self._plane(options), *made):
            self.nodes[node.name] = node
        for node in self.nodes.values():
            for topic in node.endpoints.publications:
                readers = [o for o in self.nodes.values() if o is not node and topic in o.endpoints.subscriptions]
                node.readers[topic] = readers
        gone = set(absent)
        for name in self.nodes:
            if name not in gone:
                self.revive(name)

    def _plane(self, options: frozenset[Option]) -> Node:
        config = configure.plane_config(configure.check_realtime(self.scenario), self.clock)
        seals = self._seals.get(PARENT)
        return self._node(
            PLANE, PLANE, PLANE_PHASE, lambda: sealed_plane(RealtimePlane(config), seals, self.clock), options=options
        )

    def _node(self, name: str, role: str, phase: float, make: Callable[[], RealtimeBehaviour], **more: Any) -> Node:
        """Return a node with the endpoints of its role; `options` are those of the graph."""
        robots, options = [agent.id for agent in self.scenario.agents], more.pop("options", frozenset())
        members = robots if more.get("body") is None else [more["body"]]
        ends = endpoints(role, REALTIME, options, robots=len(robots), members=members)
        return Node(name, phase, ends, more.pop("wakes", ()), make, **more)

    def _central(self, options: frozenset[Option], start_mode: Mode, *, paired: bool) -> Iterator[Node]:
        """Yield observer and parent controller, with standbys if they are paired, and the robots."""
        scenario, clock = configure.check_realtime(self.scenario), self.clock
        controller = configure.controller_config(scenario, clock, start_mode)
        law = partial(lockstep.parent_controller, scenario)
        observer = configure.observer_config(scenario, clock)
        for rank in (PRIMARY, STANDBY) if paired else (SINGLE,):
            pair = replace(observer.pair, rank=rank, paired=paired)
            observing, controlling = replace(observer, pair=pair), replace(controller, pair=pair)
            # Each host has its own memory.
            memory: dict[int, AgentState] = {}
            also = options | ({Option.STANDBY} if rank == STANDBY else set())
            names = [standby_name(name) if rank == STANDBY else name for name in (OBSERVER, CONTROLLER)]
            observes, answers = (
                partial(RealtimeObserver, observing, memory),
                partial(RealtimeController, controlling, law),
            )
            yield self._node(names[0], OBSERVER, OBSERVER_PHASE, observes, options=also)
            yield self._node(names[1], CONTROLLER, CONTROLLER_PHASE, answers, options=also, wakes=(PLANE_STATE,))
        for agent, usual in zip(scenario.agents, configure.agent_configs(scenario, clock), strict=True):
            config = replace(usual, paired=paired)
            moves = partial(RealtimeAgent, config, self._body(agent, config))
            yield self._node(agent_name(agent.id), ROBOT, AGENT_PHASE, moves, options=options, body=agent.id)

    def _peers(self, start_mode: Mode) -> Iterator[Node]:
        """Yield robots that sum up and control the swarm by themselves."""
        scenario, clock = configure.check_realtime(self.scenario), self.clock
        law = configure.controller_config(scenario, clock, start_mode)
        observing = configure.observer_config(scenario, clock)
        for agent, robot in zip(scenario.agents, configure.agent_configs(scenario, clock), strict=True):
            config, drive = configure.peer_config(scenario, clock, agent.id), self._body(agent, robot)
            seals = self._seals.get(agent.id)

            def make(
                config: RealtimePeerConfig = config,
                robot: RealtimeAgentConfig = robot,
                drive: SimulatedBody = drive,
                seals: Seals | None = seals,
            ) -> RealtimePeer:
                observer, controller = RealtimeObserver(observing), RealtimeController(law, law.make_law)
                return RealtimePeer(config, observer, controller, RealtimeAgent(robot, drive), seals)

            wakes = (PLANE_STATE if seals is None else relay_topic(PARENT),) if config.senses else ()
            ends = configure.peer_endpoints(config, frozenset() if seals is None else frozenset({Option.SEALED}))
            yield Node(agent_name(agent.id), AGENT_PHASE, ends, wakes, make, agent.id)

    def _body(self, agent: Any, config: RealtimeAgentConfig) -> SimulatedBody:
        start = (agent.position, agent.velocity)
        drive = self.drives[agent.id] = SimulatedBody(lambda: self.now_ns, config, start, self._watchdog)
        return drive

    @property
    def published(self) -> list[tuple[int, str, Message]]:
        return self._kept.all

    def watch(self, *watchers: Watcher) -> None:
        """Let watchers see what happens from now on, after those before them."""
        self.watchers += watchers
        self._told_published += [w.published for w in watchers if type(w).published is not Watcher.published]
        self._told_heard += [w.heard for w in watchers if type(w).heard is not Watcher.heard]

    @property
    def force_driven(self) -> set[str]:
        """The robots whose command is a force."""
        return {agent_name(agent.id) for agent in self.scenario.agents if agent.kind == "double_integrator"}

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.nodes)

    @property
    def time(self) -> float:
        return self.now_ns / 1e9

    def now(self, name: str) -> int:
        """Return what the clock of a node shows, ns since 1970."""
        return self._clock_of(self.nodes[name])

    def _clock_of(self, node: Node) -> int:
        drifted = node.drift * (self.now_ns - node.drifts_since) // 1_000_000 if node.drift else 0
        return EPOCH + self.now_ns + node.clock_offset + drifted

    def activity(self, name: str) -> Activity:
        """Return what drives a node that lives."""
        activity = self.nodes[name].activity
        assert activity is not None
        return activity

    def kill(self, name: str) -> None:
        """End a node without a word; the body of a robot stops, as its base does when commands cease."""
        node = self.nodes[name]
        if node.activity is None:
            return
        node.activity = None
        node.events.clear()
        if node.body is not None:
            self.drives[node.body].stop()
        for watcher in self.watchers:
            watcher.ends(name)

    def revive(self, name: str) -> None:
        """Start a node, anew if it was there before; one that lives goes on."""
        node = self.nodes[name]
        if node.activity is not None:
            return
        node.started += 1
        node.paused = False
        ends, clock = node.endpoints, StepClock(self.clock, node.phase)
        depths = {topic: qos.depth for topic, qos in ends.subscriptions.items()}
        node.inbox = Arrivals(self, depths, partial(self._taken, node), node.inbox)
        send = partial(self._publish, node)
        publishers = cast("Any", {usual_topic(topic): Outbox(topic, send) for topic in ends.publications})
        node.writers = {topic: self._gid(node, topic) for topic in ends.publications}
        engine = Engine(node.make(), clock, cast("Any", node.inbox), depths, publishers, node.wakes, decode)
        for watcher in self.watchers:
            watcher.begins(name)
        node.activity = Activity(engine, lambda: Reading(self._clock_of(node), self.now_ns))
        node.activity.activate()
        self._pass(node)
        for parcel in [event for other in self.nodes.values() for event in other.events]:
            if parcel.topic in ends.subscriptions:  # these are kept for those who come late
                self._send(parcel, node, 0)

    def _gid(self, node: Node, topic: Topic) -> bytes:
        if not self._identified:
            return b""
        process, writer = f"{node.name}:{node.started}", f"{node.name}:{node.started}:{topic.name}"
        return (
            blake2b(process.encode(), digest_size=_PARTICIPANT).digest()
            + blake2b(writer.encode(), digest_size=4).digest()
        )

    def pause(self, name: str) -> None:
        """Stop a node's process; what arrives waits for it."""
        self.nodes[name].paused = True

    def resume(self, name: str) -> None:
        """Let a node's process continue."""
        node = self.nodes[name]
        if node.activity is None or not node.paused:
            return
        node.paused = False
        if not node.activity.active:
            return
        if cast("Arrivals", node.inbox).has(node.wakes):
            node.activity.wake()
        self._pass(node)

    def deactivate(self, name: str) -> None:
        """Deactivate a node, as its lifecycle does: it halts, hears and says nothing."""
        node = self.nodes[name]
        if node.activity is not None:
            node.activity.deactivate()
            node.turn += 1

    def activate(self, name: str) -> None:
        """Activate a node that was deactivated; it begins anew with what it knows."""
        node = self.nodes[name]
        if node.activity is None or node.activity.active:
            return
        for watcher in self.watchers:
            watcher.resumes(name)
        node.activity.activate()
        if not node.paused:
            self._pass(node)

    def set_clock(self, name: str, offset: float) -> None:
        """Set by how much (s) a node's clock is ahead."""
        self.nodes[name].clock_offset = round(offset * 1e9)
        self.nodes[name].drift = 0

    def set_drift(self, name: str, millionths: int) -> None:
        """Let a node's clock run too fast from now on, by so many millionths."""
        node = self.nodes[name]
        node.clock_offset = self._clock_of(node) - EPOCH - self.now_ns
        node.drift, node.drifts_since = millionths, self.now_ns

    def call(self, name: str, command: str) -> bool:
        """Give a node a command: stop, reset, leave, join or release; tell whether it is there to hear it."""
        node = self.nodes[name]
        if node.activity is None or node.paused or not node.activity.active:
            return False
        for watcher in self.watchers:
            watcher.told(name, command)
        behaviour: Any = node.activity.engine.behaviour
        node.activity.command(getattr(behaviour.voice if command == "release" else behaviour, command))
        return True

    def inject(self, message: Message, receivers: Iterable[str], topic: Topic | None = None) -> None:
        self.deliver(Parcel("", topic or TOPIC_OF[type(message)], encode(message), b"", message), receivers)

    def deliver(self, parcel: Parcel, receivers: Iterable[str]) -> None:
        """Let a message arrive at once at those who read its topic."""
        for name in receivers:
            node = self.nodes[name]
            if node.activity is not None and parcel.topic in node.endpoints.subscriptions:
                self._send(parcel, node, 0)

    def later(self, seconds: float, do: Callable[[], object]) -> None:
        self._at(self.now_ns + round(seconds * 1e9), do)

    def run(self, seconds: float) -> None:
        self.run_until(self.now_ns + round(seconds * 1e9))

    def run_until(self, end: int) -> None:
        """Let all happen up to a time, ns."""
        queue, pop = self._queue, heapq.heappop
        while queue and queue[0][0] <= end:
            self.now_ns, sequence, action, arguments = pop(queue)
            self.moment = (self.now_ns, sequence)
            action(*arguments)
        self.now_ns = end
        self.moment = (end, inf)

    def _at(self, time: int, action: Callable[..., object], *arguments: Any) -> None:
        self._sequence += 1
        heapq.heappush(self._queue, (time, self._sequence, cast("Any", action), arguments))

    def _pass(self, node: Node) -> None:
        """Let a node's loop do what is due; it goes on when it does not wait any longer, or is woken."""
        activity = cast("Activity", node.activity)
        while not (seconds := activity.advance()[1]):
            pass
        node.turn += 1
        self._at(self.now_ns + max(SHORTEST_SLEEP, round(seconds * 1e9)), self._waited, node, activity, node.turn)

    def _waited(self, node: Node, activity: Activity, turn: int) -> None:
        if node.activity is activity and node.turn == turn and not node.paused:
            self._pass(node)

    def _publish(self, node: Node, topic: Topic, data: bytes) -> None:
        message = decode(topic.message, data)
        if lie := self.liars.get(node.name):
            message = lie(message)
            data = encode(message)
        parcel, usual = Parcel(node.name, topic, data, node.writers[topic], message), usual_topic(topic)
        for published in self._told_published:
            published(node.name, usual, message, data)
        if isinstance(message, SwarmEvent):
            node.events.append(parcel)
        arrivals, sender, step, draw = self.network.arrivals, node.name, message.step, self._draw
        send = self._send
        for other in node.readers[topic]:
            for after in arrivals(sender, other.name, step, draw):
                send(parcel, other, after)

    def _send(self, parcel: Parcel, node: Node, after: int) -> None:
        """Let a parcel arrive at a node after some time, ns."""
        inbox, topic, time = node.inbox, parcel.topic, self.now_ns + after
        if node.activity is None or inbox is None:  # it may live again when the parcel arrives
            if after:
                self._at(time, self._send, parcel, node, 0)
            return
        self._sequence += 1
        inbox.put(topic, (time, self._sequence), parcel)
        if self._prompt or topic in node.wakes:
            heapq.heappush(self._queue, (time, self._sequence, self._arrived, (node, topic)))

    def _arrived(self, node: Node, topic: Topic) -> None:
        """Wake a node that goes on with a message of a topic."""
        if node.activity is None or node.paused or not node.activity.active:
            return
        node.activity.wake()
        if topic in node.wakes:
            self._pass(node)

    def _taken(self, node: Node, parcel: Parcel) -> None:
        if node.activity is None or not (node.activity.active or isinstance(parcel.message, SwarmEvent)):
            return  # what is outdated at the start is thrown away, but events are not
        for heard in self._told_heard:
            heard(node.name, parcel)
