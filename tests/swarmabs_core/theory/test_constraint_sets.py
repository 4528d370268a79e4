"""The constraint sets against enumeration, optimisation, subset sums of whole numbers, and the paper's numbers."""

import math
from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from swarmabs_core.theory.constraint_sets import Bracket, ConstraintSets, StateClass, box_edges
from swarmabs_core.theory.general_theorems import Ball, clearance, constrained_level, manifold_clearance

G = 9.81
PAPER = (0.3552, 0.3532, 0.6762, 0.4596)
FOUR = ConstraintSets(PAPER, 1.0, G)

masses = st.lists(st.floats(0.25, 0.75), min_size=2, max_size=6)
fractions = st.floats(-1.0, 1.0)


def enumerated_largest_inertia(torque: float, masses: Sequence[float]) -> float:
    """J_max by trying all points of the box |x| <= 1 with the right sum m x that have at most one |x| < 1; L = 1."""
    weights, largest = [Fraction(m) for m in masses], -math.inf
    for free, *signs in product(range(len(weights)), *[(-1, 1)] * (len(weights) - 1)):
        others = weights[:free] + weights[free + 1 :]
        moment = 2 * Fraction(torque) / Fraction(G) - sum(m * sign for m, sign in zip(others, signs, strict=True))
        if abs(x := moment / weights[free]) <= 1:
            largest = max(largest, float(sum(others) + weights[free] * x * x) / 4)
    return largest


@settings(max_examples=30)
@given(masses, fractions)
def test_largest_inertia_is_that_of_the_best_vertex(masses: list[float], fraction: float) -> None:
    torque = fraction * G * sum(masses) / 2
    found = ConstraintSets(masses, 1.0, G).largest_inertia(torque)
    assert found.lower == found.upper
    assert found.lower == pytest.approx(enumerated_largest_inertia(torque * (1 - 1e-15), masses), rel=1e-10)


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


