from __future__ import annotations

from math import nan

import pytest
from hypothesis import given, strategies as st
from tests.swarmabs_core.helpers import PERIOD_NS, agent_state

from swarmabs_core.behaviours import Observer, ObserverConfig
from swarmabs_core.behaviours.base import ConflictError, StepAheadError, UnexpectedMessageError, UnknownAgentError
from swarmabs_core.cdr import encode
from swarmabs_core.errors import RunError
from swarmabs_core.membership import Change, ChangeKind
from swarmabs_core.messages import (
    AGENT_STATE,
    AbstractState,
    AgentState,
    AuxiliaryState,
    EventKind,
    Kind,
    Message,
    PlaneState,
    Status,
    SwarmEvent,
)

MEMBERS = (1, 2, 3, 4)


def observer(*schedule: Change, last_step: int | None = None) -> Observer:
    return Observer(ObserverConfig(MEMBERS, PERIOD_NS, 9.81, 1.0, schedule, last_step))


def robots(step: int = 0, without: tuple[int, ...] = ()) -> list[AgentState]:
    """Two single and two double integrators, somewhere."""
    return [
        agent_state(
            i,
            step,
            kind=Kind.SINGLE_INTEGRATOR if i < 3 else Kind.DOUBLE_INTEGRATOR,
            mass=0.3 + 0.1 * i,
            damping=0.0 if i < 3 else 0.7,
            position=0.1 * (-1) ** i + 0.013 * i + 0.001 * step,
            velocity=0.07 * i - 0.1,
        )
        for i in MEMBERS
        if i not in without
    ]


def feed(node: Observer, messages: list[AgentState]) -> list[Message]:
    return [answer for message in messages for answer in node.handle(message)]


def sums(node: Observer, messages: list[AgentState]) -> tuple[AbstractState, AuxiliaryState]:
    """Feed the last messages of a step and return the two broadcasts."""
    *_, abstract, auxiliary = feed(node, messages)
    assert isinstance(abstract, AbstractState)
    assert isinstance(auxiliary, AuxiliaryState)
    return abstract, auxiliary


def test_sums_by_hand() -> None:
    """Two robots of 0.5 kg at +-0.1 m, one of them a double integrator."""
    node = Observer(ObserverConfig((1, 2), PERIOD_NS, 10.0, 1.0))
    first = agent_state(1, kind=Kind.DOUBLE_INTEGRATOR, damping=2.0, position=0.1, velocity=0.2)
    abstract, auxiliary = sums(node, [first, agent_state(2, position=-0.1, velocity=0.4)])
    assert abstract[:3] == (0, 0, 2)
    assert abstract[3:] == pytest.approx((0.0, 0.01, 10.0 * 0.3, 2.0 * 0.5 * (0.02 - 0.04)))
    s0, s3 = 0.5, 4.0 * 0.5**4 * 0.01
    d0 = 0.5 * 3.0
    assert auxiliary[2:] == pytest.approx((s0, 0.0, 0.005, s3, d0, 0.1 * d0, 0.01 * d0, 0.5 * 0.2))


arrivals = st.tuples(
    st.permutations([*robots(0), *robots(0)[:2]]), st.permutations(robots(1)), st.permutations(robots(2))
)


@given(arrivals)
def test_any_order_of_arrival_gives_the_same_bytes(steps: tuple[list[AgentState], ...]) -> None:
    """Repeats are among the first step's messages, and some of them come when the step is over."""
    found, expected = observer(), observer()
    for step, arrival in enumerate(steps):
        answer, reference = feed(found, arrival), feed(expected, robots(step))
        assert b"".join(map(encode, answer)) == b"".join(map(encode, reference))
        assert len(answer) == 2


def test_nothing_is_published_before_the_last_one() -> None:
    node = observer()
    assert node.start() == ()
    for number, state in enumerate(robots()[:3], start=1):
        assert node.handle(state) == ()
        assert node.missing() == (0, tuple(f"agent {i}" for i in MEMBERS[number:]))
    assert node.missing_agents() == node.silent_agents() == (4,)
    assert node.awaits() == (AGENT_STATE,)
    assert [type(answer) for answer in node.handle(robots()[3])] == [AbstractState, AuxiliaryState]
    assert node.missing() == (1, ("agent 1", "agent 2", "agent 3", "agent 4"))
    assert node.silent_agents() == ()  # they all wait for somebody


