from contextlib import suppress
from functools import cache
from math import inf, isfinite, nan
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from tests.swarmabs_core.helpers import Run, agent_state, builtin, digest, singly

from swarmabs_bag.run.figures import RealtimeFigures, RunFigures
from swarmabs_bag.run.gatherer import RunCollector, UnplannedChangeError
from swarmabs_bag.run.realtime_gatherer import (
    MEMORY,
    QUIET_STEPS,
    SECOND_WRITER,
    TWO_MESSAGES,
    Dispute,
    RealtimeCollector,
    disputed,
)
from swarmabs_bag.run.step import Step
from swarmabs_config import configure
from swarmabs_config.graph import STANDBY_TOPICS, own_topic
from swarmabs_core import messages as msg
from swarmabs_core.behaviours.base import ConflictError, NegativeTimeError, UnknownAgentError
from swarmabs_core.cdr import encode
from swarmabs_core.events import EventCode
from swarmabs_core.membership import Change, ChangeKind
from swarmabs_core.realtime.base import Health, Level, Realtime, Schedule
from swarmabs_core.realtime.validation import Bounds
from swarmabs_core.record import Record


@cache
def short_run() -> Run:
    """Six steps with a robot that leaves, one that joins and one that is killed."""
    faults = (
        "faults=[{at: 0.02, kind: leave, agent: 1}, {at: 0.03, kind: join, agent: 2}, {at: 0.04, kind: kill, agent: 3}]"
    )
    return Run(builtin("pd_di_4", "duration=0.06", faults))


def collector(run: Run, **settings: int) -> RunCollector:
    schedule = (Change(2, 1, ChangeKind.LEAVE), Change(3, 2, ChangeKind.JOIN), Change(4, 3, ChangeKind.KILL))
    return RunCollector((1, 2, 3, 4), schedule, len(run.steps) - 1, division=200, **settings)


def messages(run: Run) -> list[msg.Message]:
    """Return all messages by step, the events of a step first."""
    found = [record.message for step in run.steps for record in step.records]
    return sorted(found, key=lambda message: (message.step, not isinstance(message, msg.SwarmEvent)))


@settings(max_examples=60)
@given(st.randoms(use_true_random=False), st.integers(1, 3))
def test_any_order_and_any_repeats_give_the_same_steps(random: Random, copies: int) -> None:
    run, book = short_run(), collector(short_run())
    arriving = [message for message in messages(run) if not isinstance(message, msg.SwarmEvent)] * copies
    random.shuffle(arriving)
    # Events come first here: an event of a step that is complete already is recorded by itself.
    complete = [steps for message in [*run.events(), *arriving] for steps in book.add(Record.of(message))]
    assert singly(complete) == run.steps
    assert book.finished
    assert book.missing() == ()


def test_missing_names_robots_and_topics_and_strangers_are_refused() -> None:
    run = short_run()
    book = collector(run)
    for message in messages(run)[1:4]:
        assert book.add(Record.of(message)) == []
    assert (book.step, book.missing_agents()) == (0, (1,))
    missing = ("swarm/abstract_state", "swarm/auxiliary_state", "swarm/desired_abstract_state")
    assert book.missing() == ("agent 1", *missing)
    with pytest.raises(NegativeTimeError, match=r"plane/state: .* step 0 has a time stamp of -1 ns"):
        collector(run).add(Record.of(run.one(msg.PlaneState, 0)._replace(stamp=-1)))
    with pytest.raises(UnknownAgentError, match="robot 9 is not a member"):
        collector(run).add(Record.of(agent_state(9)))


