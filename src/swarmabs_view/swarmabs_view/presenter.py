"""How the state of a swarm becomes messages for the page, by the tables of its parent system."""

from __future__ import annotations

from contextlib import suppress
from math import isfinite
from typing import TYPE_CHECKING, Any, Literal

from swarmabs_bag.run.figures import Tracking
from swarmabs_bag.shown.swarm_state import finite
from swarmabs_core.errors import InputError
from swarmabs_core.messages import word
from swarmabs_core.systems.interface import NamedSystem, SystemTables
from swarmabs_view.protocol import Curves, Event, Frame, RobotInfo, Robots, Row, System

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from swarmabs_bag.shown.swarm_state import Instant, RobotIdentity, ShownRobot, ShownVector, TimedEvent
    from swarmabs_core.systems import Constant, ParentSystem, Quantity
    from swarmabs_view.protocol import Number


class Presenter:
    """Presents a swarm on the parent system with these tables.

    A parent system is drawn by its own package, if that is installed with the same tables.

    Attributes
    ----------
    system : System
        The parent system, for the hello.
    axes : range
        Numbers of the robots' coordinates.
    """

    def __init__(self, tables: SystemTables) -> None:
        self._tables = tables
        self.axes = range(len(tables.robot))
        followed = tuple(tables.parent[index] for index in Tracking.of(tables).followed)
        self._groups = (tables.parent, followed, tables.abstract, tables.abstract)
        self._made = _installed(tables)
        rows = [
            *_rows("parent", tables.parent),
            *_rows("reference", followed),
            *_rows("abstract", tables.abstract),
            *_rows("desired", tables.abstract),
            *_rows("robot", tables.robot),
            *(Row(role="constant", name=constant.name, unit=constant.unit) for constant in tables.constants),
        ]
        self.system = System(
            name=tables.name,
            rows=rows,
            placed=hasattr(self._made, "robot_place"),
            disturbance_unit=tables.disturbance_unit,
        )
        self._units = {
            "m": _common(row.unit for row in tables.robot),
            "rad": _common(row.unit for row in followed),
            "N m": tables.disturbance_unit,
        }

    def robots(self, identities: Iterable[RobotIdentity]) -> list[RobotInfo]:
        """Return the constant properties of the robots."""
        draw = getattr(self._made, "robot_body", _nothing)
        return [
            RobotInfo(
                id=robot.id,
                kind=word(robot.kind),
                constants=list(robot.constants),
                body=_lines(_drawn(draw, (robot.constants, self._tables.constants))),
                joins=robot.joins,
            )
            for robot in identities
        ]

    def frame(
        self, instant: Instant, robots: Sequence[ShownRobot], identities: Sequence[RobotIdentity], step_rate: Number
    ) -> Frame:
        """Return the frame of a step, with the robots in the order of the hello."""
        places = (self._place(instant.parent, *one) for one in zip(robots, identities, strict=True))
        return Frame(
            step=instant.step,
            time=instant.time,
            values=self._values(instant),
            outline=_lines(_drawn(getattr(self._made, "outline", _nothing), (instant.parent, self._tables.parent))),
            robots=Robots(
                position=list(places),
                coordinates=[list(robot.coordinates) for robot in robots],
                velocities=[list(robot.velocities) for robot in robots],
                command=[list(robot.command) for robot in robots],
                status=[robot.status for robot in robots],
            ),
            step_rate=step_rate,
        )

    def curves(self, instants: Sequence[Instant], *, replace: bool) -> Curves:
        """Return steps as points of the curves."""
        points = [self._values(instant) for instant in instants]
        values = [list(column) for column in zip(*points, strict=True)] or [[] for rows in self._groups for _ in rows]
        return Curves(replace=replace, time=[instant.time for instant in instants], values=values)

    def event(self, timed: TimedEvent) -> Event:
        """Return an event."""
        return Event.of(timed, lambda unit: self._units.get(unit, unit))

    def _values(self, instant: Instant) -> list[Number]:
        vectors = (instant.parent, instant.reference, instant.abstract, instant.desired)
        pairs = zip(vectors, self._groups, strict=True)
        return [
            value for vector, rows in pairs for value in (vector if len(vector) == len(rows) else (None,) * len(rows))
        ]

    def _place(self, state: ShownVector, robot: ShownRobot, identity: RobotIdentity) -> list[float] | None:
        """Return where a robot is drawn, by default at its first two coordinates, None if that is unknown."""
        place, tables = getattr(self._made, "robot_place", None), self._tables
        vectors = (state, tables.parent), (robot.coordinates, tables.robot), (identity.constants, tables.constants)
        found = _drawn(place, *vectors) if place else robot.coordinates[:2]
        known = [value for value in found if value is not None and isfinite(value)]
        return known if known and len(known) == len(found) else None


def _rows(role: Literal["parent", "reference", "abstract", "desired", "robot"], table: Iterable[Quantity]) -> list[Row]:
    return [Row(role=role, name=row.name, unit=row.unit, scale=row.scale, low=finite(row.low)) for row in table]


def _common(units: Iterable[str]) -> str:
    """Return the unit of all these, empty if they differ."""
    found = {*units}
    return found.pop() if len(found) == 1 else ""


def _nothing(_: ShownVector) -> tuple[()]:
    return ()


def _drawn(
    draw: Callable[..., tuple[Any, ...]], *vectors: tuple[ShownVector, Sequence[Quantity | Constant]]
) -> tuple[Any, ...]:
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
