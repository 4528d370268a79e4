"""Making a whole bag of a damaged one, and saying what was lost."""

from __future__ import annotations

import os
import shutil
import stat
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcap.opcode import Opcode
from mcap.records import DataEnd, Header

from swarmabs_bringup.bag.errors import BagFolderError, BagWriteError, DamagedBagError, NotABagError
from swarmabs_bringup.bag.index import FileIndex, read_index, scan_index
from swarmabs_bringup.bag.metadata import (
    ABORTED_KEY,
    METADATA_FILE,
    RECORD_KEY,
    REPAIRED_KEY,
    FileRecord,
    TopicRecord,
    bag_metadata,
    dump_yaml,
    qos_profiles,
    write_metadata,
)
from swarmabs_bringup.bag.output import RecordFile
from swarmabs_bringup.bag.reader import find_bag, load_yaml
from swarmabs_bringup.bag.rebuild import Nowhere, rebuild
from swarmabs_bringup.bag.records import MAGIC, RecordError, parse, read_record
from swarmabs_bringup.bag.split_reader import missing_files, split_files
from swarmabs_bringup.bag.steps import recorded_steps
from swarmabs_core.scenario.errors import ScenarioError
from swarmabs_core.scenario.text_file import read_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from typing import BinaryIO

    from mcap.records import Statistics

    from swarmabs_bringup.bag.rebuild import Output, Rebuilt
    from swarmabs_bringup.bag.salvage import Damage

CUT_OFF = "the recording was cut off"
"""Reason under `ABORTED_KEY` of a bag whose writer did not come to its end."""

_KEPT_SUFFIX = ".damaged"
_OWN = "swarmabs"
_TEMPORARY = ".repairing"


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


@dataclass(slots=True)
class _Part:
    """A file of the bag, its name afterwards, and what can be saved of it: None if nothing was ever in it."""

    path: Path
    name: str
    size: int
    found: Rebuilt | None
    problems: list[str]


def repair_bag(path: Path | str, output: Path | None = None, *, in_place: bool = False) -> RepairReport:
    """Make a whole bag of a damaged one.

    Every chunk, attachment and other record that is whole is kept as it is, of a chunk that the file's end cuts off
    the whole messages; all indexes, the summary section and ``metadata.yaml`` are made anew. A file that is whole
    stays as it is, byte by byte.

    Parameters
    ----------
    path : Path or str
        A run folder, its ``bag/``, or an MCAP file.
    output : Path, optional
        Folder of the new bag, which must not exist or be empty; by default it is beside the damaged one, with
        ``_repaired`` behind its name, and not made if there is nothing to do.
    in_place : bool
        Whether the new files take the names of the damaged ones, which are kept with ``.damaged`` behind theirs.

    Raises
    ------
    NotABagError
        If there is nothing, or something that is no bag.
    BagFolderError
        If the output exists, or a bag cannot be repaired in place.
    DamagedBagError
        If no message can be saved.
    BagWriteError
        If the disk is full or fails; nothing is left behind.
    """
    named = Path(path)
    found = find_bag(named)
    folder = None if named.is_file() else found if found.is_dir() else found.parent
    target = _target(found if folder is None else folder, output, in_place=in_place, is_file=folder is None)
    parts, problems = _examine(found)
    kept = [part for part in parts if part.found is not None]
    if not kept:
        raise DamagedBagError(f"{found}: nothing can be saved: {parts[0].problems[0]}")
    damaged = [part for part in kept if part.found is not None and part.found.damage]
    if damaged and not any(part.found.index.statistics.message_count for part in kept if part.found is not None):
        raise DamagedBagError(f"{damaged[0].path}: no message can be saved: {damaged[0].problems[0]}")
    if in_place and any(part.name != part.path.name for part in kept):
        gap = next(iter(problems), None) or next(part.problems[0] for part in parts if part.found is None)
        raise BagFolderError(f"{found} cannot be repaired in place: {gap}; repair it into a new folder with -o")
    unfinished = kept[-1] is not parts[-1] or (kept[-1].found is not None and not kept[-1].found.ended)
    if folder is not None:
        problem = _metadata_problem(folder, kept)
        if problem is not None and not problems and not any(part.problems for part in parts):
            problems.append(problem)
    if len(kept) > 1 and not unfinished and not (kept[0].path.parent / METADATA_FILE).exists():
        unfinished = _stops_early(found)
    if unfinished and _custom_data(kept[-1].found).get(ABORTED_KEY) is None and not kept[-1].problems:
        kept[-1].problems.append(CUT_OFF)
    idle = not problems and not any(part.problems for part in parts)
    if idle and (output is None or in_place):
        return _report(named, None, found, parts, problems)
    if in_place:
        _refuse_earlier(parts, target)
    with _work_folder(target) as work:
        _write(kept, work, unfinished=unfinished)
        report = _report(named, target, work, parts, problems)
        if in_place:
            _exchange(parts, work, found.parent if folder is None else folder, with_metadata=folder is not None)
        else:
            target.parent.mkdir(parents=True, exist_ok=True)
            work.rename(target)
    return report


