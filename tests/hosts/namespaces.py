"""Linux namespaces and the other system calls of the test hosts that Python has not had for long."""

from __future__ import annotations

import ctypes
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

MOUNT, UTS, IPC, PID, NET = 0x00020000, 0x04000000, 0x08000000, 0x20000000, 0x40000000
"""CLONE_NEWNS and so on."""

_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None, use_errno=True)
_PROGRAMS = ("ip", "unshare", "nsenter", "mount", "env")


def _call(name: str, *arguments: object) -> None:
    if getattr(_LIBC, name)(*arguments):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()), name)


def unshare(kinds: int) -> None:
    """Give this process new namespaces; one for process ids holds for its children only."""
    _call("unshare", kinds)


def die_with(parent: int) -> None:
    """Let the kernel kill this process when the thread of its parent that has started it ends, however it does.

    Ctrl-C, which all processes of a terminal hear, is the parent's matter: it still needs this one to end in order.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _call("prctl", _PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:  # it has ended already
        os._exit(1)


def say(line: str) -> None:
    """Tell the test that has started this process."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def hold_cables(parent: int) -> None:
    """Become the process of a switch: with a network namespace for its ends of the cables, and mortal."""
    die_with(parent)
    unshare(NET)
    # A switch has no addresses and says nothing by itself.
    Path("/proc/sys/net/ipv6/conf/default/disable_ipv6").write_text("1", encoding="ascii")


@contextmanager
def children_born_in(pid: int) -> Iterator[None]:
    """Let the processes that this thread starts in the block live in the process id namespace of another process."""
    own = os.open("/proc/thread-self/ns/pid", os.O_RDONLY)
    try:
        other = os.open(f"/proc/{pid}/ns/pid", os.O_RDONLY)
        try:
            _call("setns", other, PID)
        finally:
            os.close(other)
        try:
            yield
        finally:
            _call("setns", own, PID)
    finally:
        os.close(own)


def why_no_hosts() -> str | None:
    """Return why this machine can have no test hosts, or nothing if it can."""
    if sys.platform != "linux":
        return "test hosts are Linux namespaces"
    missing = [name for name in _PROGRAMS if shutil.which(name) is None]
    if missing:
        return f"test hosts need the commands {', '.join(missing)}"
    trial = ("unshare", "--net", "--pid", "--fork", "--mount", "--uts", "--ipc", "ip", "link", "add", "type", "veth")
    done = subprocess.run(trial, capture_output=True, text=True, check=False)
    if done.returncode:
        return f"the kernel forbids network namespaces (they need root): {done.stderr.strip()}"
    return None
