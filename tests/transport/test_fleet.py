"""What fleets do to a swarm: late, lost and doubled messages, nodes that die and come back, clocks, intruders."""

from collections.abc import Callable
from functools import cache
from math import inf, nan
from typing import NamedTuple, TypeVar

import pytest
from tests.swarmabs_core.helpers import FOUR_ROBOT_SCENARIOS, builtin
from tests.virtual.fleet import Network, VirtualFleet

from swarmabs_config.graph import CONTROLLER, OBSERVER, PLANE, own_topic
from swarmabs_core import messages as msg
from swarmabs_core.events import EventCode
from swarmabs_core.nodes import agent_name
from swarmabs_run.simulation import Simulation

M = TypeVar("M", bound=msg.Message)
ROBOTS = tuple(agent_name(i) for i in (1, 2, 3, 4))
AGE_LIMIT = 0.1
PERIOD = 0.01
AT_REST = 1e-3
BRAKING = 0.5
"""Time, s, in which a double integrator comes to rest: it brakes with a time constant of 0.1 s."""


def fleet_of(
    name: str = "arise_het_4", *overrides: str, begun: float = 0.5, network: Network | None = None
) -> VirtualFleet:
    fleet = VirtualFleet(builtin(name, *overrides), network=network)
    fleet.run(begun)
    return fleet


def said(fleet: VirtualFleet, kind: type[M], since: float = 0.0, until: float = inf) -> list[M]:
    return [m for t, _, m in fleet.published if isinstance(m, kind) and since * 1e9 <= t <= until * 1e9]


def angles(fleet: VirtualFleet) -> dict[int, float]:
    return {round(t / 1e7 - 0.5): m.angle for t, _, m in fleet.published if isinstance(m, msg.PlaneState)}


def those(fleet: VirtualFleet, kind: msg.EventKind, since: float = 0.0) -> list[int]:
    """Return the robots of which there is an event of a kind, each as often as there is one."""
    events = [event for event in said(fleet, msg.SwarmEvent, since) if not isinstance(event, msg.Removal)]
    return sorted(event.agent_id for event in events if event.kind == kind)


def newest(fleet: VirtualFleet) -> dict[int, msg.AgentState]:
    return {state.agent_id: state for state in said(fleet, msg.AgentState, fleet.time - 2 * PERIOD)}


def active(fleet: VirtualFleet) -> set[int]:
    """Return who follows broadcasts now."""
    return {i for i, s in newest(fleet).items() if s.status == msg.Status.ACTIVE and s.broadcast_step != msg.NEVER}


def fastest(fleet: VirtualFleet, since: float) -> float:
    return max(abs(state.velocity) for state in said(fleet, msg.AgentState, since))


def count(fleet: VirtualFleet) -> int:
    return said(fleet, msg.AbstractState)[-1].agent_count


def desired(step: int, mode: int = msg.Mode.RUN, torque: float = -3.0) -> msg.DesiredAbstractState:
    return msg.DesiredAbstractState(0, step, mode, torque, 0.05, *(0.0,) * 6)


@pytest.mark.parametrize("name", FOUR_ROBOT_SCENARIOS)
def test_the_plane_moves_as_in_lockstep(name: str) -> None:
    """In real time each robot hears of a step one period later than in lockstep: 8e-3 rad is the bound for that."""
    real = angles(fleet_of(name, begun=2.2))
    simulated = Simulation(builtin(name, "duration=2")).steps()
    lockstep = [plane.angle for step in simulated for plane in step.parents]
    released = min(k for k, a in real.items() if a != real[0]) - 1
    assert max(abs(real[k + released] - lockstep[k]) for k in range(200)) < 8e-3


@cache
def undisturbed() -> dict[int, float]:
    return angles(fleet_of("pd_het_4", begun=1.5))


@pytest.mark.parametrize(
    ("network", "bound"),
    [
        (Network(delay=0.01), 8e-3),
        (Network(delay=0.02), 8e-3),
        (Network(duplication=1.0), 1e-12),
        (Network(loss=0.1), 2e-2),
        (Network(fading=0.2), 8e-3),
        (Network(jitter=0.03, duplication=0.3), 2e-2),
    ],
)
def test_the_swarm_bears_a_bad_network(network: Network, bound: float) -> None:
    there, fleet = undisturbed(), fleet_of("pd_het_4", begun=1.5, network=network)
    here = angles(fleet)
    assert max(abs(there[k] - here[k]) for k in there) < bound
    assert not those(fleet, msg.EventKind.SAFE_STOP, since=1.0)


