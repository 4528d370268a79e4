"""What a report says of a parent system and its robots: the plane's names and units, or those of another system."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from swarmabs_core.messages import PLANE_KINDS, Kind
from swarmabs_core.systems import Quantity

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    import numpy as np
    from numpy.typing import NDArray

    from swarmabs_bag.run.figures import Tracking
    from swarmabs_core.systems import SystemTables

    Floats = NDArray[np.float64]


class Subject(NamedTuple):
    """What the panels and tables of a report name and read.

    Attributes
    ----------
    parent : str
        What the robots act on.
    tracked : Quantity
        The first number that follows the reference.
    zoomed : str
        What the panels around events show.
    robot : tuple of Quantity
        Coordinates of a robot; the kinds of robots are those of `kinds`.
    falsified : str
        What a robot with a falsified state misreports.
    disturbance_unit : str
        Unit of disturbances; empty for another parent system, which does not state it.
    limits, weighed : bool
        Whether robots report that they are at a limit; whether they differ by mass.
    states, coordinates : callable
        Return the numbers of the parent's state, (n+1, S), and the coordinates of the robots, (n+1, N, d), of the
        arrays of a run.
    """

    parent: str
    tracked: Quantity
    zoomed: str
    robot: tuple[Quantity, ...]
    kinds: Iterable[Kind]
    falsified: str
    disturbance_unit: str
    limits: bool
    weighed: bool
    states: Callable[[Any], Floats]
    coordinates: Callable[[Any], Floats]


PLANE = Subject(
    parent="plane",
    tracked=Quantity("θ", "rad"),
    zoomed="angle with its dashed reference, and positions",
    robot=(Quantity("p", "m"),),
    kinds=PLANE_KINDS,
    falsified="positions and masses",
    disturbance_unit="N m",
    limits=False,
    weighed=True,
    states=lambda arrays: arrays.angle[:, None],
    coordinates=lambda arrays: arrays.agents.position[..., None],
)


def subject_of(system: SystemTables | None, tracking: Tracking) -> Subject:
    """Return what to say of a parent system: of the plane, which has no tables, or of another one."""
    if system is None:
        return PLANE
    return Subject(
        parent="parent system",
        tracked=Quantity(tracking.name, tracking.unit),
        zoomed="what is tracked with its dashed reference, and the first coordinate of the robots",
        robot=tuple(system.robot),
        kinds=Kind,
        falsified="coordinates and constants",
        disturbance_unit="",
        limits=True,
        weighed=False,
        states=lambda arrays: arrays.parent,
        coordinates=lambda arrays: arrays.agents.coordinates,
    )
