"""MCAP files made by hand, record by record, also such as no writer makes, and bags as other programs write them."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import lz4.frame
import zstandard
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import Writer

from swarmabs_bag.mcap.index import FileIndex, scan_index, tail
from swarmabs_bag.mcap.records import Record, RecordError, read_records

if TYPE_CHECKING:
    from typing_extensions import Self

MAGIC = b"\x89MCAP0\r\n"


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: bytes) -> bytes:
    return struct.pack("<I", len(value)) + value


HEADER = record(Opcode.HEADER, text(b"ros2") + text(b""))


def message(channel: int = 1, data: bytes = b"data", time: int = 0) -> bytes:
    return record(Opcode.MESSAGE, struct.pack("<HIQQ", channel, 0, time, time) + data)


def schema(number: int, name: bytes, *, reaching: int = 0) -> bytes:
    """Return a schema whose last field says to be longer than it is."""
    last = struct.pack("<I", 8 + reaching) + b"8" * 8
    return record(Opcode.SCHEMA, struct.pack("<H", number) + text(name) + text(b"ros2msg") + last)


def channel(number: int, of_schema: int, topic: bytes) -> bytes:
    return record(Opcode.CHANNEL, struct.pack("<HH", number, of_schema) + text(topic) + text(b"cdr") + text(b""))


def attachment(name: bytes, data: bytes) -> bytes:
    content = bytes(16) + text(name) + text(b"") + struct.pack("<Q", len(data)) + data
    return record(Opcode.ATTACHMENT, content + struct.pack("<I", zlib.crc32(content)))


def described(metadata: bytes) -> bytes:
    """Return rosbag2's description with this text."""
    return record(Opcode.METADATA, text(b"rosbag2") + text(text(b"serialized_metadata") + text(metadata)))


def chunk(
    data: bytes,
    compression: str = "zstd",
    *,
    size: int | None = None,
    crc: int | None = None,
    times: tuple[int, int] = (0, 2**40),
) -> bytes:
    """Return a chunk, which may say to hold something else."""
    packed = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}.get(compression, bytes)(data)
    said = (len(data) if size is None else size, zlib.crc32(data) if crc is None else crc)
    head = struct.pack("<QQQI", *times, *said)
    return record(Opcode.CHUNK, head + text(compression.encode()) + struct.pack("<Q", len(packed)) + packed)


def inner_records(data: bytes) -> list[tuple[int, bytes]]:
    """Return opcode and content of each record in the content of a chunk."""
    records, position = [], 0
    while position < len(data):
        opcode, length = struct.unpack_from("<BQ", data, position)
        records.append((opcode, data[position + 9 : position + 9 + length]))
        position += 9 + length
    return records


def split(bag: bytes) -> list[Record]:
    """Return the records of the data section."""
    return [found for found in read_records(BytesIO(bag), len(MAGIC), len(bag)) if found.opcode != Opcode.DATA_END]


def joined(records: list[Record]) -> bytes:
    return MAGIC + b"".join(found.stored for found in records)


def sealed(section: bytes, change: Callable[[FileIndex], object] = lambda _: None) -> bytes:
    """Return a file with this data section and the end that belongs to it, which may then be changed."""
    try:
        index = scan_index(BytesIO(section), len(section))
    except RecordError:
        return section
    end = len(section)
    index.data_end, index.crc = end, zlib.crc32(section)
    change(index)
    index.data_end = end
    try:
        return section + b"".join(tail(index))
    except (struct.error, OverflowError):  # a number that does not fit into the summary
        return section


class Recorded:
    """A bag of another program; options are those of the library's writer."""

    def __init__(self, path: Path, **options: Any) -> None:
        self._stream: IO[bytes] = path.open("wb")
        self.writer = Writer(self._stream, **options)
        self.writer.start("ros2", "somebody else")

    def channel(self, topic: str, ros_type: str = "std_msgs/msg/String", encoding: str = "cdr", **metadata: str) -> int:
        schema = self.writer.register_schema(ros_type, "ros2msg", b"string data")
        return self.writer.register_channel(topic, encoding, schema, metadata)

    def message(self, channel: int, data: bytes, time: int = 0) -> None:
        self.writer.add_message(channel, time, data, time)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.writer.finish()
        self._stream.close()


def rewritten(
    bag: Path,
    path: Path,
    change: Callable[[str, bytes], bytes] = lambda _, data: data,
    *,
    attachments: bool = True,
    **options: Any,
) -> Path:
    """Write a whole bag once more, with chunks of the same size; the bytes of a topic's messages may be changed."""
    with (
        (bag / "bag_0.mcap").open("rb") as stream,
        Recorded(path, chunk_size=4000, **({"enable_data_crcs": True} | options)) as made,
    ):
        reader, writer = make_reader(stream), made.writer
        channels: dict[int, int] = {}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            if channel.id not in channels:
                assert schema is not None
                known = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, known, channel.metadata
                )
            number, data = channels[channel.id], change(channel.topic, message.data)
            writer.add_message(number, message.log_time, data, message.publish_time, message.sequence)
        for one in reader.iter_attachments() if attachments else ():
            writer.add_attachment(one.create_time, one.log_time, one.name, one.media_type, one.data)
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
    return path
