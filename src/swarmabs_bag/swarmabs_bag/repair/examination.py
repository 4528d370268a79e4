"""Examination of a damaged bag: its files, what can be recovered from each, the damage, and what metadata.yaml says."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcap.opcode import Opcode
from mcap.records import Header

from swarmabs_bag.errors import DamagedBagError, NotABagError
from swarmabs_bag.mcap.index import FileIndex, scan_index
from swarmabs_bag.mcap.records import MAGIC, RecordError, parse, read_record
from swarmabs_bag.repair.rebuild import Rebuilt
from swarmabs_bag.run.channels import bag_topics
from swarmabs_bag.run.metadata import METADATA_FILE, BagChannel, custom_texts, listed_topic, load_yaml
from swarmabs_bag.run_folder import SUFFIX, missing_files, split_files
from swarmabs_config.scenario import ScenarioError
from swarmabs_config.scenario.text_file import read_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from typing import BinaryIO

    from swarmabs_bag.mcap.output import RecordFile


@dataclass(slots=True)
class Part:
    """A file of the bag, its new name, what can be recovered (None if nothing was ever written), and its problems."""

    path: Path
    name: str
    size: int
    definitions: FileIndex | None
    rebuilt: Rebuilt | None = None
    problems: list[str] = field(default_factory=list)

    @property
    def index(self) -> FileIndex:
        """The index of the new file."""
        return FileIndex() if self.rebuilt is None else self.rebuilt.index

    def custom_data(self) -> dict[str, str]:
        """Return the entries under ``custom_data`` of the file's metadata record."""
        return custom_texts(load_yaml("" if self.rebuilt is None else self.rebuilt.description))

    def rebuild(self, output: RecordFile | None = None, custom: Mapping[str, str] | None = None) -> Rebuilt:
        """Determine what can be recovered, and write it to `output` if given."""
        with self.path.open("rb") as stream:
            self.rebuilt = Rebuilt(
                stream, self.size, output, definitions=self.definitions, name=self.name, custom=custom
            )
            return self.rebuilt


def examine(bag: Path) -> tuple[list[Part], list[str]]:
    """Return the files of a bag, examined, and the problems of the bag as a whole."""
    files = (split_files(bag.glob(f"*{SUFFIX}")) or {}) if bag.is_dir() else {0: bag}
    if not files:
        raise NotABagError(f"{bag} is a folder without .mcap files: name a run folder, its bag/, or an .mcap file")
    problems = missing_files(files) if bag.is_dir() else []
    for path in files.values():
        if not path.is_file() and path.exists():  # opening a pipe or device may block for ever
            raise NotABagError(f"{path} is not a regular file: move it away, or name one of the other files")
    definitions = _definitions(files.values()) if len(files) > 1 else None
    parts: list[Part] = []
    for path in files.values():
        part = _examined(path, definitions)
        if bag.is_dir():
            stem = path.stem.rpartition("_")[0]
            part.name = f"{stem}_{sum(other.rebuilt is not None for other in parts)}{SUFFIX}"
        parts.append(part)
    return parts, problems


def _examined(path: Path, definitions: FileIndex | None) -> Part:
    try:
        with path.open("rb") as stream:
            part = Part(path, path.name, stream.seek(0, 2), definitions)
            if not _begins_as_mcap(stream, part.size):
                raise NotABagError(f"{path} is not a bag: it does not begin as an MCAP file")
        if part.size <= len(MAGIC):
            part.problems.append(f"{path.name} has only {part.size} bytes: nothing was written to it")
        else:
            part.problems += _problems(part.rebuild())
    except OSError as error:
        raise NotABagError(f"cannot read {path}: {error.strerror or error}") from error
    except RecordError as error:
        raise DamagedBagError(f"{path}: {error}; nothing can be recovered") from error
    return part


