"""Writing a run into a bag: an MCAP file that ROS tools open, crash-safe while it is written."""

from __future__ import annotations

import errno
import time
from contextlib import ExitStack, contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, cast

from mcap.records import Metadata
from mcap.writer import CompressionType, Writer

from swarmabs_bringup.bag.errors import BagFolderError, BagWriteError
from swarmabs_bringup.bag.index import scan_index, tail
from swarmabs_bringup.bag.metadata import (
    ABORTED_KEY,
    RECORD_KEY,
    RECORD_NAME,
    TopicRecord,
    bag_metadata,
    dump_yaml,
    qos_yaml,
    write_metadata,
)
from swarmabs_bringup.bag.output import RecordFile, Reserve
from swarmabs_bringup.bag.records import RecordError
from swarmabs_bringup.bag.schemas import message_schema
from swarmabs_ros.qos import OFFERED

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from types import TracebackType

    from typing_extensions import Self

    from swarmabs_bringup.bag.schemas import MessageSchema
    from swarmabs_core.messages import Topic
    from swarmabs_ros.qos import Qos

BAG_FILE = "bag_0.mcap"
"""Name of the MCAP file in a bag's folder."""

CHUNK_SECONDS = 1.0
CHUNK_BYTES = 2**20

_PROFILE = "ros2"
_SEQUENCE_MASK = 2**32 - 1
_MEDIA_TYPES = {".yaml": "application/yaml", ".json": "application/json"}

# What is kept back for the end of the file and metadata.yaml: they grow with the number of chunks.
_RESERVE_BASE = 2**18
_RESERVE_PER_CHUNK = 256
_MAX_CHUNKS_GIVEN_UP = 8


