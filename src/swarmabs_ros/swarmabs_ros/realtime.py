"""The loop that drives a node behaviour by the clock: hear what has arrived, make the step that is due, publish.

Everything that touches the behaviour happens in the thread that runs the loop; other threads hand in jobs.
"""

from __future__ import annotations

import gc
import queue
import threading
import time
from concurrent.futures import Future, TimeoutError as NotInTimeError
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar, cast

from swarmabs_core.cdr import decode, encode
from swarmabs_core.errors import MalformedMessageError, RunError
from swarmabs_core.messages import EVENTS, TOPIC_OF
from swarmabs_core.realtime.base import Health, Level
from swarmabs_ros.timing import Reading, StepClock

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rclpy.publisher import Publisher

    from swarmabs_core.messages import Messages, Topic
    from swarmabs_core.realtime.base import RealtimeBehaviour
    from swarmabs_ros.endpoints import Receiver

SLICE = 0.1
"""Longest time, s, for which the loop does not look for jobs, or whether it shall stop."""
ANSWER_WITHIN = 2.0
"""Time, s, after which whoever waits for a job takes the loop to hang."""
TOLERATED = 0.01
"""Share of periods that may be missed from one report of health to the next without a warning."""
_PAIRED = 100_000
"""Longest time between the readings of two clocks, ns, that are one reading."""

T = TypeVar("T")


def read_clocks() -> Reading:
    """Read the system's clock and the steady one; again if this thread was interrupted between them."""
    for _ in range(3):
        steady = time.monotonic_ns()
        system = time.time_ns()
        if time.monotonic_ns() - steady < _PAIRED:
            break
    return Reading(system, steady)


@dataclass(frozen=True, slots=True)
class Engine:
    """What the loop drives.

    Parameters
    ----------
    behaviour : RealtimeBehaviour
        The node's state machine.
    clock : StepClock
        When its steps are due.
    receiver : Receiver
        Its subscriptions.
    depths : mapping
        How many messages of each topic may wait.
    publishers : mapping
        Its publishers by topic.
    wakes : tuple of Topic
        Topics whose messages are heard at once; all others are heard when a step is due.
    """

    behaviour: RealtimeBehaviour
    clock: StepClock
    receiver: Receiver
    depths: Mapping[Topic, int]
    publishers: Mapping[Topic, Publisher]
    wakes: tuple[Topic, ...] = ()


