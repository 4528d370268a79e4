"""STOP and RESET over a network that loses, doubles and reorders: what counts is what was said, not when it came."""

from random import Random

import pytest
from hypothesis import given, strategies as st
from tests.swarmabs_core.realtime.nodes import CLOCK, at, broadcasts, follow, kinds, robot, tell

from swarmabs_core.messages import EventKind, Message, Mode, SwarmEvent
from swarmabs_core.realtime.base import Level
from swarmabs_core.realtime.modes import ModeLatch, Orders

AGE, AHEAD = 10, 2
GUARD = AGE + AHEAD


def latch_of() -> ModeLatch:
    return ModeLatch(CLOCK, AGE * CLOCK.period, AHEAD * CLOCK.period)


def is_stopped(latch: ModeLatch, said: list[tuple[Mode, int]]) -> bool:
    for mode, step in said:
        (latch.stop if mode is Mode.STOP else latch.reset)(step)
    return latch.stopped


@given(
    st.lists(st.tuples(st.sampled_from([Mode.STOP, Mode.RESET]), st.integers(0, 60)), max_size=12),
    st.randoms(use_true_random=False),
)
def test_order_and_repetition_make_no_difference(said: list[tuple[Mode, int]], draw: Random) -> None:
    again = said + said[:3]
    draw.shuffle(again)
    assert is_stopped(latch_of(), said) == is_stopped(latch_of(), again)


@given(
    stop=st.integers(0, 5),
    held=st.integers(0, 5),
    lost=st.sets(st.integers(0, 120), max_size=60),
    draw=st.randoms(use_true_random=False),
)
def test_the_operators_reset_opens_whatever_is_lost_or_late(stop: int, held: int, lost: set[int], draw: Random) -> None:
    """STOP for a while, then RESET for 100 periods from the same step on, of which one of the later ones arrives."""
    said = [(Mode.STOP, stop + k) for k in range(held + 1)] + [(Mode.RESET, stop + held + k) for k in range(101)]
    arrived = [(mode, step) for mode, step in said if mode is Mode.STOP or step not in lost]
    draw.shuffle(arrived)
    assert is_stopped(latch_of(), arrived) == all(stop + held + k in lost for k in range(GUARD + 1, 101))


def test_a_latch_closes_and_opens_in_the_order_of_steps_and_does_not_mind_the_clock() -> None:
    latch = latch_of()
    assert is_stopped(latch, [(Mode.RESET, 20), (Mode.STOP, 21)])
    assert is_stopped(latch, [(Mode.RESET, 21 + GUARD)])
    assert not is_stopped(latch, [(Mode.RESET, 22 + GUARD), (Mode.STOP, 21)])
    for resets in ([], [(Mode.RESET, 1100)]):
        latch = latch_of()
        stopped = is_stopped(latch, [(Mode.STOP, 1000), *resets])
        assert stopped == (not resets)
        latch.forget(50)
        assert latch.stopped == stopped
        assert is_stopped(latch, [(Mode.RESET, 50 + GUARD)]) == stopped
        assert not is_stopped(latch, [(Mode.RESET, 51 + GUARD)])


@pytest.mark.parametrize("lead", [0, 1, 2])
def test_who_resets_from_the_future_does_not_overrule_one_who_goes_on_to_say_stop(lead: int) -> None:
    body, node = robot()
    tell(node, broadcasts(9, Mode.STOP), 9.6)
    answers: list[Message] = []
    for step in range(10, 200):
        forged = broadcasts(step + lead, Mode.RESET if step < 110 else Mode.RUN, torque=-3.0)
        for message in (*broadcasts(step, Mode.STOP), *forged):
            answers += node.hear(message, at(step + 0.6))
        node.tick(at(step + 1))
    assert not any(body.commands)
    assert node.health(at(200)).text == "safe stop: stop commanded"
    refused = [m.detail for m in answers if isinstance(m, SwarmEvent) and m.kind == EventKind.REFUSED]
    assert any("mode changes again and again" in detail for detail in refused)


