"""The constraint sets against enumeration, optimisation, subset sums of whole numbers, and the paper's numbers."""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import minimize
from tests.swarmabs_core.theory.preimages import abstract_states, box_positions, preimage_positions

from swarmabs_core.theory.constraint_sets import Bracket, ConstraintSets, StateClass, box_edges

G = 9.81
PAPER = (0.3552, 0.3532, 0.6762, 0.4596)
EXAMPLE = (2.0, 3.0, 3.0)

masses = st.lists(st.floats(0.25, 0.75), min_size=2, max_size=6)
fractions = st.floats(-1.0, 1.0)


def slice_vertices(moment: Fraction, weights: list[Fraction]) -> list[list[Fraction]]:
    """All points of the box |x| <= 1 with sum m x = moment that have at most one |x| < 1, in rational arithmetic."""
    found = []
    for free in range(len(weights)):
        for signs in product((-1, 1), repeat=len(weights) - 1):
            point = [Fraction(sign) for sign in signs]
            point.insert(free, Fraction(0))
            x = (moment - sum(m * p for m, p in zip(weights, point, strict=True))) / weights[free]
            if abs(x) <= 1:
                point[free] = x
                found.append(point)
    return found


def enumerated_largest_inertia(torque: float, masses: list[float], length: float) -> float:
    """J_max by trying every vertex of the slice; -inf if the slice is empty."""
    half, weights = Fraction(length) / 2, [Fraction(m) for m in masses]
    vertices = slice_vertices(Fraction(torque) / Fraction(G) / half, weights)
    return max(
        (float(half**2 * sum(m * x * x for m, x in zip(weights, v, strict=True))) for v in vertices), default=-math.inf
    )


def optimised(objective: np.ndarray, torque: float, masses: tuple[float, ...], seed: int, **limits: float) -> float:
    """Largest value of `objective` p over the preimage or, without an inertia, of sum m p^2 over the slice."""
    weights = np.array(masses)
    moment = {"type": "eq", "fun": lambda p: weights @ p - torque / G, "jac": lambda p: weights}
    constraints, bounds = [moment], None
    if "inertia" in limits:
        inertia = limits["inertia"]
        constraints.append({"type": "eq", "fun": lambda p: weights @ p**2 - inertia, "jac": lambda p: 2 * weights * p})
    else:
        bounds = [(-limits["half"], limits["half"])] * len(masses)
    best = -math.inf
    for start in np.random.default_rng(seed).uniform(-0.5, 0.5, (40, len(masses))):
        if "inertia" in limits:
            found = minimize(
                lambda p: -objective @ p, start, jac=lambda p: -objective, constraints=constraints, tol=1e-12
            )
        else:
            found = minimize(
                lambda p: -weights @ p**2,
                start,
                jac=lambda p: -2 * weights * p,
                constraints=constraints,
                bounds=bounds,
                tol=1e-12,
            )
        if found.success:
            best = max(best, -found.fun)
    return best


# J_max


@given(masses, fractions)
def test_largest_inertia_is_that_of_the_best_vertex(masses: list[float], fraction: float) -> None:
    torque = fraction * G * sum(masses) / 2
    found = ConstraintSets(masses, 1.0, G).largest_inertia(torque)
    assert found.lower == found.upper
    assert found.lower == pytest.approx(enumerated_largest_inertia(torque * (1 - 1e-15), masses, 1.0), rel=1e-10)


@pytest.mark.parametrize("torque", [0.0, 1.0, 3.3, 8.0])
def test_no_optimiser_finds_a_larger_inertia_and_one_finds_it(torque: float) -> None:
    exact = ConstraintSets(PAPER, 1.0, G).largest_inertia(torque).lower
    assert optimised(np.zeros(4), torque, PAPER, 7, half=0.5) == pytest.approx(exact, rel=1e-7)


def test_halves_find_what_all_signs_give() -> None:
    rng = np.random.default_rng(3)
    for count in (13, 16):
        weights = rng.uniform(0.25, 0.75, count)
        weights[4:7] = weights[3]  # some equal ones
        signs = 1.0 - 2.0 * ((np.arange(1 << count)[:, None] >> np.arange(count)) & 1)
        for torque in rng.uniform(-1, 1, 4) * G * weights.sum() / 2:
            moment = torque / G * 2
            best = -math.inf
            for free in range(count):
                x = (moment - (signs @ weights - signs[:, free] * weights[free])) / weights[free]
                x = x[abs(x) <= 1]
                best = max(best, ((weights.sum() - weights[free] * (1 - x**2)) / 4).max(initial=-math.inf))
            found = ConstraintSets(weights.tolist(), 1.0, G).largest_inertia(float(torque))
            assert found == (pytest.approx(best, rel=1e-12),) * 2


