"""The loop that drives a node behaviour by the clock: process messages, execute the step that is due, publish.

All access to the behaviour happens in the thread that runs the loop; other threads submit jobs. Work and waiting are
separate: an `Activity` is independent of threads and reads the clocks that it is given, so a test can act as clock,
network and scheduler of a whole fleet.
"""

from __future__ import annotations

import gc
import queue
import threading
import time
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar, cast

from swarmabs_config.graph import OFFERED, REALTIME, USUAL_TOPICS
from swarmabs_core.cdr import decode, encode, misplaced
from swarmabs_core.errors import MalformedMessageError, RunError
from swarmabs_core.messages import TOPIC_OF, SwarmEvent
from swarmabs_core.realtime.base import Health, Level, Sender
from swarmabs_core.realtime.validation import Problem, Refusals
from swarmabs_ros.timing import Reading, StepClock

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from rclpy.publisher import Publisher

    from swarmabs_core.messages import Message, Messages, Topic
    from swarmabs_core.realtime.base import RealtimeBehaviour
    from swarmabs_ros.endpoints import Receiver
    from swarmabs_ros.lockstep import Wait

SLICE = 0.1
"""Longest time, s, between checks for jobs and for the request to stop."""
ANSWER_WITHIN = 2.0
"""Time limit, s, of a job; a loop that does not answer within it is considered hung."""
HALTS_WITHIN = 5.0
"""Time limit, s, of halting for any reason; a drive that takes longer to stop is considered hung."""
TOLERATED = 0.01
"""Fraction of periods that may be missed between two health reports without a warning."""
IDENTIFIED = tuple(topic for topic in OFFERED[REALTIME] if not issubclass(topic.message, SwarmEvent))
"""Topics whose receivers distinguish the writers; of events all may speak."""
_NOTHING: Wait = ((), 0.0)
_PAIRED = 100_000
"""Longest time, ns, between the readings of two clocks that count as simultaneous."""

T = TypeVar("T")


def read_clocks() -> Reading:
    """Read the system clock and the steady clock; retry if this thread was interrupted in between."""
    for _ in range(3):
        steady = time.monotonic_ns()
        system = time.time_ns()
        if time.monotonic_ns() - steady < _PAIRED:
            break
    return Reading(system, steady)


def arrived(receiver: Receiver, depths: Mapping[Topic, int]) -> Iterator[tuple[Topic, bytes, bytes]]:
    """Take messages that have arrived, with the GIDs of their writers where the receiver knows them.

    At most `depths` of each topic are taken, so that a flood cannot delay further work.
    """
    for topic, depth in depths.items():
        for _ in range(depth):
            data = receiver.take(topic)
            if data is None:
                break
            yield topic, data, receiver.writer(topic)


@dataclass(frozen=True, slots=True)
class Engine:
    """A behaviour with its clock and its endpoints, for the loop to drive.

    Parameters
    ----------
    clock : StepClock
        Determines when the behaviour's steps are due.
    depths : mapping
        Queue depth of each topic.
    publishers : mapping
        Publishers by the usual topic, also those of a standby or a robot that publishes on topics of its own.
    wakes : tuple of Topic
        Topics whose messages are processed at once; all others are processed when a step is due.
    decode : callable
        Deserializes a message, given its class and bytes.
    """

    behaviour: RealtimeBehaviour
    clock: StepClock
    receiver: Receiver
    depths: Mapping[Topic, int]
    publishers: Mapping[Topic, Publisher]
    wakes: tuple[Topic, ...] = ()
    decode: Callable[[type[Message], bytes], Message] = decode


