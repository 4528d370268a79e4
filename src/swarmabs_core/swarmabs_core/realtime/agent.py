"""A robot in real time: it acts only on validated, fresh data, and stops by itself if there is none."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf, isfinite
from typing import TYPE_CHECKING

from swarmabs_core.declaration import choice, part, same, setting
from swarmabs_core.events import EventCode
from swarmabs_core.messages import NEVER, AgentState, Status, SwarmEvent
from swarmabs_core.models.plane_robot import RobotConfig
from swarmabs_core.parameters import Settings
from swarmabs_core.realtime.base import UNKNOWN, Health, Level, Realtime, Schedule, Sender, StepCounter
from swarmabs_core.realtime.broadcasts import BroadcastInbox
from swarmabs_core.realtime.drives import DRIVES, SIMULATED, Reporting
from swarmabs_core.realtime.envelope import LaneEnvelope, Unmeasured
from swarmabs_core.realtime.leadership import Pair
from swarmabs_core.realtime.validation import Bounds, Refusals
from swarmabs_core.robot_controller import HELD, RESET, STOPPED, Decision, RobotController
from swarmabs_core.swarm_law import Robot

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_core.messages import Broadcast, Message, Messages
    from swarmabs_core.realtime.drives import Drive, Measurement

LEAVING_PERIODS = 10
"""Number of periods for which a leaving robot publishes its last status."""


@dataclass(frozen=True, slots=True)
class RealtimeAgentConfig(RobotConfig):
    """Configuration of a robot in real time."""

    schedule: Schedule = part(Schedule, name="")
    swarm_mass: float = same(Bounds, "swarm_mass")
    deceleration: float = setting(
        inf,
        "limit of the braking deceleration of a single integrator's base",
        unit="m/s^2",
        name="limits.deceleration",
        above=0.0,
        unset=0.0,
    )
    lane_margin: float = same(Realtime, "lane_margin")
    broadcast_age_limit: float = same(Realtime, "broadcast_age_limit")
    paired: bool = same(Pair, "paired")
    measurement_age_limit: float = setting(
        0.1, "age of a robot's motion measurement above which it stops", unit="s", above=0.0
    )
    clock_tolerance: float = same(Realtime, "clock_tolerance")
    drive: str = choice(DRIVES.find, DRIVES.built_in, SIMULATED.name, "drive of the robot")
    drive_settings: Settings = field(default_factory=dict, hash=False)

    @property
    def bounds(self) -> Bounds:
        """Known properties of the swarm and its plane, against which messages are validated."""
        return Bounds(self.gravity, self.plane_length, self.swarm_mass, self.schedule.period)

    @property
    def lane_limit(self) -> float:
        """Distance from the axis within which the robot stays, m."""
        return max(0.0, 0.5 * self.plane_length - self.lane_margin)


class RealtimeLaw:
    """Law, limits and lane of one robot. It is stateless: verification recomputes the same bits from the same input.

    Raises
    ------
    InputError
        If there is no such law, or its settings are invalid.
    """

    def __init__(self, config: RealtimeAgentConfig) -> None:
        period = config.schedule.period
        robot = Robot(config.kind, config.mass, config.damping, config.gains, config.gravity, period)
        self.controller = RobotController(robot, config.law, config.law_settings, config.limits, config.plane_length)
        self._envelope = LaneEnvelope(self.controller, period, config.lane_limit, config.deceleration)
        self._period = period

    def unmeasured(self) -> Unmeasured:
        """Return what follows a robot's motion while its sensor is silent."""
        return Unmeasured(self.controller, self._period)

    def decide(
        self, position: float, velocity: float, heard: Broadcast, moved: float = 0.0
    ) -> tuple[Decision, EventCode | None]:
        """Return the decision at a position (m) with a velocity (m/s), and which limit applied, if any.

        `moved` is how far the robot has been moved since it was measured there (`Unmeasured`), m.
        """
        decision = self.controller.decide(position, velocity, heard)
        if decision.problem:
            return decision, None
        kept = self._envelope.apply(position + moved, velocity, decision.command)
        limited = EventCode.LANE_LIMITED if kept != decision.command else EventCode.COMMAND_LIMITED
        return decision._replace(command=kept), limited if kept != decision.wanted else None

    def brake(self, velocity: float) -> float:
        """Return the command that stops the robot from a velocity (m/s)."""
        return self.controller.brake(velocity)


