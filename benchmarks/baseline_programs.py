"""Runs the baseline programs in ``benchmarks/baselines``, which share no code with the product."""

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

from benchmarks.processes import Load, load_between, sample, workers_of

from swarmabs_config.graph import COORDINATORS
from swarmabs_core.errors import RunError
from swarmabs_run.orchestration.network import claimed_domain, dds_environment, profile_xml
from swarmabs_run.tracing_files import tracing_files_removed

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from typing_extensions import Self

FOLDER = Path(__file__).parent / "baselines"
START_SECONDS = 150.0
"""Time limit, s, for the processes of a baseline program to connect."""
ANSWER_SECONDS = 30.0
END_SECONDS = 10.0
"""Time limit, s, for a baseline program to end; then it is killed, and the kernel kills its processes."""


@dataclass(frozen=True, slots=True)
class Baseline:
    """A baseline program: its file, its arguments, and whether it needs a DDS network."""

    program: str
    arguments: tuple[str, ...] = ()
    dds: bool = False


BASELINES = {
    "rclpy_best_effort": Baseline("rclpy_baseline.py", dds=True),
    "rclpy_reliable": Baseline("rclpy_baseline.py", ("--reliable-broadcasts",), dds=True),
    "zeromq": Baseline("zeromq_baseline.py"),
    "datagrams": Baseline("datagram_baseline.py"),
}
BARE_RCLPY = ("rclpy_best_effort", "rclpy_reliable")
"""The faster of these is the baseline of a run over DDS."""


@dataclass(frozen=True, slots=True)
class BaselineResult:
    """Speed of a baseline program, the time until its processes were connected (s), and its load."""

    steps_per_second: float
    start_seconds: float
    load: Load


def measure_baseline(name: str, robots: int, *, warm_up: float, window: float) -> BaselineResult:
    """Run a baseline program and measure it for a window.

    Parameters
    ----------
    name : str
        One of `BASELINES`.
    robots : int
        Number of robots.
    warm_up, window : float
        Duration of the warm-up and of the measurement, s.

    Raises
    ------
    RunError
        If its processes do not connect, one of them fails, or it makes no step.
    """
    baseline = BASELINES[name]
    with ExitStack() as stack:
        environment: Mapping[str, str] = {}
        if baseline.dds:
            environment = stack.enter_context(_network(COORDINATORS + robots))
        command = [str(FOLDER / baseline.program), "--robots", str(robots), *baseline.arguments]
        program = stack.enter_context(_Program(name, command, environment))
        started = program.answer(START_SECONDS)
        time.sleep(warm_up)
        workers = workers_of(program.pid)
        first = program.ask()
        before = sample(workers, first["step"], first["time"])
        time.sleep(window)
        last = program.ask()
        load = load_between(before, sample(workers, last["step"], last["time"]), workers)
        if load is None:
            raise RunError(f"baseline {name} with {robots} robots: no step in {window:g} s")
        return BaselineResult(load.steps / load.seconds, started["start_seconds"], load)


@contextmanager
def _network(participants: int) -> Iterator[dict[str, str]]:
    """Claim a ROS domain and yield the environment variables of its participants."""
    with (
        tracing_files_removed(),
        claimed_domain(participants) as domain,
        TemporaryDirectory(prefix="swarmabs-bench-") as folder,
    ):
        profile = Path(folder) / "fastdds.xml"
        profile.write_text(profile_xml(domain), encoding="utf-8")
        yield dds_environment(domain, str(profile))


class _Program:
    """A running baseline program; it ends, with all its processes, when its standard input closes."""

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
            start_new_session=True,  # Ctrl-C in a terminal reaches only this process
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
        """Request the current step."""
        stdin = self._process.stdin
        if stdin is not None:
            with suppress(BrokenPipeError):
                stdin.write(b"\n")
                stdin.flush()
        return self.answer(ANSWER_SECONDS)

    def answer(self, seconds: float) -> dict[str, Any]:
        """Return the next line of its output.

        Raises
        ------
        RunError
            If it prints nothing in this time, or has failed.
        """
        stdout = self._process.stdout
        deadline = time.monotonic() + seconds
        while stdout is not None and b"\n" not in self._pending:
            readable, _, _ = select.select([stdout], [], [], max(0.0, deadline - time.monotonic()))
            data = os.read(stdout.fileno(), 65536) if readable else b""
            if not data:
                raise RunError(f"baseline {self._name}: {self._end() or f'no answer in {seconds:g} s'}")
            self._pending += data
        line, _, self._pending = self._pending.partition(b"\n")
        found: dict[str, Any] = json.loads(line)
        return found

    def _end(self) -> str:
        """Stop the program and return the last line of its errors."""
        try:
            _, errors = self._process.communicate(timeout=END_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            _, errors = self._process.communicate()
        except ValueError:  # already ended
            return ""
        lines = errors.decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else ""
