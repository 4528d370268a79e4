"""What is shown of a swarm whose run was recorded: any step of a bag at once."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from swarmabs_bag.arrays import LoadedMessages, arrays_since, load_messages
from swarmabs_bag.attached import attached_scenario, is_realtime
from swarmabs_bag.errors import DamagedBagError
from swarmabs_bag.reader import open_bag
from swarmabs_bag.shown.swarm_state import (
    STATUS_NAMES,
    STATUSES,
    Instant,
    RobotHistory,
    ShownRobot,
    TimedEvent,
    finites,
    further_numbers,
    is_silent,
    shown_robot,
)
from swarmabs_core.arrays import MessageArrays, RunArrays
from swarmabs_core.messages import AnyRobotState, Status, SwarmEvent
from swarmabs_core.ranges import Strays, reason_of, texts_of

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from numpy.typing import NDArray

    from swarmabs_bag.reader import BagReader
    from swarmabs_bag.shown.swarm_state import Members, RobotStatus
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.arrays import Tables
    from swarmabs_core.systems import SystemTables

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]
    Flags = NDArray[np.bool_]

_DRAWABLE = 1e100
"""Numbers beyond this are not drawn, because no axis can show them."""


@dataclass(frozen=True)
class RecordedSwarm:
    """A swarm read from its bag, how the run ended, and its namespace if there are several.

    Values that cannot be drawn, such as infinity, are NaN in the arrays.
    """

    bag: Path
    scenario: Scenario
    arrays: RunArrays
    events: tuple[SwarmEvent, ...]
    status: str
    reason: str | None
    name: str | None

    def __len__(self) -> int:
        return len(self.arrays.step)

    @cached_property
    def timeline(self) -> RobotHistory:
        """Membership of the robots by step, in the order of the scenario."""
        there = {agent.id for agent in self.scenario.initial_agents}
        robots = [agent.id for agent in self.scenario.agents]
        timeline = RobotHistory(robots, [robot for robot in robots if robot not in there], changes=None)
        for event in self.events:
            timeline.take(event)
        return timeline

    @property
    def strays(self) -> tuple[str, ...]:
        """The robots that left the ranges of their coordinates, in words."""
        return texts_of(Strays(self.events).summary())

    def time_of(self, event: SwarmEvent) -> float:
        """Return the time of an event's step, s, because the clock of its sender may be wrong."""
        return event.step * float(self.scenario.period)

    def timed_events(self) -> list[TimedEvent]:
        """Return all events with their times."""
        return [TimedEvent(event, self.time_of(event)) for event in self.events]

    @property
    def tables(self) -> SystemTables:
        """Names and units of the numbers."""
        return self.arrays.description

    @cached_property
    def vectors(self) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """The vectors of an `Instant` over the rows: parent, reference, abstract, desired and further numbers."""
        arrays = self.arrays
        unknown = np.full(len(self), np.nan)
        columns = [
            getattr(arrays.further[topic.identifier], field) if topic.identifier in arrays.further else unknown
            for topic, field, _ in further_numbers(self.scenario.family)
        ]
        further = np.stack(columns, axis=-1) if columns else np.empty((len(self), 0))
        abstract, desired = arrays.abstract.vector("value"), arrays.desired.vector("value")
        return arrays.parent, arrays.references, abstract, desired, further

    def instant(self, row: int) -> Instant:
        """Return the state of the swarm to show at a row of the arrays."""
        time = float(self.arrays.time[row])
        vectors = (finites(vector[row].tolist()) for vector in self.vectors)
        return Instant(int(self.arrays.step[row]), round(time * 1e9), time, *vectors)

    def shown_robots(self, row: int) -> list[ShownRobot]:
        """Return the states of the robots to show at a row, in the order of the scenario."""
        step, timeline = int(self.arrays.step[row]), self.timeline
        shown = []
        for agent, column in zip(self.scenario.agents, self._columns, strict=True):
            last = int(np.searchsorted(self.arrays.step, timeline.last_step(agent.id, step), side="right")) - 1
            shown.append(shown_robot(timeline.out(agent.id, step), self._state(column, last), step))
        return shown

    def members(self, row: int) -> Members:
        """Return the robots that take part at a row."""
        return self.timeline.members(int(self.arrays.step[row]))

    def have_status(self, status: RobotStatus) -> Flags:
        """Return which robots have a status at each row, (n+1, N), in the order of the arrays."""
        return np.asarray(self._membership[0] == STATUSES.index(status))

    @property
    def on_plane(self) -> Flags:
        """Which robots act on the parent at each row, (n+1, N): on the plane, those that are on it."""
        return self._membership[1]

    @property
    def coordinates(self) -> Floats:
        """Coordinates of the robots, (n+1, N, d): of a dead robot as `ShownRobot`; NaN for robots that do not act."""
        return self._membership[2]

    @cached_property
    def _membership(self) -> tuple[NDArray[np.int8], Flags, Floats]:
        """Status (-1: no state yet), presence and coordinates of all robots at all rows, as of one in `shown_robot`."""
        step, agents = self.arrays.step, self.arrays.agents
        columns = np.arange(len(agents.ids))
        said = agents.status[self._latest, columns]
        place = np.array(self.arrays.agents.vector("coordinates")[self._latest, columns])
        codes = np.full(place.shape[:2], -1, dtype=np.int8)
        for status, name in STATUS_NAMES.items():
            codes[said == status] = STATUSES.index(name)
        codes[is_silent(step[self._latest], step[:, None])] = STATUSES.index("silent")
        codes[said == Status.LEFT] = STATUSES.index("left")
        codes[self._latest < 0] = -1
        # The step in which a robot announces that it leaves is its last on the plane.
        there = (self._latest >= 0) & ~((said == Status.LEFT) & (self._latest < np.arange(len(self))[:, None]))
        for column, robot in enumerate(agents.ids.tolist()):
            changes = self.timeline.changes(robot)
            begins: list[int] = [int(np.searchsorted(step, begin)) for begin, _ in changes]
            for (_, out), begin, end in zip(changes, begins, [*begins, len(self)][1:], strict=True):
                if out is not None and out.status != "absent":
                    codes[begin:end, column] = STATUSES.index(out.status)
                    there[begin:end, column] = out.status == "dead"
                    place[begin:end, column] = place[max(0, begin - 1), column]
                    place[begin:end, column, 0] = out.place
        place[~there] = np.nan
        return codes, there, place

    @cached_property
    def _columns(self) -> list[int]:
        """The column of each robot of the scenario in the arrays, -1 for a robot without messages."""
        ids = self.arrays.agents.ids
        place = {robot: column for column, robot in enumerate(ids.tolist())}
        return [place.get(agent.id, -1) for agent in self.scenario.agents]

    @cached_property
    def _latest(self) -> Integers:
        """The row of the latest state of each robot, -1 before the first, (n+1, N)."""
        heard = self.arrays.agents.kind > 0
        rows = np.where(heard, np.arange(len(heard))[:, None], -1)
        return np.asarray(np.maximum.accumulate(rows, axis=0))

    def _state(self, column: int, last: int) -> AnyRobotState | None:
        """Return the latest state of a robot up to a row, or None."""
        row = -1 if min(column, last) < 0 else int(self._latest[last, column])
        if row < 0:
            return None
        agents: MessageArrays = self.arrays.agents
        message = cast("type[AnyRobotState]", self.scenario.family.robot.message)
        columns = {name: column_of[row, column].tolist() for name, column_of in agents.items() if name != "ids"}
        head = {name: 0 for name in message._fields if name not in columns}  # these are not shown
        return message(**columns | head | {"step": int(self.arrays.step[row])})


