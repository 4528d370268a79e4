"""Check of a parent system and of the robots on it, before a run starts with values that it cannot use."""

from __future__ import annotations

from contextlib import suppress
from difflib import get_close_matches
from functools import partial
from math import inf, isfinite, nan
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, TypeVar

from swarmabs_core.declaration import entries_of
from swarmabs_core.errors import InputError, one_line
from swarmabs_core.messages import NEVER, Kind, RobotState, Status, word
from swarmabs_core.registry import PluginError
from swarmabs_core.sensing import ParentSensor
from swarmabs_core.summation import added
from swarmabs_core.systems.desired import Requests
from swarmabs_core.systems.interface import TABLES, Constant, Need, Quantity, Tracked
from swarmabs_core.systems.kinds import KINDS
from swarmabs_core.systems.law import Gram, by_row, motion
from swarmabs_core.systems.swarm import observed, total

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence

    from swarmabs_core.systems.interface import NamedSystem, ParentSystem, Vector
    from swarmabs_core.systems.law import SystemGains

_PLAIN = (bool, int, float, str, tuple, list)
_STEP, _AGREEMENT = 1e-5, 1e-5  # step of differences in units of the coordinates, and the deviation that they allow
NEAR = 1e-3
"""Error, in units of the first one, at which robots have reached an abstract state."""
Problem: TypeAlias = tuple[tuple[str | int, ...], str, str]
"""Location in a scenario, what is wrong, and the remedy."""


ReturnT = TypeVar("ReturnT")


class StartingRobot(Protocol):
    """A robot as a scenario states it; no `velocities` mean that it is at rest."""

    id: int
    kind: str
    coordinates: Vector
    velocities: Vector
    constants: dict[str, float]


class _FaultyError(Exception):
    """The parent system cannot be used."""

    def __init__(self, problem: str, remedy: str = "correct the parent system") -> None:
        self.remedy = remedy
        super().__init__(problem)


def problems_of(
    system: NamedSystem,
    robots: Sequence[StartingRobot],
    gains: SystemGains,
    period: float,
    *,
    later: Container[int] = (),
    requests: Requests | None = None,
    sensor: ParentSensor | None = None,
) -> list[Problem]:
    """Return what is wrong with a parent system, with the robots of a scenario on it, or with their start.

    Robots whose ids are in `later` join later; the control period is in s.
    """
    problems: list[Problem] = []
    requests, sensor = requests or Requests(), sensor or ParentSensor()
    try:
        _check_tables(_called("its type", lambda: system.instance, pure=False))
        size = len(system.instance.abstract)
        given = {name: len(getattr(gains, name)) for name in ("k", "kp", "kd")}
        wrong = {name: many for name, many in given.items() if many not in {1, size}}
        problems += [(("swarm", "gains", x), f"{wrong[x]} gains for {size} rows", f"give one or {size}") for x in wrong]
        problems += [*_of_lists(system.instance, requests, sensor)]
        problems += [problem for index, robot in enumerate(robots) for problem in _of_robot(system, index, robot)]
        problems += (
            [] if problems else _of_start(system, initial_states(system, robots), later, gains, period, requests)
        )
    except PluginError as error:
        problems.append((("system",), error.problem, error.remedy))
    except _FaultyError as error:
        problems.append((("system",), f"parent system {system.type!r}: {error}", error.remedy))
    return problems


def generated(system: NamedSystem, number: int, count: int, constants: Mapping[str, float]) -> Vector:
    """Return where the system places a robot that a scenario generates; numbers are 1 to `count`.

    Raises
    ------
    InputError
        If it has no method for that, or the method fails.
    """
    place = getattr(system.instance, "generated", None)
    if place is None:
        raise InputError(f"{system.type} has no method generated", "give ranges of coordinates")
    given, what = constants_of(system, constants), f"generated() of robot {number}"
    try:
        return _numbers(what, len(system.instance.robot), lambda: place(number, count, given))
    except _FaultyError as error:
        raise InputError(f"parent system {system.type!r}: {error}", error.remedy) from error


def constants_of(system: NamedSystem, given: Mapping[str, float]) -> Vector:
    """Return a robot's constants in the order of the system, NaN for a missing one."""
    rows = system.instance.constants
    return tuple(float(given.get(row.name, nan if row.default is None else row.default)) for row in rows)


