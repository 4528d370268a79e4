"""How fast a bag becomes arrays, beside the mcap library that does no more than look at each message."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.common import COORDINATED, Settings, checked, program, repeated, row, spread, swarm_of
from mcap.reader import make_reader

from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.reader import open_bag
from swarmabs_bag.run_folder import new_run_folder
from swarmabs_run.simulated_run import simulate_run

MESSAGES_PER_SECOND = 130_000
"""Messages of the bag by the length of the window: six seconds make 100 MB, before compression."""


@dataclass(frozen=True, slots=True)
class ReadingResult:
    """Time to read a bag.

    Parameters
    ----------
    bag_bytes : int
        Size of the bag before compression.
    arrays_seconds : float
        Of `load_arrays`: all values, every length, CRC and head checked.
    iteration_seconds : float
        Of the mcap library's raw messages in file order, nothing decoded, no CRC checked.
    ratio : float
        The first by the second: below 1, the arrays come faster.
    """

    bag_bytes: int
    arrays_seconds: float
    iteration_seconds: float
    ratio: float


def measure(settings: Settings) -> dict[str, Any]:
    """Measure both with every number of robots."""
    rows = []
    for robots in settings.robots:
        results = repeated(robots, "reading", settings, measure_reading)
        summary = {
            "bag_bytes": spread(result.bag_bytes for result in results),
            "arrays_bytes_per_second": spread(result.bag_bytes / result.arrays_seconds for result in results),
            "ratio_to_iteration": spread(result.ratio for result in results),
        }
        rows.append(row(robots, results, summary))
    return {"reading": rows}


def measure_reading(robots: int, settings: Settings) -> ReadingResult:
    """Read the bag of a swarm, which is simulated for it; a longer window makes a larger bag.

    Raises
    ------
    KeyboardInterrupt
        If it was interrupted.
    """
    steps = max(20, round(settings.window * MESSAGES_PER_SECOND / (robots + COORDINATED)))
    with TemporaryDirectory(prefix="swarmabs-bench-") as folder:
        run = new_run_folder(Path(folder) / "run")
        checked(simulate_run(swarm_of(robots, steps), run))
        bag = open_bag(run.bag)
        size = sum(chunk.uncompressed_size for chunk in bag.index.chunks)
        begun = time.perf_counter()
        load_arrays(bag.path)
        loaded = time.perf_counter()
        with bag.path.open("rb") as stream:
            for _ in make_reader(stream).iter_messages(log_time_order=False):
                pass
        iterated = time.perf_counter() - loaded
    return ReadingResult(size, loaded - begun, iterated, (loaded - begun) / iterated)


if __name__ == "__main__":
    sys.exit(program(measure))
