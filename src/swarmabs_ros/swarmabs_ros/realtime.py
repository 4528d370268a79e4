"""The loop that drives a node behaviour by the clock: hear what has arrived, make the step that is due, publish.

Everything that touches the behaviour happens in the thread that runs the loop; other threads hand in jobs. What is
done and how it is waited for are apart: an `Activity` knows no thread, and reads the clocks that it is given, so a test
can be clock, network and scheduler of a whole fleet.
"""

from __future__ import annotations

import gc
import queue
import threading
import time
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from swarmabs_core.cdr import decode, encode
from swarmabs_core.errors import MalformedMessageError, RunError
from swarmabs_core.messages import EVENTS, TOPIC_OF
from swarmabs_core.realtime.base import Health, Level
from swarmabs_ros.timing import Reading, StepClock

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from rclpy.publisher import Publisher

    from swarmabs_core.messages import Messages, Topic
    from swarmabs_core.realtime.base import RealtimeBehaviour
    from swarmabs_ros.endpoints import Receiver
    from swarmabs_ros.lockstep import Wait

SLICE = 0.1
"""Longest time, s, for which the loop does not look for jobs, or whether it shall stop."""
ANSWER_WITHIN = 2.0
"""Time, s, after which whoever waits for a job takes the loop to hang."""
HALTS_WITHIN = 5.0
"""Time, s, that halting may take, whatever asks for it: a drive that takes longer to stop is taken to hang."""
TOLERATED = 0.01
"""Share of periods that may be missed from one report of health to the next without a warning."""
_NOTHING: Wait = ((), 0.0)
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


def arrived(receiver: Receiver, depths: Mapping[Topic, int]) -> Iterator[tuple[Topic, bytes]]:
    """Take what has arrived on topics, of each so much at most as may wait: a flood does not delay what comes next."""
    for topic, depth in depths.items():
        for _ in range(depth):
            data = receiver.take(topic)
            if data is None:
                break
            yield topic, data


@dataclass(frozen=True, slots=True)
class Engine:
    """What the loop drives.

    Parameters
    ----------
    clock : StepClock
        When the behaviour's steps are due.
    depths : mapping
        How many messages of each topic may wait.
    wakes : tuple of Topic
        Topics whose messages are heard at once; all others are heard when a step is due.
    """

    behaviour: RealtimeBehaviour
    clock: StepClock
    receiver: Receiver
    depths: Mapping[Topic, int]
    publishers: Mapping[Topic, Publisher]
    wakes: tuple[Topic, ...] = ()


class Activity:
    """What is done with an engine, each thing when it is asked for: steps, messages, commands, health.

    Attributes
    ----------
    engine : Engine
        What is driven.
    active : bool
        Whether steps are made.
    refused : int
        How many malformed messages were refused.
    refusal : str
        Why the last of them was.
    """

    def __init__(self, engine: Engine, read: Callable[[], Reading]) -> None:
        self.engine = engine
        self._read = read
        self._reported = (0, 0)
        self.active = False
        self.refused = 0
        self.refusal = ""

    def activate(self) -> None:
        """Begin to make steps."""
        engine = self.engine
        # What has waited until now is old; events are kept for those who come late, whatever their age.
        for _ in arrived(engine.receiver, {t: n for t, n in engine.depths.items() if t is not EVENTS}):
            pass
        engine.clock.start(self._read())
        self.active = True

    def deactivate(self) -> None:
        """Halt the behaviour, and be silent."""
        if self.active:
            self.active = False
            self.engine.behaviour.halt()

    def advance(self) -> Wait:
        """Hear what has arrived and make the step if one is due; else say what is waited for."""
        engine, now = self.engine, self._read()
        if engine.clock.due(now) is not None:
            self._hear(now.system)
            self._publish(engine.behaviour.tick(now.system))
            return _NOTHING
        return engine.wakes, min(SLICE, engine.clock.wait(now) / 1e9)

    def wake(self) -> None:
        """Hear what has arrived between two steps."""
        self._hear(self._read().system)

    def command(self, work: Callable[[int], Messages]) -> None:
        """Have an operator's command done, given the time in ns since 1970, and publish what it answers."""
        self._publish(work(self._read().system))

    def health(self) -> Health:
        """Return how behaviour and timing are; what was missed counts since the last time this was asked."""
        now, clock = self._read(), self.engine.clock
        level, text, values = self.engine.behaviour.health(now.system)
        missed, made = clock.missed - self._reported[0], clock.lateness.count - self._reported[1]
        self._reported = clock.missed, clock.lateness.count
        concerns = [text]
        if missed > TOLERATED * (missed + made):
            level = max(level, Level.WARN)
            concerns.append(f"{missed} periods missed")
        return Health(level, "; ".join(concerns), (*values, *clock.values(), *self._refusals()))

    def _hear(self, now: int) -> None:
        engine = self.engine
        for topic, data in arrived(engine.receiver, engine.depths):
            try:
                message = decode(topic.message, data)
            except MalformedMessageError as error:
                self.refused += 1
                self.refusal = str(error)
            else:
                self._publish(engine.behaviour.hear(message, now))

    def _publish(self, messages: Messages) -> None:
        for message in messages:
            self.engine.publishers[TOPIC_OF[type(message)]].publish(encode(message))

    def _refusals(self) -> tuple[tuple[str, str], ...]:
        values = (("malformed messages", str(self.refused)),)
        return (*values, ("last malformed", self.refusal)) if self.refused else values


