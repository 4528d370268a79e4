"""The processes that a scenario needs, with their parameters."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import TYPE_CHECKING

from swarmabs_config import configure, realtime
from swarmabs_config.configure import options_for
from swarmabs_config.graph import (
    CONTROLLER,
    COORDINATORS,
    KEPT_STEPS,
    LOCKSTEP,
    NODES,
    OBSERVER,
    PEER,
    PLANE,
    REALTIME,
    RECORDER,
    ROBOT,
    Driver,
    Option,
    endpoints,
    options_of,
)
from swarmabs_core.declaration import values_of
from swarmabs_core.membership import UNPLANNED
from swarmabs_core.messages import FAMILIES, Topic
from swarmabs_core.nodes import agent_name
from swarmabs_core.steering import STEERER
from swarmabs_ros.lockstep import FIRST
from swarmabs_ros.settings import LockstepSettings, Variant
from swarmabs_run.run import DEFAULTS

if TYPE_CHECKING:
    from swarmabs_bag.run_folder import RunFolder
    from swarmabs_config.scenario import PlaneScenario, Scenario
    from swarmabs_run.run import RunOptions

Parameters = dict[str, object]

PATIENCE = 1e-4
"""Shortest time, s, per robot that a node waits for an answer before it sends its message again."""
PATIENCE_OF_PEERS = 1e-5
"""The same per pair of robots, where each of them sums up the swarm: messages repeated in vain would flood them."""


@dataclass(frozen=True, slots=True)
class ProcessPlan:
    """One process of a run.

    Parameters
    ----------
    name : str
        Name of its node.
    module : str
        Module whose ``main`` it runs.
    participant : int
        Its DDS participant id.
    parameters : dict
        Its ROS parameters.
    publications, subscriptions : tuple of Topic
        Its endpoints; they determine the counterparts that it must discover before the run starts.
    agents : tuple of int
        Ids of the robots that it hosts.
    """

    name: str
    module: str
    participant: int
    parameters: Parameters
    publications: tuple[Topic, ...]
    subscriptions: tuple[Topic, ...]
    agents: tuple[int, ...] = ()

    @property
    def gathers(self) -> bool:
        """Whether it receives the robots' states one by one."""
        return any(family.robot in self.subscriptions for family in FAMILIES)

    def arguments(self, namespace: str) -> list[str]:
        """Return the node's command line."""
        given = [f"{name}:={_yaml(value)}" for name, value in self.parameters.items() if value not in ((), [])]
        return [
            "--ros-args",
            # A node logs to standard error, which goes to its file in the run's folder.
            "--disable-external-lib-logs",
            *("-r", f"__node:={self.name}"),
            *("-r", f"__ns:={namespace}"),
            *(word for text in given for word in ("-p", text)),
        ]


Arrange = Callable[[Sequence[ProcessPlan]], Sequence[ProcessPlan]]
"""Changes the planned processes before they are started, such as their order or parameters."""


def _yaml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_yaml(item) for item in value) + "]"
    if isinstance(value, str):
        return "'" + value.replace("'", "''") + "'"
    if isinstance(value, float) and 0.0 < abs(value) < sys.float_info.min:
        return value.hex()  # the parameter parser reads a decimal number this small as a string
    return repr(value)


def group_name(agent_ids: tuple[int, ...]) -> str:
    """Return the node name of a process with several robots."""
    return f"agents_{agent_ids[0]:03d}_to_{agent_ids[-1]:03d}"


def plan(
    scenario: Scenario, folder: RunFolder, options: RunOptions = DEFAULTS, driver: Driver = LOCKSTEP
) -> tuple[ProcessPlan, ...]:
    """Return the processes of a scenario: the coordinators first, then the robots by id.

    By the time they start, the folder holds the resolved scenario. In lockstep, parameters give each process the number
    of counterparts of its endpoints; in real time, they tell it to wait for the start time of step 0.
    """
    recorder: Parameters = {
        "scenario_file": str(folder.scenario),
        "bag": str(folder.bag) if options.record else "",
        "max_bag_size": options.split.bytes,
        "max_bag_duration_ns": options.split.nanoseconds,
        "logs": str(folder.logs),
    }
    if driver is REALTIME:
        return _realtime_plan(realtime.check_realtime(scenario), recorder)
    processes = _lockstep_plan(scenario, folder, recorder, options)
    expect_counterparts(processes)
    return processes


