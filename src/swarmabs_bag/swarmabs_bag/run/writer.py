"""Writing a run to a bag: an MCAP file for ROS tools, crash-safe during the recording."""

from __future__ import annotations

import time
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from mcap.records import Channel, Schema

from swarmabs_bag.errors import REMEDIES, BagFolderError, BagWriteError
from swarmabs_bag.mcap.chunks import Column, MessageRecords
from swarmabs_bag.mcap.file_writer import McapFile
from swarmabs_bag.mcap.index import ending, scan_index
from swarmabs_bag.mcap.output import RecordFile, Reserve
from swarmabs_bag.mcap.records import RecordError
from swarmabs_bag.run.metadata import (
    ABORTED_KEY,
    BagChannel,
    FileRecord,
    bag_metadata,
    dump_yaml,
    qos_profile,
    write_metadata,
)
from swarmabs_bag.run.schemas import message_schema
from swarmabs_bag.run_folder import ONE_FILE, Split
from swarmabs_config.graph import LOCKSTEP, OFFERED, usual_topic
from swarmabs_config.installation import own_version
from swarmabs_core.messages import EVENTS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from types import TracebackType

    from mcap.records import Statistics
    from typing_extensions import Self

    from swarmabs_bag.run.step import Step
    from swarmabs_config.graph import Qos
    from swarmabs_core.messages import Topic

BAG_FILE = "bag_0.mcap"
"""Name of the first MCAP file in a bag folder; the numbers of a split bag count up."""

CHUNK_SECONDS = 0.8
"""Age at which a chunk is closed, s; with the polling interval it stays below 1 s."""

CHUNK_BYTES = 2**20

# Reserve for the end of the file and metadata.yaml, which grow with the number of chunks.
_RESERVE_BASE = 2**18
_RESERVE_PER_CHUNK = 256
_MAX_CHUNKS_GIVEN_UP = 8


class _Written(NamedTuple):
    """A file of the bag whose messages are all written, and their numbers by channel."""

    record: FileRecord
    counts: Mapping[int, int]

    @classmethod
    def of(cls, name: str, statistics: Statistics) -> Self:
        """Return a file by its name and statistics."""
        return cls(FileRecord.of(name, statistics), dict(statistics.channel_message_counts))


