"""The process that shows a run in RViz and Foxglove, started by `swarmabs_view.viewers`."""

from __future__ import annotations

import os
import select
import sys
import time
from pathlib import Path

from swarmabs_run.ending import die_with_parent
from swarmabs_run.orchestration.run_files import OVER, RunOverError, environment_of_run, read_progress
from swarmabs_run.tracing_files import tracing_files_removed
from swarmabs_view.viewers import MARKERS_LOG

with tracing_files_removed():
    from swarmabs_view.visualization import node

_NICENESS = 10
"""Lower priority than that of the run, for machines with few cores."""
_POLL = 0.05


def main() -> int:
    """Wait until the run has started, join its network and show it until standard input ends."""
    parent, folder, *parameters = sys.argv[1:]
    die_with_parent(int(parent))
    os.nice(_NICENESS)
    run = Path(folder)
    with tracing_files_removed():
        if not _started(run):
            return 0
        try:
            os.environ.update(environment_of_run(run))
        except RunOverError:
            return 0
        log = os.open(run / "logs" / MARKERS_LOG, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        for descriptor in (1, 2):
            os.dup2(log, descriptor)
        path = str(run.resolve() / "scenario.yaml").replace("'", "''")
        given = [f"scenario_file:='{path}'", *parameters]
        arguments = ["--ros-args", "--disable-external-lib-logs", "--disable-rosout-logs"]
        return node.main([*arguments, *(word for text in given for word in ("-p", text))], wait=_asked_to_end)


def _started(run: Path) -> bool:
    """Wait until all processes of the run have discovered each other, undisturbed; return False if it ends before."""
    while not _asked_to_end(_POLL):
        progress = read_progress(run / "logs")
        if progress is not None and progress.phase != "starting":
            return progress.phase != OVER
    return False


def _asked_to_end(seconds: float) -> bool:
    """Wait until standard input ends, or for a time (s); return whether it has ended."""
    deadline = time.monotonic() + seconds
    while True:
        ready, _, _ = select.select([0], [], [], max(0.0, deadline - time.monotonic()))
        if ready:
            return not os.read(0, 4096)
        if time.monotonic() >= deadline:
            return False


if __name__ == "__main__":
    sys.exit(main())
