"""What fleets do to a swarm: late, lost and doubled messages, nodes that die and come back, clocks, intruders."""

from __future__ import annotations

from math import inf, nan
from typing import TYPE_CHECKING

import pytest
from tests.swarmabs_core.helpers import FOUR_ROBOT_SCENARIOS, SCENARIOS
from tests.virtual_fleet import Network, VirtualFleet

from swarmabs_config.graph import CONTROLLER, OBSERVER, PLANE, agent_name
from swarmabs_config.scenario import load_scenario
from swarmabs_core.messages import (
    NEVER,
    AbstractState,
    AgentState,
    AuxiliaryState,
    DesiredAbstractState,
    EventKind,
    Mode,
    PlaneState,
    Status,
    SwarmEvent,
)
from swarmabs_core.realtime.controller import RealtimeController
from swarmabs_core.realtime.observer import CARRIED_AWAY
from swarmabs_run.simulation import Simulation

if TYPE_CHECKING:
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import Message, Messages
    from swarmabs_core.realtime.base import RealtimeBehaviour

ROBOTS = tuple(agent_name(i) for i in (1, 2, 3, 4))
COORDINATORS = (PLANE, OBSERVER, CONTROLLER)
AGE_LIMIT = 0.1
PERIOD = 0.01
AT_REST = 1e-3


def scenario(name: str = "pd_het_4", *overrides: str) -> Scenario:
    return load_scenario(SCENARIOS / f"{name}.yaml", overrides).resolved()


def angles(fleet: VirtualFleet) -> dict[int, float]:
    return {round(t / 1e7 - 0.5): m.angle for t, _, m in fleet.published if isinstance(m, PlaneState)}


def angle(fleet: VirtualFleet) -> float:
    return next(m.angle for _, _, m in reversed(fleet.published) if isinstance(m, PlaneState))


def events(fleet: VirtualFleet, since: float = 0.0) -> list[SwarmEvent]:
    return [m for t, _, m in fleet.published if isinstance(m, SwarmEvent) and t >= since * 1e9]


def states(fleet: VirtualFleet, since: float, until: float = inf) -> list[AgentState]:
    return [m for t, _, m in fleet.published if isinstance(m, AgentState) and since * 1e9 <= t <= until * 1e9]


def fastest(fleet: VirtualFleet, since: float, until: float = inf) -> float:
    return max((abs(state.velocity) for state in states(fleet, since, until)), default=0.0)


def stop(node: RealtimeBehaviour, now: int) -> Messages:
    assert isinstance(node, RealtimeController)
    return node.stop(now)


def reset(node: RealtimeBehaviour, now: int) -> Messages:
    assert isinstance(node, RealtimeController)
    return node.reset(now)


def all_follow(fleet: VirtualFleet) -> bool:
    """Tell whether every robot's newest state says that it follows broadcasts."""
    newest = {state.agent_id: state for state in states(fleet, fleet.time - 2 * PERIOD)}
    return len(newest) == 4 and all(s.status == Status.ACTIVE and s.broadcast_step != NEVER for s in newest.values())


@pytest.mark.parametrize("name", FOUR_ROBOT_SCENARIOS)
def test_the_plane_moves_as_in_lockstep(name: str) -> None:
    """In real time each robot hears of a step one period later than in lockstep: 8e-3 rad is the bound for that."""
    fleet = VirtualFleet(scenario(name))
    fleet.run(12.0)
    lockstep = [step.plane.angle for step in Simulation(scenario(name, "duration=10")).steps() if step.plane]
    released = min(k for k, a in angles(fleet).items() if a != angles(fleet)[0]) - 1
    real = angles(fleet)
    assert all(abs(real[k + released] - lockstep[k]) < 8e-3 for k in range(1000))
    assert abs(real[1000 + released] - lockstep[1000]) < 2e-3