def test_conflicting_repeat_is_refused() -> None:
    run = short_run()
    book, forgetful = collector(run), collector(run, memory=2)
    for message in messages(run):
        book.add(Record.of(message))
        forgetful.add(Record.of(message))
    for message in (run.states(5)[0], run.one(msg.PlaneState, 5)):
        assert book.add(Record.of(message)) == []
    plane = run.one(msg.PlaneState, 5)._replace(angle=0.2)
    with pytest.raises(ConflictError, match=r"swarm/agent_state of agent 2: two different messages of step 5"):
        book.add(Record.of(run.states(5)[0]._replace(position=0.2)))
    with pytest.raises(ConflictError, match=r"plane/state: two different messages of step 5"):
        book.add(Record.of(plane))
    assert forgetful.step == 7
    assert forgetful.add(Record.of(run.one(msg.PlaneState, 4)._replace(angle=0.2))) == []
    with pytest.raises(ConflictError):
        forgetful.add(Record.of(plane))


def test_states_of_robots_that_are_out_are_not_recorded_and_late_events_once() -> None:
    run = short_run()
    book, event = collector(run), msg.SwarmEvent(10_000_000, 1, 0, msg.EventKind.LIMIT_HIT, 7.0, "late")
    assert book.add(Record.of(agent_state(2, 0))) == []  # joins at step 3
    assert book.add(Record.of(agent_state(1, 3))) == []  # has left at step 2
    found = [step for message in messages(run) for step in book.add(Record.of(message))]
    assert found == run.steps
    book = collector(run)
    for message in messages(run)[:40]:
        book.add(Record.of(message))
    assert book.step > 2
    (late,) = book.add(Record.of(event))
    assert (late.step, [record.message for record in late.records]) == (1, [event])
    assert [time for _, time, _ in late.stored()] == [event.stamp]
    assert book.add(Record.of(event)) == []
    late = Step.of(3, tuple(r for r in run.steps[3].records if isinstance(r.message, msg.SwarmEvent)))
    assert late.records and digest([*run.steps, late]) == digest(run.steps)


def test_several_events_of_a_step_are_all_kept() -> None:
    run = short_run()
    added = [msg.SwarmEvent(0, 0, 4, msg.EventKind.LIMIT_HIT, value, "") for value in (2.0, 1.0, 2.0)]
    first = [message for message in messages(run) if message.step == 0]
    for arriving in (added, added[::-1], added[1:]):
        book = collector(run)
        (step,) = [steps for message in [*arriving, *first] for steps in book.add(Record.of(message))]
        assert step.told == tuple(sorted({encode(event) for event in added})), "whatever the order of arrival"


def test_a_change_of_membership_at_another_step_than_planned_is_refused() -> None:
    run = short_run()
    kinds = {msg.EventKind.JOINED, msg.EventKind.LEFT, msg.EventKind.DEAD}
    changes = [event for event in run.events() if event.kind in kinds]
    assert {event.kind for event in changes} == kinds
    for event in changes:
        for later in (-1, 1):
            book = collector(run, drops=False)
            for message in messages(run):
                book.add(Record.of(message))
            wrong = event._replace(step=event.step + later)
            said = (
                f"robot {event.agent_id} is reported as .* from step {wrong.step} on, which nothing in this run causes"
            )
            with pytest.raises(UnplannedChangeError, match=said):
                book.add(Record.of(wrong))


def test_the_wait_for_a_robot_ends_when_it_leaves_or_the_observer_says_that_it_is_dead() -> None:
    run = Run(builtin("pd_si_4", "duration=0.01"))
    coordinators = [r.message for r in run.steps[0].records if not isinstance(r.message, msg.AgentState)]
    book = RunCollector((1, 2), (), 5)
    assert book.add(Record.of(agent_state(1, 6))) == [], "after the last step"
    for message in (agent_state(1), *coordinators):
        assert book.add(Record.of(message)) == []
    (step,) = book.add(Record.of(msg.SwarmEvent(0, 0, 2, msg.EventKind.DEAD, 0.0, "no answer")))
    assert [record.agent_id for record in step.records] == [1, 0, 0, 0, 0, 2]
    assert book.missing_agents() == (1,)
    book = RunCollector((1, 2), (), 5)
    for message in (agent_state(1), agent_state(2, status=msg.Status.LEFT), *coordinators):
        book.add(Record.of(message))
    assert (book.step, book.missing_agents()) == (1, (1,))


