"""DDS through a tunnel: nothing of it is seen on the wire, and nobody without a key takes part."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest
from tests.hosts.capture import captured
from tests.hosts.cluster import Hosts, hosts
from tests.hosts.datagrams import Receiver
from tests.hosts.dds import dds_on
from tests.hosts.sockets import Bound, bound_sockets
from tests.hosts.test_dds import fence, talking
from tests.hosts.wireguard import PORT, Keys, start_tunnel, why_no_tunnel

pytestmark = [pytest.mark.system, pytest.mark.timeout(100), pytest.mark.usefixtures("possible", "tunnels")]

_why_no_tunnel = cache(why_no_tunnel)
INNER = ("10.84.0.1", "10.84.0.2")


@pytest.fixture
def tunnels() -> None:
    if reason := _why_no_tunnel():
        pytest.skip(reason)


def join(members: Hosts, *keys: Keys) -> None:
    """Connect the first two hosts by a tunnel."""
    for one, other in ((0, 1), (1, 0)):
        start_tunnel(members[one], INNER[one], keys[one], {INNER[other]: (keys[other], members[other].address)})


def test_dds_is_in_the_tunnel_only(tmp_path: Path) -> None:
    with hosts(2) as pair:
        join(pair, Keys.new(), Keys.new())
        environments = [dds_on(tmp_path, address, INNER) for address in INNER]
        with (
            captured(pair[0], "eth0") as outside,
            captured(pair[0], "wg0") as inside,
            talking(pair, environments),
        ):
            for host, address in zip(pair, INNER, strict=True):
                found = {bound for bound in bound_sockets(host.pid) if bound.table != "packet"}
                wire = {Bound("udp", "0.0.0.0", PORT), Bound("udp6", "::", PORT)}
                assert wire < found and {bound.address for bound in found - wire} == {address}
    assert inside["dds"] > 20
    assert outside["frames"] > 20 and outside["dds"] == 0


def test_only_the_right_key_and_a_fence_keep_strangers_out(tmp_path: Path) -> None:
    with hosts(3) as all_hosts:
        robot, friend, stranger = all_hosts
        keys = [Keys.new(), Keys.new()]
        join(all_hosts, *keys)
        receiver = Receiver(robot, INNER[0])
        receiver.hear(friend, 0, 50)
        stranger.ip("route", "add", INNER[0], "via", robot.address)
        receiver.hear(stranger, 100, 50)
        for words in fence("wg0", INNER[0]):
            robot.run(words)
        receiver.hear(stranger, 200, 50)
        # With a key that the robot does not know, the stranger's tunnel never comes to be.
        stranger.ip("route", "delete", INNER[0])
        start_tunnel(stranger, "10.84.0.3", Keys.new(), {INNER[0]: (keys[0], robot.address)})
        receiver.hear(stranger, 300, 50)
        receiver.hear(friend, 400, 50)
        heard = [number // 100 for number, _ in receiver.heard(friend)]
    assert heard == [0] * 50 + [1] * 50 + [4] * 50
