from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.linalg import expm
from scipy.signal import cont2discrete

from swarmabs_core.desired_state import BANDWIDTH, CommandFilter

values = st.floats(-5.0, 5.0)
periods = st.floats(1e-4, 0.3)


def system(w: float) -> tuple[np.ndarray, np.ndarray]:
    return np.array([[0.0, 1.0], [-w * w, -2.0 * w]]), np.array([[0.0], [w * w]])


@given(periods, values, st.floats(-100.0, 100.0), values)
def test_exact_zero_order_hold(h: float, x: float, dx: float, u: float) -> None:
    a, b, *_ = cont2discrete((*system(BANDWIDTH), np.eye(2), np.zeros((2, 1))), h, "zoh")
    expected = a @ [x, dx] + b[:, 0] * u
    assert CommandFilter(h).advance(x, dx, u) == pytest.approx(expected, rel=1e-10, abs=1e-9)


@given(st.floats(1.0, 200.0))
def test_any_bandwidth(w: float) -> None:
    a, b = system(w)
    augmented = np.block([[a, b], [np.zeros((1, 3))]])
    expected = expm(augmented * 0.01)[:2] @ [0.3, -0.5, 1.0]
    assert CommandFilter(0.01, w).advance(0.3, -0.5, 1.0) == pytest.approx(expected, rel=1e-10)


@given(periods, values)
def test_start_at_the_command_has_no_transient(h: float, u: float) -> None:
    assert CommandFilter(h).advance(u, 0.0, u) == (u, 0.0)


def test_step_response_rises_without_overshoot() -> None:
    command_filter, x, response = CommandFilter(0.001), (0.0, 0.0), [0.0]
    for _ in range(500):
        x = command_filter.advance(*x, 1.0)
        response.append(x[0])
    assert all(b >= a for a, b in pairwise(response))
    t = 0.02
    assert response[20] == pytest.approx(1.0 - (1.0 + 50.0 * t) * np.exp(-50.0 * t), rel=1e-12)
    assert response[-1] == pytest.approx(1.0, abs=1e-9)
