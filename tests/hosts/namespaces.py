"""Linux namespaces of the test hosts, and what enters them."""

import ctypes
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_LIBC = ctypes.CDLL(None, use_errno=True)
_UNSHARE = ("unshare", "--net", "--pid", "--fork", "--kill-child", "--mount-proc", "--uts", "--ipc")
_FIRST = """
mount -t tmpfs tmpfs /dev/shm && mount -t tmpfs tmpfs /run && echo "$1" >/proc/sys/kernel/hostname &&
    ip link set lo up && echo ready && exec env --ignore-signal=CHLD cat
"""
"""Memory is shared within a host only. The first process ends with the test that started it; it buries orphans."""


def say(line: str) -> None:
    """Tell the test that has started this process."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


@contextmanager
def entered(pid: int, namespace: str) -> Iterator[None]:
    """Let what this thread opens ("net"), or starts ("pid"), in the block belong to the namespace of a process."""
    own, other = (os.open(f"/proc/{of}/ns/{namespace}", os.O_RDONLY) for of in ("thread-self", pid))
    try:
        _set(other)
        yield
    finally:
        _set(own)
        os.close(own)
        os.close(other)


def _set(descriptor: int) -> None:
    if _LIBC.setns(descriptor, 0):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


def why_no_hosts() -> str | None:
    """Return why this machine can have no test hosts, or nothing if it can."""
    missing = [name for name in ("ip", "ss", "unshare", "nsenter", "mount", "env") if shutil.which(name) is None]
    if missing:
        return f"test hosts need the commands {', '.join(missing)}"
    trial = (*_UNSHARE, "ip", "link", "add", "type", "veth")
    done = subprocess.run(trial, capture_output=True, text=True, check=False)
    if done.returncode:
        return f"the kernel forbids network namespaces (they need root): {done.stderr.strip()}"
    return None


def first_process(name: str) -> subprocess.Popen[str]:
    """Start a host: it is there when this returns, and gone when the process or whoever has started it is."""
    words = [*_UNSHARE, "sh", "-c", _FIRST, "sh", name]
    pipe = subprocess.PIPE
    process = subprocess.Popen(words, stdin=pipe, stdout=pipe, text=True, start_new_session=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n", f"{name} has not started; its message stands above"
    return process
