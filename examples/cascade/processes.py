"""The cascade with a process for every robot and node of every layer, in lockstep over DDS."""

from __future__ import annotations

import os
import signal
import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, cast

from layers import FOLDER, UPPER, lower

from swarmabs_config.graph import CONTROLLER, PLANE, RECORDER
from swarmabs_core.errors import RunError
from swarmabs_core.messages import AGENT_STATE, PLANE_STATE
from swarmabs_run.orchestration.machine import Machine
from swarmabs_run.orchestration.network import claimed_domain, dds_environment, profile_xml
from swarmabs_run.orchestration.plan import ProcessPlan, plan
from swarmabs_run.orchestration.supervision import how_it_ended
from swarmabs_run.run import RunOptions
from swarmabs_run.tracing_files import tracing_files_removed

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from layers import CascadeScenario

    from swarmabs_bag.run_folder import RunFolder

PATIENCE = 30.0
"""Longest time without a report from the processes, s."""
CLOSING_SECONDS = 20.0
"""Time that the recorders have to complete the bags of a failed run, s."""


@dataclass(frozen=True, slots=True)
class LayerProcess:
    """A process of a layer: its name is unique in the cascade, the name of its node is unique in the layer."""

    namespace: str
    process: ProcessPlan
    arguments: list[str]
    node: str


def processes(cascade: CascadeScenario, folders: Mapping[str, RunFolder]) -> list[LayerProcess]:
    """Return the processes of all layers; the coupling ones differ from those of a single swarm."""
    found: list[LayerProcess] = []
    for namespace, scenario in cascade.layers.items():
        folder = folders[namespace]
        for process in plan(scenario, folder, RunOptions(packed=False)):  # the coupling nodes read single messages
            coupled = _coupled(cascade, folders, namespace, process)
            unique = replace(coupled, name=f"{namespace.strip('/')}.{process.name}", participant=len(found))
            found.append(LayerProcess(namespace, unique, coupled.arguments(namespace), process.name))
    return found


def _coupled(
    cascade: CascadeScenario, folders: Mapping[str, RunFolder], namespace: str, process: ProcessPlan
) -> ProcessPlan:
    """Return a process adapted to the cascade: as a coupling node, or with more counterparts to discover."""
    robots = {lower(robot): robot for robot in cascade.lower}
    if namespace == UPPER and process.agents:
        (robot,) = process.agents
        process = _with_more(process, AGENT_STATE.name, len(robots))
        return _in_place(cascade, folders, robot, process, "carried_robot_node")
    if namespace != UPPER and process.name == PLANE:
        return _with_more(process, PLANE_STATE.name, 1)
    if namespace != UPPER and process.name == CONTROLLER:
        return _in_place(cascade, folders, robots[namespace], process, "led_controller_node")
    return process


def _with_more(process: ProcessPlan, topic: str, more: int) -> ProcessPlan:
    """Return a process that must discover more counterparts on a topic."""
    match = []
    for text in cast("list[str]", process.parameters["match"]):
        name, number = text.split()
        match.append(f"{name} {int(number) + more * (name == topic)}")
    return replace(process, parameters={**process.parameters, "match": match})


def _in_place(
    cascade: CascadeScenario, folders: Mapping[str, RunFolder], robot: int, process: ProcessPlan, module: str
) -> ProcessPlan:
    """Return the coupling node that replaces a process."""
    common = ("period_ns", "last_step", "stall_timeout", "match")
    parameters: dict[str, object] = {
        **{name: process.parameters[name] for name in common},
        "upper_file": str(folders[UPPER].scenario),
        "lower_file": str(folders[lower(robot)].scenario),
        "robot": robot,
        "ratio": cascade.coupling.ratio,
        "bandwidth": cascade.coupling.bandwidth,
    }
    return replace(process, module=module, parameters=parameters)


