"""The test hosts do what the tests that use them rely on: they are apart, reach each other and leave nothing.

Times are lower bounds only; what is lost is counted, within five standard deviations.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from math import sqrt
from pathlib import Path
from typing import Literal

import psutil
import pytest
from tests.hosts.cluster import Hosts, hosts
from tests.hosts.datagrams import Receiver
from tests.hosts.impairment import Impairment
from tests.hosts.sockets import Bound, bound_sockets
from tests.hosts.switches import netem
from tests.processes import ROOT, SEARCH_PATH, marked_processes, until

pytestmark = [pytest.mark.system, pytest.mark.timeout(100), pytest.mark.usefixtures("possible")]

Kind = Literal["software", "kernel"]
COUNT = 2000
both = pytest.mark.parametrize("switch", ["software", "kernel"])


def exchange(pair: Hosts, count: int = COUNT) -> list[tuple[int, float]]:
    receiver = Receiver(pair[1])
    pair[0].know(pair[1])
    receiver.hear(pair[0], 0, count)
    return receiver.heard(pair[0])


def near(found: int, count: int, probability: float) -> bool:
    return abs(found - count * probability) < 5.0 * sqrt(count * probability * (1.0 - probability))


@contextmanager
def impaired(switch: Kind, how: Impairment, request: pytest.FixtureRequest) -> Iterator[Hosts]:
    """Have two hosts, the first of which is impaired in what it sends; the kernel's way where the kernel can."""
    if switch == "kernel":
        request.getfixturevalue("netem")
    with hosts(2, switch=switch) as pair:
        pair[0].impair(how, directions=("from",))
        yield pair


@both
def test_hosts_reach_each_other_with_datagrams_of_any_size(switch: Kind) -> None:
    with hosts(2, switch=switch) as pair:
        receiver = Receiver(pair[1])
        for first, size in ((0, 100), (100, 1400), (200, 20_000)):
            receiver.hear(pair[0], first, 100, size=size, period=1e-3)
        heard = receiver.heard(pair[0])
    assert [number for number, _ in heard] == list(range(300))


@both
def test_a_delay_with_jitter_holds_datagrams_back_in_order(switch: Kind, request: pytest.FixtureRequest) -> None:
    with impaired(switch, Impairment(delay=0.03, jitter=0.01), request) as pair:
        heard = exchange(pair)
    assert [number for number, _ in heard] == list(range(COUNT))
    assert min(delay for _, delay in heard) >= 0.02


@both
def test_losses_are_as_frequent_as_asked(switch: Kind, request: pytest.FixtureRequest) -> None:
    with impaired(switch, Impairment(loss=0.1), request) as pair:
        numbers = [number for number, _ in exchange(pair)]
    assert numbers == sorted(set(numbers))
    assert near(len(numbers), COUNT, 0.9)


@both
def test_duplicates_are_as_frequent_as_asked(switch: Kind, request: pytest.FixtureRequest) -> None:
    with impaired(switch, Impairment(duplicate=0.1), request) as pair:
        times = Counter(number for number, _ in exchange(pair))
    assert sorted(times) == list(range(COUNT)) and set(times.values()) == {1, 2}
    assert near(sum(n == 2 for n in times.values()), COUNT, 0.1)


@both
def test_order_changes_when_asked(switch: Kind, request: pytest.FixtureRequest) -> None:
    with impaired(switch, Impairment(delay=0.02, reorder=0.1), request) as pair:
        heard = exchange(pair)
    numbers = [number for number, _ in heard]
    # The order to end may overtake as well.
    assert numbers != sorted(numbers) and len(set(numbers)) == len(numbers) > COUNT / 2
    overtaking = sum(delay < 0.02 for _, delay in heard)
    assert near(overtaking, COUNT, 0.1)


def test_impairments_hold_for_one_direction_and_over_a_death() -> None:
    with hosts(2) as pair:
        pair[0].impair(Impairment(loss=1.0), directions=("to",))
        pair[0].kill()
        pair[0].revive()
        to, back = Receiver(pair[1]), Receiver(pair[0])
        for one, other in (pair, pair[::-1]):  # no answer comes in, so the first could not ask
            one.know(other)
        to.hear(pair[0], 0, 50)
        back.hear(pair[1], 0, 50)
        pair[0].impair(Impairment())
        back.hear(pair[1], 50, 50)
        assert [number for number, _ in to.heard(pair[0])] == list(range(50))
        assert [number for number, _ in back.heard(pair[1])] == list(range(50, 100))


