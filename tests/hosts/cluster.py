"""Hosts for tests: namespaces on this machine, each with its processes, memory, name, and cables to switches.

Nothing of it has a name outside: all is gone when its processes are, and the kernel kills these when the test ends,
also by a SIGKILL. Use it from the thread that goes on until the hosts are no longer needed.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from typing import Any

import psutil
from tests.hosts.namespaces import entered, first_process
from tests.hosts.switch import DIRECTIONS, Impairment, Switch
from tests.processes import ROOT, SEARCH_PATH, until

LONGEST = 60.0
"""Time, s, after which a command on a host is taken to hang."""


class Host:
    """One host. It has the interface eth0 with an address in the first network, eth1 in the second, and so on."""

    def __init__(self, name: str, number: int, networks: Sequence[Switch]) -> None:
        self.name = name
        self.addresses = tuple(f"10.83.{network}.{number + 1}" for network in range(len(networks)))
        self._number = number
        self._networks = networks
        self._started: list[subprocess.Popen[Any]] = []
        self._sockets: list[socket.socket] = []
        self._impaired: dict[str, Impairment] = {}
        self._group = 0
        self._holder: subprocess.Popen[str] | None = None
        self.pid = 0
        """Of its first process; 0 while it is dead."""

    @property
    def address(self) -> str:
        return self.addresses[0]

    def _hardware_address(self, network: int = 0) -> str:
        return f"02:00:00:00:{network:02x}:{self._number + 1:02x}"

    @property
    def alive(self) -> bool:
        return self._holder is not None

    def revive(self) -> None:
        """Switch the host on. It comes with its old addresses and cables, and without any process."""
        assert self._holder is None, f"{self.name} is alive"
        self._holder = first_process(self.name)
        (child,) = psutil.Process(self._holder.pid).children()
        self.pid = child.pid
        for network, switch in enumerate(self._networks):
            interface = f"eth{network}"
            switch.attach(self._number, self.pid, interface, self._hardware_address(network))
            self.ip("address", "add", f"{self.addresses[network]}/24", "dev", interface)
            until(lambda: "state UP" in self.ip("link", "show", interface), f"{self.name} has carrier")  # noqa: B023
        self.group(self._group)
        for direction, how in self._impaired.items():
            self._networks[0].impair(self._number, direction, asdict(how))

    def kill(self) -> None:
        """Cut the power: all its processes are gone at once, without a word to anybody."""
        assert self._holder is not None, f"{self.name} is dead"
        os.kill(self.pid, signal.SIGKILL)
        for process in (*self._started, self._holder):
            with process:  # its pipes are closed; what it has written is lost
                process.kill()
        for opened in self._sockets:
            opened.close()
        self._started.clear()
        self._sockets.clear()
        self._holder, self.pid = None, 0
        for switch in self._networks:
            switch.detach(self._number)

    def impair(self, how: Impairment, *, directions: Iterable[str] = DIRECTIONS) -> None:
        """Impair what it sends ("from"), or receives ("to"), in the first network from now on, also over its death."""
        for direction in directions:
            self._impaired[direction] = how
            if self.alive:
                self._networks[0].impair(self._number, direction, asdict(how))

    def group(self, group: int) -> None:
        """Let the host reach only hosts of the same group in the first network."""
        self._group = group
        if self.alive:
            self._networks[0].group(self._number, group)

    def know(self, other: Host) -> None:
        """Spare the host asking for another's hardware address: what it sends before the answer may be lost."""
        known = (other.address, "lladdr", other._hardware_address(), "dev", "eth0")
        self.ip("neighbour", "replace", *known, "nud", "permanent")

    def udp(self, port: int = 0) -> socket.socket:
        """Return a socket of the host for this process, at its first address; it dies with the host."""
        with entered(self.pid, "net"):
            opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._sockets.append(opened)
        opened.bind((self.address, port))
        return opened

    def listening(self) -> set[tuple[str, str]]:
        """Return kind and address of all sockets that take what others send, whoever has opened them."""
        lines = self.run(["ss", "-H", "-n", "-l", "-t", "-u", "-w", "-0"]).splitlines()
        return {(fields[0], fields[4].rpartition(":")[0]) for fields in map(str.split, lines)}

    def groups(self) -> dict[str, set[str]]:
        """Return the IPv4 multicast groups that it has joined, by interface, but for the one of all hosts."""
        found = {
            entry["ifname"]: {group["address"] for group in entry["maddr"] if group.get("family") == "inet"}
            for entry in json.loads(self.ip("-json", "maddress"))
        }
        return {name: rest for name, groups in found.items() if (rest := groups - {"224.0.0.1"})}

    def ip(self, *words: str) -> str:
        return self.run(["ip", *words])

    def start(self, words: Sequence[object], *, env: Mapping[str, str] = {}, **options: Any) -> subprocess.Popen[Any]:
        """Start a process on the host, with variables besides those of the test and options of `subprocess.Popen`.

        It is ended by its id, as any other, and dies with the host. The hosts share this machine's files but for /proc,
        /run and /dev/shm.
        """
        assert self.alive, f"{self.name} is dead"
        entering = ["nsenter", f"--target={self.pid}", "--net", "--mount", "--uts", "--ipc", "--"]
        # A new mount namespace begins in the root folder.
        entering += ["env", f"--chdir={ROOT}", *map(str, words)]
        options = {"stdin": subprocess.DEVNULL, "text": True, **options}
        with entered(self.pid, "pid"):
            process = subprocess.Popen(entering, env={**os.environ, **SEARCH_PATH, **env}, **options)
        self._started.append(process)
        return process

    def python(self, module: str, *arguments: object, **options: Any) -> subprocess.Popen[Any]:
        return self.start([sys.executable, "-m", module, *arguments], **options)

    def run(self, words: Sequence[object], **options: Any) -> str:
        return finish(self.start(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options))


