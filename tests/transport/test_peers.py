"""Robots in real time that sum up and control the swarm by themselves: losses, cuts, deaths, STOP, clocks, the law."""

from collections.abc import Callable
from functools import cache
from random import Random

import pytest
from tests.swarmabs_core.helpers import builtin
from tests.transport.test_fleet import AGE_LIMIT, BRAKING, PERIOD, active, angles, fastest, fleet_of, said, those
from tests.virtual.fleet import Network, Parcel, VirtualFleet

from swarmabs_config.graph import PLANE
from swarmabs_core import messages as msg
from swarmabs_core.cdr import encode
from swarmabs_core.hearing import Hearing
from swarmabs_core.messages import EventKind, Mode
from swarmabs_core.nodes import agent_name
from swarmabs_core.realtime.peer import RealtimePeer
from swarmabs_core.realtime.relayed import read

ALL = {1, 2, 3, 4}


def peers_of(
    name: str = "pd_het_4", *overrides: str, begun: float = 0.5, network: Network | None = None, seed: int = 1
) -> VirtualFleet:
    scenario = builtin(name, "coordination=each_robot", *overrides)
    fleet = VirtualFleet(scenario, network=network, seed=seed)
    fleet.run(begun)
    return fleet


def generated(robots: int) -> tuple[str, str]:
    return "swarm.agents=null", f"swarm.generate.single_integrator={robots}"


def behaviour(fleet: VirtualFleet, robot: int) -> RealtimePeer:
    activity = fleet.activity(agent_name(robot))
    assert isinstance(activity.engine.behaviour, RealtimePeer)
    return activity.engine.behaviour


def deviation(one: dict[int, float], other: dict[int, float]) -> float:
    return max(abs(one[step] - other[step]) for step in one.keys() & other.keys())


def stopped(fleet: VirtualFleet, since: float) -> list[int]:
    return those(fleet, EventKind.SAFE_STOP, since)


@cache
def central(name: str) -> dict[int, float]:
    return angles(fleet_of(name, begun=1.5))


@pytest.mark.parametrize(
    ("name", "links", "network", "bound"),
    [
        ("pd_het_4", "{type: all}", Network(), 8e-3),
        ("arise_het_4", "{type: all, loss: 0.5}", Network(loss=0.5), 2e-2),
        ("pd_het_4", "{type: ring, loss: 0.5}", Network(loss=0.3), 2e-2),
        ("arise_het_4", "{type: ring, sensing: [2]}", Network(), 2e-2),
        ("pd_het_4", "{type: all}", Network(jitter=0.03, duplication=0.3), 2e-2),
    ],
)
def test_the_plane_moves_as_with_observer_and_controller(name: str, links: str, network: Network, bound: float) -> None:
    fleet = peers_of(name, f"links={links}", network=network, begun=1.5)
    assert deviation(central(name), angles(fleet)) < bound
    assert not stopped(fleet, 0.5)
    assert active(fleet) == ALL


@pytest.mark.system
def test_a_robot_passes_on_what_neighbours_lack_in_one_datagram_for_eighty_robots() -> None:
    fleet = peers_of("pd_si_4", *generated(80), "links={type: random, degree: 6}", begun=0.12)
    relays = said(fleet, msg.Relay)
    assert max(len(relay.content) for relay in relays) <= 1300
    known = said(fleet, msg.AbstractState)[-1].agent_count
    assert known == 80


