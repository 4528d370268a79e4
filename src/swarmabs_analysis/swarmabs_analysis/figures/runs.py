"""The runs shown in figures: found among existing bags, or made if missing."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from pathlib import Path

from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.attached import attached_scenario
from swarmabs_bag.errors import NotABagError
from swarmabs_bag.reader import open_bag
from swarmabs_bag.run_folder import RunFolder, find_bag, new_run_folder
from swarmabs_config.model.errors import printable, shorten
from swarmabs_config.scenario import PlaneScenario, dump_scenario, on_plane
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.arrays import RunArrays
from swarmabs_core.errors import InputError, RunError, SwarmabsError
from swarmabs_core.messages import PLANE_STATE
from swarmabs_run.run import Outcome, RunOptions
from swarmabs_run.summary import Times, summarise

Execute = Callable[[PlaneScenario, RunFolder, RunOptions], Outcome]
"""Executes a run and leaves its results in a folder."""

_LONGEST_REASON = 400


@dataclass(frozen=True, slots=True)
class RecordedRun:
    """A run read from its bag: scenario and messages."""

    scenario: PlaneScenario
    arrays: RunArrays


@dataclass(frozen=True, slots=True)
class CompleteBag:
    """A complete bag: its MCAP file and the attached scenario."""

    bag: Path
    scenario: PlaneScenario

    def load(self) -> RecordedRun:
        """Read the whole bag.

        Raises
        ------
        DamagedBagError
            If the bag is damaged.
        """
        return RecordedRun(self.scenario, load_arrays(self.bag))

    @property
    def altered(self) -> bool:
        """Whether its scenario differs from the built-in scenario of the same name."""
        return dump_scenario(self.scenario) != dump_scenario(find_scenario(self.scenario.name).resolved())


def find_runs(
    paths: Iterable[Path], needed: Collection[str], pass_over: Callable[[str], None] = lambda _: None
) -> dict[str, CompleteBag]:
    """Return the bags of the needed scenarios, by name of the scenario.

    A path is a run folder, the folder of a bag, an MCAP file, or a folder of these. `pass_over` receives the reason why
    one of several bags is skipped, for example because its run ended early.

    Raises
    ------
    InputError
        If a path contains no bag, or only one that cannot be used, or there are two bags of a scenario.
    """
    runs: dict[str, CompleteBag] = {}
    for path in paths:
        bags = _bags(path)
        for bag in bags:
            try:
                complete = _complete(bag)
            except SwarmabsError as error:
                if len(bags) == 1:
                    raise
                pass_over(str(error))
                continue
            name = complete.scenario.name
            if name in needed:
                other = runs.setdefault(name, complete)
                if other.bag.resolve() != bag.resolve():
                    raise InputError(f"{other.bag} and {bag} are both runs of {name}; name one of them")
    return runs


def find_made(folder: Path, needed: Iterable[str]) -> dict[str, CompleteBag]:
    """Return the runs that `make_run` has already made in a folder, by name of the scenario.

    Raises
    ------
    InputError
        If the place of a run contains something else.
    """
    runs = {}
    for name in needed:
        path = folder / name
        if path.exists():
            try:
                complete = _complete(find_bag(path))
            except SwarmabsError as error:
                raise InputError(f"{error}; remove {path}, or name another -o") from error
            if complete.scenario.name != name or complete.altered:
                raise InputError(f"{path} is not a run of the built-in {name}; remove it, or name another -o")
            runs[name] = complete
    return runs


def make_run(scenario: PlaneScenario, folder: Path, execute: Execute, options: RunOptions) -> CompleteBag:
    """Run a scenario and keep the results in a folder of its name in `folder`, which appears complete or not at all.

    Raises
    ------
    RunError
        If the run fails.
    """
    begun = time.monotonic()
    resolved = scenario.resolved()
    target = folder / resolved.name
    with tempfile.TemporaryDirectory(dir=folder, prefix=f".{resolved.name}-") as temporary:
        run = new_run_folder(Path(temporary) / "run")
        outcome = execute(resolved, run, options)
        if outcome.status != "ok":
            raise RunError(f"{resolved.name}: {outcome.reason}")
        times = Times(time.monotonic() - begun, startup=outcome.start_seconds)
        run.write_summary(summarise(resolved, outcome, times))
        run.path.rename(target)
    return CompleteBag(find_bag(target), resolved)


def _bags(path: Path) -> list[Path]:
    """Return the bag that a path names, or all bags in a folder: that of a bag, of a run, or of several runs."""
    if not path.is_dir():
        return [find_bag(path)]
    try:
        children = sorted(path.iterdir())
    except OSError as error:
        raise NotABagError(f"cannot read {path}: {error.strerror or error}") from error
    bags = [find_bag(child) for child in children if _holds_bag(child)]
    if not bags:
        raise NotABagError(f"{path} contains neither a bag nor run folders; name another path")
    return bags


def _holds_bag(path: Path) -> bool:
    if path.name.startswith("."):
        return False
    return path.suffix == ".mcap" or (path.is_dir() and any((*path.glob("*.mcap"), *path.glob("bag/*.mcap"))))


def _complete(bag: Path) -> CompleteBag:
    """Return a bag with its scenario; raise `InputError` if it is not complete."""
    opened = open_bag(bag, damaged=True)
    reason = opened.problem or opened.aborted()
    if reason is not None:
        raise InputError(f"{bag} is not complete: {printable(shorten(reason, _LONGEST_REASON))}")
    scenario = on_plane(attached_scenario(opened), "a figure of the paper")
    states = sum(channel.message_count for channel in opened.channels if channel.topic is PLANE_STATE)
    if states != scenario.steps + 1:
        raise InputError(f"{bag} is not complete: {states} of {scenario.steps + 1} states of the plane")
    return CompleteBag(bag, scenario)