def _target(bag: Path, output: Path | None, *, in_place: bool, is_file: bool) -> Path:
    """Return where the new bag goes, and refuse what is in its way."""
    place = bag.resolve()
    if in_place:
        if output is not None:
            raise BagFolderError("a bag is repaired either in place or into a new folder: leave out --in-place or -o")
        return place.parent if is_file else place
    target = output if output is not None else place.with_name(f"{place.stem if is_file else place.name}_repaired")
    try:
        if target.exists() and (not target.is_dir() or any(target.iterdir())):
            raise BagFolderError(f"{target} exists: name a new folder with -o")
    except OSError as error:
        raise BagFolderError(f"{target} cannot be used: {error.strerror}; name another folder with -o") from error
    return target


def _refuse_earlier(parts: Sequence[_Part], folder: Path) -> None:
    """Refuse to replace what an earlier repair has kept."""
    names = [part.path.name for part in parts if part.problems] + [METADATA_FILE]
    for kept in (folder / (name + _KEPT_SUFFIX) for name in names):
        if kept.exists() or kept.is_symlink():
            raise BagFolderError(f"{kept} is there from an earlier repair: move it away, or name a folder with -o")
    if (folder / METADATA_FILE).is_dir():
        raise BagFolderError(f"{folder / METADATA_FILE} is a folder: move it away, or name a folder with -o")


def _examine(bag: Path) -> tuple[list[_Part], list[str]]:
    """Return the files of a bag with what can be saved of them, and what is wrong with the bag as a whole."""
    files = (split_files(bag.glob("*.mcap")) or {}) if bag.is_dir() else {0: bag}
    problems = []
    if bag.is_dir():
        stem = next(iter(files.values())).stem.rpartition("_")[0]
        problems = missing_files(files)
    for path in files.values():
        _refuse_waiting(path)
    definitions = _definitions(files.values()) if len(files) > 1 else None
    parts: list[_Part] = []
    for path in files.values():
        part = _examined(path, definitions)
        if bag.is_dir():
            part.name = f"{stem}_{sum(other.found is not None for other in parts)}.mcap"
        parts.append(part)
    return parts, problems


def _refuse_waiting(path: Path) -> None:
    """Refuse what is opened only when somebody writes into it, or never ends."""
    try:
        mode = path.stat().st_mode
    except OSError as error:
        raise NotABagError(f"cannot read {path}: {error.strerror or error}") from error
    if not stat.S_ISREG(mode):
        raise NotABagError(f"{path} is no file: move it away, or name one of the files beside it")


