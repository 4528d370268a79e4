"""The parent controller in real time: it answers each state of the plane, and publishes STOP and RESET."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_core.controllers import ParentLaw
from swarmabs_core.declaration import part, same, setting
from swarmabs_core.desired_state import DesiredStateGenerator, SwarmOnPlane
from swarmabs_core.errors import RunError
from swarmabs_core.events import EventCode
from swarmabs_core.manifold import Manifold
from swarmabs_core.messages import (
    NEVER,
    PLANE_STATE,
    STANDING,
    TOPIC_OF,
    AbstractState,
    Basis,
    DesiredAbstractState,
    Message,
    Messages,
    Mode,
    PlaneState,
    Source,
    StandingState,
    SwarmEvent,
)
from swarmabs_core.plant import Plane
from swarmabs_core.realtime.base import UNKNOWN, Health, Level, Realtime, Schedule, Sender
from swarmabs_core.realtime.leadership import Pair, Voice
from swarmabs_core.realtime.modes import ModeLatch, Orders, PublishedMode
from swarmabs_core.realtime.validation import Bounds, Heard, Origin, Problem, Refusals, Writers
from swarmabs_core.summation import each_sum
from swarmabs_core.swarm_law import SwarmGains

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from swarmabs_core.controllers import ParentController

_PLANE, _PEER = Origin(PLANE_STATE.name), "the other controller"
MOST_STEPS = 100
"""Largest number of missed steps that law and filter make up for; after more, they restart."""
PULL = 0.1
"""Share of their mean distance by which the integrals of a law approach those of other robots in a period."""


class LawView(NamedTuple):
    """What robots tell each other of their instances of the law.

    Attributes
    ----------
    begun : int
        Step 0 of the law; -1 if it has not begun.
    step : int
        The last step that it has computed.
    memory : tuple of float
        What it remembers after that step.
    """

    begun: int = -1
    step: int = -1
    memory: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class RealtimeControllerConfig:
    """Configuration of the parent controller in real time."""

    schedule: Schedule = part(Schedule, name="")
    manifold: Manifold = part(Manifold)
    law: ParentLaw = part(ParentLaw, name="")
    gravity: float = same(Plane, "gravity")
    plane_length: float = same(Plane, "length")
    gains: SwarmGains = part(SwarmGains)
    start_mode: Mode = setting(
        Mode.RUN,
        "run: the swarm moves as soon as it is ready; stop: it waits for a reset",
        choices=("run", "stop"),
        make=lambda name: Mode[name.upper()],
        say=lambda mode: mode.name.lower(),
    )
    plane_age_limit: float = same(Realtime, "plane_age_limit")
    clock_tolerance: float = same(Realtime, "clock_tolerance")
    pair: Pair = part(Pair, name="")

    @property
    def bounds(self) -> Bounds:
        """Known properties of the swarm and its plane, against which messages are validated."""
        return Bounds(self.gravity, self.plane_length)

    def make_law(self) -> ParentController:
        """Return the control law in its initial state."""
        return self.law.make(self.schedule.period, self.manifold)

    def generator(self, law: ParentController) -> DesiredStateGenerator:
        """Return what generates the desired abstract state with a law."""
        return DesiredStateGenerator(
            self.schedule.period_ns, self.manifold, law, SwarmOnPlane(self.gravity, self.gains, self.law.compensated)
        )


class RealtimeController:
    """Answers the plane's state of a step with the desired abstract state of that step.

    The controller and its reference start when the observer publishes the swarm's abstract state. Without a fresh state
    of the plane it publishes nothing, and the robots stop by themselves. `make_law` creates the control law at the
    start and after each reset.

    Attributes
    ----------
    voice : Voice
        Whether it is this one of a pair that speaks.
    """

    def __init__(self, config: RealtimeControllerConfig, make_law: Callable[[], ParentController]) -> None:
        self._config, self._bounds = config, config.bounds
        self._make_law = make_law
        self._age = config.schedule.steps(config.plane_age_limit)
        self._heard: Heard[None] = Heard(self._age, config.schedule.ahead(config.clock_tolerance))
        self._writers = Writers(self._age)
        self._refusals = Refusals()
        latch = ModeLatch(config.schedule, config.plane_age_limit, config.clock_tolerance)
        self._mode = PublishedMode(config.start_mode, latch, config.schedule)
        self._swarm_heard = False
        self._plane: PlaneState | None = None
        self._divided: tuple[StandingState, bool] | None = None  # the newest, and whether it is a standby's
        # Steps by which the clock is so far ahead of the plane's that robots would refuse a STOP of its time.
        self._fast = 0
        self._asked: DesiredAbstractState | None = None
        self._last_published = -1
        self._ticked = -1
        self._blind = False
        self.voice = Voice(EventCode.CONTROLLER_LEADS, config.pair, config.schedule, config.clock_tolerance)
        self._restart()

    def _restart(self) -> None:
        self._generator = self._config.generator(self._make_law())
        self._first_step: int | None = None
        self._law_step = -1
        self._memories: dict[int, tuple[float, ...]] = {}

    def tuned(self, make_law: Callable[[], ParentController]) -> Callable[[], None]:
        """Return a callable that starts a new law between two steps; raises `InputError` if its settings are wrong."""
        make_law()

        def install() -> None:
            self._make_law = make_law
            self._restart()

        return install

    def hear(self, message: Message, now: int, sender: Sender = UNKNOWN) -> Messages:
        """Take a state of the plane or of the swarm; return the desired abstract state of the step."""
        if isinstance(message, AbstractState):
            self._swarm_heard = True
            return ()
        step = self._config.schedule.step(now)
        if isinstance(message, StandingState):
            return self._learn_division(message, step, now, sender)
        if isinstance(message, (DesiredAbstractState, Basis)) and not self._config.pair.single:
            return self._hear_peer(message, step, now, sender)
        if not isinstance(message, PlaneState):
            return self._refusals.add(Problem("not a state of the plane"), step, now)
        taken, answers = self.take(message, now, sender)
        return (*answers, *self.answer(message, now)) if taken else answers

    def take(self, plane: PlaneState, now: int, sender: Sender = UNKNOWN) -> tuple[bool, Messages]:
        """Keep a state of the plane if it is credible and newer than the known one; return whether, and events."""
        step = self._config.schedule.step(now)
        problem = self._problem(plane, step, sender.writer)
        if problem:
            return False, self._refusals.add(problem.of(_PLANE), step, now)
        if self._plane is not None and plane.step <= self._plane.step:
            return False, ()
        self._plane = plane
        self._fast = max(0, step - plane.step - self._config.schedule.ahead(self._config.clock_tolerance))
        return True, ()

    def _learn_division(self, message: StandingState, step: int, now: int, sender: Sender) -> Messages:
        """Keep the newest message on how the abstract state divides, unless it is not credible."""
        origin = Origin(STANDING.name, standby=sender.standby)
        problem = self._heard.untimely(message, step) or self._bounds.problem(message)
        problem = problem or self._writers.second(origin, sender.writer, step)
        if problem:
            return self._refusals.add(problem.of(origin), step, now)
        if self._divided is None or message.step > self._divided[0].step:
            self._divided = message, sender.standby
        return ()

    def _division(self, step: int) -> tuple[StandingState, bool] | None:
        """Return how the abstract state divides, if that is known and recent at a step."""
        division = self._divided
        return division if division is not None and abs(step - division[0].step) <= self._age else None

    def tick(self, now: int) -> Messages:
        """Repeat STOP and RESET even without states of the plane, and report if those are missing."""
        step = self._config.schedule.step(now)
        self._writers.advance(step)
        self._mode.prolong(step - self._ticked - 1, step)
        self._ticked = step
        events = self.voice.say(self._end_reset(now, step), now, able=self._keeps_still)
        newest = max(self._last_published, -1 if self._plane is None else self._plane.step)
        if newest > step + self._age:  # the clock was set back
            self._plane, self._last_published, self._fast, self._divided = None, -1, 0, None
            self._heard.forget()
            self._mode.forget(step)
        if self._mode.now is not Mode.RUN and self._last_published < step - self._fast:
            return (*events, *self._say_still(now, step - self._fast))
        doubt, was_blind = self._doubt(step), self._blind
        self._blind = bool(doubt)
        if doubt and not was_blind and self._plane is not None:
            stalled = self._event(now, EventCode.STALLED, 0.0, doubt)
            return (*events, *self.voice.say((stalled,), now, able=False))
        return events

    def stop(self, now: int) -> Messages:
        """Stop the swarm until `reset`; the message is published at once."""
        step, before = self._config.schedule.step(now), self._mode.now
        self._mode.stop(step)
        announced = self._announced(now, step)
        return announced[1:] if before is Mode.STOP else announced

    def reset(self, now: int) -> Messages:
        """Resume after `stop`, also after a stop before this node started; law and reference restart."""
        step = self._config.schedule.step(now)
        self._mode.reset(step)
        self._restart()
        return self.voice.say(self._announced(now, step), now)

    @property
    def orders(self) -> Orders:
        """What was ordered at this controller and, among robots, anywhere."""
        return self._mode.orders

    @property
    def guard(self) -> int:
        """Steps by which a RESET must be newer than a STOP that is not known where it is ordered."""
        return self._mode.guard

    @property
    def view(self) -> LawView:
        """What this instance of the law tells those of other robots."""
        if self._first_step is None:
            return LawView()
        return LawView(self._first_step, self._law_step, self._memories.get(self._law_step, ()))

    @property
    def progress(self) -> tuple[float, ...]:
        """The desired state from which it continues, as in `DesiredStateGenerator.progress`."""
        return self._generator.progress

    def obey(self, orders: Orders, now: int) -> Messages:
        """Take over STOP and RESET that were ordered at other robots; law and reference restart with a RESET."""
        step, before = self._config.schedule.step(now), self._mode.now
        self._mode.obey(orders, step, self._first_step)
        if self._mode.now is before:
            return ()
        if self._mode.now is Mode.RESET:
            self._restart()
        return self._announced(now, step)

    def agree(self, views: Collection[LawView]) -> None:
        """Hold this instance of the law together with those of other robots, given what they told since the last call.

        Its time counts from the earliest step in which one of them began. Its integrals approach the mean of the
        others': compared are those of the same step, so that nothing is held back.
        """
        answered = self._law_step if self._plane is None else self._plane.step
        views = [view for view in views if view.begun >= 0 and abs(view.step - answered) <= MOST_STEPS]
        if not views or self._mode.now is not Mode.RUN:
            return
        first = min(views)
        if self._first_step is None or first.begun < self._first_step:
            if self._first_step is None:
                self._law_step = max(first.step, answered)
            self._first_step = first.begun
            self._generator.recall(first.memory)
            self._memories = {self._law_step: first.memory}
            return
        own = self._memories
        apart = [
            [theirs - ours for theirs, ours in zip(view.memory, own[view.step], strict=True)]
            for view in views
            if view.begun == self._first_step and len(view.memory) == len(own.get(view.step, ())) > 0
        ]
        if apart:
            shift = [PULL * total / len(apart) for total in each_sum(zip(*apart, strict=True))]
            self._memories = {
                step: tuple(ours + by for ours, by in zip(memory, shift, strict=True)) for step, memory in own.items()
            }
            self._generator.recall(self._memories[self._law_step])

    def halt(self) -> None:
        """Discard the plane's state; the robots then stop when the last desired state is outdated."""
        self._plane = None
        self._restart()

    def health(self, now: int) -> Health:
        """Return the mode and the desired abstract state, and any second senders."""
        return self._writers.warned(self._health(now))

    def _health(self, now: int) -> Health:
        asked, plane = self._asked, self._plane
        values = (
            ("mode", self._mode.now.name),
            ("desired torque, N m", "none" if asked is None else f"{asked.torque:.4f}"),
            ("desired inertia, kg m^2", "none" if asked is None else f"{asked.inertia:.5f}"),
            ("angle, rad", "none" if plane is None else f"{plane.angle:.4f}"),
            *self._refusals.values(),
            *self.voice.values(now),
        )
        if self._mode.now is not Mode.RUN:
            return Health(Level.WARN, f"{self._mode.now.name}: {self._mode.why}", values)
        doubt = self._doubt(self._config.schedule.step(now))
        if doubt:
            return Health(Level.ERROR, doubt, values)
        if not self._swarm_heard:
            return Health(Level.WARN, "waiting for the observer", values)
        return Health(Level.OK, "running", values)

    def _problem(self, message: PlaneState, step: int, writer: bytes) -> Problem | None:
        problem = self._heard.untimely(message, step) or self._bounds.problem(message)
        if problem:
            return problem
        problem = self._writers.second(_PLANE, writer, step)
        if self._heard.add(None, message, step, refused=problem is not None) and not problem:
            problem = Problem("two different ones of a step; a second plane, or an intruder")
        return problem

    def _second(self, message: DesiredAbstractState | Basis, step: int, sender: Sender) -> Problem | None:
        """Return a problem if a message is not of the other controller, but of a second writer."""
        number = message.source if isinstance(message, Basis) else 0
        origin = Origin(TOPIC_OF[type(message)].name, number, sender.standby)
        return self._writers.second(origin, sender.writer, step)

    def _doubt(self, step: int) -> str:
        """Return why the plane's state permits no desired state; empty if it permits one."""
        if self._heard.doubts(None, step):
            return "the states of the plane contradict each other"
        if self._plane is None or step - self._plane.step > self._age:
            return "no fresh state of the plane"
        return ""

    def answer(self, plane: PlaneState, now: int) -> Messages:
        """Return the desired abstract state that answers a state of the plane that was taken."""
        step = self._config.schedule.step(now)
        if self._mode.now is not Mode.RUN:
            return () if plane.step <= self._last_published else self._say_still(now, plane.step)
        if not self._swarm_heard or self._doubt(step):
            return ()
        if self._first_step is not None and not 0 < plane.step - self._law_step <= MOST_STEPS:
            self._restart()
        since = NEVER if self._first_step is None else self._law_step
        if self._first_step is None:
            self._first_step, self._law_step = plane.step, plane.step - 1
        division = self._division(plane.step)
        used, ids, marks = ((division[0].step,), (0,), (int(division[1]),)) if division else ((), (), ())
        provenance = Basis(now, plane.step, since, self._first_step, Source.CONTROLLER, used, ids, marks)
        events: list[Message] = []
        period = self._config.schedule.period_ns
        try:
            while self._law_step < plane.step:  # missed steps use the current state of the plane
                self._law_step += 1
                time = (self._law_step - self._first_step) * period
                if division is not None:
                    self._generator.divide(division[0])
                news, desired = self._generator.advance(time, plane)
                events.extend(event._replace(stamp=now) for event in news)
        except RunError as error:
            self._mode.fail(step, str(error))
            return self.voice.say(self._announced(now, step), now)
        self._asked, self._last_published = desired._replace(stamp=now), plane.step
        if memory := self._generator.law_memory:
            kept = range(plane.step - self._age, plane.step)
            self._memories = {k: held for k, held in self._memories.items() if k in kept} | {plane.step: memory}
        return self.voice.say((*events, provenance, self._asked), now)

    def _hear_peer(self, message: DesiredAbstractState | Basis, step: int, now: int, sender: Sender) -> Messages:
        """Note that the other controller speaks, and take over its mode and the time of its law unless this one leads.

        A STOP counts whatever it is, as for a robot.
        """
        stops = isinstance(message, DesiredAbstractState) and message.mode == Mode.STOP
        problem = self._heard.untimely(message, step)
        if stops and not self._heard.from_future(message, step):
            problem = None
        elif not problem:
            problem = self._bounds.problem(message) or self._second(message, step, sender)
        if problem:
            return self._refusals.add(problem.of(_PEER), step, now)
        leadership = self.voice.leadership
        if isinstance(message, Basis):
            if message.source == Source.CONTROLLER and not leadership.leading:
                self._adopt(message.step, message.begun)
            return ()
        leadership.hear(message.step, step)
        before = self._mode.now
        self._mode.hear(Mode(message.mode), message.step, leading=leadership.leading)
        if self._mode.now is Mode.RESET and before is not Mode.RESET:
            self._restart()
        if stops and self._mode.now is not before:
            return self.voice.say(self._announced(now, step), now)
        if message.mode == self._mode.now == Mode.RUN and message.step == self._law_step and not leadership.leading:
            self._asked = message
            self._generator.follow(message)  # the command filter continues from what was asked
        return ()

    def _adopt(self, step: int, begun: int) -> None:
        """Continue the law that began in a step, of which the other controller has computed a step."""
        if self._first_step != begun and self._mode.now is Mode.RUN:
            self._restart()
            answered = -1 if self._plane is None else self._plane.step
            self._first_step, self._law_step = begun, max(step - 1, answered)

    @property
    def _keeps_still(self) -> bool:
        """Whether it has to tell the robots to keep still.

        One of a pair that starts in STOP may not have discovered the other one yet, which leads a moving swarm. Until
        it has been told the mode it says nothing; robots without a controller stand still anyway.
        """
        return self._mode.now is not Mode.RUN and (self._mode.told or self._config.pair.single)

    def _say_still(self, now: int, step: int) -> Messages:
        """Return the desired state that stops all robots if this controller leads, or if only it was told to stop."""
        if not self._keeps_still:
            return ()
        still = self._keep_still(now, step)
        said = self.voice.say((still,), now)
        return said or ((still,) if self._mode.told_to_stop else ())

    def _keep_still(self, now: int, step: int) -> DesiredAbstractState:
        """Return the desired state of a step that stops all robots."""
        self._last_published = max(self._last_published, step)
        asked = self._asked
        torque, inertia = (0.0, self._config.manifold.offset) if asked is None else (asked.torque, asked.inertia)
        return DesiredAbstractState(now, max(0, step), self._mode.now, torque, inertia)

    def _announced(self, now: int, step: int) -> Messages:
        """Return what tells of STOP or RESET in a step."""
        return self._changed(now), self._keep_still(now, step - self._fast)

    def _changed(self, now: int) -> SwarmEvent:
        return self._event(now, EventCode.MODE_CHANGED, float(self._mode.now), self._mode.why)

    def _end_reset(self, now: int, step: int) -> Messages:
        leadership = self.voice.leadership
        follows = not leadership.leading and leadership.hears_peer(step)
        if follows or not self._mode.is_over(step):
            return ()
        self._mode.run()
        return (self._changed(now),)

    def _event(self, now: int, code: EventCode, value: float, detail: str) -> SwarmEvent:
        step = max(0, self._config.schedule.step(now))
        return code.event(now, step, value, detail=detail)
