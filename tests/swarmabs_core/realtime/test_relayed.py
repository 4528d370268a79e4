"""What robots pass on in real time: written and read again, and what is refused."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import NEVER, AgentState, PlaneState, Relay
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.realtime.controller import LawView
from swarmabs_core.realtime.modes import Orders
from swarmabs_core.realtime.relayed import Told, constants_of, motion_of, read, written

ROBOTS = 11
STEP = 500
CLOCK = Schedule(10_000_000, 0)
numbers = st.floats(-1e3, 1e3)
steps = st.integers(-1, STEP + 2)


def relay_of(content: bytes) -> Relay:
    return Relay(0, STEP, 3, 0, 0, 0, content)


@st.composite
def states(draw: st.DrawFn, rank: int) -> AgentState:
    step = draw(st.integers(0, STEP + 2))
    following = draw(st.sampled_from([step, NEVER]))
    kind, status = draw(st.integers(1, 2)), draw(st.integers(1, 3))
    mass, damping, position, velocity = (draw(numbers) for _ in range(4))
    stamp = CLOCK.begin(step)
    return AgentState(stamp, step, following, rank + 1, kind, status, mass, damping, position, velocity, 0.0)


@st.composite
def told(draw: st.DrawFn) -> tuple[Told, list[AgentState]]:
    passed_on = [draw(states(rank)) for rank in draw(st.sets(st.integers(0, ROBOTS - 1)))]
    introduced = [state for state in passed_on if draw(st.booleans())]
    plane = PlaneState(draw(st.integers(0, 2**60)), STEP, draw(numbers), draw(numbers))
    return (
        Told(
            Orders(draw(steps), draw(steps)),
            LawView(draw(steps), draw(steps), tuple(draw(st.lists(numbers, max_size=12)))),
            (draw(steps), draw(st.integers(0, 2**ROBOTS - 1))),
            draw(steps),
            draw(st.sampled_from([None, plane])),
            np.array([draw(st.integers(STEP - 200, STEP + 2) | st.just(-1)) for _ in range(ROBOTS)]),
            {state.agent_id - 1: constants_of(state) for state in introduced},
            [motion_of(state.agent_id - 1, state, STEP) for state in passed_on],
        ),
        passed_on,
    )


@given(told())
def test_what_is_told_is_read(given: tuple[Told, list[AgentState]]) -> None:
    said, passed_on = given
    heard = read(relay_of(written(STEP, said, ROBOTS)), ROBOTS)
    assert (heard.orders, heard.law, heard.electing, heard.plane) == (said.orders, said.law, said.electing, said.plane)
    assert heard.held.tolist() == said.held.tolist()
    assert heard.constants == said.constants
    read_again = [
        motion.state(motion.rank + 1, constants_of(state), STEP - motion.age, CLOCK)
        for motion, state in zip(heard.motions, passed_on, strict=True)
    ]
    assert read_again == passed_on
    assert all(motion.tag == constants_of(state).tag for motion, state in zip(heard.motions, passed_on, strict=True))


@given(told(), st.data())
def test_what_is_cut_short_or_of_another_swarm_is_refused(
    given: tuple[Told, list[AgentState]], data: st.DataObject
) -> None:
    content = written(STEP, given[0], ROBOTS)
    with pytest.raises(MalformedMessageError):
        read(relay_of(content[: data.draw(st.integers(0, len(content) - 1))]), ROBOTS)
    with pytest.raises(MalformedMessageError):
        read(relay_of(content + b"\0"), ROBOTS)
