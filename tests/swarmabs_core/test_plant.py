from functools import partial
from math import inf, nan
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline

from swarmabs_core import plant, runge_kutta
from swarmabs_core.elementary import cos, sin, sin_cos, tanh
from swarmabs_core.elementary_arrays import elementwise
from swarmabs_core.errors import RunError
from swarmabs_core.parent_response import TorqueEstimator

G = 9.81
NONE = plant.Friction(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
SMOOTH = plant.Friction(0.1, 3.0, 2.0, 0.2, 3.0, 1.0)
PAPER = plant.Friction(0.01, 1000.0, 700.0, 0.02, 1000.0, 1.0)
CALM = plant.Disturbance(0.0, 0.5)
Array = NDArray[np.float64]

numbers = st.floats(-2.0, 2.0)
bodies = st.floats(0.1, 2.0)
paths = st.one_of(
    st.builds(plant.standing, bodies, numbers),
    st.builds(plant.straight, bodies, numbers, numbers),
    st.builds(plant.hermite, bodies, st.tuples(numbers, numbers), st.tuples(numbers, numbers), bodies),
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
    start: tuple[float, float], period: float, friction: plant.Friction, disturbance: plant.Disturbance, time: float
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
    period: float, substep: float, friction: plant.Friction = NONE, disturbance: plant.Disturbance = CALM
) -> plant.PlaneDynamics:
    return plant.PlaneDynamics(plant.Plane(friction=friction, disturbance=disturbance, substep=substep), period)


def load_of_movers(period: float) -> plant.SwarmLoad:
    return plant.swarm_load([plant.hermite(r.mass, r.start, r.end, period) for r in MOVERS], G)


@settings(max_examples=30)
@given(bodies, numbers, numbers, numbers, numbers, bodies)
def test_hermite_path_meets_both_states(mass: float, p0: float, v0: float, p1: float, v1: float, period: float) -> None:
    m, *c = plant.hermite(mass, (p0, v0), (p1, v1), period)
    path = np.polynomial.Polynomial(c)
    assert m == mass
    assert [path(0.0), path(1.0)] == pytest.approx([p0, p1], abs=1e-13)
    assert [path.deriv()(0.0), path.deriv()(1.0)] == pytest.approx([v0 * period, v1 * period], abs=1e-13)


@settings(max_examples=30)
@given(st.lists(paths, max_size=12), st.floats(0.0, 1.0))
def test_load_is_the_sum_over_the_paths(robots: list[plant.RobotPath], s: float) -> None:
    load = plant.swarm_load(robots, G)
    positions = [np.polynomial.Polynomial(path[1:])(s) for path in robots]
    weights = [path.mass for path in robots]
    bound = 1e-13 * (1.0 + sum(m * sum(map(abs, c)) ** 2 for m, *c in robots)) * 50
    torque = np.polynomial.Polynomial(load.torque)(s)
    inertia = np.polynomial.Polynomial(load.inertia)(s)
    assert torque == pytest.approx(G * np.dot(weights, positions), abs=bound * G)
    assert inertia == pytest.approx(np.dot(weights, np.square(positions)), abs=bound)


@pytest.mark.parametrize(
    ("start", "friction", "disturbance", "error"),
    [
        ((0.2, -0.3), SMOOTH, plant.Disturbance(0.4, 5.0), 1e-10),
        ((0.2, 0.01), PAPER, CALM, 1e-9),  # stiff, and through rest
    ],
)
def test_moving_plane_agrees_with_scipy(
    start: tuple[float, float], friction: plant.Friction, disturbance: plant.Disturbance, error: float
) -> None:
    found = dynamics(0.2, 0.001, friction, disturbance).advance(*start, 1.7, load_of_movers(0.2))
    assert found == pytest.approx(reference(start, 0.2, friction, disturbance, 1.7), abs=error)


def test_steps_are_of_fifth_order_and_estimate_their_error() -> None:
    motion = plant.acceleration(plant.Plane(friction=SMOOTH), 0.4, load_of_movers(0.4), 0.0, 0.0, (sin_cos, cos, tanh))
    start = (0.2, -0.3, motion(0.0, 0.2, -0.3))
    errors, estimates = [], []
    for n in (16, 32, 64):
        x, v, a, of_x, of_v = runge_kutta.step(motion, 0.0, 1.0 / n, 0.4, start)
        exact = start
        for k in range(64):
            exact = runge_kutta.step(motion, k / (64 * n), 1.0 / (64 * n), 0.4, exact)[:3]
        assert a == motion(1.0 / n, x, v), "the last stage is the first one of the next step"
        errors.append(max(abs(x - exact[0]), abs(v - exact[1])))
        estimates.append(max(abs(of_x), abs(of_v)))
    assert [error < estimate for error, estimate in zip(errors, estimates, strict=True)] == [True] * 3
    assert estimates[1] / estimates[2] == pytest.approx(32.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(64.0, rel=0.5)


@settings(max_examples=12)
@given(
    st.tuples(st.floats(-0.5, 0.5), st.one_of(st.floats(-1.0, 1.0), st.floats(-1e-2, 1e-2))),
    st.sampled_from([CALM, plant.Disturbance(0.3, 3.0), plant.Disturbance(0.5, 2.0)]),
)
def test_two_seconds_take_a_quarter_of_the_evaluations_of_millisecond_steps_and_err_by_a_billionth(
    start: tuple[float, float], disturbance: plant.Disturbance
) -> None:
    """Against SciPy; 200 periods of 10 ms with the paper's friction, which is stiff near rest."""
    plane, period, evaluations = plant.Plane(friction=PAPER, disturbance=disturbance), 0.01, 0
    load = plant.swarm_load([plant.standing(0.5, 0.11), plant.standing(0.7, -0.08)], G)
    state = start
    for step in range(200):
        motion = plant.acceleration(plane, period, load, step * period, 0.0, (sin_cos, cos, tanh))

        def counted(s: float, th: float, w: float, motion: runge_kutta.Acceleration = motion) -> float:
            nonlocal evaluations
            evaluations += 1
            return float(motion(s, th, w))

        found = runge_kutta.advance(counted, period, state, 1.0)[:2]
        assert found == plant.PlaneDynamics(plane, period).advance(*state, step * period, load)
        state = found

    def rhs(t: float, x: np.ndarray) -> list[float]:
        torque = G * (0.5 * 0.11 - 0.7 * 0.08)
        inertia = 0.5 + 0.5 * 0.11**2 + 0.7 * 0.08**2
        return [x[1], (-np.cos(x[0]) * torque - PAPER.torque(x[1]) - disturbance.torque(t)) / inertia]

    exact = solve_ivp(rhs, (0.0, 2.0), start, "DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    assert state[0] == pytest.approx(exact[0], abs=1e-9)
    assert evaluations <= 200 * 10


@pytest.mark.parametrize(("period", "substep", "count"), [(0.01, 0.0049, 3), (0.01, 1.0, 1), (0.3, 0.1, 3)])
def test_no_step_is_longer_than_a_substep_if_one_is_set(period: float, substep: float, count: int) -> None:
    """0.3/0.1 is 2.9999999999999996."""
    load = load_of_movers(period)
    found, same = (
        dynamics(period, longest, SMOOTH).advance(0.2, 0.3, 0.0, load) for longest in (substep, 1.001 * period / count)
    )
    assert found == same


@settings(max_examples=20)
@given(st.lists(st.tuples(st.floats(-1.0, 1.0), st.floats(-2.0, 2.0)), min_size=1, max_size=8))
def test_many_periods_at_once_have_the_bits_of_each(states: list[tuple[float, float]]) -> None:
    period = 0.05
    plane = plant.PlaneDynamics(plant.Plane(friction=PAPER, disturbance=plant.Disturbance(0.4, 5.0)), period)
    loads = [plant.swarm_load([plant.straight(0.5, 0.1 * n, 0.3 - 0.1 * n)], G) for n in range(len(states))]
    torque, inertia = (
        tuple(np.array(numbers) for numbers in zip(*(getattr(load, name) for load in loads), strict=True))
        for name in ("torque", "inertia")
    )
    times = np.arange(len(states)) * period
    angle, rate = np.array(states).T.copy()

    def circle(angles: Array) -> tuple[Array, Array]:
        return elementwise(sin, angles), elementwise(cos, angles)

    functions = (circle, partial(elementwise, cos), partial(elementwise, tanh))
    together = plane.advance_each(angle, rate, times, plant.SwarmLoad(torque, inertia), 0.25, functions)
    alone = [plane.advance(*state, time, load, 0.25) for state, time, load in zip(states, times, loads, strict=True)]
    assert list(zip(*(values.tolist() for values in together), strict=True)) == alone


def stopped(substep: float, end_stop: float, friction: plant.Friction = SMOOTH) -> plant.PlaneDynamics:
    return plant.PlaneDynamics(
        plant.Plane(friction=friction, disturbance=CALM, substep=substep, end_stop=end_stop), 0.4
    )


def test_end_stop_is_hit_when_scipy_says() -> None:
    stop, side = 0.25, -1.0
    load = plant.swarm_load([plant.standing(0.5, 0.2)], G)  # turns the plane to smaller angles

    def rhs(t: float, x: np.ndarray) -> list[float]:
        return [x[1], (-np.cos(x[0]) * 0.5 * 0.2 * G - SMOOTH.torque(x[1])) / (0.5 + 0.02)]

    def touch(t: float, x: np.ndarray) -> float:
        return float(x[0] + stop)

    touch.terminal = True  # type: ignore[attr-defined]
    exact = solve_ivp(rhs, (0.0, 0.4), (-0.2, -0.2), "DOP853", rtol=1e-12, atol=1e-13, events=touch)
    plane = stopped(1.0, stop)
    assert plane.advance(-0.2, -0.2, 7.0, load) == (side * stop, 0.0)
    assert plane.impact == pytest.approx((7.0 + exact.t[-1], exact.y[1, -1]), abs=1e-9)


def test_a_stop_is_met_by_a_plane_that_turns_back_within_the_period() -> None:
    """The ends of the period say nothing of it."""
    load = plant.swarm_load([plant.straight(1.0, -0.3, 0.3)], G)
    free = stopped(1.0, inf)
    end = free.advance(0.2, 0.2, 0.0, load)[0]
    turned = plant.acceleration(plant.Plane(friction=SMOOTH), 0.4, load, 0.0, 0.0, (sin_cos, cos, tanh))
    heights: list[float] = []
    runge_kutta.advance(turned, 0.4, (0.2, 0.2), 0.01, event=lambda s, h, start, end: heights.append(end[0]))
    highest = max(heights)
    assert end < highest - 1e-3
    plane = stopped(1.0, highest - 1e-4)
    angle, rate = plane.advance(0.2, 0.2, 0.0, load)
    assert plane.impact is not None
    assert angle < end, "it has lost its way up"
    assert rate < 0.0


def test_plane_stays_at_the_stop_until_it_is_pushed_back() -> None:
    outward, inward = (plant.swarm_load([plant.standing(0.5, p)], G) for p in (0.2, -0.2))
    plane = stopped(0.001, 0.25)
    state = plane.advance(-0.25, 0.0, 0.0, outward)
    assert state == (-0.25, 0.0)
    free = stopped(0.001, inf).advance(-0.25, 0.0, 0.4, inward)
    assert plane.advance(*state, 0.4, inward) == free
    assert free[0] > -0.25
    assert plane.impact is None
    assert stopped(0.001, 1.0).advance(*state, 0.4, inward) == free, "a stop that is not reached changes no bit"


@pytest.mark.parametrize("state", [(inf, 0.0), (0.1, nan), (0.1, 1e308)])
def test_motion_that_is_not_finite_is_refused(state: tuple[float, float]) -> None:
    endless = plant.swarm_load([plant.straight(0.5, 0.1, inf), plant.straight(0.5, 0.1, -inf)], G)
    for at, load in ((state, load_of_movers(0.01)), ((0.1, 0.0), endless)):
        with pytest.raises(RunError, match=r"not finite at t = 2\.5 s"):
            dynamics(0.01, 0.001, PAPER).advance(*at, 2.5, load)


@settings(max_examples=30)
@given(st.floats(-10.0, 10.0), st.floats(0.0, 2.0))
def test_friction_and_disturbance_are_those_of_the_formulas(w: float, steepness: float) -> None:
    g1, g2, g3, g4, g5, g6 = friction = plant.Friction(0.3, 3.0, 2.0 * steepness, 0.2, 7.0 * steepness, 0.5)
    expected = g1 * (np.tanh(g2 * w) - np.tanh(g3 * w)) + g4 * np.tanh(g5 * w) + g6 * w
    assert friction.torque(w) == pytest.approx(expected, rel=1e-13, abs=1e-15)
    assert friction.torque(-w) == -friction.torque(w)
    assert friction.slope_at_rest() == pytest.approx(friction.torque(1e-8) / 1e-8, rel=1e-9)
    for amplitude in (0.0, 0.1):
        sine = amplitude * np.sin(steepness * 3.0)
        assert plant.Disturbance(amplitude, steepness).torque(3.0) == pytest.approx(sine, rel=1e-15)


J, JS = 0.5, 0.03


def swinging(period: float, end: float) -> tuple[Array, Array]:
    """Solve a plane under a torque and a disturbance that are given as functions of time by SciPy."""

    def rhs(t: float, x: Array) -> list[float]:
        forces = -np.cos(x[0]) * (1.0 + np.sin(t)) - 0.4 * np.sin(3.0 * t) - SMOOTH.torque(x[1])
        return [x[1], forces / (J + JS)]

    time = np.arange(0.0, end, period)
    return time, solve_ivp(rhs, (0.0, time[-1]), (0.3, 0.0), "DOP853", t_eval=time, rtol=1e-12, atol=1e-13).y


def mean_torque(time: Array, angle: Array) -> Array:
    """Return tau_s + tau_d/cos th in the middles of the periods."""
    middle = 0.5 * (time[1:] + time[:-1])
    return 1.0 + np.sin(middle) + 0.4 * np.sin(3.0 * middle) / np.cos(0.5 * (angle[1:] + angle[:-1]))


def test_without_filter_it_is_the_mean_over_the_period_to_second_order() -> None:
    errors = []
    for period in (0.02, 0.01, 0.005):
        time, (angle, rate) = swinging(period, 2.0)
        estimator = TorqueEstimator(J, SMOOTH, 1e9, period)
        found = np.array([estimator.update(th, w, JS)[0] for th, w in zip(angle, rate, strict=True)])
        assert found[0] == 0.0
        errors.append(np.abs(found[1:] - mean_torque(time, angle)).max())
    assert errors[2] < 1e-2
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.2)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.2)


def test_filter_is_of_first_order() -> None:
    """On a plane held by the friction of a constant rate, the estimate approaches -f(w)/cos th by 1 - e^(-lambda t)."""
    estimator = TorqueEstimator(J, SMOOTH, 20.0, 0.01)
    found = [estimator.update(0.3, 0.5, JS) for _ in range(60)]
    final = -SMOOTH.torque(0.5) / np.cos(0.3)
    expected = final * (1.0 - np.exp(-20.0 * 0.01 * np.arange(60)))
    assert [torque for torque, _ in found] == pytest.approx(expected, abs=1e-12)
    assert [rate for _, rate in found[1:]] == pytest.approx(np.diff(expected) / 0.01, abs=1e-10)
