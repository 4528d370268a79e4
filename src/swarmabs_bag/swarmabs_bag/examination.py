"""What there is of a damaged bag: its files, what can be saved of each, and what is wrong with it."""

from __future__ import annotations

import stat
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mcap.opcode import Opcode
from mcap.records import DataEnd, Header

from swarmabs_bag.errors import NotABagError
from swarmabs_bag.index import FileIndex, read_index, scan_index
from swarmabs_bag.metadata import METADATA_FILE, RECORD_KEY, TopicRecord, qos_profiles
from swarmabs_bag.reader import load_yaml
from swarmabs_bag.rebuild import Nowhere, rebuild
from swarmabs_bag.records import MAGIC, RecordError, parse, read_record
from swarmabs_bag.split_reader import missing_files, split_files
from swarmabs_bag.steps import recorded_steps
from swarmabs_config.scenario.errors import ScenarioError
from swarmabs_config.scenario.text_file import read_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from typing import BinaryIO

    from mcap.records import Statistics

    from swarmabs_bag.rebuild import Rebuilt

_OWN = "swarmabs"


@dataclass(slots=True)
class Part:
    """A file of the bag, its name afterwards, and what can be saved of it: None if nothing was ever in it."""

    path: Path
    name: str
    size: int
    found: Rebuilt | None
    problems: list[str]


def examine(bag: Path) -> tuple[list[Part], list[str]]:
    """Return the files of a bag with what can be saved of them, and what is wrong with the bag as a whole."""
    files = (split_files(bag.glob("*.mcap")) or {}) if bag.is_dir() else {0: bag}
    problems = []
    if bag.is_dir():
        stem = next(iter(files.values())).stem.rpartition("_")[0]
        problems = missing_files(files)
    for path in files.values():
        _refuse_waiting(path)
    definitions = definitions_of(files.values()) if len(files) > 1 else None
    parts: list[Part] = []
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


def _examined(path: Path, definitions: FileIndex | None) -> Part:
    try:
        with path.open("rb") as stream:
            size = stream.seek(0, 2)
            part = Part(path, path.name, size, None, [])
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


def definitions_of(files: Iterable[Path]) -> FileIndex | None:
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


def metadata_problem(folder: Path, parts: Sequence[Part]) -> str | None:
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
    counts = {topic.name: count for topic, count in topics_of(parts)}
    listed = stated.get("topics_with_message_count")
    said: dict[str, int] | None
    try:
        said = {
            entry["topic_metadata"]["name"]: entry["message_count"] for entry in listed or () if entry["message_count"]
        }
    except (TypeError, KeyError):
        said = None
    right = (
        stated.get("relative_file_paths") == [part.name for part in parts]
        and stated.get("message_count") == sum(counts.values())
        and said == {name: count for name, count in counts.items() if count}
    )
    return None if right else f"{METADATA_FILE} does not agree with the files"


def stops_early(bag: Path) -> bool:
    """Tell whether a bag of a swarm ends before its scenario does."""
    steps = recorded_steps(bag)
    return steps is not None and steps.last_complete < steps.last_planned


def custom_data(found: Rebuilt | None) -> dict[str, str]:
    """Return the entries under ``custom_data`` of a file's metadata record."""
    text = "" if found is None else found.description.get(RECORD_KEY, "")
    description = load_yaml(text)
    custom = description.get("custom_data") if isinstance(description, dict) else None
    if not isinstance(custom, dict):
        return {}
    return {key: value for key, value in custom.items() if isinstance(key, str) and isinstance(value, str)}


def topics_of(parts: Sequence[Part]) -> list[tuple[TopicRecord, int]]:
    """Return the topics of all files with their numbers of messages."""
    found: dict[str, tuple[TopicRecord, int]] = {}
    for part in parts:
        for topic, count in topics_of_file(part.found.index if part.found is not None else FileIndex()):
            known, before = found.get(topic.name, (topic, 0))
            found[topic.name] = (known, before + count)
    return list(found.values())


def topics_of_file(index: FileIndex) -> list[tuple[TopicRecord, int]]:
    """Return the topics of one file with their numbers of messages."""
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
