"""Damage to a bag, drawn at random: what disks and transfers do, and what people with bad intentions do.

These also make up messages, topics and texts, in files that are as the format says.
"""

import os
import random
import struct
import zlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Message, MessageIndex, Metadata, Schema
from mcap.stream_reader import StreamReader
from tests.swarmabs_bag.mcap_files import MAGIC, chunk, inner_records, record, sealed, split

from swarmabs_bag.mcap.records import RecordError, encoded, read_records, uncompress
from swarmabs_bag.run.metadata import load_yaml
from swarmabs_core.arrays import LAYOUT
from swarmabs_core.cdr import encode
from swarmabs_core.messages import EVENTS, MAIN_TOPICS, SwarmEvent

EXTREMES = (0, 1, 7, 8, 255, 2**15, 2**16 - 1, 2**28, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**63, 2**64 - 1)
NUMBERS = (float("nan"), float("inf"), float("-inf"), -0.0, 1.0, -1.0, 5e-324, 1e9, -1e99, 1e101, 1e200, -1.7e308)
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
    b'{"versions": {"a": "\\ud800"}, "arithmetic": "\\u001b[2J\\n"}',
    b'{"versions": {"a": 1e999, "b": [[[]]]}, "arithmetic": {}}',
    b'{"versions": ' + b"[" * 50_000,
    b"9" * 10_000,
    b"x" * 2**21,
)
"""Contents for whatever is read as text: YAML, JSON, names."""

TEXTS = (
    *(found.decode() for found in HOSTILE_TEXTS if len(found) < 2**17 and found.isascii()),
    "<script>alert(1)</script><img src=x onerror=alert(1)>",
    "\x1b]0;x\x07\x1b[31m[red]{0}%s$x$\\",
    "\u202e\u2028\U0001f916\0 größer",
    "interrupted\nerror: x",
    "- {history: 99, depth: -1, reliability: [], durability: {}, deadline: {sec: -1, nsec: 99999999999}, x: 1}\n" * 2,
    '{"driver": "realtime", "replay": {"of": 7, "nodes": {"a": 1}}, "versions": {"\\n": "\\n\\u001b", "python": 3}}',
    *("/plane/state", "/swarm/abstract_state", "/lab/plane/state", "//plane/state", "/", "json", "ros1msg"),
    *("swarmabs_msgs/msg/PlaneState", "float64 x\nint32[9999999999] y", "scenario.yaml", "provenance.json", "../../x"),
)
"""Texts for whatever names something or is shown to people."""


class Damage(NamedTuple):
    """What was done to a bag; `noticeable`: whether bytes of its files differ such that every reader must notice."""

    name: str
    noticeable: bool


def damage_bag(folder: Path, draw: random.Random, forged: float) -> Damage:
    """Damage the bag in a folder; a part of the damages is forged."""
    files = sorted(folder.glob("*.mcap"))
    if draw.random() < 0.1 * len(files):
        change_folder = draw.choice(FOLDERS)
        change_folder(folder, draw)
        return Damage(change_folder.__name__, noticeable=False)
    file = draw.choice(files)
    before = file.read_bytes()
    kind = draw.random()
    if kind < forged:
        name, data = forge(before, draw)
    elif kind < 0.5 + forged / 2:
        change = draw.choice(DELIBERATE)
        name, data = change.__name__, change(before, draw)
    else:
        blind, left = draw.choice(BLIND), bytearray(before)
        for _ in range(draw.choice((1, 1, 1, 2, 5))):
            blind(left, draw)
        name, data = blind.__name__, bytes(left)
    file.write_bytes(data)
    return Damage(name, noticeable=name in {blind.__name__ for blind in BLIND} and data != before)


# What happens to files: nobody repairs a CRC


def flip_bits(data: bytearray, draw: random.Random) -> None:
    for _ in range(draw.choice((1, 1, 2, 30))):
        data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)


