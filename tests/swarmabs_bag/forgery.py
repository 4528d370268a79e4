"""Bags that are as the format says, but whose messages, topics and texts somebody has made up, drawn from a seed."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from io import BytesIO
from typing import Any

import yaml
from mcap.records import Attachment, Channel, Header, Message, MessageIndex, Metadata, Schema
from mcap.stream_reader import StreamReader
from tests.swarmabs_bag.damage import EXTREMES, HOSTILE_TEXTS, MAGIC, Damage, chunk, sealed

from swarmabs_bag.metadata import load_yaml
from swarmabs_bag.records import encoded
from swarmabs_core.arrays import LAYOUT
from swarmabs_core.cdr import decode, encode
from swarmabs_core.errors import MalformedMessageError
from swarmabs_core.messages import AGENT_STATE, EVENTS, MAIN_TOPICS, SwarmEvent, Topic

NUMBERS = (
    float("nan"), float("inf"), float("-inf"), -0.0, 0.0, 1.0, -1.0, 5e-324, 1e-9, 1e9, -1e99, 1e101, 1e200, -1.7e308,
)  # fmt: skip
TEXTS = (
    *(found.decode() for found in HOSTILE_TEXTS if len(found) < 2**17 and found.isascii()),
    "<script>alert(1)</script><img src=x onerror=alert(1)>",
    "\x1b]0;x\x07\x1b[31m[red]{0}%s$x$\\",
    "\u202e\u2028\U0001f916\0 größer",
    "silent",
    "interrupted\nerror: x",
)
"""Texts for whatever is shown to people."""

NAMES = ("/plane/state", "/agents/state", "/swarm/abstract_state", "/lab/plane/state", "//plane/state", "", "/", "x")


@dataclass
class Parts:
    """A bag taken apart."""

    header: Header
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    messages: list[Message] = field(default_factory=list)
    attachments: list[Attachment] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)

    def topic(self, message: Message) -> Topic | None:
        """Return the topic of a swarm on which a message stands, None if it is none."""
        channel = self.channels.get(message.channel_id)
        return next((t for t in (*MAIN_TOPICS, EVENTS) if channel and channel.topic.endswith(f"/{t.name}")), None)

    def of(self, topic: Topic) -> list[int]:
        """Return the places of a topic's messages."""
        return [place for place, message in enumerate(self.messages) if self.topic(message) is topic]


def taken_apart(bag: bytes) -> Parts:
    """Return the parts of a whole bag."""
    parts = Parts(Header("", ""))
    for found in StreamReader(BytesIO(bag)).records:
        if isinstance(found, Header):
            parts.header = found
        elif isinstance(found, Schema):
            parts.schemas[found.id] = found
        elif isinstance(found, Channel):
            parts.channels[found.id] = found
        elif isinstance(found, Message):
            parts.messages.append(found)
        elif isinstance(found, Attachment):
            parts.attachments.append(found)
        elif isinstance(found, Metadata):
            parts.metadata.append(found)
    return parts


def put_together(parts: Parts, generator: random.Random) -> bytes:
    """Return a file of the parts, with chunks of some size, which may come in another order."""
    size = generator.choice((1, 30, 30, 30, 10_000))
    definitions = [*parts.schemas.values(), *parts.channels.values()]
    pieces = [parts.messages[begin : begin + size] for begin in range(0, len(parts.messages), size)] or [[]]
    if generator.random() < 0.1:
        generator.shuffle(pieces)
    made = [_chunk([*definitions, *pieces[0]], generator), *(_chunk(piece, generator) for piece in pieces[1:])]
    if generator.random() < 0.05:  # without chunks
        made = [b"".join(map(encoded, [*definitions, *parts.messages]))]
    others = b"".join(map(encoded, [*parts.attachments, *parts.metadata]))
    file = sealed(MAGIC + encoded(parts.header) + b"".join(made) + others)
    if generator.random() < 0.1:  # without its end
        del made[-1]
        return MAGIC + encoded(parts.header) + others + b"".join(made)
    return file


