from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.interpolate import make_interp_spline

from swarmabs_core.errors import InputError
from swarmabs_core.trajectory import QuinticSpline, QuinticStep

AT_REST = ([(1, 0.0), (2, 0.0)], [(1, 0.0), (2, 0.0)])

tables = st.lists(st.tuples(st.floats(0.1, 2.0), st.floats(-0.5, 0.5)), min_size=2, max_size=30)


def knots(table: list[tuple[float, float]]) -> tuple[list[float], list[float]]:
    return np.cumsum([gap for gap, _ in table]).tolist(), [value for _, value in table]


@given(tables, st.floats(0.0, 0.999999))
def test_is_the_interpolating_spline_of_scipy(table: list[tuple[float, float]], part: float) -> None:
    times, values = knots(table)
    time = times[0] + part * (times[-1] - times[0])
    expected = make_interp_spline(times, values, k=5, bc_type=AT_REST)
    found = QuinticSpline(times, values).derivatives(time)
    for order, derivative in enumerate(found):
        # The shortest interval is 0.1: the n-th derivative of values up to 0.5 reaches some 0.5 * 720 * 10^n.
        assert derivative == pytest.approx(float(expected(time, order)), rel=1e-7, abs=1e-7 * 10.0**order)


@given(tables)
def test_passes_through_its_rows_and_no_derivative_up_to_the_fourth_jumps(table: list[tuple[float, float]]) -> None:
    times, values = knots(table)
    curve = QuinticSpline(times, values)
    for index, (time, value) in enumerate(zip(times, values, strict=True)):
        at = curve.derivatives(time)
        assert at[0] == pytest.approx(value, abs=1e-15)
        if 0 < index < len(times) - 1:
            before = curve.derivatives(np.nextafter(time, 0.0))
            for order, (left, right) in enumerate(zip(before, at, strict=True)):
                assert left == pytest.approx(right, rel=1e-6, abs=1e-7 * 10.0**order)


def test_two_rows_are_the_quintic_step() -> None:
    curve, step = QuinticSpline([1.0, 3.5], [0.2, -0.1]), QuinticStep(0.2, -0.1, 1.0, 2.5)
    for time in (0.0, 1.0, 1.3, 2.25, 3.4, 3.5, 9.0):
        assert curve.derivatives(time) == pytest.approx(step.derivatives(time), abs=1e-13)


def test_stays_where_its_ends_are() -> None:
    curve = QuinticSpline([1.0, 2.0, 4.0], [0.1, 0.3, 0.2])
    assert curve.derivatives(0.5) == (0.1, 0.0, 0.0, 0.0, 0.0)
    assert curve.derivatives(4.0) == (0.2, 0.0, 0.0, 0.0, 0.0)


def test_bends_least() -> None:
    """Of all curves through the rows that are at rest at both ends it has the smallest integral of (y''')^2."""
    times, values = [0.0, 1.0, 1.7, 3.0], [0.0, 0.4, -0.2, 0.1]

    def energy(curve: QuinticSpline) -> float:
        found = 0.0
        for a, b in pairwise(times):
            nodes, weights = np.polynomial.legendre.leggauss(6)
            middle, half = 0.5 * (a + b), 0.5 * (b - a)
            found += half * sum(
                w * curve.derivatives(middle + half * x)[3] ** 2 for x, w in zip(nodes, weights, strict=True)
            )
        return found

    least = QuinticSpline(times, values)
    for time in (0.5, 1.3, 2.4):
        for shift in (-0.01, 0.01):
            moved = sorted([*zip(times, values, strict=True), (time, least.derivatives(time)[0] + shift)])
            assert energy(QuinticSpline(*zip(*moved, strict=True))) > energy(least)


@pytest.mark.parametrize(
    ("times", "values", "text"),
    [
        ([0.0], [0.0], "1 times and 1 values"),
        ([0.0, 1.0], [0.0], "2 times and 1 values"),
        ([0.0, 0.0], [0.0, 1.0], r"0\.0 s follows 0\.0 s"),
        ([0.0, 0.0009], [0.0, 1.0], "increase by 0.001 s"),
        ([0.0, float("nan")], [0.0, 1.0], "nan s follows"),
        ([0.0, 1.0], [0.0, float("inf")], "not finite"),
    ],
)
def test_rows_that_make_no_curve(times: list[float], values: list[float], text: str) -> None:
    with pytest.raises(InputError, match=text):
        QuinticSpline(times, values)