def _begins_as_mcap(stream: BinaryIO, size: int) -> bool:
    """Return whether a file begins as an MCAP file, even if it is truncated there or its first bytes are damaged.

    They may be zeros, which a power cut leaves in place of a page that was not on the disk.
    """
    stream.seek(0)
    begin = stream.read(len(MAGIC))
    if MAGIC.startswith(begin) or not any(begin):
        return True
    try:
        first = read_record(stream, len(MAGIC), size)
        parse(Header, first)
    except RecordError:
        return False
    return first.opcode == Opcode.HEADER


def _definitions(files: Iterable[Path]) -> FileIndex | None:
    """Return schemas and channels from any file of a bag by this project, where all files share their numbers."""
    for path in files:
        try:
            with path.open("rb") as stream:
                index = scan_index(stream, stream.seek(0, 2))
        except (OSError, RecordError):
            continue
        if index.channels and index.is_own:
            return index
    return None


def _problems(rebuilt: Rebuilt) -> list[str]:
    """Return the problems of a file; empty if it is intact."""
    problems = [f"at byte {part.offset}: {part.problem}" for part in rebuilt.damage]
    if rebuilt.end is None:
        problems.append("its end, with the summary of its content, is missing")
    if rebuilt.reindexed:
        problems.append(f"{rebuilt.reindexed} chunks with wrong or missing message indexes or times")
    if rebuilt.unschemed:
        problems.append(f"{len(rebuilt.unschemed)} topics without a definition in the file")
    if rebuilt.repacked and not rebuilt.damage:
        problems.append(f"{rebuilt.repacked} messages outside of chunks")
    wrong = None if problems else _summary_problem(rebuilt)
    return problems if wrong is None else [wrong]


def _summary_problem(rebuilt: Rebuilt) -> str | None:
    """Return a contradiction between an intact data section and the summary of the file."""
    stated, there = rebuilt.stated, rebuilt.before
    if stated is None:
        return rebuilt.unstated
    if rebuilt.end is not None and rebuilt.end.data_section_crc not in {0, there.crc}:
        return "the CRC of the data section does not match"
    return stated.contradicted_by(there)


def metadata_problem(folder: Path, parts: Sequence[Part]) -> str | None:
    """Return a problem of ``metadata.yaml`` that would mislead a reader, or None."""
    if not (folder / METADATA_FILE).exists():
        return f"{METADATA_FILE} is missing"
    try:
        stated = _stated(folder)
    except ScenarioError:
        return f"{METADATA_FILE} cannot be read"
    if stated is None:
        return f"{METADATA_FILE} is not a description by rosbag2"
    counts = _counts(bag_topics(part.index for part in parts))
    listed = _listed(stated)
    right = (
        stated.get("relative_file_paths") == [part.name for part in parts]
        and stated.get("message_count") == sum(counts.values())
        and listed is not None
        and _counts(listed) == counts
    )
    return None if right else f"{METADATA_FILE} does not agree with the files"


def _counts(topics: Iterable[BagChannel]) -> dict[str, int]:
    return {topic.name: topic.message_count for topic in topics if topic.message_count}


def silent_topics(folder: Path) -> list[BagChannel]:
    """Return the topics without messages from ``metadata.yaml``, which may be their only record in a damaged bag."""
    with suppress(ScenarioError):
        return [topic for topic in _listed(_stated(folder) or {}) or () if topic.message_count == 0]
    return []


def _stated(folder: Path) -> dict[str, Any] | None:
    """Return the content of ``metadata.yaml``, None if it is not rosbag2's; raise `ScenarioError` if unreadable."""
    document = load_yaml(read_text(folder / METADATA_FILE, "description"))
    stated = document.get("rosbag2_bagfile_information") if isinstance(document, dict) else None
    return stated if isinstance(stated, dict) else None


def _listed(stated: dict[str, Any]) -> list[BagChannel] | None:
    """Return the topics with message counts listed in ``metadata.yaml``, None if there is no such list."""
    try:
        return [listed_topic(entry) for entry in stated.get("topics_with_message_count") or ()]
    except (AttributeError, TypeError, KeyError):
        return None