def test_the_same_seed_gives_the_same_bits_and_another_does_not() -> None:
    network = Network(jitter=0.02, loss=0.1, duplication=0.1)
    runs = []
    for seed in (1, 1, 2):
        fleet = VirtualFleet(scenario(), seed=seed, network=network)
        fleet.run(3.0)
        runs.append(fleet.published)
    assert runs[0] == runs[1] != runs[2]


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
    ids=["delay 1", "delay 2", "all twice", "loss", "fading", "reordered"],
)
def test_the_swarm_bears_a_bad_network(network: Network, bound: float) -> None:
    quiet, fleet = VirtualFleet(scenario()), VirtualFleet(scenario(), network=network)
    for each in (quiet, fleet):
        each.run(10.0)
    there, here = angles(quiet), angles(fleet)
    assert max(abs(there[k] - here[k]) for k in there) < bound
    assert not [e for e in events(fleet, 1.0) if e.kind == EventKind.SAFE_STOP]


@pytest.mark.parametrize("name", ["pd_si_4", "pd_di_4", "pd_het_4"])
def test_robots_that_hear_every_second_period_hold_the_plane(name: str) -> None:
    """Nothing is heard for 0.1 s on end now and then, so the age limit must allow for that."""
    patient = scenario(name, "realtime.broadcast_age_limit=0.3")
    quiet, fleet = VirtualFleet(patient), VirtualFleet(patient, network=Network(fading=0.5))
    for each in (quiet, fleet):
        each.run(10.0)
    there, here = angles(quiet), angles(fleet)
    assert max(abs(there[k] - here[k]) for k in there) < 8e-3


@pytest.mark.parametrize("name", COORDINATORS)
def test_without_a_coordinator_all_robots_stop_in_time_and_go_on_when_it_is_back(name: str) -> None:
    fleet = VirtualFleet(scenario("arise_het_4"))
    fleet.run(5.0)
    assert all_follow(fleet)
    fleet.kill(name)
    fleet.run(2.0)
    # The last broadcasts are up to a period old; a double integrator brakes with a time constant of 0.1 s.
    stopped = states(fleet, 5.0 + AGE_LIMIT + 3 * PERIOD)
    assert stopped
    assert all(s.status == Status.SAFE_STOP and s.broadcast_step == NEVER for s in stopped)
    assert fastest(fleet, 5.0 + AGE_LIMIT + 3 * PERIOD + 0.5) < AT_REST
    fleet.revive(name)
    fleet.run(3.0)
    assert all_follow(fleet)
    alive = [e for e in events(fleet, 7.0) if e.kind == EventKind.RECOVERED]
    assert sorted(e.agent_id for e in alive) == [1, 2, 3, 4]


@pytest.mark.parametrize("name", ["arise_si_4", "arise_di_4", "arise_het_4"])
def test_a_robot_that_dies_stands_on_the_plane_and_may_come_back(name: str) -> None:
    fleet = VirtualFleet(scenario(name))
    fleet.run(5.0)
    fleet.kill(ROBOTS[2])
    fleet.run(4.0)
    dead = [e for e in events(fleet, 5.0) if e.kind == EventKind.DEAD]
    assert [(e.agent_id, e.detail) for e in dead] == [(3, "silent")]
    assert dead[0].stamp - min(s.stamp for s in states(fleet, 5.0)) <= (AGE_LIMIT + 2 * PERIOD) * 1e9
    last = [m for _, _, m in fleet.published if isinstance(m, AbstractState)][-1]
    assert last.agent_count == 4  # its weight is still there
    sums = [m for _, _, m in fleet.published if isinstance(m, AuxiliaryState)][-1]
    masses = {s.agent_id: s.mass for s in states(fleet, 0.0)}
    assert sums.s0 == pytest.approx(sum(m * m for i, m in masses.items() if i != 3), rel=1e-12)
    reference = VirtualFleet(scenario(name))
    reference.run(15.0)
    fleet.revive(ROBOTS[2])
    fleet.run(6.0)
    assert all_follow(fleet)
    assert abs(angle(fleet) - angle(reference)) < 0.01
    others = {e.agent_id for e in events(fleet, 5.0) if e.kind in (EventKind.SAFE_STOP, EventKind.HELD)}
    assert others <= {3}  # nobody else has stopped


