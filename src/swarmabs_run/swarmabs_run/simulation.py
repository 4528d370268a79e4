"""The whole system in one process: the state machines of the nodes, without ROS."""

from __future__ import annotations

import os
import time
from collections import deque
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from swarmabs_bag.attached import scenario_of
from swarmabs_bag.run.figures import RunFigures, tracking_of
from swarmabs_bag.run.gatherer import RunCollector
from swarmabs_bag.run.step import STEP_BYTES, STEP_SECONDS
from swarmabs_config import configure
from swarmabs_config.graph import CONTROLLER, LOCKSTEP, OBSERVER, OFFERED, PLANE, ROBOT, Option, endpoints
from swarmabs_config.scenario import Scenario, dump_scenario, parse_scenario
from swarmabs_config.scenarios import as_override
from swarmabs_core.arrays import RunArrays, RunEvent, run_arrays, run_event, table
from swarmabs_core.behaviours import Agent, Controller, Observer, Parent
from swarmabs_core.cdr import encode
from swarmabs_core.errors import RunError
from swarmabs_core.messages import EVENTS, PLANE_STATE, topic_of
from swarmabs_core.nodes import NodeKind, NodeName
from swarmabs_run.swarm_columns import NotVectorisableError
from swarmabs_run.vector_simulation import VectorSimulation, vectorised

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
    from os import PathLike

    from swarmabs_bag.run.step import Step
    from swarmabs_core.behaviours import Behaviour
    from swarmabs_core.messages import Message, Messages, Topic
    from swarmabs_core.models import AgentConfig, SystemAgentConfig


Machine = TypeVar("Machine", Agent, Controller, Observer, Parent)


class NodeInProcess(NamedTuple):
    """A node as part of this process: its state machine and the topics to which it subscribes."""

    behaviour: Behaviour
    hears: Collection[Topic]


def nodes_in_process(scenario: Scenario, division: int | None = None) -> dict[NodeName, NodeInProcess]:
    """Return all nodes of a scenario by name: observer, plane, parent controller, robots.

    Whatever its coordination, they publish what the nodes of its runs do.

    The `division` is the number of steps from a change on in which the observer tells how the abstract state divides,
    by default that of the scenario.
    """
    division = configure.division(scenario) if division is None else division
    controller = Controller(
        replace(configure.controller_config(scenario, recording_window=0), division=division),
    )
    watching = replace(configure.observer_config(scenario), division=division)
    observer = Observer(watching)
    also = configure.options_for(scenario) | ({Option.WATCHING} if PLANE_STATE in observer.awaits() else set())
    nodes = {
        NodeName(NodeKind.OBSERVER): _node(observer, OBSERVER, also),
        NodeName(NodeKind.PARENT): _parent(scenario),
        NodeName(NodeKind.CONTROLLER): _node(controller, CONTROLLER, also),
    }
    for config in configure.agent_configs(scenario):
        nodes[NodeName(NodeKind.AGENT, config.agent_id)] = _robot(config)
    return nodes


def peers_in_process(scenario: Scenario) -> dict[NodeName, NodeInProcess]:
    """Return plane and robots by name, where each robot coordinates the swarm by itself."""
    peers = configure.peers(scenario, configure.members(scenario), recorded=False)
    robots = {NodeName(NodeKind.AGENT, peer.agent_id): NodeInProcess(peer, peer.needs) for peer in peers}
    return {NodeName(NodeKind.PARENT): _parent(scenario, confirmed=True)} | robots


def _parent(scenario: Scenario, *, confirmed: bool = False) -> NodeInProcess:
    """Return the node of the plane, or of another parent system."""
    config = replace(configure.parent_config(scenario), confirmed=confirmed)
    return _node(Parent(config), PLANE, configure.options_for(scenario))


def behaviour_of(nodes: Mapping[NodeName, NodeInProcess], name: NodeName, kind: type[Machine]) -> Machine:
    """Return the state machine of a node, which is of this class."""
    behaviour = nodes[name].behaviour
    assert isinstance(behaviour, kind)  # noqa: S101 - by its name
    return behaviour


def _robot(config: AgentConfig | SystemAgentConfig) -> NodeInProcess:
    """Return the node of a robot."""
    agent = Agent(config)
    feeling = {Option.FEELING} if PLANE_STATE in agent.needs else set()
    return _node(agent, ROBOT, feeling | (set() if config.system_hash is None else {Option.SYSTEM}))


def _node(behaviour: Behaviour, name: str, options: Collection[Option]) -> NodeInProcess:
    return NodeInProcess(behaviour, tuple(endpoints(name, LOCKSTEP, frozenset(options)).subscriptions))


class Network:
    """Nodes of one process connected by a queue; a copy (`copy.deepcopy`) continues independently.

    The nodes start and answer in the given order.

    Attributes
    ----------
    pending : deque of Message
        The messages that are not delivered yet.
    """

    def __init__(self, nodes: Iterable[NodeInProcess]) -> None:
        self._nodes = tuple(nodes)
        self._subscribers: dict[Topic, list[Callable[[Message], Messages]]] = {topic: [] for topic in OFFERED[LOCKSTEP]}
        for node in self._nodes:
            for topic in node.hears:
                self._subscribers.setdefault(topic, []).append(node.behaviour.handle)
        self.pending: deque[Message] = deque()

    def start(self) -> None:
        """Let every node publish its first messages."""
        for node in self._nodes:
            self.pending.extend(node.behaviour.start())

    def disconnect(self, node: NodeInProcess) -> None:
        """Deliver nothing more to a node."""
        for topic in node.hears:
            self._subscribers[topic].remove(node.behaviour.handle)

    def deliver(self, hold: Callable[[Message], bool] | None = None) -> Iterator[Message]:
        """Yield each message and then deliver it, until none is pending except those that `hold` selects."""
        held: list[Message] = []
        while self.pending:
            message = self.pending.popleft()
            if hold is not None and hold(message):
                held.append(message)
                continue
            yield message
            for handle in self._subscribers[topic_of(message)]:
                self.pending.extend(handle(message))
        self.pending.extend(held)


