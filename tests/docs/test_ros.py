"""The nodes of docs/how-to/ros.md, started by hand, and by the launch file with stand-ins for `launch`.

The package `launch` comes with a complete ROS 2 only.
"""

import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from tests.docs.pages import blocks, read, rows, script, section
from tests.processes import programs

from swarmabs_bag.reader import open_bag
from swarmabs_bag.run_folder import RunFolder, new_run_folder
from swarmabs_config.scenario import load_scenario
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.messages import MAIN_TOPICS
from swarmabs_run.orchestration.network import FIRST_FREE, claimed_domain, dds_environment, profile_xml
from swarmabs_run.orchestration.plan import plan
from swarmabs_run.simulation import Simulation

STAND_INS = {
    "launch": ("LaunchDescription",),
    "launch.actions": ("DeclareLaunchArgument", "LogInfo", "OpaqueFunction", "Shutdown"),
    "launch.substitutions": ("LaunchConfiguration",),
    "launch_ros": (),
    "launch_ros.actions": ("Node",),
}


class StandIn:
    """Keeps what it was made with."""

    def __init__(self, *positional: Any, **named: Any) -> None:
        self.positional, self.named = positional, named

    def perform(self, context: dict[str, str]) -> str:
        return context[self.positional[0]]


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> Any:
    for module_name, names in STAND_INS.items():
        module = ModuleType(module_name)
        for name in names:
            setattr(module, name, type(name, (StandIn,), {}))
        monkeypatch.setitem(sys.modules, module_name, module)
    return script("src/swarmabs_bringup/launch/lockstep.launch.py")


def documented_nodes() -> list[list[str]]:
    """Return module and arguments of every node that the page starts."""
    (text,) = blocks(section(read("docs/how-to/ros.md"), "Run nodes by hand"), "sh")
    return [shlex.split(line)[2:] for line in re.findall(r"^(python -m .*) &$", text, re.MULTILINE)]


def actions(launch_file: Any, **given: str) -> list[Any]:
    """Return what the launch file does with these arguments and its own defaults."""
    description = launch_file.generate_launch_description()
    *declared, function = description.positional[0]
    context = {argument.positional[0]: argument.named["default_value"] for argument in declared}
    assert set(given) <= set(context)
    return function.named["function"]({**context, **given})  # type: ignore[no-any-return]


def of_kind(found: list[Any], name: str) -> list[Any]:
    return [action for action in found if type(action).__name__ == name]


def test_nodes_are_those_of_a_run_and_the_end_of_any_ends_all(launch_file: Any, tmp_path: Path) -> None:
    out = tmp_path / "run"
    nodes = [node.named for node in of_kind(actions(launch_file, out=str(out)), "Node")]
    planned = plan(load_scenario(out / "scenario.yaml"), RunFolder(out))
    assert [node["arguments"] for node in nodes] == [process.arguments("/") for process in planned]
    assert (out / "logs" / "orchestrator.log").read_text() == "pd_het_4: 8 processes started by ros2 launch\n"
    for node in nodes:
        ended = node["on_exit"]
        for code, ending in ((0, False), (-2, True)):
            (action,) = ended(SimpleNamespace(process_name="a", returncode=code), SimpleNamespace(is_shutdown=ending))
            assert type(action).__name__ == "Shutdown"
        with pytest.raises(RunError, match="a failed with exit code 2"):
            ended(SimpleNamespace(process_name="a", returncode=2), SimpleNamespace(is_shutdown=False))
    for node, process in zip(nodes, planned, strict=True):
        installed = {program.name: program.module for program in programs(node["package"])}
        assert installed[node["executable"]] == process.module