class Trouble(NamedTuple):
    """What is done to a fleet, what ends it, and who follows broadcasts meanwhile."""

    do: Callable[[VirtualFleet], None]
    undo: Callable[[VirtualFleet], None]
    active: set[int]


def _death(name: str, active: set[int]) -> Trouble:
    return Trouble(lambda fleet: fleet.kill(name), lambda fleet: fleet.revive(name), active)


def _clock(name: str, offset: float, active: set[int]) -> Trouble:
    return Trouble(lambda fleet: fleet.set_clock(name, offset), lambda fleet: fleet.set_clock(name, 0.0), active)


def _cut(*names: str) -> Trouble:
    return Trouble(lambda fleet: fleet.network.cut.update(names), lambda fleet: fleet.network.cut.clear(), {3, 4})


TROUBLES = {
    **{f"death of {name}": _death(name, set()) for name in (PLANE, OBSERVER, CONTROLLER)},
    "death of a robot": _death(ROBOTS[1], {1, 3, 4}),
    "two robots out of reach": _cut(ROBOTS[0], ROBOTS[1]),
    **{
        f"clock of {name} {offset:+g} s": _clock(name, offset, {1, 3, 4} if name == ROBOTS[1] else set())
        for name in (PLANE, OBSERVER, CONTROLLER, ROBOTS[1])
        for offset in (3600.0, -0.5)
    },
}


@pytest.mark.parametrize("trouble", TROUBLES.values(), ids=TROUBLES)
def test_whom_it_concerns_stop_in_time_and_go_on_when_it_is_over(trouble: Trouble) -> None:
    fleet = fleet_of("arise_het_4", "plane.end_stop=1.2")
    assert active(fleet) == {1, 2, 3, 4}
    since = fleet.time + AGE_LIMIT + 3 * PERIOD
    trouble.do(fleet)
    fleet.run(since + BRAKING + 0.1 - fleet.time)
    stopped = [state for state in said(fleet, msg.AgentState, since) if state.agent_id not in trouble.active]
    assert all(state.status == msg.Status.SAFE_STOP and state.broadcast_step == msg.NEVER for state in stopped)
    assert active(fleet) == trouble.active
    standing = {1, 2, 3, 4} - trouble.active
    assert all(abs(fleet.drives[i].read(0).velocity) < AT_REST for i in standing)
    begun_anew = fleet.time
    trouble.undo(fleet)
    fleet.run(1.0)
    assert active(fleet) == {1, 2, 3, 4}
    assert {*those(fleet, msg.EventKind.RECOVERED, begun_anew)} == standing


def test_a_fleet_that_begins_under_overload_and_then_loses_everybody_goes_on_by_itself() -> None:
    overload = Network(loss=0.7, delay=0.2, jitter=0.5)
    fleet = fleet_of(begun=20.0, network=overload)
    assert not active(fleet), "broadcasts are older than the age limit"
    overload.cut.update(fleet.names)  # all have taken all others for gone
    fleet.run(5.0)
    overload.loss, overload.delay, overload.jitter = 0.0, 0.0005, 0.0
    overload.cut.clear()
    fleet.run(1.0)
    assert active(fleet) == {1, 2, 3, 4}


def test_a_robot_that_dies_stands_on_the_plane_and_may_come_back() -> None:
    fleet = fleet_of()
    fleet.kill(ROBOTS[2])
    fleet.run(0.5)
    (dead,) = [e for e in said(fleet, msg.SwarmEvent) if e.kind == msg.EventKind.DEAD]
    assert (dead.agent_id, dead.detail) == (3, "silent")
    assert dead.stamp - min(s.stamp for s in said(fleet, msg.AgentState, 0.5)) <= (AGE_LIMIT + 2 * PERIOD) * 1e9
    assert count(fleet) == 4  # its weight is still there
    masses = {s.agent_id: s.mass for s in said(fleet, msg.AgentState)}
    assert said(fleet, msg.AuxiliaryState)[-1].s0 == pytest.approx(
        sum(m * m for i, m in masses.items() if i != 3), rel=1e-12
    )
    fleet.revive(ROBOTS[2])
    fleet.run(3.0)
    reference = angles(fleet_of(begun=4.0))
    assert abs(angles(fleet)[399] - reference[399]) < 0.01
    stopped = those(fleet, msg.EventKind.SAFE_STOP, 0.4) + those(fleet, msg.EventKind.HELD, 0.4)
    assert {*stopped} <= {3}, "nobody else has stopped"


