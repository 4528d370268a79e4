from __future__ import annotations

from math import cos, isnan, nan, sin

import pytest
from hypothesis import given, strategies as st
from tests.swarmabs_core.helpers import taylor

from swarmabs_core.manifold import Manifold

CURVE = Manifold(0.0125, 0.025, 5.0)


def test_values_of_the_paper() -> None:
    assert CURVE.inertia(0.0) == 0.025
    assert CURVE.inertia(-5.0) == pytest.approx(0.3375, rel=1e-15)


@given(st.floats(-3.0, 3.0), st.floats(-2.0, 2.0), st.floats(0.1, 2.0))
def test_rates_are_the_derivatives_along_a_path(t: float, a: float, b: float) -> None:
    """tau(t) = a + b t + t^2, exactly differentiated and lifted numerically."""
    tau, rate, acceleration = a + b * t + t * t, b + 2.0 * t, 2.0
    _, first, second = taylor(lambda z: 0.0125 * (a + b * z + z * z) ** 2 + 0.025, t, 2)
    assert CURVE.inertia_rate(tau, rate) == pytest.approx(first, abs=1e-10)
    assert CURVE.inertia_acceleration(tau, rate, acceleration) == pytest.approx(second, abs=1e-9)


def test_rates_by_finite_differences() -> None:
    h, t = 1e-4, 0.7
    before, now, after = (CURVE.inertia(sin(t + d)) for d in (-h, 0.0, h))
    assert CURVE.inertia_rate(sin(t), cos(t)) == pytest.approx((after - before) / (2 * h), rel=1e-6)
    second = CURVE.inertia_acceleration(sin(t), cos(t), -sin(t))
    assert second == pytest.approx((after - 2 * now + before) / h**2, rel=1e-4)


@pytest.mark.parametrize(("torque", "expected"), [(-7.0, -5.0), (-5.0, -5.0), (-0.0, 0.0), (4.9, 4.9), (1e300, 5.0)])
def test_clip(torque: float, expected: float) -> None:
    assert CURVE.clip(torque) == expected


def test_clip_does_not_hide_nan() -> None:
    assert isnan(CURVE.clip(nan))
