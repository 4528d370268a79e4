import cmath

import control
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.interpolate import make_interp_spline
from tests.swarmabs_core.helpers import taylor

from swarmabs_core.controllers import (
    CONTROLLERS,
    Arise,
    AriseGains,
    ParentContext,
    Pid,
    PidSettings,
    StateFeedback,
    lqr_gains,
    regressor,
)
from swarmabs_core.errors import InputError
from swarmabs_core.manifold import Manifold
from swarmabs_core.messages import PlaneState
from swarmabs_core.plant import Friction
from swarmabs_core.trajectory import Constant, QuinticSpline, QuinticStep, Sine

CONTEXT = ParentContext(0.01, 0.5, Friction(0.01, 1000.0, 700.0, 0.02, 1000.0, 1.0), Manifold(0.0125, 0.025, 5.0))


def plane(angle: float, angular_velocity: float) -> PlaneState:
    return PlaneState(0, 0, angle, angular_velocity)


weights = st.floats(0.01, 100.0)


@settings(max_examples=25)
@given(weights, weights, weights, st.floats(0.05, 5.0), st.floats(0.0, 10.0))
def test_lqr_gains_solve_the_riccati_equation(q1: float, q2: float, r: float, inertia: float, viscous: float) -> None:
    """By python-control: K of tau = K (th, w); tau enters as -tau/inertia, its u is -K x."""
    a = np.array([[0.0, 1.0], [0.0, -viscous / inertia]])
    b = np.array([[0.0], [1.0 / inertia]])
    expected = control.lqr(a, b, np.diag([q1, q2]), np.array([[r]]))[0][0]
    assert lqr_gains((q1, q2), r, inertia, viscous) == pytest.approx(expected, rel=1e-6)


def test_laws_take_their_settings() -> None:
    law = StateFeedback(3.0, 0.5)
    assert law.torque(17.0, plane(0.1, -0.2)) == pytest.approx(0.2, rel=1e-15)
    assert law.reference(17.0) == 0.0
    assert CONTROLLERS.make("pd", {}, CONTEXT) == StateFeedback(3.1623, 3.2859)
    assert CONTROLLERS.make("pd", {"gains": (1, 2)}, CONTEXT) == StateFeedback(1.0, 2.0)
    # Inertia 0.5 + 0.025, viscous friction g6 = 1.
    optimal = StateFeedback(*lqr_gains((1.0, 3.0), 0.5, 0.525, 1.0))
    assert CONTROLLERS.make("lqr", {"q": (1.0, 3.0), "r": 0.5}, CONTEXT) == optimal
    law = CONTROLLERS.make("arise", {"trajectory.type": "constant", "trajectory.angle": 0.3}, CONTEXT)
    assert isinstance(law, Arise)
    assert law.reference(5.0) == 0.3
    sine = {"trajectory.amplitude": 0.1, "trajectory.angular_frequency": 1.0, "adaptive_initial": (0, 0, 0, 2)}
    other = CONTROLLERS.make("arise", sine, CONTEXT)
    assert other.reference(5.0) == pytest.approx(0.1 * np.sin(5.0), rel=1e-15)
    # Only g6 is estimated: Y_d lambda = 2 th_d'(0) = 0.2.
    assert other.torque(0.0, PlaneState(0, 0, 0.0, 0.0)) == pytest.approx(-0.2, rel=1e-14)


@pytest.mark.parametrize(
    ("name", "settings", "text"),
    [
        ("mpc", {}, r"no parent controller 'mpc'; available: arise, lqr, pd, pid"),
        ("pd", {"gain": (1.0, 2.0)}, r"parent controller 'pd' has no parameter 'gain'; it has gains"),
        ("pd", {"gains": (1.0,)}, "2 elements"),
        ("lqr", {"r": 0.0}, "more than 0"),
        ("pid", {"gains": (1.0, 2.0)}, "3 elements"),
        ("pid", {"gains": (1.0, 2.0, -1.0)}, "at least 0"),
        ("pid", {"integral_limit": -0.1}, "at least 0"),
        ("lqr", {"q": (0.0, 1.0)}, r"q\.0: 0 is out of range"),
        ("arise", {"trajectory.type": "square"}, "one of sine, constant"),
        ("arise", {"smoothing": 0.0}, "more than 0"),
    ],
)
def test_names_and_settings_that_are_refused(name: str, settings: dict[str, float], text: str) -> None:
    with pytest.raises(InputError, match=text):
        CONTROLLERS.make(name, settings, CONTEXT)


