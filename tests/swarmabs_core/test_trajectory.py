from __future__ import annotations

import cmath

import pytest
from hypothesis import given, strategies as st
from tests.swarmabs_core.helpers import taylor

from swarmabs_core.trajectory import Constant, Sine


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
