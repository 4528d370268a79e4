"""The graph against the contract, node by node, written down a second time."""

from __future__ import annotations

import importlib

import pytest

from swarmabs_config.graph import (
    CONTROLLER,
    GRAPH,
    LOCKSTEP,
    NODES,
    OBSERVER,
    PLANE,
    PLANE_DRIVER,
    REALTIME,
    RECORDER,
    ROBOT,
    SERVICES,
    Driver,
    Option,
    endpoints,
    options_of,
    requested,
)
from swarmabs_core.messages import AGENT_STATE, BROADCASTS, EVENTS, MAIN_TOPICS, PLANE_STATE, TOPICS
from swarmabs_core.steering import STEERER

PACKED, STEERED, CREDITED, WATCHING, FEELING = Option
STATE, ABSTRACT, AUXILIARY, DESIRED = (
    *("swarm/agent_state", "swarm/abstract_state"),
    *("swarm/auxiliary_state", "swarm/desired_abstract_state"),
)
MAIN = {"plane/state", STATE, ABSTRACT, AUXILIARY, DESIRED}
CASES: list[tuple[str, Driver, set[Option], set[str], set[str]]] = [
    (PLANE, LOCKSTEP, set(), {"plane/state", "swarm/events"}, {STATE, "swarm/events"}),
    (PLANE, LOCKSTEP, {STEERED}, {"plane/state", "swarm/events"}, {STATE, "swarm/events", "swarm/steering"}),
    (OBSERVER, LOCKSTEP, set(), {ABSTRACT, AUXILIARY, "swarm/events"}, {STATE}),
    (OBSERVER, LOCKSTEP, {WATCHING}, {ABSTRACT, AUXILIARY, "swarm/events"}, {STATE, "plane/state"}),
    (CONTROLLER, LOCKSTEP, set(), {DESIRED, "swarm/events"}, {"plane/state"}),
    (CONTROLLER, LOCKSTEP, {CREDITED}, {DESIRED, "swarm/events"}, {"plane/state", "recording/progress"}),
    (
        CONTROLLER,
        LOCKSTEP,
        {PACKED, STEERED},
        {DESIRED, "swarm/events", "swarm/broadcast"},
        {"plane/state", ABSTRACT, AUXILIARY, "swarm/steering"},
    ),
    (RECORDER, LOCKSTEP, set(), {"recording/progress"}, {*MAIN, "swarm/events"}),
    (RECORDER, LOCKSTEP, {STEERED}, {"recording/progress"}, {*MAIN, "swarm/events", "swarm/steering"}),
    (STEERER, LOCKSTEP, set(), {"swarm/steering"}, {"plane/state", "swarm/events"}),
    (ROBOT, LOCKSTEP, set(), {STATE, "swarm/events"}, {ABSTRACT, AUXILIARY, DESIRED}),
    (ROBOT, LOCKSTEP, {FEELING}, {STATE, "swarm/events"}, {ABSTRACT, AUXILIARY, DESIRED, "plane/state"}),
    (ROBOT, LOCKSTEP, {PACKED, STEERED}, {STATE, "swarm/events"}, {"swarm/broadcast", "swarm/steering"}),
    (PLANE, REALTIME, set(), {"plane/state", "swarm/events", "recording/basis"}, {STATE}),
    (PLANE_DRIVER, REALTIME, set(), {"plane/state", "swarm/events"}, set()),
    (OBSERVER, REALTIME, set(), {ABSTRACT, AUXILIARY, "swarm/events", "recording/basis"}, {STATE, "swarm/events"}),
    (CONTROLLER, REALTIME, set(), {DESIRED, "swarm/events", "recording/basis"}, {"plane/state", ABSTRACT}),
    (RECORDER, REALTIME, set(), set(), {*MAIN, "swarm/events", "recording/basis"}),
    (ROBOT, REALTIME, set(), {STATE, "swarm/events"}, {ABSTRACT, AUXILIARY, DESIRED}),
]


@pytest.mark.parametrize(("node", "driver", "options", "published", "heard"), CASES)
def test_endpoints_are_those_of_the_contract(
    node: str, driver: Driver, options: set[Option], published: set[str], heard: set[str]
) -> None:
    ends = endpoints(node, driver, frozenset(options))
    assert {topic.name for topic in ends.publications} == published
    assert {topic.name for topic in ends.subscriptions} == heard


def test_every_topic_is_there_once_in_the_order_of_the_messages() -> None:
    assert tuple(link.topic for link in GRAPH) == TOPICS


@pytest.mark.parametrize("node", [*NODES])
def test_every_node_that_an_end_names_can_be_started(node: str) -> None:
    for module in NODES[node].modules.values():
        assert callable(importlib.import_module(module).main)
    assert any(node in {end.node for end in (*link.readers, *link.writers)} for link in GRAPH)


def test_every_end_names_a_node() -> None:
    named = {end.node for link in GRAPH for end in (*link.writers, *link.readers)}
    assert named | {*SERVICES} <= {*NODES}


def test_all_options_can_be_asked_for_by_parameters() -> None:
    given = {"packed": True, "steered": True, "recording_window": 100}
    given |= {"type": "parent_response", "feels_gravity": True, "kind": "double_integrator"}
    assert options_of(given) == {*Option}
    assert options_of({**given, "kind": "single_integrator"}) == {*Option} - {FEELING}
    assert options_of({"packed": False, "recording_window": 0, "type": "sum"}) == frozenset()


def test_robots_never_hear_each_other() -> None:
    for driver in Driver:
        assert AGENT_STATE not in endpoints(ROBOT, driver, frozenset(Option)).subscriptions


@pytest.mark.parametrize("robots", [4, 100, 200, 2000])
def test_there_is_room_for_what_comes_from_all_robots(robots: int) -> None:
    for node in (PLANE, OBSERVER):
        assert endpoints(node, LOCKSTEP, robots=robots).subscriptions[AGENT_STATE].depth >= 2 * robots
    waiting = endpoints(RECORDER, LOCKSTEP, robots=robots).subscriptions
    assert 5 * robots <= waiting[AGENT_STATE].depth <= 100_000, "what a profile allows to wait"
    assert all(waiting[topic].depth >= 101 for topic in (*BROADCASTS, PLANE_STATE)), "more than is under way"


def test_a_lost_event_would_stall_who_waits_for_it() -> None:
    hearing = {
        (node, driver.value): endpoints(node, driver).subscriptions[EVENTS].reliability
        for driver in Driver
        for node in NODES
        if EVENTS in endpoints(node, driver).subscriptions
    }
    assert set(hearing.values()) == {"reliable"}
    assert ("plane_sim", "lockstep") in hearing
    assert ("abstraction_observer", "realtime") in hearing


def test_nobody_asks_for_more_than_is_offered() -> None:
    assert requested(AGENT_STATE, depth=5, reliable=True).reliability == "best_effort"
    assert [requested(topic, depth=5).reliability for topic in MAIN_TOPICS] == ["best_effort"] * 5
