"""The process that shows a run to RViz and Foxglove, as `swarmabs_view.viewers` starts it."""

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
"""Where cores are scarce, those who look wait for those who work."""
_LOOK = 0.05


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
    """Wait until all processes of the run have met: nothing may disturb that. False if it ends before."""
    while not _asked_to_end(_LOOK):
        told = read_progress(run / "logs")
        if told is not None and told.phase != "starting":
            return told.phase != OVER
    return False


def _asked_to_end(seconds: float) -> bool:
    """Wait until standard input ends, or for a time (s); tell whether it has ended."""
    deadline = time.monotonic() + seconds
    while True:
        ready, _, _ = select.select([0], [], [], max(0.0, deadline - time.monotonic()))
        if ready:
            return not os.read(0, 4096)
        if time.monotonic() >= deadline:
            return False


if __name__ == "__main__":
    sys.exit(main())