class Activity:
    """Operations on an engine: steps, messages, commands, health.

    Attributes
    ----------
    engine : Engine
        The engine that is driven.
    active : bool
        Whether steps are executed.
    refused : int
        Number of rejected malformed messages.
    refusal : str
        Reason for the last rejection.
    """

    def __init__(self, engine: Engine, read: Callable[[], Reading]) -> None:
        self.engine = engine
        self._read = read
        self._reported = (0, 0)
        self.active = False
        self.refused = 0
        self.refusal = ""
        self._misplaced = Refusals()

    def activate(self) -> None:
        """Start executing steps."""
        engine = self.engine
        # Queued messages are outdated; events are kept for nodes that join late, regardless of their age.
        passing = {t: n for t, n in engine.depths.items() if not issubclass(t.message, SwarmEvent)}
        for _ in arrived(engine.receiver, passing):
            pass
        engine.clock.start(self._read())
        self.active = True

    def deactivate(self) -> None:
        """Halt the behaviour and stop publishing."""
        if self.active:
            self.active = False
            self.engine.behaviour.halt()

    def advance(self) -> Wait:
        """If a step is due, process the messages that have arrived and execute it; return what to wait for."""
        engine, now = self.engine, self._read()
        if engine.clock.due(now) is not None:
            self._hear(now.system)
            self._publish(engine.behaviour.tick(now.system))
            return _NOTHING
        return engine.wakes, min(SLICE, engine.clock.wait(now) / 1e9)

    def wake(self) -> None:
        """Process messages that have arrived between two steps."""
        self._hear(self._read().system)

    def command(self, work: Callable[[int], Messages]) -> None:
        """Execute an operator's command, given the time in ns since 1970, and publish its answer."""
        self._publish(work(self._read().system))

    def health(self) -> Health:
        """Return the health of behaviour and timing; missed periods are counted since the last call."""
        now, clock = self._read(), self.engine.clock
        level, text, values = self.engine.behaviour.health(now.system)
        missed, executed = clock.missed - self._reported[0], clock.lateness.count - self._reported[1]
        self._reported = clock.missed, clock.lateness.count
        concerns = [text]
        if missed > TOLERATED * (missed + executed):
            level = max(level, Level.WARN)
            concerns.append(f"{missed} periods missed")
        return Health(level, "; ".join(concerns), (*values, *clock.values(), *self._refusals()))

    def _hear(self, now: int) -> None:
        engine = self.engine
        for topic, data, writer in arrived(engine.receiver, engine.depths):
            try:
                message = engine.decode(topic.message, data)
            except MalformedMessageError as error:
                self.refused += 1
                self.refusal = str(error)
                continue
            problem = misplaced(message, topic)
            if problem:
                self._publish(self._misplaced.add(Problem(problem), engine.clock.step(now), now))
            else:
                self._publish(engine.behaviour.hear(message, now, Sender(topic in USUAL_TOPICS, writer)))

    def _publish(self, messages: Messages) -> None:
        for message in messages:
            self.engine.publishers[TOPIC_OF[type(message)]].publish(encode(message))

    def _refusals(self) -> tuple[tuple[str, str], ...]:
        values = [("malformed messages", str(self.refused))]
        if self.refused:
            values.append(("last malformed", self.refusal))
        if self._misplaced.total:
            values += [("misplaced messages", str(self._misplaced.total)), ("last misplaced", self._misplaced.latest)]
        return tuple(values)


