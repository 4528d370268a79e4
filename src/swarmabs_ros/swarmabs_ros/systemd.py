"""What systemd is told of a service of ``Type=notify``, by the protocol of sd_notify(3); without systemd nothing."""

from __future__ import annotations

import os
import socket


def notify(state: str) -> None:
    """Send assignments such as ``READY=1``; nobody listening is no error, since a service must not fail by it."""
    path = os.environ.get("NOTIFY_SOCKET", "")
    if not path.startswith(("/", "@")):
        return
    address = "\0" + path[1:] if path.startswith("@") else path
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as channel:
            channel.setblocking(False)
            channel.sendto(state.encode(), address)
    except OSError:
        return


def watchdog_interval() -> int:
    """Return half the time, ns, after which systemd takes this process to hang; 0 if it does not watch it."""
    if os.environ.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return 0
    text = os.environ.get("WATCHDOG_USEC", "")
    return int(text) * 1000 // 2 if text.isdecimal() else 0


class Heartbeat:
    """Tells systemd, where it watches this process, that its loop goes round."""

    def __init__(self) -> None:
        self._interval, self._due = watchdog_interval(), 0

    def beat(self, now: int) -> None:
        """Tell it if that is due; `now` is the steady time, ns."""
        if self._interval and now >= self._due:
            self._due = now + self._interval
            notify("WATCHDOG=1")
