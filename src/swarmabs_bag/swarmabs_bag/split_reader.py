"""Reading a bag that goes on in several files as one."""

from __future__ import annotations

import re
from itertools import islice
from typing import TYPE_CHECKING, Any

from swarmabs_bag.errors import DamagedBagError
from swarmabs_bag.index import FileIndex
from swarmabs_bag.reader import BagReader, open_bag

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    from mcap.records import Channel

    from swarmabs_bag.records import StoredMessage

_MOST_NAMED = 3


class SplitBagReader(BagReader):
    """A bag in several files, open for reading; made by `open_bag`.

    Attributes
    ----------
    path : Path
        The folder of the files.
    parts : tuple of BagReader
        The files that can be read, in order. Channels have the same number in all of them to the outside.
    """

    def __init__(self, folder: Path, parts: Sequence[BagReader], problem: str | None, namespace: str | None) -> None:
        self.parts = tuple(parts)
        index, self._numbers = _merged(part.index for part in parts)
        index.problem = problem
        super().__init__(folder, sum(part.size for part in parts), index, namespace)

    def attachments(self, name: str) -> Iterator[bytes]:
        """Yield the contents of all attachments of a name, file by file."""
        for part in self.parts:
            yield from part.attachments(name)

    def rosbag2_metadata(self) -> dict[str, Any]:
        """Return rosbag2's description of the last file, which says how the run ended."""
        return self.parts[-1].rosbag2_metadata()

    def check(self) -> None:
        """Check every file."""
        for part in self.parts:
            part.check()

    def _stored(self) -> Iterator[StoredMessage]:
        for part, numbers in zip(self.parts, self._numbers, strict=True):
            same = all(number == own for own, number in numbers.items())
            for _, message in part.stored_messages():
                yield message if same else message._replace(channel_id=numbers[message.channel_id])


def split_files(files: Iterable[Path]) -> dict[int, Path] | None:
    """Return the files of a split bag by number, None if they are not named ``NAME_0.mcap``, ``NAME_1.mcap``..."""
    found: dict[int, Path] = {}
    names = set()
    for file in files:
        match = re.fullmatch(r"(.*)_(0|[1-9]\d{0,8})", file.stem, re.ASCII)
        if match is None:
            return None
        names.add(match[1])
        found[int(match[2])] = file
    return dict(sorted(found.items())) if len(names) == 1 else None


def missing_files(files: dict[int, Path]) -> list[str]:
    """Return what is missing in the row of a split bag's files; not more than the first few, of what may be many."""
    name = next(iter(files.values())).stem.rpartition("_")[0]
    missing = (number for number in range(max(files)) if number not in files)
    return [f"{name}_{number}.mcap is missing" for number in islice(missing, _MOST_NAMED)]


def open_split(folder: Path, files: dict[int, Path], *, namespace: str | None, damaged: bool) -> SplitBagReader:
    """Open all files of a split bag; parameters and errors as of `open_bag`."""
    problems = missing_files(files)
    if problems and not damaged:
        raise DamagedBagError(f"{folder} is incomplete: {', '.join(problems)}; name one of its files to read that one")
    parts = []
    for file in files.values():
        try:
            part = open_bag(file, damaged=damaged, several=True)
        except DamagedBagError as error:
            if not damaged:
                raise
            problems.append(str(error))
        else:
            parts.append(part)
            if part.problem is not None:
                problems.append(f"{file.name}: {part.problem}")
    if not parts:
        raise DamagedBagError(problems[0])
    return SplitBagReader(folder, parts, "; ".join(problems) or None, namespace)


def _merged(indexes: Iterable[FileIndex]) -> tuple[FileIndex, list[dict[int, int]]]:
    """Return the index of all files together, and for each file the new numbers of its channels."""
    merged = FileIndex()
    known: dict[object, int] = {}
    renumbered = []
    for position, index in enumerate(indexes):
        if position == 0:
            merged.header = index.header
        numbers = {own: _number(channel, index, merged, known) for own, channel in sorted(index.channels.items())}
        renumbered.append(numbers)
        merged.chunks += index.chunks
        names = {attachment.name for attachment in merged.attachments}
        merged.attachments += [attachment for attachment in index.attachments if attachment.name not in names]
        found, total = index.statistics, merged.statistics
        if found.message_count:
            first = total.message_count == 0
            start = found.message_start_time
            total.message_start_time = start if first else min(total.message_start_time, start)
            total.message_end_time = max(total.message_end_time, found.message_end_time)
        total.message_count += found.message_count
        for own, count in found.channel_message_counts.items():
            if own in numbers:
                total.channel_message_counts[numbers[own]] += count
    return merged, renumbered


def _number(channel: Channel, index: FileIndex, merged: FileIndex, known: dict[object, int]) -> int:
    """Return the number of a channel in all files together; take it up there if it is new."""
    schema = index.schemas.get(channel.schema_id)
    text = (schema.name, schema.encoding, schema.data) if schema is not None else None
    key = (channel.topic, channel.message_encoding, tuple(sorted(channel.metadata.items())), text)
    number = known.setdefault(key, channel.id if channel.id not in merged.channels else max(merged.channels) + 1)
    if number not in merged.channels:
        merged.channels[number] = type(channel)(
            id=number,
            schema_id=number if schema is not None else 0,
            topic=channel.topic,
            message_encoding=channel.message_encoding,
            metadata=channel.metadata,
        )
        if schema is not None:
            merged.schemas[number] = type(schema)(
                id=number, name=schema.name, encoding=schema.encoding, data=schema.data
            )
    return number
