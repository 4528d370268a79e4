"""Fleets that start on machines with too much load: periods missed in bursts, messages late by seconds, all at once."""

from random import Random

import pytest
from tests.swarmabs_core.helpers import builtin
from tests.transport.test_fleet import active
from tests.transport.test_leadership import PRIMARIES, STANDBYS, longest_stop, speakers
from tests.virtual.fleet import VirtualFleet

from swarmabs_config.graph import CONTROLLER, PLANE, standby_name
from swarmabs_core.messages import NEVER, AbstractState, AgentState, DesiredAbstractState, Mode
from swarmabs_core.nodes import agent_name

LONGEST_LOAD = 6.0
WITHIN, CALM = 1.5, 0.5
"""Time, s, after the load within which all robots follow, with the second of a reset, and for which they then do."""
ROBOTS = (1, 2, 3, 4)
NODES = (PLANE, *PRIMARIES, *STANDBYS, *map(agent_name, ROBOTS))


class Overload:
    """Load on all machines: nodes start late, stand still for up to seconds, die, and hear what is seconds old."""

    def __init__(self, fleet: VirtualFleet, draw: Random) -> None:
        self._fleet = fleet
        self._draw = draw
        self._over = False
        self._share = draw.choice((0.03, 0.25, 0.6))
        self._longest = draw.choice((0.1, 0.5, 3.0))
        self._latest = draw.choice((0.05, 0.5, 3.0))
        self._deadly = draw.choice((0.0, 0.1))

    def run(self) -> None:
        """Start all nodes under load, for some seconds; then it ends, but what was late then arrives late."""
        fleet, lasting = self._fleet, self._draw.uniform(1.0, LONGEST_LOAD)
        for name in fleet.names:
            fleet.later(self._draw.uniform(0.0, 0.7 * lasting), lambda name=name: self._begin(name))  # type: ignore[misc]
        fleet.run(lasting)
        self._over = True
        fleet.network.slow.clear()
        for name in fleet.names:
            fleet.revive(name)
            fleet.resume(name)

    def _begin(self, name: str) -> None:
        if not self._over:
            self._fleet.revive(name)
            self._stand(name)

    def _stand(self, name: str) -> None:
        if self._over:
            return
        fleet, draw = self._fleet, self._draw
        away = draw.uniform(0.0, self._longest)
        fleet.network.slow[name] = draw.uniform(0.0, self._latest)
        if draw.random() < self._deadly:
            fleet.kill(name)
            fleet.later(away, lambda: self._begin(name))
        else:
            fleet.pause(name)
            fleet.later(away, lambda: self._go_on(name, away * self._share))

    def _go_on(self, name: str, lasting: float) -> None:
        if not self._over:
            self._fleet.resume(name)
            self._fleet.later(lasting, lambda: self._stand(name))


def check(seed: int) -> None:
    draw = Random(f"overload:{seed}")
    paired, stopped = draw.random() < 0.5, draw.random() < 0.5
    mode = Mode.STOP if stopped else Mode.RUN
    fleet = VirtualFleet(builtin("pd_het_4"), seed=seed, paired=paired, start_mode=mode, absent=NODES)
    Overload(fleet, draw).run()
    if stopped:
        for name in (CONTROLLER, standby_name(CONTROLLER))[: 1 + paired]:
            fleet.call(name, "reset")
    fleet.run(WITHIN)
    where = f"seed {seed}, paired: {paired}, stopped: {stopped}"
    assert active(fleet) == {*ROBOTS}, where
    since = fleet.time
    fleet.run(CALM)
    assert longest_stop(fleet, since) == 0, where
    assert [len(speakers(fleet, kind)) for kind in (AbstractState, DesiredAbstractState)] == [1, 1], where


@pytest.mark.parametrize("seed", range(2))
def test_a_fleet_recovers_from_an_overload_at_its_start(seed: int) -> None:
    check(seed)


@pytest.mark.full
@pytest.mark.timeout(900)
@pytest.mark.parametrize("first", range(2, 202, 25))
def test_fleets_recover_from_many_overloads(first: int) -> None:
    for seed in range(first, first + 25):
        check(seed)


def test_a_reset_of_both_controllers_holds_although_a_stop_of_that_step_is_under_way() -> None:
    """After an overload both may lead, and publish STOP in the very step of the reset."""
    fleet = VirtualFleet(builtin("pd_het_4"), paired=True, start_mode=Mode.STOP)
    controllers = (CONTROLLER, standby_name(CONTROLLER))
    fleet.network.cut.update(controllers[1:])
    fleet.run(4.0)
    fleet.network.cut.clear()
    fleet.run(0.0065)
    for name in controllers:
        fleet.call(name, "reset")
    fleet.run(1.5)
    assert active(fleet) == {*ROBOTS}


def test_a_reset_that_robots_hear_late_opens_their_latches_unless_a_stop_came_after_it() -> None:
    late = {agent_name(robot): 0.5 for robot in ROBOTS}
    fleet = VirtualFleet(builtin("pd_het_4"), start_mode=Mode.STOP)
    fleet.run(1.0)
    fleet.network.slow.update(late)
    fleet.call(CONTROLLER, "reset")
    fleet.later(0.7, lambda: fleet.call(CONTROLLER, "stop"))
    fleet.run(1.5)
    fleet.network.slow.clear()
    fleet.run(1.0)
    assert active(fleet) == set()
    fleet.network.slow.update(late)
    fleet.call(CONTROLLER, "reset")
    fleet.run(1.2)
    states = [message for _, _, message in fleet.published if isinstance(message, AgentState)]
    assert {state.broadcast_step for state in states} == {NEVER}, "nobody follows what is outdated"
    fleet.network.slow.clear()
    fleet.run(0.7)
    assert active(fleet) == {*ROBOTS}
