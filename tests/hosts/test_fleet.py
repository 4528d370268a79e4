"""A fleet on several hosts: late starts, bad networks, partitions, power cuts; and what others do in its network."""

import time
from collections.abc import Collection
from pathlib import Path
from typing import Any

import pytest
from tests.hosts.cluster import Hosts, hosts
from tests.hosts.fleet_hosts import CALM, CALM_FOR, PATIENCE, FleetOnHosts, Operator
from tests.hosts.storm import BOUND, Storm, stands
from tests.hosts.switch import Impairment
from tests.processes import until

from swarmabs_bag.reader import open_bag
from swarmabs_core.messages import PLANE_STATE, EventKind, Mode, PlaneState, Status
from swarmabs_fleet.node_files import DISCOVERY_GROUP

pytestmark = [pytest.mark.system, pytest.mark.usefixtures("possible")]

BAD = Impairment(delay=0.015, jitter=0.005, loss=0.02)


def check_stopped(fleet: FleetOnHosts, number: int, since: int) -> None:
    """Prove that a robot that heard nothing after a time (ns) stopped within the bound of docs/explanation/safety.md.

    Times are those for which the robot decides, so a process that is kept waiting changes nothing.
    """
    bound = since + BOUND
    until(lambda: fleet.notes(number)[-1].now > bound + 10**9, f"robot {number} goes on looking", PATIENCE)
    after = [note for note in fleet.notes(number) if note.now > bound]
    assert all(map(stands, after))
    assert abs(after[-1].velocity) < 1e-3


def check_partition(machines: Hosts, fleet: FleetOnHosts, operator: Operator) -> None:
    """Prove that robots 3 and 4 stop while they are cut off, robots 1 and 2 go on, and then all of them."""
    machines.partition([0, 1, 2], [3, 4])
    cut = time.time_ns()
    for number in (3, 4):
        check_stopped(fleet, number, cut)
    operator.until_following(1, 2)
    machines.partition()
    operator.until_following(*fleet.ids)
    operator.until_calm()


def check_sockets(fleet: FleetOnHosts, groups: Collection[str] = ()) -> None:
    """Prove that hosts can be reached by their address in the fleet only, and in multicast groups."""
    for station in fleet.stations:
        assert station.host.listening() == {("udp", each) for each in (station.host.address, *groups)}, station.name


