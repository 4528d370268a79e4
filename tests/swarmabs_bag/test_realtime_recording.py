"""What is recorded of what arrives, and the figures of a run in real time."""

from __future__ import annotations

from typing import Any

import pytest
from tests.swarmabs_core.helpers import builtin
from tests.swarmabs_core.realtime.bags import WORLDS, messages, world

from swarmabs_bag.figures import RealtimeFigures
from swarmabs_bag.realtime import MEMORY, RealtimeCollector, conflict
from swarmabs_config import configure as lockstep
from swarmabs_core.messages import (
    MAIN_TOPICS,
    NEVER,
    TOPIC_OF,
    AgentState,
    Basis,
    DesiredAbstractState,
    EventKind,
    Message,
    Mode,
    PlaneState,
    RecordingProgress,
    Source,
    SwarmEvent,
)
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.record import Record

PERIOD = 10_000_000
CLOCK = Schedule(PERIOD, 10**18)
PLANE = PlaneState(CLOCK.begin(5), 5, 0.1, 0.0)
ROBOT = AgentState(CLOCK.begin(5), 5, 3, 2, 1, 1, 0.5, 0.0, 0.1, 0.0, 0.0)
ASKED = DesiredAbstractState(CLOCK.begin(5), 5, Mode.RUN, *(0.0,) * 8)
EVENT = SwarmEvent(CLOCK.begin(5), 5, 2, EventKind.HELD, 0.0, "why")
BASIS = Basis(CLOCK.begin(5), 5, 4, 1, Source.CONTROLLER, (), (), ())


class Kept(RealtimeCollector):
    """A collector that takes messages."""

    def take(self, message: Message, now: int) -> tuple[Message, ...]:
        return tuple(record.message for record in self.add(Record.of(message), now))


def collector() -> Kept:
    return Kept((1, 2), CLOCK)


@pytest.mark.parametrize("message", [PLANE, ROBOT, ASKED, EVENT, BASIS])
def test_the_first_copy_is_recorded_whenever_it_comes(message: Message) -> None:
    kept = collector()
    assert kept.take(message, CLOCK.begin(9)) == (message,)
    assert kept.take(message, CLOCK.begin(9)) == kept.take(message, CLOCK.begin(90)) == ()
    assert (kept.repeated, kept.different, kept.refused) == (2, 0, 0)


@pytest.mark.parametrize(
    ("message", "other"),
    [
        (PLANE, PLANE._replace(angle=0.2)),
        (ROBOT, ROBOT._replace(command=1.0)),
        (ASKED, ASKED._replace(torque=1.0)),
        (BASIS, BASIS._replace(begun=2)),
    ],
)
def test_another_message_in_its_place_is_counted_and_told_once(message: Message, other: Message) -> None:
    kept = collector()
    now = CLOCK.begin(6)
    kept.take(message, now)
    (event,) = kept.take(other, now)
    assert isinstance(event, SwarmEvent)
    assert conflict(event) == TOPIC_OF[type(message)].name
    assert (event.stamp, event.step, event.kind) == (now, 5, EventKind.REFUSED)
    assert event.agent_id == getattr(message, "agent_id", 0)
    assert kept.take(other, now) == ()
    assert (kept.repeated, kept.different) == (0, 2)


@pytest.mark.parametrize(
    ("message", "other"),
    [
        (ROBOT, ROBOT._replace(agent_id=1)),
        (ASKED, ASKED._replace(mode=Mode.STOP)),
        (EVENT, EVENT._replace(detail="else")),
        (BASIS, BASIS._replace(source=Source.PLANE)),
    ],
)
def test_what_is_something_else_is_recorded_too(message: Message, other: Message) -> None:
    kept = collector()
    assert kept.take(message, CLOCK.begin(6)) + kept.take(other, CLOCK.begin(6)) == (message, other)


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (ROBOT._replace(agent_id=9), "robot 9 is not a member"),
        (EVENT._replace(agent_id=9), "robot 9 is not a member"),
        (PLANE._replace(step=5 + MEMORY + 2), "a step far from now"),
        (PLANE._replace(step=NEVER), "a step far from now"),
        (RecordingProgress(0, 5, 5), "not a topic that is recorded"),
    ],
)
def test_what_is_of_another_swarm_or_time_is_refused(message: Message, reason: str) -> None:
    kept = collector()
    (event,) = kept.take(message, CLOCK.begin(6))
    assert isinstance(event, SwarmEvent)
    assert event.kind == EventKind.REFUSED
    assert reason in event.detail
    assert conflict(event) is None
    assert kept.take(message, CLOCK.begin(6)) == ()
    assert kept.refused == 2