def splice(data: bytearray, draw: random.Random) -> None:
    """Overwrite, remove or repeat a whole record, or anything."""
    begin = draw.randrange(len(data))
    begin, end = draw.choice((draw.choice(_records(data)), (begin, begin + draw.choice((1, 9, 100, 4096)))))
    part, size = bytes(data[begin:end]), end - begin
    kind = draw.randrange(3)
    if kind == 0:
        data[begin:end] = draw.choice((bytes(size), b"\xff" * size, draw.randbytes(size)))
    elif kind == 1:
        del data[begin:end]
    else:
        place = draw.choice((begin, draw.randrange(len(data))))
        data[place:place] = part


def cut(data: bytearray, draw: random.Random) -> None:
    del data[draw.randrange(8, len(data)) :]
    data += bytes(draw.choice((0, 0, 8, 4096)))


def change_head(data: bytearray, draw: random.Random) -> None:
    """Change kind or length of a record."""
    begin, _ = draw.choice(_records(data))
    if draw.random() < 0.5:
        data[begin : begin + 1] = bytes([draw.choice((*range(17), 0x7F, 0x80, 0xFF))])
    else:
        data[begin + 1 : begin + 9] = struct.pack("<Q", draw.choice(EXTREMES))


BLIND = (flip_bits, flip_bits, cut, splice, splice, splice, change_head, change_head)


def _records(data: bytearray) -> list[tuple[int, int]]:
    """Return where records begin and end, as far as they are whole."""
    found = [(0, len(MAGIC))]
    with suppress(RecordError):
        found.extend((one.offset, one.end) for one in read_records(BytesIO(data), len(MAGIC), len(data)))
    return found


# What somebody writes on purpose: whatever can be made right again, is


