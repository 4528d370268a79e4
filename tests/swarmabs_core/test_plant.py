from __future__ import annotations

from itertools import pairwise
from math import inf, nan
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline

from swarmabs_core.errors import RunError
from swarmabs_core.plant import (
    Disturbance,
    Friction,
    Plane,
    PlaneDynamics,
    RobotPath,
    SwarmLoad,
    hermite,
    standing,
    straight,
    swarm_load,
)

G = 9.81
NONE = Friction(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
SMOOTH = Friction(0.3, 3.0, 2.0, 0.2, 3.0, 0.5)
PAPER = Friction(0.01, 1000.0, 700.0, 0.02, 1000.0, 1.0)
CALM = Disturbance(0.0, 0.5)

numbers = st.floats(-2.0, 2.0)
bodies = st.floats(0.1, 2.0)
paths = st.one_of(
    st.builds(standing, bodies, numbers),
    st.builds(straight, bodies, numbers, numbers),
    st.builds(hermite, bodies, st.tuples(numbers, numbers), st.tuples(numbers, numbers), bodies),
)


class Mover(NamedTuple):
    """A robot between two states, and its position and velocity at a time by SciPy's spline."""

    mass: float
    start: tuple[float, float]
    end: tuple[float, float]

    def at(self, t: float, period: float) -> tuple[float, float]:
        spline = CubicHermiteSpline([0.0, period], *zip(self.start, self.end, strict=True))
        return float(spline(t)), float(spline(t, 1))


MOVERS = (
    Mover(0.4, (0.12, 0.3), (0.2, -0.2)),
    Mover(0.7, (-0.3, -0.1), (-0.1, 0.5)),
    Mover(0.5, (0.05, 0.0), (0.05, 0.0)),
)


def reference(
    start: tuple[float, float], period: float, friction: Friction, disturbance: Disturbance, time: float
) -> tuple[float, float]:
    """Solve the plane under `MOVERS` from the equation of motion."""

    def rhs(t: float, x: np.ndarray) -> list[float]:
        th, w = x
        moving = [(r.mass, *r.at(t, period)) for r in MOVERS]
        tau = G * sum(m * p for m, p, _ in moving)
        inertia = sum(m * p * p for m, p, _ in moving)
        rate = 2.0 * sum(m * p * v for m, p, v in moving)
        f = friction.g1 * (np.tanh(friction.g2 * w) - np.tanh(friction.g3 * w))
        f += friction.g4 * np.tanh(friction.g5 * w) + friction.g6 * w
        tau_d = disturbance.amplitude * np.sin(disturbance.angular_frequency * (time + t))
        return [w, (-np.cos(th) * tau - rate * w - f - tau_d) / (0.5 + inertia)]

    return tuple(solve_ivp(rhs, (0.0, period), start, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1])


def dynamics(
    period: float, substep: float, friction: Friction = NONE, disturbance: Disturbance = CALM
) -> PlaneDynamics:
    return PlaneDynamics(Plane(friction=friction, disturbance=disturbance, substep=substep), period)


def load_of_movers(period: float) -> SwarmLoad:
    return swarm_load([hermite(r.mass, r.start, r.end, period) for r in MOVERS], G)


@given(bodies, numbers, numbers, numbers, numbers, bodies)
def test_hermite_path_meets_both_states(mass: float, p0: float, v0: float, p1: float, v1: float, period: float) -> None:
    m, *c = hermite(mass, (p0, v0), (p1, v1), period)
    path = np.polynomial.Polynomial(c)
    assert m == mass
    assert [path(0.0), path(1.0)] == pytest.approx([p0, p1], abs=1e-13)
    assert [path.deriv()(0.0), path.deriv()(1.0)] == pytest.approx([v0 * period, v1 * period], abs=1e-13)


def test_simple_paths() -> None:
    assert standing(0.5, 0.1) == RobotPath(0.5, 0.1, 0.0, 0.0, 0.0)
    assert straight(0.5, 0.125, 0.375) == RobotPath(0.5, 0.125, 0.25, 0.0, 0.0)


@given(st.lists(paths, max_size=12), st.floats(0.0, 1.0))
def test_load_is_the_sum_over_the_paths(robots: list[RobotPath], s: float) -> None:
    load = swarm_load(robots, G)
    positions = [np.polynomial.Polynomial(path[1:])(s) for path in robots]
    weights = [path.mass for path in robots]
    bound = 1e-13 * (1.0 + sum(m * sum(map(abs, c)) ** 2 for m, *c in robots)) * 50
    torque = np.polynomial.Polynomial(load.torque)(s)
    inertia = np.polynomial.Polynomial(load.inertia)(s)
    assert torque == pytest.approx(G * np.dot(weights, positions), abs=bound * G)
    assert inertia == pytest.approx(np.dot(weights, np.square(positions)), abs=bound)


@given(st.lists(paths, min_size=1, max_size=12).flatmap(lambda x: st.tuples(st.just(x), st.permutations(x))))
def test_load_does_not_depend_on_the_order(case: tuple[list[RobotPath], list[RobotPath]]) -> None:
    assert swarm_load(case[0], G) == swarm_load(case[1], G)


def test_moving_plane_agrees_with_scipy() -> None:
    disturbance = Disturbance(0.4, 5.0)
    found = dynamics(0.2, 0.001, SMOOTH, disturbance).advance(0.2, -0.3, 1.7, load_of_movers(0.2))
    assert found == pytest.approx(reference((0.2, -0.3), 0.2, SMOOTH, disturbance, 1.7), abs=1e-11)


def test_method_is_of_fourth_order() -> None:
    period = 0.4
    exact = np.array(reference((0.2, -0.3), period, SMOOTH, CALM, 0.0))
    errors = [
        np.abs(dynamics(period, h, SMOOTH).advance(0.2, -0.3, 0.0, load_of_movers(period)) - exact).max()
        for h in (0.04, 0.02, 0.01)
    ]
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.3)
    assert errors[1] / errors[2] == pytest.approx(16.0, rel=0.3)