@both
def test_a_partition_separates_and_heals(switch: Kind) -> None:
    with hosts(3, switch=switch) as three:
        receivers = {number: Receiver(three[number]) for number in (1, 2)}
        for first, groups in enumerate(([], [[0, 1], [2]], [])):
            three.partition(*groups)
            for receiver in receivers.values():
                receiver.hear(three[0], 100 * first, 50)
        heard = {number: [n // 100 for n, _ in receiver.heard(three[0])] for number, receiver in receivers.items()}
    assert heard[1] == [0] * 50 + [1] * 50 + [2] * 50
    assert heard[2] == [0] * 50 + [2] * 50


@both
def test_a_killed_host_is_gone_at_once_and_comes_back(switch: Kind, possible: str) -> None:
    with hosts(2, switch=switch) as pair:
        before = set(marked_processes(possible))
        sleeping = pair[1].start(["sleep", "1000"])
        daemon = pair[1].run(["sh", "-c", "sleep 1000 >/dev/null 2>&1 & echo $!"])
        assert daemon.strip().isdigit()
        until(lambda: len(set(marked_processes(possible)) - before) == 2, "both sleep")
        pair[1].kill()
        assert sleeping.returncode == -signal.SIGKILL
        assert len(marked_processes(possible)) == len(before) - 2  # without the host's first process and its holder
        with pytest.raises(AssertionError, match="host1 is dead"):
            pair[1].run(["true"])
        pair[1].revive()
        assert len(exchange(pair, 20)) == 20


def test_hosts_are_apart_from_each_other_and_from_this_machine() -> None:
    with hosts(2, networks=2) as pair:
        assert [host.run(["hostname"]).strip() for host in pair] == ["host0", "host1"]
        pair[0].run(["touch", "/dev/shm/mine"])
        assert pair[1].run(["ls", "/dev/shm"]) == "" and not Path("/dev/shm/mine").exists()
        assert len(pair[0].run(["ls", "/proc"]).split()) < len(list(Path("/proc").iterdir()))
        assert pair[0].run(["sh", "-c", "echo $$"]).strip() != "1"
        addresses = {
            address.address
            for found in psutil.net_if_addrs().values()
            for address in found
            if address.address.startswith("10.83.")
        }
        assert addresses.isdisjoint(address for host in pair for address in host.addresses)
        outside = pair[0].start(
            [sys.executable, "-c", "import socket; socket.create_connection(('192.0.2.1', 80))"], stderr=subprocess.PIPE
        )
        assert "Network is unreachable" in outside.communicate()[1]


def test_sockets_are_found_with_their_addresses() -> None:
    opening = """
import socket as s, sys
kept = []
for family, kind, address in ((s.AF_INET, s.SOCK_DGRAM, "10.83.0.1"), (s.AF_INET, s.SOCK_STREAM, "0.0.0.0"),
                              (s.AF_INET6, s.SOCK_DGRAM, "::1"), (s.AF_INET6, s.SOCK_STREAM, "::")):
    kept.append(s.socket(family, kind))
    kept[-1].setsockopt(s.SOL_SOCKET, s.SO_REUSEADDR, 1)
    kept[-1].bind((address, 4000 + len(kept)))
    if kind is s.SOCK_STREAM:
        kept[-1].listen()
kept.append(s.socket(s.AF_PACKET, s.SOCK_RAW, s.htons(3)))
kept[-1].bind(("eth0", s.htons(3)))
kept.append(s.socket(s.AF_INET, s.SOCK_RAW, 89))
print("open", flush=True)
sys.stdin.read()
"""
    with hosts(1) as (host,):
        assert bound_sockets(host.pid) == set()
        words = [sys.executable, "-c", opening]
        with host.start(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
            assert process.stdout is not None and process.stdout.readline() == "open\n"
            found = bound_sockets(host.pid)
            (index,) = (bound.port for bound in found if bound.table == "packet")
        assert index > 0 and found == {
            Bound("udp", "10.83.0.1", 4001),
            Bound("tcp", "0.0.0.0", 4002),
            Bound("udp6", "::1", 4003),
            Bound("tcp6", "::", 4004),
            Bound("packet", "", index),
            Bound("raw", "0.0.0.0", 89),
        }


ABANDONED = """
import sys
from tests.hosts.cluster import hosts
with hosts(2, networks=2) as pair, hosts(1, switch='kernel') as (other,):
    for host in (*pair, other):
        host.start(["sh", "-c", "sleep 1000 & sleep 1000"])
    print("up", flush=True)
    sys.stdin.read()
"""


def test_nothing_remains_when_a_test_is_killed(possible: str) -> None:
    before, links = marked_processes(possible), psutil.net_if_stats().keys()
    with subprocess.Popen(
        [sys.executable, "-c", ABANDONED],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        cwd=ROOT,
        env={**os.environ, **SEARCH_PATH},
    ) as test:
        assert test.stdout is not None and test.stdout.readline() == b"up\n"
        until(lambda: list(marked_processes(possible).values()).count("sleep") == 6, "all sleep")
        test.kill()
    until(lambda: marked_processes(possible) == before, "all are gone")
    assert psutil.net_if_stats().keys() == links


@pytest.mark.parametrize(
    "how",
    [
        Impairment(),
        Impairment(delay=0.05, jitter=0.02, loss=0.01, duplicate=0.02),
        Impairment(delay=0.05, reorder=0.25),
    ],
)
def test_tc_understands_what_is_asked_of_netem(how: Impairment) -> None:
    """The kernel may refuse; the command itself may not. It says so before the kernel is asked."""
    words = ["unshare", "--net", "tc", "qdisc", "add", "dev", "lo", "root", *netem(how)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert not done.stderr or "qdisc kind is unknown" in done.stderr
