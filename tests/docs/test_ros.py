"""The nodes of docs/how-to/ros.md and own_node.md, by hand, and by the launch files with stand-ins for `launch`.

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
from tests.docs.pages import ROOT, blocks, read, rows, script, section
from tests.processes import programs

from swarmabs_bag.reader import open_bag
from swarmabs_bag.run_folder import RunFolder, new_run_folder
from swarmabs_cli import swarm
from swarmabs_config.graph import REALTIME
from swarmabs_config.scenario import load_scenario
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.messages import MAIN_TOPICS
from swarmabs_run.orchestration.network import FIRST_FREE, claimed_domain, dds_environment, profile_xml
from swarmabs_run.orchestration.plan import plan
from swarmabs_run.simulation import Simulation, simulate

STAND_INS = {
    "launch": ("LaunchDescription",),
    "launch.actions": ("DeclareLaunchArgument", "ExecuteProcess", "LogInfo", "OpaqueFunction", "Shutdown"),
    "launch.substitutions": ("LaunchConfiguration",),
    "launch_ros": (),
    "launch_ros.actions": ("Node",),
    "launch_ros.substitutions": ("ExecutableInPackage",),
}


LAUNCHES = sorted((ROOT / "src/swarmabs_bringup/launch").glob("*.launch.py"))


class StandIn:
    """Keeps what it was made with."""

    def __init__(self, *positional: Any, **named: Any) -> None:
        self.positional, self.named = positional, named

    def perform(self, context: dict[str, str]) -> str:
        return context[self.positional[0]]


@pytest.fixture(params=["lockstep"])
def launch_file(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return one of the launch files, by default the one in lockstep."""
    for module_name, names in STAND_INS.items():
        module = ModuleType(module_name)
        for name in names:
            setattr(module, name, type(name, (StandIn,), {}))
        monkeypatch.setitem(sys.modules, module_name, module)
    return script(f"src/swarmabs_bringup/launch/{request.param}.launch.py")


launches = pytest.mark.parametrize("launch_file", [file.name.split(".")[0] for file in LAUNCHES], indirect=True)
realtime, view = (pytest.mark.parametrize("launch_file", [name], indirect=True) for name in ("realtime", "view"))


PAGES = {"docs/how-to/ros.md": "Run nodes by hand", "docs/how-to/own_node.md": "Replace a node"}

OWN_PLANE = """\
schema: 1
duration: 3.0
plane: {friction: [0, 0, 0, 0, 0, 1.0]}
controller: {type: lqr}
swarm:
  agents:
    - {id: 1, kind: single_integrator, mass: 0.5, position: 0.2}
    - {id: 2, kind: double_integrator, mass: 0.5, damping: 0.8, position: -0.1}
"""
"""The run of own_node.md on our plane."""


def documented_nodes(page: str = "docs/how-to/ros.md") -> list[list[str]]:
    """Return module and arguments of every node that a page starts in the background."""
    text = blocks(section(read(page), PAGES[page]), "sh")[0]
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