def initial_states(system: NamedSystem, robots: Sequence[StartingRobot]) -> list[RobotState]:
    """Return the states of robots of a scenario at step 0."""
    rest = (0.0,) * len(system.instance.robot)
    states = []
    for robot in robots:
        head = 0, 0, system.hash, NEVER, robot.id, Kind.of(robot.kind), Status.ACTIVE
        given = robot.coordinates, robot.velocities or rest, rest, constants_of(system, robot.constants)
        states.append(RobotState(*head, *given))
    return states


def approach(
    system: NamedSystem, robots: Sequence[RobotState], goal: Vector, gains: SystemGains
) -> Iterator[tuple[Sequence[RobotState], Gram, float, float]]:
    """Let robots follow the law of single integrators to an abstract state, without motions of their own.

    Yields robots, their Gram matrix, the root of sum W |q'|^2, and the error in units of the first one. If the last
    error is not below `NEAR`, the robots cannot reach the abstract state.
    """
    instance, first = system.instance, 0.0
    rows, k = instance.abstract, by_row(gains.k, len(instance.abstract))
    for _ in range(int(100.0 * max(k) / min(k))):
        abstract, auxiliary = observed(system, 0, 0, robots, curvature=False)
        error = [b - a for a, b in zip(abstract.value, goal, strict=True)]
        size = max(abs(e) / row.scale for e, row in zip(error, rows, strict=True))
        first = first or max(size, 1e-6)
        gram = Gram(auxiliary.gram, rows)
        if gram.uncontrolled or not isfinite(size):
            yield robots, gram, nan, nan
            return
        right = [gain * e for gain, e in zip(k, error, strict=True)]
        y = gram.solve(right)
        yield robots, gram, max(0.0, added(a * b for a, b in zip(right, y, strict=True))) ** 0.5, size / first
        if size < NEAR * first:
            return
        moved = []
        for robot in robots:
            q, constants = robot.coordinates, robot.constants
            rate = motion(instance.jacobian(q, constants), y, instance.weight(constants), len(q))
            after = tuple(x + 0.25 / max(k) * v for x, v in zip(q, rate, strict=True))
            moved.append(robot._replace(coordinates=after))
        robots = moved


def _called(what: str, call: Callable[[], ReturnT], *, pure: bool = True) -> ReturnT:
    """Return what a call into the system returns; it may raise anything, and a pure one returns the same twice."""
    try:
        returned = call()
        again = call() if pure else returned
    except PluginError:
        raise
    except InputError as error:
        raise _FaultyError(error.problem, *filter(None, [error.remedy])) from error
    except Exception as error:
        raise _FaultyError(f"{what} raises {one_line(error)}") from error
    if isinstance(returned, _PLAIN) and repr(returned) != repr(again):  # equal numbers have equal representations
        remedy = "make it a pure function, without clock and random numbers; only a controller may store numbers"
        raise _FaultyError(f"{what} is {_shown(returned)} and, for equal arguments, {_shown(again)}", remedy)
    return returned


def _numbers(what: str, size: int, call: Callable[[], object]) -> Vector:
    """Return the finite numbers that a call into the system returns."""
    numbers = _called(what, call)
    if not isinstance(numbers, (tuple, list)) or len(numbers) != size or not all(map(_is_number, numbers)):
        wanted = "a tuple with one finite number, such as (0.0,)" if size == 1 else f"a tuple of {size} finite numbers"
        raise _FaultyError(f"{what} is {_shown(numbers)}; it must be {wanted}")
    return tuple(map(float, numbers))


def _lines(what: str, call: Callable[[], Iterable[Iterable[tuple[float, float]]]]) -> None:
    """Call what draws lines of points (x, y)."""
    _called(what, lambda: [(x + 0.0, y + 0.0) for line in call() for x, y in line])


def _positive(what: str, call: Callable[[], float]) -> None:
    if not _is_number(number := _called(what, call)) or number <= 0.0:
        raise _FaultyError(f"{what} is {_shown(number)}; it must be a positive number")


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and isfinite(value)


