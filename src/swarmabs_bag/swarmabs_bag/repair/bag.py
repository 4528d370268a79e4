"""Repairing a damaged bag, and reporting what was lost."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from swarmabs_bag.attached import contradiction
from swarmabs_bag.errors import BagFolderError, BagWriteError, DamagedBagError
from swarmabs_bag.mcap.output import RecordFile
from swarmabs_bag.reader import open_bag
from swarmabs_bag.repair.completeness import complete_steps
from swarmabs_bag.repair.examination import Part, examine, metadata_problem, silent_topics
from swarmabs_bag.repair.rebuild import Rebuilt
from swarmabs_bag.run.channels import bag_topics
from swarmabs_bag.run.metadata import (
    ABORTED_KEY,
    METADATA_FILE,
    REPAIRED_KEY,
    FileRecord,
    bag_metadata,
    write_metadata,
)
from swarmabs_bag.run_folder import find_bag

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from swarmabs_bag.repair.salvage import Damage
    from swarmabs_bag.run.metadata import BagChannel

CUT_OFF = "the recording was cut off"
"""Reason under `ABORTED_KEY` for a bag that its writer did not finish."""

_KEPT_SUFFIX = ".damaged"
_TEMPORARY = ".repairing"


@dataclass(frozen=True, slots=True)
class FileRepair:
    """Repair of a file; `repaired_as` is its new name, None if it was intact or nothing could be recovered."""

    file: str
    bytes: int
    repaired_as: str | None
    problems: tuple[str, ...]
    lost: tuple[Damage, ...]
    messages: int


@dataclass(frozen=True, slots=True)
class TopicRepair:
    """Repair of a topic: numbers of messages kept, and known to be lost.

    The number lost at the end of a file without summary section is unknown. `last_complete_step` is the last step up to
    which no message is missing; None if not every step of a swarm has messages on it.
    """

    name: str
    messages: int
    lost: int
    last_complete_step: int | None


@dataclass(frozen=True, slots=True)
class RepairReport:
    """The result of a repair.

    Attributes
    ----------
    output : str or None
        The repaired bag; None if there was nothing to do.
    problems : tuple of str
        Problems of the bag as a whole.
    lost_bytes : int
        Bytes of the files that were left out.
    attachments, lost_attachments : tuple of str
        Names of the attachments that were kept, and of those listed in the summary that were lost.
    undecided : str or None
        A problem of the repaired bag that no repair can resolve.
    first_step, last_complete_step, last_planned_step : int or None
        As for `CompleteSteps`; None without a scenario.
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
    undecided: str | None
    first_step: int | None
    last_complete_step: int | None
    last_planned_step: int | None


def repair_bag(
    path: Path | str, output: Path | None = None, *, in_place: bool = False, if_needed: bool = False
) -> RepairReport:
    """Repair a damaged bag: a run folder, its ``bag/``, or an MCAP file.

    Intact chunks, attachments and other records are kept unchanged; of a chunk truncated by the end of the file, the
    complete messages are kept. All indexes, the summary section and ``metadata.yaml`` are rewritten. An intact file is
    copied byte by byte.

    Parameters
    ----------
    output : Path, optional
        Folder of the new bag, new or empty; by default next to the damaged bag with ``_repaired`` appended to its name,
        and not created if there is nothing to do.
    in_place : bool
        Whether the new files replace the damaged ones, which are kept with ``.damaged`` appended to their names.
    if_needed : bool
        Whether nothing is written if there is nothing to do, even with an output.

    Raises
    ------
    NotABagError
        If there is nothing, or it is not a bag.
    BagFolderError
        If the output exists, or a bag cannot be repaired in place.
    DamagedBagError
        If no message can be recovered.
    BagWriteError
        If the disk is full or fails; nothing is left behind.
    """
    named = Path(path)
    place = find_bag(named)
    folder = None if named.is_file() else place if place.is_dir() else place.parent
    target = _target(place if folder is None else folder, output, in_place=in_place, is_file=folder is None)
    parts, problems = examine(place)
    kept = _worth_keeping(place, parts)
    if in_place and any(part.name != part.path.name for part in kept):
        gap = next(iter(problems), None) or next(part.problems[0] for part in parts if part.rebuilt is None)
        raise BagFolderError(f"{place} cannot be repaired in place: {gap}; repair it into a new folder with -o")
    idle = not problems and not any(part.problems for part in parts)
    if folder is not None and idle and (problem := metadata_problem(folder, kept)) is not None:
        problems.append(problem)
    unfinished = _is_unfinished(place, parts, kept)
    if unfinished and ABORTED_KEY not in kept[-1].custom_data() and not kept[-1].problems:
        kept[-1].problems.append(CUT_OFF)
    idle = not problems and not any(part.problems for part in parts)
    if idle and (output is None or in_place or if_needed):
        return _report(named, None, place, parts, problems)
    if in_place:
        _refuse_earlier(parts, target)
    with work_folder(target) as work:
        _write(kept, work, [] if folder is None else silent_topics(kept[0].path.parent), unfinished=unfinished)
        report = _report(named, target, work, parts, problems)
        if in_place:
            _exchange(parts, work, place.parent if folder is None else folder, with_metadata=folder is not None)
        else:
            target.parent.mkdir(parents=True, exist_ok=True)
            work.rename(target)
    return report


