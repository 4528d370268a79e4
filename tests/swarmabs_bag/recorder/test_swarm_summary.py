"""What people see of the robots while a run goes on, and that a report of it is short."""

from __future__ import annotations

import json

import pytest
from tests.swarmabs_bag.sample_run import AGENTS, make_step

from swarmabs_bag.recorder.swarm_summary import (
    EVENT_CHARACTERS,
    SummaryTracker,
    SwarmSummary,
    describe_event,
)
from swarmabs_bag.recording import RecordedStep
from swarmabs_bag.swarm_state import SILENT_STEPS
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.cdr import encode
from swarmabs_core.messages import EVENTS, AgentState, EventKind, Message, Status, SwarmEvent
from swarmabs_core.record import Record
from swarmabs_run.simulation import simulated_steps
from swarmabs_run.vector_simulation import vectorisable


def recorded(step: int, messages: list[Message]) -> RecordedStep:
    return RecordedStep(step, tuple(map(Record.of, messages)))


def robots(step: int, states: dict[int, tuple[Status, float]]) -> RecordedStep:
    messages: list[Message] = []
    for message in make_step(step, tuple(states)):
        if isinstance(message, AgentState):
            status, position = states[message.agent_id]
            messages.append(message._replace(status=status, position=position))
        else:
            messages.append(message)
    return recorded(step, messages)


def test_statuses_and_places() -> None:
    tracker = SummaryTracker(AGENTS, length=2.0)
    assert tracker.summary() is None
    states = {1: (Status.ACTIVE, 0.5), 2: (Status.SAFE_STOP, -1.0), 7: (Status.LEFT, 0.0004)}
    tracker.take(robots(0, states))
    assert tracker.summary() == SwarmSummary({"A": 1, "L": 1, "S": 1}, "ASL", [500, -1000, 0], [])


def test_a_robot_that_falls_silent_stays_where_it_was_seen() -> None:
    tracker = SummaryTracker((1, 2), length=1.0)
    tracker.take(robots(0, {1: (Status.ACTIVE, 0.25), 2: (Status.ACTIVE, -0.25)}))
    tracker.summary()
    tracker.take(robots(SILENT_STEPS, {1: (Status.ACTIVE, 0.1)}))
    assert tracker.summary() == SwarmSummary({"A": 2}, "AA", [200, -500], [])
    tracker.take(robots(SILENT_STEPS + 1, {1: (Status.ACTIVE, 0.1)}))
    assert tracker.summary() == SwarmSummary({"-": 1, "A": 1}, "A-", [200, -500], [])


def test_in_real_time_messages_come_one_by_one() -> None:
    tracker = SummaryTracker((1, 2, 3), length=2.0)
    assert tracker.summary() is None
    said = {state.agent_id: state for state in make_step(0, (1, 2, 3)) if isinstance(state, AgentState)}
    tracker.hear(said[1]._replace(position=0.5))
    tracker.hear(said[2]._replace(position=-0.5, status=Status.LEFT))
    assert tracker.summary() == SwarmSummary({"?": 1, "A": 1, "L": 1}, "AL?", [500, 0, 0], [])
    tracker.hear(SwarmEvent(0, 7, 1, EventKind.HELD, 0.0, ""))
    tracker.hear(said[3]._replace(step=SILENT_STEPS + 1, position=1.0))
    seen = tracker.summary()
    assert seen == SwarmSummary({"-": 1, "A": 1, "L": 1}, "-LA", [500, 0, 1000], ["step 7: robot 1 held"])


def ended(step: int, robot: int, kind: EventKind) -> SwarmEvent:
    return SwarmEvent(0, step, robot, kind, 0.25, "kill")


def test_who_is_dead_or_has_left_is_called_so_and_who_waits_to_join_is_not_silent() -> None:
    tracker = SummaryTracker((1, 2, 3, 4), length=1.0)
    there = (Status.ACTIVE, 0.1)
    tracker.take(robots(0, {1: there, 2: there, 3: there}))
    assert tracker.summary() == SwarmSummary({"?": 1, "A": 3}, "AAA?", [200, 200, 200, 0], [])
    told = [ended(1, 1, EventKind.DEAD), ended(1, 2, EventKind.LEFT)]
    later = robots(1, {3: there})
    tracker.take(recorded(1, [*(record.message for record in later.records if record.message is not None), *told]))
    seen = tracker.summary()
    assert seen is not None
    assert (seen.counts, seen.statuses, seen.places) == ({"?": 1, "A": 1, "D": 1, "L": 1}, "DLA?", [500, 0, 200, 0])
    assert seen.events == ["step 1: robot 1 dead, 0.25: kill", "step 1: robot 2 left, 0.25: kill"]


