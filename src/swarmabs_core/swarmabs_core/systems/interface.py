r"""The interface of a parent system, and the registry in which installed packages provide theirs.

The swarm acts on the parent only through the abstract state a, the sum of the robots' contributions (eq.
abstractState). With n numbers in the parent's state x_p, k in the abstract state, d coordinates of a robot and m needs
of the controller:

.. math::

    a = \sum_i \varphi_i(q_i) \in R^k \qquad \dot x_p = \hat f_p(x_p, a, \dot a, t) \qquad a_d = \sigma(t_d)

All vectors are tuples of floats; functions are pure: equal arguments give equal bits.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import sha256
from inspect import signature
from math import inf, isinf
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeAlias

from swarmabs_core.declaration import made_of, parameters_of
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import StandingState, SystemDescription
from swarmabs_core.parameters import Settings, resolve
from swarmabs_core.registry import Part, Registry

if TYPE_CHECKING:
    from typing_extensions import Self

Vector: TypeAlias = tuple[float, ...]
Matrix: TypeAlias = Sequence[Sequence[float]]


class Quantity(NamedTuple):
    """A number of a state: name, SI unit, and scale, a typical magnitude, 1 by default.

    The scale of a row of the abstract state is what a typical robot changes in this row by moving by 1: the Gram matrix
    is compared with it. A coordinate of robots may have ends, low and high, which robots do not pass while the swarm is
    in control, such as those of a deck: events report a robot beyond them (`swarmabs_core.ranges`).
    """

    name: str
    unit: str
    scale: float = 1.0
    low: float = -inf
    high: float = inf

    @property
    def label(self) -> str:
        """Name and unit, such as ``position, m``."""
        return ", ".join(filter(None, (self.name, self.unit)))


class Constant(NamedTuple):
    """A constant of each robot: name, SI unit, and default; without one, every robot needs a value.

    Three names have a meaning for the motion of robots: ``mass`` (kg) and ``damping`` (N s/m) for double integrators,
    ``time_constant`` (s) for a first-order lag.
    """

    name: str
    unit: str
    default: float | None = None


class Standing(tuple[float, ...]):  # noqa: SLOT001 - it has attributes
    """The contribution (k,) to the abstract state of robots that stand (dead, stopped or silent), zeros without any.

    Attributes
    ----------
    robots : int
        Their number.
    constants : tuple of float
        Sums of their constants, in the order of the system.
    moving : tuple of float
        The same sums over the robots that follow the law.
    """

    robots: int
    constants: Vector
    moving: Vector

    def __new__(cls, contribution: Vector, robots: int, constants: Vector, moving: Vector) -> Self:
        """Make it of its parts."""
        standing = super().__new__(cls, contribution)
        standing.robots, standing.constants, standing.moving = robots, constants, moving
        return standing

    def __getnewargs__(self) -> tuple[Vector, int, Vector, Vector]:
        """Return what it is made of."""
        return tuple(self), self.robots, self.constants, self.moving

    @classmethod
    def of(cls, divided: StandingState) -> Standing:
        """Return it as a message has it."""
        return cls(divided.standing, divided.standing_count, divided.standing_constants, divided.moving_constants)


class Need(NamedTuple):
    """What the controller asks of the swarm: name, SI unit, and the range to which it is limited."""

    name: str
    unit: str
    low: float
    high: float


class Tracked(NamedTuple):
    """A quantity of the parent that follows a reference, and the error below which it counts as settled."""

    name: str
    tolerance: float


class ParentController(Protocol):
    """The controller of a parent system. It may have internal state, so it is called once per step, in order."""

    def ask(self, time: float, state: Vector, desired: Vector) -> Vector:
        """Return the needs (m,), for the parent's state (n,), before they are limited and filtered.

        Parameters
        ----------
        time : float
            Time, s.
        state : tuple of float, (n,)
            State of the parent.
        desired : tuple of float, (k,)
            The desired abstract state of this step; in the first step, that of needs of 0.
        """
        ...


class ParentSystem(Protocol):
    """A parent system with the abstraction through which a swarm controls it.

    Optional members, with their use:

    - ``limits(constants, kind)``: a robot's lowest and highest command, (d,) each; it holds a limit that it reaches.
    - ``disturbed(time, state, abstract, rate, value)``: the derivative during a fault ``disturbance`` of a value.
    - ``offset_ask(time, state, desired, offset)`` of the controller: the needs during a fault ``reference``.
    - ``failed(state)``: why a run cannot continue from a state; an empty text if it can.
    - ``generated(number, count, constants)``: initial coordinates (d,) of a generated robot by its number, 1 to count.
    - ``robot_place(state, q, constants)``: where a robot is drawn, in m, (1,) or (2,), or (3,) with the angle by which
      its body is turned, rad; by default its first two coordinates.
    - ``robot_body(constants)``: filled lines that draw a robot around its place, as those of ``outline``, the first one
      around its id; by default a symbol of its kind.
    - ``outline(state)``: lines to draw, a tuple of tuples of points (x, y), m; closed ones are filled.
    - ``columns = True``: what is computed of robots applies only + - * /, so that ``simulate`` may pass arrays (N,).
    - ``reach(abstract)``: whether robots within their limits can have an abstract state; ``check`` reports it.
    """

    parent: tuple[Quantity, ...]
    """The state x_p, n numbers."""
    abstract: tuple[Quantity, ...]
    """The abstract state a, k numbers."""
    robot: tuple[Quantity, ...]
    """The coordinates q of a robot, d numbers."""
    constants: tuple[Constant, ...]
    """The constants of each robot."""
    needs: tuple[Need, ...]
    """What the controller asks for, m numbers."""
    tracked: tuple[Tracked, ...]
    """The quantities of the parent that follow a reference, all of the same unit; may be empty."""
    initial: Vector
    """The parent's state at step 0, (n,)."""
    substep: float
    """Longest step of the parent's integrator, s."""

    def contribution(self, q: Vector, constants: Vector) -> Vector:
        """Return a robot's contribution phi to the abstract state, (k,), at coordinates q (d,)."""
        ...

    def jacobian(self, q: Vector, constants: Vector) -> Matrix:
        """Return the derivative J of the contribution by the coordinates, k rows of d numbers."""
        ...

    def weight(self, constants: Vector) -> float:
        """Return the positive weight W of a robot's motion in the effort that the law minimises, such as its mass."""
        ...

    def own_motion(self, q: Vector, constants: Vector) -> Vector:
        """Return a velocity (d,) that a robot adds by itself, usually zeros; the swarm compensates for its effect."""
        ...

    def derivative(self, time: float, state: Vector, abstract: Vector, rate: Vector) -> Vector:
        """Return the parent's derivative (n,) at a time (s), under an abstract state (k,) with its rate (k,)."""
        ...

    def controller(self, period: float) -> ParentController:
        """Return a new controller for a control period, s."""
        ...

    def complete(self, needs: Vector, standing: Standing) -> Vector:
        """Return the desired abstract state (k,) that meets needs (m,) within their limits.

        The robots that stand contribute `standing` to it; the others must supply the rest, and must be able to. A
        system for which this makes no difference may omit the parameter.
        """
        ...

    def reference(self, time: float) -> Vector:
        """Return the reference of each entry of `tracked` at a time, s."""
        ...