class BagWriter:
    """Writer of a bag: one or several MCAP files, each self-contained.

    Messages are collected in chunks. A chunk is compressed and passed to the operating system when it contains
    `chunk_bytes` or its first message is `chunk_seconds` old, so a SIGKILL loses at most the current chunk. Only
    `close` and `abort` write the summary section and ``metadata.yaml``.

    Use it as a context manager: leaving the block closes the bag, an exception in the block aborts it.

    Parameters
    ----------
    folder : Path
        The bag's folder; it is created, or must be empty.
    topics : sequence of Topic
        All topics that may be written, including those that may stay without messages.
    attachments : mapping of str to bytes
        Attachments written first, by name: the resolved scenario, the provenance.
    namespace : str
        Namespace of the swarm; by default the bag contains ``/plane/state``.
    qos : mapping of Topic to Qos
        What the publishers of the topics offer; those of robots' own topics what they do on the usual ones.
    chunk_seconds : float
        Longest time in s, by the `monotonic` clock, until a message is passed to the operating system; call `poll` if
        there are pauses between writes.
    chunk_bytes : int
        Size of a chunk before compression.

    Raises
    ------
    BagFolderError
        If the folder is not empty or cannot be written; like the other errors, it leaves nothing behind.
    UnknownTypeError
        If the definition of a topic's type is not installed.
    BagWriteError
        If the disk is full or fails.
    """

    def __init__(
        self,
        folder: Path,
        *,
        topics: Sequence[Topic],
        attachments: Mapping[str, bytes],
        namespace: str = "/",
        qos: Mapping[Topic, Qos] = OFFERED[LOCKSTEP],
        chunk_seconds: float = CHUNK_SECONDS,
        chunk_bytes: int = CHUNK_BYTES,
        split: Split = ONE_FILE,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self.folder = folder
        self.path = folder / BAG_FILE
        self._attachments = dict(attachments)
        self._chunk_seconds = chunk_seconds
        self._chunk_bytes = chunk_bytes
        self._split = split
        self._monotonic = monotonic
        self._chunk_opened: float | None = None
        self._chunks = 0
        self._first: int | None = None
        self._last = 0
        self._complete: list[_Written] = []
        self._error: BagWriteError | None = None
        self._closed = False
        with self._remembering_errors():  # the definitions are read from files
            self._schemas = schemas = {topic.ros_type: message_schema(topic.ros_type) for topic in topics}
        self._topics = [
            BagChannel(
                name=f"{namespace.rstrip('/')}/{topic.name}",
                ros_type=topic.ros_type,
                type_hash=schemas[topic.ros_type].type_hash,
                qos_profiles=dump_yaml([qos_profile(qos[topic] if topic in qos else qos[usual_topic(topic)])]),
            )
            for topic in topics
        ]
        with _new_folder(folder, self.path) as undo:
            self._file = RecordFile(self.path)
            undo.callback(self.path.unlink)
            undo.callback(self._file.close)
            self._reserve = Reserve(folder)
            undo.callback(self._reserve.release)
            self._reserve.hold(_RESERVE_BASE)
            self._mcap = self._begin(self._file)
            # From here on nothing is undone.
            undo.pop_all()
        self._register()
        self._channels = {topic.name: channel for channel, topic in enumerate(topics, start=1)}
        self._counts = dict.fromkeys(self._channels.values(), 0)

    def _begin(self, file: RecordFile) -> McapFile:
        """Write the beginning of a file."""
        mcap = McapFile(file, _library(), self._chunk_bytes)
        for name, data in self._attachments.items():
            mcap.attach(name, data, 0)
        file.commit()
        return mcap

    def _register(self) -> None:
        ids = {name: number for number, name in enumerate(self._schemas, start=1)}
        for name, schema in self._schemas.items():
            self._mcap.define(Schema(id=ids[name], name=name, encoding="ros2msg", data=schema.text.encode()))
        for number, topic in enumerate(self._topics, start=1):
            channel = Channel(
                id=number,
                topic=topic.name,
                message_encoding="cdr",
                schema_id=ids[topic.ros_type],
                metadata={
                    "offered_qos_profiles": topic.qos_profiles,
                    "topic_type_hash": topic.type_hash,
                },
            )
            self._mcap.define(channel)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._closed:
            return
        if error is None:
            self.close()
        else:
            self.abort(reason=str(error) or type(error).__name__)

    def write(self, topic: Topic, log_time_ns: int, payload: bytes, publish_time_ns: int | None = None) -> None:
        """Write a message, CDR with its encapsulation header, on one of the topics given at construction.

        Times are in ns and not negative. In lockstep the log time is that of the message's header; the publish time
        defaults to the log time.

        Raises
        ------
        BagWriteError
            If the disk is full or fails. The messages of the current chunk are lost; call `abort`.
        """
        self._check_open()
        channel = self._channels[topic.name]
        if log_time_ns < 0:
            raise ValueError(f"{topic.name}: log time {log_time_ns} ns is negative")
        self._turn(log_time_ns)
        published = log_time_ns if publish_time_ns is None else publish_time_ns
        self._open_chunk()
        self._mcap.add(channel, self._counts[channel], (log_time_ns, published), payload)
        self._counts[channel] += 1
        self._cover(log_time_ns, log_time_ns)
        if self._file.pending:  # the chunk was full
            self._end_chunk()
        self.poll()

    def write_step(self, step: Step) -> None:
        """Write the messages of a step of lockstep, or of several, as `write` does singly; errors as for `write`."""
        self._check_open()
        for topic, payload in step.relays:
            self.write(topic, int(step.times[-1]), payload)
        left = step
        while left.tables:
            self._turn(int(left.times[0]))
            count = self._steps_to_turn(left)
            self._write_tables(left if count == len(left) else left[:count])
            if count == len(left):
                break
            left = left[count:]
        for payload in step.told:
            self.write(EVENTS, int(step.times[-1]), payload)
        self.poll()

    def _write_tables(self, step: Step) -> None:
        """Write the messages of a step, or of several in one file, except events."""
        columns = self._columns(step)
        records, following = MessageRecords(step.times, columns), 0
        while following < len(records):
            self._open_chunk()
            following = self._mcap.add_records(records, following)
            if self._file.pending:  # the chunk was full
                self._end_chunk()
        for column in columns:
            self._counts[column.channel] += column.payloads.size
        self._cover(int(step.times.min()), int(step.times.max()))

    def _columns(self, step: Step) -> list[Column]:
        """Return the messages of a step, or of several, as the file takes them."""
        channels = [(self._channels[topic.name], table) for topic, table in step.tables.items()]
        return [Column(channel, self._counts[channel], table.reshape(len(step), -1)) for channel, table in channels]

    def _turn(self, log_time_ns: int) -> None:
        """Begin the next file if a step at this time belongs there."""
        if self._first is not None and log_time_ns > self._last and self._is_full(log_time_ns):
            self._next_file()

    def _steps_to_turn(self, steps: Step) -> int:
        """Return how many of several steps come before the first one that may belong in the next file."""
        turns = [len(steps)]
        if self._split.bytes:
            turns.append(self._mcap.groups_to_fill(self._columns(steps)))
        if self._split.nanoseconds:
            first = int(steps.times[0]) if self._first is None else self._first
            late = np.flatnonzero(steps.times[1:] - first >= self._split.nanoseconds)
            turns += (late[:1] + 1).tolist()
        return min(turns)

    def _open_chunk(self) -> None:
        if self._chunk_opened is None:
            self._chunk_opened = self._monotonic()

    def _cover(self, start: int, end: int) -> None:
        """Extend the times of the file, ns."""
        self._first = start if self._first is None else min(self._first, start)
        self._last = max(self._last, end)

    def _is_full(self, log_time_ns: int) -> bool:
        """Return whether a step at this time belongs in the next file."""
        split, first = self._split, self._first or 0
        by_size = 0 < split.bytes <= self._file.committed and self._mcap.statistics.chunk_count > 0
        return by_size or 0 < split.nanoseconds <= log_time_ns - first

    def _next_file(self) -> None:
        """Begin the next file and complete the current one; if either fails, the current one remains the last."""
        path = self.folder / f"bag_{len(self._complete) + 1}.mcap"
        with self._remembering_errors(path):
            file = RecordFile(path)
        try:
            with self._remembering_errors(path):
                mcap = self._begin(file)
            self._finish_file({}, aborted=None)
        except BagWriteError:
            file.close()
            path.unlink(missing_ok=True)
            raise
        self.path, self._file, self._mcap = path, file, mcap
        self._first, self._last = None, 0
        self._counts = dict.fromkeys(self._counts, 0)
        self._register()

    def poll(self) -> None:
        """Close the current chunk if it is older than `chunk_seconds`; errors as for `write`."""
        self._check_open()
        if self._chunk_opened is not None and self._monotonic() - self._chunk_opened >= self._chunk_seconds:
            self._mcap.flush()
            self._end_chunk()

    def close(self, attachments: Mapping[str, bytes] | None = None, *, aborted: str | None = None) -> None:
        """Write the remaining messages, attachments such as the run's log, the summary section, and ``metadata.yaml``.

        `aborted` is why the run ended early, if it did.

        Raises
        ------
        BagWriteError
            If the disk is full or fails. The bag has then been completed as by `abort`.
        """
        self._check_open()
        try:
            self._finish(attachments or {}, aborted=aborted)
        except BagWriteError as error:
            self.abort(reason=str(error))
            raise

    def abort(self, reason: str = "aborted", attachments: Mapping[str, bytes] | None = None) -> None:
        """Complete the bag of a failed run as far as possible, so that it can be read.

        After a write error, the file is completed with the data written before. If even the reserved space is not
        enough, the last chunks are sacrificed. No error is raised; in the worst case the file ends after its last
        complete record, without summary section and without ``metadata.yaml``.
        """
        if self._closed:
            return
        if self._error is None:
            with suppress(BagWriteError):
                self._finish(attachments or {}, aborted=reason)
        self._finish_after_error(reason)

    def _check_open(self) -> None:
        if self._error is not None:
            raise self._error
        if self._closed:
            raise ValueError(f"{self.path} is closed")

    @contextmanager
    def _remembering_errors(self, path: Path | None = None) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self._error = BagWriteError(path or self.path, error)
            raise self._error from error

    def _end_chunk(self) -> None:
        self._chunk_opened = None
        self._chunks += 1
        with self._remembering_errors():
            self._file.commit()
            self._reserve.hold(_RESERVE_BASE + self._chunks * _RESERVE_PER_CHUNK)

    def _finish(self, attachments: Mapping[str, bytes], *, aborted: str | None) -> None:
        self._finish_file(attachments, aborted=aborted)
        with self._remembering_errors():
            self._closed = True
            self._reserve.release()
            write_metadata(self.folder, self._description(self._complete, aborted))

    def _finish_file(self, attachments: Mapping[str, bytes], *, aborted: str | None) -> None:
        with self._remembering_errors():
            self._chunk_opened = None
            self._mcap.flush()
            self._file.commit()
            for name, data in attachments.items():
                self._mcap.attach(name, data, self._last)
            self._file.commit()
            written = _Written.of(self.path.name, self._mcap.statistics)
            self._mcap.finish(dump_yaml(self._description([written], aborted)))
            self._file.commit()
            self._file.sync()
            self._file.close()
            self._complete.append(written)

    def _finish_after_error(self, reason: str) -> None:
        if self._closed:  # the file was complete before the error
            return
        self._closed = True
        self._reserve.release()
        with suppress(OSError, RecordError):
            self._salvage(reason)
        with suppress(OSError):
            self._file.close()

    def _salvage(self, reason: str) -> None:
        for _ in range(_MAX_CHUNKS_GIVEN_UP):
            with self.path.open("rb") as stream:
                index = scan_index(stream, self._file.committed)
            self._file.cut(index.data_end)
            written = _Written.of(self.path.name, index.statistics)
            try:
                for piece in ending(index, dump_yaml(self._description([written], reason))):
                    self._file.write(piece)
                self._file.commit()
            except OSError:
                if not index.chunks:
                    raise
                self._file.cut(index.chunks[-1].chunk_start_offset)
            else:
                self._file.cut(self._file.committed)
                self._file.sync()
                write_metadata(self.folder, self._description([*self._complete, written], reason))
                return

    def _description(self, files: Sequence[_Written], aborted: str | None) -> dict[str, Any]:
        return bag_metadata(
            [
                replace(topic, message_count=sum(file.counts.get(channel, 0) for file in files))
                for channel, topic in enumerate(self._topics, start=1)
            ],
            files=[file.record for file in files],
            custom_data={} if aborted is None else {ABORTED_KEY: aborted},
        )


@contextmanager
def _new_folder(folder: Path, file: Path) -> Iterator[ExitStack]:
    """Create the folder of a bag; an error in the block undoes this and what the block adds to the stack."""
    with ExitStack() as undo:
        try:
            for place in reversed([place for place in (folder, *folder.parents) if not place.exists()]):
                place.mkdir()
                undo.callback(place.rmdir)
            if any(folder.iterdir()):
                raise BagFolderError(f"{folder} is not empty: name a new folder for the bag")
            yield undo
        except OSError as error:
            if error.errno in REMEDIES:
                raise BagWriteError(file, error) from error
            raise BagFolderError(f"cannot create {file}: {error.strerror}; name another folder for the bag") from error


def _library() -> str:
    return " ".join(filter(None, ("swarmabs", own_version())))
