from __future__ import annotations

import cmath

import pytest
from hypothesis import given, strategies as st
from tests.swarmabs_core.helpers import taylor

from swarmabs_core.trajectory import Constant, QuinticStep, Sine


@given(st.floats(-1.5, 1.5), st.floats(-2.0, 2.0), st.floats(0.0, 100.0))
def test_sine_and_its_derivatives(amplitude: float, w: float, t: float) -> None:
    expected = taylor(lambda z: amplitude * cmath.sin(w * z), t, 4, radius=1.0)
    assert Sine(amplitude, w).derivatives(t) == pytest.approx(expected, abs=1e-11)


def test_reference_of_the_paper() -> None:
    angle, rate, *_ = Sine(0.7, 0.0471238898038469).derivatives(100.0 / 3.0)  # a quarter of its period
    assert angle == pytest.approx(0.7, rel=1e-12)
    assert rate == pytest.approx(0.0, abs=1e-12)


def test_constant() -> None:
    assert Constant(0.2).derivatives(17.0) == (0.2, 0.0, 0.0, 0.0, 0.0)


@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(0.0, 10.0), st.floats(0.1, 20.0), st.floats(0.001, 0.999))
def test_quintic_step_and_its_derivatives(a: float, b: float, start: float, duration: float, part: float) -> None:
    t = start + part * duration

    def step(z: complex) -> complex:
        s = (z - start) / duration
        return a + (b - a) * (10 * s**3 - 15 * s**4 + 6 * s**5)

    expected = taylor(step, t, 4, radius=duration)
    scaled = [d * duration**n for n, d in enumerate(QuinticStep(a, b, start, duration).derivatives(t))]
    assert scaled == pytest.approx([d * duration**n for n, d in enumerate(expected)], abs=1e-9)


@pytest.mark.parametrize(("time", "angle"), [(0.0, 0.3), (1.0, 0.3), (3.0, -0.1), (99.0, -0.1)])
def test_quintic_step_is_at_rest_at_and_beyond_its_ends(time: float, angle: float) -> None:
    assert QuinticStep(0.3, -0.1, 1.0, 2.0).derivatives(time)[:3] == (angle, 0.0, 0.0)


def test_quintic_step_is_half_way_in_the_middle() -> None:
    assert QuinticStep(0.3, -0.1, 1.0, 2.0).derivatives(2.0)[0] == pytest.approx(0.1, rel=1e-15)