def test_events_in_a_batch_are_taken_one_after_the_other() -> None:
    """The first one completes a step, after which the other one is late."""
    run = Run(builtin("pd_si_4", "duration=0.01"))
    first = [agent_state(1), *(r.message for r in run.steps[0].records if not isinstance(r.message, msg.AgentState))]
    events = [msg.SwarmEvent(0, 0, robot, kind, 0.0, "") for robot, kind in ((2, msg.EventKind.DEAD), (1, 7))]
    single, batch = RunCollector((1, 2), (), 5), RunCollector((1, 2), (), 5)
    for message in first:
        assert single.add(Record.of(message)) == batch.add(Record.of(message)) == []
    expected = [step for event in events for step in single.add(Record.of(event))]
    assert list(batch.add_all(msg.EVENTS, [encode(event) for event in events])) == expected
    assert [step.events for step in expected] == [(events[0],), (events[1],)]


def test_a_requested_end_of_a_robot_is_none_that_nothing_causes() -> None:
    run = short_run()
    schedule = (Change(2, 1, ChangeKind.LEAVE), Change(3, 2, ChangeKind.JOIN))
    book = RunCollector((1, 2, 3, 4), schedule, len(run.steps) - 1, division=200, steered=True, drops=False)
    for step in range(len(run.steps)):
        kill = step == 5
        book.steer(msg.Steering(0, step, int(kill), msg.Action.KILL if kill else msg.Action.NONE, 3 * kill, 0.0))
    assert singly([step for message in messages(run) for step in book.add(Record.of(message))]) == run.steps


@pytest.mark.parametrize(
    ("action", "detail"), [(msg.Action.REFERENCE, "reference"), (msg.Action.DISTURBANCE, "disturbance")]
)
def test_a_setting_that_is_ordered_must_be_announced(action: msg.Action, detail: str) -> None:
    first = short_run().steps[0].records
    book = RunCollector((1, 3, 4), (), 5, steered=True)
    assert book.steer(msg.Steering(0, 0, 1, action, 0, 0.1))[1] == []
    events = [Record.of(msg.SwarmEvent(0, 0, 0, msg.EventKind.STEERING, 0.1, text)) for text in ("else", detail)]
    assert [len(book.add(record)) for record in (*first, *events)] == [0] * (len(first) + 1) + [1]


def test_metrics_against_numpy() -> None:
    scenario = builtin("arise_het_4", "duration=6")
    run, law = Run(scenario), configure.parent_controller(scenario)
    metrics = RunFigures(law.reference)
    for step in run.steps:
        metrics.add(step)
    time = 0.01 * np.arange(601)
    error = 0.7 * np.sin(0.0471238898038469 * time) - run.column(msg.PlaneState, "angle")
    unsettled = np.flatnonzero(np.abs(error) >= 0.01)
    summary = metrics.figures()
    assert summary["settled_at"] == pytest.approx(time[unsettled[-1] + 1])
    assert summary["final_error"] == pytest.approx(error[-1], rel=1e-9)
    assert summary["rms_error"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-12)
    assert summary["max_abs_position"] == np.abs(run.column(msg.AgentState, "position")).max()
    assert summary["messages"] == sum(len(step.records) for step in run.steps)
    assert metrics.latest == (600, run.of(msg.PlaneState)[-1].angle, summary["final_error"])


@pytest.mark.parametrize(
    ("angles", "settled_at"),
    [
        ([0.0, 0.0, 0.0], 0.0),
        ([0.1, 0.009, 0.0], 0.01),
        ([0.1, 0.0, 0.1, -0.009, 0.0], 0.03),
        ([0.1, 0.0, 0.01], None),
        ([0.1, 0.0, float("nan")], None),
        ([float("nan")], None),
        ([], None),
    ],
)
def test_settled_is_when_the_error_begins_to_stay_small(angles: list[float], settled_at: float | None) -> None:
    metrics = RunFigures(lambda _: 0.0)
    for step, angle in enumerate(angles):
        metrics.add(Step.of(step, (Record.of(msg.PlaneState(step * 10_000_000, step, angle, 0.0)),)))
    found = metrics.figures()
    assert (found["settled_at"], found["messages"], found["max_abs_position"]) == (settled_at, len(angles), None)
    known = bool(angles) and all(map(isfinite, angles))
    assert (found["final_error"] is not None, found["rms_error"] is not None) == (known, known)