def test_the_gains_of_pid_repeat_the_slow_pole_of_pd() -> None:
    """The poles of the paper's PD gains, with inertia 0.525 and viscous friction 1; the gains have three digits."""
    fast, slow = sorted(np.roots([0.525, 3.2859 + 1.0, 3.1623]))
    expected = 0.525 * np.poly([fast, slow, slow]) - [0.0, 1.0, 0.0, 0.0]
    k1, k2, k3 = PidSettings().gains
    assert [k2, k1, k3] == pytest.approx(expected[1:], rel=2e-3)


def test_the_integral_of_pid_is_a_sum_over_the_history() -> None:
    """As long as angle and torque are small; the sum is that of NumPy, the offset part of the error."""
    law = Pid(PidSettings((2.0, 3.0, 5.0), 4.0), 0.01, 9.0)
    th, w, offset = 0.3 * np.cos(np.arange(300) / 40.0), 0.1 * np.sin(np.arange(300) / 20.0), 0.05
    torques = [law.offset_torque(0.0, plane(a, b), offset) for a, b in zip(th, w, strict=True)]
    error = th - offset
    np.testing.assert_allclose(torques, 2.0 * error + 3.0 * w + 0.05 * (np.cumsum(error) - error), rtol=1e-12)
    assert law.reference(3.0) == 0.0


@pytest.mark.parametrize(
    ("angle", "angular_velocity", "grows"),
    [
        (0.2, 0.0, True),
        (0.2, 2.0, True),  # torque 2.6 of 3
        (0.2, 2.5, False),  # the torque is limited
        (0.24, 0.0, True),
        (0.26, 0.0, False),  # k1 th exceeds the limit of the integral
        (-0.26, 0.0, False),
        (-0.2, -2.0, True),
    ],
)
def test_the_integral_of_pid_grows_only_where_it_can_help(angle: float, angular_velocity: float, grows: bool) -> None:  # noqa: FBT001
    law = Pid(PidSettings((2.0, 1.1, 5.0), 0.5), 0.01, 3.0)
    first, second = (law.torque(0.0, plane(angle, angular_velocity)) for _ in range(2))
    assert second - first == pytest.approx(0.05 * angle if grows else 0.0, abs=1e-15)


def test_the_integral_of_pid_is_bounded_and_shrinks_everywhere() -> None:
    """It reaches 0.5 N m after 25 steps at 0.2 rad; far on the other side each step takes 0.05 N m/rad off."""
    law = Pid(PidSettings((2.0, 0.0, 10.0), 0.5), 0.01, 3.0)
    torques = [law.torque(0.0, plane(0.2, 0.0)) for _ in range(40)]
    assert torques[10] == pytest.approx(0.4 + 10 * 0.02)
    assert torques[25:] == pytest.approx([0.9] * 15)
    far = [law.torque(0.0, plane(-1.0, 0.0)) + 2.0 for _ in range(7)]
    assert far == pytest.approx([0.5, 0.4, 0.3, 0.2, 0.1, 0.0, 0.0], abs=0.1 + 1e-12)
    assert far[:5] == pytest.approx([0.5, 0.4, 0.3, 0.2, 0.1])


@settings(max_examples=30)
@given(st.floats(0.0, 50.0), st.floats(0.1, 6.0), st.floats(0.1, 6.0), st.floats(0.1, 6.0))
def test_regressor_and_its_derivatives(t: float, g2: float, g3: float, g5: float) -> None:
    """Each entry, as a function of time along a sine, differentiated by Cauchy's integral."""
    amplitude, w = 0.4, 0.8

    def rate(z: complex, order: int) -> complex:
        return amplitude * w**order * cmath.sin(w * z + order * cmath.pi / 2.0)

    entries = (
        lambda z: rate(z, 2),
        lambda z: cmath.tanh(g2 * rate(z, 1)) - cmath.tanh(g3 * rate(z, 1)),
        lambda z: cmath.tanh(g5 * rate(z, 1)),
        lambda z: rate(z, 1),
    )
    expected = np.array([taylor(entry, t, 2) for entry in entries]).T
    _, *rates = Sine(amplitude, w).derivatives(t)
    found = regressor(Friction(9.0, g2, g3, 9.0, g5, 9.0), tuple(rates))
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_many_steps_against_sums_over_the_history() -> None:
    """The integrals are left Riemann sums of what was seen before; NumPy adds them up afterwards."""
    gains = AriseGains(gamma=(8.0, 2.0, 3.0, 9.0))
    friction = Friction(0.01, 30.0, 20.0, 0.02, 40.0, 1.0)
    trajectory, dt, n = Sine(0.7, 1.1), 0.01, 400
    time = dt * np.arange(n)
    th, w = 0.1 * np.cos(3.0 * time), 0.2 * np.sin(2.0 * time)

    law = Arise(gains, trajectory, friction, dt)
    found = [law.torque(t, plane(a, b)) for t, a, b in zip(time, th, w, strict=True)]

    th_d = np.array([trajectory.derivatives(t) for t in time]).T
    e2 = th_d[1] - w + gains.alpha1 * (th_d[0] - th)
    y, dy, ddy = np.array([regressor(friction, tuple(rates)) for rates in th_d[1:].T]).transpose(1, 0, 2)
    ks1 = gains.ks + 1.0

    def integral(rate: np.ndarray) -> np.ndarray:
        return dt * (np.cumsum(rate, axis=0) - rate)

    mu1 = integral(ks1 * gains.alpha2 * e2 + gains.beta * np.tanh(e2 / gains.smoothing))
    mu2 = integral((ddy - gains.alpha2 * dy) * e2[:, None])
    lam = gains.adaptive_initial + np.array(gains.gamma) * (dy * e2[:, None] - dy[0] * e2[0] - mu2)
    expected = -((y * lam).sum(axis=1) + ks1 * (e2 - e2[0]) + mu1) / np.cos(th)
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-12)


