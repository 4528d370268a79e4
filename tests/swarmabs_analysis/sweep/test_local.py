"""Worker processes on this machine: they may die, and a case that kills them is given up."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator

import pytest
from tests.swarmabs_analysis.sweep.helpers import workers

from swarmabs_analysis.sweep.engine import ATTEMPTS, Common, Task
from swarmabs_analysis.sweep.evaluate import evaluate
from swarmabs_analysis.sweep.local import LocalEngine
from swarmabs_analysis.sweep.study import Study
from swarmabs_core.errors import RunError

ENDLESS = ("duration=1000000",)


@pytest.fixture
def engine(nothing_survives: str) -> Iterator[LocalEngine]:
    engine = LocalEngine(2)
    yield engine
    engine.close()


def nothing() -> None:
    pass


def test_rows_are_those_of_the_cases_whoever_computes_them(engine: LocalEngine, study: Study) -> None:
    tasks = [Task(case.index, case.overrides()) for case in study.cases()]
    common = Common(study.scenario, 0.2)
    found = sorted(engine.compute(common, iter(tasks), nothing), key=lambda line: json.loads(line)["case"])
    assert found == [evaluate(study.scenario, task.index, task.overrides, 0.2) for task in tasks]
    assert not workers(os.getpid())


def test_as_many_processes_as_there_are_cores() -> None:
    assert LocalEngine().description == f"{len(os.sched_getaffinity(0))} processes here"


def test_case_of_a_killed_worker_is_computed_again(engine: LocalEngine, study: Study) -> None:
    tasks = [Task(case.index, case.overrides()) for case in study.cases()]
    rows = engine.compute(Common(study.scenario, 0.2), iter(tasks), nothing)
    found = [next(rows)]
    killed = workers(os.getpid())
    for worker in killed:
        worker.send_signal(signal.SIGKILL)
    found += rows
    assert len(killed) == 2
    assert sorted(json.loads(line)["case"] for line in found) == list(range(36))
    assert "died" not in "".join(found)


def test_case_that_kills_its_workers_is_given_up(engine: LocalEngine, study: Study) -> None:
    kills = 0

    def kill() -> None:  # called while nothing is ready: what is computed is the endless case
        nonlocal kills
        busy = [worker.process for worker in engine._workers.values() if worker.task is not None]
        if busy and kills < ATTEMPTS:
            kills += 1
            busy[0].kill()

    common = Common(study.scenario, 0.2)
    (line,) = engine.compute(common, iter([Task(0, ENDLESS)]), kill)
    row = json.loads(line)
    assert (row["case"], row["status"]) == (0, "failed")
    assert row["reason"] == "3 worker processes died of it; the last one was killed by SIGKILL"
    assert len(list(engine.compute(common, iter([Task(1, ("duration=0.1",))]), kill))) == 1


def test_worker_that_cannot_start_ends_the_sweep(
    engine: LocalEngine, study: Study, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONHOME", "/nowhere")
    with pytest.raises(RunError, match=r"worker processes do not start; the last one ended with exit code 1; try"):
        list(engine.compute(Common(study.scenario, 0.2), iter([Task(0, ())]), nothing))


def test_closing_ends_what_is_computed_at_once(engine: LocalEngine, study: Study) -> None:
    rows = engine.compute(Common(study.scenario, 0.2), iter([Task(0, ENDLESS), Task(1, ("duration=0.1",))]), nothing)
    next(rows)
    engine.close()
    assert not workers(os.getpid())
