"""A recorded run as numpy arrays, and its digest."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import psutil
from numpy.typing import NDArray

from swarmabs_bag.attached import description_of, event_time, is_realtime
from swarmabs_bag.bag_summary import reference_of_bag, summarise_bag
from swarmabs_bag.errors import BagTooLargeError, DamagedBagError, NotABagError
from swarmabs_bag.reader import BagReader, open_bag
from swarmabs_bag.run.digest import digest_head
from swarmabs_core.arrays import LAYOUT, LENGTH, PADDING, RunArrays, Tables, layout_of, run_arrays, run_event
from swarmabs_core.cdr import ENCAPSULATION, FRAME, lengths_of
from swarmabs_core.messages import EVENTS, FAMILIES, ROBOT_STATES, STANDING, SwarmEvent, Topic

try:
    import resource
except ModuleNotFoundError:  # on Windows
    resource = None  # type: ignore[assignment]

if TYPE_CHECKING:
    from collections.abc import Mapping

    from swarmabs_bag.run.grouping import TopicMessages
    from swarmabs_core.systems import SystemTables

MOST_ABSENT = 50_000_000
"""Most entries of an array (steps, agents) beyond four times the number of messages."""


_MEMORY_FACTOR = 2.5
"""Peak memory of loading, as a multiple of the size of the messages."""
_EVENT_BYTES = 500
"""Memory of an event without a long text, bytes."""

_GROUP = Path("/sys/fs/cgroup")


def load_arrays(
    path: Path | str,
    *,
    namespace: str | None = None,
    damaged: bool = False,
    stride: int = 1,
) -> RunArrays:
    """Load a bag: a run folder, its ``bag/``, or an MCAP file.

    Parameters
    ----------
    namespace : str, optional
        Which swarm to read if the bag contains several.
    damaged : bool
        Whether to load a bag without its end, as far as it can be read.
    stride : int
        Only steps that are multiples of it are loaded; the others need no memory. All events are loaded.

    Raises
    ------
    BagTooLargeError
        If there is not enough memory for the arrays, before anything is read.
    NotABagError
        If it is not a bag, or lacks a main topic.
    DamagedBagError
        If the bag is damaged, or a message violates its definition.
    """
    bag = open_bag(path, namespace=namespace, damaged=damaged)
    return arrays_since(bag, load_messages(bag, stride=stride))[0]


class LoadedMessages(NamedTuple):
    """Messages of main and further topics as rows of structured arrays, and the events, in the order of the file.

    `description` is that of the parent system; `divided` is the number of messages on how the
    abstract state divides.
    """

    tables: dict[Topic, NDArray[np.void]]
    events: tuple[SwarmEvent, ...]
    description: SystemTables
    divided: int


def arrays_since(bag: BagReader, messages: LoadedMessages) -> tuple[RunArrays, float]:
    """Arrange the messages of a bag by step; also return the start of the time axis, s."""
    time = event_time(bag)
    arrays = run_arrays(
        messages.tables,
        reference=reference_of_bag(bag),
        events=[run_event(event, time(event)) for event in messages.events],
        figures=partial(summarise_bag, bag.path, bag.namespace),
        description=messages.description,
    )
    if not is_realtime(bag) or not len(arrays.time):
        return arrays, 0.0
    start = float(arrays.time[0])
    events = tuple(event._replace(time=event.time - start) for event in arrays.events)
    return replace(arrays, time=arrays.time - start, events=events), start


def load_messages(bag: BagReader, *, stride: int = 1) -> LoadedMessages:
    """Load the messages of a bag in one pass; `stride` and errors are those of `load_arrays`.

    A bag without its end may lack topics.
    """
    family, recorded = bag.family, bag.topics()
    missing = [topic.name for topic in (*family.main, *family.once) if topic not in recorded]
    if missing and not bag.problem:
        raise NotABagError(f"{bag.path} is not the bag of a swarm: it lacks {', '.join(missing)}")
    topics = (*family.main, *(topic for topic in family.further if topic in recorded))
    firsts = {topic: _first(bag, topic) for topic in topics}
    layouts = {topic: layout_of(topic, first) for topic, first in firsts.items()}
    sizes = {topic: layout.itemsize for topic, layout in layouts.items()}
    _check_memory(bag, sizes, stride)
    gathered = {topic: bytearray() for topic in topics}
    events: list[tuple[Topic, int, bytes]] = []
    divided = 0
    for messages in bag.tables((*topics, STANDING, EVENTS)):
        divided += len(messages.on(STANDING))
        events.extend((EVENTS, event.time, event.payload) for event in messages.on(EVENTS))
        _check_sizes(bag, messages, sizes)
        for topic, layout in layouts.items():
            rows = messages.on(topic).stored.rows(layout)
            gathered[topic] += (rows if stride == 1 else rows[rows["step"] % stride == 0]).tobytes()
    tables = {topic: np.frombuffer(data, dtype=layouts[topic]) for topic, data in gathered.items()}
    for topic, rows in tables.items():
        if len(rows):
            _check_heads(bag, topic, rows, lengths_of(topic.message, firsts[topic]))
    _check_density(bag, tables)
    decoded = tuple(event for _, _, event in bag.decode(events) if isinstance(event, SwarmEvent))
    return LoadedMessages(tables, decoded, description_of(bag), divided)


def _check_sizes(bag: BagReader, messages: TopicMessages, sizes: Mapping[Topic, int]) -> None:
    """Raise `DamagedBagError` for the first message whose payload is not of the size of its topic."""
    expected = np.array([sizes.get(topic, -1) for topic in messages.topics])[messages.places]
    more = messages.stored.sizes - expected
    # DDS may pad a payload to four bytes.
    wrong = np.flatnonzero((expected >= 0) & ((more < 0) | (more >= 4)))
    if len(wrong):
        (topic, log_time, _, payload), size = next(iter(messages[wrong[0] :])), int(expected[wrong[0]])
        raise DamagedBagError(
            f"{bag.path}: /{topic.name} at {log_time / 1e9:.9g} s: {len(payload)} bytes, expected {size}"
        )


def _first(bag: BagReader, topic: Topic) -> bytes:
    """Return the first payload of a topic, from which the lengths of its lists follow; empty if it has no lists."""
    return b"" if topic in LAYOUT else next((record.payload for record in bag.records((topic,))), b"")


def _check_memory(bag: BagReader, sizes: Mapping[Topic, int], stride: int) -> None:
    size = sum(sizes.get(channel.topic, 0) * channel.message_count for channel in bag.channels if channel.topic)
    events = sum(channel.message_count for channel in bag.channels if channel.topic is EVENTS)
    needed, available = int(_MEMORY_FACTOR * size / stride) + events * _EVENT_BYTES, available_memory()
    if needed > available:
        enough = stride * -(-needed // max(available, 1))
        raise BagTooLargeError(
            f"{bag.path}: its arrays need about {needed / 1e6:.0f} MB, but only {available / 1e6:.0f} MB are free; load"
            f" part of the steps, such as load_arrays(..., stride={enough}), or iterate over its messages"
        )


def _check_heads(bag: BagReader, topic: Topic, table: NDArray[np.void], lengths: tuple[int, ...]) -> None:
    heads: dict[str, np.void | int | NDArray[np.uint64]] = {
        "encapsulation": np.void(ENCAPSULATION),
        "frame": np.void(FRAME),
    }
    names = table.dtype.names or ()
    heads |= dict(zip((name for name in names if name.startswith(LENGTH)), lengths, strict=True))
    heads |= {name: table[name][:1] for name in names if name == "system"}
    for field, value in heads.items():
        wrong = np.flatnonzero(table[field] != value)
        if len(wrong):
            raise DamagedBagError(
                f"{bag.path}: /{topic.name}, message {wrong[0] + 1}: its {field} is not that of a swarm's message"
            )
    if np.any(table["step"] > np.iinfo(np.int64).max):
        raise DamagedBagError(f"{bag.path}: /{topic.name} has a step beyond 2^63")


def _check_density(bag: BagReader, tables: Tables) -> None:
    """Raise an error for a bag whose arrays would be far larger than its messages."""
    steps = len(np.unique(np.concatenate([table["step"] for table in tables.values()])))
    states = next(table for topic, table in tables.items() if topic.message in ROBOT_STATES)
    agents = len(np.unique(states["agent_id"]))
    if steps * agents > MOST_ABSENT + 4 * len(states):
        raise DamagedBagError(
            f"{bag.path}: {len(states)} states of {agents} agents over {steps} steps: too sparse to load"
        )


def digest_of(tables: Tables) -> str:
    """Return the digest (docs/reference/bag.md) of a run from its messages, those of each topic in any order.

    Padding counts as 0, because the digest covers canonical payloads.
    """
    digest = sha256()
    main = {topic for family in FAMILIES for topic in family.main}
    topics = sorted(main & tables.keys(), key=lambda topic: topic.name)
    steps = np.unique(np.concatenate([tables[topic]["step"] for topic in topics]))
    parts = []
    for topic in topics:
        rows = tables[topic]
        keys = (rows["agent_id"], rows["step"]) if topic.message in ROBOT_STATES else (rows["step"],)
        rows = rows[np.lexsort(keys)]  # a copy
        for field in rows.dtype.names or ():
            if field.startswith(PADDING):
                rows[field] = np.void(rows.dtype[field].itemsize)
        head = np.frombuffer(digest_head(topic, rows.dtype.itemsize), dtype=np.uint8)
        texts = np.empty((len(rows), len(head) + rows.dtype.itemsize), dtype=np.uint8)
        texts[:, : len(head)] = head
        texts[:, len(head) :] = np.frombuffer(rows.tobytes(), dtype=np.uint8).reshape(texts[:, len(head) :].shape)
        parts.append((texts, [*np.searchsorted(rows["step"], steps).tolist(), len(rows)]))
    for number in range(len(steps)):
        for texts, begins in parts:
            digest.update(texts[begins[number] : begins[number + 1]].tobytes())
    return digest.hexdigest()


def available_memory(group: Path = _GROUP) -> int:
    """Return the memory available to this process, bytes: the least of machine, control group and limits."""
    left = [int(psutil.virtual_memory().available)]
    with suppress(OSError, ValueError):  # ValueError: the text "max"
        most, used = ((group / name).read_text(encoding="ascii") for name in ("memory.max", "memory.current"))
        left.append(int(most) - int(used))
    if resource is not None:
        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
        if limit != resource.RLIM_INFINITY:
            left.append(limit - psutil.Process().memory_info().vms)
    return max(0, min(left))
