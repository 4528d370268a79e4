"""`deploy --check --host` on the host itself: an installed bundle, and what may be wrong there."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from tests.hosts.cluster import hosts, until_ready
from tests.hosts.fleet_hosts import FleetOnHosts
from tests.hosts.stations import Station

from swarmabs_config.fleet.participants import nodes_on, ports

pytestmark = [pytest.mark.system, pytest.mark.usefixtures("possible")]


def verdicts(station: Station) -> dict[str, tuple[str, str]]:
    """Return what is found of a host, verdict and text by check; a clock is no namespace's own."""
    done = station.swarm("deploy", "--check", "--json", "/etc/swarmabs/net", "--host", station.name)
    assert done.returncode in {0, 1}, done.stderr
    found = {entry["check"]: (entry["verdict"], entry["text"]) for entry in json.loads(done.stdout)}
    assert done.returncode == any(verdict == "bad" for verdict, _ in found.values())
    del found["clock"]
    return found


@pytest.mark.timeout(200)
def test_a_host_is_examined_where_it_is() -> None:
    # The checkout is where the account of the nodes can enter, unlike the folders of tests.
    with TemporaryDirectory(dir="/tmp") as folder, hosts(3) as machines:
        Path(folder).chmod(0o755)
        fleet = FleetOnHosts(machines, Path(folder) / "fleet")
        fleet.install()
        robot = fleet.robots[1]
        installed = robot.etc / "swarmabs" / "net"
        found = verdicts(robot)
        assert {check: entry for check, entry in found.items() if entry[0] != "ok"} == {}
        expected = {"interface", "ports", "packages", "checkout", "account", "access", "systemd"}
        assert set(found) == {"bundle net/robot-1", *expected}

        (node,) = nodes_on(fleet.loaded.fleet, "robot-1")
        port = ports(fleet.loaded.fleet, node)[1]
        words = ("tests.hosts.datagrams", "receive", robot.host.address, port)
        with robot.host.python(*words, stdout=subprocess.PIPE) as holder:
            until_ready(holder)
            verdict, text = verdicts(robot)["ports"]
            assert verdict == "bad" and text.startswith(f"UDP {port} (Address already in use)")
            holder.kill()
        robot.run("systemctl", "start", "--", fleet.target)
        assert verdicts(robot)["ports"] == ("note", "the fleet's own nodes are running and hold them")
        robot.run("systemctl", "stop", "--", fleet.target)

        installed.parent.chmod(0o700)
        verdict, text = verdicts(robot)["access"]
        assert (verdict, text.partition(",")[0]) == ("bad", "swarmabs has no access to /etc/swarmabs (mode 0700)")
        installed.parent.chmod(0o755)

        parameters = installed / "nodes" / "agent_001.yaml"
        parameters.write_text(parameters.read_text().replace("0.3552", "3.552"))
        (installed / "complete").unlink()
        verdict, text = verdicts(robot)["bundle net/robot-1"]
        assert verdict == "bad" and "its installation was interrupted" in text
        robot.run(fleet.bundles / "robot-1" / "install.sh")
        parameters.write_text(parameters.read_text().replace("0.3552", "3.552"))
        verdict, text = verdicts(robot)["bundle net/robot-1"]
        assert verdict == "bad" and "agent_001.yaml has been changed; copy or install the bundle again" in text

        robot.host.ip("address", "delete", f"{robot.host.address}/24", "dev", "eth0")
        robot.host.ip("address", "add", "10.83.0.99/24", "dev", "eth0")
        verdict, text = verdicts(robot)["interface"]
        assert verdict == "bad" and f"has not the address {robot.host.address} but 10.83.0.99" in text
        robot.host.ip("link", "set", "eth0", "down")
        robot.host.ip("link", "set", "eth0", "name", "eth7")
        verdict, text = verdicts(robot)["interface"]
        assert verdict == "bad" and text.startswith("there is no eth0 here (eth7, lo); ")
