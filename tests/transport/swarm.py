"""A swarm in lockstep on a transport in this process: real nodes, real loops, no clock but the scheduler's."""

import importlib
from collections import Counter
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

from tests.swarmabs_ros.nodes import settings_from
from tests.transport.network import Act, Inbox, Outbox, Reports, Script, turns

from agent_node.group import peers
from swarmabs_bag.recorder.node import Recorder
from swarmabs_bag.run.step import Step
from swarmabs_bag.run_folder import RunFolder
from swarmabs_config import configure
from swarmabs_config.graph import LOCKSTEP, OFFERED, RECORDER, ROBOT, Endpoints, usual_topic
from swarmabs_config.scenario import Scenario
from swarmabs_core.behaviours import SteeringController
from swarmabs_core.messages import Topic
from swarmabs_core.steering import STEERER
from swarmabs_ros.announcements import send_events
from swarmabs_ros.lockstep import Lockstep, NodeSpec, RunningClock, Wait
from swarmabs_ros.runner import Settings
from swarmabs_ros.settings import LockstepSettings
from swarmabs_run.orchestration.plan import ProcessPlan, plan
from swarmabs_run.run import DEFAULTS, RunOptions
from swarmabs_run.steering.node import steering_config

AGENTS = (
    "{id: 1, kind: single_integrator, mass: 0.5, position: 0.2}",
    "{id: 2, kind: double_integrator, mass: 0.4, damping: 0.6, position: -0.2}",
    "{id: 3, kind: double_integrator, mass: 0.3, damping: 0.7, position: 0.1}",
)
FROZEN = 0.7
"""Time, s, for which a node stands still that is frozen, or begins later: others repeat themselves meanwhile."""
SHORTEST = 1e-6
"""Time, s, that every wait takes at least: one of no length would never end."""
BUFFERED = 60
"""Messages that reach a node while it is frozen; the kernel has no room for more."""
LONGEST_RUN = 120.0
"""Time, s, by the swarm's clock after which a run that has not ended hangs."""


class Role(NamedTuple):
    """A node before it is made: its name, what its process is told, and the robots in it."""

    name: str
    make: Callable[[Reports], NodeSpec]
    endpoints: Endpoints
    settings: Settings
    agents: tuple[int, ...]


class Cast:
    """All nodes of a run, as its plan says, to be made as often as wanted: the parameters are checked once."""

    def __init__(
        self,
        scenario: Scenario,
        options: RunOptions = DEFAULTS,
        changed: Mapping[str, Mapping[str, object]] | None = None,
    ) -> None:
        self.scenario = scenario
        self.packed, self.steered = options.packed, options.steered
        processes = plan(scenario, RunFolder(Path("/nowhere")), options)
        self.roles = [self._role(process, (changed or {}).get(process.name, {})) for process in processes]

    def _role(self, process: ProcessPlan, changed: Mapping[str, object]) -> Role:
        module = importlib.import_module(process.module)
        given = {name: value for name, value in (process.parameters | dict(changed)).items() if value != []}
        settings = settings_from(module.PARAMETERS, **cast("Any", given))
        scenario, robots = self.scenario, tuple(process.agents)
        if robots and scenario.decentralised:
            ends = configure.peer_endpoints(scenario, robots, steered=self.steered)
        else:
            name, also = ROBOT if robots else process.name, configure.options_for(scenario)
            relaying = configure.relaying(scenario)
            ends = settings.endpoints(name, LOCKSTEP, *also, robots=len(scenario.agents), neighbours=relaying)
        return Role(process.name, partial(module.make, settings), ends, settings, robots)


@dataclass(slots=True)
class Node:
    name: str
    role: Role
    reports: Reports
    loop: Lockstep
    spec: NodeSpec
    inbox: Inbox
    activity: Generator[Wait, bool | None, None]
    begun: bool = False
    alive: bool = True
    ended: bool = False
    buffered: int = 0
    waits: Wait | None = None
    deadline: float = 0.0
    frozen_until: float = 0.0


class Parcel(NamedTuple):
    sender: Node
    receiver: Node
    topic: Topic
    data: bytes
    reliable: bool


