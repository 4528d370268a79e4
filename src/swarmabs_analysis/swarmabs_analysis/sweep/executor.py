"""The Dask workers that compute the cases of a sweep: processes on this machine, or those of a scheduler that runs.

Dask sends code and trusts all who take part in it. On this machine workers are reached on loopback and by TLS, with
keys that are made for the sweep and never written. Elsewhere it is the users' matter: connect to a scheduler of your
own, in a network of your own or through its TLS. What is handed over is a function by name, the scenario's text and
overrides; what comes back is a line of text.
"""

from __future__ import annotations

import logging
import os
import shutil
import tempfile
from asyncio import CancelledError, TimeoutError as LateError  # of its own until Python 3.10
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, NamedTuple

import dask
from distributed import Client, Future, LocalCluster
from distributed.client import FutureCancelledError
from distributed.scheduler import KilledWorker
from distributed.security import Security

from swarmabs_analysis.sweep.evaluate import evaluate, lost
from swarmabs_analysis.sweep.identity import Identity, identity, stranger
from swarmabs_core.errors import InputError, RunError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

ATTEMPTS = 3
"""How many workers may die while they compute a case before it counts as failed."""
_CONNECT = 10.0
"""Time, s, for a scheduler to answer."""
_FIRST_WORKER = 30.0
"""Time, s, for the first worker to be there."""
_IDLE = 0.5
"""Time, s, after which waiting is interrupted to show progress."""
_PER_THREAD, _AT_LEAST = 4, 64
"""Tasks handed to workers elsewhere ahead of time: per thread, and in all."""

_NO_PAGES: dict[str, list[str]] = {"distributed.scheduler.http.routes": [], "distributed.worker.http.routes": []}
"""Settings of Dask by which scheduler and workers show nothing of themselves by HTTP."""


@dataclass(frozen=True, slots=True)
class Task:
    """What a worker gets: number of the case and its overrides of the scenario, plain texts."""

    index: int
    overrides: tuple[str, ...]


class Common(NamedTuple):
    """What is the same for all cases: the scenario's text, and the bound of the angle for the estimates, rad."""

    scenario: str
    angle_max: float


class Executor:
    """Computes tasks on Dask workers, in any order.

    Attributes
    ----------
    description : str
        What and where the workers are, for people.
    differing : list of str
        Workers whose mathematical library gives other bits than the one here: digests differ there.
    """

    description: str

    def __init__(self) -> None:
        self.differing: list[str] = []
        self._open = ExitStack()
        for name in ("distributed", "distributed.client"):  # what matters is said by this class, in one line
            logging.getLogger(name).setLevel(logging.CRITICAL)

    def compute(self, common: Common, tasks: Iterator[Task], idle: Callable[[], None]) -> Iterator[str]:
        """Yield the row of each task as `evaluate` makes it; `idle` is called now and then while nothing is ready.

        Raises
        ------
        RunError
            If no more tasks can be computed.
        """
        client = self._client()
        finished: SimpleQueue[Future[str]] = SimpleQueue()
        pending: dict[Future[str], Task] = {}
        while True:
            while len(pending) < self._most_pending() and (task := next(tasks, None)) is not None:
                arguments = (common.scenario, task.index, task.overrides, common.angle_max)
                future = client.submit(evaluate, *arguments, pure=False)
                pending[future] = task
                future.add_done_callback(finished.put)
            if not pending:
                return
            try:
                future = finished.get(timeout=_IDLE)
            except Empty:
                with self._loss_explained():
                    self._look_after()
                idle()
                continue
            with self._loss_explained():
                row = self._row(future, pending.pop(future))
            yield row

    def close(self) -> None:
        """End everything that was started, and leave the scheduler."""
        self._open.close()

    def _client(self) -> Client:
        """Return what hands tasks to the workers, which are started if they are not there yet."""
        raise NotImplementedError

    def _most_pending(self) -> int:
        """Return how many tasks may be handed over and not be finished."""
        raise NotImplementedError

    def _look_after(self) -> None:
        """Notice how the workers are."""

    def _row(self, future: Future[str], task: Task) -> str:
        """Return a task's row; a worker that has died was replaced by others already."""
        error: Any = future.exception()
        if isinstance(error, KilledWorker):
            return lost(task.index, f"{error.allowed_failures + 1} worker processes died of it")
        if error is not None:
            raise RunError(f"{self.description} cannot compute case {task.index}: {error}") from error
        return future.result()

    @contextmanager
    def _loss_explained(self) -> Iterator[None]:
        """Say in a line that the scheduler is gone, or another one than it was."""
        try:
            yield
        except (OSError, LateError, CancelledError, FutureCancelledError) as error:
            raise RunError(f"lost {self.description}; go on with --resume") from error


