from collections.abc import Sequence
from dataclasses import replace
from math import nan

import pytest
from tests.swarmabs_core.helpers import PERIOD_NS, agent_state

from swarmabs_core import messages as msg
from swarmabs_core.behaviours import Observer
from swarmabs_core.behaviours.base import ConflictError, StepAheadError, UnexpectedMessageError, UnknownAgentError
from swarmabs_core.behaviours.packed import PackedObserver
from swarmabs_core.cdr import encode
from swarmabs_core.errors import RunError
from swarmabs_core.membership import Change, ChangeKind
from swarmabs_core.models import ObserverConfig
from swarmabs_core.parent_response import TorqueEstimator
from swarmabs_core.plant import Friction

MEMBERS = (1, 2, 3, 4)


def observer(*schedule: Change, last_step: int | None = None) -> Observer:
    return Observer(ObserverConfig(PERIOD_NS, last_step, members=MEMBERS, schedule=schedule))


def robots(step: int = 0, without: tuple[int, ...] = ()) -> list[msg.AgentState]:
    """Two single and two double integrators, somewhere."""
    single, double = {"kind": msg.Kind.SINGLE_INTEGRATOR}, {"kind": msg.Kind.DOUBLE_INTEGRATOR, "damping": 0.7}
    places = {i: 0.1 * (-1) ** i + 0.013 * i + 0.001 * step for i in MEMBERS if i not in without}
    return [
        agent_state(i, step, mass=0.3 + 0.1 * i, position=p, velocity=0.07 * i - 0.1, **(single if i < 3 else double))
        for i, p in places.items()
    ]


def feed(node: Observer, messages: Sequence[msg.Message]) -> list[msg.Message]:
    return [answer for message in messages for answer in node.handle(message)]


def sums(node: Observer, messages: Sequence[msg.Message]) -> tuple[msg.AbstractState, msg.AuxiliaryState]:
    """Feed the last messages of a step and return the two broadcasts."""
    *_, abstract, auxiliary = feed(node, messages)
    assert isinstance(abstract, msg.AbstractState)
    assert isinstance(auxiliary, msg.AuxiliaryState)
    return abstract, auxiliary


def test_sums_by_hand() -> None:
    """Two robots of 0.5 kg at +-0.1 m, one of them a double integrator."""
    node = Observer(ObserverConfig(PERIOD_NS, members=(1, 2), gravity=10.0))
    first = agent_state(1, kind=msg.Kind.DOUBLE_INTEGRATOR, damping=2.0, position=0.1, velocity=0.2)
    abstract, auxiliary = sums(node, [first, agent_state(2, position=-0.1, velocity=0.4)])
    assert abstract[:3] == (0, 0, 2)
    assert abstract[3:] == pytest.approx((0.0, 0.01, 10.0 * 0.3, 2.0 * 0.5 * (0.02 - 0.04)))
    s0, s3 = 0.5, 4.0 * 0.5**4 * 0.01
    d0 = 0.5 * 3.0
    assert auxiliary[2:] == pytest.approx((s0, 0.0, 0.005, s3, d0, 0.1 * d0, 0.01 * d0, 0.5 * 0.2))


def test_nothing_is_published_before_the_last_one_and_repeats_change_nothing() -> None:
    node = observer()
    assert node.start() == ()
    for number, state in enumerate(robots()[:3], start=1):
        assert feed(node, [state, state]) == []
        assert node.missing() == (0, tuple(f"agent {i}" for i in MEMBERS[number:]))
    assert node.missing_agents() == node.silent_agents() == (4,)
    assert node.awaits() == (msg.AGENT_STATE,)
    assert [type(answer) for answer in node.handle(robots()[3])] == [msg.AbstractState, msg.AuxiliaryState]
    assert node.handle(robots()[1]._replace(position=0.4)) == (), "late"
    assert node.missing() == (1, ("agent 1", "agent 2", "agent 3", "agent 4"))
    assert node.silent_agents() == ()  # they all wait for somebody
    # A NaN that was sent twice arrives as two different objects, equal in their bytes alone.
    assert feed(observer(), [robots()[0]._replace(velocity=float(str(nan))) for _ in range(2)]) == []


@pytest.mark.parametrize(
    ("message", "error", "text"),
    [
        (agent_state(9), UnknownAgentError, "robot 9 is not a member of this swarm"),
        (agent_state(4, 1), StepAheadError, "agent 4: step 0 expected, 1 received"),
        (agent_state(1, position=0.3), ConflictError, "agent 1: two different messages of step 0"),
        (msg.PlaneState(0, 0, 0.0, 0.0), UnexpectedMessageError, "observer: received PlaneState"),
    ],
)
def test_what_is_refused_of_robots_changes_nothing(message: msg.Message, error: type[Exception], text: str) -> None:
    node = observer()
    feed(node, robots()[:3])
    with pytest.raises(error, match=text):
        node.handle(message)
    assert sums(node, robots()[3:]) == sums(observer(), robots())


def test_newcomers_are_announced_and_robots_that_leave_are_waited_for_no_more() -> None:
    node = observer(Change(1, 4, ChangeKind.JOIN))
    feed(node, robots(0, without=(4,)))
    assert feed(node, robots(1))[0] == msg.SwarmEvent(PERIOD_NS, 1, 4, msg.EventKind.JOINED, 0.0, "")
    node = observer()
    feed(node, [*robots()[:3], robots()[3]._replace(status=msg.Status.LEFT)])
    event, abstract, _ = feed(node, robots(1, without=(4,)))
    assert event[1:4] == (1, 4, msg.EventKind.LEFT) and event[-1] == "left"
    assert isinstance(abstract, msg.AbstractState) and abstract.agent_count == 3