# In real time


PERIOD = 10_000_000
CLOCK = Schedule(PERIOD, 10**18)
PLANE = msg.PlaneState(CLOCK.begin(5), 5, 0.1, 0.0)
ROBOT = msg.AgentState(CLOCK.begin(5), 5, 3, 2, 1, 1, 0.5, 0.0, 0.1, 0.0, 0.0)
ASKED = msg.DesiredAbstractState(CLOCK.begin(5), 5, msg.Mode.RUN, *(0.0,) * 8)
EVENT = msg.SwarmEvent(CLOCK.begin(5), 5, 2, msg.EventKind.HELD, 0.0, "why")
BASIS = msg.Basis(CLOCK.begin(5), 5, 4, 1, msg.Source.CONTROLLER, (), (), ())


FIRST, SECOND = b"1" * 16, b"2" * 16


class Kept(RealtimeCollector):
    """A collector of two robots that takes messages."""

    def __init__(self, limits: Realtime = Realtime()) -> None:  # noqa: B008 - it is frozen
        super().__init__((1, 2), CLOCK, Bounds(9.81, 1.0, 1.5, 0.01), limits)

    def take(self, message: msg.Message, now: int, writer: bytes = b"") -> tuple[msg.Message, ...]:
        return tuple(record.message for record in self.add(Record.of(message), now, writer))


@pytest.mark.parametrize(
    ("message", "another"),
    [
        (PLANE, None),
        (ROBOT, ROBOT._replace(agent_id=1)),
        (ASKED, ASKED._replace(mode=msg.Mode.STOP)),
        (EVENT, EVENT._replace(detail="else")),
        (BASIS, BASIS._replace(source=msg.Source.PLANE)),
    ],
)
def test_the_first_copy_and_other_messages_are_recorded(message: msg.Message, another: msg.Message | None) -> None:
    kept = Kept()
    assert kept.take(message, CLOCK.begin(9)) == (message,)
    assert kept.take(message, CLOCK.begin(9)) == kept.take(message, CLOCK.begin(90)) == ()
    assert another is None or kept.take(another, CLOCK.begin(9)) == (another,)
    assert (kept.repeated, kept.different, kept.refused) == (2, 0, 0)


def test_what_robots_publish_on_topics_of_their_own_is_recorded_on_the_usual_ones() -> None:
    kept, now = Kept(), CLOCK.begin(6)
    own, of_another = ({topic: own_topic(topic, i) for topic in (msg.AGENT_STATE, msg.EVENTS)} for i in (2, 1))
    for message in (ROBOT, EVENT):
        record = Record.heard(own[msg.TOPIC_OF[type(message)]], encode(message))
        assert kept.add(record, now) == (Record.of(message),)
    assert kept.take(ROBOT, now) == (), "it is the same message"
    for number, message in enumerate((ROBOT._replace(command=1.0), EVENT._replace(detail="else"))):
        topic = of_another[msg.TOPIC_OF[type(message)]]
        (told,) = kept.add(Record.heard(topic, encode(message)), now)
        assert told.topic is msg.EVENTS
        assert told.message.detail == f"robot 1: messages with the id of another robot on {topic.name}"
        assert (kept.repeated, kept.different, kept.refused) == (1, 0, number + 1)


