"""The picture of a swarm that goes on: whatever is lost, late, repeated or made up, it shows the latest that came."""

from __future__ import annotations

import random

import pytest
from tests.swarmabs_bag.sample_run import PERIOD, make_run, make_step

from swarmabs_bag.membership_timeline import SILENT_STEPS, Members
from swarmabs_core.messages import (
    AgentState,
    Basis,
    DesiredAbstractState,
    EventKind,
    Message,
    PlaneState,
    Source,
    Status,
    SwarmEvent,
)
from swarmabs_core.steering import DISTURBANCE, REFERENCE, OffsetReference, Staircase
from swarmabs_view import picture as module
from swarmabs_view.picture import MOST_EVENTS, STALE, Picture
from swarmabs_view.protocol import Robot


def ten_times() -> OffsetReference:
    return OffsetReference(lambda time: 10 * time, Staircase(), PERIOD)


def picture_of(messages: list[Message]) -> Picture:
    made = Picture(reference=ten_times())
    for message in messages:
        made.add(message)
    return made


def event(step: int, agent: int, kind: int, detail: str = "") -> SwarmEvent:
    return SwarmEvent(step * PERIOD, step, agent, kind, 0.5, detail)


def test_frame_is_that_of_the_latest_step() -> None:
    run = make_run(20)
    frame = picture_of(run).frame(12.5)
    assert frame is not None
    last = {type(m).__name__ + str(getattr(m, "agent_id", "")): m for m in run if m.step == 20}
    plane, abstract, desired = (last[name] for name in ("PlaneState", "AbstractState", "DesiredAbstractState"))
    assert (frame.step, frame.time, frame.step_rate) == (20, 0.2, 12.5)
    assert (frame.angle, frame.angular_velocity) == (plane.angle, plane.angular_velocity)  # type: ignore[union-attr]
    assert frame.reference == 2.0
    assert frame.abstract.model_dump() == {"torque": abstract.torque, "inertia": abstract.inertia}  # type: ignore[union-attr]
    assert frame.desired.model_dump() == {"torque": desired.torque, "inertia": desired.inertia}  # type: ignore[union-attr]
    robots = [last[f"AgentState{robot}"] for robot in (1, 2, 7)]
    assert frame.robots.position == [robot.position for robot in robots]  # type: ignore[union-attr]
    assert frame.robots.command == [robot.command for robot in robots]  # type: ignore[union-attr]
    assert frame.robots.status == ["active"] * 3


def test_the_reference_shown_has_the_offset_that_was_announced() -> None:
    steered = [event(7, 0, EventKind.STEERING, REFERENCE), event(9, 0, EventKind.STEERING, DISTURBANCE)]
    run = make_run(20)
    found = picture_of(sorted([*steered, *run], key=lambda message: message.step))
    curves = found.curves.since(-1, 0)
    assert curves is not None
    assert curves.reference == pytest.approx([0.1 * step + 0.5 * (step >= 7) for step in range(21)])


def test_order_and_repeats_change_nothing() -> None:
    run = make_run(20)
    mixed = [*run, *run]
    random.Random(3).shuffle(mixed)
    straight, other = picture_of(run), picture_of(mixed)
    assert other.frame(None) == straight.frame(None)
    assert other.robots == straight.robots
    assert other.events == straight.events


def test_lost_messages_are_gaps_in_curves_and_nothing_else() -> None:
    whole = picture_of(make_run(20)).curves.since(-1, 0)
    lossy = picture_of([m for m in make_run(20) if not (isinstance(m, PlaneState) and m.step in {4, 5})])
    found = lossy.curves.since(-1, 0)
    assert whole is not None
    assert found is not None
    assert [time for time in whole.time if time not in found.time] == [0.04, 0.05]
    assert found.angle == [angle for angle, time in zip(whole.angle, whole.time, strict=True) if time in found.time]


def test_nothing_is_shown_before_the_plane_is_heard() -> None:
    assert picture_of([m for m in make_step(0) if isinstance(m, AgentState)]).frame(None) is None


@pytest.mark.parametrize(
    ("kind", "status"), [(EventKind.DEAD, "dead"), (EventKind.LEFT, "left"), (EventKind.LIMIT_HIT, "active")]
)
def test_events_say_who_is_out(kind: EventKind, status: str) -> None:
    frame = picture_of([*make_run(5), event(3, 2, kind)]).frame(None)
    assert frame is not None
    assert frame.robots.status == ["active", status, "active"]


def test_a_robot_that_was_dead_before_anything_was_heard_stands_where_its_event_says() -> None:
    known = [Robot(id=number, kind="single_integrator", mass=1.0, damping=0.0) for number in (1, 2, 7, 9)]
    made = Picture(known)
    for message in [event(3, 9, EventKind.LEFT), event(3, 2, EventKind.DEAD, "kill"), *make_step(500, agents=(1, 7))]:
        made.add(message)
    frame = made.frame(None)
    assert frame is not None
    assert frame.robots.status == ["active", "dead", "active", "left"]
    for name, dead in (("position", 0.5), ("velocity", 0.0), ("command", None)):
        found = getattr(frame.robots, name)
        assert None not in (found[0], found[2])
        assert (found[1], found[3]) == (dead, None)
    assert made.members() == Members((1, 7), ((2, 0.5),))


