"""examples/own_node: the monitors run with a swarm, the one in C++ where rclcpp is installed."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree as ET

import pytest
from tests.docs.pages import ROOT, read, script
from tests.processes import programs, until
from tests.system.helpers import events, started_swarm, swarm

from swarmabs_config.graph import CONTROLLER, options_of, services
from swarmabs_core.messages import TOPICS, EventKind

FOLDER = ROOT / "examples" / "own_node"
SOURCES = [FOLDER / "monitor.py", FOLDER / "monitor.cpp"]


PREFIXES = [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(":") if prefix]
NO_RCLCPP = not any((prefix / "include" / "rclcpp").is_dir() for prefix in PREFIXES)


def started_by(source: Path, folder: Path) -> str:
    """Return the shell command that starts a monitor; that in C++ is compiled."""
    if source.suffix == ".py":
        return f"{sys.executable} {source}"
    for words in (["cmake", "-S", FOLDER, "-B", folder], ["cmake", "--build", folder]):
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    return str(folder / "monitor")


@pytest.mark.system
@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    "source",
    [SOURCES[0], pytest.param(SOURCES[1], marks=pytest.mark.skipif(NO_RCLCPP, reason="rclcpp is not installed"))],
    ids=lambda path: path.suffix,
)
def test_the_monitor_sees_a_run_and_stops_it(nothing_survives: str, tmp_path: Path, source: Path) -> None:
    """It hears states and events, and its request brings every robot into its safe stop."""
    run, monitor_command = tmp_path / "run", started_by(source, tmp_path / "build")
    with started_swarm("run", "--realtime", "--duration", "5", "-o", run) as command:
        until((run / "logs" / "network.json").is_file, lambda: "the run has its network", 30.0)
        settings = swarm("env", run).out
        words = f"{settings}\nexec {monitor_command} --ros-args -p angle_limit:=0.05"
        surroundings = {**os.environ, "ROS_LOG_DIR": str(tmp_path)}
        monitor = subprocess.Popen(
            ["bash", "-ec", words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=surroundings
        )
        try:
            done = command.wait()
        finally:
            monitor.terminate()
            said = monitor.communicate(timeout=15)[0]
    assert monitor.returncode == 0, said
    assert done.code == 0, done.err
    assert re.search(r"step \d+: 0\.1000 rad is beyond 0\.05 rad: stop requested$", said, re.MULTILINE), said
    assert "stop accepted" in said
    assert re.search(r"step \d+: [+]0\.\d{4} rad, [+-]\d\.\d{3} N m$", said, re.MULTILINE), said
    stopped = {
        event.agent_id for event in events(run) if event.kind == EventKind.SAFE_STOP and "commanded" in event.detail
    }
    assert stopped == {1, 2, 3, 4}


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.suffix)
def test_topics_services_and_fields_of_the_monitor_exist(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    subscribed = dict(re.findall(r'create_subscription[(<](\w+)[^"]*?"([\w/]+)"', text))
    types = {topic.name: topic.type_name for topic in TOPICS}
    assert subscribed == {types[name]: name for name in subscribed.values()}
    assert set(subscribed.values()) == {"plane/state", "swarm/abstract_state", "swarm/events"}
    assert re.findall(r'create_client\W[^"]*"([\w/]+)"', text) == [services(CONTROLLER, options_of({}))[0]]
    used = {(kind, field) for kind, field in re.findall(r"\b(plane|swarm|event)\.([a-z_]+)\b", text)}
    fields = {
        kind: re.findall(
            r"^\w+(?:/\w+)? (\w+)(?![\w=])",
            (ROOT / "src/swarmabs_msgs/msg" / f"{message}.msg").read_text(encoding="utf-8"),
            re.MULTILINE,
        )
        for kind, message in {"plane": "PlaneState", "swarm": "AbstractState", "event": "SwarmEvent"}.items()
    }
    assert len(used) >= 7
    assert {(kind, field) for kind, field in used if field not in fields[kind]} == set()


def test_package_names_what_its_sources_include() -> None:
    depends = {each.text for each in ET.parse(FOLDER / "package.xml").getroot().findall("depend")}
    included = set(re.findall(r"^#include <(\w+)/", SOURCES[1].read_text(encoding="utf-8"), re.MULTILINE))
    assert included <= depends
    found = set(re.findall(r"find_package\((\w+)", (FOLDER / "CMakeLists.txt").read_text(encoding="utf-8")))
    assert included <= found


@pytest.fixture
def launched(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], list[Any]]:
    """Return a function that returns the actions of a launch file.

    They are stand-ins: the package `launch` comes with a complete ROS 2 only.
    """

    def kept(name: str) -> type:
        return type(
            name, (), {"__init__": lambda self, *given, **named: self.__dict__.update(given=given, named=named)}
        )

    for module, names in {
        "launch": ("LaunchDescription",),
        "launch.actions": ("DeclareLaunchArgument",),
        "launch.substitutions": ("LaunchConfiguration",),
        "launch_ros": (),
        "launch_ros.actions": ("Node",),
    }.items():
        stand_in = ModuleType(module)
        for name in names:
            setattr(stand_in, name, kept(name))
        monkeypatch.setitem(sys.modules, module, stand_in)

    def actions(name: str) -> list[Any]:
        (found,) = script(f"examples/own_node/{name}.launch.py").generate_launch_description().given
        return list(found)

    return actions


def test_the_launch_file_starts_the_monitor(launched: Callable[[str], list[Any]]) -> None:
    *declared, node = launched("monitor")
    (parameters,) = node.named["parameters"]
    assert {argument.given[0] for argument in declared} == {"executable", "namespace", *parameters}
    for path in SOURCES:
        (name,) = set(re.findall(r'declare_parameter\("(\w+)"', path.read_text(encoding="utf-8")))
        assert name in parameters
    assert declared[0].named["default_value"] in (FOLDER / "CMakeLists.txt").read_text(encoding="utf-8")


def test_the_launch_file_of_the_own_plane_starts_the_nodes_of_the_page(
    launched: Callable[[str], list[Any]],
) -> None:
    argument, *nodes, plane = launched("own_plane")
    page = read("docs/how-to/own_node.md")
    documented = {
        (module, tuple(re.findall(r"-p ([\w.]+):=", options)))
        for module, options in re.findall(r"^python -m (\w+)\.node --ros-args (.*) &$", page, re.MULTILINE)
    }
    found = {
        (node.named["package"], tuple(name for part in node.named["parameters"] for name in part)) for node in nodes
    }
    assert found == documented
    assert all(
        node.named["executable"] in {program.name for program in programs(node.named["package"])} for node in nodes
    )
    assert argument.given[0] in plane.named["parameters"][0]
    assert plane.named["executable"] in (FOLDER / "CMakeLists.txt").read_text(encoding="utf-8")
