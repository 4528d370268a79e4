"""What there is of a damaged bag: its files, what can be saved of each, and what is wrong with it."""

from __future__ import annotations

import stat
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcap.opcode import Opcode
from mcap.records import Header

from swarmabs_bag.channels import bag_channel
from swarmabs_bag.errors import DamagedBagError, NotABagError
from swarmabs_bag.index import FileIndex, scan_index
from swarmabs_bag.metadata import METADATA_FILE, TopicRecord, custom_texts, load_yaml, qos_profiles, topic_record
from swarmabs_bag.places import SUFFIX, missing_files, split_files
from swarmabs_bag.rebuild import OWN, Rebuilt
from swarmabs_bag.records import MAGIC, RecordError, parse, read_record
from swarmabs_bag.steps import recorded_steps
from swarmabs_config.scenario.errors import ScenarioError
from swarmabs_config.scenario.text_file import read_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from typing import BinaryIO


@dataclass(slots=True)
class Part:
    """A file of the bag, its name afterwards, and what can be saved of it: None if nothing was ever in it."""

    path: Path
    name: str
    size: int
    found: Rebuilt | None
    problems: list[str]

    @property
    def index(self) -> FileIndex:
        """What the file holds afterwards."""
        return FileIndex() if self.found is None else self.found.index

    def custom_data(self) -> dict[str, str]:
        """Return the entries under ``custom_data`` of the file's metadata record."""
        return custom_texts(load_yaml("" if self.found is None else self.found.description))


def examine(bag: Path) -> tuple[list[Part], list[str]]:
    """Return the files of a bag with what can be saved of them, and what is wrong with the bag as a whole."""
    files = (split_files(bag.glob(f"*{SUFFIX}")) or {}) if bag.is_dir() else {0: bag}
    problems = missing_files(files) if bag.is_dir() else []
    for path in files.values():
        _refuse_waiting(path)
    definitions = definitions_of(files.values()) if len(files) > 1 else None
    parts: list[Part] = []
    for path in files.values():
        part = _examined(path, definitions)
        if bag.is_dir():
            stem = path.stem.rpartition("_")[0]
            part.name = f"{stem}_{sum(other.found is not None for other in parts)}{SUFFIX}"
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
            if not _begins_as_mcap(stream, size):
                raise NotABagError(f"{path} is not a bag: it does not begin as an MCAP file")
            if size <= len(MAGIC):
                part.problems.append(f"{path.name} has only {size} bytes: nothing was written into it")
                return part
            part.found = Rebuilt(stream, size, definitions=definitions)
            part.problems += _problems(part.found)
            return part
    except OSError as error:
        raise NotABagError(f"cannot read {path}: {error.strerror or error}") from error
    except RecordError as error:
        raise DamagedBagError(f"{path}: {error}; nothing can be saved") from error


def _begins_as_mcap(stream: BinaryIO, size: int) -> bool:
    """Tell whether a file begins as one of MCAP, which may be cut off, or have lost nothing but its first bytes."""
    stream.seek(0)
    if MAGIC.startswith(stream.read(len(MAGIC))):
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
        if index.channels and index.header.library.startswith(OWN):
            return index
    return None


def _problems(found: Rebuilt) -> list[str]:
    """Return what is wrong with a file; nothing if it is whole."""
    problems = [f"at byte {part.offset}: {part.problem}" for part in found.damage]
    if found.end is None:
        problems.append("it ends before it says what it holds")
    if found.reindexed:
        problems.append(f"{found.reindexed} chunks without right message indexes or times")
    if found.unschemed:
        problems.append(f"{len(found.unschemed)} topics whose definition is nowhere in the file")
    if found.repacked and not found.damage:
        problems.append(f"{found.repacked} messages outside of any chunk")
    wrong = None if problems else _summary_problem(found)
    return problems if wrong is None else [wrong]


def _summary_problem(found: Rebuilt) -> str | None:
    """Return where a file whose data section is whole contradicts what it says of it."""
    stated, there = found.stated, found.before
    if stated is None:
        return found.unstated
    if found.end is not None and found.end.data_section_crc not in {0, there.crc}:
        return "CRC of the data section does not match"
    if (stated.numbers(), stated.statistics.attachment_count) != (there.numbers(), there.statistics.attachment_count):
        return "the numbers in the summary section are not those of the file"
    counted = there.entries()
    for name, said in stated.entries().items():
        if said != counted[name]:
            return f"the summary section lists other {name} than the file has"
    if not (there.channels.items() <= stated.channels.items() and there.schemas.items() <= stated.schemas.items()):
        return "the summary section describes other topics than the file has"
    return None


def metadata_problem(folder: Path, parts: Sequence[Part]) -> str | None:
    """Return what is wrong with ``metadata.yaml``, as far as it would mislead a reader."""
    if not (folder / METADATA_FILE).exists():
        return f"{METADATA_FILE} is missing"
    try:
        stated = _stated(folder)
    except ScenarioError:
        return f"{METADATA_FILE} cannot be read"
    if stated is None:
        return f"{METADATA_FILE} is not rosbag2's"
    counts = {topic.name: count for topic, count in topics_of(parts) if count}
    listed = _listed(stated)
    right = (
        stated.get("relative_file_paths") == [part.name for part in parts]
        and stated.get("message_count") == sum(counts.values())
        and listed is not None
        and {topic.name: count for topic, count in listed if count} == counts
    )
    return None if right else f"{METADATA_FILE} does not agree with the files"


def silent_topics(folder: Path) -> list[TopicRecord]:
    """Return the topics without messages of ``metadata.yaml``, the only place where a damaged bag may name them."""
    try:
        stated = _stated(folder)
    except ScenarioError:
        return []
    return [topic for topic, count in (stated and _listed(stated)) or () if count == 0]


def _stated(folder: Path) -> dict[str, Any] | None:
    """Return what ``metadata.yaml`` says, None if it is not rosbag2's; a `ScenarioError` if it cannot be read."""
    document = load_yaml(read_text(folder / METADATA_FILE, "description"))
    stated = document.get("rosbag2_bagfile_information") if isinstance(document, dict) else None
    return stated if isinstance(stated, dict) else None


def _listed(stated: dict[str, Any]) -> list[tuple[TopicRecord, Any]] | None:
    """Return the topics that ``metadata.yaml`` lists with their numbers of messages, None if it has no such list."""
    try:
        return [
            (topic_record(entry["topic_metadata"]), entry["message_count"])
            for entry in stated.get("topics_with_message_count") or ()
        ]
    except (AttributeError, TypeError, KeyError):
        return None


def stops_early(bag: Path) -> bool:
    """Tell whether a bag of a swarm ends before its scenario does."""
    steps = recorded_steps(bag)
    return steps is not None and steps.last_complete < steps.last_planned


def topics_of(parts: Sequence[Part]) -> list[tuple[TopicRecord, int]]:
    """Return the topics of files with their numbers of messages."""
    found: dict[str, tuple[TopicRecord, int]] = {}
    for index in (part.index for part in parts):
        for channel in (bag_channel(one, index) for _, one in sorted(index.channels.items())):
            topic = TopicRecord(
                name=channel.name,
                ros_type=channel.ros_type,
                type_hash=channel.type_hash,
                profiles=qos_profiles(load_yaml(channel.qos_profiles)),
                encoding=channel.encoding,
            )
            known, before = found.get(topic.name, (topic, 0))
            found[topic.name] = (known, before + channel.message_count)
    return list(found.values())
