"""The two switches that connect test hosts: the kernel's bridge with netem, and a process of these tests.

Both do the same. The kernel's is the field standard, but its netem draws cannot be seeded everywhere, and a kernel may
be built without it. The process is seeded, and there is always one.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import asdict
from typing import Any, Protocol

from tests.hosts.impairment import Impairment
from tests.processes import SEARCH_PATH, until

DIRECTIONS = ("from", "to")
"""Of a cable, seen from the host."""


class Switch(Protocol):
    """What connects hosts: one port, one cable for each."""

    def attach(self, port: int, host: int, interface: str, hardware: str) -> None:
        """Lay a cable into the network namespace of process `host`; `interface` and hardware address are its end's.

        The host's end is set up before the switch's, so the cable carries as soon as the host's end says so.
        """

    def detach(self, port: int) -> None:
        """Take the cable away."""

    def impair(self, port: int, direction: str, how: Impairment) -> None:
        """Impair what passes a cable from now on, in one direction."""

    def group(self, port: int, group: int) -> None:
        """Put a port into a group; only ports of the same group reach each other. All are in group 0 at first."""

    def close(self) -> None:
        """End it, and with it all cables."""


class SoftwareSwitch:
    """`tests.hosts.software_switch` as a process in a network namespace of its own."""

    def __init__(self, seed: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.hosts.software_switch", str(os.getpid()), seed],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | SEARCH_PATH,
            text=True,
        )

    def _command(self, *words: object) -> Any:
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(json.dumps(words) + "\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        assert answer, "the switch has ended; its message stands above"
        return json.loads(answer)

    def attach(self, port: int, host: int, interface: str, hardware: str) -> None:
        self._command("attach", port, host, interface, hardware)

    def detach(self, port: int) -> None:
        self._command("detach", port)

    def impair(self, port: int, direction: str, how: Impairment) -> None:
        self._command("impair", port, direction, asdict(how))

    def group(self, port: int, group: int) -> None:
        self._command("group", port, group)

    def counts(self) -> dict[str, int]:
        """Return how many frames were delivered, lost, duplicated, partitioned."""
        counts: dict[str, int] = self._command("counts")
        return counts

    def close(self) -> None:
        with self._process as process:
            process.kill()


class KernelBridge:
    """Bridges in a network namespace of its own, one for each group of hosts, and netem at both ends of a cable."""

    def __init__(self) -> None:
        words = [sys.executable, "-m", "tests.hosts.holder", str(os.getpid())]
        self._holder = subprocess.Popen(words, stdout=subprocess.PIPE, env=os.environ | SEARCH_PATH, text=True)
        assert self._holder.stdout is not None and self._holder.stdout.readline()
        self._hosts: dict[int, tuple[int, str]] = {}
        self._bridges: set[int] = set()

    def attach(self, port: int, host: int, interface: str, hardware: str) -> None:
        peer = ("peer", "name", interface, "address", hardware, "netns", str(host))
        self._run(self._holder.pid, "ip", "link", "add", f"port{port}", "type", "veth", *peer)
        self._hosts[port] = host, interface
        self.group(port, 0)
        self._run(host, "ip", "link", "set", interface, "up")
        self._run(self._holder.pid, "ip", "link", "set", f"port{port}", "up")
        shown = ("ip", "-details", "link", "show", f"port{port}")
        until(lambda: "state forwarding" in self._run(self._holder.pid, *shown), f"port {port} forwards")

    def detach(self, port: int) -> None:
        del self._hosts[port]
        words = _within(self._holder.pid, "ip", "link", "delete", f"port{port}")
        subprocess.run(words, check=False, stderr=subprocess.DEVNULL)  # the kernel may have removed it with the host

    def impair(self, port: int, direction: str, how: Impairment) -> None:
        place = self._hosts[port] if direction == "from" else (self._holder.pid, f"port{port}")
        self._run(place[0], "tc", "qdisc", "replace", "dev", place[1], "root", *netem(how))

    def group(self, port: int, group: int) -> None:
        bridge = f"group{group}"
        if group not in self._bridges:
            self._bridges.add(group)
            # Without a router that asks for members, a bridge that snoops would end multicast after a while.
            self._run(self._holder.pid, "ip", "link", "add", bridge, "type", "bridge", "mcast_snooping", "0")
            self._run(self._holder.pid, "ip", "link", "set", bridge, "up")
        self._run(self._holder.pid, "ip", "link", "set", f"port{port}", "master", bridge)

    def close(self) -> None:
        with self._holder as holder:
            holder.kill()

    @staticmethod
    def _run(pid: int, *words: str) -> str:
        return subprocess.run(_within(pid, *words), check=True, stdout=subprocess.PIPE, text=True).stdout


def netem(how: Impairment) -> list[str]:
    """Return the words with which tc asks for an impairment."""
    words = ["netem", "limit", "100000"]
    if how.delay:
        words += ["delay", f"{how.delay * 1e6:.0f}us", f"{how.jitter * 1e6:.0f}us"]
    for name in ("loss", "duplicate", "reorder"):
        if probability := getattr(how, name):
            words += [name, f"{probability:.6%}"]
    if how.jitter and not how.reorder:
        words += ["rate", "100gbit"]  # netem keeps the order of frames only where it also limits their rate
    return words


def _within(pid: int, *words: str) -> list[str]:
    return ["nsenter", f"--target={pid}", "--net", "--", *words]


def why_no_netem() -> str | None:
    """Return why the kernel's bridge cannot impair anything, or nothing if it can."""
    script = "ip link set lo up && tc qdisc add dev lo root netem delay 1ms"
    done = subprocess.run(["unshare", "--net", "sh", "-c", script], capture_output=True, text=True, check=False)
    return f"this kernel has no netem: {done.stderr.strip()}" if done.returncode else None