def _check_ends(table: str, row: Quantity) -> None:
    """Accept ends of a coordinate of robots between which robots can be; other quantities have none."""
    ends = (row.low, row.high)
    low, high = (end if isinstance(end, (int, float)) and not isinstance(end, bool) else nan for end in ends)
    fit = low < high and low < inf and high > -inf
    if not fit or (table != "robot" and ends != (-inf, inf)):
        raise _FaultyError(
            f"{table} {row.name!r} has the ends {_shown(ends)}; only rows of robot have ends, low < high"
        )


def _shown(value: object) -> str:
    return f"{' '.join(repr(value).split()):.80}"


def _check_tables(instance: ParentSystem) -> None:
    for table, (of, least, most) in TABLES.items():
        rows = _called(table, partial(getattr, instance, table))
        if not isinstance(rows, tuple) or not all(isinstance(row, of) for row in rows):
            raise _FaultyError(f"{table} is {_shown(rows)}; it must be a tuple of {of.__name__}")
        if not least <= len(rows) <= most:
            raise _FaultyError(f"{table} has {len(rows)} rows; it must have {least} to {most}")
        names = [row.name for row in rows]
        for row in rows:
            if not str(row.name).isidentifier() or names.count(row.name) > 1:
                raise _FaultyError(f"{table} has a row {row.name!r}; each needs its own name of letters, digits and _")
            unit = getattr(row, "unit", "")
            numbers = [x for x in row[1 + hasattr(row, "unit") :] if not (of is Constant and x is None)]
            if isinstance(row, Quantity):
                _check_ends(table, row)
                numbers = numbers[:1]
            wrong = (
                not isinstance(unit, str) or not all(map(_is_number, numbers)) or (of is Need and row.low > row.high)
            )
            if wrong or (of in (Quantity, Tracked) and numbers[0] <= 0.0):
                said = row[1:3] if of is Quantity else row[1:]
                raise _FaultyError(f"{table} {row.name!r} has {_shown(said)}, which is out of range")
    units = {row.name: row.unit for row in instance.parent}
    for row in instance.tracked:
        if units.get(row.name) != units.get(instance.tracked[0].name, ""):
            raise _FaultyError(f"tracked {row.name!r} must be in parent, with the unit of the others")
    _numbers("initial", len(instance.parent), lambda: instance.initial)
    _positive("substep", lambda: instance.substep)


def _of_lists(instance: ParentSystem, requests: Requests, sensor: ParentSensor) -> Iterator[Problem]:
    """Yield what is wrong with lists of the scenario that have a number for each row of a table."""
    lists: tuple[tuple[tuple[str, str], Vector, Sequence[Quantity | Need]], ...] = (
        *((("sensor", name), getattr(sensor, name), instance.parent) for name, *_ in entries_of(type(sensor))),
        *((("requests", name), getattr(requests, name), instance.needs) for name in ("low", "high")),
    )
    fits = True
    for where, numbers, rows in lists:
        if numbers and len(numbers) != len(rows):
            fits = False
            yield where, f"{len(numbers)} numbers for {len(rows)}", f"give {', '.join(row.name for row in rows)}"
    for need, given in zip(instance.needs, requests.needs(instance) if fits else (), strict=fits):
        if not need.low <= given.low <= given.high <= need.high:
            text = f"{need.name} is limited to {given.low!r} to {given.high!r}"
            yield ("requests",), text, f"give low <= high, within {need.low!r} to {need.high!r} {need.unit}"