@pytest.mark.parametrize("outage", [0.05, 1.0])
def test_an_observer_that_begins_anew_knows_of_the_weight_of_a_robot_that_died_before(outage: float) -> None:
    """LQR has no integral part: a weight that nobody counts would tilt the plane for ever."""
    fleet = VirtualFleet(scenario("pd_het_4", "controller={type: lqr}"))
    fleet.run(4.0)
    fleet.kill(ROBOTS[3])
    fleet.run(3.0)
    fleet.kill(OBSERVER)
    fleet.run(outage)
    fleet.revive(OBSERVER)
    fleet.run(8.0)
    assert [m for _, _, m in fleet.published if isinstance(m, AbstractState)][-1].agent_count == 4
    assert abs(angle(fleet)) < 0.01


def test_a_dead_robot_that_was_carried_away_counts_no_more_until_it_is_heard() -> None:
    fleet = VirtualFleet(scenario("arise_het_4"))
    fleet.run(4.0)
    word = SwarmEvent(0, 400, 4, EventKind.LEFT, 0.0, CARRIED_AWAY)
    fleet.inject(word, [OBSERVER])  # it lives, so this is not believed
    fleet.run(1.0)
    fleet.kill(ROBOTS[3])
    fleet.run(1.0)
    fleet.inject(word, [OBSERVER])
    fleet.run(1.0)
    counts = [m.agent_count for _, _, m in fleet.published if isinstance(m, AbstractState)]
    assert (counts[480], counts[590], counts[-1]) == (4, 4, 3)
    assert [e.agent_id for e in events(fleet, 6.0) if e.kind == EventKind.LEFT] == [4]
    fleet.revive(ROBOTS[3])
    fleet.run(2.0)
    assert all_follow(fleet)


def test_an_observer_whose_clock_was_wrong_does_not_wait_for_a_robot_that_died_before() -> None:
    fleet = VirtualFleet(scenario("arise_het_4"))
    fleet.run(4.0)
    fleet.kill(ROBOTS[3])
    fleet.set_clock(OBSERVER, -3600.0)
    fleet.run(1.0)
    fleet.set_clock(OBSERVER, 0.0)
    fleet.run(2.0)
    newest = {s.agent_id: s for s in states(fleet, fleet.time - 2 * PERIOD)}
    assert [s.status for s in newest.values()] == [Status.ACTIVE] * 3


def test_a_robot_that_leaves_takes_its_weight_along_and_brings_it_back() -> None:
    fleet = VirtualFleet(scenario("arise_het_4"))
    fleet.run(5.0)
    fleet.call(ROBOTS[0], lambda node, now: node.leave(now))  # type: ignore[attr-defined]
    fleet.run(2.0)
    assert [m for _, _, m in fleet.published if isinstance(m, AbstractState)][-1].agent_count == 3
    assert not [s for s in states(fleet, 6.0) if s.agent_id == 1]
    fleet.call(ROBOTS[0], lambda node, now: node.join(now))  # type: ignore[attr-defined]
    fleet.run(2.0)
    assert all_follow(fleet)
    kinds = [e.kind for e in events(fleet, 5.0) if e.agent_id == 1]
    assert EventKind.LEFT in kinds
    assert EventKind.JOINED in kinds


@pytest.mark.parametrize(
    ("start", "moves"),
    [("wait", False), ("proceed", True), ("quorum", True)],
)
def test_an_absent_robot_holds_up_only_who_waits_for_it(start: str, moves: bool) -> None:  # noqa: FBT001
    sets = [f"realtime.start={start}"] + (["realtime.quorum=3"] if start == "quorum" else [])
    fleet = VirtualFleet(scenario("arise_het_4", *sets), absent=[ROBOTS[3]])
    fleet.run(2.0)
    assert (fastest(fleet, 0.0) > 0.01) == moves
    fleet.revive(ROBOTS[3])
    fleet.run(3.0)
    assert all_follow(fleet)


