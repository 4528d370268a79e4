"""What is read of processes and concluded from it, and what feeds the recorder when it is measured alone."""

import os
import subprocess
import sys
import time
from dataclasses import replace

import psutil
import pytest
from benchmarks.feeder import FEWEST, IN_FLIGHT, MOST, Feeder
from benchmarks.processes import (
    AGENTS,
    Sample,
    Usage,
    load_between,
    machine_busy,
    memory_of,
    proportional_memory,
    role_of,
    usage,
    workers_of,
)
from benchmarks.simulate import measure_against_solver
from benchmarks.start import busy_machine, busy_processes
from tests.processes import until

from swarmabs_core.messages import NEVER, RECORDING_PROGRESS, PlaneState, RecordingProgress

_NAMED = "import ctypes, sys; ctypes.CDLL(None).prctl(15, sys.argv[1].encode(), 0, 0, 0); sys.stdin.read()"


def test_processes_of_a_run_are_found_below_another_by_their_names_until_they_end() -> None:
    names = ("agent_007", "plane_sim", "abstraction_obs", "parent_controll", "recorder", "python")
    assert [role_of(name) for name in names] == [AGENTS, "plane", "observer", "controller", "recorder", None]
    with subprocess.Popen([sys.executable, "-c", _NAMED, "abstraction_observer"], stdin=subprocess.PIPE) as child:
        until(lambda: child.pid in workers_of(os.getpid()), "the process has its name")
        assert workers_of(os.getpid())[child.pid] == "observer"
        assert child.stdin is not None
        child.stdin.close()
    assert child.pid not in workers_of(os.getpid())
    assert (usage(child.pid), proportional_memory(child.pid), memory_of({child.pid: AGENTS})) == (None, None, None)


def test_usage_grows_with_work_and_counts_what_waits_and_memory_is_told_by_role() -> None:
    before = usage(os.getpid())
    end = time.process_time() + 0.1
    while time.process_time() < end:
        pass
    subprocess.run(["true"], check=True)  # for which this process waits
    after = usage(os.getpid())
    assert before and after
    assert after.cpu - before.cpu >= 0.05
    assert after.switches > before.switches
    assert machine_busy() > 0.0
    found = memory_of({os.getpid(): AGENTS})
    assert found is not None
    assert found.agent_median == found.agent_largest == found.total > 2**20
    assert found.coordinators == {}


def test_the_load_between_two_samples_is_per_second_step_and_robot() -> None:
    workers = {1: "observer", 2: AGENTS, 3: AGENTS, 4: AGENTS}  # the last has ended, and does not count
    first = Sample(10.0, 100, {1: Usage(1.0, 0), 2: Usage(0.0, 10), 3: Usage(0.0, 20), 4: Usage(9.0, 9)}, busy=50.0)
    last = Sample(14.0, 300, {1: Usage(2.0, 9), 2: Usage(1.0, 410), 3: Usage(2.0, 620)}, busy=56.0)
    load = load_between(first, last, workers)
    assert load is not None
    assert (load.seconds, load.steps) == (4.0, 200)
    assert load.cpu_share == {"observer": 0.25, AGENTS: 0.75}
    assert load.cpu_ms_per_step == pytest.approx(20.0)
    assert load.switches_per_agent_step == pytest.approx(1000 / (2 * 200))
    assert load.other_load == pytest.approx((6.0 - 4.0) / 4.0 / (os.cpu_count() or 1))
    for now, step in ((11.0, 100), (10.0, 300)):  # no time, or no step
        assert load_between(first, replace(last, time=now, step=step), workers) is None


@pytest.mark.usefixtures("nothing_survives")
def test_the_machine_is_busy_within_the_block_only() -> None:
    before = set(psutil.Process().children())
    with busy_machine():
        assert len(set(psutil.Process().children()) - before) == busy_processes() == 2 * (os.cpu_count() or 1)
    assert set(psutil.Process().children()) == before


def test_the_solver_and_the_simulation_agree_up_to_the_sampling() -> None:
    found = measure_against_solver(2.0)
    assert 0.0 < found.largest_difference < 1e-3
    assert found.ratio == found.simulate_seconds / found.solver_seconds


def feeder(count: int, each: int) -> Feeder:
    return Feeder([[PlaneState(0, step, 0.0, 0.0)] * each for step in range(count)])


def credit(step: int) -> RecordingProgress:
    return RecordingProgress(0, 0, step)


def test_no_more_is_fed_than_a_buffer_holds_credit_counts_once_and_the_end_is_when_everything_is_recorded() -> None:
    for each, window in ((1, MOST), (IN_FLIGHT // 20, 20), (IN_FLIGHT, FEWEST)):
        fed = feeder(1000, each)
        assert len(fed.start()) == window * each
        assert {message.step for message in fed.handle(credit(9))} == set(range(window, window + 10))
    fed = feeder(1000, 1)
    fed.start()
    assert fed.handle(credit(NEVER)) == ()
    assert len(fed.handle(credit(9))) == 10
    assert fed.handle(credit(9)) == ()
    assert fed.missing() == (10, ("recorder",))
    fed = feeder(30, 1)
    assert len(fed.start()) == 30
    assert fed.awaits() == (RECORDING_PROGRESS,)
    assert fed.handle(credit(29)) == fed.awaits() == ()
