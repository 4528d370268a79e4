"""Reading bags: file order, bounded memory, and every length, CRC and type checked on the way.

A bag is read from its MCAP file alone; ``metadata.yaml`` is a copy for rosbag2. What is not as the format
says raises `DamagedBagError` with its position in the file, and never anything else.
"""

from __future__ import annotations

import math
import stat
import zlib
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcap.opcode import Opcode
from mcap.records import DataEnd, Metadata as MetadataRecord, Statistics

from swarmabs_bag.definitions import check_definitions
from swarmabs_bag.errors import DamagedBagError, NotABagError
from swarmabs_bag.index import FileIndex, read_attachment, read_index, scan_index
from swarmabs_bag.metadata import ABORTED_KEY, RECORD_KEY, RECORD_NAME
from swarmabs_bag.records import (
    MAGIC,
    Record,
    RecordError,
    StoredMessage,
    crc_with,
    inner_records,
    parse,
    read_message,
    read_record,
    read_records,
    uncompress,
)
from swarmabs_bag.swarms import chosen_swarm, named_swarms, ros_type, swarm_topics
from swarmabs_config.scenario.errors import ScenarioError, show
from swarmabs_config.scenario.yaml_tree import read_tree
from swarmabs_core.cdr import decode
from swarmabs_core.errors import MalformedMessageError

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping
    from typing import BinaryIO

    from swarmabs_core.messages import Message, Topic

_SUFFIX = ".mcap"
_LONGEST_YAML = 2**20


@dataclass(frozen=True, slots=True)
class BagChannel:
    """A topic as a bag holds it.

    Attributes
    ----------
    name : str
        Topic with namespace.
    ros_type : str
        Full ROS name of the message type.
    type_hash : str
        RIHS01 hash of the type, empty if the bag does not give it.
    qos_profiles : str
        YAML text of what the publishers offered, empty if the bag does not give it.
    encoding : str
        Encoding of the messages, ``cdr`` in bags of ROS 2.
    message_count : int
        Number of messages.
    topic : Topic or None
        Which topic of the swarm it is, None if it is another one.
    """

    name: str
    ros_type: str
    type_hash: str
    qos_profiles: str
    encoding: str
    message_count: int
    topic: Topic | None