def _lockstep_plan(
    scenario: Scenario, folder: RunFolder, recorder: Parameters, options: RunOptions
) -> tuple[ProcessPlan, ...]:
    window = configure.recording_window(scenario)
    packed = options.packs(scenario)
    common: Parameters = {
        **values_of(
            LockstepSettings(
                scenario.step_ns,
                scenario.steps,
                scenario.lockstep.stall_timeout,
                repeat_after=_patience(scenario),
                repeat_steps=min(KEPT_STEPS, 2 * window),
            )
        )
    }
    # These nodes begin each step by applying the steering requests for it.
    obeying = common | values_of(Variant(packed, options.steered))
    coordinators = {
        PLANE: obeying | values_of(replace(configure.parent_config(scenario), confirmed=scenario.decentralised)),
        OBSERVER: obeying | values_of(configure.observer_config(scenario)) | {"on_stall": scenario.lockstep.on_stall},
        CONTROLLER: obeying | values_of(configure.controller_config(scenario, recording_window=window)),
        RECORDER: obeying | recorder,
    }
    also = options_for(scenario)
    if scenario.decentralised:
        del coordinators[OBSERVER], coordinators[CONTROLLER]
    if options.steered:
        coordinators[STEERER] = common | {
            "scenario_file": str(folder.scenario),
            "folder": str(folder.path),
            "step_seconds": options.step_seconds,
            "paused": options.paused,
            "restarts": options.restarts,
        }
    robots = tuple(_agent_processes(scenario, common | values_of(Variant(packed)), folder, options))
    spare = count(COORDINATORS + len(robots))
    return (
        *(_coordinator(node, LOCKSTEP, parameters, scenario, also, spare) for node, parameters in coordinators.items()),
        *robots,
    )


def _patience(scenario: Scenario) -> float:
    """Return the shortest time, s, that a node waits for an answer before it sends its message again."""
    robots = len(scenario.agents)
    pairs = robots * robots if scenario.decentralised else 0
    return max(FIRST, PATIENCE * robots, PATIENCE_OF_PEERS * pairs)


def _realtime_plan(scenario: PlaneScenario, recorder: Parameters) -> tuple[ProcessPlan, ...]:
    schedule = realtime.schedule(scenario, 0)
    coordinators = {
        PLANE: _without_epoch(realtime.plane_config(scenario, schedule)),
        OBSERVER: _without_epoch(realtime.observer_config(scenario, schedule)),
        CONTROLLER: _without_epoch(realtime.controller_config(scenario, schedule)),
        RECORDER: {"period_ns": scenario.step_ns, "await_epoch": True, "last_step": scenario.steps} | recorder,
    }
    robots = realtime.agent_configs(scenario, schedule)
    if scenario.decentralised:
        law = coordinators.pop(OBSERVER) | coordinators.pop(CONTROLLER)
        peers = [realtime.peer_config(scenario, schedule, robot.agent_id) for robot in robots]
        ends = [realtime.peer_endpoints(peer) for peer in peers]
        kind, own = PEER, [law | _without_epoch(peer) for peer in peers]
    else:
        kind, own, ends = ROBOT, [{} for _ in robots], [endpoints(ROBOT, REALTIME) for _ in robots]
    return (
        *(_coordinator(node, REALTIME, parameters, scenario) for node, parameters in coordinators.items()),
        *(
            ProcessPlan(
                agent_name(config.agent_id),
                NODES[kind].modules[REALTIME],
                COORDINATORS + index,
                own[index] | _without_epoch(config),
                ends[index].publications,
                tuple(ends[index].subscriptions),
                (config.agent_id,),
            )
            for index, config in enumerate(robots)
        ),
    )


def _without_epoch(config: object) -> Parameters:
    """Return the parameters of a node that receives the epoch once all nodes are ready."""
    values: Parameters = {**values_of(config)}
    del values["epoch_ns"]
    return values | {"await_epoch": True}


def _coordinator(
    node: str,
    driver: Driver,
    parameters: Parameters,
    scenario: Scenario,
    also: frozenset[Option] = frozenset(),
    spare: Iterator[int] | None = None,
) -> ProcessPlan:
    """Return the process of a node that exists once per run, if necessary with the next spare participant id."""
    kind = NODES[node]
    participant = kind.participant
    if participant is None:
        assert spare is not None  # noqa: S101 - only nodes in lockstep have no id of their own
        participant = next(spare)
    options, relaying = options_of(parameters) | also, configure.relaying(scenario)
    ends = endpoints(node, driver, options, robots=len(scenario.agents), neighbours=relaying)
    name = scenario.family.node if node == PLANE else node
    return ProcessPlan(
        name, kind.modules[driver], participant, parameters, ends.publications, tuple(ends.subscriptions)
    )


