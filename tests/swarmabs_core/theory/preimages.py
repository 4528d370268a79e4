"""A check of the closed forms of the constraint sets that knows the definition only.

The preimage of (tau, J) is a sphere of N - 2 dimensions: with T = tau/g and M = sum m it holds the positions
p = T/M + sqrt(J - T^2/M) u/sqrt(m) for unit vectors u that are orthogonal to the vector of all sqrt(m).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from swarmabs_core.theory.constraint_sets import ConstraintSets, StateClass

Floats: TypeAlias = NDArray[np.float64]


def box_positions(masses: Sequence[float], length: float, count: int, seed: int) -> Floats:
    """Return `count` positions (m) of all robots, uniform on the plane: one row for each, one column per robot."""
    return np.random.default_rng(seed).uniform(-length / 2, length / 2, (count, len(masses)))


def abstract_states(positions: Floats, masses: Sequence[float], gravity: float) -> tuple[Floats, Floats]:
    """Return torques (N m) and inertias (kg m^2) of positions (m), which have one row for each state."""
    weights = np.asarray(masses)
    return gravity * (positions * weights).sum(axis=1), (positions**2 * weights).sum(axis=1)


def preimage_positions(
    torque: float, inertia: float, masses: Sequence[float], gravity: float, count: int, seed: int
) -> Floats:
    """Return positions (m) that all have this torque and inertia, uniform on the sphere that the preimage is.

    Parameters
    ----------
    torque, inertia : float
        The abstract state, N m and kg m^2.
    masses : sequence of float
        kg, of at least two robots.
    gravity : float
        m/s^2.
    count : int
        Number of rows of the result; it has one column per robot.
    seed : int
        Of numpy's default generator.

    Raises
    ------
    ValueError
        If the preimage is empty.
    """
    least = ConstraintSets(masses, 1.0, gravity).smallest_inertia(torque)
    if inertia < least:
        raise ValueError(f"no positions have {torque!r} N m and less than {least!r} kg m^2, got {inertia!r}")
    weights = np.asarray(masses)
    normal = np.sqrt(weights / weights.sum())
    drawn = np.random.default_rng(seed).standard_normal((count, len(masses)))
    drawn -= (drawn * normal).sum(axis=1, keepdims=True) * normal
    drawn /= np.sqrt((drawn**2).sum(axis=1, keepdims=True))
    positions: Floats = torque / gravity / weights.sum() + np.sqrt(inertia - least) * drawn / np.sqrt(weights)
    return positions


def sampled_class(
    torque: float,
    inertia: float,
    masses: Sequence[float],
    length: float,
    gravity: float,
    *,
    count: int = 2000,
    seed: int = 0,
) -> StateClass:
    """Return the class of an abstract state as samples of its preimage show it.

    PARTIAL is certain: there are samples on the plane and off it. ADMISSIBLE and UNREACHABLE say that no sample
    contradicted; with 3 or 4 robots few states near a boundary are mistaken, with many robots most are.

    Parameters
    ----------
    torque, inertia : float
        The abstract state, N m and kg m^2.
    masses : sequence of float
        kg, of at least two robots.
    length : float
        Of the plane, m.
    gravity : float
        m/s^2.
    count, seed : int
        Number of samples and what they are drawn from.
    """
    if inertia < ConstraintSets(masses, 1.0, gravity).smallest_inertia(torque):
        return StateClass.EMPTY
    positions = preimage_positions(torque, inertia, masses, gravity, count, seed)
    on_plane = (np.abs(positions) <= length / 2).all(axis=1)
    if on_plane.all():
        return StateClass.ADMISSIBLE
    return StateClass.PARTIAL if on_plane.any() else StateClass.UNREACHABLE
