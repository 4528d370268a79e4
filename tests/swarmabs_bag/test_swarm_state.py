"""What is shown of a swarm: whatever is lost, late, repeated or made up, it is the latest that came."""

from __future__ import annotations

import random

import pytest
from tests.swarmabs_bag.sample_run import PERIOD, make_run, make_step

from swarmabs_bag import swarm_state as module
from swarmabs_bag.swarm_state import (
    MOST_EVENTS,
    SILENT_STEPS,
    Abstract,
    Instant,
    Members,
    RobotIdentity,
    ShownRobot,
    SwarmState,
)
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.messages import (
    AgentState,
    Basis,
    DesiredAbstractState,
    EventKind,
    Kind,
    Message,
    PlaneState,
    Source,
    Status,
    SwarmEvent,
)
from swarmabs_core.steering import DISTURBANCE, REFERENCE, OffsetReference, StepSchedule


def ten_times() -> OffsetReference:
    return OffsetReference(lambda time: 10 * time, StepSchedule(), PERIOD)


def state_of(messages: list[Message]) -> SwarmState:
    made = SwarmState(reference=ten_times())
    for message in messages:
        made.add(message)
    return made


def shown(state: SwarmState) -> tuple[Instant, list[ShownRobot]]:
    instant = state.instant()
    assert instant is not None
    return instant, state.shown_robots(instant.step)


def statuses(state: SwarmState) -> list[str | None]:
    return [robot.status for robot in shown(state)[1]]


def event(step: int, agent: int, kind: int, detail: str = "") -> SwarmEvent:
    return SwarmEvent(step * PERIOD, step, agent, kind, 0.5, detail)


def test_what_is_shown_is_the_latest_step() -> None:
    run = make_run(20)
    instant, robots = shown(state_of(run))
    last = {type(m).__name__ + str(getattr(m, "agent_id", "")): m for m in run if m.step == 20}
    plane, abstract, desired = (last[name] for name in ("PlaneState", "AbstractState", "DesiredAbstractState"))
    assert (instant.step, instant.stamp, instant.time) == (20, 20 * PERIOD, 0.2)
    assert (instant.angle, instant.angular_velocity) == (plane.angle, plane.angular_velocity)  # type: ignore[union-attr]
    assert instant.reference == 2.0
    assert instant.abstract == (abstract.torque, abstract.inertia)  # type: ignore[union-attr]
    assert instant.desired == (desired.torque, desired.inertia)  # type: ignore[union-attr]
    said = [last[f"AgentState{robot}"] for robot in (1, 2, 7)]
    assert robots == [(one.position, one.velocity, one.command, "active") for one in said]  # type: ignore[union-attr]


def test_the_reference_shown_has_the_offset_that_was_announced() -> None:
    steered = [event(7, 0, EventKind.STEERING, REFERENCE), event(9, 0, EventKind.STEERING, DISTURBANCE)]
    made = SwarmState(reference=ten_times())
    complete = [made.add(message) for message in sorted([*steered, *make_run(20)], key=lambda message: message.step)]
    found = [instant.reference for instant in complete if instant is not None]
    assert found == pytest.approx([0.1 * step + 0.5 * (step >= 7) for step in range(21)])


def test_order_and_repeats_change_nothing() -> None:
    run = make_run(20)
    mixed = [*run, *run]
    random.Random(3).shuffle(mixed)
    straight, other = state_of(run), state_of(mixed)
    assert shown(other) == shown(straight)
    assert other.robots == straight.robots
    assert other.events == straight.events


def test_a_step_is_complete_once_and_those_of_which_something_is_lost_never_are() -> None:
    made = SwarmState()
    lossy = [m for m in make_run(20) if not (isinstance(m, PlaneState) and m.step in {4, 5})]
    steps = [instant.step for message in lossy if (instant := made.add(message)) is not None]
    assert steps == [step for step in range(21) if step not in {4, 5}]


def test_nothing_is_shown_before_the_plane_is_heard() -> None:
    assert state_of([m for m in make_step(0) if isinstance(m, AgentState)]).instant() is None


@pytest.mark.parametrize(
    ("kind", "status"), [(EventKind.DEAD, "dead"), (EventKind.LEFT, "left"), (EventKind.LIMIT_HIT, "active")]
)
def test_events_say_who_is_out(kind: EventKind, status: str) -> None:
    assert statuses(state_of([*make_run(5), event(3, 2, kind)])) == ["active", status, "active"]


def known(*numbers: int) -> list[RobotIdentity]:
    return [RobotIdentity(number, Kind.SINGLE_INTEGRATOR, 1.0, 0.0) for number in numbers]


def test_a_robot_that_was_dead_before_anything_was_heard_stands_where_its_event_says() -> None:
    made = SwarmState(known(1, 2, 7, 9))
    for message in [event(3, 9, EventKind.LEFT), event(3, 2, EventKind.DEAD, "kill"), *make_step(500, agents=(1, 7))]:
        made.add(message)
    _, robots = shown(made)
    assert [robots[0].status, robots[2].status] == ["active"] * 2
    assert None not in (*robots[0], *robots[2])
    assert robots[1] == ShownRobot(0.5, 0.0, None, "dead")
    assert robots[3] == ShownRobot(status="left")
    assert made.members() == Members((1, 7), ((2, 0.5),))


