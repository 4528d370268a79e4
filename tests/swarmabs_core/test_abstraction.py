from fractions import Fraction
from itertools import combinations, product
from math import inf, isnan, nan

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from swarmabs_core.abstraction import Weight, abstraction, conditioned, damping_sums, is_degenerate, second_moments
from swarmabs_core.messages import AuxiliaryState
from swarmabs_core.summation import added, exact_sum
from swarmabs_core.swarm_law import pinv_row

masses = st.floats(0.05, 5.0)
lengths = st.floats(-2.0, 2.0)
weights = st.lists(st.builds(Weight, masses, lengths, lengths), min_size=1, max_size=12)
Bodies = list[tuple[float, float]]


def exactly(*terms: float) -> Fraction:
    product = Fraction(1)
    for term in terms:
        product *= Fraction(term)
    return product


def pairwise_s3(robots: Bodies) -> Fraction:
    return sum(
        (exactly(m, m, n, n) * (Fraction(p) - Fraction(q)) ** 2 for (m, p), (n, q) in combinations(robots, 2)),
        Fraction(0),
    )


@settings(max_examples=50)
@given(weights, st.floats(0.0, 5.0))
def test_sums_against_rational_arithmetic(robots: list[Weight], ksd: float) -> None:
    found = abstraction(robots, 9.81)
    scale = 1e-14 * sum(m * 20.0 for m, _, _ in robots)
    g = Fraction(9.81)
    assert found.torque == pytest.approx(float(g * sum(exactly(m, p) for m, p, _ in robots)), abs=scale)
    assert found.inertia == pytest.approx(float(sum(exactly(m, p, p) for m, p, _ in robots)), rel=1e-15)
    assert found.torque_rate == pytest.approx(float(g * sum(exactly(m, v) for m, _, v in robots)), abs=scale)
    rate = float(2 * sum(exactly(m, p, v) for m, p, v in robots))
    assert found.inertia_rate == pytest.approx(rate, abs=scale)
    assert found.q == pytest.approx(float(sum(exactly(m, v, v) for m, _, v in robots)), rel=1e-15)

    pairs = [(m, p) for m, p, _ in robots]
    moments = second_moments(pairs)
    s0, s1, s2 = (sum(exactly(m, m) * Fraction(p) ** k for m, p in pairs) for k in (0, 1, 2))
    assert moments.s0 == pytest.approx(float(s0), rel=1e-15)
    assert moments.s1 == pytest.approx(float(s1), abs=1e-15 * float(s0) * 4)
    assert moments.s2 == pytest.approx(float(s2), rel=2e-15)
    assert s0 * s2 - s1 * s1 == pairwise_s3(pairs)
    assert moments.s3 == pytest.approx(float(pairwise_s3(pairs)), abs=4e-16 * float(s0 * s2) + 1e-305)

    damped = [(m, p, abs(v)) for m, p, v in robots]  # a velocity serves as a damping here
    for k, total in enumerate(damping_sums(damped, ksd)):
        exact = [Fraction(m) * (Fraction(c) + Fraction(ksd)) * Fraction(p) ** k for m, p, c in damped]
        rounding = 2e-15 * float(sum(map(abs, exact))) + 1e-305  # or below the smallest normal number
        assert total == pytest.approx(float(sum(exact)), abs=rounding)


@settings(max_examples=30)
@given(weights.flatmap(lambda x: st.tuples(st.just(x), st.permutations(x))), st.floats(0.0, 5.0))
def test_no_bit_depends_on_the_order(case: tuple[list[Weight], list[Weight]], ksd: float) -> None:
    first, second = case
    assert abstraction(first, 9.81) == abstraction(second, 9.81)
    assert second_moments((m, p) for m, p, _ in first) == second_moments((m, p) for m, p, _ in second)
    # A velocity serves as a damping here.
    assert damping_sums(first, ksd) == damping_sums(second, ksd)


@given(st.lists(st.tuples(masses, st.floats(1e-6, 2e-6)), min_size=2, max_size=8), st.floats(-1.0, 1.0))
def test_s3_loses_only_what_its_terms_lose_when_the_robots_are_close(robots: Bodies, centre: float) -> None:
    """The rounded sums would lose as many digits, and the sign, whatever their terms are."""
    close = [(m, centre + p) for m, p in robots]
    moments = second_moments(close)
    assert moments.s3 == pytest.approx(float(pairwise_s3(close)), abs=4e-16 * moments.s0 * moments.s2)
    rows = [(m * m, m * m * p, m * m * p * p) for m, p in close]
    s0, s1, s2 = (sum(Fraction(row[k]) for row in rows) for k in range(3))
    assert moments.s3 == max(0.0, float(s0 * s2 - s1 * s1)), "rounded once"