@pytest.mark.parametrize("outage", [0.05, 1.0])
def test_an_observer_that_begins_anew_does_not_wait_for_a_robot_that_died_before(outage: float) -> None:
    """After a short outage robots still follow, after a long one all have stopped: then their events tell."""
    fleet = VirtualFleet(scenario("arise_het_4"))
    fleet.run(4.0)
    fleet.kill(ROBOTS[3])
    fleet.run(2.0)
    fleet.kill(OBSERVER)
    fleet.run(outage)
    fleet.revive(OBSERVER)
    fleet.run(2.0)
    newest = {s.agent_id: s for s in states(fleet, fleet.time - 2 * PERIOD)}
    assert [s.status for s in newest.values()] == [Status.ACTIVE] * 3


@pytest.mark.parametrize(
    "offset",
    [3600.0, -3600.0, 0.5, -0.5, pytest.param(2e9, marks=pytest.mark.full), pytest.param(-2e9, marks=pytest.mark.full)],
)
@pytest.mark.parametrize("name", [*COORDINATORS, ROBOTS[1]])
def test_a_clock_that_jumps_stops_whom_it_must_and_nobody_for_good(name: str, offset: float) -> None:
    fleet = VirtualFleet(scenario("arise_het_4", "plane.end_stop=1.2"))
    fleet.run(3.0)
    fleet.set_clock(name, offset)
    fleet.run(1.0)
    late = states(fleet, 3.0 + AGE_LIMIT + 0.6)
    if name == ROBOTS[1]:
        assert {s.agent_id for s in late if s.status == Status.ACTIVE} == {1, 3, 4}
        assert abs(fleet.drives[2].read(0).velocity) < AT_REST
    else:
        assert max(abs(s.velocity) for s in late) < AT_REST
    fleet.set_clock(name, 0.0)
    fleet.run(3.0)
    assert all_follow(fleet)


@pytest.mark.parametrize("offset", [0.004, -0.004])
def test_clocks_may_differ_a_little(offset: float) -> None:
    fleet = VirtualFleet(scenario())
    fleet.set_clock(ROBOTS[0], offset)
    fleet.set_clock(OBSERVER, -offset)
    fleet.run(8.0)
    assert abs(angle(fleet)) < 0.01
    assert not [e for e in events(fleet, 0.5) if e.kind in (EventKind.SAFE_STOP, EventKind.REFUSED)]


def test_stop_is_obeyed_within_a_period_and_holds_until_reset() -> None:
    fleet = VirtualFleet(scenario("arise_het_4"))
    fleet.run(5.0)
    fleet.call(CONTROLLER, stop)
    fleet.run(2 * PERIOD)
    newest = {s.agent_id: s.status for s in states(fleet, fleet.time - PERIOD)}
    assert set(newest.values()) == {Status.SAFE_STOP}
    fleet.run(1.0)
    assert fastest(fleet, 5.8) < AT_REST
    # A controller that crashes and comes back says RUN again: that must not set the robots in motion.
    fleet.kill(CONTROLLER)
    fleet.run(0.5)
    fleet.revive(CONTROLLER)
    fleet.run(2.0)
    modes = [m.mode for t, _, m in fleet.published if isinstance(m, DesiredAbstractState) and t > 7e9]
    assert modes[-1] == Mode.RUN
    assert fastest(fleet, 6.0) < AT_REST
    fleet.call(CONTROLLER, reset)
    fleet.run(3.0)
    assert all_follow(fleet)
    assert fastest(fleet, 9.6) > 0.01


def test_a_robot_that_hears_nothing_but_stop_stops() -> None:
    fleet = VirtualFleet(scenario("arise_het_4"))
    fleet.run(5.0)
    desired = DesiredAbstractState(0, 501, Mode.STOP, nan, nan, *(nan,) * 6)
    fleet.inject(desired, [ROBOTS[0]])
    fleet.run(1.0)
    assert {s.status for s in states(fleet, 5.02) if s.agent_id == 1} == {Status.SAFE_STOP}
    assert {s.status for s in states(fleet, 5.02) if s.agent_id != 1} == {Status.ACTIVE}


