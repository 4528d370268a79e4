"""Robots on any parent system as columns: one state for all robots of a kind, each number an array (N,).

Where the functions of a system apply arithmetic only, as its attribute `columns` declares, they accept columns in place
of numbers. Addition, subtraction, multiplication and division round each element of an array exactly as they round
numbers, and every sum over the robots is correctly rounded: so law, sums and motion, which apply nothing else to
robots, give the bits of one robot after the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from swarmabs_core.drive import DoubleIntegratorDrive
from swarmabs_core.errors import one_line
from swarmabs_core.systems.interface import NamedSystem
from swarmabs_core.systems.kinds import RobotDynamics

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from swarmabs_core.messages import RobotState
    from swarmabs_core.systems.interface import Matrix, ParentSystem, Vector

    Floats = NDArray[np.float64]

EXACT = (np.add, np.subtract, np.multiply, np.divide, np.negative)
"""What a function may apply to columns: it rounds as the same operation on numbers does."""


@dataclass(frozen=True)
class SystemOnColumns(NamedSystem):
    """A parent system by its type whose functions take and return columns."""

    @cached_property
    def instance(self) -> ParentSystem:
        """The parent system."""
        on_columns: Any = OnColumns(NamedSystem(self.type, self.settings).instance)
        return on_columns  # type: ignore[no-any-return]  # it passes on all that it does not define


class OnColumns:
    """A parent system whose functions of a robot also return columns where they return the same number for all."""

    def __init__(self, instance: ParentSystem) -> None:
        self._made = instance

    def __getattr__(self, name: str) -> Any:
        return getattr(self._made, name)

    def contribution(self, q: Vector, constants: Vector) -> Vector:
        """Return the contributions, k columns."""
        return columns(self._made.contribution(q, constants), q)

    def jacobian(self, q: Vector, constants: Vector) -> Matrix:
        """Return their derivatives, k rows of d columns."""
        return tuple(columns(row, q) for row in self._made.jacobian(q, constants))

    def own_motion(self, q: Vector, constants: Vector) -> Vector:
        """Return the velocities that the robots add by themselves, d columns."""
        return columns(self._made.own_motion(q, constants), q)


def columns(numbers: Sequence[Any], like: Sequence[Any]) -> tuple[Any, ...]:
    """Return numbers, or columns, as columns as long as given ones."""
    return tuple(x if isinstance(x, np.ndarray) else np.full(like[0].shape, x) for x in numbers)


def column(rows: Iterable[Vector]) -> tuple[Any, ...]:
    """Return the vectors of robots as columns, one for each of their components."""
    return tuple(np.array(numbers) for numbers in zip(*rows, strict=True))


def dynamics_of(robots: Sequence[RobotDynamics]) -> RobotDynamics:
    """Return the numbers of robots of one kind as columns."""
    joined: Any = RobotDynamics._make(map(np.array, zip(*robots, strict=True)))
    return joined._replace(  # type: ignore[no-any-return]  # of columns, not of numbers
        constants=column(robot.constants for robot in robots),
        drive=DoubleIntegratorDrive(*column(robot.drive for robot in robots)),
    )


class _Checked(np.ndarray[Any, Any]):
    """A column that refuses what is not exact, and what would change it."""

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        if ufunc not in EXACT or method != "__call__" or options:
            raise TypeError(f"{ufunc.__name__} is applied to columns")
        return ufunc(*(np.asarray(x).view(np.ndarray) for x in inputs)).view(_Checked)

    def __array_function__(self, function: Any, *_: Any) -> NoReturn:
        raise TypeError(f"{function.__name__} is applied to columns")

    def _refuse(self, *_: Any) -> NoReturn:
        raise TypeError("a column is used as a number")

    __float__ = __int__ = __bool__ = __index__ = __len__ = __iter__ = __setitem__ = _refuse


def problem_on_columns(instance: ParentSystem, robots: Sequence[RobotState]) -> str:
    """Return why the functions of a system cannot be applied to columns of robots; an empty text if they can."""
    q, constants = (
        tuple(numbers.view(_Checked) for numbers in column(rows))
        for rows in ((robot.coordinates for robot in robots), (robot.constants for robot in robots))
    )

    def rows_of(name: str, q: Vector, constants: Vector) -> list[Any]:
        function: Any = getattr(instance, name)
        if name == "weight":
            return [function(constants)]
        returned = function(q, constants)
        return [x for row in returned for x in row] if name == "jacobian" else [*returned]

    for name in ("contribution", "jacobian", "own_motion", "weight"):
        try:
            rows = [np.broadcast_to(np.asarray(x).view(np.ndarray), len(robots)) for x in rows_of(name, q, constants)]
        except Exception as error:  # noqa: BLE001 - of the system
            return f"{name}() does not accept columns: {one_line(error)}"
        for number, robot in enumerate(robots):
            wanted = np.array(rows_of(name, robot.coordinates, robot.constants), dtype=float)
            if wanted.tobytes() != np.array([row[number] for row in rows], dtype=float).tobytes():
                return f"{name}() of robot {robot.agent_id} differs on columns"
    return ""
