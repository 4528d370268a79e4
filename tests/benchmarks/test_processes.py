"""What is read of processes, and what is concluded from it."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import pytest
from benchmarks.processes import (
    AGENTS,
    Sample,
    Usage,
    crew_of,
    load_between,
    machine_busy,
    memory_of,
    proportional_memory,
    role_of,
    usage,
)
from tests.processes import until

CREW = {1: "observer", 2: AGENTS, 3: AGENTS}
_NAMED = "import ctypes, sys; ctypes.CDLL(None).prctl(15, sys.argv[1].encode(), 0, 0, 0); sys.stdin.read()"


@pytest.mark.parametrize(
    ("name", "role"),
    [
        ("agent_007", AGENTS),
        ("plane_sim", "plane"),
        ("abstraction_obs", "observer"),
        ("parent_controll", "controller"),
        ("recorder", "recorder"),
        ("python", None),
    ],
)
def test_the_kernels_name_of_a_process_tells_its_role(name: str, role: str | None) -> None:
    assert role_of(name) == role


def test_processes_of_a_run_are_found_below_another_by_their_names() -> None:
    with subprocess.Popen([sys.executable, "-c", _NAMED, "abstraction_observer"], stdin=subprocess.PIPE) as child:
        until(lambda: child.pid in crew_of(os.getpid()), "the process has its name")
        found = crew_of(os.getpid())
        assert child.stdin is not None
        child.stdin.close()
    assert found[child.pid] == "observer"
    assert child.pid not in crew_of(os.getpid())


def test_usage_grows_with_work_and_counts_what_waits() -> None:
    before = usage(os.getpid())
    end = time.process_time() + 0.1
    while time.process_time() < end:
        pass
    time.sleep(0.01)
    after = usage(os.getpid())
    assert before is not None
    assert after is not None
    assert after.cpu - before.cpu >= 0.05
    assert after.switches > before.switches
    assert machine_busy() > 0.0


def test_nothing_is_known_of_a_process_that_has_ended() -> None:
    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait()
    assert usage(child.pid) is None
    assert proportional_memory(child.pid) is None
    assert memory_of({child.pid: AGENTS}) is None


def test_memory_is_told_by_role() -> None:
    found = memory_of({os.getpid(): AGENTS})
    assert found is not None
    assert found.agent_median == found.agent_largest == found.total > 2**20
    assert found.coordinators == {}


def test_the_load_between_two_samples_is_per_second_step_and_robot() -> None:
    first = Sample(10.0, 100, {1: Usage(1.0, 0), 2: Usage(0.0, 10), 3: Usage(0.0, 20)}, busy=50.0)
    last = Sample(14.0, 300, {1: Usage(2.0, 9), 2: Usage(1.0, 410), 3: Usage(2.0, 620)}, busy=56.0)
    load = load_between(first, last, CREW)
    assert load is not None
    assert (load.seconds, load.steps) == (4.0, 200)
    assert load.cpu_share == {"observer": 0.25, AGENTS: 0.75}
    assert load.cpu_ms_per_step == pytest.approx(20.0)
    assert load.switches_per_agent_step == pytest.approx(1000 / (2 * 200))
    assert load.other_load == pytest.approx((6.0 - 4.0) / 4.0 / (os.cpu_count() or 1))


def test_a_process_that_has_ended_does_not_count() -> None:
    first = Sample(0.0, 0, {1: Usage(0.0, 0), 2: Usage(0.0, 0)}, busy=0.0)
    load = load_between(first, Sample(1.0, 10, {1: Usage(0.5, 0)}, busy=0.2), CREW)
    assert load is not None
    assert load.cpu_share == {"observer": 0.5}
    assert load.switches_per_agent_step == 0.0
    assert load.other_load == 0.0


@pytest.mark.parametrize(("time", "step"), [(1.0, 0), (0.0, 10)])
def test_there_is_no_load_without_time_or_steps(time: float, step: int) -> None:
    assert load_between(Sample(0.0, 0, {}, 0.0), Sample(time, step, {}, 0.0), CREW) is None