def test_a_second_controller_stops_the_swarm_for_as_long_as_it_speaks() -> None:
    fleet = VirtualFleet(scenario("arise_het_4"))
    fleet.run(5.0)
    for _ in range(50):
        step = max(m.step for _, _, m in fleet.published if isinstance(m, DesiredAbstractState))
        fleet.inject(DesiredAbstractState(0, step, Mode.RUN, 1.0, 0.05, *(0.0,) * 6), ROBOTS)
        fleet.run(PERIOD)
    assert {s.status for s in states(fleet, 5.3, 5.5)} == {Status.SAFE_STOP}
    refused = [e for e in events(fleet, 5.0) if e.kind == EventKind.REFUSED]
    assert {e.agent_id for e in refused} == {1, 2, 3, 4}
    assert len(refused) == 4  # said once, not fifty times
    fleet.run(2.0)
    assert all_follow(fleet)


@pytest.mark.parametrize("lead", [0, 1, 2])
def test_a_second_controller_that_is_ahead_leads_nobody(lead: int) -> None:
    fleet = VirtualFleet(scenario("arise_het_4"))
    fleet.run(5.0)
    for _ in range(50):
        step = max(m.step for _, _, m in fleet.published if isinstance(m, DesiredAbstractState)) + lead
        fleet.inject(DesiredAbstractState(0, step, Mode.RUN, -3.0, 0.05, *(0.0,) * 6), ROBOTS)
        fleet.run(PERIOD)
    stopped = states(fleet, 5.0 + (lead + 2) * PERIOD, 5.5)
    assert all((s.status, s.broadcast_step) == (Status.SAFE_STOP, NEVER) for s in stopped)
    assert {e.agent_id for e in events(fleet, 5.0) if e.kind == EventKind.REFUSED} == {1, 2, 3, 4}
    fleet.run(2.0)
    assert all_follow(fleet)


def test_nobody_opens_the_latch_while_the_controller_says_stop() -> None:
    fleet = VirtualFleet(scenario("arise_het_4"))
    fleet.run(5.0)
    fleet.call(CONTROLLER, stop)
    fleet.run(0.5)
    for _ in range(150):
        step = max(m.step for _, _, m in fleet.published if isinstance(m, DesiredAbstractState)) + 2
        fleet.inject(DesiredAbstractState(0, step, Mode.RESET, 0.0, 0.05, *(0.0,) * 6), ROBOTS)
        fleet.run(PERIOD)
    assert {s.status for s in states(fleet, 5.5)} == {Status.SAFE_STOP}


@pytest.mark.parametrize("pause", [0.0, 0.004, 0.05, 0.5])
def test_an_operator_who_stops_and_resets_is_heard_over_a_bad_network(pause: float) -> None:
    fleet = VirtualFleet(scenario(), network=Network(jitter=0.04, loss=0.1, duplication=0.3))
    fleet.run(4.0)
    fleet.call(CONTROLLER, stop)
    fleet.run(pause)
    fleet.call(CONTROLLER, reset)
    fleet.run(0.9)
    assert fastest(fleet, fleet.time - 0.1) < AT_REST
    fleet.run(1.1)
    newest = {state.agent_id: state for state in states(fleet, fleet.time - 2 * PERIOD)}
    assert all(state.status == Status.ACTIVE for state in newest.values())
    accused = [e for e in events(fleet, 4.0) if e.kind == EventKind.REFUSED and "outdated" not in e.detail]
    assert not accused