@pytest.mark.parametrize(
    ("message", "other"),
    [
        (PLANE, PLANE._replace(angle=0.2)),
        (ROBOT, ROBOT._replace(command=1.0)),
        (ASKED, ASKED._replace(torque=1.0)),
        (BASIS, BASIS._replace(begun=2)),
    ],
)
@pytest.mark.parametrize("writer", [FIRST, b""])
def test_another_message_in_its_place_is_counted_and_told_once(
    message: msg.Message, other: msg.Message, writer: bytes
) -> None:
    kept, now = Kept(), CLOCK.begin(6)
    kept.take(message, now, writer)
    (event,) = kept.take(other, now, writer)
    topic, robot = msg.TOPIC_OF[type(message)].name, getattr(message, "agent_id", 0)
    assert isinstance(event, msg.SwarmEvent)
    assert disputed(event) == Dispute(TWO_MESSAGES, topic, robot or getattr(message, "source", 0), 5, None)
    assert event[:4] == (now, 5, robot, msg.EventKind.REFUSED)
    assert kept.take(other, now, writer) == ()
    assert (kept.repeated, kept.different) == (0, 2)


OF_BROADCASTS = [msg.AbstractState(0, 5, 4, *(0.0,) * 4), msg.AuxiliaryState(0, 5, *(0.0,) * 8), ASKED]


@pytest.mark.parametrize("lead", [-1, 0, 2])
@pytest.mark.parametrize("standby", [False, True])
@pytest.mark.parametrize("message", [PLANE, ROBOT, *OF_BROADCASTS, BASIS], ids=lambda message: type(message).__name__)
def test_of_two_senders_the_first_is_recorded_and_two_events_tell_of_all_steps(
    message: msg.Message, lead: int, *, standby: bool
) -> None:
    kept = Kept()
    topic = msg.TOPIC_OF[type(message)]
    if standby:
        if topic not in STANDBY_TOPICS:
            return
        topic = STANDBY_TOPICS[topic]
    found: list[tuple[int, msg.Message]] = []
    for step in range(5, 420):
        genuine = message._replace(step=step)
        forged = message._replace(step=step + lead, stamp=7 + step)
        arriving = [(genuine, FIRST)]
        if 10 <= step < 300:  # the forger is late at first, then ahead of the one for whom it speaks
            arriving.insert(step % 2, (forged, SECOND))
        for sent, writer in arriving:
            record = Record.heard(topic, encode(sent))
            found += [(step, record.message) for record in kept.add(record, CLOCK.begin(step), writer)]
    recorded = [m for _, m in found if not isinstance(m, msg.SwarmEvent)]
    assert recorded == [message._replace(step=step) for step in range(5, 420)]
    told = [(step, disputed(m)) for step, m in found if isinstance(m, msg.SwarmEvent)]
    robot = getattr(message, "agent_id", getattr(message, "source", 0))
    begun, ended = ((at, said) for at, said in told)
    assert begun == (10, Dispute(SECOND_WRITER, topic.name, robot, 10 + min(0, lead), None))
    assert ended == (299 + QUIET_STEPS + 1, Dispute(SECOND_WRITER, topic.name, robot, None, 299 + max(0, lead)))
    assert [m.value for _, m in found if isinstance(m, msg.SwarmEvent)] == [1.0, 290.0], "messages in dispute"
    health = kept.writers.warned(Health(Level.OK, "recording"))
    assert "a second sender speaks for" in health.text and health.level is Level.WARN


def test_another_writer_takes_the_place_of_one_that_is_silent_for_the_age_limit_of_its_topic() -> None:
    limits = Realtime(plane_age_limit=0.2)
    kept = Kept(limits)
    for step in (5, 25):
        assert len(kept.take(PLANE._replace(step=step), CLOCK.begin(step), FIRST)) == 1
        assert len(kept.take(ROBOT._replace(step=step), CLOCK.begin(step), FIRST)) == 1
        for later in range(step, step + 11):
            kept.take(EVENT._replace(step=later), CLOCK.begin(later))
    forged = PLANE._replace(step=36, angle=0.2), ROBOT._replace(step=36, position=-0.3)
    plane, robot = (kept.take(message, CLOCK.begin(36), SECOND)[0] for message in forged)
    assert (type(plane), robot) == (msg.SwarmEvent, forged[1])