class RealtimeAgent:
    """One robot of the swarm. It has no knowledge of other robots.

    Raises `InputError` if there is no law with the configured name, or its settings are invalid.
    """

    def __init__(self, config: RealtimeAgentConfig, drive: Drive) -> None:
        self._config = config
        self._drive = drive
        self._law = RealtimeLaw(config)
        self._unmeasured = self._law.unmeasured()
        self._inbox = BroadcastInbox(config.schedule, config.broadcast_age_limit, config.clock_tolerance, config.bounds)
        self._refusals = Refusals(config.agent_id)
        self._measurement: Measurement | None = None
        self._counter = StepCounter(config.schedule)
        self._command = 0.0
        self._broadcast_step = NEVER
        self._status = Status.SAFE_STOP
        self._problem = "not started yet"
        self._held = False
        self._limited: EventCode | None = None
        self._leaving: int | None = None

    def tuned(self, config: RealtimeAgentConfig) -> Callable[[], None]:
        """Return a callable that installs the law and the gains of a configuration between two steps.

        Raises `InputError` if the settings of the law are invalid.
        """
        law = RealtimeLaw(config)

        def install() -> None:
            self._law = law

        return install

    def hear(self, message: Message, now: int, sender: Sender = UNKNOWN) -> Messages:
        """Take a broadcast, which is rejected if it is not valid."""
        problem = self._inbox.add(message, now, sender)
        return self._refusals.add(problem, self._config.schedule.step(now), now) if problem else ()

    def tick(self, now: int) -> Messages:
        """Measure, return the state, decide on the command for the next period and write it to the drive."""
        before = self._counter.last
        step = self._counter.next(now)
        if step is None:
            # Otherwise the command would be held until the clock catches up.
            set_back = before is not None and self._counter.last is None
            return self._doubt(now) if set_back else ()
        self._inbox.writers.advance(step)
        measured = self._drive.read(now)
        if measured is not None and isfinite(measured.position) and isfinite(measured.velocity):
            self._measurement = measured
        if self._measurement is not None:
            self._unmeasured.note(step, self._measurement.stamp, self._command)
        if self._leaving is not None:
            return self._repeat_last_state(step)
        fresh = self._fresh(now)
        states = self._publish(step, fresh=fresh)
        return (*states, *self._decide(now, fresh=fresh))

    def leave(self, now: int) -> Messages:
        """Stop, and announce for some periods that the robot's weight leaves the plane."""
        if self._leaving is not None:
            return ()
        self._rest()
        self._leaving = LEAVING_PERIODS
        return (self._event(now, EventCode.ASKED_TO_LEAVE),)

    def join(self, now: int) -> Messages:
        """Take part again after `leave`."""
        if self._leaving is None:
            return ()
        self._leaving = None
        return (self._event(now, EventCode.ASKED_TO_JOIN),)

    def halt(self) -> None:
        """Bring the body to a safe state, because ticks are suspended."""
        self._rest()

    def health(self, now: int) -> Health:
        """Return whether the robot follows the broadcasts, or the reason if it does not, and any second senders."""
        return self._inbox.writers.warned(self._health(now))

    def _health(self, now: int) -> Health:
        newest, m = self._inbox.newest, self._measurement
        age = None if newest is None else self._config.schedule.step(now) - newest.step
        values = (
            ("status", "LEFT" if self._leaving is not None else self._status.name),
            ("broadcast age, steps", "none" if age is None else str(age)),
            ("position, m", "none" if m is None else f"{m.position:.4f}"),
            ("velocity, m/s", "none" if m is None else f"{m.velocity:.4f}"),
            ("command", f"{self._command:.4f}"),
            *(self._inbox.followed.values() if self._config.paired else ()),
            *self._refusals.values(),
            *(self._drive.report() if isinstance(self._drive, Reporting) else ()),
        )
        if self._leaving is not None:
            return Health(Level.OK, "has left", values)
        if self._status is not Status.ACTIVE:
            level = Level.WARN if self._problem in {STOPPED, RESET} else Level.ERROR
            return Health(level, f"safe stop: {self._problem}", values)
        if self._held:
            return Health(Level.WARN, f"keeps still: {HELD}", values)
        return Health(Level.OK, f"follows the broadcasts{', ' + self._limited.text if self._limited else ''}", values)

    def _fresh(self, now: int) -> bool:
        m = self._measurement
        return m is not None and abs(now - m.stamp) <= self._config.measurement_age_limit * 1e9

    def _publish(self, step: int, *, fresh: bool) -> Messages:
        """Return the state with the command held until now; without fresh measurements its status is SAFE_STOP."""
        m, config = self._measurement, self._config
        if m is None:
            return ()
        status = Status.LEFT if self._leaving is not None else self._status if fresh else Status.SAFE_STOP
        return (
            AgentState(
                m.stamp,
                step,
                self._broadcast_step,
                config.agent_id,
                config.kind,
                status,
                config.mass,
                config.damping,
                m.position,
                m.velocity,
                self._command,
            ),
        )

    def _decide(self, now: int, *, fresh: bool) -> Messages:
        problem = self._inbox.problem(now) if fresh else "no fresh measurement of the robot's motion"
        m, broadcasts = self._measurement, self._inbox.newest
        if problem or m is None or broadcasts is None:
            return self._stop(now, problem)
        decision, limited = self._law.decide(m.position, m.velocity, broadcasts, self._unmeasured.distance)
        if decision.held:
            return self._hold(now, decision.command)
        if decision.problem:
            return self._stop(now, decision.problem)
        self._act(decision.command, broadcasts.step, now)
        events = self._active(now, followed=True)
        return (*events, *self._note_limits(now, decision.wanted, limited))

    def _doubt(self, now: int) -> Messages:
        """Stop and discard what was received, because its age is unknown after the clock was set back."""
        self._inbox.forget(now)
        return self._stop(now, "the clock was set back")

    def _stop(self, now: int, problem: str) -> Messages:
        """Brake to rest; return an event when braking starts or its reason changes."""
        m = self._measurement
        self._act(self._law.brake(m.velocity) if m is not None and self._fresh(now) else 0.0, NEVER, now)
        before, self._status, self._held, self._limited = self._status, Status.SAFE_STOP, False, None
        changed, self._problem = problem != self._problem, problem
        if before is Status.SAFE_STOP and not changed:
            return ()
        return (self._event(now, EventCode.SAFE_STOP, detail=problem),)

    def _hold(self, now: int, command: float) -> Messages:
        """Keep still with status ACTIVE: S3 vanishes until enough robots that had stopped report it again."""
        self._act(command, NEVER, now)
        before, self._limited = self._held, None
        events = self._active(now, followed=False)
        self._held = True
        return events if before else (*events, self._event(now, EventCode.HELD, detail=HELD))

    def _active(self, now: int, *, followed: bool) -> Messages:
        recovered = followed and (self._status is not Status.ACTIVE or self._held)
        self._status, self._problem = Status.ACTIVE, ""
        if not followed:
            return ()
        self._held = False
        return (self._event(now, EventCode.RECOVERED),) if recovered else ()

    def _act(self, command: float, broadcast_step: int, now: int) -> None:
        self._command, self._broadcast_step = command, broadcast_step
        self._drive.write(command, now)

    def _note_limits(self, now: int, wanted: float, limited: EventCode | None) -> Messages:
        before, self._limited = self._limited, limited
        if limited and limited is not before:
            return (self._event(now, limited, wanted),)
        return ()

    def _repeat_last_state(self, step: int) -> Messages:
        if not self._leaving:
            return ()
        self._leaving -= 1
        return self._publish(step, fresh=True)

    def _rest(self) -> None:
        self._drive.stop()
        self._command, self._broadcast_step = 0.0, NEVER
        self._status, self._held, self._limited = Status.SAFE_STOP, False, None
        self._problem = "deactivated"

    def _event(self, now: int, code: EventCode, value: float = 0.0, detail: str = "") -> SwarmEvent:
        """Return an event that holds from the next published state on."""
        step = max(0, self._config.schedule.step(now) + 1)
        return code.event(now, step, value, robot=self._config.agent_id, detail=detail)
