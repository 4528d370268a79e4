"""Datagrams between test hosts: a sender that numbers them, a receiver that notes what comes, and their use in tests.

Usage: python -m tests.hosts.datagrams receive ADDRESS PORT
       python -m tests.hosts.datagrams send ADDRESS PORT FIRST COUNT SIZE PERIOD
       python -m tests.hosts.datagrams end ADDRESS PORT

The receiver prints "ready", and at the end a JSON list of [number, delay in s] in the order of arrival. All hosts have
the same monotonic clock. The order to end is repeated until the receiver is no longer there, since it may be lost.
"""

from __future__ import annotations

import json
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable

from tests.hosts.cluster import Host, finish, until_ready
from tests.hosts.namespaces import say

_MODULE = "tests.hosts.datagrams"
_PORT = 5000
_HEAD = struct.Struct("<Qd")
_LAST = 2**64 - 1
_SO_RCVBUFFORCE, _BUFFER = 33, 16 * 2**20


def receive(address: str, port: str) -> None:
    """Note what comes until the last datagram."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as hear:
        hear.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _BUFFER)
        hear.bind((address, int(port)))
        say("ready")
        arrived = []
        while True:
            datagram = hear.recv(65536)
            number, sent = _HEAD.unpack_from(datagram)
            if number == _LAST:
                break
            arrived.append((number, time.monotonic() - sent))
    say(json.dumps(arrived))


def send(address: str, port: str, first: str, count: str, size: str, period: str) -> None:
    """Send numbered datagrams, one each period (s), of some size (bytes)."""
    filling = bytes(int(size) - _HEAD.size)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as speak:
        start = time.monotonic()
        for sent in range(int(count)):
            time.sleep(max(start + sent * float(period) - time.monotonic(), 0.0))
            speak.sendto(_HEAD.pack(int(first) + sent, time.monotonic()) + filling, (address, int(port)))


def end(address: str, port: str) -> None:
    """Let a receiver end."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as speak:
        speak.connect((address, int(port)))
        try:
            while True:
                speak.send(_HEAD.pack(_LAST, time.monotonic()))
                time.sleep(0.02)
        except ConnectionRefusedError:
            pass


class Receiver:
    """What a host receives at one of its addresses; at the first if none is given."""

    def __init__(self, host: Host, address: str | None = None) -> None:
        self._address = address or host.address
        words = (_MODULE, "receive", self._address, _PORT)
        self._process = host.python(*words, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        until_ready(self._process)

    def hear(self, sender: Host, first: int, count: int, *, size: int = 100, period: float = 2e-4) -> None:
        """Let another host send it datagrams, with numbers from `first` on."""
        finish(sender.python(_MODULE, "send", self._address, _PORT, first, count, size, period))

    def heard(self, sender: Host) -> list[tuple[int, float]]:
        """Let another host end it; return numbers and delays (s) of what has come, in order."""
        finish(sender.python(_MODULE, "end", self._address, _PORT))
        return [(number, delay) for number, delay in json.loads(finish(self._process))]


if __name__ == "__main__":
    tasks: dict[str, Callable[..., None]] = {"receive": receive, "send": send, "end": end}
    tasks[sys.argv[1]](*sys.argv[2:])
