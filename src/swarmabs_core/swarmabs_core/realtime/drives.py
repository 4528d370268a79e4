"""The boundary between a robot's law and its body, as a hardware interface: read, write, stop."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

if TYPE_CHECKING:
    from swarmabs_core.drive import DoubleIntegratorDrive, SingleIntegratorDrive
    from swarmabs_core.realtime.base import Schedule

MOST_STEPS = 1000
"""Periods that a simulated robot catches up after a pause; beyond, it has stood still."""


class Measurement(NamedTuple):
    """What a robot knows of its own motion: time (ns since 1970), position (m) and velocity (m/s) along the plane."""

    stamp: int
    position: float
    velocity: float


class Drive(Protocol):
    """What moves a robot and knows where it is."""

    def read(self, now: int) -> Measurement | None:
        """Return the newest measurement, None if there has been none yet; `now` in ns since 1970."""
        ...

    def write(self, command: float, now: int) -> None:
        """Take over the command, m/s of a single integrator, N of a double integrator; it is within the limits."""
        ...

    def stop(self) -> None:
        """Leave the body safe, at rest and without drive; more than once does no harm."""
        ...


@runtime_checkable
class Reporting(Protocol):
    """A drive that has more to say of its health than that there is no measurement."""

    def report(self) -> tuple[tuple[str, str], ...]:
        """Return figures as (name, text), such as what was refused."""
        ...


class SimulatedDrive:
    """A body that moves exactly as the law expects; it begins at a position (m) with a velocity (m/s)."""

    def __init__(
        self,
        model: SingleIntegratorDrive | DoubleIntegratorDrive,
        schedule: Schedule,
        position: float,
        velocity: float = 0.0,
    ) -> None:
        self._model = model
        self._schedule = schedule
        self._position, self._velocity = position, velocity
        self._command = 0.0
        self._step: int | None = None

    def read(self, now: int) -> Measurement:
        """Move as many periods as have passed under the command held, and tell where that leads."""
        step = self._schedule.step(now)
        if self._step is not None:
            for _ in range(min(max(0, step - self._step), MOST_STEPS)):
                self._position, self._velocity = self._model.advance(self._position, self._velocity, self._command)
        self._step = step if self._step is None else max(step, self._step)
        return Measurement(now, self._position, self._velocity)

    def write(self, command: float, now: int) -> None:  # noqa: ARG002 - it is held from the last reading on
        """Hold the command until the next one."""
        self._command = command

    def stop(self) -> None:
        """Come to rest at once."""
        self._command = self._velocity = 0.0
