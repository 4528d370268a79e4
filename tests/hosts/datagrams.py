"""Numbered datagrams between test hosts, sent and received by the test itself."""

import socket
import struct
import time
from contextlib import suppress

from tests.hosts.cluster import Host

_PORT = 5000
_HEAD = struct.Struct("<qd")
_SO_RCVBUFFORCE, _BUFFER = 33, 16 * 2**20


class Receiver:
    """What a host receives at its first address."""

    def __init__(self, host: Host) -> None:
        self._place = (host.address, _PORT)
        self._socket = host.udp(_PORT)
        self._socket.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _BUFFER)
        self._socket.settimeout(0.1)
        self._last = 0

    def hear(self, sender: Host, number: int, count: int = 50, size: int = 100) -> None:
        """Let a host send it datagrams of some size (bytes) with numbers from this one on."""
        speak = sender.udp()
        for each in range(number, number + count):
            self._send(speak, each, size)

    def _send(self, speak: socket.socket, number: int, size: int = _HEAD.size) -> None:
        speak.sendto(_HEAD.pack(number, time.monotonic()).ljust(size), self._place)

    def heard(self, sender: Host) -> list[tuple[int, float]]:
        """Return numbers and delays (s) of what has come in order, up to a last word of a host that gets through."""
        self._last -= 1
        found: list[tuple[int, float]] = []
        speak = sender.udp()
        while True:
            self._send(speak, self._last)  # again if it was lost
            with suppress(TimeoutError):
                while (head := _HEAD.unpack_from(self._socket.recv(65_536)))[0] != self._last:
                    found.append((head[0], time.monotonic() - head[1]))
                return [(number, delay) for number, delay in found if number >= 0]
