"""What is shown of a swarm: whatever is lost, late, repeated or made up, it is the latest that came."""

import pickle
import random
from itertools import groupby
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.swarmabs_analysis.figures.conftest import record
from tests.swarmabs_bag.realtime_bags import realtime_bag
from tests.swarmabs_bag.sample_run import PERIOD, SCENARIO, make_run, make_step, write_bag
from tests.swarmabs_core.realtime.bags import Stored

from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.reader import open_bag
from swarmabs_bag.shown import swarm_state as module
from swarmabs_bag.shown.percentiles import SIDES, starts_above
from swarmabs_bag.shown.recorded_swarm import RecordedSwarm, read_swarm
from swarmabs_bag.shown.swarm_state import (
    MOST_EVENTS,
    SILENT_STEPS,
    STATUSES,
    Instant,
    Members,
    RobotHistory,
    RobotIdentity,
    ShownRobot,
    SwarmState,
)
from swarmabs_config import configure
from swarmabs_config.scenarios import find_scenario
from swarmabs_core import messages as msg
from swarmabs_core.steering import DISTURBANCE, REFERENCE, OffsetReference, StepSchedule


def ten_times() -> OffsetReference:
    return OffsetReference(lambda time: 10 * time, StepSchedule(), PERIOD)


def state_of(messages: list[msg.Message]) -> SwarmState:
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


def event(step: int, agent: int, kind: int, detail: str = "") -> msg.SwarmEvent:
    return msg.SwarmEvent(step * PERIOD, step, agent, kind, 0.5, detail)


def test_what_is_shown_is_the_latest_step_whatever_the_order_and_the_repeats() -> None:
    run = make_run(20)
    instant, robots = shown(state_of(run))
    last: dict[str, Any] = {type(m).__name__ + str(getattr(m, "agent_id", "")): m for m in run if m.step == 20}
    plane, abstract, desired = (last[name] for name in ("PlaneState", "AbstractState", "DesiredAbstractState"))
    assert (instant.step, instant.stamp, instant.time, instant.reference) == (20, 20 * PERIOD, 0.2, (2.0,))
    assert instant.parent == (plane.angle, plane.angular_velocity)
    assert (instant.abstract, instant.desired) == (abstract[3:5], desired[3:5])
    said = [last[f"AgentState{robot}"] for robot in (1, 2, 7)]
    assert robots == [((one.position,), (one.velocity,), (one.command,), "active") for one in said]
    mixed = [*run, *run]
    random.Random(3).shuffle(mixed)
    straight, other = state_of(run), state_of(mixed)
    assert shown(other) == shown(straight)
    assert (other.robots, other.events) == (straight.robots, straight.events)


def test_the_reference_shown_has_the_offset_that_was_announced() -> None:
    steered = [event(7, 0, msg.EventKind.STEERING, REFERENCE), event(9, 0, msg.EventKind.STEERING, DISTURBANCE)]
    made = SwarmState(reference=ten_times())
    complete = [made.add(message) for message in sorted([*steered, *make_run(20)], key=lambda message: message.step)]
    found = [instant.reference[0] for instant in complete if instant is not None]
    assert found == pytest.approx([0.1 * step + 0.5 * (step >= 7) for step in range(21)])


def test_a_step_is_complete_once_and_waits_for_its_rest_while_so_many_others_begin() -> None:
    """Those of which something is lost never are complete, and nothing is shown before the plane is heard."""
    made = SwarmState()
    lossy = [m for m in make_run(20) if not (isinstance(m, msg.PlaneState) and m.step in {4, 5})]
    steps = [instant.step for message in lossy if (instant := made.add(message)) is not None]
    assert steps == [step for step in range(21) if step not in {4, 5}]
    rest = [m for m in make_step(0) if isinstance(m, (msg.AbstractState, msg.DesiredAbstractState))]
    for others, complete in ((module.PENDING, True), (module.PENDING + 1, False)):
        made = state_of([msg.PlaneState(step * PERIOD, step, 0.0, 0.0) for step in range(others)])
        assert ([made.add(message) for message in rest][-1] is not None) == complete
    assert state_of([m for m in make_step(0) if isinstance(m, msg.AgentState)]).instant() is None


def test_what_is_shown_does_not_go_back_when_late_messages_complete_an_earlier_step() -> None:
    """The observer was silent for so long that the plane alone was shown; a complete step that is later ends that."""
    last = SILENT_STEPS + 10
    planes = [m for m in make_run(last) if isinstance(m, msg.PlaneState) and m.step > 5]
    made = state_of([*make_run(5), *planes])
    assert (shown(made)[0].step, shown(made)[0].abstract) == (last, ())
    for late, expected in ((last - 30, last), (last - 1, last), (last + 1, last + 1)):
        for message in make_step(late):
            made.add(message)
        assert shown(made)[0].step == expected
    assert shown(made)[0].abstract