class BagWriter:
    """Writer of a bag with one MCAP file.

    Messages are gathered in chunks. A chunk is compressed and handed to the operating system when it holds
    `chunk_bytes` or when its first message was written `chunk_seconds` ago, so a SIGKILL costs at most the
    current chunk. Only `close` and `abort` write the summary section and ``metadata.yaml``.

    Use it as a context manager: leaving the block closes the bag, an exception in the block aborts it.

    Parameters
    ----------
    folder : Path
        The bag's folder; it is created, or must be empty.
    topics : sequence of Topic
        All topics that may be written, also those on which nothing may ever come.
    attachments : mapping of str to bytes
        What is attached at once, by name: the resolved scenario, the provenance.
    namespace : str
        Namespace of the swarm: the bag holds ``/plane/state`` by default.
    qos : mapping of Topic to Qos
        What the publishers of each topic offer.
    chunk_seconds : float
        Longest time in s until a message is with the operating system; when writes pause, `poll` keeps it.
    chunk_bytes : int
        Size of a chunk before compression.
    monotonic : callable
        The clock for `chunk_seconds`.

    Raises
    ------
    BagFolderError
        If the folder is not empty or cannot be written; nothing is left behind.
    UnknownTypeError
        If the definition of a topic's type is not installed; nothing is left behind.
    BagWriteError
        If the disk is full or fails; nothing is left behind.
    """

    def __init__(
        self,
        folder: Path,
        *,
        topics: Sequence[Topic],
        attachments: Mapping[str, bytes],
        namespace: str = "/",
        qos: Mapping[Topic, Qos] = OFFERED,
        chunk_seconds: float = CHUNK_SECONDS,
        chunk_bytes: int = CHUNK_BYTES,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self.folder = folder
        self.path = folder / BAG_FILE
        self._chunk_seconds = chunk_seconds
        self._monotonic = monotonic
        self._chunk_opened: float | None = None
        self._chunks = 0
        self._first: int | None = None
        self._last = 0
        self._error: BagWriteError | None = None
        self._closed = False
        schemas = {topic.ros_type: message_schema(topic.ros_type) for topic in topics}
        self._topics = [
            TopicRecord(
                name=f"{namespace.rstrip('/')}/{topic.name}",
                ros_type=topic.ros_type,
                type_hash=schemas[topic.ros_type].type_hash,
                qos=qos[topic],
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
            self._writer = Writer(
                cast("IO[bytes]", self._file),  # of a file, the library uses `write`, `tell` and `flush`
                chunk_size=chunk_bytes,
                compression=CompressionType.ZSTD,
                enable_data_crcs=True,
            )
            self._writer.start(profile=_PROFILE, library=_library())
            self._attach(attachments)
            self._file.commit()
            # From here on all of it stays.
            undo.pop_all()
        channels = self._register(schemas)
        self._channels = {topic.name: channel for topic, channel in zip(topics, channels, strict=True)}
        self._counts = dict.fromkeys(channels, 0)

    def _register(self, schemas: Mapping[str, MessageSchema]) -> list[int]:
        ids = {
            name: self._writer.register_schema(name=name, encoding="ros2msg", data=schema.text.encode())
            for name, schema in schemas.items()
        }
        return [
            self._writer.register_channel(
                topic=topic.name,
                message_encoding="cdr",
                schema_id=ids[topic.ros_type],
                metadata={"offered_qos_profiles": qos_yaml(topic.qos), "topic_type_hash": topic.type_hash},
            )
            for topic in self._topics
        ]

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

    def write(self, topic: Topic, log_time_ns: int, payload: bytes) -> None:
        """Write a message; log and publish time are the same.

        Parameters
        ----------
        topic : Topic
            One of those named at opening.
        log_time_ns : int
            Time in ns, not negative; in lockstep that of the message's header.
        payload : bytes
            CDR with its encapsulation header.

        Raises
        ------
        BagWriteError
            If the disk is full or fails. The messages of the current chunk are lost; call `abort`.
        """
        self._check_open()
        channel = self._channels[topic.name]
        if log_time_ns < 0:
            raise ValueError(f"{topic.name}: log time {log_time_ns} ns is negative")
        if self._chunk_opened is None:
            self._chunk_opened = self._monotonic()
        self._writer.add_message(
            channel_id=channel,
            log_time=log_time_ns,
            data=payload,
            publish_time=log_time_ns,
            sequence=self._counts[channel] & _SEQUENCE_MASK,
        )
        self._counts[channel] += 1
        self._first = log_time_ns if self._first is None else min(self._first, log_time_ns)
        self._last = max(self._last, log_time_ns)
        if self._file.pending:  # the library has closed a full chunk
            self._end_chunk()
        else:
            self.poll()

    def poll(self) -> None:
        """Close the current chunk and hand it to the operating system if it is older than `chunk_seconds`.

        Raises
        ------
        BagWriteError
            As `write`.
        """
        self._check_open()
        if self._chunk_opened is not None and self._monotonic() - self._chunk_opened >= self._chunk_seconds:
            self._writer.flush()
            self._end_chunk()

    def close(self, attachments: Mapping[str, bytes] | None = None) -> None:
        """Write what is left, the summary section, and ``metadata.yaml``.

        Parameters
        ----------
        attachments : mapping of str to bytes, optional
            What is attached at the end, by name: the run's log.

        Raises
        ------
        BagWriteError
            If the disk is full or fails. What was written before was then already completed as by `abort`.
        """
        self._check_open()
        try:
            self._finish(attachments or {}, aborted=None)
        except BagWriteError as error:
            self.abort(reason=str(error))
            raise

    def abort(self, reason: str = "aborted", attachments: Mapping[str, bytes] | None = None) -> None:
        """Complete the bag of a run that failed, as far as possible, so that it can be read.

        After a write error, the file is completed with what was written before. Where not even the space kept
        back for this is enough, the last chunks are given up for it. No error is raised; if nothing helps,
        the file ends behind its last whole record, without summary section and without ``metadata.yaml``.

        Parameters
        ----------
        reason : str
            Why the run failed; it stands under ``custom_data`` of ``metadata.yaml``.
        attachments : mapping of str to bytes, optional
            What is attached at the end, unless writing failed before.
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

    def _attach(self, attachments: Mapping[str, bytes]) -> None:
        for name, data in attachments.items():
            self._writer.add_attachment(
                create_time=0,
                log_time=self._last,
                name=name,
                media_type=_MEDIA_TYPES.get(Path(name).suffix, "text/plain"),
                data=data,
            )

    @contextmanager
    def _remembering_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self._error = BagWriteError(self.path, error)
            raise self._error from error

    def _end_chunk(self) -> None:
        self._chunk_opened = None
        self._chunks += 1
        with self._remembering_errors():
            self._file.commit()
            self._reserve.hold(_RESERVE_BASE + self._chunks * _RESERVE_PER_CHUNK)

    def _finish(self, attachments: Mapping[str, bytes], *, aborted: str | None) -> None:
        with self._remembering_errors():
            self._writer.flush()
            self._file.commit()
            self._attach(attachments)
            self._file.commit()
            description = self._description(self._counts, (self._first or 0, self._last), aborted)
            self._writer.add_metadata(RECORD_NAME, {RECORD_KEY: dump_yaml(description)})
            self._writer.finish()
            self._file.commit()
            self._file.sync()
            self._closed = True
            self._reserve.release()
            self._file.close()
            write_metadata(self.folder, description)

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
            statistics = index.statistics
            description = self._description(
                statistics.channel_message_counts,
                (statistics.message_start_time, statistics.message_end_time),
                reason,
            )
            try:
                record = Metadata(name=RECORD_NAME, metadata={RECORD_KEY: dump_yaml(description)})
                self._file.write(index.add_metadata(record))
                for piece in tail(index):
                    self._file.write(piece)
                self._file.commit()
            except OSError:
                if not index.chunks:
                    raise
                self._file.cut(index.chunks[-1].chunk_start_offset)
            else:
                self._file.cut(self._file.committed)
                self._file.sync()
                write_metadata(self.folder, description)
                return

    def _description(self, counts: Mapping[int, int], span: tuple[int, int], aborted: str | None) -> dict[str, Any]:
        start, end = span
        return bag_metadata(
            [(topic, counts.get(channel, 0)) for channel, topic in enumerate(self._topics, start=1)],
            file=BAG_FILE,
            start=start,
            end=end,
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
            if error.errno in {
                errno.ENOSPC,
                errno.EDQUOT,
                errno.EIO,
                errno.EFBIG,
                errno.EMFILE,
                errno.ENFILE,
            }:
                raise BagWriteError(file, error) from error
            raise BagFolderError(f"cannot create {file}: {error.strerror}; name another folder for the bag") from error


def _library() -> str:
    try:
        return f"swarmabs {version('swarmabs_bringup')}"
    except PackageNotFoundError:  # run from the source tree without having been built
        return "swarmabs"
