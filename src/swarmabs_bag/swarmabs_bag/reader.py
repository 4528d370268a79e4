"""Reading bags in file order and bounded memory, with every length, CRC and type checked.

A bag is read from its MCAP files alone; ``metadata.yaml`` is a copy for rosbag2. Any violation of the format raises
`DamagedBagError` with its position in the file.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from swarmabs_bag.errors import CONVERT, DamagedBagError, NotABagError
from swarmabs_bag.mcap.file_reader import BagFile, open_file
from swarmabs_bag.mcap.index import FileIndex, add_messages
from swarmabs_bag.run.channels import bag_channel, check_definitions, chosen_swarm, named_swarms, swarm_topics
from swarmabs_bag.run.grouping import TopicMessages, whole_steps
from swarmabs_bag.run.metadata import ABORTED_KEY, custom_texts, load_yaml
from swarmabs_bag.run.step import Step
from swarmabs_bag.run_folder import SUFFIX, find_bag, missing_files, split_files
from swarmabs_core.cdr import decode
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import FAMILIES, PLANE_FAMILY, TYPES
from swarmabs_core.record import Record

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Sequence

    from mcap.records import Channel

    from swarmabs_bag.mcap.records import StoredMessage
    from swarmabs_bag.mcap.stored import StoredMessages
    from swarmabs_bag.run.grouping import Published
    from swarmabs_bag.run.metadata import BagChannel
    from swarmabs_core.messages import Family, Message, Topic

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""First bytes of a zstd frame; CDR payloads begin with a zero."""

T = TypeVar("T")


