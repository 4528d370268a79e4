"""Damage to a bag, drawn from a seed: what disks and transfers do, and what people with bad intentions do."""

from __future__ import annotations

import random
import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from typing import NamedTuple

import lz4.frame
import zstandard
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, ChunkIndex, MetadataIndex

from swarmabs_bag.index import FileIndex, scan_index, tail
from swarmabs_bag.records import Record, RecordError, inner_records, read_records, uncompress

MAGIC = b"\x89MCAP0\r\n"
EXTREMES = (0, 1, 7, 8, 255, 2**15, 2**16 - 1, 2**28, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**63, 2**64 - 1)

HOSTILE_TEXTS: tuple[bytes, ...] = (
    b"",
    b"\xff\xfe\x00",
    b"\0",
    b"[" * 100_000,
    b"{a: " * 5000,
    b"!!python/object/apply:os.system ['exit 1']\n",
    b"!!python/object/new:type {}\n",
    b"schema: 1\nname: !!python/name:os.system\n",
    b"a: &a {x: 1}\n"
    + b"".join(
        b"k%d: &k%d {<<: [*%s, *%s]}\n" % (n, n, p, p)
        for n, p in zip(range(40), [b"a", *(b"k%d" % n for n in range(39))], strict=True)
    ),
    b"a: &a [x, x]\n"
    + b"".join(b"%c: &%c [*%c, *%c]\n" % (c + 1, c + 1, c, c) for c in range(97, 121))
    + b"custom_data: {swarmabs.aborted: *y}\n",
    b"custom_data: {swarmabs.aborted: 0x" + b"f" * 20_000 + b"}\n",
    b"custom_data: {swarmabs.aborted: " + b"9" * 20_000 + b"}\n",
    b"- {reliability: 0x" + b"f" * 20_000 + b", depth: [[[]]]}\n",
    b"1: 2\n? [a, b]\n: c\n",
    b"&a [*a]\n",
    b"custom_data: [1, 2]\n",
    b"2000-99-99\n",
    b"schema: 1\nduration: 1e308\nswarm: {generate: {count: 999999999999}}\n",
    b"schema: 1\nschema: 1\n",
    b'{"versions": {"a": "\\ud800"}, "libm_fingerprint": "\\u001b[2J\\n"}',
    b'{"versions": {"a": 1e999, "b": [[[]]]}, "libm_fingerprint": {}}',
    b'{"versions": ' + b"[" * 50_000,
    b"9" * 10_000,
    b"x" * 2**21,
)
"""Contents for whatever is read as text: YAML, JSON, names."""


class Damage(NamedTuple):
    """A damaged bag.

    Attributes
    ----------
    name : str
        What was done.
    data : bytes
        The file.
    sealed : bool
        Whether all CRCs, lengths and places were made right again, so that the reader cannot notice.
    """

    name: str
    data: bytes
    sealed: bool


def damage(bag: bytes, seed: int) -> Damage:
    """Return the bag with the damage of a seed."""
    generator = random.Random(seed)
    if generator.random() < 0.4:
        blind = generator.choice(BLIND)
        data = bytearray(bag)
        for _ in range(generator.choice((1, 1, 1, 2, 5))):
            if data:
                blind(data, generator)
        return Damage(blind.__name__, bytes(data), sealed=False)
    deliberate = generator.choice(DELIBERATE)
    return Damage(deliberate.__name__, deliberate(bag, generator), sealed=True)


# What happens to files: nobody repairs a CRC


def flip_bits(data: bytearray, generator: random.Random) -> None:
    for _ in range(generator.choice((1, 1, 2, 30))):
        data[generator.randrange(len(data))] ^= 1 << generator.randrange(8)


def overwrite(data: bytearray, generator: random.Random) -> None:
    begin, length = generator.randrange(len(data)), generator.choice((1, 4, 8, 512, 4096))
    length = min(length, len(data) - begin)
    data[begin : begin + length] = generator.choice((bytes(length), b"\xff" * length, generator.randbytes(length)))


