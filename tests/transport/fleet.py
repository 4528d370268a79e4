"""A fleet in real time without time: the real loop of each node, with clocks and a network of this process.

Everything that a fleet does to a swarm can be done here, as often as wanted and each time with the same result:
messages that are late, lost, twice or in another order, clocks that differ, nodes that die and come back.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from random import Random
from typing import Any, cast

from tests.transport.network import Inbox, Outbox

from swarmabs_config import configure as lockstep, realtime as configure
from swarmabs_config.graph import (
    CONTROLLER,
    OBSERVER,
    PLANE,
    REALTIME,
    ROBOT,
    STANDBY_SUFFIX,
    Endpoints,
    Option,
    endpoints,
    standby_name,
    usual_topic,
)
from swarmabs_config.scenario import Scenario
from swarmabs_core.cdr import decode, encode
from swarmabs_core.messages import PLANE_STATE, TOPIC_OF, AgentState, Message, Mode, SwarmEvent, Topic
from swarmabs_core.nodes import agent_name
from swarmabs_core.realtime.agent import RealtimeAgent, RealtimeAgentConfig
from swarmabs_core.realtime.base import AGENT_PHASE, CONTROLLER_PHASE, OBSERVER_PHASE, PLANE_PHASE, RealtimeBehaviour
from swarmabs_core.realtime.controller import RealtimeController, RealtimeControllerConfig
from swarmabs_core.realtime.drives import Body, Measurement, SimulatedDrive
from swarmabs_core.realtime.leadership import PRIMARY, SINGLE, STANDBY
from swarmabs_core.realtime.observer import RealtimeObserver
from swarmabs_core.realtime.peer import RealtimePeer, RealtimePeerConfig
from swarmabs_core.realtime.plane import RealtimePlane
from swarmabs_ros.realtime import Activity, Engine
from swarmabs_ros.timing import Reading, StepClock

_ROBOT = "agent_"
EPOCH = 1_700_000_000_000_000_000
"""A time of the clock, ns since 1970, as large as those of real clocks are."""


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

    def arrivals(self, sender: str, receiver: str, step: int, draw: Random) -> list[int]:
        """Return after which times (ns) a message of a step arrives; none if it is lost."""
        fades = bool(self.fading) and receiver.startswith(_ROBOT)
        faded = fades and Random(f"{receiver}:{step}").random() < self.fading
        lost = draw.random() < self.loss or faded
        copies = 2 if draw.random() < self.duplication else 1
        delay = self.delay + self.slow.get(sender, 0.0) + self.slow.get(receiver, 0.0)
        times = [round((delay + self.jitter * draw.random()) * 1e9) for _ in range(copies)]
        return [] if lost or sender in self.cut or receiver in self.cut else times


@dataclass(slots=True)
class _Node:
    name: str
    phase: float
    endpoints: Endpoints
    wakes: tuple[Topic, ...]
    make: Callable[[], RealtimeBehaviour]
    inbox: Inbox
    activity: Activity | None = None
    clock_offset: int = 0
    turn: int = 0
    paused: bool = False
    events: list[tuple[Topic, bytes]] = field(default_factory=list)


class _Body(SimulatedDrive):
    """A body that moves by the time of the world, whatever the clock of its node says."""

    def __init__(self, fleet: VirtualFleet, name: str, config: RealtimeAgentConfig, start: tuple[float, float]) -> None:
        body = (config.agent_id, config.kind, config.schedule, config.mass, config.damping)
        super().__init__(Body(*body, position=start[0], velocity=start[1]))
        self._fleet = fleet
        self._name = name

    def read(self, now: int) -> Measurement:
        """Move up to now, and tell where that leads, at the time of the node's clock."""
        return super().read(EPOCH + round(self._fleet.time * 1e9))._replace(stamp=now)