class BagReader:
    """A bag of one or several files, created by `open_bag`.

    Nothing stays open between calls, and several iterations may run at the same time. They raise `DamagedBagError` at a
    damaged place, after everything before it has been yielded.

    Attributes
    ----------
    path : Path
        The MCAP file, or the folder of a split bag.
    files : tuple of BagFile
        The readable files, in order; `size` is their total size in bytes.
    index : FileIndex
        Their merged index, in which channels have common numbers.
    start, end : int
        Log times of the first and last message in ns, 0 without messages.
    channels : tuple of BagChannel
        Its topics in the order of their ids.
    swarms : tuple of str
        Namespaces of all its swarms, with trailing slash.
    namespace : str or None
        Namespace of the swarm that is read, None if there is none, or several and none was chosen.
    supplied : dict
        Attachments by name that replace those in the files.
    problem : str or None
        Why the end of the bag is missing, if opened with ``damaged=True``; None for a complete bag.
    """

    def __init__(self, path: Path, files: Sequence[BagFile], problem: str | None, namespace: str | None) -> None:
        self.path = path
        self.files = tuple(files)
        self.problem = problem
        self.supplied: dict[str, bytes] = {}
        self.size = sum(file.size for file in files)
        indexes = [file.index for file in files]
        self.index, self._numbers = _merged(indexes) if len(indexes) > 1 else (indexes[0], [{}])
        statistics = self.index.statistics
        self.start, self.end = statistics.message_start_time, statistics.message_end_time
        self.message_count = statistics.message_count
        topics = swarm_topics(self.index)
        self.swarms = tuple(sorted({swarm for swarm, _ in topics.values()}))
        chosen = chosen_swarm(path, self.swarms, namespace)
        of_chosen = {number: topic for number, (swarm, topic) in topics.items() if swarm == chosen}
        self._channels = {
            number: bag_channel(channel, self.index, of_chosen.get(number))
            for number, channel in sorted(self.index.channels.items())
        }
        self.channels = tuple(self._channels.values())
        self.namespace = chosen

    def topics(self) -> tuple[Topic, ...]:
        """Return the topics of the swarm in the bag."""
        return tuple(channel.topic for channel in self.channels if channel.topic is not None)

    def of_swarm(self) -> tuple[BagChannel, ...]:
        """Return the channels of the swarm, and those of its messages on topics that this version does not know."""
        return tuple(
            channel
            for channel in self.channels
            if channel.topic is not None
            or (channel.ros_type.startswith(TYPES) and self._swarm_of(channel.name) == self.namespace is not None)
        )

    def _swarm_of(self, name: str) -> str | None:
        """Return the namespace of the swarm to which the name of a topic belongs."""
        return max((swarm for swarm in self.swarms if name.startswith(swarm)), key=len, default=None)

    @property
    def family(self) -> Family:
        """The topics of its run: those of a swarm on the plane unless it has others."""
        return next((family for family in FAMILIES if set(family.main) & set(self.topics())), PLANE_FAMILY)

    def stored_messages(self) -> Iterator[tuple[BagChannel, StoredMessage]]:
        """Yield every message of the bag in file order, including those on topics outside of the swarm."""
        channels = self._channels
        for messages in self._stored():
            for message in messages:
                yield channels[message.channel_id], message

    def messages(self, topics: Collection[Topic] | None = None) -> Iterator[tuple[Topic, int, bytes]]:
        """Yield topic, log time in ns and CDR payload of the swarm's messages on some or all topics, in file order.

        Raises
        ------
        UnknownTypeError
            If a message definition is unknown to this version.
        """
        for topic, log_time, _, payload in self.published(topics):
            yield topic, log_time, payload

    def published(self, topics: Collection[Topic] | None = None) -> Iterator[Published]:
        """Yield the swarm's messages on some or all topics, in file order; errors as for `messages`."""
        for of_topics in self.tables(topics):
            yield from of_topics

    def tables(self, topics: Collection[Topic] | None = None) -> Iterator[TopicMessages]:
        """Yield what `published` does, the messages of a chunk at once; errors as for `messages`."""
        wanted = self._wanted(topics)
        for messages in self._stored():
            of_topics = TopicMessages.of(messages, wanted)
            if len(of_topics):
                yield of_topics

    def whole_steps(self, topics: Collection[Topic] | None = None) -> Iterator[Step | Published]:
        """Yield what `published` does, complete steps together where possible; errors as for `messages`."""
        return whole_steps(self.tables(topics), self.family)

    def steps(self) -> Iterator[Step | Record]:
        """Yield what `records` does for all topics, complete steps together where possible; errors as for it."""
        for read in self.whole_steps():
            if isinstance(read, Step):
                yield read
            else:
                yield from self._heard([(read.topic, read.time, read.payload)])

    def records(self, topics: Collection[Topic] | None = None) -> Iterator[Record]:
        """Yield the swarm's messages with canonical bytes, in file order; parameters and errors as for `messages`."""
        return self._heard(self.messages(topics))

    def _heard(self, messages: Iterable[tuple[Topic, int, bytes]]) -> Iterator[Record]:
        return self._each(messages, lambda topic, payload, _: Record.heard(topic, payload))

    def decoded(self, topics: Collection[Topic] | None = None) -> Iterator[tuple[Topic, int, Message]]:
        """Yield topic, log time in ns and message, in file order; parameters and errors as for `messages`."""
        return self.decode(self.messages(topics))

    def decode(self, messages: Iterable[tuple[Topic, int, bytes]]) -> Iterator[tuple[Topic, int, Message]]:
        """Decode what `messages` has yielded; a `DamagedBagError` if a payload does not fit its topic."""
        return self._each(messages, lambda topic, payload, time: (topic, time, decode(topic.message, payload)))

    def _each(
        self, messages: Iterable[tuple[Topic, int, bytes]], read: Callable[[Topic, bytes, int], T]
    ) -> Iterator[T]:
        for topic, log_time, payload in messages:
            try:
                message = read(topic, payload, log_time)
            except MalformedMessageError as error:
                raise DamagedBagError(f"{self.path}: /{topic.name} at {log_time / 1e9:.9g} s: {error}") from error
            yield message

    def _wanted(self, topics: Collection[Topic] | None) -> dict[int, Topic]:
        """Return the topics of the swarm to be read, by channel number."""
        check_definitions(self.path, self._channels.values())
        return {
            number: channel.topic
            for number, channel in self._channels.items()
            if channel.topic is not None and (topics is None or channel.topic in topics)
        }

    def _stored(self) -> Iterator[StoredMessages]:
        for file, numbers in zip(self.files, self._numbers, strict=True):
            for messages in file.stored():
                messages.renumber(numbers)
                yield messages

    def attachment(self, name: str) -> bytes | None:
        """Return the content of the first attachment with a name, or None; errors as for `attachments`."""
        return next(self.attachments(name), None)

    def attachments(self, name: str) -> Iterator[bytes]:
        """Yield the contents of all attachments with a name, file by file."""
        if name in self.supplied:
            yield self.supplied[name]
            return
        for file in self.files:
            yield from file.attachments(name)

    def contradicts_itself(self, name: str) -> bool:
        """Return whether there are different attachments with a name; errors as for `attachments`."""
        return len(set(self.attachments(name))) > 1

    def rosbag2_metadata(self) -> dict[str, Any]:
        """Return rosbag2's description in the last file, which records how the run ended; empty without one."""
        description = load_yaml(self.files[-1].description())
        return description if isinstance(description, dict) else {}

    def custom_data(self) -> dict[str, str]:
        """Return the texts under ``custom_data`` of rosbag2's description; errors as for `rosbag2_metadata`."""
        return custom_texts(self.rosbag2_metadata())

    def aborted(self) -> str | None:
        """Return why the run in the bag ended early, or None."""
        return self.custom_data().get(ABORTED_KEY)

    def check(self) -> None:
        """Read all files and compare them with every CRC and with their summaries."""
        for file in self.files:
            file.check()