def finish(process: subprocess.Popen[Any]) -> str:
    """Wait for a process that shall succeed; return what it has printed."""
    out, err = process.communicate(timeout=LONGEST)
    assert process.returncode == 0, f"{process.args!r} ended with {process.returncode}: {err or out!r}"
    return str(out)


def until_ready(process: subprocess.Popen[Any]) -> str:
    """Wait until a process prints the line "ready"; return what it has printed before."""
    before = ""
    assert process.stdout is not None
    for line in process.stdout:
        if line == "ready\n":
            return before
        before += line
    raise AssertionError(f"{process.args!r} is not ready: {before} {process.stderr and process.stderr.read()}")


class Hosts(tuple[Host, ...]):  # noqa: SLOT001
    """All hosts of a test, and the switches of their networks."""

    switches: Sequence[Switch]

    def impair(self, how: Impairment) -> None:
        """Impair what all hosts send in the first network. Between two hosts a frame is impaired once."""
        for host in self:
            host.impair(how, directions=("from",))

    def partition(self, *groups: Iterable[int]) -> None:
        """Divide the first network: only hosts of the same group reach each other; those not named are another."""
        group_of = {number: group for group, numbers in enumerate(groups, start=1) for number in numbers}
        for number, host in enumerate(self):
            host.group(group_of.get(number, 0))


@contextmanager
def hosts(count: int, *, networks: int = 1, seed: str = "hosts") -> Iterator[Hosts]:
    """Have hosts for the time of the block, each connected to some networks that do to frames what the seed says."""
    with ExitStack() as stack:
        switches = [Switch(f"{seed} {network}") for network in range(networks)]
        for switch in switches:
            stack.callback(switch.close)
        made = Hosts(Host(f"host{number}", number, switches) for number in range(count))
        made.switches = switches
        for host in made:
            stack.callback(lambda host=host: host.kill() if host.alive else None)  # type: ignore[misc]
            host.revive()
        yield made