@pytest.mark.timeout(600)
def test_a_fleet_survives_what_networks_and_hosts_do(tmp_path: Path) -> None:
    with hosts(5) as machines:
        fleet = FleetOnHosts(machines, tmp_path / "fleet", recorder=True)
        fleet.install()
        late = fleet.robots[4]
        late.host.kill()
        fleet.start(*(station for station in fleet.stations if station is not late))
        done = fleet.base.swarm("reset", fleet.file)
        assert done.returncode == 0, done.stderr
        with fleet.operator() as operator:
            operator.until_following(1, 2, 3)
            operator.until_calm()
            machines.impair(BAD)
            late.power_on()
            operator.until_following(4)
            operator.until_calm()
            check_sockets(fleet)

            check_partition(machines, fleet, operator)
            # What was said meanwhile is reliable.
            for number in (3, 4):
                said = [number, EventKind.SAFE_STOP, "the broadcasts are outdated"]
                until(lambda said=said: said in operator.look()["events"], f"{said} is heard", PATIENCE)  # type: ignore[misc]

            fleet.robots[2].host.kill()
            until(lambda: [2, EventKind.DEAD, "silent"] in operator.look()["events"], "robot 2 is missed", PATIENCE)
            operator.until_following(1, 3, 4)
            fleet.robots[2].power_on()
            operator.until_following(*fleet.ids)
            fleet.robots[1].run(f"/etc/swarmabs/{fleet.name}/restart.sh")
            operator.until_following(*fleet.ids)
            operator.until_calm()
        fleet.base.host.kill()
        cut = time.time_ns()
        for number in fleet.ids:
            check_stopped(fleet, number, cut)
        fleet.base.power_on()
        fleet.base.until_active(fleet.target)
        with fleet.operator() as operator:
            operator.reset_until_calm(*fleet.ids)
        fleet.base.run("systemctl", "stop", "--", fleet.target)
        fleet.check_bodies()
        _, bag = fleet.bags(fleet.base)
        verified = fleet.base.swarm("verify", bag)
        assert verified.returncode == 0, verified.stdout + verified.stderr
        angles = [
            message.angle for _, _, message in open_bag(bag).decoded({PLANE_STATE}) if isinstance(message, PlaneState)
        ]
        assert angles[0] == 0.1
        assert max(map(abs, angles[-CALM_FOR // 2 :])) <= CALM


@pytest.mark.full
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("seed", ["1", "2"])
def test_a_storm(seed: str, tmp_path: Path) -> None:
    with hosts(5, seed=seed) as machines:
        fleet = FleetOnHosts(machines, tmp_path / "fleet")
        fleet.install()
        fleet.start()
        storm = Storm(machines, fleet, seed, print)
        for number in range(8):
            storm.round(number)


@pytest.mark.full
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("discovery", ["multicast", "server"])
def test_other_ways_of_discovery(discovery: str, tmp_path: Path) -> None:
    """With a discovery server, which is on the base, its return is seen, too."""
    with hosts(4, networks=2) as machines:
        fleet = FleetOnHosts(machines, tmp_path / "fleet", discovery=discovery)
        fleet.install()
        fleet.start()
        fleet.lose_hosts()
        groups = {DISCOVERY_GROUP} if discovery == "multicast" else set()
        check_sockets(fleet, groups)
        for station in fleet.stations:
            assert station.host.groups() == ({"eth0": groups} if groups else {})
        fleet.check_bodies()


@pytest.mark.full
@pytest.mark.timeout(1200)
@pytest.mark.parametrize(
    ("own", "foreign"),
    [
        # They meet: each announces itself to a group that the other has joined.
        ({"discovery": "multicast"}, {"discovery": "multicast", "namespace": "/twin"}),
        ({"discovery": "multicast"}, {"discovery": "multicast", "domain": 8}),
        # They do not: addresses are listed.
        ({"discovery": "static"}, {"discovery": "static", "first_id": 11}),
    ],
)
def test_a_foreign_swarm_is_ignored(own: dict[str, Any], foreign: dict[str, Any], tmp_path: Path) -> None:
    with hosts(6) as machines:
        first = FleetOnHosts(machines[:3], tmp_path / "first", quorum=2, **own)
        second = FleetOnHosts(machines[3:], tmp_path / "second", quorum=2, name="foreign", **foreign)
        for fleet in (first, second):
            fleet.install()
            fleet.start()
        with first.operator() as one, second.operator() as other:
            for operator, fleet in ((one, first), (other, second)):
                operator.reset()
                operator.until_following(*fleet.ids)
            # Stopping one swarm is no business of the other's.
            assert other.trigger("swarm/stop") == [True, ""]
            for number in second.ids:
                stopped = lambda number=number: other.state(number)["status"] == Status.SAFE_STOP  # noqa: E731
                until(stopped, f"robot {number} of the other swarm stops", PATIENCE)
            one.until_following(*first.ids)
            one.until_calm()
            if own["discovery"] == "multicast" and "namespace" in foreign:
                until(lambda: one.nodes().count("plane_sim") == 2, "they meet", PATIENCE)
            # A busy machine is late, which is refused, too; what is of another swarm would be refused as such.
            refused = {detail for _, kind, detail in one.look()["events"] if kind == EventKind.REFUSED}
            assert all("outdated" in detail for detail in refused), refused
            assert one.look()["modes"][-3:] == [Mode.STOP, Mode.RESET, Mode.RUN]
            other.reset_until_calm(*second.ids)
        first.check_bodies()
        second.check_bodies()
