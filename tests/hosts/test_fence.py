"""The fence of a bundle: who is in another network no longer reaches the address that the nodes are bound to."""

import re
from pathlib import Path

import pytest
from tests.hosts.cluster import Host, hosts
from tests.hosts.datagrams import Receiver
from tests.processes import ROOT
from tests.swarmabs_fleet.fleets import ONE_HOST, deployed, edited

from swarmabs_config.fleet.loader import load_fleet

pytestmark = [pytest.mark.system, pytest.mark.timeout(300), pytest.mark.usefixtures("possible")]

OTHER = "203.0.113.9"
"""Address of another fleet on the same host."""


def commands(folder: Path, host: Host, level: str) -> tuple[str, str]:
    """Return what puts the fence of eth0 up and what takes it down: of a bundle, or docs/how-to/network.md.

    As a tunnel eth0 is as good as any other interface: what is beneath is eth1.
    """
    place, prefix, keys = f"address: {host.address}, interface: eth0", folder / "etc", None
    changes = [("/etc/swarmabs", str(prefix))]
    if level == "tunnel":
        keys = folder / "keys"
        place = f"address: {host.addresses[1]}, interface: eth1, tunnel_address: {host.address}"
        changes.append(("level: none", "level: tunnel, interface: eth0"))
    file = edited(folder / "one.yaml", ONE_HOST, ("address: 127.0.0.1, interface: lo", place), *changes)
    prefix.mkdir()
    installed = (deployed(load_fleet(file), folder / "out", keys) / "base").rename(prefix / "one")
    up, down = f"{installed}/fence.sh up", f"{installed}/fence.sh down"
    if level == "tunnel":
        text = (installed / "wireguard" / "eth0.conf").read_text()
        assert f"\nPreUp = {up}\nPostDown = {down}\n" in text
    return (rules_of_the_page("eth0", host.address) if level == "page" else up), down


def rules_of_the_page(interface: str, address: str) -> str:
    """Return the commands of docs/how-to/network.md that put up a fence."""
    page = (ROOT / "docs" / "how-to" / "network.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```sh\n((?:ip rule .*\n)+)```$", page, re.MULTILINE)
    return str(block).replace("INTERFACE", interface).replace("ADDRESS", address)


@pytest.mark.parametrize("level", ["none", "tunnel", "page"])
def test_a_fence_keeps_others_out_and_can_be_taken_down(level: str, tmp_path: Path) -> None:
    with hosts(3, networks=2) as (robot, friend, stranger):
        up, down = commands(tmp_path, robot, level)
        stranger.ip("address", "flush", "dev", "eth0")
        stranger.ip("address", "add", stranger.address, "dev", "eth1")
        stranger.ip("route", "add", robot.address, "via", robot.addresses[1])
        rules = robot.ip("rule")
        receiver = Receiver(robot)

        def heard(by: Host) -> set[int]:
            return {number // 100 for number, _ in receiver.heard(by)}

        assert not heard(stranger)  # waits until the links, which have just been made, carry something
        receiver.hear(stranger, 0)
        assert heard(stranger) == {0}
        for _ in range(1 if level == "page" else 2):  # the script may be repeated
            robot.run(["sh", "-c", up])
            for number, host in enumerate((stranger, friend, robot), start=1):
                receiver.hear(host, 100 * number)
            assert heard(friend) == {2, 3}
        # Of another fleet's fence nothing is taken down.
        robot.ip("rule", "add", "pref", "3", "to", OTHER, "blackhole")
        for _ in range(2):
            robot.run(["sh", "-c", down])
            receiver.hear(stranger, 400)
            assert heard(stranger) == {4}
        assert OTHER in robot.ip("rule") and robot.address not in robot.ip("rule")
        robot.ip("rule", "delete", "pref", "3", "to", OTHER)
        for word in ("", "UP", "--help"):
            refused = robot.start([*down.split()[:1], word], stderr=-1)
            assert (refused.communicate()[1], refused.returncode) == ("fence.sh: give up or down as the argument\n", 1)
        robot.run(["sh", "-c", down])
        assert robot.ip("rule") == rules