@realtime
def test_in_real_time_nodes_are_those_of_a_run_and_only_robots_may_be_lost(
    launch_file: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[Any] = []

    class Starting(StandIn):
        environment = {"SWARMABS_START_FD": "/pipe"}  # noqa: RUF012 - as of the real one
        begun, failed = False, ""
        start = forget = lambda _: None

        def __init__(self, *processes: object) -> None:
            made.append(self)

        def problem(self) -> str:
            return self.failed

    monkeypatch.setattr(launch_file, "Starter", Starting)
    out = tmp_path / "run"
    found = actions(launch_file, out=str(out), duration="3", markers="true", namespace="/left")
    *nodes, markers = (node.named for node in of_kind(found, "Node"))
    planned = plan(load_scenario(out / "scenario.yaml"), RunFolder(out), driver=REALTIME)
    assert [node["arguments"] for node in nodes] == [process.arguments("/left") for process in planned]
    for node, process in zip(nodes, planned, strict=True):
        assert node["additional_env"] == Starting.environment
        installed = {program.name: program.module for program in programs(node["package"])}
        assert installed[node["executable"]] == process.module
    assert markers["parameters"] == [{"scenario_file": str(out / "scenario.yaml")}]
    assert (markers["package"], markers["namespace"]) == ("swarmabs_view", "/left")

    ends = {process.name: node["on_exit"] for node, process in zip(nodes, planned, strict=True)}

    def follows(name: str, code: int, *, ending: bool = False) -> list[str]:
        following = ends[name](SimpleNamespace(returncode=code), SimpleNamespace(is_shutdown=ending))
        return [type(action).__name__ for action in following]

    with pytest.raises(RunError, match="agent_002 failed with exit code 2"):
        follows("agent_002", 2)
    made[0].begun = True
    assert follows("agent_001", 0) == follows("agent_001", -2, ending=True) == []
    assert follows("recorder", 0) == follows("plane_sim", 1, ending=True) == ["Shutdown"]
    with pytest.raises(RunError, match="plane_sim failed with exit code 1"):
        follows("plane_sim", 1)
    made[0].failed = "the plane lies"
    with pytest.raises(RunError, match="the plane lies"):
        follows("recorder", 0)
    assert follows("agent_002", -9) == ["LogInfo"]
    with pytest.raises(RunError, match="agent_002 failed with exit code -9; the plane lies"):
        follows("recorder", 0)
    with pytest.raises(InputError, match="markers:=yes: give true or false"):
        actions(launch_file, markers="yes")


@view
@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({}, ["--live", "/", "--port", "0"]),
        ({"namespace": "/left", "open": "true"}, ["--live", "/left", "--port", "0", "--open"]),
        ({"bag": "run", "port": "8080"}, ["run", "--port", "8080"]),
        ({"bag": "run", "namespace": "/left"}, ["run", "--namespace", "/left", "--port", "0"]),
    ],
)
def test_the_view_is_the_command_of_that_name(launch_file: Any, given: dict[str, str], words: list[str]) -> None:
    (process,) = actions(launch_file, **given)
    program, command, *arguments = process.named["cmd"]
    assert (program.named, command) == ({"package": "swarmabs_cli", "executable": "swarm"}, "view")
    assert arguments == words
    context = swarm.make_context("swarm", ["view", *words], resilient_parsing=True)
    swarm.get_command(context, "view").make_context("view", words)
    (action,) = process.named["on_exit"](SimpleNamespace(returncode=0), SimpleNamespace(is_shutdown=False))
    assert type(action).__name__ == "Shutdown"
    with pytest.raises(RunError, match="exit code 2"):
        process.named["on_exit"](SimpleNamespace(returncode=2), SimpleNamespace(is_shutdown=False))
    with pytest.raises(InputError, match="open:=yes"):
        actions(launch_file, open="yes")


def test_the_page_starts_all_kinds_of_nodes_by_hand() -> None:
    kinds = {module.split(".")[0] for module, *_ in documented_nodes()}
    assert kinds == {"plane_sim", "abstraction_observer", "parent_controller", "agent_node"}


@launches
def test_the_page_has_the_arguments_of_each_file(launch_file: Any) -> None:
    heading = Path(launch_file.__file__).name
    described = {row[0].strip("`"): row[1] for row in rows(section(read("docs/how-to/ros.md"), heading))}
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
@pytest.mark.timeout(300)
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
@pytest.mark.timeout(300)
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


@pytest.mark.system
@pytest.mark.timeout(120)
def test_an_own_plane_replaces_ours_and_moves_as_it_does(by_hand: NodesByHand, tmp_path: Path) -> None:
    """The oracle is `simulate`, whose plane has the same friction and another integrator, which follows the robots."""
    page = "docs/how-to/own_node.md"
    for index, (module, *arguments) in enumerate(documented_nodes(page)):
        by_hand.start(module, *arguments, name=f"{index} {module}")
    (words,) = re.findall(r"^python (examples/own_node/own_plane\.py .*)$", read(page), re.MULTILINE)
    command = [sys.executable, "-u", *shlex.split(words)]
    with subprocess.Popen(command, env=by_hand.environment, cwd=ROOT, stdout=subprocess.PIPE, text=True) as plane:
        try:
            assert plane.stdout is not None
            lines = [plane.stdout.readline().rstrip("\n") for _ in range(3)]
        finally:
            plane.kill()
    assert lines == blocks(section(read(page), PAGES[page]), "text")[0].splitlines()
    scenario = tmp_path / "own_plane.yaml"
    scenario.write_text(OWN_PLANE, encoding="utf-8")
    expected = simulate(scenario).angle
    for line in lines:
        step, angle = re.findall(r"^step (\d+): (\S+) rad$", line)[0]
        assert float(angle) == pytest.approx(expected[int(step)], abs=1e-5)