def _of_robot(system: NamedSystem, index: int, robot: StartingRobot) -> Iterator[Problem]:
    """Yield what is wrong with a robot of the scenario."""
    instance, where, kind = system.instance, ("swarm", "agents", index), robot.kind
    names, size, model = [row.name for row in instance.constants], len(instance.robot), KINDS[Kind.of(kind)]
    needed, units = model.constant, [row.unit for row in instance.robot]
    if not model.fits(units):
        wanted, given = (", ".join(unit or "no unit" for unit in listed) for listed in (model.coordinates, units))
        text = f"robots of kind {kind} need coordinates in {wanted}; those of {system.type} are in {given}"
        yield (*where, "kind"), text, "choose another kind, or a system whose robots have these coordinates"
    for name in robot.constants.keys() - set(names):
        near = get_close_matches(name, names, n=1)
        remedy = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(names) or 'none'}"
        yield (*where, "constants", name), f"{system.type} has no constant {name!r}", remedy
    for row, value in zip(instance.constants, constants_of(system, robot.constants), strict=True):
        if not isfinite(value):
            yield (*where, "constants"), f"robot {robot.id} lacks {row.name}", f"give {row.name} in {row.unit}"
        elif row.name == needed and value <= 0.0:
            yield (*where, "constants", row.name), f"{value!r} is out of range", "give a number > 0"
    if needed and needed not in names:
        text = f"{system.type} has no constant {needed!r}, which robots of this kind need"
        yield (*where, "kind"), text, "choose another kind, or add the constant to the system"
    for name, numbers in (("coordinates", robot.coordinates), ("velocities", robot.velocities)):
        if len(numbers) != size and (numbers or name == "coordinates"):
            wanted = ", ".join(row.name for row in instance.robot)
            yield (*where, name), f"{len(numbers)} numbers for {size} coordinates", f"give {wanted}"
    for one, x in zip(instance.robot, robot.coordinates, strict=False):
        if not one.low <= x <= one.high:
            text = f"{x!r} {one.unit} is out of the range of {one.name}"
            yield (*where, "coordinates"), text, f"give a number from {one.low!r} to {one.high!r}"
    if not Kind.of(kind).by_force and any(robot.velocities):
        yield (*where, "velocities"), f"not applicable to robots of kind {kind}", "omit them"


def _of_start(
    system: NamedSystem,
    robots: Sequence[RobotState],
    later: Container[int],
    gains: SystemGains,
    period: float,
    requests: Requests,
) -> Iterator[Problem]:
    """Call each function of the system, and yield why the robots cannot control the abstract state at the start."""
    instance: Any = system.instance
    k, start, remedy = len(instance.abstract), instance.initial, "spread the robots, or add robots"
    contributions = {robot.agent_id: _contribution(instance, robot) for robot in robots}
    if getattr(instance, "columns", False):
        from swarmabs_core.systems.columns import problem_on_columns  # noqa: PLC0415 - numpy, which few systems need

        if problem := problem_on_columns(instance, robots):
            remedy = "use only + - * / there (x * x, not x ** 2), or omit columns"
            raise _FaultyError(problem, remedy)
    present = [robot for robot in robots if robot.agent_id not in later]
    at_start = 0.0, start, total((contributions[robot.agent_id] for robot in present), k), (0.0,) * k
    _numbers("derivative()", len(start), lambda: instance.derivative(*at_start))
    if hasattr(instance, "reach"):
        _called("reach()", lambda: bool(instance.reach(at_start[2])))
    if hasattr(instance, "disturbed"):
        _numbers("disturbed()", len(start), lambda: instance.disturbed(*at_start, 0.0))
    if hasattr(instance, "failed") and (text := _called("failed()", lambda: instance.failed(start))):
        raise _FaultyError(f"it fails at the start: {_shown(text)}")
    _numbers("reference()", len(instance.tracked), lambda: instance.reference(0.0))
    if hasattr(instance, "outline"):
        _lines("outline()", lambda: instance.outline(start))
    for robot in robots if hasattr(instance, "robot_body") else ():
        _lines("robot_body()", partial(instance.robot_body, robot.constants))
    for robot in robots if hasattr(instance, "robot_place") else ():
        place = _called(
            what := "robot_place()", partial(instance.robot_place, start, robot.coordinates, robot.constants)
        )
        if not isinstance(place, (tuple, list)) or len(place) not in (1, 2, 3) or not all(map(_is_number, place)):
            raise _FaultyError(f"{what} is {_shown(place)}; it must be a tuple of 1 to 3 finite numbers")
    limits = [(need.low, need.high) for need in requests.needs(instance)]

    def complete(needs: Sequence[float]) -> tuple[str, Vector]:
        limited = tuple(min(max(x, low), high) for x, (low, high) in zip(needs, limits, strict=True))
        return (what := f"complete({limited})"), _numbers(what, k, lambda: system.complete(limited, system.nobody))

    for needs in (*zip(*limits, strict=True), [0.0] * len(limits)):
        _, desired = complete(needs)
    controller = _called("controller()", lambda: instance.controller(period), pure=False)
    ask = "ask() of the controller"
    asked = _numbers(ask, len(limits), lambda: instance.controller(period).ask(0.0, start, desired))
    if hasattr(controller, "offset_ask"):
        ask = "offset_ask() of the controller"
        _numbers(ask, len(limits), lambda: instance.controller(period).offset_ask(0.0, start, desired, 0.0))
    what, desired = complete(asked)
    if unchanged := [
        row.name for n, row in enumerate(instance.abstract) if present and not _changes(instance, present, n)
    ]:
        text = f"no robot can change row {unchanged[0]!r} of the abstract state: it has only zeros in every jacobian()"
        yield ("swarm", "agents"), text, "add a robot that can, or remove the row from the system's table abstract"
        return
    way = partial(approach, system, present, desired, gains)
    first, *others = _called(f"the way to {what}", lambda: list(way()), pure=False)
    if uncontrolled := first[1].uncontrolled:
        row = instance.abstract[uncontrolled[0]].name
        text = f"the robots cannot control row {row!r}: their Gram matrix is singular at the start"
        yield ("swarm", "agents"), text, remedy
    elif not (others or [first])[-1][3] < NEAR:
        text = f"the robots cannot reach the abstract state of {what}, the first that is requested"
        yield ("swarm", "agents"), text, f"{remedy}, or correct the parent system"


