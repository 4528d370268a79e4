"""An Ethernet switch as a process that delays, loses, doubles and reorders frames, by a seed.

It takes the frames from the switch's ends of the cables by packet sockets. Commands come as JSON lines on standard
input; each is answered, so what it asks for holds from then on.

Usage: unshare --net python -m tests.hosts.switch SEED
"""

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
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

from tests.hosts.namespaces import say
from tests.processes import SEARCH_PATH

_EVERY_PROTOCOL = 3  # ETH_P_ALL
_SOL_PACKET, _PACKET_IGNORE_OUTGOING = 263, 23
_SO_RCVBUFFORCE, _BUFFER = 33, 16 * 2**20
_LARGEST_FRAME = 65_600
_SIOCETHTOOL = 0x8946
_OFFLOADS = (0x17, 0x1F, 0x24)
"""ETHTOOL_STXCSUM, ETHTOOL_STSO, ETHTOOL_SGSO."""
_AT_ONCE = 64
"""Frames that are read from one cable before the others have their turn."""
DIRECTIONS = ("from", "to")
"""Of a cable, seen from the host."""


@dataclass(frozen=True)
class Impairment:
    """Delay and jitter in s (uniform in delay ± jitter), loss and duplicate as probabilities per frame.

    A frame with less delay overtakes those before it, as in netem.
    """

    delay: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0
    duplicate: float = 0.0

    def departures(self, now: float, draw: Random) -> list[float]:
        """Return when a frame that arrives now leaves, s: not at all if it is lost, twice if it is doubled."""
        lost, doubled = draw.random() < self.loss, draw.random() < self.duplicate
        due = now + self.delay + draw.uniform(-self.jitter, self.jitter)
        return [due] * (0 if lost else 1 + doubled)


PERFECT = Impairment()


class Switch:
    """This switch as a process in a network namespace of its own: one port, one cable for each host.

    It does what `_Frames` does, by these names without "do_".
    """

    def __init__(self, seed: str) -> None:
        pipe = subprocess.PIPE
        words = ["unshare", "--net", sys.executable, "-m", __name__, seed]
        environment = os.environ | SEARCH_PATH
        self._process = subprocess.Popen(
            words, stdin=pipe, stdout=pipe, env=environment, text=True, start_new_session=True
        )

    @property
    def process(self) -> int:
        return self._process.pid

    def __getattr__(self, name: str) -> Callable[..., Any]:
        def command(*words: object) -> Any:
            assert self._process.stdin is not None and self._process.stdout is not None
            self._process.stdin.write(json.dumps([name, *words]) + "\n")
            self._process.stdin.flush()
            answer = self._process.stdout.readline()
            assert answer, "the switch has ended; its message stands above"
            return json.loads(answer)

        return command

    def close(self) -> None:
        """End it, and with it all cables."""
        with self._process as process:
            process.kill()


class _Port:
    """The switch's end of one cable."""

    def __init__(self, interface: str) -> None:
        self.interface = interface
        self.group = 0
        self.impaired = dict.fromkeys(DIRECTIONS, PERFECT)
        self.socket = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0)
        self.socket.setblocking(False)
        self.socket.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _BUFFER)
        self.socket.setsockopt(_SOL_PACKET, _PACKET_IGNORE_OUTGOING, 1)
        self.socket.bind((interface, _EVERY_PROTOCOL))


