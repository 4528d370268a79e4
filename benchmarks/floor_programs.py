"""Driving the floor programs in ``benchmarks/floors``, which share no code with the product."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from benchmarks.processes import Load, crew_of, load_between, sample

from swarmabs_config.graph import COORDINATORS
from swarmabs_config.ports import domains_spanned
from swarmabs_core.errors import RunError
from swarmabs_run.orchestration.network import claimed_domain, dds_environment, profile_xml
from swarmabs_run.tracing_files import tracing_files_removed

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from typing_extensions import Self

FOLDER = Path(__file__).parent / "floors"
START_SECONDS = 150.0
"""Longest time, s, until a floor program has met."""
ANSWER_SECONDS = 30.0
END_SECONDS = 10.0
"""Longest time, s, that a floor program may take to end; then it is killed, and the kernel ends its processes."""


@dataclass(frozen=True, slots=True)
class Floor:
    """A floor program: its file, its arguments, and whether it needs a DDS network."""

    program: str
    arguments: tuple[str, ...] = ()
    dds: bool = False


FLOORS = {
    "rclpy_best_effort": Floor("rclpy_floor.py", dds=True),
    "rclpy_reliable": Floor("rclpy_floor.py", ("--reliable-broadcasts",), dds=True),
    "zeromq": Floor("zeromq_floor.py"),
    "datagrams": Floor("datagram_floor.py"),
}
BARE_RCLPY = ("rclpy_best_effort", "rclpy_reliable")
"""The better of these is the floor of a run over DDS."""


@dataclass(frozen=True, slots=True)
class FloorResult:
    """Speed of a floor program, the time until its processes had met (s), and what it cost."""

    steps_per_second: float
    start_seconds: float
    load: Load


def measure_floor(name: str, robots: int, *, warm_up: float, window: float) -> FloorResult:
    """Run a floor program and measure a window of it.

    Parameters
    ----------
    name : str
        One of `FLOORS`.
    robots : int
        How many robots.
    warm_up, window : float
        Time before and of the measurement, s.

    Raises
    ------
    RunError
        If its processes do not meet, one of them fails, or no step is made.
    """
    floor = FLOORS[name]
    with ExitStack() as stack:
        environment: Mapping[str, str] = {}
        if floor.dds:
            environment = stack.enter_context(_network(COORDINATORS + robots))
        command = [str(FOLDER / floor.program), "--robots", str(robots), *floor.arguments]
        program = stack.enter_context(_Program(name, command, environment))
        started = program.answer(START_SECONDS)
        time.sleep(warm_up)
        crew = crew_of(program.pid)
        first = program.ask()
        before = sample(crew, first["step"], first["time"])
        time.sleep(window)
        last = program.ask()
        load = load_between(before, sample(crew, last["step"], last["time"]), crew)
        if load is None:
            raise RunError(f"floor {name} with {robots} robots: no step in {window:g} s")
        return FloorResult(load.steps / load.seconds, started["start_seconds"], load)


@contextmanager
def _network(participants: int) -> Iterator[dict[str, str]]:
    """Claim a ROS domain and yield the environment variables of those who take part in it."""
    with (
        tracing_files_removed(),
        claimed_domain(domains_spanned(participants)) as domain,
        TemporaryDirectory(prefix="swarmabs-bench-") as folder,
    ):
        profile = Path(folder) / "fastdds.xml"
        profile.write_text(profile_xml(domain), encoding="utf-8")
        yield dds_environment(domain, str(profile))


class _Program:
    """A floor program that runs; it ends, with all its processes, when its standard input does."""

    def __init__(self, name: str, command: list[str], environment: Mapping[str, str]) -> None:
        self._name = name
        self._pending = b""
        search = os.pathsep.join(filter(None, (str(FOLDER), os.environ.get("PYTHONPATH"))))
        self._process = subprocess.Popen(
            [sys.executable, *command],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**os.environ, **environment, "PYTHONPATH": search, "OPENBLAS_NUM_THREADS": "1"},
            start_new_session=True,  # Ctrl-C in a terminal is for us alone
        )

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def ask(self) -> dict[str, Any]:
        """Ask how far it is."""
        stdin = self._process.stdin
        if stdin is not None:
            with suppress(BrokenPipeError):
                stdin.write(b"\n")
                stdin.flush()
        return self.answer(ANSWER_SECONDS)

    def answer(self, seconds: float) -> dict[str, Any]:
        """Return the next thing it says.

        Raises
        ------
        RunError
            If it says nothing in this time, or has failed.
        """
        stdout = self._process.stdout
        deadline = time.monotonic() + seconds
        while stdout is not None and b"\n" not in self._pending:
            readable, _, _ = select.select([stdout], [], [], max(0.0, deadline - time.monotonic()))
            data = os.read(stdout.fileno(), 65536) if readable else b""
            if not data:
                raise RunError(f"floor {self._name}: {self._end() or f'no answer in {seconds:g} s'}")
            self._pending += data
        line, _, self._pending = self._pending.partition(b"\n")
        found: dict[str, Any] = json.loads(line)
        return found

    def _end(self) -> str:
        """End it and return the last line that it wrote about what went wrong."""
        try:
            _, errors = self._process.communicate(timeout=END_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            _, errors = self._process.communicate()
        except ValueError:  # ended before
            return ""
        lines = errors.decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else ""
