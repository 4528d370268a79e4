import pytest

from swarmabs_core.errors import InputError
from swarmabs_core.membership import UNPLANNED, Change, ChangeKind, Membership
from swarmabs_core.messages import EventKind

JOIN, LEAVE, KILL, FREEZE, REMOVE = map(ChangeKind, ("join", "leave", "kill", "freeze", "remove"))


def member(*schedule: Change) -> Membership:
    return Membership([3, 1, 2], schedule)


@pytest.mark.parametrize(
    ("change", "publishes", "first", "event"),
    [
        (Change(5, 2, JOIN), [5, 6, 99], 5, (EventKind.JOINED, "")),
        (Change(5, 2, LEAVE), [0, 4, 5], 6, (EventKind.LEFT, "leave")),
        (Change(5, 2, KILL), [0, 4, 5], 6, (EventKind.DEAD, "kill")),
        (Change(5, 2, FREEZE), [0, 4, 5], 6, (EventKind.DEAD, "freeze")),
        (Change(5, 2, REMOVE), [0, 4, 5], 6, (EventKind.LEFT, "remove")),
        (Change(0, 2, KILL), [0], 1, (EventKind.DEAD, "kill")),
        (Change(0, 2, JOIN), [0, 4, 5, 6, 99], 0, None),
        (Change(UNPLANNED, 2, JOIN), [], 0, None),
    ],
)
def test_scheduled_change(
    change: Change, publishes: list[int], first: int, event: tuple[EventKind, str] | None
) -> None:
    membership = member(change)
    steps = [0, 4, 5, 6, 99]
    assert [step for step in steps if membership.publishes(2, step)] == publishes
    for step in steps:
        assert membership.publishing(step) == ((1, 2, 3) if step in publishes else (1, 3))
    told = {step: membership.changes(step) for step in range(20) if membership.changes(step)}
    assert told == ({first: [(2, *event)]} if event else {})
    assert membership.span(2).stays is (change.kind in {KILL, FREEZE})


def test_changes_of_a_step_are_told_by_robot_and_a_robot_may_join_and_leave() -> None:
    membership = member(Change(5, 3, KILL), Change(6, 2, JOIN), Change(5, 1, LEAVE), Change(8, 2, LEAVE))
    assert [change[0] for change in membership.changes(6)] == [1, 2, 3]
    assert [step for step in range(12) if membership.publishes(2, step)] == [6, 7, 8]


def test_the_earliest_end_of_a_robot_stands() -> None:
    membership = member(Change(9, 2, LEAVE))
    assert membership.publishing(7) == (1, 2, 3)
    membership.end(2, 6, stays=True, reason="stalled")
    assert membership.publishing(7) == (1, 3), "also where it has been asked before"
    assert membership.changes(7) == [(2, EventKind.DEAD, "stalled")]
    membership.end(2, 6, stays=False, reason="late")
    membership.plan(Change(8, 2, LEAVE))
    assert membership.changes(7) == [(2, EventKind.DEAD, "stalled")]
    membership.plan(Change(5, 1, JOIN))
    assert membership.publishing(4) == (2, 3)


def test_a_robot_that_ends_before_it_joins_never_joins() -> None:
    membership = member(Change(5, 2, JOIN))
    membership.end(2, 2, stays=True, reason="silent")
    told = {step: membership.changes(step) for step in range(20) if membership.changes(step)}
    assert told == {3: [(2, EventKind.DEAD, "silent")]}


@pytest.mark.parametrize(
    ("kind", "agent_id", "end"),
    [
        (EventKind.DEAD, 2, (6, True)),
        (EventKind.LEFT, 2, (6, False)),
        (EventKind.SAFE_STOP, 2, (None, False)),
        (EventKind.JOINED, 2, (None, False)),
        (EventKind.DEAD, 9, (None, False)),
    ],
)
def test_only_announced_ends_of_members_hold(kind: EventKind, agent_id: int, end: tuple[int | None, bool]) -> None:
    membership = member()
    membership.apply(kind, agent_id, 7, "stalled")
    assert (membership.span(2).last, membership.span(2).stays) == end
    assert (9 in membership, 2 in membership, membership.publishes(9, 0)) == (False, True, False)


def test_a_change_in_writing() -> None:
    assert Change.parse("  kill 3   500 ") == Change(500, 3, KILL)
    assert Change.parse(str(Change(0, 65535, JOIN))) == Change(0, 65535, JOIN)
    for text in ("", "kill 3", "kill 3 500 1", "kill three 500", "kill 3 5.0", "explode 3 500"):
        with pytest.raises(InputError, match=r"not of the form 'KIND AGENT STEP' with KIND one of join, leave, kill"):
            Change.parse(text)
    with pytest.raises(InputError, match=r"'kill 9 5': there is no robot 9"):
        member(Change(5, 9, KILL))