def column_points(column: Integers, values: Floats) -> Integers:
    """Return the indices of the points that represent a line in a picture, given the pixel column of each point.

    Columns must ascend; NaN is a gap, whose edges are kept.
    """
    begins = np.flatnonzero(np.diff(column, prepend=column[0] - 1))
    ends = np.append(begins[1:], len(column))
    missing = np.isnan(values)
    gaps = np.flatnonzero(missing[1:] != missing[:-1])
    lowest = np.where(missing, np.inf, values)
    highest = np.where(missing, -np.inf, values)
    extremes = [
        point
        for begin, end in zip(begins.tolist(), ends.tolist(), strict=True)
        for point in (begin + int(np.argmin(lowest[begin:end])), begin + int(np.argmax(highest[begin:end])))
    ]
    return np.unique(np.concatenate([begins, ends - 1, gaps, gaps + 1, np.array(extremes, dtype=np.int64)]))


def read_swarm(path: Path, *, namespace: str | None = None) -> RecordedSwarm:
    """Read the swarm of a bag, of an incomplete one as far as possible.

    Raises `InputError` if it is not the bag of a swarm or contains no valid scenario, `DamagedBagError` if it cannot be
    read or contains a robot of unknown kind.
    """
    bag = open_bag(path, namespace=namespace, damaged=True)
    messages = load_messages(bag)
    return recorded_swarm(bag, messages, arrays_since(bag, messages)[0])


