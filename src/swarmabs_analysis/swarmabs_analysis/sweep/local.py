"""Worker processes on this machine, one per core, each at the other end of a pipe.

This is not a Dask cluster, because here it needs less: a case that kills its worker is known exactly and tried again,
an interrupt ends all workers at once, they end with this process however it ends, there is no port, no scratch folder
and no code in what goes through the pipes.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import threading
from collections import deque
from multiprocessing.connection import wait
from typing import TYPE_CHECKING, cast

from swarmabs_analysis.sweep.engine import ATTEMPTS, Common, Task
from swarmabs_analysis.sweep.evaluate import evaluate, lost
from swarmabs_core.errors import RunError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from multiprocessing.connection import Connection
    from multiprocessing.context import SpawnProcess

_IDLE = 0.5
"""Time, s, after which waiting is interrupted to show progress."""
_READY = b""
_SPAWN = multiprocessing.get_context("spawn")  # a fork would inherit locks, signal handlers and the other pipes


class LocalEngine:
    """Computes tasks in processes on this machine.

    Parameters
    ----------
    jobs : int, optional
        Number of processes; as many as there are cores for this process by default.
    """

    def __init__(self, jobs: int | None = None) -> None:
        self._jobs = jobs or len(os.sched_getaffinity(0))
        self._workers: dict[Connection, _Worker] = {}
        self._failed_starts = 0

    @property
    def description(self) -> str:
        """What it is, for people."""
        return f"{self._jobs} processes here"

    def compute(self, common: Common, tasks: Iterator[Task], idle: Callable[[], None]) -> Iterator[str]:
        """Yield the row of each task; see `Engine`."""
        again: deque[Task] = deque()
        deaths: dict[int, int] = {}
        for _ in range(self._jobs):
            self._start(common)
        while self._workers:
            ready = wait(list(self._workers), timeout=_IDLE)
            if not ready:
                idle()
            for connection in cast("list[Connection]", ready):
                worker = self._workers[connection]
                try:
                    row = worker.connection.recv_bytes()
                except (EOFError, OSError):
                    yield from self._bury(worker, common, again, deaths)
                    continue
                done = worker.ready
                worker.ready, worker.task = True, None
                self._failed_starts = 0
                task = again.popleft() if again else next(tasks, None)
                if task is None:
                    self._end(worker)
                else:
                    self._give(worker, task)
                if done:
                    yield row.decode()

    def close(self) -> None:
        """End all workers at once."""
        for worker in list(self._workers.values()):
            self._end(worker)

    def _start(self, common: Common) -> None:
        ours, theirs = _SPAWN.Pipe()
        process = _SPAWN.Process(target=_work, args=(theirs, *common), name="swarm sweep worker", daemon=True)
        process.start()
        theirs.close()
        self._workers[ours] = _Worker(process, ours)

    def _give(self, worker: _Worker, task: Task) -> None:
        """Hand a task to a worker; that it has died is noticed when its answer is read."""
        worker.task = task
        try:
            worker.connection.send_bytes(json.dumps([task.index, task.overrides]).encode())
        except OSError:
            return

    def _end(self, worker: _Worker) -> None:
        del self._workers[worker.connection]
        worker.process.kill()
        worker.process.join()
        worker.process.close()
        worker.connection.close()

    def _bury(self, worker: _Worker, common: Common, again: deque[Task], deaths: dict[int, int]) -> Iterator[str]:
        """Replace a worker that has died; give its task to another one, or give it up."""
        worker.process.join()
        code, task, ready = worker.process.exitcode or 0, worker.task, worker.ready
        self._end(worker)
        how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        self._failed_starts += not ready
        if self._failed_starts == ATTEMPTS:
            raise RunError(f"worker processes do not start; the last one {how}; try fewer with --jobs")
        self._start(common)
        if task is None:
            return
        deaths[task.index] = deaths.get(task.index, 0) + 1
        if deaths[task.index] < ATTEMPTS:
            again.append(task)
        else:
            yield lost(task.index, f"{ATTEMPTS} worker processes died of it; the last one {how}")


class _Worker:
    """A process, the pipe to it, whether it has said that it is ready, and what it computes."""

    def __init__(self, process: SpawnProcess, connection: Connection) -> None:
        self.process = process
        self.connection = connection
        self.ready = False
        self.task: Task | None = None


def _work(connection: Connection, scenario: str, angle_max: float) -> None:
    """Compute what comes through the pipe until it is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; who started this one decides
    threading.Thread(target=_end_with_parent, daemon=True).start()
    connection.send_bytes(_READY)
    while True:
        index, overrides = json.loads(connection.recv_bytes())
        connection.send_bytes(evaluate(scenario, index, overrides, angle_max).encode())


def _end_with_parent() -> None:
    """End this process as soon as the one that started it has ended, even by SIGKILL."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
