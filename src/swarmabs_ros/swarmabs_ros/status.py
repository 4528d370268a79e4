"""What a node tells the process that started it, and how it is told to begin.

The orchestrator hands down two file descriptors by environment variables: a pipe on which nodes report in lines of
JSON, and the read end of another pipe whose closing is the start signal for all at once. A node that was started by
hand has neither, reports nowhere and begins at once.
"""

from __future__ import annotations

import json
import os
import select
from typing import Literal

REPORT_FD = "SWARMABS_REPORT_FD"
START_FD = "SWARMABS_START_FD"

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


def _descriptor(variable: str) -> int | None:
    text = os.environ.get(variable)
    return int(text) if text else None
