"""Who speaks for somebody else, ahead of him by as much as clocks may differ: nodes notice when both speak."""

from __future__ import annotations

import pytest
from tests.swarmabs_core.realtime.nodes import (
    Body,
    at,
    broadcasts,
    kinds,
    robot,
)

from swarmabs_core.messages import (
    EventKind,
)
from swarmabs_core.realtime.heard import Heard

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