class BagReader:
    """A bag, open for reading; made by `open_bag`.

    Nothing stays open between calls, and several iterations may go on at once.

    Attributes
    ----------
    path : Path
        The MCAP file, or the folder of a split bag.
    size : int
        Its size in bytes.
    index : FileIndex
        What the file says it holds.
    channels : tuple of BagChannel
        Its topics in the order of their ids.
    swarms : tuple of str
        Namespaces of all swarms in it, with their last slash.
    namespace : str or None
        Namespace of the swarm that is read, None if there is no topic of one, or none of several was chosen.
    """

    def __init__(self, path: Path, size: int, index: FileIndex, namespace: str | None) -> None:
        self.path = path
        self.size = size
        self.index = index
        topics = swarm_topics(index)
        self.swarms = tuple(sorted({swarm for swarm, _ in topics.values()}))
        self._channels = _describe(index, topics, chosen_swarm(path, self.swarms, namespace))
        self.channels = tuple(self._channels.values())
        self.namespace = next(
            (channel.name.removesuffix(channel.topic.name) for channel in self.channels if channel.topic),
            None,
        )

    @property
    def problem(self) -> str | None:
        """Why the file has no end, if it was opened with ``damaged=True``; None for a complete one."""
        return self.index.problem

    @property
    def start(self) -> int:
        """Log time of the first message in ns, 0 without messages."""
        return self.index.statistics.message_start_time

    @property
    def end(self) -> int:
        """Log time of the last message in ns, 0 without messages."""
        return self.index.statistics.message_end_time

    @property
    def message_count(self) -> int:
        """Number of messages on all topics."""
        return self.index.statistics.message_count

    def topics(self) -> tuple[Topic, ...]:
        """Return the topics of the swarm that the bag has."""
        return tuple(channel.topic for channel in self.channels if channel.topic is not None)

    def stored_messages(self) -> Iterator[tuple[BagChannel, StoredMessage]]:
        """Yield every message of the file in file order, also those on topics that are not of the swarm.

        Raises
        ------
        DamagedBagError
            Where the file is damaged; all before it has been yielded then.
        """
        channels = self._channels
        for message in self._stored():
            yield channels[message.channel_id], message

    def messages(self, topics: Collection[Topic] | None = None) -> Iterator[tuple[Topic, int, bytes]]:
        """Yield topic, log time in ns and CDR payload of the swarm's messages, in file order.

        Parameters
        ----------
        topics : collection of Topic, optional
            Those to yield; by default all of the swarm.

        Raises
        ------
        DamagedBagError
            Where the file is damaged; all before it has been yielded then.
        UnknownTypeError
            If messages have a definition that this version does not know.
        """
        wanted = self._wanted(topics)
        for message in self._stored():
            topic = wanted.get(message.channel_id)
            if topic is not None:
                yield topic, message.log_time, message.payload

    def published(self, topics: Collection[Topic]) -> Iterator[tuple[Topic, int, int, bytes]]:
        """Yield topic, log time and publish time in ns, and payload; parameters and errors as of `messages`."""
        wanted = self._wanted(topics)
        for message in self._stored():
            topic = wanted.get(message.channel_id)
            if topic is not None:
                yield topic, message.log_time, message.publish_time, message.payload

    def _wanted(self, topics: Collection[Topic] | None) -> dict[int, Topic]:
        """Return the topics of the swarm to be read, by the numbers of their channels."""
        check_definitions(self.path, self._channels.values())
        return {
            number: channel.topic
            for number, channel in self._channels.items()
            if channel.topic is not None and (topics is None or channel.topic in topics)
        }

    def decoded(self, topics: Collection[Topic] | None = None) -> Iterator[tuple[Topic, int, Message]]:
        """Yield topic, log time in ns and message, in file order; parameters and errors as of `messages`."""
        for topic, log_time, payload in self.messages(topics):
            try:
                message = decode(topic.message, payload)
            except MalformedMessageError as error:
                raise DamagedBagError(f"{self.path}: /{topic.name} at {log_time / 1e9:.9g} s: {error}") from error
            yield topic, log_time, message

    def attachment_names(self) -> tuple[str, ...]:
        """Return the names of all attachments in file order."""
        return tuple(attachment.name for attachment in self.index.attachments)

    def attachment(self, name: str) -> bytes | None:
        """Return the content of the first attachment of a name, None if there is none; errors as of `attachments`."""
        return next(self.attachments(name), None)

    def attachments(self, name: str) -> Iterator[bytes]:
        """Yield the contents of all attachments of a name, in file order.

        Raises
        ------
        DamagedBagError
            If one is not where the bag says, or its CRC does not match.
        """
        for entry in self.index.attachments:
            if entry.name == name:
                with self._opened() as stream:
                    attachment = read_attachment(read_record(stream, entry.offset, self.size))
                    if attachment.name != name:
                        raise RecordError(entry.offset, f"the attachment here is not {show(name)}, as the summary says")
                yield attachment.data

    def contradicts_itself(self, name: str) -> bool:
        """Tell whether there are different attachments of a name; errors as of `attachments`."""
        return len(set(self.attachments(name))) > 1

    def rosbag2_metadata(self) -> dict[str, Any]:
        """Return rosbag2's description of the bag from within the file, empty if it has none.

        Raises
        ------
        DamagedBagError
            If it is not where the bag says.
        """
        for entry in reversed(self.index.metadata):  # rosbag2 writes one at opening, too
            if entry.name == RECORD_NAME:
                with self._opened() as stream:
                    record: MetadataRecord = parse(MetadataRecord, read_record(stream, entry.offset, self.size))
                found = load_yaml(record.metadata.get(RECORD_KEY, ""))
                return found if isinstance(found, dict) else {}
        return {}

    def aborted(self) -> str | None:
        """Return why the bag ends before its run was over, None if it does not."""
        custom = self.rosbag2_metadata().get("custom_data")
        reason = custom.get(ABORTED_KEY) if isinstance(custom, dict) else None
        return reason if isinstance(reason, str) else None

    def check(self) -> None:
        """Read the whole file and compare it with every CRC and with what its summary says.

        Raises
        ------
        DamagedBagError
            At the first contradiction.
        """
        with self._opened() as stream:
            found = scan_index(stream, self.size)
            if found.problem is not None:
                raise DamagedBagError(f"{self.path}: {found.problem}{_readable(found)}")
            _check_crc(read_record(stream, found.data_end, self.size), found.crc)
        counted, said = _numbers(found.statistics), _numbers(self.index.statistics)
        for name in {**counted, **said}:
            number, stated_number = counted.get(name, 0), said.get(name, 0)
            if stated_number != number:
                raise DamagedBagError(_miscounted(self.path, name, stated_number, str(number)))

    @contextmanager
    def _opened(self) -> Iterator[BinaryIO]:
        try:
            with self.path.open("rb") as stream:
                yield stream
        except RecordError as error:
            raise DamagedBagError(f"{self.path}: {error}") from error
        except OSError as error:
            raise DamagedBagError(f"{self.path} cannot be read: {error.strerror or error}") from error

    def _stored(self) -> Iterator[StoredMessage]:
        latest = count = 0
        most = math.inf if self.problem else self.message_count
        try:
            with self.path.open("rb") as stream:
                for message in _stored_messages(stream, self.index):
                    if message.channel_id not in self._channels:
                        raise RecordError(  # noqa: TRY301 - one place adds the file's name
                            self.index.data_end,
                            f"channel {message.channel_id} of a message is not in the summary",
                        )
                    latest = message.log_time
                    count += 1
                    if count > most:
                        break
                    yield message
        except RecordError as error:
            raise DamagedBagError(
                f"{self.path}: {error}; the messages before it, up to {latest / 1e9:.9g} s, can be read"
            ) from error
        except OSError as error:
            raise DamagedBagError(f"{self.path} cannot be read: {error.strerror or error}") from error
        if self.problem is None and count != self.message_count:
            counted = f"at least {count}" if count > most else str(count)
            raise DamagedBagError(_miscounted(self.path, "message_count", self.message_count, counted))


