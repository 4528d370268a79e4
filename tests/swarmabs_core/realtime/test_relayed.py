"""What robots pass on in real time: written and read again, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import NEVER, AgentState, Basis, PlaneState, Relay, Source
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.realtime.controller import LawView
from swarmabs_core.realtime.modes import Orders
from swarmabs_core.realtime.relayed import (
    BUDGET,
    SIGNATURE,
    Answer,
    Told,
    answers_of,
    constants_of,
    motion_of,
    read,
    room,
    written,
)

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
def answers(draw: st.DrawFn, held: list[int]) -> Answer:
    """Return an answer from states that are mostly those that are held, but for that of the relay's sender."""
    step = draw(st.integers(STEP - 100, STEP + 2))
    since = draw(st.none() | st.just(NEVER) | st.integers(max(step - 100, 0), step - 1))
    division = None if since is None else draw(st.none() | st.integers(STEP - 100, STEP + 2))
    if not draw(st.booleans()):
        return Answer(step, since=since, division=division)
    ranks = draw(st.sets(st.integers(0, ROBOTS - 1)))
    usual = {rank: min(held[rank], STEP - 1) for rank in ranks if held[rank] >= 0}
    unusual = {rank: draw(st.integers(-STEP, STEP + 2)) for rank in draw(st.sets(st.sampled_from(range(ROBOTS))))}
    states = dict(sorted((usual | unusual).items()))
    resting = frozenset(draw(st.sets(st.sampled_from(sorted(states))))) if states else frozenset[int]()
    return Answer(step, True, states, resting, since, division)


@st.composite
def told(draw: st.DrawFn) -> tuple[Told, list[AgentState]]:
    passed_on = [draw(states(rank)) for rank in draw(st.sets(st.integers(0, ROBOTS - 1), max_size=5))]
    introduced = [state for state in passed_on if draw(st.booleans())]
    held = [draw(st.integers(STEP - 200, STEP + 2) | st.just(-1)) for _ in range(ROBOTS)]
    plane = draw(st.none() | st.builds(PlaneState, st.integers(0, 2**60), st.just(STEP), numbers, numbers))
    sealed = draw(st.booleans())
    signatures = st.binary(min_size=SIGNATURE, max_size=SIGNATURE) if sealed else st.just(b"")
    return (
        Told(
            Orders(draw(steps), draw(steps)),
            LawView(draw(steps), draw(steps), tuple(draw(st.lists(numbers, max_size=12)))),
            (draw(steps), draw(st.integers(0, 2**ROBOTS - 1))),
            draw(steps),
            plane,
            np.array(held),
            draw(st.lists(answers(held), max_size=3)),
            draw(st.sampled_from([None, (), tuple(draw(numbers) for _ in range(4))])),
            {state.agent_id - 1: constants_of(state) for state in introduced},
            [motion_of(state.agent_id - 1, state, STEP, draw(signatures)) for state in passed_on],
            sealed,
            b"" if plane is None else draw(signatures),
        ),
        passed_on,
    )


@given(told())
def test_what_is_told_is_read(given: tuple[Told, list[AgentState]]) -> None:
    said, passed_on = given
    heard = read(relay_of(written(STEP, said, ROBOTS)), ROBOTS)
    assert (heard.orders, heard.law, heard.electing, heard.plane) == (said.orders, said.law, said.electing, said.plane)
    assert heard.held.tolist() == said.held.tolist()
    assert (heard.answers, heard.progress) == (said.answers, said.progress)
    assert heard.constants == said.constants
    assert (heard.sealed, heard.plane_signature) == (said.sealed, said.plane_signature)
    assert [motion.signature for motion in heard.motions] == [motion.signature for motion in said.motions]
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


def test_provenances_become_answers_in_few_bytes() -> None:
    """Robot 7 has died, robot 3 is assumed at rest although its state is recent, robot 5 has left."""
    rank = {robot: robot - 1 for robot in range(1, ROBOTS + 1)}
    there = [robot for robot in rank if robot != 5]
    of = [STEP - 300 if robot == 7 else STEP - 1 for robot in there]
    rests = [int(robot in {3, 7}) for robot in there]
    observed = Basis(0, STEP - 1, NEVER, NEVER, Source.OBSERVER, tuple(of), tuple(there), tuple(rests))
    asked = Basis(0, STEP - 1, STEP - 3, 7, Source.CONTROLLER, (STEP - 2,), (0,), (0,))
    (answer,) = answers_of([observed, asked], rank, 10)
    states = {robot - 1: step for robot, step in zip(there, of, strict=True)}
    assert answer == Answer(STEP - 1, True, states, frozenset({2}), STEP - 3, STEP - 2)
    held = np.array([STEP - 300 if robot == 7 else STEP - (robot != 1) for robot in rank])
    plain = Told(Orders(), LawView(), (-1, 0), -1, None, held)
    with_it = replace(plain, answers=[answer])
    assert read(relay_of(written(STEP, with_it, ROBOTS)), ROBOTS).answers == [answer]
    assert len(written(STEP, with_it, ROBOTS)) - len(written(STEP, plain, ROBOTS)) == 4 + 2 + 2 * 7


def test_of_many_unusual_states_it_is_not_told_which_they_are() -> None:
    states = dict.fromkeys(range(50), STEP - 5)
    told = Told(Orders(), LawView(), (-1, 0), -1, None, np.full(50, STEP), [Answer(STEP - 1, True, states)])
    (answer,) = read(relay_of(written(STEP, told, 50)), 50).answers
    assert answer == Answer(STEP - 1, True)


@given(told())
def test_sizes_are_known_before(given: tuple[Told, list[AgentState]]) -> None:
    said, _ = given
    left = len(written(STEP, said, ROBOTS)) - len(written(STEP, replace(said, constants={}, motions=[]), ROBOTS))
    constants, motions = len(said.constants), len(said.motions)
    assert room(left, constants, motions, sealed=said.sealed)
    assert not room(left - 1, constants, motions, sealed=said.sealed)


def test_a_relay_larger_than_its_sender_may_write_is_refused() -> None:
    """So nobody makes others check more signatures by one message."""
    state = AgentState(0, STEP, NEVER, 1, 1, 1, 1.0, 0.0, 0.1, 0.2, 0.0)
    motion = motion_of(0, state, STEP, bytes(SIGNATURE))
    head = Told(Orders(), LawView(), (-1, 0), -1, None, np.full(ROBOTS, -1), sealed=True)
    budget = BUDGET - len(written(STEP, head, ROBOTS))
    most = next(n for n in range(100) if not room(budget, 0, n + 1, sealed=True))
    assert most == 13
    assert len(read(relay_of(written(STEP, replace(head, motions=[motion] * most), ROBOTS)), ROBOTS).motions) == most
    with pytest.raises(MalformedMessageError):
        read(relay_of(written(STEP, replace(head, motions=[motion] * (most + 1)), ROBOTS)), ROBOTS)