def _examined(path: Path, definitions: FileIndex | None) -> _Part:
    try:
        with path.open("rb") as stream:
            size = stream.seek(0, 2)
            part = _Part(path, path.name, size, None, [])
            if size <= len(MAGIC):
                stream.seek(0)
                if not MAGIC.startswith(stream.read(size)):
                    raise NotABagError(f"{path} is not a bag: it does not begin as an MCAP file")
                part.problems.append(f"{path.name} has only {size} bytes: nothing was written into it")
                return part
            if not _begins_as_mcap(stream, size):
                raise NotABagError(f"{path} is not a bag: it does not begin as an MCAP file")
            part.found = rebuild(stream, size, Nowhere(), definitions=definitions, describe=lambda _: "")
            part.problems += _problems(stream, size, part.found)
            return part
    except OSError as error:
        raise NotABagError(f"cannot read {path}: {error.strerror or error}") from error


def _begins_as_mcap(stream: BinaryIO, size: int) -> bool:
    stream.seek(0)
    if stream.read(len(MAGIC)) == MAGIC:
        return True
    try:
        first = read_record(stream, len(MAGIC), size)
        parse(Header, first)
    except RecordError:
        return False
    return first.opcode == Opcode.HEADER


def _definitions(files: Iterable[Path]) -> FileIndex | None:
    """Return schemas and channels from any file of a bag of this project, whose files all number them alike."""
    for path in files:
        try:
            with path.open("rb") as stream:
                index = scan_index(stream, stream.seek(0, 2))
        except (OSError, RecordError):
            continue
        if index.channels and index.header.library.startswith(_OWN):
            return index
    return None


def _problems(stream: BinaryIO, size: int, found: Rebuilt) -> list[str]:
    """Return what is wrong with a file; nothing if it is whole."""
    problems = [f"at byte {part.offset}: {part.problem}" for part in found.damage]
    if not found.ended:
        problems.append("it ends before it says what it holds")
    if found.reindexed:
        problems.append(f"{found.reindexed} chunks without right message indexes or times")
    if found.unschemed:
        problems.append(f"{len(found.unschemed)} topics whose definition is nowhere in the file")
    if found.repacked and not found.damage:
        problems.append(f"{found.repacked} messages outside of any chunk")
    if not problems:
        try:
            wrong = _summary_problem(stream, size)
        except RecordError as error:
            wrong = str(error)
        problems += [wrong] if wrong else []
    return problems


def _summary_problem(stream: BinaryIO, size: int) -> str | None:
    stated, found = read_index(stream, size), scan_index(stream, size)
    if found.problem is not None:
        return found.problem
    end: DataEnd = parse(DataEnd, read_record(stream, found.data_end, size))
    if end.data_section_crc not in {0, found.crc}:
        return "CRC of the data section does not match"
    if _numbers(stated.statistics) != _numbers(found.statistics):
        return "the numbers in the summary section are not those of the file"
    for name, said, there in (
        ("chunks", stated.chunks, found.chunks),
        ("attachments", stated.attachments, found.attachments),
        ("metadata records", stated.metadata, found.metadata),
    ):
        if said != there:
            return f"the summary section lists other {name} than the file has"
    if any(stated.channels.get(number) != channel for number, channel in found.channels.items()) or any(
        stated.schemas.get(number) != schema for number, schema in found.schemas.items()
    ):
        return "the summary section describes other topics than the file has"
    return None


def _numbers(statistics: Statistics) -> tuple[object, ...]:
    return (
        statistics.message_count,
        statistics.message_start_time,
        statistics.message_end_time,
        statistics.chunk_count,
        statistics.attachment_count,
        {channel: count for channel, count in statistics.channel_message_counts.items() if count},
    )


def _metadata_problem(folder: Path, parts: Sequence[_Part]) -> str | None:
    """Return what is wrong with ``metadata.yaml``, as far as it would mislead a reader."""
    if not (folder / METADATA_FILE).exists():
        return f"{METADATA_FILE} is missing"
    try:
        text = read_text(folder / METADATA_FILE, "description")
    except ScenarioError:
        return f"{METADATA_FILE} cannot be read"
    document = load_yaml(text)
    stated = document.get("rosbag2_bagfile_information") if isinstance(document, dict) else None
    if not isinstance(stated, dict):
        return f"{METADATA_FILE} is not rosbag2's"
    counts = {topic.name: count for topic, count in _topics(parts)}
    listed = stated.get("topics_with_message_count")
    try:
        said = {entry["topic_metadata"]["name"]: entry["message_count"] for entry in listed or ()}
    except (TypeError, KeyError):
        said = {}
    right = (
        stated.get("relative_file_paths") == [part.name for part in parts]
        and stated.get("message_count") == sum(counts.values())
        and said == counts
    )
    return None if right else f"{METADATA_FILE} does not agree with the files"