def test_memory_is_bounded_whatever_the_clock_does() -> None:
    kept = collector()
    for step in (*range(5 * MEMORY), 10**6, 10**9, 10**9 + 1, 3):
        kept.take(PLANE._replace(step=step), CLOCK.begin(step))
        assert len(kept._known) <= MEMORY + 1


def figures() -> RealtimeFigures:
    return RealtimeFigures(lambda time: 0.1 * time, CLOCK)


def test_the_error_counts_in_the_time_of_the_law() -> None:
    found = figures()
    for step in range(20):
        found.add(Record.of(PLANE._replace(step=step, angle=0.5)))
    assert found.summary()["final_error"] is None
    for step, begun in ((7, 7), (9, 7), (12, 12), (14, 12)):
        found.add(Record.of(BASIS._replace(step=step, begun=begun)))
    errors = [0.0 - 0.5, 0.002 - 0.5, 0.0 - 0.5, 0.002 - 0.5]
    summary = found.summary()
    assert summary["final_error"] == pytest.approx(errors[-1])
    assert summary["rms_error"] == pytest.approx((sum(e * e for e in errors) / 4) ** 0.5)
    assert summary["messages"] == 24


def test_the_first_state_of_a_fallen_plane_is_named() -> None:
    found = figures()
    for step, angle in ((311, 1.49), (312, -1.5), (313, -1.5)):
        found.add(Record.of(PLANE._replace(step=step, angle=angle)))
    assert found.fallen.startswith("t = 3.12 s, step 312: the plane's angle is -1.5 rad and a run ends at 1.5 rad: ")
    assert "plane.end_stop" in found.fallen


def test_a_plane_at_an_end_stop_before_that_has_not_fallen() -> None:
    found = figures()
    for step in range(100):
        found.add(Record.of(PLANE._replace(step=step, angle=-1.4999)))
    assert not found.fallen


def test_the_angle_is_told_without_an_error_once_the_controller_does_not_answer_any_more() -> None:
    found = figures()
    found.add(Record.of(BASIS._replace(step=7, begun=7)))
    for step in (7, 17):
        found.add(Record.of(PLANE._replace(step=step, angle=-0.5)))
    assert found.latest == (7, -0.5, 0.5)
    found.add(Record.of(PLANE._replace(step=18, angle=1.5)))
    assert found.latest == (18, 1.5, None)


def test_it_does_not_matter_which_of_the_two_comes_first() -> None:
    one, other = figures(), figures()
    one.add(Record.of(PLANE))
    one.add(Record.of(BASIS))
    other.add(Record.of(BASIS))
    other.add(Record.of(PLANE))
    assert one.summary() == other.summary()
    assert one.latest == other.latest is not None


def test_losses_ages_and_stops() -> None:
    found = figures()
    for step in (5, 6, 9):
        found.add(Record.of(ROBOT._replace(step=step, broadcast_step=3)))
        found.add(Record.of(ROBOT._replace(step=step + 100, agent_id=1, broadcast_step=NEVER)))
    for step in (2, 4):
        found.add(Record.of(PLANE._replace(step=step)))
    found.add(Record.of(EVENT._replace(kind=EventKind.SAFE_STOP)))
    said: dict[str, Any] = found.realtime()
    assert said["losses"]["swarm/agent_state"] == {"received": 6, "missing": 4}
    assert said["losses"]["plane/state"] == {"received": 2, "missing": 1}
    assert said["losses"]["swarm/abstract_state"] == {"received": 0, "missing": 0}
    assert said["broadcast_ages"] == {"2": 1, "3": 1, "6": 1}
    assert said["safe_stops"] == 1


def test_figures_of_a_run_are_those_of_its_messages() -> None:
    recorded = world("operator")
    said: dict[str, Any] = recorded.figures.realtime()
    found = messages(recorded.bag)
    by_topic = {topic.name: sum(TOPIC_OF[type(m)] is topic for m in found) for topic in MAIN_TOPICS}
    assert {name: loss["received"] for name, loss in said["losses"].items()} == by_topic
    assert recorded.figures.figures()["messages"] == len(found)
    law = lockstep.parent_controller(builtin("pd_het_4"))
    angles = {m.step: m.angle for m in found if isinstance(m, PlaneState)}
    run = [m for m in found if isinstance(m, DesiredAbstractState) and m.mode == Mode.RUN]
    assert recorded.figures.figures()["final_error"] == law.reference(0.0) - angles[run[-1].step]


def test_every_world_has_its_figures() -> None:
    for name in WORLDS:
        summary = world(name).figures.figures()
        assert summary["rms_error"] is not None
        assert summary["max_abs_position"] is not None