@pytest.mark.parametrize("late", [False, True])
def test_what_a_robot_says_after_its_end_is_not_shown(late: bool) -> None:  # noqa: FBT001 - a case, not a switch
    end = event(6, 2, EventKind.DEAD, "kill")
    again = event(8, 2, EventKind.RECOVERED)
    run = make_run(20)
    made = picture_of([*run, again, end] if late else [end, again, *run])
    frame = made.frame(None)
    assert frame is not None
    assert frame.step == 20
    assert (frame.robots.status[1], frame.robots.position[1], frame.robots.velocity[1]) == ("dead", 0.5, 0.0)
    early = picture_of([end, *(message for message in run if message.step < 6)]).frame(None)
    assert early is not None
    (state,) = (m for m in run if isinstance(m, AgentState) and (m.step, m.agent_id) == (5, 2))
    assert (early.robots.status[1], early.robots.position[1]) == ("active", state.position)


def test_who_joins_again_is_in() -> None:
    frame = picture_of([*make_run(5), event(2, 2, EventKind.DEAD), event(4, 2, EventKind.JOINED)]).frame(None)
    assert frame is not None
    assert frame.robots.status == ["active"] * 3


def test_a_robot_that_says_nothing_is_silent_and_stays_where_it_was() -> None:
    messages = [m for m in make_run(SILENT_STEPS + 2) if not (isinstance(m, AgentState) and m.agent_id == 7)]
    (old,) = (m for m in make_step(2) if isinstance(m, AgentState) and m.agent_id == 7)
    made = picture_of([*messages, old])
    frame = made.frame(None)
    assert frame is not None
    assert frame.robots.status == ["active"] * 3
    for message in make_step(SILENT_STEPS + 3, agents=(1, 2)):
        made.add(message)
    frame = made.frame(None)
    assert frame is not None
    assert frame.robots.status == ["active", "active", "silent"]
    assert frame.robots.position[2] == old.position


def test_safe_stop_is_told_apart() -> None:
    stopped = [m._replace(status=Status.SAFE_STOP) if isinstance(m, AgentState) else m for m in make_run(2)]
    frame = picture_of(stopped).frame(None)
    assert frame is not None
    assert frame.robots.status == ["safe_stop"] * 3


def test_robots_that_are_known_but_not_heard_have_a_place() -> None:
    known = [Robot(id=number, kind="single_integrator", mass=1.0, damping=0.0) for number in (9, 1)]
    made = Picture(known)
    for message in make_step(0, agents=(1,)):
        made.add(message)
    frame = made.frame(None)
    assert frame is not None
    assert [robot.id for robot in made.robots] == [9, 1]
    assert frame.robots.status == [None, "active"]
    assert frame.robots.position[0] is None


def test_strangers_cannot_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_ROBOTS", 50)
    (state,) = (m for m in make_step(0, agents=(1,)) if isinstance(m, AgentState))
    flood: list[Message] = [state._replace(agent_id=number) for number in range(1, 500)]
    flood += [event(number, 1, EventKind.LIMIT_HIT, f"{number}") for number in range(10 * MOST_EVENTS)]
    flood += [PlaneState(0, number, 0.0, 0.0) for number in range(0, 10**6, 100)]
    made = picture_of(flood)
    assert len(made.robots) == 50
    assert len(made.events) == MOST_EVENTS
    assert made.event_count == 10 * MOST_EVENTS
    assert len(made._known_events) <= 4 * MOST_EVENTS
    assert len(made._steps) <= module.PENDING


def test_numbers_of_different_steps_are_never_shown_together() -> None:
    run = make_run(30)
    made = picture_of([m for m in run if m.step <= 10 or isinstance(m, PlaneState)])
    frame = made.frame(None)
    assert frame is not None
    assert frame.step == 10
    for step in range(31, 12 + STALE):  # the observer is not heard any more
        made.add(PlaneState(step * PERIOD, step, 0.5, 0.0))
        made.add(DesiredAbstractState(step * PERIOD, step, 1, 0.25, *[0.0] * 7))
    frame = made.frame(None)
    assert frame is not None
    assert (frame.step, frame.angle, frame.desired.torque, frame.abstract.torque) == (11 + STALE, 0.5, 0.25, None)


def test_by_a_clock_times_are_those_of_the_steps_and_the_law_begins_when_it_says() -> None:
    made = Picture(reference=ten_times(), period_ns=PERIOD)
    now = 1_795_000_000 * 10**9
    for step in range(100, 120):
        for message in make_step(step):
            made.add(message._replace(stamp=now + message.stamp))
    frame = made.frame(None)
    assert frame is not None
    assert (frame.time, frame.reference) == (1.19, None)
    made.add(Basis(now, 119, 118, 109, Source.CONTROLLER, (), (), ()))
    made.add(Basis(now, 119, 118, 7, Source.PLANE, (), (), ()))
    frame = made.frame(None)
    assert frame is not None
    assert frame.reference == 10 * 0.1


def test_without_a_period_a_clock_counts_from_the_first_message() -> None:
    made = Picture()
    now = 1_795_000_000 * 10**9
    for step in range(100, 120):
        for message in make_step(step):
            made.add(message._replace(stamp=now + message.stamp))
    frame = made.frame(None)
    assert frame is not None
    assert frame.time == pytest.approx(0.19)
