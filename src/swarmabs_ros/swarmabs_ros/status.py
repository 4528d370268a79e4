"""What a node tells whoever started it, the orchestrator of a run or systemd, and how it is told to begin.

The orchestrator hands down two file descriptors by environment variables: a pipe on which nodes report in lines of
JSON, and the read end of another pipe whose closing is the start signal for all at once. A launch file, which cannot
hand down descriptors, gives the paths of named pipes instead. In real time each process finds there, before that, when
its step 0 begins. A node that was started by hand has neither, reports nowhere and begins at once. systemd is told of a
service of ``Type=notify`` by the protocol of sd_notify(3).
"""

from __future__ import annotations

import json
import os
import select
import socket
from typing import Literal

from swarmabs_core.errors import InputError, RunError

REPORT_FD = "SWARMABS_REPORT_FD"
START_FD = "SWARMABS_START_FD"

EPOCH_RECORD = 20
"""Bytes of the decimal number by which a process is told the epoch."""

Report = Literal["ready", "stalled", "recovered", "failed", "progress", "written", "done", "timing", "steered"]


class StatusChannel:
    """Reports to the orchestrator under the name of a node, if there is an orchestrator."""

    def __init__(self, node: str) -> None:
        self._node = node
        self._report = _descriptor(REPORT_FD, os.O_WRONLY)
        self._start = _descriptor(START_FD, os.O_RDONLY)

    def send(self, event: Report, **details: object) -> None:
        """Report; lines below 4 KiB are never mixed up with those of other nodes."""
        if self._report is None:
            return
        line = json.dumps({"node": self._node, "pid": os.getpid(), "event": event, **details}) + "\n"
        try:
            os.write(self._report, line.encode())
        except BrokenPipeError:  # the orchestrator has gone, and the kernel is about to end this process too
            self._report = None

    def wait_for_start(self, timeout: float) -> bool:
        """Wait until all may begin; return False if it was not in time (s)."""
        if self._start is None:
            return True
        ready, _, _ = select.select([self._start], [], [], timeout)
        return bool(ready)

    def wait_for_epoch(self) -> int:
        """Wait for the start and return the time, ns since 1970, that it comes with.

        Raises `InputError` if nobody has started this node who could tell it, and `RunError` if whoever did has gone.
        """
        if self._start is None:
            raise InputError("parameter await_epoch: nobody is there to tell the epoch; give epoch_ns instead")
        # All processes read the same pipe, and there is a record for each of them.
        record = os.read(self._start, EPOCH_RECORD)
        if len(record) < EPOCH_RECORD:
            raise RunError("whoever has started this node has gone before the start")
        return int(record)


def epoch_records(epoch_ns: int, processes: int) -> bytes:
    """Return what tells so many processes, at the start, the time (ns since 1970) at which step 0 begins."""
    return b"%0*d" % (EPOCH_RECORD, epoch_ns) * processes


def _descriptor(variable: str, mode: int) -> int | None:
    text = os.environ.get(variable, "")
    if text.startswith("/"):
        return os.open(text, mode | os.O_CLOEXEC)
    return int(text) if text else None


def notify(state: str) -> None:
    """Send systemd assignments such as ``READY=1``; nobody listening is no error: a service must not fail by it."""
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


class Heartbeat:
    """Tells systemd, where it watches this process, that its loop goes round."""

    def __init__(self) -> None:
        watched = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        microseconds = os.environ.get("WATCHDOG_USEC", "")
        # Half the time, ns, after which systemd takes this process to hang; 0: it does not watch it.
        self._interval = int(microseconds) * 1000 // 2 if watched and microseconds.isdecimal() else 0
        self._due = 0

    def beat(self, now: int) -> None:
        """Tell it if that is due; `now` is the steady time, ns."""
        if self._interval and now >= self._due:
            self._due = now + self._interval
            notify("WATCHDOG=1")
