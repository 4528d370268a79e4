"""What the cases of a sweep are computed by, whether here or elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

ATTEMPTS = 3
"""How many workers may die while they compute a case before it counts as failed."""


@dataclass(frozen=True, slots=True)
class Task:
    """What a worker gets: number of the case and its overrides of the scenario, plain texts."""

    index: int
    overrides: tuple[str, ...]


class Common(NamedTuple):
    """What is the same for all cases: the scenario's text, and the bound of the angle for the estimates, rad."""

    scenario: str
    angle_max: float


class Engine(Protocol):
    """Computes tasks, in any order."""

    @property
    def description(self) -> str:
        """What and where it is, for people."""
        ...

    def compute(self, common: Common, tasks: Iterator[Task], idle: Callable[[], None]) -> Iterator[str]:
        """Yield the row of each task as `evaluate` makes it; `idle` is called now and then while nothing is ready.

        Raises
        ------
        RunError
            If no more tasks can be computed.
        """
        ...

    def close(self) -> None:
        """End everything that was started, at once."""
        ...