class CascadeRun:
    """Starts the processes of all layers, waits until they have discovered each other, and lets them run.

    Parameters
    ----------
    cascade : CascadeScenario
        The cascade to run.
    folders : mapping
        The initialised result folders of the layers by namespace.
    """

    def __init__(self, cascade: CascadeScenario, folders: Mapping[str, RunFolder]) -> None:
        self._folders = folders
        self._processes = {layer.process.name: layer for layer in processes(cascade, folders)}
        self._names: dict[int, str] = {}
        self._ready: set[str] = set()
        self._stalled: dict[str, str] = {}
        self._done: dict[str, dict[str, Any]] = {}

    @property
    def figures(self) -> dict[str, Mapping[str, object]]:
        """Digest and figures of the layers whose recorder has ended, by namespace."""
        return {self._processes[name].namespace: report["figures"] for name, report in self._done.items()}

    def run(self) -> None:
        """Run to the end.

        Raises
        ------
        RunError
            If a process fails or ends, or the run stalls; no process remains.
        """
        logs = self._folders[UPPER].logs
        with ExitStack() as stack:
            stack.enter_context(tracing_files_removed())
            domain = stack.enter_context(claimed_domain(len(self._processes)))
            profile = logs / "fastdds.xml"
            profile.write_text(profile_xml(domain, peers=range(len(self._processes))), encoding="utf-8")
            environment = dds_environment(domain, str(profile.resolve()))
            environment["PYTHONPATH"] = os.pathsep.join((str(FOLDER), os.environ.get("PYTHONPATH", "")))
            machine = Machine(environment, logs / "launcher.log", processes=len(self._processes))
            launcher = stack.enter_context(machine)
            for layer in self._processes.values():
                log = self._folders[layer.namespace].logs / f"{layer.node}.log"
                launcher.spawn(layer.process, layer.arguments, log)
            try:
                self._listen(launcher, lambda: len(self._ready) == len(self._processes))
                launcher.start_all()
                self._listen(launcher, self._complete)
            except (RunError, KeyboardInterrupt):
                self._end_recorders(launcher)
                raise

    def _complete(self) -> bool:
        return len(self._done) == len(self._folders)

    def _listen(self, launcher: Machine, enough: Callable[[], bool]) -> None:
        """Process reports until `enough` returns True."""
        news = time.monotonic()
        while not enough():
            if reports := launcher.listen(1.0):
                for report in reports:
                    self._take(report)
                news = time.monotonic()
            elif not launcher.alive():
                raise RunError("the launcher has died")
            elif time.monotonic() - news > PATIENCE:
                waits = "; ".join(f"{name} waits for {what}" for name, what in sorted(self._stalled.items()))
                raise RunError(f"nothing has moved for {PATIENCE:g} s: {waits or 'processes have not met'}")

    def _take(self, report: Mapping[str, Any]) -> None:
        event = report["event"]
        if event == "spawned":
            self._names[report["child"]] = report["name"]
            return
        name = self._names[report["child"] if event == "exited" else report["pid"]]
        if event == "ready":
            self._ready.add(name)
        elif event == "stalled":
            self._stalled[name] = ", ".join(report["missing"])
        elif event == "recovered":
            self._stalled.pop(name, None)
        elif event == "done":
            self._done[name] = dict(report)
            if report["problem"]:
                raise RunError(f"{name}: {report['problem']}")
        elif event == "failed":
            raise RunError(f"{name}: {report['reason']}")
        elif event == "exited" and name not in self._done:
            log = self._folders[self._processes[name].namespace].logs / f"{self._processes[name].node}.log"
            raise RunError(f"{name} {how_it_ended(report['code'])}; see {log}")

    def _end_recorders(self, launcher: Machine) -> None:
        """Let the recorders complete the bags of a failed run."""
        recorders = {name for name, layer in self._processes.items() if layer.node == RECORDER}
        for name in recorders - self._done.keys():
            launcher.signal(name, signal.SIGTERM)
        deadline = time.monotonic() + CLOSING_SECONDS
        while not recorders <= self._done.keys() and launcher.alive() and time.monotonic() < deadline:
            for report in launcher.listen():
                with suppress(RunError):  # only the first failure is reported
                    self._take(report)
