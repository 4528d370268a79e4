"""Sums over robots: exact, in any grouping, as numbers or columns."""

from fractions import Fraction
from math import fsum, inf, isnan, nan

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st

from swarmabs_core.summation import (
    PLACES,
    column_sums,
    determinant,
    each_sum,
    exact_sum,
    exact_units,
    robot_sums,
    rounded,
)
from swarmabs_run.swarm_columns import step_sums

doubles = st.floats(allow_nan=False, allow_infinity=False)
usual = st.floats(-10.0, 10.0)
LEAST = 5e-324


@settings(max_examples=200)
@given(st.lists(st.lists(st.one_of(usual, st.floats(-1e300, 1e300)), max_size=8), max_size=6), st.randoms())
@example([[1e16, 1.0], [-1e16], [1e-300, LEAST]], None)
def test_partial_sums_in_any_grouping_and_order_are_the_exact_sum(groups: list[list[float]], random: object) -> None:
    parts = [exact_units(group) for group in groups]
    exact = sum((Fraction(term) for group in groups for term in group), Fraction(0))
    if random is not None:
        random.shuffle(parts)  # type: ignore[attr-defined]
    whole = sum(parts)
    assert whole == exact_units([term for group in groups for term in group]) == exact * 2**1074
    assert rounded(whole) == float(exact)


@pytest.mark.parametrize("terms", [[inf], [nan, 1.0], [inf, -inf], [1e308, 1e308]])
def test_a_sum_that_is_not_finite_is_refused_and_rounds_to_nan(terms: list[float]) -> None:
    with pytest.raises((OverflowError, ValueError)):
        exact_units(terms)
    assert not exact_sum(terms) < inf
    assert all(map(isnan, determinant([terms, terms, terms])))


def test_a_product_that_overflows_is_nan_and_one_that_underflows_is_rounded() -> None:
    huge, tiny = exact_units([1e300]), exact_units([3e-170])
    assert isnan(rounded(huge * huge, 2 * PLACES))
    assert rounded(tiny * tiny, 2 * PLACES) == float(Fraction(3e-170) ** 2)
    assert rounded(tiny * tiny * tiny, 3 * PLACES) == 0.0


@given(st.lists(st.tuples(st.floats(1e-3, 1e3), usual), min_size=1, max_size=12))
def test_a_determinant_of_sums_is_rounded_once(robots: list[tuple[float, float]]) -> None:
    columns = [[m * p**k for m, p in robots] for k in range(3)]
    a, b, c = (sum(map(Fraction, column), Fraction(0)) for column in columns)
    assert determinant(columns) == [float(a), float(b), float(c), max(0.0, float(a * c - b * b))]


@given(st.lists(st.lists(st.tuples(usual, usual), min_size=3, max_size=3), min_size=1, max_size=6))
def test_columns_and_steps_have_the_bits_of_robots(steps: list[list[tuple[float, float]]]) -> None:
    def terms(m: float = 0.0, p: float = 0.0) -> tuple[float, ...]:
        return m * m, m * p, p * p

    for reduction in (each_sum, determinant):
        alone = [robot_sums(robots, terms, reduction) for robots in steps]
        columns = [column_sums(tuple(np.array(robots).T), terms, reduction) for robots in steps]
        m, p = np.array(steps).transpose(2, 1, 0)
        assert alone == columns == np.array(step_sums((m, p), terms, reduction)).T.tolist()
        same = step_sums((m[:, :1], p), terms, reduction)  # masses are those of every step
        assert np.array(same).T.tolist() == np.array(step_sums((m[:, :1] + 0.0 * p, p), terms, reduction)).T.tolist()


def test_an_exact_sum_is_that_of_the_standard_library() -> None:
    assert exact_sum([0.1] * 10) == fsum([0.1] * 10) == 1.0
