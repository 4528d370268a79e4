"""Who speaks for somebody else, ahead of him by as much as clocks may differ: nodes notice when both speak."""

from itertools import product
from math import inf, nan

import pytest
from tests.swarmabs_core.realtime import nodes

from swarmabs_config import realtime as configure
from swarmabs_core import messages as msg
from swarmabs_core.realtime.observer import Role
from swarmabs_core.realtime.plane import RealtimePlane
from swarmabs_core.realtime.validation import FASTEST_TURN, Bounds, Heard

LEADS = [0, 1, 2]
"""Steps by which an intruder is ahead; the last is the clock tolerance."""


@pytest.mark.parametrize("lead", LEADS)
@pytest.mark.parametrize("part", [0, 1, 2, None], ids=["abstract", "sums", "desired", "all"])
def test_broadcasts_of_an_intruder_who_is_ahead_stop_a_robot(lead: int, part: int | None) -> None:
    body, node = nodes.robot()
    refused: list[int] = []
    for step in range(100, 160):
        forged = nodes.broadcasts(step + lead, torque=-3.0)
        forged = (forged[0]._replace(agent_count=4), forged[1]._replace(d0=0.4), forged[2])
        for message in (*nodes.broadcasts(step, torque=0.3), *(forged if part is None else forged[part : part + 1])):
            refused += nodes.kinds(node.hear(message, nodes.at(step + 0.6)))
        node.tick(nodes.at(step + 1))
    assert refused == [msg.EventKind.REFUSED] * (3 if part is None else 1)
    # Until the step has come of which the first forged message was, nobody can tell.
    assert not any(body.commands[lead:])
    assert node.health(nodes.at(160)).text == "safe stop: the broadcasts contradict each other"


ABSTRACT, SUMS, DESIRED = nodes.broadcasts(12)


@pytest.mark.parametrize(
    ("message", "lie"),
    [
        *((ABSTRACT, lie) for lie in ({"torque": nan}, {"torque": 1e6}, {"step": 2**63})),
        *((ABSTRACT, {"inertia": inertia}) for inertia in (inf, -0.01, 5.0)),
        *((SUMS, lie) for lie in ({"s0": -1.0}, {"s0": 1e6}, {"s1": 2.0}, {"s2": 3.0}, {"s3": 0.5}, {"s3": nan})),
        *((DESIRED, lie) for lie in ({"mode": 77}, {"torque": inf})),
    ],
)
def test_what_cannot_be_true_is_refused_and_moves_no_robot(message: msg.Message, lie: dict[str, float]) -> None:
    body, node = nodes.robot()
    nodes.follow(node, 11)
    assert nodes.kinds(node.hear(message._replace(**lie), nodes.at(12.6))) == [msg.EventKind.REFUSED]
    node.tick(nodes.at(13))
    assert body.commands[0] == body.commands[1] != 0.0


def test_what_was_heard_is_kept_for_a_bounded_time() -> None:
    heard: Heard[int] = Heard(10, 2)
    for step in range(1000):
        for message in nodes.broadcasts(step + 2):
            heard.add(1, message, step)
        assert len(heard.steps()) <= 13
    assert not heard.add(1, nodes.broadcasts(985)[0], 999)  # of a step that is not kept


@pytest.mark.parametrize("lead", LEADS)
def test_a_second_plane_that_is_ahead_makes_the_controller_ask_for_nothing(lead: int) -> None:
    node = nodes.controller()
    asked: dict[int, int] = {}
    answers: list[msg.Message] = []
    for step in range(100, 140):
        intruder = [msg.PlaneState(0, step + lead, -0.2, 0.0)] if step < 120 else []
        for plane in (msg.PlaneState(0, step, 0.05, 0.0), *intruder):
            answer = node.hear(plane, nodes.at(step + 0.55))
            asked[step] = asked.get(step, 0) + sum(isinstance(m, msg.DesiredAbstractState) for m in answer)
            answers += answer
        answers += node.tick(nodes.at(step + 0.75))
    quiet = 120 + lead + 10
    assert not any(count for step, count in asked.items() if 100 + lead < step < quiet)
    assert all(asked[step] for step in range(quiet + 1, 140))
    details = [m.detail for m in answers if isinstance(m, msg.SwarmEvent)]
    assert any("a second plane, or an intruder" in detail for detail in details)
    assert details.count("the states of the plane contradict each other") == 1


@pytest.mark.parametrize("lead", LEADS)
def test_a_second_robot_with_the_same_id_that_is_ahead_makes_neither_be_believed(lead: int) -> None:
    node = nodes.observer()
    answers: list[msg.Message] = []
    for step in range(100, 150):
        honest = nodes.states(step)
        answers += nodes.hear(node, (*honest, honest[2]._replace(step=step + lead, position=-0.4)), step)
        if step > 100 + lead + 12:
            assert node.roles == {1: Role.ACTIVE, 2: Role.ACTIVE, 3: Role.SILENT, 4: Role.ACTIVE}
    said = [
        m for m in answers if isinstance(m, msg.SwarmEvent) and m.kind in (msg.EventKind.REFUSED, msg.EventKind.DEAD)
    ]
    assert [(m.detail, m.agent_id) for m in said] == [("robot 3: two different states of a step", 0), ("silent", 3)]
    for step in range(150, 170):
        nodes.hear(node, nodes.states(step), step)
    assert node.roles[3] is Role.ACTIVE


