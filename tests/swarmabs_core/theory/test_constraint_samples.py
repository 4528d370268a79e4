"""Samples of preimages against the closed forms, which know each other not."""

from __future__ import annotations

import numpy as np
import pytest
from tests.swarmabs_core.theory.preimages import abstract_states, preimage_positions, sampled_class

from swarmabs_core.theory.constraint_sets import ConstraintSets, StateClass

G = 9.81
PAPER = (0.3552, 0.3532, 0.6762, 0.4596)
EXAMPLE = (2.0, 3.0, 3.0)


def states(masses: tuple[float, ...], count: int) -> list[tuple[float, float]]:
    """Random states all over the region where anything can happen."""
    rng = np.random.default_rng(11)
    end, top = G * sum(masses) / 2, sum(masses) / 4
    return [
        (float(t), float(j))
        for t, j in zip(rng.uniform(-1.1 * end, 1.1 * end, count), rng.uniform(0, 1.1 * top, count), strict=True)
    ]


@pytest.mark.parametrize(("masses", "seen"), [((0.7, 0.4), 1.0), (EXAMPLE, 0.97), (PAPER, 0.9)])
def test_closed_forms_agree_with_samples_of_the_preimage(masses: tuple[float, ...], seen: float) -> None:
    agree, classes = 0, set()
    cases = states(masses, 300)
    for torque, inertia in cases:
        exact = ConstraintSets(masses, 1.0, G).classify(torque, inertia)
        sampled = sampled_class(torque, inertia, masses, 1.0, G, count=3000, seed=5)
        classes.add(exact)
        agree += exact is sampled
        # Samples may miss the few positions that make a state A_P, but never see what is not there.
        assert exact is sampled or exact is StateClass.PARTIAL
    assert agree >= seen * len(cases)
    assert classes == {StateClass.ADMISSIBLE, StateClass.PARTIAL, StateClass.UNREACHABLE, StateClass.EMPTY}


def test_preimage_of_the_papers_example_is_an_ellipse_through_all_its_points() -> None:
    positions = preimage_positions(10.0, 1.0, EXAMPLE, G, 2000, seed=2)
    torque, inertia = abstract_states(positions, EXAMPLE, G)
    assert np.allclose(torque, 10.0, rtol=1e-12) and np.allclose(inertia, 1.0, rtol=1e-12)
    # Uniform on a circle after scaling: every robot reaches T/M +- sqrt((J - T^2/M)(1/m - 1/M)).
    centre, free = 10 / G / 8, 1 - (10 / G) ** 2 / 8
    extent = np.sqrt(free * (1 / np.array(EXAMPLE) - 1 / 8))
    assert np.allclose(positions.max(axis=0), centre + extent, atol=1e-4)
    assert np.allclose(positions.min(axis=0), centre - extent, atol=1e-4)
    assert np.allclose(positions.mean(axis=0), centre, atol=0.03)


def test_samples_depend_on_the_seed_only() -> None:
    first, again, other = (preimage_positions(1.0, 0.1, PAPER, G, 5, seed) for seed in (1, 1, 2))
    assert np.array_equal(first, again) and not np.array_equal(first, other)


def test_nothing_is_drawn_from_an_empty_preimage() -> None:
    with pytest.raises(ValueError, match=r"no positions have 2\.0 N m and less than 0\.0225\d+ kg m\^2, got 0\.01$"):
        preimage_positions(2.0, 0.01, PAPER, G, 5, seed=0)
