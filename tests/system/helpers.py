"""Whole runs: as a command, and within this process; and their bags, read without the project's own reader."""

import hashlib
import io
import json
import os
import signal
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from mcap.reader import make_reader
from tests.processes import marked_processes, until

from swarmabs_bag.run.digest import Digest
from swarmabs_bag.run_folder import new_run_folder
from swarmabs_cli import main
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.cdr import decode
from swarmabs_core.messages import SwarmEvent
from swarmabs_run.orchestration.lockstep_run import LockstepRun
from swarmabs_run.orchestration.plan import Arrange
from swarmabs_run.orchestration.realtime_run import RealtimeRun
from swarmabs_run.run import Outcome, Progress, RunOptions
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
    return f"duration={duration!r}"


def parsed(text: str) -> dict[str, Any]:
    """Return the one JSON document of a text."""
    document = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert isinstance(document, dict)
    return document


@dataclass(frozen=True)
class Finished:
    code: int
    out: str
    err: str

    def summary(self) -> dict[str, Any]:
        return parsed(self.out)


def swarm(*arguments: object) -> Finished:
    """Carry out a command in this process."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = main([*map(str, arguments)])
    return Finished(code, out.getvalue(), err.getvalue())


@dataclass(frozen=True)
class Command:
    """A command that is a process, in a group of its own."""

    process: subprocess.Popen[str]

    def wait(self) -> Finished:
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


def view_address(command: Command) -> str:
    """Return the address of the page that a run has printed, once it has."""
    assert command.process.stderr is not None
    for line in command.process.stderr:
        if line.startswith("view: "):
            return line.removeprefix("view: ").strip()
    raise AssertionError("the command has printed no address")


def run_log(folder: Path) -> str:
    log = folder / "logs" / "orchestrator.log"
    return log.read_text(encoding="utf-8") if log.is_file() else ""


def until_stepping(folder: Path, *, simulated: bool = False) -> None:
    """Wait until the processes of a run have met, or it is simulated, and the bag grows."""
    until(lambda: simulated or "start" in run_log(folder), f"the run in {folder} has started")
    bag = bag_file(folder)
    until(bag.is_file, f"there is {bag}")
    size = bag.stat().st_size
    until(lambda: bag.stat().st_size > size, f"{bag} grows")


def named_processes(mark: str) -> dict[str, int]:
    """Return the process ids of a run's nodes by node name, as far as the kernel's 15 characters tell it."""
    full = {name[:15]: name for name in COORDINATORS}
    names = [(full.get(name, name), pid) for pid, name in marked_processes(mark).items()]
    nodes = [(name, pid) for name, pid in names if name in COORDINATORS or name.startswith("agent_")]
    assert len(dict(nodes)) == len(nodes), f"two processes of a node: {nodes}"
    return dict(nodes)


def signal_process(mark: str, name: str, number: signal.Signals) -> int:
    pid = named_processes(mark)[name]
    os.kill(pid, number)
    return pid


FOREVER = seconds(100_000.0)


def lockstep(
    folder: Path, scenario: str = "pd_het_4", *overrides: str, arrange: Arrange = tuple, **options: Any
) -> Outcome:
    """Run a scenario as processes, with these `RunOptions`."""
    loaded = find_scenario(scenario, overrides).resolved()
    return LockstepRun(loaded, new_run_folder(folder), RunOptions(**options), arrange).run()


def realtime(folder: Path, *overrides: str, **options: Any) -> Outcome:
    """Run a scenario as processes in real time, with these `RunOptions`."""
    loaded = find_scenario("pd_het_4", overrides).resolved()
    return RealtimeRun(loaded, new_run_folder(folder), RunOptions(**options)).run()


def at(acts: Mapping[int, Callable[[], object]]) -> Callable[[Progress], None]:
    """Return what acts as soon as so many steps of a run are recorded: to be given as `RunOptions.on_progress`.

    It waits for the controller's first answer, since in real time robots may be late: all have been heard by then.
    """
    waiting = sorted(acts.items())

    def watch(progress: Progress) -> None:
        while waiting and progress.error is not None and progress.step >= waiting[0][0]:
            waiting.pop(0)[1]()

    return watch


def interrupt() -> None:
    """Do as Ctrl-C does to a run within this process."""
    os.kill(os.getpid(), signal.SIGINT)


@cache
def simulated_digest(scenario: str, *overrides: str) -> str:
    """Return the digest of a scenario, computed in this process without ROS and without a bag."""
    digest = Digest()
    for step in Simulation(find_scenario(scenario, overrides)).steps():
        digest.update(step)
    return digest.hexdigest()


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
    return folder / "bag" / "bag_0.mcap"


def bag_messages(folder: Path) -> list[BagMessage]:
    messages = []
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
            messages.append(BagMessage(topic, *times, step, agent_id, message.data))
    return messages


def events(folder: Path) -> list[SwarmEvent]:
    recorded = [
        decode(SwarmEvent, message.payload) for message in bag_messages(folder) if message.topic == "swarm/events"
    ]
    assert all(isinstance(event, SwarmEvent) for event in recorded)
    return recorded  # type: ignore[return-value]


def bag_digest(messages: Sequence[BagMessage]) -> str:
    """Return the digest of a run as its definition says, from what stands in the bag."""
    total = hashlib.sha256()
    main = [message for message in messages if message.topic in MAIN_TOPICS]
    for message in sorted(main, key=lambda m: (m.step, m.topic, m.agent_id)):
        total.update(message.topic.encode() + b"\0" + struct.pack("<I", len(message.payload)) + message.payload)
    return total.hexdigest()


def summary_of(folder: Path) -> dict[str, Any]:
    return parsed((folder / "summary.json").read_text(encoding="utf-8"))
