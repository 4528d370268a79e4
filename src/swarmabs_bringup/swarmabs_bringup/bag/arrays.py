"""A recorded run as numpy arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from swarmabs_bringup.bag.errors import DamagedBagError, NotABagError
from swarmabs_bringup.bag.reader import BagReader, open_bag
from swarmabs_core.arrays import LAYOUT, RunArrays, Tables, run_arrays, table
from swarmabs_core.messages import AGENT_STATE, FRAME_ID, MAIN_TOPICS, Topic

if TYPE_CHECKING:
    from pathlib import Path

_FRAME = FRAME_ID.encode() + b"\0"
_ENCAPSULATION = b"\0\1"

_SPARSE = 50_000_000
"""Most entries of an array (steps, agents) beyond four times the number of messages."""


def load_arrays(path: Path | str, *, namespace: str | None = None, damaged: bool = False) -> RunArrays:
    """Load the main topics of a bag.

    Parameters
    ----------
    path : Path or str
        A run folder, its ``bag/``, or an MCAP file.
    namespace : str, optional
        Which swarm to read if the bag holds several.
    damaged : bool
        Whether a bag without its end is loaded too, as far as it can be read.

    Raises
    ------
    NotABagError
        If it is no bag, or has not all five main topics.
    DamagedBagError
        If the bag is damaged, or a message is not as the contract says.
    """
    bag = open_bag(path, namespace=namespace, damaged=damaged)
    missing = [topic.name for topic in MAIN_TOPICS if topic not in bag.topics()]
    if missing and not bag.problem:
        raise NotABagError(f"{bag.path} is no bag of a swarm: it has no topic {', '.join(missing)}")
    tables = _tables(bag)
    _check_density(bag, tables)
    return run_arrays(tables)


def _tables(bag: BagReader) -> dict[Topic, NDArray[np.void]]:
    sizes = {topic: layout.itemsize for topic, layout in LAYOUT.items()}
    gathered = {topic: bytearray() for topic in MAIN_TOPICS}
    for topic, log_time, payload in bag.messages(MAIN_TOPICS):
        size = sizes[topic]
        # DDS may pad a payload to four bytes.
        if not size <= len(payload) < size + 4:
            raise DamagedBagError(
                f"{bag.path}: /{topic.name} at {log_time / 1e9:.9g} s: {len(payload)} bytes, expected {size}"
            )
        gathered[topic] += payload[:size]
    tables = {topic: table(topic, data) for topic, data in gathered.items()}
    for topic, rows in tables.items():
        _check_heads(bag, topic, rows)
    return tables


def _check_heads(bag: BagReader, topic: Topic, table: NDArray[np.void]) -> None:
    expected = {
        "encapsulation": np.void(_ENCAPSULATION),
        "frame": np.void(_FRAME),
        "frame_length": len(_FRAME),
    }
    for field, value in expected.items():
        wrong = np.flatnonzero(table[field] != value)
        if len(wrong):
            raise DamagedBagError(
                f"{bag.path}: /{topic.name}, message {wrong[0] + 1}: "
                f"its {field.replace('_', ' ')} is not that of a swarm's message"
            )
    if np.any(table["step"] > np.iinfo(np.int64).max):
        raise DamagedBagError(f"{bag.path}: /{topic.name} has a step beyond 2^63")


def _check_density(bag: BagReader, tables: Tables) -> None:
    """Refuse a bag whose arrays would be out of all proportion to its messages."""
    steps = len(np.unique(np.concatenate([table["step"] for table in tables.values()])))
    states = tables[AGENT_STATE]
    agents = len(np.unique(states["agent_id"]))
    if steps * agents > _SPARSE + 4 * len(states):
        raise DamagedBagError(
            f"{bag.path}: {len(states)} states of {agents} agents over {steps} steps: too sparse to load"
        )
