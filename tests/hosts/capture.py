"""What passes an interface of a test host: a process that looks at every frame, and how a test uses it.

Usage: python -m tests.hosts.capture INTERFACE
"""

from __future__ import annotations

import json
import selectors
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from tests.hosts.cluster import Host, finish, until_ready
from tests.hosts.namespaces import say

_EVERY_PROTOCOL = 3


def watch(interface: str) -> None:
    """Count frames, and those with a DDS message in them, until standard input ends."""
    counts = {"frames": 0, "dds": 0}
    with (
        socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0) as frames,
        selectors.DefaultSelector() as selector,
    ):
        frames.bind((interface, _EVERY_PROTOCOL))
        selector.register(frames, selectors.EVENT_READ)
        selector.register(sys.stdin, selectors.EVENT_READ)
        say("ready")
        while sys.stdin not in (ready := [key.fileobj for key, _ in selector.select()]):
            assert frames in ready
            counts["frames"] += 1
            counts["dds"] += b"RTPS" in frames.recv(65536)
    say(json.dumps(counts))


@contextmanager
def captured(host: Host, interface: str) -> Iterator[dict[str, int]]:
    """Count the frames that pass an interface during the block; the numbers are there after it."""
    pipe = subprocess.PIPE
    process = host.python("tests.hosts.capture", interface, stdin=pipe, stdout=pipe, stderr=pipe)
    until_ready(process)
    counts: dict[str, int] = {}
    yield counts
    counts.update(json.loads(finish(process)))


if __name__ == "__main__":
    watch(sys.argv[1])
