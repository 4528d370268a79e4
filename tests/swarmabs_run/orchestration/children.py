"""Processes for a launcher to fork, and ``python -m ... LOGS``: an orchestrator that starts two and then waits."""

import gc
import os
import signal
import sys
from pathlib import Path

from swarmabs_ros.status import START_FD
from swarmabs_run.orchestration.machine import Machine
from swarmabs_run.orchestration.network import PARTICIPANT_VARIABLE, profile_environment
from swarmabs_run.orchestration.plan import ProcessPlan


def child(name: str) -> ProcessPlan:
    """Return the plan of a process that does what its arguments say."""
    return ProcessPlan(name, "tests.swarmabs_run.orchestration.children", 8, {}, (), ())


def main(arguments: list[str]) -> int:
    action, *rest = arguments
    sys.stdout.write(f"{action} begins\n")
    if action == "exit":
        return int(rest[0])
    if action == "raise":
        raise RuntimeError(rest[0])
    if action == "loaded":
        return sum(name not in sys.modules for name in rest) + (gc.get_freeze_count() == 0)
    if action == "profile":
        return int(any(os.environ.get(name, "") != rest[0] for name in profile_environment("")))
    if action == "participant":
        return int(os.environ[PARTICIPANT_VARIABLE])
    if action == "start":
        return len(os.read(int(os.environ[START_FD]), 100))
    if action == "ignore-sigterm":
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    if action == "end-in-order":
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    sys.stdout.write("waiting\n")
    sys.stdout.flush()
    while True:
        signal.pause()


if __name__ == "__main__":
    logs = Path(sys.argv[1])
    client = Machine({}, logs / "launcher.log", processes=2)
    for node in ("one", "two"):
        client.spawn(child(node), ["ignore-sigterm"], logs / f"{node}.log")
    signal.pause()
