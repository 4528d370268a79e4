"""The parent controller: plane state in, desired abstract state out."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING

from swarmabs_core.behaviours.base import StepAheadError, UnexpectedMessageError, refuse_conflict
from swarmabs_core.command_filter import CommandFilter
from swarmabs_core.errors import RunError
from swarmabs_core.messages import (
    NEVER,
    PLANE_STATE,
    RECORDING_PROGRESS,
    DesiredAbstractState,
    EventKind,
    Message,
    Messages,
    Mode,
    PlaneState,
    RecordingProgress,
    SwarmEvent,
    Topic,
)

if TYPE_CHECKING:
    from swarmabs_core.controllers.base import ParentController
    from swarmabs_core.manifold import Manifold

STEEPEST = 1.5
"""Angle of the plane, rad, at which a run fails: robots slip off, and the ARISE law divides by its cosine."""
TORQUE_LIMITED = "torque limited to torque_max"
"""What the controller says of a torque that it limits."""


@dataclass(frozen=True, slots=True)
class ControllerConfig:
    """Configuration of the parent controller's node, whatever its law.

    Parameters
    ----------
    period_ns : int
        Control period, ns.
    manifold : Manifold
        Curve on which the desired abstract state lies.
    recording_window : int
        How many steps the run may be ahead of the recorder; 0 if it is not recorded.
    last_step : int, optional
        The step with which the run ends.
    """

    period_ns: int
    manifold: Manifold
    recording_window: int = 0
    last_step: int | None = None


class Controller:
    """Asks the law for a torque, limits and filters it, and lifts it onto the manifold.

    Parameters
    ----------
    config : ControllerConfig
        Configuration.
    law : ParentController
        The control law.
    """

    def __init__(self, config: ControllerConfig, law: ParentController) -> None:
        self._config = config
        self._law = law
        self._period = config.period_ns / 1e9
        self._filter = CommandFilter(self._period)
        self._state: tuple[float, float] | None = None
        self._step = 0
        self._plane: PlaneState | None = None
        self._written = -1
        self._clipped = False

    def start(self) -> Messages:
        """Publish nothing: the plane begins."""
        return ()

    def handle(self, message: Message) -> Messages:
        """Take a plane state or the recorder's progress; answer the desired abstract state of the step."""
        if isinstance(message, PlaneState):
            if message.step > self._step:
                raise StepAheadError("plane", got=message.step, expected=self._step)
            if message.step == self._step:
                if self._plane is not None:
                    refuse_conflict(self._plane, message, PLANE_STATE.name)
                self._plane = message
        elif isinstance(message, RecordingProgress):
            if message.written_step != NEVER:
                self._written = max(self._written, message.written_step)
        else:
            raise UnexpectedMessageError("parent controller", message)
        return self._finish() if self._plane is not None and self._credit() else ()

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for the plane, then, if the recorder is too far behind, for the recorder."""
        last = self._config.last_step
        if last is not None and self._step > last:
            return ()
        return (PLANE_STATE,) if self._plane is None else (RECORDING_PROGRESS,)

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the current step and who is waited for."""
        return self._step, ("plane_sim",) if self._plane is None else ("recorder",)

    def _credit(self) -> bool:
        window = self._config.recording_window
        return not window or self._step - window <= self._written

    def _finish(self) -> Messages:
        plane, manifold, period = self._plane, self._config.manifold, self._period
        assert plane is not None  # noqa: S101 - `handle` has checked it
        step, self._plane = self._step, None
        if not abs(plane.angle) < STEEPEST:
            raise RunError(
                f"step {step}: the plane's angle is {plane.angle:.4g} rad and a run ends at {STEEPEST} rad: "
                "the swarm cannot hold the plane in this scenario"
            )
        stamp = step * self._config.period_ns
        raw = self._law.torque(stamp / 1e9, plane)
        if not isfinite(raw):
            raise RunError(
                f"step {step}: the parent controller asks for a torque of {raw} N m at an angle of "
                f"{plane.angle:.4g} rad; its law must give a finite number"
            )
        command = manifold.clip(raw)
        torque, rate = self._state or (command, 0.0)
        next_torque, next_rate = self._filter.advance(torque, rate, command)
        self._state = (next_torque, next_rate)
        self._step += 1
        acceleration = (next_rate - rate) / period
        desired = DesiredAbstractState(
            stamp,
            step,
            Mode.RUN,
            torque,
            manifold.inertia(torque),
            rate,
            manifold.inertia_rate(torque, rate),
            # A robot holds its command for a period: it needs the means over it, not the initial values.
            (next_torque - torque) / period,
            manifold.curvature * (next_torque * next_torque - torque * torque) / period,
            acceleration,
            manifold.inertia_acceleration(torque, rate, acceleration),
        )
        return (*self._limit(raw, command, stamp, step), desired)

    def _limit(self, raw: float, command: float, stamp: int, step: int) -> Messages:
        """Say when the wanted torque begins to be limited."""
        before, self._clipped = self._clipped, raw != command
        if self._clipped and not before:
            return (SwarmEvent(stamp, step, 0, EventKind.LIMIT_HIT, raw, TORQUE_LIMITED),)
        return ()
