from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import pytest
from tests.swarmabs_core.helpers import PERIOD_NS, agent_state

from swarmabs_core.behaviours import Observer, ObserverConfig
from swarmabs_core.behaviours.base import ConflictError, StepAheadError, UnexpectedMessageError
from swarmabs_core.membership import Change, ChangeKind
from swarmabs_core.messages import (
    AGENT_STATE,
    PLANE_STATE,
    AbstractState,
    AuxiliaryState,
    EventKind,
    Message,
    PlaneState,
    SwarmEvent,
)
from swarmabs_core.parent_response import TorqueEstimator
from swarmabs_core.plant import Friction

MODEL = (0.5, Friction(0.01, 30.0, 20.0, 0.02, 30.0, 1.0), 50.0)


def observer(*schedule: Change, last_step: int | None = None) -> Observer:
    return Observer(watching(ObserverConfig((1, 2, 3), PERIOD_NS, 9.81, 1.0, schedule, last_step)))


def watching(config: ObserverConfig) -> ObserverConfig:
    """Return the configuration of an observer that watches the plane."""
    inertia, friction, bandwidth = MODEL
    return replace(config, type="parent_response", inertia=inertia, friction=friction, bandwidth=bandwidth)


def plane(step: int = 0) -> PlaneState:
    return PlaneState(step * PERIOD_NS, step, 0.1 - 0.01 * step, -1.0 * step)


def feed(node: Observer, *messages: Message) -> list[Message]:
    return [answer for message in messages for answer in node.handle(message)]


def robots(step: int = 0) -> tuple[Message, ...]:
    return tuple(agent_state(agent_id, step) for agent_id in (1, 2, 3))


def test_the_plane_is_heard_if_there_is_a_model_of_it() -> None:
    config = ObserverConfig((1, 2, 3), PERIOD_NS, 9.81, 1.0)
    assert Observer(watching(config)).handle(plane(0)) == ()
    with pytest.raises(UnexpectedMessageError, match="observer: a PlaneState was delivered"):
        Observer(config).handle(plane(0))


def test_torque_is_the_estimators_and_the_rest_the_robots() -> None:
    node, summing, estimator = observer(), Observer(ObserverConfig((1, 2, 3), PERIOD_NS, 9.81, 1.0)), None
    estimator = TorqueEstimator(*MODEL, PERIOD_NS / 1e9)
    for step in range(4):
        abstract, auxiliary = feed(node, *robots(step), plane(step))
        summed, same = feed(summing, *robots(step))
        assert isinstance(abstract, AbstractState)
        assert isinstance(summed, AbstractState)
        torque, rate = estimator.update(plane(step).angle, plane(step).angular_velocity, summed.inertia)
        assert abstract == summed._replace(torque=torque, torque_rate=rate)
        assert auxiliary == same
    assert torque != pytest.approx(summed.torque, rel=0.1)


def test_any_order_of_arrival_gives_the_same() -> None:
    expected = feed(observer(), *robots(), plane())
    assert [type(answer) for answer in expected] == [AbstractState, AuxiliaryState]
    for order in permutations([*robots(), plane(), plane(), agent_state(2)]):
        assert feed(observer(), *order) == expected


def test_waits_for_the_plane_too_and_says_so() -> None:
    node = observer(last_step=0)
    assert node.awaits() == (AGENT_STATE, PLANE_STATE)
    assert node.missing() == (0, ("agent 1", "agent 2", "agent 3"))
    feed(node, *robots())
    assert node.missing() == (0, ("plane_sim",))
    feed(node, plane())
    assert node.awaits() == ()


def test_what_no_correct_plane_sends() -> None:
    node = observer()
    with pytest.raises(StepAheadError):
        node.handle(plane(1))
    node.handle(plane())
    with pytest.raises(ConflictError):
        node.handle(plane()._replace(angle=0.2))
    assert len(feed(node, *robots())) == 2
    assert feed(node, plane()) == []


def test_silent_robot_is_announced_before_the_plane_answers() -> None:
    """The plane waits for that robot, and would wait for ever if the observer waited for the plane first."""
    node = observer()
    feed(node, *robots(), plane())
    feed(node, agent_state(1, 1), agent_state(2, 1))
    (event,) = node.drop(node.missing_agents(), "silent")
    assert isinstance(event, SwarmEvent)
    assert (event.agent_id, event.kind, event.step) == (3, EventKind.DEAD, 1)
    assert [type(answer) for answer in feed(node, plane(1))] == [AbstractState, AuxiliaryState]


def test_planned_change_is_announced_once() -> None:
    node = observer(Change(1, 3, ChangeKind.KILL))
    feed(node, *robots(), plane(), *robots(1), plane(1))
    (event,) = feed(node, agent_state(1, 2), agent_state(2, 2))
    assert isinstance(event, SwarmEvent)
    assert (event.agent_id, event.kind, event.step) == (3, EventKind.DEAD, 2)
    abstract, _ = feed(node, plane(2))
    assert isinstance(abstract, AbstractState)
    assert abstract.agent_count == 3
