"""Time to load a bag into arrays, compared with an iteration of the mcap library over its raw messages.

Also the processor time of everything that reads whole bags.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.common import COORDINATED, Settings, checked, program, repeated, row, spread, swarm_of
from mcap.reader import make_reader

from swarmabs_analysis.comparison import compare_bags
from swarmabs_analysis.verify import BagToVerify
from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.info import bag_info
from swarmabs_bag.reader import open_bag
from swarmabs_bag.run_folder import new_run_folder
from swarmabs_run.simulated_run import simulate_run

MESSAGES_PER_SECOND = 130_000
"""Messages in the bag per second of the window: six seconds give 100 MB before compression."""

COMMANDS: dict[str, tuple[Callable[[Path], object], int]] = {
    "verify": (lambda bag: BagToVerify(bag).verify(), 1),
    "compare": (lambda bag: compare_bags(bag, bag), 2),
    "info": (bag_info, 1),
    "load_arrays": (load_arrays, 1),
}
"""What reads a whole bag, and how many bags it reads."""


@dataclass(frozen=True, slots=True)
class ReadingResult:
    """Time to read a bag.

    Parameters
    ----------
    bag_bytes : int
        Size of the bag before compression.
    arrays_seconds : float
        `load_arrays`: all values, with every length, CRC and header checked.
    iteration_seconds : float
        Iteration of the mcap library in file order, without decoding and CRC checks.
    ratio : float
        `arrays_seconds` / `iteration_seconds`: below 1, loading arrays is faster.
    messages_per_core_second : dict of str to float
        Messages read per second of processor time by `COMMANDS`; `compare` reads those of both bags.
    """

    bag_bytes: int
    arrays_seconds: float
    iteration_seconds: float
    ratio: float
    messages_per_core_second: dict[str, float]


def measure(settings: Settings) -> dict[str, Any]:
    """Measure both for every swarm size."""
    rows = []
    for robots in settings.robots:
        results = repeated(robots, "reading", settings, measure_reading)
        summary = {
            "bag_bytes": spread(result.bag_bytes for result in results),
            "arrays_bytes_per_second": spread(result.bag_bytes / result.arrays_seconds for result in results),
            "ratio_to_iteration": spread(result.ratio for result in results),
            **{name: spread(result.messages_per_core_second[name] for result in results) for name in COMMANDS},
        }
        rows.append(row(robots, results, summary))
    return {"reading": rows}


def measure_reading(robots: int, settings: Settings) -> ReadingResult:
    """Simulate a swarm and read its bag; a longer window gives a larger bag.

    Raises
    ------
    KeyboardInterrupt
        If the run was interrupted.
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
        rates = {}
        for name, (read, bags) in COMMANDS.items():
            used = time.process_time()
            read(bag.path)
            rates[name] = bags * bag.message_count / (time.process_time() - used)
    return ReadingResult(size, loaded - begun, iterated, (loaded - begun) / iterated, rates)


if __name__ == "__main__":
    sys.exit(program(measure))
