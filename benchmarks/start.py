"""Start, memory and end of a run as users see them: the command as a process, interrupted by Ctrl-C."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import psutil
from benchmarks.common import Settings, program, row, spread, swarm_of, tell
from benchmarks.processes import Memory, memory_of, workers_of

from swarmabs_config.scenario import dump_scenario
from swarmabs_core.errors import RunError
from swarmabs_run.ending import die_with_parent
from swarmabs_run.orchestration.process_run import STARTED_AGAIN

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from typing import IO

START_SECONDS = 180.0
"""Time limit, s, from the command to the first step."""
END_SECONDS = 60.0
"""Time limit, s, from Ctrl-C to the end of the command."""
_STEPS = 30_000
_LINE = 65536
PER_CORE = 2
"""Number of busy processes per core."""


@dataclass(frozen=True, slots=True)
class LaunchResult:
    """Start and end of a run.

    Parameters
    ----------
    start_seconds, shut_down_seconds : float
        From the command to the first step, and from Ctrl-C to the end of all processes.
    memory : Memory
        After the warm-up.
    retried : int
        Number of processes that failed to start and were started again.
    """

    start_seconds: float
    shut_down_seconds: float
    memory: Memory
    retried: int


def measure(settings: Settings) -> dict[str, Any]:
    """Measure start, memory and end of the same runs, on a busy machine if requested."""
    start, memory = [], []
    with busy_machine() if settings.busy else nullcontext():
        for robots in settings.robots:
            results, failures = _launches(robots, settings)
            start.append(start_row(robots, results, failures, busy=settings.busy))
            summary = {
                "agent_bytes": spread(result.memory.agent_median for result in results),
                "total_bytes": spread(result.memory.total for result in results),
            }
            memory.append(row(robots, (result.memory for result in results), summary))
    return {"start": start, "memory": memory}


def _launches(robots: int, settings: Settings) -> tuple[list[LaunchResult], list[str]]:
    """Return the clean starts and the errors of the others; the suite measures how many starts are clean."""
    results: list[LaunchResult] = []
    failures: list[str] = []
    starts = settings.starts or settings.repeat
    for number in range(starts):
        tell(f"{robots} robots, start {number + 1} of {starts}: start, memory and end")
        try:
            result = measure_launch(robots, warm_up=settings.warm_up)
        except RunError as error:
            failures.append(str(error))
            tell(f"  {error}")
            continue
        tell(
            f"  first step after {result.start_seconds:.1f} s, {result.memory.agent_median / 2**20:.1f} MiB per robot, "
            f"ended after {result.shut_down_seconds:.1f} s"
        )
        results.append(result)
    return results, failures


def start_row(robots: int, results: Sequence[LaunchResult], failures: Sequence[str], *, busy: bool) -> dict[str, Any]:
    """Summarise the starts of a swarm; in a clean start all processes connect and the first step is made."""
    return {
        "robots": robots,
        "starts": len(results) + len(failures),
        "clean": len(results),
        "retried": sum(result.retried for result in results),
        "busy_processes": busy_processes() if busy else 0,
        "failures": list(failures),
        "summary": {
            "start_seconds": spread(result.start_seconds for result in results),
            "shut_down_seconds": spread(result.shut_down_seconds for result in results),
        },
        "repeats": [
            {name: getattr(result, name) for name in ("start_seconds", "shut_down_seconds", "retried")}
            for result in results
        ],
    }


def measure_launch(robots: int, *, warm_up: float) -> LaunchResult:
    """Start ``swarm run``, measure its processes after the warm-up (s), and interrupt it.

    Raises
    ------
    RunError
        If it does not start, does not end, or leaves a process behind.
    """
    with TemporaryDirectory(prefix="swarmabs-bench-") as folder:
        scenario, run = Path(folder) / "scenario.yaml", Path(folder) / "run"
        scenario.write_text(dump_scenario(swarm_of(robots, _STEPS)), encoding="utf-8")
        begun = time.monotonic()
        process = subprocess.Popen(
            [sys.executable, "-m", "swarmabs_cli", "run", str(scenario), "-o", str(run)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C in a terminal reaches only this process
            preexec_fn=partial(die_with_parent, os.getpid()),  # noqa: PLW1509 - makes only a system call
        )
        try:
            _wait_for_first_step(process, begun + START_SECONDS)
            started = time.monotonic()
            time.sleep(warm_up)
            workers = workers_of(process.pid)
            memory = memory_of(workers)
            below = psutil.Process(process.pid).children(recursive=True)
            interrupted = time.monotonic()
        finally:
            _end(process)
        ended = time.monotonic()
        retried = (run / "logs" / "orchestrator.log").read_text(encoding="utf-8").count(STARTED_AGAIN)
    left = [child.pid for child in below if child.is_running()]
    if left:
        raise RunError(f"processes {left} of an interrupted run are still running")
    if memory is None:
        raise RunError(f"the robots of a run ended within {warm_up:g} s of its first step")
    return LaunchResult(started - begun, ended - interrupted, memory, retried)


def _wait_for_first_step(process: subprocess.Popen[bytes], deadline: float) -> None:
    """Read the progress of a command until it makes steps."""
    shown = []
    for line in _lines(process.stderr, deadline):
        shown.append(line)
        if ": step " in line:
            return
    raise RunError(f"a run did not make its first step: {'; '.join(shown[-3:]) or 'no output'}")


def _end(process: subprocess.Popen[bytes]) -> None:
    """Interrupt a run and wait for its end; kill it after a time limit."""
    process.send_signal(signal.SIGINT)
    try:
        process.communicate(timeout=END_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        raise RunError(f"an interrupted run did not end within {END_SECONDS:g} s") from None


def _lines(stream: IO[bytes] | None, deadline: float) -> Iterator[str]:
    """Yield the lines of a stream until it ends or the deadline passes."""
    pending = b""
    while stream is not None:
        readable, _, _ = select.select([stream], [], [], max(0.0, deadline - time.monotonic()))
        data = os.read(stream.fileno(), _LINE) if readable else b""
        if not data:
            return
        *lines, pending = (pending + data).split(b"\n")
        yield from (line.decode(errors="replace") for line in lines)


def busy_processes() -> int:
    """Return the number of processes that keep the machine busy."""
    return PER_CORE * (os.cpu_count() or 1)


@contextmanager
def busy_machine() -> Iterator[None]:
    """Run `PER_CORE` busy processes per core during the block."""
    busy: list[subprocess.Popen[bytes]] = []
    try:
        for _ in range(busy_processes()):
            busy.append(  # noqa: PERF401 - those already started must be stopped if one fails
                subprocess.Popen(
                    [sys.executable, "-c", "while True: pass"],
                    stdin=subprocess.DEVNULL,
                    start_new_session=True,
                    preexec_fn=partial(die_with_parent, os.getpid()),  # noqa: PLW1509 - makes only a system call
                )
            )
        yield
    finally:
        for process in busy:
            process.kill()
        for process in busy:
            process.wait()


if __name__ == "__main__":
    sys.exit(program(measure))