class Swarm:
    """Nodes, clock, network and scheduler.

    Usually the first node goes on that can; if none can, the oldest message under way arrives; if there is none, time
    passes until a node goes on by itself. A script says where something else happens. What is reliable is not lost,
    not doubled, and keeps its order.

    `now` is the time, s, since the beginning, `published` how often which node has published which bytes on which
    topic, `problems` why which node has failed, and `steerer` what an operator asks in a run that is steered.
    """

    def __init__(self, cast_: Cast, script: Script = []) -> None:  # noqa: B006 - it is not changed
        self.now = 0.0
        self.turn = 0
        self.published: Counter[tuple[str, Topic, bytes]] = Counter()
        self.problems: dict[str, Exception] = {}
        self.recorded: list[Step] = []
        self.steerer = SteeringController(steering_config(cast_.scenario))
        self._under_way: list[Parcel] = []
        self._script = turns(script)
        self._history: list[tuple[Node, Topic, bytes]] = []
        self._readers: dict[Topic, list[tuple[Node, bool]]] = {}
        self.nodes = {role.name: self._node(role, cast_) for role in cast_.roles}
        self._ready = dict(self.nodes)

    def _node(self, role: Role, cast_: Cast) -> Node:
        reports = Reports()
        if role.name == RECORDER:
            recording = cast("Any", SimpleNamespace(add=self._record, offset=lambda *_: None))
            behaviour = Recorder(
                cast_.scenario,
                recording,
                lambda _: None,
                packed=cast_.packed,
                steered=cast_.steered,
                on_events=partial(send_events, cast("Any", reports), "recorded"),
            )
            spec = NodeSpec(
                behaviour,
                lingers=False,
                gather=behaviour.gathering,
                hear_all=behaviour.hear_all,
                compares=True,
            )
        elif role.name == STEERER:
            spec = NodeSpec(self.steerer, on_idle=lambda _: self.steerer.release())
        elif cast_.scenario.decentralised and role.agents:
            spec = peers(cast_.scenario, role.agents, steered=cast_.steered)
        else:
            spec = role.make(reports)
        inbox, common = Inbox(role.endpoints.subscriptions), role.settings.declared(LockstepSettings)
        node: Node
        publishers = {
            topic: Outbox(topic, lambda t, data: self._publish(node, t, data)) for topic in role.endpoints.publications
        }
        loop = Lockstep(
            spec,
            inbox,
            cast("Any", publishers),
            cast("Any", reports),
            topics=tuple(role.endpoints.subscriptions),
            stall_timeout=common.stall_timeout,
            repeat_after=common.repeat_after,
            repeat_steps=common.repeat_steps,
            clock=RunningClock(lambda: self.now),
        )
        node = Node(role.name, role, reports, loop, spec, inbox, loop.activity())
        for topic, qos in role.endpoints.subscriptions.items():
            self._readers.setdefault(topic, []).append((node, qos.reliability == "reliable"))
        return node

    def _record(self, step: Step) -> None:
        self.recorded.extend(step.singly())

    @property
    def finished(self) -> bool:
        return self.nodes[RECORDER].ended

    def run(self, until: float = LONGEST_RUN) -> bool:
        """Go on until the run is recorded, a node fails, or this time, s; tell whether it is recorded."""
        while not self.finished and not self.problems and self.now < until:
            self.step()
        return self.finished

    def run_calmly(self, until: float) -> None:
        """Go on until a time, s, as usual; what the script has is left for later."""
        script, self._script = self._script, turns([])
        self.run(until)
        self._script = script

    def run_turns(self, turns: int) -> None:
        end = self.turn + turns
        while self.turn < end and not self.finished:
            self.step()

    def stalls(self) -> dict[str, dict[str, Any]]:
        """Return the last stall that each node has reported: the step, and who is missing for it."""
        return {node.name: said[-1] for node in self.nodes.values() if (said := node.reports.of("stalled"))}

    def step(self) -> None:
        self.turn += 1
        deviation = next(self._script)
        if deviation is not None and self._deviate(deviation.act, deviation.which):
            return
        if self._ready:
            self._go_on(next(iter(self._ready.values())))
        elif self._under_way:
            self._deliver(self._under_way.pop(0))
        else:
            self._pass()

    def kill(self, name: str) -> None:
        node = self.nodes[name]
        node.alive = False
        self._look(node)

    def freeze(self, name: str, seconds: float) -> None:
        node = self.nodes[name]
        node.frozen_until, node.buffered = self.now + seconds, 0
        self._look(node)

    def _deviate(self, act: Act, which: int) -> bool:
        """Do something unusual; tell whether there was anybody to whom it can happen."""
        if act in {Act.OTHER, Act.LOSE, Act.TWICE}:
            if not self._under_way:
                return False
            self._meet(act, which % len(self._under_way))
        elif act is Act.PASS:
            self._pass()
        elif act is Act.RUN:
            if not self._ready:
                return False
            self._go_on(list(self._ready.values())[which % len(self._ready)])
        else:
            nodes = [n for n in self.nodes.values() if n.alive and not (act is Act.LATE and n.begun)]
            if not nodes:
                return False
            self.freeze(nodes[which % len(nodes)].name, FROZEN)
        return True

    def _meet(self, act: Act, index: int) -> None:
        parcel = self._under_way[index]
        if parcel.reliable:  # the first of its kind, and later if it was lost
            index = next(i for i, p in enumerate(self._under_way) if p[:3] == parcel[:3])
            parcel = self._under_way[index]
            if act is not Act.LOSE:
                self._deliver(self._under_way.pop(index))
        elif act is Act.TWICE:
            self._deliver(parcel)
        else:
            del self._under_way[index]
            if act is Act.OTHER:
                self._deliver(parcel)

    def _pass(self) -> None:
        alive = [node for node in self.nodes.values() if node.alive]
        self.now = max(self.now, min(max(node.deadline, node.frozen_until) for node in alive))
        for node in alive:
            self._look(node)

    def _look(self, node: Node) -> None:
        can = node.alive and node.frozen_until <= self.now
        if can and (node.waits is None or node.deadline <= self.now or node.inbox.has(node.waits[0])):
            self._ready[node.name] = node
        else:
            self._ready.pop(node.name, None)

    def _go_on(self, node: Node) -> None:
        try:
            if node.waits is None:
                self._join(node)
                node.waits = next(node.activity)
            else:
                node.waits = node.activity.send(node.inbox.has(node.waits[0]))
            node.deadline = self.now + max(SHORTEST, node.waits[1])
        except StopIteration:
            node.alive, node.ended = False, True
        except Exception as error:  # noqa: BLE001 - whoever looks for what is wrong is told of bugs, too
            node.alive = False
            self.problems[node.name] = error
        self._look(node)

    def _join(self, node: Node) -> None:
        """Let a node begin: what was said before it has missed, but what is kept for those who come late."""
        node.begun = True
        for sender, topic, data in self._history:
            kept = node.role.endpoints.subscriptions.get(topic)
            if kept is not None and kept.durability == "transient_local":
                self._under_way.append(Parcel(sender, node, topic, data, reliable=True))

    def _publish(self, sender: Node, topic: Topic, data: bytes) -> None:
        self.published[sender.name, topic, data] += 1
        for receiver, reliable in self._readers.get(topic, ()):
            if receiver.begun and receiver.alive:
                self._under_way.append(Parcel(sender, receiver, topic, data, reliable))
        if OFFERED[LOCKSTEP][usual_topic(topic)].durability == "transient_local":
            self._history.append((sender, topic, data))

    def intrude(self, topic: Topic, data: bytes) -> None:
        """Deliver a message of a node that does not belong to the swarm."""
        for receiver, _ in self._readers.get(topic, ()):
            if receiver.begun and receiver.frozen_until <= self.now:
                self._deliver(Parcel(receiver, receiver, topic, data, reliable=True))

    def _deliver(self, parcel: Parcel) -> None:
        node = parcel.receiver
        if not node.alive:
            return
        if node.frozen_until > self.now:
            node.buffered += 1
            if node.buffered > BUFFERED and not parcel.reliable:
                return
        node.inbox.put(parcel.topic, parcel.data)
        self._look(node)
