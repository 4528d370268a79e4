"""A node in real time whose behaviour fails when a file is there, as a drive does whose cable is off.

With a second file it does not come back from halting, as a drive does not whose base does not answer.
"""

import sys
import threading
from pathlib import Path

from swarmabs_config.graph import REALTIME, Endpoints, requested
from swarmabs_core.messages import EVENTS, PLANE_STATE, Message, Messages, PlaneState
from swarmabs_core.parameters import Parameter
from swarmabs_core.realtime.base import Health, Level, Schedule
from swarmabs_ros.managed import RealtimeNode, RealtimeSpec
from swarmabs_ros.realtime_runner import run_realtime
from swarmabs_ros.runner import Settings


class Failing:
    """Publishes a state of the plane each period until the file is there."""

    def __init__(self, schedule: Schedule, file: Path) -> None:
        self._schedule, self._file = schedule, file

    def hear(self, message: Message, now: int) -> Messages:
        return ()

    def tick(self, now: int) -> Messages:
        if self._file.exists():
            raise OSError("the cable is off")
        return (PlaneState(now, self._schedule.step(now), 0.0, 0.0),)

    def halt(self) -> None:
        self._file.with_suffix(".halted").touch()
        if self._file.with_suffix(".hangs").exists():
            threading.Event().wait()

    def health(self, now: int) -> Health:
        return Health(Level.OK, "fine")


def make(settings: Settings, node: RealtimeNode) -> RealtimeSpec:
    behaviour = Failing(settings.made(Schedule), Path(settings.text("file")))
    heard = {PLANE_STATE: requested(PLANE_STATE, REALTIME, depth=10)}
    return RealtimeSpec(behaviour, 0.5, Endpoints((EVENTS, PLANE_STATE), heard))


if __name__ == "__main__":
    sys.exit(run_realtime("failing", (Parameter("file", "", "the file"),), make))
