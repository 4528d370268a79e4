"""Single nodes in real time: what they do with their clock, their drive and messages that should not be."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan

import pytest
from tests.swarmabs_core.realtime.nodes import (
    CLOCK,
    Body,
    at,
    broadcasts,
    controller,
    desired,
    kinds,
    observer,
    robot,
    scenario,
    state_of,
    states,
    sums,
    tell,
)

from swarmabs_config import realtime as configure
from swarmabs_core.abstraction import Weight, abstraction, second_moments
from swarmabs_core.errors import InputError
from swarmabs_core.messages import (
    NEVER,
    AbstractState,
    AuxiliaryState,
    EventKind,
    Kind,
    Mode,
    PlaneState,
    Status,
    SwarmEvent,
)
from swarmabs_core.realtime.agent import HELD, RealtimeAgent
from swarmabs_core.realtime.base import Level, StepCounter
from swarmabs_core.realtime.observer import RealtimeObserver, Role
from swarmabs_core.realtime.plane import RealtimePlane
from swarmabs_core.realtime.validation import QUIET_NS, Refusals


def test_a_state_tells_the_command_that_led_to_it() -> None:
    body = Body()
    node = robot(body)
    assert state_of(node.tick(at(10))).broadcast_step == NEVER
    tell(node, broadcasts(10), 10.6)
    node.tick(at(11))
    assert body.commands[-1] != 0.0
    later = state_of(node.tick(at(12)))
    assert (later.command, later.broadcast_step, later.status) == (body.commands[-2], 10, Status.ACTIVE)


@pytest.mark.parametrize("missing", [0, 1, 2])
def test_two_broadcasts_of_three_are_not_followed(missing: int) -> None:
    body = Body()
    node = robot(body)
    tell(node, [m for i, m in enumerate(broadcasts(10)) if i != missing], 10.6)
    node.tick(at(11))
    assert body.commands == [0.0]


def test_the_newest_complete_broadcasts_count_in_whatever_order_they_came() -> None:
    one, two = Body(), Body()
    first, second = robot(one), robot(two)
    tell(first, (*broadcasts(10, torque=0.1), *broadcasts(11, torque=0.7)), 11.6)
    mixed = [*reversed(broadcasts(11, torque=0.7)), *reversed(broadcasts(10, torque=0.1)), *broadcasts(12)[:2]]
    tell(second, mixed, 11.6)
    first.tick(at(12))
    second.tick(at(12))
    assert one.commands == two.commands != [0.0]


def test_broadcasts_are_followed_up_to_their_age_limit_and_not_longer() -> None:
    body = Body()
    node = robot(body)
    tell(node, broadcasts(10), 10.6)
    for step in range(11, 21):
        node.tick(at(step))
        assert body.commands[-1] != 0.0, step
    answer = node.tick(at(21))
    assert body.commands[-1] == 0.0
    assert EventKind.SAFE_STOP in kinds(answer)
    assert state_of(node.tick(at(22))).status == Status.SAFE_STOP
    assert node.health(at(22)).level is Level.ERROR
    tell(node, broadcasts(22), 22.6)
    assert EventKind.RECOVERED in kinds(node.tick(at(23)))


def test_a_double_integrator_brakes_in_a_safe_stop() -> None:
    body = Body(velocity=0.3)
    robot(body).tick(at(0))
    assert body.commands == [pytest.approx(-0.6762 * 0.3 / 0.1)]


@pytest.mark.parametrize("trouble", ["blind", "old", "nan", "ahead"])
def test_a_robot_that_does_not_know_where_it_is_stops(trouble: str) -> None:
    body = Body()
    node = robot(body)
    tell(node, broadcasts(10), 10.6)
    node.tick(at(11))
    body.blind = trouble == "blind"
    if trouble == "nan":
        body.position = nan
    else:
        body.stamp = {"old": at(11), "ahead": at(40), "blind": None}[trouble]
    for step in range(12, 24):
        tell(node, broadcasts(step - 1), step - 0.4)
        answer = node.tick(at(step))
    assert body.commands[-1] == 0.0
    state = state_of(answer)
    assert state.status == Status.SAFE_STOP
    assert state.position == 0.1
    assert "measurement" in node.health(at(23)).text


def test_a_clock_that_is_set_back_stops_the_robot_and_no_step_is_made_twice() -> None:
    body = Body()
    node = robot(body)
    tell(node, broadcasts(1000), 1000.6)
    node.tick(at(1001))
    assert node.tick(at(1001.3)) == ()
    assert body.commands[-1] != 0.0
    assert EventKind.SAFE_STOP in kinds(node.tick(at(500)))
    assert body.commands[-1] == 0.0
    assert state_of(node.tick(at(501))).status == Status.SAFE_STOP


def test_before_the_epoch_nothing_happens() -> None:
    body = Body()
    assert robot(body).tick(at(-1)) == ()
    assert body.commands == []


def test_deactivation_leaves_the_body_safe() -> None:
    body = Body()
    node = robot(body)
    node.halt()
    node.halt()
    assert body.stops == 2
    assert node.health(at(0)).text == "safe stop: deactivated"


def test_a_reset_that_was_overtaken_by_a_stop_does_not_count() -> None:
    body = Body()
    node = robot(body)
    for step, mode in ((10, Mode.RESET), (12, Mode.STOP), (11, Mode.RESET), (12, Mode.RESET)):
        tell(node, broadcasts(step, mode)[2:], 12.6)
    tell(node, broadcasts(13), 13.6)
    node.tick(at(14))
    assert body.commands == [0.0]
    tell(node, broadcasts(30, Mode.RESET)[2:], 30.6)
    tell(node, broadcasts(31), 31.6)
    node.tick(at(32))
    assert body.commands[-1] != 0.0


def test_a_law_without_a_finite_command_stops_the_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    body = Body()
    node = robot(body)
    monkeypatch.setattr(node._law.controller, "follow", lambda *_: inf)
    tell(node, broadcasts(10), 10.6)
    node.tick(at(11))
    assert body.commands == [0.0]
    assert "finite" in node.health(at(11)).text


def test_a_swarm_without_spread_is_waited_for() -> None:
    body = Body()
    node = robot(body)
    abstract, sums, desired = broadcasts(10)
    assert isinstance(sums, AuxiliaryState)
    nobody = sums._replace(s0=0.0, s1=0.0, s2=0.0, s3=0.0)
    tell(node, (abstract, nobody, desired), 10.6)
    assert kinds(node.tick(at(11))) == [EventKind.HELD]
    assert body.commands == [0.0]
    later = state_of(node.tick(at(12)))
    assert (later.status, later.broadcast_step) == (Status.ACTIVE, NEVER)
    assert HELD in node.health(at(12)).text


def test_roles_decide_what_a_robot_counts_in() -> None:
    node = observer()
    first, second, third, fourth = states(5)
    for state in (first, second._replace(status=Status.SAFE_STOP), third, fourth):
        node.hear(state, at(5.2))
    node.tick(at(5.5))
    for step in range(6, 16):
        node.hear(first._replace(step=step), at(step + 0.2))
        node.hear(second._replace(step=step, status=Status.SAFE_STOP), at(step + 0.2))
        status = Status.LEFT if step > 10 else Status.ACTIVE
        node.hear(third._replace(step=step, status=status), at(step + 0.2))
        answer = node.tick(at(step + 0.5))
    answer = node.tick(at(16.5))
    assert node.roles == {1: Role.ACTIVE, 2: Role.STOPPED, 3: Role.LEFT, 4: Role.SILENT}
    abstract, auxiliary = sums(answer)
    on_plane = [Weight(s.mass, s.position, 0.0 if s.agent_id == 4 else s.velocity) for s in (first, second, fourth)]
    *expected, q = abstraction(on_plane, 9.81)
    assert abstract[2:] == (3, *expected)
    assert auxiliary[2:] == (*second_moments([(first.mass, first.position)]), 0.0, 0.0, 0.0, q)


def test_two_robots_with_one_id_are_noticed() -> None:
    node = observer()
    state = states(5)[0]
    assert node.hear(state, at(5.2)) == ()
    assert node.hear(state, at(5.2)) == ()
    assert kinds(node.hear(state._replace(position=-0.3), at(5.2))) == [EventKind.REFUSED]


def test_an_observer_with_too_few_robots_says_so_and_publishes_nothing() -> None:
    node = observer()
    for state in states(5)[:3]:
        node.hear(state, at(5.2))
    assert not [m for m in node.tick(at(5.5)) if isinstance(m, AbstractState)]
    assert "3 heard, 4 needed" in node.health(at(5.5)).text


def test_outdated_states_do_not_start_the_swarm() -> None:
    node = observer()
    for state in states(5):
        node.hear(state, at(100_000.2))
    assert not [m for m in node.tick(at(100_000.5)) if isinstance(m, AbstractState)]
    assert "0 heard, 4 needed" in node.health(at(100_000.5)).text
    for state in states(100_001):
        node.hear(state, at(100_001.2))
    assert [m for m in node.tick(at(100_001.5)) if isinstance(m, AbstractState)]


def test_a_robot_that_was_silent_before_the_observer_began_is_known_nevertheless() -> None:
    dead = states(5)[3]
    node = RealtimeObserver(configure.observer_config(scenario(), CLOCK), {4: dead})
    for state in states(100)[:3]:
        assert state.broadcast_step == NEVER
        node.hear(state, at(100.2))
    abstract, _ = sums(node.tick(at(100.5)))
    assert abstract.agent_count == 4


def test_missed_states_of_the_plane_are_caught_up() -> None:
    """The plane stands still here, so that it makes no difference whether its states were heard."""
    whole, gaps = controller(), controller()
    for step in range(30):
        wanted = desired(whole.hear(PlaneState(0, step, 0.05, 0.0), at(step + 0.5)))
        if step in (0, 3, 4, 9, 29):
            got = desired(gaps.hear(PlaneState(0, step, 0.05, 0.0), at(step + 0.5)))
            assert got == wanted


@pytest.mark.parametrize(
    "state",
    [
        PlaneState(0, 5, nan, 0.0),
        PlaneState(0, 5, 0.1, inf),
        PlaneState(0, 5, 9.0, 0.0),
        PlaneState(0, 2**63, 0.1, 0.0),
        PlaneState(0, 0, 0.1, 0.0),
    ],
)
def test_a_state_of_the_plane_that_cannot_be_true_is_not_answered(state: PlaneState) -> None:
    node = controller()
    assert kinds(node.hear(state, at(30.5))) == [EventKind.REFUSED]


def test_a_plane_too_steep_to_hold_stops_the_swarm() -> None:
    node = controller()
    answer = node.hear(PlaneState(0, 5, 1.55, 0.0), at(5.5))
    assert desired(answer).mode == Mode.STOP
    assert EventKind.MODE_CHANGED in kinds(answer)
    assert desired(node.hear(PlaneState(0, 6, 0.0, 0.0), at(6.5))).mode == Mode.STOP


def test_a_swarm_that_waits_for_a_reset_is_told_so_without_a_plane() -> None:
    node = controller(Mode.STOP)
    assert desired(node.tick(at(3.75))).mode == Mode.STOP
    node.reset(at(4))
    modes = {desired(node.tick(at(step + 0.75))).mode for step in range(5, 103)}
    assert modes == {Mode.RESET}
    node.tick(at(104.75))
    assert node._mode is Mode.RUN
    assert node._first_step is None
    assert desired(node.hear(PlaneState(0, 105, 0.1, 0.0), at(105.5))).mode == Mode.RUN
    assert node._first_step == 105


def test_only_one_desired_state_of_a_mode_is_published_per_step() -> None:
    node = controller(Mode.STOP)
    first = [*node.hear(PlaneState(0, 5, 0.1, 0.0), at(5.5)), *node.tick(at(5.75))]
    assert len(first) == 1


def test_the_plane_is_held_until_a_robot_follows() -> None:
    node = RealtimePlane(configure.plane_config(scenario(), CLOCK))
    for step in range(10):
        for state in states(step):
            node.hear(state, at(step + 0.1))
        _, held = node.tick(at(step + 0.5))
        assert held[2:] == (0.1, 0.0)
    node.hear(states(10, broadcast_step=9)[0], at(10.1))
    node.tick(at(10.5))
    _, moved = node.tick(at(11.5))
    assert moved[2:] != (0.1, 0.0)


def test_a_plane_that_was_late_makes_up_for_it() -> None:
    late, punctual = (RealtimePlane(configure.plane_config(scenario(), CLOCK)) for _ in range(2))
    for node in (late, punctual):
        for state in states(0, broadcast_step=0, velocity=0.0):
            node.hear(state, at(0.1))
        node.tick(at(0.5))
    for step in range(1, 21):
        _, expected = punctual.tick(at(step + 0.5))
    _, caught_up = late.tick(at(20.5))
    assert caught_up == expected


def test_refusals_are_counted_and_reported_now_and_then() -> None:
    book = Refusals(7)
    (first,) = book.add("nonsense", 3, 0)
    assert isinstance(first, SwarmEvent)
    assert (first.agent_id, first.detail, first.value) == (7, "nonsense", 1.0)
    assert all(book.add("nonsense", 3, k) == () for k in range(1, 100))
    (again,) = book.add("nonsense", 3, QUIET_NS)
    assert isinstance(again, SwarmEvent)
    assert again.value == 100.0
    reported = sum(bool(book.add(f"reason {k}", 3, 0)) for k in range(10_000))
    assert reported < 200


def test_steps_are_made_once() -> None:
    counter = StepCounter(CLOCK)
    made = [counter.next(at(k)) for k in (-1, 0, 0.5, 1, 3, 2, 4)]
    assert made == [None, 0, None, 1, 3, None, 4]
    assert counter.next(at(0)) is None
    assert counter.last is None
    assert counter.next(at(0.1)) == 0


@pytest.mark.parametrize(
    "override",
    ["plane.robot_gravity=true", "swarm.actuator_lag=0.1", "faults=[{kind: kill, at: 1, agent: 1}]"],
)
def test_what_there_is_in_lockstep_only_is_refused(override: str) -> None:
    with pytest.raises(InputError, match=override.split("=", maxsplit=1)[0]):
        configure.check_realtime(scenario(override))


def test_limits_come_from_the_scenario() -> None:
    made = scenario("limits={velocity: 0.2, force: 1.5}", "realtime.lane_margin=0.1")
    config = configure.agent_configs(made, CLOCK)[2]
    assert (config.lane_limit, config.limits.velocity, config.limits.force) == (0.4, 0.2, 1.5)
    assert config.kind is Kind.DOUBLE_INTEGRATOR
    body = Body(position=0.1)
    node = RealtimeAgent(replace(config, law_settings={}), body)
    tell(node, broadcasts(10, torque=5.0), 10.6)
    node.tick(at(11))
    assert 0.0 < abs(body.commands[-1]) <= 1.5