def test_run_ends_with_its_last_step_and_not_for_want_of_robots() -> None:
    node = observer(last_step=1)
    feed(node, robots(0))
    assert node.awaits() == (msg.AGENT_STATE,)
    assert len(feed(node, robots(1))) == 2
    assert node.awaits() == ()
    assert feed(node, robots(2)) == []
    assert node.drop(MEMBERS, "stalled") == ()
    kills = tuple(Change(0, i, ChangeKind.KILL) for i in MEMBERS)
    with pytest.raises(RunError, match="step 1: no robot is left"):
        feed(observer(*kills, last_step=1), robots(0))
    assert len(feed(observer(*kills, last_step=0), robots(0))) == 2


@pytest.mark.parametrize("status", [msg.Status.SAFE_STOP, msg.Status.LEFT])
def test_only_active_robots_are_in_the_s_and_d_sums(status: msg.Status) -> None:
    """What stands in safe stop, or says that it leaves, still weighs and moves."""
    states = robots()
    states[2] = states[2]._replace(status=status)
    abstract, auxiliary = sums(observer(), states)
    everybody, _ = sums(observer(), robots())
    without = Observer(ObserverConfig(PERIOD_NS, members=(1, 2, 4)))
    _, others = sums(without, robots(without=(3,)))
    assert abstract == everybody
    assert auxiliary[:9] == others[:9]
    assert auxiliary.q == pytest.approx(others.q + states[2].mass * states[2].velocity ** 2)


def test_dropped_robot_stands_where_it_was() -> None:
    node = observer()
    feed(node, robots(0))
    feed(node, robots(1, without=(3, 4)))
    assert node.drop([3], "no answer") == (), "the other one is waited for"
    event, abstract, auxiliary = node.handle(robots(1)[3])
    last = robots(0)[2]
    assert event == msg.SwarmEvent(PERIOD_NS, 1, 3, msg.EventKind.DEAD, last.position, "no answer")
    standing = last._replace(velocity=0.0, status=msg.Status.SAFE_STOP, step=1, stamp=PERIOD_NS)
    equivalent = observer()
    feed(equivalent, robots(0))
    assert (abstract, auxiliary) == sums(equivalent, [*robots(1, without=(3,)), standing])
    assert node.handle(robots(1)[2]) == ()  # too late


MODEL = (0.5, Friction(0.01, 30.0, 20.0, 0.02, 30.0, 1.0), 50.0)


def watcher(*schedule: Change, last_step: int | None = None) -> Observer:
    """Return an observer that watches the plane."""
    inertia, friction, bandwidth = MODEL
    config = ObserverConfig(PERIOD_NS, last_step, members=MEMBERS, schedule=schedule)
    return Observer(replace(config, type="parent_response", inertia=inertia, friction=friction, bandwidth=bandwidth))


def plane(step: int = 0) -> msg.PlaneState:
    return msg.PlaneState(step * PERIOD_NS, step, 0.1 - 0.01 * step, -1.0 * step)


def test_torque_is_the_estimators_and_the_rest_the_robots() -> None:
    node, summing, estimator = watcher(), observer(), TorqueEstimator(*MODEL, PERIOD_NS / 1e9)
    for step in range(4):
        abstract, auxiliary = sums(node, [*robots(step), plane(step)])
        summed, same = sums(summing, robots(step))
        torque, rate = estimator.update(plane(step).angle, plane(step).angular_velocity, summed.inertia)
        assert abstract == summed._replace(torque=torque, torque_rate=rate)
        assert auxiliary == same
    assert torque != pytest.approx(summed.torque, rel=0.1)


def test_waits_for_the_plane_too_and_refuses_what_no_correct_plane_sends() -> None:
    node = watcher(last_step=0)
    assert node.awaits() == (msg.AGENT_STATE, msg.PLANE_STATE)
    assert node.missing() == (0, ("agent 1", "agent 2", "agent 3", "agent 4"))
    feed(node, robots())
    assert node.missing() == (0, ("plane_sim",))
    with pytest.raises(StepAheadError):
        node.handle(plane(1))
    assert len(feed(node, [plane()])) == 2
    assert node.awaits() == ()
    early = watcher()
    early.handle(plane())
    with pytest.raises(ConflictError):
        early.handle(plane()._replace(angle=0.2))
    assert len(feed(early, robots())) == 2
    assert feed(early, [plane()]) == []


@pytest.mark.parametrize("planned", [False, True])
def test_end_of_a_robot_is_announced_before_the_plane_answers(*, planned: bool) -> None:
    """The plane waits for that robot, and would wait for ever if the observer waited for the plane first."""
    node = watcher(*[Change(0, 3, ChangeKind.KILL)] * planned)
    feed(node, [*robots(), plane()])
    answers = feed(node, robots(1, without=(3,)))
    if not planned:
        assert answers == []
        answers = list(node.drop(node.missing_agents(), "silent"))
    assert [answer[1:4] for answer in answers] == [(1, 3, msg.EventKind.DEAD)]
    abstract, _ = sums(node, [plane(1)])
    assert abstract.agent_count == 4


def test_packed_states_follow_what_is_announced_and_precede_the_sums() -> None:
    config = ObserverConfig(PERIOD_NS, members=MEMBERS, schedule=(Change(0, 2, ChangeKind.KILL),))
    node = PackedObserver(config)
    states = robots(0)
    packed, *sums = feed(node, states[::-1])
    assert packed == msg.SwarmStates(0, 0, b"".join(map(encode, states)))
    assert sums == feed(Observer(config), states)
    states = robots(1, without=(2,))
    event, packed, *_ = feed(node, states)
    assert isinstance(event, msg.SwarmEvent)
    assert packed == msg.SwarmStates(PERIOD_NS, 1, b"".join(map(encode, states)))
