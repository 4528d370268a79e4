"""Start, memory and end of a run as a user sees them: the command as a process of its own, interrupted by Ctrl-C."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import psutil

from swarmabs_cli.bench_framework.processes import Memory, crew_of, memory_of
from swarmabs_cli.bench_framework.scenarios import swarm_of
from swarmabs_config.scenario import dump_scenario
from swarmabs_core.errors import RunError
from swarmabs_run.orchestration.process_run import STARTED_AGAIN
from swarmabs_run.parent_death import die_with_parent

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import IO

START_SECONDS = 180.0
"""Longest time, s, from the command to the first step."""
END_SECONDS = 60.0
"""Longest time, s, from Ctrl-C to the end of the command."""
_STEPS = 30_000
_LINE = 65536


@dataclass(frozen=True, slots=True)
class LaunchResult:
    """How a run has started and ended.

    Parameters
    ----------
    start_seconds, shut_down_seconds : float
        From the command to the first step, and from Ctrl-C to the end of everything.
    memory : Memory
        After the warm-up.
    retried : int
        How many processes did not come up at first and were started again.
    """

    start_seconds: float
    shut_down_seconds: float
    memory: Memory
    retried: int


def measure_launch(robots: int, *, warm_up: float) -> LaunchResult:
    """Start ``swarm run``, look at its processes after the warm-up (s), and interrupt it.

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
            start_new_session=True,  # Ctrl-C in a terminal is for us alone
            preexec_fn=partial(die_with_parent, os.getpid()),  # noqa: PLW1509 - it calls nothing but the kernel
        )
        try:
            _wait_for_first_step(process, begun + START_SECONDS)
            started = time.monotonic()
            time.sleep(warm_up)
            crew = crew_of(process.pid)
            memory = memory_of(crew)
            below = psutil.Process(process.pid).children(recursive=True)
            interrupted = time.monotonic()
        finally:
            _end(process)
        ended = time.monotonic()
        retried = (run / "logs" / "orchestrator.log").read_text(encoding="utf-8").count(STARTED_AGAIN)
    left = [child.pid for child in below if child.is_running()]
    if left:
        raise RunError(f"processes {left} are left of an interrupted run")
    if memory is None:
        raise RunError(f"the robots of a run had ended {warm_up:g} s after its first step")
    return LaunchResult(started - begun, ended - interrupted, memory, retried)


def _wait_for_first_step(process: subprocess.Popen[bytes], deadline: float) -> None:
    """Read the progress that a command shows until it makes steps."""
    shown = []
    for line in _lines(process.stderr, deadline):
        shown.append(line)
        if ": step " in line:
            return
    raise RunError(f"a run did not make its first step: {'; '.join(shown[-3:]) or 'it said nothing'}")


def _end(process: subprocess.Popen[bytes]) -> None:
    """Interrupt a run and wait until it has ended; its launcher ends with it in any case."""
    process.send_signal(signal.SIGINT)
    try:
        process.communicate(timeout=END_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        raise RunError(f"an interrupted run did not end within {END_SECONDS:g} s") from None


def _lines(stream: IO[bytes] | None, deadline: float) -> Iterator[str]:
    """Yield the lines of a stream until it ends or time is up."""
    pending = b""
    while stream is not None:
        readable, _, _ = select.select([stream], [], [], max(0.0, deadline - time.monotonic()))
        data = os.read(stream.fileno(), _LINE) if readable else b""
        if not data:
            return
        *lines, pending = (pending + data).split(b"\n")
        yield from (line.decode(errors="replace") for line in lines)
