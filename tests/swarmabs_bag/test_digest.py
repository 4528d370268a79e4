"""The digest of a run, computed here from the contract's words alone, does not depend on how the bag was written."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer

from swarmabs_analysis.comparison import compare_bags
from swarmabs_bag.arrays import digest_of, load_tables
from swarmabs_bag.reader import open_bag
from swarmabs_core.messages import PLANE_STATE, Message

MAIN = {
    "plane/state",
    "swarm/agent_state",
    "swarm/abstract_state",
    "swarm/auxiliary_state",
    "swarm/desired_abstract_state",
}
PADDING = {
    "plane/state": [(22, 28)],
    "swarm/agent_state": [(22, 28), (48, 52)],
    "swarm/abstract_state": [(22, 28), (38, 44)],
    "swarm/auxiliary_state": [(22, 28)],
    "swarm/desired_abstract_state": [(22, 28), (37, 44)],
}
STEP = 28
AGENT_ID = 44


def digest(file: Path) -> str:
    """SHA-256 over (topic, 0x00, uint32 LE length, payload), sorted by (step, topic, agent_id)."""
    records = []
    with file.open("rb") as stream:
        for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            topic, data = channel.topic.removeprefix("/"), message.data
            if topic in MAIN:
                (step,) = struct.unpack_from("<Q", data, STEP)
                (agent,) = struct.unpack_from("<H", data, AGENT_ID) if topic == "swarm/agent_state" else (0,)
                record = topic.encode() + b"\0" + struct.pack("<I", len(data)) + data
                records.append((step, topic, agent, record))
    total = hashlib.sha256()
    for _, _, _, record in sorted(records):
        total.update(record)
    return total.hexdigest()


def test_digest_depends_on_the_run_only(
    tmp_path: Path, bag: Path, run: list[Message], write_bag: Callable[..., Path]
) -> None:
    expected = digest(bag / "bag_0.mcap")
    assert digest(write_bag(tmp_path / "chunks", chunk_bytes=1) / "bag_0.mcap") == expected
    assert digest(write_bag(tmp_path / "order", list(reversed(run))) / "bag_0.mcap") == expected
    assert digest(write_bag(tmp_path / "less", run[:-1]) / "bag_0.mcap") != expected


def test_digest_of_loaded_messages_in_any_order(bag: Path) -> None:
    tables = load_tables(open_bag(bag))
    expected = digest(bag / "bag_0.mcap")
    assert digest_of(tables) == expected
    draw = np.random.default_rng(3)
    assert digest_of({topic: draw.permutation(rows) for topic, rows in tables.items()}) == expected
    assert digest_of({**tables, PLANE_STATE: tables[PLANE_STATE][:-1]}) != expected


def test_digest_of_loaded_messages_is_that_of_compare_whatever_the_padding(bag: Path, tmp_path: Path) -> None:
    """ROS leaves padding undefined, and so do the bags of other recorders."""
    padded = tmp_path / "padded.mcap"
    with (bag / "bag_0.mcap").open("rb") as source, padded.open("wb") as sink:
        writer = Writer(sink)
        writer.start(profile="ros2", library="another")
        for schema, channel, message in make_reader(source).iter_messages(log_time_order=False):
            assert schema is not None
            data = bytearray(message.data)
            for begin, end in PADDING.get(channel.topic.removeprefix("/"), []):
                data[begin:end] = b"\xa5" * (end - begin)
            made = writer.register_schema(schema.name, schema.encoding, schema.data)
            number = writer.register_channel(channel.topic, "cdr", made)
            writer.add_message(number, message.log_time, bytes(data), message.publish_time)
        writer.finish()
    found = compare_bags(bag, padded)
    assert found.equal
    assert digest(padded) != digest_of(load_tables(open_bag(padded))) == found.b.digest == digest(bag / "bag_0.mcap")


def test_every_padding_byte_in_the_bag_is_zero(bag: Path) -> None:
    with (bag / "bag_0.mcap").open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            assert message.data[:4] == b"\0\1\0\0"
            for begin, end in PADDING.get(channel.topic.removeprefix("/"), []):
                assert not any(message.data[begin:end])
