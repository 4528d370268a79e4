"""Comparison of two bags: messages, figures, scenarios and provenance."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Literal, NamedTuple, cast

from swarmabs_analysis.comparison.messages import MessageComparison, compare_steps
from swarmabs_analysis.difference import plain
from swarmabs_bag.attached import attached_provenance, attached_scenario, description_of, is_realtime
from swarmabs_bag.errors import DamagedBagError, NotABagError
from swarmabs_bag.reader import open_bag
from swarmabs_bag.run.figures import PLANE_TRACKING, RealtimeFigures, RunFigures, tracking_of
from swarmabs_bag.run.ordering import REALTIME_WINDOW, recorded_steps
from swarmabs_config import configure
from swarmabs_core.errors import InputError
from swarmabs_core.realtime.base import Schedule

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from swarmabs_analysis.difference import Difference
    from swarmabs_bag.reader import BagReader
    from swarmabs_bag.run.figures import Reference
    from swarmabs_bag.run.step import Step
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.record import Record
    from swarmabs_core.systems import SystemTables


_DEEPEST = 32
"""Depth down to which documents are compared field by field; scenarios are never deeper."""


class SettingDifference(NamedTuple):
    """A field with different values in two documents: dotted path, both values, and the document that lacks it."""

    field: str
    a: object
    b: object
    missing: Literal["A", "B"] | None = None


def setting_differences(a: Mapping[str, object], b: Mapping[str, object]) -> tuple[SettingDifference, ...]:
    """Return the fields in which two documents differ, in the order of the first, then of the second document.

    Paths are those of ``--set``: dotted, with an index for the elements of lists of mappings; a list of plain values is
    one value, and an empty list equals a missing one.
    """
    ours, theirs = dict(_leaves(a, "", 0)), dict(_leaves(b, "", 0))
    changed = [
        SettingDifference(path, value, theirs.get(path), None if path in theirs else "B")
        for path, value in ours.items()
        if path not in theirs or theirs[path] != value
    ]
    added = [SettingDifference(path, None, value, "A") for path, value in theirs.items() if path not in ours]
    return (*changed, *added)


def _leaves(value: object, path: str, depth: int) -> Iterator[tuple[str, object]]:
    children: Mapping[object, object] = {}
    if isinstance(value, Mapping):
        children = value
    elif isinstance(value, list) and any(isinstance(item, Mapping) for item in value):
        children = dict(enumerate(value))
    if value in ([], {}):
        return
    if not children or depth == _DEEPEST:
        yield path, value
        return
    for key, child in children.items():
        yield from _leaves(child, f"{path}.{key}" if path else str(key), depth + 1)


@dataclass
class BagSummary:
    """Summary of one of the two bags, computed from its messages.

    Attributes
    ----------
    file : str
        The MCAP file.
    digest : str or None
        Digest of the run; None without messages on main topics and in real time.
    first_step, last_step : int or None
        Steps of the first and the last message of a main topic.
    period : float or None
        Control period of its scenario, s.
    robots : int
        Number of robots with a recorded state.
    figures : dict
        As in ``summary.json``; those that need the reference are None without a scenario.
    problem : str or None
        The damage, and how far the bag could be read.
    aborted, scenario_problem : str or None
        Why the run ended early, and why there is no scenario to compare.
    not_compared : tuple of str
        Topics that are not those of a recorded swarm.
    """

    file: str
    digest: str | None = None
    first_step: int | None = None
    last_step: int | None = None
    period: float | None = None
    robots: int = 0
    figures: dict[str, float | int | None] = field(default_factory=dict)
    problem: str | None = None
    aborted: str | None = None
    scenario_problem: str | None = None
    not_compared: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Comparison:
    """The result of `compare_bags`.

    Attributes
    ----------
    a, b : BagSummary
        Both bags.
    messages : MessageComparison
        First difference, and deviations by topic and field.
    robots_only_in_a, robots_only_in_b : tuple of int
        Robots with states in only one of the bags.
    scenario : tuple of SettingDifference
        Fields in which the resolved scenarios differ; also empty if one of them is missing.
    provenance : tuple of SettingDifference
        Differences of the provenance: versions, machine, arithmetic.
    system : SystemTables or None
        Names and units of the quantities of bags on another parent system than the plane, if those of both are equal.
    """

    a: BagSummary
    b: BagSummary
    messages: MessageComparison
    robots_only_in_a: tuple[int, ...]
    robots_only_in_b: tuple[int, ...]
    scenario: tuple[SettingDifference, ...]
    provenance: tuple[SettingDifference, ...]
    system: SystemTables | None = None

    @property
    def damaged(self) -> bool:
        """Whether one of the bags could not be read completely."""
        return self.a.problem is not None or self.b.problem is not None

    @property
    def equal(self) -> bool:
        """Whether both bags are complete and have the same messages, bit for bit."""
        return self.messages.equal and not self.damaged

    def to_dict(self) -> dict[str, object]:
        """Return everything as plain data for JSON; numbers that are not finite become strings."""
        first = self.messages.first
        document = {
            "equal": self.equal,
            "damaged": self.damaged,
            "a": asdict(self.a),
            "b": asdict(self.b),
            "first_difference": None if first is None else _told(first),
            "topics": [asdict(topic) for topic in self.messages.topics],
            "robots_only_in_a": self.robots_only_in_a,
            "robots_only_in_b": self.robots_only_in_b,
            "scenario": [difference._asdict() for difference in self.scenario],
            "provenance": [difference._asdict() for difference in self.provenance],
        }
        return cast("dict[str, object]", plain(document))


def compare_bags(
    a: Path | str, b: Path | str, *, namespaces: tuple[str | None, str | None] = (None, None)
) -> Comparison:
    """Compare two bags message by message, in bounded memory; `namespaces` select a swarm in each.

    A message that only one bag has is counted as missing in the other. Damage does not raise: a bag is compared as far
    as it can be read, and its summary says so.

    Raises
    ------
    NotABagError
        If one of them is not the bag of a swarm.
    DamagedBagError
        If one of them is unreadable.
    """
    left, right = (
        _Side(open_bag(path, namespace=namespace, damaged=True))
        for path, namespace in zip((a, b), namespaces, strict=True)
    )
    messages = compare_steps(left.steps(), right.steps())
    return Comparison(
        a=left.summary,
        b=right.summary,
        messages=messages,
        robots_only_in_a=tuple(sorted(left.robots - right.robots)),
        robots_only_in_b=tuple(sorted(right.robots - left.robots)),
        scenario=_scenario_differences(left.scenario, right.scenario),
        provenance=setting_differences(attached_provenance(left.bag), attached_provenance(right.bag)),
        system=left.tables if left.tables == right.tables else None,
    )


class _Side:
    """One of the two bags, summarised while it is read."""

    def __init__(self, bag: BagReader) -> None:
        if bag.namespace is None and bag.problem is None:
            raise NotABagError(f"{bag.path} is not the bag of a swarm: it has none of its topics; name another bag")
        self.bag = bag
        self.robots: set[int] = set()
        self.scenario: Scenario | None = None
        self.summary = summary = BagSummary(
            str(bag.path),
            problem=bag.problem and f"{bag.path}: {bag.problem}",
            not_compared=tuple(channel.name for channel in bag.channels if channel.topic is None),
        )
        self.tables: SystemTables | None = None
        with suppress(DamagedBagError):
            self.tables = description_of(bag)._replace(settings={})
        reference: Reference = _unknown
        tracking = PLANE_TRACKING
        period_ns = 1
        try:
            self.scenario = attached_scenario(bag)
            summary.period, period_ns = self.scenario.period, self.scenario.step_ns
            reference, tracking = configure.reference(self.scenario), tracking_of(self.scenario)
        except (InputError, DamagedBagError) as error:
            summary.scenario_problem = str(error)
        with suppress(DamagedBagError):
            summary.aborted = bag.aborted()
        self._run = RunFigures(reference, tracking)
        self._realtime = RealtimeFigures(reference, Schedule(period_ns)) if is_realtime(bag) else None

    def steps(self) -> Iterator[Step]:
        """Yield the steps of the bag as far as they can be read."""
        summary, realtime = self.summary, self._realtime is not None
        # Other recorders receive topics independently of each other, as in real time.
        window = None if attached_provenance(self.bag) else REALTIME_WINDOW
        try:
            for step in recorded_steps(self._records(), summary.file, realtime=realtime, window=window):
                self._run.add(step)
                if step.tables:
                    if summary.first_step is None:
                        summary.first_step = step.first
                    summary.last_step = step.step
                    self.robots.update(step.robots.tolist())
                yield step
            if summary.problem is None:
                self.bag.check()  # parts that no message needs can be damaged too
        except DamagedBagError as error:
            summary.problem = str(error)
        summary.robots = len(self.robots)
        summary.figures = (self._realtime or self._run).figures()
        summary.digest = None if realtime or summary.first_step is None else self._run.digest()

    def _records(self) -> Iterator[Record | Step]:
        """Yield the messages of the bag; in real time the figures also need those that are not part of a step."""
        if self._realtime is None:
            yield from self.bag.steps()
            return
        for record in self.bag.records():
            self._realtime.add(record)
            yield record


def _unknown(_time: float) -> float:
    """Return the reference of a bag without a scenario: NaN."""
    return math.nan


def _scenario_differences(a: Scenario | None, b: Scenario | None) -> tuple[SettingDifference, ...]:
    if a is None or b is None:
        return ()
    ours, theirs = (scenario.resolved().model_dump(mode="json", by_alias=True) for scenario in (a, b))
    return setting_differences(ours, theirs)


def _told(first: Difference) -> dict[str, object]:
    """Return the first difference as data, without the fields of a message that one bag lacks."""
    place = {"topic": first.topic, "step": first.step, "agent": first.agent or 0}
    if first.missing is not None:
        return {**place, "field": None, "a": None, "b": None, "missing": first.missing}
    return {**place, "field": first.field, "a": first.a, "b": first.b, "missing": None}
