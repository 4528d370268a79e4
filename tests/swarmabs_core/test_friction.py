from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from swarmabs_core.plant import Friction

PAPER = Friction(0.01, 1000.0, 700.0, 0.02, 1000.0, 1.0)


def test_value_by_hand_where_the_tangents_are_saturated() -> None:
    # tanh(20) = 1 to 17 digits: the Stribeck term vanishes, Coulomb gives g4.
    assert PAPER.torque(0.5) == pytest.approx(0.02 + 0.5, rel=1e-14)


def test_torque_against_the_formula() -> None:
    w = 0.0013
    expected = 0.01 * (np.tanh(1.3) - np.tanh(0.91)) + 0.02 * np.tanh(1.3) + 0.0013
    assert PAPER.torque(w) == pytest.approx(expected, rel=1e-14)


@given(st.floats(-10, 10))
def test_is_odd(w: float) -> None:
    assert PAPER.torque(-w) == -PAPER.torque(w)


def test_slope_at_rest_is_that_of_the_paper_and_of_the_curve() -> None:
    assert PAPER.slope_at_rest() == pytest.approx(24.0, rel=1e-14)
    assert PAPER.slope_at_rest() == pytest.approx(PAPER.torque(1e-8) / 1e-8, rel=1e-9)


@given(st.floats(1e-6, 10), st.floats(1e-6, 10))
def test_opposes_the_motion(w: float, g6: float) -> None:
    friction = Friction(0.01, 1000.0, 700.0, 0.02, 1000.0, g6)
    assert friction.torque(w) > 0.0