def open_bag(
    path: Path | str, *, namespace: str | None = None, damaged: bool = False, several: bool = False
) -> BagReader:
    """Open a bag: a run folder, its ``bag/``, or an MCAP file.

    Parameters
    ----------
    namespace : str, optional
        Which swarm to read if the bag contains several.
    damaged : bool
        Whether to accept a bag without its end, which can be read up to its last intact record.
    several : bool
        Whether to accept a bag of several swarms without a namespace; then no topic belongs to a swarm.

    Raises
    ------
    NotABagError
        If there is nothing, it is not a bag, or it contains no swarm of that name, or several.
    DamagedBagError
        If the end of the bag is missing, with what can still be read.
    """
    place = find_bag(Path(path))
    row = split_files(place.glob(f"*{SUFFIX}")) if place.is_dir() else None
    if row is None:
        file = open_file(place, damaged=damaged)
        bag = BagReader(place, (file,), file.index.problem, namespace)
    else:
        files, problems = _open_row(place, row, damaged=damaged)
        bag = BagReader(place, files, "; ".join(problems) or None, namespace)
    if namespace is None and len(bag.swarms) > 1 and not several:
        raise NotABagError(
            f"{bag.path} contains several swarms; select one with --namespace: {named_swarms(bag.swarms)}"
        )
    _check_compression(bag)
    return bag


def _check_compression(bag: BagReader) -> None:
    """Raise `NotABagError` if messages are compressed individually, which only rosbag2's plugin can read."""
    with suppress(DamagedBagError):
        first = next(bag.stored_messages(), None)
        if first is not None and first[1].payload.startswith(ZSTD_MAGIC):
            raise NotABagError(f"{bag.path} is compressed message by message by rosbag2; {CONVERT}")


def _open_row(folder: Path, row: dict[int, Path], *, damaged: bool) -> tuple[list[BagFile], list[str]]:
    """Open the readable files of a split bag, and return them with the problems; errors as for `open_bag`."""
    problems = missing_files(row)
    if problems and not damaged:
        raise DamagedBagError(f"{folder} is incomplete: {', '.join(problems)}; name one of its files to read only that")
    files = []
    for path in row.values():
        try:
            file = open_file(find_bag(path), damaged=damaged)
        except DamagedBagError as error:
            if not damaged:
                raise
            problems.append(str(error))
        else:
            files.append(file)
            if file.index.problem is not None:
                problems.append(f"{path.name}: {file.index.problem}")
    if not files:
        raise DamagedBagError(problems[0])
    return files, problems


def _merged(indexes: Iterable[FileIndex]) -> tuple[FileIndex, list[dict[int, int]]]:
    """Return the merged index of all files, and for each file the new numbers of its channels."""
    merged = FileIndex()
    assigned: dict[object, int] = {}
    renumbered = []
    for position, index in enumerate(indexes):
        if position == 0:
            merged.header = index.header
        numbers = {own: _number(channel, index, merged, assigned) for own, channel in sorted(index.channels.items())}
        renumbered.append(numbers)
        merged.chunks += index.chunks
        names = {attachment.name for attachment in merged.attachments}
        merged.attachments += [attachment for attachment in index.attachments if attachment.name not in names]
        add_messages(merged.statistics, index.statistics, numbers)
    return merged, renumbered


def _number(channel: Channel, index: FileIndex, merged: FileIndex, assigned: dict[object, int]) -> int:
    """Return the number of a channel in the merged index; add it if it is new."""
    schema = index.schemas.get(channel.schema_id)
    text = (schema.name, schema.encoding, schema.data) if schema is not None else None
    key = (channel.topic, channel.message_encoding, tuple(sorted(channel.metadata.items())), text)
    number = assigned.setdefault(key, channel.id if channel.id not in merged.channels else max(merged.channels) + 1)
    if number not in merged.channels:
        merged.channels[number] = replace(channel, id=number, schema_id=0 if schema is None else number)
        if schema is not None:
            merged.schemas[number] = replace(schema, id=number)
    return number
