"""Whole runs: as a command, and within this process; and their bags, read without the project's own reader."""

from __future__ import annotations

import hashlib
import json
import os
import re
import signal
import struct
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from mcap.reader import make_reader
from tests.processes import marked_processes, until

from swarmabs_bag.recording import Digest
from swarmabs_bag.run_folder import new_run_folder
from swarmabs_config.scenarios import find_scenario
from swarmabs_run.orchestration.lockstep_run import LockstepRun
from swarmabs_run.orchestration.plan import Arrange
from swarmabs_run.run import Outcome, RunOptions
from swarmabs_run.simulation import Simulation

MAIN_TOPICS = (
    *("plane/state", "swarm/agent_state", "swarm/abstract_state"),
    *("swarm/auxiliary_state", "swarm/desired_abstract_state"),
)
COORDINATORS = ("plane_sim", "abstraction_observer", "parent_controller", "recorder")
COMMAND = (sys.executable, "-m", "swarmabs_cli")
LONGEST = 100.0
"""Time, s, after which a command is taken to hang."""


def seconds(duration: float) -> str:
    """Return the override that shortens a scenario."""
    return f"duration={duration!r}"


# Commands


@dataclass(frozen=True)
class Finished:
    """How a command has ended."""

    code: int
    out: str
    err: str

    def summary(self) -> dict[str, Any]:
        """Return the one JSON document that the command has printed."""
        document = json.loads(self.out, parse_constant=_no_constant)
        assert isinstance(document, dict)
        return document


def _no_constant(name: str) -> None:
    raise AssertionError(f"{name} is not JSON")


def swarm(*arguments: object, cwd: Path | None = None) -> Finished:
    """Run a command to its end."""
    words = [*COMMAND, *map(str, arguments)]
    done = subprocess.run(words, cwd=cwd, capture_output=True, text=True, timeout=LONGEST, check=False)
    return Finished(done.returncode, done.stdout, done.stderr)


class Command:
    """A command that goes on, in a process group of its own."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process

    @property
    def pid(self) -> int:
        """Its process id, and the id of its process group."""
        return self.process.pid

    def wait(self) -> Finished:
        """Wait until it has ended."""
        out, err = self.process.communicate(timeout=LONGEST)
        return Finished(self.process.returncode, out, err)


@contextmanager
def started_swarm(*arguments: object, **options: Any) -> Iterator[Command]:
    """Start a command; it is killed at the end of the block if it has not ended."""
    with subprocess.Popen(
        [*COMMAND, *map(str, arguments)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        **options,
    ) as process:
        try:
            yield Command(process)
        finally:
            process.kill()


def run_log(folder: Path) -> str:
    """Return what the orchestrator has noted so far."""
    log = folder / "logs" / "orchestrator.log"
    return log.read_text(encoding="utf-8") if log.is_file() else ""


def until_stepping(folder: Path) -> None:
    """Wait until the processes of a run have met and the recorder writes."""
    until(lambda: "start" in run_log(folder), f"the run in {folder} has started", 60.0)
    bag = folder / "bag" / "bag_0.mcap"
    size = bag.stat().st_size
    until(lambda: bag.stat().st_size > size, f"the bag in {folder} grows", 60.0)


def named_processes(mark: str) -> dict[str, int]:
    """Return the process ids of a run's nodes by node name, as far as the kernel's 15 characters tell it."""
    known = {name[:15]: name for name in COORDINATORS}
    found = {}
    for pid, name in marked_processes(mark).items():
        if name in known or name.startswith("agent_"):
            assert name not in found, f"two processes {name}"
            found[known.get(name, name)] = pid
    return found


def signal_process(mark: str, name: str, number: signal.Signals) -> int:
    """Send a signal to the process of a node; return its id."""
    pid = named_processes(mark)[name]
    os.kill(pid, number)
    return pid


# Runs within this process


def lockstep(
    folder: Path,
    scenario: str = "pd_het_4",
    *overrides: str,
    arrange: Arrange = tuple,
    **options: Any,
) -> Outcome:
    """Run a scenario as processes, with these `RunOptions`."""
    loaded = find_scenario(scenario, overrides).resolved()
    return LockstepRun(loaded, new_run_folder(folder), RunOptions(**options), arrange).run()


@cache
def simulated_digest(scenario: str, *overrides: str) -> str:
    """Return the digest of a scenario, computed in this process without ROS and without a bag."""
    digest = Digest()
    for step in Simulation(find_scenario(scenario, overrides)).steps():
        digest.update(step)
    return digest.hexdigest()


# Bags


class BagMessage(NamedTuple):
    """A message as the mcap library reads it, with the numbers that stand in its bytes."""

    topic: str
    log_time: int
    publish_time: int
    stamp: int
    step: int
    agent_id: int
    payload: bytes


_HEAD = struct.Struct("<4siII6s6xQ")


def bag_file(folder: Path) -> Path:
    """Return the MCAP file of a run."""
    return folder / "bag" / "bag_0.mcap"


def bag_messages(folder: Path) -> list[BagMessage]:
    """Return all messages of a run's bag in the order of the file."""
    found = []
    with bag_file(folder).open("rb") as stream:
        for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False):
            topic = channel.topic.removeprefix("/")
            _, sec, nanosec, _, _, step = _HEAD.unpack_from(message.data)
            agent_id = 0
            if topic in {"swarm/agent_state", "swarm/events"}:
                offset = _HEAD.size + (8 if topic == "swarm/agent_state" else 0)
                (agent_id,) = struct.unpack_from("<H", message.data, offset)
            stamp = sec * 10**9 + nanosec
            times = (message.log_time, message.publish_time, stamp)
            found.append(BagMessage(topic, *times, step, agent_id, message.data))
    return found


def bag_digest(messages: Sequence[BagMessage]) -> str:
    """Return the digest of a run as its definition says, from what stands in the bag."""
    total = hashlib.sha256()
    main = [message for message in messages if message.topic in MAIN_TOPICS]
    for message in sorted(main, key=lambda m: (m.step, m.topic, m.agent_id)):
        total.update(message.topic.encode() + b"\0" + struct.pack("<I", len(message.payload)) + message.payload)
    return total.hexdigest()


def summary_of(folder: Path) -> dict[str, Any]:
    """Return the content of a run's summary.json."""
    document = json.loads((folder / "summary.json").read_text(encoding="utf-8"), parse_constant=_no_constant)
    assert isinstance(document, dict)
    return document


def domain_of(folder: Path) -> int:
    """Return the ROS domain of a run."""
    found = re.search(r"ROS domain (\d+)", run_log(folder))
    assert found is not None
    return int(found[1])
