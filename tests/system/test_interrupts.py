"""However a run is ended from outside, nothing of it stays behind: the fixture of all system tests proves that."""

from __future__ import annotations

import json
import os
import random
import shlex
import signal
import subprocess
import time
from pathlib import Path

import pytest
from tests.processes import marked_processes, until
from tests.system.helpers import (
    COMMAND,
    bag_messages,
    domain_of,
    run_log,
    started_swarm,
    summary_of,
    swarm,
    until_stepping,
)

from swarmabs_bag.reader import open_bag

pytestmark = [pytest.mark.system, pytest.mark.timeout(120)]

FOREVER = ("--duration", 100_000)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_the_orchestrator_alone_is_told_to_end(folder: Path, number: signal.Signals) -> None:
    with started_swarm("run", *FOREVER, "-o", folder, "--json") as command:
        until_stepping(folder)
        os.kill(command.pid, number)
        done = command.wait()
    assert done.code == 1
    assert "error: interrupted" in done.err
    assert "Traceback" not in done.err
    assert done.summary() == summary_of(folder)
    assert summary_of(folder)["status"] == summary_of(folder)["reason"] == "interrupted"
    assert open_bag(folder).aborted() == "interrupted"
    assert (folder / "bag" / "metadata.yaml").is_file()
    assert len(bag_messages(folder)) == summary_of(folder)["messages"] > 0


def test_control_c_reaches_the_whole_process_group(folder: Path) -> None:
    with started_swarm("run", *FOREVER, "-o", folder) as command:
        until_stepping(folder)
        os.killpg(command.pid, signal.SIGINT)
        done = command.wait()
    assert done.code == 1
    assert "Traceback" not in done.err
    assert summary_of(folder)["status"] == "interrupted"
    assert len(bag_messages(folder)) == summary_of(folder)["messages"] > 0
    assert not [log for log in (folder / "logs").glob("*.log") if "Traceback" in log.read_text(encoding="utf-8")]


def test_an_impatient_user(folder: Path) -> None:
    with started_swarm("run", *FOREVER, "-o", folder) as command:
        until_stepping(folder)
        for _ in range(20):
            os.killpg(command.pid, signal.SIGINT)
            time.sleep(0.005)
        done = command.wait()
    assert done.code == 1
    assert "Traceback" not in done.err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_while_processes_start(folder: Path, mark: str, number: signal.Signals) -> None:
    with started_swarm("run", "arise_het_20", *FOREVER, "-o", folder) as command:
        until(lambda: len(marked_processes(mark)) > 8, "some processes have started")
        os.kill(command.pid, number)
        done = command.wait()
    assert done.code == 1
    assert "Traceback" not in done.err
    assert summary_of(folder)["status"] == "interrupted"


@pytest.mark.parametrize("seed", range(6))
def test_the_orchestrator_is_killed_at_any_moment(folder: Path, mark: str, seed: int) -> None:
    """During the start and while stepping: the launcher, its children and their ports go with it."""
    with started_swarm("run", *FOREVER, "-o", folder) as command:
        until((folder / "logs" / "launcher.log").exists, "the launcher is started", 30.0)
        time.sleep(random.Random(seed).uniform(0.0, 3.0))
        os.kill(command.pid, signal.SIGKILL)
        command.wait()
    until(lambda: not marked_processes(mark), "all processes are gone")


def test_a_domain_is_free_again_after_its_run_was_killed(folder: Path, tmp_path: Path) -> None:
    with started_swarm("run", *FOREVER, "-o", folder) as command:
        until_stepping(folder)
        domain = domain_of(folder)
        other = swarm("run", "--duration", 0.1, "-o", tmp_path / "beside")
        assert other.code == 0, other.err
        assert domain_of(tmp_path / "beside") != domain
        command.process.kill()
        command.wait()
    again = swarm("run", "--duration", 0.1, "-o", tmp_path / "after")
    assert again.code == 0, again.err


def test_simulate_is_interrupted_the_same_way(folder: Path) -> None:
    with started_swarm("simulate", *FOREVER, "-o", folder) as command:
        until((folder / "bag" / "bag_0.mcap").is_file, "the bag is there", 30.0)
        size = (folder / "bag" / "bag_0.mcap").stat().st_size
        until(lambda: (folder / "bag" / "bag_0.mcap").stat().st_size > size, "the bag grows", 30.0)
        command.process.terminate()
        done = command.wait()
    assert done.code == 1
    assert "Traceback" not in done.err
    assert summary_of(folder)["status"] == "interrupted"
    assert len(bag_messages(folder)) == summary_of(folder)["messages"]
    assert run_log(folder) == ""


_PRIVATE = ("unshare", "--user", "--map-root-user", "--mount", "--propagation", "private", "sh", "-c")
"""Starts a shell whose mounts are its own."""


@pytest.mark.parametrize("number", [None, signal.SIGINT])
def test_nothing_of_the_tracing_library_is_left(folder: Path, number: signal.Signals | None) -> None:
    """Where no other program has loaded rclpy, which this very process has."""
    words = [*COMMAND, "run", "--duration", "1" if number is None else "100000", "-o", str(folder)]
    script = f"mount -t tmpfs tmpfs /dev/shm || exit 77; {shlex.join(words)} >&2; ls /dev/shm"
    with subprocess.Popen([*_PRIVATE, script], stdout=subprocess.PIPE, text=True, start_new_session=True) as shell:
        if number is not None:
            until_stepping(folder)
            network = json.loads((folder / "logs" / "network.json").read_text(encoding="utf-8"))
            os.kill(network["orchestrator"], number)
        left, _ = shell.communicate(timeout=60.0)
    if shell.returncode == 77:
        pytest.skip("this user may not mount anything here")
    assert summary_of(folder)["status"] == ("ok" if number is None else "interrupted")
    assert left == ""
