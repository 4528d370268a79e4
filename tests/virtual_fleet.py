"""A fleet in real time without time: nodes, clocks and network as events in the order of a simulated clock.

Everything that a fleet does to a swarm can be done here, as often as wanted and each time with the same result:
messages that are late, lost, twice or in another order, clocks that differ, nodes that die and come back.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field
from random import Random
from typing import TYPE_CHECKING

from swarmabs_config import configure as lockstep, realtime as configure
from swarmabs_config.graph import CONTROLLER, OBSERVER, PLANE, REALTIME, ROBOT, agent_name, endpoints
from swarmabs_core.messages import EVENTS, TOPIC_OF, Mode
from swarmabs_core.realtime.agent import RealtimeAgent, RealtimeAgentConfig
from swarmabs_core.realtime.base import AGENT_PHASE, CONTROLLER_PHASE, OBSERVER_PHASE, PLANE_PHASE
from swarmabs_core.realtime.controller import RealtimeController
from swarmabs_core.realtime.drives import Body, Measurement, SimulatedDrive
from swarmabs_core.realtime.observer import RealtimeObserver
from swarmabs_core.realtime.plane import RealtimePlane

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import AgentState, Message, Messages, Topic
    from swarmabs_core.realtime.base import RealtimeBehaviour

_ROBOT = "agent_"
EPOCH = 1_700_000_000_000_000_000
"""A time of the clock, ns since 1970, as large as those of real clocks are."""


@dataclass(slots=True)
class Network:
    """What happens to a message between two nodes.

    Parameters
    ----------
    delay : float
        Shortest time under way, s.
    jitter : float
        Largest additional time, drawn evenly, s; more than the time between two messages changes their order.
    loss : float
        Probability of being lost.
    duplication : float
        Probability of arriving twice.
    fading : float
        Probability that a robot hears nothing of all that is sent in a period.
    cut : set of str
        Nodes that neither send nor receive, but go on.
    """

    delay: float = 0.0005
    jitter: float = 0.0
    loss: float = 0.0
    duplication: float = 0.0
    fading: float = 0.0
    cut: set[str] = field(default_factory=set)

    def arrivals(self, sender: str, receiver: str, step: int, draw: Random) -> list[int]:
        """Return after which times (ns) a message of a step arrives; none if it is lost."""
        faded = receiver.startswith(_ROBOT) and Random(f"{receiver}:{step}").random() < self.fading
        lost = draw.random() < self.loss or faded
        copies = 2 if draw.random() < self.duplication else 1
        times = [round((self.delay + self.jitter * draw.random()) * 1e9) for _ in range(copies)]
        return [] if lost or sender in self.cut or receiver in self.cut else times


@dataclass(slots=True)
class _Node:
    """A process of the fleet."""

    name: str
    phase: float
    listens: frozenset[Topic]
    make: Callable[[], RealtimeBehaviour]
    behaviour: RealtimeBehaviour | None
    clock_offset: int = 0
    life: int = 0
    events: list[Message] = field(default_factory=list)


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

    Parameters
    ----------
    scenario : Scenario
        The scenario; what only exists in lockstep is refused.
    seed : int
        Seed of what the network does.
    network : Network, optional
        What happens to messages; may be changed at any time.
    absent : iterable of str
        Nodes that are not there at the beginning.
    start_mode : Mode
        What the parent controller begins with.

    Attributes
    ----------
    network : Network
        What happens to messages from now on.
    published : list
        All that was published, as (time of the simulated clock in ns since its beginning, node, message).
    drives : dict
        Bodies of the robots by id; they outlive their nodes.

    Raises
    ------
    InputError
        If the scenario asks for what there is in lockstep only.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        seed: int = 1,
        network: Network | None = None,
        absent: Iterable[str] = (),
        start_mode: Mode = Mode.RUN,
    ) -> None:
        configure.check_realtime(scenario)
        self.network = network or Network()
        self.published: list[tuple[int, str, Message]] = []
        self._draw = Random(f"virtual fleet:{seed}")
        self._clock = configure.schedule(scenario, EPOCH)
        self._now = 0
        self._sequence = 0
        self._queue: list[tuple[int, int, Callable[[], None]]] = []
        self._nodes: dict[str, _Node] = {}
        self._memory: dict[int, AgentState] = {}
        self.drives: dict[int, SimulatedDrive] = {}
        self._add_coordinators(scenario, start_mode)
        self._add_robots(scenario)
        gone = set(absent)
        for node in self._nodes.values():
            if node.name not in gone:
                self.revive(node.name)

    def _add_coordinators(self, scenario: Scenario, start_mode: Mode) -> None:
        clock = self._clock
        controller = configure.controller_config(scenario, clock, start_mode)
        self._add(PLANE, PLANE_PHASE, lambda: RealtimePlane(configure.plane_config(scenario, clock)))
        self._add(
            OBSERVER,
            OBSERVER_PHASE,
            lambda: RealtimeObserver(configure.observer_config(scenario, clock), self._memory),
        )
        self._add(
            CONTROLLER,
            CONTROLLER_PHASE,
            lambda: RealtimeController(controller, lambda: lockstep.parent_controller(scenario)),
        )

    def _add_robots(self, scenario: Scenario) -> None:
        for agent, config in zip(scenario.agents, configure.agent_configs(scenario, self._clock), strict=True):
            drive = _Body(self, agent_name(agent.id), config, (agent.position, agent.velocity))
            self.drives[agent.id] = drive
            self._add(
                agent_name(agent.id),
                AGENT_PHASE,
                lambda config=config, drive=drive: RealtimeAgent(config, drive),  # type: ignore[misc]
            )

    def _add(self, name: str, phase: float, make: Callable[[], RealtimeBehaviour]) -> None:
        heard = endpoints(ROBOT if name.startswith(_ROBOT) else name, REALTIME).subscriptions
        self._nodes[name] = _Node(name, phase, frozenset(heard), make, None)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all nodes, coordinators first."""
        return tuple(self._nodes)

    @property
    def time(self) -> float:
        """Time of the simulated clock since its beginning, s."""
        return self._now / 1e9

    def now(self, name: str) -> int:
        """Return the time by a node's own clock, ns since 1970."""
        return EPOCH + self._now + self._nodes[name].clock_offset

    def node(self, name: str) -> RealtimeBehaviour:
        """Return the state machine of a node that is alive."""
        behaviour = self._nodes[name].behaviour
        if behaviour is None:
            raise KeyError(f"{name} is not alive")
        return behaviour

    def alive(self, name: str) -> bool:
        """Tell whether a node is alive."""
        return self._nodes[name].behaviour is not None

    def kill(self, name: str) -> None:
        """End a node without a word; the body of a robot stops, as its base does when commands cease."""
        node = self._nodes[name]
        node.behaviour = None
        node.life += 1
        node.events.clear()
        if name.startswith(_ROBOT):
            self.drives[int(name.removeprefix(_ROBOT))].stop()

    def revive(self, name: str) -> None:
        """Start a node, anew if it was there before; one that lives goes on."""
        node = self._nodes[name]
        if node.behaviour is None:
            node.behaviour = node.make()
            self._schedule_tick(node)
            if EVENTS in node.listens:  # these are kept for those who come late
                for event in [event for other in self._nodes.values() for event in other.events]:
                    self._hear(node, event)

    def set_clock(self, name: str, offset: float) -> None:
        """Let a node's clock be ahead by so much, s."""
        self._nodes[name].clock_offset = round(offset * 1e9)

    def call(self, name: str, action: Callable[[RealtimeBehaviour, int], Messages]) -> None:
        """Do something with a node that is alive, and publish what it answers."""
        self._publish(self._nodes[name], action(self.node(name), self.now(name)))

    def inject(self, message: Message, receivers: Iterable[str]) -> None:
        """Let nodes hear a message that none of the fleet has sent."""
        for name in receivers:
            self._hear(self._nodes[name], message)

    def run(self, seconds: float) -> None:
        """Let the fleet go on for so long, s."""
        end = self._now + round(seconds * 1e9)
        while self._queue and self._queue[0][0] <= end:
            self._now, _, action = heapq.heappop(self._queue)
            action()
        self._now = end

    def _at(self, time: int, action: Callable[[], None]) -> None:
        self._sequence += 1
        heapq.heappush(self._queue, (time, self._sequence, action))

    def _schedule_tick(self, node: _Node) -> None:
        """Let a node tick at the next time at which its own clock says so."""
        local = EPOCH + self._now + node.clock_offset
        step = self._clock.step(local - round(node.phase * self._clock.period_ns)) + 1
        life = node.life
        self._at(
            max(self._now, self._clock.begin(step, node.phase) - node.clock_offset - EPOCH),
            lambda: self._tick(node, life),
        )

    def _tick(self, node: _Node, life: int) -> None:
        if node.behaviour is None or node.life != life:
            return
        self._publish(node, node.behaviour.tick(self.now(node.name)))
        self._schedule_tick(node)

    def _publish(self, node: _Node, messages: Messages) -> None:
        for message in messages:
            self.published.append((self._now, node.name, message))
            if TOPIC_OF[type(message)] is EVENTS:
                node.events.append(message)
            for other in self._nodes.values():
                if other is not node and TOPIC_OF[type(message)] in other.listens:
                    for after in self.network.arrivals(node.name, other.name, message.step, self._draw):
                        self._at(self._now + after, lambda other=other, message=message: self._hear(other, message))  # type: ignore[misc]

    def _hear(self, node: _Node, message: Message) -> None:
        if node.behaviour is not None:
            self._publish(node, node.behaviour.hear(message, self.now(node.name)))
