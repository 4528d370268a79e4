"""How the state of a swarm becomes messages for the page, by the tables of its parent system."""

from __future__ import annotations

from contextlib import suppress
from math import isfinite
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeVar

from swarmabs_bag.run.figures import Tracking
from swarmabs_bag.shown.percentiles import QUANTILES, SIDES, percentiles, starts_above
from swarmabs_bag.shown.swarm_state import family_of, finite, further_numbers
from swarmabs_core.errors import InputError
from swarmabs_core.events import code_of, said_event
from swarmabs_core.messages import EventKind, word
from swarmabs_core.systems.interface import NamedSystem, SystemTables
from swarmabs_core.systems.kinds import KINDS
from swarmabs_view.protocol import Curves, Event, Events, Frame, Positions, RobotInfo, RobotKind, Robots, Row, System

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from swarmabs_bag.shown.swarm_state import Instant, RobotIdentity, ShownRobot, ShownVector, TimedEvent
    from swarmabs_core.messages import SwarmEvent
    from swarmabs_core.systems import Constant, ParentSystem, Quantity, kinds
    from swarmabs_view.protocol import Number

    Lines = Sequence[Sequence[tuple[float, float]]]

MOST_LINES = 24
"""Most robots whose positions are drawn as a line each."""
BANDS = tuple(f"start {side}: {name}" for side in SIDES.values() for name in QUANTILES)
"""Labels of the percentiles of the robots that start on each side of the axis."""
_KINDS = {kind.value: kind.name for kind in EventKind}
DrawnT = TypeVar("DrawnT")


class Placed(NamedTuple):
    """Coordinates of the robots in a step by id, empty for a robot that is not there; time in s."""

    step: int
    time: float
    places: Mapping[int, ShownVector]


class Presenter:
    """Presents a swarm on the parent system with these tables.

    A parent system is drawn by its own package, if that is installed with the same tables.

    Attributes
    ----------
    system : System
        The parent system, for the hello.
    """

    def __init__(self, tables: SystemTables) -> None:
        self._tables = tables
        followed = tuple(tables.parent[index] for index in Tracking.of(tables).followed)
        further = tuple(number.quantity for number in further_numbers(family_of(tables)))
        self._groups = (tables.parent, followed, tables.abstract, tables.abstract, further)
        self._drawing = _installed(tables)
        rows = [
            *_rows("parent", tables.parent),
            *_rows("reference", followed),
            *_rows("abstract", tables.abstract),
            *_rows("desired", tables.abstract),
            *_rows("further", further),
            *_rows("robot", tables.robot),
            *(Row(role="constant", name=constant.name, unit=constant.unit) for constant in tables.constants),
        ]
        self.system = System(
            name=tables.name,
            rows=rows,
            kinds=[_kind(kind, tables.robot) for kind in KINDS.values()],
            placed=hasattr(self._drawing, "robot_place"),
            disturbance_unit=tables.disturbance_unit,
        )
        self._units = {
            "m": _common(row.unit for row in tables.robot),
            "rad": _common(row.unit for row in followed),
            "N m": tables.disturbance_unit,
        }

    def robots(self, identities: Iterable[RobotIdentity]) -> list[RobotInfo]:
        """Return the constant properties of the robots."""
        draw = getattr(self._drawing, "robot_body", _nothing)
        return [
            RobotInfo(
                id=robot.id,
                kind=word(robot.kind),
                constants=list(robot.constants),
                body=_lines(_drawn(draw, (), (robot.constants, self._tables.constants))),
                joins=robot.joins,
            )
            for robot in identities
        ]

    def frame(
        self, instant: Instant, robots: Sequence[ShownRobot], identities: Sequence[RobotIdentity], step_rate: Number
    ) -> Frame:
        """Return the frame of a step, with the robots in the order of the hello."""
        outline = getattr(self._drawing, "outline", _nothing)
        return Frame(
            step=instant.step,
            time=instant.time,
            values=self._values(instant),
            outline=_lines(_drawn(outline, (), (instant.parent, self._tables.parent))),
            robots=Robots(
                position=[self._place(instant.parent, *pair) for pair in zip(robots, identities, strict=True)],
                coordinates=[list(robot.coordinates) for robot in robots],
                velocities=[list(robot.velocities) for robot in robots],
                command=[list(robot.command) for robot in robots],
                status=[robot.status for robot in robots],
            ),
            step_rate=step_rate,
        )

    def curves(self, instants: Sequence[Instant], replace: bool) -> Curves:  # noqa: FBT001 - as from a buffer
        """Return steps as points of the curves, which replace the earlier ones or are appended."""
        points = [self._values(instant) for instant in instants]
        values = [list(column) for column in zip(*points, strict=True)] or [[] for rows in self._groups for _ in rows]
        return Curves(replace=replace, time=[instant.time for instant in instants], values=values)

    def positions(
        self,
        robots: Sequence[int],
        points: Sequence[Placed],
        replace: bool,  # noqa: FBT001 - as from a buffer
        above: Mapping[int, bool],
    ) -> Positions:
        """Return points of the lines of these robots, or of their percentiles, for each coordinate; as `curves`.

        `above` states of each robot that has a place whether it starts above 0, see `sides`.
        """
        bands = len(robots) > MOST_LINES
        labels = list(BANDS) if bands else [f"robot {robot}" for robot in robots]
        lines: list[list[Number]] = []
        for axis in range(len(self._tables.robot)):
            rows = [[_along(point.places.get(robot, ()), axis) for robot in robots] for point in points]
            if bands:
                rows = [_distribution(row, [above.get(robot) for robot in robots]) for row in rows]
            lines += [[row[index] for row in rows] for index in range(len(labels))]
        return Positions(
            replace=replace, bands=bands, labels=labels, time=[point.time for point in points], lines=lines
        )

    def events(self, events: Iterable[TimedEvent], *, replace: bool, left_out: int = 0) -> Events:
        """Return events, which replace the earlier ones or are appended."""
        return Events(replace=replace, events=[self.event(*event) for event in events], left_out=left_out)

    def event(self, event: SwarmEvent, time: float) -> Event:
        """Return an event and its time (s); a unit of `EventCode`, which are the plane's, as that of this system."""
        code = code_of(event)
        return Event(
            step=event.step,
            time=time,
            agent=event.agent_id,
            kind=_KINDS.get(event.kind, str(event.kind)),
            words=said_event(event),
            value=finite(event.value),
            unit="" if code is None else self._units.get(code.unit, code.unit),
            detail=event.detail,
        )

    def _values(self, instant: Instant) -> list[Number]:
        vectors = (instant.parent, instant.reference, instant.abstract, instant.desired, instant.further)
        pairs = zip(vectors, self._groups, strict=True)
        return [
            value for vector, rows in pairs for value in (vector if len(vector) == len(rows) else (None,) * len(rows))
        ]

    def _place(self, state: ShownVector, robot: ShownRobot, identity: RobotIdentity) -> list[float] | None:
        """Return where a robot is drawn, by default at its first two coordinates, None if that is unknown."""
        draw, tables = getattr(self._drawing, "robot_place", None), self._tables
        vectors = (state, tables.parent), (robot.coordinates, tables.robot), (identity.constants, tables.constants)
        drawn = _drawn(draw, (), *vectors) if draw else robot.coordinates[:2]
        place = [value for value in drawn if value is not None and isfinite(value)]
        return place if place and len(place) == len(drawn) else None


