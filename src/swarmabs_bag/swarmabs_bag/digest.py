"""The digest of a run whose messages are in memory; `swarmabs_bag.recording.Digest` is that of one which passes by."""

from __future__ import annotations

from hashlib import sha256
from typing import TYPE_CHECKING

import numpy as np

from swarmabs_bag.recording import digest_head
from swarmabs_core.arrays import PADDING
from swarmabs_core.messages import AGENT_STATE, MAIN_TOPICS

if TYPE_CHECKING:
    from swarmabs_core.arrays import Tables


def digest_of(tables: Tables) -> str:
    """Return the digest (docs/design.md, Digest) of a run whose messages are given in any order.

    Padding counts as 0, whatever another recorder has left there: the digest is one of canonical payloads.
    """
    found = sha256()
    topics = sorted(MAIN_TOPICS, key=lambda topic: topic.name)
    steps = np.unique(np.concatenate([tables[topic]["step"] for topic in topics]))
    parts = []
    for topic in topics:
        rows = tables[topic]
        keys = (rows["agent_id"], rows["step"]) if topic is AGENT_STATE else (rows["step"],)
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
            found.update(texts[begins[number] : begins[number + 1]].tobytes())
    return found.hexdigest()