def _target(bag: Path, output: Path | None, *, in_place: bool, is_file: bool) -> Path:
    """Return the place of the new bag; raise `BagFolderError` if it is taken."""
    place = bag.resolve()
    if in_place:
        if output is not None:
            raise BagFolderError("--in-place and -o exclude each other: leave out one of them")
        return place.parent if is_file else place
    target = output if output is not None else place.with_name(f"{place.stem if is_file else place.name}_repaired")
    refuse_taken(target)
    return target


def refuse_taken(target: Path) -> None:
    """Raise `BagFolderError` if the place of a new bag is taken."""
    try:
        if target.exists() and (not target.is_dir() or any(target.iterdir())):
            raise BagFolderError(f"{target} exists: name a new folder with -o")
    except OSError as error:
        raise BagFolderError(f"{target} cannot be used: {error.strerror}; name another folder with -o") from error


def _worth_keeping(bag: Path, parts: Sequence[Part]) -> list[Part]:
    """Return the files with content; raise an error if there is damage and no message can be recovered."""
    kept = [part for part in parts if part.rebuilt is not None]
    if not kept:
        raise DamagedBagError(f"{bag}: nothing can be recovered: {parts[0].problems[0]}")
    broken = [part for part in kept if part.rebuilt is not None and (part.rebuilt.damage or part.rebuilt.end is None)]
    if broken and not any(part.index.statistics.message_count for part in kept):
        raise DamagedBagError(f"{broken[0].path}: no message can be recovered: {broken[0].problems[0]}")
    return kept


def _is_unfinished(bag: Path, parts: Sequence[Part], kept: Sequence[Part]) -> bool:
    """Return whether the writer did not finish: its last file has no end, or was never begun."""
    last = kept[-1]
    if last is not parts[-1] or (last.rebuilt is not None and last.rebuilt.end is None):
        return True
    if len(kept) == 1 or (last.path.parent / METADATA_FILE).exists():
        return False
    steps = complete_steps(bag)
    return steps is not None and steps.last_complete < steps.last_planned


def _refuse_earlier(parts: Sequence[Part], folder: Path) -> None:
    """Raise `BagFolderError` if files kept by an earlier repair would be replaced."""
    names = [part.path.name for part in parts if part.problems] + [METADATA_FILE]
    for kept in (folder / (name + _KEPT_SUFFIX) for name in names):
        if kept.exists() or kept.is_symlink():
            raise BagFolderError(f"{kept} exists from an earlier repair: move it away, or name a folder with -o")
    if (folder / METADATA_FILE).is_dir():
        raise BagFolderError(f"{folder / METADATA_FILE} is a folder: move it away, or name a folder with -o")


def _lost_text(damage: Sequence[Damage]) -> str:
    first = damage[0]
    places = "1 place" if len(damage) == 1 else f"{len(damage)} places"
    lost = sum(part.bytes for part in damage)
    return f"{lost} bytes in {places} could not be recovered, the first at byte {first.offset}: {first.problem}"


@contextmanager
def work_folder(target: Path) -> Iterator[Path]:
    """Create a folder next to the target, which is removed afterwards unless it was renamed."""
    place = target.resolve()
    work = place.with_name(f".{place.name}{_TEMPORARY}")
    created: list[Path] = []
    done = False
    try:
        for parent in reversed([parent for parent in work.parents if not parent.exists()]):
            parent.mkdir()
            created.append(parent)
        if work.exists():
            shutil.rmtree(work)
        work.mkdir()
        yield work
        done = True
    except OSError as error:
        raise BagWriteError(target, error) from error
    finally:
        shutil.rmtree(work, ignore_errors=True)
        if not done:
            for parent in reversed(created):
                parent.rmdir()