def _chunk(records: list[Any], generator: random.Random) -> bytes:
    data, entries = bytearray(), dict[int, list[tuple[int, int]]]()
    for one in records:
        if isinstance(one, Message):
            entries.setdefault(one.channel_id, []).append((one.log_time, len(data)))
        data += encoded(one)
    indexes = b"".join(encoded(MessageIndex(channel, listed)) for channel, listed in entries.items())
    times = [time for listed in entries.values() for time, _ in listed] or [0]
    return (
        chunk(bytes(data), generator.choice(("zstd", "zstd", "lz4", "")), times=(min(times), max(times)))
        + (b"" if generator.random() < 0.02 else indexes)
    )  # fmt: skip


def forge(bag: bytes, seed: int) -> Damage:
    """Return the bag with the forgeries of a seed."""
    generator = random.Random(seed)
    parts = taken_apart(bag)
    made = [generator.choice(FORGERIES) for _ in range(generator.choice((1, 1, 1, 2, 4)))]
    for change in made:
        change(parts, generator)
    return Damage("+".join(change.__name__ for change in made), put_together(parts, generator), sealed=True)


# Messages


def change_field(parts: Parts, generator: random.Random) -> None:
    """Put another value into a field of one message, of some, or of all on a topic."""
    topic = generator.choice(MAIN_TOPICS)
    layout = LAYOUT[topic]
    name = generator.choice([name for name in layout.names or () if not name.startswith("pad")])
    dtype, offset = (layout.fields or {})[name][:2]
    value = generator.choice(NUMBERS) if dtype.kind == "f" else generator.choice(EXTREMES)
    places = parts.of(topic)
    for place in generator.choice(
        (places[:1], places[-1:], _some(places, generator), _some(places, generator), places)
    ):
        payload = bytearray(parts.messages[place].data)
        if len(payload) >= offset + dtype.itemsize:
            raw = struct.pack("<d", value) if dtype.kind == "f" else struct.pack("<Q", int(value))
            payload[offset : offset + dtype.itemsize] = raw[: dtype.itemsize].ljust(dtype.itemsize, b"\0")
            parts.messages[place].data = bytes(payload)


def _some(places: list[int], generator: random.Random) -> list[int]:
    return generator.sample(places, min(len(places), generator.choice((1, 3)))) if places else []


def change_events(parts: Parts, generator: random.Random) -> None:
    """Put in events that nobody has announced."""
    channel = next((n for n, found in parts.channels.items() if found.topic.endswith(EVENTS.name)), 1)
    for _ in range(generator.choice((1, 3, 200))):
        step = generator.choice((0, 5, 20, 40, generator.choice(EXTREMES)))
        event = SwarmEvent(
            generator.choice((step * 10_000_000, 0)) % 2**60,
            step,
            generator.choice((0, 1, 2, 7, 9, 65535)),
            generator.choice((*range(12), 255)),
            generator.choice(NUMBERS),
            generator.choice(TEXTS)[: generator.choice((20, 100_000))],
        )
        place = generator.randrange(len(parts.messages) + 1)
        near = parts.messages[place - 1].log_time if parts.messages else 0
        parts.messages.insert(place, Message(channel, near, encode(event), near, 0))


def drop(parts: Parts, generator: random.Random) -> None:
    """Leave messages out: any, all of a topic, of a step, behind a step, or all there are."""
    topic, step = generator.choice((*MAIN_TOPICS, EVENTS)), generator.randrange(41)
    one = generator.randrange(len(parts.messages)) if parts.messages else 0
    kept: Callable[[int, Message], bool] = generator.choice((
        lambda place, _: place != one,
        lambda _, message: parts.topic(message) is not topic,
        lambda _, message: message.log_time != step * 10_000_000,
        lambda _, message: message.log_time < step * 10_000_000,
        lambda _, message: message.log_time > step * 10_000_000,
        lambda *_: generator.random() < 0.7,
        lambda *_: False,
    ))  # fmt: skip
    parts.messages = [message for place, message in enumerate(parts.messages) if kept(place, message)]