def open_bag(
    path: Path | str, *, namespace: str | None = None, damaged: bool = False, several: bool = False
) -> BagReader:
    """Open a bag.

    Parameters
    ----------
    path : Path or str
        A run folder, its ``bag/``, or an MCAP file.
    namespace : str, optional
        Which swarm to read if the bag holds several.
    damaged : bool
        Whether a bag without its end is opened too, to be read as far as its records are whole.
    several : bool
        Whether a bag of several swarms is opened too if none of them is named; no topic is then that of a swarm.

    Raises
    ------
    NotABagError
        If there is nothing, or something that is no bag, or it has no swarm of that name, or several.
    DamagedBagError
        If the bag has lost its end; the text says what can still be read.
    """
    from swarmabs_bag.split_reader import open_split, split_files  # noqa: PLC0415 - builds upon this one

    file = find_bag(Path(path))
    if file.is_dir() and (files := split_files(file.glob(f"*{_SUFFIX}"))) is not None:
        bag: BagReader = open_split(file, files, namespace=namespace, damaged=damaged)
    else:
        bag = _open_file(file, namespace, damaged=damaged)
    if namespace is None and len(bag.swarms) > 1 and not several:
        raise NotABagError(f"{bag.path} holds several swarms: choose one with --namespace: {named_swarms(bag.swarms)}")
    return bag


def _open_file(file: Path, namespace: str | None, *, damaged: bool) -> BagReader:
    try:
        with file.open("rb") as stream:
            size = stream.seek(0, 2)
            stream.seek(0)
            magic = stream.read(len(MAGIC))
            if not MAGIC.startswith(magic):
                raise NotABagError(f"{file} is not a bag: it does not begin as an MCAP file")
            if len(magic) < len(MAGIC):
                raise DamagedBagError(f"{file} has only {size} bytes: nothing was written into it")
            index = _index(file, stream, size, damaged=damaged)
    except OSError as error:
        raise NotABagError(f"cannot read {file}: {error.strerror or error}") from error
    except RecordError as error:
        raise DamagedBagError(f"{file}: {error}; nothing can be read") from error
    return BagReader(file, size, index, namespace)