def _write(parts: Sequence[Part], work: Path, silent: Sequence[BagChannel], *, unfinished: bool) -> None:
    """Write the new files and ``metadata.yaml``, which also lists the topics without messages."""
    custom: dict[str, str] = {}
    for part in parts:
        if part.problems:
            said = part.custom_data()
            if unfinished and part is parts[-1]:
                said.setdefault(ABORTED_KEY, CUT_OFF)
            if part.rebuilt is not None and part.rebuilt.damage:
                said[REPAIRED_KEY] = _lost_text(part.rebuilt.damage)
            file = RecordFile(work / part.name)
            try:
                part.rebuild(file, said)
                file.sync()
            finally:
                file.close()
        else:
            shutil.copyfile(part.path, work / part.name)
        custom |= part.custom_data()
    topics = bag_topics(part.index for part in parts)
    names = {topic.name for topic in topics}
    topics += [topic for topic in silent if topic.name not in names]
    files = [FileRecord.of(part.name, part.index.statistics) for part in parts]
    write_metadata(work, bag_metadata(topics, files=files, custom_data=custom))


def _exchange(parts: Sequence[Part], work: Path, folder: Path, *, with_metadata: bool) -> None:
    """Move the new files to the places of the old ones, which are kept under other names."""
    for part in parts:
        kept = part.path.with_name(part.path.name + _KEPT_SUFFIX)
        if part.rebuilt is None:
            part.path.rename(kept)
        elif part.problems:
            os.link(part.path, kept)
            (work / part.name).replace(part.path)
    if with_metadata:
        old = folder / METADATA_FILE
        if old.exists() or old.is_symlink():  # a dangling link is kept too
            os.link(old, old.with_name(METADATA_FILE + _KEPT_SUFFIX))
        (work / METADATA_FILE).replace(old)


def _report(
    named: Path, output: Path | None, result: Path, parts: Sequence[Part], problems: Sequence[str]
) -> RepairReport:
    """Return the report of a repair whose bag will be at `output` and currently is at `result`."""
    kept = [part.rebuilt for part in parts if part.rebuilt is not None]
    lost: Counter[str] = Counter()
    lost_attachments: list[str] = []
    for rebuilt in kept:
        lost.update(_lost_messages(rebuilt))
        if rebuilt.stated is not None:
            there = {entry.name for entry in rebuilt.index.attachments}
            lost_attachments += [entry.name for entry in rebuilt.stated.attachments if entry.name not in there]
    steps = complete_steps(result)
    topics = bag_topics(part.index for part in parts)
    return RepairReport(
        bag=str(named),
        output=None if output is None else str(output),
        problems=tuple(problems),
        files=tuple(
            FileRepair(
                file=str(part.path),
                bytes=part.size,
                repaired_as=part.name if part.problems and part.rebuilt is not None else None,
                problems=tuple(part.problems),
                lost=tuple(part.rebuilt.damage) if part.rebuilt is not None else (),
                messages=part.index.statistics.message_count,
            )
            for part in parts
        ),
        topics=tuple(
            TopicRepair(
                topic.name,
                topic.message_count,
                lost[topic.name],
                steps.by_topic.get(topic.name) if steps else None,
            )
            for topic in topics
        ),
        messages=sum(topic.message_count for topic in topics),
        lost_bytes=sum(one.bytes for rebuilt in kept for one in rebuilt.damage),
        attachments=tuple(dict.fromkeys(entry.name for rebuilt in kept for entry in rebuilt.index.attachments)),
        lost_attachments=tuple(dict.fromkeys(lost_attachments)),
        undecided=contradiction(open_bag(result, damaged=True, several=True)),
        first_step=steps.first if steps else None,
        last_complete_step=steps.last_complete if steps else None,
        last_planned_step=steps.last_planned if steps else None,
    )


def _lost_messages(rebuilt: Rebuilt) -> Counter[str]:
    """Return the known losses by topic: from the summary section, otherwise from gaps in the sequence numbers."""
    lost: Counter[str] = Counter()
    kept = rebuilt.index.statistics.channel_message_counts
    for number, channel in rebuilt.index.channels.items():
        if rebuilt.stated is None:
            missing = rebuilt.gaps.get(number, 0)
        else:
            missing = rebuilt.stated.statistics.channel_message_counts.get(number, 0) - kept.get(number, 0)
        lost[channel.topic] += max(0, missing)
    return lost