def test_stiff_friction_of_the_paper_is_resolved() -> None:
    """The plane swings through rest, where the friction's slope is 24 times that of its viscous part."""
    found = dynamics(0.2, 0.001, PAPER).advance(0.2, 0.01, 0.0, load_of_movers(0.2))
    assert found == pytest.approx(reference((0.2, 0.01), 0.2, PAPER, CALM, 0.0), abs=1e-7)


def test_energy_is_kept_without_friction_by_standing_robots() -> None:
    load = swarm_load([standing(0.4, 0.3), standing(0.5, -0.1)], G)
    tau, inertia = load.torque[0], 0.5 + load.inertia[0]

    def energy(th: float, w: float) -> float:
        return 0.5 * inertia * w * w + tau * np.sin(th)

    plane, state = dynamics(0.01, 0.001), (0.3, 0.5)
    before = energy(*state)
    for k in range(500):
        state = plane.advance(*state, k * 0.01, load)
    assert energy(*state) == pytest.approx(before, rel=1e-10)
    assert abs(state[0] - 0.3) > 0.1


def test_angular_momentum_is_kept_without_torque() -> None:
    """Robots that move symmetrically exert no torque: (J + Js) w stays what it is."""
    load = swarm_load([straight(0.5, 0.1, 0.3), straight(0.5, -0.1, -0.3)], G)
    _, w = dynamics(0.5, 0.001).advance(0.1, 0.8, 0.0, load)
    assert (0.5 + 0.09) * w == pytest.approx((0.5 + 0.01) * 0.8, rel=1e-12)


def test_friction_takes_energy_away() -> None:
    still = swarm_load([], G)
    state, speeds = (0.0, 1.0), [1.0]
    for _ in range(50):
        state = dynamics(0.01, 0.001, PAPER).advance(*state, 0.0, still)
        speeds.append(state[1])
    assert all(b < a for a, b in pairwise(speeds))
    assert speeds[-1] > 0.0


@pytest.mark.parametrize(
    ("substep", "same_as"), [(0.001, 0.00100001), (0.00091, 0.0009999), (0.01, 1.0), (0.006, 0.005)]
)
def test_period_is_divided_into_the_fewest_equal_substeps(substep: float, same_as: float) -> None:
    load = load_of_movers(0.01)
    first, second = (dynamics(0.01, h, SMOOTH).advance(0.2, 0.3, 0.0, load) for h in (substep, same_as))
    assert first == second


def test_a_multiple_of_the_substep_gains_none_by_rounding() -> None:
    assert 0.07 / 0.01 > 7.0
    load = load_of_movers(0.07)
    hundredths, sevenths = (dynamics(0.07, h, SMOOTH).advance(0.2, 0.3, 0.0, load) for h in (0.01, 0.011))
    assert hundredths == sevenths


