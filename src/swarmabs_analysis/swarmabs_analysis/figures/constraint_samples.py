"""Points of the constraint sets, for figures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from swarmabs_core.theory.constraint_sets import ConstraintSets

Floats: TypeAlias = NDArray[np.float64]
Classes: TypeAlias = NDArray[np.object_]


def box_positions(masses: Sequence[float], length: float, count: int, seed: int) -> Floats:
    """Return `count` positions (m) of all robots, uniform on the plane: one row for each, one column per robot."""
    return np.random.default_rng(seed).uniform(-length / 2, length / 2, (count, len(masses)))


def abstract_states(positions: Floats, masses: Sequence[float], gravity: float) -> tuple[Floats, Floats]:
    """Return torques (N m) and inertias (kg m^2) of positions (m), which have one row for each state."""
    weights = np.asarray(masses)
    return gravity * (positions * weights).sum(axis=1), (positions**2 * weights).sum(axis=1)


def classify_points(torques: Floats, inertias: Floats, sets: ConstraintSets) -> Classes:
    """Return the `StateClass` of each abstract state, as `classify` does.

    Parameters
    ----------
    torques, inertias : array
        N m and kg m^2, of one shape, which is that of the result.
    sets : ConstraintSets
        The robots on their plane.
    """
    pairs = zip(np.ravel(torques).tolist(), np.ravel(inertias).tolist(), strict=True)
    found = np.empty(np.size(torques), dtype=object)
    found[:] = [sets.classify(torque, inertia) for torque, inertia in pairs]
    return found.reshape(np.shape(torques))