class SystemType(Part[None, ParentSystem]):
    """A kind of parent system; `name` is the value of ``system.type`` in a scenario."""

    @classmethod
    def of(cls, name: str, declaration: type[ParentSystem]) -> SystemType:
        """Return the type of a dataclass whose fields are declared with `swarmabs_core.declaration.setting`."""
        if not hasattr(declaration, "__dataclass_fields__"):
            raise TypeError(f"{declaration.__name__} must be a dataclass: write @dataclass(frozen=True) above it")
        text = (declaration.__doc__ or name).partition("\n")[0].rstrip(".")
        return cls(name, parameters_of(declaration), lambda values, _: made_of(declaration, values), text)


SYSTEMS: Registry[None, ParentSystem] = Registry(
    "parent system",
    "swarmabs.parent_systems",
    SystemType,
    (),
    ("contribution", "jacobian", "weight", "own_motion", "derivative", "controller", "complete", "reference"),
)


Row: TypeAlias = Quantity | Constant | Need | Tracked

TABLES: dict[str, tuple[type[Row], int, int]] = {
    "parent": (Quantity, 1, 32),
    "abstract": (Quantity, 1, 16),
    "robot": (Quantity, 1, 8),
    "constants": (Constant, 0, 16),
    "needs": (Need, 1, 16),
    "tracked": (Tracked, 0, 32),
}
"""Tables of a parent system: type of a row, smallest and largest number of rows."""