def _agent_processes(
    scenario: Scenario, common: Parameters, folder: RunFolder, options: RunOptions
) -> Iterator[ProcessPlan]:
    configs = configure.agent_configs(scenario)
    absent = {config.agent_id for config in configs if config.life.first_step == UNPLANNED}
    if not options.steered:  # a robot that exists only if added needs no process in a run that cannot be steered
        configs = tuple(config for config in configs if config.agent_id not in absent)
    for index, first in enumerate(range(0, len(configs), options.agents_per_process)):
        hosted = configs[first : first + options.agents_per_process]
        ids = tuple(config.agent_id for config in hosted)
        if scenario.decentralised:
            yield _peers(
                scenario,
                COORDINATORS + index,
                common | {"scenario_file": str(folder.scenario), "steered": options.steered},
                ids,
            )
            continue
        if options.agents_per_process == 1:
            name, module = agent_name(ids[0]), NODES[ROBOT].modules[LOCKSTEP]
            parameters = values_of(hosted[0]) | common
        else:
            name, module = group_name(ids), "agent_node.group"
            parameters = common | {"scenario_file": str(folder.scenario), "agent_ids": ids}
        if not absent.isdisjoint(ids):
            parameters["steered"] = True
        asked = options_of(parameters) | options_for(scenario)
        if any(Option.FEELING in options_of(values_of(config)) for config in hosted):
            asked |= {Option.FEELING}
        ends = endpoints(ROBOT, LOCKSTEP, asked)
        yield ProcessPlan(
            name, module, COORDINATORS + index, parameters, ends.publications, tuple(ends.subscriptions), ids
        )


def _peers(scenario: Scenario, participant: int, parameters: Parameters, ids: tuple[int, ...]) -> ProcessPlan:
    """Return the process of robots that coordinate the swarm by themselves."""
    name = agent_name(ids[0]) if len(ids) == 1 else group_name(ids)
    ends = configure.peer_endpoints(scenario, ids, steered=parameters["steered"] is True)
    return ProcessPlan(
        name,
        NODES[PEER].modules[LOCKSTEP],
        participant,
        parameters | {"agent_ids": ids},
        ends.publications,
        tuple(ends.subscriptions),
        ids,
    )


def partners(processes: Collection[ProcessPlan]) -> dict[str, tuple[int, ...]]:
    """Return the participant ids of the other robots' processes with which a process shares topics, by its name.

    Only processes that have such partners are in it: those of robots that coordinate the swarm by themselves.
    """
    robots = [process for process in processes if process.agents]
    readers: dict[Topic, list[int]] = {}
    for process in robots:
        for topic in process.subscriptions:
            readers.setdefault(topic, []).append(process.participant)
    found: dict[str, set[int]] = {}
    names = {process.participant: process.name for process in robots}
    for process in robots:
        for other in {reader for topic in process.publications for reader in readers.get(topic, ())}:
            if other != process.participant:
                found.setdefault(process.name, set()).add(other)
                found.setdefault(names[other], set()).add(process.participant)
    return {name: tuple(sorted(others)) for name, others in found.items()}


def announced_to(processes: Collection[ProcessPlan]) -> dict[str, tuple[int, ...]]:
    """Return the participant ids to which each process announces itself: the coordinators' and its partners'."""
    coordinators = {*range(COORDINATORS), *(process.participant for process in processes if not process.agents)}
    of_robots = partners(processes)
    return {p.name: tuple(sorted({*coordinators, *of_robots.get(p.name, ())})) for p in processes}


def expect_counterparts(processes: Collection[ProcessPlan]) -> None:
    """Set in every process the number of counterparts of each of its endpoints."""
    publishers = Counter(topic for process in processes for topic in process.publications)
    subscribers = Counter(topic for process in processes for topic in process.subscriptions)
    for process in processes:
        met = {topic: subscribers[topic] for topic in process.publications}
        met |= {topic: publishers[topic] for topic in process.subscriptions if topic not in met}
        process.parameters["match"] = [f"{topic.name} {number}" for topic, number in met.items()]