def cut(data: bytearray, generator: random.Random) -> None:
    del data[generator.randrange(len(data)) :]
    data += bytes(generator.choice((0, 0, 8, 4096)))


def remove(data: bytearray, generator: random.Random) -> None:
    begin = generator.randrange(len(data))
    del data[begin : begin + generator.choice((1, 9, 100, 4096))]


def repeat(data: bytearray, generator: random.Random) -> None:
    begin, place = generator.randrange(len(data)), generator.randrange(len(data))
    data[place:place] = data[begin : begin + generator.choice((1, 9, 100, 4096))]


def change_head(data: bytearray, generator: random.Random) -> None:
    """Change kind or length of a record."""
    begin = generator.choice(list(_places(bytes(data))) or [0])
    if generator.random() < 0.5:
        data[begin : begin + 1] = bytes([generator.choice((*range(17), 0x7F, 0x80, 0xFF))])
    else:
        data[begin + 1 : begin + 9] = struct.pack("<Q", generator.choice(EXTREMES))


def double_record(data: bytearray, generator: random.Random) -> None:
    places = list(_places(bytes(data)))
    if len(places) > 1:
        number = generator.randrange(len(places) - 1)
        begin, end = places[number], places[number + 1]
        data[begin:begin] = data[begin:end]


def drop_record(data: bytearray, generator: random.Random) -> None:
    places = list(_places(bytes(data)))
    if len(places) > 1:
        number = generator.randrange(len(places) - 1)
        del data[places[number] : places[number + 1]]


def double_end(data: bytearray, generator: random.Random) -> None:
    """Write the last bytes, such as the footer, once more."""
    data += data[-generator.choice((8, 37, 300)) :]


def join(data: bytearray, _: random.Random) -> None:
    data += bytes(data)


Blind = Callable[[bytearray, random.Random], None]
BLIND: tuple[Blind, ...] = (
    flip_bits, flip_bits, overwrite, cut, remove, repeat, change_head, change_head, double_record, drop_record,
    double_end, join,
)  # fmt: skip


def _places(data: bytes) -> Iterator[int]:
    """Yield where the records begin, as far as they are whole."""
    begin = len(MAGIC)
    while begin + 9 <= len(data) - len(MAGIC):
        yield begin
        (length,) = struct.unpack_from("<Q", data, begin + 1)
        begin += 9 + length


# What somebody writes on purpose: whatever can be made right again, is


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: bytes) -> bytes:
    return struct.pack("<I", len(value)) + value


def chunk(
    data: bytes,
    compression: str = "zstd",
    *,
    size: int | None = None,
    crc: int | None = None,
    times: tuple[int, int] = (0, 2**40),
) -> bytes:
    packed = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}.get(compression, bytes)(data)
    said = (len(data) if size is None else size, zlib.crc32(data) if crc is None else crc)
    head = struct.pack("<QQQI", *times, *said)
    return record(Opcode.CHUNK, head + text(compression.encode()) + struct.pack("<Q", len(packed)) + packed)


def sealed(section: bytes, change: Callable[[FileIndex], None] = lambda _: None) -> bytes:
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


def split(bag: bytes) -> list[Record]:
    """Return the records of the data section."""
    return [r for r in read_records(BytesIO(bag), len(MAGIC), len(bag)) if r.opcode != Opcode.DATA_END]


def joined(records: list[Record]) -> bytes:
    return MAGIC + b"".join(record(r.opcode, r.content) for r in records)


def lie_about_places(bag: bytes, generator: random.Random) -> bytes:
    section = joined(split(bag))
    values = (*EXTREMES, len(section), len(bag), len(bag) - 37, len(section) + 13, 8)

    def change(index: FileIndex) -> None:
        for _ in range(generator.randrange(1, 4)):
            entry = generator.choice([*index.chunks, *index.attachments, *index.metadata])
            names = {
                ChunkIndex: ("chunk_start_offset", "chunk_length", "compressed_size", "uncompressed_size"),
                AttachmentIndex: ("offset", "length", "data_size", "log_time"),
                MetadataIndex: ("offset", "length"),
            }[type(entry)]
            setattr(entry, generator.choice(names), generator.choice(values))

    return sealed(section, change)