def _stops_early(bag: Path) -> bool:
    steps = recorded_steps(bag)
    return steps is not None and steps.last_complete < steps.last_planned


def _custom_data(found: Rebuilt | None) -> dict[str, str]:
    """Return the entries under ``custom_data`` of a file's metadata record."""
    text = "" if found is None else found.description.get(RECORD_KEY, "")
    description = load_yaml(text)
    custom = description.get("custom_data") if isinstance(description, dict) else None
    if not isinstance(custom, dict):
        return {}
    return {key: value for key, value in custom.items() if isinstance(key, str) and isinstance(value, str)}


def _lost_text(damage: Sequence[Damage]) -> str:
    first = damage[0]
    places = "1 place" if len(damage) == 1 else f"{len(damage)} places"
    lost = sum(part.size for part in damage)
    return f"{lost} bytes in {places} could not be saved, the first at byte {first.offset}: {first.problem}"


def _topics(parts: Sequence[_Part]) -> list[tuple[TopicRecord, int]]:
    """Return the topics of all files with their numbers of messages."""
    found: dict[str, tuple[TopicRecord, int]] = {}
    for part in parts:
        for topic, count in _topics_of(part.found.index if part.found is not None else FileIndex()):
            known, before = found.get(topic.name, (topic, 0))
            found[topic.name] = (known, before + count)
    return list(found.values())


def _topics_of(index: FileIndex) -> list[tuple[TopicRecord, int]]:
    found: dict[str, tuple[TopicRecord, int]] = {}
    for number, channel in sorted(index.channels.items()):
        schema = index.schemas.get(channel.schema_id)
        topic = TopicRecord(
            name=channel.topic,
            ros_type=schema.name if schema is not None else "",
            type_hash=channel.metadata.get("topic_type_hash", ""),
            profiles=qos_profiles(load_yaml(channel.metadata.get("offered_qos_profiles", ""))),
            encoding=channel.message_encoding,
        )
        known, before = found.get(topic.name, (topic, 0))
        found[topic.name] = (known, before + index.statistics.channel_message_counts.get(number, 0))
    return list(found.values())


def _file_record(name: str, index: FileIndex) -> FileRecord:
    statistics = index.statistics
    return FileRecord(name, statistics.message_start_time, statistics.message_end_time, statistics.message_count)


@contextmanager
def _work_folder(target: Path) -> Iterator[Path]:
    """Make a folder beside the target, which is gone afterwards unless it was renamed."""
    place = target.resolve()
    work = place.with_name(f".{place.name}{_TEMPORARY}")
    made: list[Path] = []
    done = False
    try:
        for parent in reversed([parent for parent in work.parents if not parent.exists()]):
            parent.mkdir()
            made.append(parent)
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
            for parent in reversed(made):
                parent.rmdir()


def _write(parts: Sequence[_Part], work: Path, *, unfinished: bool) -> None:
    """Write the new files and ``metadata.yaml``."""
    for part in parts:
        if not part.problems:
            shutil.copyfile(part.path, work / part.name)
            continue
        custom = _custom_data(part.found)
        if unfinished and part is parts[-1]:
            custom.setdefault(ABORTED_KEY, CUT_OFF)
        if part.found is not None and part.found.damage:
            custom[REPAIRED_KEY] = _lost_text(part.found.damage)
        part.found = _rewritten(part, work / part.name, custom, _shared(parts))
    custom = {}
    for part in parts:
        custom |= _custom_data(part.found)
    description = bag_metadata(
        _topics(parts),
        files=[_file_record(part.name, part.found.index) for part in parts if part.found is not None],
        custom_data=custom,
    )
    write_metadata(work, description)


