"""Whom a robot hears that sums up the swarm by itself, in the words of diagnostics and views."""

from __future__ import annotations

import re
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Mapping

HEARS, NEIGHBOURS, AGES, LACKS, MAJORITY = (
    "hears robots",
    "neighbours",
    "ages of states, steps",
    "lacks robots",
    "hears a majority",
)
_ANSWERS = {"yes": True, "no": False}
_NUMBER = r"(?:0|[1-9]\d{0,17})"
_NUMBERS = re.compile(rf"(?:{_NUMBER}(?: {_NUMBER})*)?", re.ASCII)
_PAIRS = re.compile(rf"(?:{_NUMBER}:{_NUMBER}(?: {_NUMBER}:{_NUMBER})*)?", re.ASCII)
_MOST_ROBOTS = 2000
"""Most robots in one value; a view that believed more could be made to draw anything."""
_HIGHEST_ID = 65535


class Hearing(NamedTuple):
    """What a robot knows of the others.

    Attributes
    ----------
    hears : tuple of int
        Ids of the neighbours that it hears, ascending.
    neighbours : int
        Number of its neighbours.
    ages : mapping
        Age, in steps, of the newest state that it knows of each robot that has not left, by id.
    lacks : tuple of int
        Ids of the robots that have not left, and of which it knows no state or only one that is too old.
    majority : bool
        Whether it hears a majority of the robots; otherwise it stops.
    """

    hears: tuple[int, ...]
    neighbours: int
    ages: Mapping[int, int]
    lacks: tuple[int, ...]
    majority: bool

    @property
    def oldest(self) -> int | None:
        """The age, in steps, of the oldest state that is not too old; None if it knows none."""
        return max((age for robot, age in self.ages.items() if robot not in self.lacks), default=None)

    def values(self) -> tuple[tuple[str, str], ...]:
        """Return the values for a health status."""
        return (
            (HEARS, _joined(self.hears)),
            (NEIGHBOURS, str(self.neighbours)),
            (AGES, " ".join(f"{robot}:{age}" for robot, age in self.ages.items())),
            (LACKS, _joined(self.lacks)),
            (MAJORITY, "yes" if self.majority else "no"),
        )

    @classmethod
    def read(cls, values: Mapping[str, str]) -> Hearing | None:
        """Return what the values of a health status tell, None if they are not exactly those of `values`."""
        try:
            hears, lacks = _ids(values[HEARS]), _ids(values[LACKS])
            (neighbours,) = _numbers(values[NEIGHBOURS])
            majority = _ANSWERS[values[MAJORITY]]
            ages = _ages(values[AGES])
        except (KeyError, ValueError):
            return None
        if not len(hears) <= neighbours <= _MOST_ROBOTS:
            return None
        return cls(hears, neighbours, ages, lacks, majority)

    def words(self) -> str:
        """Return it in a few words."""
        oldest = "" if self.oldest is None else f", oldest {self.oldest} step{'s' * (self.oldest != 1)}"
        lacks = f", lacks {_joined(self.lacks)}" if self.lacks else ""
        return f"hears {len(self.hears)} of {self.neighbours}{oldest}{lacks}{'' if self.majority else ', a minority'}"


def _joined(numbers: tuple[int, ...]) -> str:
    return " ".join(map(str, numbers))


def _numbers(text: str) -> tuple[int, ...]:
    """Read numbers; raises `ValueError` if the text is anything else."""
    if not _NUMBERS.fullmatch(text):
        raise ValueError(text)
    return tuple(map(int, text.split()))


def _ids(text: str) -> tuple[int, ...]:
    """Read ids, ascending; raises `ValueError` if the text is anything else."""
    return _ascending(_numbers(text))


def _ages(text: str) -> dict[int, int]:
    """Read ages by id; raises `ValueError` if the text is anything else."""
    if not _PAIRS.fullmatch(text):
        raise ValueError(text)
    numbers = tuple(map(int, text.replace(":", " ").split()))
    return dict(zip(_ascending(numbers[::2]), numbers[1::2], strict=True))


def _ascending(ids: tuple[int, ...]) -> tuple[int, ...]:
    """Return the ids; raises `ValueError` if they are not ascending, or too many."""
    if len(ids) > _MOST_ROBOTS or any(one >= other for one, other in pairwise((0, *ids, _HIGHEST_ID + 1))):
        raise ValueError(ids)
    return ids