def find_bag(path: Path) -> Path:
    """Return the MCAP file of a run folder, of a bag's folder, or the file itself; of a split bag its folder.

    Raises
    ------
    NotABagError
        If there is none, or more than one that do not belong together.
    """
    from swarmabs_bag.split_reader import split_files  # noqa: PLC0415 - builds upon this one

    try:
        mode = path.stat().st_mode
        if stat.S_ISREG(mode):
            return path
        if not stat.S_ISDIR(mode):
            raise _neither(path)
        for folder in (path / "bag", path):
            files = sorted(folder.glob(f"*{_SUFFIX}"))
            if len(files) > 1:
                if split_files(files) is not None:
                    return folder
                raise NotABagError(f"{folder} holds {len(files)} .mcap files: name one of them")
            if files:
                mode = files[0].stat().st_mode
                if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
                    raise _neither(files[0])
                return files[0]
    except (OSError, ValueError) as error:  # ValueError: the path has a NUL
        reason = error.strerror if isinstance(error, OSError) else error
        raise NotABagError(f"cannot read {path}: {reason}; name a run folder, its bag/, or an .mcap file") from error
    raise NotABagError(f"{path} holds no bag: name a run folder, its bag/, or an .mcap file")


def _neither(path: Path) -> NotABagError:
    return NotABagError(f"{path} is neither a folder nor a file: name a run folder, its bag/, or an .mcap file")


def load_yaml(text: str) -> Any:
    """Read YAML from a bag: plain data only; None if it is not YAML, or too long or too deep to be ours."""
    if len(text) > _LONGEST_YAML:
        return None
    try:
        return read_tree(text, "").plain()
    except ScenarioError:
        return None


def _index(file: Path, stream: BinaryIO, size: int, *, damaged: bool) -> FileIndex:
    try:
        return read_index(stream, size)
    except RecordError as error:
        found = scan_index(stream, size)
        found.problem = found.problem or str(error)
        if damaged:
            return found
        raise DamagedBagError(
            f"{file} is incomplete: {found.problem}{_readable(found)}; repair saves what can be saved"
        ) from error


def _miscounted(path: Path, name: str, said: int, counted: str) -> str:
    return f"{path}: the summary says {name} = {said}, but it is {counted}"


def _readable(index: FileIndex) -> str:
    count, end = index.statistics.message_count, index.statistics.message_end_time
    return (
        f"; {count} messages before it, up to {end / 1e9:.9g} s, can be read" if count else "; no message can be read"
    )


def _numbers(statistics: Statistics) -> dict[str, int]:
    return {
        "message_count": statistics.message_count,
        "message_start_time": statistics.message_start_time,
        "message_end_time": statistics.message_end_time,
        "chunk_count": statistics.chunk_count,
        **{
            f"messages of channel {channel}": count
            for channel, count in sorted(statistics.channel_message_counts.items())
            if count
        },
    }


def _check_crc(end: Record, crc: int) -> None:
    """Compare the CRC of the data section with what its end says."""
    stated: DataEnd = parse(DataEnd, end)
    if stated.data_section_crc not in {0, crc}:
        raise RecordError(
            end.offset, f"CRC of the data section is {crc:#010x}, but the file says {stated.data_section_crc:#010x}"
        )


def _stored_messages(stream: BinaryIO, index: FileIndex) -> Iterator[StoredMessage]:
    if index.data_end <= len(MAGIC):
        return
    crc = zlib.crc32(MAGIC)
    # A damaged bag ends at data_end; a complete one has a DataEnd record there, which ends the loop.
    for record in read_records(stream, len(MAGIC), index.data_end if index.problem else stream.seek(0, 2)):
        if record.opcode == Opcode.CHUNK:
            data = uncompress(record)
            for opcode, begin, end in inner_records(data, record.offset):
                if opcode == Opcode.MESSAGE:
                    yield read_message(data, begin, end, record.offset)
        elif record.opcode == Opcode.MESSAGE:
            yield read_message(record.content, 0, len(record.content), record.offset)
        elif record.opcode == Opcode.DATA_END:
            _check_crc(record, crc)
        crc = crc_with(crc, record)
        if index.problem and record.end >= index.data_end:
            return


def _describe(index: FileIndex, topics: Mapping[int, tuple[str, Topic]], chosen: str | None) -> dict[int, BagChannel]:
    counts = index.statistics.channel_message_counts
    return {
        number: BagChannel(
            name=channel.topic,
            ros_type=ros_type(channel, index),
            type_hash=channel.metadata.get("topic_type_hash", ""),
            qos_profiles=channel.metadata.get("offered_qos_profiles", ""),
            encoding=channel.message_encoding,
            message_count=counts.get(number, 0),
            topic=topics[number][1] if number in topics and topics[number][0] == chosen else None,
        )
        for number, channel in sorted(index.channels.items())
    }
