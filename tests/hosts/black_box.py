"""A robot's body for tests, a plug-in drive: it moves as the law expects, and notes every command with its time.

It does what is asked of every base: it stands when commands cease. Its file outlives the host, as a body does: a robot
whose power was cut begins again where it stood.
"""

from pathlib import Path
from typing import NamedTuple

from swarmabs_core.drive import DoubleIntegratorDrive, Drive, SingleIntegratorDrive
from swarmabs_core.messages import Kind
from swarmabs_core.parameters import Parameter, Settings
from swarmabs_core.realtime.drives import Body, DriveType, Measurement

NAME = "black_box"
HELD = 2
"""Periods for which a command moves the body."""


class Note(NamedTuple):
    """A command (m/s or N), the time at which the robot gave it, ns, and where it was, m and m/s."""

    now: int
    position: float
    velocity: float
    command: float


def notes(path: Path) -> list[Note]:
    """Return what a body has noted; a power cut leaves half a line behind."""
    if not path.exists():
        return []
    lines = (line.split() for line in path.read_text(encoding="ascii").split("\n"))
    return [Note(int(words[0]), *map(float, words[1:4])) for words in lines if words[4:] == ["."]]


class BlackBox:
    def __init__(self, settings: Settings, body: Body) -> None:
        path = Path(str(settings["file"]))
        known = notes(path)
        self._position = known[-1].position if known else float(str(settings["position"]))
        self._velocity = self._command = 0.0
        period = body.schedule.period_ns / 1e9
        self._model: Drive = SingleIntegratorDrive(period)
        if body.kind is Kind.DOUBLE_INTEGRATOR:
            self._model = DoubleIntegratorDrive.of(period, body.mass, body.damping)
        self._schedule = body.schedule
        self._step = self._stands_from = 0
        self._file = path.open("a", buffering=1, encoding="ascii")
        self._file.write("\n")

    def read(self, now: int) -> Measurement:
        step = self._schedule.step(now)
        for _ in range(self._step, min(step, self._stands_from)):
            self._position, self._velocity = self._model.advance(self._position, self._velocity, self._command)
        if step > self._stands_from:
            self._velocity = 0.0
        self._step = max(self._step, step)
        return Measurement(now, self._position, self._velocity)

    def write(self, command: float, now: int) -> None:
        self._command, self._stands_from = command, self._schedule.step(now) + HELD
        self._file.write(f"{now} {self._position!r} {self._velocity!r} {command!r} .\n")

    def stop(self) -> None:
        self._command = self._velocity = 0.0


PART = DriveType(
    NAME,
    (Parameter("file", "", "file of the notes"), Parameter("position", 0.0, "where the body is if it has none, m")),
    BlackBox,
)