def test_nothing_one_point_and_nan_are_degenerate_and_what_is_near_relative_to_plane_and_masses() -> None:
    assert abstraction([], 9.81) == (0.0, 0.0, 0.0, 0.0, 0.0)
    assert second_moments([]) == (0.0, 0.0, 0.0, 0.0)
    assert damping_sums([], 1.0) == (0.0, 0.0, 0.0)
    s0, _, _, s3 = second_moments([(0.5, 0.25)] * 4)
    assert s3 == 0.0, "exactly, where all robots stand at one point"
    for sums in ((s0, s3), (0.0, 0.0), (nan, 1.0), (1.0, nan)):
        assert is_degenerate(*sums, 1.0)
    # Two equal robots 2d apart have S3 = 4 m^4 d^2 and S0 = 2 m^2: the limit is d = 1e-4 L.
    for length, mass, (d, expected) in product((0.1, 1.0, 30.0), (1e-3, 1.0, 1e3), ((0.99e-4, True), (1.01e-4, False))):
        s0, _, _, s3 = second_moments([(mass, d * length), (mass, -d * length)])
        assert is_degenerate(s0, s3, length) is expected


@pytest.mark.parametrize("share", [1.5, 1.0, 0.1, 1e-4, 0.0])
def test_near_one_point_the_torque_is_exact_and_the_inertia_is_commanded_by_a_vanishing_share(share: float) -> None:
    """Motions by the rows of the pseudo-inverse, summed up: the torque's never touches the inertia's share."""
    length, d = 2.0, share * 1e-4 * 2.0
    robots = [(0.4, 0.3 + d), (0.4, 0.3 - d)]
    moments = second_moments(robots)
    sums = AuxiliaryState(0, 0, *moments, 0.0, 0.0, 0.0, 0.0)
    used = conditioned(sums, length)
    assert (used is sums) == (share > 1.0)
    rows = [pinv_row(m, p, used, 9.81) for m, p in robots]
    by_torque, by_inertia = zip(*rows, strict=True)
    jacobian = [(9.81 * m, 2.0 * m * p) for m, p in robots]
    assert sum(j * r for (j, _), r in zip(jacobian, by_torque, strict=True)) == pytest.approx(1.0, rel=1e-9)
    assert sum(j * r for (j, _), r in zip(jacobian, by_inertia, strict=True)) == pytest.approx(0.0, abs=1e-3)
    reached = sum(j * r for (_, j), r in zip(jacobian, by_inertia, strict=True))
    assert reached == pytest.approx(min(1.0, share**4), rel=1e-3, abs=1e-8)


@settings(max_examples=50)
@given(st.lists(st.floats(-1e100, 1e100), max_size=50).flatmap(lambda x: st.tuples(st.just(x), st.permutations(x))))
def test_correctly_rounded_in_any_order(case: tuple[list[float], list[float]]) -> None:
    terms, shuffled = case
    assert exact_sum(terms) == float(sum(map(Fraction, terms)))
    assert exact_sum(shuffled).hex() == exact_sum(terms).hex()


@pytest.mark.parametrize("terms", [[inf, -inf], [1.7e308, 1.7e308, 1.7e308]])
def test_no_sum_is_nan(terms: list[float]) -> None:
    assert isnan(exact_sum(terms))


@given(st.lists(st.floats(-1e300, 1e300) | st.floats(-1.0, 1.0), max_size=8))
def test_few_terms_are_added_one_after_the_other(terms: list[float]) -> None:
    """By exact arithmetic, rounded after each term; the built-in sum differs since Python 3.12."""
    rounded = 0.0
    for term in terms:
        rounded = float(Fraction(rounded) + Fraction(term))
    assert added(terms) == rounded
    assert added([np.array([term, 1.0]) for term in terms] or [np.zeros(2)]).tolist() == [rounded, float(len(terms))]


def test_few_terms_by_hand() -> None:
    assert added([0.1] * 10) == 0.9999999999999999
    assert added([1e308, 1e308]) == inf
    assert added(iter(())) == 0.0