class RealtimeLoop:
    """Drives an engine while it is active.

    Parameters
    ----------
    on_failure : callable
        Told, in the loop's thread, of an error of the behaviour; it has been halted and is silent by then.
    on_pass : callable
        Called with the steady time, ns, every `SLICE` s at the latest.
    read : callable
        Reads the clocks.
    sleep : callable
        Sleeps, s, by the steady clock.
    """

    def __init__(
        self,
        on_failure: Callable[[Exception], None],
        on_pass: Callable[[int], None] = lambda _: None,
        *,
        read: Callable[[], Reading] = read_clocks,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._on_failure = on_failure
        self._on_pass = on_pass
        self._read = read
        self._sleep = sleep
        self._engine: Engine | None = None
        self._active = False
        self._jobs: queue.SimpleQueue[tuple[Callable[[], Any], Future[Any]]] = queue.SimpleQueue()
        self._thread: int | None = None
        self._stopping = False
        self._reported = (0, 0)
        self.refused = 0
        self.refusal = ""

    # From any thread

    def stop(self) -> None:
        """Make `run` return soon."""
        self._stopping = True

    def call(self, work: Callable[[], T], timeout: float = ANSWER_WITHIN) -> T:
        """Have something done in the loop's thread, between two passes, and return what it returns.

        Raises
        ------
        RunError
            If it was not done in time (s); then it will not be done either.
        """
        if threading.get_ident() == self._thread:
            return work()
        answer: Future[T] = Future()
        self._jobs.put((work, answer))
        try:
            return answer.result(timeout)
        except NotInTimeError:
            if answer.cancel():
                raise RunError(f"the loop that makes the steps has not answered for {timeout:g} s") from None
            return answer.result()

    def attach(self, engine: Engine | None) -> None:
        """Take over what is to be driven, not active at first; None: nothing."""
        self.call(lambda: self._attach(engine))

    def activate(self) -> None:
        """Begin to make steps."""
        self.call(self._activate)

    def deactivate(self) -> None:
        """Halt the behaviour, and be silent."""
        self.call(self._deactivate)

    def command(self, work: Callable[[int], Messages]) -> None:
        """Have an operator's command done, given the time in ns since 1970, and publish what it answers.

        Raises
        ------
        RunError
            If nothing is active.
        """
        self.call(lambda: self._command(work))

    def health(self, timeout: float = ANSWER_WITHIN) -> Health:
        """Return how behaviour and timing are; what was missed counts since the last time this was asked."""
        return self.call(self._health, timeout)

    # In the loop's thread

    def run(self) -> None:
        """Drive what is attached while it is active, until `stop` is called; then halt it."""
        self._thread = threading.get_ident()
        while not self._stopping:
            self._on_pass(self._read().steady)
            self._do_jobs(wait=not self._active)
            if self._active:
                try:
                    self._pass()
                except Exception as error:  # noqa: BLE001 - whatever goes wrong, the body must be left safe
                    self._fail(error)
        try:
            self._deactivate()
        except Exception as error:  # noqa: BLE001 - as above
            self._on_failure(error)
        self._do_jobs(wait=False)

    def _do_jobs(self, *, wait: bool) -> None:
        try:
            while True:
                work, answer = self._jobs.get(wait, SLICE)
                if answer.set_running_or_notify_cancel():
                    try:
                        answer.set_result(work())
                    except Exception as error:  # noqa: BLE001 - it is raised where it was asked for
                        answer.set_exception(error)
                wait = False
        except queue.Empty:
            return

    def _pass(self) -> None:
        engine = cast("Engine", self._engine)
        now = self._read()
        if engine.clock.due(now) is not None:
            self._hear(engine, now.system)
            self._publish(engine, engine.behaviour.tick(now.system))
            return
        rest = min(SLICE, engine.clock.wait(now) / 1e9)
        if not engine.wakes:
            self._sleep(rest)
        elif engine.receiver.wait(engine.wakes, rest):
            self._hear(engine, self._read().system)

    def _hear(self, engine: Engine, now: int) -> None:
        """Hear what has arrived, so much at most as may wait: a flood does not keep the step from being made."""
        for topic, depth in engine.depths.items():
            for _ in range(depth):
                data = engine.receiver.take(topic)
                if data is None:
                    break
                try:
                    message = decode(topic.message, data)
                except MalformedMessageError as error:
                    self.refused += 1
                    self.refusal = str(error)
                    continue
                self._publish(engine, engine.behaviour.hear(message, now))

    @staticmethod
    def _publish(engine: Engine, messages: Messages) -> None:
        for message in messages:
            engine.publishers[TOPIC_OF[type(message)]].publish(encode(message))

    def _attach(self, engine: Engine | None) -> None:
        self._deactivate()
        self._engine = engine
        self._reported, self.refused, self.refusal = (0, 0), 0, ""

    def _activate(self) -> None:
        if self._engine is None:
            raise RunError("there is nothing to activate")
        for topic, depth in self._engine.depths.items():
            if topic is EVENTS:  # kept for those who come late, whatever their age
                continue
            for _ in range(depth):  # what has waited until now is old
                if self._engine.receiver.take(topic) is None:
                    break
        self._engine.clock.start(self._read())
        # What is there now stays: the collector need not go through it again while steps are made.
        gc.collect()
        gc.freeze()
        self._active = True

    def _deactivate(self) -> None:
        if self._active:
            self._active = False
            gc.unfreeze()
            cast("Engine", self._engine).behaviour.halt()

    def _fail(self, error: Exception) -> None:
        try:
            self._deactivate()
        except Exception as worse:  # noqa: BLE001 - told together with what led to it
            error = RunError(f"{_text(error)}; then halting failed too: {_text(worse)}")
        self._on_failure(error)

    def _command(self, work: Callable[[int], Messages]) -> None:
        if not self._active or self._engine is None:
            raise RunError("this node is not active")
        try:
            self._publish(self._engine, work(self._read().system))
        except Exception as error:
            self._fail(error)
            raise

    def _health(self) -> Health:
        if self._engine is None:
            return Health(Level.WARN, "nothing is configured")
        now, clock = self._read(), self._engine.clock
        level, text, values = self._engine.behaviour.health(now.system)
        missed, made = clock.missed - self._reported[0], clock.lateness.count - self._reported[1]
        self._reported = clock.missed, clock.lateness.count
        concerns = [text]
        if missed > TOLERATED * (missed + made):
            level = max(level, Level.WARN)
            concerns.append(f"{missed} periods missed")
        return Health(level, "; ".join(concerns), (*values, *timing_values(clock), *self._refusals()))

    def _refusals(self) -> tuple[tuple[str, str], ...]:
        values = (("malformed messages", str(self.refused)),)
        return (*values, ("last malformed", self.refusal)) if self.refused else values


def timing_values(clock: StepClock) -> tuple[tuple[str, str], ...]:
    """Return the figures of timing for people."""
    late = clock.lateness
    return (
        ("steps made", str(late.count)),
        ("periods missed", str(clock.missed)),
        ("late, half below (us)", str(late.below(0.5))),
        ("late, 99.9 % below (us)", str(late.below(0.999))),
        ("late, longest (us)", str(late.longest // 1000)),
        ("clock jumps", str(clock.jumps)),
        ("largest clock jump (ms)", f"{clock.largest_jump / 1e6:.3f}"),
    )


def timing_report(clock: StepClock) -> dict[str, object]:
    """Return the figures of timing as a JSON document; the histogram by the upper edges of its bins, us."""
    return {
        "steps": clock.lateness.count,
        "missed": clock.missed,
        "longest_us": clock.lateness.longest // 1000,
        "lateness_us": {str(edge): count for edge, count in clock.lateness.bins().items()},
        "clock_jumps": clock.jumps,
        "largest_clock_jump_ns": clock.largest_jump,
    }


def _text(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"