def test_substeps_are_not_longer_than_asked_for() -> None:
    load = load_of_movers(0.3)
    tenths, eleventh = (dynamics(0.3, h, SMOOTH).advance(0.2, 0.3, 0.0, load) for h in (0.1, 0.0999))
    thirds = dynamics(0.3, 0.12, SMOOTH).advance(0.2, 0.3, 0.0, load)
    assert tenths == thirds  # 0.3/0.1 is 2.9999999999999996, 0.3/0.12 is 2.5: three substeps
    assert eleventh != tenths


def stopped(substep: float, end_stop: float, friction: Friction = SMOOTH) -> PlaneDynamics:
    return PlaneDynamics(Plane(friction=friction, disturbance=CALM, substep=substep, end_stop=end_stop), 0.4)


@pytest.mark.parametrize("substep", [0.004, 0.001, 0.0001])
def test_end_stop_is_hit_when_scipy_says_and_to_the_substep(substep: float) -> None:
    stop, side = 0.25, -1.0
    load = swarm_load([standing(0.5, 0.2)], G)  # turns the plane to smaller angles

    def rhs(t: float, x: np.ndarray) -> list[float]:
        return [x[1], (-np.cos(x[0]) * 0.5 * 0.2 * G - SMOOTH.torque(x[1])) / (0.5 + 0.02)]

    def touch(t: float, x: np.ndarray) -> float:
        return float(x[0] + stop)

    touch.terminal = True  # type: ignore[attr-defined]
    exact = solve_ivp(rhs, (0.0, 0.4), (-0.2, -0.2), "DOP853", rtol=1e-12, atol=1e-13, events=touch)
    plane = stopped(substep, stop)
    assert plane.advance(-0.2, -0.2, 7.0, load) == (side * stop, 0.0)
    assert plane.impact is not None
    time, rate = plane.impact
    assert 0.0 <= time - 7.0 - exact.t[-1] <= substep
    assert rate == pytest.approx(exact.y[1, -1], abs=2.0 * substep)


def test_plane_stays_at_the_stop_until_it_is_pushed_back() -> None:
    outward, inward = (swarm_load([standing(0.5, p)], G) for p in (0.2, -0.2))
    plane = stopped(0.001, 0.25)
    state = plane.advance(-0.25, 0.0, 0.0, outward)
    assert state == (-0.25, 0.0)
    free = stopped(0.001, inf).advance(-0.25, 0.0, 0.4, inward)
    assert plane.advance(*state, 0.4, inward) == free
    assert free[0] > -0.25
    assert plane.impact is None


def test_a_push_that_turns_round_within_the_period_frees_the_plane_at_the_substep() -> None:
    """The robot crosses the axis at half time: from then on the plane falls freely from the stop."""
    crossing = swarm_load([straight(0.5, 0.1, -0.1)], G)
    found = stopped(0.0001, 0.25).advance(-0.25, 0.0, 0.0, crossing)

    def rhs(t: float, x: np.ndarray) -> list[float]:
        p = 0.1 - 0.2 * t / 0.4
        rate = -2.0 * 0.5 * p * 0.2 / 0.4
        return [x[1], (-np.cos(x[0]) * 0.5 * p * G - rate * x[1] - SMOOTH.torque(x[1])) / (0.5 + 0.5 * p * p)]

    exact = solve_ivp(rhs, (0.2, 0.4), (-0.25, 0.0), "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    assert found == pytest.approx(tuple(exact), abs=1e-5)


def test_stop_that_is_not_reached_changes_no_bit() -> None:
    load = load_of_movers(0.4)
    assert stopped(0.001, 1.0).advance(0.2, -0.3, 0.0, load) == stopped(0.001, inf).advance(0.2, -0.3, 0.0, load)


@pytest.mark.parametrize("state", [(inf, 0.0), (nan, 0.0), (0.1, inf), (0.1, nan), (0.1, 1e308)])
def test_motion_that_is_not_finite_is_refused(state: tuple[float, float]) -> None:
    with pytest.raises(RunError, match=r"not finite at t = 2\.5 s"):
        dynamics(0.01, 0.001, PAPER).advance(*state, 2.5, load_of_movers(0.01))


def test_load_that_is_not_finite_is_refused() -> None:
    load = swarm_load([straight(0.5, 0.1, inf), straight(0.5, 0.1, -inf)], G)
    with pytest.raises(RunError, match="not finite"):
        dynamics(0.01, 0.001).advance(0.1, 0.0, 0.0, load)


def test_disturbance() -> None:
    assert Disturbance(0.1, 0.5).torques([3.0]) == [pytest.approx(0.1 * np.sin(1.5), rel=1e-15)]
    assert Disturbance(0.0, 0.5).torques([3.0, 4.0]) == [0.0, 0.0]