def double(parts: Parts, generator: random.Random) -> None:
    """Write messages twice, at once or at another time."""
    chosen = generator.choice((_some(list(range(len(parts.messages))), generator), list(range(len(parts.messages)))))
    copies = [replace(parts.messages[place]) for place in chosen]
    if generator.random() < 0.3:
        for copy in copies:
            copy.log_time = generator.choice((copy.log_time + 1, generator.choice(EXTREMES)))
    place = generator.randrange(len(parts.messages) + 1)
    parts.messages[place:place] = copies


def reorder(parts: Parts, generator: random.Random) -> None:
    kind = generator.randrange(4)
    if kind == 0:
        generator.shuffle(parts.messages)
    elif kind == 1:
        parts.messages.reverse()
    elif kind == 2:
        parts.messages.sort(key=lambda message: message.channel_id)
    elif len(parts.messages) > 1:
        one, other = generator.sample(range(len(parts.messages)), 2)
        parts.messages[one], parts.messages[other] = parts.messages[other], parts.messages[one]


def change_times(parts: Parts, generator: random.Random) -> None:
    """Change the bag's own times or sequence numbers."""
    name = generator.choice(("log_time", "publish_time", "sequence"))
    value = generator.choice(EXTREMES) % (2**32 if name == "sequence" else 2**64)
    places = list(range(len(parts.messages)))
    for place in generator.choice((_some(places, generator), places)):
        setattr(parts.messages[place], name, value)


def change_payload(parts: Parts, generator: random.Random) -> None:
    """Make messages longer or shorter, or replace them by something else."""
    places = list(range(len(parts.messages)))
    data = generator.choice((b"", b"\0\1\0\0", bytes(2**16), generator.randbytes(100)))
    for place in generator.choice((_some(places, generator), places)):
        known = parts.messages[place].data
        parts.messages[place].data = generator.choice((data, known[: len(data)], known + data[:100]))


def many_robots(parts: Parts, generator: random.Random) -> None:
    """Put in states of robots that nobody knows, or steps that are far from each other."""
    places = parts.of(AGENT_STATE)
    if not places:
        return
    for number in range(generator.choice((3, 2000))):
        known = parts.messages[generator.choice(places)]
        try:
            state = decode(AGENT_STATE.message, known.data)._replace(  # type: ignore[call-arg]
                agent_id=number * 31 % 65536,
                **({"step": generator.randrange(2**63)} if generator.random() < 0.1 else {}),
            )
        except MalformedMessageError:
            return
        parts.messages.append(replace(known, data=encode(state)))


def stretch(parts: Parts, generator: random.Random) -> None:
    """Multiply all steps by a number, with their times or without."""
    factor = generator.choice((2, 10**6, 10**12))
    for message in parts.messages:
        topic = parts.topic(message)
        try:
            found = decode(topic.message, message.data) if topic else None
            if found is not None:
                message.data = encode(found._replace(step=found.step * factor))
        except MalformedMessageError:
            return


# Topics


def rename(parts: Parts, generator: random.Random) -> None:
    for number in _some(list(parts.channels), generator):
        known = parts.channels[number].topic
        name = generator.choice((generator.choice(NAMES), f"/lab{known}", generator.choice(TEXTS)[:5000]))
        parts.channels[number].topic = name