@pytest.mark.parametrize(
    ("kinds", "status"),
    [
        ((msg.EventKind.DEAD,), "dead"),
        ((msg.EventKind.LEFT,), "left"),
        ((msg.EventKind.LIMIT_HIT,), "active"),
        ((msg.EventKind.DEAD, msg.EventKind.JOINED), "active"),
    ],
)
def test_events_say_who_is_out(kinds: tuple[msg.EventKind, ...], status: str) -> None:
    events = [event(step, 2, kind) for step, kind in enumerate(kinds, start=2)]
    for arriving in (events, events[::-1]):
        assert statuses(state_of([*make_run(5), *arriving])) == ["active", status, "active"]


def test_of_many_changes_the_latest_count() -> None:
    kinds = (msg.EventKind.LEFT, msg.EventKind.JOINED)
    events = [event(step, 2, kinds[step % 2]) for step in range(1, 2 * module.MOST_CHANGES + 1)]
    for count, status in ((len(events), "left"), (len(events) - 1, "active")):
        assert statuses(state_of([*make_run(40), *events[:count]])) == ["active", status, "active"]


def test_a_robot_that_was_dead_before_anything_was_heard_stands_where_its_event_says() -> None:
    made = SwarmState([RobotIdentity(number, msg.Kind.SINGLE_INTEGRATOR, (1.0, 0.0)) for number in (9, 1, 8, 2, 7)])
    for message in [
        event(3, 9, msg.EventKind.LEFT),
        event(3, 2, msg.EventKind.DEAD, "kill"),
        *make_step(500, agents=(1, 7)),
    ]:
        made.add(message)
    _, robots = shown(made)
    assert [robot.status for robot in robots] == ["left", "active", None, "dead", "active"]
    assert all(None not in vector and len(vector) == 1 for robot in (robots[1], robots[4]) for vector in robot[:3])
    assert robots[3] == ShownRobot((0.5,), (0.0,), (), "dead")
    assert (robots[0], robots[2]) == (ShownRobot(status="left"), ShownRobot())
    assert made.members() == Members((1, 8, 7), ((2, 0.5),))


@pytest.mark.parametrize("late", [False, True])
def test_what_a_robot_says_after_its_end_is_not_shown(late: bool) -> None:  # noqa: FBT001 - a case, not a switch
    end = event(6, 2, msg.EventKind.DEAD, "kill")
    again = event(8, 2, msg.EventKind.RECOVERED)
    run = make_run(20)
    instant, robots = shown(state_of([*run, again, end] if late else [end, again, *run]))
    assert (instant.step, robots[1]) == (20, ShownRobot((0.5,), (0.0,), (), "dead"))
    _, early = shown(state_of([end, *(message for message in run if message.step < 6)]))
    (state,) = (m for m in run if isinstance(m, msg.AgentState) and (m.step, m.agent_id) == (5, 2))
    assert (early[1].status, early[1].coordinates) == ("active", (state.position,))


def test_what_a_dead_robot_says_in_the_step_of_its_end_and_later_is_not_its_last_state() -> None:
    history = RobotHistory([2])
    for message in make_run(20):
        if isinstance(message, msg.AgentState) and message.agent_id == 2:
            history.add(message)
    history.take(event(6, 2, msg.EventKind.DEAD, "kill"))
    found = [history.latest(2, step) for step in (5, 6, 20)]
    assert [None if state is None else state.step for state in found] == [5, 5, 5]


def test_robots_that_end_in_the_same_step_take_no_part_from_it_on_also_if_the_second_is_told_later() -> None:
    robots = [RobotIdentity(number, msg.Kind.SINGLE_INTEGRATOR, (1.0, 0.0)) for number in (1, 2, 7)]
    made = SwarmState(robots)
    for message in [*make_run(20), event(6, 2, msg.EventKind.LEFT)]:
        made.add(message)
    assert made.members() == Members((1, 7), ())
    made.add(event(6, 7, msg.EventKind.LEFT))
    assert made.members() == Members((1,), ())


def test_a_robot_that_says_nothing_is_silent_and_stays_where_it_was() -> None:
    messages = [m for m in make_run(SILENT_STEPS + 2) if not (isinstance(m, msg.AgentState) and m.agent_id == 7)]
    (old,) = (m for m in make_step(2) if isinstance(m, msg.AgentState) and m.agent_id == 7)
    made = state_of([*messages, old])
    assert statuses(made) == ["active"] * 3
    for message in make_step(SILENT_STEPS + 3, agents=(1, 2)):
        made.add(message)
    assert statuses(made) == ["active", "active", "silent"]
    assert shown(made)[1][2].coordinates == (old.position,)
    stopped = [m._replace(status=msg.Status.SAFE_STOP) if isinstance(m, msg.AgentState) else m for m in make_run(2)]
    assert statuses(state_of(stopped)) == ["safe_stop"] * 3


