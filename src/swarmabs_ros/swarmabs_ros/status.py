"""What a node tells the process that started it, and how it is told to begin.

The orchestrator hands down two file descriptors by environment variables: a pipe on which nodes report in lines of
JSON, and the read end of another pipe whose closing is the start signal for all at once. In real time each process
finds there, before that, when its step 0 begins. A node that was started by hand has neither, reports nowhere and
begins at once.
"""

from __future__ import annotations

import json
import os
import select
from typing import Literal

from swarmabs_core.errors import InputError, RunError

REPORT_FD = "SWARMABS_REPORT_FD"
START_FD = "SWARMABS_START_FD"

EPOCH_RECORD = 20
"""Bytes of the decimal number by which a process is told the epoch."""

Report = Literal["ready", "stalled", "recovered", "failed", "progress", "written", "done", "timing", "steered"]


class StatusChannel:
    """Reports to the orchestrator, if there is one.

    Parameters
    ----------
    node : str
        Name under which to report.
    """

    def __init__(self, node: str) -> None:
        self._node = node
        self._report = _descriptor(REPORT_FD)
        self._start = _descriptor(START_FD)

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

        Raises
        ------
        InputError
            If nobody has started this node who could tell it.
        RunError
            If whoever has started it has gone.
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


def _descriptor(variable: str) -> int | None:
    text = os.environ.get(variable)
    return int(text) if text else None