def test_in_real_time_a_dead_robot_may_come_back() -> None:
    tracker = SummaryTracker((1, 2), length=1.0)
    said = {state.agent_id: state for state in make_step(9, (1, 2)) if isinstance(state, AgentState)}
    for state in said.values():
        tracker.hear(state._replace(position=0.1))
    tracker.hear(ended(9, 1, EventKind.DEAD))
    seen = tracker.summary()
    assert seen is not None
    assert (seen.statuses, seen.places) == ("DA", [500, 200])
    tracker.hear(ended(9, 1, EventKind.JOINED))
    seen = tracker.summary()
    assert seen is not None
    assert (seen.statuses, seen.places) == ("AA", [200, 200])


@pytest.mark.parametrize(
    ("kind", "value", "detail", "text"),
    [
        (EventKind.STEERING, 0.05, "reference", "step 7: steering, 0.05: reference"),
        (EventKind.STEERING, 0.0, "disturbance", "step 7: steering, 0: disturbance"),
        (EventKind.DEAD, 0.107341234, "kill", "step 7: dead, 0.10734: kill"),
        (EventKind.JOINED, 0.0, "", "step 7: joined"),
        (EventKind.LIMIT_HIT, float("nan"), "", "step 7: limit hit"),
    ],
)
def test_events_are_told_with_their_values(kind: EventKind, value: float, detail: str, text: str) -> None:
    assert describe_event(SwarmEvent(0, 7, 0, kind, value, detail)) == text


@pytest.mark.parametrize(("position", "place"), [(7.0, 1000), (-7.0, -1000), (float("inf"), 0), (float("nan"), 0)])
def test_places_beyond_the_plane(position: float, place: int) -> None:
    tracker = SummaryTracker((1,), length=1.0)
    tracker.take(robots(0, {1: (Status.ACTIVE, position)}))
    seen = tracker.summary()
    assert seen is not None and seen.places == [place]


def test_the_latest_events_are_kept_in_order() -> None:
    tracker = SummaryTracker((1,), length=1.0)
    for step in range(5):
        event = SwarmEvent(0, step, 1, EventKind.LIMIT_HIT, 0.0, "")
        tracker.take(recorded(step, [*make_step(step, (1,)), event]))
    seen = tracker.summary()
    assert seen is not None
    assert seen.events == [f"step {step}: robot 1 limit hit" for step in (2, 3, 4)]


@pytest.mark.parametrize("overrides", [(), ("swarm.actuator_lag=0.01",)])
def test_both_kinds_of_simulation_tell_the_events_that_they_store(overrides: tuple[str, ...]) -> None:
    changes = ["duration=0.5", "manifold.torque_max=0.05", *overrides]
    scenario = find_scenario("arise_het_4", changes).resolved()
    assert vectorisable(scenario) == (not overrides)
    steps = list(simulated_steps(scenario))
    told = [encode(event) for step in steps for event in step.events]
    assert told == [payload for step in steps for topic, _, payload in step.stored() if topic is EVENTS] != []


@pytest.mark.parametrize("detail", ["\x1b[31mred\nnext", "\U0001f41d" * 500, '"' * 500, "ü" * 500])
def test_a_report_is_short_whatever_robots_say(detail: str) -> None:
    """Longer lines would mix with those of other processes in the pipe."""
    event = SwarmEvent(0, 2**64 - 1, 65535, EventKind.REFUSED, 0.0, detail)
    text = describe_event(event)
    assert len(text) <= EVENT_CHARACTERS and text.isprintable()
    tracker = SummaryTracker(range(1, 201), length=1.0)
    states = dict.fromkeys(range(1, 201), (Status.SAFE_STOP, -0.5))
    for step in range(3):
        tracker.take(robots(step, states))
        tracker.take(RecordedStep(step, recorded(step, [event._replace(step=step)]).records))
    seen = tracker.summary()
    assert seen is not None and len(seen.places) == 200 and len(seen.events) == 3
    line = {"node": "recorder", "pid": 2**22, "event": "progress", "step": 2**63, "angle": -1 / 3, "error": 1e-300 / 3}
    assert len(json.dumps({**line, "robots": seen._asdict()})) < 4000
    assert SwarmSummary(**json.loads(json.dumps(seen._asdict()))) == seen


def test_very_many_robots_are_counted_only() -> None:
    tracker = SummaryTracker(range(1, 1001), length=1.0)
    tracker.take(robots(0, dict.fromkeys(range(1, 901), (Status.ACTIVE, 0.0))))
    assert tracker.summary() == SwarmSummary({"?": 100, "A": 900}, "", [], [])