def whole_number_deficit(moment: int, weights: list[int]) -> Fraction:
    """Smallest M - sum m x^2 over the slice sum m x = moment, by the subset sums of whole numbers as bits."""
    total, least = sum(weights), Fraction(10**9)
    for index, mass in enumerate(weights):
        subsets = 1
        for other in weights[:index] + weights[index + 1 :]:
            subsets |= subsets << other
        # rest = 2 subset - (total - mass), within mass of the moment
        for subset in range(max(0, (moment + total - 2 * mass) // 2), (moment + total) // 2 + 1):
            x = Fraction(moment - (2 * subset - total + mass), mass)
            if abs(x) <= 1 and subsets >> subset & 1:
                least = min(least, mass * (1 - x * x))
    return least


@pytest.mark.parametrize(("count", "width"), [(21, 1e-14), (40, 5e-4), (100, 5e-4)])
def test_bracket_of_many_robots_holds_the_largest_inertia(count: int, width: float) -> None:
    rng = np.random.default_rng(count)
    weights = sorted({int(m) for m in rng.integers(250, 750, 3 * count)})[::2][:count]
    total = sum(weights)
    # Moments everywhere, and near the end, where few robots or none can stand on the other side.
    for moment in (0, total // 3, total - 5000, total - 1500, total - 600, total - 37, total):
        exact = float(total - whole_number_deficit(moment, weights))
        found = ConstraintSets(weights, 2.0, 1.0).largest_inertia(float(moment))
        assert found.lower <= exact * (1 + 1e-14) and exact * (1 - 1e-14) <= found.upper, moment
        assert found.lower >= exact - width * total
        if total - moment <= 2 * weights[13]:
            assert found.lower == found.upper


def test_any_number_of_equal_robots_is_exact() -> None:
    # Torque 0: halves on both sides; of an odd number one stands in the middle.
    assert ConstraintSets([0.5] * 1000, 1.0, G).largest_inertia(0.0) == Bracket(125.0, 125.0)
    assert ConstraintSets([0.5] * 1001, 1.0, G).largest_inertia(0.0) == Bracket(125.0, 125.0)
    assert ConstraintSets([0.5] * 1000, 1.0, G).largest_inertia(0.25 * G) == Bracket(124.875, 124.875)


def test_all_robots_at_ends_give_the_largest_inertia_of_all() -> None:
    # Corners of the box, where rounding decides whether the slice has a vertex.
    rng = np.random.default_rng(6)
    for count in (2, 3) * 100:
        weights = rng.uniform(0.25, 0.75, count).tolist()
        for signs in product((-1, 1), repeat=count):
            torque = G * math.fsum(m * sign / 2 for m, sign in zip(weights, signs, strict=True))
            assert ConstraintSets(weights, 1.0, G).largest_inertia(torque).lower == pytest.approx(
                sum(weights) / 4, rel=1e-9
            )


def test_beyond_the_largest_torque_there_is_none() -> None:
    end = G * sum(PAPER) / 2
    assert ConstraintSets(PAPER, 1.0, G).largest_inertia(end) == pytest.approx((sum(PAPER) / 4,) * 2, rel=1e-12)
    assert ConstraintSets(PAPER, 1.0, G).largest_inertia(1.0001 * end) == (-math.inf, -math.inf)
    assert ConstraintSets(PAPER, 1.0, G).largest_admissible_inertia(end) == pytest.approx(sum(PAPER) / 4, rel=1e-12)
    assert ConstraintSets(PAPER, 1.0, G).largest_admissible_inertia(1.0001 * end) == -math.inf


def test_its_curve_is_the_upper_envelope_of_the_edges() -> None:
    edges = list(box_edges(PAPER))
    assert len(edges) == len(set(edges)) == 4 * 8
    for torque in np.linspace(-9, 9, 37).tolist():
        moment = torque / G * 2
        over = [(sum(PAPER) - m + (moment - rest) ** 2 / m) / 4 for m, rest in edges if abs(moment - rest) <= m]
        assert ConstraintSets(PAPER, 1.0, G).largest_inertia(torque).lower == pytest.approx(max(over), rel=1e-12)
    assert len(list(box_edges([0.5] * 5))) == 5  # 80 edges, of which 16 each are alike


# A_A


@given(masses, fractions, st.floats(0.0, 2.0))
def test_upper_boundary_of_a_a_is_where_a_robot_reaches_the_end(
    masses: list[float], fraction: float, more: float
) -> None:
    torque = fraction * G * sum(masses) / 2
    least = ConstraintSets(masses, 1.0, G).smallest_inertia(torque)
    boundary = ConstraintSets(masses, 1.0, G).largest_admissible_inertia(torque)
    inertia = least + more * (boundary - least)
    assert ConstraintSets(masses, 1.0, G).largest_position(torque, inertia) == pytest.approx(
        abs(torque) / G / sum(masses) + math.sqrt(more) * (0.5 - abs(torque) / G / sum(masses)), rel=1e-6
    )


@pytest.mark.parametrize(
    ("torque", "inertia", "masses"), [(10.0, 1.0, EXAMPLE), (-1.5, 0.05, PAPER), (0.0, 0.1, PAPER)]
)
def test_no_optimiser_finds_a_position_farther_out_and_one_finds_it(
    torque: float, inertia: float, masses: tuple[float, ...]
) -> None:
    # Each robot towards either side.
    found = [
        optimised(sign * np.eye(len(masses))[robot], torque, masses, 5, inertia=inertia)
        for robot in range(len(masses))
        for sign in (-1, 1)
    ]
    assert max(found) == pytest.approx(ConstraintSets(masses, 1.0, G).largest_position(torque, inertia), rel=1e-6)


# Classes


@given(st.lists(st.floats(0.25, 0.75), min_size=2, max_size=24), st.data())
def test_robots_on_the_plane_are_never_called_off_it(masses: list[float], data: st.DataObject) -> None:
    # Ends and middle are drawn often: vertices and the lower bound, where rounding decides.
    place = st.one_of(st.sampled_from([-0.5, 0.0, 0.5]), st.floats(-0.5, 0.5))
    positions = data.draw(
        st.one_of(st.lists(place, min_size=len(masses), max_size=len(masses)), place.map(lambda p: [p] * len(masses)))
    )
    torque = G * math.fsum(m * p for m, p in zip(masses, positions, strict=True))
    inertia = math.fsum(m * p * p for m, p in zip(masses, positions, strict=True))
    found = ConstraintSets(masses, 1.0, G).classify(torque, inertia)
    assert found in {StateClass.ADMISSIBLE, StateClass.PARTIAL, StateClass.UNDECIDED}
    if found is StateClass.UNDECIDED:
        assert len(set(masses)) > 21


@given(masses, st.floats(-1.2, 1.2), st.floats(-0.1, 1.2), st.randoms(use_true_random=False))
def test_class_does_not_depend_on_side_order_or_units(
    masses: list[float], fraction: float, height: float, random: object
) -> None:
    total = sum(masses)
    torque, inertia = fraction * G * total / 2, height * total / 4
    expected = ConstraintSets(masses, 1.0, G).classify(torque, inertia)
    assert ConstraintSets(masses, 1.0, G).classify(-torque, inertia) is expected
    assert ConstraintSets(masses[::-1], 1.0, G).classify(torque, inertia) is expected
    # Powers of 2 change no digit: masses, lengths, gravity.
    assert ConstraintSets([4 * m for m in masses], 1.0, G).classify(4 * torque, 4 * inertia) is expected
    assert ConstraintSets(masses, 4.0, G).classify(4 * torque, 16 * inertia) is expected
    assert ConstraintSets(masses, 1.0, 4 * G).classify(4 * torque, inertia) is expected


def test_classes_of_the_four_robots_from_below_to_above() -> None:
    torque = 2.0
    bounds = (
        ConstraintSets(PAPER, 1.0, G).smallest_inertia(torque),
        ConstraintSets(PAPER, 1.0, G).largest_admissible_inertia(torque),
        enumerated_largest_inertia(torque, list(PAPER), 1.0),
    )
    assert bounds[0] < bounds[1] < bounds[2]
    order = (StateClass.EMPTY, StateClass.ADMISSIBLE, StateClass.PARTIAL, StateClass.UNREACHABLE)
    for bound, (below, above) in zip(bounds, pairwise(order), strict=True):
        assert ConstraintSets(PAPER, 1.0, G).classify(torque, bound * (1 - 1e-9)) is below
        assert ConstraintSets(PAPER, 1.0, G).classify(torque, bound * (1 + 1e-9)) is above
    end = G * sum(PAPER) / 2
    assert (
        ConstraintSets(PAPER, 1.0, G).classify(
            1.01 * end, ConstraintSets(PAPER, 1.0, G).smallest_inertia(1.01 * end) * 1.001
        )
        is StateClass.UNREACHABLE
    )
    assert (
        ConstraintSets(PAPER, 1.0, G).classify(
            1.01 * end, ConstraintSets(PAPER, 1.0, G).smallest_inertia(1.01 * end) * 0.999
        )
        is StateClass.EMPTY
    )


def test_undecided_only_in_the_bracket() -> None:
    weights = np.random.default_rng(1).uniform(0.25, 0.75, 200).tolist()
    bound = ConstraintSets(weights, 1.0, G).largest_inertia(3.0)
    assert bound.lower < bound.upper
    for inertia, expected in (
        (bound.lower, StateClass.PARTIAL),
        ((bound.lower + bound.upper) / 2, StateClass.UNDECIDED),
        (bound.upper * (1 + 1e-9), StateClass.UNREACHABLE),
    ):
        assert ConstraintSets(weights, 1.0, G).classify(3.0, inertia) is expected


@pytest.mark.parametrize("masses", [(), (0.5,)])
def test_one_robot_is_refused(masses: tuple[float, ...]) -> None:
    for call in (
        lambda: ConstraintSets(masses, 1.0, G).classify(0.0, 0.1),
        lambda: ConstraintSets(masses, 1.0, G).largest_inertia(0.0),
        lambda: ConstraintSets(masses, 1.0, G).largest_admissible_inertia(0.0),
        lambda: ConstraintSets(masses, 1.0, G).manifold_reach(0.01, 0.02),
    ):
        with pytest.raises(ValueError, match=f"need at least two robots, got {len(masses)}$"):
            call()


# The paper's numbers


def test_preimage_of_the_papers_example() -> None:
    # By hand: T = 1.01937, T/M = .12742, T^2/M = .12989, 1/2 - 1/8 = .375, sqrt(.87011 * .375) = .57122.
    assert ConstraintSets(EXAMPLE, 1.0, G).largest_position(10.0, 1.0) == pytest.approx(0.12742 + 0.57122, abs=1e-5)
    assert ConstraintSets(EXAMPLE, 1.0, G).classify(10.0, 1.0) is StateClass.PARTIAL
    assert ConstraintSets(EXAMPLE, 1.3972, G).classify(10.0, 1.0) is StateClass.PARTIAL
    assert ConstraintSets(EXAMPLE, 1.3974, G).classify(10.0, 1.0) is StateClass.ADMISSIBLE


def test_the_papers_manifold_leaves_a_a_long_before_its_end() -> None:
    """The claim that it lies in A_A for |tau| <= 5 is false, and 2.288 is right."""
    reach = ConstraintSets(PAPER, 1.0, G).manifold_reach(0.0125, 0.025)
    assert reach.admissible == pytest.approx(2.288, abs=5e-4)
    assert reach.nonempty == math.inf
    for torque in np.linspace(0, 5, 101).tolist():
        inertia = 0.0125 * torque**2 + 0.025
        positions = preimage_positions(torque, inertia, PAPER, G, 4000, seed=1)
        assert np.allclose(abstract_states(positions, PAPER, G), [[torque], [inertia]], atol=1e-12)
        outside = (np.abs(positions) > 0.5).any(axis=1)
        if torque <= 2.288:
            assert not outside.any()
        elif torque >= 2.4:
            assert outside.any()
    # It does stay in A_A or A_P: up to 5.777, on which vertices enumerated on a grid agree.
    assert reach.reachable.lower == reach.reachable.upper
    assert reach.reachable.lower == pytest.approx(5.777, abs=5e-4)
    below = [
        0.0125 * torque**2 + 0.025 <= enumerated_largest_inertia(torque, list(PAPER), 1.0)
        for torque in (*np.linspace(0, 5.77, 41).tolist(), 5.777, 5.7772)
    ]
    assert below == [True] * 42 + [False]


# Manifolds


@settings(max_examples=60)
@given(masses, st.floats(0.0, 0.05), st.floats(0.001, 1.0))
def test_reach_separates_the_classes(masses: list[float], curvature: float, offset: float) -> None:
    reach = ConstraintSets(masses, 1.0, G).manifold_reach(curvature, offset)

    def at(torque: float) -> StateClass:
        return ConstraintSets(masses, 1.0, G).classify(torque, curvature * torque * torque + offset)

    reachable = {StateClass.ADMISSIBLE, StateClass.PARTIAL}
    assert reach.reachable.lower == reach.reachable.upper
    for limit, classes in ((reach.admissible, {StateClass.ADMISSIBLE}), (reach.reachable.lower, reachable)):
        if limit == -math.inf:
            assert at(0.0) not in classes
        else:
            assert all(at(limit * share * (1 - 1e-9)) in classes for share in np.linspace(0, 1, 41).tolist())
            assert at(limit * (1 + 1e-6) + 1e-6) not in classes
    if reach.nonempty < math.inf:
        assert at(reach.nonempty * (1 + 1e-7)) is StateClass.EMPTY
        assert at(reach.nonempty * (1 - 1e-7)) is not StateClass.EMPTY


def test_reach_of_two_robots() -> None:
    # By hand: on the slice T = 0 the light robot stands at an end and the heavy one a third as far on the other side.
    middle = (0.25 + 0.75 / 9) / 4
    end = G * math.sqrt(0.999 * middle)
    assert ConstraintSets((0.25, 0.75), 1.0, G).manifold_reach(0.0, 0.999 * middle).reachable == pytest.approx(
        (end, end), rel=1e-12
    )
    assert ConstraintSets((0.25, 0.75), 1.0, G).manifold_reach(0.0, 1.001 * middle).reachable == (-math.inf, -math.inf)


def test_reach_ends_at_a_gap_however_narrow() -> None:
    # Manifolds from 0.1 at torque 0 that just touch J_max, or just do not, where it has a dip.
    torques = np.linspace(0.5, 9.0, 1701).tolist()
    steepness = [(enumerated_largest_inertia(t, list(PAPER), 1.0) - 0.1) / t**2 for t in torques]
    dips = [
        (torques[i], steepness[i])
        for i in range(1, len(torques) - 1)
        if steepness[i] < min(steepness[:i]) and steepness[i] < steepness[i + 1]
    ]
    assert dips
    for torque, curvature in dips:
        assert ConstraintSets(PAPER, 1.0, G).manifold_reach(curvature * (1 + 1e-6), 0.1).reachable.upper < torque
        assert ConstraintSets(PAPER, 1.0, G).manifold_reach(curvature * (1 - 1e-3), 0.1).reachable.lower > torque + 0.01


def test_reach_of_many_robots_is_bracketed() -> None:
    weights = np.random.default_rng(2).uniform(0.25, 0.75, 60).tolist()
    reach = ConstraintSets(weights, 1.0, G).manifold_reach(0.0125, 0.025)
    lower, upper = reach.reachable
    assert lower < upper < 1.01 * lower
    for torque in np.linspace(0, lower, 50).tolist():
        assert ConstraintSets(weights, 1.0, G).classify(torque, 0.0125 * torque**2 + 0.025) in {
            StateClass.ADMISSIBLE,
            StateClass.PARTIAL,
        }
    beyond = upper * (1 + 1e-9)
    assert ConstraintSets(weights, 1.0, G).classify(beyond, 0.0125 * beyond**2 + 0.025) is StateClass.UNREACHABLE


def test_box_samples_lie_between_the_curves() -> None:
    positions = box_positions(PAPER, 1.0, 2000, seed=4)
    for torque, inertia in zip(*(x.tolist() for x in abstract_states(positions, PAPER, G)), strict=True):
        assert (
            ConstraintSets(PAPER, 1.0, G).smallest_inertia(torque)
            <= inertia
            <= ConstraintSets(PAPER, 1.0, G).largest_inertia(torque).upper
        )


def test_as_many_robots_as_there_are_ids() -> None:
    """All with another mass: the edges are not even counted one by one."""
    masses = [1.0 + number * 1e-6 for number in range(65_535)]
    reach = ConstraintSets(masses, 1.0, G).manifold_reach(1e-4, 0.025)
    assert 0.0 < reach.admissible <= reach.reachable.lower <= reach.reachable.upper <= reach.nonempty
