"""Trials of standby coordinators on a fleet of eight robots: what faults cost, by the bags of both recorders."""

from pathlib import Path

import pytest
from tests.hosts.trials import Bags, Recorded, drawn, running

pytestmark = [pytest.mark.full, pytest.mark.timeout(1800), pytest.mark.usefixtures("possible")]

COUNT = 25


@pytest.mark.parametrize("seed", ["1", "2", "3", "4"])
def test_no_fault_stops_a_robot_for_long(seed: str, tmp_path: Path) -> None:
    folder = tmp_path / "fleet"
    with running(folder, seed, print) as trials:
        times = [trials.run(number) for number in range(COUNT)]
        restarted = trials.restart()
    assert Bags.of(folder).merge(trials.fleet.checkout.swarm, folder) == []
    recorded = Recorded(folder / "AB")
    found = {number: recorded.outcome(*each).problems for number, each in enumerate(times)}
    assert not any(found.values()), [(drawn(seed, number), problems) for number, problems in found.items() if problems]
    assert recorded.takeovers > 0
    assert recorded.outcome(*restarted).problems == [], "a restart of host after host"
