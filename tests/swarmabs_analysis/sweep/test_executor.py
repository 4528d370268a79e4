"""Worker processes on this machine: they may die, and a case that kills them is given up."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator

import psutil
import pytest
from tests.swarmabs_analysis.sweep.helpers import workers

from swarmabs_analysis.sweep.evaluate import Task, evaluate
from swarmabs_analysis.sweep.executor import ATTEMPTS, LocalExecutor
from swarmabs_analysis.sweep.study import Study
from swarmabs_core.errors import RunError

ENDLESS = ("duration=1000000",)
BUSY = 5.0
"""Processor time, s, after which a worker has done more than to start."""

pytestmark = pytest.mark.timeout(120)


@pytest.fixture
def executor(monkeypatch: pytest.MonkeyPatch) -> Iterator[LocalExecutor]:
    for name in ("MALLOC_TRIM_THRESHOLD_", "MKL_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        monkeypatch.setenv(name, os.environ.get(name, "1"))  # Dask sets them for its workers
    executor = LocalExecutor(2)
    yield executor
    executor.close()
    assert not workers(os.getpid())


def nothing() -> None:
    pass


def test_rows_are_those_of_the_cases_whoever_computes_them(executor: LocalExecutor, study: Study) -> None:
    tasks = [study.task(index) for index in range(study.sweep.count)]
    rows = executor.compute(iter(tasks), nothing)
    found = [next(rows)]
    loopback = {connection.laddr.ip for connection in psutil.net_connections("tcp") if connection.pid == os.getpid()}
    assert loopback == {"127.0.0.1"}
    found = sorted([*found, *rows], key=lambda line: json.loads(line)["case"])
    assert found == [evaluate(task) for task in tasks]


def test_as_many_processes_as_there_are_cores() -> None:
    assert LocalExecutor().description == f"{len(os.sched_getaffinity(0))} processes here"


def test_case_of_a_killed_worker_is_computed_again(executor: LocalExecutor, study: Study) -> None:
    tasks = [study.task(index) for index in range(study.sweep.count)]
    rows = executor.compute(iter(tasks), nothing)
    found = [next(rows)]
    killed = workers(os.getpid())
    for worker in killed:
        worker.send_signal(signal.SIGKILL)
    found += rows
    assert len(killed) == 2
    assert sorted(json.loads(line)["case"] for line in found) == list(range(36))
    assert "died" not in "".join(found)


def test_case_that_kills_its_workers_is_given_up_and_no_other(executor: LocalExecutor, study: Study) -> None:
    killed = set()

    def kill() -> None:  # called while nothing is ready: what is computed is the endless case
        for worker in workers(os.getpid()):
            if worker.cpu_times().user > BUSY:
                killed.add(worker.pid)
                worker.kill()

    tasks = [
        Task(study.scenario, 0, ENDLESS, 0.2),
        *(Task(study.scenario, number, ("duration=0.1",), 0.2) for number in (1, 2, 3)),
    ]
    found = [json.loads(line) for line in executor.compute(iter(tasks), kill)]
    assert len(killed) == ATTEMPTS
    assert [row["case"] for row in found if row["status"] == "failed"] == [0]
    assert found[-1]["reason"] == "3 worker processes died of it"
    assert {row["case"] for row in found} == {0, 1, 2, 3}


def test_worker_that_cannot_start_ends_the_sweep(
    executor: LocalExecutor, study: Study, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONHOME", "/nowhere")
    with pytest.raises(RunError, match=r"worker processes do not start: .*; try fewer with --jobs"):
        list(executor.compute(iter([study.task(0)]), nothing))


def test_closing_ends_what_is_computed(executor: LocalExecutor, study: Study) -> None:
    tasks = iter([Task(study.scenario, 0, ENDLESS, 0.2), Task(study.scenario, 1, ("duration=0.1",), 0.2)])
    next(executor.compute(tasks, nothing))
    executor.close()
    assert not workers(os.getpid())