def test_a_contested_reset_is_not_obeyed() -> None:
    body, node = robot()
    for step in range(10, 40):
        tell(node, broadcasts(step + 2, Mode.RESET)[2:], step + 0.6)
        follow(node, step)
    assert not any(body.commands)
    _, node = robot()
    tell(node, broadcasts(10, Mode.STOP), 10.6)
    tell(node, broadcasts(30), 30.6)
    one = broadcasts(11, Mode.RESET)[2]
    assert kinds([*node.hear(one, at(11.6)), *node.hear(one._replace(torque=1.0), at(11.6))]) == [EventKind.REFUSED]
    node.tick(at(12))
    assert node.health(at(12))[:2] == (Level.WARN, "safe stop: stop commanded"), "somebody wants it so"


def test_a_mode_that_changes_within_a_step_accuses_nobody() -> None:
    """RUN then STOP, STOP then RESET, RESET then RUN of the same step; STOP once more has another stamp."""
    body, node = robot()
    run, stop, reset = Mode.RUN, Mode.STOP, Mode.RESET
    said = {10: (run, stop, stop), 11: (stop,), 12: (stop, reset), **dict.fromkeys(range(13, 112), (reset,))}
    said |= {112: (reset, run), 113: (run,), 114: (run,)}
    answers: list[Message] = []
    for step, modes in said.items():
        for stamp, mode in enumerate(modes):
            abstract, sums, desired = broadcasts(step, mode)
            for message in (abstract, sums, desired._replace(stamp=stamp)):
                answers += node.hear(message, at(step + 0.6))
        answers += node.tick(at(step + 1))
        assert any(body.commands) == (step > 112), step
    assert EventKind.REFUSED not in kinds(answers)


@pytest.mark.parametrize(
    ("hour", "change"),
    [(1000.6, {"torque": float("nan")}), (2000.6, {}), (1000.6, {"mode": 77})],
)
def test_a_reset_that_is_refused_is_not_obeyed(hour: float, change: dict[str, float]) -> None:
    _, node = robot()
    tell(node, broadcasts(10, Mode.STOP), 10.6)
    reset = broadcasts(1000, Mode.RESET)[2]._replace(**change)
    assert kinds(node.hear(reset, at(hour))) == [EventKind.REFUSED]
    tell(node, broadcasts(round(hour)), hour + 1)
    node.tick(at(hour + 1.4))
    assert node.health(at(hour + 1.4)).text == "safe stop: stop commanded"


@pytest.mark.parametrize(("late", "obeyed"), [(300, True), (301, False)])
def test_a_reset_that_comes_late_is_obeyed_for_some_time(late: int, *, obeyed: bool) -> None:
    """At an overload it may be outdated wherever it arrives."""
    body, node = robot()
    tell(node, broadcasts(10, Mode.STOP), 10.6)
    assert kinds(node.hear(broadcasts(100, Mode.RESET)[2], at(100.6 + late))) == [EventKind.REFUSED]
    follow(node, 101 + late)
    assert any(body.commands) is obeyed


def test_an_old_reset_does_not_open_the_latch_after_the_clock_was_set_back() -> None:
    body, node = robot()
    follow(node, 1000, Mode.STOP)
    node.tick(at(6))
    tell(node, broadcasts(5, Mode.RESET), 6.1)
    follow(node, 7)
    assert not any(body.commands)
    tell(node, broadcasts(30, Mode.RESET), 30.6)
    follow(node, 31)
    assert any(body.commands)
    tell(node, broadcasts(32, Mode.STOP), 1000.6)  # an outdated stop is obeyed
    body.commands.clear()
    follow(node, 1001)
    assert not any(body.commands)


orders = st.builds(Orders, st.integers(-1, 60), st.integers(-1, 60))


@given(st.lists(orders, max_size=6), st.randoms(use_true_random=False))
def test_orders_of_robots_join_in_any_order(heard: list[Orders], draw: Random) -> None:
    again = heard + heard[:3]
    draw.shuffle(again)
    one, other = Orders(), Orders()
    for order in heard:
        one = one.joined(order)
    for order in again:
        other = other.joined(order)
    assert one == other


@given(orders, st.integers(0, 60))
def test_an_order_holds_against_what_is_known_where_it_is_given(known: Orders, step: int) -> None:
    assert known.stopped(step).stops(GUARD)
    assert not known.released(step, GUARD).stops(GUARD)


@given(st.integers(0, 60), st.integers(-GUARD, GUARD))
def test_of_orders_that_do_not_know_of_each_other_within_the_guard_the_stop_holds(step: int, later: int) -> None:
    stop, reset = Orders().stopped(step), Orders().released(max(0, step + later), GUARD)
    assert stop.joined(reset).stops(GUARD)