@given(st.floats(-1.5, 1.5), st.floats(-2.0, 2.0), st.floats(0.0, 100.0))
def test_sine_and_its_derivatives(amplitude: float, w: float, t: float) -> None:
    expected = taylor(lambda z: amplitude * cmath.sin(w * z), t, 4, radius=1.0)
    assert Sine(amplitude, w).derivatives(t) == pytest.approx(expected, abs=1e-11)


@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(0.0, 10.0), st.floats(0.1, 20.0), st.floats(0.001, 0.999))
def test_quintic_step_and_its_derivatives(a: float, b: float, start: float, duration: float, part: float) -> None:
    t = start + part * duration

    def step(z: complex) -> complex:
        s = (z - start) / duration
        return a + (b - a) * (10 * s**3 - 15 * s**4 + 6 * s**5)

    expected = taylor(step, t, 4, radius=duration)
    scaled = [d * duration**n for n, d in enumerate(QuinticStep(a, b, start, duration).derivatives(t))]
    assert scaled == pytest.approx([d * duration**n for n, d in enumerate(expected)], abs=1e-9)


def test_constants_steps_and_splines_are_at_rest_at_and_beyond_their_ends() -> None:
    assert Constant(0.2).derivatives(17.0) == (0.2, 0.0, 0.0, 0.0, 0.0)
    for time, angle in ((0.0, 0.3), (1.0, 0.3), (3.0, -0.1), (99.0, -0.1)):
        assert QuinticStep(0.3, -0.1, 1.0, 2.0).derivatives(time)[:3] == (angle, 0.0, 0.0)
    for time, angle in ((0.5, 0.1), (4.0, 0.2)):
        assert QuinticSpline([1.0, 2.0, 4.0], [0.1, 0.3, 0.2]).derivatives(time) == (angle, 0.0, 0.0, 0.0, 0.0)


AT_REST = ([(1, 0.0), (2, 0.0)], [(1, 0.0), (2, 0.0)])

tables = st.lists(st.tuples(st.floats(0.1, 2.0), st.floats(-0.5, 0.5)), min_size=2, max_size=30)


def knots(table: list[tuple[float, float]]) -> tuple[list[float], list[float]]:
    return np.cumsum([gap for gap, _ in table]).tolist(), [value for _, value in table]


@settings(max_examples=30)
@given(tables, st.floats(0.0, 0.999999))
def test_spline_is_the_interpolating_spline_of_scipy(table: list[tuple[float, float]], part: float) -> None:
    times, values = knots(table)
    assert QuinticSpline(times, values).derivatives(times[1])[0] == pytest.approx(values[1], abs=1e-15)
    time = times[0] + part * (times[-1] - times[0])
    expected = make_interp_spline(times, values, k=5, bc_type=AT_REST)
    found = QuinticSpline(times, values).derivatives(time)
    for order, derivative in enumerate(found):
        # The shortest interval is 0.1: the n-th derivative of values up to 0.5 reaches some 0.5 * 720 * 10^n.
        assert derivative == pytest.approx(float(expected(time, order)), rel=1e-7, abs=1e-7 * 10.0**order)


@pytest.mark.parametrize(
    ("times", "values", "text"),
    [
        ([0.0], [0.0], "1 times and 1 values"),
        ([0.0, 1.0], [0.0], "2 times and 1 values"),
        ([0.0, 0.0], [0.0, 1.0], r"0\.0 s follows 0\.0 s"),
        ([0.0, 0.0009], [0.0, 1.0], "increase by at least 0.001 s"),
        ([0.0, float("nan")], [0.0, 1.0], "nan s follows"),
        ([0.0, 1.0], [0.0, float("inf")], "not finite"),
    ],
)
def test_rows_that_make_no_curve(times: list[float], values: list[float], text: str) -> None:
    with pytest.raises(InputError, match=text):
        QuinticSpline(times, values)
