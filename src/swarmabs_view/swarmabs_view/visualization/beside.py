"""The markers beside a run: a process of its own, which the run does not need and which ends with its command."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from swarmabs_run.orchestration.progress_file import OVER, read_progress
from swarmabs_run.parent_death import die_with_parent

if TYPE_CHECKING:
    from collections.abc import Iterator

LOG = "markers.log"
END_SECONDS = 5.0
"""Longest time, s, that the process may take to end; then it is killed."""
_NICENESS = 10
"""Where cores are scarce, those who look wait for those who work."""
_LOOK = 0.05


@contextmanager
def markers_beside(folder: Path, *, ros: bool, foxglove_port: int | None, clock: bool) -> Iterator[None]:
    """Show the run in a folder, which is about to begin, for the time of the block.

    Parameters
    ----------
    folder : Path
        The run's folder.
    ros : bool
        Whether to publish on topics of ROS.
    foxglove_port : int, optional
        Port for Foxglove; without it nothing is served.
    clock : bool
        Whether to publish the time of the steps as clock, where it is not that of the machine.
    """
    parameters = {"ros": _yaml(ros), "clock": _yaml(clock), "foxglove_port": _yaml(foxglove_port)}
    words = [f"{name}:={value}" for name, value in parameters.items()]
    log = folder / "logs" / LOG
    command = [sys.executable, "-m", "swarmabs_view.visualization.beside", str(os.getpid()), str(folder), *words]
    with subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C in a terminal is for the command alone
    ) as process:
        try:
            yield
        finally:
            if process.stdin is not None:
                process.stdin.close()
            try:
                process.wait(END_SECONDS)
            except subprocess.TimeoutExpired:
                process.kill()
    if process.returncode > 0:
        sys.stderr.write(f"warning: the markers have failed; see {log}\n")


def _yaml(value: bool | int | None) -> str:  # noqa: FBT001
    return str(-1 if value is None else value).lower()


def main() -> int:
    """Wait until the run has started, join its network and show it until standard input ends."""
    parent, folder, *words = sys.argv[1:]
    die_with_parent(int(parent))
    os.nice(_NICENESS)
    from swarmabs_run.orchestration.looking_in import (  # noqa: PLC0415 - after the first lines
        RunOverError,
        environment_of_run,
    )
    from swarmabs_run.orchestration.tracing_files import tracing_files_removed  # noqa: PLC0415

    run = Path(folder)
    with tracing_files_removed():
        from swarmabs_view.visualization import node  # noqa: PLC0415 - the whole of ROS, while the run starts

        if not _started(run):
            return 0
        try:
            os.environ.update(environment_of_run(run))
        except RunOverError:
            return 0
        log = os.open(run / "logs" / LOG, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        for descriptor in (1, 2):
            os.dup2(log, descriptor)
        path = str(run.resolve() / "scenario.yaml").replace("'", "''")
        given = [f"scenario_file:='{path}'", *words]
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
