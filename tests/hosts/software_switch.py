"""An Ethernet switch as a process that delays, loses, doubles and reorders frames, for kernels without netem.

It takes the frames from the switch's ends of the cables by packet sockets. Each cable has a `Channel` in each
direction. Commands come as JSON lines on standard input; each is answered, so what it asks for holds from then on.

Usage: python -m tests.hosts.software_switch PARENT SEED
"""

from __future__ import annotations

import ctypes
import fcntl
import heapq
import itertools
import json
import os
import select
import socket
import struct
import subprocess
import sys
import time
from collections import Counter
from functools import partial
from typing import Any

from tests.hosts.impairment import Channel, Impairment
from tests.hosts.namespaces import hold_cables, say

_EVERY_PROTOCOL = 3  # ETH_P_ALL
_SOL_PACKET, _PACKET_IGNORE_OUTGOING = 263, 23
_SO_RCVBUFFORCE, _BUFFER = 33, 16 * 2**20
_LARGEST_FRAME = 65_600
_SIOCETHTOOL = 0x8946
_OFFLOADS = (0x17, 0x1F, 0x24)
"""ETHTOOL_STXCSUM, ETHTOOL_STSO, ETHTOOL_SGSO."""
_AT_ONCE = 64
"""Frames that are read from one cable before the others have their turn."""


class _Port:
    """The switch's end of one cable."""

    def __init__(self, interface: str, seed: str) -> None:
        self.interface = interface
        self.group = 0
        self.channels = {direction: Channel(f"{seed} {interface} {direction}") for direction in ("from", "to")}
        self.socket = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0)
        self.socket.setblocking(False)
        self.socket.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _BUFFER)
        self.socket.setsockopt(_SOL_PACKET, _PACKET_IGNORE_OUTGOING, 1)
        self.socket.bind((interface, _EVERY_PROTOCOL))


class SoftwareSwitch:
    """Ports by number, the addresses learnt, and the frames under way."""

    def __init__(self, seed: str) -> None:
        self._seed = seed
        self._ports: dict[int, _Port] = {}
        self.sockets: dict[int, int] = {}
        """The ports by the descriptor of their socket."""
        self._learnt: dict[bytes, int] = {}
        self._waiting: list[tuple[float, int, int, str, bytes]] = []
        self._order = itertools.count()
        self._counts: Counter[str] = Counter()

    # Commands

    def command(self, words: list[Any]) -> object:
        """Obey a command; return what is answered."""
        name, *arguments = words
        return getattr(self, f"do_{name}")(*arguments)

    def do_attach(self, port: int, host: int, interface: str, hardware: str) -> None:
        self._ports[port] = _Port(_lay_cable(port, host, interface, hardware), self._seed)
        self.sockets = {attached.socket.fileno(): number for number, attached in self._ports.items()}

    def do_detach(self, port: int) -> None:
        gone = self._ports.pop(port)
        self.sockets = {attached.socket.fileno(): number for number, attached in self._ports.items()}
        self._learnt = {address: at for address, at in self._learnt.items() if at != port}
        gone.socket.close()
        # The kernel takes its time to remove what belonged to a dead host; if it was quicker, there is nothing to do.
        subprocess.run(["ip", "link", "delete", gone.interface], check=False, stderr=subprocess.DEVNULL)

    def do_impair(self, port: int, direction: str, how: dict[str, float]) -> None:
        self._ports[port].channels[direction].impairment = Impairment(**how)

    def do_group(self, port: int, group: int) -> None:
        self._ports[port].group = group

    def do_counts(self) -> dict[str, int]:
        return dict(self._counts)

    # Frames

    def patience(self, now: float) -> float | None:
        """Return how long nothing needs to be done, s."""
        return max(self._waiting[0][0] - now, 0.0) if self._waiting else None

    def read(self, descriptor: int, now: float) -> None:
        """Take what has come by one cable."""
        number = self.sockets[descriptor]
        receive = self._ports[number].socket.recv
        for _ in range(_AT_ONCE):
            try:
                frame = receive(_LARGEST_FRAME)
            except OSError:  # there is no more, or the host has just died
                return
            self._learnt[frame[6:12]] = number
            self._enter(number, "from", frame, now)

    def release(self, now: float) -> None:
        """Move on all frames whose time has come."""
        while self._waiting and self._waiting[0][0] <= now:
            _, _, number, direction, frame = heapq.heappop(self._waiting)
            if number not in self._ports:
                self._counts["to the dead"] += 1
            elif direction == "to":
                self._send(number, frame)
            else:
                self._distribute(number, frame, now)

    def _enter(self, number: int, direction: str, frame: bytes, now: float) -> None:
        departures = self._ports[number].channels[direction].departures(now)
        self._counts["lost"] += not departures
        self._counts["duplicated"] += len(departures) > 1
        for due in departures:
            heapq.heappush(self._waiting, (due, next(self._order), number, direction, frame))

    def _distribute(self, source: int, frame: bytes, now: float) -> None:
        """Send a frame to the one who is known to have the address, else to everybody, within the group."""
        known = self._learnt.get(frame[:6])
        group = self._ports[source].group
        for number in tuple(self._ports) if known is None else (known,):
            if number == source:
                continue
            if self._ports[number].group == group:
                self._enter(number, "to", frame, now)
            else:
                self._counts["partitioned"] += 1

    def _send(self, number: int, frame: bytes) -> None:
        try:
            self._ports[number].socket.send(frame)
            self._counts["delivered"] += 1
        except OSError:  # its buffers are full, or the host has just died
            self._counts["refused"] += 1


def _disable_offload(interface: str) -> None:
    """Let the kernel compute checksums and cut frames to size: what a packet socket takes must be whole."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        for setting in _OFFLOADS:
            value = (ctypes.c_uint32 * 2)(setting, 0)
            fcntl.ioctl(control, _SIOCETHTOOL, struct.pack("16sP16x", interface.encode(), ctypes.addressof(value)))


def _lay_cable(port: int, host: int, interface: str, hardware: str) -> str:
    """Make a cable into the network namespace of a process; return the name of the switch's end."""
    here, there = f"port{port}", f"cable{port}"
    run = partial(subprocess.run, check=True)
    run(["ip", "link", "add", here, "type", "veth", "peer", "name", there, "address", hardware])
    _disable_offload(there)
    run(["ip", "link", "set", there, "netns", str(host), "name", interface])
    run(["nsenter", f"--target={host}", "--net", "--", "ip", "link", "set", interface, "up"])
    run(["ip", "link", "set", here, "up"])
    return here


def main() -> None:
    """Switch frames until standard input ends."""
    parent, seed = int(sys.argv[1]), sys.argv[2]
    hold_cables(parent)
    switch = SoftwareSwitch(seed)
    pending = b""
    while True:
        ready, _, _ = select.select([0, *switch.sockets], [], [], switch.patience(time.monotonic()))
        now = time.monotonic()
        for descriptor in ready:
            if descriptor:
                switch.read(descriptor, now)
        switch.release(now)
        if 0 in ready:
            received = os.read(0, 65536)
            if not received:
                return
            *lines, pending = (pending + received).split(b"\n")
            for line in lines:
                say(json.dumps(switch.command(json.loads(line))))


if __name__ == "__main__":
    main()
