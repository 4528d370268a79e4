"""The adapter of the observer."""

from __future__ import annotations

import pytest
from tests.swarmabs_core.helpers import agent_state
from tests.swarmabs_ros.nodes import settings_from

from abstraction_observer.node import PARAMETERS, make
from swarmabs_config.graph import LOCKSTEP, OBSERVER
from swarmabs_core.behaviours import Observer, ObserverConfig
from swarmabs_core.membership import Change, ChangeKind
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    AUXILIARY_STATE,
    EVENTS,
    PLANE_STATE,
    EventKind,
    SwarmEvent,
)
from swarmabs_core.plant import Friction
from swarmabs_ros.status import StatusChannel

CHANNEL = StatusChannel("abstraction_observer")


def test_every_parameter_reaches_the_configuration() -> None:
    settings = settings_from(
        PARAMETERS,
        period_ns=5_000_000,
        last_step=77,
        members=(2, 9),
        schedule=("join 9 5",),
        gravity=1.62,
        ksd=0.3,
    )
    schedule = (Change(5, 9, ChangeKind.JOIN),)
    assert settings.made(ObserverConfig) == ObserverConfig((2, 9), 5_000_000, 1.62, 0.3, schedule, 77)


def test_it_hears_robots_and_sums_them_up() -> None:
    settings = settings_from(PARAMETERS)
    assert isinstance(make(settings, CHANNEL).behaviour, Observer)
    ends = settings.endpoints(OBSERVER, LOCKSTEP)
    assert set(ends.publications) == {ABSTRACT_STATE, AUXILIARY_STATE, EVENTS}
    assert set(ends.subscriptions) == {AGENT_STATE}


def test_it_watches_the_plane_if_that_is_wanted() -> None:
    friction = (0.02, 900.0, 600.0, 0.03, 800.0, 1.5)
    given = settings_from(PARAMETERS, type="parent_response", inertia=0.7, friction=friction, bandwidth=12.0)
    config = given.made(ObserverConfig)
    assert config.watches_plane
    assert (config.inertia, config.friction, config.bandwidth) == (0.7, Friction(*friction), 12.0)
    assert not settings_from(PARAMETERS).made(ObserverConfig).watches_plane
    spec = make(given, CHANNEL)
    assert spec.behaviour.awaits() == (AGENT_STATE, PLANE_STATE)
    assert set(given.endpoints(OBSERVER, LOCKSTEP).subscriptions) == {AGENT_STATE, PLANE_STATE}


def test_silent_robots_are_dropped_only_if_that_is_wanted() -> None:
    assert make(settings_from(PARAMETERS), CHANNEL).on_stall is None
    spec = make(settings_from(PARAMETERS, members=(1, 2, 3), on_stall="drop"), CHANNEL)
    assert spec.on_stall is not None
    for agent_id in (1, 2, 3):
        spec.behaviour.handle(agent_state(agent_id))
    for agent_id in (1, 2):
        spec.behaviour.handle(agent_state(agent_id, 1))
    messages = spec.on_stall()
    events = [message for message in messages if isinstance(message, SwarmEvent)]
    assert [(event.agent_id, event.kind, event.step) for event in events] == [(3, EventKind.DEAD, 1)]
    assert len(messages) == 3


@pytest.mark.parametrize("count", [4, 200])
def test_a_large_swarm_has_room_to_wait_in(count: int) -> None:
    settings = settings_from(PARAMETERS, members=tuple(range(1, count + 1)))
    assert settings.endpoints(OBSERVER, LOCKSTEP).subscriptions[AGENT_STATE].depth >= 2 * count
