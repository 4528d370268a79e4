from __future__ import annotations

from fractions import Fraction
from math import factorial, nextafter

import numpy as np
import pytest
from hypothesis import assume, given, strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from swarmabs_core.drive import DoubleIntegratorDrive, Lag, SingleIntegratorDrive
from swarmabs_core.messages import Kind

masses = st.floats(0.05, 5.0)
dampings = st.one_of(st.just(0.0), st.floats(1e-12, 1e-3), st.floats(1e-3, 50.0))
periods = st.floats(1e-4, 0.2)
states = st.floats(-2.0, 2.0)


def exact_gains(z: Fraction) -> tuple[float, float]:
    """(e^z - 1)/z and (e^z - 1 - z)/z^2 in rational arithmetic, for |z| <= 2."""
    phi1 = sum(z**n / factorial(n + 1) for n in range(40))
    phi2 = sum(z**n / factorial(n + 2) for n in range(40))
    return float(phi1), float(phi2)


@given(periods, states, states, states)
def test_single_integrator_moves_at_its_command(h: float, p: float, v: float, u: float) -> None:
    assert SingleIntegratorDrive(h).advance(p, v, u) == (p + u * h, u)


@given(periods, masses, dampings, states, states, states)
def test_double_integrator_is_the_matrix_exponential(
    h: float, m: float, c: float, p: float, v: float, u: float
) -> None:
    augmented = np.array([[0.0, 1.0, 0.0], [0.0, -c / m, 1.0 / m], [0.0, 0.0, 0.0]])
    expected = expm(augmented * h)[:2] @ [p, v, u]
    assert DoubleIntegratorDrive.of(h, m, c).advance(p, v, u) == pytest.approx(expected, rel=1e-11, abs=1e-12)


def test_double_integrator_solves_its_equation_of_motion() -> None:
    m, c, u = 0.4, 1.3, 0.7
    solution = solve_ivp(
        lambda t, x: [x[1], (u - c * x[1]) / m], (0.0, 0.5), [0.1, -0.2], "DOP853", rtol=1e-12, atol=1e-13
    )
    found = DoubleIntegratorDrive.of(0.5, m, c).advance(0.1, -0.2, u)
    assert found == pytest.approx(solution.y[:, -1], rel=1e-10)


@given(st.one_of(st.just(0.0), st.floats(1e-300, 1e-10), st.floats(1e-10, 2.0)))
def test_gains_keep_their_digits_for_any_damping(z: float) -> None:
    drive = DoubleIntegratorDrive.of(1.0, 1.0, z)
    phi1, phi2 = exact_gains(Fraction(-z))
    assert drive.velocity_to_position == pytest.approx(phi1, rel=1e-15)
    assert drive.force_to_velocity == pytest.approx(phi1, rel=1e-15)
    assert drive.force_to_position == pytest.approx(phi2, rel=1e-14)
    assert drive.decay == pytest.approx(1.0 - z * phi1, rel=1e-13)


def test_no_damping_is_the_limit_of_little_damping() -> None:
    free = DoubleIntegratorDrive.of(0.01, 0.5, 0.0)
    assert free.advance(0.1, 0.2, 0.3) == pytest.approx((0.1 + 0.002 + 3e-5, 0.2 + 0.006), rel=1e-15)
    assert DoubleIntegratorDrive.of(0.01, 0.5, 1e-13).advance(0.1, 0.2, 0.3) == pytest.approx(
        free.advance(0.1, 0.2, 0.3), rel=1e-14
    )


def test_series_and_quotient_meet() -> None:
    inside, outside = (DoubleIntegratorDrive.of(1.0, 1.0, z) for z in (0.1, nextafter(0.1, 1.0)))
    assert inside.force_to_position == pytest.approx(outside.force_to_position, rel=5e-15)
    assert inside.velocity_to_position == pytest.approx(outside.velocity_to_position, rel=5e-16)


