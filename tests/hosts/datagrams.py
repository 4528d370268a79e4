"""Datagrams between test hosts: a sender that numbers them, and a receiver that notes what comes.

Usage: python -m tests.hosts.datagrams receive PORT
       python -m tests.hosts.datagrams send ADDRESS PORT FIRST COUNT SIZE PERIOD
       python -m tests.hosts.datagrams end ADDRESS PORT

The receiver prints "ready", and at the end a JSON list of [number, delay in s] in the order of arrival. All hosts have
the same monotonic clock. The order to end is repeated until the receiver is no longer there, since it may be lost.
"""

from __future__ import annotations

import json
import socket
import struct
import sys
import time
from collections.abc import Callable

from tests.hosts.namespaces import say

_HEAD = struct.Struct("<Qd")
_LAST = 2**64 - 1
_SO_RCVBUFFORCE, _BUFFER = 33, 16 * 2**20


def receive(port: str) -> None:
    """Note what comes until the last datagram."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as hear:
        hear.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _BUFFER)
        hear.bind(("", int(port)))
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


if __name__ == "__main__":
    tasks: dict[str, Callable[..., None]] = {"receive": receive, "send": send, "end": end}
    tasks[sys.argv[1]](*sys.argv[2:])
