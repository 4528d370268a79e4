"""The workers of a Dask scheduler that runs already.

Dask sends code and trusts all who take part in it, as its users must: connect to a scheduler of your own, in a network
of your own or through its TLS. What this module hands over is a function by name, the scenario's text and overrides;
what it takes back is a line of text.
"""

from __future__ import annotations

import logging
from asyncio import CancelledError, TimeoutError as LateError  # of its own until Python 3.10
from contextlib import contextmanager
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from distributed import Client, Future
from distributed.client import FutureCancelledError
from distributed.scheduler import KilledWorker

from swarmabs_analysis.sweep.engine import Common, Task
from swarmabs_analysis.sweep.evaluate import evaluate, lost
from swarmabs_analysis.sweep.identity import Identity, identity, stranger
from swarmabs_core.errors import InputError, RunError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_CONNECT = 10.0
"""Time, s, for the scheduler to answer."""
_FIRST_WORKER = 30.0
"""Time, s, for the first worker to be there."""
_IDLE = 0.5
_PER_THREAD = 4
_AT_LEAST = 64
"""Tasks handed over ahead: per thread of the workers, and in all."""


class SchedulerEngine:
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
        self._address = address
        for name in ("distributed", "distributed.client"):  # what matters is said by this class, in one line
            logging.getLogger(name).setLevel(logging.CRITICAL)
        try:
            self._client = Client(address, timeout=_CONNECT, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise InputError(f"no Dask scheduler at {address}: {error}; give e.g. tcp://127.0.0.1:8786") from error
        try:
            self._client.wait_for_workers(1, timeout=_FIRST_WORKER)
            workers = {name: Identity(*found) for name, found in self._client.run(identity).items()}
        except LateError as error:
            self.close()
            raise InputError(f"the scheduler at {address} has no workers; start some with 'dask worker'") from error
        except (ImportError, AttributeError) as error:
            self.close()
            raise InputError(
                f"the workers of {address} lack this swarmabs: {error}; install it there and start them again"
            ) from error
        mine = identity()
        strange = stranger(mine, workers)
        if strange is not None:
            self.close()
            raise InputError(f"{strange}: results would not belong together; install the same there and start it again")
        self._threads = self._count_threads()
        self._differing = sorted(name for name, theirs in workers.items() if theirs.libm != mine.libm)

    @property
    def description(self) -> str:
        """What and where it is, for people."""
        return f"Dask workers at {self._address}"

    @property
    def differing(self) -> list[str]:
        """Workers whose mathematical library gives other bits than the one here: digests differ there."""
        return self._differing

    def compute(self, common: Common, tasks: Iterator[Task], idle: Callable[[], None]) -> Iterator[str]:
        """Yield the row of each task; see `Engine`."""
        finished: SimpleQueue[Future[str]] = SimpleQueue()
        pending: dict[Future[str], Task] = {}
        while True:
            while len(pending) < max(_AT_LEAST, _PER_THREAD * self._threads):
                task = next(tasks, None)
                if task is None:
                    break
                arguments = (common.scenario, task.index, task.overrides, common.angle_max)
                future = self._client.submit(evaluate, *arguments, pure=False)
                pending[future] = task
                future.add_done_callback(finished.put)
            if not pending:
                return
            try:
                future = finished.get(timeout=_IDLE)
            except Empty:
                with self._loss_explained():
                    self._threads = self._count_threads()
                idle()
                continue
            with self._loss_explained():
                row = self._row(future, pending.pop(future))
            yield row

    def close(self) -> None:
        """Forget what is computed still, and leave the scheduler."""
        self._client.close(timeout=_CONNECT)

    def _row(self, future: Future[str], task: Task) -> str:
        """Return a task's row; a worker that has died was replaced by others already."""
        error: Any = future.exception()
        if isinstance(error, KilledWorker):
            return lost(task.index, f"{error.allowed_failures + 1} workers died of it")
        if error is not None:
            raise RunError(f"the workers of {self._address} cannot compute case {task.index}: {error}") from error
        return future.result()

    @contextmanager
    def _loss_explained(self) -> Iterator[None]:
        """Say in a line that the scheduler is gone, or another one than it was."""
        try:
            yield
        except (OSError, LateError, CancelledError, FutureCancelledError) as error:
            raise RunError(f"lost the scheduler at {self._address}; go on with --resume") from error

    def _count_threads(self) -> int:
        """Return the workers' threads as they are now: workers come and go."""
        workers = self._client.scheduler_info(n_workers=-1)["workers"]
        return sum(worker["nthreads"] for worker in workers.values())
