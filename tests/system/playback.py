"""A stock ROS node that listens to a playback, and what it should have heard."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from tests.system.helpers import BagMessage

TOPICS = ("/plane/state", "/swarm/desired_abstract_state", "/swarm/events")
LONGEST = 80
"""Time, s, after which a listener gives up."""


@contextmanager
def listening(out: Path, environment: Mapping[str, str]) -> Iterator[subprocess.Popen[str]]:
    """Let ``listener.py`` listen to the topics and write into a file; it is killed if it goes on behind the block."""
    words = [sys.executable, str(Path(__file__).with_name("listener.py")), str(out), str(LONGEST), *TOPICS]
    logs = {"ROS_LOG_DIR": str(out.parent)}
    with subprocess.Popen(
        words, env={**os.environ, **environment, **logs}, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def assert_heard(out: Path, messages: Sequence[BagMessage]) -> int:
    """Assert that a listener has heard these messages of its topics, byte for byte; return how many.

    A reliable reader, however slow, loses none as long as no topic has more messages than its depth of 100.
    """
    heard = json.loads(out.read_text())
    for topic in TOPICS:
        sent = [message.payload for message in messages if f"/{message.topic}" == topic]
        assert 0 < len(sent) <= 100, topic
        received = [bytes.fromhex(text) for text in heard[topic]["messages"]]
        assert [data[: len(wanted)] for data, wanted in zip(received, sent, strict=True)] == sent, topic
        assert {len(data) - len(wanted) for data, wanted in zip(received, sent, strict=True)} <= {0, 1, 2, 3}  # padding
    assert heard["/plane/state"]["qos"] == ["RELIABLE", "VOLATILE"]
    assert heard["/swarm/events"]["qos"] == ["RELIABLE", "TRANSIENT_LOCAL"]
    return sum(len(heard[topic]["messages"]) for topic in TOPICS)