def _changes(instance: ParentSystem, robots: Sequence[RobotState], row: int) -> bool:
    """Return whether a robot can change a row of the abstract state, at the start or close to it."""
    for robot in robots:
        q = robot.coordinates
        shifts = [(j, sign * axis.scale) for j, axis in enumerate(instance.robot) for sign in (1.0, -1.0)]
        near = [(*q[:j], q[j] + shift, *q[j + 1 :]) for j, shift in shifts]
        for place in (q, *near):
            with suppress(Exception):  # robots may not be everywhere
                if any(instance.jacobian(place, robot.constants)[row]):
                    return True
    return False


def _contribution(instance: ParentSystem, robot: RobotState) -> Vector:
    """Return a robot's contribution, and check all functions of its coordinates and constants."""
    q, constants, rows, d = robot.coordinates, robot.constants, instance.abstract, len(instance.robot)
    of = f"of robot {robot.agent_id}"

    def at(j: int, x: float) -> Vector:
        q_ = (*q[:j], x, *q[j + 1 :])
        return _numbers(f"contribution() {of}", len(rows), lambda: instance.contribution(q_, constants))

    value = at(0, q[0])
    matrix = _called(f"jacobian() {of}", lambda: instance.jacobian(q, constants))
    if not isinstance(matrix, (tuple, list)) or len(matrix) != len(rows):
        raise _FaultyError(f"jacobian() {of} is {_shown(matrix)}; it must have {len(rows)} rows of {d} numbers")
    for i, row in enumerate(rows):
        line = _numbers(f"jacobian() {of}, row {row.name!r}", d, partial(matrix.__getitem__, i))
        for j, (coordinate, given) in enumerate(zip(instance.robot, line, strict=True)):
            h = _STEP * max(coordinate.scale, abs(q[j]))
            slope = (at(j, q[j] + h)[i] - at(j, q[j] - h)[i]) / (2.0 * h)
            if abs(slope - given) > _AGREEMENT * max(1e-3 * row.scale, abs(slope), abs(given)):
                where = f"in row {row.name!r}, column {coordinate.name!r}"
                text = f"jacobian() {of} has {given:.6g} {where}, but differences of contribution() give {slope:.6g}"
                raise _FaultyError(text)
    _positive(f"weight() {of}", lambda: instance.weight(constants))
    _numbers(f"own_motion() {of}", d, lambda: instance.own_motion(q, constants))
    if hasattr(instance, "limits"):
        kind = word(Kind(robot.kind))
        bounds = _called(what := f"limits() {of}", lambda: instance.limits(constants, kind))
        if _called(what, lambda: [a <= b for a, b in zip(*bounds, strict=True)]) != [True] * d:
            raise _FaultyError(f"{what} is {_shown(bounds)}; it must be two tuples of {d}, low <= high")
    return value