@pytest.mark.parametrize("lie", [PLANE._replace(angle=9.0), ROBOT._replace(position=inf)])
def test_what_nodes_do_not_believe_is_recorded_of_the_sender_whom_they_hear_only(lie: msg.Message) -> None:
    kept = Kept()
    (event,) = kept.take(lie, CLOCK.begin(5), SECOND)
    assert isinstance(event, msg.SwarmEvent)
    assert disputed(event) is None
    honest = PLANE if isinstance(lie, msg.PlaneState) else ROBOT
    assert kept.take(honest, CLOCK.begin(5), FIRST) == (honest,)
    assert kept.take(lie._replace(step=6), CLOCK.begin(6), FIRST) == (lie._replace(step=6),)


def test_whatever_is_forged_the_events_are_few() -> None:
    """Every message has other values, and most are refused: as many events as there are reasons and senders."""
    draw, kept = Random(1), Kept()
    events = 0
    for step in range(5, 505):
        kept.take(PLANE._replace(step=step), CLOCK.begin(step), FIRST)
        kept.take(ROBOT._replace(step=step), CLOCK.begin(step), FIRST)
        for message in (PLANE, ROBOT, ROBOT._replace(agent_id=1), BASIS, EVENT, *OF_BROADCASTS):
            index = draw.randrange(2, len(message))
            lie = draw.choice([draw.uniform(-1e9, 1e9), inf, float(step)])
            number = isinstance(message[index], int)
            forged = message._replace(
                step=step, **{message._fields[index]: int(draw.uniform(0, 200)) if number else lie}
            )
            with suppress(Exception):  # what no message can contain
                found = kept.take(
                    Record.heard(msg.TOPIC_OF[type(message)], encode(forged)).message, CLOCK.begin(step), SECOND
                )
                events += sum(isinstance(m, msg.SwarmEvent) and m.kind == msg.EventKind.REFUSED for m in found)
    assert 0 < events < 50


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (ROBOT._replace(agent_id=9), "a robot that is not a member of this swarm (robot 9)"),
        (EVENT._replace(agent_id=9), "a robot that is not a member of this swarm (robot 9)"),
        (PLANE._replace(step=5 + MEMORY + 2), "a step far from now"),
        (PLANE._replace(step=msg.NEVER), "a step far from now"),
        (msg.RecordingProgress(0, 5, 5), "not a topic that is recorded"),
    ],
)
def test_what_is_of_another_swarm_or_time_is_refused(message: msg.Message, reason: str) -> None:
    kept = Kept()
    (event,) = kept.take(message, CLOCK.begin(6))
    assert isinstance(event, msg.SwarmEvent)
    assert (event.kind, disputed(event)) == (msg.EventKind.REFUSED, None)
    assert reason in event.detail
    assert kept.take(message, CLOCK.begin(6)) == ()
    assert kept.refused == 2


def test_a_forged_step_far_ahead_does_not_prolong_a_dispute() -> None:
    kept = Kept(Realtime(plane_age_limit=0.2))
    kept.take(PLANE, CLOCK.begin(5), FIRST)
    kept.take(PLANE._replace(step=505, angle=0.2), CLOCK.begin(5), SECOND)
    (ended,) = kept.finish()
    assert disputed(ended.message) == Dispute(SECOND_WRITER, "plane/state", 0, None, 5 + 20)


def test_a_dispute_is_over_when_the_clock_is_set_back() -> None:
    kept = Kept()
    for message, writer in ((PLANE._replace(step=500), FIRST), (PLANE._replace(step=500, angle=0.2), SECOND)):
        kept.take(message, CLOCK.begin(500), writer)
    ended, state = kept.take(ROBOT, CLOCK.begin(5), FIRST)
    assert isinstance(ended, msg.SwarmEvent) and disputed(ended) == Dispute(SECOND_WRITER, "plane/state", 0, None, 500)
    assert state == ROBOT