class Simulation:
    """The nodes of a scenario, connected by a queue.

    The nodes start and answer in the given order, by default that of `nodes_in_process`, or `peers_in_process` if each
    robot coordinates the swarm by itself; `division` is as for `nodes_in_process`.
    """

    def __init__(
        self,
        scenario: Scenario,
        nodes: Iterable[NodeInProcess] | None = None,
        division: int | None = None,
    ) -> None:
        if nodes is None:
            named = peers_in_process(scenario) if scenario.decentralised else nodes_in_process(scenario, division)
            nodes = named.values()
        self._network = Network(nodes)
        self._collector = RunCollector(
            configure.members(scenario),
            configure.schedule(scenario),
            scenario.steps,
            memory=2,
            division=configure.division(scenario) if division is None else division,
            family=scenario.family,
            relayed=scenario.decentralised,
        )

    def steps(self) -> Iterator[Step]:
        """Run, and yield the steps as a bag would hold them, several together; after an error, those before it first.

        Raises `RunError` if the run fails, such as when the plane turns over, or stalls.
        """
        self._network.start()
        sent = _Sent()
        try:
            for message in self._network.deliver():
                sent.add(message)
                if sent.full:
                    yield from sent.collected_by(self._collector)
        except Exception:
            yield from sent.collected_by(self._collector)
            raise
        yield from sent.collected_by(self._collector)
        if not self._collector.finished:
            missing = ", ".join(self._collector.missing())
            raise RunError(f"the run stalls at step {self._collector.step}; missing: {missing}")


class _Sent:
    """The messages that have been sent since the collector was given some, by topic."""

    def __init__(self) -> None:
        self._payloads: dict[Topic, list[bytes]] = {}
        self._size = 0
        self._begun = 0.0

    @property
    def full(self) -> bool:
        """Whether the messages are as many, or as old, as those of a `Step` may be."""
        return self._size >= STEP_BYTES or time.monotonic() - self._begun >= STEP_SECONDS

    def add(self, message: Message) -> None:
        """Add a message."""
        if not self._size:
            self._begun = time.monotonic()
        payload = encode(message)
        self._payloads.setdefault(topic_of(message), []).append(payload)
        self._size += len(payload)

    def collected_by(self, collector: RunCollector) -> Iterator[Step]:
        """Give the messages to the collector, and yield the steps that are complete then."""
        sent, self._payloads, self._size = self._payloads, {}, 0
        for topic in sorted(sent, key=lambda topic: topic is not EVENTS):  # a step is complete with its events
            yield from collector.add_all(topic, sent[topic])


def simulated_steps(scenario: Scenario) -> Iterator[Step]:
    """Simulate a scenario, on arrays if all robots always behave alike; the results are identical bit for bit.

    Raises `RunError` if the run fails, such as when the plane turns over.
    """
    done = 0
    swarm = vectorised(scenario)
    if swarm is not None:
        try:
            for step in VectorSimulation(scenario, swarm).steps():
                yield step
                done = step.step + 1
        except NotVectorisableError:
            pass
        else:
            return
    for step in Simulation(scenario).steps():
        if step.step >= done:
            yield step[max(0, done - step.first) :]


def simulate(scenario: Scenario | str | PathLike[str], overrides: Mapping[str, object] | None = None) -> RunArrays:
    """Simulate a scenario in this process.

    Parameters
    ----------
    scenario : Scenario, str or path
        A scenario, the name of a built-in one, a YAML file, or a bag whose scenario to simulate.
    overrides : mapping, optional
        Values by their dotted paths in the scenario, as with ``--set``; lists and mappings replace the existing ones.

    Returns
    -------
    RunArrays
        The run as arrays: state of the parent, reference, abstract, auxiliary and desired state by step, robots by step
        and id; events and summary.

    Raises
    ------
    InputError
        If the scenario does not exist or is not valid.
    RunError
        If the run fails, such as when the plane turns over.

    Examples
    --------
    >>> from swarmabs_run.simulation import simulate
    >>> run = simulate("pd_het_4", {"plane.angle": 0.2})  # doctest: +SKIP
    >>> run.angle[-1], run.summary()["settled_at"]  # doctest: +SKIP
    """
    changed = _changed(scenario, [as_override(path, value) for path, value in (overrides or {}).items()])
    reference, period_ns = configure.reference(changed), changed.step_ns
    figures = RunFigures(reference, tracking_of(changed))
    events: list[RunEvent] = []
    gathered = {topic: bytearray() for topic in changed.family.stepwise}
    for step in simulated_steps(changed):
        figures.add(step)
        events.extend(run_event(event, event.step * period_ns / 1e9) for event in step.events)
        for topic in step.tables.keys() & gathered.keys():
            gathered[topic] += step.tables[topic].tobytes()
    return run_arrays(
        {topic: table(topic, payloads) for topic, payloads in gathered.items()},
        reference=lambda step: reference(step * period_ns / 1e9),
        events=events,
        figures=partial(dict, figures.summary()),
        description=changed.tables,
    )


def _changed(scenario: Scenario | str | PathLike[str], overrides: list[str]) -> Scenario:
    if not isinstance(scenario, Scenario):
        return scenario_of(os.fspath(scenario), overrides)
    return parse_scenario(dump_scenario(scenario), overrides=overrides) if overrides else scenario
