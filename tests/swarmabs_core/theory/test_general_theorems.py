"""Room around the desired state and S_c, against boundaries and level sets drawn point by point."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from swarmabs_core.theory.constraint_sets import ConstraintSets, StateClass
from swarmabs_core.theory.general_theorems import Ball, clearance, constrained_level, manifold_clearance

G = 9.81
PAPER = (0.3552, 0.3532, 0.6762, 0.4596)


def around(torque: float, inertia: float, radius: float) -> set[StateClass]:
    angles = np.linspace(0, 2 * math.pi, 721)
    return {
        ConstraintSets(PAPER, 1.0, G).classify(torque + radius * math.cos(a), inertia + radius * math.sin(a))
        for a in angles.tolist()
    }


@settings(max_examples=60)
@given(st.floats(-8.0, 8.0), st.floats(0.02, 0.98))
def test_ball_of_the_clearance_touches_the_boundary(torque: float, share: float) -> None:
    least, most = (
        ConstraintSets(PAPER, 1.0, G).smallest_inertia(torque),
        ConstraintSets(PAPER, 1.0, G).largest_admissible_inertia(torque),
    )
    inertia = least + share * (most - least)
    found = clearance(ConstraintSets(PAPER, 1.0, G), torque, inertia)
    assert around(torque, inertia, found.radius * (1 - 1e-6)) == {StateClass.ADMISSIBLE}
    assert len(around(torque, inertia, found.radius * 1.001)) > 1


@pytest.mark.parametrize(
    ("torque", "inertia"),
    [(0.0, 0.025), (1.0, 0.0375), (-2.0, 0.2), (5.0, 0.3375), (3.0, 0.01), (0.01, 0.3), (9.1, 0.3)],
)
def test_clearance_is_the_distance_to_the_nearest_point_of_each_curve(torque: float, inertia: float) -> None:
    found = clearance(ConstraintSets(PAPER, 1.0, G), torque, inertia)
    end = G * sum(PAPER) / 2
    taus = np.linspace(-1.1 * end, 1.1 * end, 200_001)
    lower = np.hypot(taus - torque, (taus / G) ** 2 / sum(PAPER) - inertia).min()
    taus = np.linspace(-end, end, 200_001)
    left = 0.5 - np.abs(taus) / G / sum(PAPER)
    upper_curve = (taus / G) ** 2 / sum(PAPER) + left**2 / (1 / min(PAPER) - 1 / sum(PAPER))
    upper = np.hypot(taus - torque, upper_curve - inertia).min()
    assert [abs(x) for x in found] == pytest.approx([lower, upper], rel=1e-5)
    inside = ConstraintSets(PAPER, 1.0, G).classify(torque, inertia) is StateClass.ADMISSIBLE
    assert (found.radius >= 0) == inside


def test_room_of_the_papers_manifold() -> None:
    # 0.025 is the manifold's height at 0, where the lower bound is 0.
    for torque_max in (0.32, 1.0, 2.0):
        found = manifold_clearance(ConstraintSets(PAPER, 1.0, G), 0.0125, 0.025, torque_max)
        grid = [
            clearance(ConstraintSets(PAPER, 1.0, G), t, 0.0125 * t * t + 0.025)
            for t in np.linspace(0, torque_max, 1999).tolist()
        ]
        assert found.lower == pytest.approx(min(x.lower for x in grid), rel=1e-6) == pytest.approx(0.025)
        assert found.upper == pytest.approx(min(x.upper for x in grid), rel=1e-6)
    # No room up to 5; the room ends where the manifold leaves A_A.
    assert manifold_clearance(ConstraintSets(PAPER, 1.0, G), 0.0125, 0.025, 5.0).radius < -0.1
    end = ConstraintSets(PAPER, 1.0, G).manifold_reach(0.0125, 0.025).admissible
    assert manifold_clearance(ConstraintSets(PAPER, 1.0, G), 0.0125, 0.025, end).upper == pytest.approx(0.0, abs=1e-9)


def test_the_papers_first_error_has_no_room() -> None:
    """By the letter, D_ac leaves out the errors with which the paper's PD run starts, for any torque_max."""
    # Of the errors that the paper accepts, |e_tau| < 2 and |e_J| <= 0.03, some belong to no positions.
    assert ConstraintSets(PAPER, 1.0, G).classify(0.0, 0.025 - 0.03) is StateClass.EMPTY
    initial = math.hypot(0.0482, -0.0026)
    assert initial > manifold_clearance(ConstraintSets(PAPER, 1.0, G), 0.0125, 0.025, 0.01).radius
    # What remains inside A_A is larger if the run's torques, at most 0.32, are taken.
    assert initial < manifold_clearance(ConstraintSets(PAPER, 1.0, G), 0.0125, 0.025, 0.32).upper


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


def test_without_room_s_c_is_empty() -> None:
    assert constrained_level(1.0, Ball(0.2, 1.0), Ball(-0.1, 1.0)) == -math.inf
    assert constrained_level(1.0, Ball(0.2, 1.0), Ball(0.0, 1.0)) == 0.0