@pytest.mark.parametrize(("count", "width"), [(21, 1e-14), (40, 5e-4)])
def test_bracket_of_many_robots_holds_the_largest_inertia(count: int, width: float) -> None:
    rng = np.random.default_rng(count)
    weights = sorted({int(m) for m in rng.integers(250, 750, 3 * count)})[::2][:count]
    total = sum(weights)
    # Moments everywhere, and near the end, where few robots or none can stand on the other side.
    last = 2 * weights[13]  # what is missing from the end there makes the answer exact for any number of robots
    for missing in (total, 2 * total // 3, 5000, 1500, last, 600, 37, 0):
        moment = total - missing
        exact = float(total - whole_number_deficit(moment, weights))
        found = ConstraintSets(weights, 2.0, 1.0).largest_inertia(float(moment))
        assert found.lower <= exact * (1 + 1e-14) and exact * (1 - 1e-14) <= found.upper, moment
        assert found.lower >= exact - width * total
        if count == 21 or missing <= last:
            assert found.lower == found.upper
    beyond = ConstraintSets(weights, 2.0, 1.0).largest_inertia(float(total - last - 1))
    assert (beyond.lower == beyond.upper) == (count == 21)


@pytest.mark.parametrize("masses", [(), (0.5,)])
def test_one_robot_is_refused(masses: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match=f"need at least two robots, got {len(masses)}$"):
        ConstraintSets(masses, 1.0, G).classify(0.0, 0.1)


def test_edges_that_are_alike_are_one_and_beyond_the_largest_torque_there_is_none() -> None:
    edges = list(box_edges(PAPER))
    assert len(edges) == len(set(edges)) == 4 * 8
    assert len(list(box_edges([0.5] * 5))) == 5  # 80 edges, of which 16 each are alike
    # Torque 0: halves on both sides; of an odd number one stands in the middle.
    assert ConstraintSets([0.5] * 1000, 1.0, G).largest_inertia(0.0) == Bracket(125.0, 125.0)
    assert ConstraintSets([0.5] * 1001, 1.0, G).largest_inertia(0.0) == Bracket(125.0, 125.0)
    assert ConstraintSets([0.5] * 1000, 1.0, G).largest_inertia(0.25 * G) == Bracket(124.875, 124.875)
    end = G * sum(PAPER) / 2
    assert FOUR.largest_inertia(end) == pytest.approx((sum(PAPER) / 4,) * 2, rel=1e-12)
    assert FOUR.largest_inertia(1.0001 * end) == (-math.inf, -math.inf)
    assert FOUR.largest_admissible_inertia(end) == pytest.approx(sum(PAPER) / 4, rel=1e-12)
    assert FOUR.largest_admissible_inertia(1.0001 * end) == -math.inf


@settings(max_examples=30)
@given(masses, fractions, st.floats(0.0, 2.0))
def test_upper_boundary_of_a_a_has_a_robot_at_the_end(masses: list[float], fraction: float, more: float) -> None:
    torque = fraction * G * sum(masses) / 2
    least = ConstraintSets(masses, 1.0, G).smallest_inertia(torque)
    boundary = ConstraintSets(masses, 1.0, G).largest_admissible_inertia(torque)
    inertia = least + more * (boundary - least)
    centre = abs(torque) / G / sum(masses)
    expected = centre + math.sqrt(more) * (0.5 - centre)
    assert ConstraintSets(masses, 1.0, G).largest_position(torque, inertia) == pytest.approx(expected, rel=1e-6)


@settings(max_examples=30)
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


@pytest.mark.parametrize("torque", [1.0, 2.0, 6.0])
def test_classes_of_the_four_robots_from_below_to_above(torque: float) -> None:
    end = 1.01 * G * sum(PAPER) / 2
    inner = FOUR.smallest_inertia(torque), FOUR.largest_admissible_inertia(torque)
    bounds = (*inner, enumerated_largest_inertia(torque, PAPER))
    order = (StateClass.EMPTY, StateClass.ADMISSIBLE, StateClass.PARTIAL, StateClass.UNREACHABLE)
    slack = 1e-12 * sum(PAPER) / 4
    for bound, tolerated, (below, above) in zip(bounds, (-slack, slack, slack), pairwise(order), strict=True):
        assert FOUR.classify(torque, bound + tolerated - 0.5 * slack) is below
        assert FOUR.classify(torque, bound + tolerated + 0.5 * slack) is above
    assert FOUR.classify(end, FOUR.smallest_inertia(end) * 1.001) is StateClass.UNREACHABLE
    assert FOUR.classify(end, FOUR.smallest_inertia(end) * 0.999) is StateClass.EMPTY


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


@settings(max_examples=20)
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


def test_reach_of_two_robots_by_hand() -> None:
    # On the slice T = 0 the light robot stands at an end and the heavy one a third as far on the other side.
    middle = (0.25 + 0.75 / 9) / 4
    end = G * math.sqrt(0.999 * middle)
    two = ConstraintSets((0.25, 0.75), 1.0, G)
    assert two.manifold_reach(0.0, 0.999 * middle).reachable == pytest.approx((end, end), rel=1e-12)
    assert two.manifold_reach(0.0, 1.001 * middle).reachable == (-math.inf, -math.inf)
    # Both of 0.5 kg, L = 2, g = 1: J_max is 1 - 2 |tau| + 2 tau^2, as steep as the manifold 2 tau^2 + 0.5.
    assert ConstraintSets((0.5, 0.5), 2.0, 1.0).manifold_reach(2.0, 0.5).reachable == (0.25, 0.25)


def test_reach_ends_at_a_gap_however_narrow() -> None:
    """Manifolds from 0.1 at torque 0 that just touch J_max, or just do not, where it has a dip."""
    torques = np.linspace(0.5, 9.0, 341).tolist()
    steepness = [(FOUR.largest_inertia(torque).lower - 0.1) / torque**2 for torque in torques]
    dips = [
        (torques[i], steepness[i])
        for i in range(1, len(torques) - 1)
        if steepness[i] < min(steepness[:i]) and steepness[i] < steepness[i + 1]
    ]
    assert dips
    for torque, curvature in dips:
        assert FOUR.manifold_reach(curvature * (1 + 1e-3), 0.1).reachable.upper < torque + 0.025
        assert FOUR.manifold_reach(curvature * (1 - 1e-2), 0.1).reachable.lower > torque + 0.01


def test_reach_of_many_robots_is_bracketed() -> None:
    weights = np.random.default_rng(2).uniform(0.25, 0.75, 60).tolist()
    reach = ConstraintSets(weights, 1.0, G).manifold_reach(0.0125, 0.025)
    lower, upper = reach.reachable
    assert lower < upper < 1.01 * lower
    for torque in np.linspace(0, lower, 20).tolist():
        found = ConstraintSets(weights, 1.0, G).classify(torque, 0.0125 * torque**2 + 0.025)
        assert found in {StateClass.ADMISSIBLE, StateClass.PARTIAL}
    beyond = upper * (1 + 1e-9)
    assert ConstraintSets(weights, 1.0, G).classify(beyond, 0.0125 * beyond**2 + 0.025) is StateClass.UNREACHABLE
    # All at the ends are M L^2/4 at torque 0, and at most that at any: the bound that needs no search.
    most = math.fsum(weights) / 4
    assert upper == pytest.approx(math.sqrt((most - 0.025) / 0.0125), rel=1e-12)
    assert ConstraintSets(weights, 1.0, G).manifold_reach(0.0125, most).reachable.upper == 0.0
    assert ConstraintSets(weights, 1.0, G).manifold_reach(0.0125, 1.001 * most).reachable == (-math.inf, -math.inf)
    many = ConstraintSets([1.0 + number * 1e-6 for number in range(4000)], 1.0, G).manifold_reach(1e-4, 0.025)
    assert 0.0 < many.admissible <= many.reachable.lower <= many.reachable.upper <= many.nonempty


@pytest.mark.parametrize(
    ("torque", "inertia"),
    [(0.0, 0.025), (1.0, 0.0375), (-2.0, 0.2), (5.0, 0.3375), (3.0, 0.01), (0.01, 0.3), (9.1, 0.3)],
)
def test_clearance_is_the_distance_to_the_nearest_point_of_each_curve(torque: float, inertia: float) -> None:
    found = clearance(FOUR, torque, inertia)
    end = G * sum(PAPER) / 2
    taus = np.linspace(-1.1 * end, 1.1 * end, 200_001)
    lower = np.hypot(taus - torque, (taus / G) ** 2 / sum(PAPER) - inertia).min()
    taus = np.linspace(-end, end, 200_001)
    left = 0.5 - np.abs(taus) / G / sum(PAPER)
    upper_curve = (taus / G) ** 2 / sum(PAPER) + left**2 / (1 / min(PAPER) - 1 / sum(PAPER))
    upper = np.hypot(taus - torque, upper_curve - inertia).min()
    assert [abs(x) for x in found] == pytest.approx([lower, upper], rel=1e-5)
    inside = FOUR.classify(torque, inertia) is StateClass.ADMISSIBLE
    assert (found.radius >= 0) == inside


def test_room_of_the_papers_manifold() -> None:
    # 0.025 is the manifold's height at 0, where the lower bound is 0.
    for torque_max in (0.32, 1.0, 2.0):
        found = manifold_clearance(FOUR, 0.0125, 0.025, torque_max)
        grid = [clearance(FOUR, t, 0.0125 * t * t + 0.025) for t in np.linspace(0, torque_max, 401).tolist()]
        assert found.lower == pytest.approx(min(x.lower for x in grid), rel=1e-6) == pytest.approx(0.025)
        assert found.upper == pytest.approx(min(x.upper for x in grid), rel=1e-6)
    # No room up to 5; the room ends where the manifold leaves A_A.
    assert manifold_clearance(FOUR, 0.0125, 0.025, 5.0).radius < -0.1
    end = FOUR.manifold_reach(0.0125, 0.025).admissible
    assert manifold_clearance(FOUR, 0.0125, 0.025, end).upper == pytest.approx(0.0, abs=1e-9)
    assert constrained_level(1.0, Ball(0.2, 1.0), Ball(-0.1, 1.0)) == -math.inf
    assert constrained_level(1.0, Ball(0.2, 1.0), Ball(0.0, 1.0)) == 0.0


@pytest.mark.parametrize(("level", "decides"), [(0.02, "S"), (9.0, "parent"), (9.1, "abstract")])
def test_level_of_s_c_is_the_least_on_the_boundary(level: float, decides: str) -> None:
    p = np.array([[2.0, 0.4], [0.4, 1.0]])
    kappa = 3.0
    radii = (0.2, 0.5) if decides == "parent" else (0.5, 0.2)
    growths = (float(np.linalg.eigvalsh(p)[0]), kappa / 2)
    found = constrained_level(level, Ball(radii[0], growths[0]), Ball(radii[1], growths[1]))
    # Points on the boundary of S and both balls, along rays in all directions.
    rays = np.random.default_rng(1).standard_normal((200_000, 4))
    rays[:5000, :2] = 0.0
    rays[5000:10000, 2:] = 0.0
    value = np.einsum("ki,ij,kj->k", rays[:, :2], p, rays[:, :2]) + kappa / 2 * (rays[:, 2:] ** 2).sum(axis=1)
    norms = np.hypot(rays[:, 0], rays[:, 1]), np.hypot(rays[:, 2], rays[:, 3])
    with np.errstate(divide="ignore"):
        reach = np.minimum(np.sqrt(level / value), np.minimum(radii[0] / norms[0], radii[1] / norms[1]))
    assert found == pytest.approx((value * reach**2).min(), rel=1e-5)
