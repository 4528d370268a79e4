"""What commands and processes load: a start is quick if nothing is loaded before it is needed."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from swarmabs_cli import PARSE_ONLY, main
from swarmabs_ros.status import REPORT_FD

NUMERICAL = {"numpy", "scipy"}
MODELS = {"pydantic", "yaml", "swarmabs_config.scenario"}
PRINTING = {"rich", "jinja2", "matplotlib", "aiohttp"}
ROS = {"rclpy", "swarmabs_msgs"}
BAGS = {"mcap", "swarmabs_bag"}
SWEEPS = {"dask", "distributed", "pyarrow", "pandas"}
NODE = NUMERICAL | MODELS - {"yaml"} | PRINTING | BAGS | SWEEPS | {"psutil"}
"""What no node but the recorder needs; rclpy itself loads YAML."""
ALL = NUMERICAL | MODELS | PRINTING | ROS | BAGS | SWEEPS | {"psutil"}

MAIN = """
import json, sys
from swarmabs_cli import main
def stop(*given, **options):
    print(json.dumps([*sys.modules]))
    sys.stdout.flush()
    os._exit(0)
import os
{before}
main({arguments})
stop()
"""
AT_LAUNCHER = "from swarmabs_run.orchestration import launcher_process as at; at.LauncherProcess = stop"
AT_NODES = "from swarmabs_run.orchestration.machine import Machine as at; at.spawn = stop"


def loaded(arguments: list[str], before: str = "") -> set[str]:
    """Return the modules that a command has loaded at its end, or where `before` makes it stop."""
    program = MAIN.format(before=before, arguments=arguments)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    return set(json.loads(done.stdout.splitlines()[-1]))


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["run", "--help"]])
def test_help_loads_nothing(arguments: list[str]) -> None:
    assert not ALL & loaded(arguments)


def test_info_loads_no_repair() -> None:
    found = loaded(["info", "--help"])
    assert "swarmabs_bag.info" in found
    assert not {"swarmabs_bag.repair.bag", "swarmabs_bag.merge"} & found


def test_a_run_starts_its_launcher_before_it_loads_anything() -> None:
    assert not ALL & loaded(["run"], AT_LAUNCHER)


def test_a_run_loads_no_mathematics_and_no_ros_before_its_processes_start(tmp_path: Path) -> None:
    arguments = ["run", "--duration", "1", "-o", str(tmp_path / "run")]
    found = loaded(arguments, AT_NODES)
    assert found >= MODELS
    assert not (NUMERICAL | ROS | SWEEPS | {"mcap", "matplotlib", "aiohttp"}) & found


@pytest.mark.parametrize(
    ("modules", "heavy"),
    [
        ("swarmabs_run.orchestration.launcher_process", ALL | {"swarmabs_config"}),
        ("swarmabs_run.orchestration.launcher", NODE),
        ("agent_node.node, plane_sim.node, abstraction_observer.node, parent_controller.node", NODE),
        ("swarmabs_analysis.sweep.evaluate", PRINTING | ROS | SWEEPS | {"scipy", "psutil"}),
        ("swarmabs_core.behaviours, swarmabs_core.controllers", ALL),
        ("swarmabs_config.theory", ALL - NUMERICAL - MODELS | {"scipy"}),
    ],
)
def test_processes_load_only_what_they_need(modules: str, heavy: set[str]) -> None:
    """What the launcher and its nodes load takes time and memory in every run."""
    said = f"import json, sys, {modules}; print(json.dumps([*sys.modules]))"
    done = subprocess.run([sys.executable, "-c", said], capture_output=True, text=True, check=True)
    found = set(json.loads(done.stdout))
    assert modules.partition(",")[0] in found
    assert not heavy & found


LOG_IN_A_NODE = """
import os, sys
from rclpy.logging import get_logger
from swarmabs_run.orchestration import launcher
def spawned(self):
    realpath, resolved = os.path.realpath, []
    os.path.realpath = lambda *given, **options: resolved.append(given) or realpath(*given, **options)
    get_logger("node").info("ready")
    print(len(resolved))
launcher.Launcher.run = spawned
sys.argv[1:] = ["lockstep"]
launcher.main()
"""


def test_nodes_inherit_the_paths_that_their_first_log_message_needs() -> None:
    environment = {**os.environ, REPORT_FD: "2"}
    program = [sys.executable, "-c", LOG_IN_A_NODE]
    done = subprocess.run(program, env=environment, capture_output=True, text=True, check=True)
    assert int(done.stdout) < 20  # otherwise one for each loaded module, several hundred


def test_an_interruption_before_the_command_line_is_loaded_ends_it_in_one_line(tmp_path: Path) -> None:
    def interrupted() -> None:
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # as scripts/swarm does
        os.kill(os.getpid(), signal.SIGINT)

    command = [sys.executable, "-m", "swarmabs_cli", "run", "-o", str(tmp_path / "run")]
    ended = subprocess.run(command, preexec_fn=interrupted, text=True, capture_output=True, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (1, "", "interrupted\n")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(("words", "code"), [("view --nope", 2), ("sweep", 2), ("view", 0), ("view --help", 0)])
def test_a_command_line_is_parsed_without_being_carried_out(
    words: str, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(PARSE_ONLY, "1")
    assert main(words.split()) == code
    assert capsys.readouterr().err.startswith("error: ") == bool(code)