class LocalExecutor(Executor):
    """Computes tasks in processes on this machine; one that dies is replaced.

    Parameters
    ----------
    jobs : int, optional
        Number of processes; as many as there are cores for this process by default.

    Raises
    ------
    InputError
        If the library that makes the keys of TLS is missing.
    """

    def __init__(self, jobs: int | None = None) -> None:
        super().__init__()
        self._jobs = jobs or len(os.sched_getaffinity(0))
        self.description = f"{self._jobs} processes here"
        try:
            self._security = Security.temporary()
        except ImportError as error:
            raise InputError(f"{error}; `swarm sweep` needs cryptography: install it") from error

    def _client(self) -> Client:
        folder = tempfile.mkdtemp(prefix="swarmabs-sweep-")
        self._open.callback(shutil.rmtree, folder, ignore_errors=True)
        try:
            with dask.config.set({**_NO_PAGES, "temporary-directory": folder}):
                cluster = LocalCluster(
                    n_workers=self._jobs,
                    threads_per_worker=1,
                    host="127.0.0.1",
                    security=self._security,
                    dashboard_address="127.0.0.1:0",
                    memory_limit=0,
                    silence_logs=logging.CRITICAL,
                    scheduler_kwargs={"allowed_failures": ATTEMPTS - 1, "dashboard": False},
                )
        except RuntimeError as error:
            raise RunError(f"worker processes do not start: {error}; try fewer with --jobs") from error
        self._open.callback(cluster.close)
        shutil.rmtree(folder, ignore_errors=True)  # workers keep nothing there, and a kill would leave it behind
        client: Client = self._open.enter_context(Client(cluster, security=self._security, set_as_default=False))
        return client

    def _most_pending(self) -> int:
        """Return one per process: what a process has when it dies is what it has died of."""
        return self._jobs


class SchedulerExecutor(Executor):
    """Computes tasks on the workers of a Dask scheduler.

    Parameters
    ----------
    address : str
        Such as ``tcp://192.168.1.2:8786``.

    Raises
    ------
    InputError
        If there is no scheduler, it has no workers, or one of them has no swarmabs or another one than this.
    """

    def __init__(self, address: str) -> None:
        super().__init__()
        self.description = f"Dask workers at {address}"
        try:
            self._connected = Client(address, timeout=_CONNECT, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise InputError(f"no Dask scheduler at {address}: {error}; give e.g. tcp://127.0.0.1:8786") from error
        self._open.callback(self._connected.close, timeout=_CONNECT)
        try:
            self._check(address)
        except InputError:
            self.close()
            raise
        self._look_after()

    def _check(self, address: str) -> None:
        """Refuse workers that would not compute the same."""
        try:
            self._connected.wait_for_workers(1, timeout=_FIRST_WORKER)
            workers = {name: Identity(*found) for name, found in self._connected.run(identity).items()}
        except LateError as error:
            raise InputError(f"the scheduler at {address} has no workers; start some with 'dask worker'") from error
        except (ImportError, AttributeError) as error:
            raise InputError(
                f"the workers of {address} lack this swarmabs: {error}; install it there and start them again"
            ) from error
        mine = identity()
        strange = stranger(mine, workers)
        if strange is not None:
            raise InputError(f"{strange}: results would not belong together; install the same there and start it again")
        self.differing = sorted(name for name, theirs in workers.items() if theirs.libm != mine.libm)

    def _client(self) -> Client:
        return self._connected

    def _most_pending(self) -> int:
        return max(_AT_LEAST, _PER_THREAD * self._threads)

    def _look_after(self) -> None:
        """Count the workers' threads as they are now: workers come and go."""
        workers = self._connected.scheduler_info(n_workers=-1)["workers"]
        self._threads: int = sum(worker["nthreads"] for worker in workers.values())
