from __future__ import annotations

import hashlib
import struct
from functools import cache
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from tests.swarmabs_core.helpers import Run, agent_state, builtin, digest

from swarmabs_bag.figures import RunFigures
from swarmabs_bag.recording import RecordedStep, RunCollector
from swarmabs_config import configure
from swarmabs_core.behaviours.base import ConflictError, NegativeTimeError, UnknownAgentError
from swarmabs_core.cdr import encode
from swarmabs_core.membership import Change, ChangeKind
from swarmabs_core.messages import (
    AbstractState,
    AgentState,
    AuxiliaryState,
    DesiredAbstractState,
    EventKind,
    Message,
    PlaneState,
    Status,
    SwarmEvent,
)
from swarmabs_core.record import Record

TOPIC_NAMES = {
    PlaneState: "plane/state",
    AgentState: "swarm/agent_state",
    AbstractState: "swarm/abstract_state",
    AuxiliaryState: "swarm/auxiliary_state",
    DesiredAbstractState: "swarm/desired_abstract_state",
}


@cache
def short_run() -> Run:
    """Six steps with a robot that leaves, one that joins and one that is killed."""
    faults = (
        "faults=[{at: 0.02, kind: leave, agent: 1}, {at: 0.03, kind: join, agent: 2}, {at: 0.04, kind: kill, agent: 3}]"
    )
    return Run(builtin("pd_di_4", "duration=0.06", faults))


def collector(run: Run, **settings: int) -> RunCollector:
    schedule = (
        Change(2, 1, ChangeKind.LEAVE),
        Change(3, 2, ChangeKind.JOIN),
        Change(4, 3, ChangeKind.KILL),
    )
    return RunCollector((1, 2, 3, 4), schedule, len(run.steps) - 1, **settings)


def messages(run: Run) -> list[Message]:
    """Return all messages by step, the events of a step first."""
    found = [record.message for step in run.steps for record in step.records]
    return sorted(found, key=lambda message: (message.step, not isinstance(message, SwarmEvent)))


def test_run_in_order_is_itself() -> None:
    run = short_run()
    book = collector(run)
    assert [step for message in messages(run) for step in book.add(Record.of(message))] == run.steps
    assert book.finished


@settings(max_examples=60)
@given(st.randoms(use_true_random=False), st.integers(1, 3))
def test_any_order_and_any_repeats_give_the_same_steps(random: Random, copies: int) -> None:
    run, book = short_run(), collector(short_run())
    arriving = [message for message in messages(run) if not isinstance(message, SwarmEvent)] * copies
    random.shuffle(arriving)
    # Events come first here: an event of a step that is complete already is recorded by itself.
    found = [step for message in [*run.events(), *arriving] for step in book.add(Record.of(message))]
    assert found == run.steps
    assert book.finished
    assert book.missing() == ()


def test_missing_names_robots_and_topics() -> None:
    run = short_run()
    book = collector(run)
    first = messages(run)[:7]
    for message in first[1:4]:
        assert book.add(Record.of(message)) == []
    assert book.step == 0
    assert book.missing_agents() == (1,)
    assert book.missing() == (
        "agent 1",
        "swarm/abstract_state",
        "swarm/auxiliary_state",
        "swarm/desired_abstract_state",
    )


def test_conflicting_repeat_is_refused() -> None:
    run = short_run()
    book = collector(run)
    for message in messages(run):
        book.add(Record.of(message))
    for message in (run.states(5)[0], run.one(PlaneState, 5)):
        assert book.add(Record.of(message)) == []
    with pytest.raises(ConflictError, match=r"swarm/agent_state of agent 2: two different messages of step 5"):
        book.add(Record.of(run.states(5)[0]._replace(position=0.2)))
    with pytest.raises(ConflictError, match=r"plane/state: two different messages of step 5"):
        book.add(Record.of(run.one(PlaneState, 5)._replace(angle=0.2)))


def test_repeats_beyond_the_memory_are_not_compared() -> None:
    run = short_run()
    book = collector(run, memory=2)
    for message in messages(run):
        book.add(Record.of(message))
    assert book.step == 7
    assert book.add(Record.of(run.one(PlaneState, 4)._replace(angle=0.2))) == []
    with pytest.raises(ConflictError):
        book.add(Record.of(run.one(PlaneState, 5)._replace(angle=0.2)))


def test_strangers_are_refused() -> None:
    run = short_run()
    with pytest.raises(NegativeTimeError, match=r"plane/state: .* step 0 has a time stamp of -1 ns"):
        collector(run).add(Record.of(run.one(PlaneState, 0)._replace(stamp=-1)))
    with pytest.raises(UnknownAgentError, match="robot 9 is not a member"):
        collector(short_run()).add(Record.of(agent_state(9)))


def test_states_of_robots_that_are_out_are_not_recorded() -> None:
    run = short_run()
    book = collector(run)
    assert book.add(Record.of(agent_state(2, 0))) == []  # joins at step 3
    assert book.add(Record.of(agent_state(1, 3))) == []  # has left at step 2
    found = [step for message in messages(run) for step in book.add(Record.of(message))]
    assert found == run.steps


def test_late_event_is_recorded_once() -> None:
    run = short_run()
    book = collector(run)
    for message in messages(run)[:40]:
        book.add(Record.of(message))
    assert book.step > 2
    event = SwarmEvent(10_000_000, 1, 0, EventKind.LIMIT_HIT, 7.0, "late")
    (late,) = book.add(Record.of(event))
    assert (late.step, [record.message for record in late.records]) == (1, [event])
    assert book.add(Record.of(event)) == []


