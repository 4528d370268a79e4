from __future__ import annotations

import pytest

from swarmabs_core.errors import InputError
from swarmabs_core.membership import UNPLANNED, Change, ChangeKind, Membership
from swarmabs_core.messages import EventKind

JOIN, LEAVE, KILL, FREEZE = ChangeKind.JOIN, ChangeKind.LEAVE, ChangeKind.KILL, ChangeKind.FREEZE
REMOVE = ChangeKind.REMOVE


def member(*schedule: Change) -> Membership:
    return Membership([3, 1, 2], schedule)


@pytest.mark.parametrize(
    ("change", "publishes", "first", "event"),
    [
        (Change(5, 2, JOIN), [5, 6, 99], 5, (2, EventKind.JOINED, "")),
        (Change(5, 2, LEAVE), [0, 4, 5], 6, (2, EventKind.LEFT, "leave")),
        (Change(5, 2, KILL), [0, 4, 5], 6, (2, EventKind.DEAD, "kill")),
        (Change(5, 2, FREEZE), [0, 4, 5], 6, (2, EventKind.DEAD, "freeze")),
        (Change(5, 2, REMOVE), [0, 4, 5], 6, (2, EventKind.LEFT, "remove")),
    ],
)
def test_scheduled_change(change: Change, publishes: list[int], first: int, event: tuple[int, EventKind, str]) -> None:
    membership = member(change)
    steps = [0, 4, 5, 6, 99]
    assert [step for step in steps if membership.publishes(2, step)] == publishes
    for step in steps:
        assert membership.publishing(step) == ((1, 2, 3) if step in publishes else (1, 3))
    assert {step: membership.changes(step) for step in range(20) if membership.changes(step)} == {first: [event]}
    assert membership.span(2).stays is (change.kind in {KILL, FREEZE})


def test_robot_that_joins_and_leaves() -> None:
    membership = member(Change(4, 2, LEAVE), Change(2, 2, JOIN))
    assert [step for step in range(8) if membership.publishes(2, step)] == [2, 3, 4]


def test_robot_that_nobody_has_planned_to_join() -> None:
    membership = member(Change(UNPLANNED, 2, JOIN))
    assert [membership.publishing(step) for step in (0, 5, 10**9)] == [(1, 3)] * 3
    assert not any(membership.changes(step) for step in range(20))


def test_join_at_step_0_is_no_change() -> None:
    membership = member(Change(0, 2, JOIN))
    assert membership.publishing(0) == (1, 2, 3)
    assert membership.changes(0) == []


def test_end_at_step_0_holds_from_step_1() -> None:
    membership = member(Change(0, 2, KILL))
    assert [membership.publishing(step) for step in (0, 1)] == [(1, 2, 3), (1, 3)]


def test_changes_of_a_step_are_told_by_robot() -> None:
    membership = member(Change(5, 3, KILL), Change(6, 2, JOIN), Change(5, 1, LEAVE))
    assert [change[0] for change in membership.changes(6)] == [1, 2, 3]


def test_unplanned_end() -> None:
    membership = member()
    assert membership.publishing(7) == (1, 2, 3)
    membership.end(2, 6, stays=True, reason="stalled")
    assert membership.publishing(7) == (1, 3)
    assert membership.changes(7) == [(2, EventKind.DEAD, "stalled")]


def test_an_earlier_end_stands() -> None:
    membership = member(Change(5, 2, LEAVE))
    membership.end(2, 8, stays=True, reason="stalled")
    assert membership.changes(6) == [(2, EventKind.LEFT, "leave")]
    membership.end(2, 3, stays=True, reason="stalled")
    assert membership.changes(4) == [(2, EventKind.DEAD, "stalled")]
    assert membership.span(2).stays


@pytest.mark.parametrize(("kind", "stays"), [(EventKind.DEAD, True), (EventKind.LEFT, False)])
def test_announced_end(kind: EventKind, stays: bool) -> None:  # noqa: FBT001 - a table's column
    membership = member()
    membership.apply(kind, 2, 7, "stalled")
    assert [membership.publishes(2, step) for step in (6, 7)] == [True, False]
    assert membership.span(2).stays is stays


def test_other_events_and_strangers_change_nothing() -> None:
    membership = member()
    for kind, agent_id in ((EventKind.SAFE_STOP, 2), (EventKind.JOINED, 2), (EventKind.DEAD, 9)):
        membership.apply(kind, agent_id, 7, "")
    assert membership.publishing(8) == (1, 2, 3)
    assert 9 not in membership
    assert 2 in membership
    assert not membership.publishes(9, 0)


@pytest.mark.parametrize("change", [Change(500, 3, KILL), Change(0, 65535, JOIN)])
def test_text_of_a_change_is_read_back(change: Change) -> None:
    assert Change.parse(str(change)) == change


def test_text_of_a_change() -> None:
    assert Change.parse("  kill 3   500 ") == Change(500, 3, KILL)


@pytest.mark.parametrize("text", ["", "kill 3", "kill 3 500 1", "kill three 500", "kill 3 5.0", "explode 3 500"])
def test_text_that_is_no_change(text: str) -> None:
    with pytest.raises(InputError, match=r"not of the form 'KIND AGENT STEP' with KIND one of join, leave, kill"):
        Change.parse(text)


def test_change_of_a_stranger() -> None:
    with pytest.raises(InputError, match=r"'kill 9 5': there is no robot 9"):
        member(Change(5, 9, KILL))
