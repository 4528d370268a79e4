"""The test hosts do what the tests that use them rely on: they are apart, reach each other and leave nothing.

Times are lower bounds only; what is lost is counted, within five standard deviations.
"""

import os
import signal
import subprocess
import sys
from collections import Counter
from math import sqrt
from pathlib import Path

import psutil
import pytest
from tests.hosts.cluster import hosts
from tests.hosts.datagrams import Receiver
from tests.hosts.switch import Impairment
from tests.processes import ROOT, SEARCH_PATH, marked_processes, until

pytestmark = [pytest.mark.system, pytest.mark.timeout(300), pytest.mark.usefixtures("possible")]

COUNT = 2000
BAD = Impairment(delay=0.03, jitter=0.01, loss=0.1, duplicate=0.1)


def near(found: int, count: int, probability: float) -> bool:
    return abs(found - count * probability) <= 5.0 * sqrt(count * probability * (1.0 - probability))


def test_a_network_is_as_bad_as_asked_in_one_direction_and_over_a_death() -> None:
    with hosts(2) as pair:
        pair[0].impair(BAD, directions=("from",))
        pair[0].kill()
        pair[0].revive()
        there, back = Receiver(pair[1]), Receiver(pair[0])
        for one, other in (pair, pair[::-1]):
            one.know(other)
        there.hear(pair[0], 0, COUNT)
        back.hear(pair[1], 0, size=20_000)
        # The last word may overtake others.
        found = there.heard(pair[0]) + there.heard(pair[0])
        assert [number for number, _ in back.heard(pair[1])] == list(range(50))
    times = Counter(number for number, _ in found)
    assert near(len(times), COUNT, 1.0 - BAD.loss)
    assert near(sum(n == 2 for n in times.values()), len(times), BAD.duplicate) and max(times.values()) <= 2
    assert min(delay for _, delay in found) >= BAD.delay - BAD.jitter
    assert list(times) != sorted(times), "frames overtake each other"


def test_a_partition_separates_and_heals() -> None:
    with hosts(3) as three:
        receivers = [Receiver(host) for host in three[1:]]
        for first, groups, reached in ((0, [], 0), (50, [[0, 1], [2]], 2), (100, [], 0)):
            three.partition(*groups)
            for receiver in receivers:
                receiver.hear(three[0], first)
            here, far = (
                [n for n, _ in each.heard(three[by])] for each, by in zip(receivers, (0, reached), strict=True)
            )
            assert here == list(range(first, first + 50))
            assert far == ([] if groups else here)


def test_a_killed_host_is_gone_at_once_and_comes_back(possible: str) -> None:
    with hosts(1) as (host,):
        before = set(marked_processes(possible))
        sleeping = host.start(["sleep", "1000"])
        host.run(["sh", "-c", "sleep 1000 >/dev/null 2>&1 &"])
        until(lambda: len(set(marked_processes(possible)) - before) == 2, "both sleep")
        host.kill()
        assert sleeping.returncode == -signal.SIGKILL
        assert len(marked_processes(possible)) == len(before) - 2  # without the host's first process and its holder
        with pytest.raises(AssertionError, match="host0 is dead"):
            host.run(["true"])
        host.revive()
        assert host.run(["hostname"]) == "host0\n"


def test_hosts_are_apart_from_each_other_and_from_this_machine() -> None:
    with hosts(2, networks=2) as pair:
        pair[0].run(["touch", "/dev/shm/mine"])
        assert pair[1].run(["ls", "/dev/shm"]) == "" and not Path("/dev/shm/mine").exists()
        assert len(pair[0].run(["ls", "/proc"]).split()) < len(list(Path("/proc").iterdir()))
        own = {address.address for found in psutil.net_if_addrs().values() for address in found}
        assert own.isdisjoint(address for host in pair for address in host.addresses)
        assert pair[0].ip("route", "show", "default") == ""
        assert pair[0].listening() == set()
        pair[0].udp(4001)
        assert pair[0].listening() == {("udp", pair[0].address)}


ABANDONED = """
import sys
from tests.hosts.cluster import hosts
with hosts(3, networks=2) as three:
    for host in three:
        host.start(["sh", "-c", "sleep 1000 & sleep 1000"])
    print("up", flush=True)
    sys.stdin.read()
"""


def test_nothing_remains_when_a_test_is_killed(possible: str) -> None:
    before, links = marked_processes(possible), psutil.net_if_stats().keys()
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    environment = {**os.environ, **SEARCH_PATH}
    with subprocess.Popen([sys.executable, "-c", ABANDONED], cwd=ROOT, env=environment, **pipes) as test:
        assert test.stdout is not None and test.stdout.readline() == b"up\n"
        until(lambda: list(marked_processes(possible).values()).count("sleep") == 6, "all sleep")
        test.kill()
    until(lambda: marked_processes(possible) == before, "all are gone")
    assert psutil.net_if_stats().keys() == links