def swap_names(bag: bytes, _: random.Random) -> bytes:
    def change(index: FileIndex) -> None:
        for entry in index.attachments:
            entry.name = "scenario.yaml"
        index.attachments.reverse()

    return sealed(joined(split(bag)), change)


def lie_about_numbers(bag: bytes, generator: random.Random) -> bytes:
    def change(index: FileIndex) -> None:
        name = generator.choice(("message_count", "message_start_time", "message_end_time", "chunk_count", "each"))
        value = generator.choice(EXTREMES)
        if name == "each":
            index.statistics.channel_message_counts[generator.choice((1, 6, 77, 65535))] = value
        else:
            setattr(index.statistics, name, value)

    return sealed(joined(split(bag)), change)


def change_footer(bag: bytes, generator: random.Random) -> bytes:
    start = generator.choice((*EXTREMES, len(bag) - 37, len(bag), len(bag) // 2))
    return bag[:-28] + struct.pack("<QQI", start, generator.choice(EXTREMES), 0) + MAGIC


def change_summary(bag: bytes, generator: random.Random) -> bytes:
    """Change a byte or a length of the summary section and its CRC accordingly."""
    start, offsets, _ = struct.unpack("<QQI", bag[-28:-8])
    data = bytearray(bag)
    place = generator.randrange(start, len(bag) - 37)
    if generator.random() < 0.5:
        data[place] = generator.randrange(256)
    else:
        data[place : place + 8] = struct.pack("<Q", generator.choice(EXTREMES))
    data[-12:-8] = struct.pack("<I", zlib.crc32(bytes(data[start:-12])))
    assert len(data) == len(bag)
    assert offsets <= len(bag)
    return bytes(data)


def order_chunks(bag: bytes, generator: random.Random) -> bytes:
    records = split(bag)
    places = [number for number, r in enumerate(records) if r.opcode == Opcode.CHUNK]
    one, other = generator.choice(places), generator.choice(places)
    kind = generator.randrange(3)
    if kind == 0:
        records[one], records[other] = records[other], records[one]
    elif kind == 1:
        records.insert(one, records[other])
    else:
        del records[one]
    return sealed(joined(records))


def change_inner(bag: bytes, generator: random.Random) -> bytes:
    """Change the records within a chunk."""
    records = split(bag)
    number = generator.choice([number for number, r in enumerate(records) if r.opcode == Opcode.CHUNK])
    data = uncompress(records[number])
    inner = [(opcode, bytearray(data[begin:end])) for opcode, begin, end in inner_records(data, 0)]
    for _ in range(generator.choice((1, 1, 4))):
        place = generator.randrange(len(inner))
        content = inner[place][1]
        kind = generator.randrange(6)
        if kind == 0:
            inner[place] = (generator.choice((*range(1, 17), 0x80)), content)
        elif kind == 1:
            del content[generator.randrange(len(content) + 1) :]
        elif kind == 2:
            content += generator.randbytes(generator.choice((1, 3, 8, 1000)))
        elif kind == 3 and len(content) > 30:
            begin = generator.choice((0, 2, 6, 14, 22, *range(22, len(content) - 8)))
            content[begin : begin + 8] = struct.pack("<Q", generator.choice(EXTREMES))
        elif kind == 4:
            del inner[place]
        else:
            inner.insert(place, inner[generator.randrange(len(inner))])
        if not inner:
            break
    made = b"".join(record(opcode, bytes(content)) for opcode, content in inner)
    end = generator.choice((b"", b"", b"\x05", b"\x05" + b"\xff" * 8))
    made = chunk(made + end, generator.choice(("zstd", "zstd", "lz4", "")), crc=generator.choice((None, 0)))
    return sealed(joined(records[:number]) + made + joined(records[number + 1 :])[len(MAGIC) :])


def bomb(bag: bytes, generator: random.Random) -> bytes:
    """Put in a chunk that is much larger than it looks."""
    size = generator.choice((2**20, 2**24, 2**25))
    unit = generator.choice((b"\0", record(0x80, b""), record(Opcode.MESSAGE, bytes(22))))
    filling = unit * (size // len(unit))
    stated = generator.choice((None, 100, 2**28, 2**40))
    made = chunk(filling, generator.choice(("zstd", "lz4")), size=stated, crc=0)
    if generator.random() < 0.3:
        made = chunk(made, "zstd")
    head, *rest = split(bag)
    return sealed(joined([head]) + made * generator.choice((1, 1, 3)) + joined(rest)[len(MAGIC) :])


def define(bag: bytes, generator: random.Random) -> bytes:
    """Put in schemas and channels with names that hurt."""
    names = (
        b"",
        b"/plane/state",
        b"/a\n\x1b[2J/plane/state",
        b"/" + b"x" * 10_000 + b"/plane/state",
        b"\xff",
        b"[red]/",
    )
    made = b""
    for number in range(generator.choice((1, 2, 300))):
        schema = generator.choice((0, 1, 2, 65535))
        if generator.random() < 0.5:
            kind = generator.choice((b"swarmabs_msgs/msg/PlaneState", b"", b"\xc3"))
            made += record(
                Opcode.SCHEMA, struct.pack("<H", schema) + text(kind) + text(b"ros1msg") + text(b"float64 x")
            )
        metadata = text(b"offered_qos_profiles") + text(generator.choice(HOSTILE_TEXTS)[:100_000])
        content = struct.pack("<HH", generator.choice((1, 2, 7, 7 + number)), schema) + text(generator.choice(names))
        made += record(Opcode.CHANNEL, content + text(generator.choice((b"cdr", b"", b"json"))) + text(metadata))
    if generator.random() < 0.3:
        made = chunk(made)
    return sealed(joined(split(bag)) + made)


def change_texts(bag: bytes, generator: random.Random) -> bytes:
    """Replace the content of what is read as text."""
    records = [r for r in split(bag) if r.opcode not in {Opcode.ATTACHMENT, Opcode.METADATA}]
    made = b""
    for name in (b"scenario.yaml", b"provenance.json", b"\x1b[2J\n" * 100):
        data = generator.choice(HOSTILE_TEXTS)
        content = bytes(16) + text(name) + text(b"text/plain") + struct.pack("<Q", len(data)) + data
        made += record(Opcode.ATTACHMENT, content + struct.pack("<I", zlib.crc32(content)))
    pair = text(b"serialized_metadata") + text(generator.choice(HOSTILE_TEXTS))
    made += record(Opcode.METADATA, text(b"rosbag2") + text(pair))
    return sealed(joined(records) + made)


def put_in(bag: bytes, generator: random.Random) -> bytes:
    """Put a strange record between the others."""
    records = split(bag)
    data = generator.choice((b"", bytes(4), generator.randbytes(60), struct.pack("<Q", 2**63) * 6, b"\xff" * 60))
    number = generator.randrange(len(records) + 1)
    strange = record(generator.choice((*range(1, 17), 0x7F, 0x80, 0xFF)), data)
    return sealed(joined(records[:number]) + strange + joined(records[number:])[len(MAGIC) :])


Deliberate = Callable[[bytes, random.Random], bytes]
DELIBERATE: tuple[Deliberate, ...] = (
    lie_about_places, swap_names, lie_about_numbers, change_footer, change_summary, change_summary, order_chunks,
    change_inner, change_inner, change_inner, bomb, define, change_texts, put_in,
)  # fmt: skip
