"""Fleets in real time tolerate what hypothesis does to them, and what goes wrong is found."""

from __future__ import annotations

import pytest
from hypothesis import given, note, settings, strategies as st
from tests.soak.conftest import FEW, LONG
from tests.soak.disturbances import UNTIL, Disturbance, disturbances
from tests.soak.fleet import fleet_violations, of_a_fleet
from tests.soak.scenarios import Draw, scenarios
from tests.swarmabs_core.helpers import builtin
from tests.virtual_fleet import VirtualFleet

from swarmabs_config.graph import agent_name
from swarmabs_config.scenario import Scenario, dump_scenario
from swarmabs_core.realtime.broadcasts import BroadcastInbox
from swarmabs_core.realtime.envelope import LaneEnvelope

pytestmark = pytest.mark.timeout(300)

Trial = tuple[Scenario, list[Disturbance]]


@st.composite
def trials(draw: Draw) -> Trial:
    """Draw a fleet and what is done to it."""
    scenario = of_a_fleet(draw(scenarios()))
    return scenario, draw(disturbances([agent.id for agent in scenario.agents]))


def broken(trial: Trial) -> set[str]:
    return {violation.invariant for violation in fleet_violations(*trial)}


def tell(trial: Trial) -> None:
    scenario, disturbed = trial
    note(dump_scenario(scenario))
    note("\n".join(f"{disturbance.time} s: {disturbance.kind or 'end'}" for disturbance in disturbed))


@settings(FEW)
@given(trial=trials())
def test_a_fleet_tolerates_what_is_done_to_it(trial: Trial) -> None:
    tell(trial)
    assert fleet_violations(*trial) == []


@pytest.mark.full
@pytest.mark.timeout(0)
@settings(LONG)
@given(trial=trials())
def test_a_fleet_tolerates_what_is_done_to_it_for_long(trial: Trial) -> None:
    tell(trial)
    assert fleet_violations(*trial) == []


@settings(FEW, max_examples=50)
@given(disturbed=disturbances(range(1, 5)))
def test_everything_is_over_in_time(disturbed: list[Disturbance]) -> None:
    assert all(0.0 < disturbance.time <= UNTIL for disturbance in disturbed)
    assert [disturbance.time for disturbance in disturbed] == sorted(disturbance.time for disturbance in disturbed)


@pytest.fixture
def trial() -> Trial:
    """Four robots, one of which hears nothing for a while."""

    def cut(fleet: VirtualFleet) -> None:
        fleet.network.cut = frozenset({agent_name(1)})

    def mend(fleet: VirtualFleet) -> None:
        fleet.network.cut = frozenset()

    disturbed = [Disturbance(2.0, "partition", cut), Disturbance(4.0, None, mend)]
    return of_a_fleet(builtin("pd_het_4", "duration=6")), disturbed


def test_a_robot_that_leaves_its_lane_is_found(trial: Trial, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LaneEnvelope, "apply", lambda self, position, velocity, command: 1.0)
    assert "lane" in broken(trial)


def test_a_robot_that_acts_on_old_broadcasts_is_found(trial: Trial, monkeypatch: pytest.MonkeyPatch) -> None:
    def lenient(inbox: BroadcastInbox, now: int) -> str:
        return "" if inbox.newest is not None else "nothing heard"

    assert "stale data" not in broken(trial)
    monkeypatch.setattr(BroadcastInbox, "problem", lenient)
    assert "stale data" in broken(trial)
