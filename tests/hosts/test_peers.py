"""A fleet without observer and controller: any robot's host may be lost, and a minority stops."""

from pathlib import Path

import pytest
from tests.hosts.cluster import hosts
from tests.hosts.fleet_hosts import PATIENCE, FleetOnHosts
from tests.hosts.peer_trials import Recorded, running
from tests.hosts.switch import Impairment
from tests.hosts.test_fleet import check_partition
from tests.processes import until

from swarmabs_core.messages import EventKind

pytestmark = [pytest.mark.system, pytest.mark.usefixtures("possible")]

LOSSY = Impairment(delay=0.002, jitter=0.002, loss=0.3)


@pytest.mark.timeout(600)
def test_a_fleet_of_peers_survives_the_loss_of_any_robot(tmp_path: Path) -> None:
    with hosts(5) as machines:
        fleet = FleetOnHosts(machines, tmp_path / "fleet", recorder=True, peers=True, quorum=4)
        fleet.install()
        fleet.start()
        done = fleet.base.swarm("reset", fleet.file)
        assert done.returncode == 0, done.stderr
        with fleet.operator() as operator:
            operator.until_following(*fleet.ids)
            operator.until_calm()
            machines.impair(LOSSY)
            operator.until_following(*fleet.ids)

            fleet.robots[1].host.kill()
            until(lambda: [1, EventKind.DEAD, "silent"] in operator.look()["events"], "robot 1 is missed", PATIENCE)
            operator.until_following(2, 3, 4)
            operator.until_calm()
            fleet.robots[1].power_on()
            operator.until_following(*fleet.ids)
            machines.impair(Impairment())
            operator.until_calm()

            operator.until_counted(*fleet.ids)
            check_partition(machines, fleet, operator)
        stopped = fleet.base.swarm("stop", fleet.file)
        assert stopped.returncode == 0, stopped.stderr
        status = fleet.base.swarm("status", fleet.file)
        assert "STOP" in status.stdout or "stop commanded" in status.stdout
        with fleet.operator() as operator:
            operator.reset_until_calm(*fleet.ids, service="agent_003/reset")
        fleet.check_bodies()


@pytest.mark.full
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("seed", ["1", "2"])
def test_no_fault_of_some_stops_others(seed: str, tmp_path: Path) -> None:
    with running(tmp_path / "fleet", seed, tell=print) as trials:
        done = [trials.run(number) for number in range(25)]
    recorded = Recorded(trials.fleet)
    found = {number: recorded.problems(*each) for number, each in enumerate(done)}
    assert not any(found.values()), [(done[number][0], problems) for number, problems in found.items() if problems]
