"""The fence of a bundle: who is in another network no longer reaches the address that the nodes are bound to."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.hosts.cluster import Host, hosts
from tests.hosts.datagrams import Receiver

from swarmabs_config.fleet.loader import load_fleet
from swarmabs_fleet.bundle import deploy

pytestmark = [pytest.mark.system, pytest.mark.timeout(100), pytest.mark.usefixtures("possible")]

FLEET = """\
schema: 1
name: fenced
hosts:
{hosts}
robots:
  - {{id: 1, host: robot, kind: single_integrator, mass: 0.4, drive: {{type: simulated, position: 0.1}}}}
  - {{id: 2, host: robot, kind: single_integrator, mass: 0.4, drive: {{type: simulated, position: -0.1}}}}
coordinators: {{plane: {{host: base}}, observer: {{host: base}}, controller: {{host: base}}}}
network: {{domain: 7}}
security: {security}
installation: {{prefix: {prefix}}}
"""
OTHER = "203.0.113.9"
"""Address of another fleet on the same host."""


def bundle(folder: Path, robot: Host, base: Host, level: str) -> Path:
    """Deploy a fleet whose nodes are bound to the address of eth0, and return the robot's installed bundle.

    As a tunnel eth0 is as good as any other interface: what is beneath is eth1.
    """
    if level == "tunnel":
        listed = [(host.addresses[1], f"interface: eth1, tunnel_address: {host.address}") for host in (robot, base)]
        security, keys = "{level: tunnel, interface: eth0}", folder / "keys"
    else:
        listed = [(host.address, "interface: eth0") for host in (robot, base)]
        security, keys = "{level: none}", None
    names = zip(("robot", "base"), listed, strict=True)
    lines = [f"  - {{name: {name}, address: {address}, {rest}}}" for name, (address, rest) in names]
    file = folder / "fenced.yaml"
    prefix = folder / "etc"
    file.write_text(FLEET.format(hosts="\n".join(lines), security=security, prefix=prefix), encoding="utf-8")
    deploy(load_fleet(file), folder / "bundles", keys)
    prefix.mkdir()
    return (folder / "bundles" / "robot").rename(prefix / "fenced")


def commands(installed: Path, level: str) -> tuple[str, str]:
    """Return what puts the fence up and what takes it down."""
    if level == "tunnel":
        lines = (installed / "wireguard" / "eth0.conf").read_text().splitlines()
        (up,) = (line.removeprefix("PreUp = ") for line in lines if line.startswith("PreUp"))
        (down,) = (line.removeprefix("PostDown = ") for line in lines if line.startswith("PostDown"))
        return up, down
    return f"{installed}/fence.sh up", f"{installed}/fence.sh down"


@pytest.mark.parametrize("level", ["none", "tunnel"])
def test_a_fence_keeps_others_out_and_can_be_taken_down(level: str, tmp_path: Path) -> None:
    with hosts(3, networks=2) as (robot, friend, stranger):
        up, down = commands(bundle(tmp_path, robot, friend, level), level)
        stranger.ip("address", "flush", "dev", "eth0")
        stranger.ip("route", "add", robot.address, "via", robot.addresses[1])
        rules = robot.ip("rule")
        receiver = Receiver(robot)
        receiver.hear(stranger, 0, 50)
        for _ in range(2):
            robot.run(["sh", "-c", up])
            receiver.hear(stranger, 100, 50)
            for host in (friend, robot):
                receiver.hear(host, 200, 50)
        # Of another fleet's fence nothing is taken down.
        robot.ip("rule", "add", "pref", "3", "to", OTHER, "blackhole")
        for _ in range(2):
            robot.run(["sh", "-c", down])
            receiver.hear(stranger, 300, 50)
        assert OTHER in robot.ip("rule") and robot.address not in robot.ip("rule")
        robot.ip("rule", "delete", "pref", "3", "to", OTHER)
        robot.run(["sh", "-c", down])
        assert robot.ip("rule") == rules
        heard = [number // 100 for number, _ in receiver.heard(friend)]
    assert heard == [0] * 50 + [2] * 200 + [3] * 100


def test_what_is_neither_up_nor_down_is_refused(tmp_path: Path) -> None:
    with hosts(2, networks=2) as (robot, friend):
        installed = bundle(tmp_path, robot, friend, "none")
        rules = robot.ip("rule")
        for word in ("", "UP", "--help"):
            process = robot.start([installed / "fence.sh", word], stderr=-1)
            _, error = process.communicate()
            assert (process.returncode, error) == (1, "fence.sh: say up or down\n")
        assert robot.ip("rule") == rules
