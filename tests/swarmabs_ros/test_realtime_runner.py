"""What a process asks of the kernel, and what it says when that is refused."""

from __future__ import annotations

import ctypes
import os
import resource
import subprocess
import sys
import threading

import pytest

from swarmabs_core.errors import InputError
from swarmabs_ros.realtime_runner import lock_memory, schedule_threads

LOCKS = "from swarmabs_ros.realtime_runner import lock_memory; lock_memory(); print(open('/proc/self/status').read())"


def test_nothing_is_asked_for_unless_it_is_wanted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_setscheduler", lambda *_: pytest.fail("nobody wants that"))
    schedule_threads("other", 50)


@pytest.mark.parametrize(("name", "policy"), [("fifo", os.SCHED_FIFO), ("rr", os.SCHED_RR)])
def test_all_threads_get_the_class_and_this_one_comes_first(
    name: str, policy: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: dict[int, tuple[int, int]] = {}
    gone: list[int] = []

    def note(thread: int, its_policy: int, parameters: os.sched_param) -> None:
        if thread in gone:
            raise ProcessLookupError(3, "No such process")
        asked[thread] = (its_policy, parameters.sched_priority)

    monkeypatch.setattr(os, "sched_setscheduler", note)
    ending, begun = threading.Event(), threading.Event()
    others = [threading.Thread(target=lambda: (begun.set(), ending.wait(10.0))) for _ in range(2)]
    for other in others:
        other.start()
    assert begun.wait(10.0)
    ids = [other.native_id for other in others]
    gone += [ids[0] or 0]
    try:
        schedule_threads(name, 42)
    finally:
        ending.set()
        for other in others:
            other.join()
    assert asked[threading.get_native_id()] == (policy, 42)
    assert asked[ids[1] or 0] == (policy, 41)
    assert ids[0] not in asked


def test_a_refused_class_is_named_with_the_way_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with pytest.raises(InputError, match=r"parameter scheduling: .*fifo priority 42.*LimitRTPRIO=42.*'other'"):
        schedule_threads("fifo", 42)


def test_refused_locking_is_named_with_the_way_out(monkeypatch: pytest.MonkeyPatch) -> None:
    class Libc:
        @staticmethod
        def mlockall(_: int) -> int:
            ctypes.set_errno(12)
            return -1

    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: Libc)
    with pytest.raises(InputError, match=r"parameter lock_memory: .*Cannot allocate memory.*LimitMEMLOCK=infinity"):
        lock_memory()


def test_locked_memory_is_locked() -> None:
    _, hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if os.geteuid() and hard != resource.RLIM_INFINITY:
        pytest.skip("this user may not lock memory: RLIMIT_MEMLOCK is limited")
    done = subprocess.run([sys.executable, "-c", LOCKS], capture_output=True, text=True, timeout=20, check=False)
    assert done.returncode == 0, done.stderr
    (locked,) = (int(line.split()[1]) for line in done.stdout.splitlines() if line.startswith("VmLck:"))
    assert locked > 1000, "kB"