class VirtualFleet:
    """All nodes of a scenario, each with a clock of its own, and the network between them.

    Nodes that are `absent` are not there at the beginning. Nodes that are `prompt` hear each message when it
    arrives, and not only those that they answer at once. With `own_topics` robots publish on topics of their own.
    What was `published` is (time of the simulated clock in ns since its beginning, node, message). The bodies of the
    robots by id, `drives`, outlive their nodes.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        seed: int = 1,
        network: Network | None = None,
        absent: Iterable[str] = (),
        start_mode: Mode = Mode.RUN,
        prompt: bool = False,
        own_topics: bool = False,
        paired: bool = False,
    ) -> None:
        configure.check_realtime(scenario)
        self.network = network or Network()
        self.published: list[tuple[int, str, Message]] = []
        self._prompt = prompt
        self._draw = Random(f"virtual fleet:{seed}")
        self._clock = configure.schedule(scenario, EPOCH)
        self._now = 0
        self._sequence = 0
        self._queue: list[tuple[int, int, Callable[[], None]]] = []
        self._nodes: dict[str, _Node] = {}
        self.drives: dict[int, SimulatedDrive] = {}
        self._members = [agent.id for agent in scenario.agents]
        chosen = {Option.OWN_TOPICS: own_topics, Option.PAIRED: paired}
        self._options = frozenset(option for option, given in chosen.items() if given)
        clock = self._clock
        controller = configure.controller_config(scenario, clock, start_mode)
        law = partial(lockstep.parent_controller, scenario)
        observer = configure.observer_config(scenario, clock)
        self._add(PLANE, PLANE_PHASE, lambda: RealtimePlane(configure.plane_config(scenario, clock)))
        if scenario.decentralised:
            self._add_peers(scenario, controller)
            self._begin(absent)
            return
        for rank in (PRIMARY, STANDBY) if paired else (SINGLE,):
            pair = replace(observer.pair, rank=rank, paired=paired)
            observing, controlling = replace(observer, pair=pair), replace(controller, pair=pair)
            # Each host has its own memory.
            memory: dict[int, AgentState] = {}
            names = [standby_name(name) if rank == STANDBY else name for name in (OBSERVER, CONTROLLER)]
            self._add(names[0], OBSERVER_PHASE, partial(RealtimeObserver, observing, memory))
            self._add(names[1], CONTROLLER_PHASE, partial(RealtimeController, controlling, law), PLANE_STATE)
        for agent, usual in zip(scenario.agents, configure.agent_configs(scenario, clock), strict=True):
            config = replace(usual, paired=paired)
            drive = _Body(self, agent_name(agent.id), config, (agent.position, agent.velocity))
            self.drives[agent.id] = drive
            self._add(agent_name(agent.id), AGENT_PHASE, partial(RealtimeAgent, config, drive))
        self._begin(absent)

    def _add_peers(self, scenario: Scenario, law: RealtimeControllerConfig) -> None:
        """Add robots that sum up and control the swarm by themselves."""
        clock = self._clock
        observing = configure.observer_config(scenario, clock)
        for agent, robot in zip(scenario.agents, configure.agent_configs(scenario, clock), strict=True):
            name, config = agent_name(agent.id), configure.peer_config(scenario, clock, agent.id)
            drive = self.drives[agent.id] = _Body(self, name, robot, (agent.position, agent.velocity))
            ends = configure.peer_endpoints(config)
            wakes = (PLANE_STATE,) if config.senses else ()

            def make(
                config: RealtimePeerConfig = config, robot: RealtimeAgentConfig = robot, drive: _Body = drive
            ) -> RealtimePeer:
                observer, controller = RealtimeObserver(observing), RealtimeController(law, law.make_law)
                return RealtimePeer(config, observer, controller, RealtimeAgent(robot, drive))

            self._nodes[name] = _Node(name, AGENT_PHASE, ends, wakes, make, Inbox(ends.subscriptions))

    def _begin(self, absent: Iterable[str]) -> None:
        gone = set(absent)
        for node in self._nodes.values():
            if node.name not in gone:
                self.revive(node.name)

    def _add(self, name: str, phase: float, make: Callable[[], RealtimeBehaviour], *wakes: Topic) -> None:
        is_robot, standby = name.startswith(_ROBOT), name.endswith(STANDBY_SUFFIX)
        members = [int(name.removeprefix(_ROBOT))] if is_robot else self._members
        role, robots = ROBOT if is_robot else name.removesuffix(STANDBY_SUFFIX), len(self._members)
        options = self._options | ({Option.STANDBY} if standby else set())
        ends = endpoints(role, REALTIME, options, robots=robots, members=members)
        self._nodes[name] = _Node(name, phase, ends, wakes, make, Inbox(ends.subscriptions))

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self._nodes)

    @property
    def time(self) -> float:
        return self._now / 1e9

    def now(self, name: str) -> int:
        return EPOCH + self._now + self._nodes[name].clock_offset

    def activity(self, name: str) -> Activity:
        """Return what drives a node that lives."""
        activity = self._nodes[name].activity
        assert activity is not None
        return activity

    def kill(self, name: str) -> None:
        """End a node without a word; the body of a robot stops, as its base does when commands cease."""
        node = self._nodes[name]
        node.activity = None
        node.events.clear()
        if name.startswith(_ROBOT):
            self.drives[int(name.removeprefix(_ROBOT))].stop()

    def revive(self, name: str) -> None:
        """Start a node, anew if it was there before; one that lives goes on."""
        node = self._nodes[name]
        if node.activity is not None:
            return
        ends, clock = node.endpoints, StepClock(self._clock, node.phase)
        node.inbox = Inbox(ends.subscriptions)
        send = partial(self._publish, node)
        publishers = cast("Any", {usual_topic(topic): Outbox(topic, send) for topic in ends.publications})
        depths = {topic: qos.depth for topic, qos in ends.subscriptions.items()}
        engine = Engine(node.make(), clock, node.inbox, depths, publishers, node.wakes)
        node.activity = Activity(engine, lambda: Reading(self.now(name), self._now))
        node.activity.activate()
        self._pass(node)
        for topic, event in [event for other in self._nodes.values() for event in other.events]:
            if topic in ends.subscriptions:  # these are kept for those who come late
                self._arrive(node, topic, event)

    def pause(self, name: str) -> None:
        """Stop a node's process; what arrives waits for it."""
        self._nodes[name].paused = True

    def resume(self, name: str) -> None:
        """Let a node's process continue."""
        node = self._nodes[name]
        node.paused = False
        self._pass(node)

    def set_clock(self, name: str, offset: float) -> None:
        self._nodes[name].clock_offset = round(offset * 1e9)

    def call(self, name: str, command: str) -> None:
        """Give a node a command: stop, reset, leave, join or release; one that is not alive hears nothing."""
        activity = self._nodes[name].activity
        if activity is not None:
            behaviour = activity.engine.behaviour
            speaker = behaviour.voice if command == "release" else behaviour
            activity.command(getattr(speaker, command))

    def inject(self, message: Message, receivers: Iterable[str], topic: Topic | None = None) -> None:
        for name in receivers:
            self._arrive(self._nodes[name], topic or TOPIC_OF[type(message)], encode(message))

    def later(self, seconds: float, do: Callable[[], None]) -> None:
        self._at(self._now + round(seconds * 1e9), do)

    def run(self, seconds: float) -> None:
        end = self._now + round(seconds * 1e9)
        while self._queue and self._queue[0][0] <= end:
            self._now, _, action = heapq.heappop(self._queue)
            action()
        self._now = end

    def _at(self, time: int, action: Callable[[], None]) -> None:
        self._sequence += 1
        heapq.heappush(self._queue, (time, self._sequence, action))

    def _pass(self, node: _Node) -> None:
        """Let a node's loop do what is due; it goes on when it does not wait any longer, or is woken."""
        activity = cast("Activity", node.activity)
        while not (seconds := activity.advance()[1]):
            pass
        node.turn += 1
        turn = node.turn
        self._at(self._now + round(seconds * 1e9), lambda: self._waited(node, activity, turn))

    def _waited(self, node: _Node, activity: Activity, turn: int) -> None:
        if node.activity is activity and node.turn == turn and not node.paused:
            self._pass(node)

    def _publish(self, node: _Node, topic: Topic, data: bytes) -> None:
        message = decode(topic.message, data)
        self.published.append((self._now, node.name, message))
        if isinstance(message, SwarmEvent):
            node.events.append((topic, data))
        for other in self._nodes.values():
            if other is not node and topic in other.endpoints.subscriptions:
                for after in self.network.arrivals(node.name, other.name, message.step, self._draw):
                    self._at(self._now + after, lambda other=other: self._arrive(other, topic, data))  # type: ignore[misc]

    def _arrive(self, node: _Node, topic: Topic, data: bytes) -> None:
        """Let a message arrive; a node that is woken by it hears what else has come, too."""
        if node.activity is None:
            return
        node.inbox.put(topic, data)
        if node.paused:
            return
        if self._prompt:
            node.activity.wake()
        elif topic in node.wakes:
            node.activity.wake()
            self._pass(node)