def test_repeats_and_late_states_change_nothing() -> None:
    node, undisturbed = observer(), observer()
    feed(node, robots(0))
    feed(undisturbed, robots(0))
    late = robots(0)[1]._replace(position=0.4)
    assert node.handle(late) == ()
    assert feed(node, [*robots(1)[:3], *robots(1)[:3]]) == []
    assert sums(node, robots(1)[3:]) == sums(undisturbed, robots(1))


@pytest.mark.parametrize(
    ("state", "error", "text"),
    [
        (agent_state(9), UnknownAgentError, "robot 9 is not a member of this swarm"),
        (agent_state(4, 1), StepAheadError, "agent 4: step 0 expected, 1 received"),
        (agent_state(1, position=0.3), ConflictError, "agent 1: two different messages of step 0"),
    ],
)
def test_what_no_correct_robot_sends(state: AgentState, error: type[Exception], text: str) -> None:
    node = observer()
    feed(node, robots()[:3])
    with pytest.raises(error, match=text):
        node.handle(state)
    # The refused message has changed nothing.
    assert sums(node, robots()[3:]) == sums(observer(), robots())


def test_repeated_nan_is_no_conflict() -> None:
    """A NaN that was sent twice arrives as two different objects, equal in their bytes alone."""
    node = observer()
    for _ in range(2):
        assert node.handle(robots()[0]._replace(velocity=float(str(nan)))) == ()


def test_other_messages_are_not_for_the_observer() -> None:
    with pytest.raises(UnexpectedMessageError, match="observer: a PlaneState was delivered"):
        observer().handle(PlaneState(0, 0, 0.0, 0.0))


def test_run_ends_with_its_last_step() -> None:
    node = observer(last_step=1)
    feed(node, robots(0))
    assert node.awaits() == (AGENT_STATE,)
    assert len(feed(node, robots(1))) == 2
    assert node.awaits() == ()
    assert feed(node, robots(2)) == []
    assert node.drop(MEMBERS, "stalled") == ()


@pytest.mark.parametrize("status", [Status.SAFE_STOP, Status.LEFT])
def test_only_active_robots_are_in_the_s_and_d_sums(status: Status) -> None:
    """What stands in safe stop, or says that it leaves, still weighs and moves."""
    states = robots()
    states[2] = states[2]._replace(status=status)
    abstract, auxiliary = sums(observer(), states)
    everybody, _ = sums(observer(), robots())
    without = Observer(ObserverConfig((1, 2, 4), PERIOD_NS, 9.81, 1.0))
    _, others = sums(without, robots(without=(3,)))
    assert abstract == everybody
    assert auxiliary[:9] == others[:9]
    assert auxiliary.q == pytest.approx(others.q + states[2].mass * states[2].velocity ** 2)


def test_robot_that_leaves_unplanned_is_waited_for_no_more() -> None:
    node = observer()
    feed(node, [*robots()[:3], robots()[3]._replace(status=Status.LEFT)])
    event, abstract, _ = feed(node, robots(1, without=(4,)))
    assert isinstance(event, SwarmEvent)
    assert isinstance(abstract, AbstractState)
    assert (event.step, event.agent_id, event.kind, event.detail) == (1, 4, EventKind.LEFT, "left")
    assert abstract.agent_count == 3


def test_dropped_robot_stands_where_it_was() -> None:
    node = observer()
    feed(node, robots(0))
    feed(node, robots(1, without=(3,)))
    event, abstract, auxiliary = node.drop(node.missing_agents(), "no answer")
    last = robots(0)[2]
    assert event == SwarmEvent(PERIOD_NS, 1, 3, EventKind.DEAD, last.position, "no answer")
    standing = last._replace(velocity=0.0, status=Status.SAFE_STOP, step=1, stamp=PERIOD_NS)
    equivalent = observer()
    feed(equivalent, robots(0))
    assert (abstract, auxiliary) == sums(equivalent, [*robots(1, without=(3,)), standing])
    assert node.handle(robots(1)[2]) == ()  # too late


def test_drop_of_some_of_the_missing_waits_for_the_others() -> None:
    node = observer()
    feed(node, robots(0))
    feed(node, robots(1, without=(3, 4)))
    assert node.drop([3], "no answer") == ()
    assert [type(m) for m in feed(node, [robots(1)[3]])] == [SwarmEvent, AbstractState, AuxiliaryState]


def test_last_robot_may_not_go_before_the_run_ends() -> None:
    kills = tuple(Change(0, i, ChangeKind.KILL) for i in MEMBERS)
    with pytest.raises(RunError, match="step 1: no robot is left that takes part in the run"):
        feed(observer(*kills, last_step=1), robots(0))
    assert len(feed(observer(*kills, last_step=0), robots(0))) == 2
