"""Which robots weigh on the plane at which step, and how far the swarm is from its constraints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from swarmabs_core.theory.constraint_sets import ConstraintSets
from swarmabs_core.theory.general_theorems import clearance

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from swarmabs_analysis.report.record import Recorded

    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]

_MOST_ROWS = 10_000
"""Steps for which the distance to A_A's boundary is computed; of longer runs every second one, third one and so on."""


@dataclass(frozen=True, slots=True)
class Weights:
    """The robots on the plane.

    Attributes
    ----------
    there : ndarray of bool, (n+1, N)
        Whether a robot's weight is on the plane.
    position : ndarray, (n+1, N)
        Where it is, m; of one that is out of the run where it stands. NaN if it is not there.
    mass : ndarray, (N,)
        kg.
    """

    there: Flags
    position: Floats
    mass: Floats

    @property
    def torque_over_gravity(self) -> Floats:
        """The sum of mass times position at each step, kg m."""
        return np.nansum(self.mass * self.position, axis=1)

    @property
    def inertia(self) -> Floats:
        """The sum of mass times squared position at each step, kg m^2."""
        return np.nansum(self.mass * self.position**2, axis=1)

    @property
    def reach(self) -> Floats:
        """The largest distance from the axis at each step, m; NaN without robots."""
        filled = np.where(self.there, np.abs(self.position), -np.inf)
        reach = filled.max(axis=1, initial=-np.inf)
        return np.where(np.isfinite(reach), reach, np.nan)

    def spans(self) -> Iterator[tuple[int, int, tuple[float, ...]]]:
        """Yield spans of rows [begin, end) in which the same robots are there, with the masses of these, kg."""
        if not len(self.there):
            return
        changes = np.flatnonzero((self.there[1:] != self.there[:-1]).any(axis=1)) + 1
        begins = [0, *changes.tolist()]
        for begin, end in zip(begins, [*begins[1:], len(self.there)], strict=True):
            yield begin, end, tuple(self.mass[self.there[begin]].tolist())


def weights(recorded: Recorded) -> Weights:
    """Return which robots are on the plane: a robot that died stays where it was, one that left is gone."""
    agents = recorded.arrays.agents
    mass = np.nanmax(np.where(agents.kind > 0, agents.mass, -np.inf), axis=0, initial=-np.inf)
    return Weights(recorded.swarm.on_plane, recorded.swarm.positions, mass)


@dataclass(frozen=True, slots=True)
class Margins:
    """How far a run is from its constraints.

    Attributes
    ----------
    end : ndarray, (n+1,)
        From the outermost robot to the plane's end, m; negative beyond it.
    spread : ndarray, (n+1,)
        S3/S0^2, m^2; the swarm is singular at 0.
    rows : ndarray of int, (r,)
        The rows at which the following two are given.
    actual, desired : ndarray, (r,)
        Distance of the abstract state, and of the desired one, to the upper boundary J_A of A_A; negative beyond it.
    """

    end: Floats
    spread: Floats
    rows: NDArray[np.int64]
    actual: Floats
    desired: Floats


def margins(recorded: Recorded, on_plane: Weights) -> Margins:
    """Compute the margins of a run; A_A is that of all robots whose weight is on the plane."""
    arrays, plane = recorded.arrays, recorded.scenario.plane
    rows = np.arange(0, len(arrays.step), max(1, -(-len(arrays.step) // _MOST_ROWS)))
    actual, desired = np.full(len(rows), np.nan), np.full(len(rows), np.nan)
    for begin, end, masses in on_plane.spans():
        if len(masses) < 2 or not min(masses) > 0:
            continue
        sets = ConstraintSets(masses, plane.length, plane.gravity)
        chosen = np.flatnonzero((rows >= begin) & (rows < end))
        for found, state in ((actual, arrays.abstract), (desired, arrays.desired)):
            pairs = zip(state.torque[rows[chosen]].tolist(), state.inertia[rows[chosen]].tolist(), strict=True)
            found[chosen] = [
                clearance(sets, torque, inertia).upper if np.isfinite(torque) and np.isfinite(inertia) else np.nan
                for torque, inertia in pairs
            ]
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = arrays.auxiliary.s3 / arrays.auxiliary.s0**2
    return Margins(
        plane.length / 2.0 - on_plane.reach, np.where(np.isfinite(spread), spread, np.nan), rows, actual, desired
    )
