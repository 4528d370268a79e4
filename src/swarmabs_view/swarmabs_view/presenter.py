"""How the state of a swarm becomes messages for the page: on the plane, and on any other parent system."""

from __future__ import annotations

from contextlib import suppress
from math import isfinite
from typing import TYPE_CHECKING, Any

from swarmabs_bag.run.figures import Tracking
from swarmabs_core.errors import InputError
from swarmabs_core.systems.interface import NamedSystem, SystemTables
from swarmabs_view.protocol import Curves, Frame, Message, Row, System, SystemCurves, SystemFrame, SystemRobots

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from swarmabs_bag.shown.swarm_state import ShownSystemRobot, ShownVector, SystemIdentity, SystemInstant
    from swarmabs_core.systems.interface import ParentSystem
    from swarmabs_view.protocol import Number


class Presenter:
    """Presents a swarm on the plane or, with its tables, on another parent system.

    Instants, identities and shown robots are those of `swarmabs_bag.shown.swarm_state` for the family. A parent system
    is drawn by its own package, if that is installed with the same tables.
    """

    def __init__(self, tables: SystemTables | None = None) -> None:
        self._tables = tables
        self.axes = range(1 if tables is None else len(tables.robot))
        if tables is not None:
            followed = tuple(tables.parent[index] for index in Tracking.of(tables).followed)
            self._groups = (tables.parent, followed, tables.abstract, tables.abstract)
            self._made = _installed(tables)
            roles = ("parent", "reference", "abstract", "desired", "robot", "constant")
            groups = zip(roles, (*self._groups, tables.robot, tables.constants), strict=True)
            rows: list[tuple[Any, Any]] = [(role, row) for role, rows in groups for row in rows]
            self._system = System(
                name=tables.name,
                rows=[
                    Row(role=role, name=one.name, unit=one.unit, scale=getattr(one, "scale", 1.0)) for role, one in rows
                ],
                constants=[],
                placed=hasattr(self._made, "robot_place"),
            )

    def described(self, robots: Sequence[Any]) -> list[Message]:
        """Return what follows a hello."""
        if self._tables is None:
            return []
        draw = getattr(self._made, "robot_body", _nothing)
        bodies = [_lines(_drawn(draw, (robot.constants, self._tables.constants))) for robot in robots]
        constants = [list(robot.constants) for robot in robots]
        return [self._system.model_copy(update={"constants": constants, "bodies": bodies})]

    def frame(self, instant: Any, robots: Sequence[Any], identities: Sequence[Any], step_rate: Number) -> Message:
        """Return the frame of a step, with the robots in the order of the hello."""
        if self._tables is None:
            return Frame.of(instant, robots, step_rate)
        fields = ("coordinates", "velocities", "command")
        places = (self._place(self._tables, instant.parent, *one) for one in zip(robots, identities, strict=True))
        states = {name: [list(getattr(robot, name)) for robot in robots] for name in fields}
        return SystemFrame(
            step=instant.step,
            time=instant.time,
            values=self._values(instant),
            outline=_lines(_drawn(getattr(self._made, "outline", _nothing), (instant.parent, self._tables.parent))),
            robots=SystemRobots(position=list(places), status=[robot.status for robot in robots], **states),
            step_rate=step_rate,
        )

    def curves(self, instants: Sequence[Any], *, replace: bool) -> Message:
        """Return steps as points of the curves."""
        if self._tables is None:
            return Curves.of(instants, replace=replace)
        points = [self._values(instant) for instant in instants]
        values = [list(column) for column in zip(*points, strict=True)] or [[] for rows in self._groups for _ in rows]
        return SystemCurves(replace=replace, time=[instant.time for instant in instants], values=values)

    def _values(self, instant: SystemInstant) -> list[Number]:
        vectors = (instant.parent, instant.reference, instant.abstract, instant.desired)
        pairs = zip(vectors, self._groups, strict=True)
        return [
            value for vector, rows in pairs for value in (vector if len(vector) == len(rows) else (None,) * len(rows))
        ]

    def _place(
        self, tables: SystemTables, state: ShownVector, robot: ShownSystemRobot, identity: SystemIdentity
    ) -> list[float] | None:
        """Return where a robot is drawn, by default at its first two coordinates, None if that is unknown."""
        place = getattr(self._made, "robot_place", None)
        vectors = (state, tables.parent), (robot.coordinates, tables.robot), (identity.constants, tables.constants)
        found = _drawn(place, *vectors) if place else robot.coordinates[:2]
        known = [value for value in found if value is not None and isfinite(value)]
        return known if known and len(known) == len(found) else None


def _nothing(_: ShownVector) -> tuple[()]:
    return ()


def _drawn(draw: Callable[..., tuple[Any, ...]], *vectors: tuple[ShownVector, Sequence[Any]]) -> tuple[Any, ...]:
    """Return what a package draws from vectors with the rows of these tables.

    Nothing if it cannot, or if a number is not known.
    """
    if any(len(vector) != len(rows) or None in vector for vector, rows in vectors):
        return ()
    with suppress(ArithmeticError, LookupError, TypeError, ValueError):
        return draw(*(vector for vector, _ in vectors))
    return ()


def _lines(lines: tuple[Any, ...]) -> list[list[list[float]]]:
    """Return lines to draw as lists; numbers that are not finite are left to the page."""
    return [[[float(x), float(y)] for x, y in line] for line in lines]


def _installed(tables: SystemTables) -> ParentSystem | None:
    """Return the parent system with these tables, if an installed package provides it."""
    try:
        named = NamedSystem(tables.name, tables.settings)
        return named.made if SystemTables.read(named.description) == tables else None
    except InputError:
        return None