def test_a_robot_that_starts_on_the_axis_is_on_the_lower_side() -> None:
    assert [SIDES[starts_above(start)] for start in (-0.1, 0.0, 5e-324)] == ["≤ 0", "≤ 0", "> 0"]


def test_strangers_cannot_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_ROBOTS", 50)
    (state,) = (m for m in make_step(0, agents=(1,)) if isinstance(m, msg.AgentState))
    flood: list[msg.Message] = [state._replace(agent_id=number) for number in range(1, 500)]
    flood += [event(number, 1, msg.EventKind.LIMIT_HIT, f"{number}") for number in range(10 * MOST_EVENTS)]
    flood += [msg.PlaneState(0, number, 0.0, 0.0) for number in range(0, 10**6, 100)]
    made = SwarmState()
    for message in flood:
        made.add(message)
    assert made.version == len(flood)
    assert len(made.robots) == 50
    assert len(made.events) == MOST_EVENTS
    assert made.event_count == 10 * MOST_EVENTS
    size = len(pickle.dumps(made))
    for message in flood:
        made.add(message._replace(step=message.step + 10**7))
    assert len(pickle.dumps(made)) < 1.1 * size


def test_numbers_of_different_steps_are_never_shown_together() -> None:
    run = make_run(30)
    made = state_of([m for m in run if m.step <= 10 or isinstance(m, msg.PlaneState)])
    assert shown(made)[0].step == 10
    for step in range(31, 12 + SILENT_STEPS):  # the observer is not heard any more
        made.add(msg.PlaneState(step * PERIOD, step, 0.5, 0.0))
        made.add(msg.DesiredAbstractState(step * PERIOD, step, 1, 0.25, *[0.0] * 7))
    instant, _ = shown(made)
    assert (instant.step, instant.parent[0]) == (11 + SILENT_STEPS, 0.5)
    assert (instant.desired[0], instant.abstract) == (0.25, ())


def test_by_a_clock_times_are_those_of_the_steps_and_the_law_begins_when_it_says() -> None:
    made, without_period = SwarmState(reference=ten_times(), period_ns=PERIOD), SwarmState()
    now = 1_795_000_000 * 10**9
    for step in range(100, 120):
        for message in make_step(step):
            made.add(message._replace(stamp=now + message.stamp))
            without_period.add(message._replace(stamp=now + message.stamp))
    assert shown(without_period)[0].time == pytest.approx(0.19), "since the first message"
    instant, _ = shown(made)
    assert (instant.time, instant.reference) == (1.19, ())
    made.add(msg.Basis(now, 119, 118, 109, msg.Source.CONTROLLER, (), (), ()))
    made.add(msg.Basis(now, 119, 118, 7, msg.Source.PLANE, (), (), ()))
    assert shown(made)[0].reference == (10 * 0.1,)


def test_a_scenario_gives_its_robots_its_period_and_its_offsets() -> None:
    changes = ["faults=[{kind: reference, at: 1.0, offset: 0.1}, {kind: join, at: 2.0, agent: 3}]"]
    made = SwarmState.of(find_scenario("pd_het_4", changes).resolved())
    assert [(robot.id, robot.joins) for robot in made.robots] == [(1, False), (2, False), (3, True), (4, False)]
    made.add(msg.PlaneState(0, 0, 0.0, 0.0))
    assert made.members() == Members((1, 2, 4), ())
    made.add(msg.PlaneState(0, 100, 0.0, 0.0))
    assert (shown(made)[0].time, shown(made)[0].reference) == (1.0, (0.1,))
    assert made.members() == Members((1, 2, 4), ())


# What is shown of a recorded swarm is what was shown while its messages came


MEMBERS = "[{at: 0.05, kind: kill, agent: 1}, {at: 0.1, kind: leave, agent: 2}, {at: 0.02, kind: join, agent: 4}]"
OFFSET = "[{kind: reference, at: 0.1, offset: 0.2, until: 0.2}, {at: 0.05, kind: remove, agent: 3}]"
ARISE = ("arise_het_4", "faults=[{kind: loss, probability: 0.2}, {at: 0.1, kind: freeze, agent: 3}]")


