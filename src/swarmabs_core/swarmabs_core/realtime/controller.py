"""The parent controller in real time: it answers each state of the plane, and publishes STOP and RESET."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from swarmabs_core.controllers import ParentLaw
from swarmabs_core.declaration import part, same, setting
from swarmabs_core.desired_state import DesiredStateGenerator
from swarmabs_core.errors import RunError
from swarmabs_core.manifold import Manifold
from swarmabs_core.messages import (
    NEVER,
    AbstractState,
    Basis,
    DesiredAbstractState,
    EventKind,
    Message,
    Messages,
    Mode,
    PlaneState,
    Source,
    SwarmEvent,
)
from swarmabs_core.plant import Plane
from swarmabs_core.realtime.base import Health, Level, Realtime, Schedule
from swarmabs_core.realtime.validation import Bounds, Heard, Refusals

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_core.controllers import ParentController

RESET_SECONDS = 1.0
"""Time for which RESET is published before RUN, s, so that every robot hears it."""
MOST_STEPS = 100
"""Largest number of missed steps that law and filter make up for; after more, they restart."""


@dataclass(frozen=True, slots=True)
class RealtimeControllerConfig:
    """Configuration of the parent controller in real time."""

    schedule: Schedule = part(Schedule, name="")
    manifold: Manifold = part(Manifold)
    law: ParentLaw = part(ParentLaw, name="")
    gravity: float = same(Plane, "gravity")
    plane_length: float = same(Plane, "length")
    start_mode: Mode = setting(
        Mode.RUN,
        "run: the swarm moves as soon as it is ready; stop: it waits for a reset",
        choices=("run", "stop"),
        make=lambda name: Mode[name.upper()],
        say=lambda mode: mode.name.lower(),
    )
    plane_age_limit: float = same(Realtime, "plane_age_limit")
    clock_tolerance: float = same(Realtime, "clock_tolerance")

    @property
    def bounds(self) -> Bounds:
        """Known properties of the swarm and its plane, against which messages are validated."""
        return Bounds(self.gravity, self.plane_length)


class RealtimeController:
    """Answers the plane's state of a step with the desired abstract state of that step.

    The controller and its reference start when the observer publishes the swarm's abstract state. Without a fresh state
    of the plane it publishes nothing, and the robots stop by themselves. `make_law` creates the control law at the
    start and after each reset.
    """

    def __init__(self, config: RealtimeControllerConfig, make_law: Callable[[], ParentController]) -> None:
        self._config, self._bounds = config, config.bounds
        self._make_law = make_law
        self._age = config.schedule.steps(config.plane_age_limit)
        self._heard: Heard[None] = Heard(self._age, config.schedule.ahead(config.clock_tolerance))
        self._refusals = Refusals()
        self._mode = config.start_mode
        self._why = "waiting for a reset" if config.start_mode is Mode.STOP else ""
        self._reset_until = 0
        self._swarm_heard = False
        self._plane: PlaneState | None = None
        self._asked: DesiredAbstractState | None = None
        self._last_published = -1
        self._blind = False
        self._restart()

    def _restart(self) -> None:
        self._generator = DesiredStateGenerator(
            self._config.schedule.period_ns, self._config.manifold, self._make_law()
        )
        self._first_step: int | None = None
        self._law_step = -1

    def tuned(self, make_law: Callable[[], ParentController]) -> Callable[[], None]:
        """Return a callable that starts a new law between two steps; raises `InputError` if its settings are wrong."""
        make_law()

        def install() -> None:
            self._make_law = make_law
            self._restart()

        return install

    def hear(self, message: Message, now: int) -> Messages:
        """Take a state of the plane or of the swarm; return the desired abstract state of the step."""
        if isinstance(message, AbstractState):
            self._swarm_heard = True
            return ()
        step = self._config.schedule.step(now)
        problem = self._problem(message, step)
        if problem:
            return self._refusals.add(problem, step, now)
        assert isinstance(message, PlaneState)  # noqa: S101 - `_problem` has checked it
        if self._plane is not None and message.step <= self._plane.step:
            return ()
        self._plane = message
        return self._answer(message, now)

    def tick(self, now: int) -> Messages:
        """Repeat STOP and RESET even without states of the plane, and report if those are missing."""
        step = self._config.schedule.step(now)
        events = self._end_reset(now)
        if self._plane is not None and self._plane.step > step + self._age:  # the clock was set back
            self._plane, self._last_published = None, -1
            self._heard.forget()
        if self._mode is not Mode.RUN and self._last_published < step:
            return (*events, self._keep_still(now, step))
        doubt, was_blind = self._doubt(step), self._blind
        self._blind = bool(doubt)
        if doubt and not was_blind and self._plane is not None:
            return (*events, self._event(now, EventKind.STALLED, 0.0, doubt))
        return events

    def stop(self, now: int) -> Messages:
        """Stop the swarm until `reset`; the message is published at once."""
        if self._mode is Mode.STOP:
            return (self._keep_still(now, self._config.schedule.step(now)),)
        return self._change(Mode.STOP, now, "stop commanded")

    def reset(self, now: int) -> Messages:
        """Resume after `stop`, also after a stop before this node started; law and reference restart."""
        self._reset_until = now + round(RESET_SECONDS * 1e9)
        self._restart()
        return self._change(Mode.RESET, now, "reset commanded")

    def halt(self) -> None:
        """Discard the plane's state; the robots then stop when the last desired state is outdated."""
        self._plane = None
        self._restart()

    def health(self, now: int) -> Health:
        """Return the mode and the desired abstract state."""
        asked, plane = self._asked, self._plane
        values = (
            ("mode", self._mode.name),
            ("desired torque, N m", "none" if asked is None else f"{asked.torque:.4f}"),
            ("desired inertia, kg m^2", "none" if asked is None else f"{asked.inertia:.5f}"),
            ("angle, rad", "none" if plane is None else f"{plane.angle:.4f}"),
            *self._refusals.values(),
        )
        if self._mode is not Mode.RUN:
            return Health(Level.WARN, f"{self._mode.name}: {self._why}", values)
        doubt = self._doubt(self._config.schedule.step(now))
        if doubt:
            return Health(Level.ERROR, doubt, values)
        if not self._swarm_heard:
            return Health(Level.WARN, "waiting for the observer", values)
        return Health(Level.OK, "running", values)

    def _problem(self, message: Message, step: int) -> str:
        if not isinstance(message, PlaneState):
            return "not a state of the plane"
        if self._heard.from_future(message, step):
            return "plane/state: from the future; the clocks differ, or it is of another swarm"
        if message.step < step - self._age:
            return "plane/state: outdated"
        problem = self._bounds.problem(message)
        if problem:
            return f"plane/state: {problem}"
        if self._heard.add(None, message, step):
            return "plane/state: two different ones of a step; a second plane, or an intruder"
        return ""

    def _doubt(self, step: int) -> str:
        """Return why the plane's state permits no desired state; empty if it permits one."""
        if self._heard.doubts(None, step):
            return "the states of the plane contradict each other"
        if self._plane is None or step - self._plane.step > self._age:
            return "no fresh state of the plane"
        return ""

    def _answer(self, plane: PlaneState, now: int) -> Messages:
        if self._mode is not Mode.RUN:
            return () if plane.step <= self._last_published else (self._keep_still(now, plane.step),)
        if not self._swarm_heard or self._doubt(self._config.schedule.step(now)):
            return ()
        if self._first_step is not None and not 0 < plane.step - self._law_step <= MOST_STEPS:
            self._restart()
        since = NEVER if self._first_step is None else self._law_step
        if self._first_step is None:
            self._first_step, self._law_step = plane.step, plane.step - 1
        provenance = Basis(now, plane.step, since, self._first_step, Source.CONTROLLER, (), (), ())
        events: list[Message] = []
        period = self._config.schedule.period_ns
        try:
            while self._law_step < plane.step:  # missed steps use the current state of the plane
                self._law_step += 1
                time = (self._law_step - self._first_step) * period
                news, desired = self._generator.advance(time, plane)
                events.extend(event._replace(stamp=now) for event in news)
        except RunError as error:
            return self._change(Mode.STOP, now, str(error))
        self._asked, self._last_published = desired._replace(stamp=now), plane.step
        return (*events, provenance, self._asked)

    def _keep_still(self, now: int, step: int) -> DesiredAbstractState:
        """Return the desired state of a step that stops all robots."""
        self._last_published = max(self._last_published, step)
        asked = self._asked
        torque, inertia = (0.0, self._config.manifold.offset) if asked is None else (asked.torque, asked.inertia)
        return DesiredAbstractState(now, max(0, step), self._mode, torque, inertia, *(0.0,) * 6)

    def _change(self, mode: Mode, now: int, why: str) -> Messages:
        self._mode, self._why = mode, why
        event = self._event(now, EventKind.MODE_CHANGED, float(mode), why)
        if mode is Mode.RUN:
            return (event,)
        return (event, self._keep_still(now, self._config.schedule.step(now)))

    def _end_reset(self, now: int) -> Messages:
        if self._mode is Mode.RESET and now >= self._reset_until:
            return self._change(Mode.RUN, now, "reset is over")
        return ()

    def _event(self, now: int, kind: EventKind, value: float, detail: str) -> SwarmEvent:
        step = max(0, self._config.schedule.step(now))
        return SwarmEvent(now, step, 0, kind, value, detail)