@pytest.mark.parametrize("lead", LEADS)
def test_the_simulated_plane_does_not_follow_a_second_robot_with_the_same_id(lead: int) -> None:
    node = RealtimePlane(configure.plane_config(nodes.scenario(), nodes.CLOCK))
    answers: list[msg.Message] = []
    for step in range(100, 150):
        honest = nodes.states(step, broadcast_step=step - 1)
        second = honest[2]._replace(step=step + lead, position=-0.4 + 0.01 * (step - 100))
        answers += nodes.hear(node, (*honest, second), step)
    basis = [message for message in answers if isinstance(message, msg.Basis)][-1]
    assert dict(zip(basis.agent_ids, basis.state_steps, strict=True))[3] <= 100 + 2 * lead
    assert nodes.kinds(answers).count(msg.EventKind.REFUSED) == 1


@pytest.mark.parametrize(
    ("word", "lie"),
    [
        ("mass", {"mass": 3.0}),
        ("mass", {"mass": 1e9}),
        ("others", {"mass": 1.0}),
        ("velocity", {"velocity": 1e300}),
        ("velocity", {"velocity": -200.0}),
        ("damping", {"damping": 1e300}),
    ],
)
def test_a_robot_that_cannot_be_so_is_named_and_counts_as_silent(word: str, lie: dict[str, float]) -> None:
    node = nodes.observer()
    answers: list[msg.Message] = []
    for step in range(100, 130):
        first, second, third, fourth = nodes.states(step)
        answer = nodes.hear(node, (first, second, third._replace(**lie if step > 110 else {}), fourth), step)
        answers += answer
    (refused,) = [m for m in answers if isinstance(m, msg.SwarmEvent) and m.kind == msg.EventKind.REFUSED]
    assert refused.detail.startswith("robot 3: a ")
    assert word in refused.detail
    assert node.roles[3] is Role.SILENT
    assert [configure.bounds(nodes.scenario()).problem(m) for m in nodes.sums(answer)] == [None, None]


def test_robots_at_their_bounds_make_broadcasts_that_are_believed() -> None:
    """What the observer takes, the others must take: else one robot stops all."""
    bounds = configure.bounds(nodes.scenario())
    masses = (0.001, 0.001, bounds.swarm_mass - 0.003, 0.001)
    for position, speed in product((-bounds.reach, bounds.reach), (-bounds.fastest, bounds.fastest)):
        at_bounds = nodes.states(5, position=position, velocity=speed)
        answer = nodes.hear(
            nodes.observer(), [state._replace(mass=m) for state, m in zip(at_bounds, masses, strict=True)], 5
        )
        assert msg.EventKind.REFUSED not in nodes.kinds(answer)
        assert [bounds.problem(m) for m in nodes.sums(answer)] == [None, None]


def test_what_is_just_beyond_the_bounds_is_refused() -> None:
    bounds = configure.bounds(nodes.scenario())
    torque, inertia = 9.81 * bounds.swarm_mass * bounds.reach, bounds.swarm_mass * bounds.reach**2
    most = (torque, inertia, 9.81 * bounds.swarm_mass * bounds.fastest, 2.0 * inertia / bounds.reach * bounds.fastest)
    assert bounds.problem(msg.AbstractState(0, 5, 4, *most)) is None
    for index in range(4):
        for sign in (1.0, -1.0):
            beyond = [value * (1.001 * sign if index == place else 1.0) for place, value in enumerate(most)]
            problem = bounds.problem(msg.AbstractState(0, 5, 4, *beyond))
            assert problem is not None and ("robots too fast" in problem.reason) is (index > 1)
            limitless = Bounds(9.81, 1.0, inf).problem(msg.AbstractState(0, 5, 4, *most[:2], *beyond[2:]))
            assert limitless is None
    assert not Bounds(9.81, 1.0).problem(msg.PlaneState(0, 5, 0.1, FASTEST_TURN))
    assert "angular velocity" in str(Bounds(9.81, 1.0).problem(msg.PlaneState(0, 5, 0.1, 1.01 * FASTEST_TURN)))
    assert "an angle beyond" in str(Bounds(9.81, 1.0).problem(msg.PlaneState(0, 5, -3.3, 0.0)))


def test_a_robot_that_leaves_makes_room_for_its_mass() -> None:
    node = nodes.observer()
    first, second, third, fourth = nodes.states(5)
    nodes.hear(node, (first, second, third._replace(mass=0.5), fourth), 5)
    heavy = third._replace(step=6, mass=1.0)
    nodes.hear(node, (first, second, heavy, fourth._replace(step=6, status=msg.Status.LEFT)), 6)
    assert node.hear(heavy._replace(step=7), nodes.at(7.2)) == ()
