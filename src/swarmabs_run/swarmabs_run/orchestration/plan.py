"""Which processes a scenario needs, and with which parameters each is started."""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from swarmabs_bag.run_folder import ONE_FILE, Split
from swarmabs_config import configure
from swarmabs_config.graph import (
    CONTROLLER,
    COORDINATORS,
    LOCKSTEP,
    NODES,
    OBSERVER,
    PLANE,
    RECORDER,
    ROBOT,
    Driver,
    Option,
    agent_name,
    endpoints,
    options_of,
)
from swarmabs_core.declaration import values_of
from swarmabs_core.membership import UNPLANNED
from swarmabs_core.messages import Kind, Topic
from swarmabs_core.steering import STEERER
from swarmabs_ros.repeat import FIRST, WINDOW

if TYPE_CHECKING:
    from collections.abc import Collection
    from pathlib import Path

    from swarmabs_config.scenario import Scenario

PATIENCE = 1e-4
"""Time, s, per robot that a node waits at least for an answer before it repeats itself."""


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
        Its endpoints, from which follows whom each must have met before the run starts.
    agents : tuple of int
        Ids of the robots that live in it.
    """

    name: str
    module: str
    participant: int
    parameters: dict[str, object]
    publications: tuple[Topic, ...]
    subscriptions: tuple[Topic, ...]
    agents: tuple[int, ...] = ()

    def arguments(self, namespace: str) -> list[str]:
        """Return the node's command line."""
        given = [f"{name}:={_yaml(value)}" for name, value in self.parameters.items() if value not in ((), [])]
        return [
            "--ros-args",
            # What a node logs goes to its standard error, and from there to its file in the run's folder.
            *("--disable-external-lib-logs", "--disable-rosout-logs"),
            *("-r", f"__node:={self.name}"),
            *("-r", f"__ns:={namespace}"),
            *(word for text in given for word in ("-p", text)),
        ]


def _yaml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_yaml(item) for item in value) + "]"
    if isinstance(value, str):
        return "'" + value.replace("'", "''") + "'"
    if isinstance(value, float) and 0.0 < abs(value) < sys.float_info.min:
        return value.hex()  # a decimal as small as this counts as a text
    return repr(value)


def group_name(agent_ids: tuple[int, ...]) -> str:
    """Return the node name of a process with several robots."""
    return f"agents_{agent_ids[0]:03d}_to_{agent_ids[-1]:03d}"


def plan(
    scenario: Scenario,
    *,
    scenario_file: Path,
    bag: Path | None,
    logs: Path,
    agents_per_process: int = 1,
    packed: bool = False,
    split: Split = ONE_FILE,
    steered: bool = False,
    step_seconds: float = 0.0,
) -> tuple[ProcessPlan, ...]:
    """Return the processes of a scenario: the coordinators first, then the robots by id.

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    scenario_file : Path
        Where the resolved scenario stands, for the recorder.
    bag : Path, optional
        Folder of the bag; none if nothing is to be recorded.
    logs : Path
        Folder of the processes' logs, for the recorder.
    agents_per_process : int
        How many robots share a process.
    packed : bool
        Whether the robots hear the three broadcasts as one message.
    split : Split
        When the bag goes on in a new file.
    steered : bool
        Whether the run can be steered.
    step_seconds : float
        Shortest wall time, s, of a step of a run that can be steered.
    """
    common: dict[str, object] = {
        "period_ns": scenario.step_ns,
        "last_step": scenario.steps,
        "stall_timeout": scenario.lockstep.stall_timeout,
        "repeat_after": max(FIRST, PATIENCE * len(scenario.agents)),
        "repeat_steps": min(WINDOW, 2 * configure.recording_window(scenario)),
    }
    # Who begins each step with what is ordered for it.
    obeying = common | ({"steered": True} if steered else {})
    window = configure.recording_window(scenario)
    coordinators = {
        PLANE: obeying | values_of(configure.plane_config(scenario)),
        OBSERVER: obeying | values_of(configure.observer_config(scenario)) | {"on_stall": scenario.lockstep.on_stall},
        CONTROLLER: obeying
        | values_of(configure.controller_config(scenario, recording_window=window))
        | {"packed": packed},
        RECORDER: obeying | recorder_parameters(scenario_file, bag, logs, split),
    }
    if steered:  # its socket lies beside the scenario, in the folder of the run
        place = {"scenario_file": str(scenario_file), "folder": str(scenario_file.parent)}
        coordinators[STEERER] = common | place | {"step_seconds": step_seconds}
    processes = [
        *(coordinator(node, LOCKSTEP, parameters, scenario) for node, parameters in coordinators.items()),
        *_agent_processes(scenario, common | {"packed": packed}, scenario_file, agents_per_process, steered=steered),
    ]
    expect_counterparts(processes)
    return tuple(processes)


def recorder_parameters(scenario_file: Path, bag: Path | None, logs: Path, split: Split) -> dict[str, object]:
    """Return what a recorder is told of its files, whatever makes the steps."""
    return {
        "scenario_file": str(scenario_file),
        "bag": str(bag or ""),
        "max_bag_size": split.bytes,
        "max_bag_duration_ns": split.nanoseconds,
        "logs": str(logs),
    }


def coordinator(node: str, driver: Driver, parameters: dict[str, object], scenario: Scenario) -> ProcessPlan:
    """Return the process of a node that there is once."""
    kind = NODES[node]
    ends = endpoints(node, driver, options_of(parameters), robots=len(scenario.agents))
    return ProcessPlan(
        node, kind.modules[driver], kind.participant, parameters, ends.publications, tuple(ends.subscriptions)
    )


def _agent_processes(
    scenario: Scenario, common: dict[str, object], scenario_file: Path, per_process: int, *, steered: bool
) -> list[ProcessPlan]:
    configs = configure.agent_configs(scenario)
    absent = {config.agent_id for config in configs if config.life.first_step == UNPLANNED}
    if not steered:  # who is there only when it is added has no process where nobody can be added
        configs = tuple(config for config in configs if config.agent_id not in absent)
    processes = []
    for index, first in enumerate(range(0, len(configs), per_process)):
        hosted = configs[first : first + per_process]
        ids = tuple(config.agent_id for config in hosted)
        feels = any(config.feels_gravity and config.kind is Kind.DOUBLE_INTEGRATOR for config in hosted)
        if per_process == 1:
            name, module = agent_name(ids[0]), NODES[ROBOT].modules[LOCKSTEP]
            parameters: dict[str, object] = {**values_of(hosted[0])}
        else:
            name, module = group_name(ids), "agent_node.group"
            parameters = {"scenario_file": str(scenario_file), "agent_ids": ids}
        parameters |= common
        if not absent.isdisjoint(ids):
            parameters["steered"] = True
        options = options_of(parameters) | ({Option.FEELING} if feels else set())
        ends = endpoints(ROBOT, LOCKSTEP, options)
        processes.append(
            ProcessPlan(
                name, module, COORDINATORS + index, parameters, ends.publications, tuple(ends.subscriptions), ids
            )
        )
    return processes


def expect_counterparts(processes: Collection[ProcessPlan]) -> None:
    """Tell every process how many counterparts each of its endpoints will meet."""
    publishers = Counter(topic for process in processes for topic in process.publications)
    subscribers = Counter(topic for process in processes for topic in process.subscriptions)
    for process in processes:
        met = {topic: subscribers[topic] for topic in process.publications}
        met |= {topic: publishers[topic] for topic in process.subscriptions if topic not in met}
        process.parameters["match"] = [f"{topic.name} {number}" for topic, number in met.items()]
