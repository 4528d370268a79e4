"""The launch file, with stand-ins for `launch`, which comes with a complete ROS 2 only."""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import pytest
from tests.docs.pages import ROOT, read, rows, section
from tests.processes import programs

from swarmabs_bag.reader import open_bag
from swarmabs_bag.run_folder import RunFolder, new_run_folder
from swarmabs_config.scenario import load_scenario
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.errors import InputError
from swarmabs_core.messages import MAIN_TOPICS
from swarmabs_run.orchestration.plan import plan
from swarmabs_run.simulation import Simulation

if TYPE_CHECKING:
    from tests.docs.conftest import NodesByHand

FILE = ROOT / "src" / "swarmabs_bringup" / "launch" / "lockstep.launch.py"


@dataclass
class StandIn:
    """Keeps what it was made with."""

    positional: tuple[Any, ...]
    named: dict[str, Any] = field(default_factory=dict)


def stand_in(name: str) -> type[StandIn]:
    def init(self: StandIn, *positional: Any, **named: Any) -> None:
        StandIn.__init__(self, positional, named)

    def perform(self: StandIn, context: dict[str, str]) -> str:
        return context[self.positional[0]]

    return type(name, (StandIn,), {"__init__": init, "perform": perform})


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> Any:
    classes = {
        "launch": ("LaunchDescription",),
        "launch.actions": ("DeclareLaunchArgument", "LogInfo", "OpaqueFunction", "Shutdown"),
        "launch.substitutions": ("LaunchConfiguration",),
        "launch_ros": (),
        "launch_ros.actions": ("Node",),
    }
    for module_name, names in classes.items():
        module = ModuleType(module_name)
        for name in names:
            setattr(module, name, stand_in(name))
        monkeypatch.setitem(sys.modules, module_name, module)
    spec = importlib.util.spec_from_file_location("lockstep_launch", FILE)
    assert spec is not None
    assert spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


def actions(launch_file: Any, **given: str) -> list[Any]:
    """Return what the launch file does with these arguments and its own defaults."""
    description = launch_file.generate_launch_description()
    *declared, function = description.positional[0]
    context = {argument.positional[0]: argument.named["default_value"] for argument in declared}
    assert set(given) <= set(context)
    return function.named["function"]({**context, **given})  # type: ignore[no-any-return]


def of_kind(found: list[Any], name: str) -> list[Any]:
    return [action for action in found if type(action).__name__ == name]


def test_nodes_are_those_of_a_run(launch_file: Any, tmp_path: Path) -> None:
    out = tmp_path / "run"
    nodes = of_kind(actions(launch_file, out=str(out)), "Node")
    scenario = load_scenario(out / "scenario.yaml")
    planned = plan(scenario, RunFolder(out))
    assert [node.named["arguments"] for node in nodes] == [process.arguments("/") for process in planned]
    started = {(node.named["package"], node.named["executable"]) for node in nodes}
    assert started == {
        ("plane_sim", "plane_sim"),
        ("abstraction_observer", "abstraction_observer"),
        ("parent_controller", "parent_controller"),
        ("swarmabs_bag", "recorder"),
        ("agent_node", "agent_node"),
    }


def test_executables_are_installed(launch_file: Any, tmp_path: Path) -> None:
    for node in of_kind(actions(launch_file, out=str(tmp_path / "run")), "Node"):
        package, name = node.named["package"], node.named["executable"]
        assert any(program.name == name and program.module.startswith(f"{package}.") for program in programs(package))


def test_the_end_of_any_node_ends_the_launch(launch_file: Any, tmp_path: Path) -> None:
    for node in of_kind(actions(launch_file, out=str(tmp_path / "run")), "Node"):
        assert type(node.named["on_exit"]).__name__ == "Shutdown"


def test_scenario_and_namespace_are_taken(launch_file: Any, tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("schema: 1\nswarm: {generate: {single_integrator: 3}}\n", encoding="utf-8")
    found = actions(launch_file, scenario=str(file), out=str(tmp_path / "run"), namespace="/left")
    nodes = of_kind(found, "Node")
    assert len(nodes) == 4 + 3
    assert all("__ns:=/left" in node.named["arguments"] for node in nodes)
    assert any("results:" in text.named["msg"] for text in of_kind(found, "LogInfo"))


def test_results_without_a_name_are_numbered(launch_file: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    actions(launch_file)
    assert (tmp_path / "runs" / "pd_het_4-001" / "scenario.yaml").is_file()


def test_a_folder_in_use_is_refused(launch_file: Any, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="is not empty"):
        actions(launch_file, out=str(tmp_path))


def test_documented_arguments_are_those_of_the_file(launch_file: Any) -> None:
    described = {row[0].strip("`"): row[1] for row in rows(section(read("docs/ros.md"), "Launch file"))}
    assert described.keys() == launch_file.ARGUMENTS.keys()
    for name, (default, _) in launch_file.ARGUMENTS.items():
        assert described[name] == (f"`{default}`" if default else "empty")


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
