"""Communication of a node with the process that started it: the orchestrator of a run, or systemd.

The orchestrator passes two file descriptors in environment variables: a pipe on which nodes report in lines of JSON,
and the read end of a second pipe, whose closing is the start signal for all nodes. A launch file, which cannot pass
descriptors, gives the paths of named pipes instead. In real time, each process first reads from the second pipe the
time at which step 0 starts. A node that was started by hand has neither, does not report, and starts at once. systemd
receives the state of a service with ``Type=notify`` by the protocol of sd_notify(3).
"""

from __future__ import annotations

import json
import os
import select
import socket
from typing import Any, Literal, TypeAlias, TypedDict

from swarmabs_core.errors import InputError, RunError

REPORT_FD = "SWARMABS_REPORT_FD"
START_FD = "SWARMABS_START_FD"

EPOCH_RECORD = 20
"""Length, in bytes, of the decimal number that sends the epoch to a process."""

Document: TypeAlias = dict[str, Any]
"""A JSON document."""

Event = Literal[
    "ready",
    "stalled",
    "recovered",
    "failed",
    "progress",
    "done",
    "timing",
    "steered",
    "paused",
    "restart",
    "publishes",
    "recorded",
    "spawned",
    "exited",
]


class _Report(TypedDict):
    node: str
    pid: int
    event: Event


class Report(_Report, total=False):
    """A report of a node, or of the launcher on its children; which of these entries it has depends on its event."""

    name: str
    """``spawned``, ``exited``: the child."""
    child: int
    code: int
    step: int
    missing: list[str]
    """``stalled``: what is waited for."""
    silence: float
    reason: str
    angle: float | None
    error: float | None
    robots: Document | None
    complete: bool
    problem: str | None
    figures: Document
    steps: int
    missed: int
    longest_us: int
    lateness_us: dict[str, int]
    clock_jumps: int
    text: str
    change: str
    paused: bool
    action: str
    events: list[tuple[str, int, int, int]]
    """``publishes``, ``recorded``: digest, step, robot and kind of each."""


class StatusChannel:
    """Reports to the orchestrator, if there is one, under the name of a node."""

    def __init__(self, node: str) -> None:
        self._node = node
        self._report = _descriptor(REPORT_FD, os.O_WRONLY)
        self._start = _descriptor(START_FD, os.O_RDONLY)

    def send(self, event: Event, **details: object) -> None:
        """Send a report; lines below 4 KiB do not interleave with those of other nodes."""
        if self._report is None:
            return
        line = json.dumps({"node": self._node, "pid": os.getpid(), "event": event, **details}) + "\n"
        try:
            os.write(self._report, line.encode())
        except BrokenPipeError:  # the orchestrator has ended, and the kernel is about to end this process, too
            self._report = None

    def wait_for_start(self, timeout: float) -> bool:
        """Wait for the start signal; return False after `timeout` (s)."""
        if self._start is None:
            return True
        ready, _, _ = select.select([self._start], [], [], timeout)
        return bool(ready)

    def wait_for_epoch(self) -> int:
        """Wait for the start and return the epoch, ns since 1970, that is sent with it.

        Raises `InputError` if the node was not started by an orchestrator, and `RunError` if that has ended.
        """
        if self._start is None:
            raise InputError("parameter await_epoch: no orchestrator started this node; set epoch_ns instead")
        # All processes read from the same pipe, which contains one record for each.
        record = os.read(self._start, EPOCH_RECORD)
        if len(record) < EPOCH_RECORD:
            raise RunError("the process that started this node ended before the start")
        return int(record)


def epoch_records(epoch_ns: int, processes: int) -> bytes:
    """Return the records that send the time (ns since 1970) of step 0 to a number of processes."""
    return b"%0*d" % (EPOCH_RECORD, epoch_ns) * processes


def _descriptor(variable: str, mode: int) -> int | None:
    text = os.environ.get(variable, "")
    if text.startswith("/"):
        return os.open(text, mode | os.O_CLOEXEC)
    return int(text) if text else None


def notify(state: str) -> None:
    """Send assignments such as ``READY=1`` to systemd; errors are ignored, because they must not stop a service."""
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
    """Reports to systemd, if its watchdog is enabled, that the loop of this process is running."""

    def __init__(self) -> None:
        watched = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        microseconds = os.environ.get("WATCHDOG_USEC", "")
        # Half of the watchdog timeout of systemd, ns; 0: no watchdog.
        self._interval = int(microseconds) * 1000 // 2 if watched and microseconds.isdecimal() else 0
        self._due = 0

    def beat(self, now: int) -> None:
        """Report if that is due; `now` is the steady time, ns."""
        if self._interval and now >= self._due:
            self._due = now + self._interval
            notify("WATCHDOG=1")