class Watchdog(threading.Thread):
    """Calls `on_hang` if an operation does not end in time, wherever its thread hangs."""

    def __init__(self, on_hang: Callable[[], None]) -> None:
        super().__init__(name="watchdog", daemon=True)
        self._on_hang = on_hang
        # Reentrant, so that signal handlers can use it.
        self._orders: queue.SimpleQueue[float | None] = queue.SimpleQueue()

    def expect(self, seconds: float | None) -> None:
        """Expect the operation to end within a time (s) from now; None: it has ended."""
        self._orders.put(seconds)

    def end(self) -> None:
        """Stop watching."""
        self._orders.put(-1.0)
        self.join()

    def run(self) -> None:
        """Watch until `end`, or until an operation hangs."""
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
        Called in the loop's thread with an error of the behaviour, after the behaviour was halted.
    on_pass : callable
        Called with the steady time, ns, at least every `SLICE` s.
    on_hang : callable
        Called in a separate thread if halting does not end within `halts_within`: the loop's thread is lost.
    halts_within : float
        Time limit of halting, s.
    read : callable
        Reads the clocks.
    sleep : callable
        Sleeps for a time, s, by the steady clock.
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
        self._jobs: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._thread: int | None = None
        self._stopping = False

    # From any thread

    def stop(self) -> None:
        """Make `run` return soon, or `on_hang` be called; safe in signal handlers."""
        self._stopping = True
        self._watchdog.expect(self._halts_within)

    def call(self, work: Callable[[], T], timeout: float = ANSWER_WITHIN) -> T:
        """Execute `work` in the loop's thread, between two passes, and return its result.

        Raises `RunError` if it does not start within `timeout` (s), in which case it is cancelled, or if the loop is
        lost.
        """
        if threading.get_ident() == self._thread:
            return work()
        answer: Future[T] = Future()
        self._jobs.put(lambda: _answer(work, answer))
        either = answer, cast("Future[T]", self._hung)
        wait(either, timeout, FIRST_COMPLETED)
        if not answer.done() and not self._hung.done():
            if answer.cancel():
                raise RunError(f"the loop that executes the steps has not answered for {timeout:g} s")
            wait(either, return_when=FIRST_COMPLETED)
        if not answer.done():
            raise RunError(self.hang)
        return answer.result()

    @property
    def hang(self) -> str:
        """The error text for a loop that is lost."""
        return f"halting has not ended within {self._halts_within:g} s: a drive's stop() hangs, or a step before it"

    def attach(self, engine: Engine | None) -> None:
        """Attach an engine, which is inactive at first; None: detach the current one."""
        self._halting(lambda: self._attach(engine))

    def activate(self) -> None:
        """Start executing steps."""
        self.call(self._activate)

    def deactivate(self) -> None:
        """Halt the behaviour and stop publishing; raises `RunError` if it does not halt in time."""
        self._halting(self._deactivate)

    def command(self, work: Callable[[int], Messages]) -> None:
        """Execute an operator's command, given the time in ns since 1970, and publish its answer.

        Raises `RunError` if the node is not active.
        """
        self.call(lambda: self._command(work))

    def health(self, timeout: float = ANSWER_WITHIN) -> Health:
        """Return the health of behaviour and timing; missed periods are counted since the last call."""
        return self.call(self._health, timeout)

    def _halting(self, work: Callable[[], None]) -> None:
        """Execute work that halts the behaviour; the loop's current work must also end in time."""
        self._watchdog.expect(self._halts_within)
        self.call(work, self._halts_within)

    def _hang(self) -> None:
        self._hung.set_result(None)
        self._on_hang()

    # In the loop's thread

    def run(self) -> None:
        """Drive the attached engine while it is active, until `stop` is called; then halt it."""
        self._thread = threading.get_ident()
        self._watchdog.start()
        while not self._stopping:
            self._on_pass(self._read().steady)
            self._do_jobs(wait=self._active is None)
            if (activity := self._active) is not None:
                try:
                    self._pass(activity)
                except Exception as error:  # noqa: BLE001 - after any error the body must be brought to a safe state
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
                self._jobs.get(wait, SLICE)()
                wait = False
        except queue.Empty:
            return

    @property
    def _active(self) -> Activity | None:
        """The attached activity, if it is active."""
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
            raise RunError("there is nothing to activate; configure the node first")
        self._activity.activate()
        # Existing objects are permanent: the collector need not scan them again while steps are executed.
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
        except Exception as worse:  # noqa: BLE001 - reported together with its cause
            error = RunError(f"{_text(error)}; then halting failed too: {_text(worse)}")
        self._on_failure(error)

    def _command(self, work: Callable[[int], Messages]) -> None:
        if (activity := self._active) is None:
            raise RunError("this node is not active; activate it first")
        try:
            activity.command(work)
        except Exception as error:
            self._fail(error)
            raise

    def _health(self) -> Health:
        return Health(Level.WARN, "nothing is configured") if self._activity is None else self._activity.health()


def _answer(work: Callable[[], T], answer: Future[T]) -> None:
    """Execute work unless it is cancelled, and set its result or its error."""
    if answer.set_running_or_notify_cancel():
        try:
            answer.set_result(work())
        except Exception as error:  # noqa: BLE001 - it is raised in the calling thread
            answer.set_exception(error)


def _text(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"
