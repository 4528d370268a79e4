"""Study how the swarm copes with a rig that differs from its model: python examples/mujoco/study.py [-o FOLDER].

Without further options it takes up to 100 seeds with 4 and 8 robots, all maps, and the laws as printed. Trials
whose results are in the folder are not repeated.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, NamedTuple, TextIO

import study_figures
from study_maps import BY_SEED, MANY, MAPS, SEEDED, Map
from study_trials import SCENARIOS, Case, Deviation, Outcome, run

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

MAP_SEEDS = 2
"""Seeds of each cell of a map."""
NONE = "none"
"""Name of the imperfection of trials by seed, which have those of `SEEDED`."""


class Row(NamedTuple):
    """A row of a table: what trials of one loop on one rig have in common.

    Attributes
    ----------
    robots, loop, imperfection, value, duration : int, str, str, float, float
        Which trials.
    trials, settled : int
        How many there are, and how many settled.
    median_error, largest_error : float
        Of the angle in the last 2 s, rad.
    farthest, steepest, spread : float
        Of all trials: largest distance from the axis, m; largest angle, rad; least spread, m.
    """

    robots: int
    loop: str
    imperfection: str
    value: float
    duration: float
    trials: int
    settled: int
    median_error: float
    largest_error: float
    farthest: float
    steepest: float
    spread: float


def by_seed(most: int, duration: float) -> Iterator[Case]:
    """Yield the trials by seed, of a duration, s, with at most some seeds of a loop."""
    for loop, seeds in BY_SEED.items():
        for seed in range(1, min(seeds, most) + 1):
            for robots in SCENARIOS:
                yield Case(robots, loop, NONE, 0.0, Deviation(SEEDED), seed, duration)


def cells(study: Map, seeds: int, duration: float) -> Iterator[Case]:
    """Yield the trials of a map, of a duration, s."""
    for seed in range(1, seeds + 1):
        for loop in study.loops:
            for value in study.values:
                yield Case(4, loop, study.name, value, study.deviation(value), seed, duration)


def table(outcomes: Iterable[Outcome]) -> list[Row]:
    """Return a row for each loop on each rig."""
    groups: dict[tuple[int, str, str, float, float], list[Outcome]] = defaultdict(list)
    for outcome in outcomes:
        groups[outcome.cell].append(outcome)
    return [
        Row(
            *cell,
            trials=len(group),
            settled=sum(outcome.settled for outcome in group),
            median_error=median(outcome.error for outcome in group),
            largest_error=max(outcome.error for outcome in group),
            farthest=max(outcome.farthest for outcome in group),
            steepest=max(outcome.steepest for outcome in group),
            spread=min(outcome.spread for outcome in group),
        )
        for cell, group in groups.items()
    ]


def computed(cases: Sequence[Case], file: Path, workers: int) -> list[Outcome]:
    """Return the outcomes of trials; those that the file lacks are computed and added to it."""
    known = {outcome.key: outcome for outcome in stored(file)}
    missing = [case for case in cases if case.key not in known]
    with file.open("a", encoding="utf-8", newline="") as rows, ProcessPoolExecutor(workers) as pool:
        writer = csv.writer(rows)
        if not known:
            writer.writerow(Outcome._fields)
        for number, outcome in enumerate(pool.map(run, missing), start=1):
            writer.writerow(outcome)
            rows.flush()
            known[outcome.key] = outcome
            _show(f"{number} of {len(missing)} trials", sys.stderr)
    return [known[case.key] for case in cases]


def _show(text: str, terminal: TextIO) -> None:
    if terminal.isatty():
        terminal.write(f"\r{text}")
        terminal.flush()


def stored(file: Path) -> Iterator[Outcome]:
    """Yield the outcomes that a file contains."""
    if file.exists():
        with file.open(encoding="utf-8", newline="") as rows:
            for row in csv.DictReader(rows):
                yield Outcome.parsed(row)


def write(file: Path, rows: Sequence[Row]) -> None:
    """Write a table as CSV, and print it."""
    with file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(Row._fields)
        writer.writerows(rows)
    for row in rows:
        rig = "" if row.imperfection == NONE else f", {row.imperfection} {row.value:g}"
        print(
            f"{row.robots} robots, {row.loop}{rig}: {row.settled} of {row.trials} settled, error {row.median_error:.4f}"
            f" rad (median), {row.largest_error:.4f} rad (largest), farthest {row.farthest:.3f} m, steepest"
            f" {row.steepest:.3f} rad, least spread {row.spread:.3f} m"
        )


def main(arguments: list[str]) -> int:
    """Compute the study, write tables and figures, and return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--seeds", type=int, metavar="N", help=f"at most so many seeds; {MANY}, and {MAP_SEEDS} in each cell of a map"
    )
    parser.add_argument("--map", choices=sorted(MAPS), action="append", help="compute only this map; may be repeated")
    parser.add_argument("--duration", type=float, default=10.0, metavar="S", help="of a trial, s")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="number of processes")
    parser.add_argument("-o", "--output", metavar="FOLDER", type=Path, default=Path("study"))
    asked = parser.parse_args(arguments)
    folder: Path = asked.output
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "trials.csv"
    if not asked.map:
        outcomes = computed(list(by_seed(asked.seeds or MANY, asked.duration)), file, asked.workers)
        write(folder / "seeds.csv", table(outcomes))
        study_figures.draw_seeds(outcomes, folder / "reality_seeds.png")
        study_figures.draw_printed(folder / "reality_printed.png", asked.duration)
    seeds = min(asked.seeds or MAP_SEEDS, MAP_SEEDS)
    maps = [MAPS[name] for name in asked.map or MAPS]
    outcomes = computed([case for study in maps for case in cells(study, seeds, asked.duration)], file, asked.workers)
    rows = table(outcomes)
    write(folder / "maps.csv", rows)
    study_figures.draw_maps(rows, maps, folder / "reality_maps.png")
    print(f"{folder}: tables seeds.csv and maps.csv, all trials in trials.csv, and the figures reality_*.png")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