def change_summary(bag: bytes, draw: random.Random) -> bytes:
    """Change a byte or a length of summary section or footer, and the CRC accordingly."""
    (start,) = struct.unpack("<Q", bag[-28:-20])
    data = bytearray(bag)
    if draw.random() < 0.5:
        data[draw.randrange(start, len(bag) - 12)] = draw.randrange(256)
    else:
        place = draw.choice((draw.randrange(start, len(bag) - 37), len(bag) - 28, len(bag) - 20))
        data[place : place + 8] = struct.pack("<Q", draw.choice((*EXTREMES, len(bag) - 37, len(bag) // 2)))
    data[-12:-8] = struct.pack("<I", zlib.crc32(bytes(data[start:-12])))
    return bytes(data)


def change_records(bag: bytes, draw: random.Random) -> bytes:
    """Change, leave out, double or put in records, within a chunk or outside of any."""
    records = [(one.opcode, bytearray(one.content)) for one in split(bag)]
    places = [place for place, (opcode, _) in enumerate(records) if opcode == Opcode.CHUNK]
    if draw.random() < 0.7:
        place = draw.choice(places)
        data = uncompress(split(bag)[place])
        inner = [(opcode, bytearray(content)) for opcode, content in inner_records(data)]
        _change(inner, draw)
        end = draw.choice((b"", b"", b"\x05", b"\x05" + b"\xff" * 8))
        made = chunk(_stored(inner) + end, draw.choice(("zstd", "zstd", "lz4", "")), crc=draw.choice((None, 0)))
        records[place] = (Opcode.CHUNK, bytearray(made[9:]))
    else:
        _change(records, draw)
    return sealed(MAGIC + _stored(records))


def _change(records: list[tuple[int, bytearray]], draw: random.Random) -> None:
    for _ in range(draw.choice((1, 1, 4))):
        place = draw.randrange(len(records))
        opcode, content = records[place]
        kind = draw.randrange(6)
        if kind == 0:
            records[place] = (draw.choice((*range(1, 17), 0x7F, 0x80, 0xFF)), content)
        elif kind == 1:
            del content[draw.randrange(len(content) + 1) :]
        elif kind == 2:
            content += draw.randbytes(draw.choice((1, 3, 8, 1000)))
        elif kind == 3:
            begin = draw.choice((0, 2, 6, 14, 22, draw.randrange(len(content) + 1)))
            content[begin : begin + 8] = struct.pack("<Q", draw.choice(EXTREMES))
        elif kind == 4 and len(records) > 1:
            del records[place]
        else:
            records.insert(draw.randrange(len(records)), (opcode, bytearray(content)))


def _stored(records: list[tuple[int, bytearray]]) -> bytes:
    return b"".join(record(opcode, bytes(content)) for opcode, content in records)


DELIBERATE = (change_summary, change_records, change_records)


# What happens to the files of a bag


def take_away(folder: Path, draw: random.Random) -> None:
    path = draw.choice(sorted(folder.iterdir()))
    os.truncate(path, draw.choice((0, 3, 8, 20, 60)))
    if draw.random() < 0.5:
        path.unlink()


def exchange(folder: Path, draw: random.Random) -> None:
    """Put a file in the place of another or beside it, under a name that may be none of the bag."""
    path, other = (draw.choice(sorted(folder.glob("*.mcap"))) for _ in range(2))
    number = draw.choice(("1", "5", "7", "00", "999999999", "9999999999", "-1", "x", "\u0663"))
    to = folder / draw.choice((other.name, f"bag_{number}.mcap", f"other_{number}.mcap", "bag.mcap", "bag_1.mcap.gz"))
    to.write_bytes(path.read_bytes())
    if draw.random() < 0.5 and to != path:
        path.unlink()


def put_in(folder: Path, draw: random.Random) -> None:
    """Put something else than a file in the place of one."""
    path = folder / draw.choice(("bag_1.mcap", "bag_5.mcap", "metadata.yaml", "bag", "x.mcap"))
    path.unlink(missing_ok=True)
    to = draw.choice(("folder", "pipe", path.name, "bag_0.mcap", "/dev/zero"))
    if to == "folder":
        path.mkdir()
    elif to == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to(to)


def change_yaml(folder: Path, draw: random.Random) -> None:
    """Put another value into metadata.yaml, or something else in its place."""
    path = folder / "metadata.yaml"
    document = load_yaml(path.read_text(encoding="utf-8"))
    replace_value(document, (*EXTREMES, -1, 1.5, None, [], {}, "", "../../etc/passwd", "bag_0.mcap", [[]] * 3), draw)
    path.write_bytes(draw.choice((yaml.safe_dump(document).encode(), draw.choice(HOSTILE_TEXTS))))


FOLDERS = (take_away, exchange, put_in, put_in, change_yaml, change_yaml)


# Bags that are as the format says, but whose messages, topics and texts somebody has made up


@dataclass
class Parts:
    """A bag taken apart."""

    definitions: list[Schema | Channel]
    messages: list[Message]
    others: list[Attachment | Metadata]

    def topic(self, message: Message) -> str:
        """Return the topic of a message, without the namespace of a swarm."""
        names = [one.topic for one in self.definitions if isinstance(one, Channel) and one.id == message.channel_id]
        return names[0].removeprefix("/") if names else ""

    def some(self, draw: random.Random, topic: str | None = None) -> list[Message]:
        """Return messages, of a topic if it is given: one, a few, those from some place on, or all."""
        found = [message for message in self.messages if topic in {None, self.topic(message)}]
        few = draw.sample(found, min(len(found), draw.choice((1, 1, 3))))
        return draw.choice((few, found[draw.randrange(len(found) + 1) :], found))


def forge(bag: bytes, draw: random.Random) -> tuple[str, bytes]:
    """Return what was forged, and the file."""
    records = list(StreamReader(BytesIO(bag)).records)
    records = records[: next(place for place, one in enumerate(records) if type(one).__name__ == "DataEnd")]
    parts = Parts(
        [one for one in records if isinstance(one, (Schema, Channel))],
        [one for one in records if isinstance(one, Message)],
        [one for one in records if isinstance(one, (Attachment, Metadata))],
    )
    made = [draw.choice(FORGERIES) for _ in range(draw.choice((1, 1, 1, 2, 4)))]
    for change in made:
        change(parts, draw)
    return "+".join(change.__name__ for change in made), _put_together(parts, draw)


def _put_together(parts: Parts, draw: random.Random) -> bytes:
    """Return a file of the parts, with chunks of some size, which may come in another order, or without its end."""
    size = draw.choice((1, 30, 30, 30, 10_000))
    pieces = [parts.messages[begin : begin + size] for begin in range(0, len(parts.messages), size)] or [[]]
    if draw.random() < 0.1:
        draw.shuffle(pieces)
    made = [_chunk([*parts.definitions, *pieces[0]], draw), *(_chunk(piece, draw) for piece in pieces[1:])]
    if draw.random() < 0.05:  # without chunks
        made = [b"".join(map(_bytes, [*parts.definitions, *parts.messages]))]
    head = MAGIC + encoded(Header("ros2", "swarmabs")) + b"".join(map(_bytes, parts.others))
    return head + b"".join(made[:-1]) if draw.random() < 0.1 else sealed(head + b"".join(made))


def _chunk(records: list[Any], draw: random.Random) -> bytes:
    data, entries = bytearray(), dict[int, list[tuple[int, int]]]()
    for one in records:
        if isinstance(one, Message):
            entries.setdefault(one.channel_id, []).append((one.log_time, len(data)))
        data += _bytes(one)
    times = [time for listed in entries.values() for time, _ in listed] or [0]
    made = chunk(bytes(data), draw.choice(("zstd", "zstd", "lz4", "")), times=(min(times), max(times)))
    indexes = (_bytes(MessageIndex(channel, listed)) for channel, listed in entries.items())
    return made + b"".join(indexes) if draw.random() < 0.98 else made


def _bytes(record: Any) -> bytes:
    """Return a record as it stands in a file; nothing if a number does not fit."""
    try:
        return encoded(record)
    except (struct.error, OverflowError, UnicodeEncodeError):
        return b""


def change_field(parts: Parts, draw: random.Random) -> None:
    """Put another value into a field of one message, of some, or of all on a topic."""
    topic = draw.choice(MAIN_TOPICS)
    layout = LAYOUT[topic]
    name = draw.choice([name for name in layout.names or () if not name.startswith("pad")])
    dtype, offset = (layout.fields or {})[name][:2]
    factor, value = draw.choice((0, 0, 2, 10**6, 10**12)), draw.choice(EXTREMES)
    fixed = draw.random() < 0.7
    for message in parts.some(draw, topic.name):
        if len(message.data) < offset + dtype.itemsize:
            continue
        if dtype.kind == "f":
            raw = struct.pack("<d", draw.choice(NUMBERS))
        else:
            old = int.from_bytes(message.data[offset : offset + dtype.itemsize], "little")
            new = old * factor + (value if fixed or not factor else 0)
            raw = (new % 2**64).to_bytes(8, "little")
        raw = raw[: dtype.itemsize].ljust(dtype.itemsize, b"\0")
        message.data = message.data[:offset] + raw + message.data[offset + dtype.itemsize :]


def put_in_events(parts: Parts, draw: random.Random) -> None:
    """Put in events that nobody has announced."""
    for _ in range(draw.choice((1, 3, 200))):
        step, detail = draw.choice((0, 5, 20, 40, draw.choice(EXTREMES))), draw.choice(TEXTS)
        event = SwarmEvent(
            draw.choice((step * 10_000_000, 0)) % 2**60,
            step,
            draw.choice((0, 1, 2, 7, 9, 65535)),
            draw.choice((*range(12), 255)),
            draw.choice(NUMBERS),
            detail[: draw.choice((20, 100_000))],
        )
        place = draw.randrange(len(parts.messages) + 1)
        near = parts.messages[place - 1].log_time if parts.messages else 0
        parts.messages.insert(place, Message(len((*MAIN_TOPICS, EVENTS)), near, encode(event), near, 0))


def rearrange(parts: Parts, draw: random.Random) -> None:
    """Leave messages out, write them twice, or in another order."""
    gone = {id(message) for message in parts.some(draw)} if draw.random() < 0.5 else ()
    twice = [replace(message) for message in parts.some(draw)] if draw.random() < 0.3 else []
    parts.messages = [message for message in parts.messages if id(message) not in gone] + twice
    sort: Callable[[Message], float] = draw.choice((
        lambda _: 0.0, lambda _: draw.random(), lambda message: message.channel_id, lambda message: -message.log_time,
    ))  # fmt: skip
    parts.messages.sort(key=sort)


def change_record(parts: Parts, draw: random.Random) -> None:
    """Put something else into a field of a topic, a definition, an attachment, a description, or messages."""
    records: list[Any] = draw.choice((parts.definitions, parts.others, parts.messages))
    if not records:
        return
    chosen = parts.some(draw) if records is parts.messages else [draw.choice(records)]
    if draw.random() < 0.2:  # it stands there twice then
        records += [replace(one) for one in chosen]
    name = draw.choice([field.name for field in fields(draw.choice(records))])
    value = draw.choice((*EXTREMES, draw.randrange(8)))
    words, hostile = draw.choice(TEXTS), draw.choice(HOSTILE_TEXTS)
    for one in chosen:
        known = getattr(one, name, None)
        if isinstance(known, int):
            setattr(one, name, value)
        elif isinstance(known, str):
            setattr(one, name, draw.choice((words[:5000], f"/lab{known}")))
        elif isinstance(known, bytes):
            setattr(one, name, draw.choice((hostile, known[: len(known) // 2], known + hostile[:100])))
        elif known is not None:
            known[draw.choice([*known, "x", ""])] = words


_SETTINGS: tuple[dict[str, Any], ...] = (
    {"duration": 2147483647.0, "step": 1e-9},
    {"faults": [{"kind": "join", "at": 2147483000.0, "agent": 1}], "duration": 2147483647.0},
    {"faults": [{"kind": "delay", "steps": 2**31 - 1}]},
    {"swarm": {"generate": {"single_integrator": 65535}}},
    {"controller": {"type": "lqr", "q": [1e300, 1e-300], "r": 1e-300}},
    {"controller": {"type": "pd", "trajectory": {"type": "csv", "file": "/dev/zero"}}},
    {"plane": {"angle": 1e-320, "length": 1e9}, "name": "<script>alert(1)</script>", "seed": 2**64},
)


def change_scenario(parts: Parts, draw: random.Random) -> None:
    """Change a value of the attached scenario."""
    values = (*(value for value in NUMBERS if abs(value) < 1e301), *EXTREMES, None, True, [], {}, draw.choice(TEXTS))
    for attachment in parts.others:
        document = load_yaml(attachment.data.decode("utf-8", "replace")) if isinstance(attachment, Attachment) else None
        if isinstance(document, dict) and isinstance(attachment, Attachment) and attachment.name == "scenario.yaml":
            if draw.random() < 0.5:
                document.update(draw.choice(_SETTINGS))
            else:
                replace_value(document, values, draw)
            attachment.data = yaml.safe_dump(document, allow_unicode=True).encode()


def replace_value(document: Any, values: Sequence[object], draw: random.Random) -> None:
    """Put one of the values anywhere in what was read from YAML."""
    place = document
    while keys := list(place) if isinstance(place, dict) else list(range(len(place))):
        key = draw.choice(keys)
        if not isinstance(place[key], (dict, list)) or draw.random() < 0.1:
            place[key] = draw.choice(values)
            return
        place = place[key]


FORGERIES = (
    *(change_field, change_field, change_field, put_in_events, put_in_events, rearrange, rearrange),
    *(change_record, change_record, change_record, change_record, change_scenario, change_scenario),
)
