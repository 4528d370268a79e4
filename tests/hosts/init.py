"""The first process of a test host: with it the host lives and dies, as a machine does with its power supply.

Usage: python -m tests.hosts.init PARENT NAME
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

from tests.hosts.namespaces import IPC, MOUNT, NET, PID, UTS, die_with, say, unshare

_MOUNTS = (
    ("--make-rprivate", "/"),
    ("-t", "proc", "proc", "/proc"),
    ("-t", "tmpfs", "tmpfs", "/dev/shm"),
    ("-t", "tmpfs", "tmpfs", "/run"),
)
"""Memory is shared within a host only, and what its processes leave there is gone when the host is."""


def _power_on(name: str) -> None:
    """Set up the host, and say which process id it has outside."""
    outside = str(Path("/proc/self").readlink())
    for words in _MOUNTS:
        subprocess.run(["mount", *words], check=True)
    Path("/proc/sys/kernel/hostname").write_text(name, encoding="ascii")
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the kernel buries orphans
    say(outside)


def main() -> None:
    """Start the host, and wait for its end."""
    parent, name = int(sys.argv[1]), sys.argv[2]
    die_with(parent)
    unshare(NET | PID | MOUNT | UTS | IPC)
    reading, writing = os.pipe()
    first = os.fork()
    if first:
        os.waitpid(first, 0)
    else:
        os.close(writing)
        _power_on(name)
        os.read(reading, 1)  # nothing ever comes: until the parent has died, however it did


if __name__ == "__main__":
    main()
