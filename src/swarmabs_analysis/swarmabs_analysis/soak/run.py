"""A soak: one random run after the other, until enough time is simulated."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, NamedTuple

from swarmabs_analysis.soak.draw import DURATION, drawn_scenario
from swarmabs_analysis.soak.leaks import Growth, Sample, growth, sample
from swarmabs_analysis.soak.trial import StoppedError, Trial, run_trial
from swarmabs_bag.run_folder import RunFolder
from swarmabs_run.interruption import end_asked

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from swarmabs_analysis.soak.engine import Engine


class Extent(NamedTuple):
    """Which runs a soak has: `runs` of them from `first` on."""

    seed: int
    first: int
    runs: int
    robots: int | None = None
    realtime: bool = False

    @classmethod
    def of_hours(cls, seed: int, hours: float, robots: int | None, *, realtime: bool = False) -> Extent:
        """Return as many runs as take a number of hours, simulated."""
        return cls(seed, 0, max(1, round(hours * 3600.0 / DURATION)), robots, realtime)

    def command(self, number: int) -> str:
        """Return the command that repeats one run."""
        robots = "" if self.robots is None else f" --robots {self.robots}"
        mode = " --realtime" if self.realtime else ""
        return f"swarm soak{mode} --seed {self.seed}{robots} --only {number}"


@dataclass(slots=True)
class Soak:
    """What came of a soak so far."""

    extent: Extent
    engine: str
    trials: list[Trial] = field(default_factory=list)
    samples: list[Sample] = field(default_factory=list)
    interrupted: bool = False

    @property
    def failed(self) -> list[Trial]:
        """The runs in which something does not hold."""
        return [trial for trial in self.trials if trial.violations]

    @property
    def growth(self) -> tuple[Growth, ...]:
        """What the process held early and late."""
        return growth(self.samples) if self.samples else ()

    @property
    def status(self) -> Literal["ok", "failed", "interrupted"]:
        """How it ended."""
        if self.failed or not all(one.ok for one in self.growth):
            return "failed"
        return "interrupted" if self.interrupted else "ok"


def run_soak(extent: Extent, engine: Engine, folder: Path, on_trial: Callable[[Soak], None]) -> Soak:
    """Run a soak; the folders of runs in which something does not hold are kept.

    Parameters
    ----------
    extent : Extent
        Which runs.
    engine : Engine
        What runs them.
    folder : Path
        An empty folder for what is kept.
    on_trial : callable
        Told after each run.

    Raises
    ------
    OSError, BagWriteError
        If a bag cannot be written.
    """
    soak = Soak(extent, engine.name)
    with end_asked() as asked:
        for number in range(extent.first, extent.first + extent.runs):
            place = RunFolder(folder / f"run-{number:05d}")
            place.path.mkdir()
            trial = None
            try:
                scenario = engine.prepare(drawn_scenario(extent.seed, number, extent.robots))
                trial = run_trial(number, scenario, engine, place, asked)
            except StoppedError:
                soak.interrupted = True
                break
            finally:
                if trial is None or not trial.violations:
                    shutil.rmtree(place.path)
            soak.trials.append(trial)
            soak.samples.append(sample())
            on_trial(soak)
    return soak