def test_several_events_of_a_step_are_all_kept() -> None:
    run = short_run()
    book = collector(run)
    added = [SwarmEvent(0, 0, 4, EventKind.LIMIT_HIT, value, "") for value in (2.0, 1.0, 2.0)]
    first = [message for message in messages(run) if message.step == 0]
    (step,) = [found for message in [*added, *first] for found in book.add(Record.of(message))]
    kept = [record.message for record in step.records if isinstance(record.message, SwarmEvent)]
    assert sorted(kept, key=lambda event: event.value) == [added[1], added[0]]


def test_observers_word_ends_the_wait_for_a_robot() -> None:
    book = RunCollector((1, 2), (), 5)
    run = Run(builtin("pd_si_4", "duration=0.01"))
    coordinators = [r.message for r in run.steps[0].records if not isinstance(r.message, AgentState)]
    for message in (agent_state(1), *coordinators):
        assert book.add(Record.of(message)) == []
    dead = SwarmEvent(0, 0, 2, EventKind.DEAD, 0.0, "no answer")
    (step,) = book.add(Record.of(dead))
    assert [record.agent_id for record in step.records] == [1, 0, 0, 0, 0, 2]
    assert book.missing_agents() == (1,)


def test_unplanned_leave_ends_the_wait_for_a_robot() -> None:
    book = RunCollector((1, 2), (), 5)
    run = Run(builtin("pd_si_4", "duration=0.01"))
    coordinators = [r.message for r in run.steps[0].records if not isinstance(r.message, AgentState)]
    for message in (agent_state(1), agent_state(2, status=Status.LEFT), *coordinators):
        book.add(Record.of(message))
    assert (book.step, book.missing_agents()) == (1, (1,))


def test_steps_after_the_last_are_ignored() -> None:
    book = RunCollector((1, 2), (), 5)
    assert book.add(Record.of(agent_state(1, 6))) == []


def test_digest_against_its_definition() -> None:
    """SHA-256 over topic, 0x00, uint32 length, payload, sorted by (step, topic, robot), events left out."""
    run = short_run()
    records = []
    for message in messages(run):
        if isinstance(message, SwarmEvent):
            continue
        robot = message.agent_id if isinstance(message, AgentState) else 0
        records.append((message.step, TOPIC_NAMES[type(message)], robot, encode(message)))
    text = b"".join(
        name.encode() + b"\x00" + struct.pack("<I", len(payload)) + payload for _, name, _, payload in sorted(records)
    )
    assert run.digest() == hashlib.sha256(text).hexdigest()


def test_digest_does_not_depend_on_events_that_come_late() -> None:
    run = short_run()
    late = RecordedStep(3, tuple(r for r in run.steps[3].records if isinstance(r.message, SwarmEvent)))
    assert late.records
    assert digest([*run.steps, late]) == digest(run.steps)


def test_metrics_against_numpy() -> None:
    scenario = builtin("arise_het_4", "duration=6")
    run, law = Run(scenario), configure.parent_controller(scenario)
    metrics = RunFigures(law.reference)
    for step in run.steps:
        metrics.add(step)

    time = 0.01 * np.arange(601)
    error = 0.7 * np.sin(0.0471238898038469 * time) - run.column(PlaneState, "angle")
    unsettled = np.flatnonzero(np.abs(error) >= 0.01)
    summary = metrics.figures()
    assert summary["settled_at"] == pytest.approx(time[unsettled[-1] + 1])
    assert summary["final_error"] == pytest.approx(error[-1], rel=1e-9)
    assert summary["rms_error"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-12)
    assert summary["max_abs_position"] == np.abs(run.column(AgentState, "position")).max()
    assert summary["messages"] == sum(len(step.records) for step in run.steps)
    assert metrics.latest is not None
    assert metrics.latest == (600, run.of(PlaneState)[-1].angle, summary["final_error"])


@pytest.mark.parametrize(
    ("angles", "settled_at"),
    [
        ([0.0, 0.0, 0.0], 0.0),
        ([0.1, 0.009, 0.0], 0.01),
        ([0.1, 0.0, 0.1, -0.009, 0.0], 0.03),
        ([0.1, 0.0, 0.01], None),
        ([0.1, 0.0, float("nan")], None),
    ],
)
def test_settled_is_the_first_time_after_which_the_error_stays_small(
    angles: list[float], settled_at: float | None
) -> None:
    metrics = RunFigures(lambda _: 0.0)
    template = short_run().steps[0].records[-1]
    for step, angle in enumerate(angles):
        record = template._replace(message=PlaneState(step * 10_000_000, step, angle, 0.0))
        metrics.add(RecordedStep(step, (record,)))
    assert metrics.figures()["settled_at"] == settled_at


def test_figures_that_are_not_finite_are_null() -> None:
    metrics = RunFigures(lambda _: 0.0)
    template = short_run().steps[0].records[-1]
    metrics.add(RecordedStep(0, (template._replace(message=PlaneState(0, 0, float("nan"), 0.0)),)))
    assert metrics.figures() == {
        "settled_at": None,
        "final_error": None,
        "rms_error": None,
        "max_abs_position": None,
        "messages": 1,
    }


def test_metrics_of_nothing_are_null() -> None:
    assert RunFigures(lambda _: 0.0).figures() == {
        "settled_at": None,
        "final_error": None,
        "rms_error": None,
        "max_abs_position": None,
        "messages": 0,
    }
