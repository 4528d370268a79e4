"""How fast a bag becomes arrays, beside the mcap library that does no more than look at each message."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from mcap.reader import make_reader

from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.reader import open_bag
from swarmabs_bag.run_folder import new_run_folder
from swarmabs_cli.bench_framework.product import checked
from swarmabs_cli.bench_framework.scenarios import swarm_of
from swarmabs_run.simulated_run import simulate_run

MESSAGES_PER_SECOND = 130_000
"""Messages of the bag by the length of the window: six seconds make 100 MB, before compression."""
_COORDINATED = 4
"""Messages of a step that do not come from robots."""


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


def measure_reading(robots: int, *, window: float) -> ReadingResult:
    """Read the bag of a swarm, which is simulated for it; a longer window (s) makes a larger bag.

    Raises
    ------
    KeyboardInterrupt
        If it was interrupted.
    """
    steps = max(20, round(window * MESSAGES_PER_SECOND / (robots + _COORDINATED)))
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
