"""Hosts for tests: namespaces on this machine, each with its processes, memory, name, and cables to switches.

Nothing of it has a name outside: all is gone when its processes are, and the kernel kills these when the test ends,
also by a SIGKILL. Use it from the thread that goes on until the hosts are no longer needed.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Literal

from tests.hosts.impairment import Impairment
from tests.hosts.namespaces import children_born_in
from tests.hosts.switches import DIRECTIONS, KernelBridge, SoftwareSwitch, Switch
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
        self._impaired: dict[tuple[int, str], Impairment] = {}
        self._groups: dict[int, int] = {}
        self._holder: subprocess.Popen[str] | None = None
        self.pid = 0
        """Of its first process; 0 while it is dead. `/proc/PID/net` shows the host's sockets."""

    @property
    def address(self) -> str:
        """Its address in the first network."""
        return self.addresses[0]

    def hardware_address(self, network: int = 0) -> str:
        """Return its hardware address in a network."""
        return f"02:00:00:00:{network:02x}:{self._number + 1:02x}"

    @property
    def alive(self) -> bool:
        return self._holder is not None

    def revive(self) -> None:
        """Switch the host on. It comes with its old addresses and cables, and without any process."""
        assert self._holder is None, f"{self.name} is alive"
        words = [sys.executable, "-m", "tests.hosts.init", str(os.getpid()), self.name]
        environment = os.environ | SEARCH_PATH
        holder = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, env=environment, text=True)
        assert holder.stdout is not None
        pid = holder.stdout.readline()
        if not pid:
            with holder:
                holder.kill()
            raise AssertionError(f"{self.name} has not started; its message stands above")
        self._holder, self.pid = holder, int(pid)
        for network, switch in enumerate(self._networks):
            interface = f"eth{network}"
            switch.attach(self._number, self.pid, interface, self.hardware_address(network))
            self.ip("address", "add", f"{self.addresses[network]}/24", "dev", interface)
            until(lambda: "state UP" in self.ip("link", "show", interface), f"{self.name} has carrier")  # noqa: B023
            if network in self._groups:
                switch.group(self._number, self._groups[network])
        for (network, direction), how in self._impaired.items():
            self._networks[network].impair(self._number, direction, how)

    def kill(self) -> None:
        """Cut the power: all its processes are gone at once, without a word to anybody."""
        assert self._holder is not None, f"{self.name} is dead"
        os.kill(self.pid, signal.SIGKILL)
        for process in self._started:
            with process:  # its pipes are closed; what it has written is lost
                process.kill()
        self._started.clear()
        with self._holder as holder:
            holder.wait()
        self._holder, self.pid = None, 0
        for switch in self._networks:
            switch.detach(self._number)

    def off(self) -> None:
        """Kill the host if it is alive."""
        if self.alive:
            self.kill()

    def impair(self, how: Impairment, *, network: int = 0, directions: Iterable[str] = DIRECTIONS) -> None:
        """Impair what the host sends ("from"), or what it receives ("to"), from now on; also over its death."""
        for direction in directions:
            self._impaired[network, direction] = how
            if self.alive:
                self._networks[network].impair(self._number, direction, how)

    def group(self, group: int, *, network: int = 0) -> None:
        """Let the host reach only hosts of the same group."""
        self._groups[network] = group
        if self.alive:
            self._networks[network].group(self._number, group)

    def know(self, other: Host, *, network: int = 0) -> None:
        """Spare the host asking for another's hardware address: what it sends before the answer may be lost."""
        known = (other.addresses[network], "lladdr", other.hardware_address(network), "dev", f"eth{network}")
        self.ip("neighbour", "replace", *known, "nud", "permanent")

    def ip(self, *words: str) -> str:
        """Run the command `ip` on the host; return what it prints."""
        return self.run(["ip", *words])

    def start(
        self, words: Sequence[object], *, cwd: Path = ROOT, env: Mapping[str, str] | None = None, **options: Any
    ) -> subprocess.Popen[Any]:
        """Start a process on the host. It is ended by its id, as any other, and dies with the host.

        Parameters
        ----------
        words : sequence
            The program and its arguments.
        cwd : Path
            Its working directory; the hosts share this machine's files but for /proc and /dev/shm.
        env : mapping
            Variables that it has besides those of the test.
        **options
            Of `subprocess.Popen`.
        """
        assert self.alive, f"{self.name} is dead"
        entering = ["nsenter", f"--target={self.pid}", "--net", "--mount", "--uts", "--ipc", "--"]
        # A new mount namespace begins in the root folder.
        entering += ["env", f"--chdir={cwd}", *map(str, words)]
        options = {"stdin": subprocess.DEVNULL, "text": True, **options}
        with children_born_in(self.pid):
            process = subprocess.Popen(entering, env={**os.environ, **SEARCH_PATH, **(env or {})}, **options)
        self._started.append(process)
        return process

    def python(self, module: str, *arguments: object, **options: Any) -> subprocess.Popen[Any]:
        """Start a module of the project or of its tests on the host."""
        return self.start([sys.executable, "-m", module, *arguments], **options)

    def run(self, words: Sequence[object], **options: Any) -> str:
        """Run a program on the host to its end; return what it prints.

        Raises
        ------
        AssertionError
            If it fails.
        """
        process = self.start(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options)
        return finish(process)


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


class Hosts(tuple[Host, ...]):
    """All hosts of a test."""

    __slots__ = ()

    def impair(self, how: Impairment, *, network: int = 0) -> None:
        """Impair what all hosts send. Between two hosts a frame is impaired once."""
        for host in self:
            host.impair(how, network=network, directions=("from",))

    def partition(self, *groups: Iterable[int], network: int = 0) -> None:
        """Divide a network: only hosts of the same group reach each other; those not named are a further group."""
        group_of = {number: group for group, numbers in enumerate(groups, start=1) for number in numbers}
        for number, host in enumerate(self):
            host.group(group_of.get(number, 0), network=network)

    def heal(self, *, network: int = 0) -> None:
        """Make a network whole again."""
        self.partition(network=network)


@contextmanager
def hosts(
    count: int, *, networks: int = 1, switch: Literal["software", "kernel"] = "software", seed: str = "hosts"
) -> Iterator[Hosts]:
    """Have hosts for the time of the block.

    Parameters
    ----------
    count : int
        How many.
    networks : int
        To how many networks each of them is connected.
    switch : str
        What connects them: the process `tests.hosts.software_switch`, or the kernel's bridge.
    seed : str
        Of what the network does to frames; the kernel's bridge has none.
    """
    with ExitStack() as stack:
        switches: list[Switch] = []
        for network in range(networks):
            switches.append(KernelBridge() if switch == "kernel" else SoftwareSwitch(f"{seed} {network}"))
            stack.callback(switches[-1].close)
        made = Hosts(Host(f"host{number}", number, switches) for number in range(count))
        for host in made:
            stack.callback(host.off)
            host.revive()
        yield made