class _Frames:
    """Ports by number, the addresses learnt, and the frames under way."""

    def __init__(self, seed: str) -> None:
        self._draw = Random(seed)
        self._ports: dict[int, _Port] = {}
        self._learnt: dict[bytes, int] = {}
        self._waiting: list[tuple[float, int, int, str, bytes]] = []
        self._order = itertools.count()
        self._dds_messages = 0

    def sockets(self) -> dict[int, int]:
        """Return the ports by the descriptor of their socket."""
        return {attached.socket.fileno(): number for number, attached in self._ports.items()}

    def do_attach(self, port: int, host: int, interface: str, hardware: str) -> None:
        """Lay a cable into the network namespace of process `host`; `interface` and hardware address are its end's.

        The host's end is set up before the switch's, so the cable carries as soon as the host's end says so.
        """
        self._ports[port] = _Port(_lay_cable(port, host, interface, hardware))

    def do_detach(self, port: int) -> None:
        gone = self._ports.pop(port)
        self._learnt = {address: at for address, at in self._learnt.items() if at != port}
        gone.socket.close()
        # The kernel takes its time to remove what belonged to a dead host; if it was quicker, there is nothing to do.
        subprocess.run(["ip", "link", "delete", gone.interface], check=False, stderr=subprocess.DEVNULL)

    def do_impair(self, port: int, direction: str, how: dict[str, float]) -> None:
        self._ports[port].impaired[direction] = Impairment(**how)

    def do_group(self, port: int, group: int) -> None:
        """Put a port into a group; only ports of the same group reach each other. All are in group 0 at first."""
        self._ports[port].group = group

    def do_dds_messages(self) -> int:
        """Return how many frames with a DDS message hosts have sent so far."""
        return self._dds_messages

    def patience(self, now: float) -> float | None:
        """Return how long nothing needs to be done, s."""
        return max(self._waiting[0][0] - now, 0.0) if self._waiting else None

    def read(self, number: int) -> None:
        """Take what has come by one cable."""
        for _ in range(_AT_ONCE):
            try:
                frame = self._ports[number].socket.recv(_LARGEST_FRAME)
            except OSError:  # there is no more, or the host has just died
                return
            self._dds_messages += b"RTPS" in frame
            self._learnt[frame[6:12]] = number
            # Each frame has its own time: one that comes while others are taken is not delayed too little.
            self._enter(number, "from", frame, time.monotonic())

    def release(self, now: float) -> None:
        """Move on all frames whose time has come."""
        while self._waiting and self._waiting[0][0] <= now:
            _, _, number, direction, frame = heapq.heappop(self._waiting)
            if number not in self._ports:  # the host has died
                continue
            if direction == "to":
                with suppress(OSError):  # its buffers are full, or the host has just died
                    self._ports[number].socket.send(frame)
            else:
                self._distribute(number, frame, now)

    def _enter(self, number: int, direction: str, frame: bytes, now: float) -> None:
        for due in self._ports[number].impaired[direction].departures(now, self._draw):
            heapq.heappush(self._waiting, (due, next(self._order), number, direction, frame))

    def _distribute(self, source: int, frame: bytes, now: float) -> None:
        """Send a frame to the one who is known to have the address, else to everybody, within the group."""
        known = self._learnt.get(frame[:6])
        for number in tuple(self._ports) if known is None else (known,):
            if number != source and self._ports[number].group == self._ports[source].group:
                self._enter(number, "to", frame, now)


def _lay_cable(port: int, host: int, interface: str, hardware: str) -> str:
    """Make a cable into the network namespace of a process; return the name of the switch's end."""
    here, there = f"port{port}", f"cable{port}"
    subprocess.run(["ip", "link", "add", here, "type", "veth", "peer", "name", there, "address", hardware], check=True)
    # The kernel computes checksums and cuts frames to size: what a packet socket takes must be whole.
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        for setting in _OFFLOADS:
            value = (ctypes.c_uint32 * 2)(setting, 0)
            fcntl.ioctl(control, _SIOCETHTOOL, struct.pack("16sP16x", there.encode(), ctypes.addressof(value)))
    for words in (
        ["ip", "link", "set", there, "netns", str(host), "name", interface],
        ["nsenter", f"--target={host}", "--net", "--", "ip", "link", "set", interface, "up"],
        ["ip", "link", "set", here, "up"],
    ):
        subprocess.run(words, check=True)
    return here


def main() -> None:
    """Switch frames until standard input ends."""
    # A switch has no addresses and says nothing by itself.
    Path("/proc/sys/net/ipv6/conf/default/disable_ipv6").write_text("1", encoding="ascii")
    switch = _Frames(sys.argv[1])
    pending = b""
    while True:
        sockets = switch.sockets()
        ready, _, _ = select.select([0, *sockets], [], [], switch.patience(time.monotonic()))
        for descriptor in ready:
            if descriptor:
                switch.read(sockets[descriptor])
        switch.release(time.monotonic())
        if 0 in ready:
            received = os.read(0, 65536)
            if not received:
                return
            *lines, pending = (pending + received).split(b"\n")
            for line in lines:
                name, *arguments = json.loads(line)
                say(json.dumps(getattr(switch, f"do_{name}")(*arguments)))


if __name__ == "__main__":
    main()