def test_robots_in_a_room_pass_on_nothing_but_their_own_state() -> None:
    fleet = peers_of()
    fleet.run(1.0)
    recent = [len(relay.content) for relay in said(fleet, msg.Relay, 1.0)]
    assert sorted(recent)[len(recent) // 2] < 100
    assert max(recent) < 125  # once in ten periods also from which desired state it continues


DEATHS: dict[str, tuple[list[int], set[int]]] = {
    "the first": ([1], {2, 3, 4}),
    "two, not the first": ([3, 4], {1, 2}),
    "one after the other": ([4, 0, 3, 0], {1, 2}),
    "another, then the first": ([2, 0, 1], {3, 4}),
}


@pytest.mark.parametrize("case", DEATHS)
def test_a_majority_goes_on_when_robots_die(case: str) -> None:
    """Half of the robots go on if the lowest id is among them, two of three in any case."""
    dying, left = DEATHS[case]
    fleet = peers_of()
    for robot in dying:
        if robot:
            fleet.kill(agent_name(robot))
        else:
            fleet.run(1.5)
    begun = fleet.time
    fleet.run(1.0)
    assert active(fleet) == left
    assert not stopped(fleet, begun)
    assert abs(angles(fleet)[max(angles(fleet))]) < 0.1


def hearing(fleet: VirtualFleet, robot: int) -> Hearing:
    found = Hearing.read(dict(behaviour(fleet, robot).health(fleet.now(agent_name(robot))).values))
    assert found is not None
    return found


def test_diagnostics_tell_whom_a_robot_hears_and_how_old_the_states_are() -> None:
    fleet = peers_of("pd_het_4", *generated(8), "links={type: ring}", begun=0.5)
    fleet.run(0.5)
    first = hearing(fleet, 1)
    assert (first.hears, first.neighbours, first.lacks, first.majority) == ((2, 8), 2, (), True)
    assert first.ages.keys() == set(range(1, 9))
    assert max(first.ages, key=first.ages.__getitem__) == 5, "the state of the opposite robot takes the longest"
    fleet.call(agent_name(3), "leave")
    fleet.kill(agent_name(8))
    fleet.run(1.0)
    first = hearing(fleet, 1)
    assert (first.hears, first.lacks, first.majority) == ((2,), (8,), True)
    assert 3 not in first.ages
    assert first.ages[8] > AGE_LIMIT / PERIOD > (first.oldest or 0)
    fleet.network.cut.add(agent_name(5))
    fleet.run(1.0)
    fifth = hearing(fleet, 5)
    assert (fifth.hears, fifth.lacks, fifth.majority) == ((), (1, 2, 4, 6, 7, 8), False)


def test_two_of_four_stop_if_the_first_two_die_at_once() -> None:
    fleet = peers_of()
    fleet.kill(agent_name(1))
    fleet.kill(agent_name(2))
    fleet.run(2 * AGE_LIMIT + BRAKING + 0.1)
    assert not active(fleet)
    assert fastest(fleet, fleet.time - 0.05) < 1e-2


def test_a_minority_stops_and_returns() -> None:
    """Three robots that hear neither plane nor others stop, five go on; then all go on."""
    fleet = peers_of("pd_het_4", *generated(8), begun=0.5)
    fleet.network.cut |= {agent_name(i) for i in (2, 5, 7)}
    begun = fleet.time
    fleet.run(1.5)
    assert set(stopped(fleet, begun)) == {2, 5, 7}
    assert active(fleet) == {1, 3, 4, 6, 8}
    fleet.network.cut.clear()
    fleet.run(0.3)
    assert active(fleet) == set(range(1, 9))


def test_stop_and_reset_of_any_robots_reach_all_whatever_is_lost() -> None:
    fleet = peers_of(network=Network(loss=0.4))
    fleet.call(agent_name(2), "stop")
    fleet.run(0.3)
    assert not active(fleet)
    fleet.call(agent_name(4), "reset")
    fleet.run(2.0)
    assert active(fleet) == ALL
    assert {behaviour(fleet, robot).orders for robot in ALL} == {behaviour(fleet, 1).orders}


def test_a_stop_reaches_a_minority_that_still_follows_its_broadcasts() -> None:
    fleet = peers_of()
    for robot in (1, 2, 4):
        fleet.kill(agent_name(robot))
    fleet.run(AGE_LIMIT + 4 * PERIOD)  # the others are silent for robot 3, and its broadcasts are not yet outdated
    assert 3 in active(fleet)
    fleet.call(agent_name(3), "stop")
    begun = fleet.time
    fleet.run(2 * PERIOD)
    assert 3 in stopped(fleet, begun)


@pytest.mark.parametrize("first", ["stop", "reset"])
def test_of_a_stop_and_a_reset_at_the_same_time_the_stop_holds(first: str) -> None:
    fleet = peers_of()
    fleet.call(agent_name(1), "stop")
    fleet.run(0.5)
    second = "reset" if first == "stop" else "stop"
    fleet.call(agent_name(2), first)
    fleet.call(agent_name(4), second)
    fleet.run(2.5)
    assert not active(fleet)
    assert {desired.mode for desired in said(fleet, msg.DesiredAbstractState, fleet.time - 0.2)} == {Mode.STOP}


def test_a_stop_reaches_a_robot_that_starts_later_and_reset_releases_it() -> None:
    fleet = peers_of()
    fleet.kill(agent_name(3))
    fleet.call(agent_name(1), "stop")
    fleet.run(0.5)
    fleet.revive(agent_name(3))
    fleet.run(0.5)
    assert not active(fleet)
    fleet.call(agent_name(3), "reset")
    fleet.run(2.0)
    assert active(fleet) == ALL


def test_the_law_of_all_begins_anew_with_a_reset_although_nobody_has_stopped_the_swarm() -> None:
    fleet = peers_of(begun=2.0)
    fleet.call(agent_name(3), "reset")
    ordered = round(fleet.time * 100)
    fleet.run(0.5)
    assert not active(fleet)
    fleet.run(1.5)
    assert active(fleet) == ALL
    assert min(behaviour(fleet, robot).law.begun for robot in ALL) > ordered


def test_a_robot_that_joins_two_sides_does_not_bring_the_law_of_before_a_reset() -> None:
    """When it starts it hears in the same period of both laws, and of the RESET that only one side knows."""
    fleet = peers_of("pd_het_4", "links={type: listed, pairs: [1 2, 2 3, 2 4, 3 4]}")
    fleet.kill(agent_name(2))
    fleet.run(0.5)
    ordered = round(fleet.time * 100)
    fleet.call(agent_name(4), "reset")
    fleet.run(2.0)
    fleet.revive(agent_name(2))
    fleet.run(2.0)
    assert active(fleet) == ALL
    assert min(behaviour(fleet, robot).law.begun for robot in ALL) > ordered


def test_a_robot_that_starts_need_not_wait_for_a_reset_of_long_ago() -> None:
    fleet = peers_of()
    fleet.kill(agent_name(2))
    fleet.call(agent_name(3), "reset")
    fleet.run(2.0)
    fleet.revive(agent_name(2))
    fleet.run(0.3)
    assert active(fleet) == ALL


def test_a_robot_that_restarts_continues_the_law_of_the_others() -> None:
    fleet = peers_of("arise_het_4", begun=2.0)
    before = behaviour(fleet, 2).law
    fleet.kill(agent_name(2))
    fleet.run(0.3)
    fleet.revive(agent_name(2))
    fleet.run(0.5)
    laws = [behaviour(fleet, robot).law for robot in sorted(ALL)]
    assert {law.begun for law in laws} == {before.begun}
    assert len({law.step for law in laws}) == 1
    for column in zip(*(law.memory for law in laws), strict=True):
        assert max(column) - min(column) < 1e-3 * (1.0 + max(map(abs, column)))


@pytest.mark.system
def test_integrals_stay_together_while_states_of_the_plane_are_lost() -> None:
    """Without the pull the integrals of robots that miss states of the plane drift apart."""
    fleet = peers_of("arise_het_4", network=Network(loss=0.5), begun=4.0)
    laws = [behaviour(fleet, robot).law for robot in sorted(ALL)]
    step = {law.step for law in laws}
    assert max(step) - min(step) <= 3
    first = [law.memory[0] for law in laws]
    assert max(first) - min(first) < 0.02


def test_a_robot_whose_clock_is_wrong_stops_alone() -> None:
    fleet = peers_of()
    begun = fleet.time
    fleet.set_clock(agent_name(2), 1.0)
    fleet.run(1.0)
    assert active(fleet) == {1, 3, 4}
    assert set(stopped(fleet, begun)) == {2}
    fleet.set_clock(agent_name(2), 0.0)
    fleet.run(1.5)
    assert active(fleet) == ALL


def test_the_swarm_stops_without_the_plane_and_goes_on_with_it() -> None:
    fleet = peers_of()
    fleet.kill(PLANE)
    fleet.run(AGE_LIMIT + 2 * PERIOD + BRAKING + 0.2)
    assert not active(fleet)
    fleet.revive(PLANE)
    fleet.run(0.5)
    assert active(fleet) == ALL


@pytest.mark.full
@pytest.mark.parametrize("seed", range(30))
def test_no_robot_of_a_majority_stops_whatever_happens_to_others(seed: int) -> None:
    """Eight robots, half of all messages lost; up to three are killed, paused, cut off or have a wrong clock."""
    draw = Random(f"majority:{seed}")
    links = draw.choice(("{type: all}", "{type: random, degree: 5}"))
    fleet = peers_of("pd_het_4", *generated(8), f"links={links}", network=Network(loss=0.5), seed=seed, begun=1.5)
    harms: list[Callable[[str], object]] = [
        fleet.kill,
        fleet.pause,
        fleet.network.cut.add,
        lambda name: fleet.set_clock(name, draw.choice((-2.0, 2.0))),
    ]
    harmed = draw.sample(range(1, 9), 3)
    begun = fleet.time
    for robot in harmed:
        draw.choice(harms)(agent_name(robot))
        fleet.run(draw.uniform(0.0, 0.5))
    fleet.run(2.0)
    left = set(range(1, 9)) - set(harmed)
    assert left <= active(fleet)
    assert not left & set(stopped(fleet, begun))
    assert abs(angles(fleet)[max(angles(fleet))]) < 0.05


@pytest.mark.parametrize("angle", [0.2, 9.0], ids=["credible", "impossible"])
def test_a_state_of_the_plane_that_a_robot_refuses_is_not_passed_on(angle: float) -> None:
    """An intruder is not heard as long as the plane is, and nobody hears of what it says."""
    scenario = builtin("pd_het_4", "coordination=each_robot", "links={type: ring, sensing: [2]}")
    fleet = VirtualFleet(scenario, identified=True)
    fleet.run(1.0)
    for _ in range(5):
        forged = msg.PlaneState(0, round(fleet.time / PERIOD) + 1, angle, 0.0)
        fleet.deliver(Parcel("", msg.PLANE_STATE, encode(forged), b"an intruder", forged), [agent_name(2)])
        fleet.run(PERIOD)
    told = [read(relay, len(ALL)).plane for relay in said(fleet, msg.Relay) if relay.agent_id == 2]
    assert len([plane for plane in told if plane is not None]) > 50
    assert {*filter(None, told)} <= {*said(fleet, msg.PlaneState)}
    assert active(fleet) == ALL


def test_who_sends_unreadable_relays_in_the_name_of_a_robot_does_not_take_its_place() -> None:
    scenario = builtin("pd_het_4", "coordination=each_robot")
    fleet = VirtualFleet(scenario, identified=True)
    fleet.run(1.0)
    fleet.kill(agent_name(3))

    def intrude() -> None:
        relay = msg.Relay(0, round(fleet.time / PERIOD), 3, 0, 0, 0, b"anything")
        topic = msg.relay_topic(3)
        fleet.deliver(Parcel("", topic, encode(relay), b"an intruder", relay), [agent_name(i) for i in (1, 2, 4)])
        fleet.later(PERIOD, intrude)

    fleet.run(0.3)
    intrude()
    fleet.run(0.3)
    fleet.revive(agent_name(3))
    fleet.run(0.5)
    assert hearing(fleet, 1).hears == (2, 3, 4)
    assert active(fleet) == ALL