@pytest.mark.parametrize("outage", [0.05, 0.6])
def test_an_observer_that_begins_anew_knows_of_a_robot_that_died_before(outage: float) -> None:
    """After a short outage robots still follow, after a long one all have stopped: then their events tell."""
    fleet = fleet_of("pd_het_4", "controller={type: lqr}")
    fleet.kill(ROBOTS[3])
    fleet.run(0.3)
    fleet.kill(OBSERVER)
    fleet.run(outage)
    fleet.revive(OBSERVER)
    fleet.run(0.5)
    assert count(fleet) == 4  # LQR has no integral part: a weight that nobody counts would tilt the plane for ever
    assert active(fleet) == {1, 2, 3}  # nobody waits for it


def test_a_dead_robot_that_was_carried_away_counts_no_more_until_it_is_heard() -> None:
    fleet = fleet_of()

    def removal(later: float = 0.0) -> msg.Removal:
        return msg.Removal(*EventCode.CARRIED_AWAY.event(0, round((fleet.time + later) / PERIOD), robot=4))

    early = removal()
    fleet.inject(early, [OBSERVER])  # it lives, so this is not believed
    fleet.run(0.3)
    fleet.kill(ROBOTS[3])
    fleet.run(0.3)
    for word in (early, removal(later=1.0), msg.SwarmEvent(*removal())):
        fleet.inject(word, [OBSERVER])  # it was heard since; from the future; anybody may say so
    fleet.run(0.1)
    assert count(fleet) == 4
    accepted = removal()
    fleet.inject(accepted, [OBSERVER])
    fleet.run(0.1)
    assert count(fleet) == 3
    assert those(fleet, msg.EventKind.LEFT) == [4]
    assert said(fleet, msg.Removal) == [accepted], "told to observers that start later"
    fleet.revive(ROBOTS[3])
    fleet.run(0.3)
    assert active(fleet) == {1, 2, 3, 4}


def test_an_observer_whose_clock_was_wrong_does_not_wait_for_a_robot_that_died_before() -> None:
    fleet = fleet_of()
    fleet.kill(ROBOTS[3])
    for offset, seconds in ((-3600.0, 0.4), (0.0, 0.6)):
        fleet.set_clock(OBSERVER, offset)
        fleet.run(seconds)
    assert active(fleet) == {1, 2, 3}


def test_a_robot_that_leaves_takes_its_weight_along_and_brings_it_back() -> None:
    fleet = fleet_of()
    fleet.call(ROBOTS[0], "leave")
    fleet.run(0.5)
    assert count(fleet) == 3
    assert 1 not in newest(fleet)
    fleet.call(ROBOTS[0], "join")
    fleet.run(0.5)
    assert active(fleet) == {1, 2, 3, 4}
    kinds = [e.kind for e in said(fleet, msg.SwarmEvent, 0.5) if e.agent_id == 1]
    assert kinds.index(msg.EventKind.LEFT) < kinds.index(msg.EventKind.JOINED)


@pytest.mark.parametrize(
    ("settings", "moves"), [("start: wait", False), ("start: proceed", True), ("start: quorum, quorum: 3", True)]
)
def test_an_absent_robot_holds_up_only_who_waits_for_it(settings: str, moves: bool) -> None:  # noqa: FBT001
    fleet = VirtualFleet(builtin("arise_het_4", f"realtime={{{settings}}}"), absent=[ROBOTS[3]])
    fleet.run(0.5)
    assert (fastest(fleet, 0.0) > 0.01) == moves
    fleet.revive(ROBOTS[3])
    fleet.run(0.5)
    assert active(fleet) == {1, 2, 3, 4}


def test_stop_is_obeyed_within_a_period_and_holds_until_reset() -> None:
    fleet = fleet_of()
    fleet.call(CONTROLLER, "stop")
    fleet.run(2 * PERIOD)
    assert {state.status for state in newest(fleet).values()} == {msg.Status.SAFE_STOP}
    fleet.run(BRAKING + 0.2)
    since = fleet.time
    # A controller that crashes and comes back says RUN again: that must not set the robots in motion.
    fleet.kill(CONTROLLER)
    fleet.run(0.2)
    fleet.revive(CONTROLLER)
    fleet.run(0.5)
    assert said(fleet, msg.DesiredAbstractState)[-1].mode == msg.Mode.RUN
    assert fastest(fleet, since) < AT_REST
    # Nor may somebody else open the latch as long as the controller says STOP.
    fleet.call(CONTROLLER, "stop")
    for _ in range(50):
        fleet.inject(desired(said(fleet, msg.DesiredAbstractState)[-1].step + 2, msg.Mode.RESET), ROBOTS)
        fleet.run(PERIOD)
    assert fastest(fleet, since) < AT_REST
    fleet.call(CONTROLLER, "reset")
    fleet.run(1.5)
    assert active(fleet) == {1, 2, 3, 4}
    assert fastest(fleet, fleet.time - 0.3) > 0.01


