"""Who speaks for somebody else, ahead of him by as much as clocks may differ: nodes notice when both speak."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.swarmabs_core.realtime.nodes import (
    CLOCK,
    Body,
    at,
    broadcasts,
    controller,
    kinds,
    observer,
    robot,
    scenario,
    states,
)

from swarmabs_config import realtime as configure
from swarmabs_core.messages import DesiredAbstractState, EventKind, PlaneState, SwarmEvent
from swarmabs_core.realtime.observer import Role
from swarmabs_core.realtime.plane import RealtimePlane
from swarmabs_core.realtime.validation import Heard

if TYPE_CHECKING:
    from swarmabs_core.messages import Message

LEADS = [0, 1, 2]
"""Steps by which an intruder is ahead; the last is the clock tolerance."""


@pytest.mark.parametrize("lead", LEADS)
@pytest.mark.parametrize("part", [0, 1, 2, None], ids=["abstract", "sums", "desired", "all"])
def test_broadcasts_of_an_intruder_who_is_ahead_stop_a_robot(lead: int, part: int | None) -> None:
    body = Body()
    node = robot(body)
    refused: list[int] = []
    for step in range(100, 160):
        forged = broadcasts(step + lead, torque=-3.0)
        forged = (forged[0]._replace(agent_count=4), forged[1]._replace(d0=0.4), forged[2])
        for message in (*broadcasts(step, torque=0.3), *(forged if part is None else forged[part : part + 1])):
            refused += kinds(node.hear(message, at(step + 0.6)))
        node.tick(at(step + 1))
    assert refused == [EventKind.REFUSED] * (3 if part is None else 1)
    # Until the step has come of which the first forged message was, nobody can tell.
    assert not any(body.commands[lead:])
    assert node.health(at(160)).text == "safe stop: the broadcasts contradict each other"


def test_a_robot_follows_again_when_the_intruder_is_silent() -> None:
    body = Body()
    node = robot(body)
    for step in range(100, 140):
        forged = broadcasts(step + 2, torque=-3.0) if step < 110 else ()
        for message in (*broadcasts(step), *forged):
            node.hear(message, at(step + 0.6))
        node.tick(at(step + 1))
    # The last forged one is of 111, and is noticed then; the first command is that of 101.
    assert not any(body.commands[2:21])
    assert all(body.commands[21:])


def test_what_was_heard_is_kept_for_a_bounded_time() -> None:
    heard: Heard[int] = Heard(10, 2)
    for step in range(1000):
        for message in broadcasts(step + 2):
            heard.add(1, message, step)
        assert len(heard.steps()) <= 13
    assert not heard.add(1, broadcasts(985)[0], 999)  # of a step that is not kept


@pytest.mark.parametrize("lead", LEADS)
def test_a_second_plane_that_is_ahead_makes_the_controller_ask_for_nothing(lead: int) -> None:
    node = controller()
    asked: dict[int, int] = {}
    answers: list[Message] = []
    for step in range(100, 140):
        intruder = [PlaneState(0, step + lead, -0.2, 0.0)] if step < 120 else []
        for plane in (PlaneState(0, step, 0.05, 0.0), *intruder):
            answer = node.hear(plane, at(step + 0.55))
            asked[step] = asked.get(step, 0) + sum(isinstance(m, DesiredAbstractState) for m in answer)
            answers += answer
        answers += node.tick(at(step + 0.75))
    quiet = 120 + lead + 10
    assert not any(count for step, count in asked.items() if 100 + lead < step < quiet)
    assert all(asked[step] for step in range(quiet + 1, 140))
    details = [m.detail for m in answers if isinstance(m, SwarmEvent)]
    assert any("a second plane, or an intruder" in detail for detail in details)
    assert "the states of the plane contradict each other" in details


@pytest.mark.parametrize("lead", LEADS)
def test_a_second_robot_with_the_same_id_that_is_ahead_makes_neither_be_believed(lead: int) -> None:
    node = observer()
    answers: list[Message] = []
    for step in range(100, 150):
        honest = states(step)
        for state in (*honest, honest[2]._replace(step=step + lead, position=-0.4)):
            answers += node.hear(state, at(step + 0.2))
        answers += node.tick(at(step + 0.5))
        if step > 100 + lead + 12:
            assert node.roles == {1: Role.ACTIVE, 2: Role.ACTIVE, 3: Role.SILENT, 4: Role.ACTIVE}
    said = [m for m in answers if isinstance(m, SwarmEvent) and m.kind in (EventKind.REFUSED, EventKind.DEAD)]
    assert [(m.detail, m.agent_id) for m in said] == [("robot 3: two different states of a step", 0), ("silent", 3)]
    for step in range(150, 170):
        for state in states(step):
            node.hear(state, at(step + 0.2))
        node.tick(at(step + 0.5))
    assert node.roles[3] is Role.ACTIVE


@pytest.mark.parametrize("lead", LEADS)
def test_the_simulated_plane_does_not_follow_a_second_robot_with_the_same_id(lead: int) -> None:
    node = RealtimePlane(configure.plane_config(scenario(), CLOCK))
    answers: list[Message] = []
    for step in range(100, 150):
        honest = states(step, broadcast_step=step - 1)
        second = honest[2]._replace(step=step + lead, position=-0.4 + 0.01 * (step - 100))
        for state in (*honest, second):
            answers += node.hear(state, at(step + 0.2))
        answers += node.tick(at(step + 0.5))
    assert node._robots()[3].step <= 100 + 2 * lead
    assert kinds(tuple(answers)).count(EventKind.REFUSED) == 1