def change_channels(parts: Parts, generator: random.Random) -> None:
    """Swap numbers of channels or schemas, write a channel twice, or leave one out."""
    one, other = generator.choice(list(parts.channels)), generator.choice(list(parts.channels))
    kind = generator.randrange(5)
    if kind == 0:
        for message in parts.messages:
            message.channel_id = {one: other, other: one}.get(message.channel_id, message.channel_id)
    elif kind == 1:
        parts.channels[one].schema_id = generator.choice((0, 65535, parts.channels[other].schema_id))
    elif kind == 2:
        parts.channels[99] = replace(parts.channels[one], id=99)
        for message in parts.messages:
            if message.channel_id == one and generator.random() < 0.5:
                message.channel_id = 99
    elif kind == 3:
        parts.channels[one].message_encoding = generator.choice(("", "json", "cdr\n", "x" * 1000))
    elif len(parts.channels) > 1:
        del parts.channels[one]
        if generator.random() < 0.5:
            parts.messages = [message for message in parts.messages if message.channel_id != one]


def change_descriptions(parts: Parts, generator: random.Random) -> None:
    """Change schemas, hashes and what channels say of their QoS."""
    for number in generator.choice((_some(list(parts.channels), generator), list(parts.channels))):
        key = generator.choice(("offered_qos_profiles", "topic_type_hash", "x", ""))
        parts.channels[number].metadata[key] = generator.choice((*TEXTS, _hostile_profile(generator)))
    for number in _some(list(parts.schemas), generator) if generator.random() < 0.5 else ():
        kind = generator.choice(("name", "encoding", "data"))
        value = generator.choice(
            ("", "ros1msg", "swarmabs_msgs/msg/PlaneState", "float64 x\nint32[9999999999] y", *TEXTS)
        )
        setattr(parts.schemas[number], kind, value.encode() if kind == "data" else value)


def _hostile_profile(generator: random.Random) -> str:
    values = [*EXTREMES, -1, 1.5, True, None, "reliable", "RELIABLE", "x\ny", [], {}, {"sec": 2**70, "nsec": -5}]
    keys = (
        *("history", "depth", "reliability", "durability", "deadline", "lifespan", "liveliness"),
        *("liveliness_lease_duration", "avoid_ros_namespace_conventions", "x"),
    )
    profile = {key: generator.choice(values) for key in keys if generator.random() < 0.7}
    return yaml.safe_dump([profile] * generator.choice((0, 1, 2)))


# Texts


def change_header(parts: Parts, generator: random.Random) -> None:
    parts.header = Header(generator.choice(("ros2", "", "x", TEXTS[-4])), generator.choice(("swarmabs 9", *TEXTS)))


def change_scenario(parts: Parts, generator: random.Random) -> None:
    """Change values of the attached scenario."""
    for attachment in parts.attachments:
        if attachment.name == "scenario.yaml":
            document = load_yaml(attachment.data.decode("utf-8", "replace"))
            if not isinstance(document, dict):
                continue
            for _ in range(generator.choice((1, 1, 3))):
                _change_value(document, generator)
            attachment.data = yaml.safe_dump(document, allow_unicode=True).encode()


_SETTINGS: tuple[dict[str, Any], ...] = (
    {"duration": 2147483647.0},
    {"duration": 2147483647.0, "step": 1e-9},
    {"step": 1e-9},
    {"step": 0.4},
    {"faults": [{"kind": "join", "at": 2147483000.0, "agent": 1}], "duration": 2147483647.0},
    {"faults": [{"kind": "join", "at": 2147483000.0, "agent": 1}], "duration": 2147483647.0, "step": 1e-9},
    {"faults": [{"kind": "delay", "steps": 2**31 - 1}]},
    {"faults": [{"kind": "loss", "probability": 1.0}, {"kind": "kill", "at": 0.0, "agent": 1}]},
    {"faults": []},
    {"swarm": {"generate": {"single_integrator": 65535}}},
    {"swarm": {"agents": [{"id": 65535, "kind": "single_integrator", "mass": 1e-300, "position": 0.0}]}},
    {"swarm": {"agents": []}},
    {"controller": {"type": "pd", "kp": 1e300, "kd": 1e300}},
    {"controller": {"type": "lqr", "q": [1e300, 1e-300], "r": 1e-300}},
    {"controller": {"type": "pd", "trajectory": {"type": "csv", "file": "/etc/passwd"}}},
    {"controller": {"type": "pd", "trajectory": {"type": "csv", "file": "/dev/zero"}}},
    {"controller": {"type": "pd", "trajectory": {"type": "step", "time": 0.2, "angle": 0.3}}},
    {"observer": {"type": "parent_response"}},
    {"lockstep": {"on_stall": "drop"}},
    {"plane": {"angle": 1e-320, "length": 1e9}},
    {"schema": 2**70},
    {"name": "<script>alert(1)</script>"},
    {"seed": 2**64},
)