def test_messages_are_recorded_up_to_an_age() -> None:
    kept = Kept()
    assert kept.take(PLANE, CLOCK.begin(5 + MEMORY)) == (PLANE,)
    (event,) = kept.take(PLANE._replace(angle=0.2), CLOCK.begin(5 + MEMORY + 1))
    assert isinstance(event, msg.SwarmEvent) and "a step far from now" in event.detail


def test_memory_is_bounded_whatever_the_clock_does() -> None:
    kept = Kept()
    for step in (*range(5 * MEMORY), 10**6, 10**9, 10**9 + 1, 3):
        kept.take(PLANE._replace(step=step), CLOCK.begin(step))
        assert kept.remembered <= MEMORY + 1


def figures(*told: msg.Message) -> RealtimeFigures:
    found = RealtimeFigures(lambda time: 0.1 * time, CLOCK)
    for message in told:
        found.add(Record.of(message))
    return found


def test_the_error_counts_in_the_time_of_the_law() -> None:
    told: list[msg.Message] = [PLANE._replace(step=step, angle=0.5) for step in range(20)]
    assert figures(*told).summary()["final_error"] is None
    told += [BASIS._replace(step=step, begun=begun) for step, begun in ((7, 7), (9, 7), (12, 12), (14, 12))]
    errors = [0.0 - 0.5, 0.002 - 0.5, 0.0 - 0.5, 0.002 - 0.5]
    summary = figures(*told).summary()
    assert summary["final_error"] == pytest.approx(errors[-1])
    assert summary["rms_error"] == pytest.approx((sum(e * e for e in errors) / 4) ** 0.5)
    assert summary["messages"] == 24


def test_a_state_of_the_plane_waits_for_its_answer_while_a_hundred_others_come() -> None:
    waiting = figures(*(PLANE._replace(step=step) for step in range(101)))
    waiting.add(Record.of(BASIS._replace(step=0, begun=0)))
    assert waiting.figures()["final_error"] is None
    waiting.add(Record.of(BASIS._replace(step=1, begun=0)))
    assert waiting.figures()["final_error"] is not None


def test_a_position_that_is_no_number_is_not_passed_over() -> None:
    metrics = RunFigures(lambda _: 0.0)
    for distance, largest in ((0.5, 0.5), (0.7, 0.7), (0.6, 0.7), (nan, None), (0.3, None), (0.9, None)):
        metrics.reach(distance)
        assert metrics.figures()["max_abs_position"] == largest


def test_the_first_state_of_a_fallen_plane_is_named() -> None:
    found = figures(*(PLANE._replace(step=step, angle=-1.4999) for step in range(100)))
    assert not found.fallen
    for step, angle in ((311, 1.49), (312, -1.5), (313, -1.5)):
        found.add(Record.of(PLANE._replace(step=step, angle=angle)))
    assert found.fallen.startswith("t = 3.12 s, step 312: the plane's angle is -1.5 rad and a run ends at 1.5 rad: ")
    assert "plane.end_stop" in found.fallen


def test_a_robot_out_of_range_counts_in_the_time_of_the_law_until_it_has_left() -> None:
    found = figures(BASIS._replace(step=100, begun=100), PLANE._replace(step=100, angle=0.0))
    assert found.figures()["settled_at"] == 0.0
    found.add(Record.of(EventCode.OUT_OF_RANGE.event(0, 105, 0.6, robot=2, where="position above 0.5 m")))
    assert found.figures()["settled_at"] is None
    found.add(Record.of(EVENT._replace(step=120, kind=msg.EventKind.LEFT)))
    assert found.figures()["settled_at"] == 0.2


def test_the_largest_angle_shown_stays() -> None:
    metrics = RunFigures(lambda _: 0.0)
    for step, (angle, largest) in enumerate(((-0.5, 0.5), (0.2, 0.5), (0.7, 0.7))):
        metrics.follow(step, 0.0, (angle, 0.0))
        assert metrics.max_abs_shown == largest


