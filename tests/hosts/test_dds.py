"""DDS between hosts: with static peers and by multicast, on one interface and nowhere else.

Each host is also in a second network, which is not trusted. What listens is read from the kernel; what is sent is
looked at on the interfaces themselves.
"""

from __future__ import annotations

import json
import re
import shlex
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.hosts.capture import captured
from tests.hosts.cluster import Host, finish, hosts, until_ready
from tests.hosts.datagrams import Receiver
from tests.hosts.dds import dds_on
from tests.hosts.impairment import Impairment
from tests.hosts.sockets import bound_sockets, groups_joined
from tests.processes import ROOT

pytestmark = [pytest.mark.system, pytest.mark.timeout(100), pytest.mark.usefixtures("possible")]

CHATTER = "tests.hosts.chatter"
GROUP = "239.255.0.1"
"""Where participants announce themselves by multicast."""


@contextmanager
def talking(pair: Sequence[Host], environments: Sequence[Mapping[str, str]], count: int = 20) -> Iterator[None]:
    """Let the second host hear the first; both go on talking and listening during the block."""
    pipe = subprocess.PIPE
    processes = [
        pair[1].python(CHATTER, "listen", count, times, env=environments[1], stdout=pipe) for times in (1, 10**9)
    ]
    for process in processes:
        until_ready(process)
    processes.append(pair[0].python(CHATTER, "talk", env=environments[0], stdout=pipe))
    try:
        heard = json.loads(finish(processes[0]))
        assert heard == list(range(heard[0], heard[0] + count))
        yield
    finally:
        for process in processes:
            with process:
                process.kill()


def addresses(host: Host) -> set[tuple[str, str]]:
    return {(bound.table, bound.address) for bound in bound_sockets(host.pid)}


@pytest.mark.parametrize("peers", ["static", "multicast"])
def test_hosts_talk_on_one_interface_and_nothing_listens_elsewhere(peers: str, tmp_path: Path) -> None:
    with hosts(2, networks=2) as pair:
        if peers == "static":
            environments = [dds_on(tmp_path, host.address, [other.address for other in pair]) for host in pair]
            groups: set[str] = set()
        else:
            environments = [dds_on(tmp_path, "eth0", None)] * 2
            groups = {GROUP}
        with (
            captured(pair[0], "eth0") as trusted,
            captured(pair[0], "eth1") as untrusted,
            talking(pair, environments),
        ):
            for host in pair:
                # The sockets of this test that look at all frames are bound to no address.
                found = {address for address in addresses(host) if address[0] != "packet"}
                assert found == {("udp", address) for address in {host.address} | groups}
                assert groups_joined(host.pid) == ({"eth0": groups} if groups else {})
    assert trusted["dds"] > 20
    assert untrusted["dds"] == 0


def test_without_a_profile_that_can_be_read_everything_is_open(tmp_path: Path) -> None:
    """Fast DDS notes the error and goes on with its defaults. It also shows that the test above can fail."""
    with hosts(2, networks=2) as pair:
        environment = dds_on(tmp_path, "eth0", ["no address"])
        with captured(pair[0], "eth1") as untrusted, talking(pair, [environment] * 2):
            for host in pair:
                assert ("udp", "0.0.0.0") in addresses(host)
                assert set(groups_joined(host.pid)) == {"lo", "eth0", "eth1"}
    assert untrusted["dds"] > 0


def test_with_an_interface_that_is_not_there_a_node_is_deaf_and_goes_on(tmp_path: Path) -> None:
    """That is safe, but nobody is told: what starts a node has to wait for the interface."""
    with hosts(1) as (host,):
        node = host.python(CHATTER, "listen", 1, env=dds_on(tmp_path, "wg0", None), stdout=subprocess.PIPE)
        assert "All whitelist interfaces were filtered out" in until_ready(node)
        assert bound_sockets(host.pid) == set() and node.poll() is None


