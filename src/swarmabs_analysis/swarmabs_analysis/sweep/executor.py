"""The Dask workers that compute the cases of a sweep: processes on this machine, or workers of a running scheduler.

Dask sends code and trusts all participants. Workers on this machine are reached over loopback with TLS, by keys that
are generated for the sweep and never written to disk. With a remote scheduler, security is up to the user: connect
only to a scheduler that you control, in a private network or over its TLS. Each task is a function by name, the text
of the scenario and its overrides; the result is a line of text.
"""

from __future__ import annotations

import logging
import shutil
import tempfile
from asyncio import CancelledError, TimeoutError as LateError  # distinct from the built-in in Python 3.10
from contextlib import ExitStack, contextmanager
from hashlib import sha256
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, NamedTuple

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
from swarmabs_config.installation import lacking, own_version
from swarmabs_core.errors import InputError, RunError
from swarmabs_run.processes import usable_cores

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from swarmabs_analysis.sweep.evaluate import Task

ATTEMPTS = 3
"""Number of workers that may die while computing a case before the case counts as failed."""
_CONNECT = 10.0
"""Time within which a scheduler must answer, s."""
_FIRST_WORKER = 30.0
"""Time within which the first worker must appear, s."""
_IDLE = 0.5
"""Interval at which waiting is interrupted to show progress, s."""
_PER_THREAD, _AT_LEAST = 4, 64
"""Tasks queued at remote workers: per thread, and at least in total."""

_SETTINGS = {
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
}
"""Dask settings without HTTP pages, profiler and frequent checks, which would take time from the cases."""

_PACKAGES = (swarmabs_core, swarmabs_config, swarmabs_bag, swarmabs_run)
SOURCES = {package.__name__: Path(package.__path__[0]) for package in _PACKAGES} | {"sweep": Path(__file__).parent}
"""The sources that determine the results of a case: mathematics, scenarios, simulation, figures and evaluation."""


class Executor:
    """Computes tasks on Dask workers, in any order.

    Attributes
    ----------
    description : str
        Human-readable description and location of the workers.
    """

    def __init__(self, description: str) -> None:
        self.description = description
        self._most_pending = 0
        """Most tasks submitted and not finished."""
        self._open = ExitStack()
        for name in ("distributed", "distributed.client"):  # this class reports what matters, in one line
            logging.getLogger(name).setLevel(logging.CRITICAL)

    def compute(self, tasks: Iterator[Task], idle: Callable[[], None]) -> Iterator[str]:
        """Yield the row of each task as made by `evaluate`; `idle` is called periodically while no result is ready.

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
        """Stop everything that was started, and disconnect from the scheduler."""
        self._open.close()

    def _client(self) -> Client:
        """Return the client that submits tasks; start the workers if necessary."""
        raise NotImplementedError

    def _look_after(self) -> None:
        """Update what is known of the workers."""

    def _row(self, future: Future[str], index: int) -> str:
        """Return the row of a case; workers that died have already been replaced."""
        error = future.exception()
        if isinstance(error, KilledWorker):
            return lost(index, f"{error.allowed_failures + 1} worker processes died while computing it")
        if error is not None:
            raise RunError(f"{self.description} cannot compute case {index}: {error}") from error
        return future.result()

    @contextmanager
    def _loss_explained(self) -> Iterator[None]:
        """Turn the loss of the scheduler into a `RunError` with a remedy."""
        try:
            yield
        except (OSError, LateError, CancelledError, FutureCancelledError) as error:
            raise RunError(f"lost the connection to {self.description}; continue with --resume") from error


class LocalExecutor(Executor):
    """Computes tasks in processes on this machine, by default one per core; a process that dies is replaced.

    Raises
    ------
    InputError
        If the library that generates the TLS keys is missing.
    """

    def __init__(self, jobs: int | None = None) -> None:
        jobs = jobs or usable_cores()
        super().__init__(f"{jobs} local processes")
        self._most_pending = jobs  # one per process, so that the task of a process that dies is known
        try:
            self._security = Security.temporary()
        except ImportError as error:
            raise lacking(ModuleNotFoundError(name="cryptography"), "a sweep on this machine") from error

    def _client(self) -> Client:
        folder = tempfile.mkdtemp(prefix="swarmabs-sweep-")
        self._open.callback(shutil.rmtree, folder, ignore_errors=True)
        self._open.enter_context(dask.config.set({**_SETTINGS, "temporary-directory": folder}))
        try:
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
            raise RunError(f"the worker processes did not start: {error}; try fewer with --jobs") from error
        self._open.callback(cluster.close)
        shutil.rmtree(folder, ignore_errors=True)  # workers store nothing there, and a kill would leave it behind
        client: Client = self._open.enter_context(Client(cluster, security=self._security, set_as_default=False))
        return client


class SchedulerExecutor(Executor):
    """Computes tasks on the workers of the Dask scheduler at an address such as ``tcp://192.168.1.2:8786``.

    Raises
    ------
    InputError
        If there is no scheduler, it has no workers, or a worker lacks swarmabs or has a different version of it.
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
        """Raise `InputError` if a worker would compute different results."""
        try:
            self._connected.wait_for_workers(1, timeout=_FIRST_WORKER)
            workers = {name: Identity(*answer) for name, answer in self._connected.run(identity).items()}
        except LateError as error:
            raise InputError(f"the scheduler at {address} has no workers; start some with 'dask worker'") from error
        except (ImportError, AttributeError) as error:
            raise InputError(
                f"the workers at {address} lack this version of swarmabs: {error}; install it there and restart them"
            ) from error
        mine = identity()
        mismatch = different_worker(mine, workers)
        if mismatch is not None:
            raise InputError(f"{mismatch}: their results would differ; install this version there and restart it")

    def _client(self) -> Client:
        return self._connected

    def _look_after(self) -> None:
        """Count the threads of the current workers: workers may join and leave."""
        workers = self._connected.scheduler_info(n_workers=-1)["workers"]
        self._most_pending = max(_AT_LEAST, _PER_THREAD * sum(worker["nthreads"] for worker in workers.values()))


class Identity(NamedTuple):
    """The software of a process: its version, and a short hash of its sources."""

    version: str
    sources: str


def identity(sources: Mapping[str, Path] = SOURCES) -> Identity:
    """Return the identity of this process, from the folders of its sources."""
    total = sha256()
    for name, folder in sources.items():
        for path in sorted(folder.rglob("*.py")):
            content = path.read_bytes()
            total.update(f"{name}/{path.relative_to(folder).as_posix()}\0{len(content)}\0".encode() + content)
    return Identity(own_version() or "not installed", total.hexdigest()[:16])


def different_worker(mine: Identity, workers: Mapping[str, Identity]) -> str | None:
    """Describe the first worker, given by name, whose swarmabs differs from that of this process, if any."""
    for name, theirs in sorted(workers.items()):
        if theirs != mine:
            return (
                f"worker {name} has swarmabs {theirs.version}, sources {theirs.sources}, but this process has"
                f" {mine.version}, sources {mine.sources}"
            )
    return None