@pytest.mark.parametrize("late", [False, True])
def test_what_a_robot_says_after_its_end_is_not_shown(late: bool) -> None:  # noqa: FBT001 - a case, not a switch
    end = event(6, 2, EventKind.DEAD, "kill")
    again = event(8, 2, EventKind.RECOVERED)
    run = make_run(20)
    instant, robots = shown(state_of([*run, again, end] if late else [end, again, *run]))
    assert (instant.step, robots[1]) == (20, ShownRobot(0.5, 0.0, None, "dead"))
    _, early = shown(state_of([end, *(message for message in run if message.step < 6)]))
    (state,) = (m for m in run if isinstance(m, AgentState) and (m.step, m.agent_id) == (5, 2))
    assert (early[1].status, early[1].position) == ("active", state.position)


def test_who_joins_again_is_in() -> None:
    assert (
        statuses(state_of([*make_run(5), event(2, 2, EventKind.DEAD), event(4, 2, EventKind.JOINED)])) == ["active"] * 3
    )


def test_a_robot_that_says_nothing_is_silent_and_stays_where_it_was() -> None:
    messages = [m for m in make_run(SILENT_STEPS + 2) if not (isinstance(m, AgentState) and m.agent_id == 7)]
    (old,) = (m for m in make_step(2) if isinstance(m, AgentState) and m.agent_id == 7)
    made = state_of([*messages, old])
    assert statuses(made) == ["active"] * 3
    for message in make_step(SILENT_STEPS + 3, agents=(1, 2)):
        made.add(message)
    assert statuses(made) == ["active", "active", "silent"]
    assert shown(made)[1][2].position == old.position


def test_safe_stop_is_told_apart() -> None:
    stopped = [m._replace(status=Status.SAFE_STOP) if isinstance(m, AgentState) else m for m in make_run(2)]
    assert statuses(state_of(stopped)) == ["safe_stop"] * 3


def test_robots_that_are_known_but_not_heard_have_a_place() -> None:
    made = SwarmState(known(9, 1))
    for message in make_step(0, agents=(1,)):
        made.add(message)
    assert [robot.id for robot in made.robots] == [9, 1]
    assert shown(made)[1][0] == ShownRobot()
    assert statuses(made) == [None, "active"]


def test_strangers_cannot_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_ROBOTS", 50)
    (state,) = (m for m in make_step(0, agents=(1,)) if isinstance(m, AgentState))
    flood: list[Message] = [state._replace(agent_id=number) for number in range(1, 500)]
    flood += [event(number, 1, EventKind.LIMIT_HIT, f"{number}") for number in range(10 * MOST_EVENTS)]
    flood += [PlaneState(0, number, 0.0, 0.0) for number in range(0, 10**6, 100)]
    made = state_of(flood)
    assert len(made.robots) == 50
    assert len(made.events) == MOST_EVENTS
    assert made.event_count == 10 * MOST_EVENTS
    assert len(made._known_events) <= 4 * MOST_EVENTS
    assert len(made._steps) <= module.PENDING


def test_numbers_of_different_steps_are_never_shown_together() -> None:
    run = make_run(30)
    made = state_of([m for m in run if m.step <= 10 or isinstance(m, PlaneState)])
    assert shown(made)[0].step == 10
    for step in range(31, 12 + SILENT_STEPS):  # the observer is not heard any more
        made.add(PlaneState(step * PERIOD, step, 0.5, 0.0))
        made.add(DesiredAbstractState(step * PERIOD, step, 1, 0.25, *[0.0] * 7))
    instant, _ = shown(made)
    assert (instant.step, instant.angle) == (11 + SILENT_STEPS, 0.5)
    assert (instant.desired.torque, instant.abstract) == (0.25, Abstract())


def test_by_a_clock_times_are_those_of_the_steps_and_the_law_begins_when_it_says() -> None:
    made = SwarmState(reference=ten_times(), period_ns=PERIOD)
    now = 1_795_000_000 * 10**9
    for step in range(100, 120):
        for message in make_step(step):
            made.add(message._replace(stamp=now + message.stamp))
    instant, _ = shown(made)
    assert (instant.time, instant.reference) == (1.19, None)
    made.add(Basis(now, 119, 118, 109, Source.CONTROLLER, (), (), ()))
    made.add(Basis(now, 119, 118, 7, Source.PLANE, (), (), ()))
    assert shown(made)[0].reference == 10 * 0.1


def test_without_a_period_a_clock_counts_from_the_first_message() -> None:
    made = SwarmState()
    now = 1_795_000_000 * 10**9
    for step in range(100, 120):
        for message in make_step(step):
            made.add(message._replace(stamp=now + message.stamp))
    assert shown(made)[0].time == pytest.approx(0.19)


def test_a_scenario_gives_its_robots_its_period_and_its_offsets() -> None:
    changes = ["faults=[{kind: reference, at: 1.0, offset: 0.1}, {kind: join, at: 2.0, agent: 3}]"]
    made = SwarmState.of(find_scenario("pd_het_4", changes).resolved())
    assert [(robot.id, robot.joins) for robot in made.robots] == [(1, False), (2, False), (3, True), (4, False)]
    made.add(PlaneState(0, 100, 0.0, 0.0))
    assert (shown(made)[0].time, shown(made)[0].reference) == (1.0, 0.1)
    assert made.members() == Members((1, 2, 4), ())
