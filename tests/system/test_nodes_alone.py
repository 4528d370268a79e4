"""Every node starts by itself, with parameters, and ends when it is told to."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from tests.processes import programs, until
from tests.system.helpers import LONGEST

from swarmabs_ros.status import REPORT_FD, START_FD

pytestmark = [pytest.mark.system, pytest.mark.timeout(60), pytest.mark.usefixtures("ros")]

NODES = {
    "plane_sim": ("plane_sim.node", ["-p", "members:=[1, 2]", "-p", "angle:=0.2"]),
    "abstraction_observer": ("abstraction_observer.node", ["-p", "members:=[1, 2]", "-p", "on_stall:=drop"]),
    "parent_controller": ("parent_controller.node", ["-p", "controller.type:=lqr", "-p", "controller.r:=2.0"]),
    "agent_node": ("agent_node.node", ["-p", "agent_id:=7", "-p", "kind:=double_integrator", "-p", "damping:=1"]),
}


def console_script(package: str) -> str:
    """Return the program that the package's console script runs, from its setup.cfg."""
    (entry,) = (program for program in programs(package) if program.name == package)
    return f"import sys; from {entry.module} import {entry.attr}; sys.exit({entry.attr}())"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("way", ["module", "console script"])
@pytest.mark.parametrize("name", NODES)
def test_a_node_starts_alone_and_stops_when_told(name: str, way: str, number: signal.Signals, tmp_path: Path) -> None:
    module, parameters = NODES[name]
    program = ["-m", module] if way == "module" else ["-c", console_script(name)]
    log = tmp_path / "log"
    quiet = {key: text for key, text in os.environ.items() if key not in {REPORT_FD, START_FD}}
    with (
        log.open("w") as stream,
        subprocess.Popen(
            [sys.executable, *program, "--ros-args", *parameters], stdout=stream, stderr=stream, env=quiet
        ) as process,
    ):
        until(lambda: "ready" in log.read_text(encoding="utf-8") or process.poll() is not None, f"{name} is ready")
        assert process.poll() is None, log.read_text(encoding="utf-8")
        process.send_signal(number)
        code = process.wait(LONGEST)
    text = log.read_text(encoding="utf-8")
    assert code == 0, text
    assert "Traceback" not in text


@pytest.mark.parametrize("name", NODES)
def test_a_node_refuses_a_wrong_parameter(name: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", NODES[name][0], "--ros-args", "-p", "stall_timeout:=-1.0"],
        capture_output=True,
        text=True,
        timeout=LONGEST,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr.startswith("error: parameter stall_timeout: ")
    assert done.stderr.count("\n") == 1