@pytest.mark.parametrize("run", [("pd_het_4", f"faults={MEMBERS}"), ("pd_het_4", f"faults={OFFSET}"), ARISE])
def test_a_bag_shows_what_its_messages_showed(tmp_path: Path, run: tuple[str, str]) -> None:
    recorded = read_swarm(record(tmp_path / "run", *run))
    assert (recorded.status, recorded.reason, recorded.name) == ("ok", None, None)
    live = SwarmState.of(recorded.scenario.resolved())
    messages = sorted((message for _, _, message in open_bag(tmp_path / "run").decoded()), key=lambda one: one.step)
    for row, (step, said) in enumerate(groupby(messages, key=lambda one: one.step)):
        for message in said:
            live.add(message)
        assert live.instant() == recorded.instant(row)
        assert live.shown_robots(step) == recorded.shown_robots(row)
        assert live.members() == recorded.members(row)
        check_arrays(recorded, row)
    assert row == len(recorded) - 1
    assert list(live.events) == recorded.timed_events()


def check_arrays(recorded: RecordedSwarm, row: int) -> None:
    """Check that the arrays of all robots have in a row what is shown of each."""
    ids = [agent.id for agent in recorded.scenario.agents]
    shown = dict(zip(ids, recorded.shown_robots(row), strict=True))
    for column, robot in enumerate(recorded.arrays.agents.ids.tolist()):
        statuses = [status for status in STATUSES if recorded.have_status(status)[row, column]]
        assert statuses == ([] if shown[robot].status is None else [shown[robot].status])
        (place,) = recorded.coordinates[row, column].tolist()
        assert isnan(place) != recorded.on_plane[row, column]
        if shown[robot].coordinates:
            assert (place,) == shown[robot].coordinates
        if shown[robot].status == "left":
            before = recorded.on_plane[row - 1, column]
            assert not recorded.on_plane[row, column] or before, "on the plane for the last time"


def test_in_real_time_a_moving_reference_counts_from_when_its_law_began(tmp_path: Path) -> None:
    folder = realtime_bag(tmp_path / "bag", "adaptive", since_1970=True)
    begins = {m.step: m.begun for _, _, m in open_bag(folder).decoded([msg.BASIS]) if m.source == msg.Source.CONTROLLER}
    wanted, arrays = configure.reference(read_swarm(folder).scenario), load_arrays(folder)
    expected = [wanted((step - begins[step]) * 0.01) for step in arrays.step.tolist() if step in begins]
    assert arrays.reference[~np.isnan(arrays.reference)] == pytest.approx(expected, rel=1e-12)
    assert len(set(expected)) > 10


@pytest.mark.parametrize(("steps", "status"), [(41, "ok"), (40, "incomplete"), (2, "incomplete")])
def test_a_recording_that_lacks_its_last_steps_is_incomplete(steps: int, status: str, tmp_path: Path) -> None:
    run = [message for message in make_run(40) if message.step < steps]
    recorded = read_swarm(write_bag(tmp_path / "bag", run, {"scenario.yaml": SCENARIO.encode()}))
    reason = None if steps == 41 else f"{steps} of 41 states of the parent system are recorded"
    assert (recorded.status, recorded.reason) == (status, reason)


@pytest.mark.parametrize("since_1970", [False, True])
def test_in_real_time_times_of_law_and_events_count_from_the_start(tmp_path: Path, *, since_1970: bool) -> None:

    def with_a_wrong_clock(stored: Stored) -> tuple[msg.Message, ...]:
        message = stored.message
        return (message._replace(stamp=7) if isinstance(message, msg.SwarmEvent) and message.agent_id else message,)

    folder = realtime_bag(tmp_path / "bag", "deaths", since_1970=since_1970, change=with_a_wrong_clock)
    recorded, period = read_swarm(folder), 0.01
    assert (recorded.status, len(recorded.events) > 3) == ("ok", True)
    bag = open_bag(folder)
    begins = {m.step: m.begun for _, _, m in bag.decoded([msg.BASIS]) if m.source == msg.Source.CONTROLLER}
    wanted = configure.reference(recorded.scenario)
    for step, angle in zip(recorded.arrays.step.tolist(), recorded.arrays.reference.tolist(), strict=True):
        assert (step in begins) != isnan(angle)
        assert step not in begins or angle == wanted((step - begins[step]) * period)
    first = min(message.stamp for _, _, message in bag.decoded(msg.MAIN_TOPICS))
    told = sorted((m for _, _, m in bag.decoded([msg.EVENTS])), key=lambda event: event.step)
    assert [event.stamp for event in recorded.events] == [max(0, event.stamp - first) for event in told]
    assert min(event.stamp for event in recorded.events) == 0 < max(event.stamp for event in recorded.events)