class SystemTables(NamedTuple):
    """What the description of a parent system states: its type, the tables of `ParentSystem`, and its settings.

    The unit of a constant disturbance is not part of descriptions; it is empty if it is not known.
    """

    name: str
    parent: tuple[Quantity, ...]
    abstract: tuple[Quantity, ...]
    robot: tuple[Quantity, ...]
    constants: tuple[Constant, ...]
    needs: tuple[Need, ...]
    tracked: tuple[Tracked, ...]
    settings: Settings
    disturbance_unit: str = ""

    @classmethod
    def read(cls, description: str) -> SystemTables:
        """Read the text of a `SystemDescription`; raise `MalformedMessageError` if it is not one."""
        try:
            stated = json.loads(description)
            tables: dict[str, Any] = {
                name: tuple(row(**values) for values in stated[name]) for name, (row, *_) in TABLES.items()
            }
            return cls(name=str(stated["name"]), settings=dict(stated["settings"]), **tables)
        except (ValueError, TypeError, KeyError, RecursionError) as error:
            raise MalformedMessageError(SystemDescription.__name__, f"its text lacks {error}") from error


PLANE_TABLES = SystemTables(
    name="plane",
    parent=(Quantity("angle", "rad"), Quantity("angular_velocity", "rad/s")),
    abstract=(Quantity("torque", "N m", scale=5.0), Quantity("inertia", "kg m^2", scale=0.5, low=0.0)),
    robot=(Quantity("position", "m"),),
    constants=(Constant("mass", "kg"), Constant("damping", "N s/m", 0.0)),
    needs=(),
    tracked=(Tracked("angle", 0.01),),
    settings={},
    disturbance_unit="N m",
)
"""What the plane would state in a description; its messages have these numbers by name (`vector_of`)."""


@dataclass(frozen=True)
class NamedSystem:
    """A parent system by its type, with its settings, and what is derived from it.

    Raises
    ------
    InputError
        If there is no such type, its package is unusable, or a setting is not allowed.
    """

    type: str
    settings: Settings = field(default_factory=dict, hash=False)

    def __deepcopy__(self, _: object) -> NamedSystem:
        """Return the system itself: its functions are pure."""
        return self

    @cached_property
    def instance(self) -> ParentSystem:
        """The parent system."""
        return SYSTEMS.make(self.type, self.settings, None)

    @cached_property
    def description(self) -> str:
        """Names, units, scales and ends of its numbers and its settings as JSON, the text of `SystemDescription`."""
        settings = resolve(SYSTEMS.find(self.type).settings, self.settings, owner=self.type)
        tables = {name: [_stated(row) for row in getattr(self.instance, name)] for name in TABLES}
        return json.dumps({"name": self.type, **tables, "settings": settings}, sort_keys=True)

    @cached_property
    def hash(self) -> int:
        """The first eight bytes of the SHA-256 of the description; in every message."""
        return int.from_bytes(sha256(self.description.encode()).digest()[:8], "little")

    @cached_property
    def nobody(self) -> Standing:
        """What stands if no robot does."""
        none = (0.0,) * len(self.instance.constants)
        return Standing((0.0,) * len(self.instance.abstract), 0, none, none)

    @cached_property
    def complete(self) -> Callable[[Vector, Standing], Vector]:
        """`ParentSystem.complete` with both parameters."""
        complete: Callable[..., Vector] = self.instance.complete
        if len(signature(complete).parameters) > 1:
            return lambda needs, standing: tuple(complete(needs, standing))
        return lambda needs, _: tuple(complete(needs))

    def constant(self, constants: Vector, name: str, default: float = 0.0) -> float:
        """Return a robot's constant by name, the default if the system has no such constant."""
        names = [row.name for row in self.instance.constants]
        return constants[names.index(name)] if name in names else default


def _stated(row: Row) -> dict[str, object]:
    """Return a row of a table without the ends that it does not have: JSON has no infinity."""
    return {name: value for name, value in row._asdict().items() if not (isinstance(value, float) and isinf(value))}
