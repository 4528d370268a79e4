"""A run that cannot go on ends within seconds, names who is to blame, and leaves a readable bag."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.processes import marked_processes, until
from tests.system.helpers import (
    COORDINATORS,
    Finished,
    bag_messages,
    named_processes,
    run_log,
    signal_process,
    started_swarm,
    summary_of,
    swarm,
    until_stepping,
)

from swarmabs_bag.reader import open_bag

pytestmark = [pytest.mark.system, pytest.mark.timeout(120)]

FOREVER = ("--duration", 100_000)
QUICK = ("--set", "lockstep.stall_timeout=0.5")


def readable_steps(folder: Path) -> int:
    """Return how many complete steps the bag of a failed run holds, read without the project's own reader."""
    messages = bag_messages(folder)
    counts = [0] * (max(message.step for message in messages) + 1)
    for message in messages:
        if message.topic != "swarm/events":
            counts[message.step] += 1
    # A full disk cuts where it must; before the last step nothing is missing.
    assert counts[:-1] == [8] * (len(counts) - 1)
    return len(counts)


def failed(done: Finished, folder: Path, *words: str) -> None:
    """Check that a run has failed in an orderly way and says why."""
    assert done.code == 1, (done.code, done.err)
    assert "Traceback" not in done.err
    for word in words:
        assert word in done.err
        assert word in run_log(folder)
    summary = summary_of(folder)
    assert summary["status"] == "failed"
    assert summary["reason"] in done.err
    assert summary == done.summary()


@pytest.mark.parametrize("name", ["agent_003", *COORDINATORS])
def test_a_process_that_is_killed_is_named_with_its_last_lines(folder: Path, mark: str, name: str) -> None:
    with started_swarm("run", *FOREVER, "-o", folder, "--json") as command:
        until_stepping(folder)
        if name == "recorder":  # which may be in the middle of the first chunk
            until(lambda: open_bag(folder, damaged=True).message_count > 0, "a chunk is written", 60.0)
        pid = signal_process(mark, name, signal.SIGKILL)
        done = command.wait()
    failed(done, folder, f"{name} (process {pid}) was killed by SIGKILL", f"last lines of {name}.log:")
    if name != "recorder":
        assert readable_steps(folder) > 0
    else:  # the file has no end, but what the recorder had handed over is there
        assert open_bag(folder, damaged=True).message_count > 0


DROP = ("--set", "lockstep.on_stall=drop")
"""Of robots that wait for another node none is dropped."""


@pytest.mark.parametrize(
    ("name", "words"), [("agent_002", ()), *((name, ()) for name in COORDINATORS), ("plane_sim", DROP)]
)
def test_a_process_that_is_silent_is_named_with_its_state(
    folder: Path, mark: str, name: str, words: tuple[str, ...]
) -> None:
    with started_swarm("run", *FOREVER, *QUICK, *words, "-o", folder, "--json") as command:
        until_stepping(folder)
        pid = signal_process(mark, name, signal.SIGSTOP)
        done = command.wait()
    shown = name.replace("agent_", "agent ")
    failed(done, folder, f"{shown} (process {pid} is stopped) has not answered step ")
    if name != "recorder":
        assert readable_steps(folder) > 0


def test_a_launcher_that_is_killed_is_named(folder: Path, mark: str) -> None:
    with started_swarm("run", *FOREVER, "-o", folder, "--json") as command:
        until_stepping(folder)
        nodes = set(named_processes(mark).values())
        (launcher,) = set(marked_processes(mark)) - nodes - {command.pid}
        os.kill(launcher, signal.SIGKILL)
        done = command.wait()
    failed(done, folder, "the launcher")


def test_a_node_that_fails_by_itself_speaks_for_itself(folder: Path) -> None:
    """A plane without friction, far off, that two tiny robots cannot hold."""
    done = swarm(
        *("run", "pd_si_4", "--duration", 30, "-o", folder, "--json"),
        *("--set", "plane.disturbance={amplitude: 500.0, angular_frequency: 1.0}"),
    )
    failed(done, folder, "parent_controller", "the plane's angle is")
    assert readable_steps(folder) > 0


# Disk full


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """Mount a file system of 1 MiB."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", disk], capture_output=True, check=False)
    if mounted.returncode:
        pytest.skip("only root can mount a small disk; test_a_file_that_may_not_grow shows the same")
    yield disk
    subprocess.run(["umount", disk], check=True)


def test_a_disk_that_fills_up_is_named_and_the_bag_readable(small_disk: Path) -> None:
    folder = small_disk / "run"
    done = swarm("run", *FOREVER, "-o", folder)
    assert done.code == 1, done.err
    assert "No space left on device" in done.err
    assert "Traceback" not in done.err
    assert readable_steps(folder) > 100


def test_a_file_that_may_not_grow_is_named_and_the_bag_readable(folder: Path) -> None:
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (600_000, 600_000))

    with started_swarm("run", *FOREVER, "-o", folder, preexec_fn=limit) as command:
        done = command.wait()
    assert done.code == 1, done.err
    assert "File too large" in done.err
    assert "Traceback" not in done.err
    assert readable_steps(folder) > 100
    assert summary_of(folder)["status"] == "failed"


def test_simulate_on_a_disk_that_fills_up_ends_the_same_way(small_disk: Path) -> None:
    folder = small_disk / "run"
    done = swarm("simulate", *FOREVER, "-o", folder)
    assert done.code == 1, done.err
    assert "No space left on device" in done.err
    assert "Traceback" not in done.err
    assert readable_steps(folder) > 100


def test_no_domain_is_left(folder: Path) -> None:
    """Whoever is refused a domain has started nothing."""
    script = (
        "import sys; import swarmabs_run.orchestration.network as d; d._claim = lambda _: [];"
        "from swarmabs_cli import main; sys.exit(main(sys.argv[1:]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, "run", "-o", folder],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 1
    assert "no ROS domain is free" in done.stderr