def test_scenario_namespace_and_folder_are_taken_or_numbered_and_a_folder_in_use_is_refused(
    launch_file: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("schema: 1\nswarm: {generate: {single_integrator: 3}}\n", encoding="utf-8")
    found = actions(launch_file, scenario=str(file), out=str(tmp_path / "run"), namespace="/left")
    nodes = of_kind(found, "Node")
    assert len(nodes) == 4 + 3
    assert all("__ns:=/left" in node.named["arguments"] for node in nodes)
    assert any("results:" in text.named["msg"] for text in of_kind(found, "LogInfo"))
    monkeypatch.chdir(tmp_path)
    actions(launch_file)
    assert (tmp_path / "runs" / "pd_het_4-001" / "scenario.yaml").is_file()
    with pytest.raises(InputError, match=r"is not empty; name another with out:="):
        actions(launch_file, out=str(tmp_path))


def test_the_page_has_the_arguments_of_the_file_and_starts_all_kinds_of_nodes_by_hand(launch_file: Any) -> None:
    kinds = {module.split(".")[0] for module, *_ in documented_nodes()}
    assert kinds == {"plane_sim", "abstraction_observer", "parent_controller", "agent_node"}
    described = {row[0].strip("`"): row[1] for row in rows(section(read("docs/how-to/ros.md"), "Launch file"))}
    assert described.keys() == launch_file.ARGUMENTS.keys()
    for name, (default, _) in launch_file.ARGUMENTS.items():
        assert described[name] == (f"`{default}`" if default else "empty")


class NodesByHand:
    """Starts nodes as modules of their own processes."""

    def __init__(self, environment: dict[str, str], logs: Path) -> None:
        self.environment, self._logs = environment, logs
        self.processes: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, module: str, *arguments: str, name: str) -> None:
        with (self._logs / f"{name}.txt").open("wb") as log:
            words = [sys.executable, "-m", module, *arguments]
            self.processes[name] = subprocess.Popen(words, env=self.environment, stdout=log, stderr=log)

    def end(self) -> dict[str, int]:
        """Ask all to end, and return their exit codes."""
        for process in self.processes.values():
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
        try:
            return {name: process.wait(timeout=15) for name, process in self.processes.items()}
        finally:
            for process in self.processes.values():
                process.kill()


@pytest.fixture
def by_hand(nothing_survives: str, tmp_path: Path) -> Iterator[NodesByHand]:
    """Nodes in a claimed ROS domain on loopback."""
    with claimed_domain() as domain:
        profile = tmp_path / "fastdds.xml"
        profile.write_text(profile_xml(domain, peers=range(16), participant=FIRST_FREE), encoding="utf-8")
        settings = {**dds_environment(domain, str(profile)), "ROS_LOG_DIR": str(tmp_path / "ros")}
        nodes = NodesByHand({**os.environ, **settings}, tmp_path)
        try:
            yield nodes
        finally:
            codes = nodes.end()
        assert set(codes.values()) == {0}, codes


@pytest.mark.system
@pytest.mark.timeout(90)
def test_planned_nodes_record_the_run_without_an_orchestrator(by_hand: NodesByHand, tmp_path: Path) -> None:
    """What the launch file starts, started as it starts them: the bag holds what `simulate` gives."""
    folder = new_run_folder(tmp_path / "run")
    scenario = find_scenario("pd_het_4", ["duration=1.0"]).resolved()
    folder.fill(scenario)
    planned = plan(scenario, folder)
    for process in planned:
        by_hand.start(process.module, *process.arguments("/"), name=process.name)
    assert by_hand.processes["recorder"].wait(timeout=60) == 0
    recorded = sorted((topic.name, payload) for topic, _, payload in open_bag(folder.path).messages(MAIN_TOPICS))
    expected = sorted(
        (record.topic.name, record.payload) for step in Simulation(scenario).steps() for record in step.records
    )
    assert recorded == expected


@pytest.mark.system
@pytest.mark.timeout(90)
def test_nodes_of_the_page_level_the_plane_and_its_script_sees_it(by_hand: NodesByHand) -> None:
    for index, (module, *arguments) in enumerate(documented_nodes()):
        by_hand.start(module, *arguments, name=f"{index} {module}")
    (script,) = blocks(section(read("docs/how-to/ros.md"), "Look into a run"), "python")
    command = [sys.executable, "-u", "-c", script]
    with subprocess.Popen(command, env=by_hand.environment, stdout=subprocess.PIPE, text=True) as looker:
        try:
            assert looker.stdout is not None
            seen = (line.split() for line in looker.stdout)
            angle = next(float(angle) for step, angle in seen if int(step) >= 1000)
        finally:
            looker.kill()
    assert abs(angle) < 0.01