def forged(step: int) -> list[Message]:
    """Return broadcasts that nobody may believe, each alone."""
    good = AuxiliaryState(0, step, 1.0, 0.0, 0.02, 0.02, 0.1, 0.0, 0.1, 0.0)
    return [
        AbstractState(0, step, 4, nan, 0.03, 0.0, 0.0),
        AbstractState(0, step, 4, 0.0, inf, 0.0, 0.0),
        AbstractState(0, step, 4, 1e6, 0.03, 0.0, 0.0),
        AbstractState(0, step, 4, 0.0, -0.01, 0.0, 0.0),
        AbstractState(0, step, 4, 0.0, 5.0, 0.0, 0.0),
        AbstractState(0, 2**63, 4, 0.0, 0.03, 0.0, 0.0),
        good._replace(s0=-1.0),
        good._replace(s0=1e6),
        good._replace(s1=2.0),
        good._replace(s2=3.0),
        good._replace(s3=0.5),
        good._replace(s3=nan),
        DesiredAbstractState(0, step, 77, 0.0, 0.03, *(0.0,) * 6),
        DesiredAbstractState(0, step, Mode.RUN, inf, 0.03, *(0.0,) * 6),
    ]


@pytest.mark.parametrize("index", range(len(forged(0))))
def test_what_cannot_be_true_is_refused_and_moves_nobody(index: int) -> None:
    fleet, quiet = VirtualFleet(scenario("arise_het_4")), VirtualFleet(scenario("arise_het_4"))
    fleet.run(5.0)
    for _ in range(20):
        fleet.inject(forged(round(fleet.time / PERIOD) + 1)[index], ROBOTS)
        fleet.run(PERIOD)
    fleet.run(0.8)
    quiet.run(6.0)
    assert [m for _, _, m in fleet.published if isinstance(m, AgentState)] == [
        m for _, _, m in quiet.published if isinstance(m, AgentState)
    ]
    assert {e.agent_id for e in events(fleet, 5.0) if e.kind == EventKind.REFUSED} == {1, 2, 3, 4}


def test_a_stranger_and_a_liar_do_not_enter_the_sums() -> None:
    fleet, quiet = VirtualFleet(scenario()), VirtualFleet(scenario())
    fleet.run(1.0)
    for _ in range(100):
        step = round(fleet.time / PERIOD)
        stranger = AgentState(0, step, NEVER, 9, 1, 1, 1.0, 0.0, 0.1, 0.0, 0.0)
        for state in (
            stranger,
            stranger._replace(agent_id=1, step=step + 10**6),
            stranger._replace(agent_id=1, step=step + 1, position=0.9),
            stranger._replace(agent_id=1, step=step + 1, mass=nan),
        ):
            fleet.inject(state, [OBSERVER, PLANE])
        fleet.run(PERIOD)
    quiet.run(2.0)
    assert angles(fleet) == angles(quiet)


def test_a_partition_stops_those_cut_off_and_heals() -> None:
    network = Network()
    fleet = VirtualFleet(scenario("arise_het_4"), network=network)
    fleet.run(4.0)
    network.cut = {ROBOTS[0], ROBOTS[1]}
    fleet.run(2.0)
    newest = {s.agent_id: s.status for s in states(fleet, fleet.time - 2 * PERIOD)}
    assert newest == {1: Status.SAFE_STOP, 2: Status.SAFE_STOP, 3: Status.ACTIVE, 4: Status.ACTIVE}
    network.cut = set()
    fleet.run(3.0)
    assert all_follow(fleet)


def test_robots_all_at_one_point_keep_still_and_say_so() -> None:
    together = scenario("pd_het_4")
    fleet = VirtualFleet(together)
    for drive in fleet.drives.values():
        drive._position = 0.1
    fleet.run(2.0)
    assert fastest(fleet, 0.0) < AT_REST
    assert {e.agent_id for e in events(fleet) if e.kind == EventKind.HELD} == {1, 2, 3, 4}


def test_no_robot_leaves_its_lane_when_the_swarm_cannot_hold_the_plane() -> None:
    hard = scenario("pd_het_4", "plane.angle=0.6", "plane.end_stop=1.0", "swarm.gains.k=[100, 100]")
    fleet = VirtualFleet(hard)
    fleet.run(5.0)
    assert max(abs(s.position) for s in states(fleet, 0.0)) <= 0.48 + 1e-9
    assert [e for e in events(fleet) if e.kind == EventKind.LIMIT_HIT]