def made_up(step: int, mode: msg.Mode) -> list[msg.Message]:
    """Return the broadcasts of a swarm of two robots of 0.4 kg that is not there, with far too little inertia."""
    return [
        msg.AbstractState(0, step, 2, 0.0, 0.008, 0.0, 0.0),
        msg.AuxiliaryState(0, step, 0.32, 0.0, 0.0032, 0.001024, 0.1, 0.0, 0.001, 0.0),
        desired(step, mode, torque=0.0)._replace(inertia=0.5),
    ]


def test_without_a_base_an_intruder_leads_robots_within_their_limits_until_he_is_silent() -> None:
    fleet = fleet_of("pd_het_4", "limits={velocity: 0.5, force: 3}")
    fleet.call(CONTROLLER, "stop")
    fleet.run(2 * PERIOD)
    for name in (PLANE, OBSERVER, CONTROLLER):
        fleet.kill(name)
    fleet.run(0.5)
    for number in range(500):
        for message in made_up(round(fleet.time / PERIOD), msg.Mode.RESET if number < 100 else msg.Mode.RUN):
            fleet.inject(message, ROBOTS)
        fleet.run(PERIOD)
    states, lane = said(fleet, msg.AgentState), 0.48
    assert all(abs(state.position) > 0.95 * lane for state in newest(fleet).values()), "to the end of their lanes"
    assert max(abs(state.position) for state in states) <= lane
    assert {abs(s.command) <= (0.5 if s.kind == msg.Kind.SINGLE_INTEGRATOR else 3.0) for s in states} == {True}
    fleet.run(AGE_LIMIT + 3 * PERIOD + BRAKING)
    assert (active(fleet), fastest(fleet, fleet.time - PERIOD) < AT_REST) == (set(), True)
    for name in (PLANE, OBSERVER, CONTROLLER):
        fleet.revive(name)
    fleet.call(CONTROLLER, "reset")
    fleet.run(1.5)
    assert active(fleet) == {1, 2, 3, 4}


def test_a_stranger_and_a_liar_do_not_enter_the_sums() -> None:
    fleet = fleet_of(begun=0.3)
    for _ in range(50):
        step = round(fleet.time / PERIOD)
        stranger = msg.AgentState(0, step, msg.NEVER, 9, 1, 1, 1.0, 0.0, 0.1, 0.0, 0.0)
        for state in (
            stranger,
            stranger._replace(agent_id=1, step=step + 10**6),
            stranger._replace(agent_id=1, step=step + 1, position=0.9),
            stranger._replace(agent_id=1, step=step + 1, mass=nan),
        ):
            fleet.inject(state, [OBSERVER, PLANE])
        fleet.run(PERIOD)
    assert angles(fleet) == angles(fleet_of(begun=0.8))


def test_with_own_topics_nothing_changes_and_no_robot_speaks_for_another() -> None:
    shared, fleet = (VirtualFleet(builtin("arise_het_4"), own_topics=own) for own in (False, True))
    for one in (shared, fleet):
        one.run(0.5)
        one.kill(OBSERVER)  # the next one must learn from events that the swarm is under way
        one.kill(ROBOTS[3])
        one.run(0.6)
        one.revive(OBSERVER)
        one.run(0.6)
    assert active(fleet) == {1, 2, 3}
    order = [(now, node, repr(message)) for now, node, message in fleet.published]
    assert sorted(order) == sorted((now, node, repr(message)) for now, node, message in shared.published)
    own = own_topic(msg.AGENT_STATE, 1), own_topic(msg.EVENTS, 1)
    for one in (shared, fleet):
        for _ in range(50):
            forged = newest(one)[2]._replace(step=round(one.time / PERIOD) + 1, position=-0.45, velocity=0.0)
            left = msg.SwarmEvent(0, forged.step, 2, msg.EventKind.RECOVERED, 0.0, "")
            for message, topic in zip((forged, left), own, strict=True):
                one.inject(message, [OBSERVER], topic if one is fleet else None)
            if one is fleet:
                one.inject(forged, [PLANE], own[0])
            one.run(PERIOD)
    assert active(fleet) == {1, 2, 3}
    assert (those(shared, msg.EventKind.DEAD, 1.7), those(fleet, msg.EventKind.DEAD, 1.7)) == ([2], [])
    refused = [e for e in said(fleet, msg.SwarmEvent, 1.7) if e.kind == msg.EventKind.REFUSED]
    assert {e.detail for e in refused} == {
        f"robot 1: messages with the id of another robot on agent_001/{name}" for name in ("state", "events")
    }