def block(listener: subprocess.Popen[Any]) -> list[int]:
    """Wait for the next numbers that a listener says."""
    assert listener.stdout is not None
    return list(json.loads(listener.stdout.readline()))


def in_a_row(listener: subprocess.Popen[Any], beyond: int = 0) -> int:
    """Wait until a listener is beyond a number; return its last. Reliable is what comes once the nodes have met."""
    block(listener)
    heard = block(listener)
    while heard[-1] < beyond:
        heard += block(listener)
    assert heard == list(range(heard[0], heard[0] + len(heard)))
    return heard[-1]


def again_in_a_row(listener: subprocess.Popen[Any]) -> int:
    """Wait until nothing is missing any more; return the last number.

    Who comes back under an old id is taken for the one before, until somebody notices; meanwhile messages get lost.
    """
    heard = block(listener)
    while heard != list(range(heard[0], heard[0] + len(heard))):
        heard = block(listener)
    return in_a_row(listener)


@pytest.mark.full
def test_reliable_topics_survive_bad_networks_partitions_and_reboots(tmp_path: Path) -> None:
    """What does not come ends the test by its time limit."""
    with hosts(3) as three:
        three.impair(Impairment(delay=0.01, jitter=0.01, loss=0.1, duplicate=0.05, reorder=0.05))
        known = [host.address for host in three]
        environments = [dds_on(tmp_path, address, known) for address in known]

        def node(number: int, *words: object) -> subprocess.Popen[Any]:
            return three[number].python(CHATTER, *words, env=environments[number], stdout=subprocess.PIPE)

        node(0, "talk")
        listeners = [node(number, "listen", 50, 10**9) for number in (1, 2)]
        for listener in listeners:
            until_ready(listener)
            in_a_row(listener)
        three.partition([0, 1], [2])
        until_ready(late := node(1, "listen", 100))
        unheard = block(late)  # by the second listener, as long as it is cut off
        three.heal()
        last = [in_a_row(listener, unheard[-1]) for listener in listeners]
        # A host that comes back at once has its old addresses, and gives its processes their old ids.
        three[2].kill()
        three[2].revive()
        listeners[1] = node(2, "listen", 50, 10**9)
        until_ready(listeners[1])
        last[1] = again_in_a_row(listeners[1])
        three[0].kill()
        three[0].revive()
        node(0, "talk")
        for listener, number in zip(listeners, last, strict=True):
            while block(listener)[-1] >= number:  # from the first life
                pass
            again_in_a_row(listener)


def fence(interface: str, address: str) -> list[list[str]]:
    """Return the commands that docs/network.md gives."""
    page = (ROOT / "docs" / "network.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```sh\n((?:ip rule .*\n)+)```$", page, re.MULTILINE)
    lines = block.replace("INTERFACE", interface).replace("ADDRESS", address).splitlines()
    return [shlex.split(line, comments=True) for line in lines]


def test_an_address_keeps_nobody_out_but_a_fence_does() -> None:
    """Linux takes what is for any of its addresses by any of its interfaces."""
    with hosts(3, networks=2) as (robot, friend, intruder):
        intruder.ip("address", "flush", "dev", "eth0")
        intruder.ip("route", "add", robot.address, "via", robot.addresses[1])
        receiver = Receiver(robot)
        assert addresses(robot) == {("udp", robot.address)}
        receiver.hear(intruder, 0, 50)
        assert numbers(receiver, intruder) == [*range(50)]
        for words in fence("eth0", robot.address):
            robot.run(words)
        receiver = Receiver(robot)
        receiver.hear(intruder, 100, 50)
        for host in (robot, friend):
            receiver.hear(host, 200, 50)
        assert numbers(receiver, friend) == [*range(200, 250), *range(200, 250)]


def numbers(receiver: Receiver, sender: Host) -> list[int]:
    """Let a host end a receiver, by the way that its datagrams have taken; return the numbers of all that came."""
    return [number for number, _ in receiver.heard(sender)]
