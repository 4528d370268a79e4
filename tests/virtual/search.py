# ruff: noqa: T201 - it is a command
"""Run many seeds of virtual fleets, and show what is broken: who, when, what, why, and how to see it again.

./scripts/swarm soak --virtual                         # 30 minutes of new seeds on all processors
./scripts/swarm soak --virtual --seeds 1-10000
./scripts/swarm soak --virtual --seeds 17 --only 2,5   # one seed with some of its faults, with its timeline
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from hashlib import blake2b
from itertools import count
from math import inf
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import NamedTuple, Protocol, TypeAlias

from tests.virtual.bags import BagCase, BagStory, bag_case
from tests.virtual.checks import STATEMENTS
from tests.virtual.disk import own_folder
from tests.virtual.lockstep import LockstepCase, LockstepStory, lockstep_case
from tests.virtual.rounds import RoundsCase, RoundsStory, rounds_case
from tests.virtual.schedule import Case, Tell, case_of, untold
from tests.virtual.starts import StartCase, StartStory, start_case
from tests.virtual.story import Result, Story, outcome
from tests.virtual.timeline import Timeline, Trace

from swarmabs_run.ending import die_with_parent, end_asked, terminable

COMMAND = "./scripts/swarm soak --virtual"
MOST_TRIALS = 150
"""Runs that are spent on making a case shorter."""
MOST_SHOWN = 20
"""Kinds of failures of which one case is shortened and shown; of further ones only the seeds are."""
TOLD_EVERY = 30.0
"""Time, s, between two lines on how far a search is."""
POLL = 0.1
"""Time, s, after which a search that is asked to end does."""
LONGEST = 60.0
"""Time of the processor, s, of a seed; usual ones need one."""
YEAR = 365.25 * 86400.0


class Trial(NamedTuple):
    """What came of a seed: what is broken (property and text), times simulated and of the processor (s), its faults."""

    seed: int
    broken: str
    text: str
    simulated: float
    took: float
    robots: int
    faults: Counter[str]

    @property
    def kind(self) -> str:
        """What is broken without nodes, numbers and details: failures of one kind have perhaps one reason."""
        return re.sub(r"agent_\d+|(all|,) (?=\d)|[-+\d.]+(e[-+]\d+)?| or |;.*", "", self.text)


AnyCase: TypeAlias = "Case | LockstepCase | RoundsCase | BagCase | StartCase"
_OTHERS: dict[int, Callable[[int], AnyCase]] = {
    2: bag_case,
    8: rounds_case,
    **dict.fromkeys((0, 3, 7, 11, 15), lockstep_case),  # these and starts take a twentieth of the time of others
    **dict.fromkeys((4, 6, 10, 12, 14), start_case),
}
"""What is drawn of other kinds than fleets, by the remainder of the seed divided by 16."""


def drawn(seed: int) -> AnyCase:
    """Return the case of a seed."""
    return _OTHERS.get(seed % 16, case_of)(seed)


class Told(Protocol):
    """What lets a case happen that is not one of a fleet, and tells all that is said in it."""

    @property
    def time(self) -> float: ...

    def check(self) -> None: ...

    def said(self) -> str: ...


def story_of(case: AnyCase, tell: Tell = untold) -> Told:
    """Return what lets a case happen that is not one of a fleet."""
    if isinstance(case, LockstepCase):
        return LockstepStory(case, tell)
    if isinstance(case, RoundsCase):
        return RoundsStory(case, tell)
    if isinstance(case, BagCase):
        return BagStory(case, tell)
    assert isinstance(case, StartCase)
    return StartStory(case, tell)


def run(case: AnyCase) -> Result:
    """Let a case happen; return what comes of it. One that takes `LONGEST` seconds of the processor hangs."""
    signal.signal(signal.SIGVTALRM, _hangs)
    signal.setitimer(signal.ITIMER_VIRTUAL, LONGEST)
    try:
        return outcome(Story(case) if isinstance(case, Case) else story_of(case))
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)


def _hangs(*_: object) -> None:
    raise TimeoutError(f"this seed does not end within {LONGEST:g} s")


def trial(seed: int) -> Trial:
    """Run a seed."""
    case, started = drawn(seed), time.process_time()
    result = run(case)
    broken = result.broken
    kinds = Counter(fault.kind for fault in case.faults)
    name, text = (broken.name, str(broken)) if broken else ("", "")
    return Trial(seed, name, text, result.time, time.process_time() - started, case.robots, kinds)


def shortened(case: AnyCase, wanted: str) -> tuple[int, ...]:
    """Return the numbers of as few faults of a case as still break a property: delta debugging."""
    left, parts, trials = list(range(len(case.faults))), 2, 0
    while len(left) >= 1 and trials < MOST_TRIALS:
        size = -(-len(left) // parts)
        for start in range(0, len(left), size):
            rest = left[:start] + left[start + size :]
            trials += 1
            broken = run(case.only(rest)).broken
            if broken is not None and broken.name == wanted:
                left, parts = rest, max(2, parts - 1)
                break
        else:
            if size <= 1:
                break
            parts = min(len(left), 2 * parts)
    return tuple(left)


def replay(case: AnyCase, trace: Path | None = None) -> tuple[Result, Timeline, str]:
    """Run a case again; return what comes of it, its timeline, and the digest of all that was said and heard."""
    timeline = Timeline()
    if not isinstance(case, Case):
        told = story_of(case, timeline.tell)
        result = outcome(told)
        return result, timeline, _digest(told.said(), trace)
    story = Story(case, [timeline], timeline.tell)
    timeline.watch(story.fleet)
    output = None if trace is None else trace.open("w", encoding="utf-8")
    traced = Trace(story.fleet, output)
    story.fleet.watch(traced)
    result = outcome(story)
    if output is not None:
        output.close()
    return result, timeline, traced.digest


def _digest(said: str, trace: Path | None) -> str:
    """Return the digest of all that was said; write it to a file."""
    if trace is not None:
        trace.write_text(said, encoding="utf-8")
    return blake2b(said.encode(), digest_size=16).hexdigest()


def report(case: AnyCase, result: Result, timeline: Timeline, command: str) -> Iterator[str]:
    """Yield the lines that tell people what is wrong."""
    broken = result.broken
    assert broken is not None
    yield f"BROKEN: {broken.name}"
    yield f"  must hold: {STATEMENTS[broken.name]}"
    yield f"  instead:   {broken.node} {broken.text}"
    yield f"  replay:    {command}"
    yield "what was done, of all that the seed draws:"
    yield str(case)
    yield "what happened (* and a number: what was done):"
    yield from timeline.lines()
    yield f"{result.time:9.4f} s   BROKEN: {broken.node} {broken.text}"


def show(seed: int, only: tuple[int, ...] | None, trace: Path | None) -> int:
    """Show what happens with a seed, or with some of its faults; return the exit code."""
    case = drawn(seed)
    chosen = case if only is None else case.only(only)
    result, timeline, digest = replay(chosen, trace)
    command = f"{COMMAND} --seeds {seed}" + ("" if only is None else f" --only {_numbers(only)}")
    if result.broken is not None:
        print("\n".join(report(chosen, result, timeline, command)))
    else:
        print("\n".join([str(chosen), *timeline.lines(), "all properties hold"]))
    print(f"trace {digest}")
    return int(result.broken is not None)


def _numbers(only: Iterable[int]) -> str:
    return ",".join(map(str, only)) or "none"


class Tally:
    """What came of many seeds."""

    def __init__(self) -> None:
        self._started = self._told = time.monotonic()
        self._done = 0
        self._simulated = self._processor = self._years = 0.0
        self._faults: Counter[str] = Counter()
        self.broken: Counter[str] = Counter()

    def add(self, one: Trial) -> None:
        """Count a trial, and say now and then how many there are."""
        self._done += 1
        self._simulated += one.simulated
        self._processor += one.took
        self._years += one.simulated * one.robots / YEAR
        self._faults += one.faults
        self.broken[one.broken] += bool(one.broken)
        if time.monotonic() - self._told > TOLD_EVERY:
            self._told = time.monotonic()
            print(f"{self.seconds:.0f} s: {self._done} seeds, broken: {self._said}", file=sys.stderr, flush=True)

    @property
    def seconds(self) -> float:
        """The time since the beginning, s."""
        return time.monotonic() - self._started

    @property
    def _said(self) -> str:
        return ", ".join(f"{name} {number}" for name, number in (+self.broken).most_common()) or "nothing"

    def __str__(self) -> str:
        """Return all of it in a line."""
        kinds = ", ".join(f"{kind} {number}" for kind, number in self._faults.most_common())
        speed = self._simulated / self._processor if self._processor else 0.0
        return (
            f"{self._done} seeds in {self.seconds:.0f} s: {self._simulated:.0f} s simulated, {speed:.0f} times real "
            f"time on each core; {self._years:.4f} robot-years; {sum(self._faults.values())} faults ({kinds}); "
            f"broken: {self._said}"
        )


def _results(running: set[Future[Trial] | Future[str]], most: int, ends: Callable[[], bool]) -> Iterator[Trial | str]:
    """Yield what comes, and take it out, until no more than so many are running, or until all `ends`."""
    while len(running) > most and not ends():
        done, _ = wait(running, POLL, FIRST_COMPLETED)
        running.difference_update(done)
        yield from (one.result() for one in done)


def search(seeds: Iterable[int], minutes: float | None, jobs: int) -> int:
    """Run seeds in so many processes until they or the time are over; show what is broken, and return the exit code.

    A case is made shorter while the search goes on. If it is asked to end, it does so only where it waits: an executor
    that is interrupted in its own work may not know all of its processes, and wait for one of them for ever.
    """
    tally, shown = Tally(), set[str]()
    limit = inf if minutes is None else 60.0 * minutes
    running: set[Future[Trial] | Future[str]] = set()
    with end_asked() as ends, ProcessPoolExecutor(jobs, get_context("fork"), die_with_parent, (os.getpid(),)) as pool:

        def take(most: int) -> None:
            """Take what comes until no more than so many are running."""
            for one in _results(running, most, ends):
                if isinstance(one, str):
                    print(one, flush=True)
                    continue
                tally.add(one)
                if one.broken and one.kind not in shown and len(shown) < MOST_SHOWN:
                    shown.add(one.kind)
                    running.add(pool.submit(_short, one))
                elif one.broken:
                    print(f"seed {one.seed}: {one.text}; replay: {COMMAND} --seeds {one.seed}", flush=True)

        for seed in seeds:
            running.add(pool.submit(trial, seed))
            take(2 * jobs)
            if ends() or tally.seconds >= limit:
                break
        take(0)
        if ends():
            for process in active_children():
                process.kill()
            print(f"interrupted: {tally}", file=sys.stderr)
            return 1
    print(tally)
    return int(tally.broken.total() > 0)


def _short(one: Trial) -> str:
    """Make the case of a seed as short as possible; return what tells people of it."""
    case = drawn(one.seed)
    only = shortened(case, one.broken)
    short = case.only(only)
    result, timeline, digest = replay(short)
    if result.broken is None:  # it does not break again: that is a fault of the search
        return f"seed {one.seed}: {one.text}, but not when it is replayed"
    command = f"{COMMAND} --seeds {one.seed}" + ("" if len(only) == len(case.faults) else f" --only {_numbers(only)}")
    return "\n".join([*report(short, result, timeline, command), f"trace {digest}"])


def _seeds(text: str) -> int | range:
    first, dash, last = text.partition("-")
    try:
        seeds = range(int(first), int(last) + 1) if dash else int(first)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is neither a seed nor seeds A-B") from None
    if seeds == range(0):
        raise argparse.ArgumentTypeError(f"{text!r} has no seeds; name the lower one first")
    return seeds


def _faults(text: str) -> tuple[int, ...]:
    try:
        return () if text == "none" else tuple(map(int, text.split(",")))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is neither 'none' nor numbers such as 0,2") from None


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, and search or show."""
    parser = argparse.ArgumentParser(prog=COMMAND)
    parser.add_argument("--seeds", type=_seeds, help="seeds A-B, or one seed, which is shown; by default new ones")
    parser.add_argument("--only", type=_faults, help="numbers of the faults of the seed that happen, or none")
    parser.add_argument("--minutes", type=float)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--trace", type=Path, help="file of all that is published and heard in the seed shown")
    options = parser.parse_args(arguments)
    with terminable(), own_folder():
        return _search_or_show(parser, options)


def _search_or_show(parser: argparse.ArgumentParser, options: argparse.Namespace) -> int:
    if isinstance(options.seeds, int):
        faults = len(drawn(options.seeds).faults)
        if wrong := [number for number in options.only or () if not 0 <= number < faults]:
            parser.error(f"--only: seed {options.seeds} has no fault {wrong[0]}; it has {faults}, from 0 on")
        return show(options.seeds, options.only, options.trace)
    if options.seeds is not None:
        return search(options.seeds, options.minutes, options.jobs)
    begin = time.time_ns() // 1_000_000 % 10**10
    return search(count(begin), options.minutes if options.minutes is not None else 30.0, options.jobs)


if __name__ == "__main__":
    sys.exit(main())