class Watchdog(threading.Thread):
    """Notices that something does not end in time, whatever the thread hangs in that does it, and tells `on_hang`."""

    def __init__(self, on_hang: Callable[[], None]) -> None:
        super().__init__(name="watchdog", daemon=True)
        self._on_hang = on_hang
        # Reentrant, so that a handler of signals may use it, whatever it has interrupted.
        self._orders: queue.SimpleQueue[float | None] = queue.SimpleQueue()

    def expect(self, seconds: float | None) -> None:
        """Expect an end within so many s from now; None: it has come."""
        self._orders.put(seconds)

    def end(self) -> None:
        """Watch no longer."""
        self._orders.put(-1.0)
        self.join()

    def run(self) -> None:
        """Watch until `end`, or until something hangs."""
        seconds: float | None = None
        while seconds is None or seconds >= 0.0:
            try:
                seconds = self._orders.get(timeout=seconds)
            except queue.Empty:
                self._on_hang()
                return


class RealtimeLoop:
    """Drives an engine while it is active.

    Parameters
    ----------
    on_failure : callable
        Told, in the loop's thread, of an error of the behaviour; it has been halted and is silent by then.
    on_pass : callable
        Called with the steady time, ns, every `SLICE` s at the latest.
    on_hang : callable
        Told, in a thread of its own, that halting has not ended within `halts_within`: the loop's thread is lost.
    halts_within : float
        Time, s, that halting may take.
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
        on_hang: Callable[[], None] = lambda: None,
        halts_within: float = HALTS_WITHIN,
        read: Callable[[], Reading] = read_clocks,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._on_failure = on_failure
        self._on_pass = on_pass
        self._on_hang = on_hang
        self._halts_within = halts_within
        self._watchdog = Watchdog(self._hang)
        self._hung: Future[None] = Future()
        self._read = read
        self._sleep = sleep
        self._activity: Activity | None = None
        self._jobs: queue.SimpleQueue[tuple[Callable[[], Any], Future[Any]]] = queue.SimpleQueue()
        self._thread: int | None = None
        self._stopping = False

    # From any thread

    def stop(self) -> None:
        """Make `run` return soon, or have `on_hang` told; for handlers of signals, too."""
        self._stopping = True
        self._watchdog.expect(self._halts_within)

    def call(self, work: Callable[[], T], timeout: float = ANSWER_WITHIN) -> T:
        """Have something done in the loop's thread, between two passes, and return what it returns.

        Raises `RunError` if it was not begun in time (s), and then it will not be done either; or if the loop is lost.
        """
        if threading.get_ident() == self._thread:
            return work()
        answer: Future[T] = Future()
        self._jobs.put((work, answer))
        either: tuple[Future[Any], ...] = (answer, self._hung)
        wait(either, timeout, FIRST_COMPLETED)
        if not answer.done() and not self._hung.done():
            if answer.cancel():
                raise RunError(f"the loop that makes the steps has not answered for {timeout:g} s")
            wait(either, return_when=FIRST_COMPLETED)
        if not answer.done():
            raise RunError(self.hang)
        return answer.result()

    @property
    def hang(self) -> str:
        """What there is to say of a loop that is lost."""
        return f"halting has not ended within {self._halts_within:g} s: a drive's stop() hangs, or a step before it"

    def attach(self, engine: Engine | None) -> None:
        """Take over what is to be driven, not active at first; None: nothing."""
        self._halting(lambda: self._attach(engine))

    def activate(self) -> None:
        """Begin to make steps."""
        self.call(self._activate)

    def deactivate(self) -> None:
        """Halt the behaviour, and be silent; raises `RunError` if it does not halt in time."""
        self._halting(self._deactivate)

    def command(self, work: Callable[[int], Messages]) -> None:
        """Have an operator's command done, given the time in ns since 1970, and publish what it answers.

        Raises `RunError` if the node is not active.
        """
        self.call(lambda: self._command(work))

    def health(self, timeout: float = ANSWER_WITHIN) -> Health:
        """Return how behaviour and timing are; what was missed counts since the last time this was asked."""
        return self.call(self._health, timeout)

    def _halting(self, work: Callable[[], None]) -> None:
        """Have something done that halts: what the loop is at must end in time too."""
        self._watchdog.expect(self._halts_within)
        self.call(work, self._halts_within)

    def _hang(self) -> None:
        self._hung.set_result(None)
        self._on_hang()

    # In the loop's thread

    def run(self) -> None:
        """Drive what is attached while it is active, until `stop` is called; then halt it."""
        self._thread = threading.get_ident()
        self._watchdog.start()
        while not self._stopping:
            self._on_pass(self._read().steady)
            self._do_jobs(wait=self._active is None)
            if (activity := self._active) is not None:
                try:
                    self._pass(activity)
                except Exception as error:  # noqa: BLE001 - whatever goes wrong, the body must be left safe
                    self._fail(error)
        try:
            self._deactivate()
        except Exception as error:  # noqa: BLE001 - as above
            self._on_failure(error)
        self._do_jobs(wait=False)
        self._watchdog.end()

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

    @property
    def _active(self) -> Activity | None:
        """What is attached, if it is active."""
        activity = self._activity
        return activity if activity is not None and activity.active else None

    def _pass(self, activity: Activity) -> None:
        topics, seconds = activity.advance()
        if topics:
            if activity.engine.receiver.wait(topics, seconds):
                activity.wake()
        elif seconds:
            self._sleep(seconds)

    def _attach(self, engine: Engine | None) -> None:
        self._deactivate()
        self._activity = None if engine is None else Activity(engine, self._read)

    def _activate(self) -> None:
        if self._activity is None:
            raise RunError("there is nothing to activate")
        self._activity.activate()
        # What is there now stays: the collector need not go through it again while steps are made.
        gc.collect()
        gc.freeze()

    def _deactivate(self) -> None:
        self._watchdog.expect(self._halts_within)
        try:
            if (activity := self._active) is not None:
                gc.unfreeze()
                activity.deactivate()
        finally:
            self._watchdog.expect(None)

    def _fail(self, error: Exception) -> None:
        try:
            self._deactivate()
        except Exception as worse:  # noqa: BLE001 - told together with what led to it
            error = RunError(f"{_text(error)}; then halting failed too: {_text(worse)}")
        self._on_failure(error)

    def _command(self, work: Callable[[int], Messages]) -> None:
        if (activity := self._active) is None:
            raise RunError("this node is not active")
        try:
            activity.command(work)
        except Exception as error:
            self._fail(error)
            raise

    def _health(self) -> Health:
        return Health(Level.WARN, "nothing is configured") if self._activity is None else self._activity.health()


def _text(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"
