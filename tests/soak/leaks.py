"""Whether a process that does the same again and again comes to hold more and more."""

from __future__ import annotations

import gc
from statistics import median
from typing import NamedTuple

import psutil

WARM_UP = 5
"""Runs in which caches may fill."""
FEWEST = WARM_UP + 6
"""Runs from which on growth can be told."""
MEMORY_GROWTH = 24.0
"""MiB by which the memory of runs of different size may differ for no reason."""
OBJECTS_GROWTH = 2000
"""Objects of the Python heap, likewise."""


class Sample(NamedTuple):
    """What a process holds between two runs."""

    memory: float
    """Resident memory, MiB."""
    objects: int
    """Objects that Python's garbage collector knows."""
    descriptors: int
    threads: int
    children: int


def sample() -> Sample:
    """Return what this process holds now."""
    gc.collect()
    process = psutil.Process()
    with process.oneshot():
        memory = round(process.memory_info().rss / 2**20, 1)
        threads = process.num_threads()
    return Sample(memory, len(gc.get_objects()), process.num_fds(), threads, len(process.children()))


class Growth(NamedTuple):
    """How much of something was held: early, late, and by how much late may exceed early; None if not judged."""

    what: str
    early: float
    late: float
    allowed: float | None

    @property
    def ok(self) -> bool:
        """Whether it does not grow."""
        return self.allowed is None or self.late - self.early <= self.allowed


def growth(samples: list[Sample]) -> tuple[Growth, ...]:
    """Compare the medians of the first and the last third of the runs after the warm-up.

    Parameters
    ----------
    samples : list of Sample
        One after each run, at least one.
    """
    judged = len(samples) >= FEWEST
    warm = samples[WARM_UP:] if judged else samples
    third = max(1, len(warm) // 3)
    allowed = Sample(MEMORY_GROWTH, OBJECTS_GROWTH, 0, 0, 0)
    return tuple(
        Growth(
            name,
            median(getattr(one, name) for one in warm[:third]),
            median(getattr(one, name) for one in warm[-third:]),
            getattr(allowed, name) if judged else None,
        )
        for name in Sample._fields
    )