def _shared(parts: Sequence[_Part]) -> FileIndex | None:
    return _definitions([part.path for part in parts]) if len(parts) > 1 else None


def _rewritten(part: _Part, path: Path, custom: Mapping[str, str], definitions: FileIndex | None) -> Rebuilt:
    def describe(found: Rebuilt) -> str:
        description = bag_metadata(
            _topics_of(found.index), files=[_file_record(part.name, found.index)], custom_data=custom
        )
        found.description = {RECORD_KEY: dump_yaml(description)}
        return found.description[RECORD_KEY]

    file: RecordFile = RecordFile(path)
    output: Output = file
    try:
        with part.path.open("rb") as stream:
            found = rebuild(stream, part.size, output, definitions=definitions, describe=describe)
        file.sync()
    finally:
        file.close()
    return found


def _exchange(parts: Sequence[_Part], work: Path, folder: Path, *, with_metadata: bool) -> None:
    """Put the new files in the places of the old ones, which keep their content under another name."""
    for part in parts:
        kept = part.path.with_name(part.path.name + _KEPT_SUFFIX)
        if part.found is None:
            part.path.rename(kept)
        elif part.problems:
            os.link(part.path, kept)
            (work / part.name).replace(part.path)
    if with_metadata:
        old = folder / METADATA_FILE
        if old.exists() or old.is_symlink():  # a link that leads nowhere is kept too
            os.link(old, old.with_name(METADATA_FILE + _KEPT_SUFFIX))
        (work / METADATA_FILE).replace(old)


def _report(
    named: Path, output: Path | None, result: Path, parts: Sequence[_Part], problems: Sequence[str]
) -> RepairReport:
    kept = [part for part in parts if part.found is not None]
    lost: dict[str, int] = {}
    lost_attachments: list[str] = []
    for part in kept:
        if part.found is None:
            continue
        for name, count in _lost_messages(part.found).items():
            lost[name] = lost.get(name, 0) + count
        if part.found.stated is not None:
            there = {entry.name for entry in part.found.index.attachments}
            lost_attachments += [e.name for e in part.found.stated.attachments if e.name not in there]
    steps = recorded_steps(result)
    topics = _topics(kept)
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
                messages=part.found.index.statistics.message_count if part.found is not None else 0,
            )
            for part in parts
        ),
        topics=tuple(
            TopicRepair(topic.name, count, lost.get(topic.name, 0), steps.by_topic.get(topic.name) if steps else None)
            for topic, count in topics
        ),
        messages=sum(count for _, count in topics),
        lost_bytes=sum(one.size for part in kept if part.found is not None for one in part.found.damage),
        attachments=tuple(
            dict.fromkeys(entry.name for part in kept if part.found for entry in part.found.index.attachments)
        ),
        lost_attachments=tuple(dict.fromkeys(lost_attachments)),
        first_step=steps.first if steps else None,
        last_complete_step=steps.last_complete if steps else None,
        last_planned_step=steps.last_planned if steps else None,
    )


def _lost_part(damage: Damage) -> LostPart:
    start, end = (None if time is None else time / 1e9 for time in (damage.start, damage.end))
    return LostPart(damage.offset, damage.size, damage.problem, start, end)


def _lost_messages(found: Rebuilt) -> dict[str, int]:
    """Return how many messages are known to be lost by topic: from the summary section, else from the gaps."""
    lost: dict[str, int] = {}
    for number, channel in found.index.channels.items():
        if found.stated is not None:
            kept = found.index.statistics.channel_message_counts.get(number, 0)
            count = found.stated.statistics.channel_message_counts.get(number, 0) - kept
        else:
            count = found.gaps.get(number, 0)
        if count > 0:
            lost[channel.topic] = lost.get(channel.topic, 0) + count
    return lost
