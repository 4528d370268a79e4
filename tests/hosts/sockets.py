"""What a host's sockets are bound to, as the kernel tells: the addresses at which it can be reached at all."""

from __future__ import annotations

import socket
import struct
from ipaddress import ip_address
from pathlib import Path
from typing import NamedTuple

_LISTENING = {"tcp": "0A", "tcp6": "0A", "udp": "07", "udp6": "07", "raw": None, "raw6": None}
"""State of a socket that takes what anybody sends, by table."""


class Bound(NamedTuple):
    """A socket that takes what others send."""

    table: str
    address: str
    port: int


def _address(digits: str) -> str:
    words = struct.pack(f"={len(digits) // 8}I", *(int(digits[k : k + 8], 16) for k in range(0, len(digits), 8)))
    return str(ip_address(words))


def bound_sockets(pid: int) -> set[Bound]:
    """Return all sockets that listen in the network namespace of a process, whoever has opened them.

    Packet sockets, which are bound to interfaces, are named with the interface's index as their port.
    """
    folder = Path(f"/proc/{pid}/net")
    found = set()
    for table, state in _LISTENING.items():
        for line in (folder / table).read_text().splitlines()[1:]:
            fields = line.split()
            address, port = fields[1].split(":")
            if state in {None, fields[3]}:
                found.add(Bound(table, _address(address), int(port, 16)))
    for line in (folder / "packet").read_text().splitlines()[1:]:
        found.add(Bound("packet", "", int(line.split()[4])))
    return found


def groups_joined(pid: int) -> dict[str, set[str]]:
    """Return the IPv4 multicast groups that a host has joined, by interface, but for the one of all hosts."""
    joined: dict[str, set[str]] = {}
    interface = ""
    for line in Path(f"/proc/{pid}/net/igmp").read_text().splitlines()[1:]:
        fields = line.split()
        if line[0].isdigit():
            interface = fields[1]
        elif (group := socket.inet_ntoa(struct.pack("=I", int(fields[0], 16)))) != "224.0.0.1":
            joined.setdefault(interface, set()).add(group)
    return joined
