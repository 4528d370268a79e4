from __future__ import annotations

from fractions import Fraction
from math import inf, isnan

import pytest
from hypothesis import given, strategies as st

from swarmabs_core.summation import exact_sum


@given(st.lists(st.floats(-1e100, 1e100), max_size=50).flatmap(lambda x: st.tuples(st.just(x), st.permutations(x))))
def test_correctly_rounded_in_any_order(case: tuple[list[float], list[float]]) -> None:
    terms, shuffled = case
    assert exact_sum(terms) == float(sum(map(Fraction, terms)))
    assert exact_sum(shuffled).hex() == exact_sum(terms).hex()


@pytest.mark.parametrize("terms", [[inf, -inf], [1.7e308, 1.7e308, 1.7e308]])
def test_no_sum_is_nan(terms: list[float]) -> None:
    assert isnan(exact_sum(terms))