def _change_value(document: Any, generator: random.Random) -> None:
    """Put a setting into a scenario, or another value in the place of one that is there."""
    if generator.random() < 0.5:
        document.update(generator.choice(_SETTINGS))
        return
    place: Any = document
    while True:
        keys = list(place) if isinstance(place, dict) else list(range(len(place)))
        if not keys:
            return
        key = generator.choice(keys)
        if not isinstance(place[key], (dict, list)) or generator.random() < 0.1:
            break
        place = place[key]
    finite = [value for value in NUMBERS if abs(value) < 1e301]
    place[key] = generator.choice((*finite, *EXTREMES, None, True, [], {}, "x", generator.choice(TEXTS)[:1000]))


def change_provenance(parts: Parts, generator: random.Random) -> None:
    data = generator.choice((
        b'{"driver": "realtime"}', b'{"driver": {}}', b'{"driver": "' + b"x" * 5000 + b'\\n"}',
        b'{"replay": {"of": 7, "nodes": {"a": 1}}}', b'{"replay": "x"}', b'{"schema": 99}',
        b'{"versions": {"<script>": "<script>"}, "libm_fingerprint": "<script>"}',
        b'{"versions": {"\\n": "\\n\\u001b", "python": 3}, "libm_fingerprint": "\\u001b"}',
        *(found.encode("utf-8", "replace") for found in TEXTS),
    ))  # fmt: skip
    for attachment in parts.attachments:
        if attachment.name == "provenance.json":
            attachment.data = data


def change_attachments(parts: Parts, generator: random.Random) -> None:
    """Replace, rename, double or remove attachments."""
    for attachment in list(parts.attachments):
        kind = generator.randrange(5)
        if kind == 0:
            attachment.data = generator.choice(HOSTILE_TEXTS)
        elif kind == 1:
            attachment.name = generator.choice(("scenario.yaml", "provenance.json", "../../x", "", TEXTS[-4]))
        elif kind == 2:
            parts.attachments.append(replace(attachment, data=generator.choice(HOSTILE_TEXTS)))
        elif kind == 3:
            parts.attachments.remove(attachment)


def change_description(parts: Parts, generator: random.Random) -> None:
    """Change what rosbag2's metadata record says, above all why the run ended."""
    custom: Any = {
        key: generator.choice((*TEXTS, None, 7, []))
        for key in ("swarmabs.aborted", "swarmabs.repaired", "x")
        if generator.random() < 0.7
    }
    document = generator.choice((
        {"version": 9, "custom_data": custom}, {"version": 9, "custom_data": custom}, custom, [custom],
        {"custom_data": generator.choice(TEXTS)},
    ))  # fmt: skip
    name = generator.choice(("rosbag2", "rosbag2", "rosbag2", "x"))
    parts.metadata.append(Metadata(name, {"serialized_metadata": yaml.safe_dump(document, allow_unicode=True)}))


Forgery = Callable[[Parts, random.Random], None]
FORGERIES: tuple[Forgery, ...] = (
    change_field, change_field, change_field, change_field, change_events, change_events, drop, drop, double, reorder,
    change_times, change_payload, many_robots, stretch, rename, change_channels, change_descriptions, change_header,
    change_scenario, change_scenario, change_scenario, change_provenance, change_attachments, change_description,
)  # fmt: skip
