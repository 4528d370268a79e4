"""What an answer to a damaged bag may look like, and what other readers say of it."""

from __future__ import annotations

import hashlib
import io
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Schema
from rosbags.rosbag2 import Reader
from tests.swarmabs_bag.damage import split

from swarmabs_bag.reader import BagReader, open_bag
from swarmabs_bag.records import HEAD_SIZE, Record, encoded, inner_records, parse, uncompress
from swarmabs_cli import main
from swarmabs_core.arrays import RunArrays
from swarmabs_core.errors import SwarmabsError

Content = tuple[str, dict[str, bytes | None]]
"""Digest of all messages in file order, and the attachments."""

Kept = Counter[tuple[str, int, int, bytes]]
"""Messages: topic, log and publish time, bytes."""


class WrongAnswerError(Exception):
    """Something read a damaged bag and gave an answer that should not be."""


def content(path: Path, *, damaged: bool = False) -> Content:
    bag = open_bag(path, damaged=damaged)
    digest = hashlib.sha256()
    for channel, message in bag.stored_messages():
        digest.update(f"{channel.name} {message.log_time} {len(message.payload)} ".encode() + message.payload)
    attachments = {entry.name: bag.attachment(entry.name) for entry in bag.index.attachments}
    bag.rosbag2_metadata()
    bag.aborted()
    return digest.hexdigest(), attachments


def kept(bag: BagReader) -> Kept:
    return Counter((c.name, m.log_time, m.publish_time, m.payload) for c, m in bag.stored_messages())


def same(one: RunArrays, other: RunArrays) -> bool:
    """Say whether two runs have the same states of robots and plane."""
    return all(
        np.array_equal(getattr(one.agents, name), getattr(other.agents, name), equal_nan=True)
        for name in ("ids", "status", "position", "command")
    ) and np.array_equal(one.angle, other.angle, equal_nan=True)


def check_line(error: SwarmabsError) -> None:
    """Make sure that an error is one short line that cannot steer a terminal."""
    if not str(error).isprintable() or len(str(error)) > 1000:
        raise WrongAnswerError(f"an error of {len(str(error))} characters: {str(error)[:300]!r}")


def command(*arguments: str | Path) -> tuple[int, str]:
    """Return exit code and standard output of a command.

    If it fails there is an answer on standard output, or one line of error and nothing else. What it prints cannot
    steer a terminal, and no library prints a warning.
    """
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err), warnings.catch_warnings():
        warnings.simplefilter("always")
        code = main([str(argument) for argument in arguments])
    shown = f"swarm {' '.join(str(argument) for argument in arguments)} exits {code} and says"
    errors = [line for line in err.getvalue().split("\n") if line.startswith("error: ")]
    others = [line for line in err.getvalue().split("\n") if line and line not in errors]
    if code not in {0, 1, 2} or (code and not out.getvalue() and (len(errors) != 1 or others)):
        raise WrongAnswerError(f"{shown} {err.getvalue()[:500]!r}")
    if any("Warning" in line or "Traceback" in line for line in others) or len(errors) > 1 or (errors and not code):
        raise WrongAnswerError(f"{shown} {err.getvalue()[:500]!r}")
    for line in (*errors, *others, *out.getvalue().split("\n")):
        if not line.isprintable() or (line in errors and len(line) > 1000):
            raise WrongAnswerError(f"{shown} a line of {len(line)} characters: {line[:300]!r}")
    return code, out.getvalue()


def check_with_mcap(files: list[Path]) -> Counter[bytes]:
    """Return the payloads of whole files as the mcap library reads them by their indexes."""
    found: Counter[bytes] = Counter()
    for file in files:
        with file.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            found.update(message.data for _, _, message in reader.iter_messages())
            for one in (*reader.iter_attachments(), *reader.iter_metadata()):
                assert one.name is not None
    return found


def extended(file: Path) -> bool:
    """Tell whether a schema or channel in a chunk has fields of a later version of MCAP.

    The format allows it, but the mcap library (1.6) reads on behind the fields that it knows.
    """
    records = [found for found in split(file.read_bytes()) if found.opcode == Opcode.CHUNK]
    for data in map(uncompress, records):
        for opcode, begin, end in inner_records(data, 0):
            kind = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel}.get(opcode)
            if kind and len(encoded(parse(kind, Record(0, opcode, data[begin:end])))) != HEAD_SIZE + end - begin:
                return True
    return False


def check_with_rosbags(folder: Path) -> Counter[bytes]:
    """Return the payloads of a bag as rosbags reads them."""
    with Reader(folder) as reader:
        found = Counter(bytes(data) for _, _, data in reader.messages())
        if reader.message_count != found.total():
            raise WrongAnswerError(f"metadata.yaml says {reader.message_count} messages, there are {found.total()}")
    return found


def files_below(folder: Path) -> Iterator[Path]:
    """Yield everything below a folder, links and pipes too."""
    yield from sorted(folder.rglob("*"))