def sides(points: Iterable[Placed]) -> dict[int, bool]:
    """Return whether each robot starts above 0, by its first place in these points, which are in order of time."""
    above: dict[int, bool] = {}
    for point in points:
        for robot, place in point.places.items():
            start = None if robot in above else _along(place, 0)
            if start is not None:
                above[robot] = starts_above(start)
    return above


def _along(place: ShownVector, axis: int) -> Number:
    """Return a coordinate of a place, None if it is not known."""
    return place[axis] if axis < len(place) else None


def _distribution(positions: Sequence[Number], above: Sequence[bool | None]) -> list[Number]:
    """Return the lines of `BANDS`."""
    lines: list[Number] = []
    for side in SIDES:
        quantiles = percentiles(
            [place for place, of in zip(positions, above, strict=True) if of == side and place is not None]
        )
        lines += [None] * len(QUANTILES) if quantiles is None else quantiles.tolist()
    return lines


def _rows(
    role: Literal["parent", "reference", "abstract", "desired", "further", "robot"], table: Iterable[Quantity]
) -> list[Row]:
    return [Row(role=role, name=row.name, unit=row.unit, scale=row.scale, low=finite(row.low)) for row in table]


def _kind(kind: kinds.RobotKind, coordinates: Iterable[Quantity]) -> RobotKind:
    units = [row.unit for row in coordinates]
    return RobotKind(
        name=word(kind.kind),
        words=kind.words,
        legend=kind.legend,
        colour=kind.colour,
        shape=kind.shape,
        commands=[*kind.command_units(units)] if kind.fits(units) else [],
    )


def _common(units: Iterable[str]) -> str:
    """Return the unit of all these, empty if they differ."""
    different = {*units}
    return different.pop() if len(different) == 1 else ""


def _nothing(_: ShownVector) -> tuple[()]:
    return ()


def _drawn(
    draw: Callable[..., DrawnT], nothing: DrawnT, *vectors: tuple[ShownVector, Sequence[Quantity | Constant]]
) -> DrawnT:
    """Return what a package draws from vectors with the rows of these tables.

    Nothing if it cannot, or if a number is not known.
    """
    if any(len(vector) != len(rows) or None in vector for vector, rows in vectors):
        return nothing
    with suppress(ArithmeticError, LookupError, TypeError, ValueError):
        return draw(*(vector for vector, _ in vectors))
    return nothing


def _lines(lines: Lines) -> list[list[list[float]]]:
    """Return lines to draw as lists; numbers that are not finite are left to the page."""
    return [[[float(x), float(y)] for x, y in line] for line in lines]


def _installed(tables: SystemTables) -> ParentSystem | None:
    """Return the parent system with these tables, if an installed package provides it."""
    try:
        named = NamedSystem(tables.name, tables.settings)
        return named.instance if SystemTables.read(named.description) == tables else None
    except InputError:
        return None
