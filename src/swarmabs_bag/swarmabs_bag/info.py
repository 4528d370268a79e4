"""An overview of a bag, as a table for the terminal or as data for programs."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import TYPE_CHECKING

from rich import box
from rich.console import Group
from rich.markup import escape
from rich.table import Table

from swarmabs_bag.attached import (
    MERGED,
    SCENARIO_FILE,
    UNDECIDED,
    arithmetic_of,
    attached_provenance,
    contradiction,
    events_in,
)
from swarmabs_bag.errors import DamagedBagError, repair_command
from swarmabs_bag.reader import BagReader, open_bag
from swarmabs_bag.run.channels import named_swarms
from swarmabs_bag.run.metadata import ABORTED_KEY, REPAIRED_KEY, load_yaml
from swarmabs_config.model.errors import shorten, show
from swarmabs_config.scenario import ScenarioError, parse_scenario
from swarmabs_core.arithmetic import FORMER
from swarmabs_core.ranges import Strays, texts_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from rich.console import RenderableType

_LONGEST_QOS = 200
_MOST_SPANS = 5
_DIGEST = 12
"""Characters of a SHA-256 that identify a bag for a person."""
_CLOCK = 1e8
"""Log time above which times count from 1970, not from the start of a simulation, s."""


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """A topic of a bag; `qos` is the offered reliability, durability and depth, empty if not recorded."""

    name: str
    type: str
    type_hash: str
    message_count: int
    qos: str


@dataclass(frozen=True, slots=True)
class ScenarioInfo:
    """The attached scenario: name, seed, number of agents, duration and control period in s."""

    name: str
    seed: int
    agents: int
    duration: float
    step: float


@dataclass(frozen=True, slots=True)
class BagInfo:
    """The result of `bag_info`; sizes are in bytes, times in s.

    Attributes
    ----------
    profile, library : str
        Profile and library recorded by its writer.
    start, duration : float
        Log time of the first message, and from there to the last one.
    namespace : str or None
        Namespace of the swarm, None if the bag contains none or several.
    attachments : dict
        Sizes by name.
    versions, arithmetic
        Software versions of the run and number of its arithmetic, from the attached provenance.
    complete : bool
        Whether the file has its end and every CRC and count is correct; otherwise `problem` says what is wrong.
    aborted, repaired : str or None
        Why the run ended early; what a repair could not recover.
    merged : tuple of str
        For a merged bag, the steps and the digest of each bag that it is made of.
    out_of_range : tuple of str
        Robots that left the ranges of their coordinates.
    """

    file: str
    size: int
    profile: str
    library: str
    start: float
    duration: float
    message_count: int
    topics: tuple[TopicInfo, ...]
    namespace: str | None
    swarms: tuple[str, ...]
    chunks: int
    compression: str
    uncompressed_size: int
    attachments: dict[str, int]
    scenario: ScenarioInfo | None
    versions: dict[str, str]
    arithmetic: int | None
    complete: bool
    problem: str | None
    aborted: str | None
    repaired: str | None
    merged: tuple[str, ...] = ()
    out_of_range: tuple[str, ...] = ()


def bag_info(path: Path | str) -> BagInfo:
    """Describe a bag (a run folder, its ``bag/``, or an MCAP file) and check it completely.

    The whole file is read once, chunk by chunk. Damage does not raise but is part of the result.

    Raises
    ------
    NotABagError
        If there is nothing, or it is not a bag.
    DamagedBagError
        If the file is unreadable.
    """
    bag = open_bag(path, damaged=True, several=True)
    problem = bag.problem
    if problem is None:
        try:
            bag.check()
            problem = contradiction(bag)
        except DamagedBagError as error:
            problem = str(error)
    provenance = attached_provenance(bag)
    versions = provenance.get("versions")
    custom: dict[str, str] = {}
    with suppress(DamagedBagError):
        custom = bag.custom_data()
    return BagInfo(
        file=str(bag.path),
        size=bag.size,
        profile=bag.index.header.profile,
        library=bag.index.header.library,
        start=bag.start / 1e9,
        duration=(bag.end - bag.start) / 1e9,
        message_count=bag.message_count,
        topics=tuple(
            TopicInfo(
                channel.name,
                channel.ros_type,
                channel.type_hash,
                channel.message_count,
                _qos(channel.qos_profiles),
            )
            for channel in bag.channels
        ),
        namespace=bag.namespace,
        swarms=bag.swarms,
        chunks=len(bag.index.chunks),
        compression=", ".join(sorted({chunk.compression or "none" for chunk in bag.index.chunks})),
        uncompressed_size=sum(chunk.uncompressed_size for chunk in bag.index.chunks),
        attachments={attachment.name: attachment.data_size for attachment in bag.index.attachments},
        scenario=_scenario(bag),
        versions={name: value for name, value in versions.items() if isinstance(value, str)}
        if isinstance(versions, dict)
        else {},
        arithmetic=arithmetic_of(provenance),
        complete=problem is None,
        problem=problem,
        aborted=custom.get(ABORTED_KEY),
        repaired=custom.get(REPAIRED_KEY),
        merged=tuple(_merged(provenance.get(MERGED))),
        out_of_range=texts_of(Strays(events_in(bag)).summary()),
    )


def said_steps(spans: Iterable[Sequence[int]]) -> str:
    """Return spans of steps, each with its first and last step, as text."""
    texts = [f"step {first}" if first == last else f"steps {first} to {last}" for first, last in spans]
    more = [f"{len(texts) - _MOST_SPANS} more spans"] if len(texts) > _MOST_SPANS else []
    return ", ".join([*texts[:_MOST_SPANS], *more]) or "no step"


def _merged(entries: object) -> Iterator[str]:
    """Yield a text for each bag that a merged one is made of, as far as its provenance is as written."""
    for entry in entries if isinstance(entries, list) else ():
        with suppress(KeyError, TypeError, ValueError):
            yield f"{said_steps(entry['steps'])} of {', '.join(digest[:_DIGEST] for digest in entry['sha256'])}"


def render(info: BagInfo) -> RenderableType:
    """Return the information as tables for a terminal."""
    facts = Table(show_header=False, box=None, pad_edge=False)
    facts.add_column(style="bold")
    facts.add_column(overflow="fold")
    for name, value in _facts(info).items():
        facts.add_row(name, _shown(value))
    topics = Table(box=box.SIMPLE, pad_edge=False)
    for heading in ("topic", "type", "QoS offered"):
        topics.add_column(heading, overflow="fold")
    topics.add_column("messages", justify="right")
    for topic in info.topics:
        topics.add_row(_shown(topic.name), _shown(topic.type), _shown(topic.qos), f"{topic.message_count:,}")
    return Group(facts, topics)


def _arithmetic(number: int | None) -> str:
    return "" if number is None else f"{number}, the former one" if number == FORMER else str(number)


def _facts(info: BagInfo) -> Mapping[str, str]:
    scenario = info.scenario
    facts = {
        "file": info.file,
        "state": _state(info),
        "ended early": info.aborted,
        "repaired": info.repaired,
        "out of range": "; ".join(info.out_of_range),
        "merged from": "; ".join(info.merged),
        "size": f"{info.size:,} bytes",
        "chunks": f"{info.chunks} ({info.compression or 'none'}; {info.uncompressed_size:,} bytes uncompressed)",
        "time": _times(info),
        "messages": f"{info.message_count:,}",
        "swarms in": named_swarms(info.swarms) if len(info.swarms) > 1 else "",
        "written by": info.library,
        "versions": ", ".join(f"{name} {value}" for name, value in info.versions.items()),
        "arithmetic": _arithmetic(info.arithmetic),
        "attachments": ", ".join(f"{name} ({size:,} bytes)" for name, size in info.attachments.items()),
        "scenario": scenario
        and f"{scenario.name}, seed {scenario.seed}, {scenario.agents} agents, {scenario.duration:.9g} s",
    }
    return {name: value for name, value in facts.items() if value}


def _state(info: BagInfo) -> str:
    """Return whether the bag is complete or intact, else the problem and, if a repair can help, its command."""
    if info.complete:
        return "intact, up to the early end of the run" if info.aborted else "complete"
    if info.problem == UNDECIDED:
        return f"contradictory: {info.problem}; no repair can decide this"
    remedy = repair_command(info.file) if info.message_count else "no message can be saved"
    return f"damaged: {info.problem}; {remedy}"


def _times(info: BagInfo) -> str:
    """Return the time span, with a date for times since 1970."""
    if info.start < _CLOCK:
        return f"{info.start:.9g} s to {info.start + info.duration:.9g} s"
    try:
        begin = datetime.fromtimestamp(info.start, timezone.utc)
    except (OverflowError, ValueError, OSError):
        return f"{info.start:.9g} s and {info.duration:.9g} s more"
    return f"{begin:%Y-%m-%d %H:%M:%S} UTC and {info.duration:.9g} s more"


def _shown(text: str) -> str:
    """Return text from a file, safe for the terminal."""
    return escape("".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text))


def _scenario(bag: BagReader) -> ScenarioInfo | None:
    try:
        scenario = parse_scenario((bag.attachment(SCENARIO_FILE) or b"").decode(), source=SCENARIO_FILE)
    except (DamagedBagError, ScenarioError, UnicodeDecodeError):
        return None
    return ScenarioInfo(scenario.name, scenario.seed, len(scenario.agents), scenario.duration_ns / 1e9, scenario.period)


def _qos(profiles: str) -> str:
    offered = load_yaml(profiles)
    if not isinstance(offered, list):
        return ""
    profiles_shown = [
        " ".join(show(profile.get(key)).strip("'") for key in ("reliability", "durability", "depth"))
        for profile in offered
        if isinstance(profile, dict)
    ]
    return shorten(", ".join(dict.fromkeys(profiles_shown)), _LONGEST_QOS)