def recorded_swarm(bag: BagReader, messages: LoadedMessages, arrays: RunArrays) -> RecordedSwarm:
    """Return the swarm of an open bag whose messages and arrays are loaded; as `read_swarm`."""
    scenario, tables = attached_scenario(bag), messages.tables
    if scenario.family is not bag.family:
        raise DamagedBagError(f"{bag.path} has no messages of the parent system of its scenario")
    _check_kinds(bag, tables)
    events = tuple(sorted(messages.events, key=lambda event: event.step))
    realtime = is_realtime(bag)
    if realtime:
        events = _since_first(events, tables)
    status, reason = _ending(bag, scenario, None if realtime else len(tables[bag.family.parent]), events)
    return RecordedSwarm(
        bag=bag.path,
        scenario=scenario,
        arrays=_drawable(arrays),
        events=events,
        status=status,
        reason=reason,
        name=_name(bag),
    )


def _name(bag: BagReader) -> str | None:
    if bag.namespace is None or (bag.namespace == "/" and len(bag.swarms) <= 1):
        return None
    return bag.namespace.rstrip("/") or "/"


def _check_kinds(bag: BagReader, tables: Tables) -> None:
    states = tables[bag.family.robot]
    wrong = states[~np.isin(states["kind"], [kind.value for kind in bag.family.kinds])]
    if len(wrong):
        first = wrong[0]
        raise DamagedBagError(
            f"{bag.path}: agent {first['agent_id']} at step {first['step']}: kind {first['kind']} is unknown"
        )


def _since_first(events: tuple[SwarmEvent, ...], tables: Tables) -> tuple[SwarmEvent, ...]:
    """Return events with times since the first message of a run, as in the arrays."""
    first = min(
        (int(rows["sec"][0]) * 10**9 + int(rows["nanosec"][0]) for rows in tables.values() if len(rows)), default=0
    )
    return tuple(event._replace(stamp=max(0, event.stamp - first)) for event in events)


def _ending(
    bag: BagReader, scenario: Scenario, states: int | None, events: Iterable[SwarmEvent]
) -> tuple[str, str | None]:
    """Return how the run ended; `states` is the number of states of the parent system, None if steps may lack one."""
    if bag.problem is not None:
        return "damaged", f"the end of the bag is missing: {bag.problem}"
    aborted = bag.aborted()
    if aborted is not None:
        return ("interrupted" if aborted.startswith("interrupted") else "failed"), aborted
    if states is not None and states != scenario.steps + 1:
        return "incomplete", f"{states} of {scenario.steps + 1} states of the parent system are recorded"
    reason = reason_of(Strays(events).summary())
    return ("failed", reason) if reason else ("ok", None)


def _drawable(arrays: RunArrays) -> RunArrays:
    """Replace values that cannot be drawn with NaN."""
    shown: dict[str, Any] = {}
    for field in fields(arrays):
        value = getattr(arrays, field.name)
        if isinstance(value, np.ndarray):
            shown[field.name] = _finite(value)
        elif isinstance(value, MessageArrays):
            shown[field.name] = value.converted(_finite)
    further = {name: messages.converted(_finite) for name, messages in arrays.further.items()}
    return replace(arrays, **shown, further=further)


def _finite(column: NDArray[np.generic]) -> NDArray[np.generic]:
    if column.dtype.kind != "f":
        return column
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(column) < _DRAWABLE, column, np.nan)
