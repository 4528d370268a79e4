"""Robots that sign their states: what others pass on of them, genuine, falsified, old, and of those without a key."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from tests.swarmabs_core.helpers import builtin
from tests.transport.test_fleet import PERIOD, active, angles, said
from tests.transport.test_peers import deviation
from tests.virtual.fleet import Network, VirtualFleet

from swarmabs_config.seals import EcdsaSeals
from swarmabs_core import messages as msg
from swarmabs_core.events import EventCode
from swarmabs_core.nodes import agent_name
from swarmabs_core.realtime.relayed import Constants, Motion, Told, read, written
from swarmabs_core.realtime.seals import Seals

ROBOTS = (1, 2, 3, 4)
CURVE = ec.SECP256R1()
KEYS = {author: ec.derive_private_key(1 + author, CURVE) for author in (msg.PARENT, *ROBOTS)}
RING, SENSING = "links={type: ring}", "links={type: ring, sensing: [2]}"
FORGED = "robot 3 passed on a state of robot 2 that robot 2 has not signed"
Lie = Callable[[msg.Relay, Told], Told]


def seals_of(*without: int, wrong: int | None = None) -> dict[int, Seals]:
    public = {author: key.public_key() for author, key in KEYS.items()}
    keys = KEYS | ({} if wrong is None else {wrong: ec.derive_private_key(99, CURVE)})
    return {author: EcdsaSeals(key, public) for author, key in keys.items() if author not in without}


def sealed(
    *overrides: str, seals: dict[int, Seals] | None = None, lie: Lie | None = None, network: Network | None = None
) -> VirtualFleet:
    """Return a fleet after a second, in which robot 3 tells its neighbours what a lie makes of its relays."""
    scenario = builtin("pd_het_4", "coordination=each_robot", *overrides)
    fleet = VirtualFleet(scenario, network=network, seals=seals_of() if seals is None else seals)
    if lie is not None:
        fleet.liars[agent_name(3)] = partial(_told_otherwise, lie)
    fleet.run(1.0)
    return fleet


@cache
def honest(links: str) -> dict[int, float]:
    """Return the angles of a sealed fleet in which nobody lies."""
    return angles(sealed(links))


def _told_otherwise(lie: Lie, message: msg.Message) -> msg.Message:
    if not isinstance(message, msg.Relay):
        return message
    told = read(message, len(ROBOTS))
    return message._replace(content=written(message.step, lie(message, told), len(ROBOTS)))


def refused(fleet: VirtualFleet) -> set[str]:
    return {event.detail for event in said(fleet, msg.SwarmEvent) if "has not signed" in event.detail}


def lighter(relay: msg.Relay, told: Told) -> Told:
    """Tell of robot 2 that it is lighter, with the tag that belongs to that."""
    mass = Constants(msg.Kind.SINGLE_INTEGRATOR, 0.25, 0.0)
    motions = [motion._replace(tag=mass.tag, age=-1) if motion.rank == 1 else motion for motion in told.motions]
    return replace(told, constants={**told.constants, 1: mass}, motions=motions)


def lie_about(change: Callable[[msg.Relay, Motion], Motion]) -> Lie:
    """Return a lie: what robot 3 passes on of robot 2 is changed."""

    def lie(relay: msg.Relay, told: Told) -> Told:
        return replace(told, motions=[change(relay, motion) if motion.rank == 1 else motion for motion in told.motions])

    return lie


def moved_as_newer(relay: msg.Relay, motion: Motion) -> Motion:
    return motion._replace(position=-motion.position, age=-1)


def as_newer(relay: msg.Relay, motion: Motion) -> Motion:
    return motion._replace(age=-1)


def test_a_sealed_swarm_moves_exactly_as_one_without_seals() -> None:
    assert honest(RING) == angles(sealed(RING, seals={}))


def test_a_sealed_swarm_tolerates_losses() -> None:
    fleet = sealed(SENSING, network=Network(loss=0.3))
    assert not refused(fleet)
    assert active(fleet) == {*ROBOTS}
    assert deviation(angles(sealed()), angles(fleet)) < 2e-2


LIES = {"moved, as newer": lie_about(moved_as_newer), "old, as newer": lie_about(as_newer), "lighter": lighter}


@pytest.mark.parametrize("lie", LIES)
def test_a_state_that_its_author_has_not_signed_is_refused_and_both_are_named(lie: str) -> None:
    """Robot 4 hears of robot 2 from 1 and 3: it moves exactly as if 3 told the truth."""
    fleet = sealed(RING, lie=LIES[lie])
    assert refused(fleet) == {FORGED}
    assert {event.agent_id for event in said(fleet, msg.SwarmEvent) if event.detail == FORGED} == {4}
    assert angles(fleet) == honest(RING)
    assert active(fleet) == {*ROBOTS}


@pytest.mark.parametrize("lie", ["moved, as newer", "lighter"])
def test_without_seals_the_same_lies_mislead_the_swarm(lie: str) -> None:
    fleet = sealed(RING, seals={}, lie=LIES[lie])
    assert not refused(fleet)
    assert angles(fleet) != honest(RING)


def test_who_says_that_constants_have_changed_harms_nobody() -> None:
    """A strange tag makes robot 4 ask for the constants of robot 2, and use what it has until it has them."""
    fleet = sealed(RING, lie=lie_about(lambda _, motion: motion._replace(tag=7, age=-1)))
    assert not refused(fleet)
    assert angles(fleet) == honest(RING)


def test_an_old_state_that_is_passed_on_as_what_it_is_changes_nothing() -> None:
    first: list[tuple[int, Motion]] = []

    def old(relay: msg.Relay, motion: Motion) -> Motion:
        first.append((relay.step - motion.age, motion))
        step, kept = first[0]
        return kept._replace(age=relay.step - step)

    fleet = sealed(RING, lie=lie_about(old))
    assert len(first) > 50
    assert not refused(fleet)
    assert angles(fleet) == honest(RING)


def test_a_false_state_of_the_plane_is_refused() -> None:
    def lie(relay: msg.Relay, told: Told) -> Told:
        return replace(told, plane=told.plane and told.plane._replace(angle=1.0, step=told.plane.step + 1))

    fleet = sealed(SENSING, lie=lie)
    assert refused(fleet) == {"robot 3 passed on a state of the plane that the plane has not signed"}
    assert angles(fleet) == honest(SENSING)


def test_who_signs_with_a_wrong_key_is_named_and_no_neighbour_is_suspected() -> None:
    """Robots 2 and 4 hear robot 3 itself, and do not pass on what nobody could check."""
    fleet = sealed(RING, "realtime.start=proceed", seals=seals_of(wrong=3))
    assert refused(fleet) == {"robot 3 has not signed its state"}
    assert {event.agent_id for event in said(fleet, msg.SwarmEvent) if "has not signed" in event.detail} == {2, 4}
    assert active(fleet) >= {1, 2, 4}


def test_a_robot_without_key_takes_no_part_in_a_sealed_swarm() -> None:
    fleet = sealed("realtime.start=proceed", seals=seals_of(3))
    told = {(event.agent_id, event.detail) for event in said(fleet, msg.SwarmEvent) if "signatures" in event.detail}
    assert {(robot, text.partition(": ")[2]) for robot, text in told} == {
        *((robot, "a relay without signatures") for robot in (1, 2, 4)),
        (3, "a relay with signatures"),
    }
    assert active(fleet) == {1, 2, 4}


def test_a_state_of_a_removed_robot_is_not_passed_on_as_its_own() -> None:
    """An operator's word is not the robot's: neighbours that have it, too, need no state, and nobody is suspected."""
    fleet = sealed(RING)
    fleet.kill(agent_name(3))
    fleet.run(0.5)
    removal = msg.Removal(*EventCode.CARRIED_AWAY.event(0, round(fleet.time / PERIOD), robot=3))
    fleet.inject(removal, [agent_name(i) for i in (1, 2, 4)])
    fleet.run(0.5)
    assert said(fleet, msg.AbstractState)[-1].agent_count == 3
    assert not refused(fleet)
    assert active(fleet) == {1, 2, 4}