@given(periods, masses, dampings, states, states, states)
def test_two_half_periods_are_one_period(h: float, m: float, c: float, p: float, v: float, u: float) -> None:
    half = DoubleIntegratorDrive.of(h / 2, m, c)
    middle = half.advance(p, v, u)
    expected = DoubleIntegratorDrive.of(h, m, c).advance(p, v, u)
    assert half.advance(*middle, u) == pytest.approx(expected, rel=1e-12, abs=1e-13)


lags = st.one_of(st.floats(1e-9, 1e-3), st.floats(1e-3, 10.0))


@given(periods, lags, states, states, states)
def test_lag_of_a_single_integrator_is_the_matrix_exponential(
    h: float, lag: float, p: float, v: float, u: float
) -> None:
    augmented = np.array([[0.0, 1.0, 0.0], [0.0, -1.0 / lag, 1.0 / lag], [0.0, 0.0, 0.0]])
    expected = expm(augmented * h)[:2] @ [p, v, u]
    answer, ideal = Lag.of(Kind.SINGLE_INTEGRATOR, lag, h, 1.0, 0.0), SingleIntegratorDrive(h).advance(p, v, u)
    found = [ideal[0] + answer.gap_to_position * (v - u), ideal[1] + answer.gap_to_velocity * (v - u)]
    assert found == pytest.approx(expected, rel=1e-10, abs=1e-11)


@given(periods, lags, masses, dampings, states, states, states, states)
def test_lag_of_a_double_integrator_is_the_matrix_exponential(
    h: float, lag: float, m: float, c: float, p: float, v: float, f: float, u: float
) -> None:
    assume(c == 0.0 or c * h > 1e-6 * m)  # closer to no damping, SciPy's expm is off by up to 5e-4
    system = [[0, 1, 0, 0], [0, -c / m, 1 / m, 0], [0, 0, -1 / lag, 1 / lag], [0, 0, 0, 0]]
    expected = expm(np.array(system) * h) @ [p, v, f, u]
    answer, ideal = Lag.of(Kind.DOUBLE_INTEGRATOR, lag, h, m, c), DoubleIntegratorDrive.of(h, m, c).advance(p, v, u)
    found = [
        ideal[0] + answer.gap_to_position * (f - u),
        ideal[1] + answer.gap_to_velocity * (f - u),
        u + answer.decay * (f - u),
    ]
    assert found == pytest.approx(expected[:3], rel=1e-9, abs=1e-10)


@given(periods, lags, masses)
def test_lag_without_damping_is_the_limit_of_little_damping(h: float, lag: float, m: float) -> None:
    free, slow = (Lag.of(Kind.DOUBLE_INTEGRATOR, lag, h, m, c) for c in (0.0, 1e-13 * m / h))
    assert slow.gap_to_velocity == pytest.approx(free.gap_to_velocity, rel=1e-12)
    assert slow.gap_to_position == pytest.approx(free.gap_to_position, rel=1e-12)


@pytest.mark.parametrize("offset", [0.0, 1e-16, 1e-12, 1e-8, 1e-4])
@pytest.mark.parametrize("h", [0.001, 0.1, 0.49, 0.51, 3.0])
def test_lag_keeps_its_digits_where_lag_and_drag_are_equally_fast(h: float, offset: float) -> None:
    """In rational arithmetic: both time constants are 0.5 s, or differ by a little."""
    a, b = Fraction(-h) / Fraction(0.5), Fraction(-(1.0 + offset) * 1.0 * h) / Fraction(0.5)
    homogeneous = [sum(a**i * b ** (n - i) for i in range(n + 1)) for n in range(50)]
    lag = Lag.of(Kind.DOUBLE_INTEGRATOR, 0.5, h, 0.5, 1.0 + offset)
    first = sum(term / factorial(n + 1) for n, term in enumerate(homogeneous))
    second = sum(term / factorial(n + 2) for n, term in enumerate(homogeneous))
    assert lag.gap_to_velocity == pytest.approx(float(first) * h / 0.5, rel=1e-13)
    assert lag.gap_to_position == pytest.approx(float(second) * h * h / 0.5, rel=1e-13)
