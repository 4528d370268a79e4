"""What a repair has found and done, for people and programs."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from swarmabs_bag.examination import topics_of
from swarmabs_bag.steps import recorded_steps

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from swarmabs_bag.examination import Part
    from swarmabs_bag.rebuild import Rebuilt
    from swarmabs_bag.salvage import Damage


@dataclass(frozen=True, slots=True)
class LostPart:
    """A part of a file that was lost; `start`, `end`: its log times in s as it states them, else None."""

    offset: int
    bytes: int
    problem: str
    start: float | None
    end: float | None


@dataclass(frozen=True, slots=True)
class FileRepair:
    """What became of one file; `repaired_as`: its new name, None if nothing of it was left or to be done."""

    file: str
    bytes: int
    repaired_as: str | None
    problems: tuple[str, ...]
    lost: tuple[LostPart, ...]
    messages: int


@dataclass(frozen=True, slots=True)
class TopicRepair:
    """What there is of a topic.

    Attributes
    ----------
    name : str
        The topic.
    messages : int
        Messages that were kept.
    lost : int
        Messages that are known to have been lost; at the end of a file without summary section nobody knows.
    last_complete_step : int or None
        Up to which step, from the bag's first on, nothing is missing; None if it is no main topic of a swarm.
    """

    name: str
    messages: int
    lost: int
    last_complete_step: int | None


@dataclass(frozen=True, slots=True)
class RepairReport:
    """What a repair has found and done.

    Attributes
    ----------
    bag : str
        What was named.
    output : str or None
        Where the whole bag is; None if there was nothing to do.
    problems : tuple of str
        What was wrong with the bag as a whole.
    files : tuple of FileRepair
        Its files.
    topics : tuple of TopicRepair
        Its topics.
    messages : int
        Messages that were kept.
    lost_bytes : int
        Bytes of the files that were left out.
    attachments, lost_attachments : tuple of str
        Names of the attachments that were kept, and of those that the summary names and that were not.
    first_step, last_complete_step, last_planned_step : int or None
        First complete step, up to which step from there on nothing is missing, and the last one of the scenario; None
        without a scenario.
    """

    bag: str
    output: str | None
    problems: tuple[str, ...]
    files: tuple[FileRepair, ...]
    topics: tuple[TopicRepair, ...]
    messages: int
    lost_bytes: int
    attachments: tuple[str, ...]
    lost_attachments: tuple[str, ...]
    first_step: int | None
    last_complete_step: int | None
    last_planned_step: int | None

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain data for JSON."""
        return asdict(self)


def report_of(
    named: Path, output: Path | None, result: Path, parts: Sequence[Part], problems: Sequence[str]
) -> RepairReport:
    """Return the report of a repair.

    Parameters
    ----------
    named : Path
        What was named.
    output : Path or None
        Where the whole bag will be.
    result : Path
        Where the whole bag is now.
    parts : sequence of Part
        The files.
    problems : sequence of str
        What was wrong with the bag as a whole.
    """
    kept = [part.found for part in parts if part.found is not None]
    lost: Counter[str] = Counter()
    lost_attachments: list[str] = []
    for found in kept:
        lost.update(_lost_messages(found))
        if found.stated is not None:
            there = {entry.name for entry in found.index.attachments}
            lost_attachments += [entry.name for entry in found.stated.attachments if entry.name not in there]
    steps = recorded_steps(result)
    topics = topics_of(parts)
    return RepairReport(
        bag=str(named),
        output=None if output is None else str(output),
        problems=tuple(problems),
        files=tuple(
            FileRepair(
                file=str(part.path),
                bytes=part.size,
                repaired_as=part.name if part.problems and part.found is not None else None,
                problems=tuple(part.problems),
                lost=tuple(map(_lost_part, part.found.damage)) if part.found is not None else (),
                messages=part.index.statistics.message_count,
            )
            for part in parts
        ),
        topics=tuple(
            TopicRepair(topic.name, count, lost[topic.name], steps.by_topic.get(topic.name) if steps else None)
            for topic, count in topics
        ),
        messages=sum(count for _, count in topics),
        lost_bytes=sum(one.size for found in kept for one in found.damage),
        attachments=tuple(dict.fromkeys(entry.name for found in kept for entry in found.index.attachments)),
        lost_attachments=tuple(dict.fromkeys(lost_attachments)),
        first_step=steps.first if steps else None,
        last_complete_step=steps.last_complete if steps else None,
        last_planned_step=steps.last_planned if steps else None,
    )


def _lost_part(damage: Damage) -> LostPart:
    start, end = (None if time is None else time / 1e9 for time in (damage.start, damage.end))
    return LostPart(damage.offset, damage.size, damage.problem, start, end)


def _lost_messages(found: Rebuilt) -> Counter[str]:
    """Return how many messages are known to be lost by topic: from the summary section, else from the gaps."""
    lost: Counter[str] = Counter()
    kept = found.index.statistics.channel_message_counts
    for number, channel in found.index.channels.items():
        if found.stated is None:
            missing = found.gaps.get(number, 0)
        else:
            missing = found.stated.statistics.channel_message_counts.get(number, 0) - kept.get(number, 0)
        lost[channel.topic] += max(0, missing)
    return lost