def test_the_angle_is_told_without_an_error_once_the_controller_does_not_answer_any_more() -> None:
    basis, plane = BASIS._replace(step=7, begun=7), PLANE._replace(step=7, angle=-0.5)
    found = figures(basis, plane)
    assert found.latest == figures(plane, basis).latest == (7, -0.5, 0.5), "whichever of them comes first"
    found.add(Record.of(PLANE._replace(step=17, angle=-0.5)))
    assert found.latest == (7, -0.5, 0.5)
    found.add(Record.of(PLANE._replace(step=18, angle=1.5)))
    assert found.latest == (18, 1.5, None)


def test_losses_ages_and_stops() -> None:
    robots = [ROBOT._replace(step=step, broadcast_step=3) for step in (5, 6, 9)]
    robots += [ROBOT._replace(step=step + 100, agent_id=1, broadcast_step=msg.NEVER) for step in (5, 6, 9)]
    planes = [PLANE._replace(step=step) for step in (2, 4)]
    asked = [ASKED, ASKED._replace(mode=msg.Mode.STOP)]  # two of one step
    said: dict[str, Any] = figures(*robots, *planes, *asked, EVENT._replace(kind=msg.EventKind.SAFE_STOP)).realtime()
    assert said["losses"]["swarm/agent_state"] == {"received": 6, "missing": 4}
    assert said["losses"]["plane/state"] == {"received": 2, "missing": 1}
    assert said["losses"]["swarm/desired_abstract_state"] == {"received": 2, "missing": 0}
    assert said["losses"]["swarm/abstract_state"] == {"received": 0, "missing": 0}
    assert said["broadcast_ages"] == {"2": 1, "3": 1, "6": 1}
    assert said["safe_stops"] == 1


def of(participant: bytes, entity: int) -> bytes:
    """Return the GID of a writer of a process."""
    return participant[:12] + entity.to_bytes(4, "big")


def test_an_event_waits_until_more_is_heard_of_its_process_and_strangers_events_are_dropped_and_told() -> None:
    kept, strange = Kept(), EVENT._replace(detail="forged")
    others = EVENT._replace(step=4), EVENT._replace(detail="another")
    assert kept.take(EVENT, CLOCK.begin(5), of(FIRST, 7)) == ()
    assert kept.take(strange, CLOCK.begin(5), of(SECOND, 7)) == ()
    for event in (*others, EVENT):
        assert kept.take(event, CLOCK.begin(5), of(FIRST, 7)) == ()
    assert kept.take(ROBOT, CLOCK.begin(5), of(FIRST, 4)) == (ROBOT, EVENT, *others), "each once, in order of arrival"
    later = EVENT._replace(step=6)
    assert kept.take(later, CLOCK.begin(6), of(FIRST, 7)) == (later,)
    assert kept.take(PLANE._replace(angle=9.0), CLOCK.begin(6), of(SECOND, 3)) != (), "nobody believes it"
    found = [m for step in range(7, 400) for m in kept.take(ROBOT._replace(step=step), CLOCK.begin(step), of(FIRST, 4))]
    (told,) = [message for message in found if isinstance(message, msg.SwarmEvent)]
    assert told.kind == msg.EventKind.REFUSED
    assert told.detail == "swarm/events: an event of a process from which nothing else of this swarm is heard"
    assert told.step == 5, "it arrived then"
    assert kept.take(EVENT._replace(step=400), CLOCK.begin(400), of(SECOND, 7)) == ()
    assert [record.message.detail for record in kept.finish()] == [], "told once in a while"
    assert kept.refused == 3


def test_an_operator_removes_a_robot_and_sends_nothing_else() -> None:
    kept, removal = Kept(), msg.Removal(*EVENT)
    assert kept.take(removal, CLOCK.begin(5), of(SECOND, 7)) == (removal,)


def test_a_flood_of_events_is_dropped_without_being_kept() -> None:
    kept = Kept()
    for number in range(3000):
        kept.take(EVENT._replace(detail=str(number)), CLOCK.begin(5), of(SECOND, 7))
    assert kept.refused == 2000
    assert kept.take(ROBOT, CLOCK.begin(5), of(FIRST, 4)) == (ROBOT,)
