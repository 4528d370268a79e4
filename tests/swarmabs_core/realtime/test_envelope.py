"""Whatever a robot is asked to do, it stays in its lane, and what is harmless is left alone."""

import math
from collections.abc import Iterable
from random import Random

import pytest
from hypothesis import example, given, settings, strategies as st

from swarmabs_core.messages import Kind
from swarmabs_core.realtime.envelope import LaneEnvelope, Unmeasured
from swarmabs_core.robot_controller import Limits, RobotController
from swarmabs_core.swarm_law import PAPER, Robot, SwarmGains

GAINS = SwarmGains((10.0, 10.0), (10.0, 10.0), (5.0, 5.0), 1.0)
LANE = 0.48
FREE = Limits()

periods = st.sampled_from([0.002, 0.01, 0.05, 0.1])
commands = st.lists(st.floats(-1e3, 1e3) | st.sampled_from([0.0, 1e300, -1e300, 5.0, -5.0]), min_size=1, max_size=80)


def envelope(
    kind: Kind, period: float, mass: float = 0.5, damping: float = 0.0, limits: Limits = FREE, slowing: float = math.inf
) -> tuple[RobotController, LaneEnvelope]:
    controller = RobotController(Robot(kind, mass, damping, GAINS, 9.81, period), PAPER.name, {}, limits, 1.0)
    return controller, LaneEnvelope(controller, period, LANE, slowing)


def drive_about(
    controller: RobotController, lane: LaneEnvelope, start: float, commands: Iterable[tuple[float, int]]
) -> float:
    """Return how far from the axis a robot comes that holds each command for one period, or for two."""
    p, v, farthest = start, 0.0, abs(start)
    for command, periods in commands:
        limited = controller.limit(v, command)
        kept = lane.apply(p, v, limited)
        assert min(limited, controller.brake(v), 0.0) <= kept <= max(limited, controller.brake(v), 0.0)
        for _ in range(periods):
            p, v = controller.ideal.advance(p, v, kept)
            farthest = max(farthest, abs(p))
    return farthest


@given(
    commands,
    st.randoms(use_true_random=False),
    st.floats(-LANE, LANE),
    st.fixed_dictionaries({"mass": st.floats(0.1, 5.0), "damping": st.floats(0.0, 3.0), "period": periods}),
    st.builds(Limits, st.just(math.inf) | st.floats(0.05, 3.0), st.just(math.inf) | st.floats(0.05, 20.0)),
)
@settings(max_examples=100, deadline=None)
def test_a_double_integrator_never_leaves_its_lane(
    commands: list[float], lateness: Random, start: float, body: dict[str, float], limits: Limits
) -> None:
    controller, lane = envelope(Kind.DOUBLE_INTEGRATOR, limits=limits, **body)
    held = [(command, lateness.choice((1, 2))) for command in commands for _ in range(5)]
    assert drive_about(controller, lane, start, held) <= LANE + 1e-9


@pytest.mark.parametrize(
    ("force", "period"), [(2.0, 0.002), *((force, period) for force in (0.3, 2.0, 40.0) for period in (0.01, 0.1))]
)
def test_a_robot_pushed_all_the_way_stops_just_before_the_end(force: float, period: float) -> None:
    controller, lane = envelope(Kind.DOUBLE_INTEGRATOR, period, mass=1.0, limits=Limits(force=force))
    for held in (1, 2):
        farthest = drive_about(controller, lane, -LANE, [(1e9, held)] * round(20.0 / period))
        assert 0.8 * LANE < farthest <= LANE + 1e-9


@given(commands, st.floats(-LANE, LANE), periods)
@settings(max_examples=60, deadline=None)
def test_a_single_integrator_stays_when_commands_are_held_twice(commands: list[float], p: float, period: float) -> None:
    _, lane = envelope(Kind.SINGLE_INTEGRATOR, period)
    for command in commands:
        kept = lane.apply(p, 0.0, command)
        assert abs(kept) <= abs(command)
        assert kept * command >= 0.0
        p += 2.0 * period * kept
        assert abs(p) <= LANE + 1e-9


@given(commands, st.randoms(use_true_random=False), st.floats(-LANE, LANE), periods)
@settings(max_examples=60, deadline=None)
def test_a_single_integrator_stays_while_its_sensor_is_silent(
    commands: list[float], draw: Random, start: float, period: float
) -> None:
    controller, lane = envelope(Kind.SINGLE_INTEGRATOR, period)
    unmeasured = Unmeasured(controller, period)
    p = measured = start
    step, stamp, kept = 0, 0, 0.0
    for command in commands * 3:
        if draw.random() < 0.4:
            measured, stamp = p, step
        unmeasured.note(step, stamp, kept)
        kept = lane.apply(measured + unmeasured.distance, 0.0, command)
        held = draw.choice((1, 1, 2))
        step, p = step + held, p + held * period * kept
        assert abs(p) <= LANE + 1e-9


@given(commands=commands, deceleration=st.floats(0.1, 10.0))
@settings(max_examples=40, deadline=None)
def test_a_base_that_brakes_slowly_can_still_stop(commands: list[float], deceleration: float) -> None:
    period = 0.01
    _, lane = envelope(Kind.SINGLE_INTEGRATOR, period, slowing=deceleration)
    p = 0.0
    for command in commands:
        speed = lane.apply(p, 0.0, min(max(command, -3.0), 3.0))
        p += speed * period
        # The next command is late by one period; then the base brakes as hard as it can.
        assert abs(p + speed * period + math.copysign(speed * speed / (2.0 * deceleration), speed)) <= LANE + 1e-9


@pytest.mark.parametrize("kind", list(Kind))
def test_a_robot_beyond_its_lane_may_only_come_back(kind: Kind) -> None:
    controller, lane = envelope(kind, period=0.01)
    assert lane.apply(0.49, 0.0, 1.0) == controller.brake(0.0) == 0.0
    assert lane.apply(0.49, 0.0, -0.1) == -0.1
    assert lane.apply(-0.49, 0.0, 0.1) == 0.1


@given(st.floats(-0.1, 0.1), st.floats(-0.2, 0.2), st.floats(-0.5, 0.5))
@example(0.0, 5e-324, 0.0)
def test_far_from_the_ends_nothing_is_changed(position: float, velocity: float, command: float) -> None:
    for kind in Kind:
        assert envelope(kind, period=0.01)[1].apply(position, velocity, command) == command
