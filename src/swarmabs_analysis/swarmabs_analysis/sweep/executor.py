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
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, NamedTuple

import dask
from distributed import Client, Future, LocalCluster
from distributed.client import FutureCancelledError
from distributed.scheduler import KilledWorker
from distributed.security import Security

import swarmabs_bag
import swarmabs_config
import swarmabs_core
import swarmabs_run
from swarmabs_analysis.sweep.evaluate import evaluate, lost
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.fingerprint import libm_fingerprint

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from swarmabs_analysis.sweep.evaluate import Task

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

_PACKAGES = (swarmabs_core, swarmabs_config, swarmabs_bag, swarmabs_run)
SOURCES = {package.__name__: Path(package.__path__[0]) for package in _PACKAGES} | {"sweep": Path(__file__).parent}
"""What a case's results depend on: mathematics, scenarios, simulation, figures, and how cases are evaluated."""


class Executor:
    """Computes tasks on Dask workers, in any order.

    Attributes
    ----------
    description : str
        What and where the workers are, for people.
    differing : list of str
        Workers whose mathematical library gives other bits than the one here: digests differ there.
    """

    def __init__(self, description: str) -> None:
        self.description = description
        self.differing: list[str] = []
        self._most_pending = 0
        """How many tasks may be handed over and not be finished."""
        self._open = ExitStack()
        for name in ("distributed", "distributed.client"):  # what matters is said by this class, in one line
            logging.getLogger(name).setLevel(logging.CRITICAL)

    def compute(self, tasks: Iterator[Task], idle: Callable[[], None]) -> Iterator[str]:
        """Yield the row of each task as `evaluate` makes it; `idle` is called now and then while nothing is ready.

        Raises
        ------
        RunError
            If no more tasks can be computed.
        """
        client = self._client()
        finished: SimpleQueue[Future[str]] = SimpleQueue()
        pending: dict[Future[str], int] = {}
        while True:
            while len(pending) < self._most_pending and (task := next(tasks, None)) is not None:
                future = client.submit(evaluate, task, pure=False)
                pending[future] = task.case
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

    def _look_after(self) -> None:
        """Notice how the workers are."""

    def _row(self, future: Future[str], index: int) -> str:
        """Return a case's row; a worker that has died was replaced by others already."""
        error: Any = future.exception()
        if isinstance(error, KilledWorker):
            return lost(index, f"{error.allowed_failures + 1} worker processes died of it")
        if error is not None:
            raise RunError(f"{self.description} cannot compute case {index}: {error}") from error
        return future.result()

    @contextmanager
    def _loss_explained(self) -> Iterator[None]:
        """Say in a line that the scheduler is gone, or another one than it was."""
        try:
            yield
        except (OSError, LateError, CancelledError, FutureCancelledError) as error:
            raise RunError(f"lost {self.description}; go on with --resume") from error


class LocalExecutor(Executor):
    """Computes tasks in processes on this machine, by default as many as there are cores; one that dies is replaced.

    Raises
    ------
    InputError
        If the library that makes the keys of TLS is missing.
    """

    def __init__(self, jobs: int | None = None) -> None:
        jobs = jobs or len(os.sched_getaffinity(0))
        super().__init__(f"{jobs} processes here")
        self._most_pending = jobs  # one per process: what a process has when it dies is what it has died of
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
                    n_workers=self._most_pending,
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


class SchedulerExecutor(Executor):
    """Computes tasks on the workers of the Dask scheduler at an address such as ``tcp://192.168.1.2:8786``.

    Raises
    ------
    InputError
        If there is no scheduler, it has no workers, or one of them has no swarmabs or another one than this.
    """

    def __init__(self, address: str) -> None:
        super().__init__(f"Dask workers at {address}")
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

    def _look_after(self) -> None:
        """Count the workers' threads as they are now: workers come and go."""
        workers = self._connected.scheduler_info(n_workers=-1)["workers"]
        self._most_pending = max(_AT_LEAST, _PER_THREAD * sum(worker["nthreads"] for worker in workers.values()))


class Identity(NamedTuple):
    """What a process computes with: version, a short hash of the sources, and that of the mathematical library."""

    version: str
    sources: str
    libm: str


def identity(sources: Mapping[str, Path] = SOURCES) -> Identity:
    """Return what this process computes with, given by the folders of its sources."""
    try:
        installed = version("swarmabs_core")
    except PackageNotFoundError:
        installed = "not installed"
    total = sha256()
    for name, folder in sources.items():
        for path in sorted(folder.rglob("*.py")):
            content = path.read_bytes()
            total.update(f"{name}/{path.relative_to(folder).as_posix()}\0{len(content)}\0".encode() + content)
    return Identity(installed, total.hexdigest()[:16], libm_fingerprint())


def stranger(mine: Identity, workers: Mapping[str, Identity]) -> str | None:
    """Say which of the workers, given by name, has another swarmabs than this process; None if none has."""
    for name, theirs in sorted(workers.items()):
        if theirs[:2] != mine[:2]:
            return (
                f"worker {name} has swarmabs {theirs.version}, sources {theirs.sources}, and this is {mine.version},"
                f" sources {mine.sources}"
            )
    return None
